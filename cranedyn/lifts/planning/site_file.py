"""Sites from TOML files (docs/howto/plan_lift.md); errors name line and field."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.command import uninterrupted_import
from cranedyn.data.files import parse_toml, read_text
from cranedyn.dynamics.contact import box_corners
from cranedyn.errors import CraneError, DataError, UnknownName, quoted
from cranedyn.lifts.planning.bim import read_ifc
from cranedyn.lifts.planning.boom import boom_length, boom_of, telescope_at
from cranedyn.lifts.planning.crane_bodies import neighbour, parked_position
from cranedyn.lifts.planning.details_file import (
    CRANE_FIELDS,
    GROUND_FIELDS,
    JOB_FIELDS,
    LIMIT_FIELDS,
    LOAD_FIELDS,
    PEOPLE_FIELDS,
    RIGGING_FIELDS,
    SAFETY_FIELDS,
    SHIFT_FIELDS,
    details_of,
    rigging_masses,
    rigging_tables,
)
from cranedyn.lifts.planning.plan_assumptions import in_words
from cranedyn.lifts.planning.plan_details import is_named
from cranedyn.lifts.planning.plausibility import findings
from cranedyn.lifts.planning.site import (
    CRANE_HEADING,
    DISTANCE,
    KINDS,
    SWING,
    TOWER_DRIVES,
    Arm,
    Base,
    DescribedCrane,
    Runway,
    Site,
    SiteDrive,
)
from cranedyn.lifts.planning.site_table import (
    MAX_COUNT,
    FieldLines,
    SiteTable,
    crane_values,
    field_lines,
    names_of,
    positions_of,
)
from cranedyn.lifts.planning.solids import Solid, body, box, prism, read_mesh, rotation_z
from cranedyn.model.crane import Crane
from cranedyn.model.description import arguments
from cranedyn.model.machines import machine_names
from cranedyn.references.limits import Limits

SITES = Path(__file__).parent / "sites"
"""Folder of the example sites."""

EXAMPLES = ("open_yard", "city_block", "tower", "neighbour")
"""Names of the example sites."""

PLAN_EXAMPLES = ("signed_lift",)
"""Names of the example sites with every field of a lift plan; the experiment `lift` does not plan
their lifts, which would be those of `EXAMPLES` again."""

SITE_EXAMPLES = (*EXAMPLES, *PLAN_EXAMPLES)
"""Names of all sites that come with the package."""

CHART_EXAMPLES = ("laboratory", "mct88", "terex_rt335", "terex_rt665")
"""Names of the example charts: of this project's crane, which is none, and of makers' sheets."""

UNBOUNDED = 1e4
"""Height of a zone that enters none [m]: higher than any crane."""


def read_site(path: str | Path) -> Site:
    """Read a site from a TOML file, or the example site of that name.

    Raises:
        DataError: If it cannot be read, is no TOML, or a field is missing, unknown or out of its
            range, with its line. Also if a mesh or an IFC file that it names cannot be read, or two
            obstacles have one name.
        UnknownName: If there is no file and no example of that name.
    """
    path = example_path(path, SITES, SITE_EXAMPLES, "site")
    top, lines = read_fields(path, ["estimated", *_FIELDS, *SOLIDS])
    tables = _tables(top, lines)
    ground = tables["ground"].number("height")
    solids = solids_of(top, lines, ground)
    crane = tables["crane"]
    description = _description(crane)
    telescope = _telescope(description, crane)
    if telescope is not None:
        description = telescope.held
    is_tower = description is None or description.is_tower
    drives = TOWER_DRIVES if description is None else _drives_of(description, crane)
    if not is_tower:
        _refuse_tower_tables(tables)
    if tables["runway"].values and tables["base"].values:
        tables["base"].fail("spacing", "[runway] is given, too: a crane on rails has no base.")
    lift = tables["lift"]
    wind = tables["wind"]
    rigging = tables["rigging"]
    masses = rigging_masses(tables)
    details = details_of(tables)
    _check_names_in_zone(tables["safety"], details.in_zone, solids)
    site = Site(
        name=top.text("name", path.stem),
        solids=tuple(solids),
        ground=ground,
        foot=np.array(crane.numbers("position", 3, default=[0.0, 0.0, ground])),
        heading=_heading(crane, is_tower=is_tower),
        crane=_crane_values_of(tables, masses, drives, description),
        load=_load(tables["load"], details.load.centre),
        start=_point(lift, "from"),
        goal=_point(lift, "to"),
        distance=lift.number("distance", DISTANCE, "m", "> 0"),
        swing=lift.angle("swing", SWING, "0.01 to 28"),
        description=description,
        drives=drives,
        limits=_limits(tables["drives"], drives),
        base=_base(tables["base"], description),
        arms=_arms(tables["jib"], tables["counter_jib"]),
        runway=_runway(tables["runway"], is_tower=is_tower),
        rigging=masses,
        gust=wind.optional_number("gust", "m/s", ">= 0"),
        gust_swing=wind.optional_angle("swing", "0.1 to 45"),
        risk=_risk(lift),
        spread=_spread(tables["uncertainty"]),
        chart=chart_of(crane),
        falls=rigging.optional_whole("falls"),
        telescope="" if telescope is None else telescope.joint,
        boom=None if telescope is None else telescope.boom,
        counterweight=_counterweight(crane),
        details=details,
        entered=_entered(tables),
        estimated=_estimated(top, tables),
    )
    return _plausible(site, tables)


def _tables(top: SiteTable, lines: FieldLines) -> dict[str, SiteTable]:
    """Return the tables of a site beside its obstacles, by name; those left out are empty.

    Raises:
        DataError: If there is no [ground], one is no table, or a field is unknown.
    """
    if not isinstance(top.values.get("ground"), dict):
        top.fail("ground", "there is none; a site needs a table [ground] with its height.")
    tables = {name: top.top_table(name, fields, lines) for name, fields in _FIELDS.items()}
    return tables | rigging_tables(tables["rigging"], lines)


def _description(crane: SiteTable) -> DescribedCrane | None:
    """Return which crane [crane] describes; None for the tower crane of this project."""
    named = [field for field in ("kind", "file", "machine") if field in crane.values]
    if len(named) > 1:
        crane.fail(named[1], f"{named[0]} is given, too; leave one out.")
    for field in ("driven", "locked", "boom"):
        if field in crane.values and not named:
            crane.fail(field, "it is for a crane that file, kind or machine names.")
    if not named:
        return None
    (field,) = named
    named_crane: dict[str, Any] = {}
    if field == "file":
        named_crane[field] = _description_file(crane)
    else:
        known = KINDS if field == "kind" else machine_names()
        named_crane[field] = crane.choice(field, known)
    driven = crane.take("driven", names_of, [])
    locked = crane.take("locked", positions_of, {})
    return DescribedCrane(**named_crane, driven=tuple(driven), locked=locked)


class _Telescope(NamedTuple):
    """A boom that telescopes, held at one length.

    Attributes:
        joint: Name of the joint that telescopes it.
        boom: Its length [m].
        held: The crane with that joint held.
    """

    joint: str
    boom: float
    held: DescribedCrane


def _telescope(description: DescribedCrane | None, crane: SiteTable) -> _Telescope | None:
    """Return the boom of a crane that telescopes, held at the length that [crane] enters, or where
    `locked` holds its joint; None if no boom telescopes.

    Raises:
        DataError: If a length is entered of another boom, or one that it cannot have, and if no
            length is entered of a boom that telescopes.
    """
    if description is None or description.is_tower:
        if "boom" in crane.values:
            crane.fail("boom", "it is for a crane whose boom telescopes; a tower crane has none.")
        return None
    values = crane.take("values", crane_values, {})
    field = next(name for name in ("kind", "file", "machine") if name in crane.values)
    try:
        free = replace(description, locked={}).load(values)
    except CraneError as error:
        crane.fail(field, error)
    boom = boom_of(free)
    extends = None if boom is None else boom.telescope
    joint = "" if extends is None else free.layout.joints[extends].name
    if "boom" in crane.values:
        length = crane.number("boom", allowed="> 0")
        try:
            joint, coordinate = telescope_at(free, length)
        except CraneError as error:
            crane.fail("boom", error)
        if joint in description.locked:
            crane.fail("boom", f"locked holds {joint}, too; leave one out.")
        held = replace(description, locked={**description.locked, joint: coordinate})
        return _Telescope(joint, length, held)
    if not joint:
        return None
    if joint not in description.locked:
        crane.fail(
            field,
            f"the boom of this crane telescopes ({joint}), and a lift is planned with a boom of "
            "one length, since telescoping under load is not planned; enter boom, its length [m].",
        )
    try:
        locked = description.load(values)
    except CraneError as error:
        crane.fail("locked", error)
    held_length = boom_length(locked, locked.start.q)
    assert held_length is not None  # a boom without its telescope is still one
    return _Telescope(joint, held_length, description)


def _counterweight(crane: SiteTable) -> float | None:
    """Return the counterweight that [crane] enters, as a field or among the values of the crane
    [kg]; None if it does not.
    """
    if "counterweight" in crane.values:
        return crane.number("counterweight", unit="kg", allowed=">= 0")
    values = crane.take("values", crane_values, {})
    return values.get("counterweight")


def _description_file(crane: SiteTable) -> Path:
    """Return the file of a crane that a site names: a plain one, in the folder of the site."""
    file = crane.file("file")
    if file.suffix == ".xacro":
        crane.fail(
            "file",
            "a xacro file may run any Python expression, so that a site does not load one; write "
            "its plain URDF with xacro, and name that.",
        )
    return file


def _drives_of(description: DescribedCrane, crane: SiteTable) -> tuple[SiteDrive, ...]:
    """Return the drives of a crane that [crane] describes.

    Raises:
        DataError: If it cannot be loaded.
    """
    field = next(name for name in ("kind", "file", "machine") if name in crane.values)
    try:
        layout = description.load({}).layout
    except CraneError as error:
        crane.fail(field, error)
    return tuple(
        SiteDrive(joint.role or joint.symbol, joint.kind == "revolute") for joint in layout.driven
    )


def _refuse_tower_tables(tables: Mapping[str, SiteTable]) -> None:
    """Refuse jib and counter-jib of a crane that is not the tower crane of this project: the
    description of such a crane has its masses and its shapes.
    """
    for name in ("jib", "counter_jib"):
        for field in tables[name].values:
            tables[name].fail(
                field, "it is for a tower crane; the description of this crane has its masses."
            )


def _heading(crane: SiteTable, *, is_tower: bool) -> float:
    """Return the heading of a crane [rad], see `Site`. Of a tower crane a file gives it itself, and
    of another one the angle by which its axes are turned against those of the site.
    """
    if is_tower:
        if "yaw" in crane.values:
            crane.fail("yaw", "it is for another crane; of a tower crane give heading.")
        return crane.angle("heading", CRANE_HEADING)
    if "heading" in crane.values:
        crane.fail(
            "heading",
            "it is for a tower crane; of another one give yaw, by which its axes are turned.",
        )
    return CRANE_HEADING + crane.angle("yaw")


def _crane_values_of(
    tables: Mapping[str, SiteTable],
    rigging: Mapping[str, float],
    drives: Sequence[SiteDrive],
    description: DescribedCrane | None,
) -> dict[str, float]:
    """Return the values of the crane that [crane] and other tables enter, by name.

    Raises:
        DataError: If one of them is entered twice.
    """
    values = dict(tables["crane"].take("values", crane_values, {}))
    entries = [*_arguments(tables, rigging, drives), *_setup_arguments(tables, description)]
    for entered in entries:
        if entered.argument in values:
            entered.table.fail(
                entered.field,
                f"the same value is entered twice: here, and as {entered.argument} = "
                f"{values[entered.argument]:g} in the values of [crane]. Keep this field, and take "
                f"{entered.argument} out there.",
            )
        values[entered.argument] = entered.value
    return values


def _check_names_in_zone(safety: SiteTable, in_zone: Iterable[str], solids: list[Solid]) -> None:
    """Check that each name of `[safety] in_zone` is that of an obstacle.

    Raises:
        DataError: If one is not: a misspelt name would be taken for something that is cleared.
    """
    names = [solid.name for solid in solids]
    for key in in_zone:
        if not any(is_named(name, key) for name in names):
            known = ", ".join(names[:8]) or "none"
            safety.fail(
                "in_zone",
                f"no obstacle has the name {quoted(key)}. Names are: {known}"
                f"{', ...' if len(names) > 8 else ''}. All that begin alike are named by their "
                'beginning and a star, such as "house*".',
            )


def _entered(tables: Mapping[str, SiteTable]) -> frozenset[str]:
    """Return the fields that are entered, such as "[lift] swing"."""
    fields = {f"[{name}] {field}" for name, table in tables.items() for field in table.values}
    values = tables["crane"].values.get("values", {})
    return frozenset(fields | {f"[crane.values] {name}" for name in values})


def _estimated(top: SiteTable, tables: Mapping[str, SiteTable]) -> frozenset[str]:
    """Return the fields that the site calls estimated, such as "[jib] mass".

    Raises:
        DataError: If one of them is not entered.
    """
    entered = _entered(tables)
    fields = top.take("estimated", names_of, [])
    for field in fields:
        if field not in entered:
            top.fail(
                "estimated",
                f"{quoted(field)} is not entered in this file; write a field as the report does, "
                'such as "[jib] mass" or "[crane.values] upper_mass".',
            )
    return frozenset(fields)


def _plausible(site: Site, tables: Mapping[str, SiteTable]) -> Site:
    """Return the site with sentences about its unusual values.

    Raises:
        DataError: If a value cannot be meant.
    """
    reach = None  # of another crane the plan knows it
    if site.is_tower:
        defaults = arguments()
        smallest_radius = float(site.crane.get("trolley_min", defaults["trolley_min"].default))
        largest_radius = float(site.crane.get("trolley_max", defaults["trolley_max"].default))
        reach = (smallest_radius, largest_radius)
    unusual = []
    for finding in findings(site, reach):
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
        spread["late"] = uncertainty.number("delay", unit="s", allowed="0 to 1")
    return spread


def chart_of(crane: SiteTable) -> Path | str | None:
    """Return the name of an example chart, or the file of a chart, which must lie in the folder of
    the site; None if there is no chart.

    Raises:
        DataError: If there is neither.
    """
    if "chart" not in crane.values:
        return None
    name = crane.text("chart")
    if name in CHART_EXAMPLES:
        return name
    file = crane.file("chart")
    if name.isidentifier() and not file.exists():
        known = in_words(CHART_EXAMPLES)
        crane.fail(
            "chart",
            f"{quoted(name)} is neither a file beside the site nor an example chart; the examples "
            f"are {known}.",
        )
    return file


def example_path(path: str | Path, folder: Path, examples: Sequence[str], kind: str) -> Path:
    """Return the path of a TOML file, or of the example in a folder that has this name.

    Args:
        path: The path, or the name of an example.
        folder: Folder of the examples.
        examples: Their names.
        kind: What errors call such a file.

    Raises:
        UnknownName: If it is a plain word, and neither.
    """
    name = str(path)
    if name in examples:
        return folder / f"{name}.toml"
    if name.isidentifier() and not os.path.exists(path):  # False for a name too long, too
        raise UnknownName(kind, name, examples)
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
    # A table of the file is a field of the whole, and begins at its header.
    headers = {name: of_table[""] for (name, index), of_table in lines.items() if index == 0}
    top_lines = headers | lines.get(("", 0), {})
    return SiteTable(path, kind, content, top_lines, ["name", *fields]), lines


_FIELDS = {
    "job": [*JOB_FIELDS],
    "people": [*PEOPLE_FIELDS],
    "ground": ["height", *GROUND_FIELDS],
    "crane": [
        *("kind", "file", "machine", "driven", "locked", "boom", "counterweight"),
        *("position", "heading", "yaw", "values", "chart"),
        *CRANE_FIELDS,
    ],
    "load": ["size", "file", "mass", *LOAD_FIELDS],
    "lift": ["from", "to", "distance", "swing", "risk"],
    "wind": ["gust", "swing"],
    "uncertainty": ["mass", "cable", "wind", "gust", "delay"],
    "drives": ["rates", "accelerations", "efforts"],
    "base": ["spacing", "mass", "permitted", "along"],
    "runway": ["rails", "wheel_base", "permitted"],
    "jib": ["mass", "centre"],
    "counter_jib": ["length", "mass", "centre"],
    "rigging": [*RIGGING_FIELDS],
    "limits": [*LIMIT_FIELDS],
    "safety": [*SAFETY_FIELDS],
    "shift": [*SHIFT_FIELDS],
}
"""Tables of a site beside its obstacles, with their fields."""

SITE_TABLES = tuple(name for name in _FIELDS if name != "shift")
"""Names of the tables that somebody may enter; [shift] is written by the plan of a shift."""


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
        if len(solids) + len(entries) > MAX_COUNT:
            top.fail(kind, f"there are more than {MAX_COUNT} obstacles.")
        for entry in entries:
            # An obstacle from an IFC file has no name of its own.
            key = "name" if "name" in entry.values else "file"
            try:
                solids_of_entry = make(entry, ground)
            except CraneError as error:
                # Errors of a field name file and line already, those of geometry do not.
                if str(error).startswith(str(top.path)):
                    raise
                entry.fail(key, error)
            for solid in solids_of_entry:
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
    tables: Mapping[str, SiteTable], rigging: Mapping[str, float], drives: Sequence[SiteDrive]
) -> Iterator[_Argument]:
    """Yield the arguments of the crane that other tables enter.

    Args:
        tables: The tables of the site, by name.
        rigging: Masses of hook and slings [kg], by name; the crane's load includes them.
        drives: Drives of the crane.
    """
    load = tables["load"]
    counter_jib = tables["counter_jib"]
    of_drives = tables["drives"]
    if "mass" in load.values:
        mass = load.number("mass", unit="kg", allowed="> 0") + sum(rigging.values())
        yield _Argument(load, "mass", "payload_mass", mass)
    elif rigging:
        load.fail("mass", "it is missing; hook and slings are counted besides.")
    if "length" in counter_jib.values:
        length = counter_jib.number("length", allowed="> 0")
        yield _Argument(counter_jib, "length", "counter_jib", length)
    if "efforts" in of_drives.values:
        units = ["N m" if drive.turns else "N" for drive in drives]
        efforts = of_drives.numbers("efforts", len(drives), "> 0", units=units)
        for drive, effort in zip(drives, efforts, strict=True):
            yield _Argument(of_drives, "efforts", f"{drive.name}_effort", effort)


def _setup_arguments(
    tables: Mapping[str, SiteTable], description: DescribedCrane | None
) -> Iterator[_Argument]:
    """Yield counterweight and falls, as far as a crane of this project has them as arguments.

    The falls of the tower crane are none of these: they count for a rope that stretches.
    """
    if description is None or description.kind in (None, "tower"):
        return
    accepted = arguments(description.urdf)  # type: ignore[arg-type]
    crane = tables["crane"]
    if "counterweight" in crane.values and "counterweight" in accepted:
        mass = crane.number("counterweight", unit="kg", allowed=">= 0")
        yield _Argument(crane, "counterweight", "counterweight", mass)
    rigging = tables["rigging"]
    if "falls" in rigging.values and "falls" in accepted:
        yield _Argument(rigging, "falls", "falls", rigging.whole("falls"))


def _limits(table: SiteTable, drives: Sequence[SiteDrive]) -> Limits | None:
    """Return the limits of the drives; None if nothing of the drives is entered."""
    if not table.values:
        return None
    return Limits(
        _motion_limits(table, drives, "rates", "/s"),
        _motion_limits(table, drives, "accelerations", "/s²"),
    )


def _motion_limits(
    table: SiteTable, drives: Sequence[SiteDrive], name: str, per_time: str
) -> list[float]:
    """Return rates or accelerations of all drives; the file gives those of turning ones in degrees.

    Args:
        table: [drives].
        drives: The drives.
        name: "rates" or "accelerations".
        per_time: What follows the unit of a position in theirs.
    """
    units = [f"degrees{per_time}" if drive.turns else f"m{per_time}" for drive in drives]
    entered = table.numbers(name, len(drives), "> 0", units=units)
    return [
        math.radians(value) if drive.turns else value
        for drive, value in zip(drives, entered, strict=True)
    ]


def _base(base: SiteTable, description: DescribedCrane | None) -> Base | None:
    """Return the base of the crane; None if it is not entered.

    Its sides lie along the axes of the site, or of the crane where `along` says so. The outriggers
    of the mobile crane lie along those of the crane unless it says otherwise.
    """
    if not base.values:
        return None
    permitted = base.optional_kilonewtons("permitted")
    spacing = base.number("spacing", allowed="> 0")
    mass = base.number("mass", unit="kg", allowed=">= 0")
    is_mobile = description is not None and description.kind == "mobile"
    along = base.choice("along", ("crane", "site"), "crane" if is_mobile else "site", "way to lie")
    return Base(spacing, mass, permitted, turns_with_crane=along == "crane")


def _runway(runway: SiteTable, *, is_tower: bool) -> Runway | None:
    """Return the rails of a crane that travels; None if they are not entered."""
    if not runway.values:
        return None
    if is_tower:
        runway.fail("rails", "it is for a crane that travels on rails; a tower crane has a base.")
    permitted = runway.optional_kilonewtons("permitted")
    first, second = runway.numbers("rails", 2)
    if first == second:
        runway.fail("rails", "both rails are in the same place.")
    return Runway((first, second), runway.number("wheel_base", allowed="> 0"), permitted)


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


def _load(load: SiteTable, centre: Sequence[float] | None) -> np.ndarray | None:
    """Return the corners of the load about the point that hangs below the rope [m], shape (n, 3),
    from a mesh or from the sides of a box; None if neither is entered.

    In plan that point is the centre of gravity, which the rope is above wherever the load hangs at
    rest. In height it is the middle of the box around the load.

    Args:
        load: [load].
        centre: Centre of gravity from the centre of the box [m], as entered; None for the middle of
            a box, or the centre of volume of a mesh.
    """
    if "file" in load.values:
        if "size" in load.values:
            load.fail("size", "file is given, too; leave one out.")
        vertices, triangles = read_mesh(load.file("file"))
        if centre is None:
            return vertices - _hanging_centre(vertices, triangles)
        corners = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    elif "size" in load.values:
        corners = np.array(box_corners(*load.numbers("size", 3, "> 0")))
    else:
        return None
    aside = (0.0, 0.0) if centre is None else (centre[0], centre[1])
    return corners - np.array([*aside, 0.0])


def _hanging_centre(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the point of a load of one material that hangs below the rope [m], shape (3,): in plan
    its centre of volume, since it would lean otherwise; in height the middle.

    A mesh that is not closed has no volume of its own; the centre is then that of its hull.
    """
    trimesh = uninterrupted_import("trimesh")  # slow, and few sites need it
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

