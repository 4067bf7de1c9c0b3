"""Light links between the swing joints, and loads of any mass.

The links may be as light as one likes, and a point load swings alike whatever it weighs.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.analysis.swing import zero_crossings
from cranedyn.controllers import follow
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.references import spline
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import POINT

LINKS = (50.0, 10.0, 1.0, 0.1, 1e-2, 1e-4, 1e-6, 0.0)
"""Masses of each dummy link [kg]; its inertia is 1 m² times that."""

LOADS = (10.0, 1.0e3, 1.0e5)
"""Masses of the load [kg]."""

SWING = 0.10
"""Swing at the start [rad]."""

LENGTH = 15.0
"""Cable length [m]."""

DURATION = 40.0
"""Duration of a free swing [s]."""

TOUR = 20.0
"""Duration of a tour [s]."""


def swing(setup: Setup, link: float) -> Trajectory:
    """Let the load swing from rest, with the drives locked.

    Args:
        setup: The world.
        link: Mass of each dummy link [kg].
    """
    crane = setup.variant(dummy_mass=link, dummy_inertia=link, damp_swing=0)
    return setup.simulate(
        crane,
        zero_command(crane),
        None,
        start=crane.state(l=LENGTH, phi=SWING),
        duration=DURATION,
        label=f"links of {link:g} kg",
        drive="motion",
    )


def crossing_period(trajectory: Trajectory) -> float:
    """Return the mean period from zero crossings [s].

    Raises:
        DataError: If the load does not swing through twice.
    """
    crossings = zero_crossings(trajectory.t, trajectory["phi_rad"])
    if len(crossings) < 2:
        raise DataError(
            f"The load swings through {len(crossings)} times in {DURATION:g} s; a period needs two."
        )
    return 2.0 * float(crossings[-1] - crossings[0]) / (len(crossings) - 1)


def step_share(setup: Setup, period: float) -> float:
    """Return the share by which semi-implicit Euler shortens the period of a small swing.

    It is (ω dt)²/24; a finite swing A changes it by A² of itself.

    Args:
        setup: The step.
        period: Period of the swing [s].
    """
    return (2.0 * math.pi / period * setup.dt) ** 2 / 24.0


def interpolation_share(setup: Setup, period: float) -> float:
    """Return the largest relative error of a period that is read off straight lines between rows.

    A straight line between two rows misses a zero crossing of A sin ωt by ω² a b (b - a)/6, where a
    and b are the times from the rows to the crossing. With rows a time h apart that is at most
    ω² h³/(36 √3). The first and the last crossing count, over the time between them.

    Args:
        setup: The time between rows, h.
        period: Period of the swing [s].
    """
    h = setup.control_period
    omega = 2.0 * math.pi / period
    return 2.0 * (omega * h) ** 2 * h / (36.0 * math.sqrt(3.0)) / (DURATION - period)


def rounding(setup: Setup, duration: float) -> float:
    """Return the rounding error of a run, which adds up step by step like a random walk.

    Args:
        setup: The step.
        duration: Duration of the run [s].
    """
    return math.sqrt(duration / setup.dt) * sys.float_info.epsilon


def run_tour(setup: Setup, crane: Crane) -> Trajectory:
    """Move all three drives in prescribed motion at once, with a swing at the start."""
    start = crane.state(x=8.0, l=LENGTH, phi=0.05, theta=-0.03)
    reference = spline(crane, start, [(0.4, 14.0, LENGTH - 4.0)], [12.0], at=1.0)
    drives = follow(crane, reference, setup.control_period)
    # The heaviest loads ask for more than any drive has; what is looked at is how they swing.
    return setup.simulate(
        crane,
        drives,
        reference,
        start=start,
        duration=TOUR,
        label=f"load of {crane.payload_mass:g} kg",
        drive="motion",
        validity="mark",
    )


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Vary the dummy links, then the load."""
    crane = setup.crane
    runs = {mass: swing(setup, mass) for mass in LINKS}
    periods = {mass: crossing_period(run) for mass, run in runs.items()}
    expected = {mass: _compound_period(crane, mass) for mass in LINKS}
    points = {}
    rigid = {}
    for mass in LOADS:
        points[mass] = run_tour(setup, setup.variant(payload_mass=mass, **POINT))
        rigid[mass] = run_tour(setup, setup.variant(payload_mass=mass, damp_swing=0))
    are_finite = all(np.isfinite(run.q).all() for run in runs.values())
    return Outcome(
        tables=[_links_table(crane, periods, expected), _loads_table(points, rigid)],
        claims=[
            _periods_claim(setup, periods, expected, are_finite),
            _light_links_claim(setup, periods, expected),
            _loads_claim(setup, points, rigid),
        ],
        parameters={"swing_rad": SWING, "length_m": LENGTH},
        trajectories={"links_50": runs[50.0], "links_1e-6": runs[1e-6], "tour_1000": points[1.0e3]},
        figures={"links": _links_figure(crane, periods)},
        recording=harness.side_by_side({"all drives at once": (crane, points[1.0e3])}),
    )


