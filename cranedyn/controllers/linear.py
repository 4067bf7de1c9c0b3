"""Linear dynamic controllers: a notch filter, an observer with a gain, an integrator, an H∞ law.

Such a controller is a discrete state-space system from deviations of the crane to commands. Its
matrices may come from python-control (`cranedyn.interop.python_control.from_control`), from MATLAB
or from a textbook. `linear_controller` makes a `LinearController` of them, which runs in every
engine and in batches, has margins, and can be exported.

With the deviations y of the named inputs, the deviations u of the named commands, and the states x,

    u[k] = c x[k] + d y[k],
    x[k + 1] = a x[k] + b y[k] + anti_windup (applied[k] - u[k]),

where `applied` is what the limits of the drives leave of the command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy

from cranedyn.checks import ShortRepr, check_choice, finite, number
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.affine import Affine, ControllerStates, at_rest_shifted, next_states
from cranedyn.controllers.hold import FREQUENCY, hold_controller
from cranedyn.controllers.lqr import linearised
from cranedyn.controllers.tracking import Tracking
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.converters import MAX_DELAY_STEPS, Converters, converters_of_run
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import feedback_gain, held_states
from cranedyn.errors import CraneError, OutOfRange, UnknownName
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import interpolate, locate

SetpointSource = Literal["rest", "run"]
"""Whose positions of the drives a controller acts about: those of its rest or motion, or those of
the reference of the run."""

_Observer = Literal["observer"]

AntiWindup = np.ndarray | _Observer | None
"""Anti-windup of a controller: a matrix, an observer of its states by its own command, or none."""


@dataclass(eq=False, repr=False)
class LinearController(ShortRepr):
    """A controller with states x: command = tracking + c x, see `ControllerStates`.

    It begins each run at the initial states. Asked again for the same time, it answers the same and
    does not advance.

    Attributes:
        crane: The crane.
        tracking: The command without the states, and the rest or motion from which deviations are
            measured.
        states: Its states, with their initial values; none for a gain.
        period: Its control period [s]; None for a gain, and for one that remembers nothing but its
            last commands.
        setpoint: Whether the drives are held at the setpoint of the tracking or at that of the run.
        delay: Number of commands on their way to the converters that it feeds back, in control
            periods.
        converters: Converters whose delay that must be; None where `delay` is 0.
    """

    crane: Crane
    tracking: Tracking
    states: ControllerStates
    period: float | None
    setpoint: SetpointSource = "rest"
    delay: int = 0
    converters: Converters | None = None
    _t: float = field(init=False, default=np.nan)
    _x: np.ndarray = field(init=False)
    _next_x: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Begin at the initial states, also where no run is begun."""
        self._restart()

    def _restart(self) -> None:
        """Return to the initial states."""
        self._t = np.nan  # which differs from the time of any control instant
        self._x = self.states.initial
        self._next_x = self.states.initial

    def begin_run(self, t: float, control_period: float) -> None:
        """Return to the initial states, see `cranedyn.clocks.Clocked`.

        Raises:
            OutOfRange: If the control period of the run [s] is another one, or the delay of the
                converters is another number of its control periods than that of the feedback.
        """
        if self.period is not None:
            difference = abs(control_period - self.period)
            if difference > SAME_PERIOD * self.period:
                allowed = f"that of the controller, {self.period:g}"
                raise OutOfRange("control period of the run", control_period, allowed, "s")
        if self.converters is not None:
            steps = self.converters.delay_steps(0.0, control_period)
            if steps != self.delay:
                raise OutOfRange(
                    f"delay of {self.converters.delay:g} s in control periods of "
                    f"{control_period:g} s",
                    steps,
                    f"{self.delay}, the commands on their way that the feedback has gains for; run "
                    "it with the control period that it was designed with",
                )
        self._restart()

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of a control instant, shape (m,), and go on to the next one."""
        if t != self._t:
            self._t = t
            self._x = self._next_x
        if self.setpoint == "run":
            # The crane about the setpoint of the run stands as one that is shifted stands about the
            # rest.
            shift = self._shifts(setpoint.position[None])[0]
            state = State(state.q - shift[: len(state.q)], state.v)
        command = self.tracking(t, state, setpoint)
        if not len(self.states):
            return command
        table = self.tracking.setpoint
        place = locate(t, self.tracking.period, len(table))
        deviation = np.concatenate(state) - interpolate(table, *place)
        command = command + self.states.c @ self._x
        self._next_x = next_states(self.states, self._x, deviation, command)
        return command

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        form = self.tracking.affine(times, positions)
        if self.setpoint == "run":
            form = replace(form, setpoint=form.setpoint + self._shifts(positions))
        if len(self.states):
            x = self._x if times[0] == self._t else self._next_x
            form = replace(form, states=replace(self.states, initial=x))
        return form

    def resume_states(self, t: float, states: np.ndarray) -> None:
        """Continue after a control instant [s], see `cranedyn.controllers.affine.Dynamic`."""
        self._t = t
        self._next_x = states

    def _shifts(self, positions: np.ndarray) -> np.ndarray:
        """Return the state at rest, less that of its own rest, shape (rows, 2 n), where the drives
        are at the given positions, shape (rows, m).
        """
        at_rest = self.tracking.setpoint[0, self.crane.layout.drives]
        return at_rest_shifted(self.crane, positions - at_rest)


def linear_controller(
    crane: Crane,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: np.ndarray,
    *,
    about: State | Motion,
    inputs: Sequence[str],
    outputs: Sequence[str] | None = None,
    period: float | None = None,
    initial: np.ndarray | None = None,
    anti_windup: AntiWindup = "observer",
    setpoint: SetpointSource = "rest",
    drive: Drive = "effort",
    dt: float = 5e-4,
    converters: Converters | None = None,
) -> LinearController:
    """Return a discrete state-space system as a controller, see `cranedyn.controllers.linear`.

    It acts on deviations from a rest or a motion, whose commands are fed forward. Drives that no
    output commands are held at their setpoints: those that take efforts by the gains of
    `hold_controller`, those that take rates by what `as_velocity_command` makes of it, and those
    that take accelerations with critical damping at `hold.FREQUENCY`.

    With the anti-windup "observer" the states follow an observer of the applied command,
    x ← (a - l c) x + (b - l d) y + l applied, whose gain l makes a - l c stable: it is that of a
    stationary Kalman filter with unit weights, see `observer_gain`. Source: K. J. Åström and B.
    Wittenmark, Computer-Controlled Systems, 3rd ed., 1997, chapter 9, on nonlinear actuators.

    Args:
        crane: The crane.
        a: Matrix of the states in their next values, shape (k, k); empty for a gain.
        b: Matrix of the inputs in these, shape (k, inputs).
        c: Matrix of the states in the commands, shape (outputs, k).
        d: Matrix of the inputs in the commands, shape (outputs, inputs). A feedback that pulls back
            has negative numbers here.
        about: The rest, or the motion, from which inputs and outputs are deviations.
        inputs: Names of states of the crane, such as "phi" or "x_dot"; with "velocity" also of
            commands on their way to the converters, such as "x_dot_command_1", the command of one
            control period before.
        outputs: Names of commands of the drives, such as "F_x", see
            `cranedyn.model.signals.input_names`; None for all, in the order of the drives.
        period: Its control period [s], that of every run; needed with states.
        initial: States at the start of a run, shape (k,); None for zero.
        anti_windup: Gain of what saturation takes away from the commands in the next states, shape
            (k, outputs); "observer"; or None, for states that do not know about limits. Unless it
            is None, the controller also remembers commands on their way as the limits leave them.
        setpoint: "rest" to act about the positions of the rest or motion, or "run" to act about
            those of the reference of the run, which an exported block has as inputs. The rates of
            that reference are not used.
        drive: What the commands are: efforts, with "motion" accelerations, or with "velocity"
            rates.
        dt: Physics step of the run [s]; a motion's period is a multiple of it.
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        OutOfRange: If a matrix has another shape or is not finite; for a rest at which something
            moves; or for a setpoint of the run beside a motion.
        UnknownName: If there is no such state or command.
        CraneError: If a name is given twice, or the states cannot be observed in the commands.
    """
    check_choice("drive", drive, Drive)
    check_choice("setpoint", setpoint, SetpointSource)
    converters = converters_of_run(crane, drive, converters)
    commands = input_names(crane, drive)
    outputs = commands if outputs is None else list(outputs)
    _check_names("command", outputs, commands)
    output_places = [commands.index(name) for name in outputs]
    places = _places(crane, about, commands if drive == "velocity" else [], inputs)

    k = len(finite("a of the controller", a, ("k", "k")))
    a = finite("a of the controller", a, (k, k))
    b = finite("b of the controller", b, (k, len(inputs)))
    c = finite("c of the controller", c, (len(outputs), k))
    d = finite("d of the controller", d, (len(outputs), len(inputs)))
    first = np.zeros(k) if initial is None else finite("initial states", initial, (k,))
    if k or period is not None:
        period = number("period of the controller", period, "s", "> 0")

    # The same with all states of the crane, all commands on their way, and all commands.
    m = crane.layout.m
    width = 2 * crane.layout.n
    by_input = np.zeros((k + m, width + m * places.delay))
    by_input[:k, places.columns] = b
    by_input[np.ix_([k + i for i in output_places], places.columns)] = d
    held = np.setdiff1d(np.arange(m), output_places)
    by_input[k + held, :width] = -_holding_gain(crane, drive, converters)[held]
    by_state = np.zeros((m, k))
    by_state[output_places] = c
    back = np.zeros((k, m))
    back[:, output_places] = _back_calculation(a, c, anti_windup)

    states = _with_memory(
        ControllerStates(a, by_input[:k], by_state, back, _limits(crane, drive, converters), first),
        by_input[k:],
        places.delay,
        as_applied=anti_windup is not None,
    )
    gain = 0.0 - by_input[k:, :width]  # 0, and not -0, for an input that has no effect
    if isinstance(about, Motion):
        if setpoint == "run":
            raise OutOfRange("setpoint", setpoint, '"rest" about a motion, which has its own')
        tracking = _along(crane, about, gain, drive, dt)
    else:
        tracking = _at_rest(crane, about, gain, drive)
    return LinearController(
        crane,
        tracking,
        states,
        period,
        setpoint,
        places.delay,
        converters if places.delay else None,
    )


@dataclass(frozen=True)
class _InputPlaces:
    """Where the inputs of a controller are.

    Attributes:
        columns: Index of each input among coordinates, rates, and then the commands on their way,
            the oldest first.
        delay: Number of control periods for which a command is on its way; 0 if none is an input.
    """

    columns: list[int]
    delay: int


def _check_names(kind: str, names: Sequence[str], allowed: Sequence[str]) -> None:
    """Check that names are allowed ones, each once.

    Raises:
        UnknownName: If one is not allowed.
        CraneError: If one stands twice.
    """
    for i, name in enumerate(names):
        if name not in allowed:
            raise UnknownName(kind, str(name), allowed)
        if name in names[:i]:
            raise CraneError(f"The {kind} {name} is given twice to the controller.")


def _places(
    crane: Crane, about: State | Motion, commands: Sequence[str], inputs: Sequence[str]
) -> _InputPlaces:
    """Return where the inputs are.

    Args:
        crane: The crane.
        about: Rest or motion of the controller.
        commands: Names of the commands that may be on their way.
        inputs: Names of the inputs.

    Raises:
        UnknownName: If one is no state of the crane and no command on its way.
    """
    if isinstance(about, Motion):
        first_state = State(about.q[0], about.v[0])
    else:
        first_state = crane.layout.as_state("rest", about)
    names = state_names(crane)
    held = held_states(crane, first_state)
    # Those that are held, such as the stretch of a rigid rope, are no states.
    allowed = [name for i, name in enumerate(names) if i not in held]
    delay = 0
    for name in inputs:
        command, _, periods = str(name).rpartition("_")
        if command in commands and periods.isdecimal() and periods[0] != "0":
            delay = max(delay, int(periods))
    if delay > MAX_DELAY_STEPS:
        name = "control periods for which a command is on its way"
        raise OutOfRange(name, delay, f"{MAX_DELAY_STEPS} or less")
    for periods_ago in range(delay, 0, -1):
        on_their_way = [f"{command}_{periods_ago}" for command in commands]
        allowed += on_their_way
        names += on_their_way
    _check_names("input", list(inputs), allowed)
    return _InputPlaces([names.index(name) for name in inputs], delay)


def _holding_gain(crane: Crane, drive: Drive, converters: Converters | None) -> np.ndarray:
    """Return the gain that holds each drive by itself, shape (m, 2 n)."""
    m = crane.layout.m
    if drive == "motion":
        return feedback_gain(crane, np.full(m, FREQUENCY**2), np.full(m, 2.0 * FREQUENCY))
    hold = hold_controller(crane)
    if drive == "velocity":
        hold = as_velocity_command(crane, hold, drive="effort", converters=converters)  # type: ignore[assignment]
    return feedback_gain(crane, hold.stiffness, hold.damping)


def _limits(crane: Crane, drive: Drive, converters: Converters | None) -> np.ndarray:
    """Return the largest command that each drive takes, shape (m,); inf for none."""
    if drive == "effort":
        return np.array(crane.effort_limit, dtype=float)
    if converters is not None:
        return converters.rates
    return np.full(crane.layout.m, np.inf)


def _back_calculation(a: np.ndarray, c: np.ndarray, anti_windup: AntiWindup) -> np.ndarray:
    """Return the gain from what saturation takes away from the commands to the next states, shape
    (k, outputs), see `linear_controller`.

    Raises:
        OutOfRange: If a matrix is given that has another shape or is not finite.
        CraneError: If an observer is asked for, and the states cannot be observed.
    """
    outputs, k = c.shape
    if anti_windup is None or not k:
        return np.zeros((k, outputs))
    if isinstance(anti_windup, str):
        check_choice("anti_windup", anti_windup, _Observer)
        return observer_gain(a, c)
    return finite("anti_windup", anti_windup, (k, outputs))


def observer_gain(a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the gain l of an observer x ← a x + l (u - c x) of the states of a controller by its
    command u, shape (k, outputs): that of a stationary Kalman filter with unit weights.

    Args:
        a: Shape (k, k).
        c: Shape (outputs, k).

    Raises:
        CraneError: If no gain makes a - l c stable.
    """
    try:
        # Numbers that overflow give no gain, which is refused below.
        with np.errstate(all="ignore"):
            covariance = scipy.linalg.solve_discrete_are(a.T, c.T, np.eye(len(a)), np.eye(len(c)))
            of_command = c @ covariance @ c.T + np.eye(len(c))
            gain = np.linalg.solve(of_command, c @ covariance @ a.T).T
            radius = float(np.abs(np.linalg.eigvals(a - gain @ c)).max())
    except (np.linalg.LinAlgError, ValueError):
        radius = np.inf
    if not radius < 1.0:
        raise CraneError(
            "The controller has states that do not decay and cannot be observed in its commands, "
            "or numbers too large for a Riccati equation, so that there is no anti-windup "
            '"observer"; give it anti_windup=None or a matrix, or leave these states out.'
        )
    return gain


