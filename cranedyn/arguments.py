"""Arguments held against the annotations of whoever takes them, so that a wrong one is a sentence
and not an error from somewhere inside.

`checked` sees to kinds: a number, an array, a crane, a callable of three arguments. Ranges and
shapes are for the function itself to check.
"""

from __future__ import annotations

import collections.abc
import inspect
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, wraps
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    Protocol,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    runtime_checkable,
)

import numpy as np

from cranedyn.arrays import DOUBLE, masked
from cranedyn.errors import CraneError, OutOfRange, written_out

_Any = TypeVar("_Any", bound=Callable[..., Any])

_PLAIN = (str, bytes, int, float, complex, NoneType, list, tuple, dict, set)
_LONGEST = 100

_WORDS = {
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "a text",
    NoneType: "None",
    np.ndarray: "an array of numbers",
    Path: "a pathlib.Path",  # which Python 3.13 defines in a module of another name
    collections.abc.Mapping: "a mapping, such as a dict",
    np.random.Generator: "a np.random.Generator, such as np.random.default_rng(1)",
}


@runtime_checkable
class OfCrane(Protocol):
    """What belongs to cranes of some layout."""

    def check_fits(self, name: str, layout: Any) -> None:
        """Return if it is of such a crane.

        Args:
            name: Which argument it is, for the sentence.
            layout: Of the crane, see `cranedyn.model.layout.Layout`.

        Raises:
            OutOfRange: If it is not.
        """


def checked(taker: _Any) -> _Any:
    """Have the arguments of a function, or those that a class is made with, held against their
    annotations at every call.

    Numbers arrive as floats and arrays as arrays of floats, also where any name may be given one
    (``**numbers: float``). A callable must take as many arguments as its annotation says. A class
    can say itself what may stand for it, by a class method ``checked(name, value)``.

    What is of one kind of crane only, as states and motions are, is held against the argument named
    ``crane``, see `OfCrane`.

    The function then raises:
        OutOfRange: If an argument is of another kind, or of another crane.
    """
    if isinstance(taker, type):
        taker.__init__ = checked(taker.__init__)  # type: ignore[misc]
        return taker
    signature = inspect.signature(taker)
    kinds = cache(lambda: get_type_hints(taker))
    by_name = next(
        (name for name, one in signature.parameters.items() if one.kind is one.VAR_KEYWORD), ""
    )
    right = set[tuple[Any, ...]]()

    @wraps(taker)
    def taking(*args: Any, **named: Any) -> Any:
        # Integrators ask equations many times with numbers and arrays of doubles, of which the
        # first ones tell.
        axes = [*map(_axes, args), *map(_axes, named.values())]
        asked = (*named, *axes)
        if asked in right:
            return taker(*args, **named)
        try:
            given = signature.bind(*args, **named)
        except TypeError:  # one is missing or unknown, which Python says best
            return taker(*args, **named)
        as_given = None not in axes
        parts = [
            (given.arguments, name, name)
            for name in given.arguments.keys() & kinds().keys() - {by_name}
        ]
        parts += [
            (given.arguments[by_name], name, by_name) for name in given.arguments.get(by_name, ())
        ]
        for holder, name, parameter in parts:
            value = holder[name]
            holder[name] = taken(name, value, kinds()[parameter])
            as_given &= holder[name] is value
        if as_given:
            right.add(asked)
        if (layout := getattr(given.arguments.get("crane"), "layout", None)) is not None:
            for name, value in given.arguments.items():
                if hasattr(type(value), "check_fits"):
                    value.check_fits(name, layout)
        return taker(*given.args, **given.kwargs)

    return taking  # type: ignore[return-value]


def _axes(value: Any) -> int | None:
    """How many axes a number or an array of doubles has; None for anything else."""
    if type(value) is float:
        return 0
    return value.ndim or None if type(value) is np.ndarray and value.dtype is DOUBLE else None


def taken(name: str, value: Any, kind: Any) -> Any:
    """A value as what an annotation asks for.

    Raises:
        OutOfRange: If it is of another kind.
    """
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    if (value is None and NoneType in kinds) or (type(value) is float and float in kinds):
        return value
    able = [one for one in kinds if one is not NoneType]
    if len(able) == 1 and hasattr(able[0], "checked"):
        return able[0].checked(name, value)
    for one in able:
        with suppress(Exception):  # whatever a stranger's conversion raises
            return _as(value, one)
    raise OutOfRange(name, described(value), " or ".join(map(_words, kinds)))


