"""Proof that cranes keep a distance wherever they are in intervals of their positions: branch and
bound over products of intervals, compiled.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.code import DOUBLE, INTEGER, Code
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.scalars import array, indicator, larger, smaller, square_root
from cranedyn.lifts.sites import capsules
from cranedyn.lifts.sites.capsules import CAPSULE_SIZE, FOOT_SIZE, JOINT_SIZE, Capsule
from cranedyn.lifts.sites.placed_capsules import CraneBodies, PlacedCapsules

ROUNDING = 1e-6
"""Deduction from every distance [m]: a thousand times the rounding errors of a site of 1e5 m."""

MAX_POSITION = 1e9
"""Largest magnitude of a position of a drive about which anything is proven [rad or m]."""

MAX_SWING = math.pi / 2.0
"""Largest swing of a rope about which anything is proven [rad]."""

MAX_EXAMINED = 100
"""Pairs of capsules with halved intervals that are examined before a proof fails."""

_PLACED_CAPSULE_SIZE = 7
"""Numbers of a capsule in the frame of the site: both ends and the radius."""

_BALL_SIZE = 4
"""Numbers of a ball: its centre and radius."""

_FARTHER_THAN_ALL = 1e300
"""Distance beyond all that are measured [m]."""


def proven_apart(
    bodies: CraneBodies,
    first: np.ndarray,
    first_box: np.ndarray,
    second: np.ndarray,
    second_box: np.ndarray,
    distance: float,
    swing: float,
) -> np.ndarray:
    """Return for each of N pairs of cranes whether no positions in two boxes bring them nearer to
    each other than a distance, shape (N,).

    In the middle of a box a unit vector n separates two capsules with ends a and b and radii r_a
    and r_b by s = min n·a - max n·b - r_a - r_b. Each joint may be off the middle by half of its
    interval at most. Moved one after the other, from the tip to the foot, the joints shift the
    capsules along n by no more than `cranedyn.lifts.sites.capsules.shifts` says. Where s less all
    shifts is at least the distance, the capsules are apart in all of the box. Otherwise the
    interval with the largest shift is halved, and both halves are examined. Rope and load move with
    their pivot. False says nothing about the pair.

    Comparisons are written so that a number that is not finite fails them, and intervals whose ends
    are swapped prove nothing: such a box is never apart from anything.

    Args:
        bodies: The cranes, `stacked`.
        first: Indices of the cranes, shape (N,).
        first_box: Ends of their intervals, shape (N, 2, k + 1), the cable length last.
        second: Indices of the others, shape (N,).
        second_box: Ends of theirs.
        distance: Required distance [m].
        swing: Largest angle of the ropes from plumb [rad].
    """
    if not (distance >= 0.0 and 0.0 <= swing <= MAX_SWING):
        return np.zeros(len(first), dtype=bool)
    count = len(first)

    # A point of a rope that swings by α goes along a chord of 2 sin(α/2) times its depth.
    cone = 2.0 * math.sin(swing / 2.0)
    required = np.array([[distance + ROUNDING, cone]]).repeat(count, axis=0)

    # The layout of a row is that of `_RowLayout`.
    rows = np.hstack(
        [
            required,
            first_box.reshape(count, -1),
            bodies.numbers[first],
            second_box.reshape(count, -1),
            bodies.numbers[second],
        ]
    )
    prove = _compile_proof(bodies.axis.shape[1], bodies.radius.shape[1])
    proven = prove(rows)[:, 0] > 0.0
    return proven & is_box(first_box) & is_box(second_box)


def is_box(ends: np.ndarray) -> np.ndarray:
    """Return whether the ends of intervals, shape (..., 2, k), are ordered and no farther from zero
    than `MAX_POSITION`, shape (...).
    """
    # Each comparison is false for NaN.
    low = ends[..., 0, :]
    high = ends[..., 1, :]
    are_ends = (-MAX_POSITION <= low) & (low <= high) & (high <= MAX_POSITION)
    return np.all(are_ends, axis=-1)


def least_distances(a: PlacedCapsules, b: PlacedCapsules) -> np.ndarray:
    """Return the least distance [m] of N pairs of capsules, shape (N,), or of N pairs of groups of
    n capsules each, with ends of shape (N, n, 2, 3) and radii of shape (N, n).

    Where a number is not finite, the distance is NaN: compare so that NaN counts as too near.
    """
    first = _capsule_rows(a)
    second = _capsule_rows(b)
    rows = np.hstack([first, second])
    measure = _compile_least_distance(
        first.shape[1] // _PLACED_CAPSULE_SIZE, second.shape[1] // _PLACED_CAPSULE_SIZE
    )
    least = measure(rows)[:, 0]
    return np.where(np.isfinite(rows).all(axis=1), least, math.nan)


def _capsule_rows(placed: PlacedCapsules) -> np.ndarray:
    """Return the numbers of groups of capsules, six of both ends and the radius each, in rows."""
    count = len(placed.ends)
    ends = placed.ends.reshape(count, -1, 6)
    radius = placed.radius.reshape(count, -1)
    return np.dstack([ends, radius]).reshape(count, -1)


@cache
def _compile_least_distance(first: int, second: int) -> RowFunction:
    """Compile the least distance of two groups of so many capsules."""
    module = ir.Module()
    code = Code(module, "rows", ["given", "count", "answers", "shared"], 1)
    inputs = code.argument["given"]
    width = _PLACED_CAPSULE_SIZE * (first + second)
    (least,) = code.variables([0.0])

    def capsule(start: ir.Value, which: ir.Value) -> np.ndarray:
        offset = code.builder.add(start, code.product(which, _PLACED_CAPSULE_SIZE))
        indices = range(_PLACED_CAPSULE_SIZE)
        return array([code.spread(inputs, code.plus(offset, i)) for i in indices])

    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        start = code.product(row, width)
        least.set(_FARTHER_THAN_ALL)
        with code.loop(0, first) as a, code.loop(0, second) as b:
            one = capsule(start, a)
            other = capsule(start, code.plus(b, first))
            one_ends = one[:6].reshape(2, 3)
            other_ends = other[:6].reshape(2, 3)
            separation = capsules.separation(one_ends, other_ends, one[6] + other[6])
            least.set(smaller(separation.upper_bound, least.get()))
        code.store(least.get(), code.argument["answers"], row)
    code.end()
    return RowFunction(translate(module), "rows", width, 1)


@cache
def _compile_proof(joints: int, count: int) -> RowFunction:
    """Compile the proof for cranes with so many joints between foot and rope, and capsules."""
    module = ir.Module()
    layout = _RowLayout(joints, count)
    _ProofEmitter(Code(module, "rows", ["given", "count", "answers", "shared"], 1), layout).emit()
    return RowFunction(translate(module), "rows", layout.row, 1)


@dataclass(frozen=True)
class _RowLayout:
    """Layout of the numbers of a pair of cranes.

    A row has the required distance and the cone of the ropes, then for each crane the lower and
    upper ends of its intervals, the numbers of its foot and joints, and those of its capsules, see
    `CraneBodies.numbers`. An entry of the queue has the indices of a capsule of each crane, and the
    ends of the intervals of both.

    Attributes:
        joints: Number of joints between foot and rope, k.
        count: Number of capsules of a crane.
    """

    joints: int
    count: int

    @property
    def ends(self) -> int:
        """Numbers of the ends of the intervals of a crane, with the cable length."""
        return 2 * (self.joints + 1)

    @property
    def chain(self) -> int:
        """Numbers of the foot and the joints of a crane."""
        return FOOT_SIZE + JOINT_SIZE * self.joints

    @property
    def crane(self) -> int:
        """All numbers of a crane and its intervals."""
        return self.ends + self.chain + CAPSULE_SIZE * self.count

    @property
    def row(self) -> int:
        """Numbers of a row."""
        return 2 + 2 * self.crane

    @property
    def entry(self) -> int:
        """Numbers of an entry of the queue."""
        return 2 + 2 * self.ends


class _PlacedPair(NamedTuple):
    """A capsule of each crane in the middle of their intervals.

    Attributes:
        indices: Indices of both capsules as they are in the queue.
        boxes: Ends of the intervals of both cranes, shape (2, 2, k + 1).
        capsules: Both capsules.
    """

    indices: np.ndarray
    boxes: np.ndarray
    capsules: tuple[Capsule, Capsule]


class _ProofEmitter:
    """Emits the code of the proof, see `proven_apart`.

    For each row all pairs of capsules that balls around what they sweep do not prove apart are put
    in a queue. Entries are taken from its head. If a bound does not prove one of them, its largest
    interval is halved, and both halves are appended; the row is proven when the queue is empty.
    """

    def __init__(self, code: Code, layout: _RowLayout) -> None:
        self._code = code
        self._layout = layout
        self._inputs = code.argument["given"]
        count = layout.count

        # A pair of capsules adds one entry. Each entry that is examined adds two at most, and no
        # more are examined than these pairs and `MAX_EXAMINED`.
        longest = 3 * count * count + 2 * MAX_EXAMINED
        self._balls = code.builder.alloca(DOUBLE, 2 * _BALL_SIZE * count)
        self._queue = code.builder.alloca(DOUBLE, layout.entry * longest)
        self._tail = code.builder.alloca(INTEGER)

    def emit(self) -> None:
        """Emit the proof for all rows."""
        code = self._code
        with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
            start = code.product(row, self._layout.row)
            required, self._cone = self._numbers(self._inputs, start, 2)
            self._offsets = [code.plus(start, 2), code.plus(start, 2 + self._layout.crane)]
            self._emit_balls()
            self._emit_queue(required)
            self._emit_search(row, required)
        code.end()

    def _numbers(self, pointer: ir.Value, first: ir.Value, size: int) -> np.ndarray:
        """Return so many numbers from an index on."""
        code = self._code
        return array([code.spread(pointer, code.plus(first, i)) for i in range(size)])

    def _put(self, pointer: ir.Value, first: ir.Value, values: Iterable[Any]) -> None:
        """Store numbers from an index on."""
        for i, value in enumerate(values):
            self._code.store(value, pointer, self._code.plus(first, i))

    def _length(self) -> ir.Value:
        """Return the number of entries that were put in the queue."""
        return self._code.builder.load(self._tail)

    def _placed(self, offset: ir.Value, which: ir.Value, box: np.ndarray) -> Capsule:
        """Return a capsule of the crane at an offset in the middle of its intervals."""
        code = self._code
        layout = self._layout
        crane = self._numbers(self._inputs, code.plus(offset, layout.ends), layout.chain)
        of_capsules = code.plus(offset, layout.ends + layout.chain)
        first = code.builder.add(of_capsules, code.product(which, CAPSULE_SIZE))
        capsule = self._numbers(self._inputs, first, CAPSULE_SIZE)
        plumb = array([0.0, 0.0, -1.0])
        return capsules.place(crane, capsule, box[0], box[1], self._cone, plumb)

    def _emit_balls(self) -> None:
        """Emit a ball around all that each capsule of both cranes sweeps in the intervals."""
        code = self._code
        count = self._layout.count
        for i, offset in enumerate(self._offsets):
            with code.loop(0, count) as which:
                box = self._numbers(self._inputs, offset, self._layout.ends).reshape(2, -1)
                capsule = self._placed(offset, which, box)
                half = 0.5 * (capsule.ends[1] - capsule.ends[0])
                no_direction = array([0.0, 0.0, 0.0])
                shifts = capsules.shifts(capsule, box[0], box[1], no_direction)
                swept = _sum(shifts.in_any_direction)
                radius = capsule.radius + square_root(half @ half) + swept
                ball = [*(capsule.ends[0] + half), radius]
                begin = code.product(code.plus(which, i * count), _BALL_SIZE)
                self._put(self._balls, begin, ball)

    def _emit_queue(self, required: Any) -> None:
        """Emit what puts all pairs in the queue whose balls are nearer than required."""
        code = self._code
        build = code.builder
        count = self._layout.count
        build.store(code.integer(0), self._tail)
        with code.loop(0, count) as a, code.loop(0, count) as b:
            # The balls of the second crane come after those of the first.
            b_ball = code.plus(b, count)
            one = self._numbers(self._balls, code.product(a, _BALL_SIZE), _BALL_SIZE)
            other = self._numbers(self._balls, code.product(b_ball, _BALL_SIZE), _BALL_SIZE)
            delta = one[:3] - other[:3]
            near = one[3] + other[3] + required
            # Written so that NaN is looked at, and fails later.
            with code.when(build.not_(delta @ delta >= near * near)):
                entry: list[Any] = []
                for offset in self._offsets:
                    entry.extend(self._numbers(self._inputs, offset, self._layout.ends))
                begin = code.product(self._length(), self._layout.entry)
                indices = [code.from_integer(a), code.from_integer(b)]
                self._put(self._queue, begin, [*indices, *entry])
                build.store(code.plus(self._length(), 1), self._tail)

    def _emit_search(self, row: ir.Value, required: Any) -> None:
        """Emit the search through the queue, which proves a row or gives it up."""
        code = self._code
        build = code.builder
        limit = code.plus(self._length(), MAX_EXAMINED)
        code.store(1.0, code.argument["answers"], row)

        # The length is read again in each turn: entries are appended.
        with code.loop(0, self._length) as head:
            pair = self._pair_in_queue(head)
            first, second = pair.capsules
            radii = first.radius + second.radius
            separation = capsules.separation(first.ends, second.ends, radii)
            moves = []
            for capsule, box in zip(pair.capsules, pair.boxes, strict=True):
                shifts = capsules.shifts(capsule, box[0], box[1], separation.normal)
                moves.extend(shifts.along_normal)
            total = _sum(moves)
            with code.when(build.not_(separation.lower_bound - total >= required)):
                # Where they are too near in the middle of the intervals, no halving helps.
                late = build.icmp_signed(">=", head, limit)
                fails = code.either(build.not_(separation.upper_bound >= required), late)

                # The halves are appended in any case, since choosing a length takes no branch. A
                # proof that fails sets the length to zero: a queue without entries behind the head
                # ends the loop.
                self._append_halves(pair, moves)
                after = code.plus(self._length(), 2)
                build.store(build.select(fails, code.integer(0), after), self._tail)
                with code.when(fails):
                    code.store(0.0, code.argument["answers"], row)

    def _pair_in_queue(self, head: ir.Value) -> _PlacedPair:
        """Return an entry of the queue with its capsules in their places."""
        code = self._code
        size = self._layout.entry
        entry = self._numbers(self._queue, code.product(head, size), size)
        boxes = entry[2:].reshape(2, 2, -1)
        placed = []
        for crane, offset in enumerate(self._offsets):
            which = code.builder.fptosi(entry[crane].register, INTEGER)
            placed.append(self._placed(offset, which, boxes[crane]))
        return _PlacedPair(entry[:2], boxes, (placed[0], placed[1]))

    def _append_halves(self, pair: _PlacedPair, moves: list[Any]) -> None:
        """Put both halves of an entry behind the tail, its interval with the largest shift halved.

        Which interval that is, is only known when the code runs. So all ends are computed, and a
        flag chooses the one that changes, the first of those that are equal.

        Args:
            pair: The entry.
            moves: Shifts by all joints of both cranes [m].
        """
        code = self._code
        largest = moves[0]
        for move in moves[1:]:
            largest = larger(largest, move)
        for upper in (0, 1):
            half = pair.boxes.copy()
            not_yet_halved: Any = 1.0
            for i, move in enumerate(moves):
                crane, joint = divmod(i, self._layout.joints)
                is_halved = not_yet_halved * indicator(move >= largest, move)
                not_yet_halved = not_yet_halved - is_halved
                low, high = pair.boxes[crane, :, joint]
                # The lower half ends in the middle, the upper half begins there.
                shift = (0.5 - upper) * is_halved
                half[crane, 1 - upper, joint] += shift * (low - high)
            begin = code.product(code.plus(self._length(), upper), self._layout.entry)
            self._put(self._queue, begin, [*pair.indices, *half.flat])


def _sum(values: list[Any]) -> Any:
    """Return the sum of numbers of any kind, without the zero with which `sum` begins."""
    total = values[0]
    for value in values[1:]:
        total = total + value
    return total
