"""B1, the paper's control: quintic splines, two decoupled LQRs and a hoist PID, beside what is
simpler and what is better.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.controllers import paper
from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.plotting.runs import STYLES
from cranedyn.references.flat import flat
from experiments import harness
from experiments.harness import Claim, Outcome, Setup, Table
from experiments.scenarios.colours import strategy_colour
from experiments.scenarios.moves import AFTER, CLOSE, MOVES, Move, Score, of_sampling
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import FLAT, LQR, PAPER, PD, STRATEGIES

SHOWN = ("spline alone", PD, PAPER, LQR, FLAT)


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Every strategy on every move."""
    from cranedyn.recording import Run

    made = {
        move: {
            strategy: make(
                setup, move, STRATEGIES[strategy](setup, move), label=f"{move.name}, {strategy}"
            )
            for strategy in SHOWN
        }
        for move in MOVES
    }
    runs = {
        move: {strategy: run for strategy, (run, _) in of_move.items()}
        for move, of_move in made.items()
    }
    scores = {
        move: {strategy: found for strategy, (_, found) in of_move.items()}
        for move, of_move in made.items()
    }
    combined = MOVES[-1]
    return Outcome(
        tables=[_table(move, of_move) for move, of_move in scores.items()],
        claims=_claims(setup, combined, scores[combined]),
        parameters=setup.parameters()
        | {
            "moves": {move.name: [move.start, move.goal, move.duration] for move in MOVES},
            "paper_trolley_weights": [np.diag(w).tolist() for w in paper.TROLLEY_WEIGHTS],
            "paper_slew_weights": [np.diag(w).tolist() for w in paper.SLEW_WEIGHTS],
            "paper_hoist_pid": paper.HOIST,
        },
        trajectories={
            f"b1_{move.name}_{_plain(strategy)}": runs[move][strategy]
            for move in MOVES
            for strategy in (PD, PAPER, LQR, FLAT)
        },
        figures={
            f"tracking_{move.name}": _tracking_figure(of_move[PAPER])
            for move, of_move in runs.items()
        }
        | {f"swing_{move.name}": _swing_figure(move, of_move) for move, of_move in runs.items()},
        recording=[
            Run(strategy, setup.crane, runs[combined][strategy], colour=strategy_colour(strategy))
            for strategy in (PD, PAPER)
        ],
    )


def _plain(strategy: str) -> str:
    return strategy.replace("'s", "").replace(" + ", "_").replace(" ", "_").lower()


def _claims(setup: Setup, move: Move, found: Mapping[str, Score]) -> list[Claim]:
    pd, ours, lqr, best = (found[strategy] for strategy in (PD, PAPER, LQR, FLAT))
    planned = flat(setup.crane, *move.ends(setup.crane), move.duration, period=setup.control_period)
    plan = float(np.linalg.norm(planned.q[:, setup.crane.swings], axis=1).max())
    sampling = of_sampling(setup.gravity, best.length, setup.control_period, plan)
    return [
        Claim(
            f"Combined move: within {AFTER:g} s of the arrival the paper's control settles to "
            f"{1000 * CLOSE:g} mm ({_settled(ours)}), the PD does not ({_settled(pd)}).",
            math.isfinite(ours.settled) and not math.isfinite(pd.settled),
        ),
        Claim(f"The full-model LQR does, too ({_settled(lqr)}).", math.isfinite(lqr.settled)),
        Claim(
            f"Flat feed-forward with LQR leaves no swing at the arrival: {1000 * best.arrival:.4f} "
            "mrad, where efforts that are held for "
            f"{1000 * setup.control_period:g} ms may leave {1000 * sampling:.4f} mrad.",
            best.arrival < sampling,
        ),
        Claim(
            f"Its peak swing ({1000 * best.peak:.3f} mrad) is the planned ({1000 * plan:.3f} mrad) "
            "within the same.",
            abs(best.peak - plan) < sampling,
        ),
    ]


def _settled(found: Score) -> str:
    return f"after {found.settled:.2f} s" if math.isfinite(found.settled) else "not in that time"


def _table(move: Move, found: Mapping[str, Score]) -> Table:
    rows = [
        (
            strategy,
            1000 * s.peak,
            1000 * s.arrival,
            1000 * s.later,
            1000 * s.later * s.length,
            s.settled if math.isfinite(s.settled) else None,
            *s.tracking.tolist(),
            *s.effort.tolist(),
        )
        for strategy, s in found.items()
    ]
    columns = [
        ("strategy", ""),
        ("peak [mrad]", ".2f"),
        ("at arrival", ".4f"),
        ("20 s later", ".4f"),
        ("hook [mm]", ".3f"),
        ("settled [s]", ".2f"),
        ("γ off [mrad]", ".2f"),
        ("x off [mm]", ".1f"),
        ("l off [mm]", ".2f"),
        ("T_γ [N m]", ".0f"),
        ("F_x [N]", ".0f"),
        ("F_l [N]", ".0f"),
    ]
    note = (
        "Swing amplitudes in mrad; settled: the payload stays within 10 mm of its goal, a dash "
        "where it does not in 20 s. Off: the drives' largest distance from their reference. "
        "Efforts: the largest beyond holding the load. Spline, planes (7)-(10), LQR and PID are "
        "the paper's; weights, gains and durations are ours, since the paper's are not public."
    )
    return Table(
        f"Move {move.name}: {move.start} to {move.goal} in {move.duration:g} s", columns, rows, note
    )


def _tracking_figure(run: Trajectory) -> Figure:
    """Drives and their references, in the manner of the paper's Fig. 5."""
    figure, axes = panels(3, height=1.8, sharex=True)
    scale = np.degrees(1.0)
    for ax, column, factor in zip(
        axes, ("gamma_{}rad", "x_{}m", "l_{}m"), (scale, 1.0, 1.0), strict=True
    ):
        name = column.partition("_")[0]
        ax.plot(
            run.t,
            factor * run[column.format("setpoint_")],
            "--",
            color=COLOURS["setpoint"],
            label="setpoint",
        )
        ax.plot(
            run.t, factor * run[column.format("")], color=COLOURS[name], label="paper's control"
        )
        ax.set_ylabel({"gamma": "γ [°]", "x": "x [m]", "l": "l [m]"}[name])
    axes[0].legend(loc="lower right")
    axes[-1].set_xlabel("time [s]")
    return figure


def _swing_figure(move: Move, runs: Mapping[str, Trajectory]) -> Figure:
    """Radial and tangential swing of each strategy, in the manner of the paper's Fig. 6."""
    figure, axes = panels(2, height=2.6, sharex=True)
    for ax, column, name in zip(axes, ("phi_rad", "theta_rad"), ("φ", "θ"), strict=True):
        for strategy in (PD, PAPER, LQR, FLAT):
            style, colour = STYLES[column.removesuffix("_rad")], strategy_colour(strategy)
            ax.plot(
                runs[strategy].t,
                np.degrees(runs[strategy][column]),
                style,
                color=colour,
                label=strategy,
            )
        ax.axvline(move.duration, linestyle=":", color=COLOURS["unexplained"], linewidth=1.0)
        ax.set_ylabel(f"{name} [°]")
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel("time [s]; dotted: arrival")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "b1",
        "The paper's control on single-axis and combined moves, beside PD, full-model LQR and flat "
        "feed-forward.",
    )
    harness.add_setup(parser)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
