"""MCAP: a run as ROS 2 messages, for Foxglove, PlotJuggler, RViz and rosbag2: joints, frames,
setpoints, and the robot's description.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.command import command_line
from cranedyn.data.files import with_ending
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.errors import DataError, OutOfRange
from cranedyn.export.crane_data import ends, joints, urdf_element
from cranedyn.export.target import new_file
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_of_run, crane_words

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "run.mcap --trajectory out/a1/a1_l5.parquet"
"""Example of a target, for the help of the command line."""

FRAME_PERIOD = 0.02
"""Least time between messages of frames [s]; joints have a message at every row."""

_ROUND_OFF = 1e-9
"""Round-off of the times of rows [s]."""

TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/joint_setpoints": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/robot_description": "std_msgs/msg/String",
}
"""Topics by their usual names, with the types of their messages."""

_FOREVER = "{sec: 9223372036, nsec: 854775807}"
"""Largest duration of ROS 2, which stands for no limit of time."""

_LATCHED = (
    "- {history: 1, depth: 1, reliability: 1, durability: 1, "
    f"deadline: {_FOREVER}, lifespan: {_FOREVER}, liveliness: 1, "
    f"liveliness_lease_duration: {_FOREVER}, avoid_ros_namespace_conventions: false}}"
)
"""Quality of service in the numbers of rmw, which rosbag2 reads from Humble on: reliable and
transient local, so that a later subscriber receives the last message."""

WORLD = "world"
"""Frame in which a base moves, if the run has one."""

OTHER_WORLD = "earth"
"""The same for a crane whose root link is named as that frame."""

PROFILES = {"/tf_static": _LATCHED, "/robot_description": _LATCHED}
"""Quality of service of the topics that have one message only."""

Message = tuple[str, int, dict[str, Any]]
"""Topic, time [ns], message."""


def check_installed() -> None:
    """Check that the extra is installed.

    Raises:
        DataError: If it is not.
    """
    for module, package in (("mcap_ros2", "mcap-ros2-support"), ("rosbags", "rosbags")):
        if find_spec(module) is None:
            raise DataError(f"{package} is not installed: pip install 'cranedyn[mcap]'.")


def export(file: str | Path, crane: Crane, trajectory: Trajectory) -> Path:
    """Write a run as MCAP.

    ``/joint_states`` has all moving joints by their names in the URDF, with position, velocity and
    effort, of the drives the effort that acted, 0 for passive joints. ``/joint_setpoints`` has the
    drives with position wanted and effort commanded. ``/tf`` has a frame for each moving link, 20
    ms apart or more; on a base that moves, also for the root link in the world, whose frame is
    `WORLD` or `OTHER_WORLD`. ``/tf_static`` and ``/robot_description`` stand at the first time, and
    reach later subscribers, too (`PROFILES`). Times are those of the run, from 0 on, in the header,
    as log time and as publish time.

    Args:
        file: New file, ending in .mcap.
        crane: Crane of the run.
        trajectory: Run to write.

    Raises:
        DataError: If the extra ``mcap`` is not installed, the ending is not .mcap, or the file
            exists or cannot be written.
        OutOfRange: If the run has no row, begins before time 0, or is of another crane.
    """
    check_installed()
    from mcap.writer import Writer
    from mcap_ros2._dynamic import serialize_dynamic
    from rosbags.typesys import Stores, get_typestore

    file = with_ending(file, ".mcap")
    trajectory.check_coordinates(crane.layout.columns()["q"])
    if not len(trajectory) or trajectory.t[0] < 0.0:
        first = trajectory.t[0] if len(trajectory) else "that of no row"
        raise OutOfRange(
            "time at the start of a run in MCAP", first, "0 or later: times there have no sign", "s"
        )
    robot = urdf_element(crane)
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    with new_file(file) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schemas = {}
        encoders = {}
        channels = {}
        for name in dict.fromkeys(TYPES.values()):
            definition = typestore.generate_msgdef(name, ros_version=2)[0]
            schemas[name] = writer.register_schema(name, "ros2msg", definition.encode())
            encoders[name] = serialize_dynamic(name, definition)[name]
        for topic, name in TYPES.items():
            profile = {"offered_qos_profiles": PROFILES[topic]} if topic in PROFILES else {}
            channels[topic] = writer.register_channel(topic, "cdr", schemas[name], profile)
        for topic, time, message in _messages(crane, robot, trajectory):
            data = encoders[TYPES[topic]](message)
            writer.add_message(channels[topic], log_time=time, data=data, publish_time=time)
        writer.finish()
    return file


def _messages(crane: Crane, robot: ET.Element, run: Trajectory) -> Iterator[Message]:
    """Yield the messages of a run in the order of their times."""
    moving = joints(crane, robot)
    driven = [joint for joint in moving if joint.driven]
    names = [joint.name for joint in moving]
    drives = [joint.name for joint in driven]
    times = np.rint(1e9 * run.t).astype(int).tolist()
    efforts = np.zeros_like(run.q)
    efforts[:, [moving.index(joint) for joint in driven]] = run.effort
    no_rates = np.empty(0)

    # The links of joints that move, and of the fixed ones.
    links = {element.get("name", ""): ends(element) for element in robot.iterfind("joint")}
    frames = [links.pop(joint.name) for joint in moving]
    fixed_frames = list(links.values())
    # The link that hangs from no joint: a base that moves carries it.
    children = {child for _, child in [*frames, *fixed_frames]}
    root = next(
        name for link in robot.iterfind("link") if (name := link.get("name", "")) not in children
    )
    yield "/robot_description", times[0], {"data": crane.urdf}
    yield "/tf_static", times[0], _transforms(crane, run.q[0], times[0], fixed_frames)
    last_frame = -np.inf
    for k, time in enumerate(times):
        yield "/joint_states", time, _joint_state(time, names, run.q[k], run.v[k], efforts[k])
        setpoint = _joint_state(time, drives, run.setpoint[k], no_rates, run.command[k])
        yield "/joint_setpoints", time, setpoint
        if run.t[k] > last_frame + FRAME_PERIOD - _ROUND_OFF:
            last_frame = run.t[k]
            message = _transforms(crane, run.q[k], time, frames)
            if run.base is not None:
                message["transforms"].append(_base_transform(root, run.base[k], time))
            yield "/tf", time, message


def _joint_state(
    time: int,
    names: Sequence[str],
    position: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
) -> dict[str, Any]:
    """Return a message of joint states at a time [ns]; an array may be empty."""
    return {
        "header": _header(time),
        "name": names,
        "position": position.tolist(),
        "velocity": velocity.tolist(),
        "effort": effort.tolist(),
    }


def _header(time: int, frame: str = "") -> dict[str, Any]:
    """Return the header of a message with a time [ns] and a frame."""
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": frame}


def _transforms(
    crane: Crane, q: np.ndarray, time: int, links: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    """Return a message of the frames of links in those of their parents.

    Args:
        crane: The crane.
        q: Coordinates, shape (n,).
        time: Time [ns].
        links: Names of the parent and of the link.
    """
    model = crane.model
    data = crane.data
    transforms = []
    pin.framesForwardKinematics(model, data, q)
    for parent_name, child_name in links:
        parent = data.oMf[model.getFrameId(parent_name, pin.BODY)]
        child = data.oMf[model.getFrameId(child_name, pin.BODY)]
        x, y, z, *rotation = pin.SE3ToXYZQUAT(parent.actInv(child)).tolist()
        transforms.append(
            {
                "header": _header(time, parent_name),
                "child_frame_id": child_name,
                "transform": {
                    "translation": {"x": x, "y": y, "z": z},
                    "rotation": dict(zip("xyzw", rotation, strict=True)),
                },
            }
        )
    return {"transforms": transforms}


def _base_transform(root: str, base: np.ndarray, time: int) -> dict[str, Any]:
    """Return the frame of the root of a crane on a base that moves, in the world.

    Args:
        root: Name of the root link.
        base: Surge, sway, heave [m], roll, pitch and yaw [rad], shape (6,).
        time: Time [ns].
    """
    x, y, z, *rotation = pin.SE3ToXYZQUAT(
        pin.SE3(pin.rpy.rpyToMatrix(*base[3:]), base[:3])
    ).tolist()
    return {
        "header": _header(time, WORLD if root != WORLD else OTHER_WORLD),
        "child_frame_id": root,
        "transform": {
            "translation": {"x": x, "y": y, "z": z},
            "rotation": dict(zip("xyzw", rotation, strict=True)),
        },
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument(
        "--trajectory",
        required=True,
        metavar="FILE",
        help="the run, a .csv or .parquet file as experiments write",
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    check_installed()
    trajectory = read(options.trajectory)
    return export(options.target, crane_of_run(options, trajectory, options.trajectory), trajectory)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    crane = crane_words(options)
    identify = command_line("cranedyn", "run", "identify", options.target, *crane)
    return [
        command_line("ros2", "bag", "info", options.target),
        identify if crane else f"{identify}  # add the options that name another crane of the run",
    ]
