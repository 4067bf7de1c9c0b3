"""Further records of a crane that would determine what the present ones do not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cranedyn.identification.model import Model
from cranedyn.identification.motion import lagged
from cranedyn.identification.record import Record
from cranedyn.model.layout import Joint
from cranedyn.theory import point_period


def propose_records(model: Model, values: np.ndarray) -> Iterator[tuple[str, Record]]:
    """Yield descriptions of further records and the records: every drive forth and back, in half a
    period of the swing and in a fifth of it; the same while hoisting; at another cable length; and
    with positions beside setpoints. Yield none where drives are not prescribed.
    """
    if model.drives != "motion":
        return
    first, crane = model.records[0], model.prior.crane
    hoist = crane.layout.drive_of("hoist")
    template = _RecordTemplate(model, values, first)
    for joint in crane.layout.driven:
        if joint.role == "hoist":
            continue
        for share in (0.5, 0.2):
            size = template.size(joint) * (1.0 if share > 0.3 else 0.4)
            lasts = share * template.period
            text = f"{joint.symbol} by {size:.2g} {joint.unit} in {lasts:.1f} s and back at once"
            yield text, template.record({joint.symbol: (size, lasts, 2.0)})
    sideways = next((joint for joint in crane.layout.driven if joint.role != "hoist"), None)
    if hoist is None or sideways is None:
        return
    lift, size = crane.layout.driven[hoist], template.size(sideways)
    swing_move = {sideways.symbol: (size, 0.5 * template.period, 2.0)}
    for share, text in ((-0.5, "half the cable"), (0.5, "half as much cable again")):
        length = template.positions[hoist]
        target = float(np.clip((1.0 + share) * length, *_ends(model, hoist)))
        if abs(target - length) > 0.1 * length:
            yield (
                f"{sideways.symbol} by {size:.2g} {sideways.unit} and back at {target:.3g} m, "
                f"{text}",
                _RecordTemplate(model, values, first, {hoist: target}).record(swing_move),
            )
            yield (
                f"hoisting from {length:.3g} to {target:.3g} m while the load swings",
                template.record(
                    {**swing_move, lift.symbol: (target - length, 2.0 * template.period, 4.0)}
                ),
            )
    if template.missing_positions:
        names = ", ".join(template.missing_positions)
        yield (
            f"{sideways.symbol} by {size:.2g} {sideways.unit} and back, {names} recorded, too",
            template.record(swing_move, with_positions=True),
        )


def _ends(model: Model, drive: int) -> tuple[float, float]:
    i = model.prior.crane.layout.drives[drive]
    return float(model.prior.crane.lower[i]), float(model.prior.crane.upper[i])


class _RecordTemplate:
    """Factory of further records with the columns and the rate of a present record."""

    def __init__(
        self,
        model: Model,
        values: np.ndarray,
        like: Record,
        overrides: dict[int, float] | None = None,
    ) -> None:
        self.model, self.values, self.like = model, values, like
        layout, crane = model.prior.crane.layout, model.prior.crane
        self.positions = []
        for drive, (joint, i) in enumerate(zip(layout.driven, layout.drives, strict=True)):
            recorded = [
                like.columns[name][-1]
                for name in (joint.columns[0], joint.setpoint_column)
                if name in like.columns
            ]
            end = float(recorded[0] if recorded else crane.start.q[i])
            self.positions.append((overrides or {}).get(drive, end))
        hoist = layout.drive_of("hoist")
        length = 10.0 if hoist is None else self.positions[hoist]
        self.period = float(point_period(length, crane.gravity))

    @property
    def missing_positions(self) -> list[str]:
        """Columns of positions that the record lacks beside a setpoint."""
        return [
            joint.columns[0]
            for joint in self.model.prior.crane.layout.driven
            if joint.setpoint_column in self.like.columns
            and joint.columns[0] not in self.like.columns
        ]

    def size(self, joint: Joint) -> float:
        """Return the distance of a move: a metre or a tenth of a turn, towards the middle of the
        range.
        """
        drive = self.model.prior.crane.layout.drive(joint.symbol)
        low, high = _ends(self.model, drive)
        distance = min(1.0 if joint.unit == "m" else 0.15, 0.2 * (high - low))
        return distance if self.positions[drive] + distance < high else -distance

    def record(
        self, moved: dict[str, tuple[float, float, float]], *, with_positions: bool = False
    ) -> Record:
        """Return the record of drives that move by a distance, in a time, from a time on, and back
        at once; the hoist moves forth only.
        """
        layout = self.model.prior.crane.layout
        t = np.arange(0.0, 4.0 + 5.0 * self.period, self.like.interval)
        columns: dict[str, np.ndarray] = {}
        for joint, position in zip(layout.driven, self.positions, strict=True):
            distance, lasts, begins = moved.get(joint.symbol, (0.0, 1.0, 0.0))
            aim = position + distance * _smooth((t - begins) / lasts)
            if joint.role != "hoist":
                aim = aim - distance * _smooth((t - begins - lasts) / lasts)
            aimed = joint.setpoint_column
            if aimed in self.like.columns:
                columns[aimed] = aim
                lagged_position = self._lagged(joint, aim)
                if joint.columns[0] in self.like.columns or with_positions:
                    columns[joint.columns[0]] = lagged_position
            else:
                columns[joint.columns[0]] = aim
            if joint.effort_column in self.like.columns:
                columns[joint.effort_column] = np.sin(t)  # only how it is predicted counts
        for joint in self.like.swings:
            columns[joint.columns[0]] = 1e-3 * np.sin(t)
        return replace(self.like, name="a further record", t=t, columns=columns)

    def _lagged(self, joint: Joint, aim: np.ndarray) -> np.ndarray:
        names = [p.name for p in self.model.parameters]
        name = f"{joint.symbol}_lag"
        lag = float(self.values[names.index(name)]) if name in names else 0.0
        return lagged(aim, self.like.interval, lag)[0]


def _smooth(share: np.ndarray) -> np.ndarray:
    """Return a step from 0 to 1 with zero rate and acceleration at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
