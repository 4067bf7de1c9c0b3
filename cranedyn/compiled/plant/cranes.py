"""Thousands of cranes that differ in arguments of one description, without loading each.

What the dynamics asks of a crane is a row of numbers: masses, first moments, inertias, places, see
`cranedyn.compiled.plant.plant.plant_numbers`. In the arguments of a description these are
polynomials, at most of second degree in each argument, and without terms of more than two
arguments:

    f(x) = f(c) + Σᵢ gᵢ(xᵢ) + Σᵢ<ⱼ hᵢⱼ(xᵢ, xⱼ),

with the arguments c in the middle of their ranges, gᵢ(cᵢ) = 0 and hᵢⱼ = 0 where one of its
arguments is in the middle. Three values of each argument (its nodes) determine such polynomials. So
a few cranes are loaded, all others are interpolated, and some of the others are loaded as well, to
check that this holds.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np

from cranedyn.checks import finite
from cranedyn.compiled.plant.plant import plant_numbers
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, arguments
from cranedyn.model.layout import Layout
from cranedyn.model.load import load_crane

_CHECKED_CRANES = 6
"""Number of cranes that are loaded to check the interpolation."""

_ROUND_OFF = 1e-11
"""Difference of a number from its interpolation that is round-off, over the largest number in its
column.
"""

_FIRST = 0
"""Index of the lowest node of an argument."""

_MIDDLE = 1
"""Index of the middle node of an argument."""

_LAST = 2
"""Index of the highest node of an argument."""


class Cranes:
    """Cranes that differ in numbers only; each is loaded when it is asked for.

    Attributes:
        numbers: Numbers of each crane in a row, as of
            `cranedyn.compiled.plant.plant.plant_numbers`, shape (cranes, k).
        start: Coordinates and rates at the start, shape (cranes, n) each.
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
        self._shared = arguments
        self._varied = varied
        self.numbers = rows
        self.start = start

    @property
    def layout(self) -> Layout:
        """Joints of the cranes, which all have the same."""
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
            return [self[i] for i in range(len(self))[index]]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return load_crane(**self._shared, **_values_of(self._varied, index))


def load_cranes(urdf: str | Path | None = None, **values: Any) -> Cranes:
    """Make many cranes of one description, for `cranedyn.compiled.batch.simulate_batch`.

    Args:
        urdf: As for `load_crane`.
        values: Arguments of the xacro file as for `load_crane`, one for all or an array with one
            for each crane; also coordinates and rates at the start by their symbols, for example
            ``payload_mass=masses, l=lengths, phi=0.1``. Other arguments of `load_crane`, such as
            ``gravity`` or ``joints``, are shared by all.

    Raises:
        OutOfRange: If arrays have different lengths or not one axis, a value is not finite, or is
            none that a crane can have.
        UnknownName: If there is neither an argument nor a coordinate of a name.
        ModelError: If the numbers of the cranes are not such polynomials of the arguments, so that
            they must be loaded one by one; or if the cranes are elastic and their coordinates at
            the start are not given.
    """
    # A list of `driven` joints is one value, and not one for each crane.
    arrays = {}
    for name, value in values.items():
        if isinstance(value, np.ndarray | list) and name != "driven":
            arrays[name] = np.asarray(value, dtype=float)
    count = _common_length(arrays)

    # `values` and `numbers` are parameters of `load_crane`, but no arguments of a crane.
    parameters = {*inspect.signature(load_crane).parameters, *_arguments(urdf)}
    parameters -= {"values", "numbers"}
    start_values = {}
    varied = {}
    shared: dict[str, Any] = {"urdf": urdf}
    for name, value in values.items():
        if name not in parameters:
            start_values[name] = value
        elif name in arrays:
            varied[name] = arrays[name]
        else:
            shared[name] = value

    rows, base = _interpolated_rows(shared, varied, count)
    n = base.layout.n
    start = _start(base, rows[:, -n:], start_values)
    return Cranes(base, shared, varied, rows[:, :-n], start)


def _common_length(arrays: Mapping[str, np.ndarray]) -> int:
    """Return the length of all arrays.

    Raises:
        OutOfRange: If it is not the same, an array has not one axis, or a value is not finite.
    """
    shapes = {name: array.shape for name, array in arrays.items()}
    if any(len(shape) != 1 for shape in shapes.values()) or len(set(shapes.values())) != 1:
        lengths = ", ".join(f"{name} of shape {shape}" for name, shape in shapes.items()) or "none"
        raise OutOfRange("arrays of values", lengths, "one or more of one length")
    for name, array in arrays.items():
        finite(name, array, shapes[name])
    return len(next(iter(arrays.values())))


def _arguments(urdf: str | Path | None) -> list[str]:
    """Return names of the arguments of a description; none of a plain URDF."""
    path = XACRO if urdf is None else Path(urdf)
    return list(arguments(path)) if path.suffix == ".xacro" else []


def _row(crane: Crane) -> np.ndarray:
    """Return the numbers of a crane and its coordinates at the start in a row, shape (k + n,)."""
    return np.concatenate([plant_numbers(crane), crane.start.q])


def _values_of(varied: Mapping[str, np.ndarray], index: int) -> dict[str, Any]:
    """Return the arguments that vary for one crane."""
    return {name: float(array[index]) for name, array in varied.items()}


