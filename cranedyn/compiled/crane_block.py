"""A crane as a function block: one physics step, and its outputs at a state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import check_choice
from cranedyn.clocks import clocks
from cranedyn.compiled.block import FAULT, BlockCode, FunctionBlock, Variable, identifiers
from cranedyn.compiled.kernel import Recipe
from cranedyn.compiled.step import Step, StepState, check_rule
from cranedyn.compiled.verify import compile_kernel
from cranedyn.dynamics.converters import fitting
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.plant.plant import Plant, Topology, numbers, plant

COMMUNICATION = 10
"""Physics steps from one usual change of the inputs to the next."""


class _ConverterNumber(NamedTuple):
    """One of the numbers of a frequency converter.

    Attributes:
        unit: Its unit, with {} for the unit of the joint.
        lower: Its lower limit; None for the physics step.
        about: Its description in the texts of a block.
    """

    unit: str
    lower: float | None
    about: str


_CONVERTER = {
    "rate_limit": _ConverterNumber("{}/s", 1e-9, "commands beyond are cut to it"),
    "ramp": _ConverterNumber("{}/s2", 1e-9, "largest acceleration of the ramp"),
    "jerk": _ConverterNumber("{}/s3", 1e-9, "largest jerk of the ramp"),
    "lag": _ConverterNumber("s", None, "time constant of the speed control"),
    "resolution": _ConverterNumber("{}/s", 0.0, "to which commands are rounded"),
}
"""Numbers of a frequency converter by name, in the order of `Response`."""


def crane_block(
    crane: Crane,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    integrator: Integrator = semi_implicit_euler,
) -> FunctionBlock:
    """Return a crane as a block: "outputs" computes accelerations, efforts, energy and validity at
    the state under the inputs, "step" the state a physics step later.

    Parameters are the mass of the load, the length of the cable beyond the coordinate of the hoist,
    the damping of each joint, a horizontal wind on the load, and with "velocity" the numbers of
    typical frequency converters, whose delay is rounded up to a multiple of `COMMUNICATION` physics
    steps.

    Args:
        crane: The crane.
        drive: Inputs: "effort", or with "motion" accelerations, or with "velocity" rates.
        dt: Physics step [s].
        integrator: The stepping rule.

    Raises:
        OutOfRange: If a number is out of range, or there is no code for the stepping rule.
        ModelError: If the rope goes slack and taut within a step, or the code would not do what
            Pinocchio does.
    """
    check_choice("drive", drive, Drive)
    clocks(dt, dt, dt)
    check_rule(integrator)
    if (rope := crane.springs.rope) and (rope.inextensible or integrator.smooth):
        raise ModelError(
            "The rope may go slack, which a block cannot follow within a step; give a finite "
            "rope_stiffness and semi-implicit Euler, or 0 for a rope that is always taut."
        )
    response = np.zeros(0)
    delay = 0
    arrays = {}
    converters = fitting(crane, drive, None)
    if converters is not None:
        response = np.concatenate(converters.response)
        delay = COMMUNICATION * converters.delay_steps(dt, COMMUNICATION * dt)
        # References, slopes and first rates, then a row for each command on its way, see
        # `_Text.followed`.
        arrays = {"converters": np.zeros((3 + max(delay, 1)) * crane.layout.m)}
    recipe = Recipe(1, drive, integrator, forces=True, delay_steps=0 if arrays else None)
    # The machine code is not used: it was compared with Pinocchio.
    compile_kernel([crane], recipe, response if arrays else None)
    names, identifier = _names(crane, drive)
    block = FunctionBlock(
        "crane",
        f"A crane of drive mode {drive}.",
        dt,
        _variables(crane, drive, names, response, dt),
        arrays,
        last=max(2 * delay - 1, 1) if arrays else 0,
        first=max(delay, 1),
        renamed={name: new for name, new in identifier.items() if name != new},
        at_fault="At a fault the crane stands still as it is, and valid is 0.",
    )

    def outputs(code: BlockCode) -> Mapping[str, Any]:
        text = _Text(code, crane, drive, names)
        command = text.followed(code, delay, dt, keep=False)
        dynamics = text.plant.answer(text.q, text.v, command, text.forces)
        effort = dynamics.effort
        hoist = crane.layout.drive_of("hoist")
        hoist_force = 0.0 if hoist is None else effort[hoist]
        conditions = text.plant.conditions(text.q, text.v, hoist_force, dynamics.needed)
        if text.plant.response is not None:
            cuts = text.plant.response.cuts(text.command)
            conditions += [code.chosen(cut, 1.0, 0.0) < 0.5 for cut in cuts]
        return {
            **dict(zip(names.accelerations, dynamics.acceleration, strict=True)),
            **dict(zip(names.efforts, effort, strict=True)),
            "energy": text.plant.energy(text.q, text.v),
            "valid": code.chosen(code.both(*conditions), 1.0, 0.0),
        }

    def step(code: BlockCode) -> Mapping[str, Any]:
        text = _Text(code, crane, drive, names)
        command = text.followed(code, delay, dt, keep=True)
        rule = Step(integrator, text.plant, command, text.forces, dt, 1.0, 1)
        no_work = array([0.0, 0.0])
        after = rule.after(StepState(text.q, text.v, no_work))
        readings = []
        for coordinate, offset in zip(after.q, text.offset, strict=True):
            readings.append(coordinate - offset)
        return dict(zip(names.state, [*readings, *after.v], strict=True))

    block.emit(FAULT, lambda code: {"valid": 0.0})
    block.emit("outputs", outputs)
    block.emit("step", step)
    return block


def force_names(crane: Crane) -> list[str]:
    """Return the names of the external forces on each point along each axis of the world, such as
    payload_force_x.
    """
    return [f"{point}_force_{axis}" for point in crane.layout.points for axis in "xyz"]


@dataclass(frozen=True)
class _BlockNames:
    """Identifiers of the variables of a block that come in lists.

    Attributes:
        state: Coordinates, then rates.
        accelerations: Accelerations of all joints.
        efforts: Efforts of the drives.
        commands: Commands of the drives.
        forces: External forces, see `force_names`.
        dampings: Damping of each joint.
        converters: Numbers of the frequency converters, attribute by attribute; empty without.
    """

    state: list[str]
    accelerations: list[str]
    efforts: list[str]
    commands: list[str]
    forces: list[str]
    dampings: list[str]
    converters: list[str]


def _names(crane: Crane, drive: str) -> tuple[_BlockNames, dict[str, str]]:
    """Return the identifiers of a block, and identifiers by the names of signals.

    Symbols of joints may hold characters that no language allows in an identifier.
    """
    layout = crane.layout
    symbols = layout.symbols
    driven = [joint.symbol for joint in layout.driven]
    efforts = [joint.effort_name for joint in layout.driven]
    if drive == "effort":
        followed = efforts
    elif drive == "velocity":
        followed = [f"{symbol}_dot" for symbol in driven]
    else:
        followed = [f"{symbol}_ddot" for symbol in driven]
    converter_names = []
    if drive == "velocity":
        for name in _CONVERTER:
            converter_names += [f"{symbol}_{name}" for symbol in driven]
    groups = {
        "state": [*symbols, *(f"{symbol}_dot" for symbol in symbols)],
        "accelerations": [f"{symbol}_ddot" for symbol in symbols],
        "efforts": efforts,
        "commands": [f"{name}_command" for name in followed],
        "forces": force_names(crane),
        "dampings": [f"{symbol}_damping" for symbol in symbols],
        "converters": converter_names,
    }
    signals = ["payload_mass", "cable_offset", "wind_x", "wind_y", "payload_area"]
    signals += ["energy", "valid"]
    for group in groups.values():
        signals += group
    identifier = identifiers(signals)
    lists = {name: [identifier[signal] for signal in group] for name, group in groups.items()}
    return _BlockNames(**lists), identifier


def _variables(
    crane: Crane, drive: str, names: _BlockNames, response: np.ndarray, dt: float
) -> tuple[Variable, ...]:
    """Return the variables of a block: inputs, parameters, state and outputs.

    Args:
        crane: The crane.
        drive: Kind of the commands.
        names: Identifiers.
        response: Numbers of the frequency converters in the order of `Response`; empty without.
        dt: Physics step [s].
    """
    layout = crane.layout
    several = Variable.several
    effort_units = [joint.effort_unit.replace(" ", ".") for joint in layout.driven]
    holding = np.zeros(layout.m)
    if drive == "effort":
        command_units = effort_units
        holding = holding_effort(crane, crane.start.q)
    elif drive == "velocity":
        command_units = [f"{joint.unit}/s" for joint in layout.driven]
    else:
        command_units = [f"{joint.unit}/s2" for joint in layout.driven]
    found = several(names.commands, "input", command_units, holding, about="command of the drive")
    found += several(names.forces, "input", "N", about="external force in the world")
    found += _parameters(crane, names, response, dt)

    units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    lowest_rates = np.full(layout.n, -np.inf)
    highest_rates = np.full(layout.n, np.inf)
    lowest = np.append(crane.lower, lowest_rates)
    highest = np.append(crane.upper, highest_rates)
    found += several(names.state, "state", units, np.concatenate(crane.start), lowest, highest)

    acceleration_units = [f"{unit}/s2" for unit in layout.units]
    found += several(names.accelerations, "output", acceleration_units)
    found += several(names.efforts, "output", effort_units, about="effort of the drive")
    found += several(["energy"], "output", "J", about="mechanical, zero of height at the ground")
    found += several(["valid"], "output", "", about="1 where the model holds, 0 where it does not")
    return tuple(found)


def _parameters(
    crane: Crane, names: _BlockNames, response: np.ndarray, dt: float
) -> list[Variable]:
    """Return the parameters of a block; arguments are those of `_variables`."""
    layout = crane.layout
    several = Variable.several
    mass = crane.payload_mass
    found = several(["payload_mass"], "parameter", "kg", mass, 1e-3, 1e9, about="the load")
    if layout.has("hoist"):
        about = "cable beyond the coordinate of the hoist"
        found += several(["cable_offset"], "parameter", "m", about=about)
    units = ["N.m.s/rad" if joint.kind == "revolute" else "N.s/m" for joint in layout.joints]
    about = "viscous damping"
    found += several(names.dampings, "parameter", units, crane.damping, 0.0, about=about)
    if len(response):
        for i, (unit, lower, about) in enumerate(_CONVERTER.values()):
            part = slice(i * layout.m, (i + 1) * layout.m)
            units = [unit.format(joint.unit) for joint in layout.driven]
            least = dt if lower is None else lower
            converter_names = names.converters[part]
            values = response[part]
            found += several(converter_names, "parameter", units, values, least, about=about)
    about = "wind on the load in the world"
    found += several(["wind_x", "wind_y"], "parameter", "m/s", about=about)
    about = "drag coefficient times area of the load"
    found += several(["payload_area"], "parameter", "m2", 0.0, 0.0, about=about)
    return found


class _Text:
    """State, inputs and crane in the code of a function.

    Attributes:
        plant: The crane.
        q: Coordinates, shape (n,); the cable has its true length.
        v: Rates, shape (n,).
        offset: Coordinates less their readings in the state of the block, shape (n,).
        command: Commands of the drives, shape (m,).
        forces: External forces with wind [N], shape (3 points,).
    """

    def __init__(self, code: BlockCode, crane: Crane, drive: str, names: _BlockNames) -> None:
        layout = crane.layout
        self.plant = _plant(code, crane, drive, names)
        z = code.get_all(names.state)
        self.offset = array([0.0] * layout.n)
        if layout.has("hoist"):
            self.offset[layout.role("hoist", "")] = code.get("cable_offset")
        self.q = z[: layout.n] + self.offset
        self.v = z[layout.n :]
        self.command = code.get_all(names.commands)
        self.forces = code.get_all(names.forces)
        area = {"payload": code.get("payload_area")}
        areas = array([area.get(point, 0.0) for point in layout.points])
        air = array([code.get("wind_x"), code.get("wind_y"), 0.0] * len(areas))
        self.forces = self.forces + self.plant.drag(self.q, self.v, air, areas)

    def followed(self, code: BlockCode, delay: int, dt: float, *, keep: bool) -> np.ndarray:
        """Return the command that the plant follows in a step, shape (m,): efforts within the
        limits, accelerations, or reference rates of converters.

        The array "converters" is their memory: reference rates, their slopes, and the rates at the
        first step, m numbers each; then a ring of `delay` commands, that of a step in the row of
        its number modulo the delay.

        Args:
            code: The code.
            delay: Number of steps by which commands are late.
            dt: Physics step [s].
            keep: Whether the memory goes on.
        """
        response = self.plant.response
        if response is None:
            return self.plant.within(self.command)
        m = len(self.command)
        compared = code.builder.icmp_signed
        rates = self.v[self.plant.topology.layout.drives]
        memory = array([code.element("converters", i) for i in range(3 * m)])
        reference, slope, first_rates = memory.reshape(3, m)
        # At the first step the references are the rates of the drives.
        is_first = compared("==", code.count, code.integer(0))
        for past in (reference, first_rates):
            for i in range(m):
                past[i] = code.chosen(is_first, rates[i], past[i])

        quantized = response.heard(self.command)
        sent = quantized
        row = code.builder.srem(code.count, code.integer(max(delay, 1)))
        places = [code.plus(code.product(row, m), 3 * m + i) for i in range(m)]
        if delay:
            # Until the delay of the first command has passed, the drives go on at their rates.
            is_early = compared("<", code.count, code.integer(delay))
            waiting = [code.element("converters", place) for place in places]
            sent = []
            for first_rate, waited in zip(first_rates, waiting, strict=True):
                sent.append(code.chosen(is_early, first_rate, waited))
        new_reference, new_slope = response.ramped(sent, reference, slope, rates, dt)
        if keep:
            values = [*new_reference, *new_slope, *first_rates, *quantized]
            for place, value in zip([*range(3 * m), *places], values, strict=True):
                code.put("converters", place, value)
        return array(new_reference)


def _plant(code: BlockCode, crane: Crane, drive: str, names: _BlockNames) -> Plant:
    """Return the crane with its parameters in place of their numbers.

    Which numbers a parameter changes is found by a change of it: all are linear in the mass of the
    load, and one is the damping of each joint.
    """
    usual = numbers(crane)
    values: list[Any] = usual.tolist()

    model = crane.model.copy()
    joint = crane.payload.body + 1  # joint 0 of Pinocchio is the world
    load = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(load.mass + 1.0, load.lever, load.inertia)
    heavier = numbers(replace(crane, model=model))
    for i in np.flatnonzero(heavier != usual).tolist():
        slope = float(heavier[i] - usual[i])
        at_zero = float(usual[i] - slope * crane.payload_mass)
        values[i] = code.get("payload_mass") * slope + at_zero

    more_damped = numbers(replace(crane, damping=crane.damping + 1.0))
    changed = np.flatnonzero(more_damped != usual)
    for i, name in zip(changed.tolist(), names.dampings, strict=True):
        values[i] = code.get(name)
    values += code.get_all(names.converters).tolist()
    return plant(Topology.of(crane), values, drive, buffers=False)
