"""A crane in MuJoCo's format, MJCF, as MuJoCo's own compiler understands it.

MJCF has defaults, frames, replicas, units and rules for inertia that no other reader knows in full.
So the file is compiled by MuJoCo, in a process of its own (`cranedyn.model.mjcf_compiler`), and the
compiled model becomes a URDF: a link for each body, and a chain of joints where a body has several.
Accelerations of that URDF by Pinocchio, with its damping, springs and armature, are then compared
with those that MuJoCo computes at random states: a file in which anything else acts on the bodies
is refused, whatever it is. MuJoCo leaves actuators, limits, contacts and dry friction out of these
accelerations; what is read of them is checked one by one.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from copy import deepcopy
from dataclasses import dataclass
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
    UNKNOWN_EFFORT,
    UNLIMITED_SLIDE,
    complete_limits,
    joint_names,
    read_armature,
)
from cranedyn.model.urdf import inertial_element, numbers_text, parse_urdf, set_placement, skeleton

_PROGRAM = Path(__file__).with_name("mjcf_compiler.py")
"""Program that compiles a file by MuJoCo."""

_MAX_INCLUDED_FILES = 100
"""Number of files that one model may include."""

_FOLDERS = ("meshdir", "texturedir", "assetdir")
"""Attributes of ``<compiler>`` that name folders."""

_MAX_GRAVITY_TILT = 1e-5
"""Largest angle between gravity and the vertical at which it counts as vertical [rad]."""

_ACCELERATION_TOLERANCE = 1e-7
"""Largest difference from MuJoCo's accelerations, as a share of the largest of them: round-off of
two algorithms on masses that differ by up to 10⁷."""

_MIN_ACCELERATION = 1e-3
"""Acceleration that differences are compared with where all are smaller [rad/s² or m/s²]."""


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
    pending = [(root, path)]
    known_files = {path.resolve()}
    while pending:
        element_root, source = pending.pop()
        folders = _asset_folders(element_root)
        for element in element_root.iter():
            _check_named_files(element, home, folders, source)
            if element.tag not in ("include", "model") or not element.get("file"):
                continue
            included = (home / element.get("file", "")).resolve()
            if included in known_files:
                continue
            known_files.add(included)
            if len(known_files) > _MAX_INCLUDED_FILES:
                raise ModelError(f"{path} includes more than {_MAX_INCLUDED_FILES} files.")
            pending.append((parse_urdf(read_text(included), included), included))


def _asset_folders(root: ET.Element) -> list[str]:
    """Return the folders in which the compiler may look for the files that a file names."""
    folders = [""]
    for compiler in root.iter("compiler"):
        for name in _FOLDERS:
            folder = compiler.get(name)
            if folder:
                folders.append(folder)
    return folders


def _check_named_files(element: ET.Element, home: Path, folders: list[str], source: Path) -> None:
    """Check that the files and folders that an element names are in a folder.

    Args:
        element: The element.
        home: The folder.
        folders: Folders in it to which the names may be relative.
        source: File of the element for the error message.

    Raises:
        ModelError: If one is not.
    """
    for name, value in element.attrib.items():
        if not value or not (name.startswith("file") or name in _FOLDERS):
            continue
        for folder in folders:
            if not (home / folder / value).resolve().is_relative_to(home):
                raise ModelError(
                    f"{source} names {quoted(value)}, which is outside of its folder; put all "
                    "files of the model in one folder, or folders in it."
                )


def _compiled(path: Path) -> dict[str, Any]:
    """Return what MuJoCo's compiler makes of a file, see `cranedyn.model.mjcf_compiler`."""
    import tempfile  # its import takes milliseconds, and few cranes are MJCF

    limits = [str(reading_process.MEMORY), str(reading_process.CPU_TIME), str(MAX_MOVING_JOINTS)]
    # In a folder of its own, since MuJoCo writes its log into the current one.
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as output:
        arguments = [str(path.resolve()), *limits]
        code = run_reader(_PROGRAM, arguments, path, output, folder=folder)
        output.seek(0)
        lines = output.read().decode("utf-8", "replace").splitlines()
    reply = json_reply(lines[-1]) if lines else {}
    if reply.get("missing"):
        raise CraneError(
            f"{path} is an MJCF, which MuJoCo reads, and MuJoCo is not installed: pip install "
            "'cranedyn[mujoco]'."
        )
    if "error" in reply:
        reason = printable(" ".join(str(reply["error"]).split()).rstrip("."))
        raise ModelError(f"{path} is not a crane in MJCF: {reason}.")
    if "model" not in reply:
        raise ModelError(f"{path} cannot be loaded: {why_it_ended(code)}.")
    model: dict[str, Any] = reply["model"]
    return model


