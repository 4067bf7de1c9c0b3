"""Side view of a crane as a figure, for pages, notebooks and films."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.collections import PolyCollection
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
        corners: Its corners [m], shape (n, 2).
        depth: Distance towards the eye of its nearest point [m]: larger ones are drawn in front.
        colour: Red, green, blue and alpha, 0 to 1.
        extent: The rectangle about its corners.
    """

    corners: np.ndarray
    depth: float
    colour: tuple[float, ...]
    extent: Extent


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
        self._axes = np.array([right, upward, to_eye])
        self._offset = np.array(offset)
        self._turn = Rotation.from_euler("z", heading)
        self._crane = crane
        self._data = crane.model.createData()
        # Hull points do not change with the pose of the link: they are worked out once.
        self._shapes: dict[int, list[tuple[Shape, np.ndarray]]] = {}
        for link, link_shapes in shapes(crane.urdf, meshes).items():
            frame = crane.model.getFrameId(link, pin.BODY)
            self._shapes[frame] = [(shape, shape.hull_points()) for shape in link_shapes]
        self._drawn: dict[int, _LinkOutlines] = {}

    def rope(self, q: np.ndarray) -> np.ndarray:
        """Return points of the rope, the payload last, on the picture [m], shape (points, 2)."""
        return self.points(rope_line(self._crane, q[None])[0])

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
                drawn = _LinkOutlines(pose.homogeneous.copy(), self._outline(pose, link_shapes))
                self._drawn[frame] = drawn
            result += drawn.outlines
        return sorted(result, key=lambda outline: outline.depth)

    def _project(self, points: np.ndarray) -> np.ndarray:
        """Return points of the crane [m] on the picture, with their distances towards the eye as
        third column [m], shape (n, 3).
        """
        in_scene = self._turn.apply(points) + self._offset
        return np.asarray(in_scene @ self._axes.T)

    def _outline(
        self, pose: pin.SE3, link_shapes: Sequence[tuple[Shape, np.ndarray]]
    ) -> list[Outline]:
        """Return the outlines of the shapes of a link at a pose; a plate seen edge-on has none."""
        outlines = []
        for shape, hull_points in link_shapes:
            projected = self._project(hull_points @ pose.rotation.T + pose.translation)
            try:
                hull = ConvexHull(projected[:, :2]).vertices
            except QhullError:  # all points are on a line
                continue
            depth = float(projected[:, 2].max())
            corners = projected[hull, :2]
            extent = Extent(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
            outlines.append(Outline(corners, depth, shape.colour, extent))
        return outlines


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
    corners = [outline.corners for outline in outlines]
    colours = [outline.colour for outline in outlines]
    ax.add_collection(PolyCollection(corners, facecolors=colours))
    across, up = projection.rope(q).T
    # Behind the shapes, which Matplotlib draws at a zorder of 1.
    ax.plot(across, up, color="#404040", linewidth=1.2, zorder=0.9)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="[m]", ylabel="[m]")
    return figure
