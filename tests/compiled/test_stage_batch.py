"""Many cranes whose loads are attached and released at once: each as it is alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.fleet import Fleet
from cranedyn.compiled.stage_batch import simulate_stage_batch
from cranedyn.controllers.follow import follow
from cranedyn.controllers.hold import hold_controller, zero_command
from cranedyn.data.columns import LOADS_COLUMN
from cranedyn.dynamics.contact import ON_GROUND, Ground, box_corners, box_load
from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp, spline
from cranedyn.simulation.stages import LoadStage, StagedRun, change_load, simulate_stages
from experiments.scenarios.crane_variants import POINT

HOOK = 100.0


def tower(mass: float) -> Crane:
    return load_crane(payload_mass=mass, **POINT)


def round_trips() -> tuple[list[list[LoadStage]], State]:
    """Cranes that attach different loads at different times, carry them by different ways, and
    release them.
    """
    empty = tower(HOOK)
    start = empty.state(l=12.0, phi=0.1, theta=-0.05)
    here = hold(empty, start)
    waits = follow(empty, here)
    lanes = []
    for mass, begin, way in ((700.0, 0.5, 2.0), (1500.0, 0.735, 1.0), (2000.0, 1.1, 3.0)):
        loaded = tower(mass)
        there = ramp(empty, here, "x", way, rate=0.5, at=1.5)
        lanes.append(
            [
                LoadStage(empty, waits, begin, here),
                LoadStage(loaded, follow(loaded, there), 4.0 - begin, there),
                LoadStage(empty, follow(empty, there), 0.4, there),
            ]
        )
    return lanes, start


def assert_alike(ours: StagedRun, alone: StagedRun) -> None:
    """All columns of both runs are the same up to round-off, by the size of each."""
    assert len(ours.trajectory) == len(alone.trajectory)
    for column in alone.trajectory.keys():
        expected = alone.trajectory[column]
        scale = max(1e-3, float(np.abs(expected).max()))
        assert_allclose(ours.trajectory[column], expected, rtol=0.0, atol=1e-9 * scale)
    assert_allclose(
        [(change.mass, change.brought, change.lost) for change in ours.changes],
        [(change.mass, change.brought, change.lost) for change in alone.changes],
        rtol=1e-9,
    )


def test_lanes_with_loads_and_times_of_their_own_are_those_of_runs_one_by_one() -> None:
    lanes, start = round_trips()
    batch = simulate_stage_batch(lanes, start=start, drive="motion")
    assert batch.valid.all() and len(batch) == 3
    assert_allclose(batch.mass(), [[600.0, -600.0], [1400.0, -1400.0], [1900.0, -1900.0]])
    assert (batch.lost()[:, 0] > 1.0).all() and not batch.lost()[:, 1].any()
    assert len(set(batch.t_end[:, 0])) == 3
    for i, of_lane in enumerate(lanes):
        alone = simulate_stages(
            of_lane, start=start, drive="motion", engine="pinocchio", validity="mark"
        )
        assert_alike(batch.run(i), alone)
        assert_allclose(batch.end.q[i], alone.trajectory.q[-1], rtol=0.0, atol=1e-9)
        assert batch.t_end[i, -1] == pytest.approx(alone.trajectory.t[-1], abs=1e-12)
        gained = batch.brought()[i] - batch.lost()[i]
        assert batch.run(i).trajectory[LOADS_COLUMN][-1] == pytest.approx(gained.sum())


@pytest.mark.parametrize("drive", ["effort", "velocity"])
def test_each_kind_of_drive_begins_a_stage_anew(drive: str) -> None:
    """Converters and efforts are as one by one; starts, times and references differ, too."""
    empty = tower(HOOK)
    lanes = []
    starts = []
    for mass, duration in ((500.0, 0.3), (900.0, 0.45)):
        loaded = tower(mass)
        first, second = hold_controller(empty), hold_controller(loaded)
        if drive == "velocity":
            first = second = zero_command(empty)
        lanes.append([LoadStage(empty, first, duration), LoadStage(loaded, second, 0.5)])
        starts.append(empty.state(l=10.0, phi=0.2, x=8.0 + duration))
    batch = simulate_stage_batch(lanes, start=starts, t_start=[0.0, 5.0], drive=drive)
    for i, of_lane in enumerate(lanes):
        alone = simulate_stages(
            of_lane,
            start=starts[i],
            t_start=5.0 * i,
            drive=converters(empty) if drive == "velocity" else drive,
            engine="compiled",
            validity="mark",
        )
        assert_alike(batch.run(i), alone)


def test_lanes_end_a_stage_when_their_loads_stand() -> None:
    """The first load stands earlier; the hook then rises without it."""
    sides = 1.5, 3.0, 1.2
    rope = {"rope_stiffness": 2e7, "hoist_max": 30.0}
    empty = load_crane(**box_load(50.0, 0.3, 0.3, 0.3), **rope)
    lanes = []
    starts = []
    ground = Ground(box_corners(*sides), friction=0.5)
    for mass, above in ((1000.0, 0.3), (1400.0, 0.5)):
        loaded = load_crane(**box_load(mass, *sides), **rope)
        start = loaded.state(x=18.0, l=26.78 - above)
        down = spline(loaded, start, [[0.0, 18.0, 27.4]], [5.0])
        lanes.append(
            [
                LoadStage(
                    loaded,
                    follow(loaded, down),
                    8.0,
                    down,
                    ground,
                    ends_when=lambda run: run["phase"] == ON_GROUND,
                ),
                LoadStage(empty, zero_command(empty), 0.5),
            ]
        )
        starts.append(start)
    batch = simulate_stage_batch(lanes, start=starts, drive="motion")
    assert 0.5 < batch.t_end[0, 0] < batch.t_end[1, 0] < 6.0
    for i, of_lane in enumerate(lanes):
        alone = simulate_stages(
            of_lane, start=starts[i], drive="motion", engine="compiled", validity="mark"
        )
        assert_alike(batch.run(i), alone)


def test_cranes_of_a_batch_may_begin_at_times_of_their_own() -> None:
    crane = tower(900.0)
    way = ramp(crane, hold(crane), "x", 2.0, rate=0.5, at=1.0)
    controller = follow(crane, way)
    times = [0.0, 0.8, 2.0]
    together = simulate_batch(
        crane, controller, way, t_start=times, duration=1.5, drive="motion", record=1
    )
    assert together.t.shape == (3, 301)
    for i, time in enumerate(times):
        alone = simulate_batch(
            crane, controller, way, t_start=time, duration=1.5, drive="motion", record=1
        )
        assert_allclose(together.t[i], alone.t)
        assert_allclose(together.q[i], alone.q[0], rtol=0.0, atol=0.0)


def test_what_a_batch_of_stages_cannot_do_is_refused_in_a_sentence() -> None:
    lanes, start = round_trips()
    with pytest.raises(OutOfRange, match="stages"):
        simulate_stage_batch([])
    with pytest.raises(OutOfRange, match=r"number of stages of crane 1 is 2; allowed is 3"):
        simulate_stage_batch([lanes[0], lanes[1][:2]], start=start, drive="motion")
    with pytest.raises(OutOfRange, match=r"number of starts is 2; allowed is 3"):
        simulate_stage_batch(lanes, start=[start, start], drive="motion")
    empty = tower(HOOK)
    never = LoadStage(empty, zero_command(empty), 0.1, ends_when=lambda run: run.t > 9.0)
    with pytest.raises(CraneError, match=r"Crane 1 of the batch: Stage 1 does not end"):
        ends = LoadStage(empty, zero_command(empty), 0.1)
        simulate_stage_batch([[ends], [never]], drive="motion")
    other = LoadStage(load_crane(rope_stiffness=2e7), zero_command(empty), 0.1)
    with pytest.raises(CraneError, match="other joints"):
        simulate_stage_batch([[ends, other]], drive="motion")
    with pytest.raises(CraneError, match="not affine"):
        python = LoadStage(empty, lambda t, state, setpoint: np.zeros(3), 0.1)
        simulate_stage_batch([[python]], drive="motion")
    with pytest.raises(OutOfRange, match="crane of a batch is 1; allowed is 0 to 0"):
        simulate_stage_batch([[ends]], drive="motion").run(1)
    crane = tower(HOOK)
    with pytest.raises(OutOfRange, match="residual_from"):
        simulate_batch(
            [crane] * 2,
            zero_command(crane),
            t_start=[0.0, 1.0],
            duration=1.0,
            drive="motion",
            residual_from=0.5,
        )


def test_a_fleet_takes_a_load_in_the_state_that_the_change_leaves() -> None:
    empty, loaded = tower(HOOK), tower(900.0)
    start = empty.state(l=10.0, phi=0.1)
    fleet = Fleet([empty, loaded], 2, control_period=0.1, drive="motion")
    fleet.place(np.array([0, 1]), start)
    still = np.zeros((3, 2))
    z = fleet.step(still)
    change = change_load(empty, loaded, State(z[:5, 1].copy(), z[5:, 1].copy()), prescribed=True)
    fleet.place(np.array([1]), change.state, np.array([1]))
    z = fleet.step(still)
    stages = [LoadStage(crane, zero_command(crane), 0.1) for crane in (empty, loaded)]
    whole = simulate_stages(stages, start=start, drive="motion", validity="mark").trajectory
    assert_allclose(z[:5, 1], whole.q[-1], rtol=0.0, atol=1e-12)
    assert_allclose(z[5:, 1], whole.v[-1], rtol=0.0, atol=1e-12)
    assert abs(z[:, 0] - z[:, 1]).max() > 1e-4
