"""Sites with several cranes from TOML files; errors name line and field."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError, quoted
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.planning.site_file import SiteTable, crane_values, read_fields
from cranedyn.sites.brakes import REACTION, brakes
from cranedyn.sites.site import DISTANCE, SWING, CraneSite, Station

SITES = Path(__file__).parent / "examples"
"""Folder of the example sites."""

EXAMPLES = ("two_towers", "four_towers", "luffing_between")
"""Names of the example sites."""

_CRANE = ["name", "position", "heading", "model", "urdf", "values", "brakes", "reaction"]
_MODELS = ("tower_crane", "luffing_crane")


def read_crane_site(path: str | Path) -> CraneSite:
    """Read a site with several cranes from a TOML file, or the example site of that name.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line. Also if two cranes have one name, or towers overlap.
    """
    path = SITES / f"{path}.toml" if str(path) in EXAMPLES else Path(path)
    top, lines = read_fields(path, ["ground", "distance", "swing", "crane"])
    ground = top.number("ground", 0.0)
    entries = top.tables("crane", _CRANE, lines)
    stations: list[Station] = []
    for entry in entries:
        stations.append(_station(entry, ground))
        if stations[-1].name in [station.name for station in stations[:-1]]:
            entry.fail("name", f"two cranes are called {quoted(stations[-1].name)}; rename one.")
    if not stations:
        top.fail("crane", "there is none; write each as [[crane]].")
    distance = top.number("distance", DISTANCE, "m", "> 0")
    swing = top.angle("swing", SWING, "0 to 28")
    name = top.text("name", path.stem)
    for count in range(1, len(stations) + 1):
        try:
            site = CraneSite(name, tuple(stations[:count]), ground, distance, swing)
        except CraneError as error:
            entries[count - 1].fail("position", error)
    return site


def _station(entry: SiteTable, ground: float) -> Station:
    name = entry.text("name")
    values: dict[str, Any] = entry.take("values", crane_values, {})
    model = entry.text("model", _MODELS[0])
    if model not in _MODELS:
        entry.fail("model", f"{quoted(model)} is not one of {', '.join(_MODELS)}.")
    own = "urdf" in entry.values
    if own and values:
        entry.fail("values", "an own URDF has none; leave them out.")
    urdf = entry.file("urdf") if own else XACRO.with_name(f"{model}.urdf.xacro")
    if urdf.suffix == ".xacro" and own:
        entry.fail("urdf", "a xacro file runs code; expand it to a URDF.")
    key = "urdf" if own else "values" if values else "name"
    try:
        crane = load_crane(None if urdf == XACRO else urdf, values=values or None)
        drives = converters(crane)
        entry_brakes = brakes(
            crane,
            entry.text("brakes", "converters"),  # type: ignore[arg-type]
            reaction=entry.number("reaction", REACTION, "s", "> 0"),
        )
        foot = np.array(entry.numbers("position", 3, default=[0.0, 0.0, ground]))
        heading = entry.angle("heading", -math.pi / 2.0)
        station = Station(name, crane, foot, heading, drives, entry_brakes)
        _ = station.bodies
    except CraneError as error:
        if str(error).startswith(str(entry.path)):
            raise
        entry.fail("brakes" if "brakes" in str(error) else key, error)
    return station
