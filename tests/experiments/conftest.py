"""Experiments as run whole through their command lines, each once a session."""

from __future__ import annotations

import fcntl
import importlib
import io
import json
import os
import pickle
import re
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers import FAST

ARTICLE = {"a1", "a2", "a3"}
"""Experiments that stand in the article's gravity here, so that its published numbers are judged.
"""

PLAIN = {"a1"}
"""Those that are computed by the plain loop, too, as by default; both print the same."""


@dataclass(frozen=True)
class Ran:
    """An experiment as run: exit code, standard output, folder and ``result.json``."""

    code: int
    text: str
    folder: Path
    result: dict[str, Any]

    def table(self, title: str) -> list[dict[str, Any]]:
        """Return the rows of the one table whose title begins so; of columns with the same header
        the first, then "header 2", and so on.
        """
        (table,) = (table for table in self.result["tables"] if table["title"].startswith(title))
        headers = table["columns"]
        counts = [headers[: i + 1].count(header) for i, header in enumerate(headers)]
        names = [h if n == 1 else f"{h} {n}" for h, n in zip(headers, counts, strict=True)]
        return [dict(zip(names, row, strict=True)) for row in table["rows"]]

    def failed(self) -> list[str]:
        """Return the sentences of claims that do not hold."""
        return [claim["sentence"] for claim in self.result["claims"] if claim["holds"] is not True]


Standard = Callable[[str], Ran]
"""A fixture that runs an experiment by its name."""


def parse_strict(text: str) -> Any:
    """Parse JSON without numbers that are none."""
    return json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in result.json"))


def run_command(name: str, folder: Path, *argv: str) -> Ran:
    """Run an experiment by its name into a folder."""
    module = importlib.import_module(f"experiments.{name}")
    with redirect_stdout(io.StringIO()) as out:
        code = module.main([*argv, "--out", str(folder)])
    result = parse_strict((folder / "result.json").read_text(encoding="utf-8"))
    return Ran(code, out.getvalue(), folder, result)


@pytest.fixture(scope="session")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Ran]:
    """Runs an experiment with arguments when it is first asked for, once for all workers."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    @cache
    def run(name: str, *argv: str) -> Ran:
        folder = shared / re.sub(r"[^\w.-]", "_", "_".join(["ran", name, *argv]))
        with open(f"{folder}.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (folder / "ran").exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                done = run_command(name, folder / name, *argv)
                (folder / "ran").write_bytes(pickle.dumps(done))
        return pickle.loads((folder / "ran").read_bytes())

    return run


@pytest.fixture(scope="session")
def standard(ran: Callable[..., Ran]) -> Standard:
    """Runs an experiment as the article has it, by the engine that is fast where it may."""

    def run(name: str) -> Ran:
        gravity = ["--gravity", "9.8"] if name in ARTICLE else []
        return ran(name, *gravity, "--engine", FAST)

    return run


def write_csv(path: Path, **columns: np.ndarray) -> Path:
    """Write columns with all their digits, and return the file."""
    table = np.stack(list(columns.values()), axis=1)
    header = ",".join(columns)
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    return path


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow what reads a whole experiment."""
    for item in items:
        if "ran" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
