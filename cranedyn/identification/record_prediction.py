"""Prediction of records: many variants of a crane, simulated in one batch.

A *variant* is the crane with one set of values of all parameters. A Jacobian by finite differences
needs one variant for each parameter and one more; all of them run as the lanes of one batch
(`cranedyn.compiled.batch`), on a grid of control instants. What the sensors report at the recorded
times is interpolated from that grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification.drive_motion import (
    SampledMotion,
    lagged,
    recorded_motion,
    recorded_setpoint,
)
from cranedyn.identification.problem import Channel, EstimationProblem
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate

PERIODS = {"motion": 0.01, "effort": 5e-3, "hold": 5e-3}
"""Control period and physics step [s], by how the drives are simulated. Prescribed motions are
smooth and allow a longer one; a hold controller keeps its command for a whole period."""

_STANDSTILL_RATE = {"rad": 1e-4, "m": 1e-3}
"""Rate below which a drive counts as standing [per second]: a hundredth of usual rates. No dry
friction is predicted there, since it may be anything up to that of a moving drive."""

_SURELY_MOVES = 3.0
"""Ratio of the rate of a smoothed motion to its creep from which on the drive surely moves."""

_SURELY_STANDS = 3.0
"""Time since or until a moving row, in units of one over the cutoff of a smoothed motion, from
which on a slow drive surely stands. The kernel of the smoothing decays as exp(-cutoff |t| / 2): the
poles of its gain 1 / (1 + (ω / cutoff)^6) that lie nearest to the real axis are at half the
cutoff from it."""

_TARGET_CHANGE = 1e-6
"""Change of a channel, as a share of its range, at which the steps of finite differences aim."""

_TRIAL_STEP = 1e-3
"""Step by which the sensitivity of the channels is tried, as a share of a parameter's scale."""

ROUND_OFF = 1e-12
"""Changes of a channel below this share of its range are round-off."""


class _DriveMotion(NamedTuple):
    """Motion of the drives at the control instants.

    Attributes:
        position: Positions [rad or m], shape (variants or 1, instants, m).
        velocity: Rates [rad/s or m/s], shape (variants or 1, instants, m).
    """

    position: np.ndarray
    velocity: np.ndarray


class _Controllers(NamedTuple):
    """Controllers and references of a batch, each a list with one entry for all variants, or with
    one entry for each of them.
    """

    controllers: Sequence[Controller]
    references: Sequence[Reference]


