"""What a record would show of a crane with given numbers: all variants of it in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from cranedyn.arguments import check_word, checked
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import DataError, OutOfRange
from cranedyn.identification.family import Family
from cranedyn.identification.known import Known
from cranedyn.identification.motion import Rows, lagged, recorded_motion, recorded_setpoint
from cranedyn.identification.parameters import (
    EARLY,
    LATE,
    Drives,
    Parameter,
    parameter,
    starts,
    usual,
)
from cranedyn.identification.record import Record, setpoint_column
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate

PERIODS = {"motion": 0.01, "effort": 5e-3, "hold": 5e-3}
"""Time between control instants, which is that between steps [s]: drives that are prescribed are
smooth, a brake holds its command for one."""

_CHANGE = 1e-6

_SMOOTH = {"rad": 1e-3, "m": 1e-2}
"""Rate at which dry friction is three quarters of itself [per second], which makes it smooth."""


class Channel(NamedTuple):
    """A column of a record that is predicted.

    Attributes:
        column: Its name.
        unit: Its unit.
        kind: What it shows.
        at: Which swing or drive, by its place among the coordinates.
        drive: The same among the drives; -1 for a swing.
    """

    column: str
    unit: str
    kind: str
    at: int
    drive: int = -1


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
    @checked
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
                "hold" holds the drives at their setpoints by a brake; None for the motion where a
                record has one, else the efforts.

        Raises:
            DataError: If there is no record, it lacks what this needs, or a column never moves that
                a parameter needs.
            UnknownName: If a name stands for nothing.
        """
        if not records:
            raise DataError("There is no record to identify a crane from; give one or more.")
        way = _way(records) if drives is None else drives
        check_word("drives", way, Drives)
        chosen = usual(known, records, way) if names is None else list(dict.fromkeys(names))
        if not chosen:
            raise DataError("There is nothing to find; give names of parameters.")
        found = [parameter(known, name) for name in chosen]
        for one in found:
            _check_tells(one, records, way)
        found += [one for i, record in enumerate(records) for one in starts(record, i, way)]
        return cls(known, tuple(records), tuple(found), way)

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
        count = len(self.parameters)
        sign = np.array([-1.0 if one.start + one.scale > one.high else 1.0 for one in
                         self.parameters])  # fmt: skip
        tried, most = 1e-3 * sign * self.scale, np.zeros(count)
        for index in range(len(self.records)):
            places, measured = self.of_record(index), self.measured(index)
            variants = np.tile(self.first, (len(places) + 1, 1))
            variants[np.arange(1, len(places) + 1), places] += tried[places]
            shown = self.predicted(index, variants)
            change = np.abs(shown[1:] - shown[0]).max(axis=2)
            share = (change / np.maximum(np.ptp(measured, axis=1), 1e-9)).max(axis=1)
            most[places] = np.maximum(most[places], np.where(np.isfinite(share), share, 0.0))
        factor = np.where(most > 0.0, _CHANGE / np.maximum(most, 1e-300), 1.0)
        return tried * np.clip(factor, 1e-6, 1e6)

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
                and ({position, setpoint_column(joint)} <= record.columns.keys())
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


