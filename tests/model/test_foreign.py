"""URDF of other cranes: ROS packages, missing swing joints, other directions and signs; exports of
foreign cranes, an MJCF among them.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import cranedyn as cd
from cranedyn.controllers.hold import hold_controller
from cranedyn.errors import CraneError, ModelError, OutOfRange, UnknownName
from tests.portal import portal_crane

RIGID = """<robot name="rigid">
  <link name="ground"/>
  <link name="upper"><inertial><origin xyz="0 0 2.01"/><mass value="3000"/>
    <inertia ixx="1e6" iyy="1e6" izz="1e6" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="carriage"><inertial><mass value="500"/>
    <inertia ixx="50" iyy="50" izz="50" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://rigid/meshes/carriage.stl"/></geometry></visual>
  </link>
  <link name="hook"><inertial><mass value="1000"/>
    <inertia ixx="400" iyy="400" izz="400" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="azimuth" type="revolute">
    <parent link="ground"/><child link="upper"/><origin xyz="0 0 25.99"/><axis xyz="0 0 -1"/>
    <limit lower="-3" upper="3" effort="1e6" velocity="0"/>
  </joint>
  <joint name="cart" type="prismatic">
    <parent link="upper"/><child link="carriage"/><origin xyz="22 0 2.01" rpy="0 0 1.2"/>
    <axis xyz="-0.36235775447667 0.93203908596723 0"/>
    <limit lower="0" upper="20" effort="1e6" velocity="10"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="carriage"/><child link="hook"/>
    <origin xyz="0 0 -26.4" rpy="3.141592653589793 0 0"/>
    <axis xyz="0 0 -1"/><limit lower="0" upper="23" effort="1e5" velocity="5"/>
  </joint>
</robot>"""
"""The tower crane of this project without swing, in other directions: slew about -Z, jib along +X,
trolley inwards from its outer end, hook upwards from the ground."""

HEAVY = """<mujoco model="bridge">
  <compiler angle="radian"/>
  <worldbody>
    <body name="bridge" pos="0 0 10">
      <inertial mass="10" pos="0 0 0" diaginertia="1 1 1"/>
      <joint name="travel" type="slide" axis="1 0 0" range="-5 5"/>
      <body name="rope">
        <inertial mass="0.001" pos="0 0 0" diaginertia="1e-6 1e-6 1e-6"/>
        <joint name="swivel" type="ball" damping="0.5"/>
        <body name="load" pos="0 0 -5">
          <joint name="winch" type="slide" axis="0 0 1" range="-1 3"/>
          <geom type="sphere" size="0.1" mass="20"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="travel"/><motor joint="winch"/></actuator>
  <keyframe><key name="home" qpos="0 1 0 0 0 0"/></keyframe>
