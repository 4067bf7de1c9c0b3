"""The energy ledger: where every joule of a free swing goes, and that nothing vanishes."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.checks import number
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, panels
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


def band(trajectory: Trajectory, period: float) -> tuple[float, float, float]:
    """Return the mean of the unexplained energy over the last swing, and its least and largest
    value in the first swing [J].

    Over a whole period [s] the ripple, which follows the swing, cancels in the mean. A steady gain
    or loss carries the mean out of the band of the first swing; a ripple that decays with the swing
    does not.
    """
    t = trajectory.t
    error = trajectory.unexplained
    first = error[t <= t[0] + period]
    return float(error[t >= t[-1] - period].mean()), float(first.min()), float(first.max())


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Audit the swing, vary the damping, halve the step, and check that it does not run away."""
    swing = number("swing", options.swing, "rad", f"{LEAST_SWING:g} to {math.pi / 2:.4f}")
    if getattr(options, "overwritten", False):
        from experiments.energy.overwritten import experiment as overwritten

        return overwritten(setup, swing, options.length)
    return _audit(setup, swing, options.length)


def _audit(setup: Setup, swing: float, length: float) -> Outcome:
    cranes = {d: setup.variant(damp_swing=d) for d in DAMPINGS}
    crane = cranes[1.0]
    audits = {d: run(setup, c, swing, length, AUDIT) for d, c in cranes.items()}
    steps = {dt: run(replace(setup, dt=dt), crane, swing, length, LONG) for dt in STEPS}
    ripple = {dt: float(np.abs(r.unexplained).max()) for dt, r in steps.items()}
    largest = float(np.abs(steps[5e-4].energy).max())
    if min(ripple.values()) < ROUNDING * largest:
        raise DataError(
            f"What stays open, {min(ripple.values()):.1e} J, is lost in the rounding of energies "
            f"of {largest:.1e} J: swing wider."
        )
    inertia = crane.payload_inertia[0, 0]
    period = theory.rigid_period(length, crane.gravity, crane.payload_mass, inertia) * float(
        theory.amplitude_factor(swing)
    )
    bands = {dt: band(r, period) for dt, r in steps.items()}
    remaining = {d: float(swing_energy(cranes[d], r)[-1]) for d, r in audits.items()}
    first = float(swing_energy(crane, audits[1.0])[0])
    expected = {d: first * damped_share(c, d, length, AUDIT) for d, c in cranes.items()}
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
        trajectories={f"energy_damp_{d:g}": r for d, r in audits.items()}
        | {f"energy_dt_{1e6 * dt:.0f}us": r for dt, r in steps.items()},
        figures={
            "ledger": _ledger_figure(crane, audits[1.0]),
            "remainder": _remainder_figure(steps),
        },
        recording=harness.side_by_side(
            {f"damping {d:g} N m s/rad": (cranes[d], r) for d, r in audits.items()}
        ),
    )


def _ledger_claims(
    setup: Setup, crane: Crane, audit: Trajectory, ripple: Mapping[float, float], period: float
) -> Iterator[Claim]:
    first = float(swing_energy(crane, audit)[0])
    worst = float(np.abs(audit.unexplained).max())
    lead = half_step(crane, audit, setup.dt)
    halving = [ripple[a] / ripple[b] for a, b in itertools.pairwise(STEPS)]
    # What the next power of the step changes in a ratio is a few ω dt.
    second = [8.0 * math.pi / period * dt for dt in STEPS[:-1]]
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
    limits: tuple[float, float, float],
    period: float,
) -> Iterator[Claim]:
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
        ("swing energy at t = 0", first, PUBLISHED[0]),
        (f"swing energy at t = {AUDIT:g} s", last, PUBLISHED[1]),
        ("difference", last - first, PUBLISHED[1] - PUBLISHED[0]),
        ("work of the three drives", float(trajectory.work[-1].sum()), PUBLISHED[2]),
        ("taken by joint damping", -float(trajectory.dissipated[-1]), None),
        ("unexplained", float(trajectory.unexplained[-1]), PUBLISHED[3]),
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


def _steps(
    ripple: Mapping[float, float], bands: Mapping[float, tuple[float, float, float]]
) -> ResultTable:
    return make_table(
        f"What the ledger leaves open over {LONG:g} s",
        ripple,
        ("dt [ms]", "g", lambda dt: 1000 * dt),
        ("at most [J]", ".3f", lambda dt: ripple[dt]),
        ("mean of the last swing [J]", "+.4f", lambda dt: bands[dt][0]),
        ("first swing from [J]", "+.3f", lambda dt: bands[dt][1]),
        ("to [J]", "+.3f", lambda dt: bands[dt][2]),
    )


def _ledger_figure(crane: Crane, trajectory: Trajectory) -> Figure:
    figure, (above, below) = panels(2, height=2.4, sharex=True)
    t = trajectory.t
    level = swing_energy(crane, trajectory)
    above.plot(t, level, color=COLOURS["energy"], label="ours")
    label = "article, with its plugin"
    colour = COLOURS["unexplained"]
    above.plot([0.0, AUDIT], PUBLISHED[:2], "x", color=colour, label=label)
    above.set(ylabel="swing energy [J]", ylim=(0, 1.1 * level[0]))
    below.plot(t, level - level[0], color=COLOURS["energy"], label="change of swing energy")
    for i, (drive, name) in enumerate({"gamma": "slew", "x": "trolley", "l": "hoist"}.items()):
        below.plot(t, trajectory.work[:, i], color=COLOURS[drive], label=f"work of {name}")
    below.plot(t, trajectory.unexplained, "--", color=colour, label="unexplained")
    below.set(xlabel="time [s]", ylabel="energy [J]")
    above.legend(loc="lower left")
    below.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.3))
    return figure


def _remainder_figure(steps: Mapping[float, Trajectory]) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    for (dt, trajectory), name in zip(steps.items(), ("x", "energy", "l"), strict=True):
        label = f"dt = {1000 * dt:g} ms"
        ax.plot(
            trajectory.t, trajectory.unexplained, color=COLOURS[name], linewidth=1.0, label=label
        )
    ax.set(xlabel="time [s]", ylabel="unexplained [J]")
    ax.legend(ncols=3, loc="upper right")
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
