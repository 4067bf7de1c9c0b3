"""The exporter to ROS 2: a package that ament takes, with the article's traps answered in it."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.dynamics.equations_of_motion import over_all_joints
from cranedyn.errors import DataError, ModelError, OutOfRange
from cranedyn.export import gazebo, ros2
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, describe
from cranedyn.model.load import load_crane
from tests.gantry import GANTRY
from tests.helpers import ROOT, files, quickly
from tests.model.test_foreign import RIGID
from tests.model.test_sdf import BRIDGE
from tests.oracles.sdf import build_probe, dynamics, read_with_libsdformat
from tests.system.test_cross_engines import DT, PERIOD

DRIVES = ["yaw_joint", "trolley_joint", "hoist_joint"]
INITIAL_EFFORT = "state_interface[@name='effort']/param[@name='initial_value']"


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load_crane(payload_mass=1234.5, hoist_init=17.25, gravity=9.8)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory, crane: Crane) -> Path:
    return ros2.export(tmp_path_factory.mktemp("ros2") / "crane_description", crane)


@pytest.fixture(scope="module")
def robot(package: Path) -> ET.Element:
    return ET.parse(package / "urdf" / "crane.urdf").getroot()


@pytest.mark.slow
def test_the_package_is_one_by_the_rules_of_ament(package: Path) -> None:
    catkin = pytest.importorskip(
        "catkin_pkg.package", reason="catkin_pkg is not installed: pip install 'cranedyn[test]'"
    )
    found = catkin.parse_package(str(package))
    warnings = []
    found.validate(warnings=warnings)
    assert (found.name, found.get_build_type(), warnings) == (
        "crane_description",
        "ament_cmake",
        [],
    )
    assert "project(crane_description)" in (package / "CMakeLists.txt").read_text()
    assert {name for name in files(package) if (package / name).is_dir()} == {
        "config",
        "launch",
        "rviz",
        "urdf",
        "worlds",
    }


@pytest.mark.slow
def test_colcon_builds_the_package_and_installs_every_file_of_it(
    package: Path, tmp_path: Path
) -> None:
    system = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    if shutil.which("colcon", path=system["PATH"]) is None:
        pytest.skip("colcon is not installed: run .ci/colcon as root")
    # colcon alone builds no package of ament: it needs its extension, and CMake those of ament.
    probe = tmp_path / "probe"
    probe.mkdir()
    (probe / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.8)\nproject(probe)\nfind_package(ament_cmake REQUIRED)\n"
    )
    for needed in (
        ["python3", "-c", "import ament_package, catkin_pkg, colcon_ros"],
        ["cmake", "-S", "probe", "-B", "probe/build"],
    ):
        found = subprocess.run(needed, cwd=tmp_path, env=system, capture_output=True, check=False)
        if found.returncode:
            pytest.skip("colcon is installed without packages of ament: run .ci/colcon as root")
    shutil.rmtree(probe)
    shutil.copytree(package, tmp_path / "src" / "crane_description")
    build = subprocess.run(
        ["colcon", "build"], cwd=tmp_path, env=system, capture_output=True, text=True, check=False
    )
    assert build.returncode == 0, build.stderr
    share = tmp_path / "install" / "crane_description" / "share"
    for name in files(package):
        if (package / name).is_file() and name != "CMakeLists.txt":
            installed = share / "crane_description" / name
            assert installed.read_bytes() == (package / name).read_bytes()
    index = share / "ament_index" / "resource_index"
    needed = (index / "package_run_dependencies" / "crane_description").read_text()
    assert set(needed.split(";")) == set(ros2.DEPENDENCIES)


@pytest.mark.slow
def test_the_urdf_is_read_by_check_urdf_and_loads_as_the_same_crane(
    package: Path, crane: Crane
) -> None:
    same = load_crane(package / "urdf" / "crane.urdf", gravity=9.8)
    assert same.start.q.tolist() == crane.start.q.tolist()
    assert same.payload_mass == crane.payload_mass
    assert same.damping.tolist() == crane.damping.tolist()
    program = Path(sys.executable).with_name("check_urdf")
    if not program.exists():
        pytest.skip("check_urdf is not beside this Python")
    run = subprocess.run(
        [program, package / "urdf" / "crane.urdf"], capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stderr) == (0, "")
    assert "root Link: world" in run.stdout


def test_commands_within_their_limits_go_to_the_drives_only_and_states_come_from_all(
    robot: ET.Element, crane: Crane
) -> None:
    (control,) = robot.iterfind("ros2_control")
    limits = dict(zip(DRIVES, crane.effort_limit.tolist(), strict=True))
    assert [joint.get("name") for joint in control.iterfind("joint")] == list(crane.model.names)[1:]
    for joint in control.iterfind("joint"):
        name = joint.get("name", "")
        states = [state.get("name") for state in joint.iterfind("state_interface")]
        assert states == ["position", "velocity", *(["effort"] if name in DRIVES else [])]
        commands = joint.findall("command_interface")
        assert [command.get("name") for command in commands] == ["effort"] * (name in DRIVES)
        for command in commands:
            bounds = [float(bound.text or "nan") for bound in command.iterfind("param")]
            assert bounds == [-limits[name], limits[name]]
        start = joint.findtext("state_interface[@name='position']/param[@name='initial_value']")
        limit = robot.find(f"joint[@name='{name}']/limit")
        assert limit is not None and start is not None
        assert float(limit.get("lower", "nan")) <= float(start) <= float(limit.get("upper", "nan"))


@pytest.mark.parametrize(
    "name", ["yaw_joint ", "1", "yes", "- a", "a: b", "#", "*a", "ä", "a\\b", "🏗"]
)
@pytest.mark.slow
def test_controllers_are_told_the_drives_whatever_these_are_called(
    name: str, tmp_path: Path
) -> None:
    yaml = pytest.importorskip(
        "ruamel.yaml", reason="ruamel.yaml is not installed: pip install 'cranedyn[mcap]'"
    )
    (tmp_path / "crane.urdf").write_text(describe().replace('"yaw_joint"', f'"{name}"'))
    package = ros2.export(tmp_path / "package", load_crane(tmp_path / "crane.urdf"))
    made = yaml.YAML(typ="safe").load((package / "config" / "controllers.yaml").read_text())
    assert made["drives"]["ros__parameters"]["joints"] == [name, *DRIVES[1:]]


@pytest.mark.parametrize("xacro", ["tower_crane", "overhead_crane"])
@pytest.mark.slow
def test_the_efforts_before_the_first_command_hold_the_crane_where_it_starts(
    xacro: str, tmp_path: Path
) -> None:
    crane = load_crane(ROOT / "urdf" / f"{xacro}.urdf.xacro", payload_mass=1234.5)
    robot = ET.parse(ros2.export(tmp_path / "out", crane) / "urdf" / "crane.urdf").getroot()
    efforts = [
        float(robot.findtext(f"ros2_control/joint[@name='{joint.name}']/{INITIAL_EFFORT}") or "0")
        for joint in crane.layout.joints
    ]
    # a closed form: the hoist carries the load, nothing else carries anything
    assert efforts == pytest.approx([0.0, 0.0, 0.0, 0.0, -1234.5 * crane.gravity], abs=1e-9)


def test_meshes_of_ros_packages_stay_others_do_not(tmp_path: Path) -> None:
    for name in ("package://bridge/hook.stl", "hook.stl"):
        text = describe(ROOT / "urdf" / "overhead_crane.urdf.xacro", {})
        mesh = f'<visual><geometry><mesh filename="{name}"/></geometry></visual></link>'
        (tmp_path / "crane.urdf").write_text(text.replace("</link>", mesh))
        folder = ros2.export(tmp_path / name[:2], load_crane(tmp_path / "crane.urdf"))
        assert (name in (folder / "urdf" / "crane.urdf").read_text()) == (":" in name)


def test_the_worlds_take_the_physics_step_that_is_asked_for(tmp_path: Path, crane: Crane) -> None:
    folder = ros2.export(tmp_path / "out", crane, dt=1.25e-3)
    for world in ("crane.sdf", "classic.sdf"):
        root = ET.parse(folder / "worlds" / world).getroot()
        assert root.findtext("world/physics/max_step_size") == "0.00125"


def test_the_articles_traps_are_answered(package: Path, robot: ET.Element) -> None:
    text = (package / "urdf" / "crane.urdf").read_text()
    # A colon and a space in a comment broke gazebo_ros2_control.
    assert not [word for word in ("<!--", "<mesh", "package://", "file://") if word in text]
    assert robot.find(".//gravity") is None  # nothing turns gravity off for a link
    light = [link.get("name") for link in robot.iterfind("link") if link.find("inertial") is None]
    assert light == ["world"]
    for name in ("crane.sdf", "classic.sdf"):
        world = ET.parse(package / "worlds" / name).getroot()
        assert world.findtext("world/gravity") == "0 0 -9.8"


def test_the_package_depends_on_what_its_launch_files_use(package: Path) -> None:
    texts = [file.read_text() for file in (package / "launch").glob("*.py")]
    texts += [
        (package / name).read_text() for name in ("urdf/crane.urdf", "config/controllers.yaml")
    ]
    root = ET.parse(package / "package.xml").getroot()
    needed = [entry.text or "" for entry in root.iterfind("exec_depend")]
    # A Gazebo plugin is a library of its package, and a controller a type of its.
    used = {name for name in ALL_PACKAGES if any(name in text for text in texts)}
    assert sorted(needed) == sorted(used)


ALL_PACKAGES = (
    *("controller_manager", "effort_controllers", "forward_command_controller", "gazebo_ros"),
    *("gz_ros2_control", "joint_state_broadcaster", "joint_state_publisher_gui", "rviz2"),
    *("robot_state_publisher", "ros_gz_bridge", "ros_gz_sim", "xacro"),
)
"""Packages of ROS 2 with which cranes like ours are launched."""


def test_the_worlds_have_the_gravity_of_the_crane(tmp_path: Path) -> None:
    folder = ros2.export(tmp_path / "out", load_crane(gravity=1.62))
    for world in ("crane.sdf", "classic.sdf"):
        gravity = ET.parse(folder / "worlds" / world).getroot().findtext("world/gravity")
        assert gravity is not None and [float(x) for x in gravity.split()] == [0.0, 0.0, -1.62]


def test_the_controllers_run_at_200_hz_on_the_drives(package: Path) -> None:
    yaml = pytest.importorskip(
        "ruamel.yaml", reason="ruamel.yaml is not installed: pip install 'cranedyn[mcap]'"
    )
    made = yaml.YAML(typ="safe").load((package / "config" / "controllers.yaml").read_text())
    manager = made["controller_manager"]["ros__parameters"]
    assert manager["update_rate"] == 200
    assert {name: one["type"] for name, one in manager.items() if name != "update_rate"} == {
        "joint_state_broadcaster": "joint_state_broadcaster/JointStateBroadcaster",
        "drives": "forward_command_controller/ForwardCommandController",
    }
    assert made["drives"]["ros__parameters"] == {"joints": DRIVES, "interface_name": "effort"}
    yaml.YAML(typ="safe").load((package / "rviz" / "crane.rviz").read_text())


@pytest.mark.parametrize("xacro", ["tower_crane", "overhead_crane"])
@pytest.mark.slow
def test_the_crane_moves_in_dart_as_here_under_the_same_efforts_to_rounding(
    xacro: str, tmp_path: Path
) -> None:
    dart = pytest.importorskip(
        "dartpy", reason="dartpy is not installed: pip install 'cranedyn[dart]'"
    )
    # DART takes damping at the rates after a step; both take semi-implicit Euler steps.
    crane = load_crane(ROOT / "urdf" / f"{xacro}.urdf.xacro", damp_swing=0.0)
    push = np.random.default_rng(0).normal(size=(2001, 3))
    hold = hold_controller(crane)
    run = quickly(
        crane,
        lambda t, state, goal: hold(t, state, goal) + [2e3, 1e3, 800.0] * push[round(t / PERIOD)],
        start=crane.state(phi=0.2, theta=-0.15),
        duration=10.0,
        dt=DT,
        control_period=PERIOD,
    )
    urdf = ros2.export(tmp_path / "out", crane) / "urdf" / "crane.urdf"
    skeleton = dart.utils.DartLoader().parseSkeleton(str(urdf))
    drives = [skeleton.getDof(joint.name).getIndexInSkeleton() for joint in crane.layout.driven]
    assert drives == crane.layout.drives.tolist()
    world = dart.simulation.World()
    world.setGravity([0.0, 0.0, -crane.gravity])
    world.setTimeStep(DT)
    world.addSkeleton(skeleton)
    skeleton.setPositions(run.q[0])
    rows = []
    for efforts in run.effort:
        rows.append([*skeleton.getPositions(), *skeleton.getVelocities()])
        for _ in range(round(PERIOD / DT)):
            skeleton.setForces(over_all_joints(crane, efforts))
            world.step()
    # Rounding, as in test_cross_engines.
    assert_allclose(rows, np.hstack([run.q, run.v]), rtol=0.0, atol=1e-12)


def test_dart_reads_ranges_damping_and_effort_limits(package: Path, crane: Crane) -> None:
    dart = pytest.importorskip(
        "dartpy", reason="dartpy is not installed: pip install 'cranedyn[dart]'"
    )
    skeleton = dart.utils.DartLoader().parseSkeleton(str(package / "urdf" / "crane.urdf"))
    joints = [skeleton.getDof(joint.name) for joint in crane.layout.joints]
    assert [joint.getDampingCoefficient() for joint in joints] == crane.damping.tolist()
    assert [joint.getPositionLowerLimit() for joint in joints] == crane.lower.tolist()
    assert [joint.getPositionUpperLimit() for joint in joints] == crane.upper.tolist()
    drives = [joints[i].getForceUpperLimit() for i in crane.layout.drives]
    assert drives == crane.effort_limit.tolist()


class _Stub:
    """Whatever ROS would have there; remembers what it was made with."""

    def __init__(self, *args: Any, **named: Any) -> None:
        self.args = args
        self.named = named


@pytest.fixture
def launched(package: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs a launch file where ROS is not, and gives its description."""
    made: dict[str, list[str]] = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "IncludeLaunchDescription"],
        "launch.conditions": ["IfCondition"],
        "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "ament_index_python": [],
        "ament_index_python.packages": [],
    }
    for name, classes in made.items():
        module = ModuleType(name)
        vars(module).update(dict.fromkeys(classes, _Stub))
        monkeypatch.setitem(sys.modules, name, module)
    vars(module)["get_package_share_directory"] = lambda name: f"/opt/ros/share/{name}"

    def entries(name: str) -> list[_Stub]:
        launch_file = runpy.run_path(str(package / "launch" / name))
        return launch_file["generate_launch_description"]().args[0]

    return entries


