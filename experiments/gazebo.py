"""The same runs in Gazebo Classic, the article's own simulator: recordings made there beside runs
made here.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.analysis.swing import SwingFit, agreement, fit_swing
from cranedyn.data.trajectory import Trajectory, read_columns
from cranedyn.errors import DataError
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import panels
from experiments import a1, a2, a3, harness
from experiments.harness import Claim, Outcome, Setup, Table

GRAVITY = 9.8
"""Gravity of the article's world, Gazebo's default [m/s²]."""

ALLOWED = 1e-4
"""Largest difference in a swing angle at any time of a whole run [rad].

Gazebo moves centres of mass along chords, so that a slider on a rotating link gains h l ω²/2 in a
step; its difference from the runs here halves with the step.
"""

RECORDINGS = Path(__file__).with_name("recordings") / "gazebo"
"""Runs of Gazebo Classic 11.1; a README beside them says how they were made."""

COLUMNS = ("t_s", "gamma_dot_rad_s", "x_m", "phi_rad", "theta_rad", "theta_dot_rad_s", "l_m")
"""What the recordings hold."""

SWINGS = ("phi_rad", "theta_rad")
"""The swing angles among them."""


@dataclass(frozen=True)
class Pair:
    """One run, in Gazebo and here.

    Attributes:
        name: Of the recording.
        there: Columns of the recording by name, shape (n,) each.
        here: The run.
    """

    name: str
    there: Mapping[str, np.ndarray]
    here: Trajectory

    def difference(self, column: str) -> np.ndarray:
        """What was recorded less what is found here at the same times, shape (n,).

        Raises:
            DataError: If the run has no row at a time of the recording.
        """
        t = self.there["t_s"]
        rows = np.searchsorted(self.here.t, t - 1e-6)
        if rows[-1] >= len(self.here) or np.abs(self.here.t[rows] - t).max() > 1e-6:
            raise DataError(f"The recording {self.name} has rows at other times than the run.")
        return self.there[column] - self.here[column][rows]

    def largest(self, *columns: str) -> float:
        """Return the largest size of that difference in any of the columns, the swing angles if
        none is named.
        """
        return max(float(np.abs(self.difference(name)).max()) for name in columns or SWINGS)


def pairs(setup: Setup) -> dict[str, Pair]:
    """Every recording with its run made here, by name."""
    length, stiffness, damping, _ = a1.SOFT
    runs = {f"a1_l{length:g}": a1.run(setup, length).trajectory for length in a1.PUBLISHED}
    runs |= {
        "a1_soft": a1.run(
            setup, length, stiffness={"x": stiffness}, damping={"x": damping}
        ).trajectory,
        "a2": a2.run(setup),
        "a3": a3.run(setup),
    }
    return {
        name: Pair(name, read_columns(RECORDINGS / f"{name}.parquet", COLUMNS), run)
        for name, run in runs.items()
    }


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Compare every recording with its run."""
    world = replace(setup, gravity=GRAVITY)
    found = pairs(world)
    free = [pair for name, pair in found.items() if name.startswith("a1")]
    apart = {
        "A1, swing at four cable lengths and with a soft trolley": max(
            pair.largest() for pair in free
        ),
        "A2, swing while the hoist runs": found["a2"].largest(),
        "A3, swing after the slew pulse": found["a3"].largest(),
    }
    return Outcome(
        tables=[_swings(free), _hoisting(found["a2"]), _slewing(found["a3"])],
        claims=[
            Claim(
                f"{name}: never further than {ALLOWED:g} rad from Gazebo ({worst:.1e} rad at "
                "most).",
                worst < ALLOWED,
            )
            for name, worst in apart.items()
        ],
        parameters=world.parameters(),
        figures={"difference": _figure(found)},
    )


def _fit(columns: Mapping[str, np.ndarray] | Trajectory) -> SwingFit:
    late = columns["t_s"] >= a1.FIT_FROM
    return fit_swing(columns["t_s"][late], columns["phi_rad"][late])


