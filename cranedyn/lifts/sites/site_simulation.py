"""Simulate the cranes of a site by one clock, with messages that come late or never.

Conventions of this module:

* m drives, n coordinates (the drives and two swing joints), N copies of a site in lockstep.
* Rows of a run are a `CYCLE` apart: one for each cycle of guards and supervisor, at its beginning.
* A crane is named by its index among `CraneSite.stations`.
* The *pairs* of a site are those of `itertools.combinations` of its cranes, in this order.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
import pyarrow as pa

from cranedyn.checks import as_array, number, whole
from cranedyn.command import defer_next_sigint
from cranedyn.compiled.fleet import Fleet
from cranedyn.data.tables import arrow, write_table
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import Speed
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError, OutOfRange, RunError, format_error, quoted
from cranedyn.interfaces import EngineName, State
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite, SiteWind, Station
from cranedyn.lifts.sites.distance_proof import least_distances
from cranedyn.lifts.sites.guard import BoxGrant, BoxRequest, Guard
from cranedyn.lifts.sites.placed_capsules import PlacedCapsules, place_crane
from cranedyn.lifts.sites.promise import unjudged_ropes
from cranedyn.lifts.sites.supervisor import Supervisor
from cranedyn.lifts.sites.working_wind import CALM
from cranedyn.recording import Obstacle, Run, Scenery, record
from cranedyn.simulation.run_spec import make_run_spec
from cranedyn.simulation.stepper import RecordedCrane

SiteOperator = Callable[[float, Sequence[State]], np.ndarray]
"""Rates of the drives of one crane [rad/s or m/s], shape (m,), at a time [s] and states of all."""


# A point that accelerates by a leaves the chord of its path over the time T by a T²/8 at most. No
# point of a crane accelerates by more than 32 m/s², about three times that of free fall.
_BEND = 32.0 * CYCLE**2 / 8.0
"""Largest distance of a point from its straight line between two rows [m]."""

_ROWS_AT_ONCE = 1000
"""Rows whose distances are measured in one call, which bounds the memory that it takes."""

_SHORTEST_SPAN = 1.0 / 64.0
"""Share of the way between two rows that is not halved again."""

_TIME_ROUNDING = 1e-9
"""Rounding error of times of messages, which are multiples of the cycle plus the latency [s]."""

_SOLIDS = -2
"""Index that stands for the solids of the site, see `_Pair`."""

_ZONES = -1
"""Index that stands for the zones of the site, see `_Pair`."""


class Deadlock(NamedTuple):
    """A cycle in which cranes wait for each other in a circle.

    Attributes:
        t: Time [s].
        cranes: Cranes each of which waits for the next, and the last for the first.
        refuges: Positions of the drives to which each crane withdraws that lets another pass
            [rad or m], by its index.
    """

    t: float
    cranes: tuple[int, ...]
    refuges: dict[int, np.ndarray]


class Wait(NamedTuple):
    """A time in which the same cranes wait for each other in a circle.

    Attributes:
        begin: Time at which they begin to [s].
        duration: For how long [s].
        words: Which crane waits for which, and which one lets another pass where.
    """

    begin: float
    duration: float
    words: str


class MessageChannel(NamedTuple):
    """Network between cranes and supervisor.

    Attributes:
        latency: Time that a message takes [s].
        loss: Probability that a message is lost.
    """

    latency: float = 0.0
    loss: float = 0.0


class SiteContact(NamedTuple):
    """Beginning of a contact of two cranes, or of a crane and an obstacle.

    Attributes:
        t: Time [s].
        first: Name of the crane, of two cranes the first of the site.
        second: Name of the other crane, or of the obstacle.
        first_body: Name of the body of the first that touches, see `CraneBodies.names`.
        second_body: Name of the body of the other crane; "" for an obstacle.
    """

    t: float
    first: str
    second: str
    first_body: str
    second_body: str


@dataclass(frozen=True, eq=False, repr=False)
class SiteRun:
    """A simulated site, rows a `CYCLE` apart.

    Attributes:
        site: The site.
        t: Times [s], shape (rows,).
        trajectories: Trajectory of each crane; setpoints are where its drives stand.
        commands: Rates that were commanded, shape (rows, m) each.
        passed: Rates that went to the drives, shape (rows, m) each.
        distances: Least distance of each pair of cranes [m], shape (rows, pairs), in the order of
            `itertools.combinations`.
        clearances: Least distance of each crane from obstacles, and of its rope and load from
            zones [m], shape (rows, cranes); inf where there are none.
        contacts: Beginnings of contacts: in a row, or not proven to be none between two rows.
        swing: Largest angle of each rope from rest [rad], shape (cranes,).
        outside: Largest distance by which a drive of each crane left its box [rad or m], shape
            (cranes,); negative inside, -inf without a supervisor.
        deadlocks: All cycles in which cranes waited for each other in a circle.
        boxes: Box in which each crane was kept [rad or m], shape (rows, 2, m) each; none without a
            supervisor.
        wind_speed: Wind on the loads [m/s], shape (rows,).
        wind_area: Drag coefficient times area of each load in this wind [m²].
    """

    site: CraneSite
    t: np.ndarray
    trajectories: tuple[Trajectory, ...]
    commands: list[np.ndarray]
    passed: list[np.ndarray]
    distances: np.ndarray
    clearances: np.ndarray
    contacts: tuple[SiteContact, ...]
    swing: np.ndarray
    outside: np.ndarray
    deadlocks: tuple[Deadlock, ...]
    boxes: tuple[np.ndarray, ...] = ()
    wind_speed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    wind_area: float = 0.0

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        swing_percent = 100.0 * self.swing.max() / self.site.swing
        text = (
            f"Run: {len(self.contacts)} contacts, least distance {self.least_distance:.2f} m, "
            f"largest swing {swing_percent:.0f} % of the envelope"
        )
        waits = self.waits
        if waits:
            text += f"; waits in a circle: {len(waits)}, first {waits[0].words}"
        if self.violation:
            text += f"; the model {self.violation}"
        for words in self.broken_assumptions:
            text += f"; outside of what the site assumes: {words}"
        return text

    @property
    def broken_assumptions(self) -> list[str]:
        """What in this run was outside of what the promise of the site assumes, in words; empty if
        nothing was.

        Contacts of such a run say nothing about what the site promises, and neither does their
        absence.
        """
        broken = unjudged_ropes(self.site)
        limit = self.site.working_wind
        stated = f"the site states {limit.gust:g} m/s" if limit.gust else "the site states no wind"
        # True also for NaN.
        rows = np.flatnonzero(~(np.abs(self.wind_speed) <= limit.gust))
        if len(rows):
            largest = float(np.abs(self.wind_speed[rows]).max())
            broken.append(
                f"wind of up to {largest:.1f} m/s, from {self.t[rows[0]]:.1f} s on; {stated}"
            )
        # A site that states no wind states no drag area, either.
        if limit.gust and np.any(self.wind_speed) and not self.wind_area <= limit.area:
            broken.append(
                f"loads with a drag area of {self.wind_area:g} m²; the site states {limit.area:g} "
                "m²"
            )
        return broken

    @property
    def states(self) -> list[np.ndarray]:
        """Coordinates and rates of each crane, shape (rows, 2 n) each."""
        return [np.hstack([run.q, run.v]) for run in self.trajectories]

    @property
    def violation(self) -> str:
        """First failure of the model of a crane, with its time; empty if the model holds."""
        failures = []
        for station, run in zip(self.site.stations, self.trajectories, strict=True):
            if run.valid.all():
                continue
            for event in events(station.crane, run)[:1]:
                failures.append((run.t[event.row], f"{station.name}, {event.words}"))
        if not failures:
            return ""
        t, why = min(failures)
        return f"fails from {t:.1f} s on: {why}"

    @property
    def waits(self) -> list[Wait]:
        """Times in which cranes waited for each other in a circle, in their order."""
        # A deadlock that lasts for several cycles is recorded in each of them.
        lasting: list[list[Deadlock]] = []
        for deadlock in self.deadlocks:
            if lasting and _continues(lasting[-1][-1], deadlock):
                lasting[-1].append(deadlock)
            else:
                lasting.append([deadlock])
        waits = []
        for deadlocks in lasting:
            first = deadlocks[0]
            refuges: dict[int, np.ndarray] = {}
            for deadlock in deadlocks:
                refuges.update(deadlock.refuges)
            words = self._in_words(first.cranes, refuges)
            waits.append(Wait(first.t, CYCLE * len(deadlocks), words))
        return waits

    def _in_words(self, deadlocked: tuple[int, ...], refuges: dict[int, np.ndarray]) -> str:
        """Return who waits for whom in a deadlock, and where which crane lets another pass."""
        names = [station.name for station in self.site.stations]
        words = " for ".join(names[i] for i in (*deadlocked, deadlocked[0]))
        for i, refuge in refuges.items():
            drives = zip(self.site.stations[i].crane.layout.driven, refuge, strict=True)
            position = ", ".join(f"{joint.symbol} {q:.2f} {joint.unit}" for joint, q in drives)
            words += f"; {names[i]} lets pass at {position}"
        return words

    @property
    def least_distance(self) -> float:
        """Least distance of any two cranes in a row [m]."""
        return float(self.distances.min(initial=np.inf))

    def gaps(self) -> dict[str, np.ndarray]:
        """Return distances by the names of both cranes, or of a crane and "obstacles" [m]."""
        names = [station.name for station in self.site.stations]
        gaps = {}
        for k, (first, second) in enumerate(itertools.combinations(names, 2)):
            gaps[f"{first}_{second}"] = self.distances[:, k]
        if self.site.solids:
            for k, name in enumerate(names):
                gaps[f"{name}_obstacles"] = self.clearances[:, k]
        return gaps

    def table(self) -> pa.Table:
        """Return the columns of all cranes with their names in front, rates that were commanded and
        passed on, and distances; the metadata has the record of each crane.
        """
        columns = {"t_s": self.t}
        records = {}
        for i, station in enumerate(self.site.stations):
            run = self.trajectories[i]
            for key in run.keys()[1:]:
                columns[f"{station.name}_{key}"] = run[key]
            for kind, rates in (("command", self.commands[i]), ("passed", self.passed[i])):
                for joint, rate in zip(station.crane.layout.driven, rates.T, strict=True):
                    name = f"{station.name}_{joint.symbol}_{kind}_{joint.unit}_s"
                    # An operator may command NaN: such a cell stays empty.
                    columns[name] = arrow().array(rate, from_pandas=True)
            records[station.name] = dict(run.record)
        for name, distance in self.gaps().items():
            columns[f"{name}_distance_m"] = distance
        return arrow().table(columns, metadata={"cranedyn.record": json.dumps(records)})

    def write(self, path: str | Path) -> Path:
        """Write `table` to a ``.csv`` or ``.parquet`` file and return its path.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        return write_table(path, self.table())

    def record(self, path: str | Path) -> Path:
        """Write all cranes at their places, obstacles, distances and contacts into one ``.rrd``
        file and return its path.

        Raises:
            DataError: If the file cannot be written.
            CraneError: If Rerun is switched off in the environment.
        """
        return record(
            path,
            self.runs_to_record(),
            title=self.site.name,
            text=self._text_to_record(),
            gaps=self.gaps(),
            contacts=[contact.t for contact in self.contacts],
        )

    def runs_to_record(self) -> list[Run]:
        """Return all cranes as they are recorded, at their places."""
        return [self._run_to_record(i) for i in range(len(self.site.stations))]

    def _run_to_record(self, i: int) -> Run:
        """Return a crane as it is recorded: at its place, with its reserved boxes.

        The obstacles of the site go with the first crane, so that they are drawn once.
        """
        station = self.site.stations[i]
        solids = station.in_crane_frame(self.site.solids) if i == 0 else []
        obstacles = []
        for solid in solids:
            obstacles.append(Obstacle(solid.name, solid.vertices, solid.triangles, solid.zone))
        reserved = None
        if self.boxes:
            boxes = self.boxes[i]
            # A sector stays as it is drawn until the next one: only changes are recorded.
            changed = np.append(True, np.diff(boxes, axis=0).any(axis=(1, 2)))
            reserved = self.t[changed], station.outline(boxes[changed])
        scenery = None
        if obstacles or reserved is not None:
            scenery = Scenery(obstacles, np.zeros((0, 3)), reserved=reserved)
        x, y, z = (float(coordinate) for coordinate in station.foot)
        return Run(
            station.name,
            station.crane,
            self.trajectories[i],
            (x, y, z),
            scenery=scenery,
            heading=station.turn,
        )

    def _text_to_record(self) -> str:
        """Return contacts and waits as Markdown."""
        lines = ["No contacts."]
        if self.contacts:
            lines = ["**Contacts:**\n"]
        for contact in self.contacts:
            lines.append(
                f"- {contact.t:.1f} s: {contact.first_body} of {contact.first} and "
                f"{contact.second_body} {contact.second}"
            )
        for wait in self.waits:
            lines.append(
                f"\n**Waiting:** {wait.words}, {wait.duration:.1f} s from {wait.begin:.1f} s on."
            )
        if self.boxes:
            lines.append("\nSectors beside jibs, and areas around bridges, are what is reserved.")
        return "\n".join(lines)


