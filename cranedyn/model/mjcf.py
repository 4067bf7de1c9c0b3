"""A crane in MuJoCo's format, MJCF, as MuJoCo's own compiler understands it.

MJCF has defaults, frames, replicas, units and rules for inertia that no other reader knows in full.
So the file is compiled by MuJoCo, in a process of its own (`cranedyn.model.mjcf_compiler`), and the
compiled model becomes a URDF: a link for each body, and a chain of joints where a body has several.
Accelerations of that URDF by Pinocchio, with its damping, springs and armature, are then compared
with those that MuJoCo computes at random states: a file in which anything else acts on the bodies
is refused, whatever it is. Actuators, limits, contacts and dry friction do not act at these states;
what is read of them is checked one by one.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.data import reading_process
from cranedyn.data.files import read_text
from cranedyn.data.reading_process import json_reply, run_reader, why_it_ended
from cranedyn.errors import CraneError, ModelError, OutOfRange, printable, quoted
from cranedyn.model.crane import NO_RATE_LIMIT
from cranedyn.model.foreign import ForeignModel
from cranedyn.model.joints import (
    MAX_MOVING_JOINTS,
    complete_limits,
    joint_names,
    read_armature,
)
from cranedyn.model.urdf import inertial_element, numbers_text, parse_urdf, set_placement, skeleton

_PROGRAM = Path(__file__).with_name("mjcf_compiler.py")

_MOST_INCLUDED = 100
"""Number of files that one model may include."""

_FOLDERS = ("meshdir", "texturedir", "assetdir")
"""Attributes of ``<compiler>`` that name folders."""

_SLIDE_REACH = 1e3
"""Range to either side of a sliding joint without limits [m]."""

_EFFORT = 1e6
"""Largest effort of a drive without a limit [N or N m]."""

_LARGEST_TILT = 1e-5
"""Largest angle between gravity and the vertical at which it counts as vertical [rad]."""

_AGREEMENT = 1e-7
"""Largest difference from MuJoCo's accelerations, as a share of the largest of them: round-off of
two algorithms on masses that differ by up to 10⁷."""


def read_mjcf(root: ET.Element, path: Path) -> ForeignModel:
    """Return the model of an MJCF file as a URDF.

    Bodies, inertias, joints, ranges, damping, armature, springs, dry friction, the efforts of
    actuators, gravity and the start come from the model that MuJoCo compiles. The joints of
    actuators are driven. A ball joint becomes two hinges, about X and then Y of its body, since a
    rope does not turn its load.

    Args:
        root: Root of the file, already parsed.
        path: The file; it and the files that it names must be in one folder.

    Raises:
        DataError: If the file or one that it includes cannot be read, or takes too long.
        ModelError: If MuJoCo refuses the file, if a crane cannot be what it describes (free bodies,
            tendons with forces, equality constraints, actuators on anything but a joint, a load
            that stands on something), or if a file is named outside of its folder.
        OutOfRange: If gravity does not point along -Z.
        CraneError: If MuJoCo is not installed.
    """
    _check_files(root, path)
    model = _compiled(path)
    robot = _Converter(model, path).robot()
    notes = [printable(note) for note in model["notes"]]
    notes += _drive_notes(model)
    _compare(robot, model, path)
    return ForeignModel(robot, _gravity(model, path), notes)


def _check_files(root: ET.Element, path: Path) -> None:
    """Check that a model names no file outside of its folder, nor do the files that it includes.

    Raises:
        ModelError: If one does, or too many files are included.
        DataError: If an included file cannot be read.
    """
    home = path.resolve().parent
    waiting = [(root, path)]
    seen = {path.resolve()}
    while waiting:
        element_root, source = waiting.pop()
        folders = [
            compiler.get(name, "")
            for compiler in element_root.iter("compiler")
            for name in _FOLDERS
            if compiler.get(name)
        ]
        for element in element_root.iter():
            for name, value in element.attrib.items():
                if not (name.startswith("file") or name in _FOLDERS) or not value:
                    continue
                for folder in ["", *folders]:
                    if not (home / folder / value).resolve().is_relative_to(home):
                        raise ModelError(
                            f"{source} names {quoted(value)}, which is outside of its folder; put "
                            "all files of the model in one folder, or folders in it."
                        )
            if element.tag not in ("include", "model") or not element.get("file"):
                continue
            included = (home / element.get("file", "")).resolve()
            if included in seen:
                continue
            seen.add(included)
            if len(seen) > _MOST_INCLUDED:
                raise ModelError(f"{path} includes more than {_MOST_INCLUDED} files.")
            waiting.append((parse_urdf(read_text(included), included), included))


def _compiled(path: Path) -> dict[str, Any]:
    """Return what MuJoCo's compiler makes of a file, see `cranedyn.model.mjcf_compiler`."""
    import tempfile  # takes milliseconds, and few cranes are MJCF

    limits = [str(reading_process.MEMORY), str(reading_process.CPU_TIME), str(MAX_MOVING_JOINTS)]
    # In a folder of its own, since MuJoCo writes its log into the current one.
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as output:
        arguments = [str(path.resolve()), *limits]
        code = run_reader(_PROGRAM, arguments, path, output, folder=folder)
        output.seek(0)
        lines = output.read().decode("utf-8", "replace").splitlines()
    found = json_reply(lines[-1]) if lines else {}
    if found.get("missing"):
        raise CraneError(
            f"{path} is an MJCF, which MuJoCo reads, and MuJoCo is not installed: pip install "
            "'cranedyn[mujoco]'."
        )
    if "error" in found:
        reason = printable(" ".join(str(found["error"]).split()).rstrip("."))
        raise ModelError(f"{path} is not a crane in MJCF: {reason}.")
    if "model" not in found:
        raise ModelError(f"{path} cannot be loaded: {why_it_ended(code)}.")
    model: dict[str, Any] = found["model"]
    return model


