"""The layout that travels in a recording: scene on the left, coordinates and text below it, plots
on the right.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun.blueprint as rrb

from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.equations_of_motion import payload_position, point_positions
from cranedyn.plotting.style import rgb
from cranedyn.recording.contents import SCENE, TIMELINE, Run
from cranedyn.recording.scene import BACKGROUND, drawn_size, payload_entity
from cranedyn.recording.series import GAPS, READOUT, Table, run_plots, time_range, time_series_view
from cranedyn.recording.shapes import visible_points

_UP = np.array([0.0, 0.0, 1.0])
"""Upward direction of every eye."""

_PAYLOAD_DISTANCE = 14.0
"""Distance from the payload of the eye that follows it [m], on a crane of 10 m and more."""

_REACH_ROWS = 50
"""Number of rows of a run, about, in which its reach is looked for; all of them would take long."""

_CORNER_DISTANCE = 0.8
"""Distance of the eye above a corner, over the diagonal of the box around all cranes."""

_DISTANCE_PER_SIZE = 0.8
"""Distance of the eye beside a jib, over the sum of the height and the reach of the crane."""

_DISTANCE_PER_WIDTH = 0.55
"""Distance that is added to it, over the width of the row of feet as the eye sees it."""

_DISTANCE_PER_DEPTH = 0.35
"""Distance that is added to it, over the depth of the row of feet as the eye sees it."""

_TARGET_REACH = 0.26
"""Distance along the jib of the point at which the eye looks, over the reach."""


class _EyeAngles(NamedTuple):
    """From where the eye looks at tower cranes.

    Attributes:
        turn: Angle from square to the jibs towards their tips [rad].
        rise: Height of the eye above the point at which it looks, over its horizontal distance.
        target_height: Height of that point, over the height of the crane.
    """

    turn: float
    rise: float
    target_height: float


_SQUARE = _EyeAngles(turn=0.0, rise=0.0, target_height=0.56)
"""Level and square to the jib, so that what is plumb looks plumb."""

_OBLIQUE = _EyeAngles(turn=float(np.radians(55.0)), rise=0.3, target_height=0.4)
"""From above and from the side of the tips, where cranes in a row would hide each other."""


def dashboard(runs: Sequence[Run], tables: Sequence[Table], *, gaps: bool = False) -> rrb.Blueprint:
    """Return the layout of a recording.

    Args:
        runs: The runs.
        tables: Their tables, see `cranedyn.recording.series.series_table`; empty for a run that is
            only beginning, which the layout then follows.
        gaps: Whether there are distances between cranes to plot.
    """
    return rrb.Blueprint(
        rrb.Horizontal(
            _scene_column(runs),
            _plot_column(runs, tables, gaps=gaps),
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


def _scene_column(runs: Sequence[Run]) -> rrb.Vertical:
    """Return the scene with the coordinates and the description below it."""
    # The table of coordinates has a row for each run; it has room for three at least.
    texts_share = 1.2 + 0.3 * max(3, len(runs))
    return rrb.Vertical(
        rrb.Tabs(scene_view(runs), payload_view(runs), active_tab=0),
        rrb.Horizontal(
            rrb.TextDocumentView(origin=READOUT, name="Now"),
            rrb.TextDocumentView(origin="text", name="About"),
            # In a window of 1,200 pixels the table of a tower crane is shown whole, also with names
            # of runs such as "without control".
            column_shares=[11, 9],
        ),
        row_shares=[7, texts_share],
    )


def _plot_column(runs: Sequence[Run], tables: Sequence[Table], *, gaps: bool) -> rrb.Vertical:
    """Return three rows of plots: positions of the drives; swing, stretch and gaps; energies,
    efforts and speeds.
    """
    plot_names = set[str]()
    symbols: list[str] = []
    efforts: list[str] = []
    for run in runs:
        plot_names.update(run_plots(run))
        for joint in run.crane.layout.driven:
            if joint.symbol not in symbols:
                symbols.append(joint.symbol)
            if joint.effort_name not in efforts:
                efforts.append(joint.effort_name)
    busiest = _busiest_drive(runs, symbols)
    efforts.insert(0, efforts.pop(busiest))
    speeds = [name for name in ("speeds", "angular speeds") if name in plot_names]

    position_views = [time_series_view(name, runs, tables) for name in symbols]
    energy_views = _energy_views(runs, tables)
    effort_and_speed_views = [time_series_view(name, runs, tables) for name in [*efforts, *speeds]]
    passive_views = []
    if gaps:
        axis = rrb.TimeAxis(view_range=time_range(runs))
        passive_views.append(
            rrb.TimeSeriesView(
                name="Distance [m]",
                origin=GAPS,
                axis_x=axis,
                # In the time after the last row, as in all plots.
                plot_legend=rrb.PlotLegend(corner="RightTop"),
            )
        )
    for name in ("swing", "stretch", "base", "base attitude"):
        if name in plot_names:
            passive_views.append(time_series_view(name, runs, tables))

    middle: rrb.Tabs | rrb.TimeSeriesView
    if len(passive_views) > 1:
        middle = rrb.Tabs(*passive_views)
    else:
        # A crane in which nothing swings shows its energy here, too.
        middle = (passive_views or energy_views)[0]
    return rrb.Vertical(
        rrb.Tabs(*position_views, active_tab=busiest),
        middle,
        rrb.Tabs(energy_views[0], *effort_and_speed_views, *energy_views[1:], active_tab=0),
        row_shares=[3, 5, 4],
    )


def _energy_views(runs: Sequence[Run], tables: Sequence[Table]) -> list[rrb.TimeSeriesView]:
    """Return a plot of the energy of each run; it has too many curves for several runs in one."""
    views = []
    for i, run in enumerate(runs):
        title = f"Energy [J] · {run.name}" if len(runs) > 1 else ""
        views.append(time_series_view("energy", [run], tables[i : i + 1], title))
    return views


def scene_view(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """Return the view of the whole scene: tower cranes from beside the jib, others from a corner.

    The eye is level before jibs, so that what is plumb looks plumb.
    """
    are_tower_cranes = all(run.crane.layout.has("slew") and not run.heading for run in runs)
    eye = _jib_eye(runs) if are_tower_cranes else _corner_eye(runs)
    return _view(SCENE, runs, eye)


def payload_view(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """Return the view of the scene from beside the payload of the first run, which it follows."""
    run = runs[0]
    payload = run.to_scene(payload_position(run.crane, run.trajectory.q[0]))
    distance = _PAYLOAD_DISTANCE * drawn_size(run.crane)
    eye = rrb.EyeControls3D(
        position=payload + distance * _across(_slew(run)[0]),
        look_target=payload,
        eye_up=_UP,
        tracking_entity=payload_entity(run),
    )
    return _view("Payload", runs, eye)


def extent(run: Run) -> np.ndarray:
    """Return the bounding box of a crane at the start of a run, in the scene: its lowest and its
    highest corner [m], shape (2, 3).
    """
    q = run.trajectory.q[0] if len(run.trajectory) else run.crane.start.q
    corners = [point_positions(run.crane, q)]
    for _, hull_points in visible_points(run.crane, q, run.meshes):
        corners.append(hull_points)
    points = run.to_scene(np.concatenate(corners))
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
    every = max(1, len(run.trajectory) // _REACH_ROWS)
    horizontal = point_paths(run.crane, run.trajectory.q[::every])[..., :2]
    return float(np.linalg.norm(horizontal, axis=-1).max())


def _view(name: str, runs: Sequence[Run], eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    """Return a view of the scene of all runs, above a grid of 5 m."""
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=[f"+ {run.entity('scene')}/**" for run in runs],
        background=rrb.Background(color=rgb(BACKGROUND)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=5.0, color=rgb("#B4C0CC")),
        eye_controls=eye,
    )


def _corner_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Return an eye above a corner of the bounding box of all cranes, before its longer side."""
    boxes = np.array([extent(run) for run in runs])
    low = boxes[:, 0].min(axis=0)
    high = boxes[:, 1].max(axis=0)
    is_longer_in_x = high[0] - low[0] > high[1] - low[1]
    direction = np.array([-0.45, -0.9, 0.4] if is_longer_in_x else [0.9, -0.45, 0.4])
    target = (low + high) / 2.0
    position = target + _CORNER_DISTANCE * np.linalg.norm(high - low) * direction
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)


