"""The figures of the validation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, panels
from experiments.oracles.check import STEP, OracleCheck
from experiments.oracles.reading import Bench, payload_from_pivot
from experiments.oracles.swing import LENGTH, OVALS

SWING = 0.5
"""Swing whose energy is shown to ripple [rad]."""


def convergence_figure(checks: Sequence[OracleCheck]) -> Figure:
    """Draw the error of every row in which the step shows, over the step, each over its error at
    the coarsest.
    """
    figure, (ax,) = panels(1, height=4.5)
    ordered = [check for check in checks if check.order is not None]
    for check in ordered:
        errors = np.abs(np.array(check.values) - check.oracle.closed)
        colour = COLOURS["gamma" if round(check.order or 0.0) == 1 else "x"]
        ax.loglog(
            1e3 * np.array(check.steps), errors / errors[0], ".-", color=colour, linewidth=0.8
        )
    steps = STEP * np.array([1.0, 0.06])
    for power, colour in ((1, "gamma"), (2, "x")):
        ax.loglog(
            steps * 1e3, (steps / STEP) ** power, ":", color=COLOURS["unexplained"], linewidth=1.0
        )
        ax.plot([], [], ".-", color=COLOURS[colour], label=f"rows of order {power}")
    ax.plot([], [], ":", color=COLOURS["unexplained"], label="first and second power")
    ticks = [1000.0 * step for step in checks[0].steps]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.minorticks_off()
    ax.set(xlabel="dt [ms]", ylabel=f"error over that at {1000 * STEP:g} ms")
    ax.legend()
    return figure


def ripple_figure(bench: Bench, crane: Crane) -> Figure:
    """Draw the energy of a large swing in its plane, at three steps, each half of the one
    before.
    """
    figure, (ax,) = panels(1, height=3.2)
    for dt, colour in zip((0.02, 0.01, 0.005), ("x", "energy", "l"), strict=True):
        swing = bench.run(crane, crane.state(l=LENGTH, phi=SWING), 30.0, dt)
        ax.plot(
            swing.t,
            swing.energy - swing.energy[0],
            color=COLOURS[colour],
            label=f"dt = {1000 * dt:g} ms",
        )
    full = crane.payload_mass * crane.gravity * LENGTH * (1.0 - np.cos(SWING))
    ax.set(xlabel="time [s]", ylabel=f"gain of energy [J] of {full:.0f} J")
    ax.legend(ncols=3, loc="upper right")
    return figure


def oval_figure(trajectory: Trajectory) -> Figure:
    """Draw the load from above, and the far ends of its oval by the apsidal integral."""
    figure, (ax,) = panels(1, height=6.0, width=6.5)
    offset = payload_from_pivot(trajectory.q) - payload_from_pivot(trajectory.q * [1, 1, 0, 0, 0])
    far, near = OVALS[1]
    turns = int(trajectory.t[-1] / theory.point_period(LENGTH, 9.81)) + 1
    angles = np.arctan2(offset[0, 1], offset[0, 0]) + theory.apsidal_precession(
        LENGTH, far, near
    ) * np.arange(turns)
    ax.plot(*offset[:, :2].T, color=COLOURS["theta"], linewidth=0.8, label="load from above")
    ax.plot(
        far * np.cos(angles),
        far * np.sin(angles),
        "o",
        color=COLOURS["x"],
        label="far ends by the integral",
    )
    ax.set(xlabel="[m]", ylabel="[m]", aspect="equal")
    ax.legend(loc="upper right")
    return figure
