"""The model of a stage and the weights of a horizon, by matrix exponentials and differences."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from llvmlite import ir
from numpy.testing import assert_allclose

from cranedyn.compiled.horizon import horizon_model
from cranedyn.compiled.horizon.receding import Receding, receding
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane
from tests.model.test_hanging import ECCENTRIC, LUFFING


def made_for(one: Crane) -> Receding:
    limits = Limits((0.05,) * one.layout.m, (0.02,) * one.layout.m)
    return receding(one, limits, drive="motion")


def test_a_stage_is_the_exponential_of_the_linear_crane_to_the_fourth_power_of_its_length() -> None:
    tower = crane()
    plant = made_for(tower).programme.plant
    n = tower.layout.n
    m = tower.layout.m
    q = tower.start.q
    still = np.zeros(n)
    length = 0.6
    entries = horizon_model.stage_model(plant, length, q, still, np.zeros(m))
    found = np.zeros((2 * n, 2 * n + m))
    for name, i, j, value in entries:
        if name == "forward":
            found[i, j] = value
    # About the plumb load: a pendulum of nearly ω² = g/l in each plane, moved by the trolley, and
    # by the slew at the radius of 10 m.
    squared = tower.gravity / q[4]
    derivatives = horizon_model.crane_derivatives(plant, q, still, np.zeros(m))
    rates = derivatives.acceleration_slopes.astype(float)
    inertia_of_the_load = 3e-3  # as a share of m l²
    assert_allclose(rates[[2, 3], [2, 3]], -squared, rtol=inertia_of_the_load)
    moved = np.abs(rates[2:4, 2 * n :]).max(axis=0)
    assert_allclose(moved, [10.0 / q[4], 1.0 / q[4], 0.0], rtol=inertia_of_the_load)
    continuous = np.zeros((2 * n + m, 2 * n + m))
    continuous[:n, n : 2 * n] = np.eye(n)
    continuous[n : 2 * n] = rates
    exact = scipy.linalg.expm(length * continuous)[: 2 * n]
    # The first term that is left out: (ω h)⁵ / 5!, of an angle in terms of a rate over ω.
    phase = math.sqrt(squared) * length
    assert_allclose(found, exact, rtol=0.0, atol=1.1 * phase**5 / 120.0 / math.sqrt(squared))
    assert np.abs(found - exact).max() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "changes"),
    [(LUFFING, (-0.2, 0.0, 0.3)), (ECCENTRIC, (-2.0, -0.2, 0.3, 2.0))],
    ids=["luffing", "eccentric"],
)
def test_a_goal_hangs_where_the_load_rests_for_positions_of_the_drives(
    text: str, changes: tuple[float, ...], tmp_path: Path
) -> None:
    (tmp_path / "crane.urdf").write_text(text)
    one = load_crane(tmp_path / "crane.urdf")
    plant = made_for(one).programme.plant
    for change in changes:
        q = one.start.q.copy()
        q[one.layout.drives] += change
        # To first order alone the eccentric load would be off by 1e-6 to 1e-4 rad.
        found = horizon_model.hanging(plant, q[one.layout.drives]).astype(float)
        assert_allclose(found, one.resting(q), rtol=0.0, atol=1e-12)


def test_weights_are_those_of_the_payload_and_of_the_joints_by_differences() -> None:
    tower = crane()
    made = made_for(tower)
    n = tower.layout.n
    programme = made.programme
    shape = made.programme.shape(1)
    module = ir.Module()
    work = np.zeros(shape.size)
    errors = np.arange(1.0, 1.0 + 2 * n).reshape(2, n)
    horizon_model.emit_weights(module, shape, programme.plant, errors, np.array([0.1, 0.5]))
    goal = tower.state(gamma=0.3, x=12.0, l=11.0).q
    work[shape.offset("goal") :][:n] = goal
    machine = translate(module)
    machine.function("weigh", 1)(work.ctypes.data)
    rows = [work[shape.offset("weight", i) :][: 2 * n] for i in range(2 * n)]
    step = 1e-5 * np.eye(n)
    jacobian = np.stack(
        [
            (payload_position(tower, goal + h) - payload_position(tower, goal - h)) / 2e-5
            for h in step
        ],
        axis=1,
    )
    expected = np.zeros((2 * n, 2 * n))
    for block, error in enumerate((0.1, 0.5)):
        part = slice(block * n, (block + 1) * n)
        expected[part, part] = jacobian.T @ jacobian / error**2 + np.diag(errors[block] ** -2.0)
    assert_allclose(np.array(rows), expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_a_boom_luffs_to_its_goal_although_its_load_hangs_at_another_angle_there(
    tmp_path: Path,
) -> None:
    (tmp_path / "crane.urdf").write_text(LUFFING)
    one = load_crane(tmp_path / "crane.urdf")
    limits = Limits((0.05, 0.03, 0.5), (0.02, 0.02, 0.3))
    # The swing joint turns by 0.2 rad with the boom, four times the swing that is allowed.
    controller = receding(one, limits, drive="motion", swing_limit=0.05)
    target = one.state(luff=0.8)
    run = simulate(
        one, controller, hold(one, target), duration=30.0, drive="motion", engine="compiled"
    )
    assert np.abs(one.swing_angles(run.q)).max() < 0.06
    assert_allclose(run.q[-1], target.q, rtol=0.0, atol=2e-3)
