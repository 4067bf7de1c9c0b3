"""The tables of the comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from experiments.compare.runs import UNSEEING, Results, StrategyResult, TourResult, score_of
from experiments.harness import Column, ResultTable, finite_or_none, make_table
from experiments.scenarios.moves import IDEAL, RestToRest, Score
from experiments.scenarios.perturbations import NOMINAL, PERTURBATIONS, UNTOLD, Perturbation

RESOLUTION = {IDEAL: (">0.001", ">0.01"), "velocity": (">0.1", ">1")}
"""Least swing [mrad] and way of the hook [mm] that are told apart, by drives. Rates of converters
come in 1/16384 of the largest, and one such step of the trolley's or slew's rate swings a load on
15 m by 0.009 mrad; a dozen of them in step with the swing, as rounding may have it, are 0.1 mrad.
On ideal drives the control period leaves some 0.001 mrad."""


def _reasons(results: Mapping[str, StrategyResult]) -> str:
    """Return why some have no numbers, each reason once, with their names or, if many, number."""
    reasons: dict[str, list[str]] = {}
    for name, result in results.items():
        if result.why:
            reasons.setdefault(result.why, []).append(name)
    return "".join(
        f" {'; '.join(names) if len(names) < 3 else f'{len(names)} others'}: {why}"
        for why, names in reasons.items()
    )


def _hook(score: Score) -> float:
    """Return the amplitude of the hook on arrival [mm]."""
    return 1e3 * score.arrival * score.length


def move_table(move: RestToRest, results: Results, drive: str) -> ResultTable:
    """Return the swing of a move under each strategy."""
    swing, hook = RESOLUTION[drive]
    nominal = {strategy: cases[NOMINAL.name] for strategy, cases in results.items()}
    return make_table(
        f"Move {move.name}: {move.start} to {move.goal}",
        [(strategy, result.score) for strategy, result in nominal.items()],
        ("strategy", "", lambda row: row[0]),
        ("arrives [s]", ".2f", lambda row: row[1] and row[1].arrives),
        ("peak [mrad]", ".1f", lambda row: row[1] and 1e3 * row[1].peak),
        ("at arrival [mrad]", f".3g{swing}", lambda row: row[1] and 1e3 * row[1].arrival),
        ("hook [mm]", f".4g{hook}", lambda row: row[1] and _hook(row[1])),
        ("20 s later [mrad]", f".3g{swing}", lambda row: row[1] and 1e3 * row[1].later),
        ("settled [s]", ".2f", lambda row: row[1] and finite_or_none(row[1].settled)),
        ("cycle [s]", ".2f", lambda row: row[1] and finite_or_none(row[1].cycle)),
        note="Swings are amplitudes. Settled: the payload stays within 10 mm of its goal, after "
        "the arrival and (cycle) after the start; a dash: not within 20 s."
        f"{_quantised(drive)}{_reasons(nominal)}",
    )


def _effort(row: tuple[str, Score], name: str, drive: int) -> float:
    return 1e-3 * float(getattr(row[1], name)[drive])


def drives_table(move: RestToRest, results: Results, *, beyond: bool = False) -> ResultTable:
    """Return what a move asks of the drives; if they are asked for more than they have, or
    `beyond`, for how long.
    """
    scores = {strategy: score_of(results, strategy, NOMINAL.name) for strategy in results}
    rows = [(strategy, score) for strategy, score in scores.items() if score]
    beyond = beyond or any(score.beyond for _, score in rows)
    efforts: list[Column] = [
        (f"{drive} {kind} [{unit}]", ".2f", partial(_effort, name=name, drive=i))
        for kind, name in (("peak", "effort"), ("RMS", "rms"))
        for i, (drive, unit) in enumerate((("T_γ", "kN m"), ("F_x", "kN"), ("F_l", "kN")))
    ]
    late: list[Column] = [("beyond [s]", ".2f", lambda row: row[1].beyond)]
    return make_table(
        f"What move {move.name} asks of the drives",
        rows,
        ("strategy", "", lambda row: row[0]),
        *efforts,
        ("work [kJ]", ".1f", lambda row: 1e-3 * row[1].work),
        ("rate", ".2f", lambda row: row[1].rate),
        ("acc.", ".2f", lambda row: row[1].acceleration),
        *late[:beyond],
        note="Efforts beyond holding the load. Work: put in by the drives, without what they take "
        "back. Rate, acc.: largest, as a share of the limits of the plans."
        + " Beyond: time in which drives were asked for more than their limits."
        * beyond,
    )


def tour_table(tours: Mapping[str, TourResult | str]) -> ResultTable:
    """Return the swing of the tour under each control."""
    swing, hook = RESOLUTION[IDEAL]
    reasons = "".join(f" {name}: {why}" for name, why in tours.items() if isinstance(why, str))
    return make_table(
        "The article's seven legs as one tour",
        [(name, None if isinstance(tour, str) else tour) for name, tour in tours.items()],
        ("control", "", lambda row: row[0]),
        ("cycle [s]", ".1f", lambda row: row[1] and row[1].cycle),
        ("worst dwell [mrad]", f".4g{swing}", lambda row: row[1] and row[1].worst),
        ("mean of dwells [mrad]", f".4g{swing}", lambda row: row[1] and row[1].mean),
        ("worst at the hook [mm]", f".4g{hook}", lambda row: row[1] and row[1].hook),
        ("peak on the way [mrad]", ".1f", lambda row: row[1] and row[1].peak),
        note=f"Amplitudes of radial and tangential swing together.{reasons}",
    )


def case_tables(results: Results, drive: str) -> list[ResultTable]:
    """Return the swing and the settling time of each strategy under each case."""
    reasons = {
        f"{strategy}, {case}": result
        for strategy, cases in results.items()
        for case, result in cases.items()
        if result.why != UNSEEING
    }
    dash = "A dash: no feedback of the swing, not settled in 20 s, or diverged."
    later = f".3g{RESOLUTION[drive][0]}", lambda s: 1e3 * s.later
    settled = ".3g", lambda s: finite_or_none(s.settled)
    return [
        make_table(
            f"{title}, combined move",
            results,
            *_case_columns(results, PERTURBATIONS, *quantity),
            note=f"{dash}{note}{_reasons(reasons)}",
        )
        for title, quantity, note in (
            ("Swing 20 s after the arrival [mrad]", later, _quantised(drive)),
            ("Settled within 10 mm [s after the arrival]", settled, ""),
        )
    ]


def observer_table(results: Results) -> ResultTable:
    """Return the swing at the arrival of every strategy where the drives alone are seen."""
    names = [case.name for case in UNTOLD]
    return make_table(
        "Swing at the arrival where the drives alone are seen [mrad], combined move",
        [s for s in results if any(score_of(results, s, name) for name in names)],
        *_case_columns(results, UNTOLD, ".3g", lambda s: 1e3 * s.arrival),
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

    cells: list[Column] = [(c.name, form, partial(value, case=c.name)) for c in cases]
    return [("strategy", "", str), *cells]


def _quantised(drive: str) -> str:
    """Return why small swings are not told apart, nothing where drives are ideal."""
    if drive == IDEAL:
        return ""
    return " Below 0.1 mrad the rounding of the commanded rates decides."
