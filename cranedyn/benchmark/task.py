"""Tasks of the benchmark as data: what a file of tasks holds, and the instances drawn from it.

A file describes one crane with its drives and sensors, and the tasks on this crane. A task has one
nominal instance, in which everything is as an entry is told, and several perturbed ones. What a
perturbed instance differs in is drawn from ranges of the file by a seed; the entry is never told.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.data.files import parse_toml, read_text
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.disturbances.waves import Jonswap, Raos, motion_in_waves
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.errors import DataError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import Reference, State
from cranedyn.lifts.planning.site_table import SiteTable, crane_values, field_lines
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.references.simple import spline

VERSION = "v1"
"""Version of the tasks of this package. A change of any task that has been published makes a new
one."""

FOLDER = Path(__file__).resolve().parent / "tasks" / VERSION
"""Folder of the task files of this version."""

KINDS = ("move", "path", "wind", "operator", "unknown", "sensors")
"""Kinds of tasks, in the order of tables."""

MOVES = ("move", "unknown", "sensors")
"""Kinds in which the load goes from one rest to another in as little time as possible."""

PUBLIC = "public"
"""Name of the seeds that everybody may develop with."""

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
"""Form of a date from which the seeds of a ranking are derived."""

_WAVES = 40
"""Waves of a sea: a run of a minute meets less than ten, and each costs time in every step."""

_MAX_INSTANCES = 1000
"""Largest number of perturbed instances of a task."""


class Sensors(NamedTuple):
    """How the state is measured, of the nominal instance.

    Attributes:
        noise: Noise of all sensors as a multiple of `cranedyn.estimation.sensor_model.noise_of`.
        delay: Delay of all readings [control periods].
        position_step: Resolution of the positions of the drives [rad or m].
        swing_step: Resolution of the swing angles [rad].
    """

    noise: float
    delay: int
    position_step: float
    swing_step: float


class Gusts(NamedTuple):
    """Gusts that blow on the load one after the other, each of the shape (1 - cos)/2.

    Attributes:
        speed: Largest wind speed of each gust [m/s].
        area: Drag coefficient times area of the load [m²].
        direction: Direction in which they blow, from the world's +X towards +Y [rad].
        at: Time at which the first one begins [s].
        lasts: Duration of each [s].
        repeats: Number of gusts.
    """

    speed: float
    area: float
    direction: float
    at: float
    lasts: float
    repeats: int

    @property
    def end(self) -> float:
        """Time at which the last gust ends [s]."""
        return self.at + self.repeats * self.lasts


@dataclass(frozen=True)
class Sea:
    """Waves, and the ship on which a crane stands in them.

    Attributes:
        hs: Significant height of the waves [m].
        tp: Their peak period [s].
        gamma: Peak enhancement factor of their JONSWAP spectrum.
        place: Place of the crane's origin in the frame of the ship [m], shape (3,).
        raos: Rows of an angular frequency [rad/s], and of the response of heave [m/m], roll and
            pitch [°/m] to the waves, each followed by its phase [°]; shape (k, 7).
    """

    hs: float
    tp: float
    gamma: float
    place: tuple[float, ...]
    raos: tuple[tuple[float, ...], ...]

    def motion(self, seed: int, factor: float) -> BaseMotion:
        """Return the motion of the crane's base.

        Args:
            seed: Seed of the waves.
            factor: Factor on their height.
        """
        rows = np.array(self.raos)
        response = np.zeros((len(rows), len(COORDINATES)), dtype=complex)
        columns = (("heave", 1.0), ("roll", np.pi / 180.0), ("pitch", np.pi / 180.0))
        for i, (name, scale) in enumerate(columns):
            magnitude = scale * rows[:, 1 + 2 * i]
            phase = np.deg2rad(rows[:, 2 + 2 * i])
            response[:, COORDINATES.index(name)] = magnitude * np.exp(1j * phase)
        spectrum = Jonswap(factor * self.hs, self.tp, self.gamma)
        ship = motion_in_waves(spectrum, Raos(rows[:, 0], response), seed=seed, components=_WAVES)
        return ship.seen_at(self.place)


RANGES = {
    "payload_factor": 1.0,
    "rope_offset": 0.0,
    "lag_factor": 1.0,
    "start_swing": 0.0,
    "noise_factor": 1.0,
    "more_delay": 0.0,
    "swing_bias": 0.0,
    "outage": 0.0,
    "outage_at": 0.0,
    "gust_factor": 1.0,
    "gust_direction": 0.0,
    "sea_factor": 1.0,
}
"""What may differ in a perturbed instance, with the value of the nominal one:

