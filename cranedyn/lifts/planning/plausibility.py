"""Whether what somebody entered for a lift can be meant, and which mistake is likely.

A number in the wrong unit is a number like any other: 3.6 for a load of 3.6 tonnes is a load of
3.6 kg, and a plan for it is right about the wrong load. So every quantity that a site enters has
two ranges. Outside of the *possible* one it cannot be meant and is refused. Outside of the *usual*
one it is unusual, which is said and does not stop anybody: cranes of a laboratory lift 0.1 kg, and
the largest ones 20,000 t.

Sizes of cranes differ by a factor of a thousand, so that ranges in metres and kilograms alone catch
little. Ratios are sharper: the density of the load, the speed of the jib's tip, the distance of a
place over the reach of the crane.

Where a usual conversion brings a value from outside of its usual range into it, the sentence asks
for that. What cannot be seen in this way: pounds for kilograms, or a mass with or without its
rigging.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.errors import DataError
from cranedyn.lifts.planning.plan_assumptions import arguments_of
from cranedyn.lifts.planning.plan_details import LoadDetails, PlanDetails, Slings, Spreader
from cranedyn.lifts.planning.rigging import sling_angle
from cranedyn.lifts.planning.site import MAX_SWING, MIN_SWING, Site, SiteDrive

Conversions = Mapping[str, float]
"""Factor that makes a value right which was entered in another unit, by a phrase for that unit."""

MILLIMETRES: Conversions = {"millimetres": 1e-3, "centimetres": 1e-2}
"""Units that are mistaken for metres."""

TONNES: Conversions = {"tonnes": 1e3}
"""Unit that is mistaken for kilograms."""

METRES_PER_MINUTE: Conversions = {"metres per minute": 1.0 / 60.0, "millimetres per second": 1e-3}
"""Units that are mistaken for metres per second."""

RADIANS: Conversions = {"radians": math.degrees(1.0)}
"""Unit that is mistaken for degrees."""

KILONEWTONS: Conversions = {"kilonewtons": 1e3}
"""Unit that is mistaken for newtons."""

SMALLEST_OBSTACLE = 5e-3
"""Largest side of an obstacle over the reach of the crane, below which it cannot be meant."""

FARTHEST_PLACE = 3.0
"""Distance of a place of the lift from the foot over the reach of the crane, beyond which it cannot
be meant."""

FARTHEST_USUAL_OBSTACLE = 3.0
"""Distance of an obstacle from the foot over the reach of the crane, beyond which it has no effect
on the lift, which is unusual."""

FARTHEST_OBSTACLE = 100.0
"""Distance of an obstacle from the foot over the reach of the crane, beyond which it cannot be
meant."""


@dataclass(frozen=True)
class Quantity:
    """What a site enters, with the range that it can have.

    Attributes:
        name: What it is, to begin a sentence with.
        unit: Its unit.
        possible: Range outside of which it cannot be meant.
        usual: Range outside of which it is unusual.
        conversions: Units in which it may have been entered by mistake.
    """

    name: str
    unit: str
    possible: tuple[float, float]
    usual: tuple[float, float]
    conversions: Conversions


@dataclass(frozen=True)
class Finding:
    """A value that cannot be meant, or is unusual.

    Attributes:
        table, field: Where it was entered in the file of a site, such as "load" and "mass"; of an
            obstacle the table is empty and the field its name.
        refused: Whether it cannot be meant.
        sentence: What was entered, what is usual, and the mistake that is likely.
    """

    table: str
    field: str
    refused: bool
    sentence: str

    def __str__(self) -> str:
        """Return the sentence with the field that it is about."""
        return f"[{self.table}] {self.field}: {self.sentence}" if self.table else self.sentence


# Ranges of absolute values. The lower ends are those of cranes on a laboratory's bench: 0.085 kg,
# ways of 0.4 m, ropes of 0.2 m. The upper ends: the largest tower cranes lift 240 t at booms of
# 100 m, the largest ring crane 5,000 t, the largest gantry 20,000 t.
LOAD_MASS = Quantity("The mass of the load", "kg", (1e-3, 2.5e7), (0.05, 1.5e6), TONNES)
LOAD_SIDE = Quantity("A side of the load", "m", (1e-3, 500.0), (0.01, 100.0), MILLIMETRES)
RIGGING_MASS = Quantity("The mass of rigging", "kg", (0.0, 1e6), (0.0, 1e5), {})
DISTANCE = Quantity("The distance to keep", "m", (0.0, 50.0), (0.05, 5.0), MILLIMETRES)
SWING = Quantity(
    "The swing",
    "degrees",
    (math.degrees(MIN_SWING), math.degrees(MAX_SWING)),
    (0.2, 10.0),
    RADIANS,
)
GUST_SWING = Quantity("The swing allowed in gusts", "degrees", (0.0, 45.0), (0.2, 10.0), RADIANS)
BASE_SPACING = Quantity("The spacing of the corners", "m", (0.02, 150.0), (0.1, 20.0), MILLIMETRES)
BASE_MASS = Quantity("The mass of the base", "kg", (0.0, 1e8), (0.0, 5e6), {})
PERMITTED = Quantity(
    "The force that the ground may bear under a corner",
    "kN",
    (0.0, 1e5),
    (1.0, 2e4),
    {"newtons": 1e-3},
)
ARM_MASS = Quantity("The mass of an arm", "kg", (0.0, 1e7), (0.0, 1e6), {})
ARM_LENGTH = Quantity("A length of an arm", "m", (0.0, 500.0), (0.02, 150.0), MILLIMETRES)

# A tower crane turns at 0.6 to 1 rpm, 3.6 to 6 °/s, small mobile cranes at 2 rpm, a bench crane of
# 1 m at 57 °/s. Trolleys go up to 2 m/s and those of container cranes 4 m/s; hoists 3.3 m/s.
TURN_RATE = Quantity("The rate of a drive", "°/s", (0.0, 360.0), (0.3, 60.0), RADIANS)
RATE = Quantity("The rate of a drive", "m/s", (0.0, 10.0), (0.002, 4.8), METRES_PER_MINUTE)
DEGREES_PER_RPM = 6.0
"""One revolution per minute in degrees per second."""

SLOWEST_SLEW = 1.5
"""Rate of a slew below which it is more likely one in revolutions per minute [°/s]."""

SLOWEST_SLEW_RPM = 0.3
"""Slowest slew of a crane [rpm]; what is slower is not usual in either unit."""

TURN_ACCELERATION = Quantity(
    "The acceleration of a drive", "°/s²", (0.0, 360.0), (0.05, 120.0), RADIANS
)
ACCELERATION = Quantity(
    "The acceleration of a drive", "m/s²", (0.0, 9.80665), (0.005, 3.0), METRES_PER_MINUTE
)
EFFORT = Quantity("The effort of a drive", "N or N m", (0.0, 1e10), (0.5, 1e9), KILONEWTONS)
COORDINATE = Quantity("A coordinate", "m", (-1e7, 1e7), (-1e6, 1e6), MILLIMETRES)
GROUND = Quantity("The height of the ground", "m", (-9e3, 9e3), (-450.0, 6e3), MILLIMETRES)

# Cranes stop at 14 to 20 m/s, and those that must work in high wind at 28. No wind at all reaches
# 100 m/s, and between the two a requirement is one that no lift will meet.
WIND = Quantity(
    "The gust",
    "m/s",
    (0.0, 100.0),
    (2.0, 20.0),
    {"kilometres per hour": 1.0 / 3.6, "miles per hour": 0.447},
)
WIND_LIMIT = Quantity(
    "The wind limit",
    "m/s",
    (0.1, 100.0),
    (3.0, 25.0),
    {"kilometres per hour": 1.0 / 3.6, "miles per hour": 0.447},
)
RISK = Quantity("The risk", "%", (0.0, 100.0), (0.0, 10.0), {})

# What a lift plan says beside the motion. Slings are 0.5 to 20 m long, chains lift 1 to 30 t a leg
# and the largest round slings some hundred; guides end at 60° from the vertical.
SLING_LIMIT = Quantity("The working load limit of a leg", "kg", (0.1, 1e7), (50.0, 5e5), TONNES)
SET_LIMIT = Quantity("The working load limit of a set", "kg", (0.1, 1e7), (50.0, 1e6), TONNES)
SPREADER_LIMIT = Quantity(
    "The working load limit of the spreader", "kg", (0.1, 1e8), (50.0, 5e6), TONNES
)
HOOK_LIMIT = Quantity("The rated load of the hook block", "kg", (0.1, 1e8), (50.0, 5e6), TONNES)
SLING_LENGTH = Quantity("The length of a leg", "m", (1e-3, 500.0), (0.1, 50.0), MILLIMETRES)
SLING_ANGLE = Quantity("The angle of a leg", "degrees", (0.0, 85.0), (3.0, 60.0), RADIANS)
HOOK_HEIGHT = Quantity("The height of the hook block", "m", (1e-3, 50.0), (0.1, 8.0), MILLIMETRES)
SPREADER_HEIGHT = Quantity("The height of the spreader", "m", (0.0, 50.0), (0.0, 10.0), MILLIMETRES)
JIB_LENGTH = Quantity("The length of the jib", "m", (0.01, 500.0), (0.2, 150.0), MILLIMETRES)
COUNTER_BALLAST = Quantity("The counter-ballast", "kg", (0.0, 1e8), (100.0, 5e6), TONNES)
CENTRAL_BALLAST = Quantity("The central ballast", "kg", (0.0, 1e8), (100.0, 5e6), TONNES)
CORNER_FORCE = Quantity(
    "The force of a corner",
    "kN",
    (0.0, 1e5),
    (1.0, 2e4),
    {"newtons": 1e-3, "tonnes": 9.81},
)
HEIGHT_UNDER_HOOK = Quantity(
    "The height under hook", "m", (0.01, 1500.0), (0.2, 300.0), MILLIMETRES
)
PRESSURE = Quantity(
    "The permitted bearing pressure",
    "kPa",
    (1.0, 1e5),
    (30.0, 5e3),
    {"pascals": 1e-3, "tonnes per square metre": 9.81, "newtons per square millimetre": 1e3},
)
MAT_SIDE = Quantity("A side of the mat", "m", (0.01, 50.0), (0.2, 10.0), MILLIMETRES)
CHART_SHARE = Quantity(
    "The share of the chart that may be used", "%", (1.0, 100.0), (50.0, 100.0), {"parts of 1": 100}
)
AREA = Quantity(
    "The area of the load",
    "m²",
    (1e-6, 1e5),
    (1e-3, 1e3),
    {"square millimetres": 1e-6, "square centimetres": 1e-4},
)
DRAG = Quantity("The drag coefficient of the load", "", (0.05, 5.0), (0.4, 2.5), {})

SMALLEST_AREA_SHARE = 0.2
"""Area of the load over the largest section of its box below which the area is unusual, even for a
frame of few bars."""

LARGEST_AREA_SHARE = 1.05
"""Area of the load over the largest section of its box above which it is larger than its box: the
rest is rounding."""

FARTHEST_LIFTING_POINT = 1.5
"""Coordinate of a lifting point over half of the side of the box around the load, beyond which it
is unusual: lugs stand out a little."""

FARTHEST_POINT_OF_LOAD = 20.0
"""The same, beyond which it cannot be meant."""

SPAN_TOLERANCE = 0.05
"""Difference of a span and of the distance of the rails that is rounding [m]."""

CHAIN_LIMITS = (
    *(1120.0, 1500.0, 2000.0, 3150.0, 5300.0, 8000.0, 10000.0, 11200.0, 12500.0, 15000.0, 16000.0),
    *(20000.0, 21200.0, 25000.0, 31500.0),
    *(1400.0, 1900.0, 2500.0, 4000.0, 6700.0, 10000.0, 16000.0, 19000.0, 26500.0),
)
"""Working load limits of one leg of chain [kg]: grade 8 by EN 818-4, then grade 10 as makers sell
it; both read in catalogues."""

CHAIN_SET_LIMITS = {
    2: (1600.0, 2120.0, 2800.0, 4250.0, 7500.0, 11200.0, 17000.0, 21200.0, 30000.0, 45000.0),
    3: (2360.0, 3150.0, 4250.0, 6700.0, 11200.0, 17000.0, 26500.0, 31500.0, 45000.0, 67000.0),
}
"""Working load limits on the tags of sets of two legs of chain, and of three or four, up to 45°
from the vertical [kg], for grade 8 by EN 818-4."""

ANGLE_TOLERANCE = math.radians(5.0)
"""Difference of the entered angle of a sling and that of its length, above which one of them is
wrong [rad]."""

# The density of a box around a load: air has 1.2 kg/m³ and the densest metal 22,600. Foam has 10 to
# 30, an empty container 60, solid steel 7,850.
DENSITY = Quantity("The density of the load", "kg/m³", (1.3, 23e3), (10.0, 8e3), {})

# Tips of the largest booms run at 7 m/s. A load that is stopped at 25 m/s rises by v²/2g = 32 m,
# above the jib of most cranes.
TIP_SPEED = Quantity("The speed of the tip of the jib", "m/s", (0.0, 25.0), (0.0, 10.0), {})


def judge_value(
    quantity: Quantity, value: float, table: str, field: str, name: str = ""
) -> Iterator[Finding]:
    """Yield a finding where a value lies outside of a range.

    Args:
        quantity: The quantity with its ranges.
        value: What was entered, in the quantity's unit.
        table: Table of the site's file.
        field: Field of the table.
        name: Another name for the sentence.
    """
    low, high = quantity.usual
    if low <= value <= high:
        return
    possible = quantity.possible
    refused = not possible[0] <= value <= possible[1]  # a NaN is refused
    allowed = possible if refused else quantity.usual
    kind = "possible" if refused else "usual"
    sentence = (
        f"{name or quantity.name} is {_number(value)} {quantity.unit}; {kind} is "
        f"{_number(allowed[0])} to {_number(allowed[1])} {quantity.unit}."
    )
    for unit, factor in quantity.conversions.items():
        if low <= value * factor <= high:
            sentence += f" Is {_number(value)} in {unit}? Then write {_number(value * factor)}."
            break
    yield Finding(table, field, refused, sentence)


def _number(value: float) -> str:
    """Return a number to read: thousands apart, and six digits at most."""
    return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.6g}"


def unusual_or_refuse(found: Iterable[Finding]) -> tuple[str, ...]:
    """Return sentences about values that are unusual, each once.

    Raises:
        DataError: If a value cannot be meant.
    """
    found = list(found)
    for finding in found:
        if finding.refused:
            raise DataError(str(finding))
    return tuple(dict.fromkeys(map(str, found)))


def findings(site: Site, reach: tuple[float, float] | None = None) -> list[Finding]:
    """Return what cannot be meant of a site, and what is unusual.

    Args:
        site: The site. What it does not enter has a usual value by default and is no finding.
        reach: Smallest and largest radius of the crane's trolley [m]; None if unknown, then the
            places of the lift are not judged.
    """
    return [
        *_of_obstacles(site, reach),
        *_of_load(site),
        *_of_drives(site, reach),
        *_of_structure(site),
        *_of_runway(site),
        *_of_rigging(site),
        *_of_plan(site),
        *_of_papers_beside_model(site),
        *_of_places(site, reach),
    ]


def _of_obstacles(site: Site, reach: tuple[float, float] | None) -> Iterator[Finding]:
    """Yield obstacles in a wrong unit or frame, which a proof would not meet anywhere."""
    if reach is None:
        return
    _, largest_radius = reach
    foot = np.asarray(site.foot, dtype=float)[:2]
    for solid in site.solids:
        largest = float(np.ptp(solid.vertices, axis=0).max())
        if largest < SMALLEST_OBSTACLE * largest_radius:
            sentence = (
                f"The obstacle {solid.name} is {_number(largest)} m large, too small to be one. "
                "Is it in another unit?"
            )
            yield Finding("", solid.name, True, sentence)
        # Distance in plan of the box around it from the foot.
        low = solid.vertices[:, :2].min(axis=0)
        high = solid.vertices[:, :2].max(axis=0)
        x, y = np.maximum(np.maximum(low - foot, foot - high), 0.0)
        gap = float(np.hypot(x, y))
        if gap > FARTHEST_USUAL_OBSTACLE * largest_radius:
            sentence = (
                f"The obstacle {solid.name} is {_number(gap)} m from the foot of the crane, whose "
                f"trolley reaches {_number(largest_radius)} m: it has no effect. Is it in "
                "millimetres, or in another frame than [crane] position?"
            )
            yield Finding("", solid.name, gap > FARTHEST_OBSTACLE * largest_radius, sentence)


def _of_load(site: Site) -> Iterator[Finding]:
    """Yield what is unusual of load and rigging: masses, sides and density."""
    mass = site.crane.get("payload_mass")
    if mass is not None:
        mass = float(mass) - sum(site.rigging.values())  # the crane's load includes the rigging
        yield from judge_value(LOAD_MASS, mass, "load", "mass")
    for name, value in site.rigging.items():
        yield from judge_value(RIGGING_MASS, value, "rigging", name)
    if site.load is None:
        return
    sides = np.ptp(site.load, axis=0)
    for side in sides.tolist():
        yield from judge_value(LOAD_SIDE, side, "load", "size")
    if mass is None:
        return
    volume = float(sides.prod())
    if not volume > 0.0:
        return  # a flat load is a finding of its size
    for finding in judge_value(DENSITY, mass / volume, "load", "mass"):
        sentence = f"{finding.sentence[:-1]}: {_number(mass)} kg in a box of {_number(volume)} m³."
        low, high = DENSITY.usual
        if low <= 1e3 * mass / volume <= high:
            sentence += f" Is {_number(mass)} in tonnes? Then write {_number(1e3 * mass)}."
        elif low <= 1e9 * mass / volume <= high:
            sentence += " Is the size in millimetres?"
        yield Finding(finding.table, finding.field, finding.refused, sentence)


def _of_drives(site: Site, reach: tuple[float, float] | None) -> Iterator[Finding]:
    """Yield what is unusual of the drives: rates, accelerations, speed of the tip, and efforts."""
    if site.limits is None:
        return
    rates = site.limits.rates
    accelerations = site.limits.accelerations
    yield from _of_motion_limits(site.drives, rates, TURN_RATE, RATE, "rates")
    yield from _of_motion_limits(
        site.drives, accelerations, TURN_ACCELERATION, ACCELERATION, "accelerations"
    )
    for drive, rate in zip(site.drives, rates, strict=False):
        if drive.name == "slew":
            yield from _of_slew(math.degrees(rate))
        if drive.name == "slew" and reach is not None:
            yield from judge_value(TIP_SPEED, rate * reach[1], "drives", "rates")
    for drive in site.drives:
        effort = site.crane.get(f"{drive.name}_effort")
        if effort is not None:
            name = f"The effort of the {drive.name}"
            yield from judge_value(EFFORT, float(effort), "drives", "efforts", name)


def _of_slew(rate: float) -> Iterator[Finding]:
    """Yield a rate of the slew [°/s] that is more likely one in revolutions per minute."""
    if not SLOWEST_SLEW_RPM <= rate < SLOWEST_SLEW:
        return
    sentence = (
        f"The rate of the slew is {_number(rate)} °/s, {_number(rate / DEGREES_PER_RPM)} rpm, and "
        f"few cranes slew at less than {_number(SLOWEST_SLEW)} °/s. Is {_number(rate)} in "
        f"revolutions per minute? Then write {_number(DEGREES_PER_RPM * rate)}."
    )
    yield Finding("drives", "rates", False, sentence)


def _of_motion_limits(
    drives: Sequence[SiteDrive],
    values: Sequence[float],
    of_turning: Quantity,
    of_sliding: Quantity,
    field: str,
) -> Iterator[Finding]:
    """Yield what is unusual of the rates or accelerations of drives in a field of [drives].

    Args:
        drives: The drives.
        values: Their rates or accelerations.
        of_turning: The quantity of a drive that turns, in degrees.
        of_sliding: The quantity of a drive that slides.
        field: The field.
    """
    # Not strict: a wrong number of limits is refused where the limits meet their crane.
    for drive, value in zip(drives, values, strict=False):
        quantity = of_turning if drive.turns else of_sliding
        name = quantity.name.replace("a drive", f"the {drive.name}")
        shown = math.degrees(value) if drive.turns else value
        yield from judge_value(quantity, shown, "drives", field, name)


def _of_structure(site: Site) -> Iterator[Finding]:
    """Yield what is unusual of base, jib and counter-jib."""
    if site.base is not None:
        yield from judge_value(BASE_SPACING, site.base.spacing, "base", "spacing")
        yield from judge_value(BASE_MASS, site.base.mass, "base", "mass")
        if site.base.permitted is not None:
            permitted = site.base.permitted / 1e3
            yield from judge_value(PERMITTED, permitted, "base", "permitted")
    for arm in site.arms:
        table = "jib" if arm.centre >= 0.0 else "counter_jib"
        name = f"The {table.replace('_', '-')}"
        yield from judge_value(ARM_MASS, arm.mass, table, "mass", f"{name}'s mass")
        yield from judge_value(ARM_LENGTH, abs(arm.centre), table, "centre", f"{name}'s centre")
    length = site.crane.get("counter_jib")
    if length:
        name = "The length of the counter-jib"
        yield from judge_value(ARM_LENGTH, float(length), "counter_jib", "length", name)


def _of_runway(site: Site) -> Iterator[Finding]:
    """Yield rails that are not as far apart as the bridge of this package's crane spans."""
    described = site.description
    if site.runway is None or described is None or described.kind != "overhead":
        return
    span = float(site.crane.get("span", arguments_of(site)["span"].default))
    first, second = site.runway.rails
    if abs(abs(first - second) - span) > SPAN_TOLERANCE:
        sentence = (
            f"The rails are {abs(first - second):g} m apart, and the bridge spans {span:g} m: "
            "span in [crane.values]."
        )
        yield Finding("runway", "rails", True, sentence)


