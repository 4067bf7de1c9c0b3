"""Proof that cranes keep a distance wherever they are in intervals of their positions: branch and
bound over products of intervals, compiled.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.code import DOUBLE, INTEGER, POINTER, Code
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.scalars import array
from cranedyn.sites import capsules
from cranedyn.sites.bodies import CraneBodies
from cranedyn.sites.capsules import CAPSULE, JOINT, Capsule, separation

ROUNDING = 1e-6
"""Deduction from every distance [m]: a thousand times the rounding errors of a site of 1e5 m."""

FINEST = 0.05
"""Motion of a capsule [m] below which intervals are not halved again: a pair that is closer to the
required distance than this is not proven."""

MOST = 800
"""Pairs of capsules with halved intervals that are examined before the proof of a pair of cranes
fails."""


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

    Args:
        bodies: The cranes, `stacked`.
        first: Indices of the cranes, shape (N,).
        first_box: Ends of their intervals, shape (N, 2, k + 1), the cable length last.
        second: Indices of the others, shape (N,).
        second_box: Ends of theirs.
        distance: Required distance [m].
        swing: Largest angle of the ropes from plumb [rad].
    """
    numbers = np.array([[distance + ROUNDING, 2.0 * math.sin(swing / 2.0)]]).repeat(len(first), 0)
    sides = [(first, first_box), (second, second_box)]
    blocks = [
        block
        for which, box in sides
        for block in (box.reshape(len(which), -1), bodies.numbers[which])
    ]
    prove = _compiled(bodies.axis.shape[1], bodies.radius.shape[1])
    return prove(np.hstack([numbers, *blocks]))[:, 0] > 0.0


@cache
def _compiled(joints: int, count: int) -> RowFunction:
    module = ir.Module()
    _emit(Code(module, "rows", ["given", "count", "answers"], 1), joints, count)
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
    given, build, width = code.argument["given"], code.builder, 2 + 2 * _side(joints, count)
    item = 2 + 4 * joints
    balls, queue = (
        build.bitcast(build.alloca(DOUBLE, size), POINTER)
        for size in (8 * count, item * (3 * count * count + 2 * MOST))
    )
    tail = build.bitcast(build.alloca(INTEGER), POINTER)

    def numbers(pointer: ir.Value, first: ir.Value, size: int) -> np.ndarray:
        return array([code.spread(pointer, code.plus(first, i)) for i in range(size)])

    def put(pointer: ir.Value, first: ir.Value, values: Iterable[Any]) -> None:
        for i, value in enumerate(values):
            code.store(value, pointer, code.plus(first, i))

    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        start = code.product(row, width)
        required, cone = numbers(given, start, 2)
        places = [code.plus(start, 2 + i * _side(joints, count)) for i in (0, 1)]

        def crane(side: int, which: ir.Value, middle: np.ndarray) -> Capsule:
            """Return a capsule of a crane by its number."""
            first = code.plus(places[side], 2 * (joints + 1))
            own = code.plus(first, 12 + JOINT * joints)
            return capsules.place(
                numbers(given, first, 12),
                numbers(given, code.plus(first, 12), JOINT * joints).reshape(joints, JOINT),
                numbers(given, build.add(own, code.product(which, CAPSULE)), CAPSULE),
                middle,
                numbers(given, places[side], 2 * (joints + 1))[joints :: joints + 1],
                cone,
                array([0.0, 0.0, -1.0]),
            )

        for side in (0, 1):
            with code.loop(0, count) as which:
                low, high = numbers(given, places[side], 2 * (joints + 1)).reshape(2, -1)[:, :-1]
                capsule = crane(side, which, (low + high) * 0.5)
                ball = (
                    *((capsule.ends[0] + capsule.ends[1]) * 0.5),
                    capsules.reach(capsule, (high - low) * 0.5),
                )
                put(balls, code.product(code.plus(which, side * count), 4), ball)
        build.store(code.integer(0), tail)
        with code.loop(0, count) as a, code.loop(0, count) as b:
            of_a, of_b = (numbers(balls, code.product(i, 4), 4) for i in (a, code.plus(b, count)))
            way = of_a[:3] - of_b[:3]
            near = of_a[3] + of_b[3] + required
            with code.when(way @ way < near * near):
                end = code.load_one(tail, 0, INTEGER)
                boxes = [numbers(given, place, 2 * (joints + 1)).reshape(2, -1) for place in places]
                ends = [x for box in boxes for x in box[:, :-1].flat]
                put(queue, code.product(end, item), [*map(code.from_integer, (a, b)), *ends])
                build.store(code.plus(end, 1), tail)
        initial = code.load_one(tail, 0, INTEGER)
        code.store(1.0, code.argument["answers"], row)
        with code.loop(0, lambda: code.load_one(tail, 0, INTEGER)) as head:
            entry = numbers(queue, code.product(head, item), item)
            low, high = entry[2:].reshape(2, 2, joints).transpose(1, 0, 2)
            half = (high - low) * 0.5
            a, b = (
                crane(i, build.fptosi(entry[i].register, INTEGER), low[i] + half[i]) for i in (0, 1)
            )
            least, normal, gap = separation(a, b)
            moves = [
                move
                for side in (0, 1)
                for move in capsules.shifts((a, b)[side], half[side], normal)
            ]
            total = sum(moves[1:], moves[0])
            with code.when(least - total < required):
                fails = code.either(gap < required, total < FINEST)
                examined = build.sub(head, initial)
                fails = code.either(fails, build.icmp_signed(">=", examined, code.integer(MOST)))
                end = code.load_one(tail, 0, INTEGER)
                largest = moves[0]
                for move in moves[1:]:
                    largest = code.call("llvm.maxnum", largest, move)
                for part in (0, 1):
                    ends = [low.copy(), high.copy()]
                    free = 1.0
                    for i, move in enumerate(moves):
                        side, joint = divmod(i, joints)
                        cut = code.chosen(move >= largest, free, 0.0)
                        free = free - cut
                        middle = low[side, joint] + half[side, joint]
                        old = ends[1 - part][side, joint]
                        ends[1 - part][side, joint] = code.chosen(cut > 0.5, middle, old)
                    put(
                        queue,
                        code.product(code.plus(end, part), item),
                        [*entry[:2], *np.array(ends).transpose(1, 0, 2).flat],
                    )
                build.store(build.select(fails, code.integer(0), code.plus(end, 2)), tail)
                with code.when(fails):
                    code.store(0.0, code.argument["answers"], row)
    code.end()
