"""Many cranes at once, each with numbers, start, controller and reference of its own, one in each lane of the processor's vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.clocks import clocks
from cranedyn.compiled.checked import check, compiled
from cranedyn.compiled.kernel import AIM, FORCE, LAW, ROW, STATE, SUMMARY, Recipe, places, size
from cranedyn.compiled.memory import grouped, run, ungrouped
from cranedyn.compiled.tables import NO_FORCE, Table, aim, law, shortened, table
from cranedyn.controllers.affine import form
from cranedyn.crane import DRIVES, Crane, State
from cranedyn.errors import CraneError, OutOfRange, number, within
from cranedyn.integrator import Integrator, semi_implicit_euler
from cranedyn.references import Reference, hold
from cranedyn.references.wanted import tabulated
from cranedyn.simulate import Controller, Drive

_LANES = 8
_CHECKED = 16
"""Cranes of a batch whose accelerations are compared with Pinocchio's; the code is the same for all."""

_LARGEST = 4e9
"""Memory that tables and records of a batch may take [byte]."""


@dataclass(frozen=True, eq=False)
class Batch:
    """What became of n cranes; a crane that diverged has numbers that are not finite.

    Attributes:
        end: Coordinates and rates at the end, shape (n, 5) each.
        peak_swing: Largest swing, radial and tangential together [rad], shape (n,).
        residual_swing: Largest amplitude of the swing from `residual_from` on [rad], see `cranedyn.analysis.swing_amplitude`, shape (n,).
        largest_effort: Of slew, trolley, hoist [N m, N, N], shape (n, 3).
        valid_until: Time at which the model ceased to hold, see `cranedyn.watch` [s]; inf where it held throughout; shape (n,).
        t: Times of the recorded rows [s], shape (m,).
        q, v: Coordinates and rates at these, shape (n, m, 5) each.
        command, effort: What the controllers asked for and what acted, shape (n, m, 3) each.
        energy: Mechanical energy [J], shape (n, m).
    """

    end: State
    peak_swing: np.ndarray
    residual_swing: np.ndarray
    largest_effort: np.ndarray
    valid_until: np.ndarray
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    command: np.ndarray
    effort: np.ndarray
    energy: np.ndarray

    def __len__(self) -> int:
        """Number of cranes."""
        return len(self.peak_swing)


