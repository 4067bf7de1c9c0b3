"""Ctrl-C and SIGTERM to every command at any instant of its life."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from random import Random

from cranedyn.recording.process import free_port, is_free
from tests.system.fuzz.core import PATIENCE, ROOT, Broken, Case, Generator
from tests.system.fuzz.lines import check_whole, commands

ARGUMENTS = {
    "sweep": "--points 2 --durations 2 --workers 2",
    "compare": "--engine compiled --jobs 2 --only flat",
    "report": "--engine compiled --only mass_ratio energy --out out",
    "description": "",
    "snapshot": "nothing.rrd -t 0",
}
"""What commands are given that do not take ``--engine compiled``, or would take too long; `compare`
is given names of its own."""

_ENDED = 30.0
"""Time in which it must have ended in any case, on a machine with much else to do [s]."""


@dataclass(frozen=True)
class Signals:
    """A command in a process of its own that gets a signal when it has had some processor time."""

    name: str = "signals"
    weight: float = 0.02
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """Which command, which signal, and after how much processor time [s]."""
        command = rng.choice(list(commands()))
        serves = command.startswith("experiments.") and rng.random() < 0.1
        return Case(
            (
                command,
                rng.choice(["SIGINT", "SIGINT", "SIGTERM"]),
                round(10.0 ** rng.uniform(-2.3, 0.6), 4),
                serves,
            ),
            [],
        )

    def attempt(self, case: Case, folder: Path) -> str:
        """It ends in time with 130, or was done, and leaves whole files, no process and no
        traceback.
        """
        command, name, after, serves = case.head
        port = (
            next((port for port in iter(free_port, 0) if port < 65535 and is_free(port + 1)), 0)
            if serves
            else 0
        )
        words = [sys.executable, "-m", command, *_arguments(command, port)]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        with (folder.parent / "said").open("w+") as said:
            process = subprocess.Popen(
                words, cwd=folder, env=environment, stdout=said, stderr=said, start_new_session=True
            )
            try:
                code, used = _signalled(process, getattr(signal, name), after)
            finally:
                left = _end_group(process.pid)
            said.seek(0)
            text = said.read()
        if used > PATIENCE:
            raise Broken(
                f"{name} is not answered in {PATIENCE:g} s by {command}",
                f"it took {used:.1f} s of processor time",
            )
        if left:
            raise Broken(f"{command} leaves a process behind", name)
        if code not in (0, 1, 2, 130, -getattr(signal, name)):
            raise Broken(
                f"{name} ends {command} with another code than 130", f"{code} {text[-500:]}"
            )
        ours = set(re.findall(r'File "[^"]*/(?:cranedyn|experiments)/(.*)\.py"', text))
        if "Traceback" in text and ours - {"__init__", "startup"}:  # once those have been imported
            raise Broken(f"{name} shows a traceback of ours", text[-1500:])
        check_whole([str(path) for path in folder.rglob("*")])
        return f"code {code}"

    def shown(self, case: Case) -> str:
        """The command, the signal and when."""
        command, name, after, serves = case.head
        return (
            f"python -m {command} {' '.join(_arguments(command, 9090 if serves else 0))}   # "
            f"{name} after {after} s of processor time"
        )


def _arguments(command: str, port: int) -> list[str]:
    """What a command is given, its recording to be served at a port unless that is 0."""
    short = command.rpartition(".")[2]
    words = ARGUMENTS.get(short, "--engine compiled --out out").split()
    if short == "compare":
        words[-1] = "spline + PD"
    return words + (
        ["--serve", "--port", str(port)]
        if port and short not in ("sweep", "report", "snapshot")
        else []
    )


def _signalled(process: subprocess.Popen[bytes], number: int, after: float) -> tuple[int, float]:
    """Exit code, and the processor time [s] from the signal to the end."""
    began = time.monotonic()
    while (
        (used := _processor(process.pid)) < after
        and time.monotonic() < began + _ENDED
        and process.poll() is None
    ):
        time.sleep(0.002)
    before = used
    if process.returncode is None:
        process.send_signal(number)
    end = time.monotonic() + _ENDED
    while process.poll() is None and time.monotonic() < end:
        used = max(used, _processor(process.pid))
        time.sleep(0.01)
    if process.returncode is None:
        return 0, float("inf")
    return process.returncode, max(0.0, used - before)


def _processor(pid: int) -> float:
    """Processor time of a process [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _end_group(pid: int) -> bool:
    """Whether any process of its group is left when it has had two seconds to end; it is ended."""
    for _ in range(round(PATIENCE / 0.05)):
        try:
            os.killpg(pid, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.05)
    os.killpg(pid, signal.SIGKILL)
    return True


GENERATORS: list[Generator] = [Signals()]
