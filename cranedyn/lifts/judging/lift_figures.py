"""Figures of a lift: the site, loads over time, the chart with the way of the load, and wind; and
the site as the scenery of a recording.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.collections import PolyCollection
from scipy.spatial import ConvexHull

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.chart import (
    ANY_RADIUS,
    CUT_OUT,
    WARNING,
    NotCovered,
    RatedLoads,
)
from cranedyn.lifts.judging.loads import hanging_mass, jib_moment
from cranedyn.lifts.judging.wind_limit import FAILED_SHARE, WindLimit
from cranedyn.lifts.planning.boom import boom_ends, boom_of
from cranedyn.lifts.planning.certificate import Certificate
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.solids import Solid, rotation_z
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.plotting.style import run_colour
from cranedyn.recording import Obstacle, Scenery

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STATIONS = 60
"""Points along the jib at which its moment is drawn."""

_MAX_OBSTACLES = 5
"""Number of obstacles, the nearest, that are drawn in clearance over time."""

_BOX_SPACING = 1.5
"""Distance along the path between boxes around the load in a recording [m]."""

_CLEARANCE_SCALE = 8.0
"""Largest clearance on the axis of clearance over time [m]."""


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
    certificate = analysis.certificate
    captioned = {
        "clearance": (clearance_over_time(certificate), "Clearance and swing over time."),
        "loads": (
            draw_loads(analysis),
            "Utilisation, load moment and the rope's angles over time."
            if "load_moment_Nm" in analysis.loads.values
            else "Utilisation, tension of the rope and its angles over time.",
        ),
    }
    if "radius_m" in analysis.loads.values:
        captioned["chart"] = (draw_chart(analysis), _chart_caption(analysis))
    if analysis.wind is not None:
        captioned["wind"] = (
            draw_wind(analysis.wind, analysis.requirements.wind or 0.0),
            "The worst utilisation, swing and clearance in gusts up to a speed. A distance that "
            'suffices is not measured further: where its share is shown as "at most", more of it '
            "may be left.",
        )
    return {name: LiftFigure(*figure) for name, figure in captioned.items()}


def _chart_caption(analysis: LiftAnalysis) -> str:
    """Return what `draw_chart` shows, in a sentence."""
    jib = ", and the jib's largest moments" if _has_jib(analysis) else ""
    if analysis.chart is None:
        return f"The load over the radius, without a chart{jib}."
    return f"Chart with the way of the load{jib}."


def _has_jib(analysis: LiftAnalysis) -> bool:
    """Return whether a trolley runs along the jib of a crane that slews."""
    return analysis.crane.layout.has("slew", "trolley")


def draw_loads(analysis: LiftAnalysis) -> Figure:
    """Draw utilisation, load moment and the rope's angles over time; of a crane that does not slew
    the tension of the rope instead of the moment.
    """
    figure, axes = panels(3, height=1.9, sharex=True)
    used, moment, lead = axes
    t = analysis.loads.t
    if analysis.utilisation is not None:
        used.plot(t, 100.0 * analysis.utilisation, color=COLOURS["x"])
    for threshold, style in ((WARNING, ":"), (CUT_OUT, "--")):
        used.axhline(100.0 * threshold, color=COLOURS["limit"], linestyle=style, linewidth=1.0)
    highest = 0.0 if analysis.utilisation is None else 105.0 * float(analysis.utilisation.max())
    used.set(ylabel="utilisation [%]", ylim=(0.0, max(110.0, highest)))
    if "load_moment_Nm" in analysis.loads.values:
        moment.plot(t, 1e-3 * analysis.loads["load_moment_Nm"], color=COLOURS["x"], label="load")
        moment.plot(t, 1e-3 * analysis.loads["ring_tilting_Nm"], color=COLOURS["l"], label="ring")
        moment.set(ylabel="moment [kN m]")
    else:
        moment.plot(t, 1e-3 * analysis.loads["rope_N"], color=COLOURS["x"], label="rope")
        moment.set(ylabel="tension [kN]")
    for name, label, style in (("off_lead_rad", "off-lead", "-"), ("side_lead_rad", "side", "--")):
        lead.plot(t, np.degrees(analysis.loads[name]), style, color=COLOURS["phi"], label=label)
    lead.set(ylabel="rope from plumb [°]", xlabel="time [s]")
    for ax in (moment, lead):
        legend_above(ax, columns=2)
    return figure


def draw_chart(analysis: LiftAnalysis) -> Figure:
    """Draw the rated load over the radius with the pull of the load, and the moment of the jib if
    a trolley runs along one.
    """
    columns = 2 if _has_jib(analysis) else 1
    figure, axes = panels(1, columns, height=3.4, width=5.5 * columns)
    rated = axes[0]
    for reeving, is_used in _drawn_loads(analysis):
        # A chart of one load for all radii has no last one.
        last = reeving.radii[-1]
        if last == ANY_RADIUS:
            last = 1.5 * float(analysis.loads["radius_m"].max())
        radius = np.linspace(max(reeving.least, 0.5), last, 200)
        style = "-" if is_used else ":"
        boom = "" if reeving.boom is None else f", boom {reeving.boom:.4g} m"
        label = f"{reeving.count} falls{boom}"
        rated.plot(radius, reeving.at(radius) / 1e3, style, color=COLOURS["limit"], label=label)
        points = reeving.radii <= last
        rated.plot(reeving.radii[points], reeving.rated[points] / 1e3, ".", color=COLOURS["limit"])
    pull = analysis.loads["pull_N"] / analysis.crane.gravity
    rated.plot(analysis.loads["radius_m"], pull / 1e3, color=COLOURS["x"], label="this lift")
    rated.axhline(hanging_mass(analysis.crane) / 1e3, color=COLOURS["x"], linewidth=0.8, alpha=0.5)
    rated.set(xlabel="radius [m]", ylabel="load [t]", ylim=(0.0, None))
    legend_above(rated)
    if not _has_jib(analysis):
        return figure
    jib = axes[1]
    stations = np.linspace(0.0, float(analysis.loads["radius_m"].max()), _STATIONS)
    envelope = jib_moment(analysis.run_crane, analysis.run, stations).max(axis=0)
    jib.fill_between(stations, 1e-3 * envelope, color=COLOURS["x"], alpha=0.3)
    jib.plot(stations, 1e-3 * envelope, color=COLOURS["x"])
    jib.set(xlabel="along the jib [m]", ylabel="largest moment [kN m]")
    return figure


def _drawn_loads(analysis: LiftAnalysis) -> list[tuple[RatedLoads, bool]]:
    """Return the rated loads that `draw_chart` draws, each with whether it is that of the lift: all
    of a chart without lengths of the boom, and else those of the falls and the boom of the lift,
    and of the next shorter and longer boom of the chart.
    """
    chart = analysis.chart
    if chart is None:
        return []
    falls = analysis.inputs.falls
    lengths = chart.booms(falls)
    if not lengths:
        return [(reeving, reeving.count == falls) for reeving in chart.reevings]
    boom = analysis.loads.values.get("boom_m")
    if boom is None:
        return [(reeving, False) for reeving in chart.of_falls(falls)]
    length = float(boom[0])
    near = chart.about_boom(falls, length)
    drawn = [(reeving, False) for reeving in (near.shorter, near.longer) if reeving is not None]
    try:
        drawn.append((chart.on(falls, length), True))
    except NotCovered:
        pass  # the check of the utilisation says so
    return drawn


def draw_wind(limit: WindLimit, required: float) -> Figure:
    """Draw utilisation, swing and clearance over the speed of a gust, as shares of their limits,
    and the gust that the lift must bear [m/s].
    """
    figure, (ax,) = panels(1, height=3.2, width=8.0)
    colours = (COLOURS["x"], COLOURS["phi"], COLOURS["l"])
    for (name, allowed), colour in zip(limit.allowed.items(), colours, strict=True):
        worst = limit.worst[name]
        if name == "clearance":
            # Less is worse; a load that touches, or nearly so, is off the scale.
            share = allowed / np.maximum(worst, 1e-3)
            label = "required over clearance"
            # One that suffices is not measured further: its share is an upper bound.
            kept = limit.kept(name)
            ax.plot(
                limit.speeds[kept],
                share[kept],
                marker="v",
                fillstyle="none",
                linestyle="none",
                color=colour,
                label=f"{label}, at most",
            )
            drawn = (share < FAILED_SHARE) & ~kept
        else:
            share = worst / allowed
            label = f"{name} over its limit"
            drawn = share < FAILED_SHARE
        ax.plot(limit.speeds[drawn], share[drawn], ".-", color=colour, label=label)
    ax.axhline(1.0, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    ax.axvline(required, color=COLOURS["limit"], linestyle=":", linewidth=1.0)
    swing = f"{math.degrees(limit.allowed['swing']):g}°"
    ax.set(xlabel="gust [m/s]; dotted: asked for", ylabel=f"share of the limit (swing {swing})")
    ax.set_ylim(0.0, 3.0)
    legend_above(ax)
    return figure


def site_views(certificate: Certificate) -> Figure:
    """Draw plan and two elevations of a site with the path of the load, the place at which it is
    nearest to an obstacle, and the reach of the crane. A boom is drawn where it is at both ends.
    """
    lift = certificate.lift
    clearance = lift.clearance
    site = clearance.site
    path = site.to_site(clearance.point(lift.timed.places))
    nearest_row = np.searchsorted(certificate.run.t, certificate.nearest_t)
    nearest_place = certificate.run.q[nearest_row][clearance.drive_joints]
    near = site.to_site(clearance.point(nearest_place))
    foot_and_pivot = _mast_line(clearance)
    booms = _boom_lines(lift)
    figure, axes = panels(1, 3, height=4.2, width=13.0)
    for ax, (i, j) in zip(axes, itertools.combinations(range(3), 2), strict=True):
        for solid in site.solids:
            ax.add_collection(solid_outlines(solid, i, j))
        ax.plot(
            *foot_and_pivot[:, [i, j]].T, color="#333333", linewidth=3.0, marker="s", markersize=4
        )
        for line in booms:
            ax.plot(*line[:, [i, j]].T, color="#333333", linewidth=1.5)
        ax.plot(path[:, i], path[:, j], color=COLOURS["x"], label="centre of the load")
        ax.plot(path[0, i], path[0, j], "o", color=COLOURS["x"])
        ax.plot(path[-1, i], path[-1, j], "*", color=COLOURS["x"], markersize=12)
        nearest = f"nearest, {certificate.nearest.distance:.2f} m"
        ax.plot(near[i], near[j], "x", color="#000000", label=nearest)
        if j == 2:
            ax.axhline(site.ground, color="#777777", linewidth=1.0)
        ax.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]")
        ax.set_aspect("equal", adjustable="datalim")
        ax.autoscale_view()
    if clearance.turning is not None:
        angle = np.linspace(0.0, 2.0 * math.pi, 100)
        for radius in clearance.reach:
            circle = radius * np.stack([np.cos(angle), np.sin(angle)])
            axes[0].plot(*(site.foot[:2, None] + circle), ":", color="#999999", linewidth=1.0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(site.name)
    return figure


def _mast_line(clearance: Clearance) -> np.ndarray:
    """Return foot and top of what stands, in the frame of the site [m], shape (2, 3): up to the
    hinge of a boom, or else up to the pivot of a crane that turns; of another one nothing but its
    foot.
    """
    top = 0.0
    boom = boom_of(clearance.crane)
    if boom is not None:
        top = float(boom_ends(clearance.crane, boom, clearance.crane.start.q)[0, 2])
    elif clearance.turning is not None:
        places = clearance.crane.start.q[None, clearance.drive_joints]
        pivot = clearance.point(places)[0]
        top = float(pivot[2]) + float(clearance.cable(clearance.q(places))[0])
    return clearance.site.to_site(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, top]]))


def _boom_lines(lift: Lift) -> list[np.ndarray]:
    """Return hinge, head and load at both ends of a lift in the frame of the site [m], shape (3, 3)
    each; an empty list of a crane without a boom.
    """
    clearance = lift.clearance
    boom = boom_of(lift.crane)
    if boom is None:
        return []
    lines = []
    for place in lift.ends:
        ends = boom_ends(lift.crane, boom, clearance.q(place[None])[0])
        load = clearance.point(place[None])
        lines.append(clearance.site.to_site(np.concatenate([ends, load])))
    return lines


def clearance_over_time(certificate: Certificate) -> Figure:
    """Draw the clearance to the nearest obstacles, and the swing, over time."""
    site = certificate.lift.clearance.site
    figure, (clear, swing) = panels(2, height=2.6, sharex=True)
    zones = {solid.name for solid in site.solids if solid.zone}
    names = [name for name in certificate.distances if name not in zones]
    names.sort(key=lambda name: certificate.distances[name].min().item())
    for i, name in enumerate(names[:_MAX_OBSTACLES]):
        clear.plot(certificate.t, certificate.distances[name], color=run_colour(i), label=name)
    clear.axhline(site.distance, color="#000000", linestyle="--", linewidth=1.0, label="required")
    clear.set(ylabel="clearance [m]", ylim=(0.0, _CLEARANCE_SCALE))
    legend_above(clear, columns=2)
    run = certificate.run
    # Angles from plumb: those of a luffing crane are not its coordinates.
    angles, _ = certificate.lift.clearance.swing(run.q, run.v)
    labels = ("φ radial", "θ tangential") if "phi_rad" in run.keys() else ("first", "second")
    for k, (label, colour) in enumerate(zip(labels, ("phi", "theta"), strict=True)):
        swing.plot(run.t, 1e3 * angles[:, k], color=COLOURS[colour], label=label)
    for limit in (1e3 * site.swing, -1e3 * site.swing):
        swing.axhline(limit, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    swing.axvline(certificate.lift.timed.motion.arrival, color=COLOURS["limit"], linewidth=1.0)
    swing.set(xlabel="time [s], the line is the arrival", ylabel="swing [mrad]")
    legend_above(swing, columns=2)
    return figure


def scenery(certificate: Certificate, *, begins: float = 0.0) -> Scenery:
    """Return the obstacles of a site for a recording, marked while they are nearer than the
    required distance and twice the envelope, in a run in which the lift begins at a time [s].
    """
    lift = certificate.lift
    clearance = lift.clearance
    cable = float(clearance.cable(clearance.q(lift.ends)).mean())
    mark = clearance.site.distance + 2.0 * clearance.envelope(cable)
    obstacles = []
    for solid in clearance.solids:
        times: list[float] = []
        if not solid.zone:  # no distance is required of a zone
            times = _times_near(certificate, solid.name, mark)
        marked = [begins + t for t in times]
        obstacle = Obstacle(solid.name, solid.vertices, solid.triangles, solid.zone, marked)
        obstacles.append(obstacle)
    return Scenery(obstacles, clearance.point(lift.timed.places[::5]), _swept_boxes(lift))


def _times_near(certificate: Certificate, name: str, mark: float) -> list[float]:
    """Return the times at which an obstacle comes nearer than a distance [m] and leaves, in turn
    [s].
    """
    near = certificate.distances[name] < mark
    turns = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    return certificate.t[np.minimum(turns, len(certificate.t) - 1)].tolist()


def _swept_boxes(lift: Lift) -> dict[str, np.ndarray]:
    """Return boxes around the load with its envelope, `_BOX_SPACING` apart along its path."""
    clearance = lift.clearance
    drive_positions = lift.timed.places
    points = clearance.point(drive_positions)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    rows = np.unique(np.searchsorted(arc, np.arange(0.0, arc[-1], _BOX_SPACING)))
    # Corners of the load along the axes that it has with all drives at zero, from which it turns.
    load = clearance.bodies.load @ clearance.bodies.hook_turn.T
    cables = clearance.cable(clearance.q(drive_positions[rows]))
    envelope = clearance.envelope(cables)
    yaw = clearance.load_turn(drive_positions[rows])
    # The point below the rope need not be the middle of the box, which turns with the load.
    middle = (load.min(axis=0) + load.max(axis=0)) / 2.0
    offsets = np.array([rotation_z(angle) @ middle for angle in yaw])
    return {
        "centres": points[rows] + offsets,
        "sizes": np.ptp(load, axis=0) + 2.0 * envelope[:, None],
        "yaw": yaw,
    }


def solid_outlines(solid: Solid, i: int, j: int) -> PolyCollection:
    """Return the outlines of a solid as seen along an axis, with the coordinates i and j to the
    right and upwards: those of its convex parts, or of its triangles if it has none.
    """
    faces = solid.parts or tuple(solid.vertices[triangle] for triangle in solid.triangles)
    shapes = []
    for corners in faces:
        # Faces seen from the side are lines, of which there is no convex hull.
        flat = np.unique(np.round(corners[:, [i, j]], 6), axis=0)
        if len(flat) > 2 and np.linalg.matrix_rank(flat - flat[0], tol=1e-5) == 2:
            shapes.append(flat[ConvexHull(flat).vertices])
    colour, alpha = ("#CC3311", 0.25) if solid.zone else ("#8C8475", 0.55)
    return PolyCollection(shapes, facecolor=colour, edgecolor=colour, alpha=alpha, linewidth=0.8)
