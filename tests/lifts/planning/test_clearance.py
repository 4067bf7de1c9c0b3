"""Distances: against closed forms, against brute force, and the bounds that proofs rest on."""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cranedyn.errors import ModelError
from cranedyn.lifts.planning.clearance import ROUNDING, Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.crane_bodies import (
    collision_bodies,
    neighbour,
    parked_position,
    read_shapes,
    shape_corners,
)
from cranedyn.lifts.planning.fields import Body, Field
from cranedyn.lifts.planning.plan_details import PlanDetails, Slings
from cranedyn.lifts.planning.remeasure import second_look
from cranedyn.lifts.planning.site import GROUND, MAST
from cranedyn.lifts.planning.solids import body, box, hull, prism
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from tests.helpers import ROOT, pickled
from tests.lifts.planning.sites import HEIGHT, WALL, clearance, corners, crane, load_corners, site

PLACES = st.tuples(st.floats(-3.0, 3.0), st.floats(4.0, 22.0), st.floats(4.0, 25.0)).map(np.array)
SMALL = st.tuples(*[st.floats(-0.3, 0.3)] * 3).map(np.array)


def test_a_cube_beside_a_wall_and_above_the_ground_is_as_far_as_by_hand() -> None:
    asked = clearance_of(crane(), site(WALL, load=corners(2.0, 2.0, 2.0)))
    place = asked.place(np.array([10.0, -6.0, 3.5]))
    q = asked.q(place)
    # Half the width of a turned cube along Y.
    turned = np.abs(np.sin(place[0])) + np.abs(np.cos(place[0]))
    found = asked.distances(q)
    assert found["wall"].distance == pytest.approx(5.5 - turned, abs=1e-6)
    assert found[GROUND].distance == pytest.approx(2.5, abs=1e-6)
    assert asked.nearest(q).obstacle == GROUND
    swung = (HEIGHT - 3.5 + np.sqrt(3.0)) * asked.swing_chord
    assert asked.swing_margin(place) == pytest.approx(2.5 - 0.5 - swung - ROUNDING, abs=1e-6)


@pytest.mark.parametrize("swing", [0.035, 0.1, 0.5])
def test_no_point_of_a_load_leaves_the_envelope_of_its_swing(swing: float) -> None:
    asked = clearance_of(crane(), site(load=corners(0.2, 0.2, 6.0), swing=swing))
    place = np.array([0.3, 12.0, 20.0])
    plumb = load_corners(asked, asked.q(place))
    envelope = asked.envelope(20.0)
    largest = 0.0
    for share in np.linspace(0.0, np.pi / 2.0, 19):
        # The rope leans by the swing: cos φ cos θ = cos s.
        first = swing * np.cos(share)
        second = np.arccos(min(np.cos(swing) / np.cos(first), 1.0))
        for sign in (1.0, -1.0):
            q = asked.q(place)
            q[[2, 3]] = first, sign * second
            moved = np.linalg.norm(load_corners(asked, q) - plumb, axis=1).max()
            largest = max(largest, float(moved))
    assert largest <= envelope
    assert largest > 0.99 * envelope


def test_a_place_is_where_pinocchio_has_the_load_in_any_frame_of_a_site() -> None:
    asked = clearance_of(crane(), site(foot=np.array([5.0, -3.0, 2.0]), heading=0.7))
    point = np.array([12.0, 6.0, 9.0])
    place = asked.place(point)
    centre = load_corners(asked, asked.q(place)).mean(axis=0)
    np.testing.assert_allclose(asked.site.to_site(centre), point, atol=1e-9)
    np.testing.assert_allclose(asked.site.to_site(asked.point(place)), point, atol=1e-9)


def test_a_cube_of_20_centimetres_stands_for_a_hook_that_a_tower_crane_does_not_draw() -> None:
    """The wall crane, which has the joints of a tower crane, draws its load as a cube of 0.6 m and
    nothing above it.
    """
    drives = ["bracket", "carriage", "winch"]
    wall = load_crane(ROOT / "examples" / "wall_crane.urdf", driven=drives)
    asked = clearance_of(wall, site(WALL, load=None))
    assert isinstance(asked, TowerClearance)
    assert asked.bodies.falls == 0.1
    assert_allclose(asked.bodies.hook.size, [0.2, 0.2, 0.2])
    assert_allclose(asked.bodies.hook.centre, [0.0, 0.0, 0.4], atol=1e-12)
    taller = clearance_of(wall, site(WALL, load=corners(1.0, 1.0, 2.0)))
    assert_allclose(taller.bodies.hook.centre, [0.0, 0.0, 1.1], atol=1e-12)