class Variants:
    """One record made again by variants of the crane, each with its values of the parameters."""

    def __init__(self, model: Model, index: int, values: np.ndarray, until: float = np.inf) -> None:
        self.model, self.index, self.values = model, index, values
        self.record, self.layout = model.records[index], model.known.crane.layout
        self.period = PERIODS[model.drives]
        self.rows = model.rows(index, until)
        lasts = float(self.record.t[self.rows[-1]]) if len(self.rows) else 0.0
        late = any(one.kind == "delay" for one in model.parameters)
        count = int(np.ceil((lasts - (EARLY if late else 0.0)) / self.period)) + 2
        self.grid = self.period * np.arange(count)
        self.inside = np.minimum(self.grid, self.record.t[-1])
        self.places = {one.name: i for i, one in enumerate(model.parameters) if one.record is None}
        self.own = {
            (one.kind, one.of): i for i, one in enumerate(model.parameters) if one.record == index
        }

    def value(self, name: str, otherwise: float = 0.0) -> np.ndarray:
        """A parameter of the crane in each variant, shape (variants,)."""
        place = self.places.get(name)
        return np.full(len(self.values), otherwise) if place is None else self.values[:, place]

    def cranes(self) -> list[Crane]:
        """The crane of each variant, the same object where it is the same crane."""
        family = self.model.family
        places = [self.places[name] for name in family.names]
        rows = [tuple(row) for row in self.values[:, places].tolist()]
        made = {row: family.at(np.array(row)) for row in dict.fromkeys(rows)}
        return [made[row] for row in rows]

    def batch(self) -> Batch:
        """All variants simulated."""
        cranes, start = self.cranes(), self.start()
        controller, reference = self.laws(cranes)
        return simulate_batch(
            cranes,
            controller[0] if len(controller) == 1 else controller,
            reference[0] if len(reference) == 1 else reference,
            start=start,
            duration=self.duration,
            dt=self.period,
            control_period=self.period,
            drive=self.drive,
            integrator=rk4,
            record=1,
        )

    def laws(self, cranes: Sequence[Crane]) -> tuple[list[Any], list[Any]]:
        """Controllers and references, one for all variants or one for each."""
        still = [hold(cranes[0], cranes[0].start)]
        if self.model.drives == "motion":
            rows = [Rows(self.period, *one) for one in zip(*self.motion, strict=True)]
            return [follow(cranes[0], one, self.period) for one in rows], still
        return ([self._efforts()], still) if self.model.drives == "effort" else self._brakes()

    @property
    def duration(self) -> float:
        """How long it runs [s]."""
        return float(self.period * (len(self.grid) - 1))

    @property
    def drive(self) -> Drive:
        """How the drives take commands."""
        return "motion" if self.model.drives == "motion" else "effort"

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the drives are and how they move, shape (variants or 1, rows, m) each."""
        lags = [self.value(f"{j.symbol}_lag") for j in self.layout.driven]
        driven = self.layout.driven
        motions = [
            recorded_motion(self.record, joint, float(self.model.known.crane.start.q[at]))
            for joint, at in zip(driven, self.layout.drives, strict=True)
        ]
        aimed = any(motion is None for motion in motions)
        variants = len(self.values) if aimed else 1
        position = np.empty((variants, len(self.grid), self.layout.m))
        velocity = np.empty_like(position)
        for i, (joint, motion) in enumerate(zip(driven, motions, strict=True)):
            if motion is not None:
                position[:, :, i], velocity[:, :, i] = motion(self.inside), motion(self.inside, 1)
                continue
            aim = recorded_setpoint(self.record, joint)(self.inside)
            for lane in range(variants):
                position[lane, :, i], velocity[lane, :, i] = lagged(
                    aim, self.period, float(lags[i][lane])
                )
        return position, velocity

    def start(self) -> State:
        """Where each variant begins."""
        position, velocity = self.motion
        crane, variants = self.model.known.crane, len(self.values)
        q = np.tile(crane.start.q, (variants, 1))
        v = np.zeros_like(q)
        q[:, self.layout.drives] = position[:, 0]
        v[:, self.layout.drives] = velocity[:, 0]
        for (kind, symbol), place in self.own.items():
            if kind == "start":
                q[:, self.layout.index(symbol)] = self.values[:, place]
            elif kind == "start rate":
                v[:, self.layout.index(symbol)] = self.values[:, place]
        for joint, at in zip(self.layout.driven, self.layout.drives, strict=True):
            q[:, at] += self.value(f"{joint.symbol}_offset")
        return State(q, v)

    def _efforts(self) -> Tracking:
        """What acts as recorded, each effort until the next row."""
        rows = np.searchsorted(self.record.t, self.grid + 1e-9 * self.period, side="right") - 1
        rows = np.clip(rows, 0, len(self.record.t) - 1)
        efforts = np.stack(
            [self.record.columns[joint.effort_column][rows] for joint in self.layout.driven], axis=1
        )
        width = 2 * self.layout.n
        gain = np.zeros((len(rows), self.layout.m, width))
        return Tracking(self.period, efforts, gain, np.zeros((len(rows), width)))

    def _brakes(self) -> tuple[list[Any], list[Any]]:
        usual, crane = hold_controller(self.model.known.crane), self.model.known.crane
        gains = {
            kind: np.stack(
                [
                    self.value(f"{joint.symbol}_{kind}", float(getattr(usual, kind)[i]))
                    for i, joint in enumerate(self.layout.driven)
                ],
                axis=1,
            )
            for kind in ("stiffness", "damping")
        }
        aims = self._setpoints()
        laws = [
            Hold(crane, stiff, damped, usual.feed_forward)
            for stiff, damped in zip(gains["stiffness"], gains["damping"], strict=True)
        ]
        still = np.zeros_like(aims[0])
        return laws, [Rows(self.period, aim, still) for aim in aims]

    def _setpoints(self) -> np.ndarray:
        """Setpoints of the drives as recorded, or where they are held, in the true coordinate,
        shape (variants, rows, m).
        """
        aims = np.empty((len(self.values), len(self.grid), self.layout.m))
        for i, (joint, at) in enumerate(zip(self.layout.driven, self.layout.drives, strict=True)):
            column, own = setpoint_column(joint), self.own.get(("setpoint", joint.symbol))
            if column in self.record.columns:
                aims[:, :, i] = recorded_setpoint(self.record, joint)(self.inside)
            elif own is not None:
                aims[:, :, i] = self.values[:, own][:, None]
            else:
                still = self.record.columns.get(
                    joint.columns[0], self.model.known.crane.start.q[at]
                )
                aims[:, :, i] = np.mean(still)
            aims[:, :, i] += self.value(f"{joint.symbol}_offset")[:, None]
        return aims

    def outputs(self, batch: Batch) -> np.ndarray:
        """What the record would show of a batch, shape (variants, channels, rows)."""
        channels, t = self.model.channels[self.index], self.record.t[self.rows]
        found = np.empty((len(self.values), len(channels), len(t)))
        for c, channel in enumerate(channels):
            if channel.kind == "swing":
                late = self.value("delay")
                symbol = self.layout.symbols[channel.at]
                place = self._between(batch, channel.at, t[None] - late[:, None])
                found[:, c] = place + self.value(f"{symbol}_bias")[:, None]
            elif channel.kind == "position":
                symbol = self.layout.symbols[channel.at]
                place = self._between(batch, channel.at, np.broadcast_to(t, found[:, c].shape))
                found[:, c] = place - self.value(f"{symbol}_offset")[:, None]
            elif channel.kind == "lagged":
                found[:, c] = self._lagged(channel, t)
            else:
                found[:, c] = self._effort(batch, channel, t)
        return found

    def _between(self, batch: Batch, at: int, times: np.ndarray) -> np.ndarray:
        """A coordinate at times [s] of each variant, by the cubic through places and rates; shape
        (variants, rows).
        """
        where = np.clip(times / self.period, 0.0, len(self.grid) - 1.001)
        k = where.astype(int)
        s = where - k
        q0, q1 = (np.take_along_axis(batch.q[:, :, at], k + i, axis=1) for i in (0, 1))
        v0, v1 = (
            self.period * np.take_along_axis(batch.v[:, :, at], k + i, axis=1) for i in (0, 1)
        )
        rise = q1 - q0
        return q0 + s * (v0 + s * (3.0 * rise - 2.0 * v0 - v1 + s * (v0 + v1 - 2.0 * rise)))

    def _lagged(self, channel: Channel, t: np.ndarray) -> np.ndarray:
        joint = self.layout.joints[channel.at]
        aim = recorded_setpoint(self.record, joint)(self.inside)
        return np.array(
            [
                np.interp(t, self.grid, lagged(aim, self.period, float(lag))[0])
                for lag in self.value(f"{joint.symbol}_lag")
            ]
        )

    def _effort(self, batch: Batch, channel: Channel, t: np.ndarray) -> np.ndarray:
        """What the motion costs a drive, dry friction among it: the mean over each period, which
        stands in its middle.
        """
        joint = self.layout.joints[channel.at]
        rate = batch.v[:, :, channel.at]
        friction = self.value(f"{joint.symbol}_friction")[:, None]
        cost = batch.effort[:, :, channel.drive] + friction * np.tanh(rate / _SMOOTH[joint.unit])
        middle = self.grid + self.period / 2.0
        return np.array([np.interp(t, middle, lane) for lane in cost])


def _way(records: Sequence[Record]) -> Drives:
    """How drives are made again if nothing is said."""
    for record in records:
        driven = record.crane.layout.driven
        if any(
            {*joint.columns, setpoint_column(joint)} & record.columns.keys() for joint in driven
        ):
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
        "lag": joint and setpoint_column(joint),
        "friction": joint and joint.effort_column,
        "bias": joint and joint.columns[0],
    }.get(one.kind)
    if column and not any(record.moves(column) for record in records):
        there = any(column in record.columns for record in records)
        raise DataError(
            f"{one.name} cannot be found: {column} {'never moves' if there else 'is not there'}."
        )
