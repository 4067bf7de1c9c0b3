"""Cases in processes of their own, so that one that crashes, hangs or takes all memory is told of,
and the others go on.
"""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

from tests.system.fuzz.core import (
    BUDGET,
    PATIENCE,
    Case,
    Found,
    Verdict,
    drawn,
    judged,
    listed,
    place_in_dump,
    smallest,
)
from tests.system.fuzz.generators import GENERATORS

MEMORY = 2_500_000_000
"""Most memory that a process may have [byte]; with all that is imported it has some 0.4 GB."""

GRACE, BLOCKED = 3.0, 8.0
"""When a process is ended: processor time beyond that of an interruption [s], and time of sleep
with next to no processor time [s]."""

NATIVE = ("api simulate", "api batch", "loop Fleet", "loop TowerCraneVectorEnv")
"""Kinds that go deep into native code of ours."""

BELIEVED = ("file MCAP, bytes", "file MCAP, messages", "file bag, bytes")
"""Kinds whose parsers ask for as much memory as a damaged length says; as long as nobody writes
to it, the system gives none."""

_FAST = "/dev/shm"
"""A file system in memory, where there is one."""

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["tests.system.fuzz.generators"])


class Block(NamedTuple):
    """Cases of one generator, from one number up to, not including, another."""

    name: str
    first: int
    last: int


class Tried(NamedTuple):
    """A case that was tried; the input only where it breaks a promise."""

    name: str
    number: int
    verdict: Verdict
    case: Case | None


def _work(pipe: Connection, folder: Path) -> None:
    """What a process does: blocks of cases, and single inputs."""
    os.setsid()  # Ctrl-C on the terminal is for the process that counts
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with (folder / "log").open("w") as file, suppress(EOFError, OSError):
        faulthandler.enable(file)
        faulthandler.register(signal.SIGUSR1, file)
        warnings.simplefilter("always")
        while True:
            asked = pipe.recv()
            if isinstance(asked, Block):
                generator = GENERATORS[asked.name]
                _perturb(asked.name)
                for number in range(asked.first, asked.last):
                    case = drawn(generator, number)
                    verdict = judged(generator, case, folder)
                    pipe.send((number, verdict, case if verdict.place else None))
                    if number % 50 == 0:
                        gc.collect()
                pipe.send(None)
            else:
                name, case = asked
                _perturb(name)
                pipe.send(judged(GENERATORS[name], case, folder))


def _perturb(name: str) -> None:
    """Have memory that is read before it is written, or after it is freed, hold nonsense."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(-6, 0 if name in BELIEVED else 165)  # M_PERTURB


class Worker:
    """A process and what it is at."""

    def __init__(self) -> None:
        self._folder = Path(
            tempfile.mkdtemp(prefix="fuzz-", dir=_FAST if os.path.isdir(_FAST) else None)
        )
        self.pipe, theirs = _SERVER.Pipe()
        self.process = _SERVER.Process(target=_work, args=(theirs, self._folder))
        self.process.start()
        theirs.close()
        self.block: Block | None = None
        self._last = ""
        self._heard()

    def _heard(self) -> None:
        self._since, self._used = time.monotonic(), self._status()[1]

    def _status(self) -> tuple[str, float]:
        """Whether it sleeps, runs or waits for a disk, in a letter, and the processor time that it
        has had [s].
        """
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return "", 0.0
        return fields[0], (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _memory(self) -> int:
        try:
            return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf(
                "SC_PAGE_SIZE"
            )
        except (OSError, IndexError):
            return 0

    def fit_for(self, block: Block) -> Worker:
        """Itself, or one that is fresh: what native code has spoilt in cases of one kind is not to
        show in those of another.
        """
        if self._last in (block.name, "") or self._last not in NATIVE:
            return self
        self.close()
        return Worker()

    def submit(self, block: Block) -> None:
        """Begin a block."""
        self.block, self._last = block, block.name
        self.pipe.send(block)
        self._heard()

    def heard(self) -> Tried | None:
        """What it has to say; None when its block is done.

        Raises:
            EOFError: If it has died.
        """
        assert self.block is not None
        said = self.pipe.recv()
        self._heard()
        if said is None:
            self.block = None
            return None
        number, verdict, case = said
        self.block = self.block._replace(first=number + 1)
        return Tried(self.block.name, number, verdict, case)

    def trouble(self) -> str:
        """Why it must be ended; empty if it need not."""
        if self._memory() > MEMORY:
            return f"takes more than {MEMORY / 1e9:g} GB"
        letter, now = self._status()
        used, since = now - self._used, time.monotonic() - self._since
        if used > BUDGET + PATIENCE + GRACE:
            return f"Ctrl-C is not answered in {PATIENCE:g} s"
        if letter == "S" and since > BLOCKED and used < 0.02 * since:
            return f"blocks for {BLOCKED:g} s"
        return ""

    def ended(self, trouble: str = "") -> Verdict:
        """End it; the verdict on the case it was at."""
        if trouble and self.process.pid:
            with suppress(ProcessLookupError):
                os.kill(self.process.pid, signal.SIGUSR1)
            time.sleep(0.3)
        self.process.join(0.5 if not trouble else 0.0)
        dump = (self._folder / "log").read_text(errors="replace")
        self.close()
        number = self.process.exitcode or 0
        what = trouble or (
            f"killed by {signal.Signals(-number).name}" if number < 0 else f"exit({number})"
        )
        return Verdict("broken", f"{what} at {place_in_dump(dump)}", dump[:1500])

    def judge(self, name: str, case: Case) -> Verdict:
        """The verdict on one input."""
        self.pipe.send((name, case))
        self._heard()
        try:
            while not self.pipe.poll(0.2):
                if trouble := self.trouble():
                    return self.ended(trouble)
            return self.pipe.recv()
        except (EOFError, ConnectionError):
            return self.ended()

    def close(self) -> None:
        """End the process and all that it has started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid or 0, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        self.pipe.close()
        shutil.rmtree(self._folder, ignore_errors=True)


