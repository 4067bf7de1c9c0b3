"""Tables of an identified crane: its numbers, residuals and doubts, and the residual swing of
controllers on its twin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.identification import Estimate, Model, Preflight, Twin, identify, preflight, twin_of
from cranedyn.identification.assumed import InertiaEffect, assumed_inertias
from cranedyn.identification.estimate import SIGN_EVIDENCE
from cranedyn.identification.parameters import MEANINGS, Parameter, parameter
from cranedyn.identification.preflight import Advice
from experiments.harness import Column, ResultTable, Setup, finite_or_none, make_table
from experiments.identify.trial import Trial


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of the identification of records.

    Attributes:
        estimate: Estimates of the parameters, with intervals.
        judged: Which parameters these records can tell apart, and which moves would help.
        twin: The crane with these numbers.
    """

    estimate: Estimate
    judged: Preflight
    twin: Twin


def identify_records(model: Model, setup: Setup, label: str) -> Identification:
    """Identify a crane from the records of a model, with progress under a label."""
    estimate = identify(model, progress=setup.reporter.message(label, "predictions of the records"))
    return Identification(estimate, preflight(model, estimate), twin_of(estimate))


def record_tables(
    result: Identification, subject: str, truth: Mapping[str, float]
) -> list[ResultTable]:
    """Return the tables of records: numbers, residuals, and what they cannot tell.

    Args:
        result: The identification.
        subject: What the records are, for the titles; empty for none.
        truth: True values that are known, by name.
    """
    return [
        values_table(result, subject, truth),
        *_sign_tables(result.estimate, subject),
        _residual_table(result, subject),
        *doubts(result, subject),
    ]


def _titled(title: str, subject: str) -> str:
    """Return a title that begins with its subject, if there is one."""
    return f"{subject}: {title[0].lower()}{title[1:]}" if subject else title


def _rounded(value: float, margin: float) -> float:
    """Return a value rounded two digits behind the first digit of its margin.

    Digits behind that say nothing, and differ from one processor to another.
    """
    if not 0.0 < margin < math.inf:
        return value
    return round(value, 2 - math.floor(math.log10(margin)))


def values_table(result: Identification, subject: str, truth: Mapping[str, float]) -> ResultTable:
    """Return the table of estimates with their intervals, beside prior and true values; the
    arguments are those of `record_tables`.
    """
    estimate = result.estimate

    def error(p: Parameter) -> float | None:
        return estimate.intervals[p.name][0] - truth[p.name] if p.name in truth else None

    columns: list[Column] = [
        ("parameter", "", lambda p: p.name),
        ("unit", "", lambda p: p.unit),
        ("prior", ".6g", lambda p: parameter(estimate.model.prior, p.name).start),
        ("estimate", ".6g", lambda p: _rounded(*estimate.intervals[p.name])),
        ("±", ".2g", lambda p: finite_or_none(estimate.intervals[p.name][1])),
    ]
    if truth:
        columns += [("true", ".6g", lambda p: truth.get(p.name)), ("error", "+.2g", error)]
    note = _note(estimate)
    title = _titled("What the records say", subject)
    return make_table(title, estimate.model.own, *columns, note=note)


def _note(estimate: Estimate) -> str:
    """Return the note of the table of values: meanings of parameters, those at the end of their
    range, and remarks about the records.
    """
    kinds = dict.fromkeys(p.kind for p in estimate.model.own if p.kind in MEANINGS)
    meanings = "; ".join(f"{kind}: {MEANINGS[kind]}" for kind in kinds)
    note = f"±: half the 95 % interval. {meanings[:1].upper()}{meanings[1:]}"
    if meanings:
        note += "."
    if estimate.at_bound:
        bounds = ", ".join(estimate.at_bound)
        note += f" At the end of what is allowed, where an interval says nothing: {bounds}."
    # A remark about several records stands once, after their names.
    remarks: dict[str, list[str]] = {}
    for record in estimate.model.records:
        for remark in record.notes:
            remarks.setdefault(remark.removeprefix(f"{record.name}: "), []).append(record.name)
    for text, names in remarks.items():
        note += f" {', '.join(names)}: {text}"
    return note.strip()


class _Residual(NamedTuple):
    """Residual of a column of a record.

    Attributes:
        record: Name of the record.
        column: Name of the column.
        values: The residual [unit of the column], shape (rows,).
        measured: The column, shape (rows,).
        is_white: Whether the residual is white noise.
    """

    record: str
    column: str
    values: np.ndarray
    measured: np.ndarray
    is_white: bool


