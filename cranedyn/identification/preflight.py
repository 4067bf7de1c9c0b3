"""Identifiability of parameters before an estimate: expected confidence intervals, pairs that the
records cannot separate, and further records that would separate them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.identification.estimate import Estimate, initial_noise, invert_information
from cranedyn.identification.model import Model
from cranedyn.identification.motion import lagged
from cranedyn.identification.parameters import initial_parameters
from cranedyn.identification.record import Record
from cranedyn.identification.search import jacobian
from cranedyn.model.layout import Joint
from cranedyn.references.simple import Spline
from cranedyn.theory import point_period

ALIKE = 0.95
"""Correlation above which two parameters count as inseparable."""

_SURE = 1.959963984540054


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
        alike: Pairs that the records cannot separate.
        blind: Parameters that the records hardly determine: half the interval is more than a
            quarter of the range between the bounds, or than the value itself.
        advice: Effects of further records, the best first; none where all parameters are
            determined, or drives are not prescribed.
    """

    margins: dict[str, float]
    correlation: np.ndarray
    alike: tuple[ParameterPair, ...]
    blind: tuple[str, ...]
    advice: tuple[Advice, ...] = ()

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Names of all parameters in `alike` and `blind`."""
        paired = [name for pair in self.alike for name in (pair.first, pair.second)]
        return tuple(dict.fromkeys([*paired, *self.blind]))


def preflight(model: Model, estimate: Estimate | None = None) -> Preflight:
    """Predict confidence intervals from the curvature of the least squares.

    Args:
        model: Records and parameters.
        estimate: Values and noise to linearise at; None for the first values of the search and
            the noise from second differences.
    """
    values = model.first if estimate is None else estimate.values
    noise = initial_noise(model) if estimate is None else list(estimate.noise)
    current = information(model, values, noise)
    names = [p.name for p in model.own]
    margins, correlation = _spread(current)
    alike = tuple(
        ParameterPair(names[i], names[j], float(correlation[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) >= ALIKE
    )
    blind = tuple(
        p.name
        for p, margin, value in zip(model.parameters, margins, values.tolist(), strict=False)
        if margin > (0.25 * (p.high - p.low) if np.isfinite(p.high - p.low) else abs(value))
    )
    result = Preflight(dict(zip(names, margins.tolist(), strict=True)), correlation, alike, blind)
    advice = []
    for move, record in propose_records(model, values) if result.doubtful else ():
        reduced, rho = _spread(current + _further_information(model, record, values, noise))
        pairs = [abs(rho[names.index(pair.first), names.index(pair.second)]) for pair in alike]
        expected = dict(zip(names, reduced.tolist(), strict=True))
        advice.append(Advice(move, expected, max(pairs, default=0.0)))
    advice.sort(key=lambda entry: sum(np.log([entry.margins[name] for name in result.doubtful])))
    return replace(result, advice=tuple(advice))


def information(model: Model, values: np.ndarray, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Return Fisher's information about the parameters of the crane, with the initial states of the
    records estimated along; shape (parameters of the crane, parameters of the crane), in their
    scales.
    """
    count = len(model.own)
    total = np.zeros((count, count))
    for index, spread in enumerate(noise):
        slope = jacobian(model, values, index).slope * model.scale / spread[:, None, None]
        indices = model.of_record(index)
        flat = slope.reshape(-1, len(values))[:, indices]
        full = flat.T @ flat
        initial = full[count:, count:]
        beside = np.linalg.pinv(initial, rcond=1e-13, hermitian=True)
        total += full[:count, :count] - full[:count, count:] @ beside @ full[count:, :count]
    return total * np.outer(1.0 / model.scale[:count], 1.0 / model.scale[:count])


