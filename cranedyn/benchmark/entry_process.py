"""The process in which an entry runs, and the conversation with it.

`EntryProcess` is the side of the benchmark: it starts the process and asks it for commands. The
other side is `main`, which the process runs. They talk in frames over two pipes; a frame is a
letter and the length of what follows, which is JSON or doubles. Nothing in them is run or
unpickled. The process sees readings, never the crane that moves.

Limits of processor time and memory are those of the operating system. They keep a faulty entry from
stopping the others; they are no jail for a hostile one, which may read files and the network.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cranedyn.benchmark.entry import Briefing, Declined, Entry, Opened, briefing_of
from cranedyn.benchmark.entry_files import EntryFiles, add_digests
from cranedyn.benchmark.entry_kinds import open_entry
from cranedyn.benchmark.entry_source import EntrySource
from cranedyn.benchmark.sensors import SensorReading, consecutive_slices
from cranedyn.benchmark.task import CraneTask, read_tasks
from cranedyn.data.files import parse_json
from cranedyn.errors import CraneError, format_error

_FRAME = struct.Struct("<cI")
"""Head of a frame: its letter and the length of what follows [byte]."""

# Letters of requests to the process.
_OPEN = b"O"
"""Open an entry."""

_BEGIN = b"B"
"""Begin an instance."""

_STEP = b"S"
"""Return a command for a reading."""

_FILES = b"F"
"""Return the digests of the files of the entry that were used so far."""

# Letters of its answers.
_READY = b"R"
"""It is done."""

_COMMAND = b"C"
"""The command, and the processor time that it took."""

_DECLINED = b"D"
"""The entry does not take part; a sentence says why."""

_ERROR = b"E"
"""The entry failed; a sentence says how."""

_LAST_WORDS = 5.0
"""Time for which a process that has closed its pipes may take to end [s]."""

_FAREWELL = 0.5
"""Time for which a process that is not needed any more may take to end [s]."""

_DOUBLE = 8
"""Size of a number in a frame [byte]."""

_MAX_FRAME = 1_000_000
"""Longest frame that is read [byte]."""


class EntryFailed(CraneError):
    """An entry that raised an error, ended, took too long, or returned what is no command."""


@dataclass(frozen=True)
class EntryLimits:
    """What an entry may use.

    Attributes:
        seconds: Processor time for an instance, that of making the controller included [s].
        megabytes: Address space of its process [MB].
    """

    seconds: float = 60.0
    megabytes: float = 4096.0

    @property
    def patience(self) -> float:
        """Time after which an instance is ended in any case, as of an entry that sleeps [s]: ten
        times the processor time, since other programs may use the processors, too.
        """
        return 10.0 * self.seconds


class EntryProcess:
    """An entry in a process of its own, which is started again after it has ended.

    One process serves all instances that it is given, of any tasks, so that an entry is loaded
    once, and may keep what it has designed for a nominal crane.

    Attributes:
        files: SHA-256 of the files of the entry that its processes have used, see
            `cranedyn.benchmark.entry_files`.
        changed: Names of files that were no longer the same when they were used again.
    """

    def __init__(self, source: EntrySource, limits: EntryLimits) -> None:
        """Name the entry; the process starts with the first instance.

        Args:
            source: The entry.
            limits: What it may use.
        """
        self.files: dict[str, str] = {}
        self.changed: set[str] = set()
        self._source = source
        self._limits = limits
        self._process: subprocess.Popen[bytes] | None = None
        self._timer: threading.Timer | None = None
        self._was_late = False

    def open(self) -> None:
        """Start the process and open the entry, if it does not run already.

        Raises:
            EntryFailed: If it cannot be opened.
        """
        if self._process is None:
            self._start()

    def begin(self, task: CraneTask) -> None:
        """Begin an instance of a task.

        Raises:
            Declined: If the entry does not take part in it.
            EntryFailed: If it cannot be opened or does not make a controller.
        """
        self.open()
        self._start_timer()
        file = str(task.file.resolve())
        letter, content = self._ask(_BEGIN, json.dumps([file, task.kind]).encode())
        if letter == _DECLINED:
            raise Declined(content.decode(errors="replace"))

    def command(self, reading: SensorReading) -> tuple[np.ndarray, float]:
        """Return the command for a reading, and the processor time that it took by the clock of the
        process [s]; NaN for a program elsewhere.

        Raises:
            EntryFailed: If there is none.
        """
        numbers = np.concatenate([[reading.t], *reading[1:]])
        letter, content = self._ask(_STEP, numbers.astype("<f8").tobytes())
        if letter == _DECLINED:
            raise EntryFailed(
                "It declined in the middle of an instance; decline where the controller is made."
            )
        if len(content) != _DOUBLE * (len(reading.position) + 1):
            # The process checks commands, too, but runs code of the entry.
            raise EntryFailed("Its process answered with what is no command.")
        answer = np.frombuffer(content, dtype="<f8")
        return answer[:-1], float(answer[-1])

    def end_instance(self) -> None:
        """Take down the files that an instance has used, and stop its clock."""
        if self._process is not None:
            with suppress(EntryFailed):
                self._take_files()
        self._stop_timer()

    def _take_files(self) -> None:
        """Ask the process for the files of the entry.

        Raises:
            EntryFailed: If it does not answer.
        """
        _, content = self._ask(_FILES, b"")
        try:
            files = parse_json(content)
        except (ValueError, RecursionError):
            files = None
        if not isinstance(files, dict) or not all(isinstance(sha, str) for sha in files.values()):
            # What answers runs code of the entry.
            raise EntryFailed("Its process answered with what is no list of files.")
        self.changed |= add_digests(self.files, files)

    def _stop_timer(self) -> None:
        """Stop the clock of an instance."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def close(self) -> None:
        """End the process."""
        self._stop_timer()
        process = self._process
        self._process = None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        # What is still in its buffer cannot be written any more.
        with suppress(OSError):
            process.stdin.close()
        # It ends by itself when it reads the end of the pipe, unless it still computes.
        with suppress(subprocess.TimeoutExpired):
            process.wait(_FAREWELL)
        process.kill()
        process.wait()
        process.stdout.close()

    def _start(self) -> None:
        """Start the process and open the entry.

        Raises:
            EntryFailed: If it cannot be opened.
        """
        self._was_late = False
        # Numerical libraries would start a thread for each processor, whose stacks count as memory.
        single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cranedyn.benchmark.entry_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **single},
        )
        self._start_timer()
        file = None if self._source.file is None else str(self._source.file.resolve())
        settings = [self._source.source, file, self._limits.seconds, self._limits.megabytes]
        try:
            self._ask(_OPEN, json.dumps(settings).encode())
        except EntryFailed:
            # A process without an entry serves no instance.
            self.close()
            raise

    def _start_timer(self) -> None:
        """Kill the process after the patience of the limits, counted from now on."""
        self._stop_timer()
        self._timer = threading.Timer(self._limits.patience, self._kill_late)
        self._timer.daemon = True
        self._timer.start()

    def _kill_late(self) -> None:
        self._was_late = True
        if self._process is not None:
            self._process.kill()

    def _ask(self, letter: bytes, content: bytes) -> tuple[bytes, bytes]:
        """Send a request and return letter and content of the answer.

        Raises:
            EntryFailed: If the answer is an error, or the process has ended.
        """
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        try:
            _write(process.stdin, letter, content)
            answer = _read(process.stdout)
        except OSError:
            # The process has closed its end of the pipe.
            answer = None
        if answer is None:
            raise self._ended()
        if answer[0] == _ERROR:
            raise EntryFailed(answer[1].decode(errors="replace"))
        return answer

    def _ended(self) -> EntryFailed:
        """Return the reason for which the process has ended."""
        assert self._process is not None
        # It ends by itself in most cases, and then says how. An entry may also have closed the
        # pipes and go on.
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LAST_WORDS)
        self._process.kill()
        code = self._process.wait()
        was_late = self._was_late
        self.close()
        if was_late:
            return EntryFailed(f"It gave no answer within {self._limits.patience:g} s.")
        if code == -signal.SIGXCPU:
            return EntryFailed(
                f"It took more than {self._limits.seconds:g} s of processor time for an instance."
            )
        if code < 0:
            # By a signal, as where a library in C reads beside its arrays.
            return EntryFailed(f"Its process was ended by {signal.Signals(-code).name}.")
        return EntryFailed(f"Its process ended with the exit code {code}.")


