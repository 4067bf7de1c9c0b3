"""What a reference says."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from cranedyn.checks import finite, short_repr
from cranedyn.errors import CraneError, Misshapen, format_error
from cranedyn.interfaces import Reference, Setpoint

_PARTS = ("position", "velocity", "acceleration")


def checked_setpoint(answer: Any, shape: tuple[int | str, ...] = ("m",)) -> Setpoint:
    """What a reference answered: positions, rates and accelerations as arrays of finite numbers, of
    one shape.

    Args:
        answer: The answer.
        shape: What shape they must have.

    Raises:
        Misshapen: If it is anything else.
        OutOfRange: If a number is not finite.
    """
    if len(shape) == 1 and _sound(answer, shape[0]):
        return answer
    if not isinstance(answer, Setpoint):
        raise Misshapen(
            "answer of the reference",
            short_repr(answer),
            "a cranedyn.Setpoint: position, velocity, acceleration",
        )
    parts = []
    for name, part in zip(_PARTS, answer, strict=True):
        parts.append(finite(f"{name} of the setpoint", part, shape))
        shape = parts[0].shape
    return Setpoint(*parts)


def _sound(answer: Any, drives: int | str) -> bool:
    """Whether these are three times as many finite numbers as there are drives, seen quickly: it is
    asked at every control instant.
    """
    try:
        position, velocity, acceleration = (
            answer.position.tolist(),
            answer.velocity.tolist(),
            answer.acceleration.tolist(),
        )
        alike = len(position) == len(velocity) == len(acceleration) == drives
        return (
            alike
            and math.isfinite(sum(position) + sum(velocity) + sum(acceleration))
            and type(answer) is Setpoint
        )
    except (AttributeError, TypeError, ValueError):
        return False


class Setpoints:
    """What a reference answers at one time after another, looked at.

    Attributes:
        steady: What it answered twice and nobody can change, which is not looked at again.
    """

    def __init__(self, reference: Reference, drives: int) -> None:
        self._reference, self._shape = reference, (drives,)
        self._last: Setpoint | None = None
        self.steady: Setpoint | None = None

    def __call__(self, t: float) -> Setpoint:
        """The setpoint at a time [s].

        Raises:
            OutOfRange: If it is none, see `checked_setpoint`.
        """
        answer = self._reference(t)
        if self.steady is not None and answer is self.steady:
            return self.steady
        setpoint = checked_setpoint(answer, self._shape)
        if answer is self._last and all(
            part.dtype == float and part.flags.owndata and not part.flags.writeable
            for part in setpoint
        ):
            self.steady = answer
        self._last = answer
        return setpoint


def tabulated(reference: Reference, times: np.ndarray, drives: int | None = None) -> Setpoint:
    """The setpoints of a reference at many times [s], shape (rows, m) each; by its own `at` if it
    has one, which takes all at once.

    Args:
        reference: The reference.
        times: The times [s].
        drives: How many drives it must speak of; None for any number.

    Raises:
        Misshapen: If it answers with anything but arrays of that shape.
        OutOfRange: If a number is not finite.
        CraneError: If it raises an error, which is then its cause.
    """
    columns = "m" if drives is None else drives
    at_once = getattr(reference, "at", None)
    with owned("reference"):
        if at_once is not None:
            return checked_setpoint(at_once(times), (len(times), columns))
        rows = [checked_setpoint(reference(t), (columns,)) for t in times.tolist()]
    if not rows:
        return Setpoint(*np.empty((3, 0, drives or 0)))
    return Setpoint(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


@contextmanager
def owned(whose: str) -> Iterator[None]:
    """Where a caller's own function is asked: what it raises becomes a sentence that says where.

    Raises:
        CraneError: If it raises anything else; that is its cause.
    """
    try:
        yield
    except CraneError:
        raise
    except Exception as error:
        raise CraneError(f"The {whose} raised {format_error(error)}") from error


class Tabulating(ABC):
    """A reference that is written down for many times at once."""

    @abstractmethod
    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (rows, m) each."""

    def __call__(self, t: float) -> Setpoint:
        """The setpoint at a time [s]."""
        return Setpoint(*(part[0] for part in self.at(np.array([t]))))
