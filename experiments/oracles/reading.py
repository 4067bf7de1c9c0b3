"""How runs are made for the oracles, and read between their rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq

from cranedyn.controllers import Hold, follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.interfaces import Controller, Drive, EngineName, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.simulate import simulate
from experiments.oracles.check import Build

EVERY, SELDOM = 5, 50
"""Physics steps to a control period, and where nothing is commanded and only the end is read."""


def locked(crane: Crane) -> Hold:
    """Return a controller of no command: drives of prescribed motion keep their speed, drives of
    efforts exert none.
    """
    return Hold(crane, *np.zeros((3, crane.layout.m)))


@dataclass(frozen=True)
class Bench:
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
        drive: Drive = "motion",
    ) -> Trajectory:
        """Run a crane, by default with drives in prescribed motion; the run goes on where a rope or
        a range would end.
        """
        return simulate(
            crane,
            controller or locked(crane),
            start=start,
            duration=duration,
            dt=dt,
            control_period=substeps * dt,
            drive=drive,
            validity="mark",
            engine=self.engine,
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
        """Run a crane whose drives follow a reference."""
        return self.run(
            crane, start, duration, dt, follow(crane, reference, substeps * dt), substeps=substeps
        )


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
    radius, aside = x - length * np.sin(phi) * np.cos(theta), -length * np.sin(theta)
    down = length * np.cos(phi) * np.cos(theta)
    return (radius * outward + aside * leftward - down * np.array([[0.0], [0.0], [1.0]])).T


def rate_along(position: Callable[[np.ndarray], np.ndarray], trajectory: Trajectory) -> np.ndarray:
    """Return the rate of a function of the coordinates along a run, by a complex step, exact to
    rounding.
    """
    return position(trajectory.q + 1e-30j * trajectory.v).imag / 1e-30
