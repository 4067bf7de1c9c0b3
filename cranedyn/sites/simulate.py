"""Simulate the cranes of a site by one clock, with messages that come late or never."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from cranedyn.checks import as_array, number, whole
from cranedyn.clocks import clocks
from cranedyn.data.tables import write_table
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import EngineName, Setpoint, State
from cranedyn.recording import Obstacle, Run, Scenery, record
from cranedyn.simulation.engine import Setting, load_engine
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import RunRecord
from cranedyn.simulation.stepper import as_command, as_force, check_bounded, initial_state
from cranedyn.sites.bodies import PlacedCapsules, place_capsules
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import Guard
from cranedyn.sites.proof import separations
from cranedyn.sites.site import CraneSite, SiteWind, Station
from cranedyn.sites.supervisor import Supervisor

SiteOperator = Callable[[float, Sequence[State]], np.ndarray]
"""Rates of the drives of one crane [rad/s or m/s], shape (m,), at a time [s] and states of all."""


_BEND = 32.0 * CYCLE**2 / 8.0
"""Way [m] of a point off its straight line between two rows at most: its acceleration is less than
thrice that of a fall."""

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


@dataclass(frozen=True, eq=False)
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
        deadlocks: Times at which cranes waited for each other in a circle, and which [s].
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
    deadlocks: tuple[tuple[float, tuple[int, ...]], ...]

    @property
    def states(self) -> list[np.ndarray]:
        """Coordinates and rates of each crane, shape (rows, 2 n) each."""
        return [np.hstack([run.q, run.v]) for run in self.trajectories]

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
                    columns[f"{station.name}_{joint.symbol}_{kind}_{joint.unit}_s"] = rate
            records[station.name] = dict(run.record)
        columns |= {f"{name}_distance_m": values for name, values in self.gaps().items()}
        return pa.table(columns, metadata={"cranedyn.record": json.dumps(records)})

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
        for station, run in zip(self.site.stations, self.trajectories, strict=True):
            solids = () if runs else station.in_crane_frame(self.site.solids)
            obstacles = [Obstacle(s.name, s.vertices, s.triangles, s.zone) for s in solids]
            surroundings = Scenery(obstacles, np.zeros((0, 3))) if obstacles else None
            x, y, z = map(float, station.foot)
            turn = station.heading + math.pi / 2.0
            runs.append(
                Run(station.name, station.crane, run, (x, y, z), scenery=surroundings, heading=turn)
            )
        lines = [
            f"- {t:.1f} s: {body} of {first} and {other} {second}"
            for t, first, second, body, other in self.contacts
        ]
        return record(
            path,
            runs,
            title=self.site.name,
            text="\n".join(["**Contacts:**\n", *lines]) if lines else "No contacts.",
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
        wind: Wind on all loads; None for none.
        seed: Seed of the losses of messages.
        dt: Physics step [s].
        engine: Engine of each crane, see `cranedyn.simulation.stepper.Stepper`.

    Raises:
        OutOfRange: If there is not one operator for each crane, or a number is out of its range.
        DataError: If cranes are not proven apart at the start.
        RunError: If an operator commands a rate that is not finite without a supervisor.
    """
    if len(operators) != len(site.stations):
        raise OutOfRange("number of operators", len(operators), f"{len(site.stations)}")
    number("latency", channel.latency, "s", ">= 0")
    number("loss of messages", channel.loss, "", "0 to 1")
    rows = whole("cycles", round(number("duration", duration, "s", "> 0") / CYCLE), 1)
    cranes = [
        _SiteCrane(station, operator, wind, engine, dt, rows)
        for station, operator in zip(site.stations, operators, strict=True)
    ]
    network = _Network(site, channel, np.random.default_rng(seed)) if supervised else None
    watch, outside = _Watch(site), np.full((rows, len(cranes)), -np.inf)
    commands: list[list[np.ndarray]] = []
    passed: list[list[np.ndarray]] = []
    deadlocks: list[tuple[float, tuple[int, ...]]] = []
    for row in range(rows):
        t, states = row * CYCLE, [crane.engine.state for crane in cranes]
        commands.append([crane.command(t, states) for crane in cranes])
        passed.append(commands[-1] if network is None else network.step(t, states, commands[-1]))
        if network is not None:
            outside[row] = network.outside(states)
            if circle := network.supervisor.deadlock():
                deadlocks.append((t, circle))
        watch.measure(t, states)
        for crane, rates in zip(cranes, passed[-1], strict=True):
            crane.step(t, rates)
    trajectories = tuple(crane.record.trajectory(crane.log, crane.engine) for crane in cranes)
    swings = [
        np.linalg.norm(crane.crane.swing_angles(run.q), axis=1).max()
        for crane, run in zip(cranes, trajectories, strict=True)
    ]
    return SiteRun(
        site,
        CYCLE * np.arange(rows),
        trajectories,
        [np.array(column) for column in zip(*commands, strict=True)],
        [np.array(column) for column in zip(*passed, strict=True)],
        np.array(watch.distances),
        np.array(watch.clearances),
        tuple(watch.contacts),
        np.array(swings),
        outside.max(axis=0),
        tuple(deadlocks),
    )


