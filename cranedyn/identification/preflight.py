"""Identifiability of parameters before an estimate: expected confidence intervals, pairs that the
records cannot separate, and further records that would separate them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.identification.checked_record import Record
from cranedyn.identification.drive_motion import lagged
from cranedyn.identification.estimate import Estimate, initial_noise, invert_information
from cranedyn.identification.least_squares import jacobian
from cranedyn.identification.parameters import initial_parameters
from cranedyn.identification.record_prediction import Model
from cranedyn.model.layout import Joint
from cranedyn.references.simple import Spline
from cranedyn.theory import point_period

MAX_CORRELATION = 0.95
"""Correlation, of either sign, from which on two parameters count as inseparable."""

_NORMAL_QUANTILE = 1.959963984540054
"""Half width of a 95 % interval over the standard error, of a normal error."""

_UNDETERMINED_SHARE = 0.25
"""Half width of an interval from which on records hardly determine a parameter, as a share of the
range between its bounds."""

_NEW_CHANNEL_NOISE = 1e-4
"""Noise of a column that no record has yet, as a share of the range of its drive."""

_ASSUMED_CABLE = 10.0
"""Cable length by which the period of the swing is estimated for a crane without a winch [m]."""

_MOVE_SIZES = {"m": 1.0, "rad": 0.15}
"""Largest distance of a proposed move by the unit of its drive."""

_MAX_MOVE_SHARE = 0.2
"""Largest distance of a proposed move, as a share of the range of its drive."""


class ParameterPair(NamedTuple):
    """Two parameters that the records cannot separate, and their correlation."""

    first: str
    second: str
    correlation: float


class Advice(NamedTuple):
    """Effect of a further record.

    Attributes:
        move: Motion to record.
        margins: Half widths of the intervals with this record, by name; inf for a parameter that
            is not determined.
        correlation: Largest correlation of the inseparable pairs with this record; 0 for no pair.
    """

    move: str
    margins: dict[str, float]
    correlation: float


@dataclass(frozen=True, eq=False)
class Preflight:
    """Identifiability of the parameters of a crane from its records.

    Attributes:
        margins: Half width of the 95 % interval that each parameter of the crane would have; inf
            where the records do not determine it.
        correlation: Correlations of these parameters, shape (parameters, parameters).
        inseparable: Pairs that the records cannot separate.
        undetermined: Parameters that the records hardly determine: half the interval is more than a
            quarter of the range between the bounds, or, without bounds, than the value itself.
        advice: Effects of further records, the best first; none where all parameters are
            determined, or drives are not prescribed.
    """

    margins: dict[str, float]
    correlation: np.ndarray
    inseparable: tuple[ParameterPair, ...]
    undetermined: tuple[str, ...]
    advice: tuple[Advice, ...] = ()

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Names of all parameters in `inseparable` and `undetermined`, each once."""
        names = []
        for pair in self.inseparable:
            names += [pair.first, pair.second]
        return tuple(dict.fromkeys([*names, *self.undetermined]))


def preflight(model: Model, estimate: Estimate | None = None) -> Preflight:
    """Predict confidence intervals from the curvature of the least squares.

    Args:
        model: Records and parameters.
        estimate: Values and noise to linearise at; None for the first values of the search and
            the noise from second differences.
    """
    if estimate is None:
        values = model.first
        noise = initial_noise(model)
    else:
        values = estimate.values
        noise = list(estimate.noise)
    names = [p.name for p in model.own]
    current = information(model, values, noise)
    margins, correlation = _margins_and_correlation(current)
    inseparable = _inseparable_pairs(names, correlation)
    result = Preflight(
        margins=dict(zip(names, margins.tolist(), strict=True)),
        correlation=correlation,
        inseparable=inseparable,
        undetermined=_undetermined(model, margins, values),
    )
    if not result.doubtful:
        return result
    advice = []
    for move, record in propose_records(model, values):
        further = _further_information(model, record, values, noise)
        reduced_margins, reduced_correlation = _margins_and_correlation(current + further)
        remaining = 0.0
        for pair in inseparable:
            rho = reduced_correlation[names.index(pair.first), names.index(pair.second)]
            remaining = max(remaining, abs(rho))
        expected = dict(zip(names, reduced_margins.tolist(), strict=True))
        advice.append(Advice(move, expected, remaining))

    def log_product_of_margins(entry: Advice) -> float:
        """Return the logarithm of the product of all margins that matter with a further record."""
        # Units of the margins scale all products alike, so that they do not change the order.
        return sum(np.log([entry.margins[name] for name in result.doubtful]))

    advice.sort(key=log_product_of_margins)
    return replace(result, advice=tuple(advice))


def _inseparable_pairs(names: Sequence[str], correlation: np.ndarray) -> tuple[ParameterPair, ...]:
    """Return the pairs of parameters whose correlation is `MAX_CORRELATION` or more, of either
    sign.
    """
    pairs = []
    for i, first in enumerate(names):
        for j, second in enumerate(names[:i]):
            if abs(correlation[i, j]) >= MAX_CORRELATION:
                pairs.append(ParameterPair(first, second, float(correlation[i, j])))
    return tuple(pairs)


