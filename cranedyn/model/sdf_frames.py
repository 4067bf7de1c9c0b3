"""Frames of an SDF file: its links, joints, models and free frames, with their poses in the world.

A pose in SDF may be written in any frame of its model, and a free frame may be attached to any
other. Each pose holds with all joints at zero.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError, OutOfRange, quoted
from cranedyn.model.urdf import are_numbers

OLDEST_VERSION = 4
"""Oldest version 1.x of SDF that is read; older ones name links by attributes."""

NEWEST_VERSION = 12
"""Newest version 1.x of SDF that is read."""

FRAME_SEMANTICS_VERSION = 7
"""Version 1.x from which poses name their frame by relative_to only, axes theirs by expressed_in,
and no two elements of a model share a name."""

QUATERNION_TOLERANCE = 1e-3
"""Largest deviation of the length of a quaternion from 1: rounded digits."""

MAX_FRAMES = 2000
"""Largest number of links, joints, models and frames in a file."""


@dataclass(eq=False)
class SdfFrame:
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
    scope: SdfFrame | None = None
    static: bool = False
    members: dict[str, SdfFrame] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.kind} {quoted(self.name or self.element.get('name', ''))}"


class SdfFrames:
    """Frames of one file, and the numbers in it.

    Attributes:
        path: The file, for error messages.
        root: Its root.
        version: x of the version 1.x.
        notes: What was assumed so far.
        world: Frame of the world.
        frames: All other frames in their order.
    """

    def __init__(self, root: ET.Element, path: Path) -> None:
        self.path = path
        self.root = root
        self.version = _version(root, path)
        self.notes: list[str] = []
        self.frames: list[SdfFrame] = []
        self.world = SdfFrame("world", "world", ET.Element("world"))
        self._poses: dict[SdfFrame, pin.SE3] = {self.world: pin.SE3.Identity()}
        self._placements: dict[SdfFrame, pin.SE3] = {}
        self._moving_models: list[ET.Element] | None = None

    def note(self, sentence: str) -> None:
        """Add a note once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    # --- numbers ----------------------------------------------------------------------------------

    def numbers(
        self, parent: ET.Element | None, tag: str, default: str, context: str
    ) -> np.ndarray:
        """Return the numbers of a child of an element, as many as its default has."""
        text = default if parent is None else child_text(parent, tag, default)
        texts = text.split()
        count = len(default.split())
        if len(texts) != count or not are_numbers(texts):
            kind = "a decimal number" if count == 1 else f"{count} decimal numbers"
            raise OutOfRange(f"{tag} of {context} in {self.path}", repr(text), f"{kind} up to 1e30")
        return np.array([float(number) for number in texts])

    def number(self, parent: ET.Element | None, tag: str, default: str, context: str) -> float:
        """Return the number of a child of an element."""
        return float(self.numbers(parent, tag, default, context)[0])

    def raw_pose(self, element: ET.Element, context: str) -> pin.SE3:
        """Return the numbers of the <pose> of an element as a placement."""
        pose = element.find("pose")
        if pose is None or not (pose.text or "").strip():
            return pin.SE3.Identity()
        rotation_format = pose.get("rotation_format", "euler_rpy")
        degrees = is_true(pose.get("degrees", "false"))
        if rotation_format == "quat_xyzw":
            numbers = self.numbers(element, "pose", "0 0 0 0 0 0 1", context)
            quaternion = numbers[3:]
            length = float(np.linalg.norm(quaternion))
            if abs(length - 1.0) > QUATERNION_TOLERANCE:
                raise OutOfRange(
                    f"length of the quaternion of {context} in {self.path}", f"{length:.6g}", "1"
                )
            rotation = pin.Quaternion(quaternion / length).matrix()
        elif rotation_format == "euler_rpy":
            numbers = self.numbers(element, "pose", "0 0 0 0 0 0", context)
            angles = np.radians(numbers[3:]) if degrees else numbers[3:]
            rotation = pin.rpy.rpyToMatrix(angles)
        else:
            raise ModelError(
                f"The pose of {context} in {self.path} has the rotation_format "
                f"{quoted(rotation_format)}; allowed are euler_rpy and quat_xyzw."
            )
        return pin.SE3(rotation, numbers[:3])

    # --- frames -----------------------------------------------------------------------------------

    def declare(self, element: ET.Element, scope: SdfFrame, prefix: str) -> None:
        """Enter the frame of an element and, for a model, those in it."""
        name = element.get("name", "")
        if not name:
            raise ModelError(f"{self.path} has a {element.tag} without a name.")
        if name in ("world", "__root__") or (name.startswith("__") and name.endswith("__")):
            raise ModelError(
                f"{self.path} has a {element.tag} with the name {quoted(name)}, which SDF keeps "
                "for itself; rename it."
            )
        frame = SdfFrame(prefix + name, element.tag, element, scope, scope.static)
        if element.tag == "model" and is_true(child_text(element, "static", "false")):
            frame.static = True
        key = self._key(frame, name, scope)
        scope.members[key] = frame
        self.frames.append(frame)
        if len(self.frames) > MAX_FRAMES:
            raise ModelError(
                f"{self.path} has more than {MAX_FRAMES} links, joints and frames; allowed are "
                f"{MAX_FRAMES}."
            )
        if element.tag == "model":
            # The name of the only model that moves is left out of the names of its members.
            drops_prefix = scope is self.world and not frame.static and self._is_single(frame)
            self.declare_members(frame, "" if drops_prefix else f"{frame.name}::")

    def _key(self, frame: SdfFrame, name: str, scope: SdfFrame) -> str:
        """Return the key of a new frame among the members of its scope.

        That is its name. Before frame semantics a joint and a link could share a name, since no
        pose names a joint. The joint is renamed then, and its key is "joint NAME"; the key NAME is
        the link.

        Raises:
            ModelError: If the scope has another frame of the name.
        """
        if name not in scope.members:
            return name
        other = scope.members[name]
        is_one_joint = "joint" in (frame.kind, other.kind) and frame.kind != other.kind
        if self.version >= FRAME_SEMANTICS_VERSION or not is_one_joint:
            raise ModelError(
                f"{self.path} has two elements with the name {quoted(frame.name)}, a "
                f"{other.kind} and a {frame.kind}; allowed is one."
            )
        joint = frame if frame.kind == "joint" else other
        joint.name += "_joint"  # as libsdformat renames it
        scope.members[f"joint {name}"] = joint
        return f"joint {name}" if joint is frame else name

    def _is_single(self, model: SdfFrame) -> bool:
        """Return whether a model is the only one of the world that moves."""
        if self._moving_models is None:
            self._moving_models = [
                child
                for child in self.world.element.iterfind("model")
                if not is_true(child_text(child, "static", "false"))
            ]
        return not self._moving_models or self._moving_models == [model.element]

    def declare_members(self, scope: SdfFrame, prefix: str) -> None:
        """Enter the frames that a model or the world declares, with a prefix to their names."""
        for child in scope.element:
            if child.tag in ("link", "joint", "frame", "model"):
                self.declare(child, scope, prefix)

    def find(self, scope: SdfFrame, name: str, user: str) -> SdfFrame:
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

    def scope_of(self, frame: SdfFrame) -> SdfFrame:
        """Return the model or the world in which a frame is declared."""
        return self.world if frame.scope is None else frame.scope

    def named_base(self, element: ET.Element, scope: SdfFrame, user: str) -> SdfFrame | None:
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
        return self.find(scope, name, f"a pose of {user}") if name else None

    def _base(self, frame: SdfFrame) -> SdfFrame:
        """Return the frame in which the pose of a frame is written."""
        scope = self.scope_of(frame)
        named = self.named_base(frame.element, scope, str(frame))
        if named is not None:
            return named
        if frame.kind == "joint":
            return self.end(frame, "child")
        attached = frame.element.get("attached_to") if frame.kind == "frame" else None
        return self.find(scope, attached, str(frame)) if attached else scope

    def end(self, joint: SdfFrame, tag: str) -> SdfFrame:
        """Return the frame that a joint names as its parent or child."""
        name = child_text(joint.element, tag)
        if not name:
            raise ModelError(f"The {joint} in {self.path} needs a {tag}.")
        if name == "world":
            if tag == "child":
                raise ModelError(
                    f"The {joint} in {self.path} has the child world; allowed is a link."
                )
            return self.world
        return self.find(self.scope_of(joint), name, f"the {tag} of {joint}")

    def pose(self, frame: SdfFrame) -> pin.SE3:
        """Return the pose of a frame in the world with all joints at zero."""
        # From the frame to the first one on the way to the world whose pose is known. A dictionary
        # keeps the order, and finds a frame that comes twice at once.
        chain: dict[SdfFrame, None] = {}
        while frame not in self._poses:
            if frame in chain:
                raise ModelError(
                    f"{self.path} has poses that are relative to each other in a cycle through "
                    f"the {frame}."
                )
            chain[frame] = None
            frame = self._base(frame)
        pose = self._poses[frame]
        for inner in reversed(chain):
            pose = pose * self._placement(inner)
            self._poses[inner] = pose
        return pose

    def _placement(self, frame: SdfFrame) -> pin.SE3:
        """Return the pose of a frame in the frame in which it is written.

        It is kept: nested models that all name a frame of the innermost one would otherwise
        compute it again at each level, which takes exponential time.
        """
        if frame not in self._placements:
            self._placements[frame] = self._new_placement(frame)
        return self._placements[frame]

    def _new_placement(self, frame: SdfFrame) -> pin.SE3:
        """Return the placement of a frame that is not known yet."""
        placement = self.raw_pose(frame.element, str(frame))
        name = frame.element.get("placement_frame") if frame.kind == "model" else None
        if not name:
            return placement
        inner = self.find(frame, name, f"the placement_frame of {frame}")
        # The pose says where that frame is, not where the model frame is.
        in_model = pin.SE3.Identity()
        passed_frames: set[SdfFrame] = set()
        while inner is not frame:
            if inner in passed_frames:
                raise ModelError(
                    f"{self.path} has poses that are relative to each other in a cycle through "
                    f"the {inner}."
                )
            passed_frames.add(inner)
            in_model = self._placement(inner) * in_model
            inner = self._base(inner)
        return placement * in_model.inverse()

    def body(self, frame: SdfFrame) -> SdfFrame:
        """Return the link, or the world, with which a frame moves."""
        passed_frames: set[SdfFrame] = set()
        while frame.kind not in ("link", "world"):
            if frame in passed_frames:
                raise ModelError(
                    f"{self.path} has frames that are attached to each other in a cycle through "
                    f"the {frame}."
                )
            passed_frames.add(frame)
            if frame.kind == "joint":
                frame = self.end(frame, "child")
            elif frame.kind == "model":
                frame = self._canonical(frame)
            else:
                attached = frame.element.get("attached_to")
                scope = self.scope_of(frame)
                frame = self.find(scope, attached, str(frame)) if attached else scope
        return self.world if frame.static else frame

    def _canonical(self, model: SdfFrame) -> SdfFrame:
        """Return the frame to which a model is attached: that which it names, its first link, or
        its first model.
        """
        name = model.element.get("canonical_link")
        if name:
            return self.find(model, name, f"the canonical_link of {model}")
        for kind in ("link", "model"):
            for member in model.members.values():
                if member.kind == kind:
                    return member
        raise ModelError(f"The {model} in {self.path} has no link.")


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


def child_text(parent: ET.Element, tag: str, default: str = "") -> str:
    """Return the text of a child of an element, or the default where it has none."""
    return (parent.findtext(tag) or "").strip() or default


def is_true(text: str) -> bool:
    """Return whether a text means true in SDF.

    Raises:
        OutOfRange: If it means neither true nor false.
    """
    word = text.strip().lower()
    if word not in ("true", "false", "1", "0"):
        raise OutOfRange("a yes or no in an SDF file", quoted(text), "true, false, 1 or 0")
    return word in ("true", "1")
