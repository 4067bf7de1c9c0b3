"""Sweep: a hundred thousand moves by cranes that are not quite those planned for; how much swing
each strategy leaves, and how often it fails.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cranedyn.errors import DataError
from cranedyn.sweep import Design, cross, grid, sweep
from cranedyn.sweep.cluster import tls
from cranedyn.sweep.design import check_memory
from experiments import harness
from experiments.harness.progress import watching
from experiments.harness.swept import columns_swept
from experiments.scenarios.drawn import DRAWN, drawn
from experiments.scenarios.robustness import AFTER, COMBINED, IDEAL, SWEPT, robustness
from experiments.scenarios.strategies import FLAT, PAPER, PD
from experiments.sweep_drawn import drawn_claims, drawn_tables
from experiments.sweep_figures import drawn_figure, map_figure, timing_figure

LOADS, CABLES, DURATIONS = (0.5, 1.5), (-1.5, 1.5), (13.0, 35.0)
"""Ranges: mass of the payload over that planned for, length of the cable less that measured [m],
time for the move [s]."""

_COLUMNS = 8
"""Of the design."""

_MOST = 10**9
"""Points, durations, cases or workers that are asked for."""

_CHUNK = 512
"""Drawn cases that a process computes at once."""

_SEED = 1

Columns = Mapping[str, np.ndarray]


def design(setup: harness.Setup, points: int, durations: int, drive: str = IDEAL) -> Design:
    """Every strategy with every duration, each on a square of loads and cables; cases of one plan
    stand together.

    Raises:
        DataError: If the table would not fit the memory, told before any of it is made.
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
    )
    return cross(plans, grid(load=_even(LOADS, points), cable_error_m=_even(CABLES, points)))


