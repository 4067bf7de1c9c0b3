"""The supervisor of a site: what it takes for a request, and what it then grants."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import OutOfRange
from cranedyn.lifts.sites.guard import BoxGrant, BoxRequest, Guard
from cranedyn.lifts.sites.supervisor import Supervisor
from tests.lifts.sites.cases import BAD, ODD, at_rest, site_of

pytestmark = pytest.mark.slow


def supervisor_of(copies: int = 1) -> Supervisor:
    site = site_of()
    return Supervisor(site, [Guard(x, site.swing, copies).box for x in site.stations])


def honest(supervisor: Supervisor, number: int = 1) -> BoxRequest:
    """Return a request of the first crane that is granted as a whole."""
    held = supervisor.boxes[0][:1].copy()
    wanted = held + np.array([[-0.01, -0.5, -0.5], [0.01, 0.5, 0.5]])
    return BoxRequest(np.array([0]), np.array([number]), held, wanted)


def assert_is_ignored(supervisor: Supervisor, request: BoxRequest) -> None:
    """Check that a request changes nothing that is reserved, for any crane."""
    before = [box.copy() for box in supervisor.boxes]
    grant = supervisor.receive(0, request)
    assert not len(grant.copies)
    assert not len(grant.box)
    for box, old in zip(supervisor.boxes, before, strict=True):
        assert (box == old).all()
    # The other crane gets its range no more than it did before.
    everything = site_of().stations[1].ranges[None]
    theirs = BoxRequest(np.array([0]), np.array([1]), supervisor.boxes[1].copy(), everything)
    given_box = supervisor.receive(1, theirs).box
    assert not (given_box == everything).all()
    assert site_of().pair_apart(0, supervisor.boxes[0], 1, given_box).all()


def test_an_honest_request_is_granted_as_a_whole() -> None:
    supervisor = supervisor_of()
    request = honest(supervisor)
    grant = supervisor.receive(0, request)
    assert (grant.box == request.wanted).all()
    assert (supervisor.boxes[0] == request.wanted).all()


@pytest.mark.parametrize("field", ["held", "wanted"])
@pytest.mark.parametrize("value", BAD)
def test_a_request_with_a_number_that_is_none_is_ignored(value: float, field: str) -> None:
    for end, drive in np.ndindex(2, 3):
        supervisor = supervisor_of()
        request = honest(supervisor)
        getattr(request, field)[0, end, drive] = value
        assert_is_ignored(supervisor, request)


@given(
    held=st.lists(st.floats(), min_size=6, max_size=6),
    wanted=st.lists(st.floats(), min_size=6, max_size=6),
)
def test_boxes_of_any_doubles_leave_what_is_reserved_proven_apart(
    held: list[float], wanted: list[float]
) -> None:
    supervisor = supervisor_of()
    boxes = [np.reshape(values, (1, 2, 3)) for values in (held, wanted)]
    supervisor.receive(0, BoxRequest(np.array([0]), np.array([1]), *boxes))
    assert site_of().pair_apart(0, supervisor.boxes[0], 1, supervisor.boxes[1]).all()


@pytest.mark.parametrize("value", [*BAD, -1.0, 1.0, 0.5, 1e15])
def test_a_request_of_a_copy_that_there_is_not_is_ignored(value: float) -> None:
    supervisor = supervisor_of()
    assert_is_ignored(supervisor, honest(supervisor)._replace(copies=np.array([value])))


@pytest.mark.parametrize("value", [*BAD, *ODD, 0.0, -1.0, 1.5, 2.0**54])
def test_a_request_whose_number_is_none_is_ignored(value: float) -> None:
    supervisor = supervisor_of()
    assert_is_ignored(supervisor, honest(supervisor)._replace(number=np.array([value])))


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("drive", [0, 1, 2])
def test_a_held_box_may_leave_the_reserved_one_on_neither_side(end: int, drive: int) -> None:
    supervisor = supervisor_of()
    request = honest(supervisor)
    request.held[0, end, drive] += (-1e-6, 1e-6)[end]
    assert_is_ignored(supervisor, request)


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("drive", [0, 1, 2])
def test_a_wanted_box_contains_the_held_one_on_both_sides(end: int, drive: int) -> None:
    supervisor = supervisor_of()
    request = honest(supervisor)
    request.wanted[0, end, drive] = request.held[0, end, drive] + (1e-6, -1e-6)[end]
    assert_is_ignored(supervisor, request)


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("drive", [0, 1, 2])
def test_a_wanted_box_lies_in_the_ranges_of_the_drives(end: int, drive: int) -> None:
    supervisor = supervisor_of()
    station = site_of().stations[0]
    request = honest(supervisor)
    limit = station.ranges[end, drive] + (-1.0, 1.0)[end] * station.brakes.tolerances[drive]
    request.wanted[0, end, drive] = limit + (-1e-6, 1e-6)[end]
    assert_is_ignored(supervisor, request)


@pytest.mark.parametrize("kind", ["zeros", "swapped", "swapped and held"])
def test_a_request_whose_boxes_are_none_is_ignored(kind: str) -> None:
    supervisor = supervisor_of()
    request = honest(supervisor)
    if kind == "zeros":
        request = request._replace(wanted=0.0 * request.wanted)
    elif kind == "swapped":
        request = request._replace(wanted=request.wanted[:, ::-1])
    else:
        request = request._replace(held=request.held[:, ::-1], wanted=request.wanted[:, ::-1])
    assert_is_ignored(supervisor, request)


def test_a_box_whose_ends_are_swapped_inside_of_the_reserved_one_is_no_held_box() -> None:
    supervisor = supervisor_of()
    request = honest(supervisor)
    middle = request.held.mean(axis=1)
    request.held[0, 0] = middle + 1e-4
    request.held[0, 1] = middle - 1e-4
    assert_is_ignored(supervisor, request)


def test_of_two_rows_of_a_message_for_one_copy_the_first_counts() -> None:
    supervisor = supervisor_of(2)
    one = honest(supervisor)
    wider = one.wanted + np.array([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    copies = np.array([1, 1])
    number = np.array([1, 2])
    held = np.concatenate([one.held] * 2)
    wanted = np.concatenate([one.wanted, wider])
    grant = supervisor.receive(0, BoxRequest(copies, number, held, wanted))
    assert grant.copies.tolist() == [1]
    assert grant.number.tolist() == [1]
    assert (supervisor.boxes[0][1] == grant.box[0]).all()
    assert (grant.box == one.wanted).all()
    assert (supervisor.boxes[0][0] == one.held).all()


def test_there_is_no_crane_of_another_index() -> None:
    supervisor = supervisor_of()
    for station in (-1, 2, 0.5, math.nan):
        with pytest.raises(OutOfRange, match="index of a crane"):
            supervisor.receive(station, honest(supervisor))  # type: ignore[arg-type]


def test_an_honest_crane_stays_guarded_by_a_supervisor_that_grants_anything() -> None:
    site = site_of()
    rng = np.random.default_rng(4)
    station = site.stations[0]
    guard = Guard(station, site.swing)
    state = at_rest(station)
    drives = station.crane.layout.drives
    supervisor = Supervisor(site, [Guard(x, site.swing).box for x in site.stations])
    for k in range(300):
        command = rng.integers(-1, 2, (1, 3)) * station.converters.rates
        rates, request = guard.step(0.1 * k, state, command)
        state.q[:, drives] += 0.1 * rates
        state.v[:, drives] = rates
        if not len(request.copies):
            continue
        forged = rng.choice([*BAD, *ODD, -9.0, 9.0, 40.0], (1, 2, 3))
        target = rng.choice([*BAD, 99.0], (1, 3))
        grant = supervisor.receive(0, request)
        assert len(grant.copies) == 1
        guard.receive(BoxGrant(request.copies, request.number, forged, grant.blocked_by, target))
        assert (guard.box >= supervisor.boxes[0][:, :1]).all()
        assert (guard.box <= supervisor.boxes[0][:, 1:]).all()
        guard.receive(grant)
    assert np.ptp(guard.box) > 0.0
    assert np.isfinite(guard.box).all()
