"""The energy ledger: where every joule of a free swing goes, and that nothing vanishes."""

from __future__ import annotations

import argparse
import cmath
import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from cranedyn import theory
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.pinocchio import energy, payload_position
from cranedyn.errors import DataError, number
from cranedyn.interfaces import State, Validity
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.references import spline
from experiments import harness
from experiments.harness import Claim, Outcome, Setup, Table
from experiments.oracles.reading import locked

SWING, LENGTH, AUDIT, LONG = 0.15, 15.0, 6.0, 60.0
"""Swing at the start [rad], cable length [m], time of the audit and of the long run [s]."""

LEAST_SWING, ROUNDING = 0.001, 1e-13
"""Smallest swing at the start [rad], and smallest share of the energy that stands clear of its
rounding."""

STEPS = (1.0e-3, 5.0e-4, 2.5e-4)
DAMPINGS = (0.0, 1.0, 2.0e5)
"""Physics steps compared [s]; damping of the swing joints compared [N m s/rad]."""

PUBLISHED = (1651.8, 19.3, -30.7, -1601.8)
"""The article's ledger while a plugin overwrote its passive joints [J]: energy at 0 and 6 s, work
of the drives, unexplained."""


def run(setup: Setup, crane: Crane, swing: float, length: float, duration: float) -> Trajectory:
    """Let the load swing from rest [rad] on a cable [m] with the drives held."""
    start = crane.state(l=length, phi=swing)
    return setup.simulate(
        crane,
        hold_controller(crane),
        None,
        start=start,
        duration=duration,
        label=f"dt = {1000 * setup.dt:g} ms",
    )


def swing_energy(crane: Crane, trajectory: Trajectory) -> np.ndarray:
    """Mechanical energy above that of the load hanging at rest where the drives started [J], shape
    (n,).
    """
    rest = trajectory.q[0].copy()
    rest[crane.swings] = 0.0
    return trajectory.energy - energy(crane, State(rest, np.zeros_like(rest)))


def half_step(crane: Crane, trajectory: Trajectory, dt: float) -> float:
    """The most that the weight of the load works in half a step [J], by which positions are ahead
    of velocities.
    """
    height = np.array([payload_position(crane, q)[2] for q in trajectory.q])
    return (
        dt
        / 2.0
        * crane.payload_mass
        * crane.gravity
        * float(np.abs(np.gradient(height, trajectory.t)).max())
    )


def lowered(setup: Setup, length: float) -> tuple[float, float]:
    """Lower a plumb load by a tenth of the cable [m]: what the ledger leaves open at most, and what
    rounding may leave [J].

    No force depends on a velocity there and no inertia changes, so that the step keeps the balance
    of energy exactly, if positions are taken back by the half step that they are ahead of the
    velocities, in the energy here and in the work of the drives by the log.
    """
    crane = setup.variant(damp_slew=0, damp_trolley=0, damp_swing=0, damp_hoist=0)
    start = crane.state(l=length)
    reference = spline(
        crane,
        start,
        [(start.q[crane.layout.index("gamma")], start.q[crane.layout.index("x")], 1.1 * length)],
        [AUDIT],
    )
    made = setup.simulate(
        crane,
        hold_controller(crane),
        reference,
        start=start,
        duration=AUDIT,
        label="a plumb load lowered",
        validity="mark",
    )
    level = np.array(
        [
            energy(crane, State(q - setup.dt / 2.0 * v, v))
            for q, v in zip(made.q, made.v, strict=True)
        ]
    )
    left = level - level[0] - made.work.sum(axis=1)
    return float(np.abs(left).max()), math.sqrt(len(left)) * sys.float_info.epsilon * float(
        np.abs(level).max()
    )