def _of_rigging(site: Site) -> Iterator[Finding]:
    """Yield what is unusual of slings, spreader and hook block, and of the points of the load."""
    details = site.details
    slings = details.slings
    spreader = details.spreader or Spreader()
    for quantity, value, table, field in (
        (SLING_LIMIT, slings.limit, "rigging.slings", "limit"),
        (SET_LIMIT, slings.set_limit, "rigging.slings", "set_limit"),
        (SLING_LENGTH, slings.length, "rigging.slings", "length"),
        (HOOK_HEIGHT, details.hook_block_height, "rigging", "hook_height"),
        (HOOK_LIMIT, details.hook_block_limit, "rigging", "hook_limit"),
        (SPREADER_HEIGHT, spreader.height, "rigging.spreader", "height"),
        (SPREADER_LIMIT, spreader.limit, "rigging.spreader", "limit"),
    ):
        if value is not None:
            yield from judge_value(quantity, value, table, field)
    yield from _of_legs(details)
    if site.load is not None:
        half = np.ptp(site.load, axis=0) / 2.0
        yield from _of_points(details.load, half)


def is_limit_of_a_set(slings: Slings) -> bool:
    """Return whether the limit that was entered for one leg of a chain sling can only be that of a
    set: it is on the tags of `CHAIN_SET_LIMITS` and not among `CHAIN_LIMITS`.
    """
    if slings.type != "chain" or slings.limit is None or slings.number is None:
        return False
    of_sets = CHAIN_SET_LIMITS.get(min(slings.number, 3), ())
    return slings.limit in of_sets and slings.limit not in CHAIN_LIMITS


