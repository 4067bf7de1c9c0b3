"""The affine form of controllers that are affine in the state, so that a closed loop can be
compiled.

A controller may have states of its own, such as those of a filter, an observer or an integrator
that is given as matrices: then its form has `ControllerStates`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from cranedyn.checks import as_array, read_only
from cranedyn.dynamics.scalars import array, clipped, magnitude, where
from cranedyn.errors import Misshapen
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class ControllerStates:
    """States x of a dynamic controller in discrete time, which add c x to its command u.

        x[k + 1] = a x[k] + b (z[k] - setpoint[k]) + anti_windup (applied[k] - u[k])

    Here u is the whole command and `applied` what the limits of the drives leave of it. Without
    saturation both are equal, so that the last term acts at a limit only: this is anti-windup by
    back-calculation.

    Attributes:
        a: Shape (k, k).
        b: Shape (k, 2 n).
        c: Shape (m, k).
        anti_windup: Gain of what saturation takes away from the command, shape (k, m); zero for no
            anti-windup.
        limit: Largest command that a drive takes, shape (m,); inf for none.
        initial: States at the first row of the form, shape (k,).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    anti_windup: np.ndarray
    limit: np.ndarray
    initial: np.ndarray

    def __len__(self) -> int:
        """Return the number of states, k."""
        return len(self.initial)

    def checked(self, owner: str, drives: int, width: int) -> ControllerStates:
        """Return the same states with the shapes of all fields checked, see `Affine.checked`.

        Raises:
            Misshapen: If a field has another shape, or a limit is no number.
        """

        def field(name: str, *shape: int | str) -> np.ndarray:
            """Return a field with its shape checked."""
            return as_array(f"{name} of the states of {owner}", getattr(self, name), shape)

        initial = field("initial", "k")
        count = len(initial)
        limit = field("limit", drives)
        if np.isnan(limit).any():
            name = f"limit of the states of {owner}"
            raise Misshapen(name, "an array that holds nan", "numbers, inf for none")
        return ControllerStates(
            a=field("a", count, count),
            b=field("b", count, width),
            c=field("c", drives, count),
            anti_windup=field("anti_windup", count, drives),
            limit=limit,
            initial=initial,
        )


def next_states(
    states: ControllerStates, x: np.ndarray, deviation: np.ndarray, command: np.ndarray
) -> np.ndarray:
    """Return the states of a controller at the next control instant, shape (k,), in any kind of
    number, see `ControllerStates`.

    Args:
        states: Its matrices.
        x: States at this instant, shape (k,).
        deviation: Deviation from the setpoint, shape (2 n,).
        command: Whole command before it is limited, shape (m,).
    """
    removed: list[Any] = []
    for value, limit in zip(command, states.limit, strict=True):
        # No language of an exported block has a literal for infinity.
        is_unlimited = isinstance(limit, float) and not limit < np.inf
        removed.append(0.0 if is_unlimited else clipped(value, -limit, limit) - value)
    saturation = array(removed) if command.dtype == object else np.array(removed)
    return states.a @ x + states.b @ deviation + states.anti_windup @ saturation


@dataclass(frozen=True, eq=False)
class Affine:
    """command = feed_forward[k] - gain[k] (z - setpoint[k]) + c x + integral_gain
    ∫ (target - position), with z = (coordinates, rates) and the states x of `ControllerStates`.

    Row k is for control instant k; beyond the end of an array its last row holds. The error at a
    control instant counts for one control period of the run. At the limit of a drive its integral
    only decreases.

    Attributes:
        feed_forward: Commands at the setpoint, shape (rows, m), with one row a control instant at
            most.
        gain: Gains, shape (rows, m, 2 n).
        setpoint: The motion to track, shape (rows, 2 n), with any number of rows.
        target: Positions to which the integrals take the drives, shape (rows, m), with any number
            of rows.
        integral_gain: Gains of the integrals, per second, shape (m,).
        limit: Largest command with which the integrals grow, shape (m,).
        integral: Integrals at the first row, shape (m,).
        states: Further states of the controller; None for a controller without.
    """

    feed_forward: np.ndarray
    gain: np.ndarray
    setpoint: np.ndarray
    target: np.ndarray
    integral_gain: np.ndarray
    limit: np.ndarray
    integral: np.ndarray
    states: ControllerStates | None = None

    def not_finite_field(self) -> str:
        """Return the name of the first field with a number that is not finite, or an empty text; a
        limit may be infinite.
        """
        for name in ("feed_forward", "gain", "setpoint", "target", "integral_gain", "integral"):
            if not np.isfinite(getattr(self, name)).all():
                return name
        if self.states is not None:
            for name in ("a", "b", "c", "anti_windup", "initial"):
                if not np.isfinite(getattr(self.states, name)).all():
                    return f"states.{name}"
        return ""

    def checked(self, owner: str, instants: int, drives: int, width: int) -> Affine:
        """Return the same form with the shapes of all fields checked.

        Args:
            owner: Name of the controller whose form it is, for an error.
            instants: Number of control instants.
            drives: Number of drives, m.
            width: Number of coordinates and rates together, 2 n.

        Raises:
            Misshapen: If a field has another shape, or a limit is no number.
        """

        def field(name: str, *shape: int | str) -> np.ndarray:
            """Return a field with its shape checked; "rows" stands for 1 to `instants` rows."""
            title = f"{name} in the common form of {owner}"
            checked = as_array(title, getattr(self, name), shape)
            if isinstance(shape[0], str) and not 0 < len(checked) <= instants:
                rows = f"an array of {len(checked)} rows"
                raise Misshapen(title, rows, f"one of 1 to {instants}")
            return checked

        feed_forward = field("feed_forward", "rows", drives)
        limit = field("limit", drives)
        if np.isnan(limit).any():
            name = f"limit in the common form of {owner}"
            raise Misshapen(name, "an array that holds nan", "numbers, inf for none")
        return Affine(
            feed_forward=feed_forward,
            gain=field("gain", len(feed_forward), drives, width),
            setpoint=field("setpoint", "rows", width),
            target=field("target", "rows", drives),
            integral_gain=field("integral_gain", drives),
            limit=limit,
            integral=field("integral", drives),
            states=self._checked_states(owner, drives, width),
        )

    def _checked_states(self, owner: str, drives: int, width: int) -> ControllerStates | None:
        """Return the states with the shapes of their fields checked; None for no states."""
        if self.states is None:
            return None
        states = self.states.checked(owner, drives, width)
        return states if len(states) else None


