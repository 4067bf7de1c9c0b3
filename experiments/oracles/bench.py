"""Closed forms beside runs of the plant: how runs are made and read between their rows, and how
they are held against an oracle by halving the step, so that the step's own error is known and taken
off.
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

G, MASS = 9.81, 1000.0
"""Gravity [m/s²] and mass of the load [kg] of all oracles."""

STEP = 0.02
"""The coarsest step [s]; every time at which something happens is a multiple of its control
period."""

ROUNDING = 1e-11
"""What sums of some 10⁵ steps lose of a number of size 1, and of what is read between two rows by
polynomials."""

SMALL, FINITE = 1e-4, "finite swing"
"""By how much motions with a closed form for small angles are scaled down in their runs; what is
left of a finite angle is the square of that."""

SURE = 1e-5
"""How much an extrapolation may be unsure of a number of size 1; more means that the runs have no
limit."""

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
"""Ranges as long as those of a real crane, on a structure that is light enough for the load to
turn it."""


@cache
def point_crane(**values: object) -> Crane:
    """Return a large crane with a point load, in the gravity of the oracles; loaded once."""
    return load_crane(gravity=G, **{**POINT, **LARGE, **values})


class Oracle(NamedTuple):
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


class OracleCheck(NamedTuple):
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
        return self.unsure + ROUNDING * max(1.0, abs(self.oracle.closed)) + self.oracle.beyond

    @property
    def order(self) -> float | None:
        """Power of the step with which the error falls, for a vanishing step; None where too little
        of it is the step's to tell.
        """
        errors = [abs(value - self.oracle.closed) for value in self.values[-3:]]
        if errors[-1] < 100.0 * self.allowed:
            return None
        coarse, fine = (math.log2(error / half) for error, half in itertools.pairwise(errors))
        return 2.0 * fine - coarse

    @property
    def holds(self) -> bool:
        """Whether there is a limit, and it is the closed form."""
        size = max(1.0, abs(self.oracle.closed))
        return self.unsure <= SURE * size and abs(self.rest) <= self.allowed


def _richardson(values: Sequence[float]) -> list[float]:
    """Return Richardson extrapolations of values at steps h, h/2, h/4, ..., by rising power."""
    row = list(values)
    best = [values[-1]]
    for power in range(1, len(values)):
        pairs = itertools.pairwise(row)
        row = [fine + (fine - coarse) / (2.0**power - 1.0) for coarse, fine in pairs]
        best.append(row[-1])
    return best


def check_oracle(oracle: Oracle, halvings: int) -> OracleCheck:
    """Run an oracle with the coarsest step, half of it, and so on."""
    steps = [STEP / 2**k for k in range(halvings + 1)]
    return OracleCheck(oracle, steps, [oracle.read(dt) for dt in steps])


EVERY, SELDOM = 5, 50
"""Physics steps to a control period, and where nothing is commanded and only the end is read."""


def locked(crane: Crane) -> Hold:
    """Return a controller of no command: drives of prescribed motion keep their speed, drives of
    efforts exert none.
    """
    return Hold(crane, *np.zeros((3, crane.layout.m)))


class Bench(NamedTuple):
    """Where the plant is held against oracles.

    Attributes:
        build: Makes a crane from numbers of its xacro file.
        engine: What computes a step.
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
        """Run a crane, by default with drives in prescribed motion; the run goes on where a rope or
        a range would end. Further options are those of `simulate`.
        """
        options = {"drive": "motion", "validity": "mark", "engine": self.engine, **options}
        options |= {"start": start, "dt": dt, "control_period": substeps * dt}
        return simulate(crane, controller or locked(crane), duration=duration, **options)

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
        """Run a crane whose drives follow a reference."""
        drives = follow(crane, reference, substeps * dt)
        return self.run(crane, start, duration, dt, drives, substeps=substeps)


def curve(t: np.ndarray, y: np.ndarray, row: int) -> BSpline:
    """Return the polynomial of degree 7 through the eight rows about one; its error is below
    rounding for swings sampled at 0.1 s.
    """
    first = min(max(row - 3, 0), len(t) - 8)
    return make_interp_spline(t[first : first + 8], y[first : first + 8], k=7)


def crossing(t: np.ndarray, y: np.ndarray, count: int) -> float:
    """Return the time at which a signal changes its sign for the n-th time.

    Raises:
        DataError: If it does so less often.
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
    """Return the time between two times at which a function is zero.

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
    """Return the position of the payload [m], shape (n, 3), from the coordinates, shape (n, 5);
    heights count from the pivot. Derived by hand (docs/concepts/model.md).
    """
    gamma, x, phi, theta, length = q.T
    outward = np.stack([np.sin(gamma), -np.cos(gamma), 0.0 * gamma])
    leftward = np.stack([np.cos(gamma), np.sin(gamma), 0.0 * gamma])
    radius = x - length * np.sin(phi) * np.cos(theta)
    aside = -length * np.sin(theta)
    down = length * np.cos(phi) * np.cos(theta)
    return (radius * outward + aside * leftward - down * np.array([[0.0], [0.0], [1.0]])).T


def offset_from_plumb(q: np.ndarray) -> np.ndarray:
    """Return the position of the payload [m], shape (n, 3), from where it would hang plumb below
    the trolley on no cable.
    """
    return payload_from_pivot(q) - payload_from_pivot(q * [1, 1, 0, 0, 0])


def rate_along(position: Callable[[np.ndarray], np.ndarray], trajectory: Trajectory) -> np.ndarray:
    """Return the rate of a function of the coordinates along a run, by a complex step, exact to
    rounding.
    """
    return position(trajectory.q + 1e-30j * trajectory.v).imag / 1e-30
