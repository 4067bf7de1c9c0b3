"""No obstacle is left out of a proof: a solid of every kind in every role is seen, by its name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("coal", reason="extra planning (coal) is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from cranedyn.errors import DataError
from cranedyn.lifts.planning.certificate import Certificate, _second_look_check, certify
from cranedyn.lifts.planning.clearance import Clearance, Nearest, ObstaclePart
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.coverage import (
    BodyAndObstacle,
    coverage_check,
    hanging_pairs,
    required_pairs,
    slewing_pairs,
)
from cranedyn.lifts.planning.crane_bodies import neighbour
from cranedyn.lifts.planning.lift import NoWay, plan_lift
from cranedyn.lifts.planning.motion_proof import Line, slew_range, unproven_parameter, unproven_row
from cranedyn.lifts.planning.remeasure import point_distances, second_look
from cranedyn.lifts.planning.site import GROUND, HANGING, MAST, Base
from cranedyn.lifts.planning.solids import Solid, body, box, prism
from cranedyn.lifts.planning.standing import standing_check, standing_parts
from cranedyn.lifts.planning.support import (
    NO_SUPPORT,
    Support,
    contact_check,
    meshes_at,
    support_of,
)
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.load import load_crane
from cranedyn.verdict import Verdict
from tests.lifts.planning.sites import (
    LIMITS,
    WALL,
    certificate,
    clearance,
    corners,
    crane,
    lift,
    site,
)

NAME = "thing"


def convex_prism(centre: np.ndarray, size: np.ndarray) -> Solid:
    outline = centre[:2] + size[:2] / 2.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return prism(NAME, outline, centre[2] - size[2] / 2.0, size[2])


def bent_prism(centre: np.ndarray, size: np.ndarray) -> Solid:
    """A prism with a notch on one side, which is not convex."""
    outline = np.array([[-1, -1], [0, -0.9], [1, -1], [1, 1], [-1, 1]])
    flat = centre[:2] + size[:2] / 2.0 * outline
    return prism(NAME, flat, centre[2] - size[2] / 2.0, size[2])


def mesh(centre: np.ndarray, size: np.ndarray, *, notch: bool, as_hull: bool = False) -> Solid:
    """A box as a mesh, with a notch in one edge of its top if it shall not be convex."""
    made = trimesh.creation.box(size)
    if notch:
        made = made.subdivide()
        x, y, z = (made.vertices / size).T
        middle_of_edge = (x > 0.499) & (np.abs(y) < 0.01) & (z > 0.499)
        made.vertices[middle_of_edge, 2] -= 0.1 * size[2]
    return body(NAME, made.vertices + centre, made.faces, as_hull=as_hull)


def parts_of_two(centre: np.ndarray, size: np.ndarray) -> Solid:
    """One obstacle of two boxes, such as a parked crane or a product of a building model."""
    half = np.array([size[0] / 4.0, 0.0, 0.0])
    boxes = [
        box(NAME, (centre + sign * half)[:2], (size[0] / 2.0, *size[1:]), centre[2] - size[2] / 2.0)
        for sign in (-1.0, 1.0)
    ]
    vertices = np.vstack([one.vertices for one in boxes])
    triangles = np.vstack([boxes[0].triangles, boxes[1].triangles + len(boxes[0].vertices)])
    return Solid(NAME, tuple(part for one in boxes for part in one.parts), vertices, triangles)


KINDS: dict[str, Callable[[np.ndarray, np.ndarray], Solid]] = {
    "box": lambda centre, size: box(NAME, centre[:2], size, centre[2] - size[2] / 2.0),
    "convex prism": convex_prism,
    "prism that is not convex": bent_prism,
    "convex mesh": lambda centre, size: mesh(centre, size, notch=False),
    "mesh that is not convex": lambda centre, size: mesh(centre, size, notch=True),
    "mesh as its hull": lambda centre, size: mesh(centre, size, notch=True, as_hull=True),
    "two boxes": parts_of_two,
}

every_kind = pytest.mark.parametrize("kind", KINDS)


def made(kind: str, centre: tuple[float, ...], size: tuple[float, ...]) -> Solid:
    return KINDS[kind](np.array(centre), np.array(size))


@every_kind
@pytest.mark.parametrize(
    ("centre", "size"),
    [
        ((0.0, 0.0, 5.0), (6.0, 6.0, 10.0)),
        ((1.0, 0.0, 9.0), (2.0, 3.0, 0.2)),
        ((0.0, 0.0, 20.0), (80.0, 80.0, 100.0)),
    ],
    ids=["around the mast", "a plate through it", "around the whole crane"],
)
def test_the_mast_stands_in_no_solid(
    kind: str, centre: tuple[float, ...], size: tuple[float, ...]
) -> None:
    where = clearance(made(kind, centre, size))
    check = standing_check(standing_parts(where))
    assert check.verdict is Verdict.FAILS and f"mast stands in {NAME}" in check.sentence
    with pytest.raises(NoWay, match=f"mast stands in {NAME}"):
        plan_lift(where.site, LIMITS, crane=crane())


@every_kind
def test_a_solid_that_the_mast_touches_is_no_reason_to_refuse(kind: str) -> None:
    """A foundation below the mast, and a collar that ties it to a building, touch it."""
    where = clearance(made(kind, (0.0, 0.0, -1.0), (6.0, 6.0, 2.0)))
    mast_side = max(part[:, 0].max() for part in where.bodies.mast)
    beside = clearance(made(kind, (mast_side + 1.0, 0.0, 9.0), (2.0, 3.0, 4.0)))
    for one in (where, beside):
        assert standing_check(standing_parts(one)).verdict is Verdict.HOLDS


def test_a_zone_is_for_what_hangs_and_not_for_the_mast() -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    where = clearance(prism(NAME, square, 0.0, 10.0, zone=True))
    assert standing_parts(where).inside == ()
    assert {
        pair.body for pair in required_pairs(where.site, where.parts) if pair.obstacle == NAME
    } == {*HANGING}


@pytest.mark.parametrize("name", ["ground", "own mast", "own base", "own upper structure"])
def test_no_obstacle_has_a_name_of_our_own(name: str) -> None:
    """A proof that leaves out what a load stands on would leave out an obstacle of that name."""
    with pytest.raises(DataError, match=f"An obstacle is called '?{name}'?, as the program calls"):
        site(box(name, (20.0, 20.0), (1.0, 1.0, 1.0), 0.0))


@pytest.mark.parametrize(
    ("foot", "solids", "words"),
    [
        (0.0, (), "the foot on ground"),
        (15.0, (), "The foot of the crane stands on nothing"),
        (2.0, (box("slab", (0.0, 0.0), (5.0, 5.0, 2.0), 0.0),), "the foot on slab"),
        (2.0, (box("slab", (9.0, 0.0), (5.0, 5.0, 2.0), 0.0),), "stands on nothing"),
        # 3 cm beside the square below the foot, and 3 cm below the foot.
        (2.0, (box("ledge", (0.53, 0.0), (0.5, 1.0, 1.97), 0.0),), "stands on nothing"),
        (2.0, (box("low", (0.0, 0.0), (5.0, 5.0, 1.94), 0.0),), "stands on nothing"),
        (2.0, (box("worn", (0.0, 0.0), (5.0, 5.0, 1.96), 0.0),), "the foot on worn"),
        (-5.0, (), "the mast stands in ground"),
    ],
)
def test_a_foot_stands_on_the_ground_or_an_obstacle(
    foot: float, solids: tuple[Solid, ...], words: str
) -> None:
    here = clearance_of(crane(), site(*solids, foot=np.array([0.0, 0.0, foot])))
    assert words in standing_check(standing_parts(here)).sentence


@pytest.mark.slow
def test_a_load_keeps_from_the_crane_s_own_base_and_upper_structure() -> None:
    """On a cable of 27.3 m the load, a cubic metre, is at the height of the base."""
    broad = clearance_of(crane(), site(base=Base(12.0, 6e4)))
    at_base = broad.distances(broad.q(np.array([0.0, 5.7, 27.3])))
    assert at_base["own base"].distance <= 0.0 and at_base["own base"].body == "load"
    # The slewing column is between a mast of 35 m and a pivot at 40 m; the load is 6 m long.
    tall = load_crane(mast_height=35.0, pivot_height=40.0, total_height=45.0)
    long = clearance_of(tall, site(load=corners(0.6, 6.0, 0.6)))
    beside = long.distances(long.q(np.array([0.3, 2.2, 3.5])))
    assert beside["own upper structure"].distance <= 0.0
    assert long.margin(long.q(np.array([0.3, 2.2, 3.5]))) < 0.0
    below = long.distances(long.q(np.array([0.3, 2.2, 12.0])))
    assert below["own upper structure"].distance > 5.0
    assert below.keys() == beside.keys()  # a run that begins high and goes low has all in each row
    turned = long.distances(long.q(np.array([2.1, 2.2, 3.5])))
    for name in ("own upper structure",):  # it turns with the jib
        assert turned[name].distance == pytest.approx(beside[name].distance, abs=1e-3)


@pytest.mark.parametrize("cable", [3.5, 6.0, 12.0, 20.0])
@pytest.mark.parametrize("swing", [0.0, 0.4])
def test_no_margin_is_more_than_that_of_the_upper_structure_however_far_below_it(
    cable: float, swing: float
) -> None:
    """A proof goes as far from a place as its margin there: what is left out where it is far away
    would be passed through. The mast, which is nearer to a load that hangs low, is taken away.
    """
    tall = load_crane(mast_height=35.0, pivot_height=40.0, total_height=45.0)
    where = clearance_of(tall, site(load=corners(0.6, 2.0, 0.6)))
    where.__dict__["bodies"] = replace(where.bodies, mast=[])
    q = where.q(np.array([0.3, 2.2, cable]))
    q[where.joints.radial_swing] = swing
    upper = where.distances(q)["own upper structure"].distance
    # How deep shapes are in each other is nobody's distance: then it counts that both are negative.
    assert where.margin(q) <= (upper - where.site.distance if upper > 0.0 else 0.0)


@pytest.mark.slow
def test_the_base_that_is_entered_is_a_body_too() -> None:
    """A base of 6 m, turned with the site, reaches 3 m and across its corners 4.2 m."""
    for heading, centre, is_in in (
        (-90.0, (3.5, 0.0), True),
        (-90.0, (4.2, 0.0), False),
        (-45.0, (3.5, 0.0), True),
        (-45.0, (4.2, 0.0), False),
        (-45.0, (3.5, 3.5), True),
        (-45.0, (3.7, 3.7), False),
    ):
        block = box(NAME, centre, (1.2, 1.2, 0.5), 0.0)
        here = site(block, base=Base(6.0, 6e4), heading=math.radians(heading))
        inside = standing_parts(clearance_of(crane(), here)).inside
        assert (BodyAndObstacle("base", NAME) in inside) is is_in, (heading, centre)


@every_kind
def test_a_load_does_not_start_in_a_solid(kind: str) -> None:
    where = site(made(kind, (6.0, -12.0, 4.0), (3.0, 3.0, 3.0)))
    with pytest.raises(NoWay, match=NAME):
        plan_lift(where, LIMITS, crane=crane())


@pytest.mark.slow
@every_kind
def test_a_wall_that_grows_into_the_way_turns_the_certificate_red(kind: str) -> None:
    """The way leads over a wall of 8 m; this one is 9.5 m high."""
    wall = made(kind, (14.0, 0.0, 4.75), (14.0, 1.0, 9.5))
    certified = certify(lift(), clearance_of(crane(), site(wall)))
    assert not certified.holds and certified.nearest.obstacle == NAME
    assert red(certified) and all(NAME in sentence for sentence in red(certified)[:1])


def red(certified: Certificate) -> list[str]:
    return [check.sentence for check in certified.checks if check.verdict is not Verdict.HOLDS]


def standing_load(where: Clearance, bottom: np.ndarray) -> np.ndarray:
    """Return the corners of a cubic metre that stands on a point of the site and sinks by 2 mm."""
    return corners(1.0, 1.0, 1.0) + where.site.to_crane(bottom + np.array([0.0, 0.0, 0.498]))


@every_kind
def test_a_load_stands_on_convex_parts_below_it_and_no_mesh(kind: str) -> None:
    solid = made(kind, (5.0, -9.0, 1.0), (4.0, 4.0, 2.0))
    where = clearance(solid)
    top = solid.vertices[:, 2].max()
    stands = standing_load(where, np.array([5.0, -9.0, top]))
    support = support_of(where, stands)
    if kind == "mesh that is not convex":
        assert not support.parts and meshes_at(where.site, stands) == [NAME]
        return
    assert meshes_at(where.site, stands) == []
    assert {part.obstacle for part in support.parts} == {NAME}
    assert {part.number for part in support.parts} == set(range(len(solid.parts)))
    assert support.height == pytest.approx(top)
    beside = where.without(support.parts)
    pairs = hanging_pairs(beside)
    assert ("load", NAME) not in pairs and ("load", NAME) in pairs | support.pairs


def test_the_walls_of_what_a_load_stands_in_stay_in_the_proof() -> None:
    """A tray: a floor of 0.2 m and a wall beside it of 2 m, one obstacle of two parts."""
    floor = box(NAME, (5.0, -9.0), (4.0, 4.0, 0.2), 0.0)
    wall = box(NAME, (7.1, -9.0), (0.2, 4.0, 2.0), 0.0)
    tray = Solid(
        NAME,
        (*floor.parts, *wall.parts),
        np.vstack([floor.vertices, wall.vertices]),
        np.vstack([floor.triangles, wall.triangles + len(floor.vertices)]),
    )
    where = clearance(tray)
    stands = standing_load(where, np.array([6.3, -9.0, 0.2]))
    support = support_of(where, stands)
    assert [part.number for part in support.parts] == [0]
    (kept,) = where.without(support.parts).solids
    assert len(kept.parts) == 1 and kept.parts[0][:, 2].max() == 2.0


def test_a_load_that_hangs_or_is_inside_of_a_box_stands_on_nothing() -> None:
    where = clearance(box(NAME, (5.0, -9.0), (4.0, 4.0, 2.0), 0.0))
    for height in (2.05, 1.95, 1.0):
        assert not support_of(where, standing_load(where, np.array([5.0, -9.0, height]))).parts
    on_ground = standing_load(where, np.array([12.0, 0.0, 0.0]))
    assert {part.obstacle for part in support_of(where, on_ground).parts} == {GROUND}


def test_a_load_that_stands_on_nothing_is_on_no_support() -> None:
    for support, lowest, verdict in (
        (NO_SUPPORT, 0.0, Verdict.FAILS),
        (Support(2.0, frozenset({ObstaclePart("pad", 0)})), 1.995, Verdict.HOLDS),
        (Support(2.0, frozenset({ObstaclePart("pad", 0)})), 1.985, Verdict.FAILS),
        (Support(2.0, frozenset({ObstaclePart("pad", 0)})), math.nan, Verdict.FAILS),
    ):
        check = contact_check([("start", support, np.array([2.5, lowest, 2.1]))])
        assert check.verdict is verdict, check


@pytest.mark.parametrize("foot", [0.0, 3.0])
def test_the_ground_lies_below_a_foot_that_stands_higher(foot: float) -> None:
    here = clearance_of(crane(), site(foot=np.array([0.0, 0.0, foot])))
    stands = standing_load(here, np.array([12.0, 0.0, 0.0]))
    support = support_of(here, stands)
    assert {part.obstacle for part in support.parts} == {GROUND}
    assert support.height == pytest.approx(-foot)
    q = here.q(here.place(np.array([6.0, -12.0, 6.0])))[None]
    lowest = second_look(here.site, crane(), q, 10.0)
    assert lowest.obstacle == GROUND and lowest.distance == pytest.approx(5.5, abs=1e-9)


def test_a_solid_just_below_the_trolley_is_too_low_for_it_by_the_distance_to_keep(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bottom = clearance().trolley_bottom
    monkeypatch.setattr(TowerClearance, "compared_fields", lambda _: iter(()))
    for gap, is_too_low in ((0.4, False), (0.6, True)):
        post = box(NAME, (0.0, 15.0), (1.0, 1.0, bottom - gap), 0.0)
        pairs = hanging_pairs(clearance_of(crane(), site(post)))
        assert (BodyAndObstacle("trolley", NAME) in pairs) is is_too_low


def test_the_pairs_of_all_bodies_and_obstacles_are_counted_by_hand() -> None:
    zone = prism("zone", np.array([[20, 0], [21, 0], [21, 1], [20, 1]]), 0.0, 5.0, zone=True)
    here = site(WALL, zone)
    where = clearance_of(crane(), here)
    pairs = required_pairs(here, where.parts)
    # The wall, the zone, the own mast, the ground, and the own upper structure.
    assert len(pairs) == 6 + 3 + 3 + 1 + 2
    assert BodyAndObstacle("jib", "wall") in pairs and BodyAndObstacle("jib", "zone") not in pairs
    assert {pair.body for pair in pairs} == {*where.parts.bodies}
    covered = hanging_pairs(where) | slewing_pairs(where) | standing_parts(where).pairs
    assert covered >= pairs
    assert coverage_check(where, covered).verdict is Verdict.HOLDS
    for left_out in (("load", "wall"), ("mast", "wall"), ("hook", MAST), ("load", GROUND)):
        check = coverage_check(where, covered - {BodyAndObstacle(*left_out)})
        assert check.verdict is Verdict.NOT_JUDGED
        assert f"{left_out[0]} and {left_out[1]}" in check.sentence


def test_an_obstacle_counts_as_compared_only_with_all_of_its_parts() -> None:
    solid = parts_of_two(np.array([12.0, 0.0, 3.0]), np.array([4.0, 1.0, 6.0]))
    assert BodyAndObstacle("load", NAME) in hanging_pairs(clearance(solid))
    where = clearance_of(crane(), site(solid))
    where.__dict__["solids"] = [replace(solid, parts=solid.parts[:1])]
    assert BodyAndObstacle("load", NAME) not in hanging_pairs(where)
    assert BodyAndObstacle("jib", NAME) not in slewing_pairs(where)


# --- a second look -------------------------------------------------------------------------------


def test_points_are_as_far_from_a_box_as_by_hand_and_from_a_mesh_alike() -> None:
    points = np.array([[3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 0.5], [1.5, 2.0, 1.0]])
    by_hand = [2.0, math.hypot(2.0, 2.0), 0.0, 0.5]
    for kind in ("box", "mesh that is not convex", "two boxes"):
        solid = made(kind, (0.0, 0.0, 0.0), (2.0, 4.0, 4.0))
        assert point_distances(points, solid) == pytest.approx(by_hand, abs=1e-12), kind


@pytest.mark.slow
def test_a_second_look_agrees_with_the_certificate() -> None:
    nearest = certificate().nearest
    rows = certificate().run.q[::40]
    again = second_look(site(WALL), crane(), rows, nearest.distance + 0.5)
    assert again.obstacle == nearest.obstacle
    assert nearest.distance - 1e-3 <= again.distance <= nearest.distance + 0.05


@pytest.mark.slow
def test_a_plan_for_a_load_of_half_its_size_is_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Plan and proof share their bodies: with a load of half its size in both, both agree."""
    where = clearance_of(crane(), site(WALL, load=0.5 * corners(1.0, 1.0, 1.0)))
    small = certify(plan_lift(where.site, LIMITS, crane=crane()))
    assert small.holds
    whole = replace(where, site=site(WALL))
    whole.__dict__["bodies"] = where.bodies  # the fault
    certified = certify(replace(small.lift, clearance=whole))
    assert certified.checks[0].holds, "the proof does not see its own fault"
    (sentence,) = red(certified)
    assert sentence.startswith("Measured a second time")


