"""What a record can tell before one believes it: how sure each parameter would be, which two it
cannot tell apart, and which move would.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.arguments import checked
from cranedyn.identification.estimate import Estimate, initial_noise, jacobian
from cranedyn.identification.model import Model
from cranedyn.identification.motion import lagged
from cranedyn.identification.parameters import starts
from cranedyn.identification.record import Record, setpoint_column
from cranedyn.model.layout import Joint
from cranedyn.theory import point_period

ALIKE = 0.95
"""Correlation from which on two parameters count as not told apart."""

_SURE = 1.959963984540054
_FLOOR = 1e-12


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


@checked
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
    names = [one.name for one in model.parameters if one.record is None]
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
    count = sum(one.record is None for one in model.parameters)
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
    size = np.sqrt(np.diag(known))
    told = size > 0.0
    unit = np.where(told, size, 1.0)
    share, axes = np.linalg.eigh(known / np.outer(unit, unit))
    inverse = (axes / np.maximum(share, _FLOOR)) @ axes.T
    deviation = np.sqrt(np.diag(inverse))
    margins = np.where(told, _SURE * deviation / unit, np.inf)
    correlation = inverse / np.outer(deviation, deviation)
    correlation[~told] = correlation[:, ~told] = 0.0
    return margins, correlation


def _with(model: Model, record: Record) -> Model:
    """The same to be found of another record."""
    own = [one for one in model.parameters if one.record is None]
    begins = starts(record, 0, model.drives)
    return Model(model.known, (record,), (*own, *begins), model.drives)


def _values(again: Model, model: Model, values: np.ndarray) -> np.ndarray:
    """Values for a record that begins at rest."""
    found = np.zeros(len(again.parameters))
    count = sum(one.record is None for one in model.parameters)
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
    crane = model.known.crane
    width = crane.upper - crane.lower
    return np.array([seen.get(one.column, 1e-4 * width[one.at]) for one in again.channels[0]])


def moves(model: Model, values: np.ndarray) -> Iterator[tuple[str, Record]]:
    """Further records that one could make, each with a sentence: every drive there and back, in
    half a period of the swing and as fast as a fifth of it; hoisting meanwhile; another cable
    length; and positions beside setpoints. None where drives are not prescribed.
    """
    if model.drives != "motion":
        return
    first, crane = model.records[0], model.known.crane
    hoist = crane.layout.drive_of("hoist")
    usual = _Move(model, values, first)
    for joint in crane.layout.driven:
        if joint.role == "hoist":
            continue
        for share in (0.5, 0.2):
            size = usual.size(joint) * (1.0 if share > 0.3 else 0.4)
            lasts = share * usual.period
            words = f"{joint.symbol} by {size:.2g} {joint.unit} in {lasts:.1f} s and back at once"
            yield words, usual.record({joint.symbol: (size, lasts, 2.0)})
    sideways = next((one for one in crane.layout.driven if one.role != "hoist"), None)
    if hoist is None or sideways is None:
        return
    lift, size = crane.layout.driven[hoist], usual.size(sideways)
    swung = {sideways.symbol: (size, 0.5 * usual.period, 2.0)}
    for share, words in ((-0.5, "half the cable"), (0.5, "half as much cable again")):
        length = usual.at[hoist]
        other = float(np.clip((1.0 + share) * length, *_ends(model, hoist)))
        if abs(other - length) > 0.1 * length:
            yield (
                f"{sideways.symbol} by {size:.2g} {sideways.unit} and back at {other:.3g} m, "
                f"{words}",
                _Move(model, values, first, {hoist: other}).record(swung),
            )
            yield (
                f"hoisting from {length:.3g} to {other:.3g} m while the load swings",
                usual.record({**swung, lift.symbol: (other - length, 2.0 * usual.period, 4.0)}),
            )
    if usual.aimed_alone:
        names = ", ".join(usual.aimed_alone)
        yield (
            f"{sideways.symbol} by {size:.2g} {sideways.unit} and back, {names} recorded, too",
            usual.record(swung, positions=True),
        )


def _ends(model: Model, drive: int) -> tuple[float, float]:
    at = model.known.crane.layout.drives[drive]
    return float(model.known.crane.lower[at]), float(model.known.crane.upper[at])


class _Move:
    """A further record of the same columns and rate as one that is there."""

    def __init__(
        self, model: Model, values: np.ndarray, like: Record, at: dict[int, float] | None = None
    ) -> None:
        self.model, self.values, self.like = model, values, like
        layout, crane = model.known.crane.layout, model.known.crane
        self.at = []
        for drive, (joint, place) in enumerate(zip(layout.driven, layout.drives, strict=True)):
            known = [
                like.columns[name][-1]
                for name in (joint.columns[0], setpoint_column(joint))
                if name in like.columns
            ]
            end = float(known[0] if known else crane.start.q[place])
            self.at.append((at or {}).get(drive, end))
        hoist = layout.drive_of("hoist")
        length = 10.0 if hoist is None else self.at[hoist]
        self.period = float(point_period(length, crane.gravity))

    @property
    def aimed_alone(self) -> list[str]:
        """Columns of positions that are lacking beside a setpoint."""
        return [
            joint.columns[0]
            for joint in self.model.known.crane.layout.driven
            if setpoint_column(joint) in self.like.columns
            and joint.columns[0] not in self.like.columns
        ]

    def size(self, joint: Joint) -> float:
        """How far a drive moves: a metre or a tenth of a turn, into the middle of its range."""
        drive = self.model.known.crane.layout.drive(joint.symbol)
        low, high = _ends(self.model, drive)
        far = min(1.0 if joint.unit == "m" else 0.15, 0.2 * (high - low))
        return far if self.at[drive] + far < high else -far

    def record(
        self, moved: dict[str, tuple[float, float, float]], *, positions: bool = False
    ) -> Record:
        """The record of drives moved by a distance in a time from a time on, and back at once, the
        hoist there only.
        """
        layout = self.model.known.crane.layout
        t = np.arange(0.0, 4.0 + 5.0 * self.period, self.like.interval)
        columns: dict[str, np.ndarray] = {}
        for joint, at in zip(layout.driven, self.at, strict=True):
            far, lasts, begins = moved.get(joint.symbol, (0.0, 1.0, 0.0))
            aim = at + far * _smooth((t - begins) / lasts)
            if joint.role != "hoist":
                aim = aim - far * _smooth((t - begins - lasts) / lasts)
            aimed = setpoint_column(joint)
            if aimed in self.like.columns:
                columns[aimed] = aim
                place = self._lagged(joint, aim)
                if joint.columns[0] in self.like.columns or positions:
                    columns[joint.columns[0]] = place
            else:
                columns[joint.columns[0]] = aim
            if joint.effort_column in self.like.columns:
                columns[joint.effort_column] = np.sin(t)  # only how it is predicted counts
        for joint in self.like.swings:
            columns[joint.columns[0]] = 1e-3 * np.sin(t)
        return replace(self.like, name="a further record", t=t, columns=columns)

    def _lagged(self, joint: Joint, aim: np.ndarray) -> np.ndarray:
        names = [one.name for one in self.model.parameters]
        name = f"{joint.symbol}_lag"
        lag = float(self.values[names.index(name)]) if name in names else 0.0
        return lagged(aim, self.like.interval, lag)[0]


def _smooth(share: np.ndarray) -> np.ndarray:
    """From 0 to 1 with rates and accelerations that begin and end at zero."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
