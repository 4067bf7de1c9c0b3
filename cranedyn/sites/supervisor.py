"""Reservation: each crane keeps inside a box of positions that no other crane's box comes near.

The box of a crane is an interval for each of its drives, in which it can always stop by its own
brakes. A guard on each crane (`cranedyn.sites.guard`) keeps it there whatever messages arrive. The
`Supervisor` enlarges a box only where it is proven apart from all others. Neither reads a clock of
the other: a grant answers one numbered request, and a guard accepts none but that for its last.

Invariant: each crane can stop in its box (guard), its box lies in what the supervisor has reserved
for it (a guard gives back before it asks, and the supervisor enlarges before it answers), and
reserved boxes are proven the required distance apart, with the load of each anywhere in its cone.
So nothing meets, as long as brakes are no weaker and ropes swing no farther than entered. Messages
that are late or lost only make cranes wait.
"""

from __future__ import annotations

import itertools

import numpy as np

from cranedyn.errors import DataError, quoted
from cranedyn.sites.guard import BoxGrant, BoxRequest
from cranedyn.sites.site import CraneSite

STUCK, PASSING = 20, 100
"""Refused requests in a row after which a way out of a circle is sought, one trial a cycle, and
requests of a crane without waiting after which the one that withdrew no longer lets it pass."""

AHEAD, FARTHEST, CHECKED = (20.0, 5.0, 1.0), 30.0, 3
"""Ways that a crane is let pass, the first that can be, and the longest way out, at full rate [s];
ways out of each that are proven at most.
"""

_SHARES = (1.0, 0.5, 0.2)
"""Shares of an extension that are tried."""


class Supervisor:
    """The part of the supervision that all cranes share.

    Right of way has the crane whose requests have been refused longest, then the first: no other is
    granted what it has asked for. Where cranes wait for each other in a circle, one withdraws to
    let another pass: the ones with the least right of way are tried first, one a cycle. A crane
    that withdraws has no right of way; what it wanted before still counts in later circles.

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
        self._wanted, self._ways = list(self.boxes), [np.zeros_like(box) for box in self.boxes]
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
        if station not in self.withdrawals:  # else it wants to go where it was told to
            self._ways[station] = np.sign(wanted - request.held)
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
        rank = [(i not in self.withdrawals, times, -i) for i, times in enumerate(self._refused)]
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
        if (target := self._way_out(loser, winner, ahead)) is not None:
            self.withdrawals.pop(winner, None)
            self.withdrawals[loser], self._free_since[loser] = (target, winner), 0
            self._refused[station] = 0

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
        wanted, ends = self._wanted[winner], self._drives(winner)
        reach = ahead * site.stations[winner].converters.rates * self._ways[winner]
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