def _of_legs(details: PlanDetails) -> Iterator[Finding]:
    """Yield what is unusual of angle and number of the legs of the slings."""
    slings = details.slings
    table = "rigging.slings"
    if slings.angle is not None and slings.number != 1:
        yield from judge_value(SLING_ANGLE, math.degrees(slings.angle), table, "angle")
        of_length = sling_angle(replace(details, slings=replace(slings, angle=None)))
        if of_length is not None and abs(of_length - slings.angle) > ANGLE_TOLERANCE:
            sentence = (
                f"The angle of a leg is {math.degrees(slings.angle):.0f}°; from its length and the "
                f"lifting points it is {math.degrees(of_length):.0f}° from the vertical. Is it "
                "from the horizontal?"
            )
            yield Finding(table, "angle", False, sentence)
    if is_limit_of_a_set(slings):
        assert slings.limit is not None
        sentence = (
            f"The limit of one leg is {_number(slings.limit)} kg, which no single leg of chain "
            f"of grade 8 or 10 has, and a set of {slings.number} legs has on its tag. Is it that "
            "of the set? Then write it as set_limit."
        )
        yield Finding(table, "limit", False, sentence)
    count = len(details.load.lifting_points)
    if count and slings.number not in (None, count) and details.spreader is None:
        sentence = f"There are {slings.number} legs and {count} lifting points of the load."
        yield Finding(table, "number", False, sentence)


