"""The plain loop: reference, controller, drives, log, monitors, step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NoReturn, TypedDict, Unpack

import numpy as np

from cranedyn.checks import number
from cranedyn.clocks import clocks
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import CraneError, OutOfRange, RunError, format_error
from cranedyn.interfaces import (
    Controller,
    Disturbance,
    Drive,
    EngineName,
    Monitor,
    Reference,
    State,
    Validity,
)
from cranedyn.model.crane import Crane
from cranedyn.references.simple import checked, hold
from cranedyn.simulation.engine import Setting, load_engine
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import RunRecord
from cranedyn.simulation.stepper import as_command, as_force, check_bounded, initial_state


class Options(TypedDict, total=False):
    """Settings of a run that are rarely needed, as keyword arguments of `simulate`.

    Attributes:
        disturbance: External forces on the points of the crane, such as wind, see
            `cranedyn.disturbances.wind`; held for a control period, as commands are. None for none.
        ground: Ground and platforms that the load may touch, see `cranedyn.dynamics.contact`; None,
            the default, for none.
        validity: What to do where a joint leaves its range, the rope would have to push, the load
            swings to 90° or touches the ground, or a motion that is followed exactly needs more
            effort or rate than a drive has. "stop", the default, ends the run with an error that
            carries what was recorded. "buffers" catches drives that take efforts at the ends of
            their ranges. "mark" goes on; the column `valid` is 0 in these rows.
        integrator: The integrator, by default `semi_implicit_euler`.
        t_start: Time at the start [s], for a run that continues an earlier one; by default 0.
        monitors: Called after each row of the log, see `cranedyn.interfaces.Monitor`.
    """

    disturbance: Disturbance | None
    ground: Ground | None
    validity: Validity
    integrator: Integrator
    t_start: float
    monitors: Sequence[Monitor]


_DEFAULTS: Options = {
    "disturbance": None,
    "ground": None,
    "validity": "stop",
    "integrator": semi_implicit_euler,
    "t_start": 0.0,
    "monitors": (),
}


def simulate(
    crane: Crane,
    controller: Controller,
    reference: Reference | None = None,
    *,
    start: State | None = None,
    duration: float,
    dt: float = 5e-4,
    control_period: float = 5e-3,
    drive: Drive | Converters = "effort",
    engine: EngineName | str = "pinocchio",
    **options: Unpack[Options],
) -> Trajectory:
    """Run a crane under a controller.

    The controller is called once per control period and its command is held until the next one
    (zero-order hold). Efforts beyond the limits of the drives are cut to them; the log then shows a
    difference between command and effort.

    Args:
        crane: The crane.
        controller: From time, state and setpoint to commands of the drives.
        reference: From time to the setpoint of the drives. None holds the drives where they start.
        start: The state at the start; None hangs at rest where the URDF says.
        duration: Length of the run [s], a multiple of the control period.
        dt: Physics step [s].
        control_period: Time between calls of the controller [s], a multiple of `dt`; one row is
            logged each time.
        drive: "effort": commands are efforts, as of a force-controlled drive. "motion": commands
            are accelerations, which the drives follow exactly. "velocity", or `Converters`:
            commands are rates, which the drives follow as typical frequency converters, or these,
            make them, see `cranedyn.dynamics.converters`.
        engine: "pinocchio" steps by Pinocchio's algorithms. "compiled" steps by code compiled for
            this crane; it agrees with Pinocchio to round-off and is many times faster, most of all
            with a controller that is affine in the state, such as `Hold`, `Tracking`,
            `HoistIntegral` or `Follow`, and no disturbance but a `Wind`. Its angles end at a
            million rad. It needs the extra `compiled`.
        options: Settings that are rarely needed, see `Options`.

    Returns:
        The trajectory from the start on.

    Raises:
        OutOfRange: If an argument is out of its range or has no effect; if the log would take more
            than 4 GB; if the start is not one finite coordinate and rate for each joint; if the
            controller was made for a shorter control period. At the first instant also if the
            command is not one number for each drive or the setpoint is not finite.
        RunError: If the model ceases to hold; if state, command or setpoint stop being finite; if
            the run is interrupted; if the controller, the reference, the disturbance or a monitor
            raises an error, which is then its cause. It carries what was recorded.
    """
    settings = _checked(options, drive)
    t = t_start = settings["t_start"]
    validity, disturbance = settings["validity"], settings["disturbance"]
    clock = clocks(duration, dt, control_period)
    ground = settings["ground"]
    acting: Any = {"disturbance": disturbance, "buffers": validity == "buffers", "ground": ground}
    setting = Setting.of(crane, clock, drive, settings["integrator"], **acting)
    moving = load_engine(engine)(setting, initial_state(crane, start))
    layout = crane.layout
    monitors = settings["monitors"]
    reference = hold(crane, moving.state) if reference is None else reference
    setpoint_at = checked(reference, layout, t_start, control_period)
    log = Log(setting, validity, t_start, clock.periods + 1)
    record = RunRecord(setting, engine, validity, controller, reference, disturbance, ground)
    if hasattr(controller, "begin_run"):  # looking for a protocol takes ten times as long
        controller.begin_run(t_start, control_period)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for rows, holds in moving.run_ahead(controller, reference, log.t, log.rows):
                t = log.extend_to(rows, holds=holds)
                for monitor in monitors:
                    monitor(rows - 1, t, moving.state)
            state = moving.state
            for k in range(len(log), clock.periods + 1):
                t = t_start + k * control_period
                check_bounded(layout, t, state)
                setpoint = setpoint_at(t)
                force = None if disturbance is None else as_force(disturbance(t, state), layout)
                command = as_command(controller(t, state, setpoint), t, layout)
                state_after = moving.advance(command, force, last=k == clock.periods)
                log.append(moving.row(setpoint))
                for monitor in monitors:
                    monitor(k, t, state)
                state = state_after
            log.check()
    except (Exception, KeyboardInterrupt) as error:
        _end_early(error, t, log, lambda: record.trajectory(log, moving))
    return record.trajectory(log, moving)


def _checked(options: Options, drive: Drive | Converters) -> Options:
    """Return all options, checked."""
    if unknown := options.keys() - _DEFAULTS.keys():
        raise TypeError(f"simulate() got an unexpected keyword argument {min(unknown)!r}")
    settings = _DEFAULTS | options
    number("time at the start", settings["t_start"], "s", "-1e9 to 1e9")
    validity = settings["validity"]
    if validity not in ("stop", "mark") and (validity, drive) != ("buffers", "effort"):
        allowed = "stop or mark, or buffers where the drives take efforts"
        raise OutOfRange("validity", validity, allowed)
    return settings


def _end_early(
    error: BaseException, t: float, log: Log, trajectory: Callable[[], Trajectory]
) -> NoReturn:
    """Raise the error of a run that ends at a time [s] by another error."""
    if isinstance(error, KeyboardInterrupt):
        message = f"Interrupted at t = {t:.3f} s."
        raise RunError(message, t=t, trajectory=trajectory()) from None
    if isinstance(error, CraneError) and not len(log):
        raise error
    if isinstance(error, RunError) and error.trajectory is not None:  # of a run within the run
        raise error
    try:
        log.check()
    except RunError as event:  # the model ceased to hold before
        error = event
    if isinstance(error, RunError):
        error.trajectory = trajectory()
        raise error
    message = f"At t = {t:.4g} s: {format_error(error)}"  # type: ignore[arg-type]
    raise RunError(message, t=t, trajectory=trajectory()) from error
