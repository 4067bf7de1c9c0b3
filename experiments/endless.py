"""A run without end in bounded memory: its last minutes, files of what came before, and what was
left in each dwell.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.data.trajectory import Trajectory, join
from cranedyn.planning.itinerary import Stage, Timetable

PART = 300.0
"""How long each part of a long run is [s]; one to two of them are kept in memory."""


def part_of(file: Path, begin: float) -> Path:
    """Where the part of a file stands that begins at a time [s]."""
    return file.with_name(f"{file.stem}_from_{begin:.0f}s{file.suffix}")


class Record:
    """The pieces of a run as they come.

    Attributes:
        parts: The files in which earlier parts stand, in order; no row stands twice, and the sums
            of each begin at zero.
    """

    def __init__(self, file: Path) -> None:
        """Begin without a piece; parts are called after this file, which is not written itself."""
        self._file, self._pieces = file, list[Trajectory]()
        self.parts: list[Path] = []

    def __bool__(self) -> bool:
        """Whether anything was appended."""
        return bool(self._pieces)

    def append(self, piece: Trajectory) -> None:
        """Add what follows; when it makes two parts, put the older into a file of its own.

        Raises:
            DataError: If that file cannot be written.
        """
        self._pieces.append(piece)
        begin = float(self._pieces[0].t[0])
        if float(piece.t[-1]) - begin < 2.0 * PART - 1e-6:
            return
        whole, file = join(self._pieces), part_of(self._file, begin)
        whole.before(begin + PART - 1e-6).write(file)
        self._pieces = [_anew(whole.since(begin + PART - 1e-6))]
        self.parts.append(file)

    def last(self, *more: Trajectory) -> Trajectory:
        """What is not in a part, and perhaps more that follows.

        Raises:
            DataError: If there is nothing.
        """
        return join([*self._pieces, *more])


def _anew(run: Trajectory) -> Trajectory:
    """The same with all sums from its first row on."""
    return replace(
        run,
        **{
            name: getattr(run, name) - getattr(run, name)[0]
            for name in ("work", "dissipated", "outside")
        },
    )


class Dwell(NamedTuple):
    """What is left after a leg: its name, when it ended [s], swing [mrad] and deviation at the hook
    [mm].
    """

    leg: str
    arrival: float
    swing: float
    deviation: float


class Dwells:
    """What is left in the dwells of a tour, from the pieces of its run as they come.

    Attributes:
        rows: The dwells that are over.
        peak: The most swing on the way [rad], radial and tangential together.
        shortest: The shortest cable [m].
        first: The last row of the first dwell; there is none before that is over.
        effort: The largest of each drive up to then [N m or N], shape (m,).
    """

    def __init__(self, tour: Timetable, period: float) -> None:
        """Begin without a piece of a tour; the control period [s] is how near a piece may be to the
        end of its leg.
        """
        self._tour, self._period = tour, period
        self._begin = -np.inf
        self._low, self._high, self._count = np.full(2, np.inf), np.full(2, -np.inf), 0
        self.rows: list[Dwell] = []
        self.peak, self.shortest = 0.0, np.inf
        self.first: Trajectory
        self.effort: np.ndarray | float = 0.0

    def begins(self, piece: Trajectory) -> Stage | None:
        """The leg that begins with a piece, None if it goes on."""
        stage, cycle = self._stage(piece)
        return None if cycle + stage.begin == self._begin else stage

    def add(self, piece: Trajectory) -> Dwell | None:
        """Look at a piece, which lies within one leg and its dwell; what is left, if the dwell is
        over with it.
        """
        stage, cycle = self._stage(piece)
        if cycle + stage.begin != self._begin:
            self._begin = cycle + stage.begin
            self._low, self._high, self._count = np.full(2, np.inf), np.full(2, -np.inf), 0
        self.peak = max(
            self.peak, float(np.linalg.norm(piece.coordinates("phi", "theta"), axis=1).max())
        )
        self.shortest = min(self.shortest, float(piece["l_m"].min()))
        if not self.rows:
            self.effort = np.maximum(self.effort, np.abs(piece.effort).max(axis=0))
        end = cycle + stage.end
        rest = piece.between(cycle + stage.arrival, end)
        if len(rest):
            swing = rest.coordinates("phi", "theta")
            self._low, self._high = (
                np.minimum(self._low, swing.min(axis=0)),
                np.maximum(self._high, swing.max(axis=0)),
            )
            self._count += len(rest)
        if piece.t[-1] < end - 1e-6 or self._count < 2:
            return None
        left = 1000.0 * float(np.hypot(*((self._high - self._low) / 2.0)))
        if not self.rows:
            self.first = piece.between(float(piece.t[-1]), float(piece.t[-1]))
        self.rows.append(
            Dwell(stage.leg.name, cycle + stage.arrival, left, left * float(rest["l_m"][-1]))
        )
        return self.rows[-1]

    def _stage(self, piece: Trajectory) -> tuple[Stage, float]:
        return self._tour.stage(float(piece.t[0]) + self._period / 2.0)
