"""Proof that cranes keep a distance wherever they are in intervals of their positions: branch and
bound over products of intervals.
"""

from __future__ import annotations

import numpy as np

from cranedyn.sites.bodies import CraneBodies, PlacedCapsules, place_capsules

ROUNDING = 1e-6
"""Deduction from every distance [m]: a thousand times the rounding errors of a site of 1e5 m."""

FINEST = 0.05
"""Motion of a capsule [m] below which intervals are not halved again: a pair that is closer to the
required distance than this is not proven."""

_MOST = 800
"""Pairs of capsules that are examined before the proof fails."""


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
    apart = np.ones(len(first), dtype=bool)
    required = distance + ROUNDING
    pair, *work = _close_pairs(bodies, first, first_box, second, second_box, required, swing)
    examined = 0
    while len(pair):
        examined += len(pair)
        a, ca, box_a, b, cb, box_b = work
        placed = (
            place_capsules(bodies, a, ca, box_a[:, 0], box_a[:, 1], swing),
            place_capsules(bodies, b, cb, box_b[:, 0], box_b[:, 1], swing),
        )
        separation, normal, gap = separations(*placed)
        turns = bodies.revolute[a], bodies.revolute[b]
        halves = tuple((box[:, 1, :-1] - box[:, 0, :-1]) / 2.0 for box in (box_a, box_b))
        shifts = np.concatenate(
            [_shifts(placed[i], turns[i], halves[i], normal) for i in (0, 1)], axis=1
        )
        total = shifts.sum(axis=1)
        open_ = separation - total < required
        hopeless = open_ & ((gap < required) | (total < FINEST))
        apart[pair[hopeless]] = False
        if examined > _MOST:
            apart[pair[open_]] = False
        keep = open_ & apart[pair]
        pair, work = _halved(pair[keep], [item[keep] for item in work], shifts[keep])
    return apart


def _close_pairs(
    bodies: CraneBodies,
    first: np.ndarray,
    first_box: np.ndarray,
    second: np.ndarray,
    second_box: np.ndarray,
    required: float,
    swing: float,
) -> list[np.ndarray]:
    """Return those pairs of capsules that balls around all that they sweep do not prove apart: pair
    of cranes, crane, capsule and box of the first, and of the second.
    """
    capsules = bodies.radius.shape[1]
    balls = []
    for which, box in ((first, first_box), (second, second_box)):
        crane, capsule = which.repeat(capsules), np.tile(np.arange(capsules), len(which))
        boxes = box.repeat(capsules, axis=0)
        placed = place_capsules(bodies, crane, capsule, boxes[:, 0], boxes[:, 1], swing)
        half = (boxes[:, 1, :-1] - boxes[:, 0, :-1]) / 2.0
        reach = placed.radius + motion_bound(placed, bodies.revolute[crane], half)
        reach += np.linalg.norm(placed.ends[:, 1] - placed.ends[:, 0], axis=1) / 2.0
        shape = len(which), capsules
        balls.append((placed.ends.mean(axis=1).reshape(*shape, 3), reach.reshape(shape)))
    (centre_a, reach_a), (centre_b, reach_b) = balls
    gap = np.linalg.norm(centre_a[:, :, None] - centre_b[:, None], axis=3)
    near = gap - reach_a[:, :, None] - reach_b[:, None] < required
    pair, ca, cb = np.nonzero(near)
    return [pair, first[pair], ca, first_box[pair], second[pair], cb, second_box[pair]]


def _halved(
    pair: np.ndarray, work: list[np.ndarray], shifts: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return twice as many pairs of capsules, each with one interval halved."""
    count, k = len(pair), shifts.shape[1] // 2
    widest, rows = shifts.argmax(axis=1), np.arange(count)
    parts = []
    for upper in (False, True):
        part = list(work)
        for i, of_crane in ((2, widest < k), (5, widest >= k)):
            box, mine, drive = work[i].copy(), rows[of_crane], widest[of_crane] % k
            box[mine, 1 - upper, drive] = work[i][mine][:, :, drive].mean(axis=1)[
                np.arange(len(mine)), np.arange(len(mine))
            ]
            part[i] = box
        parts.append(part)
    doubled = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return np.concatenate([pair, pair]), doubled


def separations(a: PlacedCapsules, b: PlacedCapsules) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return separation [m], shape (N,), unit vector from the second to the first, shape (N, 3),
    and an upper bound of the distance [m], shape (N,), of N pairs of capsules.

    The separation is a lower bound of the distance whatever the unit vector is; along the
    shortest connection of both segments it is the distance.
    """
    first, second = a.ends, b.ends
    along_a, along_b = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    offset = first[:, 0] - second[:, 0]
    aa, bb = (np.maximum((u * u).sum(1), 1e-12) for u in (along_a, along_b))
    ab, ao, bo = (along_a * along_b).sum(1), (along_a * offset).sum(1), (along_b * offset).sum(1)
    parallel = np.maximum(aa * bb - ab * ab, 1e-12 * aa * bb)
    s = np.clip((ab * bo - ao * bb) / parallel, 0.0, 1.0)
    t = np.clip((ab * s + bo) / bb, 0.0, 1.0)
    s = np.clip((ab * t - ao) / aa, 0.0, 1.0)
    connection = offset + s[:, None] * along_a - t[:, None] * along_b
    length = np.sqrt((connection * connection).sum(1))
    normal = connection / np.maximum(length, 1e-12)[:, None]
    low = (first @ normal[:, :, None])[:, :, 0].min(axis=1)
    high = (second @ normal[:, :, None])[:, :, 0].max(axis=1)
    radii = a.radius + b.radius
    return low - high - radii, normal, length - radii


def _levers(placed: PlacedCapsules) -> np.ndarray:
    """Return u × (x - o) of each joint and moving point [m], shape (N, k, 2, 3)."""
    offset = placed.moving[:, None] - placed.origin[:, :, None]
    u = placed.axis[:, :, None]
    return np.stack(
        [
            u[..., 1] * offset[..., 2] - u[..., 2] * offset[..., 1],
            u[..., 2] * offset[..., 0] - u[..., 0] * offset[..., 2],
            u[..., 0] * offset[..., 1] - u[..., 1] * offset[..., 0],
        ],
        axis=-1,
    )


def motion_bound(placed: PlacedCapsules, turns: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return an upper bound of the shift of any point in any direction [m], shape (N,)."""
    radius = np.sqrt((_levers(placed) ** 2).sum(3)).max(axis=2)
    total = np.zeros(len(half))
    for k in reversed(range(half.shape[1])):
        lever = np.where(turns[:, k], radius[:, k] + total, 1.0)
        total = total + placed.lever[:, k] * half[:, k] * lever
    return total


def _shifts(
    placed: PlacedCapsules, turns: np.ndarray, half: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Return upper bounds of the shift of any point along a normal by each joint [m], shape (N, k),
    see `proven_apart`.
    """
    tangents = _levers(placed)
    radius = np.sqrt((tangents**2).sum(3)).max(axis=2)
    first = np.abs(tangents @ normal[:, None, :, None])[..., 0].max(axis=2)
    sliding = np.abs((placed.axis * normal[:, None]).sum(2))
    shifts, beyond = np.zeros_like(half), np.zeros(len(half))
    for k in reversed(range(half.shape[1])):
        h = half[:, k] * placed.lever[:, k]
        turned = h * (first[:, k] + beyond) + h * h / 2.0 * radius[:, k]
        shifts[:, k] = np.where(turns[:, k], turned, h * sliding[:, k])
        beyond = beyond + h * np.where(turns[:, k], radius[:, k] + beyond, 1.0)
    return shifts
