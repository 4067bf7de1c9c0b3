"""Where a capsule of a crane is, how far its joints shift it, and how far it is from another.

Written once for floats and values of compiled code, see `cranedyn.dynamics.scalars`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.dynamics.scalars import (
    array,
    chosen,
    clipped,
    cross_product,
    flag,
    larger,
    magnitude,
    smaller,
    square_root,
)

JOINT = 16
"""Numbers of a joint in the tables of compiled code."""

CAPSULE = 15
"""Numbers of a capsule there."""


class Capsule(NamedTuple):
    """A capsule in the frame of the site.

    Attributes:
        ends: Ends of its segment [m], shape (2, 3).
        radius: Its radius, with the swing of rope and load [m].
        turns: 1 for each joint that turns it, else 0, shape (k,).
        slides: Axis of each joint along which it slides, else 0, shape (k, 3).
        tangents: u × (x - o) for each joint that turns it about u through o, with the ends x
            without their depth below the pivot [m], else 0, shape (k, 2, 3).
    """

    ends: np.ndarray
    radius: Any
    turns: np.ndarray
    slides: np.ndarray
    tangents: np.ndarray


def place(
    crane: np.ndarray, capsule: np.ndarray, low: np.ndarray, high: np.ndarray, cone: Any, rope: Any
) -> Capsule:
    """Return a capsule in the middle of intervals of positions.

    Args:
        crane: Rotation and translation of the foot; rotation, translation, local axis, and whether
            it turns, of each joint; shape (12 + k `JOINT`,).
        capsule: Number of its joints, ends, depths, whether it hangs, and radius, shape
            (`CAPSULE`,).
        low: Lower ends of the intervals [rad or m], shape (k + 1,), the cable length last; rope
            and load are swept over all lengths.
        high: Upper ends.
        cone: Way of a point on the rope by the largest swing, over its depth.
        rope: Direction of the rope, shape (3,).
    """
    foot = crane[:12].reshape(3, 4)
    joints = crane[12:].reshape(-1, JOINT)
    middle = low + high
    frame = (foot[:, :3], foot[:, 3])
    chain = []
    for k, (rotation, point, axis, origin) in enumerate(_links(foot, joints, 0.5 * middle[:-1])):
        moves = capsule[0] > float(k)
        frame = (_where(moves, rotation, frame[0]), _where(moves, point, frame[1]))
        turns = flag(moves, capsule[0]) * joints[k, 15]
        chain.append((turns, axis * (flag(moves, capsule[0]) - turns), axis, origin))
    moving = [frame[0] @ end + frame[1] for end in capsule[1:7].reshape(2, 3)]
    depths = [
        smaller(high[-1] + shortest * (low[-1] - high[-1]), longest) + length
        for shortest, longest, length in capsule[7:13].reshape(2, 3)
    ]
    return Capsule(
        ends=np.array([x + rope * depth for x, depth in zip(moving, depths, strict=True)]),
        radius=capsule[14] + capsule[13] * cone * (depths[1] + capsule[14]),
        turns=array([turns for turns, *_ in chain]),
        slides=np.array([slide for _, slide, *_ in chain]),
        tangents=np.array(
            [[cross_product(u * turns, x - o) for x in moving] for turns, _, u, o in chain]
        ),
    )


def rope_pose(
    crane: np.ndarray, position: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pivot of a rope [m], shape (3,), its direction, shape (3,), and the motion of the
    pivot by each joint [m/rad or m/m], shape (k, 3).

    Args:
        crane: Numbers of the foot and of k + 2 joints as in `place`, and the direction of the rope
            behind the last, shape (15 + (k + 2) `JOINT`,).
        position: Of k joints [rad or m], shape (k,).
        angles: Of the swing joints [rad], shape (2,).
    """
    foot = crane[:12].reshape(3, 4)
    joints = crane[12:-3].reshape(-1, JOINT)
    chain = [*_links(foot, joints, [*position, *angles])]
    pivot = chain[len(position)][3]
    motion = []
    for joint, (_, _, axis, origin) in zip(joints, chain[: len(position)], strict=False):
        motion.append(axis * (1.0 - joint[15]) + cross_product(axis * joint[15], pivot - origin))
    return pivot, chain[-1][0] @ crane[-3:], np.array(motion)


