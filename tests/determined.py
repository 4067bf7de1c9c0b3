"""Which printed digits are determined: the experiments under other arithmetic, cell by cell.

``python -m tests.determined --out DIR [NAME ...]`` runs experiments as they are, on the kernels of
OpenBLAS for other processors, and with every start moved by 1e-12, and names the cells that differ
by more than half of the last digit that is printed. A run that is there already is read, so results
of other Pythons can be put beside them in folders of their own.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from experiments.harness.document import last_digit
from experiments.harness.outcome import ResultTable
from tests.helpers import ROOT

COMPILED = ("--engine", "compiled")
ARTICLE = ("--gravity", "9.8")

COMMANDS: dict[str, tuple[str, ...]] = {
    "a1": ("a1", *ARTICLE),
    "a2": ("a2", *ARTICLE),
    "a3": ("a3", *ARTICLE),
    "b1": ("b1", *COMPILED),
    "compare": ("compare", *COMPILED),
    "compare_velocity": ("compare", "--drive", "velocity", *COMPILED),
    "cranes": ("cranes", *COMPILED),
    "demo": ("demo", "--cycles", "1", "--control", "flat", *COMPILED),
    "energy": ("energy", *COMPILED),
    "factors": ("factors",),
    "gazebo": ("gazebo", *COMPILED),
    "identify": ("identify",),
    "lift": ("lift",),
    "lift_benchmark": ("lift_benchmark", "--sites", "20"),
    "linear_vs_full": ("linear_vs_full", *COMPILED),
    "margins": ("margins", *COMPILED),
    "mass_ratio": ("mass_ratio", *COMPILED),
    "observer": ("observer", *COMPILED),
    "sweep": ("sweep",),
    "validate": ("validate", *COMPILED),
}
"""The experiments whose tables documents show, by the folder of their results."""

TIMES = ("How long it took", "plan and certificate [s]")
"""Beginnings of tables and columns of times that the machine took."""

MOVED = 1e-12
"""By how much the drives start elsewhere [rad or m]."""

VARIANTS: dict[str, Mapping[str, str]] = {
    "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "moved": {"OPENBLAS_CORETYPE": "Haswell", "CRANEDYN_MOVED": str(MOVED)},
    "moved_back": {"OPENBLAS_CORETYPE": "Haswell", "CRANEDYN_MOVED": str(-MOVED)},
}
"""Environment variables of each way to compute."""

STARTUP = """\
import os
import numpy as np
from cranedyn.interfaces import State
from cranedyn.simulation.engine import Engine


def reset_elsewhere(engine):
    reset = engine.reset

    def moved(self, start):
        crane, q = self._setting.crane, start.q.copy()
        drives = crane.layout.drives
        if not start.v.any():  # else it is a run that goes on from an earlier one
            q[drives] += float(os.environ["CRANEDYN_MOVED"])
        reset(self, State(np.clip(q, crane.lower, crane.upper), start.v))

    engine.reset = moved


reset_elsewhere(Engine)
"""
"""What Python runs first where starts are moved, in worker processes too."""


def run(name: str, variant: str, folder: Path) -> None:
    """Run an experiment under a variant unless its result is there."""
    out = folder / variant / name
    if (out / "result.json").exists():
        return
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", **VARIANTS[variant]}
    if "CRANEDYN_MOVED" in environment:
        startup = folder / "startup"
        startup.mkdir(parents=True, exist_ok=True)
        (startup / "sitecustomize.py").write_text(STARTUP, encoding="utf-8")
        environment["PYTHONPATH"] = os.pathsep.join([str(startup), str(ROOT)])
    out.parent.mkdir(parents=True, exist_ok=True)
    module, *words = COMMANDS[name]
    done = subprocess.run(
        [sys.executable, "-m", f"experiments.{module}", *words, "--out", str(out)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
    )
    print(f"{name} under {variant}: exit code {done.returncode}", flush=True)
    if done.returncode:
        print(done.stdout[-1000:], done.stderr[-1000:])


def spread(name: str, folder: Path) -> list[str]:
    """The columns of an experiment whose cells differ by more than half of their last digit, with
    the cell that differs by most of its last digits.
    """
    results = {
        file.parents[1].name: json.loads(file.read_text(encoding="utf-8"))
        for file in sorted(folder.glob(f"*/{name}/result.json"))
    }
    tables: dict[str, dict[str, ResultTable]] = defaultdict(dict)
    for variant, result in results.items():
        for kept in result["tables"]:
            tables[kept["title"]][variant] = ResultTable.of(kept)
    sentences = []
    for title, of_variant in tables.items():
        if len(of_variant) < len(results) or len({len(t.rows) for t in of_variant.values()}) > 1:
            sentences.append(f"{name}, {title}: not the same rows under {', '.join(of_variant)}")
            continue
        first = next(iter(of_variant.values()))
        for at, (header, form) in enumerate(first.columns):
            if title.startswith(TIMES) or header.startswith(TIMES):
                continue
            columns = zip(*([row[at] for row in t.rows] for t in of_variant.values()), strict=True)
            apart = {
                (row, distance): cells
                for row, cells in enumerate(columns)
                if (distance := _distance(cells, form)) > 0.5
            }
            if apart:
                row, worst = max(apart, key=lambda key: key[1])
                cells = ", ".join(_shown(cell, form) for cell in apart[row, worst])
                sentences.append(
                    f"{name}, {title}, {header.strip()}: {len(apart)} of {len(first.rows)} cells, "
                    f"by up to {worst:.3g} of the last digit, row {first.rows[row][0]}: {cells}"
                )
    return sentences


def _distance(cells: Sequence[object], form: str) -> float:
    """Return how far apart cells are, in last digits that are printed; infinite for other words."""
    numbers = [float(cell) for cell in cells if isinstance(cell, int | float)]
    if len(numbers) < len(cells):
        return float("inf") if len(set(map(str, cells))) > 1 else 0.0
    digit = last_digit(max(numbers, key=abs), form)
    return (max(numbers) - min(numbers)) / digit if digit else 0.0


def _shown(cell: object, form: str) -> str:
    return format(cell, form) if isinstance(cell, int | float) else str(cell)


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0 if every printed digit is determined, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m tests.determined", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="experiments (default all)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of results")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    options = parser.parse_args(argv)
    sentences = []
    for name in options.names or COMMANDS:
        for variant in options.variants:
            run(name, variant, options.out)
        sentences += spread(name, options.out)
    print(*sentences, f"{len(sentences)} columns are not determined.", sep="\n")
    return 1 if sentences else 0


if __name__ == "__main__":
    sys.exit(main())