@runtime_checkable
class AffineController(Protocol):
    """A controller that has an affine form."""

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form at control instants [s], shape (n,), with the setpoint of the
        drives at positions, shape (rows, m).

        None where it is not affine there.
        """


@runtime_checkable
class Stateful(Protocol):
    """An affine controller that integrates, and can continue from an integral."""

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Continue from an integral, shape (m,), that includes a control instant [s]."""


@runtime_checkable
class Dynamic(Protocol):
    """An affine controller with states of its own, which can continue from given ones."""

    def resume_states(self, t: float, states: np.ndarray) -> None:
        """Continue after a control instant [s] with states, shape (k,), that include it."""


def affine_form(
    controller: object, times: np.ndarray, positions: np.ndarray, width: int
) -> Affine | None:
    """Return the affine form of a controller, see `AffineController.affine`; None if it has none,
    if a subclass overrides `__call__` alone, or if the form has states and the controller is not
    `Dynamic`.

    Args:
        controller: The controller.
        times: Control instants [s].
        positions: Setpoints of the drives there, shape (rows, m).
        width: Number of coordinates and rates together, 2 n.

    Raises:
        Misshapen: If it is not made of arrays as it should be.
    """
    # The first class of the method resolution order with one of both methods must have `affine`: a
    # subclass that overrides `__call__` alone commands something else than the inherited form.
    defining_class: type = object
    for kind in type(controller).__mro__:
        if vars(kind).keys() & {"__call__", "affine"}:
            defining_class = kind
            break
    if not callable(vars(defining_class).get("affine")):
        return None
    owner = type(controller).__name__
    form = cast(AffineController, controller).affine(read_only(times), read_only(positions))
    if form is not None and not isinstance(form, Affine):
        allowed = "an Affine, or None where it is not affine"
        raise Misshapen(f"the common form of {owner}", type(form).__name__, allowed)
    if form is None:
        return None
    form = form.checked(owner, len(times), positions.shape[1], width)
    if form.states is not None and not hasattr(controller, "resume_states"):
        # Such as a wrapper around a controller with states, which could not go on from them.
        return None
    return form


def integrated_command(
    command: Any, error: Any, integral: Any, gain: Any, limit: Any, period: Any
) -> tuple[Any, Any]:
    """Return the command of a drive with its integral, and the integral after a control period, in
    any kind of number.

    Args:
        command: Command without the integral.
        error: Target less position.
        integral: Integral of the error so far.
        gain: Gain of the integral, per second.
        limit: Largest command with which the integral grows.
        period: Control period [s].
    """
    # Anti-windup: at the limit the integral only grows where that takes the command back, which is
    # where error and command have different signs.
    next_integral = integral + error * period
    total = command + gain * next_integral
    is_within_limit = magnitude(total) <= limit
    at_limit = where(error * total < 0.0, next_integral, integral)
    integral = where(is_within_limit, next_integral, at_limit)
    return command + gain * integral, integral


def without_integral(feed_forward: np.ndarray, gain: np.ndarray, setpoint: np.ndarray) -> Affine:
    """Return the affine form of a controller that does not integrate."""
    zero = np.zeros(feed_forward.shape[1])
    return Affine(
        feed_forward=feed_forward,
        gain=gain,
        setpoint=setpoint,
        target=zero[None],
        integral_gain=zero,
        limit=np.full_like(zero, np.inf),
        integral=zero,
    )


def at_drives(crane: Crane, positions: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return coordinates and rates, shape (rows, 2 n), from those of the drives, shape (rows, m)
    each; zero for the passive joints.
    """
    layout = crane.layout
    setpoint = np.zeros((len(positions), 2 * layout.n))
    setpoint[:, layout.drives] = positions
    setpoint[:, layout.n + layout.drives] = rates
    return setpoint


def at_rest_shifted(crane: Crane, shifts: np.ndarray) -> np.ndarray:
    """Return by how much coordinates and rates at rest change, shape (rows, 2 n), where the drives
    stand elsewhere by the given shifts, shape (rows, m).

    The swings of a luffing crane, which are measured from its jib, hang at another angle where the
    jib stands at another one.
    """
    change = at_drives(crane, shifts, np.zeros_like(shifts))
    change[:, crane.swings] += shifts @ crane.rest.slope.T
    return change
