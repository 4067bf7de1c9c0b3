"""Closed loop in code: control, drives, log and steps, for one crane or for one in each lane."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.angles import SHORTER, Turn, all_within
from cranedyn.compiled.code import INTEGER, Code, StackVariable, Value, uses
from cranedyn.compiled.machine import Machine, translate
from cranedyn.compiled.memory_layout import SLOTS, TURNS, BufferLayout, Sections, size, slices
from cranedyn.compiled.plant.plant import SI, Plant, Topology, Units, plant
from cranedyn.compiled.step import Step, StepState
from cranedyn.compiled.threads import KINDS, THREAD, emit_lane_loop
from cranedyn.controllers.affine import integrated_command
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.integrators import Integrator
from cranedyn.dynamics.scalars import array
from cranedyn.simulation.loop_checks import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.memory import Programme


@dataclass(frozen=True)
class Recipe:
    """Features of the code to generate.

    Attributes:
        lanes: Number of cranes that run at once.
        drive: "effort", "motion" or "velocity".
        integrator: The stepping rule.
        buffers: Whether buffers end the ranges of the drives.
        integral: Whether the controller integrates.
        offset: Whether the sensors add an offset.
        forces: Whether external forces act.
        shared: Whether all lanes share the gain table, the setpoint table, the forces, and the
            sensor offsets.
        log, summary: Whether rows are recorded, and whether a summary is computed.
        ledger: Whether the rows are those of the log of `simulate`, with its energy ledger.
        areas: Drag areas of the points [m²] in a wind, whose velocities then stand in place of the
            forces; empty without wind. It needs the ledger.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        turns: Steps after which sines and cosines are computed afresh; with 1 a motion is the same
            to the bit for any division into control periods.
        programme: Parameters of a predictive controller; None for one that is affine in the state.
        delayed: Whether the sensors have delays.
        threads: Whether each lane is a thread with plain doubles, as on a GPU, instead of a part of
            a vector.
        contacts: Contacts of the load with the ground; None for none.
    """

    lanes: int
    drive: str
    integrator: Integrator
    buffers: bool = False
    integral: bool = False
    offset: bool = False
    forces: bool = False
    shared: tuple[bool, ...] = (True, True, True)
    log: bool = False
    summary: bool = False
    delay_steps: int | None = None
    turns: int = TURNS
    programme: Programme | None = None
    delayed: bool = False
    threads: bool = False
    contacts: Contacts | None = None
    ledger: bool = False
    areas: tuple[float, ...] = ()


class KernelSource(NamedTuple):
    """What code is made from; equal sources give equal code.

    Attributes:
        topology: Topology of the cranes.
        constants: Their numbers, None where each lane has its own.
        recipe: Features of the code.
    """

    topology: Topology
    constants: tuple[float | None, ...]
    recipe: Recipe

    @property
    def sizes(self) -> BufferLayout:
        """Layout of the buffers."""
        recipe = self.recipe
        sizes = BufferLayout.of(self.topology.layout, recipe.delay_steps, recipe.contacts)
        return replace(sizes, ledger=recipe.ledger)

    @property
    def varied(self) -> int:
        """Number of crane parameters that differ between the lanes of a batch."""
        return self.constants.count(None)

    def plant(self, code: Code, numbers: ir.Value) -> Plant:
        """Return the crane whose varied numbers are at an address. Its other numbers are constants
        of the code, which fold.
        """
        values: list[Any] = []
        loaded = 0
        for constant in self.constants:
            if constant is None:
                values.append(code.load(numbers, loaded * code.stride))
                loaded += 1
            else:
                values.append(constant)
        recipe = self.recipe
        without_ground = plant(self.topology, values, recipe.drive, recipe.buffers)
        return replace(without_ground, contacts=recipe.contacts)

    def in_steps(self, crane: Plant, dt: Any) -> tuple[Plant, Units]:
        """Return the crane and the units in which it steps, see `Plant.in_steps`.

        These are SI units for a thread, which has too few registers for constants in other units,
        and where sines and cosines are computed afresh after every step: rates are then converted
        as often, with a rounding error each time.
        """
        if self.recipe.threads or self.recipe.turns == 1:
            return crane, SI
        return crane.in_steps(dt)


class Kernel(NamedTuple):
    """Compiled closed loop, to be called through `cranedyn.compiled.binding`.

    Attributes:
        source: What it is made from.
        sizes: Layout of its buffers.
        machine: Its functions: run, the loop; answer, accelerations at one state for each lane;
            and, for many lanes without a log, several, the loop for each of many groups.
        verified: Varied numbers of the cranes for which it was compared with Pinocchio.
    """

    source: KernelSource
    sizes: BufferLayout
    machine: Machine
    verified: set[bytes]


def kernel(source: KernelSource) -> Kernel:
    """Compile the loop."""
    module = build_module(source)
    if source.recipe.threads:
        emit_lane_loop(module)
    machine = translate(module, inlining=source.recipe.lanes > 1)
    return Kernel(source, source.sizes, machine, set())


def build_module(source: KernelSource) -> ir.Module:
    """Return the loop as a module for LLVM; for threads it is the loop of one thread, see
    `cranedyn.compiled.threads`.
    """
    module = ir.Module()
    recipe = source.recipe
    lanes = 1 if recipe.threads else recipe.lanes
    if recipe.programme is not None:
        # Few runs need it, and the first step of the others should not wait for the import.
        from cranedyn.compiled.horizon.control_instant import emit_instant, emit_plan

        emit_plan(module, recipe.programme, lanes)
        if recipe.lanes == 1:
            emit_instant(module, recipe.programme)
    run, answer = THREAD if recipe.threads else ("run", "answer")
    _Loop(Code(module, run, ["call"], lanes, recipe.lanes), source).emit()
    arguments = ["given", "numbers", "accelerations"]
    _emit_answer(Code(module, answer, arguments, lanes, recipe.lanes), source)
    if lanes > 1 and not recipe.log:
        _emit_several(Code(module, "several", ["calls", "count"], 1), module.globals["run"])
    return module


def _emit_answer(code: Code, source: KernelSource) -> None:
    """Emit the function that computes accelerations at one state for each lane, see
    `BufferLayout.query`.
    """
    if not source.recipe.threads:
        # It is called a few times only, for which LLVM need not optimise it.
        code.function.attributes.add("noinline")
        code.function.attributes.add("optnone")
    crane, units = source.in_steps(source.plant(code, code.argument["numbers"]), 1.0)
    sections = source.sizes.query
    query = [code.load(code.argument["given"], i * code.stride) for i in range(size(sections))]
    columns = slices(sections)
    q = array(query[columns["q"]])
    v = array(query[columns["v"]])
    command = array(query[columns["command"]])
    forces = array(query[columns["force"]])
    plant_forces = forces * units.force if source.recipe.forces else None
    dynamics = crane.answer(q, v, command * units.command, plant_forces)
    for i, acceleration in enumerate(dynamics.acceleration):
        code.store(acceleration, code.argument["accelerations"], i * code.stride)
    code.end()


def _emit_several(code: Code, run: ir.Function) -> None:
    """Emit the function that runs the loop for each of many groups, whose calls stand one after
    another in memory.
    """
    calls = code.argument["calls"]
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as group:
        first = code.product(group, len(SLOTS))
        code.builder.call(run, [code.builder.gep(calls, [first], source_etype=INTEGER)])
    code.end()


class _InstantValues(NamedTuple):
    """Quantities of a crane at a control instant, as numbers of the code.

    Attributes:
        q: Coordinates [rad or m], shape (n,).
        v: Rates [rad/s or m/s], shape (n,).
        command: What the drives are commanded, shape (m,): efforts as commanded; for other drives
            the efforts that the command needs, before limits.
        effort: Efforts of the drives from this instant on [N m or N], shape (m,).
        before: Their efforts up to this instant, shape (m,).
        forces: External forces from this instant on [N], shape (3 points,); None without.
        stop_force: Force of the buffer of the hoist [N].
        saturated: 1 where a command exceeds the largest rate of a converter, else 0; empty without
            converters.
        holds: Whether the model holds.
    """

    q: np.ndarray
    v: np.ndarray
    command: np.ndarray
    effort: np.ndarray
    before: np.ndarray
    forces: np.ndarray | None
    stop_force: Any
    saturated: list[Any]
    holds: ir.Value


class _Loop:
    """Loop over control instants under construction.

    The state and the summary are variables while the loop runs, and are stored in memory at its
    end. So are sine and cosine of the angle of each revolute joint: a step rotates them by the
    change of the angle, which takes less time than computing them.
    """

    def __init__(self, code: Code, source: KernelSource) -> None:
        self.code = code
        self.recipe = source.recipe
        self.sizes = source.sizes
        call = code.argument["call"]
        self.call_values = {name: code.load_one(call, SLOTS[name], KINDS[name]) for name in SLOTS}
        self.dt = code.from_double(self.call_values["dt"])
        self.period = code.from_double(self.call_values["period"])
        self.plant = source.plant(code, self.call_values["numbers"])
        self.moving, self.units = source.in_steps(self.plant, self.dt)
        self.state = self._variables("state", self.sizes.state)
        self.summary = self._variables("summary", self.sizes.summary) if self.recipe.summary else {}

        # Sine and cosine of each revolute joint, by its number. Threads have few registers, and
        # compute them where they are needed.
        self.angles: dict[int, list[StackVariable]] = {}
        for i, joint in enumerate(source.topology.layout.joints):
            if joint.kind == "revolute" and not self.recipe.threads:
                self.angles[i] = code.variables([0.0, 0.0])

        # Values of these variables that the code has loaded so far: sines and cosines that nothing
        # uses are not updated.
        self.loaded_angles: dict[int, list[Value]] = {i: [] for i in self.angles}

    # --- variables and tables ---------------------------------------------------------------------

    def _variables(self, name: str, sections: Sections) -> dict[str, list[StackVariable]]:
        """Return variables, by section, that begin with the numbers of a buffer."""
        code = self.code
        address = self.call_values[name]
        variables = [
            StackVariable(code, code.load(address, i * code.stride)) for i in range(size(sections))
        ]
        return {key: variables[section] for key, section in slices(sections).items()}

    def _store_variables(self, name: str, variables: dict[str, list[StackVariable]]) -> None:
        """Store variables, by section, in their buffer."""
        for i, variable in enumerate(chain.from_iterable(variables.values())):
            self.code.store(variable.get(), self.call_values[name], i * self.code.stride)

    def _row(self, table: int, name: str, instant: ir.Value) -> Callable[[str], np.ndarray]:
        """Return a function that loads a section of the row of a table for an instant; beyond its
        end of the last row.

        Args:
            table: Number of the table, in the order of `Recipe.shared`.
            name: Its name.
            instant: Control instant, or another count of rows.
        """
        code = self.code
        pointer = self.call_values[name]
        sections = getattr(self.sizes, name)
        width = size(sections)
        columns = slices(sections)
        last = code.builder.sub(self.call_values[f"{name}_rows"], code.integer(1))
        row = code.least(instant, last)
        rows = [row]
        if not self.recipe.shared[table]:
            first = table * code.stride
            starts = self.call_values["starts"]
            begins = [code.load_one(starts, first + lane, INTEGER) for lane in range(code.lanes)]
            rows = [code.builder.add(start, row) for start in begins]
        addresses = [code.address(pointer, code.product(row, width)) for row in rows]

        def load(section: str) -> np.ndarray:
            return array([code.gather(addresses, i) for i in range(width)[columns[section]]])

        return load

    def _get(self, section: str) -> np.ndarray:
        """Return the present numbers of a section of the state."""
        return array([variable.get() for variable in self.state[section]])

    def _set(self, section: str, values: Iterable[Any]) -> None:
        """Assign the numbers of a section of the state."""
        for variable, value in zip(self.state[section], values, strict=True):
            variable.set(value)

    def _anchors(self) -> np.ndarray:
        """Return the anchors of the ground, shape (3 points,); empty without ground."""
        return self._get("anchors") if self.sizes.touching else array([])

    # --- sines and cosines ------------------------------------------------------------------------

    def _coordinates(self) -> np.ndarray:
        """Return coordinates, with their sines and cosines cached."""
        q = self._get("q")
        for i, (sine_variable, cosine_variable) in self.angles.items():
            sine = sine_variable.get()
            cosine = cosine_variable.get()
            self.code.cache_angle(q[i], sine, cosine)
            self.loaded_angles[i] += [sine, cosine]
        return q

    def _used_angles(self) -> list[int]:
        """Return the joints of whose angles the code so far needs sines or cosines."""
        needed = uses(self.code.function)
        joints = []
        for i in self.angles:
            if any(value.register in needed for value in self.loaded_angles[i]):
                joints.append(i)
        return joints

    def _compute_angles(self, joints: Iterable[int]) -> None:
        """Compute sines and cosines of joints afresh."""
        q = self._get("q")
        for i in joints:
            self._set_angle(i, self.code.sine_and_cosine(q[i]))

    def _set_angle(self, i: int, pair: tuple[Value, Value]) -> None:
        """Assign sine and cosine of a joint."""
        for variable, value in zip(self.angles[i], pair, strict=True):
            variable.set(value)

    # --- the loop ---------------------------------------------------------------------------------

    def emit(self) -> None:
        """Emit the whole function."""
        code = self.code
        self._compute_angles(self.angles)
        call = self.call_values
        compared = code.builder.icmp_signed
        with code.loop(call["first"], call["last"]) as instant:
            forces = self._forces(instant)
            is_first = compared("==", instant, call["first"])
            begun = code.both(is_first, compared("!=", call["resumed"], code.integer(0)))
            with code.when(code.builder.not_(begun)):
                self._control(instant, forces)
            with code.when(compared("<", instant, call["end"])):
                self._period(forces)
        self._store_variables("state", self.state)
        if self.recipe.summary:
            self._store_variables("summary", self.summary)
        code.end()

    def _period(self, forces: np.ndarray | None) -> None:
        """Emit the steps of a control period.

        Sines and cosines are updated step by step, each time with a rounding error. They are
        computed afresh every `Recipe.turns` steps and at the end of the period. In between, rates
        are in the units of the steps, see `KernelSource.in_steps`.
        """
        code = self.code
        steps = self.call_values["steps"]
        turns = self.recipe.turns
        if self.recipe.threads:
            self._steps(code.integer(0), steps, forces)
            return
        pieces = code.builder.sdiv(code.plus(steps, turns - 1), code.integer(turns))
        with code.loop(0, pieces) as piece:
            first = code.product(piece, turns)
            last = code.least(code.plus(first, turns), steps)
            self._set("v", self._get("v") * self.units.time)
            self._steps(first, last, forces)
            self._set("v", [code.quotient(rate, self.units.time) for rate in self._get("v")])
            self._compute_angles(self._used_angles())

    def _steps(self, first: ir.Value, last: ir.Value, forces: np.ndarray | None) -> None:
        """Emit steps from the first to the one before the last."""
        code = self.code
        units = self.units
        with code.fast_loop(first, last) as end:
            q_before = self._coordinates()
            works = self._get("contacts")
            v = self._get("v")
            last_command = self._get("last_command")
            if self.recipe.delay_steps is not None:
                reference, slope = self._next_reference(last_command, v * (1.0 / units.time))
                self._set("reference", reference)
                self._set("rising", slope)
                last_command = array(reference)
            step = Step(
                integrator=self.recipe.integrator,
                plant=self.moving,
                command=last_command * units.command,
                forces=None if forces is None else forces * units.force,
                dt=self.dt / units.time,
                unit=units.work,
                substeps=self.call_values["substeps"],
            )
            q, v, works, anchors = step.after(StepState(q_before, v, works, self._anchors()))
            self._set("q", q)
            self._set("v", v)
            self._set("contacts", works)
            if self.sizes.touching:
                self._set("anchors", anchors)
            self._rotate_angles(q, end)

    def _rotate_angles(self, q: np.ndarray, end: Callable[[ir.Value], None]) -> None:
        """Update sines and cosines after a step to coordinates, and end the loop over steps.

        A short series rotates them by the change of the angle. It is precise for small changes; in
        the rare case that a joint turned farther, the loop is left for a longer one.

        Args:
            q: Coordinates after the step.
            end: Ends the statements of the loop, see `Code.fast_loop`.
        """
        code = self.code
        joints = self._used_angles()
        turns: dict[int, Turn] = {}
        for i in joints:
            turn = code.turn(q[i])
            if turn is not None:
                turns[i] = turn
        rotated = {i: turn.rotate(SHORTER) for i, turn in turns.items()}
        for i in joints:
            self._set_angle(i, rotated[i] if i in rotated else code.sine_and_cosine(q[i]))
        all_small = all_within(code, [*turns.values()], SHORTER)
        end(all_small)
        with code.when(code.builder.not_(all_small)):
            for i, turn in turns.items():
                self._set_angle(i, turn.refine(rotated[i]))

    def _forces(self, instant: ir.Value) -> np.ndarray | None:
        """Return the external forces from an instant on [N], shape (3 points,); None without."""
        if not self.recipe.forces:
            return None
        since_start = self.code.most(instant, self.code.integer(0))
        row = self.code.builder.sdiv(since_start, self.call_values["force_interval"])
        forces = self._row(2, "force", row)("force")
        if not self.recipe.areas:
            return forces
        # The table then holds the velocity of the wind.
        return self.plant.drag(self._coordinates(), self._get("v"), forces, self.recipe.areas)

    def _forces_before(self, instant: ir.Value) -> np.ndarray | None:
        """Return the external forces up to an instant. The drag of a wind depends on the state at
        the instant before, so that it is remembered.
        """
        if self.recipe.areas:
            return self._get("pushed")
        return self._forces(self.code.builder.sub(instant, self.code.integer(1)))

    # --- the control instant ----------------------------------------------------------------------

    def _control(self, instant: ir.Value, forces: np.ndarray | None) -> None:
        """Emit a control instant: the command, and what is recorded of it."""
        q = self._coordinates()
        v = self._get("v")
        before = self._get("last_command")
        requested = self._controller_command(instant, q, v)
        followed = self.plant.within(requested)
        if self.recipe.delay_steps is not None:
            followed = self._delay_command(requested)
        self._set("last_command", followed)
        if not (self.recipe.log or self.recipe.summary):
            return
        values = self._instant_values(instant, q, v, requested, followed, before, forces)
        if self.recipe.log:
            self._log(instant, self._log_row(instant, values))
        if self.recipe.summary:
            self._summarise(instant, values)

    def _delay_command(self, requested: np.ndarray) -> np.ndarray:
        """Return the command that converters hear at this instant, shape (m,), and put the present
        one at the end of those on their way.
        """
        assert self.plant.response is not None
        waiting = [*self._get("unheard"), *self.plant.response.quantize_commands(requested)]
        self._set("unheard", waiting[self.sizes.m :])
        return array(waiting[: self.sizes.m])

    def _instant_values(
        self,
        instant: ir.Value,
        q: np.ndarray,
        v: np.ndarray,
        requested: np.ndarray,
        followed: np.ndarray,
        before: np.ndarray,
        forces: np.ndarray | None,
    ) -> _InstantValues:
        """Return the quantities of the crane at an instant.

        Args:
            instant: The instant.
            q: Coordinates.
            v: Rates.
            requested: Command of the controller.
            followed: What the drives follow from now on: efforts within the limits, accelerations,
                or commands that converters hear.
            before: What they followed up to now.
            forces: External forces from now on.
        """
        code = self.code
        recipe = self.recipe
        command = requested
        effort = followed
        reactions = self.plant.ground_reactions(q, v, self._anchors())[0]
        if recipe.delay_steps is not None:
            if recipe.log:
                forces_before = self._forces_before(instant)
                reference = self._get("reference")
                before = self.plant.answer(q, v, reference, forces_before, reactions)[1]
            next_reference = array(self._next_reference(followed, v)[0])
            _, effort, command, _ = self.plant.answer(q, v, next_reference, forces, reactions)
        if recipe.drive == "motion":
            forces_before = self._forces_before(instant)
            before = self.plant.answer(q, v, before, forces_before, reactions)[1]
            command = effort = self.plant.answer(q, v, command, forces, reactions)[1]
        stop_force = self.plant.stop_force(q, v)
        saturated = self._saturated(requested)
        hoist = self.plant.topology.layout.drive_of("hoist")
        hoist_force = stop_force if hoist is None else effort[hoist] + stop_force
        conditions = self.plant.conditions(q, v, hoist_force, command)
        holds = code.both(*conditions, *(number < 0.5 for number in saturated))
        return _InstantValues(q, v, command, effort, before, forces, stop_force, saturated, holds)

    def _next_reference(self, heard: np.ndarray, v: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Return the reference rates of converters after the next step, and their rates of change,
        m numbers each.

        Args:
            heard: Commands that the converters follow.
            v: Rates of all joints [rad/s or m/s].
        """
        assert self.plant.response is not None
        rate = v[self.plant.topology.layout.drives]
        reference = self._get("reference")
        slope = self._get("rising")
        return self.plant.response.ramped(heard, reference, slope, rate, self.dt)

    def _saturated(self, command: np.ndarray) -> list[Any]:
        """Return 1 where a command exceeds the largest rate of a converter, else 0; empty without
        converters.
        """
        if self.plant.response is None:
            return []
        values = [self.code.value(number) for number in command]
        exceeds = self.code.either(*self.plant.response.saturates(values))
        return [self.code.chosen(exceeds, 1.0, 0.0)]

    def _controller_command(self, instant: ir.Value, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the command of the controller, shape (m,)."""
        sizes = self.sizes
        gains = self._row(0, "gain_table", instant)
        setpoints = self._row(1, "setpoint_table", instant)
        z = np.concatenate([q, v])
        if self.recipe.offset:
            z = z + self._row(3, "offset", instant)("reading")
        if self.recipe.delayed:
            z = self._delay_reading(instant, z)
        if self.recipe.programme is not None:
            return self._predictive_command(self.recipe.programme, z, setpoints)
        gain = gains("gain").reshape(sizes.m, sizes.z)
        command = gains("feed_forward") - gain @ (z - setpoints("setpoint"))
        if not self.recipe.integral:
            return command
        integrals = self._get("integral")
        position = setpoints("position")
        factor = gains("integral_gain")
        limit = gains("limit")
        for i, drive in enumerate(self.plant.topology.layout.drives):
            error = position[i] - z[drive]
            command[i], integrals[i] = integrated_command(
                command[i], error, integrals[i], factor[i], limit[i], self.period
            )
        self._set("integral", integrals)
        return command

    def _predictive_command(
        self, programme: Programme, z: np.ndarray, setpoints: Callable[[str], np.ndarray]
    ) -> np.ndarray:
        """Return the command of a predictive controller for coordinates and rates, shape (2 n,),
        and a row of the setpoint table, see `_row`.
        """
        from cranedyn.compiled.horizon.control_instant import PredictiveControl

        horizon = self.call_values["horizon"]
        control = PredictiveControl(self.code, programme, horizon, self.call_values["workspace"])
        row, due = control.count_instant()
        q = z[: self.sizes.n]
        v = z[self.sizes.n :]
        position = setpoints("position")
        if self.code.lanes == 1:
            return control.call_instant(q, v, position, row, due)
        return control.command(q, v, position, row, due)

    def _delay_reading(self, instant: ir.Value, z: np.ndarray) -> np.ndarray:
        """Store the present reading and return the delayed one, shape (2 n,).

        The readings are a ring: the one of an instant stands in the row of its number modulo the
        number of rows. Before the delay has passed, the first reading is seen.
        """
        code = self.code
        build = code.builder
        readings = self.call_values["readings"]

        def place(count: ir.Value, i: int) -> ir.Value:
            row = build.srem(count, self.call_values["reading_count"])
            return code.plus(code.product(row, self.sizes.z * code.stride), i * code.stride)

        for i, value in enumerate(z):
            code.store(value, readings, place(instant, i))
        lanes = range(code.lanes)
        delays = [code.load_one(self.call_values["delay"], lane, INTEGER) for lane in lanes]
        visible = [code.most(build.sub(instant, delay), code.integer(0)) for delay in delays]
        delayed = []
        for i in range(len(z)):
            places = [code.plus(place(visible[lane], i), lane) for lane in lanes]
            delayed.append(code.gather([code.address(readings, place) for place in places]))
        return array(delayed)

    def _log_row(self, instant: ir.Value, values: _InstantValues) -> list[Any]:
        """Return the row of the log for an instant, in the order of `BufferLayout.row`."""
        q = values.q
        v = values.v
        acts = [*values.command, *values.effort, *values.before]
        energy = self.plant.energy(q, v)
        contacts = [*self._get("contacts"), values.stop_force]
        if not self.recipe.ledger:
            return [*q, *v, *acts, energy, *contacts, *values.saturated]
        setpoint = self._row(1, "setpoint_table", instant)("position")
        forces: Any = values.forces
        if forces is None:
            forces = [0.0] * size(self.sizes.force)
        outside = [0.0, *contacts, *(values.saturated or [0.0])]
        row = [*setpoint, *q, *v, *acts, *forces, *outside, energy]
        self._set("pushed", forces)
        return self._balanced(row, values)

    def _log(self, instant: ir.Value, row: Sequence[Any]) -> None:
        """Store a row of the log where one is due at an instant."""
        code = self.code
        build = code.builder
        interval = self.call_values["log_interval"]
        each_instant = self.recipe.ledger
        due = build.icmp_signed("==", build.srem(instant, interval), code.integer(0))
        with nullcontext() if each_instant else code.when(due):
            index = instant if each_instant else build.sdiv(instant, interval)
            first = code.product(index, len(row) * code.stride)
            begin = code.address(self.call_values["log"], first)
            for i, value in enumerate(row):
                code.store(value, begin, i * code.stride)

    def _balanced(self, row: list[Any], values: _InstantValues) -> list[Any]:
        """Return a row of the log of `simulate` with work, dissipation and validity, and note
        whether the run is broken.

        Sums are rounded in the order of `cranedyn.simulation.log.Log`, which computes the same, so
        that both give the same bits.
        """
        code = self.code
        q = values.q
        v = values.v
        drives = self.plant.topology.layout.drives
        with code.as_written():
            power = self.plant.joint.dissipation(q, v)
            reached = q[drives] - v[drives] * (self.recipe.integrator.lead * self.dt)
            # Trapezoidal rule from row to row; `again` is 0 at the first row, which has none before
            # it, and 1 after that.
            again = self._get("again")
            moved = reached - self._get("reached")
            work = (self._get("acted") + values.before) / 2.0 * moved * again
            loss = (self._get("power") + power) / 2.0 * self.period * again
            self._set("work", self._get("work") + work)
            self._set("dissipated", self._get("dissipated") + loss)
        self._set("reached", reached)
        self._set("acted", values.effort)
        self._set("power", [power])
        self._set("again", [1.0])
        row = [*row, *self._get("work"), *self._get("dissipated")]

        # A sum is finite only if all its terms are: one comparison in place of many. Setpoints are
        # left out, as their table has been checked, and rates, which must be far below infinity.
        checked = [*q, *row[self.sizes.m + self.sizes.z :]]
        numbers_are_finite = abs(_pairwise_sum(checked)) < np.inf
        is_sound = code.both(numbers_are_finite, v @ v < DIVERGED**2)
        _keep_largest(code, self.state["broken"][0], code.chosen(is_sound, 0.0, 1.0))
        # Where the model does not hold, the log finds out why.
        return [*row, code.chosen(values.holds, 1.0, np.nan)]

    def _summarise(self, instant: ir.Value, values: _InstantValues) -> None:
        """Update the summary of the run, see `BufferLayout.summary`."""
        code = self.code
        summary = self.summary
        swing, amplitude = (code.value(x) for x in self.plant.swing(values.q, values.v))
        _keep_largest(code, summary["peak"][0], swing)
        is_residual = code.builder.icmp_signed(">=", instant, self.call_values["residual_from"])
        with code.when(is_residual):
            _keep_largest(code, summary["residual"][0], amplitude)
        for variable, effort in zip(summary["effort"], values.effort, strict=True):
            _keep_largest(code, variable, code.call("llvm.fabs", effort))
        now = code.from_integer(instant)
        first_invalid = summary["invalid"][0]
        unchanged = first_invalid.get()
        earlier = code.call("llvm.minnum", first_invalid.get(), now)
        first_invalid.set(code.chosen(values.holds, unchanged, earlier))


def _keep_largest(code: Code, variable: StackVariable, value: Value) -> None:
    """Assign a value to a variable if it is larger than the present one, or NaN, with which every
    comparison fails. A later number would replace that NaN, but a state that is NaN stays so.
    """
    old = variable.get()
    variable.set(code.chosen(value <= old, old, value))


def _pairwise_sum(numbers: Sequence[Any]) -> Any:
    """Return the sum of numbers, added in pairs: no term waits for all others, so that the
    processor adds several at once.
    """
    half = len(numbers) // 2
    if not half:
        return numbers[0]
    return _pairwise_sum(numbers[:half]) + _pairwise_sum(numbers[half:])
