"""The recursions in plain numbers against Pinocchio's algorithms, which have another derivation and
another language.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cranedyn.compiled.plant import rigid_body
from cranedyn.compiled.plant.forward_dynamics import is_sliding_point, tree_forward_dynamics
from cranedyn.compiled.plant.rigid_body import ExternalForce, Frame
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.dynamics.bodies import Bodies, blank, bodies_of_model
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.interfaces import State
from tests.helpers import crane, states


def _arm(parents: Sequence[int], seed: int) -> pin.Model:
    """Seven joints of all kinds, with armature, in gravity that is not vertical."""
    model = pin.Model()
    rng = np.random.default_rng(seed)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    kinds = [
        pin.JointModelRZ(),
        pin.JointModelPrismaticUnaligned(axis),
        pin.JointModelHX(0.3),
        pin.JointModelRevoluteUnaligned(axis),
    ]
    kinds += [pin.JointModelPY(), pin.JointModelHelicalUnaligned(axis, -0.2), pin.JointModelRX()]
    for i, (kind, parent) in enumerate(zip(kinds, parents, strict=True)):
        place = pin.SE3(
            pin.Quaternion(rng.normal(size=4)).normalized().matrix(), rng.normal(size=3)
        )
        joint = model.addJoint(parent, kind, place, f"joint {i}")
        body = pin.Inertia(1.0 + i, rng.normal(size=3), np.diag([1.0, 2.0, 2.5]) + 0.1)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    model.armature = rng.uniform(0.1, 2.0, 7)
    return model


ARM = _arm((0, 1, 2, 1, 4, 5, 5), 4)

vectors = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7).map(np.array)


def _tree(model: pin.Model) -> Bodies:
    tree = bodies_of_model(model)
    return tree.with_numbers(tree.numbers().tolist())


def _at(q: np.ndarray) -> tuple[Bodies, list[Frame]]:
    tree = _tree(ARM)
    return tree, rigid_body.frames(tree, q)


def _plain(values: np.ndarray) -> np.ndarray:
    return np.array(values, dtype=float)


# rounding of some hundred operations on numbers up to 1e3


@given(vectors, vectors, vectors)
def test_forces_that_cause_accelerations_are_those_of_pinocchio(
    q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> None:
    found = rigid_body.tree_inverse_dynamics(*_at(q), v, a)
    expected = pin.rnea(ARM, ARM.createData(), q, v, a)
    assert_allclose(_plain(found), expected, atol=1e-12 * np.abs(expected).max() + 1e-10)


@given(vectors)
def test_inertia_of_the_coordinates_is_that_of_pinocchio(q: np.ndarray) -> None:
    found = _plain(rigid_body.mass_matrix(*_at(q)))
    upper = np.triu(pin.crba(ARM, ARM.createData(), q))
    assert_allclose(found, upper + np.triu(upper, 1).T, atol=1e-12 * np.abs(upper).max())
    assert not found[3, 1] and not found[6, 5]  # on different branches


@given(vectors)
def test_height_energy_and_its_slope_are_those_of_gravity(q: np.ndarray) -> None:
    data = ARM.createData()
    energy = rigid_body.potential_energy(*_at(q))
    assert energy == pytest.approx(pin.computePotentialEnergy(ARM, data, q), abs=1e-11)
    resting = rigid_body.tree_inverse_dynamics(*_at(q), np.zeros(7))
    h = 1e-5
    slope = [
        (rigid_body.potential_energy(*_at(q + d)) - rigid_body.potential_energy(*_at(q - d)))
        / (2 * h)
        for d in h * np.eye(7)
    ]
    # Truncation h² of third derivatives of 1e3 J, rounding 1e-13 / h.
    assert_allclose(_plain(resting), slope, atol=1e-5)


@given(vectors, st.integers(0, 6), st.floats(-50.0, 50.0))
def test_a_push_does_the_work_of_its_point(q: np.ndarray, body: int, strength: float) -> None:
    tree, where = _at(q)
    point = np.array([0.3, -0.5, 0.7])
    force = strength * np.array([0.5, 1.0, -2.0])
    pushed, free = (
        rigid_body.tree_inverse_dynamics(tree, where, np.zeros(7), external_forces=external_forces)
        for external_forces in ([ExternalForce(body, point, force)], [])
    )
    data = ARM.createData()
    pin.computeJointJacobians(ARM, data, q)
    jacobian = pin.getJointJacobian(ARM, data, body + 1, pin.LOCAL_WORLD_ALIGNED)
    arm = data.oMi[body + 1].rotation @ point
    expected = jacobian[:3].T @ force + jacobian[3:].T @ np.cross(arm, force)
    assert_allclose(_plain(free - pushed), expected, atol=1e-10)


@given(st.tuples(*(st.integers(0, i) for i in range(7))), st.integers(0), vectors, vectors, vectors)
def test_accelerations_of_any_tree_are_those_of_pinocchio(
    parents: tuple[int, ...], seed: int, q: np.ndarray, v: np.ndarray, effort: np.ndarray
) -> None:
    model = _arm(parents, seed)
    tree = _tree(model)
    data = model.createData()
    where = rigid_body.frames(tree, q)
    found = _plain(tree_forward_dynamics(tree, where, v, array(effort.tolist())))
    expected = pin.aba(model, data, q, v, effort)
    assert not rigid_body.disagreement(found, expected, pin.crba(model, data, q))


@pytest.mark.parametrize("joint", [pin.JointModelSpherical(), pin.JointModelComposite(0)])
def test_a_joint_of_another_kind_is_named(joint: object) -> None:
    model = pin.Model()
    with pytest.raises(ModelError, match="has no joint that moves"):
        bodies_of_model(model)
    if isinstance(joint, pin.JointModelComposite):
        joint.addJoint(pin.JointModelRX(), pin.SE3.Identity())
    model.addJoint(0, joint, pin.SE3.Identity(), "wrist")
    with pytest.raises(ModelError, match=rf"wrist is a {joint.shortname()}; .* must be revolute"):
        bodies_of_model(model)


@given(states)
def test_a_load_on_its_rope_moves_as_in_pinocchio_wherever_its_centre_is(state: State) -> None:
    c = crane(damp_swing=0)
    model = c.model.copy()
    data = c.model.createData()
    model.inertias[5] = pin.Inertia(800.0, np.array([0.3, -0.2, 0.5]), np.zeros((3, 3)))
    tree = _tree(model)
    effort = np.array([1e4, -2e3, 30.0, -40.0, -9e3])
    force = ExternalForce(4, np.array([0.1, 0.2, -0.3]), np.array([300.0, -200.0, 100.0]))
    where = rigid_body.frames(tree, state.q)
    assert is_sliding_point(tree, 4)
    found = _plain(tree_forward_dynamics(tree, where, state.v, array(effort.tolist()), [force]))
    pushed, free = (
        _plain(rigid_body.tree_inverse_dynamics(tree, where, np.zeros(5), external_forces=some))
        for some in ([force], [])
    )
    expected = pin.aba(model, data, state.q, state.v, effort + free - pushed)
    assert not rigid_body.disagreement(found, expected, pin.crba(model, data, state.q))


@given(states)
def test_a_payload_that_turns_is_pushed_at_its_centre(state: State) -> None:
    c = crane(damp_swing=0)
    tree = _tree(c.model)
    where = rigid_body.frames(tree, state.q)
    force = np.array([[300.0, -200.0, 100.0], [-50.0, 20.0, 70.0]])
    external_forces = [
        ExternalForce(4, tree.lever[4], force[0]),
        ExternalForce(2, np.zeros(3), force[1]),
    ]
    pushed, free = (
        rigid_body.tree_inverse_dynamics(tree, where, np.zeros(5), external_forces=some)
        for some in (external_forces, [])
    )
    expected = dynamics.outside_effort(c.points, c.model, c.data, state.q, force)
    assert_allclose(_plain(free - pushed), expected, atol=1e-8)  # differences of 1e5 N m


def test_numbers_go_out_and_come_back_in_one_order() -> None:
    tree = bodies_of_model(ARM)
    again = blank(tree.parents).with_numbers(tree.numbers().tolist())
    assert again.numbers().tolist() == tree.numbers().tolist()
    assert _plain(again.inertia).tolist() == tree.inertia.tolist()
    assert len(again) == 7


def test_two_ways_to_solve_may_differ_by_the_condition_of_a_matrix_whatever_the_units() -> None:
    assert rigid_body.lost_digits(np.diag([1.0, 1e12])) == pytest.approx(1e3 * 2.0**-52)
    near = 1.0 - 1e-6  # eigenvalues 2 - 1e-6 and 1e-6
    mass = np.array([[1.0, 1e3 * near], [1e3 * near, 1e6]])
    assert rigid_body.lost_digits(mass) == pytest.approx(1e3 * 2.0**-52 * 2e6, rel=1e-3)


@given(q=vectors, v=vectors)
def test_counting_with_the_parent_what_moves_with_it_anyway_changes_nothing(
    q: np.ndarray, v: np.ndarray
) -> None:
    for model in (ARM, crane().model):
        tree = _tree(model)
        n = model.nv
        less = rigid_body.regrouped(tree)
        where = rigid_body.frames(tree, q[:n])
        ours, all_of_it = (_plain(rigid_body.mass_matrix(one, where)) for one in (less, tree))
        assert_allclose(ours, all_of_it, rtol=1e-12, atol=1e-9)
        expected = _plain(rigid_body.tree_inverse_dynamics(tree, where, v[:n]))
        found = _plain(rigid_body.tree_inverse_dynamics(less, where, v[:n]))
        assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
        energies = [float(rigid_body.potential_energy(one, where)) for one in (tree, less)]
        assert_allclose(*energies, rtol=1e-12, atol=1e-9)


def test_a_crane_keeps_no_mass_in_its_universal_joint() -> None:
    tree = rigid_body.regrouped(_tree(crane().model))
    assert tree.mass[crane().layout.passive].tolist() == [0.0, 0.0]
    assert sum(tree.mass) == sum(_tree(crane().model).mass)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.integers(0, 20))
def test_a_mass_on_the_axis_of_its_joint_is_counted_with_a_parent_that_has_its_own(
    first: float, second: float, seed: int
) -> None:
    """Two joints that turn, the second body with its centre on its own axis: all of its mass goes
    to the first, which has mass elsewhere, so that they share a centre.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Random(), "first")
    body = pin.Inertia(3.0, rng.normal(size=3), np.diag([1.0, 2.0, 2.5]) + 0.1)
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    joint = model.addJoint(joint, pin.JointModelRZ(), pin.SE3.Random(), "second")
    wheel = pin.Inertia(5.0, np.array([0.0, 0.0, 0.7]), np.diag([0.4, 0.4, 0.5]))
    model.appendBodyToJoint(joint, wheel, pin.SE3.Identity())
    tree = _tree(model)
    q = np.array([first, second])
    v = rng.normal(size=2)
    less = rigid_body.regrouped(tree)
    assert less.mass.tolist() == [8.0, 0.0]
    poses = rigid_body.frames(less, q)
    data = model.createData()
    upper = np.triu(pin.crba(model, data, q))
    found = _plain(rigid_body.mass_matrix(less, poses))
    assert_allclose(found, upper + np.triu(upper, 1).T, atol=1e-12 * np.abs(upper).max())
    expected = pin.rnea(model, data, q, v, np.zeros(2))
    resisting = _plain(rigid_body.tree_inverse_dynamics(less, poses, v))
    assert_allclose(resisting, expected, atol=1e-11 * np.abs(expected).max() + 1e-11)
    energy = pin.computePotentialEnergy(model, data, q)
    assert rigid_body.potential_energy(less, poses) == pytest.approx(energy, abs=1e-10)