def _of_points(load: LoadDetails, half: np.ndarray) -> Iterator[Finding]:
    """Yield a centre of gravity outside of the load, lifting points far from it, and an area that
    its box does not have.

    Args:
        load: The details of the load.
        half: Half of each side of the box around the load [m], shape (3,).
    """
    if load.centre is not None and (np.abs(load.centre) > half).any():
        sentence = (
            f"The centre of gravity {_point(load.centre)} m is outside of the load, whose box "
            f"reaches {_point(half)} m from its middle. It is entered from the middle of the box, "
            "in metres."
        )
        yield Finding("load", "centre", True, sentence)
    for point in load.lifting_points:
        share = float((np.abs(point) / half).max())
        if share > FARTHEST_LIFTING_POINT:
            sentence = (
                f"The lifting point {_point(point)} m is outside of the load, whose box reaches "
                f"{_point(half)} m from its middle. Is it in millimetres, or from a corner?"
            )
            yield Finding("load", "lifting_points", share > FARTHEST_POINT_OF_LOAD, sentence)
    if load.area is not None:
        # The largest vertical section is that through opposite edges.
        section = 4.0 * math.hypot(half[0], half[1]) * float(half[2])
        share = load.area / section
        if not SMALLEST_AREA_SHARE <= share <= LARGEST_AREA_SHARE:
            sentence = (
                f"The area of the load is {_number(load.area)} m²; the largest section of its box "
                f"has {_number(section)} m²."
            )
            yield Finding("load", "area", False, sentence)


