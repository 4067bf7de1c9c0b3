"""Obstacles of a site: closed bodies, each as triangles to draw and as shapes for distances."""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
from scipy.spatial import ConvexHull

from cranedyn.checks import ShortRepr
from cranedyn.command import uninterrupted_import
from cranedyn.data.files import read_bytes
from cranedyn.errors import DataError, OutOfRange

MESH_ENDINGS = (".stl", ".ply", ".off", ".obj")
"""Endings of mesh files; none of these formats needs another file."""

FARTHEST = 1e7
"""Largest coordinate of a corner [m]: that of national grids, in which doubles are 2e-9 m apart."""

# Otherwise trimesh logs tracebacks of bad files to standard error.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_MOST_NEIGHBOURS = 255
"""Most neighbours of a corner of a convex body, each along an edge, in `coal`."""

_LARGEST_MESH = 50_000_000
_THIN = 1e-6
"""Least thickness of a body [m]."""


@dataclass(frozen=True, eq=False, repr=False)
class Solid(ShortRepr):
    """A closed body in the frame of the site.

    Attributes:
        name: Its name; no two of a site have the same.
        parts: Corners of convex bodies [m], shape (n, 3) each, whose union it is; empty for a
            surface of triangles.
        vertices: Corners of its surface [m], shape (n, 3).
        triangles: Indices of the corners of each triangle, counter-clockwise from outside, shape
            (m, 3).
        zone: Whether it is a zone that load, hook and rope keep out of, and no body.
    """

    name: str
    parts: tuple[np.ndarray, ...]
    vertices: np.ndarray
    triangles: np.ndarray
    zone: bool = False

    def __post_init__(self) -> None:
        """Check what libraries for geometry assume.

        Raises:
            DataError: If a corner lies beyond `FARTHEST`, or a triangle has a corner that there is
                not.
        """
        for points in (*self.parts, self.vertices):
            check_corners(points)
        count = len(self.vertices)
        if not ((self.triangles >= 0) & (self.triangles < count)).all():
            raise DataError(f"a triangle has a corner that there is not; there are {count}.")

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Solid:
        """Return the body, rotated and then translated [m]."""
        parts = tuple(corners @ rotation.T + translation for corners in self.parts)
        return replace(self, parts=parts, vertices=self.vertices @ rotation.T + translation)

    def without_parts(self, indices: Iterable[int]) -> Solid | None:
        """Return the body without some of its convex parts, None if no part is left. Its surface
        stays as it is; it is drawn and not measured.
        """
        left_out = set(indices)
        if not left_out:
            return self
        kept = tuple(part for i, part in enumerate(self.parts) if i not in left_out)
        # A solid without parts would be taken for a surface of triangles.
        return replace(self, parts=kept) if kept else None

    def geometries(self) -> list[coal.CollisionGeometry]:
        """Return shapes for `coal`, in the frame of the corners."""
        if self.parts:
            return [hull(corners) for corners in self.parts]
        surface = coal.BVHModelOBBRSS()
        surface.beginModel(len(self.triangles), len(self.vertices))
        surface.addVertices(self.vertices)
        surface.addTriangles(self.triangles.astype(np.int64))
        surface.endModel()
        return [surface]

    def meets(self, corners: np.ndarray) -> bool:
        """Return whether the convex hull of corners [m], shape (n, 3), and the body have a point in
        common; one inside of the other counts.
        """
        shape, here = hull(corners), coal.Transform3s()
        for geometry in self.geometries():
            if coal.collide(
                shape, here, geometry, here, coal.CollisionRequest(), coal.CollisionResult()
            ):
                return True
        # A surface of triangles is hollow: a hull inside of it touches none of them.
        return self.holds(corners[0])

    def holds(self, point: np.ndarray) -> bool:
        """Return whether a point [m] lies inside of a surface of triangles; for convex parts, whose
        distances show it, always False.
        """
        if self.parts:
            return False
        surface = _trimesh().Trimesh(self.vertices, self.triangles, process=False)
        return bool(surface.contains([point])[0])


def check_corners(points: np.ndarray) -> None:
    """Refuse corners [m] that are not finite or lie beyond `FARTHEST`.

    Raises:
        DataError: If one does.
    """
    beyond = points[~(np.abs(points) <= FARTHEST)]
    if len(beyond):
        allowed = f"{-FARTHEST:g} to {FARTHEST:g} m, in metres"
        raise DataError(f"a corner lies at {beyond[0]:g} m; allowed are {allowed}.")


