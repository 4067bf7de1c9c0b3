"""SDF: read as libsdformat and DART read it, and refused by name where no crane is meant."""

from __future__ import annotations

import math
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.model.foreign import ForeignModel
from cranedyn.model.sdf import read_sdf
from cranedyn.model.urdf import check_urdf, parse_urdf, skeleton
from tests.oracles.sdf import RandomSdf, build_probe, dynamics, read_with_libsdformat

GRAVITY = 9.81
"""Gravity of a fresh Pinocchio model [m/s²]."""

BRIDGE = """<?xml version="1.0"?>
<sdf version="1.9">
  <world name="yard">
    <gravity>0 0 -1.62</gravity>
    <include><uri>model://ground_plane</uri></include>
    <model name="floor"><static>true</static><link name="slab"/></model>
    <model name="bridge">
      <pose>0 0 8 0 0 0</pose>
      <link name="rail"/>
      <joint name="anchor" type="fixed"><parent>world</parent><child>rail</child></joint>
      <link name="cart">
        <inertial><mass>50</mass></inertial>
        <visual name="looks">
          <geometry><box><size>1 0.5 0.2</size></box></geometry>
          <material><diffuse>1 0 0 1</diffuse></material>
        </visual>
        <visual name="mesh"><geometry><mesh><uri>cart.dae</uri></mesh></geometry></visual>
      </link>
      <joint name="travel_joint" type="prismatic">
        <parent>rail</parent><child>cart</child>
        <axis><xyz>1 0 0</xyz>
          <limit><lower>-5</lower><upper>5</upper><effort>2000</effort><velocity>1.5</velocity>
          </limit>
          <dynamics><damping>12</damping></dynamics>
        </axis>
      </joint>
      <link name="load">
        <pose relative_to="cart">0 0 -4 0 0 0</pose>
        <inertial><mass>20</mass>
          <inertia><ixx>0.4</ixx><iyy>0.4</iyy><izz>0.4</izz></inertia></inertial>
      </link>
      <joint name="rope" type="universal">
        <pose relative_to="cart"/>
        <parent>cart</parent><child>load</child>
        <axis><xyz>1 0 0</xyz><dynamics><damping>0.5</damping></dynamics></axis>
        <axis2><xyz>0 1 0</xyz><dynamics><spring_stiffness>3</spring_stiffness>
          <spring_reference>0.1</spring_reference></dynamics></axis2>
      </joint>
      <plugin filename="gz-sim-joint-position-controller-system"
              name="gz::sim::systems::JointPositionController">
        <joint_name>travel_joint</joint_name>
      </plugin>
      <plugin filename="gz-sim-joint-state-publisher-system"
              name="gz::sim::systems::JointStatePublisher"><joint_name>rope</joint_name></plugin>
    </model>
  </world>
</sdf>
"""
"""An overhead crane as people write it for gz sim."""


def saved(folder: Path, text: str) -> Path:
    path = folder / "crane.sdf"
    path.write_text(text)
    return path


def read(text: str) -> ForeignModel:
    return read_sdf(parse_urdf(text, "crane.sdf"), Path("crane.sdf"))


