"""Closed forms beside runs of the plant.

An *oracle* is a number that mechanics knows in closed form, and a function that reads it off a run
with a given step. It is read at steps of which each is half of the one before. Richardson's
extrapolation then tells the value for a vanishing step, so that the error of the step itself is
known and taken off; what is left has to be explained by rounding or by the oracle itself.

This module makes the runs, reads them between their rows, and compares.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq

from cranedyn.controllers import Hold, follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.interfaces import Controller, EngineName, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.relatives.catalogue import POINT

G = 9.81
"""Gravity of all oracles [m/s²]."""

MASS = 1000.0
"""Mass of the load of all oracles [kg]."""

STEP = 0.02
"""The coarsest step [s].

Every time at which something happens in a run is a multiple of the control period at this step, so
that at all steps it happens at the same time.
"""

ROUNDING = 1e-11
"""Rounding error of a number of size 1 that is the sum of some 10⁵ steps, or that a polynomial
reads between two rows."""

SMALL = 1e-4
"""Factor by which motions are scaled down in runs whose closed form holds for small angles.

The relative error of such a form is about the square of the angle.
"""

FINITE = "finite swing"
"""The reason that is stated for this error, see `Oracle.why`."""

SURE = 1e-5
"""Largest uncertainty of an extrapolation to a number of size 1; with more, runs have no limit."""

EVERY = 5
"""Physics steps in a control period."""

SELDOM = 50
"""The same where nothing is commanded and only the end of a run is read."""

Build = Callable[..., Crane]
"""Makes a crane from numbers of its xacro file."""

LARGE = {
    "slewing_inertia": 2e5,
    "trolley_min": 0,
    "trolley_max": 52,
    "hoist_max": 48,
    "mast_height": 50,
    "pivot_height": 52,
    "total_height": 58,
}
"""Ranges as long as those of a real crane [m], and a slewing inertia [kg m²] that is small enough
for the load to turn the structure."""


@cache
def point_crane(**values: object) -> Crane:
    """Return a large crane with a point load, in the gravity of the oracles; loaded once."""
    return load_crane(gravity=G, **{**POINT, **LARGE, **values})


class Oracle(NamedTuple):
    """A number that mechanics knows, and how to read it off a run.

    Attributes:
        name: What the number is.
        unit: Unit of the number, empty for a pure number.
        closed: Value in closed form.
        read: Function that takes a step [s] and returns the value that a run with it has.
        beyond: Largest difference between the two for other reasons than the step, such as a closed
            form that holds for small angles only.
        why: These reasons, in a few words.
    """

    name: str
    unit: str
    closed: float
    read: Callable[[float], float]
    beyond: float = 0.0
    why: str = ""


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
    def of_step(self) -> float:
        """Part of the error that vanishes with the step, as the runs themselves tell."""
        return self.values[-1] - self.limit

    @property
    def rest(self) -> float:
        """Error that is left for a vanishing step."""
        return self.limit - self.oracle.closed

    @property
    def unsure(self) -> float:
        """Uncertainty of the limit: what taking off the last power of the step changed, which
        bounds what the powers beyond it would change.
        """
        last, limit = _richardson(self.values)[-2:]
        return abs(limit - last)

    @property
    def allowed(self) -> float:
        """Largest allowed `rest`: the uncertainty of the extrapolation, rounding, and what the
        oracle itself leaves out.
        """
        return self.unsure + ROUNDING * max(1.0, abs(self.oracle.closed)) + self.oracle.beyond

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
        return self.unsure <= SURE * size and abs(self.rest) <= self.allowed


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


def locked(crane: Crane) -> Hold:
    """Return a controller that commands nothing.

    Drives in prescribed motion keep their speed, drives of efforts exert none.
    """
    return Hold(crane, *np.zeros((3, crane.layout.m)))


class Bench(NamedTuple):
    """Makes the cranes and runs that oracles are read from.

    Attributes:
        build: Makes a crane from numbers of its xacro file.
        engine: Engine that computes a step. Ground and ropes that may go slack are computed by the
            compiled engine also where this is "pinocchio".
    """

    build: Build
    engine: EngineName = "pinocchio"

    def run(
        self,
        crane: Crane,
        start: State,
        duration: float,
        dt: float,
        controller: Controller | None = None,
        *,
        substeps: int = EVERY,
        **options: Any,
    ) -> Trajectory:
        """Run a crane.

        The run goes on where the rope would push or a drive leaves its range: closed forms know of
        neither.

        Args:
            crane: The crane.
            start: Where it starts.
            duration: Duration [s].
            dt: Step [s].
            controller: Controller; None for `locked`.
            substeps: Physics steps in a control period.
            **options: Further options of `simulate`; drives are in prescribed motion by default.
        """
        return simulate(
            crane,
            controller or locked(crane),
            start=start,
            duration=duration,
            dt=dt,
            control_period=substeps * dt,
            engine=None if self.engine == "pinocchio" else self.engine,
            **{"drive": "motion", "validity": "mark", **options},
        )

    def moved(
        self,
        crane: Crane,
        start: State,
        reference: Reference,
        duration: float,
        dt: float,
        *,
        substeps: int = EVERY,
    ) -> Trajectory:
        """Run a crane whose drives follow a reference; the arguments are those of `run`."""
        drives = follow(crane, reference, substeps * dt)
        return self.run(crane, start, duration, dt, drives, substeps=substeps)


def curve(t: np.ndarray, y: np.ndarray, row: int) -> BSpline:
    """Return the polynomial of degree 7 through the eight rows about one.

    Its error is below rounding for swings sampled at 0.1 s.

    Args:
        t: Times of the rows [s].
        y: Values.
        row: The row.
    """
    first = min(max(row - 3, 0), len(t) - 8)
    return make_interp_spline(t[first : first + 8], y[first : first + 8], k=7)


def crossing(t: np.ndarray, y: np.ndarray, count: int) -> float:
    """Return the time at which a signal changes its sign for the n-th time [s].

    Args:
        t: Times of the rows [s].
        y: The signal.
        count: Number n of the change, from 1.

    Raises:
        DataError: If the sign changes less often.
    """
    rows = np.flatnonzero(y[:-1] * y[1:] < 0.0)
    if len(rows) < count:
        raise DataError(
            f"A swing passes the vertical {len(rows)} times in {t[-1]:g} s, where its oracle needs "
            f"{count}."
        )
    i = int(rows[count - 1])
    return zero_between(curve(t, y, i), t[i], t[i + 1])


def zero_between(function: BSpline, low: float, high: float) -> float:
    """Return the time between two times at which a function is zero [s].

    Raises:
        DataError: If it has the same sign at both.
    """
    if function(low) * function(high) > 0.0:
        raise DataError(
            f"A run has nothing to read between {low:g} and {high:g} s, where its oracle needs a "
            "turning point."
        )
    return float(brentq(function, low, high, xtol=1e-15))


def payload_from_pivot(q: np.ndarray) -> np.ndarray:
    """Return the position of the payload [m], shape (rows, 3), from coordinates of shape (rows, 5).

    Heights count from the pivot. The equation is derived by hand, without the code of the plant, in
    docs/concepts/model.md.
    """
    gamma, x, phi, theta, length = q.T
    outward = np.stack([np.sin(gamma), -np.cos(gamma), 0.0 * gamma])
    leftward = np.stack([np.cos(gamma), np.sin(gamma), 0.0 * gamma])
    radius = x - length * np.sin(phi) * np.cos(theta)
    aside = -length * np.sin(theta)
    down = length * np.cos(phi) * np.cos(theta)
    return (radius * outward + aside * leftward - down * np.array([[0.0], [0.0], [1.0]])).T


def offset_from_plumb(q: np.ndarray) -> np.ndarray:
    """Return the position of the payload from the trolley, from which the rope hangs [m], shape
    (rows, 3), from coordinates of shape (rows, 5).
    """
    return payload_from_pivot(q) - payload_from_pivot(q * [1, 1, 0, 0, 0])


def rate_along(position: Callable[[np.ndarray], np.ndarray], trajectory: Trajectory) -> np.ndarray:
    """Return the rate of a function of the coordinates along a run, exact to rounding.

    By a complex step: f(q + i h v) = f(q) + i h f'(q) v up to h², and no difference of two large
    numbers is taken, so that h can be as small as one likes.

    Args:
        position: Function of the coordinates that works with complex numbers.
        trajectory: The run.
    """
    return position(trajectory.q + 1e-30j * trajectory.v).imag / 1e-30