def damped_share(crane: Crane, damping: float, length: float, t: float) -> float:
    """Energy left of a small swing from rest under joint damping d, drives fixed: the linear
    oscillator J φ̈ + d φ̇ + m g l φ = 0.
    """
    inertia = crane.payload_mass * length**2 + crane.payload_inertia[0, 0] + crane.dummy_inertia[0]
    omega2 = crane.payload_mass * crane.gravity * length / inertia
    decay = damping / (2.0 * inertia)
    omega = cmath.sqrt(omega2 - decay**2)  # imaginary beyond critical damping
    swing = cmath.exp(-decay * t) * (cmath.cos(omega * t) + decay / omega * cmath.sin(omega * t))
    rate = -cmath.exp(-decay * t) * omega2 / omega * cmath.sin(omega * t)
    return (swing**2 + rate**2 / omega2).real


def locked_off(setup: Setup, crane: Crane, swing: float, length: float) -> tuple[float, float]:
    """How far a swing with the drives locked is from the damped pendulum, and how far the step lets
    it be.

    Args:
        setup: Its clocks.
        crane: The crane.
        swing: At the start [rad].
        length: Of the cable [m].

    Returns:
        Largest difference in energy up to the time of the audit, and that of semi-implicit Euler
        for a swing without damping, ω dt/2; both as shares of the energy at the start.
    """
    weight, inertia = crane.payload_mass * crane.gravity * length, crane.payload_mass * length**2
    inertia += crane.payload_inertia[0, 0] + crane.dummy_inertia[0]

    damping = float(crane.damping[crane.layout.index("phi")])

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -(damping * y[1] + weight * math.sin(y[0])) / inertia]

    # Locked drives need no buffers.
    validity: Validity = "stop" if setup.validity == "buffers" else setup.validity
    run = setup.simulate(
        crane,
        locked(crane),
        None,
        start=crane.state(l=length, phi=swing),
        duration=AUDIT,
        drive="motion",
        validity=validity,
        label="drives locked",
    )
    phi, rate = solve_ivp(
        rates,
        (0.0, AUDIT),
        [swing, 0.0],
        method="DOP853",
        t_eval=run.t,
        rtol=1e-10,
        atol=1e-12 * swing,
    ).y
    pendulum, ours = (
        inertia * rate**2 / 2.0 + 2.0 * weight * np.sin(phi / 2.0) ** 2,
        swing_energy(crane, run),
    )
    return float(np.abs(ours - pendulum).max() / pendulum[0]), math.sqrt(
        weight / inertia
    ) * setup.dt / 2.0


