"""The seven legs of the article's demonstration, until Ctrl-C, and the swing that is left in every
dwell.
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
from cranedyn.checks import number
from cranedyn.command import interrupted
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.errors import DataError, OutOfRange, RunError
from cranedyn.interfaces import Controller
from cranedyn.lifts.planning.itinerary import Stage, Timetable
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.references.limits import Limits
from experiments import endless, harness
from experiments.scenarios.moves import CLOSE, DWELL, TOUR_LIMITS, of_sampling
from experiments.scenarios.tours import CONTROLS

PIECE = 0.5
"""Length of the pieces in which the demo is simulated, shown and written [s]."""

RECORDED = 3600.0
"""Longest time in one file of the live recording [s]."""

MAX_ROWS = 70
"""Dwells in a table: those of ten cycles."""

PACES = "0.001 to 1e6"
"""Range of the pace, in times real time; slower, a piece would not end in minutes."""


def pieces(
    setup: harness.Setup, tour: Timetable, controller: Controller, until: float
) -> Iterator[Trajectory]:
    """Simulate the tour piece by piece up to a time [s], which may be infinite."""
    crane = setup.crane
    state = setup.crane.start
    t = 0.0
    period = setup.control_period
    while until - t > period / 2.0:
        stage, cycle = tour.stage(t + period / 2.0)
        steps = math.ceil(min(PIECE, until - t, cycle + stage.end - t) / period - 1e-6)
        length = period * max(1, steps)
        piece = setup.simulate(
            crane, controller, tour, start=state, t_start=t, duration=length, label=""
        )
        state = piece.state(-1)
        t = float(piece.t[-1])
        yield piece


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Run until the cycles are done or the user interrupts; both keep all that was recorded."""
    setup = replace(setup, reporter=harness.ProgressReporter(None))
    rates = (options.rate_slew, options.rate_x, options.rate_hoist)
    rates = setup.crane.layout.for_drives("rate limit", rates, "/s", "> 0").tolist()
    limits = Limits(rates, TOUR_LIMITS.accelerations)
    dwell = number("dwell", options.dwell, "s", "> 0")
    tour, controller = CONTROLS[options.control](setup, limits, dwell)
    until = math.inf
    if options.cycles is not None:
        until = number("cycles", options.cycles, "", "> 0") * tour.duration
    if until < setup.control_period:
        fewest_cycles = f"{setup.control_period / tour.duration:.3g} or more, one control period"
        raise OutOfRange("cycles", options.cycles, fewest_cycles)
    bare = None if options.control == "none" else Bare(setup, limits, options.dwell, tour)
    show = _Show(options, setup, tour, bare)
    run = show.run(pieces(setup, tour, controller, until))
    rows = show.dwells.rows
    earlier_files = [file.name for file in show.record.parts]
    tables = [_table(rows, options.control, float(run.t[0]), earlier_files)]
    claims = _bare(setup, tour, show.dwells) if rows and options.control == "none" else []
    runs = {"demo" if bare is None else f"control {options.control}": run}
    trajectories = {"demo": run}
    if bare is not None and (before := bare.run(float(run.t[-1]))) is not None:
        trajectories["demo_before"] = before
        if not earlier_files:
            runs["without control"] = before
        tables.append(_table(bare.dwells.rows, "none"))
        if options.control == "flat":
            claims = [_nothing(setup, show.dwells)] if rows else []
        elif rows and bare.dwells.rows:
            claims = [_better(rows, bare.dwells.rows, options.control)]
    parameters = {
        "rates": list(limits.rates),
        "accelerations": list(limits.accelerations),
        "dwell_s": options.dwell,
        "control": options.control,
    }
    return harness.Outcome(
        tables=tables,
        claims=claims,
        parameters=parameters | ({"earlier_parts": earlier_files} if earlier_files else {}),
        trajectories=trajectories,
        figures={"swing": _figure(tour, run)},
        recording=harness.side_by_side(
            {name: (setup.crane, trajectory) for name, trajectory in runs.items()}, apart=0.0
        ),
    )


def in_step(tour: Timetable, leader: Timetable) -> Timetable:
    """Return a tour at full rate whose legs begin when those of a slower leader begin."""
    stages = tuple(
        stage._replace(
            begin=led.begin, arrival=led.begin + stage.arrival - stage.begin, end=led.end
        )
        for stage, led in zip(tour.stages, leader.stages, strict=True)
    )
    return replace(tour, stages=stages)


