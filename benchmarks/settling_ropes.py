"""Predictive control of cranes whose rope stretches or goes slack, or whose load hangs on two
falls: how long a combined move takes until the load is at rest, beside the crane on a rigid rope.

The controller plans on the crane with the rigid rope, see `cranedyn.model.rigid_rope`; the full
crane is simulated.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.analysis.swing import settling_time
from cranedyn.command import command
from cranedyn.compiled.horizon.receding import receding
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, finite_or_none, make_table
from experiments.harness.outcome import show
from experiments.scenarios.moves import LIMITS, SETTLED_DISTANCE

RIGID = "rigid"
"""Name of the rope with which the others are compared."""

ROPES: dict[str, dict[str, float]] = {
    RIGID: {},
    "EA 10 MN, damped": {"rope_stiffness": 1e7, "rope_damping": 500.0},
    "EA 10 MN, undamped": {"rope_stiffness": 1e7},
    "EA 1 MN, damped": {"rope_stiffness": 1e6, "rope_damping": 500.0},
    "inextensible, may go slack": {"rope_stiffness": np.inf},
    "two falls, 1 m apart": {"fall_spacing": 1.0},
}
"""Arguments of cranes by their ropes. A steel rope of 16 mm has an EA of about 10 MN."""

START = {"x": 10.0, "l": 15.0}
"""Coordinates from which the load is moved [m]."""

GOAL = {"gamma": 0.6, "x": 20.0, "l": 10.0}
"""Coordinates to which it is moved [rad, m]."""

DURATION = 25.0
"""Time for which the move is watched [s]."""

LAST = 5.0
"""Time at the end over which the swing that is left is measured [s]."""

MAX_DELAY = 0.1
"""Largest time that a rope may take longer than the rigid one, as it is claimed [s]."""


class RopeMove(NamedTuple):
    """A move of a crane.

    Attributes:
        rope: Name of its rope.
        drive: Drive mode.
        settled: Time until the load stays at its goal [s]; infinite if it does not.
        swing: Largest swing of the rope at the end [rad].
        stretch: Largest stretch of the rope on the way [m]; None if it has none.
        yaw: Largest yaw of the load against the rope at the end [rad]; None if it has none.
        failures: Number of failed optimisations.
    """

    rope: str
    drive: Drive
    settled: float
    swing: float
    stretch: float | None
    yaw: float | None
    failures: int


def move(rope: str, drive: Drive) -> RopeMove:
    """Make the move on a rope by predictive control with its defaults."""
    crane = load_crane(**ROPES[rope])  # type: ignore[arg-type]
    start = _hanging(crane, START)
    goal = _hanging(crane, GOAL)
    controller = receding(crane, LIMITS, drive=drive)
    run = simulate(
        crane,
        controller,
        hold(crane, goal),
        start=start,
        duration=DURATION,
        drive=drive,
        engine="compiled",
        validity="mark",
    )
    place = payload_position(crane, goal.q)
    distances = [np.linalg.norm(payload_position(crane, q) - place) for q in run.q]
    at_end = run.t >= DURATION - LAST
    stretch = None
    if crane.springs.rope is not None:
        stretch = float(run.q[:, crane.springs.rope.stretch].max())
    yaw = None
    if crane.springs.bifilar is not None:
        yaw = float(np.abs(run.q[at_end, crane.springs.bifilar.yaw]).max())
    return RopeMove(
        rope,
        drive,
        settling_time(run.t, np.array(distances), SETTLED_DISTANCE),
        float(np.abs(run.q[at_end][:, crane.swings]).max()),
        stretch,
        yaw,
        controller.status.failures,
    )


def _hanging(crane: Crane, coordinates: dict[str, float]) -> State:
    """Return the state at which a crane hangs at rest with drives at some coordinates."""
    state = crane.state(**coordinates)
    return State(crane.hanging(state.q), state.v)


def judge_ropes(moves: Sequence[RopeMove]) -> Outcome:
    """Return the table of moves and the claim on the worst of them."""
    rigid = {one.drive: one for one in moves if one.rope == RIGID}

    def delay(one: RopeMove) -> float:
        """Return the time that a move takes longer than on the rigid rope [s]."""
        return one.settled - rigid[one.drive].settled

    table = make_table(
        "Predictive control on the rigid rope, of cranes on other ropes",
        moves,
        ("rope", "", lambda one: one.rope),
        ("drive", "", lambda one: one.drive),
        ("settled [s]", ".2f", lambda one: finite_or_none(one.settled)),
        ("later [s]", "+.2f", lambda one: finite_or_none(delay(one))),
        ("swing left [mrad]", ".3f", lambda one: 1e3 * one.swing),
        ("stretch [mm]", ".1f", lambda one: None if one.stretch is None else 1e3 * one.stretch),
        ("yaw left [mrad]", ".1f", lambda one: None if one.yaw is None else 1e3 * one.yaw),
        ("failed", ".0f", lambda one: one.failures),
        note="Settled: from the start until the payload stays within "
        f"{1e3 * SETTLED_DISTANCE:g} mm of its goal; later than on the rigid rope. Swing and yaw "
        f"left: the largest in the last {LAST:g} s of {DURATION:g} s. Stretch: the largest on the "
        "way. Nothing damps the yaw of the default crane.",
    )
    worst = max(delay(one) for one in moves)
    sentence = (
        f"Predictive control that plans on a rigid rope settles within {MAX_DELAY:g} s of that on "
        f"every rope ({worst:+.2f} s at most)."
    )
    return Outcome([table], [Claim(sentence, worst <= MAX_DELAY)])


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print and judge; exit code 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.settling_ropes", description=__doc__
    )
    parser.parse_args(argv)

    def run() -> int:
        drives: tuple[Drive, ...] = ("effort", "velocity")
        outcome = judge_ropes([move(rope, drive) for rope in ROPES for drive in drives])
        show(outcome)
        return 0 if all(claim.holds for claim in outcome.claims) else 1

    return command(run)


if __name__ == "__main__":
    sys.exit(main())
