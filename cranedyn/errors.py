"""What goes wrong, in one sentence each: what was given, what is allowed, in which unit."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable
from numbers import Integral
from typing import Any

_LONGEST = 2000
_LONGEST_QUOTE = 200
_PLAIN = re.compile(r"[\w./:+-]+", re.ASCII)


def printable(text: object) -> str:
    """What a stranger wrote, on one line: characters that are not printable are escaped as in
    Python.
    """
    words = str(text)
    return words if words.isprintable() else repr(words)[1:-1]


def quoted(text: object) -> str:
    """The same as part of a sentence: a plain word as it is, all else cut to a length and between
    quotation marks that it cannot close.
    """
    cut = _shortened(str(text), _LONGEST_QUOTE)
    return cut if _PLAIN.fullmatch(cut) else repr(cut)


def shown(value: object) -> str:
    """A value as in Python; what it is if that cannot be said, as of a whole number of more than
    4300 digits.
    """
    try:
        return repr(value)
    except Exception:  # whatever the value of a stranger raises
        return written_out(value)


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length // 2]} … {text[-length // 2 :]}"


class CraneError(Exception):
    """Base of every error that cranedyn raises on purpose; its text is one clear sentence.

    Whatever names and values from elsewhere it quotes, it is one line of printable characters and
    not endless.
    """

    def __init__(self, sentence: str) -> None:
        """Keep the sentence."""
        super().__init__(
            "".join(c if c.isprintable() else " " for c in _shortened(sentence, _LONGEST))
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Come back from another process as what it was, although each kind is made from values of
        its own.
        """
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[CraneError], sentence: tuple[str], values: dict[str, object]) -> CraneError:
    error = kind.__new__(kind, *sentence)
    error.__dict__.update(values)
    return error


class OutOfRange(CraneError):
    """A number outside of what is allowed.

    Attributes:
        name: What the number is.
        value: The number given.
        allowed: What is allowed, in words, for example ``"> 0"``.
        unit: Its unit, empty for a pure number.
    """

    def __init__(self, name: str, value: object, allowed: str, unit: str = "") -> None:
        """Keep the values and phrase the sentence."""
        self.name, self.value, self.allowed, self.unit = name, value, allowed, unit
        super().__init__(
            f"{name} is {f'{written_out(value)} {unit}'.strip()}; allowed is {allowed}."
        )


def written_out(value: object) -> str:
    """A value as text; what it is if there is none, as of a whole number of more than 4300
    digits.
    """
    try:
        return str(value)
    except Exception:  # whatever the value of a stranger raises
        return f"{type(value).__name__} that cannot be written out"


class Misshapen(OutOfRange):
    """What should be an array is another: of another shape or kind, or none at all."""


class UnknownName(CraneError):
    """A name that is not one of those known.

    Attributes:
        given: The name given.
        known: The names there are.
    """

    def __init__(self, kind: str, given: str, known: Iterable[str]) -> None:
        """Keep the values and phrase the sentence."""
        self.given, self.known = given, tuple(known)
        super().__init__(f"There is no {kind} {shown(given)}; there are {', '.join(self.known)}.")


class MissingRole(CraneError):
    """Something made for a tower crane is asked of a crane in which no joint plays a part that it
    needs.

    Attributes:
        role: The part.
        joints: Names of the joints there are.
    """

    def __init__(self, user: str, role: str, joints: Iterable[str]) -> None:
        """Keep the values and phrase the sentence.

        Args:
            user: What needs the part, to begin the sentence with.
            role: The part.
            joints: Names of the joints there are.
        """
        self.role, self.joints = role, tuple(joints)
        super().__init__(
            f"{user} needs a joint in the role {role}; the joints of this crane are "
            f"{', '.join(self.joints)}."
        )


class UnknownColumn(UnknownName, KeyError):
    """A column that a table does not have; a KeyError, too, for whoever takes the table for a
    mapping.
    """

    __str__ = Exception.__str__


class ModelError(CraneError):
    """A description that is not a crane: it does not parse, has no payload, or a joint is turned or
    of a type that it must not be.
    """


class DataError(CraneError):
    """A file that cannot be read or written, or does not hold what is needed."""


class RunError(CraneError):
    """A run that ended early.

    Attributes:
        t: Time at which it ended [s].
        joint: Name of the joint concerned, or empty.
        value: The value that was found there.
        trajectory: Everything recorded up to then.
    """

    def __init__(
        self,
        sentence: str,
        *,
        t: float,
        joint: str = "",
        value: float = math.nan,
        trajectory: Any = None,
    ) -> None:
        """Keep the values; the sentence is given."""
        self.t, self.joint, self.value, self.trajectory = t, joint, value, trajectory
        super().__init__(sentence)


def number(name: str, value: object, unit: str = "", allowed: str = "any") -> float:
    """The value as a float, if it is finite and in the range allowed.

    Args:
        name: What the number is, for the sentence.
        value: Anything that ``float`` takes.
        unit: Its unit, for the sentence.
        allowed: ``"any"``, ``"> 0"``, ``">= 0"`` or ``"LOW to HIGH"``.

    Raises:
        OutOfRange: If it is no number, not finite, or not in the range.
    """
    try:
        x = float(value)  # type: ignore[arg-type]
    except Exception:  # whatever the conversion of a stranger's value raises
        if isinstance(value, str):
            if unit and value.strip().endswith(unit):  # which would be said twice
                raise OutOfRange(name, quoted(value), f"the number alone, in {unit}") from None
            value = quoted(value)
        raise OutOfRange(
            name, value, "a number" if allowed == "any" else f"a number {allowed}", unit
        ) from None
    low, high, strict = _range(allowed)
    if not math.isfinite(x) or x < low or x > high or (strict and x == low):
        raise OutOfRange(name, value, "a finite number" if allowed == "any" else allowed, unit)
    return x


def within(name: str, value: object, low: float, high: float, unit: str = "") -> float:
    """The value as a float, if it is finite and between two numbers, both of them allowed.

    Raises:
        OutOfRange: If it is no number, not finite, or not between them.
    """
    x = number(name, value, unit)
    if not low <= x <= high:
        ends = f"{low:g}", f"{high:g}"
        if float(ends[0]) <= x <= float(ends[1]):  # rounded they would seem to allow it
            ends = str(float(low)), str(float(high))
        raise OutOfRange(name, value, " to ".join(ends), unit)
    return x


def whole(name: str, value: object, least: int, unit: str = "") -> int:
    """The value, if it is a whole number from `least` on.

    Raises:
        OutOfRange: If it is none, or less.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise OutOfRange(name, value, f"a whole number >= {least}", unit)
    if int(value) > sys.maxsize:
        raise OutOfRange(name, value, f"a whole number up to {sys.maxsize:g}", unit)
    return int(value)


def _range(allowed: str) -> tuple[float, float, bool]:
    if allowed == "any":
        return -math.inf, math.inf, False
    if " to " in allowed:
        low, high = allowed.split(" to ")
        return float(low), float(high), False
    return 0.0, math.inf, {"> 0": True, ">= 0": False}[allowed]
