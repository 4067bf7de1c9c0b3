"""Loads that are attached and released: impacts by hand, energy across the change, both engines."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.command import interrupted
from cranedyn.controllers.hold import hold_controller, zero_command
from cranedyn.data.columns import LOADS_COLUMN
from cranedyn.data.trajectory import read
from cranedyn.dynamics.contact import ON_GROUND, Ground, Platform, box_corners, box_load, standing
from cranedyn.dynamics.equations_of_motion import payload_position, point_velocities
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, Misshapen, OutOfRange, RunError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stages import LoadStage, change_load, simulate_stages
from experiments.scenarios.crane_variants import POINT

HOOK = 100.0
LOADED = 900.0


def tower(mass: float, **values: float) -> Crane:
    return load_crane(payload_mass=mass, **{**POINT, **values})


def swinging(crane: Crane) -> State:
    """Return a load that passes below its pivot at 0.6 rad/s, on a rope of 10 m."""
    return crane.state(l=10.0, phi_dot=0.6)


def test_a_point_load_attached_to_a_swinging_hook_shares_its_momentum() -> None:
    """A plastic impact by hand: v₁ = v₀ m/(m + M), and the energy ½ m M/(m + M) v₀² is lost."""
    empty, loaded = tower(HOOK), tower(LOADED)
    change = change_load(empty, loaded, swinging(empty), prescribed=True)
    phi = loaded.layout.index("phi")
    assert change.mass == pytest.approx(LOADED - HOOK)
    assert change.state.v[phi] == pytest.approx(0.6 * HOOK / LOADED, rel=1e-12)
    attached = LOADED - HOOK
    lost = 0.5 * HOOK * attached / LOADED * (10.0 * 0.6) ** 2
    assert change.lost == pytest.approx(lost, rel=1e-9)
    height = float(payload_position(loaded, change.state.q)[2])
    assert change.brought == pytest.approx(attached * loaded.gravity * height, rel=1e-9)


def test_free_drives_take_their_part_of_an_impact_by_the_theorem_of_carnot() -> None:
    """The energy lost is the kinetic energy of the speeds lost: those of the crane by its own mass
    matrix, and that of the load, which comes from rest. A winch with inertia makes the rope pull,
    whose taut length does not change.
    """
    rope = {"rope_stiffness": math.inf, "drum_inertia": 5000.0}
    empty, loaded = tower(HOOK, **rope), tower(LOADED, **rope)
    before = empty.state(l=10.0, phi=0.3, theta=-0.2, phi_dot=0.6, theta_dot=-0.4, x_dot=0.5)
    change = change_load(empty, loaded, before)
    drop = before.v - change.state.v
    assert np.abs(drop[empty.layout.drives]).min() > 1e-6
    stretch = empty.layout.index("rope_stretch")
    assert drop[stretch] == 0.0
    of_crane = 0.5 * drop @ empty.mass_matrix(before.q) @ drop
    speed = point_velocities(loaded, change.state)[0]
    of_load = 0.5 * (LOADED - HOOK) * speed @ speed
    assert change.lost == pytest.approx(of_crane + of_load, rel=1e-9)
    # Nothing but the rope pushes along a coordinate, so that the momentum of each other one stays.
    after = np.delete(loaded.mass_matrix(before.q) @ change.state.v, stretch)
    expected = np.delete(empty.mass_matrix(before.q) @ before.v, stretch)
    assert_allclose(after, expected, rtol=1e-9, atol=1e-6)


def test_a_released_load_takes_its_energy_away_and_leaves_all_rates() -> None:
    loaded, empty = tower(LOADED), tower(HOOK)
    before = swinging(loaded)
    change = change_load(loaded, empty, before)
    assert change.state is before
    released = LOADED - HOOK
    height = float(payload_position(loaded, before.q)[2])
    taken = released * (loaded.gravity * height + 0.5 * (10.0 * 0.6) ** 2)
    assert (change.brought, change.lost) == (pytest.approx(-taken, rel=1e-9), 0.0)


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_energy_is_accounted_for_across_attaching_and_releasing(
    engine: str, tmp_path: Path
) -> None:
    """The ledger of the whole run moves by no more than the integration error of its stages."""
    empty, loaded = tower(HOOK), tower(LOADED)
    stages = [
        LoadStage(empty, zero_command(empty), 1.0),
        LoadStage(loaded, zero_command(loaded), 1.5),
        LoadStage(empty, zero_command(empty), 0.5),
    ]
    options = {"drive": "motion", "integrator": rk4, "engine": engine}
    start = empty.state(l=10.0, phi=0.2, theta=0.1)
    run = simulate_stages(stages, start=start, **options)
    whole = run.trajectory
    assert len(whole) == 601
    assert whole.t[-1] == pytest.approx(3.0, abs=1e-12)
    jumps = np.abs(np.diff(whole.energy)).max()
    assert jumps > 1e4
    assert np.abs(whole.unexplained).max() < 1e-8 * jumps
    assert run.changes[0].lost > 1.0
    net = sum(change.brought - change.lost for change in run.changes)
    assert whole[LOADS_COLUMN][[0, -1]].tolist() == [0.0, pytest.approx(net)]
    masses = [stage["crane"]["arguments"]["payload_mass"] for stage in whole.record["stages"]]
    assert masses == [str(HOOK), str(LOADED), str(HOOK)] or masses == [HOOK, LOADED, HOOK]
    path = whole.write(tmp_path / "run.parquet")
    assert_allclose(read(path)[LOADS_COLUMN], whole[LOADS_COLUMN])


def test_both_engines_run_the_same_stages() -> None:
    empty, loaded = tower(HOOK), tower(LOADED)
    found = []
    for engine in ("pinocchio", "compiled"):
        stages = [
            LoadStage(empty, hold_controller(empty), 0.5),
            LoadStage(loaded, hold_controller(loaded), 0.5),
        ]
        start = empty.state(l=10.0, phi=0.2)
        found.append(simulate_stages(stages, start=start, engine=engine).trajectory)
    assert_allclose(found[0].q, found[1].q, rtol=0.0, atol=1e-9)
    assert_allclose(found[0].energy, found[1].energy, rtol=1e-9)


def test_a_load_is_set_down_and_released_and_the_hook_rises_without_it() -> None:
    """The stage ends when the load stands; then the empty hook of 50 kg leaves it."""
    sides = 1.5, 3.0, 1.2
    loaded = load_crane(**box_load(1000.0, *sides), rope_stiffness=2e7, hoist_max=30.0)
    empty = load_crane(**box_load(50.0, 0.3, 0.3, 0.3), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(*sides), (Platform((0.0, -18.0), (2.0, 4.0), 1.0),), friction=0.5)
    lies = standing(loaded, ground, loaded.state(l=26.85))
    above = lies.q.copy()
    hoist = loaded.layout.drives[2]
    above[hoist] -= 0.6
    above[loaded.springs.rope.stretch] = 0.0
    start = State(above, np.zeros_like(above))

    def lower(t: float, state: State, setpoint: object) -> np.ndarray:
        return np.array([0.0, 0.0, 1.0 * (0.2 - state.v[hoist])])

    def lift(t: float, state: State, setpoint: object) -> np.ndarray:
        return np.array([0.0, 0.0, 1.0 * (-0.5 - state.v[hoist])])

    stages = [
        LoadStage(
            loaded, lower, 12.0, ground=ground, ends_when=lambda run: run["phase"] == ON_GROUND
        ),
        LoadStage(empty, lift, 3.0),
    ]
    run = simulate_stages(stages, start=start, drive="motion", validity="mark")
    stood = float(run.stages[0].t[-1])
    assert 1.0 < stood < 12.0
    assert run.stages[0]["phase"][-1] == ON_GROUND
    assert run.changes[0].mass == pytest.approx(-950.0)
    last = run.trajectory.state(-1)
    rise = payload_position(empty, last.q) - payload_position(loaded, run.stages[0].state(-1).q)
    assert rise[2] > 0.5
    assert abs(run.trajectory.unexplained).max() < 1e-3 * np.ptp(run.trajectory.energy)


def test_what_is_impossible_is_refused_in_a_sentence() -> None:
    empty, loaded = tower(HOOK), tower(LOADED)
    controller = zero_command(empty)
    with pytest.raises(OutOfRange, match="stages"):
        simulate_stages([])
    with pytest.raises(CraneError, match="other joints"):
        change_load(empty, load_crane(rope_stiffness=math.inf), empty.start)
    with pytest.raises(CraneError, match="differ at"):
        change_load(empty, tower(LOADED, trolley_mass=900.0), empty.start)
    never = LoadStage(empty, controller, 0.1, ends_when=lambda run: run.t > 1.0)
    with pytest.raises(CraneError, match=r"Stage 1 does not end within its 0\.1 s"):
        simulate_stages([never], drive="motion")
    wrong = LoadStage(empty, controller, 0.1, ends_when=lambda run: run.t[:2] > 1.0)
    with pytest.raises(Misshapen):
        simulate_stages([wrong], drive="motion")
    at_once = LoadStage(loaded, controller, 0.1, ends_when=lambda run: run.t >= 0.0)
    with pytest.raises(CraneError, match="Stage 2 may end where it begins"):
        simulate_stages([LoadStage(empty, controller, 0.1), at_once], drive="motion")


def test_a_stage_that_fails_loses_nothing_of_those_before() -> None:
    empty, loaded = tower(HOOK), tower(LOADED)

    def fails(t: float, state: State, setpoint: object) -> np.ndarray:
        if t > 0.3:
            raise ValueError("no")
        return np.zeros(3)

    stages = [LoadStage(empty, zero_command(empty), 0.2), LoadStage(loaded, fails, 0.5)]
    with pytest.raises(RunError) as caught:
        simulate_stages(stages, drive="motion")
    recorded = caught.value.trajectory
    assert recorded is not None
    assert (recorded.t[0], recorded.t[-1]) == (0.0, pytest.approx(0.295))
    assert LOADS_COLUMN in recorded.keys()


@pytest.mark.parametrize("where", ["before the first row", "while the load is changed"])
def test_ctrl_c_before_a_stage_has_begun_keeps_the_stages_before(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty, loaded = tower(HOOK), tower(LOADED)

    def interrupts(*_: object, **__: object) -> np.ndarray:
        raise KeyboardInterrupt

    if where == "while the load is changed":
        monkeypatch.setattr("cranedyn.simulation.stages.change_load", interrupts)
    stages = [LoadStage(empty, zero_command(empty), 0.2), LoadStage(loaded, interrupts, 0.5)]
    with pytest.raises(RunError, match=r"Interrupted at t = 0\.200 s") as caught:
        simulate_stages(stages, drive="motion")
    assert interrupted(caught.value)
    recorded = caught.value.trajectory
    assert recorded is not None and (recorded.t[0], recorded.t[-1]) == (0.0, pytest.approx(0.2))


def test_one_stage_is_a_run() -> None:
    crane = tower(LOADED)
    start = crane.state(l=10.0, phi=0.2)
    run = simulate_stages([LoadStage(crane, hold_controller(crane), 0.3)], start=start)
    alone = simulate(crane, hold_controller(crane), duration=0.3, start=start)
    assert_allclose(run.trajectory.q, alone.q, rtol=0.0, atol=0.0)
    assert not run.trajectory[LOADS_COLUMN].any()
