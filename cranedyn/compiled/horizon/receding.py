"""Model predictive control to a setpoint or along a motion, with a compiled optimisation.

`receding` makes a controller, `Receding`. In a plain loop it is called at each control instant. A
compiled loop runs the same code in the memory of the controller: `resume_memory` hands it out, and
`advance_to` says how far the loop has come.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
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
from cranedyn.compiled.horizon import horizon_model
from cranedyn.compiled.horizon.control_instant import emit_instant, emit_plan
from cranedyn.compiled.horizon.memory import REPORT, Programme, lane_memory
from cranedyn.compiled.horizon.planning import SolverStatus
from cranedyn.compiled.machine import Machine, translate
from cranedyn.compiled.plant.plant import Plant, Topology, make_plant, plant_numbers
from cranedyn.controllers.tracking import check_finite
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.model.rigid_rope import on_rigid_rope
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import ROW_TOLERANCE

EXCESS_PRICE = 1e6
"""Cost of exceeding a bound by its own size in one stage.

It is large against the costs of errors, which are of the order of 1, see `Tuning`: a bound is
exceeded only where no plan keeps it.
"""

_BARRIER_SHARE = 0.02
"""Distance of the first iterate from a bound, as a share of the size of the bound.

On the central path an iterate on a bound with the price p has the barrier p times that distance. As
the price is `EXCESS_PRICE` over the size, the initial barrier is the same for all bounds: that
share of `EXCESS_PRICE`.
"""

_UNBOUNDED = 1e9
"""Size of a bound that is never active."""

_MAX_STAGES = 200
"""Largest number of stages of a horizon."""

_MAX_SWING_LIMIT = 1.57
"""Largest swing from rest that can be allowed [rad]: below π/2."""

_MAX_PLAUSIBLE_SWING = math.pi / 2.0
"""Largest plausible swing from rest [rad]."""

_PLAUSIBLE_RATE_RATIO = 10.0
"""Largest plausible rate of a drive, as a multiple of its limit; ours."""

_PLAUSIBLE_SWING_RATIO = 2.0
"""Largest plausible rate of a swing, as a multiple of that of a load that falls from the height of
its pivot; ours."""

MIN_TENSION_RATIO = 0.1
"""Least tension of the rope, as a share of the payload's weight."""

INPUT_ERROR_RATIO = 10.0
"""Accelerations of the drives with the same weight as the errors of `Tuning`, as a multiple of
their limits."""

TUNED_SWING_PERIOD = 7.75356
"""Period of the pendulum for which the numbers of `Tuning` were chosen [s]: of the default crane
with 14.9 m of cable, the middle of its range."""

_MIN_FREQUENCY_RATIO = 1e-6
"""Share of the largest natural frequency up to which a mode does not swing: what is left of zero by
rounding."""

_MAX_TIME_CONSTANT = 1e3
"""Largest time constant of a filter [s]."""


