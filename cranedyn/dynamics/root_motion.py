"""Motion of the frame in which a crane stands, and the generalized forces that it causes.

A crane on a ship, a barge or a truck stands in a frame that moves. Its coordinates q and rates v
are those relative to this frame, so that layout, drives and joint forces stay as they are. What
changes is the bias of the equation of motion. In the recursive Newton-Euler algorithm the motion of
the root comes in at the first joint and nowhere else:

    M(q) a + b(q, v; ω, α, c) = τ,

with the angular velocity ω of the frame, its angular acceleration α, and c = R⁻¹ (r̈ - g), the
acceleration of its origin r less gravity g, all in the axes of the frame, whose attitude is R. The
mass matrix does not depend on them. The velocity of the origin does not occur, since the laws of
mechanics are the same in all frames that move steadily (Galilei). In a frame at rest, ω = α = 0 and
c = -g. The difference of both biases is a generalized force,

    τ_root(q, v) = b(q, v; 0, 0, -g) - b(q, v; ω, α, c),

which is added to the forces of a standing crane: the sum of centrifugal, Coriolis, Euler and
translational inertial forces, and of gravity turned into the frame. It is exact for any crane, and
for every kind of drive.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), §5.3 and §9.3 (floating bases).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

ROOT_NUMBERS = 9
"""How many numbers describe the motion of the root, see `RootMotion.of`."""

SAMPLES_PER_STEP = 2
"""The motion of the root is known at the beginning, the middle and the end of each physics step,
where the stages of the stepping rules lie; that is every half step."""


class RootMotion(NamedTuple):
    """Motion of the frame in which a crane stands, in the axes of this frame.

    Attributes:
        omega: Angular velocity [rad/s], shape (3,).
        alpha: Angular acceleration [rad/s²], shape (3,).
        acceleration: Acceleration of the origin less gravity [m/s²], shape (3,).
    """

    omega: np.ndarray
    alpha: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def of(cls, numbers: np.ndarray) -> RootMotion:
        """Return the motion whose components stand one after another, shape (9,)."""
        return cls(numbers[:3], numbers[3:6], numbers[6:])

    def in_steps(self, dt: Any) -> RootMotion:
        """Return the same with time in units of `dt` [s]."""
        squared = dt * dt
        return RootMotion(self.omega * dt, self.alpha * squared, self.acceleration * squared)


def interpolated_root(samples: np.ndarray, phase: Any) -> RootMotion:
    """Return the motion of the root within a physics step.

    It lies on the parabola through the samples at the beginning, in the middle and at the end of
    the step. Where the stages of semi-implicit Euler and of the classical rule of Runge and Kutta
    lie, that is the sample itself.

    Args:
        samples: The three samples, of any kind of number, shape (3, 9).
        phase: Elapsed share of the step, 0 to 1; of any kind of number.
    """
    weights = (
        (1.0 - phase) * (1.0 - 2.0 * phase),
        4.0 * phase * (1.0 - phase),
        phase * (2.0 * phase - 1.0),
    )
    for weight, sample in zip(weights, samples, strict=True):
        # The usual case: the stage is at a sample, and the other weights are 0.
        if isinstance(weight, float) and weight == 1.0:
            return RootMotion.of(sample)
    numbers: Any = 0.0
    for weight, sample in zip(weights, samples, strict=True):
        numbers = numbers + sample * weight
    return RootMotion.of(numbers)


class RootForces:
    """Generalized forces on the joints of a crane from the motion of the frame in which it stands.

    Pinocchio's recursive Newton-Euler algorithm lets the root accelerate, but not turn. So the
    crane hangs from a joint with six degrees of freedom here, whose motion is given.

    Attributes:
        motion: The motion of the frame now.
    """

    motion: RootMotion

    def __init__(self, model: pin.Model) -> None:
        """Begin in a frame at rest.

        Args:
            model: Pinocchio's model of the standing crane.
        """
        self._model = model
        self._data = model.createData()
        self._floating_model = floating_model(model)
        self._floating_data = self._floating_model.createData()
        no_rotation = np.zeros(3)
        self.motion = RootMotion(no_rotation, no_rotation, -model.gravity.linear)
        self._no_acceleration = np.zeros(model.nv)
        # Position and quaternion of the frame in itself, then the coordinates.
        self._q = np.concatenate([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], np.zeros(model.nq)])
        self._v = np.zeros(6 + model.nv)
        self._a = np.zeros(6 + model.nv)

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the generalized forces at coordinates q and rates v [N m or N], shape (n,)."""
        self._q[7:] = q
        self._v[6:] = v
        # The velocity of the origin is taken as zero, see the module. Then Pinocchio's spatial
        # acceleration of the origin, which lacks ω × velocity, is the acceleration itself.
        self._v[3:6] = self.motion.omega
        self._a[:3] = self.motion.acceleration
        self._a[3:6] = self.motion.alpha
        moving = pin.rnea(self._floating_model, self._floating_data, self._q, self._v, self._a)
        standing = pin.rnea(self._model, self._data, q, v, self._no_acceleration)
        return standing - moving[6:]


def floating_model(model: pin.Model) -> pin.Model:
    """Return a crane whose root is a body without mass and with six degrees of freedom, in no
    gravity: gravity is part of the acceleration of the root, see `RootMotion`.
    """
    root = pin.Model()
    joint = root.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    frame = root.addFrame(pin.Frame("root", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    floating = pin.appendModel(root, model, frame, pin.SE3.Identity())
    floating.gravity = pin.Motion.Zero()
    # Pinocchio's inertia of rotors is kept by `appendModel`; the joints keep their order.
    assert list(floating.names)[2:] == list(model.names)[1:]
    return floating
