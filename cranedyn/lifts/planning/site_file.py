"""Sites from TOML files (docs/howto/plan_lift.md); errors name line and field."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.data.files import parse_toml, read_text
from cranedyn.dynamics.contact import box_corners
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName, quoted
from cranedyn.lifts.planning.bim import read_ifc
from cranedyn.lifts.planning.crane_bodies import neighbour
from cranedyn.lifts.planning.plausibility import findings
from cranedyn.lifts.planning.site import DISTANCE, DRIVES, SWING, Arm, Base, Site
from cranedyn.lifts.planning.solids import Solid, body, box, prism, read_mesh, rotation_z
from cranedyn.model.description import arguments
from cranedyn.references.limits import Limits

SITES = Path(__file__).parent / "sites"
"""Folder of the example sites."""

EXAMPLES = ("open_yard", "city_block", "tower", "neighbour")
"""Names of the example sites."""

UNBOUNDED = 1e4
"""Height of a zone that enters none [m]: higher than any crane."""

_HEADER = re.compile(r"\s*\[\[?\s*([\w.]+)\s*\]\]?")
"""Line that begins a table, with its name."""

_KEY = re.compile(r"\s*([\w]+)\s*=")
"""Line that begins a field, with its name."""

_MAX_COUNT = 2000
"""Largest number of obstacles of a site, and of corners of an outline."""

FieldLines = Mapping[tuple[str, int], dict[str, int]]
"""Number of the line of each field, by the name of its table and the index among the tables of that
name, then by the name of the field; "" is the line that begins the table."""


class SiteTable:
    """Table of a site's file with the lines of its fields; its methods refuse a value with them."""

    def __init__(
        self,
        path: Path,
        name: str,
        values: dict[str, Any],
        lines: dict[str, int],
        fields: Sequence[str],
    ) -> None:
        """Take a table, and refuse fields that it cannot have.

        Args:
            path: The file.
            name: Name of the table.
            values: Its fields.
            lines: Number of the line of each field, "" for the line that begins the table.
            fields: Names of the fields that it may have.

        Raises:
            DataError: If it has another field.
        """
        self.path = path
        self.name = name
        self.values = values
        self.lines = lines
        for key in values:
            if key not in fields:
                self.fail(key, UnknownName("field", key, fields))

    def fail(self, key: str, reason: object) -> NoReturn:
        """Refuse a field, with the line where it is, or where its table begins.

        Raises:
            DataError: With file, line, table, field and the reason.
        """
        line = self.lines.get(key, self.lines.get("", 1))
        raise DataError(f"{self.path}, line {line}, [{self.name}] {key}: {reason}")

    def take(self, key: str, convert: Callable[[str, Any], Any], default: Any = None) -> Any:
        """Return a field, converted; it may be left out if there is a default."""
        if key not in self.values:
            if default is None:
                self.fail(key, "it is missing.")
            return default
        try:
            return convert(key, self.values[key])
        except CraneError as error:
            self.fail(key, error)

    def number(
        self, key: str, default: float | None = None, unit: str = "m", allowed: str = "any"
    ) -> float:
        """Return a number in a range, see `cranedyn.checks.number`."""
        return self.take(key, partial(_number, unit=unit, allowed=allowed), default)

    def numbers(self, key: str, count: int, allowed: str = "any", default: Any = None) -> Any:
        """Return a list of so many numbers."""
        return self.take(key, partial(_numbers, count=count, allowed=allowed), default)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a printable text."""
        return self.take(key, _text, default)

    def flag(self, key: str) -> bool:
        """Return true or false, by default false."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            self.fail(key, "allowed is true or false.")
        return value

    def angle(self, key: str, default: float = 0.0, allowed: str = "any") -> float:
        """Return an angle [rad] that the file gives in degrees."""
        return math.radians(self.number(key, math.degrees(default), "degrees", allowed))

    def optional_number(self, key: str, unit: str, allowed: str) -> float | None:
        """Return a number in a range; None if it is left out."""
        return self.number(key, unit=unit, allowed=allowed) if key in self.values else None

    def tables(self, kind: str, fields: Sequence[str], lines: FieldLines) -> list[SiteTable]:
        """Return all tables of a kind, none if there are none.

        Args:
            kind: Name of the tables.
            fields: Names of the fields that they may have.
            lines: Lines of all fields of the file.
        """
        tables = self.values.get(kind, [])
        if not isinstance(tables, list) or not all(isinstance(values, dict) for values in tables):
            self.fail(kind, f"write each as [[{kind}]].")
        return [
            SiteTable(self.path, kind, values, lines.get((kind, i), {}), fields)
            for i, values in enumerate(tables)
        ]

    def file(self, key: str) -> Path:
        """Return the path of a file, which must lie in the folder of the site, links resolved."""
        name = self.text(key)
        folder = Path(os.path.realpath(self.path.parent))
        path = Path(os.path.realpath(folder / name))
        if not path.is_relative_to(folder):
            self.fail(
                key,
                f"{quoted(name)} lies outside of the folder of the site; allowed are files in it.",
            )
        return path


