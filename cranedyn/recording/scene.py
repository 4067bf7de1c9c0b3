"""The 3D scene of a recording: structure, cable, payload and its path, setpoint, swing arrows, and
scenery.

`rerun.urdf.UrdfTree` computes the transforms of the joints. It does not log the visuals, see
`cranedyn.recording.shapes` for what would be lost. The cable of changing length, which no URDF can
describe, is a line between points of the crane.

Each link is a frame in Rerun's tree of transforms, named by `Run.frame`. Entities below
"RUN/joints" hold the transforms between these frames, entities below "RUN/scene" what is drawn in
them. So the eye of a view can follow a payload, and a viewer can hide a part of the scene.
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
from cranedyn.dynamics.equations_of_motion import payload_orientation, point_positions
from cranedyn.errors import printable
from cranedyn.model.crane import Crane
from cranedyn.model.urdf import parse_urdf, skeleton
from cranedyn.plotting.style import COLOURS, mixed, rgb
from cranedyn.recording.contents import Obstacle, Run, Scenery, clock, colours, rows_every
from cranedyn.recording.shapes import CONTACT, Shape, rope_line, shapes, touching_points

BACKGROUND = "#E1E8F0"
"""Colour behind the scene, into which the path of the payload fades."""

PATH_SECONDS = 4.0
"""Duration of the path of the payload [s]."""

_FRAME_PERIOD = 0.04
"""Time between rows of the scene [s]: 25 a second, as in a film."""

_PATH_PERIOD = 0.1
"""Time between points of the path of the payload [s]."""

_PATH_POINTS = round(PATH_SECONDS / _PATH_PERIOD)
"""Number of points of the path of the payload."""

_CABLE = "#202020"
"""Colour of the cable."""

_SETPOINT = "#8C8C8C"
"""Colour of the cable at the setpoint."""

_CABLE_RADIUS = 0.05
"""Radius of the cable [m]; as all sizes below on a crane of 10 m and more, see `drawn_size`."""

_PATH_RADIUS = 0.16
"""Radius of the newest point of the path [m]."""

_ARROW_RADIUS = 0.12
"""Radius of the swing arrows [m]."""

_CONTACT_RADIUS = 0.2
"""Radius of marks where the load touches [m]."""

_ARROWS_BELOW_TROLLEY = 1.5
"""Distance of the swing arrows below the trolley [m]."""

_ARROW_SCALES = (0.5, 0.2, 0.1, 0.05)
"""Lengths of arrows for one degree of swing [m/°], of which the longest that fits is taken."""

_MAX_ARROW = 5.0
"""Length that arrows should not exceed [m]."""

_RESERVED_RADIUS = -1.5
"""Radius of the line around what is reserved for a crane. Rerun takes a negative radius for points
on the screen."""

_PLANNED_RADIUS = 0.06
"""Radius of the line along which a load is planned to move [m]."""

_SOLID_COLOUR = "#B9AE9B"
"""Colour of obstacles."""

_ZONE_COLOUR = "#CC3311"
"""Colour of zones to keep out of."""

_NEAR_COLOUR = "#F22B05"
"""Colour of obstacles and zones while the load is near."""

_SWEPT_COLOUR = "#0072B2"
"""Colour of the planned path of the load and of the space that it sweeps."""

_SWEPT_ALPHA = 25
"""Opacity of that space, 0 to 255."""

_ZONE_ALPHA = 60
"""Opacity of zones to keep out of, 0 to 255."""

_OVERLAPPING_ALPHA = 0.25
"""Share of its opacity with which a crane is drawn that stands where another one stands."""

_OUTLINE_COLOUR = (0.3, 0.3, 0.3, 0.5)
"""Colour of the payload at the setpoint: red, green, blue and alpha, 0 to 1."""

_WIREFRAME: Any = "transparentfillmajorwireframe"
"""Rerun's name for edges with transparent faces."""

_TANGENTIAL_SWING = "tangential_swing"
"""Role of the swing across the jib."""

_RADIAL_SWING = "radial_swing"
"""Role of the swing along the jib."""


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
    arrow = _arrow_scale(runs)
    offsets = [tuple(run.offset) for run in runs]
    result = []
    for i, (run, colour) in enumerate(zip(runs, colours(runs), strict=True)):
        overlaps = offsets[:i].count(offsets[i])
        label = printable(run.name) if len(runs) > 1 else ""
        result.append(Look(colour, overlaps, label, arrow))
    return result


