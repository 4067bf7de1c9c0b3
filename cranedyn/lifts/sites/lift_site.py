"""A lift of a shift as the site of one crane, which is what `lift_report` judges.

    shift = plan_shift(read_crane_site("site.toml"))
    site = write_lift_site(shift, shift.lifts[0], Path("site.toml"), Path("out/formwork"))

The file that is written has the crane of the lift, the obstacles, each other crane as a neighbour
at the place where it is when the load leaves, the lift, and as [shift] what the plan of the shift
says of it. What a lift plan needs besides stands in the file of the shift as `report`: tables of a
site with one crane, of all lifts, of those of a crane, or of one lift.
"""

from __future__ import annotations

import copy
import json
import math
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.data.files import parse_toml, read_text, write_text
from cranedyn.errors import DataError, quoted
from cranedyn.lifts.judging.plan_inputs import named_files
from cranedyn.lifts.planning.site import CRANE_HEADING, DescribedCrane
from cranedyn.lifts.planning.site_file import SOLIDS
from cranedyn.lifts.sites.crane_site import Station
from cranedyn.lifts.sites.crane_site_file import DEFAULT_KIND, MODEL_ENDING
from cranedyn.lifts.sites.plan import ScheduledLift
from cranedyn.lifts.sites.shift_plan import PlannedLift, ShiftPlan
from cranedyn.lifts.sites.timetable import clock_time, load_of

SITE_FILE = "site.toml"
"""Name of the file of a lift in its folder."""

_LONGEST_NAME = 40
"""Most letters of the name of a lift in the name of its folder."""

Content = dict[str, Any]
"""Content of a TOML file."""


