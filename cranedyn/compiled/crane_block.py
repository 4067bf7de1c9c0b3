"""A crane as a function block: one physics step, and its outputs at a state.

`crane_block` makes it. The equations are those of `cranedyn.compiled.plant`, with the parameters of
the block in place of the numbers of the crane that they change, see `_plant`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from llvmlite import ir

from cranedyn.checks import check_choice
from cranedyn.clocks import clocks
from cranedyn.compiled.block import FAULT, BlockCode, FunctionBlock, Variable, identifiers
from cranedyn.compiled.code import Value
from cranedyn.compiled.kernel import KernelOptions
from cranedyn.compiled.plant.plant import Plant, Topology, make_plant, plant_numbers
from cranedyn.compiled.step import Step, StepState, check_rule
from cranedyn.compiled.verify import compile_kernel
from cranedyn.disturbances.base_motion import COORDINATES, UNITS, angular_motion, attitude
from cranedyn.dynamics.converters import converters_of_run
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.root_motion import SAMPLES_PER_STEP, RootMotion
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane

COMMUNICATION = 10
"""Physics steps from one change of the inputs to the next, as a rule. The delay of the converters
is a multiple of it."""

_MIN_PAYLOAD_MASS = 1e-3
"""Smallest mass of the load that a block takes [kg]."""

_MAX_PAYLOAD_MASS = 1e9
"""Largest mass of the load that a block takes [kg]."""

_MIN_LIMIT = 1e-9
"""Smallest rate limit, acceleration or jerk of a converter that a block takes, in their units."""


@dataclass(frozen=True)
class _ConverterNumber:
    """A number of a frequency converter, which is a parameter of a block.

    Attributes:
        name: Name, behind the symbol of the joint.
        unit: Unit, in which {} stands for that of the joint.
        lower: Smallest value; None for the physics step.
        about: Description.
    """

    name: str
    unit: str
    lower: float | None
    about: str


_CONVERTER_NUMBERS = (
    _ConverterNumber("rate_limit", "{}/s", _MIN_LIMIT, "commands beyond are cut to it"),
    _ConverterNumber("ramp", "{}/s2", _MIN_LIMIT, "largest acceleration of the ramp"),
    _ConverterNumber("jerk", "{}/s3", _MIN_LIMIT, "largest jerk of the ramp"),
    _ConverterNumber("lag", "s", None, "time constant of the speed control"),
    _ConverterNumber("resolution", "{}/s", 0.0, "to which commands are rounded"),
)
"""Numbers of a frequency converter, in the order of `Response`."""


def crane_block(
    crane: Crane,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    integrator: Integrator = semi_implicit_euler,
    base: bool = False,
) -> FunctionBlock:
    """Return a crane as a block: "outputs" computes accelerations, efforts, energy and validity at
    the state under the inputs, "step" the state a physics step later.

    Parameters are the mass of the load, the length of the cable beyond the coordinate of the hoist,
    the damping of each joint, a horizontal wind on the load, and with "velocity" the numbers of
    typical frequency converters, whose delay is rounded up to a multiple of `COMMUNICATION` physics
    steps.

    On a base that moves, the motion of the base is an input, see `base_inputs`, and is held over a
    call as all inputs are. Coordinates, rates and energy are then those relative to the base.

    Args:
        crane: The crane.
        drive: Inputs: "effort", or with "motion" accelerations, or with "velocity" rates.
        dt: Physics step [s].
        integrator: The stepping rule.
        base: Whether the base on which the crane stands moves.

    Raises:
        OutOfRange: If a number is out of range, or there is no code for the stepping rule.
        ModelError: If the rope goes slack and taut within a step, or the code would not do what
            Pinocchio does.
    """
    check_choice("drive", drive, Drive)
    clocks(dt, dt, dt)
    check_rule(integrator)
    rope = crane.springs.rope
    if rope is not None and (rope.inextensible or integrator.smooth):
        raise ModelError(
            "The rope may go slack, which a block cannot follow within a step; give a finite "
            "rope_stiffness and semi-implicit Euler, or 0 for a rope that is always taut."
        )
    response = np.zeros(0)
    delay = 0
    arrays = {}
    drives = converters_of_run(crane, drive, None)
    if drives is not None:
        response = np.concatenate(drives.response)
        delay = COMMUNICATION * drives.delay_steps(dt, COMMUNICATION * dt)
        # Rows of m numbers: reference rates, their slopes, the rates of the first call, and a ring
        # of the commands on their way, see `_CraneCode.followed_command`.
        arrays = {"converters": np.zeros((3 + max(delay, 1)) * crane.layout.m)}
    # The kernel itself is not needed. But its equations are those of the block, and to compile it
    # compares them with Pinocchio.
    options = KernelOptions(
        1, drive, integrator, forces=True, delay_steps=0 if arrays else None, base=base
    )
    compile_kernel([crane], options, response if arrays else None)

    names = _names(crane, drive)
    block = FunctionBlock(
        "crane",
        f"A crane of drive mode {drive}{' on a base that moves' if base else ''}.",
        dt,
        _variables(crane, drive, names, response, dt, base=base),
        arrays,
        # The count of calls gives the row of the ring, its remainder by the delay, and tells the
        # calls before a whole delay has passed. After 2 delay - 1 it goes on at the delay.
        last=max(2 * delay - 1, 1) if arrays else 0,
        first=max(delay, 1),
        renamed={name: new for name, new in names.identifier.items() if name != new},
        at_fault="At a fault the crane stands still as it is, and valid is 0.",
    )

    def outputs(code: BlockCode) -> Mapping[str, Any]:
        return _outputs(_CraneCode(code, crane, drive, names, base=base), names, delay, dt)

    def step(code: BlockCode) -> Mapping[str, Any]:
        crane_code = _CraneCode(code, crane, drive, names, base=base)
        command = crane_code.followed_command(delay, dt, keep=True)
        root = None
        if crane_code.root is not None:
            # The inputs are held: the base feels the same at the beginning, in the middle and at
            # the end of the step.
            root = np.tile(np.concatenate(crane_code.root), (SAMPLES_PER_STEP + 1, 1))
        rule = Step(integrator, crane_code.plant, command, crane_code.forces, dt, 1.0, 1, root=root)
        no_work = array([0.0, 0.0])
        after = rule.after(StepState(crane_code.q, crane_code.v, no_work))
        readings = []
        for coordinate, offset in zip(after.q, crane_code.offset, strict=True):
            readings.append(coordinate - offset)
        return dict(zip(names.state, [*readings, *after.v], strict=True))

    block.emit(FAULT, lambda code: {"valid": 0.0})
    block.emit("outputs", outputs)
    block.emit("step", step)
    return block


@dataclass(frozen=True)
class BaseInput:
    """An input of a crane on a base that moves.

    Attributes:
        name: Its name.
        unit: Its unit.
        about: What it is.
    """

    name: str
    unit: str
    about: str


def base_inputs() -> list[BaseInput]:
    """Return the inputs that say how the base moves, of any crane on a base that moves.

    They are the coordinates of `cranedyn.disturbances.base_motion`, with its frames and signs: the
    accelerations of all six, the angles and their rates, and the velocity of the origin, on which
    the wind depends.
    """
    inputs = []
    for name, unit in zip(COORDINATES, UNITS, strict=True):
        where = "along an axis of the world" if unit == "m" else "angle, Rz(yaw) Ry(pitch) Rx(roll)"
        if unit == "rad":
            inputs.append(BaseInput(f"base_{name}", unit, f"{name} of the base: {where}"))
        inputs.append(BaseInput(f"base_{name}_dot", f"{unit}/s", f"rate of the {name}"))
        about = f"acceleration of the {name}: {where}"
        inputs.append(BaseInput(f"base_{name}_ddot", f"{unit}/s2", about))
    return inputs


def force_names(crane: Crane) -> list[str]:
    """Return the names of the external forces on each point along each axis of the world, such as
    payload_force_x.
    """
    return [f"{point}_force_{axis}" for point in crane.layout.points for axis in "xyz"]


@dataclass(frozen=True)
class _Names:
    """Identifiers of the variables of a crane's block.

    Attributes:
        state: Coordinates, then rates.
        accelerations: Accelerations of the coordinates.
        efforts: Efforts of the drives.
        commands: Commands of the drives.
        forces: External forces, see `force_names`.
        dampings: Viscous damping of each joint.
        converters: Numbers of the frequency converters, those of all drives for each; empty without
            converters.
        base: Motion of the base, see `base_inputs`, by the names there.
        identifier: Identifiers by the names of the signals.
    """

    state: list[str]
    accelerations: list[str]
    efforts: list[str]
    commands: list[str]
    forces: list[str]
    dampings: list[str]
    converters: list[str]
    base: dict[str, str]
    identifier: dict[str, str]


def _names(crane: Crane, drive: str) -> _Names:
    """Choose the identifiers of the variables."""
    layout = crane.layout
    symbols = layout.symbols
    driven = [joint.symbol for joint in layout.driven]
    efforts = [joint.effort_name for joint in layout.driven]
    state = [*symbols, *(f"{symbol}_dot" for symbol in symbols)]
    accelerations = [f"{symbol}_ddot" for symbol in symbols]
    ending = "dot" if drive == "velocity" else "ddot"
    commanded = efforts if drive == "effort" else [f"{symbol}_{ending}" for symbol in driven]
    commands = [f"{name}_command" for name in commanded]
    forces = force_names(crane)
    dampings = [f"{symbol}_damping" for symbol in symbols]
    converters = []
    if drive == "velocity":
        for number in _CONVERTER_NUMBERS:
            converters += [f"{symbol}_{number.name}" for symbol in driven]

    # Last, so that a crane has the same identifiers on any base.
    bases = [one.name for one in base_inputs()]

    # All at once: an identifier is distinct among the names that are given together.
    others = ["payload_mass", "cable_offset", "wind_x", "wind_y", "payload_area", "energy", "valid"]
    signals = [
        *others,
        *state,
        *accelerations,
        *efforts,
        *commands,
        *forces,
        *dampings,
        *converters,
        *bases,
    ]
    identifier = identifiers(signals)
    return _Names(
        state=[identifier[name] for name in state],
        accelerations=[identifier[name] for name in accelerations],
        efforts=[identifier[name] for name in efforts],
        commands=[identifier[name] for name in commands],
        forces=[identifier[name] for name in forces],
        dampings=[identifier[name] for name in dampings],
        converters=[identifier[name] for name in converters],
        base={name: identifier[name] for name in bases},
        identifier=identifier,
    )


def _variables(
    crane: Crane, drive: str, names: _Names, response: np.ndarray, dt: float, *, base: bool
) -> tuple[Variable, ...]:
    """Return the variables of the block in the order of its memory.

    Args:
        crane: The crane.
        drive: What its inputs are.
        names: Identifiers of the variables.
        response: Usual numbers of the converters, in the order of `_CONVERTER_NUMBERS`; empty
            without converters.
        dt: Physics step [s].
        base: Whether the base moves.
    """
    layout = crane.layout
    several = Variable.several
    effort_units = [joint.effort_unit.replace(" ", ".") for joint in layout.driven]
    per = "/s" if drive == "velocity" else "/s2"
    command_units = [f"{joint.unit}{per}" for joint in layout.driven]
    holding = np.zeros(layout.m)
    if drive == "effort":
        command_units = effort_units
        holding = holding_effort(crane, crane.start.q)

    variables = several(
        names.commands, "input", command_units, holding, about="command of the drive"
    )
    variables += several(names.forces, "input", "N", about="external force in the world")
    if base:
        for one in base_inputs():
            variables.append(Variable(names.base[one.name], "input", one.unit, about=one.about))
    variables += _parameters(crane, names, response, dt)

    state_units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    unbounded = np.full(layout.n, np.inf)
    lower = np.append(crane.lower, -unbounded)
    upper = np.append(crane.upper, unbounded)
    start = np.concatenate(crane.start)
    variables += several(names.state, "state", state_units, start, lower, upper)
    acceleration_units = [f"{unit}/s2" for unit in layout.units]
    variables += several(names.accelerations, "output", acceleration_units)
    variables += several(names.efforts, "output", effort_units, about="effort of the drive")
    about = "mechanical, zero of height at the ground"
    if base:
        about = "mechanical, that of a crane on a base at rest in the same state"
    variables.append(Variable("energy", "output", "J", about=about))
    about = "1 where the model holds, 0 where it does not"
    variables.append(Variable("valid", "output", about=about))
    return tuple(variables)


def _parameters(crane: Crane, names: _Names, response: np.ndarray, dt: float) -> list[Variable]:
    """Return the parameters of the block, see `_variables`."""
    layout = crane.layout
    several = Variable.several
    parameters = [
        Variable(
            "payload_mass",
            "parameter",
            "kg",
            crane.payload_mass,
            _MIN_PAYLOAD_MASS,
            _MAX_PAYLOAD_MASS,
            "the load",
        )
    ]
    if layout.has("hoist"):
        about = "cable beyond the coordinate of the hoist"
        parameters.append(Variable("cable_offset", "parameter", "m", about=about))

    units = []
    for joint in layout.joints:
        units.append("N.m.s/rad" if joint.kind == "revolute" else "N.s/m")
    about = "viscous damping"
    parameters += several(names.dampings, "parameter", units, crane.damping, 0.0, about=about)

    if len(response):
        for i, number in enumerate(_CONVERTER_NUMBERS):
            of_drives = slice(i * layout.m, (i + 1) * layout.m)
            parameters += several(
                names.converters[of_drives],
                "parameter",
                [number.unit.format(joint.unit) for joint in layout.driven],
                response[of_drives],
                # In a step longer than its lag a rate would pass beyond its reference.
                dt if number.lower is None else number.lower,
                about=number.about,
            )

    about = "wind on the load in the world"
    parameters += several(["wind_x", "wind_y"], "parameter", "m/s", about=about)
    about = "drag coefficient times area of the load"
    parameters.append(Variable("payload_area", "parameter", "m2", lower=0.0, about=about))
    return parameters


class _CraneCode:
    """State, inputs and crane in the code of a function.

    Attributes:
        code: The function.
        plant: The crane, with its parameters.
        q: Coordinates, shape (n,); the cable has its true length.
        v: Rates, shape (n,).
        offset: Coordinates less their readings, shape (n,).
        command: Commands of the drives, shape (m,).
        forces: External forces with wind [N], shape (3 points,), in the axes of the base.
        root: Motion of the base; None for one at rest.
    """

    def __init__(
        self, code: BlockCode, crane: Crane, drive: str, names: _Names, *, base: bool
    ) -> None:
        layout = crane.layout
        self.code = code
        self.plant = _plant(code, crane, drive, names)
        z = code.get_all(names.state)
        self.offset = array([0.0] * layout.n)
        if layout.has("hoist"):
            self.offset[layout.role("hoist", "")] = code.get("cable_offset")
        self.q = z[: layout.n] + self.offset
        self.v = z[layout.n :]
        self.command = code.get_all(names.commands)
        forces = code.get_all(names.forces)
        payload_area = code.get("payload_area")
        areas = array([payload_area if point == "payload" else 0.0 for point in layout.points])
        wind = array([code.get("wind_x"), code.get("wind_y"), 0.0])
        self.root: RootMotion | None = None
        turning = None
        if base:
            moving = _MovingBase(code, names)
            gravity = crane.model.gravity.linear
            self.root = moving.root(gravity)
            turning = self.root.omega
            wind = moving.in_axes(wind - moving.velocity)
            forces = np.concatenate([moving.in_axes(force) for force in forces.reshape(-1, 3)])
        air = np.tile(wind, len(areas))
        self.forces = forces + self.plant.drag(self.q, self.v, air, areas, turning)

    def followed_command(self, delay: int, dt: float, *, keep: bool) -> np.ndarray:
        """Return the command that the plant follows in a step, shape (m,): efforts within the
        limits, accelerations, or reference rates of converters.

        Converters remember the reference rate of their ramp, its slope, the rates of the first
        call, and the commands of the last `delay` calls in a ring. Until the first command has
        passed the delay, they are commanded the rates of the first call: those with which the
        drives begin.

        Args:
            delay: Time from a command to its effect, in physics steps.
            dt: Physics step [s].
            keep: Whether the memory of the converters goes on.
        """
        code = self.code
        build = code.builder
        response = self.plant.response
        m = len(self.command)
        if response is None:
            return self.plant.within(self.command)
        rates = self.v[self.plant.topology.layout.drives]
        memory = array([code.element("converters", i) for i in range(3 * m)])
        stored_reference, slope, stored_first = memory.reshape(3, m)
        is_first_call = build.icmp_signed("==", code.count, code.integer(0))
        reference = self._chosen(is_first_call, rates, stored_reference)
        first = self._chosen(is_first_call, rates, stored_first)

        heard = response.quantize_commands(self.command)
        sent: Any = heard
        row = build.srem(code.count, code.integer(max(delay, 1)))
        places = [code.plus(code.product(row, m), 3 * m + i) for i in range(m)]
        if delay:
            is_early = build.icmp_signed("<", code.count, code.integer(delay))
            waiting = array([code.element("converters", place) for place in places])
            sent = self._chosen(is_early, first, waiting)
        ramped, slopes = response.ramped(sent, reference, slope, rates, dt)
        if keep:
            for i, value in enumerate([*ramped, *slopes, *first]):
                code.put("converters", i, value)
            for place, value in zip(places, heard, strict=True):
                code.put("converters", place, value)
        return array(ramped)

    def _chosen(self, condition: ir.Value, yes: np.ndarray, no: np.ndarray) -> np.ndarray:
        """Return one array where a condition holds, and another elsewhere."""
        values = []
        for if_so, if_not in zip(yes, no, strict=True):
            values.append(self.code.where(condition, if_so, if_not))
        return array(values)


class _MovingBase:
    """The base on which a crane stands, in the code of a function.

    Attributes:
        velocity: Velocity of the origin in the world [m/s], shape (3,).
    """

    def __init__(self, code: BlockCode, names: _Names) -> None:
        def numbers(coordinates: Sequence[str], ending: str) -> list[Value]:
            """Return the inputs of some coordinates."""
            return [code.get(names.base[f"base_{name}{ending}"]) for name in coordinates]

        pairs = [code.sine_and_cosine(angle) for angle in numbers(COORDINATES[3:], "")]
        sines, cosines = zip(*pairs, strict=True)
        rates = numbers(COORDINATES[3:], "_dot")
        accelerations = numbers(COORDINATES[3:], "_ddot")
        self._turning = angular_motion(sines, cosines, rates, accelerations)
        self._rotation = np.array(attitude(sines, cosines), dtype=object)
        self.velocity = array(numbers(COORDINATES[:3], "_dot"))
        self._acceleration = array(numbers(COORDINATES[:3], "_ddot"))

    def in_axes(self, vector: np.ndarray) -> np.ndarray:
        """Return a vector in the axes of the base from that in the world, shape (3,)."""
        return self._rotation.T @ vector

    def root(self, gravity: np.ndarray) -> RootMotion:
        """Return what the crane feels of the base.

        Args:
            gravity: Gravity in the world [m/s²], shape (3,).
        """
        felt = self.in_axes(self._acceleration - array(gravity.tolist()))
        return RootMotion(array(self._turning.omega), array(self._turning.alpha), felt)


def _outputs(crane_code: _CraneCode, names: _Names, delay: int, dt: float) -> dict[str, Any]:
    """Emit the outputs of a crane at its state under its inputs, and return them by name.

    Args:
        crane_code: The crane in the code of the function.
        names: Identifiers of the variables.
        delay: Time from a command to its effect, in physics steps.
        dt: Physics step [s].
    """
    code = crane_code.code
    crane = crane_code.plant
    q = crane_code.q
    v = crane_code.v
    command = crane_code.followed_command(delay, dt, keep=False)
    dynamics = crane.forward_dynamics(q, v, command, crane_code.forces, root=crane_code.root)
    hoist = crane.topology.layout.drive_of("hoist")
    hoist_force = 0.0 if hoist is None else dynamics.effort[hoist]
    conditions = crane.conditions(q, v, hoist_force, dynamics.needed)
    if crane.response is not None:
        for cut in crane.response.saturates(crane_code.command):
            conditions.append(code.where(cut, 1.0, 0.0) < 0.5)
    outputs = dict(zip(names.accelerations, dynamics.acceleration, strict=True))
    outputs |= dict(zip(names.efforts, dynamics.effort, strict=True))
    outputs["energy"] = crane.energy(q, v)
    outputs["valid"] = code.where(code.both(*conditions), 1.0, 0.0)
    return outputs


def _plant(code: BlockCode, crane: Crane, drive: str, names: _Names) -> Plant:
    """Return the crane with its parameters in place of their numbers.

    Those that the equations of a block use are affine in the mass of the load, with its centre of
    mass and the inertia about that unchanged: the difference that one kilogram more makes is their
    slope. The damping of each joint is a number of its own; which one, a change of all dampings
    shows.
    """
    usual = plant_numbers(crane)
    values: list[Any] = usual.tolist()

    model = crane.model.copy()
    joint = crane.payload.body + 1  # joint 0 of Pinocchio is the world
    load = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(load.mass + 1.0, load.lever, load.inertia)
    heavier = plant_numbers(replace(crane, model=model))
    for i in np.flatnonzero(heavier != usual).tolist():
        slope = float(heavier[i] - usual[i])
        at_no_load = float(usual[i] - slope * crane.payload_mass)
        values[i] = code.get("payload_mass") * slope + at_no_load

    more_damped = plant_numbers(replace(crane, damping=crane.damping + 1.0))
    places = np.flatnonzero(more_damped != usual).tolist()
    for i, name in zip(places, names.dampings, strict=True):
        values[i] = code.get(name)
    values += code.get_all(names.converters).tolist()
    return make_plant(Topology.of(crane), values, drive, buffers=False)
