"""Closed loop in code: control, drives, log and steps, for one crane or for one in each lane.

`KernelSource` says what the code is made from, `build_module` makes it as a module of LLVM, and
`kernel` compiles that. The loop itself is emitted by `_Loop`:

    for each control instant from `first` to the one before `last`:
        the command of the controller, from the (delayed, offset) state and the tables
        the row of the log and the summary, where they are asked for
        the physics steps of the control period, except at the instant `end`

Where several groups run in one call, each of these lines is run for each group before the next, and
the steps of the groups take turns, see `cranedyn.compiled.team`.

The functions of this module run once, while the code is made: their numbers are values that the
code will compute, see `cranedyn.compiled.instructions`. What they decide by `if` depends on the
options of the code; what depends on numbers is decided by `Code.when` or chosen lane by lane.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.checks import check_choice
from cranedyn.compiled.angles import SHORTER, Turn, all_within
from cranedyn.compiled.code import DOUBLE, INTEGER, Code, StackVariable, Value, uses
from cranedyn.compiled.instructions import SINGLE
from cranedyn.compiled.machine import Machine, translate
from cranedyn.compiled.memory_layout import (
    ANGLE_REFRESH_STEPS,
    SLOT_TYPES,
    SLOTS,
    TABLES,
    BufferLayout,
    Sections,
    size,
    slices,
)
from cranedyn.compiled.plant.plant import SI, Plant, Topology, Units, make_plant
from cranedyn.compiled.plant.rigid_body import ExternalForce
from cranedyn.compiled.step import Step, StepState
from cranedyn.compiled.team import Team, TeamVariable
from cranedyn.compiled.threads import ACCELERATE_THREAD, RUN_THREAD, emit_lane_loop
from cranedyn.controllers.affine import ControllerStates, integrated_command, next_states
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.integrators import Integrator
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP, RootMotion
from cranedyn.dynamics.scalars import array
from cranedyn.errors import OutOfRange, quoted
from cranedyn.simulation.loop_checks import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.memory import Programme


Precision = Literal["double", "single"]
"""Precision in which cranes move."""

LANES: dict[Precision, int] = {"double": 8, "single": 16}
"""Number of cranes in a group on a processor, one in each lane of a vector of 64 bytes."""


@dataclass(frozen=True)
class KernelOptions:
    """Features of the code to generate.

    Attributes:
        lanes: Number of cranes that run at once.
        drive: Kind of the commands: "effort", "motion" or "velocity".
        integrator: The stepping rule.
        buffers: Whether buffers act at the ends of the ranges of the drives.
        integral: Whether the controller integrates.
        controller_states: Number of states of the controller, see `ControllerStates`.
        single: Whether the loop computes in single precision, of which a vector holds twice as many
            lanes. Memory stays in doubles. Only motions without contacts, buffers, predictive
            controllers and ropes that go slack are computed so.
        offset: Whether the sensors add an offset.
        forces: Whether external forces act.
        shared: Whether all lanes share a table, for each of `TABLES` that the code reads.
        log: Whether rows are recorded.
        summary: Whether a summary of the run is computed.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        angle_refresh_steps: Steps after which sines and cosines are computed afresh. With 1 a
            motion is the same to the bit for any division into control periods.
        programme: Parameters of a predictive controller; None for one that is affine in the state.
        delayed: Whether the sensors have delays.
        threads: Whether each lane is a thread with plain doubles, as on a GPU, instead of a part of
            a vector.
        contacts: Contacts of the load with the ground; None for none.
        ledger: Whether the rows are those of the log of `simulate`, with its energy ledger.
        areas: Drag areas of the points of the crane [m²]. Where they are given, the table of forces
            holds velocities of the air instead, and the code computes the forces; this needs the
            ledger. Empty without wind.
        base: Whether the base on which the cranes stand moves.
        base_by_lane: Whether each lane has a base of its own.
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
    angle_refresh_steps: int = ANGLE_REFRESH_STEPS
    programme: Programme | None = None
    delayed: bool = False
    threads: bool = False
    contacts: Contacts | None = None
    ledger: bool = False
    areas: tuple[float, ...] = ()
    controller_states: int = 0
    single: bool = False
    base: bool = False
    base_by_lane: bool = False


def check_precision(precision: Precision, topology: Topology, excluded: Mapping[str, bool]) -> None:
    """Check that cranes can move in a precision.

    Single precision has seven digits. What is switched on and off at a small distance, or solved by
    iteration, needs more.

    Args:
        precision: The precision.
        topology: Topology of the cranes.
        excluded: What is not computed in single precision, by name, and whether the run has it.

    Raises:
        OutOfRange: If the precision is "single" and the run has some of it.
    """
    check_choice("precision", precision, Precision)
    if precision == "double":
        return
    rope = {"a rope that may go slack": topology.rope is not None}
    for name, present in {**excluded, **rope}.items():
        if present:
            raise OutOfRange("precision", quoted(precision), f"'double' with {name}")


