"""Lifts of cranes that are no tower crane: kinematics, bounds and distances against Pinocchio."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.errors import CraneError, ModelError
from cranedyn.lifts.planning.certificate import certify
from cranedyn.lifts.planning.chain_bodies import chain_bodies
from cranedyn.lifts.planning.chain_clearance import ChainClearance
from cranedyn.lifts.planning.clearance import ROUNDING, OutOfReach
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.coverage import coverage_check
from cranedyn.lifts.planning.crane_bodies import corners_of
from cranedyn.lifts.planning.ground_lift import from_ground
from cranedyn.lifts.planning.hoist_chain import HoistChain
from cranedyn.lifts.planning.lift import EXTRA, _end, _lowest, plan_lift
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import box
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.verdict import Verdict
from tests.lifts.planning.sites import LOAD, corners

PORTAL = Path(__file__).resolve().parents[3] / "examples" / "portal_crane.urdf"

KINDS = ("overhead", "luffing", "portal", "mobile", "tower")


@cache
def crane(kind: str) -> Crane:
    if kind == "portal":
        return load_crane(PORTAL, locked={"travel_joint": 12.0})
    locked = {"telescope_joint": 6.0} if kind == "mobile" else {}
    return load_crane(XACRO.parent / f"{kind}_crane.urdf.xacro", locked=locked)


@cache
def clearance(kind: str) -> ChainClearance:
    return ChainClearance(crane(kind), Site("test", (), load=LOAD))


def random_places(asked: ChainClearance, count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    lower = np.maximum(asked.crane.lower[asked.drive_joints], -3.0)
    upper = np.minimum(asked.crane.upper[asked.drive_joints], 30.0)
    return rng.uniform(lower, upper, (count, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_the_pivot_moves_as_pinocchio_has_it(kind: str) -> None:
    chain = HoistChain(crane(kind))
    model = crane(kind).model
    rng = np.random.default_rng(2)
    places = random_places(clearance(kind), 20)
    rates, accelerations = rng.normal(size=(2, 20, 2))
    pivot = chain.pivot(places[:, :2])
    linear = chain.pivot_acceleration(places[:, :2], rates, accelerations)
    joint = chain.swings[0] + 1
    data = model.createData()
    for row, carriers in enumerate(places[:, :2]):
        q, v, a = np.zeros((3, model.nv))
        q[list(chain.carriers)] = carriers
        v[list(chain.carriers)] = rates[row]
        a[list(chain.carriers)] = accelerations[row]
        pin.forwardKinematics(model, data, q, v, a)
        assert_allclose(pivot.point[row], data.oMi[joint].translation, atol=1e-9)
        velocity = pin.getVelocity(model, data, joint, pin.LOCAL_WORLD_ALIGNED).linear
        assert_allclose(pivot.by_drive[row] @ rates[row], velocity, atol=1e-9)
        # Pinocchio's acceleration of the origin of the frame, which turns with the joint's own
        # rate of zero.
        origin = pin.getClassicalAcceleration(model, data, joint, pin.LOCAL_WORLD_ALIGNED).linear
        assert_allclose(linear[row], origin, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_place_hangs_the_load_plumb_at_its_point(kind: str) -> None:
    asked = clearance(kind)
    places = random_places(asked, 20)
    places[:, 2] = np.maximum(places[:, 2], asked.shortest_cable)
    points = asked.point(places)
    data = asked.crane.model.createData()
    for point, q in zip(points, asked.q(places), strict=True):
        pin.forwardKinematics(asked.crane.model, data, q)
        load = data.oMi[asked.crane.payload.body + 1]
        centre = load.translation + load.rotation @ asked.crane.payload.lever
        pivot = data.oMi[asked.swing_joints[0] + 1].translation
        assert_allclose(centre, point, atol=1e-9)
        assert_allclose(centre[:2], pivot[:2], atol=1e-9)
        assert pivot[2] - centre[2] == pytest.approx(float(asked.cable(q)), abs=1e-9)
        assert float(asked.tilt(q)) == pytest.approx(0.0, abs=1e-7)
        again = asked.place(asked.site.to_site(point))
        assert_allclose(asked.point(again), point, atol=1e-6)


def test_places_of_a_tower_crane_are_those_of_its_closed_forms() -> None:
    chain = clearance("tower")
    closed = clearance_of(crane("tower"), chain.site)
    places = random_places(chain, 20)
    rng = np.random.default_rng(3)
    assert_allclose(chain.point(places), closed.point(places), atol=1e-9)
    assert_allclose(chain.q(places), closed.q(places), atol=1e-9)
    assert chain.reach == pytest.approx(closed.reach, rel=1e-6)
    assert chain.swing_inertia == pytest.approx(closed.swing_inertia, rel=1e-9)
    first, second = 0.1 * rng.normal(size=(2, 20, 3))
    # Both name two directions at right angles: sizes are alike.
    by_chain = np.linalg.norm(chain.load_accelerations(places, first, second), axis=1)
    by_closed = np.linalg.norm(closed.load_accelerations(places, first, second), axis=1)
    assert_allclose(by_chain, by_closed, atol=1e-9)
    rope = np.column_stack([0.05 * rng.normal(size=(20, 2)), np.ones(20)])
    rope[0] = [0.0, 0.0, 1.0]  # the closed form counts full turns from a plumb first row
    rope /= np.linalg.norm(rope, axis=1)[:, None]
    low = closed.point(places) - [0.0, 0.0, 0.1]
    difference = chain.carry(low, rope, places) - closed.carry(low, rope, places)
    difference[:, 0] -= 2.0 * np.pi * np.round(difference[:, 0] / (2.0 * np.pi))
    assert_allclose(difference, 0.0, atol=1e-7)


def body_points(asked: ChainClearance, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return corners of the bodies by Pinocchio: in the frame of the crane, and what hangs in that
    of each link.
    """
    data = asked.crane.model.createData()
    pin.forwardKinematics(asked.crane.model, data, q)
    hanging = np.vstack([asked.bodies.load, asked.bodies.hook.corners])
    load = data.oMi[asked.hoist + 1]
    points = {"hanging": hanging @ load.rotation.T + load.translation}
    for joint, link in asked.bodies.links.items():
        frame = data.oMi[joint + 1]
        shapes = np.vstack([corners_of(shape) for shape in link.shapes])
        points[link.name] = shapes @ frame.rotation.T + frame.translation
        relative = frame.actInv(load)
        points[f"hanging from {link.name}"] = hanging @ relative.rotation.T + relative.translation
    return points


