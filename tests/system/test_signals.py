"""Ctrl-C and SIGTERM at any instant, the very first milliseconds among them: 130 to a shell, no
traceback, no half-written file.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
import tomllib
import venv
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import xacro

from cranedyn.command import INTERRUPTED, command
from cranedyn.data.trajectory import read
from cranedyn.model.description import describe
from tests.helpers import ROOT, files

QUIET = "cranedyn/ctrl_c.pth"


def started(words: list[str], python: str = sys.executable) -> subprocess.Popen[str]:
    """A command as a shell would start it."""
    return subprocess.Popen(
        [python, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT
    )


# --- before any module of ours is imported --------------------------------------------------------


@pytest.mark.parametrize("module", ["cranedyn.model.description", "experiments.energy"])
def test_ctrl_c_while_python_reads_its_environment_shows_no_traceback(
    module: str, tmp_path: Path
) -> None:
    venv.create(tmp_path, symlinks=True)
    packages = next(tmp_path.glob("lib/python*/site-packages"))
    (packages / _installed()).write_text((ROOT / QUIET).read_text())
    (packages / "cmeel.pth").write_text(
        "import sys, time; sys.stderr.write('reading\\n'); sys.stderr.flush(); time.sleep(20)\n"
    )
    process = started(["-m", module], str(tmp_path / "bin" / "python"))
    assert process.stderr is not None
    assert process.stderr.readline() == "reading\n"
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=10)[1] == ""
    assert process.returncode == -signal.SIGINT  # 130 to a shell


def _installed() -> str:
    """The name under which the file is installed, read before those of the packages we stand on."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
        "targets"
    ]["wheel"]
    name: str = wheel["force-include"][QUIET]
    assert sorted([name, "cmeel.pth", "distutils-precedence.pth"])[0] == name
    return name


def test_other_programs_keep_their_ctrl_c(tmp_path: Path) -> None:
    line = (ROOT / QUIET).read_text()
    script = (
        f"import signal\nexec({line!r})\nimport cranedyn\n"
        "print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    )
    (tmp_path / "other.py").write_text(script)
    for words in (["-c", script], ["-m", "other"], ["-m", "other", "cranedyn.model.description"]):
        run = subprocess.run(
            [sys.executable, *words],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            check=False,
        )
        assert run.stdout == "True\n", run.stderr


@pytest.mark.parametrize("seen", ["cranedyn.errors", "minidom", "xacro"])
def test_ctrl_c_while_the_description_is_being_imported_shows_no_traceback(seen: str) -> None:
    process = started(["-X", "importtime", "-m", "cranedyn.model.description"])
    assert process.stderr is not None
    for line in process.stderr:
        if line.rstrip().endswith(seen):
            break
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(10) in (-signal.SIGINT, INTERRUPTED)
    assert "Traceback" not in rest and "KeyboardInterrupt" not in rest


# --- while a command runs -------------------------------------------------------------------------


def _taken_for_a_fault() -> None:
    """As where a library imports in a `try` and names in its `except` what was to be imported."""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        raise UnboundLocalError("cannot access local variable 'ArgException'") from None


def test_an_interruption_that_xacro_takes_for_a_fault_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.xacro").write_text('<robot name="a"/>')  # ours may have been expanded before
    monkeypatch.setattr(xacro, "process_file", lambda *_, **__: _taken_for_a_fault())
    with pytest.raises(KeyboardInterrupt):
        describe(tmp_path / "a.xacro")


def _refused() -> int:
    raise KeyboardInterrupt


def _hidden() -> int:
    _taken_for_a_fault()
    return 0


@pytest.mark.parametrize("run", [_refused, _hidden])
def test_an_interruption_is_130_whatever_a_library_made_of_it(
    run: Callable[[], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(run) == INTERRUPTED
    assert capsys.readouterr().err == "Interrupted.\n"


def test_a_fault_of_ours_is_not_taken_for_an_interruption() -> None:
    with pytest.raises(ZeroDivisionError):
        command(lambda: 1 // 0)


@pytest.mark.parametrize("when", ["_interruptible", "_patient"])
def test_an_interruption_before_or_after_the_run_of_a_command_is_130(
    when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"cranedyn.command.{when}", stopped)
    assert command(lambda: 0) == INTERRUPTED


COMMANDS = [
    ["cranedyn.model.description", "-o", "{}/crane.urdf"],
    ["experiments.energy", "--out", "{}/energy"],
    ["experiments.a1", "--out", "{}/a1"],
    ["experiments.a2", "--engine", "compiled", "--out", "{}/a2"],
    ["experiments.compare", "--jobs", "1", "--out", "{}/compare"],
    ["experiments.validate", "--out", "{}/validate"],
    ["experiments.report", "--only", "mass_ratio", "--out", "{}/report"],
    ["experiments.snapshot", "{}/no.rrd", "-t", "0"],
]


def _used(process: subprocess.Popen[str]) -> float:
    """Time of the processor that it has taken [s]."""
    return sum(psutil.Process(process.pid).cpu_times()[:2])


@pytest.mark.parametrize("words", COMMANDS, ids=[words[0] for words in COMMANDS])
def test_a_signal_at_a_random_instant_ends_a_command_quietly_and_leaves_whole_files_only(
    words: list[str], tmp_path: Path
) -> None:
    pick = random.Random(words[0])
    for latest in (0.3, 4.0):
        process = started(["-m", *(word.format(tmp_path) for word in words)])
        # Until Python has read its environment.
        while process.poll() is None and _used(process) < 0.1:
            time.sleep(0.005)
        time.sleep(pick.uniform(0.0, latest))
        if process.poll() is None:
            used = _used(process)
            process.send_signal(pick.choice([signal.SIGINT, signal.SIGTERM]))
            assert process.stderr is not None
            error = process.stderr.read()
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            # Of the processor, which others use, too.
            assert usage.ru_utime + usage.ru_stime - used < 2.0
            assert process.returncode in (INTERRUPTED, -signal.SIGINT, -signal.SIGTERM, 0, 2)
            assert "Traceback" not in error and "KeyboardInterrupt" not in error
        process.communicate()
    for name in files(tmp_path):
        path = tmp_path / name
        assert not path.name.startswith(".")
        if path.suffix == ".parquet":
            assert len(read(path)) > 0
        if path.suffix == ".json":
            json.loads(path.read_text())
        if path.suffix == ".urdf":
            assert path.read_text().endswith("</robot>\n")
