"""Cases in a process of their own, so that one that crashes or hangs is a verdict, too."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from multiprocessing.connection import Connection
from typing import NamedTuple

from tests.system.fuzz.core import Verdict, drawn, judged
from tests.system.fuzz.generators import GENERATORS

_LONGEST = 60.0
"""Time in which a case must end on a machine with much else to do [s]."""

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["tests.system.fuzz.generators"])


class Tried(NamedTuple):
    """A case and its verdict."""

    name: str
    number: int
    verdict: Verdict

    def __str__(self) -> str:
        generator = GENERATORS[self.name]
        text = "\n".join(f"    | {line}" for line in self.verdict.text.strip().splitlines()[-6:])
        case = generator.shown(drawn(generator, self.number))
        return f"* {self.name}/{self.number}: {self.verdict.place}\n    {case}\n{text}"


def _judge(pipe: Connection, name: str, numbers: list[int]) -> None:
    os.setsid()  # Ctrl-C on the terminal is for the process that counts
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.enable()
    warnings.simplefilter("always")
    for number in numbers:
        pipe.send(judged(GENERATORS[name], drawn(GENERATORS[name], number)))


def tried(name: str, numbers: Iterable[int]) -> Iterator[Tried]:
    """Try cases of a generator in another process, and in a new one after each that kills it."""
    todo = deque(numbers)
    while todo:
        receiver, sender = _SERVER.Pipe(duplex=False)
        process = _SERVER.Process(target=_judge, args=(sender, name, list(todo)))
        process.start()
        sender.close()
        try:
            while todo and receiver.poll(_LONGEST):
                yield Tried(name, todo[0], receiver.recv())
                todo.popleft()
            if todo:
                place = f"does not end in {_LONGEST:g} s"
                yield Tried(name, todo.popleft(), Verdict("broken", place))
        except EOFError:
            process.join()
            place = f"killed by {signal.Signals(-(process.exitcode or 0)).name}"
            yield Tried(name, todo.popleft(), Verdict("broken", place))
        finally:
            process.kill()
            process.join()
            receiver.close()
