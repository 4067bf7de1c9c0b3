"""Studies: functions that compute results of cases, their sources, and what workers run of them."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from cranedyn.data.files import digest
from cranedyn.data.tables import arrow
from cranedyn.errors import CraneError, DataError, shown
from cranedyn.sweep.design import RESERVED

_ROOT = Path(__file__).resolve().parents[2]
"""Folder that holds the package cranedyn; in a checkout also its descriptions of cranes."""

Study = Callable[[Mapping[str, np.ndarray]], Mapping[str, np.ndarray]]
"""Function at the top of a module: from the parameters of n cases to their results, columns of
shape (n,) each."""

DIED = "The worker process died on this case, as of a crash in compiled code or for lack of memory."
"""Error of a case that kills the process that computes it."""

LATE = "The case took longer than the {:g} s that a case may."
"""Error of a case whose process was ended at the time limit."""


class CaseRange(NamedTuple):
    """Cases that stand one below the other in a design.

    Attributes:
        first: Number of the first case.
        last: Number of the case after the last one.
    """

    first: int
    last: int

    @property
    def size(self) -> int:
        """Number of cases."""
        return self.last - self.first

    def halves(self) -> list[CaseRange]:
        """Return the first half of two cases or more, and the second."""
        middle = (self.first + self.last) // 2
        return [CaseRange(self.first, middle), CaseRange(middle, self.last)]


def study_name(study: Study) -> str:
    """Return ``module:function``, by which workers import a study.

    Raises:
        CraneError: If it is no function at the top of a module, or one of a script that cannot be
            imported.
    """
    module = getattr(study, "__module__", None)
    name = getattr(study, "__qualname__", "")
    if module == "__main__":  # started by python -m, the module has another name for workers
        spec = getattr(sys.modules["__main__"], "__spec__", None)
        module = spec.name if spec else None
    if not (callable(study) and module and name.isidentifier()):
        raise CraneError(
            "A study must be a function at the top of a module that workers can import; "
            f"{shown(study)} is not."
        )
    return f"{module}:{name}"


def source_digests(study: str) -> dict[str, str]:
    """Return the SHA-256 of each source file that a study is computed by.

    These are all Python files of the study's top package, or the one file of a module in no
    package, and all of cranedyn with its descriptions of cranes. Other packages are left out.

    Returns:
        By file name below the folder that it is imported from; sorted.

    Raises:
        DataError: If a file cannot be read.
    """
    package = study.partition(":")[0].partition(".")[0]
    try:
        files = dict(_source_files(package))
        files.update(_source_files("cranedyn"))
        return {name: digest(path) for name, path in sorted(files.items())}
    except OSError as error:
        raise DataError(
            f"Cannot read {error.filename}, which the study may be made of: {error.strerror}."
        ) from error


def code_digest(digests: Mapping[str, str]) -> str:
    """Return one digest of all source files."""
    lines = "".join(f"{checksum} {name}\n" for name, checksum in digests.items())
    return hashlib.sha256(lines.encode()).hexdigest()


def _source_files(package: str) -> Iterator[tuple[str, Path]]:
    """Yield the source files of a package or module, each with its name below the folder that it is
    imported from.
    """
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return
    folders = {folder: package for folder in spec.submodule_search_locations or ()}
    if package == "cranedyn" and (_ROOT / "urdf").is_dir():
        folders[str(_ROOT / "urdf")] = "cranedyn/urdf"  # inside the package once installed
    for folder, name in folders.items():
        for path in Path(folder).rglob("*"):
            if path.suffix in (".py", ".xacro") and path.is_file():
                yield f"{name}/{path.relative_to(folder).as_posix()}", path
    if not folders and spec.origin and spec.origin.endswith(".py"):
        yield f"{package}.py", Path(spec.origin)


class Task(NamedTuple):
    """Study as a worker runs it.

    Attributes:
        study: See `study_name`.
        code: Digest of the sources that the sweeping program has, see `code_digest`; empty if they
            do not matter.
        limit: Time that a case may take [s]; n cases may take n times as long.
    """

    study: str
    code: str = ""
    limit: float = math.inf

    def load(self) -> Study:
        """Import the study.

        Raises:
            CraneError: If it cannot be imported, or has other sources here.
        """
        arrow()  # which takes a moment to import, before the time of a case counts
        module, _, function = self.study.partition(":")
        try:
            study = getattr(importlib.import_module(module), function)
        except Exception as error:
            raise CraneError(
                f"The worker cannot import the study {self.study}: {_message(error)}"
            ) from error
        if self.code and self.code != _imported_code(self.study):
            raise CraneError(
                f"A worker has other source files of the study {self.study}, or of cranedyn, than "
                "the program that sweeps; give both the same, and start the workers again."
            )
        return study

    def evaluate(self, columns: Mapping[str, np.ndarray]) -> pa.Table:
        """Run the study on some cases; this process ends if that takes longer than it may.

        If the study raises or returns what it may not, the cases are halved until the bad one
        stands alone. A case with a result that is not finite is bad, too.

        Args:
            columns: Parameters of the cases, shape (n,) each.

        Returns:
            Results, a row per case, and the column `error`: null, or why all others are null.

        Raises:
            CraneError: As `load`, or if a result is a number in one case and a word in another.
        """
        study = self.load()
        count = len(next(iter(columns.values())))
        with _alarm(count * self.limit):
            return concatenate(_evaluate(study, columns, 0, count))


def failure(message: str) -> pa.Table:
    """Return the table of a case that has an error and no results."""
    return pa.table({"error": pa.array([message], pa.string())})


def concatenate(tables: list[pa.Table]) -> pa.Table:
    """Return one table below the other, `error` last; columns that one lacks are null there.

    Raises:
        DataError: If a column is of numbers in one table and of words in another.
    """
    try:
        table = pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException as error:
        raise DataError(
            f"The study returns results of different kinds: {_message(error)}"
        ) from error
    names = [name for name in table.column_names if name != "error"]
    if "error" in table.column_names:
        names.append("error")
    return table.select(names)


@cache
def _imported_code(name: str) -> str:
    """Return the digest of the sources when this process imported them, whatever they are now."""
    return code_digest(source_digests(name))


def _evaluate(
    study: Study, columns: Mapping[str, np.ndarray], first: int, last: int
) -> list[pa.Table]:
    """Return the results of the cases from `first` up to, not including, `last`.

    Returns:
        Tables to be put one below the other. A case on which the study raises stands alone in one.
    """
    # Copies, so that a study that writes into its parameters does no harm to a second try.
    cases = {name: values[first:last].copy() for name, values in columns.items()}
    try:
        return [_table(study(cases), last - first, columns)]
    except (Exception, SystemExit) as error:  # a study that calls sys.exit is no reason to end
        if last - first == 1:
            return [failure(_message(error))]
    middle = (first + last) // 2
    return [
        *_evaluate(study, columns, first, middle),
        *_evaluate(study, columns, middle, last),
    ]


def _table(results: Mapping[str, np.ndarray], count: int, parameters: Collection[str]) -> pa.Table:
    """Return the results of some cases as a table with the column `error`.

    A result that is not finite makes all results of its case null, and is its error.

    Args:
        results: What the study returned.
        count: Number of cases.
        parameters: Names that no result may have.

    Raises:
        DataError: If a result has another shape or type, or the name of a parameter.
    """
    columns = {}
    errors = np.full(count, None, dtype=object)
    for name, values in results.items():
        column = np.ma.asarray(values)
        columns[name] = column
        if column.shape != (count,) or column.dtype.kind not in "fiubU":
            raise DataError(
                f"The study returned {name} of shape {column.shape} and type {column.dtype}; "
                f"allowed are numbers or words of shape ({count},)."
            )
        if name in parameters or name in RESERVED:
            raise DataError(f"The study returned a column {name}, which another column is called.")
        if column.dtype.kind == "f":
            # A masked result is null and no error, whatever number is under the mask.
            for i in np.flatnonzero(~np.isfinite(column.filled(0.0))):
                if errors[i] is None:  # the first result that is not finite is told
                    errors[i] = f"The result {name} is {column[i]}."
    is_bad = np.array([error is not None for error in errors])
    arrays = {}
    for name, column in columns.items():
        arrays[name] = pa.array(column.data, mask=np.ma.getmaskarray(column) | is_bad)
    return pa.table({**arrays, "error": pa.array(errors, pa.string())})


def _message(error: BaseException) -> str:
    """Return the message of an error in one printable line, with its type unless it is ours."""
    message = str(error)
    if not (isinstance(error, CraneError) and message):
        message = f"{type(error).__name__}: {message}".rstrip(": ")
    return str(CraneError(message))  # which makes one printable line of it


_deadlines: dict[object, float] = {}
"""Times of the monotonic clock by which threads must be done [s], by a key for each thread."""

_deadlines_lock = threading.Lock()
"""Held while a deadline and the timer are changed, which belong together."""


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    """End this process unless the context ends within so many seconds.

    No executor does that: the timeout of `Future.result` ends the wait and not the call, `cancel`
    has no effect on a call that runs, and Dask has no limit of time for a task. A handler of a
    signal in Python, or another thread, would not run either while native code keeps Python's lock.
    So SIGALRM keeps its default action, which ends the process whatever it does.

    There is one such timer in a process, ITIMER_REAL. The threads of a Dask worker share it.
    """
    if seconds == math.inf:
        yield
        return
    key = object()
    _set_deadline(key, time.monotonic() + seconds)
    try:
        yield
    finally:
        _set_deadline(key, math.inf)


def _set_deadline(key: object, deadline: float) -> None:
    """Set the deadline of a thread, and the timer to the earliest deadline of all threads.

    Args:
        key: Stands for the thread.
        deadline: Time of the monotonic clock [s]; infinite to remove the deadline.
    """
    with _deadlines_lock:
        if deadline == math.inf:
            _deadlines.pop(key, None)
        else:
            _deadlines[key] = deadline
        remaining = min(_deadlines.values(), default=math.inf) - time.monotonic()
        # Zero would stop the timer, which it does where there is no deadline. A deadline that has
        # passed already rings at once.
        seconds = 0.0 if remaining == math.inf else max(remaining, 1e-3)
        signal.setitimer(signal.ITIMER_REAL, seconds)
