"""The crane: a Pinocchio model whose joints are known by name, split into driven and passive."""

from __future__ import annotations

import math
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.arguments import checked, described, taken
from cranedyn.arrays import shaped
from cranedyn.description import XACRO, describe
from cranedyn.errors import ModelError, OutOfRange, UnknownName, number, printable, quoted, within
from cranedyn.files import read_text
from cranedyn.urdf import check, parse, skeleton

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], exact by definition (CGPM 1901)."""

COORDINATES = ("gamma", "x", "phi", "theta", "l")
"""The five coordinates in chain order: slew, trolley radius, radial swing, tangential swing, cable length."""

UNITS = ("rad", "m", "rad", "rad", "m")
"""Unit of each coordinate."""

DRIVES = np.array([0, 1, 4])
"""Where slew, trolley and hoist stand among the coordinates."""

PASSIVE = np.array([2, 3])
"""Where radial and tangential swing stand among the coordinates."""


_UPRIGHT = float(np.nextafter(np.pi / 2, 0.0))
_SINGULAR, _ASTRAY = 1e-10, 1e-3
_LIGHTEST = 1e-15
"""Least payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if they weighed that."""


class _Joint(NamedTuple):
    name: str
    kind: str
    axis: tuple[int, int, int]


JOINTS = (
    _Joint("yaw_joint", "revolute", (0, 0, 1)),
    _Joint("trolley_joint", "prismatic", (0, -1, 0)),
    _Joint("swing_radial_joint", "revolute", (1, 0, 0)),
    _Joint("swing_tangential_joint", "revolute", (0, 1, 0)),
    _Joint("hoist_joint", "prismatic", (0, 0, -1)),
)
"""The joints behind the coordinates: name, type, and axis in the world when every coordinate is zero."""


class State(NamedTuple):
    """Where the crane is and how it moves.

    Attributes:
        q: Slew [rad], trolley radius [m], radial swing [rad], tangential swing [rad], cable length [m]; shape (5,).
        v: Their rates, per second; shape (5,).
    """

    q: np.ndarray
    v: np.ndarray

    @classmethod
    def checked(cls, name: str, value: Any) -> State:
        """A state of five finite coordinates and rates that nobody else can change.

        Args:
            name: Which state it is, for the sentence.
            value: A state, or two sequences of five numbers.

        Raises:
            OutOfRange: If it is none.
        """
        try:
            coordinates, rates = value
        except Exception:  # whatever it is, it is no pair
            raise OutOfRange(name, described(value), "five coordinates and five rates, all numbers") from None
        state = cls(*(taken(name, part, np.ndarray).copy() for part in (coordinates, rates)))
        for kind, part in zip(("coordinates", "rates"), state, strict=True):
            if part.shape != (5,):
                raise OutOfRange(f"{kind} at the {name}", described(part), f"five numbers: {', '.join(COORDINATES)}")
            for coordinate, unit, one in zip(COORDINATES, UNITS, part, strict=True):
                if kind == "rates":
                    number(f"{coordinate} among the rates at the {name}", one, f"{unit}/s")
                else:
                    number(f"{coordinate} at the {name}", one, unit)
            part.flags.writeable = False
        return state


class _Scratch(threading.local):
    """Scratch memory of Pinocchio: whichever thread asks has its own, made when it first asks."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()

    def __reduce__(self) -> tuple[type[_Scratch], tuple[pin.Model]]:
        return type(self), (self.model,)


