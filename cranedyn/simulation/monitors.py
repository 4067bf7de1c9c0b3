"""Monitors of a run.

A monitor is called after each row is logged, with the index of the row, its time [s] and its
state. Where an engine logs rows ahead of the loop, it is called for the last of them. It ends the
run by an error; the run keeps what was logged.
"""

from __future__ import annotations

from collections.abc import Callable

from cranedyn.errors import RunError
from cranedyn.interfaces import State, Validity
from cranedyn.simulation.log import Log

Monitor = Callable[[int, float, State], object]

_ROWS = 1000
"""Rows that are checked at once."""


class ValidityMonitor:
    """Stops a run where the model ceases to hold, unless rows are only to be marked."""

    def __init__(self, log: Log, validity: Validity) -> None:
        self._log, self._validity, self._next = log, validity, 0

    def __call__(self, row: int, t: float, state: State) -> None:
        """Check the log once in a while."""
        if row >= self._next:
            self._next = row + _ROWS
            self.check()

    def check(self) -> None:
        """Check the rows that are not checked yet.

        Raises:
            RunError: If the model does not hold at one of them, which is then the last of the log.
        """
        if self._validity == "mark":
            return
        event = self._log.next_event()
        if event is not None:
            t = self._log.truncate(event.row)
            hint = "" if self._validity == "buffers" else "; validity = mark goes on all the same"
            raise RunError(
                f"At t = {t:.4g} s {event.words}{hint}.", t=t, joint=event.joint, value=event.value
            )
