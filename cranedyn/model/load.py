"""Loading a crane: from a URDF, a xacro file or a record to a checked `Crane`."""

from __future__ import annotations

import contextlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
import pinocchio as pin

from cranedyn.checks import number, within
from cranedyn.data.files import read_text
from cranedyn.data.trajectory import read_record
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange, printable, quoted
from cranedyn.interfaces import State
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import XACRO, CraneValues, describe
from cranedyn.model.friction import friction_notes, read_friction, smooth_friction
from cranedyn.model.joints import (
    check_joints,
    check_roles,
    complete_limits,
    declare_drives,
    driven_joints,
    force_points,
    has_drives,
    joint_names,
    payload_index,
    read_armature,
    read_joints,
)
from cranedyn.model.layout import Layout
from cranedyn.model.locked import Locked, lock_joints
from cranedyn.model.machines import read_machine
from cranedyn.model.mimics import coupling_of, limit_leaders, read_mimics
from cranedyn.model.mjcf import read_mjcf
from cranedyn.model.pendulum import pendulum_note
from cranedyn.model.sdf import read_sdf
from cranedyn.model.springs import read_springs
from cranedyn.model.swing import hang_load, swing_numbers, turn_tower
from cranedyn.model.urdf import bare, check_urdf, initial_values, parse_urdf, skeleton

_RECORD_TYPES = {
    "urdf": str,
    "gravity": float,
    "joints": dict,
    "driven": list,
    "payload": str,
    "check_axes": bool,
}
"""Entries of a record of a crane and their types."""

_FOREIGN_FORMATS = {"mujoco": read_mjcf, "sdf": read_sdf}
"""Readers of other formats than URDF by the tag of their root."""

_LEAST_EIGENVALUE = 1e-10
"""Least eigenvalue of the scaled mass matrix, so that its inverse keeps some digits of a double."""

_LARGEST_DEVIATION = 1e-3
"""Largest relative deviation of the articulated-body algorithm from the mass matrix."""

_LIGHTEST = 1e-15
"""Least payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if they
weighed that."""


class _Options(NamedTuple):
    """Options of `load_crane` that a URDF does not contain."""

    gravity: float | None = None
    joints: Mapping[str, str] | None = None
    driven: Sequence[str] | None = None
    payload: str | None = None
    check_axes: bool = True
    assumptions: tuple[str, ...] = ()

    def in_gravity(self, of_file: float | None, path: Path) -> _Options:
        """Return the options with the gravity of a file [m/s²] where none was given.

        Raises:
            OutOfRange: If that is not positive.
        """
        if self.gravity is not None or of_file is None:
            return self
        allowed = "> 0; give another by gravity=, or --gravity"
        if not of_file > 0.0:
            raise OutOfRange(f"gravity along -Z of {path}", of_file, allowed, "m/s²")
        return self._replace(gravity=of_file)


