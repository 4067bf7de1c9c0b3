"""Command lines, made from the parsers themselves: every option of every command, with numbers,
names and files that nobody should give.
"""

from __future__ import annotations

import argparse
import importlib
import io
import json
import math
import os
import pkgutil
import re
import shlex
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from PIL import Image

import cranedyn.recording
import cranedyn.recording.snapshot
import cranedyn.simulation.simulate
import experiments
from cranedyn.checks import number
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import read
from cranedyn.interfaces import Monitor, State
from cranedyn.model.description import Argument, arguments
from cranedyn.sweep.study import Task
from cranedyn.sweep.workers import LocalPool
from experiments import harness
from tests.helpers import RESULT
from tests.system.fuzz.core import OURS, Broken, Case, Generator, interrupt_after
from tests.system.fuzz.odd import LETTERS, NUMBERS, SMALL_COUNTS

COMMANDS = ["cranedyn.model.description"]
"""Modules that are run as commands; those of the experiments are found."""

FILES = [
    "good.csv",
    "good.parquet",
    "bad.csv",
    "words.csv",
    "doc.md",
    "real.rrd",
    "other.rrd",
    "folder",
    "pipe",
    "missing/a.csv",
    "new.rrd",
]
FILES += [
    "new",
    "a/b",
    "../up",
    ".",
    "/dev/null",
    "/dev/full",
    "/dev/zero",
    "/dev/urandom",
    "/proc/cranedyn",
    "x" * 300 + ".rrd",
    "ä" * 130,
]
FILES += [
    "\udcff.rrd",
    "\udcff",
    "a\nb.rrd",
    "a\x1b[31m.csv",
    "here.xacro",
    "out",
    "earlier",
    "earlier/result.json",
    "~",
    "-",
    "$(id)",
    "a b",
]
"""Names for whatever wants a file or a folder."""

GOOD_FILES = [
    "good.csv",
    "good.parquet",
    "real.rrd",
    "new.rrd",
    "new",
    "earlier",
    "doc.md",
    "earlier/a.rrd",
]
"""Those among them that are right for something."""

ADDRESSES = [
    "tcp://127.0.0.1:1",
    f"tcp://{'a' * 300}:1",
    "tcp://[::1",
    "tcp://127.0.0.1:99999",
    "tls://127.0.0.1:1",
    "inproc://",
    "tcp://:1",
]
"""Of schedulers that are not there."""

_RUNS = 8
"""Control instants after which a run that is cut off is interrupted."""


@cache
def commands() -> dict[str, Callable[[list[str]], int]]:
    """Every command by its module."""
    names = [
        *COMMANDS,
        *(f"experiments.{module.name}" for module in pkgutil.iter_modules(experiments.__path__)),
    ]
    found = {name: getattr(importlib.import_module(name), "main", None) for name in names}
    return {name: main for name, main in found.items() if main is not None}


class _Caught(BaseException):
    pass


