"""Proofs of distances of cranes from each other and from obstacles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.lifts.planning.solids import box, prism
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.distance_proof import least_distances, proven_apart
from cranedyn.lifts.sites.obstacles import Obstacles
from cranedyn.lifts.sites.placed_capsules import CraneBodies, PlacedCapsules
from tests.lifts.sites.cases import BAD, ODD, site_of

pytestmark = pytest.mark.slow


def boxes() -> list[np.ndarray]:
    """Return a box around the start of each of two cranes, which are proven apart."""
    around = np.array([[-0.01, -0.1, -0.1], [0.01, 0.1, 0.1]])
    return [x.crane.start.q[x.crane.layout.drives] + around for x in site_of().stations]


def apart(
    first: np.ndarray,
    second: np.ndarray,
    distance: float = 1.0,
    swing: float = 0.1,
    bodies: CraneBodies | None = None,
) -> bool:
    site = site_of()
    rows = np.array([0]), site.positions(0, first)[None], np.array([1])
    end = site.positions(1, second)[None]
    return bool(proven_apart(bodies or site.bodies, *rows, end, distance, swing)[0])


def test_the_cranes_are_proven_apart() -> None:
    assert apart(*boxes())


@pytest.mark.parametrize("value", BAD)
def test_no_box_with_a_number_that_is_none_is_proven_apart_from_anything(value: float) -> None:
    site = site_of()
    for crane, end, drive in np.ndindex(2, 2, 3):
        both = boxes()
        both[crane][end, drive] = value
        assert not apart(*both)
        assert not site.pair_apart(0, both[0], 1, both[1])
        assert not site.apart(crane, both[crane], both).any()
        assert not site.apart(crane, both[crane], both, doubtful=False).any()


@given(ends=st.lists(st.floats(), min_size=6, max_size=6))
def test_no_box_of_any_doubles_is_proven_apart_unless_its_ends_are_finite_and_ordered(
    ends: list[float],
) -> None:
    first, second = boxes()
    drawn = np.reshape(ends, (2, 3))
    is_sound = bool((np.isfinite(drawn) & (drawn[0] <= drawn[1])).all())
    assert is_sound or not apart(drawn, second)
    assert is_sound or not apart(first, drawn)


@pytest.mark.parametrize("crane", [0, 1])
@pytest.mark.parametrize("drive", [0, 1, 2])
def test_no_box_with_swapped_ends_is_proven_apart_from_anything(crane: int, drive: int) -> None:
    both = boxes()
    both[crane][:, drive] = both[crane][::-1, drive]
    assert not apart(*both)
    assert not site_of().apart(crane, both[crane], both, doubtful=False).any()


@pytest.mark.parametrize("value", [*BAD[:3], -1.0])
def test_no_distance_or_swing_that_is_none_is_proven(value: float) -> None:
    assert not apart(*boxes(), distance=value)
    assert not apart(*boxes(), swing=value)


@pytest.mark.parametrize("value", ODD)
def test_the_smallest_numbers_are_proven_as_zero_is(value: float) -> None:
    both = boxes()
    both[0][0, 0] = value
    at_zero = boxes()
    at_zero[0][0, 0] = 0.0
    assert apart(*both) == apart(*at_zero) is True


@pytest.mark.parametrize("field", ["radius", "ends", "depth", "translation"])
def test_compiled_comparisons_fail_for_numbers_that_are_none(field: str) -> None:
    bodies = site_of().bodies
    values = getattr(bodies, field).copy()
    for capsule in range(values.shape[1]):
        broken = values.copy()
        broken[0, capsule] = math.nan
        assert not apart(*boxes(), bodies=replace(bodies, **{field: broken}))


def test_a_distance_of_capsules_that_are_none_is_no_number() -> None:
    ends = np.array([[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]] * 2])
    radius = np.full((1, 2), 0.5)
    other = PlacedCapsules(ends + 3.0, radius, np.zeros(0))
    assert least_distances(PlacedCapsules(ends, radius, np.zeros(0)), other)[0] > 1.0
    for value in (math.nan, math.inf):
        for capsule in (0, 1):
            broken = ends.copy()
            broken[0, capsule, 0, 0] = value
            placed = PlacedCapsules(broken, radius, np.zeros(0))
            assert not least_distances(placed, other)[0] > -math.inf


PILLAR = box("pillar", [30.0, 30.0], [1.0, 1.0, 60.0], 0.0)


def clear(site: CraneSite, ends: np.ndarray, distance: float = 1.0, swing: float = 0.1) -> bool:
    return site.obstacles.proven_clear(site.bodies, 0, site.positions(0, ends), distance, swing)


def test_no_box_with_a_number_that_is_none_is_clear_of_obstacles() -> None:
    site = replace(site_of(), solids=(PILLAR,))
    assert clear(site, boxes()[0])
    assert not clear(site, boxes()[0][::-1])
    for value in BAD:
        for end, drive in np.ndindex(2, 3):
            here = boxes()[0]
            here[end, drive] = value
            assert not clear(site, here)


@pytest.mark.parametrize("value", [*BAD[:3], -1.0])
def test_no_distance_or_swing_that_is_none_is_clear(value: float) -> None:
    site = replace(site_of(), solids=(PILLAR,))
    assert not clear(site, boxes()[0], distance=value)
    assert not clear(site, boxes()[0], swing=value)


def test_a_capsule_that_is_none_has_no_margin() -> None:
    obstacles = Obstacles([PILLAR])
    for ends, radius in ((np.full((2, 3), math.nan), 1.0), (np.zeros((2, 3)), math.nan)):
        assert not any(margin > -math.inf for margin in obstacles.margins(ends, radius, hangs=True))


def tower_gap(site: CraneSite, wall: float) -> float:
    """Return the distance of the capsules of the first tower from a plane x = wall [m]."""
    bodies = site.stations[0].bodies
    ends = bodies.ends @ bodies.foot[:, :3].T + bodies.foot[:, 3]
    tower = bodies.joint == 0
    return float((wall - ends[tower, :, 0].max(axis=1) - bodies.radius[tower]).min())


@pytest.mark.parametrize("zone", [False, True])
def test_solids_are_kept_at_the_required_distance_and_zones_out_of(zone: bool) -> None:
    # Beside the mast, low enough that nothing but the mast comes near.
    outline = np.array([[9.0, -1.0], [11.0, -1.0], [11.0, 1.0], [9.0, 1.0]])
    solid = prism("wall", outline, 0.0, 8.0, zone=zone)
    gap = tower_gap(site_of(), 9.0)
    site = replace(site_of(), solids=(solid,))
    assert 2.0 < gap < 8.0
    assert clear(site, boxes()[0], distance=gap - 0.01)
    assert clear(site, boxes()[0], distance=gap + 0.01) == zone


def test_an_obstacle_at_the_corner_of_a_box_is_found_though_no_single_drive_reaches_it() -> None:
    # Slew and trolley each move the load by 10 m at most, both together to the corner, 14 m away.
    station = site_of().stations[0]
    middle = np.array([0.0, 30.0, 20.0])
    halves = np.array([0.25, 10.0, 0.0])
    corner = middle + halves
    _, (point,) = station.plumb(corner[None])
    post = box("post", point[:2].tolist(), [0.1, 0.1, 0.2], float(point[2]) - 0.1)
    site = replace(site_of(), solids=(post,))
    here = np.array([corner, corner])
    assert not clear(site, here, distance=0.0, swing=0.0)
    ends = np.array([middle - halves, middle + halves])
    assert not clear(site, ends, distance=0.0, swing=0.0)
    beside = ends - np.array([0.5, 0.0, 0.0])
    assert clear(site, beside, distance=0.0, swing=0.0)
