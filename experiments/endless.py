"""A run without end in bounded memory: its last minutes, files of its past, and its dwells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.data.trajectory import Trajectory, join
from cranedyn.lifts.planning.itinerary import Stage, Timetable

PART = 300.0
"""Length of each part of a long run [s]; one to two of them are kept in memory."""


def part_of(file: Path, begin: float) -> Path:
    """Return the file of the part that begins at a time [s]."""
    return file.with_name(f"{file.stem}_from_{begin:.0f}s{file.suffix}")


class EndlessRecord:
    """The pieces of a run in their order.

    Attributes:
        parts: The files of the earlier parts, in their order. No row stands twice, and the sums of
            each begin at zero.
    """

    def __init__(self, file: Path) -> None:
        """Begin without a piece; the names of the parts derive from the file."""
        self._file = file
        self._pieces: list[Trajectory] = []
        self.parts: list[Path] = []

    def __bool__(self) -> bool:
        """Return whether there is a piece."""
        return bool(self._pieces)

    def append(self, piece: Trajectory) -> None:
        """Add a piece; with two parts in memory, write the older one to its file.

        Raises:
            DataError: If that file cannot be written.
        """
        self._pieces.append(piece)
        begin = float(self._pieces[0].t[0])
        if float(piece.t[-1]) - begin < 2.0 * PART - 1e-6:
            return
        run = join(self._pieces)
        file = part_of(self._file, begin)
        end = begin + PART - 1e-6
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
    sums = {name: getattr(run, name) for name in ("work", "dissipated", "outside")}
    return replace(run, **{name: values - values[0] for name, values in sums.items()})


class Dwell(NamedTuple):
    """A dwell after a leg: name, arrival [s], swing [mrad] and deviation at the hook [mm]."""

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
        """Begin without a piece; pieces end within a control period [s] of the end of their leg."""
        self._tour = tour
        self._period = period
        self._begin = -np.inf
        self._extremes = np.zeros((0, 2))
        self._count = 0
        self.rows: list[Dwell] = []
        self.peak = 0.0
        self.shortest = np.inf
        self.first: Trajectory
        self.effort: np.ndarray | float = 0.0

    def begins(self, piece: Trajectory) -> Stage | None:
        """Return the leg that begins with a piece, None if it goes on."""
        stage, cycle = self._stage(piece)
        return None if cycle + stage.begin == self._begin else stage

    def add(self, piece: Trajectory) -> Dwell | None:
        """Add a piece, which lies within one leg and its dwell; return the dwell if it is over."""
        stage, cycle = self._stage(piece)
        if cycle + stage.begin != self._begin:
            self._begin = cycle + stage.begin
            self._extremes = np.zeros((0, 2))
            self._count = 0
        swing = np.linalg.norm(piece.coordinates("phi", "theta"), axis=1)
        self.peak = max(self.peak, float(swing.max()))
        self.shortest = min(self.shortest, float(piece["l_m"].min()))
        if not self.rows:
            self.effort = np.maximum(self.effort, np.abs(piece.effort).max(axis=0))
        end = cycle + stage.end
        dwell = piece.between(cycle + stage.arrival, end)
        if len(dwell):
            angles = np.concatenate([self._extremes, dwell.coordinates("phi", "theta")])
            self._extremes = np.array([angles.min(axis=0), angles.max(axis=0)])
            self._count += len(dwell)
        if piece.t[-1] < end - 1e-6 or self._count < 2:
            return None
        residual = 1000.0 * float(np.hypot(*(np.ptp(self._extremes, axis=0) / 2.0)))
        if not self.rows:
            self.first = piece.between(float(piece.t[-1]), float(piece.t[-1]))
        deviation = residual * float(dwell["l_m"][-1])
        self.rows.append(Dwell(stage.leg.name, cycle + stage.arrival, residual, deviation))
        return self.rows[-1]

    def _stage(self, piece: Trajectory) -> tuple[Stage, float]:
        return self._tour.stage(float(piece.t[0]) + self._period / 2.0)