class _RecordSimulation:
    """Simulation of one record by variants of the crane.

    Attributes:
        problem: The records and parameters.
        values: Values of all parameters for each variant, shape (variants, parameters).
        channels: Channels of the record that are predicted.
        record: The record.
        crane: The crane with its prior values.
        layout: Its coordinates.
        period: Control period and physics step [s].
        t: Times of the rows evaluated [s], shape (rows,).
        grid: Times of the control instants [s], shape (instants,).
        inside: The same times, held at the end of the record, so that nothing is extrapolated.
        indices: Indices of the parameters of the crane, by name.
        record_indices: Indices of the parameters of this record, by kind and symbol.
    """

    def __init__(
        self, problem: EstimationProblem, index: int, values: np.ndarray, until: float = np.inf
    ) -> None:
        """Prepare the simulation of record `index` up to a time `until` [s]."""
        self.problem = problem
        self.values = values
        self.channels = problem.channels[index]
        self.record = problem.records[index]
        self.crane = problem.prior.crane
        self.layout = self.crane.layout
        self.period = PERIODS[problem.drives]
        self.t = self.record.t[problem.rows(index, until)]

        # A negative delay of the swing sensor reads the swing of a later time than that of its row,
        # so that the grid must reach beyond the last row by as much.
        last = float(self.t[-1]) if len(self.t) else 0.0
        count = int(np.ceil((last - problem.delay_bounds[0]) / self.period)) + 2
        self.grid = self.period * np.arange(count)
        self.inside = np.minimum(self.grid, self.record.t[-1])
        self.indices = {p.name: i for i, p in enumerate(problem.own)}
        self.record_indices = {
            (p.kind, p.of): i for i, p in enumerate(problem.parameters) if p.record == index
        }

    @property
    def duration(self) -> float:
        """Duration of the simulation [s]."""
        return float(self.period * (len(self.grid) - 1))

    @property
    def drive(self) -> Drive:
        """What the controllers command: accelerations of prescribed drives, or efforts."""
        return "motion" if self.problem.drives == "motion" else "effort"

    def value(self, name: str, default: float = 0.0) -> np.ndarray:
        """Return a parameter of the crane in each variant, shape (variants,); the default where it
        is not estimated.
        """
        index = self.indices.get(name)
        if index is None:
            return np.full(len(self.values), default)
        return self.values[:, index]

    # --- the batch --------------------------------------------------------------------------------

    def outputs(self) -> np.ndarray:
        """Simulate and return the predicted channels, shape (variants, channels, rows)."""
        batch = self._simulate()
        outputs = np.empty((len(self.values), len(self.channels), len(self.t)))
        for c, channel in enumerate(self.channels):
            outputs[:, c] = self._channel(batch, channel)
        return outputs

    def _simulate(self) -> Batch:
        """Simulate all variants from their initial states."""
        family = self.problem.family
        varied = [self.indices[name] for name in family.names]
        arguments = [tuple(row) for row in self.values[:, varied].tolist()]

        # Variants that differ in drives and sensors only share a crane: each is built once.
        cranes: dict[tuple[float, ...], Crane] = {}
        for row in arguments:
            if row not in cranes:
                cranes[row] = family.at(np.array(row))
        controllers, references = self.controllers(cranes[arguments[0]])
        return simulate_batch(
            [cranes[row] for row in arguments],
            controllers[0] if len(controllers) == 1 else controllers,
            references[0] if len(references) == 1 else references,
            start=self.start(),
            duration=self.duration,
            dt=self.period,
            control_period=self.period,
            drive=self.drive,
            integrator=rk4,
            record=1,
            base=self.record.base,
        )

    def start(self) -> State:
        """Return the initial state of each variant, shape (variants, n) each."""
        q = np.tile(self.crane.start.q, (len(self.values), 1))
        v = np.zeros_like(q)
        q[:, self.layout.drives] = self.drive_motion.position[:, 0, :]
        v[:, self.layout.drives] = self.drive_motion.velocity[:, 0, :]
        for (kind, symbol), index in self.record_indices.items():
            if kind == "start":
                q[:, self.layout.index(symbol)] = self.values[:, index]
            elif kind == "start rate":
                v[:, self.layout.index(symbol)] = self.values[:, index]
        # Recorded positions lack the offset of their sensor, the simulated crane has it.
        for joint, coordinate in zip(self.layout.driven, self.layout.drives, strict=True):
            q[:, coordinate] += self.value(f"{joint.symbol}_offset")
        return State(q, v)

    # --- drives -----------------------------------------------------------------------------------

    def controllers(self, crane: Crane) -> _Controllers:
        """Return controllers and references, one for all variants or one for each."""
        if self.problem.drives == "hold":
            return self._hold_controllers()
        standstill = [hold(crane, crane.start)]
        if self.problem.drives == "effort":
            return _Controllers([self._recorded_efforts()], standstill)
        controllers = []
        for position, velocity in zip(*self.drive_motion, strict=True):
            motion = SampledMotion(self.period, position, velocity)
            controllers.append(follow(crane, motion, self.period))
        return _Controllers(controllers, standstill)

    @cached_property
    def drive_motion(self) -> _DriveMotion:
        """Motion of the drives: as recorded, which is one for all variants, or behind the setpoints
        by the lag of each variant.
        """
        positions = []
        velocities = []
        for joint, start in zip(self.layout.driven, self._drive_starts, strict=True):
            recorded = recorded_motion(self.record, joint, start)
            if recorded is None:
                position, velocity = self._behind_setpoint(joint)
            else:
                position = recorded(self.inside)[None]
                velocity = recorded(self.inside, 1)[None]
            positions.append(position)
            velocities.append(velocity)
        shape = (max(len(position) for position in positions), len(self.grid))
        return _DriveMotion(
            np.stack([np.broadcast_to(position, shape) for position in positions], axis=2),
            np.stack([np.broadcast_to(velocity, shape) for velocity in velocities], axis=2),
        )

    @property
    def _drive_starts(self) -> list[float]:
        """Positions of the drives where the crane starts by its description."""
        return self.crane.start.q[self.layout.drives].tolist()

    def _behind_setpoint(self, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
        """Return position and rate of a drive behind its setpoint at the control instants, shape
        (variants, instants) each.
        """
        setpoint = recorded_setpoint(self.record, joint)(self.inside)
        positions = []
        velocities = []
        for lag in self.value(f"{joint.symbol}_lag").tolist():
            position, velocity = lagged(setpoint, self.period, lag)
            positions.append(position)
            velocities.append(velocity)
        return np.array(positions), np.array(velocities)

    def _recorded_efforts(self) -> Tracking:
        """Return a controller that applies the recorded efforts, each until the next row."""
        # The billionth of a period finds the row at an instant in spite of round-off.
        rows = np.searchsorted(self.record.t, self.grid + 1e-9 * self.period, side="right") - 1
        rows = np.clip(rows, 0, len(self.record.t) - 1)
        efforts = np.stack(
            [self.record.columns[joint.effort_column][rows] for joint in self.layout.driven], axis=1
        )
        state_size = 2 * self.layout.n
        no_feedback = np.zeros((len(rows), self.layout.m, state_size))
        return Tracking(self.period, efforts, no_feedback, np.zeros((len(rows), state_size)))

    def _hold_controllers(self) -> _Controllers:
        """Return hold controllers with the gains of each variant, and their setpoints."""
        usual = hold_controller(self.crane)
        stiffness = self._gains("stiffness", usual.stiffness)
        damping = self._gains("damping", usual.damping)
        setpoints = self._setpoints()
        at_rest = np.zeros_like(setpoints[0])
        controllers = []
        references = []
        for k_p, k_d, setpoint in zip(stiffness, damping, setpoints, strict=True):
            controllers.append(Hold(self.crane, k_p, k_d, usual.feed_forward))
            references.append(SampledMotion(self.period, setpoint, at_rest))
        return _Controllers(controllers, references)

    def _gains(self, kind: str, usual: np.ndarray) -> np.ndarray:
        """Return the gains of a kind, "stiffness" or "damping", of the hold controller in each
        variant, shape (variants, m).
        """
        gains = []
        for joint, gain in zip(self.layout.driven, usual, strict=True):
            gains.append(self.value(f"{joint.symbol}_{kind}", float(gain)))
        return np.stack(gains, axis=1)

    def _setpoints(self) -> np.ndarray:
        """Return the recorded setpoints of the drives, or the positions where they are held, in the
        true coordinate, shape (variants, instants, m).
        """
        setpoints = np.empty((len(self.values), len(self.grid), self.layout.m))
        for i, (joint, start) in enumerate(
            zip(self.layout.driven, self._drive_starts, strict=True)
        ):
            index = self.record_indices.get(("setpoint", joint.symbol))
            if joint.setpoint_column in self.record.columns:
                setpoints[:, :, i] = recorded_setpoint(self.record, joint)(self.inside)
            elif index is not None:
                setpoints[:, :, i] = self.values[:, index][:, None]
            else:
                setpoints[:, :, i] = np.mean(self.record.columns.get(joint.columns[0], start))
            setpoints[:, :, i] += self.value(f"{joint.symbol}_offset")[:, None]
        return setpoints

    # --- channels ---------------------------------------------------------------------------------

    def _channel(self, batch: Batch, channel: Channel) -> np.ndarray:
        """Return a channel as its sensor reports it, shape (variants, rows)."""
        joint = self.layout.joints[channel.at]
        if channel.kind == "swing":
            return self._swing(batch, channel, joint)
        if channel.kind == "position":
            no_delay = np.zeros(len(self.values))
            position, _ = self._interpolate(
                batch.q[:, :, channel.at], batch.v[:, :, channel.at], no_delay
            )
            return position - self.value(f"{joint.symbol}_offset")[:, None]
        if channel.kind == "lagged":
            position, _ = self._behind_setpoint(joint)
            return self._at_rows(position)
        return self._effort(batch, channel, joint)

    def _at_rows(self, values: np.ndarray) -> np.ndarray:
        """Return values at the control instants, interpolated linearly to the rows evaluated, shape
        (variants, rows).
        """
        return np.array([np.interp(self.t, self.grid, lane) for lane in values])

    def _swing(self, batch: Batch, channel: Channel, joint: Joint) -> np.ndarray:
        """Return the angle of a swing with the bias of its sensor, or its rate with the bias and
        the drift of a gyroscope, shape (variants, rows).
        """
        position, rate = self._reported(batch, channel.at)
        if channel.column == joint.columns[0]:
            return position + self.value(f"{joint.symbol}_bias")[:, None]
        bias = self.values[:, self.record_indices["rate bias", joint.symbol], None]
        drift = self.values[:, self.record_indices["rate drift", joint.symbol], None]
        return rate + bias + drift * self.t

    def _reported(self, batch: Batch, coordinate: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a swing and its rate as their sensor reports them at the rows evaluated: late by
        its delay [s], and averaged over its window [s] before that; shape (variants, rows) each.
        """
        angle = batch.q[:, :, coordinate]
        rate = batch.v[:, :, coordinate]
        delay = self.value("delay")
        if "window" not in self.indices:
            return self._interpolate(angle, rate, delay)
        window = self.value("window")

        # The mean over a window is the integral's difference between its ends over its length. A
        # cubic Hermite piece of length h with end values q0, q1 and end rates v0, v1 has the
        # integral h (q0 + q1) / 2 + h² (v0 - v1) / 12.
        rate_change = rate[:, :-1] - rate[:, 1:]
        mean = (angle[:, :-1] + angle[:, 1:]) / 2.0 + self.period * rate_change / 12.0
        integral = np.zeros_like(angle)
        np.cumsum(self.period * mean, axis=1, out=integral[:, 1:])
        last_integral, last_angle = self._interpolate(integral, angle, delay)
        first_integral, first_angle = self._interpolate(integral, angle, delay + window)
        swing = (last_integral - first_integral) / window[:, None]
        swing_rate = (last_angle - first_angle) / window[:, None]
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
        # Before the first instant and behind the last one the nearest of both holds. The last piece
        # ends at instant -1, so that the position must stay below its index.
        position = np.clip((self.t - delay[:, None]) / self.period, 0.0, len(self.grid) - 1.001)
        k = position.astype(int)
        s = position - k  # share of the piece that has passed, 0 to 1

        # q(s) = q0 + v0 s + square s² + cube s³, with rates v0 and v1 per piece rather than second.
        slopes = self.period * rates
        q0 = np.take_along_axis(values, k, axis=1)
        q1 = np.take_along_axis(values, k + 1, axis=1)
        v0 = np.take_along_axis(slopes, k, axis=1)
        v1 = np.take_along_axis(slopes, k + 1, axis=1)
        rise = q1 - q0
        square = 3.0 * rise - 2.0 * v0 - v1
        cube = v0 + v1 - 2.0 * rise
        rate = (v0 + s * (2.0 * square + 3.0 * s * cube)) / self.period
        return q0 + s * (v0 + s * (square + s * cube)), rate

    def _effort(self, batch: Batch, channel: Channel, joint: Joint) -> np.ndarray:
        """Return the effort of a drive, dry friction included, shape (variants, rows)."""
        # Accelerations jump at the control instants: an effort there is the mean of those before
        # and after. The first instant has none before.
        efforts = batch.effort[:, :, channel.drive].copy()
        efforts[:, 1:] += batch.before[:, 1:, channel.drive]
        efforts[:, 1:] /= 2.0

        rate = batch.v[:, :, channel.at]
        friction = self.value(f"{joint.symbol}_friction")[:, None]
        effort_at_rows = self._at_rows(efforts + friction * self._direction(rate, joint))
        if f"{joint.symbol}_friction" in self.indices:
            # Friction there is anything up to that of a moving drive. What is predicted as
            # recorded has no residual and says nothing.
            undecided = self._undecided(joint)
            recorded = self.record.columns[channel.column]
            recorded_at_rows = np.interp(self.t, self.record.t, recorded)
            effort_at_rows[:, undecided] = recorded_at_rows[undecided]
        return effort_at_rows

    def _direction(self, rate: np.ndarray, joint: Joint) -> np.ndarray:
        """Return the direction in which a drive moves at some rates, from -1 to 1; 0 where it
        stands.
        """
        curve = self.record.curves.get(joint.columns[0])
        if curve is None or self.problem.drives != "motion":
            # A smooth sign, so that finite differences see no jump. The third power keeps it near
            # zero well below the rate of standstill, and near one well above it.
            return np.tanh((rate / _STANDSTILL_RATE[joint.unit]) ** 3)
        return np.where(np.abs(rate) > curve.creep, np.sign(rate), 0.0)

    def _undecided(self, joint: Joint) -> np.ndarray:
        """Return whether it is open in each row evaluated if a drive stands, shape (rows,). A
        smoothed motion begins before the drive does and ends after it, so that for some time around
        each start and stop a slow drive may move or stand.
        """
        curve = self.record.curves.get(joint.columns[0])
        if curve is None or self.problem.drives != "motion":
            return np.zeros(len(self.t), dtype=bool)
        smooth_rate = curve.spline.derivative()
        moving_times = self.record.t[np.abs(smooth_rate(self.record.t)) > curve.creep]
        if not len(moving_times):
            return np.zeros(len(self.t), dtype=bool)

        # Time to the nearest moving row, which is the next one or the one before.
        next_row = np.clip(np.searchsorted(moving_times, self.t), 0, len(moving_times) - 1)
        previous_row = np.maximum(next_row - 1, 0)
        until_next = np.abs(moving_times[next_row] - self.t)
        since_previous = np.abs(moving_times[previous_row] - self.t)
        distance = np.minimum(until_next, since_previous)
        is_slow = np.abs(smooth_rate(self.t)) < _SURELY_MOVES * curve.creep
        return is_slow & (distance < _SURELY_STANDS / curve.cutoff)


@dataclass(frozen=True, eq=False)
class Model(EstimationProblem):
    """Model of records of one crane: predicts them from values of the parameters."""

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps of finite differences, shape (parameters,), with which some channel changes by a
        millionth of its range: far above the round-off of a simulation, and small enough that
        curvature does not matter.
        """
        has_effect = self.sensitivity > 0.0
        factor = np.where(
            has_effect, _TARGET_CHANGE / np.where(has_effect, self.sensitivity, 1.0), 1.0
        )
        return self._trial_steps * np.clip(factor, 1e-6, 1e6)

    @cached_property
    def _trial_steps(self) -> np.ndarray:
        """Steps from the first values of the search, a thousandth of the scale of each parameter;
        downwards where the scale reaches beyond the upper bound.
        """
        fits_above = self.first + self.scale <= self.bounds[1]
        return _TRIAL_STEP * np.where(fits_above, 1.0, -1.0) * self.scale

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """Largest change of a channel, as a share of its range, with a thousandth of the scale of
        each parameter at the first values; 0 where it is round-off, shape (parameters,).
        """
        largest = np.zeros(len(self.parameters))
        for index in range(len(self.records)):
            indices = self.of_record(index)
            channel_range = np.ptp(self.measured(index), axis=1)
            outputs = self.variations(index, self.first, self._trial_steps)
            change = np.abs(outputs[1:] - outputs[0]).max(axis=2)
            share = (change / np.maximum(channel_range, 1e-9)).max(axis=1)
            share = np.where(np.isfinite(share), share, 0.0)
            largest[indices] = np.maximum(largest[indices], share)
        return np.where(largest > ROUND_OFF, largest, 0.0)

    def variations(
        self, index: int, values: np.ndarray, steps: np.ndarray, until: float = np.inf
    ) -> np.ndarray:
        """Predict a record at some values, and with the step of each of its parameters.

        Args:
            index: Index of the record.
            values: Values of all parameters, shape (parameters,).
            steps: Step of each parameter, shape (parameters,).
            until: End of the rows evaluated [s].

        Returns:
            The prediction at the values, then one for each parameter of `of_record(index)`, see
            `predicted`.
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
        is_argument = np.array([p.kind == "argument" for p in self.parameters])
        further = values[:1] + np.where(is_argument, 1e-3 * self.scale, 0.0)
        simulation = _RecordSimulation(self, index, np.vstack([values, further]), until)
        return simulation.outputs()[:-1]

    def run(self, index: int, values: np.ndarray, crane: Crane) -> Trajectory:
        """Simulate a record with one crane.

        Args:
            index: Index of the record.
            values: Values of all parameters, shape (parameters,).
            crane: The crane with these values.
        """
        simulation = _RecordSimulation(self, index, values[None])
        controllers, references = simulation.controllers(crane)
        start = simulation.start()
        return simulate(
            crane,
            controllers[0],
            references[0],
            start=State(start.q[0, :], start.v[0, :]),
            duration=simulation.duration,
            dt=simulation.period,
            control_period=simulation.period,
            drive=simulation.drive,
            engine="compiled",
            validity="mark",
            integrator=rk4,
            base=simulation.record.base,
        )
