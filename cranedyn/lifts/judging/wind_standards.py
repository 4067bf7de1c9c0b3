"""Wind on cranes and loads as the standards have it: pressures, classes, heights, recurrence; and
how a load hangs in it.

The standards are read second hand; see `cranedyn.lifts.judging.factors`.
"""

from __future__ import annotations

import math
from types import MappingProxyType

from cranedyn.checks import number, within
from cranedyn.disturbances.wind import AIR_DENSITY

PRESSURE = AIR_DENSITY / 2.0
"""q/v² [kg/m³]."""

IN_SERVICE = MappingProxyType({"light": 14.0, "normal": 20.0, "heavy": 28.5})
"""Wind speeds in service [m/s]: of cranes easily protected and used in light winds only, of all
normal ones, and of those that must go on in high winds. AS 5222:2021 (second hand)."""

SCATTER = 0.11
"""Scale over location of Gumbel's law (1958) for the largest wind speed of a year, the law of EN
1991-1-4, (4.2). With 0.11 it gives, to their three digits, all recurrence factors of AS 5222:2021
(second hand): 0.815, 0.873, 0.946 and 1 for 5, 10, 25 and 50 years."""

OPERATING = MappingProxyType(
    {"a maker's manual": 20.0, "UK trade guidance": 16.5, "a Chinese code of work": 12.0}
)
"""Wind speeds at which work ends [m/s], as in use (second hand)."""


def wind_pressure(speed: float) -> float:
    """Return the pressure [Pa] of a wind speed [m/s]: 0.625 v². AS 5222:2021 (second hand)."""
    v = number("wind speed", speed, "m/s")
    return PRESSURE * v * v


def speed_of_pressure(pressure: float) -> float:
    """Return the wind speed [m/s] of a pressure [Pa]: √(q/0.625)."""
    return math.sqrt(number("pressure", pressure, "Pa", ">= 0") / PRESSURE)


def height_factor(height: float) -> float:
    """Return the wind speed out of service at a height [m] over the reference at 10 m:
    (z/10)^0.14 + 0.4. AS 5222:2021 (second hand).
    """
    return float((number("height", height, "m", "> 0") / 10.0) ** 0.14 + 0.4)


def recurrence_factor(years: float) -> float:
    """Return f_rec, the wind speed exceeded once in a number of years over that of 50 years: the
    quantile of 1 - 1/years of Gumbel's law, see `SCATTER`.
    """
    years = within("years of recurrence", years, 2.0, 1000.0)
    return _gumbel_quantile(years) / _gumbel_quantile(50.0)


def _gumbel_quantile(years: float) -> float:
    """Return the wind speed that is exceeded once in a number of years, over the location of
    Gumbel's law: 1 - s ln(-ln(1 - 1/years)) with its scale s, see `SCATTER`.
    """
    return 1.0 - SCATTER * math.log(-math.log1p(-1.0 / years))


def out_of_service_speed(height: float, reference: float, years: float = 50) -> float:
    """Return the wind speed out of service [m/s]: f_rec [(z/10)^0.14 + 0.4] v_ref. AS 5222:2021
    (second hand).

    Args:
        height: z above ground [m].
        reference: v_ref of the storm, mean of ten minutes at 10 m with a recurrence of 50 years
            [m/s].
        years: Of recurrence, 2 to 1000.
    """
    speed = number("reference", reference, "m/s", ">= 0")
    return recurrence_factor(years) * height_factor(height) * speed


def wind_force(pressure: float, drag_area: float) -> float:
    """Return the force [N] of a wind pressure [Pa] on a body at rest by its coefficient of drag
    times its area [m²]: q c A. AS 5222:2021 (second hand).

    The drag of a body that moves is `cranedyn.disturbances.wind.drag_force`.
    """
    return number("pressure", pressure, "Pa", ">= 0") * number("drag_area", drag_area, "m²", ">= 0")


def wind_lean(force: float, mass: float, gravity: float) -> float:
    """Return the angle [rad] at which a load of a mass [kg] hangs in a steady horizontal force [N]:
    atan(F/(m g)).

    Raises:
        OutOfRange: If a number is not finite, or mass, gravity or weight not positive.
    """
    weight = number("mass", mass, "kg", "> 0") * number("gravity", gravity, "m/s²", "> 0")
    return math.atan(number("force", force, "N") / number("weight", weight, "N", "> 0"))


def gust_lean(force: float, mass: float, gravity: float) -> float:
    """Return the largest angle [rad] of a load that hung plumb when a steady horizontal force [N]
    came at once: 2 atan(F/(m g)), exactly, since it swings about its new rest.
    """
    return 2.0 * wind_lean(force, mass, gravity)