class KernelSource(NamedTuple):
    """What code is made from; equal sources give equal code.

    Attributes:
        topology: Topology of the cranes.
        constants: Parameters of the cranes, see `cranedyn.compiled.plant.plant.plant_numbers`; None
            where each lane has its own, which the code then reads from memory.
        options: Features of the code.
    """

    topology: Topology
    constants: tuple[float | None, ...]
    options: KernelOptions

    @property
    def sizes(self) -> BufferLayout:
        """Layout of the buffers."""
        options = self.options
        sizes = BufferLayout.of(self.topology.layout, options.delay_steps, options.contacts)
        return replace(
            sizes,
            ledger=options.ledger,
            controller_states=options.controller_states,
            base=options.base,
        )

    @property
    def varied(self) -> int:
        """Number of crane parameters that differ between the lanes of a batch."""
        return self.constants.count(None)

    @property
    def works_in_teams(self) -> bool:
        """Whether the groups of a call take turns, see `cranedyn.compiled.team`.

        That is for code of many lanes whose numbers are constants, and whose steps are short: they
        solve nothing by iteration and have no small steps inside.
        """
        options = self.options
        return (
            options.lanes > 1
            and not options.threads
            and not self.varied
            and not options.buffers
            and options.contacts is None
            and options.programme is None
            and self.topology.rope is None
        )

    def plant(self, code: Code, numbers: ir.Value) -> Plant:
        """Return the crane whose varied numbers are at an address.

        The other numbers are constants of the code: products with 0 and 1 vanish from it.
        """
        values: list[Any] = []
        loaded = 0
        for constant in self.constants:
            if constant is None:
                values.append(code.load(numbers, loaded * code.stride))
                loaded += 1
            else:
                values.append(constant)
        options = self.options
        without_ground = make_plant(self.topology, values, options.drive, options.buffers)
        return replace(without_ground, contacts=options.contacts)

    def in_steps(self, crane: Plant, dt: Any) -> tuple[Plant, Units]:
        """Return the crane in the units in which it steps, and these units, see `Plant.in_steps`.

        They are SI units in two cases. A thread has too few registers for the converted constants.
        Where sines and cosines are computed afresh after every step, rates would be converted as
        often, with a rounding error each time.

        Args:
            crane: The crane in SI units.
            dt: The step [s].
        """
        if self.options.threads or self.options.angle_refresh_steps == 1:
            return crane, SI
        return crane.in_steps(dt)


class Kernel(NamedTuple):
    """Compiled closed loop, to be called through `cranedyn.compiled.binding`.

    Attributes:
        source: What it is made from.
        sizes: Layout of its buffers.
        machine: Its functions: `run`, the loop for one group; `accelerate`, accelerations at one
            state for each lane; and, for several lanes without a log, `run_groups`, the loop for
            many groups.
        verified: Bytes of the varied numbers of the cranes for which it was compared with
            Pinocchio.
    """

    source: KernelSource
    sizes: BufferLayout
    machine: Machine
    verified: set[bytes]


def kernel(source: KernelSource) -> Kernel:
    """Compile the loop."""
    module = build_module(source)
    if source.options.threads:
        emit_lane_loop(module)
    machine = translate(module, inlining=source.options.lanes > 1)
    return Kernel(source, source.sizes, machine, set())


def build_module(source: KernelSource) -> ir.Module:
    """Return the loop as a module for LLVM. For threads it is the loop of one thread, which
    `cranedyn.compiled.threads` completes.
    """
    module = ir.Module()
    options = source.options
    lanes = 1 if options.threads else options.lanes
    if options.programme is not None:
        # Few runs need it, and the first step of the others should not wait for the import.
        from cranedyn.compiled.horizon.control_instant import emit_instant, emit_plan

        emit_plan(module, options.programme, lanes)
        if options.lanes == 1:
            emit_instant(module, options.programme)
    run_name = RUN_THREAD if options.threads else "run"
    accelerations_name = ACCELERATE_THREAD if options.threads else "accelerate"
    # A thread computes one lane, but the numbers of its crane stand a whole group apart.
    stride = options.lanes
    scalar = SINGLE if options.single else DOUBLE
    _Loop(Code(module, run_name, ["call"], lanes, stride, scalar), source).emit()
    arguments = ["query", "numbers", "accelerations"]
    _emit_accelerations(Code(module, accelerations_name, arguments, lanes, stride), source)
    if lanes > 1 and not options.log:
        _emit_run_groups(Code(module, "run_groups", ["calls", "count"], 1), module.globals["run"])
    return module


def _emit_accelerations(code: Code, source: KernelSource) -> None:
    """Emit the function that computes accelerations at one state for each lane.

    Its arguments are addresses: of the state and what acts, see `BufferLayout.query`; of the varied
    numbers of the cranes; and of the accelerations, which it writes. Python calls it to compare the
    code with Pinocchio. It computes in the units of the steps, of which a step of 1 s leaves the
    unit of time as it is: so a mistake in the unit of mass is found, too. It computes in doubles,
    also beside a loop of single precision: the formulas are the same, and a mistake in them would
    be lost in the rounding errors of single precision.
    """
    if not source.options.threads:
        # It is called a few times only, which is not worth the time to optimise it.
        code.function.attributes.add("noinline")
        code.function.attributes.add("optnone")
    crane, units = source.in_steps(source.plant(code, code.argument["numbers"]), 1.0)
    sections = source.sizes.query
    query = [code.load(code.argument["query"], i * code.stride) for i in range(size(sections))]
    columns = slices(sections)
    q = array(query[columns["q"]])
    v = array(query[columns["v"]])
    command = array(query[columns["command"]])
    forces = array(query[columns["force"]])
    plant_forces = forces * units.force if source.options.forces else None
    root = None
    if source.options.base:
        # The unit of time is 1 s here.
        root = RootMotion.of(array(query[columns["root"]]))
    dynamics = crane.forward_dynamics(q, v, command * units.command, plant_forces, root=root)
    for i, acceleration in enumerate(dynamics.acceleration):
        code.store(acceleration, code.argument["accelerations"], i * code.stride)
    code.end()


