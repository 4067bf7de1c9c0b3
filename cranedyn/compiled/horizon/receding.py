"""Model predictive control to a setpoint or along a motion, with a compiled optimisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from llvmlite import ir

from cranedyn.checks import (
    ShortRepr,
    check_choice,
    finite,
    number,
    weight_matrix,
    whole,
    within,
)
from cranedyn.clocks import SAME_PERIOD, multiple, whole_periods
from cranedyn.compiled.binding import Instant, aligned_copy
from cranedyn.compiled.horizon import model
from cranedyn.compiled.horizon.control import emit_instant, emit_plan
from cranedyn.compiled.horizon.memory import REPORT, Programme, lane_memory
from cranedyn.compiled.horizon.planning import Marks
from cranedyn.compiled.machine import Machine, translate
from cranedyn.controllers.tracking import check_finite
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.plant.plant import Plant, Topology, numbers, plant
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import ROW_TOLERANCE

PRICE = 1e6
"""Cost of exceeding a bound by its own size in one stage."""

_BARRIER = 0.02
"""Distance of the first iterate from a bound, as a share of the bound's size."""

_NONE = 1e9
"""Bound that is never active."""

_STAGES = 200

_RIGHT = math.pi / 2.0
"""Largest plausible swing from rest [rad]."""

_FASTEST = 10.0
"""Largest plausible rate of a drive as a multiple of its limit, ours; that of a swing is twice the
rate of a load that falls from the height of its pivot."""

TAUT = 0.1
"""Least tension of the rope, as a share of the payload's weight."""

INPUT = 10.0
"""Accelerations of the drives with the same weight as the errors of `Tuning`, as a multiple of
their limits."""

PENDULUM = 7.75356
"""Period of the pendulum [s] for which the numbers of `Tuning` were chosen: of the default crane
with 14.9 m of cable, the middle of its range."""


@dataclass(frozen=True)
class Tuning:
    """Times and errors of a predictive controller, ours.

    The defaults are for a load that swings with a period of `PENDULUM`. Motions of another crane
    are alike where all times go with its period and all lengths with the square of that.

    Attributes:
        period: Time between optimisations [s].
        to_goal: Length of a stage [s] on the way to a goal: the horizon should cover a period of
            the swing and the stopping time of a drive.
        on_path: Length of a stage [s] along a motion; shorter stages follow it more closely.
        settling: Time constant of the disturbance estimate [s].
        smoothing: Time constant of the swing filter [s].
        recalled: Time constant with which measured rates correct commanded ones [s].
        payload: Errors of the payload's position [m] and rate [m/s] with equal weight.
        revolute: Errors of each revolute joint with that weight [rad, rad/s].
        prismatic: Errors of each prismatic joint with that weight [m, m/s].
    """

    period: float = 0.05
    to_goal: float = 0.4
    on_path: float = 0.2
    settling: float = 0.1
    smoothing: float = 0.2
    recalled: float = 3.0
    payload: tuple[float, float] = (0.22, 0.16)
    revolute: tuple[float, float] = (0.1, 0.1)
    prismatic: tuple[float, float] = (1.0, 1.0)

    def errors(self, layout: Layout) -> tuple[float, ...]:
        """Return errors of coordinates, then of rates of each joint that weigh alike."""
        by_kind = {"revolute": self.revolute, "prismatic": self.prismatic}
        return tuple(by_kind[joint.kind][i] for i in (0, 1) for joint in layout.joints)

    def slower(self, time: float) -> Tuning:
        """Return the tuning for a crane whose motions take a multiple of the time."""
        times = ("period", "to_goal", "on_path", "settling", "smoothing", "recalled")
        length = time**2  # so that rates go with the time
        return Tuning(
            **{name: time * getattr(self, name) for name in times},
            payload=(self.payload[0] * length, self.payload[1] * time),
            revolute=(self.revolute[0], self.revolute[1] / time),
            prismatic=(self.prismatic[0] * length, self.prismatic[1] * time),
        )


