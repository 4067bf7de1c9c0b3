"""What a recording is made of: runs, the scenery around their cranes, and how both are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from cranedyn.checks import finite, number
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import Crane
from cranedyn.plotting.style import run_colour

TIMELINE = "sim_time"
"""The only timeline of a recording."""

SCENE = "Crane"
"""Name of the view that shows the whole scene."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An obstacle in the frame of the crane.

    Attributes:
        name: Its name.
        vertices: Vertices of its surface [m], shape (n, 3).
        triangles: Indices of the three vertices of each triangle, shape (m, 3).
        zone: Whether it is a zone to keep out of, which is drawn transparent.
        near: Times [s] at which the load comes near and leaves again, in turn; meanwhile the
            obstacle is drawn red.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    zone: bool = False
    near: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class Scenery:
    """The surroundings of a crane and the space that its load sweeps.

    Attributes:
        obstacles: The obstacles.
        path: Path of the centre of the load [m], shape (n, 3).
        swept: Boxes around the load on its path, enlarged by its swing: "centres" and "sizes" [m],
            shape (k, 3), and "yaw" [rad], shape (k,). Empty for none.
        reserved: Times [s], shape (k,), and the lines around what is reserved for the crane from
            each of these times on [m], shape (k, n, 3); None for nothing.
    """

    obstacles: Sequence[Obstacle]
    path: np.ndarray
    swept: Mapping[str, np.ndarray] = field(default_factory=dict)
    reserved: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Run:
    """A crane, its trajectory, and how both are drawn.

    Attributes:
        name: Name of the run, unique in its recording.
        crane: The crane.
        trajectory: Its trajectory.
        offset: Position of the foot of the crane in the scene [m]. Cranes with the same offset
            overlap; all but the first are drawn transparent.
        meshes: Folder of the mesh files of the URDF. Files outside of it are refused. None draws no
            meshes.
        colour: Hex colour of payload, path and curves; empty for the next one of
            `cranedyn.plotting.style`.
        scenery: The surroundings; None for none.
        heading: Rotation of the crane about its foot, from X towards Y [rad].
    """

    name: str
    crane: Crane
    trajectory: Trajectory
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    meshes: Path | None = None
    colour: str = ""
    scenery: Scenery | None = None
    heading: float = 0.0

    def __post_init__(self) -> None:
        """Check offset and heading, and escape what UTF-8 cannot encode in the name.

        Raises:
            OutOfRange: If a number is not finite.
        """
        finite("offset of a run", self.offset, (3,), unit="m")
        number("heading of a run", self.heading, "rad")
        object.__setattr__(self, "name", utf8(self.name))

    def to_scene(self, points: np.ndarray) -> np.ndarray:
        """Return points in the frame of the crane [m], shape (..., 3), in that of the scene."""
        return Rotation.from_euler("z", self.heading).apply(points) + self.offset

    def entity(self, *parts: str) -> str:
        """Return the path of an entity of this run, with what Rerun reserves escaped."""
        return rr.new_entity_path([self.name, *parts])

    def frame(self, link: str) -> str:
        """Return the name of the coordinate frame of a link of this run."""
        return f"{self.name}: {link}"


def utf8(text: str) -> str:
    """Return a text with escapes for what UTF-8 cannot encode, such as names of odd files."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def colours(runs: Sequence[Run]) -> list[str]:
    """Return the hex colour of each run."""
    return [run.colour or run_colour(i) for i, run in enumerate(runs)]


def clock(t: np.ndarray) -> list[rr.TimeColumn]:
    """Return times [s] as a column of the timeline.

    They are rounded to nanoseconds here, because Rerun truncates.
    """
    return [rr.TimeColumn(TIMELINE, duration=np.round(1e9 * t).astype("timedelta64[ns]"))]


def rows_every(t: np.ndarray, period: float) -> np.ndarray:
    """Return indices of rows a period apart, the first and the last row included.

    Args:
        t: Times of the rows [s], shape (n,).
        period: The period [s]; where rows are farther apart, each counts once.
    """
    times = np.append(np.arange(t[0], t[-1], period), t[-1])
    # A row that is late by no more than rounding still counts for its time.
    return np.unique(np.searchsorted(t, times - 1e-9))
