"""A1, free swing: the period at four cable lengths, every part of its error explained, and
predicted before it is measured.

The run is in `case`, the tables are in `tables`; `experiment` puts them together.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

import numpy as np

from cranedyn.analysis.swing import fit_swing
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import read_columns
from cranedyn.errors import DataError, OutOfRange
from cranedyn.model.crane import Crane
from experiments import harness
from experiments.a1.case import (
    FIT_FROM,
    PUBLISHED,
    PULSE_AT,
    ROUNDING,
    SOFT,
    SWING,
    Published,
    SwingCase,
    run,
)
from experiments.harness import Claim, Outcome, Setup

__all__ = ["PUBLISHED", "ROUNDING", "SOFT", "Published", "SwingCase", "experiment", "main", "run"]

COLUMNS = ("t_s", "phi_rad", "l_m")
"""Columns that a recorded file must have."""

GAIN_RESIDUAL = {"error": 0.017, "damping ratio": 0.000011, "amplitude": 0.00025}
"""Largest residual of these columns with the gains identified from them (docs/results/article.md,
``--identify``)."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run all cases, or analyse recorded files."""
    if options.files:
        return _from_files(options.files, options.columns, options.joints, setup.crane)
    if options.identify:
        from experiments.a1.identify import identify_hoist

        return identify_hoist(setup)
    if len({f"{length:g}" for length in options.length}) < len(options.length):
        raise OutOfRange(
            "length", options.length, "each length once, as far as six digits tell", "m"
        )
    swing = options.swing
    published = PUBLISHED if swing == SWING else {}
    cases = [run(setup, x, swing=swing, published=published.get(x)) for x in options.length]
    length, k_p, k_d, article = SOFT
    stiffness, damping = {"x": k_p}, {"x": k_d}
    soft = run(setup, length, swing=swing, stiffness=stiffness, damping=damping, published=article)
    return outcome(setup, cases, soft)


def outcome(setup: Setup, cases: Sequence[SwingCase], soft: SwingCase) -> Outcome:
    """Return tables, claims, figures and files of the cable lengths and the soft trolley."""
    from cranedyn.recording import Run
    from experiments.a1 import figures, tables

    return Outcome(
        tables=[
            tables.article_table(setup.crane, cases),
            tables.budget_table([*cases, soft]),
            tables.damping_table(setup.crane, cases),
            tables.prediction_table([*cases, soft]),
        ],
        claims=_claims(setup, cases, soft),
        parameters={
            **setup.parameters(),
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "fit_from_s": FIT_FROM,
            "pulse_at_s": PULSE_AT,
        },
        trajectories={f"a1_l{case.length:g}": case.trajectory for case in cases}
        | {"a1_soft": soft.trajectory},
        figures={
            "waveform": figures.waveform_figure(cases),
            "period": figures.period_figure(cases),
            "budget": figures.budget_figure(cases),
        },
        recording=[
            Run(f"l = {case.length:g} m", setup.crane, case.trajectory, (20.0 * i, 0.0, 0.0))
            for i, case in enumerate(cases)
        ],
    )


def _claims(setup: Setup, cases: Sequence[SwingCase], soft: SwingCase) -> list[Claim]:
    listed = [(case, case.published) for case in cases]
    misses = {
        "error": [100 * case.error - p.point for case, p in listed if p.point],
        "damping ratio": [case.fit.damping_ratio - p.zeta for case, p in listed if p.zeta],
        "amplitude": [case.fit.amplitude - p.amplitude for case, p in listed if p.amplitude],
    }
    all_cases = [*cases, soft]
    explained, budget = _within(
        [c.unexplained for c in all_cases], [c.second_order for c in all_cases]
    )
    # The prediction is of lowest order in the swing.
    small = all(case.predicted.amplitude < 1.1 * SWING for case in all_cases)
    agree, finite = _within(
        [case.prediction_error for case in all_cases], [case.finite_swing for case in all_cases]
    )
    return [
        *(_published_claim(setup, column, values) for column, values in misses.items()),
        Claim(
            "What the budget leaves unexplained of a period is of second order in its parts (at "
            f"most {budget}).",
            setup.judged(explained),
        ),
        Claim(
            "Predicted and simulated period differ by less than a finite swing A changes the "
            f"pivot's give, A² of it (at most {finite}).",
            agree if small else None,
        ),
    ]


def _published_claim(setup: Setup, column: str, misses: Sequence[float]) -> Claim:
    allowed = ROUNDING[column] + GAIN_RESIDUAL[column]
    unit = {"error": "percentage points", "amplitude": "rad"}.get(column, "")
    sentence = f"Every published {column} is met within {allowed:.2g} {unit}".rstrip()
    if not misses:
        return Claim(f"{sentence} (none was run).", None)
    worst = max(map(abs, misses))
    return Claim(
        f"{sentence}, half its last digit and what the identified gains leave (worst {worst:.2g}).",
        setup.judged(worst < allowed),
    )


def _within(misses: Sequence[float], allowed: Sequence[float]) -> tuple[bool, str]:
    """Return whether all misses are within their bounds, and a text with the extremes [%]."""
    pairs = list(zip(map(abs, misses), allowed, strict=True))
    largest, nearest = max(pairs), max(pairs, key=lambda pair: pair[0] / pair[1])
    texts = [
        f"{100 * miss:.2g} % where {100 * bound:.2g} % are allowed"
        for miss, bound in dict.fromkeys([largest, nearest])
    ]
    return all(miss < bound for miss, bound in pairs), ", and nearest to it ".join(texts)


def _from_files(
    files: Sequence[str], sources: Sequence[str], joints: Sequence[str], crane: Crane
) -> Outcome:
    from experiments.a1.tables import files_table

    fits = []
    for file in files:
        data = harness.read_recorded(file, COLUMNS, sources, joints)
        late = data["t_s"] >= FIT_FROM
        with harness.name_file(file):
            fit = fit_swing(data["t_s"][late], data["phi_rad"][late])
            fits.append((file, _length(file, data, late), fit))
    return Outcome([files_table(crane, fits)], [])


def _length(file: str, data: Mapping[str, np.ndarray], late: np.ndarray) -> float:
    """Return the cable length [m]: setpoint of the hoist if recorded, else the measured mean."""
    try:
        return float(read_columns(file, ["l_setpoint_m"])["l_setpoint_m"][late].mean())
    except DataError:
        return float(data["l_m"][late].mean())


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "a1", "Free swing at four cable lengths: the period, its error budget, and its prediction."
    )
    harness.add_setup(parser, "hoist_init")
    lengths = list(PUBLISHED)
    text = "cable lengths [m]"
    parser.add_argument("--length", type=float, nargs="+", default=lengths, metavar="L", help=text)
    text = "swing to aim at [rad]"
    parser.add_argument("--swing", type=float, default=SWING, metavar="PHI", help=text)
    text = "find the unpublished gains of trolley and hoist from the published columns"
    parser.add_argument("--identify", action="store_true", help=text)
    harness.add_files(parser, COLUMNS, "values")
    harness.add_mode(parser, "identify", "gravity", "dt", "control_period", "values", "engine")
    return harness.run_experiment(parser, experiment, argv)