def pivot_motions(crane: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[Any]:
    """Return upper bounds of the motion of a pivot by each of k joints [m/rad or m/m], wherever in
    intervals they stand, see `rope_pose`.

    A joint that turns moves the pivot by no more than in the middle of the box and by how far the
    joints beyond it can shift the pivot from there.

    Args:
        crane: As in `rope_pose`.
        low: Lower ends of the intervals [rad or m], shape (k,).
        high: Upper ends.
    """
    _, _, motion = rope_pose(crane, 0.5 * (low + high), array([0.0, 0.0]))
    reaches = []
    beyond = 0.0
    for k in reversed(range(len(low))):
        turns = crane[12 + JOINT * (k + 1) - 1]
        reaches.append(square_root(motion[k] @ motion[k]) + turns * beyond)
        beyond = beyond + 0.5 * (high[k] - low[k]) * reaches[-1]
    return reaches[::-1]


def _links(
    foot: np.ndarray, joints: np.ndarray, position: Sequence[Any]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield for each joint rotation and origin of its link, its axis and its own origin."""
    rotation = foot[:, :3]
    point = foot[:, 3]
    for joint, value in zip(joints, position, strict=True):
        origin = point + rotation @ joint[9:12]
        rotation = rotation @ joint[:9].reshape(3, 3)
        angle = joint[15] * value
        axis = rotation @ joint[12:15]
        point = origin + axis * (value - angle)
        rotation = rotation @ _rotation(joint[12:15], angle)
        yield rotation, point, axis, origin


def shifts(
    capsule: Capsule, low: np.ndarray, high: np.ndarray, normal: np.ndarray
) -> tuple[list[Any], list[Any]]:
    """Return upper bounds of the shift of any point [m] by each joint from the middle of its
    interval, along a unit vector, see `cranedyn.lifts.sites.distance_proof`, and in any direction,
    k numbers each.
    """
    along = []
    ways = []
    beyond = 0.0
    for k in reversed(range(len(capsule.turns))):
        h = 0.5 * (high[k] - low[k])
        slide = capsule.slides[k]
        tangents = capsule.tangents[k]
        lever = square_root(larger(*(x @ x for x in tangents)))
        first = larger(*(magnitude(x @ normal) for x in tangents)) + magnitude(slide @ normal)
        turned = capsule.turns[k] * beyond
        along.append(h * (first + turned + 0.5 * h * lever))
        ways.append(h * (lever + turned + square_root(slide @ slide)))
        beyond = beyond + ways[-1]
    return along[::-1], ways[::-1]


def separation(first: np.ndarray, second: np.ndarray, radii: Any) -> tuple[Any, np.ndarray, Any]:
    """Return separation [m], unit vector from the second to the first, shape (3,), and an upper
    bound of the distance [m] of two capsules, from their ends [m], shape (2, 3) each, and the sum
    of their radii [m].

    The separation is a lower bound of the distance whatever the unit vector is; along the
    shortest connection of both segments it is the distance.
    """
    a, b, offset = first[1] - first[0], second[1] - second[0], first[0] - second[0]
    aa, bb, ab, ao, bo = a @ a + 1e-12, b @ b + 1e-12, a @ b, a @ offset, b @ offset
    square = aa * bb
    determinant = square - ab * ab
    parallel = chosen(determinant > 1e-12 * square, determinant, 1e-12 * square)
    s = clipped((ab * bo - ao * bb) / parallel, 0.0, 1.0)
    t = clipped((ab * s + bo) / bb, 0.0, 1.0)
    s = clipped((ab * t - ao) / aa, 0.0, 1.0)
    connection = offset + a * s - b * t
    length = square_root(connection @ connection)
    normal = connection * (1.0 / (length + 1e-12))
    low = -larger(*(-(x @ normal) for x in first))
    return low - larger(*(x @ normal for x in second)) - radii, normal, length - radii


def _where(condition: Any, yes: np.ndarray, no: np.ndarray) -> np.ndarray:
    numbers = [chosen(condition, a, b) for a, b in zip(yes.flat, no.flat, strict=True)]
    return array(numbers).reshape(yes.shape)


def _rotation(axis: np.ndarray, angle: Any) -> np.ndarray:
    """Return the rotation about a unit axis by an angle [rad], after Rodrigues."""
    x, y, z = axis
    cross = array([0.0, -z, y, z, 0.0, -x, -y, x, 0.0]).reshape(3, 3)
    return np.eye(3) + cross * np.sin(angle) + cross @ cross * (1.0 - np.cos(angle))
