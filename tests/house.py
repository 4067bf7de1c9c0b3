"""Size and shape of the house beside bounds and goals: ``python -m tests.house`` prints them.

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

ROOT = Path(__file__).resolve().parents[1]

CORE = frozenset(
    "__init__ controllers data display disturbances dynamics errors interfaces model plotting "
    "recording references simulation theory".split()
)

CONTENTLESS = frozenset(
    "again anew another answer apart around asked at away each every far few found given gone held "
    "here how it kept known least left less made many meant more most on one ones other others out "
    "own owner part parts place places rest said seen shown so some such taken that there they "
    "thing things those told wanted way ways what when where which who whole whose words".split()
)
"""Names that say nothing of what they are bound to."""

NO_VERBS = frozenset(
    "a all an any as at both by each either every few for from half his how if in it its many more "
    "most much no none nothing of on one only other same some such that the their there these they "
    "this those to true two what when where whether which who whose with".split()
)
"""Words that begin a docstring without a verb."""

PROTOCOL = frozenset(
    "main run export experiment add_arguments emit study generate_launch_description".split()
)
"""Public names that every module of a kind defines."""

LIMITS = {
    "lines of the core": (14_370, 10_000),
    "lines of cranedyn": (46_700, 27_000),
    "lines of experiments": (16_461, 11_000),
    "lines of benchmarks": (3_865, 2_800),
    "lines of tests": (37_945, 27_000),
    "modules in cranedyn": (231, 150),
    "modules imported by simulate": (38, 25),
    "parameters of simulate": (9, 10),
    "body lines of simulate": (36, 40),
    "circles of imports in cranedyn": (0, 0),
    "circles of imports in experiments": (0, 0),
    "imports upward": (0, 0),
    "contentless bindings [per mille]": (12, 15),
    "docstrings without a verb [per mille]": (10, 50),
    "ambiguous public names": (0, 0),
    "words of docs": (22_000, 22_000),
}
"""Bound and goal of each number: a change may lower a number below its bound and never raise it
above."""

Edge = tuple[str, str]
"""A module and a module that it imports, by dotted names."""


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
    reached, stack = set[str](), [start]
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
        room = "experiments" if name.startswith("experiments") else ".".join(name.split(".")[:2])
        return depth.get(room, len(layers))

    return sorted((a, b) for a, b in edges if depth_of(b) < depth_of(a))


def bindings(paths: list[Path]) -> list[str]:
    """Return the names of all variables and parameters of files."""
    nodes = [node for path in paths for node in ast.walk(tree(path))]
    variables = [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    parameters = [node.arg for node in nodes if isinstance(node, ast.arg)]
    return variables + [name for name in parameters if name not in ("self", "cls")]


def first_words(paths: list[Path]) -> list[str]:
    """Return the first word of the docstring of every function that is no property."""
    return [
        text.split()[0].strip(".,:`").lower()
        for path in paths
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef) and (text := ast.get_docstring(node))
        if not any("property" in ast.unparse(decorator) for decorator in node.decorator_list)
    ]


def ambiguous(paths: list[Path]) -> list[str]:
    """Return the public functions and classes that several modules define."""
    files = defaultdict(set)
    for path in paths:
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name[0] != "_":
                files[node.name].add(path)
    return sorted(name for name in files.keys() - PROTOCOL if len(files[name]) > 1)


def loaded_modules() -> int:
    """Return how many modules of cranedyn a fresh Python has loaded after `cranedyn.simulate`."""
    program = "import sys, cranedyn; cranedyn.simulate; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    return sum(name.split(".")[0] == "cranedyn" for name in output.split())


def measure() -> dict[str, int]:
    """Return all numbers of the house, by the names of `LIMITS`."""
    edges, own = imports(), sources("cranedyn", "experiments")
    core = [p for p in sources("cranedyn") if p.relative_to(ROOT).with_suffix("").parts[1] in CORE]
    names, openings = bindings(own), first_words(own)
    (simulate,) = (
        node
        for node in tree(ROOT / "cranedyn/simulation/simulate.py").body
        if isinstance(node, ast.FunctionDef) and node.name == "simulate"
    )
    arguments, first, last = simulate.args, simulate.body[1], simulate.body[-1]
    parameters = arguments.posonlyargs + arguments.args + arguments.kwonlyargs
    contentless = sum(name in CONTENTLESS for name in names)
    verbless = sum(word in NO_VERBS for word in openings)
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    documents = [path.read_text(encoding="utf-8") for path in pages]
    return {
        "lines of the core": lines(core),
        "lines of cranedyn": lines(sources("cranedyn")),
        "lines of experiments": lines(sources("experiments")),
        "lines of benchmarks": lines(sources("benchmarks")),
        "lines of tests": lines(sources("tests")),
        "modules in cranedyn": len(sources("cranedyn")),
        "modules imported by simulate": loaded_modules(),
        "parameters of simulate": len(parameters),
        "body lines of simulate": (last.end_lineno or 0) - first.lineno + 1,
        "circles of imports in cranedyn": len(circles(edges, "cranedyn")),
        "circles of imports in experiments": len(circles(edges, "experiments")),
        "imports upward": len(upward(edges)),
        "contentless bindings [per mille]": -(-1000 * contentless // len(names)),
        "docstrings without a verb [per mille]": -(-1000 * verbless // len(openings)),
        "ambiguous public names": len(ambiguous(own)),
        "words of docs": sum(len(text.split()) for text in documents),
    }


def main() -> None:
    """Print the table, and the circles and imports upward one by one."""
    print(f"{'':40} {'today':>8} {'bound':>8} {'goal':>8}")
    for name, value in measure().items():
        bound, goal = LIMITS[name]
        print(f"{name:40} {value:8,} {bound:8,} {goal:8,}")
    edges = imports()
    for circle in [*circles(edges, "cranedyn"), *circles(edges, "experiments")]:
        print("circle:", ", ".join(circle))
    for source, target in upward(edges):
        print("upward:", source, "->", target)


if __name__ == "__main__":
    main()
