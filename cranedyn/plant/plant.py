"""A crane in any kind of number: what drives, gravity, joint forces, forces from outside and
buffers make of a state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import read_only
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.bodies import Bodies, blank, bodies, height, numeric_bodies
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.converters import Response, saturate_acceleration
from cranedyn.dynamics.joint_forces import JointForces, Stops, tension_from_hoist_force
from cranedyn.dynamics.scalars import array, chosen, clipped, flag, solve_linear
from cranedyn.dynamics.validity import bounds
from cranedyn.model.crane import Crane, once_per_crane
from cranedyn.model.friction import DryFriction
from cranedyn.model.layout import Layout
from cranedyn.model.mimics import Coupling
from cranedyn.model.springs import Bifilar, Rope, Springs
from cranedyn.plant import rigid_body
from cranedyn.plant.rigid_body import ExternalForce

_NO_LIMIT = 1e9
"""Stands for no limit of a rate: whatever is faster has diverged."""


@dataclass(frozen=True)
class Topology:
    """What cranes have in common that differ in numbers only.

    Attributes:
        parents: Place of the joint before each joint among the coordinates, -1 for the world.
        layout: The joints by name.
        bodies: The joints that carry the points that forces act on.
        swings: The joints that are swings, and whether the hoist hangs on each.
        springs: Whether anything is elastic.
        rope: Stretch and length of a rope that may go slack, and whether it is inextensible; None
            if there is none.
        bifilar: Yaw and length of two falls; None for a single line.
        friction: The joints that have dry friction.
        coupling: Joints that follow others; None if there are none.
    """

    parents: tuple[int, ...]
    layout: Layout
    bodies: tuple[int, ...]
    swings: tuple[tuple[int, bool], ...]
    springs: bool
    rope: tuple[int, int, bool] | None
    bifilar: tuple[int, int] | None
    friction: tuple[int, ...]
    coupling: Coupling | None

    @staticmethod
    @once_per_crane
    def of(crane: Crane) -> Topology:
        """Return the topology of a crane."""
        parents = tuple(int(parent) - 1 for parent in list(crane.model.parents)[1:])
        hoist = crane.layout.role("hoist", "") if crane.layout.has("hoist") else None
        above = [] if hoist is None else numeric_bodies(crane).path(hoist)[:-1]
        swings = tuple((i, i in above) for i in crane.swings.tolist())
        rope, falls = crane.springs.rope, crane.springs.bifilar
        bodies = tuple(point.body for point in crane.points)
        return Topology(
            parents,
            crane.layout,
            bodies,
            swings,
            crane.springs.any,
            None if rope is None else (rope.stretch, rope.length, rope.inextensible),
            None if falls is None else (falls.yaw, falls.length),
            () if crane.friction is None else crane.friction.joints,
            crane.coupling,
        )


class Units(NamedTuple):
    """What is what for a plant that counts time and mass in units of its own.

    Attributes:
        time: Its unit of time [s].
        command: How much it has of a unit of a command.
        force: How much it has of a newton, from outside or of a drive.
        work: What its unit of work is [J].
    """

    time: Any
    command: Any
    force: Any
    work: Any


SI = Units(1.0, 1.0, 1.0, 1.0)
"""Seconds and kilograms."""


class Answer(NamedTuple):
    """Answer of a crane to a command: accelerations, shape (n,), efforts of the drives and efforts
    needed to follow the command, shape (m,), and a force that is positive where a rope that may go
    slack pulls, None for any other.
    """

    acceleration: np.ndarray
    effort: np.ndarray
    needed: np.ndarray
    pull: Any


@dataclass(frozen=True, eq=False)
class Plant:
    """A crane with n joints and m drives whose numbers are known, or stand for what is not known
    yet.

    Attributes:
        topology: What it has in common with others.
        tree: Its bodies.
        joint: Damping, dry friction and springs.
        stops: Buffers at the ends of the ranges of the drives.
        lower, upper: Ranges, shape (n,).
        effort_limit, rate_limit: Of the drives, shape (m,).
        levers: Where the points are in the frames of their joints [m], shape (points, 3).
        arms: From each swing joint to the payload, but for the cable [m], shape (swings,).
        rest: Where the swing joints hang, see `cranedyn.model.springs.Rest`: angle and slope.
        drive: Whether commands are efforts, "effort", accelerations, "motion", or reference rates,
            "velocity".
        buffers: Whether there are buffers.
        response: Of the drives' frequency converters; None if there are none.
        contacts: Of the load with the ground; None for none.
    """

    topology: Topology
    tree: Bodies
    joint: JointForces
    stops: Stops
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    rate_limit: np.ndarray
    levers: np.ndarray
    arms: np.ndarray
    rest: tuple[np.ndarray, np.ndarray]
    drive: str
    buffers: bool
    response: Response | None = None
    contacts: Contacts | None = None

    def in_steps(self, dt: Any) -> tuple[Plant, Units]:
        """Return the same with time in units of `dt` [s] and mass in units of the load, unless that
        is counted with another body: rates are v dt, accelerations a dt², and step and load drop
        out of much arithmetic.

        Returns:
            The plant, and its units.
        """
        load = self.tree.mass[self.topology.bodies[0]]
        mass = 1.0 if isinstance(load, float) and load == 0.0 else load
        force = dt * dt / mass
        response = self.response
        contacts = self.contacts
        scaled = replace(
            self,
            tree=self.tree.in_steps(dt, mass),
            joint=self.joint.in_steps(dt, mass),
            stops=self.stops.in_steps(dt, mass),
            effort_limit=self.effort_limit * force,
            response=None if response is None else response._replace(lags=response.lags / dt),
            contacts=None if contacts is None else contacts.in_steps(dt, mass),
        )
        commands = {"effort": force, "motion": dt * dt, "velocity": dt}
        return scaled, Units(dt, commands[self.drive], force, 1.0 / force)

    def answer(
        self,
        q: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
        forces: np.ndarray | None,
        reactions: Sequence[ExternalForce] = (),
    ) -> Answer:
        """Return the answer to a command at a state.

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            command: Efforts within the limits, accelerations, or reference rates of the drives,
                shape (m,).
            forces: From outside on the points in the world [N], shape (3 points,); None for none.
            reactions: Those of the ground, see `ground_reactions`.
        """
        drives = self.topology.layout.drives
        rope = self.joint.rope
        frames = rigid_body.frames(self.tree, q)
        pushes: Any = [] if forces is None else forces.reshape(-1, 3)
        acting = zip(self.topology.bodies, self.levers, pushes, strict=forces is not None)
        external = [*map(ExternalForce._make, acting), *reactions]
        effort = self.joint.effort(q, v)
        if self.buffers:
            effort[drives] = effort[drives] + self.stops.effort(q, v)
        pull = None if rope is None or rope.inextensible else self.joint.pull(q, v)
        coupling = self.topology.coupling
        direct = coupling is None and (rope is None or not rope.inextensible)
        if self.drive == "effort" and direct:
            effort[drives] = effort[drives] + command
            a = rigid_body.tree_forward_dynamics(self.tree, frames, v, effort, external)
            return Answer(a, command, command, pull)
        resisting = rigid_body.tree_inverse_dynamics(self.tree, frames, v, external_forces=external)
        resisting = resisting - effort
        mass = rigid_body.mass_matrix(self.tree, frames)
        if coupling is not None:
            a, exerted, needed = self._solved(
                coupling.reduce(mass), coupling.gather(resisting), v, command
            )
            return Answer(coupling.spread(a), exerted, needed, pull)
        if rope is None or not rope.inextensible:
            return Answer(*self._solved(mass, resisting, v, command), pull)
        return self._on_inextensible_rope(rope.stretch, mass, resisting, q, v, command)

    def _on_inextensible_rope(
        self,
        stretch: int,
        mass: np.ndarray,
        resisting: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
    ) -> Answer:
        """Return `answer` for a rope that holds its stretch where it is taut."""
        taut = self.joint.taut
        pull = None
        if taut is None or isinstance(taut, bool):
            still = self._solved(mass, resisting, v, command, stretch)
            pull = -(mass[stretch] @ still[0] + resisting[stretch])
            if taut:
                return Answer(*still, pull)
            # a rope that is slack already, or goes slack at this instant, does not pull
            pull = chosen(q[stretch] < 0.0, -1.0, chosen(v[stretch] < 0.0, -1.0, pull))
            taut = pull > 0.0
        held = mass.copy()
        pushed = resisting.copy()
        loose = 1.0 - flag(taut, resisting[stretch])
        for i in np.delete(np.arange(len(q)), stretch):
            held[stretch, i] = held[i, stretch] = mass[stretch, i] * loose
        pushed[stretch] = resisting[stretch] * loose
        a, effort, needed = self._solved(held, pushed, v, command)
        tension = -(mass[stretch] @ a + resisting[stretch])
        return Answer(a, effort, needed, tension if pull is None else pull)

    def _solved(
        self,
        mass: np.ndarray,
        resisting: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
        still: int | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return accelerations, efforts and the efforts needed, of all joints or of all but one
        that stands still.
        """
        drives = self.topology.layout.drives
        free = self._answering(still)
        if self.response is not None:
            target = array(self.response.accelerations_at(command, v[drives]))
            return saturate_acceleration(mass, resisting, target, self.effort_limit, drives, free)
        a = array([0.0] * len(v))
        if self.drive == "effort":
            resisting = resisting.copy()
            resisting[drives] = resisting[drives] - command
        else:
            a[drives] = command
        a[free] = solve_linear(mass[np.ix_(free, free)], -(resisting + mass @ a)[free])
        effort = command if self.drive == "effort" else (mass @ a + resisting)[drives]
        return a, effort, effort

    def _answering(self, still: int | None = None) -> np.ndarray:
        """Return the joints whose motion is not prescribed, by their indices, but for one that
        stands still.
        """
        layout = self.topology.layout
        joints = layout.independent if self.drive == "effort" else layout.passive
        return joints if still is None else joints[joints != still]

    def impact(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, Any]:
        """Return rates and the kinetic energy gained as `cranedyn.dynamics.drives` does where an
        inextensible rope becomes taut.
        """
        assert self.joint.rope is not None
        stretch = self.joint.rope.stretch
        mass = rigid_body.mass_matrix(self.tree, rigid_body.frames(self.tree, q))
        free = self._answering(stretch)
        change = array([0.0] * len(v))
        change[stretch] = -v[stretch]
        change[free] = solve_linear(mass[np.ix_(free, free)], -(mass @ change)[free])
        after = v + change
        after[stretch] = 0.0
        return after, change @ (mass @ (v + 0.5 * change))

    def ground_reactions(
        self, q: np.ndarray, v: np.ndarray, anchors: np.ndarray
    ) -> tuple[list[ExternalForce], np.ndarray]:
        """Return forces of the ground on the load, and the anchors after that, shape (3 points,).

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            anchors: Where the points of the load came to rest [m], shape (3 points,).
        """
        contacts = self.contacts
        reactions = list[ExternalForce]()
        moved = list[Any]()
        if contacts is None:
            return reactions, anchors
        rows = zip(contacts.points, self._ground_motions(q, v), anchors.reshape(-1, 3), strict=True)
        for point, motion, anchor in rows:
            force, place = contacts.reaction(*motion, anchor)
            reactions.append(ExternalForce(contacts.body, array(point), array(force)))
            moved += place
        return reactions, array(moved)

    def power(self, q: np.ndarray, v: np.ndarray, reactions: Sequence[ExternalForce]) -> Any:
        """Return the power of the forces of `ground_reactions` at coordinates and rates [W]."""
        pairs = zip(self._ground_motions(q, v), reactions, strict=True)
        return sum((velocity @ push.force for (_, velocity), push in pairs), 0.0)

    def touching(self, q: np.ndarray) -> list[Any]:
        """Return whether each point of the load is in a support; empty without ground."""
        contacts = self.contacts
        still = array([0.0] * len(q))
        if contacts is None:
            return []
        return [contacts.depth(place)[0] > 0.0 for place, _ in self._ground_motions(q, still)]

    def _ground_motions(self, q: np.ndarray, v: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return position and velocity of each point of the load that may touch the ground."""
        assert self.contacts is not None
        points = [array(p) for p in self.contacts.points]
        frames = rigid_body.frames(self.tree, q)
        return rigid_body.point_motions(self.tree, frames, v, self.contacts.body, points)

    def drag(self, q: np.ndarray, v: np.ndarray, air: np.ndarray, areas: Any) -> np.ndarray:
        """Return the drag of air on the points [N], shape (3 points,), see
        `cranedyn.disturbances.wind.drag_force`.

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            air: Velocity of the air at each point in the world [m/s], shape (3 points,).
            areas: Drag coefficient times area of each point [m²], shape (points,).
        """
        poses = rigid_body.frames(self.tree, q)
        forces = []
        points = zip(areas, air.reshape(-1, 3), self.topology.bodies, self.levers, strict=True)
        for area, wind, body, lever in points:
            ((_, velocity),) = rigid_body.point_motions(self.tree, poses, v, body, [lever])
            forces.append(drag_force(area, wind - velocity))
        return np.concatenate(forces)

    def stop_force(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return the force of the buffers at the ends of the cable [N], see
        `cranedyn.dynamics.drives.cable_buffers`.
        """
        hoist = self.topology.layout.drive_of("hoist")
        if hoist is None or not self.buffers:
            return 0.0
        joint = self.stops.drives[hoist]
        return self.stops.effort_of(hoist, q[joint], v[joint])

    def conditions(
        self, q: np.ndarray, v: np.ndarray, hoist_force: Any, needed: np.ndarray
    ) -> list[Any]:
        """Return comparisons that must be true for the model to hold, given the force of the hoist
        with that of the cable's buffers, and the efforts needed by drives that follow a motion or a
        rate.
        """
        layout = self.topology.layout
        tension = tension_from_hoist_force(layout, self.joint, q, v, hoist_force)
        above = height(self.tree, q, self.topology.bodies[0], self.levers[0])
        state_bounds = bounds(
            layout,
            self,
            q,
            v,
            self.swing_angles(q),
            tension,
            above,
            buffers=self.buffers,
            needed=None if self.drive == "effort" else needed,
            rates=self.drive != "velocity",
            rope=self.topology.rope,
            level=0.0 if self.contacts is None else self.contacts.level,
        )
        return [condition for bound in state_bounds for condition in bound.conditions]

    def within(self, command: np.ndarray) -> np.ndarray:
        """Return efforts cut to the limits of the drives, accelerations as they are, shape (m,)."""
        if self.drive != "effort":
            return command
        return array(
            [clipped(c, -limit, limit) for c, limit in zip(command, self.effort_limit, strict=True)]
        )

    def energy(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return the mechanical energy with that of springs [J], zero of height at the ground."""
        frames = rigid_body.frames(self.tree, q)
        rigid = 0.5 * (v @ (rigid_body.mass_matrix(self.tree, frames) @ v))
        rigid = rigid + rigid_body.potential_energy(self.tree, frames)
        return rigid if self.joint.springs is None else rigid + self.joint.springs.energy(q)

    @property
    def plumb_at_zero(self) -> bool:
        """Whether the load hangs plumb where the swing joints are at zero."""
        return not any(np.any(term) for term in self.rest)

    def hanging_angles(self, drives: np.ndarray) -> np.ndarray:
        """Return where the swing joints hang for coordinates of the drives, to first order about
        the start [rad], shape (swings,).
        """
        angle, slope = self.rest
        return angle + slope @ drives

    def swing_angles(self, q: np.ndarray) -> dict[int, Any]:
        """Return angles of the swing joints from where they hang [rad], by their place among the
        coordinates.
        """
        hanging = self.hanging_angles(q[self.topology.layout.drives])
        return {
            i: q[i] - rest_angle
            for (i, _), rest_angle in zip(self.topology.swings, hanging, strict=True)
        }

    def swing(self, q: np.ndarray, v: np.ndarray) -> tuple[Any, Any]:
        """Return the square of the swing, and that of its amplitude if the pendulums below each
        joint swung alone [rad²].
        """
        swings = self.topology.swings
        angle: Any = sum(
            (component * component for component in self.swing_angles(q).values()), 0.0
        )
        gravity = -self.tree.gravity[2]
        kinetic: Any = 0.0
        for (i, hangs), arm in zip(swings, self.arms, strict=True):
            length = arm + q[self.topology.layout.role("hoist", "The cable")] if hangs else arm
            kinetic = kinetic + v[i] * v[i] * length
        return angle, angle + kinetic / gravity


@once_per_crane
def numbers(crane: Crane) -> np.ndarray:
    """Return all numbers of a crane in a row, in the order of `plant`, read-only."""
    tree = bodies(crane.model)
    springs = crane.springs
    stops = Stops.of(crane)
    rope, falls = springs.rope, springs.bifilar
    levers = np.concatenate([point.lever for point in crane.points])
    values = (
        tree.numbers(),
        crane.damping,
        [] if crane.friction is None else crane.friction.effort,
        [] if crane.friction is None else crane.friction.width,
        springs.stiffness,
        springs.rest,
        [0.0 if rope is None else rope.stiffness],
        [] if falls is None else [falls.stiffness],
        crane.lower,
        crane.upper,
        crane.effort_limit,
        np.minimum(crane.rate_limit, _NO_LIMIT),
        levers,
        _arms(crane),
        crane.rest.angle,
        crane.rest.slope.ravel(),
        stops.stiffness,
        stops.damping,
    )
    return read_only(np.concatenate(values))


def _arms(crane: Crane) -> np.ndarray:
    """Return the distance from each swing joint to the payload with all joints below it at zero
    [m], shape (swings,).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, np.zeros(crane.layout.n))
    payload = data.oMi[crane.payload.body + 1].act(crane.payload.lever)
    pivots = [data.oMi[swing + 1].translation for swing in crane.swings.tolist()]
    return np.array([float(np.linalg.norm(payload - pivot)) for pivot in pivots])


def plant(topology: Topology, values: Sequence[Any], drive: str, buffers: bool) -> Plant:
    """Return a plant from its topology and its numbers, in the order of `numbers`; with drive
    "velocity" those of the frequency converters follow.
    """
    layout = topology.layout
    n, m = layout.n, layout.m
    response = None
    if drive == "velocity":
        count = m * len(Response._fields)
        response = Response(*np.split(array(values[-count:]), len(Response._fields)))
        values = values[:-count]
    tree = blank(topology.parents)
    count = len(tree.numbers())
    swings = len(topology.swings)
    falls = topology.bifilar and Bifilar(*topology.bifilar, 0.0)
    rubbing = len(topology.friction)
    joint_counts = [n, rubbing, rubbing, n, n, 1, int(falls is not None), n, n, m, m]
    counts = [*joint_counts, 3 * len(topology.bodies), swings, swings, swings * m, m, m]
    groups = np.split(array(values[count:]), np.cumsum(counts)[:-1])
    damping, dry, width, stiffness, rest, ea, yaw_stiffness, lower, upper, *groups = groups
    effort_limit, rate_limit, levers, arms, rest_angle, rest_slope, *stop_gains = groups
    rope = None
    if topology.rope is not None:
        stretch, length, inextensible = topology.rope
        rope = Rope(stretch, length, ea[0], inextensible)
    falls = falls and falls._replace(stiffness=yaw_stiffness[0])
    springs = Springs(stiffness, rest, rope, falls) if topology.springs else None
    friction = DryFriction(topology.friction, dry, width) if topology.friction else None
    stops = Stops(layout.drives, lower[layout.drives], upper[layout.drives], *stop_gains)
    return Plant(
        topology,
        rigid_body.regrouped(tree.with_numbers(values[:count])),
        JointForces(damping, springs, friction),
        stops,
        lower,
        upper,
        effort_limit,
        rate_limit,
        levers.reshape(-1, 3),
        arms,
        (rest_angle, rest_slope.reshape(swings, m)),
        drive,
        buffers,
        response,
    )
