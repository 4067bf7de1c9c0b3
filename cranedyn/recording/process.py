"""The process of Rerun's viewer and the ports it takes.

Rerun's own `spawn` and `serve_web_viewer` listen on all interfaces and send analytics.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cranedyn.errors import CraneError

HOST = "127.0.0.1"
"""The only interface that viewers listen on."""

_START_SECONDS = 30.0
_QUIET: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
_GUARD = "import os, sys; sys.stdin.read(); os.kill(int(sys.argv[1]), 9)"
_GUARDS: dict[int, subprocess.Popen[bytes]] = {}
"""The guard of each guarded process, by process id."""


def start(
    *arguments: str, ports: Sequence[int], hint: str, detached: bool = False
) -> subprocess.Popen[bytes]:
    """Start the viewer without output and analytics, and return when its ports answer.

    Args:
        arguments: Arguments of its command line.
        ports: Ports on which it listens.
        hint: Advice for the error message.
        detached: Whether it outlives this program; else it ends with it, even if that is killed.

    Raises:
        CraneError: If the viewer is not installed, or is not ready within half a minute.
    """
    # Rerun sends no analytics where CI is set, whatever the user's own setting, which stays.
    environment = {"RUST_LOG": "error", **os.environ, "CI": "true"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    drivers = sorted(Path("/usr/share/vulkan/icd.d").glob("lvp_icd.*.json"))
    chosen = {"VK_ICD_FILENAMES", "VK_DRIVER_FILES"} & environment.keys()
    if "--headless" in arguments and drivers and not chosen:
        environment["VK_ICD_FILENAMES"] = str(drivers[0])
    command = [str(_program()), "--bind", HOST, *arguments]
    null = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            command, env=environment, start_new_session=detached, stdin=null, **_QUIET
        )
    except OSError as error:
        raise CraneError(f"Rerun's viewer cannot be started: {error.strerror}.") from error
    try:
        if not detached:
            guard(process)
        deadline = time.monotonic() + _START_SECONDS
        while any(map(is_free, ports)):
            if process.poll() is not None:
                code = process.returncode
                raise CraneError(f"Rerun's viewer ended with exit code {code}. {hint}")
            if time.monotonic() > deadline:
                raise CraneError(f"Rerun's viewer did not start in {_START_SECONDS:g} s. {hint}")
            time.sleep(0.05)
    except BaseException:
        end(process)
        raise
    return process


def guard(process: subprocess.Popen[bytes]) -> None:
    """Have a process killed when this program ends, even by a kill.

    A small process waits for the end of a pipe that this program holds open; `end` ends it, too.
    """
    command = [sys.executable, "-I", "-S", "-c", _GUARD, str(process.pid)]
    _GUARDS[process.pid] = subprocess.Popen(
        command, stdin=subprocess.PIPE, start_new_session=True, **_QUIET
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process, by force after five seconds, and its guard."""
    process.terminate()
    try:
        process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if watcher := _GUARDS.pop(process.pid, None):
        with watcher:
            watcher.kill()


def is_free(port: int) -> bool:
    """Return whether a port of this machine is free."""
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) != 0


def free_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _program() -> Path:
    """Return the viewer's binary; the command ``rerun`` is a script that starts it as its child."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun"):
            if (file := Path(folder, name)).is_file():
                return file
    raise CraneError(
        "Rerun's viewer is not installed; install it with: pip install --force-reinstall rerun-sdk"
    )