def _arrow_scale(runs: Sequence[Run]) -> float:
    """Return the length of the swing arrows for one degree [m/°], the same for all runs, so that
    their arrows can be compared.
    """
    largest_swing = 0.0
    for run in runs:
        swing = np.degrees(run.trajectory.q[:, run.crane.swings])
        largest_swing = max(largest_swing, np.abs(swing).max(initial=0.0))
    size = min(drawn_size(run.crane) for run in runs)
    for scale in _ARROW_SCALES:
        if scale * largest_swing <= _MAX_ARROW:
            return scale * size
    return _ARROW_SCALES[-1] * size


def payload_entity(run: Run) -> str:
    """Return the entity with the body of the payload, which the eye of a view can follow."""
    link = _payload_link(run.crane)
    link_shapes = shapes(run.crane.urdf, run.meshes)[link]
    body = _largest(link_shapes)
    if body.kind != "mesh":
        return run.entity("scene", link, body.kind)
    # Each mesh is an entity of its own, see `Scene._log_shapes`.
    meshes = [shape for shape in link_shapes if shape.kind == "mesh"]
    return run.entity("scene", link, "mesh", str(meshes.index(body)))


def drawn_size(crane: Crane) -> float:
    """Return the size of cables and arrows, as a share of that on a crane of 10 m and more.

    On a model of a crane that stands on a table, a cable of 5 cm would hide the crane.
    """
    height = float(point_positions(crane, crane.start.q)[:, 2].max())
    return min(1.0, height / 10.0)