def _spread(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half widths of intervals, shape (parameters,), and correlations, from information."""
    inverse, determined = invert_information(information)
    deviation = np.sqrt(np.diag(inverse))
    margins = np.where(determined, _SURE * deviation, np.inf)
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
    spreads = {
        channel.column: float(spread)
        for record_channels, record_noise in zip(model.channels, noise, strict=True)
        for channel, spread in zip(record_channels, record_noise, strict=True)
    }
    width = model.prior.crane.upper - model.prior.crane.lower
    spread = [spreads.get(c.column, 1e-4 * width[c.at]) for c in further.channels[0]]
    added = information(further, start, [np.array(spread)])
    return added if np.isfinite(added).all() else np.zeros_like(added)  # it cannot be simulated


def propose_records(model: Model, values: np.ndarray) -> Iterator[tuple[str, Record]]:
    """Yield descriptions of further records and the records: every drive forth and back, in half a
    period of the swing and in a fifth of it; the same while hoisting; at another cable length; and
    with positions beside setpoints. Yield none where drives are not prescribed.
    """
    if model.drives != "motion":
        return
    crane, template = model.prior.crane, _RecordTemplate(model, values)
    hoist = crane.winch
    sideways = [joint for i, joint in enumerate(crane.layout.driven) if i != hoist]
    for joint in sideways:
        for share, scale in ((0.5, 1.0), (0.2, 0.4)):
            size, lasts = scale * template.size(joint), share * template.period
            text = f"{joint.symbol} by {size:.2g} {joint.unit} in {lasts:.1f} s and back at once"
            yield text, template.record({joint.symbol: (size, lasts, 2.0)})
    if hoist is None or not sideways:
        return
    lift, size = crane.layout.driven[hoist], template.size(sideways[0])
    move = f"{sideways[0].symbol} by {size:.2g} {sideways[0].unit} and back"
    swing_move = {sideways[0].symbol: (size, 0.5 * template.period, 2.0)}
    length = template.positions[lift.symbol]
    for factor, text in ((0.5, "half the cable"), (1.5, "half as much cable again")):
        target = float(np.clip(factor * length, *template.range_of(lift)))
        if abs(target - length) > 0.1 * length:
            shorter = _RecordTemplate(model, values, {lift.symbol: target})
            yield f"{move} at {target:.3g} m, {text}", shorter.record(swing_move)
            hoisting = {lift.symbol: (target - length, 2.0 * template.period, 4.0)}
            text = f"hoisting from {length:.3g} to {target:.3g} m while the load swings"
            yield text, template.record({**swing_move, **hoisting})
    recorded = template.like.columns
    missing = [
        joint.columns[0]
        for joint in crane.layout.driven
        if joint.setpoint_column in recorded and joint.columns[0] not in recorded
    ]
    if missing:
        text = f"{move}, {', '.join(missing)} recorded, too"
        yield text, template.record(swing_move, with_positions=True)


class _RecordTemplate:
    """Factory of further records with the columns and the rate of the first record, whose last
    positions of the drives they begin at.
    """

    def __init__(
        self, model: Model, values: np.ndarray, overrides: Mapping[str, float] | None = None
    ) -> None:
        self.crane, self.like = model.prior.crane, model.records[0]
        own = zip(model.own, values.tolist(), strict=False)
        self.lags = {p.of: value for p, value in own if p.kind == "lag"}
        layout, columns = self.crane.layout, self.like.columns
        self.positions = {}
        for joint, start in zip(layout.driven, self.crane.start.q[layout.drives], strict=True):
            column = columns.get(joint.columns[0], columns.get(joint.setpoint_column))
            self.positions[joint.symbol] = float(start if column is None else column[-1])
        self.positions |= overrides or {}
        hoist = self.crane.winch
        length = 10.0 if hoist is None else self.positions[layout.driven[hoist].symbol]
        self.period = float(point_period(length, self.crane.gravity))

    def range_of(self, joint: Joint) -> tuple[float, float]:
        """Return the least and the largest position of a drive."""
        i = self.crane.layout.index(joint.symbol)
        return float(self.crane.lower[i]), float(self.crane.upper[i])

    def size(self, joint: Joint) -> float:
        """Return the distance of a move: a metre or a tenth of a turn, towards the middle of the
        range.
        """
        low, high = self.range_of(joint)
        distance = min(1.0 if joint.unit == "m" else 0.15, 0.2 * (high - low))
        return distance if self.positions[joint.symbol] + distance < high else -distance

    def record(
        self, moved: Mapping[str, tuple[float, float, float]], *, with_positions: bool = False
    ) -> Record:
        """Return the record of drives that move by a distance, in a time, from a time on, and back
        at once; the hoist moves forth only.
        """
        recorded, t = self.like.columns, np.arange(0.0, 4.0 + 5.0 * self.period, self.like.interval)
        columns: dict[str, np.ndarray] = {}
        for drive, joint in enumerate(self.crane.layout.driven):
            distance, lasts, begins = moved.get(joint.symbol, (0.0, 1.0, 0.0))
            still = self.positions[joint.symbol]
            last = still + distance if drive == self.crane.winch else still
            points = np.array([[still], [still + distance], [last]])
            (aim,) = Spline(begins + lasts * np.arange(3), points).at(t).position.T
            position = joint.columns[0]
            if joint.setpoint_column in recorded:
                columns[joint.setpoint_column] = aim
                if position in recorded or with_positions:
                    lag = self.lags.get(joint.symbol, 0.0)
                    columns[position] = lagged(aim, self.like.interval, lag)[0]
            else:
                columns[position] = aim
            if joint.effort_column in recorded:
                columns[joint.effort_column] = np.sin(t)  # only how it is predicted counts
        for joint in self.like.swings:
            columns[self.like.swing_column(joint)] = 1e-3 * np.sin(t)
        return replace(self.like, name="a further record", t=t, columns=columns)
