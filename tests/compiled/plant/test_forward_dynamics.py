"""Accelerations of a load on a rope by the short way, beside the general equations."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given

from cranedyn.compiled.plant import forward_dynamics, rigid_body
from cranedyn.compiled.plant.forward_dynamics import tree_forward_dynamics
from cranedyn.compiled.plant.rigid_body import ExternalForce
from cranedyn.dynamics.bodies import Bodies, bodies_of_model
from cranedyn.dynamics.root_motion import RootMotion
from cranedyn.dynamics.scalars import array
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from tests.helpers import crane, states

EFFORT = np.array([1e4, -2e3, 30.0, -40.0, -9e3])
"""Efforts of slew, trolley, both swings and hoist."""

FORCES = [
    ExternalForce(4, np.array([0.1, 0.2, -0.3]), np.array([300.0, -200.0, 100.0])),
    ExternalForce(3, np.array([0.0, 0.1, 0.0]), np.array([-10.0, 20.0, 30.0])),
    ExternalForce(1, np.zeros(3), np.array([-50.0, 20.0, 70.0])),
]
"""Forces on the load, on the link above it, and on the trolley."""

ROOT = RootMotion(
    omega=array([0.1, -0.2, 0.3]),
    alpha=array([0.4, 0.1, -0.2]),
    acceleration=array([0.5, -1.0, 9.0]),
)


def _tree(c: Crane) -> Bodies:
    tree = bodies_of_model(c.model)
    return rigid_body.regrouped(tree.with_numbers(tree.numbers().tolist()))


def _hinges(tree: Bodies, q: np.ndarray) -> list[int]:
    masses = tree.mass.copy()
    masses[len(tree) - 1] = 0.0
    without_load = replace(tree, mass=masses)
    hanging = forward_dynamics._hanging(without_load, rigid_body.frames(tree, q))
    return sorted(hanging.hinge_in.values())


def _agrees(tree: Bodies, q: np.ndarray, v: np.ndarray, effort: np.ndarray) -> bool:
    """Return whether accelerations are those of the general equations, under forces and on a base
    that moves.
    """
    poses = rigid_body.frames(tree, q)
    found = tree_forward_dynamics(tree, poses, v, array(effort.tolist()), FORCES, ROOT)
    mass = rigid_body.mass_matrix(tree, poses).astype(float)
    resisting = rigid_body.tree_inverse_dynamics(
        tree, poses, v, external_forces=FORCES, root=ROOT
    ).astype(float)
    expected = np.linalg.solve(mass, effort - resisting)
    return not rigid_body.disagreement(found.astype(float), expected, mass)


@given(states)
def test_a_load_on_hinges_moves_as_by_the_equations_of_all_joints(state: State) -> None:
    tree = _tree(crane())
    assert _hinges(tree, state.q) == [2, 3]
    assert _agrees(tree, state.q, state.v, EFFORT)


@given(states)
def test_hinges_without_inertia_or_with_any_other_are_hinges_too(state: State) -> None:
    tree = _tree(crane())
    for inertia in (0.0, 1e4):
        inertias = tree.inertia.copy()
        for i in (2, 3):
            inertias[i] = array((inertia * np.eye(3)).ravel().tolist()).reshape(3, 3)
        changed = replace(tree, inertia=inertias)
        assert _hinges(changed, state.q) == [2, 3]
        assert _agrees(changed, state.q, state.v, EFFORT)


@given(states)
def test_a_load_below_an_overhead_crane_hangs_on_hinges_as_well(state: State) -> None:
    c = load_crane(XACRO.with_name("overhead_crane.urdf.xacro"))
    tree = _tree(c)
    assert _hinges(tree, state.q) == [2, 3]
    found = tree_forward_dynamics(
        tree, rigid_body.frames(tree, state.q), state.v, array(EFFORT.tolist())
    )
    data = c.model.createData()
    expected = pin.aba(c.model, data, state.q, state.v, EFFORT)
    mass = pin.crba(c.model, data, state.q)
    assert not rigid_body.disagreement(found.astype(float), expected, mass)


def _with_unequal_inertia(tree: Bodies) -> Bodies:
    inertias = tree.inertia.copy()
    inertias[3] = array(np.diag([0.3, 0.4, 0.6]).ravel().tolist()).reshape(3, 3)
    return replace(tree, inertia=inertias)


def _with_load_beside_the_rope(x: float, y: float, tree: Bodies) -> Bodies:
    levers = tree.lever.copy()
    levers[4] = array([x, y, 0.5])
    return replace(tree, lever=levers)


def _with_armature(tree: Bodies) -> Bodies:
    return replace(tree, armature=array([0.0, 0.0, 2.0, 3.0, 0.0]))


def _with_heavy_link(tree: Bodies) -> Bodies:
    masses = tree.mass.copy()
    masses[3] = 50.0
    levers = tree.lever.copy()
    levers[3] = array([0.1, 0.2, -1.0])
    return replace(tree, mass=masses, lever=levers)


@pytest.mark.parametrize(
    "change",
    [
        _with_unequal_inertia,
        pytest.param(partial(_with_load_beside_the_rope, 0.3, -0.2), id="load beside the rope"),
        pytest.param(partial(_with_load_beside_the_rope, 0.3, 0.0), id="load ahead of the rope"),
        pytest.param(partial(_with_load_beside_the_rope, 0.0, -0.2), id="load aside of the rope"),
        _with_armature,
        _with_heavy_link,
    ],
)
def test_what_shares_its_inertia_with_others_is_no_hinge(change: object) -> None:
    assert callable(change)
    tree = change(_tree(crane()))
    rng = np.random.default_rng(2)
    q = crane().start.q + rng.uniform(-0.3, 0.3, 5)
    v = rng.uniform(-1.0, 1.0, 5)
    assert _hinges(tree, q) == []
    assert _agrees(tree, q, v, EFFORT)


def test_a_pendulum_that_hangs_from_nothing_that_moves_swings_as_in_pinocchio() -> None:
    """Its outer hinge has no body before it."""
    model = pin.Model()
    below = 0
    joints = [
        (pin.JointModelRY(), 20.0, pin.Inertia(0.0, np.zeros(3), 0.1 * np.eye(3))),
        (pin.JointModelRX(), 0.0, pin.Inertia(0.0, np.zeros(3), 0.1 * np.eye(3))),
        (pin.JointModelPrismaticUnaligned(np.array([0.0, 0.0, -1.0])), 0.0, pin.Inertia.Zero()),
    ]
    for i, (joint, height, inertia) in enumerate(joints):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        below = model.addJoint(below, joint, place, f"joint_{i}")
        model.appendBodyToJoint(below, inertia, pin.SE3.Identity())
    load = pin.Inertia(500.0, np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(below, load, pin.SE3.Identity())
    tree = bodies_of_model(model)
    tree = rigid_body.regrouped(tree.with_numbers(tree.numbers().tolist()))
    q = np.array([0.3, -0.2, 10.0])
    v = np.array([0.5, 0.4, -0.3])
    effort = np.array([100.0, -50.0, -4000.0])
    poses = rigid_body.frames(tree, q)
    found = tree_forward_dynamics(tree, poses, v, array(effort.tolist())).astype(float)
    data = model.createData()
    expected = pin.aba(model, data, q, v, effort)
    assert not rigid_body.disagreement(found, expected, pin.crba(model, data, q))
