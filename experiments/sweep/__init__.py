"""How much swing each strategy for the combined move leaves where load, cable and time for it
differ, case by case.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cranedyn.errors import DataError
from cranedyn.sweep import Design, cross, grid, sweep
from cranedyn.sweep.cluster import tls
from cranedyn.sweep.design import check_memory
from experiments import harness
from experiments.scenarios.moves import IDEAL
from experiments.sweep.sweep_results import (
    CABLES,
    DURATIONS,
    LOADS,
    drawn_claims,
    drawn_figure,
    drawn_tables,
    grid_claims,
    grid_table,
    map_figure,
    timing_figure,
)
from experiments.sweep.sweep_study import DRAWN, SWEPT, drawn, simulate_cases

_COLUMNS = 9
"""Number of columns of the design of the grid."""

_MAX_COUNT = 10**9
"""Largest count that the command line takes."""

_DRAWN_CHUNK = 512
"""Number of drawn cases in a chunk."""

_SEED = 1
"""Seed of the drawn cases, unless another is given."""


def design(setup: harness.Setup, points: int, durations: int, drive: str = IDEAL) -> Design:
    """Return every strategy with every duration, each on a square of loads and cables.

    Cases of one plan stand together. Their steps are in single precision, which takes less than
    three quarters of the time; what it rounds is computed beside, see `simulate_cases`.

    Raises:
        DataError: If the table would not fit the memory.
    """
    cases = len(SWEPT) * durations * points**2
    check_memory(f"A design of {cases} cases", 8.0 * _COLUMNS * float(min(cases, 10**300)))
    plans = grid(
        strategy=list(SWEPT),
        drive=drive,
        duration_s=_even(DURATIONS, durations),
        gravity_m_s2=setup.gravity,
        dt_s=setup.dt,
        control_period_s=setup.control_period,
        precision="single",
    )
    return cross(plans, grid(load=_even(LOADS, points), cable_error_m=_even(CABLES, points)))


def _even(ends: tuple[float, float], count: int) -> list[float]:
    """Return numbers at equal distances between two ends."""
    return np.linspace(*ends, count).tolist()


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Run or resume the sweep, and judge all of it."""
    folder = options.folder / "cases"
    tls_files = [options.tls_ca_file, options.tls_cert, options.tls_key]
    if any(tls_files) and not all(tls_files):
        raise DataError("TLS needs --tls-ca-file, --tls-cert and --tls-key, all three of them.")
    end = sweep(
        simulate_cases,
        _cases(options, setup),
        folder,
        chunk=_DRAWN_CHUNK if options.cases else options.points**2,
        workers=options.workers,
        scheduler=options.scheduler,
        security=tls(*tls_files) if all(tls_files) else None,
        limit=options.limit,
        progress=setup.reporter.sweep("cases"),
    )
    columns = harness.swept_columns(folder)
    parameters = replace(setup, validity="mark").parameters() | {
        "drive": options.drive,
        "cases": end.cases,
    }
    if options.cases:
        return harness.Outcome(
            tables=drawn_tables(columns, options.drive),
            claims=drawn_claims(columns, options.drive, end.errors),
            parameters=parameters | {"seed": options.seed},
            figures={"sweep_map": drawn_figure(columns)},
        )
    return harness.Outcome(
        tables=[grid_table(columns, options.drive)],
        claims=grid_claims(columns, end.errors),
        parameters=parameters | {"points": options.points, "durations": options.durations},
        figures={"sweep_map": map_figure(columns), "sweep_timing": timing_figure(columns)},
    )


def _cases(options: argparse.Namespace, setup: harness.Setup) -> Design:
    """Return the design; raise DataError if an option has no effect, or the design is none."""
    if options.cases:
        names = [name for name in options.only or DRAWN if name not in options.without]
        if not names:
            raise DataError("No strategy is left of --only by --without.")
        return drawn(setup, names, options.drive, options.cases, options.seed)
    for name, default in (("only", None), ("without", []), ("seed", _SEED)):
        if getattr(options, name) != default:
            raise DataError(f"--{name} has no effect without --cases; leave it out.")
    return design(setup, options.points, options.durations, options.drive)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("sweep", __doc__, recording=False, engines=("compiled",))
    option = parser.add_argument
    count: dict[str, Any] = {"type": _count, "metavar": "N"}
    option("--points", default=32, help="loads, and cables, evenly over their ranges", **count)
    option("--durations", default=13, help="times for the move", **count)
    option(
        "--cases",
        help="instead, N moves for each strategy that differ in load, cable, wind, noise and delay "
        "of the sensors and lag of the drives, drawn at random",
        **count,
    )
    names: dict[str, Any] = {"nargs": "+", "choices": DRAWN, "metavar": "STRATEGY"}
    option("--only", help=f"drawn cases of these strategies only, of: {', '.join(DRAWN)}", **names)
    option("--without", default=[], help="no drawn cases of these strategies", **names)
    option("--seed", type=int, default=_SEED, metavar="N", help="seed of the drawn cases")
    option(
        "--drive",
        choices=(IDEAL, "velocity"),
        default=IDEAL,
        help="ideal: drives take what each strategy answers, efforts or accelerations; velocity: "
        "all drives have frequency converters, which take rates",
    )
    option = parser.common.add_argument
    option("--workers", help="processes, by default one for each processor", **count)
    text = "seconds that a case may take; one that takes longer is a bad one"
    option("--limit", type=float, metavar="S", help=text)
    option(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="run on the workers of this Dask scheduler instead; it and all of them can run code "
        "in this program, so trust it, and have it listen only where you want; how to start one, "
        "also with TLS at tls://HOST:PORT, see docs/howto/sweep.md",
    )
    option("--tls-ca-file", metavar="FILE", help="certificates of those to trust")
    option("--tls-cert", metavar="FILE", help="certificate of this program")
    option("--tls-key", metavar="FILE", help="its private key")
    harness.add_mode(
        parser,
        "cases",
        "only",
        "without",
        "seed",
        "drive",
        "engine",
        "workers",
        "limit",
        "scheduler",
        "tls_ca_file",
        "tls_cert",
        "tls_key",
    )
    return harness.run_experiment(parser, experiment, argv)


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= float(text) <= _MAX_COUNT:
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} is not a whole number from 1 to {_MAX_COUNT}"
        )
    return int(text)
