"""Predictive control to a goal: how long random moves take until the load is at rest, beside moves
of least time under the same limits.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.analysis.swing import settling_time
from cranedyn.command import command
from cranedyn.compiled.horizon.receding import receding
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.lifts.planning.least_time import INTERVAL
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.lifts.planning.timing import RAMP
from cranedyn.model.crane import Crane
from cranedyn.model.description import arguments
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, finite_or_none, make_table
from experiments.harness.outcome import show
from experiments.scenarios.moves import LIMITS, SETTLED_DISTANCE, RestToRest

SLEW = (-1.0, 1.0)
"""Range from which the slew of a goal is drawn [rad]."""

RADIUS = (5.0, 20.0)
"""Range from which the trolley radius of start and goal is drawn [m]."""

LENGTH = (6.0, 22.0)
"""Range from which the cable length of start and goal is drawn [m]."""

SIZE = (0.05, 3.0)
"""Range from which the size of a crane is drawn, as a multiple of the default crane's."""

PERIOD = 5e-3
"""Control period [s]."""

SWING = 0.1
"""Largest swing of start and goal in each swing joint [rad]."""

WATCH_TIME = 45.0
"""Time for which each move is watched [s]."""

MAX_RATIO = 1.5
"""Largest settling time of a move of the default crane over the least time, as it is claimed."""

MAX_RATIO_OF_ANY_CRANE = 2.0
"""The same of cranes of their own, of which some have drives that suit each other worse."""


class SettlingTrial(NamedTuple):
    """A move of a crane.

    Attributes:
        size: Size of the crane, as a multiple of the default crane's.
        limits: Limits of its drives.
        move: The move.
    """

    size: float
    limits: Limits
    move: RestToRest


class SettlingTimes(NamedTuple):
    """Times of a move.

    Attributes:
        move: The move.
        least: Least time in which it can be made [s].
        taken: Time until the load is at rest by predictive control [s]; infinite if it is not.
    """

    move: RestToRest
    least: float
    taken: float

    @property
    def ratio(self) -> float:
        """Time by predictive control over the least time."""
        return self.taken / self.least


def trials(count: int, seed: int, any_crane: bool = False) -> list[SettlingTrial]:
    """Return random moves from rest to rest; fewer of one seed are the first of more.

    Args:
        count: Number of moves.
        seed: Seed of all that is random.
        any_crane: Whether each is of a crane of its own: a scaled one, whose drives are up to twice
            as quick or slow as those of the default crane would be.
    """
    rng = np.random.default_rng(seed)
    size = 1.0
    quickness = np.ones(3)
    drawn = []
    for i in range(count):
        if any_crane:
            size = math.exp(rng.uniform(*np.log(SIZE)))
            quickness = 2.0 ** rng.uniform(-1.0, 1.0, 3)
        start = _random_end(rng, size, 0.0)
        goal = _random_end(rng, size, rng.uniform(*SLEW))
        move = RestToRest(f"{i + 1}", start, goal, duration=0.0)
        drawn.append(SettlingTrial(size, alike(size, quickness), move))
    return drawn


def _random_end(rng: np.random.Generator, size: float, slew: float) -> tuple[float, float, float]:
    """Return slew [rad], random trolley radius and random cable length of a crane of a size [m]."""
    radius = size * rng.uniform(*RADIUS)
    length = size * rng.uniform(*LENGTH)
    return slew, radius, length


def scaled_crane(size: float) -> Crane:
    """Return the default crane with all its lengths multiplied, at the same density."""
    if size == 1.0:
        return load_crane()
    usual = arguments()
    # The power of the size with which each number goes, in the same gravity: masses with the third,
    # inertias with the fifth, times with the half.
    powers: dict[str, float] = {
        "slew_effort": 4,
        "trolley_effort": 3,
        "hoist_effort": 3,
        "damp_swing": 4.5,
        "slew_velocity": -0.5,
    }
    for length in ("mast_height", "pivot_height", "total_height"):
        powers[length] = 1
    for end in ("min", "max", "init"):
        powers[f"trolley_{end}"] = 1
        powers[f"hoist_{end}"] = 1
    for body in ("payload", "upper", "trolley", "dummy"):
        powers[f"{body}_mass"] = 3
    for body in ("payload", "slewing", "trolley", "dummy"):
        powers[f"{body}_inertia"] = 5
    values = {name: float(usual[name].default) * size**power for name, power in powers.items()}
    return load_crane(**values)


