"""The crane in code: what its drives, gravity, damping, forces from outside and buffers make of a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.compiled.code import Code, Value
from cranedyn.dynamics import rigid_body
from cranedyn.dynamics.drives import buffer_numbers
from cranedyn.dynamics.pinocchio import pivot_position
from cranedyn.dynamics.rigid_body import Bodies, ExternalForce, Frame, array
from cranedyn.model.crane import DRIVES, PASSIVE, Crane

_PIVOT, _LOAD = 2, 4
"""The bodies that outside forces act on: at the swing pivot, and the payload."""


@dataclass(frozen=True, eq=False)
class Plant:
    """A crane whose numbers are known, or loaded by the code.

    Attributes:
        tree: Its bodies.
        damping: Of each joint, shape (5,).
        lower, upper: Ranges, shape (5,).
        effort_limit: Of the drives, shape (3,).
        height: Of the swing pivot above the ground [m], shape (1,).
        spring, damper: Of the buffers at the ends of the ranges of the drives, shape (3,) each.
        drive: Whether commands are efforts, "effort", or accelerations, "motion".
        buffers: Whether there are buffers.
    """

    tree: Bodies
    damping: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    height: np.ndarray
    spring: np.ndarray
    damper: np.ndarray
    drive: str
    buffers: bool

    def answer(self, q: np.ndarray, v: np.ndarray, command: np.ndarray, forces: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """What a command causes at a state, in any unit of time but seconds.

        Args:
            q: Coordinates, shape (5,).
            v: Their rates, shape (5,).
            command: Efforts within the limits, or accelerations, of the drives, shape (3,).
            forces: From outside on payload and trolley in the world [N], shape (6,); None for none.

        Returns:
            Accelerations, shape (5,), and efforts of the drives, shape (3,).
        """
        where = rigid_body.frames(self.tree, q)
        external_forces = (
            []
            if forces is None
            else [ExternalForce(_LOAD, self.tree.lever[_LOAD], forces[:3]), ExternalForce(_PIVOT, array([0.0] * 3), forces[3:])]
        )
        resisting = rigid_body.inverse_dynamics(self.tree, where, v, external_forces=external_forces) + self.damping * v
        if self.buffers:
            resisting[DRIVES] = resisting[DRIVES] - self.stop_effort(q, v)
        mass = rigid_body.mass_matrix(self.tree, where)
        a = array([0.0] * 5)
        if self.drive == "effort":
            a[DRIVES] = command
            return rigid_body.solve(mass, a - resisting), command
        a[DRIVES] = command
        swing = np.ix_(PASSIVE, PASSIVE)
        a[PASSIVE] = rigid_body.solve(mass[swing], -(resisting + mass @ a)[PASSIVE])
        return a, (mass @ a + resisting)[DRIVES]

    def stop_effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Efforts of the buffers on the drives [N m, N, N], shape (3,)."""
        code: Code = q[0].code
        external_forces = []
        for i, spring, damper in zip(DRIVES, self.spring, self.damper, strict=True):
            beyond = q[i] - code.clipped(q[i], self.lower[i], self.upper[i])
            push = -(spring * beyond) - damper * v[i]
            external_forces.append(code.chosen(push * beyond < 0.0, push, 0.0))
        return array(external_forces)

    def stop_force(self, q: np.ndarray, v: np.ndarray) -> Any:
        """What the buffers at the ends of the cable push [N], see `cranedyn.dynamics.drives.Outside.held`."""
        return self.stop_effort(q, v)[2] if self.buffers else 0.0

    def beyond(self, q: np.ndarray) -> Any:
        """Whether a drive is beyond its range."""
        code: Code = q[0].code
        sides = [side for i in DRIVES for side in (q[i] < self.lower[i], q[i] > self.upper[i])]
        return code.either(*sides)

    def holds(self, q: np.ndarray, v: np.ndarray, hoist: Any) -> Any:
        """Whether the model holds at a state under a force of the hoist and of the buffers of the cable, see `dynamics.validity`."""
        code: Code = q[0].code
        conditions = [self.damping[4] * v[4] - hoist > 0.0, self.height[0] - q[4] * (np.cos(q[2]) * np.cos(q[3])) >= 0.0]
        for i, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if i in PASSIVE:
                conditions += [code.call("llvm.fabs", q[i]) <= np.pi / 2.0]
            if i in PASSIVE or not self.buffers:
                conditions += [q[i] >= low, q[i] <= high]
        return code.both(*conditions)

    def within(self, command: np.ndarray) -> np.ndarray:
        """Efforts cut to the limits of the drives, accelerations as they are, shape (3,)."""
        if self.drive != "effort":
            return command
        code: Code = command[0].code
        return array([code.clipped(c, -limit, limit) for c, limit in zip(command, self.effort_limit, strict=True)])

    def energy(self, q: np.ndarray, v: np.ndarray) -> Value:
        """Mechanical energy [J], zero of height at the ground."""
        where: list[Frame] = rigid_body.frames(self.tree, q)
        return 0.5 * (v @ (rigid_body.mass_matrix(self.tree, where) @ v)) + rigid_body.potential_energy(self.tree, where)


def numbers(crane: Crane) -> np.ndarray:
    """All numbers of a crane in a row, as `plant` takes them."""
    tree = rigid_body.bodies(crane.model)
    height = pivot_position(crane, crane.start.q)[2:]
    return np.concatenate([tree.numbers(), crane.damping, crane.lower, crane.upper, crane.effort_limit, height, *buffer_numbers(crane)])


def plant(parents: Sequence[int], values: Sequence[Any], drive: str, buffers: bool) -> Plant:
    """A plant from the chain of its joints and its numbers, in the order of `numbers`."""
    tree = rigid_body.blank(parents)
    count = len(tree.numbers())
    damping, lower, upper, effort_limit, height, spring, damper = np.split(array(values[count:]), np.cumsum([5, 5, 5, 3, 1, 3]))
    return Plant(tree.with_numbers(values[:count]), damping, lower, upper, effort_limit, height, spring, damper, drive, buffers)
