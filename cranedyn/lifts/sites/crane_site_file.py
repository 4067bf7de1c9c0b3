"""Sites with several cranes from TOML files; errors name line and field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.dynamics.converters import ROUNDING, Converters, converters
from cranedyn.errors import CraneError, UnknownName, quoted
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.planning.site import KINDS
from cranedyn.lifts.planning.site_file import (
    SITE_TABLES,
    SOLIDS,
    chart_of,
    example_path,
    read_fields,
    solids_of,
)
from cranedyn.lifts.planning.site_table import FieldLines, SiteTable, crane_values, names_of
from cranedyn.lifts.sites.brakes import REACTION, Brakes, brakes
from cranedyn.lifts.sites.crane_site import DISTANCE, SWING, CraneSite, Station, check_names
from cranedyn.lifts.sites.guard import gentle
from cranedyn.lifts.sites.lift_list import (
    ANY_CRANE,
    HOOKING_TIME,
    ListedLift,
    check_lift,
    check_order,
)
from cranedyn.lifts.sites.working_wind import CALM, WorkingWind
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.model.machines import read_machine

SITES = Path(__file__).parent / "examples"
"""Folder of the example sites."""

EXAMPLES = ("two_towers", "four_towers", "luffing_between")
"""Names of the example sites."""

SHIFT_EXAMPLES = ("two_towers_shift", "two_bridges")
"""Names of the example sites that list lifts."""

_FIELDS = (
    "name",
    "position",
    "heading",
    "runway",
    "kind",
    "model",
    "machine",
    "urdf",
    "values",
    "drives",
    "brakes",
    "reaction",
    "chart",
    "report",
)
"""Fields of a crane."""

SITE_FIELDS = ("ground", "distance", "swing", "wind", "hooking", "crane", *SOLIDS)
"""Fields and tables of a site beside its name and the lifts of a shift."""

_LIFT_FIELDS = ("name", "crane", "from", "to", "load", "earliest", "after", "report")
"""Fields of a lift."""

DEFAULT_KIND = "tower"
"""Kind of a crane that names no other one, of `cranedyn.lifts.planning.site.KINDS`."""

MODEL_ENDING = "_crane"
"""What `model`, another name of `kind`, has behind the kind."""

_ENTERED_BY = {
    "brakes": ["brakes"],
    "reaction": ["reaction"],
    "drives": ["drives", "machine"],
    "crane": ["machine", "urdf", "values"],
    "load": ["urdf"],
}
"""Fields of a crane by which somebody enters what is assumed of it, by the names of
`Station.entered`."""

_CONVERTER_BRAKING_SHARE = 0.9
"""Largest deceleration of brakes by converters, over the acceleration of the drive."""


def crane_site_path(path: str | Path) -> Path:
    """Return the path of a site with several cranes, or of the example site of that name.

    Raises:
        UnknownName: If there is no example of that name.
    """
    return example_path(path, SITES, (*EXAMPLES, *SHIFT_EXAMPLES), "site")


def read_crane_site(path: str | Path) -> CraneSite:
    """Read a site with several cranes from a TOML file, or the example site of that name.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line. Also if two cranes or obstacles have one name, or towers overlap.
        UnknownName: If there is no file and no example of that name.
    """
    top, lines = _read_tables(path)
    return crane_site_of(top, lines)


def lists_lifts(path: str | Path) -> bool:
    """Return whether a site lists lifts of its own, without making its cranes.

    Raises:
        DataError: If it cannot be read, is no TOML, or has an unknown field.
        UnknownName: If there is no file and no example of that name.
    """
    top, _ = _read_tables(path)
    return bool(top.values.get("lift"))


def _read_tables(path: str | Path) -> tuple[SiteTable, FieldLines]:
    """Return the whole of the file of a site, and the lines of its fields."""
    return read_fields(crane_site_path(path), [*SITE_FIELDS, "lift", "report"])


def crane_site_of(top: SiteTable, lines: FieldLines) -> CraneSite:
    """Return the site of a file that may have further tables, such as a load of two cranes.

    Args:
        top: The whole of the file.
        lines: Lines of all its fields.

    Raises:
        DataError: As `read_crane_site`.
    """
    ground = top.number("ground", 0.0)
    solids = tuple(solids_of(top, lines, ground))
    entries = top.tables("crane", _FIELDS, lines)
    lift_entries = top.tables("lift", _LIFT_FIELDS, lines)
    for table in (top, *entries, *lift_entries):
        _check_report(table)
    stations: list[Station] = []
    for entry in entries:
        stations.append(_station(entry, ground, stations))
        with _blamed_on(entry, "name"):
            check_names([station.name for station in stations])
    if not stations:
        top.fail("crane", "there is none; write each as [[crane]].")
    distance = top.number("distance", DISTANCE, "m", "> 0")
    swing = top.angle("swing", SWING, "0.1 to 28")
    wind = _working_wind(top, lines)
    entered = frozenset({"distance", "swing", "wind"} & top.values.keys())
    name = top.text("name", top.path.stem)

    # The site is made of one crane, of two, and so on: the crane with which that fails first is the
    # one whose line the error names.
    for count, entry in enumerate(entries, start=1):
        with _blamed_on(entry, "runway" if "runway" in entry.values else "position"):
            site = CraneSite(
                name, tuple(stations[:count]), ground, distance, swing, solids, wind, entered
            )
    for station in stations:
        with _blamed_on(top, "wind"):
            gentle(station, swing, wind)
    lifts = _lifts(lift_entries, [x.name for x in stations])
    hooking_time = top.number("hooking", HOOKING_TIME, "s", "0 to 3600")
    return replace(site, lifts=lifts, hooking_time=hooking_time)


def _check_report(table: SiteTable) -> None:
    """Check that `report` holds tables of a site with one crane; what is in them is checked when
    the site of a lift is read.
    """
    report = table.values.get("report", {})
    if not isinstance(report, dict):
        table.fail("report", "it must hold tables of a lift plan, such as [report.people].")
    for name, value in report.items():
        # The line of a table of its own is known by its whole name.
        field = f"report.{name}"
        if name not in SITE_TABLES:
            table.fail(field, UnknownName("table", name, SITE_TABLES))
        if not isinstance(value, dict):
            table.fail(field, "it must be a table.")


def _lifts(entries: Sequence[SiteTable], cranes: Sequence[str]) -> tuple[ListedLift, ...]:
    """Return the lifts of a shift.

    Args:
        entries: Tables of the lifts.
        cranes: Names of the cranes of the site.
    """
    by_name: dict[str, ListedLift] = {}
    for entry in entries:
        lift = _lift(entry)
        with _blamed_on(entry, "name" if lift.name in by_name else "crane"):
            check_lift(lift, cranes, by_name)
        by_name[lift.name] = lift
    lifts = tuple(by_name.values())

    # A lift may wait for one that stands below it.
    for entry, lift in zip(entries, lifts, strict=True):
        for name in lift.after:
            if name not in by_name:
                entry.fail("after", UnknownName("lift", name, list(by_name)))
    # The line of the error is that of the first entry that closes a circle with those above it.
    for count, entry in enumerate(entries, start=1):
        known = {lift.name for lift in lifts[:count]}
        listed = [replace(x, after=tuple(known & {*x.after})) for x in lifts[:count]]
        with _blamed_on(entry, "after"):
            check_order(listed)
    return lifts


def _lift(entry: SiteTable) -> ListedLift:
    """Return the lift of a table."""
    return ListedLift(
        name=entry.text("name"),
        crane=entry.text("crane", ANY_CRANE),
        start=np.array(entry.numbers("from", 3, "-1e7 to 1e7")),
        goal=np.array(entry.numbers("to", 3, "-1e7 to 1e7")),
        load=entry.optional_number("load", "kg", "> 0"),
        earliest=entry.number("earliest", 0.0, "s", ">= 0"),
        after=tuple(entry.take("after", names_of, [])),
    )


@contextmanager
def _blamed_on(entry: SiteTable, field: str) -> Iterator[None]:
    """Raise an error of the block again with the line of a field; one that has a line already stays
    as it is.

    Raises:
        DataError: If the block raises a `CraneError`.
    """
    try:
        yield
    except CraneError as error:
        if str(error).startswith(f"{entry.path}, "):
            raise
        entry.fail(field, error)


def _working_wind(top: SiteTable, lines: FieldLines) -> WorkingWind:
    """Return the wind that the file enters, or none at all."""
    if "wind" not in top.values:
        return CALM
    values = top.values["wind"]
    if not isinstance(values, dict):
        top.fail("wind", "it must be a table with gust [m/s] and area [m²].")
    places = lines.get(("wind", 0), {"": top.lines.get("wind", 1)})
    table = SiteTable(top.path, "wind", values, places, ["gust", "area"])
    return WorkingWind(
        gust=table.number("gust", unit="m/s", allowed=">= 0"),
        area=table.number("area", unit="m²", allowed="> 0"),
    )


def _station(entry: SiteTable, ground: float, above: Sequence[Station]) -> Station:
    """Return the crane of a table at its place.

    Args:
        entry: The table.
        ground: Height of the ground [m], on which the crane stands by default.
        above: The cranes of the tables above it, on whose runways it may travel.
    """
    name = entry.text("name")
    runway = entry.text("runway", "")
    place = [0.0, 0.0, ground]
    heading = -math.pi / 2.0
    if runway:
        # Where its runway is, unless the table says so again.
        owners = {station.name: station for station in above}
        if runway not in owners:
            known = f"there are {', '.join(owners)}" if owners else "there is none"
            entry.fail(
                "runway",
                f"{quoted(runway)} is no crane that stands above this one in the file; {known}.",
            )
        place = owners[runway].foot.tolist()
        heading = owners[runway].heading
    foot = np.array(entry.numbers("position", 3, "-1e7 to 1e7", place))
    heading = entry.angle("heading", heading)

    # The field that says which crane it is: errors of its model are blamed on that.
    model_field = "name"
    for field in ("values", "kind", "model", "machine", "urdf"):
        if field in entry.values:
            model_field = field
    with _blamed_on(entry, model_field):
        crane, limits = _crane(entry)
        limits |= _of_drives(entry, "drives", crane, ["rates", "accelerations"])
        jerks = {}
        for symbol, acceleration in limits.get("accelerations", {}).items():
            jerks[symbol] = acceleration / ROUNDING
        drives = converters(crane, **limits, jerks=jerks)  # type: ignore[arg-type]
    with _blamed_on(entry, "brakes"):
        brake, drives = _brakes(entry, crane, drives)
    chart = None
    chart_file = chart_of(entry)
    if chart_file is not None:
        with _blamed_on(entry, "chart"):
            chart = read_chart(chart_file)
    with _blamed_on(entry, "reaction"):
        entered = _entered(entry)
        station = Station(name, crane, foot, heading, drives, brake, chart, entered, runway)
    with _blamed_on(entry, model_field):
        # Capsules are made when they are first asked for, which is here: not every crane has them.
        _ = station.bodies
    return station


def _entered(entry: SiteTable) -> frozenset[str]:
    """Return which values of a crane somebody entered, by the names of `Station.entered`."""
    entered = set()
    for value, fields in _ENTERED_BY.items():
        if entry.values.keys() & set(fields):
            entered.add(value)
    if "payload_mass" in entry.values.get("values", {}):
        entered.add("load")
    if _has_own_brakes(entry) and "tolerances" in entry.values["brakes"]:
        entered.add("tolerances")
    return frozenset(entered)


def _crane(entry: SiteTable) -> tuple[Crane, dict[str, dict[str, float]]]:
    """Return a crane, and accelerations of its drives that its machine states."""
    values: dict[str, Any] = entry.take("values", crane_values, {})
    kinds = [key for key in ("kind", "model", "machine", "urdf") if key in entry.values]
    if len(kinds) > 1:
        entry.fail(kinds[1], f"{kinds[0]} is given, too; leave one out.")
    if "urdf" in kinds:
        if values:
            entry.fail("values", "an own URDF has none; leave them out.")
        urdf = entry.file("urdf")
        if urdf.suffix == ".xacro":
            entry.fail("urdf", "a xacro file runs code; expand it to a URDF.")
        return load_crane(urdf), {}
    if "machine" in kinds:
        machine = entry.text("machine")
        crane = load_crane(machine=machine, values=values)
        return crane, {"accelerations": read_machine(machine).accelerations}
    kind = _kind(entry)
    # None is the tower crane.
    description = None if kind == DEFAULT_KIND else XACRO.with_name(f"{kind}_crane.urdf.xacro")
    return load_crane(description, values=values or None), {}


def _kind(entry: SiteTable) -> str:
    """Return the kind of a crane of this project, from the field `kind` or `model`."""
    field = "model" if "model" in entry.values else "kind"
    ending = MODEL_ENDING if field == "model" else ""
    known = [kind + ending for kind in KINDS]
    return entry.choice(field, known, DEFAULT_KIND + ending).removesuffix(ending)


def _has_own_brakes(entry: SiteTable) -> bool:
    """Return whether a crane gives its brakes by numbers and not by name."""
    return isinstance(entry.values.get("brakes"), dict)


def _brakes(entry: SiteTable, crane: Crane, drives: Converters) -> tuple[Brakes, Converters]:
    """Return the brakes of a crane, and its converters as they are with these brakes.

    Brakes by converters are limited by what the converters of this crane accelerate. With other
    brakes, of gears or given by numbers, it is the other way round: the drives ramp no faster than
    the brakes stop, so that a simulated crane brakes no better than is assumed.
    """
    has_own_brakes = _has_own_brakes(entry)
    kind: Any = "converters" if has_own_brakes else entry.text("brakes", "converters")
    brake = brakes(crane, kind, reaction=entry.number("reaction", REACTION, "s", "> 0"))
    if kind == "converters" and not has_own_brakes:
        limit = _CONVERTER_BRAKING_SHARE * drives.accelerations
        return replace(brake, decelerations=np.minimum(brake.decelerations, limit)), drives

    if has_own_brakes:
        given = _of_drives(entry, "brakes", crane, ["decelerations", "tolerances"])
        if "decelerations" not in given:
            entry.fail("brakes", "decelerations is missing.")
        brake = replace(brake, decelerations=np.array([*given["decelerations"].values()]))
        if "tolerances" in given:
            brake = replace(brake, tolerances=np.array([*given["tolerances"].values()]))
        if (brake.decelerations > drives.accelerations).any():
            entry.fail("brakes", "decelerations are more than the drives accelerate.")
    accelerations = np.minimum(drives.accelerations, brake.decelerations)
    jerks = accelerations / ROUNDING
    return brake, replace(drives, accelerations=accelerations, jerks=jerks)


def _of_drives(
    entry: SiteTable, field: str, crane: Crane, keys: list[str]
) -> dict[str, dict[str, float]]:
    """Return numbers of the drives from a field that is a table, such as "drives".

    Args:
        entry: Table of the crane.
        field: The field.
        crane: The crane.
        keys: Names of the lists that the field may have, with one number for each drive; those of
            drives that turn are in degrees.

    Returns:
        The numbers in SI units, by the name of the list and by the symbol of the drive.
    """
    values = entry.values.get(field, {})
    if not isinstance(values, dict):
        entry.fail(field, f"it must be a table with {' and '.join(keys)}.")
    table = SiteTable(entry.path, field, values, {"": entry.lines.get(field, 1)}, keys)
    driven = crane.layout.driven
    numbers: dict[str, dict[str, float]] = {}
    for key in keys:
        if key not in values:
            continue
        numbers[key] = {}
        for joint, value in zip(driven, table.numbers(key, len(driven), "> 0"), strict=True):
            scale = math.radians(1.0) if joint.unit == "rad" else 1.0
            numbers[key][joint.symbol] = scale * value
    return numbers
