"""Inputs of a batch, shared or one for each crane: checks and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, whole, within
from cranedyn.clocks import Clocks
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.compiled.layout import BufferLayout, size
from cranedyn.compiled.tables import (
    RowTable,
    TableStack,
    drop_repeated_rows,
    gain_table,
    setpoint_table,
    without_gains,
)
from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.controllers.hold import Hold
from cranedyn.dynamics.converters import fitting
from cranedyn.errors import CraneError, Misshapen, OutOfRange
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.plant.cranes import Cranes
from cranedyn.plant.plant import Topology
from cranedyn.references import hold
from cranedyn.references.tabulated import owned, tabulated

_LARGEST = 4e9
"""Largest memory of a batch, tables and records included [byte]."""

_LATEST = 1000
"""Largest delay of a sensor [control periods]."""

_CRANE, _PAIR = 48, 250
"""Numbers stored for each crane, and for each controller with each reference besides their tables:
measured, see `tests/compiled/test_batch.py`."""


class ControlTables(NamedTuple):
    """Tables of controllers and setpoints.

    Attributes:
        gain_table, setpoint_table: The tables.
        integrals: Integrals at the start, shape (cranes, m).
        integrates: Whether any controller integrates.
        predictive: The predictive controller of all cranes; None for those that are affine.
    """

    gain_table: RowTable
    setpoint_table: RowTable
    integrals: np.ndarray
    integrates: bool
    predictive: Receding | None


def crane_count(**arguments: Any) -> int:
    """Return the number of cranes that the arguments have in common.

    Raises:
        OutOfRange: If an argument has neither one item nor as many as the others.
    """
    lengths = {
        name: length for name, value in arguments.items() if (length := _length(value)) is not None
    }
    count = max(lengths.values(), default=1)
    for name, length in lengths.items():
        if length != count or length == 0:
            allowed = f"{max(count, 1)}, as many as there are of others, or one alone for all"
            raise OutOfRange(f"number of {name}s", length, allowed)
    return count


def _length(value: Any) -> int | None:
    if isinstance(value, State):
        try:
            return len(value.q) if np.ndim(value.q) == 2 else None
        except ValueError:  # rows of different lengths
            return None
    several = isinstance(value, Sequence | Cranes) and not isinstance(value, str | bytes)
    return len(value) if several else None


def start_states(start: State | Sequence[State], cranes: int, joints: int) -> State:
    """Return coordinates and rates at the start, shape (cranes, joints) each.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    try:
        q, v = start if isinstance(start, State) else zip(*start, strict=True)
    except (TypeError, ValueError):
        allowed = "a State, one with rows, or a sequence of States"
        raise OutOfRange("start", type(start).__name__, allowed) from None
    shapes = (joints,), (cranes, joints)
    q, v = finite("coordinates at the start", q, *shapes), finite("rates at the start", v, *shapes)
    return State(np.broadcast_to(q, shapes[1]), np.broadcast_to(v, shapes[1]))


def control_tables(
    crane: Crane, controller: Any, reference: Any, start: State, times: np.ndarray, used: int
) -> ControlTables:
    """Return the tables of controllers and references, one for each distinct object; without a
    reference the drives hold their start.

    Args:
        crane: One of the cranes.
        controller: One controller or n.
        reference: One reference or n, or None.
        start: Coordinates and rates at the start, shape (cranes, joints) each.
        times: Control instants [s].
        used: Numbers of memory already used.

    Raises:
        CraneError: If a controller is not affine in the state.
        OutOfRange: If an affine form is not finite, or the tables do not fit into 4 GB.
    """
    cranes, sizes = len(start.q), BufferLayout.of(crane.layout)
    if reference is None and type(controller) is Hold:
        return _hold_tables(controller, sizes, start.q[:, crane.layout.drives], used)
    reference_of, references = _references(crane, reference, start, used)
    controller_of, controllers = distinct_objects(controller, cranes)
    pairs, pair_of = np.unique(controller_of * len(references) + reference_of, return_inverse=True)
    used += _PAIR * len(pairs)
    gains, setpoints = TableStack(), TableStack()
    gains_of_pair, integrals, integrates = [], [], False
    last: dict[int, int] = {}
    for pair in pairs.tolist():
        index, reference_index = divmod(pair, len(references))
        position = tabulated(references[reference_index], times, sizes.m).position
        form = (
            without_gains(sizes, position)
            if isinstance(controllers[index], Receding)
            else _form(controllers[index], times, position, sizes.z)
        )
        integrals.append(form.integral)
        integrates = integrates or bool(form.integral_gain.any())
        setpoints.add(drop_repeated_rows(setpoint_table(sizes, form, len(times))))
        rows = gain_table(sizes, form)
        if index not in last or not np.array_equal(rows, gains.arrays[last[index]]):
            last[index] = gains.add(rows)
        gains_of_pair.append(last[index])
        counts = f"{len(gains.arrays)} and {len(setpoints.arrays)} or more"
        needed = used + 2 * (gains.numbers + setpoints.numbers)
        check_fits_memory("number of controllers and references", counts, needed)
    tables = gains.stacked(np.array(gains_of_pair)[pair_of]), setpoints.stacked(pair_of)
    initial, predictive = np.array(integrals)[pair_of], _predictive(controllers)
    return ControlTables(*tables, initial, integrates, predictive)


