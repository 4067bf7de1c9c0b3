"""Prior knowledge of a crane, before identification."""

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
class Prior:
    """Description of a crane with prior values of its arguments.

    Attributes:
        urdf: A ``.xacro`` file or a plain URDF; None for the tower crane of this project.
        values: Prior values of arguments of the xacro file.
        gravity: Prior value of gravity [m/s²].
    """

    urdf: str | Path | None = None
    values: Mapping[str, object] = field(default_factory=dict)
    gravity: float = STANDARD_GRAVITY
    _families: dict[Any, Family] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def crane(self) -> Crane:
        """Crane with the prior values."""
        return self.load()

    @cached_property
    def arguments(self) -> dict[str, Argument]:
        """Numeric arguments of the description by name, and gravity."""
        path = XACRO if self.urdf is None else Path(self.urdf)
        declared = arguments(path) if path.suffix == ".xacro" else {}
        numbers = {name: argument for name, argument in declared.items() if argument.allowed}
        return {"gravity": Argument("", "m/s²", "> 0", "gravity of the world"), **numbers}

    def load(self, **values: float) -> Crane:
        """Load the crane with some values changed, gravity among them."""
        merged = {**self.values, **values}
        gravity = float(merged.pop("gravity", self.gravity))  # type: ignore[arg-type]
        return load_crane(self.urdf, gravity=gravity, values=merged)

    def family(self, first: Mapping[str, float], second: Mapping[str, float]) -> Family:
        """Return the cranes of this description, see `Family`; cached."""
        key = (*first.items(), *second.items())
        if key not in self._families:
            self._families[key] = Family(self.load, first, second)
        return self._families[key]

    def value(self, name: str) -> float:
        """Return the prior value of an argument.

        Raises:
            UnknownName: If there is no such argument.
        """
        if name not in self.arguments:
            raise UnknownName("argument", name, self.arguments)
        if name == "gravity":
            return self.gravity
        argument = self.arguments[name]
        return number(
            name, self.values.get(name, argument.default), argument.unit, argument.allowed
        )