def test_the_broad_phase_gives_the_distances_of_brute_force_for_inflated_bodies() -> None:
    """What coal's margins get wrong (its issue 625), shapes inflated by a metre get right."""
    rng = np.random.default_rng(1)
    named = [
        (str(i), hull(corners(*rng.uniform(1, 6, 3)) + rng.uniform(-15, 15, 3))) for i in range(25)
    ]
    mesh = body("mesh", *_cube_of_triangles(2.0)).moved(np.eye(3), np.array([0.0, 0.0, 20.0]))
    field = Field([*named, ("mesh", mesh.geometries()[0])])
    moving = Body(hull(corners(1.0, 2.0, 3.0)), 1.0)
    touching = 0
    for _ in range(300):
        put = moving.put(coal.Transform3s(rng.uniform(-18, 18, 3)))
        brute = min(field.distances(put).values())
        least = field.least(put)
        touching += brute <= 0.0
        assert (least <= 0.0) == (brute <= 0.0)
        assert least <= 0.0 or least == pytest.approx(brute, abs=1e-6)
    assert 30 < touching < 270


def test_inflating_takes_exactly_as_much_off_a_distance_from_hulls_and_meshes() -> None:
    vertices, triangles = _cube_of_triangles(2.0)
    dented = vertices.copy()
    dented[0] *= 0.2  # no longer convex, so measured from its triangles
    for solid in (body("cube", vertices, triangles), body("dented", dented, triangles)):
        field = Field([("it", one) for one in solid.geometries()])
        above = coal.Transform3s(np.array([0.0, 0.0, 5.0]))
        cube = hull(corners(1.0, 1.0, 1.0))
        found = [field.least(Body(cube, by).put(above)) for by in (0.0, 1.5)]
        assert found == pytest.approx([3.5, 2.0], abs=1e-6)


@given(PLACES, SMALL)
def test_room_and_a_plumb_load_move_by_no_more_than_travel(
    place: np.ndarray, step: np.ndarray
) -> None:
    asked = clearance(WALL)
    there = place + step
    change = abs(asked.swing_margin(there) - asked.swing_margin(place))
    assert change <= asked.travel(place, np.abs(step)) + 1e-5
    farthest = _farthest(asked, asked.q(place), asked.q(there))
    assert farthest <= asked.travel(place, np.abs(step)) + 1e-9


@given(PLACES, st.floats(0.0, 1.0), st.floats(-np.pi, np.pi))
def test_the_envelope_holds_the_load_at_every_swing_that_the_site_allows(
    place: np.ndarray, share: float, towards: float
) -> None:
    asked = clearance(WALL)
    q = asked.q(place)
    q[2:4] = share * asked.site.swing * np.array([np.cos(towards), np.sin(towards)])
    assert asked.margin(q) >= asked.swing_margin(place) - 1e-5


def _farthest(asked: Clearance, one: np.ndarray, other: np.ndarray) -> float:
    """Return how far any corner of the load is moved between coordinates, by Pinocchio [m]."""
    moved = load_corners(asked, other) - load_corners(asked, one)
    return float(np.linalg.norm(moved, axis=1).max())


@given(PLACES, SMALL, st.tuples(*[st.floats(-0.2, 0.2)] * 4).map(np.array))
def test_no_point_of_the_load_moves_farther_than_said(
    place: np.ndarray, step: np.ndarray, swings: np.ndarray
) -> None:
    asked = clearance(WALL)
    one = asked.q(place)
    other = asked.q(place + step)
    one[2:4] = swings[:2]
    other[2:4] = swings[2:]
    assert _farthest(asked, one, other) <= float(asked.displacement(one, other)) + 1e-9


