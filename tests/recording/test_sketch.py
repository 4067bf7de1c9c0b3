"""Outlines of cranes on a picture, and text put together from pictures of its characters."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.path import Path as DrawnPath
from scipy.spatial import ConvexHull

from cranedyn.model.load import load_crane
from cranedyn.recording.lettering import Lettering
from cranedyn.recording.shapes import visible_points
from cranedyn.recording.sketch import Outline, Projection, shapes

PICTURE_HEIGHT = 60
PICTURE_WIDTH = 300

DARK = 64
"""Pixels below are black to the eye."""

INKED = 230
"""Pixels below are touched by a letter."""


def key_numbers(corners: np.ndarray, area: float, depth: float) -> list[float]:
    """Return numbers that tell an outline from others: ends, area and depth."""
    return [*corners.min(axis=0), *corners.max(axis=0), area, depth]


def area_inside(outline: Outline) -> float:
    """Return the area that the path of an outline goes around once [m²]."""
    # About a corner of its own, so that no digits are lost far from the origin.
    x, y = (outline.corners - outline.corners[0]).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0, math.pi])
@pytest.mark.parametrize("rise", [0.0, 0.4, -1.2])
def test_the_outline_of_a_shape_is_the_convex_hull_of_its_points(turn: float, rise: float) -> None:
    crane = load_crane()
    q = crane.start.q + np.linspace(-0.3, 0.4, crane.layout.n)
    offset = np.array([5.0, -3.0, 1.0])
    heading = 0.3
    projection = Projection(
        crane, turn=turn, rise=rise, offset=tuple(offset.tolist()), heading=heading
    )
    level = np.array([-np.cos(turn), -np.sin(turn), 0.0])
    to_eye = np.cos(rise) * level + [0.0, 0.0, np.sin(rise)]
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    expected = []
    for _, points in visible_points(crane, q):
        in_scene = points @ pin.utils.rotate("z", heading).T + offset
        on_picture = in_scene @ np.array([right, np.cross(to_eye, right)]).T
        hull = ConvexHull(on_picture)
        expected.append(key_numbers(on_picture, hull.volume, float((in_scene @ to_eye).max())))
    found = []
    for outline in projection.outlines(q):
        area = area_inside(outline)
        found.append(key_numbers(outline.corners, area, outline.depth))
        assert found[-1][:4] == pytest.approx(outline.extent, abs=1e-12)
    assert len(found) == len(expected) == sum(map(len, shapes(crane.urdf).values()))
    # Both are in different orders: each has one of the other that is the same to round-off of
    # coordinates up to 50 m and sums of seven segments.
    distances = np.abs(np.array(found)[:, None] - np.array(expected)).max(axis=2)
    assert distances.min(axis=1).max() < 1e-12
    assert distances.min(axis=0).max() < 1e-12


def test_an_outline_is_closed_by_the_corner_at_which_it_begins() -> None:
    crane = load_crane()
    for outline in Projection(crane).outlines(crane.start.q):
        assert outline.path.codes is not None
        assert outline.path.codes[-1] == DrawnPath.CLOSEPOLY
        assert len(outline.corners) == len(outline.path.codes) - 1


def matplotlib_text(text: str) -> np.ndarray:
    """Return a white picture with a text as Matplotlib draws it, shape (height, width, 4)."""
    figure = Figure(figsize=(PICTURE_WIDTH / 100, PICTURE_HEIGHT / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    left, top = 10 / PICTURE_WIDTH, 1.0 - 10 / PICTURE_HEIGHT
    figure.text(left, top, text, family="monospace", size=9, va="top", parse_math=False)
    canvas.draw()
    return np.array(canvas.buffer_rgba())


def pasted_text(text: str, left: int = 10, top: int = 10) -> np.ndarray:
    """Return a white picture with a text put together, shape (height, width, 4)."""
    picture = np.full((PICTURE_HEIGHT, PICTURE_WIDTH, 4), 255, dtype=np.uint8)
    Lettering(family="monospace", size=9.0, dots_per_inch=100).write(picture, left, top, text)
    return picture


def test_text_put_together_is_that_of_matplotlib_to_a_pixel() -> None:
    # Signs of formulas are signs, and what is higher or deeper than letters is whole.
    text = "t = 12.34 s\ncrane_1: γ -0.5°  φ 1.0°\nl 3.25 m $2^4$ Å (x)"
    drawn = matplotlib_text(text)[..., 0]
    pasted = pasted_text(text)[..., 0]
    assert (drawn < DARK).sum() > 300
    for rows in ([8, 24], [24, 40], [40, 58]):
        line = slice(*rows)
        # The edges of letters are grey, by a little more or less: dark pixels of the one have to be
        # inked in the other.
        for one, other in ((drawn[line], pasted[line]), (pasted[line], drawn[line])):
            dark = (one < DARK).any(axis=0)
            inked = (other < INKED).any(axis=0)
            assert (inked | ~dark).all()
        # Matplotlib rounds the height of each line by rules of its own, to within one pixel.
        lowest = [np.flatnonzero((p[line] < DARK).any(axis=1))[-1] for p in (drawn, pasted)]
        assert abs(lowest[0] - lowest[1]) <= 1


def test_text_beyond_the_edges_of_a_picture_is_left_out() -> None:
    whole = pasted_text("t = 1.00 s")
    assert not np.array_equal(whole, pasted_text("t = 1.00 s", left=PICTURE_WIDTH - 20))
    for left, top in ((PICTURE_WIDTH + 5, 10), (10, PICTURE_HEIGHT + 30), (10, -40)):
        assert (pasted_text("t = 1.00 s\n", left, top) == 255).all()
    assert (pasted_text("") == 255).all()
    # What remains of a text at the upper edge is its lower part.
    cut = pasted_text("t = 1.00 s", top=-4)
    assert np.array_equal(cut[:10], whole[14:24])


def test_text_leaves_light_lines_behind_it_visible() -> None:
    picture = np.full((PICTURE_HEIGHT, PICTURE_WIDTH, 4), 221, dtype=np.uint8)
    Lettering(family="monospace", size=9.0, dots_per_inch=100).write(picture, 10, 10, "l 5.00 m")
    assert picture[..., :3].min() < 30
    assert (picture[..., :3] == 221).mean() > 0.9
    assert (picture[..., 3] == 221).all()