class Bare:
    """The same tour without swing control, simulated alongside, leg by leg in step with the leader,
    for as long as it is kept in memory.
    """

    def __init__(
        self, setup: harness.Setup, limits: Limits, dwell: float, leader: Timetable
    ) -> None:
        """Begin at the start of the tour."""
        tour, controller = CONTROLS["none"](setup, limits, dwell)
        tour = in_step(tour, leader)
        self._pieces = pieces(setup, tour, controller, 2.0 * endless.PART)
        self._past: list[Trajectory] = []
        self._failed = False
        self.dwells = endless.Dwells(tour, setup.control_period)

    def follow(self, t: float) -> None:
        """Simulate up to a time [s], the end of what is kept, or an error, which is printed."""
        while not self._failed and (not self._past or self._past[-1].t[-1] < t - 1e-9):
            try:
                piece = next(self._pieces, None)
            except RunError as error:
                if interrupted(error):
                    raise KeyboardInterrupt from None
                print(f"There is no run without control to compare with: {error}", file=sys.stderr)
                self._failed = True
                return
            if piece is None:
                return
            self._past.append(piece)
            self.dwells.add(piece)

    def run(self, t: float) -> Trajectory | None:
        """Return the run up to a time [s] or the end of what is kept; None after an error."""
        self.follow(t)
        return None if self._failed or not self._past else join(self._past).before(t + 1e-9)


def _table(
    rows: Sequence[endless.Dwell],
    control: str,
    t_start: float = 0.0,
    earlier_files: Sequence[str] = (),
) -> harness.ResultTable:
    columns = [
        ("leg", ""),
        ("arrives [s]", ".1f"),
        ("residual swing [mrad]", ".4g"),
        ("at the hook [mm]", ".4g"),
    ]
    strategy = "without swing control" if control == "none" else f"control {control}"
    note = "Amplitudes of radial and tangential swing together."
    if len(rows) > MAX_ROWS:
        note += f" The last {MAX_ROWS} of {len(rows)} dwells."
    if earlier_files:
        names = ", ".join(
            earlier_files if len(earlier_files) < 3 else [earlier_files[0], "…", earlier_files[-1]]
        )
        note += f" What happened before t = {t_start:.0f} s is in {names}."
    title = f"Swing that is left in the dwells, {strategy}"
    return harness.ResultTable(title, columns, rows[-MAX_ROWS:], note)


def _bare(setup: harness.Setup, tour: Timetable, dwells: endless.Dwells) -> list[harness.Claim]:
    """Claim that the load swings on, after the first leg as the closed form predicts."""
    swing = min(row.swing for row in dwells.rows)
    hook = min(row.deviation for row in dwells.rows)
    row = dwells.first
    length = dwells.first["l_m"]
    angles = row.coordinates("phi", "theta")
    rates = row.rates("phi", "theta")
    amplitude = float(swing_amplitude(angles, rates, length, setup.gravity)[0])
    closed, allowed = started_and_stopped(setup, tour.stages[0], float(length[0]))
    limited = bool((dwells.effort >= setup.crane.effort_limit).any())
    return [
        harness.Claim(
            f"Without swing control the load keeps swinging in every dwell: {swing:.1f} mrad and "
            f"{hook:.0f} mm at the hook at least, where "
            f"{1000 * CLOSE:g} mm count as settled.",
            hook > 1000.0 * CLOSE,
        ),
        harness.Claim(
            f"After the first leg it swings {1000 * amplitude:.1f} mrad; a trolley that starts and "
            "stops at once leaves "
            f"{1000 * closed:.1f} mrad by closed form, to which a finite swing adds or takes "
            f"{1000 * allowed:.1f} mrad at most.",
            None if limited else abs(amplitude - closed) < allowed,
        ),
    ]


