"""Clocks of a run: physics steps within control periods within its duration."""

from __future__ import annotations

import copy
import math
from typing import Any, NamedTuple, Protocol, runtime_checkable

from cranedyn.checks import number, within
from cranedyn.errors import OutOfRange

_MIN_STEP = 1e-9
"""Shortest physics step [s]."""

_MAX_STEP = 1e3
"""Longest physics step [s]."""

_MAX_STEPS = 1e10
"""Largest number of physics steps of a run; more would take most of a day."""

_MAX_ROWS = 4_000_000
"""Largest number of rows of a planned motion: five hours at 200 Hz; more would take gigabytes."""

_BUFFER_STEP = 5e-4
"""Longest step in which buffers act, where the stepping rule asks for a smooth motion [s]."""

_ROUNDING = 1e-9
"""Rounding error of the quotient of two times, as a number of steps or as a share."""

SAME_PERIOD = 1e-3
"""Relative difference of two control periods that count as the same; a clock at 1e9 s rounds to
1e-7 s."""


class Clocks(NamedTuple):
    """Physics steps and control periods of a run.

    Attributes:
        dt: Physics step [s].
        period: Time between control instants [s].
        steps: Physics steps in a control period.
        periods: Control periods in the run.
    """

    dt: float
    period: float
    steps: int
    periods: int

    @property
    def substeps(self) -> int:
        """Small steps that replace a physics step where buffers act."""
        return math.ceil(self.dt / _BUFFER_STEP - _ROUNDING)


@runtime_checkable
class Clocked(Protocol):
    """A controller that needs the control period of a run before it begins."""

    def begin_run(self, t: float, control_period: float) -> None:
        """Prepare for a run from its first control instant [s] and its control period [s].

        Raises:
            OutOfRange: If the controller was made for a shorter control period.
        """


def at_begin_of_run(controller: Any, t: float, control_period: float) -> Any:
    """Return a controller as it is at the first control instant [s] of a run: one that is `Clocked`
    as a copy that has begun such a run, so that it itself stays as it is.

    Raises:
        OutOfRange: If the controller was made for another control period.
    """
    # To ask for the protocol `Clocked` would take ten times as long.
    if not hasattr(controller, "begin_run"):
        return controller
    controller = copy.copy(controller)
    controller.begin_run(t, control_period)
    return controller


def clocks(duration: float, dt: float, control_period: float) -> Clocks:
    """Return the clocks of a run.

    Args:
        duration: How long it is [s], a multiple of the control period.
        dt: Physics step [s], 1e-9 to 1000.
        control_period: Time between control instants [s], a multiple of `dt`.

    Raises:
        OutOfRange: If a time is not positive, one does not divide the other, or the run would have
            more than 1e10 steps.
    """
    number("dt", dt, "s", "> 0")
    within("dt", dt, _MIN_STEP, _MAX_STEP, "s")
    number("control_period", control_period, "s", "> 0")
    number("duration", duration, "s", "> 0")
    # Before the times are divided: a quotient of 1e300 is no number of steps.
    longest = max(duration, control_period)
    for name, step in (("dt", dt), ("control_period", control_period)):
        if longest / step > _MAX_STEPS:
            shortest = longest / _MAX_STEPS
            raise OutOfRange(
                name,
                step,
                f"{shortest:g} or more for a run of {longest:g} s, that is {_MAX_STEPS:g} steps",
                "s",
            )
    steps = multiple("control_period", control_period, "dt", dt)
    periods = multiple("duration", duration, "control_period", control_period)
    return Clocks(dt, control_period, steps, periods)


def soon_enough(controller_period: float, control_period: float) -> None:
    """Return if a run calls a controller at least once in the controller's own period [s].

    A controller that is called less often overshoots.

    Raises:
        OutOfRange: If the control period of the run [s] is longer, by more than `SAME_PERIOD`.
    """
    if control_period > controller_period * (1.0 + SAME_PERIOD):
        raise OutOfRange(
            "control period of the run",
            control_period,
            f"that for which the controller was made, {controller_period:g} s, or less",
            "s",
        )


def intervals(name: str, duration: float, step: float) -> int:
    """Return the number of steps that cover a duration; the last may end after it.

    Args:
        name: Name of the duration for the error message.
        duration: The duration [s].
        step: Length of a step [s].

    Raises:
        OutOfRange: If one is not positive, or there would be more than 4 million.
    """
    number(name, duration, "s", "> 0")
    number("step", step, "s", "> 0")
    if duration / step > _MAX_ROWS:
        raise OutOfRange(
            name,
            duration,
            f"{_MAX_ROWS * step:g} or less: {_MAX_ROWS} rows that are {step:g} s apart",
            "s",
        )
    return math.ceil(duration / step - _ROUNDING)


def whole_periods(time: float, control_period: float) -> float:
    """Round a time to whole control periods, one at least [s]."""
    return control_period * max(1, round(time / control_period))


def multiple(name: str, value: float, of_name: str, of: float) -> int:
    """Return how many times a time is another.

    Args:
        name: Name of the longer time for the error message.
        value: The longer time [s].
        of_name: Name of the shorter time for the error message.
        of: The shorter time [s].

    Raises:
        OutOfRange: If one is not positive, or they do not divide.
    """
    number(of_name, of, "s", "> 0")
    ratio = number(name, value, "s", "> 0") / of
    # A very short time has no finite quotient, and an infinite one cannot be rounded.
    times = round(ratio) if math.isfinite(ratio) else 0
    if times < 1 or abs(times * of - value) > _ROUNDING * value:
        raise OutOfRange(name, value, f"a multiple of {of_name} = {of:g} s", "s")
    return times
