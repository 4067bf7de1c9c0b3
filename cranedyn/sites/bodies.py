"""Capsules around all shapes of a crane, where they are for many positions of its drives at once.

A capsule is all that is no farther from a segment than a radius. Rope and load are
swept: over the cable lengths of an interval, and over a cone about plumb.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane
from cranedyn.planning.bodies import shape_corners
from cranedyn.planning.solids import rotation_z
from cranedyn.sites.capsules import CAPSULE, JOINT, place, rope_pose, shifts

_MOST, _GAIN, _CUTS = 5, 5.0, 5
"""Most capsules of a joint; volume that a cut of a group of shapes in two saves at least [m³]; cuts
that are tried along each axis."""

_ROPE = 4
"""Capsules of a rope, one below the other: the cone in which it swings grows downwards. They end at
depths that no cable length moves: so the capsules of a smaller box lie in those of a larger."""


@dataclass(frozen=True, eq=False)
class CraneBodies:
    """Capsules of one crane on a site, or of several, then with a first axis for the crane.

    A position is one number for each of the k drives between foot and rope, and the cable length.
    Capsule 0 <= c < n is fixed to the link behind `joint[c]` of these drives.

    Attributes:
        names: Name of each capsule: "tower", "jib", "counter-jib", "trolley", "rope" or "load".
        columns: Index of each number of a position among the drives of the crane, shape (k + 1,).
        rotation, translation: Placement of each joint in the frame of the link before it, the first
            in that of the site, shapes (k, 3, 3) and (k, 3) [m].
        foot: Rotation and translation of the foot, as one matrix [R, p], shape (3, 4).
        axis: Axis of each joint in its frame, shape (k, 3).
        revolute: Whether it is revolute, shape (k,).
        rope: Numbers of both swing joints, see `numbers`, and the direction of the rope behind
            them, shape (2 `JOINT` + 3,).
        joint: Number of joints before each capsule, shape (n,).
        ends: Ends of its segment in the frame of its link [m], shape (n, 2, 3); of rope and load
            the pivot twice.
        depth: Depth of these ends below the pivot in three numbers, shape (n, 2, 3): whether below
            the end of the shortest cable or of the longest, the depth [m] below which they do not
            follow it, and a length [m] that is added; 0 for what does not hang.
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
        `cranedyn.sites.capsules.place`.
        """
        joints = _columns(self.rotation, self.translation, self.axis, self.revolute)
        return np.hstack([x.reshape(len(self.foot), -1) for x in (self.foot, joints)])

    @cached_property
    def capsules(self) -> np.ndarray:
        """Numbers of their capsules, shape (cranes, n, `CAPSULE`)."""
        return _columns(self.joint, self.ends, self.depth, self.hangs, self.radius)

    @cached_property
    def numbers(self) -> np.ndarray:
        """All numbers of several cranes in rows."""
        return np.hstack([self.chains, self.capsules.reshape(len(self.foot), -1)])

    @cached_property
    def ropes(self) -> np.ndarray:
        """Numbers of foot, joints and rope in rows, see `cranedyn.sites.capsules.rope_pose`."""
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


def crane_bodies(crane: Crane, foot: np.ndarray, heading: float) -> CraneBodies:
    """Return the capsules of a crane whose foot stands at a point [m], shape (3,), and whose jib
    points along a heading at zero slew, from X towards Y [rad].

    Every corner of every shape in its URDF lies in a capsule.

    Raises:
        ModelError: If it has no rope below two swing joints that hangs from both, has other joints
            besides drives from the foot to the rope, or shows a mesh or no load.
        OutOfRange: If the heading is not finite.
    """
    number("heading", heading, "rad")
    model, layout, winch = crane.model, crane.layout, crane.winch
    supports = [] if winch is None else model.supports[int(layout.drives[winch]) + 1].tolist()[1:]
    driven = [layout.joints[i - 1].driven for i in supports]
    chain = supports[: driven.index(False)] if False in driven else []
    swings = supports[len(chain) : -1]
    if len(supports) != layout.n or any(driven[len(chain) : -1]) or len(swings) != 2:
        raise ModelError(
            "A crane on a site has drives from its foot to a pivot, two swing joints and a rope; "
            f"this one has {', '.join(layout.symbols)}."
        )
    pivot = model.jointPlacements[swings[0]].translation[None].repeat(2, axis=0)
    shapes: dict[int, list[np.ndarray]] = {}
    for joint, corners in shape_corners(crane):
        shapes.setdefault(joint, []).append(corners)
    if supports[-1] not in shapes:
        raise ModelError("The URDF of the crane shows no load; its distances are not known.")
    capsules, fixed, data = [], np.zeros((2, 3)), model.createData()
    turns = bool(chain) and layout.joints[chain[0] - 1].kind == "revolute"
    q = np.where(turns & (np.arange(layout.n) == supports[0] - 1), 0.0, crane.start.q)
    pin.forwardKinematics(model, data, q)
    outward = (data.oMi[swings[0]].translation - data.oMi[supports[0]].translation)[:2]
    if chain and layout.joints[chain[-1] - 1].kind == "prismatic":
        direction = (data.oMi[chain[-1]].rotation @ _local_axis(crane, chain[-1]))[:2]
        outward = direction * math.copysign(1.0, direction @ outward)
    offsets = [model.jointPlacements[i].translation for i in (swings[1], supports[-1])]
    rope = data.oMi[supports[-1]].rotation @ _local_axis(crane, supports[-1])
    if np.abs(offsets).max() > 1e-9 or rope[2] > 0.0 or crane.lower[supports[-1] - 1] < 0.0:
        raise ModelError("Swing joints and hoist must have one origin, and the hoist lower from 0.")
    for index, joint in enumerate([0, *chain]):
        for points in group_shapes(shapes.get(joint, [])):
            ends, radius = _capsule(points)
            middle = data.oMi[joint].act(ends.mean(axis=0))[:2]
            name = "jib" if middle @ outward >= 0.0 else "counter-jib"
            if index == 0 or (index == len(chain) and layout.joints[joint - 1].role == "trolley"):
                name = "trolley" if index else "tower"
            capsules.append((name, index, ends, fixed, False, radius))
    carried = [corners for joint in swings for corners in shapes.get(joint, [])]
    if carried:
        radius = float(np.linalg.norm(np.concatenate(carried), axis=1).max())
        capsules.append(("trolley", len(chain), pivot, fixed, False, radius))
    for name, depth, radius in _hanging(crane, shapes[supports[-1]]):
        capsules.append((name, len(chain), pivot, depth, True, radius))
    jib = math.atan2(outward[1], outward[0]) if turns else -math.pi / 2.0
    names, joint, ends, depth, hangs, radii = zip(*capsules, strict=True)
    rotation, translation, axis, revolute = _joints(crane, chain)
    hinges = _columns(*(array[None] for array in _joints(crane, swings)))
    return CraneBodies(
        names=names,
        columns=np.array([layout.drives.tolist().index(i - 1) for i in (*chain, supports[-1])]),
        rotation=rotation,
        translation=translation,
        foot=np.column_stack([rotation_z(heading - jib), foot]),
        axis=axis,
        revolute=revolute,
        rope=np.append(hinges, _local_axis(crane, supports[-1])),
        joint=np.array(joint),
        ends=np.array(ends),
        depth=np.array(depth),
        hangs=np.array(hangs),
        radius=np.array(radii),
    )


def _joints(crane: Crane, joints: Sequence[int]) -> list[np.ndarray]:
    """Return rotation, translation, axis and kind of joints."""
    placements = [crane.model.jointPlacements[i] for i in joints]
    return [
        np.array([placement.rotation for placement in placements]),
        np.array([placement.translation for placement in placements]),
        np.array([_local_axis(crane, i) for i in joints]),
        np.array([crane.layout.joints[i - 1].kind == "revolute" for i in joints]),
    ]


def _columns(*arrays: np.ndarray) -> np.ndarray:
    """Return all numbers of each joint or capsule of several cranes in one axis."""
    return np.concatenate([array.reshape(*array.shape[:2], -1) for array in arrays], axis=2)


def _local_axis(crane: Crane, joint: int) -> np.ndarray:
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, np.zeros(crane.layout.n))
    return data.oMi[joint].rotation.T @ np.array(crane.layout.joints[joint - 1].axis)


def _hanging(crane: Crane, shapes: list[np.ndarray]) -> list[tuple[str, np.ndarray, float]]:
    """Return capsules of rope and load: name, depth of both ends and radius [m]."""
    assert crane.winch is not None
    down = _local_axis(crane, int(crane.layout.drives[crane.winch]) + 1)
    points = np.concatenate(shapes)
    along = points @ down
    width = float(np.linalg.norm(points - along[:, None] * down, axis=1).max())
    block = min(shapes, key=lambda corners: float((corners @ down).mean()))
    across = block - (block @ down)[:, None] * down
    falls = float(np.linalg.norm(across, axis=1).max())
    depths = np.linspace(0.0, crane.upper[crane.layout.drives[crane.winch]], _ROPE + 1)[:-1]
    rope = [
        ("rope", np.array([[0.0, first, 0.0], [0.0, last, 0.0]]), falls)
        for first, last in itertools.pairwise([*depths.tolist(), math.inf])
    ]
    load = np.array([[1.0, math.inf, float(along.min())], [0.0, math.inf, float(along.max())]])
    return [*rope, ("load", load, width)]


def group_shapes(shapes: list[np.ndarray]) -> list[np.ndarray]:
    """Partition the corners of shapes, shape (n, 3) each, into at most `_MOST` groups.

    One capsule covers a group.

    Repeatedly split the largest group in two where that saves most volume of capsules; stop where a
    split saves less than `_GAIN`.
    """
    if not shapes:
        return []
    groups = [shapes]
    while len(groups) < _MOST:
        i = int(np.argmax([_volume(group) for group in groups]))
        volume, halves = _best_cut(groups[i])
        if _volume(groups[i]) - volume < _GAIN:
            break
        groups[i : i + 1] = halves
    return [np.concatenate(group) for group in groups]


def _best_cut(group: list[np.ndarray]) -> tuple[float, list[list[np.ndarray]]]:
    best: tuple[float, list[list[np.ndarray]]] = (math.inf, [])
    centres = np.array([corners.mean(axis=0) for corners in group])
    for axis in range(3):
        order = np.argsort(centres[:, axis], kind="stable")
        for cut in np.unique(np.linspace(0, len(group), _CUTS + 2).astype(int)[1:-1]):
            halves = [[group[i] for i in half] for half in (order[:cut], order[cut:])]
            if all(halves):
                volume = sum(map(_volume, halves))
                best = min(best, (volume, halves), key=lambda pair: pair[0])
    return best


def _volume(group: list[np.ndarray]) -> float:
    ends, radius = _capsule(np.concatenate(group))
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return math.pi * radius**2 * (length + 4.0 / 3.0 * radius)


def _capsule(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the ends of a segment [m], shape (2, 3), and a radius [m] within which points, shape
    (n, 3), lie about it: of the coordinate and principal axes that with the least volume.
    """
    centre = points.mean(axis=0)
    principal = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    best = None
    for direction in (principal, *np.eye(3)):
        t = points @ direction
        across = points - t[:, None] * direction
        line = (across.min(axis=0) + across.max(axis=0)) / 2.0
        line -= (line @ direction) * direction
        distance = np.linalg.norm(across - line, axis=1)
        radius = float(distance.max())
        cap = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
        low, high = float((t + cap).min()), float((t - cap).max())
        low, high = (low, high) if low < high else ((low + high) / 2.0,) * 2
        volume = radius**2 * (high - low + 4.0 / 3.0 * radius)
        if best is None or volume < best[0]:
            best = volume, np.array([line + low * direction, line + high * direction]), radius
    assert best is not None
    _, ends, _ = best
    return ends, float(segment_distance(points, ends).max()) + 1e-9


