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

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, INTEGER, Code, Value
from cranedyn.compiled.horizon import horizon_model, interior, planning, riccati
from cranedyn.compiled.horizon.memory import MemoryRows, Programme, lane_memory
from cranedyn.dynamics.scalars import array, clipped


def emit_plan(
    module: ir.Module, programme: Programme, lanes: int = 1
) -> list[tuple[str, int, int, float]]:
    """Add the function `plan` and the functions that it calls, for a crane in each lane.

    Args:
        module: Module to which they are added.
        programme: Parameters of the controller.
        lanes: Number of cranes.

    Returns:
        The numbers that are the same in every stage: name of the quantity, its row, place in it,
        and value. The code folds them, but the memory of each stage must have them too.
    """
    shape = programme.shape(lanes)
    crane = programme.plant
    n = programme.topology.layout.n
    entries = horizon_model.emit(module, shape, crane, programme.stage_length)
    constants = {}
    for name, row, place, number in entries:
        constants[name, row, place] = number
    # Coordinates, rates and inputs have weights of their own, and none between them.
    kind = [i // n for i in range(shape.variables)]
    for i in range(shape.variables):
        for j in range(shape.variables):
            if kind[i] != kind[j]:
                constants["weight", i, j] = 0.0
    riccati.emit(module, shape, constants)
    interior.emit(module, shape, constants)
    joint_errors = np.reshape(programme.joint_errors, (2, n))
    horizon_model.emit_weights(
        module, shape, crane, joint_errors, np.array(programme.payload_errors)
    )
    planning.emit(module, shape, programme, constants)
    return entries


def emit_instant(module: ir.Module, programme: Programme) -> None:
    """Add the function `instant` for one crane.

    Its arguments are addresses: of the memory of the controller; of the query, that is the state,
    the setpoint of the drives, and two whole numbers, the row of the path and whether to optimise;
    and of the command, which it writes.
    """
    code = Code(module, "instant", ["memory", "query", "command"], 1)
    # Inlined into several callers it might be rounded differently in each of them.
    code.function.attributes.add("noinline")
    n = programme.crane_joints
    m = programme.topology.layout.m
    query = code.argument["query"]
    q = array([code.load(query, i) for i in range(n)])
    v = array([code.load(query, n + i) for i in range(n)])
    position = array([code.load(query, 2 * n + i) for i in range(m)])
    row = code.load_one(query, 2 * n + m, INTEGER)
    due = code.load_one(query, 2 * n + m + 1, INTEGER)

    memory = code.argument["memory"]
    workspace = code.address(memory, programme.offsets(1).path)
    control = PredictiveControl(code, programme, memory, workspace)
    is_due = code.builder.icmp_signed("!=", due, code.integer(0))
    command = control.command(q, v, position, row, is_due)
    for i, value in enumerate(command):
        code.store(value, code.argument["command"], i)
    code.end()


class _Reading(NamedTuple):
    """Measured state of a crane, or the last plausible one.

    Attributes:
        q: Coordinates [rad or m], shape (n,).
        v: Rates [rad/s or m/s], shape (n,).
        is_plausible: 1 if this is the present reading, 0 if that was implausible.
    """

    q: np.ndarray
    v: np.ndarray
    is_plausible: Value


class PredictiveControl:
    """Code of a control instant, for one crane or for one in each lane."""

    def __init__(
        self, code: Code, programme: Programme, memory: ir.Value, workspace: ir.Value
    ) -> None:
        """Prepare the code.

        Args:
            code: The function under construction.
            programme: Parameters of the controller.
            memory: Address of the memory of the controller, see `Programme.offsets`.
            workspace: Address of its sections from `path` on, which may lie elsewhere.
        """
        self.code = code
        self.programme = programme
        self.memory = memory
        self.offsets = programme.offsets(code.lanes)
        self.layout = programme.topology.layout
        self._path = workspace
        self._work = code.address(workspace, self.offsets.work - self.offsets.path)
        self._places = lane_memory(self.layout)

    def count_instant(self) -> tuple[ir.Value, ir.Value]:
        """Count a control instant.

        Returns:
            Row of the path, which is the number of instants before this one, and whether to
            optimise: at every `Programme.ratio`-th instant, and at the first one of a run.
        """
        code = self.code
        build = code.builder
        count = code.load_one(self.memory, self.offsets.counts, INTEGER)
        address = code.address(self.memory, self.offsets.counts)
        build.store(build.add(count, code.integer(1)), address, align=8)
        since_optimisation = build.srem(count, code.integer(self.programme.ratio))
        count_at_start = code.load_one(self.memory, self.offsets.counts + 1, INTEGER)
        is_turn = build.icmp_signed("==", since_optimisation, code.integer(0))
        is_first = build.icmp_signed("==", count, count_at_start)
        return count, build.or_(is_turn, is_first)

    def command(
        self, q: np.ndarray, v: np.ndarray, position: np.ndarray, row: ir.Value, due: ir.Value
    ) -> np.ndarray:
        """Return the command of the drives: efforts [N m or N], accelerations, or rates, shape
        (m,).

        Args:
            q: Coordinates of the crane as measured [rad or m], shape (crane_joints,).
            v: Their rates as measured [rad/s or m/s], shape (crane_joints,).
            position: Setpoint of the drives [rad or m], shape (m,); unused with a path.
            row: Present row of the path.
            due: Whether to optimise.
        """
        code = self.code
        programme = self.programme
        # From here on all is about the model, in which the rope of the crane is rigid.
        kept = list(programme.kept)
        q = q[kept]
        v = v[kept]
        reading_before = self._load("reading")
        begun = self._load("begun")[0]
        reading = self._plausible_reading(q, v)
        estimated_q, estimated_v = self._estimated_state(reading, reading_before)
        with code.when(due):
            goal = array([])
            if not programme.rows:
                goal = horizon_model.hanging(programme.plant, position)
            start = np.concatenate([estimated_q, estimated_v])
            self._plan(start, goal, row, reading.is_plausible)
        acceleration = self._load("acceleration")

        if programme.drive == "effort":
            # At the first instant nothing was expected yet, and an implausible reading was replaced
            # by an old one: neither says anything about a disturbance.
            learns = begun * reading.is_plausible
            return self._efforts(reading.q, reading.v, acceleration, learns)

        acceleration = self._acceleration_keeping_tension(reading.q, reading.v, acceleration)
        if programme.drive == "motion":
            return acceleration

        # A drive that follows its command with the lag T, and hears it late, has the acceleration
        # a where the command leads its rate by (T + delay) a.
        rates = estimated_v[self.layout.drives]
        self._store("expected_rates", rates + programme.period * acceleration)
        command = []
        for rate, lead, planned in zip(rates, programme.leads, acceleration, strict=True):
            command.append(rate + lead * planned)
        return array(command)

    def call_instant(
        self, q: np.ndarray, v: np.ndarray, position: np.ndarray, row: ir.Value, due: ir.Value
    ) -> np.ndarray:
        """Return the command as `command` does, for one crane: by the function of `emit_instant`,
        which Python calls too, so that both agree to the bit.
        """
        code = self.code
        build = code.builder
        numbers = [*q, *v, *position]
        with build.goto_entry_block():
            query = build.alloca(DOUBLE, len(numbers) + 2)
            command = build.alloca(DOUBLE, len(position))
        for i, value in enumerate(numbers):
            code.store(value, query, i)
        whole_numbers = (row, build.zext(due, INTEGER))
        for i, number in enumerate(whole_numbers, len(numbers)):
            # Their bits are stored as those of doubles, since the query is an array of these.
            bits = build.bitcast(number, DOUBLE)
            code.store(Value(code, bits), query, i)
        function = code.function.module.globals["instant"]
        build.call(function, [self.memory, query, command])
        return array([code.load(command, i) for i in range(len(position))])

    def _plan(self, state: np.ndarray, goal: np.ndarray, row: ir.Value, plausible: Value) -> None:
        """Optimise from a state, and hold the first accelerations of the plan.

        Args:
            state: Coordinates and rates, shape (2 n,).
            goal: Coordinates of the goal, shape (n,); empty with a path.
            row: Present row of the path.
            plausible: Whether the reading was plausible, 1 or 0.
        """
        code = self.code
        lanes = code.lanes
        states = len(state)
        plan = code.address(self.memory, self.offsets.plans)
        query = code.address(self.memory, self.offsets.query)
        for i, value in enumerate([*state, plausible]):
            code.store(value, query, i * lanes)
        code.builder.store(row, code.address(query, (states + 1) * lanes), align=8)
        for i, value in enumerate(goal):
            code.store(value, self._path, i * lanes)
        addresses = [self._work, plan, query, self._path]
        code.builder.call(code.function.module.globals["plan"], addresses)
        inputs = [code.load(plan, (states + i) * lanes) for i in range(self.layout.m)]
        self._store("acceleration", inputs)

    def _offset(self, place: int) -> int:
        return self.offsets.lanes + place * self.code.lanes

    def _load(self, name: str) -> np.ndarray:
        """Load what each lane remembers under a name, see `lane_memory`."""
        return array([self.code.load(self.memory, self._offset(i)) for i in self._places[name]])

    def _store(self, name: str, values: Any) -> None:
        """Store what each lane remembers under a name, see `lane_memory`."""
        for place, value in zip(self._places[name], values, strict=True):
            self.code.store(value, self.memory, self._offset(place))

    def _store_chosen(self, name: str, condition: ir.Value, yes: Any, no: Any) -> None:
        """Store one of two arrays in each lane, as a condition holds there or not."""
        values = []
        for if_so, if_not in zip(yes, no, strict=True):
            values.append(self.code.where(condition, if_so, if_not))
        self._store(name, values)

    def _plausible_reading(self, q: np.ndarray, v: np.ndarray) -> _Reading:
        """Return the present reading, or the last plausible one where it lies beyond what the crane
        can reach, and count that.

        An implausible reading is a fault of a sensor, such as an encoder that wraps. A plan from
        there would be wild, and may not even be finite.
        """
        code = self.code
        read = np.concatenate([q, v])
        rows = MemoryRows(code, self.programme.shape(code.lanes), self._work, {})
        least = rows.row("least_plausible", len(read))
        most = rows.row("most_plausible", len(read))
        # A comparison with NaN is false: NaN is implausible.
        conditions = []
        for low, number, high in zip(least, read, most, strict=True):
            conditions.append(number >= low)
            conditions.append(number <= high)
        is_plausible = code.both(*conditions)

        last_plausible = self._load("reading")
        last_refused = self._load("refused_reading")
        refusals = self._load("refusals")
        refusals_with_this = self._load("refusals") + 1.0
        self._store_chosen("reading", is_plausible, read, last_plausible)
        self._store_chosen("refused_reading", is_plausible, last_refused, read)
        self._store_chosen("refusals", is_plausible, refusals, refusals_with_this)

        reading = self._load("reading")
        n = self.layout.n
        return _Reading(reading[:n], reading[n:], code.where(is_plausible, 1.0, 0.0))

    def _estimated_state(
        self, reading: _Reading, reading_before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates with which a plan begins: as measured, except for the
        filtered swing and, where rates are commanded, the rates of the drives.

        Args:
            reading: The present reading.
            reading_before: State that was read at the instant before, shape (2 n,).
        """
        has_begun = self._load("begun")[0] > 0.0
        drives = self.layout.drives
        rates_before = reading_before[self.layout.n + drives]
        q, v = self._filter_swing(has_begun, reading, rates_before)
        if self.programme.drive == "velocity":
            expected_rates = self._load("expected_rates")
            v[drives] = self._corrected(
                has_begun, expected_rates, reading.v[drives], self.programme.rate_gain
            )
        self._store("begun", [1.0])
        return q, v

    def _filter_swing(
        self, has_begun: ir.Value, reading: _Reading, rates_before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates of a reading, with the filtered swing in place of the
        measured one.

        The accelerations of the drives since the instant before are their change of rate over the
        period, whatever caused it. Over many instants the noise of the encoders in it cancels: the
        sum of the changes is the last rate less the first.

        Args:
            has_begun: Whether there was an instant before.
            reading: The present reading.
            rates_before: Rates of the drives at the instant before, shape (m,).
        """
        layout = self.layout
        period = self.programme.period
        drives = layout.drives
        passive = layout.passive
        q = reading.q.copy()
        v = reading.v.copy()
        if self.programme.swing_gain == 1.0 or not len(passive):
            return q, v

        measured = [*q[passive], *v[passive]]
        swing_before = self._load("swing")
        q_before = q.copy()
        q_before[passive] = swing_before[: len(passive)]
        v[passive] = swing_before[len(passive) :]

        # A step of the semi-implicit Euler method: the new rates move the coordinates.
        drive_accelerations = (v[drives] - rates_before) / period
        dynamics = self.programme.plant.forward_dynamics(q_before, v, drive_accelerations, None)
        expected_v = v[passive] + period * dynamics.acceleration[passive]
        expected_q = q_before[passive] + period * expected_v
        estimated = self._corrected(
            has_begun, [*expected_q, *expected_v], measured, self.programme.swing_gain
        )
        self._store("swing", estimated)
        q[passive] = estimated[: len(passive)]
        v[passive] = estimated[len(passive) :]
        return q, v

    def _corrected(
        self, has_begun: ir.Value, expected: Any, measured: Any, gain: float
    ) -> np.ndarray:
        """Return expected values, corrected by a share of their difference from the measured ones;
        the measured ones at the first instant.
        """
        values = []
        for prediction, measurement in zip(expected, measured, strict=True):
            corrected = prediction + gain * (measurement - prediction)
            values.append(self.code.where(has_begun, corrected, measurement))
        return array(values)

    def _efforts(
        self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, learns: Value
    ) -> np.ndarray:
        """Return efforts for planned accelerations less the estimated disturbance, and update the
        estimate.

        The disturbance d is what accelerates a drive beside its effort in the model. The estimate
        follows d ← d + gain (measured rate - expected rate) / period. The expected rates follow
        from the clipped efforts, so that the estimate recovers from any error: with those before
        the limits, an effort that is cut would look like a disturbance.

        Args:
            q: Coordinates, shape (n,).
            v: Rates, shape (n,).
            acceleration: Planned accelerations of the drives, shape (m,).
            learns: 1, or 0 where the estimate stays.
        """
        code = self.code
        programme = self.programme
        drives = self.layout.drives
        disturbance_before = self._load("disturbance")
        expected_rates = self._load("expected_rates")
        rates = v[drives]
        gain = learns * (programme.disturbance_gain / programme.period)
        updated = []
        for before, rate, expected in zip(disturbance_before, rates, expected_rates, strict=True):
            updated.append(before + gain * (rate - expected))
        disturbance = array(updated)

        crane = programme.plant
        needed = crane.forward_dynamics(q, v, acceleration - disturbance, None).effort
        efforts = []
        for effort, limit in zip(needed, crane.effort_limit, strict=True):
            efforts.append(clipped(effort, -limit, limit))
        hoist = self.layout.drive_of("hoist")
        if hoist is not None:
            limit = self._largest_hoist_effort(int(drives[hoist]), v)
            efforts[hoist] = code.where(efforts[hoist] > limit, limit, efforts[hoist])

        dynamics = programme.driven("effort").forward_dynamics(q, v, array(efforts), None)
        caused = dynamics.acceleration[drives]
        self._store("disturbance", disturbance)
        self._store("expected_rates", rates + programme.period * (caused + disturbance))
        return array(efforts)

    def _largest_hoist_effort(self, joint: int, v: np.ndarray) -> Any:
        """Return the effort of the hoist at which the rope has its least tension [N].

        A positive effort pays out rope, against the resistance of the joint and with the tension:
        effort + tension = resistance. A drum that has an inertia of its own, as that of an elastic
        rope, takes a part of the effort while it gathers speed downward. The rope is then tighter
        than this says, so that the bound errs on the safe side: a load that is much lighter than
        the drum is lowered more gently than it might be.

        Args:
            joint: Index of the hoist among the coordinates.
            v: Rates, shape (n,).
        """
        resistance = self.programme.plant.joint.resistance_of(joint, v[joint])
        return resistance - self.programme.min_tension

    def _acceleration_keeping_tension(
        self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Return accelerations of the drives, reduced for a hoist that would go below the least
        tension of the rope.

        The effort of the hoist is linear in its acceleration; the slope is found as the difference
        of two efforts, for accelerations that differ by 1 m/s².
        """
        hoist = self.layout.drive_of("hoist")
        if hoist is None:
            return acceleration
        crane = self.programme.plant
        joint = int(self.layout.drives[hoist])
        faster = acceleration.copy()
        faster[hoist] = acceleration[hoist] + 1.0
        effort = crane.forward_dynamics(q, v, acceleration, None).effort[hoist]
        effort_if_faster = crane.forward_dynamics(q, v, faster, None).effort[hoist]
        over = effort - self._largest_hoist_effort(joint, v)
        reduced = acceleration[hoist] - over / (effort_if_faster - effort)
        acceleration[hoist] = self.code.where(over > 0.0, reduced, acceleration[hoist])
        return acceleration
