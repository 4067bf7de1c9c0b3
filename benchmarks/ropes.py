"""Physics steps of a batch in a second of one processor, by rope: rigid, elastic and bouncing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from benchmarks.conduct import print_tables
from benchmarks.timing import race
from benchmarks.workload import Case
from cranedyn.compiled.batch import simulate_batch
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.harness.outcome import ResultTable

# EA of the rope [N], 0 for a rigid one, and the largest speed at which loads leave it [m/s].
ROPES = {
    "rigid": (0.0, 0.0),
    "elastic, hangs": (2e7, 0.0),
    "elastic, bounces": (2e7, 2.0),
    "inextensible, falls into the rope": (np.inf, 2.0),
}

COLUMNS = (
    ("rope", ""),
    ("rule", ""),
    ("slack [%]", ".0f"),
    ("changes/s", ".1f"),
    ("million steps/s", ".3g"),
    ("ratio", ".2f"),
)


def measure_ropes(
    cranes: int, duration: float, rounds: int, rules: Sequence[Integrator]
) -> list[ResultTable]:
    """Return a table of the best of rounds for each rope and stepping rule."""
    tasks: list[Callable[[], object]] = []
    rows: list[list[float | str | None]] = []
    for rule in rules:
        for name, (ea, speed) in ROPES.items():
            case = Case(load_crane(rope_stiffness=ea))
            q, v = np.split(case.starts(cranes), 2, axis=1)
            if speed:
                v[:, case.crane.layout.index("rope_stretch")] = -speed * np.linspace(
                    0.5, 1.0, cranes
                )
            how: Any = {"duration": duration, "integrator": rule}
            one = partial(simulate, start=State(q[0], v[0]), engine="compiled", validity="mark")
            phase = one(case.crane, case.controller, **how).phase
            slack = np.zeros(2) if phase is None else phase
            rows.append([name, rule.name, 100.0 * slack.mean(), np.abs(np.diff(slack)).sum()])
            how |= {"start": State(q, v), "threads": 1}
            tasks.append(partial(simulate_batch, case.crane, case.controller, **how))
            tasks[-1]()
    times = race(tasks, rounds, np.random.default_rng(0), process_time).min(axis=1)
    rates = cranes * duration / Case.dt / times.reshape(len(rules), -1)
    ratios = rates / rates[:, :1]
    for row, rate, ratio in zip(rows, rates.flat, ratios.flat, strict=True):
        row[3:] = [row[3] / duration, rate / 1e6, ratio]  # type: ignore[operator]
    note = (
        f"{cranes:,} cranes that swing for {duration:g} s, steps of {1e3 * Case.dt:g} ms, one "
        f"thread; least processor time of {rounds} shuffled rounds. Slack, and changes between "
        "slack and taut: of the first crane. Ratio: to the rigid rope with the same rule."
    )
    return [ResultTable("Ropes in a batch", COLUMNS, rows, note)]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""

    def measure(options: argparse.Namespace) -> Sequence[ResultTable]:
        return measure_ropes(512, 2.0, options.rounds, [semi_implicit_euler, rk4])

    rounds = {"type": int, "default": 15, "metavar": "N", "help": "rounds (default 15)"}
    return print_tables("ropes", __doc__, measure, argv, rounds=rounds)


if __name__ == "__main__":
    sys.exit(main())
