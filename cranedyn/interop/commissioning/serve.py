"""A plant on a clock, behind its servers and recorded: ``cranedyn serve``."""

from __future__ import annotations

import argparse
import asyncio
import atexit
import contextlib
import gc
import logging
import os
import sys
import tempfile
import threading
import time
from array import array
from collections.abc import Callable, Coroutine, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.checks import number
from cranedyn.command import command_line, defer_sigint, next_lines
from cranedyn.errors import CraneError, DataError, RunError
from cranedyn.export.target import check_new_folder, name_default_rates, new_folder
from cranedyn.interop.commissioning.security import Security
from cranedyn.interop.commissioning.served_crane import PERIOD, ServedCrane
from cranedyn.interop.commissioning.words import write_map
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options, crane_words
from cranedyn.recording import Run, record

PASSWORD_VARIABLE = "CRANEDYN_PASSWORD"
"""Environment variable of the password for OPC UA."""

LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")
"""Hosts that only programs on this machine reach."""

_LIBRARY_LOGGERS = ("asyncua", "pymodbus", "pymodbus.logging", "asyncio")
"""Loggers to which the servers of the libraries report what a client did wrong."""

_CLOSING_TIME = 0.3
"""Longest wait for a server that ends [s]. asyncua closes its connections at once, and then waits
up to 1 s for its own clock."""

_LONGEST_SLEEP = 0.1
"""Longest time between two looks for Ctrl-C [s]."""

_SWITCH_INTERVAL = 5e-4
"""Time after which Python hands over to another thread [s]: a tenth of a cycle."""

_MAX_DELAY = 1.0
"""Delay from which on a cycle is not made up for [s]."""

_EVENT_PERIOD = 0.1
"""Time between two looks for events to print [s]."""

_REALTIME_PRIORITY = 10
"""Real-time priority of the plant, 1 to 99; programs without one have less than 1."""

Address = tuple[str, int]
"""Host and port."""


def address(text: str) -> Address:
    """Return host and port from HOST:PORT.

    Raises:
        DataError: If the text has another form.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise DataError(f"{text!r} is not of the form HOST:PORT, with a port from 1 to 65535.")
    return host.strip("[]"), int(port)


def check_exposure(options: argparse.Namespace) -> Security | None:
    """Return what protects the OPC UA server that a command line asks for; None for no protection.

    Args:
        options: The options of `add_arguments`.

    Raises:
        CraneError: If other machines would reach an OPC UA server without protection, or a Modbus
            server that was not allowed in so many words, or if a part of the protection is missing.
    """
    password = os.environ.get(PASSWORD_VARIABLE)
    has_login = all((options.certificate, options.key, options.user, password))
    is_exposed = bool(options.opcua) and options.opcua[0] not in LOCAL_HOSTS
    # A password alone does not ask for protection: the variable may be set for other runs.
    is_asked_for = any((options.certificate, options.key, options.user, options.trust))
    is_complete = has_login and (options.trust or not is_exposed)
    if options.opcua and (is_exposed or is_asked_for) and not is_complete:
        raise CraneError(
            f"OPC UA at {options.opcua[0]} needs --certificate, --key, --user, --trust, and a "
            f"password in the environment variable {PASSWORD_VARIABLE}; a server for this machine "
            "alone goes without, or without --trust."
        )
    if options.modbus and options.modbus[0] not in LOCAL_HOSTS and not options.insecure_modbus:
        raise CraneError(
            f"Modbus has no security, so whoever reaches {options.modbus[0]} drives the crane; "
            "--insecure-modbus serves it there all the same."
        )
    if not has_login:
        return None
    return Security(options.certificate, options.key, options.user, password or "", options.trust)


class _ClientErrors(logging.Handler):
    """Counts what the libraries of the servers report, instead of printing their tracebacks.

    Python prints a report for which there is no handler, and this is one. A handler that somebody
    has set on the root logger still gets all reports.
    """

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count a report."""
        self.count += 1

    def __enter__(self) -> _ClientErrors:
        for name in _LIBRARY_LOGGERS:
            logging.getLogger(name).addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        for name in _LIBRARY_LOGGERS:
            logging.getLogger(name).removeHandler(self)


