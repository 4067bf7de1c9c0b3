"""How a run is divided: physics steps within control periods within its duration."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, runtime_checkable

from cranedyn.checks import number, within
from cranedyn.errors import OutOfRange

_STEPS = 1e-9, 1e3
"""Shortest and longest physics step [s]."""

_MOST_STEPS = 1e10
"""A run of more physics steps than this would take most of a day."""

_MOST_ROWS = 4_000_000
"""A planned motion of more rows than this would take gigabytes; so many are five hours at 200
Hz."""

_SMALL = 5e-4
"""Longest step in which buffers act, where the stepping rule asks for a smooth motion [s]."""


SAME_PERIOD = 1e-3
"""Share by which two times between control instants may differ and still be the same; a clock at
1e9 s rounds to 1e-7 s."""


class Clocks(NamedTuple):
    """A run's division.

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
    def small(self) -> int:
        """How many small steps make a physics step where buffers act."""
        return math.ceil(self.dt / _SMALL - 1e-9)


@runtime_checkable
class Timed(Protocol):
    """A controller that is told how a run is divided before it begins."""

    def run_begins(self, t: float, control_period: float) -> None:
        """Be told the first control instant [s] and the time between control instants [s].

        Raises:
            OutOfRange: If the controller was made for a shorter control period.
        """


def clocks(duration: float, dt: float, control_period: float) -> Clocks:
    """Divide a run.

    Args:
        duration: How long it is [s], a multiple of the control period.
        dt: Physics step [s], 1e-9 to 1000.
        control_period: Time between control instants [s], a multiple of `dt`.

    Raises:
        OutOfRange: If a time is not positive, one does not divide the other, or the run would have
            more than 1e10 steps.
    """
    number("dt", dt, "s", "> 0")
    within("dt", dt, *_STEPS, "s")
    number("control_period", control_period, "s", "> 0")
    number("duration", duration, "s", "> 0")
    longest = max(duration, control_period)
    for name, step in (("dt", dt), ("control_period", control_period)):
        if longest / step > _MOST_STEPS:
            raise OutOfRange(
                name,
                step,
                f"{longest / _MOST_STEPS:g} or more for a run of {longest:g} s, that is "
                f"{_MOST_STEPS:g} steps",
                "s",
            )
    steps = multiple("control_period", control_period, "dt", dt)
    return Clocks(
        dt, control_period, steps, multiple("duration", duration, "control_period", control_period)
    )


def soon_enough(own: float, control_period: float) -> None:
    """Return if a run lets a controller answer at least once in its own control period [s]; else it
    would do too much of everything.

    Raises:
        OutOfRange: If it does not, by more than a clock at 1e9 s rounds off.
    """
    if control_period > own * (1.0 + SAME_PERIOD):
        raise OutOfRange(
            "control period of the run",
            control_period,
            f"that for which the controller was made, {own:g} s, or less",
            "s",
        )


def intervals(name: str, duration: float, step: float) -> int:
    """How many steps a duration takes, the last of which may end after it: one less than there are
    rows in a table.

    Raises:
        OutOfRange: If one is not positive, or there would be more than 4 million.
    """
    number(name, duration, "s", "> 0")
    number("step", step, "s", "> 0")
    if duration / step > _MOST_ROWS:
        raise OutOfRange(
            name,
            duration,
            f"{_MOST_ROWS * step:g} or less: {_MOST_ROWS} rows that are {step:g} s apart",
            "s",
        )
    return math.ceil(duration / step - 1e-9)


def whole_periods(time: float, control_period: float) -> float:
    """Round a time to whole control periods, one at least [s]."""
    return control_period * max(1, round(time / control_period))


def multiple(name: str, value: float, of_name: str, of: float) -> int:
    """How many times one time [s] goes into another.

    Raises:
        OutOfRange: If one is not positive, or they do not divide.
    """
    number(of_name, of, "s", "> 0")
    ratio = number(name, value, "s", "> 0") / of
    times = round(ratio) if math.isfinite(ratio) else 0
    if times < 1 or abs(times * of - value) > 1e-9 * value:
        raise OutOfRange(name, value, f"a multiple of {of_name} = {of:g} s", "s")
    return times
