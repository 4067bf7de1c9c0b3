"""Shape of the house: imports that go up or in circles, and public names with two meanings.

``python -m tests.house`` prints what it finds. Nothing here counts lines or words.

Imports in functions, under TYPE_CHECKING, and dotted module names in strings count as imports.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PROTOCOL = frozenset(
    "main run begin export experiment add_arguments next_commands emit study oracles "
    "generate_launch_description open_source".split()
)
"""Public names that every module of a kind defines."""

Edge = tuple[str, str]
"""A module and a module that it imports, by dotted names."""


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def sources(*folders: str) -> list[Path]:
    """Return the Python files of folders of the repository."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


@cache
def modules() -> dict[str, Path]:
    """Return the files of cranedyn and experiments by the dotted name of the module."""
    paths = {
        path.relative_to(ROOT).with_suffix(""): path for path in sources("cranedyn", "experiments")
    }
    return {".".join(name.parts).removesuffix(".__init__"): path for name, path in paths.items()}


def imports() -> set[Edge]:
    """Return all imports between modules of cranedyn and experiments."""
    return {
        (name, target)
        for name, path in modules().items()
        for text in named_modules(tree(path))
        if (target := text if text in modules() else text.rpartition(".")[0]) in modules()
        and target != name
    }


def named_modules(root: ast.Module) -> Iterator[str]:
    """Yield the dotted names that a module imports or has in a string."""
    for node in ast.walk(root):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value.partition(":")[0]
            if text.count(".") > 1 or (text in modules() and "." in text):
                yield text


def circles(edges: set[Edge], package: str) -> list[list[str]]:
    """Return the strongly connected components of more than one module of a package."""
    targets: dict[str, set[str]] = defaultdict(set)
    for source, target in edges:
        if source.split(".")[0] == target.split(".")[0] == package:
            targets[source].add(target)
    reached = {name: _reachable(name, targets) for name in [*targets]}
    components = {tuple(sorted(m for m in reached[n] if n in reached.get(m, ()))) for n in reached}
    return sorted([*component] for component in components if len(component) > 1)


def _reachable(start: str, targets: dict[str, set[str]]) -> set[str]:
    reached = set[str]()
    stack = [start]
    while stack:
        new = targets.get(stack.pop(), set()) - reached
        reached |= new
        stack += new
    return reached


def upward(edges: set[Edge]) -> list[Edge]:
    """Return the imports from a layer into a higher one, by the layers of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    depth = {room: i for i, layer in enumerate(layers) for room in layer.split(" | ")}
    depth |= {"cranedyn": 0.5, "cranedyn.__main__": 0.5}  # below the experiments alone

    def depth_of(name: str) -> float:
        if name.startswith("experiments"):
            return depth["experiments"]
        parts = name.split(".")
        # A layer is a package, or one within it: the longest name counts.
        for length in range(len(parts), 0, -1):
            layer = ".".join(parts[:length])
            if layer in depth and (length > 1 or len(parts) == 1):
                return depth[layer]
        return len(layers)

    return sorted((a, b) for a, b in edges if depth_of(b) < depth_of(a))


def ambiguous(paths: list[Path]) -> list[str]:
    """Return the public functions and classes that several modules define."""
    files = defaultdict(set)
    for path in paths:
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name[0] != "_":
                files[node.name].add(path)
    return sorted(name for name in files.keys() - PROTOCOL if len(files[name]) > 1)


def problems() -> list[str]:
    """Return what is wrong with the shape of the house, a sentence each."""
    edges = imports()
    packages = ("cranedyn", "experiments")
    found = [
        f"The modules {', '.join(circle)} import each other in a circle."
        for package in packages
        for circle in circles(edges, package)
    ]
    found += [f"{source} imports {target}, of a higher layer." for source, target in upward(edges)]
    found += [
        f"The public name {name} has several meanings." for name in ambiguous(sources(*packages))
    ]
    return found


def main() -> int:
    """Print what is wrong; return the exit code."""
    found = problems()
    print(*(found or ["Imports go down, without circles; no public name is ambiguous."]), sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