def built(text: str) -> tuple[pin.Model, list[str]]:
    """Return the model of an SDF text, with revolute joints for continuous ones, and its joints."""
    robot = read(text).robot
    check_urdf(robot, "crane.sdf")
    for joint in robot.iterfind("joint[@type='continuous']"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        assert limit is not None
        limit.attrib |= {"lower": "-9", "upper": "9"}
    model = pin.buildModelFromXML(skeleton(robot))
    return model, list(model.names)[1:]


def test_a_crane_of_gz_sim_is_read_with_its_limits_drives_springs_and_looks(tmp_path: Path) -> None:
    crane = cd.load_crane(saved(tmp_path, BRIDGE))
    assert crane.layout.symbols == ("travel", "rope_axis", "rope_axis2")
    assert [joint.driven for joint in crane.layout.joints] == [True, False, False]
    assert crane.payload_mass == 20.0
    assert crane.damping.tolist() == [12.0, 0.5, 0.0]
    assert crane.springs.stiffness.tolist() == [0.0, 0.0, 3.0]
    assert crane.springs.rest[2] == 0.1
    assert crane.effort_limit.tolist() == [2000.0]
    assert (crane.lower[0], crane.upper[0], crane.rate_limit[0]) == (-5.0, 5.0, 1.5)
    assert len(ET.fromstring(crane.urdf).findall("link/visual")) == 1
    notes = " ".join(crane.assumptions)
    for expected in (
        "travel_joint is driven: the plugin",
        "1 kg m² about each axis, the default of SDF",
        "model floor is static",
        "model://ground_plane",
        "A visual of link cart is of a shape without a size here and left out.",
        "A body of 1e-05 kg is between the axes of joint rope.",
    ):
        assert expected in notes
    assert read(BRIDGE).gravity == crane.gravity == 1.62
    # a closed form: a compound pendulum of mass m, inertia I, length l and a spring k
    period = 2.0 * np.pi * np.sqrt((20.0 * 16.0 + 0.4) / (20.0 * crane.gravity * 4.0 + 3.0))
    start = crane.state(rope_axis=0.0, rope_axis2=crane.start.q[2] + 0.01)
    run = cd.simulate(
        crane, hold_controller(crane), start=start, duration=6.0, dt=1e-3, drive="motion"
    )
    # After half a period the offset from rest is the opposite one, but for (0.01 rad)²/16.
    half = np.interp(period / 2.0, run.t, run.q[:, 2] - crane.start.q[2])
    assert half == pytest.approx(-0.01, rel=1e-3)


def test_the_smallest_file_is_read_by_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from cranedyn.__main__ import main

    path = saved(
        tmp_path,
        '<sdf version="1.9"><model name="c"><link name="rail"/><link name="cart"><inertial>'
        '<mass>50</mass></inertial></link><joint name="rail_joint" type="prismatic"><parent>rail'
        "</parent><child>cart</child><axis><xyz>1 0 0</xyz></axis></joint></model></sdf>",
    )
    assert main(["describe", "--urdf", str(path), "--driven", "rail_joint"]) == 0
    printed = capsys.readouterr().out
    assert "No joint connects rail with the world; it is read as fixed there." in printed
    assert "rail_joint has no limit at one end or both; -1000 to 1000 m is taken." in printed


def compare(probe: Path, folder: Path, seeds: range) -> None:
    """Compare mass matrix and weight of random trees with those of the poses of libsdformat."""
    joints = 0
    texts = [RandomSdf(seed, version=4 + seed % 6).text for seed in seeds]
    files = [folder / f"{seed}.sdf" for seed in seeds]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text)
    trees = read_with_libsdformat(probe, files)
    for seed, text, tree in zip(seeds, texts, trees, strict=True):
        model, names = built(text)
        assert set(names) == set(tree.screws)
        joints += len(names)
        if not names:
            continue
        q = np.random.default_rng(seed).normal(size=len(names))
        expected_mass, expected_weight = dynamics(tree, names, q, GRAVITY)
        data = model.createData()
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        weight = pin.computeGeneralizedGravity(model, data, q)
        # Rounding: some ten products of matrices of order one to ten.
        size = max(1.0, np.abs(expected_mass).max())
        assert_allclose(mass, expected_mass, atol=1e-11 * size, rtol=0.0, err_msg=text)
        assert_allclose(weight, expected_weight, atol=1e-11 * GRAVITY * size, rtol=0.0)
    assert joints > 2 * len(seeds)


@pytest.mark.slow
def test_random_trees_of_all_versions_move_as_libsdformat_places_them(tmp_path: Path) -> None:
    compare(build_probe(), tmp_path, range(12))  # twice each version


@pytest.mark.long
def test_300_random_trees_move_as_libsdformat_places_them(tmp_path: Path) -> None:
    compare(build_probe(), tmp_path, range(300))


@pytest.mark.slow
def test_random_trees_move_for_two_seconds_as_in_dart(tmp_path: Path) -> None:
    dart = pytest.importorskip(
        "dartpy", reason="dartpy is not installed: pip install 'cranedyn[dart]'"
    )
    step = 1e-3
    steps = 2000
    for seed in range(12):
        # DART reads versions 1.4 to 1.6, 1.4 without its axes in the model frame.
        text = RandomSdf(seed, 5 + seed % 2, plain=True).text
        model, names = built(text)
        skeleton_of_dart = dart.utils.SdfParser.readSkeleton(str(saved(tmp_path, text)))
        order = [names.index(skeleton_of_dart.getDof(i).getName()) for i in range(len(names))]
        for joint in range(skeleton_of_dart.getNumJoints()):
            skeleton_of_dart.getJoint(joint).setLimitEnforcement(False)
        world = dart.simulation.World()
        world.setGravity([0.0, 0.0, -GRAVITY])
        world.setTimeStep(step)
        world.addSkeleton(skeleton_of_dart)
        q, v = np.random.default_rng(seed).normal(size=(2, len(names))) * 0.3
        skeleton_of_dart.setPositions(q[order])
        skeleton_of_dart.setVelocities(v[order])
        data = model.createData()
        for _ in range(steps):  # both take semi-implicit Euler steps
            v = v + step * pin.aba(model, data, q, v, np.zeros(len(names)))
            q = q + step * v
            world.step()
        # Rounding, amplified by e^(λ t) of a chain that tumbles freely for 2 s.
        size = max(1.0, np.abs(q).max())
        assert_allclose(skeleton_of_dart.getPositions(), q[order], atol=1e-7 * size, rtol=0.0)


