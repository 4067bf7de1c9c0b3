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
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.horizon.receding import receding
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.model.load import load_crane
from cranedyn.planning.optimal import optimal
from cranedyn.references import hold
from experiments.harness import Claim, Outcome, Table
from experiments.harness.outcome import show
from experiments.scenarios.moves import CLOSE, LIMITS, Move

SLEW, RADIUS, LENGTH = (-1.0, 1.0), (5.0, 20.0), (6.0, 22.0)
"""Between which moves are drawn: slew of the goal [rad]; trolley radius and cable length of start
and goal [m]."""

SWING, RATIO, LASTS = 0.1, 1.5, 45.0
"""Largest swing of both [rad]; how many times the least time is claimed at most; how long each move
is watched [s]."""


class Settled(NamedTuple):
    """What a move took [s]: at least, and by predictive control."""

    move: Move
    least: float
    taken: float

    @property
    def ratio(self) -> float:
        """The one over the other."""
        return self.taken / self.least


def moves(count: int, seed: int) -> list[Move]:
    """Random moves from rest to rest; fewer of one seed are the first of more."""
    rng = np.random.default_rng(seed)

    def end(slew: float) -> tuple[float, float, float]:
        return slew, rng.uniform(*RADIUS), rng.uniform(*LENGTH)

    return [Move(f"{i + 1}", end(0.0), end(rng.uniform(*SLEW)), 0.0) for i in range(count)]


def settle(drawn: Sequence[Move]) -> list[Settled]:
    """Make moves by predictive control, and plan each in the least time."""
    crane = load_crane()
    ends = [move.ends(crane) for move in drawn]
    batch = simulate_batch(
        crane,
        receding(crane, LIMITS, swing_limit=SWING),
        [hold(crane, goal) for _, goal in ends],
        start=[start for start, _ in ends],
        duration=LASTS,
        record=1,
    )
    found = []
    for move, (start, goal), rows in zip(drawn, ends, batch.q, strict=True):
        there = payload_position(crane, goal.q)
        away = np.array([np.linalg.norm(payload_position(crane, q) - there) for q in rows])
        least = optimal(crane, start, goal, LIMITS, swing=SWING).arrival
        found.append(Settled(move, least, settling_time(batch.t, away, CLOSE)))
    return found


def judged(found: Sequence[Settled]) -> Outcome:
    """The moves in a table, and the claim, judged on the worst of them."""
    rows = [
        (*_place(one.move), one.least, one.taken if math.isfinite(one.taken) else None, one.ratio)
        for one in found
    ]
    table = Table(
        "Random moves by predictive control to the goal, and in the least time",
        [
            ("x, l from [m]", ""),
            ("γ, x, l to [rad, m]", ""),
            ("least [s]", ".2f"),
            ("settled [s]", ".2f"),
            ("ratio", ".2f"),
        ],
        rows,
        f"Settled: from the start until the payload stays within {1e3 * CLOSE:g} mm of its goal; "
        f"a dash where it does not in {LASTS:g} s. Both keep the same rates and accelerations and "
        f"{1e3 * SWING:g} mrad of swing.",
    )
    worst = max(one.ratio for one in found)
    sentence = (
        f"Predictive control to a goal settles within {RATIO:g} times the least time in each of "
        f"{len(found)} random moves ({worst:.2f} at most)."
    )
    return Outcome([table], [Claim(sentence, worst <= RATIO)])


def _place(move: Move) -> tuple[str, str]:
    (_, x, length), (slew, radius, end) = move.start, move.goal
    return f"{x:.1f}, {length:.1f}", f"{slew:.2f}, {radius:.1f}, {end:.1f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print and judge; exit code 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.settling", description=__doc__)
    parser.add_argument("--moves", type=int, default=10, help="how many (default 10)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moves (default 1)")
    options = parser.parse_args(argv)
    if options.moves < 1 or options.seed < 0:
        parser.error("--moves is 1 or more, --seed 0 or more")

    def run() -> int:
        outcome = judged(settle(moves(options.moves, options.seed)))
        show(outcome)
        return 0 if all(claim.holds for claim in outcome.claims) else 1

    return command(run)


if __name__ == "__main__":
    sys.exit(main())
