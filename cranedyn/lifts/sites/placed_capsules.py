"""Capsules around all shapes of a crane, where they are for many positions of its drives at once.

A capsule is all that is no farther from a segment than a radius. Rope and load are
swept: over the cable lengths of an interval, and over a cone about plumb.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.lifts.planning.crane_bodies import shape_corners
from cranedyn.lifts.planning.solids import rotation_z
from cranedyn.lifts.sites.capsules import (
    CAPSULE_SIZE,
    FOOT_SIZE,
    JOINT_SIZE,
    ROPE_DIRECTION_SIZE,
    place,
    rope_pose,
    shifts,
)
from cranedyn.model.crane import Crane

_MAX_GROUPS = 5
"""Largest number of groups of shapes of a joint; one capsule covers a group."""

_MIN_GAIN = 5.0
"""Volume of capsules that a split of a group must save [m³]."""

_MAX_RUNWAY_SHAPES = 24
"""Largest number of shapes of a runway that each get a capsule of their own."""

_CUTS_PER_AXIS = 5
"""Splits of a group that are tried along each axis."""

# The cone in which a rope swings grows downwards, so that one capsule for all of it would be much
# too wide at the top. The capsules end at depths that no cable length moves: so the capsules of a
# smaller box lie in those of a larger one.
_ROPE_CAPSULES = 4
"""Capsules of a rope, one below the other."""

_ORIGIN_TOLERANCE = 1e-9
"""Largest distance between the origins of swing joints and hoist [m]."""

_RADIUS_ROUNDING = 1e-9
"""Rounding error of a radius, which is added so that all corners lie inside [m]."""


@dataclass(frozen=True, eq=False)
class CraneBodies:
    """Capsules of one crane on a site, or of several, then with a first axis for the crane.

    A position is one number for each of the k drives between foot and rope, and the cable length.
    Capsule 0 <= c < n is fixed to the link behind `joint[c]` of these drives.

    Attributes:
        names: Name of each capsule: "tower", "jib", "counter-jib", "trolley", "rope" or "load"; of
            a crane that travels "runway" is what stands, and of an overhead crane "bridge" is what
            travels.
        columns: Index of each number of a position among the drives of the crane, shape (k + 1,).
        rotation, translation: Placement of each joint in the frame of the link before it, the first
            in that of the site, shapes (k, 3, 3) and (k, 3) [m].
        foot: Rotation and translation of the foot, as one matrix [R, p], shape (3, 4).
        axis: Axis of each joint in its frame, shape (k, 3).
        revolute: Whether it is revolute, shape (k,).
        rope: Numbers of both swing joints, see `numbers`, and the direction of the rope behind
            them, shape (2 `JOINT_SIZE` + `ROPE_DIRECTION_SIZE`,).
        joint: Number of joints before each capsule, shape (n,).
        ends: Ends of its segment in the frame of its link [m], shape (n, 2, 3); of rope and load
            the pivot twice.
        depth: Depth of these ends below the pivot in three numbers, shape (n, 2, 3): whether they
            follow the end of the shortest cable (1) or of the longest (0), the depth [m] below
            which they do not follow it, and a length [m] that is added; 0 for what does not hang.
        hangs: Whether it hangs, shape (n,).
        radius: Its radius without swing [m], shape (n,).
    """

    names: tuple[str, ...]
    columns: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    foot: np.ndarray
    axis: np.ndarray
    revolute: np.ndarray
    rope: np.ndarray
    joint: np.ndarray
    ends: np.ndarray
    depth: np.ndarray
    hangs: np.ndarray
    radius: np.ndarray

    @cached_property
    def chains(self) -> np.ndarray:
        """Numbers of the foot and the joints of several cranes in rows, see
        `cranedyn.lifts.sites.capsules.place`.
        """
        joints = _side_by_side(self.rotation, self.translation, self.axis, self.revolute)
        return np.hstack([x.reshape(len(self.foot), -1) for x in (self.foot, joints)])

    @cached_property
    def capsules(self) -> np.ndarray:
        """Numbers of their capsules, shape (cranes, n, `CAPSULE_SIZE`)."""
        return _side_by_side(self.joint, self.ends, self.depth, self.hangs, self.radius)

    @cached_property
    def numbers(self) -> np.ndarray:
        """All numbers of several cranes in rows."""
        return np.hstack([self.chains, self.capsules.reshape(len(self.foot), -1)])

    @cached_property
    def ropes(self) -> np.ndarray:
        """Numbers of foot, joints and rope in rows, see `capsules.rope_pose`."""
        return np.hstack([self.chains, self.rope])


@dataclass(frozen=True, eq=False)
class PlacedCapsules:
    """Capsules at positions, N of them.

    Attributes:
        ends: Ends of the segments in the frame of the site [m], shape (N, 2, 3).
        radius: Radii, with the swing of rope and load [m], shape (N,).
        motion: Upper bounds of the shift of any point by each joint [m], shape (N, k).
    """

    ends: np.ndarray
    radius: np.ndarray
    motion: np.ndarray


class _LocalCapsule(NamedTuple):
    """A capsule of a crane in the frame of a link; see `CraneBodies` for the fields."""

    name: str
    joint: int
    ends: np.ndarray
    depth: np.ndarray
    hangs: bool
    radius: float


class _RopeCapsule(NamedTuple):
    """A capsule of rope or load: its name, the depth of both ends as in `CraneBodies.depth`, and
    its radius [m].
    """

    name: str
    depth: np.ndarray
    radius: float


class _Joints(NamedTuple):
    """Joints of a crane from its foot to its load, by their indices in its Pinocchio model.

    Attributes:
        chain: Drives from the foot to the pivot.
        swings: Both swing joints.
        hoist: The joint of the winch.
    """

    chain: list[int]
    swings: list[int]
    hoist: int


class _Placements(NamedTuple):
    """Placements of k joints, see `CraneBodies` for the fields."""

    rotation: np.ndarray
    translation: np.ndarray
    axis: np.ndarray
    revolute: np.ndarray


def crane_bodies(crane: Crane, foot: np.ndarray, heading: float) -> CraneBodies:
    """Return the capsules of a crane at its place on a site.

    Every corner of every shape in its URDF lies in a capsule.

    Args:
        crane: The crane.
        foot: Where its foot stands in the frame of the site [m], shape (3,).
        heading: Direction of its jib at zero slew, from X towards Y [rad]; of a crane that travels
            the direction of -Y of its frame, in which the trolley of an overhead crane runs.

    Raises:
        ModelError: If it has no rope below two swing joints that hangs from both, has other joints
            besides drives from the foot to the rope, or shows a mesh or no load.
        OutOfRange: If the heading is not finite.
    """
    number("heading", heading, "rad")
    layout = crane.layout
    joints = _joints_to_load(crane)
    shapes = _shapes_by_joint(crane)
    if joints.hoist not in shapes:
        raise ModelError("The URDF of the crane shows no load; its distances are not known.")
    data = _at_zero_slew(crane, joints)
    _check_rope(crane, joints, data)
    outward = _outward(crane, joints, data)

    pivot = crane.model.jointPlacements[joints.swings[0]].translation[None].repeat(2, axis=0)
    capsules = _rigid_capsules(crane, joints, shapes, data, outward)
    of_swings: list[np.ndarray] = []
    for joint in joints.swings:
        of_swings += shapes.get(joint, [])
    if of_swings:
        # Shapes of the swing joints turn about the pivot: a ball covers them in any position.
        radius = float(np.linalg.norm(np.concatenate(of_swings), axis=1).max())
        not_hanging = np.zeros((2, 3))
        ball = _LocalCapsule("trolley", len(joints.chain), pivot, not_hanging, False, radius)
        capsules.append(ball)
    for part in _hanging(crane, shapes[joints.hoist]):
        capsules.append(
            _LocalCapsule(part.name, len(joints.chain), pivot, part.depth, True, part.radius)
        )

    # Where the jib points at zero slew in the frame of the crane.
    jib = -math.pi / 2.0
    if _slews_first(crane, joints):
        jib = math.atan2(outward[1], outward[0])
    of_chain = _placements(crane, joints.chain)
    of_swing_joints = _placements(crane, joints.swings)
    swing_joints = _side_by_side(*(field[None] for field in of_swing_joints))
    drives = layout.drives.tolist()
    return CraneBodies(
        names=tuple(capsule.name for capsule in capsules),
        columns=np.array([drives.index(i - 1) for i in (*joints.chain, joints.hoist)]),
        rotation=of_chain.rotation,
        translation=of_chain.translation,
        foot=np.column_stack([rotation_z(heading - jib), foot]),
        axis=of_chain.axis,
        revolute=of_chain.revolute,
        rope=np.append(swing_joints, _local_axis(crane, joints.hoist)),
        joint=np.array([capsule.joint for capsule in capsules]),
        ends=np.array([capsule.ends for capsule in capsules]),
        depth=np.array([capsule.depth for capsule in capsules]),
        hangs=np.array([capsule.hangs for capsule in capsules]),
        radius=np.array([capsule.radius for capsule in capsules]),
    )


def _joints_to_load(crane: Crane) -> _Joints:
    """Return the joints of a crane from its foot to its load.

    Raises:
        ModelError: If they are not drives, two swing joints and a hoist, or there are others.
    """
    layout = crane.layout
    supports: list[int] = []
    if crane.winch is not None:
        hoist = int(layout.drives[crane.winch]) + 1
        # The first joint of Pinocchio is the world.
        supports = crane.model.supports[hoist].tolist()[1:]
    is_driven = [layout.joints[i - 1].driven for i in supports]
    chain = supports[: is_driven.index(False)] if False in is_driven else []
    swings = supports[len(chain) : -1]
    driven_after_chain = any(is_driven[len(chain) : -1])
    if len(supports) != layout.n or driven_after_chain or len(swings) != 2:
        raise ModelError(
            "A crane on a site has drives from its foot to a pivot, two swing joints and a rope; "
            f"this one has {', '.join(layout.symbols)}."
        )
    return _Joints(chain, swings, supports[-1])


def _shapes_by_joint(crane: Crane) -> dict[int, list[np.ndarray]]:
    """Return the corners of all shapes behind each joint in the frame of its link [m], shape (n, 3)
    each; joint 0 is the world.
    """
    shapes: dict[int, list[np.ndarray]] = {}
    for joint, corners in shape_corners(crane):
        shapes.setdefault(joint, []).append(corners)
    return shapes


def _slews_first(crane: Crane, joints: _Joints) -> bool:
    """Return whether the first joint of a crane turns, as a slew does."""
    return bool(joints.chain) and crane.layout.joints[joints.chain[0] - 1].kind == "revolute"


def travels(crane: Crane) -> bool:
    """Return whether the first drive of a crane slides, as a bridge does on its runway. What stands
    of such a crane is a runway, on which others may travel as well.
    """
    first = crane.layout.joints[0]
    return first.driven and first.kind == "prismatic"


def is_bridge_crane(crane: Crane) -> bool:
    """Return whether a crane is a bridge with a trolley: two drives that slide, and a hoist."""
    kinds = [joint.kind for joint in crane.layout.driven]
    return travels(crane) and kinds == ["prismatic", "prismatic", "prismatic"]


def _at_zero_slew(crane: Crane, joints: _Joints) -> pin.Data:
    """Return the kinematics of a crane at its start with the first joint at zero if it turns."""
    q = np.array(crane.start.q, dtype=float)
    if _slews_first(crane, joints):
        q[joints.chain[0] - 1] = 0.0
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    return data


def _check_rope(crane: Crane, joints: _Joints, data: pin.Data) -> None:
    """Raise `ModelError` unless swing joints and hoist have one origin, and the rope goes down from
    there: `CraneBodies` knows one pivot only.
    """
    placements = crane.model.jointPlacements
    offsets = [placements[i].translation for i in (joints.swings[1], joints.hoist)]
    rope = data.oMi[joints.hoist].rotation @ _local_axis(crane, joints.hoist)
    origins_differ = np.abs(offsets).max() > _ORIGIN_TOLERANCE
    if origins_differ or rope[2] > 0.0 or crane.lower[joints.hoist - 1] < 0.0:
        raise ModelError("Swing joints and hoist must have one origin, and the hoist lower from 0.")


def _outward(crane: Crane, joints: _Joints, data: pin.Data) -> np.ndarray:
    """Return a horizontal vector in the direction of the jib, shape (2,): that in which a trolley
    runs, if there is one, else from the first joint to the pivot.
    """
    first = [*joints.chain, *joints.swings][0]
    to_pivot = data.oMi[joints.swings[0]].translation - data.oMi[first].translation
    outward = to_pivot[:2]
    if joints.chain and crane.layout.joints[joints.chain[-1] - 1].kind == "prismatic":
        last = joints.chain[-1]
        track = (data.oMi[last].rotation @ _local_axis(crane, last))[:2]
        outward = track * math.copysign(1.0, track @ outward)
    return outward


def _rigid_capsules(
    crane: Crane,
    joints: _Joints,
    shapes: dict[int, list[np.ndarray]],
    data: pin.Data,
    outward: np.ndarray,
) -> list[_LocalCapsule]:
    """Return the capsules around the shapes of the foot and of the drives before the pivot.

    Args:
        crane: The crane.
        joints: Its joints.
        shapes: Corners of the shapes behind each joint.
        data: Its kinematics at zero slew.
        outward: Direction of its jib, shape (2,).
    """
    capsules = []
    for index, joint in enumerate([0, *joints.chain]):
        is_trolley = (
            index == len(joints.chain)
            and index > 0
            and crane.layout.joints[joint - 1].role == "trolley"
        )
        for points in convex_parts(crane, joint, shapes.get(joint, [])):
            ends, radius = _capsule(points)
            middle = data.oMi[joint].act(ends.mean(axis=0))[:2]
            if index == 0:
                name = standing_part(crane)
            elif is_trolley:
                name = "trolley"
            elif is_bridge_crane(crane):
                name = "trolley" if index == len(joints.chain) else "bridge"
            else:
                name = "jib" if middle @ outward >= 0.0 else "counter-jib"
            capsules.append(_LocalCapsule(name, index, ends, np.zeros((2, 3)), False, radius))
    return capsules


def _placements(crane: Crane, joints: Sequence[int]) -> _Placements:
    """Return the placements of joints by their indices in the Pinocchio model of a crane."""
    placements = [crane.model.jointPlacements[i] for i in joints]
    return _Placements(
        rotation=np.array([placement.rotation for placement in placements]),
        translation=np.array([placement.translation for placement in placements]),
        axis=np.array([_local_axis(crane, i) for i in joints]),
        revolute=np.array([crane.layout.joints[i - 1].kind == "revolute" for i in joints]),
    )


def _side_by_side(*fields: np.ndarray) -> np.ndarray:
    """Return the fields of the joints or capsules of several cranes side by side, shape (cranes,
    joints or capsules, numbers), from shapes (cranes, joints or capsules, ...).
    """
    return np.concatenate([field.reshape(*field.shape[:2], -1) for field in fields], axis=2)


def _local_axis(crane: Crane, joint: int) -> np.ndarray:
    """Return the axis of a joint in its own frame, shape (3,); the layout has it at zero position
    in the frame of the crane.
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, np.zeros(crane.layout.n))
    return data.oMi[joint].rotation.T @ np.array(crane.layout.joints[joint - 1].axis)


