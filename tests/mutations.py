"""Break the physics, one thing at a time, and see that the tests notice: ``python -m
tests.mutations``.

The mutations are listed in ``mutations.toml``. Each is made in a copy of the project; its test runs
there, in a process forked from this one, and must fail. The table printed has its processor time.
Exit code 1 if a mutation survives.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import hypothesis
import pytest
from hypothesis import Phase

from tests.objects import FOLDER

ROOT = Path(__file__).parent.parent

MUTATIONS = Path(__file__).with_suffix(".toml")

# As in the tests, before anything imports NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SHARED = (
    "asyncua",
    "casadi",
    "llvmlite.binding",
    "matplotlib.figure",
    "mujoco",
    "pandas",
    "pinocchio",
    "pyarrow.dataset",
    "rich.progress",
    "scipy.integrate",
    "scipy.signal",
    "toppra",
    "trimesh",
    "xacro",
    "yourdfpy",
)
"""Modules imported once for all tests: slow, never mutated, and without threads, which a forked
process would miss.
"""

LIMIT = 600.0
"""Longest time that a test may take [s]; the slowest takes a few seconds of processor time."""

NOT_COPIED = (".git", ".venv", "out", ".*cache", "*.egg-info")


@dataclass(frozen=True)
class Mutation:
    """One entry of ``mutations.toml``."""

    file: str
    """The file to change, relative to the root of the repository."""

    test: str
    """Identifier, as pytest prints it, of the test that must fail."""

    breaks: str
    """What the mutation breaks, in one sentence."""

    before: str
    """The code to replace, which the file must hold exactly once."""

    after: str
    """The code that replaces it."""


@dataclass(frozen=True)
class Trial:
    """A mutation whose test is running."""

    mutation: Mutation

    copy: Path
    """The copy of the project in which the mutation is made."""

    source: str
    """The text of the file before the mutation."""

    begin: float
    """When the test was started, on the monotonic clock [s]."""


def read_mutations(path: Path = MUTATIONS) -> list[Mutation]:
    """Read the mutations of a TOML file."""
    with path.open("rb") as file:
        entries = tomllib.load(file)["mutation"]
    return [Mutation(**entry) for entry in entries]


def mutated(text: str, mutation: Mutation) -> str:
    """Return the text of a file with a mutation made in it.

    Raises:
        SystemExit: If the text does not hold the code to replace exactly once.
    """
    count = text.count(mutation.before)
    if count != 1:
        raise SystemExit(
            f"{mutation.file} must hold the code {mutation.before!r} exactly once and holds it "
            f"{count} times. Update this entry of tests/mutations.toml: {mutation.breaks}"
        )
    return text.replace(mutation.before, mutation.after)


def check_test_exists(mutation: Mutation, root: Path) -> None:
    """Check that the file of a mutation's test defines that test.

    Raises:
        SystemExit: If it does not.
    """
    file, name = mutation.test.split("::", 1)
    path = root / file
    function = name.split("[")[0]
    if not path.exists() or f"\ndef {function}(" not in path.read_text("utf-8"):
        raise SystemExit(
            f"{file} does not define the test {function}. Update this entry of "
            f"tests/mutations.toml: {mutation.breaks}"
        )


def write_source(path: Path, text: str) -> None:
    """Write a source file and remove its outdated bytecode."""
    path.write_text(text, encoding="utf-8")
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def fork_test(test: str, copy: Path) -> int:
    """Run a test of a copy in a forked process, with its output in the copy's file "output".

    Returns:
        The process id.
    """
    process = os.fork()
    if process:
        return process
    status = -1
    try:
        output = os.open(copy / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        os.chdir(copy)
        os.environ["PYTHONPATH"] = str(copy)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        sys.path.insert(0, str(copy))
        # These modules are those of the original; the tests import those of the copy.
        for name in [*sys.modules]:
            if name.partition(".")[0] == "tests":
                del sys.modules[name]
        options = ["-p", "no:cacheprovider", f"--basetemp={copy / 'temporary'}", "-o", "addopts="]
        status = pytest.main(["-q", "-x", *options, str(copy / test)])
        sys.stdout.flush()
    finally:
        # Exit handlers belong to the parent process.
        os._exit(status)


def start(mutation: Mutation, copy: Path) -> tuple[int, Trial]:
    """Make a mutation in a copy of the project, and start its test there.

    Returns:
        The process id of the test, and what to undo afterwards.
    """
    if not copy.exists():
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
    path = copy / mutation.file
    trial = Trial(mutation, copy, path.read_text("utf-8"), time.monotonic())
    write_source(path, mutated(trial.source, mutation))
    return fork_test(mutation.test, copy), trial


def finish(trial: Trial, status: int, seconds: float) -> bool:
    """Undo a mutation whose test has ended, and print what became of it.

    Args:
        trial: The mutation.
        status: Wait status of the test's process.
        seconds: Processor time of the test [s].

    Returns:
        Whether the test has noticed the mutation.
    """
    write_source(trial.copy / trial.mutation.file, trial.source)
    # A test that cannot be collected or found ends with another exit code of pytest, one that was
    # ended because of its time with none.
    caught = os.waitstatus_to_exitcode(status) == pytest.ExitCode.TESTS_FAILED
    output = (trial.copy / "output").read_text("utf-8", "replace")
    failures = re.findall(r"^(?:FAILED|ERROR).*?(?= - |$)", output, re.MULTILINE)
    verdict = "caught" if caught else "SURVIVES"
    reason = failures[0] if failures else output[-600:]
    print(f"{verdict:9}{seconds:5.1f} s  {trial.mutation.breaks} {reason}", flush=True)
    return caught


@contextmanager
def ends_what_is_overdue(running: dict[int, Trial]) -> Iterator[None]:
    """End each test that takes longer than `LIMIT`, while the block waits for some of them.

    A mutation can make a loop that never ends. Without this limit, the whole run would not.

    Args:
        running: What is running, by process id; the block changes it.
    """

    def look(*_: object) -> None:
        for process, trial in running.items():
            if time.monotonic() - trial.begin > LIMIT:
                print(f"Ended after {LIMIT:.0f} s: {trial.mutation.test}", flush=True)
                os.kill(process, signal.SIGKILL)

    before = signal.signal(signal.SIGALRM, look)
    # A forked process has no timers of its parent.
    signal.setitimer(signal.ITIMER_REAL, LIMIT / 10.0, LIMIT / 10.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def try_all(mutations: Sequence[Mutation], jobs: int) -> int:
    """Make every mutation in a copy of the project, several at a time.

    Returns:
        The number of mutations that survive their tests.
    """
    waiting = list(reversed(mutations))
    running: dict[int, Trial] = {}
    survivors = 0
    with tempfile.TemporaryDirectory() as parent, ends_what_is_overdue(running):
        # Most of the code that a test compiles is that of the tests before.
        if FOLDER not in os.environ:
            objects = Path(parent, "objects")
            objects.mkdir()
            os.environ[FOLDER] = str(objects)
        idle = [Path(parent, str(job)) for job in range(jobs)]
        while waiting or running:
            if waiting and idle:
                process, trial = start(waiting.pop(), idle.pop())
                running[process] = trial
                continue
            process, status, usage = os.wait4(-1, 0)
            trial = running.pop(process)
            idle.append(trial.copy)
            if not finish(trial, status, usage.ru_utime + usage.ru_stime):
                survivors += 1
    return survivors


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutations",
        description="Break the physics and see that the tests notice.",
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes at a time"
    )
    parser.add_argument(
        "--only", metavar="TEXT", default="", help="only mutations and files that hold this text"
    )
    options = parser.parse_args(argv)
    text = options.only.lower()
    mutations = [m for m in read_mutations() if text in f"{m.file} {m.breaks}".lower()]
    for mutation in mutations:
        check_test_exists(mutation, ROOT)
    for module in SHARED:
        importlib.import_module(module)
    # Failing examples need not shrink; the profile of the tests inherits the phases.
    hypothesis.settings.register_profile("first", phases=[Phase.explicit, Phase.generate])
    hypothesis.settings.load_profile("first")
    # Forked processes look for no garbage among the shared modules.
    gc.collect()
    gc.freeze()
    survivors = try_all(mutations, options.jobs)
    print(f"{len(mutations) - survivors} of {len(mutations)} mutations caught.")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
