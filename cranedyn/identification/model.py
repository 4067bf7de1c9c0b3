"""What a record would show of a crane with given numbers, and what of it is to be found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cranedyn.checks import check_choice
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import DataError, OutOfRange
from cranedyn.identification.family import Family
from cranedyn.identification.known import Known
from cranedyn.identification.parameters import (
    EARLY,
    LATE,
    Drives,
    Parameter,
    parameter,
    starts,
    usual,
)
from cranedyn.identification.record import Record
from cranedyn.identification.variants import Channel, Variants
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.simulation.simulate import simulate

_CHANGE = 1e-6

ROUND_OFF = 1e-12
"""What of a channel is round-off, as a share of its range."""


@dataclass(frozen=True, eq=False)
class Model:
    """Records of one crane, what is to be found of it, and how both hang together.

    Attributes:
        known: What one believes of the crane.
        records: The records.
        parameters: What is to be found, those of the crane first, then how each record begins.
        drives: How the drives are made again.
    """

    known: Known
    records: tuple[Record, ...]
    parameters: tuple[Parameter, ...]
    drives: Drives

    @classmethod
    def of(
        cls,
        known: Known,
        records: Sequence[Record],
        names: Sequence[str] | None = None,
        *,
        drives: Drives | None = None,
    ) -> Model:
        """A model of records.

        Args:
            known: What one believes of the crane.
            records: One or more of it.
            names: Of what is to be found, see `cranedyn.identification.parameters.parameter`; None
                for whatever the columns could tell.
            drives: "motion" prescribes the recorded motion, "effort" lets the recorded efforts act,
                "hold" holds the drives at their setpoints by a hold controller; None for the motion
                where a record has one, else the efforts.

        Raises:
            DataError: If there is no record, it lacks what this needs, or a column never moves that
                a parameter needs.
            UnknownName: If a name stands for nothing.
        """
        if not records:
            raise DataError("There is no record to identify a crane from; give one or more.")
        way = _way(records) if drives is None else drives
        check_choice("drives", way, Drives)
        chosen = usual(known, records, way) if names is None else list(dict.fromkeys(names))
        if not chosen:
            raise DataError("There is nothing to find; give names of parameters.")
        found = [parameter(known, name) for name in chosen]
        for one in found:
            _check_tells(one, records, way)
        found += [one for i, record in enumerate(records) for one in starts(record, i, way)]
        return cls(known, tuple(records), tuple(found), way)

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The parameters of the crane, which are the first."""
        return tuple(one for one in self.parameters if one.record is None)

    @cached_property
    def first(self) -> np.ndarray:
        """Where the search begins, shape (parameters,)."""
        return np.array([one.start for one in self.parameters])

    @cached_property
    def scale(self) -> np.ndarray:
        """A usual change of each parameter, shape (parameters,)."""
        return np.array([one.scale for one in self.parameters])

    @cached_property
    def steps(self) -> np.ndarray:
        """How far apart variants stand for a slope, shape (parameters,): so far that some channel
        changes by a millionth of its range.
        """
        factor = np.where(self.tells > 0.0, _CHANGE / np.where(self.tells, self.tells, 1.0), 1.0)
        return self._tried * np.clip(factor, 1e-6, 1e6)

    @cached_property
    def _tried(self) -> np.ndarray:
        up = [one.start + one.scale <= one.high for one in self.parameters]
        return 1e-3 * np.where(up, 1.0, -1.0) * self.scale

    @cached_property
    def tells(self) -> np.ndarray:
        """By which share of its range some channel changes with a thousandth of the scale of each
        parameter, where the search begins; 0 where it is round-off, shape (parameters,).
        """
        tried, most = self._tried, np.zeros(len(self.parameters))
        for index in range(len(self.records)):
            places, measured = self.of_record(index), self.measured(index)
            variants = np.tile(self.first, (len(places) + 1, 1))
            variants[np.arange(1, len(places) + 1), places] += tried[places]
            shown = self.predicted(index, variants)
            change = np.abs(shown[1:] - shown[0]).max(axis=2)
            share = (change / np.maximum(np.ptp(measured, axis=1), 1e-9)).max(axis=1)
            most[places] = np.maximum(most[places], np.where(np.isfinite(share), share, 0.0))
        return np.where(most > ROUND_OFF, most, 0.0)

    def of_record(self, index: int) -> list[int]:
        """Places of the parameters that a record hangs on."""
        return [i for i, one in enumerate(self.parameters) if one.record in (None, index)]

    @cached_property
    def family(self) -> Family:
        """The cranes."""
        found = [one for one in self.parameters if one.kind == "argument"]
        first = {one.name: one.start for one in found}
        return self.known.family(first, {one.name: one.start + 0.5 * one.scale for one in found})

    @cached_property
    def channels(self) -> tuple[tuple[Channel, ...], ...]:
        """What is predicted of each record."""
        return tuple(self._channels(record) for record in self.records)

    def _channels(self, record: Record) -> tuple[Channel, ...]:
        layout, asked = self.known.crane.layout, {one.name for one in self.parameters}
        found = [
            Channel(joint.columns[0], joint.unit, "swing", layout.index(joint.symbol))
            for joint in record.swings
        ]
        for drive, joint in enumerate(layout.driven):
            at, position = int(layout.drives[drive]), joint.columns[0]
            weighs = joint.role == "hoist" and "payload_mass" in asked
            if self.drives != "motion" and record.moves(position):
                found.append(Channel(position, joint.unit, "position", at, drive))
            if (
                self.drives == "motion"
                and f"{joint.symbol}_lag" in asked
                and ({position, joint.setpoint_column} <= record.columns.keys())
            ):
                found.append(Channel(position, joint.unit, "lagged", at, drive))
            if (
                self.drives == "motion"
                and joint.effort_column in record.columns
                and (weighs or f"{joint.symbol}_friction" in asked)
            ):
                effort = joint.effort_column
                found.append(Channel(effort, joint.effort_unit, "effort", at, drive))
        return tuple(found)

    def rows(self, index: int, until: float = np.inf) -> np.ndarray:
        """Which rows of a record are looked at, up to a time [s]: not those that a delay would take
        from before its beginning or after its end.
        """
        t = self.records[index].t
        late = any(one.kind == "delay" for one in self.parameters)
        low, high = (LATE, t[-1] + EARLY) if late else (0.0, t[-1])
        return np.flatnonzero((t >= low) & (t <= min(high, until)))

    def measured(self, index: int, until: float = np.inf) -> np.ndarray:
        """What was recorded, shape (channels, rows looked at)."""
        record, rows = self.records[index], self.rows(index, until)
        return np.array([record.columns[one.column][rows] for one in self.channels[index]])

    def predicted(self, index: int, values: np.ndarray, until: float = np.inf) -> np.ndarray:
        """What a record would show, shape (variants, channels, rows looked at); not finite where a
        variant cannot be simulated.

        Args:
            index: Of the record.
            values: Of all parameters for each variant, shape (variants, parameters).
            until: Look at rows up to this time only [s].
        """
        # Numbers in which all cranes agree go into the code: one alone would have code of its own.
        beside = values[:1] + np.where(self._varied, 1e-3 * self.scale, 0.0)
        made = Variants(self, index, np.vstack([values, beside]), until)
        return made.outputs(made.batch())[:-1]

    @cached_property
    def _varied(self) -> np.ndarray:
        """Which parameters change the crane."""
        return np.array([one.kind == "argument" for one in self.parameters])

    def run(self, index: int, values: np.ndarray, crane: Crane) -> Trajectory:
        """A record made again by one crane, as a run.

        Args:
            index: Of the record.
            values: Of all parameters, shape (parameters,).
            crane: The crane with these values.
        """
        made = Variants(self, index, values[None])
        (controller, *_), (reference, *_) = made.laws([crane])
        begins = made.start()
        return simulate(
            crane,
            controller,
            reference,
            start=State(begins.q[0], begins.v[0]),
            duration=made.duration,
            dt=made.period,
            control_period=made.period,
            drive=made.drive,
            integrator=rk4,
            validity="mark",
            engine="compiled",
        )


