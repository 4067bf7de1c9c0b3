"""The process of Rerun's viewer: where the program is, how it starts and ends, and the ports it
takes.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cranedyn.errors import CraneError

HOST = "127.0.0.1"
"""This machine alone; Rerun itself would listen to all."""

_PATIENCE = 30.0

_QUIET: dict[str, Any] = {
    "stdin": subprocess.DEVNULL,
    "stdout": subprocess.DEVNULL,
    "stderr": subprocess.DEVNULL,
}

_GUARD = """
import os, signal, sys, time
parent, child = map(int, sys.argv[1:])
try:
    while os.getppid() == parent:
        os.kill(child, 0)
        time.sleep(0.5)
    os.kill(child, signal.SIGKILL)
except ProcessLookupError:
    pass
"""
_GUARDS: dict[int, subprocess.Popen[bytes]] = {}
"""The guard of each process that has one, by the number of the process."""


def start(*arguments: str, own_session: bool = False) -> subprocess.Popen[bytes]:
    """Start the viewer, silent: it prints nothing, and its analytics are off whatever the user's
    own setting is, which stays as it is.

    Args:
        arguments: Of its command line.
        own_session: Whether it outlives the program and the terminal that it is started from; else
            it ends with the program, even if that is killed.

    Raises:
        CraneError: If it is not installed or does not start.
    """
    # Where CI is set, Rerun sends nothing ...
    environment = {"RUST_LOG": "error"} | dict(os.environ) | {"CI": "true"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)  # ... but where this is
    software = sorted(Path("/usr/share/vulkan/icd.d").glob("lvp_icd.*.json"))
    if (
        "--headless" in arguments
        and software
        and not {"VK_ICD_FILENAMES", "VK_DRIVER_FILES"} & environment.keys()
    ):
        environment["VK_ICD_FILENAMES"] = str(software[0])
    try:
        process = subprocess.Popen(
            [program(), *arguments], env=environment, start_new_session=own_session, **_QUIET
        )
        try:
            if not own_session:
                guard(process)
        except BaseException:
            end(process)
            raise
    except OSError as error:
        raise CraneError(f"Rerun's viewer cannot be started: {error.strerror}.") from error
    return process


def guard(process: subprocess.Popen[bytes]) -> None:
    """Have a process that was started here killed within a second after this program has ended,
    however it did.

    A small process of its own looks twice a second whether both are there; it ends with the one or
    the other, or by `end`.
    """
    command = [sys.executable, "-I", "-S", "-c", _GUARD, str(os.getpid()), str(process.pid)]
    _GUARDS[process.pid] = subprocess.Popen(command, start_new_session=True, **_QUIET)


def await_ready(process: subprocess.Popen[bytes], ready: Callable[[], bool], hint: str) -> None:
    """Return when the viewer is ready; if it does not become so, end it.

    Raises:
        CraneError: If it ends before it is ready, or is not ready in half a minute; the hint says
            what may help.
    """
    try:
        for _ in range(round(_PATIENCE / 0.05)):
            if process.poll() is not None:
                raise CraneError(
                    f"Rerun's viewer ended with exit code {process.returncode}. {hint}"
                )
            if ready():
                return
            time.sleep(0.05)
        raise CraneError(f"Rerun's viewer did not start within {_PATIENCE:g} s. {hint}")
    except BaseException:
        end(process)
        raise


def ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether it has ended by itself, or does within a second."""
    try:
        process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return False
    return True


def end(process: subprocess.Popen[bytes]) -> None:
    """End it, by force if it does not listen, and its guard."""
    process.terminate()
    try:
        process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if watching := _GUARDS.pop(process.pid, None):
        watching.kill()
        watching.wait()


def free(port: int) -> bool:
    """Whether nobody listens at a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) != 0


def free_port() -> int:
    """A port of this machine at which nobody listens."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def program() -> Path:
    """The viewer that comes with the Python package; the ``rerun`` command is a script around it,
    which would have to be ended too.
    """
    spec = importlib.util.find_spec("rerun_cli")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or [])] if spec else []
    for file in (
        folder / name
        for folder in folders
        for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
    ):
        if file.is_file():
            return file
    raise CraneError(
        "Rerun's viewer is not installed; install it with: pip install --force-reinstall rerun-sdk"
    )
