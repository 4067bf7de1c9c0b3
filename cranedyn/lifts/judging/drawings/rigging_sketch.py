"""A sketch of the rigging: hook block, spreader, slings and load. Only what was entered is drawn;
what nobody entered is said to be so.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass

import numpy as np

from cranedyn.lifts.judging.drawings.canvas import INK, Canvas, Stroke
from cranedyn.lifts.judging.drawings.labels import text_width
from cranedyn.lifts.judging.drawings.sheet import (
    A4_PORTRAIT,
    LINE,
    MARGIN,
    LiftSheet,
    TitleBlock,
    frame,
    title_block,
)
from cranedyn.lifts.judging.table import tonnes
from cranedyn.lifts.planning.plan_details import PlanDetails
from cranedyn.lifts.planning.rigging import sling_angle, sling_height
from cranedyn.lifts.planning.site import Site

_SKETCH_HEIGHT = 150.0
"""Height of the sketch on paper [mm]."""

_SKETCH_WIDTH = 100.0
"""Width of the sketch on paper [mm]."""

_UNKNOWN = Stroke("#777777", 0.3, "2 1.5")
"""Lines of what nobody entered."""

_UNKNOWN_HEIGHT = 1.0
"""Height at which a part is sketched whose height nobody entered [m]."""

NOT_ENTERED = "not entered"
"""What stands in place of a value that nobody entered."""


@dataclass(frozen=True)
class RiggingStack:
    """Heights of the rigging, from the end of the rope down.

    Attributes:
        block: Height of the hook block [m]; None if it was not entered.
        spreader: Height of the spreader [m]; 0 without one, None if it was not entered.
        slings: Height from the upper eye of the slings to the lifting points [m]; None if neither
            angle and length nor angle and lifting points were entered.
        below: Height of the load below its lifting points [m]; None if its size was not entered.
    """

    block: float | None
    spreader: float | None
    slings: float | None
    below: float | None

    @property
    def headroom(self) -> float | None:
        """Height from the end of the rope to the underside of the load [m]; None if a part of it
        is not known.
        """
        total = 0.0
        for part in (self.block, self.spreader, self.slings, self.below):
            if part is None:
                return None
            total += part
        return total


def rigging_stack(site: Site) -> RiggingStack:
    """Return the heights of the rigging of a site, as far as they were entered."""
    details = site.details
    spreader: float | None = 0.0
    if details.spreader is not None:
        spreader = details.spreader.height
    return RiggingStack(details.hook_block_height, spreader, sling_height(details), _below(site))


def _below(site: Site) -> float | None:
    """Return the height of the load below its lifting points, or below its top if none were entered
    [m]; None if its size was not entered.
    """
    if site.load is None:
        return None
    bottom = float(site.load[:, 2].min())
    points = np.array(site.details.load.lifting_points)
    if len(points):
        middle = (site.load.min(axis=0) + site.load.max(axis=0))[2] / 2.0
        return float(points[:, 2].mean()) + middle - bottom
    return float(site.load[:, 2].max()) - bottom


def rigging_sheet(site: Site, block: TitleBlock) -> LiftSheet:
    """Return the sheet with the sketch of the rigging."""
    paper = A4_PORTRAIT
    canvas = Canvas("rigging", paper.width, paper.height)
    canvas.text(MARGIN + 3.0, MARGIN + 6.5, "Rigging", bold=True, size=5.0)
    frame(canvas)
    _draw_stack(canvas, site, MARGIN + 6.0, MARGIN + 20.0)
    letters = int((paper.width - 2.0 * MARGIN - 6.0) / text_width("x"))
    lines = [line for note in _notes(site) for line in textwrap.wrap(note, letters)]
    canvas.lines_of_text(MARGIN + 3.0, MARGIN + 32.0 + _SKETCH_HEIGHT, lines, LINE)
    title_block(canvas, block, "not to scale")
    return LiftSheet("rigging", "Rigging", canvas.svg, paper.width, paper.height)


def _draw_stack(canvas: Canvas, site: Site, left: float, top: float) -> None:
    """Draw the rigging from the end of the rope down, with a text beside each part. X of the load
    is to the right. Parts are to one scale where their heights were entered.
    """
    stack = rigging_stack(site)
    details = site.details
    heights = []
    for known in (stack.block, stack.spreader, stack.slings, stack.below):
        heights.append(_UNKNOWN_HEIGHT if known is None else known)
    width = 1.0 if site.load is None else float(np.ptp(site.load[:, 0]))
    per_metre = min(_SKETCH_HEIGHT / max(sum(heights), 0.5), _SKETCH_WIDTH / max(width, 0.5))
    middle = left + _SKETCH_WIDTH / 2.0
    side = left + _SKETCH_WIDTH + 8.0

    y = top
    canvas.line(middle, y - 8.0, middle, y, Stroke(INK, 0.6))
    texts = (
        f"hook block: {_metres(stack.block)}",
        f"spreader: {_spreader_text(details)}",
        f"slings: {_sling_text(details)}",
        f"load: {_load_text(site)}",
    )
    ends = []
    for height in heights:
        ends.append((y, y + height * per_metre))
        y = ends[-1][1]
    block, spreader, slings, load = ends
    _draw_block(canvas, middle, block, known=stack.block is not None)
    if details.spreader is not None:
        known = stack.spreader is not None
        stroke = Stroke(INK, 0.4, fill="#dddddd") if known else _UNKNOWN
        half = min(0.35 * width * per_metre, 0.4 * _SKETCH_WIDTH)
        canvas.box(middle - half, spreader[0], 2.0 * half, spreader[1] - spreader[0], stroke)
    _draw_load(canvas, site, middle, per_metre, load)
    # Over the load, since lifting points may lie below its top.
    _draw_slings(canvas, site, middle, per_metre, slings)

    last = top - LINE
    letters = int((canvas.width - MARGIN - side - 2.0) / text_width("x"))
    for text, (upper, lower) in zip(texts, ends, strict=True):
        if upper == lower:
            continue  # no spreader
        lines = textwrap.wrap(text, letters)
        begin = max((upper + lower) / 2.0 - (len(lines) - 1) * LINE / 2.0, last + LINE + 1.0)
        canvas.line(side - 6.0, (upper + lower) / 2.0, side - 1.0, begin - 1.2)
        canvas.lines_of_text(side, begin, lines, LINE)
        last = begin + (len(lines) - 1) * LINE
        canvas.line(side - 9.0, upper, side - 6.0, upper)
        canvas.line(side - 9.0, lower, side - 6.0, lower)
    canvas.line(side - 7.5, top, side - 7.5, y)
    canvas.text(
        middle,
        y + 7.0,
        f"rope's end to underside: {_metres(stack.headroom)}",
        anchor="middle",
        bold=True,
    )


def _draw_block(canvas: Canvas, middle: float, ends: tuple[float, float], *, known: bool) -> None:
    """Draw the hook block between two heights of the page."""
    stroke = Stroke(INK, 0.4, fill="#bbbbbb") if known else _UNKNOWN
    upper, lower = ends
    body = 0.6 * (lower - upper)
    canvas.box(middle - 5.0, upper, 10.0, body, stroke)
    radius = min(0.2 * (lower - upper), 4.0)
    canvas.line(middle, upper + body, middle, lower - 2.0 * radius, Stroke(stroke.colour, 0.6))
    canvas.circle(middle, lower - radius, radius, Stroke(stroke.colour, 0.6))


def _aside(site: Site, per_metre: float) -> float:
    """Return how far the middle of the load is to the right of the rope on the sheet [mm]: it hangs
    with its centre of gravity below the hook.
    """
    centre = site.details.load.centre
    return 0.0 if centre is None else -centre[0] * per_metre


def _draw_slings(
    canvas: Canvas, site: Site, middle: float, per_metre: float, ends: tuple[float, float]
) -> None:
    """Draw the legs of the slings from their upper eye to the lifting points, or dashed to the
    corners of the load where these or the angle were not entered.
    """
    details = site.details
    known = sling_height(details) is not None and bool(details.load.lifting_points)
    stroke = Stroke(INK, 0.5) if known else _UNKNOWN
    points = details.load.lifting_points
    if points:
        mean = sum(point[2] for point in points) / len(points)
        feet = sorted({(point[0], point[2] - mean) for point in points})
    else:
        half = 0.5 if site.load is None else float(np.ptp(site.load[:, 0])) / 2.0
        feet = [(-half, 0.0), (half, 0.0)]
    upper, lower = ends
    for across, above_mean in feet:
        x = middle + _aside(site, per_metre) + across * per_metre
        y = lower - above_mean * per_metre
        canvas.line(middle, upper, x, y, stroke)
        if points:
            canvas.circle(x, y, 1.2, Stroke(INK, 0.3, fill=INK))
    angle = sling_angle(details)
    if angle is not None:
        canvas.line(middle, upper, middle, lower)
        text = f"β = {math.degrees(angle):.0f}°"
        canvas.text(middle + 1.5, (upper + 2.0 * lower) / 3.0, text, halo=True)


def _draw_load(
    canvas: Canvas, site: Site, middle: float, per_metre: float, ends: tuple[float, float]
) -> None:
    """Draw the box around the load, and its centre of gravity where it was entered.

    Args:
        canvas: The sheet.
        site: The site.
        middle: Where the rope is on the sheet [mm].
        per_metre: Millimetres on the sheet of a metre.
        ends: Height on the sheet of the lifting points and of the underside of the load [mm].
    """
    upper, lower = ends
    if site.load is None:
        width = _UNKNOWN_HEIGHT * per_metre
        canvas.box(middle - width / 2.0, upper, width, lower - upper, _UNKNOWN)
        return
    # The box has its whole height: the load rises above lifting points that lie below its top.
    width, _, height = (per_metre * np.ptp(site.load, axis=0)).tolist()
    stroke = Stroke("#9a4a00", 0.4, fill="#f0a04b", opacity=0.5)
    left = middle + _aside(site, per_metre) - width / 2.0
    canvas.box(left, lower - height, width, height, stroke)
    centre = site.details.load.centre
    if centre is None:
        return
    y = lower - height / 2.0 - centre[2] * per_metre
    canvas.circle(middle, y, 2.0, Stroke(INK, 0.4, fill="#ffffff"))
    canvas.line(middle - 3.5, y, middle + 3.5, y)
    canvas.line(middle, y - 3.5, middle, y + 3.5)
    canvas.text(middle + 4.0, y - 1.0, "centre of gravity", halo=True)


def _metres(value: float | None) -> str:
    """Return a height in words."""
    return NOT_ENTERED if value is None else f"{value:.2f} m"


def _mass(value: float | None) -> str:
    """Return a working load limit in words."""
    return NOT_ENTERED if value is None else tonnes(value)


def _spreader_text(details: PlanDetails) -> str:
    """Return what was entered of the spreader."""
    spreader = details.spreader
    if spreader is None:
        return "none entered"
    name = spreader.name or "name not entered"
    return f"{name}, height {_metres(spreader.height)}, limit {_mass(spreader.limit)}"


def _sling_text(details: PlanDetails) -> str:
    """Return what was entered of the slings, and the angle that follows."""
    slings = details.slings
    known = sling_angle(details)
    angle = NOT_ENTERED
    if known is not None:
        angle = f"{math.degrees(known):.0f}°" + (" (computed)" if slings.angle is None else "")
    number = "number of legs not entered" if slings.number is None else f"{slings.number} legs"
    limit = f"limit of one leg {_mass(slings.limit)}"
    if slings.set_limit is not None:
        limit = f"limit of the set up to 45° {_mass(slings.set_limit)}"
    return (
        f"{slings.type or 'type not entered'}, {number}, angle β from the vertical {angle}, length "
        f"{_metres(slings.length)}, {limit}, certificate "
        f"{slings.certificate or NOT_ENTERED}"
    )


def _load_text(site: Site) -> str:
    """Return what was entered of the load's size."""
    if site.load is None:
        return f"size {NOT_ENTERED}"
    across, along, height = np.ptp(site.load, axis=0).tolist()
    size = f"{across:.2f} m × {along:.2f} m × {height:.2f} m high"
    below = rigging_stack(site).below
    assert below is not None  # as the size of the load is known
    if math.isclose(below, height, abs_tol=5e-3):
        return size
    return f"{size}, of which {below:.2f} m below its lifting points"


def _notes(site: Site) -> list[str]:
    """Return sentences about what the sketch shows and what was not entered."""
    details = site.details
    load = details.load
    notes = []
    mass = site.crane.get("payload_mass")
    notes.append(
        f"Mass of all that hangs: {NOT_ENTERED if mass is None else tonnes(mass)}"
        f" (source: {load.source or NOT_ENTERED})."
    )
    centre = NOT_ENTERED
    if load.centre is not None:
        centre = ", ".join(f"{value:+.2f}" for value in load.centre) + " m from the middle"
    notes.append(f"Centre of gravity: {centre}.")
    points = NOT_ENTERED
    if load.lifting_points:
        shown = ["(" + ", ".join(f"{v:.2f}" for v in point) + ")" for point in load.lifting_points]
        points = "; ".join(shown) + " m from the middle"
    notes.append(f"Lifting points: {points}.")
    notes.append(
        "The sketch is seen along Y of the load. What is dashed was not entered, and its height is "
        "not to scale. The angle β is that of a leg in space; from this side it looks smaller. "
        "That angle, length and lifting points fit each other is not judged. Forces and strength "
        "of the rigging are not in this sketch."
    )
    return notes