@given(vectors, vectors, st.integers(0, 6))
def test_points_and_spins_of_a_body_are_those_of_pinocchio(
    q: np.ndarray, v: np.ndarray, body: int
) -> None:
    tree, poses = _at(q)
    point = np.array([0.3, -0.5, 0.7])
    data = ARM.createData()
    pin.forwardKinematics(ARM, data, q, v)
    ((place, speed),) = rigid_body.point_motions(tree, poses, v, body, [point])
    joint = data.oMi[body + 1]
    assert_allclose(_plain(place), joint.act(point), atol=1e-11)
    motion = pin.getVelocity(ARM, data, body + 1)
    expected = joint.rotation @ (motion.linear + np.cross(motion.angular, point))
    assert_allclose(_plain(speed), expected, atol=1e-10)
    spin = _plain(rigid_body.angular_velocity(tree, poses, body, v))
    assert_allclose(spin, motion.angular, atol=1e-11)
    world = np.array([0.4, 1.0, -2.0])
    local = _plain(rigid_body.into(tree, poses, body, world))
    assert_allclose(local, joint.rotation.T @ world, atol=1e-12)


@given(vectors, vectors, vectors)
def test_what_joints_pass_on_is_what_pinocchio_passes_on(
    q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> None:
    """Its forces act at the origin of a joint, in the joint's frame, less those of a push."""
    tree, poses = _at(q)
    data = ARM.createData()
    body = 5
    point = np.array([0.3, -0.5, 0.7])
    force = np.array([30.0, -20.0, 10.0])
    pin.forwardKinematics(ARM, data, q)
    pushes = [pin.Force.Zero() for _ in range(8)]
    local = data.oMi[body + 1].rotation.T @ force
    pushes[body + 1] = pin.Force(local, np.cross(point, local))
    wrenches = pin.StdVec_Force()
    wrenches.extend(pushes)
    pin.rnea(ARM, data, q, v, a, wrenches)
    found = rigid_body.transmitted(tree, poses, v, a, [ExternalForce(body, point, force)])
    for i, (linear, angular) in enumerate(found, start=1):
        size = max(1.0, float(np.abs(data.f[i].vector).max()))
        assert_allclose(_plain(linear), data.f[i].linear, atol=1e-11 * size)
        assert_allclose(_plain(angular), data.f[i].angular, atol=1e-11 * size)


def test_a_difference_counts_from_its_round_off_on() -> None:
    mass = np.eye(2)
    expected = np.array([1.0, -2.0])
    assert rigid_body.disagreement(expected + np.array([0.0, 1.9e-11]), expected, mass) == 0.0
    # By a hand: the largest difference over the largest number, in any of two rows.
    differs = np.array([1e-6, 0.0])
    off = rigid_body.disagreement(np.array([expected, expected + differs]), expected, mass)
    assert off == pytest.approx(0.5e-6, rel=1e-6)
    near = np.array([[1.0, 1.0 - 1e-8], [1.0 - 1e-8, 1.0]])  # condition 2e8: 4e-5 is lost
    assert rigid_body.disagreement(expected + differs, expected, near) == 0.0


def test_a_helical_joint_keeps_a_mass_on_its_axis_which_it_moves_along() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(3.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    joint = model.addJoint(joint, pin.JointModelHZ(0.3), pin.SE3.Identity(), "screw")
    nut = pin.Inertia(5.0, np.array([0.0, 0.0, 0.7]), np.eye(3))
    model.appendBodyToJoint(joint, nut, pin.SE3.Identity())
    q = np.array([0.1, 0.2])
    less = rigid_body.regrouped(_tree(model))
    found = _plain(rigid_body.mass_matrix(less, rigid_body.frames(less, q)))
    assert_allclose(found, pin.crba(model, model.createData(), q))
