"""Bodies of a crane from the shapes in its URDF: mast, upper structure, trolley, rope, hook and
load; and all of a crane that is parked on a site, as an obstacle.

The frame of a crane has its origin at the foot of the mast, Z up, and the jib along -Y at zero
slew. `refuse_other_kinematics` makes sure that its joints stand and move in that frame as those of
the tower crane of this project do, on which the distances of a lift rest.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin

from cranedyn.checks import within
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.lifts.planning.rigging import attachment_height, rigging_height
from cranedyn.lifts.planning.site import HANGING, Site
from cranedyn.lifts.planning.solids import Solid, convex_hull, rotation_z
from cranedyn.model.crane import Crane

_POSITION_TOLERANCE = 1e-4
"""Largest distance of a joint from where a tower crane has it [m]. The deduction from margins,
`cranedyn.lifts.planning.clearance.ROUNDING`, is as large.
"""

_ROTATION_TOLERANCE = 1e-5
"""Largest entry of the difference of two rotation matrices that count as one: a right angle that a
URDF rounds to 1.5708 is off by 4e-6."""

ROPE_RADIUS = 0.1
"""Radius of a rope whose hook is not drawn [m]: that of a usual hook block of a few tonnes."""


class DrawnShape(NamedTuple):
    """A shape of a URDF.

    Attributes:
        geometry: The shape, about its own origin.
        rotation: Its rotation in the frame of the joint that carries it, shape (3, 3).
        translation: Its origin in that frame [m], shape (3,).
    """

    geometry: coal.CollisionGeometry
    rotation: np.ndarray
    translation: np.ndarray


class BoundingBox(NamedTuple):
    """A box along the axes of a frame.

    Attributes:
        centre: Its centre [m], shape (3,).
        size: Its sides [m], shape (3,).
    """

    centre: np.ndarray
    size: np.ndarray

    @property
    def top(self) -> float:
        """Height of its top [m]."""
        return self.centre[2] + self.size[2] / 2.0

    @property
    def corners(self) -> np.ndarray:
        """Its corners [m], shape (8, 3)."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        return self.centre + signs * self.size / 2.0