def segment_distance(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the distance of points [m], shape (n, 3), from a segment, shape (2, 3)."""
    along = ends[1] - ends[0]
    square = float(along @ along)
    share = np.clip((points - ends[0]) @ along / square, 0.0, 1.0) if square > 0.0 else 0.0
    nearest = ends[0] + np.multiply.outer(share, along)
    return np.linalg.norm(points - nearest, axis=1)


def stacked(bodies: Sequence[CraneBodies]) -> CraneBodies:
    """Return the bodies of several cranes as arrays with a first axis for the crane.

    Missing joints are prismatic without an axis, missing capsules repeat the last.
    """
    longest = max(len(item.axis) for item in bodies)
    largest = max(len(item.radius) for item in bodies)
    columns: dict[str, list[np.ndarray]] = {}
    for item in bodies:
        joints, capsules = len(item.axis), len(item.radius)
        for field in fields(CraneBodies)[2:]:
            array = getattr(item, field.name)
            if field.name in ("rotation", "translation", "axis", "revolute"):
                filler = np.eye(3) if field.name == "rotation" else np.zeros(array.shape[1:])
                padding = np.broadcast_to(filler, (longest - joints, *array.shape[1:]))
                array = np.concatenate([array, padding.astype(array.dtype)])
            elif field.name not in ("foot", "rope"):
                array = np.concatenate([array, array[-1:].repeat(largest - capsules, axis=0)])
            columns.setdefault(field.name, []).append(array)
    arrays = {name: np.array(values) for name, values in columns.items()}
    return CraneBodies(names=(), columns=np.zeros(0, dtype=int), **arrays)


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
    cranes, capsules = bodies.chains[which], bodies.capsules[which, capsule]
    cone = np.full((len(which), 1), 2.0 * math.sin(swing / 2.0))
    placed = _placing(bodies.axis.shape[1])(np.hstack([cranes, capsules, low, high, cone]))
    return PlacedCapsules(placed[:, :6].reshape(-1, 2, 3), placed[:, 6], placed[:, 7:])


@cache
def _placing(joints: int) -> RowFunction:
    sizes = [12 + JOINT * joints, CAPSULE, joints + 1, joints + 1, 1]

    def placed(numbers: np.ndarray) -> list[Any]:
        crane, local, low, high, cone = np.split(numbers, np.cumsum(sizes)[:-1])
        rope = array([0.0, 0.0, -1.0])
        capsule = place(crane, local, low, high, cone[0], rope)
        return [*capsule.ends.flat, capsule.radius, *shifts(capsule, low, high, rope)[1]]

    return compile_rows(placed, sum(sizes), 7 + joints)


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
    sizes = bodies.axis.shape[1], bodies.radius.shape[1]
    numbers = np.concatenate([bodies.ropes[crane], bodies.capsules[crane].ravel()])
    ends = _placing_crane(*sizes)(np.hstack([position, angles]), numbers)
    return ends.reshape(len(position), -1, 2, 3)


@cache
def _placing_crane(joints: int, count: int) -> RowFunction:
    sizes = [12 + JOINT * joints, 2 * JOINT + 3, CAPSULE * count, joints + 1, 2]

    def placed(numbers: np.ndarray) -> list[Any]:
        chain, hinges, capsules, position, angles = np.split(numbers, np.cumsum(sizes)[:-1])
        _, rope, _ = rope_pose(np.append(chain, hinges), position[:-1], angles)
        return [
            number
            for capsule in capsules.reshape(count, CAPSULE)
            for number in place(chain, capsule, position, position, 0.0, rope).ends.flat
        ]

    return compile_rows(placed, sum(sizes[3:]), 6 * count, sum(sizes[:3]))


def rope_poses(ropes: np.ndarray, position: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return pivots, directions and motions of the pivots in rows of 6 + 3 k numbers, see
    `cranedyn.sites.capsules.rope_pose`.

    Args:
        ropes: Numbers of N cranes as in `CraneBodies.ropes`.
        position: Positions of their joints between foot and rope [rad or m], shape (N, k).
        angles: Angles of their swing joints [rad], shape (N, 2).
    """
    return _posing(position.shape[1])(np.hstack([ropes, position, angles]))


@cache
def _posing(joints: int) -> RowFunction:
    sizes = [15 + JOINT * (joints + 2), joints, 2]

    def pose(numbers: np.ndarray) -> list[Any]:
        return [
            x for block in rope_pose(*np.split(numbers, np.cumsum(sizes)[:-1])) for x in block.flat
        ]

    return compile_rows(pose, sum(sizes), 6 + 3 * joints)