def load_crane(
    urdf: str | Path | None = None,
    *,
    machine: str | None = None,
    from_record: str | Path | Mapping[str, Any] | None = None,
    gravity: float | None = None,
    joints: Mapping[str, str] | None = None,
    driven: Sequence[str] | None = None,
    payload: str | None = None,
    check_axes: bool = True,
    swing: bool | Mapping[str, float] = False,
    locked: Locked = (),
    packages: Mapping[str, str | Path] | None = None,
    values: Mapping[str, object] | None = None,
    **numbers: Unpack[CraneValues],
) -> Crane:
    """Load a crane: a chain or tree of revolute and prismatic joints.

    Args:
        urdf: A ``.xacro`` file, which is expanded and may run any Python expression: load only
            files whose programs you would run, too. Any other file is plain URDF, MJCF or SDF:
            nothing in it is run or fetched, and no file outside of its folder is read. None is the
            tower crane of this project.
        machine: Name of a machine of the library, see `cranedyn.model.machines`; values change
            those of the machine.
        from_record: A Parquet file of a run, an identified twin (``.json``), or the `record` of a
            run, which contains the whole crane. The looks of this project's crane are made again,
            the looks of other cranes are not kept.
        gravity: Gravity [m/s²] along -Z; None for that of the file, or standard gravity where it
            says none, as a URDF.
        joints: Names of joints by role, for example ``{"slew": "base_yaw"}``; None for the names in
            the tower crane of this project. See `cranedyn.model.layout.ROLES`.
        driven: Names of the driven joints, for a URDF that gives no joint a drive by
            ``<ros2_control>`` or ``<transmission>``. All others are passive.
        payload: Name of the joint that carries the payload; needed where more than one joint
            carries no other.
        check_axes: Whether the joints must have kind and axis of their roles. False is for showing
            the effect of a wrong axis.
        swing: True for a URDF whose hook is rigid: two passive joints and a rope are put above its
            hoist, and slew and trolley are turned into those of a tower crane. Rope and load may be
            given, for example ``{"length": 2.0, "mass": 5.0, "damping": 0.01}``, see
            `cranedyn.model.swing.Swing`. `Crane.assumptions` lists what was assumed.
        locked: Joints that are held fixed, such as outriggers: their names, or their coordinates
            [rad or m] by name; a joint without a coordinate is held where it starts. Joints that
            mimic them are held, too.
        packages: Folders of ROS packages by name, for ``$(find NAME)`` in a xacro file; others are
            looked for, see `cranedyn.model.description.package_folder`.
        values: Arguments of a xacro file by name, for files other than the tower crane of this
            project.
        numbers: Arguments of the tower crane of this project, for example ``payload_mass=2000``.

    Raises:
        ModelError: If it is no valid URDF or not a crane: no joint is driven, the payload is
            ambiguous, a joint has several degrees of freedom, or does not fit its role.
        OutOfRange: If a number is not one that a crane can have.
        UnknownName: If the xacro file has no such argument, or there is no such joint or role.
        DataError: If the file cannot be read, or values are given for one without arguments.
    """
    for name in (values or {}).keys() & numbers.keys():
        raise OutOfRange(name, "given twice", "given once, in values or by its name")
    values = {**(values or {}), **numbers}
    if from_record is not None:
        excluded = {
            "urdf": urdf, "machine": machine, "joints": joints, "driven": driven,
            "payload": payload, "swing": swing or None, "locked": locked or None,
        }  # fmt: skip
        _refuse_beside_record({**excluded, "gravity": gravity, **values})
        if isinstance(from_record, Mapping):
            return _from_record(from_record, Path("the record"))
        return _from_record(read_record(from_record), Path(from_record))
    if gravity is not None:
        gravity = number("gravity", gravity, "m/s²", "> 0")
    options = _Options(gravity, joints, driven, payload, check_axes)
    if machine is not None:
        if urdf is not None:
            raise OutOfRange("machine", f"{machine!r} beside urdf", "one of both")
        specification = read_machine(machine)
        urdf = specification.urdf
        values = {**specification.values, **values}
        options = options._replace(assumptions=specification.assumptions)
    path = XACRO if urdf is None else Path(urdf)
    if path.suffix == ".xacro":
        text = describe(path, values, visuals=urdf is not None, packages=packages)
    else:
        text = _text_without_arguments(path, values)
    if urdf is not None or swing or locked:
        return _foreign_crane(text, path, options, swing, locked)
    record: dict[str, Any] = {}
    with contextlib.suppress(TypeError, ValueError):  # a value that is text is not recorded
        floats = {name: float(value) for name, value in values.items()}  # type: ignore[arg-type]
        # JSON has no infinity
        record["arguments"] = {n: x if math.isfinite(x) else str(x) for n, x in floats.items()}
    return _crane(parse_urdf(text, path), path, partial(_own_urdf, values), options, record)


