"""The tables of the comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from experiments.compare.runs import (
    NO_SWING_FEEDBACK,
    Results,
    StrategyResult,
    TourResult,
    score_of,
)
from experiments.harness import Column, ResultTable, finite_or_none, make_table
from experiments.scenarios.moves import IDEAL, RestToRest, Score
from experiments.scenarios.perturbations import NOMINAL, PERTURBATIONS, UNTOLD, Perturbation


class _Resolution(NamedTuple):
    """Least values that are told apart, as the end of a column's format.

    Attributes:
        swing: Least swing [mrad].
        hook: Least amplitude of the hook [mm].
    """

    swing: str
    hook: str


RESOLUTION = {IDEAL: _Resolution(">0.001", ">0.01"), "velocity": _Resolution(">0.1", ">1")}
"""Least values that are told apart, by the kind of the drives.

Rates of converters come in 1/16384 of the largest, and one such step of the trolley's or slew's
rate swings a load on 15 m by 0.009 mrad; a dozen of them in step with the swing, as rounding may
have it, are 0.1 mrad. On ideal drives the control period leaves some 0.001 mrad.
"""


def least_swing(drive: str) -> float:
    """Return the least swing that is told apart on drives of a kind [mrad]."""
    return float(RESOLUTION[drive].swing.removeprefix(">"))


ScoredStrategy = tuple[str, Score | None]
"""Name of a strategy and its score, None if there is none."""


def _value(read: Callable[[Score], float | None]) -> Callable[[ScoredStrategy], float | None]:
    """Return a function that reads a number of a score, None where there is no score."""

    def read_row(row: ScoredStrategy) -> float | None:
        score = row[1]
        return None if score is None else read(score)

    return read_row


def _reasons(results: Mapping[str, StrategyResult]) -> str:
    """Return why some have no numbers, each reason once, with their names.

    Where more than two share a reason, their number stands for the names.
    """
    names_of: dict[str, list[str]] = {}
    for name, result in results.items():
        if result.why:
            names_of.setdefault(result.why, []).append(name)
    text = ""
    for why, names in names_of.items():
        subject = "; ".join(names) if len(names) < 3 else f"{len(names)} others"
        text += f" {subject}: {why}"
    return text


def _hook(score: Score) -> float:
    """Return the amplitude of the hook at the arrival [mm]."""
    return 1e3 * score.arrival * score.length


def move_table(move: RestToRest, results: Results, drive: str) -> ResultTable:
    """Return the swing of a move under each strategy."""
    resolution = RESOLUTION[drive]
    nominal = {strategy: cases[NOMINAL.name] for strategy, cases in results.items()}
    rows: list[ScoredStrategy] = [(strategy, result.score) for strategy, result in nominal.items()]
    swing = f".3g{resolution.swing}"
    hook = f".4g{resolution.hook}"
    return make_table(
        f"Move {move.name}: {move.start} to {move.goal}",
        rows,
        ("strategy", "", lambda row: row[0]),
        ("arrives [s]", ".2f", _value(lambda score: score.arrives)),
        ("peak [mrad]", ".1f", _value(lambda score: 1e3 * score.peak)),
        ("at arrival [mrad]", swing, _value(lambda score: 1e3 * score.arrival)),
        ("hook [mm]", hook, _value(_hook)),
        ("20 s later [mrad]", swing, _value(lambda score: 1e3 * score.later)),
        ("settled [s]", ".2f", _value(lambda score: finite_or_none(score.settled))),
        ("cycle [s]", ".2f", _value(lambda score: finite_or_none(score.cycle))),
        note="Swings are amplitudes. Settled: the payload stays within 10 mm of its goal, after "
        "the arrival and (cycle) after the start; a dash: not within 20 s."
        f"{_quantised(drive)}{_reasons(nominal)}",
    )


def _effort(row: tuple[str, Score], name: str, drive: int) -> float:
    """Return an effort of a score by the name of its attribute [kN m or kN]."""
    return 1e-3 * float(getattr(row[1], name)[drive])


def drives_table(move: RestToRest, results: Results, *, beyond: bool = False) -> ResultTable:
    """Return what a move asks of the drives.

    Args:
        move: The move.
        results: Results of the move.
        beyond: Whether to show for how long the drives were asked for more than they have also
            where they never were.
    """
    rows = []
    for strategy in results:
        score = score_of(results, strategy, NOMINAL.name)
        if score:
            rows.append((strategy, score))
    columns: list[Column] = [("strategy", "", lambda row: row[0])]
    for kind, name in (("peak", "effort"), ("RMS", "rms")):
        for i, (drive, unit) in enumerate((("T_γ", "kN m"), ("F_x", "kN"), ("F_l", "kN"))):
            read = partial(_effort, name=name, drive=i)
            columns.append((f"{drive} {kind} [{unit}]", ".2f", read))
    columns += [
        ("work [kJ]", ".1f", lambda row: 1e-3 * row[1].work),
        ("rate", ".2f", lambda row: row[1].rate),
        ("acc.", ".2f", lambda row: row[1].acceleration),
    ]
    note = (
        "Efforts beyond holding the load. Work: put in by the drives, without what they take "
        "back. Rate, acc.: largest, as a share of the limits of the plans."
    )
    if beyond or any(score.beyond for _, score in rows):
        columns.append(("beyond [s]", ".2f", lambda row: row[1].beyond))
        note += " Beyond: time in which drives were asked for more than their limits."
    return make_table(f"What move {move.name} asks of the drives", rows, *columns, note=note)


def tour_table(tours: Mapping[str, TourResult | str]) -> ResultTable:
    """Return the swing of the tour under each control.

    Args:
        tours: Result of each control, or why there is none, by its name.
    """
    reasons = ""
    rows: list[tuple[str, TourResult | None]] = []
    for name, tour in tours.items():
        if isinstance(tour, str):
            reasons += f" {name}: {tour}"
            rows.append((name, None))
        else:
            rows.append((name, tour))
    resolution = RESOLUTION[IDEAL]
    return make_table(
        "The article's seven legs as one tour",
        rows,
        ("control", "", lambda row: row[0]),
        ("cycle [s]", ".1f", lambda row: row[1] and row[1].cycle),
        ("worst dwell [mrad]", f".4g{resolution.swing}", lambda row: row[1] and row[1].worst),
        ("mean of dwells [mrad]", f".4g{resolution.swing}", lambda row: row[1] and row[1].mean),
        ("worst at the hook [mm]", f".4g{resolution.hook}", lambda row: row[1] and row[1].hook),
        ("peak on the way [mrad]", ".1f", lambda row: row[1] and row[1].peak),
        note=f"Amplitudes of radial and tangential swing together.{reasons}",
    )


def case_tables(results: Results, drive: str) -> list[ResultTable]:
    """Return the swing and the settling time of each strategy under each case."""
    reasons = {}
    for strategy, cases in results.items():
        for case, result in cases.items():
            if result.why != NO_SWING_FEEDBACK:
                reasons[f"{strategy}, {case}"] = result
    dash = "A dash: no feedback of the swing, not settled in 20 s, or diverged."
    later = _case_columns(
        results, PERTURBATIONS, f".3g{RESOLUTION[drive].swing}", lambda score: 1e3 * score.later
    )
    settled = _case_columns(
        results, PERTURBATIONS, ".3g", lambda score: finite_or_none(score.settled)
    )
    return [
        make_table(
            "Swing 20 s after the arrival [mrad], combined move",
            results,
            *later,
            note=f"{dash}{_quantised(drive)}{_reasons(reasons)}",
        ),
        make_table(
            "Settled within 10 mm [s after the arrival], combined move",
            results,
            *settled,
            note=f"{dash}{_reasons(reasons)}",
        ),
    ]


def observer_table(results: Results) -> ResultTable:
    """Return the swing at the arrival of every strategy where the drives alone are seen."""
    scored = []
    for strategy in results:
        if any(score_of(results, strategy, case.name) for case in UNTOLD):
            scored.append(strategy)
    return make_table(
        "Swing at the arrival where the drives alone are seen [mrad], combined move",
        scored,
        *_case_columns(results, UNTOLD, ".3g", lambda score: 1e3 * score.arrival),
        note="State alone: the observer trusts planned load and cable. Load too: it estimates "
        "both. A dash: diverged.",
    )


def _case_columns(
    results: Results, cases: Sequence[Perturbation], form: str, read: Callable[[Score], Any]
) -> list[Column]:
    """Return the columns of strategies that show a number of their scores under each case."""

    def value(strategy: str, case: str) -> float | None:
        score = score_of(results, strategy, case)
        return read(score) if score else None

    columns: list[Column] = [("strategy", "", str)]
    for case in cases:
        columns.append((case.name, form, partial(value, case=case.name)))
    return columns


def _quantised(drive: str) -> str:
    """Return why small swings are not told apart, nothing where drives are ideal."""
    if drive == IDEAL:
        return ""
    return " Below 0.1 mrad the rounding of the commanded rates decides."
