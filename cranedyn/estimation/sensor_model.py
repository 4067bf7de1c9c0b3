"""Sensor models: a controller that gets the state with delay and noise."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cranedyn.checks import ShortRepr, number, short_repr, whole
from cranedyn.clocks import Clocked
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane

ENCODER = {"rad": 1e-4, "m": 1e-3}
"""Standard deviations of encoders of drives by unit [rad or m], ours: 0.1 mrad and 1 mm."""

ENCODER_RATE = {"rad": 1e-4, "m": 2e-3}
"""Standard deviations of the rates of drives by unit [rad/s or m/s], ours."""

SWING_SENSOR = {"rad": 1e-3, "m": 1e-3}
"""Standard deviations of passive joints by unit [rad or m], whose swing a camera or a gyroscope
measures, ours: 1 mrad."""

SWING_SENSOR_RATE = {"rad": 3e-3, "m": 3e-3}
"""Standard deviations of the rates of passive joints by unit [rad/s or m/s], ours: 3 mrad/s."""


def noise_of(crane: Crane) -> np.ndarray:
    """Return standard deviations of the sensor noise of a crane: coordinates [rad or m] and rates
    [per second], shape (2 n,).
    """
    coordinates = []
    rates = []
    for joint in crane.layout.joints:
        if joint.driven:
            coordinates.append(ENCODER[joint.unit])
            rates.append(ENCODER_RATE[joint.unit])
        else:
            coordinates.append(SWING_SENSOR[joint.unit])
            rates.append(SWING_SENSOR_RATE[joint.unit])
    return np.array([*coordinates, *rates])


def standard_deviations(
    name: str, deviations: Any, count: int, allowed: str = ">= 0"
) -> np.ndarray:
    """Check the number and the range of standard deviations; return them, shape (count,).

    Args:
        name: What they are of, for an error.
        deviations: The standard deviations, in any shape.
        count: How many there must be.
        allowed: Range of each of them, see `cranedyn.checks.number`.

    Raises:
        OutOfRange: If their number is another, or one is out of range.
    """
    elements = np.asarray(deviations, dtype=object).ravel()
    if len(elements) != count:
        raise OutOfRange(name, deviations, f"{count} standard deviations")
    return np.array([number(name, element, allowed=allowed) for element in elements])


@dataclass(eq=False, repr=False)
class SensorModelController(ShortRepr):
    """A controller behind sensors. It remembers readings: make a new one for each run.

    Attributes:
        controller: The controller that gets the readings.
        noise: Standard deviations of coordinates and rates, shape (2 n,).
        rng: Random generator of the noise.
        readings: The latest readings, oldest first; the controller gets the oldest.
    """

    controller: Controller
    noise: np.ndarray
    rng: np.random.Generator
    readings: deque[State]
    _t: float = field(default=-math.inf)

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin the run of the controller, see `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of the controller, shape (m,).

        Raises:
            CraneError: If time does not increase, as in a second run.
        """
        if t <= self._t:
            raise CraneError(
                f"These sensors have seen t = {self._t:g} s and are asked for t = {t:g} s; make "
                "new ones for each run."
            )
        self._t = t
        reading = np.concatenate(state) + self.noise * self.rng.standard_normal(len(self.noise))
        self.readings.append(State(*reading.reshape(2, -1)))
        return self.controller(t, self.readings[0], setpoint)


def with_sensor_model(
    crane: Crane,
    controller: Controller,
    *,
    delay: int = 0,
    noise: Sequence[float] | Sequence[Sequence[float]] | np.ndarray | None = None,
    rng: np.random.Generator,
) -> SensorModelController:
    """Return a controller behind sensors with delay and white Gaussian noise; make one for each
    run.

    Args:
        crane: The crane that the sensors measure.
        controller: The controller.
        delay: Delay of the readings [control periods]; before the first delay has passed, the
            controller gets the first reading.
        noise: Standard deviations of the coordinates [rad or m] and of their rates [per second], 2
            n numbers or n and n; None for `noise_of`.
        rng: Random generator of the noise; an equal seed gives an equal run.

    Raises:
        OutOfRange: If the delay is not a whole number from 0 on, the noise not 2 n numbers from 0
            on, or `rng` not a generator.
    """
    delay = whole("delay of the sensors", delay, 0, "control periods")
    noise = noise_of(crane) if noise is None else noise
    deviations = standard_deviations("noise of the sensors", noise, 2 * crane.layout.n)
    if not isinstance(rng, np.random.Generator):
        raise OutOfRange("rng", short_repr(rng), "a generator, such as numpy.random.default_rng(0)")
    # With so many readings at most the first one in the queue is `delay` periods old.
    return SensorModelController(controller, deviations, rng, deque(maxlen=delay + 1))
