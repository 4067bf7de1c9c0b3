"""Checked records of a crane: times, drives, swing.

`load_record` reads a file, and `Record.of` checks its columns. Columns of drives whose derivatives
would be noise are replaced by smooth curves, see `cranedyn.identification.sampling`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from cranedyn.checks import as_array, finite
from cranedyn.data.columns import BASE_COLUMNS
from cranedyn.data.external import Source, load_external
from cranedyn.data.logs import open_log
from cranedyn.disturbances.base_motion import UNITS, BaseCoordinates, BaseMotion
from cranedyn.dynamics.equations_of_motion import natural_frequencies
from cranedyn.errors import DataError
from cranedyn.identification.period import possible_periods, recorded_period
from cranedyn.identification.sampling import Samples, SmoothCurve, is_irregular, samples, smooth
from cranedyn.interop import bags
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint

MIN_PERIODS = 2.0
"""Least length of a record in periods of its swing."""

MIN_ROWS = 40
"""Least number of rows of a record."""

MAX_OFFSET_SHARE = 0.25
"""Largest offset of a recorded position, as a share of the range of its drive."""

_MAX_SWING = math.pi / 2
"""Largest swing [rad]."""

_STANDSTILL_RANGE = 1e-9
"""Largest change of a column that does not move [rad or m]."""

_IMPOSSIBLE_RATIO = 1.25
"""How far a recorded period lies beyond those of the crane, as a factor, where the crane cannot be
that of the record. Swings of 90 degrees last 18 % longer than small ones."""

_REMARKABLE_RATIO = 1.1
"""Factor between the period of a record and that of the crane from which on it is said."""

_MAX_GAP_STEPS = 5.0
"""Longest gap between rows in usual steps of the clock, unless `_MAX_GAP_SHARE` allows more."""

_MAX_GAP_SHARE = 0.1
"""Longest gap between rows as a share of a period of the swing, in which drives hardly change their
motion; the longer of both gaps is allowed."""

_MAX_MISFIT = 2.0
"""Mean square of the deviations from a smooth curve over their variance, from which on a column is
no smooth motion. It is one for white noise and less for rounding."""

_NOTABLE_NOISE = 0.2
"""Noise of a smoothed acceleration [m/s² or rad/s²] from which on it is told. It takes its square
over that of gravity from the mass that a hoist weighs, which is 0.04 % here."""

_BASE_DEGREE = 5
"""Degree of the spline through exact coordinates of a base: accelerations are smooth."""

_MIN_LEVELS = 20
"""Least number of values of a setpoint that changes gradually; one with fewer may jump."""

_MAX_STEP = 3.0
"""Largest usual step of a clock [s], a few rows in a period of a long rope."""

_TIME_ROUNDING = 1e-9
"""Round-off of times of rows [s]."""

_POSITION_ROUNDING = 1e-6
"""Round-off of positions of drives [rad or m]."""


@dataclass(frozen=True, eq=False)
class Record:
    """Record of a crane, in SI units; time counts from the first row.

    Attributes:
        name: Name of the record.
        crane: Crane with prior values.
        t: Times [s], shape (rows,).
        columns: Recorded columns by their names in a trajectory, shape (rows,) each.
        notes: Remarks about the record, a sentence each.
        resolution: Step of the grid of values of each column that was smoothed, by name.
        curves: Smooth curve of each column that was smoothed, by name. Times count as in the
            record. The position of a drive and its rate have one curve, by the position.
        unsmoothed: Values as recorded of each column that was smoothed and has a fresh value in
            each row, by name, shape (rows,) each.
        signs: Sign with which each column was taken that has not the recorded one, -1, by name.
        base: Recorded motion of the base on which the crane stands; None for a base at rest. Its
            times count as in the record.
    """

    name: str
    crane: Crane
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()
    resolution: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, SmoothCurve] = field(default_factory=dict)
    unsmoothed: Mapping[str, np.ndarray] = field(default_factory=dict)
    signs: Mapping[str, int] = field(default_factory=dict)
    base: BaseMotion | None = None

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
        """Return a record from columns, among them ``t_s`` and a swing; columns other than those of
        drives, swings and the base are left out.

        A crane on a base that moves has columns of it, see `cranedyn.data.columns.BASE_COLUMNS`:
        the place and the attitude of the crane's own origin, in the frames and with the signs of
        `cranedyn.disturbances.base_motion`. Coordinates without a column stay zero. The swing is
        then that relative to the crane, as encoders see it, and not that from the plumb line.

        Args:
            crane: Crane with prior values.
            columns: Columns by their names, such as ``phi_rad``, shape (rows,) each.
            name: Name of the record.
            since: Start of the record [s], on its own clock.
            until: End of the record [s].

        Raises:
            DataError: If there is no swing, all of it stands still or it is beyond 90 degrees, a
                drive is out of its range, time jumps or does not increase, it is too short, or the
                crane cannot swing in the period of the record.
        """
        t, recorded = _checked_columns(name, crane, columns, since, until)
        constant = _check_swings(name, crane, recorded)
        recorded = {key: values for key, values in recorded.items() if key not in constant}
        notes = [f"{name}: {key} never moves and is left out." for key in constant]

        # Period and length are judged by the rows as recorded, before columns are smoothed.
        as_recorded = cls(name, crane, t, recorded)
        remarks_on_period = _check_period(as_recorded)
        remarks_on_base = _remarks_on_base(as_recorded)
        _check_length(as_recorded)

        fresh = _resample(crane, t, recorded)
        notes += [f"{name}: {remark}" for remark in fresh.remarks]
        notes += _notes_on_unrecorded_drives(name, crane, fresh.columns)
        record = cls(
            name=name,
            crane=crane,
            t=fresh.t,
            columns=fresh.columns,
            notes=(*notes, *remarks_on_base, *remarks_on_period),
            resolution={key: curve.sampled.resolution for key, curve in fresh.curves.items()},
            curves=fresh.curves,
            unsmoothed=fresh.unsmoothed,
            base=fresh.base,
        )
        _check_rates(record)
        return record

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.t[-1])

    @property
    def interval(self) -> float:
        """Usual time from row to row [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def swings(self) -> tuple[Joint, ...]:
        """Recorded swings."""
        joints = (self.crane.layout.joints[i] for i in self.crane.swings.tolist())
        return tuple(joint for joint in joints if {*joint.columns} & self.columns.keys())

    def swing_column(self, joint: Joint) -> str:
        """Return the column of a recorded swing: its angle, or its rate where no angle is."""
        angle, rate = joint.columns
        return angle if angle in self.columns else rate

    @cached_property
    def mean_position(self) -> np.ndarray:
        """Coordinates with the drives where they stand on average, shape (n,)."""
        layout = self.crane.layout
        q = self.crane.start.q.copy()
        for joint, i in zip(layout.driven, layout.drives.tolist(), strict=True):
            if joint.columns[0] in self.columns:
                q[i] = float(np.mean(self.columns[joint.columns[0]]))
        return q

    @cached_property
    def swing_period(self) -> float:
        """Shortest period of small swings of the crane with the drives where they stand on average
        [s].
        """
        frequencies = natural_frequencies(self.crane, self.mean_position, self.crane.swings)
        fastest = float(frequencies[-1])
        return 2.0 * math.pi / fastest if fastest > 0.0 else math.inf

    @cached_property
    def recorded_period(self) -> float | None:
        """Shortest period of the recorded swings [s]; None where no period dominates any."""
        periods = list[float]()
        for joint in self.swings:
            column = self.swing_column(joint)
            is_rate = column == joint.columns[1]
            period = recorded_period(self.t, self.columns[column], is_rate=is_rate)
            if period is not None:
                periods.append(period)
        return min(periods, default=None)

    @property
    def judged_period(self) -> float:
        """Period by which the record is judged [s]: its own, or that of the crane where the record
        does not tell one.
        """
        return self.recorded_period or self.swing_period

    def turned(self, column: str) -> Record:
        """Return the record with the other sign of a column."""
        columns = {**self.columns, column: -self.columns[column]}
        signs = {**self.signs, column: -self.signs.get(column, 1)}
        note = f"{self.name}: {column} has the other sign and is turned."
        return replace(self, columns=columns, notes=(*self.notes, note), signs=signs)

    def measured(self, column: str) -> np.ndarray:
        """Return what a prediction of a column is compared with, shape (rows,): the values as
        recorded, whose errors have no memory, or a smoothed motion where most of them are stale.
        """
        return self.unsmoothed.get(column, self.columns[column])

    def measured_again(self, shifts: Mapping[str, float], rng: np.random.Generator) -> Record:
        """Return the record that sensors of the same resolutions and noise would have made of the
        smoothed motions, had they been mounted a little aside.

        Args:
            shifts: Where the grid of each smoothed column lies, -1/2 to 1/2 of its resolution, by
                name.
            rng: Random numbers, for noise.
        """
        columns = dict(self.columns)
        unsmoothed = dict(self.unsmoothed)
        of_base = dict[str, BSpline]()
        for key, curve in self.curves.items():
            again = curve.measured_again(shifts[key], rng)
            if key in BASE_COLUMNS:
                of_base[key] = again
                continue
            if key in unsmoothed:
                # The errors as recorded stay; only what the smoothing makes of them moves.
                unsmoothed[key] = unsmoothed[key] + again(self.t) - columns[key]
            columns |= _on_curve(self.crane, key, again, self.t)
        base = self.base
        if of_base:
            assert base is not None and isinstance(base.law, RecordedBase)
            base = _base_motion({**base.law.curves, **of_base}, base.law.last)
        return replace(self, columns=columns, unsmoothed=unsmoothed, base=base)

    def moves(self, column: str) -> bool:
        """Return whether a column was recorded and is not constant."""
        values = self.columns.get(column)
        return values is not None and bool(np.ptp(values) > _STANDSTILL_RANGE)


@dataclass(frozen=True, eq=False)
class RecordedBase:
    """Law of motion of a base by curves through its recorded coordinates.

    Attributes:
        curves: Curves through the columns, by their names in `BASE_COLUMNS`.
        last: Time of the last row [s]. Before the first and after the last row, the motion is that
            there.
    """

    curves: Mapping[str, BSpline]
    last: float

    def __call__(self, times: np.ndarray) -> BaseCoordinates:
        """Return the coordinates with rates and accelerations at times [s], shape (k,)."""
        inside = np.clip(times, 0.0, self.last)
        orders = np.zeros((3, len(times), len(BASE_COLUMNS)))
        for column, key in enumerate(BASE_COLUMNS):
            curve = self.curves.get(key)
            if curve is not None:
                for order in range(3):
                    orders[order, :, column] = curve(inside, order)
        return BaseCoordinates(*orders)


def _base_motion(curves: Mapping[str, BSpline], last: float) -> BaseMotion | None:
    """Return the motion of a base; None for one of which nothing is recorded."""
    return BaseMotion(RecordedBase(curves, last), source="a record") if curves else None


def _remarks_on_base(record: Record) -> list[str]:
    """Return a sentence on the base if it is recorded, else none."""
    recorded = [key for key in BASE_COLUMNS if key in record.columns]
    if not recorded:
        return []
    remark = f"{record.name}: the crane stands on a base with {', '.join(recorded)}"
    if not _base_moves(record):
        return [f"{remark}, which stands still."]
    return [
        f"{remark}; its swing is taken as that relative to the crane, and its period is not judged."
    ]


def _base_moves(record: Record) -> bool:
    """Return whether the base of a record moves."""
    return any(record.moves(key) for key in BASE_COLUMNS)


def _checked_columns(
    name: str, crane: Crane, columns: Mapping[str, np.ndarray], since: float, until: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times [s] from `since` to `until`, and the columns that identification reads at
    these times; all of them finite, with positions in the ranges of the drives.

    Raises:
        DataError: If there are no times, a number is not finite, time jumps or does not increase,
            or a drive is out of its range.
    """
    t = columns.get("t_s")
    if t is None:
        raise DataError(f"{name} has no column t_s; identification needs times [s].")
    t = as_array(f"t_s of {name}", t, ("rows",))
    recorded = {}
    for key in relevant_columns(crane, columns):
        if key != "t_s":
            recorded[key] = as_array(f"{key} of {name}", columns[key], (len(t),))
    # Nothing outside of these times is judged.
    if since > -math.inf or until < math.inf:
        mask = (t >= since - _TIME_ROUNDING) & (t <= until + _TIME_ROUNDING)
        t = t[mask]
        recorded = {key: values[mask] for key, values in recorded.items()}
    t = finite(f"t_s of {name}", t, ("rows",), unit="s")
    for key, values in recorded.items():
        finite(f"{key} of {name}", values, (len(t),))
    _check_clock(name, t)
    _check_positions(name, crane, recorded)
    return t, recorded


def _notes_on_unrecorded_drives(
    name: str, crane: Crane, columns: Mapping[str, np.ndarray]
) -> list[str]:
    """Return a sentence for each drive of which nothing is recorded."""
    notes = []
    starts = crane.start.q[crane.layout.drives].tolist()
    for joint, start in zip(crane.layout.driven, starts, strict=True):
        drive_columns = {*joint.columns, joint.setpoint_column, joint.effort_column}
        if not drive_columns & columns.keys():
            notes.append(
                f"{name}: nothing is recorded of {joint.symbol}, taken to stand at {start:g} "
                f"{joint.unit}."
            )
    return notes


@dataclass(frozen=True, eq=False)
class _FreshRows:
    """Rows in which a swing is fresh, with smooth motions of the drives.

    Attributes:
        t: Times from the first of these rows [s], shape (rows,).
        columns: Columns, shape (rows,) each.
        curves: Smooth curves by the columns that they were made of.
        unsmoothed: These columns as recorded where each row is fresh, shape (rows,) each.
        remarks: What was done, a sentence each.
        base: Motion of the base; None if none is recorded.
    """

    t: np.ndarray
    columns: dict[str, np.ndarray]
    curves: dict[str, SmoothCurve]
    unsmoothed: dict[str, np.ndarray]
    remarks: list[str]
    base: BaseMotion | None


def _resample(crane: Crane, t: np.ndarray, columns: Mapping[str, np.ndarray]) -> _FreshRows:
    """Return the rows in which a swing is fresh, with smooth motions of the drives.

    A column of a drive that is sampled in each row, by a regular clock, and whose derivatives are
    no noise, stays as it is.

    Args:
        crane: Crane with prior values.
        t: Times [s], shape (rows,).
        columns: Columns by their names, shape (rows,) each.
    """
    remarks = list[str]()
    rows = np.arange(len(t))
    sampled_swings = [samples(t, columns[key]) for key in _swing_columns(crane, columns)]
    if sampled_swings and all(sampled.is_held for sampled in sampled_swings):
        rows = np.unique(np.concatenate([sampled.rows for sampled in sampled_swings]))
        remarks.append(
            f"{len(rows)} of {len(t)} rows bring a fresh swing, every "
            f"{1e3 * sampled_swings[0].interval:.0f} ms; the others are left out."
        )
    # The first row is always fresh: times count from there.
    t = t - t[0]
    fresh = {key: values[rows] for key, values in columns.items()}
    curves = dict[str, SmoothCurve]()
    unsmoothed = dict[str, np.ndarray]()
    for joint in crane.layout.driven:
        position, rate = joint.columns
        for key, curve in _smooth_curves(joint, t, columns).items():
            curves[key] = curve
            if not curve.sampled.is_held:
                unsmoothed[key] = columns[key][rows]
            fresh |= _on_curve(crane, key, curve.spline, t[rows])
            remarks.append(_smoothing_remark(key, joint, curve))
        has_both = position in columns and rate in columns
        if has_both and position not in curves and not samples(t, columns[rate]).is_exact(1):
            # The positions are exact: their derivative is better than the recorded rate.
            fresh[rate] = CubicSpline(t, columns[position])(t[rows], 1)
    of_base = dict[str, BSpline]()
    for key, unit in zip(BASE_COLUMNS, UNITS, strict=True):
        if key not in columns:
            continue
        sampled = samples(t, columns[key])
        if np.ptp(columns[key]) > _STANDSTILL_RANGE and _needs_smoothing(t, sampled, 2):
            curves[key] = smooth(t, columns[key], sampled)
            of_base[key] = curves[key].spline
            remarks.append(_remark_on_curve(key, unit, curves[key], is_position=True))
        else:
            of_base[key] = make_interp_spline(t, columns[key], k=_BASE_DEGREE)
    base = _base_motion(of_base, float(t[-1]))
    return _FreshRows(t[rows], fresh, curves, unsmoothed, remarks, base)


def _smooth_curves(
    joint: Joint, t: np.ndarray, columns: Mapping[str, np.ndarray]
) -> dict[str, SmoothCurve]:
    """Return smooth curves of the motion and of the setpoint of a drive by their columns, as far as
    they are recorded and need smoothing.
    """
    position, rate = joint.columns
    # Where both are recorded the position tells more than the rate, which is then the derivative of
    # its curve. Of a motion the acceleration counts: the second derivative of a position, or the
    # first one of a rate. Of a setpoint its rate counts.
    candidates = [(rate, 1), (joint.setpoint_column, 1)]
    if position in columns:
        candidates = [(position, 2), (joint.setpoint_column, 1)]
    curves = {}
    for key, order in candidates:
        if key not in columns or np.ptp(columns[key]) <= _STANDSTILL_RANGE:
            continue
        sampled = samples(t, columns[key])
        if not _needs_smoothing(t, sampled, order):
            continue
        curve = smooth(t, columns[key], sampled)
        if key != joint.setpoint_column or _is_gradual(columns[key], curve):
            curves[key] = curve
    return curves


def _needs_smoothing(t: np.ndarray, sampled: Samples, order: int) -> bool:
    """Return whether some derivative of the samples, of order one or two, is noise."""
    return sampled.is_held or is_irregular(t) or not sampled.is_exact(order)


def _is_gradual(values: np.ndarray, curve: SmoothCurve) -> bool:
    """Return whether a setpoint is a smooth motion with rounding or noise; a setpoint may jump."""
    return curve.misfit <= _MAX_MISFIT and len(np.unique(values)) >= _MIN_LEVELS


def _on_curve(crane: Crane, key: str, curve: BSpline, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return a column by its smooth curve at some times [s], and beside a position its rate."""
    for joint in crane.layout.driven:
        position, rate = joint.columns
        if key == position:
            return {position: curve(t), rate: curve.derivative()(t)}
    return {key: curve(t)}


def _smoothing_remark(key: str, joint: Joint, curve: SmoothCurve) -> str:
    """Return a sentence on what was smoothed of a drive, and by how much."""
    unit = joint.unit if key != joint.columns[1] else f"{joint.unit}/s"
    return _remark_on_curve(key, unit, curve, is_position=key == joint.columns[0])


def _remark_on_curve(key: str, unit: str, curve: SmoothCurve, *, is_position: bool) -> str:
    """Return a sentence on how a column was smoothed, and by how much.

    Args:
        key: The column.
        unit: Its unit.
        curve: The curve.
        is_position: Whether its second derivative is an acceleration.
    """
    sampled = curve.sampled
    fresh = f"{key} brings a fresh value every {1e3 * sampled.interval:.0f} ms"
    if sampled.resolution > 0.0:
        fresh += f" in steps of {sampled.resolution:.2g} {unit}"
    if sampled.noise > 0.0:
        fresh += f" with noise of {sampled.noise:.2g} {unit}"
    remark = f"{fresh}, smoothed by {curve.deviation:.2g} {unit}."
    doubt = ""
    if curve.misfit > _MAX_MISFIT:
        doubt = f"deviates from any smooth motion by {math.sqrt(curve.misfit):.2g} times as much"
    elif is_position and curve.acceleration_noise > _NOTABLE_NOISE:
        noise = f"{curve.acceleration_noise:.2g} {unit}/s²"
        doubt = f"changes so abruptly that noise of {noise} is left in its acceleration"
    if doubt:
        return f"{remark[:-1]}, but it {doubt}: intervals may not hold the truth."
    return remark


def relevant_columns(crane: Crane, present: Collection[str]) -> list[str]:
    """Return those of some columns that identification reads: times, swings, the drives with their
    setpoints and efforts, and the base. The rate of a swing is read where its angle is not there.
    """
    names = ["t_s", *_swing_columns(crane, present)]
    for joint in crane.layout.driven:
        names += [*joint.columns, joint.setpoint_column, joint.effort_column]
    names += BASE_COLUMNS
    return [name for name in names if name in present]


def _swing_columns(crane: Crane, present: Collection[str]) -> list[str]:
    """Return the column of each recorded swing: its angle, or its rate where no angle is."""
    columns = []
    for i in crane.swings.tolist():
        angle, rate = crane.layout.joints[i].columns
        if angle in present:
            columns.append(angle)
        elif rate in present:
            columns.append(rate)
    return columns


def load_record(
    path: str | Path,
    crane: Crane,
    *,
    sources: Mapping[str, Source] | None = None,
    joints: Mapping[str, str] | None = None,
    since: float = -math.inf,
    until: float = math.inf,
) -> Record:
    """Load a record from a file; columns other than those of drives, swings and the base are not
    read.

    Args:
        path: A table in a format of `cranedyn.data.logs`; or ``.mcap``, ``.db3``, ``.bag`` or a
            folder of ROS 2 with joint states.
        crane: Crane with prior values.
        sources: Names and units of the columns of a table, by the names of cranedyn, see
            `cranedyn.data.external.parse_sources`.
        joints: Names of the joints in a recording of ROS by the symbols of coordinates, where they
            are not those of the crane.
        since: Start of the record [s], on its own clock.
        until: End of the record [s].

    Raises:
        DataError: As `cranedyn.data.external.read_external`,
            `cranedyn.interop.bags.read_joint_states` and `Record.of`.
        UnknownName: If a source names an unknown column.
    """
    path = Path(path)
    if bags.is_recording(path):
        present = {"t_s", *bags.joint_state_columns(path, joints, layout=crane.layout)}
        names = relevant_columns(crane, present)
        data: Mapping[str, np.ndarray] = bags.read_joint_states(
            path, names, joints, layout=crane.layout, since=since, until=until
        )
        return Record.of(crane, data, name=path.name, since=since, until=until)
    sources = sources or {}
    log = open_log(path)
    names = relevant_columns(crane, {"t_s", *log.names, *sources})
    table = load_external(
        log,
        list(dict.fromkeys([*names, *sources])),
        sources,
        since=since,
        until=until,
        filling="hold",
    )
    record = Record.of(crane, table.columns, name=path.name, since=since, until=until)
    remarks = tuple(f"{path.name}: {remark}." for remark in table.remarks)
    return replace(record, notes=(*remarks, *record.notes))


def _check_clock(name: str, t: np.ndarray) -> None:
    """Check that times increase, by steps that can be seconds.

    Raises:
        DataError: If they do not, or there are not even two.
    """
    if len(t) < 2:
        raise DataError(
            f"{name} has {len(t)} rows to go by; allowed are {MIN_ROWS} or more. Where only a part "
            "of it is looked at, its rows may lie outside of that time."
        )
    steps = np.diff(t)
    if not (steps > 0.0).all():
        # The first row is row 1, and the first step leads to row 2.
        row = int(np.argmin(steps)) + 2
        raise DataError(
            f"{name}: t_s does not increase at row {row} of {len(t)}, a clock that jumps back; "
            "allowed are times that increase."
        )
    usual = float(np.median(steps))
    if usual > _MAX_STEP:
        raise DataError(
            f"{name}: t_s increases by {usual:.3g} s from row to row; allowed are {_MAX_STEP:g} s. "
            "Is it in ms? Then say so: --columns t_s=NAME[ms]."
        )


def _check_positions(name: str, crane: Crane, columns: Mapping[str, np.ndarray]) -> None:
    """Check that positions and setpoints of the drives are in their ranges, but for an offset.

    Raises:
        DataError: If one is not.
    """
    for joint, i in zip(crane.layout.driven, crane.layout.drives.tolist(), strict=True):
        drive_range = crane.upper[i] - crane.lower[i]
        offset = MAX_OFFSET_SHARE * drive_range + _POSITION_ROUNDING
        low = crane.lower[i] - offset
        high = crane.upper[i] + offset
        for key in {joint.columns[0], joint.setpoint_column} & columns.keys():
            outside = columns[key][(columns[key] < low) | (columns[key] > high)]
            if len(outside):
                other = "mm" if joint.unit == "m" else "deg"
                raise DataError(
                    f"{name}: {key} is {outside[0]:.4g} {joint.unit} in some row; allowed is "
                    f"{low:.4g} to {high:.4g}, the range of the drive and a quarter more. If it is "
                    f"in {other}, say so: --columns {key}={key}[{other}]."
                )


def _check_swings(name: str, crane: Crane, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Return the names of swing columns that never move; at least one other does.

    Raises:
        DataError: If there is no swing, none moves, or one is beyond 90 degrees.
    """
    present = _swing_columns(crane, columns)
    if not present:
        needed: list[str] = []
        for i in crane.swings.tolist():
            needed += crane.layout.joints[i].columns
        raise DataError(f"{name} has no swing column; one of {', '.join(needed)} is needed.")
    for key in present:
        peak = float(np.abs(columns[key]).max(initial=0.0))
        if peak > _MAX_SWING and not key.endswith("_s"):
            raise DataError(
                f"{name}: {key} is {peak:.4g} rad in some row; a swing is {_MAX_SWING:.4f} rad (90 "
                f"degrees) at most. If it is in degrees, say so: --columns {key}={key}[deg]."
            )
    constant = [key for key in present if np.ptp(columns[key]) <= _STANDSTILL_RANGE]
    if constant == present:
        raise DataError(
            f"{name}: {', '.join(constant)} never moves; a load that does not swing, or a sensor "
            "that is not connected, says nothing."
        )
    return constant


def _check_rates(record: Record) -> None:
    """Check that recorded rates of swings are those of swings of up to 90 degrees.

    Raises:
        DataError: If they are not.
    """
    for joint in record.swings:
        key = record.swing_column(joint)
        # An oscillation of the period T with the rate v has the amplitude v T / (2 π).
        swing = np.ptp(record.columns[key]) / 2.0 * record.judged_period / (2.0 * math.pi)
        if key.endswith("_s") and swing > _MAX_SWING:
            raise DataError(
                f"{record.name}: {key} is that of a swing of {swing:.3g} rad; allowed are "
                f"{_MAX_SWING:.4f} rad (90 degrees). If it is in degrees, say so: --columns "
                f"{key}={key}[deg/s]."
            )


def _check_period(record: Record) -> list[str]:
    """Compare the period of a record with those that the crane can have, and return what is
    remarkable, a sentence each.

    Raises:
        DataError: If the crane cannot swing in the period of the record, however long its cable.
    """
    own = record.recorded_period
    crane = record.crane
    if _base_moves(record):
        # The load swings in the period of the base, too, whatever that of the crane is.
        return []
    if own is None or 1.0 / _REMARKABLE_RATIO < own / record.swing_period < _REMARKABLE_RATIO:
        return []
    offset = 0.0
    if crane.winch is not None:
        hoist = int(crane.layout.drives[crane.winch])
        offset = MAX_OFFSET_SHARE * float(crane.upper[hoist] - crane.lower[hoist])
    possible = possible_periods(crane, record.mean_position, offset)
    swing = " and ".join(record.swing_column(joint) for joint in record.swings)
    heavy = _described_inertias(crane)
    # Drives that move force swings of their own period, which may be as long as one likes.
    if own < possible.shortest / _IMPOSSIBLE_RATIO:
        limit = f"{possible.shortest:.3g} s or more"
    elif own > possible.longest * _IMPOSSIBLE_RATIO and not _is_driven(record):
        limit = f"{possible.longest:.3g} s or less"
    else:
        return [
            f"{record.name}: {swing} swings in {own:.3g} s, but the crane with {heavy} in "
            f"{record.swing_period:.3g} s; a cable of another length, or other masses and "
            "inertias, may explain that."
        ]
    raise DataError(
        f"{record.name}: {swing} swings in {own:.3g} s, but the crane with {heavy} only in "
        f"{limit}, whatever the length of its cable. State those of the crane that was recorded: "
        "--set payload_mass:=… payload_inertia:=… dummy_mass:=… dummy_inertia:=…, or another "
        "description."
    )


def _is_driven(record: Record) -> bool:
    """Return whether some drive moves in a record, or is meant to."""
    for joint in record.crane.layout.driven:
        for column in (*joint.columns, joint.setpoint_column):
            if record.moves(column):
                return True
    return False


def _described_inertias(crane: Crane) -> str:
    """Return the mass and the inertia of the load in words, and those of the links on the way."""
    inertia = float(np.max(np.diag(crane.payload_inertia)))
    load = f"a load of {crane.payload_mass:g} kg and {inertia:g} kg m²"
    if crane.winch is None:
        return load
    # The load hangs on the hoist, so that these bodies are links without a load.
    links = [crane.model.inertias[i + 1].inertia for i in crane.swings.tolist()]
    sizes = ", ".join(f"{float(np.max(np.diag(link))):g}" for link in links)
    return f"{load} and links of {sizes} kg m² between its swing joints"


def _check_length(record: Record) -> None:
    """Check that a record is long enough and has no gap.

    Raises:
        DataError: If it has too few rows, lasts too few periods of its swing, or has a gap.
    """
    name = record.name
    t = record.t
    if len(t) < MIN_ROWS:
        raise DataError(f"{name} has {len(t)} rows to go by; allowed are {MIN_ROWS} or more.")
    period = record.judged_period if math.isfinite(record.judged_period) else 0.0
    if t[-1] - t[0] < MIN_PERIODS * period:
        raise DataError(
            f"{name} lasts {t[-1] - t[0]:.3g} s; allowed is {MIN_PERIODS * period:.3g} s or more, "
            f"{MIN_PERIODS:g} periods of its swing."
        )
    steps = np.diff(t)
    worst = int(np.argmax(steps))
    allowed = max(_MAX_GAP_STEPS * np.median(steps), _MAX_GAP_SHARE * period)
    if steps[worst] > allowed:
        raise DataError(
            f"{name}: t_s goes from {t[worst]:g} to {t[worst + 1]:g} s at row {worst + 2}, a gap "
            f"or a clock that jumps; allowed is {allowed:.3g} s."
        )
