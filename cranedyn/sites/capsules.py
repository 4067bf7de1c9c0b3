"""Where a capsule of a crane is, how far its joints shift it, and how far it is from another.

Written once for any kind of number, see `cranedyn.dynamics.scalars`: arrays of many rows, and
values of compiled code. Vectors are arrays of three such numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.dynamics.scalars import (
    array,
    chosen,
    clipped,
    cross_product,
    flag,
    magnitude,
    square_root,
)

JOINT, CAPSULE = 16, 15
"""Numbers of a joint and of a capsule."""


class Capsule(NamedTuple):
    """A capsule in the frame of the site.

    Attributes:
        ends: Ends of its segment [m], shape (2, 3).
        radius: Its radius, with the swing of what hangs [m].
        turns: 1 for each joint that turns, else 0, shape (k,).
        levers: 1 for each joint that moves the capsule, else 0, shape (k,).
        axes: Axis u of each joint, shape (k, 3).
        tangents: u × (x - o) for each joint with the origin o and the ends x without the depth
            below the pivot [m], shape (k, 2, 3).
    """

    ends: np.ndarray
    radius: Any
    turns: np.ndarray
    levers: np.ndarray
    axes: np.ndarray
    tangents: np.ndarray


def place(
    foot: np.ndarray,
    joints: np.ndarray,
    capsule: np.ndarray,
    middle: np.ndarray,
    cable: np.ndarray,
    cone: Any,
    rope: np.ndarray,
) -> Capsule:
    """Return a capsule with the joints at a position.

    Args:
        foot: Rotation and translation of the foot, shape (12,).
        joints: Rotation, translation, local axis and whether it turns, of each joint, shape (k,
            `JOINT`).
        capsule: Number of its joints, ends, depths, whether it hangs, and radius, shape
            (`CAPSULE`,).
        middle: Position of the joints [rad or m], shape (k,).
        cable: Shortest and longest cable [m], shape (2,).
        cone: Way of a point on the rope by the largest swing, over its depth.
        rope: Direction of the rope, shape (3,).
    """
    foot = foot.reshape(3, 4)
    rotation, point = foot[:, :3], foot[:, 3]
    frame, origins, axes = (rotation, point), [], []
    for k, (joint, position) in enumerate(zip(joints, middle, strict=True)):
        point = point + rotation @ joint[9:12]
        rotation = rotation @ joint[:9].reshape(3, 3)
        local, angle = joint[12:15], joint[15] * position
        axes.append(rotation @ local)
        origins.append(point)
        point = point + _scaled(axes[-1], position - angle)
        rotation = rotation @ _rotation(local, angle)
        behind = capsule[0] > float(k)
        frame = (_where(behind, rotation, frame[0]), _where(behind, point, frame[1]))
    moving = [frame[0] @ end + frame[1] for end in capsule[1:7].reshape(2, 3)]
    depths = [
        share[0] * cable[0] + share[1] * cable[1] + share[2]
        for share in capsule[7:13].reshape(2, 3)
    ]
    radius = capsule[14] + capsule[13] * cone * (depths[1] + capsule[14])
    return Capsule(
        ends=np.array([p + _scaled(rope, d) for p, d in zip(moving, depths, strict=True)]),
        radius=radius,
        turns=joints[:, 15],
        levers=array([flag(capsule[0] > float(k), capsule[0]) for k in range(len(joints))]),
        axes=np.array(axes),
        tangents=np.array(
            [[cross_product(u, x - o) for x in moving] for u, o in zip(axes, origins, strict=True)]
        ),
    )


def shifts(capsule: Capsule, half: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return upper bounds of the shift of any point along a unit vector [m] by each joint within
    half its interval, shape (k,), see `cranedyn.sites.proof`.
    """
    bounds, beyond = np.empty_like(half), 0.0
    for k in reversed(range(len(half))):
        h, turns, lever = half[k] * capsule.levers[k], capsule.turns[k], _lever(capsule, k)
        first = _largest([magnitude(x @ normal) for x in capsule.tangents[k]])
        bounds[k] = h * (
            turns * (first + beyond + 0.5 * h * lever)
            + (1.0 - turns) * magnitude(capsule.axes[k] @ normal)
        )
        beyond = beyond + _way(turns, h, lever, beyond)
    return bounds


def reach(capsule: Capsule, half: np.ndarray) -> Any:
    """Return the radius of a ball about the middle of a capsule that holds all that it sweeps with
    each joint within half its interval [m].
    """
    total = 0.0
    for k in reversed(range(len(half))):
        h = half[k] * capsule.levers[k]
        total = total + _way(capsule.turns[k], h, _lever(capsule, k), total)
    along = capsule.ends[1] - capsule.ends[0]
    return capsule.radius + 0.5 * square_root(along @ along) + total


def separation(first: Any, second: Any) -> tuple[Any, np.ndarray, Any]:
    """Return separation [m], unit vector from the second to the first, shape (3,), and an upper
    bound of the distance [m] of two capsules.

    The separation is a lower bound of the distance whatever the unit vector is; along the
    shortest connection of both segments it is the distance.
    """
    a, b = first.ends[1] - first.ends[0], second.ends[1] - second.ends[0]
    offset = first.ends[0] - second.ends[0]
    aa, bb, ab, ao, bo = a @ a + 1e-12, b @ b + 1e-12, a @ b, a @ offset, b @ offset
    square = aa * bb
    determinant = square - ab * ab
    parallel = chosen(determinant > 1e-12 * square, determinant, 1e-12 * square)
    s = clipped((ab * bo - ao * bb) / parallel, 0.0, 1.0)
    t = clipped((ab * s + bo) / bb, 0.0, 1.0)
    s = clipped((ab * t - ao) / aa, 0.0, 1.0)
    connection = offset + _scaled(a, s) - _scaled(b, t)
    length = square_root(connection @ connection)
    normal = _scaled(connection, 1.0 / (length + 1e-12))
    ends = [[x @ normal for x in capsule.ends] for capsule in (first, second)]
    radii = first.radius + second.radius
    low = -_largest([-x for x in ends[0]])
    return low - _largest(ends[1]) - radii, normal, length - radii


def _way(turns: Any, h: Any, lever: Any, beyond: Any) -> Any:
    """Return the way of a point by a joint [m], with the way by the joints beyond it."""
    return h * (turns * (lever + beyond) + (1.0 - turns))


def _lever(capsule: Capsule, joint: int) -> Any:
    return square_root(_largest([x @ x for x in capsule.tangents[joint]]))


def _largest(numbers: Sequence[Any]) -> Any:
    a, b = numbers
    return chosen(a > b, a, b)


def _scaled(vector: np.ndarray, number: Any) -> np.ndarray:
    return array([x * number for x in vector])


def _where(condition: Any, yes: np.ndarray, no: np.ndarray) -> np.ndarray:
    numbers = [chosen(condition, a, b) for a, b in zip(yes.flat, no.flat, strict=True)]
    return array(numbers).reshape(yes.shape)


def _rotation(axis: np.ndarray, angle: Any) -> np.ndarray:
    """Return the rotation about a unit axis by an angle [rad], after Rodrigues."""
    x, y, z = axis
    cross = array([0.0, -z, y, z, 0.0, -x, -y, x, 0.0]).reshape(3, 3)
    sine, rest = np.sin(angle), 1.0 - np.cos(angle)
    terms = [a * sine + b * rest for a, b in zip(cross.flat, (cross @ cross).flat, strict=True)]
    return np.eye(3).astype(object) + array(terms).reshape(3, 3)
