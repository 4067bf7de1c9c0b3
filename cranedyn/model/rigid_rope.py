"""The same crane on a single rope that neither stretches nor goes slack.

The stretch of a rope oscillates much faster than the load swings, and on two falls the load also
yaws. A controller that plans over seconds needs neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import with_locked_joints


@dataclass(frozen=True, eq=False)
class RigidRope:
    """A crane with the stretch of its rope, or the yaw of its load on two falls, held fixed.

    Attributes:
        crane: The crane without these joints; the full crane itself if it has none of them.
        kept: Index of each coordinate of that crane among those of the full crane.
        left_out: Names of the joints that are held.
    """

    crane: Crane
    kept: tuple[int, ...]
    left_out: tuple[str, ...] = ()


def on_rigid_rope(crane: Crane) -> RigidRope:
    """Hold the stretch of a crane's rope, or the yaw of its load on two falls, where it is at the
    start of the crane.

    At the cable length of the start the load then hangs exactly as low as on the full crane. An
    elastic rope of the length l is stretched by W l/EA by the weight W of the load, so that at
    another length the pendulum of the full crane is longer by W/EA times the difference of the
    lengths: some tenths of a per cent of it at most, since ropes strain so little. The inertia of
    the drum stays, as armature of the hoist.

    The yaw on two falls does not move the centre of mass of the load where that is on the axis of
    the rope, as in the tower crane of this project. What the full crane has beside, is the small
    moment of inertia that yaws freely instead of with the slew.

    Args:
        crane: The full crane.

    Raises:
        ModelError: If the rest is no crane.
    """
    joints = crane.layout.joints
    held: list[int] = []
    if crane.springs.rope is not None:
        held.append(crane.springs.rope.stretch)
    if crane.springs.bifilar is not None:
        held.append(crane.springs.bifilar.yaw)
    kept = np.setdiff1d(np.arange(crane.layout.n), held)
    if not held:
        return RigidRope(crane, tuple(kept.tolist()))
    left_out = tuple(joints[i].name for i in held)
    locked = {joints[i].name: float(crane.start.q[i]) for i in held}
    rigid = with_locked_joints(crane, locked)
    # Masses and damping of a crane may be others than those of its URDF, as those of an identified
    # twin are. Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
    bodies = [i + 1 for i in held]
    rigid = replace(
        rigid,
        model=pin.buildReducedModel(crane.model, bodies, crane.start.q),
        damping=crane.damping[kept],
        start=State(crane.start.q[kept], crane.start.v[kept]),
    )
    return RigidRope(rigid, tuple(kept.tolist()), left_out)
