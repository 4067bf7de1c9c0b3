"""Sheets of paper: a drawing to a scale, with title block, scale bar, axes or north, notes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from cranedyn.errors import DataError
from cranedyn.lifts.judging.drawings.canvas import INK, THIN, Canvas, Stroke
from cranedyn.lifts.judging.drawings.drawing import Arc, Dimension, Drawing, Layer, Point, Polyline
from cranedyn.lifts.judging.drawings.labels import (
    CIRCLE_RADIUS,
    FONT_SIZE,
    PlacedText,
    place_texts,
    text_width,
)
from cranedyn.lifts.planning.plan_details import Job
from cranedyn.version import __version__

SCALES = (50, 100, 200, 250, 500, 1000, 2000)
"""Scales of sheets, the largest first: 50 is 1:50."""


@dataclass(frozen=True)
class Paper:
    """A size of paper.

    Attributes:
        name: Its name.
        width, height: Its size [mm].
    """

    name: str
    width: float
    height: float


PAPERS = (
    Paper("A4", 297.0, 210.0),
    Paper("A4", 210.0, 297.0),
    Paper("A3", 420.0, 297.0),
    Paper("A3", 297.0, 420.0),
)
"""Sizes of paper in the order in which they are tried at each scale."""

A4_PORTRAIT = PAPERS[1]
"""Paper of sheets without a scale."""

MARGIN = 10.0
"""Margin around a sheet [mm], which every printer leaves."""

BLOCK_WIDTH = 96.0
"""Width of the title block [mm]."""

BLOCK_ROW = 7.0
"""Height of a row of the title block [mm]."""

_BLOCK_ROWS = 6
"""Rows of the title block."""

LINE = 4.7
"""Distance between lines of text [mm]."""

_LEAST_FONT = 2.6
"""Least size of the letters of a long name in the title block [mm]."""

_ARROW = 2.2
"""Length of the arrow of a dimension [mm]."""

STYLES: dict[Layer, Stroke] = {
    "ground": Stroke("#5b4a32", 0.6),
    "obstacles": Stroke("#6b6353", 0.35, fill="#cfc8b8", opacity=0.7),
    "zones": Stroke("#b3261e", 0.35, "4 1.5 1 1.5", fill="#b3261e", opacity=0.10),
    "exclusion": Stroke("#b3261e", 0.5, "5 2"),
    "envelope": Stroke("#0b5cad", 0.3, "2 1.2"),
    "reach": Stroke("#777777", 0.2, "6 1.5 0.8 1.5"),
    "crane": Stroke(INK, 0.25, fill="#9aa3ad", opacity=0.45),
    "crane later": Stroke("#777777", 0.25, "2.5 1.2"),
    "path": Stroke("#0b5cad", 0.45),
    "load": Stroke("#9a4a00", 0.35, fill="#f0a04b", opacity=0.7),
    "dimensions": THIN,
    "text": THIN,
}
"""How each layer is drawn."""

_TEXT_COLOURS: dict[Layer, str] = {
    "zones": "#8f1d17",
    "path": "#0b4a8a",
    "reach": "#555555",
    "obstacles": "#3c372d",
}
"""Colours of texts on layers that have one of their own."""


@dataclass(frozen=True)
class LiftSheet:
    """A page.

    Attributes:
        name: Its name, such as "plan".
        title: What it shows, with its scale and the size of its paper.
        svg: The page as SVG of exact millimetres.
        width_mm, height_mm: Size of the page [mm].
    """

    name: str
    title: str
    svg: str
    width_mm: float
    height_mm: float

    @property
    def markup(self) -> Markup:
        """The page as a part of an HTML document; its texts are escaped already."""
        return Markup(self.svg)


@dataclass(frozen=True)
class TitleBlock:
    """What stands in the corner of every sheet.

    Attributes:
        site: Name of the site.
        job: Which lift it is for; what is None stays an empty line to be filled in.
        prepared: Who prepared the plan; None for an empty line.
        number: Number of the sheet.
        count: Number of all sheets.
    """

    site: str
    job: Job
    prepared: str | None
    number: int
    count: int


class DrawingTooLarge(DataError):
    """A drawing that fits on no paper at any scale of `SCALES`."""


@dataclass(frozen=True)
class _Layout:
    """Where things stand on a sheet of a drawing [mm].

    Attributes:
        paper: The paper.
        scale: The scale, such as 200.
        left, top: Upper left corner of the drawing's area.
        width, height: Size of that area.
        notes: Lines of the notes.
    """

    paper: Paper
    scale: int
    left: float
    top: float
    width: float
    height: float
    notes: tuple[str, ...]


def choose_layout(drawing: Drawing) -> _Layout:
    """Return paper and scale of a drawing: the largest scale at which it fits on any paper, and of
    several papers the first.

    Raises:
        DrawingTooLarge: If it fits on none.
    """
    for scale in SCALES:
        for paper in PAPERS:
            layout = _layout_on(paper, scale, drawing.notes)
            width = 1e3 * drawing.size[0] / scale
            height = 1e3 * drawing.size[1] / scale
            if width <= layout.width and height <= layout.height:
                return layout
    raise DrawingTooLarge(
        f"The {drawing.name} is {drawing.size[0]:.0f} m by {drawing.size[1]:.0f} m, which fits on "
        f"no A3 sheet at 1:{SCALES[-1]}; leave out obstacles that are out of reach."
    )


def _layout_on(paper: Paper, scale: int, notes: Sequence[str]) -> _Layout:
    """Return where things stand on a paper."""
    inner = paper.width - 2.0 * MARGIN
    letters = int((inner - BLOCK_WIDTH - 6.0) / text_width("x"))
    lines = [line for note in notes for line in textwrap.wrap(note, letters)]
    strip = max(_BLOCK_ROWS * BLOCK_ROW, (len(lines) + 4) * LINE)
    return _Layout(
        paper=paper,
        scale=scale,
        left=MARGIN,
        top=MARGIN + 10.0,
        width=inner,
        height=paper.height - 2.0 * MARGIN - 10.0 - strip,
        notes=tuple(lines),
    )


def drawing_sheet(drawing: Drawing, block: TitleBlock) -> LiftSheet:
    """Return a drawing on paper, to the largest scale that fits."""
    layout = choose_layout(drawing)
    paper = layout.paper
    canvas = Canvas(drawing.name, paper.width, paper.height)
    canvas.text(MARGIN + 3.0, MARGIN + 6.5, drawing.title, bold=True, size=5.0)
    draw(canvas, drawing, layout.scale, layout.left, layout.top, layout.width, layout.height)
    frame(canvas)
    bottom = layout.top + layout.height
    canvas.line(MARGIN, bottom, paper.width - MARGIN, bottom, Stroke(width=0.35))
    scale_bar(canvas, MARGIN + 4.0, bottom + 4.0, layout.scale)
    canvas.lines_of_text(MARGIN + 3.0, bottom + 4.0 * LINE - 1.0, layout.notes, LINE)
    title_block(canvas, block, f"1:{layout.scale} ({paper.name})")
    _direction(canvas, drawing, paper.width - MARGIN - 16.0, layout.top + 10.0)
    title = f"{drawing.title}, 1:{layout.scale} on {paper.name}"
    return LiftSheet(drawing.name, title, canvas.svg, paper.width, paper.height)


def frame(canvas: Canvas) -> None:
    """Draw the frame of a sheet."""
    width = canvas.width - 2.0 * MARGIN
    height = canvas.height - 2.0 * MARGIN
    canvas.box(MARGIN, MARGIN, width, height, Stroke(width=0.5))


def draw(
    canvas: Canvas,
    drawing: Drawing,
    scale: float,
    left: float,
    top: float,
    width: float,
    height: float,
) -> None:
    """Draw a drawing to a scale into the middle of a rectangle of a page [mm], which cuts it off.

    Args:
        canvas: The page.
        drawing: The drawing.
        scale: The scale, such as 200.
        left: Left edge of the rectangle.
        top: Its upper edge.
        width: Its width.
        height: Its height.
    """
    per_metre = 1e3 / scale
    # The middle of the area to be shown comes to the middle of the rectangle.
    across = left + width / 2.0
    down = top + height / 2.0
    middle_x = (drawing.low[0] + drawing.high[0]) / 2.0
    middle_y = (drawing.low[1] + drawing.high[1]) / 2.0

    def on_paper(point: Point) -> np.ndarray:
        x = across + (point[0] - middle_x) * per_metre
        y = down - (point[1] - middle_y) * per_metre
        return np.array([x, y])

    canvas.begin_window(left, top, width, height)
    for primitive in drawing.primitives:
        stroke = STYLES[primitive.layer]
        if isinstance(primitive, Polyline):
            if not primitive.closed:
                stroke = Stroke(stroke.colour, stroke.width, stroke.dashes)
            points = np.array([on_paper(point) for point in primitive.points])
            canvas.path(points, stroke, closed=primitive.closed)
        elif isinstance(primitive, Arc):
            _draw_arc(canvas, primitive, on_paper(primitive.centre), per_metre, stroke)
        elif isinstance(primitive, Dimension):
            start, end = primitive.line
            _draw_dimension(
                canvas,
                on_paper(primitive.start),
                on_paper(primitive.end),
                on_paper(start),
                on_paper(end),
            )
    for placed in place_texts(drawing, scale):
        leader = None
        if placed.leader is not None:
            leader = np.array([on_paper(point) for point in placed.leader])
        _write(canvas, placed, on_paper(placed.centre), leader)
    canvas.end_window()


def _draw_arc(
    canvas: Canvas, arc: Arc, centre: np.ndarray, per_metre: float, stroke: Stroke
) -> None:
    """Draw an arc or a circle around a point of the page."""
    radius = arc.radius * per_metre
    if arc.is_circle:
        canvas.circle(float(centre[0]), float(centre[1]), radius, stroke)
        return
    count = max(int(math.degrees(arc.end - arc.start)), 2)
    angles = np.linspace(arc.start, arc.end, count)
    around = np.column_stack([np.cos(angles), -np.sin(angles)])
    canvas.path(centre + radius * around, Stroke(stroke.colour, stroke.width, stroke.dashes))


def _draw_dimension(
    canvas: Canvas, first: np.ndarray, last: np.ndarray, start: np.ndarray, end: np.ndarray
) -> None:
    """Draw a dimension line with arrows from start to end, and lines to it from the points that it
    measures between, all on the page.
    """
    for point, tip in ((first, start), (last, end)):
        if np.linalg.norm(tip - point) > 0.5:
            canvas.path(np.array([point, tip]), THIN)
    canvas.path(np.array([start, end]), THIN)
    length = float(np.linalg.norm(end - start))
    if length < 2.0 * _ARROW:
        return  # there is no room for arrows
    along = (end - start) / length
    across = np.array([-along[1], along[0]])
    for tip, inward in ((start, along), (end, -along)):
        back = tip + _ARROW * inward
        corners = np.array([tip, back + 0.35 * across, back - 0.35 * across])
        canvas.path(corners, Stroke("none", fill=INK), closed=True)


def _write(
    canvas: Canvas, placed: PlacedText, centre: np.ndarray, leader: np.ndarray | None
) -> None:
    """Write a text, and the number of a position in its circle, at its place on the page."""
    if leader is not None:
        canvas.path(leader, THIN)
    x, y = float(centre[0]), float(centre[1])
    # The baseline is below the middle of the capitals by half of their height.
    baseline = y + 0.36 * FONT_SIZE
    if placed.in_circle:
        canvas.circle(x, y, CIRCLE_RADIUS, Stroke(INK, 0.3, fill="#ffffff"))
        canvas.text(x, baseline, placed.text, anchor="middle", bold=True)
        return
    colour = _TEXT_COLOURS.get(placed.layer, INK)
    canvas.text(x, baseline, placed.text, anchor="middle", colour=colour, halo=True)


def scale_bar(canvas: Canvas, left: float, top: float, scale: float) -> None:
    """Draw a bar of five parts of a round length, about 60 mm long in all."""
    wanted = 60.0 * scale / 1e3 / 5.0
    part = min((1, 2, 5, 10, 20, 50, 100), key=lambda length: abs(math.log(length / wanted)))
    width = 1e3 * part / scale
    for i in range(5):
        fill = INK if i % 2 == 0 else "#ffffff"
        canvas.box(left + i * width, top, width, 1.8, Stroke(INK, 0.18, fill=fill))
    for i in (0, 1, 2, 3, 4, 5):
        unit = " m" if i == 5 else ""
        canvas.text(left + i * width, top + 5.6, f"{i * part}{unit}", anchor="middle")


def _direction(canvas: Canvas, drawing: Drawing, x: float, y: float) -> None:
    """Draw the north arrow of a drawing, or the axes of a plan where nobody entered north."""
    if drawing.north is not None:
        _arrow(canvas, x, y + 6.0, drawing.north, 14.0, "N")
    elif drawing.axes == ("x", "y"):
        _arrow(canvas, x - 4.0, y + 6.0, 0.0, 12.0, "x")
        _arrow(canvas, x - 4.0, y + 6.0, math.pi / 2.0, 12.0, "y")


def _arrow(canvas: Canvas, x: float, y: float, angle: float, length: float, text: str) -> None:
    """Draw an arrow from a point in a direction, counter-clockwise from the right [rad]."""
    along = np.array([math.cos(angle), -math.sin(angle)])
    across = np.array([-along[1], along[0]])
    start = np.array([x, y])
    tip = start + length * along
    canvas.path(np.array([start, tip]), Stroke(width=0.5))
    back = tip - 4.0 * along
    corners = np.array([tip, back + 1.4 * across, back - 1.4 * across])
    canvas.path(corners, Stroke("none", fill=INK), closed=True)
    at = tip + 3.2 * along
    canvas.text(float(at[0]), float(at[1]) + 1.3, text, anchor="middle", bold=True)


def title_block(canvas: Canvas, block: TitleBlock, scale: str) -> None:
    """Draw the title block into the lower right corner of a sheet. What nobody entered stays empty,
    to be filled in.
    """
    job = block.job
    height = _BLOCK_ROWS * BLOCK_ROW
    left = canvas.width - MARGIN - BLOCK_WIDTH
    top = canvas.height - MARGIN - height
    canvas.box(left, top, BLOCK_WIDTH, height, Stroke(width=0.5, fill="#ffffff"))
    half = BLOCK_WIDTH / 2.0
    rows: list[list[tuple[str, str | None]]] = [
        [("Site", job.site or block.site)],
        [("Lift", job.title)],
        [("Lift no.", job.number), ("Rev.", job.revision)],
        [("Date", job.date), ("Scale", scale)],
        [("Prepared", block.prepared), ("Signed", None)],
        [
            ("Drawn by", f"cranedyn {__version__}"),
            ("Drawing", f"{block.number} of {block.count}"),
        ],
    ]
    for i, row in enumerate(rows):
        y = top + i * BLOCK_ROW
        canvas.line(left, y, left + BLOCK_WIDTH, y)
        for k, (label, value) in enumerate(row):
            x = left + k * half
            if k:
                canvas.line(x, y, x, y + BLOCK_ROW)
            canvas.text(x + 1.5, y + 4.8, label, colour="#555555")
            if value:
                room = (BLOCK_WIDTH if len(row) == 1 else half) - 21.0
                # A long name is written smaller, but no smaller than can be read.
                size = FONT_SIZE * min(room / text_width(value), 1.0)
                canvas.text(x + 20.0, y + 4.8, value, bold=True, size=max(size, _LEAST_FONT))