def _refuse_beside_record(values: Mapping[str, object]) -> None:
    """Check that nothing is given beside a record, which says all of its crane.

    Raises:
        OutOfRange: If something is.
    """
    for name, value in values.items():
        if value is not None:
            allowed = "left out: the record says all of the crane"
            raise OutOfRange(name, "given beside from_record", allowed)


def _text_without_arguments(path: Path, values: Mapping[str, object]) -> str:
    """Return the text of a file that is no xacro file.

    Raises:
        DataError: If it cannot be read, or values are given, for which it has no arguments.
    """
    text = read_text(path)  # first, so that a file that is missing is named as missing
    if values:
        raise DataError(
            f"{path} is not a .xacro file and has no arguments, so that "
            f"{', '.join(map(str, values))} cannot be set in it; change the number in the file "
            "itself, or give a .xacro file that declares it."
        )
    return text


def _foreign_crane(
    text: str,
    path: Path,
    options: _Options,
    swing: bool | Mapping[str, float],
    locked: Locked,
) -> Crane:
    """Return the crane of a foreign URDF, MJCF or SDF, completed."""
    robot = parse_urdf(text, path)
    notes = list[str]()
    if robot.tag in _FOREIGN_FORMATS:
        foreign = _FOREIGN_FORMATS[robot.tag](robot, path)
        robot, notes = foreign.robot, foreign.notes
        options = options.in_gravity(foreign.gravity, path)
    check_urdf(robot, path)
    notes += lock_joints(robot, locked, path)
    notes += complete_limits(robot, options.driven)
    if not (swing or notes):
        return _crane(robot, path, partial(str, text), options)
    if swing:
        roles: dict[str, str] = {}
        driven = options.driven
        for complete in (turn_tower, partial(hang_load, swing=swing_numbers(swing))):
            check_urdf(robot, path)
            model = _build(skeleton(robot), path)
            check_joints(model, path)
            names = joint_names(model)
            if driven is None and not has_drives(robot):
                driven = names
                notes.append("All joints of the file are driven.")
            mimics = read_mimics(robot, names)
            drives = driven_joints(robot, names, driven, path, mimics)
            joints = read_joints(model, drives, {}, path, mimics)
            if robot.find("ros2_control/joint/command_interface") is None:
                declare_drives(robot, [name for name in names if name in drives])
            further_roles, further_notes = complete(robot, model, joints, path=path)
            roles |= further_roles
            notes += further_notes
        options = options._replace(driven=driven, joints=options.joints or roles)
    options = options._replace(assumptions=(*options.assumptions, *notes))
    ET.indent(robot)
    return _crane(robot, path, partial(str, ET.tostring(robot, encoding="unicode")), options)