@dataclass(eq=False, repr=False)
class Receding(ShortRepr):
    """Predictive controller with memory: create a new one for each run.

    Attributes:
        programme: Parameters of its code.
        table: Memory of an optimisation before the first, shape (doubles,).
        path: Coordinates and rates to track by control instant, shape (rows, 2 n); no rows for a
            setpoint.
    """

    programme: Programme
    table: np.ndarray
    path: np.ndarray
    _instant: Instant = field(init=False, repr=False)
    _memory: np.ndarray = field(init=False, repr=False)
    _when: int | None = field(default=None, init=False)
    _last: float = field(default=-math.inf, init=False)

    def __post_init__(self) -> None:
        """Check the arrays, compile the code and allocate its memory.

        Raises:
            OutOfRange: If the table or the path is not of the programme's size.
        """
        shape = self.programme.shape(1)
        self.table = finite("table", self.table, (shape.size,))
        self.path = finite("path", self.path, (self.programme.rows, shape.states))
        self._memory = aligned_copy(self.memory(1))
        self._bind()

    def _bind(self) -> None:
        self._instant = Instant(_compile(self.programme).machine, self._memory, self.programme)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the code, for a copy with its own memory."""
        return {name: value for name, value in vars(self).items() if name != "_instant"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and bind the code to its memory."""
        vars(self).update(state)
        self._bind()

    def memory(self, lanes: int) -> np.ndarray:
        """Return the memory of a group of so many cranes before a run, shape (doubles,)."""
        offsets = self.programme.offsets(lanes)
        memory = np.zeros(offsets.size)
        memory[offsets.work :] = np.repeat(self.table, lanes)
        self._of_lanes(memory, lanes, "read")[:] = self._row("start")[:, None]
        memory[offsets.path : offsets.path + self.path.size] = self.path.ravel()
        return memory

    def _row(self, name: str) -> np.ndarray:
        """Return a row of the table about states, shape (2 n,)."""
        shape = self.programme.shape(1)
        return self.table[shape.place(name) :][: shape.states]

    def _of_lanes(self, memory: np.ndarray, lanes: int, name: str) -> np.ndarray:
        """Return a view of a section of the lanes' memory, shape (numbers, lanes)."""
        offsets = self.programme.offsets(lanes)
        slots = lane_memory(self.programme.topology.layout)
        return memory[offsets.lanes : offsets.plans].reshape(-1, lanes)[slots[name]]

    def refusals(self, memory: np.ndarray, lanes: int) -> np.ndarray:
        """Return the number of implausible readings in each lane, shape (lanes,)."""
        return self._of_lanes(memory, lanes, "refusals")[0].astype(int)

    def initial_memory(self, t: float, lanes: int) -> np.ndarray:
        """Return memory as `memory`, for a compiled loop that begins at a time [s]."""
        memory = self.memory(lanes)
        memory[self.programme.offsets(lanes).counts :][:2].view(np.int64)[:] = self._count(t)
        return memory

    @property
    def marks(self) -> Marks:
        """Outcome of the optimisations so far."""
        return self.marks_by_lane(self._memory, 1)[0]

    def memory_of_optimisation(self) -> np.ndarray:
        """Return a copy of the memory of the last optimisation, see
        `cranedyn.compiled.horizon.memory`.
        """
        return self._memory[self.programme.offsets(1).work :].copy()

    def notes(self) -> dict[str, object]:
        """Return notes for a run, see `cranedyn.simulation.record.controller_notes`."""
        notes: dict[str, object] = {"failed_optimisations": int(self.marks.failures)}
        if refusals := int(self.refusals(self._memory, 1)[0]):
            joints = self.programme.topology.layout.joints
            columns = [joint.columns[i] for i in (0, 1) for joint in joints]
            read = self._of_lanes(self._memory, 1, "refused")[:, 0]
            wrong = (read < self._row("least")) | (read > self._row("most"))
            notes["refused_readings"] = refusals
            notes["last_refused"] = {columns[i]: float(read[i]) for i in np.flatnonzero(wrong)}
        return notes

    def marks_by_lane(self, memory: np.ndarray, lanes: int) -> list[Marks]:
        """Return the outcome of the optimisations in each lane of a memory."""
        offsets, shape = self.programme.offsets(lanes), self.programme.shape(lanes)
        last = offsets.plans + shape.stages * shape.lanes * lanes
        numbers = memory[last:][: len(Marks._fields) * lanes].reshape(-1, lanes)
        return [Marks(*column) for column in numbers.T.tolist()]

    def begin_run(self, t: float, control_period: float) -> None:
        """Check the control period, see `cranedyn.clocks.Clocked`.

        Raises:
            OutOfRange: If the run's control period is another than the controller's.
        """
        period = self.programme.period
        if not math.isclose(control_period, period, rel_tol=SAME_PERIOD):
            allowed = f"the controller's, {period:g}"
            raise OutOfRange("control period of the run", control_period, allowed, "s")

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], accelerations or rates, shape (m,).

        Raises:
            OutOfRange: If a coordinate or rate is not finite.
        """
        numbers = np.concatenate([*state, setpoint.position])
        if not math.isfinite(sum(numbers.tolist())):
            check_finite(state)
        count = self._count(t)
        period = count // self.programme.ratio
        if t < self._last:
            self._begin()
        due = period != self._when
        self._when = period
        self._last = t
        return self._instant(numbers, count, due)

    def _count(self, t: float) -> int:
        return max(0, math.floor(t / self.programme.period + ROW_TOLERANCE))

    def _begin(self) -> None:
        self._memory[:], self._when = self.memory(1), None

    def resume_memory(self, t: float) -> np.ndarray:
        """Return its memory for a compiled loop that continues from a control instant [s], shape
        (1, doubles).
        """
        if t < self._last:
            self._begin()
        counts = self._memory[self.programme.offsets(1).counts :][:2].view(np.int64)
        counts[:] = self._count(t), self._count(t) if self._when is None else -1
        return self._memory[None]

    def advance_to(self, t: float) -> None:
        """Record that a compiled loop has advanced through a control instant [s]."""
        self._when = self._count(t) // self.programme.ratio
        self._last = t


class _CompiledProgramme(NamedTuple):
    """Code of a programme, and the constants in the memory of each stage."""

    machine: Machine
    constants: list[tuple[str, int, int, float]]


@lru_cache(maxsize=64)
def _compile(programme: Programme) -> _CompiledProgramme:
    module = ir.Module()
    constants = emit_plan(module, programme)
    emit_instant(module, programme)
    return _CompiledProgramme(translate(module), constants)


def receding(
    crane: Crane,
    limits: Limits,
    *,
    motion: Motion | None = None,
    drive: Drive = "effort",
    converters: Converters | None = None,
    swing_limit: float = 0.1,
    control_period: float = 5e-3,
    period: float | None = None,
    stages: int = 40,
    stage: float | None = None,
    input_weight: np.ndarray | None = None,
    settling: float | None = None,
    smoothing: float | None = None,
) -> Receding:
    """Create a model predictive controller on the nonlinear crane, from any state.

    The soft constraints are the ranges of the joints, the rates, accelerations and efforts of the
    drives, a bound of the swing, and a least tension of the rope; an infeasible one is exceeded as
    little as possible. Efforts are always clipped to their limits, and the hoist never slackens the
    rope.

    Default times and errors follow from the pendulum of the crane, see `Tuning`.

    Args:
        crane: The crane, rigid.
        limits: Limits of the rates and accelerations of the drives, beside the crane's rate limits.
        motion: Motion to track; None to go to the setpoint of the reference.
        drive: Kind of command: "effort", "motion", or "velocity", the rates at which frequency
            converters accelerate the drives as planned, see
            `cranedyn.controllers.velocity_command`.
        converters: Converters of drives that take velocities; None for typical ones.
        swing_limit: Largest size of each swing from rest [rad], below π/2.
        control_period: Control period of the run [s].
        period: Time between optimisations [s], a multiple of the control period.
        stages: Number of stages of the horizon.
        stage: Length of a stage [s], a multiple of the control period.
        input_weight: R for the accelerations of the drives, shape (m, m); None for
            `usual_input_weight`.
        settling: Time constant of the disturbance estimate [s].
        smoothing: Time constant of the swing filter [s]; up to the control period for no filter.

    Raises:
        OutOfRange: If a number is out of range, times do not divide, or the weight is not symmetric
            and positive definite.
        CraneError: If the crane is elastic.
    """
    check_choice("drive", drive, Drive)
    layout = crane.layout
    if crane.springs.any:
        raise CraneError(
            "This predictive controller is made for a rigid crane; this one has springs."
        )
    number("control_period", control_period, "s", "> 0")
    crane.require_independent_joints("Predictive control")
    topology = Topology.of(crane)
    values = tuple(numbers(crane).tolist())
    swing_period = _swing_period(crane, plant(topology, list(values), "motion", False))
    tuning = Tuning().slower(swing_period / PENDULUM)
    if period is None:
        period = whole_periods(tuning.period, control_period)
    if stage is None:
        length = tuning.to_goal if motion is None else tuning.on_path
        stage = whole_periods(length, control_period)
    settling = max(tuning.settling, control_period) if settling is None else settling
    smoothing = tuning.smoothing if smoothing is None else smoothing
    ratio = multiple("period", period, "control_period", control_period)
    multiple("stage", stage, "control_period", control_period)
    within("stages", whole("stages", stages, 2, "stages"), 2, _STAGES)
    within("settling", number("settling", settling, "s", "> 0"), control_period, 1e3, "s")
    within("smoothing", number("smoothing", smoothing, "s", "> 0"), 0.0, 1e3, "s")
    swing = number("swing limit", swing_limit, "rad", "> 0")
    within("swing limit", swing, 0.0, 1.57, "rad")
    if motion is not None:
        motion.check_fits("motion", layout)
    if motion is not None and not math.isclose(motion.period, control_period, rel_tol=SAME_PERIOD):
        allowed = f"the control period, {control_period:g}"
        raise OutOfRange("period of the motion", motion.period, allowed, "s")
    drive_limits = limits.for_crane(crane)
    rates, accelerations = np.array(drive_limits.rates), np.array(drive_limits.accelerations)
    lags = fitting(crane, drive, converters)
    hoist = layout.drive_of("hoist")
    weight = 0.0 if hoist is None else float(abs(holding_effort(crane, crane.start.q)[hoist]))
    path = np.zeros((0, 2 * layout.n)) if motion is None else np.hstack([motion.q, motion.v])
    programme = Programme(
        topology,
        values,
        drive,
        stages,
        stage,
        control_period,
        ratio,
        len(path),
        min(1.0, control_period / settling),
        min(1.0, control_period / smoothing),
        min(1.0, control_period / tuning.recalled),
        swing,
        TAUT * weight,
        tuning.errors(layout),
        tuning.payload,
        () if lags is None else tuple((lags.lags + lags.ahead(control_period)).tolist()),
    )
    cost = _weights(crane, accelerations, input_weight)
    bounds = _bounds(crane, rates, accelerations, swing, programme.taut)
    rows = bounds | _plausible(crane, rates, programme)
    return Receding(programme, _table(programme, cost, rows), path)


def usual_input_weight(accelerations: np.ndarray) -> np.ndarray:
    """Return R for drives with limits of acceleration, shape (m, m), see `INPUT`."""
    return np.diag((INPUT * accelerations) ** -2.0)


def _weights(
    crane: Crane, accelerations: np.ndarray, input_weight: np.ndarray | None
) -> np.ndarray:
    """Return the weight of states and inputs together, shape (2 n + m, 2 n + m); code writes that
    of the states.
    """
    layout = crane.layout
    r = usual_input_weight(accelerations) if input_weight is None else input_weight
    r = weight_matrix("input weight", r, layout.m, definite=True)
    return scipy.linalg.block_diag(np.eye(2 * layout.n), r)


def _bounds(
    crane: Crane, rates: np.ndarray, accelerations: np.ndarray, swing: float, taut: float
) -> dict[str, np.ndarray]:
    """Return lower and upper bounds of all bounded values, and the prices of exceeding them."""
    layout = crane.layout
    n, m, drives = layout.n, layout.m, layout.drives
    low = np.full(2 * n + 2 * m, -_NONE)
    high = np.full(2 * n + 2 * m, _NONE)
    size = np.ones(len(low))
    low[drives], high[drives] = crane.lower[drives], crane.upper[drives]
    low[crane.swings], high[crane.swings], size[crane.swings] = -swing, swing, swing
    for first, limit in (
        (n + drives, rates),
        (2 * n + np.arange(m), accelerations),
        (2 * n + m + np.arange(m), crane.effort_limit),
    ):
        low[first], high[first], size[first] = -limit, limit, limit
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        high[2 * n + m + hoist] = -taut
    return {"low": low, "high": high, "price": PRICE / size}


def _plausible(crane: Crane, rates: np.ndarray, programme: Programme) -> dict[str, np.ndarray]:
    """Return the least and largest plausible coordinates and rates, and the state before the first
    reading.
    """
    layout = crane.layout
    start = crane.start.q
    drives, swings, n = layout.drives, crane.swings, layout.n
    low = np.full(2 * n, -_NONE)
    high = np.full(2 * n, _NONE)
    span = crane.upper - crane.lower
    low[drives], high[drives] = (crane.lower - span)[drives], (crane.upper + span)[drives]
    ends = np.clip([crane.lower[drives], crane.upper[drives]], -_NONE, _NONE)[:, None]
    turned = crane.rest.slope * ends
    short = start.copy()
    if (hoist := layout.drive_of("hoist")) is not None:
        short[drives[hoist]] = crane.lower[drives[hoist]]
    swinging = 2.0 * math.sqrt(2.0) * _frequencies(programme.plant, short).max(initial=0.0)
    low[swings] = crane.rest.angle + turned.min(axis=0).sum(axis=-1) - _RIGHT
    high[swings] = crane.rest.angle + turned.max(axis=0).sum(axis=-1) + _RIGHT
    high[n + swings], high[n + drives] = swinging, _FASTEST * rates
    low[n:] = -high[n:]
    return {
        "least": np.clip(low, -_NONE, _NONE),
        "most": np.clip(high, -_NONE, _NONE),
        "start": np.concatenate([start, np.zeros(n)]),
    }


def _frequencies(plant: Plant, q: np.ndarray) -> np.ndarray:
    """Return natural frequencies of free swing at standing drives [rad/s], shape (n - m,)."""
    layout = plant.topology.layout
    still = np.zeros(layout.n)
    slopes = model.crane_derivatives(plant, q, still, np.zeros(layout.m)).rates[layout.passive]
    stiffness = -slopes[:, layout.passive].astype(float)
    return np.sqrt(np.clip(np.linalg.eigvals(stiffness).real, 0.0, None))


def _swing_period(crane: Crane, plant: Plant) -> float:
    """Return the period of the slowest swing with the drives in the middle of their ranges [s], or
    `PENDULUM` if nothing swings.
    """
    q = crane.start.q.copy()
    middle = (crane.lower + crane.upper) / 2.0
    drives = crane.layout.drives[np.isfinite(middle[crane.layout.drives])]
    q[drives] = middle[drives]
    frequencies = _frequencies(plant, crane.resting(q))
    swinging = frequencies[frequencies > 1e-6 * frequencies.max(initial=0.0)]
    return 2.0 * math.pi / float(swinging.min()) if len(swinging) else PENDULUM


def _table(programme: Programme, cost: np.ndarray, rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return the memory of an optimisation before the first."""
    shape = programme.shape(1)
    table = np.zeros(shape.size)

    def row(name: str, i: int = 0) -> np.ndarray:
        return table[shape.place(name, i) :][: shape.lanes]

    for i, numbers_ in enumerate(cost):
        row("weight", i)[: len(cost)] = numbers_
    row("low")[:], row("high")[:], row("price")[:] = -_NONE, _NONE, PRICE
    for name, values in rows.items():
        row(name)[: len(values)] = values
    row("report")[REPORT.index("first")] = _BARRIER * PRICE
    stages = table[shape.first :].reshape(shape.stages, shape.stride)
    for name, i, lane, value in _compile(programme).constants:
        stages[:, shape.place(name, i) + lane] = value
    return table