def _hanging(crane: Crane, shapes: list[np.ndarray]) -> list[_RopeCapsule]:
    """Return the capsules of rope and load.

    The rope has the width of the hook block, as its falls are that far apart. The load is a capsule
    about the rope, since it may turn about it.

    Args:
        crane: The crane.
        shapes: Corners of the shapes behind the hoist, shape (n, 3) each: hook block and load.
    """
    assert crane.winch is not None
    hoist = int(crane.layout.drives[crane.winch])
    down = _local_axis(crane, hoist + 1)

    # The hook block is the highest shape.
    block = min(shapes, key=lambda corners: float((corners @ down).mean()))
    rope_radius = _largest_distance_from_axis(block, down)
    upper_ends = np.linspace(0.0, crane.upper[hoist], _ROPE_CAPSULES + 1)[:-1].tolist()
    rope = []
    for first, last in itertools.pairwise([*upper_ends, math.inf]):
        # Both ends follow the longest cable down to their depth.
        depth = np.array([[0.0, first, 0.0], [0.0, last, 0.0]])
        rope.append(_RopeCapsule("rope", depth, rope_radius))

    # From the top of the load on the shortest cable to its bottom on the longest.
    points = np.concatenate(shapes)
    below_cable = points @ down
    top = float(below_cable.min())
    bottom = float(below_cable.max())
    load_depth = np.array([[1.0, math.inf, top], [0.0, math.inf, bottom]])
    load = _RopeCapsule("load", load_depth, _largest_distance_from_axis(points, down))
    return [*rope, load]


