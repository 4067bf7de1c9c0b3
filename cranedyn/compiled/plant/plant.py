"""A crane in any kind of number: the accelerations that drives, gravity, joint forces, external
forces and buffers cause at a state.

A `Plant` is made of a `Topology`, which says what there is, and of a row of numbers.
`plant_numbers` takes that row from a crane, and `make_plant` puts both together. The row may hold
floats, symbols or values of a program under construction, see `cranedyn.dynamics.scalars`. The
order of operations in this module is that of the generated code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import read_only
from cranedyn.compiled.plant import rigid_body
from cranedyn.compiled.plant.forward_dynamics import tree_forward_dynamics
from cranedyn.compiled.plant.rigid_body import ExternalForce
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.bodies import Bodies, blank, bodies_of_crane, bodies_of_model, height
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.converters import DrivenMotion, Response, saturate_acceleration
from cranedyn.dynamics.joint_forces import JointForces, Stops, rope_tension
from cranedyn.dynamics.root_motion import RootMotion
from cranedyn.dynamics.scalars import array, clipped, indicator, solve_linear, where
from cranedyn.dynamics.validity import bounds
from cranedyn.model.crane import Crane, once_per_crane
from cranedyn.model.friction import DryFriction
from cranedyn.model.layout import Layout
from cranedyn.model.mimics import Coupling
from cranedyn.model.springs import Bifilar, Rope, Springs

_NO_RATE_LIMIT = 1e9
"""Limit of a rate where a joint has none [rad/s or m/s]: a drive that is faster has diverged."""


@dataclass(frozen=True)
class Topology:
    """What cranes have in common that differ in numbers only. Joints are given by their indices
    among the coordinates.

    Attributes:
        parents: The joint before each joint, -1 for the world.
        layout: The joints by name.
        bodies: The joints that carry the points on which forces act, that of the payload first.
        swings: The joints that are swings, each with whether it carries the hoist, so that the
            length of its pendulum changes with the cable.
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
        # Joint 0 of Pinocchio is the world.
        parents = tuple(int(parent) - 1 for parent in list(crane.model.parents)[1:])
        above_hoist: list[int] = []
        if crane.layout.has("hoist"):
            hoist = crane.layout.role("hoist", "")
            above_hoist = bodies_of_crane(crane).path(hoist)[:-1]
        rope = crane.springs.rope
        falls = crane.springs.bifilar
        return Topology(
            parents=parents,
            layout=crane.layout,
            bodies=tuple(point.body for point in crane.points),
            swings=tuple((swing, swing in above_hoist) for swing in crane.swings.tolist()),
            springs=crane.springs.any,
            rope=None if rope is None else (rope.stretch, rope.length, rope.inextensible),
            bifilar=None if falls is None else (falls.yaw, falls.length),
            friction=() if crane.friction is None else crane.friction.joints,
            coupling=crane.coupling,
        )


class Units(NamedTuple):
    """Units of a plant that counts time and mass in units of its own.

    Attributes:
        time: Unit of time [s].
        command: Factor from a command in SI units to that of the plant.
        force: Factor from a force in newtons, external or of a drive, to that of the plant.
        work: Unit of work [J].
    """

    time: Any
    command: Any
    force: Any
    work: Any


SI = Units(1.0, 1.0, 1.0, 1.0)
"""Seconds and kilograms."""