def largest_way(asked: ChainClearance, q: np.ndarray, q_end: np.ndarray) -> float:
    first = body_points(asked, q)
    last = body_points(asked, q_end)
    ways = [np.linalg.norm(last[name] - first[name], axis=1).max() for name in first]
    return float(max(ways))


@pytest.mark.parametrize("kind", KINDS[:4])
def test_no_point_moves_farther_than_the_bound_of_a_displacement(kind: str) -> None:
    asked = clearance(kind)
    rng = np.random.default_rng(4)
    n = asked.crane.layout.n
    q = asked.q(random_places(asked, 200)) + 0.1 * rng.normal(size=(200, n))
    step = rng.normal(size=(200, n)) * rng.choice([0.0, 0.01, 0.2], size=(200, n))
    bound = asked.displacement(q, q + step)
    ways = np.array([largest_way(asked, q[i], q[i] + step[i]) for i in range(200)])
    assert (ways <= bound + 1e-12).all()
    assert (ways / np.maximum(bound, 1e-9)).max() > 0.5  # the bound is of use


@pytest.mark.parametrize("kind", KINDS[:4])
def test_no_point_of_the_structure_moves_farther_than_its_bound(kind: str) -> None:
    asked = clearance(kind)
    rng = np.random.default_rng(8)
    n = asked.crane.layout.n
    q = asked.q(random_places(asked, 200))
    step = rng.normal(size=(200, n)) * rng.choice([0.0, 0.01, 0.2], size=(200, n))
    links = [link.name for link in asked.bodies.links.values()]
    ways = []
    for row, row_end in zip(q, q + step, strict=True):
        first = body_points(asked, row)
        last = body_points(asked, row_end)
        ways.append(max(np.linalg.norm(last[name] - first[name], axis=1).max() for name in links))
    bound = asked.structure_displacement(q, q + step)
    assert (np.array(ways) <= bound + 1e-12).all()
    assert (np.array(ways) / np.maximum(bound, 1e-9)).max() > 0.5  # the bound is of use


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_structure_is_nearest_along_a_motion_where_it_is_by_all_its_rows(kind: str) -> None:
    houses = (
        box("house", (6.0, 9.0), (2.0, 3.0, 9.0), 0.0),
        box("hut", (-12.0, -9.0), (3.0, 2.0, 4.0), 0.0),
    )
    asked = clearance_of(crane(kind), Site("test", houses, load=LOAD))
    drives = asked.drive_joints
    lower = np.maximum(asked.crane.lower[drives], -3.0)
    upper = np.minimum(asked.crane.upper[drives], 30.0)
    places = np.random.default_rng(5).uniform(lower, upper, (6, 3))
    # It goes from place to place, and rests for a while at each.
    times = np.repeat(np.arange(6.0), 2) + np.tile([0.0, 0.3], 6)
    rows = np.linspace(0.0, 5.3, 400)
    motion = np.column_stack([np.interp(rows, times, np.repeat(x, 2)) for x in places.T])
    q = asked.q(motion)

    found = asked.nearest_of_structure(q)
    alone = [asked.nearest_of_structure(row[None]) for row in q]
    assert found and all(one.keys() == found.keys() for one in alone)
    if kind == "tower":
        assert {*found} == {"jib", "trolley"}  # both are far above the houses
    for part, (row, nearest) in found.items():
        distances = [one[part].nearest.distance for one in alone]
        assert nearest == alone[row][part].nearest
        assert nearest.distance == pytest.approx(min(distances), abs=1e-5)  # that of coal


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS[:4])
def test_no_margin_of_a_group_of_bodies_changes_by_more_than_its_bound(kind: str) -> None:
    """Also of long steps, of large swings, and of a rope that is paid out from its shortest."""
    asked = clearance(kind)
    rng = np.random.default_rng(6)
    n = asked.crane.layout.n
    q = asked.q(random_places(asked, 300)) + 0.05 * rng.normal(size=(300, n))
    step = rng.normal(size=(300, n)) * rng.choice([0.0, 0.03, 0.2, 1.0], size=(300, n))
    first = np.array([asked.margins_by_motion(row) for row in q])
    last = np.array([asked.margins_by_motion(row) for row in q + step])
    bounds = asked.displacements(q, q + step)
    # coal's distances are accurate to 1e-6 of a length; of bodies that touch they say no more
    assert (np.maximum(last, 0.0) >= first - bounds - 1e-4).all()
    everything = np.array([asked.margin(row) for row in q])
    assert (first.min(axis=1) <= everything).all()
    near = everything < 0.4
    assert_allclose(first.min(axis=1)[near], everything[near], atol=1e-9)


