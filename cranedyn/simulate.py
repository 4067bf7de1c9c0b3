"""The plain loop: reference, controller, drives, step, log."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import pinocchio as pin

from cranedyn.crane import DRIVES, JOINTS, Crane, State
from cranedyn.dynamics import follow_drives, inverse_dynamics
from cranedyn.errors import CraneError, OutOfRange, RunError, number
from cranedyn.integrator import Acceleration, Integrator, in_steps, semi_implicit_euler
from cranedyn.references import Reference, Wanted, hold
from cranedyn.trajectory import Trajectory

Controller = Callable[[float, State, Wanted], np.ndarray]
"""From time [s], state and what is wanted to three numbers for slew, trolley and hoist: efforts [N m, N, N], or accelerations
[rad/s², m/s², m/s²] where the drives follow prescribed motion. The passive joints cannot be addressed."""

Drive = Literal["effort", "motion"]
"""How the drives take a command."""

_DIVERGED = 1e6
"""No joint of a crane moves this fast [rad/s or m/s]."""


def simulate(
    crane: Crane,
    controller: Controller,
    reference: Reference | None = None,
    *,
    start: State | None = None,
    since: float = 0.0,
    duration: float,
    dt: float = 5e-4,
    control_period: float = 5e-3,
    drive: Drive = "effort",
    integrator: Integrator = semi_implicit_euler,
    progress: Callable[[float], object] | None = None,
) -> Trajectory:
    """Run a crane under a controller.

    The controller is called once per control period and its answer is held until the next (zero-order hold). Efforts beyond the
    limits of the drives are cut to them, which the log shows as a difference between command and effort.

    Args:
        crane: The crane.
        controller: What commands the drives.
        reference: Where the drives should be at each time. None holds the drives where they are first observed.
        start: Where it starts; by default hanging at rest where its URDF says.
        since: Time at the start [s], when a run goes on from an earlier one.
        duration: How long to run [s], a multiple of the control period.
        dt: Physics step [s].
        control_period: Time between calls of the controller [s], a multiple of `dt`; one row is logged each time.
        drive: "effort": the controller commands efforts, as a force-controlled drive. "motion": it commands accelerations, which the
            drives follow exactly at the efforts this costs, as a stiff velocity-controlled drive.
        integrator: The stepping rule.
        progress: Called at every control instant with the time [s].

    Returns:
        What happened, from `since` on.

    Raises:
        OutOfRange: If a time is not positive, or one does not divide the other.
        RunError: If the state or the command stops being finite, or the run is interrupted; it carries what was recorded so far.
    """
    steps, periods = _steps(duration, dt, control_period)
    if drive not in ("effort", "motion"):
        raise OutOfRange("drive", drive, "effort or motion")
    drives = (_EffortDrives if drive == "effort" else _MotionDrives)(crane, dt)
    state = crane.start if start is None else start
    reference = hold(state) if reference is None else reference
    q, u, per_second = state.q, dt * state.v, np.full(5, 1.0 / dt)
    log: list[tuple[np.ndarray, ...]] = []

    def recorded() -> Trajectory:
        parameters: dict[str, float | str] = {"dt_s": dt, "control_period_s": control_period, "drive": drive, "integrator": integrator.name}
        return _trajectory(crane, log, since, control_period, integrator.lead * dt, parameters)

    t = since
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(periods + 1):
                t = since + k * control_period
                _check_finite(t, state, recorded)
                wanted = reference(t)
                before = drives.effort(state)
                command = np.array(controller(t, state, wanted), dtype=float)
                if command.shape != (3,) or not math.isfinite(sum(command.tolist())):
                    raise _bad_command(t, command, recorded)
                command, effort = drives.take(command, state)
                log.append((*state, wanted.position, command, effort, before))
                if progress is not None:
                    progress(t)
                if k < periods:
                    q, u = integrator.advance(drives.acceleration, drives.model, q, u, steps)
                    state = State(q, u * per_second)
    except KeyboardInterrupt:
        raise RunError(f"Interrupted at t = {t:.3f} s.", t=t, trajectory=recorded()) from None
    return recorded()


class _EffortDrives:
    """Drives that push with the effort commanded, within their limits. Inside, time is counted in steps."""

    def __init__(self, crane: Crane, dt: float) -> None:
        self.model = in_steps(crane.model, dt)
        self._limit = crane.effort_limit
        self._limits = tuple(crane.effort_limit.tolist())
        self._dt2 = np.full(3, dt * dt)
        self._effort = np.zeros(3)
        self._tau = np.zeros(5)
        self.acceleration = self._damped_aba(dt * crane.damping)

    def _damped_aba(self, damping: np.ndarray) -> Acceleration:
        aba, world = pin.aba, pin.Convention.WORLD
        model, data, tau = self.model, self.model.createData(), self._tau
        return lambda q, u: aba(model, data, q, u, tau - damping * u, world)

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        slew, trolley, hoist = command.tolist()
        a, b, c = self._limits
        inside = -a <= slew <= a and -b <= trolley <= b and -c <= hoist <= c
        self._effort = command if inside else command.clip(-self._limit, self._limit)
        self._tau[DRIVES] = self._dt2 * self._effort
        return command, self._effort

    def effort(self, state: State) -> np.ndarray:
        return self._effort


class _MotionDrives:
    """Drives that accelerate as commanded, whatever effort it costs. Inside, time is counted in steps."""

    def __init__(self, crane: Crane, dt: float) -> None:
        self.model = in_steps(crane.model, dt)
        self._data = self.model.createData()
        self._damping = dt * crane.damping
        self._dt = dt
        self._command = np.zeros(5)

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        self._command[DRIVES] = self._dt**2 * command
        effort = self.effort(state)
        return effort, effort

    def effort(self, state: State) -> np.ndarray:
        u = self._dt * state.v
        return inverse_dynamics(self.model, self._data, state.q, u, self.acceleration(state.q, u), self._damping) / self._dt**2

    def acceleration(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        return follow_drives(self.model, self._data, q, u, self._command, self._damping)


def _steps(duration: float, dt: float, control_period: float) -> tuple[int, int]:
    """Physics steps per control period and control periods in the run."""
    number("dt", dt, "s", "> 0")
    number("control_period", control_period, "s", "> 0")
    number("duration", duration, "s", "> 0")
    steps, periods = round(control_period / dt), round(duration / control_period)
    if steps < 1 or abs(steps * dt - control_period) > 1e-9 * control_period:
        raise OutOfRange("control_period", control_period, f"a multiple of dt = {dt:g} s", "s")
    if periods < 1 or abs(periods * control_period - duration) > 1e-9 * duration:
        raise OutOfRange("duration", duration, f"a multiple of control_period = {control_period:g} s", "s")
    return steps, periods


def _bad_command(t: float, command: np.ndarray, recorded: Callable[[], Trajectory]) -> CraneError:
    if command.shape != (3,):
        return OutOfRange("command of the controller", f"an array of shape {command.shape}", "three numbers: slew, trolley, hoist")
    joint = JOINTS[DRIVES[int(np.argmin(np.isfinite(command)))]].name
    return RunError(
        f"The controller commanded {command.tolist()} at t = {t:.4f} s; {joint} needs a finite number.",
        t=t,
        joint=joint,
        trajectory=recorded(),
    )


def _check_finite(t: float, state: State, recorded: Callable[[], Trajectory]) -> None:
    if abs(sum(state.v.tolist())) < _DIVERGED:
        return
    i = int(np.argmax(np.nan_to_num(np.abs(state.v), nan=np.inf)))
    value = float(state.v[i])
    if not abs(value) < _DIVERGED:
        raise RunError(
            f"The run diverged at t = {t:.4f} s: {JOINTS[i].name} moves at {value:g} per second; a smaller dt or softer gains may help.",
            t=t,
            joint=JOINTS[i].name,
            value=value,
            trajectory=recorded(),
        )


def _trajectory(
    crane: Crane, log: list[tuple[np.ndarray, ...]], since: float, period: float, lead: float, parameters: dict[str, float | str]
) -> Trajectory:
    """The log as arrays, with its energy ledger.

    Work is effort times the displacement that belongs to the velocities, so a lead of the positions [s] is taken off. Where motion is
    prescribed the mean of the efforts at both ends of a period stands for them. Dissipation is integrated by the trapezoidal rule.
    """
    q, v, wanted, command, effort, before = (
        (np.array(column) for column in zip(*log, strict=True)) if log else [np.empty((0, w)) for w in (5, 5, 3, 3, 3, 3)]
    )
    work = np.zeros_like(effort)
    displacement = np.diff((q - lead * v)[:, DRIVES], axis=0)
    np.cumsum((effort[:-1] + before[1:]) / 2 * displacement, axis=0, out=work[1:])
    power = v**2 @ crane.damping
    dissipated = np.zeros(len(q))
    np.cumsum((power[:-1] + power[1:]) / 2 * period, out=dissipated[1:])
    energies = np.array([pin.computeMechanicalEnergy(crane.model, crane.data, *row[:2]) for row in log])
    return Trajectory(since + period * np.arange(len(q)), q, v, wanted, command, effort, energies, work, dissipated, parameters)