def read_site(path: str | Path) -> Site:
    """Read a site from a TOML file, or the example site of that name.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line. Also if a mesh or an IFC file that it names cannot be read, or two
            obstacles have one name.
        UnknownName: If there is no file and no example of that name.
    """
    path = site_path(path, SITES, EXAMPLES)
    top, lines = read_fields(path, [*_FIELDS, *SOLIDS])
    tables = _tables(top, lines)
    ground = tables["ground"].number("height")
    solids = solids_of(top, lines, ground)
    crane = tables["crane"]
    lift = tables["lift"]
    wind = tables["wind"]
    rigging = tables["rigging"]
    masses = {}
    for name in sorted(rigging.values.keys() - {"falls"}):
        masses[name] = rigging.number(name, unit="kg", allowed=">= 0")
    site = Site(
        name=top.text("name", path.stem),
        solids=tuple(solids),
        ground=ground,
        foot=np.array(crane.numbers("position", 3, default=[0.0, 0.0, ground])),
        heading=crane.angle("heading", -math.pi / 2.0),
        crane=_crane_values_of(tables, masses),
        load=_load(tables["load"]),
        start=_point(lift, "from"),
        goal=_point(lift, "to"),
        distance=lift.number("distance", DISTANCE, "m", "> 0"),
        swing=lift.angle("swing", SWING, "0 to 28"),
        limits=_limits(tables["drives"]),
        base=_base(tables["base"]),
        arms=_arms(tables["jib"], tables["counter_jib"]),
        rigging=masses,
        gust=wind.optional_number("gust", "m/s", ">= 0"),
        gust_swing=wind.angle("swing", allowed="0.1 to 45") if "swing" in wind.values else None,
        risk=_risk(lift),
        spread=_spread(tables["uncertainty"]),
        chart=_chart(crane),
        falls=rigging.take("falls", _whole) if "falls" in rigging.values else None,
        entered=_entered(tables),
    )
    return _plausible(site, tables)


def _tables(top: SiteTable, lines: FieldLines) -> dict[str, SiteTable]:
    """Return the tables of a site beside its obstacles, by name; those left out are empty.

    Raises:
        DataError: If there is no [ground], one is no table, or a field is unknown.
    """
    content = top.values
    if not isinstance(content.get("ground"), dict):
        top.fail("ground", "there is none; a site needs a table [ground] with its height.")
    tables = {}
    for name, fields in _FIELDS.items():
        values = content.get(name, {})
        if not isinstance(values, dict):
            top.fail(name, "it must be a table.")
        tables[name] = SiteTable(top.path, name, values, lines.get((name, 0), {}), fields)
    return tables


