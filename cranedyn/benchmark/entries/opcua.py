"""Entries that are programs of their own, which read and write variables by OPC UA.

The server is in the process of the entry and listens on this machine only. In namespace 2 it has
the object Benchmark with the variables ``Benchmark.NAME`` of `NODES`. It waits for the program at
each control period, however long that takes, so that a result does not depend on the load of the
machine:

1. For each instance it writes `Briefing`, and then a new number into `Instance`. The program writes
   that number into `Ready`, or a sentence into `Declined`.
2. In each control period it writes what is measured, and then a new number into `Cycle`. The
   program writes the rates of the drives into `Command`, and that number into `Answered`. Both may
   be written by one request, in this order.

A program that is named by ``opcua:PROGRAM`` is started for each instance, with the address as its
only argument, and ended behind it. One that the user starts, at ``opc.tcp://127.0.0.1:PORT``, sees
all instances one after another.
"""

from __future__ import annotations

import asyncio
import atexit
import json
import logging
import resource
import subprocess
import sys
import threading
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from cranedyn.benchmark.entries.plain_briefing import plain_briefing
from cranedyn.benchmark.entries.targets import Target, Targets
from cranedyn.benchmark.entry import Briefing, Declined, Entry, Opened
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, format_error
from cranedyn.interop.commissioning.opcua import listen, new_server
from cranedyn.interop.commissioning.words import NAMESPACE
from cranedyn.recording.process import free_port
from cranedyn.sweep.workers import kill_with_parent

try:
    from asyncua import ua
except ModuleNotFoundError as error:
    raise CraneError(
        "OPC UA needs asyncua, which is not installed: pip install 'cranedyn[serve]'."
    ) from error

HOST = "127.0.0.1"
"""Where the server listens."""

NODES: dict[str, tuple[str, str]] = {
    "Briefing": (
        "String",
        "what is told of an instance, in JSON with the names of crane_briefing",
    ),
    "Instance": ("Int64", "number of the instance, written after its briefing"),
    "Time": ("Double", "time since the start [s]"),
    "Position": ("Double[]", "measured positions of the drives [rad or m]"),
    "Rate": ("Double[]", "their measured rates"),
    "Swing": ("Double[]", "measured swing angles [rad]"),
    "SwingRate": ("Double[]", "their measured rates [rad/s]"),
    "Operator": ("Double[]", "rates that the operator asks for"),
    "Target": ("Double[]", "where the drives shall be now [rad or m]"),
    "TargetRate": ("Double[]", "rates of these positions"),
    "Cycle": ("Int64", "number of the reading, written after it"),
    "Ready": ("Int64", "by the program: the instance that it takes part in"),
    "Declined": ("String", "by the program: why it does not take part"),
    "Command": ("Double[]", "by the program: rates of the drives"),
    "Answered": ("Int64", "by the program: the cycle that the command is for"),
}
"""Type and meaning of each variable, in the order in which they are written."""

WRITABLE = ("Ready", "Declined", "Command", "Answered")
"""Variables that the program writes."""

_TYPES = {
    "String": ua.VariantType.String,
    "Int64": ua.VariantType.Int64,
    "Double": ua.VariantType.Double,
    "Double[]": ua.VariantType.Double,
}
"""Types of OPC UA by their names in `NODES`."""

_LOOK_PERIOD = 0.1
"""Time after which it is looked whether a program still runs [s]."""


def open_source(source: str) -> Opened:
    """Start the server for a program.

    Raises:
        CraneError: If it cannot listen.
    """
    # What a client does wrong is told to the client.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    program = None
    scheme, _, name = source.partition(":")
    if scheme == "opcua":
        program = Path(name).resolve()
        port = free_port()
    else:
        port = urlsplit(source).port or 0
    conversation = _Conversation(port, program)
    # Before the server ends, about which the program would complain.
    atexit.register(conversation.end_program)

    def make(briefing: Briefing) -> Entry:
        conversation.begin(briefing)
        return _ProgramEntry(conversation, Targets(briefing))

    return make


