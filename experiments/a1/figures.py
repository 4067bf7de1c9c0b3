"""The figures of A1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.plotting.style import run_colour
from experiments.a1.case import FIT_FROM, SwingCase

_CAUSES = {
    "payload inertia": ["payload inertia"],
    "dummy inertia": ["dummy inertia"],
    "compliance of the trolley": ["pivot spring", "pivot damper"],
    "finite amplitude": ["amplitude"],
    "gravity": ["gravity"],
    "compliance of the hoist": ["hoist compliance"],
}
"""Entries of the budget that are drawn as one cause, by its name in the legend."""

_COLOURS = tuple(run_colour(index) for index in (1, 5, 0, 4, 3, 2))
"""Colours of the causes, in their order."""


def waveform_figure(cases: Sequence[SwingCase]) -> Figure:
    """Draw the swing over time, and the same wave at the period of the point pendulum: the phase
    lost by the end is the error.
    """
    figure, axes = panels(len(cases), height=1.7, sharex=True)
    for ax, case in zip(axes, cases, strict=True):
        t = case.trajectory.t
        fit = case.fit
        point = float(theory.point_period(case.length, STANDARD_GRAVITY))
        late = t >= FIT_FROM
        # The phase of the fit where the fit begins, and the phase of the point pendulum from there.
        phase_at_fit = 2 * np.pi / fit.period * FIT_FROM
        phase_since = 2 * np.pi / point * (t - FIT_FROM)
        ideal = fit.amplitude_at(t) * np.cos(phase_since + phase_at_fit + fit.phase)
        ax.plot(t, np.degrees(case.trajectory["phi_rad"]), color=COLOURS["phi"], label="simulated")
        style: Any = {"color": COLOURS["unexplained"], "linewidth": 1.0}
        ax.plot(t[late], np.degrees(ideal[late]), "--", label="at the period 2π√(l/g)", **style)
        ax.set_ylabel(f"φ [°], l = {case.length:g} m")
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    return figure


def _errors(cases: Sequence[SwingCase]) -> tuple[list[float], list[float]]:
    """Return the simulated and the published errors of the period [%]; NaN if there is none."""
    published = [case.published.point or np.nan for case in cases]
    return [100 * case.error for case in cases], published


def period_figure(cases: Sequence[SwingCase]) -> Figure:
    """Draw the period over cable length, and its error beside the published one."""
    figure, (left, right) = panels(1, 2, height=3.6)
    lengths = np.array([case.length for case in cases])
    fine = np.linspace(3.4, 22.0, 200)
    point = theory.point_period(fine, STANDARD_GRAVITY)
    left.plot(fine, point, color=COLOURS["setpoint"], label="2π√(l/g)")
    periods = [case.fit.period for case in cases]
    left.plot(lengths, periods, "o", color=COLOURS["phi"], label="simulated")
    left.set(xlabel="cable length [m]", ylabel="period [s]")
    ours, published = _errors(cases)
    right.plot(lengths, ours, "o-", color=COLOURS["phi"], label="simulated")
    right.plot(lengths, published, "x", color=COLOURS["unexplained"], markersize=9, label="article")
    right.set(xlabel="cable length [m]", ylabel="error against 2π√(l/g) [%]", ylim=(0, None))
    legend_above(left)
    legend_above(right)
    return figure


def budget_figure(cases: Sequence[SwingCase]) -> Figure:
    """Draw what each cause adds to the period, stacked, beside the simulated error."""
    figure, (ax,) = panels(1, 1, height=4.0)
    positions = np.arange(len(cases))
    floor = np.zeros(len(cases))
    for (cause, names), colour in zip(_CAUSES.items(), _COLOURS, strict=True):
        shares = np.array([100 * sum(case.budget[name] for name in names) for case in cases])
        ax.bar(positions, shares, 0.5, bottom=floor, color=colour, label=cause)
        floor = floor + shares
    ours, published = _errors(cases)
    style: Any = {"markeredgecolor": "black", "markersize": 9, "markeredgewidth": 1.5}
    ax.plot(positions, ours, "D", color="white", label="simulated", **style)
    ax.plot(positions, published, "x", label="article", **style)
    ax.set_xticks(positions, [f"l = {case.length:g} m" for case in cases])
    ax.set_ylabel("error against 2π√(l/g) [%]")
    legend_above(ax)
    return figure