def convex_hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the convex hull of one point or more.

    Along a principal axis in which the points are thinner than a micrometre, they are made thicker
    by one. Which of them are corners is found where their extents along all principal axes are
    one, since an affine map changes nothing in it but how exact it is.

    Args:
        points: The points [m], shape (n, 3).

    Returns:
        Its corners, shape (m, 3), and its triangles, counter-clockwise from outside, shape (k, 3).

    Raises:
        DataError: If a point lies beyond `FARTHEST`.
    """
    check_corners(points)
    offsets = points - points.mean(axis=0)
    axes = np.linalg.svd(np.vstack([offsets, np.zeros((3, 3))]), full_matrices=False)[2]
    axes[2] *= np.linalg.det(axes)
    for axis in axes[np.ptp(offsets @ axes.T, axis=0) < _THIN]:
        points = np.concatenate([points - axis * _THIN / 2.0, points + axis * _THIN / 2.0])
    scaled = (points - points.mean(axis=0)) @ axes.T
    scaled /= np.ptp(scaled, axis=0)
    hull = ConvexHull(scaled)
    triangles, normals = hull.simplices, hull.equations[:, :3]
    if _most_neighbours(triangles) > _MOST_NEIGHBOURS:
        triangles, normals = _in_strips(scaled, hull)
    a, b, c = np.moveaxis(scaled[triangles], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * normals, axis=1) < 0.0
    triangles = np.where(inward[:, None], triangles[:, ::-1], triangles)
    corners, triangles = np.unique(triangles, return_inverse=True)
    return points[corners], triangles.reshape(-1, 3)


def _in_strips(points: np.ndarray, hull: ConvexHull) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles of a hull and their normals, those of each flat facet in a strip.

    Qhull arranges them around one corner, which then has all others of the facet for neighbours.
    """
    planes, facet = np.unique(hull.equations, axis=0, return_inverse=True)
    strips = []
    for i, plane in enumerate(planes):
        corners = np.unique(hull.simplices[facet.ravel() == i])
        along = points[corners[1]] - points[corners[0]]
        offsets = points[corners] - points[corners].mean(axis=0)
        ring = corners[
            np.argsort(np.arctan2(offsets @ np.cross(plane[:3], along), offsets @ along))
        ]
        k = np.arange(len(ring))
        strip = ring[np.where(k % 2, (k + 1) // 2, len(ring) - k // 2) % len(ring)]
        strips.append(np.column_stack([strip[:-2], strip[1:-1], strip[2:]]))
    return np.concatenate(strips), np.repeat(planes[:, :3], [*map(len, strips)], axis=0)


def _most_neighbours(triangles: np.ndarray) -> int:
    """Return the largest number of neighbours of a corner of a closed surface."""
    return int(np.bincount(triangles.ravel()).max())


def hull(points: np.ndarray) -> coal.Convex:
    """Compute the convex hull of one point [m] or more, shape (n, 3), as a shape for `coal`.

    Raises:
        DataError: If a point lies beyond `FARTHEST`, or a corner has more neighbours than `coal`
            takes.
    """
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices, faces = convex_hull(points)
    if (edges := _most_neighbours(faces)) > (most := _MOST_NEIGHBOURS):
        raise DataError(f"a corner of a convex body has {edges} edges; allowed are {most}.")
    for vertex in vertices:
        corners.append(vertex)
    for face in faces:
        triangles.append(coal.Triangle(*map(int, face)))
    return coal.Convex(corners, triangles)


def rotation_z(yaw: float) -> np.ndarray:
    """Return the rotation about Z by an angle [rad], shape (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def box(
    name: str, centre: Sequence[float], size: Sequence[float], base: float, yaw: float = 0.0
) -> Solid:
    """Return a box that stands upright.

    Args:
        name: Its name.
        centre: Centre of its footprint [m], two numbers.
        size: Length, width, height [m].
        base: Height of its bottom [m].
        yaw: Rotation about Z [rad].
    """
    length, width, height = size
    corners = [[-length, -width], [length, -width], [length, width], [-length, width]]
    turned = np.array(corners) / 2.0 @ rotation_z(yaw)[:2, :2].T
    return prism(name, turned + np.asarray(centre), base, height)


def prism(
    name: str, outline: np.ndarray, base: float, height: float, *, zone: bool = False
) -> Solid:
    """Return a body with an outline [m], shape (n, 2), from a base up to a height above it [m].

    Raises:
        DataError: If the outline crosses itself or encloses nothing, or a corner lies beyond
            `FARTHEST`.
        OutOfRange: If the height is less than a micrometre.
    """
    import shapely

    check_corners(outline)
    if not height >= _THIN:
        raise OutOfRange("height", height, f">= {_THIN:g}", "m")
    check_corners(np.array([base, base + height]))
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid or polygon.area < _THIN:
        raise DataError("an outline must enclose an area and not cross itself.")
    polygon = shapely.geometry.polygon.orient(polygon)

    def upright(outline: np.ndarray) -> np.ndarray:
        return np.vstack([np.insert(outline, 2, z, axis=1) for z in (base, base + height)])

    if polygon.convex_hull.area - polygon.area < _THIN:
        corners = upright(np.array(polygon.exterior.coords)[:-1])
        return Solid(name, (corners,), *convex_hull(corners), zone)
    trimesh = _trimesh()
    mesh = trimesh.creation.extrude_polygon(polygon, height)
    mesh.apply_translation([0.0, 0.0, base])
    points, triangles = trimesh.creation.triangulate_polygon(polygon)
    parts = tuple(upright(np.asarray(points)[triangle]) for triangle in triangles)
    return Solid(name, parts, np.array(mesh.vertices), np.array(mesh.faces), zone)


def body(name: str, vertices: np.ndarray, triangles: np.ndarray, *, as_hull: bool = False) -> Solid:
    """Return a body with a surface of triangles.

    Args:
        name: Its name.
        vertices: Corners [m], shape (n, 3).
        triangles: Indices of the corners of each triangle, shape (m, 3).
        as_hull: Whether to replace it by its convex hull, which is faster and never smaller.

    Raises:
        DataError: If a corner lies beyond `FARTHEST`, a triangle has a corner that there is not,
            or the surface is not closed.
    """
    surface = Solid(name, (), vertices, triangles)
    if as_hull:
        corners, triangles = convex_hull(vertices)
        return Solid(name, _as_parts(corners), corners, triangles)
    mesh = _trimesh().Trimesh(surface.vertices, surface.triangles)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    with np.errstate(all="ignore"):  # trimesh divides by volumes that may be zero
        if not mesh.is_watertight or mesh.volume == 0.0:
            raise DataError("the mesh is not closed: some edge has not two triangles.")
        mesh.fix_normals()
        convex = mesh.is_convex
    corners = np.array(mesh.vertices)
    return Solid(name, _as_parts(corners) if convex else (), corners, np.array(mesh.faces))


def _trimesh() -> Any:
    """Return trimesh, whose import is slow and which few sites need."""
    return uninterrupted_import("trimesh")


def _as_parts(corners: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the parts of a convex body; none, for its surface, if a corner has more neighbours
    than `coal` takes, as the top of a cone may have.
    """
    few_neighbours = _most_neighbours(convex_hull(corners)[1]) <= _MOST_NEIGHBOURS
    return (corners,) if few_neighbours else ()


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the corners, shape (n, 3), and triangles, shape (m, 3), of a mesh from one file.

    Raises:
        DataError: If it cannot be read, has another ending, or holds no mesh.
    """
    if path.suffix.lower() not in MESH_ENDINGS:
        raise DataError(f"Cannot read {path}: a mesh ends in {', '.join(MESH_ENDINGS)}.")
    content = read_bytes(path, _LARGEST_MESH)
    try:
        with np.errstate(all="ignore"):  # numbers that are none are refused with their corner
            kind = path.suffix[1:].lower()
            mesh = _trimesh().load_mesh(io.BytesIO(content), file_type=kind, resolver=None)
            vertices = np.asarray(mesh.vertices, dtype=float)
            triangles = np.asarray(mesh.faces, dtype=int)
    except Exception as error:  # parsers of bad files raise anything
        raise DataError(
            f"Cannot read {path}: it holds no mesh ({type(error).__name__})."
        ) from error
    if not len(triangles) or not vertices.shape[1:] == triangles.shape[1:] == (3,):
        raise DataError(f"Cannot read {path}: it holds no mesh of triangles in space.")
    return vertices, triangles
