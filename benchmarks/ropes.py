"""Physics steps of a batch in a second of one processor, by rope: rigid, elastic and bouncing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from time import process_time
from typing import NamedTuple

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


class Rope(NamedTuple):
    """A rope and how its loads begin.

    Attributes:
        stiffness: EA of the rope [N]; 0 for a rigid one.
        speed: Largest speed at which loads leave the rope [m/s]; 0 for loads at rest.
    """

    stiffness: float
    speed: float


ROPES = {
    "rigid": Rope(0.0, 0.0),
    "elastic, hangs": Rope(2e7, 0.0),
    "elastic, bounces": Rope(2e7, 2.0),
    "inextensible, falls into the rope": Rope(np.inf, 2.0),
}
"""Ropes that are compared, by name; the first is what others are compared with."""

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
    described: list[tuple[str, Integrator, np.ndarray]] = []
    for rule in rules:
        for name, rope in ROPES.items():
            case = Case(load_crane(rope_stiffness=rope.stiffness))
            start = _start(case, rope, cranes)
            described.append((name, rule, _slack(case, start, duration, rule)))
            task = partial(
                simulate_batch,
                case.crane,
                case.controller,
                start=start,
                duration=duration,
                integrator=rule,
                threads=1,
            )
            # The first run is not measured: it compiles.
            task()
            tasks.append(task)
    times = race(tasks, rounds, np.random.default_rng(0), process_time).min(axis=1)
    rates = cranes * duration / Case.dt / times.reshape(len(rules), -1)
    ratios = rates / rates[:, :1]
    rows: list[list[float | str | None]] = []
    for (name, rule, slack), rate, ratio in zip(described, rates.flat, ratios.flat, strict=True):
        changes = np.abs(np.diff(slack)).sum() / duration
        rows.append([name, rule.name, 100.0 * slack.mean(), changes, rate / 1e6, ratio])
    note = (
        f"{cranes:,} cranes that swing for {duration:g} s, steps of {1e3 * Case.dt:g} ms, one "
        f"thread; least processor time of {rounds} shuffled rounds. Slack, and changes between "
        "slack and taut: of the first crane. Ratio: to the rigid rope with the same rule."
    )
    return [ResultTable("Ropes in a batch", COLUMNS, rows, note)]


def _start(case: Case, rope: Rope, cranes: int) -> State:
    """Return the start of cranes, whose loads leave the rope at different speeds."""
    q, v = np.split(case.starts(cranes), 2, axis=1)
    if rope.speed:
        shares = np.linspace(0.5, 1.0, cranes)
        v[:, case.crane.layout.index("rope_stretch")] = -rope.speed * shares
    return State(q, v)


def _slack(case: Case, start: State, duration: float, rule: Integrator) -> np.ndarray:
    """Return whether the rope of the first crane is slack, 1 or 0, at each control instant."""
    run = simulate(
        case.crane,
        case.controller,
        start=State(start.q[0], start.v[0]),
        duration=duration,
        integrator=rule,
        engine="compiled",
        validity="mark",
    )
    # A rigid rope has no phases.
    return np.zeros(2) if run.phase is None else run.phase


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""

    def measure(options: argparse.Namespace) -> Sequence[ResultTable]:
        return measure_ropes(512, 2.0, options.rounds, [semi_implicit_euler, rk4])

    rounds = {"type": int, "default": 15, "metavar": "N", "help": "rounds (default 15)"}
    return print_tables("ropes", __doc__, measure, argv, rounds=rounds)


if __name__ == "__main__":
    sys.exit(main())
