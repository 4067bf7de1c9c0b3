"""The layout that travels in a recording: scene on the left, coordinates and text below it, plots
on the right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.pinocchio import payload_position, point_positions
from cranedyn.plotting.style import rgb
from cranedyn.recording.run import SCENE, TIMELINE, Run
from cranedyn.recording.scene import BACKGROUND, drawn_size, payload_entity
from cranedyn.recording.series import GAPS, READOUT, Table, plots, time_range, time_series_view
from cranedyn.recording.shapes import visible_points

_UP = np.array([0.0, 0.0, 1.0])
_PAYLOAD_DISTANCE = 14.0
"""Distance of the eye that follows the payload [m]."""


def dashboard(runs: Sequence[Run], tables: Sequence[Table], *, gaps: bool = False) -> rrb.Blueprint:
    """Return the layout for runs and their tables, and with a plot of gaps between cranes; without
    tables, for runs that are beginning.
    """
    names = {name for run in runs for name in plots(run.crane.layout)}
    driven = [joint for run in runs for joint in run.crane.layout.driven]
    symbols = list(dict.fromkeys(joint.symbol for joint in driven))
    efforts = list(dict.fromkeys(joint.effort_name for joint in driven))
    busiest = _busiest_drive(runs, symbols)
    efforts.insert(0, efforts.pop(busiest))
    efforts += [name for name in ("speeds", "angular speeds") if name in names]
    energies = [
        time_series_view(
            "energy", [run], tables[i : i + 1], f"Energy [J] · {run.name}" * (len(runs) > 1)
        )
        for i, run in enumerate(runs)
    ]
    drives_and_speeds = [time_series_view(name, runs, tables) for name in efforts]
    passive = [
        time_series_view(name, runs, tables) for name in ("swing", "stretch") if name in names
    ]
    if gaps:
        axis = rrb.TimeAxis(view_range=time_range(runs))
        passive.insert(0, rrb.TimeSeriesView(name="Distance [m]", origin=GAPS, axis_x=axis))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Tabs(scene_view(runs), payload_view(runs), active_tab=0),
                rrb.Horizontal(
                    rrb.TextDocumentView(origin=READOUT, name="Now"),
                    rrb.TextDocumentView(origin="text", name="About"),
                    column_shares=[9, 11],
                ),
                row_shares=[7, 1.2 + 0.3 * max(3, len(runs))],
            ),
            rrb.Vertical(
                rrb.Tabs(
                    *(time_series_view(name, runs, tables) for name in symbols), active_tab=busiest
                ),
                rrb.Tabs(*passive) if len(passive) > 1 else (passive or energies)[0],
                rrb.Tabs(energies[0], *drives_and_speeds, *energies[1:], active_tab=0),
                row_shares=[3, 5, 4],
            ),
            column_shares=[11, 9],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            loop_mode="all" if tables else "off",
            play_state="playing" if tables else "following",
        ),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """Return the view of the whole scene: tower cranes from beside the jib, others from a corner.

    The eye is level before jibs, so that what is plumb looks plumb.
    """
    jibs = all(run.crane.layout.has("slew") and not run.heading for run in runs)
    return _view(SCENE, runs, _jib_eye(runs) if jibs else _corner_eye(runs))


def payload_view(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """Return the view of the scene from beside the payload of the first run, which it follows."""
    run = runs[0]
    payload = run.to_scene(payload_position(run.crane, run.trajectory.q[0]))
    eye = rrb.EyeControls3D(
        position=payload + _PAYLOAD_DISTANCE * drawn_size(run.crane) * _across(_slew(run)[0]),
        look_target=payload,
        eye_up=_UP,
        tracking_entity=payload_entity(run),
    )
    return _view("Payload", runs, eye)


def extent(run: Run) -> np.ndarray:
    """Return the bounding box of a crane at the start of a run: two corners [m], shape (2, 3)."""
    q = run.trajectory.q[0] if len(run.trajectory) else run.crane.start.q
    visuals = [points for _, points in visible_points(run.crane, q, run.meshes)]
    points = run.to_scene(np.concatenate([point_positions(run.crane, q), *visuals]))
    return np.array([points.min(axis=0), points.max(axis=0)])


def _busiest_drive(runs: Sequence[Run], symbols: Sequence[str]) -> int:
    """Return the index of the drive that moves furthest; angles count as arcs at the reach."""
    travel = dict.fromkeys(symbols, 0.0)
    for run in runs:
        for joint in run.crane.layout.driven:
            arm = _reach(run) if joint.kind == "revolute" else 1.0
            length = float(np.ptp(run.trajectory.coordinates(joint.symbol))) * arm
            travel[joint.symbol] = max(travel[joint.symbol], length)
    return list(travel.values()).index(max(travel.values()))


def _reach(run: Run) -> float:
    """Return the greatest horizontal distance of a crane's points from its foot in a run [m]; for a
    trolley on a jib the end of its range.
    """
    layout = run.crane.layout
    if layout.has("slew", "trolley"):
        return float(run.crane.upper[layout.role("trolley", "The reach")])
    rows = run.trajectory.q[:: max(1, len(run.trajectory) // 50)]
    points = point_paths(run.crane, rows)[..., :2]
    return float(np.linalg.norm(points, axis=-1).max())


def _view(name: str, runs: Sequence[Run], eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=[f"+ {run.entity('scene')}/**" for run in runs],
        background=rrb.Background(color=rgb(BACKGROUND)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=5.0, color=rgb("#B4C0CC")),
        eye_controls=eye,
    )


def _corner_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Return an eye above a corner of the bounding box of all cranes."""
    boxes = np.array([extent(run) for run in runs])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    wide = high[0] - low[0] > high[1] - low[1]
    direction = np.array([-0.45, -0.9, 0.4] if wide else [0.9, -0.45, 0.4])
    target = (low + high) / 2.0
    position = target + 0.8 * np.linalg.norm(high - low) * direction
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)


def _jib_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Return an eye square to the middle of the sector of the jibs.

    Cranes in a row across their jibs are seen from the side of the tips: none hides another.
    """
    slew = np.concatenate([_slew(run) for run in runs])
    middle = (slew.min() + slew.max()) / 2
    along = np.array([np.sin(middle), -np.cos(middle), 0.0])
    across = _across(middle)
    height = max(point_positions(run.crane, run.crane.start.q)[:, 2].max() for run in runs)
    reach = max(_reach(run) for run in runs)
    feet = np.array([run.offset for run in runs])
    in_a_row = np.ptp(feet @ across) > np.ptp(feet @ along)
    turn, rise, target_height = (np.radians(55.0), 0.3, 0.4) if in_a_row else (0.0, 0.0, 0.56)
    towards = np.cos(turn) * across + np.sin(turn) * along
    sideways = np.cos(turn) * along - np.sin(turn) * across
    distance = 0.8 * (height + reach)
    distance += 0.55 * np.ptp(feet @ sideways) + 0.35 * np.ptp(feet @ towards)
    target = feet.mean(axis=0) + 0.26 * reach * along + target_height * height * _UP
    position = target + distance * (towards + rise * _UP)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)


def _slew(run: Run) -> np.ndarray:
    """Return the slew angle of each row [rad], shape (rows,); zero without a slewing joint."""
    layout = run.crane.layout
    if not layout.has("slew"):
        return np.zeros(len(run.trajectory))
    return run.trajectory.q[:, layout.role("slew", "The view")]


def _across(slew: float) -> np.ndarray:
    """Return the horizontal unit vector square to the jib, towards the eye."""
    return np.array([np.cos(slew), np.sin(slew), 0.0])
