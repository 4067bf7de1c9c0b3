"""Where a program holds a coordinate's number: integer indices into coordinates, rates and what
belongs to drives, by its syntax tree.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

COORDINATES = frozenset({"q", "v"})
"""Names of arrays along whose last axis are joints."""

DRIVES = frozenset(
    {"effort", "command", "setpoint", "work", "position", "velocity", "acceleration"}
)
"""Names of arrays along whose last axis are drives; alone, with one index, they may be rows."""

OTHER_COORDINATES = frozenset(
    {
        # Vectors in the world, or on a base that moves: surge to yaw.
        "cranedyn/controllers/moving_base.py",
        "cranedyn/disturbances/base_motion.py",
        "cranedyn/lifts/judging/drawings/swept.py",
        # Place and attitude of a load that is a body of its own.
        "cranedyn/lifts/tandem/simulation.py",
    }
)
"""Files whose arrays of these names are those of no crane's joints."""

STATES = frozenset({"state", "start", "goal", "rest", "here"})
"""Names of states, whose arrays have one axis; those of all else may be rows of which the first and
the last have numbers."""


def integer_indices(source: str) -> list[tuple[int, str]]:
    """Line and text of each place where such an array is indexed by an integer, or sliced at one,
    along its last axis.
    """
    return sorted(
        (node.lineno, ast.unparse(node)) for node in _subscripts(source) if _is_forbidden(node)
    )


def everywhere(folders: list[Path], without: Path) -> list[str]:
    """The same in all modules of folders but one folder and `OTHER_COORDINATES`, as ``file:line:
    text``.
    """
    files = []
    for folder in folders:
        for path in folder.rglob("*.py"):
            is_other = path.as_posix().endswith(tuple(OTHER_COORDINATES))
            if without not in path.parents and not is_other:
                files.append(path)
    return [
        f"{path}:{line}: {text}"
        for path in sorted(files)
        for line, text in integer_indices(path.read_text(encoding="utf-8"))
    ]


def _subscripts(source: str) -> Iterator[ast.Subscript]:
    return (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Subscript))


def _is_forbidden(node: ast.Subscript) -> bool:
    name, owner = _named(node.value)
    if name not in COORDINATES | DRIVES:
        return False
    if isinstance(node.slice, ast.Tuple):
        return len(node.slice.elts) > 1 and _is_fixed(node.slice.elts[-1])
    if name in DRIVES:
        return False
    is_row = (
        isinstance(node.value, ast.Attribute)
        and owner not in STATES
        and _integer(node.slice) in (0, -1)
    )
    return _is_fixed(node.slice) and not is_row


def _named(node: ast.expr) -> tuple[str, str]:
    """The name of an array, and of what it is an attribute of."""
    if isinstance(node, ast.Attribute):
        return node.attr, _named(node.value)[0]
    return (node.id, "") if isinstance(node, ast.Name) else ("", "")


def _is_fixed(index: ast.expr) -> bool:
    """Whether an index is an integer, a list of some, or a slice from or to one."""
    if isinstance(index, ast.Slice):
        return any(
            part is not None and _integer(part) not in (None, 0)
            for part in (index.lower, index.upper)
        )
    if isinstance(index, ast.List | ast.Tuple):
        return any(_integer(part) is not None for part in index.elts)
    return _integer(index) is not None


def _integer(node: ast.expr) -> int | None:
    try:
        value = ast.literal_eval(node)
    except ValueError:
        return None
    return value if isinstance(value, int) and not isinstance(value, bool) else None
