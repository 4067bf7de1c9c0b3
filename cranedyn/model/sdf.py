"""A crane in SDF, the format of Gazebo and gz sim, as a URDF of its joints and masses.

SDF places links, joints and free frames by poses that may be written relative to each other, while
a URDF places each joint in its parent link and each link at its joint. The poses of both formats
hold with all joints at zero, so the reader resolves every SDF pose to the world first and then
expresses it in the links of the URDF.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError, OutOfRange, quoted
from cranedyn.model.crane import NO_RATE_LIMIT, STANDARD_GRAVITY
from cranedyn.model.urdf import are_numbers, inertial_element, numbers_text, set_placement

OLDEST_VERSION = 4
"""Oldest version 1.x of SDF that is read; older ones name links by attributes."""

NEWEST_VERSION = 12
"""Newest version 1.x of SDF that is read."""

FRAME_SEMANTICS_VERSION = 7
"""Version 1.x from which poses name their frame by relative_to only, axes theirs by expressed_in,
and no two elements of a model have one name."""

JOINT_FRAME_AXES_VERSION = 5
"""Version 1.x from which an axis is written in the joint frame unless it says otherwise; before, it
is written in the model frame."""

QUATERNION_TOLERANCE = 1e-3
"""Largest deviation of the length of a quaternion from 1: rounded digits."""

DEFAULT_GRAVITY = 9.8
"""Gravity of a world that says none [m/s²], by the specification."""

INFINITE_LIMIT = 1e16
"""Limit from which on a joint has no end [rad or m], by the specification."""

SLIDE_REACH = 1e3
"""Range to the side of a sliding joint at which it has no end [m]."""

TURN_REACH = 31.4159
"""Range to the side of a turning joint at which it has no end [rad], as that of a continuous joint.
"""

LIGHT_MASS = 1e-6
"""Mass of the body between the two axes of a joint [kg]: other programs drop a link without one."""

LIGHT_INERTIA = 1e-9
"""Moment of inertia of the body between the two axes of a joint [kg m²]."""

MAX_FRAMES = 2000
"""Largest number of links, joints, models and frames in a file."""

_WORLD_CHILDREN = (
    "gravity magnetic_field atmosphere gui physics scene light frame model joint actor plugin road "
    "spherical_coordinates state population audio wind include"
)

_LINK_CHILDREN = (
    "gravity enable_wind self_collide kinematic must_be_base_link velocity_decay pose inertial "
    "collision visual sensor projector audio_sink audio_source battery light particle_emitter "
    "frame contact"
)
"""The last is an extension of Bullet."""

_JOINT_CHILDREN = (
    "parent child gearbox_ratio gearbox_reference_body thread_pitch screw_thread_pitch axis axis2 "
    "physics pose sensor frame"
)

_AXIS_CHILDREN = "xyz use_parent_model_frame dynamics limit initial_position mimic"

_CHILDREN = {
    tag: frozenset(children.split())
    for tag, children in {
        "sdf": "world model light actor",
        "world": _WORLD_CHILDREN,
        "model": "static self_collide allow_auto_disable enable_wind frame pose link joint plugin "
        "gripper include model ros2_control",
        "link": _LINK_CHILDREN,
        "inertial": "mass pose inertia density auto_inertia_params fluid_added_mass frame",
        "inertia": "ixx ixy ixz iyy iyz izz",
        "velocity_decay": "linear angular",
        "joint": _JOINT_CHILDREN,
        "axis": _AXIS_CHILDREN,
        "axis2": _AXIS_CHILDREN,
        "dynamics": "damping friction spring_reference spring_stiffness",
        "limit": "lower upper effort velocity stiffness dissipation",
        "mimic": "multiplier offset reference",
        "frame": "pose",
    }.items()
}
"""Children of the elements that decide about the dynamics, by the specification. Any other child is
refused, since a misspelt element would be lost."""

_LIMIT = re.compile(
    r"[+-]?((\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|inf|infinity)", re.ASCII | re.IGNORECASE
)
"""Text of a limit, which may be infinite."""

_REPEATED = frozenset(
    "frame link joint plugin gripper include model collision visual sensor light projector "
    "audio_source audio_sink battery particle_emitter actor road state population physics".split()
)
"""Elements of which there may be several in one parent."""

_LEFT_OUT = frozenset({"gripper", "actor", "road", "wind", "state", "battery", "contact"})
"""Elements that may act on a crane, or place it, and are left out with a note."""

_SCENERY = re.compile(r"model://(sun|ground_plane)/?|https?://\S*/models/(Sun|Ground Plane)")
"""Addresses of included models that neither move nor touch a crane."""

_DRIVING_PLUGIN = re.compile(
    r"joint_?(position|trajectory|velocity)?_?controller|apply_?joint_?force", re.IGNORECASE
)
"""Names of plugins that command the joints that they name."""

_PASSIVE_PLUGIN = re.compile(
    r"state_?publisher|pose_?publisher|odometry_?publisher|physics|user_?commands|"
    r"scene_?broadcaster|sensors?|imu|force_?torque|contact|altimeter|magnetometer|navsat|log",
    re.IGNORECASE,
)
"""Names of plugins that measure, draw or compute, and do not act on a crane."""

_ROS_CONTROL_PLUGIN = re.compile(r"ros2?_control", re.IGNORECASE)
"""Names of plugins whose joints stand in a URDF elsewhere."""

_AXES_OF_TYPES = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "fixed": 0,
    "universal": 2,
    "revolute2": 2,
    "ball": 0,
}
"""Number of axes that a joint of each type says."""


@dataclass(frozen=True)
class ForeignModel:
    """A crane of another format.

    Attributes:
        robot: The crane as a URDF.
        gravity: Gravity along -Z that the file says [m/s²]; None if it says none.
        notes: What was assumed, changed or left out, a sentence each.
    """

    robot: ET.Element
    gravity: float | None
    notes: list[str]


@dataclass(eq=False)
class _Frame:
    """A frame of an SDF file.

    Attributes:
        name: Name with those of its models before it, for example ``boom::hook``.
        kind: world, model, link, joint or frame.
        element: Its element.
        scope: Model or world in which it is declared; None of the world.
        static: Whether it is in a model that does not move.
        members: Frames that a model or a world declares, by their names in it.
    """

    name: str
    kind: str
    element: ET.Element
    scope: _Frame | None = None
    static: bool = False
    members: dict[str, _Frame] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.kind} {quoted(self.name or self.element.get('name', ''))}"


@dataclass(frozen=True)
class _Axis:
    """One axis of a joint.

    Attributes:
        name: Name of its joint in the URDF.
        kind: Type of that joint.
        direction: Unit vector in the frame of the SDF joint.
        element: Its element in the SDF; None for those of a ball joint.
    """

    name: str
    kind: str
    direction: np.ndarray
    element: ET.Element | None


def read_sdf(root: ET.Element, path: Path) -> ForeignModel:
    """Return the URDF of an SDF file, and what was assumed.

    Read are links, joints, free frames and nested models of versions 1.4 to 1.12, with the defaults
    of the specification. A universal joint and two revolute joints in series become two revolute
    joints; so does a ball joint, which loses the rotation about the vertical, because a rope does
    not turn its load. Joints that a plugin commands are driven. No other file is read.

    Args:
        root: Root of the SDF.
        path: File for error messages.

    Raises:
        ModelError: If the file includes others, holds what no crane has, or is no valid SDF.
        OutOfRange: If a number is none, or has no effect here.
    """
    return _Reader(root, path).read()


class _Reader:
    """Reader of one file.

    Attributes:
        path: The file, for error messages.
        version: x of the version 1.x.
        notes: What was assumed so far.
        world: Frame of the world.
        frames: All frames in their order.
    """

    def __init__(self, root: ET.Element, path: Path) -> None:
        self.path = path
        self.root = root
        self.version = _version(root, path)
        self.notes: list[str] = []
        self.frames: list[_Frame] = []
        self.world = _Frame("world", "world", ET.Element("world"))
        self._poses: dict[_Frame, pin.SE3] = {self.world: pin.SE3.Identity()}

    def read(self) -> ForeignModel:
        """Return the crane of the file."""
        self._check_children(self.root)
        tops = [child for child in self.root if child.tag in ("world", "model")]
        if len(tops) != 1:
            raise ModelError(
                f"{self.path} has {len(tops)} worlds and models in <sdf>; allowed is one."
            )
        gravity = None
        if tops[0].tag == "world":
            self.world.element = tops[0]
            gravity = self._gravity(tops[0])
            self._declare_members(self.world, "")
        else:
            self._declare(tops[0], self.world, "")
        for frame in self.frames:
            self.pose(frame)
        robot = self._robot()
        return ForeignModel(robot, gravity, self.notes)

    # --- what a file may hold ---------------------------------------------------------------------

    def _check_children(self, element: ET.Element) -> None:
        """Refuse children that the specification does not have, or has once only, at any depth."""
        known = _CHILDREN.get(element.tag)
        if known is None:
            return
        name = element.get("name")
        context = f"<{element.tag}>" if name is None else f"{element.tag} {quoted(name)}"
        seen = set()
        for child in element:
            if child.tag.startswith("{") or ":" in child.tag:
                tag = child.tag.rpartition("}")[2]
                self._note(f"<{tag}> of {context}, an extension of SDF, is left out.")
                continue
            if child.tag not in known:
                raise ModelError(
                    f"{self.path} has <{child.tag}> in {context}, which SDF does not have there; "
                    f"allowed are {', '.join(sorted(known))}."
                )
            if child.tag in seen and child.tag not in _REPEATED:
                raise ModelError(
                    f"{self.path} has two elements <{child.tag}> in {context}; allowed is one."
                )
            seen.add(child.tag)
            if child.tag in _LEFT_OUT:
                self._note(f"<{child.tag}> of {context} is left out.")
            if child.tag == "population":
                raise ModelError(
                    f"{self.path} has a population of models; allowed are models one by one."
                )
            if child.tag == "include":
                self._check_include(child)
            elif child.tag == "plugin":
                self._note_plugin(child)
            else:
                self._check_children(child)

    def _check_include(self, include: ET.Element) -> None:
        """Leave out scenery, and refuse any other model of another file."""
        uri = _text(include, "uri")
        if _SCENERY.fullmatch(uri) or _is_true(_text(include, "static", "false")):
            self._note(f"The included model {quoted(uri)} does not move and is left out.")
            return
        raise ModelError(
            f"{self.path} includes {quoted(uri)}, and no other file is read; merge the files into "
            f"one by: gz sdf -p {quoted(self.path)}."
        )

    def _note_plugin(self, plugin: ET.Element) -> None:
        """Say what becomes of a plugin that may act on the crane."""
        name = _plugin_name(plugin)
        if _ROS_CONTROL_PLUGIN.search(name):
            self._note(
                f"The plugin {quoted(name)} takes its joints from a URDF elsewhere; name them by "
                "driven, or --driven."
            )
        elif not (_DRIVING_PLUGIN.search(name) or _PASSIVE_PLUGIN.search(name)):
            self._note(f"What the plugin {quoted(name)} does is left out.")

    def _note(self, sentence: str) -> None:
        """Add a note once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    # --- numbers ----------------------------------------------------------------------------------

    def _numbers(
        self, parent: ET.Element | None, tag: str, default: str, context: str
    ) -> np.ndarray:
        """Return the numbers of a child of an element, as many as its default has."""
        text = default if parent is None else _text(parent, tag, default)
        texts = text.split()
        count = len(default.split())
        if len(texts) != count or not are_numbers(texts):
            kind = "a decimal number" if count == 1 else f"{count} decimal numbers"
            raise OutOfRange(f"{tag} of {context} in {self.path}", repr(text), f"{kind} up to 1e30")
        return np.array([float(number) for number in texts])

    def _number(self, parent: ET.Element | None, tag: str, default: str, context: str) -> float:
        """Return the number of a child of an element."""
        return float(self._numbers(parent, tag, default, context)[0])

    def _limit(self, limits: ET.Element | None, tag: str, default: float, context: str) -> float:
        """Return an end of a range; infinite if the joint has no end there."""
        text = "" if limits is None else _text(limits, tag)
        if not text:
            return default
        if not _LIMIT.fullmatch(text):
            raise OutOfRange(
                f"{tag} of {context} in {self.path}", quoted(text), "a decimal number or inf"
            )
        value = float(text)  # converters from URDF write ±1.79769e+308 for none
        return math.copysign(math.inf, value) if abs(value) >= INFINITE_LIMIT else value

    def _gravity(self, world: ET.Element) -> float:
        """Return the gravity of a world [m/s²]."""
        element = world
        if self.version < 6 and world.find("gravity") is None:
            physics = world.find("physics")  # where it stood before version 1.6
            element = world if physics is None else physics
        x, y, z = self._numbers(element, "gravity", f"0 0 {-DEFAULT_GRAVITY}", "world").tolist()
        if x or y or not z < 0.0:
            raise OutOfRange(
                f"gravity of the world in {self.path}",
                f"{x:g} {y:g} {z:g}",
                "0 0 and a negative number: a crane stands upright",
                "m/s²",
            )
        if -z != STANDARD_GRAVITY:
            gravity = f"{-z:.9g}"
            self._note(
                f"The world of the file has a gravity of {gravity} m/s²; --gravity {gravity} takes "
                "it."
            )
        return float(-z)

    def _raw_pose(self, element: ET.Element, context: str) -> pin.SE3:
        """Return the numbers of the <pose> of an element as a placement."""
        pose = element.find("pose")
        if pose is None or not (pose.text or "").strip():
            return pin.SE3.Identity()
        rotation = pose.get("rotation_format", "euler_rpy")
        degrees = _is_true(pose.get("degrees", "false"))
        if rotation == "quat_xyzw":
            numbers = self._numbers(element, "pose", "0 0 0 0 0 0 1", context)
            quaternion = numbers[3:]
            length = float(np.linalg.norm(quaternion))
            if abs(length - 1.0) > QUATERNION_TOLERANCE:
                raise OutOfRange(
                    f"length of the quaternion of {context} in {self.path}", f"{length:.6g}", "1"
                )
            turn = pin.Quaternion(quaternion / length).matrix()
        elif rotation == "euler_rpy":
            numbers = self._numbers(element, "pose", "0 0 0 0 0 0", context)
            angles = np.radians(numbers[3:]) if degrees else numbers[3:]
            turn = pin.rpy.rpyToMatrix(angles)
        else:
            raise ModelError(
                f"The pose of {context} in {self.path} has the rotation_format {quoted(rotation)}; "
                "allowed are euler_rpy and quat_xyzw."
            )
        return pin.SE3(turn, numbers[:3])

    # --- frames -----------------------------------------------------------------------------------

    def _declare(self, element: ET.Element, scope: _Frame, prefix: str) -> None:
        """Enter the frame of an element and, for a model, those in it."""
        name = element.get("name", "")
        if not name:
            raise ModelError(f"{self.path} has a {element.tag} without a name.")
        if name in ("world", "__root__") or (name.startswith("__") and name.endswith("__")):
            raise ModelError(
                f"{self.path} has a {element.tag} with the name {quoted(name)}, which SDF keeps "
                "for itself; rename it."
            )
        frame = _Frame(prefix + name, element.tag, element, scope, scope.static)
        if element.tag == "model" and _is_true(_text(element, "static", "false")):
            frame.static = True
        key = name
        if name in scope.members:
            other = scope.members[name]
            # Before frame semantics a joint may have the name of a link; no pose names a joint.
            names_joint = "joint" in (frame.kind, other.kind) and frame.kind != other.kind
            if self.version >= FRAME_SEMANTICS_VERSION or not names_joint:
                raise ModelError(
                    f"{self.path} has two elements with the name {quoted(frame.name)}, a "
                    f"{other.kind} and a {frame.kind}; allowed is one."
                )
            joint = frame if frame.kind == "joint" else other
            joint.name += "_joint"  # as libsdformat renames it
            scope.members[f"joint {name}"] = joint
            if joint is frame:
                key = f"joint {name}"
        scope.members[key] = frame
        self.frames.append(frame)
        if len(self.frames) > MAX_FRAMES:
            raise ModelError(
                f"{self.path} has more than {MAX_FRAMES} links, joints and frames; allowed are "
                f"{MAX_FRAMES}."
            )
        if element.tag == "model":
            hidden = scope is self.world and not frame.static and self._is_single(frame)
            self._declare_members(frame, "" if hidden else f"{frame.name}::")

    def _is_single(self, model: _Frame) -> bool:
        """Return whether a model is the only one of the world that moves: its links keep their
        names.
        """
        moving = [
            child
            for child in self.world.element.iterfind("model")
            if not _is_true(_text(child, "static", "false"))
        ]
        return not moving or moving == [model.element]

    def _declare_members(self, scope: _Frame, prefix: str) -> None:
        for child in scope.element:
            if child.tag in ("link", "joint", "frame", "model"):
                self._declare(child, scope, prefix)

    def _find(self, scope: _Frame, name: str, user: str) -> _Frame:
        """Return the frame of a name in a model or the world.

        Args:
            scope: Model or world in which the name is used.
            name: The name; frames of nested models are named as ``model::frame``.
            user: What uses the name, for the error message.
        """
        if name == "__model__" and scope.kind == "model":
            return scope
        if name == "world" and scope is self.world:
            return scope
        if name in scope.members:  # older files write model::link as one name
            return scope.members[name]
        frame = scope
        for part in name.split("::"):
            if part not in frame.members:
                listed = ", ".join(quoted(member) for member in frame.members) or "none"
                raise ModelError(
                    f"{self.path} has {user}, which names {quoted(name)}; the names in {frame} "
                    f"are {listed}."
                )
            frame = frame.members[part]
        return frame

    def _scope(self, frame: _Frame) -> _Frame:
        return self.world if frame.scope is None else frame.scope

    def _named_base(self, element: ET.Element, scope: _Frame, user: str) -> _Frame | None:
        """Return the frame that the <pose> of an element names; None if it names none."""
        pose = element.find("pose")
        if pose is None:
            return None
        name = pose.get("relative_to", "")  # libsdformat takes it in any version
        older_name = pose.get("frame", "")
        if older_name and (name or self.version >= FRAME_SEMANTICS_VERSION):
            raise ModelError(
                f"The pose of {user} in {self.path} has the attribute frame; SDF of version "
                f"1.{self.version} names the frame by relative_to."
            )
        name = name or older_name
        return self._find(scope, name, f"a pose of {user}") if name else None

    def _base(self, frame: _Frame) -> _Frame:
        """Return the frame in which the pose of a frame is written."""
        scope = self._scope(frame)
        named = self._named_base(frame.element, scope, str(frame))
        if named is not None:
            return named
        if frame.kind == "joint":
            return self._end(frame, "child")
        attached = frame.element.get("attached_to") if frame.kind == "frame" else None
        return self._find(scope, attached, str(frame)) if attached else scope

    def _end(self, joint: _Frame, tag: str) -> _Frame:
        """Return the frame that a joint names as its parent or child."""
        name = _text(joint.element, tag)
        if not name:
            raise ModelError(f"The {joint} in {self.path} needs a {tag}.")
        if name == "world":
            if tag == "child":
                raise ModelError(
                    f"The {joint} in {self.path} has the child world; allowed is a link."
                )
            return self.world
        return self._find(self._scope(joint), name, f"the {tag} of {joint}")

    def pose(self, frame: _Frame) -> pin.SE3:
        """Return the pose of a frame in the world with all joints at zero."""
        chain: dict[_Frame, None] = {}
        while frame not in self._poses:
            if frame in chain:
                raise ModelError(
                    f"{self.path} has poses that are relative to each other in a circle through "
                    f"the {frame}."
                )
            chain[frame] = None
            frame = self._base(frame)
        pose = self._poses[frame]
        for inner in reversed(chain):
            pose = pose * self._placement(inner)
            self._poses[inner] = pose
        return pose

    def _placement(self, frame: _Frame) -> pin.SE3:
        """Return the pose of a frame in the frame in which it is written."""
        placement = self._raw_pose(frame.element, str(frame))
        name = frame.element.get("placement_frame") if frame.kind == "model" else None
        if not name:
            return placement
        inner = self._find(frame, name, f"the placement_frame of {frame}")
        # The pose says where that frame is, not where the model frame is.
        in_model = pin.SE3.Identity()
        passed: set[_Frame] = set()
        while inner is not frame:
            if inner in passed:
                raise ModelError(
                    f"{self.path} has poses that are relative to each other in a circle through "
                    f"the {inner}."
                )
            passed.add(inner)
            in_model = self._placement(inner) * in_model
            inner = self._base(inner)
        return placement * in_model.inverse()

    def body(self, frame: _Frame) -> _Frame:
        """Return the link, or the world, with which a frame moves."""
        passed: set[_Frame] = set()
        while frame.kind not in ("link", "world"):
            if frame in passed:
                raise ModelError(
                    f"{self.path} has frames that are attached to each other in a circle through "
                    f"the {frame}."
                )
            passed.add(frame)
            if frame.kind == "joint":
                frame = self._end(frame, "child")
            elif frame.kind == "model":
                frame = self._canonical(frame)
            else:
                attached = frame.element.get("attached_to")
                scope = self._scope(frame)
                frame = self._find(scope, attached, str(frame)) if attached else scope
        return self.world if frame.static else frame

    def _canonical(self, model: _Frame) -> _Frame:
        """Return the frame to which a model is attached: that which it names, its first link, or
        its first model.
        """
        if name := model.element.get("canonical_link"):
            return self._find(model, name, f"the canonical_link of {model}")
        for kind in ("link", "model"):
            for member in model.members.values():
                if member.kind == kind:
                    return member
        raise ModelError(f"The {model} in {self.path} has no link.")

    # --- the URDF ---------------------------------------------------------------------------------

    def _robot(self) -> ET.Element:
        """Return the URDF."""
        models = [frame for frame in self.world.members.values() if frame.kind == "model"]
        moving = [model for model in models if not model.static]
        if not moving:
            raise ModelError(
                f"{self.path} has no model that moves: static models have no joints for a crane."
            )
        for model in models:
            if model.static:
                self._note(f"The {model} is static and stands still; its looks are left out.")
        self._check_connected(moving)
        links = [frame for frame in self.frames if frame.kind == "link" and not frame.static]
        joints = [frame for frame in self.frames if frame.kind == "joint" and not frame.static]
        inbound = self._inbound(joints)
        self._check_anchors(links, inbound)
        robot = ET.Element("robot", name=moving[0].element.get("name", "crane"))
        ET.SubElement(robot, "link", name="world")
        origins = {self.world: pin.SE3.Identity()}
        for link in links:
            joint = inbound.get(link)
            origins[link] = self.pose(link if joint is None else joint)
        driven = self._driven()
        springs: list[ET.Element] = []
        drives: list[str] = []
        for link in links:
            joint = inbound.get(link)
            if joint is None:
                _fixed(robot, f"{link.name}_to_the_ground", "world", link.name, origins[link])
            else:
                axes = self._axes(joint)
                parent = self.body(self._end(joint, "parent"))
                self._add_joint(robot, joint, axes, link, parent, origins[parent], springs)
                for index in driven.get(joint, ()):
                    if index >= len(axes):
                        raise ModelError(
                            f"{self.path} has a plugin that commands axis {index} of {joint}, "
                            f"which has {len(axes)}."
                        )
                    drives.append(axes[index].name)
            self._add_link(robot, link, origins[link], moves=joint is not None)
        robot.extend(springs)
        if drives:
            control = ET.SubElement(robot, "ros2_control", name="drives", type="system")
            for name in drives:
                drive = ET.SubElement(control, "joint", name=name)
                ET.SubElement(drive, "command_interface", name="effort")
        return robot

    def _check_connected(self, models: list[_Frame]) -> None:
        """Check that joints of the world connect all models that move."""
        groups = {model: {model} for model in models}
        for joint in self.world.members.values():
            if joint.kind != "joint":
                continue
            tops = [self._top(self._end(joint, tag)) for tag in ("parent", "child")]
            if all(top in groups for top in tops):
                merged = groups[tops[0]] | groups[tops[1]]
                for model in merged:
                    groups[model] = merged
        apart = [model for model in models if model not in groups[models[0]]]
        if apart:
            raise ModelError(
                f"{self.path} has models that move without a joint between them: "
                f"{', '.join(quoted(model.name) for model in [models[0], *apart][:5])}; write each "
                "to a file of its own."
            )

    def _top(self, frame: _Frame) -> _Frame:
        """Return the model of the world in which a frame is, or the frame itself in the world."""
        while frame.scope not in (None, self.world):
            frame = self._scope(frame)
        return frame

    def _inbound(self, joints: list[_Frame]) -> dict[_Frame, _Frame]:
        """Return the joint of each link that carries it."""
        inbound: dict[_Frame, _Frame] = {}
        for joint in joints:
            child = self.body(self._end(joint, "child"))
            if child is self.world:
                continue  # it moves a static model, which it cannot
            if child is self.body(self._end(joint, "parent")):
                raise ModelError(f"The {joint} in {self.path} connects {child} with itself.")
            if child in inbound:
                raise ModelError(
                    f"{self.path} has two joints with the child {quoted(child.name)}, "
                    f"{quoted(inbound[child].name)} and {quoted(joint.name)}; allowed is one: a "
                    "crane is a tree."
                )
            inbound[child] = joint
        return inbound

    def _check_anchors(self, links: list[_Frame], inbound: dict[_Frame, _Frame]) -> None:
        """Check that all bodies hang on the world, or on the only link that is on no joint."""
        roots = [link for link in links if link not in inbound]
        anchored = False
        for joint in inbound.values():
            anchored |= self.body(self._end(joint, "parent")) is self.world
        if len(roots) + anchored > 1:
            free = ", ".join(quoted(root.name) for root in roots[:5])
            raise ModelError(
                f"{self.path} has bodies that no joint connects with the crane: {free}; connect "
                "them by joints, of the type fixed where they stand still, or leave them out."
            )
        for root in roots:
            self._note(
                f"No joint connects {quoted(root.name)} with the world; it is read as fixed there."
            )

    def _axes(self, joint: _Frame) -> list[_Axis]:
        """Return the axes of a joint, none for a fixed one."""
        kind = joint.element.get("type", "")
        if kind not in _AXES_OF_TYPES:
            raise ModelError(
                f"The {joint} in {self.path} is of type {quoted(kind)}; allowed are "
                f"{', '.join(_AXES_OF_TYPES)}."
            )
        if kind == "ball":
            return self._ball_axes(joint)
        axes = []
        tags = ("axis", "axis2")[: _AXES_OF_TYPES[kind]]
        for tag in tags:
            element = joint.element.find(tag)
            if element is None:
                raise ModelError(f"The {joint} in {self.path} is {kind} and needs <{tag}>.")
            name = joint.name if len(tags) == 1 else f"{joint.name}_{tag}"
            turning = "continuous" if kind == "continuous" else "revolute"
            axes.append(
                _Axis(
                    name,
                    "prismatic" if kind == "prismatic" else turning,
                    self._direction(joint, element, tag),
                    element,
                )
            )
        for tag in ("axis", "axis2"):
            if tag not in tags and joint.element.find(tag) is not None:
                self._note(f"<{tag}> of {joint}, which is {kind}, has no effect.")
        return axes

    def _ball_axes(self, joint: _Frame) -> list[_Axis]:
        """Return the two horizontal axes that a ball joint is read as."""
        self._note(f"The ball {joint} turns about X, then Y of the world, not about the vertical.")
        if joint.element.find("axis") is not None:
            self._note(f"<axis> of {joint}, which is a ball, has no effect.")
        to_joint = self.pose(joint).rotation.T
        return [
            _Axis(f"{joint.name}_x", "continuous", to_joint[:, 0], None),
            _Axis(f"{joint.name}_y", "continuous", to_joint[:, 1], None),
        ]

    def _direction(self, joint: _Frame, axis: ET.Element, tag: str) -> np.ndarray:
        """Return the unit vector of an axis in the frame of its joint."""
        context = f"{tag} of {joint}"
        vector = self._numbers(axis, "xyz", "0 0 1", context)
        length = float(np.linalg.norm(vector))
        if not length > 0.0:
            raise OutOfRange(f"xyz of {context} in {self.path}", "0 0 0", "a length > 0")
        vector = vector / length
        xyz = axis.find("xyz")
        expressed_in = "" if xyz is None else xyz.get("expressed_in", "")
        in_model = _is_true(_text(axis, "use_parent_model_frame", "false"))
        if in_model and (expressed_in or self.version >= FRAME_SEMANTICS_VERSION):
            raise ModelError(
                f"The {context} in {self.path} has use_parent_model_frame, which SDF has up to "
                f"version 1.6; say <xyz expressed_in='__model__'> in version 1.{self.version}."
            )
        scope = self._scope(joint)
        if expressed_in:
            frame = self._find(scope, expressed_in, context)
        elif in_model or self.version < JOINT_FRAME_AXES_VERSION:
            frame = scope
        else:
            return vector
        return self.pose(joint).rotation.T @ (self.pose(frame).rotation @ vector)

    def _add_joint(
        self,
        robot: ET.Element,
        joint: _Frame,
        axes: list[_Axis],
        link: _Frame,
        parent: _Frame,
        parent_pose: pin.SE3,
        springs: list[ET.Element],
    ) -> None:
        """Append the joints of the URDF that stand for one of the SDF.

        Args:
            robot: The URDF.
            joint: The joint of the SDF.
            axes: Its axes.
            link: The link that it carries.
            parent: The link that carries it.
            parent_pose: Pose of that link of the URDF in the world.
            springs: Elements for its springs, which are appended to these.
        """
        placement = parent_pose.actInv(self.pose(joint))
        self._check_joint_physics(joint)
        if not axes:
            _fixed(robot, joint.name, parent.name, link.name, placement)
            return
        above = parent.name
        for i, axis in enumerate(axes):
            last = i == len(axes) - 1
            below = link.name if last else f"{axis.name}_body"
            element = ET.SubElement(robot, "joint", name=axis.name, type=axis.kind)
            ET.SubElement(element, "parent", link=above)
            ET.SubElement(element, "child", link=below)
            set_placement(element, placement)
            ET.SubElement(element, "axis", xyz=numbers_text(axis.direction))
            self._add_limits(element, axis)
            self._add_dynamics(element, axis, springs)
            if not last:
                self._note(f"A body of {LIGHT_MASS:g} kg is between the axes of {joint}.")
                between = ET.SubElement(robot, "link", name=below)
                inertia = LIGHT_INERTIA * np.eye(3)
                between.append(inertial_element(pin.Inertia(LIGHT_MASS, np.zeros(3), inertia)))
            above = below
            placement = pin.SE3.Identity()

    def _check_joint_physics(self, joint: _Frame) -> None:
        """Refuse settings of engines that move a joint or cut it."""
        force = joint.element.find("physics/ode/max_force")
        if force is not None:
            largest = self._number(joint.element.find("physics/ode"), "max_force", "0", str(joint))
            if largest != 0.0:
                self._note(f"The motor of ODE (max_force) at {joint} is left out.")
        cut = joint.element.find("physics/simbody/must_be_loop_joint")
        if cut is not None and _is_true((cut.text or "").strip()):
            raise ModelError(f"The {joint} in {self.path} closes a loop; a crane is a tree.")

    def _add_limits(self, element: ET.Element, axis: _Axis) -> None:
        """Append the limits of one axis, and make a joint whose ends coincide a fixed one."""
        context = f"joint {quoted(axis.name)}"
        limits = None if axis.element is None else axis.element.find("limit")
        low, high = -math.inf, math.inf
        if axis.kind != "continuous":
            low = self._limit(limits, "lower", -math.inf, context)
            high = self._limit(limits, "upper", math.inf, context)
        effort = self._limit(limits, "effort", -1.0, context)
        velocity = self._limit(limits, "velocity", -1.0, context)
        if low == high == 0.0:
            self._note(f"The {context} has no range and is read as fixed.")
            element.set("type", "fixed")
            for tag in ("axis", "limit"):
                for child in element.findall(tag):
                    element.remove(child)
            return
        if axis.kind == "revolute" and math.isinf(low) and math.isinf(high):
            element.set("type", "continuous")
        if axis.kind == "prismatic" or math.isfinite(low) or math.isfinite(high):
            low, high = self._closed_range(axis, low, high)
        if effort < 0.0 or math.isinf(effort):
            effort = 0.0  # completed where a drive moves the joint
        if velocity < 0.0 or math.isinf(velocity):
            velocity = NO_RATE_LIMIT
        numbers = {"effort": effort, "velocity": velocity}
        if math.isfinite(low) and math.isfinite(high):
            numbers |= {"lower": low, "upper": high}
        ET.SubElement(element, "limit", {name: repr(value) for name, value in numbers.items()})

    def _closed_range(self, axis: _Axis, low: float, high: float) -> tuple[float, float]:
        """Return the range of a joint, closed where the file leaves it open."""
        reach, unit = (SLIDE_REACH, "m") if axis.kind == "prismatic" else (TURN_REACH, "rad")
        if math.isfinite(low) and math.isfinite(high):
            return low, high
        lower = low if math.isfinite(low) else min(-reach, high - reach)
        upper = high if math.isfinite(high) else max(reach, low + reach)
        self._note(
            f"{axis.name} has no limit at one end or both; {lower:g} to {upper:g} {unit} is taken."
        )
        return lower, upper

    def _add_dynamics(self, element: ET.Element, axis: _Axis, springs: list[ET.Element]) -> None:
        """Append damping and friction of one axis, and its spring to the springs."""
        if axis.element is None or element.get("type") == "fixed":
            return
        context = f"joint {quoted(axis.name)}"
        dynamics = axis.element.find("dynamics")
        numbers = {
            tag: self._number(dynamics, tag, "0", context) for tag in ("damping", "friction")
        }
        ET.SubElement(element, "dynamics", {tag: repr(value) for tag, value in numbers.items()})
        stiffness = self._number(dynamics, "spring_stiffness", "0", context)
        if stiffness != 0.0:
            spring = ET.Element("gazebo", reference=axis.name)
            ET.SubElement(spring, "springStiffness").text = repr(stiffness)
            reference = self._number(dynamics, "spring_reference", "0", context)
            ET.SubElement(spring, "springReference").text = repr(reference)
            springs.append(spring)
        if self._number(axis.element, "initial_position", "0", context) != 0.0:
            self._note(f"The initial_position of {context} is left out; Gazebo ignores it, too.")
        if (mimic := axis.element.find("mimic")) is not None:
            multiplier = self._number(mimic, "multiplier", "1", context)
            offset = self._number(mimic, "offset", "0", context)
            offset -= multiplier * self._number(mimic, "reference", "0", context)
            entries = {"multiplier": repr(multiplier), "offset": repr(offset)}
            ET.SubElement(element, "mimic", entries | {"joint": mimic.get("joint", "")})

    def _add_link(self, robot: ET.Element, link: _Frame, origin: pin.SE3, *, moves: bool) -> None:
        """Append a link of the URDF whose frame has a pose in the world."""
        self._check_link(link)
        element = ET.SubElement(robot, "link", name=link.name)
        to_origin = origin.actInv(self.pose(link))
        element.append(inertial_element(to_origin.act(self._inertia(link, moves))))
        for tag in ("visual", "collision"):
            for body in link.element.iterfind(tag):
                self._add_shape(element, body, link, origin)

    def _check_link(self, link: _Frame) -> None:
        """Refuse what makes a link move otherwise than a rigid body in gravity."""
        if not _is_true(_text(link.element, "gravity", "true")):
            raise ModelError(
                f"The {link} in {self.path} has no gravity; allowed is gravity on all links."
            )
        if _is_true(_text(link.element, "kinematic", "false")):
            raise ModelError(
                f"The {link} in {self.path} is kinematic, moved without forces; leave that out."
            )
        decay = link.element.find("velocity_decay")
        for tag in ("linear", "angular"):
            value = self._number(decay, tag, "0", f"velocity_decay of {link}")
            if value != 0.0:
                raise OutOfRange(
                    f"{tag} velocity_decay of {link} in {self.path}",
                    value,
                    "0: say it as damping of joints",
                )

    def _inertia(self, link: _Frame, moves: bool) -> pin.Inertia:
        """Return the inertia of a link in its SDF frame; defaults are noted if it moves."""
        context = str(link)
        inertial = link.element.find("inertial")
        if inertial is not None and _is_true(inertial.get("auto", "false")):
            raise ModelError(
                f"The {link} in {self.path} has its mass computed from its collision shapes "
                "(auto); say mass and inertia: gz sdf -p --expand-auto-inertials prints them."
            )
        tensor = None if inertial is None else inertial.find("inertia")
        if moves and (inertial is None or inertial.find("mass") is None):
            self._note(f"The {link} has no mass; 1 kg is taken, the default of SDF.")
        if moves and tensor is None:
            self._note(f"The {link} has no inertia; 1 kg m² about each axis, the default of SDF.")
        added = None if inertial is None else inertial.find("fluid_added_mass")
        for term in () if added is None else added:
            if self._number(added, term.tag, "0", context) != 0.0:
                raise ModelError(f"The {link} in {self.path} has fluid_added_mass; allowed is 0.")
        mass = self._number(inertial, "mass", "1", context)
        moments = np.empty((3, 3))
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"):
                key = "i" + "".join(sorted(a + b))
                moments[i, j] = self._number(tensor, key, "1" if a == b else "0", context)
        principal = np.linalg.eigvalsh(moments)
        if not principal[0] >= 0.0:
            raise OutOfRange(
                f"principal moments of inertia of {context} in {self.path}",
                ", ".join(f"{moment:.6g}" for moment in principal),
                ">= 0",
                "kg m²",
            )
        if inertial is None:
            return pin.Inertia(mass, np.zeros(3), moments)
        pose = inertial.find("pose")
        if pose is not None and (pose.get("relative_to") or pose.get("frame")):
            raise ModelError(
                f"The inertial of {link} in {self.path} has a pose relative to another frame; "
                "allowed is one in the frame of its link."
            )
        centre = self._raw_pose(inertial, f"the inertial of {link}")
        return centre.act(pin.Inertia(mass, np.zeros(3), moments))

    def _add_shape(
        self, element: ET.Element, body: ET.Element, link: _Frame, origin: pin.SE3
    ) -> None:
        """Append a visual or a collision whose shape a URDF has, to a link of the URDF."""
        geometry = body.find("geometry")
        shape = None if geometry is None else _urdf_shape(self, geometry, str(link))
        if shape is None:
            self._note(f"A {body.tag} of {link} is of a shape without a size here and left out.")
            return
        user = f"a {body.tag} of {link}"
        named = self._named_base(body, self._scope(link), user)
        base = self.pose(link if named is None else named)
        placement = origin.actInv(base * self._raw_pose(body, user))
        copy = ET.SubElement(element, body.tag)
        set_placement(copy, placement)
        ET.SubElement(copy, "geometry").append(shape)
        diffuse = body.find("material/diffuse")
        colours = [] if diffuse is None else (diffuse.text or "").split()
        if body.tag == "visual" and len(colours) in (3, 4) and are_numbers(colours):
            material = ET.SubElement(copy, "material", name="")
            ET.SubElement(material, "color", rgba=" ".join([*colours, "1"][:4]))

    # --- drives -----------------------------------------------------------------------------------

    def _driven(self) -> dict[_Frame, list[int]]:
        """Return the axes, by their indices, of each joint that a plugin commands."""
        driven: dict[_Frame, list[int]] = {}
        models = [frame for frame in self.frames if frame.kind == "model" and not frame.static]
        for scope in [self.world, *models]:
            for plugin in scope.element.iterfind("plugin"):
                name = _plugin_name(plugin)
                if not _DRIVING_PLUGIN.search(name) or _PASSIVE_PLUGIN.search(name):
                    continue
                for entry in plugin.iterfind("joint_name"):
                    joint = self._commanded(scope, (entry.text or "").strip(), name)
                    index = self._number(plugin, "joint_index", "0", f"plugin {quoted(name)}")
                    driven.setdefault(joint, [])
                    if int(index) not in driven[joint]:
                        driven[joint].append(int(index))
                    self._note(f"{joint.name} is driven: the plugin {quoted(name)} commands it.")
            for entry in scope.element.iterfind("ros2_control/joint"):
                if entry.find("command_interface") is not None:
                    joint = self._commanded(scope, entry.get("name", ""), "ros2_control")
                    driven.setdefault(joint, [0])
        return driven

    def _commanded(self, scope: _Frame, name: str, plugin: str) -> _Frame:
        """Return the joint of a name that a plugin commands."""
        joint = scope.members.get(f"joint {name}")
        if joint is None:
            joint = self._find(scope, name, f"the plugin {quoted(plugin)}")
        if joint.kind != "joint":
            raise ModelError(
                f"{self.path} has the plugin {quoted(plugin)}, which commands the {joint}; allowed "
                "is a joint."
            )
        return joint


