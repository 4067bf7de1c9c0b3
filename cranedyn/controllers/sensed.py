"""Imperfect sensors: a controller that sees the state late and with noise."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cranedyn.arguments import checked
from cranedyn.errors import CraneError, OutOfRange, number, whole
from cranedyn.interfaces import COORDINATES, Controller, Setpoint, State

NOISE = np.array([1e-4, 1e-3, 1e-3, 1e-3, 1e-3, 1e-4, 2e-3, 3e-3, 3e-3, 2e-3])
"""Standard deviations of sensors as cranes have them, ours: of γ 0.1 mrad, of x and l 1 mm, of the swing 1 mrad; of their rates
0.1 mrad/s, 2 mm/s and 3 mrad/s. Drives have encoders; swing is seen by a camera or a gyroscope, if at all."""


@dataclass(eq=False)
class Sensed:
    """A controller behind sensors. It remembers readings: make a new one for each run.

    Attributes:
        controller: What acts on the readings.
        noise: Standard deviations of coordinates and rates, shape (10,).
        rng: Where the noise comes from.
        readings: The latest ones, oldest first; the oldest is what the controller sees.
    """

    controller: Controller
    noise: np.ndarray
    rng: np.random.Generator
    readings: deque[State]
    _t: float = field(default=-math.inf)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What the controller commands, shape (3,).

        Raises:
            CraneError: If time does not go on, as in a second run.
        """
        if t <= self._t:
            raise CraneError(f"These sensors have seen t = {self._t:g} s and are asked for t = {t:g} s; make new ones for each run.")
        self._t = t
        self.readings.append(State(*(np.concatenate(state) + self.noise * self.rng.standard_normal(10)).reshape(2, 5)))
        return self.controller(t, self.readings[0], setpoint)


@checked
def sensed(
    controller: Controller,
    *,
    delay: int = 0,
    noise: Sequence[float] | Sequence[Sequence[float]] | np.ndarray = NOISE,
    rng: np.random.Generator,
) -> Sensed:
    """Put a controller behind sensors that are late and have white Gaussian noise; one for each run.

    Args:
        controller: The controller.
        delay: How many control periods late it sees a state. Until as many have passed it sees the first reading.
        noise: Standard deviations of γ, x, φ, θ, l [rad or m] and of their rates [per second], ten numbers or five and five.
        rng: Where the noise comes from; an equal seed gives an equal run.

    Raises:
        OutOfRange: If the delay is not a whole number from 0 on, the noise not ten numbers from 0 on, or `rng` not a generator.
    """
    late = whole("delay of the sensors", delay, 0, "control periods")
    given = np.asarray(noise, dtype=object).ravel()
    if given.shape != (10,):
        raise OutOfRange("noise of the sensors", noise, "ten numbers: five coordinates, five rates")
    names = [*COORDINATES, *(f"{c}_dot" for c in COORDINATES)]
    deviations = np.array([number(f"noise of {name}", part, allowed=">= 0") for name, part in zip(names, given, strict=True)])
    return Sensed(controller, deviations, rng, deque(maxlen=late + 1))
