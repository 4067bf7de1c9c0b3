"""The commands that an output names at its end, and whether they work."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest

from cranedyn.__main__ import main
from cranedyn.command import Parser

RUN = ("describe", "list", "record-template")
"""Commands of this package that are run; the others take long or do not end by themselves, so that
their arguments are parsed only.
"""

DELEGATED = ("list", "report", "run", "snapshot")
"""Commands of this package whose arguments are parsed by the module of the command."""

WRITING = ("export", "record-template", "template")
"""Commands of this package whose file is a new one."""

FILE_ENDINGS = (".csv", ".json", ".mcap", ".parquet", ".rrd", ".urdf")
"""Endings of files that commands read."""


class Parsed(BaseException):
    """Arguments were parsed without an error."""


def check_next_commands(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that an output ends with two commands that work with what is there now.

    Args:
        text: The output.
        monkeypatch: Patches the parser.
    """
    before, mark, last = text.rpartition("Next: ")
    assert mark, f"no next command is named: {text}"
    assert before == "" or before.endswith("\n")
    lines = last.splitlines()
    assert len(lines) == 2
    assert lines[0] != lines[1].strip()
    for line in lines:
        commands, _, remark = line.partition("  # ")
        for command in commands.split(" && "):
            words = shlex.split(command)
            if words[0] == "cranedyn":
                # A file that is there "once" something is done is written by somebody else later.
                _check_own(words[1:], monkeypatch, files_are_there="once" not in remark)
            else:
                _check_program(words)


def _check_own(words: list[str], monkeypatch: pytest.MonkeyPatch, *, files_are_there: bool) -> None:
    """Run a command of this package if it is quick, else check its arguments and files."""
    if files_are_there and words[0] not in WRITING:
        for word in words[1:]:
            assert not word.endswith(FILE_ENDINGS) or Path(word).is_file(), words
    if words[0] in RUN or "--help" in words:
        assert _exit_code(words) == 0, words
    else:
        assert _parses(words, monkeypatch), words


def _check_program(words: list[str]) -> None:
    """Run another program on what was written, or do what it does first, where that is quick."""
    program = words[0]
    if words[:3] == ["python", "-m", "webbrowser"]:
        assert Path(url2pathname(urlsplit(words[3]).path)).is_file(), words
    elif words[:3] == ["python", "-m", "mujoco.viewer"]:
        mujoco = pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
        mujoco.MjModel.from_xml_path(words[3].removeprefix("--mjcf="))
    elif program == "python":
        subprocess.run([sys.executable, *words[1:]], check=True, timeout=60)
    elif program in ("cmake", "ctest", "fmpy"):
        beside_python = shutil.which(program, path=str(Path(sys.executable).parent))
        file = beside_python or shutil.which(program)
        if file is not None:
            subprocess.run([file, *words[1:]], check=True, timeout=300)
    elif program in ("colcon", "ros2"):
        assert Path(words[-1]).exists(), words
    elif program == "matlab":
        assert Path(words[2].split("'")[1]).is_file(), words
    else:
        # A script that the command has written.
        assert os.access(program, os.X_OK), words


def _exit_code(words: list[str]) -> int:
    """Return the exit code of a command of this package, which is returned or raised."""
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


def _parses(words: list[str], monkeypatch: pytest.MonkeyPatch) -> bool:
    """Return whether a command of this package accepts its arguments."""
    parse = Parser.parse_args

    def stop(parser: Parser, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and go on only to the parser that takes the rest."""
        options = parse(parser, args, namespace)
        if parser.prog == "cranedyn" and words[0] in DELEGATED:
            return options
        raise Parsed

    with monkeypatch.context() as patch:
        patch.setattr(Parser, "parse_args", stop)
        try:
            main(words)
        except Parsed:
            return True
        except SystemExit:
            return False
    return False
