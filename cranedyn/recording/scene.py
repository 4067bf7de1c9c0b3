"""The crane in three dimensions: structure, cable, payload and its path, where the payload is wanted, and the swing as arrows."""

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

from cranedyn.crane import DRIVES, JOINTS
from cranedyn.dynamics import payload_position, pivot_position
from cranedyn.recording.run import Run, clock
from cranedyn.recording.shapes import Shape, log_shapes, shapes
from cranedyn.style import COLOURS, mixed, rgb

BACKGROUND = "#E1E8F0"
"""Colour behind the scene, into which the path of the payload fades."""

PATH_SECONDS = 4.0
"""How long the path of the payload stays [s]."""

_PICTURES_PER_SECOND, _PATH_POINTS_PER_SECOND = 50.0, 10.0
_PAYLOADS = ("#F22B05", "#0072B2", "#009E73", "#CC79A7", "#E69F00")
_CABLE, _GREY = "#202020", "#8C8C8C"
_CABLE_RADIUS, _PATH_RADIUS, _ARROW_RADIUS = 0.05, 0.16, 0.12
_ARROWS_BELOW_PIVOT = 1.5
_LONGEST_ARROW = 5.0


class Look(NamedTuple):
    """How one run is told from the others.

    Attributes:
        colour: Hex colour of payload and path.
        alpha: Opacity of the structure; a crane that stands where another stands already is seen through.
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
    """The rows of a run that become pictures, and the frame of the ground in which they are drawn."""

    t: np.ndarray
    q: np.ndarray
    wanted: np.ndarray
    ground: str


def looks(runs: Sequence[Run]) -> list[Look]:
    """The look of each run."""
    widest = max(np.degrees(np.abs(run.trajectory.q[:, 2:4])).max() for run in runs)
    arrow = next((scale for scale in (0.5, 0.2, 0.1) if scale * widest <= _LONGEST_ARROW), 0.05)
    found = []
    for i, run in enumerate(runs):
        here = sum(other.offset == run.offset for other in runs[:i])
        label = run.name if len(runs) > 1 else ""
        found.append(Look(_PAYLOADS[i % len(_PAYLOADS)], 0.25 if here else 1.0, label, 1.5 + 1.2 * here, arrow))
    return found


def log_scene(recording: rr.RecordingStream, run: Run, look: Look) -> None:
    """Draw one run, 50 pictures a second."""
    tree = _tree(run)
    rows = _every(run.trajectory.t, 1 / _PICTURES_PER_SECOND)
    ground = run.frame(tree.root_link().name)
    times = _Times(run.trajectory.t[rows], run.trajectory.q[rows], run.trajectory.wanted[rows], ground)
    foot = rr.Transform3D(translation=run.offset, parent_frame="tf#/", child_frame=ground)
    recording.log(run.entity("joints", "ground"), foot, static=True)
    _log_joints(recording, run, tree, times)
    body = _log_links(recording, run, tree, look)
    _log_load(recording, run, times, look)
    _log_wanted(recording, run, times, body)
    _log_swing(recording, run, times, look, _child(tree, "trolley_joint"))


def _tree(run: Run) -> UrdfTree:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "crane.urdf")
        file.write_text(run.crane.urdf, encoding="utf-8")
        return UrdfTree.from_file_path(file, frame_prefix=run.frame(""))


def _child(tree: UrdfTree, joint: str) -> str:
    found = tree.get_joint_by_name(joint)
    assert found is not None
    return found.child_link


def _every(t: np.ndarray, seconds: float) -> np.ndarray:
    """Rows a time apart, first and last among them."""
    return np.unique(np.searchsorted(t, np.append(np.arange(t[0], t[-1], seconds), t[-1]) - 1e-9))


def _log_joints(recording: rr.RecordingStream, run: Run, tree: UrdfTree, times: _Times) -> None:
    moving = [joint.name for joint in JOINTS]
    for joint in tree.joints():
        path = run.entity("joints", joint.name)
        if joint.name in moving:
            columns = joint.compute_transform_columns(times.q[:, moving.index(joint.name)].tolist(), clamp=False)
            recording.send_columns(path, clock(times.t), columns)
        else:
            recording.log(path, joint.compute_transform(0.0, clamp=False), static=True)


def _log_links(recording: rr.RecordingStream, run: Run, tree: UrdfTree, look: Look) -> Shape:
    """The links as they look; returns the body of the payload, its largest shape."""
    payload = _child(tree, "hoist_joint")
    by_link = shapes(run.crane.urdf)
    by_link[payload] = by_link[payload] or [Shape("box", (1.0, 1.0, 1.0))]
    body = max(by_link[payload], key=lambda shape: math.prod(shape.size))
    painted = (*(c / 255 for c in rgb(look.colour)), 1.0)
    for link, of_link in by_link.items():
        if link == payload:
            of_link = [replace(shape, colour=painted) if shape.colour == body.colour else shape for shape in of_link]
        else:
            of_link = [replace(shape, colour=(*shape.colour[:3], look.alpha * shape.colour[3])) for shape in of_link]
        log_shapes(recording, run.entity("scene", link), run.frame(link), of_link)
    if look.label:
        colour = rgb(mixed(look.colour, "#FFFFFF", 0.5))
        label = rr.Points3D([[0.0, 0.0, -look.label_depth]], radii=0.0, labels=[look.label], colors=colour, show_labels=True)
        recording.log(run.entity("scene", "label"), rr.CoordinateFrame(run.frame(payload)), label, static=True)
    return body


def _log_load(recording: rr.RecordingStream, run: Run, times: _Times, look: Look) -> None:
    """The cable from the pivot to the payload, and the path of the payload: as many points at any time, older ones paler and smaller."""
    ends = np.array([(pivot_position(run.crane, q), payload_position(run.crane, q)) for q in times.q])
    path = run.entity("scene", "cable")
    recording.log(path, rr.CoordinateFrame(times.ground), rr.LineStrips3D.from_fields(colors=rgb(_CABLE), radii=_CABLE_RADIUS), static=True)
    recording.send_columns(path, clock(times.t), rr.LineStrips3D.columns(strips=list(ends)))

    some, n = _every(times.t, 1 / _PATH_POINTS_PER_SECOND), round(PATH_SECONDS * _PATH_POINTS_PER_SECOND)
    past = ends[some, 1][np.clip(np.arange(len(some))[:, None] - np.arange(n), 0, None)]
    age = np.arange(n) / n
    points = rr.Points3D.from_fields(colors=[rgb(mixed(look.colour, BACKGROUND, a)) for a in age], radii=_PATH_RADIUS * (1 - age))
    path = run.entity("scene", "path")
    recording.log(path, rr.CoordinateFrame(times.ground), points, static=True)
    recording.send_columns(path, clock(times.t[some]), rr.Points3D.columns(positions=past.reshape(-1, 3)).partition(np.full(len(some), n)))


def _log_wanted(recording: rr.RecordingStream, run: Run, times: _Times, body: Shape) -> None:
    """An outline of the payload hanging at rest below the trolley where the drives are wanted; rows only where that changes."""
    rows = np.append(True, np.any(np.diff(times.wanted, axis=0) != 0, axis=1))
    q = np.zeros((np.count_nonzero(rows), 5))
    q[:, DRIVES] = times.wanted[rows]
    ends = np.array([(pivot_position(run.crane, row), payload_position(run.crane, row)) for row in q])
    turned = np.stack([0 * q[:, 0], 0 * q[:, 0], np.sin(q[:, 0] / 2), np.cos(q[:, 0] / 2)], axis=1)
    frame, path, n = run.frame("wanted"), run.entity("scene", "wanted"), len(q)
    moved = rr.Transform3D.columns(translation=ends[:, 1], quaternion=turned, parent_frame=[times.ground] * n, child_frame=[frame] * n)
    recording.send_columns(run.entity("joints", "wanted"), clock(times.t[rows]), moved)
    outline = replace(body, colour=(0.3, 0.3, 0.3, 0.5))
    log_shapes(recording, path, frame, [outline], "transparentfillmajorwireframe")
    look = rr.LineStrips3D.from_fields(colors=rgb(_GREY), radii=_CABLE_RADIUS / 2)
    recording.log(f"{path}/cable", rr.CoordinateFrame(times.ground), look, static=True)
    recording.send_columns(f"{path}/cable", clock(times.t[rows]), rr.LineStrips3D.columns(strips=list(ends)))


def _log_swing(recording: rr.RecordingStream, run: Run, times: _Times, look: Look, trolley: str) -> None:
    """Two arrows below the trolley that point where the load hangs off the plumb line: along the jib, and across it."""
    phi, theta = look.arrow * np.degrees(times.q[:, 2:4]).T
    vectors = np.zeros((len(phi), 2, 3))
    vectors[:, 0, 1], vectors[:, 1, 0] = phi, -theta
    arrows = rr.Arrows3D.from_fields(
        origins=[[0.0, 0.0, -_ARROWS_BELOW_PIVOT]] * 2, colors=[rgb(COLOURS["phi"]), rgb(COLOURS["theta"])], radii=_ARROW_RADIUS
    )
    path = run.entity("scene", "swing")
    recording.log(path, rr.CoordinateFrame(run.frame(trolley)), arrows, static=True)
    recording.send_columns(path, clock(times.t), rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3)).partition(np.full(len(phi), 2)))
