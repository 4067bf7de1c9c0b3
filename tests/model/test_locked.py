"""Joints that are held fixed: the crane without them, with their mass where they are held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.__main__ import main
from cranedyn.errors import DataError, ModelError, OutOfRange, UnknownName
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.options import parse_locked

LINK = """<link name="{0}"><inertial><origin xyz="0.2 0 -0.5"/><mass value="{1}"/>
<inertia ixx="5" iyy="6" izz="7" ixy="0" ixz="0" iyz="0"/></inertial></link>"""

JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>
<origin xyz="0.5 0 1" rpy="0.1 0.2 0"/><axis xyz="{4}"/>
<limit lower="-1.5" upper="1.5" effort="3e4" velocity="1"/>{5}</joint>"""

LOADER = (
    '<robot name="loader"><link name="truck"/>'
    + "".join(LINK.format(*link) for link in (("leg", 300), ("foot", 40), ("column", 900)))
    + "".join(LINK.format(*link) for link in (("jaw", 30), ("load", 100)))
    + JOINT.format("outrigger", "prismatic", "truck", "leg", "0 2 0", "")
    + JOINT.format("pad", "prismatic", "leg", "foot", "0 0 1",
                   '<mimic joint="outrigger" multiplier="-2" offset="0.1"/>')
    + JOINT.format("slew", "revolute", "truck", "column", "0 0 1", "")
    + JOINT.format("swing", "revolute", "column", "load", "1 0 0", "")
    + JOINT.format("grip", "revolute", "load", "jaw", "0 1 0", "")
    + "</robot>"
)  # fmt: skip
"""A loader on a truck: an outrigger whose pad mimics it, and a grapple at the load."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "loader.urdf"
    file.write_text(LOADER, encoding="utf-8")
    return file


def mass_matrix(crane: Crane, **coordinates: float) -> np.ndarray:
    q = np.zeros(crane.layout.n)
    for symbol, value in coordinates.items():
        q[crane.layout.index(symbol)] = value
    return pin.crba(crane.model, crane.data, q)


def test_a_locked_crane_has_the_inertia_of_the_free_one_at_that_coordinate(path: Path) -> None:
    free = load_crane(path, driven=["slew", "grip"], locked=["outrigger"], payload="swing")
    held = load_crane(path, driven=["slew"], locked={"outrigger": 0.3, "grip": 0.7})
    assert held.layout.symbols == ("slew", "swing")
    assert held.payload_mass == pytest.approx(130.0)
    at = free.layout.at("slew", "swing")
    theirs = mass_matrix(free, swing=0.4, grip=0.7)[np.ix_(at, at)]
    np.testing.assert_allclose(mass_matrix(held, swing=0.4), theirs, rtol=1e-12)


def test_a_joint_may_have_any_name(tmp_path: Path) -> None:
    path = tmp_path / "loader.urdf"
    path.write_text(LOADER.replace('"grip"', '"driver\'s &quot;grip&quot;"'), encoding="utf-8")
    crane = load_crane(path, driven=["slew"], locked=['driver\'s "grip"', "outrigger"])
    assert crane.layout.symbols == ("slew", "swing")


def test_what_mimics_a_locked_joint_is_held_with_it(path: Path) -> None:
    crane = load_crane(path, driven=["slew"], locked={"outrigger": 0.3, "grip": None})
    assert crane.assumptions[:3] == (
        "outrigger is locked at 0.3 m.",
        "pad is locked at -0.5 m.",
        "grip is locked at 0 rad.",
    )
    frames = pin.buildModelFromXML(crane.urdf)
    data = frames.createData()
    pin.framesForwardKinematics(frames, data, np.zeros(frames.nq))
    apart = data.oMf[frames.getFrameId("leg")].actInv(data.oMf[frames.getFrameId("foot")])
    tilt = pin.rpy.rpyToMatrix(0.1, 0.2, 0.0)
    expected = np.array([0.5, 0.0, 1.0]) + tilt @ [0.0, 0.0, -0.5]
    np.testing.assert_allclose(apart.translation, expected, atol=1e-12)


def test_a_locked_joint_is_no_longer_a_drive(path: Path) -> None:
    control = (
        '<ros2_control name="d" type="system"><joint name="slew"><command_interface name="effort"/>'
        '</joint><joint name="outrigger"><command_interface name="effort"/><state_interface '
        'name="position"><param name="initial_value">0.4</param></state_interface></joint>'
        "</ros2_control></robot>"
    )
    path.write_text(LOADER.replace("</robot>", control), encoding="utf-8")
    crane = load_crane(path, locked=["outrigger", "grip"])
    assert [joint.name for joint in crane.layout.driven] == ["slew"]
    assert "outrigger is locked at 0.4 m." in crane.assumptions
    again = load_crane(from_record={"crane": dict(crane.record)})
    assert again.layout == crane.layout


def test_a_joint_that_cannot_be_locked_is_refused(path: Path) -> None:
    with pytest.raises(UnknownName, match=r"no moving joint 'legs'.*"):
        load_crane(path, driven=["slew"], locked=["legs"])
    with pytest.raises(ModelError, match=r"pad in .* mimics outrigger; lock outrigger instead"):
        load_crane(path, driven=["slew"], locked=["pad"])
    with pytest.raises(ModelError, match=r"pad in .* mimics outrigger"):
        load_crane(path, driven=["slew"], locked={"outrigger": 0.3, "pad": 0.5})
    with pytest.raises(OutOfRange, match=r"locked grip is 2 rad; allowed is -1\.5 to 1\.5"):
        load_crane(path, driven=["slew"], locked={"grip": 2})
    with pytest.raises(OutOfRange, match="locked is given beside from_record"):
        load_crane(from_record={}, locked=["grip"])


def test_the_command_line_locks_joints_and_names_the_payload(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["describe", "--urdf", str(path), "--driven", "slew"]
    assert main([*common, "--locked", "outrigger=0.2", "grip"]) == 0
    out = capsys.readouterr().out
    assert "outrigger is locked at 0.2 m." in out and "payload of 130 kg" in out
    assert main([*common, "--locked", "outrigger", "--payload", "swing"]) == 0
    assert "payload of 100 kg" in capsys.readouterr().out
    assert main(common) == 2
    error = capsys.readouterr().err
    assert "or --payload, and hold those that do not matter by locked=[...], or --locked" in error
    assert main(["describe", "--locked", "yaw_joint"]) == 2
    assert "--locked is allowed only with --urdf" in capsys.readouterr().err


def test_a_text_that_locks_nothing_is_refused() -> None:
    assert parse_locked(["a", "b=1"]) == {"a": None, "b": "1"}
    for text in (["=1"], ["a", "a=2"]):
        with pytest.raises(DataError, match="not of the form JOINT or JOINT=VALUE"):
            parse_locked(text)


def test_a_crane_of_this_project_keeps_its_visuals_where_a_joint_is_locked() -> None:
    assert load_crane(locked=["yaw_joint"]).urdf.count("<visual") > 100