def folder_name(shift: ShiftPlan, planned: PlannedLift) -> str:
    """Return the name of the folder of a lift: its number in the timetable and its name."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", planned.lift.name).strip("_").lower()
    number = shift.lifts.index(planned) + 1
    return f"{number:02d}_{plain[:_LONGEST_NAME]}".rstrip("_")


def write_lift_site(shift: ShiftPlan, planned: PlannedLift, source: Path, folder: Path) -> Path:
    """Write the site of a lift of a shift, and the files that it names, and return its path.

    Args:
        shift: The plan of the shift.
        planned: One of its lifts.
        source: The site file that the shift was planned from.
        folder: Where to write; a file of that name is replaced.

    Raises:
        DataError: If the file of the shift cannot be read, the rigging weighs more than all that
            hangs, or a file cannot be written.
    """
    entered = parse_toml(read_text(source), source)
    text = (
        f"# Lift {quoted(planned.lift.name)}, written by cranedyn run site --reports. Enter what\n"
        f"# is missing as `report` in {quoted(source.name)}: this file is replaced each time.\n"
        f"{toml_text(_lift_site(shift, planned, entered, source))}"
    )
    folder.mkdir(parents=True, exist_ok=True)
    _copy_files(text, source, folder)
    path = folder / SITE_FILE
    write_text(path, text)
    return path


def drive_positions(shift: ShiftPlan, crane: int, t: float) -> np.ndarray:
    """Return where the drives of a crane are at a time of the plan [rad or m], shape (m,).

    Args:
        shift: The plan of the shift.
        crane: Index of the crane.
        t: The time [s].
    """
    drives = shift.plan.site.stations[crane].crane.layout.drives
    q = shift.plan.site.stations[crane].crane.start.q
    for scheduled in shift.plan.lifts:
        if scheduled.crane == crane and scheduled.begin <= t:
            rows = scheduled.motion.q
            row = round((t - scheduled.begin) / scheduled.motion.period)
            q = rows[min(row, len(rows) - 1)]
    return q[drives]


def _lift_site(
    shift: ShiftPlan, planned: PlannedLift, entered: Mapping[str, Any], source: Path
) -> Content:
    """Return the content of the file of a lift.

    Args:
        shift: The plan of the shift.
        planned: The lift.
        entered: Content of the file of the shift.
        source: That file, for an error.
    """
    site = shift.plan.site
    index = site.index_of(planned.crane)
    station = site.stations[index]
    of_crane = entered["crane"][index]
    of_lift = next(entry for entry in entered["lift"] if entry["name"] == planned.lift.name)

    content: Content = {
        "name": f"{site.name}: {planned.lift.name}",
        "job": {"title": planned.lift.name},
        "crane": _crane(station, of_crane),
        "ground": {"height": site.ground},
        "load": {},
        "lift": {
            "from": planned.lift.start.tolist(),
            "to": planned.lift.goal.tolist(),
            "distance": site.distance,
        },
    }
    if "drives" in of_crane:
        content["drives"] = copy.deepcopy(of_crane["drives"])
    # The swing of a shift is what its guard keeps clear, wind included. The planned motion of one
    # lift swings less, by [lift] swing.
    if "swing" in entered:
        content["wind"] = {"swing": entered["swing"]}
    if site.working_wind.gust > 0.0:
        # The file of a shift enters area times drag coefficient.
        content.setdefault("wind", {})["gust"] = site.working_wind.gust
        content["load"] |= {"area": site.working_wind.area, "drag": 1.0}
    for kind in SOLIDS:
        content[kind] = copy.deepcopy(entered.get(kind, []))
    for i in range(len(site.stations)):
        if i == index:
            continue
        neighbour = _neighbour(shift, i, entered["crane"][i], planned.off)
        if site.share_runway(index, i):
            neighbour["on_runway"] = True
        content["neighbour"].append(neighbour)
    for tables in (entered, of_crane, of_lift):
        _merge(content, tables.get("report", {}))
    content["load"]["mass"] = _mass_of_load(shift, planned, content, source)
    content["shift"] = _shift(shift, planned)
    return content


def _crane(station: Station, entry: Mapping[str, Any]) -> Content:
    """Return the table [crane] of a station from its table in the file of the shift."""
    crane = _described(entry)
    values = dict(entry.get("values", {}))
    values.pop("payload_mass", None)  # [load] has the mass
    crane["position"] = np.asarray(station.foot, dtype=float).tolist()
    # A crane of a file is neither of a kind nor a machine, and so no tower crane.
    if DescribedCrane(kind=crane.get("kind"), machine=crane.get("machine")).is_tower:
        crane["heading"] = math.degrees(station.heading)
    else:
        # The angle by which its axes are turned.
        crane["yaw"] = math.degrees(station.heading) - math.degrees(CRANE_HEADING)
    if values:
        crane["values"] = values
    if "chart" in entry:
        crane["chart"] = entry["chart"]
    return crane


def _described(entry: Mapping[str, Any]) -> Content:
    """Return the fields of a site with one crane that say which crane it is."""
    if "urdf" in entry:
        return {"file": entry["urdf"]}
    if "machine" in entry:
        return {"machine": entry["machine"]}
    if "model" in entry:
        return {"kind": entry["model"].removesuffix(MODEL_ENDING)}
    return {"kind": entry.get("kind", DEFAULT_KIND)}


def _neighbour(shift: ShiftPlan, index: int, entry: Mapping[str, Any], t: float) -> Content:
    """Return a crane as a neighbour at the place where it is at a time.

    Args:
        shift: The plan of the shift.
        index: Index of the crane.
        entry: Its table in the file of the shift.
        t: The time [s].
    """
    other = shift.plan.site.stations[index]
    drives = []
    positions = drive_positions(shift, index, t)
    for joint, position in zip(other.crane.layout.driven, positions, strict=True):
        turns = joint.kind == "revolute"
        drives.append(math.degrees(position) if turns else float(position))
    neighbour = {
        "name": other.name,
        **_described(entry),
        "position": np.asarray(other.foot, dtype=float).tolist(),
        "heading": math.degrees(other.heading),
        "drives": drives,
    }
    if "values" in entry:
        neighbour["values"] = dict(entry["values"])
    return neighbour


def _mass_of_load(shift: ShiftPlan, planned: PlannedLift, content: Content, source: Path) -> float:
    """Return the mass of the load alone [kg]: what hangs in the plan of the shift, less the rigging
    that is entered.

    Raises:
        DataError: If nothing is left.
    """
    gross = load_of(shift, planned)
    rigging = content.get("rigging", {})
    parts = 0.0
    for part in ("hook", "slings", "spreader"):
        entered = rigging.get(part, 0.0)
        mass = entered.get("mass", 0.0) if isinstance(entered, Mapping) else entered
        if isinstance(mass, int | float):
            parts += mass
    if not parts < gross:
        raise DataError(
            f"{source}: the rigging of the lift {quoted(planned.lift.name)} weighs {parts:g} kg, "
            f"and all that hangs {gross:g} kg; `load` counts hook block and slings, too."
        )
    return gross - parts


def _shift(shift: ShiftPlan, planned: PlannedLift) -> Content:
    """Return what the plan of the shift says of a lift, as the table [shift]."""
    lift = planned.lift
    waits = "not for another crane"
    if planned.waited > 0.0:
        reason = f": {planned.waits_for}" if planned.waits_for else ""
        waits = f"{planned.waited:.0f} s{reason}"
    table: Content = {
        "site": shift.plan.site.name,
        "lift": lift.name,
        "crane": planned.crane,
        "begins": clock_time(planned.begin),
        "leaves": clock_time(planned.off),
        "delivered": clock_time(planned.delivered),
        "unhooked": clock_time(planned.end),
        "waits": waits,
        "others": _others(shift, planned),
    }
    if lift.after:
        table["after"] = f"{', '.join(lift.after)} unhooked"
    return table


def _others(shift: ShiftPlan, planned: PlannedLift) -> list[str]:
    """Return what each other crane does while that of a lift carries its load, in sentences."""
    sentences = []
    moving = {motion.crane for motion in shift.plan.lifts if _meanwhile(motion, planned)}
    for index, station in enumerate(shift.plan.site.stations):
        if station.name == planned.crane:
            continue
        lifts = []
        for other in shift.lifts:
            if other.crane == station.name and _meanwhile(other, planned):
                times = f"from {clock_time(other.begin)} to {clock_time(other.end)}"
                lifts.append(f"{quoted(other.lift.name)} {times}")
        if lifts:
            does = f"brings {' and '.join(lifts)}"
        elif index in moving:
            does = "makes way"
        else:
            does = "stands"
        sentences.append(f"{station.name} {does}.")
    return sentences


def _meanwhile(other: PlannedLift | ScheduledLift, planned: PlannedLift) -> bool:
    """Return whether another lift or motion overlaps the time in which a crane carries its load."""
    return other.begin < planned.delivered and planned.off < other.end


def _merge(content: Content, entered: Mapping[str, Any]) -> None:
    """Put entered tables over those of a content, field by field; it is changed in place."""
    for name, value in entered.items():
        if isinstance(value, Mapping) and isinstance(content.get(name), dict):
            _merge(content[name], value)
        else:
            content[name] = copy.deepcopy(value)


def _copy_files(text: str, source: Path, folder: Path) -> None:
    """Copy the files that a site names, and those that its chart names, from the folder of a file
    to another folder.
    """
    for file in named_files(source, text):
        target = folder / file.path
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source.parent / file.path, target)
        if target.suffix == ".toml":
            _copy_files(read_text(target), source.parent / file.path, target.parent)


# --- TOML -----------------------------------------------------------------------------------------


def toml_text(content: Content) -> str:
    """Return the text of a TOML file with tables and lists of tables at its top, and inline tables
    within these.
    """
    lines = [f"{key} = {_value(value)}" for key, value in content.items() if not _is_table(value)]
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{key}]", *_fields(value)]
        elif _is_table(value):
            for entry in value:
                lines += ["", f"[[{key}]]", *_fields(entry)]
    return "\n".join([*lines, ""])


def _is_table(value: Any) -> bool:
    """Return whether a value at the top is a table, or a list of tables."""
    is_list = isinstance(value, list) and all(isinstance(entry, Mapping) for entry in value)
    return isinstance(value, Mapping) or is_list


def _fields(table: Mapping[str, Any]) -> list[str]:
    """Return the lines of the fields of a table."""
    return [f"{key} = {_value(value)}" for key, value in table.items()]


def _value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A text of JSON is one of TOML, if it has no escaped pairs of surrogates.
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(_fields(value))}}}"
    return str(value)  # numbers and dates
