"""The closed forms, against numerical integration, series and tables: theory must not be tested by
what it is there to test.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from cranedyn import theory
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from tests.helpers import G, accelerations, big_crane, pendulum_period, states
from tests.lagrangian import Lagrangian


def _solve(rates, y: list[float], times: np.ndarray) -> np.ndarray:
    return solve_ivp(rates, (0.0, times[-1]), y, "DOP853", times, rtol=1e-12, atol=1e-14).y


def _crossings(t: np.ndarray, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Zero crossings by Newton from the sample before."""
    i = np.flatnonzero(y[:-1] * y[1:] < 0)
    return t[i] - y[i] / v[i]


def test_the_period_of_a_point_load_is_the_published() -> None:
    # the article's column, three decimals
    assert_allclose(
        theory.point_period(np.array([5.0, 10.0, 15.0, 20.0]), 9.80665),
        [4.487, 6.345, 7.771, 8.973],
        atol=6e-4,
    )


def test_the_period_of_a_rigid_load_is_the_published() -> None:
    found = [
        theory.rigid_period(length, 9.80665, 1000.0, 400.0) for length in (5.0, 10.0, 15.0, 20.0)
    ]
    assert_allclose(found, [4.522, 6.358, 7.778, 8.978], atol=6e-4)  # three decimals
    assert theory.rigid_period(7.0, G, 3.0, 0.0) == pytest.approx(
        theory.point_period(7.0, G), rel=1e-15
    )


@pytest.mark.parametrize("amplitude", [math.pi, -3.2, 4.0, 6.28, math.nan])
def test_a_swing_beyond_180_degrees_has_no_period_and_no_action(amplitude: float) -> None:
    with pytest.raises(OutOfRange, match="amplitude_factor"):
        theory.amplitude_factor(np.array([1.0, amplitude]))
    with pytest.raises(OutOfRange, match="adiabatic_amplitude"):
        theory.adiabatic_amplitude(np.array([10.0]), 10.0, amplitude)


@given(st.floats(1e-3, 3.0))
def test_the_factor_of_finite_amplitude_is_that_of_the_arithmetic_geometric_mean(
    amplitude: float,
) -> None:
    expected = pendulum_period(1.0, 1.0, amplitude) / (2.0 * math.pi)
    assert theory.amplitude_factor(amplitude) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("length", [5.0, 20.0])
@pytest.mark.parametrize(("stiffness", "damping"), [(3e5, 5e4), (3e5, 0.0), (3e4, 1.2e4)])
def test_the_give_of_the_pivot_is_the_eigenvalue_of_trolley_and_load(
    length: float, stiffness: float, damping: float
) -> None:
    m = 1000.0
    trolley = 600.0
    # trolley x, lag φ: M ẍ + k_d ẋ + k_p x = -m g φ, l φ̈ + g φ = ẍ
    mass = np.array([[trolley, 0.0], [-1.0, length]])
    spring = np.array([[stiffness, m * G], [0.0, G]])
    damper = np.diag([damping, 0.0])
    inverse = np.linalg.inv(mass)
    values = np.linalg.eigvals(
        np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ spring, -inverse @ damper]])
    )
    value = min(values[values.imag > 1e-3], key=lambda v: abs(v - 1j * math.sqrt(G / length)))
    gain = 2.0 * math.pi / abs(value) / float(theory.point_period(length, G)) - 1.0
    found = theory.pivot_compliance(length, G, m, stiffness, damping, trolley)
    first = m * G / (2.0 * stiffness * length)
    # first order in the give: the next is three times its square
    assert found[0] == pytest.approx(gain, abs=4.0 * first**2)
    assert found[1] == pytest.approx(-value.real / abs(value), abs=4.0 * first**2)


@pytest.mark.parametrize(
    ("length", "percent"), [(5.0, 0.33), (10.0, 0.16), (15.0, 0.11), (20.0, 0.08)]
)
def test_the_give_of_a_spring_is_the_published(length: float, percent: float) -> None:
    gain, ratio = theory.pivot_compliance(length, 9.80665, 1000.0, 3e5)
    assert 100.0 * gain == pytest.approx(percent, abs=5e-3)  # two decimals
    assert ratio == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "damping"), [(3e4, 2e4), (1e5, 1e3)])
