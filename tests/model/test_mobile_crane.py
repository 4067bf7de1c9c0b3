"""The mobile crane of this project: its statics by hand, its telescope, and what it does alike in
both engines.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.controllers import hold_controller, lqr
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import ModelError
from cranedyn.export import gazebo, ros2
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import XACRO, arguments
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold
from cranedyn.simulation.simulate import simulate
from tests.helpers import alike_in_both_engines

MOBILE = XACRO.with_name("mobile_crane.urdf.xacro")

LOAD = 4000.0
DUMMIES = 60.0
"""Mass of both links between the swing joints [kg]."""


@cache
def mobile(**values: float) -> Crane:
    return load_crane(MOBILE, values=values)


def test_every_argument_of_the_mobile_crane_is_documented_and_used() -> None:
    text = MOBILE.read_text("utf-8")
    for name, argument in arguments(MOBILE).items():
        assert argument.allowed, name
        assert argument.unit or "whole number" in argument.allowed, name
        assert len(argument.meaning) > 10, name
        assert f"$(arg {name})" in text, name


def test_its_sections_extend_together_from_its_shortest_to_its_longest_boom() -> None:
    crane = mobile()
    head = crane.model.getJointId("swing_radial_joint")
    hinge = crane.model.getJointId("luff_joint")
    data = crane.model.createData()
    for extension, length in ((0.0, 11.0), (5.0, 26.0), (8.2, 35.6)):
        q = crane.state(telescope=extension, luff=0.7, slew=0.4).q
        pin.forwardKinematics(crane.model, data, q)
        boom = data.oMi[head].translation - data.oMi[hinge].translation
        assert np.linalg.norm(boom) == pytest.approx(length)
        assert np.arcsin(boom[2] / length) == pytest.approx(0.7)
        # Turned from -Y by the slew angle.
        assert np.arctan2(boom[0], -boom[1]) == pytest.approx(0.4)


@pytest.mark.parametrize(("extension", "luff"), [(0.0, 0.3), (5.0, 1.0), (8.2, 1.4)])
def test_its_drives_hold_what_statics_by_hand_say(extension: float, luff: float) -> None:
    """Centres of the sections along the boom, from their tails and fronts with a boom_min of 11 m;
    section k has moved by k times the extension.
    """
    crane = mobile()
    q = crane.hanging(crane.state(telescope=extension, luff=luff).q)
    slew, luffing, telescope, hoist = holding_effort(crane, q)
    sections = [
        (3200.0, (-0.3 + 9.8) / 2.0, 0),
        (2100.0, (0.6 + 10.2) / 2.0, 1),
        (1600.0, (0.8 + 10.6) / 2.0, 2),
        (1300.0, (1.0 + 11.0) / 2.0, 3),
        (LOAD + DUMMIES, 11.0, 3),
    ]
    moment = sum(mass * (centre + k * extension) for mass, centre, k in sections)
    along = sum(mass * k for mass, _, k in sections)
    assert slew == pytest.approx(0.0, abs=1e-6)
    assert luffing == pytest.approx(moment * np.cos(luff) * STANDARD_GRAVITY, rel=1e-9)
    assert telescope == pytest.approx(along * np.sin(luff) * STANDARD_GRAVITY, rel=1e-9)
    assert abs(hoist) == pytest.approx(LOAD * STANDARD_GRAVITY, rel=1e-9)


def test_its_hoist_is_as_strong_as_its_falls() -> None:
    limits = {}
    for falls in (2, 6):
        crane = mobile(falls=falls)
        limits[falls] = (crane.effort_limit[3], crane.model.velocityLimit[crane.layout.index("l")])
    assert limits[2] == pytest.approx((72e3, 1.05))
    assert limits[6] == pytest.approx((216e3, 0.35))
    assert mobile(hoist_effort=9e4).effort_limit[3] == pytest.approx(9e4)


def test_it_stands_without_its_counterweight() -> None:
    def mass(crane: Crane) -> float:
        return sum(inertia.mass for inertia in crane.model.inertias)

    assert mass(mobile()) - mass(mobile(counterweight=0.0)) == pytest.approx(12e3)


@pytest.mark.slow
def test_both_engines_move_it_alike_while_it_slews_luffs_and_telescopes() -> None:
    crane = mobile()
    start = crane.state(swing_radial=-0.9, theta=0.05, telescope=4.0)

    def command(t: float, state: object, setpoint: object) -> np.ndarray:
        return np.array([0.1, -0.02, 0.08, 0.2]) * np.cos(t)

    run = alike_in_both_engines(
        crane, command, start=start, duration=1.0, drive="velocity", validity="mark"
    )
    extension = run.q[:, crane.layout.at("telescope", "section_2", "section_3")]
    assert np.ptp(extension[:, 0]) > 0.01
    assert np.ptp(extension, axis=1).max() < 1e-12


@pytest.mark.slow
def test_an_lqr_brings_it_to_rest_at_another_boom_and_angle() -> None:
    crane = mobile()
    goal = crane.state(telescope=5.2, luff=1.02, slew=0.02)
    controller = lqr(crane, hanging_reference(crane, hold(crane, goal), 30.0))
    run = simulate(crane, controller, hold(crane, goal), duration=60.0, engine="compiled")
    resting = crane.resting(goal.q)
    assert np.abs(run.q[-1] - resting).max() < 1e-3


def test_what_no_simulator_would_couple_is_refused_or_said(tmp_path: Path) -> None:
    program = gazebo.Program(mobile(), hold_controller(mobile()), None, mobile().start, 0.1)
    with pytest.raises(ModelError, match=r"The export to Gazebo Classic is made for joints that"):
        gazebo.export(tmp_path / "gazebo", program)
    package = ros2.export(tmp_path / "mobile", mobile())
    notes = (package / "README.md").read_text()
    assert "section_3_joint follows telescope_joint (<mimic>)" in notes
    urdf = (package / "urdf" / "crane.urdf").read_text()
    assert urdf.count("<mimic") == 2
    assert "hydraulicCylinder" not in urdf  # which only this project reads


@pytest.mark.slow
def test_its_hold_controller_keeps_it_where_it_starts() -> None:
    crane = mobile()
    run = simulate(crane, hold_controller(crane), duration=5.0, engine="compiled")
    assert np.abs(run.q - crane.resting(crane.start.q)).max() < 1e-3
