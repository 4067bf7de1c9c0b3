"""Simulate the cranes of a site by one clock, with messages that come late or never."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import EngineName, State
from cranedyn.simulation.stepper import Stepper
from cranedyn.sites.bodies import place_capsules
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.proof import separations
from cranedyn.sites.site import CraneSite
from cranedyn.sites.supervisor import Guard, Supervisor

SiteOperator = Callable[[float, Sequence[State]], np.ndarray]
"""Rates of the drives of one crane [rad/s or m/s], shape (m,), at a time [s] and states of all."""


_BEND = 32.0 * CYCLE**2 / 8.0
"""Way [m] of a point off its straight line between two rows at most: its acceleration is less than
thrice that of a fall."""


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
        first, second: Names of the cranes.
        first_body, second_body: Names of the bodies that touch.
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
        states: Coordinates and rates of each crane, shape (rows, 2 n) each.
        commands: Rates that were commanded, shape (rows, m) each.
        passed: Rates that went to the drives, shape (rows, m) each.
        distances: Least distance of each pair of cranes [m], shape (rows, pairs), in the order of
            `itertools.combinations`.
        contacts: Beginnings of contacts: in a row, or not proven to be none between two rows.
        swing: Largest angle of each rope from rest [rad], shape (cranes,).
        outside: Largest way of a drive of each crane out of its box [rad or m], shape (cranes,);
            negative inside, -inf without a supervisor.
        deadlocks: Times at which cranes waited for each other in a circle, and which [s].
    """

    site: CraneSite
    t: np.ndarray
    states: list[np.ndarray]
    commands: list[np.ndarray]
    passed: list[np.ndarray]
    distances: np.ndarray
    contacts: tuple[SiteContact, ...]
    swing: np.ndarray
    outside: np.ndarray
    deadlocks: tuple[tuple[float, tuple[int, ...]], ...]

    @property
    def least_distance(self) -> float:
        """Least distance of any two cranes in a row [m]."""
        return float(self.distances.min())


def simulate_site(
    site: CraneSite,
    operators: Sequence[SiteOperator],
    *,
    duration: float,
    supervised: bool = True,
    channel: MessageChannel = MessageChannel(),  # noqa: B008
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
    steppers = [
        Stepper(station.crane, dt=dt, control_period=CYCLE, drive=station.converters, engine=engine)
        for station in site.stations
    ]
    network = _Network(site, channel, np.random.default_rng(seed)) if supervised else None
    log = _Log(site)
    for row in range(rows):
        t, states = row * CYCLE, [stepper.state for stepper in steppers]
        commands = [np.asarray(operator(t, states), dtype=float) for operator in operators]
        passed = commands if network is None else network.step(t, states, commands)
        log.append(t, states, commands, passed, network)
        for stepper, rates in zip(steppers, passed, strict=True):
            stepper.step(rates)
    return log.run()


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


class _Log:
    """Rows of a run, and what is measured in each."""

    def __init__(self, site: CraneSite) -> None:
        self.site, cranes = site, range(len(site.stations))
        self.pairs = list(itertools.combinations(cranes, 2))
        self.t: list[float] = []
        self.states: list[list[np.ndarray]] = [[] for _ in cranes]
        self.commands: list[list[np.ndarray]] = [[] for _ in cranes]
        self.passed: list[list[np.ndarray]] = [[] for _ in cranes]
        self.distances: list[np.ndarray] = []
        self.contacts: list[SiteContact] = []
        self._touching = np.zeros(len(self.pairs), dtype=bool)
        self.swing, self.outside = np.zeros(len(cranes)), np.full(len(cranes), -np.inf)
        self.deadlocks: list[tuple[float, tuple[int, ...]]] = []
        counts = [len(station.bodies.names) for station in site.stations]
        self._crane = np.repeat(np.arange(len(counts)), counts)
        self._capsule = np.concatenate([np.arange(count) for count in counts])
        firsts = np.cumsum([0, *counts])
        blocks = [
            np.indices((counts[a], counts[b])).reshape(2, -1) + firsts[[[a], [b]]]
            for a, b in self.pairs
        ]
        self._rows = np.concatenate(blocks, axis=1)
        self._starts = np.cumsum([0] + [block.shape[1] for block in blocks[:-1]])
        self._ends: np.ndarray | None = None

    def append(
        self,
        t: float,
        states: Sequence[State],
        commands: Sequence[np.ndarray],
        passed: Sequence[np.ndarray],
        network: _Network | None,
    ) -> None:
        """Add a row."""
        self.t.append(t)
        for i, state in enumerate(states):
            crane = self.site.stations[i].crane
            self.states[i].append(np.concatenate(state))
            self.commands[i].append(np.array(commands[i]))
            self.passed[i].append(np.array(passed[i]))
            angle = float(np.linalg.norm(crane.swing_angles(state.q)))
            self.swing[i] = max(self.swing[i], angle)
            if network is not None:
                guard, q = network.guards[i], state.q[crane.layout.drives]
                beyond = np.maximum(guard.box[0] - q, q - guard.box[1]).max()
                self.outside[i] = max(self.outside[i], float(beyond))
        if network is not None and (circle := network.supervisor.deadlock()):
            self.deadlocks.append((t, circle))
        self._measure(t, states)

    def _measure(self, t: float, states: Sequence[State]) -> None:
        """Measure distances, and begin contacts where what both cranes have moved since the row
        before, half of it for either row, does not prove them apart.
        """
        stations, crane, rows = self.site.stations, self._crane, self._rows
        position = np.array(
            [
                self.site.positions(i, state.q[stations[i].crane.layout.drives])
                for i, state in enumerate(states)
            ]
        )[crane]
        ropes = [station.rope(state.q)[1] for station, state in zip(stations, states, strict=True)]
        bodies = self.site.bodies
        placed = place_capsules(
            bodies, crane, self._capsule, position, position, 0.0, np.array(ropes)[crane]
        )
        ends, radius = placed.ends, placed.radius
        first, second = (replace(placed, ends=ends[i], radius=radius[i]) for i in rows)
        _, _, gaps = separations(first, second)
        moved = np.zeros(len(ends))
        if self._ends is not None:
            moved = np.linalg.norm(ends - self._ends, axis=2).max(axis=1) + 2.0 * _BEND
        self._ends = ends
        proven = gaps - moved[rows].sum(axis=0) / 2.0
        self.distances.append(np.minimum.reduceat(gaps, self._starts))
        touching = np.minimum.reduceat(proven, self._starts) <= 0.0
        for k in np.nonzero(touching & ~self._touching)[0].tolist():
            start = self._starts[k]
            nearest = start + int(np.argmin(proven[start:][: self._count(k)]))
            i, j = rows[:, nearest]
            names = [stations[crane[m]].bodies.names[self._capsule[m]] for m in (i, j)]
            a, b = self.pairs[k]
            self.contacts.append(SiteContact(t, stations[a].name, stations[b].name, *names))
        self._touching = touching

    def _count(self, pair: int) -> int:
        return int(np.append(self._starts, self._rows.shape[1])[pair + 1] - self._starts[pair])

    def run(self) -> SiteRun:
        """Return the run."""
        states, commands, passed = (
            [np.array(rows) for rows in columns]
            for columns in (self.states, self.commands, self.passed)
        )
        return SiteRun(
            self.site,
            np.array(self.t),
            states,
            commands,
            passed,
            np.array(self.distances),
            tuple(self.contacts),
            self.swing,
            self.outside,
            tuple(self.deadlocks),
        )