def _point(point: Sequence[float] | np.ndarray) -> str:
    """Return a point to read."""
    return f"({', '.join(_number(float(coordinate)) for coordinate in point)})"


def _of_plan(site: Site) -> Iterator[Finding]:
    """Yield what is unusual of the papers of the crane, the ground, and the limits of the site."""
    crane = site.details.crane
    ground = site.details.ground
    limits = site.details.limits
    load = site.details.load
    mats = (ground.mat_length, ground.mat_width)
    share = None if limits.chart_share is None else 100.0 * limits.chart_share
    in_service = None if crane.corner_in_service is None else crane.corner_in_service / 1e3
    out_of_service = None
    if crane.corner_out_of_service is not None:
        out_of_service = crane.corner_out_of_service / 1e3
    pressure = None if ground.permitted_pressure is None else ground.permitted_pressure / 1e3
    for quantity, value, table, field in (
        (JIB_LENGTH, crane.jib_length, "crane", "jib_length"),
        (COUNTER_BALLAST, crane.counter_ballast, "crane", "counter_ballast"),
        (CENTRAL_BALLAST, crane.central_ballast, "crane", "central_ballast"),
        (CORNER_FORCE, in_service, "crane", "corner_in_service"),
        (CORNER_FORCE, out_of_service, "crane", "corner_out_of_service"),
        (HEIGHT_UNDER_HOOK, crane.height_under_hook, "crane", "height_under_hook"),
        (WIND_LIMIT, crane.wind_limit, "crane", "wind_limit"),
        (WIND_LIMIT, limits.wind, "limits", "wind"),
        (CHART_SHARE, share, "limits", "chart_share"),
        (PRESSURE, pressure, "ground", "permitted_pressure"),
        (MAT_SIDE, mats[0], "ground", "mat"),
        (MAT_SIDE, mats[1], "ground", "mat"),
        (AREA, load.area, "load", "area"),
        (DRAG, load.drag, "load", "drag"),
    ):
        if value is not None:
            yield from judge_value(quantity, value, table, field)


