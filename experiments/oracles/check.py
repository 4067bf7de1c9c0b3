"""What an oracle is, and how a run is held against it: by halving the step, so that the step's own
error is known and taken off.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane

G, MASS = 9.81, 1000.0
"""Gravity [m/s²] and mass of the load [kg] of all oracles."""

STEP = 0.02
"""The coarsest step [s]; every time at which something happens is a multiple of its control
period."""

ROUNDING = 1e-11
"""What sums of some 10⁵ steps lose of a number of size 1, and of what is read between two rows by
polynomials."""

SURE = 1e-5
"""How much an extrapolation may be unsure of a number of size 1; more means that the runs have no
limit."""

Build = Callable[..., Crane]
"""Makes a crane from numbers of its xacro file."""

POINT = {"payload_inertia": 0, "dummy_mass": 0, "dummy_inertia": 0, "damp_swing": 0}
"""A point load on a massless rope without friction."""

LARGE = {
    "slewing_inertia": 2e5,
    "trolley_min": 0,
    "trolley_max": 52,
    "hoist_max": 48,
    "mast_height": 50,
    "pivot_height": 52,
    "total_height": 58,
}
"""Strategies as long as those of a real crane, on a structure that is light enough for the load to
turn it."""


@cache
def point_crane(**values: object) -> Crane:
    """Return a large crane with a point load, in the gravity of the oracles; loaded once."""
    return load_crane(gravity=G, **{**POINT, **LARGE, **values})  # type: ignore[arg-type]


@dataclass(frozen=True)
class Oracle:
    """A number that mechanics knows, and how to read it off a run.

    Attributes:
        name: What it is.
        unit: Its unit, empty for a pure number.
        closed: Its value in closed form.
        read: The same from a run with a given step [s].
        beyond: How far the two may differ for other reasons than the step.
        why: What these are, in a few words.
    """

    name: str
    unit: str
    closed: float
    read: Callable[[float], float]
    beyond: float = 0.0
    why: str = ""


@dataclass(frozen=True)
class OracleCheck:
    """An oracle and its runs.

    Attributes:
        oracle: The oracle.
        steps: Steps of the runs [s], each half of the one before.
        values: What was read off them.
    """

    oracle: Oracle
    steps: Sequence[float]
    values: Sequence[float]

    @property
    def error(self) -> float:
        """Of the run with the finest step."""
        return self.values[-1] - self.oracle.closed

    @property
    def limit(self) -> float:
        """The value for a vanishing step: Richardson's extrapolation, which takes off one power of
        the step after the other.
        """
        return _richardson(self.values)[-1]

    @property
    def of_step(self) -> float:
        """The part of the error that the runs themselves put down to the step."""
        return self.values[-1] - self.limit

    @property
    def rest(self) -> float:
        """Error of the limit."""
        return self.limit - self.oracle.closed

    @property
    def unsure(self) -> float:
        """What the last power of the step that was taken off still changed, a bound for what those
        beyond it would.
        """
        last, limit = _richardson(self.values)[-2:]
        return abs(limit - last)

    @property
    def allowed(self) -> float:
        """For the rest: what the extrapolation is unsure of, rounding, and what the oracle itself
        leaves out.
        """
        return self.unsure + ROUNDING * self.size + self.oracle.beyond

    @property
    def size(self) -> float:
        """Of the number itself, 1 at least."""
        return max(1.0, abs(self.oracle.closed))

    @property
    def order(self) -> float | None:
        """Power of the step with which the error falls, for a vanishing step; None where too little
        of it is the step's to tell.
        """
        errors = [abs(value - self.oracle.closed) for value in self.values[-3:]]
        if errors[-1] < 100.0 * self.allowed:
            return None
        coarse, fine = (
            math.log2(coarse_error / half) for coarse_error, half in itertools.pairwise(errors)
        )
        return 2.0 * fine - coarse

    @property
    def holds(self) -> bool:
        """Whether there is a limit, and it is the closed form."""
        return self.unsure <= SURE * self.size and abs(self.rest) <= self.allowed


def _richardson(values: Sequence[float]) -> list[float]:
    """Return Richardson extrapolations of values at steps h, h/2, h/4, ..., by rising power."""
    row, best = list(values), [values[-1]]
    for power in range(1, len(values)):
        row = [
            fine + (fine - coarse) / (2.0**power - 1.0) for coarse, fine in itertools.pairwise(row)
        ]
        best.append(row[-1])
    return best


def check_oracle(oracle: Oracle, halvings: int) -> OracleCheck:
    """Run an oracle with the coarsest step, half of it, and so on."""
    steps = [STEP / 2**k for k in range(halvings + 1)]
    return OracleCheck(oracle, steps, [oracle.read(dt) for dt in steps])