@given(PLACES, SMALL, st.floats(0.0, 0.3), st.floats(-np.pi, np.pi))
@example(np.array([0.0, 14.0, 10.0]), np.array([0.0, 0.3, -0.3]), 0.3, 0.0)  # nearly the bound
def test_hoisting_along_a_leaning_rope_moves_the_load_no_farther_than_said(
    place: np.ndarray, step: np.ndarray, lean: float, towards: float
) -> None:
    """A rope that keeps its angle takes the load outward while trolley and slew do so, too."""
    asked = clearance(WALL)
    one = asked.q(place)
    other = asked.q(place + step)
    one[2:4] = other[2:4] = lean * np.array([np.cos(towards), np.sin(towards)])
    assert _farthest(asked, one, other) <= float(asked.displacement(one, other)) + 1e-9


def _drawn(joint: int) -> list[np.ndarray]:
    """Return the corners of all that the crane's URDF draws at a joint, in its frame [m]."""
    return [corners for where, corners in shape_corners(crane()) if where == joint]


def test_the_hook_keeps_from_the_own_mast_by_the_way_between_them() -> None:
    asked = clearance()
    legs = max(part[:, 1].max() for part in _drawn(0) if part[:, 2].max() > 7.0)
    for radius in (2.2, 4.0):
        found = asked.nearest(asked.q(np.array([0.0, radius, 15.0])))
        by_hand = radius - asked.bodies.hook[1][1] / 2.0 - legs
        assert (found.body, found.obstacle) == ("hook", MAST)
        assert found.distance == pytest.approx(by_hand, abs=1e-6)  # coal's tolerance


@pytest.mark.slow
def test_rope_and_trolley_keep_from_a_post_beside_them_by_what_the_urdf_draws() -> None:
    """Two posts a metre beside the plumb line at 10 m, one at half of the rope, one at the jib."""
    block = max(_drawn(5), key=lambda part: float(part[:, 2].max()))
    half = {"rope": np.ptp(block[:, :2], axis=0).max() / 2.0}
    half["trolley"] = np.vstack([*_drawn(2), *_drawn(3), *_drawn(4)])[:, 0].max()
    for body_name, base, top in (("rope", 14.0, 18.0), ("trolley", 26.9, 28.6)):
        post = box("post", (1.5, -10.0), (1.0, 1.0, top - base), base)
        asked = clearance(post)
        q = asked.q(np.array([0.0, 10.0, 20.0]))
        found = asked.distances(q, jib=False)["post"]
        assert found.body == body_name
        assert found.distance == pytest.approx(1.0 - half[body_name], abs=1e-6)
        assert asked.margin(q) == pytest.approx(found.distance - 0.5, abs=2e-4)  # ROUNDING


@pytest.mark.slow
def test_the_rope_of_a_parked_neighbour_is_in_the_way() -> None:
    """A ball beside it, ten metres above its load and as far below its trolley."""
    parked = load_crane()
    q = parked_position(parked, [0.0, 15.0, 24.0])
    (solid,) = neighbour("n", parked, q, np.array([30.0, 0.0, 0.0]), np.pi)
    field = Field([("n", one) for one in solid.geometries()])
    ball = Body(coal.Sphere(0.25), 0.0)
    least = field.least(ball.put(coal.Transform3s(np.array([13.0, 0.0, 14.0]))))
    assert least == pytest.approx(2.0 - 0.25 - clearance().bodies.falls, abs=1e-6)


def test_a_concave_prism_is_hollow_where_its_outline_is() -> None:
    outline = np.array(
        [[0, 0], [10, 0], [10, 10], [6, 10], [6, 4], [4, 4], [4, 10], [0, 10]], dtype=float
    )
    outline += np.array([5.0, -5.0])
    solid = prism("u", outline, 0.0, 10.0)
    field = Field([("u", one) for one in solid.geometries()])
    moving = Body(coal.Sphere(0.25), 0.0)
    inside, touching = (
        field.least(moving.put(coal.Transform3s(np.array([x, 3.0, 5.0])))) for x in (10.0, 7.0)
    )
    assert inside == pytest.approx(0.75, abs=1e-6) and touching < 0.0


