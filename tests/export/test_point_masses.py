"""Hook blocks that are points in the crane, as bodies for other programs."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.dynamics.equations_of_motion import over_all_joints
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.export import gazebo, ros2
from cranedyn.export.crane_data import urdf_element
from cranedyn.export.gazebo import Program
from cranedyn.export.point_masses import ball_inertia, ball_radius, give_bodies_to_points
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane
from tests.oracles.sdf import build_probe, dynamics, read_with_libsdformat
from tests.system.test_cross_engines import DT, PERIOD

POINTS: dict[str, dict[str, float]] = {
    "hook": {"hook_mass": 200.0},
    "falls": {"fall_spacing": 1.0},
    "hook on falls": {"fall_spacing": 1.0, "hook_mass": 200.0},
}
"""Arguments of cranes with links that have no mass or no inertia."""


def mass_matrix(one: Crane, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(one.model, one.data, q))
    return upper + np.triu(upper, 1).T


def moved(one: Crane) -> np.ndarray:
    return one.start.q + 0.1 * np.random.default_rng(4).normal(size=one.layout.n)


def masses(robot: ET.Element) -> dict[str, float]:
    found = {}
    for link in robot.iterfind("link"):
        mass = link.find("inertial/mass")
        found[link.get("name", "")] = 0.0 if mass is None else float(mass.get("value", "0"))
    return found


def test_a_ball_of_steel_has_the_mass_of_its_volume_and_the_inertia_of_a_ball() -> None:
    # 1 m³ of steel weighs 7850 kg.
    assert 4.0 / 3.0 * math.pi * ball_radius(7850.0) ** 3 == pytest.approx(1.0)
    assert ball_inertia(7850.0) == pytest.approx(0.4 * 7850.0 * ball_radius(7850.0) ** 2)


def test_parts_of_a_hook_block_weigh_what_the_hook_weighs() -> None:
    one = crane(**POINTS["hook on falls"])
    robot = urdf_element(one)
    before = masses(robot)
    notes = give_bodies_to_points(one, robot)
    after = masses(robot)
    assert sum(after.values()) == pytest.approx(sum(before.values()), rel=1e-14)
    changed = [name for name in before if before[name] != after[name]]
    assert changed == ["falls_link", "hook_link", "sling_link"]
    assert after["falls_link"] == 2.0
    for name in changed:
        assert any(f"The link {name} " in note for note in notes)


@pytest.mark.parametrize(
    "values", [{}, {"payload_inertia": 0.0}, {"hook_mass": 200.0, "hook_inertia": 20.0}]
)
def test_a_crane_without_such_links_stays_as_it_is_and_a_load_that_is_a_point_one(
    values: dict[str, float],
) -> None:
    one = crane(**values)
    robot = urdf_element(one)
    before = ET.tostring(robot)
    assert give_bodies_to_points(one, robot) == []
    assert ET.tostring(robot) == before


@pytest.mark.parametrize("name", list(POINTS))
def test_the_mass_matrix_is_that_of_the_crane_with_the_inertia_of_the_balls_added(
    name: str, tmp_path: Path
) -> None:
    one = crane(**POINTS[name])
    urdf = ros2.export(tmp_path / "out", one) / "urdf" / "crane.urdf"
    same = load_crane(urdf, gravity=one.gravity)
    assert same.layout.symbols == one.layout.symbols
    q = moved(one)
    expected = mass_matrix(one, q)
    hook_mass = POINTS[name].get("hook_mass", 0.0)
    # No coordinate turns the hook, or a part of the load, by more than one rad per unit: the
    # entries grow by the inertia of the hook at most. The yaw of the load loses that of its part.
    allowed = ball_inertia(hook_mass) + ball_inertia(10.0)
    assert np.abs(mass_matrix(same, q) - expected).max() <= 1.05 * allowed
    # Weights do not change at all but for rounding.
    weight = pin.computeGeneralizedGravity(one.model, one.data, q)
    theirs = pin.computeGeneralizedGravity(same.model, same.data, q)
    assert_allclose(theirs, weight, rtol=0.0, atol=1e-12 * np.abs(weight).max())


@pytest.mark.parametrize("length", [5.0, 15.0])
def test_a_ball_instead_of_a_point_lowers_the_frequencies_by_less_than_three_in_ten_thousand(
    length: float,
) -> None:
    # docs/howto/export.md
    inertia = ball_inertia(200.0)
    found = []
    for one in (
        crane(hook_mass=200.0, hoist_init=length),
        crane(hook_mass=200.0, hook_inertia=inertia, hoist_init=length),
    ):
        found.append(free_modes(one, one.start).frequencies)
    point, ball = found
    assert ((ball < point) & (ball > (1.0 - 3e-4) * point)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(POINTS))
def test_libsdformat_mujoco_and_dart_read_the_exported_mass_matrix(
    name: str, tmp_path: Path
) -> None:
    urdf = ros2.export(tmp_path / "out", crane(**POINTS[name])) / "urdf" / "crane.urdf"
    same = load_crane(urdf)
    q = moved(same)
    expected = mass_matrix(same, q)
    found = _mass_matrices(urdf, same, q)
    for matrix in found.values():
        # rounding: some ten products of matrices
        assert_allclose(matrix, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def _mass_matrices(urdf: Path, same: Crane, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return the mass matrix of a URDF at coordinates of a crane in each program that is here."""
    found = {}
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    # MuJoCo's reader of URDF knows neither ros2_control nor Gazebo's tags, and skips them.
    model = mujoco.MjModel.from_xml_path(str(urdf))
    data = mujoco.MjData(model)
    names = [joint.name for joint in same.layout.joints]
    assert [model.joint(i).name for i in range(model.njnt)] == names
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    matrix = np.zeros((len(q), len(q)))
    mujoco.mj_fullM(model, data, matrix)
    found["mujoco"] = matrix

    dart = pytest.importorskip("dartpy", reason="dartpy is not installed")
    skeleton = dart.utils.DartLoader().parseSkeleton(str(urdf))
    assert [skeleton.getDof(i).getName() for i in range(skeleton.getNumDofs())] == names
    skeleton.setPositions(q)
    found["dart"] = skeleton.getMassMatrix()

    (tree,) = read_with_libsdformat(build_probe(), [urdf])
    found["libsdformat"], _ = dynamics(tree, names, q, same.gravity)
    return found


