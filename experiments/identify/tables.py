"""What is printed of an identified crane: numbers, what is left, doubts, and what controllers leave
on its twin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.identification import Estimate, Model, Preflight, Twin, identify, preflight, twin_of
from cranedyn.identification.parameters import MEANINGS
from experiments.harness import Setup, Table
from experiments.identify.trial import Trial


@dataclass(frozen=True, eq=False)
class Found:
    """What was found of records.

    Attributes:
        estimate: The numbers.
        judged: What these records can tell.
        twin: The crane that follows.
    """

    estimate: Estimate
    judged: Preflight
    twin: Twin


def found(model: Model, setup: Setup, label: str) -> Found:
    """Identify, judge, and make the twin, with progress under a label."""
    estimate = identify(model, progress=setup.reporter.message(label, "predictions of the records"))
    return Found(estimate, preflight(model, estimate), twin_of(estimate))


def record_tables(result: Found, subject: str, truth: Mapping[str, float]) -> list[Table]:
    """Return the tables of records: numbers, residuals, and what they cannot tell."""
    return [values_table(result, subject, truth), _left(result, subject), *doubts(result, subject)]


def _titled(title: str, subject: str) -> str:
    return f"{subject}: {title[0].lower()}{title[1:]}" if subject else title


def values_table(result: Found, subject: str, truth: Mapping[str, float]) -> Table:
    """Return the values with their intervals, beside the prior and the truth."""
    parameters = result.estimate.model.own
    rows: list[tuple[float | str | None, ...]] = []
    for parameter in parameters:
        value, margin = result.estimate.found[parameter.name]
        true = truth.get(parameter.name)
        row = (parameter.name, parameter.unit, parameter.start, value, _finite(margin))
        rows.append((*row, true, None if true is None else value - true))
    columns = [("what", ""), ("unit", ""), ("believed", ".6g"), ("found", ".6g"), ("±", ".2g")]
    if truth:
        columns += [("true", ".6g"), ("off", "+.2g")]
    bound = result.estimate.at_bound
    kinds = dict.fromkeys(p.kind for p in parameters if p.kind in MEANINGS)
    meanings = "; ".join(f"{kind}: {MEANINGS[kind]}" for kind in kinds)
    note = f"±: half the 95 % interval. {meanings[:1].upper()}{meanings[1:]}" + "." * bool(meanings)
    if bound:
        note += f" At the end of what is allowed, where an interval says nothing: {_list(bound)}."
    note = " ".join([note, *(n for record in result.estimate.model.records for n in record.notes)])
    shown = [row[: len(columns)] for row in rows]
    return Table(_titled("What the records say", subject), columns, shown, note.strip())


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)


def _left(result: Found, subject: str) -> Table:
    """Return the residual of each channel."""
    estimate, rows = result.estimate, []
    for index, record in enumerate(estimate.model.records):
        for c, channel in enumerate(estimate.model.channels[index]):
            off = estimate.residuals[index][c]
            std = float(np.std(estimate.model.measured(index)[c]))
            rms = float(np.sqrt(np.mean(off**2)))
            white = "yes" if estimate.white[index][c] else "no"
            row = (record.name, channel.column, len(off), std, rms, float(np.abs(off).max()))
            rows.append((*row, white))
    columns = [
        ("record", ""),
        ("column", ""),
        ("rows", "d"),
        ("recorded, std", ".3g"),
        ("left, RMS", ".3g"),
        ("left, most", ".3g"),
        ("white", ""),
    ]
    note = (
        "White: no memory in what is left, by Ljung and Box at 0.1 %. Where there is, the model "
        "lacks something, and intervals are widened to those of errors with a memory; what the "
        "model gets wrong always in the same way they do not know."
    )
    return Table(_titled("What the twin leaves", subject), columns, rows, note)


def doubts(result: Found, subject: str) -> list[Table]:
    """Return what records cannot tell, and which moves would."""
    judged = result.judged
    pairs: list[tuple[str | float, ...]] = [
        (f"{pair.one} from {pair.other}", pair.correlation) for pair in judged.alike
    ]
    pairs += [(f"{name}, next to nothing", math.nan) for name in judged.blind]
    rows_of_pairs = [(name_of_pair, None if rho != rho else rho) for name_of_pair, rho in pairs]
    pairs_table = Table(
        _titled("What these records cannot tell", subject),
        [("what", ""), ("correlation", "+.3f")],
        rows_of_pairs or [("nothing: all parameters are told apart", None)],
    )
    if not judged.advice:
        return [pairs_table]
    doubtful = list(
        dict.fromkeys([*(n for p in judged.alike for n in (p.one, p.other)), *judged.blind])
    )
    columns = [("a further record", ""), *((f"± {name}", ".2g") for name in doubtful)]
    if judged.alike:
        columns.append(("correlation", ".3f"))
    rows = [("none", judged.margins, max((abs(p.correlation) for p in judged.alike), default=0.0))]
    rows += [(a.move, a.margins, a.correlation) for a in judged.advice]
    table = [
        (move, *(_finite(margins[name]) for name in doubtful), rho)[: len(columns)]
        for move, margins, rho in rows
    ]
    note = "Half intervals that a further record would leave together with these, the best first."
    return [pairs_table, Table(_titled("Moves that would tell", subject), columns, table, note)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def of_trials(trials: Sequence[Trial]) -> list[Table]:
    """Return the swing that strategies leave on the twin; no table if none was tried."""
    if not trials:
        return []
    rows = [
        (trial.strategy, trial.designed, *(1e3 * np.quantile(trial.swing, [0.5, 1.0])))
        for trial in trials
    ]
    columns = [
        ("strategy", ""),
        ("designed for", ""),
        ("median [mrad]", ".3g"),
        ("worst [mrad]", ".3g"),
    ]
    note = (
        f"Swing left by the combined move of experiment compare on {len(trials[0].swing)} cranes "
        "that the estimate allows, with their cables and sensors as wrong as they were found; "
        "lag and delay are not among it."
    )
    return [Table("Controllers tried on the twin", columns, rows, note)]
