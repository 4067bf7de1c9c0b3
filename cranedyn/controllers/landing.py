"""Set a load down on a deck that moves: when to begin, and how hard it lands.

A hoist that compensates heave keeps its load at rest in the world, see
`cranedyn.controllers.moving_base.heave_compensated`, and lowers it there with a constant speed v.
The deck meets it with its own velocity ż, upwards, so that the two close at the speed

    u = v + ż

when they touch. The impulse of the impact is m u (1 + e), with the mass m of the load and the
coefficient of restitution e, beside that of the weight in the short time of the contact.

When lowering begins decides at which phase of the waves the load lands. `least_impact_landing`
searches for the beginning after which u is least, also if it is a little late or early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import ShortRepr, finite, number
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import Tabulating, tabulated

_HEAVE = COORDINATES.index("heave")
"""Index of the coordinate along the vertical of the world."""

_TIME_STEP = 0.01
"""Time between the instants at which beginnings are tried and the deck is looked at [s]: a wave of
some seconds moves by a thousandth of its period in it."""


@dataclass(frozen=True)
class Landing:
    """A landing of a load on a deck.

    Attributes:
        begin: Time at which lowering begins [s].
        contact: Time at which the load touches the deck [s].
        lowering: Speed of the load in the world, downwards [m/s].
        speed: Speed at which load and deck close when they touch [m/s].
        speed_within_tolerance: Largest closing speed if lowering begins up to the tolerance of the
            search earlier or later [m/s].
        worst_speed: Largest closing speed of all beginnings that were tried [m/s].
    """

    begin: float
    contact: float
    lowering: float
    speed: float
    speed_within_tolerance: float
    worst_speed: float

    def impulse(self, mass: float, restitution: float = 0.0) -> float:
        """Return the impulse m u (1 + e) of the impact [N s], without that of the weight.

        Args:
            mass: Mass of the load [kg].
            restitution: Coefficient of restitution e, 0 to 1.
        """
        return mass * self.speed * (1.0 + restitution)


def least_impact_landing(
    deck: BaseMotion,
    place: Sequence[float],
    *,
    height: float,
    lowering: float,
    earliest: float,
    latest: float,
    tolerance: float = 0.0,
) -> Landing:
    """Return the landing with the least closing speed, of all beginnings within a time.

    Args:
        deck: Motion of the deck.
        place: Where the load lands, in the frame of the deck at rest [m], shape (3,).
        height: Height of the lowest point of the load over this place on a deck at rest [m].
        lowering: Speed of the load in the world, downwards [m/s].
        earliest: Earliest time at which lowering may begin [s].
        latest: Latest time [s].
        tolerance: Time by which it may begin earlier or later than planned [s]. The landing is
            chosen whose largest closing speed within this time is least.

    Raises:
        OutOfRange: If a number is out of its range, the deck touches the load before it is lowered,
            or the motion of the deck is not known until the load has landed.
    """
    point = finite("place of the landing", place, (3,), unit="m")
    clearance = number("height of the load over the deck", height, "m", "> 0")
    speed = number("lowering speed", lowering, "m/s", "> 0")
    first = number("earliest beginning", earliest, "s")
    last = number("latest beginning", latest, "s", f">= {first:g}")
    margin = number("tolerance of the beginning", tolerance, "s", ">= 0")

    # The deck is looked at until it has met the load wherever that is: a time that doubles.
    horizon = last + margin + 2.0 * clearance / speed
    begins = np.arange(first - margin, last + margin + 0.5 * _TIME_STEP, _TIME_STEP)
    while True:
        t = np.arange(begins[0], horizon + _TIME_STEP, _TIME_STEP)
        at_place = deck.at(t).seen_at(point)
        heights = at_place.position[:, _HEAVE]
        velocities = at_place.velocity[:, _HEAVE]
        contacts = _first_contacts(t, heights, clearance, speed, begins)
        if not np.isnan(contacts).any():
            break
        horizon = last + margin + 2.0 * (horizon - last - margin)
    closing = speed + np.interp(contacts, t, velocities)

    # The largest closing speed within the tolerance of each beginning.
    reach = int(np.ceil(margin / _TIME_STEP - 1e-9))
    planned = np.arange(reach, len(begins) - reach)
    windows = np.lib.stride_tricks.sliding_window_view(closing, 2 * reach + 1)
    largest = windows.max(axis=1)
    best = int(np.argmin(largest))
    chosen = int(planned[best])
    return Landing(
        begin=float(begins[chosen]),
        contact=float(contacts[chosen]),
        lowering=speed,
        speed=float(closing[chosen]),
        speed_within_tolerance=float(largest[best]),
        worst_speed=float(closing[planned].max()),
    )


def _first_contacts(
    t: np.ndarray, heights: np.ndarray, clearance: float, speed: float, begins: np.ndarray
) -> np.ndarray:
    """Return when a deck first touches a load that begins to be lowered at some times [s], shape
    (begins,); NaN where it does not within the times that are looked at.

    Raises:
        OutOfRange: If the deck touches a load before it is lowered.
    """
    contacts = np.full(len(begins), np.nan)
    for i, begin in enumerate(begins):
        gaps = clearance - speed * np.maximum(t - begin, 0.0) - heights
        row = int(np.argmax(gaps <= 0.0))
        if gaps[row] > 0.0:
            continue
        if t[row] <= begin:
            allowed = f"more than {heights[row]:.3g}, the height of the deck at {t[row]:.4g} s"
            raise OutOfRange("height of the load over the deck", clearance, allowed, "m")
        # Between two rows the gap closes on a straight line.
        share = gaps[row - 1] / (gaps[row - 1] - gaps[row])
        contacts[i] = t[row - 1] + share * (t[row] - t[row - 1])
    return contacts


@dataclass(frozen=True, eq=False, repr=False)
class LandingReference(ShortRepr, Tabulating):
    """A reference whose hoist pays out at a constant speed from some time on, see
    `landing_reference`.

    Attributes:
        crane: The crane.
        reference: The reference before that.
        begin: Time at which it begins [s].
        lowering: The speed [m/s].
    """

    crane: Crane
    reference: Reference
    begin: float
    lowering: float

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (k, m) each."""
        hoist = self.crane.layout.drive_of("hoist")
        position, velocity, acceleration = tabulated(self.reference, times, self.crane.layout.m)
        position = position.copy()
        velocity = velocity.copy()
        elapsed = np.maximum(np.asarray(times) - self.begin, 0.0)
        position[:, hoist] += self.lowering * elapsed
        velocity[:, hoist] += np.where(elapsed > 0.0, self.lowering, 0.0)
        return Setpoint(position, velocity, acceleration)


def landing_reference(crane: Crane, reference: Reference, landing: Landing) -> LandingReference:
    """Return a reference, such as a heave-compensated one, that lowers its load for a landing.

    The hoist goes on paying out after the load has landed, so that the rope becomes slack and the
    deck cannot lift the load from its rope when it falls.

    Args:
        crane: A crane with a hoist.
        reference: The reference.
        landing: The landing.

    Raises:
        OutOfRange: If the crane has no hoist.
    """
    if crane.layout.drive_of("hoist") is None:
        raise OutOfRange("crane", "one without a hoist", "one with a hoist")
    return LandingReference(crane, reference, landing.begin, landing.lowering)