def _emit_run_groups(code: Code, run: ir.Function) -> None:
    """Emit the function that runs the loop for each of many groups, whose calls stand one after
    another in memory. One call from Python costs more than the steps of a group.
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
        needed: Efforts that the command asks for, before limits [N m or N], shape (m,).
        effort: Efforts of the drives from this instant on [N m or N], shape (m,).
        effort_before: Efforts of the drives up to this instant [N m or N], shape (m,).
        forces: External forces from this instant on [N], shape (3 points,); None without.
        cable_buffer_force: Force of the buffers at the ends of the cable [N].
        saturated: 1 where a command exceeds the largest rate of a converter, else 0; empty without
            converters.
        holds: Whether the model holds.
    """

    q: np.ndarray
    v: np.ndarray
    needed: np.ndarray
    effort: np.ndarray
    effort_before: np.ndarray
    forces: np.ndarray | None
    cable_buffer_force: Any
    saturated: list[Any]
    holds: ir.Value


class _Efforts(NamedTuple):
    """Efforts of the drives about a control instant [N m or N], shape (m,) each.

    Attributes:
        needed: What the command asks for, before limits.
        after: Efforts from the instant on.
        before: Efforts up to the instant.
    """

    needed: np.ndarray
    after: np.ndarray
    before: np.ndarray


class _TableRow:
    """Row of a table for a control instant, one for all lanes or one for each."""

    def __init__(
        self, code: Code, addresses: Sequence[ir.Value], columns: dict[str, slice], width: int
    ) -> None:
        self._code = code
        self._addresses = addresses
        self._columns = columns
        self._width = width

    def section(self, name: str) -> np.ndarray:
        """Load the numbers of a section."""
        columns = range(self._width)[self._columns[name]]
        return array([self._code.gather(self._addresses, i) for i in columns])


