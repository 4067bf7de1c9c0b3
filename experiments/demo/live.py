"""The demonstration while it runs: simulated piece by piece, printed, shown, and recorded."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from rich.console import Console

from cranedyn.checks import number
from cranedyn.command import interrupted
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.errors import DataError, RunError
from cranedyn.interfaces import Controller
from cranedyn.lifts.planning.itinerary import Timetable
from cranedyn.references.limits import Limits
from experiments import harness
from experiments.demo import endless
from experiments.scenarios.tours import CONTROLS

PIECE = 0.5
"""Length of the pieces in which the demo is simulated, shown and written [s]."""

MAX_FILE_DURATION = 3600.0
"""Longest time in one file of the live recording [s]."""

PACES = "0.001 to 1e6"
"""Range of the pace, in times real time; slower, a piece would not end in minutes."""


def pieces(
    setup: harness.Setup, tour: Timetable, controller: Controller, until: float
) -> Iterator[Trajectory]:
    """Yield the run of a tour piece by piece.

    A piece lies within one leg and the dwell after it.

    Args:
        setup: Crane, clocks and engine.
        tour: The tour, which is the reference.
        controller: Controller of the drives.
        until: End of the run [s], which may be infinite.
    """
    state = setup.crane.start
    t = 0.0
    period = setup.control_period
    while until - t > period / 2.0:
        stage, cycle = tour.stage(t + period / 2.0)
        longest = min(PIECE, until - t, cycle + stage.end - t)
        period_count = max(1, math.ceil(longest / period - 1e-6))
        piece = setup.simulate(
            setup.crane,
            controller,
            tour,
            start=state,
            t_start=t,
            duration=period * period_count,
            label="",
        )
        state = piece.state(-1)
        t = float(piece.t[-1])
        yield piece


def in_step(tour: Timetable, leader: Timetable) -> Timetable:
    """Return a tour whose legs begin when those of a slower tour begin, each at its own rate.

    Args:
        tour: The tour.
        leader: The slower tour, with the same legs.
    """
    stages = []
    for stage, leading in zip(tour.stages, leader.stages, strict=True):
        arrival = leading.begin + stage.arrival - stage.begin
        stages.append(stage._replace(begin=leading.begin, arrival=arrival, end=leading.end))
    return replace(tour, stages=tuple(stages))


class UncontrolledTour:
    """The same tour without swing control, simulated alongside for comparison.

    Its legs begin with those of the tour under control. It ends when no more of it is kept in
    memory.

    Attributes:
        dwells: Its dwells.
    """

    def __init__(
        self, setup: harness.Setup, limits: Limits, dwell: float, leader: Timetable
    ) -> None:
        """Begin at the start of the tour.

        Args:
            setup: Crane, clocks and engine.
            limits: Limits of the drives.
            dwell: Time at rest after each leg [s].
            leader: The tour under control.
        """
        tour, controller = CONTROLS["none"](setup, limits, dwell)
        tour = in_step(tour, leader)
        self._pieces = pieces(setup, tour, controller, 2.0 * endless.PART)
        self._past: list[Trajectory] = []
        self._has_failed = False
        self.dwells = endless.Dwells(tour, setup.control_period)

    def follow(self, t: float) -> None:
        """Simulate up to a time [s], or to the end of what is kept.

        An error ends the simulation for good, and is printed.
        """
        while not self._has_failed and (not self._past or self._past[-1].t[-1] < t - 1e-9):
            try:
                piece = next(self._pieces, None)
            except RunError as error:
                if interrupted(error):
                    raise KeyboardInterrupt from None
                print(f"There is no run without control to compare with: {error}", file=sys.stderr)
                self._has_failed = True
                return
            if piece is None:
                return
            self._past.append(piece)
            self.dwells.add(piece)

    def run(self, t: float) -> Trajectory | None:
        """Return the run up to a time [s] or the end of what is kept; None after an error."""
        self.follow(t)
        if self._has_failed or not self._past:
            return None
        return join(self._past).before(t + 1e-9)


class LiveDemo:
    """Prints and records the pieces of a run, and keeps them until the end or an interruption.

    Attributes:
        record: The pieces.
        dwells: The dwells of the tour.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        setup: harness.Setup,
        tour: Timetable,
        uncontrolled: UncontrolledTour | None,
    ) -> None:
        """Begin without a piece.

        Args:
            options: Arguments of the command line.
            setup: Crane, clocks and engine.
            tour: The tour.
            uncontrolled: The tour without control that is simulated alongside; None for none.

        Raises:
            OutOfRange: If the pace is out of range.
        """
        self._options = options
        self._setup = setup
        self._uncontrolled = uncontrolled
        # In times real time; None for as fast as possible.
        self._pace = 1.0 if options.view or options.serve else None
        if options.pace is not None:
            self._pace = number("pace", options.pace, "", PACES)
        self._console = Console(highlight=False)
        self.record = endless.EndlessRecord(options.folder / "demo.parquet")
        self.dwells = endless.Dwells(tour, setup.control_period)

    def run(self, pieces: Iterator[Trajectory]) -> Trajectory:
        """Show all pieces, and return the last minutes of the run, which are in memory."""
        with ExitStack() as stack:
            try:
                for piece in pieces:
                    # Opened after the first piece: all that can be refused has been by now.
                    if not self.record:
                        recordings = _LiveRecordings(self._options, self._setup, stack)
                        t_begin = time.monotonic()
                    # Recorded first: until the scene is drawn there is nothing to keep.
                    recordings.append(piece)
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
                recordings.put_aside()
        return self.record.last()

    def _add(self, piece: Trajectory) -> None:
        """Keep a piece, and print the leg that begins or the dwell that ends with it."""
        # Kept first, so that whatever is printed is kept.
        self.record.append(piece)
        stage = self.dwells.begins(piece)
        if stage is not None:
            self._console.print(f"{piece.t[0]:8.1f} s  {stage.leg.name}")
        if self._uncontrolled is not None:
            self._uncontrolled.follow(float(piece.t[-1]))
        dwell = self.dwells.add(piece)
        if dwell is not None:
            self._console.print(
                f"            the load still swings {dwell.swing:.1f} mrad, "
                f"{dwell.deviation:.0f} mm at the hook"
            )