def _largest_distance_from_axis(points: np.ndarray, axis: np.ndarray) -> float:
    """Return the largest distance of points [m], shape (n, 3), from an axis through the origin."""
    across = points - (points @ axis)[:, None] * axis
    return float(np.linalg.norm(across, axis=1).max())


def standing_part(crane: Crane) -> str:
    """Return what is called the part of a crane that no drive moves."""
    return "runway" if travels(crane) else "tower"


def convex_parts(crane: Crane, joint: int, shapes: list[np.ndarray]) -> list[np.ndarray]:
    """Partition the corners of the shapes behind a joint, shape (n, 3) each, into parts that count
    as convex; joint 0 is the world.

    Shapes are grouped, see `group_shapes`. The rails and columns of a runway are not, up to
    `_MAX_RUNWAY_SHAPES`: a capsule around a row of columns and their rail would be as wide as the
    columns are high, and fill the hall beside them.
    """
    if joint == 0 and travels(crane) and len(shapes) <= _MAX_RUNWAY_SHAPES:
        return shapes
    return group_shapes(shapes)


def group_shapes(shapes: list[np.ndarray]) -> list[np.ndarray]:
    """Partition the corners of shapes, shape (n, 3) each, into at most `_MAX_GROUPS` groups.

    One capsule covers a group.

    Repeatedly split the largest group in two where that saves most volume of capsules; stop where a
    split saves less than `_MIN_GAIN`.
    """
    if not shapes:
        return []
    corners = np.concatenate(shapes, dtype=float)
    groups = _group_shapes_cached(corners.tobytes(), tuple(len(shape) for shape in shapes))
    return [group.copy() for group in groups]