def _compound_period(crane: Crane, link: float) -> float:
    """Return the period of the compound pendulum of load and links [s].

    Args:
        crane: The crane, for its load.
        link: Mass of each link [kg], whose inertia is 1 m² times that.
    """
    inertia = crane.payload_inertia[0, 0] + 2.0 * link
    small = theory.rigid_period(LENGTH, crane.gravity, crane.payload_mass, inertia)
    return small * float(theory.amplitude_factor(SWING))


def _periods_claim(
    setup: Setup, periods: dict[float, float], expected: dict[float, float], are_finite: bool
) -> Claim:
    """Return the claim that all periods are those of the compound pendulum, but for the step."""
    without_links = expected[0.0]
    of_step = step_share(setup, without_links)
    errors = []
    for mass in LINKS:
        relative = periods[mass] / expected[mass] - 1.0
        errors.append(abs(relative + step_share(setup, expected[mass])))
    worst = max(errors)
    allowed = SWING**2 * of_step + interpolation_share(setup, without_links)
    return Claim(
        "Dummy links from 50 kg down to none run without trouble, and their periods are "
        "those of the compound pendulum less "
        f"(ω dt)²/24 of the step, {of_step:.1e}, within "
        f"{allowed:.1e} (worst {worst:.1e}).",
        are_finite and worst < allowed,
    )


def _light_links_claim(
    setup: Setup, periods: dict[float, float], expected: dict[float, float]
) -> Claim:
    """Return the claim that the lightest links change the period as their inertia must."""
    simulated_gain = periods[1e-6] / periods[0.0] - 1.0
    expected_gain = expected[1e-6] / expected[0.0] - 1.0
    allowed = rounding(setup, DURATION)
    return Claim(
        f"Links of 1e-6 kg beside a load of {setup.crane.payload_mass:g} kg change the period by "
        f"{simulated_gain:.1e}, as their inertia must, "
        f"within rounding, {allowed:.0e}.",
        abs(simulated_gain - expected_gain) < allowed,
    )


def _loads_claim(
    setup: Setup, points: dict[float, Trajectory], rigid: dict[float, Trajectory]
) -> Claim:
    """Return the claim that point loads of any mass swing alike, and rigid ones do not."""
    allowed = rounding(setup, TOUR)
    spread = _spread(points)
    spread_rigid = _spread(rigid)
    return Claim(
        "With exact drives a point load of 10 kg and one of 100 t swing alike within "
        f"rounding, {allowed:.0e} rad "
        f"({spread:.0e}); with inertia they do not ({spread_rigid:.1e}).",
        spread < allowed < spread_rigid,
    )


def _spread(runs: dict[float, Trajectory]) -> float:
    """Return the largest difference in a swing angle between any two runs [rad]."""
    swings = np.stack([r.coordinates("phi", "theta") for r in runs.values()])
    return float(np.ptp(swings, axis=0).max())


def _links_table(
    crane: Crane, periods: dict[float, float], expected: dict[float, float]
) -> ResultTable:
    return make_table(
        "Free swing with ever lighter links between the swing joints",
        periods,
        ("link [kg]", "g", lambda m: m),
        ("load/link", ".0e", lambda m: crane.payload_mass / m if m else None),
        ("T [s]", ".8f", lambda m: periods[m]),
        ("compound pendulum [s]", ".8f", lambda m: expected[m]),
        ("relative error", "+.1e", lambda m: periods[m] / expected[m] - 1),
        ("relative to no links", "+.1e", lambda m: periods[m] / periods[0.0] - 1),
        note="The article's engine diverged at 1 kg.",
    )


def _loads_table(points: dict[float, Trajectory], rigid: dict[float, Trajectory]) -> ResultTable:
    def largest(run: Trajectory, name: str) -> float:
        return float(np.abs(run[name]).max())

    return make_table(
        "All drives in prescribed motion: swing of loads of different mass",
        points,
        ("load [kg]", "g", lambda m: m),
        ("point: max φ [rad]", ".9f", lambda m: largest(points[m], "phi_rad")),
        ("max θ [rad]", ".9f", lambda m: largest(points[m], "theta_rad")),
        ("400 kg m²: max φ [rad]", ".9f", lambda m: largest(rigid[m], "phi_rad")),
        ("max θ [rad]", ".9f", lambda m: largest(rigid[m], "theta_rad")),
    )


def _links_figure(crane: Crane, periods: dict[float, float]) -> Figure:
    figure, (ax,) = panels(1, height=3.4, width=7.0)
    masses = np.array([m for m in periods if m > 0])
    gain = np.array([periods[m] / periods[0.0] - 1 for m in masses])
    ax.loglog(masses, gain, "o", color=COLOURS["phi"], label="simulated")
    theory_gain = masses / (crane.payload_mass * LENGTH**2 + crane.payload_inertia[0, 0])
    ax.loglog(masses, theory_gain, color=COLOURS["setpoint"], label="I/(2 m l²), two links")
    ax.axvline(1.0, linestyle=":", color=COLOURS["unexplained"])
    text = "the article's engine\ndiverged here"
    offset = "offset points"
    ax.annotate(text, (1.0, gain.min()), xytext=(6, 0), textcoords=offset)
    ax.set(xlabel="mass of each link [kg]", ylabel="gain in period over no links")
    legend_above(ax)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("mass_ratio", __doc__)
    harness.add_setup(parser, "dummy_mass", "dummy_inertia", "damp_swing", "hoist_init")
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