@dataclass(frozen=True)
class CraneParts:
    """Names of the bodies of a crane beside hook, rope and load, which every crane has.

    Attributes:
        standing: Bodies that stand, such as a mast.
        moving: Bodies above the rope that drives move, such as jib and trolley.
        own: Parts of the crane that are obstacles to what hangs, by the name of the obstacle, with
            the bodies that keep from them.
        undrawn: Links that drives move and of which the description draws nothing.
    """

    standing: tuple[str, ...]
    moving: tuple[str, ...]
    own: Mapping[str, tuple[str, ...]]
    undrawn: tuple[str, ...] = ()

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of all bodies that keep from the solids of a site."""
        return *self.standing, *self.moving, *HANGING


@dataclass(frozen=True, eq=False, kw_only=True)
class HangingBodies:
    """Bodies of a crane that hang, in the frame of the joint that carries the load.

    Attributes:
        hook: The box around the hook, above the load.
        load: Corners of the load about the end of the cable [m], shape (n, 3), in the frame of the
            hoist joint. The load is their convex hull.
        falls: Radius about the cable's axis within which the falls of the rope run [m]: half the
            width of the hook's block.
        hook_turn: Rotation from the frame of the hoist joint to that of the crane with its drives
            at zero and the load plumb, about Z, shape (3, 3).
    """

    hook: BoundingBox
    load: np.ndarray
    falls: float
    hook_turn: np.ndarray

    @cached_property
    def spread(self) -> float:
        """Largest distance of rope, hook or load from the plumb line [m]."""
        radii = [self.falls, *(_largest_radius(box) for box in self._boxes)]
        radii.append(np.linalg.norm(self.load[:, :2], axis=1).max())
        return float(max(radii))

    @property
    def _boxes(self) -> Sequence[BoundingBox]:
        """Boxes that `spread` counts."""
        return (self.hook,)

    @cached_property
    def below(self) -> float:
        """Largest distance of a point of the load from the end of the cable [m]: no point is
        farther from the pivot than l and this.
        """
        return float(np.linalg.norm(self.load, axis=1).max())


@dataclass(frozen=True, eq=False, kw_only=True)
class CollisionBodies(HangingBodies):
    """Bodies of a tower crane, each in the frame of the joint that carries it.

    Attributes:
        mast: Corners of the hulls of the mast and its foot [m], shape (n, 3) each.
        upper: Shapes that slew, jib and counter-jib among them.
        trolley: The box around the trolley.
    """

    mast: list[np.ndarray]
    upper: list[DrawnShape]
    trolley: BoundingBox

    @property
    def _boxes(self) -> Sequence[BoundingBox]:
        """The trolley rolls above the load, and `spread` counts it, too."""
        return self.trolley, self.hook


Bodies = TypeVar("Bodies", bound=HangingBodies)
"""Bodies of any crane."""


def with_hook_above_rigging(bodies: Bodies, site: Site) -> Bodies:
    """Return bodies with the hook block where the rigging of a site has it: its saddle above the
    lifting points by the height of slings and spreader, and the block as high as it is entered.
    Where that height does not follow from what is entered, the hook stays as the description draws
    it, just above the load. The falls of the rope run to the load, so that what is as wide as the
    block is compared all the way down.
    """
    rigging = rigging_height(site.details)
    if rigging is None or site.load is None:
        return bodies
    middle = float(site.load[:, 2].min() + site.load[:, 2].max()) / 2.0
    saddle = middle + attachment_height(site.details, site.load) + rigging
    width, depth, drawn_height = bodies.hook.size
    height = site.details.hook_block_height or float(drawn_height)
    x, y, _ = bodies.hook.centre
    hook = BoundingBox(np.array([x, y, saddle + height / 2.0]), np.array([width, depth, height]))
    return replace(bodies, hook=hook)


def collision_bodies(crane: Crane, load: np.ndarray | None = None) -> CollisionBodies:
    """Return the bodies of a crane from the boxes, cylinders and spheres in its URDF.

    Of the link at the hook, shapes whose middle is above the largest shape are the hook; all others
    are the load, and several of them count as the box around them. Where no hook is drawn, a cube
    with sides of twice `ROPE_RADIUS` stands for it.

    Args:
        crane: The crane.
        load: Corners of another load about the end of the cable [m], shape (n, 3), X across the jib
            and Y against it; the hook then stands on top of it. None for the load that is drawn.

    Raises:
        MissingRole: If it is not a tower crane.
        ModelError: If it moves in other joints, too, or otherwise than a tower crane, see
            `refuse_other_kinematics`; if a shape cannot be read, see `read_shapes`; or if the URDF
            shows no shapes where one is needed.
    """
    refuse_other_kinematics(crane)
    slew, trolley, radial, tangential, hoist = crane.layout.tower("Clearance")
    # Pinocchio counts joints from 1; 0 is the world, in which the mast stands. The links between
    # the swing joints hang at the pivot. What they draw counts as part of the trolley, as if it did
    # not turn with the swing: it is taken to be small beside the trolley.
    carriers = {
        "mast": [0],
        "upper structure": [slew + 1],
        "trolley": [trolley + 1, radial + 1, tangential + 1],
        "payload": [hoist + 1],
    }
    shapes = _shapes(crane)
    groups: dict[str, list[DrawnShape]] = {}
    for name, joints in carriers.items():
        groups[name] = []
        for joint in joints:
            groups[name] += shapes.get(joint, [])
    for name in ("upper structure", "trolley", "payload"):
        if not groups[name]:
            raise ModelError(
                f"The URDF of the crane shows no shapes of its {name}; clearance needs boxes, "
                "cylinders or spheres."
            )
    drawn = drawn_payload(groups["payload"])
    turn = hook_turn(crane)
    carried = drawn.load
    hook_rise = 0.0
    if load is not None:
        carried = load @ turn  # rows are turned back into the frame of the joint
        # The hook is as far above the load that is carried as it is drawn above the largest shape.
        hook_rise = float(load[:, 2].max()) - drawn.top
    if drawn.hook:
        hook = box_around(np.concatenate(drawn.hook) + np.array([0.0, 0.0, hook_rise]))
        falls = float(np.ptp(drawn.block[:, :2], axis=0).max()) / 2.0
    else:
        hook = small_hook(carried)
        falls = ROPE_RADIUS
    return CollisionBodies(
        mast=_mast(groups["mast"]),
        upper=groups["upper structure"],
        trolley=box_around(np.concatenate([corners_of(shape) for shape in groups["trolley"]])),
        hook=hook,
        load=carried,
        falls=falls,
        hook_turn=turn,
    )


class DrawnPayload(NamedTuple):
    """The link at the hook, as the URDF draws it; corners about the end of the cable [m], shape
    (n, 3) each.

    Attributes:
        load: Corners of the load.
        top: Height of the top of its largest shape [m].
        hook: Corners of each shape of the hook with its block and slings; none where no hook is
            drawn.
        block: The highest of them, from which the falls of the rope go up; the load where there is
            no hook.
    """

    load: np.ndarray
    top: float
    hook: list[np.ndarray]
    block: np.ndarray


def drawn_payload(shapes: list[DrawnShape]) -> DrawnPayload:
    """Tell load and hook apart among the shapes of a link."""

    def volume(points: np.ndarray) -> float:
        return float(np.prod(np.ptp(points, axis=0)))

    def highest(points: np.ndarray) -> float:
        return float(points[:, 2].max())

    corners = [corners_of(shape) for shape in shapes]
    top = highest(max(corners, key=volume))
    hook = [points for points in corners if points[:, 2].mean() > top]
    load = [points for points in corners if not points[:, 2].mean() > top]
    if len(load) > 1:
        load = [box_around(np.concatenate(load)).corners]
    return DrawnPayload(load[0], top, hook, max(hook, key=highest, default=load[0]))


def small_hook(load: np.ndarray | None) -> BoundingBox:
    """Return the box that stands for a hook that is not drawn, on top of a load."""
    top = 0.0 if load is None else float(load[:, 2].max())
    side = 2.0 * ROPE_RADIUS
    return BoundingBox(np.array([0.0, 0.0, top + ROPE_RADIUS]), np.array([side, side, side]))


def hook_turn(crane: Crane) -> np.ndarray:
    """Return the rotation from the frame of the hoist joint to that of the crane, with both drives
    that carry the rope at zero and the load plumb, shape (3, 3).
    """
    q = crane.start.q.copy()
    q[crane.layout.drives[:2]] = 0.0
    q = crane.hanging(q)
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    return data.oMi[crane.payload.body + 1].rotation.copy()


def refuse_other_kinematics(crane: Crane) -> None:
    """Refuse a tower crane whose joints are not where the formulas of a planned lift have them.

    Joints with the axes of a tower crane may stand anywhere: the hoist may have another coordinate
    than the cable length, the swing joints may be apart from each other, and the trolley may have
    its zero beside the slew axis. A planned lift rests on the frames of `_expected_frames`.

    Raises:
        MissingRole: If it is not a tower crane.
        ModelError: If it moves in other joints, too, or a joint is elsewhere; with its name.
    """
    layout = crane.layout
    joints = layout.tower("A planned lift")
    at_zero = _frames(crane, np.zeros(layout.n))
    turn = at_zero[-1].rotation
    # Positions are affine in radius and cable length. One posture shows the origins of the joints,
    # and another one, in which no coordinate is zero, their axes.
    for coordinates in (np.zeros(5), np.array([0.7, 11.0, 0.2, -0.3, 13.0])):
        q = np.zeros(layout.n)
        q[list(joints)] = coordinates
        frames = _frames(crane, q)
        expected_frames = _expected_frames(coordinates, at_zero)
        for joint, frame, expected in zip(joints, frames, expected_frames, strict=True):
            off = float(np.linalg.norm(frame.translation - expected.translation))
            turned = float(np.abs(frame.rotation - expected.rotation).max())
            if not (off <= _POSITION_TOLERANCE and turned <= _ROTATION_TOLERANCE):
                raise ModelError(
                    "A planned lift needs the joints of a tower crane where this project's crane "
                    f"has them. At {layout.coordinates_text(q)} the frame of "
                    f"{layout.joints[joint].name} is {off:.4g} m from there, and entries of its "
                    f"rotation differ by up to {turned:.4g}. In the URDF the frames of slew, "
                    "trolley and swings need Z up and the jib along -Y, both swing joints the "
                    "origin of the trolley, which at zero is on the slew axis, and the hoist the "
                    "cable length as its coordinate."
                )
    if not np.abs(turn[:, 2] - np.array([0.0, 0.0, 1.0])).max() <= _ROTATION_TOLERANCE:
        raise ModelError(
            f"A planned lift needs the frame of {layout.joints[joints[-1]].name} with its Z axis "
            "up along the rope; turn the origin of the joint in the URDF."
        )


def _expected_frames(coordinates: np.ndarray, at_zero: list[pin.SE3]) -> list[pin.SE3]:
    """Return where a planned lift has the frames of slew, trolley, radial swing, tangential swing
    and hoist.

    The pivot is at (x sin γ, -x cos γ, height), and the load l below it along the rope. The frames
    up to the trolley are turned by Rz(γ), the rope by Rz(γ) Rx(φ) Ry(θ).

    Args:
        coordinates: γ [rad], x [m], φ, θ [rad] and l [m], shape (5,).
        at_zero: The frames of the crane itself with all coordinates at zero, of which the heights
            of slew and trolley are taken, and how the frame of the hoist is turned.
    """
    gamma, x, phi, theta, length = coordinates.tolist()
    slew_at_zero, trolley_at_zero, *_, hoist_at_zero = at_zero
    slewed = rotation_z(gamma)
    leaning = slewed @ pin.rpy.rpyToMatrix(phi, 0.0, 0.0)
    along_rope = leaning @ pin.rpy.rpyToMatrix(0.0, theta, 0.0)
    ring = np.array([0.0, 0.0, slew_at_zero.translation[2]])
    pivot = np.array([x * math.sin(gamma), -x * math.cos(gamma), trolley_at_zero.translation[2]])
    end_of_cable = pivot - length * along_rope[:, 2]
    return [
        pin.SE3(slewed, ring),
        pin.SE3(slewed, pivot),
        pin.SE3(leaning, pivot),
        pin.SE3(along_rope, pivot),
        pin.SE3(along_rope @ hoist_at_zero.rotation, end_of_cable),
    ]


def _frames(crane: Crane, q: np.ndarray) -> list[pin.SE3]:
    """Return the frames of slew, trolley, radial swing, tangential swing and hoist of a tower crane
    at coordinates of all joints, shape (n,).
    """
    joints = crane.layout.tower("The frames of a tower crane")
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    return [data.oMi[joint + 1].copy() for joint in joints]  # Pinocchio counts joints from 1


def _mast(shapes: list[DrawnShape]) -> list[np.ndarray]:
    """Return the corners of two groups of bars, whose hulls stand for a hundred bars: all bars that
    reach above a quarter of the height, and those of the foot; shape (n, 3) each.
    """
    corners = [corners_of(shape) for shape in shapes]
    quarter = max((float(points[:, 2].max()) for points in corners), default=0.0) / 4.0
    high = [points for points in corners if points[:, 2].max() > quarter]
    low = [points for points in corners if not points[:, 2].max() > quarter]
    return [np.concatenate(group) for group in (high, low) if group]


def shape_corners(crane: Crane) -> list[tuple[int, np.ndarray]]:
    """Return every shape in the URDF: the joint that carries it (0 for none), and its corners in
    the frame of that joint [m].
    """
    corners = []
    for joint, shapes in _shapes(crane).items():
        for shape in shapes:
            corners.append((joint, corners_of(shape)))
    return corners


def _shapes(crane: Crane) -> dict[int, list[DrawnShape]]:
    """Return all shapes in a URDF, those of ``<visual>`` and of ``<collision>``, by the joint that
    carries them; 0 is the world.

    Raises:
        ModelError: As `read_shapes`.
    """
    return read_shapes(crane, ET.fromstring(crane.urdf))


def read_shapes(crane: Crane, robot: ET.Element, advice: str = "") -> dict[int, list[DrawnShape]]:
    """Return all shapes that links show, by the joint of Pinocchio that carries them; 0 is the
    world.

    Pinocchio's reader leaves out a shape that it cannot read, such as one without a size. A body
    that is left out would count as no body, so that such shapes are refused.

    Args:
        crane: The crane.
        robot: The element ``<robot>`` of its URDF, with the shapes that count.
        advice: A sentence that errors about other shapes end with.

    Raises:
        ModelError: If a link shows another shape than a box, a cylinder or a sphere, one without a
            size, or one that Pinocchio's reader left out.
    """
    expected = 0
    for link in robot.iterfind("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            _check_shape(element, link.get("name", ""), advice)
            expected += 1
    text = ET.tostring(robot, encoding="unicode")
    shapes: dict[int, list[DrawnShape]] = {}
    for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
        for shape in pin.buildGeomFromUrdfString(crane.model, text, kind).geometryObjects:
            placement = shape.placement
            drawn = DrawnShape(shape.geometry, placement.rotation, placement.translation)
            shapes.setdefault(int(shape.parentJoint), []).append(drawn)
    found = sum(len(of_joint) for of_joint in shapes.values())
    if found != expected:
        raise ModelError(
            f"Of {expected} shapes of the crane {found} could be read; check each <geometry> and "
            "<origin> of its description."
        )
    return shapes


def _check_shape(element: ET.Element, link: str, advice: str) -> None:
    """Refuse a shape that clearance does not know, or that has no size; see `read_shapes`.

    Raises:
        ModelError: With the link and the shape.
    """
    geometry = element.find("geometry")
    shape = None if geometry is None or not len(geometry) else geometry[0]
    sizes = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
    if shape is None or shape.tag not in sizes:
        shown = "no shape" if shape is None else f"a {shape.tag}"
        sentence = (
            f"The link {link} of the crane shows {shown}; clearance needs boxes, cylinders or "
            "spheres."
        )
        raise ModelError(f"{sentence} {advice}".rstrip())
    words = " ".join(shape.get(name, "") for name in sizes[shape.tag]).split()
    try:
        has_size = len(words) > 0 and all(float(word) > 0.0 for word in words)
    except ValueError:
        has_size = False
    if not has_size:
        raise ModelError(
            f"A {shape.tag} of the link {link} of the crane has a size that is not above 0."
        )


def corners_of(shape: DrawnShape) -> np.ndarray:
    """Return the corners of the box around a shape along its own axes, in the frame of the joint
    [m], shape (8, 3).
    """
    shape.geometry.computeLocalAABB()
    low = shape.geometry.aabb_local.min_
    high = shape.geometry.aabb_local.max_
    xs, ys, zs = zip(low, high, strict=True)
    box = np.array(list(itertools.product(xs, ys, zs)))
    return box @ shape.rotation.T + shape.translation


def _largest_radius(box: BoundingBox) -> float:
    """Return the largest distance of a corner of a box from the Z axis [m]."""
    x, y = np.abs(box.centre[:2]) + box.size[:2] / 2.0
    return float(np.hypot(x, y))


def box_around(points: np.ndarray) -> BoundingBox:
    """Return the box around points [m], shape (n, 3)."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    return BoundingBox((low + high) / 2.0, high - low)