ARM = (
    '<sdf version="1.8"><model name="m"><link name="a"/><link name="b"><pose>0 0 1 0.5 0 0</pose>'
    '</link><joint name="j" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 1 0'
    "</xyz></axis></joint></model></sdf>"
)
"""An arm on a base."""

REFUSED = {
    "version": (
        'version="1.8"',
        'version="1.3"',
        "version of the SDF file .* is 1.3; allowed is 1.4",
    ),
    "no version": ('version="1.8"', "", "is left out; allowed is 1.4 to 1.12"),
    "include": (
        '<link name="a"/>',
        '<link name="a"/><include><uri>model://hook</uri></include>',
        "includes model://hook, and no other file is read; merge .* gz sdf -p",
    ),
    "static": ('<link name="a"/>', '<static>true</static><link name="a"/>', "no model that moves"),
    "free body": (
        "<joint",
        '<link name="ball"/><joint',
        "no joint connects with the crane: a, ball",
    ),
    "weightless": ('<link name="a"/>', '<link name="a"><gravity>0</gravity></link>', "no gravity"),
    "kinematic": (
        '<link name="a"/>',
        '<link name="a"><kinematic>1</kinematic></link>',
        "link a in .* is kinematic",
    ),
    "air": (
        '<link name="a"/>',
        '<link name="a"><velocity_decay><linear>0.1</linear></velocity_decay></link>',
        "linear velocity_decay of link a .* is 0.1; allowed is 0: say it as damping",
    ),
    "friction": (
        "</axis>",
        "<dynamics><friction>-2</friction></dynamics></axis>",
        "dry friction of joint j .* is -2.0; allowed is >= 0",
    ),
    "type": ('type="revolute"', 'type="screw"', "is of type screw; allowed are revolute"),
    "misspelt": (
        "</axis>",
        "<dynamics><dampng>2</dampng></dynamics></axis>",
        "<dampng> in <dynamics>",
    ),
    "twice": ("</axis>", "<xyz>1 0 0</xyz></axis>", "two elements <xyz> in <axis>"),
    "names": (
        '<link name="b">',
        '<link name="a">',
        "two elements with the name a, a link and a link",
    ),
    "unknown child": ("<child>b", "<child>c", "names c; the names in model m are a, b, j"),
    "child world": ("<child>b", "<child>world", "has the child world"),
    "itself": ("<child>b", "<child>a", "connects link a with itself"),
    "circle": (
        "<pose>0 0 1 0.5 0 0</pose>",
        '<pose relative_to="j">0 0 1 0.5 0 0</pose>',
        "relative to each other in a cycle through the link b|cycle through the joint j",
    ),
    "loop": (
        "</model>",
        '<joint name="k" type="revolute"><parent>a</parent><child>b</child><axis/></joint></model>',
        "two joints with the child b, j and k",
    ),
    "negative inertia": (
        '<link name="a"/>',
        '<link name="a"><inertial><inertia><ixy>3</ixy></inertia></inertial></link>',
        "principal moments of inertia of link a in .* is -2, 1, 4 kg m²; allowed is >= 0",
    ),
    "no axis": ("<axis><xyz>0 1 0</xyz></axis>", "", "is revolute and needs <axis>"),
    "axis": ("<xyz>0 1 0</xyz>", "<xyz>0 0 0</xyz>", "xyz of axis of joint j .* is 0 0 0"),
    "words": (
        "<xyz>0 1 0</xyz>",
        "<xyz>0 one 0</xyz>",
        "is '0 one 0'; allowed is 3 decimal numbers",
    ),
    "short pose": ("0 0 1 0.5 0 0", "0 0 1", "pose of link b .* is '0 0 1'; allowed is 6 decimal"),
    "quaternion": (
        "<pose>0 0 1 0.5 0 0</pose>",
        '<pose rotation_format="quat_xyzw">0 0 1 0 0 0 0</pose>',
        "length of the quaternion of link b .* is 0; allowed is 1",
    ),
    "old flag": (
        "</axis>",
        "<use_parent_model_frame>1</use_parent_model_frame></axis>",
        "use_parent_model_frame, which SDF has up to version 1.6",
    ),
    "auto": (
        '<link name="a"/>',
        '<link name="a"><inertial auto="true"/></link>',
        "mass computed from its collision shapes .*expand-auto-inertials",
    ),
    "limit": ("</axis>", "<limit><lower>low</lower></limit></axis>", "lower of joint j .* is low"),
    "bool": (
        '<link name="a"/>',
        '<static>maybe</static><link name="a"/>',
        "is maybe; allowed is true",
    ),
    "two roots": ("</model>", '</model><model name="n"/>', "2 worlds and models in <sdf>"),
    "upside down": (
        '<model name="m">',
        '<world name="w"><gravity>0 9.8 0</gravity><model name="m">',
        "gravity of the world .* is 0 9.8 0 m/s²",
    ),
}
"""What is replaced in `ARM`, by what, and what is said to that."""


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_crane_has_is_refused_by_name(case: str, tmp_path: Path) -> None:
    old, new, message = REFUSED[case]
    text = ARM.replace(old, new)
    assert text != ARM
    if "<world" in text:
        text = text.replace("</model>", "</model></world>")
    with pytest.raises((ModelError, OutOfRange), match=message):
        cd.load_crane(saved(tmp_path, text), driven=["j"])


