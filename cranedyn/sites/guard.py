"""Guard of a crane: it keeps the drives inside a box, and the rope inside its largest swing.

Written once for floats and compiled code, see `cranedyn.dynamics.scalars`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache, reduce
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array, whole
from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.scalars import array, chosen, larger, smaller, square_root
from cranedyn.interfaces import State
from cranedyn.sites.brakes import CYCLE, Brakes, largest_rate, stopping_distance
from cranedyn.sites.capsules import JOINT, pivot_motions, rope_pose
from cranedyn.sites.site import Station

PATIENCE, LONGEST = 0.5, 16.0
"""Time for which a guard waits for an answer, and the longest after some that came late [s]."""

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


ROUNDING, FARTHEST = 1e-9, 1e9
"""Rounding errors of decelerations and rates, and a distance beyond all drives."""


class BoxRequest(NamedTuple):
    """Messages of the guards of one crane on k copies of a site.

    Attributes:
        copies: Indices of the copies, shape (k,).
        number: Number of each request, shape (k,).
        held: Boxes that the cranes keep to from now on, shape (k, 2, m).
        wanted: Boxes that they ask for, around those that they keep to, shape (k, 2, m).
    """

    copies: np.ndarray
    number: np.ndarray
    held: np.ndarray
    wanted: np.ndarray


class BoxGrant(NamedTuple):
    """Answers of the supervisors to one crane on k copies of a site.

    Attributes:
        copies: Indices of the copies, shape (k,).
        number: Number of each request, shape (k,).
        box: Boxes that the cranes may keep to, shape (k, 2, m).
        blocked_by: Whether each crane of the site keeps it from all that it asked for, shape (k,
            cranes).
        target: Positions of the drives to which they withdraw, shape (k, m), to let others pass
            that wait for them; inf where they need not.
    """

    copies: np.ndarray
    number: np.ndarray
    box: np.ndarray
    blocked_by: np.ndarray
    target: np.ndarray


class Guard:
    """The part of the supervision that runs on a crane, on N copies of a site in lockstep.

    Attributes:
        box: Box in which each crane keeps, shape (N, 2, m).
        rates: Last rates that it passed on [rad/s or m/s], shape (N, m).
        fault: Whether a measurement was out of its range; all drives then brake; shape (N,).
        target: Position to which each crane withdraws, whatever is commanded, shape (N, m); inf
            where it does not.
    """

    def __init__(self, station: Station, swing: float, count: int = 1) -> None:
        """Start at rest where the crane starts, with a box just around it.

        Args:
            station: The crane.
            swing: Largest angle of the rope from plumb [rad].
            count: Number of copies, N.

        Raises:
            OutOfRange: If the number is not a whole one from 1.
        """
        crane, layout, brakes = station.crane, station.crane.layout, station.brakes
        copies = whole("number of copies", count, 1)
        self.station, self.rates = station, np.zeros((copies, layout.m))
        box = brakes.tube(crane.start.q[layout.drives], self.rates[0], self.rates[0])
        self.box, self._granted = np.array([[box] * copies] * 2)
        self.fault = np.zeros(copies, dtype=bool)
        self.target = np.full((copies, layout.m), np.inf)
        self._number, self._asked_at = np.zeros(copies, dtype=int), np.full(copies, -math.inf)
        self._patience = np.full(copies, PATIENCE)
        self._steps = CYCLE * gentle(station, swing).decelerations
        self._numbers = np.concatenate(
            [station.ropes[0], [brakes.reaction, crane.gravity, swing], brakes.tolerances,
             brakes.decelerations, *station.ranges]
        )  # fmt: skip
        order = layout.drives, station.bodies.columns, crane.swings
        self._guarded = _guarding(*(tuple(indices.tolist()) for indices in order))

    def step(self, t: float, state: State, command: np.ndarray) -> tuple[np.ndarray, BoxRequest]:
        """Return the rates for the drives [rad/s or m/s], shape (N, m), and the requests that are
        due.

        A rate is the commanded one, as far as its stopping distance ends inside of the box and it
        changes by no more than the brakes can take back. Where braking now would swing the rope by
        more than `DAMPED` of what is allowed, no drive speeds up and the drives damp the swing.

        Args:
            t: Time of the crane's own clock [s].
            state: Coordinates and rates as measured, shape (N, n) each.
            command: Rates that operators or plans command, shape (N, m).

        Raises:
            Misshapen: If the command has another shape.
        """
        drives = self.station.crane.layout.drives
        command = as_array("command", command, self.rates.shape)
        measured, position = np.hstack([*state, command]), state.q[:, drives]
        outside = np.abs(position - np.clip(position, *self.station.ranges))
        fits = (outside <= self.station.brakes.tolerances).all(axis=1)
        fits &= np.isfinite(measured).all(axis=1)
        self.fault, count = ~fits, len(fits)
        boxes = (box.reshape(count, -1) for box in (self.box, self._granted))
        numbers = np.hstack([measured, self.rates, *boxes, self.target])
        outputs = self._guarded(numbers, self._numbers).reshape(count, 7, -1)
        braked = np.clip(0.0, self.rates - self._steps, self.rates + self._steps)
        self.rates = np.where(fits[:, None], outputs[:, 0], braked)
        asks = fits & (t - self._asked_at >= self._patience)
        box = np.where(asks[:, None, None], outputs[:, 3:5], outputs[:, 1:3])
        self.box, self._granted = (
            np.where(fits[:, None, None], box, old) for old in (self.box, self._granted)
        )
        self._number, self._asked_at = self._number + asks, np.where(asks, t, self._asked_at)
        due = np.flatnonzero(asks)
        return self.rates, BoxRequest(due, self._number[due], box[due], outputs[due, 5:])

    def receive(self, grant: BoxGrant) -> None:
        """Take grants that answer the last request; wait longer for others where one comes late."""
        last, asks = self._number[grant.copies], self._asked_at[grant.copies] > -math.inf
        answers = (grant.number == last) & asks
        copies, late = grant.copies[answers], grant.copies[grant.number < last]
        self._granted[copies], self.target[copies] = grant.box[answers], grant.target[answers]
        self._asked_at[copies] = -math.inf
        self._patience[late] = np.minimum(2.0 * self._patience[late], LONGEST)


def gentle(station: Station, swing: float) -> Brakes:
    """Return the brakes of a crane with decelerations that incline its rope by no more than
    `GENTLE` of the largest swing [rad], each drive for itself, wherever the drives stand.
    """
    crane, brakes, columns = station.crane, station.brakes, station.bodies.columns.tolist()
    numbers = station.ropes[0], brakes.reaction, crane.gravity, swing
    drives = brakes.tolerances, brakes.decelerations, columns[:-1], columns[-1]
    slopes, _ = _Crane(*numbers, *drives).planned(station.ranges)
    return replace(brakes, decelerations=slopes.astype(float))


_stops, _rates = np.frompyfunc(stopping_distance, 3, 1), np.frompyfunc(largest_rate, 3, 1)
_least, _most = np.frompyfunc(smaller, 2, 1), np.frompyfunc(larger, 2, 1)
_where = np.frompyfunc(chosen, 3, 1)


_toward = np.frompyfunc(
    lambda way, rate: chosen(way > 0.0, rate, -rate), 2, 1
)  # a comparison of two arrays of objects is true


def _clip(value: Any, low: Any, high: Any) -> Any:
    return _least(_most(value, low), high)


class _Crane(NamedTuple):
    """Numbers of a crane for its guard.

    Attributes:
        rope: See `cranedyn.sites.capsules.rope_pose`.
        reaction, gravity, swing: Reaction time [s], gravity [m/s²] and largest swing [rad].
        slack, slopes: Tolerances and weakest decelerations of its brakes, shape (m,).
        chain: Indices of the drives from the foot to the pivot.
        winch: Index of the winch.
    """

    rope: np.ndarray
    reaction: Any
    gravity: Any
    swing: Any
    slack: np.ndarray
    slopes: np.ndarray
    chain: list[int]
    winch: int

    def planned(self, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return decelerations that incline the rope by no more than `GENTLE` of its largest swing,
        each drive for itself, and largest motions of the pivot, wherever in a box the drives stand,
        shape (m,) each.
        """
        reaches, largest = 0.0 * self.slopes + 1e-6, GENTLE * self.swing * self.gravity
        reaches[self.chain] = pivot_motions(self.rope, *box[:, self.chain])
        slopes = _least(self.slopes, 1.0 / reaches * largest)
        return slopes, reaches

    def tube(self, slopes: np.ndarray, position: Any, low: Any, high: Any) -> np.ndarray:
        """Return the ends of what drives pass before they stand, see `Brakes.tube`."""
        back = _stops(_least(low, 0.0), self.reaction, slopes) + self.slack
        ahead = _stops(_most(high, 0.0), self.reaction, slopes) + self.slack
        return np.array([position - back, position + ahead])

    def largest_rates(
        self, slopes: np.ndarray, box: np.ndarray, position: Any, rates: Any, velocity: Any
    ) -> np.ndarray:
        """Return the largest rates to the lower and the upper ends of a box, shape (2, m).

        Drives that lag behind their commands by the reaction time still go on at what they have or
        had been commanded, and stop from there: so they end in the box, and slow down by no more
        than the decelerations.
        """
        distances = _most(np.array([position - box[0], box[1] - position]) - self.slack, 0.0)
        speeds = np.array([-_least(rates, velocity), _most(rates, velocity)])
        remaining = _most(distances - _most(speeds, 0.0) * self.reaction, 0.0)
        return _least(_rates(distances, self.reaction, slopes), _rates(remaining, 0.0, slopes))

    def swings_to(
        self,
        poses: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
        cables: tuple[Any, Any],
        velocity: np.ndarray,
        rates: np.ndarray,
        box: np.ndarray,
    ) -> tuple[Any, np.ndarray]:
        """Return the largest angle of the rope [rad] if all drives brake now, and changes of rates
        that damp it: those of the pivot are 2 ζ ω times those of the load's place from it in plan.

        At constant rates the pivot has an acceleration b by turning, about which the rope swings
        inclined by b/g. A drive that brakes within an acceleration of the pivot a from a rate of
        the pivot v adds an amplitude of no more than 2 a/g, and no more than v/√(g l), both where
        in the box the rope reaches farthest; b fades and adds no more than b/g. Of a rope that is
        shortened from l to s, no amplitude grows by more than (l/s)^1.5.

        Args:
            poses: Poses of the rope, `MOMENT` apart, three.
            cables: Cable length and the shortest [m].
            velocity: Measured rates, shape (m,).
            rates: Commanded rates, shape (m,).
            box: Ends of the box, shape (2, m).
        """
        chain, winch, (cable, shortest) = self.chain, self.winch, cables
        fall = square_root(self.gravity * cable)
        (slopes, reaches), motions = self.planned(box), [motion[:, :2] for *_, motion in poses]
        tilts = [
            (earlier - later).T @ velocity[chain] / (MOMENT * self.gravity)
            for earlier, later in itertools.pairwise(motions)
        ]
        leans = [rope[:2] - tilt for (_, rope, _), tilt in zip(poses, tilts, strict=False)]
        change = (leans[1] - leans[0]) * (1.0 / MOMENT)
        added = reaches * _least(2.0 * slopes / self.gravity, abs(rates) / fall)
        swing = square_root(leans[0] @ leans[0] + change @ change * (cable / self.gravity))
        swing = swing + square_root(tilts[0] @ tilts[0]) + square_root(added @ added)
        hoisted = _least(_least(rates[winch], velocity[winch]), 0.0)
        shortened = cable - stopping_distance(hoisted, self.reaction, slopes[winch])
        growth = _most(cable / _most(shortened, shortest), 1.0)
        damping, gram = 0.0 * slopes, motions[0].T @ motions[0]
        (a, b), (_, c) = gram + np.eye(2) * 1e-9 * (gram[0, 0] + gram[1, 1])
        x, y = change * (2.0 * DAMPING * CYCLE * fall / (a * c - b * b))
        damping[chain] = motions[0] @ array([c * x - b * y, a * y - b * x])
        return swing * growth * square_root(growth), damping


