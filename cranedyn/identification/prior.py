"""Prior knowledge of a crane, and the cranes interpolated between its loaded variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.compiled.plant.plant import plant_numbers
from cranedyn.errors import ModelError, UnknownName
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, Argument, arguments
from cranedyn.model.load import load_crane

_LINEARITY_TOLERANCE = 1e-9
"""Largest difference, relative and absolute, between the numbers of an interpolated crane and of a
loaded one."""


class Family:
    """Cranes as a function of some arguments.

    Masses, first moments, inertias, damping and gravity are linear in the arguments that can be
    identified. So a crane at any values follows from one crane at the first values and one further
    crane for each argument, without loading its description again.

    Attributes:
        names: Names of the arguments.
        base: Crane at the first values.
    """

    def __init__(
        self, load: Callable[..., Crane], first: Mapping[str, float], second: Mapping[str, float]
    ) -> None:
        """Load the cranes to interpolate between.

        Args:
            load: Function that loads a crane with values of the arguments.
            first: First value of each argument.
            second: Second value of each argument.

        Raises:
            ModelError: If the cranes are not linear in the arguments.
        """
        self.names = tuple(first)
        self.base = load(**first)
        self._first = np.array(list(first.values()))
        self._row = _linear_numbers(self.base)
        steps = np.array([second[name] for name in self.names]) - self._first
        self._slopes = []
        for name, step in zip(self.names, steps, strict=True):
            changed = {**first, name: second[name]}
            self._slopes.append((_linear_numbers(load(**changed)) - self._row) / step)
        if self.names:
            # A product of two arguments shows only where both are changed.
            ours = plant_numbers(self.at(self._first + steps))
            loaded = plant_numbers(load(**second))
            tolerance = _LINEARITY_TOLERANCE
            if ours.shape != loaded.shape or not np.allclose(ours, loaded, tolerance, tolerance):
                raise ModelError(
                    f"The crane depends on {', '.join(self.names)} in another way than masses, "
                    "inertias, damping and gravity do; such numbers cannot be identified."
                )

    def at(self, values: np.ndarray) -> Crane:
        """Return the crane at values of the arguments, shape (arguments,)."""
        if not self.names:
            return self.base
        row = self._row.copy()
        for slope, value, first in zip(self._slopes, values, self._first, strict=True):
            row += slope * (value - first)
        model = self.base.model.copy()
        n = self.base.layout.n
        bodies = row[: 10 * n].reshape(n, 10)
        for i, inertial in enumerate(bodies, start=1):
            # A body without mass keeps its inertia: Pinocchio divides by the mass.
            if inertial[0] > 0.0:
                model.inertias[i] = pin.Inertia.FromDynamicParameters(inertial)
        model.gravity.linear = np.array([0.0, 0.0, -row[-1]])
        return replace(self.base, model=model, damping=row[10 * n : 11 * n])


def _linear_numbers(crane: Crane) -> np.ndarray:
    """Return the numbers that are linear in the arguments: ten inertial numbers of each of n
    bodies, n dampings, and gravity, shape (11 n + 1,).
    """
    bodies = [inertia.toDynamicParameters() for inertia in list(crane.model.inertias)[1:]]
    return np.concatenate([*bodies, crane.damping, [crane.gravity]])


@dataclass(frozen=True)
class Prior:
    """Description of a crane with prior values of its arguments.

    Attributes:
        urdf: A ``.xacro`` file or a plain URDF; None for the tower crane of this project.
        values: Prior values of arguments of the xacro file.
        gravity: Prior value of gravity [m/s²]; None for that of the file, or standard gravity.
        loading: Further arguments of `cranedyn.load_crane`, such as ``driven``, by name.
    """

    urdf: str | Path | None = None
    values: Mapping[str, object] = field(default_factory=dict)
    gravity: float | None = None
    loading: Mapping[str, Any] = field(default_factory=dict)
    _families: dict[Any, Family] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def crane(self) -> Crane:
        """Crane with the prior values."""
        return self.load()

    @cached_property
    def _declared(self) -> dict[str, Argument]:
        """Numeric arguments of the description by name."""
        path = XACRO if self.urdf is None else Path(self.urdf)
        declared = arguments(path) if path.suffix == ".xacro" else {}
        return {name: argument for name, argument in declared.items() if argument.allowed}

    @cached_property
    def arguments(self) -> dict[str, Argument]:
        """Numeric arguments of the description by name, and gravity; of a description without
        arguments the damping of each passive joint, such as damp_phi.
        """
        found = {"gravity": Argument("", "m/s²", "> 0", "gravity of the world"), **self._declared}
        if self._declared:
            return found
        for i in self.crane.layout.passive.tolist():
            joint = self.crane.layout.joints[i]
            damping = float(self.crane.damping[i])
            unit = f"{joint.effort_unit} s"
            meaning = f"damping of {joint.name}"
            found[f"damp_{joint.symbol}"] = Argument(repr(damping), unit, ">= 0", meaning)
        return found

    def load(self, **values: float) -> Crane:
        """Load the crane with some values changed, gravity among them; of a description without
        arguments also the damping of passive joints.
        """
        merged = {**self.values, **values}
        gravity: Any = merged.pop("gravity", self.gravity)
        dampings = {}
        if not self._declared:
            for name in values:
                if name.startswith("damp_"):
                    dampings[name.removeprefix("damp_")] = merged.pop(name)
        crane = load_crane(self.urdf, gravity=gravity, values=merged, **self.loading)
        if not dampings:
            return crane
        damping = crane.damping.copy()
        for symbol, value in dampings.items():
            damping[crane.layout.index(symbol)] = value
        return replace(crane, damping=damping)

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
            return self.crane.gravity
        argument = self.arguments[name]
        value = self.values.get(name, argument.default)
        return number(name, value, argument.unit, argument.allowed)
