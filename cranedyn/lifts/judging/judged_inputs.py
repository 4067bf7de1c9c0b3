"""What the judgement of a lift rests on: values from the site, from the caller, or by default.

`resolve_inputs` takes each value from where it was entered and notes its origin. A value that
nobody entered is a default of this program: the lift is computed with it, so that its numbers can
be seen, and the judgement is incomplete.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cranedyn.assumptions import Assumption, Origin
from cranedyn.lifts.judging.analysis import JudgedInputs, Requirements
from cranedyn.lifts.judging.chart import Chart, read_chart
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.ground_lift import CREEP_SPEED, ROPE_STIFFNESS, stands_at
from cranedyn.lifts.planning.perturbed import DRAG_COEFFICIENT, Spread, drag_area
from cranedyn.lifts.planning.plan_assumptions import (
    other_estimates,
    plan_assumptions,
    with_estimates,
)
from cranedyn.lifts.planning.plan_details import WEIGHT_TOLERANCES
from cranedyn.lifts.planning.site import Site
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits

DEFAULT_WIND = 8.0
"""Gust that a lift is tried in where nobody entered one [m/s]."""

DEFAULT_GUST_SWING = math.radians(5.0)
"""Largest angle of the rope in gusts where nobody entered one [rad]."""

DEFAULT_RISK = 0.01
"""Largest probability that a perturbed lift comes too close where nobody entered one."""

CHART_FIELD = "[crane] chart"
"""The field of a site that names its chart."""

SHIPPED_CHART = "laboratory"
"""The chart of the tower crane that comes with the package."""

CHART_COVERS = frozenset(
    {
        "payload_mass", "payload_inertia", "payload_ixx", "payload_iyy", "payload_izz",
        "lug_height", "mast_height", "pivot_height", "total_height", "hoist_min", "hoist_max",
        "counter_jib", "mast_width", "foot_width", "slew_init", "trolley_init", "hoist_init",
        "slew_limit", "damp_slew", "damp_trolley", "damp_swing", "damp_hoist",
    }
)  # fmt: skip
"""Arguments of the shipped crane that its chart is valid for whatever they are.

A chart says what may hang at which radius. The load itself, the height of the mast, the length of
the cable, how far the drives go, where they start, and damping do not change that. The counter-jib
is drawn and weighs nothing. With another jib or trolley, or another force of a drive, it is another
crane to a chart."""


@dataclass(frozen=True)
class Requirement:
    """A requirement that a caller or a site may enter, and else has a default.

    Attributes:
        attribute: Name of the attribute of `Requirements`.
        name: The quantity, in words.
        unit: Unit in which it is shown.
        scale: The number in that unit over the number in the unit of `Requirements`.
        default: Value where nobody entered one, in the unit of `Requirements`.
        option: Option of the command with which a caller enters it.
        field: Field of a site's file in which a site enters it.
    """

    attribute: str
    name: str
    unit: str
    scale: float
    default: float
    option: str
    field: str

    def resolve(self, given: float | None, of_site: float | None) -> tuple[float, Assumption]:
        """Return the value with its origin: the caller's, or that of the site, or the default."""
        if given is not None:
            return given, self._assumption(given, Origin.ENTERED, self.option)
        if of_site is not None:
            return of_site, self._assumption(of_site, Origin.ENTERED, self.field)
        return self.default, self._assumption(self.default, Origin.DEFAULT, self.field)

    def _assumption(self, value: float, origin: Origin, where: str) -> Assumption:
        return Assumption(self.name, f"{self.scale * value:.4g} {self.unit}", origin, where)


GUST = Requirement("wind", "gust to bear", "m/s", 1.0, DEFAULT_WIND, "--wind", "[wind] gust")

GUST_SWING = Requirement(
    "swing",
    "largest angle of the rope in gusts",
    "°",
    math.degrees(1.0),
    DEFAULT_GUST_SWING,
    "--swing",
    "[wind] swing",
)