def _of_papers_beside_model(site: Site) -> Iterator[Finding]:
    """Yield what the papers of the crane say and the crane that moves cannot have: a plan for one
    crane that was computed for another is none.
    """
    papers = site.details.crane
    balance = [arm.mass for arm in site.arms if arm.centre < 0.0]
    bounds = (
        (
            "jib_length",
            "The length of the jib",
            papers.jib_length,
            site.crane.get("trolley_max"),
            "m, and trolley_max in the values of [crane], the way of the trolley on it",
            False,
        ),
        (
            "height_under_hook",
            "The largest height of the hook",
            papers.height_under_hook,
            site.crane.get("pivot_height"),
            "m, and pivot_height in the values of [crane], where the rope begins",
            True,
        ),
        (
            "counter_ballast",
            "The counter-ballast",
            papers.counter_ballast,
            sum(balance) if balance else None,
            "kg, and the mass of [counter_jib], of which it is a part",
            True,
        ),
        (
            "central_ballast",
            "The central ballast",
            papers.central_ballast,
            None if site.base is None else site.base.mass,
            "kg, and the mass of [base], of which it is a part",
            True,
        ),
    )
    for field, name, said, modelled, of_what, at_most in bounds:
        if said is None or modelled is None:
            continue
        if said > modelled if at_most else said < modelled:
            limit = "more" if at_most else "less"
            yield Finding(
                "crane",
                field,
                True,
                f"{name} is {_number(said)} {of_what}, is {_number(modelled)}: it cannot be "
                f"{limit}. One of them is of another crane or setup.",
            )