@pytest.mark.slow
def test_a_rope_beside_a_plate_comes_no_nearer_than_its_bound(tmp_path: Path) -> None:
    """The plate hangs 4 m down from a bridge, beside the rope and in the way of its crab. Many
    steps are nearly as long as their bounds, and no margin changes by more.
    """
    text = (PORTAL.parent / "cranes" / "gantry.urdf").read_text()
    legs = re.findall(r"^.*0\.8 0\.8 16\.6.*$", text, re.M)
    assert len(legs) == 4
    for leg in legs:
        text = text.replace(leg, "")
    plate = '<visual><origin xyz="0.5 0 16"/><geometry><box size="0.2 1 4"/></geometry></visual>'
    text = text.replace('<link name="gantry">', f'<link name="gantry">{plate}')
    (tmp_path / "plate.urdf").write_text(text)
    driven = ["gantry_joint", "crab_joint", "rope_joint"]
    gantry = load_crane(tmp_path / "plate.urdf", driven=driven)
    asked = ChainClearance(gantry, Site("test", (), load=LOAD))
    rng = np.random.default_rng(7)
    places = rng.uniform([0.0, -1.5, 2.0], [9.0, 1.5, 14.0], (2000, 3))
    n = gantry.layout.n
    q = asked.q(places) + 0.05 * rng.normal(size=(2000, n))
    step = rng.normal(size=(2000, n)) * rng.choice([0.0, 0.03, 0.1], size=(2000, n))
    first = np.array([asked.margins_by_motion(row) for row in q])
    last = np.array([asked.margins_by_motion(row) for row in q + step])
    bounds = asked.displacements(q, q + step)
    changes = first - np.maximum(last, 0.0)
    assert (changes <= bounds + 1e-4).all()
    of_rope = changes[:, 2] / np.maximum(bounds[:, 2], 1e-3)
    assert 0.9 < of_rope.max() <= 1.1


