"""Charts, twins and sites of strangers: whole files whose values, and how they are nested, are not
those that were meant.
"""

from __future__ import annotations

import copy
import json
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from cranedyn.identification import read_twin, twin_of
from cranedyn.lifting.chart import CHARTS, read_chart
from cranedyn.model.load import load_crane
from cranedyn.planning.site_file import SITES
from tests.system.fuzz.api import namespace
from tests.system.fuzz.core import Broken, Case, Generator
from tests.system.fuzz.files import Edited, ended
from tests.system.fuzz.sites import furnished, stood

ODD: tuple[Any, ...] = (
    *("", "a", " ", "a\0b", "ä" * 200, "1.0", "nan", "../a.stl", "box.stl", "payload_mass"),
    *(True, False, 0, 1, -1, 2, 3, 10**30, 10**400, 1e-10, 1e-6, 1e9, 1e16, 1e300, -1e300, 5e-324),
    *(float("nan"), float("inf"), float("-inf"), 0.0, -0.0),
    *([], {}, [[]], [1.0], [1.0, 2.0], [1.0, 2.0, 3.0], ["a", "b"], [True] * 3, {"a": 1}, {"": []}),
    *([[0.0, 0.0], [1.0, 0.0], [1.0, 1e-10]], [float("nan")] * 2, [float("nan")] * 3, [1e300] * 3),
)
"""What may stand in the place of anything."""

Change = tuple[str, float, float, Any]
"""What is done, at which node, to or with which other one, both as shares; and with what."""


def change(rng: Random) -> Change:
    """Something to do to a tree."""
    kind = rng.choice(["odd", "odd", "times", "times", "drop", "twice", "rename", "swap", "number"])
    new: Any = rng.choice(ODD)
    if kind == "times":
        mild = [rng.uniform(0.5, 2.0) for _ in range(3)]
        new = rng.choice([-1.0, 0.0, 10.0 ** rng.uniform(-10.0, 9.0), 1.0 + 1e-12, *mild])
    if kind == "number":
        new = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-10.0, 10.0)
    return kind, rng.random(), rng.random(), new


def changed(tree: Any, changes: list[Change]) -> Any:
    """A tree of tables, lists and values after some changes."""
    tree = copy.deepcopy(tree)
    for kind, first, second, new in changes:
        nodes = list(_nodes(tree))
        if not nodes:
            break
        holder, key = nodes[int(first * len(nodes))]
        other, its = nodes[int(second * len(nodes))]
        value = holder[key]
        match kind:
            case "times" if isinstance(value, int | float) and abs(value) < 1e300:
                holder[key] = value * new
            case "drop":
                del holder[key]
            case "twice" if isinstance(holder, list):
                holder.append(copy.deepcopy(value))
            case "twice" | "rename" if isinstance(holder, dict):
                holder[str(new) if kind == "rename" else f"{key}s"] = copy.deepcopy(value)
                if kind == "rename":
                    holder.pop(key)
            case "swap":
                holder[key], other[its] = copy.deepcopy(other[its]), copy.deepcopy(value)
            case _:
                holder[key] = copy.deepcopy(new)
    return tree


