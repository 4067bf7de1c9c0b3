"""Tables, claims and figures of the sweep: of cases on a grid, and of cases drawn at random."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.harness import Claim, ResultTable, make_table
from experiments.harness.table import Cell
from experiments.scenarios.moves import COMBINED, DRAG, IDEAL
from experiments.scenarios.strategies import FLAT, PAPER, PD, strategy_colour
from experiments.sweep.sweep_study import AFTER, RANGES, UNBATCHED

# Workers import this module, too. They tabulate and draw nothing, and do not wait for SciPy's
# statistics and Matplotlib, which functions below import.
if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADS = (0.5, 1.5)
"""Range of the grid: mass of the payload over the planned one."""

CABLES = (-1.5, 1.5)
"""Range of the grid: true less measured cable length [m]."""

DURATIONS = (13.0, 35.0)
"""Range of the grid: duration of the move [s]."""

MAX_RESIDUAL_SWING = 5e-3
"""Largest residual swing with which a move does not fail [rad]: 5 cm at the hook, on the 10 m of
cable with which the move ends."""

MAX_FAILURE_SHARE = 1e-3
"""Largest share of cases in which a strategy fails that is claimed not to fail."""

CONFIDENCE = 0.95
"""Confidence of the intervals."""

MANY = 100_000
"""Number of cases whose time is estimated."""

CELLS = 12
"""Cells of a map of drawn cases along each side."""

Columns = Mapping[str, np.ndarray]
"""Columns of a design and its results by name, shape (cases,) each."""


def by_strategy(columns: Columns) -> dict[str, Columns]:
    """Return the columns of each strategy, in the order of the cases."""
    strategies = columns["strategy"]
    result: dict[str, Columns] = {}
    for strategy in dict.fromkeys(strategies.tolist()):
        rows = strategies == strategy
        result[strategy] = {name: column[rows] for name, column in columns.items()}
    return result


def grid_table(columns: Columns, drive: str) -> ResultTable:
    """Return the swing that each strategy leaves on the grid."""

    def quantile(cases: Columns, share: float) -> float:
        return 1e3 * float(np.nanquantile(cases["residual_swing_rad"], share))

    drives = (
        "Strategies without a controller in their name have drives that follow exactly."
        if drive == IDEAL
        else "All drives have typical frequency converters."
    )
    suffix = "" if drive == IDEAL else " on velocity drives"
    compared = columns["rounding_rad"]
    compared = compared[~np.isnan(compared)]
    return make_table(
        f"Swing left by {len(columns['case']):,} moves{suffix}",
        by_strategy(columns).items(),
        ("strategy", "", lambda s: s[0]),
        ("cases", ",d", lambda s: len(s[1]["case"])),
        ("failed", "d", lambda s: int(np.isnan(s[1]["residual_swing_rad"]).sum())),
        ("median [mrad]", ".3g", lambda s: quantile(s[1], 0.5)),
        ("95 % below [mrad]", ".3g", lambda s: quantile(s[1], 0.95)),
        ("worst [mrad]", ".3g", lambda s: quantile(s[1], 1.0)),
        ("worst on the way [mrad]", ".3g", lambda s: 1e3 * np.nanmax(s[1]["peak_swing_rad"])),
        ("worst off goal [mm]", ".3g", lambda s: 1e3 * np.nanmax(s[1]["off_goal_m"])),
        note=f"Swing {AFTER:g} s after the arrival of the {COMBINED.name} move of {DURATIONS[0]:g} "
        f"to {DURATIONS[1]:g} s. Loads are {LOADS[0]:g} to {LOADS[1]:g} times the planned one, "
        f"cables up to {CABLES[1]:g} m off. {drives} Steps are in single precision; in "
        f"{len(compared):,} cases that were computed in doubles, too, what is left differs by at "
        f"most {1e3 * compared.max(initial=0.0):.2g} mrad.",
    )


def _none_is_bad(columns: Columns, errors: int) -> Claim:
    """Return the claim that no case failed with an error."""
    count = len(columns["case"])
    return Claim(f"Each of the {count:,} cases is done and none is bad.", errors == 0)


def grid_claims(columns: Columns, errors: int) -> list[Claim]:
    """Return the claims on the grid."""
    durations = len(np.unique(columns["duration_s"]))
    # Residual swings of each strategy, a row for each duration.
    residual = {}
    for strategy, cases in by_strategy(columns).items():
        residual[strategy] = cases["residual_swing_rad"].reshape(durations, -1)
    other_swings = np.array([swing for strategy, swing in residual.items() if strategy != FLAT])
    pd = residual[PD]
    paper = residual[PAPER]
    return [
        _none_is_bad(columns, errors),
        Claim(
            f"{FLAT} leaves less swing than any other strategy, case by case.",
            bool((residual[FLAT] < other_swings).all()),
        ),
        Claim(
            f"At every time for the move the worst that {PAPER} leaves is below the median of "
            f"{PD}, which leaves less in {(paper >= pd).sum():,} of {pd.size:,} cases.",
            bool((paper.max(axis=1) < np.median(pd, axis=1)).all()),
        ),
    ]


def drawn_claims(columns: Columns, drive: str, errors: int) -> list[Claim]:
    """Return the claims on drawn cases."""
    claims = [_none_is_bad(columns, errors)]
    flat = by_strategy(columns).get(FLAT)
    if flat is not None:
        failed = failures(flat)
        claims.append(
            Claim(
                f"On {drive} drives {FLAT} fails in at most {1e3 * MAX_FAILURE_SHARE:g} of a "
                f"thousand cases ({failed.sum()} of {len(failed):,}).",
                bool(failed.sum() <= MAX_FAILURE_SHARE * len(failed)),
            )
        )
    return claims


def _leaves_too_much(columns: Columns) -> np.ndarray:
    """Return whether each case leaves too much swing; a crane that diverged does."""
    return ~(columns["residual_swing_rad"] <= MAX_RESIDUAL_SWING)


def failures(columns: Columns) -> np.ndarray:
    """Return whether each case left a range, had a slack rope, diverged or left too much swing."""
    return (columns["broken"] == 1.0) | _leaves_too_much(columns)


def drawn_tables(columns: Columns, drive: str) -> list[ResultTable]:
    """Return the tables of swing, failures and time of each strategy."""
    strategies = by_strategy(columns)
    drives = f"on {drive} drives"
    return [_swings(strategies, drives), _failures(strategies, drives), _costs(strategies, drives)]


def _swings(strategies: Mapping[str, Columns], drives: str) -> ResultTable:
    def quantile(cases: Columns, which: str, share: float) -> float | None:
        """Return a quantile [mrad], None where infinite; NaN counts as infinite."""
        swings = cases[f"{which}_swing_rad"]
        swings = np.where(np.isfinite(swings), swings, math.inf)
        value = 1e3 * float(np.quantile(swings, share, method="higher"))
        return value if math.isfinite(value) else None

    low, high = RANGES["load"]
    return make_table(
        f"Swing of random moves, {drives}",
        strategies.items(),
        ("strategy", "", lambda s: s[0]),
        ("cases", ",d", lambda s: len(s[1]["case"])),
        ("arrival, median [mrad]", ".3g", lambda s: quantile(s[1], "arrival", 0.5)),
        ("arrival, 95 % below [mrad]", ".3g", lambda s: quantile(s[1], "arrival", 0.95)),
        ("left, median [mrad]", ".3g", lambda s: quantile(s[1], "residual", 0.5)),
        ("left, 95 % below [mrad]", ".3g", lambda s: quantile(s[1], "residual", 0.95)),
        ("left, worst [mrad]", ".3g", lambda s: quantile(s[1], "residual", 1.0)),
        note=f"Amplitude at the arrival of the {COMBINED.name} move and {AFTER:g} s later; a dash: "
        f"diverged. Uniform random: load {low:g} to {high:g} times the planned one; cable up to "
        f"{RANGES['cable_error_m'][1]:g} m off; gust of up to {RANGES['gust_m_s'][1]:g} m/s from "
        f"any side on {DRAG:g} m² for {RANGES['gust_lasts_s'][0]:g} to "
        f"{RANGES['gust_lasts_s'][1]:g} s, in the first {RANGES['gust_at_s'][1]:g} s; sensor noise "
        f"up to {RANGES['noise'][1]:g} times the usual; sensors up to {RANGES['delay'][1] - 1:g} "
        f"control periods late; lag of converters {RANGES['lag'][0]:g} to {RANGES['lag'][1]:g} "
        "times the usual. Not in a batch: "
        + "; ".join(f"{name}, because {why}" for name, why in UNBATCHED.items())
        + ".",
    )


def _failures(strategies: Mapping[str, Columns], drives: str) -> ResultTable:
    from scipy.stats import binomtest

    rows: list[list[Cell]] = []
    for strategy, cases in strategies.items():
        failed = failures(cases)
        interval = binomtest(int(failed.sum()), len(failed)).proportion_ci(CONFIDENCE, "exact")
        shares = (
            cases["broken"].mean(),
            _leaves_too_much(cases).mean(),
            failed.mean(),
            interval.low,
            interval.high,
            np.isfinite(cases["valid_until_s"]).mean(),
        )
        rows.append([strategy, *(100.0 * float(share) for share in shares)])
    columns = [("strategy", "")]
    for heading in ("broken", "too much left", "fails", "at least", "at most", "beyond"):
        columns.append((f"{heading} [%]", ".2f"))
    return ResultTable(
        f"Random moves that fail, {drives}",
        columns,
        rows,
        "Broken: a joint leaves its range, the rope goes slack or the load touches the ground, at "
        f"20 instants a second. Too much left: more than {1e3 * MAX_RESIDUAL_SWING:g} mrad. At "
        f"least, at most: {100 * CONFIDENCE:g} % interval of the probability (Clopper and "
        "Pearson). Beyond: broken, or a drive is asked for more than its limits.",
    )


def _costs(strategies: Mapping[str, Columns], drives: str) -> ResultTable:
    return make_table(
        f"Computing time of random moves, {drives}",
        [(strategy, float(np.median(cases["spent_s"]))) for strategy, cases in strategies.items()],
        ("strategy", "", lambda s: s[0]),
        ("a case [ms]", ".2f", lambda s: 1e3 * s[1]),
        (f"{MANY:,} cases [min]", ".1f", lambda s: s[1] * MANY / 60.0),
        note="Processor time on this machine, the median of batches; n processors share it.",
    )


class SwingMap(NamedTuple):
    """Residual swing over load and cable.

    Attributes:
        cables: True less measured cable lengths [m], shape (cables,).
        loads: Masses of the payload over the planned one, shape (loads,).
        swing: Residual swing [mrad], shape (loads, cables).
    """

    cables: np.ndarray
    loads: np.ndarray
    swing: np.ndarray


def map_figure(columns: Columns) -> Figure:
    """Plot the residual swing of each strategy over load and cable, for the median duration."""
    durations = np.unique(columns["duration_s"])
    duration = durations[len(durations) // 2]
    maps: dict[str, SwingMap] = {}
    for strategy, cases in by_strategy(columns).items():
        selected = cases["duration_s"] == duration
        loads = np.unique(cases["load"][selected])
        cables = np.unique(cases["cable_error_m"][selected])
        residual = 1e3 * cases["residual_swing_rad"][selected].reshape(len(loads), len(cables))
        maps[strategy] = SwingMap(cables, loads, residual)
    return _maps(maps, f"swing 10 s after the combined move in {duration:.3g} s [mrad]")


def drawn_figure(columns: Columns) -> Figure:
    """Plot the median residual swing of each strategy in cells of load and cable.

    A cell without cases, or in which most diverge, stays empty.
    """
    from scipy.stats import binned_statistic_2d

    maps: dict[str, SwingMap] = {}
    for strategy, cases in by_strategy(columns).items():
        residual = 1e3 * cases["residual_swing_rad"]
        median, loads, cables, _ = binned_statistic_2d(
            cases["load"],
            cases["cable_error_m"],
            np.where(np.isfinite(residual), residual, np.inf),
            statistic="median",
            bins=CELLS,
            range=[RANGES["load"], RANGES["cable_error_m"]],
        )
        maps[strategy] = SwingMap(
            cables=(cables[1:] + cables[:-1]) / 2.0,
            loads=(loads[1:] + loads[:-1]) / 2.0,
            swing=np.where(np.isfinite(median), median, np.nan),
        )
    return _maps(maps, "median swing 10 s after the combined move [mrad]")


def _maps(maps: Mapping[str, SwingMap], label: str) -> Figure:
    """Draw the map of each strategy, four in a row, all with one scale."""
    from matplotlib.colors import LogNorm

    from cranedyn.plotting.figures import panels

    swings = np.concatenate([drawn.swing[np.isfinite(drawn.swing)] for drawn in maps.values()])
    norm = LogNorm(swings.min(), swings.max()) if len(swings) else LogNorm(1.0, 10.0)
    figure, axes = panels(
        math.ceil(len(maps) / 4), 4, height=2.6, width=11.0, sharex=True, sharey=True
    )
    for ax, (strategy, values) in zip(axes, maps.items(), strict=False):
        mesh = ax.pcolormesh(*values, norm=norm, cmap="viridis", rasterized=True)
        ax.set_title(strategy, fontsize=10.0)
        ax.grid(visible=False)
    for ax in axes[len(maps) :]:
        ax.set_axis_off()
    # Panels that share an axis have its numbers below the lowest one only, which may be empty.
    for ax in axes[max(len(maps) - 4, 0) : len(maps)]:
        ax.xaxis.set_tick_params(labelbottom=True)
    figure.supxlabel("cable longer than measured by [m]", fontsize=11.0)
    figure.supylabel("payload over that planned for", fontsize=11.0)
    figure.colorbar(mesh, ax=axes, label=label)
    return figure


def timing_figure(columns: Columns) -> Figure:
    """Plot the residual swing of each strategy over the time for the move: median and range."""
    from cranedyn.plotting.figures import legend_above, panels

    figure, (ax,) = panels(height=4.6)
    durations = np.unique(columns["duration_s"])
    for k, (strategy, cases) in enumerate(by_strategy(columns).items()):
        residual = [1e3 * cases["residual_swing_rad"][cases["duration_s"] == d] for d in durations]
        lowest, middle, highest = np.nanquantile(np.array(residual), [0.0, 0.5, 1.0], axis=1)
        colour = strategy_colour(strategy)
        marker = "osv^D*Px"[k % 8]
        ax.plot(durations, middle, marker=marker, markersize=4.0, color=colour, label=strategy)
        ax.fill_between(durations, lowest, highest, color=colour, alpha=0.15, linewidth=0.0)
    ax.set(
        yscale="log", xlabel="time for the combined move [s]", ylabel="swing 10 s after it [mrad]"
    )
    legend_above(ax, columns=2)
    return figure
