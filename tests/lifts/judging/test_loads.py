"""What a crane carries: statics, steady slewing, and Pinocchio's own joint forces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cranedyn as cd
from cranedyn import theory
from cranedyn.controllers import Hold, hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import over_all_joints, payload_position, pivot_position
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.judging.loads import (
    Loads,
    corner_forces,
    hanging_mass,
    jib_moment,
    loads,
    loads_of_rows,
)
from cranedyn.lifts.judging.wrench import CraneStates, Wrench
from cranedyn.lifts.planning.site import CRANE_HEADING, Arm, Base
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ROLES
from cranedyn.model.load import load_crane
from cranedyn.references import hold, pulse
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import BRIDGE, CRANE_VARIANTS, HOOK, variant_crane
from tests.helpers import G, crane, efforts, locked, quickly, states

ROUND_OFF = 1e-11
"""Relative: both sides add some hundred products of doubles."""


def pinocchio_wrench(
    of: Crane, state: State, effort: np.ndarray, force: np.ndarray, joint: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force, moment and where, by pin.aba, pin.rnea and the joint forces that it leaves."""
    model = of.model
    data = of.model.createData()
    pin.forwardKinematics(model, data, state.q)
    outside = [pin.Force.Zero() for _ in range(model.njoints)]
    for (_, body, lever), one in zip(of.points, force.reshape(-1, 3), strict=True):
        local = data.oMi[body + 1].rotation.T @ one
        outside[body + 1] += pin.Force(local, np.cross(lever, local))
    tau = over_all_joints(of, effort) + JointForces.of(of).effort(*state)
    a = pin.aba(model, data, *state, tau, outside)
    pin.rnea(model, data, *state, a, outside)
    at = data.oMi[joint + 1]
    held = data.f[joint + 1]
    return -at.rotation @ held.linear, -at.rotation @ held.angular, at.translation


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(states, efforts, st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_what_passes_through_a_joint_is_what_pinocchio_says(
    state: State, effort: np.ndarray, joint: int, seed: int
) -> None:
    force = np.random.default_rng(seed).uniform(-2e3, 2e3, 6)
    of = crane()
    states_of = CraneStates.of(of, state.q[None], state.v[None], effort[None], force[None])
    found = states_of.through(joint)
    expected, moment, point = pinocchio_wrench(of, state, effort, force, joint)
    size = float(np.linalg.norm(expected))
    np.testing.assert_allclose(found.point[0], point, atol=ROUND_OFF, rtol=ROUND_OFF)
    np.testing.assert_allclose(found.force[0], expected, atol=ROUND_OFF * size, rtol=0.0)
    np.testing.assert_allclose(
        found.moment[0], moment, atol=ROUND_OFF * (size + np.linalg.norm(moment)), rtol=0.0
    )


@pytest.mark.slow
@pytest.mark.parametrize("variant", CRANE_VARIANTS, ids=lambda one: one.name)
def test_cranes_of_other_topology_stand_on_what_they_weigh(variant: object) -> None:
    of = variant_crane(variant)  # type: ignore[arg-type]
    run = quickly(of, hold_controller(of), duration=0.05)
    found = loads(of, run)
    weight = sum(inertia.mass for inertia in of.model.inertias) * of.gravity
    first = run.q[0], run.v[0], run.effort[0], np.zeros(3 * len(of.points))
    expected = sum(
        (
            pinocchio_wrench(of, State(*first[:2]), first[2], first[3], i)[0]
            for i, parent in enumerate(of.model.parents[1:])
            if parent == 0
        ),
        np.zeros(3),
    )
    assert found["foot_vertical_N"][0] == pytest.approx(-expected[2], rel=ROUND_OFF)
    assert found["foot_vertical_N"].mean() == pytest.approx(weight, rel=0.05)


def still(of: Crane, duration: float = 0.05, **where: float) -> tuple[Trajectory, Loads]:
    """A load that hangs at rest under drives that do not move."""
    run = simulate(of, locked, start=of.state(**where), duration=duration, drive="motion")
    return run, loads(of, run, base=BASE)


BASE = Base(spacing=4.5, mass=60.0e3)


def test_a_jib_and_a_counter_jib_weigh_where_they_lie() -> None:
    of = crane()
    arms = (Arm(2000.0, 10.0), Arm(3500.0, -6.0))
    for slew in (0.0, 0.7, -2.0):
        run, bare = still(of, gamma=slew, x=12.0)
        found = loads(of, run, base=BASE, arms=arms)
        for name, more in (
            ("foot_vertical_N", 5500.0 * G),
            ("ring_vertical_N", 5500.0 * G),
            ("ring_tilting_Nm", -1000.0 * G),
            ("overturning_Nm", -1000.0 * G),
        ):
            added = found[name] - bare[name]
            np.testing.assert_allclose(added, more, rtol=0.0, atol=ROUND_OFF * 1e6, err_msg=name)
        corners = sum(found[f"corner_{i}_N"] for i in range(1, 5))
        np.testing.assert_allclose(corners, found["foot_vertical_N"], rtol=ROUND_OFF)


def test_at_rest_every_load_is_that_of_statics() -> None:
    of = crane()
    _, found = still(of, gamma=0.4, x=12.0, l=10.0)
    above = of.payload_mass + of.trolley_mass + 2.0 * 50.0  # load, trolley, two links
    ring = above * G * 12.0
    foot = (above + 3000.0 + BASE.mass) * G
    expected = {
        "rope_N": of.payload_mass * G,
        "pull_N": of.payload_mass * G,
        "radius_m": 12.0,
        "load_moment_Nm": of.payload_mass * G * 12.0,
        "ring_vertical_N": (above + 3000.0) * G,
        "ring_tilting_Nm": ring,
        "foot_vertical_N": foot,
        "overturning_Nm": ring,
        "slack_margin": 1.0,
        "snag_margin": 1.0 - of.payload_mass * G / 1e5,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=ROUND_OFF, err_msg=name)
    for name in ("off_lead_rad", "side_lead_rad", "side_force_percent"):
        np.testing.assert_allclose(found[name], 0.0, atol=1e-12, err_msg=name)
    for name in ("ring_lateral_Nm", "ring_torsion_Nm", "torsion_Nm"):
        np.testing.assert_allclose(found[name], 0.0, atol=ROUND_OFF * ring, err_msg=name)


def test_corners_carry_the_whole_and_turn_with_the_jib() -> None:
    of = crane()
    for slew, most in (
        (-0.75 * np.pi, 3),
        (-0.25 * np.pi, 4),
        (0.25 * np.pi, 1),
        (0.75 * np.pi, 2),
    ):
        # The jib points along -Y at zero slew, to (+, -) at an eighth of a turn.
        _, found = still(of, gamma=slew, x=20.0)
        corners = np.array([found[f"corner_{i}_N"][0] for i in range(1, 5)])
        assert corners.sum() == pytest.approx(found["foot_vertical_N"][0], rel=ROUND_OFF)
        pressed = {1: 4, 2: 1, 3: 2, 4: 3}[most]
        assert int(corners.argmax()) + 1 in (most, pressed)
        arm = BASE.spacing / np.sqrt(2.0)
        pair = corners.max() - corners.min()
        assert pair * arm * 2.0 == pytest.approx(2.0 * found["overturning_Nm"][0], rel=ROUND_OFF)


def test_a_crane_that_stands_turned_on_its_base_presses_the_corners_below_its_jib() -> None:
    """A crane turned by an angle presses as one that is not, and has slewed by it."""
    of = crane()
    turned = 0.7
    _, slewed = still(of, gamma=0.4 + turned, x=12.0, l=10.0)
    run, _ = still(of, gamma=0.4, x=12.0, l=10.0)
    found = loads(of, run, base=BASE, heading=CRANE_HEADING + turned)
    for i in range(1, 5):
        corner = f"corner_{i}_N"
        np.testing.assert_allclose(found[corner], slewed[corner], rtol=ROUND_OFF)
    assert found.parameters["heading_rad"] == CRANE_HEADING + turned


def reactions(base: Base, foot: Wrench, gravity: float) -> np.ndarray:
    """Forces of four equal supports: those of a stiff base are the smallest of all that balance
    force and moment, which NumPy's pseudo-inverse finds.
    """
    half = base.spacing / 2.0
    places = np.array([[half, half], [-half, half], [-half, -half], [half, -half]])
    # Each presses down at its place: a moment of (-y F, x F) about the middle.
    balance = np.stack([np.ones(4), -places[:, 1], places[:, 0]])
    weight = -foot.force[:, 2] + base.mass * gravity
    wanted = np.stack([weight, foot.moment[:, 0], foot.moment[:, 1]])
    return (np.linalg.pinv(balance) @ wanted).T


@given(st.integers(0, 2**32 - 1))
def test_corners_balance_force_and_moment_of_any_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force, moment = 1e5 * rng.normal(size=(2, 6, 3))
    foot = Wrench(force, moment, np.zeros((6, 3)))
    base = Base(float(rng.uniform(1.0, 12.0)), float(rng.uniform(0.0, 1e5)))
    expected = reactions(base, foot, G)
    np.testing.assert_allclose(
        corner_forces(base, foot, G), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max()
    )


def test_each_corner_presses_as_by_hand() -> None:
    """The jib at 0.4 rad from -Y towards +X; load, trolley and links, 1600 kg, at 12 m of it.

    They weigh 15 696.00 N at x = 4.67302 m, y = -11.05273 m; all weighs 633 726 N, 158 431.50 N a
    corner. A weight at x, y adds W x/2b = 8 149.75 N to the corners of +X and takes it from the
    others, and W y/2b = -19 275.96 N to those of +Y.
    """
    _, found = still(crane(), gamma=0.4, x=12.0, l=10.0)
    by_hand = [147305.28, 131005.79, 169557.72, 185857.21]
    for i, force in enumerate(by_hand, start=1):
        np.testing.assert_allclose(found[f"corner_{i}_N"], force, rtol=0.0, atol=0.02)


ARMS = (Arm(2000.0, 10.0), Arm(3500.0, -6.0))
"""Jib and counter-jib: 5500 kg, whose moment about the slew axis is that of -1000 kg at 1 m."""


def one_row(of: Crane, state: State, effort: np.ndarray, force: np.ndarray) -> Trajectory:
    """A run of one row, whatever its other columns say."""
    run = simulate(of, locked, duration=0.005, drive="motion").since(0.005)
    return replace(run, q=state.q[None], v=state.v[None], effort=effort[None], force=force[None])


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(states, efforts, st.integers(0, 2**32 - 1))
def test_all_loads_of_a_crane_that_moves_in_the_wind_are_what_pinocchio_says(
    state: State, effort: np.ndarray, seed: int
) -> None:
    of = crane(damp_swing=2e3, damp_hoist=50.0)  # dampers of the swing turn the trolley
    force = np.random.default_rng(seed).uniform(-2e3, 2e3, 6)
    run = one_row(of, state, effort, force)
    found = loads(of, run, base=BASE, arms=ARMS)
    outward = np.array([np.sin(state.q[0]), -np.cos(state.q[0]), 0.0])
    aside = np.array([np.cos(state.q[0]), np.sin(state.q[0]), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    slew, trolley, hoist = (of.layout.index(symbol) for symbol in ("gamma", "x", "l"))
    ring, twist, point = pinocchio_wrench(of, state, effort, force, slew)
    pull, _, _ = pinocchio_wrench(of, state, effort, force, hoist)
    # 5500 kg more, and -1000 kg at 1 m of the jib.
    foot = twist + np.cross(point, ring) + np.cross(outward, 1000.0 * G * up)
    vertical = -ring[2] + 5500.0 * G
    rope = payload_position(of, state.q) - pivot_position(of, state.q)
    expected = {
        "pull_N": -pull[2],
        "side_force_percent": 100.0 * pull @ aside / (of.payload_mass * G),
        "off_lead_rad": np.arctan2(rope @ outward, -rope[2]),
        "side_lead_rad": np.arctan2(rope @ aside, -rope[2]),
        "radius_m": np.hypot(*payload_position(of, state.q)[:2]),
        "pivot_radius_m": state.q[1],
        "load_moment_Nm": -pull[2] * state.q[1],
        "ring_vertical_N": vertical,
        "ring_tilting_Nm": twist @ aside - 1000.0 * G,
        "ring_lateral_Nm": twist @ outward,
        "ring_torsion_Nm": twist[2],
        "foot_vertical_N": vertical + BASE.mass * G,
        "foot_x_Nm": foot[0],
        "foot_y_Nm": foot[1],
        "overturning_Nm": np.sqrt(foot[0] ** 2 + foot[1] ** 2),
        "torsion_Nm": foot[2],
    }
    size = max(np.linalg.norm(ring), np.linalg.norm(twist), np.linalg.norm(foot), vertical)
    for name, value in expected.items():
        scale = size if name.endswith(("_N", "_Nm")) else 1e3
        np.testing.assert_allclose(
            found[name][0], value, rtol=0.0, atol=ROUND_OFF * scale, err_msg=name
        )
    # What passes from the trolley into the jib bends it, and its force by the lever ahead.
    held, bend, _ = pinocchio_wrench(of, state, effort, force, trolley)
    for ahead in (0.0, 1e-3, 0.4 * state.q[1], state.q[1]):
        moment = (bend + np.cross(ahead * outward, held)) @ aside
        at = np.array([state.q[1] - ahead])
        np.testing.assert_allclose(
            jib_moment(of, run, at)[0, 0], moment, rtol=0.0, atol=ROUND_OFF * size
        )


@pytest.mark.parametrize("rope", [{}, {"rope_stiffness": np.inf}], ids=["taut", "may be slack"])
def test_a_load_let_go_at_an_angle_is_carried_by_the_cosine(rope: dict[str, float]) -> None:
    """At rest for an instant the rope of a point load pulls m g cos φ along itself, and so m g
    cos² φ down.
    """
    of = crane(damp_swing=0.0, payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0, **rope)
    angle = 0.5
    state = of.state(x=12.0, l=10.0, phi=angle)
    weight = of.payload_mass * G
    # Fixed drives: none of trolley and slew moves, whatever it takes; the hoist holds.
    run = simulate(of, locked, start=state, duration=0.005, drive="motion")
    found = loads(of, run)
    tension = weight * np.cos(angle)
    expected = {
        "rope_N": tension,
        "pull_N": tension * np.cos(angle),
        "slack_margin": np.cos(angle),
        "snag_margin": 1.0 - tension / 1e5,
        "load_moment_Nm": tension * np.cos(angle) * 12.0,
    }
    for name, value in expected.items():
        assert found[name][0] == pytest.approx(value, rel=1e-9), name
    assert abs(found["off_lead_rad"][0]) == pytest.approx(angle, rel=1e-9)


@pytest.mark.slow
def test_a_tower_that_stands_elsewhere_has_the_same_radius_and_ring(tmp_path: Path) -> None:
    text = crane().urdf
    assert text.count('<origin xyz="0 0 25.99"/>') == 1
    file = tmp_path / "aside.urdf"
    file.write_text(text.replace('"0 0 25.99"', '"30 -20 25.99"'), encoding="utf-8")
    names = {role: part.joint for role, part in ROLES.items()}
    aside = load_crane(file, joints=names, gravity=G)
    near, far = (
        loads_of_rows(of, *(one[None] for one in of.state(gamma=0.4, x=12.0)), np.zeros((1, 3)))
        for of in (crane(), aside)
    )
    for name in ("radius_m", "load_moment_Nm", "ring_vertical_N", "ring_tilting_Nm"):
        np.testing.assert_allclose(far[name], near[name], rtol=ROUND_OFF, err_msg=name)
    # About the origin of the world its weight has a lever of (30, -20): (-y W, x W) down.
    moved = far["foot_x_Nm"] - near["foot_x_Nm"], far["foot_y_Nm"] - near["foot_y_Nm"]
    vertical = near["foot_vertical_N"]
    np.testing.assert_allclose(moved, (20.0 * vertical, 30.0 * vertical), rtol=1e-9)


def test_loads_of_a_run_count_the_buffers_that_it_was_made_with() -> None:
    of = crane()
    q, v = of.state(x=12.0)
    hoist = of.layout.index("l")
    q[hoist] = of.upper[hoist] + 0.02
    q[of.layout.index("x")] = of.upper[of.layout.index("x")] + 0.02
    run = one_row(of, State(q, v), np.zeros(3), np.zeros(6))
    free, met = (
        replace(run, parameters={**run.parameters, "validity": validity})
        for validity in ("mark", "buffers")
    )
    at = np.array([5.0])
    for one, buffers in ((free, False), (met, True)):
        expected = loads_of_rows(of, one.q, one.v, one.effort, one.force, buffers=buffers)
        np.testing.assert_array_equal(loads(of, one)["rope_N"], expected["rope_N"])
    # The buffer of the hoist holds the load of a drive that gives way, by its spring.
    assert loads(of, met)["rope_N"][0] > 1e3 > loads(of, free)["rope_N"][0]
    assert jib_moment(of, met, at)[0, 0] > jib_moment(of, free, at)[0, 0] + 1e3


@pytest.mark.parametrize("name", ["q", "v", "effort", "force"])
def test_rows_of_another_width_or_of_no_numbers_are_refused_by_name(name: str) -> None:
    of = crane()
    q, v = of.state(x=12.0)
    rows = {"q": q[None], "v": v[None], "effort": np.zeros((1, 3)), "force": np.zeros((1, 6))}
    with pytest.raises(OutOfRange, match=f"^{name} is nan"):
        loads_of_rows(of, **{**rows, name: rows[name] * np.nan})
    for wrong in (np.repeat(rows[name], 2, axis=1), rows[name][:, 1:]):
        with pytest.raises(CraneError, match=f"^{name} "):
            loads_of_rows(of, **{**rows, name: wrong})


def test_a_run_of_another_crane_is_refused() -> None:
    run = simulate(crane(), locked, duration=0.005, drive="motion")
    with pytest.raises(OutOfRange, match="run is of joints"):
        loads(variant_crane(BRIDGE), run)


def test_a_crane_that_slews_steadily_carries_what_its_closed_form_says() -> None:
    point = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}
    of = crane(trolley_inertia=0.0, **point)
    radius = 15.0
    length = 12.0
    rate = 0.3
    out = theory.slewing_swing(radius, length, rate, G)
    start = of.state(x=radius, l=length, phi=out, gamma_dot=rate)
    run = simulate(of, locked, start=start, duration=0.05, drive="motion")
    found = loads(of, run)
    load = radius - length * np.sin(out)
    centrifugal = rate**2 * (of.payload_mass * load + of.trolley_mass * radius)
    weight = (of.payload_mass + of.trolley_mass) * G
    height = 28.0 - 25.99
    expected = {
        "rope_N": theory.slewing_tension(radius, length, rate, G, of.payload_mass),
        "off_lead_rad": -out,
        "load_moment_Nm": of.payload_mass * G * radius,
        "ring_tilting_Nm": weight * radius + centrifugal * height,
        "overturning_Nm": weight * radius + centrifugal * 28.0,
    }
    for name, value in expected.items():
        # The step moves the load off its circle by about dt of its rate within the run.
        np.testing.assert_allclose(found[name][0], value, rtol=1e-9, err_msg=name)
    assert abs(found["side_force_percent"][0]) < 1e-9
    assert abs(found["torsion_Nm"][0]) < 1e-9 * weight * radius


def test_a_rope_that_leads_aside_pulls_by_its_tangent_and_twists_the_tower() -> None:
    of = crane(damp_swing=0.0, payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0)
    run, found = still(of, x=12.0, l=10.0, theta=0.02)
    pull = found["pull_N"] * np.tan(found["side_lead_rad"])
    weight = hanging_mass(of) * G
    np.testing.assert_allclose(found["side_force_percent"], 100.0 * pull / weight, rtol=1e-9)
    np.testing.assert_allclose(np.abs(found["side_lead_rad"]), np.abs(run["theta_rad"]), rtol=1e-9)
    np.testing.assert_allclose(np.abs(found["torsion_Nm"]), np.abs(pull) * 12.0, rtol=1e-6)


def test_torsion_of_the_foot_is_what_the_slew_drive_exerts() -> None:
    of = crane()
    reference = pulse(of, hold(of), "gamma", 0.1, at=0.0, width=0.3)
    run = simulate(of, hold_controller(of), reference, duration=1.0)
    found = loads(of, run)
    size = np.abs(run.effort[:, 0]).max()
    assert size > 1e3
    np.testing.assert_allclose(found["torsion_Nm"], -run.effort[:, 0], atol=ROUND_OFF * size)


def test_slack_is_at_zero_tension_and_snag_at_the_hoists_strength() -> None:
    of = crane()
    fall = simulate(
        of, lambda *_: np.array([0.0, 0.0, G]), duration=0.02, drive="motion", validity="mark"
    )
    np.testing.assert_allclose(loads(of, fall)["slack_margin"], 0.0, atol=1e-9)
    full_pull = of.effort_limit[2] / of.payload_mass - G
    snag = simulate(of, lambda *_: np.array([0.0, 0.0, -full_pull]), duration=0.02, drive="motion")
    np.testing.assert_allclose(loads(of, snag)["snag_margin"], 0.0, atol=1e-9)


@pytest.mark.parametrize(("end", "effort"), [("longest", 0.0), ("shortest", -2e4)])
def test_a_rope_pulls_what_hangs_on_it_where_a_buffer_takes_of_it_or_adds_to_it(
    end: str, effort: float
) -> None:
    """Of a plumb load at rest the rope is what moves it, whatever the drive does besides."""
    of = crane()
    hoist = of.layout.index("l")
    q, v = of.state(x=12.0)
    q[hoist] = of.upper[hoist] + 0.02 if end == "longest" else of.lower[hoist] - 0.02
    efforts = np.array([[0.0, 0.0, effort]])
    met, free = (
        loads_of_rows(of, q[None], v[None], efforts, buffers=buffers) for buffers in (True, False)
    )
    np.testing.assert_allclose(met["rope_N"], met["pull_N"], rtol=ROUND_OFF)
    np.testing.assert_allclose(free["rope_N"], -effort, rtol=ROUND_OFF)
    pushed = met["rope_N"] - free["rope_N"]
    assert (pushed > 1e3).all() if end == "longest" else (pushed < -1e3).all()


def test_the_jib_bends_by_the_load_ahead_of_each_place_and_not_behind_the_trolley() -> None:
    of = crane()
    run, _ = still(of, x=12.0)
    at = np.array([0.0, 5.0, 12.0, 15.0])
    above = (of.payload_mass + of.trolley_mass + 100.0) * G
    expected = above * np.maximum(12.0 - at, 0.0)
    found = jib_moment(of, run, at)
    np.testing.assert_allclose(found, np.tile(expected, (len(run), 1)), atol=1e-9 * above)


def test_a_batch_carries_what_its_runs_carry_alone() -> None:
    of = crane()
    one, found = still(of, x=12.0, theta=0.1)
    other, again = still(of, x=15.0, phi=0.1)
    pairs = (one.q, other.q), (one.v, other.v), (one.effort, other.effort)
    both = loads_of_rows(of, *map(np.stack, pairs), base=BASE)
    for name, values in both.items():
        np.testing.assert_array_equal(values[0], found[name])
        np.testing.assert_array_equal(values[1], again[name])


def test_a_hook_hangs_on_the_rope_with_its_load_and_an_overhead_crane_has_no_ring() -> None:
    hook = variant_crane(HOOK)
    bridge = variant_crane(BRIDGE)
    for of in (hook, bridge):
        run = simulate(of, Hold(of, *np.zeros((3, of.layout.m))), duration=0.05, drive="motion")
        found = loads(of, run)
        weight = hanging_mass(of) * of.gravity
        np.testing.assert_allclose(found["pull_N"], weight, rtol=1e-9)
        np.testing.assert_allclose(found["slack_margin"], 1.0, rtol=1e-9)
        assert ("ring_tilting_Nm" in found) == (of is hook)
    assert hanging_mass(hook) == 2300.0


@pytest.mark.slow
def test_loads_are_a_table_like_a_run(tmp_path: Path) -> None:
    of = load_crane()
    _, found = still(of)
    assert found.keys()[0] == "t_s" and len(list(found)) == len(found)
    kept = pyarrow.parquet.read_table(found.write(tmp_path / "loads.parquet"))
    assert kept.column_names == found.keys()
    assert kept["overturning_Nm"].to_numpy().tolist() == found["overturning_Nm"].tolist()
    assert len(cd.plot(found).axes) == 4 and "overturning_Nm" in repr(found)
