"""Compiled forward dynamics of any tree of joints with one degree of freedom, against
Pinocchio's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cranedyn.dynamics.bodies import Bodies
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.plant import rigid_body
from tests.compiled.test_compiled import _wrong_cross
from tests.dynamics.test_integrator import ROBOTS, _robot

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.compiled.model import compile_forward_dynamics


def _unit(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


JOINTS: dict[str, Callable[[np.random.Generator], object]] = {
    "revolute x": lambda rng: pin.JointModelRX(),
    "revolute z": lambda rng: pin.JointModelRZ(),
    "revolute about any axis": lambda rng: pin.JointModelRevoluteUnaligned(_unit(rng)),
    "prismatic y": lambda rng: pin.JointModelPY(),
    "prismatic along any axis": lambda rng: pin.JointModelPrismaticUnaligned(_unit(rng)),
    "helical": lambda rng: pin.JointModelHY(float(rng.normal())),
    "helical about any axis": lambda rng: pin.JointModelHelicalUnaligned(
        _unit(rng), float(rng.normal())
    ),
    "unbounded y": lambda rng: pin.JointModelRUBY(),
}


def _inertia(rng: np.random.Generator) -> pin.Inertia:
    """Of points of 0.2 to 5 kg within a metre or two: what a body can have."""
    points, masses = rng.normal(size=(6, 3)), rng.uniform(0.2, 5.0, 6)
    lever = masses @ points / masses.sum()
    arms = points - lever
    about = (masses * (arms**2).sum(axis=1)).sum() * np.eye(3) - (masses * arms.T) @ arms
    return pin.Inertia(float(masses.sum()), lever, about)


def _tree(kinds: list[str], seed: int, *, branch: bool, armature: bool) -> pin.Model:
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.gravity.linear = rng.normal(size=3) * 9.0
    for i, kind in enumerate(kinds):
        parent = int(rng.integers(0, i + 1)) if branch else i
        rotation = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
        joint = model.addJoint(
            parent, JOINTS[kind](rng), pin.SE3(rotation, rng.normal(size=3)), f"joint {i}"
        )
        model.appendBodyToJoint(joint, _inertia(rng), pin.SE3.Identity())
    if armature:
        model.armature = rng.uniform(0.0, 3.0, model.nv)
    return model


def _worst(model: pin.Model, rng: np.random.Generator, states: int = 20) -> float:
    """Largest difference from `pin.aba`, in units of what 1000 roundings of a mass matrix of this
    condition can do, 1e-11 at least.
    """
    turns = rng.uniform(-9.0, 9.0, (states, model.nv))
    q = np.array([pin.integrate(model, pin.neutral(model), turn) for turn in turns])
    v, tau = rng.normal(size=(2, states, model.nv)) * 3.0
    found, data = compile_forward_dynamics(model)(q, v, tau), model.createData()
    worst = 0.0
    for state, mine in zip(zip(q, v, tau, strict=True), found, strict=True):
        expected = pin.aba(model, data, *state)
        allowed = max(1e-11, rigid_body.lost_digits(pin.crba(model, data, state[0])))
        off = np.abs(mine - expected).max() / np.abs(expected).max()
        worst = max(worst, float(off / allowed))
    return worst


@settings(max_examples=20)
@given(
    st.lists(st.sampled_from(list(JOINTS)), min_size=1, max_size=5),
    st.integers(0, 10**6),
    st.booleans(),
    st.booleans(),
)
@pytest.mark.slow
def test_any_tree_moves_as_in_pinocchio(
    kinds: list[str], seed: int, branch: bool, armature: bool
) -> None:
    tree = _tree(kinds, seed, branch=branch, armature=armature)
    assert _worst(tree, np.random.default_rng(seed)) < 1.0


@pytest.mark.parametrize("name", [*ROBOTS, "kinova.urdf"])
@pytest.mark.slow
def test_real_robots_move_as_in_pinocchio(name: str) -> None:
    assert _worst(_robot(name), np.random.default_rng(3)) < 1.0


def test_damping_is_left_to_whoever_gives_the_forces_as_in_pinocchio() -> None:
    damped = _tree(["revolute x", "prismatic y"], 1, branch=False, armature=False)
    damped.damping = np.array([5.0, 7.0])
    assert _worst(damped, np.random.default_rng(1)) < 1.0


def _with(joint: object) -> pin.Model:
    model = pin.Model()
    before = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "shoulder")
    model.appendBodyToJoint(before, _inertia(np.random.default_rng(0)), pin.SE3.Identity())
    last = model.addJoint(before, joint, pin.SE3.Identity(), "wrist")
    model.appendBodyToJoint(last, _inertia(np.random.default_rng(1)), pin.SE3.Identity())
    return model


def _composite() -> pin.JointModelComposite:
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])))
    return joint


@pytest.mark.parametrize(
    ("joint", "kind"),
    [
        (pin.JointModelSpherical(), "JointModelSpherical"),
        (pin.JointModelFreeFlyer(), "JointModelFreeFlyer"),
        (pin.JointModelPlanar(), "JointModelPlanar"),
        (_composite(), "JointModelComposite"),
    ],
)
def test_a_joint_that_cannot_be_compiled_is_named(joint: object, kind: str) -> None:
    words = rf"wrist is a {kind}; .* must be revolute, prismatic or helical, with one degree of"
    with pytest.raises(ModelError, match=words):
        compile_forward_dynamics(_with(joint))


def test_a_joint_that_follows_another_is_named() -> None:
    model = pin.transformJointIntoMimic(_with(pin.JointModelRY()), 1, 2, 1.0, 0.0)
    with pytest.raises(ModelError, match="wrist is a JointModelMimic"):
        compile_forward_dynamics(model)


def test_a_model_without_joints_is_refused() -> None:
    with pytest.raises(ModelError, match="has no joint that moves"):
        compile_forward_dynamics(pin.Model())


def _heavier(tree: Bodies) -> np.ndarray:
    numbers = _NUMBERS(tree)
    numbers[-4 - 9 - 1] *= 1.0 + 1e-9
    return numbers


_NUMBERS = Bodies.numbers


@pytest.mark.parametrize(
    ("what", "wrong"), [("cross_product", _wrong_cross), ("Bodies.numbers", _heavier)]
)
def test_code_that_moves_otherwise_is_refused(
    what: str, wrong: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = _tree(["revolute x", "prismatic y", "revolute z"], 5, branch=False, armature=False)
    compile_forward_dynamics(model)
    monkeypatch.setattr(f"cranedyn.plant.rigid_body.{what}", wrong)
    words = r"moves otherwise than in Pinocchio: accelerations differ by .* of the largest"
    with pytest.raises(ModelError, match=words):
        compile_forward_dynamics(model)


def test_states_that_do_not_fit_are_refused_and_no_states_are_none() -> None:
    made = compile_forward_dynamics(_robot("double_pendulum_continuous.urdf"))
    q, v = np.array([[1.0, 0.0, 1.0, 0.0]]), np.zeros((1, 2))
    with pytest.raises(OutOfRange, match=r"q is .* \(1, 2\); allowed is one of shape \(1, 4\)"):
        made(v, v, v)
    with pytest.raises(OutOfRange, match=r"tau is .* \(2,\); allowed is one of shape \(1, 2\)"):
        made(q, v, v[0])
    assert made(q[:0], v[:0], v[:0]).shape == (0, 2)


def test_each_row_is_answered_by_itself_and_what_goes_in_stays_as_it_was() -> None:
    model = _robot("ur5_robot.urdf")
    made, rng = compile_forward_dynamics(model), np.random.default_rng(2)
    states = rng.normal(size=(3, 5, model.nv))
    before = states.copy()
    together = made(*states)
    alone = [made(*(one[i : i + 1] for one in states))[0].tolist() for i in range(5)]
    assert alone == together.tolist()
    assert (states == before).all()


def test_compiling_draws_nothing_from_generators_that_others_share() -> None:
    pin.seed(0)
    first = pin.randomConfiguration(pin.buildSampleModelManipulator())
    pin.seed(0)
    compile_forward_dynamics(_tree(["revolute x"], 1, branch=False, armature=False))
    assert pin.randomConfiguration(pin.buildSampleModelManipulator()).tolist() == first.tolist()