</mujoco>"""


def saved(folder: Path, text: str, name: str = "crane.urdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_rigid_crane_in_other_directions_swings_as_that_of_this_project(tmp_path: Path) -> None:
    ours = cd.load_crane(dummy_mass=1.0, dummy_inertia=1e-3, damp_swing=1.0)
    theirs = cd.load_crane(saved(tmp_path, RIGID), swing={"damping": 1.0})
    assert theirs.layout.symbols == ours.layout.symbols
    assert [joint.role for joint in theirs.layout.joints] == [
        joint.role for joint in ours.layout.joints
    ]
    np.testing.assert_allclose(theirs.lower[[1, 4]], [2.0, 3.4], atol=1e-12)
    np.testing.assert_allclose(theirs.upper[[1, 4]], [22.0, 26.4], atol=1e-12)

    def setpoint(t: float) -> cd.Setpoint:
        return cd.Setpoint(
            [0.3 * math.sin(0.2 * t), 10.0 + math.sin(0.3 * t), 15.0 - 0.2 * t],
            [0.06 * math.cos(0.2 * t), 0.3 * math.cos(0.3 * t), -0.2],
            [-0.012 * math.sin(0.2 * t), -0.09 * math.sin(0.3 * t), 0.0],
        )

    start = ours.state(x=10.0, l=15.0, phi=0.2, theta=-0.1)
    controller = hold_controller(ours)
    runs = [
        cd.simulate(crane, controller, setpoint, start=start, duration=10.0)
        for crane in (ours, theirs)
    ]
    np.testing.assert_allclose(runs[1].q, runs[0].q, atol=1e-12)
    np.testing.assert_allclose(runs[1].v, runs[0].v, atol=1e-12)
    assert theirs.assumptions == (
        "velocity limit 0 of azimuth read as none.",
        "All joints of the file are driven.",
        "gamma = 1.5708 rad - azimuth, the heading of the jib, 0 along -Y.",
        "x = 22 m - cart, the radius from the slew axis.",
        "The pivot is at the height of carriage.",
        "l = 26.4 m - lift, the length of the rope.",
        "Two links of 1 kg and 0.001 kg m² are at the pivot.",
    )
    again = cd.load_crane(from_record={"crane": theirs.record})
    assert again.layout == theirs.layout
    np.testing.assert_array_equal(again.model.inertias[3].mass, theirs.model.inertias[3].mass)


def test_rope_and_load_can_be_given(tmp_path: Path) -> None:
    swing = {"length": 30.0, "mass": 2000.0, "damping": 3.0}
    crane = cd.load_crane(saved(tmp_path, RIGID), swing=swing)
    assert crane.payload_mass == 2000.0
    np.testing.assert_allclose(crane.payload_inertia, np.eye(3) * 800.0)
    assert crane.damping[crane.layout.at("phi", "theta")].tolist() == [3.0, 3.0]
    np.testing.assert_allclose([crane.lower[4], crane.upper[4], crane.start.q[4]], [7, 30, 18.5])


def test_a_swing_without_numbers_has_the_default_ones(tmp_path: Path) -> None:
    path = saved(tmp_path, RIGID)
    assert cd.load_crane(path, swing={}).record == cd.load_crane(path, swing=True).record


def test_the_mass_of_a_swing_is_that_of_all_that_the_hoist_carries(tmp_path: Path) -> None:
    container = (
        '<link name="box"><inertial><mass value="3000"/>'
        '<inertia ixx="90" iyy="90" izz="90" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="twistlock" type="fixed"><parent link="hook"/><child link="box"/>'
        '<origin xyz="0 0 1"/></joint></robot>'
    )
    path = saved(tmp_path, RIGID.replace("</robot>", container))
    as_drawn = cd.load_crane(path, swing=True)
    lighter = cd.load_crane(path, swing={"mass": 400.0})
    assert as_drawn.payload_mass == 4000.0
    assert lighter.payload_mass == pytest.approx(400.0)
    np.testing.assert_allclose(lighter.payload_inertia, as_drawn.payload_inertia / 10.0)
    np.testing.assert_allclose(lighter.payload.lever, as_drawn.payload.lever)


FOLLOWER = """<link name="stay"><inertial><mass value="10"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slider" type="prismatic"><parent link="upper"/><child link="stay"/>
    <axis xyz="1 0 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
    <mimic joint="cart" multiplier="0.25" offset="0.5"/></joint></robot>"""


def test_what_follows_a_trolley_or_holds_it_by_a_spring_does_so_in_its_new_coordinate(
    tmp_path: Path,
) -> None:
    spring = (
        '<gazebo reference="cart"><springStiffness>700</springStiffness>'
        "<springReference>4</springReference></gazebo></robot>"
    )
    text = RIGID.replace("</robot>", FOLLOWER).replace("</robot>", spring)
    crane = cd.load_crane(saved(tmp_path, text), swing=True)
    # The radius is x = 22 m - cart.
    state = crane.state(x=10.0)
    assert state.q[crane.layout.index("slider")] == pytest.approx(0.25 * 12.0 + 0.5)
    trolley = crane.layout.index("x")
    assert crane.springs.rest[trolley] == pytest.approx(18.0)
    assert "All joints of the file are driven." in crane.assumptions
    assert not crane.layout.joints[crane.layout.index("slider")].driven


def test_a_hoist_that_follows_another_joint_gets_no_swing(tmp_path: Path) -> None:
    mimic = '<mimic joint="cart"/></joint>\n</robot>'
    text = RIGID.replace("</joint>\n</robot>", mimic)
    with pytest.raises(ModelError, match=r"needs one hoist .* it has none"):
        cd.load_crane(saved(tmp_path, text), swing=True)
    carriage = RIGID.replace('velocity="10"/>', 'velocity="10"/><mimic joint="azimuth"/>')
    with pytest.raises(ModelError, match=r"has cart between .* follows azimuth; .*locked=\['azi"):
        cd.load_crane(saved(tmp_path, carriage), swing=True)


def test_a_slewing_ring_below_a_trolley_makes_no_tower_crane(tmp_path: Path) -> None:
    parts = {
        "ground": '<link name="ground"/>',
        "azimuth": '<parent link="carriage"/><child link="upper"/>',
        "cart": '<parent link="ground"/><child link="carriage"/>',
        "lift": '<parent link="upper"/><child link="hook"/>',
    }
    text = (
        RIGID.replace('<parent link="ground"/><child link="upper"/>', parts["azimuth"])
        .replace('<parent link="upper"/><child link="carriage"/>', parts["cart"])
        .replace('<parent link="carriage"/><child link="hook"/>', parts["lift"])
    )
    crane = cd.load_crane(saved(tmp_path, text), swing=True)
    assert crane.layout.symbols == ("cart", "azimuth", "phi", "theta", "l")
    assert not crane.layout.has("slew")


def test_a_start_that_is_no_number_is_named_where_a_swing_is_added(tmp_path: Path) -> None:
    control = (
        '<ros2_control name="c" type="system"><joint name="cart">'
        '<command_interface name="effort"/><state_interface name="position">'
        '<param name="initial_value">far</param></state_interface></joint></ros2_control></robot>'
    )
    text = RIGID.replace("</robot>", control)
    driven = ["azimuth", "lift"]
    for name in driven:
        text = text.replace(
            "</ros2_control>",
            f'<joint name="{name}"><command_interface name="effort"/></joint></ros2_control>',
        )
    with pytest.raises(OutOfRange, match="cart at the start is far"):
        cd.load_crane(saved(tmp_path, text), swing=True)
    short = cd.load_crane(saved(tmp_path, RIGID), swing={"length": 20.0})
    np.testing.assert_allclose([short.lower[4], short.upper[4]], [0.4, 20.0])
    assert "The shortest rope is 0.4 m." in short.assumptions


def test_a_hoist_that_its_file_starts_at_an_end_of_its_range_holds_a_swinging_load(
    tmp_path: Path,
) -> None:
    interfaces = '<command_interface name="effort"/><state_interface name="position">'
    start = '<param name="initial_value">0.0</param></state_interface>'
    drives = "".join(
        f'<joint name="{name}">{interfaces}{start}</joint>' for name in ("azimuth", "cart", "lift")
    )
    text = RIGID.replace("</robot>", f'<ros2_control name="all">{drives}</ros2_control></robot>')
    crane = cd.load_crane(saved(tmp_path, text), swing=True)
    assert crane.start.q[4] == pytest.approx(26.4 - 0.01 * 23.0)  # the file's zero is the lowest
    cd.simulate(crane, hold_controller(crane), start=crane.state(phi=0.1), duration=5.0)


@pytest.mark.parametrize(
    ("changes", "swing", "error", "message"),
    [
        ({}, {"rope": 2.0}, UnknownName, "number of the swing"),
        ({}, {"mass": -2.0}, OutOfRange, "mass of the swing"),
        ({}, {"damping": math.nan}, OutOfRange, "damping of the swing"),
        ({'lower="0" upper="23"': 'lower="1" upper="23"'}, {"length": 0.5}, OutOfRange, "longest"),
        (
            {'"lift" type="prismatic"': '"lift" type="revolute"'},
            True,
            ModelError,
            "needs one hoist",
        ),
        ({'rpy="3.141592653589793 0 0"': 'rpy="3.1 0 0"'}, True, ModelError, "it has none"),
    ],
)
def test_a_swing_that_cannot_be_is_refused(
    tmp_path: Path,
    changes: dict[str, str],
    swing: dict[str, float] | bool,
    error: type[CraneError],
    message: str,
) -> None:
    text = RIGID
    for old, new in changes.items():
        text = text.replace(old, new)
    with pytest.raises(error, match=message):
        cd.load_crane(saved(tmp_path, text), swing=swing)


def test_a_crane_that_swings_gets_no_second_swing() -> None:
    with pytest.raises(ModelError, match="has the passive joint swing_radial_joint"):
        cd.load_crane(swing=True)


def test_axes_are_judged_by_a_milliradian(tmp_path: Path) -> None:
    leaning = RIGID.replace('rpy="3.141592653589793 0 0"', 'rpy="3.1410 0 0"')
    assert cd.load_crane(saved(tmp_path, leaning), swing=True).layout.has("hoist")


def test_names_of_a_tower_crane_on_a_gantry_give_no_roles(tmp_path: Path) -> None:
    text = (
        RIGID.replace("azimuth", "trolley_joint")
        .replace('type="revolute"', 'type="prismatic"')
        .replace('xyz="0 0 -1"/>\n    <limit lower="-3"', 'xyz="1 0 0"/>\n    <limit lower="-3"')
    )
    crane = cd.load_crane(saved(tmp_path, text), driven=["trolley_joint", "cart", "lift"])
    assert crane.layout.symbols == ("trolley", "cart", "lift")
    assert not crane.layout.has("trolley")


def test_transmissions_say_what_is_driven_and_limits_of_passive_joints_do_not_matter(
    tmp_path: Path,
) -> None:
    transmission = '<transmission name="t"><joint name="azimuth"/></transmission></robot>'
    text = RIGID.replace("</robot>", transmission).replace('effort="1e5"', 'effort="0"')
    crane = cd.load_crane(saved(tmp_path, text))
    assert [joint.driven for joint in crane.layout.joints] == [True, False, False]
    assert crane.rate_limit.tolist() == [math.inf]


PACKAGE = "<package><name>{}</name></package>"
INCLUDING = """<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="$(find parts)/urdf/parts.xacro"/></robot>"""


@pytest.mark.parametrize("place", ["above", "beside", "given", "ament", "ros"])
def test_a_package_is_found_without_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    home = {
        "above": "space/parts", "beside": "space/parts", "given": "else/where",
        "ament": "else/share/parts", "ros": "else/parts",
    }[place]  # fmt: skip
    saved(tmp_path, PACKAGE.format("parts"), f"{home}/package.xml")
    saved(tmp_path, RIGID, f"{home}/urdf/parts.xacro")
    mine = "space/parts" if place == "above" else "space/mine"
    saved(tmp_path, PACKAGE.format(mine[6:]), f"{mine}/package.xml")
    path = saved(tmp_path, INCLUDING, f"{mine}/urdf/crane.urdf.xacro")
    if place in ("ament", "ros"):
        folder = str(tmp_path / "else")
        monkeypatch.setenv({"ament": "AMENT_PREFIX_PATH", "ros": "ROS_PACKAGE_PATH"}[place], folder)
    packages = {"parts": tmp_path / home} if place == "given" else None
    crane = cd.load_crane(path, swing=True, packages=packages)
    assert crane.layout.has("slew", "trolley", "hoist")


def test_a_package_that_is_nowhere_is_named(tmp_path: Path) -> None:
    path = saved(tmp_path, INCLUDING, "mine/urdf/crane.urdf.xacro")
    with pytest.raises(ModelError, match=r"needs the ROS package parts, .* --package parts=FOLDER"):
        cd.load_crane(path)


def test_describe_says_what_was_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cranedyn.__main__ import main

    path = saved(tmp_path, RIGID)
    target = tmp_path / "whole.urdf"
    assert main(["describe", "--urdf", str(path), "--swing", "mass:=50", "-o", str(target)]) == 0
    assert "x = 22 m - cart, the radius from the slew axis." in capsys.readouterr().out
    roles = [f"{role}={name}" for role, name in (("slew", "azimuth"), ("trolley", "cart"),
             ("radial_swing", "swing_radial_joint"), ("hoist", "lift"))]  # fmt: skip
    driven = ["azimuth", "cart", "lift"]
    assert main(["describe", "--urdf", str(target), "--driven", *driven, "--role", *roles]) == 0
    assert "payload of 50 kg" in capsys.readouterr().out
    assert main(["describe", "--swing"]) == 2
    assert "--swing is allowed only with --urdf" in capsys.readouterr().err
    assert main(["describe", "--urdf", str(path), "--role", "slew"]) == 2
    assert "of --role is not of the form" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("exporter", ["mjcf", "ros2", "fmu", "gazebo"])
@pytest.mark.parametrize("options", [["rigid.urdf", "--swing"], ["bridge.xml"]])
def test_a_foreign_crane_is_exported(tmp_path: Path, exporter: str, options: list[str]) -> None:
    from cranedyn.__main__ import main

    if "bridge.xml" in options:
        pytest.importorskip("mujoco", reason="extra mujoco is not installed")

    path = saved(tmp_path, RIGID if "--swing" in options else HEAVY, options[0])
    target = tmp_path / f"out{ {'fmu': '.fmu', 'mjcf': '.xml'}.get(exporter, '') }"
    assert main(["export", exporter, str(target), "--urdf", str(path), *options[1:]]) == 0
    assert target.exists()


CAD = (
    RIGID.replace('effort="1e6"', 'effort="0"')
    .replace('effort="1e5" velocity="5"', 'effort="0" velocity="0"')
    .replace('type="revolute"', 'type="continuous"')
)
"""The same crane as programs for CAD write it: no limits of drives, and a slew without ends."""


def test_limits_that_cad_leaves_out_are_read_as_none(tmp_path: Path) -> None:
    crane = cd.load_crane(saved(tmp_path, CAD), swing=True)
    assert crane.effort_limit.tolist() == [1e6] * 3
    assert crane.rate_limit.tolist() == [math.inf, 10.0, math.inf]
    assert crane.upper[0] - crane.lower[0] == pytest.approx(20 * math.pi, rel=1e-5)
    assert {
        "azimuth is continuous, read as revolute up to ±31.4159 rad.",
        "velocity limit 0 of lift read as none.",
        "effort limit 0 of lift read as unknown: 1e+06 N.",
        "effort limit 0 of azimuth read as unknown: 1e+06 N m.",
    } <= {*crane.assumptions}
    limits = {
        joint.get("name"): {key: float(number) for key, number in limit.items()}
        for joint in ET.fromstring(crane.urdf).iterfind("joint")
        for limit in joint.iterfind("limit")
    }
    assert all(limit["velocity"] > 0.0 and limit["effort"] > 0.0 for limit in limits.values())
    swing = limits["swing_radial_joint"]
    assert (swing["effort"], swing["velocity"]) == (1e7, 10.0)


def test_what_describe_writes_of_a_swing_is_read_back(tmp_path: Path) -> None:
    crane = cd.load_crane(saved(tmp_path, CAD), swing=True)
    again = cd.load_crane(saved(tmp_path, crane.urdf, "swinging.urdf"))
    assert again.layout == crane.layout and again.assumptions == ()
    np.testing.assert_array_equal(again.start.q, crane.start.q)
    np.testing.assert_array_equal(again.rate_limit, crane.rate_limit)
    control = ET.fromstring(crane.urdf).findall("ros2_control")
    assert len(control) == 1 and control[0].find("hardware/plugin") is not None
    assert max(map(len, crane.urdf.splitlines())) < 120


@pytest.mark.parametrize(
    ("length", "note"),
    [
        (30.0, "The pivot is 3.6 m above carriage."),
        (20.0, "The pivot is 6.4 m below carriage."),
        (26.4, "The pivot is at the height of carriage."),
    ],
)
def test_the_place_of_the_pivot_is_said(tmp_path: Path, length: float, note: str) -> None:
    assert note in cd.load_crane(saved(tmp_path, RIGID), swing={"length": length}).assumptions


def test_a_rigid_hook_leads_to_swing(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="a rigid joint, swing=True, or --swing, puts a rope"):
        cd.load_crane(saved(tmp_path, RIGID))


def test_links_of_missing_meshes_are_drawn_as_sticks(tmp_path: Path) -> None:
    from cranedyn.recording.shapes import shapes, visible_points

    mesh = "<visual><geometry><mesh filename='a.stl'/></geometry></visual>"
    text = RIGID.replace('<link name="ground"/>', f'<link name="ground">{mesh}</link>')
    text = text.replace('<link name="upper">', f'<link name="upper">{mesh}')
    crane = cd.load_crane(saved(tmp_path, text), swing=True)
    drawn = shapes(crane.urdf)
    assert [shape.kind for shape in drawn["ground"]] == ["cylinder"]
    assert [shape.kind for shape in drawn["carriage"]] == ["sphere"]
    assert drawn["hook"] == []
    tips = [points for _, points in visible_points(crane, crane.start.q)]
    low, high = (end(np.concatenate(tips), axis=0) for end in (np.min, np.max))
    np.testing.assert_allclose(high[2] - low[2], 28.0, atol=0.7)
    np.testing.assert_allclose(max(high[:2] - low[:2]), 22.0, atol=0.7)


def test_a_crane_that_shows_nothing_is_drawn_with_its_rails_where_its_joints_slide(
    tmp_path: Path,
) -> None:
    from cranedyn.recording.shapes import shapes, visible_points

    crane = portal_crane(tmp_path)
    q = crane.start.q.copy()
    q[:2] = 20.0, 3.0
    ends = []
    for _, points in visible_points(crane, q):
        ends.append((points.min(axis=0), points.max(axis=0)))
    thick = 0.4
    expected = [
        # The runway, on legs beyond its ends: a load that hangs at an end is in none of them.
        ([-3.0, 0.0, 12.0], [63.0, 0.0, 12.0]),
        ([-3.0, 0.0, 0.0], [-3.0, 0.0, 12.0]),
        ([63.0, 0.0, 0.0], [63.0, 0.0, 12.0]),
        ([20.0, -9.0, 12.0], [20.0, 9.0, 12.0]),  # the bridge, where it has travelled
        ([20.0, 3.0, 12.0], [20.0, 3.0, 12.0]),  # the cart
        ([20.0, 3.0, 12.0], [20.0, 3.0, 12.0]),  # what swings below it, which has no size
    ]
    for seen, wanted in zip(ends, expected, strict=True):
        np.testing.assert_allclose(seen, wanted, atol=thick + 1e-9)
    assert shapes(crane.urdf)["s2"] == []  # the rope is drawn in its place


@pytest.mark.parametrize(
    ("folder", "name"), [("mine_ros", "mine_ros"), ("My-Crane", "crane_description")]
)
def test_a_package_has_the_name_of_its_folder(tmp_path: Path, folder: str, name: str) -> None:
    from cranedyn.export import ros2

    package = ros2.export(tmp_path / folder, cd.load_crane())
    assert ET.parse(package / "package.xml").findtext("name") == name


def test_a_clock_in_ms_taken_for_s_and_an_unknown_unit_are_refused() -> None:
    from cranedyn.data.external import parse_sources
    from cranedyn.identification import Record

    t = np.arange(100.0)
    columns = {"t_s": 50.0 * t, "phi_rad": 0.1 * np.sin(t)}
    with pytest.raises(CraneError, match=r"increases by 50 s .* --columns t_s=NAME\[ms\]"):
        Record.of(cd.load_crane(), columns)
    with pytest.raises(UnknownName, match="unit of t_s 'ks'"):
        parse_sources(["t_s=stamp[ks]"])
