"""Optimal moves: the symbols against Pinocchio, the optimiser against closed forms and linear
programs, the moves against their limits.
"""

from __future__ import annotations

import importlib
import sys
from functools import cache, partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from scipy.linalg import expm
from scipy.optimize import linprog

from cranedyn.controllers import lqr
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.references import Motion
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits, fastest, use
from tests.helpers import G, accelerations, big_crane, crane, long_after, quickly, states

ca = pytest.importorskip("casadi", reason="CasADi is not installed")

from cranedyn.lifts.planning import transcription  # noqa: E402
from cranedyn.lifts.planning.move import hybrid_dynamics, rnea  # noqa: E402
from cranedyn.lifts.planning.optimal import optimal  # noqa: E402

pytestmark = pytest.mark.slow

LIMITS = Limits((0.0838, 1.583, 1.0), (0.02, 0.4, 0.4))
RAMP = 0.5
ENDS = {
    "trolley": ({"x": 10.0, "l": 15.0}, {"x": 20.0, "l": 15.0}),
    "slew": ({"x": 15.0, "l": 15.0}, {"gamma": 0.6, "x": 15.0, "l": 15.0}),
    "combined": ({"x": 10.0, "l": 15.0}, {"gamma": 0.6, "x": 20.0, "l": 10.0}),
}


def ends(move: str) -> tuple[State, State]:
    start, goal = ENDS[move]
    return crane().state(**start), crane().state(**goal)


@cache
def moved(
    move: str,
    swing: float = 0.1,
    duration: float | None = None,
    still: tuple[str, ...] | None = None,
) -> Motion:
    return optimal(crane(), *ends(move), LIMITS, swing=swing, duration=duration, still=still)


def peak(motion: Motion) -> float:
    return float(np.abs(motion.q[:, crane().layout.passive]).max())


def squared_swing(motion: Motion) -> float:
    return float((motion.q[:, crane().layout.passive] ** 2).sum() * motion.period)


# --- symbols --------------------------------------------------------------------------------------


@cache
def _symbolic_rnea(model: pin.Model) -> Any:
    q, v, a = (ca.SX.sym(name, model.nv) for name in "qva")
    return ca.Function("rnea", [q, v, a], [rnea(model, q, v, a)])


@given(states, accelerations)
def test_symbolic_inverse_dynamics_is_pinocchios_on_the_crane(
    state: State, drives: np.ndarray
) -> None:
    a = np.array([drives[0], drives[1], 0.3, -0.2, drives[2]])
    model = crane().model
    theirs = pin.rnea(model, crane().data, *state, a)
    ours = _symbolic_rnea(model)(*state, a).full().ravel()
    size = np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * size)  # some hundred roundings


def test_symbolic_inverse_dynamics_is_pinocchios_on_an_arm_with_turned_joints_and_armature() -> (
    None
):
    model = pin.buildSampleModelManipulator()
    rng = np.random.default_rng(5)
    model.armature = rng.uniform(0.1, 1.0, model.nv)
    for i in range(1, model.njoints):
        model.jointPlacements[i] = pin.SE3.Random()
        model.inertias[i] = pin.Inertia.Random()
    for q, v, a in rng.normal(size=(20, 3, model.nv)):
        theirs = pin.rnea(model, model.createData(), q, v, a)
        ours = _symbolic_rnea(model)(q, v, a).full().ravel()
        size = np.abs(theirs).max()
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * size)


@given(states, accelerations)
def test_symbolic_swing_under_prescribed_drives_is_that_of_the_dynamics_with_damping(
    state: State, drives: np.ndarray
) -> None:
    damped = crane(damp_slew=3e4, damp_trolley=200.0, damp_swing=5e3, damp_hoist=700.0)
    q = ca.SX.sym("q", 5)
    v = ca.SX.sym("v", 5)
    a = ca.SX.sym("a", 3)
    ours = ca.Function("prescribed", [q, v, a], hybrid_dynamics(damped, q, v, a))(*state, drives)
    for one, other in zip(
        ours, dynamics.prescribed_acceleration(damped, state, drives), strict=True
    ):
        # rounding, amplified by the condition of the two passive equations, below 1e3 here
        np.testing.assert_allclose(
            one.full().ravel(), other, rtol=0, atol=1e-11 * max(1.0, np.abs(other).max())
        )


