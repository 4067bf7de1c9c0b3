"""Bodies of any shape that a file may hold: what geometry libraries cannot take is conditioned or
refused before they get it.
"""

from __future__ import annotations

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import CraneError, DataError
from cranedyn.lifts.planning.fields import Body, Field
from cranedyn.lifts.planning.solids import FARTHEST, body, box, convex_hull, hull, prism
from tests.lifts.planning.sites import corners

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@st.composite
def clouds(draw: st.DrawFn) -> np.ndarray:
    """One to thirty points, as long, flat, far and alike as they may be."""
    numbers = st.sampled_from([-1.0, -0.5, 0.0, 1.0]) | st.floats(-1.0, 1.0)
    count = draw(st.integers(1, 30))
    points = np.array(draw(st.lists(numbers, min_size=3 * count, max_size=3 * count)))
    sizes = [10.0**power for power in draw(st.tuples(*[st.floats(-14.0, 6.0)] * 3))]
    axes, _ = np.linalg.qr(np.array(draw(st.tuples(*[numbers] * 9))).reshape(3, 3) + 0.1)
    far = 10.0 ** draw(st.floats(-3.0, 6.0)) * np.array(draw(st.tuples(*[numbers] * 3)))
    return points.reshape(-1, 3) * sizes @ axes + far


@pytest.mark.slow
@given(clouds(), st.tuples(*[st.integers(-9, 9)] * 3).filter(any).map(np.array))
def test_a_hull_of_any_points_reaches_as_far_as_the_points_in_every_direction(
    points: np.ndarray, direction: np.ndarray
) -> None:
    direction = direction / np.linalg.norm(direction)
    floor = coal.Halfspace(direction, -2.0 * FARTHEST)
    distance = apart(floor, hull(points))
    expected = float((points @ direction).min()) + 2.0 * FARTHEST
    # A micrometre at most along each thin axis, half of it to this side; and round-off of numbers
    # of 2e7, which are 4e-9 apart.
    assert expected - 1e-6 <= distance <= expected + 4e-8


@pytest.mark.slow
@given(clouds())
def test_triangles_of_a_hull_are_closed_and_turn_outward(points: np.ndarray) -> None:
    vertices, triangles = convex_hull(points)
    edges = [tuple(edge) for k in range(3) for edge in np.roll(triangles, k, axis=1)[:, :2]]
    assert len(set(edges)) == len(edges)  # each once, and once the other way round
    assert {edge[::-1] for edge in edges} == set(edges)
    offsets = vertices - vertices.mean(axis=0)
    a, b, c = np.moveaxis(offsets[triangles], 1, 0)
    # Round-off of a sum of products of three lengths each.
    assert np.sum(np.cross(a, b) * c) > -1e-14 * np.abs(offsets).max() ** 3
    assert len(points) > 1 or np.sum(np.cross(a, b) * c) == pytest.approx(6e-18, rel=0.1)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_than_four_points_have_a_hull_a_micrometre_thick(count: int) -> None:
    solid = body("few", np.eye(3)[:count], np.zeros((0, 3), dtype=int), as_hull=True)
    field = Field([("few", one) for one in solid.geometries()])
    moving = Body(hull(corners(2.0, 2.0, 2.0)), 0.0)
    apart = field.least(moving.put(coal.Transform3s(np.array([5.0, 0.0, 0.0]))))
    assert apart == pytest.approx(3.0, abs=2e-6)  # a micrometre, and coal's tolerance


@pytest.mark.parametrize("offset", [1e-10, 1e-13, 1e-7])
def test_an_outline_with_a_corner_a_hair_off_a_line_is_measured_as_without_it(
    offset: float,
) -> None:
    outline = [[0.0, 0.0], [10.0, 0.0], [10.0, 5.0], [5.0, 5.0 + offset], [5.0, 10.0], [0.0, 10.0]]
    moving = Body(hull(corners(1.0, 1.0, 1.0)), 0.5)
    put = moving.put(coal.Transform3s(np.array([8.0, 8.0, 1.0])))
    found = [
        Field([("l", one) for one in prism("l", np.array(shape), 0.0, 3.0).geometries()])
        for shape in (outline, [*outline[:3], [5.0, 5.0], *outline[4:]])
    ]
    least, plain = (field.least(put) for field in found)
    assert least == pytest.approx(plain, abs=2e-6)