def test_the_launch_files_start_what_the_package_depends_on(launched: Any, package: Path) -> None:
    root = ET.parse(package / "package.xml").getroot()
    depends = {tag.text for tag in root.iterfind("exec_depend")}
    entries = [*launched("display.launch.py"), *launched("gz.launch.py")]
    nodes = [entry.named for entry in entries if "executable" in entry.named]
    assert {node["package"] for node in nodes} < depends
    controllers = (package / "config" / "controllers.yaml").read_text()
    assert set(re.findall(r"type: (\w+)/", controllers)) < depends
    needed = {"rviz2", "robot_state_publisher", "create", "spawner"}
    assert {node["executable"] for node in nodes} >= needed


def test_the_simulated_crane_is_told_where_its_controllers_stand(
    launched: Any, package: Path
) -> None:
    entries = [entry.named for entry in launched("gz.launch.py")]
    package = package.resolve()
    (publisher,) = [one for one in entries if one.get("package") == "robot_state_publisher"]
    robot = ET.fromstring(publisher["parameters"][0]["robot_description"].encode())
    controllers = str(package / "config" / "controllers.yaml")
    assert robot.findtext("gazebo/plugin/parameters") == controllers
    spawned = [one["arguments"][0] for one in entries if one.get("executable") == "spawner"]
    assert spawned == ["joint_state_broadcaster", "drives"]
    (world,) = [one for one in entries if "launch_arguments" in one]
    assert dict(world["launch_arguments"]) == {"gz_args": f"-r {package / 'worlds' / 'crane.sdf'}"}


