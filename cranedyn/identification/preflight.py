"""What a record can tell before one believes it: how sure each parameter would be, which two it
cannot tell apart, and which move would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.identification.estimate import Estimate
from cranedyn.identification.model import Model
from cranedyn.identification.moves import moves
from cranedyn.identification.noise import initial_noise, inverted
from cranedyn.identification.parameters import starts
from cranedyn.identification.record import Record
from cranedyn.identification.search import jacobian

ALIKE = 0.95
"""Correlation from which on two parameters count as not told apart."""

_SURE = 1.959963984540054


class Pair(NamedTuple):
    """Two parameters that a record cannot tell apart, with their correlation."""

    one: str
    other: str
    correlation: float


class Advice(NamedTuple):
    """What a further record would do.

    Attributes:
        move: What to record.
        margins: Half widths of the intervals with it, by name; inf where nothing is known.
        correlation: Largest of the pairs that could not be told apart, with it; 0 for no pair.
    """

    move: str
    margins: dict[str, float]
    correlation: float


@dataclass(frozen=True, eq=False)
class Preflight:
    """What records can tell.

    Attributes:
        margins: Half width of the 95 % interval that each parameter of the crane would have; inf
            where the records say nothing of it.
        correlation: Of these parameters, shape (parameters, parameters).
        alike: Those that are not told apart.
        blind: Those of which next to nothing is said: half the interval is more than a quarter of
            what is allowed, or than the value itself.
        advice: What further moves would do, the best first; none where all is told, or drives are
            not prescribed.
    """

    margins: dict[str, float]
    correlation: np.ndarray
    alike: tuple[Pair, ...]
    blind: tuple[str, ...]
    advice: tuple[Advice, ...]


def preflight(model: Model, estimate: Estimate | None = None) -> Preflight:
    """Judge records by what they would tell, by the curvature of the least squares.

    Args:
        model: Records, and what is to be found.
        estimate: Where to judge, and what noise there is; None for where the search begins, with
            the noise that second differences show.
    """
    values = model.first if estimate is None else estimate.values
    noise = initial_noise(model) if estimate is None else list(estimate.noise)
    known = information(model, values, noise)
    names = [one.name for one in model.own]
    margins, correlation = _spread(known)
    alike = tuple(
        Pair(names[i], names[j], float(correlation[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) >= ALIKE
    )
    blind = tuple(
        one.name
        for one, margin, value in zip(model.parameters, margins, values.tolist(), strict=False)
        if margin > (0.25 * (one.high - one.low) if np.isfinite(one.high - one.low) else abs(value))
    )
    doubtful = [names.index(name) for name in dict.fromkeys([*_names(alike), *blind])]
    advice = []
    for move, further in moves(model, values) if doubtful else ():
        again = _with(model, further)
        own = _values(again, model, values)
        spread = [_for(again, model, noise)]
        more, rho = _spread(known + information(again, own, spread))
        pairs = [abs(rho[names.index(p.one), names.index(p.other)]) for p in alike]
        advice.append(
            Advice(move, dict(zip(names, more.tolist(), strict=True)), max(pairs, default=0.0))
        )
    advice.sort(key=lambda one: sum(np.log([one.margins[names[i]] for i in doubtful])))
    return Preflight(
        dict(zip(names, margins.tolist(), strict=True)), correlation, alike, blind, tuple(advice)
    )


def _names(pairs: Sequence[Pair]) -> list[str]:
    return [name for pair in pairs for name in (pair.one, pair.other)]


def information(model: Model, values: np.ndarray, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Fisher's information about the parameters of the crane, how each record begins being found
    beside them; shape (parameters of the crane,) twice, in their scales.
    """
    count = len(model.own)
    found = np.zeros((count, count))
    for index, spread in enumerate(noise):
        slope = jacobian(model, values, index)[1] * model.scale / spread[:, None, None]
        places = model.of_record(index)
        flat = slope.reshape(-1, len(values))[:, places]
        whole = flat.T @ flat
        own = whole[count:, count:]
        beside = np.linalg.pinv(own, rcond=1e-13, hermitian=True)
        found += whole[:count, :count] - whole[:count, count:] @ beside @ whole[count:, :count]
    return found * np.outer(1.0 / model.scale[:count], 1.0 / model.scale[:count])


def _spread(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half widths of intervals, shape (parameters,), and correlations, from information."""
    inverse, told = inverted(known)
    deviation = np.sqrt(np.diag(inverse))
    margins = np.where(told, _SURE * deviation, np.inf)
    unit = np.where(told, deviation, 1.0)
    return margins, inverse / np.outer(unit, unit)


def _with(model: Model, record: Record) -> Model:
    """The same to be found of another record."""
    begins = starts(record, 0, model.drives)
    return Model(model.prior, (record,), (*model.own, *begins), model.drives)


def _values(again: Model, model: Model, values: np.ndarray) -> np.ndarray:
    """Values for a record that begins at rest."""
    found = np.zeros(len(again.parameters))
    count = len(model.own)
    found[:count] = values[:count]
    return found


def _for(again: Model, model: Model, noise: Sequence[np.ndarray]) -> np.ndarray:
    """Noise of the channels of a further record: that of the same columns; a column that nobody
    recorded so far has a ten thousandth of its range.
    """
    seen = {
        channel.column: float(spread)
        for own, part in zip(model.channels, noise, strict=True)
        for channel, spread in zip(own, part, strict=True)
    }
    crane = model.prior.crane
    width = crane.upper - crane.lower
    return np.array([seen.get(one.column, 1e-4 * width[one.at]) for one in again.channels[0]])
