"""Sites with several cranes from TOML files; errors name line and field."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.dynamics.converters import ROUNDING, Converters, converters
from cranedyn.errors import CraneError, DataError, quoted
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.planning.site_file import SOLIDS, read_fields, site_path, solids_of
from cranedyn.lifts.planning.site_table import SiteTable, crane_values
from cranedyn.lifts.sites.brakes import REACTION, Brakes, brakes
from cranedyn.lifts.sites.crane_site import DISTANCE, SWING, CraneSite, Station, check_names
from cranedyn.lifts.sites.guard import gentle
from cranedyn.lifts.sites.working_wind import CALM, WorkingWind
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.model.machines import read_machine

SITES = Path(__file__).parent / "examples"
"""Folder of the example sites."""

EXAMPLES = ("two_towers", "four_towers", "luffing_between")
"""Names of the example sites."""

_FIELDS = "name position heading model machine urdf values drives brakes reaction chart".split()
_MODELS = ("tower_crane", "luffing_crane")
_ENTERED_BY = {
    "brakes": ["brakes"],
    "reaction": ["reaction"],
    "drives": ["drives", "machine"],
    "crane": ["machine", "urdf", "values"],
    "load": ["urdf"],
}
"""Fields of a crane by which somebody enters what it assumes."""


def read_crane_site(path: str | Path) -> CraneSite:
    """Read a site with several cranes from a TOML file, or the example site of that name.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line. Also if two cranes or obstacles have one name, or towers overlap.
        UnknownName: If there is no file and no example of that name.
    """
    path = site_path(path, SITES, EXAMPLES)
    top, lines = read_fields(path, ["ground", "distance", "swing", "wind", "crane", *SOLIDS])
    ground = top.number("ground", 0.0)
    solids = tuple(solids_of(top, lines, ground))
    entries = top.tables("crane", _FIELDS, lines)
    stations: list[Station] = []
    for entry in entries:
        stations.append(_station(entry, ground))
        try:
            check_names([station.name for station in stations])
        except DataError as error:
            entry.fail("name", error)
    if not stations:
        top.fail("crane", "there is none; write each as [[crane]].")
    distance = top.number("distance", DISTANCE, "m", "> 0")
    swing = top.angle("swing", SWING, "0.1 to 28")
    wind = _working_wind(top, lines)
    entered = frozenset({"distance", "swing", "wind"} & top.values.keys())
    name = top.text("name", path.stem)
    for count in range(1, len(stations) + 1):
        try:
            site = CraneSite(
                name, tuple(stations[:count]), ground, distance, swing, solids, wind, entered
            )
        except CraneError as error:
            entries[count - 1].fail("position", error)
    for station in stations:
        try:
            gentle(station, swing, wind)
        except CraneError as error:
            top.fail("wind", error)
    return site


def _working_wind(top: SiteTable, lines: dict[tuple[str, int], dict[str, int]]) -> WorkingWind:
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


def _station(entry: SiteTable, ground: float) -> Station:
    name = entry.text("name")
    field = "name"
    foot = np.array(entry.numbers("position", 3, "-1e7 to 1e7", [0.0, 0.0, ground]))
    heading = entry.angle("heading", -math.pi / 2.0)
    try:
        own = field = next((k for k in ("urdf", "machine", "values") if k in entry.values), field)
        crane, limits = _crane(entry)
        limits |= _of_drives(entry, "drives", crane, ["rates", "accelerations"])
        slopes = limits.get("accelerations", {}).items()
        jerks = {symbol: value / ROUNDING for symbol, value in slopes}
        drives = converters(crane, **limits, jerks=jerks)  # type: ignore[arg-type]
        field = "brakes"
        own_brakes = isinstance(entry.values.get("brakes"), dict)
        brake, drives = _brakes(entry, crane, drives)
        field = "chart"
        chart = read_chart(entry.file(field)) if field in entry.values else None
        field = "reaction"
        entered = {
            value for value, fields in _ENTERED_BY.items() if entry.values.keys() & set(fields)
        }
        if "payload_mass" in entry.values.get("values", {}):
            entered.add("load")
        if own_brakes and "tolerances" in entry.values["brakes"]:
            entered.add("tolerances")
        station = Station(name, crane, foot, heading, drives, brake, chart, frozenset(entered))
        field = own
        _ = station.bodies
    except CraneError as error:
        if str(error).startswith(f"{entry.path}, "):
            raise
        entry.fail(field, error)
    return station


def _crane(entry: SiteTable) -> tuple[Crane, dict[str, dict[str, float]]]:
    """Return a crane, and accelerations of its drives that its machine states."""
    values: dict[str, Any] = entry.take("values", crane_values, {})
    kinds = [key for key in ("model", "machine", "urdf") if key in entry.values]
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
    model = entry.text("model", _MODELS[0])
    if model not in _MODELS:
        entry.fail("model", f"{quoted(model)} is not one of {', '.join(_MODELS)}.")
    own = None if model == _MODELS[0] else XACRO.with_name(f"{model}.urdf.xacro")
    return load_crane(own, values=values or None), {}


def _brakes(entry: SiteTable, crane: Crane, drives: Converters) -> tuple[Brakes, Converters]:
    """Return brakes, and converters that ramp no faster than brakes other than theirs stop."""
    own = isinstance(entry.values.get("brakes"), dict)
    kind: Any = "converters" if own else entry.text("brakes", "converters")
    brake = brakes(crane, kind, reaction=entry.number("reaction", REACTION, "s", "> 0"))
    if own:
        given = _of_drives(entry, "brakes", crane, ["decelerations", "tolerances"])
        if "decelerations" not in given:
            entry.fail("brakes", "decelerations is missing.")
        brake = replace(brake, decelerations=np.array([*given["decelerations"].values()]))
        if "tolerances" in given:
            brake = replace(brake, tolerances=np.array([*given["tolerances"].values()]))
        if (brake.decelerations > drives.accelerations).any():
            entry.fail("brakes", "decelerations are more than the drives accelerate.")
    elif kind == "converters":
        weakest = np.minimum(brake.decelerations, 0.9 * drives.accelerations)
        return replace(brake, decelerations=weakest), drives
    slopes = np.minimum(drives.accelerations, brake.decelerations)
    return brake, replace(drives, accelerations=slopes, jerks=slopes / ROUNDING)


def _of_drives(
    entry: SiteTable, field: str, crane: Crane, keys: list[str]
) -> dict[str, dict[str, float]]:
    """Return numbers of a table in a field, one for each drive by its symbol; angles in degrees."""
    values = entry.values.get(field, {})
    if not isinstance(values, dict):
        entry.fail(field, f"it must be a table with {' and '.join(keys)}.")
    table = SiteTable(entry.path, field, values, {"": entry.lines.get(field, 1)}, keys)
    scale = [math.radians(1.0) if joint.unit == "rad" else 1.0 for joint in crane.layout.driven]
    symbols = [joint.symbol for joint in crane.layout.driven]
    return {
        key: dict(
            zip(symbols, np.multiply(scale, table.numbers(key, len(scale), "> 0")), strict=True)
        )
        for key in keys
        if key in values
    }
