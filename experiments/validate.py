"""The plant against mechanics: closed forms beside runs of the plant, with the step's own error
known from halving it.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import replace

from cranedyn.checks import number
from cranedyn.model.crane import Crane
from cranedyn.model.description import parse_values
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, tabulate
from experiments.oracles import conserved, hoisting, moves, slewing, swing
from experiments.oracles.check import STEP, G, OracleCheck, check_oracle, point_crane
from experiments.oracles.reading import Bench, locked

PARTS = {
    "Locked drives": swing.oracles,
    "Running cable": hoisting.oracles,
    "Turning jib": slewing.oracles,
    "Moves of the trolley": moves.oracles,
    "What is conserved": conserved.oracles,
}
"""Titles of the tables and what makes their rows."""

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
    from cranedyn.recording import Run
    from experiments.oracles.figures import convergence_figure, oval_figure, ripple_figure

    halvings, spoilt = (
        int(number("halvings", options.halvings, "", "3 to 6")),
        parse_values(options.spoil),
    )

    def build(**values: object) -> Crane:
        return point_crane(**{**values, **spoilt})

    bench = Bench(build, setup.engine)
    telling = {
        "oval swing": (build(), swing.oval(build(), *swing.OVALS[1]), 90.0),
        "steady slewing": (*slewing.turning(build, *slewing.STEADY[0]), 75.0),
    }
    setup = replace(setup, dt=1e-3)
    mode = {"drive": "motion", "validity": "mark"}
    runs = {
        name: (
            crane,
            setup.simulate(
                crane, locked(crane), None, start=start, duration=end, label=name, **mode
            ),
        )
        for name, (crane, start, end) in telling.items()
    }
    results = checks(bench, halvings)
    all_checks = list(itertools.chain(*results.values()))
    tables = [oracle_table(title, rows) for title, rows in results.items()]
    return Outcome(
        tables=tables,
        claims=[*map(_claim, all_checks), _order(all_checks)],
        parameters={
            "closed_forms": len(all_checks),
            "gravity_m_s2": G,
            "coarsest_dt_s": STEP,
            "halvings": halvings,
            "spoilt": spoilt,
            "engine": setup.engine,
        },
        trajectories={name.replace(" ", "_"): run for name, (_, run) in runs.items()},
        figures={
            "convergence": convergence_figure(all_checks),
            "ripple": ripple_figure(bench, build()),
            "oval": oval_figure(runs["oval swing"][1]),
        },
        recording=[
            Run(name, crane, run, (100.0 * i, 0.0, 0.0))
            for i, (name, (crane, run)) in enumerate(runs.items())
        ],
    )


def oracle_table(title: str, checks: Sequence[OracleCheck]) -> ResultTable:
    """Return the table of one part of mechanics."""
    return tabulate(
        title,
        checks,
        [
            ("oracle", "", _named),
            ("closed form", ".10g", lambda c: c.oracle.closed),
            (f"dt = {1000 * checks[0].steps[-1]:g} ms", ".7g>1e-11", lambda c: c.values[-1]),
            ("error", "+.1e>1e-11", lambda c: c.error),
            ("of the step", "+.1e>1e-11", lambda c: c.of_step),
            ("rest within", ".0e", lambda c: c.allowed),
            ("order", ".2f", lambda c: c.order),
        ],
    )


def _named(check_run: OracleCheck) -> str:
    return (
        f"{check_run.oracle.name} [{check_run.oracle.unit}]"
        if check_run.oracle.unit
        else check_run.oracle.name
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
        f"{min(group):.3f} to {max(group):.3f} in {len(group)} rows"
        for group in (first, second)
        if group
    ]
    return Claim(
        "The error goes with the first power of the step, or where the step is symmetric with the "
        f"second: orders {', '.join(spans)}, within {ORDER:g} of whole numbers.",
        len(first) >= len(orders) / 2
        and len(first) + len(second) == len(orders)
        and all(abs(o - round(o)) < ORDER for o in orders),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "validate",
        "The plant against the closed forms of mechanics, its error for a vanishing step, and its "
        "order.",
    )
    text = f"how often the step of {1000 * STEP:g} ms is halved, 3 to 6"
    parser.add_argument("--halvings", type=int, default=4, metavar="N", help=text)
    text = (
        "change the cranes but not the closed forms, to see which rows notice; see python -m "
        "cranedyn.model.description --list"
    )
    parser.add_argument(
        "--spoil", nargs="+", action="extend", default=[], metavar="name:=value", help=text
    )
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