def alike(size: float, quickness: np.ndarray) -> Limits:
    """Return limits under which a scaled crane moves as the default one does.

    Args:
        size: Size of the crane.
        quickness: Factor on the acceleration of each drive; its rate goes with the square root.
    """
    rates = np.array(LIMITS.rates)
    accelerations = np.array(LIMITS.accelerations)
    return Limits(
        rates=rates * np.sqrt(quickness) * size ** np.array([-0.5, 0.5, 0.5]),
        accelerations=accelerations * quickness * size ** np.array([-1.0, 0.0, 0.0]),
    )


def settle(drawn: Sequence[SettlingTrial]) -> list[SettlingTimes]:
    """Make moves by predictive control with its defaults, and plan each in the least time."""
    settled = []
    for size, limits, move in drawn:
        crane = scaled_crane(size)
        time = math.sqrt(size)
        start, goal = move.ends(crane)
        run = simulate(
            crane,
            receding(crane, limits, swing_limit=SWING),
            hold(crane, goal),
            start=start,
            duration=PERIOD * round(time * WATCH_TIME / PERIOD),
            engine="compiled",
            validity="mark",
        )
        place = payload_position(crane, goal.q)
        distances = [np.linalg.norm(payload_position(crane, q) - place) for q in run.q]
        planned = optimal(
            crane, start, goal, limits, swing=SWING, ramp=time * RAMP, interval=time * INTERVAL
        )
        taken = settling_time(run.t, np.array(distances), size * SETTLED_DISTANCE)
        settled.append(SettlingTimes(move, planned.arrival, taken))
    return settled


def judge_moves(moves: Sequence[SettlingTimes], allowed: float) -> Outcome:
    """Return the table of moves and the claim on the worst of them."""
    table = make_table(
        "Random moves by predictive control to the goal, and in the least time",
        moves,
        ("x, l from [m]", "", lambda one: _start_text(one.move)),
        ("γ, x, l to [rad, m]", "", lambda one: _goal_text(one.move)),
        ("least [s]", ".2f", lambda one: one.least),
        ("settled [s]", ".2f", lambda one: finite_or_none(one.taken)),
        ("ratio", ".2f", lambda one: one.ratio),
        note="Settled: from the start until the payload stays within "
        f"{1e3 * SETTLED_DISTANCE:g} mm of its goal; a dash where it does not in "
        f"{WATCH_TIME:g} s. Both keep the same rates and accelerations and {1e3 * SWING:g} mrad of "
        "swing. For a crane of another size distances go with that, times with its root.",
    )
    worst = max(settled.ratio for settled in moves)
    sentence = (
        f"Predictive control to a goal settles within {allowed:g} times the least time in each of "
        f"{len(moves)} random moves ({worst:.2f} at most)."
    )
    return Outcome([table], [Claim(sentence, worst <= allowed)])


def _start_text(move: RestToRest) -> str:
    _, radius, length = move.start
    return f"{radius:.1f}, {length:.1f}"


def _goal_text(move: RestToRest) -> str:
    slew, radius, length = move.goal
    return f"{slew:.2f}, {radius:.1f}, {length:.1f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print and judge; exit code 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.settling", description=__doc__)
    parser.add_argument("--moves", type=int, default=10, help="how many (default 10)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moves (default 1)")
    parser.add_argument("--any-crane", action="store_true", help="each of a random crane")
    options = parser.parse_args(argv)
    if options.moves < 1 or options.seed < 0:
        parser.error("--moves is 1 or more, --seed 0 or more")

    def run() -> int:
        drawn = trials(options.moves, options.seed, options.any_crane)
        allowed = MAX_RATIO_OF_ANY_CRANE if options.any_crane else MAX_RATIO
        outcome = judge_moves(settle(drawn), allowed)
        show(outcome)
        return 0 if all(claim.holds for claim in outcome.claims) else 1

    return command(run)


if __name__ == "__main__":
    sys.exit(main())
