"""Command lines, made from the parsers themselves: every option of every command, with numbers,
names and files that nobody should give.
"""

from __future__ import annotations

import argparse
import importlib
import io
import json
import os
import pkgutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

import experiments
from cranedyn import __main__ as cli
from cranedyn import recording
from cranedyn.command import command as command_line
from cranedyn.controllers import hold_controller
from cranedyn.data.files import parse_json
from cranedyn.data.trajectory import read
from cranedyn.model import description
from cranedyn.simulation.log import Log
from experiments import harness
from tests.helpers import RESULT
from tests.system.fuzz.core import LETTERS, NUMBERS, Broken, Generator, check_line, interrupt_after

FILES = [
    *("good.csv", "good.parquet", "bad.csv", "words.csv", "doc.md", "real.rrd", "folder", "pipe"),
    *("missing/a.csv", "new.rrd", "new", "a/b", "../up", ".", "/dev/null", "/dev/full", "-", "~"),
    *("/dev/zero", "/proc/cranedyn", "x" * 300 + ".rrd", "ä" * 130, "\udcff.rrd", "a\nb.rrd"),
    *("a\x1b[31m.csv", "here.xacro", "out", "earlier", "earlier/result.json", "$(id)", "a b"),
]
"""Names for whatever wants a file or a folder."""

GOOD_FILES = "good.csv good.parquet real.rrd new.rrd new earlier doc.md earlier/a.parquet".split()
"""Names that are right for something."""

STARTERS = (
    "cranedyn.sweep.running.LocalPool",
    "experiments.harness.processes.ProcessPoolExecutor",
    "cranedyn.recording.snapshot._pictures",
    "experiments.report._run",
    "cranedyn.recording.serve",
    "cranedyn.recording.open_viewer",
    "cranedyn.interop.commissioning.serve.servers",
    "os.sched_setscheduler",
)
"""Whatever starts another process; a command that comes there is interrupted."""

_ROWS = 8
"""Rows after which most runs are interrupted."""


@cache
def commands() -> dict[str, Callable[[list[str]], int]]:
    """Return every command by its module."""
    names = [f"experiments.{module.name}" for module in pkgutil.iter_modules(experiments.__path__)]
    modules = [importlib.import_module(name) for name in names]
    mains = {module.__name__: module.main for module in modules if hasattr(module, "main")}
    mains |= {f"cranedyn.{name}": partial(_command, name) for name in ("describe", "serve")}
    return mains | {"experiments.trial": _trial}


def _command(name: str, argv: list[str]) -> int:
    parser = cli._Parser(prog=name)
    cli.COMMANDS[name](parser)

    def run() -> int:
        options = parser.parse_args(argv)
        return int(options.run(options))

    return command_line(run)


def _trial(argv: list[str]) -> int:
    """Run a short experiment in any setup, as the command of one."""
    parser = harness.parser("trial", "A trial.")
    harness.add_setup(parser)
    return harness.run_experiment(parser, _experiment, argv)


def _experiment(options: object, setup: harness.Setup) -> harness.Outcome:
    law = hold_controller(setup.crane)
    start = setup.crane.start
    run = setup.simulate(setup.crane, law, None, start=start, duration=0.03, label="")
    rows = list(zip(*run.state(-1), strict=True))
    table = harness.ResultTable("End", [("q", "g"), ("v", "g")], rows)
    return harness.Outcome([table], [], {}, {"run": run})


arguments = cache(description.arguments)


class _Caught(BaseException):
    pass


@cache
def grammar(command: str) -> list[argparse.Action]:
    """Return the arguments of a command, from its own parser."""
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


# --- words ----------------------------------------------------------------------------------------