def _started(program: Path, url: str) -> subprocess.Popen[bytes]:
    """Start a program with the address of the server as its argument.

    It may take the processor time of an instance, and ends with this process.

    Raises:
        CraneError: If it cannot be started.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
    left = soft
    if soft != resource.RLIM_INFINITY:
        left = int(np.ceil(soft - used.ru_utime - used.ru_stime))

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (left, hard))
        kill_with_parent()

    command = [str(program), url]
    if program.suffix == ".py":
        command.insert(0, sys.executable)
    try:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=limit)
    except OSError as error:
        raise CraneError(f"{program} cannot be started: {format_error(error)}") from error


class _ProgramEntry:
    """A program in an instance.

    Attributes:
        is_timed: False, since its processor time is not known.
    """

    is_timed = False

    def __init__(self, conversation: _Conversation, targets: Targets) -> None:
        self._conversation = conversation
        self._targets = targets

    def __call__(self, reading: SensorReading) -> np.ndarray:
        """Return the rates for a reading."""
        return self._conversation.command(reading, self._targets(reading))


class _Conversation:
    """The server, in a thread of its own, the program, and what both have written.

    Attributes:
        url: Its address.
    """

    def __init__(self, port: int, program: Path | None) -> None:
        """Start the server.

        Args:
            port: Port at which it listens.
            program: File of the program that is started for each instance; None for one that the
                user starts.

        Raises:
            CraneError: If it cannot listen.
        """
        self.url = f"opc.tcp://{HOST}:{port}"
        self._program = program
        self._running: subprocess.Popen[bytes] | None = None
        self._instance = 0
        self._cycle = 0
        # What the program has written last.
        self._written: dict[str, Any] = {"Ready": 0, "Declined": "", "Command": [], "Answered": 0}
        self._has_written = threading.Event()
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self._await(self._serve(port))

    def begin(self, briefing: Briefing) -> None:
        """Start the program, tell it of an instance, and wait until it is ready.

        Raises:
            Declined: If it does not take part.
            CraneError: If it cannot be started, or has ended.
        """
        self.end_program()
        if self._program is not None:
            self._running = _started(self._program, self.url)
        self._instance += 1
        self._written["Declined"] = ""
        told = json.dumps(asdict(plain_briefing(briefing)))
        self._await(self._write({"Briefing": told, "Instance": self._instance}))
        self._wait(lambda: self._written["Ready"] == self._instance)

    def end_program(self) -> None:
        """End the program of the instance before, if one was started."""
        if self._running is not None:
            self._running.kill()
            self._running.wait()
            self._running = None

    def command(self, reading: SensorReading, target: Target) -> np.ndarray:
        """Return the command of the program for a reading.

        Raises:
            CraneError: If it has ended.
        """
        self._cycle += 1
        values: dict[str, Any] = {"Time": reading.t}
        names = ("Position", "Rate", "Swing", "SwingRate", "Operator", "Target", "TargetRate")
        for name, numbers in zip(names, (*reading[1:], *target), strict=True):
            values[name] = numbers.tolist()
        values["Cycle"] = self._cycle
        self._await(self._write(values))
        self._wait(lambda: self._written["Answered"] == self._cycle)
        return np.array(self._written["Command"], dtype=float)

    def _wait(self, is_done: Callable[[], bool]) -> None:
        """Wait until the program has written what is asked for.

        Raises:
            Declined: If it declines instead.
            CraneError: If it has ended.
        """
        while not is_done():
            if self._written["Declined"]:
                raise Declined(str(self._written["Declined"]))
            if self._running is not None and self._running.poll() is not None:
                code = self._running.returncode
                raise CraneError(f"The program ended with the exit code {code}.")
            self._has_written.wait(_LOOK_PERIOD)
            self._has_written.clear()

    def _await(self, work: Coroutine[Any, Any, None]) -> None:
        """Let the thread of the server do something, and wait for it."""
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _serve(self, port: int) -> None:
        """Start the server with all its variables."""
        self._server = await new_server(HOST, port)
        parent = await self._server.nodes.objects.add_object(
            f"ns={NAMESPACE};s=Benchmark", f"{NAMESPACE}:Benchmark"
        )
        for name, (kind, about) in NODES.items():
            first: Any = {"String": "", "Int64": 0, "Double": 0.0, "Double[]": [0.0]}[kind]
            node = await parent.add_variable(
                f"ns={NAMESPACE};s=Benchmark.{name}",
                f"{NAMESPACE}:{name}",
                ua.Variant(first, _TYPES[kind]),
            )
            text = ua.Variant(ua.LocalizedText(about))
            await node.write_attribute(ua.AttributeIds.Description, ua.DataValue(text))
            if name in WRITABLE:
                await node.set_writable()
                self._server.set_attribute_value_setter(node.nodeid, self._setter(name, kind))
        await listen(self._server, HOST, port)

    def _setter(self, name: str, kind: str) -> Any:
        """Return what is called where the program writes a variable."""

        def write(data: Any, attribute: Any, value: ua.DataValue) -> None:
            variant = value.Value
            is_list = variant is not None and isinstance(variant.Value, list)
            if variant is None or variant.VariantType != _TYPES[kind]:
                raise ua.UaStatusCodeError(ua.StatusCodes.BadTypeMismatch)
            if is_list != kind.endswith("[]"):
                raise ua.UaStatusCodeError(ua.StatusCodes.BadTypeMismatch)
            self._written[name] = variant.Value
            self._has_written.set()

        return write

    async def _write(self, values: dict[str, Any]) -> None:
        """Write variables in their order; the number behind which others stand comes last."""
        for name, value in values.items():
            node = ua.NodeId.from_string(f"ns={NAMESPACE};s=Benchmark.{name}")
            data = ua.DataValue(ua.Variant(value, _TYPES[NODES[name][0]]))
            await self._server.write_attribute_value(node, data)