def _along(crane: Crane, motion: Motion, gain: np.ndarray, drive: Drive, dt: float) -> Tracking:
    """Return the feedback of a gain about a motion, whose commands are fed forward."""
    table = linearised(crane, motion, dt=dt, every=len(motion.q))
    if drive == "effort":
        commands = table.efforts
    elif drive == "motion":
        commands = motion.a[:, motion.drives]
    else:
        commands = motion.v[:, motion.drives]
    gains = np.broadcast_to(gain, (len(commands), *gain.shape))
    return Tracking(motion.period, commands, gains, table.setpoint)


def _at_rest(crane: Crane, rest: State, gain: np.ndarray, drive: Drive) -> Tracking:
    """Return the feedback of a gain about a rest, whose command is fed forward.

    Raises:
        OutOfRange: If something moves there.
    """
    rest = crane.layout.as_state("rest", rest)
    if rest.v.any():
        allowed = "0; a motion is given as a Motion"
        raise OutOfRange("rates of the rest", rest.v.tolist(), allowed, "/s")
    command = np.zeros(crane.layout.m)
    if drive == "effort":
        command = holding_effort(crane, rest.q)
    any_period = 1.0  # of a table of one row
    return Tracking(any_period, command[None], gain[None], np.concatenate(rest)[None])


