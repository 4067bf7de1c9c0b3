"""From a URDF to a crane: expanded, parsed, checked."""

from __future__ import annotations

import contextlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.checks import number, within
from cranedyn.data.files import read_text
from cranedyn.data.trajectory import read_record
from cranedyn.errors import (
    CraneError,
    DataError,
    ModelError,
    OutOfRange,
    UnknownName,
    printable,
    quoted,
)
from cranedyn.interfaces import State
from cranedyn.model.crane import STANDARD_GRAVITY, Crane, Point
from cranedyn.model.description import XACRO, describe
from cranedyn.model.layout import ROLES, Joint, Layout, roles_of, symbol_of
from cranedyn.model.springs import Rope, Springs
from cranedyn.model.urdf import bare, check, parse, skeleton

_SINGULAR, _ASTRAY = 1e-10, 1e-3

_LIGHTEST = 1e-15
"""Least payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if they
weighed that."""


def load_crane(
    urdf: str | Path | None = None,
    *,
    from_record: str | Path | Mapping[str, Any] | None = None,
    gravity: float | None = None,
    joints: Mapping[str, str] | None = None,
    driven: Sequence[str] | None = None,
    payload: str | None = None,
    check_axes: bool = True,
    **values: object,
) -> Crane:
    """Load a crane: a chain or tree of revolute and prismatic joints.

    Args:
        urdf: A ``.xacro`` file to expand, which runs Python expressions in it: only from those
            whose programs you would run, too. Any other file is plain URDF: nothing in it is run,
            fetched or read from elsewhere. None is the tower crane of this project.
        from_record: A Parquet file of a run instead, a twin (``.json``) that was identified, or the
            `record` of a run, in which its crane is written down whole; the looks of this project's
            own crane are made again, those of any other are not kept.
        gravity: Gravity [m/s²] along -Z; None for standard gravity.
        joints: Names of the joints that play the parts of a tower crane, by role, for example
            ``{"slew": "base_yaw"}``; None for those that are called as in the tower crane of this
            project. See `cranedyn.model.layout.ROLES`.
        driven: Names of the joints that drives move, for a URDF that does not say so itself: those
            to which ``<ros2_control>`` gives a command interface. All others are passive.
        payload: Name of the joint that carries the payload; needed where more than one joint
            carries no other.
        check_axes: Whether joints in a role must be of its type and axis. False is for showing what
            a wrong axis does.
        values: Arguments of the xacro file, for example ``payload_mass=2000``.

    Raises:
        ModelError: If it is no valid URDF or not a crane: no joint is driven, it is not clear what
            the payload is, a joint has several degrees of freedom, or one in a role is of another
            type or turned.
        OutOfRange: If a number in it is not one a crane can have.
        UnknownName: If an argument is not declared in the xacro file, or there is no such joint or
            role.
        DataError: If the file cannot be read.
    """
    if from_record is not None:
        others = {
            "urdf": urdf,
            "joints": joints,
            "driven": driven,
            "payload": payload,
            "gravity": gravity,
            **values,
        }
        if given := [name for name, value in others.items() if value is not None]:
            raise OutOfRange(
                given[0], "given beside from_record", "left out: the record says all of the crane"
            )
        return (
            _recorded(from_record, Path("the record"))
            if isinstance(from_record, Mapping)
            else _recorded(read_record(from_record), Path(from_record))
        )
    g = STANDARD_GRAVITY if gravity is None else number("gravity", gravity, "m/s²", "> 0")
    path = XACRO if urdf is None else Path(urdf)
    if path.suffix == ".xacro":
        text = describe(path, values, visuals=urdf is not None)
    elif values:
        raise UnknownName("argument", next(iter(values)), ["none in a plain URDF"])
    else:
        text = read_text(path)
    written = partial(_whole, path, values) if urdf is None else partial(str, text)
    crane = _crane(parse(text, path), path, written, g, joints, driven, payload, check_axes)
    return (
        replace(crane, record={**crane.record, "arguments": numbers})
        if urdf is None and (numbers := _numbers(values)) is not None
        else crane
    )


