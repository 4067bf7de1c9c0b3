"""Cranes of other topology: their closed forms, springs, free modes, and the experiment that shows
all of it.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.controllers.hold import zero_command
from cranedyn.dynamics.equations_of_motion import (
    acceleration,
    energy,
    holding_effort,
    linearise,
    payload_position,
)
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.estimation.observer import disturbance_of, initial_std_of
from cranedyn.interfaces import EngineName, State
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.dashboard import extent
from cranedyn.references import hold, ramp
from cranedyn.references.shaped import zv
from cranedyn.simulation.simulate import simulate
from experiments.cranes import modes
from experiments.harness import Setup
from experiments.scenarios.crane_variants import (
    BEND,
    BRIDGE,
    CRANE_VARIANTS,
    HOOK,
    JIB,
    POINT,
    ROPE,
    TWIST,
    CraneVariant,
    at_start,
    moved,
    variant_crane,
)
from tests.helpers import big_crane
from tests.rrd import numbers, rows

FALLS = CraneVariant("load on two falls", {"fall_spacing": 2.0})
EACH = (*CRANE_VARIANTS, FALLS)
each = pytest.mark.parametrize("variant", EACH, ids=[variant.name for variant in EACH])


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "slow", "fast"),
    [
        ((15.0, 5.0, 300.0, 2000.0), 0.70918925, 4.42110865),
        ((40.0, 4.0, 500.0, 5000.0), 0.47389722, 5.42591353),
        ((20.0, 10.0, 1000.0, 1000.0), 0.61202998, 1.60231529),
    ],
)
def test_a_double_pendulum_has_the_published_frequencies(
    numbers: tuple[float, ...], slow: float, fast: float
) -> None:
    # As printed.
    assert_allclose(theory.double_pendulum(*numbers, STANDARD_GRAVITY), (slow, fast), atol=5e-9)


def test_a_tower_that_twists_has_the_frequencies_derived_by_hand() -> None:
    tower = 1e6, 2e7, 20.0, 15.0, 2000.0, STANDARD_GRAVITY
    assert_allclose(theory.twisting_tower(*tower), (0.79786094, 4.53213150), atol=5e-9)
    _, fast = theory.twisting_tower(*tower, trolley=500.0)
    assert fast == pytest.approx(4.13761079, abs=5e-9)


def test_a_double_pendulum_with_a_load_that_weighs_nothing_is_two_pendulums() -> None:
    found = theory.double_pendulum(20.0, 5.0, 300.0, 1e-9, STANDARD_GRAVITY)
    assert_allclose(found, np.sqrt(STANDARD_GRAVITY / np.array([20.0, 5.0])), rtol=1e-10)


def test_a_rigid_tower_leaves_the_pendulum() -> None:
    length = 15.0
    load = 2000.0
    pendulum = math.sqrt(STANDARD_GRAVITY / 15.0)
    twisting = theory.twisting_tower(1e6, 1e15, 20.0, length, load, STANDARD_GRAVITY)
    bending = theory.bending_tower(1e6, 1e15, 0.0, 28.0, length, load, STANDARD_GRAVITY)
    assert_allclose([twisting[0], bending[0]], pendulum, rtol=1e-7)


@pytest.mark.parametrize("modes", [(), (0.7,), (0.7, 4.4)])
def test_convolved_shapers_leave_the_product_of_what_each_leaves(modes: tuple[float, ...]) -> None:
    expected = math.prod(float(zv().residual(0.9 / mode)) for mode in modes)
    assert theory.convolved_zv(0.9, modes) == pytest.approx(expected, abs=1e-15)


# --- springs --------------------------------------------------------------------------------------


@each
@pytest.mark.parametrize("low", [0.5, -0.5])
def test_springs_push_down_their_energy_and_the_tangent_is_how_they_do(
    variant: CraneVariant, low: float
) -> None:
    springs = variant_crane(variant).springs
    h = 1e-4
    n = len(springs.rest)
    q = np.random.default_rng(1).uniform(0.5, 2.0, n)
    ways = np.eye(n)
    q[-1] *= low / abs(low)  # the stretch, if there is one, and below zero a slack rope
    energies = [
        (springs.energy(q + h * way) - springs.energy(q - h * way)) / (2 * h) for way in ways
    ]
    assert_allclose(springs.effort(q), -np.array(energies), rtol=1e-6, atol=1e-3)  # h²
    slopes = [
        (springs.effort(q + 1e-6 * way) - springs.effort(q - 1e-6 * way)) / 2e-6 for way in ways
    ]
    assert_allclose(np.array(slopes).T, -springs.tangent(q), rtol=1e-6, atol=1e-3)


@each
def test_a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs(
    variant: CraneVariant,
) -> None:
    c = variant_crane(variant)
    by_state, _ = linearise(c, c.start, holding_effort(c, c.start.q))
    run = simulate(c, zero_command(c), duration=0.05, dt=5e-3, control_period=5e-3, drive="motion")
    assert np.abs(run.q - c.start.q).max() < 1e-12  # rounding of the balance, over ten steps
    assert np.isfinite(by_state).all()
    away = moved(c, **{c.layout.symbols[i]: 0.01 for i in c.layout.passive})
    stored = float(c.springs.energy(away.q)) if c.springs.any else 0.0
    rigid = float(pin.computeMechanicalEnergy(c.model, c.data, *away))
    assert energy(c, away) == pytest.approx(rigid + stored, rel=1e-15)


@each
def test_the_linear_crane_has_its_springs(variant: CraneVariant) -> None:
    """By central differences, good to about 1e-16/h + h² with h = 1e-5, of accelerations of some
    k/m.
    """
    c = variant_crane(variant)
    h = 1e-5
    effort = holding_effort(c, c.start.q)
    n = c.layout.n
    by_state, _ = linearise(c, c.start, effort)

    def slope(way: np.ndarray) -> np.ndarray:
        there, back = (
            acceleration(c, State(c.start.q + step * way[:n], step * way[n:]), effort)
            for step in (h, -h)
        )
        return (there - back) / (2.0 * h)

    expected = np.array([slope(way) for way in np.eye(2 * n)]).T
    assert_allclose(by_state, expected, atol=1e-6 * np.abs(expected).max())


def test_a_rope_stretches_by_its_load_over_its_stiffness_at_its_length() -> None:
    c = variant_crane(ROPE)
    weight = c.payload_mass * c.gravity
    stretch = weight * at_start(c, "l") / 3e6
    assert at_start(c, "rope_stretch") == pytest.approx(stretch, rel=1e-12)
    # a drum that is braked hard pushes the hoist joint, while the rope stays taut
    for hoist in (-weight, 1e4):
        tension = rope_tension(c.layout, JointForces.of(c), *c.start, hoist)
        assert tension == pytest.approx(weight, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 3000.0])
@pytest.mark.parametrize("engine", ["oracle", "compiled"])
@pytest.mark.usefixtures("oracle")
def test_a_load_thrown_up_is_free_until_its_rope_is_taut_again(
    engine: EngineName, damping: float
) -> None:
    c = ROPE.crane(**POINT, rope_damping=damping)
    lifted = moved(c, rope_stretch_dot=-4.0)  # by more than what the rope holds
    how = {"duration": 1.5, "control_period": 5e-4, "drive": "motion", "integrator": rk4}
    run = simulate(c, zero_command(c), start=lifted, engine=engine, **how)  # type: ignore[arg-type]
    joint = JointForces.of(c)
    tension = joint.tension(run.q.T, run.v.T)
    assert tension.min() == 0.0
    slack = (tension[1:] == 0.0) & (tension[:-1] == 0.0)
    assert 0.8 < slack.mean() * 1.5 < 1.3  # 2 v/g and a little more
    gained = np.diff(run["rope_stretch_dot_m_s"])[slack]
    assert_allclose(gained, c.gravity * 5e-4, rtol=1e-9)
    # taken up at 4 m/s, the damper's power jumps within a row, which the trapezoidal rule halves
    assert np.abs(run.unexplained).max() < 2 * 5e-4 * damping * 4.3**2 / 2 + 0.1
    assert (damping == 0.0) == (run["dissipated_J"][-1] == 0.0)


@pytest.mark.parametrize(
    ("variant", "symbol", "number"),
    [(TWIST, "gamma", "slew_drive_inertia"), (ROPE, "l", "drum_inertia")],
)
def test_a_motor_behind_something_elastic_has_an_inertia_of_its_own(
    variant: CraneVariant, symbol: str, number: str
) -> None:
    def felt(inertia: float) -> float:
        c = variant.crane(**{number: inertia})
        return float(np.diag(pin.crba(c.model, c.data, c.start.q))[c.layout.index(symbol)])

    assert felt(7e4) - felt(2e4) == pytest.approx(5e4, rel=1e-9)


# --- free modes -----------------------------------------------------------------------------------


def test_free_modes_of_the_tower_crane_are_its_compound_pendulums() -> None:
    c = big_crane(payload_mass=2000.0)
    modes = free_modes(c, c.state(l=30.0))
    assert_allclose(modes.frequencies, math.sqrt(c.gravity / 30.0), rtol=1e-13)


@each
def test_free_modes_are_normal_and_keep_their_amplitudes(variant: CraneVariant) -> None:
    """In small motions of all modes at once, each keeps its own; what is not linear goes with the
    square of 1e-5.
    """
    c = variant_crane(variant) if variant is not ROPE else ROPE.crane(**POINT)
    modes = free_modes(c, c.start)
    assert_allclose(modes.weights @ modes.shapes, np.eye(len(modes.passive)), atol=1e-9)
    q = c.start.q.copy()
    q[modes.passive] += 1e-5 * modes.shapes.sum(axis=1) / np.abs(modes.shapes).max()
    clocks = {"duration": 0.5, "dt": 2e-4, "control_period": 5e-2}
    run = simulate(c, zero_command(c), start=State(q, c.start.v), drive="motion", **clocks)
    kept = modes.amplitudes(run.q, run.v)
    ripple = modes.frequencies.max() * 2e-4 / 2.0  # of the step: ω dt/2
    assert_allclose(kept, np.broadcast_to(kept[0], kept.shape), rtol=1.2 * ripple + 2e-4)


def test_a_joint_that_a_spring_holds_is_believed_to_stand_as_still_as_a_drive() -> None:
    for variant, symbol, like in (
        (TWIST, "tower_twist", "gamma"),
        (BEND, "tower_bend_x", "gamma"),
        (JIB, "jib_bend", "gamma"),
        (HOOK, "sling_radial", "phi"),
    ):
        c = variant_crane(variant)
        joint = c.layout.index(symbol)
        drive = c.layout.index(like)
        assert initial_std_of(c)[joint] == initial_std_of(c)[drive]
        if like == "gamma":
            assert disturbance_of(c)[joint] == disturbance_of(c)[drive]


@pytest.mark.parametrize("values", [{"rope_stiffness": 2e7}, {"fall_spacing": 3.0}])
def test_forces_in_steps_are_the_same_forces(values: dict[str, float]) -> None:
    c = load_crane(**values, rope_damping=300.0, tower_twist_stiffness=2e7)
    state = State(c.start.q + 0.01, c.start.v + 0.2)
    dt = 1e-3
    joint = JointForces.of(c)
    in_steps = joint.in_steps(dt).effort(state.q, dt * state.v)
    assert_allclose(in_steps, dt * dt * joint.effort(*state), rtol=1e-14)


# --- the recordings -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Run], Path]:
    """Cranes of two layouts in one recording."""
    runs = []
    for variant in (HOOK, BRIDGE):
        c = variant_crane(variant)
        start = moved(c, **{c.layout.symbols[i]: 0.1 for i in c.swings})
        run = simulate(c, zero_command(c), start=start, duration=0.5, drive="motion")
        runs.append(Run(variant.name, c, run, (0.0, 0.0, 0.0)))
    return runs, record(tmp_path_factory.mktemp("pictures") / "two.rrd", runs, title="t")


def test_cranes_of_several_layouts_stand_in_one_recording_each_with_its_own_columns(
    pictures: tuple[list[Run], Path],
) -> None:
    runs, path = pictures
    times, found = zip(*(numbers(path, run.name.replace(" ", r"\ ")) for run in runs), strict=True)
    for run, columns in zip(runs, found, strict=True):
        symbols = {joint.symbol for joint in run.crane.layout.joints}
        assert symbols <= {name.rpartition("_")[0] for name in columns}
    # a joint may be called radial and keeps its name in degrees
    hooked = runs[0].trajectory
    for name in ("sling_radial", "sling_radial_dot"):
        unit = "_s" if name.endswith("dot") else ""
        degrees = np.degrees(np.interp(1e-9 * times[0], hooked.t, hooked[f"{name}_rad{unit}"]))
        assert_allclose(found[0][f"{name}_deg{unit}"], degrees, rtol=1e-6)  # float32


def test_the_outline_of_the_setpoint_hangs_where_the_slung_load_hangs_at_rest(
    pictures: tuple[list[Run], Path],
) -> None:
    (hooked, _), path = pictures
    name = hooked.name.replace(" ", r"\ ")
    _, place = rows(path, f"{name}/joints/setpoint", "Transform3D:translation")
    # The load's shape in the frame of its link, a sling below the hook.
    body = np.array([0.0, 0.0, -5.0])
    load = payload_position(hooked.crane, hooked.crane.start.q)
    assert_allclose(place[0] + body, load, atol=1e-5)  # float32


@pytest.mark.slow
@each
def test_all_that_can_be_seen_of_a_crane_is_in_its_box(variant: CraneVariant) -> None:
    c = variant_crane(variant)
    run = Run(
        "one", c, simulate(c, zero_command(c), duration=0.005, drive="motion"), (7.0, 0.0, 0.0)
    )
    low, high = extent(run)
    place = payload_position(c, c.start.q) + np.array([7.0, 0.0, 0.0])
    assert (low < place).all() and (place < high).all()
    assert low[2] == pytest.approx(0.0, abs=0.5)
    assert np.linalg.norm(high - low) > 30.0


@pytest.mark.slow
def test_hoisting_a_stretching_rope_steadily_does_not_make_it_bounce() -> None:
    """As the cable shortens the stretch shrinks with it: s = m g l/EA at every length."""
    c = ROPE.crane(**POINT)
    shrinks = -0.2 * at_start(c, "rope_stretch") / at_start(c, "l")
    start = moved(c, l_dot=-0.2, rope_stretch_dot=shrinks)
    reference = ramp(c, hold(c, start), "l", -2.0, rate=0.2, at=0.0)
    drives = follow(c, reference, 5e-3)
    how = {"duration": 2.5, "dt": 2.5e-3, "drive": "motion"}
    run = simulate(c, drives, reference, start=start, **how)
    share = run["rope_stretch_m"] / run["l_m"] * 3e6 / (c.payload_mass * c.gravity)
    assert np.abs(share - 1.0).max() < 5e-4


# --- the experiment -------------------------------------------------------------------------------


@pytest.mark.slow
def test_frequencies_are_measured_by_the_default_engine_also_where_a_rope_stretches() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    claims = modes.study(Setup()).claims
    assert [claim.sentence for claim in claims if not claim.holds] == []