def simulate_batch(
    crane: Crane | Sequence[Crane],
    controller: Controller | Sequence[Controller],
    reference: Reference | Sequence[Reference] | None = None,
    *,
    start: State | Sequence[State],
    since: float = 0.0,
    duration: float,
    dt: float = 5e-4,
    control_period: float = 5e-3,
    drive: Drive = "effort",
    force: np.ndarray | None = None,
    sensor_offset: np.ndarray | None = None,
    buffers: bool = False,
    integrator: Integrator = semi_implicit_euler,
    residual_from: float | None = None,
    record: int = 0,
    threads: int | None = None,
) -> Batch:
    """Run many cranes under controllers that are affine in the state, by compiled code; each does what `simulate` does with watch = mark.

    What is given once is for all cranes. A controller or reference that several cranes share should be the same object: its table is then
    kept once.

    Args:
        crane: One crane or n.
        controller: One or n, such as `Hold`, `Tracking`, `HoistIntegral` or `Follow`. Those with a memory begin with what they remember,
            and are left as they are.
        reference: One or n; None holds the drives where they start.
        start: One state, n states, or one with n rows.
        since: Time at the start [s].
        duration: How long to run [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].
        drive: What the controllers command, see `simulate`.
        force: From outside in the world [N] at each control instant, on payload and trolley, shape (m, 6) for all or (n, m, 6); beyond its
            end the last row holds. Wind that depends on how the load moves needs `simulate`.
        sensor_offset: What the sensors add to coordinates and rates, shape (10,) for all or (n, 10).
        buffers: Whether buffers end the ranges of the drives.
        integrator: The stepping rule.
        residual_from: When swing begins to count as residual [s], within the run; by default at its end.
        record: Record every that manieth control instant; 0 for none.
        threads: How many; by default one for each processor.

    Raises:
        OutOfRange: If numbers of cranes differ, an array has another shape or a number that is not finite, a time is not in the run, or
            records or tables would not fit into 4 GB.
        CraneError: If a controller is not affine in the state.
        ModelError: If the code would not do what Pinocchio does.
    """
    clock = clocks(duration, dt, control_period)
    if drive not in ("effort", "motion"):
        raise OutOfRange("drive", drive, "effort or motion")
    if buffers and drive != "effort":
        raise OutOfRange("buffers", buffers, "False where the drives follow prescribed motion")
    number("time at the start", since, "s", "-1e9 to 1e9")
    after = clock.periods
    if residual_from is not None:
        first = (within("residual_from", residual_from, since, since + duration, "s") - since) / control_period
        after = min(after, math.ceil(first - 1e-6))
    every = _whole("record", record, 0)
    rows = clock.periods // every + 1 if every else 0
    workers = None if threads is None else _whole("threads", threads, 1)
    count = _count(crane=crane, controller=controller, reference=reference, start=start)
    _fits("record", f"{rows} rows of {count} cranes", 2 * count * rows * size(ROW))
    _fits("duration", f"{clock.periods} control periods", 2 * clock.periods * (size(LAW) + size(AIM)))
    cranes, state = _each(crane, count), _starts(start, count)
    times = since + control_period * np.arange(clock.periods + 1)
    laws, aims, integrals, integrates = _tables(_each(controller, count), reference, state, times)
    forces = _forces(force, count)
    offsets = None if sensor_offset is None else _rows("sensor_offset", sensor_offset, count, 10)
    recipe = Recipe(
        _LANES,
        drive,
        integrator,
        buffers,
        integral=integrates,
        offset=offsets is not None,
        forces=force is not None,
        shared=(laws.shared, aims.shared, forces.shared),
        log=rows > 0,
        summary=True,
    )
    distinct = {id(one): one for one in cranes}
    code, varied = compiled(list(distinct.values()), recipe)
    for one, own in list(zip(distinct.values(), varied, strict=True))[:_CHECKED]:
        check(one, code, own)
    which = {key: row for row, key in enumerate(distinct)}
    memory = {
        "state": grouped(np.concatenate([state.q, state.v, integrals, np.zeros((count, 4))], axis=1), _LANES),
        "numbers": grouped(varied[[which[id(one)] for one in cranes]], _LANES),
        "starts": grouped(np.stack([laws.starts, aims.starts, forces.starts], axis=1), _LANES),
        "summary": grouped(np.tile([0.0, 0.0, math.inf, 0.0, 0.0, 0.0], (count, 1)), _LANES),
    }
    memory["log"] = np.empty((len(memory["state"]), rows * size(ROW), _LANES))
    if offsets is not None:
        memory["offset"] = grouped(offsets, _LANES)
    run(
        code,
        memory,
        workers,
        law=laws.rows,
        aim=aims.rows,
        force=forces.rows,
        law_rows=laws.length,
        aim_rows=aims.length,
        force_rows=forces.length,
        first=0,
        last=clock.periods + 1,
        end=clock.periods,
        steps=clock.steps,
        small=clock.small,
        every=max(every, 1),
        after=after,
        dt=dt,
        period=control_period,
    )
    state_at, row_at, kept_at = places(STATE), places(ROW), places(SUMMARY)
    ended, kept = (ungrouped(memory[name], count) for name in ("state", "summary"))
    log = ungrouped(memory["log"], count).reshape(count, rows, size(ROW))
    first_invalid = kept[:, kept_at["invalid"]][:, 0]
    return Batch(
        end=State(ended[:, state_at["q"]], ended[:, state_at["v"]]),
        peak_swing=np.sqrt(kept[:, kept_at["peak"]][:, 0]),
        residual_swing=np.sqrt(kept[:, kept_at["residual"]][:, 0]),
        largest_effort=kept[:, kept_at["effort"]],
        valid_until=since + control_period * first_invalid,
        t=times[:: max(every, 1)][:rows],
        **{name: log[:, :, row_at[name]] for name in ("q", "v", "command", "effort")},
        energy=log[:, :, row_at["energy"]][:, :, 0],
    )


def _count(**given: Any) -> int:
    """How many cranes are asked for: what is a sequence must be as long as the others."""
    lengths = {name: _length(value) for name, value in given.items()}
    counts = {name: length for name, length in lengths.items() if length is not None}
    count = max(counts.values(), default=1)
    for name, length in counts.items():
        if length != count or length == 0:
            raise OutOfRange(f"number of {name}s", length, f"{max(count, 1)}, as many as there are of others, or one alone for all")
    return count


def _length(value: Any) -> int | None:
    if isinstance(value, State):
        return len(value.q) if np.ndim(value.q) == 2 else None
    return len(value) if isinstance(value, Sequence) else None


