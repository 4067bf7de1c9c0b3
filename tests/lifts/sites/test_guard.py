"""The guard of a crane: what it lets pass, and what it takes for a message."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.guard import MAX_INPUT, NO_TARGET, BoxGrant, BoxRequest, Guard
from cranedyn.lifts.sites.working_wind import WorkingWind
from tests.helpers import pickled
from tests.lifts.sites.cases import BAD, ODD, at_rest, site_of, travelling_station

pytestmark = pytest.mark.slow

SWING = 0.1
GUST = WorkingWind(gust=9.0, area=4.0)


def guard_of(wind: WorkingWind | None = None) -> Guard:
    station = site_of().stations[0]
    return Guard(station, SWING) if wind is None else Guard(station, SWING, 1, wind)


def asked(guard: Guard, t: float = 0.0) -> BoxRequest:
    """Return the request of a guard that is commanded to go at full rates."""
    full = guard.station.converters.rates
    _, request = guard.step(t, at_rest(guard.station), full[None])
    assert len(request.copies) == 1
    return request


def answer(request: BoxRequest, **changes: np.ndarray) -> BoxGrant:
    """Return the grant of all that a request asks for, with some fields changed."""
    drives = request.wanted.shape[2]
    grant = BoxGrant(
        copies=request.copies,
        number=request.number,
        box=request.wanted.copy(),
        blocked_by=np.zeros((1, 2), dtype=bool),
        target=np.full((1, drives), NO_TARGET),
    )
    return grant._replace(**changes)


def box_after(guard: Guard, grant: BoxGrant) -> np.ndarray:
    """Return the box of a guard that has received a grant, after a step without a request."""
    guard.receive(grant)
    guard.step(math.nan, at_rest(guard.station), np.zeros((1, 3)))
    return guard.box


def test_a_grant_of_all_that_was_asked_for_is_taken() -> None:
    guard = guard_of()
    request = asked(guard)
    assert (box_after(guard, answer(request)) == request.wanted).all()


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize(("end", "drive"), [*np.ndindex(2, 3)])
def test_a_grant_with_a_number_that_is_none_is_ignored_and_the_next_is_taken(
    value: float, end: int, drive: int
) -> None:
    guard = guard_of()
    request = asked(guard)
    box = request.wanted.copy()
    box[0, end, drive] = value
    held = guard.box.copy()
    assert (box_after(guard, answer(request, box=box)) == held).all()
    target = np.full((1, 3), NO_TARGET)
    target[0, drive] = value if value < math.inf else 0.0
    assert (box_after(guard, answer(request, target=target)) == held).all()
    assert (guard.target == NO_TARGET).all()
    assert (box_after(guard, answer(request)) == request.wanted).all()


@pytest.mark.parametrize("value", [*BAD, -1.0, 1.0, 0.5, 7.0])
def test_a_grant_for_a_copy_or_a_request_that_there_is_not_is_ignored(value: float) -> None:
    guard = guard_of()
    request = asked(guard)
    held = guard.box.copy()
    assert (box_after(guard, answer(request, copies=np.array([value]))) == held).all()
    if value != 1.0:
        assert (box_after(guard, answer(request, number=np.array([value]))) == held).all()


def test_a_grant_that_answers_an_older_request_is_ignored_though_its_box_would_do() -> None:
    guard = guard_of()
    asked(guard, 0.0)
    second = asked(guard, 1.0)
    held = guard.box.copy()
    late = answer(second, number=np.array([1]))
    assert (box_after(guard, late) == held).all()
    # The guard waits twice as long for answers from then on: 1 s.
    full = guard.station.converters.rates[None]
    assert not len(guard.step(1.9, at_rest(guard.station), full)[1].copies)
    assert guard.step(2.0, at_rest(guard.station), full)[1].number == [3]


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("way", ["beyond what was asked for", "short of what is held", "swapped"])
def test_a_grant_that_no_sound_supervisor_gives_is_ignored(end: int, way: str) -> None:
    guard = guard_of()
    request = asked(guard)
    outward = np.array([-1e-3, 1e-3])[end]
    box = request.wanted.copy()
    if way == "swapped":
        box = box[:, ::-1]
    elif way == "short of what is held":
        box[0, end] = request.held[0, end] - outward
    else:
        box[0, end, 1] += outward
    held = guard.box.copy()
    assert (box_after(guard, answer(request, box=box)) == held).all()


def test_a_crane_withdraws_to_no_place_out_of_its_ranges() -> None:
    guard = guard_of()
    request = asked(guard)
    lowest, highest = guard.station.ranges
    for target in (lowest - 1.0, highest + 1.0):
        guard.receive(answer(request, target=target[None]))
        assert (guard.target == NO_TARGET).all()
    guard.receive(answer(request, target=lowest[None]))
    assert (guard.target == lowest).all()


def step_with(value: float, where: str, column: int) -> None:
    """Check what a guard does with a number at one place of what it measures or is commanded."""
    guard = guard_of()
    full = guard.station.converters.rates
    state = at_rest(guard.station)
    command = full[None].copy()
    inputs = {"q": state.q, "v": state.v, "command": command}[where]
    guard.rates = 0.1 * full[None]
    before = guard.box.copy()
    inputs[0, column % inputs.shape[1]] = value
    rates, request = guard.step(0.0, state, command)
    assert np.isfinite(rates).all()
    assert np.isfinite(guard.box).all()
    if not abs(value) <= MAX_INPUT:
        assert guard.fault.all()
        assert not len(request.copies)
        assert (guard.box == before).all()
        assert (np.abs(rates) < 0.1 * full).all()
        assert (rates >= 0.0).all()
    lowest, highest = guard.station.ranges
    tolerances = guard.station.brakes.tolerances
    for wanted in request.wanted:
        assert (wanted[0] >= lowest - tolerances).all()
        assert (wanted[1] <= highest + tolerances).all()


@pytest.mark.parametrize("where", ["q", "v", "command"])
def test_no_input_makes_a_guard_command_what_is_no_number(where: str) -> None:
    for value in (*BAD, *ODD):
        for column in range(5):
            step_with(value, where, column)


@given(
    value=st.floats(),
    where=st.sampled_from(["q", "v", "command"]),
    column=st.integers(0, 4),
)
def test_no_double_makes_a_guard_command_what_is_no_number(
    value: float, where: str, column: int
) -> None:
    step_with(value, where, column)


@pytest.mark.parametrize("t", [math.nan, math.inf, -math.inf])
def test_nothing_is_requested_at_a_time_that_is_none(t: float) -> None:
    guard = guard_of()
    _, request = guard.step(t, at_rest(guard.station), guard.station.converters.rates[None])
    assert not len(request.copies)
    asked(guard)


def room(
    guard: Guard,
    cable: float,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    measured: tuple[float, float, float] | None = None,
) -> float:
    """Return the amplitude of a swing [rad] up to which a guard lets a drive that stands start.

    The rope of a length [m] is plumb, and swings through there. Drives go at commanded rates, and
    at measured ones, by default the same.
    """
    station = guard.station
    crane = station.crane
    drives = crane.layout.drives
    frequency = math.sqrt(crane.gravity / cable)
    probe = 1 if rates[2] else 2
    command = np.array([rates])
    command[0, probe] = 0.3
    lowest, highest = station.ranges
    box = np.array([[np.maximum(lowest, -9.0), np.minimum(highest, 50.0)]])
    low = 0.0
    high = 1.0
    while high - low > 1e-7:
        middle = (low + high) / 2.0
        state = at_rest(station)
        state.q[0, drives[2]] = cable
        state.v[0, drives] = rates if measured is None else measured
        state.v[0, crane.swings[0]] = middle * frequency
        guard.rates = np.array([rates])
        guard.box = guard._granted = box
        passed, _ = guard.step(0.0, state, command)
        if passed[0, probe] > 0.01:
            low = middle
        else:
            high = middle
    return low


def test_a_guard_intervenes_at_95_percent_of_the_largest_swing_of_a_rope_of_its_length() -> None:
    for cable in (6.0, 24.0):
        assert room(guard_of(), cable) == pytest.approx(0.95 * SWING, rel=1e-3)


def test_a_guard_leaves_room_for_a_swing_that_grows_by_the_power_1_5_of_the_shortening() -> None:
    guard = guard_of()
    cable = 6.0
    rate = 1.1
    # The winch goes on for the reaction time, then brakes by 0.6 m/s²: 1.58 m.
    shortened = cable - rate * (guard.station.brakes.reaction + rate / (2.0 * 0.6))
    assert shortened == pytest.approx(4.42, abs=0.01)
    expected = 0.95 * SWING / (cable / shortened) ** 1.5
    assert room(guard, cable, (0.0, 0.0, -rate)) == pytest.approx(expected, rel=2e-3)


def test_a_guard_leaves_twice_the_lean_of_the_wind_to_gusts() -> None:
    # 0.5 · 1.25 kg/m³ · 4 m² · (9 m/s)² = 202.5 N on a load of 1000 kg.
    lean = 202.5 / (1000.0 * site_of().stations[0].crane.gravity)
    assert room(guard_of(GUST), 20.0) == pytest.approx(0.095 - 2.0 * lean, rel=1e-3)


def test_a_load_that_travels_against_the_wind_leaves_it_more_room() -> None:
    gravity = site_of().stations[0].crane.gravity
    speed = 0.1
    braking = speed / math.sqrt(gravity * 20.0)
    lean = 0.5 * 1.25 * 4.0 * (9.0 + speed) ** 2 / (1000.0 * gravity)
    expected = 0.095 - braking - 2.0 * lean
    assert room(guard_of(GUST), 20.0, (0.0, speed, 0.0)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("reading", [9.1, -9.1, math.nan, math.inf, 1e308])
def test_a_guard_stops_work_above_its_wind_and_goes_on_below(reading: float) -> None:
    guard = guard_of(GUST)
    full = guard.station.converters.rates
    guard.rates = 0.01 * full[None]
    before = guard.box.copy()
    rates, request = guard.step(0.0, at_rest(guard.station), full[None], reading)
    assert guard.stopped_by_wind.all()
    assert not guard.fault.any()
    assert not len(request.copies)
    assert (guard.box == before).all()
    assert (rates >= 0.0).all()
    assert (rates < 0.01 * full).all()
    _, request = guard.step(0.1, at_rest(guard.station), full[None], 8.9)
    assert not guard.stopped_by_wind.any()
    assert len(request.copies)


def test_a_guard_that_was_told_of_no_wind_stops_in_any() -> None:
    guard = guard_of()
    _, request = guard.step(0.0, at_rest(guard.station), np.ones((1, 3)), 0.1)
    assert guard.stopped_by_wind.all()
    assert not len(request.copies)
    _, request = guard.step(0.0, at_rest(guard.station), np.ones((1, 3)), 0.0)
    assert len(request.copies)


def test_wind_that_leaves_the_drives_no_swing_is_refused_with_the_name_of_the_crane() -> None:
    with pytest.raises(OutOfRange, match=r"load of north in gusts of 22 m/s is 14\.1 degrees"):
        guard_of(WorkingWind(22.0, 4.0))


def test_drives_that_push_a_pivot_in_one_direction_add_up() -> None:
    # A tower that travels and a carriage, both along the jib. Each stops at once, which adds
    # v/√(g l) to the amplitude: together twice that, and not √2 times.
    guard = Guard(travelling_station(), SWING)
    speed = 0.02
    cable = 3.0
    alone = speed / math.sqrt(guard.station.crane.gravity * cable)
    for first, second, count in ((1.0, 0.0, 1), (0.0, 1.0, 1), (1.0, 1.0, 2), (1.0, -1.0, 2)):
        rates = (first * speed, second * speed, 0.0)
        assert 0.095 - room(guard, cable, rates) == pytest.approx(count * alone, rel=1e-2)


def test_drives_at_right_angles_add_up_as_such_vectors_do() -> None:
    guard = guard_of()
    cable = 20.0
    slew = 1e-3
    trolley = 0.03
    # The box reaches to 50 m.
    together = math.hypot(50.0 * slew, trolley) / math.sqrt(guard.station.crane.gravity * cable)
    assert 0.095 - room(guard, cable, (slew, trolley, 0.0)) == pytest.approx(together, rel=2e-2)


def test_the_larger_of_measured_and_commanded_rates_counts() -> None:
    guard = guard_of()
    cable = 20.0
    speed = 0.1
    added = speed / math.sqrt(guard.station.crane.gravity * cable)
    fast = (0.0, speed, 0.0)
    slow = (0.0, 0.3 * speed, 0.0)
    for rates, measured in ((fast, slow), (slow, fast)):
        assert 0.095 - room(guard, cable, rates, measured) == pytest.approx(added, rel=1e-2)


def test_a_drive_that_stops_slowly_adds_twice_the_inclination_of_its_deceleration() -> None:
    guard = guard_of()
    planned = 0.095 / (4.0 * math.sqrt(2.0))
    assert 0.095 - room(guard, 20.0, (0.0, 1.0, 0.0)) == pytest.approx(2.0 * planned, rel=1e-3)


def test_a_guard_brakes_by_the_rates_that_the_box_was_planned_for_in_a_fault() -> None:
    guard = guard_of()
    guard.rates = np.array([[0.05, 0.5, -0.5]])
    state = at_rest(guard.station)
    broken = State(np.full_like(state.q, math.nan), state.v)
    rates, _ = guard.step(0.0, broken, np.zeros((1, 3)))
    change = guard.rates - np.array([[0.05, 0.5, -0.5]])
    assert (rates == guard.rates).all()
    # 0.095/(4 √2) of gravity at the trolley, over its 30.05 m for the slew, and all of the winch.
    inclined = 0.095 / (4.0 * math.sqrt(2.0)) * guard.station.crane.gravity
    expected = [inclined / 30.05, inclined, guard.station.brakes.decelerations[2]]
    assert np.abs(change[0]) == pytest.approx(np.multiply(expected, CYCLE), rel=1e-3)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_of_a_guard_goes_on_as_it_does_and_shares_nothing_with_it(copied: Any) -> None:
    guard = guard_of()
    request = asked(guard)
    same = copied(guard)
    guard.receive(answer(request))
    state = at_rest(guard.station)
    still = np.zeros((1, 3))
    box_without_grant = same.box.copy()
    same.step(math.nan, state, still)
    assert (same.box == box_without_grant).all()  # the grant was for the other
    same.receive(answer(request))
    for k in range(5):
        passed, _ = guard.step(1.0 + CYCLE * k, state, guard.station.converters.rates[None])
        same_passed, _ = same.step(1.0 + CYCLE * k, state, guard.station.converters.rates[None])
        assert (passed == same_passed).all()
        assert (guard.box == same.box).all()
