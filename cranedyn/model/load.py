"""Loading a crane: from a URDF, a xacro file or a record to a checked `Crane`."""

from __future__ import annotations

import contextlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from cranedyn.model.added_swing import Swing, hang_load, swing_numbers, turn_tower
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
from cranedyn.model.layout import Joint, Layout
from cranedyn.model.locked import Locked, lock_joints
from cranedyn.model.machines import read_machine
from cranedyn.model.mimics import Coupling, coupling_of, limit_leaders, read_mimics
from cranedyn.model.mjcf import read_mjcf
from cranedyn.model.pendulum import pendulum_note
from cranedyn.model.sdf import read_sdf
from cranedyn.model.springs import check_stretch, read_springs
from cranedyn.model.urdf import (
    check_urdf,
    initial_values,
    parse_urdf,
    skeleton,
    without_visuals,
)

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

_MIN_EIGENVALUE = 1e-10
"""Smallest eigenvalue of the scaled mass matrix, so that its inverse keeps some digits of a double.
"""

_MAX_ACCELERATION_ERROR = 1e-3
"""Largest relative deviation of the articulated-body algorithm from the mass matrix."""

_MIN_PAYLOAD_MASS = 1e-15
"""Smallest payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if
they weighed that."""


class _Options(NamedTuple):
    """What `load_crane` was told beside the URDF.

    Attributes:
        gravity: Gravity [m/s²] along -Z; None for that of the file, or standard gravity.
        joints: Names of joints by role; None for the default names.
        driven: Names of the driven joints; None for those that the file declares.
        payload: Name of the joint that carries the payload; None for the only one at an end.
        check_axes: Whether the joints must have kind and axis of their roles.
        assumptions: What was assumed, a sentence each.
    """

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
            run, which contains the whole crane; `packages` and `check_axes` have no effect then.
            The visuals of this project's crane are made again; those of other cranes, and of a
            crane with locked joints, are not kept.
        gravity: Gravity [m/s²] along -Z; None for that of the file, or standard gravity where it
            states none, as in a URDF.
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
            `cranedyn.model.added_swing.Swing`. `Crane.assumptions` lists what was assumed.
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
        _refuse_beside_record(
            {
                "urdf": urdf,
                "machine": machine,
                "joints": joints,
                "driven": driven,
                "payload": payload,
                "swing": swing if _is_wanted(swing) else None,
                "locked": locked or None,
                "gravity": gravity,
                **values,
            }
        )
        if isinstance(from_record, Mapping):
            return _crane_from_record(from_record, Path("the record"))
        return _crane_from_record(read_record(from_record), Path(from_record))
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
    stays_as_described = path == XACRO and not (locked or _is_wanted(swing))
    if path.suffix == ".xacro":
        # The visuals of this project's own crane take time. As long as the crane stays as it is
        # described, they are made when somebody asks for them.
        text = describe(path, values, visuals=not stays_as_described, packages=packages)
    else:
        text = _text_without_arguments(path, values)
    if not stays_as_described:
        return _foreign_crane(text, path, options, swing, locked)
    robot = parse_urdf(text, path)
    model = _checked_model(robot, path)
    record = _recorded_arguments(values)
    return _crane(robot, model, path, partial(_own_urdf, values), options, record)


def with_locked_joints(crane: Crane, locked: Mapping[str, float]) -> Crane:
    """Return the crane of the same URDF, without its visuals, with some of its joints held fixed.

    The joint that carries the payload may be one of them: then the joint above carries it.

    Args:
        crane: The crane.
        locked: Coordinates [rad or m] of the joints by their names.

    Raises:
        UnknownName: If there is no such moving joint.
        OutOfRange: If a coordinate is out of the range of its joint.
        ModelError: If the rest is no crane.
    """
    names = [joint.name for joint in crane.layout.joints]
    # Joint 0 of Pinocchio is the world, and coordinate i belongs to joint i + 1.
    carrier = crane.payload.body + 1
    while carrier > 0 and names[carrier - 1] in locked:
        carrier = int(crane.model.parents[carrier])
    roles = crane.record["joints"]
    options = _Options(
        gravity=crane.gravity,
        joints={role: name for role, name in roles.items() if name not in locked},
        driven=[name for name in crane.record["driven"] if name not in locked],
        payload=names[carrier - 1] if carrier > 0 else None,
        check_axes=crane.record["check_axes"],
    )
    return _foreign_crane(crane.record["urdf"], Path("the crane"), options, False, locked)