@pytest.mark.slow
def test_a_plan_without_its_envelope_of_swing_is_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Clearance, "envelope", lambda self, length: 0.0 * length)
    certified = certify(plan_lift(site(WALL), LIMITS, crane=crane()))
    assert certified.checks[0].holds, "the proof does not see its own fault"
    assert any(sentence.startswith("Measured a second time") for sentence in red(certified))


@pytest.mark.slow
def test_the_envelope_that_is_measured_a_second_time_is_about_plumb() -> None:
    """A motion of least time swings by itself as far as the envelope goes, and no farther."""
    made = certificate()
    motion = made.lift.timed.motion
    q = motion.q.copy()
    q[:, crane().swings] += made.lift.clearance.site.swing
    swinging = replace(made.lift, timed=replace(made.lift.timed, motion=replace(motion, q=q)))
    checks = []
    for one in (made.lift, swinging):
        checks.append(_second_look_check(one.clearance, one, made.run.q[::40], made.nearest))
    assert checks[0] == checks[1] and checks[0].holds


def looked_at(*solids: Solid, swing: float = 0.0, **changes: Any) -> Nearest:
    """Return what a second look finds of a cable of 20 m at a radius of 15 m along +X."""
    here = site(*solids, **changes)
    q = clearance_of(crane(), here).q(np.array([math.pi / 2.0, 15.0, 20.0]))[None]
    return second_look(here, crane(), q, 5.0, swing=swing)