def band(trajectory: Trajectory, period: float) -> tuple[float, float, float]:
    """What is unexplained: its mean over the last swing, and the least and the most of it in the
    first swing [J].

    Over a whole period [s] the ripple, which follows the swing, cancels in the mean. A steady gain
    or loss carries the mean out of the band of the first swing; a ripple that decays with the swing
    does not.
    """
    t, left = trajectory.t, trajectory.unexplained
    first = left[t <= t[0] + period]
    return float(left[t >= t[-1] - period].mean()), float(first.min()), float(first.max())


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Audit the swing, vary the damping, halve the step, look whether it runs away."""
    from cranedyn.recording import Run

    swing, length = (
        number("swing", options.swing, "rad", f"{LEAST_SWING:g} to {math.pi / 2:.4f}"),
        options.length,
    )
    if getattr(options, "overwritten", False):
        from experiments.energy.overwritten import experiment as overwritten

        return overwritten(setup, swing, length)
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
    period = theory.rigid_period(
        length, crane.gravity, crane.payload_mass, crane.payload_inertia[0, 0]
    ) * float(theory.amplitude_factor(swing))
    bands = {dt: band(r, period) for dt, r in steps.items()}
    mean, least, most = bands[5e-4]
    ours = audits[1.0]
    worst = float(np.abs(ours.unexplained).max())
    lead = half_step(crane, ours, setup.dt)
    halving = [ripple[a] / ripple[b] for a, b in itertools.pairwise(STEPS)]
    # What the next power of the step changes in a ratio is a few ω dt.
    second = [8.0 * math.pi / period * dt for dt in STEPS[:-1]]
    exact, rounding = lowered(setup, length)
    left = {d: float(swing_energy(cranes[d], r)[-1]) for d, r in audits.items()}
    expected = {d: damped_share(c, d, length, AUDIT) for d, c in cranes.items()}
    first = float(swing_energy(crane, ours)[0])
    off, allowed = locked_off(setup, cranes[DAMPINGS[2]], swing, length)
    return Outcome(
        tables=[
            _ledger(crane, ours),
            _dampings(audits, left, expected, first),
            _steps(ripple, bands),
        ],
        claims=[
            Claim(
                f"Nothing vanishes: of {first:.1f} J the ledger leaves {worst:.3f} J open at most "
                f"at dt = {1000 * setup.dt:g} ms, what the weight works in the half step by which "
                f"positions are ahead of velocities ({lead:.3f} J), within 1 %.",
                worst < 1.01 * lead,
            ),
            Claim(
                f"What stays open halves with the step: ratios {halving[0]:.5f} and "
                f"{halving[1]:.5f}, 2 within {second[0]:.5f} and {second[1]:.5f}, 4 ω dt.",
                all(
                    abs(ratio - 2.0) < allowed
                    for ratio, allowed in zip(halving, second, strict=True)
                ),
            ),
            Claim(
                "Where the step is exact, a plumb load being lowered, the work of the drives "
                f"closes the ledger to {exact:.0e} J, rounding being {rounding:.0e} J.",
                exact <= rounding,
            ),
            Claim(
                f"It does not run away: its mean over the last swing in {LONG:g} s, {mean:+.4f} J, "
                f"lies in what the first swing spans, {least:+.2f} to {most:+.2f} J.",
                least <= mean <= most if 2.0 * period < LONG else None,
            ),
            Claim(
                "Damping acts: with 2e5 N m s/rad and the drives locked, the energy is that of the "
                f"damped pendulum at every time up to {AUDIT:g} s, off by {off:.1e} of the start "
                f"at most, within {allowed:.1e}, which is ω dt/2.",
                off < allowed,
            ),
        ],
        parameters=setup.parameters() | {"swing_rad": swing, "length_m": length},
        trajectories={f"energy_damp_{d:g}": r for d, r in audits.items()}
        | {f"energy_dt_{1e6 * dt:.0f}us": r for dt, r in steps.items()},
        figures={"ledger": _ledger_figure(crane, ours), "remainder": _remainder_figure(steps)},
        recording=[
            Run(f"damping {d:g} N m s/rad", cranes[d], r, (20.0 * i, 0.0, 0.0))
            for i, (d, r) in enumerate(audits.items())
        ],
    )


def _ledger(crane: Crane, trajectory: Trajectory) -> Table:
    kept = swing_energy(crane, trajectory)
    first, last, drives, lost = (
        float(kept[0]),
        float(kept[-1]),
        float(trajectory.work[-1].sum()),
        float(trajectory.unexplained[-1]),
    )
    rows = [
        ("swing energy at t = 0", first, PUBLISHED[0]),
        (f"swing energy at t = {AUDIT:g} s", last, PUBLISHED[1]),
        ("difference", last - first, PUBLISHED[1] - PUBLISHED[0]),
        ("work of the three drives", drives, PUBLISHED[2]),
        ("taken by joint damping", -float(trajectory.dissipated[-1]), None),
        ("unexplained", lost, PUBLISHED[3]),
    ]
    note = (
        "The article's column is its ledger of a 0.15 rad swing on 15 m of cable, while a "
        "plugin overwrote the passive joints."
    )
    return Table(
        f"Energy of a {trajectory['phi_rad'][0]:g} rad swing on {trajectory['l_m'][0]:g} m of "
        "cable",
        [("[J]", ""), ("ours", "+.2f"), ("article", "+.1f")],
        rows,
        note,
    )


def _dampings(
    audits: Mapping[float, Trajectory],
    left: Mapping[float, float],
    expected: Mapping[float, float],
    first: float,
) -> Table:
    rows = [
        (
            d,
            left[d],
            expected[d] * first,
            float(r.dissipated[-1]),
            float(r.work[-1].sum()),
            float(np.abs(r.unexplained).max()),
        )
        for d, r in audits.items()
    ]
    columns = [
        ("damp_swing [N m s/rad]", "g"),
        ("energy left [J]", ".2f"),
        ("closed form, fixed pivot [J]", ".2f"),
        ("dissipated [J]", ".3f"),
        ("drives [J]", "+.2f"),
        ("open, at most [J]", ".2f"),
    ]
    return Table(
        f"Damping of the swing joints, after {AUDIT:g} s",
        columns,
        rows,
        "The closed form has no drives; the work of the hoist is the difference. The article was "
        "left with 19.3 J.",
    )


def _steps(
    ripple: Mapping[float, float], bands: Mapping[float, tuple[float, float, float]]
) -> Table:
    rows = [(1000 * dt, ripple[dt], *bands[dt]) for dt in ripple]
    columns = [
        ("dt [ms]", "g"),
        ("at most [J]", ".3f"),
        ("mean of the last swing [J]", "+.4f"),
        ("first swing from [J]", "+.3f"),
        ("to [J]", "+.3f"),
    ]
    return Table(f"What the ledger leaves open over {LONG:g} s", columns, rows)


def _ledger_figure(crane: Crane, trajectory: Trajectory) -> Figure:
    figure, (above, below) = panels(2, height=2.4, sharex=True)
    kept = swing_energy(crane, trajectory)
    above.plot(trajectory.t, kept, color=COLOURS["energy"], label="ours")
    above.plot(
        [0.0, AUDIT],
        PUBLISHED[:2],
        "x",
        color=COLOURS["unexplained"],
        label="article, with its plugin",
    )
    above.set(ylabel="swing energy [J]", ylim=(0, 1.1 * kept[0]))
    below.plot(
        trajectory.t, kept - kept[0], color=COLOURS["energy"], label="change of swing energy"
    )
    for i, (drive, name) in enumerate({"gamma": "slew", "x": "trolley", "l": "hoist"}.items()):
        below.plot(
            trajectory.t, trajectory.work[:, i], color=COLOURS[drive], label=f"work of {name}"
        )
    below.plot(
        trajectory.t,
        trajectory.unexplained,
        "--",
        color=COLOURS["unexplained"],
        label="unexplained",
    )
    below.set(xlabel="time [s]", ylabel="energy [J]")
    above.legend(loc="lower left")
    below.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.3))
    return figure


def _remainder_figure(steps: Mapping[float, Trajectory]) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    for (dt, trajectory), colour in zip(
        steps.items(), (COLOURS["x"], COLOURS["energy"], COLOURS["l"]), strict=True
    ):
        ax.plot(
            trajectory.t,
            trajectory.unexplained,
            color=colour,
            linewidth=1.0,
            label=f"dt = {1000 * dt:g} ms",
        )
    ax.set(xlabel="time [s]", ylabel="unexplained [J]")
    ax.legend(ncols=3, loc="upper right")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "energy", "The energy ledger of a free swing: drives, damping, and what is left open."
    )
    harness.add_setup(parser, "damp_swing", "hoist_init")
    parser.add_argument(
        "--swing", type=float, default=SWING, metavar="PHI", help="radial swing at the start [rad]"
    )
    parser.add_argument(
        "--length", type=float, default=LENGTH, metavar="L", help="cable length [m]"
    )
    parser.add_argument(
        "--overwritten",
        action="store_true",
        help="what a plugin that overwrites the passive rates does to the swing",
    )
    return harness.run_experiment(parser, experiment, argv)