def test_a_rope_beside_a_girder_is_bounded_by_what_hangs_as_high_as_the_girder() -> None:
    """A wind that lets a load swing aside by half a metre brings the rope no nearer than its plan
    has it by more than that of its upper end: no distance has to be measured.
    """
    asked = clearance("overhead")
    q = asked.q(
        np.column_stack([np.linspace(5.0, 15.0, 400), np.full(400, 8.0), np.full(400, 8.0)])
    )
    swung = q.copy()
    swung[:, list(asked.chain.swings)] += 0.05
    others, _, rope = asked.margins_by_motion(q[0])
    assert 0.3 < rope < 0.4
    by_others, of_links, by_rope = asked.displacements(q, swung).T
    assert (of_links == 0.0).all()  # no swing moves a bridge
    assert (by_others > 0.7).all()
    assert (by_rope < 0.25).all()
    assert others > 2.0


@pytest.mark.parametrize("kind", KINDS[:4])
def test_no_plumb_load_and_no_link_moves_farther_than_the_bound_of_a_travel(kind: str) -> None:
    asked = clearance(kind)
    rng = np.random.default_rng(5)
    places = random_places(asked, 200)
    reach = np.abs(rng.normal(size=(200, 3))) * rng.choice([0.0, 0.02, 0.3], size=(200, 3))
    sides = rng.uniform(-1.0, 1.0, (200, 3))
    used = 0.0
    for place, farthest, side in zip(places, reach, sides, strict=True):
        way = largest_way(asked, asked.q(place), asked.q(place + side * farthest))
        bound = asked.travel(place, farthest)
        assert way <= bound + 1e-12
        used = max(used, way / max(bound, 1e-9))
    assert used > 0.5


@pytest.mark.parametrize("kind", KINDS[:4])
def test_distances_from_the_cranes_own_links_are_those_of_pinocchios_geometry(kind: str) -> None:
    asked = ChainClearance(crane(kind), Site("test", (), load=corners(3.0, 4.0, 2.0)))
    model = asked.crane.model
    load_shape = coal.Box(np.ptp(asked.bodies.load, axis=0))
    for q in asked.q(random_places(asked, 5)):
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        load = data.oMi[asked.hoist + 1]
        for joint, link in asked.bodies.links.items():
            least = np.inf
            for shape in link.shapes:
                corners_in_link = corners_of(shape)
                low, high = corners_in_link.min(axis=0), corners_in_link.max(axis=0)
                within = pin.SE3(np.eye(3), (low + high) / 2.0)
                place = data.oMi[joint + 1] * within
                result = coal.DistanceResult()
                coal.distance(
                    load_shape,
                    coal.Transform3s(load.rotation, load.translation),
                    coal.Box(high - low),
                    coal.Transform3s(place.rotation, place.translation),
                    coal.DistanceRequest(),
                    result,
                )
                least = min(least, result.min_distance)
            found = asked.distances(q)[f"own {link.name}"]
            assert found.distance <= least + 1e-5
            if found.body == "load":
                assert found.distance == pytest.approx(least, abs=1e-5)
            margin = asked.margin(q)
            assert margin <= least - asked.site.distance - ROUNDING + 1e-5


def test_a_boom_keeps_from_obstacles_as_its_load_does() -> None:
    asked = clearance("luffing")
    q = asked.q(np.array([0.0, 0.5, 20.0]))
    # The boom begins at a height of 40 m and rises by half a radian along -Y.
    middle = (0.0, -22.5 * np.cos(0.5))
    height = 40.0 + 22.5 * np.sin(0.5)
    for gap in (0.2, 0.7):
        # Its underside is half of its height of 1.4 m below its middle, at right angles to it.
        top = height - 0.7 / np.cos(0.5) - gap / np.cos(0.5)
        mast = Site("test", (box("mast", middle, (0.02, 0.02, top), 0.0),), load=LOAD)
        beside = ChainClearance(crane("luffing"), mast)
        found = beside.nearest(q)
        assert (found.body, found.obstacle) == ("boom", "mast")
        assert found.distance == pytest.approx(gap, abs=0.02)
        assert beside.margin(q) == pytest.approx(gap - 0.5, abs=0.02)
    assert asked.margin(q, envelope=1e-9) > 1.0