@contextlib.contextmanager
def servers(
    plant: ServedCrane,
    opcua: Address | None = None,
    modbus: Address | None = None,
    security: Security | None = None,
) -> Iterator[None]:
    """Serve a plant in a thread of its own while the context lasts, and print its events.

    At the end the number of errors of clients that the servers have reported is printed, if there
    were any.

    Args:
        plant: The plant.
        opcua: Host and port of OPC UA; None for none.
        modbus: Host and port of Modbus; None for none.
        security: What protects OPC UA; without it everybody gets in.

    Raises:
        CraneError: If a server cannot listen, or an extra is not installed.
    """
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    def start(work: Coroutine[Any, Any, Any]) -> Any:
        """Start a coroutine in the thread of the servers and return its future."""
        return asyncio.run_coroutine_threadsafe(work, loop)

    async def end_tasks() -> None:
        """Cancel all that still runs in the loop, and end the loop."""
        tasks = asyncio.all_tasks(loop) - {asyncio.current_task(loop)}
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=_CLOSING_TIME)
        loop.stop()

    def close(work: Coroutine[Any, Any, Any]) -> None:
        """Wait for the end of a server, `_CLOSING_TIME` at most."""
        # A client that never reads its answers must not keep the run from being recorded.
        with contextlib.suppress(TimeoutError):
            start(work).result(_CLOSING_TIME)

    with contextlib.ExitStack() as stack:
        # An exit stack calls back in the opposite order: the servers close, all tasks end, the
        # thread ends, and then the loop is closed.
        errors = stack.enter_context(_ClientErrors())
        stack.callback(loop.close)
        stack.callback(thread.join)
        stack.callback(lambda: start(end_tasks()))
        if opcua:
            # It needs the extra serve.
            from cranedyn.interop.commissioning.opcua import publish, serve_opcua

            server = start(serve_opcua(plant.image, *opcua, security)).result()
            stack.callback(lambda: close(server.stop()))
            stack.callback(start(publish(server, plant.image)).cancel)
            print(f"OPC UA at opc.tcp://{opcua[0]}:{opcua[1]}/", flush=True)
        if modbus:
            from cranedyn.interop.commissioning.modbus import serve_modbus

            registers = start(serve_modbus(plant.image, *modbus)).result()
            stack.callback(lambda: close(registers.shutdown()))
            print(f"Modbus TCP at {modbus[0]}:{modbus[1]}, which has no security", flush=True)
        start(_print_events(plant))
        yield
        if errors.count:
            print(
                f"Clients sent what the servers could not use; errors reported: {errors.count}.",
                flush=True,
            )


async def _print_events(plant: ServedCrane) -> None:
    """Print the events of a plant as they come, until cancelled."""
    printed = 0
    while True:
        for t, text in plant.events[printed:]:
            print(f"t = {t:.3f} s: {text}", flush=True)
            printed += 1
        await asyncio.sleep(_EVENT_PERIOD)


def keep_time(
    plant: ServedCrane,
    cycles: int,
    speed: float = 1.0,
    stopped: Callable[[], bool] = lambda: False,
) -> str:
    """Run a plant by the clock of this machine, and return a sentence on how the clock was kept.

    A late cycle is followed by the next one without a pause, until the plant has caught up. A delay
    of a second or more is not made up for.

    Args:
        plant: The plant.
        cycles: Number of cycles after which the run ends.
        speed: Speed of the plant's time over that of this machine.
        stopped: Function that returns whether to end before; Ctrl-C ends the run, too.

    Raises:
        RunError: If the model ceases to hold; it carries what was recorded.
    """
    period = PERIOD / speed
    # For each cycle the time from when it was due until it began, and until it was done [s]. Arrays
    # of C doubles hold an hour of cycles in 12 MB, and have no objects to collect.
    late = array("d")
    done = array("d")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.collect()
    # Garbage collections, which would delay cycles, then look only at what the servers make from
    # now on.
    gc.freeze()
    due = time.perf_counter()
    try:
        for _ in range(cycles):
            wait = due - time.perf_counter()
            while wait > 0.0 and not stopped():
                time.sleep(min(wait, _LONGEST_SLEEP))
                wait = due - time.perf_counter()
            if stopped():
                break
            if wait < -_MAX_DELAY:
                due -= wait  # now
            late.append(-wait)
            plant.cycle()
            done.append(time.perf_counter() - due)
            due += period
    except KeyboardInterrupt:
        # The cycle that was interrupted does not count.
        late = late[: len(done)]
    except RunError as error:
        error.trajectory = plant.trajectory()
        raise
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
    return _describe_timing(period, np.array(late or [0.0]), np.array(done or [0.0]), len(done))