def _continues(earlier: Deadlock, later: Deadlock) -> bool:
    """Return whether a deadlock is that of the same cranes in the cycle after an earlier one."""
    is_next_cycle = round(later.t / CYCLE) == round(earlier.t / CYCLE) + 1
    return is_next_cycle and later.cranes == earlier.cranes


def simulate_site(
    site: CraneSite,
    operators: Sequence[SiteOperator],
    *,
    duration: float,
    supervised: bool = True,
    channel: MessageChannel = MessageChannel(),  # noqa: B008
    wind: SiteWind | None = None,
    anemometer: Speed | None = None,
    seed: int = 0,
    dt: float = 2e-3,
    engine: EngineName = "compiled",
) -> SiteRun:
    """Simulate all cranes of a site.

    Args:
        site: The site.
        operators: One for each crane.
        duration: Simulated time [s], rounded to cycles.
        supervised: Whether guards and supervisor stand between operators and drives.
        channel: Network between them.
        wind: Wind on all loads; None for none. Above the wind that the site states the run is
            outside of what the site assumes, see `SiteRun.broken_assumptions`.
        anemometer: What all guards read as the wind speed over time [m/s]; they stop the work above
            the wind that the site states. None reads the wind itself, if the site states one.
        seed: Seed of the losses of messages.
        dt: Physics step [s].
        engine: Engine of each crane, see `cranedyn.simulation.simulate.simulate`.

    Raises:
        OutOfRange: If there is not one operator for each crane, or a number is out of its range; or
            if there is an anemometer, but no guard to read it.
        DataError: If cranes are not proven apart at the start.
        SiteRunError: If the run ends early, since an operator commands a rate that is not finite
            without a supervisor, an operator or the wind raises an error, which is then its cause,
            a crane diverges, or the run is interrupted. It carries all that was recorded.
    """
    rows = _checked(site, operators, channel, duration)
    if anemometer is not None and not supervised:
        raise OutOfRange("anemometer", "given", "none, unless guards read it: supervised=True")
    cranes = [
        _SiteCrane(station, operator, wind, engine, dt, rows)
        for station, operator in zip(site.stations, operators, strict=True)
    ]
    rng = np.random.default_rng(whole("seed", seed, 0))
    network = _Network(site, channel, rng) if supervised else None
    recording = _SiteRecording(site, cranes, network, wind, anemometer)
    try:
        for row in range(rows):
            recording.run_cycle(row * CYCLE)
    except (Exception, KeyboardInterrupt) as error:
        with defer_next_sigint(error):
            recording.end_early(error)
    return recording.result()


