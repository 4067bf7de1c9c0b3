"""The energy ledger: where every joule of a free swing goes, and that nothing vanishes."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.checks import number
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from experiments import harness
from experiments.energy.swing import (
    AUDIT,
    DAMPINGS,
    LENGTH,
    LONG,
    PUBLISHED,
    SWING,
    damped_share,
    half_step,
    locked_off,
    lowered,
    run,
    swing_energy,
)
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table

LEAST_SWING = 0.001
"""Smallest swing at the start [rad]."""

ROUNDING = 1e-13
"""Smallest share of the energy that stands clear of its rounding."""

STEPS = (1.0e-3, 5.0e-4, 2.5e-4)
"""Physics steps compared [s]."""


class Band(NamedTuple):
    """Unexplained energy at the end of a run beside its range at the beginning.

    The ripple of this energy follows the swing, so it cancels in the mean over a whole period. A
    steady gain or loss carries that mean out of the range of the first swing; a ripple that decays
    with the swing does not.

    Attributes:
        mean: Mean over the last swing [J].
        low: Least value in the first swing [J].
        high: Largest value in the first swing [J].
    """

    mean: float
    low: float
    high: float


def band(trajectory: Trajectory, period: float) -> Band:
    """Return the band of the unexplained energy of a run whose swing has a period [s]."""
    t = trajectory.t
    error = trajectory.unexplained
    first = error[t <= t[0] + period]
    last = error[t >= t[-1] - period]
    return Band(float(last.mean()), float(first.min()), float(first.max()))


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Audit the swing, vary the damping, halve the step, and check that it does not run away."""
    swing = number("swing", options.swing, "rad", f"{LEAST_SWING:g} to {math.pi / 2:.4f}")
    if getattr(options, "overwritten", False):
        from experiments.energy.overwritten import experiment as overwritten

        return overwritten(setup, swing, options.length)
    return _audit(setup, swing, options.length)


def _audit(setup: Setup, swing: float, length: float) -> Outcome:
    """Return the ledger of a swing.

    Args:
        setup: The world.
        swing: Swing at the start [rad].
        length: Cable length [m].
    """
    # The swing of the article with each damping, over the time for which it is audited there.
    cranes = {damping: setup.variant(damp_swing=damping) for damping in DAMPINGS}
    audits = {}
    remaining = {}
    for damping, crane in cranes.items():
        audits[damping] = run(setup, crane, swing, length, AUDIT)
        remaining[damping] = float(swing_energy(crane, audits[damping])[-1])
    crane = cranes[1.0]
    first_energy = float(swing_energy(crane, audits[1.0])[0])
    expected = {}
    for damping, damped_crane in cranes.items():
        expected[damping] = first_energy * damped_share(damped_crane, damping, length, AUDIT)

    # A long swing with each step.
    steps = {dt: run(replace(setup, dt=dt), crane, swing, length, LONG) for dt in STEPS}
    ripple = {dt: float(np.abs(of_step.unexplained).max()) for dt, of_step in steps.items()}
    largest = float(np.abs(steps[5e-4].energy).max())
    if min(ripple.values()) < ROUNDING * largest:
        raise DataError(
            f"What stays open, {min(ripple.values()):.1e} J, is lost in the rounding of energies "
            f"of {largest:.1e} J: swing wider."
        )
    inertia = crane.payload_inertia[0, 0]
    small_period = theory.rigid_period(length, crane.gravity, crane.payload_mass, inertia)
    period = small_period * float(theory.amplitude_factor(swing))
    bands = {dt: band(of_step, period) for dt, of_step in steps.items()}

    trajectories = {f"energy_damp_{damping:g}": audit for damping, audit in audits.items()}
    for dt, of_step in steps.items():
        trajectories[f"energy_dt_{1e6 * dt:.0f}us"] = of_step
    recorded = {}
    for damping, audit in audits.items():
        recorded[f"damping {damping:g} N m s/rad"] = (cranes[damping], audit)
    return Outcome(
        tables=[
            _ledger(crane, audits[1.0]),
            _dampings(audits, remaining, expected),
            _steps(ripple, bands),
        ],
        claims=[
            *_ledger_claims(setup, crane, audits[1.0], ripple, period),
            *_exact_claims(setup, cranes[DAMPINGS[2]], swing, length, bands[5e-4], period),
        ],
        parameters={"swing_rad": swing, "length_m": length},
        trajectories=trajectories,
        figures={
            "ledger": _ledger_figure(crane, audits[1.0]),
            "remainder": _remainder_figure(steps),
        },
        recording=harness.side_by_side(recorded),
    )