class Scene:
    """The scene of one run: the constructor logs what is static, `move` logs what moves."""

    def __init__(self, recording: rr.RecordingStream, run: Run, look: Look) -> None:
        """Log links, styles and scenery."""
        self._recording = recording
        self._run = run
        self._look = look
        self._crane = run.crane
        self._tree = urdf_tree(run.crane, run.frame(""))
        # The frame in which the crane stands, and the frame of the world at its foot. They are one,
        # unless the crane stands on a base that moves.
        self._ground = run.frame(self._tree.root_link().name)
        self._world = self._ground
        if run.trajectory.base is not None:
            self._world = run.frame("world below the base")
        self._size = drawn_size(run.crane)
        self._has_arrows = run.crane.layout.has("trolley", _RADIAL_SWING, _TANGENTIAL_SWING)
        self._log_links()
        self._log_styles()
        if run.scenery is not None:
            self._log_scenery(run.scenery, float(run.trajectory.t[0]))

    def move(self, trajectory: Trajectory, t_start: float = -math.inf) -> None:
        """Log the rows from a time on, 25 a second; the path also shows earlier rows.

        Args:
            trajectory: The trajectory, with the rows before that time that the path shows.
            t_start: Time of the first row to log [s].
        """
        crane = self._crane
        rows = rows_every(trajectory.t, _FRAME_PERIOD)
        rows = rows[trajectory.t[rows] >= t_start]
        t = trajectory.t[rows]
        q = trajectory.q[rows]
        if trajectory.base is not None:
            self._move_base(t, trajectory.base[rows])
        self._move_joints(t, q)
        self._send(t, rr.LineStrips3D.columns(strips=rope_line(crane, q)), "scene", "cable")
        if trajectory.phase is not None:
            self._move_contact(trajectory, rows)
        self._move_path(trajectory, t_start)
        self._move_setpoint(t, trajectory.setpoint[rows])
        if self._has_arrows:
            self._move_arrows(t, q)

    def _move_joints(self, t: np.ndarray, q: np.ndarray) -> None:
        """Log the transforms of the joints, only where they change."""
        for joint, values in zip(self._crane.layout.joints, q.T, strict=True):
            urdf_joint = self._tree.get_joint_by_name(joint.name)
            assert urdf_joint is not None
            changes = np.append(True, np.diff(values) != 0)
            # `get_joint_by_name` knows all joints: tree and layout come from one URDF. Joints may
            # stand beyond their limits, and are drawn where they are.
            columns = urdf_joint.compute_transform_columns(values[changes].tolist(), clamp=False)
            self._send(t[changes], columns, "joints", joint.name)

    def _move_base(self, t: np.ndarray, base: np.ndarray) -> None:
        """Log where the base is, from its coordinates, shape (rows, 6)."""
        columns = rr.Transform3D.columns(
            translation=base[:, :3],
            quaternion=Rotation.from_euler("xyz", base[:, 3:]).as_quat(),
            parent_frame=[self._world] * len(t),
            child_frame=[self._ground] * len(t),
        )
        self._send(t, columns, "joints", "base")

    def _move_contact(self, trajectory: Trajectory, rows: np.ndarray) -> None:
        """Log marks where the load touches, in rows of a trajectory."""
        # Without an empty array there would be nothing to concatenate if there are no rows.
        positions = [np.zeros((0, 3))]
        counts = []
        for row in rows:
            points = touching_points(self._crane, trajectory, int(row))
            positions.append(points)
            counts.append(len(points))
        marks = rr.Points3D.columns(positions=np.concatenate(positions)).partition(counts)
        self._send(trajectory.t[rows], marks, "scene", "contact")

    def _log(self, frame: str, body: rr.AsComponents, *parts: str) -> None:
        """Log what does not change in a frame, as an entity of the scene."""
        entity = self._run.entity("scene", *parts)
        self._recording.log(entity, rr.CoordinateFrame(frame), body, static=True)

    def _send(self, t: np.ndarray, columns: Any, *parts: str) -> None:
        """Log columns with a row at each of the times [s]."""
        self._recording.send_columns(self._run.entity(*parts), clock(t), columns)

    def _log_links(self) -> None:
        """Log the fixed joints and the shapes of all links, those of the payload in its colour."""
        run = self._run
        self._log_fixed_joints()
        payload = _payload_link(self._crane)
        by_link = shapes(self._crane.urdf, run.meshes)
        body = _largest(by_link[payload])
        if not by_link[payload]:
            by_link[payload] = [body]
        for link, link_shapes in by_link.items():
            painted = []
            for shape in link_shapes:
                if link == payload:
                    colour = self._payload_colour(shape, body)
                else:
                    colour = self._structure_colour(shape)
                painted.append(replace(shape, colour=colour))
            self._log_shapes(painted, run.frame(link), link)

        # The payload at the setpoint, a mesh as its bounding box.
        kind = "box" if body.mesh else body.kind
        outline = replace(body, kind=kind, mesh=None, colour=_OUTLINE_COLOUR)
        self._log_shapes([outline], run.frame("setpoint"), "setpoint", fill_mode=_WIREFRAME)
        if self._look.label:
            self._log_label(run.frame(payload))

    def _payload_colour(self, shape: Shape, body: Shape) -> tuple[float, ...]:
        """Return the colour of a shape of the payload: that of the run for its body and for what
        is painted like it, its own for all else, such as a hook.
        """
        if shape.colour != body.colour:
            return shape.colour
        red, green, blue = np.divide(rgb(self._look.colour), 255)
        return red, green, blue, 1.0

    def _structure_colour(self, shape: Shape) -> tuple[float, ...]:
        """Return the colour of a shape of the structure; it is transparent where cranes overlap,
        which are told apart by their payloads and paths.
        """
        red, green, blue, opacity = shape.colour
        alpha = _OVERLAPPING_ALPHA if self._look.overlaps else 1.0
        return red, green, blue, alpha * opacity

    def _log_fixed_joints(self) -> None:
        """Log where the crane stands, and the joints of its URDF that do not move."""
        run = self._run
        log = self._recording.log
        foot = rr.Transform3D(
            translation=run.offset,
            rotation=rr.RotationAxisAngle([0.0, 0.0, 1.0], radians=run.heading),
            parent_frame="tf#/",
            child_frame=self._world,
        )
        log(run.entity("joints", "ground"), foot, static=True)
        moving = {joint.name for joint in self._crane.layout.joints}
        for joint in self._tree.joints():
            if joint.name not in moving:
                fixed = joint.compute_transform(0.0, clamp=False)
                log(run.entity("joints", joint.name), fixed, static=True)

    def _log_label(self, payload_frame: str) -> None:
        """Log the name of the run below the payload.

        Labels of cranes that overlap stand below each other.
        """
        height = -self._size * (1.5 + 2.6 * self._look.overlaps)
        # Rerun has no text in 3D; a label belongs to something, here to a point of radius 0.
        label = rr.Points3D(
            [[0.0, 0.0, height]],
            radii=0.0,
            labels=[self._look.label],
            colors=rgb(mixed(self._look.colour, "#FFFFFF", 0.5)),
            show_labels=True,
        )
        self._log(payload_frame, label, "label")

    def _log_shapes(
        self, link_shapes: Sequence[Shape], frame: str, *parts: str, fill_mode: Any = "solid"
    ) -> None:
        """Log shapes in a frame: those of one kind as one entity, but each mesh as its own, since
        Rerun takes many boxes, cylinders or spheres for one entity, but only one mesh.
        """
        meshes = [shape for shape in link_shapes if shape.mesh is not None]
        for i, shape in enumerate(meshes):
            mesh = rr.Mesh3D(
                vertex_positions=shape.mesh.vertices,
                triangle_indices=shape.mesh.faces,
                vertex_normals=shape.mesh.vertex_normals,
                albedo_factor=[round(255 * c) for c in shape.colour],
            )
            self._log(frame, mesh, *parts, "mesh", str(i))
        kinds = dict.fromkeys(shape.kind for shape in link_shapes if shape.mesh is None)
        for kind in kinds:
            group = [shape for shape in link_shapes if shape.kind == kind]
            self._log(frame, archetype(group, fill_mode), *parts, kind)

    def _log_styles(self) -> None:
        """Log frames, colours and radii of the cables, the path, the contacts and the arrows.

        They do not change, so that `move` sends positions only.
        """
        size = self._size
        # The path fades and thins out with the age of its points, the newest first.
        age = np.linspace(0.0, 1.0, _PATH_POINTS, endpoint=False)
        fading = [rgb(mixed(self._look.colour, BACKGROUND, share)) for share in age]
        path = rr.Points3D.from_fields(colors=fading, radii=size * _PATH_RADIUS * (1.0 - age))
        cable = rr.LineStrips3D.from_fields(colors=rgb(_CABLE), radii=size * _CABLE_RADIUS)
        setpoint = rr.LineStrips3D.from_fields(
            colors=rgb(_SETPOINT), radii=size * _CABLE_RADIUS / 2
        )
        self._log(self._ground, cable, "cable")
        self._log(self._world, path, "path")
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
        if trajectory.base is not None:
            # The path in the world, which the base does not carry along.
            base = trajectory.base[rows]
            payload = base[:, :3] + Rotation.from_euler("xyz", base[:, 3:]).apply(payload)
        new = np.flatnonzero(trajectory.t[rows] >= t_start)
        # Indices of each new row and of the rows before it, shape (new rows, points of the path).
        # Before the first row there is none: the path stays at it.
        back = np.clip(new[:, None] - np.arange(_PATH_POINTS), 0, None)
        past = payload[back]
        columns = rr.Points3D.columns(positions=past.reshape(-1, 3))
        lengths = np.full(len(new), _PATH_POINTS)
        self._send(trajectory.t[rows][new], columns.partition(lengths), "scene", "path")

    def _move_setpoint(self, t: np.ndarray, setpoint: np.ndarray) -> None:
        """Log the payload at rest at the setpoint of the drives, only where that changes."""
        changes = np.append(True, np.any(np.diff(setpoint, axis=0) != 0, axis=1))
        crane = self._crane
        n = int(np.count_nonzero(changes))
        # The load hangs plumb in the start of a crane.
        q = np.tile(crane.start.q, (n, 1))
        q[:, crane.layout.drives] = setpoint[changes]
        cable = rope_line(crane, q)
        orientation = np.array([payload_orientation(crane, row) for row in q])
        # The cable ends at the centre of the load, which is off the origin of its link.
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
        roles = (_RADIAL_SWING, _TANGENTIAL_SWING)
        swings = [self._crane.layout.role(role, "The arrows") for role in roles]
        phi, theta = self._look.arrow * np.degrees(q[:, swings]).T
        # A positive swing is a load that lags: behind a trolley that moves out along -Y, and behind
        # a jib that turns towards +X.
        vectors = np.zeros((len(t), 2, 3))
        vectors[:, 0, 1] = phi
        vectors[:, 1, 0] = -theta
        columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3))
        self._send(t, columns.partition(np.full(len(t), 2)), "scene", "swing")

    def _log_scenery(self, scenery: Scenery, t_start: float) -> None:
        """Log obstacles, the path of the load, what is reserved for the crane, and the swept space.

        Args:
            scenery: The scenery.
            t_start: Time at which the run begins [s].
        """
        for i, obstacle in enumerate(scenery.obstacles):
            self._log_obstacle(obstacle, str(i), t_start)
        path = rr.LineStrips3D([scenery.path], colors=rgb(_SWEPT_COLOUR), radii=_PLANNED_RADIUS)
        self._log(self._ground, path, "planned")
        if scenery.reserved is not None:
            times, lines = scenery.reserved
            colour = rgb(self._look.colour)
            style = rr.LineStrips3D.from_fields(colors=colour, radii=_RESERVED_RADIUS)
            self._log(self._ground, style, "reserved")
            self._send(times, rr.LineStrips3D.columns(strips=lines), "scene", "reserved")
        if scenery.swept:
            boxes = rr.Boxes3D(
                centers=scenery.swept["centres"],
                sizes=scenery.swept["sizes"],
                quaternions=Rotation.from_euler("z", scenery.swept["yaw"][:, None]).as_quat(),
                colors=[*rgb(_SWEPT_COLOUR), _SWEPT_ALPHA],
                fill_mode=_WIREFRAME,
            )
            self._log(self._ground, boxes, "swept")

    def _log_obstacle(self, obstacle: Obstacle, name: str, t_start: float) -> None:
        """Log an obstacle, red while the load is near.

        Args:
            obstacle: The obstacle.
            name: Name of its entity.
            t_start: Time at which the run begins [s].
        """
        self._log(self._ground, obstacle_mesh(obstacle), "site", name)
        *usual_colour, alpha = obstacle_colour(obstacle)
        times = np.array([t_start, *obstacle.near])
        rgba = []
        for k in range(len(times)):
            # The load is far at the start; then it comes near and leaves in turn.
            is_near = k % 2 == 1
            rgba.append([*(rgb(_NEAR_COLOUR) if is_near else usual_colour), alpha])
        columns = rr.Mesh3D.columns(albedo_factor=rgba)
        self._send(times, columns, "scene", "site", name)