class _Network:
    """Guards, supervisor and the messages between them."""

    def __init__(self, site: CraneSite, channel: MessageChannel, rng: np.random.Generator) -> None:
        self.guards = [Guard(station, site.swing) for station in site.stations]
        self.supervisor = Supervisor(site, [guard.box for guard in self.guards])
        self._channel, self._rng = channel, rng
        self._up: list[tuple[float, int, object]] = []
        self._down: list[tuple[float, int, object]] = []

    def step(
        self, t: float, states: Sequence[State], commands: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """Exchange messages that arrive by a time [s], and return the rates for the drives."""
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        passed = []
        for i, (guard, state, command) in enumerate(
            zip(self.guards, states, commands, strict=True)
        ):
            rates, request = guard.step(t, state, command)
            passed.append(rates)
            if request is not None:
                self._send(self._up, t, i, request)
        for i, request in self._arrived(self._up, t):
            if (grant := self.supervisor.receive(i, request)) is not None:
                self._send(self._down, t, i, grant)
        for i, grant in self._arrived(self._down, t):
            self.guards[i].receive(grant)
        return passed

    def outside(self, states: Sequence[State]) -> list[float]:
        """Return the largest way of a drive of each crane out of its box [rad or m]."""
        return [
            float(np.maximum(guard.box[0] - q, q - guard.box[1]).max())
            for guard, state in zip(self.guards, states, strict=True)
            for q in [state.q[guard.station.crane.layout.drives]]
        ]

    def _send(self, queue: list, t: float, station: int, message: object) -> None:
        if self._rng.random() >= self._channel.loss:
            queue.append((t + self._channel.latency, station, message))

    def _arrived(self, queue: list, t: float) -> list:
        due = [item for item in queue if item[0] <= t + 1e-9]
        queue[:] = [item for item in queue if item[0] > t + 1e-9]
        return [(station, message) for _, station, message in due]


class _SiteCrane:
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
        self.crane, self.operator = station.crane, operator
        self._wind = None if wind is None else wind.on(station)
        clock, forces = clocks(CYCLE, dt, CYCLE), wind is not None
        drives, rule = station.converters, semi_implicit_euler
        setting = Setting.of(self.crane, clock, drives, rule, forces=forces, buffers=False)
        self.engine = load_engine(engine)(setting, initial_state(self.crane, None))
        self.log = Log(setting, "mark", 0.0, rows)
        self.record = RunRecord(setting, engine, "mark", operator, None, self._wind, None)

    def command(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands, shape (m,)."""
        layout, rates = self.crane.layout, self.operator(t, states)
        return as_array("command", rates, (layout.m,), meaning=layout.drives_in_words).copy()

    def step(self, t: float, rates: np.ndarray) -> None:
        """Log a row at a time [s] and step to the next."""
        layout, state = self.crane.layout, self.engine.state
        check_bounded(layout, t, state)
        force = None if self._wind is None else as_force(self._wind(t, state), layout)
        command = as_command(rates, t, layout)
        setpoint = Setpoint(state.q[layout.drives], command, np.zeros(layout.m))
        self.engine.apply_command(command, force)
        self.log.append(self.engine.row(setpoint))
        self.engine.advance()


class _Watch:
    """Distances in each row, and contacts in rows and between.

    A gap is between two capsules of different cranes, or from a capsule to solids or zones.
    """

    def __init__(self, site: CraneSite) -> None:
        self.site = site
        self.distances: list[np.ndarray] = []
        self.clearances: list[np.ndarray] = []
        self.contacts: list[SiteContact] = []
        counts = [len(station.bodies.names) for station in site.stations]
        self._crane = np.repeat(np.arange(len(counts)), counts)
        self._capsule = np.concatenate([np.arange(count) for count in counts])
        self._hangs = site.bodies.hangs[self._crane, self._capsule]
        firsts = np.cumsum([0, *counts])
        blocks = [
            np.indices((counts[a], counts[b])).reshape(2, -1) + firsts[[[a], [b]]]
            for a, b in itertools.combinations(range(len(counts)), 2)
        ]
        singles = np.arange(firsts[-1])
        beside = np.array([singles, singles]) if site.solids else np.zeros((2, 0), dtype=int)
        self._rows = np.concatenate([*blocks, beside, beside], axis=1)
        self._pairs = sum(block.shape[1] for block in blocks)
        self._starts = np.cumsum([0] + [block.shape[1] for block in blocks])
        self._firsts = firsts
        self._before: tuple[PlacedCapsules, np.ndarray] | None = None
        self._touching: set[tuple[str, str]] = set()

    def measure(self, t: float, states: Sequence[State]) -> None:
        """Measure distances, and begin contacts where what capsules have moved since the row before
        does not prove them apart.
        """
        placed = self._place(states)
        gaps = self._gaps(placed, np.arange(self._rows.shape[1]))
        before, old = self._before or (placed, gaps)
        bend = 0.0 if self._before is None else 2.0 * _BEND
        each = np.linalg.norm(placed.ends - before.ends, axis=2).max(axis=1)
        moved = each[self._rows].sum(axis=0)
        moved[self._pairs :] /= 2.0
        clear = np.split(gaps[self._pairs :], 2)
        self.distances.append(_least(gaps, self._starts))
        self.clearances.append(_least(np.minimum(*clear), self._firsts))
        touching = {}
        for k in np.flatnonzero(gaps + old - moved <= 2.0 * bend).tolist():

            def gap(share: float, k: int = k) -> float:
                ends = before.ends + share * (placed.ends - before.ends)
                return float(self._gaps(replace(placed, ends=ends), np.array([k]))[0])

            if not _proven(gap, float(moved[k]), bend, float(old[k]), float(gaps[k])):
                contact = self._contact(t, placed, k)
                touching[contact.first, contact.second] = contact
        self.contacts += [touching[key] for key in touching if key not in self._touching]
        self._before, self._touching = (placed, gaps), set(touching)

    def _place(self, states: Sequence[State]) -> PlacedCapsules:
        pairs = list(enumerate(zip(self.site.stations, states, strict=True)))
        drives = [(i, state.q[station.crane.layout.drives]) for i, (station, state) in pairs]
        position = np.array([self.site.positions(*item) for item in drives])[self._crane]
        ropes = np.array([station.rope(state.q)[1] for _, (station, state) in pairs])[self._crane]
        bodies = self.site.bodies
        return place_capsules(bodies, self._crane, self._capsule, position, position, 0.0, ropes)

    def _gaps(self, placed: PlacedCapsules, which: np.ndarray) -> np.ndarray:
        """Return gaps [m] by their indices."""
        pairs, beside = which[which < self._pairs], which[which >= self._pairs] - self._pairs
        first, second = (
            replace(placed, ends=placed.ends[row], radius=placed.radius[row])
            for row in self._rows[:, pairs]
        )
        zone, i = np.divmod(beside, len(placed.ends))
        hangs, radius, measured = self._hangs, placed.radius.tolist(), self.site.obstacles.margins
        margins = {
            j: measured(placed.ends[j], radius[j], hangs=hangs[j]) for j in np.unique(i).tolist()
        }
        each = [margins[j][k] for k, j in zip(zone.tolist(), i.tolist(), strict=True)]
        return np.concatenate([separations(first, second)[2], each])

    def _contact(self, t: float, placed: PlacedCapsules, k: int) -> SiteContact:
        (first, body), (second, other) = (
            (station.name, station.bodies.names[self._capsule[i]])
            for i in self._rows[:, k]
            for station in [self.site.stations[self._crane[i]]]
        )
        if k >= self._pairs:
            i, zones = self._rows[0, k], k >= self._pairs + len(placed.ends)
            ends, radius = placed.ends[i], placed.radius[i]
            second, other = self.site.obstacles.nearest(ends, radius, zones=zones), ""
        return SiteContact(t, first, second, body, other)


def _least(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the least of the values from each start to the next, inf of none."""
    return np.array([values[a:b].min(initial=np.inf) for a, b in itertools.pairwise(starts)])


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
    parts = [(0.0, first, 1.0, last)]
    while parts:
        low, gap_low, high, gap_high = parts.pop()
        if gap_low + gap_high - moved * (high - low) > 2.0 * bend:
            continue
        if min(gap_low, gap_high) <= bend or high - low <= _FINEST:
            return False
        middle = (low + high) / 2.0
        parts += [(low, gap_low, middle, gap(middle)), (middle, gap(middle), high, gap_high)]
    return True