def parked_position(crane: Crane, drives: Sequence[float]) -> np.ndarray:
    """Return the coordinates of a crane that stands still with its rope plumb, shape (n,).

    Args:
        crane: The crane.
        drives: Positions of its drives, in their order [rad or m].

    Raises:
        OutOfRange: If there is another number of drives, or a drive cannot stand there.
    """
    count = len(crane.layout.driven)
    if len(drives) != count:
        raise OutOfRange("positions of the drives", f"{len(drives)} numbers", f"{count} numbers")
    q = crane.start.q.copy()
    layout = crane.layout
    for index, joint, position in zip(layout.drives, layout.driven, drives, strict=True):
        lower = float(crane.lower[index])
        upper = float(crane.upper[index])
        q[index] = within(f"position of {joint.symbol}", position, lower, upper, joint.unit)
    # A swing joint is measured from the link before it, which leans where a boom luffs.
    q[crane.swings] = 0.0
    q[crane.swings] = -crane.swing_angles(q)
    return q


def neighbour(
    name: str,
    crane: Crane,
    q: np.ndarray,
    position: np.ndarray,
    heading: float,
    *,
    standing: bool = True,
) -> list[Solid]:
    """Return a parked crane as an obstacle: all that its description draws, with hook and load, and
    its rope.

    Args:
        name: Its name.
        crane: The crane.
        q: Its coordinates, shape (n,), see `parked_position`.
        position: Foot of its mast [m], shape (3,); of a crane that travels the origin of its frame.
        heading: Direction of its jib at zero slew, from X towards Y [rad]; of a crane that travels
            the direction of -Y of its frame.
        standing: Whether what stands of it counts. A crane on the runway of another one has no
            rails and columns of its own.

    Raises:
        CraneError: If its shapes cannot be read.
    """
    rotation = rotation_z(heading + math.pi / 2.0)  # its jib points along -Y at zero slew
    parts = []
    corners = []
    triangles = []
    corner_count = 0
    for points in _parts(crane, q, standing=standing):
        placed = points @ rotation.T + position
        hull_corners, hull_triangles = convex_hull(placed)
        parts.append(placed)
        corners.append(hull_corners)
        # Each hull counts its corners from zero. In the solid they follow those before.
        triangles.append(hull_triangles + corner_count)
        corner_count += len(hull_corners)
    return [Solid(name, tuple(parts), np.vstack(corners), np.vstack(triangles))]


def _parts(crane: Crane, q: np.ndarray, *, standing: bool) -> list[np.ndarray]:
    """Return the corners of all shapes of a crane and of its rope at coordinates of all joints, in
    the crane's own frame [m], shape (n, 3) each; without those of what stands if that does not
    count.
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    shapes = []
    for joint, corners in shape_corners(crane):
        if joint == 0 and not standing:
            continue
        frame = data.oMi[joint]
        placed = frame.rotation @ corners.T + frame.translation[:, None]
        shapes.append(placed.T)
    if crane.winch is None:
        return shapes

    # The rope hangs plumb: a square column around its falls, from the pivot to the load.
    falls = ROPE_RADIUS
    if crane.layout.has("slew", "trolley"):
        crane.layout.tower("A parked neighbour")
        falls = collision_bodies(crane).falls
    square = np.array([[x, y, 0.0] for x, y in itertools.product((-falls, falls), repeat=2)])
    upper_end = data.oMi[int(crane.swings[0]) + 1].translation + square
    lower_end = data.oMi[int(crane.layout.drives[crane.winch]) + 1].translation + square
    rope = np.vstack([upper_end, lower_end])
    return [*shapes, rope]