LIMITS = {
    "overhead": Limits((1.3, 0.6, 0.3), (0.3, 0.3, 0.3)),
    "luffing": Limits((0.06, 0.015, 1.0), (0.01, 0.004, 0.3)),
    "portal": Limits((0.1, 0.02, 1.0), (0.02, 0.006, 0.3)),
}

ENDS = {
    "overhead": ((8.0, -6.0, 2.0), (30.0, -14.0, 2.0)),
    "luffing": ((20.0, -20.0, 12.0), (0.0, -30.0, 12.0)),
    "portal": ((12.0, -25.0, 5.0), (30.0, -12.0, 5.0)),
}


def lift_site(kind: str, *solids: object) -> Site:
    start, goal = map(np.array, ENDS[kind])
    return Site("test", solids, load=LOAD, start=start, goal=goal)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["overhead", "portal"])
def test_a_lift_of_another_crane_is_planned_and_certified(kind: str) -> None:
    lift = plan_lift(lift_site(kind), LIMITS[kind], crane=crane(kind))
    certificate = certify(lift)
    assert certificate.holds, [check.sentence for check in certificate.checks]
    end = lift.clearance.point(certificate.run.q[-1, lift.clearance.drive_joints])
    assert_allclose(lift.clearance.site.to_site(end), ENDS[kind][1], atol=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "centre", "size"),
    [
        ("overhead", (20.0, -9.0), (4.0, 8.0, 5.0)),
        ("luffing", (11.0, -27.0), (4.0, 6.0, 16.0)),
    ],
)
def test_a_lift_of_another_crane_goes_round_an_obstacle(
    kind: str, centre: tuple[float, float], size: tuple[float, float, float]
) -> None:
    solid = box("obstacle", centre, size, 0.0)
    certificate = certify(plan_lift(lift_site(kind, solid), LIMITS[kind], crane=crane(kind)))
    assert certificate.holds, [check.sentence for check in certificate.checks]
    assert certificate.distances["obstacle"].min() >= 0.5


def test_of_a_link_that_is_not_drawn_nothing_is_certified() -> None:
    bare = load_crane(XACRO.parent / "overhead_crane.urdf.xacro", values={"visuals": "false"})
    asked = clearance_of(bare, Site("test", (), load=LOAD))
    check = coverage_check(asked, frozenset())
    assert check.verdict is Verdict.NOT_JUDGED
    assert "draws nothing of bridge and trolley" in check.sentence


def test_a_point_that_the_crane_does_not_reach_is_refused_with_how_near_it_comes() -> None:
    asked = clearance("luffing")
    with pytest.raises(OutOfReach, match="its hook comes no nearer to that in plan than about 6"):
        asked.place(np.array([50.0, 0.0, 5.0]))
    with pytest.raises(OutOfReach, match="Lower the point, or take a taller crane"):
        asked.place(np.array([0.0, -30.0, 100.0]))


def test_what_is_made_for_a_tower_crane_refuses_another_one_in_a_sentence() -> None:
    asked = clearance("overhead")
    start = crane("overhead").start
    goal = start._replace(q=start.q + np.eye(5)[0])
    with pytest.raises(ModelError, match=r"needs a tower crane .* overhead_crane is another one\."):
        optimal(crane("overhead"), start, goal, LIMITS["overhead"], clearance=asked)


@pytest.mark.slow
def test_lift_off_of_another_crane_is_refused_in_a_sentence() -> None:
    lift = plan_lift(lift_site("portal"), LIMITS["portal"], crane=crane("portal"))
    with pytest.raises(ModelError, match="A lift from the ground or to it needs a tower crane"):
        from_ground(lift)


def test_a_boom_that_luffs_about_a_skew_axis_is_refused(tmp_path: Path) -> None:
    text = PORTAL.read_text("utf-8")
    # The first swing turns about an axis aside of the hinge of the boom: a plumb load would turn.
    text = text.replace('<origin xyz="0 -30 0"/>', '<origin xyz="0 -30 0" rpy="0 0 0.6"/>')
    (tmp_path / "skew.urdf").write_text(text)
    skew = load_crane(tmp_path / "skew.urdf", locked={"travel_joint": 12.0}, check_axes=False)
    with pytest.raises(ModelError, match=r"luff_joint turns about an axis at 34\.4° to that"):
        HoistChain(skew)


