"""One colour for each run wherever it is shown, an eye that is level, and a view that follows the
payload.
"""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting.style import RUN_COLOURS, rgb, run_colour
from cranedyn.recording import Run
from cranedyn.recording.contents import colours
from cranedyn.recording.dashboard import payload_view, scene_view
from cranedyn.recording.scene import looks, payload_entity
from cranedyn.recording.series import plots, series_table, time_series_view
from experiments import harness
from experiments.demo.live import in_step
from experiments.scenarios.moves import TOUR_LIMITS
from experiments.scenarios.strategies import strategy_colour
from experiments.scenarios.tours import CONTROLS
from tests.helpers import crane, quickly


@pytest.fixture(scope="module")
def moving() -> Trajectory:
    return quickly(crane(), hold_controller(crane()), start=crane().state(phi=0.1), duration=0.1)


def _inks(runs: list[Run], name: str) -> list[list[int]]:
    """Packed colours of the curves of each run of a plot."""
    view = time_series_view(name, runs, [series_table(run) for run in runs])
    return [
        [int(one.overrides[0].as_arrow_array()[0].as_py()) for one in visualizers]
        for visualizers in view.visualizer_overrides.values()
    ]


def _packed(colour: str) -> int:
    red, green, blue = rgb(colour)
    return red << 24 | green << 16 | blue << 8 | 255


def _channels(packed: int) -> np.ndarray:
    return np.array([packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255])


def test_a_run_has_one_colour_in_the_scene_and_in_every_plot(moving: Trajectory) -> None:
    runs = [Run(name, crane(), moving) for name in ("one", "two", "three")]
    expected = [run_colour(i) for i in range(3)]
    assert colours(runs) == [look.colour for look in looks(runs)] == expected
    for name, shown in plots(crane().layout).items():
        if name == "energy":
            continue
        for inks, colour in zip(_inks(runs, name), colours(runs), strict=True):
            curves = zip(inks, shown.curves, strict=True)
            inks_of = {curve.quantity: ink for ink, curve in curves}
            own = {
                ink for name, ink in inks_of.items() if name not in ("setpoint", "limit", "theta")
            }
            assert own == {_packed(colour)}
            pale = inks_of.get("theta", _packed(colour))  # θ is the paler of two swings
            assert np.all(_channels(pale) >= _channels(_packed(colour)))
            assert ("theta" in inks_of) == (pale != _packed(colour))


def test_a_run_can_bring_its_colour(moving: Trajectory) -> None:
    runs = [Run("one", crane(), moving), Run("two", crane(), moving, colour="#123456")]
    assert colours(runs)[1] == "#123456" == looks(runs)[1].colour


def test_every_curve_of_several_runs_is_named_with_its_run(moving: Trajectory) -> None:
    runs = [Run(name, crane(), moving) for name in ("one", "two")]
    view = time_series_view("swing", runs, [series_table(run) for run in runs])
    names = [
        str(batch.as_arrow_array()[0].as_py())
        for visualizers in view.visualizer_overrides.values()
        for one in visualizers
        for batch in one.overrides
        if "names" in str(batch.component_descriptor())
    ]
    assert names == [f"{label} · {run}" for run in ("one", "two") for label in "θφ"]


def test_the_eye_is_level_so_that_plumb_looks_plumb(moving: Trajectory) -> None:
    eye = scene_view([Run("one", crane(), moving)]).properties["EyeControls3D"]
    position, target = (
        np.array(part.as_arrow_array()[0].as_py()) for part in (eye.position, eye.look_target)
    )
    assert position[2] == pytest.approx(target[2], abs=1e-5)  # float32


def test_the_second_view_follows_the_payload(moving: Trajectory) -> None:
    run = Run("one", crane(), moving)
    view = payload_view([run])
    eye = view.properties["EyeControls3D"]
    tracked = eye.tracking_entity.as_arrow_array()[0].as_py()
    assert tracked == payload_entity(run) == "/one/scene/hook_link/box"


@pytest.mark.slow
def test_the_tour_without_control_waits_for_the_other_leg_by_leg() -> None:
    setup = harness.Setup()
    leader, _ = CONTROLS["shaped"](setup, TOUR_LIMITS, 12.0)
    bare, _ = CONTROLS["none"](setup, TOUR_LIMITS, 12.0)
    both = in_step(bare, leader)
    for one, other, before in zip(both.stages, leader.stages, bare.stages, strict=True):
        assert (one.begin, one.end) == (other.begin, other.end)
        assert one.arrival <= other.arrival + 1e-9
        assert one.arrival - one.begin == pytest.approx(before.arrival - before.begin)
        np.testing.assert_allclose(both(one.arrival + 1e-6).position, one.target, atol=1e-5)
    assert both.duration == leader.duration


def test_strategies_that_are_shown_together_have_colours_of_their_own() -> None:
    from experiments.compare import RECORDED
    from experiments.sweep import sweep_study

    for together in (RECORDED, list(sweep_study.STRATEGIES)):
        shown = [strategy_colour(strategy) for strategy in together]
        assert len(set(shown)) == min(len(shown), len(RUN_COLOURS))