def _of_places(site: Site, reach: tuple[float, float] | None) -> Iterator[Finding]:
    """Yield what is unusual of the places of ground, crane and lift, and of what a lift allows."""
    yield from judge_value(GROUND, site.ground, "ground", "height")
    for value in np.asarray(site.foot, dtype=float).tolist():
        yield from judge_value(COORDINATE, value, "crane", "position")
    yield from judge_value(DISTANCE, site.distance, "lift", "distance")
    yield from judge_value(SWING, math.degrees(site.swing), "lift", "swing")
    if site.risk is not None:
        yield from judge_value(RISK, 100.0 * site.risk, "lift", "risk")
    for name, value in site.spread.items():
        if value == 0.0:
            # The fields of two of them have other names in the file.
            field = {"load": "mass", "late": "delay"}.get(name, name)
            sentence = "It is zero, as if nothing were uncertain."
            yield Finding("uncertainty", field, False, sentence)
    if site.gust is not None:
        yield from judge_value(WIND, site.gust, "wind", "gust")
    if site.gust_swing is not None:
        yield from judge_value(GUST_SWING, math.degrees(site.gust_swing), "wind", "swing")
    if reach is None:
        return
    for field, point in (("from", site.start), ("to", site.goal)):
        if point is None:
            continue
        end = "start" if field == "from" else "goal"
        yield from _of_place(site, reach, point, field, f"The {end} of the lift")


