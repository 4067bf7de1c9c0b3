"""Identifiability of parameters before an estimate: expected confidence intervals, pairs that the
records cannot separate, and further records that would separate them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.identification.estimate import Estimate
from cranedyn.identification.model import Model
from cranedyn.identification.moves import propose_records
from cranedyn.identification.noise import initial_noise, invert_information
from cranedyn.identification.parameters import initial_parameters
from cranedyn.identification.record import Record
from cranedyn.identification.search import jacobian

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
    advice: tuple[Advice, ...]


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
    doubtful = [names.index(name) for name in dict.fromkeys([*_names(alike), *blind])]
    advice = []
    for move, record in propose_records(model, values) if doubtful else ():
        further = _further_model(model, record)
        start = _initial_values(further, model, values)
        spread = [_further_noise(further, model, noise)]
        reduced, rho = _spread(current + information(further, start, spread))
        pairs = [abs(rho[names.index(pair.first), names.index(pair.second)]) for pair in alike]
        advice.append(
            Advice(move, dict(zip(names, reduced.tolist(), strict=True)), max(pairs, default=0.0))
        )
    advice.sort(key=lambda entry: sum(np.log([entry.margins[names[i]] for i in doubtful])))
    return Preflight(
        dict(zip(names, margins.tolist(), strict=True)), correlation, alike, blind, tuple(advice)
    )


def _names(pairs: Sequence[ParameterPair]) -> list[str]:
    return [name for pair in pairs for name in (pair.first, pair.second)]


def information(model: Model, values: np.ndarray, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Return Fisher's information about the parameters of the crane, with the initial states of the
    records estimated along; shape (parameters of the crane, parameters of the crane), in their
    scales.
    """
    count = len(model.own)
    total = np.zeros((count, count))
    for index, spread in enumerate(noise):
        slope = jacobian(model, values, index)[1] * model.scale / spread[:, None, None]
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


def _further_model(model: Model, record: Record) -> Model:
    """Return a model of a further record with the same parameters of the crane."""
    initial = initial_parameters(record, 0, model.drives)
    return Model(model.prior, (record,), (*model.own, *initial), model.drives)


def _initial_values(further: Model, model: Model, values: np.ndarray) -> np.ndarray:
    """Return values for a record that begins at rest."""
    start = np.zeros(len(further.parameters))
    count = len(model.own)
    start[:count] = values[:count]
    return start


def _further_noise(further: Model, model: Model, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Return the noise of the channels of a further record: that of the same columns so far; a new
    column has a ten thousandth of its range.
    """
    spreads = {
        channel.column: float(spread)
        for record in zip(model.channels, noise, strict=True)
        for channel, spread in zip(*record, strict=True)
    }
    crane = model.prior.crane
    width = crane.upper - crane.lower
    return np.array([spreads.get(c.column, 1e-4 * width[c.at]) for c in further.channels[0]])
