"""Simulation of a record by many variants of a crane, in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification.motion import SampledMotion, lagged, recorded_motion, recorded_setpoint
from cranedyn.identification.parameters import EARLY
from cranedyn.identification.problem import Channel, EstimationProblem
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold

PERIODS = {"motion": 0.01, "effort": 5e-3, "hold": 5e-3}
"""Control period and step [s]: prescribed drives are smooth, a hold controller keeps its command
for one."""

_STANDING = {"rad": 1e-4, "m": 1e-3}
"""Rate below which a drive counts as standing [per second]: a hundredth of usual rates. No dry
friction is predicted there, since it may be anything up to that of a moving drive."""


class Variants:
    """A record simulated by variants of the crane, each with its values of the parameters."""

    def __init__(
        self, problem: EstimationProblem, index: int, values: np.ndarray, until: float = np.inf
    ) -> None:
        self.problem, self.index, self.values = problem, index, values
        self.record, self.layout = problem.records[index], problem.prior.crane.layout
        self.period = PERIODS[problem.drives]
        self.rows = problem.rows(index, until)
        duration = float(self.record.t[self.rows[-1]]) if len(self.rows) else 0.0
        has_delay = any(p.kind == "delay" for p in problem.parameters)
        count = int(np.ceil((duration - (EARLY if has_delay else 0.0)) / self.period)) + 2
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

    def cranes(self) -> list[Crane]:
        """Return the crane of each variant; equal cranes are the same object."""
        family = self.problem.family
        indices = [self.indices[name] for name in family.names]
        rows = [tuple(row) for row in self.values[:, indices].tolist()]
        cranes = {row: family.at(np.array(row)) for row in dict.fromkeys(rows)}
        return [cranes[row] for row in rows]

    def batch(self) -> Batch:
        """Simulate all variants."""
        cranes, start = self.cranes(), self.start()
        controller, reference = self.controllers(cranes)
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

    def controllers(self, cranes: Sequence[Crane]) -> tuple[list[Any], list[Any]]:
        """Return controllers and references, one for all variants or one for each."""
        still = [hold(cranes[0], cranes[0].start)]
        if self.problem.drives == "motion":
            motions = [
                SampledMotion(self.period, *arrays) for arrays in zip(*self.motion, strict=True)
            ]
            return [follow(cranes[0], motion, self.period) for motion in motions], still
        if self.problem.drives == "effort":
            return [self._efforts()], still
        return self._hold_controllers()

    @property
    def duration(self) -> float:
        """Duration of the simulation [s]."""
        return float(self.period * (len(self.grid) - 1))

    @property
    def drive(self) -> Drive:
        """Drive mode."""
        return "motion" if self.problem.drives == "motion" else "effort"

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and rates of the drives, shape (variants or 1, rows, m) each."""
        lags = [self.value(f"{j.symbol}_lag") for j in self.layout.driven]
        driven = self.layout.driven
        motions = [
            recorded_motion(self.record, joint, float(self.problem.prior.crane.start.q[coordinate]))
            for joint, coordinate in zip(driven, self.layout.drives, strict=True)
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
        """Return the initial state of each variant."""
        position, velocity = self.motion
        crane, variants = self.problem.prior.crane, len(self.values)
        q = np.tile(crane.start.q, (variants, 1))
        v = np.zeros_like(q)
        q[:, self.layout.drives] = np.take(position, 0, axis=1)
        v[:, self.layout.drives] = np.take(velocity, 0, axis=1)
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
        usual, crane = hold_controller(self.problem.prior.crane), self.problem.prior.crane
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
        controllers = [
            Hold(crane, stiff, damped, usual.feed_forward)
            for stiff, damped in zip(gains["stiffness"], gains["damping"], strict=True)
        ]
        still = np.zeros_like(aims[0])
        return controllers, [SampledMotion(self.period, aim, still) for aim in aims]

    def _setpoints(self) -> np.ndarray:
        """Return the recorded setpoints of the drives, or the positions where they are held, in the
        true coordinate, shape (variants, rows, m).
        """
        aims = np.empty((len(self.values), len(self.grid), self.layout.m))
        for i, (joint, coordinate) in enumerate(
            zip(self.layout.driven, self.layout.drives, strict=True)
        ):
            column, index = (
                joint.setpoint_column,
                self.record_indices.get(("setpoint", joint.symbol)),
            )
            if column in self.record.columns:
                aims[:, :, i] = recorded_setpoint(self.record, joint)(self.inside)
            elif index is not None:
                aims[:, :, i] = self.values[:, index][:, None]
            else:
                still = self.record.columns.get(
                    joint.columns[0], self.problem.prior.crane.start.q[coordinate]
                )
                aims[:, :, i] = np.mean(still)
            aims[:, :, i] += self.value(f"{joint.symbol}_offset")[:, None]
        return aims

    def outputs(self, batch: Batch) -> np.ndarray:
        """Return the predicted channels of a batch, shape (variants, channels, rows)."""
        channels, t = self.problem.channels[self.index], self.record.t[self.rows]
        outputs = np.empty((len(self.values), len(channels), len(t)))
        for c, channel in enumerate(channels):
            if channel.kind == "swing":
                delay = self.value("delay")
                symbol = self.layout.symbols[channel.at]
                values = self._interpolate(batch, channel.at, t[None] - delay[:, None])
                outputs[:, c] = values + self.value(f"{symbol}_bias")[:, None]
            elif channel.kind == "position":
                symbol = self.layout.symbols[channel.at]
                values = self._interpolate(
                    batch, channel.at, np.broadcast_to(t, outputs[:, c].shape)
                )
                outputs[:, c] = values - self.value(f"{symbol}_offset")[:, None]
            elif channel.kind == "lagged":
                outputs[:, c] = self._lagged(channel, t)
            else:
                outputs[:, c] = self._effort(batch, channel, t)
        return outputs

    def _interpolate(self, batch: Batch, coordinate: int, times: np.ndarray) -> np.ndarray:
        """Return a coordinate at times [s] of each variant, by cubic Hermite interpolation; shape
        (variants, rows).
        """
        position = np.clip(times / self.period, 0.0, len(self.grid) - 1.001)
        k = position.astype(int)
        s = position - k
        q0, q1 = (np.take_along_axis(batch.q[:, :, coordinate], k + i, axis=1) for i in (0, 1))
        v0, v1 = (
            self.period * np.take_along_axis(batch.v[:, :, coordinate], k + i, axis=1)
            for i in (0, 1)
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
        """Return the effort of a drive, dry friction included, shape (variants, rows): at a control
        instant the mean of those of its acceleration before and after.
        """
        joint = self.layout.joints[channel.at]
        rate = batch.v[:, :, channel.at]
        friction = self.value(f"{joint.symbol}_friction")[:, None]
        cost = batch.effort[:, :, channel.drive].copy()
        cost[:, 1:] += batch.before[:, 1:, channel.drive]
        cost[:, 1:] /= 2.0
        moves = np.tanh((rate / _STANDING[joint.unit]) ** 3)
        return np.array([np.interp(t, self.grid, lane) for lane in cost + friction * moves])