def obstacle_mesh(obstacle: Obstacle) -> rr.Mesh3D:
    """Return the surface of an obstacle as a mesh of Rerun, without a colour."""
    # Each triangle has corners of its own, all with its normal: so edges are drawn sharp. A
    # triangle without area has no normal; the quotient then must not be 0/0.
    corners = obstacle.vertices[obstacle.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return rr.Mesh3D.from_fields(
        vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0)
    )


def obstacle_colour(obstacle: Obstacle) -> list[int]:
    """Return red, green, blue and opacity of an obstacle that nothing is near to, 0 to 255."""
    if obstacle.zone:
        return [*rgb(_ZONE_COLOUR), _ZONE_ALPHA]
    return [*rgb(_SOLID_COLOUR), 255]


def archetype(group: Sequence[Shape], fill_mode: Any) -> rr.AsComponents:
    """Return shapes of one kind, "box", "cylinder" or "sphere", as one entity of Rerun."""
    size = np.array([shape.size for shape in group])
    centers = np.array([shape.centre for shape in group])
    quaternions = Rotation.from_euler("xyz", [shape.rpy for shape in group]).as_quat()
    colors = np.array([shape.colour for shape in group])
    if group[0].kind == "box":
        return rr.Boxes3D(
            sizes=size,
            centers=centers,
            quaternions=quaternions,
            colors=colors,
            fill_mode=fill_mode,
        )
    if group[0].kind == "cylinder":
        return rr.Cylinders3D(
            radii=size[:, 0],
            lengths=size[:, 1],
            centers=centers,
            quaternions=quaternions,
            colors=colors,
            fill_mode=fill_mode,
        )
    return rr.Ellipsoids3D(
        radii=size[:, 0],
        centers=centers,
        quaternions=quaternions,
        colors=colors,
        fill_mode=fill_mode,
    )