def _crane(
    robot: ET.Element,
    path: Path,
    urdf_source: Callable[[], str],
    options: _Options,
    record: Mapping[str, Any] | None = None,
) -> Crane:
    """Return the crane of a URDF; `record` adds to what is recorded of it."""
    check_urdf(robot, path)
    model = _build(skeleton(robot), path)
    check_joints(model, path)
    names = joint_names(model)
    gravity = STANDARD_GRAVITY if options.gravity is None else options.gravity
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    model.armature = read_armature(robot, names)
    load = payload_index(model, options.payload, path)
    mimics = read_mimics(robot, names)
    coupling = coupling_of(mimics, names)
    driven = driven_joints(robot, names, options.driven, path, mimics)
    joints = read_joints(model, driven, options.joints, path, mimics)
    if options.check_axes:
        check_roles(joints, path)
    points = force_points(model, joints, load)
    layout = Layout(joints, tuple(point.name for point in points))
    springs = read_springs(robot, layout, path)
    if coupling is not None and (springs.rope is not None or springs.bifilar is not None):
        raise ModelError(
            f"{path} has joints that mimic others, and a rope that stretches or two falls; allowed "
            "is one of both."
        )
    if not model.inertias[load + 1].mass > 0.0:
        raise ModelError(
            f"The joint {quoted(joints[load].name)} in {path} carries the payload, and nothing "
            "below it has a mass; give its link an <inertial> with mass and inertia, or name "
            "another joint by payload=, or --payload."
        )
    try:
        _check_ranges(model, layout, load)
    except OutOfRange as error:
        if path == XACRO:
            raise  # whose numbers are arguments, named as such
        name = f"{error.name} in {path}"
        raise OutOfRange(name, error.value, error.allowed, error.unit) from None
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    notes = [] if coupling is None else limit_leaders(coupling, lower, upper, names)
    if not len(layout.passive):
        notes.append(
            "Nothing swings: no joint is passive. If the hook hangs on a rigid joint, swing=True, "
            "or --swing, puts a rope above it."
        )
    model.lowerPositionLimit = lower
    model.upperPositionLimit = upper
    q = _start(robot, layout, model)
    if coupling is not None:
        q = coupling.complete(q)
    _check_solvable(model, q, layout, path)
    dry = read_friction(robot, layout)
    drives = layout.drives.tolist()
    friction = smooth_friction(dry, model, lower, upper, drives, q, coupling)
    crane = Crane(
        layout=layout,
        urdf_source=urdf_source,
        model=model,
        damping=model.damping.copy(),
        springs=springs,
        friction=friction,
        coupling=coupling,
        lower=lower,
        upper=upper,
        effort_limit=model.effortLimit[layout.drives].copy(),
        start=State(q, np.zeros(layout.n)),
        points=points,
        record={
            "urdf": bare(robot),
            "gravity": gravity,
            "joints": {joint.role: joint.name for joint in joints if joint.role},
            "driven": [joint.name for joint in layout.driven],
            "payload": joints[load].name,
            "check_axes": options.check_axes,
            **(record or {}),
        },
        assumptions=(*options.assumptions, *notes, *friction_notes(friction, layout)),
    )
    if not (springs.any or crane.rest.hangs):
        return crane
    hanging = crane.rest.q if crane.rest.hangs else crane.hanging(q)
    assumptions = (*crane.assumptions, *pendulum_note(crane))
    return replace(crane, start=State(hanging, np.zeros(layout.n)), assumptions=assumptions)


def _from_record(record: Mapping[str, Any], path: Path) -> Crane:
    """Return the crane of the record of a run."""
    content = record.get("crane")
    arguments = content.get("arguments", {}) if isinstance(content, dict) else None
    if (
        not isinstance(content, dict)
        or not all(isinstance(content.get(name), kind) for name, kind in _RECORD_TYPES.items())
        or not isinstance(arguments, dict)
        or not all(isinstance(x, float | int) or x == "inf" for x in arguments.values())
    ):
        raise DataError(
            f"{path} does not name its crane; a Parquet file that `Trajectory.write` wrote does."
        )
    options = _Options(
        number("gravity", content["gravity"], "m/s²", "> 0"),
        {role: str(name) for role, name in content["joints"].items()},
        [str(name) for name in content["driven"]],
        content["payload"],
        content["check_axes"],
    )
    return _crane(
        parse_urdf(content["urdf"], path), path, partial(_recorded_urdf, content), options, content
    )


def _recorded_urdf(record: Mapping[str, Any]) -> str:
    """Return the URDF of a recorded crane: with looks for the crane of this project, else without.

    The arguments may be those of another version, or wrong; then the looks are left out.
    """
    text = str(record["urdf"])
    arguments = record.get("arguments")
    if arguments is not None:
        with contextlib.suppress(CraneError):
            own_urdf = _own_urdf(arguments)
            if bare(parse_urdf(own_urdf, XACRO)) == text:
                return own_urdf
    return text


def _own_urdf(arguments: Mapping[str, object]) -> str:
    """Return the URDF of the crane of this project, with its looks."""
    text = describe(XACRO, arguments)
    check_urdf(parse_urdf(text, XACRO), XACRO)
    return text


