"""What one knows, or believes, of a crane before its records are looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from cranedyn.checks import number
from cranedyn.errors import UnknownName
from cranedyn.identification.family import Family
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import XACRO, Argument, arguments
from cranedyn.model.load import load_crane


@dataclass(frozen=True)
class Known:
    """A description of a crane with the values that one believes in.

    Attributes:
        urdf: A ``.xacro`` file or a plain URDF; None for the tower crane of this project.
        values: Of arguments of the xacro file.
        gravity: [m/s²].
    """

    urdf: str | Path | None = None
    values: Mapping[str, object] = field(default_factory=dict)
    gravity: float = STANDARD_GRAVITY
    _families: dict[Any, Family] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def crane(self) -> Crane:
        """The crane as believed."""
        return self.load()

    @cached_property
    def arguments(self) -> dict[str, Argument]:
        """Arguments of the description that are numbers, by name; gravity is one, too."""
        path = XACRO if self.urdf is None else Path(self.urdf)
        found = arguments(path) if path.suffix == ".xacro" else {}
        numbers = {name: one for name, one in found.items() if one.allowed}
        return {"gravity": Argument("", "m/s²", "> 0", "gravity of the world"), **numbers}

    def load(self, **values: float) -> Crane:
        """The crane with some values changed, gravity among them."""
        given = {**self.values, **values}
        gravity = float(given.pop("gravity", self.gravity))  # type: ignore[arg-type]
        return load_crane(self.urdf, gravity=gravity, values=given)

    def family(self, first: Mapping[str, float], other: Mapping[str, float]) -> Family:
        """Cranes of this description, see `Family`; the same are made once."""
        key = (*first.items(), *other.items())
        if key not in self._families:
            self._families[key] = Family(self.load, first, other)
        return self._families[key]

    def value(self, name: str) -> float:
        """What one believes of an argument.

        Raises:
            UnknownName: If there is no such argument.
        """
        if name not in self.arguments:
            raise UnknownName("argument", name, self.arguments)
        if name == "gravity":
            return self.gravity
        one = self.arguments[name]
        return number(name, self.values.get(name, one.default), one.unit, one.allowed)
