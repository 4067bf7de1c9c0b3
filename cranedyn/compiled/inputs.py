"""Inputs of a batch, shared or one for each crane: checks and tables.

`cranedyn.compiled.batch.simulate_batch` takes most arguments as one for all cranes or one for each.
Here they are checked and become arrays: `crane_count` tells how many cranes there are,
`distinct_objects` which of them share an object, and `control_tables` what their controllers do. On
the way the memory is reckoned up, so that what would not fit is refused before it is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, whole, within
from cranedyn.clocks import Clocks, at_begin_of_run
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.compiled.loop_tables import (
    RowTable,
    TableStack,
    drop_repeated_rows,
    gain_table,
    padded_states,
    setpoint_table,
    without_gains,
)
from cranedyn.compiled.memory_layout import BufferLayout, size
from cranedyn.compiled.plant.cranes import Cranes
from cranedyn.compiled.plant.plant import Topology
from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.controllers.hold import Hold
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.converters import converters_of_run
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP
from cranedyn.errors import CraneError, Misshapen, OutOfRange
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.references import hold
from cranedyn.references.tabulated import owned, tabulated

_MAX_BYTES = 4e9
"""Largest memory of a batch, tables and records included [byte]."""

_BYTES_PER_NUMBER = 8

_MAX_DELAY = 1000
"""Largest delay of a sensor [control periods]."""

_NUMBERS_PER_CRANE = 48
"""Numbers stored for each crane: measured, see `tests/compiled/test_batch.py`."""

_NUMBERS_PER_PAIR = 250
"""Numbers stored for each controller with each reference, besides their tables: measured, see
`tests/compiled/test_batch.py`."""

_COPIES = 2
"""Times that a record or a table stands in memory at once: rows of many cranes are first made, then
arranged in groups or stacked, and results are copied from them."""


class ControlTables(NamedTuple):
    """Tables of controllers and setpoints.

    Attributes:
        gain_table: Rows of the controllers, see `BufferLayout.gain_table`.
        setpoint_table: Rows of the setpoints, see `BufferLayout.setpoint_table`.
        integrals: Integrals at the start, shape (cranes, m).
        integrates: Whether any controller integrates.
        states: States of the controllers at the start, shape (cranes, k); controllers with fewer
            states than another have further ones, which stay zero.
        predictive: The predictive controller of all cranes; None for those that are affine.
    """

    gain_table: RowTable
    setpoint_table: RowTable
    integrals: np.ndarray
    integrates: bool
    states: np.ndarray
    predictive: Receding | None


def crane_count(
    *,
    crane: Any,
    controller: Any,
    reference: Any,
    start: Any,
    converter: Any,
    base: Any,
    start_time: Any = None,
) -> int:
    """Return the number of cranes that arguments of a batch have in common, each of them one object
    for all cranes or a sequence with one for each.

    Raises:
        OutOfRange: If an argument has neither one item nor as many as the others.
    """
    arguments = {
        "crane": crane,
        "controller": controller,
        "reference": reference,
        "start": start,
        "converter": converter,
        "base": base,
        "start time": start_time,
    }
    lengths = {}
    for name, value in arguments.items():
        length = _length(value)
        if length is not None:
            lengths[name] = length
    count = max(lengths.values(), default=1)
    for name, length in lengths.items():
        if length != count or length == 0:
            allowed = f"{max(count, 1)}, as many as there are of others, or one alone for all"
            raise OutOfRange(f"number of {name}s", length, allowed)
    return count


def _length(value: Any) -> int | None:
    """Return the number of objects in an argument; None for a single object."""
    if isinstance(value, State):
        try:
            return len(value.q) if np.ndim(value.q) == 2 else None
        except ValueError:
            return None  # rows of different lengths, which `start_states` refuses
    is_sequence = isinstance(value, Sequence | Cranes) and not isinstance(value, str | bytes)
    return len(value) if is_sequence else None


def start_states(start: State | Sequence[State], cranes: int, joints: int) -> State:
    """Return coordinates and rates at the start, shape (cranes, joints) each.

    Args:
        start: One state for all cranes, one with a row for each, or a sequence of states.
        cranes: Number of cranes.
        joints: Number of joints.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    try:
        q, v = start if isinstance(start, State) else zip(*start, strict=True)
    except (TypeError, ValueError):
        allowed = "a State, one with rows, or a sequence of States"
        raise OutOfRange("start", type(start).__name__, allowed) from None
    one = (joints,)
    each = (cranes, joints)
    q = finite("coordinates at the start", q, one, each)
    v = finite("rates at the start", v, one, each)
    return State(np.broadcast_to(q, each), np.broadcast_to(v, each))