def _way(records: Sequence[Record]) -> Drives:
    """How drives are made again if nothing is said."""
    for record in records:
        driven = record.crane.layout.driven
        if any({*joint.columns, joint.setpoint_column} & record.columns.keys() for joint in driven):
            return "motion"
    return "effort" if _has_efforts(records) else "motion"


def _has_efforts(records: Sequence[Record]) -> bool:
    return all(
        joint.effort_column in record.columns
        for record in records
        for joint in record.crane.layout.driven
    )


def _check_tells(one: Parameter, records: Sequence[Record], drives: Drives) -> None:
    """Return if some column could tell a parameter.

    Raises:
        DataError: If none could, because it is not there or never moves.
        OutOfRange: If drives that are made again so do not know it.
    """
    layout = records[0].crane.layout
    if drives == "effort" and not _has_efforts(records):
        needed = ", ".join(joint.effort_column for joint in layout.driven)
        raise DataError(f"A record has no effort of some drive; efforts that act need {needed}.")
    ways = {
        "lag": ("motion",),
        "friction": ("motion",),
        "delay": ("motion", "hold", "effort"),
        "stiffness": ("hold",),
        "damping": ("hold",),
    }
    if drives not in ways.get(one.kind, (drives,)):
        raise OutOfRange(f"drives beside {one.name}", drives, " or ".join(ways[one.kind]))
    joint = next((joint for joint in layout.joints if joint.symbol == one.of), None)
    column = {
        "lag": joint and joint.setpoint_column,
        "friction": joint and joint.effort_column,
        "bias": joint and joint.columns[0],
    }.get(one.kind)
    if column and not any(record.moves(column) for record in records):
        there = any(column in record.columns for record in records)
        raise DataError(
            f"{one.name} cannot be found: {column} {'never moves' if there else 'is not there'}."
        )