@cache
def _guarding(
    drives: tuple[int, ...], columns: tuple[int, ...], swings: tuple[int, ...]
) -> RowFunction:
    """Return the step of a guard, compiled: from the crane, its state, a command, the last rates,
    the box, the last grant and a target to rates, box, the box that it keeps to once it asks, and
    the one that it then asks for, shape (7 m,).
    """
    m, n = len(drives), len(drives) + len(swings)
    sizes = [15 + JOINT * (n - 1), 3, m, m, m, m, n, n, *[m] * 7]

    def guarded(numbers: np.ndarray) -> list[Any]:
        rope, limits, slack, slopes, lower, upper, q, v, command, rates, *boxes, target = np.split(
            numbers, np.cumsum(sizes)[:-1]
        )
        reaction, gravity, largest = limits
        chain, winch = [*columns[:-1]], columns[-1]
        crane = _Crane(rope, reaction, gravity, largest, slack, slopes, chain, winch)
        position, velocity = q[[*drives]], v[[*drives]]
        box, granted = np.array(boxes).reshape(2, 2, m)
        slopes, _ = crane.planned(box)
        # The farther the rope reaches, the gentler are brakes: an interval grows where the rates of
        # all drives may be kept.
        for drive in columns:
            larger = box.copy()
            larger[:, drive] = granted[:, drive]
            gentler, _ = crane.planned(larger)
            back, ahead = crane.largest_rates(gentler, larger, position, rates, velocity)
            spare = _most(gentler - slopes, _least(rates + back, ahead - rates))
            fits = reduce(_least, spare) > -ROUNDING
            box, slopes = _where(fits, larger, box), _where(fits, gentler, slopes)
        off = target - position
        approach = _rates(_most(abs(off) - slack, 0.0), crane.reaction, slopes)
        command = _where(abs(off[0]) < FARTHEST, _toward(off, approach), command)
        moments = [q + k * MOMENT * v for k in range(3)]
        links = [drives[i] for i in crane.chain]
        poses = [rope_pose(rope, x[links], x[[*swings]]) for x in moments]
        cables = abs(position[crane.winch]), lower[crane.winch]
        swing, damping = crane.swings_to(poses, cables, velocity, rates, box)
        change = slopes * CYCLE
        slower = _clip(command, _least(rates, 0.0), _most(rates, 0.0))
        slower[crane.winch] = _most(slower[crane.winch], 0.0)
        slower = _clip(slower, rates - change, rates + change) + damping
        command = _where(swing > DAMPED * crane.swing, slower, command)
        back, ahead = crane.largest_rates(slopes, box, position, rates, velocity)
        rates = _clip(_clip(command, rates - change, rates + change), -back, ahead)
        tube = crane.tube(slopes, position, _least(rates, velocity), _most(rates, velocity))
        outputs = [*rates, *box.flat]
        for _ in range(2):  # with brakes of the box, then of what is wanted
            soon = _clip(command, rates - HORIZON * slopes, rates + HORIZON * slopes)
            low, high = _least(soon, rates), _most(soon, rates)
            coming = crane.tube(slopes, position, low, high)
            low = _least(coming[0] + HORIZON * _least(low, 0.0), tube[0])
            high = _most(coming[1] + HORIZON * _most(high, 0.0), tube[1])
            request = np.array([_most(low, lower - slack), _least(high, upper + slack)])
            slopes, _ = crane.planned(_hull(request, tube))
        # What lies behind is given back; what is passed before standstill never is.
        hull = _hull(request, tube)
        retained = np.array([_most(box[0], hull[0]), _least(box[1], hull[1])])
        return [*outputs, *retained.flat, *_hull(request, retained).flat]

    return compile_rows(guarded, sum(sizes[6:]), 7 * m, sum(sizes[:6]))


def _hull(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the box around two boxes."""
    return np.array([_least(a[0], b[0]), _most(a[1], b[1])])
