"""Simulate a crane under a controller: check the arguments, run an engine, return a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from cranedyn.command import defer_next_sigint
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.base_motion import BaseMotion
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
from cranedyn.references.simple import hold
from cranedyn.simulation.engine import default_engine, load_engine
from cranedyn.simulation.log import EarlyEnd
from cranedyn.simulation.run_record import run_parameters, run_record, with_notes
from cranedyn.simulation.run_spec import make_run_spec

if TYPE_CHECKING:
    # Contacts take long to import, and few runs have them.
    from cranedyn.dynamics.contact import Ground


def simulate(
    crane: Crane,
    controller: Controller,
    reference: Reference | None = None,
    *,
    # when
    duration: float,
    start: State | None = None,
    t_start: float = 0.0,
    # how it is computed
    dt: float = 5e-4,
    control_period: float = 5e-3,
    integrator: Integrator = semi_implicit_euler,
    engine: EngineName | str | None = None,
    # what acts on the crane
    drive: Drive | Converters = "effort",
    disturbance: Disturbance | None = None,
    ground: Ground | None = None,
    base: BaseMotion | None = None,
    # what is watched
    validity: Validity = "stop",
    monitors: Sequence[Monitor] = (),
) -> Trajectory:
    """Run a crane under a controller.

    The controller is called once per control period, and its command is held until the next one
    (zero-order hold). Efforts beyond the limits of the drives are cut to them; the trajectory then
    shows a difference between command and effort.

    Args:
        crane: The crane.
        controller: From time, state and setpoint to commands of the drives.
        reference: From time to the setpoint of the drives. If None, the drives are held where they
            start.
        duration: Length of the run [s], a multiple of the control period.
        start: State at the start. If None, the crane hangs at rest where the URDF says.
        t_start: Time at the start [s], for a run that continues an earlier one.
        dt: Physics step [s].
        control_period: Time between calls of the controller [s], a multiple of `dt`. The
            trajectory has one row for each call.
        integrator: Rule that steps coordinates and rates.
        engine: What computes the run:

            * "pinocchio" steps by Pinocchio's algorithms in a loop in Python.
            * "compiled" steps by code compiled for this crane, with the same numbers up to
              round-off. It is many times faster, most of all where no Python is in the loop: under
              predictive control in code, or a controller that is affine in the state, such as
              `Hold`, `Tracking`, `HoistIntegral` or `Follow`, and with no disturbance but a `Wind`.
              An angle beyond 1e6 rad ends the run.
            * The name of a plugin selects the engine that another package provides.
            * None selects "pinocchio", or "compiled" if there is ground or a rope that may go
              slack, which only that one computes. The record of the run says which it was.
        drive: How the drives take a command:

            * "effort": as efforts [N m or N], as force-controlled drives do.
            * "motion": as accelerations [rad/s² or m/s²], which they follow exactly.
            * "velocity": as rates [rad/s or m/s], which they follow as typical frequency converters
              make them; `Converters` state others.
        disturbance: External forces on the points of the crane, such as wind, held for a control
            period as commands are. None for none.
        ground: Ground and platforms that the load may touch. None for none.
        base: Motion of the base on which the crane stands, such as a ship. The state, the setpoints
            and the drives are those relative to the base, and so is the ground, which is its deck.
            Forces of a disturbance are those in the world, and a `Wind` blows against the motion of
            the base as well. None for a crane that stands in the world.
        validity: What to do where the model ceases to hold: where a joint leaves its range, the
            rope would have to push, the load swings to 90° or touches a ground that is not given,
            or a motion that is followed exactly needs more effort or rate than a drive has.

            * "stop" ends the run with an error that carries the trajectory until there. Rows are
              judged in blocks, so the controller may have been called for up to 1,000 rows more.
            * "buffers" is like "stop", but buffers catch the drives at the ends of their ranges;
              for drives that take efforts.
            * "mark" goes on; the column `valid` is 0 in these rows.

            A drive that cannot follow its command, since it saturates, makes a row invalid and
            ends no run.
        monitors: Called after each row of the log with its index, its time [s] and the state.

    Returns:
        The trajectory from the start on, one row for each control instant.

    Raises:
        OutOfRange: If an argument is out of its range or has no effect; if the log would take more
            than 4 GB; if the controller was made for a shorter control period.
        UnknownName: If there is no such engine.
        CraneError: If the engine cannot compute such a run; the message names the one that can.
        RunError: If the run ends early: the model ceases to hold, a number is not finite, the user
            interrupts it, or the controller, the reference, the disturbance or a monitor raises an
            error, which is then its cause. Its attribute `trajectory` is what was recorded; if a
            run within this run ended early, it is what that one recorded. An error of cranedyn
            before the first row is raised as it is.
    """
    spec = make_run_spec(
        crane,
        start=start,
        t_start=t_start,
        duration=duration,
        dt=dt,
        control_period=control_period,
        drive=drive,
        integrator=integrator,
        validity=validity,
        disturbance=disturbance,
        ground=ground,
        base=base,
    )
    if isinstance(controller, type):
        raise OutOfRange(
            "controller",
            f"the class {controller.__name__}",
            f"a function, or an instance such as {controller.__name__}(...)",
        )
    engine_name = default_engine(spec) if engine is None else engine
    loaded_engine = load_engine(engine_name)
    parameters = run_parameters(spec, engine_name)
    record = run_record(spec, controller, reference)
    if reference is None:
        reference = hold(crane, spec.start)
    # A controller with a clock of its own learns start and period. A test with isinstance and the
    # protocol `cranedyn.clocks.Clocked` would take ten times as long.
    if hasattr(controller, "begin_run"):
        controller.begin_run(spec.t_start, spec.clocks.period)

    log = loaded_engine.run(spec, controller, reference, monitors)

    early_end = log.early_end
    if early_end is not None and len(log) == 0 and isinstance(early_end.error, CraneError):
        # Nothing was recorded, and most often an argument is wrong, such as a controller that
        # commands too few drives. Its own message says that better than "at t = 0".
        raise early_end.error

    with defer_next_sigint(early_end.error if early_end else None):
        trajectory = log.trajectory(parameters, with_notes(record, controller))
        if early_end is not None:
            _raise_early_end(early_end, trajectory)
    return trajectory


def _raise_early_end(early_end: EarlyEnd, trajectory: Trajectory) -> NoReturn:
    """Raise the error that ended a run, with the trajectory until then.

    Raises:
        RunError: Always.
    """
    t = early_end.t
    error = early_end.error
    if isinstance(error, KeyboardInterrupt):
        interruption = RunError(f"Interrupted at t = {t:.3f} s.", t=t, trajectory=trajectory)
        # By the context, `cranedyn.command.interrupted` knows what ended the run.
        interruption.__context__ = error
        raise interruption from None
    if isinstance(error, RunError):
        # One that has a trajectory already comes from a run within this run, such as that of a
        # predictive controller. Its trajectory shows what went wrong.
        if error.trajectory is None:
            error.trajectory = trajectory
        raise error
    assert isinstance(error, Exception)
    message = f"At t = {t:.4g} s: {format_error(error)}"
    raise RunError(message, t=t, trajectory=trajectory) from error