RISK = Requirement(
    "risk",
    "largest probability of coming too close",
    "%",
    100.0,
    DEFAULT_RISK,
    "--risk",
    "[lift] risk",
)


def is_shipped_crane(crane: Crane) -> bool:
    """Return whether a crane is that of the package, as far as a load chart is concerned."""
    arguments = crane.record.get("arguments")
    return isinstance(arguments, dict) and arguments.keys() <= CHART_COVERS


def resolve_inputs(
    site: Site,
    crane: Crane,
    limits: Limits,
    requirements: Requirements,
    chart: Chart | None = None,
    falls: int | None = None,
) -> JudgedInputs:
    """Return the values that a lift is judged with; what the caller gives comes before what the
    site enters, and that before a default. Only for the limits of the drives, which the caller has
    chosen already, it is the other way round, see `cranedyn.lifts.judging.judgement.judge`.

    Args:
        site: The site.
        crane: The crane.
        limits: Limits of the drives: those of the site, if it enters any.
        requirements: Requirements, with None where they are those of the site.
        chart: Load chart; None for that of the site or, for the shipped crane, the shipped one.
        falls: Number of falls; None for that of the site or the fewest of the chart.

    Raises:
        UnknownName: If the chart has no such number of falls.
        DataError: If the chart that the site names cannot be read.
    """
    assumptions = plan_assumptions(site, crane, limits)
    resolved = {}
    for requirement, given, of_site in (
        (GUST, requirements.wind, site.gust),
        (GUST_SWING, requirements.swing, site.gust_swing),
        (RISK, requirements.risk, site.risk),
    ):
        value, assumption = requirement.resolve(given, of_site)
        resolved[requirement.attribute] = value
        assumptions.append(assumption)
    spread, spread_assumptions = _spread(site)
    assumptions += spread_assumptions
    assumptions.append(_wind_on_load(site, crane))
    chart, chart_assumption = _chart(site, crane, chart)
    assumptions.append(chart_assumption)
    if chart is not None:
        falls, falls_assumption = _falls(site, chart, falls)
        assumptions.append(falls_assumption)
    else:
        falls = None
    assumptions += _lift_off(site, falls)
    assumptions += other_estimates(site, assumptions)
    return JudgedInputs(
        replace(requirements, **resolved),  # type: ignore[arg-type]
        spread,
        chart,
        falls,
        tuple(with_estimates(site, assumptions)),
    )


def _lift_off(site: Site, falls: int | None) -> list[Assumption]:
    """Return what lift-off and set-down rest on; nothing where the load hangs at both ends."""
    if not site.is_tower or not (stands_at(site.start) or stands_at(site.goal)):
        return []
    count = falls or site.falls or 1
    on_falls = "one fall" if count == 1 else f"{count} falls"
    return [
        Assumption(
            "stiffness EA of the rope, at lift-off and set-down",
            f"{count * ROPE_STIFFNESS:.3g} N on {on_falls}, no mass",
            Origin.ASSUMED,
        ),
        Assumption(
            "largest speed of lift-off and set-down", f"{CREEP_SPEED:g} m/s", Origin.ASSUMED
        ),
    ]


def _spread(site: Site) -> tuple[Spread, list[Assumption]]:
    """Return how far lifts may differ from the plan, and the origin of each of its numbers."""
    default = Spread()
    load, load_assumption = _load_tolerance(site)
    largest_delay = site.spread.get("late", max(default.late))
    delays = tuple(largest_delay * share for share in (0.0, 0.25, 0.5, 1.0))
    spread = replace(
        default,
        load=load,
        cable=site.spread.get("cable", default.cable),
        wind=site.spread.get("wind", default.wind),
        gust=site.spread.get("gust", default.gust),
        late=delays,
    )
    assumptions = [load_assumption]
    for key, name, value, field in (
        ("cable", "error of the measured cable length", f"±{spread.cable:g} m", "cable"),
        ("wind", "steady wind during the lift, up to", f"{spread.wind:g} m/s", "wind"),
        ("gust", "gust above it, up to", f"{spread.gust:g} m/s", "gust"),
        ("late", "delay of the sensors, up to", f"{1e3 * largest_delay:g} ms", "delay"),
    ):
        origin = Origin.ENTERED if key in site.spread else Origin.DEFAULT
        assumptions.append(Assumption(name, value, origin, f"[uncertainty] {field}"))
    return spread, assumptions


