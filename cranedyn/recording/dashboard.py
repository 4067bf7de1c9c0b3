"""The layout that travels in a recording: the scene on the left, what it is about below, time series on the right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from cranedyn.dynamics.pinocchio import payload_position, pivot_position
from cranedyn.model.crane import DRIVES
from cranedyn.plotting.style import rgb
from cranedyn.recording.run import SCENE, TIMELINE, Run
from cranedyn.recording.scene import BACKGROUND, payload_entity
from cranedyn.recording.series import Table, plot

_UP = np.array([0.0, 0.0, 1.0])

_NEAR = 14.0
"""How far from the payload the view stands that follows it [m]."""


def dashboard(runs: Sequence[Run], tables: Sequence[Table]) -> rrb.Blueprint:
    """The layout for these runs and what is recorded of them; without tables, for runs that are only beginning."""
    busiest = _busiest_drive(runs)
    drives = [plot(name, runs, tables) for name in ("gamma", "x", "l")]
    efforts = [plot(name, runs, tables) for name in ("T_gamma", "F_x", "F_l", "speeds", "angular speeds")]
    efforts.insert(0, efforts.pop(busiest))
    titles = [f"Energy [J] · {run.name}" if len(runs) > 1 else "" for run in runs]
    energies = [plot("energy", [run], tables[i : i + 1], titles[i]) for i, run in enumerate(runs)]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Tabs(_scene(runs), _payload(runs), active_tab=0), rrb.TextDocumentView(origin="text", name="About"), row_shares=[7, 2]
            ),
            rrb.Vertical(
                rrb.Tabs(*drives, active_tab=busiest),
                plot("swing", runs, tables),
                rrb.Tabs(energies[0], *efforts, *energies[1:], active_tab=0),
                row_shares=[3, 4, 4],
            ),
            column_shares=[11, 9],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, loop_mode="all" if tables else "off", play_state="playing" if tables else "following"
        ),
        auto_views=False,
        auto_layout=False,
    )


def _busiest_drive(runs: Sequence[Run]) -> int:
    """The drive that moves furthest, slew counted along the arc of the trolley."""
    travel = [np.ptp(run.trajectory.q[:, DRIVES], axis=0) * (run.trajectory.q[:, 1].max(), 1.0, 1.0) for run in runs]
    return int(np.argmax(np.max(travel, axis=0)))


def _scene(runs: Sequence[Run]) -> rrb.Spatial3DView:
    return _view(SCENE, runs, _eye(runs))


def _payload(runs: Sequence[Run]) -> rrb.Spatial3DView:
    """The scene from beside the payload of the first run, which the eye follows."""
    run = runs[0]
    load, across = payload_position(run.crane, run.trajectory.q[0]) + run.offset, _across(run.trajectory.q[0, 0])
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
    """Where the scene is seen from: square to the middle of the sector that the jibs sweep, far enough for every crane to be seen whole.

    The eye is level, so that what is plumb looks plumb at every place of the picture.

    Cranes that stand in a row across their jibs are seen from the side of the tips instead, so that none hides another.
    """
    slew = np.concatenate([run.trajectory.q[:, 0] for run in runs])
    middle = (slew.min() + slew.max()) / 2
    along, across = np.array([np.sin(middle), -np.cos(middle), 0.0]), _across(middle)
    height = max(pivot_position(run.crane, run.crane.start.q)[2] for run in runs)
    reach = max(run.crane.upper[1] for run in runs)
    feet = np.array([run.offset for run in runs])
    in_a_row = np.ptp(feet @ across) > np.ptp(feet @ along)
    turn, rise, middle_height = (np.radians(55.0), 0.3, 0.4) if in_a_row else (0.0, 0.0, 0.56)
    towards, sideways = np.cos(turn) * across + np.sin(turn) * along, np.cos(turn) * along - np.sin(turn) * across
    distance = 0.8 * (height + reach) + 0.55 * np.ptp(feet @ sideways) + 0.35 * np.ptp(feet @ towards)
    target = feet.mean(axis=0) + 0.26 * reach * along + middle_height * height * _UP
    position = target + distance * (towards + rise * _UP)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)


def _across(slew: float) -> np.ndarray:
    """Unit vector square to the jib at a slew angle [rad], level, on the side from which cranes are seen."""
    return np.array([np.cos(slew), np.sin(slew), 0.0])