@dataclass(frozen=True)
class Tuning:
    """Times and errors of a predictive controller, ours.

    The defaults are for a load that swings with a period of `TUNED_SWING_PERIOD`. Motions of
    another crane are alike where all times go with its period and all lengths with the square of
    that.

    Attributes:
        period: Time between optimisations [s].
        stage_to_goal: Length of a stage on the way to a goal [s]: the horizon should cover a period
            of the swing and the stopping time of a drive.
        stage_on_path: Length of a stage along a motion [s]; shorter stages follow it more closely.
        settling: Time constant of the disturbance estimate [s].
        smoothing: Time constant of the swing filter [s].
        rate_correction: Time constant with which measured rates correct planned ones [s].
        payload_errors: Errors of the payload's position [m] and velocity [m/s] with equal weight.
        revolute_errors: Errors of each revolute joint with that weight [rad, rad/s].
        prismatic_errors: Errors of each prismatic joint with that weight [m, m/s].
    """

    period: float = 0.05
    stage_to_goal: float = 0.4
    stage_on_path: float = 0.2
    settling: float = 0.1
    smoothing: float = 0.2
    rate_correction: float = 3.0
    payload_errors: tuple[float, float] = (0.22, 0.16)
    revolute_errors: tuple[float, float] = (0.1, 0.1)
    prismatic_errors: tuple[float, float] = (1.0, 1.0)

    def joint_errors(self, layout: Layout) -> tuple[float, ...]:
        """Return the errors of the coordinates, then of the rates of all joints that have equal
        weight [rad or m, rad/s or m/s], 2 n in all.
        """
        errors_of_kind = {"revolute": self.revolute_errors, "prismatic": self.prismatic_errors}
        of_coordinates = [errors_of_kind[joint.kind][0] for joint in layout.joints]
        of_rates = [errors_of_kind[joint.kind][1] for joint in layout.joints]
        return (*of_coordinates, *of_rates)

    def slower(self, factor: float) -> Tuning:
        """Return the tuning for a crane whose motions take `factor` times as long.

        The motion of a pendulum takes √(l / g) times as long where its length is l: lengths go with
        the square of times. So accelerations, as that of gravity, stay, and velocities go with
        times. Angles stay too, and their rates go with the inverse of times.
        """
        length_factor = factor**2
        return Tuning(
            period=factor * self.period,
            stage_to_goal=factor * self.stage_to_goal,
            stage_on_path=factor * self.stage_on_path,
            settling=factor * self.settling,
            smoothing=factor * self.smoothing,
            rate_correction=factor * self.rate_correction,
            payload_errors=_scaled(self.payload_errors, length_factor, factor),
            revolute_errors=(self.revolute_errors[0], self.revolute_errors[1] / factor),
            prismatic_errors=_scaled(self.prismatic_errors, length_factor, factor),
        )


