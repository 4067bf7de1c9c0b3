"""Reservation: each crane keeps inside a box of positions that no other crane's box comes near.

The box of a crane is an interval for each of its drives, in which it can always stop by its own
brakes. A guard on each crane (`cranedyn.lifts.sites.guard`) keeps it there whatever messages
arrive. The `Supervisor` enlarges a box only where it is proven apart from all others. Neither reads
a clock of
the other: a grant answers one numbered request, and a guard accepts none but that for its last.

Invariant: each crane can stop in its box (guard), its box lies in what the supervisor has reserved
for it (a guard gives back before it asks, and the supervisor enlarges before it answers), and
reserved boxes are proven the required distance apart, with the load of each anywhere in its cone.
So nothing meets, as long as what `cranedyn.lifts.sites.promise` lists holds: brakes no
weaker, ropes that swing no farther and a wind no stronger than entered, among others. Messages that
are late or
lost only make cranes wait, and so do messages that are not sound: each end checks what it receives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.checks import as_array, whole, within
from cranedyn.errors import DataError, quoted
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.guard import NO_TARGET, BoxGrant, BoxRequest, is_index, is_request_number

STUCK = 20
"""Refused requests in a row after which a way out of a circle is sought, one trial a cycle."""

PASSING = 100
"""Requests of a crane without waiting after which the one that withdrew no longer lets it pass."""

AHEAD = (20.0, 5.0, 1.0, 0.2)
"""How far ahead of what it wants a crane is let pass, as time at full rate [s]. The first that can
be is taken."""

FARTHEST = 60.0
"""Longest way out of a circle for each drive, as time at full rate [s]."""

DRAWN = 16
"""Positions that are drawn in a trial."""

# Short ways are drawn more often than long ones: half of the draws are within 3 % of `FARTHEST`.
_DRAW_POWER = 5
"""Power of a uniform number, from -1 to 1, by which a way out is drawn."""

RANGE_ROUNDING = 1e-9
"""Rounding error of the ends of ranges [rad or m]."""

_MORE_THAN_ALL_REFUSALS = 1 << 40
"""More requests than are ever refused in a row."""

_SHARES = (1.0, 0.5, 0.2)
"""Shares of an extension that are tried."""


class _Deal(NamedTuple):
    """A crane that withdraws, and the one that it lets pass.

    Attributes:
        loser: Index of the crane that withdraws.
        winner: Index of the crane that it lets pass.
        ahead: How far the winner is let pass, see `AHEAD` [s].
    """

    loser: int
    winner: int
    ahead: float


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
        if len(boxes) != len(site.stations):
            raise DataError(f"{len(boxes)} boxes are given for {len(site.stations)} cranes.")
        copies = len(boxes[0])
        cranes = len(boxes)
        self.site = site
        self.boxes = [np.array(box) for box in boxes]
        self.waits = np.zeros((copies, cranes, cranes), dtype=bool)
        self.passing = np.full((copies, cranes), -1)
        self.targets = [np.full((copies, box.shape[2]), NO_TARGET) for box in self.boxes]

        # Number of the last request of each crane, how many were refused in a row, and how many
        # requests of the crane that it lets pass did not wait.
        self._numbers = np.zeros((copies, cranes), dtype=int)
        self._refused = np.zeros((copies, cranes), dtype=int)
        self._free_since = np.zeros((copies, cranes), dtype=int)

        # Number of the last trial of a way out of a circle on each copy.
        self._trial = np.full(copies, -1)

        # Box that each crane wanted last, and the signs in which its ends went then while it did
        # not withdraw: where the crane wants to go.
        self._wanted = [box.copy() for box in self.boxes]
        self._directions = [np.zeros_like(box) for box in self.boxes]
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
        box = wanted.copy()
        cut = ~apart.all(axis=1)
        cut_neighbours = [boxes[cut] for boxes in neighbours]
        box[cut] = self._extended(station, reported[cut], wanted[cut], cut_neighbours, ~apart[cut])
        self.boxes[station][copies] = box
        self._wanted[station][copies] = wanted

        # A crane that withdraws wants to go where it was told to, not where it would go.
        goes = self.passing[copies, station] < 0
        self._directions[station][copies[goes]] = np.sign(wanted - reported)[goes]

        # Less than an error of measurement is nothing to wait for.
        short = np.abs(wanted - box) > self.site.stations[station].brakes.tolerances
        blocking = ~apart & short.any(axis=(1, 2))[:, None]

        # At its own index are obstacles, which never give way.
        blocking[:, station] = False
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
        boxes = (count, *reserved_boxes.shape[1:])
        given_copies = as_array("copies of a request", request.copies, (count,))
        given_numbers = as_array("numbers of a request", request.number, (count,))
        held = as_array("box held in a request", request.held, boxes)
        wanted = as_array("box wanted in a request", request.wanted, boxes)

        known = is_index(given_copies, len(reserved_boxes)) & is_request_number(given_numbers)
        copies = np.where(known, given_copies, 0.0).astype(int)
        number = np.where(known, given_numbers, 0.0).astype(int)
        _, first_of_copy = np.unique(np.where(known, copies, -1), return_index=True)
        first_rows = np.zeros(count, dtype=bool)
        first_rows[first_of_copy] = True

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
        """Return for each crane what another must keep apart from, shape (copies, 2, m) each.

        That is what is reserved for it, and all that it wants if it has right of way: so nobody
        takes what it waits for. Right of way has the crane that was refused more often, then the
        one with the smaller index; a crane that withdraws has none.
        """
        indices = np.arange(len(self.boxes))
        goes = self.passing[copies] < 0

        # One number for each crane that is greater the more right of way it has.
        refused = goes * _MORE_THAN_ALL_REFUSALS + self._refused[copies]
        rank = refused * len(indices) - indices
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
        """Return boxes enlarged towards wanted ones as far as they are proven apart.

        One end of one drive after the other is moved, by the largest share of its extension that is
        proven.

        Args:
            station: Index of the crane.
            box: Boxes that are proven apart, shape (k, 2, m); they are enlarged in place.
            wanted: Boxes that contain them, shape (k, 2, m).
            neighbours: Boxes of all cranes to keep apart from, shape (k, 2, m) each.
            doubtful: Whether each crane may be near, see `CraneSite.apart`, shape (k, cranes).
            shares: Shares of an extension that are tried, the largest first.
        """
        for end, drive in np.ndindex(wanted.shape[1:]):
            rows = np.flatnonzero(wanted[:, end, drive] != box[:, end, drive])
            if not len(rows):
                continue
            enlarged = np.repeat(box[rows][None], len(shares), axis=0)
            enlarged[..., end, drive] += np.outer(shares, (wanted - box)[rows, end, drive])

            # Only the slab between the old end and the new one is left to prove.
            slab = enlarged.copy()
            slab[..., 1 - end, drive] = box[rows, end, drive]
            beside = [boxes[rows] for boxes in neighbours]
            proven = self.site.apart(station, slab, beside, doubtful[rows]).all(axis=-1)
            granted = proven.any(axis=0)
            largest_share = proven.argmax(axis=0)
            box[rows[granted]] = enlarged[largest_share[granted], granted]
        return box

    def _resolve(self, station: int, copies: np.ndarray) -> None:
        """End withdrawals for a crane that has not waited for a while, and begin one if it waits in
        a circle.
        """
        self._end_withdrawals(station, copies)
        for copy in copies[self._refused[copies, station] >= STUCK].tolist():
            circle = self.deadlock(copy, station)
            # One crane of a circle acts for it, so that there is one trial a cycle.
            if station == min(circle, default=None):
                self._try_way_out(copy, circle)

    def _end_withdrawals(self, station: int, copies: np.ndarray) -> None:
        """End the withdrawals of others that let a crane pass, once it has not waited for a while.

        Args:
            station: Index of the crane that passes.
            copies: Copies on which it has sent a request.
        """
        lets_pass = self.passing[copies] == station
        free_since = self._free_since[copies]
        counted = np.where(self.waits[copies, station], 0, free_since + 1)
        free_since = np.where(lets_pass, counted, free_since)
        self._free_since[copies] = free_since
        for row, withdrawn in np.argwhere(lets_pass & (free_since > PASSING)).tolist():
            self._return(copies[row], withdrawn)

    def _try_way_out(self, copy: int, circle: tuple[int, ...]) -> None:
        """Let a crane of a circle withdraw if a random position is found from where the one that
        waits for it can pass; each call tries one crane and one length of its way.

        Args:
            copy: Index of the copy.
            circle: Cranes each of which waits for the next, and the last for the first.
        """
        self._trial[copy] += 1
        deals = self._deals(copy, circle)
        deal = deals[self._trial[copy] % len(deals)]
        target = self._way_out(copy, deal)
        if target is None:
            return
        self._return(copy, deal.winner)
        self.targets[deal.loser][copy] = target
        self.passing[copy, deal.loser] = deal.winner
        self._free_since[copy, deal.loser] = 0
        self._refused[copy, min(circle)] = 0
        self._trial[copy] = -1

    def _deals(self, copy: int, circle: tuple[int, ...]) -> list[_Deal]:
        """Return all deals in a circle in the order in which they are tried: first by the cranes
        that do not withdraw yet and have the least right of way, then by how far another may pass.
        """
        passing = self.passing[copy].tolist()
        refused = self._refused[copy].tolist()
        ranked = sorted(circle, key=lambda i: (passing[i] >= 0, refused[i], -i))
        deals = []
        for loser in ranked:
            # The crane before it in the circle waits for it.
            winner = circle[circle.index(loser) - 1]
            deals += [_Deal(loser, winner, ahead) for ahead in AHEAD]
        return deals

    def _return(self, copy: int, crane: int) -> None:
        """End the withdrawal of a crane."""
        self.targets[crane][copy] = NO_TARGET
        self.passing[copy, crane] = -1

    def _way_out(self, copy: int, deal: _Deal) -> np.ndarray | None:
        """Return a position to which a crane can withdraw so that another can pass, shape (m,);
        None if none is found.

        It is the nearest in time of some that are drawn at random. All between is proven apart from
        what is reserved for others.
        """
        loser = self.site.stations[deal.loser]
        box = self.boxes[deal.loser][copy]
        rates = loser.converters.rates

        # A seed that differs from trial to trial, and is the same when a run is repeated.
        rng = np.random.default_rng(self._numbers[copy].sum())
        times = FARTHEST * rng.uniform(-1.0, 1.0, (DRAWN, len(rates))) ** _DRAW_POWER
        is_moved = rng.integers(2, size=times.shape)
        least, largest = loser.ranges - box
        shifts = np.clip(times * is_moved * rates, least, largest)
        nearest_first = (abs(shifts) / rates).max(axis=1).argsort()
        moved = box + shifts[nearest_first, None]

        passing = self._passing_box(copy, deal)
        free = moved[self.site.pair_apart(deal.loser, moved, deal.winner, passing)][:1]
        swept = np.stack([np.minimum(box[0], free[:, 0]), np.maximum(box[1], free[:, 1])], axis=1)
        boxes = [of_crane[[copy] * len(free)] for of_crane in self.boxes]
        doubtful = np.ones((len(free), len(boxes)), dtype=bool)
        proven = self._extended(deal.loser, boxes[deal.loser], swept, boxes, doubtful, [1.0])
        if not len(free) or not np.allclose(proven, swept):
            return None
        return free[0].mean(axis=0)

    def _passing_box(self, copy: int, deal: _Deal) -> np.ndarray:
        """Return the box in which a crane passes: what it wants, and beyond that as far as it is
        let pass in the direction in which it goes, within its ranges; shape (2, m).
        """
        winner = self.site.stations[deal.winner]
        wanted = self._wanted[deal.winner][copy]
        reach = deal.ahead * winner.converters.rates * self._directions[deal.winner][copy]
        lowest, highest = winner.ranges
        # What is wanted may lie beside the ranges by an error of measurement.
        low = np.minimum(lowest, wanted[0])
        high = np.maximum(highest, wanted[1])
        return np.clip(wanted + reach, low, high)

    def refuges(self, copy: int = 0) -> dict[int, np.ndarray]:
        """Return where each crane of a copy that lets another pass withdraws to [rad or m]."""
        withdrawn = np.flatnonzero(self.passing[copy] >= 0).tolist()
        return {i: self.targets[i][copy].copy() for i in withdrawn}

    def deadlock(self, copy: int = 0, station: int | None = None) -> tuple[int, ...]:
        """Return the indices of cranes of a copy each of which waits for the next, and the last for
        the first: the shortest circle of one crane, or of the first that is in one; empty if there
        is none. A crane that withdraws waits for the one that it lets pass.
        """
        waits = []
        for i, passed in enumerate(self.passing[copy].tolist()):
            waits.append([passed] if passed >= 0 else np.flatnonzero(self.waits[copy, i]).tolist())

        # Breadth first, so that the first circle that is found is the shortest: `paths` grows while
        # the loop goes through it.
        for first in range(len(waits)) if station is None else [station]:
            paths: list[tuple[int, ...]] = [(first,)]
            reached = {first}
            for path in paths:
                if first in waits[path[-1]]:
                    return path
                for following in waits[path[-1]]:
                    if following not in reached:
                        paths.append((*path, following))
                reached.update(waits[path[-1]])
        return ()