def _residual_table(result: Identification, subject: str) -> ResultTable:
    """Return a row for each column of each record that the twin predicts."""
    estimate = result.estimate
    model = estimate.model
    residuals = []
    for i, record in enumerate(model.records):
        measured = model.measured(i)
        for c, channel in enumerate(model.channels[i]):
            residual = _Residual(
                record=record.name,
                column=channel.column,
                values=estimate.residuals[i][c],
                measured=measured[c],
                is_white=bool(estimate.white[i][c]),
            )
            residuals.append(residual)
    return make_table(
        _titled("What the twin leaves", subject),
        residuals,
        ("record", "", lambda r: r.record),
        ("column", "", lambda r: r.column),
        ("rows", "d", lambda r: len(r.values)),
        ("recorded, std", ".3g", lambda r: float(np.std(r.measured))),
        ("residual, RMS", ".3g", lambda r: float(np.sqrt(np.mean(r.values**2)))),
        ("residual, largest", ".3g", lambda r: float(np.abs(r.values).max())),
        ("white", "", lambda r: "yes" if r.is_white else "no"),
        note="White: by Ljung and Box at 0.1 %. If a column is not, the model lacks something, and "
        "intervals are widened to those of correlated errors.",
    )


def _sign_tables(estimate: Estimate, subject: str) -> list[ResultTable]:
    """Return the decisions about signs of swings with both likelihoods; no table if there was none
    to make.
    """
    if not estimate.signs:
        return []
    table = make_table(
        _titled("Signs of the swings", subject),
        estimate.signs,
        ("column", "", lambda one: one.column),
        ("taken", "", lambda one: "turned" if one.is_turned else "as recorded"),
        ("log-likelihood as recorded", ".1f", lambda one: one.as_recorded),
        ("turned", ".1f", lambda one: one.turned),
        note="The records are not explained as they are, so that each swing was tried either way. "
        f"The other sign is taken where it makes the log-likelihood larger by {SIGN_EVIDENCE:g} at "
        "least. --sign phi=1 or phi=-1 states it.",
    )
    return [table]


def inertia_tables(estimate: Estimate, effects: Sequence[InertiaEffect]) -> list[ResultTable]:
    """Return the table of how far estimates move with masses and inertias that nobody stated; no
    table if all were stated or estimated.
    """
    assumed = assumed_inertias(estimate)
    if not effects:
        return []

    def moved(name: str) -> Column:
        """Return the column of how far a parameter moves."""
        return f"Δ {name}", "+.3g", lambda effect: effect.moved.get(name)

    values = ", ".join(f"{one.name} = {one.value:g} {one.unit}" for one in assumed)
    worst = max(effects, key=lambda effect: effect.intervals)
    note = f"Nobody stated {values}; --set states them. Intervals do not include what they move."
    if worst.parameter:
        note += (
            f" Most moves {worst.parameter}, by {worst.intervals:.3g} half widths of its interval "
            f"({worst.change})."
        )
    table = make_table(
        "What was assumed of masses and inertias",
        effects,
        ("change", "", lambda effect: effect.change),
        ("in half intervals", ".3g", lambda effect: finite_or_none(effect.intervals)),
        ("of", "", lambda effect: effect.parameter),
        *(moved(p.name) for p in estimate.model.own),
        note=note,
    )
    return [table]


def doubts(result: Identification, subject: str) -> list[ResultTable]:
    """Return the tables of what records cannot tell, and of moves whose record would."""
    judged = result.judged
    pairs = [
        (f"{p.first} from {p.second}", finite_or_none(p.correlation)) for p in judged.inseparable
    ]
    pairs += [(f"{name}, next to nothing", None) for name in judged.undetermined]
    pairs_table = ResultTable(
        _titled("What these records cannot tell", subject),
        [("parameter", ""), ("correlation", "+.3f")],
        pairs or [("nothing: all parameters are told apart", None)],
    )
    if not judged.advice:
        return [pairs_table]

    def margin(name: str) -> Column:
        """Return the column of half the interval of a parameter."""
        return f"± {name}", ".2g", lambda advice: finite_or_none(advice.margins[name])

    worst = max((abs(pair.correlation) for pair in judged.inseparable), default=0.0)
    columns = [margin(name) for name in judged.doubtful]
    if judged.inseparable:
        columns.append(("correlation", ".3f", lambda advice: advice.correlation))
    moves_table = make_table(
        _titled("Moves that would tell", subject),
        [Advice("none", judged.margins, worst), *judged.advice],
        ("a further record", "", lambda advice: advice.move),
        *columns,
        note="Half intervals that a further record would leave together with these, the best "
        "first.",
    )
    return [pairs_table, moves_table]


def of_trials(trials: Sequence[Trial]) -> list[ResultTable]:
    """Return the swing that strategies leave on the twin; no table if none was tried."""
    if not trials:
        return []
    table = make_table(
        "Controllers tried on the twin",
        trials,
        ("strategy", "", lambda trial: trial.strategy),
        ("designed for", "", lambda trial: trial.designed),
        ("median [mrad]", ".3g", lambda trial: 1e3 * np.quantile(trial.swing, 0.5)),
        ("worst [mrad]", ".3g", lambda trial: 1e3 * np.quantile(trial.swing, 1.0)),
        note=f"Swing left by the combined move of experiment compare on {len(trials[0].swing)} "
        "cranes that the estimate allows, with errors of cable and sensors, without lag and delay.",
    )
    return [table]
