"""The problem of identification: records of one crane, and the parameters to be estimated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple, Self

import numpy as np

from cranedyn.checks import check_choice
from cranedyn.errors import DataError, OutOfRange, UnknownName
from cranedyn.identification.parameters import (
    Drives,
    Parameter,
    bound_lateness,
    default_names,
    initial_parameters,
    parameter,
)
from cranedyn.identification.prior import Family, Prior
from cranedyn.identification.record import Record


class Channel(NamedTuple):
    """Column of a record that is predicted.

    Attributes:
        column: Name of the column.
        unit: Unit of the column.
        kind: Kind of the signal: "swing", "position", "lagged" or "effort".
        at: Index of the swing or drive among the coordinates.
        drive: Index of the drive among the drives; -1 for a swing.
    """

    column: str
    unit: str
    kind: str
    at: int
    drive: int = -1


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """Records of one crane and the parameters to be estimated from them.

    Attributes:
        prior: Prior knowledge of the crane.
        records: The records.
        parameters: Parameters of the crane first, then the initial values of each record.
        drives: How the drives are simulated.
        stated_signs: Columns of the swings whose signs the user stated.
    """

    prior: Prior
    records: tuple[Record, ...]
    parameters: tuple[Parameter, ...]
    drives: Drives
    stated_signs: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls,
        prior: Prior,
        records: Sequence[Record],
        names: Sequence[str] | None = None,
        *,
        drives: Drives | None = None,
        signs: Mapping[str, int] | None = None,
    ) -> Self:
        """Return the problem of estimating parameters from records.

        Args:
            prior: Prior knowledge of the crane.
            records: One or more records of it.
            names: Names of parameters, see `cranedyn.identification.parameters.parameter`; None for
                all that the columns can determine.
            drives: "motion" prescribes the recorded motion, "effort" applies the recorded efforts,
                "hold" holds the drives at their setpoints by a brake; None for the motion where a
                record has one, otherwise the efforts.
            signs: Signs of swings by their symbols, 1 as recorded and -1 for the other one; what is
                not listed may be turned if it is not explained as recorded.

        Raises:
            DataError: If there is no record, a column is missing, or a column is constant that a
                parameter needs.
            UnknownName: If there is no parameter of a name.
        """
        if not records:
            raise DataError("There is no record to identify a crane from; give one or more.")
        mode = _default_drives(records) if drives is None else drives
        check_choice("drives", mode, Drives)
        chosen = default_names(prior, records, mode) if names is None else dict.fromkeys(names)
        if not chosen:
            raise DataError("There is nothing to find; give names of parameters.")
        if mode == "effort" and _missing_efforts(records):
            needed = ", ".join(joint.effort_column for joint in prior.crane.layout.driven)
            raise DataError(
                f"A record has no effort of some drive; efforts that act need {needed}."
            )
        stated = _stated_columns(prior, signs or {})
        for column, sign in stated.items():
            if sign < 0:
                records = [r.turned(column) if column in r.columns else r for r in records]
        parameters = [parameter(prior, name) for name in chosen]
        parameters = [bound_lateness(p, records) for p in parameters]
        for p in parameters:
            _check_determined(p, records, mode)
        for i, record in enumerate(records):
            parameters += initial_parameters(record, i, mode)
        return cls(prior, tuple(records), tuple(parameters), mode, frozenset(stated))

    def alternatives(self) -> Iterator[Self]:
        """Yield the same problem with each swing of either sign, and with the search begun from
        other delays of the swing sensor.
        """
        swings = dict.fromkeys(
            record.swing_column(joint) for record in self.records for joint in record.swings
        )
        swings = {name: None for name in swings if name not in self.stated_signs}
        delays = np.unique([0.0, *(0.6 * np.array(self.delay_bounds))]).tolist()
        for signs in product((1, -1), repeat=len(swings)):
            records = self.records
            for column in (name for name, sign in zip(swings, signs, strict=True) if sign < 0):
                records = tuple(r.turned(column) if column in r.columns else r for r in records)
            for delay in delays:
                if (delay, *signs) == (0.0, *np.ones(len(swings))):
                    continue
                own = [replace(p, start=delay) if p.kind == "delay" else p for p in self.own]
                initial = [
                    p for i, r in enumerate(records) for p in initial_parameters(r, i, self.drives)
                ]
                yield replace(self, records=records, parameters=(*own, *initial))

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """Parameters of the crane, which are the first."""
        return tuple(p for p in self.parameters if p.record is None)

    @cached_property
    def first(self) -> np.ndarray:
        """First values of the search, shape (parameters,)."""
        return np.array([p.start for p in self.parameters])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the parameters, shape (parameters,) each."""
        low, high = zip(*((p.low, p.high) for p in self.parameters), strict=True)
        return np.array(low), np.array(high)

    @cached_property
    def scale(self) -> np.ndarray:
        """Typical change of each parameter, shape (parameters,)."""
        return np.array([p.scale for p in self.parameters])

    @cached_property
    def delay_bounds(self) -> tuple[float, float]:
        """Bounds of the delay of the swing sensor [s], zero where none is estimated."""
        bounds = [(p.low, p.high) for p in self.own if p.kind == "delay"]
        return bounds[0] if bounds else (0.0, 0.0)

    @cached_property
    def lateness_bounds(self) -> tuple[float, float]:
        """Bounds of the age [s] of the swing that a row reports, its window included."""
        early, late = self.delay_bounds
        return early, late + max((p.high for p in self.own if p.kind == "window"), default=0.0)

    def of_record(self, index: int) -> list[int]:
        """Return the indices of the parameters on which a record depends."""
        return [i for i, p in enumerate(self.parameters) if p.record in (None, index)]

    @cached_property
    def family(self) -> Family:
        """Cranes by the values of the arguments among the parameters."""
        arguments = [p for p in self.parameters if p.kind == "argument"]
        first = {p.name: p.start for p in arguments}
        return self.prior.family(first, {p.name: p.start + 0.5 * p.scale for p in arguments})

    @cached_property
    def channels(self) -> tuple[tuple[Channel, ...], ...]:
        """Channels predicted of each record."""
        return tuple(self._channels(record) for record in self.records)

    def _channels(self, record: Record) -> tuple[Channel, ...]:
        layout, names = self.prior.crane.layout, {p.name for p in self.parameters}
        channels = [
            Channel(column, f"{joint.unit}{'/s' * column.endswith('_s')}", "swing", at)
            for joint in record.swings
            for column, at in ((record.swing_column(joint), layout.index(joint.symbol)),)
        ]
        for drive, joint in enumerate(layout.driven):
            at, position, effort = int(layout.drives[drive]), joint.columns[0], joint.effort_column
            if self.drives != "motion":
                if record.moves(position):
                    channels.append(Channel(position, joint.unit, "position", at, drive))
                continue
            has_lag = f"{joint.symbol}_lag" in names
            if has_lag and {position, joint.setpoint_column} <= record.columns.keys():
                channels.append(Channel(position, joint.unit, "lagged", at, drive))
            weighs = drive == self.prior.crane.winch and "payload_mass" in names
            if (weighs or f"{joint.symbol}_friction" in names) and effort in record.columns:
                channels.append(Channel(effort, joint.effort_unit, "effort", at, drive))
        return tuple(channels)

    def rows(self, index: int, until: float = np.inf) -> np.ndarray:
        """Return the indices of the rows of a record that are evaluated, up to a time [s].

        Where a delay or a window is estimated, rows near both ends are left out: it would shift
        them out of the record.
        """
        t = self.records[index].t
        early, late = self.lateness_bounds
        return np.flatnonzero((t >= late) & (t <= min(t[-1] + early, until)))

    def measured(self, index: int, until: float = np.inf) -> np.ndarray:
        """Return the channels of a record, shape (channels, rows evaluated)."""
        record, rows = self.records[index], self.rows(index, until)
        channels = self.channels[index]
        return np.array([record.measured(channel.column)[rows] for channel in channels])


