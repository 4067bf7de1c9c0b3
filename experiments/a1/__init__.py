"""A1, free swing: the period at four cable lengths, every part of its error explained, and
predicted before it is measured.

The run is in `case`, the tables are in `tables`; `experiment` puts them together.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cranedyn.analysis.swing import SwingFit, fit_swing
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import read_columns
from cranedyn.errors import DataError, OutOfRange
from experiments import harness
from experiments.a1 import figures, tables
from experiments.a1.case import (
    FIT_FROM,
    PUBLISHED,
    PULSE_AT,
    ROUNDING,
    SOFT,
    SWING,
    Published,
    SwingCase,
    planned_swing,
    run,
)
from experiments.harness import Claim, Outcome, Setup

__all__ = [
    "PUBLISHED",
    "ROUNDING",
    "SOFT",
    "Published",
    "SwingCase",
    "experiment",
    "main",
    "planned_swing",
    "run",
]

COLUMNS = ("t_s", "phi_rad", "l_m")
"""Columns that a recorded file must have."""

GAIN_RESIDUAL = {"error": 0.017, "damping ratio": 0.000011, "amplitude": 0.00025}
"""Largest residual of these columns with the gains identified from them (docs/results/article.md,
``--identify``)."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run all cases, or analyse recorded files."""
    if options.files:
        files = harness.analyse_files(options, COLUMNS, _fit)
        fits = [(file, *fit) for file, fit in files.results]
        return Outcome([files.noted(tables.files_table(setup.crane, fits))])
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
    if SOFT.length not in options.length:
        return outcome(setup, cases)
    soft = run(
        setup,
        SOFT.length,
        swing=swing,
        stiffness={"x": SOFT.stiffness},
        damping={"x": SOFT.damping},
        published=SOFT.published,
    )
    return outcome(setup, cases, soft)


def outcome(setup: Setup, cases: Sequence[SwingCase], soft: SwingCase | None = None) -> Outcome:
    """Return tables, claims, figures and files of the cable lengths and the soft trolley.

    Args:
        setup: The world.
        cases: The runs with the usual gains, one for each cable length.
        soft: The run with a soft trolley; None if its cable length was not asked for.
    """
    trajectories = {f"a1_l{case.length:g}": case.trajectory for case in cases}
    all_cases = list(cases)
    if soft is not None:
        trajectories["a1_soft"] = soft.trajectory
        all_cases.append(soft)
    return Outcome(
        tables=[
            tables.article_table(setup.crane, cases),
            tables.budget_table(all_cases),
            tables.damping_table(setup.crane, cases),
            tables.prediction_table(all_cases),
        ],
        claims=list(_claims(setup, cases, all_cases)),
        parameters={
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "fit_from_s": FIT_FROM,
            "pulse_at_s": PULSE_AT,
        },
        trajectories=trajectories,
        figures={
            "waveform": figures.waveform_figure(cases),
            "period": figures.period_figure(cases),
            "budget": figures.budget_figure(cases),
        },
        recording=harness.side_by_side(
            {f"l = {case.length:g} m": (setup.crane, case.trajectory) for case in cases}
        ),
    )


def _claims(
    setup: Setup, cases: Sequence[SwingCase], all_cases: Sequence[SwingCase]
) -> Iterator[Claim]:
    """Yield the claims on published columns, on the budget and on the prediction.

    Args:
        setup: The world.
        cases: The runs with the usual gains.
        all_cases: These, and the run with a soft trolley if there is one.
    """
    # Ours less the published number, of each column where it is published.
    differences: dict[str, list[float]] = {"error": [], "damping ratio": [], "amplitude": []}
    for case in cases:
        article = case.published
        if article.point:
            differences["error"].append(100 * case.error - article.point)
        if article.zeta:
            differences["damping ratio"].append(case.fit.damping_ratio - article.zeta)
        if article.amplitude:
            differences["amplitude"].append(case.fit.amplitude - article.amplitude)
    for column, values in differences.items():
        yield _published_claim(setup, column, values)

    are_explained, budget = _within([(case.unexplained, case.second_order) for case in all_cases])
    yield Claim(
        f"The causes in the error budget add up to each period within {budget}: the sum "
        "leaves out products of two causes.",
        setup.judged(are_explained),
    )
    are_predicted, finite = _within(
        [(case.prediction_error, case.finite_swing) for case in all_cases]
    )
    # The prediction is of lowest order in the swing.
    are_small = all(case.predicted.amplitude < 1.1 * SWING for case in all_cases)
    yield Claim(
        f"The linearised crane predicts each period within {finite}: it takes the yielding of the "
        "trolley for small swings.",
        are_predicted if are_small else None,
    )


def _published_claim(setup: Setup, column: str, differences: Sequence[float]) -> Claim:
    """Return the claim that a column agrees with the published one.

    Args:
        setup: The world.
        column: Name of the column.
        differences: Ours less the published number of each run.
    """
    allowed = ROUNDING[column] + GAIN_RESIDUAL[column]
    noun = {"error": "errors of the period"}.get(column, f"{column}s")
    unit = {"error": " percentage points", "amplitude": " rad"}.get(column, "")
    sentence = f"The {noun} are within {allowed:.2g}{unit} of the published ones"
    if not differences:
        return Claim(f"{sentence} (none was run).", None)
    worst = max(map(abs, differences))
    return Claim(
        f"{sentence} (worst {worst:.2g}): these are rounded, and the gains are fitted to them.",
        setup.judged(worst < allowed),
    )


def _within(pairs: Sequence[tuple[float, float]]) -> tuple[bool, str]:
    """Return whether all errors are within their bounds.

    Args:
        pairs: Each error with its bound.

    Returns:
        Whether they are, and a text with the largest error and the one nearest to its bound [%].
    """
    sizes = [(abs(error), bound) for error, bound in pairs]
    largest = max(sizes)
    nearest = max(sizes, key=lambda size: size[0] / size[1])
    texts = []
    # Both may be the same.
    for error, bound in dict.fromkeys([largest, nearest]):
        texts.append(f"{100 * error:.2g} % (allowed {100 * bound:.2g} %)")
    words = ", and in the tightest case ".join(texts)
    return all(error < bound for error, bound in sizes), words


def _fit(file: str, data: Mapping[str, np.ndarray]) -> tuple[float, SwingFit]:
    """Return the cable length [m] in a recorded file and the fit to its swing. The length is the
    setpoint of the hoist if recorded, else the measured mean.
    """
    late = data["t_s"] >= FIT_FROM
    fit = fit_swing(data["t_s"][late], data["phi_rad"][late])
    try:
        length = read_columns(file, ["l_setpoint_m"])["l_setpoint_m"]
    except DataError:
        length = data["l_m"]
    return float(length[late].mean()), fit


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("a1", __doc__)
    harness.add_setup(parser, "hoist_init")
    add = parser.add_argument
    lengths = list(PUBLISHED)
    add("--length", type=float, nargs="+", default=lengths, metavar="L", help="cable lengths [m]")
    add("--swing", type=float, default=SWING, metavar="PHI", help="swing to aim at [rad]")
    text = "find the unpublished gains of trolley and hoist from the published columns"
    add("--identify", action="store_true", help=text)
    harness.add_files(parser, COLUMNS, "values")
    harness.add_mode(parser, "identify", "gravity", "dt", "control_period", "values", "engine")
    return harness.run_experiment(parser, experiment, argv)
