"""Side view of a crane as a figure, for pages, notebooks and films."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.collections import PathCollection
from matplotlib.path import Path as DrawnPath
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import panels
from cranedyn.recording.shapes import Shape, rope_line, shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Extent(NamedTuple):
    """Upright rectangle about an outline on the picture plane.

    Attributes:
        left: Smallest coordinate to the right [m].
        bottom: Smallest coordinate upward [m].
        right: Largest coordinate to the right [m].
        top: Largest coordinate upward [m].
    """

    left: float
    bottom: float
    right: float
    top: float

    def reaches(self, middle: np.ndarray, distance: float) -> bool:
        """Return whether a part of the rectangle lies in the square about a point, shape (2,), with
        sides of twice a distance [m].
        """
        across, up = middle.tolist()
        return (
            self.left <= across + distance
            and self.right >= across - distance
            and self.bottom <= up + distance
            and self.top >= up - distance
        )


class Outline(NamedTuple):
    """Outline of a shape on the picture plane.

    Attributes:
        path: The path along its corners [m] and back to the first, as Matplotlib draws it.
        depth: Distance towards the eye of its nearest point [m]: larger ones are drawn in front.
        colour: Red, green, blue and alpha, 0 to 1.
        extent: The rectangle about its corners.
    """

    path: DrawnPath
    depth: float
    colour: tuple[float, ...]
    extent: Extent

    @property
    def corners(self) -> np.ndarray:
        """Its corners [m], shape (n, 2)."""
        return np.asarray(self.path.vertices)[:-1]


@dataclass(frozen=True, eq=False)
class _SegmentSums:
    """Shapes of a link that are sums of equally many segments, see `Shape.segments`.

    Their outlines need no convex hull: the outline of such a sum has each segment twice as an edge,
    there and back, in the order of their directions. NumPy works out all of them at once, which
    takes a fifth of the time of as many hulls.

    Attributes:
        shapes: The shapes.
        centres: Their centres in the frame of the link [m], shape (shapes, 3).
        segments: Their segments in that frame [m], shape (shapes, segments, 3).
    """

    shapes: list[Shape]
    centres: np.ndarray
    segments: np.ndarray


@dataclass(frozen=True, eq=False)
class _LinkShapes:
    """The shapes of a link.

    Attributes:
        sums: Boxes and cylinders, those with equally many segments together.
        others: The other shapes, each with points whose convex hull is its own in the frame of the
            link [m], shape (n, 3).
    """

    sums: list[_SegmentSums]
    others: list[tuple[Shape, np.ndarray]]


class _LinkOutlines(NamedTuple):
    """Outlines of the shapes of a link at a pose.

    Attributes:
        pose: Homogeneous matrix of the link in the world, shape (4, 4).
        outlines: The outlines.
    """

    pose: np.ndarray
    outlines: list[Outline]


class Projection:
    """Parallel projection of a crane on a picture plane.

    The eye looks square to the jib of a tower crane at slew angle 0, which points to the right.
    """

    def __init__(
        self,
        crane: Crane,
        *,
        turn: float = 0.0,
        rise: float = 0.0,
        offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        heading: float = 0.0,
        meshes: Path | None = None,
    ) -> None:
        """Read the shapes of the crane.

        Args:
            crane: The crane.
            turn: Angle by which the eye goes towards the tip of the jib [rad].
            rise: Angle by which it is raised [rad].
            offset: Position of the foot of the crane [m].
            heading: Rotation of the crane about its foot [rad].
            meshes: Folder of the mesh files; None draws no meshes.
        """
        # Unit vectors: to the eye along the ground, to the eye, and to the right in the picture.
        level = np.array([-np.cos(turn), -np.sin(turn), 0.0])
        to_eye = np.cos(rise) * level + [0.0, 0.0, np.sin(rise)]
        right = np.cross([0.0, 0.0, 1.0], level)
        upward = np.cross(to_eye, right)
        # Rows: the axes of the picture, and the depth.
        axes = np.array([right, upward, to_eye])
        self._rotation = axes @ Rotation.from_euler("z", heading).as_matrix()
        self._translation = axes @ np.array(offset)
        self._crane = crane
        self._data = crane.model.createData()
        # What does not change with the pose of a link is worked out once.
        self._shapes: dict[int, _LinkShapes] = {}
        for link, link_shapes in shapes(crane.urdf, meshes).items():
            frame = crane.model.getFrameId(link, pin.BODY)
            self._shapes[frame] = _sort_shapes(link_shapes)
        self._drawn: dict[int, _LinkOutlines] = {}

    def rope(self, q: np.ndarray) -> np.ndarray:
        """Return points of the rope, the payload last, on the picture [m], shape (points, 2)."""
        return self.ropes(q[None])[0]

    def ropes(self, q: np.ndarray) -> np.ndarray:
        """Return the points as `rope` at many coordinates, shape (rows, n): shape (rows, points,
        2).
        """
        lines = rope_line(self._crane, q)
        rows, points, _ = lines.shape
        return self.points(lines.reshape(rows * points, 3)).reshape(rows, points, 2)

    def points(self, places: np.ndarray) -> np.ndarray:
        """Return places in the world [m], shape (n, 3), on the picture [m], shape (n, 2)."""
        return self._project(places)[:, :2]

    def outlines(self, q: np.ndarray) -> list[Outline]:
        """Return the outlines of all shapes at coordinates q, the nearest last."""
        pin.framesForwardKinematics(self._crane.model, self._data, q)
        result: list[Outline] = []
        for frame, link_shapes in self._shapes.items():
            pose = self._data.oMf[frame]
            drawn = self._drawn.get(frame)
            # A film draws thousands of pictures, in which the tower and others stand still.
            if drawn is None or (drawn.pose != pose.homogeneous).any():
                drawn = _LinkOutlines(
                    pose.homogeneous.copy(), self._outlines_of_link(pose, link_shapes)
                )
                self._drawn[frame] = drawn
            result += drawn.outlines
        return sorted(result, key=lambda outline: outline.depth)

    def _project(self, points: np.ndarray) -> np.ndarray:
        """Return points of the crane [m] on the picture, with their distances towards the eye as
        third column [m], shape (n, 3).
        """
        return np.asarray(points @ self._rotation.T + self._translation)

    def _outlines_of_link(self, pose: pin.SE3, link_shapes: _LinkShapes) -> list[Outline]:
        """Return the outlines of the shapes of a link at a pose; a plate seen edge-on has none."""
        outlines = []
        for sums in link_shapes.sums:
            outlines += self._outlines_of_sums(pose, sums)
        for shape, hull_points in link_shapes.others:
            projected = self._project(hull_points @ pose.rotation.T + pose.translation)
            try:
                hull = ConvexHull(projected[:, :2]).vertices
            except QhullError:  # all points are on a line
                continue
            depth = float(projected[:, 2].max())
            corners = projected[hull, :2]
            path = DrawnPath(np.concatenate([corners, corners[:1]]), closed=True)
            extent = Extent(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
            outlines.append(Outline(path, depth, shape.colour, extent))
        return outlines

    def _outlines_of_sums(self, pose: pin.SE3, sums: _SegmentSums) -> list[Outline]:
        """Return the outlines of shapes that are sums of segments, at a pose of their link."""
        centres = self._project(sums.centres @ pose.rotation.T + pose.translation)
        segments = sums.segments @ (self._rotation @ pose.rotation).T
        # The nearest point of a sum is the sum of the nearest ends of its segments.
        depths = centres[:, 2] + 0.5 * np.abs(segments[..., 2]).sum(axis=1)
        # Each segment in the sense in which it goes upward, in the order of their directions. From
        # its lowest corner the outline goes along them upward, and along them downward again.
        edges = segments[..., :2]
        upward = np.where(edges[..., 1:] < 0.0, -edges, edges)
        # A height of -0 would give the direction -π, which is out of order; the sum is +0.
        directions = np.arctan2(upward[..., 1] + 0.0, upward[..., 0])
        order = np.argsort(directions, axis=1)
        ascending = np.take_along_axis(upward, order[..., None], axis=1)
        lowest = centres[:, None, :2] - 0.5 * ascending.sum(axis=1, keepdims=True)
        around = np.concatenate([lowest, ascending, -ascending], axis=1)
        corners = np.cumsum(around, axis=1)
        lower_ends = corners.min(axis=1).tolist()
        upper_ends = corners.max(axis=1).tolist()
        outlines = []
        for i, (shape, depth) in enumerate(zip(sums.shapes, depths.tolist(), strict=True)):
            path = DrawnPath(corners[i], closed=True)
            extent = Extent(*lower_ends[i], *upper_ends[i])
            outlines.append(Outline(path, depth, shape.colour, extent))
        return outlines


def _sort_shapes(link_shapes: Sequence[Shape]) -> _LinkShapes:
    """Return the shapes of a link by the way in which their outlines are worked out."""
    groups: dict[int, list[tuple[Shape, np.ndarray]]] = {}
    others = []
    for shape in link_shapes:
        segments = shape.segments()
        if segments is None:
            others.append((shape, shape.hull_points()))
        else:
            groups.setdefault(len(segments), []).append((shape, segments))
    sums = []
    for group in groups.values():
        centres = np.array([shape.centre for shape, _ in group])
        segments = np.array([segments for _, segments in group])
        sums.append(_SegmentSums([shape for shape, _ in group], centres, segments))
    return _LinkShapes(sums, others)


def sketch(crane: Crane, state: State | None = None, *, width: float = 4.5) -> Figure:
    """Draw a crane from the side; the jib of a tower crane at slew angle 0 points to the right.

    Args:
        crane: The crane.
        state: The state to draw; None for the start of the crane.
        width: Width of the figure [inch].
    """
    q = (crane.start if state is None else state).q
    projection = Projection(crane)
    outlines = projection.outlines(q)
    figure, (ax,) = panels(width=width, height=width)
    paths = [outline.path for outline in outlines]
    colours = [outline.colour for outline in outlines]
    ax.add_collection(PathCollection(paths, facecolors=colours))
    across, up = projection.rope(q).T
    # Behind the shapes, which Matplotlib draws at a zorder of 1.
    ax.plot(across, up, color="#404040", linewidth=1.2, zorder=0.9)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="[m]", ylabel="[m]")
    return figure
