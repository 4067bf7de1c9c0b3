"""The motion of all joints over time, not of the drives alone: what tracking controllers linearise
about.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.checks import Shape, ShortRepr, finite, number
from cranedyn.clocks import intervals
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.scalars import column_objects
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.references.tabulated import (
    ROW_TOLERANCE,
    interpolate,
    interpolate_many,
    locate,
    locate_many,
    tabulated,
)


@dataclass(frozen=True, eq=False, repr=False)
class Motion(ShortRepr):
    """A motion in rows, with straight lines between them; before and after it stands still. Itself
    a reference for the drives.

    Attributes:
        period: Time between rows [s].
        q: Coordinates [rad or m], shape (rows, n).
        v: Their rates, shape (rows, n).
        a: Their accelerations, shape (rows, n).
        drives: Indices of the drives among the coordinates, shape (m,).
    """

    period: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    drives: np.ndarray

    def __post_init__(self) -> None:
        """Check the period, and that there are as many finite numbers of each kind in every row."""
        number("period", self.period, "s", "> 0")
        shape: Shape = ("rows", "n")
        for name in ("q", "v", "a"):
            table = finite(f"{name} of a motion", getattr(self, name), shape)
            object.__setattr__(self, name, table)
            shape = table.shape
        if not len(self.q):
            raise OutOfRange("motion", "one of no row", "one row or more")
        drives = finite("drives of a motion", self.drives, ("m",)).tolist()
        n = self.q.shape[1]
        if len({*drives} & {*range(n)}) < max(1, len(drives)):
            allowed = f"different whole numbers from 0 to {n - 1}"
            raise OutOfRange("drives of a motion", drives, allowed)
        object.__setattr__(self, "drives", np.array(drives, dtype=int))

    def check_fits(self, name: str, layout: Layout) -> None:
        """Check that the motion belongs to a crane of this layout.

        Raises:
            OutOfRange: If its number of coordinates or its drives are others.
        """
        n = self.q.shape[1]
        drives = self.drives.tolist()
        if n != layout.n or drives != layout.drives.tolist():
            expected = f"one of {layout.n}, the drives {layout.drives.tolist()}"
            raise OutOfRange(name, f"a motion of {n} coordinates, the drives {drives}", expected)

    @property
    def arrival(self) -> float:
        """Time at which the motion ends [s]."""
        return self.period * (len(self.q) - 1)

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint of the drives at a time [s]."""
        row, share = locate(t, self.period, len(self.q))
        position = interpolate(self.q, row, share)[self.drives]
        if not self._moves(t):
            return Setpoint(position, 0.0 * position, 0.0 * position)
        velocity = interpolate(self.v, row, share)[self.drives]
        acceleration = interpolate(self.a, row, share)[self.drives]
        return Setpoint(position, velocity, acceleration)

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (rows, m) each."""
        row, share = locate_many(times, self.period, len(self.q))
        position = interpolate_many(self.q, row, share)[:, self.drives]
        velocity = interpolate_many(self.v, row, share)[:, self.drives]
        acceleration = interpolate_many(self.a, row, share)[:, self.drives]
        moving = self._moves(times)[:, None]
        return Setpoint(
            position, np.where(moving, velocity, 0.0), np.where(moving, acceleration, 0.0)
        )

    def _moves(self, t: Any) -> Any:
        """Return whether a time, or each of many [s], lies between the first and the last row."""
        return (t >= -ROW_TOLERANCE * self.period) & (
            t <= self.arrival + ROW_TOLERANCE * self.period
        )


def hanging_reference(
    crane: Crane, reference: Reference, duration: float, period: float = 5e-3
) -> Motion:
    """Return the motion of a reference over a duration [s], sampled at a period [s], with the load
    hanging plumb; its last row is at rest.

    Raises:
        OutOfRange: If a time is not positive, or there would be more than 4 million rows.
    """
    intervals("duration", duration, period)
    times = period * np.arange(round(duration / period) + 1)
    drives = crane.layout.drives
    # Positions, rates and accelerations.
    samples = np.zeros((3, len(times), crane.layout.n))
    samples[0] = crane.start.q
    samples[:, :, drives] = tabulated(reference, times, crane.layout.m)
    samples[1:, -1] = 0.0
    samples[0] = [crane.resting(q) for q in samples[0]]
    if crane.coupling is not None:
        samples[1:] = crane.coupling.spread(samples[1:].T).T
    q, v, a = samples
    return Motion(period, q, v, a, drives)


def motion_efforts(crane: Crane, motion: Motion) -> np.ndarray:
    """Return drive efforts that a motion costs, by inverse dynamics [N m or N], shape (rows, m)."""
    motion.check_fits("motion", crane.layout)
    pool = pin.ModelPool(crane.model, 1)
    forces = pin.rneaInParallel(1, pool, motion.q.T, motion.v.T, motion.a.T).T
    forces = forces.reshape(motion.q.shape)  # of one row Pinocchio returns a vector
    joint = JointForces.of(crane).effort(column_objects(motion.q), column_objects(motion.v))
    if crane.coupling is None:
        for i in motion.drives:
            forces[:, i] -= joint[i]
        return forces[:, motion.drives]
    needed = forces.T - np.array([np.broadcast_to(effort, len(forces)) for effort in joint])
    return crane.coupling.gather(needed).T[:, motion.drives]