def test_the_give_of_the_hoist_is_that_of_an_elastic_pendulum(
    stiffness: float, damping: float
) -> None:
    m = 1000.0
    length = 10.0
    amplitude = 0.1
    omega = math.sqrt(G / length)
    turns = 8

    def rates(_: float, y: np.ndarray) -> list[float]:
        phi, rate, give, speed = y
        rope = length + give
        return [
            rate,
            -(G * math.sin(phi) + 2 * speed * rate) / rope,
            speed,
            rope * rate**2 + G * (math.cos(phi) - 1) - (stiffness * give + damping * speed) / m,
        ]

    times = np.linspace(0.0, (turns + 12) * 2 * math.pi / omega, 40001)
    phi, rate, *_ = _solve(rates, [amplitude, 0.0, 0.0, 0.0], times)
    crossings = _crossings(times, phi, rate)[20:]  # the hoist's own transient is over
    half = [np.abs(phi[(times > a) & (times <= b)]).max() for a, b in itertools.pairwise(crossings)]
    size = float(np.sqrt(np.mean(np.square(half))))
    period = 2.0 * (crossings[-1] - crossings[0]) / (len(crossings) - 1)
    decay = math.log(half[0] / half[-1]) / (math.pi * (len(half) - 1))
    gain, ratio = theory.hoist_compliance(size, length, G, m, stiffness, damping)
    measured = period / (pendulum_period(length, G, size)) - 1.0
    # to order A² = 0.01 of itself, and the second order of the give, 1e-3 of itself
    assert measured == pytest.approx(gain, rel=0.02)
    assert decay == pytest.approx(ratio, rel=0.02)


@pytest.mark.parametrize(
    ("length", "rate", "expected"), [(10.0, 0.5, -0.0169789144434), (40.0, -0.8, -0.106873470578)]
)
def test_constant_hoisting_has_the_tabulated_values(
    length: float, rate: float, expected: float
) -> None:
    found = theory.constant_hoisting(np.array([40.0]), length, rate, G, 0.05, 0.0)
    assert found == pytest.approx([expected], rel=1e-11)  # digits given


@pytest.mark.parametrize(("length", "rate"), [(10.0, 0.5), (20.0, -0.5)])
def test_constant_hoisting_solves_its_equation_and_its_envelope_encloses_it(
    length: float, rate: float
) -> None:
    times = np.linspace(0.0, 20.0, 4001)
    swing = 0.04
    swing_rate = -0.03
    expected = _solve(
        lambda t, y: [y[1], -(2 * rate * y[1] + G * y[0]) / (length + rate * t)],
        [swing, swing_rate],
        times,
    )[0]
    found = theory.constant_hoisting(times, length, rate, G, swing, swing_rate)
    assert_allclose(found, expected, atol=1e-11)  # the integration's 1e-12
    envelope = theory.constant_hoisting_envelope(times, length, rate, G, swing, swing_rate)
    share = np.abs(found) / envelope
    assert share.max() < 1.0 + 1e-12
    tops = share[1:-1][(share[1:-1] > share[:-2]) & (share[1:-1] > share[2:])]
    assert len(tops) >= 4
    assert_allclose(tops, 1.0, atol=1e-5)  # samples 5 ms apart: (ω dt)²/8


def test_the_bessel_envelope_of_slow_hoisting_is_the_adiabatic_law() -> None:
    times = np.array([0.0, 300.0])
    a = theory.constant_hoisting_envelope(times, 20.0, -0.04, G, 0.05, 0.0)
    assert a[1] / a[0] == pytest.approx((8.0 / 20.0) ** -0.75, rel=1e-4)  # (v/ω l)² = 1e-5


# --- swing with the drives moving -----------------------------------------------------------------


@given(states, accelerations)
def test_small_swing_is_the_limit_of_the_full_equations(
    state: State, excitation: np.ndarray
) -> None:
    c = big_crane()
    size = 1e-4
    q = state.q.copy()
    v = state.v.copy()
    q[2:4] *= size
    v[2:4] *= size
    drives = dict(x=q[1], x_rate=v[1], slew_rate=v[0], length=q[4], length_rate=v[4], gravity=G)
    drives |= dict(slew_acceleration=excitation[0], x_acceleration=excitation[1])
    found = theory.small_swing(q[2:4], v[2:4], **drives)
    full = dynamics.prescribed_acceleration(c, State(q, v), excitation)[0][2:4]
    # what is dropped is of second order in the swing, and φ tan θ times pushes of up to 5 m/s² over
    # 3.4 m
    assert_allclose(found, full, atol=20.0 * size**2)