class _Loop:
    """Loop over control instants under construction.

    The state and the summary are variables on the stack while the loop runs, and are stored in
    memory at its end. Sine and cosine of the angle of each revolute joint are such variables, too:
    a step rotates them by the change of the angle, which takes less time than to compute them, see
    `cranedyn.compiled.angles`.

    Attributes:
        code: The function.
        options: Features of the code.
        sizes: Layout of the buffers.
        call_values: What the slots of the call hold, by name, see `SLOT_TYPES`.
        team: The groups that take turns, see `cranedyn.compiled.team`; None for code that runs one
            group.
        dt: Physics step [s].
        period: Control period [s].
        plant: The crane in SI units.
        stepping_plant: The crane in the units in which it steps.
        units: These units.
        state: Variables of the state, by section.
        summary: Variables of the summary, by section; empty without one.
        held: Variables of what acts during a control period, in the units of the steps: "command",
            but for drives with converters, and "force", where external forces act.
        angles: Variables of sine and cosine of each revolute joint, by its index; empty for
            threads, which have few registers and compute them where they are needed.
        rounded_off: In single precision, variables of what rounding has added to each coordinate,
            see `_compensated`; else empty.
        loaded_angles: Values of these variables that the code has loaded so far. What nothing uses
            of them need not be updated, see `_used_angles`.
    """

    def __init__(self, code: Code, source: KernelSource) -> None:
        self.code = code
        self.options = source.options
        self.sizes = source.sizes
        call = code.argument["call"]
        self.call_values = {}
        for name, slot in SLOTS.items():
            self.call_values[name] = code.load_one(call, slot, SLOT_TYPES[name])
        self.team = Team(code, call) if source.works_in_teams else None
        self.dt = code.from_double(self.call_values["dt"])
        self.period = code.from_double(self.call_values["period"])
        self.plant = source.plant(code, self.call_values["numbers"])
        self.stepping_plant, self.units = source.in_steps(self.plant, self.dt)
        self.state = self._variables(self.sizes.state)
        self.summary: dict[str, list[StackVariable]] = {}
        if self.options.summary:
            self.summary = self._variables(self.sizes.summary)
        self.held = self._variables({"command": self.sizes.m})
        if self.options.forces:
            self.held |= self._variables({"force": size(self.sizes.force)})

        self.angles: dict[int, list[StackVariable]] = {}
        for i, joint in enumerate(source.topology.layout.joints):
            if joint.kind == "revolute" and not self.options.threads:
                self.angles[i] = [self._variable(), self._variable()]
        self.loaded_angles: dict[int, list[Value]] = {i: [] for i in self.angles}
        self.rounded_off: list[StackVariable] = []
        if self.options.single:
            self.rounded_off = [self._variable() for _ in range(self.sizes.n)]

    # --- variables and tables ---------------------------------------------------------------------

    @contextmanager
    def _each_group(self) -> Iterator[None]:
        """Emit statements for each group of the team; without a team, for the only group."""
        if self.team is None:
            yield
            return
        with self.team.each_group():
            self.call_values |= self.team.pointers()
            yield

    def _variable(self) -> StackVariable:
        """Return a variable, which each group has for itself."""
        if self.team is None:
            return StackVariable(self.code, 0.0)
        return TeamVariable(self.code, self.team)

    def _variables(self, sections: Sections) -> dict[str, list[StackVariable]]:
        """Return variables for the numbers of some sections."""
        return {name: [self._variable() for _ in range(n)] for name, n in sections.items()}

    def _load_variables(self, name: str, variables: dict[str, list[StackVariable]]) -> None:
        """Assign the numbers of a buffer to its variables, by section."""
        for i, variable in enumerate(chain.from_iterable(variables.values())):
            variable.set(self.code.load(self.call_values[name], i * self.code.stride))

    def _store_variables(self, name: str, variables: dict[str, list[StackVariable]]) -> None:
        """Store variables, by section, in their buffer."""
        for i, variable in enumerate(chain.from_iterable(variables.values())):
            self.code.store(variable.get(), self.call_values[name], i * self.code.stride)

    def _row(self, table: str, count: ir.Value) -> _TableRow:
        """Return the row of a table; beyond its end the last row applies.

        Args:
            table: Name of the table, one of `TABLES`.
            count: Number of rows before it, such as that of the control instants.
        """
        code = self.code
        sections = getattr(self.sizes, table)
        width = size(sections)
        last = code.builder.sub(self.call_values[f"{table}_rows"], code.integer(1))
        row_of_part = code.least(count, last)
        rows = [row_of_part]
        number = TABLES.index(table)
        if not self.options.shared[number]:
            # Each lane has a part of the table, whose first rows stand in memory: those of all
            # lanes for the first table, then for the next.
            starts = self.call_values["starts"]
            first = number * code.stride
            begins = [code.load_one(starts, first + lane, INTEGER) for lane in range(code.lanes)]
            rows = [code.builder.add(begin, row_of_part) for begin in begins]
        pointer = self.call_values[table]
        addresses = [code.address(pointer, code.product(row, width)) for row in rows]
        return _TableRow(code, addresses, slices(sections), width)

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
        """Return the coordinates, and let the code know their sines and cosines."""
        q = self._get("q")
        for i, (sine_variable, cosine_variable) in self.angles.items():
            sine = sine_variable.get()
            cosine = cosine_variable.get()
            self.code.cache_angle(q[i], sine, cosine)
            self.loaded_angles[i] += [sine, cosine]
        return q

    def _used_angles(self) -> list[int]:
        """Return the joints of whose angles the code so far needs sines or cosines.

        All are loaded with the coordinates, before it is known what depends on them. Without
        external forces, for instance, nothing depends on the angle of a slew.
        """
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
        call = self.call_values
        compare = code.builder.icmp_signed
        with self._each_group():
            self._load_variables("state", self.state)
            self._load_variables("summary", self.summary)
            for variable in self.rounded_off:
                variable.set(0.0)
            self._compute_angles(self.angles)
        with code.loop(call["first"], call["last"]) as instant:
            is_first = compare("==", instant, call["first"])
            is_resumed = compare("!=", call["resumed"], code.integer(0))
            # A call may continue a control period whose control another call has run.
            has_control_run = code.both(is_first, is_resumed)
            with self._each_group():
                forces = self._forces(instant)
                with code.when(code.builder.not_(has_control_run)):
                    self._emit_control(instant, forces)
                self._hold(forces)
            with code.when(compare("<", instant, call["end"])):
                self._emit_control_period(instant)
        with self._each_group():
            self._store_variables("state", self.state)
            self._store_variables("summary", self.summary)
        code.end()

    def _hold(self, forces: np.ndarray | None) -> None:
        """Keep what acts during the coming control period, in the units of the steps.

        Args:
            forces: External forces [N], shape (3 points,); None without.
        """
        held = {"command": self._get("last_command") * self.units.command}
        if forces is not None:
            held["force"] = forces * self.units.force
        for name, values in held.items():
            for variable, value in zip(self.held[name], values, strict=True):
                variable.set(value)

    def _held(self, name: str) -> np.ndarray:
        """Return what `_hold` has kept, by name."""
        return array([variable.get() for variable in self.held[name]])

    def _emit_control_period(self, instant: ir.Value) -> None:
        """Emit the steps of the control period that begins at an instant.

        Sines and cosines are updated step by step, each time with a rounding error. They are
        computed afresh every `KernelOptions.angle_refresh_steps` steps and at the end of the
        period. In between, rates are in the units of the steps, see `KernelSource.in_steps`.
        """
        code = self.code
        steps = self.call_values["steps"]
        if self.options.threads:
            # Threads keep no sines and cosines, and step in SI units.
            self._emit_steps(instant, code.integer(0), steps)
            return
        together = self.options.angle_refresh_steps
        pieces = code.builder.sdiv(code.plus(steps, together - 1), code.integer(together))
        with code.loop(0, pieces) as piece:
            first = code.product(piece, together)
            last = code.least(code.plus(first, together), steps)
            with self._each_group():
                self._set("v", self._get("v") * self.units.time)
            self._emit_steps(instant, first, last)
            joints = self._used_angles()
            with self._each_group():
                self._set("v", [code.quotient(rate, self.units.time) for rate in self._get("v")])
                self._compute_angles(joints)

    @contextmanager
    def _each_step(
        self, first: ir.Value, last: ir.Value
    ) -> Iterator[tuple[ir.Value, Callable[[ir.Value], None]]]:
        """Emit statements for each step, and in a step for each group of the team, see
        `Code.fast_loop`.
        """
        team = self.team
        if team is None:
            with self.code.fast_loop(first, last) as (number, end):
                yield number, end
            return
        build = self.code.builder
        turns = build.mul(first, team.count), build.mul(last, team.count)
        with self.code.fast_loop(*turns) as (turn, end):
            number = team.take_turns(turn)
            self.call_values |= team.pointers()
            yield number, end

    def _emit_steps(self, instant: ir.Value, first: ir.Value, last: ir.Value) -> None:
        """Emit steps from the first to the one before the last, counted from a control instant."""
        units = self.units
        with self._each_step(first, last) as (number, end):
            q_before = self._coordinates()
            works = self._get("contact_and_impact_work")
            v = self._get("v")
            command = self._held("command")
            if self.options.delay_steps is not None:
                # The ramps of the converters move on with each step.
                followed = self._get("last_command")
                reference, slope = self._next_reference(followed, v * (1.0 / units.time))
                self._set("reference", reference)
                self._set("reference_slope", slope)
                command = array(reference) * units.command
            step = Step(
                integrator=self.options.integrator,
                plant=self.stepping_plant,
                command=command,
                forces=self._held("force") if self.options.forces else None,
                dt=self.dt / units.time,
                unit=units.work,
                substeps=self.call_values["substeps"],
                root=self._root_of_step(instant, number),
            )
            q, v, works, anchors = step.after(StepState(q_before, v, works, self._anchors()))
            if self.options.single:
                q = self._compensated(q_before, q)
            self._set("q", q)
            self._set("v", v)
            self._set("contact_and_impact_work", works)
            if self.sizes.touching:
                self._set("anchors", anchors)
            self._rotate_angles(q, end)

    def _compensated(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return coordinates after a step in single precision, shape (n,), from which the rounding
        errors of earlier steps are taken off again.

        A coordinate of 20 m is rounded to 2 µm, and a step of 0.5 ms at 1 m/s adds 500 µm: without
        more a drive would be slower by up to 0.2 %, and one of 1 mm/s would never move. So what
        rounding adds to each sum is kept, and taken off the next increment.

        Source: Kahan, Communications of the ACM 8 (1965), 40.

        Args:
            before: Coordinates before the step.
            after: Coordinates after it, sums of `before` and the increments.
        """
        code = self.code
        coordinates = []
        # In another order of the sums nothing would be left of the compensation.
        with code.as_written():
            for start, end, rounded_off in zip(before, after, self.rounded_off, strict=True):
                increment = code.value(code.increment(end, start)) - rounded_off.get()
                coordinate = code.advanced(start, increment)
                rounded_off.set((coordinate - start) - increment)
                coordinates.append(coordinate)
        return array(coordinates)

    def _root_of_step(self, instant: ir.Value, number: ir.Value) -> np.ndarray | None:
        """Return the motion of the base at the beginning, in the middle and at the end of a physics
        step, in the units of the steps, shape (3, 9); None for a base at rest.

        Args:
            instant: Control instant before the step.
            number: Steps since this instant in this call.
        """
        if not self.options.base:
            return None
        code = self.code
        step_of_period = code.builder.add(self.call_values["done"], number)
        samples = []
        for sample in range(SAMPLES_PER_STEP + 1):
            motion = self._root(instant, step_of_period, sample).in_steps(self.units.time)
            samples.append(np.concatenate(motion))
        return np.array(samples)

    def _root_at(self, instant: ir.Value) -> RootMotion | None:
        """Return the motion of the base at a control instant; None for a base at rest."""
        if not self.options.base:
            return None
        return self._root(instant, self.code.integer(0), 0)

    def _root(self, instant: ir.Value, step: ir.Value, sample: int) -> RootMotion:
        """Return a sample of the motion of the base in SI units.

        Args:
            instant: Control instant before it.
            step: Physics steps since this instant.
            sample: Half steps since this step.
        """
        code = self.code
        build = code.builder
        steps = build.add(build.mul(instant, self.call_values["period_steps"]), step)
        row = code.plus(code.product(steps, SAMPLES_PER_STEP), sample)
        last = build.sub(self.call_values["root_rows"], code.integer(1))
        row_of_part = code.least(row, last)
        rows = [row_of_part]
        if self.options.base_by_lane:
            starts = self.call_values["root_starts"]
            begins = [code.load_one(starts, lane, INTEGER) for lane in range(code.lanes)]
            rows = [build.add(begin, row_of_part) for begin in begins]
        table = self.call_values["root"]
        addresses = [code.address(table, code.product(row, ROOT_NUMBERS)) for row in rows]
        numbers = [code.gather(addresses, i) for i in range(ROOT_NUMBERS)]
        return RootMotion.of(array(numbers))

    def _rotate_angles(self, q: np.ndarray, end: Callable[[ir.Value], None]) -> None:
        """Update sines and cosines after a step to coordinates, and end the loop over steps.

        A short series rotates them by the change of the angle. It is precise for small changes. In
        the rare case that a joint has turned farther in some lane, the fast loop is left for a
        longer series, or for a full evaluation, of the angles of these lanes.

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
        if not self.options.forces:
            return None
        since_start = self.code.most(instant, self.code.integer(0))
        row = self.code.builder.sdiv(since_start, self.call_values["force_interval"])
        forces = self._row("force", row).section("force")
        if not self.options.areas:
            return forces
        # The table then holds the velocity of the wind.
        return self.plant.drag(self._coordinates(), self._get("v"), forces, self.options.areas)

    def _forces_before(self, instant: ir.Value) -> np.ndarray | None:
        """Return the external forces up to an instant.

        Given forces stand in the table. The drag of a wind depends on the state at the instant
        before, which has passed: it is remembered from there.
        """
        if self.options.areas:
            return self._get("previous_force")
        return self._forces(self.code.builder.sub(instant, self.code.integer(1)))

    # --- the control instant ----------------------------------------------------------------------

    def _emit_control(self, instant: ir.Value, forces: np.ndarray | None) -> None:
        """Emit a control instant: the command, and what is recorded of it.

        Args:
            instant: The instant.
            forces: External forces from this instant on [N], shape (3 points,); None without.
        """
        q = self._coordinates()
        v = self._get("v")
        followed_before = self._get("last_command")
        requested = self._controller_command(instant, q, v)
        if self.options.delay_steps is None:
            followed = self.plant.within(requested)
        else:
            followed = self._delay_command(requested)
        self._set("last_command", followed)
        if not (self.options.log or self.options.summary):
            return
        values = self._instant_values(instant, q, v, requested, followed, followed_before, forces)
        if self.options.log:
            self._store_row(instant, self._log_row(instant, values))
        if self.options.summary:
            self._update_summary(instant, values)

    def _delay_command(self, requested: np.ndarray) -> np.ndarray:
        """Return the command that reaches the converters at this instant, shape (m,), and put the
        present one at the end of those on their way.

        Args:
            requested: Command of the controller, shape (m,).
        """
        assert self.plant.response is not None
        m = self.sizes.m
        queue = [*self._get("delayed_commands"), *self.plant.response.quantize_commands(requested)]
        self._set("delayed_commands", queue[m:])
        return array(queue[:m])

    def _instant_values(
        self,
        instant: ir.Value,
        q: np.ndarray,
        v: np.ndarray,
        requested: np.ndarray,
        followed: np.ndarray,
        followed_before: np.ndarray,
        forces: np.ndarray | None,
    ) -> _InstantValues:
        """Return the quantities of the crane at an instant.

        Args:
            instant: The instant.
            q: Coordinates.
            v: Rates.
            requested: Command of the controller.
            followed: What the drives follow from now on: efforts within the limits, accelerations,
                or commands that have reached the converters.
            followed_before: What they followed up to now.
            forces: External forces from now on.
        """
        code = self.code
        reactions = self.plant.ground_reactions(q, v, self._anchors())[0]
        if self.options.delay_steps is not None:
            efforts = self._efforts_of_converters(
                instant, q, v, followed, followed_before, forces, reactions
            )
        elif self.options.drive == "motion":
            efforts = self._efforts_of_motion(
                instant, q, v, requested, followed_before, forces, reactions
            )
        else:
            efforts = _Efforts(requested, followed, followed_before)
        cable_buffer_force = self.plant.stop_force(q, v)
        saturated = self._saturated(requested)
        hoist = self.plant.topology.layout.drive_of("hoist")
        hoist_force = cable_buffer_force
        if hoist is not None:
            hoist_force = efforts.after[hoist] + cable_buffer_force
        conditions = self.plant.conditions(q, v, hoist_force, efforts.needed)
        holds = code.both(*conditions, *(number < 0.5 for number in saturated))
        return _InstantValues(
            q=q,
            v=v,
            needed=efforts.needed,
            effort=efforts.after,
            effort_before=efforts.before,
            forces=forces,
            cable_buffer_force=cable_buffer_force,
            saturated=saturated,
            holds=holds,
        )

    def _efforts_of_converters(
        self,
        instant: ir.Value,
        q: np.ndarray,
        v: np.ndarray,
        followed: np.ndarray,
        followed_before: np.ndarray,
        forces: np.ndarray | None,
        reactions: Sequence[ExternalForce],
    ) -> _Efforts:
        """Return the efforts of drives behind frequency converters, which follow from the reference
        rates: those of the last step up to the instant, and those of the next step from it on.

        See `_instant_values` for the arguments; `reactions` are the forces of the ground.
        """
        root = self._root_at(instant)
        before = followed_before
        if self.options.log:
            forces_before = self._forces_before(instant)
            reference = self._get("reference")
            before = self.plant.forward_dynamics(
                q, v, reference, forces_before, reactions, root
            ).effort
        next_reference = array(self._next_reference(followed, v)[0])
        dynamics = self.plant.forward_dynamics(q, v, next_reference, forces, reactions, root)
        return _Efforts(dynamics.needed, dynamics.effort, before)

    def _efforts_of_motion(
        self,
        instant: ir.Value,
        q: np.ndarray,
        v: np.ndarray,
        requested: np.ndarray,
        followed_before: np.ndarray,
        forces: np.ndarray | None,
        reactions: Sequence[ExternalForce],
    ) -> _Efforts:
        """Return the efforts of drives that follow accelerations exactly, whatever these take.

        See `_instant_values` for the arguments; `reactions` are the forces of the ground.
        """
        forces_before = self._forces_before(instant)
        root = self._root_at(instant)
        before = self.plant.forward_dynamics(
            q, v, followed_before, forces_before, reactions, root
        ).effort
        after = self.plant.forward_dynamics(q, v, requested, forces, reactions, root).effort
        return _Efforts(after, after, before)

    def _next_reference(self, followed: np.ndarray, v: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Return the reference rates of converters after the next step, and their rates of change,
        m numbers each.

        Args:
            followed: Commands that have reached the converters, shape (m,).
            v: Rates of all joints [rad/s or m/s].
        """
        assert self.plant.response is not None
        rate = v[self.plant.topology.layout.drives]
        reference = self._get("reference")
        slope = self._get("reference_slope")
        return self.plant.response.ramped(followed, reference, slope, rate, self.dt)

    def _saturated(self, command: np.ndarray) -> list[Any]:
        """Return 1 where a command exceeds the largest rate of a converter, else 0; empty without
        converters.
        """
        if self.plant.response is None:
            return []
        values = [self.code.value(number) for number in command]
        exceeds = self.code.either(*self.plant.response.saturates(values))
        return [self.code.where(exceeds, 1.0, 0.0)]

    def _controller_command(self, instant: ir.Value, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the command of the controller, shape (m,)."""
        sizes = self.sizes
        gains = self._row("gain_table", instant)
        setpoints = self._row("setpoint_table", instant)
        z = np.concatenate([q, v])
        if self.options.offset:
            z = z + self._row("offset", instant).section("reading")
        if self.options.delayed:
            z = self._delay_reading(instant, z)
        if self.options.programme is not None:
            return self._predictive_command(self.options.programme, z, setpoints)
        # command = feed-forward - gain (state - setpoint), and what states of the controller and
        # integrals of the drives add
        gain = gains.section("gain").reshape(sizes.m, sizes.z)
        deviation = z - setpoints.section("setpoint")
        command = gains.section("feed_forward") - gain @ deviation
        states = None
        if sizes.controller_states:
            states = self._controller_states(gains)
            command = command + states.c @ states.initial
        if self.options.integral:
            self._add_integrals(command, z, gains, setpoints)
        if states is not None:
            # The whole command enters, since the limits of the drives act on it.
            self._set("controller", next_states(states, states.initial, deviation, command))
        return command

    def _controller_states(self, gains: _TableRow) -> ControllerStates:
        """Return the states of the controller at this instant as the initial ones, with their
        matrices.
        """
        k = self.sizes.controller_states
        return ControllerStates(
            a=gains.section("states.a").reshape(k, k),
            b=gains.section("states.b").reshape(k, self.sizes.z),
            c=gains.section("states.c").reshape(self.sizes.m, k),
            anti_windup=gains.section("states.anti_windup").reshape(k, self.sizes.m),
            limit=gains.section("states.limit"),
            initial=self._get("controller"),
        )

    def _add_integrals(
        self, command: np.ndarray, z: np.ndarray, gains: _TableRow, setpoints: _TableRow
    ) -> None:
        """Add the integrals of the drives to their commands, shape (m,), and move them on.

        Args:
            command: Commands without integrals, which change in place.
            z: Coordinates and rates that the controller reads, shape (2 n,).
            gains: Row of the gain table.
            setpoints: Row of the setpoint table.
        """
        integrals = self._get("integral")
        position = setpoints.section("position")
        integral_gain = gains.section("integral_gain")
        limit = gains.section("limit")
        for i, drive in enumerate(self.plant.topology.layout.drives):
            error = position[i] - z[drive]
            command[i], integrals[i] = integrated_command(
                command[i], error, integrals[i], integral_gain[i], limit[i], self.period
            )
        self._set("integral", integrals)

    def _predictive_command(
        self, programme: Programme, z: np.ndarray, setpoints: _TableRow
    ) -> np.ndarray:
        """Return the command of a predictive controller, shape (m,).

        Args:
            programme: Parameters of the controller.
            z: Coordinates and rates that it reads, shape (2 n,).
            setpoints: Row of the setpoint table.
        """
        from cranedyn.compiled.horizon.control_instant import PredictiveControl

        horizon = self.call_values["horizon"]
        control = PredictiveControl(self.code, programme, horizon, self.call_values["workspace"])
        row, due = control.count_instant()
        q = z[: self.sizes.n]
        v = z[self.sizes.n :]
        position = setpoints.section("position")
        if self.code.lanes == 1:
            return control.call_instant(q, v, position, row, due)
        return control.command(q, v, position, row, due)

    def _delay_reading(self, instant: ir.Value, z: np.ndarray) -> np.ndarray:
        """Store the present reading and return the delayed one, shape (2 n,).

        The readings are a ring: the one of an instant stands in the row of its number modulo the
        number of rows. Before the delay has passed, the first reading is seen.

        Args:
            instant: The instant.
            z: Coordinates and rates at this instant, with the offsets of the sensors, shape (2 n,).
        """
        code = self.code
        build = code.builder
        readings = self.call_values["readings"]

        def place(count: ir.Value, i: int) -> ir.Value:
            """Return the index of number i of the reading of an instant, in the first lane."""
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
        efforts = [*values.needed, *values.effort, *values.effort_before]
        energy = self.plant.energy(q, v)
        contacts = [*self._get("contact_and_impact_work"), values.cable_buffer_force]
        if not self.options.ledger:
            return [*q, *v, *efforts, energy, *contacts, *values.saturated]
        setpoint = self._row("setpoint_table", instant).section("position")
        forces: Any = values.forces
        if forces is None:
            forces = [0.0] * size(self.sizes.force)
        unused = 0.0
        saturated = values.saturated or [0.0]
        row = [*setpoint, *q, *v, *efforts, *forces, unused, *contacts, *saturated, energy]
        self._set("previous_force", forces)
        return self._with_energy_ledger(row, values)

    def _store_row(self, instant: ir.Value, row: Sequence[Any]) -> None:
        """Store a row of the log where one is due at an instant."""
        code = self.code
        build = code.builder
        interval = self.call_values["log_interval"]
        each_instant = self.options.ledger
        due = build.icmp_signed("==", build.srem(instant, interval), code.integer(0))
        with nullcontext() if each_instant else code.when(due):
            index = instant if each_instant else build.sdiv(instant, interval)
            first = code.product(index, len(row) * code.stride)
            begin = code.address(self.call_values["log"], first)
            for i, value in enumerate(row):
                code.store(value, begin, i * code.stride)

    def _with_energy_ledger(self, row: list[Any], values: _InstantValues) -> list[Any]:
        """Return a row of the log of `simulate`, completed by work, dissipation and validity, and
        note whether the run has diverged.

        Work and dissipation are sums from row to row by the trapezoidal rule, rounded in the order
        of `cranedyn.simulation.log.Log`, which computes the same, so that both give the same bits.

        Args:
            row: The row from the setpoint up to the energy.
            values: Quantities of the crane at the instant.
        """
        code = self.code
        q = values.q
        v = values.v
        drives = self.plant.topology.layout.drives
        with code.as_written():
            power = self.plant.joint.dissipation(q, v)
            # Semi-implicit Euler steps coordinates ahead of the rates, see `Log`.
            position = q[drives] - v[drives] * (self.options.integrator.lead * self.dt)
            # 0 at the first row, which adds nothing, and 1 after that.
            has_previous = self._get("has_previous_row")
            moved = position - self._get("previous_position")
            mean_effort = (self._get("previous_effort") + values.effort_before) / 2.0
            work = mean_effort * moved * has_previous
            mean_power = (self._get("previous_power") + power) / 2.0
            loss = mean_power * self.period * has_previous
            self._set("work", self._get("work") + work)
            self._set("dissipated", self._get("dissipated") + loss)
        self._set("previous_position", position)
        self._set("previous_effort", values.effort)
        self._set("previous_power", [power])
        self._set("has_previous_row", [1.0])
        row = [*row, *self._get("work"), *self._get("dissipated")]

        # A sum is finite only if all its terms are: one comparison in place of many. Setpoints are
        # left out, as their table has been checked, and rates, which must be far below infinity.
        checked = [*q, *row[self.sizes.m + self.sizes.z :]]
        numbers_are_finite = abs(_pairwise_sum(checked)) < np.inf
        is_bounded = code.both(numbers_are_finite, v @ v < DIVERGED**2)
        _keep_largest(code, self.state["diverged"][0], code.where(is_bounded, 0.0, 1.0))
        # NaN asks the log to judge the row, and to find out why the model does not hold.
        return [*row, code.where(values.holds, 1.0, np.nan)]

    def _update_summary(self, instant: ir.Value, values: _InstantValues) -> None:
        """Update the summary of the run, see `BufferLayout.summary`."""
        code = self.code
        summary = self.summary
        squared_swing, squared_amplitude = self.plant.swing(values.q, values.v)
        swing = code.value(squared_swing)
        amplitude = code.value(squared_amplitude)
        _keep_largest(code, summary["peak"][0], swing)
        is_residual = code.builder.icmp_signed(">=", instant, self.call_values["residual_from"])
        with code.when(is_residual):
            _keep_largest(code, summary["residual"][0], amplitude)
        for variable, effort in zip(summary["effort"], values.effort, strict=True):
            _keep_largest(code, variable, code.call("llvm.fabs", effort))
        now = code.from_integer(instant)
        first_invalid = summary["invalid"][0]
        # As a number, the instant is exact up to 2⁵³.
        unchanged = first_invalid.get()
        earlier = code.call("llvm.minnum", first_invalid.get(), now)
        first_invalid.set(code.where(values.holds, unchanged, earlier))


def _keep_largest(code: Code, variable: StackVariable, value: Value) -> None:
    """Assign a value to a variable if it is larger than the present one, or NaN, with which every
    comparison fails. A later number would replace that NaN, but a state that is NaN stays so.
    """
    old = variable.get()
    variable.set(code.where(value <= old, old, value))


def _pairwise_sum(numbers: Sequence[Any]) -> Any:
    """Return the sum of numbers, added in pairs: no term waits for all others, so that the
    processor adds several at once.
    """
    half = len(numbers) // 2
    if not half:
        return numbers[0]
    return _pairwise_sum(numbers[:half]) + _pairwise_sum(numbers[half:])