def _version(root: ET.Element, path: Path) -> int:
    """Return x of the version 1.x of an SDF file."""
    text = root.get("version", "")
    allowed = f"1.{OLDEST_VERSION} to 1.{NEWEST_VERSION}"
    match = re.fullmatch(r"1\.(\d{1,3})", text.strip(), re.ASCII)
    if match is None or not OLDEST_VERSION <= int(match[1]) <= NEWEST_VERSION:
        raise OutOfRange(
            f"version of the SDF file {path}",
            quoted(text) if text else "left out",
            f"{allowed}; gz sdf -p converts older files",
        )
    return int(match[1])


def _text(parent: ET.Element, tag: str, default: str = "") -> str:
    """Return the text of a child of an element, or the default where it has none."""
    return (parent.findtext(tag) or "").strip() or default


def _is_true(text: str) -> bool:
    """Return whether a text means true in SDF.

    Raises:
        OutOfRange: If it means neither true nor false.
    """
    word = text.strip().lower()
    if word not in ("true", "false", "1", "0"):
        raise OutOfRange("a yes or no in an SDF file", quoted(text), "true, false, 1 or 0")
    return word in ("true", "1")


def _plugin_name(plugin: ET.Element) -> str:
    """Return name and file of a plugin, by which its kind is known."""
    return f"{plugin.get('name', '')} ({plugin.get('filename', '')})"


def _fixed(robot: ET.Element, name: str, parent: str, child: str, placement: pin.SE3) -> None:
    """Append a fixed joint to a URDF."""
    element = ET.SubElement(robot, "joint", name=name, type="fixed")
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    set_placement(element, placement)


def _urdf_shape(reader: _Reader, geometry: ET.Element, context: str) -> ET.Element | None:
    """Return a box, cylinder or sphere as in a URDF; None for any other shape."""
    for shape in geometry:
        keys = {"box": ["size"], "cylinder": ["radius", "length"], "sphere": ["radius"]}
        if shape.tag not in keys:
            continue
        element = ET.Element(shape.tag)
        for key in keys[shape.tag]:
            default = "1 1 1" if key == "size" else "1"
            element.set(key, numbers_text(reader._numbers(shape, key, default, context)))
        return element
    return None
