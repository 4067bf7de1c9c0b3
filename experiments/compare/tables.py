"""The tables of the comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from experiments.compare.result import (
    IDEAL,
    UNSEEING,
    Results,
    StrategyResult,
    TourResult,
    score_of,
)
from experiments.harness import Column, ResultTable, finite_or_none, tabulate
from experiments.scenarios.moves import RestToRest, Score
from experiments.scenarios.perturbations import NOMINAL, PERTURBATIONS

RESOLUTION = {IDEAL: (">0.001", ">0.01"), "velocity": (">0.1", ">1")}
"""Least swing [mrad] and way of the hook [mm] that are told apart, by drives. Rates of converters
come in 1/16384 of the largest, and one such step of the trolley's or slew's rate swings a load on
15 m by 0.009 mrad; a dozen of them in step with the swing, as rounding may have it, are 0.1 mrad.
On ideal drives the control period leaves some 0.001 mrad."""


def _reasons(results: Mapping[str, StrategyResult]) -> str:
    """Return why some have no numbers, each reason once."""
    reasons: dict[str, list[str]] = {}
    for name, result in results.items():
        if result.why:
            reasons.setdefault(result.why, []).append(name)
    return "".join(f" {', '.join(names)}: {why}" for why, names in reasons.items())


def _of_score(
    value: Callable[[Score], float | None],
) -> Callable[[tuple[str, StrategyResult]], Any]:
    """Return the function for a column of strategies that takes a value of their scores."""
    return lambda row: value(row[1].score) if row[1].score else None


def move_table(move: RestToRest, results: Results, drive: str) -> ResultTable:
    """Return the swing of a move under each strategy."""
    swing, hook = RESOLUTION[drive]
    nominal = {strategy: cases[NOMINAL.name] for strategy, cases in results.items()}
    return tabulate(
        f"Move {move.name}: {move.start} to {move.goal}",
        nominal.items(),
        [
            ("strategy", "", lambda row: row[0]),
            ("arrives [s]", ".2f", _of_score(lambda s: s.arrives)),
            ("peak [mrad]", ".1f", _of_score(lambda s: 1e3 * s.peak)),
            ("at arrival [mrad]", f".3g{swing}", _of_score(lambda s: 1e3 * s.arrival)),
            ("hook [mm]", f".4g{hook}", _of_score(lambda s: 1e3 * s.arrival * s.length)),
            ("20 s later [mrad]", f".3g{swing}", _of_score(lambda s: 1e3 * s.later)),
            ("settled [s]", ".2f", _of_score(lambda s: finite_or_none(s.settled))),
            ("cycle [s]", ".2f", _of_score(lambda s: finite_or_none(s.cycle))),
        ],
        "Amplitudes of the swing; hook: the same at the hook on arrival; settled: time after it "
        "from which the payload stays within 10 mm of its goal, a dash where it does not in 20 s; "
        f"cycle: from the start until then.{_quantised(drive)}{_reasons(nominal)}",
    )


def _effort(row: tuple[str, StrategyResult], name: str, drive: int) -> float | None:
    return 1e-3 * float(getattr(row[1].score, name)[drive]) if row[1].score else None


def drives_table(move: RestToRest, results: Results, *, beyond: bool = False) -> ResultTable:
    """Return what a move asks of the drives; if they are asked for more than they have, or
    `beyond`, for how long.
    """
    nominal = {strategy: cases[NOMINAL.name] for strategy, cases in results.items()}
    nominal = {strategy: result for strategy, result in nominal.items() if result.score}
    beyond = beyond or any(result.score and result.score.beyond for result in nominal.values())
    drives = (("T_γ", "kN m"), ("F_x", "kN"), ("F_l", "kN"))
    efforts: list[Column] = [
        (f"{drive} {kind} [{unit}]", ".2f", partial(_effort, name=name, drive=i))
        for kind, name in (("peak", "effort"), ("RMS", "rms"))
        for i, (drive, unit) in enumerate(drives)
    ]
    late: list[Column] = [("beyond [s]", ".2f", _of_score(lambda s: s.beyond))]
    return tabulate(
        f"What move {move.name} asks of the drives",
        nominal.items(),
        [
            ("strategy", "", lambda row: row[0]),
            *efforts,
            ("work [kJ]", ".1f", _of_score(lambda s: 1e-3 * s.work)),
            ("rate", ".2f", _of_score(lambda s: s.rate)),
            ("acc.", ".2f", _of_score(lambda s: s.acceleration)),
            *late[:beyond],
        ],
        "Efforts beyond holding the load at rest; work: what the drives put in, not counting what "
        "they took back; rate, acc.: largest rate and acceleration as a share of the limits that "
        "the plans keep. Feedback is limited by effort only."
        + " Beyond: time in which drives that follow a motion or a rate were asked for more effort "
        "or rate than they have." * beyond,
    )


def tour_table(tours: Mapping[str, TourResult | str]) -> ResultTable:
    """Return the swing of the tour under each control."""
    swing, hook = RESOLUTION[IDEAL]
    reasons = "".join(f" {name}: {why}" for name, why in tours.items() if isinstance(why, str))
    return tabulate(
        "The article's seven legs as one tour",
        [(name, None if isinstance(tour, str) else tour) for name, tour in tours.items()],
        [
            ("control", "", lambda row: row[0]),
            ("cycle [s]", ".1f", lambda row: row[1] and row[1].cycle),
            ("worst dwell [mrad]", f".4g{swing}", lambda row: row[1] and row[1].worst),
            ("mean of dwells [mrad]", f".4g{swing}", lambda row: row[1] and row[1].mean),
            ("worst at the hook [mm]", f".4g{hook}", lambda row: row[1] and row[1].hook),
            ("peak on the way [mrad]", ".1f", lambda row: row[1] and row[1].peak),
        ],
        f"Half the way across, radial and tangential together.{reasons}",
    )


def case_tables(results: Results, drive: str) -> Iterator[ResultTable]:
    """Yield the swing and the settling time of each strategy under each case."""
    reasons = {
        f"{strategy}, {case}": result
        for strategy, cases in results.items()
        for case, result in cases.items()
        if result.why != UNSEEING
    }
    dash = "A dash: it does not look at the swing, or does not settle in 20 s, or breaks off."

    def value(
        row: tuple[str, dict[str, StrategyResult]], case: str, read: Callable
    ) -> float | None:
        score = score_of(results, row[0], case)
        return read(score) if score else None

    swing = RESOLUTION[drive][0]
    for title, read, resolution, note in (
        ("Swing 20 s after the arrival [mrad]", lambda s: 1e3 * s.later, swing, _quantised(drive)),
        ("Settled within 10 mm [s after the arrival]", lambda s: finite_or_none(s.settled), "", ""),
    ):
        columns: list[Column] = [
            (case.name, f".3g{resolution}", partial(value, case=case.name, read=read))
            for case in PERTURBATIONS
        ]
        yield tabulate(
            f"{title}, combined move",
            results.items(),
            [("strategy", "", lambda row: row[0]), *columns],
            f"{dash}{note}{_reasons(reasons)}",
        )


def _quantised(drive: str) -> str:
    """Return why small swings are not told apart, nothing where drives are ideal."""
    if drive == IDEAL:
        return ""
    return " Less than 0.1 mrad is decided by the rounding of the rates that converters take."