def test_a_zone_bars_load_hook_and_rope_but_not_the_jib_and_asks_for_no_distance() -> None:
    outline = np.array([[5.0, -8.0], [7.0, -8.0], [7.0, -4.0], [5.0, -4.0]])
    zoned = clearance(prism("zone", outline, 0.0, 10.0, zone=True))
    beside = zoned.place(np.array([9.6, -6.0, 5.0]))
    through = zoned.place(np.array([6.0, -6.0, 5.0]))
    assert zoned.margin(zoned.q(beside)) > 0.5
    assert zoned.margin(zoned.q(through)) < 0.0
    assert zoned.nearest(zoned.q(through)).obstacle == "zone"
    assert zoned.slewing_margin(0.0) == np.inf


def test_two_threads_that_share_a_clearance_get_the_distances_of_one() -> None:
    asked = clearance(WALL)
    rng = np.random.default_rng(1)
    places = rng.uniform((-1.0, 6.0, 6.0), (4.0, 20.0, 22.0), (1000, 3))

    def rooms(order: slice) -> list[float]:
        return [asked.margin(asked.q(place)) for place in places[order]]

    with ThreadPoolExecutor(2) as pool:
        forth, back = pool.map(rooms, (slice(None), slice(None, None, -1)))
    assert forth == back[::-1] == rooms(slice(None))


def _cube_of_triangles(edge: float) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    cube = trimesh.creation.box([edge] * 3)
    return np.array(cube.vertices), np.array(cube.faces)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_has_the_same_distances(copied: Any) -> None:
    asked = clearance(WALL).with_more_distance(0.1)
    place = np.array([0.3, 12.0, 10.0])
    distances = asked.distances(asked.q(place))
    same = copied(asked)
    assert same.distances(same.q(place)) == distances
    assert same.swing_margin(place) == asked.swing_margin(place)


HOIST_AXIS = '<axis xyz="0 0 -1"/>'


def crane_with(tmp_path: Path, before: str, after: str) -> Crane:
    """The crane of this project with a change in its URDF."""
    text = load_crane().urdf
    assert text.count(before) == 1
    (tmp_path / "changed.urdf").write_text(text.replace(before, after))
    return load_crane(tmp_path / "changed.urdf")


@pytest.mark.parametrize(
    ("joint", "before", "after"),
    [
        ("hoist_joint", HOIST_AXIS, f'<origin xyz="0 0 -3"/>{HOIST_AXIS}'),
        (
            "hoist_joint",
            HOIST_AXIS,
            '<origin rpy="3.141592653589793 0 0"/><axis xyz="0 0 1"/>',
        ),
        (
            "hoist_joint",
            HOIST_AXIS,
            '<origin rpy="0.002 0 0"/><axis xyz="0 -0.002 -1"/>',
        ),
        ("trolley_joint", '<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0.0005"/>'),
        (
            "trolley_joint",
            '<child link="trolley_link"/>\n    <origin xyz="0 0',
            '<child link="trolley_link"/>\n    <origin xyz="0.2 0',
        ),
        (
            "swing_tangential_joint",
            '<child link="swing_t_link"/>',
            '<child link="swing_t_link"/><origin xyz="0 0 -0.1"/>',
        ),
    ],
    ids=[
        "the cable is longer than its coordinate",
        "upside down",
        "a hook that leans",
        "a jib that rises",
        "off the axis",
        "two pivots",
    ],
)
def test_a_crane_whose_load_hangs_elsewhere_than_planned_is_refused(
    tmp_path: Path, joint: str, before: str, after: str
) -> None:
    other = crane_with(tmp_path, before, after)
    with pytest.raises(ModelError, match=f"A planned lift needs .*{joint}"):
        TowerClearance(other, site(WALL))


def test_a_load_lies_across_the_jib_however_the_frame_of_its_hook_is_turned(
    tmp_path: Path,
) -> None:
    """A beam of 12 m beside a post that it would miss if it lay along the jib."""
    turned = crane_with(tmp_path, HOIST_AXIS, f'<origin rpy="0 0 1.5707963267948966"/>{HOIST_AXIS}')
    beside = site(box("post", (10.0, 5.0), (0.5, 0.5, 30.0), 0.0), load=corners(12.0, 1.0, 1.0))
    point = np.array([10.0, 0.0, 8.0])
    corner = math.hypot(0.75, 0.25)  # the nearest corner of the beam from the post, for a sample
    for one in (crane(), turned):
        asked = clearance_of(one, beside)
        q = asked.q(asked.place(point))
        assert asked.distances(q, jib=False)["post"].distance == pytest.approx(-0.75, abs=1e-6)
        second = second_look(asked.site, one, q[None, :], 1.0)
        assert (second.body, second.obstacle) == ("load", "post")
        assert second.distance == pytest.approx(corner, abs=1e-6)


