"""The steps of a lift: from one numbered position to the next, when, what the crane does, and how
fast.

The positions are those that the drawings number, see
`cranedyn.lifts.judging.numbered_positions`: whoever reads "2 to 3" in the table finds 2 and 3 on
the plan. The table of the steps and the sketches of `cranedyn.lifts.judging.drawings.sequence` say
the same words.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.hook_radius import hook_radius
from cranedyn.lifts.judging.numbered_positions import (
    LoadAtRest,
    Position,
    loads_at_rest,
    numbered_positions,
)
from cranedyn.lifts.judging.table import BLANK, place_text
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.ground_lift import stands_at

LEAST_WAY = 0.05
"""Way of a drive in a step up to which it is not told [m]."""

LEAST_TURN = math.radians(0.5)
"""Turn of a drive in a step up to which it is not told [rad]."""


@dataclass(frozen=True)
class LiftStep:
    """A step of a lift.

    Attributes:
        first, last: Numbers of the positions between which it is; the same one for a step that
            lifts the load off or sets it down.
        begins, ends: When it begins and ends [s], from the beginning of the lift.
        movements: What the crane does, in sentences without a full stop.
        speeds: The largest rate of each drive that moves, in words; empty where it is not told.
        place: Place of the load at its end in the frame of the site [m], shape (3,).
    """

    first: int
    last: int
    begins: float
    ends: float
    movements: tuple[str, ...]
    speeds: tuple[str, ...]
    place: np.ndarray

    @property
    def positions(self) -> str:
        """The numbers of the positions, such as "2 to 3"."""
        return str(self.last) if self.first == self.last else f"{self.first} to {self.last}"


def lift_steps(analysis: LiftAnalysis) -> list[LiftStep]:
    """Return the steps of a lift in order, lift-off and set-down among them where they are
    simulated.
    """
    phases = {} if analysis.grounded is None else analysis.grounded.lift.phases
    positions = numbered_positions(analysis)
    stands = loads_at_rest(analysis)
    steps: list[LiftStep] = []
    if stands.pick_up is not None:
        movement = (
            f"Lift off from {place_text(stands.pick_up.centre)}: take up the slack, raise the "
            f"load off its support{_by(stands.pick_up, positions[0])}, wait"
        )
        ends = phases["motion"]
        steps.append(LiftStep(1, 1, 0.0, ends, (movement,), (), positions[0].centre))
    steps += motion_steps(analysis, positions)
    if stands.set_down is not None:
        begins = phases["set-down"]
        last = positions[-1]
        movement = (
            f"Set down: lower the load{_by(stands.set_down, last)} onto its support until the "
            "rope is slack"
        )
        place = stands.set_down.centre
        steps.append(
            LiftStep(last.number, last.number, begins, analysis.duration, (movement,), (), place)
        )
    return steps


@dataclass(frozen=True)
class StepByHand:
    """A step that is not in the simulated lift: people work while the crane stands, for as long as
    they need, or the crane lifts off or sets down where that is not simulated.

    Attributes:
        position: Number of the position at which it is.
        what: What happens, in a sentence without a full stop.
    """

    position: int
    what: str


def all_steps(analysis: LiftAnalysis) -> list[LiftStep | StepByHand]:
    """Return the steps of a lift in order, with slinging, the trial lift and unhooking among those
    of `lift_steps`. A load that hangs at an end is slung and tried, or unhooked, in another lift.
    """
    details = analysis.site.details
    stands = loads_at_rest(analysis)
    timed = lift_steps(analysis)
    last = timed[-1].last
    steps: list[LiftStep | StepByHand] = [*timed]
    before: list[LiftStep | StepByHand] = []
    if stands_at(analysis.site.start):
        slinging = "Sling the load"
        if details.tag_lines is not None:
            slinging += f"; tag lines: {details.tag_lines}"
        before.append(StepByHand(1, slinging))
        trial = details.trial_lift or BLANK
        before.append(StepByHand(1, f"Trial lift: {trial}; then lift off"))
        if stands.pick_up is None:
            before.append(StepByHand(1, "Lift off; not simulated"))
    if stands_at(analysis.site.goal):
        if stands.set_down is None:
            steps.append(StepByHand(last, "Set down; not simulated"))
        steps.append(StepByHand(last, "Unhook the load, hoist the empty hook clear of it"))
    return before + steps


def _by(stands: LoadAtRest, hangs: Position) -> str:
    """Return by how much a load that hangs is above the place where it stands, in words."""
    return f" by {float(hangs.centre[2] - stands.centre[2]):.1f} m"


def motion_steps(analysis: LiftAnalysis, positions: list[Position]) -> list[LiftStep]:
    """Return the steps of the planned motion, from each position to the next."""
    lift = analysis.certificate.lift
    clearance = lift.clearance
    grounded = analysis.grounded
    motion_begins = 0.0 if grounded is None else grounded.lift.phases["motion"]
    steps = []
    for before, after in itertools.pairwise(positions):
        places = lift.timed.places[before.row : after.row + 1]
        # The places are those of the load; the drives lead it, and are faster at times.
        motion = lift.timed.motion
        first, last = (round(position.t / motion.period) for position in (before, after))
        driven = motion.q[first : last + 1, clearance.drive_joints]
        rates = np.abs(np.diff(driven, axis=0)).max(axis=0) / motion.period
        drives = _moving(clearance, places)
        movements = [_movement(clearance, places, drive) for drive in drives]
        steps.append(
            LiftStep(
                first=before.number,
                last=after.number,
                begins=motion_begins + before.t,
                ends=motion_begins + after.t,
                movements=tuple(movements) or ("No drive moves by as much as is told here",),
                speeds=tuple(_speed(clearance, float(rates[drive]), drive) for drive in drives),
                place=after.centre,
            )
        )
    return steps


def _moving(clearance: Clearance, places: np.ndarray) -> list[int]:
    """Return the drives that move in some places, shape (n, 3), by more than what is not told."""
    moved = np.ptp(places, axis=0)
    moving = []
    for drive, joint in enumerate(clearance.crane.layout.driven):
        least = LEAST_TURN if joint.kind == "revolute" else LEAST_WAY
        if moved[drive] > least:
            moving.append(drive)
    return moving


def _movement(clearance: Clearance, places: np.ndarray, drive: int) -> str:
    """Return what a drive does from the first to the last of some places, in a sentence without a
    full stop.
    """
    joint = clearance.crane.layout.driven[drive]
    if drive == _hoist(clearance):
        return _hoisting(clearance, places)
    if drive == clearance.turning:
        turns = clearance.load_turn(places)
        turn = float(turns[-1] - turns[0])
        side = "left" if turn > 0.0 else "right"
        sentence = f"Slew {math.degrees(abs(turn)):.0f}° to the {side}"
        return sentence + _detour(np.degrees(turns - turns[0]), "°", 1.0)
    name = joint.role or joint.symbol
    first = hook_radius(clearance, places[0])
    last = hook_radius(clearance, places[-1])
    if first is not None and last is not None:
        verb = "Luff" if joint.kind == "revolute" else name.capitalize()
        way = "out" if last > first else "in"
        return f"{verb} {way}, radius from {first:.1f} m to {last:.1f} m"
    return f"{name.capitalize()} {_slide(clearance, places, drive)}"


def _hoist(clearance: Clearance) -> int:
    """Return the index of the hoist among the drives of a place."""
    return clearance.drive_joints.tolist().index(clearance.hoist)


def _hoisting(clearance: Clearance, places: np.ndarray) -> str:
    """Return what the hoist does in some places. Heights are those of the load's underside, which a
    boom that luffs moves, too.
    """
    hoist = _hoist(clearance)
    cable = places[:, hoist]
    length = float(cable[-1] - cable[0])
    sentence = f"{'Lower' if length > 0.0 else 'Hoist'} {abs(length):.1f} m"
    luffs = False
    for i, joint in enumerate(clearance.crane.layout.driven):
        luffs = luffs or (joint.kind == "revolute" and i not in (clearance.turning, hoist))
    if luffs:
        sentence += " of rope"
    else:
        below = float(clearance.bodies.load[:, 2].min())
        centres = clearance.site.to_site(clearance.point(places[[0, -1]]))
        first, last = (centres[:, 2] + below - clearance.site.ground).tolist()
        # A short way shows only in centimetres.
        digits = 1 if abs(last - first) > 0.3 else 2
        sentence += f", the load from {first:.{digits}f} m to {last:.{digits}f} m above ground"
    return sentence + _detour(cable - cable[0], " m of rope", 0.2)


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


def _slide(clearance: Clearance, places: np.ndarray, drive: int) -> str:
    """Return how far and where to a drive moves the load alone, in words."""
    both = np.array([places[0], places[0]])
    both[1, drive] = places[-1, drive]
    first, second = clearance.site.to_site(clearance.point(both))
    way = second - first
    axis = int(np.abs(way[:2]).argmax())
    sign = "+" if way[axis] > 0.0 else "-"
    return f"{np.linalg.norm(way):.1f} m towards {sign}{'xy'[axis]}"


def _speed(clearance: Clearance, rate: float, drive: int) -> str:
    """Return the largest rate of a drive [rad/s or m/s] in words."""
    joint = clearance.crane.layout.driven[drive]
    name = joint.role or joint.symbol
    if joint.kind == "revolute":
        return f"{name} {math.degrees(rate):.1f} °/s"
    return f"{name} {rate:.2f} m/s"
