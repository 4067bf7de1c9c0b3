"""From a URDF to a crane: expanded, parsed, checked."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.arguments import taken
from cranedyn.data.files import read_text
from cranedyn.errors import ModelError, OutOfRange, UnknownName, number, printable, quoted, within
from cranedyn.interfaces import State
from cranedyn.model.crane import DRIVES, JOINTS, STANDARD_GRAVITY, UNITS, Crane
from cranedyn.model.description import XACRO, describe
from cranedyn.model.urdf import check, parse, skeleton


def load_crane(urdf: str | Path | None = None, *, gravity: float = STANDARD_GRAVITY, check_axes: bool = True, **values: object) -> Crane:
    """Load a crane.

    Args:
        urdf: A ``.xacro`` file to expand, which runs Python expressions in it: only from those whose programs you would run, too. Any
            other file is plain URDF: nothing in it is run, fetched or read from elsewhere. None is the crane of this project.
        gravity: Gravity [m/s²] along -Z.
        check_axes: Whether the joint axes must be those of `JOINTS`. False is for showing what a wrong axis does.
        values: Arguments of the xacro file, for example ``payload_mass=2000``.

    Raises:
        ModelError: If it is no valid URDF or not a crane: a joint missing, of another type, out of order, turned, or one too many.
        OutOfRange: If a number in it is not one a crane can have.
        UnknownName: If an argument is not declared in the xacro file.
        DataError: If the file cannot be read.
    """
    g = number("gravity", gravity, "m/s²", "> 0")
    taken("check_axes", check_axes, bool)
    path = XACRO if urdf is None else Path(taken("urdf", urdf, str | Path))
    if path.suffix == ".xacro":
        text = describe(path, values, visuals=urdf is not None)
    elif values:
        raise UnknownName("argument", next(iter(values)), ["none in a plain URDF"])
    else:
        text = read_text(path)
    robot = parse(text, path)
    check(robot, path)
    model = _model(skeleton(robot), path)
    model.gravity.linear = np.array([0.0, 0.0, -g])
    _check_joints(model, path, check_axes)
    _check_numbers(model)
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    initial = _initial(robot)
    q = np.array(
        [
            within(f"{j.name} at the start", initial[j.name], lower[i], upper[i], UNITS[i])
            if j.name in initial
            else (0.0 if lower[i] <= 0.0 <= upper[i] else (lower[i] + upper[i]) / 2)
            for i, j in enumerate(JOINTS)
        ]
    )
    _check_solvable(model, q, path)
    return Crane(
        written=partial(_whole, path, values) if urdf is None else partial(str, text),
        model=model,
        damping=model.damping.copy(),
        lower=lower,
        upper=upper,
        effort_limit=model.effortLimit[DRIVES].copy(),
        start=State(q, np.zeros(5)),
    )


def _whole(path: Path, values: dict[str, object]) -> str:
    text = describe(path, values)
    check(parse(text, path), path)
    return text


def _model(skeleton: str, path: Path) -> pin.Model:
    try:
        return pin.buildModelFromXML(skeleton)
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{path} is not a URDF that can be loaded: {printable(str(error).strip().rstrip('.'))}.") from error


def _check_joints(model: pin.Model, path: Path, check_axes: bool) -> None:
    names = list(model.names)[1:]
    expected = [joint.name for joint in JOINTS]
    for name in expected:
        if name not in names:
            raise ModelError(f"{path} has no moving joint {name}; a crane has {', '.join(expected)}.")
    for name in names:
        if name not in expected:
            raise ModelError(
                f"{path} has a further moving joint {quoted(name)}; a crane moves only in {', '.join(expected)}: make it fixed."
            )
    if names != expected or list(model.parents) != [0, 0, 1, 2, 3, 4]:
        raise ModelError(f"{path} chains its joints as {', '.join(map(quoted, names))}; a crane is one chain {', '.join(expected)}.")
    for i, joint in enumerate(JOINTS, start=1):
        if model.joints[i].nq != 1:
            raise ModelError(f"{path} has a {joint.name} without limits or with several axes; it must be {joint.kind} with limits.")
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(5))
    for i, joint in enumerate(JOINTS, start=1):
        column = pin.getJointJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[:, i - 1]
        linear, angular = column[:3], column[3:]
        kind = "prismatic" if np.linalg.norm(angular) < 1e-9 else "revolute"
        if kind != joint.kind:
            raise ModelError(f"{path} has a {kind} {joint.name}; it must be {joint.kind}.")
        axis = linear if kind == "prismatic" else angular
        if check_axes and not np.allclose(axis, joint.axis, atol=1e-6):
            raise ModelError(f"{path} has {joint.name} along {axis.round(6).tolist()} of the world; it must be {list(joint.axis)}.")


def _check_numbers(model: pin.Model) -> None:
    for i, joint in enumerate(JOINTS):
        low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        if not (np.isfinite([low, high]).all() and low < high):
            raise OutOfRange(f"range of {joint.name}", f"{low:g} to {high:g}", "finite, lower below upper", UNITS[i])
        number(f"effort limit of {joint.name}", model.effortLimit[i], "N m" if joint.kind == "revolute" else "N", "> 0")
        number(f"damping of {joint.name}", model.damping[i], allowed=">= 0")
        inertia = model.inertias[i + 1]
        number(f"mass moved by {joint.name}", inertia.mass, "kg", ">= 0")
        if not np.isfinite(inertia.inertia).all() or np.linalg.eigvalsh(inertia.inertia).min() < -1e-9 * np.abs(inertia.inertia).max():
            raise OutOfRange(f"inertia moved by {joint.name}", inertia.inertia.tolist(), "positive semidefinite", "kg m²")
    number("payload mass", model.inertias[5].mass, "kg", "> 0")
    number("payload mass", model.inertias[5].mass, "kg", f"{_LIGHTEST:g} to 1e30")
    number("shortest cable", model.lowerPositionLimit[4], "m", "> 0")


def _check_solvable(model: pin.Model, q: np.ndarray, path: Path) -> None:
    """The mass matrix, scaled to a unit diagonal, must be far enough from singular for its inverse to keep some digits of a double.

    The articulated-body algorithm, which goes through other numbers, must accelerate the crane under all its efforts as that matrix does.
    """
    data, none = model.createData(), np.zeros(5)
    mass = np.triu(pin.crba(model, data, q))
    mass += np.triu(mass, 1).T
    own = np.diag(mass)
    if not (np.isfinite(mass).all() and math.isfinite(pin.computePotentialEnergy(model, data, q)) and (own > 0.0).all()):
        raise ModelError(
            f"{path} cannot be simulated: masses, lengths or gravity are beyond what a number holds, or a joint moves nothing."
        )
    share = float(np.linalg.eigvalsh(mass / np.sqrt(own) / np.sqrt(own)[:, None])[0])
    if not share > _SINGULAR:
        raise OutOfRange("smallest eigenvalue of the scaled mass matrix", f"{share:.1e}", f"> {_SINGULAR:g}: masses differ too much")
    effort = np.where(np.isin(np.arange(5), DRIVES), model.effortLimit, 0.0)
    expected = np.linalg.solve(mass / np.sqrt(own) / np.sqrt(own)[:, None], (effort - pin.rnea(model, data, q, none, none)) / np.sqrt(own))
    found = pin.aba(model, data, q, none, effort, pin.Convention.WORLD) * np.sqrt(own)
    if not np.abs(found - expected).max() <= _ASTRAY * np.abs(expected).max():
        raise ModelError(f"{path} cannot be simulated: its masses and lengths differ so much that accelerations lose all their digits.")


def _initial(robot: ET.Element) -> dict[str, str]:
    found = {}
    for joint in robot.iterfind("ros2_control/joint"):
        value = joint.find("state_interface[@name='position']/param[@name='initial_value']")
        if value is not None:
            found[joint.get("name", "")] = value.text or ""
    return found


_SINGULAR, _ASTRAY = 1e-10, 1e-3


_LIGHTEST = 1e-15
"""Least payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if they weighed that."""
