"""Steps a second of the environment for learning, each of 0.1 s by ten steps of RK4: many cranes,
each with its own load, wind and episode.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np

from cranedyn.compiled.kernel import Precision
from cranedyn.interop.gymnasium import TowerCraneVectorEnv
from cranedyn.interop.task import cranes_between

COUNTS = (1024, 4096, 16_384, 65_536)
"""Numbers of cranes."""


class StepRates(NamedTuple):
    """Steps a second of an environment.

    Attributes:
        best: In the best round [1/s].
        median: In the median round [1/s].
        of_processor: Steps in a second of processor time, in the median round [1/s].
    """

    best: float
    median: float
    of_processor: float


def measure_environment(
    count: int, rounds: int, seconds: float, precision: Precision = "double"
) -> StepRates:
    """Measure the environment.

    Args:
        count: Number of cranes.
        rounds: Number of rounds.
        seconds: Duration of a round [s].
        precision: Precision in which the cranes move.
    """
    env = TowerCraneVectorEnv(
        count,
        crane=cranes_between(4, payload_mass=(500.0, 3000.0)),
        wind=10.0,
        reach=(0.6, 10.0, 5.0),
        precision=precision,
    )
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    env.step(actions)
    rates = []
    processor_rates = []
    for _ in range(rounds):
        wall_begin = time.perf_counter()
        processor_begin = time.process_time()
        steps = 0
        while not steps or time.perf_counter() - wall_begin < seconds:
            env.step(actions)
            steps += count
        rates.append(steps / (time.perf_counter() - wall_begin))
        processor_rates.append(steps / (time.process_time() - processor_begin))
    return StepRates(max(rates), statistics.median(rates), statistics.median(processor_rates))


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; 1 if no number of cranes makes the steps asked for in its best round, else
    0.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.environment", description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS, help="numbers of cranes")
    parser.add_argument("--rounds", type=int, default=9, help="(default 9)")
    parser.add_argument("--seconds", type=float, default=0.3, help="of a round (default 0.3)")
    parser.add_argument(
        "--least", type=float, default=0.0, help="million steps a second asked for (default none)"
    )
    choices = get_args(Precision)
    parser.add_argument("--precision", choices=choices, default="double", help="(default double)")
    options = parser.parse_args(argv)
    print("cranes   best [M/s]   median [M/s]   in a second of one processor [M]")
    best = []
    for count in options.counts:
        rates = measure_environment(
            count, max(options.rounds, 1), options.seconds, options.precision
        )
        best.append(1e-6 * rates.best)
        print(
            f"{count:6}   {1e-6 * rates.best:10.3f}   {1e-6 * rates.median:12.3f}   "
            f"{1e-6 * rates.of_processor:32.3f}"
        )
    return 0 if max(best) >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
