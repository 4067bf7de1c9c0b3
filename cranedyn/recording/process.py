"""The process of Rerun's viewer and the ports it takes.

Rerun 0.41 starts viewers itself, by `rerun.spawn`, `rerun.serve_grpc`, `rerun.serve_web_viewer` and
`rerun.experimental.ViewerClient.spawn`. Four things would be lost with them:

* They listen on all interfaces, so that every machine of the network can read what is served, and
  add to it. Only the command line has an option ``--bind``.
* They send analytics, unless the user has switched them off for all programs.
* They leave the viewer behind when this program is killed. `guard` does not.
* They give no choice of the graphics driver for a headless viewer, see `_viewer_environment`.
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

from cranedyn.errors import CraneError

HOST = "127.0.0.1"
"""The only interface that viewers listen on."""

_START_SECONDS = 30.0
"""Longest wait for the ports of a viewer to answer [s]."""

_POLLING_PERIOD = 0.05
"""Time between two looks at the ports [s]."""

_END_SECONDS = 5.0
"""Time that a process has to end itself before it is killed [s]."""

_VULKAN_DRIVERS = Path("/usr/share/vulkan/icd.d")
"""Folder in which Linux lists the Vulkan drivers."""

_DRIVER_VARIABLES = ("VK_ICD_FILENAMES", "VK_DRIVER_FILES")
"""Environment variables by which users choose a Vulkan driver."""

_BINARIES = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
"""Files of the viewer in the package rerun_cli, by the system: Linux, Windows, macOS."""

_GUARD = "import os, sys; sys.stdin.read(); os.kill(int(sys.argv[1]), 9)"
"""Programme of a guard: it waits for the end of its input, then kills the process of an id."""

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
    command = [str(_program()), "--bind", HOST, *arguments]
    try:
        process = subprocess.Popen(
            command,
            env=_viewer_environment(headless="--headless" in arguments),
            start_new_session=detached,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError as error:
        raise CraneError(f"Rerun's viewer cannot be started: {error.strerror}.") from error
    try:
        if not detached:
            guard(process)
        _await_ports(process, ports, hint)
    except BaseException:
        # Also after Ctrl-C.
        end(process)
        raise
    return process


def _viewer_environment(*, headless: bool) -> dict[str, str]:
    """Return the environment of a viewer: no analytics and, without a window, Mesa's processor
    renderer where it is installed and the user has chosen no other driver.
    """
    # Rerun sends no analytics where CI is set, whatever the user's own setting, which stays.
    environment = {"RUST_LOG": "error", **os.environ, "CI": "true"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    has_chosen_driver = any(name in environment for name in _DRIVER_VARIABLES)
    if headless and not has_chosen_driver:
        drivers = sorted(_VULKAN_DRIVERS.glob("lvp_icd.*.json"))
        if drivers:
            environment["VK_ICD_FILENAMES"] = str(drivers[0])
    return environment


def _await_ports(process: subprocess.Popen[bytes], ports: Sequence[int], hint: str) -> None:
    """Return when a viewer answers at all of its ports.

    Raises:
        CraneError: If it ends before, or takes more than half a minute.
    """
    deadline = time.monotonic() + _START_SECONDS
    while any(is_free(port) for port in ports):
        if process.poll() is not None:
            code = process.returncode
            raise CraneError(f"Rerun's viewer ended with exit code {code}. {hint}")
        if time.monotonic() > deadline:
            raise CraneError(f"Rerun's viewer did not start in {_START_SECONDS:g} s. {hint}")
        time.sleep(_POLLING_PERIOD)


def guard(process: subprocess.Popen[bytes]) -> None:
    """Have a process killed when this program ends, even by a kill.

    A small process waits for the end of a pipe that this program holds open: the system closes it
    however the program ends. `end` ends that process, too.
    """
    # Isolated and without site packages, Python starts fast and runs nothing of the user's.
    command = [sys.executable, "-I", "-S", "-c", _GUARD, str(process.pid)]
    # In a session of its own, a Ctrl-C at the terminal does not end it before its work.
    _GUARDS[process.pid] = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process, by force after five seconds, and its guard."""
    process.terminate()
    try:
        process.wait(timeout=_END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    watcher = _GUARDS.pop(process.pid, None)
    if watcher is not None:
        with watcher:
            watcher.kill()


def is_free(port: int) -> bool:
    """Return whether nobody answers at a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) != 0


def free_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _program() -> Path:
    """Return the viewer's binary.

    The command ``rerun`` and ``python -m rerun_cli`` are scripts that start it as their child and
    wait: to end the script would leave the viewer running.

    Raises:
        CraneError: If it is not installed.
    """
    spec = importlib.util.find_spec("rerun_cli")
    folders = spec.submodule_search_locations if spec is not None else None
    for folder in folders or []:
        for name in _BINARIES:
            file = Path(folder, name)
            if file.is_file():
                return file
    raise CraneError(
        "Rerun's viewer is not installed; install it with: pip install --force-reinstall rerun-sdk"
    )