def _interpolated_rows(
    shared: Mapping[str, Any], varied: Mapping[str, np.ndarray], count: int
) -> tuple[np.ndarray, Crane]:
    """Return the numbers and starts of all cranes, shape (count, k + n), and the crane with each
    argument in the middle.

    Args:
        shared: Arguments of `load_crane` that all cranes share.
        varied: Arguments that vary, shape (count,) each.
        count: Number of cranes.

    Raises:
        ModelError: If the numbers are not polynomials as the module describes.
    """
    nodes = {}
    for name, array in varied.items():
        nodes[name] = np.array([array.min(), (array.min() + array.max()) / 2.0, array.max()])
    # An array of equal values does not vary.
    names = [name for name, (low, _, high) in nodes.items() if high > low]

    def load_at(node_index: Mapping[str, int]) -> Crane:
        """Return the crane with some arguments at a node, by index, all others in the middle."""
        values: dict[str, Any] = {}
        for name in nodes:
            values[name] = float(nodes[name][node_index.get(name, _MIDDLE)])
        return load_crane(**shared, **values)

    base = load_at({})
    middle = _row(base)
    weights = {name: _lagrange(nodes[name], varied[name]) for name in names}

    # Changes with one argument alone, gᵢ at its outer nodes.
    changes = {}
    for name in names:
        for k in (_FIRST, _LAST):
            changes[name, k] = _row(load_at({name: k})) - middle
    rows = np.tile(middle, (count, 1))
    for (name, k), change in changes.items():
        rows += np.outer(weights[name][k], change)

    # Changes with two arguments beyond those with each alone, hᵢⱼ at their outer nodes.
    for first, second in itertools.combinations(names, 2):
        for k, m in itertools.product((_FIRST, _LAST), repeat=2):
            both = _row(load_at({first: k, second: m})) - middle
            change = both - changes[first, k] - changes[second, m]
            rows += np.outer(weights[first][k] * weights[second][m], change)
    _check_interpolation(base, shared, varied, names, rows)
    return rows, base


def _check_interpolation(
    base: Crane,
    shared: Mapping[str, Any],
    varied: Mapping[str, np.ndarray],
    names: Sequence[str],
    rows: np.ndarray,
) -> None:
    """Check the interpolated rows of some cranes against those of the cranes themselves.

    Args:
        base: Crane with each argument in the middle.
        shared: Arguments that all cranes share.
        varied: Arguments that vary.
        names: Names of those whose values differ.
        rows: Interpolated rows, shape (cranes, k + n).

    Raises:
        ModelError: If they differ by more than round-off.
    """
    size = np.abs(rows).max(axis=0)
    must_agree = np.ones(rows.shape[1], dtype=bool)
    if base.springs.any:
        # The coordinates at which an elastic crane hangs are no polynomials.
        must_agree[-base.layout.n :] = False
    generator = np.random.default_rng(0)  # the same cranes in each run
    checked = np.unique(generator.integers(0, len(rows), _CHECKED_CRANES))
    for i in checked.tolist():
        expected = _row(load_crane(**shared, **_values_of(varied, i)))
        agrees = np.abs(expected - rows[i]) <= _ROUND_OFF * size
        if not agrees[must_agree].all():
            argument_names = ", ".join(names)
            raise ModelError(
                f"The numbers of this crane depend on {argument_names} in another way than "
                "load_cranes knows; load them one by one."
            )


def _lagrange(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return Lagrange's polynomials of three nodes at values, shape (3, cranes).

    Polynomial k is Π (x - xⱼ)/(xₖ - xⱼ) over the other nodes j: 1 at node k and 0 at the others.
    """
    polynomials = []
    for own_node in nodes:
        factors = [(values - node) / (own_node - node) for node in nodes if node != own_node]
        polynomials.append(factors[0] * factors[1])
    return np.array(polynomials)


def _start(base: Crane, coordinates: np.ndarray, start_values: Mapping[str, Any]) -> State:
    """Return the starts of the cranes: given coordinates, or those of the description.

    Args:
        base: Crane with each argument in the middle.
        coordinates: Coordinates at the starts that the description gives, shape (cranes, n).
        start_values: Coordinates and rates by their symbols, one for all or one for each crane.

    Raises:
        ModelError: If a crane is elastic and a coordinate of a passive joint is not given.
        OutOfRange: If a coordinate is out of its range.
        UnknownName: If there is no coordinate of a name.
    """
    layout = base.layout
    if base.springs.any:
        passive = [layout.symbols[i] for i in layout.passive]
        missing = [symbol for symbol in passive if symbol not in start_values]
        if missing:
            raise ModelError(
                f"These cranes are elastic, each hangs otherwise; give {', '.join(missing)} at the "
                "start to load_cranes."
            )
    q = coordinates.copy()
    v = np.zeros_like(coordinates)
    for name, value in start_values.items():
        symbol = name.removesuffix("_dot")
        given = q if name == symbol else v
        given[:, layout.index(symbol)] = value

    # If any coordinate is out of its range, the least or the largest of all cranes is.
    extreme_rows = set()
    for i in range(layout.n):
        extreme_rows.add(int(np.argmin(q[:, i])))
        extreme_rows.add(int(np.argmax(q[:, i])))
    for row in extreme_rows:
        base.state(**dict(zip(layout.symbols, q[row].tolist(), strict=True)))
    return State(q, v)
