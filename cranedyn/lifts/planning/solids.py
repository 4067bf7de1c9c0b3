"""Obstacles of a site: closed bodies, each with triangles to draw and shapes to measure from.

A body is measured from its convex parts if it has any. Otherwise it is a *surface of triangles*,
which is hollow for `coal`: a point inside of it has a distance from it.
"""

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
"""Largest coordinate of a corner [m]: that of national grids. Doubles are 2e-9 m apart there."""

# Otherwise trimesh logs tracebacks of bad files to standard error.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_MAX_NEIGHBOURS = 255
"""Largest number of edges at a corner of a convex body in `coal`, each to another neighbour."""

_MAX_MESH_BYTES = 50_000_000
"""Largest size of a mesh file [bytes]."""

_MIN_THICKNESS = 1e-6
"""Least thickness of a body [m]."""

_MIN_AREA = 1e-6
"""Least area of an outline, and least area between it and its hull if it is not convex [m²]."""


@dataclass(frozen=True, eq=False, repr=False)
class Solid(ShortRepr):
    """A closed body in the frame of the site.

    Attributes:
        name: Its name; no two of a site have the same.
        parts: Corners of convex bodies [m], shape (n, 3) each, of which it is the union; empty for
            a surface of triangles.
        vertices: Corners of its surface [m], shape (n, 3).
        triangles: Indices of the corners of each triangle, counter-clockwise from outside, shape
            (m, 3).
        zone: Whether it is no body but a zone, which load, hook and rope keep out of.
    """

    name: str
    parts: tuple[np.ndarray, ...]
    vertices: np.ndarray
    triangles: np.ndarray
    zone: bool = False

    def __post_init__(self) -> None:
        """Check what libraries for geometry assume.

        Raises:
            DataError: If a corner lies beyond `FARTHEST`, or a triangle refers to a corner that
                does not exist.
        """
        for points in (*self.parts, self.vertices):
            check_corners(points)
        count = len(self.vertices)
        missing = self.triangles[(self.triangles < 0) | (self.triangles >= count)]
        if len(missing):
            raise DataError(
                f"a triangle refers to the corner of index {missing[0]}; there are {count} "
                "corners, whose indices begin at 0."
            )

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Solid:
        """Return the body, rotated and then translated [m]."""
        parts = tuple(corners @ rotation.T + translation for corners in self.parts)
        return replace(self, parts=parts, vertices=self.vertices @ rotation.T + translation)

    def without_parts(self, indices: Iterable[int]) -> Solid | None:
        """Return the body without some of its convex parts; None if no part is left. Its surface
        stays as it is, since it is only drawn and nothing is measured from it.
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

    def meets(
        self, corners: np.ndarray, shape: coal.Convex, geometries: Iterable[coal.CollisionGeometry]
    ) -> bool:
        """Return whether a convex body and this one have a point in common; one inside of the other
        counts.

        Args:
            corners: Corners of the convex body [m], shape (n, 3).
            shape: Their hull. It is given since the body may be compared with several solids.
            geometries: What `geometries` returns. They are given since the solid may be compared
                with several bodies.
        """
        here = coal.Transform3s()
        for geometry in geometries:
            request = coal.CollisionRequest()
            result = coal.CollisionResult()
            if coal.collide(shape, here, geometry, here, request, result):
                return True
        # A surface of triangles is hollow: a hull inside of it touches none of them.
        return self.surface_encloses(corners[0])

    def surface_encloses(self, point: np.ndarray) -> bool:
        """Return whether this is a surface of triangles and a point [m] lies inside of it. It is
        False for every point if there are convex parts: then distances show what is inside.
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
    beyond = points[~(np.abs(points) <= FARTHEST)]  # written so that NaN is refused
    if len(beyond):
        allowed = f"{-FARTHEST:g} to {FARTHEST:g} m, in metres"
        raise DataError(f"a corner lies at {beyond[0]:g} m; allowed are {allowed}.")