payload_factor: mass of the load over the one that the entry is told.
rope_offset: length by which the rope is longer than measured [m].
lag_factor: time constants of the drives' speed control over those told.
start_swing: each swing angle at the start [rad].
noise_factor: factor on the noise of the sensors.
more_delay: further delay of the readings [control periods], rounded to a whole number.
swing_bias: error of the zero of each swing angle [rad].
outage: duration for which all readings stay at their last value [s].
outage_at: time at which that begins [s].
gust_factor: speed of the gusts over that of the task.
gust_direction: angle by which their direction is turned [rad].
sea_factor: height of the waves over that of the task.
"""

_OF_THE_SEA = ("sea_factor",)
"""Those that are drawn by a generator of their own, so that cranes on land keep their instances."""


@dataclass(frozen=True, eq=False)
class CraneTask:
    """A task on one crane with m drives; immutable.

    Attributes:
        file: File that it was read from.
        crane_name: Name of that file without its ending.
        kind: One of `KINDS`.
        crane_source: Arguments of `cranedyn.model.load.load_crane` by name.
        values: Numbers of the crane by name, beside those of its file.
        drives: Numbers of the converters by attribute and symbol, see
            `cranedyn.dynamics.converters.converters`.
        drive_delay: Delay from a command to the response of the drives [s].
        period: Control period [s].
        step: Physics step [s].
        duration: Length of an instance [s].
        start: Coordinates at the start by symbol; the others are as in the file of the crane.
        goal: Coordinates at the goal by symbol; None for a task without one.
        waypoints: Positions of the drives that a path passes, shape (k, m); empty without a path.
        durations: Time from each waypoint to the next [s], shape (k,).
        joystick: Rows of a time [s] and the rates that the operator asks for from then on, as
            shares of the largest rates of the drives, shape (k, 1 + m); empty without an operator.
        gusts: The gusts; None for still air.
        sea: The sea, and the ship on which the crane stands; None for a crane on land. Starts,
            goals, paths and drives are relative to the deck.
        tolerance: Distance of the load from its goal up to which it counts as settled [m].
        hold: Time for which it must stay there until the end of the instance [s].
        swing_bound: Largest swing allowed [rad]; an instance that exceeds it fails.
        corridor: Largest distance of the load from where it should be [m]; None for no bound.
        stray: Largest distance of each drive from where the operator sent it [rad or m]; None
            without an operator.
        least_time: Least time of the move under the limits of the drives and the bound of the
            swing [s], see `cranedyn.benchmark.limits`; None where it was not computed.
        sensors: How the state is measured.
        ranges: Ranges of what a perturbed instance differs in, by the names of `RANGES`.
        count: Number of perturbed instances.
        digest: SHA-256 of all data of the task, in hexadecimal digits.
    """

    file: Path
    crane_name: str
    kind: str
    crane_source: Mapping[str, Any]
    values: Mapping[str, float]
    drives: Mapping[str, Mapping[str, float]]
    drive_delay: float
    period: float
    step: float
    duration: float
    start: Mapping[str, float]
    goal: Mapping[str, float] | None
    waypoints: Sequence[Sequence[float]]
    durations: Sequence[float]
    joystick: Sequence[Sequence[float]]
    gusts: Gusts | None
    sea: Sea | None
    tolerance: float
    hold: float
    swing_bound: float
    corridor: float | None
    stray: float | None
    least_time: float | None
    sensors: Sensors
    ranges: Mapping[str, tuple[float, float]]
    count: int
    digest: str

    @property
    def name(self) -> str:
        """Name of the task, such as "overhead/move"."""
        return f"{self.crane_name}/{self.kind}"

    def crane(self, payload_factor: float = 1.0) -> Crane:
        """Return the crane with its load times a factor; 1 is the crane that an entry is told."""
        source = json.dumps([dict(self.crane_source), dict(self.values)], sort_keys=True)
        return _loaded(source, payload_factor)

    def converters(self, lag_factor: float = 1.0) -> Converters:
        """Return the frequency converters of the drives, with their lags times a factor."""
        typical = converters(self.crane(), delay=self.drive_delay, **self.drives)
        return replace(typical, lags=lag_factor * typical.lags)

    def start_state(self) -> State:
        """Return the state at the start, as an entry is told: at rest, the load plumb."""
        return self.crane().state(**self.start)

    def goal_state(self) -> State | None:
        """Return the state at the goal, at rest with the load plumb; None without a goal."""
        if self.goal is None:
            return None
        return self.crane().state(**{**self.start, **self.goal})

    def path(self) -> Reference | None:
        """Return the motion of the drives below which the load shall hang plumb at each time; None
        for a task without a path.
        """
        if not self.waypoints:
            return None
        return spline(self.crane(), self.start_state(), self.waypoints, self.durations)

    def operator_rates(self, t: float) -> np.ndarray:
        """Return the rates that the operator asks for at a time [rad/s or m/s], shape (m,); zero
        without an operator.
        """
        shares = np.zeros(len(self.largest_rates))
        for first, *row in self.joystick:
            # A time that rounding puts just before a row belongs to it.
            if t >= first - 1e-9:
                shares = np.array(row)
        return shares * self.largest_rates

    @cached_property
    def largest_rates(self) -> np.ndarray:
        """Largest rates of the drives [rad/s or m/s], shape (m,)."""
        return self.converters().rates

    @property
    def counts_from(self) -> float:
        """Time from which settling counts [s]: the start of a move, the end of the path or of the
        gusts, or the time at which the operator lets go.
        """
        if self.kind == "path":
            return float(sum(self.durations))
        if self.kind == "wind" and self.gusts is not None:
            return self.gusts.end
        if self.kind == "operator":
            return float(self.joystick[-1][0])
        return 0.0


@lru_cache(maxsize=256)
def _loaded(source: str, payload_factor: float) -> Crane:
    """Return a crane, loaded once for all instances that have it.

    Args:
        source: Arguments of `load_crane` and numbers of the crane, as a list in JSON.
        payload_factor: Factor on the mass of the load.
    """
    arguments, values = json.loads(source)
    if "urdf" in arguments:
        arguments["urdf"] = XACRO.with_name(f"{arguments['urdf']}.urdf.xacro")
    if payload_factor != 1.0:
        values["payload_mass"] = payload_factor * _loaded(source, 1.0).payload_mass
    return load_crane(**arguments, **values)


@dataclass(frozen=True)
class Instance:
    """A task with what differs from what the entry is told.

    Attributes:
        task: The task.
        index: Index among the instances of the task; 0 is the nominal one.
        seeds: Name of the seeds that it was drawn by.
        values: What differs, by the names of `RANGES`.
        swing_signs: Sign of the swing at the start, of each swing joint.
        noise_seed: Seed of the noise of the sensors.
        sea_seed: Seed of the waves.
    """

    task: CraneTask
    index: int
    seeds: str
    values: Mapping[str, float]
    swing_signs: tuple[float, ...]
    noise_seed: int
    sea_seed: int = 0

    def base_motion(self) -> BaseMotion | None:
        """Return the motion of the ship; None for a crane on land."""
        sea = self.task.sea
        return None if sea is None else sea.motion(self.sea_seed, self.values["sea_factor"])

    def drive_offset(self, crane: Crane) -> np.ndarray:
        """Return where drives are less what their sensors say, shape (m,): the rope is longer than
        its drum knows.
        """
        offset = np.zeros(crane.layout.m)
        if crane.winch is not None:
            offset[crane.winch] = self.values["rope_offset"]
        return offset


def instances(task: CraneTask, seeds: str = PUBLIC) -> list[Instance]:
    """Return the nominal instance of a task and its perturbed ones.

    Each number is uniform in its range of the task. An instance has a seed of its own, so that a
    further instance changes none of the others.

    Args:
        task: The task.
        seeds: `PUBLIC`, or a date such as "2026-11-28" for a ranking.

    Raises:
        OutOfRange: If the seeds are neither.
    """
    check_seeds(seeds)
    drawn = []
    for index in range(task.count + 1):
        seed = seed_of(seeds, task.name, index)
        rng = np.random.default_rng(seed)
        values = dict(RANGES)
        sea_rng = np.random.default_rng([seed, 1])
        if index > 0:
            for name in RANGES:
                # Drawn in any case, so that a further range of a task changes no other number.
                share = (sea_rng if name in _OF_THE_SEA else rng).random()
                if name in task.ranges:
                    low, high = task.ranges[name]
                    values[name] = float(low + share * (high - low))
        signs = rng.choice([-1.0, 1.0], size=len(task.crane().swings))
        drawn.append(
            Instance(
                task=task,
                index=index,
                seeds=seeds,
                values=values,
                swing_signs=tuple(signs.tolist()),
                noise_seed=int(rng.integers(2**63)),
                sea_seed=int(sea_rng.integers(2**31)),
            )
        )
    return drawn


def check_seeds(seeds: str) -> None:
    """Check the name of seeds.

    Raises:
        OutOfRange: If it is neither `PUBLIC` nor a date.
    """
    if seeds != PUBLIC and not _DATE.fullmatch(seeds):
        raise OutOfRange("seeds", quoted(seeds), f"{PUBLIC}, or a date such as 2026-11-28")


def seed_of(seeds: str, task_name: str, index: int) -> int:
    """Return the seed of an instance: the first eight bytes of the SHA-256 of version, seeds, task
    and index. Nobody can choose a date whose seeds suit a controller that is already published.
    """
    text = f"cranedyn benchmark {VERSION} {seeds} {task_name} {index}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


# --- reading --------------------------------------------------------------------------------------


def all_tasks() -> list[CraneTask]:
    """Return the tasks of this version, crane by crane."""
    found: list[CraneTask] = []
    for file in sorted(FOLDER.glob("*.toml")):
        found += read_tasks(file)
    return found


def select_tasks(patterns: Sequence[str]) -> list[CraneTask]:
    """Return tasks of this version by name, crane or kind; all of them if there are no patterns.

    Raises:
        UnknownName: If a pattern is none of these.
    """
    tasks = all_tasks()
    if not patterns:
        return tasks
    known: set[str] = set()
    for task in tasks:
        known |= {task.name, task.crane_name, task.kind}
    for pattern in patterns:
        if pattern not in known:
            raise UnknownName("task, crane or kind of task", pattern, sorted(known))
    return [
        task for task in tasks if {task.name, task.crane_name, task.kind}.intersection(patterns)
    ]


_CRANE_FIELDS = ("urdf", "machine", "values")
_DRIVE_FIELDS = ("delay", "rates", "accelerations", "jerks", "lags")
_CLOCK_FIELDS = ("period", "step")
_TASK_FIELDS = (
    *("start", "goal", "waypoints", "durations", "joystick", "gusts", "duration"),
    *("tolerance", "hold", "swing_bound", "corridor", "stray", "least_time", "perturbed"),
)
_TABLES = {
    "crane": _CRANE_FIELDS,
    "drives": _DRIVE_FIELDS,
    "clock": _CLOCK_FIELDS,
    "sensors": Sensors._fields,
    "perturbed": ("count", *RANGES),
}
"""Tables of a file of tasks beside [tasks.KIND], with their fields."""

_NEEDED = {
    "move": ("goal",),
    "unknown": ("goal",),
    "sensors": ("goal",),
    "path": ("waypoints", "durations", "corridor"),
    "wind": ("gusts", "corridor"),
    "operator": ("joystick", "stray"),
}
"""What a task of each kind needs beside what all tasks have."""


@cache
def read_tasks(file: Path) -> tuple[CraneTask, ...]:
    """Return the tasks of a file, in the order of `KINDS`.

    Raises:
        DataError: If the file cannot be read, or a field is missing, unknown or out of its range;
            the message names file, line and field.
    """
    text = read_text(file)
    content = parse_toml(text, file)
    lines = dict(field_lines(text))
    headers = {name: of_table[""] for (name, _), of_table in lines.items()}
    top_lines = headers | lines.get(("", 0), {})
    allowed = ["title", "source", "tasks", "sea", *_TABLES]
    top = SiteTable(file, "", content, top_lines, allowed)
    top.text("title")
    top.text("source")
    tables = {}
    for name, fields in _TABLES.items():
        values = top.take(name, _table)
        tables[name] = SiteTable(file, name, values, lines.get((name, 0), {}), fields)
    if "sea" in content:
        values = top.take("sea", _table)
        of_sea = lines.get(("sea", 0), {})
        tables["sea"] = SiteTable(file, "sea", values, of_sea, list(Sea.__annotations__))
    kinds = SiteTable(file, "tasks", top.take("tasks", _table), top_lines, KINDS)
    found = []
    for kind in KINDS:
        if kind in kinds.values:
            values = kinds.take(kind, _table)
            of_kind = lines.get((f"tasks.{kind}", 0), {})
            own = SiteTable(file, f"tasks.{kind}", values, of_kind, _TASK_FIELDS)
            found.append(_task(file, kind, content, tables, own))
    return tuple(found)


def _task(
    file: Path, kind: str, content: dict[str, Any], tables: Mapping[str, SiteTable], own: SiteTable
) -> CraneTask:
    """Return a task from the tables of its file and its own table."""
    for field in _NEEDED[kind]:
        if field not in own.values:
            own.fail(field, f"it is missing; a task of the kind {kind} needs it.")
    crane = tables["crane"]
    source: dict[str, str] = {}
    for key in ("urdf", "machine"):
        if key in crane.values:
            source[key] = crane.text(key)
    drives = tables["drives"]
    clock = tables["clock"]
    perturbed = tables["perturbed"]
    ranges = _ranges(perturbed, perturbed.values)
    if "perturbed" in own.values:
        ranges |= _ranges(own, own.take("perturbed", _table))
    return CraneTask(
        file=file,
        crane_name=file.stem,
        kind=kind,
        crane_source=source,
        values=crane.take("values", crane_values, {}),
        drives={
            attribute: drives.take(attribute, crane_values)
            for attribute in _DRIVE_FIELDS
            if attribute != "delay"
        },
        drive_delay=drives.number("delay", unit="s", allowed=">= 0"),
        period=clock.number("period", unit="s", allowed="> 0"),
        step=clock.number("step", unit="s", allowed="> 0"),
        duration=own.number("duration", unit="s", allowed="> 0"),
        start=own.take("start", crane_values, {}),
        goal=own.take("goal", crane_values) if "goal" in own.values else None,
        waypoints=own.take("waypoints", _rows, []),
        durations=own.take("durations", _numbers, []),
        joystick=own.take("joystick", _rows, []),
        gusts=own.take("gusts", _gusts) if "gusts" in own.values else None,
        sea=_sea(tables["sea"]) if "sea" in tables else None,
        tolerance=own.number("tolerance", allowed="> 0"),
        hold=own.number("hold", unit="s", allowed="> 0"),
        swing_bound=own.number("swing_bound", unit="rad", allowed="> 0"),
        corridor=own.optional_number("corridor", "m", "> 0"),
        stray=own.optional_number("stray", "rad or m", "> 0"),
        least_time=own.optional_number("least_time", "s", "> 0"),
        sensors=_sensors(tables["sensors"]),
        ranges=ranges,
        count=perturbed.take("count", _count),
        digest=_digest(kind, content),
    )


def _sensors(table: SiteTable) -> Sensors:
    """Return how the state is measured."""
    return Sensors(
        noise=table.number("noise", unit="", allowed=">= 0"),
        delay=table.take("delay", partial(whole, minimum=0)),
        position_step=table.number("position_step", unit="rad or m", allowed=">= 0"),
        swing_step=table.number("swing_step", unit="rad", allowed=">= 0"),
    )


def _sea(table: SiteTable) -> Sea:
    """Return the sea, and how the ship answers it."""
    rows = table.take("raos", _rows)
    if any(len(row) != 7 for row in rows):
        allowed = "rows of 7 numbers: frequency, and magnitude and phase of heave, roll and pitch"
        table.fail("raos", OutOfRange("raos", "rows of other lengths", allowed))
    place = table.take("place", _numbers)
    if len(place) != 3:
        table.fail("place", OutOfRange("place", place, "3 numbers", "m"))
    return Sea(
        hs=table.number("hs", unit="m", allowed="> 0"),
        tp=table.number("tp", unit="s", allowed="> 0"),
        gamma=table.number("gamma", unit="", allowed=">= 1"),
        place=tuple(place),
        raos=tuple(tuple(row) for row in rows),
    )


def _ranges(table: SiteTable, values: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the ranges of a table of perturbations by name."""
    ranges = {}
    for name, value in values.items():
        if name == "count":
            continue
        if name not in RANGES:
            table.fail("perturbed", UnknownName("perturbation", name, RANGES))
        if not isinstance(value, list) or len(value) != 2:
            table.fail(name, OutOfRange(name, quoted(value), "a list of the two ends of a range"))
        low, high = (number(f"an end of {name}", end) for end in value)
        if low > high:
            table.fail(name, OutOfRange(name, value, "the lower end first"))
        ranges[name] = (low, high)
    return ranges


