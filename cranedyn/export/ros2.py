"""ROS 2: the crane as a description package for ament, with launch files, RViz, ros2_control and a
world for gz sim.
"""

from __future__ import annotations

import argparse
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from cranedyn.checks import number
from cranedyn.command import command_line
from cranedyn.errors import DataError
from cranedyn.export.crane_data import (
    GAZEBO_LEAST_MASS,
    ExportedJoint,
    add,
    anchor_to_world,
    check_inertias,
    give_light_bodies,
    joints,
    mesh_notes,
    package_of,
    readme,
    remove_control,
    urdf_element,
    write_length_spring,
    xml_bytes,
)
from cranedyn.export.gazebo import ARTICLE_ERP, world
from cranedyn.export.point_masses import give_bodies_to_points
from cranedyn.export.target import new_folder
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "DIR"
"""What the command line calls the target of the export."""

EXAMPLE = "crane_description"
"""Example of a target, for the help of the command line."""

_PACKAGE_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
"""Names that ROS allows for a package (REP 144): words of small letters and digits, joined by
single underlines."""

RATE = 200
"""Rate of the controllers [Hz], as in the article."""

_TEMPLATES = Path(__file__).with_name("templates") / "ros2"
"""Folder of the texts that do not depend on the crane: launch files, display, build."""

DEPENDENCIES = (
    "controller_manager",
    "forward_command_controller",
    "gz_ros2_control",
    "joint_state_broadcaster",
    "joint_state_publisher_gui",
    "robot_state_publisher",
    "ros_gz_bridge",
    "ros_gz_sim",
    "rviz2",
)
"""Packages that the launch files use."""

_SYSTEMS = {
    "gz-sim-physics-system": "gz::sim::systems::Physics",
    "gz-sim-user-commands-system": "gz::sim::systems::UserCommands",
    "gz-sim-scene-broadcaster-system": "gz::sim::systems::SceneBroadcaster",
}
"""Plugins of a world of gz sim: physics, insertion of models, display."""

_PLACEHOLDERS = (
    "\n## Before you publish it\n\nEnter maintainer and licence in `package.xml`; both are "
    "placeholders.\n"
)
"""Section of the README of a package."""


def export(folder: str | Path, crane: Crane, *, name: str | None = None, dt: float = 5e-4) -> Path:
    """Write a description package.

    Only the drives have command interfaces. The passive joints have state interfaces, position and
    velocity, so that nothing overwrites their swing. Initial values put every joint into its range
    and let each drive exert, until its first command, the effort that holds the crane there.

    The URDF has no comments, and only those meshes that are in ROS packages, on which the package
    then depends. Gravity acts on all links. Plugins and transmissions of the crane's own file are
    replaced. A load on two falls has the yaw stiffness of the length at the start. A hook block
    that is a point becomes a solid ball of steel, and links without mass get a part of it. The
    README.md of the package says what was changed or left out, and where the stiffness holds.

    Args:
        folder: New folder.
        crane: The crane.
        name: Name of the package; None for the name of the folder, or crane_description where ROS
            does not allow that.
        dt: Physics step of the worlds [s].

    Raises:
        DataError: If the folder exists or cannot be written, ROS does not allow the name, or it is
            the name of a package with meshes of the crane.
        ModelError: If the crane has a link without mass or inertia, a joint with an armature, a
            rope with mass, or one that goes slack without stretching.
        OutOfRange: If the step is not positive.
    """
    folder = Path(folder)
    if name is None:
        name = folder.name if _PACKAGE_NAME.fullmatch(folder.name) else "crane_description"
    if not _PACKAGE_NAME.fullmatch(name):
        raise DataError(
            f"A package of ROS cannot be called {name!r}; allowed are small letters, digits and "
            "single underlines."
        )
    number("dt", dt, "s", "> 0")
    crane.require_light_rope("The export to ROS 2")
    robot = urdf_element(crane, keep_package_meshes=True)
    mesh_packages = _mesh_packages(robot)
    if name in mesh_packages:
        raise DataError(
            f"Meshes of the crane are in the ROS package {name}, which a new package of this name "
            "would hide; choose another name (--name)."
        )
    notes = mesh_notes(crane, robot) + remove_control(robot)
    anchor_to_world(crane, robot, "ROS")
    notes += write_length_spring(crane, robot)
    notes += give_bodies_to_points(crane, robot)
    notes += _follower_notes(crane)
    give_light_bodies(crane, robot)
    check_inertias(crane, robot, "Gazebo", least_mass=GAZEBO_LEAST_MASS)
    moving = joints(crane, robot)
    robot.append(_control(moving))
    name_of_plugin = "gz_ros2_control::GazeboSimROS2ControlPlugin"
    plugin = add(
        add(robot, "gazebo"), "plugin", filename="gz_ros2_control-system", name=name_of_plugin
    )
    # The launch file, which knows where the package is, puts the path of controllers.yaml there.
    add(plugin, "parameters", "CONTROLLERS_YAML")
    with new_folder(folder) as draft:
        shutil.copytree(
            _TEMPLATES, draft, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__")
        )
        cmake = draft / "CMakeLists.txt"
        cmake.write_text(cmake.read_text().replace("@NAME@", name))
        for subfolder in ("config", "urdf", "worlds"):
            (draft / subfolder).mkdir()
        (draft / "config" / "controllers.yaml").write_text(
            _controllers([joint.name for joint in moving if joint.driven])
        )
        text = readme(name, crane, notes) + _PLACEHOLDERS
        (draft / "README.md").write_text(text, encoding="utf-8")
        trees = {
            "package.xml": _package(name, mesh_packages),
            "urdf/crane.urdf": robot,
            "worlds/crane.sdf": _gz_world(crane, dt),
            "worlds/classic.sdf": world(crane.gravity, dt, "world", ARTICLE_ERP),
        }
        for path, tree in trees.items():
            (draft / path).write_bytes(xml_bytes(tree))
    return folder


