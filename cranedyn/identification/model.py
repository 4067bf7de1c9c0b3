"""Prediction of records: many variants of a crane, simulated in one batch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification.motion import SampledMotion, lagged, recorded_motion, recorded_setpoint
from cranedyn.identification.problem import Channel, EstimationProblem
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate

PERIODS = {"motion": 0.01, "effort": 5e-3, "hold": 5e-3}
"""Control period and step [s]: prescribed drives are smooth, a hold controller keeps its command
for one."""

_STANDING = {"rad": 1e-4, "m": 1e-3}
"""Rate below which a drive counts as standing [per second]: a hundredth of usual rates. No dry
friction is predicted there, since it may be anything up to that of a moving drive."""

_SURELY_MOVES = 3.0
"""Rate of a smoothed motion over its creep from which on the drive surely moves."""

_SURELY_STANDS = 3.0
"""Time from a moving row, in units of one over the cutoff of a smoothed motion, from which on a
slow drive surely stands: its kernel falls by more than exp(-sqrt(3/4)) in each unit."""

_CHANGE = 1e-6

ROUND_OFF = 1e-12
"""Changes of a channel below this share of its range are round-off."""


class _Variants:
    """A record simulated by variants of the crane, each with its values of the parameters."""

    def __init__(
        self, problem: EstimationProblem, index: int, values: np.ndarray, until: float = np.inf
    ) -> None:
        self.problem, self.values, self.channels = problem, values, problem.channels[index]
        self.record, self.crane = problem.records[index], problem.prior.crane
        self.layout, self.period = self.crane.layout, PERIODS[problem.drives]
        self.t = self.record.t[problem.rows(index, until)]
        duration = float(self.t[-1]) if len(self.t) else 0.0
        count = int(np.ceil((duration - problem.delay_bounds[0]) / self.period)) + 2
        self.grid = self.period * np.arange(count)
        self.inside = np.minimum(self.grid, self.record.t[-1])
        self.indices = {p.name: i for i, p in enumerate(problem.own)}
        self.record_indices = {
            (p.kind, p.of): i for i, p in enumerate(problem.parameters) if p.record == index
        }

    def value(self, name: str, default: float = 0.0) -> np.ndarray:
        """Return a parameter of the crane in each variant, shape (variants,)."""
        index = self.indices.get(name)
        return np.full(len(self.values), default) if index is None else self.values[:, index]

    @property
    def settings(self) -> dict[str, Any]:
        """Options of the simulation."""
        return {
            "duration": float(self.period * (len(self.grid) - 1)),
            "dt": self.period,
            "control_period": self.period,
            "drive": "motion" if self.problem.drives == "motion" else "effort",
            "integrator": rk4,
        }

    def outputs(self) -> np.ndarray:
        """Simulate and return the predicted channels, shape (variants, channels, rows)."""
        family, variants = self.problem.family, len(self.values)
        varied = [self.indices[name] for name in family.names]
        rows = list(map(tuple, self.values[:, varied].tolist()))
        cranes = {row: family.at(np.array(row)) for row in dict.fromkeys(rows)}
        controller, reference = self.controllers(cranes[rows[0]])
        batch = simulate_batch(
            [cranes[row] for row in rows],
            controller[0] if len(controller) == 1 else controller,
            reference[0] if len(reference) == 1 else reference,
            start=self.start(),
            record=1,
            **self.settings,
        )
        outputs = np.empty((variants, len(self.channels), len(self.t)))
        for c, channel in enumerate(self.channels):
            joint = self.layout.joints[channel.at]
            if channel.kind == "swing":
                position, rate = self._reported(batch, channel.at)
                if channel.column == joint.columns[0]:
                    outputs[:, c] = position + self.value(f"{joint.symbol}_bias")[:, None]
                else:
                    bias, drift = (
                        self.values[:, self.record_indices[kind, joint.symbol], None]
                        for kind in ("rate bias", "rate drift")
                    )
                    outputs[:, c] = rate + bias + drift * self.t
            elif channel.kind == "position":
                q, v = batch.q[:, :, channel.at], batch.v[:, :, channel.at]
                outputs[:, c], _ = self._interpolate(q, v, np.zeros(variants))
                outputs[:, c] -= self.value(f"{joint.symbol}_offset")[:, None]
            else:
                follows = channel.kind == "lagged"
                signal = self._lagged(joint)[0] if follows else self._effort(batch, channel, joint)
                outputs[:, c] = [np.interp(self.t, self.grid, lane) for lane in signal]
                if not follows and f"{joint.symbol}_friction" in self.indices:
                    # Friction there is anything up to that of a moving drive. What is predicted as
                    # recorded has no residual and says nothing.
                    undecided = self._undecided(joint)
                    recorded = self.record.columns[channel.column]
                    outputs[:, c, undecided] = np.interp(self.t, self.record.t, recorded)[undecided]
        return outputs

    def controllers(self, crane: Crane) -> tuple[list[Any], list[Any]]:
        """Return controllers and references, one for all variants or one for each."""
        still = [hold(crane, crane.start)]
        if self.problem.drives == "motion":
            motions = [
                SampledMotion(self.period, *arrays) for arrays in zip(*self.motion, strict=True)
            ]
            return [follow(crane, motion, self.period) for motion in motions], still
        if self.problem.drives == "effort":
            return [self._efforts()], still
        return self._hold_controllers()

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and rates of the drives, shape (variants or 1, rows, m) each."""
        motions = []
        for joint, start in zip(self.layout.driven, self._drive_starts, strict=True):
            recorded = recorded_motion(self.record, joint, start)
            motions.append(
                self._lagged(joint)
                if recorded is None
                else (recorded(self.inside)[None], recorded(self.inside, 1)[None])
            )
        shape = (max(len(position) for position, _ in motions), len(self.grid))
        position, velocity = (
            np.stack([np.broadcast_to(array, shape) for array in arrays], axis=2)
            for arrays in zip(*motions, strict=True)
        )
        return position, velocity

    @property
    def _drive_starts(self) -> list[float]:
        return self.crane.start.q[self.layout.drives].tolist()

    def _lagged(self, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
        """Return position and rate of a drive behind its setpoint, shape (variants, rows) each."""
        aim, lags = recorded_setpoint(self.record, joint)(self.inside), f"{joint.symbol}_lag"
        motions = [lagged(aim, self.period, lag) for lag in self.value(lags).tolist()]
        position, velocity = zip(*motions, strict=True)
        return np.array(position), np.array(velocity)

    def start(self) -> State:
        """Return the initial state of each variant."""
        position, velocity = (rows.take(0, axis=1) for rows in self.motion)
        q = np.tile(self.crane.start.q, (len(self.values), 1))
        v = np.zeros_like(q)
        q[:, self.layout.drives], v[:, self.layout.drives] = position, velocity
        for (kind, symbol), index in self.record_indices.items():
            if kind == "start":
                q[:, self.layout.index(symbol)] = self.values[:, index]
            elif kind == "start rate":
                v[:, self.layout.index(symbol)] = self.values[:, index]
        for joint, coordinate in zip(self.layout.driven, self.layout.drives, strict=True):
            q[:, coordinate] += self.value(f"{joint.symbol}_offset")
        return State(q, v)

    def _efforts(self) -> Tracking:
        """Return a controller that applies the recorded efforts, each until the next row."""
        rows = np.searchsorted(self.record.t, self.grid + 1e-9 * self.period, side="right") - 1
        rows = np.clip(rows, 0, len(self.record.t) - 1)
        efforts = np.stack(
            [self.record.columns[joint.effort_column][rows] for joint in self.layout.driven], axis=1
        )
        width = 2 * self.layout.n
        gain = np.zeros((len(rows), self.layout.m, width))
        return Tracking(self.period, efforts, gain, np.zeros((len(rows), width)))

    def _hold_controllers(self) -> tuple[list[Any], list[Any]]:
        """Return hold controllers with the gains of each variant, and their setpoints."""
        usual = hold_controller(self.crane)
        stiffness, damping = (
            np.stack(
                [
                    self.value(f"{joint.symbol}_{kind}", float(gain))
                    for joint, gain in zip(self.layout.driven, gains, strict=True)
                ],
                axis=1,
            )
            for kind, gains in (("stiffness", usual.stiffness), ("damping", usual.damping))
        )
        gains, aims = zip(stiffness, damping, strict=True), self._setpoints()
        controllers = [Hold(self.crane, *pair, usual.feed_forward) for pair in gains]
        still = np.zeros_like(aims[0])
        return controllers, [SampledMotion(self.period, aim, still) for aim in aims]

    def _setpoints(self) -> np.ndarray:
        """Return the recorded setpoints of the drives, or the positions where they are held, in the
        true coordinate, shape (variants, rows, m).
        """
        aims = np.empty((len(self.values), len(self.grid), self.layout.m))
        for i, (joint, start) in enumerate(
            zip(self.layout.driven, self._drive_starts, strict=True)
        ):
            index = self.record_indices.get(("setpoint", joint.symbol))
            if joint.setpoint_column in self.record.columns:
                aims[:, :, i] = recorded_setpoint(self.record, joint)(self.inside)
            elif index is not None:
                aims[:, :, i] = self.values[:, index][:, None]
            else:
                aims[:, :, i] = np.mean(self.record.columns.get(joint.columns[0], start))
            aims[:, :, i] += self.value(f"{joint.symbol}_offset")[:, None]
        return aims

    def _reported(self, batch: Batch, coordinate: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a swing and its rate as their sensor reports them at the rows evaluated, late by
        its delay [s] and averaged over its window [s]; shape (variants, rows) each.
        """
        angle, rate = batch.q[:, :, coordinate], batch.v[:, :, coordinate]
        delay, window = self.value("delay"), self.value("window")
        if "window" not in self.indices:
            return self._interpolate(angle, rate, delay)
        # The integral of the cubics between the control instants.
        jumps = rate[:, :-1] - rate[:, 1:]
        pieces = (angle[:, :-1] + angle[:, 1:]) / 2.0 + self.period * jumps / 12.0
        integral = np.zeros_like(angle)
        np.cumsum(self.period * pieces, axis=1, out=integral[:, 1:])
        last, first = (
            np.stack(self._interpolate(integral, angle, age)) for age in (delay, delay + window)
        )
        swing, swing_rate = (last - first) / window[:, None]
        return swing, swing_rate

    def _interpolate(
        self, values: np.ndarray, rates: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return values and their rates at the rows evaluated, less a delay [s] of each variant, by
        cubic Hermite interpolation between the control instants; shape (variants, rows) each.

        Args:
            values: Values at the control instants, shape (variants, instants).
            rates: Their time derivatives [1/s], shape (variants, instants).
            delay: Delay of each variant [s], shape (variants,).
        """
        position = np.clip((self.t - delay[:, None]) / self.period, 0.0, len(self.grid) - 1.001)
        k = position.astype(int)
        s = position - k
        slope = self.period * rates
        q0, q1, v0, v1 = (
            np.take_along_axis(a, k + i, axis=1) for a in (values, slope) for i in (0, 1)
        )
        rise = q1 - q0
        square, cube = 3.0 * rise - 2.0 * v0 - v1, v0 + v1 - 2.0 * rise
        rate = (v0 + s * (2.0 * square + 3.0 * s * cube)) / self.period
        return q0 + s * (v0 + s * (square + s * cube)), rate

    def _effort(self, batch: Batch, channel: Channel, joint: Joint) -> np.ndarray:
        """Return the effort of a drive, dry friction included, shape (variants, rows): at a control
        instant the mean of those of its acceleration before and after.
        """
        cost = batch.effort[:, :, channel.drive].copy()
        cost[:, 1:] += batch.before[:, 1:, channel.drive]
        cost[:, 1:] /= 2.0
        rate = batch.v[:, :, channel.at]
        curve = self.record.curves.get(joint.columns[0])
        if curve is None or self.problem.drives != "motion":
            moves = np.tanh((rate / _STANDING[joint.unit]) ** 3)
        else:
            moves = np.sign(rate) * (np.abs(rate) > curve.creep)
        return cost + self.value(f"{joint.symbol}_friction")[:, None] * moves

    def _undecided(self, joint: Joint) -> np.ndarray:
        """Return whether it is open in each row evaluated if a drive stands, shape (rows,): its
        smoothed motion begins before it does and ends after it.
        """
        curve = self.record.curves.get(joint.columns[0])
        if curve is None or self.problem.drives != "motion":
            return np.zeros(len(self.t), dtype=bool)
        rate = np.abs(curve.spline.derivative()(self.record.t))
        moving = self.record.t[rate > curve.creep]
        if not len(moving):
            return np.zeros(len(self.t), dtype=bool)
        later = np.clip(np.searchsorted(moving, self.t), 0, len(moving) - 1)
        earlier = np.maximum(later - 1, 0)
        away = np.minimum(np.abs(moving[later] - self.t), np.abs(moving[earlier] - self.t))
        slow = np.abs(curve.spline.derivative()(self.t)) < _SURELY_MOVES * curve.creep
        return slow & (away < _SURELY_STANDS / curve.cutoff)


@dataclass(frozen=True, eq=False)
class Model(EstimationProblem):
    """Model of records of one crane: predicts them from values of the parameters."""

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps of finite differences, shape (parameters,): some channel changes by a millionth of
        its range.
        """
        factor = np.where(
            self.sensitivity > 0.0, _CHANGE / np.where(self.sensitivity, self.sensitivity, 1.0), 1.0
        )
        return self._trial_steps * np.clip(factor, 1e-6, 1e6)

    @cached_property
    def _trial_steps(self) -> np.ndarray:
        up = self.first + self.scale <= self.bounds[1]
        return 1e-3 * np.where(up, 1.0, -1.0) * self.scale

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """Largest change of a channel, as a share of its range, with a thousandth of the scale of
        each parameter at the first values; 0 where it is round-off, shape (parameters,).
        """
        largest = np.zeros(len(self.parameters))
        for index in range(len(self.records)):
            indices, width = self.of_record(index), np.ptp(self.measured(index), axis=1)
            outputs = self.variations(index, self.first, self._trial_steps)
            change = np.abs(outputs[1:] - outputs[0]).max(axis=2)
            share = (change / np.maximum(width, 1e-9)).max(axis=1)
            share = np.where(np.isfinite(share), share, 0.0)
            largest[indices] = np.maximum(largest[indices], share)
        return np.where(largest > ROUND_OFF, largest, 0.0)

    def variations(
        self, index: int, values: np.ndarray, steps: np.ndarray, until: float = np.inf
    ) -> np.ndarray:
        """Predict a record at values, shape (parameters,), and with the step of each of its
        parameters, see `predicted`.
        """
        indices = self.of_record(index)
        variants = np.tile(values, (len(indices) + 1, 1))
        variants[np.arange(1, len(indices) + 1), indices] += steps[indices]
        return self.predicted(index, variants, until)

    def predicted(self, index: int, values: np.ndarray, until: float = np.inf) -> np.ndarray:
        """Predict a record, shape (variants, channels, rows evaluated); not finite where a variant
        cannot be simulated.

        Args:
            index: Index of the record.
            values: Values of all parameters for each variant, shape (variants, parameters).
            until: End of the rows evaluated [s].
        """
        # Numbers in which all cranes agree are compiled into the code. A further variant keeps the
        # parameters out of it, or each crane would need code of its own.
        varied = np.array([p.kind == "argument" for p in self.parameters])
        further = values[:1] + np.where(varied, 1e-3 * self.scale, 0.0)
        return _Variants(self, index, np.vstack([values, further]), until).outputs()[:-1]

    def run(self, index: int, values: np.ndarray, crane: Crane) -> Trajectory:
        """Simulate a record with one crane.

        Args:
            index: Index of the record.
            values: Values of all parameters, shape (parameters,).
            crane: The crane with these values.
        """
        variant = _Variants(self, index, values[None])
        (controller, *_), (reference, *_) = variant.controllers(crane)
        start = State(*(array[0] for array in variant.start()))
        settings = {"start": start, "validity": "mark", "engine": "compiled", **variant.settings}
        return simulate(crane, controller, reference, **settings)