def _crane_values_of(
    tables: Mapping[str, SiteTable], rigging: Mapping[str, float]
) -> dict[str, float]:
    """Return the values of the crane that [crane] and other tables enter, by name.

    Raises:
        DataError: If one of them is entered twice.
    """
    values = dict(tables["crane"].take("values", crane_values, {}))
    for entered in _arguments(tables["load"], tables["drives"], tables["counter_jib"], rigging):
        if entered.argument in values:
            entered.table.fail(
                entered.field,
                f"{entered.argument} is among the values of [crane], too; leave one out.",
            )
        values[entered.argument] = entered.value
    return values


def _entered(tables: Mapping[str, SiteTable]) -> frozenset[str]:
    """Return the fields that are entered, such as "[lift] swing"."""
    return frozenset(
        f"[{name}] {field}" for name, table in tables.items() for field in table.values
    )


def _plausible(site: Site, tables: Mapping[str, SiteTable]) -> Site:
    """Return the site with sentences about its unusual values.

    Raises:
        DataError: If a value cannot be meant.
    """
    defaults = arguments()
    smallest_radius = float(site.crane.get("trolley_min", defaults["trolley_min"].default))
    largest_radius = float(site.crane.get("trolley_max", defaults["trolley_max"].default))
    unusual = []
    for finding in findings(site, (smallest_radius, largest_radius)):
        if finding.refused and finding.table:
            tables[finding.table].fail(finding.field, finding.sentence)
        if finding.refused:
            raise DataError(f"{tables['ground'].path}: {finding.sentence}")
        unusual.append(str(finding))
    return replace(site, unusual=tuple(unusual))


def _spread(uncertainty: SiteTable) -> dict[str, float]:
    """Return how far lifts may differ from the plan, by the names of `Spread`, as far as it is
    entered.
    """
    spread = {}
    if "mass" in uncertainty.values:
        spread["load"] = uncertainty.number("mass", unit="%", allowed="0 to 99") / 100.0
    for name, unit in (("cable", "m"), ("wind", "m/s"), ("gust", "m/s")):
        if name in uncertainty.values:
            spread[name] = uncertainty.number(name, unit=unit, allowed="0 to 100")
    if "delay" in uncertainty.values:
        spread["late"] = uncertainty.number("delay", unit="s", allowed="0 to 10")
    return spread


def _chart(crane: SiteTable) -> Path | str | None:
    """Return the file of a chart, which must lie in the folder of the site, or the name of one that
    is shipped.
    """
    if "chart" not in crane.values:
        return None
    name = crane.text("chart")
    return name if name.isidentifier() else crane.file("chart")


def site_path(path: str | Path, folder: Path, examples: Sequence[str]) -> Path:
    """Return the path of a file, or of the example in a folder that has this name.

    Raises:
        UnknownName: If it is a plain word, and neither.
    """
    name = str(path)
    if name in examples:
        return folder / f"{name}.toml"
    if name.isidentifier() and not os.path.exists(path):  # False for a name too long, too
        raise UnknownName("site", name, examples)
    return Path(path)


def read_fields(
    path: Path, fields: Sequence[str], kind: str = "site"
) -> tuple[SiteTable, dict[tuple[str, int], dict[str, int]]]:
    """Read the whole of a TOML file with a name and other fields, and the lines of each table.

    Args:
        path: The file.
        fields: Names of the fields and tables that it may have beside its name.
        kind: What errors call it by.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is another.
    """
    text = read_text(path)
    content = parse_toml(text, path)
    lines = dict(field_lines(text))
    return SiteTable(path, kind, content, lines.get(("", 0), {}), ["name", *fields]), lines


