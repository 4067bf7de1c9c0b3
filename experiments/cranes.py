"""Cranes of other topology: closed forms, three engines, energy, and control on each.

Hook and slung load, rope, tower and jib that give, overhead crane, and robots that are no cranes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from experiments import harness
from experiments.harness import Outcome, Setup
from experiments.relatives import agreement, control, modes, pendulum, robots, rope

STUDIES = (modes, rope, agreement, control, pendulum, robots)
"""What is made with the cranes, each part with its tables and claims."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run all cranes: frequencies, ropes, agreement, control, the double pendulum, and robots."""
    update = setup.reporter.count("parts", len(STUDIES))
    outcomes = list[Outcome]()
    for study in STUDIES:
        outcomes.append(study.study(setup))
        update(len(outcomes))
    return Outcome(
        tables=[table for outcome in outcomes for table in outcome.tables],
        claims=[claim for outcome in outcomes for claim in outcome.claims],
        parameters={
            "swing_rad": control.SWING,
            "way_m": control.WAY,
            "wind_m_s": control.GUST,
            "drag_area_m2": control.AREA,
            "duration_s": agreement.DURATION,
            "engine": setup.engine,
        },
        trajectories={
            name: run for outcome in outcomes for name, run in outcome.trajectories.items()
        },
        recording=[run for outcome in outcomes for run in outcome.recording],
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("cranes", __doc__)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
