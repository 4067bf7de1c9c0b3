"""What is drawn of a crane: the visuals of its URDF, its rope, and marks where its load touches.

Visuals are boxes, cylinders and spheres, and meshes from a folder that the caller names. A crane
that shows nothing gets sticks between its joints. A rope that is slack sags.

`rerun.urdf.UrdfTree.log_urdf_to_recording` could log the visuals, but it would lose three things:

* Size. It logs each visual as an entity of its own: 1.7 MB for the 252 visuals of the shipped tower
  crane, where `cranedyn.recording.scene` logs the shapes of one kind on a link as one entity.
* Safety. It reads mesh files from any path that the URDF names. `_mesh_path` refuses those outside
  of the folder.
* Colours. Payloads take the colour of their run, and cranes that overlap are transparent.

`UrdfTree` does compute the transforms of the joints, see `cranedyn.recording.scene.Scene`.
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from cranedyn.command import uninterrupted_import
from cranedyn.data.files import read_bytes
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import ON_GROUND
from cranedyn.dynamics.equations_of_motion import body_points
from cranedyn.errors import DataError, quoted
from cranedyn.model.crane import Crane, Point
from cranedyn.model.heavy_rope import rope_bodies
from cranedyn.model.springs import Bifilar, Rope

CONTACT = "#F22B05"
"""Colour of the marks where a load touches."""

_SIZE_ATTRIBUTES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
"""Attributes of a geometry in a URDF that make up `Shape.size`, by its tag."""

_MESH_KINDS = ("stl", "obj", "ply", "dae", "glb")
"""Kinds of mesh files that are read, by their ending."""

_MAX_MESH_BYTES = 20_000_000
"""Size of the largest mesh file that is read [bytes]."""

_CIRCLE_POINTS = 12
"""Number of corners with which a circle is drawn."""

_STICK_RATIO = 0.01
"""Radius of the sticks as a share of the longest; in metres where none has a length."""

_MAX_STICK_RADIUS = 0.2
"""Largest radius of sticks [m]: rails are long, and what they carry would be hidden behind them."""

_MAX_RAIL = 100.0
"""Largest coordinate to which the rail of a sliding joint is drawn [m]; ranges may be endless."""

_OVERHANG_RATIO = 0.05
"""Share of its length by which a rail on legs is longer at each end, so that what hangs from it at
an end is not inside of a leg."""

_SAG_POINTS = 9
"""Number of points with which a rope that sags is drawn."""

_TOUCHING_HEIGHT = 5e-3
"""Height above the lowest point of a load up to which its other points are marked, too [m]."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One visual of a link.

    Attributes:
        kind: "box", "cylinder", "sphere" or "mesh".
        size: Three edges of a box, radius and length of a cylinder, the radius of a sphere, or the
            three edges of the bounding box of a mesh [m].
        centre: Position of the centre in the frame of the link [m].
        rpy: Roll, pitch and yaw in that frame [rad].
        colour: Red, green, blue and alpha, 0 to 1.
        mesh: The `trimesh.Trimesh` of a mesh, in the frame of the link.
    """

    kind: str
    size: tuple[float, ...]
    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    colour: tuple[float, ...] = (0.5, 0.5, 0.5, 1.0)
    mesh: Any = None

    def hull_points(self) -> np.ndarray:
        """Return points whose convex hull is that of the shape, in the frame of the link [m], shape
        (n, 3).

        Circles are polygons of 12 corners.
        """
        if self.mesh is not None:
            return np.asarray(self.mesh.vertices)
        if self.kind == "box":
            points = _unit_cube() * self.size
        elif self.kind == "cylinder":
            points = self._cylinder_points()
        else:
            points = self._sphere_points()
        turned = Rotation.from_euler("xyz", self.rpy).apply(points)
        return np.asarray(turned + self.centre)

    def segments(self) -> np.ndarray | None:
        """Return segments of which a box or a cylinder is the sum: vectors in the frame of the link
        [m], shape (n, 3).

        The sum of segments is what the sums of one point of each of them fill, all of them centred
        at the centre of the shape. A box is the sum of three edges. A cylinder is the sum of its
        axis and of half the edges of its circle, a regular polygon, see `hull_points`.

        Returns:
            The segments; None for a sphere or a mesh, which are no such sum.
        """
        if self.mesh is not None or self.kind == "sphere":
            return None
        if self.kind == "box":
            vectors = np.diag(self.size)
        else:
            radius, length = self.size
            corners = radius * _unit_circle()
            edges = np.diff(corners[: _CIRCLE_POINTS // 2 + 1], axis=0)
            vectors = np.concatenate([edges, [[0.0, 0.0, length]]])
        return np.asarray(Rotation.from_euler("xyz", self.rpy).apply(vectors))

    def _cylinder_points(self) -> np.ndarray:
        """Return the corners of both ends of a cylinder about Z [m], shape (n, 3)."""
        radius, length = self.size
        circle = radius * _unit_circle()
        to_end = np.array([0.0, 0.0, 0.5 * length])
        return np.concatenate([circle - to_end, circle + to_end])

    def _sphere_points(self) -> np.ndarray:
        """Return points on circles of latitude of a sphere, from pole to pole [m], shape (n, 3)."""
        radius = self.size[0]
        circle = _unit_circle()
        circles = []
        for latitude in np.linspace(-0.5 * np.pi, 0.5 * np.pi, _CIRCLE_POINTS // 2 + 1):
            circles.append(radius * (np.cos(latitude) * circle + [0.0, 0.0, np.sin(latitude)]))
        return np.concatenate(circles)


def _unit_cube() -> np.ndarray:
    """Return the corners of a cube of edge 1 about the origin, shape (8, 3)."""
    ends = [-0.5, 0.5]
    x, y, z = np.meshgrid(ends, ends, ends)
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _unit_circle() -> np.ndarray:
    """Return the corners of a circle of radius 1 about Z, shape (n, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


# --- shapes of a URDF -----------------------------------------------------------------------------


def shapes(urdf: str, folder: str | Path | None = None) -> dict[str, list[Shape]]:
    """Return the shapes that are drawn of each link of a URDF, by the name of the link.

    Sticks, see `_sticks`, stand for a link of which only meshes are known and left out. Where no
    link has a visual, they stand for all links but those in whose place a rope is drawn.

    Args:
        urdf: The URDF with all macros expanded; its numbers and names have been checked.
        folder: Folder of the mesh files; None leaves meshes out. Of ``package://NAME/FILE`` the
            file is FILE.

    Raises:
        DataError: If a mesh file is outside of the folder, missing, larger than 20 MB, of an
            unknown kind, or not readable as a mesh.
    """
    robot = ET.fromstring(urdf)
    materials = _materials(robot)
    visuals = dict[str, list[Shape]]()
    without_shapes = set[str]()
    for link in robot.iterfind("link"):
        name = link.get("name", "")
        visuals[name] = []
        for visual in link.iterfind("visual"):
            shape = _read_shape(visual, materials, folder)
            if shape is not None:
                visuals[name].append(shape)
        has_meshes = link.find("visual/geometry/mesh") is not None
        if has_meshes and not visuals[name]:
            without_shapes.add(name)

    shows_nothing = not any(visuals.values())
    if shows_nothing and not without_shapes:
        without_shapes = set(visuals) - _rope_links(robot)
    if without_shapes:
        visuals.update(_sticks(robot, without_shapes))
    return visuals


def visible_points(
    crane: Crane, q: np.ndarray, folder: str | Path | None = None
) -> Iterator[tuple[Shape, np.ndarray]]:
    """Yield each shape of a crane with its hull points in the world [m], shape (n, 3).

    Args:
        crane: The crane.
        q: Coordinates [rad or m], shape (n,).
        folder: Folder of the mesh files; None leaves meshes out.
    """
    data = crane.model.createData()
    pin.framesForwardKinematics(crane.model, data, q)
    for link, link_shapes in shapes(crane.urdf, folder).items():
        pose = data.oMf[crane.model.getFrameId(link, pin.BODY)]
        for shape in link_shapes:
            yield shape, shape.hull_points() @ pose.rotation.T + pose.translation


def _materials(robot: ET.Element) -> dict[str | None, str]:
    """Return the colours that materials of a URDF define, as texts, by the name of the material."""
    materials = dict[str | None, str]()
    for material in robot.iter("material"):
        color = material.find("color")
        if color is not None:
            materials[material.get("name")] = color.get("rgba", "")
    return materials


def _read_shape(
    visual: ET.Element, materials: Mapping[str | None, str], folder: str | Path | None
) -> Shape | None:
    """Return the shape of a visual; None for a mesh without a folder, or an unknown geometry."""
    geometry = visual.find("geometry/*")
    if geometry is None or geometry.tag not in (*_SIZE_ATTRIBUTES, "mesh"):
        return None
    origin = visual.find("origin")
    # Without an origin the frame of the visual is that of the link.
    pose = ET.Element("origin") if origin is None else origin
    centre = _floats(pose.get("xyz", "0 0 0"))
    rpy = _floats(pose.get("rpy", "0 0 0"))
    colour = _read_colour(visual, materials)
    if geometry.tag == "mesh":
        if folder is None:
            return None
        return _read_mesh(geometry, centre, rpy, colour, Path(folder))

    attributes = [geometry.get(name, "") for name in _SIZE_ATTRIBUTES[geometry.tag]]
    size = _floats(" ".join(attributes))
    return Shape(geometry.tag, size, centre, rpy, colour)


def _read_colour(visual: ET.Element, materials: Mapping[str | None, str]) -> tuple[float, ...]:
    """Return the colour of a visual: its own, that of its material, or grey."""
    material = visual.find("material")
    color = visual.find("material/color")
    rgba = ""
    if color is not None:
        rgba = color.get("rgba", "")
    elif material is not None:
        rgba = materials.get(material.get("name"), "")
    return _floats(rgba or "0.5 0.5 0.5 1")


def _read_mesh(
    geometry: ET.Element,
    centre: tuple[float, ...],
    rpy: tuple[float, ...],
    colour: tuple[float, ...],
    folder: Path,
) -> Shape:
    """Return the shape of a mesh, whose vertices are moved into the frame of the link."""
    scale = _floats(geometry.get("scale", "1 1 1"))
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix() * scale
    transform[:3, 3] = centre
    mesh = _load_mesh(geometry.get("filename", ""), folder, transform)
    low, high = mesh.bounds
    edges = tuple(high - low)
    middle = tuple((low + high) / 2.0)
    return Shape("mesh", edges, middle, colour=colour, mesh=mesh)


def _load_mesh(name: str, folder: Path, transform: np.ndarray) -> Any:
    """Return a mesh file as a `trimesh.Trimesh`, transformed by a homogeneous matrix.

    Args:
        name: Name of the file, as the URDF has it.
        folder: Folder in which it must be.
        transform: The matrix, shape (4, 4).

    Raises:
        DataError: As `shapes`.
    """
    # It takes long to import, and only meshes need it.
    trimesh = uninterrupted_import("trimesh")
    path = _mesh_path(name, folder)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _MESH_KINDS:
        raise DataError(
            f"The mesh {quoted(name)} is of the kind {quoted(kind)}; allowed are "
            f"{', '.join(_MESH_KINDS)}."
        )
    content = io.BytesIO(read_bytes(path, _MAX_MESH_BYTES))
    try:
        # The colour is that of the URDF.
        mesh: Any = trimesh.load(content, file_type=kind, force="mesh", skip_materials=True)
        mesh.apply_transform(transform)
        vertices = np.asarray(mesh.vertices)
        normals = np.asarray(mesh.vertex_normals)
    except Exception as error:  # parsers of mesh files raise anything
        raise DataError(
            f"The mesh {quoted(name)} cannot be read: {type(error).__name__}."
        ) from error
    is_finite = np.isfinite(vertices).all() and np.isfinite(normals).all()
    if not len(mesh.faces) or not is_finite:
        raise DataError(f"The mesh {quoted(name)} has no triangles, or values that are not finite.")
    return mesh


def _mesh_path(name: str, folder: Path) -> Path:
    """Return the path of a mesh file inside of a folder.

    Raises:
        DataError: If it is outside. A URDF of a stranger must not copy files of this machine into a
            recording.
    """
    relative = re.sub(r"^package://[^/]*/|^file://", "", name)
    path = (folder / relative).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise DataError(
            f"The mesh {quoted(name)} is outside of the folder {folder}; meshes are read from "
            "there alone."
        )
    return path


def _floats(text: str) -> tuple[float, ...]:
    """Return the numbers of a text, which spaces separate."""
    return tuple(float(word) for word in text.split())


# --- sticks ---------------------------------------------------------------------------------------


def _rope_links(robot: ET.Element) -> set[str]:
    """Return the links in whose place a rope is drawn: those on which a link slides that carries no
    other, which is the load on its rope.
    """
    parent_of = dict[str, str]()
    sliding = set[str]()
    for joint in robot.iterfind("joint"):
        parent = joint.find("parent")
        child = joint.find("child")
        if parent is None or child is None:
            continue
        parent_of[child.get("link", "")] = parent.get("link", "")
        if joint.get("type") == "prismatic":
            sliding.add(child.get("link", ""))
    leaves = parent_of.keys() - parent_of.values()
    return {parent_of[link] for link in leaves & sliding}


def _sticks(robot: ET.Element, links: Collection[str]) -> dict[str, list[Shape]]:
    """Return cylinders that stand for links: from the origin of each to its joints, and rails as
    long as its joints slide. A ball stands for a joint near the origin.
    """
    children = {child.get("link", "") for child in robot.iterfind("joint/child")}
    lines: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {link: [] for link in links}
    for joint in robot.iterfind("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.get("link", "") in links:
            link = parent.get("link", "")
            lines[link] += _joint_lines(joint, on_ground=link not in children)

    longest = 0.0
    for link_lines in lines.values():
        for start, end in link_lines:
            longest = max(longest, float(np.linalg.norm(end - start)))
    radius = min(_STICK_RATIO * longest or _STICK_RATIO, _MAX_STICK_RADIUS)

    result = dict[str, list[Shape]]()
    for link, link_lines in lines.items():
        result[link] = [_stick(start, end, radius) for start, end in link_lines]
    return result


def _joint_lines(joint: ET.Element, *, on_ground: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the lines that lead to a joint in the frame of its parent link, as pairs of ends [m].

    Args:
        joint: The joint.
        on_ground: Whether the parent link is the root, whose origin lies on the ground.
    """
    origin = joint.find("origin")
    pose = {} if origin is None else origin.attrib
    place = np.array(_floats(pose.get("xyz", "0 0 0")))
    limit = joint.find("limit")
    if joint.get("type") != "prismatic" or limit is None:
        return [(np.zeros(3), place)]
    axis = joint.find("axis")
    # The axis of a joint is X if the URDF names none.
    direction = np.array(_floats("1 0 0" if axis is None else axis.get("xyz", "1 0 0")))
    direction = Rotation.from_euler("xyz", _floats(pose.get("rpy", "0 0 0"))).apply(direction)
    direction /= np.linalg.norm(direction)
    lower, upper = np.clip(
        [float(limit.get("lower", "0")), float(limit.get("upper", "0"))], -_MAX_RAIL, _MAX_RAIL
    )
    first = place + lower * direction
    last = place + upper * direction
    rail = (first, last)
    if on_ground and min(first[2], last[2]) > 0.0:
        # A raised rail stands on two legs.
        overhang = _OVERHANG_RATIO * (last - first)
        first = first - overhang
        last = last + overhang
        return [(first, last), (first * [1, 1, 0], first), (last * [1, 1, 0], last)]
    # The rail hangs on its link where it is nearest to the origin of that.
    nearest = place + np.clip(-place @ direction, lower, upper) * direction
    return [rail] if np.allclose(nearest, 0.0) else [rail, (np.zeros(3), nearest)]


def _stick(start: np.ndarray, end: np.ndarray, radius: float) -> Shape:
    """Return a cylinder between two points [m]; a ball if they are near each other."""
    length = float(np.linalg.norm(end - start))
    centre = tuple((start + end) / 2.0)
    if length <= radius:
        return Shape("sphere", (2.0 * radius,), centre)
    return Shape("cylinder", (radius, length), centre, _turn_z_along(end - start))


def _turn_z_along(axis: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw that turn Z along an axis [rad]."""
    horizontal = float(np.hypot(axis[0], axis[1]))
    pitch = float(np.arctan2(horizontal, axis[2]))
    yaw = float(np.arctan2(axis[1], axis[0]))
    return 0.0, pitch, yaw


# --- rope and contacts ----------------------------------------------------------------------------


def rope_line(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the points of the rope in the world [m], shape (rows, points, 3).

    They are the pivot, the bodies of a rope with mass, the hook if there is one, and the payload. A
    rope without mass that may go slack has points in between, by which it sags. Two falls have the
    ends of both.

    Args:
        crane: The crane.
        q: Coordinates [rad or m], shape (rows, n).
    """
    q = np.asarray(q)
    # The payload is the first point of a crane, and the last of its rope.
    on_rope = [*crane.points[1:], crane.points[0]]
    bodies = [Point("", body, np.zeros(3)) for body in rope_bodies(crane)]
    on_rope[1:1] = bodies  # below the pivot
    points = point_paths(crane, q, on_rope)
    if bodies:
        return points
    if crane.springs.bifilar is not None:
        return _two_falls(crane, crane.springs.bifilar, q, points)
    if crane.springs.rope is not None:
        return _sagging_rope(crane.springs.rope, q, points)
    return points


def _two_falls(crane: Crane, falls: Bifilar, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the points of two falls in the world [m], shape (rows, points, 3): from the centre of
    the load up one fall, across below the pivot, and down the other to the centre again.

    Args:
        crane: The crane.
        falls: The falls.
        q: Coordinates, shape (rows, n).
        points: Pivot, then what hangs below it [m], shape (rows, points, 3).
    """
    # The lower ends yaw with the load. The upper ends do not: they are given in the body that
    # carries the yawing one, which has the same origin, and are then lifted to the pivot.
    load = falls.yaw
    carrier = crane.model.parents[falls.yaw + 1] - 1
    half = 0.5 * falls.spacing
    ends = [(load, -half), (carrier, -half), (carrier, half), (load, half), (load, 0.0)]
    corners = [Point("", body, np.array([0.0, offset, 0.0])) for body, offset in ends]
    path = point_paths(crane, q, corners)
    centre = path[:, 4:]
    pivot = points[:, :1]
    path[:, 1:3] += pivot - centre
    return np.concatenate([centre, path, points[:, 1:]], axis=1)


def _sagging_rope(rope: Rope, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the points of a rope that sags as far as it is slack [m], shape (rows, points, 3).

    Args:
        rope: The rope.
        q: Coordinates, shape (rows, n).
        points: Pivot, then what hangs below it [m], shape (rows, points, 3).
    """
    top = points[:, :1]
    end = points[:, 1:2]
    # A stretch below zero is the length by which the rope is longer than the distance of its ends.
    slack = np.maximum(-q[:, rope.stretch], 0.0)
    # A parabola of depth f over a chord d is longer than the chord by 8 f²/(3 d), to second order
    # in f/d. So it is f = √(3/8 · slack · d).
    chord = np.linalg.norm(end - top, axis=2)[:, 0]
    depth = np.sqrt(0.375 * slack * chord)
    # Share of the chord, from top to end, shape (points, 1). 4 u (1 - u) is a parabola of height 1.
    u = np.linspace(0.0, 1.0, _SAG_POINTS)[:, None]
    sag = (4.0 * u * (1.0 - u) * depth)[..., None].transpose(1, 0, 2)
    # It sags to the side of the chord, diagonally, so that no side view hides it. A chord along
    # the diagonal has no such side; the quotient then must not be 0/0.
    side = np.cross(top - end, [1.0, -1.0, 0.0])
    side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-9)
    return np.concatenate([top + u * (end - top) + sag * side, points[:, 2:]], axis=1)


def touching_points(crane: Crane, run: Trajectory, row: int) -> np.ndarray:
    """Return the lowest of the points of the load that may touch, in the world [m], shape (k, 3).

    There are none where the load does not touch.

    Args:
        crane: The crane.
        run: A run of it. Its record says which points of the load may touch.
        row: Index of the row.
    """
    none = np.zeros((0, 3))
    # A record may come from a file, and hold anything.
    ground = run.record.get("ground", {})
    levers = ground.get("points") if isinstance(ground, dict) else None
    if run.phase is None or run.phase[row] < ON_GROUND or not isinstance(levers, list):
        return none
    points = crane.payload.lever + np.array(levers)
    at_rest = np.zeros(crane.layout.n)
    # Only the positions are needed, not the velocities.
    positions, _ = body_points(
        crane.model, crane.data, crane.payload.body, points, run.q[row], at_rest
    )
    heights = positions[2]
    return positions[:, heights < heights.min() + _TOUCHING_HEIGHT].T
