"""Simulate the cranes of a site by one clock, with messages that come late or never."""

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
from cranedyn.compiled.fleet import Fleet
from cranedyn.data.tables import arrow, write_table
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import Speed
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError, OutOfRange, RunError, format_error, quoted
from cranedyn.interfaces import EngineName, Setpoint, State
from cranedyn.recording import Obstacle, Run, Scenery, record
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import RunRecord
from cranedyn.simulation.stepper import Stepper
from cranedyn.sites.bodies import PlacedCapsules, place_crane
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import BoxGrant, BoxRequest, Guard
from cranedyn.sites.proof import least_distances
from cranedyn.sites.site import CraneSite, SiteWind, Station
from cranedyn.sites.supervisor import Supervisor
from cranedyn.sites.working_wind import CALM

SiteOperator = Callable[[float, Sequence[State]], np.ndarray]
"""Rates of the drives of one crane [rad/s or m/s], shape (m,), at a time [s] and states of all."""


_BEND = 32.0 * CYCLE**2 / 8.0
"""Way [m] of a point off its straight line between two rows at most: its acceleration is less than
thrice that of a fall."""

_CHUNK = 1000
"""Rows that are measured at once."""

_FINEST = 1.0 / 64.0
"""Share of the way between two rows that is not halved again."""


class MessageChannel(NamedTuple):
    """Network between cranes and supervisor.

    Attributes:
        latency: Time that a message takes [s].
        loss: Probability that a message is lost.
    """

    latency: float = 0.0
    loss: float = 0.0


