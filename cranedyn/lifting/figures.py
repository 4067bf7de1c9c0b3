"""Figures of a lift: the site, loads over time, the chart with the way of the load, and wind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cranedyn.lifting.analysis import LiftAnalysis
from cranedyn.lifting.chart import CUT_OUT, WARNING
from cranedyn.lifting.loads import hanging_mass, jib_moment
from cranedyn.lifting.site_figures import clearance_over_time, site_views
from cranedyn.lifting.wind_limit import WindLimit
from cranedyn.plotting.figures import COLOURS, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STATIONS = 60
"""Points along the jib at which its moment is drawn."""

_FAILED = 1e3
"""Share of a limit from which on a gust is not drawn, since lifts failed in it."""


class LiftFigure(NamedTuple):
    """A figure of the report.

    Attributes:
        figure: The figure.
        caption: What it shows, in a sentence.
    """

    figure: Figure
    caption: str


def figures(analysis: LiftAnalysis) -> dict[str, LiftFigure]:
    """Return all figures of a lift by name."""
    result = {
        "site": LiftFigure(
            site_views(analysis.certificate),
            "Plan and elevations of the site with the way of the load.",
        ),
        "clearance": LiftFigure(
            clearance_over_time(analysis.certificate), "Clearance and swing over time."
        ),
        "loads": LiftFigure(
            draw_loads(analysis), "Utilisation, load moment and the rope's angles over time."
        ),
        "chart": LiftFigure(
            draw_chart(analysis), "Chart with the way of the load, and the jib's largest moments."
        ),
    }
    if analysis.wind is not None:
        result["wind"] = LiftFigure(
            draw_wind(analysis.wind, analysis.requirements.wind),
            "Utilisation, swing and clearance over the speed of a gust.",
        )
    return result


def draw_loads(analysis: LiftAnalysis) -> Figure:
    """Draw utilisation, load moment and the rope's angles over time."""
    figure, (used, moment, lead) = panels(3, height=1.9, sharex=True)
    t = analysis.loads.t
    if analysis.utilisation is not None:
        used.plot(t, 100.0 * analysis.utilisation, color=COLOURS["x"])
    for threshold, style in ((WARNING, ":"), (CUT_OUT, "--")):
        used.axhline(100.0 * threshold, color=COLOURS["limit"], linestyle=style, linewidth=1.0)
    used.set(ylabel="utilisation [%]", ylim=(0.0, 110.0))
    moment.plot(t, 1e-3 * analysis.loads["load_moment_Nm"], color=COLOURS["x"], label="load")
    moment.plot(t, 1e-3 * analysis.loads["ring_tilting_Nm"], color=COLOURS["l"], label="ring")
    moment.set(ylabel="moment [kN m]")
    for name, label, style in (("off_lead_rad", "off-lead", "-"), ("side_lead_rad", "side", "--")):
        lead.plot(t, np.degrees(analysis.loads[name]), style, color=COLOURS["phi"], label=label)
    lead.set(ylabel="rope from plumb [°]", xlabel="time [s]")
    for ax in (moment, lead):
        ax.legend(ncols=2, fontsize=9)
    return figure


def draw_chart(analysis: LiftAnalysis) -> Figure:
    """Draw the rated load over the radius with the pull of the load, and the moment of the jib."""
    figure, (rated, jib) = panels(1, 2, height=3.4, width=11.0)
    for reeving in analysis.chart.reevings:
        radius = np.linspace(max(reeving.least, 0.5), reeving.radii[-1], 200)
        style = "-" if reeving.count == analysis.falls else ":"
        rated.plot(
            radius,
            reeving.at(radius) / 1e3,
            style,
            color=COLOURS["limit"],
            label=f"{reeving.count} falls",
        )
        rated.plot(reeving.radii, reeving.rated / 1e3, ".", color=COLOURS["limit"])
    pull = analysis.loads["pull_N"] / analysis.crane.gravity
    rated.plot(analysis.loads["radius_m"], pull / 1e3, color=COLOURS["x"], label="this lift")
    rated.axhline(hanging_mass(analysis.crane) / 1e3, color=COLOURS["x"], linewidth=0.8, alpha=0.5)
    rated.set(xlabel="radius [m]", ylabel="load [t]", ylim=(0.0, None))
    rated.legend(fontsize=9)
    stations = np.linspace(0.0, float(analysis.loads["radius_m"].max()), _STATIONS)
    envelope = jib_moment(analysis.crane, analysis.certificate.run, stations).max(axis=0)
    jib.fill_between(stations, 1e-3 * envelope, color=COLOURS["x"], alpha=0.3)
    jib.plot(stations, 1e-3 * envelope, color=COLOURS["x"])
    jib.set(xlabel="along the jib [m]", ylabel="largest moment [kN m]")
    return figure


def draw_wind(limit: WindLimit, required: float) -> Figure:
    """Draw utilisation, swing and clearance over the speed of a gust, as shares of their limits.

    Args:
        limit: What gusts do to the lift.
        required: Gust that the lift must bear [m/s].
    """
    figure, (ax,) = panels(1, height=3.2, width=8.0)
    colours = (COLOURS["x"], COLOURS["phi"], COLOURS["l"])
    for (name, allowed), colour in zip(limit.allowed.items(), colours, strict=True):
        worst = limit.worst[name]
        near = name == "clearance"
        share = allowed / np.maximum(worst, 1e-3) if near else worst / allowed
        drawn, label = (
            share < _FAILED,
            "required over clearance" if near else f"{name} over its limit",
        )
        ax.plot(limit.speeds[drawn], share[drawn], ".-", color=colour, label=label)
    ax.axhline(1.0, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    ax.axvline(required, color=COLOURS["limit"], linestyle=":", linewidth=1.0)
    swing = f"{math.degrees(limit.allowed['swing']):g}°"
    ax.set(xlabel="gust [m/s]; dotted: asked for", ylabel=f"share of the limit (swing {swing})")
    ax.set_ylim(0.0, 3.0)
    ax.legend(fontsize=9)
    return figure