class SiteRunError(RunError):
    """A run of a site that ended early.

    Attributes:
        crane: Name of the crane whose turn it was when the run ended; empty if it was none's.
        trajectory: Everything recorded up to then, of all cranes, as a `SiteRun`; None if no cycle
            had ended.
    """

    def __init__(self, sentence: str, *, t: float, crane: str, run: SiteRun | None) -> None:
        super().__init__(sentence, t=t, trajectory=run)
        self.crane = crane


class _SiteRecording:
    """The cycles of a run of a site, and all that is recorded in them."""

    def __init__(
        self,
        site: CraneSite,
        cranes: Sequence[_SiteCrane],
        network: _Network | None,
        wind: SiteWind | None,
        anemometer: Speed | None,
    ) -> None:
        self._site = site
        self._cranes = cranes
        self._network = network
        self._wind = wind
        self._anemometer = anemometer
        self._t = 0.0
        self._in_turn = ""
        self._commands: list[list[np.ndarray]] = []
        self._passed: list[list[np.ndarray]] = []
        self._boxes: list[list[np.ndarray]] = []
        self._wind_speeds: list[float] = []
        self._deadlocks: list[Deadlock] = []

    def run_cycle(self, t: float) -> None:
        """Run all cranes for a cycle from a time on [s]."""
        self._t = t
        states = [crane.state for crane in self._cranes]
        commands = []
        for crane in self._cranes:
            self._in_turn = crane.name
            commands.append(crane.command(t, states))
        self._in_turn = ""
        wind_speed = 0.0 if self._wind is None else float(self._wind.speed(t))

        passed = commands
        boxes = []
        if self._network is not None:
            measured = [State(q[None], v[None]) for q, v in states]
            requested = [command[None] for command in commands]
            reading = self._reading(t, wind_speed)
            passed = [rates[0] for rates in self._network.step(t, measured, requested, reading)]
            boxes = [guard.box[0] for guard in self._network.guards]
            supervisor = self._network.supervisor
            deadlocked = supervisor.deadlock()
            if deadlocked:
                self._deadlocks.append(Deadlock(t, deadlocked, supervisor.refuges()))

        for crane, rates in zip(self._cranes, passed, strict=True):
            self._in_turn = crane.name
            crane.step(rates, crane.driven_position(), crane.force())
        self._in_turn = ""

        # A cycle counts once all cranes have gone through it, see `result`.
        self._commands.append(commands)
        self._passed.append(passed)
        self._wind_speeds.append(wind_speed)
        if self._network is not None:
            self._boxes.append(boxes)

    def _reading(self, t: float, wind_speed: float) -> float | None:
        """Return what guards read as the wind speed [m/s]; None if nobody reads any."""
        if self._anemometer is not None:
            return float(self._anemometer(t))
        return None if self._site.working_wind == CALM else wind_speed

    def result(self) -> SiteRun:
        """Return the run up to the last cycle that all cranes have gone through."""
        site = self._site
        cranes = self._cranes
        rows = len(self._commands)
        trajectories = []
        for crane in cranes:
            trajectory = crane.trajectory()
            if len(trajectory.t) > rows:
                # This crane was stepped in the cycle in which another one ended the run.
                trajectory = trajectory.before((rows - 0.5) * CYCLE)
            trajectories.append(trajectory)
        swings = []
        for crane, run in zip(cranes, trajectories, strict=True):
            swings.append(np.linalg.norm(crane.crane.swing_angles(run.q), axis=1).max())

        boxes = [np.array(of_crane) for of_crane in zip(*self._boxes, strict=True)]
        outside = [-math.inf] * len(cranes)
        for i, box in enumerate(boxes):
            position = trajectories[i].q[:, cranes[i].crane.layout.drives]
            outside[i] = float(np.maximum(box[:, 0] - position, position - box[:, 1]).max())

        watch = _Watch(site)
        measured_rows = []
        for first in range(0, rows, _ROWS_AT_ONCE):
            chunk = [run.q[first : first + _ROWS_AT_ONCE, None] for run in trajectories]
            measured_rows.append(watch.measure(chunk)[:, 0])
        measured = np.concatenate(measured_rows)

        # The columns of the watch: pairs of cranes, then each crane with the solids, then each with
        # the zones.
        pair_count = math.comb(len(cranes), 2)
        clearances = np.full((rows, len(cranes)), np.inf)
        if site.solids:
            from_solids, from_zones = np.split(measured[:, pair_count:], 2, axis=1)
            clearances = np.minimum(from_solids, from_zones)
        return SiteRun(
            site=site,
            t=CYCLE * np.arange(rows),
            trajectories=tuple(trajectories),
            commands=[np.array(of_crane) for of_crane in zip(*self._commands, strict=True)],
            passed=[np.array(of_crane) for of_crane in zip(*self._passed, strict=True)],
            distances=measured[:, :pair_count],
            clearances=clearances,
            contacts=tuple(contact for _, contact in watch.contacts),
            swing=np.array(swings),
            outside=np.array(outside),
            deadlocks=tuple(self._deadlocks),
            boxes=tuple(boxes),
            wind_speed=np.array(self._wind_speeds),
            wind_area=0.0 if self._wind is None else self._wind.area,
        )

    def end_early(self, error: BaseException) -> NoReturn:
        """Raise the error of a run that ends in this cycle by another error."""
        if not self._commands and isinstance(error, CraneError) and not isinstance(error, RunError):
            raise error
        run = self.result() if self._commands else None
        whose = f"of {quoted(self._in_turn)} " if self._in_turn else ""
        if isinstance(error, KeyboardInterrupt):
            message = f"The run {whose}was interrupted at t = {self._t:.3f} s."
            raise SiteRunError(message, t=self._t, crane=self._in_turn, run=run) from None
        message = f"The run {whose}ended at t = {self._t:.4g} s: {format_error(error)}"  # type: ignore[arg-type]
        ended = SiteRunError(message, t=self._t, crane=self._in_turn, run=run)
        if isinstance(error, RunError):
            ended.joint = error.joint
            ended.value = error.value
        raise ended from error


