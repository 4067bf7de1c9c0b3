"""The size and shape of the house beside its goals; ``python -m tests.house`` prints the table.

Imports in functions, under TYPE_CHECKING, and dotted module names in strings count as imports.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

CORE = (
    "__init__ controllers data display disturbances dynamics errors interfaces model plotting "
    "recording references simulation theory"
).split()
"""Rooms and modules of cranedyn that make the core."""

CONTENTLESS = frozenset(
    "again anew another answer apart around asked at away each every far few found given gone "
    "held here how it kept known least left less made many meant more most on "
    "one ones other others out own owner part parts place places rest said seen shown so some such "
    "taken that there they thing things those told wanted way ways what when where which who whole "
    "whose words".split()
)
"""Names that say nothing of what they are bound to."""

NO_VERBS = frozenset(
    "a all an any as at both by each either every few for from half his how if in it its many more "
    "most much no none nothing of on one only other same some such that the their there these they "
    "this those to true two what when where whether which who whose with".split()
)
"""Words that begin a docstring without a verb."""

SHARED = frozenset("main run export experiment add_arguments emit oracles".split())
"""Public names that each module of a kind defines on purpose."""

GOALS = {
    "lines of the core": 10_000,
    "lines of cranedyn": 27_000,
    "lines of experiments": 11_000,
    "lines of benchmarks": 2_800,
    "lines of tests": 27_000,
    "modules in cranedyn": 150,
    "modules imported by simulate": 25,
    "parameters of simulate": 10,
    "body lines of simulate": 40,
    "circles of imports in cranedyn": 0,
    "circles of imports in experiments": 0,
    "imports upward": 0,
    "contentless bindings [per mille]": 15,
    "docstrings without a verb [per mille]": 50,
    "ambiguous public names": 0,
    "words of docs": 22_000,
}

BOUNDS: dict[str, int] = {}
"""What is reached; a change may lower these numbers and never raise them."""


class Import(NamedTuple):
    """An import of one module by another, by their dotted names."""

    source: str
    target: str


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def sources(*folders: str) -> list[Path]:
    """Return the Python files of folders of the repository."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def lines(paths: list[Path]) -> int:
    """Return the number of lines of files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


@cache
def modules() -> dict[str, Path]:
    """Return the files of cranedyn and experiments by the dotted name of the module."""
    names = {}
    for path in sources("cranedyn", "experiments"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def imports() -> set[Import]:
    """Return all imports between modules of cranedyn and experiments."""
    return {
        Import(name, target)
        for name, path in modules().items()
        for text in _imported(tree(path))
        if (target := _module(text)) and target != name
    }


def _imported(root: ast.Module) -> Iterator[str]:
    """Yield dotted names of what a module imports or names in a string."""
    for node in ast.walk(root):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value.partition(":")[0]
            if text.count(".") > 1 or text in modules().keys() - {"cranedyn", "experiments"}:
                yield text


def _module(text: str) -> str:
    """Return the module of a dotted name, which may end in a name of the module; else ""."""
    if text in modules():
        return text
    parent = text.rpartition(".")[0]
    return parent if parent in modules() else ""


def circles(edges: set[Import], package: str) -> list[list[str]]:
    """Return the strongly connected components of more than one module of a package."""
    targets = defaultdict(set)
    for source, target in edges:
        if source.split(".")[0] == target.split(".")[0] == package:
            targets[source].add(target)
    reached = {name: _reachable(name, targets) for name in targets}
    components = {
        tuple(sorted(m for m in reached[name] if name in reached.get(m, ()))) for name in reached
    }
    return sorted(list(component) for component in components if len(component) > 1)


def _reachable(start: str, targets: dict[str, set[str]]) -> set[str]:
    reached, stack = set[str](), [start]
    while stack:
        new = targets.get(stack.pop(), set()) - reached
        reached |= new
        stack += new
    return reached


def upward(edges: set[Import]) -> list[Import]:
    """Return the imports of a higher layer by a lower one, by the layers of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    level = {room: i for i, layer in enumerate(layers) for room in layer.split(" | ")}

    def height(name: str) -> int:
        if name.startswith("experiments"):
            return 0
        room = ".".join(name.split(".")[:2])
        # Modules of the package itself are on top; what has no layer is at the bottom.
        return 0 if room in ("cranedyn", "cranedyn.__main__") else level.get(room, len(layers))

    return sorted(
        edge
        for edge in edges
        if height(edge.target) < height(edge.source)
        or (edge.target.startswith("experiments") and edge.source.startswith("cranedyn"))
    )