# Each function makes the obstacles of an entry of its kind; `ground` is the height [m] of what
# stands on the ground. See `SOLIDS`.


def _box(entry: SiteTable, ground: float) -> list[Solid]:
    """Return an upright box, turned about its vertical axis by `yaw`."""
    size = entry.numbers("size", 3, "> 0")
    name = entry.text("name")
    base = entry.number("base", ground)
    centre = entry.numbers("centre", 2)
    return [box(name, centre, size, base, entry.angle("yaw"))]


def _prism(entry: SiteTable, ground: float) -> list[Solid]:
    """Return an upright prism over an outline."""
    height = entry.number("height", allowed="> 0")
    name = entry.text("name")
    outline = entry.outline("outline")
    return [prism(name, outline, entry.number("base", ground), height)]


def _zone(entry: SiteTable, ground: float) -> list[Solid]:
    """Return an upright prism to keep out of, without an upper end if no height is entered."""
    base = entry.number("base", ground)
    height = entry.number("height", UNBOUNDED, allowed="> 0")
    name = entry.text("name")
    return [prism(name, entry.outline("outline"), base, height, zone=True)]


def _mesh(entry: SiteTable, ground: float) -> list[Solid]:
    """Return a mesh from a file, multiplied by `scale`, turned by `yaw` about its Z axis and moved
    to a position; with `hull` as its convex hull.
    """
    vertices, triangles = read_mesh(entry.file("file"))
    scale = entry.number("scale", 1.0, "", "> 0")
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, ground]))
    placed = scale * vertices @ rotation_z(entry.angle("yaw")).T + position
    return [body(entry.text("name"), placed, triangles, as_hull=entry.flag("hull"))]


