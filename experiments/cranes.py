"""Cranes of other topology: hook and slung load, rope, tower and jib that give, overhead crane;
what is made for any crane, on each.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from experiments import harness
from experiments.harness import Outcome, Setup
from experiments.relatives import claims, modes, pendulum, robots, rope, tables
from experiments.relatives.agreement import DURATION, compare_engines
from experiments.relatives.catalogue import RELATIVES, relative_crane
from experiments.relatives.control import AREA, GUST, SWING, WAY, run_controllers

_SHAPED = f"Trolley at {pendulum.NUDGE:g} m/s; closed: by the swing that the move leaves unshaped."

SITES = ((0.0, 0.0), (40.0, 0.0), (80.0, 0.0), (0.0, -60.0), (40.0, -60.0), (75.0, -40.0))
"""Where the cranes stand in the recording [m]."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run all cranes: frequencies, ropes, agreement, control, and the double pendulum."""
    from cranedyn.recording import Run

    done = setup.reporter.count("cranes", 4 + 2 * len(RELATIVES))
    frequencies, jumps = modes.frequencies(setup.engine), rope.jumps(setup.engine)
    done(2)
    agreed = []
    for i, relative in enumerate(RELATIVES):
        agreed.append(compare_engines(relative))
        done(3 + i)
    controlled = []
    for i, relative in enumerate(RELATIVES):
        controlled.append(run_controllers(relative, setup.engine))
        done(3 + len(RELATIVES) + i)
    shaped, moved, growth = (
        pendulum.shaping(setup.engine),
        list(pendulum.trolley_moves(setup.engine)),
        pendulum.closed_loop_growth(),
    )
    stirred = pendulum.stirred(setup.engine)
    machines = robots.robots()
    done(4 + 2 * len(RELATIVES))
    return Outcome(
        tables=[
            tables.frequency_table(frequencies),
            tables.jump_table(jumps),
            tables.agreement_table(agreed),
            tables.control_table(controlled),
            tables.residual_table("Double pendulum: shaped moves of an operator", shaped, _SHAPED),
            tables.residual_table(
                f"Double pendulum: {pendulum.WAY:g} m of the trolley",
                moved,
                tables.unaware_note(growth),
            ),
            tables.robot_table(machines),
        ],
        claims=[
            *claims.of_frequencies(frequencies),
            *claims.of_jumps(jumps),
            *claims.of_agreement(agreed),
            *claims.of_control(controlled),
            *claims.of_pendulum(shaped, moved, growth, stirred),
            *claims.of_robots(machines),
        ],
        parameters={
            "swing_rad": SWING,
            "way_m": WAY,
            "wind_m_s": GUST,
            "drag_area_m2": AREA,
            "duration_s": DURATION,
            "engine": setup.engine,
        },
        trajectories={
            relative.name.replace(" ", "_"): result.run
            for relative, result in zip(RELATIVES, agreed, strict=True)
        }
        | {"double_pendulum_unaware": moved[-1].run},
        recording=[
            Run(result.relative.name, relative_crane(result.relative), result.run, (*site, 0.0))
            for site, result in zip(SITES, agreed, strict=True)
        ],
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "cranes",
        "Cranes of other topology: closed forms, three engines, energy, and control on each.",
    )
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
