"""Kinematics of a crane whose load hangs on a rope at the end of one chain of joints, for many
rows of coordinates at once.

From the ground to the load such a crane has drives that carry the *pivot*, two passive joints at
the pivot in which the rope swings, and a hoist, whose joint lets the load down along the rope. That
is an overhead or gantry crane (bridge, trolley), a luffing or mobile crane (slew, luff), a wall
crane, a crane on a robot's arm, and also a tower crane (slew, trolley). Where more than two drives
carry the pivot, all but two of them are to be locked, see `cranedyn.model.load.load_crane`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ALIGNED

_POSITION_TOLERANCE = 1e-4
"""Largest distance of joints that count as at one point [m], as of
`cranedyn.lifts.planning.clearance.ROUNDING`."""

_RIGHT_ANGLE_TOLERANCE = 1e-5
"""Largest cosine of an angle that counts as a right one: what a URDF rounds to 1.5708 is off by
4e-6."""

_NEWTON_STEPS = 30
"""Largest number of steps of Newton's method. It ends as soon as it converges, mostly after four.
"""

_CONVERGED = 1e-11
"""Largest remaining distance of a pivot from where it should be [m]."""

_DRIVES = 3
"""Number of drives with which a lift is planned: two that carry the pivot, and the hoist."""


@dataclass(frozen=True, eq=False)
class PivotMotion:
    """The pivot of a crane and how it moves.

    Attributes:
        point: Positions in the frame of the crane [m], shape (rows, 3).
        by_drive: Derivatives by both drives that carry it, shape (rows, 3, 2).
        attitude: Rotations from the link that carries it to the frame of the crane, shape
            (rows, 3, 3); with all coordinates at zero the unit matrix.
    """

    point: np.ndarray
    by_drive: np.ndarray
    attitude: np.ndarray


@dataclass(frozen=True, eq=False)
class CarrierLines:
    """Both drives that carry a pivot, in the frame of the crane, for many rows.

    Attributes:
        chain: The chain of joints.
        axes: Axes of both drives, shape (rows, 3) each.
        origins: Points on these axes [m], shape (rows, 3) each.
        rotations: Rotations that each drive and those before it make of what it carries, shape
            (rows, 3, 3) each.
        translations: Where a point p that a drive carries is, with p its place with all
            coordinates at zero: rotation p + translation [m]; shape (rows, 3) each.
    """

    chain: HoistChain
    axes: list[np.ndarray]
    origins: list[np.ndarray]
    rotations: list[np.ndarray]
    translations: list[np.ndarray]

    def point_on(self, joint: int, point: np.ndarray) -> np.ndarray:
        """Return where a point in the frame of a joint is [m], shape (rows, 3): of one of both
        drives, or of the first swing, which the second drive carries.
        """
        carrier = 0 if joint == self.chain.carriers[0] else 1
        at_zero = self.chain.at_zero(joint, point)
        return self.rotations[carrier] @ at_zero + self.translations[carrier]


class HoistChain:
    """The chain of joints of a crane.

    With all coordinates at zero, let e1 and e2 be the axes of the first and the second swing, and d
    the direction of the rope. These three are at right angles to each other. A link that has been
    turned by R since then carries the rope along R Rot(e1, φ) Rot(e2, θ) d.

    A drive that turns the pivot does so about the vertical or about e1. So a plumb rope has θ = 0,
    φ takes back what a boom luffs, and a plumb load turns about the vertical by exactly what the
    drives do. With other axes it would turn by more, which the bounds of
    `cranedyn.lifts.planning.chain_clearance` leave out.

    Attributes:
        crane: The crane.
        carriers: Indices of both drives that carry the pivot, among the coordinates.
        swings: Indices of both swings.
        hoist: Index of the hoist.
        offset: Distance of the centre of the load from the pivot less the coordinate of the hoist
            [m].

    Raises:
        ModelError: If the joints of the crane are no such chain, with the reason.
    """

    def __init__(self, crane: Crane) -> None:
        """Check the joints and keep where they are."""
        self.crane = crane
        _refuse_no_chain(crane)
        layout = crane.layout
        first_carrier, second_carrier, hoist = layout.drives.tolist()
        self.carriers = (first_carrier, second_carrier)
        self.hoist = hoist
        first_swing, second_swing = crane.swings.tolist()
        self.swings = (first_swing, second_swing)

        data = crane.model.createData()
        pin.forwardKinematics(crane.model, data, np.zeros(layout.n))
        at_zero = [data.oMi[i + 1].copy() for i in range(layout.n)]
        axes = [np.array(joint.axis) for joint in layout.joints]
        self._first_axis = axes[first_swing]
        self._second_axis = axes[second_swing]
        self._rope = axes[hoist]
        _refuse_skew_swings(crane, at_zero, axes, self.swings, hoist)
        _refuse_skew_drives(crane, axes, self.carriers, first_swing)

        # Positions and axes in a frame that all joints share at zero: that of the crane.
        self._origins = [frame.translation.copy() for frame in at_zero]
        self._rotations = [frame.rotation.copy() for frame in at_zero]
        self._axes = axes
        # All that a swing's angles follow from, see `swing_along`: s = e2 × d, which is ±e1, and
        # e1 × d.
        self._side_sign = float(np.cross(self._second_axis, self._rope) @ self._first_axis)
        self._ahead = np.cross(self._first_axis, self._rope)
        at_end = self._origins[hoist] - self._origins[second_swing]
        self.offset = float(at_end @ self._rope)
        lever = float(np.linalg.norm(crane.payload.lever))
        if lever > _POSITION_TOLERANCE:
            raise ModelError(
                f"The centre of mass of the load is {lever:.4g} m from the frame of the joint "
                f"{crane.layout.joints[hoist].name}. A planned lift has the load about that frame; "
                "put the origin of the joint there."
            )

    def at_zero(self, joint: int, point: np.ndarray) -> np.ndarray:
        """Return where a point in the frame of a joint is with all coordinates at zero [m], shape
        (3,).
        """
        return self._rotations[joint] @ point + self._origins[joint]

    def about_swings(self, joint: int, inertia: np.ndarray) -> np.ndarray:
        """Return the moments of inertia about the axes of both swings [kg m²], shape (2,), of an
        inertia in the frame of a joint, shape (3, 3), with all coordinates at zero.
        """
        in_crane = self._rotations[joint] @ inertia @ self._rotations[joint].T
        axes = (self._first_axis, self._second_axis)
        return np.array([axis @ in_crane @ axis for axis in axes])

    # --- the drives that carry the pivot ----------------------------------------------------------

    def pivot(self, carriers: np.ndarray) -> PivotMotion:
        """Return the pivot at positions of both drives that carry it, shape (rows, 2)."""
        lines = self.carrier_lines(carriers)
        position = lines.rotations[1] @ self._origins[self.swings[0]] + lines.translations[1]
        columns = []
        for i, joint in enumerate(self.carriers):
            axis = lines.axes[i]
            turns = self.turns(joint)
            columns.append(np.cross(axis, position - lines.origins[i]) if turns else axis)
        return PivotMotion(position, np.stack(columns, axis=-1), lines.rotations[1])

    def carrier_lines(self, carriers: np.ndarray) -> CarrierLines:
        """Return where both drives that carry the pivot are, and what they carry, at positions of
        shape (rows, 2).
        """
        rows = len(carriers)
        rotation = np.broadcast_to(np.eye(3), (rows, 3, 3))
        translation = np.zeros((rows, 3))
        axes = []
        origins = []
        rotations = []
        translations = []
        for i, joint in enumerate(self.carriers):
            origin = self._origins[joint]
            axis = rotation @ self._axes[joint]
            here = rotation @ origin + translation
            if self.turns(joint):
                rotation = rotation @ _rotations(self._axes[joint], carriers[:, i])
                # The origin of a joint does not move when the joint turns.
                translation = here - rotation @ origin
            else:
                translation = translation + axis * carriers[:, i, None]
            axes.append(axis)
            origins.append(here)
            rotations.append(rotation)
            translations.append(translation)
        return CarrierLines(self, axes, origins, rotations, translations)

    def pivot_acceleration(
        self, carriers: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
    ) -> np.ndarray:
        """Return the acceleration of the pivot [m/s²], shape (rows, 3), at positions, rates and
        accelerations of both drives that carry it, shape (rows, 2) each.
        """
        motion = self.pivot(carriers)
        linear = np.einsum("rij,rj->ri", motion.by_drive, accelerations)
        # What is quadratic in the rates: Σ ∂J/∂q_k q̇_k q̇. For joints i before k in the chain,
        # ∂J_k/∂q_i = ω_i × J_k, and ∂J_i/∂q_k is the same where i revolves, or 0.
        for k in range(2):
            for i in range(k + 1):
                if not self.turns(self.carriers[i]):
                    continue
                axis = self._axis_at(carriers, i)
                turned = np.cross(axis, motion.by_drive[:, :, k])
                times = 1.0 if i == k else 2.0
                linear = linear + times * turned * (rates[:, i] * rates[:, k])[:, None]
        return linear

    def _axis_at(self, carriers: np.ndarray, i: int) -> np.ndarray:
        """Return the axis of drive i of `carriers` in the frame of the crane, shape (rows, 3)."""
        axis = self._axes[self.carriers[i]]
        if i == 0 or not self.turns(self.carriers[0]):
            return np.broadcast_to(axis, (len(carriers), 3))
        return _rotations(self._axes[self.carriers[0]], carriers[:, 0]) @ axis

    def tips(self, joint: int) -> bool:
        """Return whether a joint turns what it carries about another axis than the vertical."""
        return self.turns(joint) and abs(float(self._axes[joint][2])) < ALIGNED

    def turns(self, joint: int) -> bool:
        """Return whether a joint turns what it carries."""
        return self.crane.layout.joints[joint].kind == "revolute"

    # --- swings -----------------------------------------------------------------------------------

    def swing_along(self, attitude: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return the angles of both swings with which the rope points along directions [rad], shape
        (rows, 2).

        Args:
            attitude: Rotations of the link that carries the pivot, shape (rows, 3, 3).
            direction: Unit vectors down along the rope in the frame of the crane, shape (rows, 3).
        """
        # u = Rᵀ direction = Rot(e1, φ) (d cos θ + s sin θ) with s = e2 × d, which is ±e1.
        u = np.einsum("rji,rj->ri", attitude, direction)
        swings = np.empty((len(u), 2))
        swings[:, 0] = np.arctan2(u @ self._ahead, u @ self._rope)
        swings[:, 1] = np.arcsin(np.clip(self._side_sign * (u @ self._first_axis), -1.0, 1.0))
        return swings

    def rope(self, q: np.ndarray) -> np.ndarray:
        """Return unit vectors down along the rope in the frame of the crane, shape (rows, 3), at
        coordinates of shape (rows, n).
        """
        attitude = self.pivot(q[:, list(self.carriers)]).attitude
        first, second = self.swings
        swung = _rotations(self._first_axis, q[:, first])
        swung = swung @ _rotations(self._second_axis, q[:, second])
        return np.einsum("rij,rjk,k->ri", attitude, swung, self._rope)

    def plumb(self, places: np.ndarray) -> np.ndarray:
        """Return all coordinates at places, shape (rows, 3), the load plumb; shape (rows, n)."""
        q = np.zeros((len(places), self.crane.layout.n))
        q[:, list(self.carriers)] = places[:, :2]
        q[:, self.hoist] = places[:, 2]
        # Turned about the vertical, a plumb rope has the same angles in the frame that turns, so
        # that one row stands for all.
        attitude = np.eye(3)[None] if self._stays_level else self._attitude(places[:, :2])
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(attitude), 3))
        q[:, list(self.swings)] = self.swing_along(attitude, down)
        return q

    @cached_property
    def _stays_level(self) -> bool:
        """Whether no drive that carries the pivot turns it about another axis than the vertical."""
        return not any(self.tips(joint) for joint in self.carriers)

    def _attitude(self, carriers: np.ndarray) -> np.ndarray:
        """Return `PivotMotion.attitude` alone at positions of shape (rows, 2)."""
        attitude = np.eye(3)[None]
        for i, joint in enumerate(self.carriers):
            if self.turns(joint):
                attitude = attitude @ _rotations(self._axes[joint], carriers[:, i])
        return np.broadcast_to(attitude, (len(carriers), 3, 3))

    # --- from the load to the drives --------------------------------------------------------------

    def carriers_above(self, points: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return positions of both drives with which the pivot is above points in plan [m], shape
        (rows, 2), by Newton's method from first positions, shape (rows, 2). Rows in which it does
        not converge are not finite.
        """
        carriers = first.copy()
        for _ in range(_NEWTON_STEPS):
            motion = self.pivot(carriers)
            off = points - motion.point[:, :2]
            if np.abs(off).max(initial=0.0) <= _CONVERGED:
                break
            carriers = carriers + _solve(motion.by_drive[:, :2, :], off)
        else:
            missed = np.abs(points - self.pivot(carriers).point[:, :2]).max(axis=1)
            carriers[~(missed <= 1e3 * _CONVERGED)] = np.nan
        return carriers

    def carriers_along(self, points: np.ndarray, rope: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return positions of both drives, and distances from points to the pivot, with which the
        pivot is up along the rope from points: shape (rows, 3).

        Args:
            points: Points in the frame of the crane [m], shape (rows, 3).
            rope: Unit vectors up along the rope, shape (rows, 3).
            first: Positions and distances from which Newton's method begins, shape (rows, 3).

        Raises:
            ModelError: If it does not converge: the drives cannot carry such a rope.
        """
        found = first.copy()
        for _ in range(_NEWTON_STEPS):
            motion = self.pivot(found[:, :2])
            off = points + rope * found[:, 2:] - motion.point
            if np.abs(off).max() <= _CONVERGED:
                return found
            matrix = np.concatenate([motion.by_drive, -rope[:, :, None]], axis=2)
            found = found + _solve(matrix, off)
        raise ModelError(
            "The drives that carry the rope cannot follow the load on this path: they pass a "
            "position in which both move it in the same direction."
        )


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions of linear systems, shape (rows, k): of least size where one is singular,
    and zero where its numbers are not finite.
    """
    try:
        return np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:  # one of all is singular
        finite = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        solutions = np.zeros_like(right)
        pseudo_inverses = np.linalg.pinv(matrix[finite])
        solutions[finite] = (pseudo_inverses @ right[finite][:, :, None])[:, :, 0]
        return solutions


def _rotations(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the rotation matrices about a unit axis by angles [rad], shape (rows, 3, 3), by
    Rodrigues' formula.
    """
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sines = np.sin(angles)[:, None, None]
    versines = (1.0 - np.cos(angles))[:, None, None]
    return np.eye(3) + sines * cross + versines * (cross @ cross)


def _refuse_no_chain(crane: Crane) -> None:
    """Refuse a crane whose joints are no chain of two drives, two swings and a hoist.

    Raises:
        ModelError: With what it lacks.
    """
    crane.require_independent_joints("A planned lift")
    layout = crane.layout
    names = [joint.name for joint in layout.joints]
    needed = (
        "A planned lift needs one chain of joints from the ground to the load: two drives, two "
        "swing joints at one point, and a hoist"
    )
    if [int(parent) for parent in crane.model.parents[1:]] != list(range(layout.n)):
        raise ModelError(f"{needed}. The joints of this crane branch: {', '.join(names)}.")
    if layout.m != _DRIVES:
        drives = ", ".join(layout.joints[i].name for i in layout.drives)
        advice = ""
        if layout.m > _DRIVES:
            advice = " Hold the others: locked=[...], --locked, or locked in [crane] of a site."
        raise ModelError(f"{needed}. This crane has {layout.m} drives: {drives}.{advice}")
    expected = [*layout.drives[:2].tolist(), *crane.swings.tolist(), int(layout.drives[2])]
    if crane.winch != _DRIVES - 1 or len(crane.swings) != 2 or expected != list(range(layout.n)):
        raise ModelError(
            f"{needed}. This crane has {', '.join(names)}; of these {_listed(crane, crane.swings)} "
            "swing. Plan it on the crane without a rope that stretches, a load on two falls, a "
            "hook with a sling below it, or a mast that bends."
        )
    if not crane.rest.hangs:
        raise ModelError(f"{needed}. The load of this crane does not hang at rest.")


def _listed(crane: Crane, joints: np.ndarray) -> str:
    """Return the names of joints in a sentence, "none" without any."""
    return ", ".join(crane.layout.joints[i].name for i in joints) or "none"


def _refuse_skew_drives(
    crane: Crane, axes: list[np.ndarray], carriers: tuple[int, int], first_swing: int
) -> None:
    """Refuse a drive that turns the pivot about an axis that is neither vertical nor that of the
    first swing, see `HoistChain`.

    Raises:
        ModelError: With the drive and the angle.
    """
    tips = False
    for joint in carriers:
        described = crane.layout.joints[joint]
        if described.kind != "revolute":
            continue
        is_vertical = abs(axes[joint][2]) >= ALIGNED and not tips
        cosine = abs(float(axes[joint] @ axes[first_swing]))
        if not is_vertical and not cosine >= ALIGNED:
            raise ModelError(
                f"A planned lift needs drives that turn about the vertical, or about the axis of "
                f"{crane.layout.joints[first_swing].name}, as a boom luffs. {described.name} turns "
                f"about an axis at {math.degrees(math.acos(min(cosine, 1.0))):.1f}° to that."
            )
        tips = tips or not is_vertical  # what a boom carries does not stay upright


def _refuse_skew_swings(
    crane: Crane,
    at_zero: list[pin.SE3],
    axes: list[np.ndarray],
    swings: tuple[int, int],
    hoist: int,
) -> None:
    """Refuse swings that are apart from each other or from the rope, or at other than right angles.

    Args:
        crane: The crane.
        at_zero: Frames of the joints with all coordinates at zero.
        axes: Axes of the joints there.
        swings: Indices of both swings.
        hoist: Index of the hoist.

    Raises:
        ModelError: With what is wrong.
    """
    first, second = swings
    names = crane.layout.joints
    apart = float(np.linalg.norm(at_zero[first].translation - at_zero[second].translation))
    to_hoist = at_zero[hoist].translation - at_zero[second].translation
    aside = float(np.linalg.norm(to_hoist - (to_hoist @ axes[hoist]) * axes[hoist]))
    if max(apart, aside) > _POSITION_TOLERANCE:
        raise ModelError(
            f"A planned lift needs both swing joints at one point, through which the rope runs: "
            f"{names[first].name} and {names[second].name} are {apart:.4g} m apart, and the axis "
            f"of {names[hoist].name} passes them at {aside:.4g} m."
        )
    pairs = ((first, second), (second, hoist), (first, hoist))
    for one, other in pairs:
        cosine = abs(float(axes[one] @ axes[other]))
        if cosine > _RIGHT_ANGLE_TOLERANCE:
            raise ModelError(
                f"A planned lift needs the axes of both swing joints and of the hoist at right "
                f"angles to each other with all coordinates at zero; the cosine between "
                f"{names[one].name} and {names[other].name} is {cosine:.4g}."
            )
    up = at_zero[hoist].rotation[:, 2]
    if not -float(up @ axes[hoist]) >= ALIGNED:
        raise ModelError(
            f"A planned lift needs the frame of {names[hoist].name} with its Z axis up along the "
            "rope; turn the origin of the joint in the URDF."
        )