def _stated_columns(prior: Prior, signs: Mapping[str, int]) -> dict[str, int]:
    """Return the signs of the columns of swings whose signs the user stated.

    Raises:
        UnknownName: If there is no swing of a symbol.
        OutOfRange: If a sign is neither 1 nor -1.
    """
    layout = prior.crane.layout
    swings = {layout.joints[i].symbol: layout.joints[i] for i in prior.crane.swings.tolist()}
    stated: dict[str, int] = {}
    for symbol, sign in signs.items():
        if symbol not in swings:
            raise UnknownName("swing", symbol, swings)
        if sign not in (1, -1):
            raise OutOfRange(f"sign of {symbol}", sign, "1 or -1")
        for column in swings[symbol].columns:
            stated[column] = sign
    return stated


def _default_drives(records: Sequence[Record]) -> Drives:
    """Return "motion" where a motion is recorded or an effort is not, otherwise "effort"."""
    moved = any(
        {*joint.columns, joint.setpoint_column} & record.columns.keys()
        for record in records
        for joint in record.crane.layout.driven
    )
    return "motion" if moved or _missing_efforts(records) else "effort"


def _missing_efforts(records: Sequence[Record]) -> bool:
    """Return whether a record lacks the effort of a drive."""
    return any(
        joint.effort_column not in record.columns
        for record in records
        for joint in record.crane.layout.driven
    )


def _check_determined(p: Parameter, records: Sequence[Record], drives: Drives) -> None:
    """Check that some column can determine a parameter.

    Raises:
        DataError: If the column is missing or constant.
        OutOfRange: If the parameter has no effect with these drives.
    """
    needed = {"lag": "motion", "friction": "motion", "stiffness": "hold", "damping": "hold"}
    if drives != needed.get(p.kind, drives):
        raise OutOfRange(f"drives beside {p.name}", drives, needed[p.kind])
    for joint in records[0].crane.layout.joints:
        column = {
            "lag": joint.setpoint_column,
            "friction": joint.effort_column,
            "bias": joint.columns[0],
        }.get(p.kind)
        if joint.symbol != p.of or column is None or any(r.moves(column) for r in records):
            continue
        recorded = any(column in record.columns for record in records)
        raise DataError(
            f"{p.name} cannot be found: {column} {'never moves' if recorded else 'is not there'}."
        )
