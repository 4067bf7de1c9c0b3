"""The sequence of a lift as numbered sketches: what happens from one position to the next, when,
how fast, and who gives the signal.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass

import numpy as np

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
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.plan_details import People
from cranedyn.lifts.planning.timing import STEP

STEPS_ON_SHEET = 4
"""Number of steps on a sheet."""

_LEAST_WAY = 0.1
"""Way of a drive up to which a step does not tell it [m]."""

_LEAST_TURN = math.radians(0.5)
"""Turn of a drive up to which a step does not tell it [rad]."""

_SKETCH_WIDTH = 58.0
"""Width of a sketch on paper [mm]."""

_ROW_HEIGHT = 54.0
"""Height of a step on paper [mm]."""


@dataclass(frozen=True)
class SketchedStep:
    """What happens from one position to the next.

    Attributes:
        number: Number of the position at its end.
        movements: What each drive does, in sentences.
        speeds: The largest rate of each drive that moves, in words.
        begins, ends: Times from the beginning of the lift [s].
    """

    number: int
    movements: tuple[str, ...]
    speeds: tuple[str, ...]
    begins: float
    ends: float


def steps_of(scene: LiftScene) -> list[SketchedStep]:
    """Return the steps from each position to the next."""
    lift = scene.analysis.certificate.lift
    grounded = scene.analysis.grounded
    offset = 0.0 if grounded is None else grounded.lift.phases["motion"]
    steps = []
    for i in range(len(scene.positions) - 1):
        first = scene.positions[i]
        last = scene.positions[i + 1]
        places = lift.timed.places[first.row : last.row + 1]
        movements = []
        speeds = []
        for drive in range(3):
            sentence = _movement(scene, i, drive, places)
            if sentence is not None:
                movements.append(sentence)
                speeds.append(_speed(scene.clearance, drive, places))
        steps.append(
            SketchedStep(
                number=last.number,
                movements=tuple(movements) or ("No drive moves by as much as is told here.",),
                speeds=tuple(speeds),
                begins=offset + first.t,
                ends=offset + last.t,
            )
        )
    return steps


def _movement(scene: LiftScene, index: int, drive: int, places: np.ndarray) -> str | None:
    """Return what a drive does in a step, in a sentence; None if it hardly moves.

    Args:
        scene: The lift.
        index: Index of the position at which the step begins.
        drive: The drive.
        places: Places of the step, shape (k, 3).
    """
    clearance = scene.clearance
    joint = clearance.crane.layout.driven[drive]
    least = _LEAST_TURN if joint.kind == "revolute" else _LEAST_WAY
    if float(np.ptp(places[:, drive])) <= least:
        return None
    if drive == 2:
        return _hoisting(scene, index, places)
    if drive == clearance.turning:
        turns = clearance.load_turn(places)
        turn = float(turns[-1] - turns[0])
        side = "left" if turn > 0.0 else "right"
        sentence = f"Slew {math.degrees(abs(turn)):.0f}° to the {side}"
        return sentence + _detour(np.degrees(turns - turns[0]), "°", 1.0)
    name = joint.role or joint.symbol
    if clearance.turning is not None:
        radii = [scene.radius(index) or 0.0, scene.radius(index + 1) or 0.0]
        verb = "Luff" if joint.kind == "revolute" else name.capitalize()
        way = "out" if radii[1] > radii[0] else "in"
        return f"{verb} {way}, radius from {radii[0]:.1f} m to {radii[1]:.1f} m"
    return f"{name.capitalize()} {_slide(clearance, drive, places)}"


def _hoisting(scene: LiftScene, index: int, places: np.ndarray) -> str:
    """Return what the hoist does in a step. Heights are those of the load's underside, which a
    boom that luffs moves, too.
    """
    clearance = scene.clearance
    ground = scene.analysis.site.ground
    heights = [float(s.load[:, 2].min()) - ground for s in scene.shapes[index : index + 2]]
    length = float(places[-1, 2] - places[0, 2])
    verb = "Lower" if length > 0.0 else "Hoist"
    luffs = False
    for i, joint in enumerate(clearance.crane.layout.driven[:2]):
        luffs = luffs or (joint.kind == "revolute" and i != clearance.turning)
    if luffs:
        sentence = f"{verb} {abs(length):.1f} m of rope"
    else:
        # A short way shows only in centimetres.
        digits = 1 if abs(heights[1] - heights[0]) > 0.3 else 2
        way = f"from {heights[0]:.{digits}f} m to {heights[1]:.{digits}f} m"
        sentence = f"{verb} the load {way} above ground"
    return sentence + _detour(places[:, 2] - places[0, 2], " m of rope", 0.2)


def _detour(values: np.ndarray, unit: str, least: float) -> str:
    """Return by how far a drive goes beyond both ends of a step and back, in words; empty if by
    less than the least.

    Args:
        values: What it has moved in each row of the step.
        unit: Unit of the values, with a space before it where one belongs there.
        least: Least number that is told.
    """
    beyond = max(
        float(values.max() - max(values[0], values[-1])),
        float(min(values[0], values[-1]) - values.min()),
    )
    return f", going {beyond:.1f}{unit} farther and back" if beyond > least else ""


def _slide(clearance: Clearance, drive: int, places: np.ndarray) -> str:
    """Return how far and where to a drive moves the load alone, in words."""
    both = np.array([places[0], places[0]])
    both[1, drive] = places[-1, drive]
    first, second = clearance.site.to_site(clearance.point(both))
    way = second - first
    axis = int(np.abs(way[:2]).argmax())
    sign = "+" if way[axis] > 0.0 else "-"
    return f"{np.linalg.norm(way):.1f} m towards {sign}{'xy'[axis]}"


def _speed(clearance: Clearance, drive: int, places: np.ndarray) -> str:
    """Return the largest rate of a drive in a step, in words."""
    joint = clearance.crane.layout.driven[drive]
    rate = float(np.abs(np.diff(places[:, drive])).max()) / STEP
    name = joint.role or joint.symbol
    if joint.kind == "revolute":
        return f"{name} {math.degrees(rate):.2f} °/s"
    return f"{name} {rate:.2f} m/s"


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
    steps = steps_of(scene)
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
    if phases["motion"] > 0.0:
        sentences.append(f"Lift-off at position 1 takes {phases['motion']:.0f} s.")
    if "set-down" in phases:
        number = scene.positions[-1].number
        takes = analysis.duration - phases["set-down"]
        sentences.append(f"Set-down at position {number} takes {takes:.0f} s.")
    return sentences


def _draw_step(
    canvas: Canvas, scene: LiftScene, index: int, step: SketchedStep, top: float
) -> None:
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
    canvas.text(left, top + 6.0, f"{step.number - 1} to {step.number}", bold=True, size=4.5)
    canvas.text(left + 18.0, top + 6.0, f"from {step.begins:.0f} s to {step.ends:.0f} s")
    letters = int((right - left) / text_width("x"))
    lines = []
    for sentence in step.movements:
        lines += textwrap.wrap(f"{sentence}.".replace("..", "."), letters)
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
