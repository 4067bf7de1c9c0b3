"""The crane: a Pinocchio model, the layout of its joints, and numbers that Pinocchio ignores."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from cranedyn.checks import finite, number, within
from cranedyn.data.time_series import html_table
from cranedyn.errors import Misshapen, ModelError, OutOfRange, UnknownName
from cranedyn.interfaces import State
from cranedyn.model.friction import DryFriction
from cranedyn.model.layout import ALIGNED, Layout
from cranedyn.model.mimics import Coupling
from cranedyn.model.springs import (
    Rest,
    Springs,
    linearise_rest,
    no_rest,
    rest_stiffness,
    solve_rest,
)

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], exact by definition (CGPM 1901)."""

NO_RATE_LIMIT = 1e3
"""Velocity limit that a URDF states for a joint without one [rad/s or m/s]. It is not 0, since
other programs keep a joint with the velocity limit 0 from moving."""

_MAX_START_SWING = float(np.nextafter(np.pi / 2, 0.0))
"""Largest swing at the start [rad], the last number below 90°."""

_LEAST_LEVER = 1e-6
"""Least motion of the load per unit of a coordinate that is not round-off [m/rad or m/m]."""

_COLUMN_WIDTHS = (7, 24, 4, 9, 9, 9, 12)
"""Least width of each column of `Crane.__repr__` [characters]."""


class Point(NamedTuple):
    """Point of a crane on which forces act.

    Attributes:
        name: Name in columns.
        body: Index of the joint that carries it among the coordinates.
        lever: Position in the frame of that joint [m], shape (3,).
    """

    name: str
    body: int
    lever: np.ndarray


class _Scratch(threading.local):
    """Scratch memory of Pinocchio, one for each thread."""

    def __init__(self, model: pin.Model) -> None:
        self.model = model
        self.data = model.createData()

    def __reduce__(self) -> tuple[type[_Scratch], tuple[pin.Model]]:
        """Pickle the model; the memory of a thread is made anew in another process."""
        return type(self), (self.model,)


