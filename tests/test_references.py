"""Where the drives should be: hold, pulse, ramp, and what they refuse."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.crane import State
from cranedyn.errors import OutOfRange, UnknownName
from cranedyn.references import Leg, Push, Reference, ei, hold, itinerary, operator, plumb, pulse, ramp, shaped, shaped_hoisting, spline, zv
from cranedyn.references.tour import tour
from cranedyn.references.wanted import tabulated
from tests.helpers import G, crane

START = State(np.array([0.5, 12.0, 0.0, 0.0, 9.0]), np.zeros(5))
BASE = hold(START)
PLACE = [0.5, 12.0, 9.0]


QUINTIC = spline(START, [(0.0, 14.0, 7.0)], [3.0], at=1.0)
PUSHES = operator(START, [Push("x", 0.5, 1.0, 3.0), Push("l", -0.8, 2.0, 0.01)], accelerations=(0.02, 0.4, 0.4))
LEGS = tour(crane(), [Leg("out", x=12.0), Leg("in", x=10.0)], lambda a, b: plumb(spline(a, [b.q[[0, 1, 4]]], [2.0]), 2.0), dwell=0.5)


@pytest.mark.parametrize(
    "reference",
    [
        BASE,
        pulse(BASE, "x", -0.3, at=1.0, width=2.0),
        ramp(pulse(QUINTIC, "x", -0.3, at=1.0, width=2.0), "l", -1.0, rate=0.5, at=2.0),
        ramp(lambda t: BASE(t), "gamma", 0.1, rate=0.1, at=1.0),
        QUINTIC,
        plumb(QUINTIC, 5.0),
        PUSHES,
        operator(START, [], accelerations=(0.02, 0.4, 0.4)),
        shaped(PUSHES, ei(), 1.3),
        shaped_hoisting(PUSHES, zv(), G, 5.0),
        LEGS,
        itinerary(START, [Leg("out and up", x=13.0, l=8.0), Leg("back", x=12.0, l=9.0)], rates=(0.1, 0.5, 0.4), dwell=0.3),
    ],
    ids=[
        "hold",
        "pulse",
        "ramp",
        "ramp on a function",
        "spline",
        "motion",
        "operator",
        "nobody",
        "shaped",
        "shaped hoisting",
        "tour",
        "itinerary",
    ],
)
def test_many_times_at_once_are_wanted_as_each_by_itself(reference: Reference) -> None:
    times = np.arange(-0.5, 9.0, 0.005)
    single = [reference(t) for t in times.tolist()]
    for i, column in enumerate(tabulated(reference, times)):
        # sums of ten terms up to 14 m in another order round at 1e-15 of them
        np.testing.assert_allclose(column, [wanted[i] for wanted in single], rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("t", [0.0, 3.0, 1e6])
def test_hold_stays_where_the_drives_are(t: float) -> None:
    wanted = BASE(t)
    assert [part.tolist() for part in wanted] == [PLACE, [0.0] * 3, [0.0] * 3]


def test_hold_does_not_follow_the_state_it_was_made_from() -> None:
    state = State(np.array([0.0, 5.0, 0.0, 0.0, 15.0]), np.zeros(5))
    reference = hold(state)
    state.q[:] = 0.0
    assert reference(1.0).position.tolist() == [0.0, 5.0, 15.0]


@pytest.mark.parametrize(("t", "x"), [(0.0, 12.0), (1.999, 12.0), (2.0, 13.0), (4.499, 13.0), (4.5, 12.0), (100.0, 12.0)])
def test_a_pulse_steps_aside_at_its_start_and_back_at_its_end(t: float, x: float) -> None:
    wanted = pulse(BASE, "x", 1.0, at=2.0, width=2.5)(t)
    assert wanted.position.tolist() == [0.5, x, 9.0]
    assert not wanted.velocity.any()


@pytest.mark.parametrize(("drive", "i"), [("gamma", 0), ("x", 1), ("l", 2)])
def test_pulse_and_ramp_move_the_drive_that_is_named_and_no_other(drive: str, i: int) -> None:
    for reference in (pulse(BASE, drive, -0.25, at=1.0, width=1.0), ramp(BASE, drive, -0.25, rate=1.0, at=1.0)):
        moved = reference(1.999).position - PLACE
        assert moved[i] == pytest.approx(-0.25, abs=1e-12)
        assert np.delete(moved, i).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("t", "l", "rate"),
    [(0.0, 9.0, 0.0), (29.9, 9.0, 0.0), (30.0, 9.0, -0.5), (32.0, 8.0, -0.5), (33.9, 7.05, -0.5), (34.0, 7.0, 0.0), (99.0, 7.0, 0.0)],
)
def test_a_ramp_moves_at_its_rate_from_its_start_until_it_is_there(t: float, l: float, rate: float) -> None:  # noqa: E741
    wanted = ramp(BASE, "l", -2.0, rate=0.5, at=30.0)(t)
    assert wanted.position[2] == pytest.approx(l, abs=1e-12)
    assert wanted.velocity.tolist() == [0.0, 0.0, rate]
    assert not wanted.acceleration.any()


@given(st.floats(-5, 5), st.floats(0.1, 2), st.floats(0, 10), st.floats(0, 30))
def test_a_ramp_is_the_integral_of_its_velocity(by: float, rate: float, at: float, t: float) -> None:
    reference, h = ramp(BASE, "x", by, rate=rate, at=at), 1e-7
    if min(abs(t - at), abs(t - at - abs(by) / rate)) > 2 * h:  # not over a corner
        slope = (reference(t + h).position[1] - reference(t - h).position[1]) / (2 * h)
        assert slope == pytest.approx(reference(t).velocity[1], abs=1e-6)  # rounding 1e-15/1e-7


def test_references_add_up() -> None:
    both = pulse(ramp(ramp(BASE, "x", 2.0, rate=1.0, at=0.0), "x", 1.0, rate=1.0, at=1.0), "gamma", 0.1, at=0.0, width=9.0)
    assert both(1.5).position.tolist() == pytest.approx([0.6, 14.0, 9.0], abs=1e-12)
    assert both(1.5).velocity.tolist() == [0.0, 2.0, 0.0]


def test_a_ramp_of_no_length_does_nothing() -> None:
    reference = ramp(BASE, "x", 0.0, rate=1.0, at=1.0)
    assert [reference(t).position.tolist() for t in (0.0, 1.0, 2.0)] == [PLACE] * 3
    assert not reference(1.0).velocity.any()


def _pulse(**changes: Any) -> Reference:
    return pulse(BASE, **{"drive": "x", "amplitude": 1.0, "at": 1.0, "width": 1.0, **changes})


def _ramp(**changes: Any) -> Reference:
    return ramp(BASE, **{"drive": "x", "by": 1.0, "at": 1.0, "rate": 1.0, **changes})


@pytest.mark.parametrize("make", [_pulse, _ramp])
@pytest.mark.parametrize("drive", ["phi", "theta", "y"])
def test_passive_joints_cannot_be_asked_for(make: Any, drive: str) -> None:
    with pytest.raises(UnknownName, match=f"no drive '{drive}'; there are gamma, x, l"):
        make(drive=drive)


@pytest.mark.parametrize(
    ("make", "changes", "sentence"),
    [
        (_pulse, {"amplitude": math.nan}, "pulse amplitude is nan; allowed is a finite number"),
        (_pulse, {"at": math.inf}, "pulse start is inf s; allowed is a finite number"),
        (_pulse, {"width": 0.0}, "pulse width is 0.0 s; allowed is > 0"),
        (_ramp, {"by": math.nan}, "ramp distance is nan; allowed is a finite number"),
        (_ramp, {"at": math.nan}, "ramp start is nan s; allowed is a finite number"),
        (_ramp, {"rate": 0.0}, "ramp rate is 0.0 .*; allowed is > 0"),
        (_ramp, {"rate": -1.0}, "ramp rate is -1.0 .*; allowed is > 0"),
    ],
)
def test_numbers_that_make_no_move_are_refused(make: Any, changes: dict[str, float], sentence: str) -> None:
    with pytest.raises(OutOfRange, match=sentence):
        make(**changes)