def urdf_tree(crane: Crane, frame_prefix: str) -> UrdfTree:
    """Load the checked skeleton of the URDF, which names no files; Rerun reads files only.

    Args:
        crane: The crane.
        frame_prefix: How the names of the coordinate frames of its links begin.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "crane.urdf")
        file.write_text(skeleton(parse_urdf(crane.urdf, "the crane")), encoding="utf-8")
        return UrdfTree.from_file_path(file, frame_prefix=frame_prefix)


def _child_link(crane: Crane, index: int) -> str:
    """Return the link that a joint moves."""
    model = crane.model
    joint_frame = model.getFrameId(crane.layout.joints[index].name, pin.JOINT)
    for frame in model.frames:
        if frame.type == pin.BODY and frame.parentFrame == joint_frame:
            return str(frame.name)
    raise AssertionError(f"No link follows the joint {crane.layout.joints[index].name}.")


def _payload_link(crane: Crane) -> str:
    """Return the link of the payload."""
    return _child_link(crane, crane.payload.body)


def _largest(link_shapes: Sequence[Shape]) -> Shape:
    """Return the largest shape of the payload, its body; a cube of 1 m where there is none.

    The product of the numbers of its size stands for the volume, which it is for boxes.
    """
    default = Shape("box", (1.0, 1.0, 1.0))
    return max(link_shapes, key=lambda shape: math.prod(shape.size), default=default)
