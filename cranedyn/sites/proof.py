"""Proof that cranes keep a distance wherever they are in intervals of their positions: branch and
bound over products of intervals, compiled.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache, reduce
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.code import DOUBLE, INTEGER, Code
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.scalars import array, flag, larger, smaller, square_root
from cranedyn.sites import capsules
from cranedyn.sites.bodies import CraneBodies, PlacedCapsules
from cranedyn.sites.capsules import CAPSULE, JOINT, Capsule

ROUNDING = 1e-6
"""Deduction from every distance [m]: a thousand times the rounding errors of a site of 1e5 m."""

MAX_POSITION = 1e9
"""Largest magnitude of a position of a drive about which anything is proven [rad or m]."""

MAX_SWING = math.pi / 2.0
"""Largest swing of a rope about which anything is proven [rad]."""

MOST = 100
"""Pairs of capsules with halved intervals that are examined before a proof fails."""


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

    In the middle of a box a unit vector n separates two capsules by s = min n·a - max n·b - r_a -
    r_b. Move the joints from the tip to the foot, each by half of its interval h at most: a joint
    that turns about u through o shifts a point x along n by no more than
    h |n·(u × (x - o))| + h S + h²/2 |u × (x - o)|, where S is the shift by the joints beyond it;
    one that slides by no more than h |n·u|. Where s less all shifts is at least the distance, all
    of the box is apart. Otherwise the interval with the largest shift is halved. Rope and load move
    with their pivot. False says nothing about the pair.

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
    numbers = np.array([[distance + ROUNDING, 2.0 * math.sin(swing / 2.0)]]).repeat(len(first), 0)
    sides = [(first, first_box), (second, second_box)]
    blocks = [
        block
        for which, box in sides
        for block in (box.reshape(len(which), -1), bodies.numbers[which])
    ]
    prove = _compiled(bodies.axis.shape[1], bodies.radius.shape[1])
    proven = prove(np.hstack([numbers, *blocks]))[:, 0] > 0.0
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
    count = len(a.ends)
    blocks = [
        np.dstack([x.ends.reshape(count, -1, 6), x.radius.reshape(count, -1)]).reshape(count, -1)
        for x in (a, b)
    ]
    rows = np.hstack(blocks)
    least = _least_separating(*(block.shape[1] // 7 for block in blocks))(rows)[:, 0]
    return np.where(np.isfinite(rows).all(axis=1), least, math.nan)


@cache
def _least_separating(first: int, second: int) -> RowFunction:
    module = ir.Module()
    code = Code(module, "rows", ["given", "count", "answers", "shared"], 1)
    inputs, width = code.argument["given"], 7 * (first + second)
    (least,) = code.variables([0.0])

    def capsule(start: ir.Value, which: ir.Value) -> np.ndarray:
        place = code.builder.add(start, code.product(which, 7))
        return array([code.spread(inputs, code.plus(place, i)) for i in range(7)])

    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        start = code.product(row, width)
        least.set(1e300)
        with code.loop(0, first) as a, code.loop(0, second) as b:
            one, other = capsule(start, a), capsule(start, code.plus(b, first))
            ends = [x[:6].reshape(2, 3) for x in (one, other)]
            gap = capsules.separation(ends[0], ends[1], one[6] + other[6])[2]
            least.set(smaller(gap, least.get()))
        code.store(least.get(), code.argument["answers"], row)
    code.end()
    return RowFunction(translate(module), "rows", width, 1)


@cache
def _compiled(joints: int, count: int) -> RowFunction:
    module = ir.Module()
    _emit(Code(module, "rows", ["given", "count", "answers", "shared"], 1), joints, count)
    return RowFunction(translate(module), "rows", 2 + 2 * _side(joints, count), 1)


def _side(joints: int, count: int) -> int:
    """Return the number of numbers of a crane and its box."""
    return 2 * (joints + 1) + 12 + JOINT * joints + CAPSULE * count


def _emit(code: Code, joints: int, count: int) -> None:
    """Emit the proof for rows.

    All pairs of capsules that balls around what they sweep do not prove apart are put in a queue:
    both capsules, lower and upper ends of the joints of both cranes. Of each one that a bound does
    not prove the halves are appended.
    """
    inputs, build, side = code.argument["given"], code.builder, _side(joints, count)
    ends, size = 2 * (joints + 1), 12 + JOINT * joints
    item = 2 + 2 * ends
    balls = build.alloca(DOUBLE, 8 * count)
    queue = build.alloca(DOUBLE, item * (3 * count * count + 2 * MOST))
    tail = build.alloca(INTEGER)

    def numbers(pointer: ir.Value, first: ir.Value, size: int) -> np.ndarray:
        return array([code.spread(pointer, code.plus(first, i)) for i in range(size)])

    def put(pointer: ir.Value, first: ir.Value, values: Iterable[Any]) -> None:
        for i, value in enumerate(values):
            code.store(value, pointer, code.plus(first, i))

    def length() -> ir.Value:
        return build.load(tail)

    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        start = code.product(row, 2 + 2 * side)
        required, cone = numbers(inputs, start, 2)
        offsets = [code.plus(start, 2), code.plus(start, 2 + side)]

        def placed(offset: ir.Value, which: ir.Value, box: np.ndarray) -> Capsule:
            crane = numbers(inputs, code.plus(offset, ends), size)
            first = build.add(code.plus(offset, ends + size), code.product(which, CAPSULE))
            capsule, plumb = numbers(inputs, first, CAPSULE), array([0.0, 0.0, -1.0])
            return capsules.place(crane, capsule, box[0], box[1], cone, plumb)

        for i, offset in enumerate(offsets):
            with code.loop(0, count) as which:
                box = numbers(inputs, offset, ends).reshape(2, -1)
                capsule = placed(offset, which, box)
                along = 0.5 * (capsule.ends[1] - capsule.ends[0])
                ways = capsules.shifts(capsule, box[0], box[1], array([0.0, 0.0, 0.0]))[1]
                reach = capsule.radius + square_root(along @ along) + sum(ways[1:], ways[0])
                ball = [*(capsule.ends[0] + along), reach]
                put(balls, code.product(code.plus(which, i * count), 4), ball)
        build.store(code.integer(0), tail)
        with code.loop(0, count) as a, code.loop(0, count) as b:
            one, other = (numbers(balls, code.product(i, 4), 4) for i in (a, code.plus(b, count)))
            delta, near = one[:3] - other[:3], one[3] + other[3] + required
            with code.when(build.not_(delta @ delta >= near * near)):
                crane_ends = [x for offset in offsets for x in numbers(inputs, offset, ends)]
                put(
                    queue,
                    code.product(length(), item),
                    [*map(code.from_integer, (a, b)), *crane_ends],
                )
                build.store(code.plus(length(), 1), tail)
        limit = code.plus(length(), MOST)
        code.store(1.0, code.argument["answers"], row)
        with code.loop(0, length) as head:
            entry = numbers(queue, code.product(head, item), item)
            boxes = entry[2:].reshape(2, 2, -1)
            pair = [
                placed(offsets[i], build.fptosi(entry[i].register, INTEGER), boxes[i])
                for i in (0, 1)
            ]
            radii = pair[0].radius + pair[1].radius
            apart, normal, gap = capsules.separation(pair[0].ends, pair[1].ends, radii)
            moves = [
                move
                for capsule, box in zip(pair, boxes, strict=True)
                for move in capsules.shifts(capsule, box[0], box[1], normal)[0]
            ]
            total = sum(moves[1:], moves[0])
            with code.when(build.not_(apart - total >= required)):
                late = build.icmp_signed(">=", head, limit)
                fails = code.either(build.not_(gap >= required), late)
                largest = reduce(larger, moves)
                for upper in (0, 1):
                    half, free = boxes.copy(), 1.0
                    for i, move in enumerate(moves):
                        crane, joint = divmod(i, joints)
                        cut = free * flag(move >= largest, move)
                        free, shift = free - cut, (0.5 - upper) * cut
                        low, high = boxes[crane, :, joint]
                        half[crane, 1 - upper, joint] += shift * (low - high)
                    put(
                        queue,
                        code.product(code.plus(length(), upper), item),
                        [*entry[:2], *half.flat],
                    )
                build.store(build.select(fails, code.integer(0), code.plus(length(), 2)), tail)
                with code.when(fails):
                    code.store(0.0, code.argument["answers"], row)
    code.end()