def draw(command: str, rng: Random) -> tuple[bool, float, list[str]]:
    """Return whether runs are cut off, the time for all [s], and the words: options in any order,
    most of them with values of the kind that they take.
    """
    actions = grammar(command)
    odd = rng.choice([0.1, 0.5])
    chosen = rng.choices(actions, k=rng.choice([0, 1, 1, 1, 2, 2, 3, 4])) if actions else []
    if rng.random() < 0.9:
        chosen += [one for one in actions if one.required or not (one.option_strings or one.nargs)]
    words: list[str] = []
    for action in chosen:
        words += [rng.choice(action.option_strings)] if action.option_strings else []
        words += [_value(action, rng, odd) for _ in range(_count(action, rng))]
    if rng.random() < 0.03:
        words.append(rng.choice(["--no-such", "-x", "--", "extra", "", "\0", "--ou", "--g=1"]))
    return rng.random() < 0.97, rng.uniform(0.2, 1.2), words


def _count(action: argparse.Action, rng: Random) -> int:
    if rng.random() < 0.02:
        return rng.choice([0, 2, 5])
    if isinstance(action.nargs, int):
        return action.nargs
    return rng.choice([1, 1, 2, 3]) if action.nargs == "+" else 1


def _value(action: argparse.Action, rng: Random, odd: float) -> str:
    """Return a value of the kind that an option takes, as a rule."""
    metavar = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
    if rng.random() < 0.1 * odd:
        return rng.choice(LETTERS)
    if action.choices:
        return str(rng.choice(list(action.choices)))
    if ":=" in metavar:
        name = rng.choice(sorted(arguments()))
        return f"{name}:={_number(arguments()[name].default, rng, odd)}"
    if any(word in metavar for word in ("FILE", "DIR", "RECORDING")):
        return rng.choice(FILES if rng.random() < odd else GOOD_FILES)
    if action.type is None:
        return rng.choice([*_names(), _number(1.0, rng, odd), rng.choice(FILES)])
    if action.type is int:
        return rng.choice(["1", "2", "0", "-1", "3", "1.0", "99999999999999", "1e3", ""])
    default = action.default if isinstance(action.default, float | int) else 1.0
    return _number(default, rng, odd)


def _number(near: object, rng: Random, odd: float) -> str:
    try:
        usual = float(near)  # type: ignore[arg-type]
    except ValueError:  # a default that is another argument's
        usual = 1.0
    if rng.random() < odd:
        return rng.choice(NUMBERS)
    return repr(usual * rng.choice([1.0, 0.5, 2.0, 1.0 + 1e-9, 0.999, 10.0, 0.1, 1.1, 1.5]))


def _names() -> list[str]:
    return sorted(name.rpartition(".")[2] for name in commands())


# --- where it runs --------------------------------------------------------------------------------


@cache
def _contents() -> dict[str, bytes]:
    """Return files for a command to find, among them results of an earlier run."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {name: 0.1 * np.cos(t) for name in ("phi_rad", "theta_rad", "theta_dot_rad_s")}
    columns |= {"l_m": 0.0 * t + 10.0, "x_m": 0.0 * t + 20.0, "gamma_dot_rad_s": 0.01 * np.sin(t)}
    table = pa.table({"t_s": t} | columns)
    csv = io.BytesIO()
    parquet = io.BytesIO()
    pyarrow.csv.write_csv(table, csv)
    pyarrow.parquet.write_table(table, parquet)
    version = map(int, recording.viewer.rr.__version__.split(".")[:3])
    document = "".join(f"# {name}\n\n<!-- {name}: -->\n<!-- end -->\n" for name in _names())
    return {
        "good.csv": csv.getvalue(),
        "good.parquet": parquet.getvalue(),
        "bad.csv": csv.getvalue()[:999] + b"nan\n",
        "words.csv": b"t_s,phi_rad\na,b\n",
        "real.rrd": b"RRF2" + bytes(version) + bytes(100),
        "doc.md": document.encode(),
        "here.xacro": b"<robot/>",
        "folder/a": b"a",
        "earlier/result.json": json.dumps(RESULT).encode(),
        "earlier/a.parquet": parquet.getvalue(),
    }


def _tree(folder: Path) -> dict[Path, tuple[int, int, int]]:
    """Return mode, size and time of the last change of everything below a folder."""
    tree = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        is_folder = path.is_dir()
        times = (0, 0) if is_folder else (status.st_size, status.st_mtime_ns)
        tree[path] = (status.st_mode, *times)
    return tree


@contextmanager
def _interrupted(cut: bool) -> Iterator[None]:
    """Interrupt whoever starts a process, and runs after some rows if they are cut."""
    with ExitStack() as stack:
        for name in STARTERS:
            stack.enter_context(patch(name, side_effect=KeyboardInterrupt))
        for name in ("append", "extend_to") if cut else ():
            stack.enter_context(patch.object(Log, name, _cut(getattr(Log, name))))
        yield


def _cut(write: Callable[..., Any]) -> Callable[..., Any]:
    def cut(log: Log, *row: Any, **options: Any) -> Any:
        written = write(log, *row, **options)
        if len(log) >= _ROWS:
            raise KeyboardInterrupt
        return written

    return cut


@contextmanager
def _streams() -> Iterator[Callable[[], str]]:
    """Give streams as a terminal's, in UTF-8; yield what returns standard error."""
    out = io.TextIOWrapper(io.BytesIO(), "utf-8", "surrogateescape")
    err = io.TextIOWrapper(raw := io.BytesIO(), "utf-8", "backslashreplace")

    def text() -> str:
        err.flush()
        return raw.getvalue().decode(errors="replace")

    with redirect_stdout(out), redirect_stderr(err):
        yield text


