"""Figures of a judged lift: loads over time, the chart with the way of the load, and wind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.lifting.chart import CUT_OUT, WARNING
from cranedyn.lifting.loads import hanging_mass, jib_moment
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.lifting.analysis import Case

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STATIONS, _OFF = 60, 1e3


def over_time(made: Case) -> Figure:
    """Utilisation, load moment and the rope's angles over time."""
    figure, (used, moment, lead) = panels(3, height=1.9, sharex=True)
    t = made.carried.t
    if made.used is not None:
        used.plot(t, 100.0 * made.used, color=COLOURS["x"])
    for limit, style in ((WARNING, ":"), (CUT_OUT, "--")):
        used.axhline(100.0 * limit, color=COLOURS["limit"], linestyle=style, linewidth=1.0)
    used.set(ylabel="utilisation [%]", ylim=(0.0, 110.0))
    moment.plot(t, 1e-3 * made.carried["load_moment_Nm"], color=COLOURS["x"], label="load")
    moment.plot(t, 1e-3 * made.carried["ring_tilting_Nm"], color=COLOURS["l"], label="ring")
    moment.set(ylabel="moment [kN m]")
    for name, words, style in (("off_lead_rad", "off-lead", "-"), ("side_lead_rad", "side", "--")):
        lead.plot(t, np.degrees(made.carried[name]), style, color=COLOURS["phi"], label=words)
    lead.set(ylabel="rope from plumb [°]", xlabel="time [s]")
    for ax in (moment, lead):
        ax.legend(ncols=2, fontsize=9)
    return figure


def chart(made: Case) -> Figure:
    """What may hang over the radius, and what the lift takes of it; the jib's moment beside it."""
    figure, (rated, jib) = panels(1, 2, height=3.4, width=11.0)
    for on in made.chart.reevings:
        radius = np.linspace(max(on.least, 0.5), on.radii[-1], 200)
        style = "-" if on.count == made.falls else ":"
        rated.plot(
            radius, on.at(radius) / 1e3, style, color=COLOURS["limit"], label=f"{on.count} falls"
        )
        rated.plot(on.radii, on.rated / 1e3, ".", color=COLOURS["limit"])
    pull = made.carried["pull_N"] / made.crane.gravity
    rated.plot(made.carried["radius_m"], pull / 1e3, color=COLOURS["x"], label="this lift")
    rated.axhline(hanging_mass(made.crane) / 1e3, color=COLOURS["x"], linewidth=0.8, alpha=0.5)
    rated.set(xlabel="radius [m]", ylabel="load [t]", ylim=(0.0, None))
    rated.legend(fontsize=9)
    stations = np.linspace(0.0, float(made.carried["radius_m"].max()), _STATIONS)
    most = jib_moment(made.crane, made.certificate.run, stations).max(axis=0)
    jib.fill_between(stations, 1e-3 * most, color=COLOURS["x"], alpha=0.3)
    jib.plot(stations, 1e-3 * most, color=COLOURS["x"])
    jib.set(xlabel="along the jib [m]", ylabel="largest moment [kN m]")
    return figure


def wind(made: Case) -> Figure:
    """Utilisation, swing and clearance over the speed of a gust, as shares of their limits."""
    figure, (ax,) = panels(1, height=3.2, width=8.0)
    assert made.wind is not None
    colours = (COLOURS["x"], COLOURS["phi"], COLOURS["l"])
    for (name, allowed), colour in zip(made.wind.allowed.items(), colours, strict=True):
        worst = made.wind.worst[name]
        near = name == "clearance"
        share = allowed / np.maximum(worst, 1e-3) if near else worst / allowed
        shown, words = share < _OFF, "required over clearance" if near else f"{name} over its limit"
        ax.plot(made.wind.speeds[shown], share[shown], ".-", color=colour, label=words)
    ax.axhline(1.0, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    ax.axvline(made.asked.wind, color=COLOURS["limit"], linestyle=":", linewidth=1.0)
    swing = f"{math.degrees(made.wind.allowed['swing']):g}°"
    ax.set(xlabel="gust [m/s]; dotted: asked for", ylabel=f"share of the limit (swing {swing})")
    ax.set_ylim(0.0, 3.0)
    ax.legend(fontsize=9)
    return figure
