"""Bodies of a crane whose load hangs at the end of a chain of joints, from the shapes in its URDF.

Of a link that has shapes for collisions these count, and otherwise those that are drawn. Shapes of
the links between the swing joints are not compared with anything: a crane that has such counts as
one that is not wholly drawn.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError
from cranedyn.lifts.planning.crane_bodies import (
    DrawnShape,
    HangingBodies,
    box_around,
    corners_of,
    drawn_payload,
    hook_turn,
    read_shapes,
    small_hook,
)
from cranedyn.lifts.planning.site import HANGING
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Link:
    """A link that drives move.

    Attributes:
        name: Its name, without the ending "_link".
        shapes: Its shapes, in the frame of the joint that carries it.
    """

    name: str
    shapes: list[DrawnShape]


@dataclass(frozen=True, eq=False, kw_only=True)
class ChainBodies(HangingBodies):
    """Bodies of a crane, each in the frame of the joint that carries it.

    Attributes:
        standing: Corners of each shape that stands [m], shape (n, 3) each.
        links: Links that drives move, by the index of the joint that carries them. A link that
            shows nothing is none of them.
        undrawn: Names of the links that show nothing, of which nothing is compared.
        hook_drawn: Whether the URDF draws a hook above the load; if not, the hook is a
            cube with sides of twice `ROPE_RADIUS`, and the rope is as wide.
    """

    standing: list[np.ndarray]
    links: dict[int, Link]
    undrawn: tuple[str, ...]
    hook_drawn: bool


def chain_bodies(crane: Crane, load: np.ndarray | None = None) -> ChainBodies:
    """Return the bodies of a crane from the boxes, cylinders and spheres in its URDF.

    Args:
        crane: The crane, of a chain of joints, see `cranedyn.lifts.planning.hoist_chain`.
        load: Corners of another load about the end of the cable [m], shape (n, 3), along the axes
            of the crane with its drives at zero; the hook then stands on top of it. None for the
            load that is drawn.

    Raises:
        ModelError: If a link shows a mesh among the shapes that count, or neither the URDF shows a
            load nor one is given.
    """
    shapes = _shapes_by_joint(crane)
    hoist = int(crane.layout.drives[2])
    turn = hook_turn(crane)
    carried = shapes.get(hoist + 1, [])
    if not carried and load is None:
        raise ModelError(
            "The URDF of the crane shows no shapes of its load; enter its size, such as [load] "
            "size, or draw it with boxes, cylinders or spheres."
        )
    hook = small_hook(load)
    hook_drawn = False
    corners = None if load is None else load @ turn  # rows are turned into the joint's frame
    if carried:
        drawn = drawn_payload(carried)
        corners = drawn.load if corners is None else corners
        if drawn.hook:
            rise = 0.0 if load is None else float(load[:, 2].max()) - drawn.top
            hook = box_around(np.concatenate(drawn.hook) + np.array([0.0, 0.0, rise]))
            hook_drawn = True
        elif load is not None:
            # What is drawn may be a load or a hook block, so that it stays above the load.
            rise = float(load[:, 2].max()) - float(drawn.load[:, 2].min())
            hook = box_around(drawn.load + np.array([0.0, 0.0, rise]))
            hook_drawn = True
        else:
            hook = small_hook(corners)
    assert corners is not None
    links = {}
    names = _link_names(crane)
    for joint in crane.layout.drives[:2].tolist():
        of_link = shapes.get(joint + 1, [])
        if of_link:
            links[joint] = Link(names[joint], of_link)
    width = float(np.max(hook.size[:2]))
    return ChainBodies(
        hook=hook,
        load=corners,
        falls=width / 2.0,
        hook_turn=turn,
        standing=[corners_of(shape) for shape in shapes.get(0, [])],
        links=links,
        undrawn=_undrawn(crane, shapes, names),
        hook_drawn=hook_drawn,
    )


def _undrawn(
    crane: Crane, shapes: dict[int, list[DrawnShape]], names: dict[int, str]
) -> tuple[str, ...]:
    """Return the names of links of which nothing is compared: those with a mass and no shape, those
    between the swing joints that have shapes, and what a file of another format draws otherwise.
    """
    undrawn = []
    hook = crane.payload.body + 1
    swings = (crane.swings + 1).tolist()
    for link in ET.fromstring(crane.urdf).iterfind("link"):
        name = link.get("name", "")
        frame = crane.model.getFrameId(name, pin.FrameType.BODY)
        if frame >= crane.model.nframes:
            continue
        joint = crane.model.frames[frame].parentJoint
        has_shape = link.find("collision") is not None or link.find("visual") is not None
        weighs = link.find("inertial/mass") is not None
        if weighs and not has_shape and joint != hook and joint not in swings:
            undrawn.append(name.removesuffix("_link"))
    for joint in crane.layout.drives[:2].tolist():
        if not shapes.get(joint + 1) and names[joint] not in undrawn:
            undrawn.append(names[joint])
    for joint in crane.swings.tolist():
        if shapes.get(joint + 1):
            undrawn.append(f"{names[joint]}, which swings,")
    # Sentences of the readers of MJCF and SDF.
    for sentence in crane.assumptions:
        if any(part in sentence for part in ("not drawn", "a shape without a size", "looks are")):
            undrawn.append(f"all that its file shows ({sentence.rstrip('.')})")
    return tuple(undrawn)


def _link_names(crane: Crane) -> dict[int, str]:
    """Return the name of the link that each joint carries, without the ending "_link", by the index
    of the joint among the coordinates.
    """
    children = {}
    for joint in ET.fromstring(crane.urdf).iterfind("joint"):
        child = joint.find("child")
        if child is not None:
            children[joint.get("name", "")] = child.get("link", "")
    names: dict[int, str] = {}
    for i, described in enumerate(crane.layout.joints):
        whole = children.get(described.name, described.name)
        name = whole.removesuffix("_link")
        if name in names.values():  # such as jib and jib_link
            name = whole
        # A link that is called as what hangs would count as that.
        names[i] = f"link {name}" if name in HANGING else name
    return names


def _shapes_by_joint(crane: Crane) -> dict[int, list[DrawnShape]]:
    """Return the shapes of a URDF by the joint of Pinocchio that carries them; 0 is the world. Of a
    link with shapes for collisions these, else those that are drawn.

    Raises:
        ModelError: As `cranedyn.lifts.planning.crane_bodies.read_shapes`.
    """
    robot = ET.fromstring(crane.urdf)
    for link in robot.iterfind("link"):
        if link.find("collision") is not None:
            for element in link.findall("visual"):
                link.remove(element)
    return read_shapes(crane, robot, "Draw them as <collision> of that link.")
