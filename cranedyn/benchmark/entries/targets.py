"""Where the drives shall be at each time, as far as a task says: the same numbers for all kinds of
entries that have no `Briefing`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cranedyn.benchmark.entry import Briefing
from cranedyn.benchmark.sensors import SensorReading


class Target(NamedTuple):
    """Where the drives shall be now.

    Attributes:
        position: Positions [rad or m], shape (m,).
        rate: Their rates [rad/s or m/s], shape (m,).
    """

    position: np.ndarray
    rate: np.ndarray


class Targets:
    """The targets of an instance: the goal from the beginning on, the present point of a path, the
    start in wind, and under an operator where the drives were sent so far.
    """

    def __init__(self, briefing: Briefing) -> None:
        """Take what is told of an instance."""
        drives = briefing.crane.layout.drives
        self._briefing = briefing
        self._sent = briefing.start.q[drives].copy()
        self._rate = np.zeros(len(drives))
        self._goal = None if briefing.goal is None else briefing.goal.q[drives]

    def __call__(self, reading: SensorReading) -> Target:
        """Return the target at a reading; to be called once for each one, in their order."""
        if self._briefing.path is not None:
            setpoint = self._briefing.path(reading.t)
            return Target(np.array(setpoint.position), np.array(setpoint.velocity))
        if self._goal is not None:
            return Target(self._goal, np.zeros_like(self._goal))
        self._sent = self._sent + self._briefing.period * self._rate
        self._rate = reading.operator
        return Target(self._sent, self._rate)
