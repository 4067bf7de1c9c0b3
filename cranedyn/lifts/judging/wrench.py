"""Force and moment that pass through the joints of a crane, of many states at once, by the
recursion of its equations of motion (`cranedyn.compiled.plant.rigid_body`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn.compiled.plant import plant, rigid_body
from cranedyn.compiled.plant.rigid_body import ExternalForce, Frame
from cranedyn.dynamics import scalars
from cranedyn.dynamics.bodies import Bodies, bodies_of_crane
from cranedyn.model.crane import Crane


class Wrench(NamedTuple):
    """Force and moment through a joint, from the side of the load to that of the ground, in the
    world.

    Attributes:
        force: [N], shape (rows, 3).
        moment: About `point` [N m], shape (rows, 3).
        point: Origin of the joint's frame [m], shape (rows, 3).
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


@dataclass(frozen=True, eq=False)
class CraneStates:
    """States of a crane in rows, with the force and torque that pass through its joints.

    Attributes:
        tree: Its bodies.
        q: Coordinates [rad or m], shape (rows, n).
        v: Their rates, shape (rows, n).
        frames: Frame of each joint in that of its parent.
        transmitted: Force and torque on the body of each joint, in the frame of the joint.
    """

    tree: Bodies
    q: np.ndarray
    v: np.ndarray
    frames: list[Frame]
    transmitted: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(
        cls,
        crane: Crane,
        q: np.ndarray,
        v: np.ndarray,
        effort: np.ndarray,
        force: np.ndarray | None = None,
        *,
        buffers: bool = False,
    ) -> CraneStates:
        """Return states with the accelerations by efforts, gravity and forces from outside.

        Args:
            crane: The crane, with n joints and m drives.
            q: Coordinates [rad or m], shape (rows, n).
            v: Their rates, shape (rows, n).
            effort: Of the drives [N m or N], shape (rows, m).
            force: From outside on the points of the crane in the world [N], shape (rows, 3 points).
            buffers: Whether buffers end the ranges of the drives.
        """
        topology = plant.Topology.of(crane)
        crane_plant = plant.make_plant(
            topology, plant.plant_numbers(crane).tolist(), "effort", buffers
        )
        # The equations of motion take a column for each joint, of all rows at once.
        positions = scalars.column_objects(q)
        rates = scalars.column_objects(v)
        outside = None if force is None or not np.any(force) else scalars.column_objects(force)
        accelerations = crane_plant.forward_dynamics(
            positions, rates, scalars.column_objects(effort), outside
        )[0]
        # The tree of the plant counts masses that move together with their parents. What passes
        # through a joint is that of the masses beyond it, so that it needs each where it is.
        tree = bodies_of_crane(crane)
        forces: list[ExternalForce] = []
        if outside is not None:
            point_forces = outside.reshape(-1, 3)
            points = zip(topology.bodies, crane_plant.levers, point_forces, strict=True)
            forces = [
                ExternalForce(body, lever, point_force) for body, lever, point_force in points
            ]
        frames = rigid_body.frames(tree, positions)
        transmitted = rigid_body.transmitted(tree, frames, rates, accelerations, forces)
        return cls(tree, q, v, frames, transmitted)

    def through(self, joint: int) -> Wrench:
        """Return the wrench through a joint, by its index among the coordinates."""
        # Transmitted is what the side of the ground does to the body; the reaction is the wrench.
        force_on_body, torque_on_body = self.transmitted[joint]
        force = -self._filled(self._turned(joint, force_on_body))
        moment = -self._filled(self._turned(joint, torque_on_body))
        return Wrench(force, moment, self.origin(joint))

    def through_ground(self) -> Wrench:
        """Return the wrench through the ground, about the world's origin."""
        on_ground = [i for i, parent in enumerate(self.tree.parents) if parent < 0]
        wrenches = [self.through(joint) for joint in on_ground]
        moments = [wrench.moment + np.cross(wrench.point, wrench.force) for wrench in wrenches]
        force = np.sum([wrench.force for wrench in wrenches], axis=0)
        moment = np.sum(moments, axis=0)
        return Wrench(force, moment, np.zeros_like(force))

    def axis(self, joint: int) -> np.ndarray:
        """Return the positive direction of a joint in the world, shape (rows, 3)."""
        # A joint slides along an axis or turns about one; the other of the two is zero.
        along, about = self.tree.axis[joint]
        return self._filled(self._turned(joint, along + about))

    def origin(self, joint: int) -> np.ndarray:
        """Return the origin of a joint's frame in the world [m], shape (rows, 3)."""
        origin = scalars.array([0.0] * 3)
        at_rest = scalars.array([0.0] * len(self.tree))
        motions = rigid_body.point_motions(self.tree, self.frames, at_rest, joint, [origin])
        ((position, _),) = motions
        return self._filled(position)

    def _turned(self, body: int, vector: np.ndarray) -> np.ndarray:
        """Return a vector of the frame of a joint in the world, shape (3,)."""
        for i in reversed(self.tree.path(body)):
            vector = self.frames[i].rotation @ vector
        return vector

    def _filled(self, columns: Iterable[Any]) -> np.ndarray:
        """Return columns, some of which may be one number for all rows, as an array."""
        count = len(self.q)
        filled = [np.broadcast_to(np.asarray(column, dtype=float), count) for column in columns]
        return np.stack(filled, axis=1)
