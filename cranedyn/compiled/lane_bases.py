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
    BaseMotion,
    Harmonics,
    checked_coordinates,
    frames_of,
)
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP
from cranedyn.errors import OutOfRange

_LANES_TOGETHER = 256
"""Lanes whose sines are summed together, so that their numbers stay in a processor's cache."""


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
        self._motions: list[BaseMotion | None] = [None] * count

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

    def root_numbers(self, columns: slice) -> np.ndarray:
        """Return what some cranes feel in the control period that begins now, see
        `cranedyn.dynamics.root_motion.RootMotion`, shape (cranes, rows_per_period, 9).

        Raises:
            OutOfRange: If a motion is not known then, or a number is not finite.
        """
        offsets = self._half_step * np.arange(self.rows_per_period)
        coordinates = self._coordinates(columns, offsets)
        numbers = frames_of(coordinates).root_numbers(self._gravity)
        return numbers.reshape(-1, self.rows_per_period, ROOT_NUMBERS)

    def rotations(self, columns: slice) -> np.ndarray:
        """Return the attitudes of some bases now, from their axes to those of the world, shape
        (cranes, 3, 3).
        """
        return frames_of(self._coordinates(columns, np.zeros(1))).rotation

    def coordinates(self) -> BaseCoordinates:
        """Return where all bases are now, with rates and accelerations, shape (n, 6) each."""
        return self._coordinates(slice(len(self.t)), np.zeros(1))

    def _coordinates(self, columns: slice, offsets: np.ndarray) -> BaseCoordinates:
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
            for first in range(0, len(places), _LANES_TOGETHER):
                some = places[first : first + _LANES_TOGETHER]
                laws = laws_of[sines][first : first + _LANES_TOGETHER]
                found[:, some] = _sums_of_sines(laws, times[some], offsets)
        count = len(motions) * len(offsets)
        position, velocity, acceleration = found.reshape(3, count, len(COORDINATES))
        return checked_coordinates(position, velocity, acceleration, count)


def _sums_of_sines(laws: Sequence[Harmonics], times: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return coordinates, rates and accelerations on sums of as many sines each, shape (3, laws,
    offsets, 6).

    A sine is the imaginary part of a exp(i (ω t + ε)). From one row to the next it turns by the
    constant factor exp(i ω δ), which is far cheaper than its sine. The round-off of these products
    grows with their number: a control period has some dozens.

    Args:
        laws: The sums.
        times: Time of each at the first row [s], shape (laws,).
        offsets: Times of the rows from there on [s], equally spaced, the first 0.
    """
    amplitude = np.array([law.amplitude.T for law in laws])
    # Coordinates that no base moves along cost nothing.
    moving = np.flatnonzero((amplitude != 0.0).any(axis=(0, 2)))
    amplitude = amplitude[:, moving]
    frequency = np.array([law.frequency.T[moving] for law in laws])
    phase = np.array([law.phase.T[moving] for law in laws])
    squared = frequency**2
    angle = frequency * times[:, None, None] + phase
    real = amplitude * np.cos(angle)
    imaginary = amplitude * np.sin(angle)
    spacing = offsets[1] if len(offsets) > 1 else 0.0
    cosine = np.cos(frequency * spacing)
    sine = np.sin(frequency * spacing)
    coordinates = np.zeros((3, len(laws), len(offsets), len(COORDINATES)))
    for row in range(len(offsets)):
        coordinates[0][:, row, moving] = imaginary.sum(axis=2)
        coordinates[1][:, row, moving] = np.einsum("lck,lck->lc", real, frequency)
        coordinates[2][:, row, moving] = -np.einsum("lck,lck->lc", imaginary, squared)
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    return coordinates