def test_a_slew_of_less_than_a_turn_reaches_all_of_its_range(tmp_path: Path) -> None:
    text = PORTAL.read_text("utf-8").replace('lower="-6.3" upper="6.3"', 'lower="3.5" upper="6.0"')
    (tmp_path / "slew.urdf").write_text(text)
    part = load_crane(tmp_path / "slew.urdf", locked={"travel_joint": 12.0})
    asked = ChainClearance(part, Site("test", (), load=LOAD))
    place = np.array([5.5, 0.9, 20.0])
    assert_allclose(asked.place(asked.point(place)), place, atol=1e-6)


def test_a_link_that_swings_is_not_drawn_for_nothing(tmp_path: Path) -> None:
    text = PORTAL.read_text("utf-8")
    shape = "<visual><geometry><box size='1 1 1'/></geometry></visual>"
    text = text.replace('<link name="swing_r_link">', f'<link name="swing_r_link">{shape}')
    (tmp_path / "block.urdf").write_text(text)
    drawn = load_crane(tmp_path / "block.urdf", locked={"travel_joint": 12.0})
    check = coverage_check(ChainClearance(drawn, Site("test", (), load=LOAD)), frozenset())
    assert check.verdict is Verdict.NOT_JUDGED
    assert "swing_r, which swings" in check.sentence


def changed_portal(folder: Path, old: str, new: str) -> Crane:
    text = PORTAL.read_text("utf-8")
    assert old in text
    (folder / "changed.urdf").write_text(text.replace(old, new, 1))
    return load_crane(folder / "changed.urdf", locked={"travel_joint": 12.0})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<box size="1.2 30 1.2"/>', '<box size="1.2 -30 1.2"/>'),
        ('<box size="1.2 30 1.2"/>', '<capsule radius="0.6" length="30"/>'),
        ('<box size="1.2 30 1.2"/>', ""),
        ('<box size="1.2 30 1.2"/>', '<mesh filename="boom.stl"/>'),
        ('<box size="1.2 30 1.2"/>', '<cylinder radius="0.6" length="0"/>'),
    ],
)
def test_a_shape_that_cannot_be_compared_is_refused_with_its_link(
    tmp_path: Path, old: str, new: str
) -> None:
    with pytest.raises(CraneError, match=r"boom_link|size|shape|mesh"):
        chain_bodies(changed_portal(tmp_path, old, new), LOAD)


def test_a_part_of_a_boom_that_is_not_drawn_is_named(tmp_path: Path) -> None:
    girder = """
  <joint name="girder_joint" type="fixed"><parent link="boom_link"/><child link="girder"/></joint>
  <link name="girder"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
</robot>"""
    crane = changed_portal(tmp_path, "</robot>", girder)
    assert ChainClearance(crane, Site("test", (), load=LOAD)).parts.undrawn == ("girder",)


def test_two_links_of_one_name_but_for_its_ending_are_told_apart(tmp_path: Path) -> None:
    text = PORTAL.read_text("utf-8").replace("upper_link", "boom")
    (tmp_path / "names.urdf").write_text(text)
    crane = load_crane(tmp_path / "names.urdf", locked={"travel_joint": 12.0})
    parts = ChainClearance(crane, Site("test", (), load=LOAD)).parts
    assert parts.moving == ("boom", "boom_link")
    assert {"own boom", "own boom_link"} <= parts.own.keys()


def test_a_load_whose_centre_is_not_at_its_joint_is_refused(tmp_path: Path) -> None:
    crane = changed_portal(
        tmp_path, '<mass value="5000"/>', '<origin xyz="0 0 -2"/><mass value="5000"/>'
    )
    with pytest.raises(ModelError, match="centre of mass of the load is 2 m from the frame"):
        HoistChain(crane)


def test_what_is_drawn_at_a_hook_stays_above_a_load_that_is_entered(tmp_path: Path) -> None:
    block = '<visual><origin xyz="0 0 2.2"/><geometry><box size="0.6 0.6 1"/></geometry></visual>'
    crane = changed_portal(tmp_path, block, "")
    bodies = ChainClearance(crane, Site("test", (), load=corners(4.0, 4.0, 3.0))).bodies
    assert bodies.hook.size == pytest.approx([2.0, 2.0, 2.0])
    assert bodies.hook.centre[2] - 1.0 == pytest.approx(1.5)  # on top of the load


