"""The sequence of a lift as numbered sketches: what happens from one position to the next, when,
how fast, and who gives the signal.
"""

from __future__ import annotations

import math
import textwrap

from cranedyn.lifts.judging.drawings.canvas import THIN, Canvas, Stroke
from cranedyn.lifts.judging.drawings.drawing import Drawing
from cranedyn.lifts.judging.drawings.labels import text_width
from cranedyn.lifts.judging.drawings.sheet import (
    A4_PORTRAIT,
    LINE,
    MARGIN,
    LiftSheet,
    TitleBlock,
    draw,
    frame,
    title_block,
)
from cranedyn.lifts.judging.drawings.views import LiftScene, elevation_sketch, plan_sketch
from cranedyn.lifts.judging.sequence import LiftStep, motion_steps
from cranedyn.lifts.judging.table import place_text
from cranedyn.lifts.planning.plan_details import People

STEPS_ON_SHEET = 4
"""Number of steps on a sheet."""

_SKETCH_WIDTH = 58.0
"""Width of a sketch on paper [mm]."""

_ROW_HEIGHT = 54.0
"""Height of a step on paper [mm]."""


def sequence_sheet_count(scene: LiftScene) -> int:
    """Return on how many sheets the steps are."""
    return math.ceil((len(scene.positions) - 1) / STEPS_ON_SHEET)


def sequence_sheet(scene: LiftScene, page: int, block: TitleBlock) -> LiftSheet:
    """Return a sheet of the sequence, counted from 0."""
    paper = A4_PORTRAIT
    title = "Sequence" if page == 0 else f"Sequence, sheet {page + 1}"
    name = f"sequence-{page + 1}"
    canvas = Canvas(name, paper.width, paper.height)
    canvas.text(MARGIN + 3.0, MARGIN + 6.5, title, bold=True, size=5.0)
    frame(canvas)
    steps = motion_steps(scene.analysis, scene.positions)
    first = page * STEPS_ON_SHEET
    for k, step in enumerate(steps[first : first + STEPS_ON_SHEET]):
        _draw_step(canvas, scene, first + k, step, MARGIN + 9.0 + k * _ROW_HEIGHT)
    notes = [*_phases(scene), "Sketches are not to scale; times are those of the planned motion."]
    communication = scene.analysis.site.details.people.communication
    if communication is not None:
        notes.append(f"Signals by: {communication.rstrip('.')}.")
    letters = int((paper.width - 2.0 * MARGIN - 100.0) / text_width("x"))
    lines = [line for note in notes for line in textwrap.wrap(note, letters)]
    canvas.lines_of_text(MARGIN + 3.0, paper.height - MARGIN - 36.0, lines, LINE)
    title_block(canvas, block, "not to scale")
    return LiftSheet(name, title, canvas.svg, paper.width, paper.height)


def _phases(scene: LiftScene) -> list[str]:
    """Return sentences about lift-off and set-down."""
    analysis = scene.analysis
    if analysis.grounded is None:
        return ["The load hangs at both ends, or lift-off and set-down were not simulated."]
    phases = analysis.grounded.lift.phases
    sentences = []
    pick_up, set_down = scene.stands
    if pick_up is not None:
        place = place_text(pick_up.centre)
        sentences.append(f"Lift-off from {place} m to position 1 takes {phases['motion']:.0f} s.")
    if set_down is not None:
        number = scene.positions[-1].number
        takes = analysis.duration - phases["set-down"]
        place = place_text(set_down.centre)
        sentences.append(f"Set-down from position {number} to {place} m takes {takes:.0f} s.")
    return sentences


def _draw_step(canvas: Canvas, scene: LiftScene, index: int, step: LiftStep, top: float) -> None:
    """Draw a step: plan, elevation, and what happens."""
    width = canvas.width - 2.0 * MARGIN
    canvas.line(MARGIN, top, MARGIN + width, top, Stroke(width=0.35))
    for k, sketch in enumerate((plan_sketch(scene, index), elevation_sketch(scene, index))):
        left = MARGIN + 1.0 + k * (_SKETCH_WIDTH + 1.0)
        height = _ROW_HEIGHT - 2.0
        scale = _fitting_scale(sketch, _SKETCH_WIDTH, height)
        draw(canvas, sketch, scale, left, top + 1.0, _SKETCH_WIDTH, height)
    left = MARGIN + 2.0 * (_SKETCH_WIDTH + 1.0) + 3.0
    right = MARGIN + width - 2.0
    canvas.text(left, top + 6.0, step.positions, bold=True, size=4.5)
    canvas.text(left + 18.0, top + 6.0, f"from {step.begins:.0f} s to {step.ends:.0f} s")
    letters = int((right - left) / text_width("x"))
    lines = []
    for sentence in step.movements:
        lines += textwrap.wrap(f"{sentence}.", letters)
    if step.speeds:
        lines += textwrap.wrap(f"At most {', '.join(step.speeds)}.", letters)
    bottom = top + _ROW_HEIGHT - 4.0
    room = bottom - (top + 11.5)
    room -= _draw_signal(canvas, scene.analysis.site.details.people, left, right, bottom)
    canvas.lines_of_text(left, top + 11.5, lines, min(LINE - 0.3, room / len(lines)))


def _draw_signal(canvas: Canvas, people: People, left: float, right: float, y: float) -> float:
    """Write who gives the signal, or a line to be filled in by hand; return the height that this
    takes above its last line [mm].
    """
    pitch = LINE - 0.3
    lines = [""]
    if people.signaller is None:
        canvas.line(left + 15.0, y + 0.5, right, y + 0.5, THIN)
    else:
        letters = int((right - left - 15.0) / text_width("x"))
        lines = textwrap.wrap(people.signaller, letters)
    begin = y - (len(lines) - 1) * pitch
    canvas.text(left, begin, "Signals:", colour="#555555")
    canvas.lines_of_text(left + 15.0, begin, lines, pitch)
    return len(lines) * pitch


def _fitting_scale(sketch: Drawing, width: float, height: float) -> float:
    """Return the scale at which a sketch fills a rectangle of the page [mm]."""
    return 1e3 * max(sketch.size[0] / width, sketch.size[1] / height)