class SiteContact(NamedTuple):
    """Beginning of a contact.

    Attributes:
        t: Time [s].
        first, second: Names of the cranes, or of a crane and an obstacle.
        first_body, second_body: Names of the bodies that touch; "" for an obstacle.
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
        outside: Largest way of a drive of each crane out of its box [rad or m], shape (cranes,);
            negative inside, -inf without a supervisor.
        deadlocks: Times at which cranes waited for each other in a circle [s], which, and where
            cranes that withdrew let another pass: positions of drives [rad or m].
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
    deadlocks: tuple[tuple[float, tuple[int, ...], dict[int, np.ndarray]], ...]
    boxes: tuple[np.ndarray, ...] = ()
    wind_speed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    wind_area: float = 0.0

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        violation, waits = self.violation, self.waits
        broken = [
            f"; outside of what the site assumes: {words}" for words in self.broken_assumptions
        ]
        return (
            f"Run: {len(self.contacts)} contacts, least distance {self.least_distance:.2f} m, "
            f"largest swing {100.0 * self.swing.max() / self.site.swing:.0f} % of the envelope"
            f"{f'; waits in a circle: {len(waits)}, first {waits[0][2]}' if waits else ''}"
            f"{violation and '; the model '}{violation}"
            f"{''.join(broken)}"
        )

    @property
    def broken_assumptions(self) -> list[str]:
        """What in this run was outside of what the site assumes, in words; empty if nothing was.

        Contacts of such a run say nothing about what the site promises, and neither does their
        absence.
        """
        limit = self.site.working_wind
        stated = f"the site states {limit.gust:g} m/s" if limit.gust else "the site states no wind"
        # True also for NaN.
        rows = np.flatnonzero(~(np.abs(self.wind_speed) <= limit.gust))
        broken = []
        if len(rows):
            largest = float(np.abs(self.wind_speed[rows]).max())
            broken.append(
                f"wind of up to {largest:.1f} m/s, from {self.t[rows[0]]:.1f} s on; {stated}"
            )
        elif np.any(self.wind_speed) and not self.wind_area <= limit.area:
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
        failures = [
            (run.t[event.row], f"{station.name}, {event.words}")
            for station, run in zip(self.site.stations, self.trajectories, strict=True)
            for event in ([] if run.valid.all() else events(station.crane, run)[:1])
        ]
        return "".join(f"fails from {t:.1f} s on: {why}" for t, why in sorted(failures)[:1])

    @property
    def waits(self) -> list[tuple[float, float, str]]:
        """Times [s] from which cranes waited in a circle, how long [s], who, and who let pass."""
        names, result = [station.name for station in self.site.stations], []
        for (_, circle), rows in itertools.groupby(
            enumerate(self.deadlocks), lambda row: (round(row[1][0] / CYCLE) - row[0], row[1][1])
        ):
            times, _, refuges = zip(*(row for _, row in rows), strict=True)
            chain = " for ".join(names[i] for i in (*circle, circle[0]))
            for i, refuge in {k: q for each in refuges for k, q in each.items()}.items():
                drives = zip(self.site.stations[i].crane.layout.driven, refuge, strict=True)
                goal = ", ".join(f"{joint.symbol} {q:.2f} {joint.unit}" for joint, q in drives)
                chain += f"; {names[i]} lets pass at {goal}"
            result.append((times[0], CYCLE * len(times), chain))
        return result

    @property
    def least_distance(self) -> float:
        """Least distance of any two cranes in a row [m]."""
        return float(self.distances.min(initial=np.inf))

    def gaps(self) -> dict[str, np.ndarray]:
        """Return distances by the names of both cranes, or of a crane and "obstacles" [m]."""
        names = [station.name for station in self.site.stations]
        pairs = map("_".join, itertools.combinations(names, 2))
        beside = [f"{name}_obstacles" for name in names if self.site.solids]
        columns = *self.distances.T, *self.clearances.T
        return dict(zip([*pairs, *beside], columns, strict=False))

    def table(self) -> pa.Table:
        """Return the columns of all cranes with their names in front, rates that were commanded and
        passed on, and distances; the metadata has the record of each crane.
        """
        columns, records = {"t_s": self.t}, {}
        rows = zip(self.site.stations, self.trajectories, self.commands, self.passed, strict=True)
        for station, run, *rates in rows:
            columns |= {f"{station.name}_{key}": run[key] for key in run.keys()[1:]}
            for kind, values in zip(("command", "passed"), rates, strict=True):
                for joint, rate in zip(station.crane.layout.driven, values.T, strict=True):
                    name = f"{station.name}_{joint.symbol}_{kind}_{joint.unit}_s"
                    columns[name] = arrow().array(rate, from_pandas=True)  # nothing for NaN
            records[station.name] = dict(run.record)
        columns |= {f"{name}_distance_m": values for name, values in self.gaps().items()}
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
        runs: list[Run] = []
        cranes = self.site.stations, self.trajectories, self.boxes or [None] * len(self.swing)
        for station, run, boxes in zip(*cranes, strict=True):
            solids = () if runs else station.in_crane_frame(self.site.solids)
            obstacles = [Obstacle(s.name, s.vertices, s.triangles, s.zone) for s in solids]
            reserved = None
            if boxes is not None:
                new = np.append(True, np.diff(boxes, axis=0).any(axis=(1, 2)))
                reserved = self.t[new], station.outline(boxes[new])
            surroundings = None
            if obstacles or reserved is not None:
                surroundings = Scenery(obstacles, np.zeros((0, 3)), reserved=reserved)
            (x, y, z), turn = map(float, station.foot), station.turn
            runs.append(
                Run(station.name, station.crane, run, (x, y, z), scenery=surroundings, heading=turn)
            )
        lines = [
            f"- {t:.1f} s: {body} of {first} and {other} {second}"
            for t, first, second, body, other in self.contacts
        ]
        lines = ["**Contacts:**\n", *lines] if lines else ["No contacts."]
        for t, duration, chain in self.waits:
            lines.append(f"\n**Waiting:** {chain}, {duration:.1f} s from {t:.1f} s on.")
        if self.boxes:
            lines.append("\nSectors beside jibs are what is reserved for their cranes.")
        return record(
            path,
            runs,
            title=self.site.name,
            text="\n".join(lines),
            gaps=self.gaps(),
            contacts=[contact.t for contact in self.contacts],
        )


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
        engine: Engine of each crane, see `cranedyn.simulation.stepper.Stepper`.

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
        self._deadlocks: list[tuple[float, tuple[int, ...], dict[int, np.ndarray]]] = []

    def run_cycle(self, t: float) -> None:
        """Run all cranes for a cycle from a time on [s]."""
        self._t = t
        states = [crane.engine.state for crane in self._cranes]
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
            if circle := self._network.supervisor.deadlock():
                self._deadlocks.append((t, circle, self._network.supervisor.refuges()))

        for crane, rates in zip(self._cranes, passed, strict=True):
            self._in_turn = crane.name
            crane.step(rates, crane.force())
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
        end = (rows - 0.5) * CYCLE
        trajectories = []
        for crane in cranes:
            trajectory = crane.record.trajectory(crane.log, crane.engine)
            trajectories.append(trajectory if len(trajectory.t) == rows else trajectory.before(end))
        swings = [
            np.linalg.norm(crane.crane.swing_angles(run.q), axis=1).max()
            for crane, run in zip(cranes, trajectories, strict=True)
        ]
        outside = [-math.inf] * len(cranes)
        for i, column in enumerate(zip(*self._boxes, strict=True)):
            box = np.array(column)
            position = trajectories[i].q[:, cranes[i].crane.layout.drives]
            outside[i] = float(np.maximum(box[:, 0] - position, position - box[:, 1]).max())
        watch = _Watch(site)
        measured_rows = []
        for first in range(0, rows, _CHUNK):
            chunk = [run.q[first : first + _CHUNK, None] for run in trajectories]
            measured_rows.append(watch.measure(chunk)[:, 0])
        pairs = math.comb(len(cranes), 2)
        distances, clear = np.split(np.concatenate(measured_rows), [pairs], axis=1)
        clearances = np.full((rows, len(cranes)), np.inf)
        if site.solids:
            clearances = np.minimum(*np.split(clear, 2, axis=1))
        return SiteRun(
            site,
            CYCLE * np.arange(rows),
            tuple(trajectories),
            [np.array(column) for column in zip(*self._commands, strict=True)],
            [np.array(column) for column in zip(*self._passed, strict=True)],
            distances,
            clearances,
            tuple(contact for _, contact in watch.contacts),
            np.array(swings),
            np.array(outside),
            tuple(self._deadlocks),
            tuple(np.array(column) for column in zip(*self._boxes, strict=True)),
            np.array(self._wind_speeds),
            0.0 if self._wind is None else self._wind.area,
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
    """What N copies of a site came to.

    Attributes:
        contacts: Number of contacts, shape (N,).
        least: Least distance of any two cranes in a row [m], shape (N,).
        swing: Largest angle of any rope from rest [rad], shape (N,).
        outside: Largest way of a drive out of its box [rad or m], shape (N,); negative inside.
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
    watch, pairs = _Watch(site), math.comb(len(cranes), 2)
    nearest, swing, outside = np.array([[math.inf], [0.0], [-math.inf]]).repeat(copies, axis=1)
    for row in range(rows):
        t = row * CYCLE
        states = [State(*np.split(fleet.z.T.copy(), 2, axis=1)) for fleet in cranes]
        passed = network.step(t, states, [operator(t, states) for operator in operators])
        near = np.maximum(nearest, site.distance)[:, None]
        distances = watch.measure([state.q[None] for state in states], near)[0, :, :pairs]
        nearest = np.minimum(nearest, distances.min(axis=1, initial=math.inf))
        for fleet, state, guard, rates in zip(cranes, states, network.guards, passed, strict=True):
            crane = guard.station.crane
            angles, drives = crane.swing_angles(state.q), state.q[:, crane.layout.drives]
            swing = np.maximum(swing, np.sqrt((angles * angles).sum(axis=1)))
            beyond = np.maximum(guard.box[:, 0] - drives, drives - guard.box[:, 1])
            outside = np.maximum(outside, beyond.max(axis=1))
            fleet.step(rates.T)
    if not np.isfinite(swing).all():
        raise RunError("A crane of the site diverged; a smaller dt may help.", t=t)
    contacts = np.bincount([copy for copy, _ in watch.contacts], minlength=copies)
    return SiteExtremes(contacts, nearest, swing, outside)


