"""Engines, exporters and experiments by name: those of cranedyn and those of other packages.

Each is an entry point of the group `cranedyn.engines`, `cranedyn.exporters` or
`cranedyn.experiments`. A package declares its own in its pyproject.toml, as cranedyn does:

* an engine is a class like `cranedyn.simulation.engine.Engine`;
* an exporter is a module with `TARGET`, `add_arguments(parser)` and `run(options)`, see
  `cranedyn.bridges`;
* an experiment is a module with `main(argv)`, which returns the exit code.

The first paragraph of a module's docstring describes it in lists and help.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cranedyn.errors import CraneError, UnknownName

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = Literal["engine", "exporter", "experiment"]

_PACKAGE = Path(__file__).resolve().parent


def names(kind: Kind) -> list[str]:
    """Return the names of all plugins of a kind, those of cranedyn first."""
    return list(_entry_points(kind))


def load(kind: Kind, name: str) -> Any:
    """Import a plugin and return it.

    Raises:
        UnknownName: If there is no plugin of this name.
        CraneError: If its package is not there, or fails to be imported.
    """
    entry = _entry_point(kind, name)
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise CraneError(f"The {kind} {name} ({entry.value}) cannot be loaded: {error}.") from error


def description(kind: Kind, name: str) -> str:
    """Return the first paragraph of a plugin's documentation, without importing its module.

    Raises:
        UnknownName: If there is no plugin of this name.
    """
    try:
        spec = find_spec(_entry_point(kind, name).module)
        text = Path((spec and spec.origin) or "").read_bytes()
    except (ImportError, OSError):
        return "cannot be loaded"
    return " ".join((ast.get_docstring(ast.parse(text)) or "").partition("\n\n")[0].split())


def _entry_point(kind: Kind, name: str) -> EntryPoint:
    entries = _entry_points(kind)
    if name not in entries:
        raise UnknownName(kind, name, entries)
    if entries[name].module.startswith("experiments."):
        _make_experiments_importable()
    return entries[name]


@cache
def _entry_points(kind: Kind) -> Mapping[str, EntryPoint]:
    """Return entry points by name; one of cranedyn is not replaced by one of another package.

    In a checkout pyproject.toml says what cranedyn has: a new line there needs no new installation.
    """
    import tomllib  # it and the next take long, and few runs need them
    from importlib.metadata import EntryPoint, entry_points

    group, project = f"cranedyn.{kind}s", _PACKAGE.with_name("pyproject.toml")
    installed = sorted(entry_points(group=group), key=lambda entry: entry.name)
    ours = [entry for entry in installed if entry.dist and entry.dist.name == "cranedyn"]
    foreign = [entry for entry in installed if entry not in ours]
    if project.is_file():
        declared = tomllib.loads(project.read_text("utf-8"))["project"]
        if declared["name"] == "cranedyn":
            entries = declared["entry-points"][group].items()
            ours = [EntryPoint(name, value, group) for name, value in entries]
    named = {entry.name: entry for entry in ours}
    return named | {entry.name: entry for entry in foreign if entry.name not in named}


def _make_experiments_importable() -> None:
    """Put the folder of the experiments first in sys.path: bundled in an installed package, beside
    it in a checkout. So a package of this name elsewhere does not hide them.
    """
    bundled = _PACKAGE / "_bundled"
    folder = str(bundled if bundled.is_dir() else _PACKAGE.parent)
    if folder not in sys.path[:1]:
        sys.path.insert(0, folder)
