"""The steps of a lift: from one numbered position to the next, when, what the crane does, and how
fast.

The positions are those that the drawings number, see
`cranedyn.lifts.judging.numbered_positions`: whoever reads "2 to 3" in the table finds 2 and 3 on
the plan.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.numbered_positions import numbered_positions
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.timing import STEP

LEAST_WAY = 0.05
"""Way of a drive in a step up to which it is not told [m]."""

LEAST_TURN = math.radians(0.5)
"""Turn of a drive in a step up to which it is not told [rad]."""


@dataclass(frozen=True)
class LiftStep:
    """A step of a lift.

    Attributes:
        positions: The numbers of the positions between which it is, such as "2 to 3"; "1" or the
            last number alone for a step that lifts the load off or sets it down.
        begins, ends: When it begins and ends [s], from the beginning of the lift.
        action: What the crane does, in words.
        speeds: The largest rate of each drive that moves, in words; empty where it is not told.
        place: Place of the load at its end in the frame of the site [m], shape (3,).
    """

    positions: str
    begins: float
    ends: float
    action: str
    speeds: str
    place: np.ndarray


def lift_steps(analysis: LiftAnalysis) -> list[LiftStep]:
    """Return the steps of a lift in order, lift-off and set-down among them where they are
    simulated.
    """
    lift = analysis.certificate.lift
    clearance = lift.clearance
    grounded = analysis.grounded
    motion_begins = 0.0 if grounded is None else grounded.lift.phases["motion"]
    positions = numbered_positions(analysis)
    last = positions[-1]

    steps: list[LiftStep] = []
    if grounded is not None and "lift-off" in grounded.lift.phases:
        action = "lift off: take up the slack, raise the load off its support, wait"
        steps.append(LiftStep("1", 0.0, motion_begins, action, "", positions[0].centre))
    for before, after in itertools.pairwise(positions):
        places = lift.timed.places[before.row : after.row + 1]
        step = LiftStep(
            positions=f"{before.number} to {after.number}",
            begins=motion_begins + before.t,
            ends=motion_begins + after.t,
            action=_action(clearance, places),
            speeds=_speeds(clearance, places),
            place=after.centre,
        )
        steps.append(step)
    if grounded is not None and "set-down" in grounded.lift.phases:
        begins = grounded.lift.phases["set-down"]
        action = "set down: lower the load onto its support until the rope is slack"
        step = LiftStep(str(last.number), begins, analysis.duration, action, "", last.centre)
        steps.append(step)
    return steps


def _moving(clearance: Clearance, places: np.ndarray) -> list[int]:
    """Return the drives that move in some places, shape (n, 3), by more than what is not told."""
    moved = np.abs(places[-1] - places[0])
    moving = []
    for drive, joint in enumerate(clearance.crane.layout.driven):
        least = LEAST_TURN if joint.kind == "revolute" else LEAST_WAY
        if moved[drive] > least:
            moving.append(drive)
    return moving


def _action(clearance: Clearance, places: np.ndarray) -> str:
    """Return what the drives do from the first to the last of some places, in words."""
    words = [_drive_action(clearance, places, drive) for drive in _moving(clearance, places)]
    return ", ".join(words) or "move by less than is told here"


def _drive_action(clearance: Clearance, places: np.ndarray, drive: int) -> str:
    """Return what a drive does from the first to the last of some places, in words."""
    crane = clearance.crane
    joints = LoadJoints.of(crane)
    index = int(crane.layout.drives[drive])
    joint = crane.layout.driven[drive]
    change = float(places[-1, drive] - places[0, drive])
    if index == joints.hoist:
        return f"{'hoist' if change < 0.0 else 'lower'} {abs(change):.1f} m"
    foot = clearance.site.foot
    if index == joints.slew:
        # A small part of the turn tells its side, also of more than half a turn.
        before, after = _by_one_drive(clearance, places[0], drive, 0.01 * change)
        side = "left" if _turn(before - foot, after - foot) > 0.0 else "right"
        return f"slew {math.degrees(abs(change)):.0f}° to the {side}"
    before, after = _by_one_drive(clearance, places[0], drive, change)
    if joints.slew is not None:
        first = float(np.linalg.norm((before - foot)[:2]))
        last = float(np.linalg.norm((after - foot)[:2]))
        verb = "luff" if joint.kind == "revolute" else "trolley"
        return f"{verb} {'out' if last > first else 'in'} from {first:.1f} m to {last:.1f} m"
    name = joint.role or joint.symbol
    return f"{name} {abs(change):.1f} m {_direction(after - before)}"


def _by_one_drive(
    clearance: Clearance, place: np.ndarray, drive: int, change: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the load is at a place, and where it is if one drive alone has moved from there
    [m], in the frame of the site, shape (3,) each.
    """
    places = np.array([place, place])
    places[1, drive] += change
    before, after = clearance.site.to_site(clearance.point(places))
    return before, after


def _turn(before: np.ndarray, after: np.ndarray) -> float:
    """Return the sine of the turn from one direction in plan to another, by its sign: positive to
    the left, seen from above and from behind. Both are less than half a turn apart.
    """
    return float(before[0] * after[1] - before[1] * after[0])


def _direction(way: np.ndarray) -> str:
    """Return the axis of the site along which a way goes, in words."""
    axis = int(np.abs(way).argmax())
    return f"towards {'+' if way[axis] > 0.0 else '-'}{'xyz'[axis]}"


def _speeds(clearance: Clearance, places: np.ndarray) -> str:
    """Return the largest rate of each drive that moves in some places, in words."""
    rates = np.abs(np.diff(places, axis=0)).max(axis=0) / STEP
    words = []
    for drive in _moving(clearance, places):
        joint = clearance.crane.layout.driven[drive]
        name = joint.role or joint.symbol
        if joint.kind == "revolute":
            words.append(f"{name} {math.degrees(rates[drive]):.1f} °/s")
        else:
            words.append(f"{name} {rates[drive]:.2f} m/s")
    return ", ".join(words)
