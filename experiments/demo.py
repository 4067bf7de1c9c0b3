"""The demo: seven legs at limited rates, again and again, and the swing that is left while the
drives stand still.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from cranedyn import theory
from cranedyn.analysis.swing import swing_amplitude
from cranedyn.command import interrupted
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.errors import CraneError, DataError, OutOfRange, RunError, number
from cranedyn.interfaces import Controller
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.references.itinerary import Stage, Timetable
from cranedyn.references.limits import Limits
from experiments import harness
from experiments.endless import PART, Dwell, Dwells, Record, part_of
from experiments.scenarios.moves import CLOSE, DWELL, TOUR_LIMITS, of_sampling
from experiments.scenarios.tours import CONTROLS

PIECE = 0.5
"""Length of the pieces in which the demo is simulated, shown and written [s]."""

RECORDED = 3600.0
"""How much is recorded live into one file [s]."""

MOST_ROWS = 70
"""Dwells in a table: those of ten cycles."""

PACES = "0.001 to 1e6"
"""How many times real time the demo may go: slower, a piece would not end in minutes."""


def pieces(
    setup: harness.Setup, tour: Timetable, controller: Controller, until: float
) -> Iterator[Trajectory]:
    """Simulate the tour piece by piece up to a time [s], which may be infinite."""
    crane, state, now = setup.crane, setup.crane.start, 0.0
    while until - now > setup.control_period / 2.0:
        stage, cycle = tour.stage(now + setup.control_period / 2.0)
        length = setup.control_period * max(
            1,
            math.ceil(
                min(PIECE, until - now, cycle + stage.end - now) / setup.control_period - 1e-6
            ),
        )
        piece = setup.simulate(
            crane, controller, tour, start=state, since=now, duration=length, label=""
        )
        state, now = piece.state(-1), float(piece.t[-1])
        yield piece


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Run until the cycles are done or the user interrupts; either way everything so far is
    kept.
    """
    from cranedyn.recording import Run

    setup = replace(setup, reporter=harness.ProgressReporter())
    if options.payload_mass is not None:
        if "payload_mass" in setup.values:
            raise CraneError(
                "payload_mass is given twice, by --payload-mass and by --set; leave one out."
            )
        setup = replace(setup, values={**setup.values, "payload_mass": options.payload_mass})
    pace = (
        options.pace
        if options.pace is not None
        else (1.0 if options.view or options.serve else None)
    )
    rates = setup.crane.layout.for_drives(
        "rate limit", (options.rate_slew, options.rate_x, options.rate_hoist), "/s", "> 0"
    )
    limits = Limits(rates.tolist(), TOUR_LIMITS.accelerations)
    tour, controller = CONTROLS[options.control](
        setup, limits, number("dwell", options.dwell, "s", "> 0")
    )
    until = (
        math.inf
        if options.cycles is None
        else number("cycles", options.cycles, "", "> 0") * tour.duration
    )
    if until < setup.control_period:
        raise OutOfRange(
            "cycles",
            options.cycles,
            f"{setup.control_period / tour.duration:.3g} or more, one control period",
        )
    bare = None if options.control == "none" else Bare(setup, limits, options.dwell, tour)
    show = _Show(
        options, setup, tour, bare, None if pace is None else number("pace", pace, "", PACES)
    )
    run = show.run(pieces(setup, tour, controller, until))
    rows, parts = show.dwells.rows, [part.name for part in show.record.parts]
    tables = [_table(rows, options.control, float(run.t[0]), parts)]
    claims = _bare(setup, tour, show.dwells) if rows and options.control == "none" else []
    runs, kept = {"demo" if bare is None else f"with {options.control}": run}, {"demo": run}
    if bare is not None and (other := bare.run(float(run.t[-1]))) is not None:
        kept["demo_before"] = other
        if not parts:
            runs["without control"] = other
        before = bare.dwells.rows
        tables.append(_table(before, "none"))
        if options.control == "flat":
            claims = [_nothing(setup, show.dwells)] if rows else []
        else:
            claims = [_better(rows, before, options.control)] if rows and before else []
    return harness.Outcome(
        tables=tables,
        claims=claims,
        parameters=setup.parameters()
        | {
            "rates": list(limits.rates),
            "accelerations": list(limits.accelerations),
            "dwell_s": options.dwell,
            "control": options.control,
        }
        | ({"earlier_parts": parts} if parts else {}),
        trajectories=kept,
        figures={"swing": _figure(tour, run)},
        recording=[Run(name, setup.crane, what) for name, what in runs.items()],
    )