def check_opens(source: EntrySource, limits: EntryLimits) -> None:
    """Check that an entry can be opened in a process of its own, before all its instances fail.

    Raises:
        EntryFailed: If it cannot.
    """
    process = EntryProcess(source, limits)
    try:
        process.open()
    finally:
        process.close()


def _write(pipe: BinaryIO | Any, letter: bytes, content: bytes) -> None:
    """Write a frame."""
    pipe.write(_FRAME.pack(letter, len(content)) + content)
    pipe.flush()


def _read(pipe: BinaryIO | Any) -> tuple[bytes, bytes] | None:
    """Return letter and content of the next frame; None at the end of the pipe, or where something
    else than a frame was written into it.
    """
    head = pipe.read(_FRAME.size)
    if len(head) < _FRAME.size:
        return None
    letter, length = _FRAME.unpack(head)
    if length > _MAX_FRAME:
        return None
    content = pipe.read(length)
    return (letter, content) if len(content) == length else None


# --- in the process of the entry ------------------------------------------------------------------


class _Side:
    """The side of the process: an opened entry and the controller of the present instance."""

    def __init__(self) -> None:
        self._opened: Opened | None = None
        self._entry: Entry | None = None
        # What is told of tasks, by their file and kind: all instances of a task are told the same,
        # and an entry may keep what it has designed for it.
        self._briefings: dict[tuple[str, str], Briefing] = {}
        self._files: EntryFiles | None = None
        self._seconds = 0.0
        self._drives = 0
        # Where the numbers of a reading stand in a frame, see `SensorReading`.
        self._places: list[slice] = []

    def answer(self, letter: bytes, content: bytes) -> tuple[bytes, bytes]:
        """Return letter and content of the answer to a request."""
        try:
            if letter == _STEP:
                return _COMMAND, self._command(content)
            if letter == _FILES:
                files = {} if self._files is None else self._files.digests()
                return _READY, json.dumps(files).encode()
            if letter == _OPEN:
                self._open(*json.loads(content))
            else:
                self._begin(*json.loads(content))
        except Declined as declined:
            return _DECLINED, str(declined).encode()
        except MemoryError:
            return _ERROR, b"It needs more memory than it may use."
        except Exception as error:
            # The frames of the entry end a traceback, so that the line named is its own.
            return _ERROR, format_error(error).encode()
        return _READY, b""

    def _open(self, source: str, file: str | None, seconds: float, megabytes: float) -> None:
        self._seconds = seconds
        if file is not None:
            self._files = EntryFiles(Path(file))
        size = int(1e6 * megabytes)
        # macOS knows no limit of the address space.
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_AS, (size, size))
        self._limit_time()
        self._opened = open_entry(source)

    def _begin(self, file: str, kind: str) -> None:
        self._limit_time()
        if (file, kind) not in self._briefings:
            task = next(task for task in read_tasks(Path(file)) if task.kind == kind)
            self._briefings[file, kind] = briefing_of(task)
        briefing = self._briefings[file, kind]
        m = briefing.crane.layout.m
        s = len(briefing.crane.swings)
        self._drives = m
        # The time comes first.
        self._places = consecutive_slices([m, m, s, s, m], begin=1)
        assert self._opened is not None
        self._entry = self._opened(briefing)

    def _limit_time(self) -> None:
        """Let the system end this process after the processor time of an instance from now on."""
        used = resource.getrusage(resource.RUSAGE_SELF)
        spent = used.ru_utime + used.ru_stime
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        # The limit is a whole number of seconds.
        soft = int(np.ceil(spent + self._seconds))
        resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))

    def _command(self, content: bytes) -> bytes:
        numbers = np.frombuffer(content, dtype="<f8")
        parts = [numbers[place] for place in self._places]
        reading = SensorReading(float(numbers[0]), *parts)
        m = self._drives
        assert self._entry is not None
        begun = time.thread_time()
        command = self._entry(reading)
        taken = time.thread_time() - begun
        if not getattr(self._entry, "is_timed", True):
            taken = math.nan
        values = np.asarray(command, dtype=float)
        if values.shape != (m,):
            raise EntryFailed(
                f"It returned an array of shape {values.shape}; needed is ({m},), a rate for each "
                "drive."
            )
        if not np.isfinite(values).all():
            raise EntryFailed(f"It returned the rates {values.tolist()}; needed are finite ones.")
        return np.append(values, taken).astype("<f8").tobytes()


def main() -> int:
    """Answer requests until the other side closes the pipe."""
    # The benchmark is interrupted by Ctrl-C, which a terminal sends to all, and ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What an entry prints must not get among the answers: its standard output is standard error.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests = sys.stdin.buffer
    side = _Side()
    while True:
        request = _read(requests)
        if request is None:
            return 0
        _write(answers, *side.answer(*request))


if __name__ == "__main__":
    sys.exit(main())
