"""Numbers that mechanics knows in closed form, and how a run is judged by them.

An *oracle* is such a number, with a function that reads the same number off a run with a given
step. It is read at steps of which each is half of the one before. Richardson's extrapolation then
tells the value for a vanishing step, so that the error of the step itself is known and taken off;
what is left has to be explained by rounding or by the oracle itself.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

STEP = 0.02
"""The coarsest step [s].

Every time at which something happens in a run is a multiple of the control period at this step, so
that at all steps it happens at the same time.
"""

ROUNDING = 1e-11
"""Rounding error of a number of size 1 that is the sum of some 10⁵ steps, or that a polynomial
reads between two rows."""

SMALL_SCALE = 1e-4
"""Factor by which motions are scaled down in runs whose closed form holds for small angles.

The relative error of such a form is about the square of the angle.
"""

FINITE_SWING = "finite swing"
"""The reason that is stated for this error, see `Oracle.reason`."""

MAX_UNCERTAINTY = 1e-5
"""Largest uncertainty of an extrapolation to a number of size 1; with more, runs have no limit."""


class Oracle(NamedTuple):
    """A number that mechanics knows, and how to read it off a run.

    Attributes:
        name: What the number is.
        unit: Unit of the number, empty for a pure number.
        closed: Value in closed form.
        read: Function that takes a step [s] and returns the value that a run with it has.
        tolerance: Largest difference between the two for other reasons than the step, such as a
            closed form that holds for small angles only.
        reason: These reasons, in a few words.
    """

    name: str
    unit: str
    closed: float
    read: Callable[[float], float]
    tolerance: float = 0.0
    reason: str = ""


class OracleCheck(NamedTuple):
    """An oracle and its runs.

    Attributes:
        oracle: The oracle.
        steps: Steps of the runs [s], each half of the one before.
        values: What was read off each.
    """

    oracle: Oracle
    steps: Sequence[float]
    values: Sequence[float]

    @property
    def error(self) -> float:
        """Error of the run with the finest step."""
        return self.values[-1] - self.oracle.closed

    @property
    def limit(self) -> float:
        """Value for a vanishing step, by Richardson's extrapolation, which takes off one power of
        the step after the other.
        """
        return _richardson(self.values)[-1]

    @property
    def step_error(self) -> float:
        """Part of the error that vanishes with the step, as the runs themselves tell."""
        return self.values[-1] - self.limit

    @property
    def remainder(self) -> float:
        """Error that is left for a vanishing step."""
        return self.limit - self.oracle.closed

    @property
    def uncertainty(self) -> float:
        """Uncertainty of the limit: what taking off the last power of the step changed, which
        bounds what the powers beyond it would change.
        """
        last, limit = _richardson(self.values)[-2:]
        return abs(limit - last)

    @property
    def allowed(self) -> float:
        """Largest allowed `remainder`: the uncertainty of the extrapolation, rounding, and what the
        oracle itself leaves out.
        """
        return (
            self.uncertainty + ROUNDING * max(1.0, abs(self.oracle.closed)) + self.oracle.tolerance
        )

    @property
    def order(self) -> float | None:
        """Power of the step with which the error falls, for a vanishing step.

        None where the error is less than a hundred times what it may be for other reasons: then too
        little of it is the step's.
        """
        errors = [abs(value - self.oracle.closed) for value in self.values[-3:]]
        if errors[-1] < 100.0 * self.allowed:
            return None
        # An error c h^p falls by 2^p with each halving of h. The next power of the step makes an
        # error of the order that halves as well: extrapolation takes it off.
        coarse = math.log2(errors[0] / errors[1])
        fine = math.log2(errors[1] / errors[2])
        return 2.0 * fine - coarse

    @property
    def holds(self) -> bool:
        """Whether the runs have a limit, and it is the closed form."""
        size = max(1.0, abs(self.oracle.closed))
        return self.uncertainty <= MAX_UNCERTAINTY * size and abs(self.remainder) <= self.allowed


def _richardson(values: Sequence[float]) -> list[float]:
    """Return Richardson extrapolations of values at steps h, h/2, h/4, ...

    The first has no power of the step taken off, the next h, the next h and h², and so on.
    """
    row = list(values)
    best = [values[-1]]
    for power in range(1, len(values)):
        # The error c h^p of the coarse value is 2^p times that of the fine one.
        pairs = itertools.pairwise(row)
        row = [fine + (fine - coarse) / (2.0**power - 1.0) for coarse, fine in pairs]
        best.append(row[-1])
    return best


def check_oracle(oracle: Oracle, halvings: int) -> OracleCheck:
    """Read an oracle off runs with the step `STEP`, half of it, and so on.

    Args:
        oracle: The oracle.
        halvings: Number of times the step is halved.
    """
    steps = [STEP / 2**k for k in range(halvings + 1)]
    return OracleCheck(oracle, steps, [oracle.read(dt) for dt in steps])