_FIELDS = {
    "ground": ["height"],
    "crane": ["position", "heading", "values", "chart"],
    "load": ["size", "file", "mass"],
    "lift": ["from", "to", "distance", "swing", "risk"],
    "wind": ["gust", "swing"],
    "uncertainty": ["mass", "cable", "wind", "gust", "delay"],
    "drives": ["rates", "accelerations", "efforts"],
    "base": ["spacing", "mass", "permitted"],
    "jib": ["mass", "centre"],
    "counter_jib": ["length", "mass", "centre"],
    "rigging": ["hook", "slings", "falls"],
}
"""Tables of a site beside its obstacles, with their fields."""


def solids_of(top: SiteTable, lines: FieldLines, ground: float) -> list[Solid]:
    """Return the obstacles of a site.

    Args:
        top: The whole of the file.
        lines: Lines of all its fields.
        ground: Height of the ground [m], on which obstacles stand that enter no height.

    Raises:
        DataError: If an obstacle cannot be made of its fields, there are too many, or two have one
            name.
    """
    solids: dict[str, Solid] = {}
    for kind, (fields, make) in SOLIDS.items():
        entries = top.tables(kind, fields, lines)
        if len(solids) + len(entries) > _MAX_COUNT:
            top.fail(kind, f"there are more than {_MAX_COUNT} obstacles.")
        for entry in entries:
            # An obstacle from an IFC file has no name of its own.
            key = "name" if "name" in entry.values else "file"
            try:
                made = make(entry, ground)
            except CraneError as error:
                # Errors of a field name file and line already, those of geometry do not.
                if str(error).startswith(str(top.path)):
                    raise
                entry.fail(key, error)
            for solid in made:
                if solid.name in solids:
                    called = f"two obstacles are called {quoted(solid.name)}"
                    entry.fail(key, f"{called}; each needs a name of its own.")
                solids[solid.name] = solid
    return list(solids.values())


class _Argument(NamedTuple):
    """An argument of the crane that a table other than [crane] enters.

    Attributes:
        table: The table.
        field: Field of the table.
        argument: Name of the argument.
        value: Its value.
    """

    table: SiteTable
    field: str
    argument: str
    value: float


def _arguments(
    load: SiteTable, drives: SiteTable, counter_jib: SiteTable, rigging: Mapping[str, float]
) -> Iterator[_Argument]:
    """Yield the arguments of the crane that other tables enter.

    Args:
        load: [load].
        drives: [drives].
        counter_jib: [counter_jib].
        rigging: Masses of hook and slings [kg], by name; the crane's load includes them.
    """
    if "mass" in load.values:
        mass = load.number("mass", unit="kg", allowed="> 0") + sum(rigging.values())
        yield _Argument(load, "mass", "payload_mass", mass)
    elif rigging:
        load.fail("mass", "it is missing; hook and slings are counted besides.")
    if "length" in counter_jib.values:
        length = counter_jib.number("length", allowed="> 0")
        yield _Argument(counter_jib, "length", "counter_jib", length)
    if "efforts" in drives.values:
        efforts = drives.numbers("efforts", 3, "> 0")
        for drive, effort in zip(DRIVES, efforts, strict=True):
            yield _Argument(drives, "efforts", f"{drive}_effort", effort)


def _limits(drives: SiteTable) -> Limits | None:
    """Return the limits of the drives; None if nothing of the drives is entered."""
    if not drives.values:
        return None
    return Limits(_motion_limits(drives, "rates"), _motion_limits(drives, "accelerations"))


def _motion_limits(drives: SiteTable, name: str) -> list[float]:
    """Return rates or accelerations of slew, trolley and hoist; the file gives those of the slew in
    degrees.
    """
    slew, trolley, hoist = drives.numbers(name, 3, "> 0")
    return [math.radians(slew), trolley, hoist]


def _base(base: SiteTable) -> Base | None:
    """Return the base of the crane; None if it is not entered."""
    if not base.values:
        return None
    permitted = None
    if "permitted" in base.values:
        permitted = 1e3 * base.number("permitted", unit="kN", allowed="> 0")
    spacing = base.number("spacing", allowed="> 0")
    mass = base.number("mass", unit="kg", allowed=">= 0")
    return Base(spacing, mass, permitted)