def _ifc(entry: SiteTable, ground: float) -> list[Solid]:
    """Return the products of a building model, turned by `yaw` about its Z axis and moved to a
    position; with `hull` as the convex hull of each.
    """
    # A model has its own heights, so that it is not put on the ground.
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, 0.0]))
    solids = read_ifc(entry.file("file"), as_hulls=entry.flag("hull"))
    return [solid.moved(rotation_z(entry.angle("yaw")), position) for solid in solids]


def _neighbour(entry: SiteTable, ground: float) -> list[Solid]:
    """Return a parked crane with its rope and hook, see `_parked` for where its drives stand."""
    position = np.array(entry.numbers("position", 3, default=[0.0, 0.0, ground]))
    values = entry.take("values", crane_values, {})
    description = _description(entry) or DescribedCrane(kind="tower")
    heading = entry.angle("heading", CRANE_HEADING)
    crane = description.load(values)
    return neighbour(
        entry.text("name"),
        crane,
        _parked(entry, crane),
        position,
        heading,
        standing=not entry.flag("on_runway"),
    )


def _parked(entry: SiteTable, crane: Crane) -> np.ndarray:
    """Return the coordinates of a neighbour, shape (n,): with its drives at the positions that it
    enters as `drives`, in degrees where they turn, or, of a tower crane, as `slew`, `trolley` and
    `cable`, of which 0 means where the crane starts.
    """
    driven = crane.layout.driven
    if "drives" in entry.values:
        for field in ("slew", "trolley", "cable"):
            if field in entry.values:
                entry.fail(field, "drives is given, too; leave one out.")
        units = ["degrees" if joint.kind == "revolute" else "m" for joint in driven]
        entered = entry.numbers("drives", len(driven), units=units)
        positions = []
        for joint, value in zip(driven, entered, strict=True):
            positions.append(math.radians(value) if joint.kind == "revolute" else value)
        return parked_position(crane, positions)
    coordinates = {
        "gamma": entry.angle("slew"),
        "x": entry.number("trolley", 0.0, "m"),
        "l": entry.number("cable", 0.0, "m"),
    }
    # 0 need not be in the range of a drive.
    given = {symbol: value for symbol, value in coordinates.items() if value}
    return crane.state(**given).q


SOLIDS: dict[str, tuple[list[str], Callable[[SiteTable, float], list[Solid]]]] = {
    "box": (["name", "centre", "size", "base", "yaw"], _box),
    "prism": (["name", "outline", "base", "height"], _prism),
    "mesh": (["name", "file", "position", "yaw", "scale", "hull"], _mesh),
    "ifc": (["file", "position", "yaw", "hull"], _ifc),
    "keep_out": (["name", "outline", "base", "height"], _zone),
    "neighbour": (
        [
            *("name", "position", "heading", "slew", "trolley", "cable", "values"),
            *("kind", "file", "machine", "driven", "locked", "drives", "on_runway"),
        ],
        _neighbour,
    ),
}
"""Kinds of obstacles with the fields that they may have, and the function that makes them."""
