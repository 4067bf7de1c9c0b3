"""Reservation: each crane keeps inside a box of positions that no other crane's box comes near.

The box of a crane is an interval for each of its drives, in which it can always stop by its own
brakes. A guard on each crane (`cranedyn.sites.guard`) keeps it there whatever messages arrive. The
`Supervisor` enlarges a box only where it is proven apart from all others. Neither reads a clock of
the other: a grant answers one numbered request, and a guard accepts none but that for its last.

Invariant: each crane can stop in its box (guard), its box lies in what the supervisor has reserved
for it (a guard gives back before it asks, and the supervisor enlarges before it answers), and
reserved boxes are proven the required distance apart, with the load of each anywhere in its cone.
So nothing meets, as long as what `cranedyn.sites.assumptions` lists holds: brakes no weaker, ropes
that swing no farther and a wind no stronger than entered, among others. Messages that are late or
lost only make cranes wait, and so do messages that are not sound: each end checks what it receives.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from cranedyn.checks import as_array, whole, within
from cranedyn.errors import DataError, quoted
from cranedyn.sites.guard import BoxGrant, BoxRequest, is_index, is_request_number
from cranedyn.sites.site import CraneSite

STUCK, PASSING = 20, 100
"""Refused requests in a row after which a way out of a circle is sought, one trial a cycle, and
requests of a crane without waiting after which the one that withdrew no longer lets it pass."""

AHEAD, FARTHEST, DRAWN = (20.0, 5.0, 1.0, 0.2), 60.0, 16
"""Ways that a crane is let pass, the first that can be, and the longest way out, at full rate [s];
ways out that are drawn in a trial."""

RANGE_ROUNDING = 1e-9
"""Rounding error of the ends of ranges [rad or m]."""

_MOST = 1 << 40
"""More requests than are ever refused in a row."""

_SHARES = (1.0, 0.5, 0.2)
"""Shares of an extension that are tried."""


class Supervisor:
    """The part of the supervision that all cranes share, on N copies of a site in lockstep.

    Right of way has the crane whose requests have been refused longest, then the first: no other is
    granted what it has asked for. Where cranes wait for each other in a circle, one withdraws to
    let another pass: the ones that do not withdraw yet and have the least right of way are tried
    first, one a cycle. A crane that withdraws has no right of way; what it wanted before still
    counts in later circles.

    Attributes:
        site: The site.
        boxes: Reserved boxes of each crane, shape (N, 2, m) each.
        waits: Whether each crane waits for each, shape (N, cranes, cranes).
        passing: Index of the crane that each crane lets pass while it withdraws, shape (N, cranes);
            -1 where it does not.
        targets: Positions to which each crane withdraws, shape (N, m) each; inf where it does not.
    """

    def __init__(self, site: CraneSite, boxes: Sequence[np.ndarray]) -> None:
        """Start with boxes that are proven apart.

        Args:
            site: The site.
            boxes: Box of each crane, shape (N, 2, m) each.

        Raises:
            DataError: If two are not, or there is not one for each crane.
        """
        self.site, self.boxes = site, [np.array(box) for box in boxes]
        if len(boxes) != len(site.stations):
            raise DataError(f"{len(boxes)} boxes are given for {len(site.stations)} cranes.")
        copies, cranes = len(boxes[0]), len(boxes)
        self.waits = np.zeros((copies, cranes, cranes), dtype=bool)
        self.passing = np.full((copies, cranes), -1)
        self.targets = [np.full((copies, box.shape[2]), np.inf) for box in self.boxes]
        self._numbers, self._refused, self._free_since = np.zeros((3, copies, cranes), dtype=int)
        self._trial = np.full(copies, -1)
        self._wanted = [box.copy() for box in self.boxes]
        self._ways = [0.0 * box for box in self.boxes]
        for i, box in enumerate(self.boxes):
            apart = np.all(site.apart(i, box, self.boxes), axis=0)
            if not apart[i]:
                name = quoted(site.stations[i].name)
                raise DataError(f"At the start {name} is not proven to keep from an obstacle.")
            if not apart.all():
                names = (quoted(site.stations[k].name) for k in (i, int(np.argmin(apart))))
                raise DataError(
                    f"At the start {' and '.join(names)} are not proven to be "
                    f"{site.distance:g} m apart, with the load swinging by {site.swing:g} rad."
                )

    def receive(self, station: int, request: BoxRequest) -> BoxGrant:
        """Return the grants for the requests of one crane that are sound; ignore all others.

        Where a request is not sound, see `_sound_requests`, nothing is granted and reserved boxes
        stay. All of the extension is tried first, then shares of it drive by drive.

        Args:
            station: Index of the crane.
            request: Its requests.

        Raises:
            OutOfRange: If there is no such crane.
            Misshapen: If a field has another shape.
        """
        within("index of a crane", whole("index of a crane", station, 0), 0, len(self.boxes) - 1)
        copies, number, reported, wanted = self._sound_requests(station, request)
        self._numbers[copies, station] = number
        neighbours = self._others(station, copies)
        apart = self.site.apart(station, wanted, neighbours)
        box, cut = wanted.copy(), ~apart.all(axis=1)
        box[cut] = self._extended(
            station, reported[cut], wanted[cut], [x[cut] for x in neighbours], ~apart[cut]
        )
        self.boxes[station][copies], self._wanted[station][copies] = box, wanted
        goes = self.passing[copies, station] < 0  # else it wants to go where it was told to
        self._ways[station][copies[goes]] = np.sign(wanted - reported)[goes]
        short = np.abs(wanted - box) > self.site.stations[station].brakes.tolerances
        blocking = ~apart & short.any(axis=(1, 2))[:, None]
        blocking[:, station] = False  # an obstacle is in the way
        self.waits[copies, station] = blocking
        self._resolve(station, copies)
        waiting = blocking.any(axis=1) | (self.passing[copies, station] >= 0)
        self._refused[copies, station] = np.where(waiting, self._refused[copies, station] + 1, 0)
        return BoxGrant(copies, number, box, blocking, self.targets[station][copies])

    def _sound_requests(self, station: int, request: BoxRequest) -> BoxRequest:
        """Return the requests of a crane that count.

        A request counts if its copy and its number are whole numbers, the copy is one of the site
        that no earlier row names, and the number is above the last one; if the box that is held
        lies in the reserved one; and if the wanted box contains the held one and lies in the ranges
        of the drives, up to the tolerances of their sensors. So all ends are finite and ordered.
        """
        reserved_boxes = self.boxes[station]
        limits = self.site.stations[station]
        count = len(np.atleast_1d(request.copies))
        boxes = count, *reserved_boxes.shape[1:]
        given_copies = as_array("copies of a request", request.copies, (count,))
        given_numbers = as_array("numbers of a request", request.number, (count,))
        held = as_array("box held in a request", request.held, boxes)
        wanted = as_array("box wanted in a request", request.wanted, boxes)

        known = is_index(given_copies, len(reserved_boxes)) & is_request_number(given_numbers)
        copies = np.where(known, given_copies, 0.0).astype(int)
        number = np.where(known, given_numbers, 0.0).astype(int)
        first_rows = np.zeros(count, dtype=bool)
        first_rows[np.unique(np.where(known, copies, -1), return_index=True)[1]] = True

        # Each comparison is false for NaN. Both ends of each drive count.
        reserved = reserved_boxes[copies]
        lowest = limits.ranges[0] - limits.brakes.tolerances - RANGE_ROUNDING
        highest = limits.ranges[1] + limits.brakes.tolerances + RANGE_ROUNDING
        is_ordered = held[:, 0] <= held[:, 1]
        is_reserved = (reserved[:, 0] <= held[:, 0]) & (held[:, 1] <= reserved[:, 1])
        is_extended = (wanted[:, 0] <= held[:, 0]) & (held[:, 1] <= wanted[:, 1])
        in_range = (lowest <= wanted[:, 0]) & (wanted[:, 1] <= highest)

        sound = (is_ordered & is_reserved & is_extended & in_range).all(axis=1)
        is_new = number > self._numbers[copies, station]
        counts = known & first_rows & sound & is_new
        return BoxRequest(copies[counts], number[counts], held[counts], wanted[counts])

    def _others(self, station: int, copies: np.ndarray) -> list[np.ndarray]:
        """Return for each crane what another must keep apart from, shape (copies, 2, m) each."""
        cranes, goes = np.arange(len(self.boxes)), self.passing[copies] < 0
        rank = (goes * _MOST + self._refused[copies]) * len(cranes) - cranes
        yields = (rank > rank[:, [station]]) & goes[:, [station]]
        boxes = [box[copies] for box in self.boxes]
        for i in np.flatnonzero(yields.any(axis=0)):
            boxes[i][yields[:, i]] = self._wanted[i][copies[yields[:, i]]]
        return boxes

    def _extended(
        self,
        station: int,
        box: np.ndarray,
        wanted: np.ndarray,
        neighbours: list[np.ndarray],
        doubtful: np.ndarray,
        shares: Sequence[float] = _SHARES,
    ) -> np.ndarray:
        """Return boxes enlarged towards wanted ones as far as they are proven apart."""
        for end, drive in np.ndindex(wanted.shape[1:]):
            rows = np.flatnonzero(wanted[:, end, drive] != box[:, end, drive])
            if not len(rows):
                continue
            larger = np.repeat(box[rows][None], len(shares), axis=0)
            larger[..., end, drive] += np.outer(shares, (wanted - box)[rows, end, drive])
            slab = larger.copy()  # the rest is proven
            slab[..., 1 - end, drive] = box[rows, end, drive]
            beside = [x[rows] for x in neighbours]
            proven = self.site.apart(station, slab, beside, doubtful[rows]).all(axis=-1)
            granted = proven.any(axis=0)
            box[rows[granted]] = larger[proven.argmax(axis=0)[granted], granted]
        return box

    def _resolve(self, station: int, copies: np.ndarray) -> None:
        """End withdrawals for a crane that has not waited for a while, and begin one if it waits in
        a circle.
        """
        passed, free = self.passing[copies] == station, self._free_since[copies]
        free = np.where(passed, np.where(self.waits[copies, station], 0, free + 1), free)
        self._free_since[copies] = free
        for row, loser in np.argwhere(passed & (free > PASSING)).tolist():
            self._withdraw(copies[row], loser)
        for copy in copies[self._refused[copies, station] >= STUCK].tolist():
            circle = self.deadlock(copy, station)
            if station != min(circle, default=None):
                continue
            self._trial[copy] += 1
            passing, refused = self.passing[copy].tolist(), self._refused[copy].tolist()
            ranked = sorted(circle, key=lambda i: (passing[i] >= 0, refused[i], -i))
            trials = list(itertools.product(ranked, AHEAD))
            loser, ahead = trials[self._trial[copy] % len(trials)]
            winner = circle[circle.index(loser) - 1]
            if (target := self._way_out(copy, loser, winner, ahead)) is not None:
                self._withdraw(copy, winner)
                self._withdraw(copy, loser, target, winner)
                self._free_since[copy, loser] = self._refused[copy, station] = 0
                self._trial[copy] = -1

    def _withdraw(self, copy: int, crane: int, target: Any = np.inf, passing: int = -1) -> None:
        """Let a crane withdraw to a position while another passes, or no longer."""
        self.targets[crane][copy], self.passing[copy, crane] = target, passing

    def _way_out(self, copy: int, loser: int, winner: int, ahead: float) -> np.ndarray | None:
        """Return the nearest position in time, of some drawn at random, from where a crane lets
        another pass for a time at full rate [s]; None if there is none.
        """
        site, box = self.site, self.boxes[loser][copy]
        rng = np.random.default_rng(self._numbers[copy].sum())
        rates, ends = site.stations[loser].converters.rates, site.stations[loser].ranges
        times = FARTHEST * rng.uniform(-1.0, 1.0, (DRAWN, len(rates))) ** 5
        shifts = np.clip(times * rng.integers(2, size=times.shape) * rates, *(ends - box))
        moved = box + shifts[(abs(shifts) / rates).max(axis=1).argsort(), None]
        wanted, ends = self._wanted[winner][copy], site.stations[winner].ranges
        reach = ahead * site.stations[winner].converters.rates * self._ways[winner][copy]
        passing = np.clip(
            wanted + reach, np.minimum(ends[0], wanted[0]), np.maximum(ends[1], wanted[1])
        )
        free = moved[site.pair_apart(loser, moved, winner, passing)][:1]
        swept = np.stack([np.minimum(box[0], free[:, 0]), np.maximum(box[1], free[:, 1])], axis=1)
        boxes = [x[[copy] * len(free)] for x in self.boxes]
        doubtful = np.ones((len(free), len(boxes)), dtype=bool)
        proven = self._extended(loser, boxes[loser], swept, boxes, doubtful, [1.0])
        return free[0].mean(axis=0) if len(free) and np.allclose(proven, swept) else None

    def refuges(self, copy: int = 0) -> dict[int, np.ndarray]:
        """Return where each crane of a copy that lets another pass withdraws to [rad or m]."""
        withdrawn = np.flatnonzero(self.passing[copy] >= 0).tolist()
        return {i: self.targets[i][copy].copy() for i in withdrawn}

    def deadlock(self, copy: int = 0, station: int | None = None) -> tuple[int, ...]:
        """Return the indices of cranes of a copy each of which waits for the next, and the last for
        the first: the shortest circle of one crane, or of the first that is in one; empty if there
        is none. A crane that withdraws waits for the one that it lets pass.
        """
        waits = [
            [passed] if passed >= 0 else np.flatnonzero(row).tolist()
            for passed, row in zip(self.passing[copy].tolist(), self.waits[copy], strict=True)
        ]
        for first in range(len(waits)) if station is None else [station]:
            paths: list[tuple[int, ...]] = [(first,)]
            reached = {first}
            for path in paths:
                if first in waits[path[-1]]:
                    return path
                paths += [(*path, i) for i in waits[path[-1]] if i not in reached]
                reached.update(waits[path[-1]])
        return ()