def _ledger_claims(
    setup: Setup, crane: Crane, audit: Trajectory, ripple: Mapping[float, float], period: float
) -> Iterator[Claim]:
    """Yield the claims on what the ledger leaves open.

    Args:
        setup: The world.
        crane: The crane of the audit.
        audit: Its run.
        ripple: Largest unexplained energy of a long run [J], by its step [s].
        period: Period of the swing [s].
    """
    first = float(swing_energy(crane, audit)[0])
    worst = float(np.abs(audit.unexplained).max())
    lead = half_step(crane, audit, setup.dt)
    halving = [ripple[coarse] / ripple[fine] for coarse, fine in itertools.pairwise(STEPS)]
    # What the next power of the step changes in a ratio is a few ω dt; four are allowed.
    second = [4.0 * (2.0 * math.pi / period) * dt for dt in STEPS[:-1]]
    yield Claim(
        f"Nothing vanishes: of {first:.1f} J the ledger leaves {worst:.3f} J open at most "
        f"at dt = {1000 * setup.dt:g} ms, what the weight works in the half step by which "
        f"positions are ahead of velocities ({lead:.3f} J), within 1 %.",
        worst < 1.01 * lead,
    )
    yield Claim(
        f"What stays open halves with the step: ratios {halving[0]:.5f} and "
        f"{halving[1]:.5f}, 2 within {second[0]:.5f} and {second[1]:.5f}, 4 ω dt.",
        all(abs(ratio - 2.0) < bound for ratio, bound in zip(halving, second, strict=True)),
    )


def _exact_claims(
    setup: Setup,
    damped: Crane,
    swing: float,
    length: float,
    limits: Band,
    period: float,
) -> Iterator[Claim]:
    """Yield the claims on runs that are known exactly, and on a long run.

    Args:
        setup: The world.
        damped: The crane with the largest damping.
        swing: Swing at the start [rad].
        length: Cable length [m].
        limits: Band of the unexplained energy of a long run.
        period: Period of the swing [s].
    """
    exact, rounding = lowered(setup, length)
    mean, low, high = limits
    error, allowed = locked_off(setup, damped, swing, length)
    yield Claim(
        "Where the step is exact, a plumb load being lowered, the work of the drives "
        f"closes the ledger to {exact:.0e} J, rounding being {rounding:.0e} J.",
        exact <= rounding,
    )
    yield Claim(
        f"It does not run away: its mean over the last swing in {LONG:g} s, {mean:+.4f} J, "
        f"lies in what the first swing spans, {low:+.2f} to {high:+.2f} J.",
        low <= mean <= high if 2.0 * period < LONG else None,
    )
    yield Claim(
        "Damping acts: with 2e5 N m s/rad and the drives locked, the energy is that of "
        f"the damped pendulum at every time up to {AUDIT:g} s, off by {error:.1e} of the start "
        f"at most, within {allowed:.1e}, which is ω dt/2.",
        error < allowed,
    )


def _ledger(crane: Crane, trajectory: Trajectory) -> ResultTable:
    level = swing_energy(crane, trajectory)
    first = float(level[0])
    last = float(level[-1])
    rows = [
        ("swing energy at t = 0", first, PUBLISHED.first),
        (f"swing energy at t = {AUDIT:g} s", last, PUBLISHED.last),
        ("difference", last - first, PUBLISHED.last - PUBLISHED.first),
        ("work of the three drives", float(trajectory.work[-1].sum()), PUBLISHED.work),
        ("taken by joint damping", -float(trajectory.dissipated[-1]), None),
        ("unexplained", float(trajectory.unexplained[-1]), PUBLISHED.unexplained),
    ]
    swing = trajectory["phi_rad"][0]
    cable = trajectory["l_m"][0]
    return ResultTable(
        f"Energy of a {swing:g} rad swing on {cable:g} m of cable",
        [("[J]", ""), ("ours", "+.2f"), ("article", "+.1f")],
        rows,
        "The article's column is its ledger of a 0.15 rad swing on 15 m of cable, while a plugin "
        "overwrote the passive joints.",
    )