def _scaled(
    errors: tuple[float, float], length_factor: float, velocity_factor: float
) -> tuple[float, float]:
    """Return the errors of a length and of a velocity, each times its factor."""
    return errors[0] * length_factor, errors[1] * velocity_factor


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
    _memory: np.ndarray = field(init=False, repr=False)
    _last_period: int | None = field(default=None, init=False)
    """Number of the period between optimisations in which the last call was; None before."""
    _last_time: float = field(default=-math.inf, init=False)
    """Time of the last call [s]."""

    def __post_init__(self) -> None:
        """Check the arrays and allocate the memory.

        Raises:
            OutOfRange: If the table or the path is not of the programme's size.
        """
        shape = self.programme.shape(1)
        self.table = finite("table", self.table, (shape.size,))
        self.path = finite("path", self.path, (self.programme.rows, shape.states))
        self._memory = aligned_copy(self.memory(1))

    @cached_property
    def _instant(self) -> Instant:
        """The code of a control instant, bound to the memory.

        It is compiled when it is first needed, which takes a second. A compiled loop, a batch and
        an exporter need other code of the same programme, and never this.
        """
        return Instant(_compile(self.programme), self._memory, self.programme)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the code, for a copy with its own memory."""
        return {name: value for name, value in vars(self).items() if name != "_instant"}

    def memory(self, lanes: int) -> np.ndarray:
        """Return the memory of a group of cranes before a run, one in each lane, shape
        (doubles,).
        """
        offsets = self.programme.offsets(lanes)
        memory = np.zeros(offsets.size)
        memory[offsets.work :] = np.repeat(self.table, lanes)
        self._of_lanes(memory, lanes, "reading")[:] = self._state_row("start")[:, None]
        memory[offsets.path : offsets.path + self.path.size] = self.path.ravel()
        return memory

    def _state_row(self, name: str) -> np.ndarray:
        """Return the numbers of a row of the table that stand for states, shape (2 n,)."""
        shape = self.programme.shape(1)
        first = shape.offset(name)
        return self.table[first : first + shape.states]

    def _of_lanes(self, memory: np.ndarray, lanes: int, name: str) -> np.ndarray:
        """Return a view of what the lanes remember under a name, shape (numbers, lanes)."""
        offsets = self.programme.offsets(lanes)
        places = lane_memory(self.programme.topology.layout)
        return memory[offsets.lanes : offsets.plans].reshape(-1, lanes)[places[name]]

    def _counts(self, memory: np.ndarray, lanes: int) -> np.ndarray:
        """Return a view of the two counts of a memory, see `MemoryOffsets`, shape (2,)."""
        first = self.programme.offsets(lanes).counts
        return memory[first : first + 2].view(np.int64)

    def refusals(self, memory: np.ndarray, lanes: int) -> np.ndarray:
        """Return the number of implausible readings in each lane, shape (lanes,)."""
        return self._of_lanes(memory, lanes, "refusals")[0].astype(int)

    def initial_memory(self, t: float, lanes: int) -> np.ndarray:
        """Return memory as `memory`, for a compiled loop that begins at a time [s]."""
        memory = self.memory(lanes)
        self._counts(memory, lanes)[:] = self._instant_number(t)
        return memory

    @property
    def status(self) -> SolverStatus:
        """Outcome of the optimisations so far."""
        return self.status_by_lane(self._memory, 1)[0]

    def memory_of_optimisation(self) -> np.ndarray:
        """Return a copy of the memory of the last optimisation, see
        `cranedyn.compiled.horizon.memory`.
        """
        return self._memory[self.programme.offsets(1).work :].copy()

    def notes(self) -> dict[str, object]:
        """Return notes for a run, see `cranedyn.simulation.run_record.controller_notes`."""
        notes: dict[str, object] = {"failed_optimisations": int(self.status.failures)}
        if self.programme.left_out:
            notes["planned_without"] = list(self.programme.left_out)
        refusals = int(self.refusals(self._memory, 1)[0])
        if refusals:
            notes["refused_readings"] = refusals
            notes["last_refused"] = self._last_refused()
        return notes

    def _last_refused(self) -> dict[str, float]:
        """Return the implausible numbers of the last implausible reading, by their columns."""
        joints = self.programme.topology.layout.joints
        columns = [joint.columns[0] for joint in joints]
        columns += [joint.columns[1] for joint in joints]
        reading = self._of_lanes(self._memory, 1, "refused_reading")[:, 0]
        least = self._state_row("least_plausible")
        most = self._state_row("most_plausible")
        refused = {}
        for i in np.flatnonzero((reading < least) | (reading > most)):
            refused[columns[i]] = float(reading[i])
        return refused

    def status_by_lane(self, memory: np.ndarray, lanes: int) -> list[SolverStatus]:
        """Return the outcome of the optimisations in each lane of a memory."""
        shape = self.programme.shape(lanes)
        first = self.programme.offsets(lanes).plans + shape.stages * shape.row_length * lanes
        numbers_of_lanes = memory[first : first + len(SolverStatus._fields) * lanes].reshape(
            -1, lanes
        )
        return [SolverStatus(*column) for column in numbers_of_lanes.T.tolist()]

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

        It optimises at the first call in each period between optimisations. A time before that of
        the last call begins a new run.

        Raises:
            OutOfRange: If a coordinate or rate is not finite.
        """
        given = np.concatenate([*state, setpoint.position])
        # A sum of all is the quickest test of each, and names none.
        if not math.isfinite(sum(given.tolist())):
            check_finite(state)
        instant_number = self._instant_number(t)
        period = instant_number // self.programme.ratio
        if t < self._last_time:
            self._restart()
        due = period != self._last_period
        self._last_period = period
        self._last_time = t
        return self._instant(given, instant_number, due)

    def _instant_number(self, t: float) -> int:
        """Return the number of control instants before a time [s], which is the row of the path."""
        return max(0, math.floor(t / self.programme.period + ROW_TOLERANCE))

    def _restart(self) -> None:
        """Return to the state before a run, and forget the run before."""
        self._memory[:] = self.memory(1)
        self._last_period = None

    def resume_memory(self, t: float) -> np.ndarray:
        """Return its memory for a compiled loop that continues from a control instant [s], shape
        (1, doubles).
        """
        if t < self._last_time:
            self._restart()
        counts = self._counts(self._memory, 1)
        instant_number = self._instant_number(t)
        counts[0] = instant_number
        # The loop optimises at every `ratio`-th instant, and at the instant counts[1]: at once
        # where the run begins here; -1 is the number of no instant.
        counts[1] = instant_number if self._last_period is None else -1
        return self._memory[None]

    def advance_to(self, t: float) -> None:
        """Record that a compiled loop has advanced through a control instant [s]."""
        self._last_period = self._instant_number(t) // self.programme.ratio
        self._last_time = t


