"""What is drawn of a crane: boxes, cylinders, spheres of its URDF, and meshes from a folder that is
given; its rope, which sags where it is slack; marks where its load stands.

`rerun.urdf.UrdfTree` would log each visual as an entity of its own (1.7 MB for the shipped crane
instead of tens of kB) and would read mesh files from anywhere.
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
from cranedyn.dynamics.pinocchio import body_points
from cranedyn.errors import DataError, quoted
from cranedyn.model.crane import Crane, Point

_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
_MESH_KINDS = ("stl", "obj", "ply", "dae", "glb")
_MAX_MESH_BYTES = 20_000_000
_CIRCLE_POINTS = 12

_STICK = 0.01
"""Radius of sticks as a share of the longest."""

_THICKEST_STICK = 0.2
"""Largest radius of sticks [m]: rails are long, and what they carry would be hidden behind them."""

CONTACT = "#F22B05"
"""Colour of marks where a load touches."""

_SAG_POINTS = 9
"""Points of a rope that sags."""

_LEVEL = 5e-3
"""Height above the lowest point of a load up to which others are marked where it touches [m]."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One visual of a link.

    Attributes:
        kind: "box", "cylinder", "sphere" or "mesh".
        size: Three edges, or radius and length, or radius [m]; of a mesh the edges of its bounding
            box.
        centre: In the frame of the link [m].
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
        """Return points in the frame of the link [m] with the shape as convex hull, shape (n, 3).

        Circles have 12 corners.
        """
        if self.mesh is not None:
            return np.asarray(self.mesh.vertices)
        if self.kind == "box":
            points = np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).reshape(3, -1).T * self.size
        else:
            angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS, endpoint=False)
            circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
            if self.kind == "cylinder":
                rings = [circle * self.size[0] + [0.0, 0.0, s * self.size[1]] for s in (-0.5, 0.5)]
            else:
                latitudes = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _CIRCLE_POINTS // 2 + 1)
                rings = [
                    self.size[0] * (np.cos(a) * circle + [0.0, 0.0, np.sin(a)]) for a in latitudes
                ]
            points = np.concatenate(rings)
        return np.asarray(Rotation.from_euler("xyz", self.rpy).apply(points) + self.centre)


def shapes(urdf: str, folder: str | Path | None = None) -> dict[str, list[Shape]]:
    """Return the visuals of each link of a plain URDF, by name of the link; sticks for a link of
    which only meshes are known that are left out, and for the links of a crane without visuals but
    those that a rope stands for, see `_sticks`.

    Args:
        urdf: The URDF, its numbers and names checked.
        folder: Folder of the mesh files; None leaves meshes out. Of ``package://NAME/FILE`` the
            file is FILE.

    Raises:
        DataError: If a mesh file is outside of the folder, missing, larger than 20 MB, of an
            unknown kind, or not readable as a mesh.
    """
    robot = ET.fromstring(urdf)
    materials = {
        material.get("name"): color.get("rgba", "")
        for material in robot.iter("material")
        if (color := material.find("color")) is not None
    }
    visuals = dict[str, list[Shape]]()
    hidden = set[str]()
    for link in robot.iterfind("link"):
        name = link.get("name", "")
        drawn = (_shape(visual, materials, folder) for visual in link.iterfind("visual"))
        visuals[name] = [shape for shape in drawn if shape is not None]
        if not visuals[name] and link.find("visual/geometry/mesh") is not None:
            hidden.add(name)
    if not hidden and not any(visuals.values()):
        hidden = set(visuals) - _rope_links(robot)  # of a crane that shows nothing
    return visuals | (_sticks(robot, hidden) if hidden else {})