def _of_place(
    site: Site, reach: tuple[float, float], point: np.ndarray, field: str, name: str
) -> Iterator[Finding]:
    """Yield a finding where a place is so far out of the crane's reach that its unit or frame is
    probably wrong.
    """
    _, largest = reach
    radius = _distance_in_plan(site.foot, point)
    if radius <= FARTHEST_PLACE * largest:
        return  # the planner says by how much it is out of reach
    sentence = (
        f"{name} is {_number(radius)} m from the foot of the crane, whose trolley reaches "
        f"{_number(largest)} m. {_question_about_place(site, reach, point)}"
    )
    yield Finding("lift", field, True, sentence)


def _question_about_place(site: Site, reach: tuple[float, float], point: np.ndarray) -> str:
    """Return the question which mistake was made with a place that the crane does not reach."""
    least, largest = reach
    for unit, factor in MILLIMETRES.items():
        if least <= _distance_in_plan(site.foot, factor * point) <= largest:
            return f"Is {_number(float(np.abs(point[:2]).max()))} in {unit}?"
    return "Is it in the same frame as [crane] position?"


def _distance_in_plan(foot: np.ndarray, point: np.ndarray) -> float:
    """Return the horizontal distance of a point from the foot of the crane [m]."""
    x, y = point[:2] - foot[:2]
    return float(np.hypot(x, y))