def margin_as_is(crane: Crane, place: np.ndarray, **site: object) -> float:
    asked = ChainClearance(crane, Site("test", (), load=LOAD, **site))  # type: ignore[arg-type]
    return asked.margin(asked.q(place))


def test_a_rope_through_the_cranes_own_deck_and_a_boom_in_its_own_column_are_seen(
    tmp_path: Path,
) -> None:
    place = np.array([0.0, 0.6, 15.0])
    assert margin_as_is(crane("portal"), place) > 0.0
    # A deck of the slewing part below the end of the boom, through which the rope runs.
    deck = '<visual><origin xyz="0 -25 5"/><geometry><box size="9 9 0.5"/></geometry></visual>'
    upper = '<visual><origin xyz="0 2 2"/>'
    assert margin_as_is(changed_portal(tmp_path, upper, deck + upper), place) < 0.0
    # A column that stands where the boom is.
    shape = '<visual><origin xyz="12 -20 15"/><geometry><box size="1 1 30"/></geometry></visual>'
    column = f'<link name="world">{shape}</link>'
    standing = changed_portal(tmp_path, '<link name="world"/>', column)
    assert margin_as_is(standing, place) < 0.0


def test_the_tail_of_a_boom_keeps_from_the_ground(tmp_path: Path) -> None:
    tail = '<visual><origin xyz="0 16 0"/><geometry><box size="2 2 2"/></geometry></visual>'
    boom = '<visual><origin xyz="0 -15 0"/>'
    crane = changed_portal(tmp_path, boom, tail + boom)
    flat, steep = np.array([0.0, 0.5, 15.0]), np.array([0.0, 1.3, 15.0])
    assert margin_as_is(crane, flat) > 0.0
    assert margin_as_is(crane, steep) < 0.0


def test_a_hook_does_not_enter_what_hangs_from_the_link_above_it(tmp_path: Path) -> None:
    # A deck below the end of the boom, which the hook meets on its way up.
    cab = '<visual><origin xyz="0 -30 -9"/><geometry><box size="2 24 0.5"/></geometry></visual>'
    boom = '<visual><origin xyz="0 -15 0"/>'
    cabbed = changed_portal(tmp_path, boom, cab + boom)
    asked = ChainClearance(cabbed, Site("test", (), load=LOAD))
    lengths = np.arange(asked.shortest_cable + 0.1, 20.0, 0.25)
    assert asked.shortest_cable > ChainClearance(crane("portal"), asked.site).shortest_cable
    for luff in (0.5, 0.925):
        q = asked.q(np.column_stack([0.0 * lengths, 0.0 * lengths + luff, lengths]))
        contacts = [
            field.least(body)
            for row in q
            for _, field, body in asked._touching(asked._posture(row))
        ]
        assert min(contacts) > 0.0
    below = asked.q(np.array([0.0, 0.5, 9.5]))  # the hook is in the deck
    assert asked.margin(below) < 0.0


def test_a_crane_with_another_drive_is_to_be_locked() -> None:
    with pytest.raises(ModelError, match=r"has 4 drives: .* Hold the others: locked="):
        HoistChain(load_crane(PORTAL))


@pytest.mark.parametrize("top", [0.1, 1.2])
def test_a_load_that_stands_near_its_boom_hangs_just_above_what_it_stands_on(top: float) -> None:
    """On the shortest cable it is too near to the boom; it hangs as low as it may, above a lorry,
    and never below a deck.
    """
    lorry = box("lorry", (-9.0, 1.5), (8.0, 2.5, top), 0.0)
    asked = ChainClearance(crane("mobile"), Site("test", (lorry,), load=corners(1.2, 3.4, 1.9)))
    point = np.array([-9.0, 1.5])
    assert asked.swing_margin(asked.highest_place(point, "start", 0.0)) < 0.0
    place = _end(asked, "start", point)
    underside = float(asked.point(place)[2]) - 0.95
    envelope = asked.envelope(float(asked.cable(asked.q(place))))
    least = top + asked.site.distance + max(EXTRA) + envelope
    assert least <= underside <= least + 0.15
    # A deck through which the load passes nowhere.
    deck = box("deck", (-9.0, 1.5), (8.0, 4.0, 0.3), 6.0)
    below_boom = replace(asked.site, solids=(lorry, deck))
    place = _lowest(ChainClearance(asked.crane, below_boom), point, "start")
    assert float(asked.point(place)[2]) > 6.3