def _checked(
    site: CraneSite, operators: Sequence[SiteOperator], channel: MessageChannel, duration: float
) -> int:
    """Return the number of cycles after checking the arguments of a run."""
    if len(operators) != len(site.stations):
        raise OutOfRange("number of operators", len(operators), f"{len(site.stations)}")
    number("latency", channel.latency, "s", ">= 0")
    number("loss of messages", channel.loss, "", "0 to 1")
    return whole("cycles", round(number("duration", duration, "s", "> 0") / CYCLE), 1)


class SiteExtremes(NamedTuple):
    """Contacts and extreme values of runs of N copies of a site.

    Attributes:
        contacts: Number of contacts, shape (N,).
        least: Least distance of any two cranes in a row [m], shape (N,).
        swing: Largest angle of any rope from rest [rad], shape (N,).
        outside: Largest distance by which a drive left its box [rad or m], shape (N,); negative
            inside.
    """

    contacts: np.ndarray
    least: np.ndarray
    swing: np.ndarray
    outside: np.ndarray


def simulate_copies(
    site: CraneSite,
    operators: Sequence[SiteOperator],
    *,
    copies: int,
    duration: float,
    channel: MessageChannel = MessageChannel(),  # noqa: B008
    seed: int = 0,
    dt: float = 2e-3,
) -> SiteExtremes:
    """Simulate N copies of a site in lockstep under its supervisor; only extremes are kept.

    Args:
        site: The site.
        operators: One for each crane, in all copies: states have coordinates and rates of shape
            (N, n), rates of the drives are of shape (N, m).
        copies: Number of copies, N.
        duration: Simulated time [s], rounded to cycles.
        channel: Network between cranes and supervisor.
        seed: Seed of the losses of messages, different in each copy.
        dt: Physics step [s].

    Raises:
        OutOfRange: As of `simulate_site`.
        DataError: As of `simulate_site`.
        RunError: If a crane diverges.
    """
    rows = _checked(site, operators, channel, duration)
    network = _Network(site, channel, np.random.default_rng(whole("seed", seed, 0)), copies)
    cranes = [
        Fleet(x.crane, copies, dt=dt, control_period=CYCLE, drive=x.converters, threads=1)
        for x in site.stations
    ]
    watch = _Watch(site)
    pair_count = math.comb(len(cranes), 2)
    nearest = np.full(copies, math.inf)
    swing = np.zeros(copies)
    outside = np.full(copies, -math.inf)
    for row in range(rows):
        t = row * CYCLE
        states = [_state_of(fleet) for fleet in cranes]
        passed = network.step(t, states, [operator(t, states) for operator in operators])

        # A distance that is proven beyond the least one up to now cannot be the least.
        within_distance = np.maximum(nearest, site.distance)[:, None]
        measured = watch.measure([state.q[None] for state in states], within_distance)
        distances = measured[0, :, :pair_count]
        nearest = np.minimum(nearest, distances.min(axis=1, initial=math.inf))
        for i, fleet in enumerate(cranes):
            guard = network.guards[i]
            crane = guard.station.crane
            angles = crane.swing_angles(states[i].q)
            swing = np.maximum(swing, np.sqrt((angles * angles).sum(axis=1)))
            position = states[i].q[:, crane.layout.drives]
            beyond = np.maximum(guard.box[:, 0] - position, position - guard.box[:, 1])
            outside = np.maximum(outside, beyond.max(axis=1))
            fleet.step(passed[i].T)
    if not np.isfinite(swing).all():
        raise RunError("A crane of the site diverged; a smaller dt may help.", t=t)
    contacts = np.bincount([copy for copy, _ in watch.contacts], minlength=copies)
    return SiteExtremes(contacts, nearest, swing, outside)


