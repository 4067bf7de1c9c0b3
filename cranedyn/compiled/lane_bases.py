"""Bases that move, one for each crane of a fleet, each at a time of its own.

A fleet takes one control period after another, and its cranes begin and end their episodes at any
of them. So what a crane feels of its base is computed from period to period, and not for a whole
run at once, as `cranedyn.compiled.inputs.root_table` does for a batch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cranedyn.clocks import Clocks
from cranedyn.disturbances.base_motion import (
    COORDINATES,
    BaseCoordinates,
    BaseFrames,
    BaseMotion,
    Harmonics,
    checked_coordinates,
    frames_of,
    sums_of_sines,
)
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP
from cranedyn.errors import OutOfRange


class LaneBases:
    """Motions of the bases of n cranes.

    Attributes:
        rows_per_period: Rows that a control period has of each crane: one for each half physics
            step, with both ends.
        t: Time of each base now [s], shape (n,).
    """

    def __init__(self, count: int, clock: Clocks, gravity: np.ndarray) -> None:
        """Let all cranes stand on bases at rest.

        Args:
            count: Number of cranes, n.
            clock: How a control period is divided.
            gravity: Gravity in the world [m/s²], shape (3,).
        """
        self.rows_per_period = SAMPLES_PER_STEP * clock.steps + 1
        self.t = np.zeros(count)
        self._half_step = clock.dt / SAMPLES_PER_STEP
        self._period = clock.period
        self._gravity = gravity
        self._motions = np.full(count, None, dtype=object)

    def stand_on(
        self, rows: np.ndarray, motions: Sequence[BaseMotion | None], t: np.ndarray
    ) -> None:
        """Let some cranes stand on other bases.

        Args:
            rows: Indices of the cranes, shape (k,).
            motions: Their bases; None for one at rest.
            t: Times at which these are now [s], shape (k,).

        Raises:
            OutOfRange: If one is no motion.
        """
        for motion in motions:
            if not isinstance(motion, BaseMotion | None):
                allowed = "a BaseMotion, such as BaseMotion.sines(heave=(1.0, 8.0)), or None"
                raise OutOfRange("base", type(motion).__name__, allowed)
        for row, motion in zip(rows.tolist(), motions, strict=True):
            self._motions[row] = motion
        self.t[rows] = t

    def motion(self, index: int) -> BaseMotion | None:
        """Return the motion of the base of a crane; None for one at rest."""
        return self._motions[index]

    def advance(self, columns: slice) -> None:
        """Move the time of some cranes on by a control period."""
        self.t[columns] += self._period

    def frames(self, columns: slice) -> BaseFrames:
        """Return the frames of some bases in the control period that begins now, crane by crane,
        `rows_per_period` of each.

        Raises:
            OutOfRange: If a motion is not known then, or a number is not finite.
        """
        offsets = self._half_step * np.arange(self.rows_per_period)
        return frames_of(self._coordinates(columns, offsets))

    def root_numbers(self, frames: BaseFrames) -> np.ndarray:
        """Return what the cranes feel on the bases of `frames`, see
        `cranedyn.dynamics.root_motion.RootMotion`, shape (cranes, rows_per_period, 9).
        """
        numbers = frames.root_numbers(self._gravity)
        return numbers.reshape(-1, self.rows_per_period, ROOT_NUMBERS)

    def coordinates(self, rows: np.ndarray) -> BaseCoordinates:
        """Return where some bases are now, with rates and accelerations, shape (k, 6) each.

        Args:
            rows: Indices of the cranes, shape (k,).
        """
        return self._coordinates(rows, np.zeros(1))

    def _coordinates(self, columns: slice | np.ndarray, offsets: np.ndarray) -> BaseCoordinates:
        """Return the coordinates of some bases, a row for each crane and each of some times from
        now on [s], crane by crane, shape (cranes · times, 6) each.
        """
        motions = self._motions[columns]
        times = self.t[columns]
        found = np.zeros((3, len(motions), len(offsets), len(COORDINATES)))
        # Sums of as many sines are computed together.
        places_of: dict[int, list[int]] = {}
        laws_of: dict[int, list[Harmonics]] = {}
        for i, motion in enumerate(motions):
            if motion is None:
                continue
            is_known_always = math.isinf(motion.first) and math.isinf(motion.last)
            if isinstance(motion.law, Harmonics) and is_known_always:
                sines = len(motion.law.amplitude)
                places_of.setdefault(sines, []).append(i)
                laws_of.setdefault(sines, []).append(motion.law)
            else:
                found[:, i] = motion.at(times[i] + offsets)
        for sines, places in places_of.items():
            found[:, places] = sums_of_sines(laws_of[sines], times[places], offsets)
        count = len(motions) * len(offsets)
        position, velocity, acceleration = found.reshape(3, count, len(COORDINATES))
        return checked_coordinates(position, velocity, acceleration, count)