def start_times(t_start: float | Sequence[float], cranes: int) -> np.ndarray:
    """Return the time at the start of each crane [s], shape (cranes,).

    Args:
        t_start: One time for all cranes, or one for each.
        cranes: Number of cranes.

    Raises:
        OutOfRange: If there is another number of them, or one is not from -1e9 to 1e9.
    """
    times = np.atleast_1d(np.asarray(t_start, dtype=float))
    for time in times.tolist():
        number("time at the start", time, "s", "-1e9 to 1e9")
    return np.broadcast_to(finite("times at the start", times, (1,), (cranes,)), (cranes,))


def control_tables(
    crane: Crane,
    controller: Any,
    reference: Any,
    start: State,
    t_start: np.ndarray,
    since_start: np.ndarray,
    used: int,
) -> ControlTables:
    """Return the tables of controllers and references, one for each distinct object and time at
    which it begins; without a reference the drives hold their start.

    Args:
        crane: One of the cranes.
        controller: One controller or n.
        reference: One reference or n, or None.
        start: Coordinates and rates at the start, shape (cranes, joints) each.
        t_start: Time at the start of each crane [s], shape (cranes,).
        since_start: Control instants from there on [s], shape (instants,).
        used: Numbers of memory already used.

    Raises:
        CraneError: If a controller is not affine in the state.
        OutOfRange: If an affine form is not finite, or the tables do not fit into 4 GB.
    """
    cranes = len(start.q)
    sizes = BufferLayout.of(crane.layout)
    if reference is None and type(controller) is Hold:
        return _hold_tables(controller, sizes, start.q[:, crane.layout.drives], used)
    reference_of, references = _references(crane, reference, start, used)
    controller_of, controllers = distinct_objects(controller, cranes)
    # Several cranes may share a controller: it begins its run once for each time of a start, here.
    # From here on, a controller that begins at two times counts as two.
    first_times, time_of = np.unique(t_start, return_inverse=True)
    beginnings = _distinct_pairs(controller_of, time_of)
    begun = []
    times_of_begun = []
    original_of_begun = []
    for controller_index, time_index in beginnings.pairs:
        times = first_times[time_index] + since_start
        begun.append(_at_start(controllers[controller_index], times))
        times_of_begun.append(times)
        original_of_begun.append(controller_index)
    most_states = _most_states(begun, references[0], times_of_begun[0], sizes)
    sizes = replace(sizes, controller_states=most_states)
    used += _COPIES * cranes * most_states

    # A pair is a controller with a reference; each pair that occurs has a setpoint table.
    pairs, pair_of = _distinct_pairs(beginnings.of_crane, reference_of)
    used += _NUMBERS_PER_PAIR * len(pairs)
    gains = TableStack()
    setpoints = TableStack()
    gain_index_of_pair = []
    integrals = []
    states = []
    no_states = np.zeros(0)
    integrates = False
    last_gain_index: dict[int, int] = {}
    for begun_index, reference_index in pairs:
        times = times_of_begun[begun_index]
        position = tabulated(references[reference_index], times, sizes.m).position
        form = _pair_form(begun[begun_index], sizes, times, position)
        integrals.append(form.integral)
        integrates = integrates or bool(form.integral_gain.any())
        states.append(padded_states(form.states, sizes).initial if most_states else no_states)
        setpoints.add(drop_repeated_rows(setpoint_table(sizes, form, len(times))))

        # The gains of most controllers do not depend on the reference. A gain table that equals the
        # last one of the same controller is stored once; pairs are sorted by controller.
        rows = gain_table(sizes, form)
        original = original_of_begun[begun_index]
        last = last_gain_index.get(original)
        if last is None or not np.array_equal(rows, gains.arrays[last]):
            last_gain_index[original] = gains.add(rows)
        gain_index_of_pair.append(last_gain_index[original])

        # Checked in the loop, so that too many tables are refused before all are made.
        counts = f"{len(gains.arrays)} and {len(setpoints.arrays)} or more"
        needed = used + _COPIES * (gains.number_count + setpoints.number_count)
        check_fits_memory("number of controllers and references", counts, needed)
    return ControlTables(
        gain_table=gains.stacked(np.array(gain_index_of_pair)[pair_of]),
        setpoint_table=setpoints.stacked(pair_of),
        integrals=np.array(integrals)[pair_of],
        integrates=integrates,
        states=np.array(states)[pair_of],
        predictive=_predictive(begun),
    )


