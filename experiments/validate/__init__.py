"""The plant against the closed forms of mechanics, its error for a vanishing step, and its
order.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.checks import number
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.options import parse_values
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.validate import (
    box_on_ground,
    conserved,
    locked_drives,
    running_cable,
    slack_rope,
    trolley_moves,
    turning_jib,
)
from experiments.validate.bench import Bench, G, point_crane
from experiments.validate.oracle import STEP, OracleCheck, check_oracle
from experiments.validate.reading import offset_from_plumb

PARTS = {
    "Locked drives": locked_drives.oracles,
    "Running cable": running_cable.oracles,
    "Turning jib": turning_jib.oracles,
    "Moves of the trolley": trolley_moves.oracles,
    "What is conserved": conserved.oracles,
    "Load on the ground": box_on_ground.oracles,
}
"""Functions that return the oracles of one part of mechanics, by the title of its table."""

RIPPLE_SWING = 0.5
"""Amplitude of the swing whose energy is drawn at several steps [rad]."""

RECORDED_STEP = 1e-3
"""Step of the two runs that are recorded [s]."""

ORDER_TOLERANCE = 0.02
"""How far a measured order may be from a whole number."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Check the oracles, measure the order of the step, and record two runs."""
    halvings = int(number("halvings", options.halvings, "", "3 to 6"))
    spoilt = parse_values(options.spoil)

    def build(**values: object) -> Crane:
        return point_crane(**{**values, **spoilt})

    bench = Bench(build, setup.engine)

    # The oracles, part by part.
    show_done = setup.reporter.count("parts of mechanics", len(PARTS) + 1)
    tables = []
    checks = []
    for done, (title, oracles) in enumerate(PARTS.items(), start=1):
        checks_of_part = [check_oracle(oracle, halvings) for oracle in oracles(bench)]
        tables.append(oracle_table(title, checks_of_part))
        checks += checks_of_part
        show_done(done)
    slack_checks = [slack_rope.check_slack_oracle(oracle) for oracle in slack_rope.oracles(bench)]
    tables.append(slack_rope.slack_table(slack_checks))
    show_done(len(PARTS) + 1)

    # Two runs for the recording.
    crane = build()
    settling_crane, plumb = turning_jib.turning(build, turning_jib.STEADY[0])
    oval_run = _recorded_run(
        setup, "oval swing", crane, locked_drives.oval(crane, *locked_drives.OVALS[1]), 90.0
    )
    slewing_run = _recorded_run(setup, "steady slewing", settling_crane, plumb, 75.0)

    return Outcome(
        tables=tables,
        claims=[
            *(oracle_claim(check) for check in checks),
            _order_claim(checks),
            *(slack_rope.slack_claim(check) for check in slack_checks),
            slack_rope.ledger_of_rk4(bench),
            slack_rope.ledger_of_semi_implicit_euler(bench),
        ],
        parameters={
            "closed_forms": len(checks) + len(slack_checks),
            "gravity_m_s2": G,
            "coarsest_dt_s": STEP,
            "halvings": halvings,
            "spoilt": spoilt,
            "engine": setup.engine,
        },
        trajectories={"oval_swing": oval_run, "steady_slewing": slewing_run},
        figures={
            "convergence": _convergence_figure(checks),
            "ripple": _ripple_figure(bench, crane),
            "oval": _oval_figure(oval_run),
        },
        recording=harness.side_by_side(
            {"oval swing": (crane, oval_run), "steady slewing": (settling_crane, slewing_run)},
            apart=100.0,
        ),
    )


def _recorded_run(
    setup: Setup, label: str, crane: Crane, start: State, duration: float
) -> Trajectory:
    """Run a crane whose drives keep their speed for a duration [s], for the recording."""
    return replace(setup, dt=RECORDED_STEP, validity="mark").simulate(
        crane,
        zero_command(crane),
        None,
        start=start,
        duration=duration,
        label=label,
        drive="motion",
    )


def oracle_table(title: str, checks: Sequence[OracleCheck]) -> ResultTable:
    """Return the table of one part of mechanics."""
    return make_table(
        title,
        checks,
        ("quantity", "", lambda c: f"{c.oracle.name} [{c.oracle.unit}]".removesuffix(" []")),
        ("closed form", ".10g", lambda c: c.oracle.closed),
        (f"dt = {1000 * checks[0].steps[-1]:g} ms", ".7g>1e-11", lambda c: c.values[-1]),
        ("error", "+.1e>1e-11", lambda c: c.error),
        ("error of the step", "+.1e>1e-11", lambda c: c.step_error),
        ("remainder below", ".0e", lambda c: c.allowed),
        ("order", ".2f", lambda c: c.order),
    )