LAUNCH = """
import sys
from unittest.mock import MagicMock
for name in ("rclpy", "composition_interfaces", "lifecycle_msgs"):
    sys.modules[name] = MagicMock(__path__=[])
for name in ("rclpy.executors", "rclpy.logging", "rclpy.parameter", "rclpy.validate_namespace",
             "rclpy.validate_node_name", "composition_interfaces.srv", "lifecycle_msgs.msg",
             "lifecycle_msgs.srv"):
    sys.modules[name] = MagicMock()
sys.modules["rclpy.parameter"].Parameter = type("Parameter", (), {})
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
source = PythonLaunchDescriptionSource(sys.argv[1])
service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(source)]))
sys.exit(service.run())
"""
WORLD = """
from launch import LaunchDescription
from launch.actions import LogInfo
from launch.substitutions import LaunchConfiguration
def generate_launch_description():
    return LaunchDescription([LogInfo(msg=["world ", LaunchConfiguration("gz_args")])])
"""


@pytest.mark.slow
@pytest.mark.parametrize("file", ["display", "gz"])
def test_the_launch_packages_of_ros_start_each_program_with_its_arguments(
    file: str, launched: Any, package: Path, tmp_path: Path
) -> None:
    sources = os.environ.get("CRANEDYN_LAUNCH")
    if sources is None:
        pytest.skip("CRANEDYN_LAUNCH names no folder of launch, see .ci/launch")
    nodes = [e.named for e in launched(f"{file}.launch.py") if "executable" in e.named]
    for node in [*nodes, {"package": "ros_gz_sim", "executable": "create"}]:
        program = tmp_path / "lib" / node["package"] / node["executable"]
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(f'#!/bin/sh\necho "$0 $*" >> {tmp_path}/calls\n')
        program.chmod(0o755)
        index = tmp_path / "share/ament_index/resource_index/packages" / node["package"]
        index.parent.mkdir(parents=True, exist_ok=True)
        index.touch()
    world = tmp_path / "share/ros_gz_sim/launch/gz_sim.launch.py"
    world.parent.mkdir(parents=True)
    world.write_text(WORLD)
    folders = ("launch/launch", "launch_ros/launch_ros", "ament_index/ament_index_python")
    paths = [str(Path(sources, folder)) for folder in (*folders, "packages")]
    run = subprocess.run(
        [sys.executable, "-c", LAUNCH, package / "launch" / f"{file}.launch.py"],
        env={
            "PYTHONPATH": ":".join(paths),
            "AMENT_PREFIX_PATH": str(tmp_path),
            "HOME": str(tmp_path),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    calls = (tmp_path / "calls").read_text()
    for node in nodes:
        first = " ".join([node["executable"], *node.get("arguments", [])])
        assert f"/{node['package']}/{first}" in calls
    assert calls.count("\n") == len(nodes) and "Error" not in run.stderr
    if file == "gz":
        assert f"world -r {package.resolve()}/worlds/crane.sdf" in run.stdout + run.stderr


def test_the_inertia_of_a_motor_which_gazebo_does_not_know_is_refused(tmp_path: Path) -> None:
    text = load_crane().urdf.replace('armature="0"', 'armature="250.0"')
    (tmp_path / "geared.urdf").write_text(text)
    geared = load_crane(tmp_path / "geared.urdf")
    assert geared.model.armature.max() == 250.0
    with pytest.raises(ModelError, match="The joint yaw_joint has an armature"):
        ros2.export(tmp_path / "out", geared)


def test_a_crane_that_hangs_on_another_root_is_hung_on_the_world(tmp_path: Path) -> None:
    text = load_crane().urdf
    old = text[text.index('<link name="world"/>') : text.index('<link name="base_link">')]
    (tmp_path / "bare.urdf").write_text(text.replace(old, ""))
    bare = load_crane(tmp_path / "bare.urdf")
    path = ros2.export(tmp_path / "out", bare) / "urdf" / "crane.urdf"
    parent = "joint[@name='fixed_to_the_world']/parent[@link='world']"
    assert ET.parse(path).getroot().find(parent) is not None
    assert load_crane(path).model.nq == 5


OWN_CONTROL = """<transmission name="slew_gear"><joint name="yaw_joint"/></transmission>
<gazebo><plugin filename="libgz_ros2_control-system.so" name="gz_ros2_control::Theirs">
<parameters>/home/somebody/ws/config/controllers.yaml</parameters></plugin></gazebo>
<gazebo reference="hook_link"><turnGravityOff>true</turnGravityOff><mu1>0.2</mu1></gazebo>
</robot>"""
"""Control of the file's own, with a path of a machine, and a link without gravity."""


@pytest.mark.parametrize("exporter", ["ros2", "gazebo"])
def test_control_of_the_file_is_replaced_and_named(exporter: str, tmp_path: Path) -> None:
    (tmp_path / "crane.urdf").write_text(describe().replace("</robot>", OWN_CONTROL))
    crane = load_crane(tmp_path / "crane.urdf")
    folder = tmp_path / "out"
    if exporter == "ros2":
        urdf = ros2.export(folder, crane) / "urdf" / "crane.urdf"
    else:
        program = gazebo.Program(crane, hold_controller(crane), None, crane.start, 1.0)
        urdf = gazebo.export(folder, program) / "models" / "crane" / "model.urdf"
    robot = ET.parse(urdf).getroot()
    ours = {"ros2": "gz_ros2_control::GazeboSimROS2ControlPlugin", "gazebo": "drives"}[exporter]
    plugins = robot.findall("gazebo/plugin")
    assert [plugin.get("name") for plugin in plugins] == [ours]
    assert robot.find("transmission") is None
    assert robot.find(".//turnGravityOff") is None
    assert robot.find("gazebo[@reference='hook_link']/mu1") is not None
    assert "/home/somebody" not in urdf.read_text()
    readme = (folder / "README.md").read_text()
    assert "The plugin gz_ros2_control::Theirs is left out." in readme
    assert "The transmission slew_gear is replaced." in readme
    assert "<turnGravityOff> true of hook_link is left out." in readme


def test_a_package_names_the_hardware_and_the_interfaces_that_it_replaces(tmp_path: Path) -> None:
    (tmp_path / "gantry.urdf").write_text(GANTRY)
    crane = load_crane(tmp_path / "gantry.urdf", swing=True)
    readme = (ros2.export(tmp_path / "gantry", crane) / "README.md").read_text()
    assert "* The hardware mock_components/GenericSystem of <ros2_control> is replaced.\n" in readme
    for name in ("portal_joint", "cross_joint", "lift_joint"):
        sentence = f"{name} takes efforts here; its command interface velocity is replaced."
        assert f"* {sentence}\n" in readme
    for sentence in crane.swing_directions:
        assert f"* {sentence}\n" in readme
    assert "left out" not in readme  # it has no mesh
    tower = (ros2.export(tmp_path / "tower", load_crane()) / "README.md").read_text()
    assert "* Nothing was replaced or left out.\n" in tower


def test_a_package_says_how_many_meshes_it_leaves_out(tmp_path: Path) -> None:
    crane = load_crane(with_meshes(tmp_path, "mast.stl", "package://looks/jib.stl"))
    readme = (ros2.export(tmp_path / "out", crane) / "README.md").read_text()
    assert "Visuals and collisions with a mesh are left out: 1 in all." in readme


@pytest.mark.parametrize("exporter", ["ros2", "gazebo"])
def test_a_folder_says_how_its_joints_count_where_they_count_otherwise_than_in_the_file(
    exporter: str, tmp_path: Path
) -> None:
    (tmp_path / "rigid.urdf").write_text(RIGID, encoding="utf-8")
    crane = load_crane(tmp_path / "rigid.urdf", swing=True)
    folder = tmp_path / "out"
    if exporter == "ros2":
        ros2.export(folder, crane)
    else:
        gazebo.export(folder, gazebo.Program(crane, hold_controller(crane), None, crane.start, 1.0))
    readme = (folder / "README.md").read_text()
    assert "* gamma = 1.5708 rad - azimuth, the heading of the jib" in readme
    for sentence in crane.assumptions:
        assert f"* {sentence}\n" in readme


def with_meshes(folder: Path, *names: str) -> Path:
    """Write the tower crane with meshes, or with a texture for names that are of pictures."""
    text = describe()
    for name in names:
        if name.endswith(".png"):
            paint = f'<material name="paint"><texture filename="{name}"/></material>'
            looks = f'<visual><geometry><sphere radius="1"/></geometry>{paint}</visual></link>'
        else:
            looks = f'<visual><geometry><mesh filename="{name}"/></geometry></visual></link>'
        text = text.replace("</link>", looks, 1)
    (folder / "meshes.urdf").write_text(text)
    return folder / "meshes.urdf"


def test_the_package_depends_on_the_packages_whose_meshes_it_keeps(tmp_path: Path) -> None:
    path = with_meshes(
        tmp_path,
        "package://site_parts/meshes/hook.stl",
        "package://Older-Parts/jib.dae",
        "package://paints/red.png",
        "/home/somebody/mast.stl",
        "/home/somebody/blue.png",
    )
    folder = ros2.export(tmp_path / "out", load_crane(path))
    needed = [entry.text for entry in ET.parse(folder / "package.xml").iter("exec_depend")]
    assert needed == [*ros2.DEPENDENCIES, "Older-Parts", "paints", "site_parts"]
    assert "/home/somebody" not in (folder / "urdf" / "crane.urdf").read_text()


def test_a_package_that_would_hide_that_of_its_meshes_is_refused(tmp_path: Path) -> None:
    crane = load_crane(with_meshes(tmp_path, "package://site_parts/hook.stl"))
    with pytest.raises(DataError, match=r"in the ROS package site_parts, .* \(--name\)"):
        ros2.export(tmp_path / "site_parts", crane)
    ros2.export(tmp_path / "site_parts", crane, name="site_crane")


@pytest.mark.slow
def test_two_falls_are_exported_with_the_stiffness_of_the_length_at_the_start(
    tmp_path: Path,
) -> None:
    crane = load_crane(fall_spacing=1.0, hook_mass=200.0, hook_inertia=20.0, hoist_init=10.0)
    folder = ros2.export(tmp_path / "out", crane)
    same = load_crane(folder / "urdf" / "crane.urdf")
    yaw = same.layout.index("load_yaw")
    # a closed form: weight times the square of half the spacing over the length
    assert same.springs.stiffness[yaw] == pytest.approx(1200.0 * same.gravity * 0.25 / 10.0)
    assert same.springs.bifilar is None
    assert "of the length l = 10 m at the start" in (folder / "README.md").read_text()


def test_a_double_pendulum_on_two_falls_weighs_in_dart_what_it_weighs_here(tmp_path: Path) -> None:
    dart = pytest.importorskip(
        "dartpy", reason="dartpy is not installed: pip install 'cranedyn[dart]'"
    )
    crane = load_crane(fall_spacing=1.0, hook_mass=200.0, hook_inertia=20.0)
    urdf = ros2.export(tmp_path / "out", crane) / "urdf" / "crane.urdf"
    skeleton = dart.utils.DartLoader().parseSkeleton(str(urdf))
    q = crane.start.q + 0.1 * np.random.default_rng(1).normal(size=crane.layout.n)
    skeleton.setPositions(q)
    expected = pin.crba(crane.model, crane.data, q)
    expected = np.triu(expected) + np.triu(expected, 1).T
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # rounding
    assert (np.abs(skeleton.getMassMatrix() - expected) <= 1e-12 * size).all()


@pytest.mark.slow
def test_a_rope_that_stretches_is_refused_where_the_drum_is_unknown(tmp_path: Path) -> None:
    crane = load_crane(rope_stiffness=1e7)
    with pytest.raises(ModelError, match=r"hoist_joint has an armature, .* rope_stiffness 0"):
        ros2.export(tmp_path / "out", crane)


@pytest.mark.slow
def test_libsdformat_with_which_gz_sim_reads_the_urdf_finds_the_same_crane(tmp_path: Path) -> None:
    probe = build_probe()
    (tmp_path / "bridge.sdf").write_text(BRIDGE)
    cranes = {
        "usual": load_crane(),
        "hook": load_crane(hook_mass=200.0, hook_inertia=20.0, damp_sling=3.0),
        "light body": load_crane(tmp_path / "bridge.sdf"),
        "falls": load_crane(hook_mass=200.0, hook_inertia=20.0, fall_spacing=1.0),
    }
    for name, crane in cranes.items():
        urdf = ros2.export(tmp_path / name, crane) / "urdf" / "crane.urdf"
        (tree,) = read_with_libsdformat(probe, [urdf])
        joints = [joint.name for joint in crane.layout.joints]
        assert sorted(tree.screws) == sorted(joints)
        q = crane.start.q + 0.1
        mass, weight = dynamics(tree, joints, q, crane.gravity)
        expected = pin.crba(crane.model, crane.data, q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        # rounding: some ten products of matrices
        assert_allclose(mass, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
        gravity = pin.computeGeneralizedGravity(crane.model, crane.data, q)
        assert_allclose(weight, gravity, rtol=0.0, atol=1e-13 * np.abs(gravity).max())
        assert [tree.springs[joint][2] for joint in joints] == crane.damping.tolist()
    # a closed form: weight times the square of half the spacing over the length
    stiffness = 1200.0 * crane.gravity * 0.25 / 15.0
    assert tree.springs["load_yaw_joint"][0] == pytest.approx(stiffness)


@pytest.mark.slow
@pytest.mark.parametrize("exporter", ["ros2", "gazebo"])
def test_a_link_so_light_that_gazebo_drops_it_and_all_below_is_refused(
    exporter: str, tmp_path: Path
) -> None:
    (tmp_path / "light.urdf").write_text(load_crane(dummy_mass=1e-6).urdf)
    crane = load_crane(tmp_path / "light.urdf")
    with pytest.raises(OutOfRange, match=r"swing_r_link is 1e-06 kg; allowed is > 1e-06: Gazebo"):
        if exporter == "ros2":
            ros2.export(tmp_path / "out", crane)
        else:
            program = gazebo.Program(crane, hold_controller(crane), None, crane.start, 1.0)
            gazebo.export(tmp_path / "out", program)


def test_a_package_says_that_its_cylinders_are_left_out(tmp_path: Path) -> None:
    mobile = load_crane(XACRO.with_name("mobile_crane.urdf.xacro"))
    folder = ros2.export(tmp_path / "mobile", mobile)
    readme = (folder / "README.md").read_text()
    for joint in ("luff_joint", "telescope_joint"):
        assert f"The cylinder of {joint} is left out: its drive acts there." in readme
    assert "hydraulicCylinder" not in (folder / "urdf" / "crane.urdf").read_text()