@pytest.mark.parametrize(
    ("centre", "size"),
    [
        ((18.0, 0.0), (2.0, 9.0, 12.0)),  # outward
        ((12.0, 0.0), (2.0, 9.0, 12.0)),
        ((15.0, 3.0), (9.0, 2.0, 12.0)),  # along the arc
        ((15.0, -3.0), (9.0, 2.0, 12.0)),
    ],
)
def test_a_load_is_swung_to_all_sides(centre: tuple[float, ...], size: tuple[float, ...]) -> None:
    """The load of a cubic metre is 1.5 m from a wall; its centre, 20 m below the pivot, goes 20 sin
    s to the side, and its corners 0.5 m below and beside that turn with the rope.
    """
    swing = 0.05
    still = looked_at(box(NAME, centre, size, 0.0))
    assert still.obstacle == NAME and still.distance == pytest.approx(1.5, abs=1e-9)
    swung = looked_at(box(NAME, centre, size, 0.0), swing=swing)
    aside = 20.0 * math.sin(swing) + 0.5 * math.sin(swing) - 0.5 * (1.0 - math.cos(swing))
    assert swung.distance == pytest.approx(1.5 - aside, abs=2e-3)


def test_a_second_look_sees_rope_and_turned_load_and_no_zone() -> None:
    shelf = box(NAME, (15.0, 2.0), (1.0, 2.0, 1.0), 15.0)  # its edge is 1 m beside the rope
    rope = looked_at(shelf)
    assert rope.body == "rope" and 1.0 <= rope.distance < 1.2
    wall = box(NAME, (15.0, 5.0), (9.0, 2.0, 12.0), 0.0)  # 4 m from the centre of the load
    for size, gap in (((5.0, 1.0, 1.0), 1.5), ((1.0, 5.0, 1.0), 3.5)):
        # At a quarter turn of the slew, X of the load, across the jib, is along Y of the site.
        assert looked_at(wall, load=corners(*size)).distance == pytest.approx(gap, abs=1e-9)
    around = np.array([[14.0, -1.0], [16.0, -1.0], [16.0, 1.0], [14.0, 1.0]])
    assert looked_at(prism(NAME, around, 0.0, 12.0, zone=True)).obstacle == ""