def attempt(command: str, case: tuple[bool, float, list[str]], folder: Path) -> str:
    """Run a line; see that the exit code, the words and the files are as promised."""
    cut, seconds, words = case
    here = folder / "here"
    for name, content in _contents().items():
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_bytes(content)
    os.mkfifo(here / "pipe")
    before = _tree(folder)
    os.chdir(here)
    with _interrupted(cut), _streams() as err:
        interrupt_after(seconds)
        try:
            code = commands()[command](words)
        except SystemExit as stop:
            code = stop.code  # type: ignore[assignment]
    after = _tree(folder)
    changed = [path for path in {*before, *after} if before.get(path) != after.get(path)]
    check_line(code, err())
    if code not in (0, 1, 2, 130):
        raise Broken("an exit code that is none of 0, 1, 2, 130", f"{code!r} {err()}")
    if any(word in err() for word in ("Traceback", "Warning:", "Exception ignored")):
        raise Broken("a traceback or a warning", err())
    if code == 2 and changed:
        raise Broken("exit code 2, but files are not as before", f"{changed} {err()}")
    if command.startswith("experiments"):
        check_whole([path for path in changed if path in after])
    return f"code {code}"


def _has_finite_rows(path: Path) -> bool:
    """Return whether a trajectory has rows, all of finite coordinates; one of several cranes is a
    table with the columns of each.
    """
    if "site" in path.parent.name:
        table = pyarrow.parquet.read_table(path)
        positions = [name for name in table.column_names if name.endswith(("_rad", "_m"))]
        finite = all(np.isfinite(table[name].to_numpy()).all() for name in positions)
        return bool(positions) and table.num_rows > 0 and finite
    run = read(path)
    return len(run) > 0 and bool(np.isfinite(run.q).all())


def check_whole(paths: list[Path]) -> None:
    """Return if all files are whole and without numbers that are not finite; else raise
    `Broken`.
    """
    for path in paths:
        if path.name.startswith(".") and path.name != ".lock":
            raise Broken("a draft is left", path)
        if path.suffix == ".json":
            parse_json(path.read_text())
        if path.suffix == ".parquet" and not _has_finite_rows(path):
            raise Broken("a trajectory without rows, or not finite, was kept", path)
        if path.suffix == ".rrd" and path.stat().st_size < 1000:
            raise Broken("a recording without rows", path)


GENERATORS = [
    Generator(
        f"line {name.rpartition('.')[2]}", partial(draw, name), partial(attempt, name), long=True
    )
    for name in commands()
]