@checked
@dataclass(frozen=True, eq=False)
class Crane:
    """A crane as loaded: parameters that do not change during a run, and that several threads may use at once.

    Attributes:
        written: What gives its plain URDF; ask for `urdf`.
        model: The Pinocchio model; joint i + 1 carries coordinate i.
        damping: Viscous damping of each joint [N m s/rad or N s/m], shape (5,). Pinocchio parses it but never applies it.
        lower, upper: Joint ranges [rad or m], shape (5,).
        effort_limit: Largest effort of the drives slew [N m], trolley [N], hoist [N], shape (3,).
        start: Where the URDF lets the drives start, hanging at rest.
    """

    written: Callable[[], str] = field(repr=False)
    model: pin.Model
    damping: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    start: State
    _scratch: _Scratch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Have scratch memory for each thread.

        Raises:
            OutOfRange: If an array has another shape.
        """
        for name, count in (("damping", 5), ("lower", 5), ("upper", 5), ("effort_limit", 3)):
            shaped(name, getattr(self, name), (count,))
        object.__setattr__(self, "_scratch", _Scratch(self.model))

    @property
    def data(self) -> pin.Data:
        """Scratch memory of Pinocchio for `cranedyn.dynamics`, that of the calling thread."""
        return self._scratch.data

    @cached_property
    def urdf(self) -> str:
        """The plain URDF of all that moves, weighs and can be seen; written when it is first asked for, since the looks take their time."""
        return self.written()

    @property
    def gravity(self) -> float:
        """Gravity [m/s²], acting along -Z of the world."""
        return float(-self.model.gravity.linear[2])

    @property
    def payload_mass(self) -> float:
        """Mass that hangs on the hoist joint [kg]."""
        return float(self.model.inertias[5].mass)

    @property
    def trolley_mass(self) -> float:
        """Mass that the trolley joint carries above the swing pivot [kg]."""
        return float(self.model.inertias[2].mass)

    @property
    def slewing_inertia(self) -> float:
        """Rotational inertia of the upper structure about the slew axis [kg m²], trolley and payload not counted."""
        return float(self.model.inertias[1].matrix()[5, 5])

    @property
    def payload_inertia(self) -> float:
        """Rotational inertia of the payload about its own X axis [kg m²]."""
        return float(self.model.inertias[5].inertia[0, 0])

    @property
    def dummy_inertia(self) -> tuple[float, float]:
        """Inertia of the links between the swing joints about the pivot: against radial and against tangential swing [kg m²]."""
        outer, inner = (self.model.inertias[i].matrix()[3:, 3:] for i in (3, 4))
        return float(outer[0, 0] + inner[0, 0]), float(inner[1, 1])

    def state(self, **values: float) -> State:
        """A state from named coordinates, at rest where nothing else is said.

        Args:
            values: Any of gamma, x, phi, theta, l [rad or m] and gamma_dot, x_dot, phi_dot, theta_dot, l_dot [per second].
                Coordinates left out are those of `start`, rates left out are zero.

        Raises:
            UnknownName: For a name that is none of these.
            OutOfRange: For a value outside the joint's range, a swing of 90° or more among them, or one that is not finite.
        """
        q, v = self.start.q.copy(), np.zeros(5)
        for name, value in values.items():
            coordinate = name.removesuffix("_dot")
            if coordinate not in COORDINATES:
                raise UnknownName("coordinate", name, [*COORDINATES, *(f"{c}_dot" for c in COORDINATES)])
            i = COORDINATES.index(coordinate)
            if name == coordinate:
                low, high = self.lower[i], self.upper[i]
                if i in PASSIVE:
                    low, high = max(low, -_UPRIGHT), min(high, _UPRIGHT)
                q[i] = within(f"{name} at the start", value, low, high, UNITS[i])
            else:
                v[i] = number(f"{name} at the start", value, f"{UNITS[i]}/s")
        return State(q, v)


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
    wanted = [joint.name for joint in JOINTS]
    for name in wanted:
        if name not in names:
            raise ModelError(f"{path} has no moving joint {name}; a crane has {', '.join(wanted)}.")
    for name in names:
        if name not in wanted:
            raise ModelError(f"{path} has a further moving joint {quoted(name)}; a crane moves only in {', '.join(wanted)}: make it fixed.")
    if names != wanted or list(model.parents) != [0, 0, 1, 2, 3, 4]:
        raise ModelError(f"{path} chains its joints as {', '.join(map(quoted, names))}; a crane is one chain {', '.join(wanted)}.")
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
