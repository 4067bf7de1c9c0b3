"""Lift-off and set-down: what they do to the rope and to the swing.

A box stands on the ground with a slack rope, the hoist already turns, and the rope takes the box
up; or the box hangs and is set down. Drives follow their motion exactly.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from experiments import harness
from experiments.harness import Outcome, Setup
from experiments.liftoff.box_results import (
    lift_off_figure,
    off_lead_table,
    other_claims,
    pick_up_claims,
    pick_up_table,
    set_down_table,
    slide_claim,
    slide_table,
)
from experiments.liftoff.box_runs import off_lead_lift, pick_up, roped_crane, set_down, slide

DRIVES: tuple[DriveClass, ...] = ("HD1", "HD2", "HD4")
"""Drive classes that differ in the speed of lift-off."""

CLASSES: tuple[HoistingClass, ...] = ("HC1", "HC2", "HC3", "HC4")
"""Hoisting classes."""

OFFSETS = (0.1, 0.5, 1.0, 2.0)
"""Distances of the trolley from above the box in lifts off-lead [m]."""

FRICTIONS = (0.2, 0.6)
"""Coefficients of friction of the ground."""

OFF_LEAD_SPEEDS = (0.05, 0.2)
"""Hoisting speeds of lifts off-lead [m/s]."""

SINK_RATES = (0.05, 0.1, 0.2, 0.4)
"""Speeds of setting down [m/s]."""

THROWN_SPEEDS = (0.5, 1.5)
"""Speeds of a box on the ground below a slack rope, which friction alone brings to rest [m/s]."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Lift the box off and set it down in all ways."""
    picked = []
    for hoisting, drive in itertools.product(CLASSES, DRIVES):
        picked.append(pick_up(setup, hoisting, drive))
    leaning = []
    for friction, offset, speed in itertools.product(FRICTIONS, OFFSETS, OFF_LEAD_SPEEDS):
        leaning.append(off_lead_lift(setup, friction, offset, speed))
    slides = []
    for friction, speed in itertools.product(FRICTIONS, THROWN_SPEEDS):
        slides.append(slide(setup, friction, speed))
    lowered = [set_down(setup, speed) for speed in SINK_RATES]
    worst = max(leaning, key=lambda lift: lift.swing / lift.lead)
    return Outcome(
        tables=[
            pick_up_table(picked),
            off_lead_table(leaning),
            slide_table(slides),
            set_down_table(lowered),
        ],
        claims=[*pick_up_claims(picked), slide_claim(slides), *other_claims(worst, lowered)],
        trajectories={"off_lead": worst.run},
        figures={"lift_off": lift_off_figure(picked)},
        recording=harness.side_by_side({"off-lead": (roped_crane(setup), worst.run)}, apart=0.0),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("liftoff", __doc__, engines=("compiled",))
    return harness.run_experiment(parser, experiment, argv)