def in_step(tour: Timetable, leader: Timetable) -> Timetable:
    """A tour at full rate whose legs begin when those of another begin; it waits for the other,
    which cannot be faster.
    """
    pairs = zip(tour.stages, leader.stages, strict=True)
    return replace(
        tour,
        stages=tuple(
            one._replace(begin=o.begin, arrival=o.begin + one.arrival - one.begin, end=o.end)
            for one, o in pairs
        ),
    )


class Bare:
    """The same tour without swing control, leg by leg with the other, simulated alongside for as
    long as all of it is kept.
    """

    def __init__(
        self, setup: harness.Setup, limits: Limits, dwell: float, leader: Timetable
    ) -> None:
        """Begin at the start of the tour."""
        tour, brake = CONTROLS["none"](setup, limits, dwell)
        tour = in_step(tour, leader)
        self._coming, self._done, self._broken = (
            pieces(setup, tour, brake, 2.0 * PART),
            list[Trajectory](),
            False,
        )
        self.dwells = Dwells(tour, setup.control_period)

    def follow(self, t: float) -> None:
        """Simulate up to a time [s], the end of what is kept, or where it breaks off, which is
        said.
        """
        while not self._broken and (not self._done or self._done[-1].t[-1] < t - 1e-9):
            try:
                piece = next(self._coming, None)
            except RunError as error:
                if interrupted(error):
                    raise KeyboardInterrupt from None
                print(f"There is no run without control to compare with: {error}", file=sys.stderr)
                self._broken = True
                return
            if piece is None:
                return
            self._done.append(piece)
            self.dwells.add(piece)

    def run(self, t: float) -> Trajectory | None:
        """What happened up to a time [s] or the end of what is kept; None if it broke off."""
        self.follow(t)
        return join(self._done).before(t + 1e-9) if self._done and not self._broken else None


def _table(
    rows: Sequence[Dwell], control: str, begin: float = 0.0, parts: Sequence[str] = ()
) -> harness.Table:
    columns = [
        ("leg", ""),
        ("arrives [s]", ".1f"),
        ("residual swing [mrad]", ".4g"),
        ("at the hook [mm]", ".4g"),
    ]
    title = "Swing that is left in the dwells, " + (
        "without swing control" if control == "none" else f"control {control}"
    )
    note = "Half the way across, radial and tangential together."
    if len(rows) > MOST_ROWS:
        note += f" The last {MOST_ROWS} of {len(rows)} dwells."
    if parts:
        note += (
            f" What happened before t = {begin:.0f} s is in "
            f"{', '.join(parts if len(parts) < 3 else [parts[0], '…', parts[-1]])}."
        )
    return harness.Table(title, columns, rows[-MOST_ROWS:], note)


def _bare(setup: harness.Setup, tour: Timetable, dwells: Dwells) -> list[harness.Claim]:
    """Without swing control: it keeps swinging, and after the first leg as the closed form says."""
    least, hook = min(row.swing for row in dwells.rows), min(row.deviation for row in dwells.rows)
    left, length = dwells.first, dwells.first["l_m"]
    found = float(
        swing_amplitude(
            left.coordinates("phi", "theta"), left.rates("phi", "theta"), length, setup.gravity
        )[0]
    )
    closed, allowed = started_and_stopped(setup, tour.stages[0], float(length[0]))
    limited = bool((dwells.effort >= setup.crane.effort_limit).any())
    return [
        harness.Claim(
            f"Without swing control the load keeps swinging in every dwell: {least:.1f} mrad and "
            f"{hook:.0f} mm at the hook at least, where "
            f"{1000 * CLOSE:g} mm count as settled.",
            hook > 1000.0 * CLOSE,
        ),
        harness.Claim(
            f"After the first leg it swings {1000 * found:.1f} mrad; a trolley that starts and "
            "stops at once leaves "
            f"{1000 * closed:.1f} mrad by closed form, to which a finite swing adds or takes "
            f"{1000 * allowed:.1f} mrad at most.",
            None if limited else abs(found - closed) < allowed,
        ),
    ]


