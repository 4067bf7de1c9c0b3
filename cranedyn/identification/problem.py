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
from cranedyn.identification.checked_record import Record
from cranedyn.identification.parameters import (
    Drives,
    Parameter,
    bound_lateness,
    default_names,
    initial_parameters,
    parameter,
)
from cranedyn.identification.prior import Family, Prior
from cranedyn.model.layout import Joint

_DELAY_START_SHARE = 0.6
"""Share of the bounds of a delay from which further searches begin."""

_NEEDED_DRIVES = {
    "lag": "motion",
    "friction": "motion",
    "stiffness": "hold",
    "damping": "hold",
}
"""How the drives must be simulated for a parameter to have an effect, by its kind; all other kinds
have one in any case."""


class Channel(NamedTuple):
    """Column of a record that is predicted.

    Attributes:
        column: Name of the column.
        unit: Unit of the column.
        kind: Kind of the signal: "swing" for the angle or the rate of a swing, "position" for the
            simulated position of a drive, "lagged" for the position of a prescribed drive behind
            its setpoint, "effort" for the effort of a drive.
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
        if names is None:
            names = default_names(prior, records, mode)
        else:
            names = list(dict.fromkeys(names))  # each once, in the order given
        if not names:
            raise DataError("There is nothing to find; give names of parameters.")
        if mode == "effort" and _missing_efforts(records):
            needed = ", ".join(joint.effort_column for joint in prior.crane.layout.driven)
            raise DataError(
                f"A record has no effort of some drive; efforts that act need {needed}."
            )
        stated = _stated_columns(prior, signs or {})
        for column, sign in stated.items():
            if sign < 0:
                records = _with_turned_column(records, column)
        parameters = []
        for name in names:
            parameters.append(bound_lateness(parameter(prior, name), records))
        for p in parameters:
            _check_determined(p, records, mode)
        for i, record in enumerate(records):
            parameters += initial_parameters(record, i, mode)
        return cls(prior, tuple(records), tuple(parameters), mode, frozenset(stated))

    def alternatives(self) -> Iterator[Self]:
        """Yield the same problem with each swing of either sign, and with the search begun from
        other delays of the swing sensor.
        """
        columns = []
        for record in self.records:
            for joint in record.swings:
                column = record.swing_column(joint)
                if column not in columns and column not in self.stated_signs:
                    columns.append(column)
        delays = np.unique([0.0, *(_DELAY_START_SHARE * np.array(self.delay_bounds))]).tolist()
        for signs in product((1, -1), repeat=len(columns)):
            records: Sequence[Record] = self.records
            for column, sign in zip(columns, signs, strict=True):
                if sign < 0:
                    records = _with_turned_column(records, column)
            for delay in delays:
                is_this_problem = delay == 0.0 and all(sign > 0 for sign in signs)
                if not is_this_problem:
                    yield self._started_at(records, delay)

    def _started_at(self, records: Sequence[Record], delay: float) -> Self:
        """Return the problem with other records, from another first value of the delay [s]."""
        parameters = []
        for p in self.own:
            parameters.append(replace(p, start=delay) if p.kind == "delay" else p)
        for i, record in enumerate(records):
            parameters += initial_parameters(record, i, self.drives)
        return replace(self, records=tuple(records), parameters=tuple(parameters))

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
        low = np.array([p.low for p in self.parameters])
        high = np.array([p.high for p in self.parameters])
        return low, high

    @cached_property
    def scale(self) -> np.ndarray:
        """Typical change of each parameter, shape (parameters,)."""
        return np.array([p.scale for p in self.parameters])

    @cached_property
    def delay_bounds(self) -> tuple[float, float]:
        """Bounds of the delay of the swing sensor [s], zero where none is estimated."""
        for p in self.own:
            if p.kind == "delay":
                return p.low, p.high
        return 0.0, 0.0

    @cached_property
    def lateness_bounds(self) -> tuple[float, float]:
        """Bounds of the age [s] of the swing that a row reports, its window included."""
        earliest, latest = self.delay_bounds
        longest_window = max((p.high for p in self.own if p.kind == "window"), default=0.0)
        return earliest, latest + longest_window

    def of_record(self, index: int) -> list[int]:
        """Return the indices of the parameters on which a record depends."""
        return [i for i, p in enumerate(self.parameters) if p.record in (None, index)]

    @cached_property
    def family(self) -> Family:
        """Cranes by the values of the arguments among the parameters."""
        # Masses, inertias, damping and gravity enter linearly, so that a second value of each,
        # half a typical change from the first, determines all cranes.
        arguments = [p for p in self.parameters if p.kind == "argument"]
        first = {p.name: p.start for p in arguments}
        second = {p.name: p.start + 0.5 * p.scale for p in arguments}
        return self.prior.family(first, second)

    @cached_property
    def channels(self) -> tuple[tuple[Channel, ...], ...]:
        """Channels predicted of each record."""
        return tuple(self._channels(record) for record in self.records)

    def _channels(self, record: Record) -> tuple[Channel, ...]:
        """Return the columns of a record that are predicted: its swings, then those of the drives
        that are not prescribed or that some parameter changes.
        """
        layout = self.prior.crane.layout
        channels = []
        for joint in record.swings:
            column = record.swing_column(joint)
            unit = f"{joint.unit}/s" if column.endswith("_s") else joint.unit
            channels.append(Channel(column, unit, "swing", layout.index(joint.symbol)))
        for drive, joint in enumerate(layout.driven):
            if self.drives == "motion":
                channels += self._prescribed_channels(record, drive, joint)
            elif record.moves(joint.columns[0]):
                at = int(layout.drives[drive])
                channels.append(Channel(joint.columns[0], joint.unit, "position", at, drive))
        return tuple(channels)

    def _prescribed_channels(self, record: Record, drive: int, joint: Joint) -> list[Channel]:
        """Return the columns of a drive with a prescribed motion that depend on some parameter: its
        position behind the setpoint on its lag, its effort on the load or on friction.
        """
        names = {p.name for p in self.parameters}
        at = int(self.prior.crane.layout.drives[drive])
        position = joint.columns[0]
        channels = []
        is_recorded = {position, joint.setpoint_column} <= record.columns.keys()
        if f"{joint.symbol}_lag" in names and is_recorded:
            channels.append(Channel(position, joint.unit, "lagged", at, drive))
        carries_load = drive == self.prior.crane.winch and "payload_mass" in names
        has_friction = f"{joint.symbol}_friction" in names
        if (carries_load or has_friction) and joint.effort_column in record.columns:
            column = joint.effort_column
            channels.append(Channel(column, joint.effort_unit, "effort", at, drive))
        return channels

    def rows(self, index: int, until: float = np.inf) -> np.ndarray:
        """Return the indices of the rows of a record that are evaluated, up to a time [s].

        Where a delay or a window is estimated, rows near both ends are left out: it would shift
        them out of the record.
        """
        t = self.records[index].t
        earliest, latest = self.lateness_bounds
        # A late swing is that of a time before the row, by up to `latest`; an early one, with a
        # negative delay, that of a time behind it.
        end = min(t[-1] + earliest, until)
        return np.flatnonzero((t >= latest) & (t <= end))

    def measured(self, index: int, until: float = np.inf) -> np.ndarray:
        """Return the channels of a record, shape (channels, rows evaluated)."""
        record = self.records[index]
        rows = self.rows(index, until)
        columns = [channel.column for channel in self.channels[index]]
        return np.array([record.measured(column)[rows] for column in columns])


def _with_turned_column(records: Sequence[Record], column: str) -> list[Record]:
    """Return records with the other sign of a column, where they have it."""
    return [record.turned(column) if column in record.columns else record for record in records]


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
    if _missing_efforts(records):
        return "motion"
    for record in records:
        for joint in record.crane.layout.driven:
            if {*joint.columns, joint.setpoint_column} & record.columns.keys():
                return "motion"
    return "effort"


def _missing_efforts(records: Sequence[Record]) -> bool:
    """Return whether a record lacks the effort of a drive."""
    for record in records:
        for joint in record.crane.layout.driven:
            if joint.effort_column not in record.columns:
                return True
    return False


def _check_determined(p: Parameter, records: Sequence[Record], drives: Drives) -> None:
    """Check that some column can determine a parameter.

    Raises:
        DataError: If the column is missing or constant.
        OutOfRange: If the parameter has no effect with these drives.
    """
    needed_drives = _NEEDED_DRIVES.get(p.kind, drives)
    if drives != needed_drives:
        raise OutOfRange(f"drives beside {p.name}", drives, needed_drives)
    for joint in records[0].crane.layout.joints:
        if joint.symbol != p.of:
            continue
        column = _needed_column(p, joint)
        if column is None or any(record.moves(column) for record in records):
            continue
        is_recorded = any(column in record.columns for record in records)
        reason = "never moves" if is_recorded else "is not there"
        raise DataError(f"{p.name} cannot be found: {column} {reason}.")


def _needed_column(p: Parameter, joint: Joint) -> str | None:
    """Return the column that determines a parameter of a joint; None if it needs none of its
    own.
    """
    if p.kind == "lag":
        return joint.setpoint_column
    if p.kind == "friction":
        return joint.effort_column
    return joint.columns[0] if p.kind == "bias" else None