def described(value: Any) -> str:
    """A value in a few words: itself if it is plain and short, else what it is."""
    if masked(value):
        return f"an array of shape {value.shape} with masked numbers"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, _PLAIN) and type(value).__repr__ is not object.__repr__:
        try:
            text = repr(value)
        except Exception:  # a number of thousands of digits, or whatever a stranger's repr does
            text = ""
        if 0 < len(text) <= _LONGEST:
            return text
    name = getattr(value, "__name__", None)
    if isinstance(name, str):
        return f"{'the class' if isinstance(value, type) else 'the function'} {name}"
    kind = type(value).__name__
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def told(error: Exception) -> str:
    """An error as a sentence; one that is not ours, which a caller's own function may raise, with
    the place where it was raised.
    """
    if isinstance(error, CraneError):
        return str(error)
    *_, place = traceback.extract_tb(error.__traceback__)
    return (
        f"{type(error).__name__} in {place.name}, line {place.lineno} of "
        f"{Path(place.filename).name}: {written_out(error)}."
    )


def check_word(name: str, value: str, kind: Any) -> None:
    """Return if a word is one of those that a Literal allows.

    Raises:
        OutOfRange: If it is none.
    """
    if value not in get_args(kind):
        raise OutOfRange(name, value, " or ".join(get_args(kind)))


def _as(value: Any, kind: Any) -> Any:
    """The value as one kind; an error if it is of another."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is collections.abc.Callable:
        return _callable(value, inner[0])
    if origin is collections.abc.Sequence:
        return _sequence(value, inner[0])
    if origin is tuple:
        return _tuple(value, inner)
    if isinstance(origin, type) and not isinstance(value, origin):
        raise TypeError
    if kind is float:
        return _float(value)
    if kind is np.ndarray:
        return _array(value)
    if not _is(value, kind):
        raise TypeError
    return value


def _is(value: Any, kind: Any) -> bool:
    if get_origin(kind) is Literal:
        # Which words, whoever takes them says better: often one goes with another only.
        return isinstance(value, str)
    if kind is int:
        # `whole` says what is wrong with 2.5.
        return isinstance(value, Real) and not isinstance(value, bool)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    return not isinstance(kind, type) or isinstance(value, kind)


def _float(value: Any) -> float:
    if isinstance(value, str | bytes | bytearray | bool) or np.ndim(value) or masked(value):
        raise TypeError
    return float(value)


def _array(value: Any) -> np.ndarray:
    array = np.asarray(value)
    if value is None or masked(value) or array.dtype.kind not in "fiuO":
        raise TypeError
    return array.astype(float, copy=False)


def _sequence(value: Any, kind: Any) -> Any:
    numbers = kind is float or get_origin(kind) is collections.abc.Sequence
    if isinstance(value, str | bytes) or not isinstance(
        value, Sequence | np.ndarray if numbers else Sequence
    ):
        raise TypeError
    if kind is float:
        return tuple(map(_float, value))
    if get_origin(kind) is collections.abc.Callable:
        for one in {id(one): one for one in value}.values():
            _callable(one, get_args(kind)[0])
    if get_origin(kind) is collections.abc.Sequence:
        return [_sequence(one, get_args(kind)[0]) for one in value]
    if isinstance(kind, type) and not all(isinstance(one, kind) for one in value):
        raise TypeError
    return value


def _tuple(value: Any, kinds: Any) -> tuple[Any, ...]:
    if isinstance(value, str | bytes) or not isinstance(value, Sequence | np.ndarray):
        raise TypeError
    each = kinds[:1] * len(value) if kinds[-1] is Ellipsis else kinds
    return tuple(_as(one, kind) for one, kind in zip(value, each, strict=True))


def _callable(value: Any, arguments: Any) -> Any:
    if not callable(value):
        raise TypeError
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # one written in C that does not say
        return value
    if arguments is not Ellipsis:
        signature.bind(*arguments)
    return value


def _words(kind: Any) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(map(str, inner))
    if origin is collections.abc.Sequence:
        return (
            "a sequence of numbers" if inner[0] is float else f"a sequence, each {_words(inner[0])}"
        )
    if origin is collections.abc.Callable:
        names = (
            ""
            if inner[0] is Ellipsis
            else f" of {len(inner[0])}: "
            f"{', '.join(getattr(one, '__name__', str(one)) for one in inner[0])}"
        )
        return f"a callable{names}"
    if origin is tuple and inner[-1] is Ellipsis:
        return f"a sequence, each {_words(inner[0])}"
    if origin is tuple:
        return f"{len(inner)} of {' and '.join(sorted(set(map(_words, inner))))}"
    kind = origin or kind
    return _WORDS.get(kind) or f"a {kind.__module__}.{kind.__qualname__}"
