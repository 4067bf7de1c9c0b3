"""Tours planned leg by leg, paths with a cruise, drives that yield to the swing, and the demo with
and without control.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import follow
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.repeated import Repeated
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import EngineName, State
from cranedyn.lifts.planning.itinerary import ARTICLE_TOUR, Leg, tour
from cranedyn.references import hanging_reference, hold, spline
from cranedyn.references.flat import cruise, flat
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion
from cranedyn.simulation.simulate import simulate
from experiments import harness
from experiments.scenarios.moves import TOUR_LIMITS as LIMITS
from experiments.scenarios.strategies import with_integral
from experiments.scenarios.tours import CONTROLS
from tests.helpers import FAST, G, big_crane, crane, quickly

FREE = Limits((10.0, 100.0, 100.0), (10.0, 100.0, 100.0))


def in_ten_seconds(start: State, goal: State) -> Motion:
    way = spline(crane(), start, [goal.q[crane().layout.drives]], [10.0])
    return hanging_reference(crane(), way, 10.0)


def test_a_cruise_is_at_constant_speed_between_its_ramps_and_arrives() -> None:
    t = np.linspace(-1.0, 21.0, 2201)
    s = cruise(t, 20.0, 5.0)
    assert_allclose(s[t <= 0.0], 0.0, atol=1e-15)
    assert_allclose(s[t >= 20.0], 1.0, atol=1e-13)  # rounding of a polynomial of degree 10
    middle = (t > 5.0) & (t < 15.0)
    assert_allclose(np.gradient(s, t)[middle], 1.0 / 15.0, atol=1e-12)
    assert (np.diff(s) >= -1e-15).all()


def test_a_flat_path_with_a_cruise_starts_and_ends_with_the_load_at_rest_where_asked() -> None:
    first = crane().state(x=10.0, l=15.0)
    last = crane().state(gamma=0.6, x=20.0, l=10.0)
    motion = flat(crane(), first, last, 20.0, ramp=5.0)
    for q, end in ((motion.q[0], first), (motion.q[-1], last)):
        # A spline of 5 ms samples.
        assert_allclose(payload_position(crane(), q), payload_position(crane(), end.q), atol=1e-7)
        assert_allclose(q[2:4], 0.0, atol=1e-7)


@pytest.mark.slow
def test_a_tour_joins_its_legs_without_a_jump_and_repeats() -> None:
    made = tour(crane(), ARTICLE_TOUR, in_ten_seconds, dwell=3.0)
    assert made.duration == pytest.approx(7 * 13.0)
    assert len(made.motion.q) == round(made.duration / 5e-3) + 1
    # The fastest quintic has 14 m in 10 s.
    assert np.abs(np.diff(made.motion.q, axis=0)).max() < 5e-3 * 15.0 / 8.0 * 1.4 * 1.01
    assert_allclose(made.motion.q[-1], made.motion.q[0], atol=1e-12)
    for stage in made.stages:
        assert_allclose(made(stage.arrival).position, stage.target, atol=1e-12)
        assert_allclose(made(stage.end + made.duration).position, stage.target, atol=1e-9)


def test_a_tour_has_one_period() -> None:
    """Its legs become one table, so that a leg of another period would be slower or faster."""

    def coarser_and_coarser(start: State, goal: State) -> Motion:
        periods.append(periods[-1] * 2.0)
        return flat(crane(), start, goal, 10.0, period=periods[-1])

    periods = [5e-3]
    legs = [Leg("out", x=14.0), Leg("in", x=crane().start.q[1])]
    with pytest.raises(OutOfRange, match=r"period of the motion of leg '?in'? is 0\.02 s"):
        tour(crane(), legs, coarser_and_coarser, dwell=0.0)


@pytest.mark.slow
def test_drives_that_yield_damp_the_swing_as_much_as_asked() -> None:
    point = big_crane()
    start = point.state(x=30.0, l=20.0, phi=0.01, theta=0.01)
    controller = with_damping(point, hold(point, start), ratio=0.2, limits=FREE)
    run = quickly(point, controller, start=start, duration=40.0, drive="motion")
    for angle in ("phi_rad", "theta_rad"):
        swing = run[angle]
        tops = [
            np.abs(swing[(run.t >= start) & (run.t < start + 9.2)]).max() for start in (0.0, 9.2)
        ]
        # a period of damped swing is 9.16 s and takes exp(-2πζ/√(1-ζ²)) = 0.277; sampling at 200 Hz
        # and 30 m of radius for the arc: 3 %
        decrement = math.exp(-2 * math.pi * 0.2 / math.sqrt(0.96))
        assert tops[1] / tops[0] == pytest.approx(decrement, rel=0.03)


@pytest.mark.slow
def test_drives_that_yield_keep_their_rates_and_accelerations() -> None:
    start = crane().state(phi=0.3)
    limits = Limits((0.08, 0.1, 0.8), (0.02, 0.4, 0.4))
    controller = with_damping(crane(), hold(crane(), start), limits=limits)
    run = quickly(crane(), controller, start=start, duration=10.0, drive="motion")
    assert np.abs(np.diff(run["x_dot_m_s"])).max() <= 0.4 * 5e-3 * (1 + 1e-9)
    assert np.abs(run["x_dot_m_s"]).max() == pytest.approx(0.1)


@pytest.mark.parametrize("theta", [0.0, 0.1, -0.1])
def test_at_the_slew_axis_the_slew_does_not_yield_and_every_command_is_finite(theta: float) -> None:
    reference = hold(crane(), crane().start)
    controller = with_damping(crane(), reference, limits=FREE)
    q = crane().start.q.copy()
    q[1:4] = 0.0, 0.05, theta
    command = controller(0.0, State(q, np.zeros(5)), reference(0.0))
    assert command[0] == 0.0
    # -2 ζ ω l φ within one period.
    assert command[1] == pytest.approx(-2.0 * 0.2 * math.sqrt(G * q[4]) * 0.05 / 5e-3)
    q[1] = 1e-9  # beside it the slew yields as fast as it can
    command = controller(0.0, State(q, np.zeros(5)), reference(0.0))
    assert command[0] == -math.copysign(10.0, theta) * (theta != 0.0)


@pytest.mark.parametrize("made", [follow, partial(with_damping, limits=FREE)])
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_a_controller_made_for_a_shorter_control_period_is_refused(
    made: Callable, engine: EngineName
) -> None:
    how = {"reference": hold(crane(), crane().start), "drive": "motion", "engine": engine}
    run = partial(simulate, crane(), duration=0.1, control_period=0.02, **how)
    short, exact = (
        made(crane(), how["reference"], control_period=period) for period in (5e-3, 0.02)
    )
    words = r"control period of the run is 0.02 s; allowed is .* 0.005 s, or less"
    with pytest.raises(OutOfRange, match=words):
        run(short)
    run(exact)


@pytest.mark.slow
def test_without_yielding_they_follow() -> None:
    start = crane().state(phi=0.1)
    reference = spline(crane(), start, [(0.1, 12.0, 14.0)], [10.0])
    runs = [
        quickly(crane(), controller, reference, start=start, duration=10.0, drive="motion")
        for controller in (
            follow(crane(), reference),
            with_damping(crane(), reference, ratio=0.0, limits=FREE),
        )
    ]
    assert_allclose(runs[0].q, runs[1].q, atol=1e-12)  # rounding


@pytest.mark.slow
@pytest.mark.parametrize("control", ["paper", pytest.param("lqr", marks=pytest.mark.long), "flat"])
def test_planned_tours_keep_the_limits(control: str) -> None:
    made, _ = CONTROLS[control](harness.Setup(), LIMITS, 6.0)
    shares = use(harness.Setup().crane, made.motion, LIMITS)  # type: ignore[attr-defined]
    assert max(shares.values()) < 1.0 + 1e-5  # a quintic's peak, rounded up to control periods


def test_a_load_heavier_than_planned_is_held_in_the_second_cycle_as_in_the_first() -> None:
    heavy = crane(payload_mass=1300.0)
    planned = crane()
    still = hanging_reference(planned, hold(planned, planned.start), 1.0, 1e-2)
    loop = Repeated(with_integral(harness.Setup(G, dt=1e-3), still), still.arrival)
    clocks = {"duration": 30.0, "dt": 1e-3, "control_period": 1e-2}
    run = quickly(heavy, loop, still, start=planned.start, **clocks)
    sag = np.abs(run["l_m"] - planned.start.q[planned.layout.index("l")])
    # The LQR alone lets a load sag that is heavier than planned; the integrator takes that out, in
    # 30 cycles of a second
    assert sag.max() > 0.05
    assert sag[-1] < 0.02 * sag.max()