@dataclass(frozen=True, eq=False, repr=False)
class Crane:
    """A crane with n joints and m drives: parameters that do not change during a run, safe to use
    from several threads.

    Attributes:
        layout: Joints by name.
        urdf_source: Function that returns the plain URDF with its visuals, see `urdf`.
        model: Pinocchio model; joint i + 1 has coordinate i.
        damping: Viscous damping of each joint [N m s/rad or N s/m], shape (n,). Pinocchio parses it
            but never applies it.
        springs: Springs in the joints.
        friction: Dry friction in the joints, and the width of its smooth law; None if no joint has
            any.
        coupling: Joints that follow others, such as the sections of a telescope; None if there are
            none.
        lower, upper: Joint ranges [rad or m], shape (n,).
        effort_limit: Largest effort of the drives [N m or N], shape (m,).
        start: State in which runs start: the drives as in the URDF, all else hanging at rest. A
            mechanism whose passive joints do not hang starts with them where the URDF states.
        points: Points on which external forces act, the payload first.
        record: All that `cranedyn.model.load.load_crane` needs to load the crane again, as it is
            recorded with a run. Assumptions that led to its URDF are not part of it: a crane loaded
            from a record lists fewer.
        assumptions: What was assumed or turned when the crane was loaded, a sentence each.
    """

    layout: Layout
    urdf_source: Callable[[], str] = field(repr=False)
    model: pin.Model
    damping: np.ndarray
    springs: Springs
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    start: State
    points: tuple[Point, ...]
    record: Mapping[str, Any] = field(repr=False)
    friction: DryFriction | None = None
    coupling: Coupling | None = None
    assumptions: tuple[str, ...] = ()
    _scratch: _Scratch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Set the yaw stiffness of two falls from the weight below them, and create scratch
        memory.
        """
        object.__setattr__(self, "springs", self.springs.carrying(self.model))
        object.__setattr__(self, "_scratch", _Scratch(self.model))

    @property
    def data(self) -> pin.Data:
        """Scratch memory of Pinocchio for the calling thread."""
        return self._scratch.data

    @cached_property
    def urdf(self) -> str:
        """Plain URDF with masses, joints and visuals ("looks"). It is made at the first use, since
        expanding the visuals of this project's cranes takes time.
        """
        return self.urdf_source()

    @property
    def gravity(self) -> float:
        """Gravity [m/s²] along -Z of the world."""
        return float(-self.model.gravity.linear[2])

    @property
    def rate_limit(self) -> np.ndarray:
        """Largest rates of the drives [rad/s or m/s], shape (m,); inf where the URDF gives none, 0,
        or a limit of `NO_RATE_LIMIT` and above.
        """
        limit = self.model.velocityLimit[self.layout.drives]
        return np.where((limit > 0.0) & (limit < NO_RATE_LIMIT), limit, np.inf)

    @cached_property
    def winch(self) -> int | None:
        """Index among the drives of the joint that sets the length of the rope: the only prismatic
        drive that a swing joint carries; None if there is none or are several.
        """
        winches = []
        for drive, i in enumerate(self.layout.drives.tolist()):
            if self.layout.joints[i].kind == "prismatic" and self._hangs_on_swing(i):
                winches.append(drive)
        return winches[0] if len(winches) == 1 else None

    def _hangs_on_swing(self, joint: int) -> bool:
        """Return whether a swing joint carries the joint of an index."""
        # Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
        carriers = self.model.supports[joint + 1].tolist()
        return any(swing + 1 in carriers for swing in self.swings.tolist())

    @property
    def payload(self) -> Point:
        """Centre of mass of the payload."""
        return self.points[0]

    @property
    def payload_mass(self) -> float:
        """Mass of the payload [kg], with all that is fixed to its joint."""
        return float(self._inertia(self.payload.body).mass)

    @property
    def payload_inertia(self) -> np.ndarray:
        """Rotational inertia of the payload about its centre of mass in the frame of its joint
        [kg m²], shape (3, 3).
        """
        return self._inertia(self.payload.body).inertia.copy()

    @property
    def trolley_mass(self) -> float:
        """Mass that the trolley joint carries above the swing pivot [kg]."""
        return float(self._inertia(self.layout.role("trolley", "The mass of the trolley")).mass)

    @property
    def slewing_inertia(self) -> float:
        """Rotational inertia of the upper structure about the slew axis [kg m²], without trolley
        and payload.
        """
        slew = self.layout.role("slew", "The slewing inertia")
        return self._moment(slew, self.layout.joints[slew].axis)

    @property
    def dummy_inertia(self) -> tuple[float, float]:
        """Inertia about the pivot of the links between the swing joints: against radial and against
        tangential swing [kg m²].
        """
        user = "The inertia of the links between the swing joints"
        radial = self.layout.role("radial_swing", user)
        tangential = self.layout.role("tangential_swing", user)
        radial_axis = self.layout.joints[radial].axis
        tangential_axis = self.layout.joints[tangential].axis
        # The radial swing turns both links, the tangential one only that of its own joint.
        outer = self._moment(radial, radial_axis)
        inner = self._moment(tangential, radial_axis)
        return outer + inner, self._moment(tangential, tangential_axis)

    def _moment(self, joint: int, axis: Sequence[float]) -> float:
        """Return the moment of inertia of the body that a joint carries about an axis through the
        origin of that joint [kg m²].

        Args:
            joint: Index of the joint among the coordinates.
            axis: Unit vector in the world with all coordinates at zero.
        """
        data = self.data
        pin.forwardKinematics(self.model, data, np.zeros(self.layout.n))
        axis_in_joint = data.oMi[joint + 1].rotation.T @ np.array(axis)
        # The rotational block of the spatial inertia is about the origin of the joint.
        rotational = self._inertia(joint).matrix()[3:, 3:]
        return float(axis_in_joint @ rotational @ axis_in_joint)

    def _inertia(self, joint: int) -> pin.Inertia:
        """Return the inertia of the body that a joint carries, in the frame of that joint."""
        return self.model.inertias[joint + 1]

    @cached_property
    def swings(self) -> np.ndarray:
        """Indices of the swings among the coordinates: passive revolute joints without a spring."""
        joints = self.layout.joints
        passive = self.layout.passive.tolist()
        elastic = self.springs.elastic
        swings = [i for i in passive if joints[i].kind == "revolute" and not elastic[i]]
        return np.array(swings, dtype=int)

    def swing_angles(self, q: np.ndarray) -> np.ndarray:
        """Return the angles of the swing joints from rest [rad], shape (..., swings), at
        coordinates of shape (..., n).

        Raises:
            Misshapen: If q is not n numbers in each row; it is an OutOfRange.
        """
        q = np.asarray(q, dtype=float)
        if q.shape[-1:] != (self.layout.n,):
            shape = f"one of shape (..., {self.layout.n})"
            raise Misshapen("coordinates", f"an array of shape {q.shape}", shape)
        drives = q[..., self.layout.drives]
        return q[..., self.swings] - self.rest.angle - drives @ self.rest.slope.T

    @cached_property
    def swing_directions(self) -> tuple[str, ...]:
        """A sentence for each swing joint on the way in which its positive angle moves the load, by
        the Jacobian of the load at the start; none for a mechanism that does not hang.

        Such as "phi > 0 moves the load towards +Y, where portal increases." Of drives, the sentence
        names those that move the load along the same line. A joint about the vertical turns the
        load.
        """
        if not self.rest.hangs:
            return ()
        linear, angular = self._payload_jacobian(self.start.q)
        sentences = []
        for i in self.swings.tolist():
            symbol = self.layout.joints[i].symbol
            # The load of a swing moves horizontally from where it hangs; what is left is round-off
            # or a lever along the axis.
            step = float(np.linalg.norm(linear[:, i]))
            if abs(angular[2, i]) >= ALIGNED:
                way = "counter-clockwise" if angular[2, i] > 0.0 else "clockwise"
                sentences.append(f"{symbol} > 0 turns the load {way}, seen from above.")
            elif step > _LEAST_LEVER:
                direction = linear[:, i] / step
                towards = _direction_text(direction) + self._slewed_text(i)
                drives = self._drives_along(direction, linear)
                sentences.append(f"{symbol} > 0 moves the load towards {towards}{drives}.")
        return tuple(sentences)

    def _payload_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the position of the payload in the world, and the angular
        velocities of its body per rate, by the coordinates, shape (3, n) each.
        """
        payload = self.points[0]
        data = self.data
        pin.computeJointJacobians(self.model, data, q)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getJointJacobian(self.model, data, payload.body + 1, frame)
        lever = data.oMi[payload.body + 1].rotation @ payload.lever
        angular = jacobian[3:]
        return jacobian[:3] - pin.skew(lever) @ angular, angular

    def _slewed_text(self, joint: int) -> str:
        """Return words for a direction that turns with a drive above a joint; else none."""
        above = self.model.supports[joint + 1].tolist()
        for i in self.layout.drives.tolist():
            if self.layout.joints[i].kind == "revolute" and i + 1 in above:
                return " at the start"
        return ""

    def _drives_along(self, direction: np.ndarray, linear: np.ndarray) -> str:
        """Return words for the drives that move the load along a unit vector, or against it.

        Args:
            direction: The unit vector, shape (3,).
            linear: Derivatives of the position of the load by the coordinates, shape (3, n).
        """
        text = ""
        for i in self.layout.drives.tolist():
            step = float(np.linalg.norm(linear[:, i]))
            along = float(direction @ linear[:, i])
            if step > _LEAST_LEVER and abs(along) >= ALIGNED * step:
                grows = "increases" if along > 0.0 else "decreases"
                text += f", where {self.layout.joints[i].symbol} {grows}"
        return text

    def state(self, **values: float) -> State:
        """Return a state from named coordinates and rates.

        Args:
            values: Coordinates by the symbols of `layout` [rad or m], for a tower crane gamma, x,
                phi, theta, l, and rates by the same symbols with the ending "_dot" [per second].
                Drives left out are as in `start`, and rates left out are zero. The passive joints
                hang at rest for these drives, unless the coordinate of one of them is given: then
                the others stay where they are in `start`, which is at rest for its drives.

        Raises:
            UnknownName: For any other name.
            OutOfRange: For a value that is not finite or outside the range of the joint, for a
                swing of 90° or more from where the load hangs, and for a joint that follows
                another.
            ModelError: If the load has no rest with these drives, see `hanging`.
        """
        layout = self.layout
        q = self.start.q.copy()
        v = np.zeros(layout.n)
        coordinates: dict[int, float] = {}
        for name, value in values.items():
            i = self._named_coordinate(name, value)
            if name == layout.symbols[i]:
                coordinates[i] = value
            else:
                v[i] = number(f"{name} at the start", value, f"{layout.units[i]}/s")
        # Drives first: where a swing joint hangs depends on them.
        for i in sorted(coordinates, key=lambda i: i in self.swings):
            low, high = self._start_range(i, q)
            name = f"{layout.symbols[i]} at the start"
            q[i] = within(name, coordinates[i], low, high, layout.units[i])
        passive_given = any(layout.symbols[i] in values for i in layout.passive)
        if self.coupling is not None:
            q = self.coupling.complete(q)
            v = self.coupling.spread(v)
        if not passive_given:
            q = self.resting(q)
        return State(q, v)

    def _named_coordinate(self, name: str, value: object) -> int:
        """Return the index of the coordinate that a name of `state` means, or whose rate it means.

        Raises:
            UnknownName: If there is none.
            OutOfRange: If its joint follows another one.
        """
        layout = self.layout
        symbol = name.removesuffix("_dot")
        if symbol not in layout.symbols:
            rates = [f"{symbol}_dot" for symbol in layout.symbols]
            raise UnknownName("coordinate", name, [*layout.symbols, *rates])
        i = layout.index(symbol)
        leader = layout.joints[i].follows
        if leader:
            raise OutOfRange(f"{name} at the start", value, f"left out: it follows {leader}")
        return i

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Return the mass matrix at coordinates q, shape (n, n), both triangles; of the reduced
        coordinates where joints follow others, see `cranedyn.model.mimics`.
        """
        mass = pin.crba(self.model, self.data, q)
        return mass if self.coupling is None else self.coupling.reduce(mass)

    def require_independent_joints(self, user: str) -> None:
        """Check that no joint follows another.

        Args:
            user: What cannot do with such a joint, to begin an error message with.

        Raises:
            ModelError: If one does.
        """
        self.require_light_rope(user)
        for joint in self.layout.joints:
            if joint.follows:
                raise ModelError(
                    f"{user} is made for joints that do not follow others; {joint.name} follows "
                    f"{joint.follows}. Hold both by locked=[{joint.follows!r}], or --locked."
                )

    def require_light_rope(self, user: str) -> None:
        """Check that the rope has no mass, and so no joints at which it bends.

        Args:
            user: What cannot do with such a rope, to begin an error message with.

        Raises:
            ModelError: If it has.
        """
        if self.springs.rope_mass is not None:
            raise ModelError(
                f"{user} is made for a rope without mass; do it with the crane loaded with "
                "rope_mass 0."
            )

    def _start_range(self, joint: int, q: np.ndarray) -> tuple[float, float]:
        """Return the range in which a joint may start [rad or m]: its range in the URDF, and for a
        swing less than 90° from where the load hangs with the drives as in q.
        """
        low = float(self.lower[joint])
        high = float(self.upper[joint])
        # A joint about the vertical, such as a swivel, turns the load without lifting it.
        is_vertical = abs(self.layout.joints[joint].axis[2]) >= ALIGNED
        if joint not in self.swings or is_vertical or not self.rest.hangs:
            return low, high
        swing = self.swings.tolist().index(joint)
        hanging = float(self.rest.angle[swing] + self.rest.slope[swing] @ q[self.layout.drives])
        return max(low, hanging - _MAX_START_SWING), min(high, hanging + _MAX_START_SWING)

    def resting(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinates of `hanging`, shape (n,). Of a mechanism whose passive joints do
        not hang, such as a robot with free joints, return q with the followers where their leaders
        put them.
        """
        if self.rest.hangs:
            return self.hanging(q)
        return q if self.coupling is None else self.coupling.complete(q)

    def hanging(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinates at rest, shape (n,): the drives as in q, the passive joints where
        gravity and springs balance, by Newton's method from q.

        Raises:
            OutOfRange: If q is not one finite number for each joint.
            ModelError: If there is no rest near q within the joint ranges.
        """
        q = finite("coordinates", q, (self.layout.n,))
        at_rest = solve_rest(
            self.model, self.data, self.springs, self.layout.passive, q, self.coupling
        )
        for i in self.layout.passive.tolist():
            joint = self.layout.joints[i]
            low = self.lower[i]
            high = self.upper[i]
            if np.isnan(at_rest[i]):
                raise ModelError(
                    "This crane does not hang at rest: no posture in which gravity and springs "
                    f"balance was found from {self.layout.coordinates_text(q)} on."
                )
            if not low <= at_rest[i] <= high:
                raise ModelError(
                    "This crane does not hang at rest within the ranges of its joints: "
                    f"{joint.name} would be at {at_rest[i]:.6g} {joint.unit}, its range is "
                    f"{low:.6g} to {high:.6g} {joint.unit}."
                )
        return at_rest

    @cached_property
    def rest(self) -> Rest:
        """How the crane hangs at rest with its drives as in `start`: whether it hangs at all, its
        coordinates there, and the angles of the swing joints to first order in the drives.
        """
        try:
            q = self.hanging(self.start.q)
        except ModelError:
            return no_rest(self.start.q, self.layout, self.swings)
        stiffness = rest_stiffness(self.model, self.data, self.springs, q, self.coupling)
        return linearise_rest(stiffness, q, self.layout, self.swings)

    def __repr__(self) -> str:
        """Return a title, a line for each joint, the directions of the swings, and the
        assumptions.
        """
        table = self._rows
        widths = list(_COLUMN_WIDTHS)
        for row in table:
            widths = [max(width, len(text)) for width, text in zip(widths, row, strict=True)]
        lines = []
        for row in table:
            cells = []
            for column, (text, width) in enumerate(zip(row, widths, strict=True)):
                is_word = column < 3  # symbol, joint and unit
                cells.append(text.ljust(width) if is_word else text.rjust(width))
            lines.append(" ".join(cells).rstrip())
        return "\n".join([self._title, *lines, *self.swing_directions, *self.assumptions])

    def _repr_html_(self) -> str:
        """Return title and joints as an HTML table, for notebooks."""
        return html_table(self._title, self._rows)

    @property
    def _title(self) -> str:
        """First line of the texts about this crane."""
        payload = f"payload of {self.payload_mass:g} kg"
        return f"Crane with a {payload} in gravity of {self.gravity:g} m/s²"

    @property
    def _rows(self) -> list[tuple[str, ...]]:
        """Headings, and a row of texts for each joint."""
        effort_limits = dict(zip(self.layout.drives.tolist(), self.effort_limit, strict=True))
        headings = ("symbol", "joint", "unit", "from", "to", "start", "drive")
        rows: list[tuple[str, ...]] = [headings]
        for i, joint in enumerate(self.layout.joints):
            drive = f"{effort_limits[i]:g} {joint.effort_unit}" if joint.driven else "passive"
            if self.coupling is not None and i in self.coupling.followers:
                drive = self.coupling.formula(i, joint.follows)
            rows.append(
                (
                    joint.symbol,
                    joint.name,
                    joint.unit,
                    f"{self.lower[i]:.5g}",
                    f"{self.upper[i]:.5g}",
                    f"{self.start.q[i]:.5g}",
                    drive,
                )
            )
        return rows


def _direction_text(direction: np.ndarray) -> str:
    """Return a unit vector of the world in words, such as "-X" or "(0.71, -0.71, 0)"."""
    for name, component in zip("XYZ", direction.tolist(), strict=True):
        if abs(component) >= ALIGNED:
            return f"{'+' if component > 0.0 else '-'}{name}"
    # Adding zero makes 0 of -0.
    return "({:g}, {:g}, {:g})".format(*(np.round(direction, 2) + 0.0))


_Result = TypeVar("_Result")


def once_per_crane(function: Callable[[Crane], _Result]) -> Callable[[Crane], _Result]:
    """Return a function that keeps its result for each crane for as long as the crane exists."""
    # Weak keys: a result goes with its crane.
    results = WeakKeyDictionary[Crane, _Result]()

    @wraps(function)
    def result_of(crane: Crane) -> _Result:
        if crane not in results:
            results[crane] = function(crane)
        return results[crane]

    return result_of