def _gravity(model: dict[str, Any], path: Path) -> float:
    """Return gravity along -Z [m/s²], 0 where the file switches it off.

    Raises:
        OutOfRange: If it points elsewhere.
    """
    x, y, z = model["gravity"]
    size = math.hypot(x, y, z)
    if math.hypot(x, y) > _MAX_GRAVITY_TILT * size or z > 0.0:
        vector = f"{x:g} {y:g} {z:g}"
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
        low = drive["low"]
        high = drive["high"]
        if not (math.isfinite(low) and math.isfinite(high)):
            notes.append(
                f"{name} has no largest effort in the file; {UNKNOWN_EFFORT:g} {unit} are taken."
            )
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

    A joint of MuJoCo with the coordinate q turns its body by q - ref about an anchor: at q = ref
    the body is where the file places it. A link of the URDF has its origin at the anchor of its
    joint.
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
                self._link(name, index, pin.SE3.Identity())
            else:
                self._add_body(index, body, by_body.get(index, []))
        return self._robot

    def _add_body(self, index: int, body: dict[str, Any], joints: list[dict[str, Any]]) -> None:
        """Add the link of a body, and the joints that carry it, with a link between each two.

        Args:
            index: Index of the body.
            body: Its description.
            joints: Descriptions of its joints; it is fixed to its parent where there is none.
        """
        parent, parent_in_link = self._links[body["parent"]]
        placement = parent_in_link * _pose(body["position"], body["quaternion"])
        name = self._new_name(body["name"])
        in_link = pin.SE3.Identity()
        if not joints:
            fixed = self._joint(self._new_name(f"{name}_fixed"), "fixed", parent, name)
            set_placement(fixed, placement)
        for place, description in enumerate(joints):
            is_last = place == len(joints) - 1
            child = name if is_last else self._new_name(f"{name}_{place + 1}")
            anchor = pin.SE3(np.eye(3), np.array(description["position"], dtype=float))
            self._add_joint(description, parent, child, placement * anchor)
            if not is_last:
                ET.SubElement(self._robot, "link", name=child)
            parent = child
            # MuJoCo writes all anchors in the frame of the body; the link has its origin at the
            # anchor.
            in_link = anchor.inverse()
            placement = in_link
        self._links.append((name, in_link))
        self._link(name, index, in_link)

    def _add_joint(
        self, description: dict[str, Any], parent: str, child: str, anchor: pin.SE3
    ) -> None:
        """Add a joint.

        Args:
            description: Its description.
            parent: Name of its parent link.
            child: Name of its child link.
            anchor: Its placement in its parent in the reference posture.
        """
        name = description["name"]
        slides = description["slides"]
        limits = {
            "effort": repr(_largest_effort(description["drive"])),
            "velocity": repr(NO_RATE_LIMIT),
        }
        kind = "prismatic" if slides else "revolute"
        if description["range"] is not None:
            low, high = description["range"]
            limits |= {"lower": repr(float(low)), "upper": repr(float(high))}
        elif slides:
            limits |= {"lower": repr(-UNLIMITED_SLIDE), "upper": repr(UNLIMITED_SLIDE)}
        else:
            kind = "continuous"
        joint = self._joint(name, kind, parent, child)

        # A URDF has its joints at zero where MuJoCo has them at the reference value.
        axis = np.array(description["axis"], dtype=float)
        back = -float(description["reference"]) * axis
        if slides:
            step = pin.SE3(np.eye(3), back)
        else:
            step = pin.SE3(pin.exp3(back), np.zeros(3))
        set_placement(joint, anchor * step)
        ET.SubElement(joint, "axis", xyz=numbers_text(axis))
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
        """Add a joint of a type between two links and return it."""
        joint = ET.SubElement(self._robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        return joint

    def _link(self, name: str, body_index: int, in_link: pin.SE3) -> None:
        """Add the link of a body.

        Args:
            name: Name of the link.
            body_index: Index of the body.
            in_link: Placement of the frame of the body in the link.
        """
        body = self._model["bodies"][body_index]
        link = ET.SubElement(self._robot, "link", name=name)
        if body["mass"] > 0.0:
            principal = _pose(body["centre"], body["principal_axes"])
            inertia = pin.Inertia(body["mass"], np.zeros(3), np.diag(body["moments"]))
            link.append(inertial_element((in_link * principal).act(inertia)))
        for shape in self._model["shapes"]:
            if shape["body"] == body_index:
                _add_shape(link, shape, in_link)

    def _new_name(self, name: str) -> str:
        """Return a name that no link or joint has yet; URDF's parsers want all to differ."""
        while name in self._names:
            name += "_link"
        self._names.add(name)
        return name


def _largest_effort(drive: dict[str, Any] | None) -> float:
    """Return the largest effort of a drive, either way [N or N m]; 0 for a passive joint."""
    if drive is None:
        return 0.0
    largest = max(abs(drive["low"]), abs(drive["high"]))
    return largest if math.isfinite(largest) else UNKNOWN_EFFORT


def _pose(position: list[float], quaternion: list[float]) -> pin.SE3:
    """Return a placement from a position [m] and a quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(position, dtype=float))


@dataclass(frozen=True)
class _Primitive:
    """Shape that a URDF has.

    Attributes:
        kind: Its tag: box, cylinder or sphere.
        measures: Its attributes.
        offset: Position along Z in the frame of its geom [m].
    """

    kind: str
    measures: dict[str, str]
    offset: float = 0.0


def _primitives(kind: str, size: list[float]) -> list[_Primitive]:
    """Return the shapes that make up a geom.

    Args:
        kind: Its type: box, sphere, cylinder or capsule, which is a cylinder between two spheres.
        size: Its numbers in MuJoCo: half of each edge of a box [m]; else the radius and, but for a
            sphere, half of the length [m].
    """
    if kind == "box":
        return [_Primitive("box", {"size": numbers_text(2.0 * np.array(size))})]
    radius = repr(size[0])
    if kind == "sphere":
        return [_Primitive("sphere", {"radius": radius})]
    half_length = size[1]
    cylinder = _Primitive("cylinder", {"radius": radius, "length": repr(2.0 * half_length)})
    if kind == "cylinder":
        return [cylinder]
    return [
        cylinder,
        _Primitive("sphere", {"radius": radius}, half_length),
        _Primitive("sphere", {"radius": radius}, -half_length),
    ]


def _add_shape(link: ET.Element, shape: dict[str, Any], in_link: pin.SE3) -> None:
    """Add a geom to a link: as a visual if it is shown, and as a collision if it is solid.

    Args:
        link: The link.
        shape: Description of the geom.
        in_link: Placement of the frame of the body of the geom in the link.
    """
    pose = in_link * _pose(shape["position"], shape["quaternion"])
    roles = []
    if shape["visible"]:
        roles.append("visual")
    if shape["solid"]:
        roles.append("collision")
    for role in roles:
        for part in _primitives(shape["kind"], shape["size"]):
            element = ET.SubElement(link, role)
            set_placement(element, pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, part.offset])))
            geometry = ET.SubElement(element, "geometry")
            ET.SubElement(geometry, part.kind, part.measures)
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
        q = np.zeros(rigid.nv)
        v = np.zeros(rigid.nv)
        effort = np.zeros(rigid.nv)
        q[order] = state["q"]
        v[order] = state["v"]
        effort[order] = state["effort"]
        # Pinocchio reads the damping of a URDF, but neither applies it nor knows springs.
        effort = effort - rigid.damping * v - stiffness * (q - slack)
        ours = pin.aba(rigid, data, q, v, effort)[order]
        theirs = np.array(state["acceleration"], dtype=float)
        largest = np.abs(theirs).max()
        if not (np.isfinite(ours).all() and np.isfinite(theirs).all()):
            raise ModelError(
                f"{path} has joints that are not independent of each other, such as four slides of "
                "one body: no accelerations follow from efforts."
            )
        difference = np.abs(ours - theirs).max()
        if not difference <= _ACCELERATION_TOLERANCE * max(largest, _MIN_ACCELERATION):
            raise ModelError(
                f"{path} holds something that acts on its joints and is not read: accelerations "
                f"differ from MuJoCo's by {difference:.1e}, where the largest is {largest:.1e}."
            )


def _springs_of(robot: ET.Element, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness and slack coordinate of the spring of each joint, shape (joints,) each."""
    stiffness = np.zeros(len(names))
    slack = np.zeros(len(names))
    for block in robot.iterfind("gazebo"):
        joint = names.index(block.get("reference", ""))
        stiffness[joint] = float(block.findtext("springStiffness", "0"))
        slack[joint] = float(block.findtext("springReference", "0"))
    return stiffness, slack
