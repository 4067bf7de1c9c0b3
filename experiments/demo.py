"""The demo: seven legs at limited rates, again and again, and the swing that is left while the drives stand still."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from cranedyn import theory
from cranedyn.analysis import swing_amplitude
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.errors import CraneError, RunError, number
from cranedyn.figures import COLOURS, panels
from cranedyn.references.itinerary import Stage, Timetable
from cranedyn.references.limits import Limits
from cranedyn.simulate import Controller
from cranedyn.trajectory import Trajectory, join
from experiments import common
from experiments.moves import CLOSE, DWELL, TOUR_LIMITS, of_sampling, residual
from experiments.tours import CONTROLS

PIECE = 0.5
"""Length of the pieces in which the demo is simulated, shown and written [s]."""

PACES = "0.001 to 1e6"
"""How many times real time the demo may go: slower, a piece would not end in minutes."""


def pieces(world: common.World, tour: Timetable, controller: Controller, until: float) -> Iterator[Trajectory]:
    """Simulate the tour piece by piece up to a time [s], which may be infinite."""
    crane, state, now = world.crane, world.crane.start, 0.0
    while until - now > world.control_period / 2.0:
        stage, cycle = tour.stage(now + world.control_period / 2.0)
        length = world.control_period * max(1, math.ceil(min(PIECE, until - now, cycle + stage.end - now) / world.control_period - 1e-6))
        piece = world.simulate(crane, controller, tour, start=state, since=now, duration=length, label="")
        state, now = piece.state(-1), float(piece.t[-1])
        yield piece


def dwelt(stage: Stage, cycle: float, run: Trajectory) -> tuple[str, float, float, float] | None:
    """What is left after a leg: its name, arrival [s], swing [mrad] and way at the hook [mm]; None before its dwell is over."""
    arrival, end = cycle + stage.arrival, cycle + stage.end
    rest = run.between(arrival, end)
    if run.t[-1] < end - 1e-6 or len(rest) < 2:
        return None
    swing = 1000.0 * residual(rest)
    return stage.leg.name, arrival, swing, swing * float(rest.q[-1, 4])


def experiment(options: argparse.Namespace, world: common.World) -> common.Outcome:
    """Run until the cycles are done or the user interrupts; either way everything so far is kept."""
    from cranedyn.recording import Run

    world = replace(world, watcher=common.Watcher(None))
    if options.payload_mass is not None:
        if "payload_mass" in world.values:
            raise CraneError("payload_mass is given twice, by --payload-mass and by --set; leave one out.")
        world = replace(world, values={**world.values, "payload_mass": options.payload_mass})
    pace = options.pace if options.pace is not None else (1.0 if options.view or options.serve else None)
    limits = Limits((options.rate_slew, options.rate_x, options.rate_hoist), TOUR_LIMITS.accelerations)
    tour, controller = CONTROLS[options.control](world, limits, number("dwell", options.dwell, "s", "> 0"))
    until = math.inf if options.cycles is None else number("cycles", options.cycles, "", "> 0") * tour.duration
    run = _show(options, world, (tour, controller), until, None if pace is None else number("pace", pace, "", PACES))
    rows = _dwells(tour, run)
    tables, claims = [_table(rows, options.control)], _bare(world, tour, rows, run) if rows and options.control == "none" else []
    runs = {"demo": run}
    if options.control != "none":
        bare, brake = CONTROLS["none"](world, limits, options.dwell)
        runs = {f"with {options.control}": run}
        if (other := _before(world, bare, brake, float(run.t[-1]))) is not None:
            runs["without control"] = other
            before = _dwells(bare, other)
            tables.append(_table(before, "none"))
            claims = [_better(rows, before, options.control)] if rows and before else []
        if options.control == "flat" and rows:
            claims.append(_nothing(world, rows, run))
    return common.Outcome(
        tables=tables,
        claims=claims,
        parameters=world.parameters()
        | {"rates": list(limits.rates), "accelerations": list(limits.accelerations), "dwell_s": options.dwell, "control": options.control},
        trajectories={"demo": run} | ({"demo_before": runs["without control"]} if len(runs) > 1 else {}),
        figures={"swing": _figure(tour, run)},
        recording=[Run(name, world.crane, what) for name, what in runs.items()],
    )


def _before(world: common.World, tour: Timetable, controller: Controller, until: float) -> Trajectory | None:
    """The same time without swing control; None, with a word, if that breaks off."""
    start = world.crane.start
    try:
        return world.simulate(world.crane, controller, tour, start=start, duration=until, label="without control")
    except RunError as error:
        print(f"There is no run without control to compare with: {error}", file=sys.stderr)
        return None


def _table(rows: Sequence[tuple[str, float, float, float]], control: str) -> common.Table:
    columns = [("leg", ""), ("arrives [s]", ".1f"), ("residual swing [mrad]", ".4g"), ("at the hook [mm]", ".4g")]
    title = "Swing that is left in the dwells, " + ("without swing control" if control == "none" else f"control {control}")
    return common.Table(title, columns, rows, "Half the way across, radial and tangential together.")


def _bare(world: common.World, tour: Timetable, rows: Sequence[tuple[str, float, float, float]], run: Trajectory) -> list[common.Claim]:
    """Without swing control: it keeps swinging, and after the first leg as the closed form says."""
    least, hook = min(row[2] for row in rows), min(row[3] for row in rows)
    first = run.between(tour.stages[0].begin, tour.stages[0].end)
    found = float(swing_amplitude(first.q[-1:, 2:4], first.v[-1:, 2:4], first.q[-1, 4], world.gravity)[0])
    closed, allowed = started_and_stopped(world, tour.stages[0], float(first.q[-1, 4]))
    limited = bool((np.abs(first.effort) >= world.crane.effort_limit).any())
    return [
        common.Claim(
            f"Without swing control the load keeps swinging in every dwell: {least:.1f} mrad and {hook:.0f} mm at the hook at least, where "
            f"{1000 * CLOSE:g} mm count as settled.",
            hook > 1000.0 * CLOSE,
        ),
        common.Claim(
            f"After the first leg it swings {1000 * found:.1f} mrad; a trolley that starts and stops at once leaves "
            f"{1000 * closed:.1f} mrad by closed form, to which a finite swing adds or takes {1000 * allowed:.1f} mrad at most.",
            None if limited else abs(found - closed) < allowed,
        ),
    ]


def started_and_stopped(world: common.World, stage: Stage, length: float) -> tuple[float, float]:
    """Swing left by a leg of the trolley at a constant rate v in a time T on a cable [m], and what finite swing may change of it [rad].

    Start and stop leave A = 2 v/√(g l) at most, and A |sin ωT/2| together. The drive lags by k_d/k_p, which takes √(1 + (ω k_d/k_p)²)
    off a swing of the frequency ω, and gives way a little. A finite swing changes A² of the swing, and A²/16 of its phase.
    """
    crane, duration = world.crane, stage.arrival - stage.begin
    reduced = length + (crane.payload_inertia + crane.dummy_inertia[0]) / (crane.payload_mass * length)
    give = theory.pivot_give(reduced, world.gravity, crane.payload_mass, STIFFNESS[1])[0]
    omega = 2.0 * math.pi / (float(theory.point_period(reduced, world.gravity)) * (1.0 + give))
    rate = abs(float(stage.target[1] - stage.origin[1])) / duration
    most = 2.0 * rate / math.sqrt(world.gravity * reduced) / math.hypot(1.0, omega * DAMPING[1] / STIFFNESS[1])
    return most * abs(math.sin(omega * duration / 2.0)), most**3 * (1.0 + omega * duration / 16.0)


def _better(
    after: Sequence[tuple[str, float, float, float]], before: Sequence[tuple[str, float, float, float]], control: str
) -> common.Claim:
    """Dwell by dwell: each leaves a quarter of what the same dwell leaves without control, or less."""
    pairs = [(row[2], other[2]) for row, other in zip(after, before, strict=False)]
    worst = max(with_control / without for with_control, without in pairs)
    return common.Claim(
        f"With {control} every dwell has at most a quarter of its swing without control (worst: 1/{1 / worst:.0f}).", worst < 0.25
    )


def _nothing(world: common.World, rows: Sequence[tuple[str, float, float, float]], run: Trajectory) -> common.Claim:
    """Flat paths leave nothing: what is left is what the sampling of the efforts makes of the swing on the way."""
    left, peak = max(row[2] for row in rows), float(np.linalg.norm(run.q[:, 2:4], axis=1).max())
    allowed = 1000.0 * of_sampling(world.gravity, float(run.q[:, 4].min()), world.control_period, peak)
    return common.Claim(
        f"Flat paths leave no swing: {left:.4f} mrad at most, where efforts that are held for {1000 * world.control_period:g} ms may leave "
        f"{allowed:.4f} of {1000 * peak:.1f} mrad on the way.",
        left < allowed,
    )


def _dwells(tour: Timetable, run: Trajectory) -> list[tuple[str, float, float, float]]:
    cycles = tour.duration * np.arange(math.ceil(run.t[-1] / tour.duration))
    return [row for cycle in cycles for stage in tour.stages if (row := dwelt(stage, float(cycle), run)) is not None]


def _figure(tour: Timetable, run: Trajectory) -> Figure:
    """Swing over time, the dwells shaded: the drives stand still there, the load does not."""
    figure, (drives, swing) = panels(2, height=2.4, sharex=True)
    drives.plot(run.t, run["x_m"], color=COLOURS["x"], label="x [m]")
    drives.plot(run.t, run["l_m"], color=COLOURS["l"], label="l [m]")
    drives.plot(run.t, np.degrees(run["gamma_rad"]), color=COLOURS["gamma"], label="γ [°]")
    swing.plot(run.t, np.degrees(run["phi_rad"]), color=COLOURS["phi"], label="φ radial")
    swing.plot(run.t, np.degrees(run["theta_rad"]), color=COLOURS["theta"], label="θ tangential")
    for cycle in tour.duration * np.arange(math.ceil(run.t[-1] / tour.duration)):
        for stage in tour.stages:
            if cycle + stage.arrival < run.t[-1]:
                swing.axvspan(cycle + stage.arrival, min(cycle + stage.end, run.t[-1]), color=COLOURS["wanted"], alpha=0.25, linewidth=0)
    swing.set(xlabel="time [s], dwells shaded", ylabel="swing [°]")
    drives.legend(ncols=3, loc="upper left")
    swing.legend(ncols=2, loc="upper left")
    return figure


def _show(
    options: argparse.Namespace, world: common.World, way: tuple[Timetable, Controller], until: float, pace: float | None
) -> Trajectory:
    """Simulate, announce, stream; returns what happened until the end or the interruption."""
    console = Console(highlight=False)
    tour, controller = way
    done: list[Trajectory] = []
    leg: list[Trajectory] = []
    with ExitStack() as stack:
        try:
            for piece in pieces(world, tour, controller, until):
                if not done:  # what would be refused has been by now
                    append, began = _sinks(options, world, stack), time.monotonic()
                stage, cycle = tour.stage(float(piece.t[0]) + world.control_period / 2.0)
                if not leg:
                    console.print(f"{piece.t[0]:8.1f} s  {stage.leg.name}")
                done.append(piece)
                leg.append(piece)
                append(piece)
                if piece.t[-1] > cycle + stage.end - world.control_period / 2.0:
                    if row := dwelt(stage, cycle, join(leg)):
                        console.print(f"            the load still swings {row[2]:.1f} mrad, {row[3]:.0f} mm at the hook")
                    leg.clear()
                if pace:
                    time.sleep(max(0.0, float(piece.t[-1]) / pace - (time.monotonic() - began)))
        except (KeyboardInterrupt, RunError) as error:
            if isinstance(error, RunError) and not isinstance(error.__context__, KeyboardInterrupt):
                if error.trajectory is not None and len(error.trajectory):
                    error.trajectory = join([*done, error.trajectory])
                raise
            console.print("Interrupted; what was recorded so far is kept.")
    if not done:
        raise KeyboardInterrupt("Interrupted before the first half second was over.")
    return join(done)


def _sinks(options: argparse.Namespace, world: common.World, stack: ExitStack) -> Callable[[Trajectory], None]:
    """Where the pieces go while the run is under way: the recording's file, readable at any time, and a viewer if one is asked for."""
    from cranedyn import recording

    viewer = ""
    if options.view:
        viewer = recording.open_viewer()
    elif options.serve:
        server = stack.enter_context(recording.serve(port=options.port))
        viewer = server.data
        print(server.words)
    return stack.enter_context(
        recording.Live(world.crane, "demo", title="The demo under way", file=options.recording, viewer=viewer)
    ).append


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = common.parser("demo", "The seven legs of the article's demonstration, until Ctrl-C, and the swing that is left in every dwell.")
    common.add_world(made)
    made.set_defaults(live=True)
    made.add_argument(
        "--control",
        choices=CONTROLS,
        default="none",
        help="none: PD without swing control; shaped: the same with shaped commands; paper, lqr: splines with the paper's control or the "
        "full-model LQR; flat: paths of the payload. All but none are recorded over the same tour without control",
    )
    made.add_argument("--cycles", type=float, metavar="N", help="stop after so many cycles")
    made.add_argument("--rate-x", type=float, default=TOUR_LIMITS.rates[1], metavar="V", help="rate of the trolley [m/s]")
    made.add_argument("--rate-slew", type=float, default=TOUR_LIMITS.rates[0], metavar="W", help="rate of the slew [rad/s]")
    made.add_argument("--rate-hoist", type=float, default=TOUR_LIMITS.rates[2], metavar="V", help="rate of the hoist [m/s]")
    made.add_argument("--dwell", type=float, default=DWELL, metavar="T", help="time at rest after each leg [s]")
    made.add_argument(
        "--pace",
        type=float,
        default=None,
        metavar="FACTOR",
        help=f"times real time, {PACES}; 1 with --view or --serve if not given, else as fast as it goes",
    )
    made.add_argument("--payload-mass", type=float, default=None, metavar="M", help="payload [kg], short for --set payload_mass:=M")
    return common.conduct(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
