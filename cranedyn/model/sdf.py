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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError, OutOfRange, quoted
from cranedyn.model.crane import NO_RATE_LIMIT
from cranedyn.model.foreign import ForeignModel
from cranedyn.model.joints import UNLIMITED_SLIDE, UNLIMITED_TURN
from cranedyn.model.sdf_frames import (
    FRAME_SEMANTICS_VERSION,
    SdfFrame,
    SdfFrames,
    child_text,
    is_true,
)
from cranedyn.model.urdf import (
    NEGATIVE_MOMENT,
    are_numbers,
    inertial_element,
    numbers_text,
    set_placement,
)

JOINT_FRAME_AXES_VERSION = 5
"""Version 1.x from which an axis is written in the joint frame unless it names another; before, it
is written in the model frame."""

DEFAULT_GRAVITY = 9.8
"""Gravity of a world that states none [m/s²], by the specification."""

INFINITE_LIMIT = 1e16
"""Limit from which on a joint has no end [rad or m], by the specification."""

LIGHT_MASS = 1e-5
"""Mass of the body between the two axes of a joint [kg]: other programs drop a link without one, as
Gazebo does with one of at most 1e-6 kg."""

LIGHT_INERTIA = 1e-9
"""Moment of inertia of the body between the two axes of a joint [kg m²]: small beside that of any
load."""

_MAX_NAMED_BODIES = 5
"""Number of bodies or models that an error message names."""

_WORLD_CHILDREN = (
    "gravity magnetic_field atmosphere gui physics scene light frame model joint actor plugin road "
    "spherical_coordinates state population audio wind include"
)
"""Children of ``<world>``, by the specification."""

_LINK_CHILDREN = (
    "gravity enable_wind self_collide kinematic must_be_base_link velocity_decay pose inertial "
    "collision visual sensor projector audio_sink audio_source battery light particle_emitter "
    "frame contact"
)
"""Children of ``<link>``, by the specification; ``contact`` is an extension of Bullet."""

_JOINT_CHILDREN = (
    "parent child gearbox_ratio gearbox_reference_body thread_pitch screw_thread_pitch axis axis2 "
    "physics pose sensor frame"
)
"""Children of ``<joint>``, by the specification."""

_AXIS_CHILDREN = "xyz use_parent_model_frame dynamics limit initial_position mimic"
"""Children of ``<axis>`` and ``<axis2>``, by the specification."""

_MODEL_CHILDREN = (
    "static self_collide allow_auto_disable enable_wind frame pose link joint plugin gripper "
    "include model ros2_control"
)
"""Children of ``<model>``, by the specification; ``ros2_control`` is an extension of ROS 2, which
takes drives from there."""

_CHILDREN = {
    "sdf": frozenset("world model light actor".split()),
    "world": frozenset(_WORLD_CHILDREN.split()),
    "model": frozenset(_MODEL_CHILDREN.split()),
    "link": frozenset(_LINK_CHILDREN.split()),
    "inertial": frozenset(
        "mass pose inertia density auto_inertia_params fluid_added_mass frame".split()
    ),
    "inertia": frozenset("ixx ixy ixz iyy iyz izz".split()),
    "velocity_decay": frozenset("linear angular".split()),
    "joint": frozenset(_JOINT_CHILDREN.split()),
    "axis": frozenset(_AXIS_CHILDREN.split()),
    "axis2": frozenset(_AXIS_CHILDREN.split()),
    "dynamics": frozenset("damping friction spring_reference spring_stiffness".split()),
    "limit": frozenset("lower upper effort velocity stiffness dissipation".split()),
    "mimic": frozenset("multiplier offset reference".split()),
    "frame": frozenset("pose".split()),
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

_NOTED_ELEMENTS = frozenset({"gripper", "actor", "road", "wind", "state", "battery", "contact"})
"""Elements that may act on a crane, or place it, and are left out with a note."""

_SCENERY = re.compile(r"model://(sun|ground_plane)/?|https?://\S*/models/(Sun|Ground Plane)")
"""Addresses of included models that neither move nor touch a crane."""

_DRIVING_PLUGIN = re.compile(
    r"joint[-_]?(position|trajectory|velocity)?[-_]?controller|apply[-_]?joint[-_]?force",
    re.IGNORECASE,
)
"""Names and files of plugins that command the joints that they name."""

_TRAJECTORY_PLUGIN = re.compile(r"joint[-_]?trajectory[-_]?controller", re.IGNORECASE)
"""Names and files of plugins that command all joints of their model where they name none."""

_PASSIVE_PLUGIN = re.compile(
    r"(state|pose|odometry)[-_]?publisher|user[-_]?commands|scene[-_]?broadcaster|"
    r"force[-_]?torque|(?<![a-z])(physics|sensors?|imu|contact|altimeter|magnetometer|navsat)"
    r"(?![a-z])",
    re.IGNORECASE,
)
"""Names and files of plugins that measure, draw or compute, and do not act on a crane."""

_ROS_CONTROL_PLUGIN = re.compile(r"ros2?_control", re.IGNORECASE)
"""Names and files of plugins whose joints stand in a URDF elsewhere."""

_AXIS_COUNTS = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "fixed": 0,
    "universal": 2,
    "revolute2": 2,
    "ball": 0,
}
"""Number of axes that a file states for a joint of each type; a ball, which turns about all, has
none."""