def _gravity(model: dict[str, Any], path: Path) -> float:
    """Return gravity along -Z [m/s²], 0 where the file switches it off.

    Raises:
        OutOfRange: If it points elsewhere.
    """
    along_x, along_y, along_z = model["gravity"]
    size = math.hypot(along_x, along_y, along_z)
    if math.hypot(along_x, along_y) > _LARGEST_TILT * size or along_z > 0.0:
        vector = f"{along_x:g} {along_y:g} {along_z:g}"
        allowed = "a vector along -Z of the world; turn the model so that it points there"
        raise OutOfRange(f"gravity of {path}", vector, allowed, "m/s²")
    return size


def _drive_notes(model: dict[str, Any]) -> list[str]:
    """Return a note on each drive whose range of efforts is infinite or not symmetric, or which is
    more than a motor.
    """
    notes = []
    for joint in model["joints"]:
        drive = joint["drive"]
        unit = "N" if joint["slides"] else "N m"
        if drive is None:
            continue
        name = printable(joint["name"])
        low, high = drive["low"], drive["high"]
        if not (math.isfinite(low) and math.isfinite(high)):
            notes.append(f"{name} has no largest effort in the file; {_EFFORT:g} {unit} are taken.")
        elif low != -high:
            largest = max(abs(low), abs(high))
            notes.append(
                f"The actuator of {name} exerts {low:g} to {high:g} {unit}; ±{largest:g} {unit} "
                "are taken."
            )
        if drive["kinds"]:
            notes.append(
                f"{name} is moved by {drive['kinds'][0]} in the file; here its drive does what "
                "the controller commands."
            )
    return notes


