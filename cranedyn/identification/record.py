"""What was recorded of a crane: times, drives, swing, checked before anything is computed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import finite
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint

PERIODS, ROWS = 2.0, 40
"""Least length of a record: periods of the swing, and rows."""

_UPRIGHT, _GAP, _STILL = math.pi / 2, 5.0, 1e-9


@dataclass(frozen=True, eq=False)
class Record:
    """One record of a crane, in our units; time counts from the first row.

    Attributes:
        name: What it is called.
        crane: The crane that it is of, as far as one knows it.
        t: Times [s], shape (rows,).
        columns: What was recorded, by the names that a trajectory has, shape (rows,) each.
        notes: What was noticed about it, a sentence each.
    """

    name: str
    crane: Crane
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        crane: Crane,
        columns: Mapping[str, np.ndarray],
        *,
        name: str = "record",
        since: float = -math.inf,
        until: float = math.inf,
    ) -> Record:
        """A record from columns, ``t_s`` and a swing among them; those that say nothing of drives
        or swings are left out.

        Args:
            crane: The crane, as far as one knows it.
            columns: By their names in a trajectory, such as ``phi_rad``, shape (rows,) each.
            name: What the record is called.
            since: From which time on it counts [s], on its own clock.
            until: Up to which time [s].

        Raises:
            DataError: If there is no swing, all of it stands still or it is beyond 90 degrees, time
                jumps or does not increase, or it is too short.
        """
        t = columns.get("t_s")
        if t is None:
            raise DataError(f"{name} has no column t_s; identification needs times [s].")
        t = finite(f"t_s of {name}", t, ("rows",), unit="s")
        kept = {
            key: finite(f"{key} of {name}", columns[key], (len(t),))
            for key in known_columns(crane)
            if key in columns and key != "t_s"
        }
        _check_clock(name, t)
        late = (t >= since - 1e-9) & (t <= until + 1e-9)
        t, kept = t[late], {key: values[late] for key, values in kept.items()}
        dead = _check_swings(name, crane, kept)
        _check_length(name, crane, t, kept)
        kept = {key: values for key, values in kept.items() if key not in dead}
        notes = [f"{name}: {key} never moves and is left out." for key in dead]
        notes += [
            f"{name}: nothing is recorded of {joint.symbol}, taken to stand at {at:g} {joint.unit}."
            for joint, at in zip(
                crane.layout.driven, crane.start.q[crane.layout.drives].tolist(), strict=True
            )
            if not {*joint.columns, joint.setpoint_column, joint.effort_column} & kept.keys()
        ]
        return cls(name, crane, t - t[0], kept, tuple(notes))

    @property
    def duration(self) -> float:
        """From the first row to the last [s]."""
        return float(self.t[-1])

    @property
    def interval(self) -> float:
        """Usual time from row to row [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def swings(self) -> tuple[Joint, ...]:
        """The swings that were recorded."""
        joints = (self.crane.layout.joints[i] for i in self.crane.swings.tolist())
        return tuple(joint for joint in joints if joint.columns[0] in self.columns)

    def moves(self, column: str) -> bool:
        """Whether a column is there and ever changes."""
        values = self.columns.get(column)
        return values is not None and bool(np.ptp(values) > _STILL)


def known_columns(crane: Crane) -> list[str]:
    """Names of the columns that say something: times, drives, their setpoints and efforts,
    swings.
    """
    layout = crane.layout
    swings = [layout.joints[i].columns[0] for i in crane.swings.tolist()]
    driven = [
        name
        for joint in layout.driven
        for name in (*joint.columns, joint.setpoint_column, joint.effort_column)
    ]
    return ["t_s", *swings, *driven]


def _check_clock(name: str, t: np.ndarray) -> None:
    steps = np.diff(t)
    if len(t) < 2 or not (steps > 0.0).all():
        row = int(np.argmin(steps)) + 2 if len(t) > 1 else len(t)
        raise DataError(
            f"{name}: t_s does not increase at row {row} of {len(t)}, a clock that jumps back; "
            "allowed are times that increase."
        )
    usual, worst = float(np.median(steps)), int(np.argmax(steps))
    if steps[worst] > _GAP * usual:
        raise DataError(
            f"{name}: t_s goes from {t[worst]:g} to {t[worst + 1]:g} s at row {worst + 2}, a gap "
            f"or a clock that jumps; allowed is {_GAP:g} times the usual {usual:.3g} s."
        )


def _check_swings(name: str, crane: Crane, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Names of swing columns that never move, at least one other does."""
    known = [crane.layout.joints[i].columns[0] for i in crane.swings.tolist()]
    there = [key for key in known if key in columns]
    if not there:
        raise DataError(f"{name} has no swing column; one of {', '.join(known)} is needed.")
    for key in there:
        if (most := float(np.abs(columns[key]).max(initial=0.0))) > _UPRIGHT:
            raise DataError(
                f"{name}: {key} is {most:.4g} rad in some row; a swing is {_UPRIGHT:.4f} rad (90 "
                f"degrees) at most. If it is in degrees, say so: --columns {key}={key}[deg]."
            )
    dead = [key for key in there if len(columns[key]) and np.ptp(columns[key]) <= _STILL]
    if dead == there:
        raise DataError(
            f"{name}: {', '.join(dead)} never moves; a load that does not swing, or a sensor that "
            "is not connected, says nothing."
        )
    return dead


def _check_length(
    name: str, crane: Crane, t: np.ndarray, columns: Mapping[str, np.ndarray]
) -> None:
    if len(t) < ROWS:
        raise DataError(f"{name} has {len(t)} rows to go by; allowed are {ROWS} or more.")
    hoist = crane.layout.drive_of("hoist")
    if hoist is None:
        return
    column = crane.layout.driven[hoist].columns[0]
    at = crane.start.q[crane.layout.drives[hoist]]
    length = max(float(np.mean(columns[column])) if column in columns else float(at), 0.1)
    needed = PERIODS * 2.0 * math.pi * math.sqrt(length / crane.gravity)
    if t[-1] - t[0] < needed:
        raise DataError(
            f"{name} lasts {t[-1] - t[0]:.3g} s; allowed is {needed:.3g} s or more, {PERIODS:g} "
            "periods of its swing."
        )