class EmittedProgramme(NamedTuple):
    """Code of a programme before it is compiled.

    Attributes:
        module: Its functions, see `emit_plan` and `emit_instant`.
        constants: Numbers that are the same in every stage, see `emit_plan`.
    """

    module: ir.Module
    constants: list[tuple[str, int, int, float]]


@lru_cache(maxsize=1)
def emit_programme(programme: Programme) -> EmittedProgramme:
    """Emit the code of a controller.

    The last one is remembered, since the table of a controller needs its constants, and what
    compiles it needs its functions soon after.
    """
    module = ir.Module()
    constants = emit_plan(module, programme)
    emit_instant(module, programme)
    return EmittedProgramme(module, constants)


@lru_cache(maxsize=64)
def _constants(programme: Programme) -> tuple[tuple[str, int, int, float], ...]:
    """Return the constants of a programme, see `EmittedProgramme`."""
    return tuple(emit_programme(programme).constants)


@lru_cache(maxsize=64)
def _compile(programme: Programme) -> Machine:
    """Compile the code of a controller; the cached code serves all with the same parameters."""
    machine = translate(emit_programme(programme).module)
    # The instructions as Python's objects take much more memory than the compiled code.
    emit_programme.cache_clear()
    return machine


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

    A crane with a rope that stretches or goes slack, or with a load on two falls, is planned for as
    if it hung on a rigid rope, see `cranedyn.model.rigid_rope`: the stretch bounces many times
    within a stage of the plan, and the yaw does not move the load. The controller then reads all
    coordinates but these, and the cable length as the drum has paid it out: the length of the load,
    with the stretch added, is not what the drum drives, and feeding it back makes the rope bounce
    ever more. `Receding.notes` names the joints that are left out.

    Args:
        crane: The crane; its structure is rigid.
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
        CraneError: If the structure of the crane is elastic.
    """
    check_choice("drive", drive, Drive)
    _check_rigid_structure(crane)
    number("control_period", control_period, "s", "> 0")
    crane.require_independent_joints("Predictive control")
    rigid = on_rigid_rope(crane)
    path = _path(crane, motion, control_period, rigid.kept)
    crane = rigid.crane
    layout = crane.layout

    topology = Topology.of(crane)
    crane_numbers = tuple(plant_numbers(crane).tolist())
    swing_period = _swing_period(crane, make_plant(topology, list(crane_numbers), "motion", False))
    tuning = Tuning().slower(swing_period / TUNED_SWING_PERIOD)
    if period is None:
        period = whole_periods(tuning.period, control_period)
    if stage is None:
        length = tuning.stage_to_goal if motion is None else tuning.stage_on_path
        stage = whole_periods(length, control_period)
    if settling is None:
        settling = max(tuning.settling, control_period)
    if smoothing is None:
        smoothing = tuning.smoothing

    ratio = multiple("period", period, "control_period", control_period)
    multiple("stage", stage, "control_period", control_period)
    within("stages", whole("stages", stages, 2, "stages"), 2, _MAX_STAGES)
    number("settling", settling, "s", "> 0")
    within("settling", settling, control_period, _MAX_TIME_CONSTANT, "s")
    number("smoothing", smoothing, "s", "> 0")
    within("smoothing", smoothing, 0.0, _MAX_TIME_CONSTANT, "s")
    swing_limit = number("swing limit", swing_limit, "rad", "> 0")
    within("swing limit", swing_limit, 0.0, _MAX_SWING_LIMIT, "rad")

    drive_limits = limits.for_crane(crane)
    rates = np.array(drive_limits.rates)
    accelerations = np.array(drive_limits.accelerations)
    leads: tuple[float, ...] = ()
    lags = converters_of_run(crane, drive, converters)
    if lags is not None:
        leads = tuple((lags.lags + lags.ahead(control_period)).tolist())
    programme = Programme(
        topology=topology,
        numbers=crane_numbers,
        kept=rigid.kept,
        left_out=rigid.left_out,
        drive=drive,
        stages=stages,
        stage_length=stage,
        period=control_period,
        ratio=ratio,
        rows=len(path),
        disturbance_gain=min(1.0, control_period / settling),
        swing_gain=min(1.0, control_period / smoothing),
        rate_gain=min(1.0, control_period / tuning.rate_correction),
        swing_limit=swing_limit,
        min_tension=MIN_TENSION_RATIO * _load_weight(crane),
        joint_errors=tuning.joint_errors(layout),
        payload_errors=tuning.payload_errors,
        leads=leads,
    )
    weight = _weights(crane, accelerations, input_weight)
    rows = _bounds(crane, rates, accelerations, swing_limit, programme.min_tension)
    rows |= _plausible(crane, rates, programme)
    return Receding(programme, _table(programme, weight, rows), path)


def _check_rigid_structure(crane: Crane) -> None:
    """Check that no joint but those of the rope has a spring, and the rope no mass.

    Raises:
        CraneError: If one has.
        ModelError: If the rope has mass.
    """
    crane.require_light_rope("Predictive control")
    bending = []
    for joint, stiffness in zip(crane.layout.joints, crane.springs.stiffness, strict=True):
        if stiffness != 0.0:
            bending.append(joint.name)
    if bending:
        held = ", ".join(map(repr, bending))
        raise CraneError(
            "This predictive controller is made for a crane whose structure is rigid; this one has "
            f"springs in {' and '.join(bending)}. Hold these joints by locked=[{held}], or "
            "--locked, or set their stiffness to 0."
        )


def _path(
    crane: Crane, motion: Motion | None, control_period: float, kept: Sequence[int]
) -> np.ndarray:
    """Return coordinates and rates of a motion by control instant, shape (rows, 2 n); no rows
    without one.

    Args:
        crane: The crane.
        motion: Its motion, or None.
        control_period: Control period [s].
        kept: Indices of the n coordinates that are planned, see `cranedyn.model.rigid_rope`.

    Raises:
        OutOfRange: If the motion is of another crane, or for another control period.
    """
    if motion is None:
        return np.zeros((0, 2 * len(kept)))
    motion.check_fits("motion", crane.layout)
    if not math.isclose(motion.period, control_period, rel_tol=SAME_PERIOD):
        allowed = f"the control period, {control_period:g}"
        raise OutOfRange("period of the motion", motion.period, allowed, "s")
    columns = list(kept)
    return np.hstack([motion.q[:, columns], motion.v[:, columns]])


def _load_weight(crane: Crane) -> float:
    """Return the force with which the hoist holds the load at the start [N]; 0 without a hoist."""
    hoist = crane.layout.drive_of("hoist")
    if hoist is None:
        return 0.0
    return float(abs(holding_effort(crane, crane.start.q)[hoist]))


def usual_input_weight(accelerations: np.ndarray) -> np.ndarray:
    """Return R for drives with limits of acceleration, shape (m, m), see `INPUT_ERROR_RATIO`."""
    return np.diag((INPUT_ERROR_RATIO * accelerations) ** -2.0)


def _weights(
    crane: Crane, accelerations: np.ndarray, input_weight: np.ndarray | None
) -> np.ndarray:
    """Return the weight of states and inputs together, shape (2 n + m, 2 n + m); code writes that
    of the states.
    """
    layout = crane.layout
    if input_weight is None:
        input_weight = usual_input_weight(accelerations)
    input_weight = weight_matrix("input weight", input_weight, layout.m, definite=True)
    return scipy.linalg.block_diag(np.eye(2 * layout.n), input_weight)


def _bounds(
    crane: Crane,
    rates: np.ndarray,
    accelerations: np.ndarray,
    swing_limit: float,
    min_tension: float,
) -> dict[str, np.ndarray]:
    """Return the lower and upper bounds of all bounded quantities, and the prices of exceeding
    them, each of shape (2 n + 2 m,).

    Args:
        crane: The crane.
        rates: Largest rates of the drives [rad/s or m/s], shape (m,).
        accelerations: Largest accelerations of the drives [rad/s² or m/s²], shape (m,).
        swing_limit: Largest swing from rest [rad].
        min_tension: Least tension of the rope [N].
    """
    layout = crane.layout
    n = layout.n
    m = layout.m
    drives = layout.drives
    swings = crane.swings
    low = np.full(2 * n + 2 * m, -_UNBOUNDED)
    high = np.full(2 * n + 2 * m, _UNBOUNDED)
    size = np.ones(len(low))
    low[drives] = crane.lower[drives]
    high[drives] = crane.upper[drives]
    low[swings] = -swing_limit
    high[swings] = swing_limit
    size[swings] = swing_limit

    limits = {"rate": rates, "acceleration": accelerations, "effort": crane.effort_limit}
    places = {
        "rate": n + drives,
        "acceleration": 2 * n + np.arange(m),
        "effort": 2 * n + m + np.arange(m),
    }
    for kind, limit in limits.items():
        place = places[kind]
        low[place] = -limit
        high[place] = limit
        size[place] = limit

    # A positive effort of the hoist pays out rope: its negative is the tension.
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        high[places["effort"][hoist]] = -min_tension
    return {"low": low, "high": high, "price": EXCESS_PRICE / size}


def _plausible(crane: Crane, rates: np.ndarray, programme: Programme) -> dict[str, np.ndarray]:
    """Return the least and largest plausible coordinates and rates, and the state before the first
    reading, each of shape (2 n,).

    Args:
        crane: The crane.
        rates: Largest rates of the drives [rad/s or m/s], shape (m,).
        programme: Parameters of the controller.
    """
    layout = crane.layout
    n = layout.n
    drives = layout.drives
    swings = crane.swings
    start = crane.start.q
    least = np.full(2 * n, -_UNBOUNDED)
    most = np.full(2 * n, _UNBOUNDED)

    # A drive may stand beyond its range, by as much as the range is wide.
    span = crane.upper - crane.lower
    least[drives] = (crane.lower - span)[drives]
    most[drives] = (crane.upper + span)[drives]

    # The rest of the swing joints changes with the drives, which stand anywhere in their ranges.
    lower = np.clip(crane.lower[drives], -_UNBOUNDED, _UNBOUNDED)
    upper = np.clip(crane.upper[drives], -_UNBOUNDED, _UNBOUNDED)
    rest_at_lower = crane.rest.slope * lower
    rest_at_upper = crane.rest.slope * upper
    least_rest = np.minimum(rest_at_lower, rest_at_upper).sum(axis=-1)
    most_rest = np.maximum(rest_at_lower, rest_at_upper).sum(axis=-1)
    least[swings] = crane.rest.angle + least_rest - _MAX_PLAUSIBLE_SWING
    most[swings] = crane.rest.angle + most_rest + _MAX_PLAUSIBLE_SWING

    # A load that falls from the height of its pivot has the rate √(2 g / l) below it: √2 times the
    # natural frequency of the swing, which is largest with the shortest cable.
    shortest_cable = start.copy()
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        shortest_cable[drives[hoist]] = crane.lower[drives[hoist]]
    frequency = _swing_frequencies(programme.plant, shortest_cable).max(initial=0.0)
    most[n + swings] = _PLAUSIBLE_SWING_RATIO * math.sqrt(2.0) * frequency
    most[n + drives] = _PLAUSIBLE_RATE_RATIO * rates
    least[n:] = -most[n:]
    return {
        "least_plausible": np.clip(least, -_UNBOUNDED, _UNBOUNDED),
        "most_plausible": np.clip(most, -_UNBOUNDED, _UNBOUNDED),
        "start": np.concatenate([start, np.zeros(n)]),
    }


def _swing_frequencies(plant: Plant, q: np.ndarray) -> np.ndarray:
    """Return the natural frequencies of free swing at standing drives [rad/s], shape (n - m,).

    They are the roots of the eigenvalues of -∂a/∂q of the passive joints; 0 for what does not swing
    back.

    Args:
        plant: Model of the crane, commanded by accelerations.
        q: Coordinates, shape (n,).
    """
    layout = plant.topology.layout
    at_rest = np.zeros(layout.n)
    derivatives = horizon_model.crane_derivatives(plant, q, at_rest, np.zeros(layout.m))
    by_passive = derivatives.acceleration_slopes[layout.passive][:, layout.passive]
    stiffness = -by_passive.astype(float)
    return np.sqrt(np.clip(np.linalg.eigvals(stiffness).real, 0.0, None))


def _swing_period(crane: Crane, plant: Plant) -> float:
    """Return the period of the slowest swing with the drives in the middle of their ranges [s], or
    `TUNED_SWING_PERIOD` if nothing swings.

    Args:
        crane: The crane.
        plant: Its model, commanded by accelerations.
    """
    q = crane.start.q.copy()
    middle = (crane.lower + crane.upper) / 2.0
    # A drive without ends, such as a slew, stays at its start.
    drives = crane.layout.drives[np.isfinite(middle[crane.layout.drives])]
    q[drives] = middle[drives]
    frequencies = _swing_frequencies(plant, crane.resting(q))
    swinging = frequencies[frequencies > _MIN_FREQUENCY_RATIO * frequencies.max(initial=0.0)]
    if not len(swinging):
        return TUNED_SWING_PERIOD
    return 2.0 * math.pi / float(swinging.min())


def _table(programme: Programme, weight: np.ndarray, rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return the memory of an optimisation before the first, shape (doubles,).

    Args:
        programme: Parameters of the controller.
        weight: Weight of states and inputs together, shape (2 n + m, 2 n + m).
        rows: Numbers at the beginnings of other rows, by name, such as bounds.
    """
    shape = programme.shape(1)
    table = np.zeros(shape.size)

    def row(name: str, i: int = 0) -> np.ndarray:
        """Return a view of a row."""
        first = shape.offset(name, i)
        return table[first : first + shape.row_length]

    for i, weights in enumerate(weight):
        row("weight", i)[: len(weight)] = weights
    # A row is longer than what is bounded: the numbers that fill it up are zero, without bounds.
    row("low")[:] = -_UNBOUNDED
    row("high")[:] = _UNBOUNDED
    row("price")[:] = EXCESS_PRICE
    for name, values in rows.items():
        row(name)[: len(values)] = values
    row("report")[REPORT.index("usual_barrier")] = _BARRIER_SHARE * EXCESS_PRICE
    stages = table[shape.first_stage :].reshape(shape.stages, shape.stage_size)
    for name, i, place, value in _constants(programme):
        stages[:, shape.offset(name, i) + place] = value
    return table