FOLLOWING = """<sdf version="1.11"><world name="w">
  <model name="crane">
    <link name="foot"/><link name="boom"/><link name="section"/>
    <joint name="ground" type="fixed"><parent>world</parent><child>foot</child></joint>
    <joint name="lift" type="universal"><parent>foot</parent><child>boom</child>
      <axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>
    <joint name="slide" type="prismatic"><parent>boom</parent><child>section</child>
      <axis><limit><lower>-1</lower><upper>1</upper></limit>
        <mimic joint="lift" axis="axis2"><multiplier>2</multiplier><offset>0</offset>
          <reference>0.5</reference></mimic></axis></joint>
  </model>
  <model name="load"><link name="body"/></model>
  <joint name="hook" type="fixed"><parent>crane::section</parent><child>load::body</child></joint>
</world></sdf>"""
"""Two models, so that the names of their joints begin with those of the models."""


def test_a_joint_follows_an_axis_of_another_one_in_a_model_of_several() -> None:
    robot = read(FOLLOWING).robot
    mimic = robot.find("joint[@name='crane::slide']/mimic")
    assert mimic is not None
    assert mimic.get("joint") == "crane::lift_axis2"
    assert (mimic.get("multiplier"), mimic.get("offset")) == ("2.0", "-1.0")


def test_a_joint_that_ties_a_moving_link_to_a_static_model_is_refused() -> None:
    wall = (
        '<model name="wall"><static>1</static><link name="bricks"/></model>'
        '<joint name="tie" type="fixed"><parent>{0}</parent><child>wall::bricks</child></joint>'
    )
    tied = FOLLOWING.replace("</world>", wall.format("load::body") + "</world>")
    with pytest.raises(ModelError, match="joint tie in"):
        read(tied)
    # At its foot a crane may stand on a static model that is the child of their joint.
    foot = '<joint name="ground" type="fixed"><parent>world</parent><child>foot</child></joint>'
    stands = FOLLOWING.replace(foot, "").replace(
        "</world>", wall.format("crane::foot") + "</world>"
    )
    assert read(stands).robot.find("joint[@name='crane::foot_to_the_ground']") is not None
    with pytest.raises(ModelError, match="has the parent crane::foot, which moves"):
        read(stands.replace('"tie" type="fixed"', '"tie" type="revolute"'))


