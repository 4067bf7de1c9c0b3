"""Where the texts of a drawing stand, so that none covers another one or a dimension line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.lifts.judging.drawings.drawing import (
    Dimension,
    Drawing,
    Label,
    Layer,
    Point,
    as_point,
)

FONT_SIZE = 3.5
"""Size of the letters on paper [mm]. Their capitals are 2.5 mm high, the least height of standards
for technical drawings that are copied."""

CIRCLE_RADIUS = 2.9
"""Radius of the circle around the number of a position on paper [mm]."""

_LETTER_WIDTH = 0.54
"""Mean width of a letter over its size, of fonts without serifs."""

_LINE_HEIGHT = 1.15
"""Height of a line that a text takes over the size of its letters."""

_GAP = 0.8
"""Least distance between two texts on paper [mm]."""

_LINE_WIDTH = 0.4
"""Width that a dimension line takes on paper [mm]."""

_RINGS = (0.0, 5.0, 8.0, 11.0, 15.0, 20.0, 26.0, 33.0, 41.0, 50.0)
"""Distances from what a text names at which room for it is looked for on paper, in turn [mm]."""

_DIRECTIONS = 16
"""Number of directions in which it is looked for at each distance."""

_LEADER_FROM = 1.5
"""Distance of a text from what it names from which on a line leads to it, beyond its own half
height [mm]."""


@dataclass(frozen=True)
class PlacedText:
    """A text with its place.

    Attributes:
        layer: Its layer.
        centre: Middle of the text [m].
        text: The text.
        in_circle: Whether a circle stands around it.
        leader: Line from what it names to the text [m]; None where the text stands at it.
    """

    layer: Layer
    centre: Point
    text: str
    in_circle: bool
    leader: tuple[Point, Point] | None


def text_width(text: str) -> float:
    """Return about how wide a text is on paper [mm]."""
    return _LETTER_WIDTH * FONT_SIZE * len(text)


def place_texts(drawing: Drawing, scale: float) -> list[PlacedText]:
    """Return the texts of a drawing with their places on a sheet of a scale, such as 200 for 1:200.

    Numbers of positions choose first, then dimensions, then names. Each text stands at the first
    place, in rings around what it names, at which it covers no other text and no upright or level
    dimension line but its own, and lies within the area that is shown. If there is none, it stands
    at the place at which it covers least.
    """
    metres = 1e-3 * scale  # on site, for a millimetre on paper
    low = np.array(drawing.low) / metres
    high = np.array(drawing.high) / metres
    lines = _dimension_lines(drawing, metres)
    taken: list[np.ndarray] = []
    placed = []
    for label, dimension in _texts_in_order(drawing):
        anchor = np.array(label.point) / metres
        if np.any(anchor < low) or np.any(anchor > high):
            continue  # what it names is not on the paper
        half = _half_size(label)
        others = [box for owner, box in lines if owner is not dimension]
        centre = _free_place(anchor, half, taken + others, low, high, in_circle=label.in_circle)
        taken.append(np.concatenate([centre - half - _GAP / 2.0, centre + half + _GAP / 2.0]))
        leader = None
        to_box = np.clip(anchor, centre - half, centre + half)
        if np.linalg.norm(to_box - anchor) > _LEADER_FROM:
            leader = (label.point, as_point(to_box * metres))
        place = as_point(centre * metres)
        placed.append(PlacedText(label.layer, place, label.text, label.in_circle, leader))
    return placed


def _dimension_lines(drawing: Drawing, metres: float) -> list[tuple[Dimension, np.ndarray]]:
    """Return the upright and the level dimension lines of a drawing, each with the box on paper
    that it takes: left, bottom, right, top [mm]. The box of any other line is far larger than it.

    Args:
        drawing: The drawing.
        metres: Metres on site for a millimetre on paper.
    """
    lines = []
    for primitive in drawing.primitives:
        if isinstance(primitive, Dimension):
            ends = np.array(primitive.line) / metres
            low, high = ends.min(axis=0), ends.max(axis=0)
            if (high - low).min() < _LINE_WIDTH:
                box = np.concatenate([low - _LINE_WIDTH / 2.0, high + _LINE_WIDTH / 2.0])
                lines.append((primitive, box))
    return lines


def _texts_in_order(drawing: Drawing) -> list[tuple[Label, Dimension | None]]:
    """Return all texts in the order in which they choose their places, each with the dimension of
    which it is the value.
    """
    numbers: list[tuple[Label, Dimension | None]] = []
    dimensions: list[tuple[Label, Dimension | None]] = []
    names: list[tuple[Label, Dimension | None]] = []
    for primitive in drawing.primitives:
        if isinstance(primitive, Dimension):
            start, end = primitive.line
            middle = ((start[0] + end[0]) / 2.0, (start[1] + end[1]) / 2.0)
            dimensions.append((Label(primitive.layer, middle, primitive.text), primitive))
        elif isinstance(primitive, Label):
            (numbers if primitive.in_circle else names).append((primitive, None))
    return [*numbers, *dimensions, *names]


def _half_size(label: Label) -> np.ndarray:
    """Return half the width and height that a text takes on paper [mm], shape (2,)."""
    if label.in_circle:
        return np.array([CIRCLE_RADIUS, CIRCLE_RADIUS])
    return np.array([text_width(label.text), _LINE_HEIGHT * FONT_SIZE]) / 2.0


def _free_place(
    anchor: np.ndarray,
    half: np.ndarray,
    taken: list[np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    *,
    in_circle: bool,
) -> np.ndarray:
    """Return the middle of the first place for a text at which it covers nothing [mm], shape (2,),
    or of the one at which it covers least.

    Args:
        anchor: What it names, shape (2,).
        half: Half of its width and height, shape (2,).
        taken: Boxes that are taken by other texts and by lines: left, bottom, right, top.
        low: Lower left corner of the area for texts, shape (2,).
        high: Its upper right corner, shape (2,).
        in_circle: Whether the text is the number of a position, which stands beside what it names
            to leave the load visible.
    """
    best = (math.inf, anchor)
    for ring in _RINGS[1:] if in_circle else _RINGS:
        for k in range(_DIRECTIONS if ring else 1):
            angle = 2.0 * math.pi * k / _DIRECTIONS
            # The box touches the ring with its near side, so that wide texts do not cover it.
            direction = np.array([math.cos(angle), math.sin(angle)])
            beside = np.where(np.abs(direction) > 0.3, np.sign(direction) * half, 0.0)
            centre = anchor + (ring * direction + beside if ring else 0.0)
            box = np.concatenate([centre - half, centre + half])
            outside = np.maximum(low - box[:2], 0.0).sum() + np.maximum(box[2:] - high, 0.0).sum()
            covered = 10.0 * float(outside) + sum(_overlap(box, other) for other in taken)
            if covered == 0.0:
                return centre
            if covered < best[0]:
                best = (covered, centre)
    return best[1]


def _overlap(box: np.ndarray, other: np.ndarray) -> float:
    """Return the area that two boxes have in common [mm²]."""
    width = min(box[2], other[2]) - max(box[0], other[0])
    height = min(box[3], other[3]) - max(box[1], other[1])
    return max(float(width), 0.0) * max(float(height), 0.0)