def _load_tolerance(site: Site) -> tuple[float, Assumption]:
    """Return by which share of its mass the load may be heavier or lighter, with its origin: as
    entered, or as it follows from how the mass is known. A load of which nobody says either is
    computed as an estimated one, which is a default.
    """
    source = site.details.load.source
    field = "[uncertainty] mass"
    if "load" in site.spread:
        tolerance = site.spread["load"]
        origin = Origin.ENTERED
    elif source is not None:
        tolerance = WEIGHT_TOLERANCES[source]
        origin = Origin.COMPUTED
        field = "[load] source"
    else:
        tolerance = WEIGHT_TOLERANCES["estimated"]
        origin = Origin.DEFAULT
        field = "[load] source or [uncertainty] mass"
    known = "" if source is None else f", {source}"
    value = f"±{100.0 * tolerance:.3g} %{known}"
    return tolerance, Assumption("tolerance of the load's mass", value, origin, field)


def _wind_on_load(site: Site, crane: Crane) -> Assumption:
    """Return the area that the wind acts on, as far as somebody entered it."""
    load = site.details.load
    area = drag_area(clearance_of(crane, site))
    entered = load.area is not None and load.drag is not None
    parts = "as entered" if entered else _drag_parts(load.area, load.drag)
    return Assumption(
        "area of the load to the wind, times its drag coefficient",
        f"{area:.3g} m², {parts}",
        Origin.ENTERED if entered else Origin.COMPUTED,
        "[load] area, drag",
    )


def _drag_parts(area: float | None, drag: float | None) -> str:
    """Return what an area times drag coefficient is made of, where not both were entered."""
    of_area = "the largest section of its box" if area is None else f"the area entered, {area:g} m²"
    of_drag = f"a coefficient of {DRAG_COEFFICIENT:g}" if drag is None else f"{drag:g} as entered"
    return f"{of_area} times {of_drag}"


def _chart(site: Site, crane: Crane, given: Chart | None) -> tuple[Chart | None, Assumption]:
    """Return the chart with its origin: the caller's, or that of the site, or for the shipped crane
    the shipped one.
    """
    if given is not None:
        return given, Assumption("load chart", given.name, Origin.ENTERED, "--chart")
    if site.chart is not None:
        chart = read_chart(site.chart)
        return chart, Assumption("load chart", chart.name, Origin.ENTERED, CHART_FIELD)
    if is_shipped_crane(crane):
        chart = read_chart(SHIPPED_CHART)
        return chart, Assumption("load chart", chart.name, Origin.SHIPPED)
    return None, Assumption("load chart", "none of this crane", Origin.DEFAULT, CHART_FIELD)


def _falls(site: Site, chart: Chart, given: int | None) -> tuple[int, Assumption]:
    """Return the number of falls with its origin: the caller's, or that of the site, or the fewest
    of the chart.

    Raises:
        UnknownName: If the chart has no such number of falls.
    """
    if given is not None:
        count = given
        origin = Origin.ENTERED
        field = "--falls"
    elif site.falls is not None:
        count = site.falls
        origin = Origin.ENTERED
        field = "[rigging] falls"
    else:
        # Where the chart has one number of falls, nobody has to choose.
        only_one = len(chart.counts) == 1
        count = chart.counts[0]
        origin = Origin.COMPUTED if only_one else Origin.DEFAULT
        field = "[rigging] falls"
    chart.of_falls(count)  # refuses a number that the chart does not have
    return count, Assumption("falls of the rope", f"{count}", origin, field)