_SHAPE_DEFAULTS = {
    "box": {"size": "1 1 1"},
    "cylinder": {"radius": "1", "length": "1"},
    "sphere": {"radius": "1"},
}
"""Numbers of each shape that a URDF has, too, and their defaults [m], by the specification."""


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


class _Reader(SdfFrames):
    """Reader of one file: what it may hold, and the URDF that it becomes."""

    def read(self) -> ForeignModel:
        """Return the crane of the file."""
        self._check_children(self.root)
        contents = [child for child in self.root if child.tag in ("world", "model")]
        if len(contents) != 1:
            raise ModelError(
                f"{self.path} has {len(contents)} worlds and models in <sdf>; allowed is one."
            )
        content = contents[0]
        gravity = None
        if content.tag == "world":
            self.world.element = content
            gravity = self._gravity(content)
            self.declare_members(self.world, "")
        else:
            self.declare(content, self.world, "")
        # Poses in a cycle are refused, those of frames that no joint needs among them.
        for frame in self.frames:
            self.pose(frame)
        robot = self._robot()
        return ForeignModel(robot, gravity, self.notes)

    # --- what a file may hold ---------------------------------------------------------------------

    def _check_children(self, element: ET.Element) -> None:
        """Refuse children that the specification does not know, and repeated ones of which it
        allows one, at any depth.
        """
        known = _CHILDREN.get(element.tag)
        if known is None:
            return
        name = element.get("name")
        context = f"<{element.tag}>" if name is None else f"{element.tag} {quoted(name)}"
        previous_tags: set[str] = set()
        for child in element:
            # The parser writes a tag of a namespace as {address}tag.
            if child.tag.startswith("{") or ":" in child.tag:
                tag = child.tag.rpartition("}")[2]
                self.note(f"<{tag}> of {context}, an extension of SDF, is left out.")
                continue
            if child.tag not in known:
                raise ModelError(
                    f"{self.path} has <{child.tag}> in {context}, which SDF does not have there; "
                    f"allowed are {', '.join(sorted(known))}."
                )
            if child.tag in previous_tags and child.tag not in _REPEATED:
                raise ModelError(
                    f"{self.path} has two elements <{child.tag}> in {context}; allowed is one."
                )
            previous_tags.add(child.tag)
            self._check_child(child, context)

    def _check_child(self, child: ET.Element, context: str) -> None:
        """Refuse, note or look into an element that its parent may have."""
        if child.tag in _NOTED_ELEMENTS:
            self.note(f"<{child.tag}> of {context} is left out.")
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
        uri = child_text(include, "uri")
        if _SCENERY.fullmatch(uri) or is_true(child_text(include, "static", "false")):
            self.note(f"The included model {quoted(uri)} does not move and is left out.")
            return
        raise ModelError(
            f"{self.path} includes {quoted(uri)}, and no other file is read; merge the files into "
            f"one by: gz sdf -p {quoted(self.path)}."
        )

    def _note_plugin(self, plugin: ET.Element) -> None:
        """Say what becomes of a plugin that may act on the crane."""
        name = _plugin_name(plugin)
        if _ROS_CONTROL_PLUGIN.search(name):
            self.note(
                f"The plugin {quoted(name)} takes its joints from a URDF elsewhere; name them by "
                "driven, or --driven."
            )
        elif not (_DRIVING_PLUGIN.search(name) or _PASSIVE_PLUGIN.search(name)):
            self.note(f"What the plugin {quoted(name)} does is left out.")

    # --- numbers ----------------------------------------------------------------------------------

    def _limit(self, limits: ET.Element | None, tag: str, default: float, context: str) -> float:
        """Return a limit of an axis, infinite if the file states that it has none.

        Args:
            limits: The element ``<limit>``; None if there is none.
            tag: Name of the limit in it.
            default: What is returned where the file does not state it.
            context: The joint, for error messages.

        Raises:
            OutOfRange: If it is not a number.
        """
        text = "" if limits is None else child_text(limits, tag)
        if not text:
            return default
        if not _LIMIT.fullmatch(text):
            raise OutOfRange(
                f"{tag} of {context} in {self.path}", quoted(text), "a decimal number or inf"
            )
        value = float(text)
        # Converters from URDF write ±1.79769e+308 for no limit.
        return math.copysign(math.inf, value) if abs(value) >= INFINITE_LIMIT else value

    def _gravity(self, world: ET.Element) -> float:
        """Return the gravity of a world [m/s²]."""
        element = world
        if self.version < 6 and world.find("gravity") is None:
            physics = world.find("physics")  # where it stood before version 1.6
            element = world if physics is None else physics
        x, y, z = self.numbers(element, "gravity", f"0 0 {-DEFAULT_GRAVITY}", "world").tolist()
        if x or y or not z < 0.0:
            raise OutOfRange(
                f"gravity of the world in {self.path}",
                f"{x:g} {y:g} {z:g}",
                "0 0 and a negative number: a crane stands upright",
                "m/s²",
            )
        return float(-z)

    # --- the URDF ---------------------------------------------------------------------------------

    def _robot(self) -> ET.Element:
        """Return the URDF."""
        models = self._models_of_crane()
        self._check_connected(models)
        links = [frame for frame in self.frames if frame.kind == "link" and not frame.static]
        joints = [frame for frame in self.frames if frame.kind == "joint" and not frame.static]
        carriers = self._carrying_joints(joints)
        self._check_anchors(links, carriers)
        robot = ET.Element("robot", name=models[0].element.get("name", "crane"))
        ET.SubElement(robot, "link", name="world")

        # A link of a URDF has its origin at the joint that carries it, with all joints at zero.
        origins = {self.world: pin.SE3.Identity()}
        for link in links:
            origins[link] = self.pose(carriers.get(link, link))

        commanded = self._commanded_axis_indices()
        springs: list[ET.Element] = []
        drives: list[str] = []
        for link in links:
            carrier = carriers.get(link)
            if carrier is None:
                _fixed(robot, f"{link.name}_to_the_ground", "world", link.name, origins[link])
            else:
                axes = self._axes(carrier)
                parent = self.body(self.end(carrier, "parent"))
                self._add_joint(robot, carrier, axes, link, parent, origins[parent], springs)
                drives += self._commanded_axes(carrier, axes, commanded.get(carrier, ()))
            self._add_link(robot, link, origins[link], moves=carrier is not None)
        robot.extend(springs)
        self._add_drives(robot, drives)
        return robot

    def _add_drives(self, robot: ET.Element, commanded: Sequence[str]) -> None:
        """Declare the joints of the URDF that plugins command as driven.

        A joint without range has become fixed, and nothing can drive it.
        """
        fixed = {joint.get("name") for joint in robot.iterfind("joint[@type='fixed']")}
        drives = []
        for name in commanded:
            if name in fixed:
                self.note(f"A plugin commands {quoted(name)}, which has no range; it is left out.")
            else:
                drives.append(name)
        if not drives:
            return
        control = ET.SubElement(robot, "ros2_control", name="drives", type="system")
        for name in drives:
            drive = ET.SubElement(control, "joint", name=name)
            ET.SubElement(drive, "command_interface", name="effort")

    def _models_of_crane(self) -> list[SdfFrame]:
        """Return the models of the world that may move, at least one; note the static ones."""
        models = [frame for frame in self.world.members.values() if frame.kind == "model"]
        moving = [model for model in models if not model.static]
        if not moving:
            raise ModelError(
                f"{self.path} has no model that moves: static models have no joints for a crane."
            )
        for model in models:
            if model.static:
                self.note(f"The {model} is static and stands still; its looks are left out.")
        return moving

    def _commanded_axes(
        self, joint: SdfFrame, axes: Sequence[_Axis], indices: Iterable[int]
    ) -> list[str]:
        """Return the names of the axes of a joint that plugins command, by their indices."""
        names: list[str] = []
        for index in indices:
            if index >= len(axes):
                raise ModelError(
                    f"{self.path} has a plugin that commands axis {index} of {joint}, "
                    f"which has {len(axes)}."
                )
            names.append(axes[index].name)
        return names

    def _check_connected(self, models: list[SdfFrame]) -> None:
        """Check that joints of the world connect all models that move."""
        # The models that are connected with each model, itself among them.
        groups = {model: {model} for model in models}
        for joint in self.world.members.values():
            if joint.kind != "joint":
                continue
            parent = self._top(self.end(joint, "parent"))
            child = self._top(self.end(joint, "child"))
            if parent in groups and child in groups:
                merged = groups[parent] | groups[child]
                for model in merged:
                    groups[model] = merged
        apart = [model for model in models if model not in groups[models[0]]]
        if apart:
            listed = [quoted(model.name) for model in [models[0], *apart][:_MAX_NAMED_BODIES]]
            raise ModelError(
                f"{self.path} has models that move without a joint between them: "
                f"{', '.join(listed)}; write each to a file of its own."
            )

    def _top(self, frame: SdfFrame) -> SdfFrame:
        """Return the model of the world in which a frame is, or the frame itself in the world."""
        while frame.scope not in (None, self.world):
            frame = self.scope_of(frame)
        return frame

    def _carrying_joints(self, joints: list[SdfFrame]) -> dict[SdfFrame, SdfFrame]:
        """Return the joint that carries each link; links that no joint carries are left out."""
        carriers: dict[SdfFrame, SdfFrame] = {}
        ties: dict[SdfFrame, SdfFrame] = {}
        for joint in joints:
            child = self.body(self.end(joint, "child"))
            parent = self.body(self.end(joint, "parent"))
            if child is self.world:
                # A static model does not move, so that the joint ties its parent to the ground.
                if parent is not self.world:
                    ties[joint] = parent
                continue
            if child is parent:
                raise ModelError(f"The {joint} in {self.path} connects {child} with itself.")
            if child in carriers:
                raise ModelError(
                    f"{self.path} has two joints with the child {quoted(child.name)}, "
                    f"{quoted(carriers[child].name)} and {quoted(joint.name)}; allowed is one: a "
                    "crane is a tree."
                )
            carriers[child] = joint
        for joint, parent in ties.items():
            if parent in carriers or joint.element.get("type") != "fixed":
                raise ModelError(
                    f"The {joint} in {self.path} has the parent {quoted(parent.name)}, which "
                    "moves, and a child in a static model, which does not. Exchange them if the "
                    "joint is the foot of the crane; leave the joint out if it closes a loop."
                )
        return carriers

    def _check_anchors(self, links: list[SdfFrame], carriers: dict[SdfFrame, SdfFrame]) -> None:
        """Check that all bodies hang on the world, or on the only link without a joint above it."""
        roots = [link for link in links if link not in carriers]
        parents = [self.body(self.end(joint, "parent")) for joint in carriers.values()]
        count = len(roots) + (1 if self.world in parents else 0)
        # Cycles, which have no such link, are refused with the URDF, see `urdf.check_urdf`.
        if count > 1:
            free = ", ".join(quoted(root.name) for root in roots[:_MAX_NAMED_BODIES])
            raise ModelError(
                f"{self.path} has bodies that no joint connects with the crane: {free}; connect "
                "them by joints, of the type fixed where they stand still, or leave them out."
            )
        for root in roots:
            self.note(
                f"No joint connects {quoted(root.name)} with the world; it is read as fixed there."
            )

    def _axes(self, joint: SdfFrame) -> list[_Axis]:
        """Return the axes of a joint, none for a fixed one."""
        kind = joint.element.get("type", "")
        if kind not in _AXIS_COUNTS:
            raise ModelError(
                f"The {joint} in {self.path} is of type {quoted(kind)}; allowed are "
                f"{', '.join(_AXIS_COUNTS)}."
            )
        if kind == "ball":
            return self._ball_axes(joint)
        axes = []
        tags = ("axis", "axis2")[: _AXIS_COUNTS[kind]]
        for tag in tags:
            element = joint.element.find(tag)
            if element is None:
                raise ModelError(f"The {joint} in {self.path} is {kind} and needs <{tag}>.")
            name = joint.name if len(tags) == 1 else f"{joint.name}_{tag}"
            # Each axis of a universal joint, or of two revolute ones in series, is a revolute one.
            urdf_kind = kind if kind in ("prismatic", "continuous") else "revolute"
            axes.append(_Axis(name, urdf_kind, self._direction(joint, element, tag), element))
        for tag in ("axis", "axis2"):
            if tag not in tags and joint.element.find(tag) is not None:
                self.note(f"<{tag}> of {joint}, which is {kind}, has no effect.")
        return axes

    def _ball_axes(self, joint: SdfFrame) -> list[_Axis]:
        """Return the two horizontal axes that a ball joint is read as."""
        self.note(f"The ball {joint} turns about X, then Y of the world, not about the vertical.")
        if joint.element.find("axis") is not None:
            self.note(f"<axis> of {joint}, which is a ball, has no effect.")
        # The columns of the inverse rotation are the axes of the world in the frame of the joint.
        to_joint = self.pose(joint).rotation.T
        return [
            _Axis(f"{joint.name}_x", "continuous", to_joint[:, 0], None),
            _Axis(f"{joint.name}_y", "continuous", to_joint[:, 1], None),
        ]

    def _direction(self, joint: SdfFrame, axis: ET.Element, tag: str) -> np.ndarray:
        """Return the unit vector of an axis in the frame of its joint."""
        context = f"{tag} of {joint}"
        vector = self.numbers(axis, "xyz", "0 0 1", context)
        length = float(np.linalg.norm(vector))
        if not length > 0.0:
            raise OutOfRange(f"xyz of {context} in {self.path}", "0 0 0", "a length > 0")
        vector = vector / length
        xyz = axis.find("xyz")
        expressed_in = "" if xyz is None else xyz.get("expressed_in", "")
        in_model = is_true(child_text(axis, "use_parent_model_frame", "false"))
        if in_model and (expressed_in or self.version >= FRAME_SEMANTICS_VERSION):
            raise ModelError(
                f"The {context} in {self.path} has use_parent_model_frame, which SDF has up to "
                f"version 1.6; say <xyz expressed_in='__model__'> in version 1.{self.version}."
            )
        scope = self.scope_of(joint)
        if expressed_in:
            frame = self.find(scope, expressed_in, context)
        elif in_model or self.version < JOINT_FRAME_AXES_VERSION:
            frame = scope
        else:
            return vector
        return self.pose(joint).rotation.T @ (self.pose(frame).rotation @ vector)

    def _add_joint(
        self,
        robot: ET.Element,
        joint: SdfFrame,
        axes: list[_Axis],
        link: SdfFrame,
        parent: SdfFrame,
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
        parent_name = parent.name
        for i, axis in enumerate(axes):
            is_last = i == len(axes) - 1
            child_name = link.name if is_last else f"{axis.name}_body"
            element = ET.SubElement(robot, "joint", name=axis.name, type=axis.kind)
            ET.SubElement(element, "parent", link=parent_name)
            ET.SubElement(element, "child", link=child_name)
            set_placement(element, placement)
            ET.SubElement(element, "axis", xyz=numbers_text(axis.direction))
            self._add_limits(element, axis)
            self._add_dynamics(element, joint, axis, springs)
            if not is_last:
                self.note(f"A body of {LIGHT_MASS:g} kg is between the axes of {joint}.")
                between = ET.SubElement(robot, "link", name=child_name)
                inertia = LIGHT_INERTIA * np.eye(3)
                between.append(inertial_element(pin.Inertia(LIGHT_MASS, np.zeros(3), inertia)))
            parent_name = child_name
            placement = pin.SE3.Identity()  # all axes go through the frame of the joint

    def _check_joint_physics(self, joint: SdfFrame) -> None:
        """Refuse a joint that an engine cuts to close a loop, and note a motor of ODE."""
        force = joint.element.find("physics/ode/max_force")
        if force is not None:
            largest = self.number(joint.element.find("physics/ode"), "max_force", "0", str(joint))
            if largest != 0.0:
                self.note(f"The motor of ODE (max_force) at {joint} is left out.")
        cut = joint.element.find("physics/simbody/must_be_loop_joint")
        if cut is not None and is_true((cut.text or "").strip()):
            raise ModelError(f"The {joint} in {self.path} closes a loop; a crane is a tree.")

    def _add_limits(self, element: ET.Element, axis: _Axis) -> None:
        """Append the limits of one axis; a joint whose ends are both zero becomes a fixed one."""
        context = f"joint {quoted(axis.name)}"
        limits = None if axis.element is None else axis.element.find("limit")
        low = -math.inf
        high = math.inf
        if axis.kind != "continuous":
            low = self._limit(limits, "lower", -math.inf, context)
            high = self._limit(limits, "upper", math.inf, context)
        effort = self._limit(limits, "effort", -1.0, context)
        velocity = self._limit(limits, "velocity", -1.0, context)
        if low == high == 0.0:
            self.note(f"The {context} has no range and is read as fixed.")
            element.set("type", "fixed")
            for child in element.findall("axis"):
                element.remove(child)
            return
        if axis.kind == "revolute" and math.isinf(low) and math.isinf(high):
            element.set("type", "continuous")
        if axis.kind == "prismatic" or math.isfinite(low) or math.isfinite(high):
            low, high = self._closed_range(axis, low, high)
        # -1 means no limit in SDF. An effort of 0 stands for that here: `joints.complete_limits`
        # gives a drive with it a large one.
        if effort < 0.0 or math.isinf(effort):
            effort = 0.0
        if velocity < 0.0 or math.isinf(velocity):
            velocity = NO_RATE_LIMIT
        numbers = {"effort": effort, "velocity": velocity}
        if math.isfinite(low) and math.isfinite(high):
            numbers |= {"lower": low, "upper": high}
        ET.SubElement(element, "limit", {name: repr(value) for name, value in numbers.items()})

    def _closed_range(self, axis: _Axis, low: float, high: float) -> tuple[float, float]:
        """Return the range of a joint, closed where the file leaves it open."""
        if math.isfinite(low) and math.isfinite(high):
            return low, high
        slides = axis.kind == "prismatic"
        reach = UNLIMITED_SLIDE if slides else UNLIMITED_TURN
        unit = "m" if slides else "rad"
        # Zero is in the range, and so is a reach beside an end that the file states.
        lower = low if math.isfinite(low) else min(-reach, high - reach)
        upper = high if math.isfinite(high) else max(reach, low + reach)
        self.note(
            f"{axis.name} has no limit at one end or both; {lower:g} to {upper:g} {unit} is taken."
        )
        return lower, upper

    def _add_dynamics(
        self, element: ET.Element, joint: SdfFrame, axis: _Axis, springs: list[ET.Element]
    ) -> None:
        """Append damping and friction of one axis to a joint of the URDF, and how it follows
        another one; append its spring to the springs.
        """
        if axis.element is None or element.get("type") == "fixed":
            return
        context = f"joint {quoted(axis.name)}"
        dynamics = axis.element.find("dynamics")
        numbers = {tag: self.number(dynamics, tag, "0", context) for tag in ("damping", "friction")}
        ET.SubElement(element, "dynamics", {tag: repr(value) for tag, value in numbers.items()})
        stiffness = self.number(dynamics, "spring_stiffness", "0", context)
        if stiffness != 0.0:
            spring = ET.Element("gazebo", reference=axis.name)
            ET.SubElement(spring, "springStiffness").text = repr(stiffness)
            reference = self.number(dynamics, "spring_reference", "0", context)
            ET.SubElement(spring, "springReference").text = repr(reference)
            springs.append(spring)
        if self.number(axis.element, "initial_position", "0", context) != 0.0:
            self.note(f"The initial_position of {context} is left out; Gazebo ignores it, too.")
        mimic = axis.element.find("mimic")
        if mimic is not None:
            # SDF: multiplier × (leader - reference) + offset; a URDF has no reference.
            multiplier = self.number(mimic, "multiplier", "1", context)
            offset = self.number(mimic, "offset", "0", context)
            offset -= multiplier * self.number(mimic, "reference", "0", context)
            leader = self._leader(joint, mimic, context)
            ET.SubElement(
                element,
                "mimic",
                multiplier=repr(multiplier),
                offset=repr(offset),
                joint=leader,
            )

    def _leader(self, joint: SdfFrame, mimic: ET.Element, context: str) -> str:
        """Return the name in the URDF of the axis that an axis of a joint mimics.

        Args:
            joint: The joint that follows.
            mimic: Its element ``<mimic>``, which names the leader as the model of the joint does.
            context: The joint, for error messages.
        """
        leader = self._joint_named(self.scope_of(joint), mimic.get("joint", ""), context)
        if _AXIS_COUNTS.get(leader.element.get("type", "")) == 2:
            return f"{leader.name}_{mimic.get('axis', 'axis')}"
        return leader.name

    def _add_link(self, robot: ET.Element, link: SdfFrame, origin: pin.SE3, *, moves: bool) -> None:
        """Append a link of the URDF whose frame has a pose in the world."""
        self._check_link(link)
        element = ET.SubElement(robot, "link", name=link.name)
        to_origin = origin.actInv(self.pose(link))
        element.append(inertial_element(to_origin.act(self._inertia(link, moves))))
        for tag in ("visual", "collision"):
            for body in link.element.iterfind(tag):
                self._add_shape(element, body, link, origin)

    def _check_link(self, link: SdfFrame) -> None:
        """Refuse what makes a link move otherwise than a rigid body in gravity."""
        if not is_true(child_text(link.element, "gravity", "true")):
            raise ModelError(
                f"The {link} in {self.path} has no gravity; allowed is gravity on all links."
            )
        if is_true(child_text(link.element, "kinematic", "false")):
            raise ModelError(
                f"The {link} in {self.path} is kinematic, moved without forces; leave that out."
            )
        decay = link.element.find("velocity_decay")
        for tag in ("linear", "angular"):
            value = self.number(decay, tag, "0", f"velocity_decay of {link}")
            if value != 0.0:
                raise OutOfRange(
                    f"{tag} velocity_decay of {link} in {self.path}",
                    value,
                    "0: say it as damping of joints",
                )

    def _inertia(self, link: SdfFrame, moves: bool) -> pin.Inertia:
        """Return the inertia of a link in its SDF frame; defaults are noted if it moves."""
        context = str(link)
        inertial = link.element.find("inertial")
        if inertial is not None and is_true(inertial.get("auto", "false")):
            raise ModelError(
                f"The {link} in {self.path} has its mass computed from its collision shapes "
                "(auto); say mass and inertia: gz sdf -p --expand-auto-inertials prints them."
            )
        tensor = None if inertial is None else inertial.find("inertia")
        if moves and (inertial is None or inertial.find("mass") is None):
            self.note(f"The {link} has no mass; 1 kg is taken, the default of SDF.")
        if moves and tensor is None:
            self.note(f"The {link} has no inertia; 1 kg m² about each axis, the default of SDF.")
        self._check_no_added_mass(inertial, link)
        mass = self.number(inertial, "mass", "1", context)
        moments = self._moments(tensor, context)
        if inertial is None:
            return pin.Inertia(mass, np.zeros(3), moments)
        pose = inertial.find("pose")
        if pose is not None and (pose.get("relative_to") or pose.get("frame")):
            raise ModelError(
                f"The inertial of {link} in {self.path} has a pose relative to another frame; "
                "allowed is one in the frame of its link."
            )
        centre = self.raw_pose(inertial, f"the inertial of {link}")
        return centre.act(pin.Inertia(mass, np.zeros(3), moments))

    def _check_no_added_mass(self, inertial: ET.Element | None, link: SdfFrame) -> None:
        """Refuse the inertia of a fluid that moves with a link: nothing here is under water."""
        added = None if inertial is None else inertial.find("fluid_added_mass")
        if added is None:
            return
        for term in added:
            if self.number(added, term.tag, "0", str(link)) != 0.0:
                raise ModelError(f"The {link} in {self.path} has fluid_added_mass; allowed is 0.")

    def _moments(self, tensor: ET.Element | None, context: str) -> np.ndarray:
        """Return the tensor of inertia of a link about its centre of mass, shape (3, 3) [kg m²]."""
        moments = np.empty((3, 3))
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"):
                key = "i" + "".join(sorted(a + b))  # a file states ixy, never iyx
                moments[i, j] = self.number(tensor, key, "1" if a == b else "0", context)
        principal = np.linalg.eigvalsh(moments)
        if not principal[0] >= -NEGATIVE_MOMENT * principal[2]:
            raise OutOfRange(
                f"principal moments of inertia of {context} in {self.path}",
                ", ".join(f"{moment:.6g}" for moment in principal),
                ">= 0",
                "kg m²",
            )
        return moments

    def _add_shape(
        self, element: ET.Element, body: ET.Element, link: SdfFrame, origin: pin.SE3
    ) -> None:
        """Append a visual or a collision whose shape a URDF has, to a link of the URDF."""
        geometry = body.find("geometry")
        shape = None if geometry is None else _urdf_shape(self, geometry, str(link))
        if shape is None:
            self.note(f"A {body.tag} of {link} is of a shape without a size here and left out.")
            return
        user = f"a {body.tag} of {link}"
        named = self.named_base(body, self.scope_of(link), user)
        base = self.pose(link if named is None else named)
        placement = origin.actInv(base * self.raw_pose(body, user))
        copy = ET.SubElement(element, body.tag)
        set_placement(copy, placement)
        ET.SubElement(copy, "geometry").append(shape)
        diffuse = body.find("material/diffuse")
        colour = [] if diffuse is None else (diffuse.text or "").split()
        if body.tag == "visual" and len(colour) in (3, 4) and are_numbers(colour):
            if len(colour) == 3:
                colour.append("1")  # opaque
            material = ET.SubElement(copy, "material", name="")
            ET.SubElement(material, "color", rgba=" ".join(colour))

    # --- drives -----------------------------------------------------------------------------------

    def _commanded_axis_indices(self) -> dict[SdfFrame, dict[int, None]]:
        """Return the indices of the axes of each joint that a plugin commands, in their order."""
        # The inner dictionaries keep the order of the plugins, and each index once.
        driven: dict[SdfFrame, dict[int, None]] = {}
        models = [frame for frame in self.frames if frame.kind == "model" and not frame.static]
        for scope in [self.world, *models]:
            for plugin in scope.element.iterfind("plugin"):
                name = _plugin_name(plugin)
                if not _DRIVING_PLUGIN.search(name):
                    continue
                index = self.number(plugin, "joint_index", "0", f"plugin {quoted(name)}")
                if index not in (0, 1):
                    raise OutOfRange(
                        f"joint_index of the plugin {quoted(name)} in {self.path}", index, "0 or 1"
                    )
                for joint in self._commanded_joints(scope, plugin, name):
                    driven.setdefault(joint, {})[int(index)] = None
                    self.note(f"{joint.name} is driven: the plugin {quoted(name)} commands it.")
            for entry in scope.element.iterfind("ros2_control/joint"):
                if entry.find("command_interface") is not None:
                    joint = self._commanded(scope, entry.get("name", ""), "ros2_control")
                    driven.setdefault(joint, {})[0] = None
        return driven

    def _commanded_joints(
        self, scope: SdfFrame, plugin: ET.Element, plugin_name: str
    ) -> list[SdfFrame]:
        """Return the joints that a plugin commands."""
        names = [(entry.text or "").strip() for entry in plugin.iterfind("joint_name")]
        if names or not _TRAJECTORY_PLUGIN.search(plugin_name):
            return [self._commanded(scope, name, plugin_name) for name in names]
        joints = []
        for member in scope.members.values():
            single = _AXIS_COUNTS.get(member.element.get("type", "")) == 1
            if member.kind == "joint" and single:
                joints.append(member)
        return joints

    def _commanded(self, scope: SdfFrame, name: str, plugin: str) -> SdfFrame:
        """Return the joint of a name that a plugin commands."""
        return self._joint_named(scope, name, f"the plugin {quoted(plugin)}")

    def _joint_named(self, scope: SdfFrame, name: str, user: str) -> SdfFrame:
        """Return the joint of a name in a model or the world.

        Args:
            scope: Model or world in which the name is used.
            name: The name.
            user: What uses the name, for error messages.
        """
        # A joint that shared its name with a link has another key, see `SdfFrames.declare`.
        joint = scope.members.get(f"joint {name}")
        if joint is None:
            joint = self.find(scope, name, user)
        if joint.kind != "joint":
            raise ModelError(
                f"{self.path} has {user}, which names the {joint}; allowed is a joint."
            )
        return joint


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
        if shape.tag not in _SHAPE_DEFAULTS:
            continue
        element = ET.Element(shape.tag)
        for attribute, default in _SHAPE_DEFAULTS[shape.tag].items():
            numbers = reader.numbers(shape, attribute, default, context)
            element.set(attribute, numbers_text(numbers))
        return element
    return None