def test_models_without_a_joint_between_them_are_refused_by_name(tmp_path: Path) -> None:
    two = ARM.replace('<model name="m">', '<world name="w"><model name="m">')
    other = ARM[ARM.index("<model") : ARM.index("</sdf>")].replace('"m"', '"n"')
    two = two.replace("</model>", f"</model>{other}</world>", 1)
    with pytest.raises(ModelError, match="models that move without a joint between them: m, n"):
        cd.load_crane(saved(tmp_path, two), driven=["j"])
    joint = '<joint name="k" type="fixed"><parent>m::b</parent><child>n::a</child></joint></world>'
    model, names = built(two.replace("</world>", joint))
    assert names == ["m::j", "n::j"]
    assert list(model.parents) == [0, 0, 1]


@pytest.mark.parametrize("seed", range(40))
def test_a_file_with_anything_cut_or_changed_is_refused_or_read_and_never_crashes(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    words = BRIDGE.split(" ")
    for _ in range(int(rng.integers(1, 4))):
        i, j = rng.integers(len(words), size=2)
        words[i] = str(rng.choice(["", "nan", "1e999", "-1", "world", "__model__", words[j]]))
    try:
        cd.load_crane(saved(tmp_path, " ".join(words)))
    except CraneError as error:
        assert str(error)


def test_a_long_chain_of_frames_is_no_deep_recursion() -> None:
    frames = "".join(
        f'<frame name="f{i}" attached_to="f{i - 1}"><pose>0 0 0.001 0 0 0</pose></frame>'
        for i in range(1, 1500)
    )
    first = '<frame name="f0" attached_to="b"/>'
    text = ARM.replace("</model>", f"{first}{frames}</model>").replace(
        "<parent>a", '<pose relative_to="a"/><parent>a'
    )
    assert built(text)[1] == ["j"]


def test_placement_frames_in_the_innermost_of_many_models_are_read_at_once() -> None:
    depth = 40
    inner = '<link name="tip"><pose>1 0 0 0 0 0</pose></link>'
    for level in range(depth):
        path = "::".join([*(f"m{i}" for i in reversed(range(level))), "tip"])
        inner = f'<model name="m{level}" placement_frame="{path}">{inner}</model>'
    joint = '<joint name="k" type="prismatic"><parent>world</parent><child>CHILD</child><axis/>'
    child = "::".join([*(f"m{i}" for i in reversed(range(depth - 1))), "tip"])
    end = inner.rindex("</model>")
    text = inner[:end] + joint.replace("CHILD", child) + "</joint>" + inner[end:]
    began = time.process_time()
    model, _ = built(f'<sdf version="1.9">{text}</sdf>')
    # Every model is where its tip is, at the origin.
    assert_allclose(model.jointPlacements[1].translation, np.zeros(3), atol=1e-12)
    # It doubled with each model. Other processes have had their own time of the processor.
    assert time.process_time() - began < 5.0


def test_a_joint_with_the_name_of_a_link_is_renamed_as_libsdformat_does() -> None:
    text = ARM.replace("1.8", "1.6").replace('joint name="j"', 'joint name="b"')
    assert built(text)[1] == ["b_joint"]


def test_limits_without_end_are_those_of_converters_from_urdf() -> None:
    limits = "<limit><lower>-1.79769e+308</lower><upper>1.79769e+308</upper></limit></axis>"
    joint = read(ARM.replace("</axis>", limits)).robot.find("joint[@name='j']")
    assert joint is not None and joint.get("type") == "continuous"


@pytest.mark.parametrize(
    ("version", "flag", "axis"),
    [
        ("1.4", "", [0.0, 1.0, 0.0]),
        ("1.5", "", [0.0, math.cos(0.5), math.sin(0.5)]),
        ("1.6", "<use_parent_model_frame>true</use_parent_model_frame>", [0.0, 1.0, 0.0]),
        ("1.7", "", [0.0, math.cos(0.5), math.sin(0.5)]),
    ],
)
def test_an_axis_is_written_in_the_model_frame_up_to_1_4_and_in_its_joint_after_that(
    version: str, flag: str, axis: list[float]
) -> None:
    model, _ = built(ARM.replace("1.8", version).replace("</axis>", f"{flag}</axis>"))
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(1))
    jacobian = pin.getJointJacobian(model, data, 1, pin.LOCAL_WORLD_ALIGNED).reshape(6)
    assert_allclose(jacobian[3:], axis, atol=1e-15)


