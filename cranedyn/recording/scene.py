"""The 3D scene of a recording: structure, cable, payload and its path, setpoint, swing arrows, and
scenery.

`rerun.urdf.UrdfTree` computes the transforms of the joints; the cable of changing length, which no
URDF can describe, is a line between points of the crane.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import rerun as rr
from rerun.urdf import UrdfTree
from scipy.spatial.transform import Rotation

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.pinocchio import payload_orientation, point_positions
from cranedyn.errors import printable
from cranedyn.model.crane import Crane
from cranedyn.model.urdf import parse_urdf, skeleton
from cranedyn.plotting.style import COLOURS, mixed, rgb
from cranedyn.recording.run import Run, Scenery, clock, colours, rows_every
from cranedyn.recording.shapes import CONTACT, Shape, rope_line, shapes, touching_points

BACKGROUND = "#E1E8F0"
"""Colour behind the scene, into which the path of the payload fades."""

PATH_SECONDS = 4.0
"""Duration of the path of the payload [s]."""

_FRAME_PERIOD, _PATH_PERIOD = 0.04, 0.1
_PATH_POINTS = round(PATH_SECONDS / _PATH_PERIOD)
_CABLE, _GREY = "#202020", "#8C8C8C"
_CABLE_RADIUS, _PATH_RADIUS, _ARROW_RADIUS, _CONTACT_RADIUS = 0.05, 0.16, 0.12, 0.2
_ARROWS_BELOW_TROLLEY = 1.5
_MAX_ARROW, _RESERVED = 5.0, -1.5  # below zero: points on the screen
_SOLID, _ZONE, _NEAR, _SWEPT = "#B9AE9B", "#CC3311", "#F22B05", "#0072B2"
_WIREFRAME: Any = "transparentfillmajorwireframe"
_ARCHETYPES: dict[str, Any] = {
    "box": rr.Boxes3D,
    "cylinder": rr.Cylinders3D,
    "sphere": rr.Ellipsoids3D,
}


class Look(NamedTuple):
    """Appearance of one run among the others.

    Attributes:
        colour: Hex colour of payload and path.
        overlaps: Number of earlier cranes at the same offset; after the first the structure is
            transparent, and labels stand below each other.
        label: Text below the payload, empty for none.
        arrow: Length of the swing arrows [m/°], the same for all runs.
    """

    colour: str
    overlaps: int
    label: str
    arrow: float


def looks(runs: Sequence[Run]) -> list[Look]:
    """Return the appearance of each run."""
    swings = [np.degrees(run.trajectory.q[:, run.crane.swings]) for run in runs]
    swing = max(np.abs(angles).max(initial=0.0) for angles in swings)
    arrow = next((scale for scale in (0.5, 0.2, 0.1) if scale * swing <= _MAX_ARROW), 0.05)
    arrow *= min(drawn_size(run.crane) for run in runs)
    offsets = [tuple(run.offset) for run in runs]
    labels = [printable(run.name) if len(runs) > 1 else "" for run in runs]
    overlaps = [offsets[:i].count(offset) for i, offset in enumerate(offsets)]
    return [Look(*look, arrow) for look in zip(colours(runs), overlaps, labels, strict=True)]


def payload_entity(run: Run) -> str:
    """Return the entity with the body of the payload, which the eye of a view can follow."""
    link = _payload_link(run.crane)
    link_shapes = shapes(run.crane.urdf, run.meshes)[link]
    body = _largest(link_shapes)
    meshes = [shape for shape in link_shapes if shape.kind == "mesh"]
    number = [str(meshes.index(body))] if body.kind == "mesh" else []
    return run.entity("scene", link, body.kind, *number)


def drawn_size(crane: Crane) -> float:
    """Return the size of cables and arrows, as a share of that on a crane of 10 m and more."""
    return min(1.0, float(point_positions(crane, crane.start.q)[:, 2].max()) / 10.0)


class Scene:
    """The scene of one run: the constructor logs what is static, `move` logs what moves."""

    def __init__(self, recording: rr.RecordingStream, run: Run, look: Look) -> None:
        """Log links, styles and scenery."""
        self._recording, self._run, self._look, self._crane = recording, run, look, run.crane
        self._tree = _urdf_tree(run)
        self._ground = run.frame(self._tree.root_link().name)
        self._size = drawn_size(run.crane)
        self._has_arrows = run.crane.layout.has("trolley", "radial_swing", "tangential_swing")
        self._log_links()
        self._log_styles()
        if run.scenery is not None:
            self._log_scenery(run.scenery, float(run.trajectory.t[0]))

    def move(self, trajectory: Trajectory, t_start: float = -math.inf) -> None:
        """Log the rows from a time on [s], 25 a second; the path also shows earlier rows."""
        crane, rows = self._crane, rows_every(trajectory.t, _FRAME_PERIOD)
        rows = rows[trajectory.t[rows] >= t_start]
        t, q = trajectory.t[rows], trajectory.q[rows]
        for joint, values in zip(crane.layout.joints, q.T, strict=True):
            urdf_joint = self._tree.get_joint_by_name(joint.name)
            assert urdf_joint is not None
            moves = np.append(True, np.diff(values) != 0)
            columns = urdf_joint.compute_transform_columns(values[moves].tolist(), clamp=False)
            self._send(t[moves], columns, "joints", joint.name)
        self._send(t, rr.LineStrips3D.columns(strips=rope_line(crane, q)), "scene", "cable")
        if trajectory.phase is not None:
            touching = [touching_points(crane, trajectory, int(row)) for row in rows]
            marks = rr.Points3D.columns(positions=np.concatenate([np.zeros((0, 3)), *touching]))
            self._send(t, marks.partition([*map(len, touching)]), "scene", "contact")
        self._move_path(trajectory, t_start)
        self._move_setpoint(t, trajectory.setpoint[rows])
        if self._has_arrows:
            self._move_arrows(t, q)

    def _log(self, frame: str, body: rr.AsComponents, *parts: str) -> None:
        entity = self._run.entity("scene", *parts)
        self._recording.log(entity, rr.CoordinateFrame(frame), body, static=True)

    def _send(self, t: np.ndarray, columns: Any, *parts: str) -> None:
        self._recording.send_columns(self._run.entity(*parts), clock(t), columns)

    def _log_links(self) -> None:
        """Log the fixed joints and the shapes of all links, those of the payload in its colour."""
        run, look, log = self._run, self._look, self._recording.log
        foot = rr.Transform3D(
            translation=run.offset,
            rotation=rr.RotationAxisAngle([0.0, 0.0, 1.0], radians=run.heading),
            parent_frame="tf#/",
            child_frame=self._ground,
        )
        log(run.entity("joints", "ground"), foot, static=True)
        moving = {joint.name for joint in self._crane.layout.joints}
        for joint in self._tree.joints():
            if joint.name not in moving:
                fixed = joint.compute_transform(0.0, clamp=False)
                log(run.entity("joints", joint.name), fixed, static=True)
        payload = _payload_link(self._crane)
        by_link = shapes(self._crane.urdf, run.meshes)
        body = _largest(by_link[payload])
        by_link[payload] = by_link[payload] or [body]
        colour = (*np.divide(rgb(look.colour), 255), 1.0)
        alpha = 0.25 if look.overlaps else 1.0
        for link, link_shapes in by_link.items():
            painted = []
            for shape in link_shapes:
                paint = (*shape.colour[:3], alpha * shape.colour[3])
                if link == payload:
                    paint = colour if shape.colour == body.colour else shape.colour
                painted.append(replace(shape, colour=paint))
            self._log_shapes(painted, run.frame(link), link)
        kind = "box" if body.mesh else body.kind
        outline = replace(body, kind=kind, mesh=None, colour=(0.3, 0.3, 0.3, 0.5))
        self._log_shapes([outline], run.frame("setpoint"), "setpoint", fill_mode=_WIREFRAME)
        if look.label:
            label = rr.Points3D(
                [[0.0, 0.0, -self._size * (1.5 + 2.6 * look.overlaps)]],
                radii=0.0,
                labels=[look.label],
                colors=rgb(mixed(look.colour, "#FFFFFF", 0.5)),
                show_labels=True,
            )
            self._log(run.frame(payload), label, "label")

    def _log_shapes(
        self, link_shapes: Sequence[Shape], frame: str, *parts: str, fill_mode: Any = "solid"
    ) -> None:
        """Log shapes in a frame, those of one kind as one entity, but each mesh as its own."""
        for i, shape in enumerate(shape for shape in link_shapes if shape.mesh is not None):
            mesh = rr.Mesh3D(
                vertex_positions=shape.mesh.vertices,
                triangle_indices=shape.mesh.faces,
                vertex_normals=shape.mesh.vertex_normals,
                albedo_factor=[round(255 * c) for c in shape.colour],
            )
            self._log(frame, mesh, *parts, "mesh", str(i))
        for kind in dict.fromkeys(shape.kind for shape in link_shapes if shape.mesh is None):
            group = [shape for shape in link_shapes if shape.kind == kind]
            size = np.array([shape.size for shape in group])
            edges = {
                "box": {"sizes": size},
                "cylinder": {"radii": size[:, 0], "lengths": size[:, -1]},
                "sphere": {"radii": size[:, 0]},
            }
            body = _ARCHETYPES[kind](
                **edges[kind],
                centers=np.array([shape.centre for shape in group]),
                quaternions=Rotation.from_euler("xyz", [shape.rpy for shape in group]).as_quat(),
                colors=np.array([shape.colour for shape in group]),
                fill_mode=fill_mode,
            )
            self._log(frame, body, *parts, kind)

    def _log_styles(self) -> None:
        """Log frames, colours and radii of the cables, the path and the swing arrows."""
        size, age = self._size, np.linspace(0.0, 1.0, _PATH_POINTS, endpoint=False)
        fading = [rgb(mixed(self._look.colour, BACKGROUND, share)) for share in age]
        path = rr.Points3D.from_fields(colors=fading, radii=size * _PATH_RADIUS * (1.0 - age))
        cable = rr.LineStrips3D.from_fields(colors=rgb(_CABLE), radii=size * _CABLE_RADIUS)
        setpoint = rr.LineStrips3D.from_fields(colors=rgb(_GREY), radii=size * _CABLE_RADIUS / 2)
        self._log(self._ground, cable, "cable")
        self._log(self._ground, path, "path")
        contact = rr.Points3D.from_fields(colors=rgb(CONTACT), radii=size * _CONTACT_RADIUS)
        self._log(self._ground, contact, "contact")
        self._log(self._ground, setpoint, "setpoint", "cable")
        if self._has_arrows:
            arrows = rr.Arrows3D.from_fields(
                origins=[[0.0, 0.0, -size * _ARROWS_BELOW_TROLLEY]] * 2,
                colors=[rgb(COLOURS["phi"]), rgb(COLOURS["theta"])],
                radii=size * _ARROW_RADIUS,
            )
            trolley = _child_link(self._crane, self._crane.layout.role("trolley", "The arrows"))
            self._log(self._run.frame(trolley), arrows, "swing")

    def _move_path(self, trajectory: Trajectory, t_start: float) -> None:
        """Log the last positions of the payload, the newest first."""
        rows = rows_every(trajectory.t, _PATH_PERIOD)
        payload = rope_line(self._crane, trajectory.q[rows])[:, -1]
        new = np.flatnonzero(trajectory.t[rows] >= t_start)
        past = payload[np.clip(new[:, None] - np.arange(_PATH_POINTS), 0, None)]
        columns = rr.Points3D.columns(positions=past.reshape(-1, 3))
        lengths = np.full(len(new), _PATH_POINTS)
        self._send(trajectory.t[rows][new], columns.partition(lengths), "scene", "path")

    def _move_setpoint(self, t: np.ndarray, setpoint: np.ndarray) -> None:
        """Log the payload at rest at the setpoint of the drives, only where that changes."""
        changes = np.append(True, np.any(np.diff(setpoint, axis=0) != 0, axis=1))
        crane, n = self._crane, int(np.count_nonzero(changes))
        q = np.tile(crane.start.q, (n, 1))
        q[:, crane.layout.drives] = setpoint[changes]
        cable = rope_line(crane, q)
        orientation = np.array([payload_orientation(crane, row) for row in q])
        origin = cable[:, -1] - Rotation.from_quat(orientation).apply(crane.payload.lever)
        columns = rr.Transform3D.columns(
            translation=origin,
            quaternion=orientation,
            parent_frame=[self._ground] * n,
            child_frame=[self._run.frame("setpoint")] * n,
        )
        self._send(t[changes], columns, "joints", "setpoint")
        strips = rr.LineStrips3D.columns(strips=cable)
        self._send(t[changes], strips, "scene", "setpoint", "cable")

    def _move_arrows(self, t: np.ndarray, q: np.ndarray) -> None:
        """Log two arrows from the trolley to where the load hangs, along the jib and across it."""
        roles = ("radial_swing", "tangential_swing")
        swings = [self._crane.layout.role(role, "The arrows") for role in roles]
        phi, theta = self._look.arrow * np.degrees(q[:, swings]).T
        vectors = np.zeros((len(t), 2, 3))
        vectors[:, 0, 1], vectors[:, 1, 0] = phi, -theta
        columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3))
        self._send(t, columns.partition(np.full(len(t), 2)), "scene", "swing")

    def _log_scenery(self, scenery: Scenery, t_start: float) -> None:
        """Log obstacles, red while the load is near, the path of the load and the swept space."""
        for i, obstacle in enumerate(scenery.obstacles):
            corners = obstacle.vertices[obstacle.triangles]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
            mesh = rr.Mesh3D.from_fields(
                vertex_positions=corners.reshape(-1, 3),
                vertex_normals=np.repeat(normals, 3, axis=0),
            )
            self._log(self._ground, mesh, "site", str(i))
            colour, alpha = (_ZONE, 60) if obstacle.zone else (_SOLID, 255)
            times = np.array([t_start, *obstacle.near])
            rgba = [[*rgb(_NEAR if k % 2 else colour), alpha] for k in range(len(times))]
            columns = rr.Mesh3D.columns(albedo_factor=rgba)
            self._send(times, columns, "scene", "site", str(i))
        path = rr.LineStrips3D([scenery.path], colors=rgb(_SWEPT), radii=0.06)
        self._log(self._ground, path, "planned")
        if scenery.reserved is not None:
            times, lines = scenery.reserved
            style = rr.LineStrips3D.from_fields(colors=rgb(self._look.colour), radii=_RESERVED)
            self._log(self._ground, style, "reserved")
            self._send(times, rr.LineStrips3D.columns(strips=lines), "scene", "reserved")
        if scenery.swept:
            boxes = rr.Boxes3D(
                centers=scenery.swept["centres"],
                sizes=scenery.swept["sizes"],
                quaternions=Rotation.from_euler("z", scenery.swept["yaw"][:, None]).as_quat(),
                colors=[*rgb(_SWEPT), 25],
                fill_mode=_WIREFRAME,
            )
            self._log(self._ground, boxes, "swept")


def _urdf_tree(run: Run) -> UrdfTree:
    """Load the checked skeleton of the URDF, which names no files; Rerun reads files only."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "crane.urdf")
        file.write_text(skeleton(parse_urdf(run.crane.urdf, "the crane")), encoding="utf-8")
        return UrdfTree.from_file_path(file, frame_prefix=run.frame(""))


def _child_link(crane: Crane, index: int) -> str:
    """Return the link that a joint moves."""
    joint = crane.model.getFrameId(crane.layout.joints[index].name, pin.JOINT)
    bodies = (frame for frame in crane.model.frames if frame.type == pin.BODY)
    return next(str(body.name) for body in bodies if body.parentFrame == joint)


def _payload_link(crane: Crane) -> str:
    return _child_link(crane, crane.payload.body)


def _largest(link_shapes: Sequence[Shape]) -> Shape:
    """Return the largest shape of the payload, its body; a cube where there is none."""
    default = Shape("box", (1.0, 1.0, 1.0))
    return max(link_shapes, key=lambda shape: math.prod(shape.size), default=default)
