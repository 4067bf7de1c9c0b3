"""The plant against the closed forms of mechanics, its error for a vanishing step, and its
order.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.checks import number
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import Crane
from cranedyn.model.options import parse_values
from cranedyn.plotting.figures import COLOURS, panels
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.oracles import conserved, ground, moves, slack, swings
from experiments.oracles.bench import (
    STEP,
    Bench,
    G,
    OracleCheck,
    check_oracle,
    locked,
    offset_from_plumb,
    point_crane,
)

PARTS = {
    "Locked drives": swings.locked_drives,
    "Running cable": swings.running_cable,
    "Turning jib": moves.turning_jib,
    "Moves of the trolley": moves.trolley_moves,
    "What is conserved": conserved.oracles,
    "Load on the ground": ground.box_on_ground,
}
"""Titles of the tables and what makes their rows."""

SWING = 0.5
"""Swing whose energy is shown to ripple [rad]."""

ORDER = 0.02
"""How far a measured order may be from a whole number."""


def checks(bench: Bench, halvings: int) -> dict[str, list[OracleCheck]]:
    """Run every oracle of every part."""
    return {
        title: [check_oracle(oracle, halvings) for oracle in oracles(bench)]
        for title, oracles in PARTS.items()
    }


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run the oracles, measure the order, record two telling runs."""
    halvings = int(number("halvings", options.halvings, "", "3 to 6"))
    spoilt = parse_values(options.spoil)

    def build(**values: object) -> Crane:
        return point_crane(**{**values, **spoilt})

    bench = Bench(build, setup.engine)
    telling = {
        "oval swing": (build(), swings.oval(build(), *swings.OVALS[1]), 90.0),
        "steady slewing": (*moves.turning(build, *moves.STEADY[0]), 75.0),
    }
    world = replace(setup, dt=1e-3, validity="mark")
    runs = {
        name: (
            crane,
            world.simulate(
                crane, locked(crane), None, start=start, duration=end, label=name, drive="motion"
            ),
        )
        for name, (crane, start, end) in telling.items()
    }
    results = checks(bench, halvings)
    all_checks = list(itertools.chain(*results.values()))
    tables = [oracle_table(title, rows) for title, rows in results.items()]
    slack_table, slack_claims, slack_forms = slack.study(bench)
    return Outcome(
        tables=[*tables, slack_table],
        claims=[*map(_claim, all_checks), _order(all_checks), *slack_claims],
        parameters={
            "closed_forms": len(all_checks) + slack_forms,
            "gravity_m_s2": G,
            "coarsest_dt_s": STEP,
            "halvings": halvings,
            "spoilt": spoilt,
            "engine": setup.engine,
        },
        trajectories={name.replace(" ", "_"): run for name, (_, run) in runs.items()},
        figures={
            "convergence": _convergence_figure(all_checks),
            "ripple": _ripple_figure(bench, build()),
            "oval": _oval_figure(runs["oval swing"][1]),
        },
        recording=harness.side_by_side(runs, apart=100.0),
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
        ("error of the step", "+.1e>1e-11", lambda c: c.of_step),
        ("remainder below", ".0e", lambda c: c.allowed),
        ("order", ".2f", lambda c: c.order),
    )


def _claim(check_run: OracleCheck) -> Claim:
    oracle = check_run.oracle
    why = f", {oracle.why} among it" if oracle.why else ""
    return Claim(
        f"{oracle.name}: {oracle.closed:.10g} {oracle.unit}".rstrip()
        + f" for a vanishing step within {check_run.allowed:.0e}{why}.",
        check_run.holds,
    )


def _order(checks_run: Sequence[OracleCheck]) -> Claim:
    orders = [c.order for c in checks_run if c.order is not None]
    first, second = ([order for order in orders if round(order) == power] for power in (1, 2))
    spans = [
        f"{min(rows):.3f} to {max(rows):.3f} in {len(rows)} rows"
        for rows in (first, second)
        if rows
    ]
    return Claim(
        "The error goes with the first power of the step, or where the step is symmetric with the "
        f"second: orders {', '.join(spans)}, within {ORDER:g} of whole numbers.",
        len(first) >= len(orders) / 2
        and len(first) + len(second) == len(orders)
        and all(abs(o - round(o)) < ORDER for o in orders),
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
    ax.legend()
    return figure


def _ripple_figure(bench: Bench, crane: Crane) -> Figure:
    """Draw the energy of a large swing in its plane, at three steps, each half of the one
    before.
    """
    figure, (ax,) = panels(1, height=3.2)
    for dt, colour in zip((0.02, 0.01, 0.005), ("x", "energy", "l"), strict=True):
        swing = bench.run(crane, crane.state(l=swings.LENGTH, phi=SWING), 30.0, dt)
        gain = swing.energy - swing.energy[0]
        label = f"dt = {1000 * dt:g} ms"
        ax.plot(swing.t, gain, color=COLOURS[colour], label=label)
    full = crane.payload_mass * crane.gravity * swings.LENGTH * (1.0 - np.cos(SWING))
    ax.set(xlabel="time [s]", ylabel=f"gain of energy [J] of {full:.0f} J")
    ax.legend(ncols=3, loc="upper right")
    return figure


def _oval_figure(trajectory: Trajectory) -> Figure:
    """Draw the load from above, and the far ends of its oval by the apsidal integral."""
    figure, (ax,) = panels(1, height=6.0, width=6.5)
    offset = offset_from_plumb(trajectory.q)
    far, near = swings.OVALS[1]
    turns = int(trajectory.t[-1] / theory.point_period(swings.LENGTH, G)) + 1
    angles = np.arctan2(offset[0, 1], offset[0, 0]) + theory.apsidal_precession(
        swings.LENGTH, far, near
    ) * np.arange(turns)
    ax.plot(*offset[:, :2].T, color=COLOURS["theta"], linewidth=0.8, label="load from above")
    ends = far * np.array([np.cos(angles), np.sin(angles)])
    label = "far ends by the integral"
    ax.plot(*ends, "o", color=COLOURS["x"], label=label)
    ax.set(xlabel="[m]", ylabel="[m]", aspect="equal")
    ax.legend(loc="upper right")
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


if __name__ == "__main__":
    sys.exit(main())