def _is_wanted(swing: bool | Mapping[str, float]) -> bool:
    """Return whether a swing is to be added; a mapping without numbers stands for the defaults."""
    return bool(swing) or isinstance(swing, Mapping)


def _recorded_arguments(values: Mapping[str, object]) -> dict[str, Any]:
    """Return the entry of a record that lists the arguments of this project's crane, from which its
    visuals are made again; no entry if a value is no number.
    """
    arguments: dict[str, float | str] = {}
    for name, value in values.items():
        try:
            argument = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            return {}
        arguments[name] = argument if math.isfinite(argument) else str(argument)  # JSON has no inf
    return {"arguments": arguments}


def _refuse_beside_record(values: Mapping[str, object]) -> None:
    """Check that nothing that would change its crane is given beside a record.

    Raises:
        OutOfRange: If something is.
    """
    for name, value in values.items():
        if value is not None:
            allowed = "left out: the record describes the whole crane"
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
    """Return the crane of a URDF, MJCF or SDF whose joints may be locked, whose limits may be
    missing, and whose hook may have to be hung on a rope.
    """
    robot = parse_urdf(text, path)
    tag_in_file = robot.tag
    notes: list[str] = []
    if tag_in_file in _FOREIGN_FORMATS:
        foreign = _FOREIGN_FORMATS[tag_in_file](robot, path)
        robot = foreign.robot
        notes = foreign.notes
        options = options.in_gravity(foreign.gravity, path)
    check_urdf(robot, path)
    notes += lock_joints(robot, locked, path)
    notes += complete_limits(robot, options.driven)
    if notes:
        # A joint was locked, or a limit added. What the user gives, such as the coordinate of a
        # locked joint, can spoil a correct URDF.
        check_urdf(robot, path)
    model = _built_model(robot, path)
    if robot.tag == tag_in_file and not (notes or _is_wanted(swing)):
        # The file is a URDF and stays as it is.
        return _crane(robot, model, path, partial(str, text), options)
    if _is_wanted(swing):
        hanging = _hang_on_rope(robot, model, path, options, swing_numbers(swing))
        model = hanging.model
        notes += hanging.notes
        options = options._replace(
            joints=options.joints or hanging.roles,
            driven=hanging.driven,
            payload=options.payload or hanging.roles["hoist"],
        )
    options = options._replace(assumptions=(*options.assumptions, *notes))
    ET.indent(robot)
    completed_text = ET.tostring(robot, encoding="unicode")
    return _crane(robot, model, path, partial(str, completed_text), options)


@dataclass(frozen=True, eq=False)
class _HangingModel:
    """Result of `_hang_on_rope`.

    Attributes:
        model: The Pinocchio model with the rope.
        driven: Names of the driven joints; None for those that the URDF declares.
        roles: Names of joints by role.
        notes: A sentence on everything that was assumed.
    """

    model: pin.Model
    driven: Sequence[str] | None
    roles: dict[str, str]
    notes: list[str]


def _hang_on_rope(
    robot: ET.Element, model: pin.Model, path: Path, options: _Options, swing: Swing
) -> _HangingModel:
    """Hang the rigid hook of a checked URDF on a rope, in place.

    A model is built for each mechanism that the URDF becomes on its way: where the slew and the
    trolley have been turned, since the place of the pivot follows from their new zero, and with the
    rope.

    Args:
        robot: The URDF.
        model: Its Pinocchio model.
        path: File for error messages.
        options: Options of `load_crane`.
        swing: Rope and load.
    """
    driven = options.driven
    notes = []
    if driven is None and not has_drives(robot):
        names = joint_names(model)
        mimics = read_mimics(robot, names)
        driven = [name for name in names if name not in mimics]
        notes.append("All joints of the file are driven.")
    joints = _joints_without_roles(robot, model, driven, path)
    if robot.find("ros2_control/joint/command_interface") is None:
        declare_drives(robot, [joint.name for joint in joints if joint.driven])
    roles, turn_notes = turn_tower(robot, model, joints, path)
    notes += turn_notes
    if roles:
        model = _checked_model(robot, path)
        joints = _joints_without_roles(robot, model, driven, path)
    rope_roles, rope_notes = hang_load(robot, model, joints, swing, path)
    notes += rope_notes
    return _HangingModel(_checked_model(robot, path), driven, roles | rope_roles, notes)


