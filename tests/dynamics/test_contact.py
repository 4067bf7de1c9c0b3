"""Contact of the load with ground and platforms; closed forms stand in experiment validate."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, Hull, Platform, box_corners, box_load, standing
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError
from cranedyn.simulation.simulate import simulate
from experiments.oracles.bench import MASS, Bench, check_oracle, locked, point_crane
from experiments.oracles.bench import G as GRAVITY
from experiments.oracles.ground import HEIGHT, SINK, WIDTH, box_on_ground, free_box
from tests.helpers import FAST, constant, crane

CORNERS = box_corners(WIDTH, WIDTH, HEIGHT)
SIDES = (1.5, 3.0, 1.2)


def slid(duration: float, force: float = 0.0, **options: Any) -> Trajectory:
    box = free_box()
    ground = options.pop("ground", Ground(CORNERS, sink=SINK))
    start = {"z": HEIGHT / 2.0 - SINK} | options.pop("start", {})
    return simulate(
        box,
        options.pop("controller", constant(force)),
        start=box.state(**start),
        duration=duration,
        ground=ground,
        validity="mark",
        engine=options.pop("engine", FAST),
        **options,
    )


def unexplained(run: Trajectory) -> np.ndarray:
    gained = run.energy - run.energy[0]
    return gained - (run.work.sum(axis=1) - run.dissipated + run.outside.sum(axis=1))


@pytest.mark.parametrize("rule", [rk4, semi_implicit_euler], ids=lambda rule: rule.name)
@pytest.mark.slow
def test_both_engines_let_a_box_fall_tip_and_slide_alike(rule: Any) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    ground = Ground(CORNERS, (Platform((2.0, 0.0), (1.0, 2.0), 0.5, 0.2),), 0.1)
    start = {"z": HEIGHT / 2.0 + 0.1, "p": 0.1, "x_dot": 3.0}
    options = {"start": start, "ground": ground, "integrator": rule, "dt": 1e-3}
    plain, compiled = (slid(0.8, engine=name, **options) for name in ("pinocchio", "compiled"))
    ahead = slid(0.8, engine="compiled", controller=locked(free_box()), **options)
    for run in (compiled, ahead):
        assert np.allclose(run.q, plain.q, rtol=0.0, atol=1e-9)
        assert np.allclose(run.outside, plain.outside, rtol=0.0, atol=1e-4)
    assert plain.outside[-1, 1] < -1000.0


def test_a_box_on_the_ground_meets_its_closed_forms() -> None:
    checks = [check_oracle(oracle, 3) for oracle in box_on_ground(Bench(point_crane, FAST))]
    assert [check.oracle.name for check in checks if not check.holds] == []


def test_the_ledger_of_a_falling_box_closes_with_the_step_and_no_energy_comes_from_nowhere() -> (
    None
):
    fall = partial(slid, 1.0, start={"z": HEIGHT / 2.0 + 0.2, "p": 0.2, "x_dot": 1.0})
    coarse, fine = (np.abs(unexplained(fall(dt=dt))).max() for dt in (2.5e-4, 1.25e-4))
    assert fine < 0.6 * coarse
    elastic = Ground(CORNERS, restitution=1.0, friction=0.0)
    bounces = [fall(dt=dt, ground=elastic).energy for dt in (2.5e-4, 1.25e-4)]
    gains = [(energy.max() - energy[0]) / np.ptp(energy) for energy in bounces]
    assert gains[1] < 0.6 * gains[0] < 1e-3


def test_a_box_tips_where_a_push_at_its_centre_is_half_the_weight() -> None:
    sinking = math.asin(2.0 * SINK / WIDTH)  # of the edge when the other is free
    critical = MASS * GRAVITY * math.tan(math.atan(WIDTH / HEIGHT) - sinking)
    ground = Ground(CORNERS, friction=0.9, sink=SINK)

    def pushed(t: float, *_: object, force: float) -> np.ndarray:
        return np.array([force * min(t / 2.0, 1.0)])

    below, above = (
        slid(5.0, controller=partial(pushed, force=share * critical), ground=ground)["p_rad"][-1]
        for share in (0.995, 1.005)
    )
    assert below < 1.5 * sinking
    assert above > 3.0 * sinking


def test_a_box_is_stopped_by_the_side_of_a_platform_and_stands_on_its_top() -> None:
    platform = Platform((2.0, 0.0), (2.0, 4.0), 3.0)
    ground = Ground(CORNERS, (platform,), friction=0.0, sink=SINK)
    assert slid(2.0, ground=ground, start={"x_dot": 1.0})["x_m"].max() < 0.5 + 0.02
    above = slid(1.0, ground=ground, start={"x": 2.0, "z": 3.0 + HEIGHT / 2.0})
    assert above["z_m"][-1] == pytest.approx(3.0 + HEIGHT / 2.0 - SINK, abs=1e-9)


def test_a_load_stands_below_a_slack_rope_until_it_is_lifted() -> None:
    values = {"rope_stiffness": 2e7, "rope_damping": 2e4, "hoist_max": 30.0}
    tower = crane(**box_load(MASS, *SIDES), **values)
    ground = Ground(box_corners(*SIDES))
    start = standing(tower, ground, tower.state(l=26.9, phi=0.0))
    assert payload_position(tower, start.q)[2] == pytest.approx(0.6 - ground.sink, abs=1e-12)
    run = simulate(
        tower,
        lambda t, state, setpoint: np.array([0.0, 0.0, -0.2 - state.v[4]]),
        start=start,
        duration=2.0,
        drive="motion",
        engine=FAST,
        ground=ground,
    )
    pull = JointForces.of(tower).tension(run.q.T, run.v.T) / (MASS * GRAVITY)
    assert pull[0] == 0.0
    assert payload_position(tower, run.q[20])[2] == pytest.approx(0.6 - ground.sink, abs=1e-6)
    assert pull[-1] == pytest.approx(1.0, abs=0.05)
    assert payload_position(tower, run.q[-1])[2] > 0.7


@pytest.mark.slow
def test_both_engines_lift_a_load_off_lead_by_frequency_converters_alike() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    tower = crane(**box_load(MASS, *SIDES), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(*SIDES))
    start = standing(tower, ground, tower.state(l=26.83))
    common = {"start": start, "duration": 1.0, "drive": "velocity", "ground": ground}
    rates = constant(0.02, 0.3, -0.3)
    plain, compiled = (
        simulate(tower, rates, engine=e, **common) for e in ("pinocchio", "compiled")
    )
    assert {*plain.phase.tolist()} == {0.0, 2.0, 3.0}
    assert np.array_equal(plain.phase, compiled.phase)
    assert np.allclose(plain.q, compiled.q, rtol=0.0, atol=1e-9)
    assert np.allclose(plain.effort, compiled.effort, rtol=1e-6, atol=1e-3)
    assert np.allclose(plain.work, compiled.work, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_cranes_of_a_batch_touch_the_ground_each_on_its_own() -> None:
    batch = pytest.importorskip("cranedyn.compiled.batch", reason="needs the extra compiled")
    box, ground = free_box(), Ground(CORNERS, friction=0.2)
    starts = [box.state(z=1.0 + height, x_dot=1.0, p=0.1 * height) for height in (0.1, 0.3, 5.0)]
    common = {"duration": 0.6, "dt": 5e-4, "control_period": 5e-3, "ground": ground}
    end = batch.simulate_batch(box, locked(box), start=starts, **common).end
    for row, start in enumerate(starts):
        run = slid(
            0.6,
            ground=ground,
            controller=locked(box),
            start=dict(zip("xzp", start.q, strict=True)) | {"x_dot": 1.0},
        )
        assert np.allclose(end.q[row], run.q[-1], rtol=0.0, atol=1e-9)


def test_a_load_without_restitution_stays_where_it_falls() -> None:
    def highest(restitution: float) -> float:
        ground = Ground(CORNERS, restitution=restitution, sink=SINK)
        bottom = slid(1.0, ground=ground, start={"z": HEIGHT / 2.0 + 1.0})["z_m"] - HEIGHT / 2.0
        return float(bottom[np.flatnonzero(bottom < 0.0)[0] :].max())

    assert highest(0.0) < 0.0 < 0.01 < highest(0.2)


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_the_ground_is_at_any_height_and_a_hull_is_like_the_platform_of_its_corners(
    engine: Any,
) -> None:
    if engine == "compiled":
        pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    low, box = -3.0, Platform((2.0, 0.0), (1.0, 2.0), -2.5, 0.2)
    (x, y), corners = box.centre, [[a, b] for a in (-0.5, 0.5) for b in (-1.0, 1.0)]
    turn = np.array([[math.cos(0.2), math.sin(0.2)], [-math.sin(0.2), math.cos(0.2)]])
    hull = Hull([[*row, z] for row in np.array(corners) @ turn + [x, y] for z in (low, -2.5)])
    start = {"z": low + HEIGHT / 2.0 + 0.1, "p": 0.1, "x_dot": 3.0}
    runs = [
        slid(0.6, engine=engine, start=start, ground=Ground(CORNERS, (support,), 0.1, height=low))
        for support in (box, hull)
    ]
    assert runs[0]["z_m"].min() > low and runs[0]["x_m"].max() < 2.0
    assert np.allclose(runs[0].q, runs[1].q, rtol=0.0, atol=1e-6)  # normals are rounded at 1e-9
    assert all((run.valid == 1.0).all() for run in runs)
    leaves = slid(
        0.05, engine=engine, start=start | {"x": 99.9}, ground=Ground(CORNERS, height=low)
    )
    assert [event.joint for event in events(free_box(), leaves)] == ["x"]


def test_a_load_that_starts_in_the_ground_is_refused() -> None:
    with pytest.raises(CraneError, match="in the ground"):
        slid(0.1, start={"z": 0.9})


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_a_box_stands_and_slides_on_a_seam_of_two_platforms_as_on_one(engine: Any) -> None:
    if engine == "compiled":
        pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    seam = WIDTH / 2.0  # below the corners of a box that stands in the middle
    one = (Platform((0.0, 0.0), (8.0, 4.0), 2.0),)
    for speed, overlap in ((0.0, 0.0), (1.0, 0.0), (1.0, 1e-3), (0.0, 0.5)):
        two = [Platform((seam + x, 0.0), (8.0 + overlap, 4.0), 2.0) for x in (-4.0, 4.0)]
        start = {"x": -0.3 * speed, "x_dot": speed, "z": 2.0 + HEIGHT / 2.0 - SINK}
        whole, parts = (
            slid(0.5, start=start, ground=Ground(CORNERS, tops, 0.05, sink=SINK), engine=engine)
            for tops in (one, two)
        )
        assert np.allclose(parts.q, whole.q, rtol=0.0, atol=1e-9)
