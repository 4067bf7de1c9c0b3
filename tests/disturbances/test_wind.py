"""Forces from outside on payload and trolley: deflection, response, drag, and their work."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.disturbances import wind
from cranedyn.dynamics.equations_of_motion import outside_effort, point_positions, point_velocities
from cranedyn.interfaces import State
from cranedyn.simulation.simulate import simulate
from tests.helpers import G, crane, locked, quickly, states

POINT = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}


@given(states)
def test_a_force_does_the_work_of_its_way(state: State) -> None:
    # virtual work: J is the derivative of the places; complex steps are not for Pinocchio, so
    # central differences, O(h²) = 1e-10
    force = np.array([[1.0, -2.0, 3.0], [-4.0, 5.0, 6.0]])
    h = 1e-5
    assert crane().layout.points == ("payload", "trolley")
    found = outside_effort(crane().points, crane().model, crane().data, state.q, force)
    for i, e in enumerate(np.eye(5)):
        paths = (
            point_positions(crane(), state.q + h * e) - point_positions(crane(), state.q - h * e)
        ) / (2 * h)
        assert_allclose(found[i], (force * paths).sum(), atol=1e-6 * 30.0)
    assert_allclose(
        found @ state.v, (force * point_velocities(crane(), state)).sum(), rtol=1e-9, atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "coordinate", "sign"), [((0.0, 1000.0, 0.0), 2, 1.0), ((1000.0, 0.0, 0.0), 3, -1.0)]
)
def test_a_steady_push_is_rest_at_the_closed_form_angle(
    force: tuple[float, ...], coordinate: int, sign: float
) -> None:
    # +Y is inward, so the load hangs as if it lagged an outward move; +X is the way of a slew to
    # the left, so the load leads
    c = crane(**POINT)
    angle = sign * math.atan(1000.0 / (1000.0 * G))
    q = c.state(x=10.0, l=15.0).q.copy()
    q[coordinate] = angle
    run = simulate(
        c,
        locked,
        start=State(q, np.zeros(5)),
        duration=10.0,
        drive="motion",
        disturbance=wind.constant_force(c, payload=force),
    )
    assert_allclose(run.q, np.tile(q, (len(run), 1)), atol=1e-9)  # rest, to rounding


@pytest.mark.slow
def test_a_push_that_comes_at_once_swings_the_load_to_twice_its_rest() -> None:
    c = crane(**POINT)
    run = quickly(
        c,
        locked,
        start=c.state(x=10.0, l=15.0),
        duration=20.0,
        drive="motion",
        disturbance=wind.constant_force(c, payload=(0.0, 1000.0, 0.0)),
    )
    # in the tilted field g_eff the load is a pendulum released at rest atan(F/mg) off its middle,
    # whatever the amplitude Half a step of lead: ω dt/2 of the amplitude.
    assert run["phi_rad"].max() == pytest.approx(2.0 * math.atan(1.0 / G), abs=2e-5)


@pytest.mark.slow
def test_the_work_of_a_push_is_in_the_ledger_and_what_it_leaves_open_halves_with_the_step() -> None:
    c = crane(**POINT)
    constant_force = wind.constant_force(
        c, payload=(300.0, 800.0, -200.0), trolley=(100.0, 500.0, 0.0)
    )
    start = c.state(x=10.0, l=15.0, phi=0.1, theta=-0.05)
    coarse, fine = (
        simulate(
            c,
            hold_controller(c, gravity=G),
            start=start,
            duration=10.0,
            dt=dt,
            control_period=5e-3,
            disturbance=constant_force,
        )
        for dt in (1e-3, 5e-4)
    )
    assert np.ptp(fine["W_force_J"]) > 300.0
    assert np.abs(fine.unexplained).max() < 3e-3 * np.ptp(fine["W_force_J"])
    # Order 1.
    assert np.abs(coarse.unexplained).max() / np.abs(fine.unexplained).max() == pytest.approx(
        2.0, abs=0.1
    )


def test_a_steady_wind_pushes_with_the_square_of_its_speed() -> None:
    c = crane()
    disturbance = wind.wind(
        c, wind.steady(20.0), direction=math.pi / 2, payload_area=5.0, trolley_area=1.0
    )
    rest = disturbance(0.0, c.start)
    assert_allclose(
        rest, [[0.0, 0.5 * 1.25 * 5.0 * 400.0, 0.0], [0.0, 0.5 * 1.25 * 400.0, 0.0]], atol=1e-12
    )


def test_a_load_that_moves_with_the_wind_feels_none() -> None:
    c = crane()
    moving = c.state(x_dot=8.0)  # outward along -Y, pivot and payload alike
    assert_allclose(
        wind.wind(c, wind.steady(8.0), direction=-math.pi / 2, payload_area=5.0)(0.0, moving),
        0.0,
        atol=1e-12,
    )


@pytest.mark.slow
def test_wind_damps_a_swing_in_its_direction() -> None:
    c = crane(**POINT)
    start = c.state(x=10.0, l=15.0, phi=0.1)
    still, windy = (
        quickly(
            c,
            locked,
            start=start,
            duration=60.0,
            control_period=2e-2,
            drive="motion",
            disturbance=wind.wind(c, wind.steady(speed), direction=math.pi / 2, payload_area=5.0),
        )
        for speed in (0.0, 10.0)
    )
    # linear drag ρ A w takes amplitude at a rate ρ A w/(2 m); the swing starts 0.1 rad from plumb,
    # about a rest that the wind holds aside
    aside = 0.5 * 1.225 * 5.0 * 10.0**2 / (1000.0 * G)
    swing = [float(np.ptp(run["phi_rad"][run.t > 50.0])) / 2.0 for run in (still, windy)]
    # the window of 10 s begins and ends within a swing: 52 s ± 2 s of decay
    assert swing[1] / (0.1 - aside) == pytest.approx(
        math.exp(-1.225 * 5.0 * 10.0 / 2000.0 * 52.0), rel=0.06
    )
    assert swing[0] > 0.09


def test_gusts_have_their_shapes() -> None:
    step = wind.step_gust(wind.steady(5.0), 10.0, at=2.0)
    assert [step(t) for t in (1.9, 2.0, 9.0)] == [5.0, 15.0, 15.0]
    bump = wind.cosine_gust(wind.steady(5.0), 10.0, at=2.0, lasts=4.0)
    assert_allclose(
        [bump(t) for t in (1.0, 2.0, 3.0, 4.0, 6.0, 7.0)],
        [5.0, 5.0, 10.0, 15.0, 5.0, 5.0],
        atol=1e-12,
    )


@pytest.mark.slow
def test_turbulence_has_its_intensity_and_its_time_scale_and_repeats_with_its_seed() -> None:
    one, two = (
        wind.turbulence(
            wind.steady(10.0),
            0.15,
            np.random.default_rng(3),
            duration=20_000.0,
            time_scale=5.0,
            step=0.5,
        )
        for _ in range(2)
    )
    t = np.arange(0.0, 20_000.0, 0.5)
    values = np.array([one(s) for s in t]) - 10.0
    assert values[:100].tolist() == [two(s) - 10.0 for s in t[:100]]
    # 20,000 s are 2000 independent stretches of twice the time scale: 1/√(2·2000) = 1.6 % of σ, 3.2
    # % of σ²; three of these
    assert values.std() == pytest.approx(1.5, rel=0.05)
    lag = float(np.mean(values[:-10] * values[10:]) / values.var())
    assert lag == pytest.approx(math.exp(-1.0), abs=0.1)


@pytest.mark.parametrize("ratio", [0.01, 0.2, 1.0, 5.0])
def test_turbulence_has_its_intensity_at_every_time_however_long_the_step(ratio: float) -> None:
    rng = np.random.default_rng(5)
    seeds = 4000
    share = np.linspace(0.0, 1.0, 5)
    found = np.empty((seeds, 5))
    for row in found:
        speed = wind.turbulence(
            wind.steady(10.0), 0.1, rng, duration=2.0 * ratio, time_scale=1.0, step=ratio
        )
        row[:] = [speed(ratio * (1.0 + s)) - 10.0 for s in share]
    # the variance of n normal numbers has the standard deviation √(2/n) of itself, 2.2 %; 4 of
    # these
    assert_allclose(found.var(axis=0), 1.0, atol=4.0 * math.sqrt(2.0 / seeds))
    # from the beginning of a step to a share of it: (1 - s + s keep) over the deviation of the
    # line; at its end exp(-step / time scale)
    keep = math.exp(-ratio)
    expected = (1.0 - share + share * keep) / np.sqrt(
        1.0 - 2.0 * share * (1.0 - share) * (1.0 - keep)
    )
    assert_allclose(
        (found[:, :1] * found).mean(axis=0), expected, atol=4.0 * math.sqrt(2.0 / seeds)
    )