def _state_of(fleet: Fleet) -> State:
    """Return a copy of the state of all copies of a crane, shape (N, n) each."""
    q, v = np.split(fleet.z.T.copy(), 2, axis=1)
    return State(q, v)


class _Network:
    """Guards, supervisor and the messages between them, on N copies of a site in lockstep."""

    def __init__(
        self, site: CraneSite, channel: MessageChannel, rng: np.random.Generator, copies: int = 1
    ) -> None:
        self.guards = [
            Guard(station, site.swing, copies, site.working_wind) for station in site.stations
        ]
        self.supervisor = Supervisor(site, [guard.box for guard in self.guards])
        self._channel = channel
        self._rng = rng
        self._up: list[tuple[float, int, BoxRequest]] = []
        self._down: list[tuple[float, int, BoxGrant]] = []

    def step(
        self,
        t: float,
        states: Sequence[State],
        commands: Sequence[np.ndarray],
        wind_speed: float | None = None,
    ) -> list[np.ndarray]:
        """Exchange the messages that arrive in a cycle, and return the rates for the drives of each
        crane, shape (N, m) each.

        Requests and answers pass through within a cycle if the network has no latency.

        Args:
            t: Time [s].
            states: State of each crane on all copies, shape (N, n).
            commands: Rates that its operator commands, shape (N, m).
            wind_speed: What all guards read as the wind speed [m/s]; None if they read none.
        """
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        passed = []
        for i, guard in enumerate(self.guards):
            rates, request = guard.step(t, states[i], commands[i], wind_speed)
            passed.append(rates)
            self._send(self._up, t, i, request)
        for i, request in self._arrived(self._up, t):
            self._send(self._down, t, i, self.supervisor.receive(i, request))
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        return passed

    def _send(self, queue: list, t: float, station: int, message: BoxRequest | BoxGrant) -> None:
        """Put a message into a queue, without the copies on which it is lost."""
        arrives = self._rng.random(len(message.copies)) >= self._channel.loss
        if arrives.any():
            sent = type(message)._make(values[arrives] for values in message)
            queue.append((t + self._channel.latency, station, sent))

    def _arrived(self, queue: list, t: float) -> list:
        """Take the messages that have arrived by a time [s] from a queue, and return each with the
        index of its crane.
        """
        arrived = []
        on_the_way = []
        for due, station, message in queue:
            if due <= t + _TIME_ROUNDING:
                arrived.append((station, message))
            else:
                on_the_way.append((due, station, message))
        queue[:] = on_the_way
        return arrived


