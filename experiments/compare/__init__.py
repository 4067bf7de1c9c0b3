"""Compare: every strategy for a move beside every other, as planned and when load, cable, sensors
and air are not as planned; and, by --controller, a controller of one's own among them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import replace
from typing import Any

from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError
from cranedyn.interop.controller_file import FORMS, controllers_by_name
from cranedyn.sweep.workers import ignore_sigint
from experiments import harness
from experiments.compare import claims, tables
from experiments.compare.runs import Results, TourResult, strategy_results, tour_results
from experiments.harness import Outcome, ProgressReporter, Setup
from experiments.harness.processes import processes
from experiments.scenarios.moves import COMBINED, IDEAL, LIMITS, MOVES, SWINGING, RestToRest
from experiments.scenarios.perturbations import NOMINAL, PERTURBATIONS
from experiments.scenarios.strategies import (
    FLAT,
    PAPER,
    PD,
    STRATEGIES,
    TIME,
    file_name,
    strategy_colours,
)
from experiments.scenarios.tours import CONTROLS

RECORDED = (PD, PAPER, FLAT, TIME)
"""Strategies that are drawn into each other in the recording."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Make every move by every strategy, the combined one under every case, and the tour."""
    from cranedyn.recording import Run

    drive = options.drive
    # Workers import this module, too. They draw nothing, and do not wait for Matplotlib.
    from experiments.compare import figures

    is_ideal = drive == IDEAL
    moves = [*MOVES, SWINGING]
    of_move, tours = _compute(options, setup, moves)
    print_missing_results(of_move)
    combined = of_move[COMBINED.name]
    perturbed = _perturbed(combined)
    runs = {}
    for strategy, results in combined.items():
        run = results[NOMINAL.name].run
        if run is not None:
            runs[strategy] = run

    colours = strategy_colours(list(runs))
    # A screen shows the first table: that of the move that figures and recording show.
    tabled_moves = [COMBINED, *(move for move in moves if move is not COMBINED)]
    result_tables = [tables.move_table(move, of_move[move.name], drive) for move in tabled_moves]
    for move in tabled_moves:
        result_tables.append(tables.drives_table(move, of_move[move.name], beyond=not is_ideal))
    if is_ideal:
        result_tables.append(tables.tour_table(tours))
    result_tables += tables.case_tables(perturbed, drive)
    if is_ideal:
        result_tables.append(tables.observer_table(combined))

    if is_ideal:
        found = [*claims.ideal_claims(setup, combined), *claims.observer_claims(combined)]
    else:
        found = [*claims.converter_claims(of_move)]
    found += claims.time_claims(setup, of_move)

    parameters: dict[str, object] = {
        "rate_limits": list(LIMITS.rates),
        "acceleration_limits": list(LIMITS.accelerations),
        "moves": {move.name: [move.start, move.goal, move.duration, move.swing] for move in moves},
    }
    if not is_ideal:
        parameters |= _converter_parameters(setup)
    return Outcome(
        tables=result_tables,
        claims=found,
        parameters=parameters,
        trajectories={f"compare_{file_name(strategy)}": run for strategy, run in runs.items()},
        figures={
            "swing": figures.swing_figure(COMBINED, runs),
            "robustness": figures.robustness_figure(COMBINED, perturbed, options.drive),
        },
        recording=[
            Run(strategy, setup.crane, runs[strategy], colour=colours[strategy])
            for strategy in recorded_strategies(list(runs))
        ],
    )


