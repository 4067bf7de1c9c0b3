"""Figures of tutorial and concept pages: python docs/draw.py, from the top of the repository."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.controllers.follow import follow
from cranedyn.plotting.figures import plot_runs
from cranedyn.references import hold, ramp, shaped, zv
from cranedyn.references.simple import spline
from cranedyn.theory import point_period, quintic_residual

PICTURES = Path(__file__).parent / "pictures"

LENGTH = 20.0
"""Cable length [m]."""

DISTANCE = 6.0
"""How far the trolley moves [m]."""


def simulated_swing(duration: float) -> float:
    """Return the amplitude of the swing that a quintic of the trolley leaves [rad]."""
    crane = cd.load_crane()
    start = crane.state(x=8.0, l=LENGTH)
    move = spline(crane, start, [[0.0, 8.0 + DISTANCE, LENGTH]], [duration])
    run = cd.simulate(
        crane,
        follow(crane, move),
        move,
        start=start,
        duration=60.0,
        drive="motion",
        engine="compiled",
    )
    return float(np.abs(run["phi_rad"][run.t > duration]).max())


def swing_left() -> Figure:
    """Return the figure of the swing that a quintic leaves, over its duration in periods."""
    gravity = cd.load_crane().gravity
    period = float(point_period(LENGTH, gravity))
    durations = np.linspace(0.5, 5.0, 900) * period
    predicted = [quintic_residual(DISTANCE, t, LENGTH, gravity) for t in durations.tolist()]
    points = np.arange(0.75, 5.01, 0.25) * period
    simulated = [simulated_swing(t) for t in points.tolist()]
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(durations / period, np.degrees(predicted), color="#2c6fb0", label="equation (3)")
    axes.plot(points / period, np.degrees(simulated), "o", ms=4, color="#c8553d", label="simulated")
    axes.set_yscale("log")
    axes.set_ylim(1e-3, 30.0)
    axes.set_xlim(0.5, 5.0)
    axes.set_xlabel("duration of the move [periods of the load, 9.0 s]")
    axes.set_ylabel("swing left [degrees]")
    axes.set_title("A quintic that moves the trolley by 6 m, on a cable of 20 m", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right")
    return figure


def shaped_move() -> Figure:
    """Return the figure of the move of the first run, as it is and shaped."""
    crane = cd.load_crane(payload_mass=2000)
    start = crane.state(x=12.0, l=10.0)
    period = float(point_period(10.0, crane.gravity))
    goal = ramp(crane, hold(crane, start), "x", 2.0, rate=0.5, at=1.0)
    runs = {}
    for name, reference in {"as it is": goal, "shaped": shaped(goal, zv(), [period])}.items():
        runs[name] = cd.simulate(
            crane, hold_controller(crane), reference, start=start, duration=20.0
        )
    return plot_runs(runs, "x_m", "phi_rad")


if __name__ == "__main__":
    shaped_move().savefig(PICTURES / "shaped_move.png", dpi=110)
    swing_left().savefig(PICTURES / "swing_left.png", dpi=110)
