"""Force and moment that pass through a cut anywhere in a crane, of many states at once.

A cut is six locked joints in the place of one joint: their efforts are the three forces and three
moments that hold all beyond them. So the recursion of the equations of motion
(`cranedyn.plant.rigid_body`) also gives the loads.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array
from cranedyn.dynamics.bodies import Bodies, blank, bodies
from cranedyn.dynamics.scalars import rows
from cranedyn.model.crane import Crane
from cranedyn.plant import rigid_body
from cranedyn.plant.plant import Topology, numbers, plant
from cranedyn.plant.rigid_body import ExternalForce, Frame

_CUT = 6


class Wrench(NamedTuple):
    """Force and moment through a cut, from the side of the load to that of the ground, in the
    world.

    Attributes:
        force: [N], shape (rows, 3).
        moment: About `point` [N m], shape (rows, 3).
        point: Where the cut is [m], shape (rows, 3).
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray

    def about(self, point: np.ndarray) -> Wrench:
        """Return the wrench about another point [m], shape (3,) or (rows, 3)."""
        arm = self.point - point
        points = np.broadcast_to(np.asarray(point, dtype=float), self.point.shape)
        return Wrench(self.force, self.moment + np.cross(arm, self.force), points)


@dataclass(frozen=True, eq=False)
class Moving:
    """States of a crane with all that acts, in rows.

    Attributes:
        tree: Its bodies.
        q, v, a: Coordinates, rates and accelerations, shape (rows, n) each.
        external: Forces from outside.
    """

    tree: Bodies
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    external: tuple[ExternalForce, ...]

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
    ) -> Moving:
        """Return states with the accelerations by efforts, gravity and forces from outside.

        Args:
            crane: The crane, with n joints and m drives.
            q: Coordinates [rad or m], shape (rows, n).
            v: Their rates, shape (rows, n).
            effort: Of the drives [N m or N], shape (rows, m).
            force: From outside on the points of the crane in the world [N], shape (rows, 3 points).
            buffers: Whether buffers end the ranges of the drives.

        Raises:
            OutOfRange: If an array has another shape.
        """
        layout, topology = crane.layout, Topology.of(crane)
        q = as_array("q", q, ("rows", layout.n))
        v = as_array("v", v, q.shape)
        effort = as_array("effort", effort, (len(q), layout.m))
        crane_plant = plant(topology, numbers(crane).tolist(), "effort", buffers)
        acting = force is not None and bool(np.any(force))
        outside = None
        if acting:
            outside = rows(as_array("force", force, (len(q), 3 * len(crane.points))))
        caused = crane_plant.answer(rows(q), rows(v), rows(effort), outside)[0]
        external = [] if outside is None else list(outside.reshape(-1, 3))
        points = zip(topology.bodies, crane_plant.levers, external, strict=acting)
        tree = bodies(crane.model)  # that of the plant counts masses with their parents
        tree = tree.with_numbers(tree.numbers().tolist())
        forces = tuple(ExternalForce(*values) for values in points)
        return cls(tree, q, v, _filled(caused, len(q)), forces)

    def through(self, joint: int | None) -> Wrench:
        """Return the wrench through a joint; for None through the ground, about the world's origin.

        Args:
            joint: Its index among the coordinates.
        """
        first = 0 if joint is None else joint
        tree = _with_cut(self.tree, joint)
        q, v, a = (
            np.insert(columns, [first] * _CUT, 0.0, axis=1) for columns in (self.q, self.v, self.a)
        )
        frames = rigid_body.frames(tree, rows(q))
        beyond = [push._replace(body=_after(push.body, first)) for push in self.external]
        efforts = rigid_body.tree_inverse_dynamics(tree, frames, rows(v), rows(a), beyond)
        last = first + _CUT - 1
        force, moment = efforts[first : first + 3], efforts[first + 3 : first + 6]
        return Wrench(
            -_filled(_turned(tree, frames, last, force), len(q)),
            -_filled(_turned(tree, frames, last, moment), len(q)),
            _filled(_placed(tree, frames, last), len(q)),
        )

    def axis(self, joint: int) -> np.ndarray:
        """Return the positive direction of a joint in the world, shape (rows, 3)."""
        frames = rigid_body.frames(self.tree, rows(self.q))
        along, about = self.tree.axis[joint]
        return _filled(_turned(self.tree, frames, joint, along + about), len(self.q))

    def origin(self, joint: int) -> np.ndarray:
        """Return the origin of a joint's frame in the world [m], shape (rows, 3)."""
        frames = rigid_body.frames(self.tree, rows(self.q))
        return _filled(_placed(self.tree, frames, joint), len(self.q))


def _filled(columns: Iterable[Any], count: int) -> np.ndarray:
    """Return columns, some of which may be one number for all rows, as an array."""
    filled = [np.broadcast_to(np.asarray(column, dtype=float), count) for column in columns]
    return np.stack(filled, axis=1)


def _after(body: int, first: int) -> int:
    """Return the index of a body after the cut is inserted."""
    return body + _CUT if body >= first else body


def _with_cut(tree: Bodies, joint: int | None) -> Bodies:
    """Return the tree with six joints, along and about three axes, before one joint or all."""
    first, n = joint or 0, len(tree)
    last = first + _CUT - 1
    template = blank([0] * (n + _CUT))
    cut = template.with_numbers(template.numbers().tolist())
    moved = [_after(i, first) for i in range(n)]
    parents = list(range(-1, n + _CUT - 1))  # those of the six joints follow one another
    parents[first] = -1 if joint is None else tree.parents[joint]
    for i, parent in enumerate(tree.parents):
        root = last if joint is None else -1
        parents[moved[i]] = _after(parent, first) if parent >= 0 else root
    for name in ("rotation", "translation", "axis", "mass", "lever", "inertia", "armature"):
        getattr(cut, name)[moved] = getattr(tree, name)
    cut.gravity[:] = tree.gravity
    cut.rotation[first : last + 1] = np.eye(3)
    for i in range(_CUT):
        cut.axis[first + i, i // 3, i % 3] = 1.0
    if joint is not None:
        parents[moved[joint]] = last
        cut.rotation[first], cut.translation[first] = tree.rotation[joint], tree.translation[joint]
        cut.rotation[moved[joint]], cut.translation[moved[joint]] = np.eye(3), np.zeros(3)
    return replace(cut, parents=parents)


def _turned(tree: Bodies, frames: list[Frame], body: int, vector: np.ndarray) -> np.ndarray:
    """Return a vector of the frame of a joint in the world, shape (3,)."""
    while body >= 0:
        vector, body = frames[body].rotation @ vector, tree.parents[body]
    return vector


def _placed(tree: Bodies, frames: list[Frame], body: int) -> np.ndarray:
    """Return the origin of a joint's frame in the world [m], shape (3,)."""
    point = rigid_body.array([0.0] * 3)
    while body >= 0:
        frame = frames[body]
        point, body = frame.origin + frame.rotation @ point, tree.parents[body]
    return point