def _nodes(tree: Any) -> Any:
    """Every place in a tree where something stands: what holds it, and where in that."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    for key in keys:
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _nodes(tree[key])


def toml(tree: dict[str, Any]) -> str:
    """A tree as TOML, its tables under headers of their own."""
    lines = [f"{_key(k)} = {_toml(v)}" for k, v in tree.items() if not _table(v) and not _tables(v)]
    for key, value in tree.items():
        for one in value if _tables(value) else [value] if _table(value) else []:
            lines.append(f"[[{_key(key)}]]" if _tables(value) else f"[{_key(key)}]")
            lines += [f"{_key(k)} = {_toml(v)}" for k, v in one.items()]
    return "\n".join(lines) + "\n"


def _table(value: Any) -> bool:
    return isinstance(value, dict)


def _tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(map(_table, value))


def _key(name: str) -> str:
    return name if name.isidentifier() and name.isascii() else json.dumps(name)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str | bool):
        return json.dumps(value)
    return "0x" + "f" * 400 if isinstance(value, int) and value > 10**300 else repr(value)


@dataclass(frozen=True)
class Changed:
    """Files of trees with a few nodes changed, given to whatever reads them.

    Attributes:
        name: Of the kind.
        weight: How many.
        trees: The good ones.
        written: One as text.
        give: Gives the text of one to its reader; says how it ended.
        interruptible: Whether what is done with it may take long.
    """

    name: str
    weight: float
    trees: Callable[[], list[Any]]
    written: Callable[[Any], str]
    give: Callable[[bytes, int, Path], str]
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """One of the trees and what is changed in it."""
        which = rng.randrange(len(self.trees()))
        return Case(which, [change(rng) for _ in range(rng.choice([1, 1, 1, 2, 3]))])

    def attempt(self, case: Case, folder: Path) -> str:
        """Give it to its reader."""
        return self.give(self._text(case).encode(errors="surrogatepass"), case.head, folder)

    def shown(self, case: Case) -> str:
        """The file."""
        return f"{self.name} {case.head}, {case.parts}:\n{self._text(case)[:4000]}"

    def _text(self, case: Case) -> str:
        return self.written(changed(self.trees()[case.head], case.parts))


# --- charts ---------------------------------------------------------------------------------------


def _chart(content: bytes, which: int, folder: Path) -> str:
    path = folder / "chart.toml"
    path.write_bytes(content)

    def rated() -> None:
        for falls in read_chart(path).reevings:
            radii = np.linspace(falls.least, falls.radii[-1], 9).clip(falls.least, falls.radii[-1])
            loads = falls.at(radii)
            if not ((loads > 0.0) & (loads <= falls.rated[0] * (1.0 + 1e-12))).all():
                raise Broken(
                    "a chart was read that rates what is no load, or more than its first", loads
                )

    return ended(rated)


# --- twins ----------------------------------------------------------------------------------------


@cache
def _twins() -> list[Any]:
    """Twins: one as it is found, one with two numbers set, and one of a plain URDF."""
    with tempfile.TemporaryDirectory() as folder:
        found = twin_of(eval("identify(model)", dict(namespace())))
        path = found.write(Path(folder) / "twin.json")
        one = json.loads(path.read_text())
    two, three = copy.deepcopy(one), copy.deepcopy(one)
    two["crane"] = json.loads(json.dumps(load_crane(payload_mass=900.0, rope_stiffness=1e7).record))
    three["crane"] = json.loads(json.dumps(load_crane(gravity=1.62).record))
    return [one, two, three]


def _twin(content: bytes, which: int, folder: Path) -> str:
    path = folder / "twin.json"
    path.write_bytes(content)

    def both() -> None:
        twin = read_twin(path)
        if not all(map(np.isfinite, twin.device_parameters.values())):
            raise Broken(
                "a twin was read that is off by what is not finite", twin.device_parameters
            )
        if not twin.options.isprintable():
            raise Broken("a twin was read whose words cannot be printed", twin.options)
        again = read_twin(twin.write(folder / "again.json"))
        if again.text != twin.text or not np.array_equal(again.crane.damping, twin.crane.damping):
            raise Broken("a twin that is written again is another", again.text)

    word = ended(both)
    alone = ended(lambda: load_crane(from_record=path))
    if (word, alone) == ("good", "refused"):
        raise Broken("a twin was read of which no crane is made")
    return word


# --- sites ----------------------------------------------------------------------------------------


@cache
def _charts() -> list[bytes]:
    return [path.read_bytes() for path in sorted(CHARTS.glob("*.toml"))]


@cache
def _sites() -> list[bytes]:
    """The examples, and one with a mesh."""
    mesh = (
        b'[ground]\nheight = 0.0\n[load]\nfile = "box.stl"\nmass = 900.0\n[lift]\nfrom = [5.0, '
        b'-9.0, 3.0]\nto = [-5.0, -12.0, 4.0]\n[[mesh]]\nname = "m"\nfile = "angle.off"\n'
        b"position = [12.0, 3.0, 0.0]\nyaw = 30.0\nscale = 2.0\nhull = false\n"
    )
    return [*(path.read_bytes() for path in sorted(SITES.glob("*.toml"))), mesh]


def _site(content: bytes, which: int, folder: Path) -> str:
    furnished(folder)
    (folder / "site.toml").write_bytes(content)
    return ended(lambda: stood(folder / "site.toml"))


def _read(contents: list[bytes]) -> list[Any]:
    return [tomllib.loads(content.decode()) for content in contents]


GENERATORS: list[Generator] = [
    Edited("file chart, bytes", 1.0, _charts, _chart),
    Changed("file chart, values", 2.0, lambda: _read(_charts()), toml, _chart),
    Edited("file twin, bytes", 1.0, lambda: [json.dumps(one).encode() for one in _twins()], _twin),
    Changed("file twin, values", 2.0, _twins, json.dumps, _twin),
    Edited("file site, bytes", 1.0, _sites, _site),
    Changed("file site, values", 1.0, lambda: _read(_sites()), toml, _site),
]
