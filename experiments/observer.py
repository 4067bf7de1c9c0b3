"""Loads and cables that the controller does not know, over a grid.

What a flat move leaves then, by three sets of sensors.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cranedyn.command import interrupted
from cranedyn.errors import CraneError
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.plotting.style import run_colour
from experiments import harness
from experiments.compare.claims import MAX_UNSEEN_SWING
from experiments.harness import (
    Claim,
    Column,
    Outcome,
    ProgressReporter,
    ResultTable,
    Setup,
    finite_or_none,
    make_table,
)
from experiments.scenarios.moves import COMBINED
from experiments.scenarios.perturbations import AFTER_UNTOLD, Perturbation, make
from experiments.scenarios.strategies import FLAT, STRATEGIES

LOADS = (0.5, 1.0, 1.5)
"""Masses of the load over the planned one."""

CABLES = (-0.1, 0.0, 0.1)
"""Relative errors of the measured cable length: the cable is longer by this share."""

SENSORS = ("drives", "swing", "imu")
"""See `cranedyn.estimation.load_filter.Sensors`."""

KINDS = ("share", "offset")
"""Whether a cable is longer by a share of what is read, or by the same everywhere: that share of
its length at the start."""


class GridCase(NamedTuple):
    """A place in the grid.

    Attributes:
        sensors: What is measured, one of `SENSORS`.
        kind: How the cable is off, one of `KINDS`.
        load: Mass of the load over the planned one.
        cable: Relative error of the measured cable length.
    """

    sensors: str
    kind: str
    load: float
    cable: float

    def perturbation(self) -> Perturbation:
        """Return the case as a perturbation of the planned move."""
        return Perturbation(
            str(tuple(self)),
            load=self.load,
            cable=self.cable if self.kind == "share" else 0.0,
            offset=0.0 if self.kind == "share" else self.cable * COMBINED.start[2],
            observer=self.sensors,  # type: ignore[arg-type]
        )


Swings = Mapping[GridCase, float]
"""Swing at the arrival [rad]; infinite where the run breaks off."""


def residual_swings(setup: Setup, sensors: Sequence[str]) -> Swings:
    """Make the combined move in every case of the grid, by several sets of sensors."""
    plan = STRATEGIES[FLAT](setup, COMBINED)
    cases = []
    for case in itertools.starmap(GridCase, itertools.product(sensors, KINDS, LOADS, CABLES)):
        # A cable that is as recorded is the same case whatever the kind.
        if case.cable or case.kind == KINDS[0]:
            cases.append(case)
    update = setup.reporter.count("observer", len(cases))
    quiet = replace(setup, reporter=ProgressReporter())
    swings = {}
    for done, case in enumerate(cases, start=1):
        try:
            _, score = make(quiet, COMBINED, plan, case.perturbation(), after=AFTER_UNTOLD)
            swings[case] = score.arrival
        except CraneError as error:
            if interrupted(error):
                raise
            swings[case] = math.inf
        update(done)
    return swings


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Make the combined move over the grid and see what is left."""
    swings = residual_swings(setup, options.sensors)
    claims = []
    for sensors in options.sensors:
        of_sensors = [case for case in swings if case.sensors == sensors]
        worst = max(of_sensors, key=lambda case: swings[case])
        claims.append(
            Claim(
                f"By the sensors “{sensors}” {1e3 * MAX_UNSEEN_SWING:g} mrad are left at the "
                f"arrival at most over the whole grid: {1e3 * swings[worst]:.3f} mrad with "
                f"{100 * worst.load:g} % of the load and {100 * worst.cable:+g} % of cable "
                f"({worst.kind}).",
                swings[worst] <= MAX_UNSEEN_SWING,
            )
        )
    return Outcome(
        tables=[_table(swings)],
        claims=claims,
        parameters={"loads": LOADS, "cables": CABLES},
        figures={"left": _figure(swings)},
    )


def _table(swings: Swings) -> ResultTable:
    def swing(sensors_kind: tuple[str, str], load: float, cable: float) -> float | None:
        sensors, kind = sensors_kind
        case = GridCase(sensors, kind, load, cable)
        return finite_or_none(1e3 * swings.get(case, math.inf))

    columns: list[Column] = []
    for load, cable in itertools.product(LOADS, CABLES):
        header = f"{100 * load:g} %, {100 * cable:+g} %"
        columns.append((header, ".3g", partial(swing, load=load, cable=cable)))
    return make_table(
        "Swing at the arrival, flat + LQR, load and cable unknown [mrad]",
        dict.fromkeys((case.sensors, case.kind) for case in swings),
        ("sensors, cable off by", "", ", ".join),
        *columns,
        note="Columns: load over the planned one, error of the cable. A dash: the run diverged, "
        "or the cable is as recorded and stands one row above.",
    )


def _figure(swings: Swings) -> Figure:
    figure, (ax,) = panels(height=3.4)
    for k, sensors in enumerate(dict.fromkeys(case.sensors for case in swings)):
        values = [value for case, value in swings.items() if case.sensors == sensors]
        ax.plot(
            1e3 * np.sort(np.array(values)),
            np.arange(1, len(values) + 1) / len(values),
            drawstyle="steps-post",
            color=run_colour(k),
            label=sensors,
        )
    ax.axvline(1e3 * MAX_UNSEEN_SWING, linestyle=":", color="#999999")
    ax.set(xscale="log", xlabel="swing at the arrival [mrad]", ylabel="share of the grid")
    legend_above(ax)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("observer", __doc__, recording=False, engines=("compiled", "pinocchio"))
    harness.add_setup(parser, "payload_mass")
    parser.add_argument(
        "--sensors", nargs="+", choices=SENSORS, default=list(SENSORS), help="what is measured"
    )
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
