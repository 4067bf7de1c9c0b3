"""A tree of bodies as plain numbers or symbols, and heights and positions of its points.

Arrays hold Python floats and, where something is not known yet, elements that add, subtract,
multiply, divide and know `sin` and `cos`. The recursions of `cranedyn.compiled.plant.rigid_body` go
by the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.scalars import array, column_objects, cross_product, is_zero
from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane, Point, once_per_crane

_UP = (0.0, 0.0, 1.0)
"""Unit vector of the world upwards."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The numbers of a model; row i is a joint and the body that it carries.

    Attributes:
        parents: Row of the joint before, -1 for the world; shape (n,).
        rotation: Rotation of the joint's placement in the frame of its parent, shape (n, 3, 3).
        translation: Origin of the placement [m], shape (n, 3).
        axis: Velocity per rate of the coordinate, linear and angular, in the joint's own frame,
            shape (n, 2, 3).
        mass: Mass of the body [kg], shape (n,).
        lever: Centre of mass in the joint's frame [m], shape (n, 3).
        inertia: Rotational inertia about the centre of mass [kg m²], shape (n, 3, 3).
        armature: Inertia added to that of the coordinate [kg m² or kg], shape (n,).
        gravity: Gravity in the world [m/s²], shape (3,).
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
        if parent < 0:
            return [body]
        return [*self.path(parent), body]

    def numbers(self) -> np.ndarray:
        """Return all numbers in a row, attribute by attribute."""
        return np.concatenate([getattr(self, name).ravel() for name in _NUMBER_ATTRIBUTES])

    def with_numbers(self, numbers: Sequence[Any] | np.ndarray) -> Bodies:
        """Return the same tree with other numbers or symbols, in the order of `numbers`."""
        arrays = []
        first = 0
        for name in _NUMBER_ATTRIBUTES:
            old = getattr(self, name)
            elements = array(list(numbers[first : first + old.size]))
            arrays.append(elements.reshape(old.shape))
            first += old.size
        return Bodies(self.parents, *arrays)

    def in_steps(self, dt: Any, mass: Any) -> Bodies:
        """Return the same tree with time in units of `dt` [s] and mass in units of `mass` [kg]."""
        return replace(
            self,
            mass=self.mass / mass,
            inertia=self.inertia / mass,
            armature=self.armature / mass,
            gravity=self.gravity * (dt * dt),
        )


_NUMBER_ATTRIBUTES = tuple(field.name for field in fields(Bodies) if field.name != "parents")
"""Attributes of `Bodies` that hold its numbers, in the order of its arguments and of a row."""


def blank(parents: Sequence[int]) -> Bodies:
    """Return a tree whose numbers are all zero."""
    n = len(parents)
    return Bodies(
        parents=parents,
        rotation=np.zeros((n, 3, 3)),
        translation=np.zeros((n, 3)),
        axis=np.zeros((n, 2, 3)),
        mass=np.zeros(n),
        lever=np.zeros((n, 3)),
        inertia=np.zeros((n, 3, 3)),
        armature=np.zeros(n),
        gravity=np.zeros(3),
    )


def bodies_of_model(model: pin.Model) -> Bodies:
    """Return the numbers of a model.

    Raises:
        ModelError: If a joint does not have one degree of freedom, or there is none.
    """
    if model.njoints < 2:
        raise ModelError(f"The model {model.name!r} has no joint that moves.")
    n = model.njoints - 1
    # Joint 0 of Pinocchio is the world.
    tree = blank([parent - 1 for parent in list(model.parents)[1:]])
    neutral = pin.neutral(model)
    for row in range(n):
        i = row + 1
        joint = model.joints[i]
        kind = joint.shortname()
        has_one_coordinate = (joint.nv, joint.idx_v) == (1, row)
        if not has_one_coordinate or kind == "JointModelComposite":
            raise ModelError(
                f"{model.names[i]} is a {kind}; to be compiled or made symbols, joints must be "
                "revolute, prismatic or helical, with one degree of freedom each."
            )
        joint_data = joint.createData()
        joint.calc(joint_data, neutral)
        placement = model.jointPlacements[i]
        body = model.inertias[i]
        tree.rotation[row] = placement.rotation
        tree.translation[row] = placement.translation
        # Pinocchio's motion vectors are linear, then angular.
        tree.axis[row] = joint_data.S.reshape(2, 3)
        tree.mass[row] = body.mass
        tree.lever[row] = body.lever
        tree.inertia[row] = body.inertia
    tree.armature[:] = model.armature
    tree.gravity[:] = model.gravity.linear
    return tree


@once_per_crane
def bodies_of_crane(crane: Crane) -> Bodies:
    """Return the bodies of a crane in Python floats, computed once."""
    tree = bodies_of_model(crane.model)
    return tree.with_numbers(tree.numbers().tolist())


def height(
    tree: Bodies, q: np.ndarray, body: int, point: np.ndarray, upwards: Sequence[float] = _UP
) -> Any:
    """Return the height of a point of a body above the origin of the world [m], or another of its
    coordinates.

    Only the vertical is carried from joint to joint, which is a third of the work of
    `cranedyn.compiled.plant.rigid_body.frames`. A joint that turns by q about the unit vector u
    takes the vertical e into its frame by Rodrigues' formula for -q, with the part p = u (u·e)
    along the axis:

        e' = p + cos q (e - p) - sin q (u × e).

    Args:
        tree: The bodies.
        q: Coordinates, shape (n,).
        body: Row of the body.
        point: Point in the joint's frame [m], shape (3,).
        upwards: Unit vector of the world along which height is measured: Z by default. With X or Y
            of the world the result is that coordinate of the point.
    """
    up = array(upwards)
    altitude = 0.0
    for i in tree.path(body):
        altitude = altitude + up @ tree.translation[i]
        up = tree.rotation[i].T @ up
        along, about = tree.axis[i]
        coordinate = q[i : i + 1]
        altitude = altitude + up @ (along * coordinate)
        if all(is_zero(component) for component in about):
            continue
        axial = about * array([about @ up])
        # A joint about the vertical, such as the slew, does not change the vertical.
        if not all(is_zero(component) for component in up - axial):
            cosine = np.cos(coordinate)
            sine = np.sin(coordinate)
            up = axial + cosine * (up - axial) - sine * cross_product(about, up)
    return altitude + up @ point


def heights(
    tree: Bodies, q: np.ndarray, body: int, point: np.ndarray, upwards: Sequence[float] = _UP
) -> np.ndarray:
    """Return heights as `height` at many coordinates, shape (rows, n): shape (rows,) [m]."""
    altitude = height(tree, column_objects(q), body, point, upwards)
    return np.broadcast_to(np.asarray(altitude, dtype=float), len(q))


def point_paths(crane: Crane, q: np.ndarray, points: Sequence[Point] = ()) -> np.ndarray:
    """Return the positions of points in the world at many coordinates.

    Args:
        crane: The crane.
        q: Coordinates, shape (rows, n).
        points: The points; all points on which forces act if none are given.

    Returns:
        Positions [m], shape (rows, points, 3).
    """
    tree = bodies_of_crane(crane)
    axes = []
    for axis in np.eye(3).tolist():
        columns = []
        for _, body, lever in points or crane.points:
            columns.append(heights(tree, q, body, lever, axis))
        axes.append(columns)
    return np.array(axes).T