def _compute(
    options: argparse.Namespace, setup: Setup, moves: Sequence[RestToRest]
) -> tuple[dict[str, Results], dict[str, TourResult | str]]:
    """Compute everything in processes.

    Raises:
        CraneError: If a controller of one's own cannot be read, or is called like a strategy.

    Returns:
        The results of each move by its name; and the tours by their control, or why there is none,
        if drives are ideal.
    """
    drive = options.drive
    quiet = replace(setup, reporter=ProgressReporter())
    names = [*(options.only or STRATEGIES)]
    files = _own_controllers(options.controller)
    names += files
    tasks = {}
    tours = {}
    with processes(options.jobs) as workers:
        # Submitting starts processes, which must not end at an interruption by themselves.
        with ignore_sigint():
            for name in names:
                file = files.get(name, "")
                tasks[name] = workers.submit(strategy_results, quiet, moves, name, drive, file)
            for control in CONTROLS if drive == IDEAL else ():
                tours[control] = workers.submit(tour_results, quiet, control)
        everything: list[Future[Any]] = [*tasks.values(), *tours.values()]
        update = setup.reporter.count("comparison", len(everything))
        for done, _ in enumerate(as_completed(everything), start=1):
            update(done)
    results = {name: task.result() for name, task in tasks.items()}
    of_move = {move.name: {name: results[name][move.name] for name in names} for move in moves}
    return of_move, {control: tour.result() for control, tour in tours.items()}


def _own_controllers(sources: Sequence[str]) -> dict[str, str]:
    """Return where controllers of one's own are, by their names.

    Raises:
        CraneError: If one cannot be read, or two have one name, or one that of a strategy.
    """
    # Opened before anything is computed, so that a mistake is told at once.
    opened = controllers_by_name(sources)
    for name, own in opened.items():
        if name in STRATEGIES:
            raise CraneError(f"{own.source} has the name of a strategy, {name}; rename it.")
    return {name: own.source for name, own in opened.items()}


def print_missing_results(of_move: Mapping[str, Results]) -> None:
    """Print on standard error why a controller of one's own has no result in a move as planned,
    each reason once. The tables show a dash there, and the reason below them only.

    Args:
        of_move: The results of each move by its name.
    """
    reasons: dict[tuple[str, str], None] = {}
    for results in of_move.values():
        for name, by_case in results.items():
            why = by_case[NOMINAL.name].why
            if why and name not in STRATEGIES:
                reasons[name, why] = None
    for name, why in reasons:
        print(f"{name} has no result: {why}", file=sys.stderr)


def recorded_strategies(strategies: Sequence[str]) -> Sequence[str]:
    """Return the strategies that are drawn into each other in the recording: those of `RECORDED`
    and the controllers of one's own, or as many of the others if none of these is there.
    """
    usual = [name for name in RECORDED if name in strategies]
    own = [name for name in strategies if name not in STRATEGIES]
    return [*usual, *own] or strategies[: len(RECORDED)]


def _perturbed(results: Results) -> Results:
    """Return the results of the cases of `PERTURBATIONS`."""
    names = [case.name for case in PERTURBATIONS]
    return {
        strategy: {name: cases[name] for name in names if name in cases}
        for strategy, cases in results.items()
    }


def _converter_parameters(setup: Setup) -> dict[str, object]:
    typical = converters(setup.crane)
    rows = {name: array.tolist() for name, array in typical.response._asdict().items()}
    return {"drive": "velocity", "converters": rows | {"delay_s": typical.delay}}


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("compare", __doc__, engines=("compiled", "pinocchio"))
    harness.add_setup(parser)
    text = (
        "ideal: drives take what each strategy answers, efforts or accelerations; velocity: "
        "all drives have typical frequency converters, which take rates"
    )
    parser.add_argument("--drive", choices=(IDEAL, "velocity"), default=IDEAL, help=text)
    text = f"only these strategies, of: {', '.join(STRATEGIES)}"
    parser.add_argument("--only", nargs="+", choices=STRATEGIES, metavar="STRATEGY", help=text)
    text = (
        f"controllers of one's own beside them: {FORMS}. A function is called with (crane, motion) "
        "and returns a controller; its file is run. The other files hold matrices"
    )
    parser.add_argument("--controller", nargs="+", default=[], metavar="FILE", help=text)
    text = "processes, by default one for each processor"
    parser.add_argument("--jobs", type=int, default=None, metavar="N", help=text)
    return harness.run_experiment(parser, experiment, argv)