def _rope_links(robot: ET.Element) -> set[str]:
    """Return the links on which a link slides that carries no other: a rope is drawn there."""
    parent_of = dict[str, str]()
    sliding = set[str]()
    for joint in robot.iterfind("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue
        parent_of[child.get("link", "")] = parent.get("link", "")
        if joint.get("type") == "prismatic":
            sliding.add(child.get("link", ""))
    leaves = parent_of.keys() - parent_of.values()
    return {parent_of[link] for link in leaves & sliding}


def _sticks(robot: ET.Element, links: Collection[str]) -> dict[str, list[Shape]]:
    """Return cylinders from the origin of each link to its child joints, or as far as their links
    slide; a ball for a joint at the origin.
    """
    ends: dict[str, list[np.ndarray]] = {link: [] for link in links}
    for joint in robot.iterfind("joint"):
        parent, origin, axis = joint.find("parent"), joint.find("origin"), joint.find("axis")
        if parent is None or parent.get("link", "") not in links:
            continue
        pose = {} if origin is None else origin.attrib
        end = np.array(_floats(pose.get("xyz", "0 0 0")))
        limit = joint.find("limit")
        if joint.get("type") == "prismatic" and limit is not None:
            along = np.array(_floats("1 0 0" if axis is None else axis.get("xyz", "1 0 0")))
            along = Rotation.from_euler("xyz", _floats(pose.get("rpy", "0 0 0"))).apply(along)
            end = end + along / np.linalg.norm(along) * float(limit.get("upper", "0"))
        ends[parent.get("link", "")].append(end)
    lengths = [np.linalg.norm(end) for group in ends.values() for end in group]
    radius = min(_STICK * float(max(lengths, default=0.0)) or _STICK, _THICKEST_STICK)
    return {
        link: [
            Shape("cylinder", (radius, float(np.linalg.norm(end))), (*(end / 2.0),), _upright(end))
            if np.linalg.norm(end) > radius
            else Shape("sphere", (2.0 * radius,))
            for end in group
        ]
        for link, group in ends.items()
    }


def _upright(axis: np.ndarray) -> tuple[float, ...]:
    """Return roll, pitch and yaw that turn Z along an axis [rad]."""
    level = float(np.hypot(*axis[:2]))
    return 0.0, float(np.arctan2(level, axis[2])), float(np.arctan2(axis[1], axis[0]))


def visible_points(
    crane: Crane, q: np.ndarray, folder: str | Path | None = None
) -> Iterator[tuple[Shape, np.ndarray]]:
    """Yield each shape of a crane at coordinates q with its hull points in the world [m]."""
    data = crane.model.createData()
    pin.framesForwardKinematics(crane.model, data, q)
    for link, link_shapes in shapes(crane.urdf, folder).items():
        pose = data.oMf[crane.model.getFrameId(link, pin.BODY)]
        for shape in link_shapes:
            yield shape, shape.hull_points() @ pose.rotation.T + pose.translation


def rope_line(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return pivot, hook if there is one, and payload in the world [m], shape (rows, points, 3), at
    coordinates of shape (rows, n); of a rope that may go slack also points between that sag, of two
    falls their ends.
    """
    order = [*range(1, len(crane.points)), 0]
    points = point_paths(crane, np.asarray(q))[:, order]
    if (falls := crane.springs.bifilar) is not None:
        above = crane.model.parents[falls.yaw + 1] - 1
        a = 0.5 * falls.spacing
        ends = ((falls.yaw, -a), (above, -a), (above, a), (falls.yaw, a), (falls.yaw, 0.0))
        corners = [Point("", body, np.array([0.0, aside, 0.0])) for body, aside in ends]
        path = point_paths(crane, np.asarray(q), corners)
        path[:, 1:3] += points[:, :1] - path[:, 4:]  # from the lower ends up to the pivot
        return np.concatenate([path[:, 4:], path, points[:, 1:]], axis=1)
    if (rope := crane.springs.rope) is None:
        return points
    top = points[:, :1]
    end = points[:, 1:2]
    slack = np.maximum(-np.asarray(q)[:, rope.stretch], 0.0)
    # A parabola of depth f over a chord d is longer than that by 8 f²/(3 d).
    depth = np.sqrt(0.375 * slack * np.linalg.norm(end - top, axis=2)[:, 0])
    u = np.linspace(0.0, 1.0, _SAG_POINTS)[:, None]
    sag = (4.0 * u * (1.0 - u) * depth)[..., None].transpose(1, 0, 2)
    aside = np.cross(top - end, [1.0, -1.0, 0.0])  # diagonal, so that no side view hides it
    aside /= np.maximum(np.linalg.norm(aside, axis=2, keepdims=True), 1e-9)
    return np.concatenate([top + u * (end - top) + sag * aside, points[:, 2:]], axis=1)


def touching_points(crane: Crane, run: Trajectory, row: int) -> np.ndarray:
    """Return the lowest of the points of the load that may touch [m], in the world, shape (k, 3);
    none where the load does not touch.
    """
    ground = run.record.get("ground", {})
    levers = ground.get("points") if isinstance(ground, dict) else None
    if run.phase is None or run.phase[row] < ON_GROUND or not isinstance(levers, list):
        return np.zeros((0, 3))
    points = crane.payload.lever + np.array(levers)
    still = np.zeros(crane.layout.n)
    places = body_points(crane.model, crane.data, crane.payload.body, points, run.q[row], still)[0]
    return places[:, places[2] < places[2].min() + _LEVEL].T


def _shape(
    visual: ET.Element, materials: Mapping[str | None, str], folder: str | Path | None
) -> Shape | None:
    geometry, origin = visual.find("geometry/*"), visual.find("origin")
    if geometry is None or geometry.tag not in (*_SIZES, "mesh"):
        return None
    pose = ET.Element("origin") if origin is None else origin
    centre, rpy = (_floats(pose.get(name, "0 0 0")) for name in ("xyz", "rpy"))
    material, color = visual.find("material"), visual.find("material/color")
    if color is not None:
        rgba = color.get("rgba", "")
    else:
        rgba = "" if material is None else materials.get(material.get("name"), "")
    colour = _floats(rgba or "0.5 0.5 0.5 1")
    if geometry.tag != "mesh":
        size = _floats(" ".join(geometry.get(name, "") for name in _SIZES[geometry.tag]))
        return Shape(geometry.tag, size, centre, rpy, colour)
    if folder is None:
        return None
    transform = np.eye(4)
    scale = _floats(geometry.get("scale", "1 1 1"))
    transform[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix() * scale
    transform[:3, 3] = centre
    mesh = _load_mesh(geometry.get("filename", ""), Path(folder), transform)
    low, high = mesh.bounds
    return Shape("mesh", (*(high - low),), (*((low + high) / 2.0),), colour=colour, mesh=mesh)


def _load_mesh(name: str, folder: Path, transform: np.ndarray) -> Any:
    trimesh = uninterrupted_import("trimesh")  # slow, and needed for meshes only
    path = _mesh_path(name, folder)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _MESH_KINDS:
        raise DataError(
            f"The mesh {quoted(name)} is of the kind {quoted(kind)}; allowed are "
            f"{', '.join(_MESH_KINDS)}."
        )
    content = io.BytesIO(read_bytes(path, _MAX_MESH_BYTES))
    try:
        mesh: Any = trimesh.load(content, file_type=kind, force="mesh", skip_materials=True)
        mesh.apply_transform(transform)
        arrays = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    except Exception as error:  # parsers of mesh files raise anything
        raise DataError(
            f"The mesh {quoted(name)} cannot be read: {type(error).__name__}."
        ) from error
    if not (len(mesh.faces) and all(np.isfinite(array).all() for array in arrays)):
        raise DataError(f"The mesh {quoted(name)} has no triangles, or values that are not finite.")
    return mesh


def _mesh_path(name: str, folder: Path) -> Path:
    path = (folder / re.sub(r"^package://[^/]*/|^file://", "", name)).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise DataError(
            f"The mesh {quoted(name)} is outside of the folder {folder}; meshes are read from "
            "there alone."
        )
    return path


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())