class _SiteCrane(RecordedCrane):
    """A crane with its operator and its wind.

    Attributes:
        name: Name of the crane.
    """

    def __init__(
        self,
        station: Station,
        operator: SiteOperator,
        wind: SiteWind | None,
        engine: EngineName,
        dt: float,
        cycles: int,
    ) -> None:
        """Begin at the start of a run of some cycles."""
        self.name = station.name
        self._operator = operator
        self._wind = None if wind is None else wind.on(station)
        spec = make_run_spec(
            station.crane,
            start=None,
            t_start=0.0,
            duration=cycles * CYCLE,
            dt=dt,
            control_period=CYCLE,
            drive=station.converters,
            integrator=semi_implicit_euler,
            validity="mark",
            disturbance=self._wind,
            ground=None,
        )
        super().__init__(spec, engine, controller=operator)

    def command(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands, shape (m,)."""
        layout = self.crane.layout
        rates = self._operator(t, states)
        # A copy, since an operator may return one array again and again, and write into it.
        return as_array("command", rates, (layout.m,), meaning=layout.drives_in_words).copy()

    def force(self) -> np.ndarray | None:
        """Return the forces of the wind [N], shape (points, 3); None for no wind."""
        return None if self._wind is None else self._wind(self.t, self.state)

    def driven_position(self) -> np.ndarray:
        """Return the positions of the drives, shape (m,). The log takes them for the setpoint: an
        operator commands rates.
        """
        return self.state.q[self.crane.layout.drives]


class _Pair(NamedTuple):
    """A crane and what it must not touch.

    Attributes:
        first: Index of the crane.
        second: Index of another crane, or `_SOLIDS` or `_ZONES`, which are negative.
    """

    first: int
    second: int

    @property
    def is_of_cranes(self) -> bool:
        """Whether the second is a crane."""
        return self.second >= 0


class _Watch:
    """Distances in each row of a run of N copies of a site, and contacts in rows and between.

    Distances are of the capsules around the cranes, with their ropes as they hang. Each call of
    `measure` goes on where the last one ended.

    Attributes:
        contacts: Beginnings of contacts, each with the index of its copy.
    """

    def __init__(self, site: CraneSite) -> None:
        """Watch all pairs of a site: two cranes, or a crane and the solids or zones."""
        cranes = range(len(site.stations))
        self._site = site
        self._pairs = [_Pair(a, b) for a, b in itertools.combinations(cranes, 2)]
        if site.solids:
            self._pairs += [_Pair(crane, _SOLIDS) for crane in cranes]
            self._pairs += [_Pair(crane, _ZONES) for crane in cranes]

        # Number of rows up to now, and the last of them: ends of the capsules of each crane, and
        # distances of all pairs.
        self._row = 0
        self._last_ends: list[np.ndarray] | None = None
        self._last_distances: np.ndarray = np.zeros(0)

        # Rows of contacts, each with its copy and the names of both.
        self._touching: set[tuple[int, int, str, str]] = set()
        self.contacts: list[tuple[int, SiteContact]] = []

    def measure(
        self, paths: Sequence[np.ndarray], within: np.ndarray | float = math.inf
    ) -> np.ndarray:
        """Return the least distance of each pair in rows that follow those of the last call [m],
        shape (rows, N, pairs).

        Args:
            paths: Coordinates of each crane, shape (rows, N, n) each.
            within: Distances that are of interest [m], shape (N, 1). Where the last distance of a
                pair, less the motion since then, is beyond that, this lower bound is returned in
                place of its distance.
        """
        is_first_call = self._last_ends is None
        after = [self._place(i, path) for i, path in enumerate(paths)]
        if self._last_ends is None:
            before = [ends[:1] for ends in after]
            # Nothing is known of the distances before the first row.
            last_distances = np.full((1, paths[0].shape[1], 1), -math.inf)
        else:
            before = self._last_ends
            last_distances = self._last_distances
        ends = [np.concatenate(both) for both in zip(before, after, strict=True)]
        motion = self._motion(ends)

        # No distance falls by more than both bodies move.
        distances = last_distances - np.cumsum(motion, axis=0)
        # True also for NaN: what is no number counts as near, here and below.
        is_near = ~(distances >= within)
        for k, pair in enumerate(self._pairs):
            near = is_near[..., k]
            if near.any():
                distances[near, k] = self._least(pair, [placed[near] for placed in after])

        # While two bodies move by d together, between distances a and b, no distance is less than
        # (a + b - d)/2, see `_proven`. That is on straight lines: bodies are off them by up to
        # `_BEND` each, 2 `_BEND` together. So no contact is possible where a + b - d > 4 `_BEND`.
        preceding = distances[:1] if is_first_call else last_distances
        in_all_rows = np.concatenate([preceding, distances])
        spare = in_all_rows[1:] + in_all_rows[:-1] - motion
        for row, copy, k in np.argwhere(~(spare > 4.0 * _BEND)).tolist():
            states_before = [placed[row, copy] for placed in ends]
            states_after = [placed[row + 1, copy] for placed in ends]
            contact = self._contact(self._row + row, self._pairs[k], states_before, states_after)
            if contact is not None:
                self._note(self._row + row, copy, contact)

        self._last_ends = [placed[-1:] for placed in after]
        self._last_distances = distances[-1:]
        self._row += len(distances)
        return distances

    def _note(self, row: int, copy: int, contact: SiteContact) -> None:
        """Keep a contact in a row if it begins there: if both did not touch in the row before."""
        if (row - 1, copy, contact.first, contact.second) not in self._touching:
            self.contacts.append((copy, contact))
        self._touching.add((row, copy, contact.first, contact.second))

    def _motion(self, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return by how much both of each pair move from row to row [m], shape (rows, N, pairs).

        A crane moves by as much as the end of a capsule that moves farthest.

        Args:
            ends: Ends of the capsules of each crane, shape (rows + 1, N, capsules, 2, 3) each.
        """
        moved = []
        for placed in ends:
            step = np.diff(placed, axis=0)
            moved.append(np.sqrt(np.einsum("...i,...i", step, step).max(axis=(2, 3))))
        motion = np.zeros((*moved[0].shape, len(self._pairs)))
        for k, pair in enumerate(self._pairs):
            motion[..., k] = moved[pair.first]
            if pair.is_of_cranes:
                motion[..., k] += moved[pair.second]
        return motion

    def _place(self, i: int, path: np.ndarray) -> np.ndarray:
        """Return the ends of the capsules of a crane [m], shape (rows, N, capsules, 2, 3)."""
        station = self._site.stations[i]
        q = path.reshape(-1, path.shape[-1])
        position = self._site.positions(i, q[:, station.crane.layout.drives])
        ends = place_crane(self._site.bodies, i, position, q[:, station.crane.swings])

        # All cranes have as many capsules as the one with most, see `stacked`.
        own = ends[:, : len(station.bodies.names)]
        return own.reshape(*path.shape[:2], -1, 2, 3)

    def _least(self, pair: _Pair, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return the least distance of a pair in rows [m], shape (rows,), from the ends of the
        capsules of all cranes.
        """
        if pair.is_of_cranes:
            first_compared, second_compared = self._compared(pair)
            first = self._capsules(pair.first, ends[pair.first])
            second = self._capsules(pair.second, ends[pair.second])
            return least_distances(
                _of_capsules(first, first_compared), _of_capsules(second, second_compared)
            )
        return np.array([self._gaps(pair, row).min() for row in zip(*ends, strict=True)])

    def _compared(self, pair: _Pair) -> tuple[np.ndarray, np.ndarray]:
        """Return which capsules of both cranes of a pair are compared with each other."""
        return (
            self._site.compared_capsules(pair.first, pair.second),
            self._site.compared_capsules(pair.second, pair.first),
        )

    def _capsules(self, i: int, ends: np.ndarray) -> PlacedCapsules:
        """Return the capsules of a crane with their ends at points."""
        radius = np.broadcast_to(self._site.stations[i].bodies.radius, ends.shape[:-2])
        return PlacedCapsules(ends, radius, np.zeros(0))

    def _gaps(self, pair: _Pair, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return the gaps of all capsules of a pair at an instant [m].

        Of two cranes these are the gaps of the first capsule with each of the other crane, then of
        the second, and so on.
        """
        if pair.is_of_cranes:
            first = self._capsules(pair.first, ends[pair.first])
            second = self._capsules(pair.second, ends[pair.second])
            first_compared, second_compared = self._compared(pair)
            rows, columns = np.meshgrid(first_compared, second_compared, indexing="ij")
            # What is not compared counts as infinitely far.
            gaps_of_pair = np.full((len(first.ends), len(second.ends)), math.inf)
            gaps_of_pair[rows, columns] = least_distances(
                _selected(first, rows.ravel()), _selected(second, columns.ravel())
            ).reshape(rows.shape)
            return gaps_of_pair.ravel()
        bodies = self._site.stations[pair.first].bodies
        radii = bodies.radius.tolist()
        hangs = bodies.hangs.tolist()
        gaps = []
        for k, segment in enumerate(ends[pair.first]):
            margins = self._site.obstacles.margins(segment, radii[k], hangs=hangs[k])
            gaps.append(margins.from_solids if pair.second == _SOLIDS else margins.from_zones)
        return np.array(gaps)

    def _contact(
        self,
        row: int,
        pair: _Pair,
        before: Sequence[np.ndarray],
        after: Sequence[np.ndarray],
    ) -> SiteContact | None:
        """Return the first contact of a pair that is not excluded since the row before; None if all
        are, nearest capsules first.

        Args:
            row: Number of the row.
            pair: The pair.
            before: Ends of the capsules of each crane in the row before [m].
            after: The same in this row.
        """
        old_gaps = self._gaps(pair, before)
        gaps = self._gaps(pair, after)
        motions = [b - a for a, b in zip(before, after, strict=True)]
        farthest = [np.linalg.norm(motion, axis=2).max(axis=1) for motion in motions]
        moved = farthest[pair.first]
        if pair.is_of_cranes:
            moved = np.add.outer(moved, farthest[pair.second]).ravel()
        for k in np.argsort(gaps).tolist():

            def gap(share: float, k: int = k) -> float:
                """Return the gap of this pair of capsules on its way, see `_proven`."""
                ends = [a + share * motion for a, motion in zip(before, motions, strict=True)]
                return float(self._gaps(pair, ends)[k])

            # Both bodies may be off their straight lines.
            bend = 2.0 * _BEND
            if not _proven(gap, float(moved[k]), bend, float(old_gaps[k]), float(gaps[k])):
                return self._named(CYCLE * row, pair, k, after[pair.first])
        return None

    def _named(self, t: float, pair: _Pair, k: int, ends: np.ndarray) -> SiteContact:
        """Return a contact at a time [s] by the names of what touches.

        Args:
            t: Time [s].
            pair: The pair.
            k: Which of its gaps, see `_gaps`.
            ends: Ends of the capsules of the first crane [m].
        """
        first = self._site.stations[pair.first]
        if pair.is_of_cranes:
            second = self._site.stations[pair.second]
            capsule, second_capsule = divmod(k, len(second.bodies.names))
            body = second.bodies.names[second_capsule]
            return SiteContact(t, first.name, second.name, first.bodies.names[capsule], body)
        radius = float(first.bodies.radius[k])
        obstacle = self._site.obstacles.nearest(ends[k], radius, zones=pair.second == _ZONES)
        return SiteContact(t, first.name, obstacle, first.bodies.names[k], "")


def _of_capsules(placed: PlacedCapsules, which: np.ndarray) -> PlacedCapsules:
    """Return some of the capsules in each row of groups of them."""
    return replace(placed, ends=placed.ends[:, which], radius=placed.radius[:, which])


def _selected(capsules: PlacedCapsules, rows: np.ndarray) -> PlacedCapsules:
    """Return the capsules in some rows."""
    return replace(capsules, ends=capsules.ends[rows], radius=capsules.radius[rows])


def _proven(
    gap: Callable[[float], float], moved: float, bend: float, first: float, last: float
) -> bool:
    """Return whether two bodies are proven apart on their way between two rows.

    A gap changes by no more than both bodies move. So in a span in which they move by d, between
    gaps a and b, no gap is less than (a + b - d)/2. A span where that does not exceed the bend is
    halved.

    Args:
        gap: Gap at a share of the straight lines between both rows [m].
        moved: Distance by which both bodies move together [m].
        bend: Largest distance of both together from their straight lines [m].
        first: Gap at the first row [m].
        last: Gap at the last.
    """
    spans = [(0.0, first, 1.0, last)]
    while spans:
        low, gap_low, high, gap_high = spans.pop()
        if gap_low + gap_high - moved * (high - low) > 2.0 * bend:
            continue
        if min(gap_low, gap_high) <= bend or high - low <= _SHORTEST_SPAN:
            return False
        middle = (low + high) / 2.0
        gap_middle = gap(middle)
        spans += [(low, gap_low, middle, gap_middle), (middle, gap_middle, high, gap_high)]
    return True