def _even(ends: tuple[float, float], count: int) -> list[float]:
    return np.linspace(*ends, count).tolist()


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Run the sweep, or go on with it, and look at all of it."""
    folder, asked = options.folder / "cases", _asked(options, setup)
    tls_files = [options.tls_ca_file, options.tls_cert, options.tls_key]
    if any(tls_files) and not all(tls_files):
        raise DataError("TLS needs --tls-ca-file, --tls-cert and --tls-key, all three of them.")
    end = sweep(
        robustness,
        asked,
        folder,
        chunk=_CHUNK if options.cases else options.points**2,
        workers=options.workers,
        scheduler=options.scheduler,
        security=tls(*tls_files) if all(tls_files) else None,
        limit=options.limit,
        progress=watching(setup.reporter, "cases"),
    )
    found = columns_swept(folder)
    parameters = replace(setup, validity="mark").parameters() | {
        "drive": options.drive,
        "cases": end.cases,
    }
    if options.cases:
        return harness.Outcome(
            tables=drawn_tables(found, options.drive),
            claims=drawn_claims(found, options.drive, end.errors),
            parameters=parameters | {"seed": options.seed},
            figures={"sweep_map": drawn_figure(found)},
        )
    return harness.Outcome(
        tables=[_strategies(found, options.drive)],
        claims=_claims(found, end.errors),
        parameters=parameters | {"points": options.points, "durations": options.durations},
        figures={"sweep_map": map_figure(found), "sweep_timing": timing_figure(found)},
    )


def _asked(options: argparse.Namespace, setup: harness.Setup) -> Design:
    """The cases that are asked for.

    Raises:
        DataError: If an argument has no effect, no strategy is left, or the table would not fit the
            memory.
    """
    if options.cases:
        names = [name for name in options.only or DRAWN if name not in options.without]
        if not names:
            raise DataError("No strategy is left of --only by --without.")
        return drawn(setup, names, options.drive, options.cases, options.seed)
    for name, given in (
        ("only", options.only),
        ("without", options.without),
        ("seed", options.seed != _SEED),
    ):
        if given:
            raise DataError(f"--{name} has no effect without --cases; leave it out.")
    return design(setup, options.points, options.durations, options.drive)


def _strategies(found: Columns, drive: str) -> harness.Table:
    rows = []
    for strategy in SWEPT:
        mine = found["strategy"] == strategy
        left, peak, off = (
            found[name][mine] for name in ("residual_swing_rad", "peak_swing_rad", "off_goal_m")
        )
        bad = int(np.isnan(left).sum())
        rows.append(
            (
                strategy,
                len(left),
                bad,
                *(1e3 * np.nanquantile(left, [0.5, 0.95, 1.0])),
                1e3 * np.nanmax(peak),
                1e3 * np.nanmax(off),
            )
        )
    columns = [
        ("strategy", ""),
        ("cases", ",d"),
        ("bad", "d"),
        ("median [mrad]", ".3g"),
        ("95 % below [mrad]", ".3g"),
        ("worst [mrad]", ".3g"),
    ]
    columns += [("worst on the way [mrad]", ".3g"), ("worst off goal [mm]", ".3g")]
    note = (
        f"Swing that is left {AFTER:g} s after the arrival of the {COMBINED.name} move. Loads are "
        f"{LOADS[0]:g} to {LOADS[1]:g} times that "
        f"planned for, cables up to {CABLES[1]:g} m longer or shorter than measured, times for the "
        f"move {DURATIONS[0]:g} to "
        f"{DURATIONS[1]:g} s. "
    ) + (
        "Strategies without a controller in their name have drives that follow exactly."
        if drive == IDEAL
        else "All drives have typical frequency converters."
    )
    where = "" if drive == IDEAL else " on velocity drives"
    return harness.Table(f"Swing left by {len(found['case']):,} moves{where}", columns, rows, note)


def _claims(found: Columns, errors: int) -> list[harness.Claim]:
    left = {
        strategy: found["residual_swing_rad"][found["strategy"] == strategy].reshape(
            len(np.unique(found["duration_s"])), -1
        )
        for strategy in SWEPT
    }
    others = np.array([swing for strategy, swing in left.items() if strategy != FLAT])
    return [
        harness.Claim(
            f"Each of the {len(found['case']):,} cases is done and none is bad.", errors == 0
        ),
        harness.Claim(
            f"{FLAT} leaves less swing than any other strategy, case by case.",
            bool((left[FLAT] < others).all()),
        ),
        harness.Claim(
            f"At every time for the move the worst that {PAPER} leaves is below the median of "
            f"{PD}, which leaves less in "
            f"{(left[PAPER] >= left[PD]).sum():,} of {left[PD].size:,} cases.",
            bool((left[PAPER].max(axis=1) < np.median(left[PD], axis=1)).all()),
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = harness.parser(
        "sweep",
        "How much swing each strategy for the combined move leaves where load, cable and time for "
        "it differ, case by case.",
        recording=False,
        engines=("compiled",),
    )
    made.add_argument(
        "--points",
        type=_count,
        default=32,
        metavar="N",
        help="loads, and cables, between the ends of their ranges",
    )
    made.add_argument(
        "--durations", type=_count, default=13, metavar="N", help="times for the move"
    )
    made.add_argument(
        "--cases",
        type=_count,
        default=None,
        metavar="N",
        help="instead, N moves for each strategy that differ in load, cable, wind, noise and delay "
        "of the sensors and lag of the drives, drawn at random",
    )
    made.add_argument(
        "--only",
        nargs="+",
        choices=DRAWN,
        metavar="STRATEGY",
        help=f"of these cases only those of some strategies, of: {', '.join(DRAWN)}",
    )
    made.add_argument(
        "--without",
        nargs="+",
        choices=DRAWN,
        default=[],
        metavar="STRATEGY",
        help="of these cases not those of some strategies",
    )
    made.add_argument(
        "--seed", type=int, default=_SEED, metavar="N", help="of the random numbers of these cases"
    )
    made.add_argument(
        "--drive",
        choices=(IDEAL, "velocity"),
        default=IDEAL,
        help="ideal: drives take what each strategy answers, efforts or accelerations; velocity: "
        "all drives have frequency converters, which take rates",
    )
    made.add_argument(
        "--workers",
        type=_count,
        default=None,
        metavar="N",
        help="processes, by default one for each processor",
    )
    made.add_argument(
        "--limit",
        type=float,
        default=None,
        metavar="S",
        help="seconds that a case may take; one that takes longer is a bad one",
    )
    made.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        default=None,
        help="run on the workers of this Dask scheduler instead; it and all of them can run code "
        "in this program: give one that you trust, "
        "which listens where you want it to, as one started by `dask scheduler --host 127.0.0.1 "
        "--port 8786 --no-dashboard "
        "--dashboard-address 127.0.0.1:0` and `dask worker tcp://127.0.0.1:8786 --host 127.0.0.1 "
        "--no-dashboard --dashboard-address "
        "127.0.0.1:0`; with more than one machine by TLS, see docs/sweeps.md",
    )
    made.add_argument(
        "--tls-ca-file",
        metavar="FILE",
        help="certificates of those to trust, for a scheduler at tls://HOST:PORT",
    )
    made.add_argument("--tls-cert", metavar="FILE", help="the certificate of this program")
    made.add_argument("--tls-key", metavar="FILE", help="its private key")
    means = "workers", "limit", "scheduler", "tls_ca_file", "tls_cert", "tls_key"
    harness.add_mode(made, "cases", "only", "without", "seed", "drive", "engine", *means)
    return harness.conduct(made, experiment, argv)


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= float(text) <= _MOST:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to {_MOST}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
