"""Least time, exactly: closed forms and bounds, ends in motion, obstacles, and interruptions."""

from __future__ import annotations

import os
import signal
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion
from tests.helpers import big_crane, crane
from tests.lifts.planning.sites import LIMITS, clearance, lift

ca = pytest.importorskip("casadi", reason="CasADi is not installed")

from cranedyn.lifts.planning import transcription  # noqa: E402
from cranedyn.lifts.planning.certificate import ARRIVAL_SWING, certify  # noqa: E402
from cranedyn.lifts.planning.clearance import Clearance  # noqa: E402
from cranedyn.lifts.planning.drive_trajectory import DriveTrajectory  # noqa: E402
from cranedyn.lifts.planning.half_spaces import half_spaces  # noqa: E402
from cranedyn.lifts.planning.least_time import in_least_time  # noqa: E402
from cranedyn.lifts.planning.motion_proof import Unproven, unproven_row  # noqa: E402
from cranedyn.lifts.planning.move import USUAL, Move, Preference  # noqa: E402
from cranedyn.lifts.planning.optimal import optimal  # noqa: E402

pytestmark = pytest.mark.slow

RATE = 1.0
"""Largest rate of the hoist [m/s]."""

ACCELERATION = 0.4
"""Largest acceleration of the hoist [m/s²]."""


