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

import numpy as np
from matplotlib.figure import Figure

from cranedyn.command import interrupted
from cranedyn.errors import CraneError
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import run_colour
from experiments import harness
from experiments.compare.claims import LEFT
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


Cases = Mapping[tuple[str, str, float, float], float]
"""Swing at the arrival [rad] by sensors, kind, load and cable; inf where the run breaks off."""


def residual_swings(setup: Setup, sensors: Sequence[str]) -> Cases:
    """Make every move."""
    plan = STRATEGIES[FLAT](setup, COMBINED)
    cases = [
        (sensors_used, kind, load, cable)
        for sensors_used, kind, load, cable in itertools.product(sensors, KINDS, LOADS, CABLES)
        if cable or kind == KINDS[0]
    ]
    update = setup.reporter.count("observer", len(cases))
    alone = replace(setup, reporter=ProgressReporter())
    swings = {}
    for done, case in enumerate(cases, start=1):
        sensors_used, kind, load, cable = case
        cables = {"cable": cable} if kind == "share" else {"offset": cable * COMBINED.start[2]}
        untold = Perturbation(str(case), load=load, observer=sensors_used, **cables)  # type: ignore[arg-type]
        try:
            _, scored = make(alone, COMBINED, plan, untold, after=AFTER_UNTOLD)
            swings[case] = scored.arrival
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
        worst = max((case for case in swings if case[0] == sensors), key=lambda case: swings[case])
        _, kind, load, cable = worst
        claims.append(
            Claim(
                f"By the sensors “{sensors}” {1e3 * LEFT:g} mrad are left at the arrival at most "
                f"over the whole grid: {1e3 * swings[worst]:.3f} mrad with {100 * load:g} % of the "
                f"load and {100 * cable:+g} % of cable ({kind}).",
                swings[worst] <= LEFT,
            )
        )
    return Outcome(
        tables=[_table(swings)],
        claims=claims,
        parameters={"loads": LOADS, "cables": CABLES},
        figures={"left": _figure(swings)},
    )


def _table(swings: Cases) -> ResultTable:
    grid = list(itertools.product(LOADS, CABLES))

    def swing(sensors_kind: tuple[str, str], load: float, cable: float) -> float | None:
        return finite_or_none(1e3 * swings.get((*sensors_kind, load, cable), math.inf))

    columns: list[Column] = [
        (f"{100 * load:g} %, {100 * cable:+g} %", ".3g", partial(swing, load=load, cable=cable))
        for load, cable in grid
    ]
    return make_table(
        "Swing at the arrival, flat + LQR, load and cable unknown [mrad]",
        dict.fromkeys((sensors, kind) for sensors, kind, *_ in swings),
        ("sensors, cable off by", "", ", ".join),
        *columns,
        note="Columns: load over the planned one, error of the cable. A dash: the run diverged, "
        "or the cable is as recorded and stands one row above.",
    )


def _figure(swings: Cases) -> Figure:
    figure, (ax,) = panels(height=3.4)
    for k, sensors in enumerate(dict.fromkeys(case[0] for case in swings)):
        values = np.array([value for case, value in swings.items() if case[0] == sensors])
        share = np.arange(1, len(values) + 1) / len(values)
        style = "steps-post"
        ax.plot(1e3 * np.sort(values), share, drawstyle=style, color=run_colour(k), label=sensors)
    ax.axvline(1e3 * LEFT, linestyle=":", color="#999999")
    ax.set(xscale="log", xlabel="swing at the arrival [mrad]", ylabel="share of the grid")
    ax.legend()
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
