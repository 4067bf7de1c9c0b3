"""A crane as a function block: one physics step, and its outputs at a state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

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

_CONVERTER = {
    "rate_limit": ("{}/s", 1e-9, "commands beyond are cut to it"),
    "ramp": ("{}/s2", 1e-9, "largest acceleration of the ramp"),
    "jerk": ("{}/s3", 1e-9, "largest jerk of the ramp"),
    "lag": ("s", None, "time constant of the speed control"),
    "resolution": ("{}/s", 0.0, "to which commands are rounded"),
}
"""Units, lower limits and descriptions of the numbers of a frequency converter, in the order of
`Response`; a lag is no less than the physics step."""


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
    if (drives := fitting(crane, drive, None)) is not None:
        response = np.concatenate(drives.response)
        delay = COMMUNICATION * drives.delay_steps(dt, COMMUNICATION * dt)
        arrays = {"converters": np.zeros((3 + max(delay, 1)) * crane.layout.m)}
    recipe = Recipe(1, drive, integrator, forces=True, delay_steps=0 if arrays else None)
    compile_kernel([crane], recipe, response if arrays else None)  # compares it with Pinocchio
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
        a, effort, needed, _ = text.plant.answer(text.q, text.v, command, text.forces)
        hoist = crane.layout.drive_of("hoist")
        hoist_force = 0.0 if hoist is None else effort[hoist]
        conditions = text.plant.conditions(text.q, text.v, hoist_force, needed)
        if text.plant.response is not None:
            cuts = text.plant.response.cuts(text.command)
            conditions += [code.chosen(cut, 1.0, 0.0) < 0.5 for cut in cuts]
        return {
            **dict(zip(names.accelerations, a, strict=True)),
            **dict(zip(names.efforts, effort, strict=True)),
            "energy": text.plant.energy(text.q, text.v),
            "valid": code.chosen(code.both(*conditions), 1.0, 0.0),
        }

    def step(code: BlockCode) -> Mapping[str, Any]:
        text = _Text(code, crane, drive, names)
        command = text.followed(code, delay, dt, keep=True)
        rule = Step(integrator, text.plant, command, text.forces, dt, 1.0, 1)
        q, v, *_ = rule.after(StepState(text.q, text.v, array([0.0, 0.0])))
        q = array([reading - offset for reading, offset in zip(q, text.offset, strict=True)])
        return dict(zip(names.state, [*q, *v], strict=True))

    block.emit(FAULT, lambda code: {"valid": 0.0})
    block.emit("outputs", outputs)
    block.emit("step", step)
    return block


def force_names(crane: Crane) -> list[str]:
    """Return the names of the external forces on each point along each axis of the world, such as
    payload_force_x.
    """
    return [f"{point}_force_{axis}" for point in crane.layout.points for axis in "xyz"]


def _names(crane: Crane, drive: str) -> tuple[SimpleNamespace, dict[str, str]]:
    """Return lists of identifiers by what they are, and identifiers by the names of signals."""
    layout = crane.layout
    velocity = drive == "velocity"
    symbols = layout.symbols
    driven = [joint.symbol for joint in layout.driven]
    efforts = [joint.effort_name for joint in layout.driven]
    rates = [f"{symbol}_{'dot' if velocity else 'ddot'}" for symbol in driven]
    groups = {
        "state": [*symbols, *(f"{symbol}_dot" for symbol in symbols)],
        "accelerations": [f"{symbol}_ddot" for symbol in symbols],
        "efforts": efforts,
        "commands": [f"{name}_command" for name in (efforts if drive == "effort" else rates)],
        "forces": force_names(crane),
        "dampings": [f"{symbol}_damping" for symbol in symbols],
        "converters": [f"{s}_{name}" for name in _CONVERTER if velocity for s in driven],
    }
    others = ["payload_mass", "cable_offset", "wind_x", "wind_y", "payload_area"]
    every = [*others, "energy", "valid", *(name for group in groups.values() for name in group)]
    identifier = identifiers(every)
    lists = {group: [identifier[name] for name in names] for group, names in groups.items()}
    return SimpleNamespace(**lists), identifier


def _variables(
    crane: Crane, drive: str, names: SimpleNamespace, response: np.ndarray, dt: float
) -> tuple[Variable, ...]:
    layout, add = crane.layout, Variable.several
    efforts = [joint.effort_unit.replace(" ", ".") for joint in layout.driven]
    per = "/s" if drive == "velocity" else "/s2"
    holding = np.zeros(layout.m)
    units = [f"{joint.unit}{per}" for joint in layout.driven]
    if drive == "effort":
        units = efforts
        holding = holding_effort(crane, crane.start.q)
    found = add(names.commands, "input", units, holding, about="command of the drive")
    found += add(names.forces, "input", "N", about="external force in the world")
    mass = crane.payload_mass
    found += add(["payload_mass"], "parameter", "kg", mass, 1e-3, 1e9, about="the load")
    if layout.has("hoist"):
        about = "cable beyond the coordinate of the hoist"
        found += add(["cable_offset"], "parameter", "m", about=about)
    units = ["N.m.s/rad" if joint.kind == "revolute" else "N.s/m" for joint in layout.joints]
    found += add(names.dampings, "parameter", units, crane.damping, 0.0, about="viscous damping")
    for i, (unit, low, about) in enumerate(_CONVERTER.values() if len(response) else ()):
        part = slice(i * layout.m, (i + 1) * layout.m)
        units = [unit.format(x.unit) for x in layout.driven]
        least = dt if low is None else low
        found += add(names.converters[part], "parameter", units, response[part], least, about=about)
    found += add(["wind_x", "wind_y"], "parameter", "m/s", about="wind on the load in the world")
    about = "drag coefficient times area of the load"
    found += add(["payload_area"], "parameter", "m2", 0.0, 0.0, about=about)
    units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    free = [np.inf] * layout.n
    lows = np.append(crane.lower, np.negative(free))
    highs = np.append(crane.upper, free)
    found += add(names.state, "state", units, np.concatenate(crane.start), lows, highs)
    found += add(names.accelerations, "output", [f"{unit}/s2" for unit in layout.units])
    found += add(names.efforts, "output", efforts, about="effort of the drive")
    found += add(["energy"], "output", "J", about="mechanical, zero of height at the ground")
    found += add(["valid"], "output", "", about="1 where the model holds, 0 where it does not")
    return tuple(found)


class _Text:
    """State, inputs and crane in the code of a function.

    Attributes:
        plant: The crane.
        q, v: Coordinates and rates, shape (n,) each; the cable has its true length.
        offset: Coordinates less their readings, shape (n,).
        command: Commands of the drives, shape (m,).
        forces: External forces with wind [N], shape (3 points,).
    """

    def __init__(self, code: BlockCode, crane: Crane, drive: str, names: SimpleNamespace) -> None:
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
        """Return the command that the plant follows in a step: efforts within the limits,
        accelerations, or reference rates of converters, whose memory then goes on if kept.
        """
        response = self.plant.response
        m = len(self.command)
        integer = code.integer
        if response is None:
            return self.plant.within(self.command)
        rates = self.v[self.plant.topology.layout.drives]
        compared = code.builder.icmp_signed
        memory = array([code.element("converters", i) for i in range(3 * m)])
        reference, slope, first = memory.reshape(3, m)
        begins = compared("==", code.count, integer(0))
        for past in (reference, first):
            past[:] = [code.chosen(begins, *pair) for pair in zip(rates, past, strict=True)]
        heard = sent = response.heard(self.command)
        row = code.builder.srem(code.count, integer(max(delay, 1)))
        places = [code.plus(code.product(row, m), 3 * m + i) for i in range(m)]
        if delay:
            early = compared("<", code.count, integer(delay))
            waiting = [code.element("converters", place) for place in places]
            sent = [code.chosen(early, *pair) for pair in zip(first, waiting, strict=True)]
        after, slopes = response.ramped(sent, reference, slope, rates, dt)
        if keep:
            values = [*after, *slopes, *first, *heard]
            for place, value in zip([*range(3 * m), *places], values, strict=True):
                code.put("converters", place, value)
        return array(after)


def _plant(code: BlockCode, crane: Crane, drive: str, names: SimpleNamespace) -> Plant:
    """Return the crane with its parameters in place of their numbers."""
    usual = numbers(crane)
    values: list[Any] = usual.tolist()
    model = crane.model.copy()
    joint = crane.payload.body + 1
    load = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(load.mass + 1.0, load.lever, load.inertia)
    heavier = numbers(replace(crane, model=model))
    for i in np.flatnonzero(heavier != usual).tolist():
        slope = float(heavier[i] - usual[i])
        values[i] = code.get("payload_mass") * slope + float(usual[i] - slope * crane.payload_mass)
    damping = replace(crane, damping=crane.damping + 1.0)
    (places,) = np.nonzero(numbers(damping) != usual)
    for i, name in zip(places.tolist(), names.dampings, strict=True):
        values[i] = code.get(name)
    values += code.get_all(names.converters).tolist()
    return plant(Topology.of(crane), values, drive, buffers=False)
