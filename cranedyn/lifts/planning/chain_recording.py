"""A chain of lifts in 3D: the crane with its hook, and all loads, each where it stands or hangs."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.lifts.planning.ground_lift import GroundLift
from cranedyn.lifts.planning.lift_chain import CertifiedChain
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import rotation_z
from cranedyn.model.crane import Crane
from cranedyn.recording.contents import Obstacle
from cranedyn.recording.postures import MovingBox, MovingLine, PosedCrane, record_postures

_ROW_PERIOD = 0.04
"""Time between rows of a recording [s]."""


def record_chain(path: str | Path, certified: CertifiedChain, *, title: str = "Lifts") -> Path:
    """Write a simulated chain as a recording for the viewer: one crane, all moves one after the
    other, with each load as a box.

    Args:
        path: The file, ending in ``.rrd``.
        certified: The chain.
        title: Heading of the recording.

    Raises:
        DataError: If the file cannot be written.
        CraneError: If Rerun is switched off in the environment.
    """
    chain = certified.chain
    site = chain.site
    first = chain.moves[0].lift.crane
    t: list[np.ndarray] = []
    q: list[np.ndarray] = []
    pulls: list[np.ndarray] = []
    ropes: list[np.ndarray] = []
    hooks: list[_Poses] = []
    loads: dict[str, list[_Poses]] = {name: [] for name in chain.sizes}
    # Where each load stands until it is carried, and from then on.
    standing = {
        name: _Poses(load.centre[None], rotation_z(load.yaw)[None])
        for name, load in chain.initial_loads.items()
    }
    for move, piece in zip(chain.moves, certified.run.stages, strict=True):
        step = max(1, round(_ROW_PERIOD / float(piece.t[1] - piece.t[0])))
        rows = slice(0, len(piece) - 1, step)
        lift = move.lift
        t.append(piece.t[rows])
        q.append(piece.q[rows])
        forces = JointForces.of(lift.crane)
        pulls.append(forces.tension(piece.q[rows].T, piece.v[rows].T) / 1e3)
        hung = _hung(lift, piece.q[rows], site)
        hanging = hung.box
        ropes.append(hung.rope)
        if move.load:
            height = chain.sizes[move.load][2]
            hooks.append(hanging.raised((height + chain.hook.size[2]) / 2.0))
        else:
            hooks.append(hanging)
        for name, poses in loads.items():
            count = len(piece.t[rows])
            poses.append(hanging if name == move.load else standing[name].repeated(count))
        if move.load:
            standing[move.load] = hanging.last
    boxes = [_moving_box("hook", chain.hook.size, hooks)]
    boxes += [_moving_box(name, chain.sizes[name], poses) for name, poses in loads.items()]
    turn = site.crane_to_site
    return record_postures(
        path,
        np.concatenate(t),
        [
            PosedCrane(
                name="crane",
                crane=first,
                q=np.concatenate(q),
                foot=np.asarray(site.foot, dtype=float),
                turn=math.atan2(turn[1, 0], turn[0, 0]),
                hidden=("payload_link", _link_of_load(first)),
            )
        ],
        boxes,
        [MovingLine("rope", np.concatenate(ropes))],
        obstacles=[
            Obstacle(solid.name, solid.vertices, solid.triangles, solid.zone)
            for solid in site.solids
        ],
        curves={"Pull of the rope [kN]": {"pull": np.concatenate(pulls)}},
        title=title,
        text="A load stands still until the hook takes it, and after it is released. Grid: 5 m.",
    )


class _Poses(NamedTuple):
    """Places of a box over time in the frame of the site.

    Attributes:
        centres: Places of its centre [m], shape (rows, 3).
        rotations: Rotations from its axes to those of the site, shape (rows, 3, 3).
    """

    centres: np.ndarray
    rotations: np.ndarray

    @property
    def last(self) -> _Poses:
        """The last place alone."""
        return _Poses(self.centres[-1:], self.rotations[-1:])

    def repeated(self, count: int) -> _Poses:
        """Return a single place, repeated."""
        return _Poses(
            np.repeat(self.centres, count, axis=0), np.repeat(self.rotations, count, axis=0)
        )

    def raised(self, height: float) -> _Poses:
        """Return places that are higher along the Z axis of the box by a height [m]."""
        return _Poses(self.centres + height * self.rotations[:, :, 2], self.rotations)


class _Hung(NamedTuple):
    """Rope and box of a move over time in the frame of the site.

    Attributes:
        rope: Pivot and end of the rope [m], shape (rows, 2, 3).
        box: Where the box hangs.
    """

    rope: np.ndarray
    box: _Poses


def _hung(lift: GroundLift, q: np.ndarray, site: Site) -> _Hung:
    """Return where rope and box of a move are at coordinates of its crane, shape (rows, n)."""
    crane = lift.crane
    # From the end of the rope, along the axes of the box.
    middle = crane.payload.lever + np.mean(lift.ground.points, axis=0)
    rope = []
    centres = []
    rotations = []
    for row in q:
        pin.forwardKinematics(crane.model, crane.data, row)
        # Pinocchio counts joints from 1.
        pivot = crane.data.oMi[crane.layout.index("theta") + 1]
        lug = crane.data.oMi[crane.payload.body + 1]
        rope.append([pivot.translation.copy(), lug.translation.copy()])
        centres.append(lug.act(middle))
        rotations.append(site.crane_to_site @ lug.rotation)
    box = _Poses(site.to_site(np.array(centres)), np.array(rotations))
    return _Hung(site.to_site(np.array(rope)), box)


def _moving_box(name: str, sides: Sequence[float], poses: Sequence[_Poses]) -> MovingBox:
    """Return a box of a recording from its places in all moves."""
    return MovingBox(
        name,
        np.array(sides, dtype=float),
        np.concatenate([part.centres for part in poses]),
        Rotation.from_matrix(np.concatenate([part.rotations for part in poses])),
    )


def _link_of_load(crane: Crane) -> str:
    """Return the name of the link that draws the load below the rope."""
    robot = ET.fromstring(crane.urdf)
    joint = next(joint for joint in robot.iterfind("joint") if joint.get("name") == "load_joint")
    child = joint.find("child")
    assert child is not None
    return child.get("link", "")
