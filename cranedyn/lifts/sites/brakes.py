"""Brakes at their weakest: which positions a crane may pass before it stands still."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cranedyn.checks import check_choice, finite, number
from cranedyn.dynamics.converters import DELAY, LAGS, ROUNDING, converters
from cranedyn.dynamics.scalars import magnitude, square_root
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import Crane

BrakesName = Literal["converters", "gears"]
"""Names of brakes that `brakes` knows."""

GEARS = (math.radians(0.2068), math.radians(0.2949), math.radians(0.3090))
"""Decelerations of the slew of a measured tower crane [rad/s²], one for each of its three gears."""

# The stopping times of the same crane lie on the line 3.5284 s per °/s times the rate + 2.3791 s,
# drawn through three measurements. For its highest gear it gives 15 s. The angle of 24° that was
# measured then is 18° by the published formula for the angle, which contradicts it. So only the
# delay of the line is taken, before which nothing need slow down, and the weakest deceleration.
GEARS_DELAY = 2.3791
"""Time before the slew of the same crane slows down [s]."""

CYCLE = 0.1
"""Period of guards and supervisor [s]."""

REACTION = CYCLE + DELAY + LAGS["slew"] + ROUNDING
"""Reaction time [s] of the drives of `cranedyn.dynamics.converters`: a cycle, the delay of the bus,
the lag of the slowest drive and the rounding of its ramp."""

_TOLERANCES = {"rad": 2e-3, "m": 0.05}
"""Largest error of a measured position by its unit."""

_BRAKING_SHARE = 0.9
"""Share of the acceleration of a frequency converter that is counted on for braking."""


@dataclass(frozen=True, eq=False)
class Brakes:
    """Brakes of the m drives of a crane.

    Attributes:
        reaction: Time from a measurement to full deceleration [s], latency of the crane's own
            network included.
        decelerations: Weakest decelerations [rad/s² or m/s²], shape (m,).
        tolerances: Largest errors of measured positions [rad or m], shape (m,).
    """

    reaction: float
    decelerations: np.ndarray
    tolerances: np.ndarray

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If one is not positive, or a tolerance is negative.
        """
        number("reaction time of brakes", self.reaction, "s", "> 0")
        for value in finite("decelerations of brakes", self.decelerations, ("m",)):
            number("deceleration of brakes", value, "", "> 0")
        shape = np.shape(self.decelerations)
        for value in finite("tolerances of brakes", self.tolerances, shape):
            number("tolerance of brakes", value, "", ">= 0")

    def tube(self, position: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the ends of the intervals that the drives may pass before they stand, shape (2,
        m), from measured positions at rates from low to high, shape (m,) each.
        """
        rates = np.array([np.minimum(low, 0.0), np.maximum(high, 0.0)])
        back, ahead = stopping_distance(rates, self.reaction, self.decelerations) + self.tolerances
        return np.array([position - back, position + ahead])


def stopping_distance(rate: Any, reaction: Any, deceleration: Any) -> Any:
    """Return how far a drive goes before it stands [rad or m], in any kind of numbers: v t in its
    reaction time t, then v²/(2 a) at its deceleration a.
    """
    speed = magnitude(rate)
    return speed * (reaction + speed / (2.0 * deceleration))


def largest_rate(distance: Any, reaction: Any, deceleration: Any) -> Any:
    """Return the largest rate from which a drive stops within a distance [rad/s or m/s], in any
    kind of numbers: the positive root v of `stopping_distance`, v t + v²/(2 a) = d.
    """
    delayed = deceleration * reaction
    return square_root(delayed * delayed + 2.0 * deceleration * distance) - delayed


def brakes(crane: Crane, name: BrakesName = "converters", *, reaction: float = REACTION) -> Brakes:
    """Return brakes of a crane by name.

    Args:
        crane: The crane.
        name: "converters": nine tenths of the accelerations of typical frequency converters.
            "gears": the weakest gear of a measured tower crane and its delay, see `GEARS_DELAY`.
            Its source gives the slew only; other drives take the same share of their converters'.
        reaction: Reaction time of the crane [s]; that of "gears" comes on top.

    Raises:
        OutOfRange: If the name is another, the reaction time is not positive, or gears are asked
            for of a crane that does not slew.
    """
    check_choice("brakes", name, BrakesName)
    decelerations = _BRAKING_SHARE * converters(crane).accelerations
    slew = crane.layout.drive_of("slew")
    if name == "gears":
        if slew is None:
            allowed = "converters, or numbers of your own, since gears are those of a slewing crane"
            raise OutOfRange("brakes of a crane without a slew", name, allowed)
        reaction += GEARS_DELAY
        share = min(GEARS) / decelerations[slew]
        decelerations = decelerations * min(share, 1.0)
    tolerances = [_TOLERANCES[joint.unit] for joint in crane.layout.driven]
    return Brakes(reaction, decelerations, np.array(tolerances))