class _Network:
    """Guards, supervisor and the messages between them, on N copies of a site in lockstep."""

    def __init__(
        self, site: CraneSite, channel: MessageChannel, rng: np.random.Generator, copies: int = 1
    ) -> None:
        self.guards = [
            Guard(station, site.swing, copies, site.working_wind) for station in site.stations
        ]
        self.supervisor = Supervisor(site, [guard.box for guard in self.guards])
        self._channel, self._rng = channel, rng
        self._up: list[tuple[float, int, BoxRequest]] = []
        self._down: list[tuple[float, int, BoxGrant]] = []

    def step(
        self,
        t: float,
        states: Sequence[State],
        commands: Sequence[np.ndarray],
        wind_speed: float | None = None,
    ) -> list[np.ndarray]:
        """Exchange messages that arrive by a time [s], and return the rates for the drives, shape
        (N, m) each, from states and commands of all copies, and a wind speed [m/s] that all read.
        """
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        passed = []
        for i, (guard, state, command) in enumerate(
            zip(self.guards, states, commands, strict=True)
        ):
            rates, request = guard.step(t, state, command, wind_speed)
            passed.append(rates)
            self._send(self._up, t, i, request)
        for i, request in self._arrived(self._up, t):
            self._send(self._down, t, i, self.supervisor.receive(i, request))
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        return passed

    def _send(self, queue: list, t: float, station: int, message: BoxRequest | BoxGrant) -> None:
        heard = self._rng.random(len(message.copies)) >= self._channel.loss
        if heard.any():
            sent = type(message)(*(values[heard] for values in message))
            queue.append((t + self._channel.latency, station, sent))

    def _arrived(self, queue: list, t: float) -> list:
        due = [item for item in queue if item[0] <= t + 1e-9]
        queue[:] = [item for item in queue if item[0] > t + 1e-9]
        return [(station, message) for _, station, message in due]


