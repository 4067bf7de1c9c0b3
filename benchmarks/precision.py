"""Batches in single precision beside those in doubles: how far they are apart, and how fast."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.kernel import Precision
from cranedyn.controllers import hold_controller
from cranedyn.export.usual_controllers import usual_controller
from cranedyn.interfaces import Controller, Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from experiments.harness.outcome import Outcome, ResultTable, show

DURATION = 60.0
"""Duration of each run [s]."""

_SWING = 0.3
"""Largest angle of the swings at the start [rad]."""


class PrecisionCase(NamedTuple):
    """Many cranes that move in both precisions.

    Attributes:
        name: What moves, in words.
        crane: The crane.
        controller: Its controller.
        drive: What it commands.
    """

    name: str
    crane: Crane
    controller: Controller
    drive: Drive


def cases() -> list[PrecisionCase]:
    """Return what is compared."""
    tower = load_crane()
    overhead = load_crane(XACRO.with_name("overhead_crane.urdf.xacro"))
    return [
        PrecisionCase("tower crane, drives held", tower, hold_controller(tower), "effort"),
        PrecisionCase("tower crane, LQR", tower, usual_controller("lqr", tower, 5e-3)[0], "effort"),
        PrecisionCase("overhead crane, drives held", overhead, hold_controller(overhead), "effort"),
    ]


def compare(case: PrecisionCase, count: int, duration: float) -> list[float | str]:
    """Return a row of the table: the name, the largest differences of drives that move along an
    axis [mm] and of swings [mrad] at the end, and million steps in a second of one processor in
    doubles and in single precision.

    Args:
        case: What moves.
        count: Number of cranes, which start at random places with random swings.
        duration: Duration of the runs [s].
    """
    crane = case.crane
    rng = np.random.default_rng(0)
    starts = []
    for _ in range(count):
        q = crane.start.q.copy()
        q[crane.swings] = rng.uniform(-_SWING, _SWING, len(crane.swings))
        starts.append(State(q, np.zeros_like(q)))
    batches: dict[Precision, Batch] = {}
    speeds: dict[Precision, float] = {}
    choices: tuple[Precision, ...] = ("double", "single")
    for precision in choices:
        # The first run compiles.
        for length in (0.01, duration):
            begin = time.process_time()
            batches[precision] = simulate_batch(
                crane,
                case.controller,
                start=starts,
                duration=length,
                drive=case.drive,
                threads=1,
                precision=precision,
            )
            seconds = time.process_time() - begin
        speeds[precision] = 1e-6 * count * duration / 5e-4 / seconds
    difference = np.abs(batches["single"].end.q - batches["double"].end.q).max(axis=0)
    slides = np.array([joint.kind == "prismatic" for joint in crane.layout.joints])
    return [
        case.name,
        1e3 * float(difference[slides].max()),
        1e3 * float(difference[crane.swings].max()),
        speeds["double"],
        speeds["single"],
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.precision", description=__doc__)
    parser.add_argument("--cranes", type=int, default=1024, help="(default 1024)")
    parser.add_argument("--seconds", type=float, default=DURATION, help="of a run (default 60)")
    options = parser.parse_args(argv)
    rows = [compare(case, options.cranes, options.seconds) for case in cases()]
    columns = [
        ("crane", ""),
        ("positions apart [mm]", ".4f"),
        ("swings apart [mrad]", ".4f"),
        ("M steps/s, double", ".0f"),
        ("M steps/s, single", ".0f"),
    ]
    title = f"{options.cranes} cranes after {options.seconds:g} s, on one processor"
    show(Outcome([ResultTable(title, columns, rows)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
