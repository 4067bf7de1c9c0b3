"""Joint forces besides drives, gravity and inertia: damping, dry friction, springs, and stops at
the ends of the ranges.

With the coordinate q and rate v of a joint these are

    damping          -d v
    dry friction     -f v/√(v² + w²)                          see `cranedyn.model.friction`
    spring           -k (q - q_rest)
    elastic rope     -T on the stretch s, and +½ EA (s/l)² on the length l where s > 0
    two falls        see `cranedyn.model.springs.Bifilar`
    stops            -k (q - q_end) - d v, where this pushes inwards

The rope pulls and does not push: its tension is T = max(0, EA s/l + d v_s), and 0 where s < 0. The
force on the length is minus the derivative by l of the strain energy EA s²/(2 l), see
`cranedyn.model.springs`.

No law gives the tension of an inextensible rope. Taut, it holds its stretch at 0 as a constraint;
slack, nothing acts on the stretch, where `springs.check_stretch` refuses damping for that reason.

The functions work on any kind of number, see `cranedyn.dynamics.scalars`: floats in the plain loop,
symbols in the optimiser, values of a program in compiled code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cranedyn.dynamics.scalars import array, clipped, square_root, where
from cranedyn.model.crane import Crane
from cranedyn.model.friction import DryFriction
from cranedyn.model.layout import Layout
from cranedyn.model.springs import Rope, Springs

_STOP_FREQUENCY = 20.0
"""Natural frequency of the inertia at a joint on its end stop [rad/s]."""

_STOP_DAMPING = 0.5
"""Damping ratio of this oscillation."""

TAUT = 0.0
"""Phase of a rope that pulls."""

SLACK = 1.0
"""Phase of a rope that hangs loose."""


@dataclass(frozen=True, eq=False)
class JointForces:
    """Damping, dry friction and springs of n joints.

    Attributes:
        damping: Viscous damping [N m s/rad or N s/m], shape (n,).
        springs: The springs; None if there are none.
        friction: Dry friction; None if there is none.
        taut: Whether the rope pulls, for a step within which that does not change; None where the
            state decides.
    """

    damping: np.ndarray
    springs: Springs | None
    friction: DryFriction | None = None
    taut: Any = None

    @classmethod
    def of(cls, crane: Crane) -> JointForces:
        """Return the damping, dry friction and springs of a crane."""
        return cls(crane.damping, crane.springs if crane.springs.any else None, crane.friction)

    @property
    def viscous_only(self) -> bool:
        """Whether nothing but viscous damping acts."""
        return self.springs is None and self.friction is None

    def without_dry_friction(self) -> JointForces:
        """Return the same without dry friction, for derivatives.

        The slope of the smooth law at rest is that of its smoothing, which a controller or an
        observer must not take for damping; in motion the slope is nearly zero.
        """
        return replace(self, friction=None)

    def in_steps(self, dt: Any, mass: Any = 1.0) -> JointForces:
        """Return the same with time in units of `dt` [s] and mass in units of `mass` [kg].

        A force is a mass times a length over a squared time, so that its number is multiplied by
        dt²/mass, and so is that of a stiffness. A damping is multiplied by dt/mass, since it is a
        force over a rate.
        """
        damping = self.damping * (dt / mass)
        force = dt * dt / mass
        springs = None if self.springs is None else self.springs.in_units(force)
        friction = None if self.friction is None else self.friction.in_units(force, dt)
        return JointForces(damping, springs, friction, self.taut)

    def resistance(self, v: np.ndarray) -> np.ndarray:
        """Return the efforts by which damping and dry friction oppose rates v, with the sign of the
        rates: shape (n,), or (n, rows) for rates of shape (n, rows).
        """
        # Transposed, so that one row or many are multiplied by the damping of their joint.
        viscous = (self.damping * v.T).T
        if self.friction is None:
            return viscous
        resistance = viscous.copy()
        for joint in self.friction.joints:
            resistance[joint] = resistance[joint] + self._dry_friction(joint, v[joint])
        return resistance

    def resistance_of(self, joint: int, rate: Any) -> Any:
        """Return the effort by which damping and dry friction oppose the rate of one joint, by its
        index among the coordinates.
        """
        viscous = self.damping[joint] * rate
        if self.friction is None or joint not in self.friction.joints:
            return viscous
        return viscous + self._dry_friction(joint, rate)

    def _dry_friction(self, joint: int, rate: Any) -> Any:
        """Return f v/√(v² + w²): Coulomb's law f sign(v), smoothed over a width w of the rate.

        See `cranedyn.model.friction`.
        """
        assert self.friction is not None
        place = self.friction.joints.index(joint)
        width = self.friction.width[place]
        return self.friction.effort[place] * (rate / square_root(rate * rate + width * width))

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return generalized forces at coordinates q and rates v, shape (n,)."""
        resisting = -self.resistance(v)
        if self.springs is None:
            return resisting
        effort = resisting + self.springs.effort(q)
        # Spring and damper of the rope were counted each by itself, and the damper also where it
        # pushes. The tension takes their place.
        if self.rope is not None and not self.rope.inextensible:
            effort[self.rope.stretch] = -self.tension(q, v)
        return effort

    def tangent(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the stiffness -∂τ/∂q, shape (n, n), and the damping -∂τ/∂v, shape (n,), at a state
        in floats.

        Dry friction is left out, see `without_dry_friction`.
        """
        n = len(q)
        stiffness = np.zeros((n, n)) if self.springs is None else self.springs.tangent(q)
        damping = self.damping.copy()
        if self.rope is not None and not self.phase(q, v) == TAUT:
            # A slack rope pulls at nothing.
            stiffness[self.rope.stretch] = 0.0
            damping[self.rope.stretch] = 0.0
        return stiffness, damping

    def dissipation(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return the power that damping and dry friction dissipate [W], for coordinates and rates
        of shape (n,) or (n, rows).

        An elastic rope dissipates (T - EA s/l) v_s, with s/l counted as 0 where s < 0:

        * taut, this is the power d v_s² of its damper;
        * slack with s > 0 left, this is -EA (s/l) v_s, the rate at which the strain energy that is
          left is lost;
        * slack with s < 0, this is 0.

        It takes the place of d v_s² in the sum over the joints.
        """
        if self.friction is None:
            power = self.damping @ (v * v)
        else:
            power = (self.resistance(v) * v).sum(axis=0)
        if self.rope is None or self.rope.inextensible:
            return power
        stretch = self.rope.stretch
        damper = self.tension(q, v) - self.rope.stiffness * self.rope.strain(q)
        counted = self.damping[stretch] * v[stretch]
        return power + (damper - counted) * v[stretch]

    @property
    def rope(self) -> Rope | None:
        """Rope that may stretch or go slack; None if there is none."""
        return None if self.springs is None else self.springs.rope

    def tension(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return the tension of an elastic rope, of spring and damper [N]; 0 where it is slack.

        For an inextensible rope this is 0: its tension follows from the motion of the whole crane,
        see `cranedyn.dynamics.equations_of_motion.constraint_tension`.

        Where `taut` is given, it decides between taut and slack, and not the state.
        """
        spring, damper = self._rope_forces(q, v)
        taut = self.pull(q, v) > 0.0 if self.taut is None else self.taut
        return where(taut, spring + damper, 0.0)

    def pull(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return a force that is positive where an elastic rope pulls [N].

        It is the force of the spring and, while the rope shortens, of the damper: a rope goes slack
        where its damper would push harder than its spring pulls, and becomes taut only where it is
        stretched, however fast it lengthens.
        """
        spring, damper = self._rope_forces(q, v)
        return spring + where(damper < 0.0, damper, 0.0)

    def phase(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return `TAUT` or `SLACK` for a rope that may go slack, of states in floats."""
        assert self.rope is not None
        if self.rope.inextensible:
            taut = (q[self.rope.stretch] >= 0.0) & (v[self.rope.stretch] >= 0.0)
        else:
            taut = self.pull(q, v) > 0.0
        return where(taut, TAUT, SLACK)

    def _rope_forces(self, q: np.ndarray, v: np.ndarray) -> tuple[Any, Any]:
        """Return the forces EA s/l of the spring of a rope, and d v_s of its damper [N]."""
        assert self.rope is not None
        stretch = self.rope.stretch
        strain = q[stretch] / q[self.rope.length]
        spring = self.rope.stiffness * strain
        damper = self.damping[stretch] * v[stretch]
        return spring, damper


def rope_tension(
    layout: Layout, joint_forces: JointForces, q: np.ndarray, v: np.ndarray, hoist: Any
) -> Any:
    """Return the tension of the rope [N]; None without a hoist, and for an inextensible rope that
    may go slack, whose tension follows from the motion of the whole crane.

    It is the force that stretches an elastic rope. For a rope that neither stretches nor goes slack
    it is the force of the hoist joint, which lies along the rope. A positive force lowers the load,
    so that the tension is minus the force of the drive, plus the damping and dry friction that
    resist the lowering.

    Args:
        layout: Joints of the crane.
        joint_forces: Damping, dry friction and springs of the joints.
        q: Coordinates, n numbers or rows of them.
        v: Their rates, likewise.
        hoist: Force of the hoist and of the buffers at the ends of the cable [N], negative where it
            holds the load.
    """
    if joint_forces.rope is not None:
        return None if joint_forces.rope.inextensible else joint_forces.tension(q, v)
    if not layout.has("hoist"):
        return None
    hoist_joint = layout.role("hoist", "The rope")
    return joint_forces.resistance_of(hoist_joint, v[hoist_joint]) - hoist


@dataclass(frozen=True, eq=False)
class Stops:
    """Buffers at both ends of the range of each of m drives: springs with dampers that push but do
    not pull.

    Attributes:
        drives: Indices of the drives among the coordinates.
        lower, upper: Ends of their ranges [rad or m], shape (m,).
        stiffness: Stiffness [N m/rad or N/m], shape (m,).
        damping: Damping [N m s/rad or N s/m], shape (m,).
    """

    drives: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    @classmethod
    def of(cls, crane: Crane) -> Stops:
        """Return the buffers of a crane.

        On its buffer, each drive with the masses on it oscillates at ω = `_STOP_FREQUENCY` with the
        damping ratio ζ = `_STOP_DAMPING`: k = m ω² and d = 2 ζ ω m. The inertia m is that with the
        drives as at the start and the passive joints at zero, where the load of this project's
        cranes hangs plumb.
        """
        drives = crane.layout.drives
        q = crane.start.q.copy()
        q[crane.layout.passive] = 0.0
        if crane.coupling is not None:
            q = crane.coupling.complete(q)
        inertia = np.diag(crane.mass_matrix(q))[drives]
        stiffness = _STOP_FREQUENCY**2 * inertia
        damping = 2.0 * _STOP_DAMPING * _STOP_FREQUENCY * inertia
        return cls(drives, crane.lower[drives], crane.upper[drives], stiffness, damping)

    def in_steps(self, dt: Any, mass: Any = 1.0) -> Stops:
        """Return the same in other units, see `JointForces.in_steps`."""
        stiffness = self.stiffness * (dt * dt / mass)
        damping = self.damping * (dt / mass)
        return Stops(self.drives, self.lower, self.upper, stiffness, damping)

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the efforts of the buffers at coordinates q and rates v, shape (m,)."""
        are_floats = q.dtype != object
        # Floats of Python are quicker than elements of an array.
        positions = q.tolist() if are_floats else q
        rates = v.tolist() if are_floats else v
        efforts = []
        for drive, joint in enumerate(self.drives):
            efforts.append(self.effort_of(drive, positions[joint], rates[joint]))
        return np.array(efforts) if are_floats else array(efforts)

    def effort_of(self, drive: int, position: Any, rate: Any) -> Any:
        """Return the effort of the buffers of one drive at its position and rate.

        A buffer only pushes back inwards: a force that would pull outwards counts as 0, and so does
        any force while the drive is inside its range.
        """
        beyond = position - clipped(position, self.lower[drive], self.upper[drive])
        pushing = -(self.stiffness[drive] * beyond) - self.damping[drive] * rate
        return where(pushing * beyond < 0.0, pushing, 0.0)

    def beyond(self, q: np.ndarray) -> list[Any]:
        """Return for each end of the range of each drive whether the drive is beyond it, 2 m in
        all: lower and upper end of the first drive, then those of the next.
        """
        are_beyond = []
        for joint, low, high in zip(self.drives, self.lower, self.upper, strict=True):
            are_beyond.append(q[joint] < low)
            are_beyond.append(q[joint] > high)
        return are_beyond
