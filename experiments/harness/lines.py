"""How far something long is where there is no terminal: a plain line on standard error now and
then.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field

EVERY = 10.0
"""Time between two lines, and before the first [s]: what is short says nothing."""


@dataclass
class Lines:
    """Says a line when it is time.

    Attributes:
        clock: The time [s].
        due: When the next line is.
    """

    clock: Callable[[], float] = time.monotonic
    due: float = field(default=-1.0)

    def __post_init__(self) -> None:
        """Count from now on."""
        self.due = self.clock() + EVERY

    def say(self, words: Callable[[], str]) -> None:
        """Print what the words are if it is time."""
        now = self.clock()
        if now >= self.due:
            self.due = now + EVERY
            print(words(), file=sys.stderr, flush=True)

    def run(self, name: str, duration: float) -> Callable[[float], None]:
        """A callback for `simulate`."""
        return lambda t: self.say(lambda: f"{name}: {t:.1f} of {duration:g} s")

    def count(self, name: str, total: int) -> Callable[[int], None]:
        """A callback for how many of several tasks are done."""
        return lambda done: self.say(lambda: f"{name}: {done} of {total}")