def test_without_casadi_a_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    monkeypatch.delitem(sys.modules, "cranedyn.lifts.planning.transcription")
    with pytest.raises(CraneError, match=r"pip install 'cranedyn\[optimal\]'"):
        importlib.import_module("cranedyn.lifts.planning.transcription")


# --- transcription --------------------------------------------------------------------------------


def bridge(
    intervals: int, steps: int, *, equal: bool = False, way: float = 15.0
) -> transcription.CollocationPlan:
    """Minimum-time bridge crane from a smooth guess of 10 s without swing."""
    x = ca.SX.sym("x", 4)
    u = ca.SX.sym("u")
    free = np.full(4, np.inf)
    problem = transcription.Problem(
        x=x,
        u=u,
        gap=ca.SX.sym("gap"),
        rates=ca.vertcat(x[1], u, x[3], -0.98 * x[2] + 0.1 * u),
        cost=ca.SX(1.0),
        path=ca.SX(0, 1),
        bounds=np.array([-free, free]),
        control_bounds=np.array([[-1.0], [1.0]]),
        path_bounds=np.zeros((2, 0)),
        scale=np.array([10.0, 1.0, 0.1, 0.1]),
    )
    durations = np.full(intervals, 10.0 / intervals)
    s = transcription.times(durations, steps) / 10.0
    states = np.stack(
        [way * s**2 * (3.0 - 2.0 * s), way * 0.6 * s * (1.0 - s), 0.0 * s, 0.0 * s], axis=1
    )
    return transcription.solve(
        problem,
        transcription.CollocationPlan(durations, np.zeros((intervals, 1)), states),
        equal=equal,
    )


def test_the_bridge_crane_switches_when_the_published_bang_bang_solution_does() -> None:
    plan = bridge(4, 10)
    np.testing.assert_allclose(plan.controls.ravel(), [1.0, -1.0, 1.0, -1.0], atol=1e-6)
    # order 5 with steps of 0.3 s leaves 1e-6 s, the published digits 1e-8 s
    switches = [2.98534056, 4.29005132, 5.59476207, 8.58010264]
    np.testing.assert_allclose(np.cumsum(plan.durations), switches, rtol=0, atol=1e-5)
    # not told how often to switch; steps of up to 0.6 s: 32 times the error
    assert bridge(8, 5).durations.sum() == pytest.approx(8.58010264, abs=1e-4)


def test_equal_intervals_cost_the_bridge_crane_less_the_more_there_are() -> None:
    coarse, fine = (bridge(n, 1, equal=True).durations for n in (32, 128))
    assert np.ptp(coarse) < 1e-9
    # switches fall at most half an interval beside their best place, and the loss is of second
    # order in that
    assert 8.58010264 - 1e-5 < fine.sum() < coarse.sum() < 8.60


def test_what_cannot_be_reached_is_unsolved_and_the_status_is_told() -> None:
    x = ca.SX.sym("x")
    u = ca.SX.sym("u")
    gap = ca.SX.sym("gap")
    bounds = np.array([[-9.0], [9.0]])
    forwards = np.array([[0.0], [1.0]])
    nothing = ca.SX(0, 1), bounds, forwards, np.zeros((2, 0)), np.ones(1)
    forward = transcription.Problem(x, u, gap, u, ca.SX(1.0), *nothing)
    backward = transcription.CollocationPlan(
        np.ones(2), np.zeros((2, 1)), -transcription.times(np.ones(2))[:, None]
    )
    infeasible = "IPOPT ends with Infeasible_Problem_Detected"
    with pytest.raises(transcription.Unsolved, match=infeasible) as failure:
        transcription.solve(forward, backward, equal=True)
    assert failure.value.status == "Infeasible_Problem_Detected"


