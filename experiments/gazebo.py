"""Runs of the article's own simulator, Gazebo Classic 11.1, beside the same runs here."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.analysis.swing import SwingFit, fit_swing
from cranedyn.data.trajectory import Trajectory, read_columns
from cranedyn.errors import DataError
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import legend_above, panels
from experiments import a1, a2, a3, harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table

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
class RecordedPair:
    """One run, in Gazebo and here.

    Attributes:
        name: Of the recording.
        recorded: Columns of the recording by name, shape (n,) each.
        run: The run.
    """

    name: str
    recorded: Mapping[str, np.ndarray]
    run: Trajectory

    def difference(self, column: str) -> np.ndarray:
        """Return the recorded column less that of the run at the same times, shape (n,).

        Raises:
            DataError: If the run has no row at a time of the recording.
        """
        t = self.recorded["t_s"]
        rows = np.searchsorted(self.run.t, t - 1e-6)
        if rows[-1] >= len(self.run) or np.abs(self.run.t[rows] - t).max() > 1e-6:
            raise DataError(f"The recording {self.name} has rows at other times than the run.")
        return self.recorded[column] - self.run[column][rows]

    def largest(self, *columns: str) -> float:
        """Return the largest size of that difference in any of the columns, the swing angles if
        none is named.
        """
        return max(float(np.abs(self.difference(name)).max()) for name in columns or SWINGS)


def pairs(setup: Setup) -> dict[str, RecordedPair]:
    """Return every recording with its run made here, by name."""
    soft = a1.SOFT
    runs = {f"a1_l{length:g}": a1.run(setup, length).trajectory for length in a1.PUBLISHED}
    runs["a1_soft"] = a1.run(
        setup, soft.length, stiffness={"x": soft.stiffness}, damping={"x": soft.damping}
    ).trajectory
    runs["a2"] = a2.run(setup)
    runs["a3"] = a3.run(setup)
    recordings = {}
    for name, run in runs.items():
        recorded = read_columns(RECORDINGS / f"{name}.parquet", COLUMNS)
        recordings[name] = RecordedPair(name, recorded, run)
    return recordings


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Compare every recording with its run."""
    world = replace(setup, gravity=GRAVITY)
    recordings = pairs(world)
    free = [pair for name, pair in recordings.items() if name.startswith("a1")]
    deviations = {
        "A1, swing at four cable lengths and with a soft trolley": max(
            pair.largest() for pair in free
        ),
        "A2, swing while the hoist runs": recordings["a2"].largest(),
        "A3, swing after the slew pulse": recordings["a3"].largest(),
    }
    return Outcome(
        tables=[_swings(free), _hoisting(recordings["a2"]), _slewing(recordings["a3"])],
        claims=[
            Claim(
                f"{name}: never further than {ALLOWED:g} rad from Gazebo ({worst:.1e} rad at "
                "most).",
                worst < ALLOWED,
            )
            for name, worst in deviations.items()
        ],
        parameters=world.parameters(),
        figures={"difference": _figure(recordings)},
    )


def _fit(columns: Mapping[str, np.ndarray] | Trajectory) -> SwingFit:
    late = columns["t_s"] >= a1.FIT_FROM
    return fit_swing(columns["t_s"][late], columns["phi_rad"][late])


def _swings(free: Sequence[RecordedPair]) -> ResultTable:
    def length(pair: RecordedPair) -> float:
        return round(float(pair.recorded["l_m"][0]), 6)

    def published(pair: RecordedPair) -> a1.Published:
        return a1.SOFT.published if pair.name == "a1_soft" else a1.PUBLISHED[length(pair)]

    def error(pair: RecordedPair, columns: Mapping[str, np.ndarray] | Trajectory) -> float:
        point = float(theory.point_period(length(pair), STANDARD_GRAVITY))
        return 100.0 * (_fit(columns).period / point - 1.0)

    return make_table(
        "Free swing (A1) in Gazebo and here",
        free,
        ("l", "", lambda p: f"{length(p):g} m{', soft' if p.name == 'a1_soft' else ''}"),
        ("T Gazebo [s]", ".6f", lambda p: _fit(p.recorded).period),
        ("here", ".6f", lambda p: _fit(p.run).period),
        ("error Gazebo [%]", "+.3f", lambda p: error(p, p.recorded)),
        ("here", "+.3f", lambda p: error(p, p.run)),
        ("article", "+.2f", lambda p: published(p).point),
        ("ζ Gazebo", ".6f", lambda p: _fit(p.recorded).damping_ratio),
        ("here", ".6f", lambda p: _fit(p.run).damping_ratio),
        ("article", ".5f", lambda p: published(p).zeta),
        ("A Gazebo [rad]", ".5f", lambda p: _fit(p.recorded).amplitude),
        ("here", ".5f", lambda p: _fit(p.run).amplitude),
        ("article", ".4f", lambda p: published(p).amplitude),
        ("apart [rad]", ".1e", lambda p: p.largest()),
        note="Apart: the largest difference in a swing angle at any time of the 70 s. Errors "
        "against the point pendulum in standard gravity.",
    )


def _hoisting(pair: RecordedPair) -> ResultTable:
    readings = {"Gazebo": a2.read_run(pair.recorded), "here": a2.read_run(pair.run)}
    return make_table(
        "Hoisting while swinging (A2) in Gazebo and here",
        readings.items(),
        ("run", "", lambda r: r[0]),
        ("mean [%]", "+.2f", lambda r: 100.0 * float(r[1].errors.mean())),
        ("max [%]", ".2f", lambda r: 100.0 * r[1].max_error),
        ("exp. all", "+.4f", lambda r: r[1].overall_law.exponent),
        ("exp. hoisting", "+.4f", lambda r: r[1].hoisting_law.exponent),
        ("A after [rad]", ".4f", lambda r: float(r[1].amplitudes[-1])),
        note=f"No swing angle is ever further apart than {pair.largest():.1e} rad, the cable "
        f"length {pair.largest('l_m'):.1e} m.",
        last_row=(
            "article",
            a2.PUBLISHED.mean_error,
            a2.PUBLISHED.max_error,
            a2.PUBLISHED.exponent,
            a2.PUBLISHED.hoisting_exponent,
            a2.PUBLISHED.amplitude_after,
        ),
    )


def _slewing(pair: RecordedPair) -> ResultTable:
    return make_table(
        "Slewing (A3) in Gazebo and here",
        [
            ("Gazebo", a3.by_paper(pair.recorded).agreement),
            ("here", a3.by_paper(pair.run).agreement),
            ("article", a3.PUBLISHED),
        ],
        ("run", "", lambda row: row[0]),
        ("θ [rad]", ".4f", lambda row: row[1].measured),
        ("correlation", "+.5f", lambda row: row[1].correlation),
        ("RMS [rad]", ".6f", lambda row: row[1].rms),
        note="Against the paper's Eq. (10). θ is never further apart than "
        f"{pair.largest('theta_rad'):.1e} rad, φ than {pair.largest('phi_rad'):.1e} rad.",
    )


def _figure(recordings: Mapping[str, RecordedPair]) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    for name, pair in recordings.items():
        angle = "theta_rad" if name == "a3" else "phi_rad"
        ax.plot(pair.recorded["t_s"], 1e6 * pair.difference(angle), linewidth=1.0, label=name)
    ax.set(xlabel="time [s]", ylabel="Gazebo less here [µrad]")
    legend_above(ax)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("gazebo", __doc__, recording=False)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
