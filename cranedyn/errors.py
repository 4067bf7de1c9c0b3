"""Errors as one sentence each: what was given, what is allowed, in which unit."""

from __future__ import annotations

import difflib
import math
import re
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_MAX_SENTENCE_LENGTH = 2000
"""Number of characters to which the sentence of an error is cut."""

_MAX_QUOTED_LENGTH = 200
"""Number of characters to which foreign text in a sentence is cut."""

_MIN_SIMILARITY = 0.5
"""Similarity of two names from which on one is suggested for the other, see
`difflib.get_close_matches`; 1 for equal ones."""

_NUMBERS = re.compile(r"[(\[+-]?\.?\d|[+-]?(?:nan|inf)\b|[(\[]")
"""The beginning of a text that is a number, or several."""

_DECIMAL_COMMA = re.compile(r"\s*['\"]?([+-]?\d+),(\d+)['\"]?\s*")
"""A number with a decimal comma, quoted or not."""

_PLAIN = re.compile(r"[\w./:+-]+", re.ASCII)
"""A word that needs no quotation marks: a name, a path, an address or a number."""


def printable(text: object) -> str:
    """Return foreign text on one line, with unprintable characters escaped as in Python.

    A line break or an escape sequence of a terminal in a name must not reach the screen.
    """
    line = str(text)
    return line if line.isprintable() else repr(line)[1:-1]


def quoted(text: object) -> str:
    """Return foreign text as part of a sentence: a plain word as it is, all else shortened and
    between quotation marks that it cannot close.
    """
    short = _shorten(str(text), _MAX_QUOTED_LENGTH)
    return short if _PLAIN.fullmatch(short) else repr(short)


def shown(value: object) -> str:
    """Return the ``repr`` of a value, or its type if there is none."""
    try:
        return repr(value)
    except ValueError:
        # Python does not write out an int of more than 4300 digits.
        return written_out(value)


def written_out(value: object) -> str:
    """Return a value as text, or its type if there is none."""
    try:
        return str(value)
    except ValueError:
        # As in `shown`.
        return f"{type(value).__name__} that cannot be written out"


def decimal_comma(value: object) -> str:
    """Return a sentence, with a space before it, that says to use a decimal point, if a value is a
    text with a decimal comma; empty otherwise.
    """
    match = _DECIMAL_COMMA.fullmatch(value) if isinstance(value, str) else None
    return f" Use a decimal point: {match[1]}.{match[2]}." if match else ""


def nearest(given: object, known: Iterable[str]) -> str:
    """Return the end of a sentence that names the known name most alike, empty if none is."""
    known_names = [str(name) for name in known]
    matches = difflib.get_close_matches(
        written_out(given), known_names, n=1, cutoff=_MIN_SIMILARITY
    )
    return f"; the nearest is {matches[0]}" if matches else ""


def format_error(error: Exception) -> str:
    """Return an error as a sentence; for any but a `CraneError` with the line that raised it."""
    if isinstance(error, CraneError):
        return str(error)
    *_, frame = traceback.extract_tb(error.__traceback__)
    return (
        f"{type(error).__name__} in {frame.name}, line {frame.lineno} of "
        f"{Path(frame.filename).name}: {error}."
    )


def _shorten(text: str, length: int) -> str:
    """Return a text without its middle if it is longer than a number of characters."""
    return text if len(text) <= length else f"{text[: length // 2]} … {text[-length // 2 :]}"


class CraneError(Exception):
    """Base of every error that cranedyn raises on purpose.

    Its text is one sentence on one line: printable characters, at most some 2000 of them.
    """

    def __init__(self, sentence: str) -> None:
        characters = []
        for character in _shorten(sentence, _MAX_SENTENCE_LENGTH):
            characters.append(character if character.isprintable() else " ")
        super().__init__("".join(characters))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle text and attributes, because each subclass has its own constructor arguments."""
        return _unpickle, (type(self), self.args, self.__dict__)


def _unpickle(kind: type[CraneError], args: tuple[str], values: dict[str, object]) -> CraneError:
    """Return an error from its type, its text and its attributes, without its constructor."""
    error = kind.__new__(kind, *args)
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
        self.name = name
        self.value = value
        self.allowed = allowed
        self.unit = unit
        text = written_out(value)
        limits = allowed
        if unit and _NUMBERS.match(text):
            text = f"{text} {unit}"
        elif unit:
            # A word, such as "none", has no unit; what is allowed has. A reason may follow it after
            # a colon.
            range_text, colon, reason = allowed.partition(":")
            limits = f"{range_text} [{unit}]{colon}{reason}"
        super().__init__(f"{name} is {text}; allowed is {limits}.{decimal_comma(value)}")


class Misshapen(OutOfRange):
    """An array of a wrong shape or kind."""


class UnknownName(CraneError):
    """A name that is not one of those known.

    Attributes:
        given: The name given.
        known: The names there are.
    """

    def __init__(self, kind: str, given: str, known: Iterable[str], advice: str = "") -> None:
        self.given = given
        self.known = tuple(known)
        names = ", ".join(str(name) for name in self.known)
        sentence = (
            f"There is no {kind} {shown(given)}; there are {names}{nearest(given, self.known)}."
        )
        super().__init__(f"{sentence} {advice}" if advice else sentence)


class MissingRole(CraneError):
    """Something made for a tower crane is asked of a crane in which no joint plays a part that it
    needs.

    Attributes:
        role: The part.
        joints: Names of the joints there are.
    """

    def __init__(self, user: str, role: str, joints: Iterable[str]) -> None:
        """Set the attributes and the error message.

        Args:
            user: What needs the part, to begin the sentence with.
            role: The part.
            joints: Names of the joints there are.
        """
        self.role = role
        self.joints = tuple(joints)
        super().__init__(
            f"{user} needs a joint in the role {role}; the joints of this crane are "
            f"{', '.join(self.joints)}."
        )


class UnknownColumn(UnknownName, KeyError):
    """A column that a table does not have; a KeyError, too, where the table serves as a
    mapping.
    """

    # A KeyError shows the repr of its text, in quotation marks.
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
        self.t = t
        self.joint = joint
        self.value = value
        self.trajectory = trajectory
        super().__init__(sentence)