@pytest.mark.slow
def test_a_certificate_is_red_where_the_crane_stands_in_a_box_or_the_load_ends_elsewhere() -> None:
    office = box("office", (0.0, 0.0), (4.0, 4.0, 3.0), 0.0)
    stands = certify(lift(), clearance_of(crane(), site(WALL, office)))
    assert "the mast stands in office" in str(red(stands))
    ends = lift().ends + np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0]])
    (sentence,) = red(certify(replace(lift(), ends=ends)))
    assert "it ends 20.0 mm from its goal, 10 allowed" in sentence


# --- numbers that are none -----------------------------------------------------------------------

BAD = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308])


@given(index=st.integers(0, 4), value=BAD)
@example(index=4, value=math.nan)
def test_no_proof_holds_with_a_coordinate_that_is_none(index: int, value: float) -> None:
    where = clearance(WALL)
    q = np.tile(where.q(np.array([0.0, 12.0, 20.0])), (5, 1))
    assert unproven_row(where, q, 5e-3) is None
    q[2, index] = value
    if not math.isfinite(value):
        assert where.margin(q[2]) == -math.inf
        assert unproven_row(where, q, 5e-3) is not None
    with np.errstate(all="ignore"):
        assert unproven_row(where, q[1:3], 5e-3) is not None


