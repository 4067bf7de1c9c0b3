"""What a worker does: run a study on a chunk of cases and find the bad ones among them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import pyarrow as pa

from cranedyn.errors import CraneError, DataError, shown
from cranedyn.sweep.design import RESERVED
from cranedyn.sweep.sources import digest, sources

Study = Callable[[Mapping[str, np.ndarray]], Mapping[str, np.ndarray]]
"""From the parameters of some cases to their results, columns of shape (n,) each; a function at the
top of a module."""

DIED = "The worker process died on this case, as of a crash in compiled code or for lack of memory."
"""What is said of a case that nobody can compute."""

LATE = "The case took longer than the {:g} s that a case may."
"""What is said of a case whose worker was ended."""


def name_of(study: Study) -> str:
    """Module and name of a study, by which workers import it.

    Raises:
        CraneError: If it has none: it is no function at the top of a module, or one of a script
            that no module is made of.
    """
    module, name = getattr(study, "__module__", None), getattr(study, "__qualname__", "")
    if module == "__main__":
        spec = getattr(sys.modules["__main__"], "__spec__", None)
        module = spec.name if spec else None
    if not (callable(study) and module and name.isidentifier()):
        raise CraneError(
            "A study must be a function at the top of a module that workers can import; "
            f"{shown(study)} is not."
        )
    return f"{module}:{name}"


def load(name: str, code: str = "") -> Study:
    """The study of a name.

    Args:
        name: See `name_of`.
        code: Checksum of its sources that the sweeping program sees, see
            `cranedyn.sweep.sources.digest`; empty if it does not matter.

    Raises:
        CraneError: If it cannot be imported, or has other sources here.
    """
    module, _, function = name.partition(":")
    try:
        study = getattr(importlib.import_module(module), function)
    except Exception as error:
        raise CraneError(
            f"The worker cannot import the study {name}: {_sentence(error)}"
        ) from error
    if code and code != _code_of(name):
        raise CraneError(
            f"A worker has other source files of the study {name}, or of cranedyn, than the "
            "program that sweeps; "
            "give both the same, and start the workers again."
        )
    return study


@cache
def _code_of(name: str) -> str:
    """Checksum of a study as it was imported into this worker, whatever becomes of its files."""
    return digest(sources(name))


def evaluate(name: str, columns: Mapping[str, np.ndarray], code: str = "") -> pa.Table:
    """The results of some cases, a row each, with the column `error`: null, or why all other
    columns are.

    If the study raises or returns what it may not, its cases are halved until the bad one stands
    alone. A case with a number that is not finite is bad, too.

    Raises:
        CraneError: If the study cannot be imported or is another, see `load`, or results are
            numbers here and words there.
    """
    count = len(next(iter(columns.values())))
    return joined(_halved(load(name, code), columns, 0, count))


def failed(count: int, sentence: str) -> pa.Table:
    """Cases without results, and why."""
    return pa.table({"error": pa.array([sentence] * count, pa.string())})


def joined(tables: list[pa.Table]) -> pa.Table:
    """One table below the other; a column that one of them does not have is null there.

    Raises:
        DataError: If a column is of numbers here and of words there.
    """
    try:
        return pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException as error:
        raise DataError(
            f"The study returns results of different kinds: {_sentence(error)}"
        ) from error


def _halved(
    study: Study, columns: Mapping[str, np.ndarray], first: int, last: int
) -> list[pa.Table]:
    part = {name: values[first:last].copy() for name, values in columns.items()}
    try:
        return [_table(study(part), last - first, set(columns))]
    except (Exception, SystemExit) as error:
        if last - first == 1:
            return [failed(1, _sentence(error))]
    middle = (first + last) // 2
    return _halved(study, columns, first, middle) + _halved(study, columns, middle, last)


def _table(found: object, count: int, parameters: set[str]) -> pa.Table:
    if not isinstance(found, Mapping):
        raise DataError(
            f"The study returned {type(found).__name__}; allowed is a mapping of columns."
        )
    errors = np.full(count, None, dtype=object)
    columns = {}
    for name, values in found.items():
        if not isinstance(name, str) or name in parameters or name in RESERVED:
            raise DataError(
                f"The study returned a column {shown(name)}; allowed is any name that no parameter "
                f"has, but not {', '.join(RESERVED)}."
            )
        columns[name] = _column(name, values, count)
        if columns[name].dtype.kind == "f":
            for i in np.flatnonzero(~np.isfinite(columns[name].filled(0.0))):
                errors[i] = errors[i] or f"The result {name} is {columns[name][i]}."
    bad = np.array([error is not None for error in errors])
    arrays = {
        name: pa.array(values.data, mask=np.ma.getmaskarray(values) | bad)
        for name, values in columns.items()
    }
    return pa.table({**arrays, "error": pa.array(errors, pa.string())})


def _column(name: str, given: object, count: int) -> np.ma.MaskedArray:
    values: np.ma.MaskedArray = np.ma.asarray(given)
    if values.shape != (count,):
        raise DataError(
            f"The study returned {name} of shape {values.shape} for {count} cases; allowed is "
            f"({count},)."
        )
    kind = {"f": "f8", "i": "i8", "u": "i8", "b": "?", "U": "U"}.get(values.dtype.kind)
    if kind is None or values.dtype == np.uint64:
        raise DataError(
            f"The study returned {name} of type {values.dtype}; allowed are numbers and words."
        )
    return np.ma.asarray(values.astype(kind))


def _sentence(error: BaseException) -> str:
    words = str(error)
    return str(
        CraneError(
            words
            if isinstance(error, CraneError) and words
            else f"{type(error).__name__}: {words}".rstrip(": ")
        )
    )