class _LiveRecordings:
    """The recordings of a run under way: a file that can be opened at any time, and a viewer.

    Rerun keeps some 40 kB for each second in memory until a file is closed, so a long recording
    comes in parts. The viewer gets one recording.
    """

    def __init__(self, options: argparse.Namespace, setup: harness.Setup, stack: ExitStack) -> None:
        """Open the recordings until the stack is left.

        Args:
            options: Arguments of the command line.
            setup: The crane.
            stack: Contexts of the run.
        """
        from cranedyn import recording

        viewer = ""
        if options.view:
            viewer = recording.open_viewer()
        elif options.serve:
            server = stack.enter_context(recording.serve(port=options.port))
            viewer = server.data
            print(server.message)
        self._open = partial(recording.Live, setup.crane, "demo", title="The demo under way")
        self._path = options.recording
        self._file_begin = 0.0
        self._in_viewer = stack.enter_context(self._open(viewer=viewer)) if viewer else None
        self._file = self._open(file=self._path)
        # The file that is open in the end, which need not be this one.
        stack.callback(lambda: self._file.close())

    def append(self, piece: Trajectory) -> None:
        """Add the rows since the last piece."""
        if piece.t[0] - self._file_begin >= MAX_FILE_DURATION:
            self.put_aside()
            self._file = self._open(file=self._path)
            self._file_begin = float(piece.t[0])
        if self._in_viewer is not None:
            self._in_viewer.append(piece)
        self._file.append(piece)

    def put_aside(self) -> None:
        """Finish the file and rename it after its begin, so that another can take its name.

        Raises:
            DataError: If it cannot be renamed.
        """
        self._file.close()
        file = endless.part_of(self._path, self._file_begin)
        try:
            self._path.replace(file)
        except OSError as error:
            raise DataError(f"Cannot rename {self._path} to {file}: {error.strerror}.") from error
