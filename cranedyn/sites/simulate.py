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
from cranedyn.data.tables import write_table
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.validity import events
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import EngineName, Setpoint, State
from cranedyn.recording import Obstacle, Run, Scenery, record
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import RunRecord
from cranedyn.simulation.stepper import Stepper
from cranedyn.sites.bodies import PlacedCapsules, place_capsules
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import Guard
from cranedyn.sites.proof import least_distances
from cranedyn.sites.site import CraneSite, SiteWind, Station
from cranedyn.sites.supervisor import Supervisor

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
        deadlocks: Times at which cranes waited for each other in a circle, and which [s].
        boxes: Box in which each crane was kept [rad or m], shape (rows, 2, m) each; none without a
            supervisor.
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
    boxes: tuple[np.ndarray, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Run: {len(self.contacts)} contacts, least distance {self.least_distance:.2f} m, "
            f"largest swing {100.0 * self.swing.max() / self.site.swing:.0f} % of the envelope"
            f"{self.violation and '; the model '}{self.violation}"
        )

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
        """Times [s] from which cranes waited for each other in a circle, how long [s], and who."""
        names, result = [station.name for station in self.site.stations], []
        for (_, circle), rows in itertools.groupby(
            enumerate(self.deadlocks), lambda row: (round(row[1][0] / CYCLE) - row[0], row[1][1])
        ):
            times = [t for _, (t, _) in rows]
            chain = " for ".join(names[i] for i in (*circle, circle[0]))
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
        cranes = self.site.stations, self.trajectories, self.boxes or [None] * len(self.swing)
        for station, run, boxes in zip(*cranes, strict=True):
            solids = () if runs else station.in_crane_frame(self.site.solids)
            obstacles = [Obstacle(s.name, s.vertices, s.triangles, s.zone) for s in solids]
            reserved = None
            if boxes is not None:
                new = np.append(True, np.diff(boxes, axis=0).any(axis=(1, 2)))
                reserved = self.t[new], station.outline(boxes[new])
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
    rng = np.random.default_rng(whole("seed", seed, 0))
    network = _Network(site, channel, rng) if supervised else None
    boxes: list[list[np.ndarray]] = []
    commands: list[list[np.ndarray]] = []
    passed: list[list[np.ndarray]] = []
    deadlocks: list[tuple[float, tuple[int, ...]]] = []
    for row in range(rows):
        t, states = row * CYCLE, [crane.engine.state for crane in cranes]
        commands.append([crane.command(t, states) for crane in cranes])
        passed.append(commands[-1] if network is None else network.step(t, states, commands[-1]))
        if network is not None:
            boxes.append([guard.box for guard in network.guards])
            if circle := network.supervisor.deadlock():
                deadlocks.append((t, circle))
        for crane, rates in zip(cranes, passed[-1], strict=True):
            crane.step(rates, crane.force())
    trajectories = tuple(crane.record.trajectory(crane.log, crane.engine) for crane in cranes)
    swings = [
        np.linalg.norm(crane.crane.swing_angles(run.q), axis=1).max()
        for crane, run in zip(cranes, trajectories, strict=True)
    ]
    outside = [-math.inf] * len(cranes)
    for i, column in enumerate(zip(*boxes, strict=True)):
        box, q = np.array(column), trajectories[i].q[:, cranes[i].crane.layout.drives]
        outside[i] = float(np.maximum(box[:, 0] - q, q - box[:, 1]).max())
    distances, contacts = _Watch(site).measure([run.q for run in trajectories])
    distances, clear = np.split(distances, [math.comb(len(cranes), 2)], axis=1)
    return SiteRun(
        site,
        CYCLE * np.arange(rows),
        trajectories,
        [np.array(column) for column in zip(*commands, strict=True)],
        [np.array(column) for column in zip(*passed, strict=True)],
        distances,
        np.minimum(*np.split(clear, 2, axis=1))
        if site.solids
        else np.full((rows, len(cranes)), np.inf),
        tuple(contacts),
        np.array(swings),
        np.array(outside),
        tuple(deadlocks),
        tuple(np.array(column) for column in zip(*boxes, strict=True)),
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

    def _send(self, queue: list, t: float, station: int, message: object) -> None:
        if self._rng.random() >= self._channel.loss:
            queue.append((t + self._channel.latency, station, message))

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
        self.operator, self._wind = operator, None if wind is None else wind.on(station)
        self.log = Log(self.setting, "mark", 0.0, rows)
        self.record = RunRecord(self.setting, engine, "mark", operator, disturbance=self._wind)

    def command(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands, shape (m,)."""
        layout, rates = self.crane.layout, self.operator(t, states)
        return as_array("command", rates, (layout.m,), meaning=layout.drives_in_words).copy()

    def force(self) -> np.ndarray | None:
        """Return the forces of the wind [N], shape (points, 3); None for no wind."""
        return None if self._wind is None else self._wind(self.t, self.state)

    def apply(self, command: Sequence[float] | np.ndarray, force: np.ndarray | None = None) -> None:
        """Hold rates from now on, and log a row."""
        super().apply(command, force)
        position, rates = self.state.q[self.crane.layout.drives], np.asarray(command)
        self.log.append(self.engine.row(Setpoint(position, rates, np.zeros_like(rates))))


class _Watch:
    """Distances in each row of a run, and contacts in rows and between.

    A group has two cranes, or a crane and the solids (-2) or zones (-1) of the site.
    """

    def __init__(self, site: CraneSite) -> None:
        """Watch all groups of a site."""
        self._site, cranes = site, range(len(site.stations))
        beside = [(i, kind) for kind in (-2, -1) for i in cranes]
        self._groups = [*itertools.combinations(cranes, 2), *beside]

    def measure(self, paths: Sequence[np.ndarray]) -> tuple[np.ndarray, list[SiteContact]]:
        """Return the least distance of each group [m], shape (rows, groups), and beginnings of
        contacts, from coordinates of each crane, shape (rows, n) each.

        Capsules are looked at where what a group moves between two rows does not prove it apart.
        """
        rows, contacts, touching = len(paths[0]), list[SiteContact](), set[tuple[int, str, str]]()
        distances = np.zeros((rows, len(self._groups)))
        for first in range(0, rows, _CHUNK):
            chunk = np.maximum(np.arange(first - 1, min(first + _CHUNK, rows)), 0)
            ends = [self._place(i, each[chunk]) for i, each in enumerate(paths)]
            moved = [np.linalg.norm(np.diff(x, axis=0), axis=3).max(axis=(1, 2)) for x in ends]
            spare = np.zeros((len(chunk) - 1, len(self._groups)))
            for k, (i, j) in enumerate(self._groups):
                distances[chunk, k] = least = self._least(i, j, ends)
                spare[:, k] = least[1:] + least[:-1] - moved[i] - (moved[j] if j >= 0 else 0.0)
            for row, k in np.argwhere(spare <= 4.0 * _BEND).tolist():
                states = ([x[row + after] for x in ends] for after in (0, 1))
                contact = self._contact(CYCLE * float(chunk[row + 1]), *self._groups[k], *states)
                if contact is not None:
                    if (chunk[row], *contact[1:3]) not in touching:
                        contacts.append(contact)
                    touching.add((chunk[row + 1], *contact[1:3]))
        return distances, contacts

    def _place(self, i: int, q: np.ndarray) -> np.ndarray:
        """Return the ends of the capsules of a crane [m], shape (rows, capsules, 2, 3)."""
        station, rows = self._site.stations[i], len(q)
        count = len(station.bodies.names)
        _, ropes, _ = station.rope(q)
        position = self._site.positions(i, q[:, station.crane.layout.drives])
        ends, ropes = (x.repeat(count, axis=0) for x in (position, ropes))
        which, capsules = np.full(rows * count, i), np.tile(np.arange(count), rows)
        placed = place_capsules(self._site.bodies, which, capsules, ends, ends, 0.0, ropes)
        return placed.ends.reshape(rows, count, 2, 3)

    def _least(self, i: int, j: int, ends: Sequence[np.ndarray]) -> np.ndarray:
        if j >= 0:
            return least_distances(*(self._placed(k, ends[k]) for k in (i, j)))
        if not self._site.solids:
            return np.full(len(ends[i]), np.inf)
        return np.array([self._gaps(i, j, row).min() for row in zip(*ends, strict=True)])

    def _placed(self, i: int, ends: np.ndarray) -> PlacedCapsules:
        radius = np.broadcast_to(self._site.stations[i].bodies.radius, ends.shape[:-2])
        return PlacedCapsules(ends, radius, np.zeros(0))

    def _gaps(self, i: int, j: int, ends: Sequence[np.ndarray]) -> np.ndarray:
        """Return gaps of all capsules of a group at an instant [m]: of the first with the first of
        the other crane, with its second, and so on.
        """
        if j >= 0:
            one, other = (self._placed(k, ends[k]) for k in (i, j))
            pairs = np.indices((len(one.ends), len(other.ends))).reshape(2, -1)
            return least_distances(
                *(
                    replace(x, ends=x.ends[k], radius=x.radius[k])
                    for x, k in zip((one, other), pairs, strict=True)
                )
            )
        bodies, margins = self._site.stations[i].bodies, self._site.obstacles.margins
        columns = zip(ends[i], bodies.radius.tolist(), bodies.hangs.tolist(), strict=True)
        return np.array([margins(*part, hangs=hangs)[j] for *part, hangs in columns])

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
        one, other = divmod(k, len(stations[j].bodies.names)) if j >= 0 else (k, 0)
        name, bodies = stations[i].name, stations[i].bodies
        if j >= 0:
            second, body = stations[j].name, stations[j].bodies.names[other]
        else:
            nearest = self._site.obstacles.nearest
            second, body = nearest(ends[one], float(bodies.radius[one]), zones=j == -1), ""
        return SiteContact(t, name, second, bodies.names[one], body)


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