def test_the_papers_equations_are_small_swing_where_jib_and_cable_rest() -> None:
    still = dict(length_rate=0.0, slew_rate=0.0, length=15.0, gravity=G, x=20.0)
    moving = dict(x_rate=0.3, x_acceleration=0.4, slew_acceleration=0.0)
    radial = theory.small_swing(np.array([0.02, 0.0]), np.array([0.1, 0.0]), **still, **moving)
    found = theory.radial_paper(0.02, length=15.0, gravity=G, excitation=0.4)
    assert found == pytest.approx(radial[0], rel=1e-14)
    moving = dict(x_rate=0.0, x_acceleration=0.0, slew_acceleration=0.01)
    tangential = theory.small_swing(np.array([0.0, 0.03]), np.zeros(2), **still, **moving)
    found = theory.tangential_paper(0.03, length=15.0, gravity=G, excitation=0.2)
    assert found == pytest.approx(tangential[1], rel=1e-14)
    # positive when the load lags: at rest on θ = x γ̈/g
    at_rest = theory.tangential_paper(0.2 / G, length=15.0, gravity=G, excitation=0.2)
    assert at_rest == pytest.approx(0.0, abs=1e-16)


# --- slow hoisting --------------------------------------------------------------------------------


def test_a_small_swing_grows_with_the_three_quarter_power() -> None:
    found = theory.adiabatic_amplitude(np.array([20.0, 12.0, 5.0]), 20.0, 1e-3)
    # The next order is amplitude², 8e-6 at 5 m / 16.
    assert_allclose(found, 1e-3 * np.array([1.0, 0.6, 0.25]) ** -0.75, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [1.0, 1.5])
def test_a_large_swing_keeps_its_action_when_the_cable_runs_slowly(amplitude: float) -> None:
    rate = -0.01
    length = 20.0
    target = 14.0

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -(2 * rate * y[1] + G * math.sin(y[0])) / (length + rate * t)]

    duration = (target - length) / rate
    times = np.linspace(0.0, duration, 120001)
    phi, _ = solve_ivp(
        rates, (0.0, duration), [amplitude, 0.0], "DOP853", times, rtol=1e-9, atol=1e-10
    ).y
    last = np.abs(phi[-2000:]).max()
    at = length + rate * times[-2000 + int(np.abs(phi[-2000:]).argmax())]
    # the hoisting speed over that of the swing, ε = v/(ω l) = 1e-3: amplitudes at the turning
    # points are off by about ε
    assert last == pytest.approx(
        float(theory.adiabatic_amplitude(np.array([at]), length, amplitude)[0]), rel=1e-3
    )
    assert last > amplitude * 1.2
    # The power law of small swings has ended.
    assert abs(last / (amplitude * (at / length) ** -0.75) - 1) > 0.015


# --- spherical pendulum ---------------------------------------------------------------------------


def _turned(length: float, far: float, near: float) -> float:
    """Precession of a point on a sphere, by Cartesian coordinates and the force of the rope; the
    far ends are where it turns inward.
    """

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        place = y[:3]
        speed = y[3:]
        pull = (speed @ speed - G * place[2]) / length**2
        return np.concatenate([speed, -pull * place - [0.0, 0.0, G]])

    def outward(_: float, y: np.ndarray) -> float:
        return y[0] * y[3] + y[1] * y[4]

    outward.direction = -1.0  # type: ignore[attr-defined]
    start = [far, 0.0, -math.sqrt(length**2 - far**2), 0.0, near * math.sqrt(G / length), 0.0]
    period = float(theory.point_period(length, G))
    span = (0.0, 1.3 * period)
    exact = dict(rtol=1e-12, atol=1e-13, max_step=0.2)
    run = solve_ivp(rates, span, start, "DOP853", events=outward, **exact)
    (last,) = (y for t, y in zip(run.t_events[0], run.y_events[0], strict=True) if t > 0.8 * period)
    return math.atan2(last[1], last[0])


@pytest.mark.parametrize(("far", "near"), [(2.0, 1.0), (8.0, 4.0), (12.0, 1.0)])
def test_the_apsidal_integral_is_the_angle_by_which_an_orbit_turns(far: float, near: float) -> None:
    # Integration and its event.
    assert theory.apsidal_precession(20.0, far, near) == pytest.approx(
        _turned(20.0, far, near), abs=1e-9
    )


def test_the_precession_of_a_small_oval_is_airys() -> None:
    assert theory.apsidal_precession(20.0, 2.0, 1.0) == pytest.approx(
        0.01180405123, abs=2e-11
    )  # digits given, a difference of two of size 2π
    for size in (0.1, 0.05):
        gain = (
            theory.apsidal_precession(1.0, size, size / 2.0)
            / theory.airy_precession(1.0, size, size / 2.0)
            - 1.0
        )
        assert 0.0 < gain < 1.25 * size**2  # the next order: (a² + b²)/l² of it at most


