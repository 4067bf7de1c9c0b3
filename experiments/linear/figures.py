"""Figures of the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.plotting.figures import COLOURS, panels
from experiments.linear.model import all_rates, integrate, paper
from experiments.linear.runs import LinearCase
from experiments.linear.sites import ANGLES, SHARES, SITES
from experiments.linear.tables import RPM

_CRANES = ("theta", "x", "gamma", "l")


def angles_figure(case: LinearCase, gravity: float) -> Figure:
    """Draw both angles of the plant, of the paper's equations, and with all rates kept."""
    figure, axes = panels(2, height=2.6, sharex=True)
    swings = {
        "Eqs. (8), (10)": integrate(case.run, paper, gravity),
        "all rates kept": integrate(case.run, all_rates, gravity),
    }
    for ax, i, angle in zip(axes, (0, 1), ("φ", "θ"), strict=True):
        ax.plot(
            case.run.t,
            np.degrees(case.run.coordinates("phi", "theta")[:, i]),
            color=COLOURS["x"],
            label="plant",
        )
        for (name, swing), colour, line in zip(
            swings.items(), (COLOURS["gamma"], COLOURS["unexplained"]), ("-", ":"), strict=True
        ):
            ax.plot(
                case.run.t, np.degrees(swing[:, i]), line, color=colour, linewidth=1.2, label=name
            )
        ax.axvline(case.job.arrival, linestyle="--", color=COLOURS["limit"], linewidth=1.0)
        ax.set_ylabel(f"{angle} [°]")
    axes[0].legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel(f"time [s]; {case.site.name}, {case.job.name}; dashed: arrival")
    return figure


def slew_figure(
    slow: Mapping[str, Sequence[float]], short: Mapping[str, Sequence[float]], good: float
) -> Figure:
    """Draw the error over slew rate and over slew angle, for each crane."""
    figure, (left, right) = panels(1, 2, height=3.8, sharey=True)
    for site, colour in zip(SITES, _CRANES, strict=True):
        left.loglog(
            RPM * site.slew * np.array(SHARES),
            100.0 * np.array(slow[site.name]),
            ".-",
            color=COLOURS[colour],
            label=site.name,
        )
        right.loglog(ANGLES, 100.0 * np.array(short[site.name]), ".-", color=COLOURS[colour])
    for ax, ticks, label in (
        (left, (0.02, 0.05, 0.1, 0.2, 0.5), "slew rate [rpm]"),
        (right, ANGLES, "angle of a short slew [°]"),
    ):
        ax.axhline(100.0 * good, linestyle="--", color=COLOURS["limit"])
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.set_yticks((0.5, 1, 2, 5, 10, 20, 50), ("0.5", "1", "2", "5", "10", "20", "50"))
        ax.minorticks_off()
        ax.set_xlabel(label)
    left.set_ylabel("rms error of Eqs. (8), (10) [%]")
    left.legend()
    return figure


def dropped_figure(cases: Sequence[LinearCase], moves: Sequence[str]) -> Figure:
    """Draw the dropped terms of some moves, for each crane."""
    figure, axes = panels(1, len(moves), height=3.6, sharey=True)
    for ax, name in zip(axes, moves, strict=True):
        of_move = [case for case in cases if case.job.name == name]
        positions = np.arange(len(of_move[0].dropped))
        for k, (case, colour) in enumerate(zip(of_move, _CRANES, strict=True)):
            shares = [100.0 * share for share in case.dropped.values()]
            ax.barh(
                positions + 0.2 * (k - 1.5),
                shares,
                0.2,
                color=COLOURS[colour],
                label=case.site.name,
            )
        ax.set_yticks(positions, list(of_move[0].dropped))
        ax.set(title=name, xlabel="of the kept term [%]")
    axes[0].invert_yaxis()
    axes[0].legend(loc="lower right")
    return figure