@given(index=st.integers(0, 2), value=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_no_line_is_proven_to_a_place_that_is_none(index: int, value: float) -> None:
    where = clearance(WALL)
    place = np.array([0.0, 12.0, 10.0])
    end = place.copy()
    end[index] = value
    with np.errstate(all="ignore"):
        assert unproven_parameter(where, Line(place, end), 0.0, 1.0) is not None


def test_no_slew_angle_that_is_none_is_free() -> None:
    where = clearance(WALL)
    for gamma in (math.nan, math.inf, -math.inf):
        assert where.slewing_margin(gamma) == -math.inf


@pytest.mark.slow
def test_a_parked_crane_is_an_obstacle_of_all_its_parts() -> None:
    other = load_crane()
    (parked,) = neighbour(NAME, other, other.start.q, np.array([30.0, 0.0, 0.0]), 0.0)
    where = clearance(parked)
    assert len(parked.parts) > 2
    covered = hanging_pairs(where) | slewing_pairs(where) | standing_parts(where).pairs
    assert coverage_check(where, covered).verdict is Verdict.HOLDS


def test_a_jib_at_an_angle_that_is_none_turns_nowhere() -> None:
    where = clearance(WALL)
    assert slew_range(where, 0.0, -1.0, 1.0).high > 0.0