def _dampings(
    audits: Mapping[float, Trajectory],
    remaining: Mapping[float, float],
    expected: Mapping[float, float],
) -> ResultTable:
    return make_table(
        f"Damping of the swing joints, after {AUDIT:g} s",
        audits.items(),
        ("damp_swing [N m s/rad]", "g", lambda a: a[0]),
        ("energy left [J]", ".2f", lambda a: remaining[a[0]]),
        ("closed form, fixed pivot [J]", ".2f", lambda a: expected[a[0]]),
        ("dissipated [J]", ".3f", lambda a: float(a[1].dissipated[-1])),
        ("drives [J]", "+.2f", lambda a: float(a[1].work[-1].sum())),
        ("unexplained, at most [J]", ".2f", lambda a: float(np.abs(a[1].unexplained).max())),
        note="The closed form has no drives; the work of the hoist is the difference. The "
        "article was left with 19.3 J.",
    )


def _steps(ripple: Mapping[float, float], bands: Mapping[float, Band]) -> ResultTable:
    return make_table(
        f"What the ledger leaves open over {LONG:g} s",
        ripple,
        ("dt [ms]", "g", lambda dt: 1000 * dt),
        ("at most [J]", ".3f", lambda dt: ripple[dt]),
        ("mean of the last swing [J]", "+.4f", lambda dt: bands[dt].mean),
        ("first swing from [J]", "+.3f", lambda dt: bands[dt].low),
        ("to [J]", "+.3f", lambda dt: bands[dt].high),
    )


def _ledger_figure(crane: Crane, trajectory: Trajectory) -> Figure:
    figure, (above, below) = panels(2, height=2.4, sharex=True)
    t = trajectory.t
    level = swing_energy(crane, trajectory)
    above.plot(t, level, color=COLOURS["energy"], label="ours")
    label = "article, with its plugin"
    colour = COLOURS["unexplained"]
    above.plot([0.0, AUDIT], [PUBLISHED.first, PUBLISHED.last], "x", color=colour, label=label)
    above.set(ylabel="swing energy [J]", ylim=(0, 1.1 * level[0]))
    below.plot(t, level - level[0], color=COLOURS["energy"], label="change of swing energy")
    for i, (drive, name) in enumerate({"gamma": "slew", "x": "trolley", "l": "hoist"}.items()):
        below.plot(t, trajectory.work[:, i], color=COLOURS[drive], label=f"work of {name}")
    below.plot(t, trajectory.unexplained, "--", color=colour, label="unexplained")
    below.set(xlabel="time [s]", ylabel="energy [J]")
    legend_above(above)
    legend_above(below, columns=5)
    return figure


def _remainder_figure(steps: Mapping[float, Trajectory]) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    for (dt, trajectory), name in zip(steps.items(), ("x", "energy", "l"), strict=True):
        label = f"dt = {1000 * dt:g} ms"
        ax.plot(
            trajectory.t, trajectory.unexplained, color=COLOURS[name], linewidth=1.0, label=label
        )
    ax.set(xlabel="time [s]", ylabel="unexplained [J]")
    legend_above(ax, columns=3)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("energy", __doc__)
    harness.add_setup(parser, "damp_swing", "hoist_init")
    add = parser.add_argument
    text = "radial swing at the start [rad]"
    add("--swing", type=float, default=SWING, metavar="PHI", help=text)
    add("--length", type=float, default=LENGTH, metavar="L", help="cable length [m]")
    text = "what a plugin that overwrites the passive rates does to the swing"
    add("--overwritten", action="store_true", help=text)
    return harness.run_experiment(parser, experiment, argv)