def test_the_pose_of_a_model_is_that_of_its_placement_frame() -> None:
    text = ARM.replace('name="m">', 'name="m" placement_frame="b"><pose>5 0 0 0 0 0</pose>')
    model, _ = built(text)
    assert_allclose(model.jointPlacements[1].translation, [5.0, 0.0, 0.0], atol=1e-15)
    assert_allclose(model.jointPlacements[1].rotation, np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("plugin", "driven"),
    [
        ('name="gz::sim::systems::JointController"><joint_name>j</joint_name>', ["j"]),
        ('filename="gz-sim-joint-controller-system"><joint_name>j</joint_name>', ["j"]),
        ('name="gz::sim::systems::ApplyJointForce"><joint_name>j</joint_name>', ["j"]),
        ('name="gz::sim::systems::JointTrajectoryController">', ["j"]),
        ('name="gz::sim::systems::JointPositionController">', []),
        ('name="gz::sim::systems::JointStatePublisher"><joint_name>j</joint_name>', []),
        ('name="gz::sim::systems::Thruster"><joint_name>j</joint_name>', []),
    ],
)
def test_a_plugin_drives_a_joint_if_it_commands_it(plugin: str, driven: list[str]) -> None:
    model = read(ARM.replace("</model>", f"<plugin {plugin}</plugin></model>"))
    drives = [drive.get("name") for drive in model.robot.iterfind("ros2_control/joint")]
    assert drives == driven
    left_out = [note for note in model.notes if note.startswith("What the plugin")]
    assert bool(left_out) == ("Thruster" in plugin)


def test_a_plugin_that_commands_what_is_no_joint_is_refused() -> None:
    for name, message in (("k", "names k; the names in model m are a, b, j"), ("b", "the link b")):
        plugin = f'<plugin name="JointController"><joint_name>{name}</joint_name></plugin></model>'
        with pytest.raises(ModelError, match=message):
            read(ARM.replace("</model>", plugin))


@pytest.mark.parametrize("index", ["-1", "0.7", "2"])
def test_an_axis_that_no_joint_has_is_not_another_one(index: str) -> None:
    plugin = (
        f'<plugin name="JointController"><joint_name>j</joint_name><joint_index>{index}'
        "</joint_index></plugin></model>"
    )
    with pytest.raises(
        OutOfRange, match=rf"joint_index of the plugin .*{index}.*allowed is 0 or 1"
    ):
        read(ARM.replace("</model>", plugin))


def test_a_thin_rod_in_any_direction_has_an_inertia() -> None:
    """Its least principal moment is zero, and may be less by the digits of a file."""
    along = np.array([0.3, -0.7, 0.2])
    tensor = (along @ along - 1e-12) * np.eye(3) - np.outer(along, along)
    entries = "".join(
        f"<i{a}{b}>{float(tensor[i, j])!r}</i{a}{b}>"
        for i, a in enumerate("xyz")
        for j, b in enumerate("xyz")
        if i <= j
    )
    rod = f'<link name="a"><inertial><inertia>{entries}</inertia></inertial></link>'
    assert np.linalg.eigvalsh(tensor)[0] < 0.0
    read(ARM.replace('<link name="a"/>', rod))


def test_a_ball_turns_about_the_two_horizontal_axes_wherever_its_frame_points() -> None:
    text = ARM.replace('type="revolute"', 'type="ball"').replace(
        "<axis><xyz>0 1 0</xyz></axis>", ""
    )
    model, names = built(text)
    assert names == ["j_x", "j_y"]
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(2))
    for i, axis in enumerate(np.eye(3)[:2]):
        jacobian = pin.getJointJacobian(model, data, i + 1, pin.LOCAL_WORLD_ALIGNED)
        assert_allclose(jacobian[3:, i], axis, atol=1e-15)


def test_gravity_is_the_default_of_sdf_where_a_world_says_none_and_none_without_a_world() -> None:
    world = ARM.replace('<model name="m">', '<world name="w"><model name="m">')
    world = world.replace("</model>", "</model></world>")
    assert read(world).gravity == 9.8
    assert read(ARM).gravity is None
    older = world.replace('version="1.8"', 'version="1.5"').replace(
        '<world name="w">', '<world name="w"><physics><gravity>0 0 -3.7</gravity></physics>'
    )
    assert read(older).gravity == 3.7


def test_a_joint_without_range_is_no_drive_whatever_commands_it(tmp_path: Path) -> None:
    brake = BRIDGE.replace(
        "<limit><lower>-5</lower><upper>5</upper>", "<limit><lower>0</lower><upper>0</upper>"
    )
    model = read(brake)
    assert model.robot.find("ros2_control") is None
    assert "A plugin commands travel_joint, which has no range; it is left out." in model.notes
