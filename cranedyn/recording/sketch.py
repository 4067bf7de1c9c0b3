"""Side view of a crane as a figure, for pages, notebooks and films."""

from __future__ import annotations

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
from cranedyn.recording.shapes import rope_line, shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Outline(NamedTuple):
    """Outline of a shape on the picture plane [m], shape (n, 2), its distance towards the eye [m]
    and its colour.
    """

    corners: np.ndarray
    depth: float
    colour: tuple[float, ...]


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
        level = np.array([-np.cos(turn), -np.sin(turn), 0.0])
        eye = np.cos(rise) * level + [0.0, 0.0, np.sin(rise)]
        right = np.cross([0.0, 0.0, 1.0], level)
        self._axes = np.array([right, np.cross(eye, right), eye])
        self._offset = np.array(offset)
        self._turn = Rotation.from_euler("z", heading)
        self._crane = crane
        self._data = crane.model.createData()
        self._links = {
            crane.model.getFrameId(link, pin.BODY): [(s.colour, s.hull_points()) for s in group]
            for link, group in shapes(crane.urdf, meshes).items()
        }
        self._past: dict[int, tuple[np.ndarray, list[Outline]]] = {}

    def rope(self, q: np.ndarray) -> np.ndarray:
        """Return points of the rope, the payload last, on the picture [m], shape (points, 2)."""
        return self.points(rope_line(self._crane, q[None])[0])

    def points(self, places: np.ndarray) -> np.ndarray:
        """Return places in the world [m], shape (n, 3), on the picture [m], shape (n, 2)."""
        return self._project(places)[:, :2]

    def outlines(self, q: np.ndarray) -> list[Outline]:
        """Return the outlines of all shapes, the nearest last; those of links at rest are kept."""
        pin.framesForwardKinematics(self._crane.model, self._data, q)
        result: list[Outline] = []
        for frame, group in self._links.items():
            pose = self._data.oMf[frame]
            if frame not in self._past or (self._past[frame][0] != pose.homogeneous).any():
                world = [(colour, p @ pose.rotation.T + pose.translation) for colour, p in group]
                drawn = [self._outline(colour, points) for colour, points in world]
                self._past[frame] = pose.homogeneous.copy(), [line for line in drawn if line]
            result += self._past[frame][1]
        return sorted(result, key=lambda outline: outline.depth)

    def _project(self, points: np.ndarray) -> np.ndarray:
        return np.asarray((self._turn.apply(points) + self._offset) @ self._axes.T)

    def _outline(self, colour: tuple[float, ...], points: np.ndarray) -> Outline | None:
        plane = self._project(points)
        try:
            hull = ConvexHull(plane[:, :2]).vertices
        except QhullError:  # a plate seen edge-on
            return None
        return Outline(plane[hull, :2], float(plane[:, 2].max()), colour)


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
    corners, colours = [line.corners for line in outlines], [line.colour for line in outlines]
    ax.add_collection(PolyCollection(corners, facecolors=colours))
    ax.plot(*projection.rope(q).T, color="#404040", linewidth=1.2, zorder=0.9)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="[m]", ylabel="[m]")
    return figure