class _Converter:
    """Converter of a compiled model to a URDF.

    A joint of MuJoCo turns its body about an anchor by its coordinate less the reference value at
    which the body is where the file places it. A link has its origin at the anchor of its joint.
    """

    def __init__(self, model: dict[str, Any], path: Path) -> None:
        self._model = model
        self._path = path
        self._robot = ET.Element("robot", name=printable(model["name"] or "crane"))
        self._control = ET.SubElement(self._robot, "ros2_control", name="drives", type="system")
        self._names = {joint["name"] for joint in model["joints"]}
        # Name of the link that a body is, and where the frame of the body is in that link.
        self._links: list[tuple[str, pin.SE3]] = []

    def robot(self) -> ET.Element:
        """Return the URDF."""
        by_body: dict[int, list[dict[str, Any]]] = {}
        for joint in self._model["joints"]:
            by_body.setdefault(joint["body"], []).append(joint)
        for index, body in enumerate(self._model["bodies"]):
            if index == 0:
                name = self._new_name("world")
                self._links.append((name, pin.SE3.Identity()))
                self._link(name, body, pin.SE3.Identity(), index)
            else:
                self._add_body(index, body, by_body.get(index, []))
        return self._robot

    def _add_body(self, index: int, body: dict[str, Any], joints: list[dict[str, Any]]) -> None:
        parent, frame = self._links[body["parent"]]
        placement = frame * _pose(body["position"], body["quaternion"])
        name = self._new_name(body["name"])
        if not joints:
            joint = self._joint(f"{name}_fixed", "fixed", parent, name)
            set_placement(joint, placement)
            in_link = pin.SE3.Identity()
        for k, description in enumerate(joints):
            child = name if k == len(joints) - 1 else self._new_name(f"{name}_{k + 1}")
            anchor = pin.SE3(np.eye(3), np.array(description["position"], dtype=float))
            self._add_joint(description, parent, child, placement * anchor)
            if k < len(joints) - 1:
                ET.SubElement(self._robot, "link", name=child)
            parent = child
            placement = anchor.inverse()
            in_link = placement
        self._links.append((name, in_link))
        self._link(name, body, in_link, index)

    def _add_joint(
        self, description: dict[str, Any], parent: str, child: str, anchor: pin.SE3
    ) -> None:
        """Add a joint; `anchor` is its placement in its parent in the reference posture."""
        name = description["name"]
        slides = description["slides"]
        axis = np.array(description["axis"], dtype=float)
        kind = "prismatic" if slides else "revolute"
        if description["range"] is None:
            low, high = (-_SLIDE_REACH, _SLIDE_REACH) if slides else (None, None)
            kind = kind if slides else "continuous"
        else:
            low, high = description["range"]
        joint = self._joint(name, kind, parent, child)
        back = -float(description["reference"]) * axis
        step = pin.SE3(np.eye(3), back) if slides else pin.SE3(pin.exp3(back), np.zeros(3))
        set_placement(joint, anchor * step)
        ET.SubElement(joint, "axis", xyz=numbers_text(axis))
        drive = description["drive"]
        effort = 0.0
        if drive is not None:
            effort = max(abs(drive["low"]), abs(drive["high"]))
            effort = effort if math.isfinite(effort) else _EFFORT
        limits = {"effort": repr(effort), "velocity": repr(NO_RATE_LIMIT)}
        if low is not None and high is not None:
            limits |= {"lower": repr(float(low)), "upper": repr(float(high))}
        ET.SubElement(joint, "limit", limits)
        dynamics = {key: repr(description[key]) for key in ("damping", "friction", "armature")}
        ET.SubElement(joint, "dynamics", dynamics)
        if description["stiffness"] != 0.0:
            block = ET.SubElement(self._robot, "gazebo", reference=name)
            ET.SubElement(block, "springStiffness").text = repr(description["stiffness"])
            ET.SubElement(block, "springReference").text = repr(description["slack"])
        self._add_control(description)

    def _add_control(self, description: dict[str, Any]) -> None:
        """Say whether a joint is driven, and where it starts."""
        control = ET.SubElement(self._control, "joint", name=description["name"])
        if description["drive"] is not None:
            ET.SubElement(control, "command_interface", name="effort")
        state = ET.SubElement(control, "state_interface", name="position")
        ET.SubElement(state, "param", name="initial_value").text = repr(description["start"])

    def _joint(self, name: str, kind: str, parent: str, child: str) -> ET.Element:
        joint = ET.SubElement(self._robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        return joint

    def _link(self, name: str, body: dict[str, Any], frame: pin.SE3, index: int) -> None:
        """Add the link of a body, whose frame is at `frame` in the link."""
        link = ET.SubElement(self._robot, "link", name=name)
        if body["mass"] > 0.0:
            principal = _pose(body["centre"], body["principal_axes"])
            inertia = pin.Inertia(body["mass"], np.zeros(3), np.diag(body["moments"]))
            link.append(inertial_element((frame * principal).act(inertia)))
        for shape in self._model["shapes"]:
            if shape["body"] == index:
                _add_shape(link, shape, frame)

    def _new_name(self, name: str) -> str:
        """Return a name that no link or joint has yet; URDF's parsers want all to differ."""
        while name in self._names:
            name += "_link"
        self._names.add(name)
        return name


def _pose(position: list[float], quaternion: list[float]) -> pin.SE3:
    """Return a placement from a position [m] and a quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(position, dtype=float))


def _add_shape(link: ET.Element, shape: dict[str, Any], frame: pin.SE3) -> None:
    """Add a geom to a link: as a visual if it is shown, and as a collision if it is solid."""
    pose = frame * _pose(shape["position"], shape["quaternion"])
    size = shape["size"]
    if shape["kind"] == "box":
        parts = [("box", {"size": numbers_text(2.0 * np.array(size))}, 0.0)]
    elif shape["kind"] == "sphere":
        parts = [("sphere", {"radius": repr(size[0])}, 0.0)]
    else:
        radius, half = size[0], size[1]
        parts = [("cylinder", {"radius": repr(radius), "length": repr(2.0 * half)}, 0.0)]
        if shape["kind"] == "capsule":
            parts += [("sphere", {"radius": repr(radius)}, end) for end in (half, -half)]
    roles = [role for role, key in (("visual", "visible"), ("collision", "solid")) if shape[key]]
    for role in roles:
        for kind, measures, along in parts:
            element = ET.SubElement(link, role)
            set_placement(element, pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, along])))
            geometry = ET.SubElement(element, "geometry")
            ET.SubElement(geometry, kind, measures)
            if role == "visual":
                material = ET.SubElement(element, "material", name="")
                ET.SubElement(material, "color", rgba=numbers_text(np.array(shape["colour"])))


def _compare(robot: ET.Element, model: dict[str, Any], path: Path) -> None:
    """Compare accelerations of the URDF, by Pinocchio, with those of MuJoCo at the same states.

    Raises:
        ModelError: If they differ.
    """
    # Pinocchio gives a joint without a range two coordinates.
    limited = deepcopy(robot)
    complete_limits(limited, None)
    rigid = pin.buildModelFromXML(skeleton(limited))
    names = joint_names(rigid)
    if sorted(names) != sorted(joint["name"] for joint in model["joints"]):
        raise ModelError(f"{path} cannot be loaded: only {len(names)} of its joints became joints.")
    if not names:
        return
    order = [names.index(joint["name"]) for joint in model["joints"]]
    stiffness, slack = _springs_of(robot, names)
    rigid.gravity.linear = np.array(model["gravity"], dtype=float)
    rigid.armature = read_armature(robot, names)
    data = rigid.createData()
    for state in model["states"]:
        q, v, effort = np.zeros((3, rigid.nv))
        q[order], v[order], effort[order] = state["q"], state["v"], state["effort"]
        effort = effort - rigid.damping * v - stiffness * (q - slack)
        ours = pin.aba(rigid, data, q, v, effort)[order]
        theirs = np.array(state["acceleration"], dtype=float)
        largest = np.abs(theirs).max()
        if not (np.isfinite(ours).all() and np.isfinite(theirs).all()):
            raise ModelError(
                f"{path} has joints that are not independent of each other, such as four slides of "
                "one body: no accelerations follow from efforts."
            )
        if not np.abs(ours - theirs).max() <= _AGREEMENT * max(largest, 1e-3):
            raise ModelError(
                f"{path} holds something that acts on its joints and is not read: accelerations "
                f"differ from MuJoCo's by {np.abs(ours - theirs).max():.1e}, where the largest is "
                f"{largest:.1e}."
            )


def _springs_of(robot: ET.Element, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness and slack coordinate of the spring of each joint, shape (joints,) each."""
    stiffness, slack = np.zeros(len(names)), np.zeros(len(names))
    for block in robot.iterfind("gazebo"):
        joint = names.index(block.get("reference", ""))
        stiffness[joint] = float(block.findtext("springStiffness", "0"))
        slack[joint] = float(block.findtext("springReference", "0"))
    return stiffness, slack