class Count:
    """What was tried and found.

    Attributes:
        tried: How many, by generator and how they ended.
        found: Broken promises by generator and place.
    """

    def __init__(self) -> None:
        self.tried: Counter[tuple[str, str]] = Counter()
        self.found: dict[tuple[str, str], Found] = {}

    def add(self, tried: Tried) -> bool:
        """Count a case; whether it breaks a promise that none did before."""
        self.tried[tried.name, tried.verdict.word] += 1
        if not tried.verdict.place:
            return False
        key = (tried.name, tried.verdict.place)
        if key in self.found:
            self.found[key].count += 1
            return False
        assert tried.case is not None
        self.found[key] = Found(tried.name, tried.number, tried.case, tried.verdict)
        return True

    def words(self, name: str) -> str:
        """How the cases of a generator ended."""
        ends = {word: count for (one, word), count in self.tried.items() if one == name}
        return (
            f"{sum(ends.values()):9,d}  "
            f"{', '.join(f'{word} {count:,}' for word, count in sorted(ends.items()))}"
        )


def blocks(counts: dict[str, int], seed: int, size: int = 100) -> list[Block]:
    """Cases in blocks, so mixed that every generator is as far as the others at any time."""
    made = [
        ((first + size) / count, Block(name, seed + first, seed + min(first + size, count)))
        for name, count in counts.items()
        for first in range(0, count, size)
    ]
    return [block for _, block in sorted(made)]


class Workers:
    """Some processes."""

    def __init__(self, count: int) -> None:
        self._idle = [Worker() for _ in range(count)]

    def run(
        self,
        todo: Iterable[Block],
        *,
        until: float = float("inf"),
        tell: Callable[[Count, Found | None], Any] = lambda *_: None,
    ) -> Count:
        """Try blocks of cases; when interrupted, return what was tried so far.

        Args:
            todo: The blocks.
            until: When to begin no further case, on the monotonic clock [s].
            tell: Called after every case with the count, and the promise if one was found broken.
        """
        queue, busy, count = deque(todo), list[Worker](), Count()
        idle = self._idle

        def note(tried: Tried) -> None:
            tell(count, count.found[tried.name, tried.verdict.place] if count.add(tried) else None)

        def lost(worker: Worker, trouble: str) -> None:
            block = worker.block
            assert block is not None
            note(
                Tried(
                    block.name,
                    block.first,
                    worker.ended(trouble),
                    drawn(GENERATORS[block.name], block.first),
                )
            )
            busy.remove(worker)
            idle.append(Worker())
            if block.first + 1 < block.last:
                queue.appendleft(block._replace(first=block.first + 1))

        try:
            while (queue and time.monotonic() < until) or busy:
                while idle and queue and time.monotonic() < until:
                    busy.append(worker := idle.pop().fit_for(queue[0]))
                    worker.submit(queue.popleft())
                ready = set(wait([worker.pipe for worker in busy], timeout=0.25))
                for worker in list(busy):
                    try:
                        if worker.pipe in ready:
                            if (tried := worker.heard()) is None:
                                busy.remove(worker)
                                idle.append(worker)
                            else:
                                note(tried)
                        elif trouble := worker.trouble():
                            lost(worker, trouble)
                    except (EOFError, ConnectionError):
                        lost(worker, "")
                if time.monotonic() > until and busy:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            for worker in busy:
                worker.close()
                idle.append(Worker())
        return count

    def shrink(self, found: Sequence[Found], seconds: float = 20.0) -> None:
        """Make the inputs of broken promises as small as can be found in some seconds each."""
        for one in found:
            end = time.monotonic() + seconds

            def fails(case: Case, one: Found = one, end: float = end) -> bool:
                return (
                    time.monotonic() < end and self.judge(one.name, case).place == one.verdict.place
                )

            one.case = smallest(one.case, fails)

    def judge(self, name: str, case: Case) -> Verdict:
        """The verdict on one input."""
        worker = self._idle.pop()
        verdict = worker.judge(name, case)
        self._idle.append(worker if not worker.pipe.closed else Worker())
        return verdict

    def close(self) -> None:
        """End all processes."""
        for worker in self._idle:
            worker.close()


def report(count: Count) -> str:
    """What was tried and found, as text."""
    names = sorted({name for name, _ in count.tried})
    found = sorted(count.found.values(), key=lambda one: (one.name, one.verdict.place))
    lines = [f"{name:24} {count.words(name)}" for name in names]
    lines.append(
        f"{'in all':24} {count.tried.total():9,d}  {len(found)} places where a promise is broken"
    )
    return "\n".join(lines) + "\n\n" + listed(found, GENERATORS)
