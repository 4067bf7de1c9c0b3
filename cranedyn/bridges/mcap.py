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

from cranedyn.bridges.joints import ends, joints, urdf_element
from cranedyn.bridges.target import new_file
from cranedyn.data.files import with_ending
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.errors import DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_of_run

TARGET = "FILE"
EXAMPLE = "run.mcap --trajectory out/a1/a1_l5.parquet"

FRAME_PERIOD = 0.02
"""Least time between messages of frames [s]; joints have a message at every row."""

TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/joint_setpoints": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/robot_description": "std_msgs/msg/String",
}
"""Topics by their usual names, with the types of their messages."""

_FOREVER = "{sec: 9223372036, nsec: 854775807}"

PROFILES = {
    topic: "- {history: 1, depth: 1, reliability: 1, durability: 1, "
    f"deadline: {_FOREVER}, lifespan: {_FOREVER}, liveliness: 1, "
    f"liveliness_lease_duration: {_FOREVER}, avoid_ros_namespace_conventions: false}}"
    for topic in ("/tf_static", "/robot_description")
}
"""Quality of service of the topics that have one message, in the numbers of rmw, which rosbag2
reads from Humble on: reliable and transient local, so that a later subscriber receives it.
"""

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
    ms apart or more; ``/tf_static`` and ``/robot_description`` stand at the first time, and reach
    later subscribers, too (`PROFILES`). Times are those of the run, from 0 on, in the header, as
    log time and as publish time.

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
        schemas, encoders, channels = {}, {}, {}
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
    moving = joints(crane, robot)
    driven = [joint for joint in moving if joint.driven]
    names, drives = [joint.name for joint in moving], [joint.name for joint in driven]
    times = np.rint(1e9 * run.t).astype(int).tolist()
    efforts = np.zeros_like(run.q)
    efforts[:, [moving.index(joint) for joint in driven]] = run.effort
    links = {element.get("name", ""): ends(element) for element in robot.iterfind("joint")}
    frames = [links.pop(joint.name) for joint in moving]
    yield "/robot_description", times[0], {"data": crane.urdf}
    yield "/tf_static", times[0], _transforms(crane, run.q[0], times[0], [*links.values()])
    last_frame = -np.inf
    for k, time in enumerate(times):
        for topic, joint_names, *columns in (
            ("/joint_states", names, run.q[k], run.v[k], efforts[k]),
            ("/joint_setpoints", drives, run.setpoint[k], np.empty(0), run.command[k]),
        ):
            fields = zip(("position", "velocity", "effort"), columns, strict=True)
            numbers = {field: column.tolist() for field, column in fields}
            yield topic, time, {"header": _header(time), "name": joint_names, **numbers}
        if run.t[k] > last_frame + FRAME_PERIOD - 1e-9:
            last_frame = run.t[k]
            yield "/tf", time, _transforms(crane, run.q[k], time, frames)


def _header(time: int, frame: str = "") -> dict[str, Any]:
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": frame}


def _transforms(
    crane: Crane, q: np.ndarray, time: int, links: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    """Return the frames of links in those of their parents, pairs of parent and child, at
    coordinates q and a time [ns].
    """
    model = crane.model
    data = crane.data
    transforms = []
    pin.framesForwardKinematics(model, data, q)
    for names in links:
        parent, child = (data.oMf[model.getFrameId(name, pin.BODY)] for name in names)
        x, y, z, *rotation = pin.SE3ToXYZQUAT(parent.actInv(child)).tolist()
        transform = {
            "translation": {"x": x, "y": y, "z": z},
            "rotation": dict(zip("xyzw", rotation, strict=True)),
        }
        header = _header(time, names[0])
        transforms.append({"header": header, "child_frame_id": names[1], "transform": transform})
    return {"transforms": transforms}


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
