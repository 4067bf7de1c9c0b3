"""The figures of A2."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import COLOURS, panels
from experiments.a2.reading import Reading


def hoisting_figure(trajectory: Trajectory, reading: Reading) -> Figure:
    """Draw the swing, the cable length, and the period of each half swing on the theoretical
    curve.
    """
    figure, (swing, cable, period) = panels(3, height=2.2, sharex=True)
    t, length = trajectory.t, trajectory["l_m"]
    swing.plot(t, np.degrees(trajectory["phi_rad"]), color=COLOURS["phi"])
    swing.set_ylabel("φ [°]")
    cable.plot(t, trajectory["l_setpoint_m"], "--", color=COLOURS["setpoint"], label="setpoint")
    cable.plot(t, length, color=COLOURS["l"], label="cable length")
    cable.set_ylabel("l [m]")
    point = theory.point_period(length, STANDARD_GRAVITY)
    period.plot(t, point, color=COLOURS["setpoint"], label="2π√(l(t)/g)")
    point = theory.point_period(np.interp(reading.times, t, length), STANDARD_GRAVITY)
    measured = (1 + reading.errors) * point
    period.plot(reading.times, measured, "o", color=COLOURS["phi"], label="half swings, doubled")
    period.set(ylabel="period [s]", xlabel="time [s]")
    cable.legend()
    period.legend()
    return figure


def fits_figure(reading: Reading) -> Figure:
    """Draw the amplitude over cable length: through all points, and where the cable moves."""
    figure, axes = panels(1, 2, height=3.8, sharey=True)
    lengths, amplitudes = reading.lengths, np.degrees(reading.amplitudes)
    fine = np.linspace(lengths.min(), lengths.max(), 50)
    anchor = reading.amplitudes[0] * lengths[0] ** 0.75
    moving = reading.hoisting
    for ax, law, name in zip(
        axes, (reading.everywhere, reading.section), ("all points", "hoisting only"), strict=True
    ):
        all_points = law is reading.everywhere
        ax.plot(
            lengths[~moving],
            amplitudes[~moving],
            "o",
            color=COLOURS["setpoint"],
            label="cable at rest" if all_points else None,
            alpha=1.0 if all_points else 0.25,
        )
        ax.plot(lengths[moving], amplitudes[moving], "o", color=COLOURS["l"], label="cable running")
        fit = f"fit: exponent {law.exponent:.3f}"
        ax.plot(fine, np.degrees(law(fine)), color=COLOURS["phi"], label=fit)
        slow, style = np.degrees(anchor * fine**-0.75), COLOURS["unexplained"]
        ax.plot(fine, slow, "--", color=style, linewidth=1.0, label="exponent -3/4")
        title = f"{name}, {law.points} points"
        ax.set(xscale="log", yscale="log", xlabel="cable length [m]", title=title)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter())
        ax.set_xticks([8, 10, 12, 15, 20])
        ax.set_yticks([6, 8, 10, 12])
        ax.legend()
    axes[0].set_ylabel("amplitude [°]")
    return figure
