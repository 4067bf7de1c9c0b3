"""Proofs: what they say is free is free, what they do not is not, and sampling would not have
done.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.lifts.planning import certificate, curve, motion_proof
from cranedyn.lifts.planning import lift as planned
from cranedyn.lifts.planning.certificate import certify
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.curve import Path, rounded_path
from cranedyn.lifts.planning.lift import plan_lift
from cranedyn.lifts.planning.motion_proof import (
    PROOF_MARGIN,
    DriveCurve,
    Line,
    slew_range,
    unproven_parameter,
    unproven_row,
)
from cranedyn.lifts.planning.path_search import best_on_grid
from cranedyn.lifts.planning.solids import box
from cranedyn.lifts.planning.timing import STEP, motion_of_load
from cranedyn.references.flat import smoothstep
from tests.lifts.planning.sites import (
    LIMITS,
    RATES,
    WALL,
    clearance,
    corners,
    crane,
    load_corners,
    site,
)

PLATE = box("plate", (13.4, 0.0), (6.0, 0.02, 20.0), 0.0)
"""Two centimetres thick, across the arc at 13.4 m that is the straight way of the drives."""


def sampled(asked: Clearance, line: DriveCurve, first: float, last: float) -> float | None:
    """What a library does if one does not say otherwise: look at places a hundredth of the way
    apart, each without its envelope.
    """
    for s in np.linspace(first, last, 8):
        if asked.margin(asked.q(line.at(s))) <= 0.01 - asked.site.distance:
            return float(s)
    return None


@given(st.integers(0, 10_000))
def test_what_is_proven_is_free_wherever_one_looks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    asked = clearance(WALL)
    one, other = (
        np.array([rng.uniform(0.2, 2.8), rng.uniform(5, 21), rng.uniform(5, 23)]) for _ in range(2)
    )
    where = unproven_parameter(asked, Line(one, other), 0.0, 1.0)
    rooms = [asked.swing_margin(one + s * (other - one)) for s in np.linspace(0.0, 1.0, 60)]
    if where is None:
        assert min(rooms) > 0.0
    else:
        assert asked.swing_margin(one + where * (other - one)) < PROOF_MARGIN


def test_a_plate_between_two_samples_is_met_by_proof_and_missed_by_sampling() -> None:
    asked = clearance_of(
        crane(), site(PLATE, load=corners(0.3, 0.3, 0.3), distance=0.05, swing=1e-4)
    )
    line = Line(*(asked.place(np.array([6.0, y, 8.0])) for y in (-12.0, 12.0)))
    assert sampled(asked, line, 0.0, 1.0) is None
    where = unproven_parameter(asked, line, 0.0, 1.0)
    assert where == pytest.approx(0.5, abs=0.03)


@pytest.mark.slow
def test_a_sampling_validator_in_the_place_of_the_proving_one_gets_no_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = site(
        PLATE,
        start=np.array([6.0, -12.0, 8.0]),
        goal=np.array([6.0, 12.0, 8.0]),
        load=corners(0.3, 0.3, 0.3),
        distance=0.05,
        swing=0.03,
    )
    assert certify(plan_lift(here, LIMITS, crane=crane())).holds
    for module in (motion_proof, curve):
        monkeypatch.setattr(module, "unproven_parameter", sampled)
    monkeypatch.setattr(planned, "unproven_row", lambda *_, **__: None)
    wrong = certify(plan_lift(here, LIMITS, crane=crane()))
    assert not wrong.holds
    assert wrong.nearest.obstacle == "plate"
    assert "not proven at t =" in wrong.checks[0].sentence


@given(st.integers(0, 1000), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_rounded_path_stays_within_the_reach_that_proofs_count_on(
    seed: int, a: float, b: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(0, 2, 4), rng.uniform(5, 20, 4), rng.uniform(5, 20, 4)])
    legs = (np.abs(np.diff(points, axis=0)) / RATES).max(axis=1)
    path = Path(points, RATES, 0.49 * np.minimum(legs[1:], legs[:-1]))
    low, high = sorted((a * path.duration, b * path.duration))
    off = np.abs(path.at(low + share * (high - low)) - path.at((low + high) / 2.0))
    assert (off <= path.reach(low, high) + 1e-9).all()


def test_before_a_corner_a_path_already_reaches_the_next_way_and_after_it_still_the_last() -> None:
    points = np.array([[0.0, 10.0, 15.0], [1.0, 10.0, 15.0], [1.0, 20.0, 15.0]])
    path = Path(points, RATES, np.array([2.0]))
    for begins, drive in ((-1.9, 1), (0.1, 0)):  # the trolley does not move yet, the slew no more
        low = path.knots[1] + begins
        off = np.abs(path.at(low + 1.8) - path.at(low + 0.9))
        assert 0.0 < off[drive] <= path.reach(low, low + 1.8)[drive]


def test_derivatives_of_a_path_are_those_of_its_places() -> None:
    points = np.array([[0.0, 10.0, 20.0], [0.5, 15.0, 12.0], [1.0, 8.0, 14.0]])
    path = Path(points, RATES, np.array([2.0]))
    s = np.linspace(0.1, path.duration - 0.1, 50)
    h = 1e-5
    _, first, second = path.derivatives(s)
    before = path.derivatives(s - h)
    after = path.derivatives(s + h)
    np.testing.assert_allclose(first, (after[0] - before[0]) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(second, (after[1] - before[1]) / (2 * h), atol=1e-5)
    ends, _, _ = path.derivatives(np.array([0.0, path.duration]))
    np.testing.assert_allclose(ends, points[[0, -1]], atol=1e-12)


def test_a_motion_is_proven_with_the_load_turned_by_the_jib_not_by_its_own_azimuth() -> None:
    """A load of 20 m, four metres from the mast: where the slew speeds up, the jib is ahead of it.

    The post stands before the corner that is farthest from where the load would be if it hung plumb
    in its place; until then no load in its place comes near to it.
    """
    asked = clearance_of(crane(), site(load=corners(20.0, 0.4, 1.0)))
    share = smoothstep(np.linspace(0.0, 1.0, round(14.2 / STEP)))
    places = np.column_stack([1.6 * share, np.full_like(share, 4.2), np.full_like(share, 25.0)])
    motion = motion_of_load(asked, places, STEP)
    assert asked.tilt(motion.q).max() <= asked.site.swing

    moved, planned = (
        np.array([load_corners(asked, q) for q in rows])
        for rows in (motion.q[:350], map(asked.q, places[:350]))
    )
    off = moved - planned
    row, which = np.unravel_index(np.argmax(np.linalg.norm(off, axis=2)), off.shape[:2])
    apart = off[row, which]
    assert np.linalg.norm(apart) > asked.envelope(25.0)
    at = moved[row, which] + 0.45 * apart / np.linalg.norm(apart)
    solid = box("post", (float(at[0]), float(at[1])), (0.1, 0.1, 6.0), 0.0)
    post = clearance_of(crane(), replace(asked.site, solids=(solid,)))
    so_far = motion.q[: row + 1]
    assert min(post.swing_margin(place) for place in places[: row + 1]) > PROOF_MARGIN
    assert min(post.margin(q) for q in so_far) < 0.0
    envelope = post.envelope(so_far[:, post.joints.hoist])
    assert unproven_row(post, so_far, STEP, envelope=envelope) is not None


def test_a_motion_that_rests_and_then_enters_a_wall_is_not_proven() -> None:
    """Its middle row lies before the way, so that the longer half of it is behind."""
    asked = clearance(WALL)
    rest, within = (asked.q(np.array([gamma, 13.4, 24.0])) for gamma in (1.2, 1.5))
    q = np.array([rest, rest, rest, rest, within])
    assert asked.margin(rest) > 0.0 > asked.margin(within)
    assert unproven_row(asked, q, 5e-3) == 3
    assert unproven_row(asked, q[:4], 5e-3) is None


@pytest.mark.parametrize(("room", "row"), [(0.039, 0), (0.041, None)])
def test_between_two_rows_alike_a_load_may_have_been_thrown_as_far_as_it_can(
    room: float, row: int | None
) -> None:
    """By 32 m/s² in a tenth of a second, there and back: 4 cm."""
    asked = clearance()
    high = asked.q(np.array([0.0, 12.0, 20.0]))
    q = asked.q(np.array([0.0, 12.0, 20.0 + asked.margin(high) - room]))
    assert asked.margin(q) == pytest.approx(room, abs=1e-9)  # above the ground
    assert unproven_row(asked, np.array([q, q]), 0.1) == row


def test_rounding_a_corner_over_a_wall_is_proven_and_sharper_where_there_is_less_room() -> None:
    asked = clearance(WALL)
    ends = [asked.place(np.array([10.0, y, 4.0])) for y in (-10.0, 10.0)]
    widths = []
    for over in (16.0, 12.0):
        corner = asked.place(np.array([10.0, 0.01, over]))
        path = rounded_path(asked, np.array([ends[0], corner, ends[1]]), RATES)
        if path is not None:
            assert unproven_parameter(asked, path, 0.0, path.duration) is None or over == 12.0
            widths.append(float(path.widths[0]))
    assert widths == sorted(widths, reverse=True)


def test_the_jib_is_stopped_by_a_tower_at_the_angle_that_its_tip_has_there() -> None:
    """The jib reaches to 23.5 m and stands 2.8 to 4 m below the top of a tower whose edge is at y =
    -10 m.
    """
    tower = box("tower", (25.0, 0.0), (12.0, 20.0, 40.0), 0.0)
    asked = clearance_of(crane(), site(tower))
    found = slew_range(asked, 0.0, -math.pi / 2.0, 3.0)
    assert found.above == "tower"
    assert found.below == ""
    # the tower's corner (19, -10) is 21.47 m from the axis, less than the jib is long, at
    # atan(19/10) = 1.087 rad
    assert 1.087 - (0.5 + 1.0 + 0.2) / 21.47 < found.high < 1.087 - 0.5 / 21.47
    assert asked.slewing_margin(found.high + 0.01) < asked.slewing_margin(found.high - 0.2)


@pytest.mark.slow
def test_a_grid_finds_the_way_through_the_only_gap_and_says_when_there_is_none() -> None:
    gap = clearance(
        box("left", (4.0, 0.0), (6.0, 1.0, 30.0), 0.0),
        box("right", (19.0, 0.0), (8.0, 1.0, 30.0), 0.0),
    )
    ends = np.array([gap.place(np.array([11.0, y, 6.0])) for y in (-10.0, 10.0)])
    bounds = np.array([[ends[0, 0] - 0.5, 2.0, 3.4], [ends[1, 0] + 0.5, 22.0, 26.4]])
    found = best_on_grid(gap, ends, bounds, RATES, cell=1.5)
    assert found.points is not None
    at_wall = found.points[np.argmin(np.abs(gap.point(found.points)[:, 1]))]
    assert 8.0 < gap.point(at_wall)[0] < 14.0
    assert all(
        unproven_parameter(gap, Line(one, other), 0.0, 1.0) is None
        for one, other in zip(found.points, found.points[1:], strict=False)
    )
    shut = clearance(box("all", (12.0, 0.0), (24.0, 1.0, 30.0), 0.0))
    none = best_on_grid(shut, ends, bounds, RATES, cell=2.0)
    assert (none.points, none.duration, none.blocked) == (None, math.inf, ["all"])


@pytest.mark.parametrize("slew", [0.0, 0.4])
def test_a_jib_that_stands_too_near_to_something_is_no_free_slewing(slew: float) -> None:
    """At zero slew the jib points along -Y of the crane, over the wall."""
    free = clearance()
    angles = np.array([0.0, slew])
    assert certificate._slewing_check(free, angles).holds
    beam = box("beam", (0.0, -12.0), (1.0, 1.0, 60.0), 0.0)
    checked = certificate._slewing_check(clearance(beam), angles)
    assert checked.holds is False
    assert "too near to beam" in checked.sentence


def test_what_stops_the_jib_is_named_also_where_a_load_at_the_mast_would_be_nearer_to_it() -> None:
    beside_mast = box("house", (2.3, -2.0), (2.0, 1.0, 30.0), 0.0)
    found = slew_range(
        clearance_of(crane(), site(beside_mast, load=corners(6.0, 6.0, 1.0))), 0, -3, 3
    )
    assert found.below == "house"
