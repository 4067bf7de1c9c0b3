"""Where the drives should be: hold, pulse, ramp, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.lifts.planning.itinerary import Leg, itinerary, tour
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.model.load import load_crane
from cranedyn.references import (
    ei,
    flat,
    hanging_reference,
    hold,
    pulse,
    ramp,
    shaped,
    shaped_hoisting,
    spline,
    zv,
)
from cranedyn.references.limits import Limits, fastest
from cranedyn.references.motion import Motion
from cranedyn.references.simple import PEAK_RATE, Ramp, checked_reference, shortest
from cranedyn.references.tabulated import tabulated
from tests.helpers import crane

CRANE = crane()
START = CRANE.state(gamma=0.5, x=12.0, l=9.0)
BASE = hold(CRANE, START)
PLACE = [0.5, 12.0, 9.0]


QUINTIC = spline(CRANE, START, [(0.0, 14.0, 7.0)], [3.0], at=1.0)
PUSHES = joystick(
    CRANE,
    START,
    [JoystickPulse("x", 0.5, 1.0, 3.0), JoystickPulse("l", -0.8, 2.0, 0.01)],
    accelerations=(0.02, 0.4, 0.4),
)


def _plan(start: State, goal: State) -> Motion:
    return hanging_reference(CRANE, spline(CRANE, start, [goal.q[CRANE.layout.drives]], [2.0]), 2.0)


WAYS = [Leg("out and up", x=13.0, l=8.0), Leg("back", x=12.0, l=9.0)]
THERE_AND_BACK = itinerary(CRANE, START, WAYS, rates=(0.1, 0.5, 0.4), dwell=0.5)
LEGS = tour(CRANE, [Leg("out", x=12.0), Leg("in", x=10.0)], _plan, dwell=0.5)


@pytest.mark.parametrize(
    "reference",
    [
        BASE,
        pulse(CRANE, BASE, "x", -0.3, at=1.0, width=2.0),
        ramp(
            CRANE, pulse(CRANE, QUINTIC, "x", -0.3, at=1.0, width=2.0), "l", -1.0, rate=0.5, at=2.0
        ),
        ramp(CRANE, lambda t: BASE(t), "gamma", 0.1, rate=0.1, at=1.0),
        QUINTIC,
        hanging_reference(CRANE, QUINTIC, 5.0),
        PUSHES,
        joystick(CRANE, START, [], accelerations=(0.02, 0.4, 0.4)),
        shaped(PUSHES, ei(), 1.3),
        shaped_hoisting(CRANE, PUSHES, zv(), 5.0),
        LEGS,
        THERE_AND_BACK,
    ],
    ids="hold,pulse,ramp,ramp on a function,spline,motion,operator,nobody,shaped,shaped hoisting,"
    "tour,itinerary".split(","),
)
def test_many_times_at_once_are_setpoint_as_each_by_itself(reference: Reference) -> None:
    times = -0.5 + 0.005 * np.arange(1900)
    at_instants = checked_reference(reference, CRANE.layout, -0.5, 0.005)
    single, blocks = ([at(t) for t in times.tolist()] for at in (reference, at_instants))
    for i, column in enumerate(tabulated(reference, times)):
        # sums of ten terms up to 14 m in another order round at 1e-15 of them
        for setpoints in (single, blocks):
            np.testing.assert_allclose(column, [s[i] for s in setpoints], rtol=0.0, atol=1e-13)


def test_a_reference_that_fails_later_is_followed_until_then() -> None:
    class Until(Ramp):
        def at(self, times: np.ndarray) -> Setpoint:
            return super().at(times[times < 0.3] if len(times) == 1 else times / 0.0)

    at_instants = checked_reference(Until(BASE, np.ones(3), 0.0, 1.0), CRANE.layout, 0.0, 0.1)
    np.testing.assert_allclose(at_instants(0.2).position, np.add(PLACE, 0.2))
    with pytest.raises(IndexError):
        at_instants(0.3)


LIMITS = (0.02, 0.4, 0.4)
LEVEL = joystick(
    CRANE,
    START,
    [JoystickPulse("x", 0.5, 0.0, 3.0), JoystickPulse("gamma", 0.05, 1.0, 4.0)],
    accelerations=LIMITS,
)
"""Without hoisting the last part of a shaped move comes right at its end."""

RESTING: dict[str, tuple[Reference, float, float, float]] = {
    "hold": (BASE, 0.0, 0.0, 0.0),
    "pulse": (pulse(CRANE, BASE, "x", -0.3, at=1.0, width=2.0), 1.0, 3.0, 0.0),
    "ramp": (ramp(CRANE, QUINTIC, "l", -1.0, rate=0.5, at=2.0), 1.0, 4.0, 0.0),
    "spline": (QUINTIC, 1.0, 4.0, 0.0),
    "operator": (PUSHES, 1.0, 5.25, 0.0),
    "shaped": (shaped(PUSHES, ei(), 1.3), 1.0, 6.55, 0.0),
    "shaped hoisting": (shaped_hoisting(CRANE, PUSHES, zv(), 5.25), 0.0, 10.0, 0.0),
    "shaped level": (shaped_hoisting(CRANE, LEVEL, zv(), 7.5), 0.0, 12.0, 0.0),
    "motion": (hanging_reference(CRANE, QUINTIC, 5.0, 0.02), 1.0, 5.0, 0.02),
    "flat": (
        flat(CRANE, CRANE.state(), CRANE.state(gamma=0.2, x=13.0, l=8.0), 8.0, period=0.02),
        0.0,
        8.0,
        0.02,
    ),
}
"""References that jump at multiples of 5 ms only; when they begin to move, when they have arrived,
and time between rows, 0 without [s]."""

CUT_SHORT = (
    hanging_reference(CRANE, ramp(CRANE, BASE, "x", 0.5, rate=0.1, at=1.0), 3.0, 0.02),
    0.98,
    3.0,
    0.02,
)
"""Its velocity jumps within the rows."""

ENDLESS: dict[str, tuple[Reference, float]] = {
    "itinerary": (THERE_AND_BACK, 0.0),
    "tour": (LEGS, 5e-3),
}


@pytest.mark.parametrize(
    ("reference", "spacing"),
    [*((r, gap) for r, *_, gap in RESTING.values()), *ENDLESS.values()],
    ids=[*RESTING, *ENDLESS],
)
def test_positions_are_the_integrals_of_velocities_and_these_of_accelerations(
    reference: Reference, spacing: float
) -> None:
    """Simpson's rule within cells of 5 ms, at whose ends all jumps are; it is exact for the
    polynomials that all references are made of.
    """
    cell = 5e-3
    begins = cell * np.arange(-200, 2800)
    first, middle, last = (tabulated(reference, begins + share * cell) for share in (0.1, 0.5, 0.9))
    for of, by in ((0, 1), (1, 2)):
        gone = 0.8 * cell / 6.0 * (first[by] + 4.0 * middle[by] + last[by])
        # between rows a straight line has the mean slope, which parts from the rate by its change
        # over a row at most
        change = np.abs(
            np.diff(tabulated(reference, spacing * np.arange(-1, 700))[by], axis=0)
        ).max(axis=0)
        # second derivatives of a spline through samples 5 ms apart round at 1e-16 of 14 m over the
        # square of that, 6e-11
        assert (np.abs(last[of] - first[of] - gone) <= 0.8 * cell * (change + 1e-9)).all()


@pytest.mark.parametrize(
    ("reference", "begin", "end", "_"),
    [*RESTING.values(), CUT_SHORT],
    ids=[*RESTING, "motion cut short"],
)
def test_a_reference_rests_before_it_begins_and_after_its_end(
    reference: Reference, begin: float, end: float, _: float
) -> None:
    for edge, further in ((begin, -1.0), (end, 1.0)):
        there = reference(edge + 1e-3 * further).position
        for t in edge + further * np.array([1e-3, 0.5, 100.0]):
            setpoint = reference(float(t))
            # Sums up to 14 m.
            np.testing.assert_allclose(setpoint.position, there, rtol=0.0, atol=1e-13)
            np.testing.assert_allclose([setpoint.velocity, setpoint.acceleration], 0.0, atol=1e-15)


def test_hold_does_not_follow_the_state_it_was_made_from() -> None:
    state = State(np.array([0.0, 5.0, 0.0, 0.0, 15.0]), np.zeros(5))
    reference = hold(CRANE, state)
    state.q[:] = 0.0
    assert reference(1.0).position.tolist() == [0.0, 5.0, 15.0]


@pytest.mark.parametrize(
    ("t", "x"), [(0.0, 12.0), (1.999, 12.0), (2.0, 13.0), (4.499, 13.0), (4.5, 12.0), (100.0, 12.0)]
)
def test_a_pulse_steps_aside_at_its_start_and_back_at_its_end(t: float, x: float) -> None:
    setpoint = pulse(CRANE, BASE, "x", 1.0, at=2.0, width=2.5)(t)
    assert setpoint.position.tolist() == [0.5, x, 9.0]
    assert not setpoint.velocity.any()


@pytest.mark.parametrize(("drive", "i"), [("gamma", 0), ("x", 1), ("l", 2)])
def test_pulse_and_ramp_move_the_drive_that_is_named_and_no_other(drive: str, i: int) -> None:
    for reference in (
        pulse(CRANE, BASE, drive, -0.25, at=1.0, width=1.0),
        ramp(CRANE, BASE, drive, -0.25, rate=1.0, at=1.0),
    ):
        moved = reference(1.999).position - PLACE
        assert moved[i] == pytest.approx(-0.25, abs=1e-12)
        assert np.delete(moved, i).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("t", "l", "rate"),
    [
        (0.0, 9.0, 0.0),
        (29.9, 9.0, 0.0),
        (30.0, 9.0, -0.5),
        (32.0, 8.0, -0.5),
        (33.9, 7.05, -0.5),
        (34.0, 7.0, 0.0),
        (99.0, 7.0, 0.0),
    ],
)
def test_a_ramp_moves_at_its_rate_from_its_start_until_it_is_there(
    t: float,
    l: float,  # noqa: E741
    rate: float,
) -> None:
    setpoint = ramp(CRANE, BASE, "l", -2.0, rate=0.5, at=30.0)(t)
    assert setpoint.position[2] == pytest.approx(l, abs=1e-12)
    assert setpoint.velocity.tolist() == [0.0, 0.0, rate]
    assert not setpoint.acceleration.any()


def test_references_add_up() -> None:
    first = ramp(CRANE, BASE, "x", 2.0, rate=1.0, at=0.0)
    second = ramp(CRANE, first, "x", 1.0, rate=1.0, at=1.0)
    both = pulse(CRANE, second, "gamma", 0.1, at=0.0, width=9.0)
    assert both(1.5).position.tolist() == pytest.approx([0.6, 14.0, 9.0], abs=1e-12)
    assert both(1.5).velocity.tolist() == [0.0, 2.0, 0.0]


def test_a_ramp_of_no_length_does_nothing() -> None:
    reference = ramp(CRANE, BASE, "x", 0.0, rate=1.0, at=1.0)
    assert [reference(t).position.tolist() for t in (0.0, 1.0, 2.0)] == [PLACE] * 3
    assert not reference(1.0).velocity.any()


def test_the_rates_of_a_crane_narrow_the_limits_of_a_plan() -> None:
    slow = load_crane(trolley_velocity=0.5)
    kept = Limits((0.1, 1.5, 1.0), (0.02, 0.4, 0.4)).for_crane(slow)
    assert (kept.rates, kept.accelerations) == ((0.1, 0.5, 1.0), (0.02, 0.4, 0.4))
    start = slow.state(x=8.0)
    goal = slow.state(x=18.0)
    duration = fastest(slow, lambda t: flat(slow, start, goal, t), Limits((1, 9, 9), (9, 9, 9)))
    assert np.abs(flat(slow, start, goal, duration).v[:, 1]).max() == pytest.approx(0.5, rel=1e-3)
    (section,) = shortest(
        slow, start, [goal.q[slow.layout.drives]], rates=(1, 9, 9), accelerations=(9, 9, 9)
    )
    assert section == pytest.approx(PEAK_RATE * 10.0 / 0.5)
    with pytest.raises(OutOfRange, match=r"rate of a pulse of x is 0\.6 rad/s or m/s; .* 0\.5"):
        joystick(slow, start, [JoystickPulse("x", 0.6, 0.0, 1.0)], accelerations=(1, 1, 1))


def test_a_shaped_reference_leaves_what_its_base_answers_as_it_is() -> None:
    still = hold(CRANE, CRANE.state(x=10.0, l=15.0))
    shaped_one = shaped_hoisting(CRANE, still, zv(), 5.0)
    before = still.at(np.array([1.0])).position.copy()
    # Nobody moves; rounding of a sum of parts and of a spline.
    np.testing.assert_allclose(shaped_one.at(np.array([1.0])).position, before, rtol=1e-14)
    assert np.array_equal(still.at(np.array([1.0])).position, before)