@lru_cache(maxsize=32)
def _group_shapes_cached(corners: bytes, counts: tuple[int, ...]) -> list[np.ndarray]:
    """Return the groups of `group_shapes`. The cranes of a site are often equal, and a site is read
    several times; the search for the best split takes a tenth of a second.

    Args:
        corners: Corners of all shapes, one shape after the other, as float64 [m], shape (n, 3).
        counts: Number of corners of each shape.
    """
    points = np.frombuffer(corners).reshape(-1, 3)
    groups = [np.split(points, np.cumsum(counts)[:-1])]
    while len(groups) < _MAX_GROUPS:
        i = int(np.argmax([_volume(group) for group in groups]))
        volume, halves = _best_cut(groups[i])
        if _volume(groups[i]) - volume < _MIN_GAIN:
            break
        groups[i : i + 1] = halves
    return [np.concatenate(group) for group in groups]


def _best_cut(group: list[np.ndarray]) -> tuple[float, list[list[np.ndarray]]]:
    """Return the split of a group of shapes whose two capsules have the least volume: this volume
    [m³] and both halves; infinity and none if the group cannot be split.

    Shapes are split by their centres along an axis of coordinates.
    """
    least_volume = math.inf
    best_halves: list[list[np.ndarray]] = []
    centres = np.array([corners.mean(axis=0) for corners in group])
    cuts = np.unique(np.linspace(0, len(group), _CUTS_PER_AXIS + 2).astype(int)[1:-1])
    for axis in range(3):
        order = np.argsort(centres[:, axis], kind="stable")
        for cut in cuts:
            lower = [group[i] for i in order[:cut]]
            upper = [group[i] for i in order[cut:]]
            if not lower or not upper:
                continue
            volume = _volume(lower) + _volume(upper)
            if volume < least_volume:
                least_volume = volume
                best_halves = [lower, upper]
    return least_volume, best_halves