def _jib_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Return an eye square to the middle of the sector of the jibs.

    Cranes in a row across their jibs are seen from the side of the tips: none hides another.
    """
    slew = np.concatenate([_slew(run) for run in runs])
    middle = (slew.min() + slew.max()) / 2
    # The jib points along -Y at zero slew, and turns from there towards +X.
    along_jib = np.array([np.sin(middle), -np.cos(middle), 0.0])
    across_jib = _across(middle)
    height = max(point_positions(run.crane, run.crane.start.q)[:, 2].max() for run in runs)
    reach = max(_reach(run) for run in runs)
    feet = np.array([run.offset for run in runs])
    in_a_row = np.ptp(feet @ across_jib) > np.ptp(feet @ along_jib)
    angles = _OBLIQUE if in_a_row else _SQUARE

    # Horizontal unit vectors from the scene to the eye, and to the right of it.
    towards_eye = np.cos(angles.turn) * across_jib + np.sin(angles.turn) * along_jib
    sideways = np.cos(angles.turn) * along_jib - np.sin(angles.turn) * across_jib
    # From farther away the eye sees a larger crane, and feet that are farther apart.
    distance = _DISTANCE_PER_SIZE * (height + reach)
    width = np.ptp(feet @ sideways)
    depth = np.ptp(feet @ towards_eye)
    distance += _DISTANCE_PER_WIDTH * width + _DISTANCE_PER_DEPTH * depth
    target = (
        feet.mean(axis=0) + _TARGET_REACH * reach * along_jib + angles.target_height * height * _UP
    )
    position = target + distance * (towards_eye + angles.rise * _UP)
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