def _with_memory(
    states: ControllerStates, by_input: np.ndarray, delay: int, *, as_applied: bool
) -> ControllerStates:
    """Return states that also remember the last commands, as far as the controller feeds them
    back.

    With the commands p on their way, the oldest first, and the last columns of b and d for them,
    the command is u = c x + d z + d_p p. Then x becomes a x + b z + b_p p, and p moves on by one
    with u at its end.

    Args:
        states: States of the controller, with columns of b for coordinates, rates, and the commands
            on their way.
        by_input: d, with the same columns, shape (m, 2 n + m delay).
        delay: Number of control periods for which a command is on its way.
        as_applied: Whether a command is remembered as the limits leave it, or as it was asked for.
    """
    m = len(by_input)
    k = len(states)
    remembered = m * delay
    width = by_input.shape[1] - remembered
    if not delay:
        return states
    from_states = states.b[:, :width]
    from_memory = states.b[:, width:]
    direct = by_input[:, :width]
    direct_from_memory = by_input[:, width:]
    moved_on = np.eye(remembered, k=m)
    newest = np.zeros((remembered, m))
    newest[-m:] = np.eye(m)
    return ControllerStates(
        a=np.block(
            [
                [states.a, from_memory],
                [newest @ states.c, moved_on + newest @ direct_from_memory],
            ]
        ),
        b=np.vstack([from_states, newest @ direct]),
        c=np.hstack([states.c.reshape(m, k), direct_from_memory]),
        anti_windup=np.vstack(
            [states.anti_windup, newest if as_applied else np.zeros_like(newest)]
        ),
        limit=states.limit,
        initial=np.append(states.initial, np.zeros(remembered)),
    )
