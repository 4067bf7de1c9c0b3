"""B1, the paper's control: quintic splines, two decoupled LQRs and a hoist PID, beside what is simpler and what is better."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.controllers import paper
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import DRIVES
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.references.flat import flat
from experiments.harness import conduct as common
from experiments.scenarios.moves import AFTER, CLOSE, MOVES, Move, Score, of_sampling
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import FLAT, LQR, PAPER, PD, WAYS

SHOWN = ("spline alone", PD, PAPER, LQR, FLAT)


def experiment(options: argparse.Namespace, world: common.World) -> common.Outcome:
    """Every way on every move."""
    from cranedyn.recording import Run

    made = {move: {way: make(world, move, WAYS[way](world, move), label=f"{move.name}, {way}") for way in SHOWN} for move in MOVES}
    runs = {move: {way: run for way, (run, _) in of_move.items()} for move, of_move in made.items()}
    scores = {move: {way: found for way, (_, found) in of_move.items()} for move, of_move in made.items()}
    combined = MOVES[-1]
    return common.Outcome(
        tables=[_table(move, of_move) for move, of_move in scores.items()],
        claims=_claims(world, combined, scores[combined]),
        parameters=world.parameters()
        | {
            "moves": {move.name: [move.start, move.goal, move.duration] for move in MOVES},
            "paper_trolley_weights": [np.diag(w).tolist() for w in paper.TROLLEY_WEIGHTS],
            "paper_slew_weights": [np.diag(w).tolist() for w in paper.SLEW_WEIGHTS],
            "paper_hoist_pid": paper.HOIST,
        },
        trajectories={f"b1_{move.name}_{_plain(way)}": runs[move][way] for move in MOVES for way in (PD, PAPER, LQR, FLAT)},
        figures={f"tracking_{move.name}": _tracking_figure(of_move[PAPER]) for move, of_move in runs.items()}
        | {f"swing_{move.name}": _swing_figure(move, of_move) for move, of_move in runs.items()},
        recording=[Run(way, world.crane, runs[combined][way]) for way in (PD, PAPER)],
    )


def _plain(way: str) -> str:
    return way.replace("'s", "").replace(" + ", "_").replace(" ", "_").lower()


def _claims(world: common.World, move: Move, found: Mapping[str, Score]) -> list[common.Claim]:
    pd, ours, lqr, best = (found[way] for way in (PD, PAPER, LQR, FLAT))
    planned = flat(world.crane, *move.ends(world.crane), move.duration, period=world.control_period)
    plan = float(np.linalg.norm(planned.q[:, 2:4], axis=1).max())
    sampling = of_sampling(world.gravity, best.length, world.control_period, plan)
    return [
        common.Claim(
            f"Combined move: within {AFTER:g} s of the arrival the paper's control settles to {1000 * CLOSE:g} mm ({_settled(ours)}), "
            f"the PD does not ({_settled(pd)}).",
            math.isfinite(ours.settled) and not math.isfinite(pd.settled),
        ),
        common.Claim(f"The full-model LQR does, too ({_settled(lqr)}).", math.isfinite(lqr.settled)),
        common.Claim(
            f"Flat feed-forward with LQR leaves no swing at the arrival: {1000 * best.arrival:.4f} mrad, where efforts that are held for "
            f"{1000 * world.control_period:g} ms may leave {1000 * sampling:.4f} mrad.",
            best.arrival < sampling,
        ),
        common.Claim(
            f"Its peak swing ({1000 * best.peak:.3f} mrad) is the planned ({1000 * plan:.3f} mrad) within the same.",
            abs(best.peak - plan) < sampling,
        ),
    ]


def _settled(found: Score) -> str:
    return f"after {found.settled:.2f} s" if math.isfinite(found.settled) else "not in that time"


def _table(move: Move, found: Mapping[str, Score]) -> common.Table:
    rows = [
        (
            way,
            1000 * s.peak,
            1000 * s.arrival,
            1000 * s.later,
            1000 * s.later * s.length,
            s.settled if math.isfinite(s.settled) else None,
            *s.tracking.tolist(),
            *s.effort.tolist(),
        )
        for way, s in found.items()
    ]
    columns = [
        ("way", ""),
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
        "Swing amplitudes in mrad; settled: the payload stays within 10 mm of its goal, a dash where it does "
        "not in 20 s. Off: the drives' largest "
        "distance from their reference. Efforts: the largest beyond holding the load. Spline, planes "
        "(7)-(10), LQR and PID are the paper's; "
        "weights, gains and durations are ours, since the paper's are not public."
    )
    return common.Table(f"Move {move.name}: {move.start} to {move.goal} in {move.duration:g} s", columns, rows, note)


def _tracking_figure(run: Trajectory) -> Figure:
    """Drives and their references, in the manner of the paper's Fig. 5."""
    figure, axes = panels(3, height=1.8, sharex=True)
    scale = np.degrees(1.0)
    for ax, i, name, factor in zip(axes, DRIVES, ("gamma", "x", "l"), (scale, 1.0, 1.0), strict=True):
        ax.plot(run.t, factor * run.wanted[:, list(DRIVES).index(i)], "--", color=COLOURS["wanted"], label="wanted")
        ax.plot(run.t, factor * run.q[:, i], color=COLOURS[name], label="paper's control")
        ax.set_ylabel({"gamma": "γ [°]", "x": "x [m]", "l": "l [m]"}[name])
    axes[0].legend(loc="lower right")
    axes[-1].set_xlabel("time [s]")
    return figure


def _swing_figure(move: Move, runs: Mapping[str, Trajectory]) -> Figure:
    """Radial and tangential swing of each way, in the manner of the paper's Fig. 6."""
    figure, axes = panels(2, height=2.6, sharex=True)
    colours = {PD: COLOURS["wanted"], PAPER: COLOURS["gamma"], LQR: COLOURS["l"], FLAT: COLOURS["x"]}
    for ax, column, name in zip(axes, ("phi_rad", "theta_rad"), ("φ", "θ"), strict=True):
        for way, colour in colours.items():
            ax.plot(runs[way].t, np.degrees(runs[way][column]), color=colour, label=way)
        ax.axvline(move.duration, linestyle=":", color=COLOURS["unexplained"], linewidth=1.0)
        ax.set_ylabel(f"{name} [°]")
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel("time [s]; dotted: arrival")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = common.parser("b1", "The paper's control on single-axis and combined moves, beside PD, full-model LQR and flat feed-forward.")
    common.add_world(made)
    return common.conduct(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
