"""The layout that travels in a recording: the scene on the left, what it is about below, time
series on the right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from cranedyn.dynamics.pinocchio import payload_position, point_positions
from cranedyn.plotting.style import rgb
from cranedyn.recording.extent import extent
from cranedyn.recording.run import SCENE, TIMELINE, Run
from cranedyn.recording.scene import BACKGROUND, payload_entity
from cranedyn.recording.series import Table, plot, plots

_UP = np.array([0.0, 0.0, 1.0])

_NEAR = 14.0
"""How far from the payload the view stands that follows it [m]."""


def dashboard(runs: Sequence[Run], tables: Sequence[Table]) -> rrb.Blueprint:
    """The layout for these runs and what is recorded of them; without tables, for runs that are
    only beginning.
    """
    layouts = [run.crane.layout for run in runs]
    there = {name for layout in layouts for name in plots(layout)}
    symbols = list(dict.fromkeys(joint.symbol for layout in layouts for joint in layout.driven))
    columns = list(
        dict.fromkeys(column for layout in layouts for column in layout.columns()["effort"])
    )
    busiest = _busiest_drive(runs, symbols)
    drives = [plot(symbol, runs, tables) for symbol in symbols]
    efforts = [plot(column.rpartition("_")[0], runs, tables) for column in columns]
    efforts.insert(0, efforts.pop(busiest))
    efforts += [plot(name, runs, tables) for name in ("speeds", "angular speeds") if name in there]
    passive = [plot(name, runs, tables) for name in ("swing", "stretch") if name in there]
    titles = [f"Energy [J] · {run.name}" if len(runs) > 1 else "" for run in runs]
    energies = [plot("energy", [run], tables[i : i + 1], titles[i]) for i, run in enumerate(runs)]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Tabs(_scene(runs), _payload(runs), active_tab=0),
                rrb.TextDocumentView(origin="text", name="About"),
                row_shares=[7, 2],
            ),
            rrb.Vertical(
                rrb.Tabs(*drives, active_tab=busiest),
                rrb.Tabs(*passive) if len(passive) > 1 else passive[0] if passive else energies[0],
                rrb.Tabs(energies[0], *efforts, *energies[1:], active_tab=0),
                row_shares=[3, 4, 4],
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


def _busiest_drive(runs: Sequence[Run], symbols: Sequence[str]) -> int:
    """Which of the drives moves furthest, angles counted along the arc at the reach of the
    crane.
    """
    travel = dict.fromkeys(symbols, 0.0)
    for run in runs:
        for joint in run.crane.layout.driven:
            arm = _reach(run) if joint.kind == "revolute" else 1.0
            way = float(np.ptp(run.trajectory.coordinates(joint.symbol))) * arm
            travel[joint.symbol] = max(travel[joint.symbol], way)
    return list(travel.values()).index(max(travel.values()))


def _reach(run: Run) -> float:
    """How far from the foot the points of a crane come in a run [m], horizontally; for a trolley on
    a jib the end of its way.
    """
    layout = run.crane.layout
    if layout.has("slew", "trolley"):
        return float(run.crane.upper[layout.role("trolley", "The reach")])
    rows = run.trajectory.q[:: max(1, len(run.trajectory) // 50)]
    return float(
        max(np.linalg.norm(point_positions(run.crane, q)[:, :2], axis=1).max() for q in rows)
    )


def _scene(runs: Sequence[Run]) -> rrb.Spatial3DView:
    return _view(SCENE, runs, _eye(runs))


def _payload(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """The scene from beside the payload of the first run, which the eye follows."""
    run = runs[0]
    load, across = (
        payload_position(run.crane, run.trajectory.q[0]) + run.offset,
        _across(_slew(run)[0]),
    )
    eye = rrb.EyeControls3D(
        position=load + _NEAR * across,
        look_target=load,
        eye_up=_UP,
        tracking_entity=payload_entity(run),
    )
    return _view("Payload", runs, eye)


def _view(name: str, runs: Sequence[Run], eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=[f"+ {run.entity('scene')}/**" for run in runs],
        background=rrb.Background(color=rgb(BACKGROUND)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=5.0, color=rgb("#B4C0CC")),
        eye_controls=eye,
    )


def _eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Where the scene is seen from."""
    return _jib_eye(runs) if all(run.crane.layout.has("slew") for run in runs) else _box_eye(runs)


def _box_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """From a corner above the box about all cranes, whatever they are, far enough for every one to
    be seen whole.
    """
    boxes = np.array([extent(run) for run in runs])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    sideways = (
        np.array([-0.45, -0.9, 0.0])
        if high[0] - low[0] > high[1] - low[1]
        else np.array([0.9, -0.45, 0.0])
    )
    target = (low + high) / 2.0
    position = target + 0.8 * np.linalg.norm(high - low) * (sideways + np.array([0.0, 0.0, 0.4]))
    return rrb.EyeControls3D(
        position=position, look_target=target, eye_up=np.array([0.0, 0.0, 1.0])
    )


def _jib_eye(runs: Sequence[Run]) -> rrb.EyeControls3D:
    """Where tower cranes are seen from: square to the middle of the sector of the jibs, far enough
    for every one to be seen whole.

    The eye is level, so that what is plumb looks plumb at every place of the picture.

    Cranes that stand in a row across their jibs are seen from the side of the tips instead, so that
    none hides another.
    """
    slew = np.concatenate([_slew(run) for run in runs])
    middle = (slew.min() + slew.max()) / 2
    along, across = np.array([np.sin(middle), -np.cos(middle), 0.0]), _across(middle)
    height = max(point_positions(run.crane, run.crane.start.q)[:, 2].max() for run in runs)
    reach = max(_reach(run) for run in runs)
    feet = np.array([run.offset for run in runs])
    in_a_row = np.ptp(feet @ across) > np.ptp(feet @ along)
    turn, rise, middle_height = (np.radians(55.0), 0.3, 0.4) if in_a_row else (0.0, 0.0, 0.56)
    towards, sideways = (
        np.cos(turn) * across + np.sin(turn) * along,
        np.cos(turn) * along - np.sin(turn) * across,
    )
    distance = (
        0.8 * (height + reach) + 0.55 * np.ptp(feet @ sideways) + 0.35 * np.ptp(feet @ towards)
    )
    target = feet.mean(axis=0) + 0.26 * reach * along + middle_height * height * _UP
    position = target + distance * (towards + rise * _UP)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)


def _slew(run: Run) -> np.ndarray:
    """Slew angle in each row [rad], shape (rows,); zero for a crane that does not slew."""
    layout = run.crane.layout
    return (
        run.trajectory.q[:, layout.role("slew", "The view")]
        if layout.has("slew")
        else np.zeros(len(run.trajectory))
    )


def _across(slew: float) -> np.ndarray:
    """Unit vector square to the jib at a slew angle [rad], level, on the side from which cranes are
    seen.
    """
    return np.array([np.cos(slew), np.sin(slew), 0.0])