# --- steady slewing -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("radius", "length", "rpm", "degrees"),
    [(50.0, 45.0, 0.8, 2.1167287968), (25.0, 19.0, 0.5, 0.4024351067), (20.0, 40.0, 6.0, None)],
)
def test_a_load_that_hangs_out_under_a_turning_jib_is_at_rest_by_the_lagrangian(
    radius: float, length: float, rpm: float, degrees: float | None
) -> None:
    rate = rpm * math.pi / 30.0
    phi = theory.slewing_swing(radius, length, rate, G)
    # Digits given.
    assert degrees is None or -math.degrees(phi) == pytest.approx(degrees, abs=5e-11)
    point = Lagrangian(G, load_inertia=0.0, link=0.0, link_inertia=0.0)
    forces = point.forces(
        np.array([0.0, radius, phi, 0.0, length]), np.array([rate, 0.0, 0.0, 0.0, 0.0]), np.zeros(5)
    )
    # nothing turns the swing joints, rounding of 5e5 N m; the hoist pulls with the tension
    assert_allclose(forces[2:4], 0.0, atol=1e-8)
    assert -forces[4] == pytest.approx(
        theory.slewing_tension(radius, length, rate, G, 1000.0), rel=1e-12
    )


# --- moves of the trolley -------------------------------------------------------------------------


def _left(duration: float, length: float, acceleration) -> float:
    """Swing that a linear pendulum keeps after a move [rad], by integration."""
    omega = math.sqrt(G / length)
    run = solve_ivp(
        lambda t, y: [y[1], (acceleration(t) - G * y[0]) / length],
        (0.0, duration), [0.0, 0.0], "DOP853", rtol=1e-11, atol=1e-13, max_step=0.01,
    )  # fmt: skip
    return math.hypot(run.y[0, -1], run.y[1, -1] / omega)


@pytest.mark.slow
def test_what_pulses_of_acceleration_leave() -> None:
    def pulses(t: float) -> float:
        return 0.3 * ((t < 4.0) - float(t > 10.0))

    pulse = theory.pulse_residual(0.3, 4.0, 20.0, G)
    coast = theory.coast_residual(0.3, 4.0, 6.0, 20.0, G)
    # steps that straddle an edge of a pulse: 0.3 m/s² for 0.01 s over 20 m and 0.7/s, and a tenth
    # of it by the step control
    assert pulse == pytest.approx(_left(10.0, 20.0, pulses), abs=3e-5)
    assert coast == pytest.approx(_left(14.0, 20.0, pulses), abs=3e-5)
    # Digits given.
    assert coast == pytest.approx(0.0424916046338, abs=5e-14)
    whole = float(theory.point_period(20.0, G))
    # A push of one period leaves none.
    assert theory.pulse_residual(0.3, whole, 20.0, G) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("duration", "degrees"), [(10.0, 10.687330), (15.0, 1.395181)])
def test_what_a_quintic_leaves(duration: float, degrees: float) -> None:
    def spline(t: float) -> float:
        s = t / duration
        return 10.0 / duration**2 * (60.0 * s - 180.0 * s**2 + 120.0 * s**3)

    found = theory.quintic_residual(10.0, duration, 20.0, G)
    assert found == pytest.approx(_left(duration, 20.0, spline), rel=1e-9)  # integration
    assert math.degrees(found) == pytest.approx(degrees, abs=5e-7)  # digits given


@pytest.mark.parametrize("ratio", [1.834566, 2.895032, 4.938452])
def test_a_quintic_of_some_durations_leaves_nothing(ratio: float) -> None:
    period = float(theory.point_period(20.0, G))
    at, before, after = (
        theory.quintic_residual(10.0, (ratio + shift) * period, 20.0, G)
        for shift in (0.0, -1e-2, 1e-2)
    )
    assert at < 1e-4 * min(before, after)  # six decimals: 5e-7 over 1e-2


def test_the_period_under_a_rolling_trolley_is_the_eigenvalue_of_both() -> None:
    mass = 1000.0
    trolley = 500.0
    length = 20.0
    # (M + m) ẍ - m l φ̈ = 0 and l φ̈ + g φ = ẍ
    inertia = np.array([[trolley + mass, -mass * length], [-1.0, length]])
    values = np.linalg.eigvals(np.linalg.solve(inertia, np.array([[0.0, 0.0], [0.0, G]])))
    assert theory.rolling_period(length, G, mass, trolley) == pytest.approx(
        2.0 * math.pi / math.sqrt(max(values.real)), rel=1e-12
    )
