"""The tables of a site's file that say what a lift plan says beside the motion: job, people,
papers of the crane, rigging, ground, limits (docs/howto/plan_lift.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import get_args

from cranedyn.lifts.planning.plan_details import (
    WEIGHT_SOURCES,
    CraneDocuments,
    GroundDetails,
    Job,
    LiftInShift,
    LoadDetails,
    People,
    PlanDetails,
    SiteLimits,
    Slings,
    SlingType,
    Spreader,
)
from cranedyn.lifts.planning.rigging import SET_FACTORS
from cranedyn.lifts.planning.site_table import POINT_RANGE, FieldLines, SiteTable

SLING_TYPES: tuple[SlingType, ...] = get_args(SlingType)
"""What slings may be made of."""


def _fields_of(kind: type) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass, which are those of its table in the file."""
    return tuple(field.name for field in dataclasses.fields(kind))


JOB_FIELDS = _fields_of(Job)
"""Fields of [job]."""

PEOPLE_FIELDS = _fields_of(People)
"""Fields of [people]."""

CRANE_FIELDS = _fields_of(CraneDocuments)
"""Fields of [crane] that are its papers."""

LOAD_FIELDS = _fields_of(LoadDetails)
"""Fields of [load] beside its size and its mass."""

RIGGING_FIELDS = (
    *("hook", "hook_height", "hook_limit", "slings", "spreader", "falls"),
    *("tag_lines", "examined"),
)
"""Fields of [rigging]. `slings` is a mass, or the table [rigging.slings]."""

SLING_FIELDS = ("mass", "type", "number", "angle", "length", "limit", "set_limit", "certificate")
"""Fields of [rigging.slings]."""

SPREADER_FIELDS = ("mass", "name", "height", "limit")
"""Fields of [rigging.spreader]."""

GROUND_FIELDS = ("permitted_pressure", "pressure_source", "mat", "north")
"""Fields of [ground] beside its height."""

LIMIT_FIELDS = _fields_of(SiteLimits)
"""Fields of [limits]."""

SAFETY_FIELDS = ("exclusion", "in_zone", "trial_lift", "contingency")
"""Fields of [safety]."""

SHIFT_FIELDS = _fields_of(LiftInShift)
"""Fields of [shift]."""


def rigging_tables(rigging: SiteTable, lines: FieldLines) -> dict[str, SiteTable]:
    """Return the tables [rigging.slings] and [rigging.spreader], by these names; empty where they
    are left out.

    Raises:
        DataError: If one of them has an unknown field, or the spreader is no table.
    """
    spreader = rigging.values.get("spreader", {})
    if not isinstance(spreader, dict):
        rigging.fail("spreader", "write it as a table, [rigging.spreader].")
    return {
        "rigging.slings": rigging.child("slings", SLING_FIELDS, lines),
        "rigging.spreader": rigging.child("spreader", SPREADER_FIELDS, lines),
    }


def rigging_masses(tables: Mapping[str, SiteTable]) -> dict[str, float]:
    """Return the masses of the rigging [kg], as far as they are entered: of "hook", "slings" and
    "spreader". That of the slings stands in [rigging] or in [rigging.slings].
    """
    rigging = tables["rigging"]
    masses = {}
    if "hook" in rigging.values:
        masses["hook"] = rigging.number("hook", unit="kg", allowed=">= 0")
    if "slings" in rigging.values and not isinstance(rigging.values["slings"], dict):
        masses["slings"] = rigging.number("slings", unit="kg", allowed=">= 0")
    for part in ("slings", "spreader"):
        table = tables[f"rigging.{part}"]
        if "mass" in table.values:
            masses[part] = table.number("mass", unit="kg", allowed=">= 0")
    return masses


def details_of(tables: Mapping[str, SiteTable]) -> PlanDetails:
    """Return what the tables of a site enter for its lift plan.

    Args:
        tables: The tables by name, those within [rigging] among them.

    Raises:
        DataError: If a value is of another type, out of its range or unknown, with its line.
    """
    safety = tables["safety"]
    return PlanDetails(
        job=Job(**_texts(tables["job"], JOB_FIELDS)),
        people=People(**_texts(tables["people"], PEOPLE_FIELDS)),
        crane=_crane(tables["crane"]),
        load=_load(tables["load"]),
        slings=_slings(tables["rigging.slings"]),
        spreader=_spreader(tables["rigging.spreader"]),
        hook_block_height=tables["rigging"].optional_number("hook_height", "m", "> 0"),
        hook_block_limit=tables["rigging"].optional_number("hook_limit", "kg", "> 0"),
        ground=_ground(tables["ground"]),
        limits=_limits(tables["limits"]),
        tag_lines=tables["rigging"].optional_text("tag_lines"),
        rigging_examined=tables["rigging"].optional_text("examined"),
        exclusion=safety.optional_text("exclusion"),
        in_zone=safety.named_texts("in_zone"),
        trial_lift=safety.optional_text("trial_lift"),
        contingency=safety.texts("contingency"),
        shift=_shift(tables["shift"]),
    )


