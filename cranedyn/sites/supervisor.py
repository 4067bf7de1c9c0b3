"""Reservation: each crane keeps inside a box of positions that no other crane's box comes near.

The box of a crane is an interval for each of its drives, in which it can always stop by its own
brakes. A `Guard` on each crane keeps it there whatever messages arrive. The `Supervisor` enlarges a
box only where it is proven apart from all others. Neither reads a clock of the other: a grant
answers one numbered request, and a guard accepts none but that for its last.

Invariant: each crane can stop in its box (guard), its box lies in what the supervisor has reserved
for it (a guard gives back before it asks, and the supervisor enlarges before it answers), and
reserved boxes are proven the required distance apart, with the load of each anywhere in its cone.
So nothing meets, as long as brakes are no weaker and ropes swing no farther than entered. Messages
that are late or lost only make cranes wait.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cranedyn.checks import as_array
from cranedyn.errors import DataError, quoted
from cranedyn.interfaces import State
from cranedyn.sites.brakes import CYCLE, Brakes
from cranedyn.sites.site import CraneSite, Station

PATIENCE = 0.5
"""Time after which a guard no longer waits for the answer to its request [s]."""

HORIZON = 1.5
"""Time for which a crane asks in advance [s]: two lost or late answers and a cycle."""

DAMPING, DAMPED = 0.15, 0.95
"""Damping ratio of the swing that guards add, and share of the largest swing from which they do:
that to which the rope would swing if all drives braked."""

MOMENT = 0.01
"""Time over which a guard extrapolates the motion of rope and pivot [s]."""

GENTLE = 0.95 / (4.0 * math.sqrt(2.0))
"""Share of the largest swing by which an acceleration of a drive that a guard plans inclines the
rope: two drives at right angles may speed up and brake at the worst times."""

STUCK, PASSING = 20, 100
"""Refused requests in a row after which a way out of a circle is sought, one trial a cycle, and
requests of a crane without waiting after which the one that withdrew no longer lets it pass."""

AHEAD, FARTHEST, CHECKED = (20.0, 5.0, 1.0), 30.0, 3
"""Ways that a crane is let pass, the first that can be, and the longest way out, at full rate [s];
ways out of each that are proven at most.
"""

_SHARES = (1.0, 0.5, 0.2)
"""Shares of an extension that are tried."""


class BoxRequest(NamedTuple):
    """Message of a guard.

    Attributes:
        number: Number of the request.
        held: Box that the crane keeps to from now on, shape (2, m).
        wanted: Box that it asks for, shape (2, m), around the one it keeps to.
    """

    number: int
    held: np.ndarray
    wanted: np.ndarray


class BoxGrant(NamedTuple):
    """Answer of the supervisor.

    Attributes:
        number: Number of the request.
        box: Box that the crane may keep to, shape (2, m).
        blocked_by: Names of cranes that keep it from all that it asked for.
        target: Position of the drives to which it withdraws, shape (m,), to let another pass that
            waits for it; None if it need not.
    """

    number: int
    box: np.ndarray
    blocked_by: tuple[str, ...]
    target: np.ndarray | None = None


class Guard:
    """The part of the supervision that runs on a crane.

    Attributes:
        brakes: Brakes that it plans with, never stronger than those of the crane.
        box: Box in which the crane keeps, shape (2, m).
        rates: Last rates that it passed on [rad/s or m/s], shape (m,).
        fault: Whether a measurement was out of its range; all drives then brake.
        blocked_by: Names of cranes that the last grant named.
        target: Position to which the crane withdraws, whatever is commanded; None if it does not.
    """

    def __init__(self, station: Station, swing: float) -> None:
        """Start at rest where the crane starts, with a box just around it.

        Args:
            station: The crane.
            swing: Largest angle of the rope from plumb [rad].
        """
        layout = station.crane.layout
        self.station, self.swing = station, swing
        self.brakes = gentle(station, swing)
        start, self.rates = station.crane.start.q[layout.drives], np.zeros(layout.m)
        self.box = self.brakes.tube(start, self.rates, self.rates)
        self.fault = False
        self.blocked_by: tuple[str, ...] = ()
        self.target: np.ndarray | None = None
        self._number, self._asked_at, self._tube = 0, -math.inf, self.box
        self._lower, self._upper = (
            ends[layout.drives] for ends in (station.crane.lower, station.crane.upper)
        )

    def step(
        self, t: float, state: State, command: np.ndarray
    ) -> tuple[np.ndarray, BoxRequest | None]:
        """Return the rates for the drives [rad/s or m/s], shape (m,), and a request if one is due.

        A rate is the commanded one, as far as its stopping distance ends inside of the box and it
        changes by no more than the brakes can take back. Where braking now would swing the rope by
        more than `DAMPED` of what is allowed, no drive speeds up and the drives damp the swing.

        Args:
            t: Time of the crane's own clock [s].
            state: Its state as measured.
            command: Rates that operator or plan command, shape (m,).

        Raises:
            Misshapen: If the command has another shape.
        """
        brakes, drives = self.brakes, self.station.crane.layout.drives
        command = as_array("command", command, drives.shape)
        position, velocity = state.q[drives], state.v[drives]
        slack = brakes.tolerances
        self.fault = not bool(
            np.isfinite(np.concatenate([*state, command])).all()
            and (position >= self._lower - slack).all()
            and (position <= self._upper + slack).all()
        )
        steps = brakes.decelerations * CYCLE
        if self.fault:
            self.rates = np.clip(0.0, self.rates - steps, self.rates + steps)
            return self.rates, None
        if self.target is not None:
            distance = self.target - position
            command = np.sign(distance) * brakes.largest_rate(np.abs(distance) - slack)
        swing, damping = self._swing(state)
        if swing > DAMPED * self.swing:
            slower = np.clip(command, np.minimum(self.rates, 0.0), np.maximum(self.rates, 0.0))
            slower[self.station.crane.winch] = max(slower[self.station.crane.winch], 0.0)
            command = np.clip(slower, self.rates - steps, self.rates + steps) + damping
        rates = np.clip(command, self.rates - steps, self.rates + steps)
        ahead = brakes.largest_rate(self.box[1] - position - slack)
        back = -brakes.largest_rate(position - self.box[0] - slack)
        self.rates = np.clip(rates, back, ahead)
        low, high = np.minimum(self.rates, velocity), np.maximum(self.rates, velocity)
        self._tube = brakes.tube(position, low, high)
        if t - self._asked_at < PATIENCE:
            return self.rates, None
        return self.rates, self._request(t, position, command)

    def receive(self, grant: BoxGrant) -> None:
        """Take a grant that answers the last request; ignore any other."""
        if grant.number == self._number and self._asked_at > -math.inf:
            self.box, self.blocked_by, self.target = grant.box, grant.blocked_by, grant.target
            self._asked_at = -math.inf

    def _request(self, t: float, position: np.ndarray, command: np.ndarray) -> BoxRequest:
        brakes = self.brakes
        change = brakes.decelerations * HORIZON
        soon = np.clip(command, self.rates - change, self.rates + change)
        low, high = np.minimum(soon, self.rates), np.maximum(soon, self.rates)
        coming = brakes.tube(position, low, high)
        coming += HORIZON * np.array([np.minimum(low, 0.0), np.maximum(high, 0.0)])
        low, high = np.minimum(coming[0], self._tube[0]), np.maximum(coming[1], self._tube[1])
        wanted = np.array(
            [np.maximum(low, self._lower - brakes.tolerances),
             np.minimum(high, self._upper + brakes.tolerances)]
        )  # fmt: skip
        # What lies behind is given back; what is passed before standstill never is.
        self.box = np.array(
            [np.maximum(self.box[0], np.minimum(wanted[0], self._tube[0])),
             np.minimum(self.box[1], np.maximum(wanted[1], self._tube[1]))]
        )  # fmt: skip
        self._number, self._asked_at = self._number + 1, t
        wanted = np.array([np.minimum(wanted[0], self.box[0]), np.maximum(wanted[1], self.box[1])])
        return BoxRequest(self._number, self.box, wanted)

    def _swing(self, state: State) -> tuple[float, np.ndarray]:
        """Return the largest angle of the rope [rad] if all drives brake now, and changes of rates
        that damp it: those of the pivot are 2 ζ ω times those of the load's place from it in plan.

        At constant rates the pivot has an acceleration b by turning, about which the rope swings
        inclined by b/g. A drive that brakes within a acceleration of the pivot a from a rate of the
        pivot v adds an amplitude of no more than 2 a/g, and no more than v/√(g l); b fades and adds
        no more than b/g. Of a rope that is shortened from l to s, no amplitude grows by more than
        (l/s)^1.5.
        """
        crane, brakes = self.station.crane, self.brakes
        winch, drives, gravity = crane.winch, crane.layout.drives, crane.gravity
        assert winch is not None
        cable = abs(float(state.q[drives[winch]]))
        fall = math.sqrt(gravity * cable)
        poses = [self.station.rope(state.q + k * MOMENT * state.v)[1:] for k in range(3)]
        ropes, motions = (np.array([x[:2] for x in part]) for part in zip(*poses, strict=True))
        inclined = np.diff(motions, axis=0) @ state.v[drives] / (-MOMENT * gravity)
        away = ropes[:2] - inclined
        change = (away[1] - away[0]) / MOMENT
        reach = np.linalg.norm(motions[0], axis=0)
        added = np.minimum(2.0 * brakes.decelerations / gravity, np.abs(self.rates) / fall)
        swing = math.hypot(*away[0], *(change * (cable / fall))) + float(
            np.linalg.norm(inclined[0]) + np.linalg.norm(reach * added)
        )
        hoisted = np.minimum(np.minimum(self.rates, state.v[drives]), 0.0)
        shortest = max(cable - brakes.stopping_distance(hoisted)[winch], self._lower[winch])
        swing *= max(cable / shortest, 1.0) ** 1.5
        damping = np.linalg.pinv(motions[0], rcond=1e-3) @ (2.0 * DAMPING * fall * CYCLE * change)
        return swing, damping


def gentle(station: Station, swing: float) -> Brakes:
    """Return the brakes of a crane with decelerations that incline its rope by no more than
    `GENTLE` of the largest swing [rad], each drive for itself, wherever the drives stand.
    """
    crane, brakes = station.crane, station.brakes
    layout, reach = crane.layout, np.full(crane.layout.m, 1e-6)
    ends = [(crane.lower[i], crane.upper[i]) for i in layout.drives]
    for corner in itertools.product(*ends):
        q = np.zeros(layout.n)
        q[layout.drives] = corner
        reach = np.maximum(reach, np.linalg.norm(station.rope(q)[2][:2], axis=0))
    slow = np.minimum(brakes.decelerations, GENTLE * swing * crane.gravity / reach)
    return replace(brakes, decelerations=slow)


class Supervisor:
    """The part of the supervision that all cranes share.

    Right of way has the crane whose requests have been refused longest, then the first: no other is
    granted what it has asked for. Where cranes wait for each other in a circle, the one with the
    least right of way withdraws.

    Attributes:
        site: The site.
        boxes: Reserved box of each crane, shape (2, m) each.
        waits: Indices of the cranes for which each crane waits.
        withdrawals: For each crane that withdraws, to where, and the crane that it lets pass.
    """

    def __init__(self, site: CraneSite, boxes: list[np.ndarray]) -> None:
        """Start with boxes that are proven apart.

        Raises:
            DataError: If two are not, or there is not one for each crane.
        """
        self.site, self.boxes = site, [np.array(box) for box in boxes]
        if len(boxes) != len(site.stations):
            raise DataError(f"{len(boxes)} boxes are given for {len(site.stations)} cranes.")
        self.waits: dict[int, frozenset[int]] = {i: frozenset() for i in range(len(boxes))}
        self.withdrawals: dict[int, tuple[np.ndarray, int]] = {}
        self._numbers, self._refused = [0] * len(boxes), [0] * len(boxes)
        self._free_since, self._trial = [0] * len(boxes), -1
        self._wanted = list(self.boxes)
        for i, box in enumerate(self.boxes):
            apart = site.apart(i, box, self.boxes)
            if not apart[i]:
                name = quoted(site.stations[i].name)
                raise DataError(f"At the start {name} is not proven to keep from an obstacle.")
            if not apart.all():
                names = (quoted(site.stations[k].name) for k in (i, int(np.argmin(apart))))
                raise DataError(
                    f"At the start {' and '.join(names)} are not proven to be "
                    f"{site.distance:g} m apart, with the load swinging by {site.swing:g} rad."
                )

    def receive(self, station: int, request: BoxRequest) -> BoxGrant | None:
        """Return the grant for a request; None for an old one, or one that reports a box outside of
        what is reserved.

        All of the extension is tried first, then shares of it drive by drive.
        """
        reserved = self.boxes[station]
        inside = (request.held[0] >= reserved[0]).all() and (request.held[1] <= reserved[1]).all()
        if request.number <= self._numbers[station] or not inside:
            return None
        self._numbers[station] = request.number
        box, wanted = np.array(request.held), np.array(request.wanted)
        boxes = self._others(station)
        apart = self.site.apart(station, wanted, boxes)
        near = [None if free else other for free, other in zip(apart, boxes, strict=True)]
        box = wanted if apart.all() else self._extended(station, box, wanted, near)
        self.boxes[station], self._wanted[station] = box, wanted
        short = np.abs(wanted - box) > self.site.stations[station].brakes.tolerances
        blocking = ~apart
        blocking[station] = False  # an obstacle is in the way
        self.waits[station] = frozenset(np.nonzero(blocking)[0].tolist() if short.any() else ())
        self._resolve(station)
        waiting = self.waits[station] or station in self.withdrawals
        self._refused[station] = self._refused[station] + 1 if waiting else 0
        names = tuple(self.site.stations[i].name for i in sorted(self.waits[station]))
        target, _ = self.withdrawals.get(station, (None, 0))
        return BoxGrant(request.number, box, names, target)

    def _others(self, station: int) -> list[np.ndarray]:
        """Return for each crane what another must keep apart from."""
        rank = [(refused, -i) for i, refused in enumerate(self._refused)]
        yields = [rank[i] > rank[station] and station not in self.withdrawals for i in self.waits]
        return [(self._wanted if yields[i] else self.boxes)[i] for i in self.waits]

    def _extended(
        self, station: int, box: np.ndarray, wanted: np.ndarray, others: list[np.ndarray | None]
    ) -> np.ndarray:
        for end, drive in zip(*np.nonzero(wanted != box), strict=True):
            for share in _SHARES:
                larger = box.copy()
                larger[end, drive] += share * (wanted - box)[end, drive]
                slab = larger.copy()  # the rest is proven
                slab[1 - end, drive] = box[end, drive]
                if self.site.apart(station, slab, others).all():
                    box = larger
                    break
        return box

    def _resolve(self, station: int) -> None:
        """End withdrawals for a crane that has not waited for a while, and begin one if it waits in
        a circle.
        """
        for loser, (_, winner) in list(self.withdrawals.items()):
            if winner == station:
                waits = loser in self.waits[winner]
                self._free_since[loser] = 0 if waits else self._free_since[loser] + 1
                if self._free_since[loser] > PASSING:
                    del self.withdrawals[loser]
        circle = self.deadlock()
        if station not in circle[:1] or self._refused[station] < STUCK:
            return
        self._trial += 1
        trials = [*itertools.product(sorted(circle, key=lambda i: (self._refused[i], -i)), AHEAD)]
        loser, ahead = trials[self._trial % len(trials)]
        winner = circle[circle.index(loser) - 1]
        if self._trial >= 0 and (target := self._way_out(loser, winner, ahead)) is not None:
            self.withdrawals.pop(winner, None)
            self.withdrawals[loser], self._free_since[loser] = (target, winner), 0
            self._trial = -STUCK

    def _way_out(self, loser: int, winner: int, ahead: float) -> np.ndarray | None:
        """Return the nearest position in time, by one drive, from where a crane lets another pass
        for a time at full rate [s]; None if there is none.
        """
        site, box, drives = self.site, self.boxes[loser], self._drives(loser)
        shifts = []
        for drive, rate in enumerate(site.stations[loser].converters.rates):
            for end in drives - box:
                shift = np.clip(end[drive], -FARTHEST * rate, FARTHEST * rate)
                shifts += [(abs(share * shift) / rate, drive, share * shift) for share in _SHARES]
        shifts.sort()
        moved = np.array([box] * len(shifts))
        for k, (_, drive, shift) in enumerate(shifts):
            moved[k, :, drive] += shift
        held, wanted, ends = self.boxes[winner], self._wanted[winner], self._drives(winner)
        reach = ahead * site.stations[winner].converters.rates * np.sign(wanted - held)
        passing = np.clip(
            wanted + reach, np.minimum(ends[0], wanted[0]), np.maximum(ends[1], wanted[1])
        )
        free = (x for x in moved if site.pair_apart(loser, x, winner, passing, site.distance))
        for refuge in itertools.islice(free, CHECKED):
            swept = np.array([np.minimum(box[0], refuge[0]), np.maximum(box[1], refuge[1])])
            if site.apart(loser, swept, self.boxes).all():
                return refuge.mean(axis=0)
        return None

    def _drives(self, station: int) -> np.ndarray:
        """Return the ends of the ranges of the drives, shape (2, m)."""
        crane = self.site.stations[station].crane
        return np.array([crane.lower, crane.upper])[:, crane.layout.drives]

    def deadlock(self) -> tuple[int, ...]:
        """Return the indices of cranes each of which waits for the next, and the last for the
        first; empty if none do. A crane that withdraws waits for the one that it lets pass.
        """
        passed = {loser: {winner} for loser, (_, winner) in self.withdrawals.items()}
        waits = {i: passed.get(i, self.waits[i]) for i in self.waits}
        stuck = set(waits)
        while free := {i for i in stuck if not waits[i] & stuck}:
            stuck -= free
        path = sorted(stuck)[:1]
        while path and (following := min(waits[path[-1]] & stuck)) not in path:
            path.append(following)
        return tuple(path[path.index(following) :]) if path else ()