def _undetermined(model: Model, margins: np.ndarray, values: np.ndarray) -> tuple[str, ...]:
    """Return the parameters of the crane that the records hardly determine, see
    `Preflight.undetermined`.
    """
    names = []
    for p, margin, value in zip(model.own, margins, values.tolist(), strict=False):
        bounded_range = p.high - p.low
        limit = _UNDETERMINED_SHARE * bounded_range if np.isfinite(bounded_range) else abs(value)
        if margin > limit:
            names.append(p.name)
    return tuple(names)


def information(model: Model, values: np.ndarray, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Return Fisher's information about the parameters of the crane, with the initial states of the
    records estimated along; shape (parameters of the crane, parameters of the crane).

    Of each record the full information is F = JᵀJ with the Jacobian J over the noise, in blocks of
    the parameters of the crane (c) and of the initial state (s). What is left for the former when
    the latter has to be estimated, too, is the Schur complement F_cc - F_cs F_ss⁻¹ F_sc.

    Args:
        model: Records and parameters.
        values: Values of all parameters, shape (parameters,).
        noise: Standard deviation of each channel of each record.
    """
    count = len(model.own)
    total = np.zeros((count, count))
    for index, deviation in enumerate(noise):
        slope = jacobian(model, values, index).slope * model.scale / deviation[:, None, None]
        indices = model.of_record(index)
        record_slope = slope.reshape(-1, len(values))[:, indices]
        full = record_slope.T @ record_slope
        # A pseudoinverse: a part of the initial state may change no channel.
        initial_inverse = np.linalg.pinv(full[count:, count:], rcond=1e-13, hermitian=True)
        by_initial = full[:count, count:]
        total += full[:count, :count] - by_initial @ initial_inverse @ full[count:, :count]
    inverse_scale = 1.0 / model.scale[:count]
    return total * np.outer(inverse_scale, inverse_scale)


def _margins_and_correlation(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half widths of intervals, shape (parameters,), and correlations, shape (parameters,
    parameters), from information.
    """
    inverse, determined = invert_information(information)
    deviation = np.sqrt(np.diag(inverse))
    margins = np.where(determined, _NORMAL_QUANTILE * deviation, np.inf)
    unit = np.where(determined, deviation, 1.0)
    return margins, inverse / np.outer(unit, unit)


def _further_information(
    model: Model, record: Record, values: np.ndarray, noise: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the information of a further record, which begins at rest.

    The noise of its channels is that of the same columns so far; a new column has a ten thousandth
    of its range.
    """
    initial = initial_parameters(record, 0, model.drives)
    further = Model(model.prior, (record,), (*model.own, *initial), model.drives)
    start = np.append(values[: len(model.own)], np.zeros(len(initial)))
    known_noise = {}
    for record_channels, record_noise in zip(model.channels, noise, strict=True):
        for channel, deviation in zip(record_channels, record_noise, strict=True):
            known_noise[channel.column] = float(deviation)
    drive_range = model.prior.crane.upper - model.prior.crane.lower
    further_noise = []
    for channel in further.channels[0]:
        default = _NEW_CHANNEL_NOISE * drive_range[channel.at]
        further_noise.append(known_noise.get(channel.column, default))
    added = information(further, start, [np.array(further_noise)])
    # A record that cannot be simulated adds nothing.
    return added if np.isfinite(added).all() else np.zeros_like(added)


class _Move(NamedTuple):
    """Motion of a drive forth, and back at once.

    Attributes:
        distance: Distance [rad or m].
        duration: Time in each direction [s].
        begins: Time at which it begins [s].
    """

    distance: float
    duration: float
    begins: float


_STANDSTILL = _Move(0.0, 1.0, 0.0)
"""Motion of a drive that does not move."""


def propose_records(model: Model, values: np.ndarray) -> Iterator[tuple[str, Record]]:
    """Yield descriptions of further records and the records: every drive forth and back, in half a
    period of the swing and in a fifth of it; the same while hoisting; at another cable length; and
    with positions beside setpoints. Yield none where drives are not prescribed.
    """
    if model.drives != "motion":
        return
    crane = model.prior.crane
    template = _RecordTemplate(model, values)
    horizontal = [joint for i, joint in enumerate(crane.layout.driven) if i != crane.winch]
    yield from _horizontal_moves(template, horizontal)
    if crane.winch is None or not horizontal:
        return
    joint = horizontal[0]
    size = template.size(joint)
    text = f"{joint.symbol} by {size:.2g} {joint.unit} and back"
    move = {joint.symbol: _Move(size, 0.5 * template.period, 2.0)}
    hoist = crane.layout.driven[crane.winch]
    yield from _other_lengths(model, values, template, hoist, text, move)
    recorded = template.first.columns
    missing = []
    for drive in crane.layout.driven:
        if drive.setpoint_column in recorded and drive.columns[0] not in recorded:
            missing.append(drive.columns[0])
    if missing:
        record = template.record(move, with_positions=True)
        yield f"{text}, {', '.join(missing)} recorded, too", record


def _horizontal_moves(
    template: _RecordTemplate, joints: Sequence[Joint]
) -> Iterator[tuple[str, Record]]:
    """Yield records of each drive but the hoist, forth and back in half a period of the swing, and
    by less in a fifth of it.
    """
    for joint in joints:
        for share_of_period, share_of_size in ((0.5, 1.0), (0.2, 0.4)):
            distance = share_of_size * template.size(joint)
            duration = share_of_period * template.period
            text = (
                f"{joint.symbol} by {distance:.2g} {joint.unit} in {duration:.1f} s and back at "
                "once"
            )
            yield text, template.record({joint.symbol: _Move(distance, duration, 2.0)})


def _other_lengths(
    model: Model,
    values: np.ndarray,
    template: _RecordTemplate,
    hoist: Joint,
    text: str,
    move: Mapping[str, _Move],
) -> Iterator[tuple[str, Record]]:
    """Yield records of a move at half the length of the cable and at one and a half of it, and
    while hoisting to each.
    """
    length = template.positions[hoist.symbol]
    for factor, description in ((0.5, "half the cable"), (1.5, "half as much cable again")):
        target = float(np.clip(factor * length, *template.range_of(hoist)))
        # Where the range of the hoist ends nearby, another length would tell little.
        if abs(target - length) <= 0.1 * length:
            continue
        elsewhere = _RecordTemplate(model, values, {hoist.symbol: target})
        yield f"{text} at {target:.3g} m, {description}", elsewhere.record(move)
        hoisting = _Move(target - length, 2.0 * template.period, 4.0)
        yield (
            f"hoisting from {length:.3g} to {target:.3g} m while the load swings",
            template.record({**move, hoist.symbol: hoisting}),
        )


class _RecordTemplate:
    """Factory of further records with the columns and the rate of the first record, whose last
    positions of the drives they begin at.
    """

    def __init__(
        self, model: Model, values: np.ndarray, overrides: Mapping[str, float] | None = None
    ) -> None:
        """Prepare records.

        Args:
            model: Records and parameters.
            values: Values of all parameters, shape (parameters,).
            overrides: Other positions of drives to begin at, by symbol.
        """
        self.crane = model.prior.crane
        self.first = model.records[0]
        self.lags = {}
        for p, value in zip(model.own, values.tolist(), strict=False):
            if p.kind == "lag":
                self.lags[p.of] = value
        layout = self.crane.layout
        columns = self.first.columns
        self.positions = {}
        for joint, start in zip(layout.driven, self.crane.start.q[layout.drives], strict=True):
            column = columns.get(joint.columns[0], columns.get(joint.setpoint_column))
            self.positions[joint.symbol] = float(start if column is None else column[-1])
        self.positions |= overrides or {}
        hoist = self.crane.winch
        length = _ASSUMED_CABLE
        if hoist is not None:
            length = self.positions[layout.driven[hoist].symbol]
        self.period = float(point_period(length, self.crane.gravity))

    def range_of(self, joint: Joint) -> tuple[float, float]:
        """Return the least and the largest position of a drive."""
        i = self.crane.layout.index(joint.symbol)
        return float(self.crane.lower[i]), float(self.crane.upper[i])

    def size(self, joint: Joint) -> float:
        """Return the distance of a move [rad or m], negative where the drive would leave its range
        otherwise.
        """
        low, high = self.range_of(joint)
        distance = min(_MOVE_SIZES[joint.unit], _MAX_MOVE_SHARE * (high - low))
        return distance if self.positions[joint.symbol] + distance < high else -distance

    def record(self, moves: Mapping[str, _Move], *, with_positions: bool = False) -> Record:
        """Return the record of drives that move forth and back at once; the hoist moves forth only.

        Args:
            moves: Motions of the drives that move, by symbol.
            with_positions: Whether positions are recorded of all drives with setpoints; otherwise
                of those that the first record has.
        """
        recorded = self.first.columns
        # Long enough for moves that begin after some seconds, and for the swing that they leave.
        t = np.arange(0.0, 4.0 + 5.0 * self.period, self.first.interval)
        columns: dict[str, np.ndarray] = {}
        for drive, joint in enumerate(self.crane.layout.driven):
            move = moves.get(joint.symbol, _STANDSTILL)
            still = self.positions[joint.symbol]
            last = still + move.distance if drive == self.crane.winch else still
            points = np.array([[still], [still + move.distance], [last]])
            spline = Spline(move.begins + move.duration * np.arange(3), points)
            setpoint = spline.at(t).position.ravel()
            position = joint.columns[0]
            if joint.setpoint_column in recorded:
                columns[joint.setpoint_column] = setpoint
                if position in recorded or with_positions:
                    lag = self.lags.get(joint.symbol, 0.0)
                    columns[position] = lagged(setpoint, self.first.interval, lag)[0]
            else:
                columns[position] = setpoint
            # Only how efforts and swings are predicted counts, not what is recorded of them: any
            # column that is not constant stands for them.
            if joint.effort_column in recorded:
                columns[joint.effort_column] = np.sin(t)
        for joint in self.first.swings:
            columns[self.first.swing_column(joint)] = 1e-3 * np.sin(t)
        return replace(self.first, name="a further record", t=t, columns=columns)