def convex_hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the convex hull of one point or more.

    Points that are thinner than a micrometre along one of their principal axes are made thicker by
    one there. Before Qhull sees them, they are scaled to extents of 1 along all of these axes: that
    changes nothing in which of them are corners, and Qhull is exact relative to the largest extent.

    Args:
        points: The points [m], shape (n, 3).

    Returns:
        Its corners, shape (m, 3), and its triangles, counter-clockwise from outside, shape (k, 3).

    Raises:
        DataError: If a point lies beyond `FARTHEST`.
    """
    check_corners(points)
    offsets = points - points.mean(axis=0)

    # The three rows of zeros give one or two points three axes, too. The last axis is reversed if
    # the three would mirror the points.
    axes = np.linalg.svd(np.vstack([offsets, np.zeros((3, 3))]), full_matrices=False)[2]
    axes[2] *= np.linalg.det(axes)
    extents = np.ptp(offsets @ axes.T, axis=0)
    for axis in axes[extents < _MIN_THICKNESS]:
        half = axis * _MIN_THICKNESS / 2.0
        points = np.concatenate([points - half, points + half])

    scaled = (points - points.mean(axis=0)) @ axes.T
    scaled /= np.ptp(scaled, axis=0)
    qhull = ConvexHull(scaled)
    triangles = qhull.simplices
    normals = qhull.equations[:, :3]
    if _largest_neighbour_count(triangles) > _MAX_NEIGHBOURS:
        triangles, normals = _in_strips(scaled, qhull)

    # Qhull gives the outward normal of each triangle, and its corners in any order.
    a, b, c = np.moveaxis(scaled[triangles], 1, 0)
    is_inward = np.sum(np.cross(b - a, c - a) * normals, axis=1) < 0.0
    triangles = np.where(is_inward[:, None], triangles[:, ::-1], triangles)

    # Points inside of the hull are left out, and the rest numbered anew.
    corners, triangles = np.unique(triangles, return_inverse=True)
    return points[corners], triangles.reshape(-1, 3)


def _in_strips(points: np.ndarray, qhull: ConvexHull) -> tuple[np.ndarray, np.ndarray]:
    """Divide each flat facet of a hull into a strip of triangles.

    Qhull arranges the triangles of a facet around one corner, which then has all others of the
    facet for neighbours.

    Args:
        points: The points of the hull, shape (n, 3).
        qhull: The hull.

    Returns:
        Indices of the corners of each triangle, shape (m, 3), and its outward normal, shape (m, 3).
    """
    # Qhull copies the plane of a facet to each of its triangles, so that rows are equal bit by bit.
    planes, facet = np.unique(qhull.equations, axis=0, return_inverse=True)
    facet_of_triangle = facet.ravel()
    strips = []
    normals = []
    for i, plane in enumerate(planes):
        corners = np.unique(qhull.simplices[facet_of_triangle == i])
        strip = _strip(_ring(points, corners, plane[:3]))
        strips.append(strip)
        normals.append(np.repeat(plane[None, :3], len(strip), axis=0))
    return np.concatenate(strips), np.concatenate(normals)


def _ring(points: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the indices of the corners of a convex facet in the order around it, shape (k,): by
    their angles about the middle of the facet.

    Args:
        points: The points of the hull, shape (n, 3).
        corners: Indices of the corners, shape (k,).
        normal: Normal of the facet, shape (3,).
    """
    x_axis = points[corners[1]] - points[corners[0]]
    y_axis = np.cross(normal, x_axis)
    offsets = points[corners] - points[corners].mean(axis=0)
    angles = np.arctan2(offsets @ y_axis, offsets @ x_axis)
    return corners[np.argsort(angles)]


