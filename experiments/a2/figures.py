"""The figures of A2."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import COLOURS, panels

if TYPE_CHECKING:
    from experiments.a2 import Reading


def hoisting_figure(trajectory: Trajectory, reading: Reading) -> Figure:
    """Swing with its envelope, cable length, and the period of each half swing on the theoretical
    curve.
    """
    figure, (swing, cable, period) = panels(3, height=2.2, sharex=True)
    t = trajectory.t
    swing.plot(t, np.degrees(trajectory["phi_rad"]), color=COLOURS["phi"])
    swing.set_ylabel("φ [°]")
    cable.plot(t, trajectory["l_setpoint_m"], "--", color=COLOURS["setpoint"], label="setpoint")
    cable.plot(t, trajectory["l_m"], color=COLOURS["l"], label="cable length")
    cable.set_ylabel("l [m]")
    period.plot(
        t,
        theory.point_period(trajectory["l_m"], STANDARD_GRAVITY),
        color=COLOURS["setpoint"],
        label="2π√(l(t)/g)",
    )
    period.plot(
        reading.times,
        (1 + reading.errors)
        * theory.point_period(np.interp(reading.times, t, trajectory["l_m"]), STANDARD_GRAVITY),
        "o",
        color=COLOURS["phi"],
        label="half swings, doubled",
    )
    period.set(ylabel="period [s]", xlabel="time [s]")
    cable.legend()
    period.legend()
    return figure


def fits_figure(reading: Reading) -> Figure:
    """Amplitude over cable length: through all points, and through those where the cable moves."""
    figure, axes = panels(1, 2, height=3.8, sharey=True)
    fine = np.linspace(reading.lengths.min(), reading.lengths.max(), 50)
    anchor = reading.amplitudes[0] * reading.lengths[0] ** 0.75
    moving = reading.hoisting
    for ax, law, mask, name in zip(
        axes,
        (reading.everywhere, reading.section),
        (np.ones_like(moving), moving),
        ("all points", "hoisting only"),
        strict=True,
    ):
        ax.plot(
            reading.lengths[~moving],
            np.degrees(reading.amplitudes[~moving]),
            "o",
            color=COLOURS["setpoint"],
            label="cable at rest" if mask.all() else None,
            alpha=1.0 if mask.all() else 0.25,
        )
        ax.plot(
            reading.lengths[moving],
            np.degrees(reading.amplitudes[moving]),
            "o",
            color=COLOURS["l"],
            label="cable running",
        )
        ax.plot(
            fine,
            np.degrees(law(fine)),
            color=COLOURS["phi"],
            label=f"fit: exponent {law.exponent:.3f}",
        )
        ax.plot(
            fine,
            np.degrees(anchor * fine**-0.75),
            "--",
            color=COLOURS["unexplained"],
            linewidth=1.0,
            label="exponent -3/4",
        )
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="cable length [m]",
            title=f"{name}, {law.points} points",
        )
        ax.xaxis.set_major_formatter(ScalarFormatter())
        ax.yaxis.set_major_formatter(ScalarFormatter())
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_xticks([8, 10, 12, 15, 20])
        ax.set_yticks([6, 8, 10, 12])
        ax.legend()
    axes[0].set_ylabel("amplitude [°]")
    return figure
