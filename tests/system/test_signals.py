"""Ctrl-C and SIGTERM at any instant of a command: 130 to a shell, no traceback, no half-written
file; the signals of other programs are left alone.
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
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import xacro

from cranedyn.command import INTERRUPTED, command
from cranedyn.data.trajectory import read
from cranedyn.model.description import describe
from tests.helpers import ROOT, files


def started(words: list[str]) -> subprocess.Popen[str]:
    """A command as a shell would start it."""
    return subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


# --- what is not ours -----------------------------------------------------------------------------


def test_the_wheel_writes_nothing_outside_of_its_own_package() -> None:
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
        "targets"
    ]["wheel"]
    assert wheel["packages"] == ["cranedyn"]
    assert all(name.startswith("cranedyn/") for name in wheel["force-include"].values())


@pytest.mark.parametrize("package", ["cranedyn", "experiments"])
def test_other_programs_keep_their_ctrl_c(package: str, tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "__init__.py").write_text(f"import {package}\n")
    (tmp_path / "lab" / "__main__.py").write_text(
        "import signal\nprint(signal.getsignal(signal.SIGINT) is signal.default_int_handler)\n"
    )
    run = subprocess.run(
        [sys.executable, "-m", "lab", "-m", package],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert run.stdout == "True\n", run.stderr


# --- while a command runs -------------------------------------------------------------------------


_SWALLOWED = """
import signal, sys, time
from cranedyn.command import command

signal.signal(signal.SIGINT, signal.SIG_IGN if {ignored} else signal.default_int_handler)

def run():
    import careless
    time.sleep(1)
    return 0

assert command(run) == 130
assert sys.modules["careless"].whole
"""


@pytest.mark.parametrize(("signal", "ignored"), [("SIGINT", False), ("SIGTERM", True)])
def test_an_interruption_waits_for_an_import_that_would_swallow_it(
    signal: str, ignored: bool, tmp_path: Path
) -> None:
    (tmp_path / "careless.py").write_text(
        "try:\n    import interrupted\n    whole = True\nexcept BaseException:\n    whole = False\n"
    )
    (tmp_path / "interrupted.py").write_text(
        f"import signal\nsignal.raise_signal(signal.{signal})\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", _SWALLOWED.format(ignored=ignored)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"},
        check=False,
    )
    assert (run.returncode, run.stderr) == (0, "Interrupted.\n")


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
            # Before and after the command Python may say so in its own way.
            assert ", in command\n" not in error
            assert process.returncode != INTERRUPTED or "Traceback" not in error
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