def _describe_timing(period: float, late: np.ndarray, done: np.ndarray, cycles: int) -> str:
    """Return how a clock was kept, as a sentence.

    Args:
        period: Time between two cycles [s].
        late: Time from when each cycle was due until it began [s], shape (n,).
        done: Time from when each cycle was due until it was done [s], shape (n,).
        cycles: Number of cycles.
    """
    in_time = 100.0 * np.mean(done <= period)
    typical, worst = np.percentile(1e3 * late, [99.9, 100.0])
    return (
        f"{cycles} cycles of {1e3 * period:g} ms, {in_time:.2f} % of them finished in time; jitter "
        f"{worst:.2f} ms at most, {typical:.2f} ms in 99.9 %."
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the crane."""
    add = parser.add_argument
    where = "HOST:PORT"
    add("--opcua", type=address, metavar=where, help="serve OPC UA, such as 127.0.0.1:4840")
    add("--modbus", type=address, metavar=where, help="serve Modbus TCP, such as 127.0.0.1:5020")
    add("--map", type=Path, metavar="FILE.csv", help="write the words with nodes and registers")
    add("--speed", type=float, default=1.0, metavar="S", help="of time, 1 for real time")
    add("--duration", type=float, default=3600.0, metavar="T", help="longest run [s]")
    add("--realtime", action="store_true", help="with real-time priority, if the system grants it")
    add("--out", type=Path, metavar="DIR", help="new folder of the recording, default out/serve_…")
    text = "of the server; OPC UA beyond this machine needs it"
    add("--certificate", type=Path, metavar="FILE", help=text)
    add("--key", type=Path, metavar="FILE", help="private key of the certificate")
    text = "certificates of clients, or folders of them; only these get in"
    add("--trust", type=Path, nargs="+", metavar="PATH", help=text)
    add("--user", metavar="NAME", help=f"who may drive; the password is in {PASSWORD_VARIABLE}")
    text = "serve Modbus beyond this machine, where whoever reaches it drives the crane"
    add("--insecure-modbus", action="store_true", help=text)


def run(options: argparse.Namespace) -> int:
    """Serve the crane that the command line names, and return the exit code."""
    if not (options.opcua or options.modbus or options.map):
        raise DataError("There is nothing to serve; give --opcua, --modbus or --map.")
    number("speed", options.speed, "", "> 0")
    security = check_exposure(options)
    crane = crane_from_options(options)
    name_default_rates(crane)
    plant = ServedCrane(crane, duration=options.duration)
    if options.map:
        print(f"Written to {write_map(options.map, plant.image.words)}.")
    if not (options.opcua or options.modbus):
        words = crane_words(options)
        print(
            next_lines(
                command_line("cranedyn", "serve", "--opcua", "127.0.0.1:4840", *words),
                command_line("cranedyn", "serve", "--modbus", "127.0.0.1:5020", *words),
            )
        )
        return 0
    folder = options.out or Path(f"out/serve_{datetime.now():%Y%m%d_%H%M%S}")
    check_new_folder(folder)
    _try_recording(plant.crane)
    if options.realtime:
        _ask_for_priority()
    cycles = round(options.duration / PERIOD)
    # At its end Python searches all objects for cyclic garbage, which takes a second or more and
    # serves nothing, since the system takes back the memory anyway.
    atexit.register(gc.freeze)
    try:
        # Ctrl-C is the usual end of a run. It raises nothing here, so that a second one, while
        # connections are closed or files are written, loses nothing.
        with defer_sigint() as stopped:
            try:
                with servers(plant, options.opcua, options.modbus, security):
                    print("Ctrl-C ends the run and records it.", flush=True)
                    print(keep_time(plant, cycles, options.speed, stopped), flush=True)
            finally:
                if plant.cycles:
                    _save(folder, plant)
    except KeyboardInterrupt:
        # Ctrl-C came while the servers were started, and nothing was run.
        if not plant.cycles:
            raise
    return 0


def _ask_for_priority() -> None:
    """Give this thread, and those that it starts, real-time priority.

    Raises:
        CraneError: If the system does not grant it.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_REALTIME_PRIORITY))
    except (AttributeError, OSError) as error:
        text = f"This system grants no real-time priority ({error}); leave out --realtime."
        raise CraneError(text) from error


def _try_recording(crane: Crane) -> None:
    """Record one cycle of a crane into a temporary folder, before anything is served.

    So an error of recording is seen now instead of after an hour. And all that Python loads for it,
    such as the expanded description of the crane, is loaded when Ctrl-C ends the run.
    """
    trial = ServedCrane(crane, duration=PERIOD)
    trial.cycle()
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), trial)


def _save(folder: Path, plant: ServedCrane) -> None:
    """Write the run of a plant into a new folder."""
    with new_folder(folder) as draft:
        _write(draft, plant)
    print(f"Written to {folder}.")
    view = command_line("cranedyn", "view", folder / "serve.rrd")
    identify = command_line("cranedyn", "run", "identify", folder / "serve.parquet")
    print(next_lines(view, identify), flush=True)


def _write(folder: Path, plant: ServedCrane) -> None:
    """Write the run of a plant as Parquet and as a recording."""
    trajectory = plant.trajectory()
    runs = [Run("served", plant.crane, trajectory)]
    text = "\n".join(f"* t = {t:.3f} s: {event}" for t, event in plant.events)
    trajectory.write(folder / "serve.parquet")
    record(folder / "serve.rrd", runs, title="Virtual commissioning", text=text)