def _swings(free: Sequence[Pair]) -> Table:
    rows: list[tuple[float | str | None, ...]] = []
    for pair in free:
        length = round(float(pair.there["l_m"][0]), 6)
        published = a1.SOFT[3] if pair.name == "a1_soft" else a1.PUBLISHED[length]
        point = float(theory.point_period(length, STANDARD_GRAVITY))
        there, here = _fit(pair.there), _fit(pair.here)
        periods = there.period, here.period
        errors = (100.0 * (period / point - 1.0) for period in periods)
        ratios = there.damping_ratio, here.damping_ratio, published.zeta
        amplitudes = there.amplitude, here.amplitude, published.amplitude
        name = f"{length:g} m{', soft' if pair.name == 'a1_soft' else ''}"
        rows.append(
            (name, *periods, *errors, published.point, *ratios, *amplitudes, pair.largest())
        )
    columns = [
        ("l", ""),
        *(("T Gazebo [s]", ".6f"), ("here", ".6f")),
        *(("error Gazebo [%]", "+.3f"), ("here", "+.3f"), ("article", "+.2f")),
        *(("ζ Gazebo", ".6f"), ("here", ".6f"), ("article", ".5f")),
        *(("A Gazebo [rad]", ".5f"), ("here", ".5f"), ("article", ".4f")),
        ("apart [rad]", ".1e"),
    ]
    note = (
        "Apart: the largest difference in a swing angle at any time of the 70 s. Errors against "
        "the point pendulum in standard gravity."
    )
    return Table("Free swing (A1) in Gazebo and here", columns, rows, note)


def _hoisting(pair: Pair) -> Table:
    p = a2.PUBLISHED
    rows: list[tuple[float | str | None, ...]] = []
    for name, data in (("Gazebo", dict(pair.there)), ("here", pair.here)):
        r = a2.read(data["t_s"], data["phi_rad"], data["l_m"])
        mean, worst, last = 100.0 * float(r.errors.mean()), 100.0 * r.worst, float(r.amplitudes[-1])
        rows.append((name, mean, worst, r.everywhere.exponent, r.section.exponent, last))
    rows.append(("article", p["mean"], p["max"], p["all"], p["hoisting"], p["after"]))
    columns = [
        ("run", ""),
        ("mean [%]", "+.2f"),
        ("max [%]", ".2f"),
        ("exp. all", "+.4f"),
        ("exp. hoisting", "+.4f"),
        ("A after [rad]", ".4f"),
    ]
    note = (
        f"No swing angle is ever further apart than {pair.largest():.1e} rad, the cable length "
        f"{pair.largest('l_m'):.1e} m."
    )
    return Table("Hoisting while swinging (A2) in Gazebo and here", columns, rows, note)


def _slewing(pair: Pair) -> Table:
    p, rows = a3.PUBLISHED, []
    for name, data in (
        ("Gazebo", dict(pair.there)),
        ("here", {c: pair.here[c] for c in a3.COLUMNS}),
    ):
        found = agreement(*a3.by_paper(data)[1:3])
        rows.append((name, found.measured, found.correlation, found.rms))
    rows.append(("article", p.measured, p.correlation, p.rms))
    columns = [("run", ""), ("θ [rad]", ".4f"), ("correlation", "+.5f"), ("RMS [rad]", ".6f")]
    note = (
        "Against the paper's Eq. (10). θ is never further apart than "
        f"{pair.largest('theta_rad'):.1e} rad, φ than {pair.largest('phi_rad'):.1e} rad."
    )
    return Table("Slewing (A3) in Gazebo and here", columns, rows, note)


def _figure(found: Mapping[str, Pair]) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    for name, pair in found.items():
        angle = "theta_rad" if name == "a3" else "phi_rad"
        ax.plot(pair.there["t_s"], 1e6 * pair.difference(angle), linewidth=1.0, label=name)
    ax.set(xlabel="time [s]", ylabel="Gazebo less here [µrad]")
    ax.legend(ncols=4, loc="upper left")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "gazebo",
        "Runs of the article's own simulator, Gazebo Classic 11.1, beside the same runs here.",
        recording=False,
    )
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