def bindings(paths: list[Path]) -> list[str]:
    """Return the names of all variables and parameters of files."""
    nodes = [node for path in paths for node in ast.walk(tree(path))]
    variables = [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    parameters = [node.arg for node in nodes if isinstance(node, ast.arg)]
    return variables + [name for name in parameters if name not in ("self", "cls")]


def first_words(paths: list[Path]) -> list[str]:
    """Return the first word of the docstring of every function that is no property."""
    words = []
    for path in paths:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef) and (text := ast.get_docstring(node)):
                if not any("property" in ast.unparse(mark) for mark in node.decorator_list):
                    words.append(text.split()[0].strip(".,:`").lower())
    return words


def ambiguous(paths: list[Path]) -> list[str]:
    """Return the public functions and classes that several modules define."""
    homes = defaultdict(set)
    for path in paths:
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                homes[node.name].add(path)
    return sorted(
        name
        for name, files in homes.items()
        if len(files) > 1 and name not in SHARED and not name.startswith("_")
    )


def simulate_function() -> ast.FunctionDef:
    """Return the syntax tree of `cranedyn.simulate`."""
    body = tree(ROOT / "cranedyn" / "simulation" / "simulate.py").body
    return next(n for n in body if isinstance(n, ast.FunctionDef) and n.name == "simulate")


def loaded_modules() -> int:
    """Return how many modules of cranedyn a fresh Python has loaded after `cranedyn.simulate`."""
    program = (
        "import sys, cranedyn; cranedyn.simulate; "
        "print(sum(name.split('.')[0] == 'cranedyn' for name in sys.modules))"
    )
    command = [sys.executable, "-c", program]
    return int(subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout)


def _per_mille(count: int, total: int) -> int:
    return -(-1000 * count // total)  # rounded up


def measure() -> dict[str, int]:
    """Return all numbers of the house, by the names of `GOALS`."""
    edges, own = imports(), sources("cranedyn", "experiments")
    core = [p for p in sources("cranedyn") if p.relative_to(ROOT).with_suffix("").parts[1] in CORE]
    names, openings, function = bindings(own), first_words(own), simulate_function()
    body = function.body[ast.get_docstring(function) is not None :]
    parameters = (function.args.posonlyargs, function.args.args, function.args.kwonlyargs)
    return {
        "lines of the core": lines(core),
        **{
            f"lines of {folder}": lines(sources(folder))
            for folder in ("cranedyn", "experiments", "benchmarks", "tests")
        },
        "modules in cranedyn": len(sources("cranedyn")),
        "modules imported by simulate": loaded_modules(),
        "parameters of simulate": sum(map(len, parameters)),
        "body lines of simulate": (body[-1].end_lineno or 0) - body[0].lineno + 1,
        "circles of imports in cranedyn": len(circles(edges, "cranedyn")),
        "circles of imports in experiments": len(circles(edges, "experiments")),
        "imports upward": len(upward(edges)),
        "contentless bindings [per mille]": _per_mille(
            sum(name in CONTENTLESS for name in names), len(names)
        ),
        "docstrings without a verb [per mille]": _per_mille(
            sum(word in NO_VERBS for word in openings), len(openings)
        ),
        "ambiguous public names": len(ambiguous(own)),
        "words of docs": sum(
            len(path.read_text(encoding="utf-8").split()) for path in (ROOT / "docs").rglob("*.md")
        ),
    }


def main() -> None:
    """Print the table, and the circles and imports upward one by one."""
    print(f"{'':40} {'today':>8} {'goal':>8}")
    for name, value in measure().items():
        print(f"{name:40} {value:8,} {GOALS[name]:8,}")
    edges = imports()
    for circle in [*circles(edges, "cranedyn"), *circles(edges, "experiments")]:
        print("circle:", ", ".join(circle))
    for edge in upward(edges):
        print("upward:", edge.source, "->", edge.target)


if __name__ == "__main__":
    main()
