"""What stands about a crane in a recording: obstacles, those that get near marked while they do,
and the room a load sweeps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from cranedyn.plotting.style import rgb

_SOLID, _ZONE, _NEAR, _SWEPT = "#B9AE9B", "#CC3311", "#F22B05", "#0072B2"


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Something that stands there, in the frame of the crane.

    Attributes:
        name: What it is called.
        vertices: Corners of its surface [m], shape (n, 3).
        triangles: Which three make each triangle, shape (m, 3).
        zone: Whether it is a zone to keep out of, which is seen through.
        near: From when on it is near, and from when on not any more [s], in turn.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    zone: bool = False
    near: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class Scenery:
    """What stands about a crane, and what its load sweeps.

    Attributes:
        obstacles: What stands there.
        path: Where the centre of the load goes [m], shape (n, 3).
        swept: Boxes about the load on its way with its envelope of swing: "centres" and "sizes"
            [m], shape (k, 3), "yaw" [rad], shape (k,).
    """

    obstacles: Sequence[Obstacle]
    path: np.ndarray
    swept: Mapping[str, np.ndarray] = field(default_factory=dict)


def log_scenery(
    recording: rr.RecordingStream,
    entity: str,
    frame: str,
    scenery: Scenery,
    begin: float,
    clock: Callable[[np.ndarray], list[rr.TimeColumn]],
) -> None:
    """Draw it in the frame of the ground.

    Args:
        recording: Where to.
        entity: Below which entity.
        frame: Name of the frame.
        scenery: What to draw.
        begin: When the run begins [s].
        clock: What makes columns of times [s].
    """
    at = rr.CoordinateFrame(frame)
    for i, one in enumerate(scenery.obstacles):
        corners = one.vertices[one.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        mesh = rr.Mesh3D.from_fields(
            vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0)
        )
        path, plain = (
            f"{entity}/site/{i}",
            [*rgb(_ZONE if one.zone else _SOLID), 60 if one.zone else 255],
        )
        recording.log(path, at, mesh, static=True)
        times = np.array([begin, *one.near])
        colours = [plain if k % 2 == 0 else [*rgb(_NEAR), plain[3]] for k in range(len(times))]
        recording.send_columns(path, clock(times), rr.Mesh3D.columns(albedo_factor=colours))
    recording.log(
        f"{entity}/planned",
        at,
        rr.LineStrips3D([scenery.path], colors=rgb(_SWEPT), radii=0.06),
        static=True,
    )
    if len(scenery.swept):
        boxes = rr.Boxes3D(
            centers=scenery.swept["centres"],
            sizes=scenery.swept["sizes"],
            quaternions=_turned(scenery.swept["yaw"]),
            colors=[*rgb(_SWEPT), 25],
            fill_mode="transparentfillmajorwireframe",
        )
        recording.log(f"{entity}/swept", at, boxes, static=True)


def _turned(yaw: np.ndarray) -> np.ndarray:
    """Quaternions of rotations about Z [rad], shape (k, 4)."""
    zero = np.zeros_like(yaw)
    return np.column_stack([zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
