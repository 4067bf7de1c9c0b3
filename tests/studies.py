"""Studies for the tests of sweeps, in a module that workers import in no time."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

Columns = Mapping[str, np.ndarray]


def squares(cases: Columns) -> Columns:
    """The parameter, squared."""
    return {"y": cases["x"] ** 2}


def logged(cases: Columns) -> Columns:
    """Squares, slowly; every case is noted in a file beside the number of the process. Where a gate
    is named, cases from 8 on wait for that file.
    """
    with open(os.environ["SWEEP_LOG"], "a") as log:
        log.write("".join(f"{os.getpid()} {x:g}\n" for x in cases["x"]))
    time.sleep(float(os.environ["SWEEP_PAUSE"]))
    gate = os.environ.get("SWEEP_GATE")
    while gate and (cases["x"] >= 8.0).any() and not os.path.exists(gate):
        time.sleep(0.01)
    return squares(cases)


def troubled(cases: Columns) -> Columns:
    """Squares, but 1 cannot be computed, 2 ends in NaN, 3 in infinity; 4 has none and needs
    none.
    """
    if (cases["x"] == 1.0).any():
        raise ArithmeticError("one\nis too much")
    y = cases["x"] ** 2
    y[cases["x"] == 2.0] = np.nan
    y[cases["x"] == 3.0] = -np.inf
    cases["x"][:] = 0.0  # a study may do what it likes with what it gets
    return {
        "y": np.ma.masked_equal(y, 16.0),
        "n": np.arange(len(y)) % 2,
        "word": np.array(["even", "odd"])[np.arange(len(y)) % 2],
    }


def hopeless(cases: Columns) -> Columns:
    """Squares from 4 on."""
    if (cases["x"] < 4.0).any():
        raise ValueError("too small")
    return squares(cases)


def deadly(cases: Columns) -> Columns:
    """Squares, but 3 ends the process."""
    if (cases["x"] == 3.0).any():
        os._exit(1)
    return squares(cases)


def wide(cases: Columns) -> Columns:
    """A hundred random columns."""
    rng = np.random.default_rng(1)
    return {f"y{i}": rng.random(len(cases["x"])) for i in range(100)}


def careless(cases: Columns) -> object:
    """Something that no study may return, by its name."""
    count = len(cases["x"])
    return {
        "nothing": None,
        "short": {"y": np.zeros(count + 1)},
        "flat": {"y": 1.0},
        "complex": {"y": np.zeros(count, dtype=complex)},
        "object": {"y": np.array([object()] * count)},
        "large": {"y": np.full(count, 2**63, dtype=np.uint64)},
        "parameter": {"x": np.zeros(count)},
        "reserved": {"error": np.zeros(count)},
    }[str(cases["kind"][0])]


def leaving(cases: Columns) -> Columns:
    """It tries to end the program."""
    raise SystemExit("enough")


def interrupting(cases: Columns) -> Columns:
    """It raises what Ctrl-C would."""
    raise KeyboardInterrupt


def cut_off(cases: Columns) -> Columns:
    """Squares of so many cases that they do not fit a pipe at once. The first time, the process is
    killed while it sends them: its parent is stopped meanwhile, and reads no more than a part.
    """
    log = Path(os.environ["SWEEP_LOG"])
    is_first = not log.exists()
    with log.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if is_first:
        parent = os.getppid()
        commands = f"kill -STOP {parent}; sleep 1; kill -KILL {os.getpid()}; kill -CONT {parent}"
        subprocess.Popen(["sh", "-c", commands], start_new_session=True)
        while "\nState:\tT" not in Path(f"/proc/{parent}/status").read_text():
            time.sleep(0.01)
    return squares(cases)


def two_minded(cases: Columns) -> Columns:
    """Numbers for some, words for others."""
    if len(set(cases["x"] < 2.0)) > 1:
        raise ValueError
    return {"y": np.array(["a"] * len(cases["x"])) if cases["x"][0] < 2.0 else cases["x"]}


def stuck(cases: Columns) -> Columns:
    """Squares, but 3 never ends, in native code that keeps Python's lock."""
    if (cases["x"] == 3.0).any():
        deaf(100)
    return squares(cases)


def deaf(seconds: int) -> None:
    """Sleep in native code that keeps Python's lock, after a line in the log with the number of the
    process.
    """
    if "SWEEP_LOG" in os.environ:
        with open(os.environ["SWEEP_LOG"], "a") as log:
            log.write(f"{os.getpid()} 0\n")
    ctypes.PyDLL(None).sleep(seconds)


def killed_while_sending() -> str:
    """A result of which half is sent to the parent before this process is killed."""

    def send_half(connection: Connection, message: bytes) -> None:
        os.write(connection.fileno(), message[: len(message) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    Connection._send = send_half  # type: ignore[attr-defined]
    return "a result"
