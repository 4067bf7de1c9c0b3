"""A crane on a single rope that neither stretches nor goes slack, made from one whose rope does."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.model.crane import Crane
from cranedyn.model.rigid_rope import on_rigid_rope
from tests.helpers import crane

STRETCH = {"rope_stiffness": 1e7, "rope_damping": 500.0}


def mass_matrix(one: Crane, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(one.model, one.data, q))
    return upper + np.triu(upper, 1).T


def moved(one: Crane) -> np.ndarray:
    return one.start.q + 0.1 * np.random.default_rng(2).normal(size=one.layout.n)


@pytest.mark.parametrize(
    ("values", "left_out"),
    [
        (STRETCH, "rope_stretch_joint"),
        ({**STRETCH, "hook_mass": 200.0, "hook_inertia": 20.0}, "rope_stretch_joint"),
        ({"rope_stiffness": math.inf}, "rope_stretch_joint"),
        ({"fall_spacing": 1.0}, "load_yaw_joint"),
        ({"fall_spacing": 1.0, "hook_mass": 200.0, "hook_inertia": 20.0}, "load_yaw_joint"),
    ],
)
def test_the_crane_on_a_rigid_rope_has_the_inertia_and_weight_of_the_full_one(
    values: dict[str, Any], left_out: str
) -> None:
    full = crane(**values)
    rigid = on_rigid_rope(full)
    assert rigid.left_out == (left_out,)
    assert not rigid.crane.springs.any
    kept = list(rigid.kept)
    names = [joint.name for joint in full.layout.joints]
    assert [joint.name for joint in rigid.crane.layout.joints] == [names[i] for i in kept]
    assert [joint.role for joint in rigid.crane.layout.joints] == [
        full.layout.joints[i].role for i in kept
    ]
    assert rigid.crane.payload_mass == full.payload_mass
    # The other joints move; the one that is held stays at its start.
    q = full.start.q.copy()
    q[kept] = moved(full)[kept]
    expected = mass_matrix(full, q)[np.ix_(kept, kept)]
    assert_allclose(mass_matrix(rigid.crane, q[kept]), expected, rtol=1e-12, atol=1e-9)
    weight = pin.computeGeneralizedGravity(full.model, full.data, q)[kept]
    reduced = rigid.crane
    theirs = pin.computeGeneralizedGravity(reduced.model, reduced.data, q[kept])
    assert_allclose(theirs, weight, rtol=1e-12, atol=1e-9 * np.abs(weight).max())


def test_a_crane_whose_rope_is_rigid_stays_the_same() -> None:
    one = crane()
    rigid = on_rigid_rope(one)
    assert rigid.crane is one
    assert rigid.kept == tuple(range(5))
    assert rigid.left_out == ()


def test_masses_and_damping_that_are_not_those_of_the_urdf_are_kept() -> None:
    full = crane(**STRETCH)
    heavier = crane(**STRETCH, payload_mass=1500.0)
    twin = replace(full, model=heavier.model, damping=2.0 * full.damping)
    rigid = on_rigid_rope(twin)
    assert rigid.crane.payload_mass == 1500.0
    assert rigid.crane.damping.tolist() == (2.0 * full.damping[list(rigid.kept)]).tolist()