def _digest(kind: str, content: dict[str, Any]) -> str:
    """Return the SHA-256 of all data that a task depends on, without comments and spaces."""
    data = {key: value for key, value in content.items() if key not in ("title", "source")}
    data["tasks"] = {kind: content["tasks"][kind]}
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


# --- conversions of fields, which raise without a line; `SiteTable.take` adds it ------------------


def _table(name: str, value: Any) -> dict[str, Any]:
    """Return a table."""
    if not isinstance(value, dict):
        raise OutOfRange(name, quoted(value), f"a table [{name}]")
    return value


def _numbers(name: str, value: Any) -> list[float]:
    """Return a list of finite numbers."""
    if not isinstance(value, list):
        raise OutOfRange(name, quoted(value), "a list of numbers")
    return [number(f"one of {name}", entry) for entry in value]


def _rows(name: str, value: Any) -> list[list[float]]:
    """Return a list of rows of finite numbers, one row at least."""
    if not isinstance(value, list) or not value:
        raise OutOfRange(name, quoted(value), "a list of rows of numbers")
    return [_numbers(f"a row of {name}", row) for row in value]


def _gusts(name: str, value: Any) -> Gusts:
    """Return the gusts of a table."""
    table = _table(name, value)
    if set(table) != set(Gusts._fields):
        raise DataError(f"it has the fields {', '.join(table)}; needed: {Gusts._fields}.")
    return Gusts(
        speed=number("speed of gusts", table["speed"], "m/s", ">= 0"),
        area=number("area of the load", table["area"], "m²", ">= 0"),
        direction=number("direction of gusts", table["direction"], "rad"),
        at=number("begin of gusts", table["at"], "s", ">= 0"),
        lasts=number("duration of a gust", table["lasts"], "s", "> 0"),
        repeats=whole("number of gusts", table["repeats"], 1),
    )


def _count(name: str, value: Any) -> int:
    """Return a number of perturbed instances."""
    count = whole(name, value, 0)
    if count > _MAX_INSTANCES:
        raise OutOfRange(name, count, f"{_MAX_INSTANCES} at most")
    return count