def test_a_flat_closed_mesh_is_measured_as_its_hull() -> None:
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1e-10]])
    assert len(body("flat", flat, TETRAHEDRON).geometries()) == 1


@pytest.mark.parametrize("far", [1e9, 1e200, np.nan])
def test_bodies_beyond_every_grid_are_refused_in_metres(far: float) -> None:
    sentence = r"a corner lies at .* m; allowed are -1e\+07 to 1e\+07 m"
    square = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    for make in (
        lambda: hull(np.full((4, 3), far)),
        lambda: box("a", [far, 0.0], [1.0, 1.0, 1.0], 0.0),
        lambda: box("a", [0.0, 0.0], [far, 1.0, 1.0], 0.0),
        lambda: prism("a", square, far, 1.0),
        lambda: body("a", np.full((4, 3), far), TETRAHEDRON),
    ):
        with pytest.raises(DataError, match=sentence):
            make()


@pytest.mark.parametrize("index", [-1, 4, 10**12])
@pytest.mark.parametrize("as_hull", [False, True])
def test_a_triangle_with_a_corner_that_there_is_not_is_refused(index: int, as_hull: bool) -> None:
    triangles = TETRAHEDRON.copy()
    triangles[0, 0] = index
    with pytest.raises(DataError, match=f"refers to the corner of index {index}; there are 4 "):
        body("a", np.vstack([np.eye(3), np.ones(3)]), triangles, as_hull=as_hull)


def test_a_closed_mesh_without_volume_is_refused() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, 0.3, 0.0]])
    with pytest.raises(DataError, match="the mesh encloses no volume"):
        body("a", flat, TETRAHEDRON)


@pytest.mark.parametrize("height", [1e-10, 0.0, -1.0, np.nan])
def test_a_prism_without_height_is_refused(height: float) -> None:
    square = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    with pytest.raises(CraneError, match=r"height is .* m; allowed is >= 1e-06"):
        prism("p", square, 0.0, height)


def round_outline(count: int) -> np.ndarray:
    """An outline of so many corners on a circle of 5 m."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return 5.0 * np.column_stack([np.cos(angles), np.sin(angles)])


def apart(one: coal.CollisionGeometry, other: coal.CollisionGeometry, height: float = 0.0) -> float:
    """Return the distance of two shapes [m], the other one raised by a height [m]."""
    here = coal.Transform3s()
    above = coal.Transform3s(np.array([0.0, 0.0, height]))
    return coal.distance(one, here, other, above, coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize("count", [200, 300, 1000])
def test_a_round_prism_of_many_corners_stands(count: int) -> None:
    """Qhull makes triangles of its cap around one corner, which `coal` does not take."""
    (shape,) = prism("tank", round_outline(count), 0.0, 3.0).geometries()
    assert apart(shape, coal.Sphere(1e-3), 10.0) == pytest.approx(7.0 - 1e-3, abs=1e-6)


@pytest.mark.parametrize("as_hull", [True, False])
def test_a_cone_of_many_sides_stands_by_its_surface(as_hull: bool) -> None:
    count = 300
    foot = np.column_stack([round_outline(count), np.zeros(count)])
    i = np.arange(count)
    sides = np.column_stack([i, np.roll(i, -1), np.full(count, count)])
    faces = np.vstack([sides, np.column_stack([sides[:, 1], i, np.full(count, count + 1)])])
    cone = body("tip", np.vstack([foot, [0, 0, 3], [0, 0, 0]]), faces, as_hull=as_hull)
    (shape,) = cone.geometries()
    assert apart(shape, coal.Sphere(1e-3), 10.0) == pytest.approx(7.0 - 1e-3, abs=1e-6)
    assert cone.surface_encloses(np.array([0.0, 0.0, 1.0]))
    with pytest.raises(
        DataError, match=r"a corner of a convex body has 300 edges; at most 255 are allowed"
    ):
        hull(cone.vertices)
