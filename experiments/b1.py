"""The paper's control on single-axis and combined moves, beside PD, full-model LQR and flat
feed-forward.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.controllers import paper
from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.plotting.style import LINE_STYLES
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, finite_or_none, make_table
from experiments.scenarios.moves import (
    AFTER,
    COMBINED,
    MOVES,
    SETTLED_DISTANCE,
    RestToRest,
    Score,
    sampling_swing,
)
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import (
    FLAT,
    LQR,
    PAPER,
    PD,
    STRATEGIES,
    file_name,
    flat_motion,
    strategy_colour,
)

SHOWN = ("spline alone", PD, PAPER, LQR, FLAT)
"""Strategies of the tables."""

DRAWN = (PD, PAPER, LQR, FLAT)
"""Strategies whose runs are stored and drawn."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Make every move by every strategy."""
    from cranedyn.recording import Run

    runs: dict[RestToRest, dict[str, Trajectory]] = {move: {} for move in MOVES}
    scores: dict[RestToRest, dict[str, Score]] = {move: {} for move in MOVES}
    for move, strategy in itertools.product(MOVES, SHOWN):
        plan = STRATEGIES[strategy](setup, move)
        run, score = make(setup, move, plan, label=f"{move.name}, {strategy}")
        runs[move][strategy] = run
        scores[move][strategy] = score

    trajectories = {}
    for move, strategy in itertools.product(MOVES, DRAWN):
        name = f"b1_{move.name}_{file_name(strategy)}"
        trajectories[name] = runs[move][strategy]
    figures = {f"tracking_{move.name}": _tracking_figure(move, runs[move][PAPER]) for move in MOVES}
    for move in MOVES:
        figures[f"swing_{move.name}"] = _swing_figure(move, runs[move])
    return Outcome(
        tables=[_table(move, of_move) for move, of_move in scores.items()],
        claims=_claims(setup, COMBINED, scores[COMBINED]),
        parameters={
            "moves": {move.name: [move.start, move.goal, move.duration] for move in MOVES},
            "paper_trolley_weights": [np.diag(w).tolist() for w in paper.TROLLEY_WEIGHTS],
            "paper_slew_weights": [np.diag(w).tolist() for w in paper.SLEW_WEIGHTS],
            "paper_hoist_pid": paper.HOIST,
        },
        trajectories=trajectories,
        figures=figures,
        recording=[
            Run(strategy, setup.crane, runs[COMBINED][strategy], colour=strategy_colour(strategy))
            for strategy in (PD, PAPER)
        ],
    )


def _claims(setup: Setup, move: RestToRest, scores: Mapping[str, Score]) -> list[Claim]:
    pd = scores[PD]
    paper_score = scores[PAPER]
    lqr = scores[LQR]
    flat = scores[FLAT]
    planned = flat_motion(setup, move)
    planned_peak = float(np.linalg.norm(planned.q[:, setup.crane.swings], axis=1).max())
    sampling = sampling_swing(setup.gravity, flat.length, setup.control_period, planned_peak)
    return [
        Claim(
            f"Combined move: within {AFTER:g} s of the arrival the paper's control settles to "
            f"{1000 * SETTLED_DISTANCE:g} mm ({_settled(paper_score)}), the PD does not "
            f"({_settled(pd)}).",
            math.isfinite(paper_score.settled) and not math.isfinite(pd.settled),
        ),
        Claim(f"The full-model LQR does, too ({_settled(lqr)}).", math.isfinite(lqr.settled)),
        Claim(
            f"Flat feed-forward with LQR leaves no swing at the arrival: {1000 * flat.arrival:.4f} "
            "mrad, where efforts that are held for "
            f"{1000 * setup.control_period:g} ms may leave {1000 * sampling:.4f} mrad.",
            flat.arrival < sampling,
        ),
        Claim(
            f"Its peak swing ({1000 * flat.peak:.3f} mrad) is the planned "
            f"({1000 * planned_peak:.3f} mrad) within the same.",
            abs(flat.peak - planned_peak) < sampling,
        ),
    ]


def _settled(score: Score) -> str:
    return f"after {score.settled:.2f} s" if math.isfinite(score.settled) else "not in that time"


def _table(move: RestToRest, scores: Mapping[str, Score]) -> ResultTable:
    return make_table(
        f"Move {move.name}: {move.start} to {move.goal} in {move.duration:g} s",
        scores.items(),
        ("strategy", "", lambda s: s[0]),
        ("peak [mrad]", ".2f", lambda s: 1000 * s[1].peak),
        ("at arrival", ".4f", lambda s: 1000 * s[1].arrival),
        ("20 s later", ".4f", lambda s: 1000 * s[1].later),
        ("hook [mm]", ".3f", lambda s: 1000 * s[1].later * s[1].length),
        ("settled [s]", ".2f", lambda s: finite_or_none(s[1].settled)),
        ("γ off [mrad]", ".2f", lambda s: float(s[1].tracking[0])),
        ("x off [mm]", ".1f", lambda s: float(s[1].tracking[1])),
        ("l off [mm]", ".2f", lambda s: float(s[1].tracking[2])),
        ("T_γ [N m]", ".0f", lambda s: float(s[1].effort[0])),
        ("F_x [N]", ".0f", lambda s: float(s[1].effort[1])),
        ("F_l [N]", ".0f", lambda s: float(s[1].effort[2])),
        note="Swing amplitudes in mrad. Settled: the payload stays within 10 mm of its goal; dash: "
        "not within 20 s. Off: largest distance of a drive from its reference. Efforts: largest "
        "beyond holding the load. Spline, planes (7)-(10), LQR and PID are the paper's; weights, "
        "gains and durations are chosen here, because the paper's are not public.",
    )


def _tracking_figure(move: RestToRest, run: Trajectory) -> Figure:
    """Draw the drives and their references, in the manner of the paper's Fig. 5."""
    figure, axes = panels(3, height=1.8, sharex=True)
    for ax, (name, unit, scale, label) in zip(
        axes,
        (
            ("gamma", "rad", np.degrees(1.0), "γ [°]"),
            ("x", "m", 1.0, "x [m]"),
            ("l", "m", 1.0, "l [m]"),
        ),
        strict=True,
    ):
        setpoint = scale * run[f"{name}_setpoint_{unit}"]
        ax.plot(run.t, setpoint, "--", color=COLOURS["setpoint"], label="setpoint")
        position = scale * run[f"{name}_{unit}"]
        ax.plot(run.t, position, color=COLOURS[name], label="paper's control")
        ax.set_ylabel(label)
    axes[0].set_title(f"Drives in the {move.name} move", loc="left")
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    return figure


def _swing_figure(move: RestToRest, runs: Mapping[str, Trajectory]) -> Figure:
    """Draw radial and tangential swing of each strategy, in the manner of the paper's Fig. 6."""
    figure, axes = panels(2, height=2.6, sharex=True)
    for ax, column, name in zip(axes, ("phi_rad", "theta_rad"), ("φ", "θ"), strict=True):
        style = LINE_STYLES[column.removesuffix("_rad")]
        for strategy in DRAWN:
            colour = strategy_colour(strategy)
            run = runs[strategy]
            ax.plot(run.t, np.degrees(run[column]), style, color=colour, label=strategy)
        ax.axvline(move.duration, linestyle=":", color=COLOURS["unexplained"], linewidth=1.0)
        ax.set_ylabel(f"{name} [°]")
    axes[0].set_title(f"Swing of the {move.name} move", loc="left")
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]; dotted: arrival")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("b1", __doc__)
    harness.add_setup(parser)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
