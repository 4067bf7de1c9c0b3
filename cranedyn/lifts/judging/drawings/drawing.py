"""A drawing in metres, of lines, circles, texts and dimensions on named layers.

It knows neither paper nor a file format. `cranedyn.lifts.judging.drawings.sheet` puts it on paper
to a scale, and `cranedyn.lifts.judging.drawings.dxf` writes it for a CAD program. Texts are as high
on paper whatever the scale, so that their size is no part of a drawing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

Layer = Literal[
    "ground",
    "obstacles",
    "zones",
    "exclusion",
    "envelope",
    "reach",
    "crane",
    "crane later",
    "path",
    "load",
    "dimensions",
    "text",
]
"""Name of a layer. "crane" is the crane at the pick-up and "crane later" at the other positions."""

Point = tuple[float, float]
"""A point of a drawing, to the right and upwards [m]."""


@dataclass(frozen=True)
class Polyline:
    """Straight lines from point to point.

    Attributes:
        layer: Its layer.
        points: The points [m].
        closed: Whether it goes back to the first point, and encloses an area.
    """

    layer: Layer
    points: tuple[Point, ...]
    closed: bool = False


@dataclass(frozen=True)
class Arc:
    """An arc of a circle, or a whole circle.

    Attributes:
        layer: Its layer.
        centre: Its centre [m].
        radius: Its radius [m].
        start, end: Angles between which it runs counter-clockwise, from the axis to the right
            [rad]; a difference of 2 π makes a circle.
    """

    layer: Layer
    centre: Point
    radius: float
    start: float = 0.0
    end: float = 2.0 * math.pi

    @property
    def is_circle(self) -> bool:
        """Whether it is a whole circle."""
        return self.end - self.start >= 2.0 * math.pi - 1e-9


@dataclass(frozen=True)
class Label:
    """A text at a point; where it stands beside the point is for the paper to choose.

    Attributes:
        layer: Its layer.
        point: What it names [m].
        text: The text, in one line.
        in_circle: Whether it is the number of a position, which stands in a circle.
    """

    layer: Layer
    point: Point
    text: str
    in_circle: bool = False


@dataclass(frozen=True)
class Dimension:
    """A distance between two points with its value.

    Attributes:
        layer: Its layer.
        start, end: The points [m].
        text: The value with its unit, and what it is.
        offset: Distance of the dimension line from the points, to the left of the way from start to
            end [m].
    """

    layer: Layer
    start: Point
    end: Point
    text: str
    offset: float = 0.0

    @property
    def line(self) -> tuple[Point, Point]:
        """Both ends of the dimension line [m]."""
        way = np.subtract(self.end, self.start)
        length = float(np.linalg.norm(way))
        left = np.zeros(2) if length == 0.0 else np.array([-way[1], way[0]]) / length
        start = np.add(self.start, self.offset * left)
        end = np.add(self.end, self.offset * left)
        return as_point(start), as_point(end)


Primitive = Polyline | Arc | Label | Dimension


@dataclass(frozen=True)
class Drawing:
    """A view of a lift.

    Attributes:
        name: Name of its files, such as "plan".
        title: What it shows.
        primitives: All that is drawn, the lowest first.
        low, high: Corners of the area to be shown [m]. What lies beyond is in the drawing and is
            cut off on paper.
        north: Direction of north, from the axis to the right, counter-clockwise [rad]; None for a
            drawing that has none, such as an elevation, or where nobody entered it.
        axes: Names of the axes to the right and upwards.
        notes: Sentences that say what is drawn.
    """

    name: str
    title: str
    primitives: tuple[Primitive, ...]
    low: Point
    high: Point
    north: float | None = None
    axes: tuple[str, str] = ("x", "y")
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> Point:
        """Width and height of the area to be shown [m]."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]


def as_point(point: np.ndarray) -> Point:
    """Return the first two coordinates of a point [m], shape (2,) or (3,)."""
    return float(point[0]), float(point[1])


def polyline(layer: Layer, points: np.ndarray, *, closed: bool = False) -> Polyline:
    """Return lines through points [m], shape (n, 2) or (n, 3)."""
    return Polyline(layer, tuple(as_point(point) for point in points), closed)