def _numbers(values: Mapping[str, object]) -> dict[str, float] | None:
    """Arguments of this project's crane as a record keeps them; None if one is text."""
    try:
        return {name: float(value) for name, value in values.items()}  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def _crane(
    robot: ET.Element,
    path: Path,
    written: Callable[[], str],
    gravity: float,
    joints: Mapping[str, str] | None,
    driven: Sequence[str] | None,
    payload: str | None,
    check_axes: bool,
) -> Crane:
    check(robot, path)
    model = _model(skeleton(robot), path)
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    _check_kinds(model, path)
    model.armature = _armature(robot, _names(model))
    load = _payload(model, payload, path)
    layout = _layout(
        model,
        path,
        roles_of(_names(model), joints),
        _driven(robot, _names(model), driven, path),
        load,
    )
    if check_axes:
        _check_axes(layout, path)
    points = _points(model, layout, load)
    springs = _springs(robot, layout, path)
    _check_numbers(model, layout, load)
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    q = _start(robot, layout, lower, upper)
    _check_solvable(model, q, layout, path)
    crane = Crane(
        layout=layout,
        written=written,
        model=model,
        damping=model.damping.copy(),
        springs=springs,
        lower=lower,
        upper=upper,
        effort_limit=model.effortLimit[layout.drives].copy(),
        start=State(q, np.zeros(layout.n)),
        points=points,
        record={
            "urdf": bare(robot),
            "gravity": gravity,
            "joints": {joint.role: joint.name for joint in layout.joints if joint.role},
            "driven": [joint.name for joint in layout.driven],
            "payload": layout.joints[load].name,
            "check_axes": check_axes,
        },
    )
    if springs.any or crane.rest.hangs:
        return replace(crane, start=State(crane.hanging(q), np.zeros(layout.n)))
    return crane


def _recorded(whole: Mapping[str, Any], path: Path) -> Crane:
    """A crane from the record of a run."""
    record = whole.get("crane")
    kinds = {
        "urdf": str,
        "gravity": float,
        "joints": dict,
        "driven": list,
        "payload": str,
        "check_axes": bool,
    }
    values = record.get("arguments", {}) if isinstance(record, dict) else None
    if (
        not isinstance(record, dict)
        or not all(isinstance(record.get(name), kind) for name, kind in kinds.items())
        or not isinstance(values, dict)
        or not all(isinstance(value, float | int) for value in values.values())
    ):
        raise DataError(
            f"{path} does not name its crane; a Parquet file that `Trajectory.write` wrote does."
        )
    robot = parse(record["urdf"], path)
    gravity = number("gravity", record["gravity"], "m/s²", "> 0")
    words = (
        {role: str(name) for role, name in record["joints"].items()},
        [str(name) for name in record["driven"]],
        record["payload"],
    )
    crane = _crane(robot, path, partial(_dressed, record), gravity, *words, record["check_axes"])
    return replace(crane, record=record)


def _dressed(record: Mapping[str, Any]) -> str:
    """A recorded crane with its looks, if it is this project's own; bare as it was written down
    otherwise.
    """
    text, values = str(record["urdf"]), record.get("arguments")
    if values is not None:
        with contextlib.suppress(CraneError):  # arguments of another version, or of a stranger
            whole = _whole(XACRO, values)
            if bare(parse(whole, XACRO)) == text:
                return whole
    return text


def _whole(path: Path, values: dict[str, object]) -> str:
    text = describe(path, values)
    check(parse(text, path), path)
    return text


def _model(skeleton: str, path: Path) -> pin.Model:
    try:
        return pin.buildModelFromXML(skeleton)
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"{path} is not a URDF that can be loaded: {printable(str(error).strip().rstrip('.'))}."
        ) from error


def _names(model: pin.Model) -> list[str]:
    return list(model.names)[1:]


def _check_kinds(model: pin.Model, path: Path) -> None:
    if not _names(model):
        raise ModelError(f"{path} has no joint that moves.")
    for i, name in enumerate(_names(model), start=1):
        if (model.joints[i].nq, model.joints[i].nv) != (1, 1):
            raise ModelError(
                f"{path} has a {quoted(name)} without limits or with several axes; it must be "
                "revolute or prismatic, with limits."
            )