@cache
def grammar(command: str) -> list[argparse.Action]:
    """What a command takes, from its own parser."""
    caught: list[argparse.ArgumentParser] = []

    def catch(parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        caught.append(parser)
        raise _Caught

    with patch.object(argparse.ArgumentParser, "parse_args", catch):
        try:
            commands()[command]([])
        except _Caught:
            pass
    return [action for action in caught[0]._actions if not isinstance(action, argparse._HelpAction)]


@dataclass(frozen=True)
class Line:
    """Lines for one command.

    Runs are interrupted after some control instants or after some processor time, whichever comes
    first, so that of most lines only what happens before and after a run is tried, but of some the
    runs, too.
    """

    command: str
    weight: float
    interruptible: bool = True

    @property
    def name(self) -> str:
        """Of the kind."""
        return f"line {self.command.rpartition('.')[2]}"

    def draw(self, rng: Random) -> Case:
        """Options in any order, most of them with one value of the kind that they take."""
        actions, words = grammar(self.command), _Words(rng)
        parts = [
            words.option(rng.choice(actions)) for _ in range(rng.choice([0, 1, 1, 1, 2, 2, 3, 4]))
        ]
        if rng.random() < 0.9:
            parts += [
                words.values(action)
                for action in actions
                if action.required or not (action.option_strings or action.nargs)
            ]
        if rng.random() < 0.03:
            parts.append(
                (rng.choice(["--no-such", "-x", "--", "extra", "", "\0", "--ou", "--g=1"]),)
            )
        if rng.random() < 0.02 and parts:
            parts.append(rng.choice(parts))
        cut = rng.random() < 0.97
        return Case((cut, rng.uniform(0.5, 2.0)), parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Run it here; see that the exit code, the words and the files are as promised."""
        cut, seconds = case.head
        here = folder / "here"
        _furnish(here)
        before = _tree(folder)
        os.chdir(here)
        with cheap(cut), _streams() as err:
            interrupt_after(seconds)
            try:
                code: object = commands()[self.command](
                    [word for part in case.parts for word in part]
                )
            except SystemExit as exit:
                code = exit.code
        return _judged(code, err(), folder, before, whole=self.command not in COMMANDS)

    def shown(self, case: Case) -> str:
        """As typed into a shell."""
        words = " ".join(_quoted(word) for part in case.parts for word in part)
        return (
            f"python -m {self.command} {words}   # "
            f"{'runs cut off' if case.head[0] else f'Ctrl-C after {case.head[1]:.2f} s'}"
        )


def _quoted(word: str) -> str:
    return (
        shlex.quote(word)
        if word.isprintable()
        else "$'"
        + word.encode(errors="surrogateescape").decode("latin-1").encode("unicode_escape").decode()
        + "'"
    )


class _Words:
    """Words for options, of which a share is odd; with few odd ones a line gets further."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._odd = rng.choice([0.1, 0.5])

    def option(self, action: argparse.Action) -> tuple[str, ...]:
        """An option with its values."""
        rng = self._rng
        if not action.option_strings:
            return self.values(action)
        flag = rng.choice(action.option_strings)
        if rng.random() < 0.03 and len(flag) > 6:
            flag = flag[: rng.randrange(4, len(flag))]
        values = self.values(action)
        if len(values) == 1 and flag.startswith("--") and rng.random() < 0.6:
            return (f"{flag}={values[0]}",)
        return flag, *values

    def values(self, action: argparse.Action) -> tuple[str, ...]:
        """As many as it takes, as a rule."""
        rng = self._rng
        counts: dict[object, int] = {
            None: 1,
            "+": rng.choice([1, 1, 2, 3]),
            "*": rng.choice([0, 1, 1, 2]),
            "?": 1,
        }
        count = counts.get(action.nargs, 1) if not isinstance(action.nargs, int) else action.nargs
        if rng.random() < 0.05 * self._odd:
            count = rng.choice([0, count + 1, 5])
        return tuple(self._value(action) for _ in range(count))

    def _value(self, action: argparse.Action) -> str:
        """Of the kind that it takes, as a rule."""
        rng = self._rng
        shown = (
            action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
        )
        if rng.random() < 0.1 * self._odd:
            return rng.choice(LETTERS)
        if action.choices:
            return str(rng.choice(list(action.choices)))
        if ":=" in shown:
            name = rng.choice(sorted(settings()))
            pair = f"{name}:={self._number(_usual(name))}"
            return (
                pair
                if rng.random() > 0.1 * self._odd
                else rng.choice([name, pair.replace(":=", "="), f":={name}", f"{name}:=", "x:=1"])
            )
        if any(word in shown for word in ("FILE", "DIR", "RECORDING")):
            return rng.choice(FILES) if rng.random() < self._odd else rng.choice(GOOD_FILES)
        if "tcp" in shown:
            return rng.choice(ADDRESSES)
        if action.type is None:
            return rng.choice([*names(), self._number(1.0), rng.choice(FILES)])
        default = (
            action.default[0]
            if isinstance(action.default, list | tuple) and action.default
            else action.default
        )
        if action.type is float:
            return self._number(
                float(default)
                if isinstance(default, float | int) and not isinstance(default, bool)
                else 1.0
            )
        return rng.choice(SMALL_COUNTS) if rng.random() > 0.2 * self._odd else rng.choice(NUMBERS)

    def _number(self, near: float) -> str:
        rng = self._rng
        if rng.random() > self._odd:
            return repr(near * rng.choice([1.0, 0.5, 2.0, 1.0 + 1e-9, 0.999, 10.0, 0.1, 1.1, 1.5]))
        return rng.choice(NUMBERS)


@cache
def settings() -> dict[str, Argument]:
    """The numbers of the crane that can be set."""
    return arguments()


def _usual(name: str) -> float:
    """The default of a number of the crane; 1 where that is another number's."""
    try:
        return float(settings()[name].default)
    except ValueError:
        return 1.0


@cache
def names() -> list[str]:
    """Names that are said where an experiment is asked for."""
    return sorted(name.rpartition(".")[2] for name in commands())


# --- where it runs --------------------------------------------------------------------------------


@cache
def _contents() -> dict[str, bytes]:
    """Files for a command to find, among them results of an earlier run."""
    t = np.arange(0.0, 40.0, 0.02)
    swing = 0.1 * np.cos(t)
    columns = {
        "t_s": t,
        "phi_rad": swing,
        "l_m": 0 * t + 10,
        "gamma_dot_rad_s": 0.01 * np.sin(t),
        "x_m": 0 * t + 20,
        "theta_rad": swing,
    }
    table = pa.table(columns | {"theta_dot_rad_s": -0.1 * np.sin(t)})
    csv, parquet = io.BytesIO(), io.BytesIO()
    pyarrow.csv.write_csv(table, csv)
    pyarrow.parquet.write_table(table, parquet)
    head = (
        b"RRF2"
        + bytes(map(int, cranedyn.recording.viewer.rr.__version__.split(".")[:3]))
        + bytes(100)
    )
    document = "".join(f"# {name}\n\n<!-- {name}: -->\n<!-- end -->\n" for name in names())
    old = {f"{name}.rrd": head for name in names()} | {
        "result.json": json.dumps(RESULT).encode(),
        "a.parquet": parquet.getvalue(),
    }
    return {
        "good.csv": csv.getvalue(),
        "good.parquet": parquet.getvalue(),
        "bad.csv": csv.getvalue()[:999] + b"nan\n",
        "words.csv": b"t_s,phi_rad\na,b\n",
        "real.rrd": head,
        "other.rrd": b"nothing",
        "doc.md": document.encode(),
        "here.xacro": b"<robot/>",
        "folder/a": b"a",
    } | {f"earlier/{name}": content for name, content in old.items()}


def _furnish(here: Path) -> None:
    for name, content in _contents().items():
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_bytes(content)
    os.mkfifo(here / "pipe")


def _tree(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Every file and folder below one: kind, size, time of the last change."""
    found = {}
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            status = os.lstat(path := os.path.join(place, name))
            folder_like = os.path.isdir(path)
            found[path] = (
                (status.st_mode, 0, 0)
                if folder_like
                else (status.st_mode, status.st_size, status.st_mtime_ns)
            )
    return found


@contextmanager
def _streams() -> Iterator[Callable[[], str]]:
    """Streams as a terminal gives them, in UTF-8; yields what tells
    standard error.
    """
    raw = io.BytesIO()
    out = io.TextIOWrapper(io.BytesIO(), "utf-8", "surrogateescape")
    err = io.TextIOWrapper(raw, "utf-8", "backslashreplace")

    def said() -> str:
        err.flush()
        return raw.getvalue().decode(errors="replace")

    with patch.object(sys, "stdout", out), patch.object(sys, "stderr", err):
        yield said


class _Alone:
    """In the place of a pool of processes: does all by itself, at once."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def submit(self, work: Callable[..., Any], *given: Any, **more: Any) -> Future[Any]:
        made: Future[Any] = Future()
        try:
            made.set_result(work(*given, **more))
        except Exception as error:
            made.set_exception(error)
        return made

    def shutdown(self, *_: object, **__: object) -> None:
        pass

    def __enter__(self) -> _Alone:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def _cut_off(*given: Any, monitors: Sequence[Monitor] = (), **more: Any) -> Any:
    """Run `simulate`, interrupted after some control instants."""

    def stop(row: int, t: float, state: State) -> None:
        if row >= _RUNS:
            raise KeyboardInterrupt

    return _SIMULATE(*given, monitors=[*monitors, stop], **more)


_SIMULATE = cranedyn.simulation.simulate.simulate


@contextmanager
def _pictures(
    path: str | Path, times: Sequence[float], size: tuple[int, int], dashboard: bool
) -> Iterator[Iterator[Image.Image]]:
    """In the place of a viewer without a window."""
    cranedyn.recording.viewer.check_recording(path)
    for t in times:
        number("time of a picture", t, "s", "0 to 10")
    yield (Image.new("RGB", size) for _ in times)


class _Inline:
    """In the place of the processes of a sweep."""

    exact, died = True, ""

    def __init__(self, task: Task, *_: object) -> None:
        self._task, self._done = task._replace(limit=math.inf), list[Any]()

    def capacity(self) -> int:
        """One."""
        return 1

    def submit(self, rows: Any, columns: Any) -> None:
        """Compute it."""
        self._done.append((rows, self._task.evaluate(columns)))

    def wait(self) -> list[Any]:
        """All that was computed."""
        done, self._done = self._done, []
        return done

    def close(self) -> None:
        """Nothing is under way."""


class _Served:
    address, data, words = "nowhere", "", "Served nowhere."

    def __enter__(self) -> _Served:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def wait(self) -> None:
        """Nobody looks."""


@cache
def _places(thing: object, modules: int) -> list[tuple[types.ModuleType, str]]:
    """Wherever a module of ours has something under a name."""
    ours = [
        module
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in OURS and isinstance(module, types.ModuleType)
    ]
    return [
        (module, name)
        for module in ours
        for name, value in list(vars(module).items())
        if value is thing
    ]


@contextmanager
def inline_sweeps() -> Iterator[None]:
    """Sweeps compute in this process, which is quicker."""
    with ExitStack() as stack:
        for module, name in _places(LocalPool, len(sys.modules)):
            stack.enter_context(patch.object(module, name, _Inline))
        yield


@contextmanager
def cheap(cut: bool = False) -> Iterator[None]:
    """No process, no port and no window; and no long run, if they are cut off."""
    with ExitStack() as stack:
        for old, new in [*([(_SIMULATE, _cut_off)] if cut else []), (ProcessPoolExecutor, _Alone)]:
            for module, name in _places(old, len(sys.modules)):
                stack.enter_context(patch.object(module, name, new))
        stack.enter_context(inline_sweeps())
        stack.enter_context(patch.object(cranedyn.recording.snapshot, "_pictures", _pictures))
        stack.enter_context(patch.object(cranedyn.recording, "open_viewer", lambda path=None: ""))
        stack.enter_context(
            patch.object(cranedyn.recording, "serve", lambda path=None, port=0: _Served())
        )
        yield


# --- what is promised -----------------------------------------------------------------------------


def _judged(
    code: object, err: str, folder: Path, before: dict[str, tuple[int, int, int]], *, whole: bool
) -> str:
    lines = err.splitlines()
    if code not in (0, 1, 2, 130) or isinstance(code, bool):
        raise Broken("an exit code that is none of 0, 1, 2, 130", f"{code!r} {err}")
    for word in ("Traceback", "Warning:", "Exception ignored"):
        if word in err:
            line = next(line for line in lines if word in line)
            raise Broken(
                f"{word.rstrip(':')} on standard error: {re.sub(r'^.*/', '', line)[:90]}", err
            )
    after = _tree(folder)
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    names = [
        re.sub(r"[0-9]+", "#", os.path.relpath(name, folder / "here"))[:60] for name in changed
    ]
    if code == 2:
        said = [line for line in lines if not line.startswith(("usage: ", " "))]
        if len(said) != 1 or not re.match(r"(python -m [\w.]+: )?error: .", said[0]):
            raise Broken("exit code 2 without one line that begins with error:", err)
        if changed:
            raise Broken("exit code 2, but files are not as before", f"{names} {err}")
    check_whole([name for name in changed if name in after] if whole else [])
    return f"code {code}"


def check_whole(paths: Sequence[str]) -> None:
    """Whatever stands under a name of its own is whole."""
    for name in paths:
        path = Path(name)
        if path.is_dir():
            continue
        if path.name.startswith(".") and path.name != ".lock":
            raise Broken("a draft is left", name)
        match path.suffix:
            case ".json":
                json.loads(path.read_text(), parse_constant=_no)
            case ".parquet":
                for column in pyarrow.parquet.read_table(io.BytesIO(path.read_bytes())).columns:
                    if (
                        pa.types.is_floating(column.type)
                        and not np.isfinite(column.drop_null().to_numpy()).all()
                    ):
                        raise Broken("a number that is not finite in a Parquet file", name)
            case ".png":
                Image.open(path).verify()
            case ".rrd":
                if path.stat().st_size < 1000:
                    raise Broken("a recording without rows", name)


def _no(word: str) -> None:
    raise Broken(f"{word} in a JSON file")


@dataclass(frozen=True)
class Setup:
    """Any numbers for the world of an experiment that is a run of 0.05 s."""

    name: str = "line world"
    weight: float = 0.5
    interruptible: bool = True

    def draw(self, rng: Random) -> Case:
        """Up to three numbers of the crane and one of the world."""

        def value() -> str:
            return repr(
                rng.choice(
                    [
                        rng.choice(_WORLD),
                        rng.uniform(0.1, 10.0),
                        rng.uniform(0.1, 10.0),
                        10.0 ** rng.uniform(-300, 300),
                    ]
                )
            )

        names = rng.sample(sorted(settings()), rng.choice([0, 1, 1, 2, 3]))
        parts = [("--set", f"{name}:={value()}") for name in names]
        return Case(
            None,
            parts
            + [
                (f"--{flag}={value()}",)
                for flag in rng.sample(["gravity", "dt", "control-period"], rng.choice([0, 0, 1]))
            ],
        )

    def attempt(self, case: Case, folder: Path) -> str:
        """A result with whole files, or a sentence."""
        made, out = harness.parser("trial", "A trial."), folder / "out"
        harness.add_setup(made)
        with _streams() as err:
            code = harness.run_experiment(
                made, _trial, ["--out", str(out), *(word for part in case.parts for word in part)]
            )
        if code == 130 and err().startswith("error: Interrupted at "):  # a budget had an end
            return "interrupted"
        if (
            code not in (0, 1, 2)
            or (err() == "") is not (code == 0)
            or not (code == 0 or err().startswith("error: "))
        ):
            raise Broken("a run neither went well nor ended in a sentence", f"{code} {err()}")
        check_whole(found := [str(path) for path in out.rglob("*")] if out.exists() else [])
        for name in found:
            if name.endswith(".parquet") and not len(read(name)):
                raise Broken("a trajectory without rows was kept")
        return f"code {code}"

    def shown(self, case: Case) -> str:
        """As typed."""
        return " ".join(word for part in case.parts for word in part)


_WORLD = (
    0.0,
    1e-300,
    1e-9,
    1e9,
    1e29,
    1e300,
    -1.0,
    5e-324,
    float("nan"),
    float("inf"),
    -0.0,
    1.7976931348623157e308,
)


def _trial(options: object, setup: harness.Setup) -> harness.Outcome:
    run = setup.simulate(
        setup.crane,
        hold_controller(setup.crane),
        None,
        start=setup.crane.start,
        duration=0.05,
        label="",
    )
    return harness.Outcome(
        [
            harness.ResultTable(
                "End", [("q", "g"), ("v", "g")], list(zip(*run.state(-1), strict=True))
            )
        ],
        [],
        {},
        {"run": run},
    )


GENERATORS: list[Generator] = [
    Line(name, 0.1 if name.endswith((".sweep", ".report", ".compare", ".identify")) else 0.3)
    for name in commands()
]
GENERATORS.append(Setup())