def _joints_without_roles(
    robot: ET.Element, model: pin.Model, driven: Sequence[str] | None, path: Path
) -> tuple[Joint, ...]:
    """Return the joints of a model, driven or passive, in no roles."""
    names = joint_names(model)
    mimics = read_mimics(robot, names)
    drives = driven_joints(robot, names, driven, path, mimics)
    return read_joints(model, drives, {}, path, mimics)


def _checked_model(robot: ET.Element, path: Path) -> pin.Model:
    """Return the Pinocchio model of a URDF, which is checked first."""
    check_urdf(robot, path)
    return _built_model(robot, path)


def _built_model(robot: ET.Element, path: Path) -> pin.Model:
    """Return the Pinocchio model of a checked URDF, in which each joint has one coordinate."""
    try:
        model = pin.buildModelFromXML(skeleton(robot))
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"{path} is not a URDF that can be loaded: {printable(str(error).strip().rstrip('.'))}."
        ) from error
    check_joints(model, path)
    return model


def _crane(
    robot: ET.Element,
    model: pin.Model,
    path: Path,
    urdf_source: Callable[[], str],
    options: _Options,
    record: Mapping[str, Any] | None = None,
) -> Crane:
    """Return the crane of a checked URDF.

    The order of the steps matters:

    1. payload, followers and drives, from which the joints and their roles follow;
    2. springs, which need the roles, and the points on which forces act, which need the springs;
    3. the ranges, checked, then narrowed to those in which followers stay in theirs;
    4. the coordinates q at the start, which need these ranges;
    5. dry friction, whose width depends on the inertias at q: the crane does not hang yet;
    6. the crane, and last its passive joints at rest, which needs the crane.

    Args:
        robot: The URDF.
        model: Its Pinocchio model, which is completed in place.
        path: File for error messages.
        urdf_source: Function that returns the URDF as text, with its visuals.
        options: Options of `load_crane`.
        record: Entries of the record of the crane besides those that follow from these; None for
            none.

    Raises:
        ModelError: As `load_crane`.
        OutOfRange: As `load_crane`.
        UnknownName: As `load_crane`.
    """
    names = joint_names(model)
    gravity = STANDARD_GRAVITY if options.gravity is None else options.gravity
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    model.armature = read_armature(robot, names)

    payload = payload_index(model, options.payload, path)
    mimics = read_mimics(robot, names)
    coupling = coupling_of(mimics, names)
    driven = driven_joints(robot, names, options.driven, path, mimics)
    joints = read_joints(model, driven, options.joints, path, mimics)
    if options.check_axes:
        check_roles(joints, path)

    springs = read_springs(robot, Layout(joints, points=()), path)
    points = force_points(model, joints, payload, springs.elastic)
    layout = Layout(joints, tuple(point.name for point in points))
    if coupling is not None and springs.rope is not None and springs.rope.inextensible:
        raise ModelError(
            f"{path} has joints that mimic others, as those of a rope with mass do, and a rope "
            "that may go slack but does not stretch; allowed is one of both. Give the rope a "
            "stiffness, or make it rigid."
        )

    _check_payload_mass(model, joints, payload, path)
    _check_ranges(model, layout, payload, path)
    lower = model.lowerPositionLimit.copy()
    upper = model.upperPositionLimit.copy()
    notes = [] if coupling is None else limit_leaders(coupling, lower, upper, names)
    model.lowerPositionLimit = lower
    model.upperPositionLimit = upper
    if len(layout.passive) == 0:
        notes.append(
            "Nothing swings: no joint is passive. If the hook hangs on a rigid joint, swing=True, "
            "or --swing, puts a rope above it."
        )

    q = _start(robot, layout, model)
    if coupling is not None:
        q = coupling.complete(q)
    _check_solvable(model, q, layout, path, coupling)

    friction_efforts = read_friction(robot, layout)
    check_stretch(springs, model.damping, friction_efforts, layout, path)
    drives = layout.drives.tolist()
    friction = smooth_friction(friction_efforts, model, lower, upper, drives, q, coupling)

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
            "urdf": without_visuals(robot),
            "gravity": gravity,
            "joints": {joint.role: joint.name for joint in joints if joint.role},
            "driven": [joint.name for joint in layout.driven],
            "payload": joints[payload].name,
            "check_axes": options.check_axes,
            **(record or {}),
        },
        assumptions=(*options.assumptions, *notes, *friction_notes(friction, layout)),
    )
    return _hanging_at_start(crane)


