"""Imperfect sensors: a controller that sees the state late and with noise."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cranedyn.checks import ShortRepr, number, whole
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane

ENCODER, ENCODER_RATE = {"rad": 1e-4, "m": 1e-3}, {"rad": 1e-4, "m": 2e-3}
"""Standard deviations of the encoders of drives as cranes have them, ours: 0.1 mrad and 1 mm; of
their rates, per second."""

GYROSCOPE, GYROSCOPE_RATE = {"rad": 1e-3, "m": 1e-3}, {"rad": 3e-3, "m": 3e-3}
"""The same of passive joints, whose swing is seen by a camera or a gyroscope, if at all: 1 mrad, 3
mrad/s."""


def noise_of(crane: Crane) -> np.ndarray:
    """Standard deviations of what sensors add to coordinates [rad or m] and rates [per second] of a
    crane, shape (2 n,).
    """
    joints = crane.layout.joints
    position = [(ENCODER if joint.driven else GYROSCOPE)[joint.unit] for joint in joints]
    return np.array(
        position
        + [(ENCODER_RATE if joint.driven else GYROSCOPE_RATE)[joint.unit] for joint in joints]
    )


@dataclass(eq=False, repr=False)
class Sensed(ShortRepr):
    """A controller behind sensors. It remembers readings: make a new one for each run.

    Attributes:
        controller: What acts on the readings.
        noise: Standard deviations of coordinates and rates, shape (2 n,).
        rng: Where the noise comes from.
        readings: The latest ones, oldest first; the oldest is what the controller sees.
    """

    controller: Controller
    noise: np.ndarray
    rng: np.random.Generator
    readings: deque[State]
    _t: float = field(default=-math.inf)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What the controller commands, shape (m,).

        Raises:
            CraneError: If time does not go on, as in a second run.
        """
        if t <= self._t:
            raise CraneError(
                f"These sensors have seen t = {self._t:g} s and are asked for t = {t:g} s; make "
                "new ones for each run."
            )
        self._t = t
        self.readings.append(
            State(
                *(
                    np.concatenate(state) + self.noise * self.rng.standard_normal(len(self.noise))
                ).reshape(2, -1)
            )
        )
        return self.controller(t, self.readings[0], setpoint)


def sensed(
    crane: Crane,
    controller: Controller,
    *,
    delay: int = 0,
    noise: Sequence[float] | Sequence[Sequence[float]] | np.ndarray | None = None,
    rng: np.random.Generator,
) -> Sensed:
    """Put a controller behind sensors that are late and have white Gaussian noise; one for each
    run.

    Args:
        crane: The crane that they measure.
        controller: The controller.
        delay: How many control periods late it sees a state. Until as many have passed it sees the
            first reading.
        noise: Standard deviations of the coordinates [rad or m] and of their rates [per second], 2
            n numbers or n and n; None for `noise_of`.
        rng: Where the noise comes from; an equal seed gives an equal run.

    Raises:
        OutOfRange: If the delay is not a whole number from 0 on, the noise not 2 n numbers from 0
            on, or `rng` not a generator.
    """
    late = whole("delay of the sensors", delay, 0, "control periods")
    symbols = crane.layout.symbols
    given = np.asarray(noise_of(crane) if noise is None else noise, dtype=object).ravel()
    if given.shape != (2 * len(symbols),):
        raise OutOfRange(
            "noise of the sensors",
            noise,
            f"{2 * len(symbols)} numbers: {len(symbols)} coordinates, {len(symbols)} rates",
        )
    names = [*symbols, *(f"{c}_dot" for c in symbols)]
    deviations = np.array(
        [
            number(f"noise of {name}", part, allowed=">= 0")
            for name, part in zip(names, given, strict=True)
        ]
    )
    return Sensed(controller, deviations, rng, deque(maxlen=late + 1))
