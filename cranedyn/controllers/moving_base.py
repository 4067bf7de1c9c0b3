"""Control of a crane on a base that moves: heave compensation, and swing as it is in the world.

A drive knows its motion relative to the base, and so does an encoder of the swing. Both functions
of this module need the motion of the base besides, as a motion reference unit measures it:

* `heave_compensated` is a reference whose hoist pays out what the base lifts, so that the load
  keeps its height in the world.
* `swing_in_world` is a controller that sees the swing from where the load would hang plumb, and
  not from the axes of the base, which tilt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.checks import ShortRepr, number
from cranedyn.clocks import Clocked
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.bodies import point_paths
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.springs import rest_stiffness
from cranedyn.references.tabulated import tabulated

_RATE_STEP = 1e-3
"""Time over which the tilt of the base is differentiated [s]: on a sea of some seconds the error of
the central difference is a millionth."""


@dataclass(frozen=True, eq=False, repr=False)
class HeaveCompensated(ShortRepr):
    """A reference whose hoist pays out what the base lifts, see `heave_compensated`.

    Attributes:
        crane: The crane.
        reference: Reference of the crane on a base at rest.
        base: Motion of the base.
        ahead: Time by which the base is foreseen [s].
    """

    crane: Crane
    reference: Reference
    base: BaseMotion
    ahead: float

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        position, velocity, acceleration = self.at(np.array([t]))
        return Setpoint(position[0], velocity[0], acceleration[0])

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (k, m) each."""
        crane = self.crane
        hoist = crane.layout.drive_of("hoist")
        position, velocity, acceleration = tabulated(self.reference, times, crane.layout.m)
        position = position.copy()
        velocity = velocity.copy()
        acceleration = acceleration.copy()
        frames = self.base.frames(np.asarray(times) + self.ahead)
        pivot = self._pivots(position)

        # Vertical motion in the world of the point of the base at which the pivot is.
        in_axes = np.cross(frames.omega, pivot)
        turning = np.cross(frames.alpha, pivot) + np.cross(frames.omega, in_axes)
        upwards = frames.rotation[:, 2]
        position[:, hoist] += frames.origin[:, 2] + (upwards * pivot).sum(axis=1) - pivot[:, 2]
        velocity[:, hoist] += frames.velocity[:, 2] + (upwards * in_axes).sum(axis=1)
        acceleration[:, hoist] += frames.acceleration[:, 2] + (upwards * turning).sum(axis=1)
        return Setpoint(position, velocity, acceleration)

    def _pivots(self, positions: np.ndarray) -> np.ndarray:
        """Return the points from which the load hangs in the frame of the base [m], shape (k, 3),
        for positions of the drives, shape (k, m).
        """
        crane = self.crane
        q = np.tile(crane.start.q, (len(positions), 1))
        q[:, crane.layout.drives] = positions
        return point_paths(crane, q)[:, 1]


def heave_compensated(
    crane: Crane, reference: Reference, base: BaseMotion, *, ahead: float = 0.0
) -> HeaveCompensated:
    """Return a reference whose hoist pays out what the base lifts.

    The length of the cable grows by the height that the pivot of the load gains in the world, with
    heave, roll and pitch. So a load that hangs plumb keeps its height exactly, with drives that
    follow exactly, while the other drives stand: while they move, rate and acceleration lack what
    their motion adds on a tilted base. Drives that answer late leave a rest of the heave: with the
    response H(ω) of the hoist, the share |1 - H(ω)|.

    Args:
        crane: A crane with a hoist.
        reference: Reference of the crane on a base at rest.
        base: Motion of the base, as it is measured.
        ahead: Time by which the base is foreseen [s], such as the delay and lag of the hoist.

    Raises:
        OutOfRange: If the crane has no hoist, or the load hangs from no point above it, or the time
            is negative.
    """
    if crane.layout.drive_of("hoist") is None or len(crane.points) < 2:
        raise OutOfRange("crane", "one without a hoist", "one with a hoist and a pivot above it")
    return HeaveCompensated(crane, reference, base, number("ahead", ahead, "s", ">= 0"))


@dataclass(frozen=True, eq=False, repr=False)
class SwingInWorld(ShortRepr):
    """A controller that sees the swing from where the load would hang plumb, see `swing_in_world`.

    Attributes:
        crane: The crane.
        controller: The controller.
        base: Motion of the base.
    """

    crane: Crane
    controller: Controller
    base: BaseMotion

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of the controller, shape (m,)."""
        # A record of a base has ends, at which the difference is one-sided.
        earlier = max(t - _RATE_STEP, self.base.first)
        later = min(t + _RATE_STEP, self.base.last)
        rotations = self.base.frames(np.array([earlier, t, later])).rotation
        gravity = self.crane.model.gravity.linear
        # Gravity in the axes of the base less that on a level base, at the three times.
        turned = np.einsum("kij,i->kj", rotations, gravity) - gravity
        before, plumb, after = turned @ self._compliance(state.q).T
        passive = self.crane.layout.passive
        q = state.q.copy()
        v = state.v.copy()
        q[passive] -= plumb
        v[passive] -= (after - before) / (later - earlier)
        return self.controller(t, State(q, v), setpoint)

    def _compliance(self, q: np.ndarray) -> np.ndarray:
        """Return how far the passive joints hang from their rest on a level base per change of
        gravity in the axes of the base [rad or m, over m/s²], shape (passive, 3), to first order.

        A change Δg of gravity acts on the joints with the generalized forces m Jᵀ Δg, with the mass
        m of the crane and the Jacobian J of its centre of mass. These over the stiffness of the
        rest are the change of the rest.

        Args:
            q: Coordinates of the crane, of which those of the drives count.
        """
        crane = self.crane
        passive = crane.layout.passive
        rest = crane.start.q.copy()
        rest[crane.layout.drives] = q[crane.layout.drives]
        stiffness = rest_stiffness(crane.model, crane.data, crane.springs, rest, crane.coupling)
        jacobian = pin.jacobianCenterOfMass(crane.model, crane.data, rest)
        forces = crane.data.mass[0] * jacobian.T[passive]
        return np.linalg.solve(stiffness[np.ix_(passive, passive)], forces)


def swing_in_world(crane: Crane, controller: Controller, base: BaseMotion) -> SwingInWorld:
    """Return a controller that sees the swing from where the load would hang plumb.

    On a base that tilts, a load at rest in the world swings relative to the crane. A controller of
    the swing that does not know of the tilt moves the drives to where the base is plumb, and so
    shakes the load. This one subtracts from coordinates and rates of the passive joints what the
    tilt alone makes of them.

    Args:
        crane: The crane.
        controller: The controller, made for a base at rest.
        base: Motion of the base, as it is measured.
    """
    return SwingInWorld(crane, controller, base)
