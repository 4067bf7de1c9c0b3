"""Tandem lifts from TOML files: a site with cranes and obstacles, the load, its ropes and its way;
errors name line and field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cranedyn.disturbances.wind import Speed, cosine_gust, steady
from cranedyn.errors import CraneError
from cranedyn.lifts.planning.site_file import read_fields
from cranedyn.lifts.planning.site_table import SiteTable, names_of
from cranedyn.lifts.sites.crane_site_file import SITE_FIELDS, crane_site_of
from cranedyn.lifts.tandem.judgement import TandemRequirements
from cranedyn.lifts.tandem.load import LUGS, TandemLoad, TandemRope
from cranedyn.lifts.tandem.load_wind import DRAG_COEFFICIENT, LoadWind
from cranedyn.lifts.tandem.plan import TandemLift, TandemPlan, plan_tandem
from cranedyn.lifts.tandem.way import plan_around

_TANDEM_FIELDS = ("cranes", "from", "to", "heading", "via", "inclination", "falls")
"""Fields of the table of the lift."""

_LOAD_FIELDS = ("mass", "size", "lugs", "inertia", "damping")
"""Fields of the table of the load."""

_ROPE_FIELDS = ("stiffness", "damping")
"""Fields of the table of the ropes."""

_WIND_FIELDS = ("speed", "towards", "gust", "gust_at", "gust_lasts", "drag")
"""Fields of the table of the wind on the load."""

_TABLES = {
    "tandem": _TANDEM_FIELDS,
    "load": _LOAD_FIELDS,
    "rope": _ROPE_FIELDS,
    "load_wind": _WIND_FIELDS,
}
"""Tables of a tandem lift beside those of its site."""


class TandemJob(NamedTuple):
    """A tandem lift as a file describes it.

    Attributes:
        name: Name of the site.
        lift: The lift.
        start: Place of the centre of mass at the start in the frame of the site [m].
        goal: Its place at the end [m].
        yaw: Angle of the load's X axis from that of the site [rad].
        via: Places between them [m]; None for a way that the planner finds.
        wind: Wind on the load; None if none is entered.
        requirements: What is required of it.
    """

    name: str
    lift: TandemLift
    start: tuple[float, ...]
    goal: tuple[float, ...]
    yaw: float
    via: Sequence[Sequence[float]] | None
    wind: LoadWind | None
    requirements: TandemRequirements

    def plan(self) -> TandemPlan:
        """Return the plan: along the places that are given, or around obstacles.

        Raises:
            NoWay: If there is no way, see `cranedyn.lifts.tandem.way.plan_around`.
            CraneError: As `cranedyn.lifts.tandem.plan.plan_tandem`.
        """
        if self.via is not None:
            return plan_tandem(self.lift, self.start, self.goal, yaw=self.yaw, via=self.via)
        return plan_around(
            self.lift,
            self.start,
            self.goal,
            yaw=self.yaw,
            distance=self.requirements.distance,
        )


def read_tandem(path: str | Path) -> TandemJob:
    """Read a tandem lift from a TOML file; "cranedyn template tandem" writes one to begin with.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line.
    """
    top, lines = read_fields(Path(path), [*SITE_FIELDS, *_TABLES])
    for name in _TABLES:
        if name not in top.values and name != "load_wind":
            top.fail(name, f"there is none; a tandem lift needs a table [{name}].")
    tables = {name: top.top_table(name, fields, lines) for name, fields in _TABLES.items()}
    site = crane_site_of(top, lines)
    tandem = tables["tandem"]
    names = tandem.take("cranes", names_of)
    if len(names) != LUGS:
        tandem.fail("cranes", f"allowed are two names of cranes; there are {len(names)}.")
    load = _load(tables["load"])
    rope_table = tables["rope"]
    rope = TandemRope(
        rope_table.number("stiffness", unit="N", allowed="> 0"),
        rope_table.number("damping", 0.0, "N s/m", ">= 0"),
    )
    try:
        lift = TandemLift(site, (names[0], names[1]), load, rope)
    except CraneError as error:
        tandem.fail("cranes", error)
    return TandemJob(
        name=site.name,
        lift=lift,
        start=tuple(tandem.numbers("from", 3)),
        goal=tuple(tandem.numbers("to", 3)),
        yaw=tandem.angle("heading"),
        via=tandem.points("via") if "via" in tandem.values else None,
        wind=_wind(tables["load_wind"]),
        requirements=TandemRequirements(
            inclination=tandem.optional_angle("inclination", "0 to 90"),
            falls=tandem.optional_whole("falls"),
        ),
    )


def _load(table: SiteTable) -> TandemLoad:
    """Return the load."""
    lugs = table.points("lugs")
    if len(lugs) != LUGS:
        table.fail(
            "lugs", f"allowed are two places from the centre of mass; there are {len(lugs)}."
        )
    try:
        return TandemLoad(
            mass=table.number("mass", unit="kg", allowed="> 0"),
            size=table.numbers("size", 3, "> 0"),
            lugs=lugs,
            inertia=table.optional_numbers("inertia", 3, "kg m²", "> 0"),
            damping=table.number("damping", 0.0, "N m s/rad", ">= 0"),
        )
    except CraneError as error:
        if str(error).startswith(str(table.path)):
            raise
        table.fail("size", error)


def _wind(table: SiteTable) -> LoadWind | None:
    """Return the wind on the load: steady, or with a gust; None if none is entered."""
    if not table.values:
        return None
    speed: Speed = steady(table.number("speed", unit="m/s", allowed=">= 0"))
    if "gust" in table.values:
        speed = cosine_gust(
            speed,
            table.number("gust", unit="m/s", allowed=">= 0"),
            at=table.number("gust_at", unit="s", allowed=">= 0"),
            lasts=table.number("gust_lasts", unit="s", allowed="> 0"),
        )
    return LoadWind(
        speed,
        math.radians(table.number("towards", unit="degrees")),
        table.number("drag", DRAG_COEFFICIENT, "", ">= 0"),
    )
