"""Thousands of cranes that differ in arguments of one description, without loading each.

What the dynamics asks of a crane is a row of numbers (`cranedyn.plant.plant.numbers`): masses,
first moments, inertias, places. In the arguments of a description these are polynomials: at most of
second degree in each argument, and no term of more than two of them. So a few cranes that are
loaded tell all others, and some of the others are loaded to see whether that is so.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, overload

import numpy as np

from cranedyn.checks import finite
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, arguments
from cranedyn.model.layout import Layout
from cranedyn.model.load import load_crane
from cranedyn.plant.plant import numbers

_LOOKED_AT = 6
"""How many of the cranes are loaded to compare."""

_AGREES = 1e-11
"""By which share of the largest number in a column they may differ: round-off."""


class Cranes:
    """Cranes that differ in numbers only; each is loaded when it is asked for.

    Attributes:
        numbers: Of each crane in a row, as `cranedyn.plant.plant.numbers`, shape (cranes, k).
        start: Where each starts, shape (cranes, n) each.
    """

    def __init__(
        self,
        base: Crane,
        arguments: Mapping[str, Any],
        varied: Mapping[str, np.ndarray],
        rows: np.ndarray,
        start: State,
    ) -> None:
        """Keep the numbers of the cranes and the arguments that make them.

        Args:
            base: Crane with the middle of each argument.
            arguments: Arguments of `load_crane` that all cranes share.
            varied: Arguments that vary, shape (cranes,) each.
            rows: Numbers of the cranes.
            start: Starts of the cranes.
        """
        self._base = base
        self._made = arguments
        self._varied = varied
        self.numbers = rows
        self.start = start

    @property
    def layout(self) -> Layout:
        """That of all of them."""
        return self._base.layout

    def __len__(self) -> int:
        """Return the number of cranes."""
        return len(self.numbers)

    @overload
    def __getitem__(self, index: int) -> Crane: ...

    @overload
    def __getitem__(self, index: slice) -> list[Crane]: ...

    def __getitem__(self, index: int | slice) -> Crane | list[Crane]:
        """Load one or some of the cranes again and return them."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        values: dict[str, Any] = {name: float(array[index]) for name, array in self._varied.items()}
        return load_crane(**self._made, **values)


def load_cranes(urdf: str | Path | None = None, **values: Any) -> Cranes:
    """Make many cranes of one description, for `cranedyn.compiled.batch.simulate_batch`.

    Args:
        urdf: As for `load_crane`.
        values: Arguments of the xacro file as for `load_crane`, one for all or an array with one
            for each crane; also coordinates and rates at the start by their symbols, for example
            ``payload_mass=masses, l=lengths, phi=0.1``. What `load_crane` takes besides, such as
            ``gravity`` or ``joints``, is for all.

    Raises:
        OutOfRange: If arrays have different lengths or not one axis, a value is not finite, or is
            none that a crane can have.
        UnknownName: If there is neither an argument nor a coordinate of a name.
        ModelError: If the numbers of the cranes are not such polynomials of the arguments, so that
            they must be loaded one by one; or if they are elastic and it is not said where they
            start.
    """
    parameters = {*inspect.signature(load_crane).parameters, *_arguments(urdf)}
    parameters -= {"values", "numbers"}
    arrays = {
        name: np.asarray(value, dtype=float)
        for name, value in values.items()
        if isinstance(value, np.ndarray | list) and name != "driven"
    }
    shapes = {name: array.shape for name, array in arrays.items()}
    if any(len(shape) != 1 for shape in shapes.values()) or len(set(shapes.values())) != 1:
        lengths = ", ".join(f"{name} of shape {shape}" for name, shape in shapes.items()) or "none"
        raise OutOfRange("arrays of values", lengths, "one or more of one length")
    for name, array in arrays.items():
        finite(name, array, shapes[name])
    of_start = {name: value for name, value in values.items() if name not in parameters}
    varied = {name: array for name, array in arrays.items() if name in parameters}
    shared = {n: value for n, value in values.items() if n not in {**of_start, **varied}}
    rows, base = _numbers({"urdf": urdf, **shared}, varied, next(iter(shapes.values()))[0])
    start = _start(base, rows[:, -base.layout.n :], of_start)
    return Cranes(base, {"urdf": urdf, **shared}, varied, rows[:, : -base.layout.n], start)


