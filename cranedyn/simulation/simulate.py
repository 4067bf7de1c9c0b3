"""The plain loop: reference, controller, drives, step, log."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cranedyn.arguments import checked, described
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.validity import first_event
from cranedyn.errors import CraneError, OutOfRange, RunError, number, written_out
from cranedyn.interfaces import Controller, Disturbance, Drive, EngineName, Reference, State, Validity
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.references import hold
from cranedyn.references.tabulated import checked_setpoint
from cranedyn.simulation.clocks import Timed, clocks
from cranedyn.simulation.engine import DIVERGED, Engine, Setting
from cranedyn.simulation.log import Log

_NUMBERS = np.dtype(float)


@checked
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
    disturbance: Disturbance | None = None,
    validity: Validity = "stop",
    integrator: Integrator = semi_implicit_euler,
    engine: EngineName = "pinocchio",
    progress: Callable[[float], object] | None = None,
) -> Trajectory:
    """Run a crane under a controller.

    The controller is called once per control period and its answer is held until the next (zero-order hold), as is the disturbance.
    Efforts beyond the limits of the drives are cut to them, which the log shows as a difference between command and effort.

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
        disturbance: Forces from outside on the points of the crane, such as wind; see `cranedyn.disturbances.wind`.
        validity: What to do where a joint leaves its range, the rope would have to push, the load swings to 90° or touches the ground.
            "stop" ends the run with an error that carries what was recorded. "buffers" catches the drives at the ends of
            their ranges, for drives that take efforts. "mark" goes on; the rows concerned are marked in the column `valid`.
        integrator: The stepping rule.
        engine: "pinocchio" steps by Pinocchio's algorithms. "compiled" steps by code made for this crane, which agrees with them to
            round-off and is many times faster, most of all where nothing in the loop is Python: for a controller that is affine in the
            state, such as `Hold`, `Tracking`, `HoistIntegral` or `Follow`, and no disturbance.
            Its angles end at a million rad. It needs the extra `compiled`.
        progress: Called with the time [s] at every control instant, or once in a while where a compiled loop runs ahead.

    Returns:
        What happened, from `since` on.

    Raises:
        OutOfRange: If an argument is of another kind; if a time is not positive, one does not divide the other, or the log would not fit
            into 4 GB; if the start is not one finite coordinate and rate for each joint; if the controller was made for a shorter control period. At
            the first instant also if the command is not one number for each drive or the setpoint not finite.
        RunError: If the model ceases to hold, state, command or setpoint stop being finite, or the run is interrupted; it carries what was
            recorded so far. So it does if the controller, the reference or the disturbance raises an error, which is then its cause.
    """
    clock = clocks(duration, dt, control_period)
    if drive not in ("effort", "motion"):
        raise OutOfRange("drive", drive, "effort or motion")
    if validity not in ("stop", "mark") and (validity, drive) != ("buffers", "effort"):
        raise OutOfRange("validity", validity, "stop or mark, or buffers where the drives take efforts")
    buffers = validity == "buffers"
    layout, state = crane.layout, State.checked("start", crane.start) if start is None else start
    number("time at the start", since, "s", "-1e9 to 1e9")
    log = Log(crane, since, control_period, clock.periods + 1, integrator.lead * dt)
    moving = _engine(engine)(Setting(crane, clock, drive, disturbance is not None, buffers, integrator), state)
    reference = hold(crane, state) if reference is None else reference
    if isinstance(controller, Timed):
        controller.run_begins(since, control_period)

    def recorded() -> Trajectory:
        made: dict[str, float | str] = {"dt_s": dt, "control_period_s": control_period, "gravity_m_s2": crane.gravity}
        made |= {"drive": drive, "engine": engine, "integrator": integrator.name, "validity": validity}
        return log.trajectory(made, moving.energies, buffers=buffers)

    def look_back() -> None:
        if validity == "mark":
            return
        event = first_event(crane, *log.fresh(), buffers=buffers)
        if event is not None:
            at = log.keep(event.row)
            hint = "" if buffers else "; validity = mark goes on all the same"
            raise RunError(f"At t = {at:.4g} s {event.words}{hint}.", t=at, joint=event.joint, value=event.value, trajectory=recorded())
        log.looked_at()

    t, drives, points = since, (layout.m,), (len(crane.points), 3)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            ahead = 0
            for ahead in moving.run_ahead(controller, reference, since, log):
                t = since + (ahead - 1) * control_period
                look_back()
                if progress is not None:
                    progress(t)
            state = moving.state
            for k in range(ahead, clock.periods + 1):
                t = since + k * control_period
                if not math.hypot(*state.v.tolist()) < DIVERGED:
                    raise _diverged(layout, t, state)
                setpoint = checked_setpoint(reference(t), drives)
                before = moving.effort()
                if disturbance is not None:
                    log.force(moving.take_force(_forces(disturbance(t, state), points, layout)))
                if buffers:
                    log.buffers(*moving.buffers())
                command, effort = moving.take(_command(controller(t, state, setpoint), t, layout))
                log.row(state, setpoint.position, command, effort, before)
                if k % moving.look_back == 0:
                    look_back()
                if progress is not None:
                    progress(t)
                if k < clock.periods:
                    state = moving.advance()
            look_back()
    except KeyboardInterrupt:
        raise RunError(f"Interrupted at t = {t:.3f} s.", t=t, trajectory=recorded()) from None
    except Exception as error:
        if isinstance(error, CraneError) and (not len(log) or (isinstance(error, RunError) and error.trajectory is not None)):
            raise
        look_back()
        joint, value = (error.joint, error.value) if isinstance(error, RunError) else ("", float("nan"))
        sentence = str(error) if isinstance(error, RunError) else f"At t = {t:.4g} s: {_told(error)}"
        raise RunError(sentence, t=t, joint=joint, value=value, trajectory=recorded()) from error
    return recorded()


def _engine(name: str) -> type[Engine]:
    if name == "pinocchio":
        return Engine
    if name != "compiled":
        raise OutOfRange("engine", name, "pinocchio or compiled")
    from cranedyn.compiled.engine import CompiledEngine

    return CompiledEngine


def _told(error: Exception) -> str:
    """An error as a sentence; one that is not ours, which a controller may raise, with the place where it was raised."""
    if isinstance(error, CraneError):
        return str(error)
    *_, place = traceback.extract_tb(error.__traceback__)
    return f"{type(error).__name__} in {place.name}, line {place.lineno} of {Path(place.filename).name}: {written_out(error)}."


def _command(answer: object, t: float, layout: Layout) -> np.ndarray:
    """One finite number for each drive."""
    command = _array(answer, "command of the controller", (layout.m,), layout.drives_in_words)
    if not math.isfinite(sum(command.tolist())) and not np.isfinite(command).all():
        joint = layout.driven[int(np.argmin(np.isfinite(command)))].name
        raise RunError(f"The controller commanded {command.tolist()} at t = {t:.4f} s; {joint} needs a finite number.", t=t, joint=joint)
    return command


def _forces(answer: object, shape: tuple[int, int], layout: Layout) -> np.ndarray:
    """A finite vector for each point of the crane."""
    forces = _array(answer, "force of the disturbance", shape, f"a vector for each of {', '.join(layout.points)}")
    if not np.isfinite(forces).all():
        raise OutOfRange("force of the disturbance", forces.tolist(), "finite numbers", "N")
    return forces


def _array(answer: object, name: str, shape: tuple[int, ...], allowed: str) -> np.ndarray:
    if type(answer) is np.ndarray and answer.dtype is _NUMBERS and answer.shape == shape:
        return answer.copy()
    try:
        array = None if isinstance(answer, np.ndarray) and np.iscomplexobj(answer) else np.array(answer, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = None
    if array is None or array.shape != shape:
        raise OutOfRange(name, described(answer if array is None else array), allowed)
    return array


def _diverged(layout: Layout, t: float, state: State) -> RunError:
    i = int(np.argmax(np.nan_to_num(np.abs(state.v), nan=np.inf)))
    name, value = layout.joints[i].name, float(state.v[i])
    return RunError(
        f"The run diverged at t = {t:.4f} s: {name} moves at {value:g} per second; a smaller dt or softer gains may help.",
        t=t,
        joint=name,
        value=value,
    )
