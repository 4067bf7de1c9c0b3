"""The wind up to which the cranes of a site work, and how far it swings their loads.

Wind is entered, as brakes are: nobody can compute it from the site. What a site promises, it
promises up to this wind.
"""

from __future__ import annotations

from dataclasses import dataclass

from cranedyn.checks import number
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.model.crane import Crane

# A load of mass m on a rope of length l, under a pivot at rest, in a wind that pushes it by the
# force F(t), follows for small angles θ from plumb
#
#     θ'' + ω² θ = ω² s(t),    ω² = g/l,    s = F/(m g),
#
# with s the inclination at which it would rest: its static lean. From rest, a wind that rises at
# once to s and stays gives θ = s (1 - cos ωt): twice the static lean.
#
# A gust is a wind that rises and falls once, in one direction, to no more than s: in any shape and
# for any duration. It is a sum of winds that are on from some time a to some time b, the levels of
# the gust one above the other, and each of them gives at most
#
#     s |cos ω(t - b) - cos ω(t - a)| ≤ 2 s.
#
# So twice the static lean bounds the response to every single gust, (1 - cos)/2 among them, and to
# a wind that blows already and drops. Drag falls with the speed of the load in the direction of the
# wind, F ~ |w - v| (w - v), which only takes energy out of the swing. The bound is not one of many
# gusts at the rhythm of the rope; that the swing decays between gusts is an assumption.
GUST_RESPONSE = 2.0
"""Largest swing by a gust over the static lean in its strongest wind."""


@dataclass(frozen=True)
class WorkingWind:
    """Wind up to which the cranes of a site work.

    Attributes:
        gust: Largest wind speed in gusts at the height of the loads [m/s].
        area: Largest drag coefficient times area of a load [m²].
    """

    gust: float
    area: float

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If one is not finite, or negative.
        """
        number("wind in gusts", self.gust, "m/s", ">= 0")
        number("drag area of a load", self.area, "m²", ">= 0")

    def drag_ratio(self, crane: Crane) -> float:
        """Return the drag on the load of a crane over its weight, for 1 m/s [s²/m²]."""
        weight = crane.payload_mass * crane.gravity
        return 0.5 * AIR_DENSITY * self.area / weight

    def swing(self, crane: Crane) -> float:
        """Return the largest angle from plumb [rad] to which one gust swings the load of a crane
        that hangs at rest: `GUST_RESPONSE` times the static lean, which is drag over weight.
        """
        return GUST_RESPONSE * self.drag_ratio(crane) * self.gust**2


CALM = WorkingWind(0.0, 0.0)
"""No wind: what a site assumes for which none is entered."""
