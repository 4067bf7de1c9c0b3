"""The plain loop against Pinocchio alone: physics steps a second, with control and logging, over
bare calls of ``pin.aba``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from benchmarks.timing import race
from cranedyn.controllers import hold_controller
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate

DURATION = 20.0
"""Simulated time of one round [s]."""

STEPS = 40_000
"""Number of physics steps of 0.5 ms in a round."""


def bare_calls(crane: Crane, calls: int = STEPS) -> None:
    """Call the articulated-body algorithm as often as a round has steps."""
    aba = pin.aba
    model = crane.model
    data = crane.data
    tau = np.array([0.0, 0.0, 0.0, 0.0, -9806.65])
    q, v = crane.state(phi=0.1, theta=0.05, phi_dot=0.1)
    for _ in range(calls):
        aba(model, data, q, v, tau)


def plain_swing(crane: Crane) -> None:
    """Simulate free swing under hold control at 200 Hz, logged at every control instant."""
    simulate(crane, hold_controller(crane), start=crane.state(phi=0.1), duration=DURATION)


class LoopRates(NamedTuple):
    """Rates of the plain loop and of Pinocchio alone.

    Attributes:
        bare: Bare calls of the algorithm a second.
        plain: Steps of the plain loop a second.
    """

    bare: float
    plain: float

    @property
    def ratio(self) -> float:
        """Rate of the plain loop over that of bare calls."""
        return self.plain / self.bare


def measure_loop(rounds: int) -> LoopRates:
    """Measure both in a number of rounds.

    The shortest time of each counts: it is the same work every time, and whatever else the machine
    does only adds to it.
    """
    crane = load_crane()
    rng = np.random.default_rng(0)
    tasks = [partial(task, crane) for task in (bare_calls, plain_swing)]
    rates = STEPS / race(tasks, rounds, rng, time.process_time).min(axis=1)
    return LoopRates(float(rates[0]), float(rates[1]))


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; 0 if the loop reaches the ratio asked for, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loop", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="pairs of measurements (default 7)")
    parser.add_argument("--least", type=float, default=0.35, help="ratio to reach (default 0.35)")
    options = parser.parse_args(argv)
    rates = measure_loop(max(options.rounds, 1))
    print(f"pin.aba from Python    {rates.bare:10,.0f} calls/s")
    real_time = rates.plain * DURATION / STEPS
    print(f"plain loop, all of it  {rates.plain:10,.0f} steps/s, {real_time:.0f} times real time")
    print(f"ratio                  {rates.ratio:10.3f} (asked for {options.least:g})")
    return 0 if rates.ratio >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