def started_and_stopped(setup: harness.Setup, stage: Stage, length: float) -> tuple[float, float]:
    """Return the residual swing of a leg of the trolley at a constant rate v in a time T on a cable
    [m], and by how much finite swing may change it [rad].

    Start and stop leave A = 2 v/√(g l) at most, and A |sin ωT/2| together. The drive lags by
    k_d/k_p, which takes √(1 + (ω k_d/k_p)²) off a swing of the frequency ω, and gives way a little.
    A finite swing changes A² of the swing, and A²/16 of its phase.
    """
    crane = setup.crane
    duration = stage.arrival - stage.begin
    reduced = length + (crane.payload_inertia[0, 0] + crane.dummy_inertia[0]) / (
        crane.payload_mass * length
    )
    g = setup.gravity
    k_p = STIFFNESS["trolley"]
    compliance = theory.pivot_compliance(reduced, g, crane.payload_mass, k_p)[0]
    omega = 2.0 * math.pi / (float(theory.point_period(reduced, g)) * (1.0 + compliance))
    rate = abs(float((stage.target - stage.origin) @ crane.layout.along("x"))) / duration
    lag = math.hypot(1.0, omega * DAMPING["trolley"] / k_p)
    amplitude = 2.0 * rate / math.sqrt(g * reduced) / lag
    turned = omega * duration
    return amplitude * abs(math.sin(turned / 2.0)), amplitude**3 * (1.0 + turned / 16.0)


def _better(
    after: Sequence[endless.Dwell], before: Sequence[endless.Dwell], control: str
) -> harness.Claim:
    """Claim that control leaves a quarter of the swing, or less, in each dwell."""
    worst = max(row.swing / bare.swing for row, bare in zip(after, before, strict=False))
    return harness.Claim(
        f"With {control} every dwell has at most a quarter of its swing without control (worst: "
        f"1/{1 / worst:.0f}).",
        worst < 0.25,
    )


def _nothing(setup: harness.Setup, dwells: endless.Dwells) -> harness.Claim:
    """Claim that flat paths leave no more swing than the sampling of the efforts explains."""
    residual = max(row.swing for row in dwells.rows)
    peak = dwells.peak
    allowed = 1000.0 * of_sampling(setup.gravity, dwells.shortest, setup.control_period, peak)
    return harness.Claim(
        f"Flat paths leave no swing: {residual:.4f} mrad at most, where efforts that are held for "
        f"{1000 * setup.control_period:g} ms may leave "
        f"{allowed:.4f} of {1000 * peak:.1f} mrad on the way.",
        residual < allowed,
    )


