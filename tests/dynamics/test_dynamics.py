"""The physics of the crane, against a Lagrangian by hand and the closed forms of pendulum
mechanics.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from tests.helpers import G, accelerations, big_crane, crane, efforts, flow, pendulum_period, states
from tests.lagrangian import Lagrangian

PAPER = Lagrangian(G)
UP = np.array([0.0, 0.0, G])
DAMPED = crane(damp_slew=3e4, damp_trolley=200, damp_swing=5e3, damp_hoist=700)
DAMPING = np.array([3e4, 200, 5e3, 5e3, 700])
DRIVES = crane().layout.drives
PASSIVE = crane().layout.passive


# --- the equations of motion ----------------------------------------------------------------------


@given(states, accelerations)
def test_prescribed_motion_moves_the_drives_as_asked_and_asks_nothing_of_the_swing_joints(
    state: State, setpoint: np.ndarray
) -> None:
    a, effort = dynamics.prescribed_acceleration(crane(damp_swing=0), state, setpoint)
    assert a[DRIVES].tolist() == setpoint.tolist()
    # rounding: the forces of the swing joints are differences of terms of 1e6 N m
    assert_allclose(PAPER.forces(*state, a), dynamics.over_all_joints(crane(), effort), atol=1e-7)


@pytest.mark.parametrize("damping", [np.zeros(5), DAMPING], ids=["none", "at every joint"])
@given(states, efforts)
def test_accelerations_are_those_of_the_lagrangian_by_hand_less_damping(
    damping: np.ndarray, state: State, effort: np.ndarray
) -> None:
    a = dynamics.acceleration(crane(damp_swing=0) if not damping.any() else DAMPED, state, effort)
    expected = dynamics.over_all_joints(crane(), effort) - damping * state.v
    # rounding of sums whose largest terms are the inertia forces of 1e6 kg m²
    rounding = 1e-9 * max(1e5, np.abs(PAPER.mass_matrix(state.q).real * a).max())
    assert_allclose(PAPER.forces(*state, a), expected, atol=rounding)


@given(states, accelerations)
def test_prescribed_motion_and_the_efforts_it_costs_are_one_motion(
    state: State, setpoint: np.ndarray
) -> None:
    a, effort = dynamics.prescribed_acceleration(DAMPED, state, setpoint)
    # rounding, magnified by the light trolley under a load of twice its mass
    assert_allclose(dynamics.acceleration(DAMPED, state, effort), a, atol=1e-10, rtol=1e-10)


@given(states)
def test_the_weight_of_structure_trolley_and_links_does_not_enter(state: State) -> None:
    light = crane(upper_mass=1.0, trolley_mass=1.0, dummy_mass=0.0, damp_swing=0)
    only_hook = Lagrangian(
        G, trolley=0.0, trolley_inertia=0.0, link=0.0, link_inertia=0.0, slewing_inertia=0.0
    )
    rest = np.zeros(5)
    expected = only_hook.forces(state.q, rest, rest)[DRIVES]
    # rounding of 1e5 N m
    assert_allclose(dynamics.holding_effort(crane(), state.q), expected, atol=1e-9)
    assert_allclose(dynamics.holding_effort(light, state.q), expected, atol=1e-9)


@given(states, efforts)
def test_linearisation_is_the_derivative_of_the_acceleration(
    state: State, effort: np.ndarray
) -> None:
    c = DAMPED
    by_state, by_effort = dynamics.linearise(c, state, effort)
    z = np.concatenate(state)
    h = 1e-5

    def a(z: np.ndarray) -> np.ndarray:
        return dynamics.acceleration(c, State(z[:5], z[5:]), effort)

    differences = np.array([(a(z + h * e) - a(z - h * e)) / (2 * h) for e in np.eye(10)]).T
    pushes = np.array(
        [
            dynamics.acceleration(c, state, e) - dynamics.acceleration(c, state, 0 * e)
            for e in np.eye(3)
        ]
    ).T
    # central differences: rounding 1e-16/1e-5 of accelerations up to 1e2, truncation of order h²
    assert_allclose(by_state, differences, atol=1e-6 * (1 + np.abs(differences).max()))
    assert_allclose(by_effort, pushes, atol=1e-12)  # linear, so rounding only


@given(states, efforts)
def test_energy_changes_by_the_power_of_the_drives_less_dissipation(
    state: State, effort: np.ndarray
) -> None:
    c = DAMPED
    a = dynamics.acceleration(c, state, effort)
    h = 1e-5
    after, before = (
        dynamics.energy(c, State(state.q + s * state.v + s**2 / 2 * a, state.v + s * a))
        for s in (h, -h)
    )
    power = float(effort @ state.v[DRIVES] - c.damping @ state.v**2)
    # rounding 1e-16 of 1e6 J over 2h is 1e-5 W; truncation h²/6 of the third derivative, below 1e7
    # W/s²
    assert (after - before) / (2 * h) == pytest.approx(power, abs=1e-2)


# --- geometry and signs ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("q", "position"),
    [
        ((0, 10, 0, 0, 15), (0, -10, 13)),
        ((math.pi / 2, 10, 0, 0, 15), (10, 0, 13)),
        ((0, 10, math.pi / 6, 0, 8), (0, -6, 28 - 8 * math.cos(math.pi / 6))),
        ((0, 10, 0, math.pi / 6, 8), (-4, -10, 28 - 8 * math.cos(math.pi / 6))),
        ((-math.pi / 2, 10, 0, math.pi / 6, 8), (-10, 4, 28 - 8 * math.cos(math.pi / 6))),
    ],
    ids=[
        "jib along -Y",
        "slewed left",
        "phi inward",
        "theta behind",
        "theta behind a jib that points to -X",
    ],
)
def test_the_payload_hangs_where_the_angles_say(
    q: tuple[float, ...], position: tuple[float, ...]
) -> None:
    # rounding.
    assert_allclose(
        dynamics.payload_position(crane(), np.array(q, dtype=float)), position, atol=1e-12
    )


@given(states)
def test_payload_and_pivot_stand_a_cable_length_apart(state: State) -> None:
    payload = dynamics.payload_position(crane(), state.q)
    pivot = dynamics.pivot_position(crane(), state.q)
    gamma, x, *_, length = state.q
    assert_allclose(payload, PAPER.payload(state.q), atol=1e-12)  # rounding
    # rounding.
    assert_allclose(pivot, [x * math.sin(gamma), -x * math.cos(gamma), 28.0], atol=1e-12)
    assert np.linalg.norm(payload - pivot) == pytest.approx(length, rel=1e-12)  # rounding


def test_positions_are_copies() -> None:
    c = crane()
    first = dynamics.payload_position(c, c.start.q), dynamics.pivot_position(c, c.start.q)
    kept = [p.copy() for p in first]
    dynamics.payload_position(c, c.start.q + 1.0)
    assert_allclose(first, kept)


@pytest.mark.parametrize("push", [0.3, -0.3])
def test_phi_is_positive_when_the_load_lags_the_trolley(push: float) -> None:
    lag = math.atan(push / G)
    a, _ = dynamics.prescribed_acceleration(
        crane(), crane().state(phi=lag), np.array([0.0, push, 0.0])
    )
    # Rounding: the lag atan(ẍ/g) is where the load keeps up.
    assert_allclose(a[PASSIVE], 0.0, atol=1e-13)


@pytest.mark.parametrize("push", [0.02, -0.02])
def test_theta_is_positive_when_the_load_lags_the_jib(push: float) -> None:
    c = big_crane()
    lag = math.atan(20.0 * push / G)
    a, _ = dynamics.prescribed_acceleration(
        c, c.state(x=20.0, theta=lag), np.array([push, 0.0, 0.0])
    )
    # Rounding: the lag atan(x γ̈/g) of a point load is where it keeps up.
    assert a[3] == pytest.approx(0.0, abs=1e-13)


# --- the rope -------------------------------------------------------------------------------------


def _rope_tension(crane: Crane, state: State, effort: np.ndarray) -> float:
    return rope_tension(crane.layout, JointForces.of(crane), *state, effort[2])


@given(states, accelerations)
def test_rope_tension_is_what_accelerates_the_load_along_the_rope(
    state: State, setpoint: np.ndarray
) -> None:
    c = DAMPED
    a, effort = dynamics.prescribed_acceleration(c, state, setpoint)
    rope = dynamics.pivot_position(c, state.q) - dynamics.payload_position(c, state.q)
    pull = 1000.0 * (PAPER.payload_acceleration(*state, a) + UP)
    # central differences of order 1e-8 of 1e2 m/s², times 1000 kg
    assert _rope_tension(c, state, effort) == pytest.approx(
        float(pull @ rope) / state.q[4], abs=1e-2
    )


@given(states, accelerations)
def test_without_inertia_and_damping_the_rope_points_along_the_pull(
    state: State, setpoint: np.ndarray
) -> None:
    c = big_crane()
    a, _ = dynamics.prescribed_acceleration(c, state, setpoint)
    rope = (dynamics.pivot_position(c, state.q) - dynamics.payload_position(c, state.q)) / state.q[
        4
    ]
    pull = PAPER.payload_acceleration(*state, a) + UP
    # flatness of a point load: pivot - payload ∥ p̈ + g e_z; central differences of order 1e-8 of
    # 1e2 m/s²
    assert_allclose(np.cross(rope, pull), 0.0, atol=1e-5)


def test_a_falling_load_leaves_the_rope_slack() -> None:
    c = crane()
    _, effort = dynamics.prescribed_acceleration(c, c.start, np.array([0.0, 0.0, G]))
    # Rounding of 1e4 N.
    assert _rope_tension(c, c.start, effort) == pytest.approx(0.0, abs=1e-9)
    _, effort = dynamics.prescribed_acceleration(c, c.start, np.array([0.0, 0.0, G + 1.0]))
    assert _rope_tension(c, c.start, effort) == pytest.approx(-1000.0, abs=1e-9)


# --- a pendulum, integrated by a Runge-Kutta of high order; experiment validate has further forms -


def _period(c: Crane, start: State, guess: float) -> float:
    times = np.linspace(0.0, 0.6 * guess, 2001)
    q, v = flow(c, start, times)
    i = int(np.flatnonzero(q[:, 2] < 0.0)[0])
    # released at rest, the load passes the vertical after a quarter period; Newton from the sample,
    # twice as exact as the integration
    return 4.0 * float(times[i] - q[i, 2] / v[i, 2])


@pytest.mark.parametrize(
    ("degrees", "seconds"),
    [(30.0, 9.127584269), (60.0, 9.627948204), (85.0, None), (90.0, 10.58931111)],
)
def test_a_large_swing_has_the_period_of_the_elliptic_integral(
    degrees: float, seconds: float | None
) -> None:
    c = big_crane()
    amplitude = math.radians(degrees)
    expected = pendulum_period(20.0, G, amplitude)
    # The digits of the table.
    assert seconds is None or expected == pytest.approx(seconds, rel=1e-9)
    # the integration's 1e-10 over 1e3 steps, and Newton's second order from samples 3 ms apart
    start = State(np.array([0.0, 10.0, amplitude, 0.0, 20.0]), np.zeros(5))
    assert _period(c, start, expected) == pytest.approx(expected, rel=1e-7)


def test_rotational_inertia_lengthens_the_pendulum_at_any_amplitude() -> None:
    c = crane(damp_swing=0)
    longer = (1000.0 * 12.0**2 + 400.0 + 100.0) / (1000.0 * 12.0)
    expected = pendulum_period(longer, G, 1.0)
    # As above.
    assert _period(c, c.state(l=12.0, phi=1.0), expected) == pytest.approx(expected, rel=1e-7)