def _at_start(controller: Any, times: np.ndarray) -> Any:
    """Return a controller as it is at the first of all control instants [s], see `at_begin_of_run`.

    A predictive controller begins a run of its own, see `cranedyn.compiled.batch`.
    """
    if isinstance(controller, Receding):
        return controller
    with owned("controller"):
        return at_begin_of_run(controller, float(times[0]), float(times[1] - times[0]))


def _most_states(
    controllers: Sequence[Any], reference: Reference, times: np.ndarray, sizes: BufferLayout
) -> int:
    """Return the largest number of states of a controller; 0 if none has states.

    Args:
        controllers: The controllers.
        reference: A reference of theirs.
        times: Control instants [s].
        sizes: Layout of the buffers.
    """
    most = 0
    dynamic = [one for one in controllers if hasattr(one, "resume_states")]
    if dynamic:
        first = times[:1]
        position = tabulated(reference, first, sizes.m).position
        for controller in dynamic:
            states = _form(controller, first, position, sizes.z).states
            most = max(most, 0 if states is None else len(states))
    return most


def _pair_form(
    controller: Any, sizes: BufferLayout, times: np.ndarray, position: np.ndarray
) -> Affine:
    """Return the affine form of a controller along setpoints of the drives, shape (rows, m).

    A predictive controller has none: its table has no gains, only the setpoints.
    """
    if isinstance(controller, Receding):
        return without_gains(sizes, position)
    return _form(controller, times, position, sizes.z)


