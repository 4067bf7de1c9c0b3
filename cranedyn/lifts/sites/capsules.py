"""Where a capsule of a crane is, how far its joints shift it, and how far it is from another.

Written once for floats and values of compiled code, see `cranedyn.dynamics.scalars`. That is why
choices are made by `where` and `clipped`, and not by `if`.

Compiled code reads vectors of numbers. Their layout is known to `_JointNumbers` and
`_CapsuleNumbers`, which unpack them; `cranedyn.lifts.sites.placed_capsules` packs them in the order
of the same fields.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.dynamics.scalars import (
    array,
    clipped,
    cross_product,
    indicator,
    larger,
    magnitude,
    smaller,
    square_root,
    where,
)

FOOT_SIZE = 12
"""Numbers of the foot of a crane: its rotation and translation [R, p], row by row."""

JOINT_SIZE = 16
"""Numbers of a joint, see `_JointNumbers`."""

CAPSULE_SIZE = 15
"""Numbers of a capsule in the frame of its link, see `_CapsuleNumbers`."""

ROPE_DIRECTION_SIZE = 3
"""Numbers of the direction of the rope behind the last swing joint."""

_MIN_SQUARED_LENGTH = 1e-12
"""Added to the squared length of a segment [m²], so that a ball does not divide by zero."""

_MIN_LENGTH = 1e-12
"""Added to the length of a connection [m], so that touching segments do not divide by zero."""

_PARALLEL = 1e-12
"""Squared sine of the angle between two segments below which they count as parallel."""


class _JointNumbers(NamedTuple):
    """A joint as compiled code reads it.

    Attributes:
        rotation: Rotation from its frame to that of the link before it, shape (3, 3).
        translation: Origin of its frame in that of the link before it [m], shape (3,).
        axis: Its axis in its own frame, a unit vector, shape (3,); zero for a missing joint.
        turns: 1 if it turns about its axis, 0 if it slides along it.
    """

    rotation: np.ndarray
    translation: np.ndarray
    axis: np.ndarray
    turns: Any

    @classmethod
    def of(cls, numbers: np.ndarray) -> _JointNumbers:
        """Return a joint from its `JOINT_SIZE` numbers."""
        return cls(numbers[:9].reshape(3, 3), numbers[9:12], numbers[12:15], numbers[15])


class _CapsuleNumbers(NamedTuple):
    """A capsule in the frame of its link as compiled code reads it.

    Attributes:
        joint_count: Number of joints between the foot and its link.
        ends: Ends of its segment [m], shape (2, 3); of rope and load the pivot twice.
        depths: How far below the pivot these ends are, three numbers for each, shape (2, 3), see
            `_depth`.
        hangs: 1 if it hangs on the rope and swings with it, else 0.
        radius: Its radius without swing [m].
    """

    joint_count: Any
    ends: np.ndarray
    depths: np.ndarray
    hangs: Any
    radius: Any

    @classmethod
    def of(cls, numbers: np.ndarray) -> _CapsuleNumbers:
        """Return a capsule from its `CAPSULE_SIZE` numbers."""
        return cls(
            joint_count=numbers[0],
            ends=numbers[1:7].reshape(2, 3),
            depths=numbers[7:13].reshape(2, 3),
            hangs=numbers[13],
            radius=numbers[14],
        )


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


class RopePose(NamedTuple):
    """How the rope of a crane hangs.

    Attributes:
        pivot: The point from which it hangs [m], shape (3,).
        direction: Unit vector along the rope, from the pivot to the load, shape (3,).
        motion: Motion of the pivot by each of k joints [m/rad or m/m], shape (k, 3).
    """

    pivot: np.ndarray
    direction: np.ndarray
    motion: np.ndarray


class Shifts(NamedTuple):
    """Upper bounds of how far k joints shift any point of a capsule from the middle of their
    intervals.

    Attributes:
        along_normal: Shift along a unit vector, to either side, by each joint [m].
        in_any_direction: Shift in any direction by each joint [m].
    """

    along_normal: list[Any]
    in_any_direction: list[Any]


class Separation(NamedTuple):
    """How far two capsules are apart.

    Attributes:
        lower_bound: By how much a plane across the unit vector separates them [m]; negative where
            they overlap along it. It is a lower bound of the distance whatever the unit vector is.
        normal: Unit vector from the second to the first, shape (3,).
        upper_bound: Distance of two of their points [m]. It is equal to the lower bound, but for
            rounding, where the unit vector is along the shortest connection of both segments.
    """

    lower_bound: Any
    normal: np.ndarray
    upper_bound: Any


class _Link(NamedTuple):
    """A link of a crane in the frame of the site, and the joint before it.

    Attributes:
        rotation: Rotation of the link, shape (3, 3).
        origin: Origin of the link [m], shape (3,).
        axis: Axis of the joint, shape (3,).
        joint_origin: Origin of the joint [m], shape (3,); it differs from that of the link by the
            way that a joint slides.
    """

    rotation: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    joint_origin: np.ndarray


def place(
    crane: np.ndarray, capsule: np.ndarray, low: np.ndarray, high: np.ndarray, cone: Any, rope: Any
) -> Capsule:
    """Return a capsule in the middle of intervals of positions.

    Args:
        crane: Numbers of the foot and of k joints, shape (`FOOT_SIZE` + k `JOINT_SIZE`,).
        capsule: Numbers of the capsule, shape (`CAPSULE_SIZE`,).
        low: Lower ends of the intervals [rad or m], shape (k + 1,), the cable length last; rope
            and load are swept over all lengths.
        high: Upper ends.
        cone: How far a point of the rope moves in the largest swing, over its depth below the
            pivot.
        rope: Direction of the rope, shape (3,).
    """
    local = _CapsuleNumbers.of(capsule)
    foot = crane[:FOOT_SIZE].reshape(3, 4)
    joints = _joints(crane[FOOT_SIZE:])
    middle = low + high
    links = list(_links(foot, joints, 0.5 * middle[:-1]))

    # The link of the capsule is the last one that moves it. How many joints do is known only when
    # the code runs, so that all of them are looked at.
    rotation = foot[:, :3]
    origin = foot[:, 3]
    turns = []
    slides = []
    for k, (joint, link) in enumerate(zip(joints, links, strict=True)):
        is_moved = local.joint_count > float(k)
        rotation = _where(is_moved, link.rotation, rotation)
        origin = _where(is_moved, link.origin, origin)
        moved = indicator(is_moved, local.joint_count)
        turned = moved * joint.turns
        turns.append(turned)
        slides.append(link.axis * (moved - turned))

    attached_ends = [rotation @ end + origin for end in local.ends]
    depths = [_depth(depth, low[-1], high[-1]) for depth in local.depths]
    ends = []
    for attached, depth in zip(attached_ends, depths, strict=True):
        ends.append(attached + rope * depth)
    tangents = []
    for turned, link in zip(turns, links, strict=True):
        of_joint = []
        for attached in attached_ends:
            of_joint.append(cross_product(link.axis * turned, attached - link.joint_origin))
        tangents.append(of_joint)

    # What hangs swings about the pivot by up to `cone` times its depth: the lowest point, the lower
    # end and the cap below it, moves farthest.
    swing = local.hangs * cone * (depths[1] + local.radius)
    return Capsule(
        ends=np.array(ends),
        radius=local.radius + swing,
        turns=array(turns),
        slides=np.array(slides),
        tangents=np.array(tangents),
    )


def _depth(numbers: np.ndarray, shortest_cable: Any, longest_cable: Any) -> Any:
    """Return how far an end of a capsule is below the pivot [m].

    Args:
        numbers: 1 if it follows the end of the shortest cable, 0 for the longest; the depth [m]
            below which it does not follow it any more; and a length [m] that is added. All zero for
            what does not hang.
        shortest_cable: Lower end of the interval of the cable length [m].
        longest_cable: Its upper end [m].
    """
    follows_shortest, limit, added = numbers
    cable_end = longest_cable + follows_shortest * (shortest_cable - longest_cable)
    return smaller(cable_end, limit) + added


def rope_pose(crane: np.ndarray, position: np.ndarray, angles: np.ndarray) -> RopePose:
    """Return how the rope of a crane hangs.

    Args:
        crane: Numbers of the foot and of k + 2 joints, the last two being the swing joints, and the
            direction of the rope behind the last, shape (`FOOT_SIZE` + (k + 2) `JOINT_SIZE` +
            `ROPE_DIRECTION_SIZE`,).
        position: Positions of k joints [rad or m], shape (k,).
        angles: Angles of the swing joints [rad], shape (2,).
    """
    foot = crane[:FOOT_SIZE].reshape(3, 4)
    joints = _joints(crane[FOOT_SIZE:-ROPE_DIRECTION_SIZE])
    links = list(_links(foot, joints, [*position, *angles]))
    joint_count = len(position)

    # The rope hangs from the origin of the first swing joint.
    pivot = links[joint_count].joint_origin
    motion = []
    for joint, link in zip(joints[:joint_count], links[:joint_count], strict=True):
        lever = pivot - link.joint_origin
        sliding = link.axis * (1.0 - joint.turns)
        motion.append(sliding + cross_product(link.axis * joint.turns, lever))
    return RopePose(pivot, links[-1].rotation @ crane[-ROPE_DIRECTION_SIZE:], np.array(motion))


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
    joints = _joints(crane[FOOT_SIZE:-ROPE_DIRECTION_SIZE])
    motion = rope_pose(crane, 0.5 * (low + high), array([0.0, 0.0])).motion
    largest = []
    shift_beyond = 0.0
    for k in reversed(range(len(low))):
        in_the_middle = square_root(motion[k] @ motion[k])
        largest.append(in_the_middle + joints[k].turns * shift_beyond)
        shift_beyond = shift_beyond + 0.5 * (high[k] - low[k]) * largest[-1]
    return largest[::-1]


def _joints(numbers: np.ndarray) -> list[_JointNumbers]:
    """Return joints from the numbers of all of them, one after the other."""
    return [_JointNumbers.of(of_joint) for of_joint in numbers.reshape(-1, JOINT_SIZE)]


def _links(
    foot: np.ndarray, joints: Sequence[_JointNumbers], position: Sequence[Any]
) -> Iterator[_Link]:
    """Yield the link behind each joint at positions of the joints [rad or m].

    Args:
        foot: Rotation and translation of the foot [R, p], shape (3, 4).
        joints: The joints from the foot on.
        position: Position of each joint.
    """
    rotation = foot[:, :3]
    origin = foot[:, 3]
    for joint, value in zip(joints, position, strict=True):
        joint_origin = origin + rotation @ joint.translation
        rotation = rotation @ joint.rotation
        angle = joint.turns * value
        axis = rotation @ joint.axis
        origin = joint_origin + axis * (value - angle)
        rotation = rotation @ _rotation(joint.axis, angle)
        yield _Link(rotation, origin, axis, joint_origin)


def shifts(capsule: Capsule, low: np.ndarray, high: np.ndarray, normal: np.ndarray) -> Shifts:
    """Return how far the joints shift a capsule from the middle of their intervals.

    A joint that turns by up to h about u through o shifts a point x along a unit vector n by no
    more than

        h |n·(u × (x - o))| + h S + h²/2 |u × (x - o)|,

    where S is how far the joints beyond it shift the point; one that slides by up to h along u
    shifts it by h |n·u|. The middle term is there because the joints beyond it change its lever,
    the last one because a turn by h leaves its tangent by no more than that. In any direction a
    joint that turns shifts the point by no more than h (|u × (x - o)| + S), the length of an arc.

    Args:
        capsule: The capsule in the middle of the intervals.
        low: Lower ends of the intervals [rad or m], shape (k + 1,), the cable length last.
        high: Upper ends.
        normal: The unit vector n, shape (3,).
    """
    along_normal = []
    in_any_direction = []
    shift_beyond = 0.0
    # From the tip to the foot, so that the shift by the joints beyond is known.
    for k in reversed(range(len(capsule.turns))):
        h = 0.5 * (high[k] - low[k])
        slide = capsule.slides[k]
        tangents = capsule.tangents[k]
        lever = square_root(larger(*(x @ x for x in tangents)))
        first = larger(*(magnitude(x @ normal) for x in tangents)) + magnitude(slide @ normal)
        turned = capsule.turns[k] * shift_beyond
        along_normal.append(h * (first + turned + 0.5 * h * lever))
        in_any_direction.append(h * (lever + turned + square_root(slide @ slide)))
        shift_beyond = shift_beyond + in_any_direction[-1]
    return Shifts(along_normal[::-1], in_any_direction[::-1])


def separation(first: np.ndarray, second: np.ndarray, radii: Any) -> Separation:
    """Return how far two capsules are apart.

    The points of both segments that are nearest to each other are found as by Ericson, Real-Time
    Collision Detection (2005), §5.1.9. Whatever they are, both bounds hold.

    Args:
        first: Ends of the segment of the first [m], shape (2, 3).
        second: Ends of the segment of the second [m], shape (2, 3).
        radii: Sum of both radii [m].
    """
    # Points p + s a and q + t b, with s and t from 0 to 1, are nearest where |p - q + s a - t b|²
    # is least. Its derivatives by s and t vanish where
    #
    #     s = (a·b t - a·(p - q)) / a·a    and    t = (a·b s + b·(p - q)) / b·b.
    a = first[1] - first[0]
    b = second[1] - second[0]
    offset = first[0] - second[0]
    aa = a @ a + _MIN_SQUARED_LENGTH
    bb = b @ b + _MIN_SQUARED_LENGTH
    ab = a @ b
    a_offset = a @ offset
    b_offset = b @ offset

    # Both together give s; of parallel segments any s will do. Each is then cut to its range, and
    # the other follows from it.
    square = aa * bb
    determinant = square - ab * ab
    is_skew = determinant > _PARALLEL * square
    divisor = where(is_skew, determinant, _PARALLEL * square)
    s = clipped((ab * b_offset - a_offset * bb) / divisor, 0.0, 1.0)
    t = clipped((ab * s + b_offset) / bb, 0.0, 1.0)
    s = clipped((ab * t - a_offset) / aa, 0.0, 1.0)

    connection = offset + a * s - b * t
    length = square_root(connection @ connection)
    normal = connection * (1.0 / (length + _MIN_LENGTH))
    lowest_of_first = -larger(*(-(x @ normal) for x in first))
    highest_of_second = larger(*(x @ normal for x in second))
    return Separation(lowest_of_first - highest_of_second - radii, normal, length - radii)


def _where(condition: Any, yes: np.ndarray, no: np.ndarray) -> np.ndarray:
    """Return one of two arrays of the same shape, element by element, see `where`."""
    numbers = [where(condition, a, b) for a, b in zip(yes.flat, no.flat, strict=True)]
    return array(numbers).reshape(yes.shape)


def _rotation(axis: np.ndarray, angle: Any) -> np.ndarray:
    """Return the rotation about a unit axis by an angle [rad], after Rodrigues."""
    x, y, z = axis
    cross = array([0.0, -z, y, z, 0.0, -x, -y, x, 0.0]).reshape(3, 3)
    return np.eye(3) + cross * np.sin(angle) + cross @ cross * (1.0 - np.cos(angle))
