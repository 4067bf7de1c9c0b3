"""Figures and scenery of planned lifts: plan, elevations, clearance over time, and the site in a
recording.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import PolyCollection
from scipy.spatial import ConvexHull

from cranedyn.planning.certificate import Certificate
from cranedyn.planning.lift import Lift
from cranedyn.planning.solids import Solid
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.recording import Obstacle, Scenery

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN, _SPACED, _SCALE = 5, 1.5, 8.0
_PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00")


def site_views(certificate: Certificate) -> Figure:
    """Draw plan and two elevations of a site with the path of the load, its envelope at the nearest
    point, and the reach of the crane.
    """
    lift = certificate.lift
    site, clearance = lift.clearance.site, lift.clearance
    path = site.to_site(clearance.point(lift.timed.places))
    near = site.to_site(
        clearance.point(
            certificate.run.q[np.searchsorted(certificate.run.t, certificate.nearest_t)][
                clearance.drive_joints
            ]
        )
    )
    figure, axes = panels(1, 3, height=4.2, width=13.0)
    for ax, (i, j), names in zip(
        axes, ((0, 1), (0, 2), (1, 2)), (("x", "y"), ("x", "z"), ("y", "z")), strict=True
    ):
        for solid in site.solids:
            ax.add_collection(_outlines(solid, i, j))
        mast = site.to_site(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, clearance.height]]))
        ax.plot(mast[:, i], mast[:, j], color="#333333", linewidth=3.0, marker="s", markersize=4)
        ax.plot(path[:, i], path[:, j], color=COLOURS["x"], label="centre of the load")
        ax.plot(path[0, i], path[0, j], "o", color=COLOURS["x"])
        ax.plot(path[-1, i], path[-1, j], "*", color=COLOURS["x"], markersize=12)
        ax.plot(
            near[i],
            near[j],
            "x",
            color="#000000",
            label=f"nearest, {certificate.nearest.distance:.2f} m",
        )
        if j == 2:
            ax.axhline(site.ground, color="#777777", linewidth=1.0)
        ax.set(xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]")
        ax.set_aspect("equal", adjustable="datalim")
        ax.autoscale_view()
    angle = np.linspace(0.0, 2.0 * math.pi, 100)
    for radius in (
        lift.crane.lower[clearance.joints.trolley],
        lift.crane.upper[clearance.joints.trolley],
    ):
        axes[0].plot(
            site.foot[0] + radius * np.cos(angle),
            site.foot[1] + radius * np.sin(angle),
            ":",
            color="#999999",
            linewidth=1.0,
        )
    axes[0].legend(loc="best", fontsize=9)
    figure.suptitle(site.name)
    return figure


def clearance_over_time(certificate: Certificate) -> Figure:
    """Draw the clearance to the nearest obstacles, and the swing, over time."""
    site = certificate.lift.clearance.site
    figure, (clear, swing) = panels(2, height=2.6, sharex=True)
    zones = {solid.name for solid in site.solids if solid.zone}
    names = sorted(
        (name for name in certificate.distances if name not in zones),
        key=lambda name: certificate.distances[name].min().item(),
    )
    for name, colour in zip(names[:_SHOWN], _PALETTE, strict=False):
        clear.plot(certificate.t, certificate.distances[name], color=colour, label=name)
    clear.axhline(site.distance, color="#000000", linestyle="--", linewidth=1.0, label="required")
    clear.set(ylabel="clearance [m]", ylim=(0.0, _SCALE))
    clear.legend(loc="upper right", ncols=2, fontsize=9)
    run = certificate.run
    swing.plot(run.t, 1e3 * run["phi_rad"], color=COLOURS["phi"], label="φ radial")
    swing.plot(run.t, 1e3 * run["theta_rad"], color=COLOURS["theta"], label="θ tangential")
    for sign in (1.0, -1.0):
        swing.axhline(
            sign * 1e3 * site.swing, color=COLOURS["limit"], linestyle="--", linewidth=1.0
        )
    swing.axvline(certificate.lift.timed.motion.arrival, color=COLOURS["limit"], linewidth=1.0)
    swing.set(xlabel="time [s], the line is the arrival", ylabel="swing [mrad]")
    swing.legend(loc="upper right", ncols=2, fontsize=9)
    return figure


def scenery(certificate: Certificate) -> Scenery:
    """Return the obstacles of a site for a recording, marked while they are nearer than the
    required distance and twice the envelope.
    """
    lift, clearance = certificate.lift, certificate.lift.clearance
    mark = clearance.site.distance + 2.0 * clearance.envelope(float(lift.ends[:, 2].mean()))
    obstacles = [
        Obstacle(
            solid.name,
            solid.vertices,
            solid.triangles,
            solid.zone,
            () if solid.zone else _spells(certificate, solid.name, mark),
        )
        for solid in clearance.solids
    ]
    return Scenery(obstacles, clearance.point(lift.timed.places[::5]), _swept(lift))


def _spells(certificate: Certificate, name: str, mark: float) -> list[float]:
    """Return the times at which an obstacle comes near and leaves, in turn [s]."""
    near = certificate.distances[name] < mark
    turns = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    return certificate.t[np.minimum(turns, len(certificate.t) - 1)].tolist()


def _swept(lift: Lift) -> dict[str, np.ndarray]:
    """Return boxes around the load with its envelope, some metres apart."""
    clearance, drive_positions = lift.clearance, lift.timed.places
    points = clearance.point(drive_positions)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    rows = np.unique(np.searchsorted(arc, np.arange(0.0, arc[-1], _SPACED)))
    load = clearance.bodies.load
    envelope = np.array([clearance.envelope(length) for length in drive_positions[rows, 2]])
    return {
        "centres": points[rows] + (load.min(axis=0) + load.max(axis=0))[None] / 2.0,
        "sizes": np.ptp(load, axis=0) + 2.0 * envelope[:, None],
        "yaw": drive_positions[rows, 0],
    }


def _outlines(solid: Solid, i: int, j: int) -> PolyCollection:
    """Draw a solid along an axis."""
    faces = solid.parts or tuple(solid.vertices[triangle] for triangle in solid.triangles)
    shapes = []
    for corners in faces:
        flat = np.unique(np.round(corners[:, [i, j]], 6), axis=0)
        if len(flat) > 2 and np.linalg.matrix_rank(flat - flat[0], tol=1e-5) == 2:
            shapes.append(flat[ConvexHull(flat).vertices])
    colour = "#CC3311" if solid.zone else "#8C8475"
    return PolyCollection(
        shapes,
        facecolor=colour,
        edgecolor=colour,
        alpha=0.25 if solid.zone else 0.55,
        linewidth=0.8,
    )