def _hold_tables(
    controller: Hold, sizes: BufferLayout, drives: np.ndarray, used: int
) -> ControlTables:
    """Return the tables of a hold controller whose drives stay where they start.

    A table of one row for each crane takes far less memory than a reference for each.

    Args:
        controller: The controller.
        sizes: Layout of the buffers.
        drives: Positions of the drives at the start, shape (cranes, m).
        used: Numbers of memory already used.

    Raises:
        OutOfRange: If the tables do not fit into 4 GB.
    """
    cranes = len(drives)
    # One place for all cranes, or one for each.
    start_alike = (drives == drives[0]).all()
    places = drives[:1] if start_alike else drives
    needed = used + _COPIES * len(places) * size(sizes.setpoint_table)
    check_fits_memory("number of places at which drives start", str(len(places)), needed)
    # A hold controller does the same at all times. So its form is made once for all cranes, as if
    # each place were the setpoint of another control instant: row k is then that of place k.
    form = _form(controller, np.zeros(len(places)), places, sizes.z)
    gain_rows = gain_table(sizes, form)
    setpoint_rows = setpoint_table(sizes, form, len(places))
    return ControlTables(
        gain_table=RowTable(gain_rows, 1, np.zeros(cranes, dtype=np.int64)),
        # Crane k begins at row k, and all at row 0 where there is a single place.
        setpoint_table=RowTable(setpoint_rows, 1, np.arange(cranes) % len(places)),
        integrals=np.broadcast_to(form.integral, (cranes, sizes.m)),
        integrates=False,
        states=np.zeros((cranes, 0)),
        predictive=None,
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
        first_start = State(start.q[0, :].copy(), start.v[0, :].copy())
        return distinct_objects(hold(crane, first_start), len(start.q))
    _, rows, index = np.unique(drives, axis=0, return_index=True, return_inverse=True)
    needed = used + _NUMBERS_PER_PAIR * len(rows)
    check_fits_memory("number of places at which drives start", str(len(rows)), needed)
    return index.ravel(), [hold(crane, State(start.q[i], start.v[i])) for i in rows]


def distinct_objects(value: Any, cranes: int) -> tuple[np.ndarray, Any]:
    """Return the index of each crane's object, shape (cranes,), and the distinct objects.

    Objects are told apart by identity: equal ones count as two, as comparing them may cost more
    than a second table, and not all can be hashed.
    """
    if isinstance(value, Cranes):
        return np.arange(cranes), value
    if _length(value) is None:
        return np.broadcast_to(0, cranes), [value]
    objects: list[Any] = []
    row_of: dict[int, int] = {}
    for item in value:
        if id(item) not in row_of:
            row_of[id(item)] = len(objects)
            objects.append(item)
    return np.array([row_of[id(item)] for item in value]), objects


class _Pairs(NamedTuple):
    """Distinct pairs of two indices that each crane has.

    Attributes:
        pairs: The pairs that occur, sorted.
        of_crane: Index of each crane's pair among them, shape (cranes,).
    """

    pairs: list[tuple[int, int]]
    of_crane: np.ndarray


def _distinct_pairs(first: np.ndarray, second: np.ndarray) -> _Pairs:
    """Return the distinct pairs of two indices of each crane, shape (cranes,) each."""
    base = int(second.max()) + 1
    numbers, of_crane = np.unique(first * base + second, return_inverse=True)
    return _Pairs([divmod(number, base) for number in numbers.tolist()], of_crane)


def converter_response(
    crane: Crane, drive: str, converters: Any, clock: Clocks
) -> tuple[np.ndarray | None, int | None]:
    """Return the parameters of frequency converters, one row for all cranes or one for each, and
    their delay [control periods]; None for drives without converters.

    Raises:
        OutOfRange: If they do not fit the crane or the clocks, or differ in delay.
    """
    of_each = converters if isinstance(converters, Sequence) else [converters]
    present = []
    for item in of_each:
        fitted = converters_of_run(crane, drive, item)
        if fitted is not None:
            present.append(fitted)
    if not present:
        return None, None
    delays = [item.delay_steps(clock.dt, clock.period) for item in present]
    if min(delays) != max(delays):
        given = f"{min(delays)} to {max(delays)} control periods"
        raise OutOfRange("delays of converters", given, "all the same")
    return np.array([np.concatenate(item.response) for item in present]), delays[0]


def converter_memory(sizes: BufferLayout, rates: np.ndarray) -> list[np.ndarray]:
    """Return the memory of frequency converters at the start, in the order of
    `BufferLayout.converters` with a row for each crane: they go on with the rates at which the
    drives move, shape (cranes, m), and have heard these all the time of their delay.
    """
    if sizes.delay_steps is None:
        return []
    slopes = np.zeros_like(rates)
    return [rates, slopes, *[rates] * sizes.delay_steps]


def common_layout(cranes: Sequence[Crane] | Cranes) -> Layout:
    """Return the layout that all cranes have in common.

    Raises:
        OutOfRange: If a crane differs from the first in joints, drives, points or sprung joints.
    """
    first = Topology.of(cranes[0])
    if isinstance(cranes, Cranes):
        return first.layout  # they have been made of one description
    for crane in cranes:
        if crane.layout != first.layout:
            joints = ", ".join(joint.name for joint in crane.layout.joints)
            raise OutOfRange("joints of a crane", joints, "those of the first crane of the batch")
        if Topology.of(crane) != first:
            pairs = zip(crane.layout.joints, crane.springs.elastic, strict=True)
            sprung = ", ".join(joint.name for joint, elastic in pairs if elastic)
            name = "joints of a crane with springs"
            raise OutOfRange(name, sprung or "none", "those of the first crane of the batch")
    return first.layout


def _form(controller: Any, times: np.ndarray, setpoint: np.ndarray, width: int) -> Affine:
    """Return the affine form of a controller.

    Args:
        controller: The controller.
        times: Control instants [s].
        setpoint: Setpoints of the drives at these, shape (rows, m).
        width: Number of coordinates and rates together.

    Raises:
        CraneError: If the controller is not affine in the state.
        OutOfRange: If a number of its form is not finite.
    """
    with owned("controller"):
        form = affine_form(controller, times, setpoint, width)
    if form is None:
        raise CraneError(
            f"{type(controller).__name__} is not affine in the state, or has run before; a batch "
            "needs one that is."
        )
    lacking = form.not_finite_field()
    if lacking:
        values = getattr(form, lacking)
        name = f"{lacking} in the common form of {type(controller).__name__}"
        raise OutOfRange(name, float(values[~np.isfinite(values)][0]), "finite")
    return form


def force_table(force: Any, cranes: int, sizes: BufferLayout) -> RowTable:
    """Return the table of external forces, from shape (rows, 3 points) for all cranes or (cranes,
    rows, 3 points); zero for None.

    Raises:
        OutOfRange: If they have another shape, or one is not finite.
    """
    columns = size(sizes.force)
    if force is None:
        return RowTable(np.zeros((1, columns)), 1, np.zeros(cranes, dtype=np.int64))
    values = finite("force", force, ("m", columns), (cranes, "m", columns), unit="N")
    return _stacked("force", values, cranes, per_crane=values.ndim == 3)


def force_in_base_axes(force: Any, base: Any, cranes: int, times: np.ndarray) -> Any:
    """Return forces in the axes of bases that move, a row for each control instant, from those in
    the world, as `force_table` takes them; those that are given if there are none, or no base. From
    one instant to the next they are held in these axes.

    Args:
        force: The forces; beyond the end of their rows the last row applies.
        base: Motion of the base, one for all cranes or one for each.
        cranes: Number of cranes.
        times: Control instants [s], shape (instants,).
    """
    if force is None or base is None:
        return force
    values = finite("force", force, ("m", "k"), ("n", "m", "k"), unit="N")
    if values.shape[-1] % 3 or not values.size:
        return force  # which `force_table` refuses
    instants = len(times)
    row_of_instant = np.minimum(np.arange(instants), values.shape[-2] - 1)
    vectors = values[..., row_of_instant, :].reshape(*values.shape[:-2], instants, -1, 3)
    index, motions = distinct_objects(base, cranes)
    rotations = np.array([motion.frames(times).rotation for motion in motions])
    if len(motions) == 1:
        turned = np.einsum("kij,...kpi->...kpj", rotations[0], vectors)
    else:
        of_each = np.broadcast_to(vectors, (cranes, *vectors.shape[-3:]))
        turned = np.einsum("ckij,ckpi->ckpj", rotations[index], of_each)
    return turned.reshape(*turned.shape[:-3], instants, values.shape[-1])


def root_table(
    base: Any,
    cranes: Sequence[Crane] | Cranes,
    crane_index: np.ndarray,
    t_start: float,
    clock: Clocks,
    used: int,
) -> RowTable | None:
    """Return the motion of the bases of all cranes, a row for each half physics step, see
    `cranedyn.dynamics.root_motion.RootMotion`; None for a base at rest, which is given as None.

    Args:
        base: Motion of the base, one for all cranes or one for each.
        cranes: The distinct cranes.
        crane_index: Index of each crane among them, shape (cranes,).
        t_start: Time at the start [s].
        clock: How the run is divided.
        used: Numbers of memory already used.

    Raises:
        OutOfRange: If one is no motion, or is not known for the whole run, or if they do not fit
            into 4 GB.
    """
    if base is None:
        return None
    motion_index, motions = distinct_objects(base, len(crane_index))
    for motion in motions:
        if not isinstance(motion, BaseMotion):
            allowed = "a BaseMotion, such as BaseMotion.sines(heave=(1.0, 8.0))"
            raise OutOfRange("base", type(motion).__name__, allowed)
    if isinstance(cranes, Cranes):
        # They are of one description, which has one gravity.
        cranes = [cranes[0]]
        crane_index = np.zeros_like(crane_index)
    gravities, gravity_of = np.unique(
        [crane.model.gravity.linear for crane in cranes], axis=0, return_inverse=True
    )
    # What a crane feels depends on its base and its gravity: each pair of them has a part.
    pairs, pair_of = _distinct_pairs(motion_index, gravity_of.ravel()[crane_index])
    length = SAMPLES_PER_STEP * clock.periods * clock.steps + 1
    needed = used + _COPIES * len(pairs) * length * ROOT_NUMBERS
    check_fits_memory("physics steps on a base", str(length), needed)
    times = t_start + clock.dt / SAMPLES_PER_STEP * np.arange(length)
    rows = [motions[i].frames(times).root_numbers(gravities[k]) for i, k in pairs]
    return RowTable(np.concatenate(rows), length, length * pair_of)


def common_gravity(cranes: Sequence[Crane]) -> np.ndarray:
    """Return the gravity of all cranes [m/s²], shape (3,), for cranes on bases that move: it is
    part of what they feel.

    Raises:
        OutOfRange: If they have different gravity.
    """
    gravity = cranes[0].model.gravity.linear.copy()
    for crane in cranes:
        if not np.array_equal(crane.model.gravity.linear, gravity):
            values = f"{crane.gravity:g} and {cranes[0].gravity:g}"
            raise OutOfRange("gravity of the cranes", values, "one on a moving base", "m/s²")
    return gravity


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
    length, columns = values.shape[-2:]
    starts = length * np.arange(cranes) if per_crane else np.broadcast_to(0, cranes)
    rows = np.ascontiguousarray(values.reshape(-1, columns), dtype=float)
    return RowTable(rows, length, starts)


def sensor_delays(delay: Any, cranes: int) -> tuple[np.ndarray, int]:
    """Return the sensor delay of each crane [control periods], shape (cranes,), and the number of
    readings to store; 0 without delays.

    Raises:
        OutOfRange: If one is not a whole number from 0 to 1000, or there are not as many as cranes.
    """
    is_sequence = isinstance(delay, Sequence | np.ndarray) and not isinstance(delay, str | bytes)
    delays = delay if is_sequence else [delay]
    if is_sequence and len(delays) != cranes:
        raise OutOfRange("number of sensor delays", len(delays), f"{cranes}, or one alone for all")
    name = "sensor_delay"
    unit = "control periods"
    periods = [within(name, whole(name, item, 0, unit), 0, _MAX_DELAY, unit) for item in delays]
    longest = int(max(periods))
    readings = longest + 1 if longest > 0 else 0  # the present one is stored before it is read
    return np.broadcast_to(np.array(periods, dtype=np.int64), (cranes,)), readings


def required_numbers(
    sizes: BufferLayout, cranes: int, instants: int, periods: int, extra: int
) -> int:
    """Return how many numbers the memory and the record of the cranes take, both arranged in lanes
    and as rows by crane.

    Args:
        sizes: Buffer layout of each crane.
        cranes: Number of cranes.
        instants: Recorded rows of each crane.
        periods: Control periods of the run.
        extra: Additional numbers of each crane.

    Raises:
        OutOfRange: If they, or the tables of one controller, take more than 4 GB.
    """
    used = cranes * (_NUMBERS_PER_CRANE + extra)
    check_fits_memory("number of cranes", str(cranes), used)
    used += _COPIES * cranes * instants * size(sizes.row)
    check_fits_memory("record", f"{instants} rows of {cranes} cranes", used)
    columns = size(sizes.gain_table) + size(sizes.setpoint_table)
    tables = _COPIES * periods * columns
    check_fits_memory("duration", f"{periods} control periods", tables)
    return used


def check_fits_memory(name: str, value: str, numbers: int) -> None:
    """Check that so many numbers fit into 4 GB.

    Raises:
        OutOfRange: If not.
    """
    needed = _BYTES_PER_NUMBER * numbers
    if needed > _MAX_BYTES:
        largest = f"what takes {_MAX_BYTES / 1e9:g} GB at most"
        raise OutOfRange(name, value, f"{largest}; these would take {needed / 1e9:.3g} GB")