def test_all_that_a_urdf_draws_at_the_hook_keeps_from_obstacles(tmp_path: Path) -> None:
    """A second box of a cubic metre, four metres beside the load."""
    drawn = '<visual><origin xyz="4 0 0"/><geometry><box size="1 1 1"/></geometry></visual>'
    link = '<link name="hook_link">'
    two = crane_with(tmp_path, link, link + drawn)
    asked = clearance_of(two, site(load=None))
    one = clearance_of(crane(), site(load=None))
    assert asked.bodies.load[:, 0].max() == pytest.approx(4.5)
    assert_allclose(asked.bodies.hook.size, one.bodies.hook.size)
    for points in _drawn(5):
        assert any(
            (body.min(axis=0) <= points.min(axis=0) + 1e-9).all()
            and (points.max(axis=0) <= body.max(axis=0) + 1e-9).all()
            for body in (one.bodies.load, one.bodies.hook.corners)
        )


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<box size="-1 1 1"/>', r"A box of the link upper_link .* not above 0"),
        ('<sphere radius="0"/>', r"A sphere of the link upper_link .* not above 0"),
        ('<capsule radius="1" length="2"/>', r"upper_link of the crane shows a capsule"),
        ("", r"upper_link of the crane shows no shape"),
    ],
)
def test_a_shape_of_a_tower_crane_that_cannot_be_compared_is_refused(
    shape: str, words: str, tmp_path: Path
) -> None:
    visual = f"<visual><geometry>{shape}</geometry></visual>"
    link = '<link name="upper_link">'
    urdf = crane().urdf
    assert urdf.count(link) == 1
    file = tmp_path / "own.urdf"
    file.write_text(urdf.replace(link, link + visual), "utf-8")
    with pytest.raises(ModelError, match=words):
        collision_bodies(load_crane(file))


def test_a_shape_that_pinocchio_leaves_out_is_refused() -> None:
    robot = ET.fromstring(crane().urdf)
    origin = robot.find("link[@name='upper_link']/visual/origin")
    assert origin is not None
    origin.set("xyz", "here")
    with pytest.raises(ModelError, match=r"Of \d+ shapes of the crane \d+ could be read"):
        read_shapes(crane(), robot)


@pytest.mark.parametrize("kind", ["tower", "overhead"])
def test_the_hook_block_hangs_above_the_rigging_where_that_is_entered(kind: str) -> None:
    """Legs of 3 m at 30° hold a cube of 1 m at its top; a block of 0.9 m is above them."""
    of = crane() if kind == "tower" else load_crane(ROOT / "urdf/overhead_crane.urdf.xacro")
    slings = Slings(number=2, angle=math.radians(30.0), length=3.0)
    entered = PlanDetails(slings=slings, hook_block_height=0.9)
    bare = clearance_of(of, site()).bodies.hook
    hook = clearance_of(of, site(details=entered)).bodies.hook
    saddle = 0.5 + 3.0 * math.cos(math.radians(30.0))
    assert_allclose([hook.corners[:, 2].min(), hook.top], [saddle, saddle + 0.9])
    assert_allclose(hook.size[:2], bare.size[:2])
    assert bare.corners[:, 2].min() < saddle - 1.0
    # Without their height it stays where it is drawn, just above the load.
    unknown = PlanDetails(slings=Slings(number=2), hook_block_height=0.9)
    assert_allclose(clearance_of(of, site(details=unknown)).bodies.hook.corners, bare.corners)


def test_a_hook_above_its_rigging_needs_a_longer_rope() -> None:
    slings = Slings(number=2, angle=math.radians(30.0), length=3.0)
    with_slings = site(details=PlanDetails(slings=slings))
    longer = TowerClearance(crane(), with_slings).shortest_cable
    assert longer > clearance().shortest_cable + 1.0