class _SiteCrane(Stepper):
    """A crane with its operator, engine and log."""

    def __init__(
        self,
        station: Station,
        operator: SiteOperator,
        wind: SiteWind | None,
        engine: str,
        dt: float,
        rows: int,
    ) -> None:
        drives, forces = station.converters, wind is not None
        super().__init__(
            station.crane, dt=dt, control_period=CYCLE, drive=drives, forces=forces, engine=engine
        )
        self.name, self.operator = station.name, operator
        self._wind = None if wind is None else wind.on(station)
        self.log = Log(self.setting, "mark", 0.0, rows)
        self.record = RunRecord(self.setting, engine, "mark", operator, disturbance=self._wind)

    def command(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands, shape (m,)."""
        layout, rates = self.crane.layout, self.operator(t, states)
        return as_array("command", rates, (layout.m,), meaning=layout.drives_in_words).copy()

    def force(self) -> np.ndarray | None:
        """Return the forces of the wind [N], shape (points, 3); None for no wind."""
        return None if self._wind is None else self._wind(self.t, self.state)

    def step(self, command: Sequence[float] | np.ndarray, force: np.ndarray | None = None) -> State:
        """Hold rates for a period, and log a row."""
        position, rates = self.state.q[self.crane.layout.drives], np.asarray(command)
        state = super().step(command, force)
        self.log.append(self.engine.row(Setpoint(position, rates, np.zeros_like(rates))))
        return state


class _Watch:
    """Distances in each row of a run of N copies of a site, and contacts in rows and between.

    A group has two cranes, or a crane and the solids (-2) or zones (-1) of the site.

    Attributes:
        contacts: Beginnings of contacts, each with the index of its copy.
    """

    def __init__(self, site: CraneSite) -> None:
        """Watch all groups of a site."""
        self._site, cranes = site, range(len(site.stations))
        beside = [(i, kind) for kind in (-2, -1) for i in cranes] if site.solids else []
        self._groups = [*itertools.combinations(cranes, 2), *beside]
        self._row, self._last, self._touching = 0, list[np.ndarray](), set[tuple]()
        self.contacts: list[tuple[int, SiteContact]] = []

    def measure(
        self, paths: Sequence[np.ndarray], within: np.ndarray | float = math.inf
    ) -> np.ndarray:
        """Return the least distance of each group [m], shape (rows, N, groups), from coordinates of
        each crane in rows that follow those of the last call, shape (rows, N, n) each; a lower
        bound where the motion since the last measurement proves it beyond a distance, shape (N, 1).

        Capsules are looked at where what a group moves between two rows does not prove it apart.
        """
        after = [self._place(i, path) for i, path in enumerate(paths)]
        first = [x[:1] for x in after]
        *before, last = self._last or [*first, np.full((1, paths[0].shape[1], 1), -math.inf)]
        ends = [np.concatenate(pair) for pair in zip(before, after, strict=True)]
        motions = (np.diff(x, axis=0) for x in ends)
        moved = [np.sqrt(np.einsum("...i,...i", x, x).max(axis=(2, 3))) for x in motions]
        moved.append(0.0 * moved[0])  # of obstacles
        motion = np.zeros((*moved[0].shape, len(self._groups)))
        for k, (i, j) in enumerate(self._groups):
            motion[..., k] = moved[i] + moved[max(j, -1)]
        distances = last - np.cumsum(motion, axis=0)
        # NaN counts as near, here and below.
        for k, near in enumerate(np.moveaxis(~(distances >= within), 2, 0)):
            if near.any():
                distances[near, k] = self._least(*self._groups[k], [x[near] for x in after])
        both = np.concatenate([last if self._last else distances[:1], distances])
        self._last = [x[-1:] for x in (*after, distances)]
        spare = both[1:] + both[:-1] - motion
        for row, copy, k in np.argwhere(~(spare > 4.0 * _BEND)).tolist():
            states = ([x[row + later, copy] for x in ends] for later in (0, 1))
            now = self._row + row
            contact = self._contact(CYCLE * now, *self._groups[k], *states)
            if contact is not None:
                touching = copy, *contact[1:3]
                if (now - 1, touching) not in self._touching:
                    self.contacts.append((copy, contact))
                self._touching.add((now, touching))
        self._row += len(distances)
        return distances

    def _place(self, i: int, path: np.ndarray) -> np.ndarray:
        """Return the ends of the capsules of a crane [m], shape (rows, N, capsules, 2, 3)."""
        station, q = self._site.stations[i], path.reshape(-1, path.shape[-1])
        position = self._site.positions(i, q[:, station.crane.layout.drives])
        ends = place_crane(self._site.bodies, i, position, q[:, station.crane.swings])
        return ends[:, : len(station.bodies.names)].reshape(*path.shape[:2], -1, 2, 3)

    def _least(self, i: int, j: int, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return the least distance of a group [m] in rows."""
        if j >= 0:
            return least_distances(*(self._placed(k, ends[k]) for k in (i, j)))
        return np.array([self._gaps(i, j, row).min() for row in zip(*ends, strict=True)])

    def _placed(self, i: int, ends: np.ndarray) -> PlacedCapsules:
        radius = np.broadcast_to(self._site.stations[i].bodies.radius, ends.shape[:-2])
        return PlacedCapsules(ends, radius, np.zeros(0))

    def _gaps(self, i: int, j: int, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return gaps of all capsules of a group at an instant [m]: of the first with the first of
        the other crane, with its second, and so on.
        """
        if j >= 0:
            first, second = (self._placed(k, ends[k]) for k in (i, j))
            pairs = np.indices((len(first.ends), len(second.ends))).reshape(2, -1)
            return least_distances(
                *(
                    replace(x, ends=x.ends[k], radius=x.radius[k])
                    for x, k in zip((first, second), pairs, strict=True)
                )
            )
        bodies, margins = self._site.stations[i].bodies, self._site.obstacles.margins
        columns = zip(ends[i], bodies.radius.tolist(), bodies.hangs.tolist(), strict=True)
        return np.array([margins(*capsule, hangs=hangs)[j] for *capsule, hangs in columns])

    def _contact(
        self, t: float, i: int, j: int, before: Sequence[np.ndarray], after: Sequence[np.ndarray]
    ) -> SiteContact | None:
        """Return the contact of a group that is not proven to be none since the row before; None if
        all are.
        """
        old, gaps = (self._gaps(i, j, ends) for ends in (before, after))
        motions = [b - a for a, b in zip(before, after, strict=True)]
        farthest = [np.linalg.norm(motion, axis=2).max(axis=1) for motion in motions]
        moved = farthest[i] if j < 0 else np.add.outer(farthest[i], farthest[j]).ravel()
        bend = 2.0 * _BEND
        for k in np.argsort(gaps).tolist():

            def gap(share: float, k: int = k) -> float:
                ends = [a + share * motion for a, motion in zip(before, motions, strict=True)]
                return float(self._gaps(i, j, ends)[k])

            if not _proven(gap, float(moved[k]), bend, float(old[k]), float(gaps[k])):
                return self._named(t, i, j, k, after[i])
        return None

    def _named(self, t: float, i: int, j: int, k: int, ends: np.ndarray) -> SiteContact:
        stations = self._site.stations
        capsule, second_capsule = divmod(k, len(stations[j].bodies.names)) if j >= 0 else (k, 0)
        name, bodies = stations[i].name, stations[i].bodies
        if j >= 0:
            second, body = stations[j].name, stations[j].bodies.names[second_capsule]
        else:
            nearest = self._site.obstacles.nearest
            second, body = nearest(ends[capsule], float(bodies.radius[capsule]), zones=j == -1), ""
        return SiteContact(t, name, second, bodies.names[capsule], body)


def _proven(
    gap: Callable[[float], float], moved: float, bend: float, first: float, last: float
) -> bool:
    """Return whether two bodies are proven apart on their way between two rows.

    Where the gaps at both ends of a part are together more than what both bodies move in it, no
    gap in it is less than half of the difference. A part that is not proven is halved.

    Args:
        gap: Gap [m] at a share of the straight ways.
        moved: Way of both bodies [m].
        bend: Way [m] by which both are off their straight ways at most.
        first: Gap at the first row [m].
        last: Gap at the last.
    """
    spans = [(0.0, first, 1.0, last)]
    while spans:
        low, gap_low, high, gap_high = spans.pop()
        if gap_low + gap_high - moved * (high - low) > 2.0 * bend:
            continue
        if min(gap_low, gap_high) <= bend or high - low <= _FINEST:
            return False
        middle = (low + high) / 2.0
        gap_middle = gap(middle)
        spans += [(low, gap_low, middle, gap_middle), (middle, gap_middle, high, gap_high)]
    return True