def _hold_tables(
    controller: Hold, sizes: BufferLayout, drives: np.ndarray, used: int
) -> ControlTables:
    """Return the tables of a hold controller whose drives stay where they start, shape (cranes, m):
    one row for each crane, or for all where they start alike.
    """
    cranes, places = len(drives), drives[:1] if (drives == drives[0]).all() else drives
    needed = used + 2 * len(places) * size(sizes.setpoint_table)
    check_fits_memory("number of places at which drives start", str(len(places)), needed)
    form = _form(controller, np.zeros(len(places)), places, sizes.z)
    return ControlTables(
        RowTable(gain_table(sizes, form), 1, np.zeros(cranes, dtype=np.int64)),
        RowTable(setpoint_table(sizes, form, len(places)), 1, np.arange(cranes) % len(places)),
        np.broadcast_to(form.integral, (cranes, sizes.m)),
        False,
        None,
    )


def _predictive(controllers: Sequence[Any]) -> Receding | None:
    """Return the predictive controller of all cranes, or None.

    Raises:
        CraneError: If there is another controller.
    """
    predictive = [one for one in controllers if isinstance(one, Receding)]
    if predictive and len(controllers) > 1:
        raise CraneError(
            "A batch has one predictive controller for all cranes, and references that differ; "
            f"these have {len(controllers)} controllers."
        )
    return predictive[0] if predictive else None


def _references(
    crane: Crane, reference: Any, start: State, used: int
) -> tuple[np.ndarray, Sequence[Reference]]:
    """Return the index of each crane's reference, and the references; without any, one hold for
    each start position of the drives.
    """
    if reference is not None:
        return distinct_objects(reference, len(start.q))
    drives = start.q[:, crane.layout.drives]
    if (drives == drives[0]).all():
        first_start = State(*(array.take(0, axis=0) for array in start))
        return distinct_objects(hold(crane, first_start), len(start.q))
    _, rows, index = np.unique(drives, axis=0, return_index=True, return_inverse=True)
    places, needed = "number of places at which drives start", used + _PAIR * len(rows)
    check_fits_memory(places, str(len(rows)), needed)
    return index.ravel(), [hold(crane, State(start.q[i], start.v[i])) for i in rows]


def distinct_objects(value: Any, cranes: int) -> tuple[np.ndarray, Any]:
    """Return the index of each crane's object, shape (n,), and the distinct objects."""
    if isinstance(value, Cranes):
        return np.arange(cranes), value
    if _length(value) is None:
        return np.broadcast_to(0, cranes), [value]
    objects = {id(item): item for item in value}
    number = {key: row for row, key in enumerate(objects)}
    return np.array([number[id(item)] for item in value]), list(objects.values())


def converter_response(
    crane: Crane, drive: str, converters: Any, clock: Clocks
) -> tuple[np.ndarray | None, int | None]:
    """Return the parameters of frequency converters, one row for all cranes or one for each, and
    their delay [control periods]; None for drives without converters.

    Raises:
        OutOfRange: If they do not fit the crane or the clocks, or differ in delay.
    """
    several = isinstance(converters, Sequence)
    fitted = [fitting(crane, drive, item) for item in (converters if several else [converters])]
    present = [item for item in fitted if item is not None]
    if not present:
        return None, None
    lates = [item.delay_steps(clock.dt, clock.period) for item in present]
    if len({*lates}) > 1:
        given = f"{min(lates)} to {max(lates)} control periods"
        raise OutOfRange("delays of converters", given, "all the same")
    return np.array([np.concatenate(item.response) for item in present]), lates[0]


def converter_memory(sizes: BufferLayout, rates: np.ndarray) -> list[np.ndarray]:
    """Return the memory of frequency converters at the start, by section with a row for each crane:
    they continue at the rates of the drives, shape (cranes, m).
    """
    if sizes.delay_steps is None:
        return []
    return [rates, np.zeros_like(rates), *[rates] * sizes.delay_steps]


def common_layout(cranes: Sequence[Crane] | Cranes) -> Layout:
    """Return the layout that all cranes have in common.

    Raises:
        OutOfRange: If a crane differs from the first in joints, drives, points or sprung joints.
    """
    first = Topology.of(cranes[0])
    for crane in () if isinstance(cranes, Cranes) else cranes:
        if crane.layout != first.layout:
            joints = ", ".join(joint.name for joint in crane.layout.joints)
            raise OutOfRange("joints of a crane", joints, "those of the first crane of the batch")
        if Topology.of(crane) != first:
            sprung = zip(crane.layout.joints, crane.springs.elastic, strict=True)
            joints = ", ".join(joint.name for joint, elastic in sprung if elastic)
            name = "joints of a crane with springs"
            raise OutOfRange(name, joints or "none", "those of the first crane of the batch")
    return first.layout