class DynamicsResult(NamedTuple):
    """Accelerations and efforts of a crane under a command.

    Attributes:
        acceleration: Accelerations of all joints, shape (n,).
        effort: Efforts of the drives, shape (m,).
        needed: Efforts that the drives would need to follow the command, shape (m,).
        pull: Force that is positive where a rope that may go slack pulls; None for any other rope.
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
        topology: What it has in common with cranes of other numbers.
        tree: Its bodies.
        joint: Damping, dry friction and springs.
        stops: Buffers at the ends of the ranges of the drives.
        lower: Lower ends of the ranges of the joints [rad or m], shape (n,).
        upper: Upper ends of the ranges of the joints [rad or m], shape (n,).
        effort_limit: Largest efforts of the drives [N m or N], shape (m,).
        rate_limit: Largest rates of the drives [rad/s or m/s], shape (m,).
        levers: Places of the points in the frames of their joints [m], shape (points, 3).
        arms: Distance from each swing joint to the payload without the cable [m], shape (swings,).
        rest_angle: Angles at which the swing joints hang with all drives at zero [rad], shape
            (swings,), see `cranedyn.model.springs.Rest`.
        rest_slope: Their derivatives by the coordinates of the drives, shape (swings, m).
        drive: Kind of the commands: efforts, "effort", accelerations, "motion", or reference rates,
            "velocity".
        buffers: Whether buffers act at the ends of the ranges.
        response: Response of the drives' frequency converters; None if there are none.
        contacts: Contacts of the load with the ground; None for none.
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
    rest_angle: np.ndarray
    rest_slope: np.ndarray
    drive: str
    buffers: bool
    response: Response | None = None
    contacts: Contacts | None = None

    def in_steps(self, dt: Any) -> tuple[Plant, Units]:
        """Return the same with time in units of `dt` [s] and mass in units of the load.

        Rates are then v dt and accelerations a dt², and step and load are 1, so that they drop out
        of much arithmetic. The unit of mass stays 1 kg where the mass of the load is counted with
        another body, see `rigid_body.regrouped`.

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

    def forward_dynamics(
        self,
        q: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
        forces: np.ndarray | None,
        reactions: Sequence[ExternalForce] = (),
        root: RootMotion | None = None,
    ) -> DynamicsResult:
        """Return the accelerations and efforts that a command causes at a state.

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            command: Efforts within the limits, accelerations, or reference rates of the drives,
                shape (m,).
            forces: External forces on the points in the axes in which the crane stands [N], shape
                (3 points,); None for none.
            reactions: Forces of the ground, see `ground_reactions`.
            root: Motion of the base on which the crane stands; None for one at rest.
        """
        drives = self.topology.layout.drives
        rope = self.joint.rope
        frames = rigid_body.frames(self.tree, q)
        external = [*self._forces_on_points(forces), *reactions]
        effort = self.joint.effort(q, v)
        if self.buffers:
            effort[drives] = effort[drives] + self.stops.effort(q, v)
        pull = None if rope is None or rope.inextensible else self.joint.pull(q, v)
        coupling = self.topology.coupling
        rope_is_constraint = rope is not None and rope.inextensible
        if self.drive == "effort" and coupling is None and not rope_is_constraint:
            # All joints are free: the equation of motion is solved as a whole.
            effort[drives] = effort[drives] + command
            a = tree_forward_dynamics(self.tree, frames, v, effort, external, root)
            return DynamicsResult(a, command, command, pull)
        resisting = rigid_body.tree_inverse_dynamics(
            self.tree, frames, v, external_forces=external, root=root
        )
        resisting = resisting - effort
        mass = rigid_body.mass_matrix(self.tree, frames)
        if coupling is not None:
            # Joints that follow others are replaced by these, see `Coupling`.
            reduced_mass = coupling.reduce(mass)
            gathered = coupling.gather(resisting)
            motion = self._solved(reduced_mass, gathered, v, command)
            a = coupling.spread(motion.acceleration)
            return DynamicsResult(a, motion.effort, motion.needed, pull)
        if rope is None or not rope.inextensible:
            motion = self._solved(mass, resisting, v, command)
            return DynamicsResult(motion.acceleration, motion.effort, motion.needed, pull)
        return self._on_inextensible_rope(rope.stretch, mass, resisting, q, v, command)

    def _forces_on_points(self, forces: np.ndarray | None) -> list[ExternalForce]:
        """Return the external forces on the points, from their numbers, shape (3 points,)."""
        if forces is None:
            return []
        external = []
        vectors = forces.reshape(-1, 3)
        for body, lever, force in zip(self.topology.bodies, self.levers, vectors, strict=True):
            external.append(ExternalForce(body, lever, force))
        return external

    def _on_inextensible_rope(
        self,
        stretch: int,
        mass: np.ndarray,
        resisting: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
    ) -> DynamicsResult:
        """Return what `forward_dynamics` does for an inextensible rope, which holds its stretch
        where it is taut.

        A taut rope is a constraint: the stretch s does not accelerate, and the tension is the force
        that this takes, T = -(M a + b)_s, with the row s of the equation of motion. The rope stays
        taut while T > 0. A slack rope does not act on its stretch.

        `JointForces.taut` gives the phase, or leaves it to the state with None:

        * True: the equations of a taut rope are solved.
        * False or None: also those, for the tension that a taut rope would have. Where it is not
          positive, or the rope is slack by its state, the rope is slack.
        * a condition, which may differ from lane to lane of code: the phase is known.

        In the last two cases one system of equations serves both phases. Where the rope is taut,
        the row and the column of the stretch are set to zero, but for the diagonal, so that the
        stretch has no acceleration.

        Args:
            stretch: The joint of the stretch.
            mass: Mass matrix, shape (n, n).
            resisting: Generalized forces without acceleration, shape (n,).
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            command: As for `forward_dynamics`.
        """
        taut = self.joint.taut
        pull = None
        if taut is None or isinstance(taut, bool):
            held = self._solved(mass, resisting, v, command, stretch)
            pull = -(mass[stretch] @ held.acceleration + resisting[stretch])
            if taut:
                return DynamicsResult(held.acceleration, held.effort, held.needed, pull)
            # A rope that is slack already, or goes slack at this instant, does not pull: any
            # negative number says so.
            pull = where(q[stretch] < 0.0, -1.0, where(v[stretch] < 0.0, -1.0, pull))
            taut = pull > 0.0
        masked_mass = mass.copy()
        masked_resisting = resisting.copy()
        is_slack = 1.0 - indicator(taut, resisting[stretch])
        for i in range(len(q)):
            if i != stretch:
                entry = mass[stretch, i] * is_slack
                masked_mass[stretch, i] = entry
                masked_mass[i, stretch] = entry
        masked_resisting[stretch] = resisting[stretch] * is_slack
        motion = self._solved(masked_mass, masked_resisting, v, command)
        tension = -(mass[stretch] @ motion.acceleration + resisting[stretch])
        if pull is None:
            pull = tension
        return DynamicsResult(motion.acceleration, motion.effort, motion.needed, pull)

    def _solved(
        self,
        mass: np.ndarray,
        resisting: np.ndarray,
        v: np.ndarray,
        command: np.ndarray,
        still: int | None = None,
    ) -> DrivenMotion:
        """Return the solution of the equation of motion M a + resisting = τ for a command.

        Args:
            mass: Mass matrix M, shape (n, n).
            resisting: Generalized forces without acceleration, shape (n,).
            v: Rates, shape (n,).
            command: As for `forward_dynamics`.
            still: A joint that does not accelerate; None for none.
        """
        drives = self.topology.layout.drives
        free = self._free_joints(still)
        if self.response is not None:
            target = array(self.response.accelerations_at(command, v[drives]))
            return saturate_acceleration(mass, resisting, target, self.effort_limit, drives, free)
        a = array([0.0] * len(v))
        if self.drive == "effort":
            resisting = resisting.copy()
            resisting[drives] = resisting[drives] - command
        else:
            a[drives] = command
        # With the accelerations of the free joints f at zero, M a is what the others cause. The
        # rows of the free joints are then M_ff a_f = -(resisting + M a)_f.
        a[free] = solve_linear(mass[np.ix_(free, free)], -(resisting + mass @ a)[free])
        effort = command if self.drive == "effort" else (mass @ a + resisting)[drives]
        return DrivenMotion(a, effort, effort)

    def _free_joints(self, still: int | None = None) -> np.ndarray:
        """Return the joints whose motion is not prescribed, by their indices, without one that
        stands still.
        """
        layout = self.topology.layout
        joints = layout.independent if self.drive == "effort" else layout.passive
        return joints if still is None else joints[joints != still]

    def impact(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, Any]:
        """Return the rates after an inextensible rope has become taut, and the kinetic energy that
        is gained by that, which is negative.

        The impact is plastic: it takes the rate of the stretch. It acts for no time, so that only
        the impulse of the rope counts, and momentum is conserved in the directions of the free
        joints f: with the change Δ of the rates, (M Δ)_f = 0, where Δ is -v at the stretch and 0 in
        drives that follow a command of motion. The energy gained is
        ½ (v + Δ)ᵀ M (v + Δ) - ½ vᵀ M v = Δᵀ M (v + ½ Δ).

        Args:
            q: Coordinates, shape (n,).
            v: Rates before the impact, shape (n,).
        """
        assert self.joint.rope is not None
        stretch = self.joint.rope.stretch
        mass = rigid_body.mass_matrix(self.tree, rigid_body.frames(self.tree, q))
        free = self._free_joints(stretch)
        change = array([0.0] * len(v))
        change[stretch] = -v[stretch]
        change[free] = solve_linear(mass[np.ix_(free, free)], -(mass @ change)[free])
        after = v + change
        after[stretch] = 0.0
        return after, change @ (mass @ (v + 0.5 * change))

    def ground_reactions(
        self, q: np.ndarray, v: np.ndarray, anchors: np.ndarray
    ) -> tuple[list[ExternalForce], np.ndarray]:
        """Return the forces of the ground on the load, and the anchors after that, shape
        (3 points,).

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            anchors: Places where the points of the load came to rest [m], shape (3 points,).
        """
        contacts = self.contacts
        if contacts is None:
            return [], anchors
        motions = self._ground_motions(q, v)
        reactions = []
        moved: list[Any] = []
        for point, motion, anchor in zip(
            contacts.points, motions, anchors.reshape(-1, 3), strict=True
        ):
            position, velocity = motion
            force, moved_anchor = contacts.reaction(position, velocity, anchor)
            reactions.append(ExternalForce(contacts.body, array(point), array(force)))
            moved += moved_anchor
        return reactions, array(moved)

    def power(self, q: np.ndarray, v: np.ndarray, reactions: Sequence[ExternalForce]) -> Any:
        """Return the power of the forces of `ground_reactions` at coordinates and rates [W]."""
        power: Any = 0.0
        for (_, velocity), reaction in zip(self._ground_motions(q, v), reactions, strict=True):
            power = power + velocity @ reaction.force
        return power

    def touching(self, q: np.ndarray) -> list[Any]:
        """Return whether each point of the load is in a support; empty without ground."""
        contacts = self.contacts
        if contacts is None:
            return []
        at_rest = array([0.0] * len(q))
        motions = self._ground_motions(q, at_rest)
        return [contacts.depth(position)[0] > 0.0 for position, _ in motions]

    def _ground_motions(self, q: np.ndarray, v: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return position and velocity of each point of the load that may touch the ground."""
        assert self.contacts is not None
        points = [array(point) for point in self.contacts.points]
        frames = rigid_body.frames(self.tree, q)
        return rigid_body.point_motions(self.tree, frames, v, self.contacts.body, points)

    def drag(
        self,
        q: np.ndarray,
        v: np.ndarray,
        air: np.ndarray,
        areas: Any,
        turning: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the drag of air on the points [N], shape (3 points,), see
        `cranedyn.disturbances.wind.drag_force`.

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            air: Velocity of the air at each point in the world [m/s], shape (3 points,).
            areas: Drag coefficient times area of each point [m²], shape (points,).
            turning: Angular velocity of a base that moves, in its axes [rad/s], shape (3,). All
                vectors are in these axes then, and the velocity of the air is that relative to the
                origin of the base. None for a base at rest.
        """
        poses = rigid_body.frames(self.tree, q)
        forces = []
        points = zip(areas, air.reshape(-1, 3), self.topology.bodies, self.levers, strict=True)
        for area, wind, body, lever in points:
            ((_, velocity),) = rigid_body.point_motions(self.tree, poses, v, body, [lever], turning)
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
        """Return comparisons that must be true for the model to hold, see
        `cranedyn.dynamics.validity`.

        Args:
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
            hoist_force: Force of the hoist and of the cable's buffers [N].
            needed: Efforts that drives need which follow a motion or a rate, shape (m,).
        """
        layout = self.topology.layout
        rope = self.joint.rope
        tension = rope_tension(layout, self.joint, q, v, hoist_force)
        payload_height = height(self.tree, q, self.topology.bodies[0], self.levers[0])
        state_bounds = bounds(
            layout,
            self,
            q,
            v,
            self.swing_angles(q),
            tension,
            self.topology.bodies[0],
            payload_height,
            buffers=self.buffers,
            needed=None if self.drive == "effort" else needed,
            rates=self.drive != "velocity",
            rope=None if rope is None else (rope.stretch, rope.length),
            level=0.0 if self.contacts is None else self.contacts.level,
        )
        return [condition for bound in state_bounds for condition in bound.conditions]

    def within(self, command: np.ndarray) -> np.ndarray:
        """Return efforts clipped to the limits of the drives, other commands as they are, shape
        (m,).
        """
        if self.drive != "effort":
            return command
        efforts = []
        for effort, limit in zip(command, self.effort_limit, strict=True):
            efforts.append(clipped(effort, -limit, limit))
        return array(efforts)

    def energy(self, q: np.ndarray, v: np.ndarray) -> Any:
        """Return the mechanical energy, including that of springs [J]; potential energy is zero at
        the origin of the world.
        """
        frames = rigid_body.frames(self.tree, q)
        rigid = 0.5 * (v @ (rigid_body.mass_matrix(self.tree, frames) @ v))
        rigid = rigid + rigid_body.potential_energy(self.tree, frames)
        return rigid if self.joint.springs is None else rigid + self.joint.springs.energy(q)

    @property
    def plumb_at_zero(self) -> bool:
        """Whether the load hangs plumb where the swing joints are at zero."""
        return not (np.any(self.rest_angle) or np.any(self.rest_slope))

    def hanging_angles(self, drives: np.ndarray) -> np.ndarray:
        """Return the angles at which the swing joints hang for coordinates of the drives, to first
        order about the start [rad], shape (swings,).
        """
        return self.rest_angle + self.rest_slope @ drives

    def swing_angles(self, q: np.ndarray) -> dict[int, Any]:
        """Return angles of the swing joints from where they hang [rad], by their indices among the
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

        A pendulum of length l with the angle φ swings with the amplitude √(φ² + φ̇² l/g). Both
        results are sums over the swing joints.
        """
        squared_angle: Any = 0.0
        for angle in self.swing_angles(q).values():
            squared_angle = squared_angle + angle * angle
        gravity = -self.tree.gravity[2]
        kinetic: Any = 0.0
        for (i, carries_hoist), arm in zip(self.topology.swings, self.arms, strict=True):
            length = arm
            if carries_hoist:
                length = arm + q[self.topology.layout.role("hoist", "The cable")]
            kinetic = kinetic + v[i] * v[i] * length
        return squared_angle, squared_angle + kinetic / gravity


def _section_sizes(topology: Topology) -> dict[str, int]:
    """Return the length of each section of the numbers of a crane, in their order.

    `plant_numbers` writes the sections, and `make_plant` reads them.
    """
    n = topology.layout.n
    m = topology.layout.m
    frictions = len(topology.friction)
    swings = len(topology.swings)
    return {
        "tree": len(blank(topology.parents).numbers()),
        "damping": n,
        "friction_effort": frictions,
        "friction_width": frictions,
        "spring_stiffness": n,
        "spring_rest": n,
        "rope_stiffness": 1,  # 0 without a rope
        "fall_stiffness": 0 if topology.bifilar is None else 1,
        "lower": n,
        "upper": n,
        "effort_limit": m,
        "rate_limit": m,
        "levers": 3 * len(topology.bodies),
        "arms": swings,
        "rest_angle": swings,
        "rest_slope": swings * m,
        "stop_stiffness": m,
        "stop_damping": m,
    }


@once_per_crane
def plant_numbers(crane: Crane) -> np.ndarray:
    """Return all numbers of a crane in a row, read-only, in the order of `_section_sizes`. From it
    `make_plant` makes the crane again.
    """
    friction = crane.friction
    springs = crane.springs
    rope = springs.rope
    falls = springs.bifilar
    stops = Stops.of(crane)
    no_numbers = np.zeros(0)
    sections: dict[str, Any] = {
        "tree": bodies_of_model(crane.model).numbers(),
        "damping": crane.damping,
        "friction_effort": no_numbers if friction is None else friction.effort,
        "friction_width": no_numbers if friction is None else friction.width,
        "spring_stiffness": springs.stiffness,
        "spring_rest": springs.rest,
        "rope_stiffness": [0.0 if rope is None else rope.stiffness],
        "fall_stiffness": no_numbers if falls is None else [falls.stiffness],
        "lower": crane.lower,
        "upper": crane.upper,
        "effort_limit": crane.effort_limit,
        "rate_limit": np.minimum(crane.rate_limit, _NO_RATE_LIMIT),
        "levers": np.concatenate([point.lever for point in crane.points]),
        "arms": _arms(crane),
        "rest_angle": crane.rest.angle,
        "rest_slope": crane.rest.slope.ravel(),
        "stop_stiffness": stops.stiffness,
        "stop_damping": stops.damping,
    }
    return read_only(
        np.concatenate([sections[name] for name in _section_sizes(Topology.of(crane))])
    )


def _arms(crane: Crane) -> np.ndarray:
    """Return the distance from each swing joint to the payload with all joints below it at zero
    [m], shape (swings,).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, np.zeros(crane.layout.n))
    payload = data.oMi[crane.payload.body + 1].act(crane.payload.lever)
    arms = []
    for swing in crane.swings.tolist():
        pivot = data.oMi[swing + 1].translation
        arms.append(float(np.linalg.norm(payload - pivot)))
    return np.array(arms)


def make_plant(topology: Topology, values: Sequence[Any], drive: str, buffers: bool) -> Plant:
    """Return a plant from its topology and its numbers.

    Args:
        topology: What it has in common with cranes of other numbers.
        values: Its numbers in the order of `plant_numbers`; with drive "velocity" those of its
            frequency converters follow, attribute by attribute of `Response`.
        drive: "effort", "motion" or "velocity", see `Plant.drive`.
        buffers: Whether buffers act at the ends of the ranges.
    """
    layout = topology.layout
    response = None
    if drive == "velocity":
        count = layout.m * len(Response._fields)
        response = Response(*np.split(array(values[-count:]), len(Response._fields)))
        values = values[:-count]

    sections: dict[str, np.ndarray] = {}
    first = 0
    for name, size in _section_sizes(topology).items():
        sections[name] = array(values[first : first + size])
        first += size

    rope = None
    if topology.rope is not None:
        stretch, length, inextensible = topology.rope
        rope = Rope(stretch, length, sections["rope_stiffness"][0], inextensible)
    falls = None
    if topology.bifilar is not None:
        yaw, length = topology.bifilar
        falls = Bifilar(yaw, length, sections["fall_stiffness"][0])
    springs = None
    if topology.springs:
        springs = Springs(sections["spring_stiffness"], sections["spring_rest"], rope, falls)
    friction = None
    if topology.friction:
        friction = DryFriction(
            topology.friction, sections["friction_effort"], sections["friction_width"]
        )
    lower = sections["lower"]
    upper = sections["upper"]
    rest_slope = sections["rest_slope"].reshape(len(topology.swings), layout.m)
    tree = blank(topology.parents).with_numbers(sections["tree"])
    return Plant(
        topology=topology,
        tree=rigid_body.regrouped(tree),
        joint=JointForces(sections["damping"], springs, friction),
        stops=Stops(
            drives=layout.drives,
            lower=lower[layout.drives],
            upper=upper[layout.drives],
            stiffness=sections["stop_stiffness"],
            damping=sections["stop_damping"],
        ),
        lower=lower,
        upper=upper,
        effort_limit=sections["effort_limit"],
        rate_limit=sections["rate_limit"],
        levers=sections["levers"].reshape(-1, 3),
        arms=sections["arms"],
        rest_angle=sections["rest_angle"],
        rest_slope=rest_slope,
        drive=drive,
        buffers=buffers,
        response=response,
    )
