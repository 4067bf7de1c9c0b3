"""Cranes of other topology: closed forms, three engines, energy, and control on each.

Hook and slung load, rope, tower and jib that give, overhead crane, and robots that are no cranes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from experiments import harness
from experiments.cranes import (
    agreement,
    control_of_variants,
    double_pendulum,
    elastic_rope,
    modes,
    robots,
)
from experiments.harness import Claim, Outcome, ResultTable, Setup

if TYPE_CHECKING:
    from cranedyn.recording import Run

STUDIES = (modes, elastic_rope, agreement, control_of_variants, double_pendulum, robots)
"""The parts of the experiment, each with tables and claims of its own."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run all cranes: frequencies, ropes, agreement, control, the double pendulum, and robots."""
    update = setup.reporter.count("parts", len(STUDIES))
    tables: list[ResultTable] = []
    claims: list[Claim] = []
    trajectories = {}
    recording: list[Run] = []
    for done, study in enumerate(STUDIES, start=1):
        outcome = study.study(setup)
        tables += outcome.tables
        claims += outcome.claims
        trajectories.update(outcome.trajectories)
        recording += outcome.recording
        update(done)
    return Outcome(
        tables=tables,
        claims=claims,
        parameters={
            "swing_rad": control_of_variants.SWING,
            "way_m": control_of_variants.TRAVEL,
            "wind_m_s": control_of_variants.WIND_SPEED,
            "drag_area_m2": control_of_variants.DRAG_AREA,
            "duration_s": agreement.DURATION,
            "engine": setup.engine,
        },
        trajectories=trajectories,
        recording=recording,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("cranes", __doc__)
    return harness.run_experiment(parser, experiment, argv)
