"""How much room a crane takes in the scene: the box about all that can be seen of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from cranedyn.dynamics.pinocchio import point_positions
from cranedyn.model.urdf import parse, skeleton
from cranedyn.recording.run import Run
from cranedyn.recording.shapes import Shape, shapes


def extent(run: Run) -> np.ndarray:
    """Lowest and highest corner of the box about a crane at the start of a run [m], shape (2,
    3).
    """
    q = run.trajectory.q[0] if len(run.trajectory) else run.crane.start.q
    model = pin.buildModelFromXML(skeleton(parse(run.crane.urdf, "the crane")))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    found = [point_positions(run.crane, q)]
    for link, of_link in shapes(run.crane.urdf, run.meshes).items():
        place = data.oMf[model.getFrameId(link, pin.FrameType.BODY)]
        found += [np.array([place.act(corner) for corner in _corners(shape)]) for shape in of_link]
    points = np.concatenate(found) + run.offset
    return np.array([points.min(axis=0), points.max(axis=0)])


def _corners(shape: Shape) -> np.ndarray:
    """Two opposite corners of a box about a shape in the frame of its link, along its axes [m],
    shape (2, 3).
    """
    size = shape.size
    if shape.kind == "sphere":
        half = np.full(3, size[0])
    else:
        half = (
            np.array([size[0], size[0], size[1] / 2.0])
            if shape.kind == "cylinder"
            else np.array(size) / 2.0
        )
    reach = np.abs(Rotation.from_euler("xyz", shape.rpy).as_matrix()) @ half
    return np.array([shape.centre - reach, shape.centre + reach])
