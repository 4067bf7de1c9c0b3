"""Tracking control: splines, flat paths, LQR, the paper's planes, shapers, the operator; each
against something independent.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers import follow
from cranedyn.controllers.lqr import effort_weight_of, lqr, riccati, state_weight_of
from cranedyn.controllers.paper import (
    SLEW_WEIGHTS,
    TROLLEY_WEIGHTS,
    paper_controller,
    slew_plane,
    trolley_plane,
)
from cranedyn.dynamics.equations_of_motion import (
    acceleration,
    holding_effort,
    linearise,
    payload_position,
    prescribed_acceleration,
)
from cranedyn.dynamics.linearisation import sampled
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.references import hold, ramp
from cranedyn.references.flat import flat, smoothstep
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.motion import hanging_reference
from cranedyn.references.shaped import ei, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.simple import shortest, spline
from cranedyn.references.tabulated import tabulated
from tests.helpers import G, big_crane, crane, quickly


def swing_left(run: np.ndarray) -> float:
    return float(np.ptp(run) / 2.0)


# --- splines --------------------------------------------------------------------------------------


def test_a_spline_is_at_rest_at_every_waypoint_and_passes_through_it() -> None:
    start = crane().state(x=10.0, l=15.0)
    reference = spline(crane(), start, [(0.3, 12.0, 14.0), (0.6, 20.0, 10.0)], [5.0, 8.0], at=1.0)
    for t, point in (
        (1.0, start.q[crane().layout.drives]),
        (6.0, (0.3, 12.0, 14.0)),
        (14.0, (0.6, 20.0, 10.0)),
        (99.0, (0.6, 20.0, 10.0)),
    ):
        setpoint = reference(t)
        # 1e-12: rounding of polynomials of order one
        np.testing.assert_allclose(setpoint.position, point, atol=1e-12)
        np.testing.assert_allclose([setpoint.velocity, setpoint.acceleration], 0.0, atol=1e-12)


def test_the_shortest_spline_reaches_a_limit_and_exceeds_none() -> None:
    start = crane().state(x=10.0, l=15.0)
    rates = (0.08, 0.8, 0.8)
    accelerations = (0.02, 0.3, 0.4)
    for goal in ((0.6, 12.0, 15.0), (0.0, 20.0, 14.0), (0.01, 10.2, 5.0)):
        (duration,) = shortest(crane(), start, [goal], rates=rates, accelerations=accelerations)
        setpoint = spline(crane(), start, [goal], [duration]).at(np.linspace(0.0, duration, 4001))
        use = max(
            (np.abs(setpoint.velocity).max(axis=0) / rates).max(),
            (np.abs(setpoint.acceleration).max(axis=0) / accelerations).max(),
        )
        assert use == pytest.approx(1.0, abs=1e-6)  # 4001 samples meet the peak within 1e-7


# --- flat paths -----------------------------------------------------------------------------------


def test_the_smoothstep_has_four_derivatives_zero_at_both_ends() -> None:
    # Near an end it grows as 126 s⁵ to first order.
    s = 1e-3
    assert smoothstep(np.array([s]))[0] == pytest.approx(126.0 * s**5, rel=5e-3)
    assert 1.0 - smoothstep(np.array([1.0 - s]))[0] == pytest.approx(126.0 * s**5, rel=5e-3)


def test_a_flat_motion_of_a_point_load_obeys_the_equations_of_motion() -> None:
    point = crane(payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0, damp_swing=0.0)
    motion = flat(point, point.state(x=10.0, l=15.0), point.state(gamma=0.6, x=20.0, l=10.0), 20.0)
    tracking = lqr(point, motion)
    for k in range(200, 3800, 300):
        a = acceleration(point, State(motion.q[k], motion.v[k]), tracking.feed_forward[k])
        # two second derivatives of samples 5 ms apart: 1e-15 · 20 m / (5 ms)² = 1e-9 m/s², a pivot
        # of that over g times l, again / (5 ms)²
        np.testing.assert_allclose(a, motion.a[k], rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("values", "left"),
    [({}, 6e-6), ({"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0}, 1e-6)],
)
def test_a_flat_slew_leaves_the_swing_that_the_documents_tell_of(
    values: dict[str, float], left: float
) -> None:
    load = crane(damp_swing=0.0, **values)
    motion = flat(load, load.state(x=15.0, l=15.0), load.state(gamma=0.6, x=15.0, l=15.0), 20.0)
    run = quickly(
        load,
        follow(load, motion, 5e-3),
        motion,
        start=load.state(x=15.0, l=15.0),
        duration=25.0,
        drive="motion",
    )
    amplitude = swing_amplitude(run.q[-1:, 2:4], run.v[-1:, 2:4], run.q[-1:, 4], G)[0]
    # Half of the last digit told: "0.006 mrad", "0.001 mrad".
    assert amplitude == pytest.approx(left, abs=5e-7)
    assert np.linalg.norm(run.q[:, 2:4], axis=1).max() == pytest.approx(22e-3, abs=5e-4)


def test_a_flat_motion_of_a_load_with_inertia_is_exact_along_the_jib_on_a_constant_cable() -> None:
    still = crane(damp_swing=0.0)
    motion = flat(still, still.state(x=10.0, l=10.0), still.state(x=20.0, l=10.0), 12.0)
    for k in range(100, 2400, 37):
        a, _ = prescribed_acceleration(
            still, State(motion.q[k], motion.v[k]), motion.a[k, still.layout.drives]
        )
        # second derivatives of samples, as above, on a shorter cable; taken for a point the load
        # would be off by I/(m l²) = 5e-3 of 0.03
        np.testing.assert_allclose(a, motion.a[k], rtol=0, atol=2e-5)


def test_a_flat_motion_starts_and_ends_with_the_load_at_rest_where_asked() -> None:
    first = crane().state(x=10.0, l=15.0)
    last = crane().state(gamma=0.6, x=20.0, l=10.0)
    motion = flat(crane(), first, last, 20.0)
    for q, v, end in ((motion.q[0], motion.v[0], first), (motion.q[-1], motion.v[-1], last)):
        np.testing.assert_allclose(
            payload_position(crane(), q), payload_position(crane(), end.q), atol=1e-7
        )
        np.testing.assert_allclose(v, 0.0, atol=1e-12)
        np.testing.assert_allclose(q[2:4], 0.0, atol=1e-7)


# --- LQR ------------------------------------------------------------------------------------------


def test_the_finite_horizon_tends_to_the_algebraic_riccati_equation() -> None:
    model = sampled(crane(), crane().state(l=10.0))
    n = 6000
    q = state_weight_of(crane())
    r = effort_weight_of(crane())
    gains = riccati(
        np.repeat(model.a[None], n, 0), np.repeat(model.b[None], n, 0), q, r, np.zeros((10, 10))
    ).gain
    p = solve_discrete_are(model.a, model.b, q, r)
    steady = np.linalg.solve(r + model.b.T @ p @ model.b, model.b.T @ p @ model.a)
    # 30 s are many time constants of the loop; the algebraic solution is good to about 1e-8 of its
    # largest entry
    np.testing.assert_allclose(gains[0], steady, rtol=1e-5, atol=1e-8 * np.abs(steady).max())


def test_no_other_feedback_costs_less_than_the_riccati_sweep() -> None:
    rng = np.random.default_rng(7)
    n = 12
    nz = 4
    nu = 2
    a = rng.normal(size=(n, nz, nz)) / 2
    b = rng.normal(size=(n, nz, nu))
    q = np.eye(nz)
    r = 0.3 * np.eye(nu)
    final = 2.0 * np.eye(nz)
    gains, costs = riccati(a, b, q, r, final)
    start = rng.normal(size=nz)

    def cost(inputs: np.ndarray) -> float:
        z = start
        total = 0.0
        for k in range(n):
            total += z @ q @ z + inputs[k] @ r @ inputs[k]
            z = a[k] @ z + b[k] @ inputs[k]
        return total + z @ final @ z

    z = start
    best = np.empty((n, nu))
    for k in range(n):
        best[k] = -gains[k] @ z
        z = a[k] @ z + b[k] @ best[k]
    assert cost(best) == pytest.approx(start @ costs[0] @ start, rel=1e-12)  # rounding
    for _ in range(50):
        # a minimum of a quadratic: the change is second order and positive
        assert cost(best + 1e-3 * rng.normal(size=best.shape)) > cost(best)


@pytest.mark.slow
def test_a_tracked_flat_motion_arrives_without_swing_and_half_the_payload_keeps_it_small() -> None:
    first = crane().state(x=10.0, l=15.0)
    last = crane().state(gamma=0.6, x=20.0, l=10.0)
    motion = flat(crane(), first, last, 20.0)
    controller = lqr(crane(), motion)
    run = quickly(crane(), controller, motion, start=first, duration=30.0)
    assert np.abs(run.since(20.0).q[:, 2:4]).max() < 5e-5
    other = crane(payload_mass=500.0)
    run = quickly(other, controller, motion, start=other.state(x=10.0, l=15.0), duration=40.0)
    assert np.abs(run.since(39.0).q[:, 2:4]).max() < 1e-3


# --- the paper ------------------------------------------------------------------------------------


def test_the_papers_planes_are_the_linear_crane_where_inertia_is_left_out() -> None:
    bare = crane(
        payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0, damp_swing=0.0, trolley_inertia=0.0
    )
    state = bare.state(x=12.0, l=9.0)
    by_state, by_effort = linearise(bare, state, holding_effort(bare, state.q))
    inertia = bare.slewing_inertia + bare.trolley_mass * 12.0**2
    planes = (
        (trolley_plane(bare.payload_mass, bare.trolley_mass, 9.0, G), [1, 6, 2, 7], 1, (1, 2)),
        (slew_plane(bare.payload_mass, inertia, 12.0, 9.0, G), [0, 5, 3, 8], 0, (0, 3)),
    )
    for (a, b), columns, drive, rows in planes:
        # 1e-9: rounding of the mass matrix's inverse
        np.testing.assert_allclose(a[[1, 3]], by_state[np.ix_(rows, columns)], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(b[[1, 3], 0], by_effort[list(rows), drive], rtol=1e-9)


def test_the_papers_gains_end_as_the_stationary_ones_of_the_held_planes() -> None:
    reference = spline(crane(), crane().state(x=10.0, l=15.0), [(0.6, 20.0, 10.0)], [20.0])
    gain = paper_controller(crane(), hanging_reference(crane(), reference, 20.0)).tracking.gain[-1]
    inertia = crane().slewing_inertia + crane().trolley_mass * 20.0**2
    g = crane().gravity
    for (a, b), weights, row, columns in (
        (trolley_plane(1000.0, 500.0, 10.0, g), TROLLEY_WEIGHTS, 1, [1, 6, 2, 7]),
        (slew_plane(1000.0, inertia, 20.0, 10.0, g), SLEW_WEIGHTS, 0, [0, 5, 3, 8]),
    ):
        held = expm(0.005 * np.block([[a, b], [np.zeros((1, 5))]]))
        p = solve_discrete_are(held[:4, :4], held[:4, 4:], *weights)
        steady = np.linalg.solve(
            weights[1] + held[:4, 4:].T @ p @ held[:4, 4:], held[:4, 4:].T @ p @ held[:4, :4]
        )
        # the last linearisation is up to ten control instants before the end, where the reference
        # is 1e-9 m from it
        np.testing.assert_allclose(gain[row, columns], steady[0], rtol=1e-6)


@pytest.mark.slow
def test_the_hoist_pid_takes_away_a_wrong_weight_and_does_not_wind_up() -> None:
    heavy = crane(payload_mass=1100.0)
    start = heavy.state(l=15.0)
    reference = spline(heavy, start, [(0.0, 10.0, 15.0)], [1.0])
    controller = paper_controller(crane(), hanging_reference(crane(), reference, 1.0))
    run = quickly(heavy, controller, reference, start=start, duration=40.0)
    assert abs(run["l_m"][-1] - 15.0) < 1e-3
    weak = crane(hoist_effort=9000.0)
    stalled = paper_controller(weak, hanging_reference(weak, reference, 1.0))
    quickly(weak, stalled, reference, start=start, duration=0.5)
    assert stalled.integral == 0.0


# --- shapers --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shaper", "formula", "insensitivity"),
    [
        (zv(), lambda r: np.abs(np.cos(np.pi * r / 2)), 0.06369),
        (zvd(), lambda r: np.cos(np.pi * r / 2) ** 2, 0.28713),
        (ei(), lambda r: np.abs((1 - 0.05) / 2 + (1 + 0.05) / 2 * np.cos(np.pi * r)), 0.39945),
    ],
)
def test_shapers_have_the_sensitivity_of_the_literature(
    shaper: object, formula: object, insensitivity: float
) -> None:
    ratio = np.linspace(0.5, 1.5, 100_001)
    residual = shaper.residual(ratio)  # type: ignore[attr-defined]
    np.testing.assert_allclose(residual, formula(ratio), atol=1e-12)  # type: ignore[operator]
    inside = ratio[residual <= 0.05 + 1e-12]
    # Steps of 1e-5 at both ends, five digits published.
    assert inside[-1] - inside[0] == pytest.approx(insensitivity, abs=3e-5)


def test_a_shaped_move_leaves_almost_no_swing_where_the_bare_one_does() -> None:
    point = big_crane()
    start = point.state(x=10.0, l=15.0)
    base = ramp(point, hold(point, start), "x", 0.5, rate=0.25, at=1.0)
    period = 2.0 * math.pi * math.sqrt(15.0 / G)
    left = {}
    for name, reference in (
        ("bare", base),
        ("zv", shaped(base, zv(), period)),
        ("zvd", shaped(base, zvd(), period)),
    ):
        run = quickly(
            point, follow(point, reference), reference, start=start, duration=25.0, drive="motion"
        )
        left[name] = swing_left(run["phi_rad"][run.t > 15.0])
        # Positions lead velocities by half a step.
        assert run["x_m"][-1] == pytest.approx(10.5, abs=2e-3)
    # small angles and 5 ms of sampling leave a thousandth
    assert left["zv"] < 3e-3 * left["bare"]
    assert left["zvd"] < 3e-3 * left["bare"]


def test_a_shaper_for_a_moving_cable_keeps_the_way_and_leaves_less_than_one_for_a_fixed_cable() -> (
    None
):
    point = big_crane()
    start = point.state(x=10.0, l=20.0)
    base = joystick(
        point,
        start,
        [JoystickPulse("l", -0.5, 0.0, 20.0), JoystickPulse("x", 0.5, 3.0, 12.0)],
        accelerations=(0.02, 0.4, 0.4),
    )
    fixed = shaped(base, zv(), 2.0 * math.pi * math.sqrt(20.0 / G))
    moving = shaped_hoisting(point, base, zv(), 25.0)
    left = {}
    for name, reference in (("bare", base), ("fixed", fixed), ("moving", moving)):
        run = quickly(
            point,
            follow(point, reference),
            reference,
            start=start,
            duration=45.0,
            drive="motion",
            validity="mark",
        )  # a hoist stopped at once
        left[name] = swing_left(run["phi_rad"][run.t > 35.0])
        assert run["x_m"][-1] == pytest.approx(16.0, abs=5e-3)
    # slow hoisting: (l̇/ωl) is 0.04 to 0.05 here, its square what is neglected; parts of equal size
    # would leave four times as much
    assert left["moving"] < 0.02 * left["fixed"]
    assert left["moving"] < 0.02 * left["bare"]


# --- the operator ---------------------------------------------------------------------------------


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.floats(-0.8, 0.8), st.floats(0.0, 3.0), st.floats(0.01, 4.0)),
        min_size=1,
        max_size=4,
    )
)
def test_an_operator_who_changes_his_mind_is_never_obeyed_beyond_the_limits(
    moves: list[tuple[float, float, float]],
) -> None:
    pushes = []
    t = 0.0
    for rate, pause, lasts in moves:
        pushes.append(JoystickPulse("x", rate, t + pause, lasts))
        t += pause + lasts
    start = crane().state(x=10.0)
    reference = joystick(crane(), start, pushes[::-1], accelerations=(0.02, 0.4, 0.4))
    setpoint = tabulated(reference, np.linspace(-1.0, t + 3.0, 2000))
    # Rounding, here and below.
    assert np.abs(setpoint.acceleration[:, 1]).max() <= 0.4 * (1 + 1e-12)
    assert np.abs(setpoint.velocity[:, 1]).max() <= max(abs(rate) for rate, *_ in moves) + 1e-12
    assert np.abs(reference(t + 2.1).velocity).max() < 1e-12  # 0.8 m/s are lost in 2 s
    # asked for is the rate while the joystick is held, zero while it is not; the drive goes there
    # at 0.4 m/s², by steps of 1 ms here
    speed = 0.0
    times = np.arange(0.0, t + 2.5, 1e-3)
    held = np.zeros(len(times))
    for push in pushes:
        held[(times >= push.at) & (times < push.at + push.hold)] = push.rate
    found = tabulated(reference, times).velocity[:, 1]
    for asked, there in zip(held, found, strict=True):
        # Each change comes up to a step early or late.
        assert there == pytest.approx(speed, abs=0.4e-3 * 2 * len(pushes))
        speed += float(np.clip(asked - speed, -0.4e-3, 0.4e-3))


def test_a_joystick_is_in_one_place_at_a_time() -> None:
    start = crane().state(x=10.0)

    def pushed(*pulses: tuple[str, float, float, float]) -> None:
        one_by_one = [JoystickPulse(*pulse) for pulse in pulses]
        joystick(crane(), start, one_by_one, accelerations=(0.02, 0.4, 0.4))

    with pytest.raises(
        OutOfRange,
        match=r"start of a pulse of x is 2\.0 s; "
        r"allowed is 4 or later, when the one before it ends",
    ):
        pushed(("x", 0.8, 1.0, 3.0), ("l", 0.5, 1.0, 3.0), ("x", 0.8, 2.0, 3.0))
    pushed(("x", 0.8, 0.1, 0.2), ("x", 0.5, 0.3, 1.0), ("l", 0.5, 0.2, 3.0))  # 0.1 + 0.2 > 0.3
    with pytest.raises(OutOfRange, match="start of a pulse is nan s"):
        pushed(("x", 0.8, math.nan, 3.0))


# --- limits ---------------------------------------------------------------------------------------


def test_the_fastest_flat_motion_uses_one_limit_fully_and_no_other_more() -> None:
    first = crane().state(x=10.0, l=15.0)
    last = crane().state(gamma=0.6, x=20.0, l=10.0)
    limits = Limits((0.08, 0.8, 0.8), (0.05, 0.5, 0.5))
    plan = partial(flat, crane(), first, last, period=0.05)
    duration = fastest(crane(), plan, limits)
    shares = use(crane(), plan(duration), limits)
    # the duration is found to a thousandth of a second of some thirty, and rounded up to rows 50 ms
    # apart
    assert max(shares.values()) == pytest.approx(1.0, abs=5e-3)
    assert max(use(crane(), plan(0.95 * duration), limits).values()) > 1.0
