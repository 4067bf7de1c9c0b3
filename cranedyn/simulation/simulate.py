"""The plain loop: reference, controller, drives, step, log."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cranedyn.checks import number
from cranedyn.clocks import Timed, clocks
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import CraneError, OutOfRange, RunError, format_error
from cranedyn.interfaces import (
    Controller,
    Disturbance,
    Drive,
    EngineName,
    Reference,
    State,
    Validity,
)
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import Setpoints
from cranedyn.simulation.engine import DIVERGED
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import notes_of, record_of
from cranedyn.simulation.stepper import Stepper, command_of, diverged, force_of


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
    converters: Converters | None = None,
) -> Trajectory:
    """Run a crane under a controller.

    The controller is called once per control period and its answer is held until the next
    (zero-order hold), as is the disturbance. Efforts beyond the limits of the drives are cut to
    them, which the log shows as a difference between command and effort.

    Args:
        crane: The crane.
        controller: What commands the drives.
        reference: Where the drives should be at each time. None holds the drives where they are
            first observed.
        start: Where it starts; by default hanging at rest where its URDF says.
        since: Time at the start [s], when a run goes on from an earlier one.
        duration: How long to run [s], a multiple of the control period.
        dt: Physics step [s].
        control_period: Time between calls of the controller [s], a multiple of `dt`; one row is
            logged each time.
        drive: "effort": the controller commands efforts, as a force-controlled drive. "motion": it
            commands accelerations, which the drives follow exactly at the efforts this costs, as a
            stiff velocity-controlled drive. "velocity": it commands rates, which the drives follow
            as frequency converters make them, see `cranedyn.dynamics.converters`. Rows in which
            these drives are told more than their rates or would need more than their efforts are
            cut to that and marked in the column `valid`.
        disturbance: Forces from outside on the points of the crane, such as wind; see
            `cranedyn.disturbances.wind`.
        validity: What to do where a joint leaves its range, the rope would have to push, the load
            swings to 90° or touches the ground, or a motion that is followed exactly needs more
            effort or rate than a drive has. "stop" ends the run with an error that carries what
            was recorded. "buffers" catches the drives at the ends of their ranges, for drives that
            take efforts. "mark" goes on; the rows concerned are marked in the column `valid`.
        integrator: The stepping rule.
        engine: "pinocchio" steps by Pinocchio's algorithms. "compiled" steps by code made for this
            crane, which agrees with them to round-off and is many times faster, most of all where
            nothing in the loop is Python: for a controller that is affine in the state, such as
            `Hold`, `Tracking`, `HoistIntegral` or `Follow`, and no disturbance. Its angles end at a
            million rad. It needs the extra `compiled`.
        progress: Called with the time [s] at every control instant, or once in a while where a
            compiled loop runs ahead.
        converters: Frequency converters of drives that take velocities; None for typical ones.

    Returns:
        What happened, from `since` on.

    Raises:
        OutOfRange: If an argument is of another kind, or has no effect; if a time is not positive,
            one does not divide the other, or the log would not fit into 4 GB; if the start is not
            one finite coordinate and rate for each joint; if the controller was made for a shorter
            control period. At the first instant also if the command is not one number for each
            drive or the setpoint not finite.
        RunError: If the model ceases to hold, state, command or setpoint stop being finite, or the
            run is interrupted; it carries what was recorded so far. So it does if the controller,
            the reference or the disturbance raises an error, which is then its cause.
    """
    clock = clocks(duration, dt, control_period)
    if validity not in ("stop", "mark") and (validity, drive) != ("buffers", "effort"):
        raise OutOfRange(
            "validity", validity, "stop or mark, or buffers where the drives take efforts"
        )
    buffers = validity == "buffers"
    if isinstance(reference, Motion):
        reference.check_fits("reference", crane.layout)
    number("time at the start", since, "s", "-1e9 to 1e9")
    log = Log(crane, since, control_period, clock.periods + 1, integrator.lead * dt)
    stepper = Stepper(
        crane,
        start=start,
        dt=dt,
        control_period=control_period,
        drive=drive,
        forces=disturbance is not None,
        buffers=buffers,
        integrator=integrator,
        engine=engine,
        converters=converters,
    )
    layout, moving, state = crane.layout, stepper.engine, stepper.state
    reference = hold(crane, state) if reference is None else reference
    record = record_of(
        crane,
        controller=controller,
        reference=reference,
        disturbance=disturbance,
        converters=stepper.converters,
    )
    if isinstance(controller, Timed):
        controller.run_begins(since, control_period)

    def recorded() -> Trajectory:
        made: dict[str, float | str] = {
            "dt_s": dt,
            "control_period_s": control_period,
            "gravity_m_s2": crane.gravity,
        }
        made |= {
            "drive": drive,
            "engine": engine,
            "integrator": integrator.name,
            "validity": validity,
        }
        noted = notes_of(controller)
        whole = record | ({"notes": noted} if noted else {})
        return log.trajectory(made, whole, moving.energies, buffers=buffers, drive=drive)

    def look_back() -> None:
        if validity == "mark":
            return
        event = log.event(drive, buffers=buffers)
        if event is not None:
            at = log.keep(event.row)
            hint = "" if buffers else "; validity = mark goes on all the same"
            raise RunError(
                f"At t = {at:.4g} s {event.words}{hint}.",
                t=at,
                joint=event.joint,
                value=event.value,
                trajectory=recorded(),
            )

    t, setpoints = since, Setpoints(reference, layout.m)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            ahead = 0
            for ahead in moving.run_ahead(controller, reference, since, clock.periods, log):
                t = since + (ahead - 1) * control_period
                look_back()
                if progress is not None:
                    progress(t)
            state = moving.state
            for k in range(ahead, clock.periods + 1):
                t = since + k * control_period
                if not math.hypot(*state.v.tolist()) < DIVERGED:
                    raise diverged(layout, t, state)
                setpoint = setpoints(t)
                before = moving.effort()
                if disturbance is not None:
                    log.force(moving.take_force(force_of(disturbance(t, state), layout)))
                if buffers:
                    log.buffers(*moving.buffers())
                command, effort = moving.take(command_of(controller(t, state, setpoint), t, layout))
                aims = setpoint.position
                if setpoint is not setpoints.steady:
                    aims = np.ascontiguousarray(aims, dtype=float)
                if stepper.converters is not None:
                    log.cut(moving.cut)
                log.row(state, aims, command, effort, before)
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
        if isinstance(error, CraneError) and (
            not len(log) or (isinstance(error, RunError) and error.trajectory is not None)
        ):
            raise
        look_back()
        joint, value = (
            (error.joint, error.value) if isinstance(error, RunError) else ("", float("nan"))
        )
        sentence = (
            str(error)
            if isinstance(error, RunError)
            else f"At t = {t:.4g} s: {format_error(error)}"
        )
        raise RunError(sentence, t=t, joint=joint, value=value, trajectory=recorded()) from error
    return recorded()
