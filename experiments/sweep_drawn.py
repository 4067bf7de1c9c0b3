"""Tables of moves drawn at random: swing that each strategy leaves, failures, time of a case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import binomtest

from experiments import harness
from experiments.scenarios.drawn import RANGES, UNBATCHED
from experiments.scenarios.moves import DRAG
from experiments.scenarios.robustness import AFTER, COMBINED
from experiments.scenarios.strategies import FLAT

MOST_LEFT = 5e-3
"""Swing that may be left [rad]: 5 cm at the hook, on the 10 m of cable with which the move ends."""

RARELY = 1e-3
"""Share of cases in which a strategy may fail that is claimed not to."""

CONFIDENCE = 0.95
"""Confidence of the intervals."""

MANY = 100_000
"""Number of cases whose time is estimated."""

Columns = Mapping[str, np.ndarray]


def drawn_tables(columns: Columns, drive: str) -> list[harness.ResultTable]:
    """Return the tables of swing, failures and time of each strategy."""
    drives = f"on {drive} drives"
    return [_swings(columns, drives), _failures(columns, drives), _costs(columns, drives)]


def drawn_claims(columns: Columns, drive: str, errors: int) -> list[harness.Claim]:
    """Return the claims on drawn cases."""
    claims = [
        harness.Claim(
            f"Each of the {len(columns['case']):,} cases is done and none is bad.", errors == 0
        )
    ]
    of_flat = columns["strategy"] == FLAT
    if of_flat.any():
        failed, count = int(failures(columns)[of_flat].sum()), int(of_flat.sum())
        claims.append(
            harness.Claim(
                f"On {drive} drives {FLAT} fails in at most {1e3 * RARELY:g} of a thousand cases "
                f"({failed} of {count:,}).",
                failed <= RARELY * count,
            )
        )
    return claims


def failures(columns: Columns) -> np.ndarray:
    """Return whether each case left a range, had a slack rope, diverged or left too much swing."""
    return (columns["broken"] == 1.0) | ~(columns["residual_swing_rad"] <= MOST_LEFT)


def _each(columns: Columns) -> Iterator[tuple[str, np.ndarray]]:
    for strategy in dict.fromkeys(columns["strategy"].tolist()):
        yield strategy, columns["strategy"] == strategy


def _quantiles(swings: np.ndarray, *shares: float) -> list[float | None]:
    """Return quantiles [mrad] of swings [rad], None where infinite; NaN counts as infinite."""
    swings = np.where(np.isfinite(swings), swings, math.inf)
    quantiles = 1e3 * np.quantile(swings, shares, method="higher")
    return [float(value) if math.isfinite(value) else None for value in quantiles]


def _swings(columns: Columns, drives: str) -> harness.ResultTable:
    rows = [
        (
            strategy,
            int(selected.sum()),
            *_quantiles(columns["arrival_swing_rad"][selected], 0.5, 0.95),
            *_quantiles(columns["residual_swing_rad"][selected], 0.5, 0.95, 1.0),
        )
        for strategy, selected in _each(columns)
    ]
    headings = [
        ("strategy", ""),
        ("cases", ",d"),
        ("arrival, median [mrad]", ".3g"),
        ("arrival, 95 % below [mrad]", ".3g"),
        ("left, median [mrad]", ".3g"),
        ("left, 95 % below [mrad]", ".3g"),
        ("left, worst [mrad]", ".3g"),
    ]
    low, high = RANGES["load"]
    note = (
        f"Amplitude of the swing at the arrival of the {COMBINED.name} move and {AFTER:g} s later. "
        f"Drawn at random, evenly: load {low:g} to {high:g} times that planned for; cable up to "
        f"{RANGES['cable_error_m'][1]:g} m longer or shorter than measured; a gust of up to "
        f"{RANGES['gust_m_s'][1]:g} m/s from any side on {DRAG:g} m² of load, of "
        f"{RANGES['gust_lasts_s'][0]:g} to {RANGES['gust_lasts_s'][1]:g} s, begun in the first "
        f"{RANGES['gust_at_s'][1]:g} s; noise of the sensors up to {RANGES['noise'][1]:g} times "
        f"the usual; sensors up to {RANGES['delay'][1] - 1:g} control periods late; converters, "
        f"where there are, of {RANGES['lag'][0]:g} to {RANGES['lag'][1]:g} times the usual lag. "
        "Drives that follow exactly need no sensors. A dash: the crane diverged. Not in a batch: "
        + "; ".join(f"{name}, as {why}" for name, why in UNBATCHED.items())
        + "."
    )
    return harness.ResultTable(f"Swing of moves that are drawn, {drives}", headings, rows, note)


def _failures(columns: Columns, drives: str) -> harness.ResultTable:
    failed, much = failures(columns), ~(columns["residual_swing_rad"] <= MOST_LEFT)
    rows = []
    for strategy, selected in _each(columns):
        count, failures_of_strategy = int(selected.sum()), int(failed[selected].sum())
        interval = binomtest(failures_of_strategy, count).proportion_ci(CONFIDENCE, "exact")
        shares = (
            columns["broken"][selected].mean(),
            much[selected].mean(),
            failures_of_strategy / count,
            interval.low,
            interval.high,
            np.isfinite(columns["valid_until_s"][selected]).mean(),
        )
        values: list[float | None] = [100.0 * float(share) for share in shares]
        rows.append((strategy, *values))
    headings = [
        ("strategy", ""),
        ("broken [%]", ".2f"),
        ("too much left [%]", ".2f"),
        ("fails [%]", ".2f"),
        ("at least [%]", ".2f"),
        ("at most [%]", ".2f"),
        ("beyond [%]", ".2f"),
    ]
    note = (
        "Broken: at one of 20 instants a second a joint is out of its range, the rope slack or the "
        f"load on the ground. Too much left: more than {1e3 * MOST_LEFT:g} mrad. Fails: one or "
        f"both; at least, at most: its probability, with {100 * CONFIDENCE:g} % confidence "
        "(Clopper and Pearson 1934). Beyond: broken, or a drive that follows a motion or a rate is "
        "asked at an instant for more than it has."
    )
    return harness.ResultTable(
        f"How often moves fail that are drawn, {drives}", headings, rows, note
    )


def _costs(columns: Columns, drives: str) -> harness.ResultTable:
    rows = []
    for strategy, selected in _each(columns):
        spent = float(np.median(columns["spent_s"][selected]))
        rows.append((strategy, 1e3 * spent, spent * MANY / 60.0))
    headings = [("strategy", ""), ("a case [ms]", ".2f"), (f"{MANY:,} cases [min]", ".1f")]
    note = "Processor time on this machine, the median of batches; n processors share it."
    return harness.ResultTable(f"What moves cost that are drawn, {drives}", headings, rows, note)
