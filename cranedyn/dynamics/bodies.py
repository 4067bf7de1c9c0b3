"""The numbers of a tree of bodies, and the height of a point of one, in any kind of number; the
positions of points in many rows.

Arrays hold Python floats and, where something is not known yet, elements that add, subtract,
multiply, divide and know `sin` and `cos`. The recursions of `cranedyn.plant.rigid_body` go by the
same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.scalars import array, cross_product, is_zero, rows
from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane, Point, once_per_crane

_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Bodies:
    """The numbers of a model; row i is a joint and the body that it carries.

    Attributes:
        parents: Row of the joint before, -1 for the world; shape (n,).
        rotation: Of the joint's placement in the frame of its parent, shape (n, 3, 3).
        translation: The same [m], shape (n, 3).
        axis: Velocity per rate of the coordinate, linear and angular, in the joint's own frame,
            shape (n, 2, 3).
        mass: [kg], shape (n,).
        lever: Centre of mass [m], shape (n, 3).
        inertia: Rotational inertia about it [kg m²], shape (n, 3, 3).
        armature: Inertia added to that of the coordinate [kg m² or kg], shape (n,).
        gravity: In the world [m/s²], shape (3,).
    """

    parents: Sequence[int]
    rotation: np.ndarray
    translation: np.ndarray
    axis: np.ndarray
    mass: np.ndarray
    lever: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    gravity: np.ndarray

    def __len__(self) -> int:
        return len(self.parents)

    def path(self, body: int) -> list[int]:
        """Return the rows of the joints from the world to a body."""
        parent = self.parents[body]
        return [*(self.path(parent) if parent >= 0 else ()), body]

    def numbers(self) -> np.ndarray:
        """Return all numbers in a row."""
        return np.concatenate([getattr(self, field.name).ravel() for field in fields(self)[1:]])

    def with_numbers(self, numbers: Sequence[Any]) -> Bodies:
        """Return the same tree with other numbers or symbols, in the order of `numbers`."""
        arrays = []
        first = 0
        for field in fields(self)[1:]:
            old = getattr(self, field.name)
            arrays.append(array(numbers[first : first + old.size]).reshape(old.shape))
            first += old.size
        return Bodies(self.parents, *arrays)

    def in_steps(self, dt: Any, mass: Any) -> Bodies:
        """Return the same with time in units of `dt` [s] and mass in units of `mass` [kg]."""
        masses = {name: getattr(self, name) / mass for name in ("mass", "inertia", "armature")}
        return replace(self, **masses, gravity=self.gravity * (dt * dt))


def blank(parents: Sequence[int]) -> Bodies:
    """Return a tree whose numbers are all zero."""
    n = len(parents)
    shapes = (n, 3, 3), (n, 3), (n, 2, 3), (n,), (n, 3), (n, 3, 3), (n,), (3,)
    return Bodies(parents, *map(np.zeros, shapes))


def bodies(model: pin.Model) -> Bodies:
    """Return the numbers of a model.

    Raises:
        ModelError: If a joint does not have one degree of freedom, or there is none.
    """
    if model.njoints < 2:
        raise ModelError(f"The model {model.name!r} has no joint that moves.")
    rows: list[tuple[Any, ...]] = []
    neutral = pin.neutral(model)
    for i in range(1, model.njoints):
        joint, placement, body = model.joints[i], model.jointPlacements[i], model.inertias[i]
        kind = joint.shortname()
        if (joint.nv, joint.idx_v) != (1, i - 1) or kind == "JointModelComposite":
            raise ModelError(
                f"{model.names[i]} is a {kind}; to be compiled or made symbols, joints must be "
                "revolute, prismatic or helical, "
                "with one degree of freedom each."
            )
        joint_data = joint.createData()
        joint.calc(joint_data, neutral)
        frame = placement.rotation, placement.translation, joint_data.S.reshape(2, 3)
        rows.append((*frame, body.mass, body.lever, body.inertia))
    columns = [np.array(column, dtype=float) for column in zip(*rows, strict=True)]
    columns += [model.armature.copy(), model.gravity.linear.copy()]
    return Bodies([model.parents[i] - 1 for i in range(1, model.njoints)], *columns)


@once_per_crane
def numeric_bodies(crane: Crane) -> Bodies:
    """Return the bodies of a crane in plain numbers, computed once."""
    tree = bodies(crane.model)
    return tree.with_numbers(tree.numbers().tolist())


def height(
    tree: Bodies, q: np.ndarray, body: int, point: np.ndarray, upwards: Sequence[float] = _UP
) -> Any:
    """Return the height of a point of a body above the origin of the world [m].

    Only the vertical is carried from joint to joint, which is a third of the work of `frames`.

    Args:
        tree: The bodies.
        q: Coordinates, shape (n,).
        body: The body.
        point: In the joint's frame [m], shape (3,).
        upwards: Unit vector of the world along which height is measured.
    """
    up = array(upwards)
    altitude = 0.0
    for i in tree.path(body):
        altitude = altitude + up @ tree.translation[i]
        up = tree.rotation[i].T @ up
        (along, about), coordinate = tree.axis[i], q[i : i + 1]
        altitude = altitude + up @ (along * coordinate)
        if all(map(is_zero, about)):
            continue
        level = about * array([about @ up])
        if not all(map(is_zero, up - level)):
            cosine, sine = np.cos(coordinate), np.sin(coordinate)
            up = level + cosine * (up - level) - sine * cross_product(about, up)
    return altitude + up @ point


def heights(
    tree: Bodies, q: np.ndarray, body: int, point: np.ndarray, upwards: Sequence[float] = _UP
) -> np.ndarray:
    """Return heights as `height` at many states, q of shape (rows, n): shape (rows,) [m]."""
    altitude = height(tree, rows(q), body, point, upwards)
    return np.broadcast_to(np.asarray(altitude, dtype=float), len(q))


def point_paths(crane: Crane, q: np.ndarray, points: Sequence[Point] = ()) -> np.ndarray:
    """Return the positions of points in the world [m], of all points on which forces act if none
    are given, at many coordinates, shape (rows, n): shape (rows, points, 3).
    """
    tree = numeric_bodies(crane)
    axes = [
        [heights(tree, q, body, lever, axis) for _, body, lever in points or crane.points]
        for axis in np.eye(3).tolist()
    ]
    return np.array(axes).T