@pytest.mark.slow
def test_a_load_on_a_hook_that_is_a_point_moves_in_dart_as_the_exported_crane_does_here(
    tmp_path: Path,
) -> None:
    dart = pytest.importorskip("dartpy", reason="dartpy is not installed")
    point = load_crane(hook_mass=200.0, damp_swing=0.0)
    urdf = ros2.export(tmp_path / "out", point) / "urdf" / "crane.urdf"
    same = load_crane(urdf)
    how: dict[str, Any] = {"duration": 5.0, "dt": DT, "control_period": PERIOD}
    start = same.state(phi=0.2, theta=-0.15)
    run = simulate(same, hold_controller(same), start=start, **how)
    skeleton = dart.utils.DartLoader().parseSkeleton(str(urdf))
    world = dart.simulation.World()
    world.setGravity([0.0, 0.0, -same.gravity])
    world.setTimeStep(DT)
    world.addSkeleton(skeleton)
    skeleton.setPositions(run.q[0])
    rows = []
    for efforts in run.effort:
        rows.append(skeleton.getPositions())
        for _ in range(round(PERIOD / DT)):
            skeleton.setForces(over_all_joints(same, efforts))
            world.step()
    # rounding
    assert_allclose(rows, run.q, rtol=0.0, atol=1e-11)

    # The frequencies differ from those of a point by 3e-4 at most: 3.7 rad/s · 5 s · 3e-4 of a
    # phase, of a swing of the sling of 0.1 rad.
    as_point = simulate(point, hold_controller(point), start=start, **how)
    off = np.abs(run.q - as_point.q)[:, point.swings].max()
    assert 0.0 < off < 0.5e-3


def test_the_readme_says_which_links_are_changed(tmp_path: Path) -> None:
    one = crane(**POINTS["hook"])
    package = ros2.export(tmp_path / "package", one)
    program = Program(one, hold_controller(one), None, one.start, 1.0)
    folder = gazebo.export(tmp_path / "folder", program)
    for path in (package, folder):
        text = (path / "README.md").read_text(encoding="utf-8")
        assert "The link hook_link of 200 kg is a point in the crane." in text
        assert "solid ball of steel (7850 kg/m³)" in text