def started_and_stopped(setup: harness.Setup, stage: Stage, length: float) -> tuple[float, float]:
    """Swing left by a leg of the trolley at a constant rate v in a time T on a cable [m], and what
    finite swing may change of it [rad].

    Start and stop leave A = 2 v/√(g l) at most, and A |sin ωT/2| together. The drive lags by
    k_d/k_p, which takes √(1 + (ω k_d/k_p)²) off a swing of the frequency ω, and gives way a little.
    A finite swing changes A² of the swing, and A²/16 of its phase.
    """
    crane, duration = setup.crane, stage.arrival - stage.begin
    reduced = length + (crane.payload_inertia[0, 0] + crane.dummy_inertia[0]) / (
        crane.payload_mass * length
    )
    give = theory.pivot_compliance(
        reduced, setup.gravity, crane.payload_mass, STIFFNESS["trolley"]
    )[0]
    omega = 2.0 * math.pi / (float(theory.point_period(reduced, setup.gravity)) * (1.0 + give))
    rate = abs(float((stage.target - stage.origin) @ crane.layout.along("x"))) / duration
    most = (
        2.0
        * rate
        / math.sqrt(setup.gravity * reduced)
        / math.hypot(1.0, omega * DAMPING["trolley"] / STIFFNESS["trolley"])
    )
    return most * abs(math.sin(omega * duration / 2.0)), most**3 * (1.0 + omega * duration / 16.0)


def _better(after: Sequence[Dwell], before: Sequence[Dwell], control: str) -> harness.Claim:
    """Dwell by dwell: each leaves a quarter of what the same dwell leaves without control, or
    less.
    """
    pairs = [(row.swing, other.swing) for row, other in zip(after, before, strict=False)]
    worst = max(with_control / without for with_control, without in pairs)
    return harness.Claim(
        f"With {control} every dwell has at most a quarter of its swing without control (worst: "
        f"1/{1 / worst:.0f}).",
        worst < 0.25,
    )


def _nothing(setup: harness.Setup, dwells: Dwells) -> harness.Claim:
    """Flat paths leave nothing: what is left is what the sampling of the efforts makes of the swing
    on the way.
    """
    left, peak = max(row.swing for row in dwells.rows), dwells.peak
    allowed = 1000.0 * of_sampling(setup.gravity, dwells.shortest, setup.control_period, peak)
    return harness.Claim(
        f"Flat paths leave no swing: {left:.4f} mrad at most, where efforts that are held for "
        f"{1000 * setup.control_period:g} ms may leave "
        f"{allowed:.4f} of {1000 * peak:.1f} mrad on the way.",
        left < allowed,
    )


def _figure(tour: Timetable, run: Trajectory) -> Figure:
    """Swing over time, the dwells shaded: the drives stand still there, the load does not."""
    figure, (drives, swing) = panels(2, height=2.4, sharex=True)
    drives.plot(run.t, run["x_m"], color=COLOURS["x"], label="x [m]")
    drives.plot(run.t, run["l_m"], color=COLOURS["l"], label="l [m]")
    drives.plot(run.t, np.degrees(run["gamma_rad"]), color=COLOURS["gamma"], label="γ [°]")
    swing.plot(run.t, np.degrees(run["phi_rad"]), color=COLOURS["phi"], label="φ radial")
    swing.plot(run.t, np.degrees(run["theta_rad"]), color=COLOURS["theta"], label="θ tangential")
    for cycle in tour.duration * np.arange(
        run.t[0] // tour.duration, math.ceil(run.t[-1] / tour.duration)
    ):
        for stage in tour.stages:
            if run.t[0] < cycle + stage.end and cycle + stage.arrival < run.t[-1]:
                swing.axvspan(
                    max(cycle + stage.arrival, run.t[0]),
                    min(cycle + stage.end, run.t[-1]),
                    color=COLOURS["setpoint"],
                    alpha=0.25,
                    linewidth=0,
                )
    swing.set(xlabel="time [s], dwells shaded", ylabel="swing [°]")
    drives.legend(ncols=3, loc="upper left")
    swing.legend(ncols=2, loc="upper left")
    return figure


