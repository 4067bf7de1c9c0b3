"""Recordings of cranes and bodies whose postures are known over time, without the trajectory of a
simulated crane: such as two cranes that carry one load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from cranedyn.checks import finite
from cranedyn.data.files import with_ending
from cranedyn.errors import printable
from cranedyn.model.crane import Crane
from cranedyn.plotting.style import rgb, run_colour
from cranedyn.recording.contents import SCENE, Obstacle, clock, rows_every, utf8
from cranedyn.recording.recorder import check_enabled
from cranedyn.recording.scene import (
    BACKGROUND,
    archetype,
    obstacle_colour,
    obstacle_mesh,
    urdf_tree,
)
from cranedyn.recording.shapes import shapes
from cranedyn.recording.stream import recording_file, send_layout

_FRAME_PERIOD = 0.04
"""Time between rows of the scene [s]: 25 a second, as in a film."""

_ROPE_RADIUS = 0.06
"""Radius of a rope [m]."""

_ROPE_COLOUR = "#202020"
"""Colour of a rope."""

_GRID_SPACING = 5.0
"""Distance between lines of the grid on the ground [m]."""

_EYE_DIRECTION = np.array([0.9, -0.45, 0.4])
"""From the middle of what moves towards the eye."""


@dataclass(frozen=True, eq=False)
class PosedCrane:
    """A crane and its coordinates over time.

    Attributes:
        name: Its name.
        crane: The crane.
        q: Coordinates of all joints [rad or m], shape (rows, n).
        foot: Place of its foot in the scene [m], shape (3,).
        turn: Rotation of the crane about its foot, from X towards Y [rad].
        hidden: Names of links that are not drawn, such as a load that is not there.
    """

    name: str
    crane: Crane
    q: np.ndarray
    foot: np.ndarray
    turn: float = 0.0
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MovingBox:
    """A box and its place over time.

    Attributes:
        name: Its name.
        size: Its sides [m], shape (3,).
        position: Place of its centre in the scene [m], shape (rows, 3).
        rotation: Rotations from its axes to those of the scene, one for each row.
    """

    name: str
    size: np.ndarray
    position: np.ndarray
    rotation: Rotation


@dataclass(frozen=True, eq=False)
class MovingLine:
    """A line, such as a rope, over time.

    Attributes:
        name: Its name.
        points: Its points in the scene [m], shape (rows, points, 3).
    """

    name: str
    points: np.ndarray


def record_postures(
    path: str | Path,
    t: np.ndarray,
    cranes: Sequence[PosedCrane],
    boxes: Sequence[MovingBox] = (),
    lines: Sequence[MovingLine] = (),
    *,
    obstacles: Sequence[Obstacle] = (),
    curves: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    title: str,
    text: str = "",
) -> Path:
    """Write cranes and bodies that move as given into an ``.rrd`` file with its layout.

    Args:
        path: The file, ending in ``.rrd``.
        t: Times of all rows [s], shape (rows,).
        cranes: The cranes.
        boxes: Boxes beside them.
        lines: Lines beside them.
        obstacles: Obstacles, in the frame of the scene; what is near to them is not marked.
        curves: Plots by their titles, each with its curves by name, shape (rows,) each.
        title: Heading of the recording.
        text: Description in Markdown.

    Raises:
        OutOfRange: If a number is not finite, or tables have different numbers of rows.
        DataError: If the file cannot be written.
        CraneError: If Rerun is switched off in the environment.
    """
    path = with_ending(path, ".rrd")
    title = utf8(title)
    t = finite("times of a recording", t, ("rows",), unit="s")
    check_enabled()
    with recording_file(path, "cranedyn-postures") as recording:
        send_layout(recording, _layout(cranes, boxes, curves or {}))
        recording.send_recording_name(title)
        document = rr.TextDocument(f"## {title}\n\n{utf8(text)}", media_type="text/markdown")
        recording.log("text", document, static=True)
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        frames = rows_every(t, _FRAME_PERIOD)
        for crane in cranes:
            _log_crane(recording, crane, t, frames)
        for obstacle in obstacles:
            colour = rr.Mesh3D.from_fields(albedo_factor=obstacle_colour(obstacle))
            entity = _entity("site", obstacle.name)
            recording.log(entity, obstacle_mesh(obstacle), colour, static=True)
        for i, box in enumerate(boxes):
            _log_box(recording, box, t, frames, run_colour(i))
        for line in lines:
            points = finite(f"points of {line.name}", line.points, (len(t), "points", 3), unit="m")
            style = rr.LineStrips3D.from_fields(colors=rgb(_ROPE_COLOUR), radii=_ROPE_RADIUS)
            recording.log(_entity(line.name), style, static=True)
            columns = rr.LineStrips3D.columns(strips=points[frames])
            recording.send_columns(_entity(line.name), clock(t[frames]), columns)
        for plot, values in (curves or {}).items():
            _log_curves(recording, plot, values, t)
    return path


def _entity(*parts: str) -> str:
    """Return the path of an entity of the scene, with what Rerun reserves escaped."""
    return rr.new_entity_path(["scene", *map(utf8, parts)])


def _log_crane(
    recording: rr.RecordingStream, posed: PosedCrane, t: np.ndarray, frames: np.ndarray
) -> None:
    """Log the links of a crane in their frames, and the frames over time."""
    crane = posed.crane
    q = finite(f"coordinates of {posed.name}", posed.q, (len(t), crane.layout.n))
    prefix = f"{utf8(posed.name)}: "
    tree = urdf_tree(crane, prefix)
    foot = rr.Transform3D(
        translation=finite(f"foot of {posed.name}", posed.foot, (3,), unit="m"),
        rotation=rr.RotationAxisAngle([0.0, 0.0, 1.0], radians=posed.turn),
        parent_frame="tf#/",
        child_frame=prefix + tree.root_link().name,
    )
    recording.log(_entity(posed.name, "joints", "ground"), foot, static=True)
    moving = {joint.name for joint in crane.layout.joints}
    for fixed_joint in tree.joints():
        if fixed_joint.name not in moving:
            transform = fixed_joint.compute_transform(0.0, clamp=False)
            entity = _entity(posed.name, "joints", fixed_joint.name)
            recording.log(entity, transform, static=True)
    for joint, values in zip(crane.layout.joints, q.T, strict=True):
        urdf_joint = tree.get_joint_by_name(joint.name)
        assert urdf_joint is not None
        columns = urdf_joint.compute_transform_columns(values[frames].tolist(), clamp=False)
        recording.send_columns(_entity(posed.name, "joints", joint.name), clock(t[frames]), columns)
    for link, link_shapes in shapes(crane.urdf, None).items():
        if link in posed.hidden:
            continue
        drawn = [shape for shape in link_shapes if shape.mesh is None]
        for kind in dict.fromkeys(shape.kind for shape in drawn):
            group = [shape for shape in drawn if shape.kind == kind]
            body = archetype(group, "solid")
            entity = _entity(posed.name, link, kind)
            recording.log(entity, rr.CoordinateFrame(prefix + link), body, static=True)


def _log_box(
    recording: rr.RecordingStream, box: MovingBox, t: np.ndarray, frames: np.ndarray, colour: str
) -> None:
    """Log a box and its place over time."""
    position = finite(f"places of {box.name}", box.position, (len(t), 3), unit="m")
    entity = _entity(box.name)
    body = rr.Boxes3D(sizes=[box.size], colors=rgb(colour), fill_mode="solid")
    recording.log(entity, body, static=True)
    columns = rr.Transform3D.columns(
        translation=position[frames], quaternion=box.rotation[frames].as_quat()
    )
    recording.send_columns(entity, clock(t[frames]), columns)


def _log_curves(
    recording: rr.RecordingStream, plot: str, values: Mapping[str, np.ndarray], t: np.ndarray
) -> None:
    """Log the curves of a plot."""
    for i, (name, curve) in enumerate(values.items()):
        finite(f"{name} of {plot}", curve, (len(t),))
        entity = rr.new_entity_path(["plots", utf8(plot), utf8(name)])
        line = rr.SeriesLines(colors=rgb(run_colour(i)), names=printable(name), widths=1.5)
        recording.log(entity, line, static=True)
        recording.send_columns(entity, clock(t), rr.Scalars.columns(scalars=curve))


def _layout(
    cranes: Sequence[PosedCrane],
    boxes: Sequence[MovingBox],
    curves: Mapping[str, Mapping[str, np.ndarray]],
) -> rrb.Blueprint:
    """Return the layout: the scene with the text below it on the left, the plots on the right."""
    places = [crane.foot for crane in cranes] + [box.position.mean(axis=0) for box in boxes]
    target = np.mean(places, axis=0)
    # The cranes are about as high as they are apart from what they carry.
    size = 2.0 * max(float(np.linalg.norm(np.subtract(place, target))) for place in places) + 20.0
    eye = rrb.EyeControls3D(
        position=target + size * _EYE_DIRECTION,
        look_target=target + np.array([0.0, 0.0, size / 6.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    scene = rrb.Spatial3DView(
        name=SCENE,
        origin="/",
        contents=["+ /scene/**"],
        background=rrb.Background(color=rgb(BACKGROUND)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=_GRID_SPACING, color=rgb("#B4C0CC")),
        eye_controls=eye,
    )
    views = []
    for plot in curves:
        path = rr.new_entity_path(["plots", utf8(plot)])
        views.append(rrb.TimeSeriesView(name=plot, origin="/", contents=[f"+ {path}/**"]))
    left = rrb.Vertical(scene, rrb.TextDocumentView(origin="/text"), row_shares=[4, 1])
    if not views:
        return rrb.Blueprint(left, collapse_panels=True)
    columns = rrb.Horizontal(left, rrb.Vertical(*views), column_shares=[11, 9])
    return rrb.Blueprint(columns, collapse_panels=True)
