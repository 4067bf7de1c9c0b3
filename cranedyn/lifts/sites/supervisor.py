"""Reservation: each crane keeps inside a box of positions that no other crane's box comes near.

The *box* of a crane is an interval of positions for each of its drives, in which it can always stop
by its own brakes. A guard on each crane (`cranedyn.lifts.sites.guard`) keeps it there whatever
messages arrive. The `Supervisor` enlarges a box only where it is proven apart from all others.
Neither reads a clock of the other: a grant answers one numbered request, and a guard accepts no
grant but that for its last request.

Invariant:

* Each crane can stop in its box: its guard sees to that.
* Its box lies in the one that the supervisor has reserved for it, since a guard gives back before
  it asks, and the supervisor enlarges before it answers.
* Reserved boxes are proven the required distance apart, with the load of each crane anywhere in the
  cone in which it may swing.

So nothing meets, as long as what `cranedyn.lifts.sites.promise` lists holds: brakes no weaker,
ropes that swing no farther and a wind no stronger than entered, among others. Messages that are
late or lost only make cranes wait, and so do messages that are not sound: each end checks what it
receives.

Cranes may wait for each other in a circle, each for the next and the last for the first: a
*deadlock*. The supervisor then lets one of them *withdraw*: its guard takes it to a position where
the crane that waits for it can pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.checks import as_array, whole, within
from cranedyn.errors import DataError, quoted
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.guard import NO_TARGET, BoxGrant, BoxRequest, is_index, is_request_number

# Chosen. A guard asks again in the cycle after an answer: where messages take no time, 20 requests
# are 2 s, and 100 requests are 10 s.
REFUSALS_BEFORE_WITHDRAWAL = 20
"""Refused requests of a crane in a row after which the supervisor tries to end a deadlock in which
it is, one trial a cycle."""

REQUESTS_BEFORE_RETURN = 100
"""Requests of the crane that is let pass, none of which had to wait for the crane that withdrew,
after which the latter may go where it wants again."""

PASSING_TIMES = (20.0, 5.0, 1.0, 0.2)
"""How far ahead of what it wants a crane is let pass, as times at full rate [s], in the order in
which they are tried."""

MAX_WITHDRAWAL_TIME = 60.0
"""Largest distance that a drive withdraws, as time at full rate [s]."""

POSITIONS_DRAWN = 16
"""Number of positions that are drawn at random in a trial."""

# Short distances are drawn more often than long ones: half of the draws are within 3 % of
# `MAX_WITHDRAWAL_TIME`.
_DRAW_POWER = 5
"""Power of a uniform number, from -1 to 1, by which the distance of a withdrawal is drawn."""

RANGE_ROUNDING = 1e-9
"""Rounding error of the ends of ranges [rad or m]."""

_MORE_THAN_ALL_REFUSALS = 1 << 40
"""More requests than are ever refused in a row."""

_EXTENSION_SHARES = (1.0, 0.5, 0.2)
"""Shares of an extension that are tried, the largest first."""


class _Withdrawal(NamedTuple):
    """A crane that may withdraw, and the one that it then lets pass.

    Attributes:
        crane: Index of the crane that withdraws.
        passing: Index of the crane that it lets pass.
        passing_time: How far ahead the other is let pass, see `PASSING_TIMES` [s].
    """

    crane: int
    passing: int
    passing_time: float


class Supervisor:
    """The part of the supervision that all cranes share, on N copies of a site in lockstep.

    The crane whose requests have been refused longest has the right of way, of several the first of
    the site: no other crane is granted what it has asked for. In a deadlock one crane withdraws to
    let another pass. The cranes that do not withdraw yet and have the least right of way are tried
    first, one a cycle. A crane that withdraws has no right of way.

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

        # Of each crane: the number of its last request, and how many were refused in a row.
        self._numbers = np.zeros((copies, cranes), dtype=int)
        self._refused = np.zeros((copies, cranes), dtype=int)

        # Of each crane that withdraws: how many requests in a row of the crane that it lets pass
        # did not wait for it.
        self._free_requests = np.zeros((copies, cranes), dtype=int)

        # Number of the last trial to end a deadlock on each copy.
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
                first = quoted(site.stations[i].name)
                second = quoted(site.stations[int(np.argmin(apart))].name)
                raise DataError(
                    f"At the start {first} and {second} are not proven to be "
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
        copies, number, held, wanted = self._sound_requests(station, request)
        self._numbers[copies, station] = number

        # Reserve all that is wanted if it is proven apart, else what can be of it.
        neighbours = self._boxes_to_keep_from(station, copies)
        apart = self.site.apart(station, wanted, neighbours)
        box = wanted.copy()
        partly = ~apart.all(axis=1)
        if partly.any():
            near_boxes = [boxes[partly] for boxes in neighbours]
            box[partly] = self._extended(
                station, held[partly], wanted[partly], near_boxes, ~apart[partly]
            )
        self.boxes[station][copies] = box
        self._wanted[station][copies] = wanted

        # A crane that withdraws asks for what takes it away, not for where it wants to go.
        goes = self.passing[copies, station] < 0
        self._directions[station][copies[goes]] = np.sign(wanted - held)[goes]

        # The crane waits for those that keep it from what it wants. Less than an error of
        # measurement is nothing to wait for.
        is_cut = np.abs(wanted - box) > self.site.stations[station].brakes.tolerances
        blocking = ~apart & is_cut.any(axis=(1, 2))[:, None]

        # At its own index are obstacles, which never give way.
        blocking[:, station] = False
        self.waits[copies, station] = blocking
        self._resolve_deadlocks(station, copies)
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

    def _boxes_to_keep_from(self, station: int, copies: np.ndarray) -> list[np.ndarray]:
        """Return the box of each crane from which a crane must keep apart, shape (copies, 2, m)
        each.

        That is the reserved box of the other crane; or, where that has the right of way, all that
        it wants, so that nobody takes what it waits for. Of two cranes the one that was refused
        more often in a row has the right of way, then the one with the smaller index. A crane that
        withdraws has none; but it need not leave others what they want, since it has to get out of
        their way.
        """
        indices = np.arange(len(self.boxes))
        goes = self.passing[copies] < 0

        # A number for each crane that is the greater, the more right of way it has.
        refused = goes * _MORE_THAN_ALL_REFUSALS + self._refused[copies]
        rank = refused * len(indices) - indices
        has_right_of_way = (rank > rank[:, [station]]) & goes[:, [station]]
        boxes = [box[copies] for box in self.boxes]
        for i in np.flatnonzero(has_right_of_way.any(axis=0)):
            rows = has_right_of_way[:, i]
            boxes[i][rows] = self._wanted[i][copies[rows]]
        return boxes

    def _extended(
        self,
        station: int,
        box: np.ndarray,
        wanted: np.ndarray,
        neighbours: list[np.ndarray],
        doubtful: np.ndarray,
        shares: Sequence[float] = _EXTENSION_SHARES,
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

            # The box itself is proven already: only the slab between the old end and the new one
            # is left to prove.
            slab = enlarged.copy()
            slab[..., 1 - end, drive] = box[rows, end, drive]
            beside = [boxes[rows] for boxes in neighbours]
            proven = self.site.apart(station, slab, beside, doubtful[rows]).all(axis=-1)
            granted = proven.any(axis=0)

            # The shares descend, so that the first one that is proven is the largest.
            largest_share = proven.argmax(axis=0)
            box[rows[granted]] = enlarged[largest_share[granted], granted]
        return box

    def _resolve_deadlocks(self, station: int, copies: np.ndarray) -> None:
        """End withdrawals that let a crane pass which has not waited for a while, and try to begin
        one if the crane has waited for long in a deadlock.

        Args:
            station: Index of the crane.
            copies: Copies on which it has sent a request.
        """
        self._end_withdrawals(station, copies)
        is_stuck = self._refused[copies, station] >= REFUSALS_BEFORE_WITHDRAWAL
        for copy in copies[is_stuck].tolist():
            deadlocked = self.deadlock(copy, station)
            # The first crane of a deadlock acts for all, so that there is one trial a cycle.
            if station == min(deadlocked, default=None):
                self._try_withdrawal(copy, deadlocked)

    def _end_withdrawals(self, station: int, copies: np.ndarray) -> None:
        """End the withdrawals of others that let a crane pass, once it has not waited for a while.

        Args:
            station: Index of the crane that passes.
            copies: Copies on which it has sent a request.
        """
        lets_pass = self.passing[copies] == station
        if not lets_pass.any():
            return
        free_requests = self._free_requests[copies]
        counted = np.where(self.waits[copies, station], 0, free_requests + 1)
        free_requests = np.where(lets_pass, counted, free_requests)
        self._free_requests[copies] = free_requests
        has_passed = lets_pass & (free_requests > REQUESTS_BEFORE_RETURN)
        for row, withdrawn in np.argwhere(has_passed).tolist():
            self._end_withdrawal(copies[row], withdrawn)

    def _try_withdrawal(self, copy: int, deadlocked: tuple[int, ...]) -> None:
        """Let a crane of a deadlock withdraw if a position is found at which the one that waits for
        it can pass. Each call tries one of the possible withdrawals.

        Args:
            copy: Index of the copy.
            deadlocked: Cranes each of which waits for the next, and the last for the first.
        """
        self._trial[copy] += 1
        withdrawals = self._possible_withdrawals(copy, deadlocked)
        withdrawal = withdrawals[self._trial[copy] % len(withdrawals)]
        target = self._refuge(copy, withdrawal)
        if target is None:
            return
        # A crane that is let pass goes where it wants to.
        self._end_withdrawal(copy, withdrawal.passing)
        self.targets[withdrawal.crane][copy] = target
        self.passing[copy, withdrawal.crane] = withdrawal.passing
        self._free_requests[copy, withdrawal.crane] = 0
        self._refused[copy, min(deadlocked)] = 0
        self._trial[copy] = -1

    def _possible_withdrawals(self, copy: int, deadlocked: tuple[int, ...]) -> list[_Withdrawal]:
        """Return the withdrawals that may end a deadlock in the order in which they are tried:
        first by the cranes that do not withdraw yet and have the least right of way, then by how
        far the other may pass.
        """
        passing = self.passing[copy].tolist()
        refused = self._refused[copy].tolist()
        ranked = sorted(deadlocked, key=lambda i: (passing[i] >= 0, refused[i], -i))
        withdrawals = []
        for crane in ranked:
            # The crane before it waits for it; before the first is the last.
            waiting = deadlocked[deadlocked.index(crane) - 1]
            withdrawals += [_Withdrawal(crane, waiting, time) for time in PASSING_TIMES]
        return withdrawals

    def _end_withdrawal(self, copy: int, crane: int) -> None:
        """Let a crane go where it wants again, if it withdraws."""
        self.targets[crane][copy] = NO_TARGET
        self.passing[copy, crane] = -1

    def _refuge(self, copy: int, withdrawal: _Withdrawal) -> np.ndarray | None:
        """Return a position to which a crane can withdraw so that another can pass, shape (m,);
        None if none is found.

        It is the nearest in time of some that are drawn at random. All positions on the way there
        are proven apart from what is reserved for other cranes.
        """
        crane = withdrawal.crane
        station = self.site.stations[crane]
        box = self.boxes[crane][copy]
        rates = station.converters.rates

        # A seed that differs from trial to trial, and is the same when a run is repeated.
        rng = np.random.default_rng(self._numbers[copy].sum())
        draws = rng.uniform(-1.0, 1.0, (POSITIONS_DRAWN, len(rates)))
        times = MAX_WITHDRAWAL_TIME * draws**_DRAW_POWER
        # Each drive stays where it is with a probability of one half.
        is_moved = rng.integers(2, size=times.shape)
        least, largest = station.ranges - box
        shifts = np.clip(times * is_moved * rates, least, largest)
        nearest_first = (abs(shifts) / rates).max(axis=1).argsort()
        moved = box + shifts[nearest_first, None]

        # The nearest box that leaves the other crane room to pass; one row or none.
        passing_box = self._passing_box(copy, withdrawal)
        is_clear = self.site.pair_apart(crane, moved, withdrawal.passing, passing_box)
        refuge = moved[is_clear][:1]
        if not len(refuge):
            return None

        # The crane can get there if all positions between are free: if its box may be extended to
        # them, as a whole.
        swept = np.stack(
            [np.minimum(box[0], refuge[:, 0]), np.maximum(box[1], refuge[:, 1])], axis=1
        )
        boxes = [of_crane[[copy]] for of_crane in self.boxes]
        doubtful = np.ones((1, len(boxes)), dtype=bool)
        proven = self._extended(crane, boxes[crane], swept, boxes, doubtful, [1.0])
        if not np.allclose(proven, swept):
            return None
        return refuge[0].mean(axis=0)

    def _passing_box(self, copy: int, withdrawal: _Withdrawal) -> np.ndarray:
        """Return the box in which a crane passes: what it wants, and beyond that as far as it is
        let pass in the direction in which it goes, within its ranges; shape (2, m).
        """
        passing = withdrawal.passing
        station = self.site.stations[passing]
        wanted = self._wanted[passing][copy]
        directions = self._directions[passing][copy]
        reach = withdrawal.passing_time * station.converters.rates * directions
        lowest, highest = station.ranges
        # What is wanted may lie beside the ranges by an error of measurement.
        low = np.minimum(lowest, wanted[0])
        high = np.maximum(highest, wanted[1])
        return np.clip(wanted + reach, low, high)

    def refuges(self, copy: int = 0) -> dict[int, np.ndarray]:
        """Return where each crane of a copy that lets another pass withdraws to [rad or m]."""
        withdrawn = np.flatnonzero(self.passing[copy] >= 0).tolist()
        return {i: self.targets[i][copy].copy() for i in withdrawn}

    def deadlock(self, copy: int = 0, station: int | None = None) -> tuple[int, ...]:
        """Return cranes of a copy each of which waits for the next, and the last for the first.

        A crane that withdraws waits for the one that it lets pass.

        Args:
            copy: Index of the copy.
            station: Index of a crane that is to be among them; None for the first of the site that
                is in a deadlock.

        Returns:
            Indices of the cranes of the shortest such circle, that crane first; empty if there is
            none.
        """
        waits = []
        for i, passing in enumerate(self.passing[copy].tolist()):
            if passing >= 0:
                waits.append([passing])
            else:
                waits.append(np.flatnonzero(self.waits[copy, i]).tolist())

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