def _follower_notes(crane: Crane) -> list[str]:
    """Return a sentence on each joint that follows another: RViz and the description know it, and
    the default engine of gz sim and Gazebo Classic let it move freely.
    """
    return [
        f"{joint.name} follows {joint.follows} (<mimic>). gz sim couples them only with the engine "
        "gz-physics-bullet-featherstone-plugin; with its default engine, and in Gazebo Classic, "
        f"{joint.name} moves freely. To simulate there, export the crane with {joint.follows} held "
        "(--locked)."
        for joint in crane.layout.joints
        if joint.follows
    ]


def _control(moving: Sequence[ExportedJoint]) -> ET.Element:
    """Return the interfaces of ros2_control: commands for the drives, states for all."""
    control = ET.Element("ros2_control", name="crane", type="system")
    add(add(control, "hardware"), "plugin", "gz_ros2_control/GazeboSimSystem")
    for joint in moving:
        entry = add(control, "joint", name=joint.name)
        if joint.driven:
            command = add(entry, "command_interface", name="effort")
            add(command, "param", repr(-joint.effort), name="min")
            add(command, "param", repr(joint.effort), name="max")
        states = {"position": joint.start, "velocity": 0.0}
        if joint.driven:
            # gz_ros2_control begins the effort command with the initial value of the effort state.
            states["effort"] = joint.holding
        for name, value in states.items():
            state = add(entry, "state_interface", name=name)
            add(state, "param", repr(value), name="initial_value")
    return control


def _controllers(drives: Sequence[str]) -> str:
    """Return the settings of ros2_control in YAML: a broadcaster of the states, and a controller
    that passes efforts on to these joints.
    """
    listed = "".join(f"      - {_yaml(name)}\n" for name in drives)
    return f"""controller_manager:
  ros__parameters:
    update_rate: {RATE}
    joint_state_broadcaster:
      type: joint_state_broadcaster/JointStateBroadcaster
    drives:
      type: forward_command_controller/ForwardCommandController

drives:
  ros__parameters:
    interface_name: effort
    joints:
{listed}"""


def _yaml(name: str) -> str:
    """Return a name as a YAML string, whatever characters it has."""
    plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in name)
    return f'"{"".join(plain)}"'


def _mesh_packages(robot: ET.Element) -> list[str]:
    """Return the names of the ROS packages in which meshes and textures of a URDF are."""
    packages = set()
    for tag in ("mesh", "texture"):
        for element in robot.iter(tag):
            packages.add(package_of(element))
    return sorted(packages - {""})


def _package(name: str, mesh_packages: Sequence[str]) -> ET.Element:
    """Return the package.xml of a package.

    Args:
        name: Name of the package.
        mesh_packages: Packages in which meshes of the crane are.
    """
    package = ET.Element("package", format="3")
    add(package, "name", name)
    add(package, "version", "0.1.0")
    about = "A crane with driven and passive joints, written by cranedyn."
    add(package, "description", about)
    # As `ros2 pkg create` writes it: the licence of a crane is not that of this project.
    add(package, "maintainer", "nobody", email="nobody@example.org")
    add(package, "license", "TODO: License declaration")
    add(package, "buildtool_depend", "ament_cmake")
    for dependency in DEPENDENCIES:
        add(package, "exec_depend", dependency)
    for dependency in mesh_packages:
        if dependency not in DEPENDENCIES:
            add(package, "exec_depend", dependency)
    add(add(package, "export"), "build_type", "ament_cmake")
    return package


def _gz_world(crane: Crane, dt: float) -> ET.Element:
    """Return a world of gz sim with the gravity of a crane and a physics step [s], as SDF."""
    sdf = ET.Element("sdf", version="1.7")
    scene = add(sdf, "world", name="crane")
    add(scene, "gravity", f"0 0 {-crane.gravity!r}")
    # gz sim uses DART, whatever the type.
    physics = add(scene, "physics", name="steps", type="ignored")
    add(physics, "max_step_size", repr(dt))
    add(physics, "real_time_factor", "1")
    for file, name in _SYSTEMS.items():
        add(scene, "plugin", filename=file, name=name)
    light = add(scene, "light", type="directional", name="sun")
    add(light, "direction", "-0.5 0.3 -0.9")
    return sdf


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    parser.add_argument("--name", help="of the package; that of DIR if left out")
    parser.add_argument(
        "--dt", type=float, default=5e-4, metavar="DT", help="physics step of the worlds [s]"
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    return export(options.target, crane_from_options(options), name=options.name, dt=options.dt)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    return [
        command_line("colcon", "build", "--base-paths", options.target),
        command_line("cranedyn", "describe", "--urdf", options.target / "urdf" / "crane.urdf"),
    ]
