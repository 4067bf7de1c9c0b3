"""What a batch is given: one of a kind for all cranes or one for each, checked and laid out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.compiled.layout import AIM, FORCE, LAW, ROW, size
from cranedyn.compiled.tables import NO_FORCE, Table, aim, law, shortened, table
from cranedyn.controllers.affine import Affine, form
from cranedyn.crane import DRIVES, State
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.references import Reference, hold
from cranedyn.references.wanted import tabulated

_LARGEST = 4e9
"""Memory that the tables or the records of a batch may take [byte]."""


class Control(NamedTuple):
    """Controllers and what they are about, as tables.

    Attributes:
        law, aim: The tables.
        integrals: What was integrated before, shape (n, 3).
        integrates: Whether any controller does.
    """

    law: Table
    aim: Table
    integrals: np.ndarray
    integrates: bool


def count(**given: Any) -> int:
    """How many cranes are asked for.

    Raises:
        OutOfRange: If there are neither one nor as many as of the others of something.
    """
    lengths = {name: length for name, value in given.items() if (length := _length(value)) is not None}
    most = max(lengths.values(), default=1)
    for name, length in lengths.items():
        if length != most or length == 0:
            raise OutOfRange(f"number of {name}s", length, f"{max(most, 1)}, as many as there are of others, or one alone for all")
    return most


def _length(value: Any) -> int | None:
    if isinstance(value, State):
        return len(value.q) if np.ndim(value.q) == 2 else None
    return len(value) if isinstance(value, Sequence) else None


def starts(start: State | Sequence[State], cranes: int) -> State:
    """Coordinates and rates at the start, shape (n, 5) each.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    try:
        q, v = start if isinstance(start, State) else zip(*start, strict=True)
    except (TypeError, ValueError):
        raise OutOfRange("start", type(start).__name__, "a State, one with rows, or a sequence of States") from None
    return State(rows("coordinates at the start", q, cranes, 5), rows("rates at the start", v, cranes, 5))


def rows(name: str, value: Any, cranes: int, columns: int) -> np.ndarray:
    """Finite numbers, one row for all or one for each crane, shape (n, columns).

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    try:
        found = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise OutOfRange(name, "no array of numbers", f"an array of shape ({columns},) or ({cranes}, {columns})") from None
    if found.shape not in ((columns,), (cranes, columns)):
        raise OutOfRange(name, f"an array of shape {found.shape}", f"one of shape ({columns},) or ({cranes}, {columns})")
    _finite(name, found)
    return np.broadcast_to(found, (cranes, columns))


def control(controller: Any, reference: Any, start: State, times: np.ndarray) -> Control:
    """Tables of controllers and references, one for each that is another object; None as reference holds the drives at the start.

    Raises:
        CraneError: If a controller is not affine in the state.
        OutOfRange: If the tables would take more than 4 GB.
    """
    cranes = len(start.q)
    aims_of, references = distinct(_references(reference, start), cranes)
    laws_of, controllers = distinct(controller, cranes)
    pairs, pair_of = np.unique(laws_of * len(references) + aims_of, return_inverse=True)
    laws: list[np.ndarray] = []
    aims, integrals, law_of_pair, integrates = [], [], [], False
    last: dict[int, int] = {}
    for which, about in (divmod(pair, len(references)) for pair in pairs.tolist()):
        wanted = tabulated(references[about], times).position
        common = _form(controllers[which], times, wanted)
        integrals.append(common.integral)
        integrates = integrates or bool(common.integral_gain.any())
        aims.append(shortened(aim(common, wanted)))
        rows_of_law = law(common)
        if which not in last or not np.array_equal(rows_of_law, laws[last[which]]):
            last[which] = len(laws)
            laws.append(rows_of_law)
        law_of_pair.append(last[which])
        needed = 2 * (len(laws) * max(map(len, laws)) * size(LAW) + len(aims) * max(map(len, aims)) * size(AIM))
        _fit("number of controllers and references", f"{len(laws)} and {len(aims)} or more", needed)
    return Control(table(laws, np.array(law_of_pair)[pair_of]), table(aims, pair_of), np.array(integrals)[pair_of], integrates)


def _references(reference: Any, start: State) -> Any:
    """The references; where there is none, one hold for each place at which drives start."""
    if reference is not None:
        return reference
    drives = start.q[:, DRIVES]
    if (drives == drives[0]).all():
        return hold(State(start.q[0], start.v[0]))
    holds: dict[bytes, Reference] = {}
    return [holds.setdefault(place.tobytes(), hold(State(q, v))) for place, q, v in zip(drives, *start, strict=True)]


def distinct(value: Any, cranes: int) -> tuple[np.ndarray, list[Any]]:
    """Which of the different objects each crane has, shape (n,), and these."""
    if _length(value) is None:
        return np.zeros(cranes, dtype=int), [value]
    found = {id(one): one for one in value}
    number = {key: row for row, key in enumerate(found)}
    return np.array([number[id(one)] for one in value]), list(found.values())


def _form(controller: Any, times: np.ndarray, wanted: np.ndarray) -> Affine:
    common = form(controller, times, wanted)
    if common is None:
        raise CraneError(f"{type(controller).__name__} is not affine in the state, or has run before; a batch needs one that is.")
    return common


def forces(force: Any, cranes: int) -> Table:
    """A table of outside forces for all cranes, shape (m, 6), or one for each, shape (n, m, 6); None for none.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    if force is None:
        return table([NO_FORCE], np.zeros(cranes, dtype=int))
    columns = size(FORCE)
    try:
        found = np.asarray(force, dtype=float)
    except (TypeError, ValueError):
        raise OutOfRange("force", "no array of numbers", f"an array of shape (m, {columns}) or ({cranes}, m, {columns})", "N") from None
    _finite("force", found, "N")
    if found.ndim == 2 and found.shape[1] == columns and len(found):
        return table([found], np.zeros(cranes, dtype=int))
    if found.ndim == 3 and found.shape[0] == cranes and found.shape[2] == columns and found.shape[1]:
        return table(list(found), np.arange(cranes))
    raise OutOfRange("force", f"an array of shape {found.shape}", f"one of shape (m, {columns}) or ({cranes}, m, {columns})")


def fits(cranes: int, instants: int, periods: int) -> None:
    """Return if what is to be recorded, arranged by lanes and by cranes, and the tables of one controller can fit.

    Raises:
        OutOfRange: If they would take more than 4 GB.
    """
    _fit("record", f"{instants} rows of {cranes} cranes", 2 * cranes * instants * size(ROW))
    _fit("duration", f"{periods} control periods", 2 * periods * (size(LAW) + size(AIM)))


def _fit(name: str, given: str, numbers: int) -> None:
    needed = 8 * numbers
    if needed > _LARGEST:
        raise OutOfRange(name, given, f"what takes {_LARGEST / 1e9:g} GB at most; these would take {needed / 1e9:.3g} GB")


def _finite(name: str, found: np.ndarray, unit: str = "") -> None:
    if not np.isfinite(found).all():
        raise OutOfRange(name, float(found[~np.isfinite(found)][0]), "finite", unit)