class _Show:
    """Simulates, announces, streams; keeps what happened until the end or the interruption."""

    def __init__(
        self,
        options: argparse.Namespace,
        setup: harness.Setup,
        tour: Timetable,
        bare: Bare | None,
        pace: float | None,
    ) -> None:
        self._options, self._world, self._tour, self._bare, self._pace = (
            options,
            setup,
            tour,
            bare,
            pace,
        )
        self._console = Console(highlight=False)
        self.record, self.dwells = (
            Record(options.folder / "demo.parquet"),
            Dwells(tour, setup.control_period),
        )

    def run(self, pieces: Iterator[Trajectory]) -> Trajectory:
        """What is kept in memory of the pieces, the last minutes."""
        with ExitStack() as stack:
            try:
                for piece in pieces:
                    if not self.record:  # what would be refused has been by now
                        sinks, began = _Sinks(self._options, self._world, stack), time.monotonic()
                    sinks.append(piece)  # first: until the scene is drawn there is nothing to keep
                    self._add(piece)
                    if self._pace:
                        time.sleep(
                            max(0.0, float(piece.t[-1]) / self._pace - (time.monotonic() - began))
                        )
            except (KeyboardInterrupt, RunError) as error:
                if not interrupted(error):
                    if (
                        isinstance(error, RunError)
                        and error.trajectory is not None
                        and len(error.trajectory)
                    ):
                        error.trajectory = self.record.last(error.trajectory)
                    raise
                self._console.print("Interrupted; what was recorded so far is kept.")
            if not self.record:
                raise KeyboardInterrupt("Interrupted before the first half second was over.")
            if self.record.parts:
                sinks.put_aside()
        return self.record.last()

    def _add(self, piece: Trajectory) -> None:
        """Keep a piece and say what there is to say."""
        if (stage := self.dwells.begins(piece)) is not None:
            self._console.print(f"{piece.t[0]:8.1f} s  {stage.leg.name}")
        self.record.append(piece)
        if self._bare is not None:
            self._bare.follow(float(piece.t[-1]))
        if (left := self.dwells.add(piece)) is not None:
            self._console.print(
                f"            the load still swings {left.swing:.1f} mrad, {left.deviation:.0f} mm "
                "at the hook"
            )


class _Sinks:
    """Where the pieces go while the run is under way: the recording's file, readable at any time,
    and a viewer if one is asked for.

    Rerun keeps some 40 kB for each second in memory until a file is closed, so a long one comes in
    parts. What a viewer is shown has none.
    """

    def __init__(self, options: argparse.Namespace, setup: harness.Setup, stack: ExitStack) -> None:
        """Open what the options ask for, until the stack is left."""
        from cranedyn import recording

        viewer = ""
        if options.view:
            viewer = recording.open_viewer()
        elif options.serve:
            server = stack.enter_context(recording.serve(port=options.port))
            viewer = server.data
            print(server.words)
        self._live = partial(recording.Live, setup.crane, "demo", title="The demo under way")
        self._path, self._begin = options.recording, 0.0
        self._shown = [stack.enter_context(self._live(viewer=viewer))] if viewer else []
        self._file = self._live(file=self._path)
        stack.callback(lambda: self._file.close())

    def append(self, piece: Trajectory) -> None:
        """Add what happened since the last piece."""
        if piece.t[0] - self._begin >= RECORDED:
            self.put_aside()
            self._file, self._begin = self._live(file=self._path), float(piece.t[0])
        for live in (*self._shown, self._file):
            live.append(piece)

    def put_aside(self) -> None:
        """Finish the file and name it after its begin, so that another can take its name."""
        self._file.close()
        aside = part_of(self._path, self._begin)
        try:
            self._path.replace(aside)
        except OSError as error:
            raise DataError(f"Cannot rename {self._path} to {aside}: {error.strerror}.") from error


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = harness.parser(
        "demo",
        "The seven legs of the article's demonstration, until Ctrl-C, and the swing that is left "
        "in every dwell.",
    )
    harness.add_setup(made)
    made.set_defaults(live=True)
    made.add_argument(
        "--control",
        choices=CONTROLS,
        default="none",
        help="none: PD without swing control; shaped: the same with shaped commands; paper, lqr: "
        "splines with the paper's control or the "
        "full-model LQR; flat: paths of the payload. All but none are recorded over the same tour "
        "without control",
    )
    made.add_argument("--cycles", type=float, metavar="N", help="stop after so many cycles")
    made.add_argument(
        "--rate-x",
        type=float,
        default=TOUR_LIMITS.rates[1],
        metavar="V",
        help="rate of the trolley [m/s]",
    )
    made.add_argument(
        "--rate-slew",
        type=float,
        default=TOUR_LIMITS.rates[0],
        metavar="W",
        help="rate of the slew [rad/s]",
    )
    made.add_argument(
        "--rate-hoist",
        type=float,
        default=TOUR_LIMITS.rates[2],
        metavar="V",
        help="rate of the hoist [m/s]",
    )
    made.add_argument(
        "--dwell", type=float, default=DWELL, metavar="T", help="time at rest after each leg [s]"
    )
    made.add_argument(
        "--pace",
        type=float,
        default=None,
        metavar="FACTOR",
        help=f"times real time, {PACES}; 1 with --view or --serve if not given, else as fast as it "
        "goes",
    )
    made.add_argument(
        "--payload-mass",
        type=float,
        default=None,
        metavar="M",
        help="payload [kg], short for --set payload_mass:=M",
    )
    return harness.run_experiment(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
