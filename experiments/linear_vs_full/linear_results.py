"""Tables and figures of the comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from cranedyn.plotting.figures import COLOURS, legend_above, panels
from experiments.harness import Column, ResultTable, make_table
from experiments.linear_vs_full.linear_equations import all_rates, integrate, paper
from experiments.linear_vs_full.linear_moves import (
    ANGLES,
    HOLD,
    SHARES,
    SITES,
    SLEW_RAMP,
    SLOW_END,
    SLOW_START,
    HoistingPowers,
    LinearCase,
    SiteCrane,
)

RPM = 30.0 / math.pi
"""Turns a minute of one radian a second."""


def errors_table(site: SiteCrane, cases: Sequence[LinearCase]) -> ResultTable:
    """Return how far the paper's equations are from the plant in each move of a crane."""
    return make_table(
        f"{site.name}: error of Eqs. (8), (10) over the largest swing",
        cases,
        ("move", "", lambda c: c.job.name),
        ("duration [s]", ".1f", lambda c: c.job.arrival),
        ("swing [°]", ".2f", lambda c: math.degrees(c.paper.swing)),
        ("φ rms [%]", ".1f", lambda c: 100.0 * c.paper.phi),
        ("θ rms [%]", ".1f", lambda c: 100.0 * c.paper.theta),
        ("both rms [%]", ".1f", lambda c: 100.0 * c.paper.rms),
        ("peak [%]", ".1f", lambda c: 100.0 * c.paper.peak),
        ("all rates: rms [%]", ".1f", lambda c: 100.0 * c.rates.rms),
        ("with inertia: rms [%]", ".1f", lambda c: c.rigid and 100.0 * c.rigid.rms),
        note=f"Jib {site.jib:g} m, cable {site.height:g} m, trolley {site.trolley:.2f} m/s, slew "
        f"{site.slew * RPM:.2f} rpm, hoist {site.slow_hoist:.2f} and {site.fast_hoist:.2f} m/s.",
    )


def dropped_table(site: SiteCrane, cases: Sequence[LinearCase]) -> ResultTable:
    """Return how large the dropped terms are in each move of a crane."""

    def share(case: LinearCase, name: str) -> float:
        return 100.0 * case.dropped[name]

    terms = [(f"{name} [%]", ".1f", partial(share, name=name)) for name in cases[0].dropped]
    return make_table(
        f"{site.name}: largest of each dropped term over the larger of ẍ and x γ̈",
        cases,
        ("move", "", lambda c: c.job.name),
        ("kept [m/s²]", ".3f", lambda c: c.kept),
        *terms,
    )


def rates_table(
    errors: Mapping[str, Sequence[float]], rates: Mapping[str, float], good: float
) -> ResultTable:
    """Return how the error falls with the slew rate."""
    return _scan_table(
        "Error of a slew at shares of the crane's slew rate",
        errors,
        [f"{share:g} [%]" for share in SHARES],
        (f"{100.0 * good:g} % at [rpm]", ".3f", lambda name: rates[name] * RPM),
        f"The rate is reached in {SLEW_RAMP:g} s, and left {HOLD:g} s after the start; root mean "
        "square over the largest swing.",
    )


def angles_table(
    errors: Mapping[str, Sequence[float]], angles: Mapping[str, float], good: float
) -> ResultTable:
    """Return how the error falls with the angle."""
    return _scan_table(
        "Error of short slews",
        errors,
        [f"{angle:g}° [%]" for angle in ANGLES],
        (f"{100.0 * good:g} % at [°]", ".1f", lambda name: angles[name]),
        "The jib accelerates over half of the angle and brakes over the other, unless it reaches "
        "its rate before.",
    )


def _scan_table(
    title: str, errors: Mapping[str, Sequence[float]], headers: list[str], limit: Column, note: str
) -> ResultTable:

    def error(name: str, i: int) -> float:
        return 100.0 * errors[name][i]

    columns = [(header, ".1f", partial(error, i=i)) for i, header in enumerate(headers)]
    return make_table(title, errors, ("crane", "", str), *columns, limit, note=note)


def powers_table(powers: Mapping[str, HoistingPowers]) -> ResultTable:
    """Return how a free swing changes on a cable that is hoisted slowly."""
    return make_table(
        "Power of the cable length with which a free swing changes",
        powers,
        ("crane", "", str),
        ("plant", "+.3f", lambda name: powers[name].plant),
        ("Eq. (8)", "+.3f", lambda name: powers[name].paper),
        note=f"Cable from {SLOW_START:g} to {SLOW_END:g} of its longest. By the action: -3/4, and "
        "+1/4 for l φ̈ + g φ = 0, which lacks 2 l̇ φ̇.",
    )


_CRANE_COLOURS = ("theta", "x", "gamma", "l")
"""Colour of each crane, by its key in `COLOURS`."""


def angles_figure(case: LinearCase, gravity: float) -> Figure:
    """Draw both angles of the plant, of the paper's equations, and with all rates kept."""
    figure, axes = panels(2, height=2.6, sharex=True)
    models = (
        ("Eqs. (8), (10)", integrate(case.run, paper, gravity), "-", COLOURS["gamma"]),
        ("all rates kept", integrate(case.run, all_rates, gravity), ":", COLOURS["unexplained"]),
    )
    for i, (ax, angle) in enumerate(zip(axes, ("φ", "θ"), strict=True)):
        swing = np.degrees(case.run.coordinates("phi", "theta")[:, i])
        ax.plot(case.run.t, swing, color=COLOURS["x"], label="plant")
        for name, modelled, line, colour in models:
            degrees = np.degrees(modelled[:, i])
            ax.plot(case.run.t, degrees, line, color=colour, linewidth=1.2, label=name)
        ax.axvline(case.job.arrival, linestyle="--", color=COLOURS["limit"], linewidth=1.0)
        ax.set_ylabel(f"{angle} [°]")
    legend_above(axes[0])
    axes[-1].set_xlabel(f"time [s]; {case.site.name}, {case.job.name}; dashed: arrival")
    return figure


def slew_figure(
    slow: Mapping[str, Sequence[float]], short: Mapping[str, Sequence[float]], good: float
) -> Figure:
    """Draw the error over slew rate and over slew angle, for each crane."""
    figure, (left, right) = panels(1, 2, height=3.8, sharey=True)
    for site, colour in zip(SITES, _CRANE_COLOURS, strict=True):
        rates = RPM * site.slew * np.array(SHARES)
        errors = 100.0 * np.array(slow[site.name])
        left.loglog(rates, errors, ".-", color=COLOURS[colour], label=site.name)
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
    legend_above(left)
    return figure


def dropped_figure(cases: Sequence[LinearCase], moves: Sequence[str]) -> Figure:
    """Draw the dropped terms of some moves, for each crane."""
    figure, axes = panels(1, len(moves), height=3.6, sharey=True)
    for ax, name in zip(axes, moves, strict=True):
        of_move = [case for case in cases if case.job.name == name]
        positions = np.arange(len(of_move[0].dropped))
        for k, (case, colour) in enumerate(zip(of_move, _CRANE_COLOURS, strict=True)):
            shares = [100.0 * share for share in case.dropped.values()]
            height = positions + 0.2 * (k - 1.5)
            ax.barh(height, shares, 0.2, color=COLOURS[colour], label=case.site.name)
        ax.set_yticks(positions, list(of_move[0].dropped))
        ax.set(title=name, xlabel="of the kept term [%]")
    axes[0].invert_yaxis()
    legend_above(axes[0])
    return figure