def _shift(shift: SiteTable) -> LiftInShift | None:
    """Return what the plan of a shift says of the lift; None if it is of none."""
    if not shift.values:
        return None
    texts = tuple(field for field in SHIFT_FIELDS if field != "others")
    return LiftInShift(**_texts(shift, texts), others=shift.texts("others"))  # type: ignore[arg-type]


def _texts(table: SiteTable, fields: tuple[str, ...]) -> dict[str, str | None]:
    """Return the texts of fields, by name."""
    return {field: table.optional_text(field) for field in fields}


def _crane(crane: SiteTable) -> CraneDocuments:
    """Return the papers of the crane."""
    return CraneDocuments(
        maker=crane.optional_text("maker"),
        type=crane.optional_text("type"),
        serial=crane.optional_text("serial"),
        configuration=crane.optional_text("configuration"),
        jib_length=crane.optional_number("jib_length", "m", "> 0"),
        counter_ballast=crane.optional_number("counter_ballast", "kg", ">= 0"),
        height_under_hook=crane.optional_number("height_under_hook", "m", "> 0"),
        chart_page=crane.optional_text("chart_page"),
        chart_date=crane.optional_text("chart_date"),
        wind_limit=crane.optional_number("wind_limit", "m/s", "> 0"),
        wind_measured=crane.optional_text("wind_measured"),
        central_ballast=crane.optional_number("central_ballast", "kg", ">= 0"),
        corner_in_service=crane.optional_kilonewtons("corner_in_service"),
        corner_out_of_service=crane.optional_kilonewtons("corner_out_of_service"),
        out_of_service=crane.optional_text("out_of_service"),
        examined=crane.optional_text("examined"),
    )


def _load(load: SiteTable) -> LoadDetails:
    """Return what is known of the load beside its mass and its size."""
    centre = load.optional_numbers("centre", 3, allowed=POINT_RANGE)
    return LoadDetails(
        source=load.optional_choice("source", WEIGHT_SOURCES),
        centre=None if centre is None else (centre[0], centre[1], centre[2]),
        lifting_points=load.points("lifting_points"),
        area=load.optional_number("area", "m²", "> 0"),
        drag=load.optional_number("drag", "", "0.05 to 5"),
    )


def _slings(slings: SiteTable) -> Slings:
    """Return the slings; the file gives their angle in degrees from the vertical.

    Raises:
        DataError: If both the limit of one leg and that of the set are entered, since one of them
            is then not what its name says, or a set has a number of legs that no standard has.
    """
    if "limit" in slings.values and "set_limit" in slings.values:
        slings.fail(
            "set_limit",
            "limit is given, too; leave one out. limit is that of one leg in a straight pull, "
            "set_limit that of all legs together, as the tag of a set has it.",
        )
    number = slings.optional_whole("number")
    if "set_limit" in slings.values and number is not None and number not in SET_FACTORS:
        slings.fail(
            "set_limit",
            f"a set has {min(SET_FACTORS)} to {max(SET_FACTORS)} legs, and number is {number}; "
            "enter the limit of one leg as limit.",
        )
    return Slings(
        type=slings.optional_choice("type", SLING_TYPES),
        number=number,
        angle=slings.optional_angle("angle", "0 to 85"),
        length=slings.optional_number("length", "m", "> 0"),
        limit=slings.optional_number("limit", "kg", "> 0"),
        certificate=slings.optional_text("certificate"),
        set_limit=slings.optional_number("set_limit", "kg", "> 0"),
    )


def _spreader(spreader: SiteTable) -> Spreader | None:
    """Return the spreader; None if nothing of it is entered."""
    if not spreader.values:
        return None
    return Spreader(
        name=spreader.optional_text("name"),
        height=spreader.optional_number("height", "m", ">= 0"),
        limit=spreader.optional_number("limit", "kg", "> 0"),
    )


def _ground(ground: SiteTable) -> GroundDetails:
    """Return what carries the crane; the file gives the pressure in kilopascals."""
    pressure = ground.optional_number("permitted_pressure", "kPa", "> 0")
    mat = ground.optional_numbers("mat", 2, allowed="> 0")
    return GroundDetails(
        permitted_pressure=None if pressure is None else 1e3 * pressure,
        pressure_source=ground.optional_text("pressure_source"),
        mat_length=None if mat is None else mat[0],
        mat_width=None if mat is None else mat[1],
        north=ground.optional_angle("north", "-360 to 360"),
    )


def _limits(limits: SiteTable) -> SiteLimits:
    """Return the limits of the site; the file gives the share of the chart in percent."""
    share = limits.optional_number("chart_share", "%", "> 0")
    return SiteLimits(
        chart_share=None if share is None else share / 100.0,
        wind=limits.optional_number("wind", "m/s", "> 0"),
        over_people=limits.optional_flag("over_people"),
        over_services=limits.optional_flag("over_services"),
        blind=limits.optional_flag("blind"),
    )
