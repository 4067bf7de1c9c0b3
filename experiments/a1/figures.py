"""The figures of A1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.plotting.runs import run_colour

if TYPE_CHECKING:
    from experiments.a1 import Case

_CAUSES = {
    "payload inertia": ["payload inertia"],
    "dummy inertia": ["dummy inertia"],
    "compliance of the trolley": ["pivot spring", "pivot damper"],
    "finite amplitude": ["amplitude"],
    "gravity": ["gravity"],
    "compliance of the hoist": ["hoist compliance"],
}
_COLOURS = tuple(map(run_colour, (1, 5, 0, 4, 3, 2)))


def waveform_figure(cases: Sequence[Case]) -> Figure:
    """Swing over time, with the same wave at the period of the point pendulum: the phase it has
    lost by the end is the error.
    """
    figure, axes = panels(len(cases), height=1.7, sharex=True)
    for ax, case in zip(axes, cases, strict=True):
        t, point = case.trajectory.t, float(theory.point_period(case.length, STANDARD_GRAVITY))
        ideal = case.fit.amplitude_at(t) * np.cos(
            2 * np.pi / point * (t - 12.0) + 2 * np.pi / case.fit.period * 12.0 + case.fit.phase
        )
        ax.plot(t, np.degrees(case.trajectory["phi_rad"]), color=COLOURS["phi"], label="simulated")
        ax.plot(
            t[t >= 12],
            np.degrees(ideal[t >= 12]),
            "--",
            color=COLOURS["unexplained"],
            linewidth=1.0,
            label="at the period 2π√(l/g)",
        )
        ax.set_ylabel(f"φ [°], l = {case.length:g} m")
    axes[0].legend(loc="upper left", ncols=2, bbox_to_anchor=(0.0, 1.35))
    axes[-1].set_xlabel("time [s]")
    return figure


def period_figure(cases: Sequence[Case]) -> Figure:
    """Period over cable length, and its error against the point pendulum beside the published
    one.
    """
    figure, (left, right) = panels(1, 2, height=3.6)
    lengths = np.array([case.length for case in cases])
    fine = np.linspace(3.4, 22.0, 200)
    left.plot(
        fine,
        theory.point_period(fine, STANDARD_GRAVITY),
        color=COLOURS["setpoint"],
        label="2π√(l/g)",
    )
    left.plot(
        lengths, [case.fit.period for case in cases], "o", color=COLOURS["phi"], label="simulated"
    )
    left.set(xlabel="cable length [m]", ylabel="period [s]")
    right.plot(
        lengths, [100 * case.error for case in cases], "o-", color=COLOURS["phi"], label="simulated"
    )
    right.plot(
        lengths,
        [case.published.point if case.published else np.nan for case in cases],
        "x",
        color=COLOURS["unexplained"],
        markersize=9,
        label="article",
    )
    right.set(xlabel="cable length [m]", ylabel="error against 2π√(l/g) [%]", ylim=(0, None))
    left.legend()
    right.legend()
    return figure


def budget_figure(cases: Sequence[Case]) -> Figure:
    """What each cause adds to the period, stacked, beside what was simulated and published."""
    figure, (ax,) = panels(1, 1, height=4.0)
    places = np.arange(len(cases))
    floor = np.zeros(len(cases))
    for (cause, names), colour in zip(_CAUSES.items(), _COLOURS, strict=True):
        parts = np.array([100 * sum(case.budget[name] for name in names) for case in cases])
        ax.bar(places, parts, 0.5, bottom=floor, color=colour, label=cause)
        floor = floor + parts
    ax.plot(
        places,
        [100 * case.error for case in cases],
        "D",
        color="white",
        markeredgecolor="black",
        markersize=8,
        label="simulated",
    )
    ax.plot(
        places,
        [case.published.point if case.published else np.nan for case in cases],
        "x",
        color="black",
        markersize=10,
        markeredgewidth=2,
        label="article",
    )
    ax.set_xticks(places, [f"l = {case.length:g} m" for case in cases])
    ax.set_ylabel("error against 2π√(l/g) [%]")
    ax.legend()
    return figure