def _volume(group: list[np.ndarray]) -> float:
    """Return the volume of the capsule around a group of shapes [m³]."""
    ends, radius = _capsule(np.concatenate(group))
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return math.pi * radius**2 * (length + 4.0 / 3.0 * radius)


def _capsule(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return a small capsule around points [m], shape (n, 3): the ends of its segment, shape (2,
    3), and its radius.

    Four directions of the segment are tried, the axes of coordinates and the principal axis of the
    points; the one with the least volume is taken.
    """
    centre = points.mean(axis=0)
    principal = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    least_volume = math.inf
    best_ends = None
    for direction in (principal, *np.eye(3)):
        capsule = _capsule_along(points, direction)
        # Over π, which all have in common.
        volume = capsule.radius**2 * (capsule.length + 4.0 / 3.0 * capsule.radius)
        if best_ends is None or volume < least_volume:
            least_volume = volume
            best_ends = capsule.ends
    assert best_ends is not None
    return best_ends, float(segment_distance(points, best_ends).max()) + _RADIUS_ROUNDING


class _AlignedCapsule(NamedTuple):
    """A capsule in a given direction: its ends [m], shape (2, 3), its length and radius [m]."""

    ends: np.ndarray
    length: float
    radius: float


def _capsule_along(points: np.ndarray, direction: np.ndarray) -> _AlignedCapsule:
    """Return a capsule in a direction, shape (3,), around points [m], shape (n, 3).

    Its line goes through the middle of the bounding box of the points, seen in this direction. A
    point at the distance d from the line is inside as long as the end of the segment is no more
    than √(r² - d²) before it: so the segment need not reach the outermost points.
    """
    position = points @ direction
    across = points - position[:, None] * direction
    line = (across.min(axis=0) + across.max(axis=0)) / 2.0

    # The bounding box is in the axes of coordinates, so its middle may lie along the direction.
    line -= (line @ direction) * direction
    distance = np.linalg.norm(across - line, axis=1)
    radius = float(distance.max())
    cap = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    low = float((position + cap).min())
    high = float((position - cap).max())
    if not low < high:
        # A ball covers all points.
        low = (low + high) / 2.0
        high = low
    ends = np.array([line + low * direction, line + high * direction])
    return _AlignedCapsule(ends, high - low, radius)


def segment_distance(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the distance of points [m], shape (n, 3), from a segment, shape (2, 3)."""
    segment = ends[1] - ends[0]
    square = float(segment @ segment)
    # The segment of a ball has no length, and no direction to project on.
    share = np.clip((points - ends[0]) @ segment / square, 0.0, 1.0) if square > 0.0 else 0.0
    nearest = ends[0] + np.multiply.outer(share, segment)
    return np.linalg.norm(points - nearest, axis=1)


def without_standing(bodies: CraneBodies) -> CraneBodies:
    """Return the bodies of a crane without the capsules that no drive moves."""
    moves = bodies.joint > 0
    return replace(
        bodies,
        names=tuple(itertools.compress(bodies.names, moves)),
        joint=bodies.joint[moves],
        ends=bodies.ends[moves],
        depth=bodies.depth[moves],
        hangs=bodies.hangs[moves],
        radius=bodies.radius[moves],
    )


def stacked(bodies: Sequence[CraneBodies]) -> CraneBodies:
    """Return the bodies of several cranes as arrays with a first axis for the crane.

    Missing joints are prismatic without an axis, missing capsules repeat the last.
    """
    joint_count = max(len(crane.axis) for crane in bodies)
    capsule_count = max(len(crane.radius) for crane in bodies)

    def with_joints(fields: list[np.ndarray], missing: np.ndarray | float) -> np.ndarray:
        """Return a field of the joints of all cranes, as many of each crane."""
        return np.array([_padded(of_crane, joint_count, missing) for of_crane in fields])

    def with_capsules(fields: list[np.ndarray]) -> np.ndarray:
        """Return a field of the capsules of all cranes, as many of each crane."""
        return np.array([_padded(of_crane, capsule_count, of_crane[-1]) for of_crane in fields])

    return CraneBodies(
        names=(),
        columns=np.zeros(0, dtype=int),
        rotation=with_joints([crane.rotation for crane in bodies], np.eye(3)),
        translation=with_joints([crane.translation for crane in bodies], 0.0),
        foot=np.array([crane.foot for crane in bodies]),
        axis=with_joints([crane.axis for crane in bodies], 0.0),
        revolute=with_joints([crane.revolute for crane in bodies], 0.0),
        rope=np.array([crane.rope for crane in bodies]),
        joint=with_capsules([crane.joint for crane in bodies]),
        ends=with_capsules([crane.ends for crane in bodies]),
        depth=with_capsules([crane.depth for crane in bodies]),
        hangs=with_capsules([crane.hangs for crane in bodies]),
        radius=with_capsules([crane.radius for crane in bodies]),
    )


def _padded(rows: np.ndarray, count: int, missing: np.ndarray | float) -> np.ndarray:
    """Return so many rows; those that are missing have a given value."""
    padding = np.broadcast_to(missing, (count - len(rows), *rows.shape[1:]))
    return np.concatenate([rows, padding.astype(rows.dtype)])


class _Reader:
    """Takes blocks off a vector of numbers, one after the other."""

    def __init__(self, numbers: np.ndarray) -> None:
        self._numbers = numbers
        self._position = 0

    def take(self, count: int) -> np.ndarray:
        """Return the next block of so many numbers."""
        begin = self._position
        self._position += count
        return self._numbers[begin : self._position]


def place_capsules(
    bodies: CraneBodies,
    which: np.ndarray,
    capsule: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    swing: float,
) -> PlacedCapsules:
    """Return capsules of cranes, N of them, in the middle of intervals of positions.

    Args:
        bodies: The cranes, `stacked`.
        which: Index of the crane, shape (N,).
        capsule: Index of the capsule, shape (N,).
        low: Lower ends of the intervals of positions, shape (N, k + 1), the cable length last;
            rope and load are swept over all lengths.
        high: Upper ends.
        swing: Largest angle of the rope from plumb [rad].
    """
    chains = bodies.chains[which]
    capsules = bodies.capsules[which, capsule]

    # A point of a rope that swings by α goes along a chord of 2 sin(α/2) times its depth.
    cone = np.full((len(which), 1), 2.0 * math.sin(swing / 2.0))
    place_rows = _compile_place_capsules(bodies.axis.shape[1])
    placed = place_rows(np.hstack([chains, capsules, low, high, cone]))
    return PlacedCapsules(placed[:, :6].reshape(-1, 2, 3), placed[:, 6], placed[:, 7:])


@cache
def _compile_place_capsules(joints: int) -> RowFunction:
    """Compile `place_capsules` for cranes with so many joints between foot and rope."""
    chain_size = FOOT_SIZE + JOINT_SIZE * joints
    position_size = joints + 1

    def placed(numbers: np.ndarray) -> list[Any]:
        reader = _Reader(numbers)
        chain = reader.take(chain_size)
        local = reader.take(CAPSULE_SIZE)
        low = reader.take(position_size)
        high = reader.take(position_size)
        (cone,) = reader.take(1)
        plumb = array([0.0, 0.0, -1.0])
        capsule = place(chain, local, low, high, cone, plumb)
        motion = shifts(capsule, low, high, plumb).in_any_direction
        return [*capsule.ends.flat, capsule.radius, *motion]

    return compile_rows(placed, chain_size + CAPSULE_SIZE + 2 * position_size + 1, 7 + joints)


def place_crane(
    bodies: CraneBodies, crane: int, position: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Return the ends of all capsules of a crane [m], shape (N, n, 2, 3), as its rope hangs.

    Args:
        bodies: The cranes, `stacked`.
        crane: Index of the crane.
        position: Positions, shape (N, k + 1), the cable length last.
        angles: Angles of its swing joints [rad], shape (N, 2).
    """
    place_rows = _compile_place_crane(bodies.axis.shape[1], bodies.radius.shape[1])
    shared = np.concatenate([bodies.ropes[crane], bodies.capsules[crane].ravel()])
    ends = place_rows(np.hstack([position, angles]), shared)
    return ends.reshape(len(position), -1, 2, 3)


@cache
def _compile_place_crane(joints: int, count: int) -> RowFunction:
    """Compile `place_crane` for so many joints between foot and rope, and so many capsules."""
    chain_size = FOOT_SIZE + JOINT_SIZE * joints
    rope_size = 2 * JOINT_SIZE + ROPE_DIRECTION_SIZE
    shared_size = chain_size + rope_size + CAPSULE_SIZE * count
    position_size = joints + 1

    def placed(numbers: np.ndarray) -> list[Any]:
        reader = _Reader(numbers)
        chain = reader.take(chain_size)
        rope = reader.take(rope_size)
        capsules = reader.take(CAPSULE_SIZE * count).reshape(count, CAPSULE_SIZE)
        position = reader.take(position_size)
        angles = reader.take(2)
        direction = rope_pose(np.append(chain, rope), position[:-1], angles).direction
        ends: list[Any] = []
        for capsule in capsules:
            # An interval without a length, and a rope that is where it is: no swing.
            ends.extend(place(chain, capsule, position, position, 0.0, direction).ends.flat)
        return ends

    return compile_rows(placed, position_size + 2, 6 * count, shared_size)


def rope_poses(ropes: np.ndarray, position: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return pivots, directions and motions of the pivots in rows of 6 + 3 k numbers, see
    `cranedyn.lifts.sites.capsules.rope_pose`.

    Args:
        ropes: Numbers of N cranes as in `CraneBodies.ropes`.
        position: Positions of their joints between foot and rope [rad or m], shape (N, k).
        angles: Angles of their swing joints [rad], shape (N, 2).
    """
    pose_rows = _compile_rope_poses(position.shape[1])
    return pose_rows(np.hstack([ropes, position, angles]))


@cache
def _compile_rope_poses(joints: int) -> RowFunction:
    """Compile `rope_poses` for cranes with so many joints between foot and rope."""
    rope_size = FOOT_SIZE + JOINT_SIZE * (joints + 2) + ROPE_DIRECTION_SIZE

    def pose(numbers: np.ndarray) -> list[Any]:
        reader = _Reader(numbers)
        crane = reader.take(rope_size)
        position = reader.take(joints)
        angles = reader.take(2)
        rope = rope_pose(crane, position, angles)
        return [*rope.pivot.flat, *rope.direction.flat, *rope.motion.flat]

    return compile_rows(pose, rope_size + joints + 2, 6 + 3 * joints)