def _strip(ring: np.ndarray) -> np.ndarray:
    """Return the triangles of a convex polygon, shape (n - 2, 3), from its corners in order, shape
    (n,): a strip that zigzags from one side to the other, so that no corner is in more than three.
    """
    # The corners in the order 0, 1, n-1, 2, n-2, …; each three consecutive ones are a triangle.
    n = len(ring)
    k = np.arange(n)
    forwards = (k + 1) // 2
    backwards = (n - k // 2) % n
    zigzag = ring[np.where(k % 2, forwards, backwards)]
    return np.column_stack([zigzag[:-2], zigzag[1:-1], zigzag[2:]])


def _largest_neighbour_count(triangles: np.ndarray) -> int:
    """Return the largest number of neighbours of a corner of a closed surface, in which a corner
    has as many neighbours as triangles.
    """
    return int(np.bincount(triangles.ravel()).max())


def hull(points: np.ndarray) -> coal.Convex:
    """Compute the convex hull of one point [m] or more, shape (n, 3), as a shape for `coal`.

    Raises:
        DataError: If a point lies beyond `FARTHEST`, or a corner has more neighbours than `coal`
            takes.
    """
    vertices, faces = convex_hull(points)
    edges = _largest_neighbour_count(faces)
    if edges > _MAX_NEIGHBOURS:
        raise DataError(
            f"a corner of a convex body has {edges} edges; at most {_MAX_NEIGHBOURS} are allowed."
        )
    corners = coal.StdVec_Vec3s()
    triangles = coal.StdVec_Triangle()
    for vertex in vertices:
        corners.append(vertex)
    for face in faces:
        a, b, c = face.tolist()
        triangles.append(coal.Triangle(a, b, c))
    return coal.Convex(corners, triangles)


def rotation_z(yaw: float) -> np.ndarray:
    """Return the rotation about Z by an angle [rad], shape (3, 3)."""
    c = math.cos(yaw)
    s = math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def box(
    name: str, centre: Sequence[float], size: Sequence[float], base: float, yaw: float = 0.0
) -> Solid:
    """Return a box that stands upright.

    Args:
        name: Its name.
        centre: Centre of its footprint, x and y [m].
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
    """Return an upright body of a given outline.

    A convex outline makes one convex part. Any other is divided into triangles, each of which makes
    a part.

    Args:
        name: Its name.
        outline: Corners of the outline [m], shape (n, 2), in either direction.
        base: Height of its bottom [m].
        height: Height of its top above its bottom [m].
        zone: Whether it is a zone to keep out of.

    Raises:
        DataError: If the outline crosses itself or encloses nothing, or a corner lies beyond
            `FARTHEST`.
        OutOfRange: If the height is less than a micrometre.
    """
    import shapely

    check_corners(outline)
    if not height >= _MIN_THICKNESS:
        raise OutOfRange("height", height, f">= {_MIN_THICKNESS:g}", "m")
    check_corners(np.array([base, base + height]))
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid or polygon.area < _MIN_AREA:
        raise DataError("an outline must enclose an area and not cross itself.")
    polygon = shapely.geometry.polygon.orient(polygon)

    def upright(outline: np.ndarray) -> np.ndarray:
        bottom = np.insert(outline, 2, base, axis=1)
        top = np.insert(outline, 2, base + height, axis=1)
        return np.vstack([bottom, top])

    if polygon.convex_hull.area - polygon.area < _MIN_AREA:
        corners = upright(np.array(polygon.exterior.coords)[:-1])  # the first is repeated as last
        hull_corners, hull_triangles = convex_hull(corners)
        return Solid(name, (corners,), hull_corners, hull_triangles, zone)
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
        DataError: If a corner lies beyond `FARTHEST`, a triangle refers to a corner that does not
            exist, or the surface is not closed or encloses no volume.
    """
    surface = Solid(name, (), vertices, triangles)  # checks corners and triangles
    if as_hull:
        hull_corners, hull_triangles = convex_hull(vertices)
        return Solid(name, _as_parts(hull_corners), hull_corners, hull_triangles)
    mesh = _trimesh().Trimesh(surface.vertices, surface.triangles)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    with np.errstate(all="ignore"):  # trimesh divides by volumes that may be zero
        if not mesh.is_watertight:
            raise DataError("the mesh is not closed: some edge has not two triangles.")
        if mesh.volume == 0.0:
            raise DataError("the mesh encloses no volume.")
        mesh.fix_normals()
        is_convex = mesh.is_convex
    corners = np.array(mesh.vertices)
    parts = _as_parts(corners) if is_convex else ()
    return Solid(name, parts, corners, np.array(mesh.faces))


def _trimesh() -> Any:
    """Return trimesh, whose import is slow and which few sites need."""
    return uninterrupted_import("trimesh")


def _as_parts(corners: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a convex body as its only part. If a corner has more neighbours than `coal` takes, as
    the top of a cone may have, there are no parts, and the body is measured from its surface.
    """
    _, triangles = convex_hull(corners)
    if _largest_neighbour_count(triangles) > _MAX_NEIGHBOURS:
        return ()
    return (corners,)


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the corners, shape (n, 3), and triangles, shape (m, 3), of a mesh from one file.

    Raises:
        DataError: If it cannot be read, has another ending, or holds no mesh.
    """
    if path.suffix.lower() not in MESH_ENDINGS:
        raise DataError(f"Cannot read {path}: a mesh ends in {', '.join(MESH_ENDINGS)}.")
    content = read_bytes(path, _MAX_MESH_BYTES)
    try:
        with np.errstate(all="ignore"):  # NaN and infinity are refused by `check_corners`
            kind = path.suffix[1:].lower()
            # Without a resolver no other file is read, whatever the mesh refers to.
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