def _figure(tour: Timetable, run: Trajectory) -> Figure:
    """Draw drives and swing over time, with the dwells shaded."""
    figure, (drives, swing) = panels(2, height=2.4, sharex=True)
    drives.plot(run.t, run["x_m"], color=COLOURS["x"], label="x [m]")
    drives.plot(run.t, run["l_m"], color=COLOURS["l"], label="l [m]")
    drives.plot(run.t, np.degrees(run["gamma_rad"]), color=COLOURS["gamma"], label="γ [°]")
    swing.plot(run.t, np.degrees(run["phi_rad"]), color=COLOURS["phi"], label="φ radial")
    swing.plot(run.t, np.degrees(run["theta_rad"]), color=COLOURS["theta"], label="θ tangential")
    first = float(run.t[0])
    last = float(run.t[-1])
    cycles = np.arange(first // tour.duration, math.ceil(last / tour.duration))
    for cycle in tour.duration * cycles:
        for stage in tour.stages:
            start = max(cycle + stage.arrival, first)
            end = min(cycle + stage.end, last)
            if start < last and first < end:
                swing.axvspan(start, end, color=COLOURS["setpoint"], alpha=0.25, linewidth=0)
    swing.set(xlabel="time [s], dwells shaded", ylabel="swing [°]")
    drives.legend(ncols=3, loc="upper left")
    swing.legend(ncols=2, loc="upper left")
    return figure


class _Show:
    """Simulates, prints and streams the pieces, and keeps them until the end or an interruption."""

    def __init__(
        self, options: argparse.Namespace, setup: harness.Setup, tour: Timetable, bare: Bare | None
    ) -> None:
        self._options = options
        self._setup = setup
        self._bare = bare
        self._pace = 1.0 if options.view or options.serve else None
        if options.pace is not None:
            self._pace = number("pace", options.pace, "", PACES)
        self._console = Console(highlight=False)
        self.record = endless.EndlessRecord(options.folder / "demo.parquet")
        self.dwells = endless.Dwells(tour, setup.control_period)

    def run(self, pieces: Iterator[Trajectory]) -> Trajectory:
        """Return the last minutes of the run, which are in memory."""
        with ExitStack() as stack:
            try:
                for piece in pieces:
                    if not self.record:  # all that can be refused has been by now
                        sinks = _Sinks(self._options, self._setup, stack)
                        t_begin = time.monotonic()
                    sinks.append(piece)  # first: until the scene is drawn there is nothing to keep
                    self._add(piece)
                    if self._pace:
                        due = t_begin + float(piece.t[-1]) / self._pace
                        time.sleep(max(0.0, due - time.monotonic()))
            except (KeyboardInterrupt, RunError) as error:
                if not interrupted(error):
                    if isinstance(error, RunError) and error.trajectory:
                        error.trajectory = self.record.last(error.trajectory)
                    raise
                self._console.print("Interrupted; what was recorded so far is kept.")
            if not self.record:
                raise KeyboardInterrupt("Interrupted before the first half second was over.")
            if self.record.parts:
                sinks.put_aside()
        return self.record.last()

    def _add(self, piece: Trajectory) -> None:
        """Keep a piece and print the leg that begins or the dwell that ends with it."""
        self.record.append(piece)  # first: what is printed is kept
        if (stage := self.dwells.begins(piece)) is not None:
            self._console.print(f"{piece.t[0]:8.1f} s  {stage.leg.name}")
        if self._bare is not None:
            self._bare.follow(float(piece.t[-1]))
        if (dwell := self.dwells.add(piece)) is not None:
            self._console.print(
                f"            the load still swings {dwell.swing:.1f} mrad, "
                f"{dwell.deviation:.0f} mm at the hook"
            )


class _Sinks:
    """The recordings of the pieces under way: a file that can be opened at any time, and a viewer.

    Rerun keeps some 40 kB for each second in memory until a file is closed, so a long one comes in
    parts. The viewer gets one recording.
    """

    def __init__(self, options: argparse.Namespace, setup: harness.Setup, stack: ExitStack) -> None:
        """Open the recordings until the stack is left."""
        from cranedyn import recording

        viewer = ""
        if options.view:
            viewer = recording.open_viewer()
        elif options.serve:
            server = stack.enter_context(recording.serve(port=options.port))
            viewer = server.data
            print(server.message)
        self._live = partial(recording.Live, setup.crane, "demo", title="The demo under way")
        self._path = options.recording
        self._begin = 0.0
        self._shown = [stack.enter_context(self._live(viewer=viewer))] if viewer else []
        self._file = self._live(file=self._path)
        stack.callback(lambda: self._file.close())

    def append(self, piece: Trajectory) -> None:
        """Add the rows since the last piece."""
        if piece.t[0] - self._begin >= RECORDED:
            self.put_aside()
            self._file = self._live(file=self._path)
            self._begin = float(piece.t[0])
        for live in (*self._shown, self._file):
            live.append(piece)

    def put_aside(self) -> None:
        """Finish the file and rename it after its begin, so that another can take its name."""
        self._file.close()
        file = endless.part_of(self._path, self._begin)
        try:
            self._path.replace(file)
        except OSError as error:
            raise DataError(f"Cannot rename {self._path} to {file}: {error.strerror}.") from error


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("demo", __doc__)
    harness.add_setup(parser)
    parser.set_defaults(live=True)
    parser.add_argument(
        "--control",
        choices=CONTROLS,
        default="none",
        help="none: PD without swing control; shaped: the same with shaped commands; paper, lqr: "
        "splines with the paper's control or the "
        "full-model LQR; flat: paths of the payload. All but none are recorded over the same tour "
        "without control",
    )
    slew, trolley, hoist = TOUR_LIMITS.rates
    for name, default, metavar, text in (
        ("--cycles", None, "N", "stop after so many cycles"),
        ("--rate-x", trolley, "V", "rate of the trolley [m/s]"),
        ("--rate-slew", slew, "W", "rate of the slew [rad/s]"),
        ("--rate-hoist", hoist, "V", "rate of the hoist [m/s]"),
        ("--dwell", DWELL, "T", "time at rest after each leg [s]"),
        (
            "--pace",
            None,
            "FACTOR",
            f"times real time, {PACES}; 1 with --view or --serve if not given, else as fast as it "
            "goes",
        ),
    ):
        parser.add_argument(name, type=float, default=default, metavar=metavar, help=text)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