def _hanging_at_start(crane: Crane) -> Crane:
    """Return a crane whose passive joints hang at rest at the start.

    A mechanism without springs that does not hang, such as a robot with free joints, stays as it
    is.

    Raises:
        ModelError: If a crane with springs has no rest near its start.
    """
    if crane.rest.hangs:
        hanging = crane.rest.q
    elif crane.springs.any:
        # `hanging` raises with the reason where there is no rest. It returns an unstable rest,
        # which may be a start, too.
        hanging = crane.hanging(crane.start.q)
    else:
        return crane
    start = State(hanging, np.zeros(crane.layout.n))
    assumptions = (*crane.assumptions, *pendulum_note(crane))
    return replace(crane, start=start, assumptions=assumptions)


def _crane_from_record(record: Mapping[str, Any], path: Path) -> Crane:
    """Return the crane of the record of a run.

    Raises:
        DataError: If the record does not describe a crane.
    """
    content = record.get("crane")
    if not (isinstance(content, dict) and _describes_crane(content)):
        raise DataError(
            f"{path} does not name its crane; a Parquet file that `Trajectory.write` wrote does."
        )
    options = _Options(
        gravity=number("gravity", content["gravity"], "m/s²", "> 0"),
        joints={role: str(name) for role, name in content["joints"].items()},
        driven=[str(name) for name in content["driven"]],
        payload=content["payload"],
        check_axes=content["check_axes"],
    )
    robot = parse_urdf(content["urdf"], path)
    model = _checked_model(robot, path)
    arguments = {"arguments": content["arguments"]} if "arguments" in content else None
    return _crane(robot, model, path, partial(_recorded_urdf, content), options, arguments)


def _describes_crane(content: Mapping[str, Any]) -> bool:
    """Return whether the record of a crane has all its entries, and these their types."""
    for name, kind in _RECORD_TYPES.items():
        if not isinstance(content.get(name), kind):
            return False
    arguments = content.get("arguments", {})
    if not isinstance(arguments, dict):
        return False
    return all(isinstance(value, float | int) or value == "inf" for value in arguments.values())


def _recorded_urdf(record: Mapping[str, Any]) -> str:
    """Return the URDF of a recorded crane: with visuals for the crane of this project, else
    without.

    The arguments may be those of another version, or wrong; then the visuals are left out.
    """
    text = str(record["urdf"])
    arguments = record.get("arguments")
    if arguments is not None:
        with contextlib.suppress(CraneError):
            own_urdf = _own_urdf(arguments)
            if without_visuals(parse_urdf(own_urdf, XACRO)) == text:
                return own_urdf
    return text


def _own_urdf(arguments: Mapping[str, object]) -> str:
    """Return the URDF of the crane of this project, with its visuals."""
    text = describe(XACRO, arguments)
    check_urdf(parse_urdf(text, XACRO), XACRO)
    return text


def _start(robot: ET.Element, layout: Layout, model: pin.Model) -> np.ndarray:
    """Return the start of each joint: its initial value in the URDF, else 0 or, where 0 is out of
    range, the middle of the range.
    """
    initial = {name: value.text or "" for name, value in initial_values(robot).items()}
    q = np.zeros(layout.n)
    for i, joint in enumerate(layout.joints):
        low = float(model.lowerPositionLimit[i])
        high = float(model.upperPositionLimit[i])
        if joint.name in initial:
            name = f"{joint.name} at the start"
            q[i] = within(name, initial[joint.name], low, high, joint.unit)
        elif not low <= 0.0 <= high:
            q[i] = (low + high) / 2
    return q


def _check_payload_mass(
    model: pin.Model, joints: Sequence[Joint], payload: int, path: Path
) -> None:
    """Check that the joint that is to carry the payload carries a mass.

    Raises:
        ModelError: If it does not.
    """
    if not model.inertias[payload + 1].mass > 0.0:
        raise ModelError(
            f"The joint {quoted(joints[payload].name)} in {path} carries the payload, and nothing "
            "below it has a mass; give its link an <inertial> with mass and inertia, or name "
            "another joint by payload=, or --payload."
        )


