"""Hydraulic cylinders: what moves a boom is a cylinder whose lever arm changes with the angle, and
drives that share a pump share its flow.

A URDF states a cylinder at the joint that it moves, in an element of this project:

    <gazebo reference="luff_joint">
      <hydraulicCylinder foot="0 0.1 0.1" head="0 -4.2 -0.5" area="0.08"/>
    </gazebo>

The foot is a point of the parent link and the head one of the child link, each in the frame of its
link [m]; the area is that of the piston [m²]. About the axis of a revolute joint both are corners
of a triangle with the sides a and b, and are h apart along the axis:

    L² = a² + b² - 2 a b cos β + h²,      dL/dq = a b sin β / L

with the angle β = q + β₀ from foot to head. The slope dL/dq is the lever arm: by virtual work a
cylinder that pushes with F exerts the torque F dL/dq, and turns the joint by (dL/dt)/(dL/dq). A
cylinder of a prismatic joint lies along its axis, needs no foot and no head, and has the slope 1.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import ModelError, OutOfRange, UnknownName, quoted
from cranedyn.model.crane import Crane
from cranedyn.model.urdf import joint_axis, joint_placement

TAG = "hydraulicCylinder"
"""Tag of a URDF that states a cylinder."""

_DEAD_CENTRE = 1e-3
"""Least sine of the angle between foot and head within the range of a joint. Nearer to a dead
centre, where foot, hinge and head are in line, a finite torque needs a force without bound."""


@dataclass(frozen=True)
class Cylinder:
    """A cylinder of a joint.

    Attributes:
        joint: Index of the joint among the coordinates.
        name: Name of the joint.
        symbol: Symbol of the joint.
        area: Area of the piston [m²].
        foot: Distance of the foot from the axis [m]; 0 for a cylinder along a prismatic joint.
        head: Distance of the head from the axis [m]; 0 for such a cylinder.
        angle: Angle from foot to head at the coordinate zero, about the axis [rad].
        apart: Distance of foot and head along the axis [m].
    """

    joint: int
    name: str
    symbol: str
    area: float
    foot: float = 0.0
    head: float = 0.0
    angle: float = 0.0
    apart: float = 0.0

    @property
    def is_triangle(self) -> bool:
        """Whether it turns a joint, and does not lie along a prismatic one."""
        return self.foot > 0.0

    def length(self, q: np.ndarray | float) -> np.ndarray:
        """Return the distance of foot and head [m] at coordinates of the joint [rad], of their
        shape; of a prismatic joint the coordinate itself [m].
        """
        q = np.asarray(q, dtype=float)
        if not self.is_triangle:
            return q
        sides = self.foot**2 + self.head**2 + self.apart**2
        return np.sqrt(sides - 2.0 * self.foot * self.head * np.cos(q + self.angle))

    def lever_arm(self, q: np.ndarray | float) -> np.ndarray:
        """Return the derivative of the length by the coordinate [m/rad, or 1], of the shape of q:
        the lever arm of the cylinder, positive where it extends as the coordinate grows.
        """
        q = np.asarray(q, dtype=float)
        if not self.is_triangle:
            return np.ones_like(q)
        return self.foot * self.head * np.sin(q + self.angle) / self.length(q)

    def force(self, q: np.ndarray | float, effort: np.ndarray | float) -> np.ndarray:
        """Return the force with which the cylinder pushes [N], negative where it pulls, from the
        effort of its joint [N m or N].
        """
        return np.asarray(effort, dtype=float) / self.lever_arm(q)

    def joint_rate(self, q: np.ndarray | float, speed: float) -> np.ndarray:
        """Return the largest rate of the joint [rad/s or m/s] at coordinates, of their shape, with
        a largest speed of the piston [m/s].

        Raises:
            OutOfRange: If the speed is negative or not finite.
        """
        number("speed of the piston", speed, "m/s", ">= 0")
        return speed / np.abs(self.lever_arm(q))

    def volume(self, q: np.ndarray | float) -> np.ndarray:
        """Return the volume of oil that the cylinder takes for a unit of the coordinate [m³/rad or
        m³/m], of the shape of q.
        """
        return self.area * np.abs(self.lever_arm(q))


def read_cylinders(crane: Crane) -> list[Cylinder]:
    """Return the cylinders that the URDF of a crane states, in the order of the joints.

    Raises:
        ModelError: If one is at a joint that does not move, or at one that has another; if a point
            is no three numbers or lies on the axis, the area is not above 0, or the joint reaches
            a dead centre.
    """
    robot = ET.fromstring(crane.urdf)
    joints = {joint.get("name", ""): joint for joint in robot.iterfind("joint")}
    names = [joint.name for joint in crane.layout.joints]
    cylinders: dict[int, Cylinder] = {}
    for block in robot.iterfind("gazebo"):
        for element in block.iterfind(TAG):
            name = block.get("reference", "")
            if name not in names:
                raise ModelError(
                    f"A <{TAG}> is at {quoted(name)}, which is no joint that moves; there are "
                    f"{', '.join(names)}."
                )
            joint = names.index(name)
            if joint in cylinders:
                raise ModelError(f"The joint {quoted(name)} has two <{TAG}>; allowed is one.")
            cylinders[joint] = _cylinder(crane, joint, joints[name], element)
    return [cylinders[joint] for joint in sorted(cylinders)]


def _cylinder(crane: Crane, joint: int, described: ET.Element, element: ET.Element) -> Cylinder:
    """Return the cylinder of a joint.

    Args:
        crane: The crane.
        joint: Index of the joint among the coordinates.
        described: The joint in the URDF.
        element: The cylinder there.
    """
    layout = crane.layout.joints[joint]
    area = _area(element, layout.name)
    if layout.kind == "prismatic":
        if element.get("foot") or element.get("head"):
            raise ModelError(
                f"The <{TAG}> of {layout.name} lies along a prismatic joint; leave out its foot "
                "and head."
            )
        return Cylinder(joint, layout.name, layout.symbol, area)
    axis = joint_axis(described)
    axis = axis / np.linalg.norm(axis)
    # Both points in the frame of the joint, which is that of the child link at the coordinate zero.
    foot = joint_placement(described).actInv(_point(element, "foot", layout.name))
    head = _point(element, "head", layout.name)
    across_foot = foot - (foot @ axis) * axis
    across_head = head - (head @ axis) * axis
    a = float(np.linalg.norm(across_foot))
    b = float(np.linalg.norm(across_head))
    if min(a, b) < _DEAD_CENTRE:
        raise ModelError(
            f"Foot and head of the <{TAG}> of {layout.name} are {a:.4g} m and {b:.4g} m from its "
            f"axis; allowed is {_DEAD_CENTRE:g} m or more, since it has no lever arm else."
        )
    sine = float(np.cross(across_foot, across_head) @ axis)
    angle = math.atan2(sine, float(across_foot @ across_head))
    apart = float((head - foot) @ axis)
    cylinder = Cylinder(joint, layout.name, layout.symbol, area, a, b, angle, apart)
    _refuse_dead_centre(cylinder, float(crane.lower[joint]), float(crane.upper[joint]))
    return cylinder


def _refuse_dead_centre(cylinder: Cylinder, low: float, high: float) -> None:
    """Refuse a cylinder that has no lever arm somewhere in the range of its joint [rad].

    Raises:
        ModelError: With the coordinate.
    """
    # Dead centres are where q + β₀ is a multiple of π.
    next_one = math.pi * math.ceil((low + cylinder.angle) / math.pi) - cylinder.angle
    ends = [abs(math.sin(end + cylinder.angle)) for end in (low, high)]
    if next_one <= high or min(ends) < _DEAD_CENTRE:
        where = next_one if next_one <= high else (low, high)[int(np.argmin(ends))]
        raise ModelError(
            f"The <{TAG}> of {cylinder.name} has no lever arm at {where:.4g} rad, where foot, "
            f"hinge and head are in line; the joint goes from {low:g} to {high:g} rad. Move the "
            "foot or the head, or narrow the range."
        )


def _point(element: ET.Element, attribute: str, joint: str) -> np.ndarray:
    """Return a point of a cylinder [m], shape (3,).

    Raises:
        ModelError: If it is no three finite numbers.
    """
    text = element.get(attribute, "")
    try:
        point = np.array([float(word) for word in text.split()])
    except ValueError:
        point = np.empty(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ModelError(
            f"The {attribute} of the <{TAG}> of {joint} is {quoted(text)}; allowed are three "
            'numbers [m], such as "0 -4.2 -0.5".'
        )
    return point


def _area(element: ET.Element, joint: str) -> float:
    """Return the area of the piston of a cylinder [m²].

    Raises:
        ModelError: If it is no number above 0.
    """
    text = element.get("area", "")
    try:
        return number("area", float(text), "m²", "> 0")
    except (ValueError, OutOfRange):
        raise ModelError(
            f"The area of the <{TAG}> of {joint} is {quoted(text)}; allowed is a number above 0 "
            "[m²]."
        ) from None


def cylinder_columns(crane: Crane, run: Trajectory) -> dict[str, np.ndarray]:
    """Return what the cylinders of a crane did in a run, shape (rows,) each.

    For each cylinder, with the symbol of its joint such as `luff`:

    * `luff_cylinder_length_m`: distance of foot and head.
    * `luff_cylinder_rate_m_s`: its derivative by time, extending positive.
    * `luff_cylinder_force_N`: force with which it pushes, of a joint that a drive moves.
    * `luff_cylinder_pressure_Pa`: that force over the area of the piston: the difference of the
      pressures of both sides, referred to the piston.

    Friction of the piston and the mass of the cylinder are not in them.

    Args:
        crane: The crane that moved.
        run: What it did.

    Raises:
        ModelError: As `read_cylinders`.
        OutOfRange: If the run is of another crane, or a number is not finite.
    """
    run.check_coordinates(crane.layout.columns()["q"])
    return cylinder_values(crane, run.q, run.v, run.effort)


def cylinder_values(
    crane: Crane, q: np.ndarray, v: np.ndarray, effort: np.ndarray
) -> dict[str, np.ndarray]:
    """Return what the cylinders of a crane do at states and efforts of any number of axes, such as
    those of a batch: ``cylinder_values(crane, batch.q, batch.v, batch.effort)``.

    Args:
        crane: The crane.
        q: Coordinates, shape (..., n).
        v: Their rates, shape (..., n).
        effort: Efforts of the drives, shape (..., m).

    Returns:
        The columns of `cylinder_columns` by their names, shape (...) each.

    Raises:
        ModelError: As `read_cylinders`.
        OutOfRange: If a number is not finite.
    """
    drives = crane.layout.drives.tolist()
    columns = {}
    for cylinder in read_cylinders(crane):
        coordinate = q[..., cylinder.joint]
        called = f"{cylinder.symbol}_cylinder"
        columns[f"{called}_length_m"] = cylinder.length(coordinate)
        columns[f"{called}_rate_m_s"] = cylinder.lever_arm(coordinate) * v[..., cylinder.joint]
        if cylinder.joint in drives:
            force = cylinder.force(coordinate, effort[..., drives.index(cylinder.joint)])
            columns[f"{called}_force_N"] = force
            columns[f"{called}_pressure_Pa"] = force / cylinder.area
    return {name: finite(name, column, q.shape[:-1]) for name, column in columns.items()}


@dataclass(frozen=True)
class Pump:
    """A pump whose flow some drives share.

    Where all of them together ask for more oil than there is, each gets the same share of the rate
    that it asks for, as valves with a common pressure compensation downstream divide it.

    A pump with a power regulator gives less oil where the load is heavy. It keeps the pressure of
    the heaviest loaded drive that moves against its load, as load-sensing pumps do, and its flow
    times this pressure is no more than its power.

    Attributes:
        crane: The crane. Its masses load the drives.
        flow: Largest flow of the pump [m³/s].
        motors: Volumes of drives without a cylinder by the symbols of their joints, such as slew
            and winch: oil for a unit of the coordinate [m³/rad or m³/m].
        power: Largest power of the pump, flow times pressure [W]; infinite for a pump without a
            power regulator.
        cylinders: Cylinders of the crane, all of which are on this pump.

    Raises:
        OutOfRange: If the flow is negative, or a volume or the power is not above 0.
        UnknownName: If a motor is at a joint that has no drive.
        ModelError: If a drive has a cylinder and a motor, or no drive takes oil; and as
            `read_cylinders`.
    """

    crane: Crane
    flow: float
    motors: Mapping[str, float]
    power: float = math.inf
    cylinders: list[Cylinder] = field(init=False)

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("flow of the pump", self.flow, "m³/s", ">= 0")
        if self.power != math.inf:
            number("power of the pump", self.power, "W", "> 0")
        driven = [joint.symbol for joint in self.crane.layout.driven]
        cylinders = read_cylinders(self.crane)
        for symbol, volume in self.motors.items():
            if symbol not in driven:
                raise UnknownName("drive", symbol, driven)
            number(f"volume of {symbol}", volume, "m³", "> 0")
            if any(cylinder.symbol == symbol for cylinder in cylinders):
                raise ModelError(
                    f"{symbol} has a cylinder, and is given a motor, too; allowed is one."
                )
        if not self.motors and not cylinders:
            raise ModelError(
                "No drive takes oil of the pump; give motors, or cylinders in the URDF."
            )
        object.__setattr__(self, "cylinders", cylinders)

    def volumes(self, q: np.ndarray) -> np.ndarray:
        """Return the oil that each drive takes for a unit of its coordinate [m³/rad or m³/m], shape
        (..., m), at coordinates of shape (..., n); 0 for a drive that is not on this pump.
        """
        volumes = np.zeros((*q.shape[:-1], self.crane.layout.m))
        drives = self.crane.layout.drives.tolist()
        for symbol, volume in self.motors.items():
            volumes[..., drives.index(self.crane.layout.index(symbol))] = volume
        for cylinder in self.cylinders:
            if cylinder.joint in drives:
                drive = drives.index(cylinder.joint)
                volumes[..., drive] = cylinder.volume(q[..., cylinder.joint])
        return volumes

    def pressure(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the pressure of the pump [Pa], shape (...): the largest of the drives on it that
        move against their loads; 0 where none does.

        A drive that holds the effort τ at rest and takes the oil V for a unit of its coordinate has
        the pressure |τ|/V, by virtual work. One that moves with its load, such as a boom that is
        lowered, needs none.

        Args:
            q: Coordinates [rad or m], shape (..., n): of one crane, or of many.
            rates: Rates of the drives, shape (..., m).
        """
        volumes = self.volumes(q)
        rows = q.reshape(-1, q.shape[-1])
        held = np.array([holding_effort(self.crane, row) for row in rows]).reshape(rates.shape)
        against = (held * rates > 0.0) & (volumes > 0.0)
        pressures = np.abs(held) / np.where(against, volumes, 1.0)
        return np.where(against, pressures, 0.0).max(axis=-1)

    def available(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the largest flow of the pump [m³/s], shape (...), where its drives move at rates;
        arguments as those of `pressure`.
        """
        flow = np.full(q.shape[:-1], float(self.flow))
        if self.power == math.inf:
            return flow
        pressure = self.pressure(q, rates)
        # Where no pressure is needed, the flow is the limit, and no zero divides.
        return np.minimum(flow, self.power / np.maximum(pressure, np.finfo(float).tiny))

    def limited(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return rates of the drives that the pump can feed [rad/s or m/s], shape (..., m): those
        asked for, or, where Σ volume |rate| is more than its flow, all on it scaled down alike.

        Args:
            q: Coordinates [rad or m], shape (..., n): of one crane, or of many.
            rates: Rates that are asked for, shape (..., m).
        """
        volumes = self.volumes(q)
        needed = (volumes * np.abs(rates)).sum(axis=-1, keepdims=True)
        flow = self.available(q, rates)[..., None]
        # Where nothing is needed, the share is 1, and no zero divides.
        share = flow / np.maximum(needed, np.maximum(flow, np.finfo(float).tiny))
        return np.where(volumes > 0.0, rates * share, rates)