def oracle_claim(check: OracleCheck) -> Claim:
    """Return the claim that a run has the closed form for a vanishing step."""
    oracle = check.oracle
    why = f", {oracle.reason} among it" if oracle.reason else ""
    return Claim(
        f"{oracle.name}: {oracle.closed:.10g} {oracle.unit}".rstrip()
        + f" for a vanishing step within {check.allowed:.0e}{why}.",
        check.holds,
    )


def _order_claim(checks: Sequence[OracleCheck]) -> Claim:
    """Return the claim on the power of the step with which errors fall."""
    orders = [check.order for check in checks if check.order is not None]
    of_first_power = [order for order in orders if round(order) == 1]
    of_second_power = [order for order in orders if round(order) == 2]
    spans = []
    for group in (of_first_power, of_second_power):
        if group:
            spans.append(f"{min(group):.3f} to {max(group):.3f} in {len(group)} rows")
    are_whole = all(abs(order - round(order)) < ORDER_TOLERANCE for order in orders)
    none_is_other = len(of_first_power) + len(of_second_power) == len(orders)
    return Claim(
        "The error goes with the first power of the step, or where the step is symmetric with the "
        f"second: orders {', '.join(spans)}, within {ORDER_TOLERANCE:g} of whole numbers.",
        len(of_first_power) >= len(orders) / 2 and none_is_other and are_whole,
    )


def _convergence_figure(checks: Sequence[OracleCheck]) -> Figure:
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
    legend_above(ax)
    return figure


def _ripple_figure(bench: Bench, crane: Crane) -> Figure:
    """Draw the energy of a large swing in its plane, at three steps, each half of the one
    before.
    """
    figure, (ax,) = panels(1, height=3.2)
    for dt, colour in zip((0.02, 0.01, 0.005), ("x", "energy", "l"), strict=True):
        swing = bench.run(crane, crane.state(l=locked_drives.LENGTH, phi=RIPPLE_SWING), 30.0, dt)
        gain = swing.energy - swing.energy[0]
        label = f"dt = {1000 * dt:g} ms"
        ax.plot(swing.t, gain, color=COLOURS[colour], label=label)
    full = crane.payload_mass * crane.gravity * locked_drives.LENGTH * (1.0 - np.cos(RIPPLE_SWING))
    ax.set(xlabel="time [s]", ylabel=f"gain of energy [J] of {full:.0f} J")
    legend_above(ax, columns=3)
    return figure


def _oval_figure(trajectory: Trajectory) -> Figure:
    """Draw the load from above, and the far ends of its oval by the apsidal integral."""
    figure, (ax,) = panels(1, height=6.0, width=6.5)
    offset = offset_from_plumb(trajectory.q)
    far, near = locked_drives.OVALS[1]
    turns = int(trajectory.t[-1] / theory.point_period(locked_drives.LENGTH, G)) + 1
    # A far end turns by the same angle in every revolution of the load.
    first_angle = np.arctan2(offset[0, 1], offset[0, 0])
    precession = theory.apsidal_precession(locked_drives.LENGTH, far, near)
    angles = first_angle + precession * np.arange(turns)
    ax.plot(
        offset[:, 0], offset[:, 1], color=COLOURS["theta"], linewidth=0.8, label="load from above"
    )
    ax.plot(
        far * np.cos(angles),
        far * np.sin(angles),
        "o",
        color=COLOURS["x"],
        label="far ends by the integral",
    )
    ax.set(xlabel="[m]", ylabel="[m]", aspect="equal")
    legend_above(ax)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("validate", __doc__)
    text = f"how often the step of {1000 * STEP:g} ms is halved, 3 to 6"
    parser.add_argument("--halvings", type=int, default=4, metavar="N", help=text)
    text = (
        "change the cranes but not the closed forms, to see which rows notice; see cranedyn "
        "describe --list"
    )
    parser.add_argument(
        "--spoil", nargs="+", action="extend", default=[], metavar="name:=value", help=text
    )
    return harness.run_experiment(parser, experiment, argv)
