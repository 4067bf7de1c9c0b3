"""The plain loop against Pinocchio alone: physics steps a second, with control and logging, over
bare calls of ``pin.aba``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from cranedyn.controllers import hold_controller
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate

DURATION, STEPS = 20.0, 40_000
"""Simulated time of one round [s], and its physics steps of 0.5 ms."""


def bare(crane: Crane, calls: int = STEPS) -> None:
    """Calls of the articulated-body algorithm, as many as a round has steps, and nothing else."""
    aba, model, data, tau = (
        pin.aba,
        crane.model,
        crane.data,
        np.array([0.0, 0.0, 0.0, 0.0, -9806.65]),
    )
    q, v = crane.state(phi=0.1, theta=0.05, phi_dot=0.1)
    for _ in range(calls):
        aba(model, data, q, v, tau)


def plain(crane: Crane) -> None:
    """A round of free swing: hold control at 200 Hz, every control instant logged, the energy
    ledger made.
    """
    simulate(crane, hold_controller(crane), start=crane.state(phi=0.1), duration=DURATION)


def seconds(task: Callable[[Crane], None], crane: Crane) -> float:
    """Processor time of one call."""
    before = time.process_time()
    task(crane)
    return time.process_time() - before


def measure(rounds: int) -> tuple[float, float, float]:
    """Steps a second of bare calls and of the plain loop, and the ratio of the two, measured in
    turn.

    The shortest time of each counts: it is the same work every time, and whatever else the machine
    does only adds to it.
    """
    crane = load_crane()
    pairs = [(seconds(bare, crane), seconds(plain, crane)) for _ in range(rounds)]
    bare_rate, plain_rate = (STEPS / min(column) for column in zip(*pairs, strict=True))
    return bare_rate, plain_rate, plain_rate / bare_rate


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; 0 if the loop reaches the ratio asked for, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loop", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="pairs of measurements (default 7)")
    parser.add_argument("--least", type=float, default=0.35, help="ratio to reach (default 0.35)")
    options = parser.parse_args(argv)
    bare_rate, plain_rate, ratio = measure(max(options.rounds, 1))
    print(f"pin.aba from Python    {bare_rate:10,.0f} calls/s")
    print(
        f"plain loop, all of it  {plain_rate:10,.0f} steps/s, {plain_rate * DURATION / STEPS:.0f} "
        "times real time"
    )
    print(f"ratio                  {ratio:10.3f} (asked for {options.least:g})")
    return 0 if ratio >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
