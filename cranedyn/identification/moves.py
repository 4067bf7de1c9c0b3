"""Further records that one could make of a crane, to tell what those that are there do not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cranedyn.identification.model import Model
from cranedyn.identification.motion import lagged
from cranedyn.identification.record import Record
from cranedyn.model.layout import Joint
from cranedyn.theory import point_period


def moves(model: Model, values: np.ndarray) -> Iterator[tuple[str, Record]]:
    """Further records that one could make, each with a sentence: every drive there and back, in
    half a period of the swing and as fast as a fifth of it; hoisting meanwhile; another cable
    length; and positions beside setpoints. None where drives are not prescribed.
    """
    if model.drives != "motion":
        return
    first, crane = model.records[0], model.prior.crane
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
    at = model.prior.crane.layout.drives[drive]
    return float(model.prior.crane.lower[at]), float(model.prior.crane.upper[at])


class _Move:
    """A further record of the same columns and rate as one that is there."""

    def __init__(
        self, model: Model, values: np.ndarray, like: Record, at: dict[int, float] | None = None
    ) -> None:
        self.model, self.values, self.like = model, values, like
        layout, crane = model.prior.crane.layout, model.prior.crane
        self.at = []
        for drive, (joint, place) in enumerate(zip(layout.driven, layout.drives, strict=True)):
            known = [
                like.columns[name][-1]
                for name in (joint.columns[0], joint.setpoint_column)
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
            for joint in self.model.prior.crane.layout.driven
            if joint.setpoint_column in self.like.columns
            and joint.columns[0] not in self.like.columns
        ]

    def size(self, joint: Joint) -> float:
        """How far a drive moves: a metre or a tenth of a turn, into the middle of its range."""
        drive = self.model.prior.crane.layout.drive(joint.symbol)
        low, high = _ends(self.model, drive)
        far = min(1.0 if joint.unit == "m" else 0.15, 0.2 * (high - low))
        return far if self.at[drive] + far < high else -far

    def record(
        self, moved: dict[str, tuple[float, float, float]], *, positions: bool = False
    ) -> Record:
        """The record of drives moved by a distance in a time from a time on, and back at once, the
        hoist there only.
        """
        layout = self.model.prior.crane.layout
        t = np.arange(0.0, 4.0 + 5.0 * self.period, self.like.interval)
        columns: dict[str, np.ndarray] = {}
        for joint, at in zip(layout.driven, self.at, strict=True):
            far, lasts, begins = moved.get(joint.symbol, (0.0, 1.0, 0.0))
            aim = at + far * _smooth((t - begins) / lasts)
            if joint.role != "hoist":
                aim = aim - far * _smooth((t - begins - lasts) / lasts)
            aimed = joint.setpoint_column
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