# --- least time -----------------------------------------------------------------------------------


def linear_time(
    intervals: int,
    way: float,
    length: float,
    rate: float,
    acceleration: float,
    swing: float,
    parts: int,
) -> float:
    """Least time [s] of a trolley with a small swing l φ̈ + g φ = ẍ, by bisection over exactly
    sampled linear programs.

    The jerk is constant over equal intervals; rate, acceleration and swing are kept at the ends of
    equal parts of them.
    """
    flow = np.zeros((6, 6))
    flow[[0, 1, 2, 3], [1, 2, 5, 4]] = 1.0
    flow[4, [2, 3]] = 1.0 / length, -G / length
    size = np.array([way, rate, acceleration, swing, swing])

    def reachable(duration: float) -> bool:
        step = expm(flow * duration / intervals / parts)
        response = np.zeros((5, intervals))
        rows = []
        for k in range(intervals * parts):
            response = step[:5, :5] @ response
            response[:, k // parts] += step[:5, 5] * acceleration / RAMP
            rows.append(response[1:4] / size[1:4, None])
        path = np.vstack([*rows, *(-row for row in rows)])
        ends = response / size[:, None]
        target = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
        none = np.zeros(intervals)
        ones = np.ones(len(path))
        return linprog(none, path, ones, ends, target, bounds=(-1.0, 1.0)).status == 0

    low = 8.0
    high = 16.0
    while high - low > 1e-5:
        middle = (low + high) / 2.0
        low, high = (low, middle) if reachable(middle) else (middle, high)
    return high


@pytest.mark.parametrize(("swing", "parts", "excess"), [(0.1, 1, 1e-5), (0.05, 8, 3e-4)])
def test_the_least_time_of_a_small_trolley_move_is_that_of_a_linear_program(
    monkeypatch: pytest.MonkeyPatch, swing: float, parts: int, excess: float
) -> None:
    plans: list[transcription.CollocationPlan] = []
    solve = transcription.solve
    monkeypatch.setattr(
        transcription,
        "solve",
        lambda *given, **also: plans.append(solve(*given, **also)) or plans[0],
    )
    point = big_crane()
    small = 0.01
    start = point.state(x=10.0, l=15.0)
    goal = point.state(x=10.0 + 10.0 * small, l=15.0)
    limits = Limits([small * r for r in LIMITS.rates], [small * a for a in LIMITS.accelerations])
    optimal(point, start, goal, limits, swing=small * swing, ramp=RAMP)
    durations = plans[0].durations
    trolley = (limits.rates[1], limits.accelerations[1])
    least = linear_time(len(durations), 10.0 * small, 15.0, *trolley, small * swing, parts)
    # Angles of a thousandth are linear to 1e-6. Where the swing touches its bound the tangents half
    # a gap of 1/8 s ahead give away some (1/16 s)²/2 of its curvature, 0.1 % of the swing, in some
    # of the twelve seconds.
    assert least * (1.0 - 1e-5) < durations.sum() < least * (1.0 + excess)


def test_a_hoist_alone_takes_the_time_of_a_trapezoid_with_ramps() -> None:
    start = crane().state(x=10.0, l=15.0)
    goal = crane().state(x=10.0, l=5.0)
    motion = optimal(crane(), start, goal, LIMITS, ramp=RAMP)
    # 10 m at 1 m/s, one rise of the rate at 0.4 m/s², one ramp; rounded up to 5 ms
    assert 13.0 <= motion.arrival <= 13.0 + motion.period + 1e-9
    assert peak(motion) < 1e-6


def test_a_fast_hoist_lets_the_load_fall_until_the_rope_is_nearly_slack_then_brakes_fully() -> None:
    weak = crane(hoist_effort=12e3)
    limits = Limits((0.1, 1.0, 20.0), (0.02, 0.4, 30.0))
    motion = optimal(weak, weak.state(l=5.0), weak.state(l=25.0), limits, ramp=0.2)
    # m (g - l̈) from a tenth of the weight to the limit of the effort, on a mass of a tonne
    assert motion.a[:, 4].max() == pytest.approx(0.9 * G, rel=1e-4)
    assert motion.a[:, 4].min() == pytest.approx(G - 12.0, rel=1e-4)


@pytest.mark.parametrize(
    ("move", "swing"),
    [
        # A combined move is one of the trolley and one of the slew, too.
        pytest.param("trolley", 0.05, marks=pytest.mark.long),
        pytest.param("slew", 0.1, marks=pytest.mark.long),
        pytest.param("combined", 0.05, marks=pytest.mark.long),
        ("combined", 0.1),
    ],
)
def test_a_move_of_least_time_exceeds_no_limit_at_any_instant_and_uses_one_fully(
    move: str, swing: float
) -> None:
    motion = moved(move, swing)
    shares = use(crane(), motion, LIMITS)
    shares["swing"] = peak(motion) / swing
    jerk = np.diff(motion.a[:-1, motion.drives], axis=0) / motion.period
    shares["jerk"] = float((np.abs(jerk) * RAMP / LIMITS.accelerations).max())
    # bounds are kept by the optimiser to 1e-8, by the swing between its points to the third order
    # of 1/8 s
    assert max(shares.values()) == pytest.approx(1.0, abs=2e-5)
    tension = [
        crane().damping[4] * v[4]
        - dynamics.inverse_dynamics(crane().model, crane().data, q, v, a, crane().damping)[2]
        for q, v, a in zip(motion.q[::20], motion.v[::20], motion.a[::20], strict=True)
    ]
    assert min(tension) > 0.0


def test_an_optimal_motion_obeys_the_equations_of_motion_and_its_rows_their_derivatives() -> None:
    motion = moved("combined")
    h = moved("combined").period
    for q, v, a in zip(motion.q[::50], motion.v[::50], motion.a[::50], strict=True):
        force = pin.rnea(crane().model, crane().data, q, v, a) + crane().damping * v
        # rounding: the swing's accelerations are solved from these rows
        assert np.abs(force[crane().layout.passive]).max() < 1e-9 * np.abs(force).max()
    inside = slice(0, -2)  # the last row is the first instant after the arrival
    mean = (motion.v[1:] + motion.v[:-1]) / 2.0
    bend = np.diff(motion.a, axis=0)
    # Hermite's rule and the trapezoidal one: no more than h³/48 and h²/8 times the jump of a jerk,
    # 1.6 m/s³ at most
    steps = np.diff(motion.q, axis=0)
    expected = h * mean - h * h / 12.0 * bend
    allowed = 1.6 * h**3 / 48.0
    np.testing.assert_allclose(steps[inside], expected[inside], rtol=0, atol=allowed)
    mean = (motion.a[1:] + motion.a[:-1]) / 2.0
    np.testing.assert_allclose(
        np.diff(motion.v, axis=0)[inside], h * mean[inside], rtol=0, atol=1.6 * h**2 / 8.0
    )


@pytest.mark.parametrize(
    "move",
    [pytest.param(move, marks=[pytest.mark.long] * (move in ("trolley", "slew"))) for move in ENDS],
)
def test_an_optimal_motion_begins_and_ends_with_the_load_at_rest_where_asked(move: str) -> None:
    motion = moved(move)
    start, goal = ends(move)
    for k, end in ((0, start), (-1, goal)):
        assert motion.q[k].tolist() == end.q.tolist()
        assert not motion.v[k].any()
    assert not motion.a[-1].any()
    # One instant before, braking at the limit of jerk leaves j h²/2 of a rate and j h³/6 of a way;
    # the rest is the defect of the plan.
    h = motion.period
    jerk = np.max(LIMITS.accelerations) / RAMP
    assert np.abs(motion.q[-2] - motion.q[-1]).max() < jerk * h**3 / 6.0 + 1e-6
    assert np.abs(motion.v[-2]).max() < jerk * h**2 / 2.0 + 1e-6


def test_a_slew_near_the_mast_keeps_the_trolley_in_its_range() -> None:
    at = {"x": 2.0, "l": 15.0}
    motion = optimal(crane(), crane().state(**at), crane().state(gamma=0.6, **at), LIMITS)
    # between points 1/8 s apart an acceleration of 0.4 m/s² leaves the range by a t²/8
    assert 2.0 - 0.4 / 8.0**3 < motion.q[:, 1].min() < 2.0 + 1e-6
    assert motion.q[:, 1].max() > 2.1


def test_a_tighter_bound_of_the_swing_costs_time() -> None:
    assert moved("trolley", 0.05).arrival > moved("trolley", 0.1).arrival
    assert moved("combined", 0.05).arrival > moved("combined", 0.1).arrival


@pytest.mark.parametrize("move", ENDS)
def test_the_least_time_is_less_than_the_fastest_flat_motion_takes(move: str) -> None:
    assert moved(move).arrival < fastest(
        crane(), partial(flat, crane(), *ends(move), period=0.05), LIMITS
    )


def test_drives_with_no_way_to_go_stand_still_unless_they_are_set_free() -> None:
    assert np.ptp(moved("trolley").q[:, [0, 4]], axis=0).tolist() == [0.0, 0.0]
    assert np.ptp(moved("slew").q[:, 4]) == 0.0
    free = moved("trolley", still=())
    alone = optimal(crane(), *ends("slew"), LIMITS, still=("x", "l"))
    assert free.arrival < moved("trolley").arrival  # a drive more does not make the best worse
    assert np.ptp(alone.q[:, [1, 4]], axis=0).tolist() == [0.0, 0.0]
    assert alone.arrival > moved("slew").arrival


# --- tracking, least swing ------------------------------------------------------------------------


def test_the_fastest_combined_move_tracked_by_the_lqr_arrives_without_swing() -> None:
    motion = moved("combined")
    start, goal = ends("combined")
    run = quickly(crane(), lqr(crane(), motion), motion, start=start, duration=motion.arrival + 5.0)
    after = run.since(motion.arrival - 1e-9)
    # semi-implicit Euler of 0.5 ms and efforts held for 5 ms leave some 1e-5
    assert np.abs(after.q[:, crane().layout.passive]).max() < 1e-4
    assert np.abs(after.q[-1] - goal.q).max() < 1e-3


@pytest.mark.parametrize("move", long_after(1, ["trolley", "combined"]))
def test_least_swing_is_less_than_that_of_the_flat_motion_in_the_same_time(move: str) -> None:
    ours = moved(move, duration=20.0)
    theirs = flat(crane(), *ends(move), 20.0)
    assert ours.arrival == pytest.approx(20.0, abs=1e-9)
    assert squared_swing(ours) < squared_swing(theirs)
    assert peak(ours) <= peak(theirs)
    assert max(use(crane(), ours, LIMITS).values()) < 1.0 + 1e-6


def test_more_time_means_less_swing() -> None:
    found = [squared_swing(moved("trolley", duration=duration)) for duration in (12.0, 14.0, 20.0)]
    assert found == sorted(found, reverse=True)


def test_a_duration_too_short_names_the_least_and_that_one_works() -> None:
    with pytest.raises(
        CraneError, match=r"duration is 8\.0 s; allowed is at least \d+\.\d\d s to keep all limits"
    ) as refusal:
        moved("trolley", duration=8.0)
    least = float(str(refusal.value).split("at least ")[1].split()[0])
    # Both rounded up, to 10 and to 5 ms.
    assert least == pytest.approx(moved("trolley").arrival, abs=0.011)
    assert moved("trolley", duration=least).arrival == pytest.approx(least, abs=1e-9)
