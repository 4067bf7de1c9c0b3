"""The crane in three dimensions: structure, cable, payload and its path, the setpoint of the
payload, and the swing as arrows.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree
from scipy.spatial.transform import Rotation

from cranedyn.dynamics.pinocchio import payload_orientation, point_positions
from cranedyn.errors import printable
from cranedyn.model.urdf import parse, skeleton
from cranedyn.plotting.style import COLOURS, mixed, rgb
from cranedyn.recording.run import Run, clock, colours
from cranedyn.recording.scenery import log_scenery
from cranedyn.recording.shapes import Shape, log_shapes, shapes

BACKGROUND = "#E1E8F0"
"""Colour behind the scene, into which the path of the payload fades."""

PATH_SECONDS = 4.0
"""How long the path of the payload stays [s]."""

_PICTURES_PER_SECOND, _PATH_POINTS_PER_SECOND = 50.0, 10.0
_PATH_POINTS = round(PATH_SECONDS * _PATH_POINTS_PER_SECOND)
_CABLE, _GREY = "#202020", "#8C8C8C"
_CABLE_RADIUS, _PATH_RADIUS, _ARROW_RADIUS = 0.05, 0.16, 0.12
_ARROWS_BELOW_PIVOT = 1.5
_LONGEST_ARROW = 5.0


class Look(NamedTuple):
    """How one run is told from the others.

    Attributes:
        colour: Hex colour of payload and path.
        alpha: Opacity of the structure; a crane that stands where another stands already is seen
            through.
        label: Words below the payload, empty for none.
        label_depth: How far below [m].
        arrow: Length of the swing arrows [m/°], the same for all runs.
    """

    colour: str
    alpha: float
    label: str
    label_depth: float
    arrow: float


class _Times(NamedTuple):
    """The rows of a run that become pictures, and the frame of the ground in which they are
    drawn.
    """

    t: np.ndarray
    q: np.ndarray
    setpoint: np.ndarray
    ground: str


def looks(runs: Sequence[Run]) -> list[Look]:
    """The look of each run."""
    widest = max(
        np.degrees(np.abs(run.trajectory.q[:, run.crane.swings])).max(initial=0.0) for run in runs
    )
    arrow = next((scale for scale in (0.5, 0.2, 0.1) if scale * widest <= _LONGEST_ARROW), 0.05)
    found = []
    for i, (run, colour) in enumerate(zip(runs, colours(runs), strict=True)):
        here = sum(other.offset == run.offset for other in runs[:i])
        label = printable(run.name) if len(runs) > 1 else ""
        found.append(Look(colour, 0.25 if here else 1.0, label, 1.5 + 2.6 * here, arrow))
    return found


class Scene:
    """One crane in a recording: what stands still is drawn at once, what moves with every call of
    `move`.
    """

    def __init__(self, recording: rr.RecordingStream, run: Run, look: Look) -> None:
        self._recording, self._look, self._tree = recording, look, _tree(run)
        self._ground = run.frame(self._tree.root_link().name)
        foot = rr.Transform3D(translation=run.offset, parent_frame="tf#/", child_frame=self._ground)
        recording.log(run.entity("joints", "ground"), foot, static=True)
        self._body = _log_links(recording, run, self._tree, look)
        _log_styles(recording, run, look, self._ground, _above_swing(run, self._tree), self._body)
        if run.scenery is not None:
            log_scenery(
                recording,
                run.entity("scene"),
                self._ground,
                run.scenery,
                float(run.trajectory.t[0]),
                clock,
            )

    def move(self, run: Run, since: float = -math.inf) -> None:
        """Draw the rows of a run from a time on [s], 50 pictures a second; earlier rows are the
        past that the path shows.
        """
        t = run.trajectory.t
        rows = _every(t, 1 / _PICTURES_PER_SECOND)
        fresh = rows[t[rows] >= since]
        times = _Times(
            t[fresh], run.trajectory.q[fresh], run.trajectory.setpoint[fresh], self._ground
        )
        _move_joints(self._recording, run, self._tree, times)
        _move_load(self._recording, run, times)
        _move_path(self._recording, run, since)
        _move_setpoint(self._recording, run, times)
        _move_swing(self._recording, run, times, self._look)


def _tree(run: Run) -> UrdfTree:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "crane.urdf")
        file.write_text(skeleton(parse(run.crane.urdf, "the crane")), encoding="utf-8")
        return UrdfTree.from_file_path(file, frame_prefix=run.frame(""))


def _child(tree: UrdfTree, joint: str) -> str:
    found = tree.get_joint_by_name(joint)
    assert found is not None
    return found.child_link


def _above_swing(run: Run, tree: UrdfTree) -> str | None:
    """The link from which the load swings along the jib and across it; None if the crane is
    another.
    """
    layout = run.crane.layout
    return (
        _child(tree, layout.joints[layout.role("trolley", "The arrows")].name)
        if layout.has("trolley", "radial_swing", "tangential_swing")
        else None
    )


def payload_entity(run: Run) -> str:
    """The entity with the body of the payload; an eye can follow one that has a shape."""
    link = _payload_link(run, _tree(run))
    of_link = shapes(run.crane.urdf, run.meshes)[link]
    body = _body(of_link)
    meshes = [
        i
        for i, shape in enumerate(shape for shape in of_link if shape.mesh is not None)
        if shape is body
    ]
    return run.entity("scene", link, *(["mesh", str(meshes[0])] if meshes else [body.kind]))


def _payload_link(run: Run, tree: UrdfTree) -> str:
    return _child(tree, run.crane.layout.joints[run.crane.payload.body].name)


def _body(of_payload: list[Shape]) -> Shape:
    """The body of the payload, its largest shape; a cube where nothing is drawn."""
    return max(
        of_payload or [Shape("box", (1.0, 1.0, 1.0))], key=lambda shape: math.prod(shape.size)
    )


def _every(t: np.ndarray, seconds: float) -> np.ndarray:
    """Rows a time apart, first and last among them."""
    return np.unique(np.searchsorted(t, np.append(np.arange(t[0], t[-1], seconds), t[-1]) - 1e-9))


def _move_joints(recording: rr.RecordingStream, run: Run, tree: UrdfTree, times: _Times) -> None:
    moving = [joint.name for joint in run.crane.layout.joints]
    for joint in tree.joints():
        if joint.name in moving:
            columns = joint.compute_transform_columns(
                times.q[:, moving.index(joint.name)].tolist(), clamp=False
            )
            recording.send_columns(run.entity("joints", joint.name), clock(times.t), columns)


def _log_links(recording: rr.RecordingStream, run: Run, tree: UrdfTree, look: Look) -> Shape:
    """The links as they look, on their fixed joints; returns the body of the payload, its largest
    shape.
    """
    moving = [joint.name for joint in run.crane.layout.joints]
    for joint in tree.joints():
        if joint.name not in moving:
            recording.log(
                run.entity("joints", joint.name),
                joint.compute_transform(0.0, clamp=False),
                static=True,
            )
    payload = _payload_link(run, tree)
    by_link = shapes(run.crane.urdf, run.meshes)
    by_link[payload] = by_link[payload] or [_body([])]
    body = _body(by_link[payload])
    painted = (*(c / 255 for c in rgb(look.colour)), 1.0)
    for link, of_link in by_link.items():
        if link == payload:
            of_link = [
                replace(shape, colour=painted) if shape.colour == body.colour else shape
                for shape in of_link
            ]
        else:
            of_link = [
                replace(shape, colour=(*shape.colour[:3], look.alpha * shape.colour[3]))
                for shape in of_link
            ]
        log_shapes(recording, run.entity("scene", link), run.frame(link), of_link)
    if look.label:
        colour = rgb(mixed(look.colour, "#FFFFFF", 0.5))
        label = rr.Points3D(
            [[0.0, 0.0, -look.label_depth]],
            radii=0.0,
            labels=[look.label],
            colors=colour,
            show_labels=True,
        )
        recording.log(
            run.entity("scene", "label"), rr.CoordinateFrame(run.frame(payload)), label, static=True
        )
    return body


def _log_styles(
    recording: rr.RecordingStream,
    run: Run,
    look: Look,
    ground: str,
    trolley: str | None,
    body: Shape,
) -> None:
    """Frames, colours and sizes of what moves: cable, path, the outline of the setpoint of the
    payload, swing arrows.
    """
    age = np.linspace(0.0, 1.0, _PATH_POINTS, endpoint=False)
    faded = [rgb(mixed(look.colour, BACKGROUND, a)) for a in age]
    arrows = rr.Arrows3D.from_fields(
        origins=[[0.0, 0.0, -_ARROWS_BELOW_PIVOT]] * 2,
        colors=[rgb(COLOURS["phi"]), rgb(COLOURS["theta"])],
        radii=_ARROW_RADIUS,
    )
    styles = {
        "cable": (ground, rr.LineStrips3D.from_fields(colors=rgb(_CABLE), radii=_CABLE_RADIUS)),
        "path": (ground, rr.Points3D.from_fields(colors=faded, radii=_PATH_RADIUS * (1 - age))),
        "setpoint/cable": (
            ground,
            rr.LineStrips3D.from_fields(colors=rgb(_GREY), radii=_CABLE_RADIUS / 2),
        ),
    } | ({} if trolley is None else {"swing": (run.frame(trolley), arrows)})
    for name, (frame, style) in styles.items():
        recording.log(
            f"{run.entity('scene')}/{name}", rr.CoordinateFrame(frame), style, static=True
        )
    outline = replace(
        body, kind="box" if body.mesh else body.kind, mesh=None, colour=(0.3, 0.3, 0.3, 0.5)
    )
    log_shapes(
        recording,
        run.entity("scene", "setpoint"),
        run.frame("setpoint"),
        [outline],
        "transparentfillmajorwireframe",
    )


def _ends(run: Run, q: np.ndarray) -> np.ndarray:
    """Pivot, hook if there is one, and payload in the world [m], shape (rows, points, 3)."""
    down = [*range(1, len(run.crane.points)), 0]
    return np.array([point_positions(run.crane, row)[down] for row in q]).reshape(-1, len(down), 3)


def _move_load(recording: rr.RecordingStream, run: Run, times: _Times) -> None:
    """The cable from the pivot to the payload."""
    recording.send_columns(
        run.entity("scene", "cable"),
        clock(times.t),
        rr.LineStrips3D.columns(strips=_ends(run, times.q)),
    )


def _move_path(recording: rr.RecordingStream, run: Run, since: float) -> None:
    """The path of the payload: as many points at any time, older ones paler and smaller."""
    t = run.trajectory.t
    some = _every(t, 1 / _PATH_POINTS_PER_SECOND)
    fresh = np.flatnonzero(t[some] >= since)
    payload = _ends(run, run.trajectory.q[some])[:, -1]
    past = payload[np.clip(fresh[:, None] - np.arange(_PATH_POINTS), 0, None)]
    columns = rr.Points3D.columns(positions=past.reshape(-1, 3)).partition(
        np.full(len(fresh), _PATH_POINTS)
    )
    recording.send_columns(run.entity("scene", "path"), clock(t[some][fresh]), columns)


def _move_setpoint(recording: rr.RecordingStream, run: Run, times: _Times) -> None:
    """An outline of the payload hanging at rest below the trolley at the setpoint of the drives;
    rows only where that changes.
    """
    rows = np.append(True, np.any(np.diff(times.setpoint, axis=0) != 0, axis=1))
    crane = run.crane
    q = np.tile(crane.start.q, (int(np.count_nonzero(rows)), 1))
    q[:, crane.layout.drives] = times.setpoint[rows]
    ends, n = _ends(run, q), len(q)
    turned = np.array([payload_orientation(crane, row) for row in q])
    # The shape stands in the frame of the link.
    foot = ends[:, -1] - Rotation.from_quat(turned).apply(crane.payload.lever)
    moved = rr.Transform3D.columns(
        translation=foot,
        quaternion=turned,
        parent_frame=[times.ground] * n,
        child_frame=[run.frame("setpoint")] * n,
    )
    recording.send_columns(run.entity("joints", "setpoint"), clock(times.t[rows]), moved)
    recording.send_columns(
        run.entity("scene", "setpoint", "cable"),
        clock(times.t[rows]),
        rr.LineStrips3D.columns(strips=ends),
    )


def _move_swing(recording: rr.RecordingStream, run: Run, times: _Times, look: Look) -> None:
    """Two arrows below the trolley that point where the load hangs off the plumb line: along the
    jib, and across it.
    """
    layout = run.crane.layout
    if not layout.has("trolley", "radial_swing", "tangential_swing"):
        return
    swings = [layout.role(role, "The arrows") for role in ("radial_swing", "tangential_swing")]
    phi, theta = look.arrow * np.degrees(times.q[:, swings]).T
    vectors = np.zeros((len(phi), 2, 3))
    vectors[:, 0, 1], vectors[:, 1, 0] = phi, -theta
    columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3)).partition(np.full(len(phi), 2))
    recording.send_columns(run.entity("scene", "swing"), clock(times.t), columns)