def _build(skeleton: str, path: Path) -> pin.Model:
    try:
        return pin.buildModelFromXML(skeleton)
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"{path} is not a URDF that can be loaded: {printable(str(error).strip().rstrip('.'))}."
        ) from error


def _start(robot: ET.Element, layout: Layout, model: pin.Model) -> np.ndarray:
    """Return the start of each joint: its initial value in the URDF, else 0 or, where 0 is out of
    range, the middle of the range.
    """
    initial = {name: value.text or "" for name, value in initial_values(robot).items()}
    q = np.zeros(layout.n)
    for i, joint in enumerate(layout.joints):
        low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        if joint.name in initial:
            name = f"{joint.name} at the start"
            q[i] = within(name, initial[joint.name], low, high, joint.unit)
        elif not low <= 0.0 <= high:
            q[i] = (low + high) / 2
    return q


def _check_ranges(model: pin.Model, layout: Layout, payload: int) -> None:
    """Check that joint ranges, effort limits, damping and payload mass are those of a crane."""
    for i, joint in enumerate(layout.joints):
        low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            name = f"range of {joint.name}"
            ends = f"{low:g} to {high:g}"
            raise OutOfRange(name, ends, "finite, lower below upper", joint.unit)
        if joint.driven:
            effort = float(model.effortLimit[i])
            number(f"effort limit of {joint.name}", effort, joint.effort_unit, "> 0")
        unit = "N m s/rad" if joint.kind == "revolute" else "N s/m"
        number(f"damping of {joint.name}", model.damping[i], unit, ">= 0")
        if joint.role == "hoist":
            number("shortest cable", low, "m", "> 0")
    number("payload mass", model.inertias[payload + 1].mass, "kg", f"{_LIGHTEST:g} to 1e30")


def _check_solvable(model: pin.Model, q: np.ndarray, layout: Layout, path: Path) -> None:
    """Check that accelerations can be computed.

    The mass matrix, scaled to a unit diagonal, must be far enough from singular. The articulated-
    body algorithm, which computes with other numbers, must accelerate the crane under all its
    efforts as that matrix does.
    """
    data = model.createData()
    zeros = np.zeros(layout.n)
    mass = pin.crba(model, data, q)
    diagonal = np.diag(mass)
    energy = pin.computePotentialEnergy(model, data, q)
    if not (np.isfinite(mass).all() and math.isfinite(energy) and (diagonal > 0.0).all()):
        still = [layout.joints[i].name for i in np.flatnonzero(~(diagonal > 0.0)).tolist()]
        reason = "masses, lengths or gravity are beyond what a number holds"
        if still:
            reason = f"{', '.join(map(quoted, still))} moves no mass; give its links a mass"
        raise ModelError(f"{path} cannot be simulated: {reason}.")
    scale = np.sqrt(diagonal)
    scaled = mass / scale / scale[:, None]
    smallest = float(np.linalg.eigvalsh(scaled)[0])
    if not smallest > _LEAST_EIGENVALUE:
        allowed = (
            f"> {_LEAST_EIGENVALUE:g}: its masses and inertias differ too much; give its lightest "
            "links more"
        )
        owner = "this crane" if path == XACRO else str(path)
        name = f"smallest eigenvalue of the scaled mass matrix of {owner}"
        raise OutOfRange(name, f"{smallest:.1e}", allowed)
    effort = np.zeros(layout.n)
    effort[layout.drives] = model.effortLimit[layout.drives]
    bias = pin.rnea(model, data, q, zeros, zeros)
    expected = np.linalg.solve(scaled, (effort - bias) / scale)
    acceleration = pin.aba(model, data, q, zeros, effort, pin.Convention.WORLD) * scale
    if not np.abs(acceleration - expected).max() <= _LARGEST_DEVIATION * np.abs(expected).max():
        raise ModelError(
            f"{path} cannot be simulated: its masses and lengths differ so much that accelerations "
            "lose all their digits; look whether all are in kg, kg m² and m."
        )