def _form(controller: Any, times: np.ndarray, setpoint: np.ndarray, width: int) -> Affine:
    with owned("controller"):
        common = affine_form(controller, times, setpoint, width)
    if common is None:
        raise CraneError(
            f"{type(controller).__name__} is not affine in the state, or has run before; a batch "
            "needs one that is."
        )
    if lacking := common.lacking():
        values = getattr(common, lacking)
        name = f"{lacking} in the common form of {type(controller).__name__}"
        raise OutOfRange(name, float(values[~np.isfinite(values)][0]), "finite")
    return common


def force_table(force: Any, cranes: int, sizes: BufferLayout) -> RowTable:
    """Return the table of external forces, from shape (rows, 3 points) for all cranes or (cranes,
    rows, 3 points); zero for None.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    if force is None:
        return RowTable(np.zeros((1, size(sizes.force))), 1, np.zeros(cranes, dtype=np.int64))
    columns = size(sizes.force)
    values = finite("force", force, ("m", columns), (cranes, "m", columns), unit="N")
    return _stacked("force", values, cranes, per_crane=values.ndim == 3)


def offset_tables(offset: Any, cranes: int, sizes: BufferLayout) -> tuple[RowTable, ...]:
    """Return the table of sensor offsets of coordinates and rates, from shape (2 n,) for all
    cranes, (cranes, 2 n) or, by control instant, (cranes, rows, 2 n); no table for None.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    if offset is None:
        return ()
    z = sizes.z
    values = finite("sensor_offset", offset, (z,), (cranes, z), (cranes, "m", z))
    by_instant = values if values.ndim == 3 else values.reshape(-1, 1, z)
    return (_stacked("sensor_offset", by_instant, cranes, per_crane=values.ndim > 1),)


def _stacked(name: str, values: np.ndarray, cranes: int, *, per_crane: bool) -> RowTable:
    """Return a table of rows by control instant, shared or one after another for each crane."""
    if not values.size:
        raise Misshapen(name, f"an array of shape {values.shape}", "one with a row at least")
    rows, columns = values.shape[-2:]
    starts = rows * np.arange(cranes) if per_crane else np.broadcast_to(0, cranes)
    return RowTable(np.ascontiguousarray(values.reshape(-1, columns), dtype=float), rows, starts)


def sensor_delays(delay: Any, cranes: int) -> tuple[np.ndarray, int]:
    """Return the sensor delay of each crane [control periods], shape (cranes,), and the number of
    readings to store; 0 without delays.

    Raises:
        OutOfRange: If one is not a whole number from 0 to 1000, or there are not as many as cranes.
    """
    several = isinstance(delay, Sequence | np.ndarray) and not isinstance(delay, str | bytes)
    delays = delay if several else [delay]
    if several and len(delays) != cranes:
        raise OutOfRange("number of sensor delays", len(delays), f"{cranes}, or one alone for all")
    name, unit = "sensor_delay", "control periods"
    periods = [within(name, whole(name, item, 0, unit), 0, _LATEST, unit) for item in delays]
    readings = int(max(periods)) + 1 if max(periods) > 0 else 0
    return np.broadcast_to(np.array(periods, dtype=np.int64), (cranes,)), readings


def required_numbers(
    sizes: BufferLayout, cranes: int, instants: int, periods: int, extra: int
) -> int:
    """Return how many numbers the memory and the record of the cranes take, by lanes and by cranes.

    Args:
        sizes: Buffer layout of each crane.
        cranes: Number of cranes.
        instants: Recorded rows of each crane.
        periods: Control periods of the run.
        extra: Additional numbers of each crane.

    Raises:
        OutOfRange: If they, or the tables of one controller, take more than 4 GB.
    """
    used = cranes * (_CRANE + extra)
    check_fits_memory("number of cranes", str(cranes), used)
    used += 2 * cranes * instants * size(sizes.row)
    check_fits_memory("record", f"{instants} rows of {cranes} cranes", used)
    tables = 2 * periods * (size(sizes.gain_table) + size(sizes.setpoint_table))
    check_fits_memory("duration", f"{periods} control periods", tables)
    return used


def check_fits_memory(name: str, value: str, numbers: int) -> None:
    """Check that so many numbers fit into 4 GB.

    Raises:
        OutOfRange: If not.
    """
    needed = 8 * numbers
    if needed > _LARGEST:
        allowed = f"what takes {_LARGEST / 1e9:g} GB at most; these would take {needed / 1e9:.3g}"
        raise OutOfRange(name, value, f"{allowed} GB")