def _arguments(urdf: str | Path | None) -> list[str]:
    """Return names of the arguments of a description; none of a plain URDF."""
    path = XACRO if urdf is None else Path(urdf)
    return list(arguments(path)) if path.suffix == ".xacro" else []


def _row(crane: Crane) -> np.ndarray:
    """Return the numbers of a crane and its start."""
    return np.concatenate([numbers(crane), crane.start.q])


def _numbers(
    arguments: Mapping[str, Any], varied: Mapping[str, np.ndarray], count: int
) -> tuple[np.ndarray, Crane]:
    """Return the numbers and starts of all cranes, shape (count, k + n), and the crane in the
    middle.
    """
    nodes = {
        name: np.array([array.min(), (array.min() + array.max()) / 2.0, array.max()])
        for name, array in varied.items()
    }
    names = [name for name, (low, _, high) in nodes.items() if high > low]

    def at(**node_index: int) -> Crane:
        """Return the crane with some arguments at their first or last node, all others in the
        middle.
        """
        values: dict[str, Any] = {
            name: float(nodes[name][node_index.get(name, 1)]) for name in nodes
        }
        return load_crane(**arguments, **values)

    base = at()
    middle = _row(base)
    shares = {name: _lagrange(nodes[name], varied[name]) for name in names}
    alone = {(name, k): _row(at(**{name: k})) - middle for name in names for k in (0, 2)}
    rows = np.tile(middle, (count, 1))
    for (name, k), change in alone.items():
        rows += np.outer(shares[name][k], change)
    for first, second in itertools.combinations(names, 2):
        for k, m in itertools.product((0, 2), repeat=2):
            change = _row(at(**{first: k, second: m})) - middle - alone[first, k] - alone[second, m]
            rows += np.outer(shares[first][k] * shares[second][m], change)
    size = np.abs(rows).max(axis=0)
    certain = np.ones(rows.shape[1], dtype=bool)
    if base.springs.any:  # where an elastic crane hangs is no polynomial
        certain[-base.layout.n :] = False
    for i in np.unique(np.random.default_rng(0).integers(0, count, _LOOKED_AT)).tolist():
        values: dict[str, Any] = {name: float(array[i]) for name, array in varied.items()}
        expected = _row(load_crane(**arguments, **values))
        if not (np.abs(expected - rows[i]) <= _AGREES * size)[certain].all():
            argument_names = ", ".join(names)
            raise ModelError(
                f"The numbers of this crane depend on {argument_names} in another way than "
                "load_cranes knows; load them one by one."
            )
    return rows, base


def _lagrange(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return Lagrange's polynomials of three nodes at values, shape (3, cranes)."""
    factors = [[(values - node) / (end - node) for node in nodes if node != end] for end in nodes]
    return np.prod(factors, axis=1)


def _start(base: Crane, coordinates: np.ndarray, start_values: Mapping[str, Any]) -> State:
    """Return the starts of the cranes: given coordinates, or those of the description."""
    layout = base.layout
    if base.springs.any and (
        missing := [
            symbol
            for symbol in (layout.symbols[i] for i in layout.passive)
            if symbol not in start_values
        ]
    ):
        raise ModelError(
            f"These cranes are elastic, each hangs otherwise; give {', '.join(missing)} at the "
            "start to load_cranes."
        )
    q, v = coordinates.copy(), np.zeros_like(coordinates)
    for name, value in start_values.items():
        symbol = name.removesuffix("_dot")
        (q if name == symbol else v)[:, layout.index(symbol)] = value
    # Out of a range is one of these.
    for row in {
        int(extreme(q[:, i])) for i in range(layout.n) for extreme in (np.argmin, np.argmax)
    }:
        base.state(**dict(zip(layout.symbols, q[row].tolist(), strict=True)))
    return State(q, v)
