"""A run without end in bounded memory: its last minutes, files of its past, and its dwells."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.data.trajectory import Trajectory, join
from cranedyn.lifts.planning.itinerary import Stage, Timetable

PART = 300.0
"""Length of each part of a long run [s]; one to two of them are kept in memory."""

ROUNDING = 1e-6
"""Rounding error of the times of control instants [s]."""


def part_of(file: Path, begin: float) -> Path:
    """Return the file of the part that begins at a time [s]."""
    return file.with_name(f"{file.stem}_from_{begin:.0f}s{file.suffix}")


class EndlessRecord:
    """The pieces of a run, in their order.

    Attributes:
        parts: Files of the earlier parts, in their order. No row stands in two of them. Work and
            losses count from the beginning of each part.
    """

    def __init__(self, file: Path) -> None:
        """Begin without a piece.

        Args:
            file: File of the whole run, from whose name those of the parts derive.
        """
        self._file = file
        self._pieces: list[Trajectory] = []
        self.parts: list[Path] = []

    def __bool__(self) -> bool:
        """Return whether there is a piece."""
        return bool(self._pieces)

    def append(self, piece: Trajectory) -> None:
        """Add a piece. Once two parts are in memory, the older one is written to its file.

        Raises:
            DataError: If that file cannot be written.
        """
        self._pieces.append(piece)
        begin = float(self._pieces[0].t[0])
        if float(piece.t[-1]) - begin < 2.0 * PART - ROUNDING:
            return
        run = join(self._pieces)
        file = part_of(self._file, begin)
        end = begin + PART - ROUNDING
        run.before(end).write(file)
        self._pieces = [_with_sums_from_zero(run.since(end))]
        self.parts.append(file)

    def last(self, *pieces: Trajectory) -> Trajectory:
        """Return the pieces in memory, followed by more.

        Raises:
            DataError: If there is nothing.
        """
        return join([*self._pieces, *pieces])


def _with_sums_from_zero(run: Trajectory) -> Trajectory:
    """Return a run whose work and losses count from its first row."""
    return replace(
        run,
        work=run.work - run.work[0],
        dissipated=run.dissipated - run.dissipated[0],
        outside=run.outside - run.outside[0],
    )


class Dwell(NamedTuple):
    """A dwell after a leg of the tour.

    Attributes:
        leg: Name of the leg.
        arrival: Time at which the drives arrive [s].
        swing: Residual swing, radial and tangential together [mrad].
        deviation: The same at the hook [mm].
    """

    leg: str
    arrival: float
    swing: float
    deviation: float


class Dwells:
    """The residual swing in the dwells of a tour, from the pieces of its run in their order.

    Attributes:
        rows: The dwells that are over.
        peak: Largest swing [rad], radial and tangential together.
        shortest: Shortest cable [m].
        first: Last row of the first dwell; not set before that is over.
        effort: Largest effort of each drive up to then [N m or N], shape (m,).
    """

    def __init__(self, tour: Timetable, period: float) -> None:
        """Begin without a piece.

        Args:
            tour: The tour.
            period: Control period [s]. Pieces end within one of the end of their leg.
        """
        self._tour = tour
        self._period = period
        self._leg_begin = -math.inf
        # Least and largest swing in each direction in the dwell so far [rad], shape (0 or 2, 2).
        self._extremes = np.zeros((0, 2))
        self._row_count = 0
        self.rows: list[Dwell] = []
        self.peak = 0.0
        self.shortest = math.inf
        self.first: Trajectory
        self.effort: np.ndarray | float = 0.0

    def begins(self, piece: Trajectory) -> Stage | None:
        """Return the leg that begins with a piece; None if the piece goes on with one."""
        stage, cycle = self._stage(piece)
        return None if cycle + stage.begin == self._leg_begin else stage

    def add(self, piece: Trajectory) -> Dwell | None:
        """Add a piece, which lies within one leg and its dwell; return the dwell if it is over."""
        stage, cycle = self._stage(piece)
        if cycle + stage.begin != self._leg_begin:
            self._leg_begin = cycle + stage.begin
            self._extremes = np.zeros((0, 2))
            self._row_count = 0

        swing = np.linalg.norm(piece.coordinates("phi", "theta"), axis=1)
        self.peak = max(self.peak, float(swing.max()))
        self.shortest = min(self.shortest, float(piece["l_m"].min()))
        if not self.rows:
            self.effort = np.maximum(self.effort, np.abs(piece.effort).max(axis=0))

        end = cycle + stage.end
        at_rest = piece.between(cycle + stage.arrival, end)
        if len(at_rest):
            angles = np.concatenate([self._extremes, at_rest.coordinates("phi", "theta")])
            self._extremes = np.array([angles.min(axis=0), angles.max(axis=0)])
            self._row_count += len(at_rest)
        if piece.t[-1] < end - ROUNDING or self._row_count < 2:
            return None

        if not self.rows:
            last = float(piece.t[-1])
            self.first = piece.between(last, last)
        radial, tangential = np.ptp(self._extremes, axis=0) / 2.0
        residual = 1000.0 * float(np.hypot(radial, tangential))
        dwell = Dwell(
            leg=stage.leg.name,
            arrival=cycle + stage.arrival,
            swing=residual,
            deviation=residual * float(at_rest["l_m"][-1]),
        )
        self.rows.append(dwell)
        return dwell

    def _stage(self, piece: Trajectory) -> tuple[Stage, float]:
        """Return the leg of a piece, and the time at which its cycle begins [s]."""
        return self._tour.stage(float(piece.t[0]) + self._period / 2.0)