def _armature(robot: ET.Element, names: Sequence[str]) -> np.ndarray:
    """Inertia of each drive's motor and gear as its joint feels it [kg m² or kg], shape (n,); no
    parser of URDF reads it.
    """
    found = np.zeros(len(names))
    for joint in robot.iterfind("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and joint.get("name") in names and dynamics.get("armature"):
            name = joint.get("name", "")
            found[names.index(name)] = number(
                f"armature of {name}", dynamics.get("armature"), "kg m² or kg", ">= 0"
            )
    return found


def _payload(model: pin.Model, name: str | None, path: Path) -> int:
    """The joint that carries the payload, by its place among the coordinates."""
    names = _names(model)
    if name is not None:
        if name not in names:
            raise UnknownName("moving joint", name, names)
        return names.index(name)
    ends = [i for i in range(len(names)) if i + 1 not in list(model.parents)[1:]]
    if len(ends) > 1:
        shown = ", ".join(quoted(names[i]) for i in ends)
        raise ModelError(
            f"{path} is a tree that ends in {shown}; say which joint carries the payload by "
            "load_crane(payload=...)."
        )
    return ends[0]


def _driven(
    robot: ET.Element, names: Sequence[str], given: Sequence[str] | None, path: Path
) -> set[str]:
    """Names of the joints that drives move."""
    own = {
        joint.get("name", "")
        for joint in robot.iterfind("ros2_control/joint")
        if joint.find("command_interface") is not None
    }
    if given is not None and own and own != {*given}:
        raise ModelError(
            f"{path} says by <ros2_control> that drives move "
            f"{', '.join(map(quoted, sorted(own)))}, the argument says {', '.join(given)}; "
            "leave one out."
        )
    for name in sorted(own):
        if name not in names:
            moving = ", ".join(map(quoted, names))
            raise ModelError(
                f"{path} gives {quoted(name)} a command interface in <ros2_control>; the joints "
                f"that move are {moving}."
            )
    for name in given or ():
        if name not in names:
            raise UnknownName("moving joint", name, names)
    found = own if given is None else {*given}
    if not found:
        raise ModelError(
            f"{path} gives no joint a command interface in <ros2_control>; say which joints drives "
            "move by load_crane(driven=[...])."
        )
    return found


def _layout(
    model: pin.Model, path: Path, roles: Mapping[str, str], driven: set[str], load: int
) -> Layout:
    joints = []
    data, n = model.createData(), len(_names(model))
    pin.computeJointJacobians(model, data, np.zeros(n))
    for i, name in enumerate(_names(model)):
        # Pinocchio gives a matrix of one column without its second dimension.
        jacobian = pin.getJointJacobian(model, data, i + 1, pin.LOCAL_WORLD_ALIGNED).reshape(6, n)
        linear, angular = jacobian[:3, i], jacobian[3:, i]
        kind = "prismatic" if np.linalg.norm(angular) < 1e-9 else "revolute"
        axis = linear if kind == "prismatic" else angular
        role = roles.get(name, "")
        unit = "m" if kind == "prismatic" else "rad"
        joints.append(
            Joint(
                name, symbol_of(name, role), unit, kind, tuple(axis.tolist()), name in driven, role
            )
        )
    symbols = [joint.symbol for joint in joints]
    if len(set(symbols)) < n:
        raise ModelError(
            f"{path} has joints of the same symbol among {', '.join(map(quoted, symbols))}; give "
            "them other names."
        )
    return Layout(tuple(joints), _point_names(joints, load))


def _check_axes(layout: Layout, path: Path) -> None:
    for joint in layout.joints:
        if not joint.role:
            continue
        role = ROLES[joint.role]
        if joint.kind != role.kind:
            raise ModelError(f"{path} has a {joint.kind} {joint.name}; it must be {role.kind}.")
        if not np.allclose(joint.axis, role.axis, atol=1e-6):
            shown = [round(part, 6) for part in joint.axis]
            raise ModelError(
                f"{path} has {joint.name} along {shown} of the world; it must be {list(role.axis)}."
            )


def _pivot(joints: Sequence[Joint]) -> int | None:
    """The first joint about which something hangs free."""
    return next(
        (i for i, joint in enumerate(joints) if not joint.driven and joint.kind == "revolute"), None
    )


def _hook(joints: Sequence[Joint], load: int) -> int | None:
    """The joint of the hook, if the payload hangs below it."""
    hoist = next((i for i, joint in enumerate(joints) if joint.role == "hoist"), load)
    return None if hoist == load else hoist


def _point_names(joints: Sequence[Joint], load: int) -> tuple[str, ...]:
    pivot = "trolley" if any(joint.role == "trolley" for joint in joints) else "pivot"
    hook = () if _hook(joints, load) is None else ("hook",)
    return ("payload", *(() if _pivot(joints) is None else (pivot,)), *hook)


def _points(model: pin.Model, layout: Layout, load: int) -> tuple[Point, ...]:
    places = [Point("payload", load, model.inertias[load + 1].lever.copy())]
    if (pivot := _pivot(layout.joints)) is not None:
        places.append(Point(layout.points[1], pivot, np.zeros(3)))
    if (hook := _hook(layout.joints, load)) is not None:
        places.append(Point("hook", hook, model.inertias[hook + 1].lever.copy()))
    return tuple(places)


def _springs(robot: ET.Element, layout: Layout, path: Path) -> Springs:
    """Springs in the tags that Gazebo reads, ``springStiffness`` and ``springReference``, and the
    rope, whose tag is ours.

    ``<ropeStiffness>`` is EA [N]; it stands at the joint that is the stretch of the rope, whose
    length is the joint in the role hoist.
    """
    names = [joint.name for joint in layout.joints]
    stiffness, rest, rope, seen = (
        np.zeros(layout.n),
        np.zeros(layout.n),
        None,
        set[tuple[str, int]](),
    )
    for tag in robot.iterfind("gazebo"):
        found = {
            part.tag: (part.text or "").strip()
            for part in tag
            if part.tag in ("springStiffness", "springReference", "ropeStiffness")
        }
        if not found:
            continue
        name = tag.get("reference", "")
        if name not in names:
            raise UnknownName("moving joint", name, names)
        i = names.index(name)
        joint = layout.joints[i]
        for part in found:
            if (part, i) in seen or len(tag.findall(part)) > 1:
                raise ModelError(f"{path} gives {part} of {name} twice; allowed is once.")
            seen.add((part, i))
        each = "N m/rad" if joint.kind == "revolute" else "N/m"
        if "springStiffness" in found:
            stiffness[i] = number(
                f"spring stiffness of {name}", found["springStiffness"], each, ">= 0"
            )
        if "springReference" in found:
            rest[i] = number(
                f"rest position of the spring of {name}", found["springReference"], joint.unit
            )
        if "ropeStiffness" in found:
            if joint.driven or joint.kind != "prismatic":
                raise ModelError(
                    f"{path} gives the rope's stretch to {name}; it must be a passive prismatic "
                    "joint."
                )
            rope = Rope(
                i,
                layout.role("hoist", "A rope that stretches"),
                number(f"EA of the rope at {name}", found["ropeStiffness"], "N", "> 0"),
            )
    return Springs(stiffness, rest, rope)


def _check_numbers(model: pin.Model, layout: Layout, load: int) -> None:
    for i, joint in enumerate(layout.joints):
        low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        if not (np.isfinite([low, high]).all() and low < high):
            raise OutOfRange(
                f"range of {joint.name}",
                f"{low:g} to {high:g}",
                "finite, lower below upper",
                joint.unit,
            )
        number(f"effort limit of {joint.name}", model.effortLimit[i], joint.effort_unit, "> 0")
        number(f"damping of {joint.name}", model.damping[i], allowed=">= 0")
        if joint.role == "hoist":
            number("shortest cable", low, "m", "> 0")
    number("payload mass", model.inertias[load + 1].mass, "kg", f"{_LIGHTEST:g} to 1e30")


def _check_solvable(model: pin.Model, q: np.ndarray, layout: Layout, path: Path) -> None:
    """The mass matrix, scaled to a unit diagonal, must be far enough from singular for its inverse
    to keep some digits of a double.

    The articulated-body algorithm, which goes through other numbers, must accelerate the crane
    under all its efforts as that matrix does.
    """
    data, none = model.createData(), np.zeros(layout.n)
    mass = np.triu(pin.crba(model, data, q))
    mass += np.triu(mass, 1).T
    own = np.diag(mass)
    if not (
        np.isfinite(mass).all()
        and math.isfinite(pin.computePotentialEnergy(model, data, q))
        and (own > 0.0).all()
    ):
        raise ModelError(
            f"{path} cannot be simulated: masses, lengths or gravity are beyond what a number "
            "holds, or a joint moves nothing."
        )
    share = float(np.linalg.eigvalsh(mass / np.sqrt(own) / np.sqrt(own)[:, None])[0])
    if not share > _SINGULAR:
        raise OutOfRange(
            "smallest eigenvalue of the scaled mass matrix",
            f"{share:.1e}",
            f"> {_SINGULAR:g}: masses differ too much",
        )
    effort = np.where(np.isin(np.arange(layout.n), layout.drives), model.effortLimit, 0.0)
    expected = np.linalg.solve(
        mass / np.sqrt(own) / np.sqrt(own)[:, None],
        (effort - pin.rnea(model, data, q, none, none)) / np.sqrt(own),
    )
    found = pin.aba(model, data, q, none, effort, pin.Convention.WORLD) * np.sqrt(own)
    if not np.abs(found - expected).max() <= _ASTRAY * np.abs(expected).max():
        raise ModelError(
            f"{path} cannot be simulated: its masses and lengths differ so much that accelerations "
            "lose all their digits."
        )


def _start(robot: ET.Element, layout: Layout, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Where the URDF lets each joint start, or at 0, or in the middle of its range."""
    initial = {}
    for joint in robot.iterfind("ros2_control/joint"):
        value = joint.find("state_interface[@name='position']/param[@name='initial_value']")
        if value is not None:
            initial[joint.get("name", "")] = value.text or ""
    return np.array(
        [
            within(f"{joint.name} at the start", initial[joint.name], low, high, joint.unit)
            if joint.name in initial
            else (0.0 if low <= 0.0 <= high else (low + high) / 2)
            for joint, low, high in zip(layout.joints, lower.tolist(), upper.tolist(), strict=True)
        ]
    )
