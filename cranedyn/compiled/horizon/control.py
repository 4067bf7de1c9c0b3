"""Command of a predictive controller at a control instant, in code.

A plan begins with a filtered swing, since the swing sensors are the worst of a crane: the swing
predicted by the model under the measured motion of the drives, corrected by a share of its
difference from the measured swing. The rope tension is limited by measured rates.

Where drives take velocities, a plan begins with the rates that were planned, not those measured:
the drives lag by an uncertain time, and a plan from the measured rates would demand ever more. The
measured rates correct the planned ones slowly.

Between optimisations the planned accelerations are held and converted to efforts at every control
instant by inverse dynamics. A difference between expected and measured rates, such as by another
load mass, is estimated as a disturbance and subtracted. Efforts are clipped to the limits of the
drives, and the hoist keeps the least tension of the rope.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, INTEGER, Code, Value
from cranedyn.compiled.horizon import interior, model, planning, riccati
from cranedyn.compiled.horizon.memory import MemoryRows, Programme, lane_memory
from cranedyn.dynamics.scalars import array, clipped


def emit_plan(
    module: ir.Module, programme: Programme, lanes: int = 1
) -> list[tuple[str, int, int, float]]:
    """Add the function `plan` and what it calls, for a crane in each lane; return the constants in
    the memory of each stage: name of the row, its number, place, value.
    """
    shape = programme.shape(lanes)
    crane = programme.plant
    n = programme.topology.layout.n
    entries = model.emit(module, shape, crane, programme.length)
    constants = {entry[:3]: entry[3] for entry in entries}
    block = [i // n for i in range(shape.both)]
    # Weights join no numbers of different blocks.
    zeros = [(i, j) for i, j in product(range(shape.both), repeat=2) if block[i] != block[j]]
    constants |= {("weight", *pair): 0.0 for pair in zeros}
    riccati.emit(module, shape, constants)
    interior.emit(module, shape, constants)
    errors = np.reshape(programme.errors, (2, n))
    model.emit_weights(module, shape, crane, errors, np.array(programme.payload_errors))
    planning.emit(module, shape, programme, constants)
    return entries


def emit_instant(module: ir.Module, programme: Programme) -> None:
    """Add the function `instant` for one crane: from the state, the row of the path and whether to
    optimise to the command.
    """
    code = Code(module, "instant", ["memory", "given", "command"], 1)
    code.function.attributes.add("noinline")  # same rounding for all callers
    layout = programme.topology.layout
    query = code.argument["given"]
    z = 2 * layout.n
    state = array([code.load(query, i) for i in range(z)])
    position = array([code.load(query, z + i) for i in range(layout.m)])
    row, due = (code.load_one(query, z + layout.m + i, INTEGER) for i in range(2))
    memory = code.argument["memory"]
    workspace = code.address(memory, programme.offsets(1).path)
    control = PredictiveControl(code, programme, memory, workspace)
    optimise = code.builder.icmp_signed("!=", due, code.integer(0))
    command = control.command(state[: layout.n], state[layout.n :], position, row, optimise)
    for i, value in enumerate(command):
        code.store(value, code.argument["command"], i)
    code.end()


class PredictiveControl:
    """Code of a control instant, for one crane or for one in each lane."""

    def __init__(
        self, code: Code, programme: Programme, memory: ir.Value, workspace: ir.Value
    ) -> None:
        self.code = code
        self.programme = programme
        self.memory = memory
        self.offsets = programme.offsets(code.lanes)
        self.layout = programme.topology.layout
        self._path = workspace
        self._work = code.address(workspace, self.offsets.work - self.offsets.path)
        self._slots = lane_memory(self.layout)

    def count_instant(self) -> tuple[ir.Value, ir.Value]:
        """Count an instant; return the row of the path and whether to optimise."""
        code = self.code
        count = code.load_one(self.memory, self.offsets.counts, INTEGER)
        address = code.address(self.memory, self.offsets.counts)
        code.builder.store(code.builder.add(count, code.integer(1)), address, align=8)
        turn = code.builder.srem(count, code.integer(self.programme.ratio))
        first = code.load_one(self.memory, self.offsets.counts + 1, INTEGER)
        compared = code.builder.icmp_signed
        due = compared("==", turn, code.integer(0)), compared("==", count, first)
        return count, code.builder.or_(*due)

    def command(
        self, q: np.ndarray, v: np.ndarray, position: np.ndarray, row: ir.Value, due: ir.Value
    ) -> np.ndarray:
        """Return the command of the drives, shape (m,).

        Args:
            q: Coordinates.
            v: Rates.
            position: Setpoint of the drives; unused with a path.
            row: Present row of the path.
            due: Whether to optimise.
        """
        code = self.code
        before = self._load_memory("read")
        begun = self._load_memory("begun")[0]
        q, v, plausible = self._plausible(q, v)
        estimated = self._estimated_state(q, v, before)
        with code.when(due):
            plant = self.programme.plant
            tracked = self.programme.rows > 0
            goal = array([]) if tracked else model.hanging(plant, position)
            self._plan(np.concatenate(estimated), goal, row, plausible)
        acceleration = self._load_memory("held")
        if self.programme.drive == "effort":
            return self._efforts(q, v, acceleration, begun * plausible)
        acceleration = self._taut(q, v, acceleration)
        if self.programme.drive == "motion":
            return acceleration
        rates = estimated[1][self.layout.drives]
        self._store_memory("expected", rates + self.programme.period * acceleration)
        lead = self.programme.lead
        return array([r + t * a for r, t, a in zip(rates, lead, acceleration, strict=True)])

    def call_instant(
        self, q: np.ndarray, v: np.ndarray, position: np.ndarray, row: ir.Value, due: ir.Value
    ) -> np.ndarray:
        """Return the command as `command`, for one crane: by the function of `emit_instant`, which
        Python calls too, so that both agree to the bit.
        """
        code = self.code
        numbers = [*q, *v, *position]
        with code.builder.goto_entry_block():
            query = code.builder.alloca(DOUBLE, len(numbers) + 2)
            command = code.builder.alloca(DOUBLE, len(position))
        for i, value in enumerate(numbers):
            code.store(value, query, i)
        for i, number in enumerate((row, code.builder.zext(due, INTEGER)), len(numbers)):
            bits = code.builder.bitcast(number, DOUBLE)
            code.store(Value(code, bits), query, i)
        function = code.function.module.globals["instant"]
        code.builder.call(function, [self.memory, query, command])
        return array([code.load(command, i) for i in range(len(position))])

    def _plan(self, z: np.ndarray, goal: np.ndarray, row: ir.Value, plausible: Value) -> None:
        """Optimise from coordinates and rates, and hold the first accelerations."""
        code = self.code
        lanes = self.code.lanes
        plan, query = (
            code.address(self.memory, place) for place in (self.offsets.plans, self.offsets.query)
        )
        for i, value in enumerate([*z, plausible]):
            code.store(value, query, i * lanes)
        code.builder.store(row, code.address(query, (len(z) + 1) * lanes), align=8)
        for i, value in enumerate(goal):
            code.store(value, self._path, i * lanes)
        addresses = [self._work, plan, query, self._path]
        code.builder.call(code.function.module.globals["plan"], addresses)
        inputs = [code.load(plan, (len(z) + i) * lanes) for i in range(self.layout.m)]
        self._store_memory("held", inputs)

    def _place(self, i: int) -> int:
        return self.offsets.lanes + i * self.code.lanes

    def _load_memory(self, name: str) -> np.ndarray:
        return array([self.code.load(self.memory, self._place(i)) for i in self._slots[name]])

    def _store_memory(self, name: str, values: Any) -> None:
        for i, value in zip(self._slots[name], values, strict=True):
            self.code.store(value, self.memory, self._place(i))

    def _plausible(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, Value]:
        """Return coordinates and rates as read, and 1; or, if the reading is implausible, the last
        plausible ones, and 0.
        """
        code = self.code
        read = np.concatenate([q, v])
        rows = MemoryRows(code, self.programme.shape(code.lanes), self._work, {})
        lower, upper = (rows.row(name, len(read)) for name in ("least", "most"))
        ranges = zip(lower, read, upper, strict=True)
        holds = code.both(*(c for low, x, high in ranges for c in (x >= low, x <= high)))
        updates = {
            "read": (read, self._load_memory("read")),
            "refused": (self._load_memory("refused"), read),
            "refusals": (self._load_memory("refusals"), self._load_memory("refusals") + 1.0),
        }
        for name, pairs in updates.items():
            values = [code.chosen(holds, a, b) for a, b in zip(*pairs, strict=True)]
            self._store_memory(name, values)
        q, v = np.split(self._load_memory("read"), 2)
        return q, v, code.chosen(holds, 1.0, 0.0)

    def _estimated_state(
        self, q: np.ndarray, v: np.ndarray, before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the state with which a plan begins: as measured, except for the filtered swing
        and, where rates are commanded, the rates of the drives.
        """
        begun = self._load_memory("begun")[0] > 0.0
        drives = self.layout.drives
        estimated_q, estimated_v = self._filter_swing(begun, q, v, before[self.layout.n + drives])
        if self.programme.drive == "velocity":
            estimated_v[drives] = self._correct(
                begun, self._load_memory("expected"), v[drives], self.programme.rate_share
            )
        self._store_memory("begun", [1.0])
        return estimated_q, estimated_v

    def _filter_swing(
        self, begun: ir.Value, q: np.ndarray, v: np.ndarray, rates_before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates with the filtered swing.

        The drives' accelerations since the instant before follow from their change of rate,
        whatever caused it; so noise of the encoders does not add up.
        """
        q = q.copy()
        v = v.copy()
        layout = self.layout
        period = self.programme.period
        drives, passive = layout.drives, layout.passive
        if self.programme.swing_share == 1.0 or not len(passive):
            return q, v
        measured = [*q[passive], *v[passive]]
        before = q.copy()
        before[passive], v[passive] = np.split(self._load_memory("swing"), 2)
        done = (v[drives] - rates_before) / period
        caused = self.programme.plant.answer(before, v, done, None)[0][passive]
        after = v[passive] + period * caused
        expected = [*(before[passive] + period * after), *after]
        estimated = self._correct(begun, expected, measured, self.programme.swing_share)
        self._store_memory("swing", estimated)
        q[passive], v[passive] = np.split(estimated, 2)
        return q, v

    def _correct(self, begun: ir.Value, expected: Any, measured: Any, share: float) -> np.ndarray:
        """Return expected values, corrected by a share of their difference from the measured ones;
        measured ones at the first instant.
        """
        pairs = zip(expected, measured, strict=True)
        return array([self.code.chosen(begun, e + share * (s - e), s) for e, s in pairs])

    def _efforts(
        self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, learns: Value
    ) -> np.ndarray:
        """Return efforts for accelerations less the estimated disturbance, and update the estimate.

        learns is 1, or 0 at the first instant and for implausible readings. Expected rates follow
        from the clipped efforts, so that the estimate recovers from any error.
        """
        code, programme, layout = self.code, self.programme, self.layout
        estimate, expected = self._load_memory("estimate"), self._load_memory("expected")
        rates = v[layout.drives]
        gain = learns * (programme.share / programme.period)
        read = zip(estimate, rates, expected, strict=True)
        estimate = array([e + gain * (r - x) for e, r, x in read])
        crane = programme.plant
        effort = crane.answer(q, v, acceleration - estimate, None)[1]
        limits = zip(effort, crane.effort_limit, strict=True)
        cut = [clipped(f, -limit, limit) for f, limit in limits]
        hoist = layout.drive_of("hoist")
        if hoist is not None:
            joint = int(layout.drives[hoist])
            limit = crane.joint.resistance_of(joint, v[joint]) - programme.taut
            cut[hoist] = code.chosen(cut[hoist] > limit, limit, cut[hoist])
        caused = programme.driven("effort").answer(q, v, array(cut), None)[0][layout.drives]
        self._store_memory("estimate", estimate)
        self._store_memory("expected", rates + programme.period * (caused + estimate))
        return array(cut)

    def _taut(self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """Return accelerations, reduced for a hoist that would go below the least tension of the
        rope; the effort of the hoist is linear in its acceleration.
        """
        code = self.code
        layout = self.layout
        crane = self.programme.plant
        hoist = layout.drive_of("hoist")
        if hoist is None:
            return acceleration
        joint = int(layout.drives[hoist])
        faster = acceleration.copy()
        faster[hoist] = acceleration[hoist] + 1.0
        force, steeper = (crane.answer(q, v, u, None)[1][hoist] for u in (acceleration, faster))
        over = force - (crane.joint.resistance_of(joint, v[joint]) - self.programme.taut)
        reduced = acceleration[hoist] - over / (steeper - force)
        acceleration[hoist] = code.chosen(over > 0.0, reduced, acceleration[hoist])
        return acceleration