def _arms(jib: SiteTable, counter_jib: SiteTable) -> tuple[Arm, ...]:
    """Return jib and counter-jib, as far as their masses are entered. The file gives both centres
    as distances from the slew axis; that of the counter-jib lies behind it.
    """
    arms = []
    for table, sign in ((jib, 1.0), (counter_jib, -1.0)):
        if "mass" in table.values or "centre" in table.values:
            mass = table.number("mass", unit="kg", allowed=">= 0")
            centre = sign * table.number("centre", allowed=">= 0")
            arms.append(Arm(mass, centre))
    return tuple(arms)


def _load(load: SiteTable) -> np.ndarray | None:
    """Return the corners of the load about its centre [m], shape (n, 3), from a mesh or from the
    sides of a box; None if neither is entered.
    """
    if "file" in load.values:
        if "size" in load.values:
            load.fail("size", "file is given, too; leave one out.")
        vertices, triangles = read_mesh(load.file("file"))
        return vertices - _hanging_centre(vertices, triangles)
    if "size" not in load.values:
        return None
    return np.array(box_corners(*load.numbers("size", 3, "> 0")))


def _hanging_centre(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the point of a load of one material that hangs below the rope [m], shape (3,): in plan
    its centre of volume, since it would lean otherwise; in height the middle.

    A mesh that is not closed has no volume of its own; the centre is then that of its hull.
    """
    import trimesh  # slow, and few sites need it

    mesh = trimesh.Trimesh(vertices, triangles)
    with np.errstate(all="ignore"):  # trimesh divides by volumes that may be zero
        closed = mesh if mesh.is_watertight and mesh.volume != 0.0 else mesh.convex_hull
        x, y, _ = closed.center_mass
    middle = (vertices[:, 2].min() + vertices[:, 2].max()) / 2.0
    return np.array([x, y, middle])


def _risk(lift: SiteTable) -> float | None:
    """Return the largest probability that a perturbed lift comes too close, which the file gives in
    percent; None if it is left out.
    """
    risk = lift.optional_number("risk", "%", "0 to 100")
    return None if risk is None else risk / 100.0


def _point(lift: SiteTable, key: str) -> np.ndarray | None:
    """Return an end of the lift [m], shape (3,), or shape (2,) if no height is entered; None if it
    is left out.
    """
    values = lift.values.get(key)
    if values is None:
        return None
    count = 2 if isinstance(values, list) and len(values) == 2 else 3
    return np.array(lift.numbers(key, count))


# --- obstacles ------------------------------------------------------------------------------------

# Each function makes the obstacles of an entry on a ground of a height [m]; see `SOLIDS`.


def _box(entry: SiteTable, ground: float) -> list[Solid]:
    size = entry.numbers("size", 3, "> 0")
    name = entry.text("name")
    base = entry.number("base", ground)
    centre = entry.numbers("centre", 2)
    return [box(name, centre, size, base, entry.angle("yaw"))]


def _prism(entry: SiteTable, ground: float) -> list[Solid]:
    height = entry.number("height", allowed="> 0")
    name = entry.text("name")
    outline = entry.take("outline", _outline)
    return [prism(name, outline, entry.number("base", ground), height)]


def _zone(entry: SiteTable, ground: float) -> list[Solid]:
    base = entry.number("base", ground)
    height = entry.number("height", UNBOUNDED, allowed="> 0")
    name = entry.text("name")
    return [prism(name, entry.take("outline", _outline), base, height, zone=True)]


def _mesh(entry: SiteTable, ground: float) -> list[Solid]:
    vertices, triangles = read_mesh(entry.file("file"))
    scale = entry.number("scale", 1.0, "", "> 0")
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, ground]))
    placed = scale * vertices @ rotation_z(entry.angle("yaw")).T + position
    return [body(entry.text("name"), placed, triangles, as_hull=entry.flag("hull"))]


def _ifc(entry: SiteTable, ground: float) -> list[Solid]:
    # A model has its own heights, so that it is not put on the ground.
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, 0.0]))
    solids = read_ifc(entry.file("file"), as_hulls=entry.flag("hull"))
    return [solid.moved(rotation_z(entry.angle("yaw")), position) for solid in solids]


def _neighbour(entry: SiteTable, ground: float) -> list[Solid]:
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, ground]))
    drive_position = {
        "slew": entry.number("slew", 0.0, "degrees"),
        "trolley": entry.number("trolley", 0.0, "m"),
        "cable": entry.number("cable", 0.0, "m"),
    }
    values = entry.take("values", crane_values, {})
    heading = entry.angle("heading", -math.pi / 2.0)
    return neighbour(entry.text("name"), position, heading, drive_position, values)


SOLIDS: dict[str, tuple[list[str], Callable[[SiteTable, float], list[Solid]]]] = {
    "box": (["name", "centre", "size", "base", "yaw"], _box),
    "prism": (["name", "outline", "base", "height"], _prism),
    "mesh": (["name", "file", "position", "yaw", "scale", "hull"], _mesh),
    "ifc": (["file", "position", "yaw", "hull"], _ifc),
    "keep_out": (["name", "outline", "base", "height"], _zone),
    "neighbour": (
        ["name", "position", "heading", "slew", "trolley", "cable", "values"],
        _neighbour,
    ),
}
"""Kinds of obstacles with the fields that they may have, and the function that makes them."""


# --- conversions of fields, which raise without a line; `SiteTable.take` adds it ------------------


def _number(name: str, value: Any, unit: str = "m", allowed: str = "any") -> float:
    """Return a number in a range. `number` alone would take true, and texts of numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise OutOfRange(name, quoted(value), "a number", unit)
    return number(name, value, unit, allowed)


def _whole(name: str, value: Any) -> int:
    """Return a whole number from 1."""
    return whole(name, value, 1)


def _numbers(name: str, value: Any, count: int, allowed: str = "any") -> list[float]:
    """Return a list of so many numbers in a range."""
    if not isinstance(value, list) or len(value) != count:
        raise OutOfRange(name, quoted(value), f"{count} numbers", "m")
    return [_number(f"one of {name}", item, "m", allowed) for item in value]


def _outline(name: str, value: Any) -> np.ndarray:
    """Return the corners of an outline [m], shape (n, 2)."""
    if not isinstance(value, list) or not 3 <= len(value) <= _MAX_COUNT:
        raise OutOfRange(name, quoted(value), "a list of 3 or more")
    return np.array([_numbers("corner", corner, 2) for corner in value])


def _text(name: str, value: Any) -> str:
    """Return a printable text that is not empty."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise OutOfRange(name, quoted(value), "a printable text")
    return value


def crane_values(name: str, table: Any) -> dict[str, float]:
    """Return numbers of a crane by name."""
    if not isinstance(table, dict):
        raise OutOfRange(name, quoted(table), "a table of numbers of the crane")
    return {argument: _number(argument, value, "") for argument, value in table.items()}


def field_lines(text: str) -> Iterator[tuple[tuple[str, int], dict[str, int]]]:
    """Yield the lines of the fields of each table, by its name and its index among the tables of
    that name; see `FieldLines`. The fields before the first table have the name "".
    """
    counts: dict[str, int] = {}
    name = ""
    fields = {"": 1}
    for i, line in enumerate(text.splitlines(), start=1):
        header = _HEADER.match(line)
        key = _KEY.match(line)
        if header:
            yield (name, counts.get(name, 1) - 1), fields
            name = header[1]
            fields = {"": i}
            counts[name] = counts.get(name, 0) + 1
        elif key:
            fields.setdefault(key[1], i)
    yield (name, counts.get(name, 1) - 1), fields