def durations(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long the plans last that are made from now on [s], not rounded to a row."""
    found: list[float] = []
    solve = transcription.solve

    def solved(*given: Any, **also: Any) -> transcription.CollocationPlan:
        plan = solve(*given, **also)
        found.append(float(plan.durations.sum()))
        return plan

    monkeypatch.setattr(transcription, "solve", solved)
    return found


def hoisted(way: float, *, first: float = 0.0, last: float = 0.0, **how: Any) -> Motion:
    """Up from 15 m, with rates of the cable at both ends [m/s]."""
    start = crane().state(l=15.0, l_dot=-first)
    goal = crane().state(l=15.0 - way, l_dot=-last)
    return optimal(crane(), start, goal, LIMITS, still=("gamma", "x"), interval=0.5, **how)


# --- closed forms and bounds ---------------------------------------------------------------------


@pytest.mark.parametrize("way", [1.0, 2.0])
def test_without_a_ramp_a_short_move_of_one_drive_is_bang_bang(
    monkeypatch: pytest.MonkeyPatch, way: float
) -> None:
    found = durations(monkeypatch)
    motion = hoisted(way, ramp=0.0)
    least = 2.0 * np.sqrt(way / ACCELERATION)
    # an even number of intervals switches in the middle; IPOPT's tolerance
    assert found[0] == pytest.approx(least, rel=1e-5)
    inside = motion.a[: round(0.45 * least / motion.period), 4]
    np.testing.assert_allclose(inside, -ACCELERATION, rtol=1e-4)


@pytest.mark.parametrize("way", [6.77, 8.23])
def test_without_a_ramp_a_long_move_of_one_drive_takes_the_time_of_a_trapezoid(
    monkeypatch: pytest.MonkeyPatch, way: float
) -> None:
    found = durations(monkeypatch)
    hoisted(way, ramp=0.0)
    least = way / RATE + RATE / ACCELERATION
    # A switch within an interval of 0.5 s costs up to h²/8 of acceleration at full rate, at both
    # ends.
    assert least * (1.0 - 1e-6) < found[0] < least + 2.0 * ACCELERATION * 0.5**2 / 8.0 / RATE


def test_no_combined_move_takes_less_than_its_slew_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    found = durations(monkeypatch)
    start = crane().state(x=15.0, l=15.0)
    goal = crane().state(gamma=0.6, x=12.0, l=15.0)
    optimal(crane(), start, goal, LIMITS, swing=0.3, interval=0.5)
    rate = LIMITS.rates[0]
    acceleration = LIMITS.accelerations[0]
    ramp = 0.5
    alone = 0.6 / rate + rate / acceleration + ramp
    assert alone * (1.0 - 1e-6) < found[0] < 1.1 * alone


def test_a_preference_costs_no_more_time_than_it_is_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    found = durations(monkeypatch)
    start = crane().state(x=10.0, l=15.0)
    goal = crane().state(x=11.0, l=15.0)
    worth = (1e-4, 0.03)
    motions = [
        optimal(crane(), start, goal, LIMITS, ramp=0.2, preference=Preference(longer=longer))
        for longer in worth
    ]
    # The cost is worth between none and all of its share of the duration.
    assert found[1] <= found[0] * (1.0 + worth[1])
    assert found[0] <= found[1] * (1.0 + worth[0])
    swings = [float((motion.q[:, 2:4] ** 2).sum()) for motion in motions]
    assert swings[1] < swings[0]


def test_a_move_that_begins_in_motion_takes_what_is_left_of_a_trapezoid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = durations(monkeypatch)
    motion = hoisted(5.0, first=RATE)
    # at full rate, then half of a fall of the rate at 0.4 m/s² and of a ramp
    least = 5.0 / RATE + 0.5 * (RATE / ACCELERATION + 0.5)
    # intervals of half a second do not end where the jerk should switch
    assert least * (1.0 - 1e-6) < found[-1] < least + 0.05
    assert motion.v[0, 4] == -RATE
    assert not motion.v[-1].any()
    assert not motion.a[-1].any()


def test_a_move_that_ends_in_motion_ends_so_in_a_row() -> None:
    motion = hoisted(5.0, last=RATE)
    least = 5.0 / RATE + 0.5 * (RATE / ACCELERATION + 0.5)
    # as above, and one row
    assert least <= motion.arrival < least + 0.055
    assert motion.v[-1, 4] == -RATE
    assert motion.q[-1, 4] == 10.0
    h = motion.period
    # the last row follows from the one before: order 5 of the plan, 1e-8 of IPOPT
    assert motion.q[-2, 4] + h * motion.v[-2, 4] == pytest.approx(10.0, abs=1e-6)
    assert motion.v[-2, 4] == pytest.approx(-RATE, abs=1e-5)


def test_a_swinging_load_is_brought_to_rest_where_it_hangs() -> None:
    start = crane().state(x=12.0, l=15.0, phi=0.05, phi_dot=0.02)
    goal = crane().state(x=12.0, l=15.0)
    motion = optimal(crane(), start, goal, LIMITS, still=("gamma", "l"), interval=0.5)
    assert motion.q[0].tolist() == start.q.tolist()
    assert motion.v[0].tolist() == start.v.tolist()
    assert max(use(crane(), motion, LIMITS).values()) < 1.0 + 1e-6
    amplitude = np.hypot(motion.q[-2, 2], motion.v[-2, 2] * np.sqrt(15.0 / crane().gravity))
    assert amplitude < 5e-6  # what the swing that was integrated differs from that of the plan
    assert np.abs(motion.q[:, 1] - 12.0).max() > 0.1


def test_a_move_ends_swinging_as_asked() -> None:
    start = crane().state(x=10.0, l=15.0)
    goal = crane().state(x=12.0, l=15.0, phi=-0.05, phi_dot=0.01)
    motion = optimal(crane(), start, goal, LIMITS, still=("gamma", "l"), interval=0.5)
    assert motion.q[-1].tolist() == goal.q.tolist()
    assert motion.q[-2, 2] + motion.period * motion.v[-2, 2] == pytest.approx(-0.05, abs=2e-6)


# --- obstacles ------------------------------------------------------------------------------------


def test_a_lift_in_least_time_is_certified_and_near_what_the_drives_alone_need() -> None:
    made = certify(in_least_time(lift()))
    assert [check.sentence for check in made.checks if not check.holds] == []
    assert made.residual_swing < ARRIVAL_SWING
    planned = lift().timed
    least = made.lift.timed
    assert least.bound < least.motion.arrival < 0.95 * planned.motion.arrival
    assert least.motion.arrival < 1.05 * least.bound
    assert max(least.shares.values()) <= 1.0 + 1e-3
    motion = least.motion
    assert unproven_row(made.lift.clearance, motion.q, motion.period) is None


def test_half_spaces_about_a_place_tell_its_room_and_no_more_of_any_place() -> None:
    clearance = lift().clearance
    places = lift().timed.places[::150]
    spaces = half_spaces(clearance, places, 0.0)
    q = ca.SX.sym("q", 5)
    room = ca.Function("room", [q, spaces.symbols], [ca.mmin(spaces.margins(q))])
    rng = np.random.default_rng(1)
    for k, place in enumerate(places):
        here = float(room(clearance.q(place), spaces.values[:, k]))
        # coal's tolerance, and 1e-2 that a proof does not go below
        assert here + 1e-2 == pytest.approx(clearance.swing_margin(place), abs=2e-4)
        for other in place + rng.normal(size=(20, 3)) * [0.01, 0.5, 0.5]:
            at = float(room(clearance.q(other), spaces.values[:, k]))
            # a body may turn a corner towards a plane, by no more than its size times the turn
            turned = 2.0 * abs(other[0] - place[0])
            assert at < clearance.swing_margin(other) + turned + 1e-2 or k in (0, len(places) - 1)


def test_a_motion_that_is_not_proven_is_not_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transcription, "solve", lambda problem, guess, **_: guess)
    asked = lift().clearance
    start, goal = lift().states()
    with pytest.raises(Unproven, match=r"not proven to keep the distance .* at t = ") as why:
        optimal(crane(), start, goal, LIMITS, clearance=asked)  # straight through the wall
    assert 0.0 < why.value.t < 40.0


def test_among_obstacles_drives_stay_inside_their_ranges_as_far_as_start_and_goal_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Between the points of a plan a motion left the range of the trolley by 3e-5 m."""
    from cranedyn.lifts.planning import optimal as module

    moves: list[Move] = []
    monkeypatch.setattr(module, "problem", lambda move, _: moves.append(move))
    monkeypatch.setattr(transcription, "solve", lambda problem, guess, **_: guess)
    start = crane().state(x=12.0, l=15.0)
    goal = crane().state(x=21.9998, l=15.0)
    optimal(crane(), start, goal, LIMITS, clearance=clearance(swing=0.2))
    low, high = moves[0].ranges
    own = np.array([crane().lower, crane().upper])
    assert low[1] == own[0, 1] + 1e-3
    assert high[1] == 21.9998
    assert high[4] == own[1, 4] - 1e-3


def test_a_motion_whose_rope_leans_more_than_the_site_allows_is_not_returned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing stands in the way of a quick move, and the rope of a guess leans as it will."""
    monkeypatch.setattr(transcription, "solve", lambda problem, guess, **_: guess)
    start = crane().state(x=12.0, l=15.0)
    goal = crane().state(x=18.0, l=15.0)
    made = optimal(crane(), start, goal, LIMITS, clearance=clearance(swing=0.2))
    leans = float(clearance().tilt(made.q).max())
    assert 0.01 < leans < 0.2
    with pytest.raises(Unproven, match=rf"the rope leans by {leans:.4f} rad"):
        optimal(crane(), start, goal, LIMITS, clearance=clearance(swing=0.9 * leans))


def test_a_search_begins_with_a_motion_between_the_same_places_only() -> None:
    start, goal = lift().states()
    with pytest.raises(OutOfRange, match="begin is a motion between other places; allowed is one"):
        optimal(crane(), goal, start, LIMITS, begin=lift().timed.motion)


def test_ends_that_are_too_near_to_something_are_refused() -> None:
    asked: Clearance = lift().clearance
    start, _ = lift().states()
    low = State(start.q + np.array([0.1, 0.0, 0.0, 0.0, 2.3]), start.v)
    with pytest.raises(OutOfRange, match="clearance margin at the goal is -"):
        optimal(crane(), start, low, LIMITS, clearance=asked)


def test_an_interruption_of_the_optimiser_is_one_and_no_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    iterations = []

    def interrupted(self: Any, arg: Any) -> list[int]:
        iterations.append(1)
        if len(iterations) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return [int(self.signal_arrived())]

    monkeypatch.setattr(transcription._StopOnSignal, "eval", interrupted)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        hoisted(5.0)
    assert len(iterations) <= 5
    assert signal.getsignal(signal.SIGINT) is before
    monkeypatch.undo()
    assert hoisted(1.0).arrival > 3.0


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_drives_reach_no_farther_between_two_times_than_is_said(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ones = np.ones(3)
    of = big_crane()
    jerk = ones if seed % 2 else None
    move = Move(of, of.start, of.start, np.arange(3), ones, ones, jerk, 0.1, USUAL)
    durations = rng.uniform(0.1, 1.0, 8)
    controls = rng.normal(size=(8, 3))
    plan = transcription.CollocationPlan(durations, controls, np.zeros((25, 13)))
    driven = DriveTrajectory(move, plan)
    low, high = np.sort(rng.uniform(0.0, driven.duration, 2))
    there = np.array([driven.at(t) for t in np.linspace(low, high, 101)])
    off = np.abs(there - driven.at((low + high) / 2.0)).max(axis=0)
    assert (off <= driven.reach(low, high) + 1e-12).all()


def test_limits_of_a_drive_that_stands_still_do_not_matter() -> None:
    slow = Limits((1e-3, 1e-3, RATE), (1e-3, 1e-3, ACCELERATION))
    start = crane().state(l=15.0)
    goal = crane().state(l=14.0)
    still = ("gamma", "x")
    motion = optimal(crane(), start, goal, slow, still=still, interval=0.5, ramp=0.0)
    assert motion.arrival == pytest.approx(2.0 * np.sqrt(1.0 / ACCELERATION), abs=5e-3)