def _check_ranges(model: pin.Model, layout: Layout, payload: int, path: Path) -> None:
    """Check that joint ranges, effort limits, damping and payload mass are those of a crane.

    Args:
        model: The Pinocchio model.
        layout: Its joints.
        payload: Index of the joint that carries the payload.
        path: File for error messages.

    Raises:
        OutOfRange: If a number is none of a crane. The error names the file, but for the crane of
            this project, where the number is an argument.
    """
    try:
        for i in range(layout.n):
            _check_range(model, layout, i)
        mass = model.inertias[payload + 1].mass
        number("payload mass", mass, "kg", f"{_MIN_PAYLOAD_MASS:g} to 1e30")
    except OutOfRange as error:
        if path == XACRO:
            raise
        name = f"{error.name} in {path}"
        raise OutOfRange(name, error.value, error.allowed, error.unit) from None


def _check_range(model: pin.Model, layout: Layout, index: int) -> None:
    """Check range, effort limit and damping of a joint."""
    joint = layout.joints[index]
    low = float(model.lowerPositionLimit[index])
    high = float(model.upperPositionLimit[index])
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        name = f"range of {joint.name}"
        ends = f"{low:g} to {high:g}"
        raise OutOfRange(name, ends, "finite, lower below upper", joint.unit)
    if joint.driven:
        effort = float(model.effortLimit[index])
        number(f"effort limit of {joint.name}", effort, joint.effort_unit, "> 0")
    unit = "N m s/rad" if joint.kind == "revolute" else "N s/m"
    number(f"damping of {joint.name}", model.damping[index], unit, ">= 0")
    if joint.role == "hoist":
        number("shortest cable", low, "m", "> 0")


def _check_solvable(
    model: pin.Model, q: np.ndarray, layout: Layout, path: Path, coupling: Coupling | None
) -> None:
    """Check that accelerations can be computed at coordinates q.

    The mass matrix, scaled to a unit diagonal, must be far enough from singular. The articulated-
    body algorithm, whose intermediate numbers differ from those of the mass matrix, must give the
    same accelerations under the largest efforts of the drives; a difference shows lost digits.
    Where joints follow others it is the mass matrix of the others that must not be singular, and
    no engine uses that algorithm.

    Raises:
        ModelError: If a joint moves no mass, or accelerations lose their digits.
        OutOfRange: If the mass matrix is almost singular.
    """
    data = model.createData()
    mass = pin.crba(model, data, q)
    if coupling is not None:
        mass = coupling.reduce(mass)
    diagonal = np.diag(mass)
    energy = pin.computePotentialEnergy(model, data, q)
    if not (np.isfinite(mass).all() and math.isfinite(energy) and (diagonal > 0.0).all()):
        massless = [joint.name for i, joint in enumerate(layout.joints) if not diagonal[i] > 0.0]
        reason = "masses, lengths or gravity are beyond what a number holds"
        if massless:
            reason = f"{', '.join(map(quoted, massless))} moves no mass; give its links a mass"
        raise ModelError(f"{path} cannot be simulated: {reason}.")

    # With D = diag(M), the matrix D^-½ M D^-½ has a unit diagonal. Its eigenvalues do not depend on
    # the units of the coordinates, rad or m.
    scale = np.sqrt(diagonal)
    scaled = mass / scale / scale[:, None]
    smallest = float(np.linalg.eigvalsh(scaled)[0])
    if not smallest > _MIN_EIGENVALUE:
        allowed = (
            f"> {_MIN_EIGENVALUE:g}: its masses and inertias differ too much; give its lightest "
            "links more"
        )
        owner = "this crane" if path == XACRO else str(path)
        name = f"smallest eigenvalue of the scaled mass matrix of {owner}"
        raise OutOfRange(name, f"{smallest:.1e}", allowed)

    if coupling is not None:
        return

    # M a = τ - b in scaled numbers: D^½ a = (D^-½ M D^-½)⁻¹ D^-½ (τ - b).
    zeros = np.zeros(layout.n)
    effort = np.zeros(layout.n)
    effort[layout.drives] = model.effortLimit[layout.drives]
    bias = pin.rnea(model, data, q, zeros, zeros)
    expected = np.linalg.solve(scaled, (effort - bias) / scale)
    acceleration = pin.aba(model, data, q, zeros, effort, pin.Convention.WORLD) * scale
    error = np.abs(acceleration - expected).max()
    if not error <= _MAX_ACCELERATION_ERROR * np.abs(expected).max():
        raise ModelError(
            f"{path} cannot be simulated: its masses and lengths differ so much that accelerations "
            "lose all their digits; look whether all are in kg, kg m² and m."
        )