def _each(value: Any, count: int) -> Sequence[Any]:
    return value if _length(value) is not None else [value] * count


def _starts(start: State | Sequence[State], count: int) -> State:
    """One row for each crane."""
    try:
        q, v = start if isinstance(start, State) else zip(*start, strict=True)
    except (TypeError, ValueError):
        raise OutOfRange("start", type(start).__name__, "a State, one with rows, or a sequence of States") from None
    return State(_rows("coordinates at the start", q, count, 5), _rows("rates at the start", v, count, 5))


def _rows(name: str, value: Any, count: int, columns: int) -> np.ndarray:
    try:
        rows = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise OutOfRange(name, "no array of numbers", f"an array of shape ({columns},) or ({count}, {columns})") from None
    if rows.shape not in ((columns,), (count, columns)):
        raise OutOfRange(name, f"an array of shape {rows.shape}", f"one of shape ({columns},) or ({count}, {columns})")
    if not np.isfinite(rows).all():
        raise OutOfRange(name, float(rows[~np.isfinite(rows)][0]), "finite")
    return np.broadcast_to(rows, (count, columns))


def _whole(name: str, value: Any, least: int) -> int:
    if not isinstance(value, int | np.integer) or value < least:
        raise OutOfRange(name, value, f"a whole number >= {least}")
    return int(value)


def _tables(controllers: Sequence[Controller], reference: Any, start: State, times: np.ndarray) -> tuple[Table, Table, np.ndarray, bool]:
    """Tables of controllers and of what they are about, integrals at the start, shape (n, 3), and whether there are any."""
    given = _length(reference) is not None
    laws: list[np.ndarray] = []
    aims: list[np.ndarray] = []
    integrals: list[np.ndarray] = []
    integrates = False
    found: dict[tuple[int, int | bytes], tuple[int, int]] = {}
    last_law: dict[int, int] = {}
    chosen, lengths = [], (0, 0)
    for k, controller in enumerate(controllers):
        one = reference[k] if given else hold(State(start.q[k], start.v[k])) if reference is None else reference
        key = (id(controller), start.q[k, DRIVES].tobytes() if reference is None else id(one))
        if key not in found:
            wanted = tabulated(one, times).position
            common = form(controller, times, wanted)
            if common is None:
                raise CraneError(f"{type(controller).__name__} is not affine in the state, or has run before; a batch needs one that is.")
            integrals.append(common.integral)
            integrates = integrates or bool(common.integral_gain.any())
            aims.append(shortened(aim(common, wanted)))
            rows = law(common)
            if id(controller) not in last_law or not np.array_equal(rows, laws[last_law[id(controller)]]):
                last_law[id(controller)] = len(laws)
                laws.append(rows)
            found[key] = last_law[id(controller)], len(aims) - 1
            lengths = max(lengths[0], len(rows)), max(lengths[1], len(aims[-1]))
            needed = 2 * (len(laws) * lengths[0] * size(LAW) + len(aims) * lengths[1] * size(AIM))
            _fits("number of controllers and references", f"{len(laws)} and {len(aims)} or more", needed)
        chosen.append(found[key])
    law_of, aim_of = zip(*chosen, strict=True)
    return table(laws, law_of), table(aims, aim_of), np.array(integrals)[list(aim_of)], integrates


def _forces(force: np.ndarray | None, count: int) -> Table:
    if force is None:
        return table([NO_FORCE], [0] * count)
    columns = size(FORCE)
    try:
        rows = np.asarray(force, dtype=float)
    except (TypeError, ValueError):
        raise OutOfRange("force", "no array of numbers", f"an array of shape (m, {columns}) or ({count}, m, {columns})", "N") from None
    if not np.isfinite(rows).all():
        raise OutOfRange("force", float(rows[~np.isfinite(rows)][0]), "finite", "N")
    if rows.ndim == 2 and rows.shape[1] == columns and len(rows):
        return table([rows], [0] * count)
    if rows.ndim == 3 and rows.shape[0] == count and rows.shape[2] == columns and rows.shape[1]:
        return table(list(rows), range(count))
    raise OutOfRange("force", f"an array of shape {rows.shape}", f"one of shape (m, {columns}) or ({count}, m, {columns})")


def _fits(name: str, given: str, numbers: int) -> None:
    """Refuse what would take more memory than there should be."""
    needed = 8 * numbers
    if needed > _LARGEST:
        raise OutOfRange(name, given, f"what takes {_LARGEST / 1e9:g} GB at most; these would take {needed / 1e9:.3g} GB")
