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
from experiments.harness import Claim, Outcome, ResultTable
from experiments.harness.outcome import show
from experiments.scenarios.moves import CLOSE, LIMITS, RestToRest

SLEW = (-1.0, 1.0)
"""Range from which the slew of a goal is drawn [rad]."""

RADIUS = (5.0, 20.0)
"""Range from which the trolley radius of start and goal is drawn [m]."""

LENGTH = (6.0, 22.0)
"""Range from which the cable length of start and goal is drawn [m]."""

SIZE = (0.05, 3.0)
"""Between which sizes cranes are drawn, as multiples of the default crane's."""

PERIOD = 5e-3
"""Control period [s]."""

SWING = 0.1
"""Largest swing of start and goal in each swing joint [rad]."""

WATCH_TIME = 45.0
"""Time for which each move is watched [s]."""

RATIO = {False: 1.5, True: 2.0}
"""How many times the least time is claimed at most: of moves of the default crane, and of cranes of
their own, of which some have drives that suit each other worse."""


class SettlingTrial(NamedTuple):
    """A move of a crane of some size, as a multiple of the default crane's, under limits of its
    drives.
    """

    size: float
    limits: Limits
    move: RestToRest


class SettlingTimes(NamedTuple):
    """What a move took [s]: at least, and by predictive control."""

    move: RestToRest
    least: float
    taken: float

    @property
    def ratio(self) -> float:
        """The one over the other."""
        return self.taken / self.least


def trials(count: int, seed: int, any_crane: bool = False) -> list[SettlingTrial]:
    """Return random moves from rest to rest; fewer of one seed are the first of more.

    Args:
        count: How many.
        seed: Of what is drawn.
        any_crane: Whether each is of a crane of its own: a scaled one, whose drives are up to twice
            as quick or slow as those of the default crane would be.
    """
    rng = np.random.default_rng(seed)
    size = 1.0
    quick = np.ones(3)

    def end(slew: float) -> tuple[float, float, float]:
        return slew, size * rng.uniform(*RADIUS), size * rng.uniform(*LENGTH)

    drawn = []
    for i in range(count):
        if any_crane:
            size = math.exp(rng.uniform(*np.log(SIZE)))
            quick = 2.0 ** rng.uniform(-1.0, 1.0, 3)
        move = RestToRest(f"{i + 1}", end(0.0), end(rng.uniform(*SLEW)), 0.0)
        drawn.append(SettlingTrial(size, alike(size, quick), move))
    return drawn


def scaled_crane(size: float) -> Crane:
    """Return the default crane with all its lengths multiplied, at the same density."""
    if size == 1.0:
        return load_crane()
    usual = arguments()
    powers = {
        **{f"trolley_{end}": 1 for end in ("min", "max", "init")},
        **{f"hoist_{end}": 1 for end in ("min", "max", "init")},
        **{f"{body}_mass": 3 for body in ("payload", "upper", "trolley", "dummy")},
        **{f"{body}_inertia": 5 for body in ("payload", "slewing", "trolley", "dummy")},
        **{"slew_effort": 4, "trolley_effort": 3, "hoist_effort": 3, "damp_swing": 4.5},
        **{"mast_height": 1, "pivot_height": 1, "total_height": 1, "slew_velocity": -0.5},
    }
    values = {name: float(usual[name].default) * size**power for name, power in powers.items()}
    return load_crane(**values)


def alike(size: float, quick: np.ndarray) -> Limits:
    """Return limits under which a scaled crane moves alike, with accelerations multiplied by drive
    and rates by the square root.
    """
    rates = np.array(LIMITS.rates)
    accelerations = np.array(LIMITS.accelerations)
    return Limits(
        rates=rates * np.sqrt(quick) * size ** np.array([-0.5, 0.5, 0.5]),
        accelerations=accelerations * quick * size ** np.array([-1.0, 0.0, 0.0]),
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
        away = np.array([np.linalg.norm(payload_position(crane, q) - place) for q in run.q])
        planned = optimal(
            crane, start, goal, limits, swing=SWING, ramp=time * RAMP, interval=time * INTERVAL
        )
        taken = settling_time(run.t, away, size * CLOSE)
        settled.append(SettlingTimes(move, planned.arrival, taken))
    return settled


def judge_moves(moves: Sequence[SettlingTimes], allowed: float) -> Outcome:
    """Return the table of moves and the claim on the worst of them."""
    rows = [
        (*_place(one.move), one.least, one.taken if math.isfinite(one.taken) else None, one.ratio)
        for one in moves
    ]
    columns = [("x, l from [m]", ""), ("γ, x, l to [rad, m]", ""), ("least [s]", ".2f")]
    table = ResultTable(
        "Random moves by predictive control to the goal, and in the least time",
        [*columns, ("settled [s]", ".2f"), ("ratio", ".2f")],
        rows,
        f"Settled: from the start until the payload stays within {1e3 * CLOSE:g} mm of its goal; "
        f"a dash where it does not in {WATCH_TIME:g} s. Both keep the same rates and accelerations "
        f"and {1e3 * SWING:g} mrad of swing. For a crane of another size distances go with that, "
        "times with its root.",
    )
    worst = max(settled.ratio for settled in moves)
    sentence = (
        f"Predictive control to a goal settles within {allowed:g} times the least time in each of "
        f"{len(moves)} random moves ({worst:.2f} at most)."
    )
    return Outcome([table], [Claim(sentence, worst <= allowed)])


def _place(move: RestToRest) -> tuple[str, str]:
    _, x, length = move.start
    slew, radius, end = move.goal
    return f"{x:.1f}, {length:.1f}", f"{slew:.2f}, {radius:.1f}, {end:.1f}"


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
        outcome = judge_moves(settle(drawn), RATIO[options.any_crane])
        show(outcome)
        return 0 if all(claim.holds for claim in outcome.claims) else 1

    return command(run)


if __name__ == "__main__":
    sys.exit(main())
