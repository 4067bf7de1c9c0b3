"""Engines, exporters and experiments by name: those of cranedyn and those of other packages.

Each is an entry point of the group `cranedyn.engines`, `cranedyn.exporters` or
`cranedyn.experiments`. A package declares its own in its pyproject.toml, as cranedyn does:

* an engine is a module with `run(spec, controller, reference, monitors)` and `begin(spec)`, see
  `cranedyn.simulation.engine.Engine`;
* an exporter is a module with `TARGET`, `add_arguments(parser)` and `run(options)`, see
  `cranedyn.export`;
* an experiment is a module with `main(argv)`, which returns the exit code.

The first paragraph of a module's docstring describes it in lists and help.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from functools import cache
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal

from cranedyn.errors import CraneError, UnknownName, printable

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = Literal["engine", "exporter", "experiment", "command"]

_PACKAGE = Path(__file__).resolve().parent


def names(kind: Kind) -> list[str]:
    """Return the names of all plugins of a kind, those of cranedyn first."""
    return list(_own(kind) | _foreign(kind))


def load(kind: Kind, name: str) -> Any:
    """Import a plugin and return it.

    Raises:
        UnknownName: If there is no plugin of this name.
        CraneError: If its package is not there, fails to be imported, or has not what a plugin of
            its kind needs.
    """
    value = _value(kind, name)
    try:
        plugin = resolve_name(value)
        _check_parts(kind, plugin)
    except CraneError:  # one of ours whose extra is not installed
        raise
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # other people's code, which may also call sys.exit
        reason = str(error)
        if not isinstance(error, ImportError | AttributeError):
            if name in _own(kind):
                raise
            reason = f"{type(error).__name__}: {error}"
        raise CraneError(f"The {kind} {name} ({value}) cannot be loaded: {reason}.") from error
    return plugin


def description(kind: Kind, name: str) -> str:
    """Return the first paragraph of a plugin's documentation, without importing its module.

    For a plugin that cannot be found or parsed it is "cannot be loaded".

    Raises:
        UnknownName: If there is no plugin of this name.
    """
    value = _value(kind, name)
    try:
        spec = find_spec(value.partition(":")[0])  # imports the packages in which it lies
        text = Path((spec and spec.origin) or "").read_bytes()
        documentation = ast.get_docstring(ast.parse(text)) or ""
    except (Exception, SystemExit):  # one package's fault must not hide the plugins of others
        return "cannot be loaded"
    return printable(" ".join(documentation.partition("\n\n")[0].split()))


_FUNCTIONS: dict[Kind, dict[str, tuple[str, ...]]] = {
    "engine": {"run": ("spec", "controller", "reference", "monitors"), "begin": ("spec",)},
    "exporter": {"add_arguments": ("parser",), "run": ("options",)},
    "experiment": {"main": ("argv",)},
    "command": {"main": ("argv",)},
}
"""Functions that the module of a plugin needs, and the arguments of each."""


def _check_parts(kind: Kind, plugin: Any) -> None:
    """Check that a plugin has what others call.

    Raises:
        AttributeError: If something is missing or takes other arguments.
    """
    if kind == "exporter" and not isinstance(plugin.TARGET, str):
        raise AttributeError("its TARGET is not a text")
    functions = dict(_FUNCTIONS[kind])
    if kind == "exporter" and hasattr(plugin, "next_commands"):
        functions["next_commands"] = ("options",)
    for function, arguments in functions.items():
        try:
            signature(getattr(plugin, function)).bind(*arguments)
        except TypeError as error:
            expected = ", ".join(arguments)
            raise AttributeError(f"its {function} is no function of ({expected})") from error


def _value(kind: Kind, name: str) -> str:
    """Return where a plugin is, as module or module:object.

    Other packages, which take long to look through, matter only if cranedyn has none of this name.
    """
    value = _own(kind).get(name) or _foreign(kind).get(name)
    if value is None:
        advice = "One that is new in pyproject.toml is found after another: pip install -e ."
        raise UnknownName(kind, name, names(kind), advice)
    if value.startswith("experiments."):
        _make_experiments_importable()
    return value


@cache
def _own(kind: Kind) -> dict[str, str]:
    """Return the plugins of cranedyn by name."""
    declared = _own_declarations()
    if declared is not None:
        return dict(sorted(declared.get(f"cranedyn.{kind}s", {}).items()))
    return {entry.name: _target(entry) for entry in _entries(kind) if _is_ours(entry)}


@cache
def _own_declarations() -> dict[str, dict[str, str]] | None:
    """Return the entry points that cranedyn declares, by group and name; None if it is not
    installed in a folder of its own, as in an archive.

    `importlib.metadata` reads the files of all packages that are installed, and its import alone
    takes as long as compiling a crane.
    """
    for folder in sys.path:
        try:
            names = os.listdir(folder or ".")
        except OSError:  # an archive, or nothing at all
            continue
        for name in names:
            if _OWN_METADATA.fullmatch(name):
                try:
                    text = Path(folder, name, "entry_points.txt").read_text("utf-8")
                except OSError:
                    return None
                return _parse_entry_points(text)
    return None


_OWN_METADATA = re.compile(r"cranedyn-[^-]+\.dist-info")
"""Name of the folder with what is known of the installed package."""


def _parse_entry_points(text: str) -> dict[str, dict[str, str]]:
    """Return the entry points of a file ``entry_points.txt``, by group and name."""
    groups: dict[str, dict[str, str]] = {}
    group: dict[str, str] = {}
    for line in text.splitlines():
        line = line.strip()
        if line.startswith("["):
            group = groups.setdefault(line.strip("[]"), {})
        elif line and not line.startswith("#"):
            name, _, value = line.partition("=")
            group[name.strip()] = "".join(value.split())
    return groups


@cache
def _foreign(kind: Kind) -> dict[str, str]:
    """Return the plugins of other packages by name."""
    return {entry.name: _target(entry) for entry in _entries(kind) if not _is_ours(entry)}


def _entries(kind: Kind) -> list[EntryPoint]:
    """Return the entry points of a kind of all packages that are installed, by name."""
    from importlib.metadata import entry_points  # it takes long, and few runs need it

    return sorted(entry_points(group=f"cranedyn.{kind}s"), key=lambda entry: entry.name)


def _is_ours(entry: EntryPoint) -> bool:
    """Return whether cranedyn itself declares an entry point."""
    return entry.dist is not None and entry.dist.name == "cranedyn"


def _target(entry: EntryPoint) -> str:
    """Return where a plugin is, as module or module:object."""
    return "".join(entry.value.split())


def _make_experiments_importable() -> None:
    """Put the folder of the experiments first in sys.path: bundled in an installed package, beside
    it in a checkout. So a package of this name elsewhere does not hide them.
    """
    bundled = _PACKAGE / "_bundled"
    folder = str(bundled if bundled.is_dir() else _PACKAGE.parent)
    if folder not in sys.path[:1]:
        sys.path.insert(0, folder)
