"""The crane as a drawing: what its URDF shows, seen from the side, for pages and notebooks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from matplotlib.collections import PolyCollection
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from cranedyn.dynamics.pinocchio import point_positions
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import panels
from cranedyn.recording.shapes import Shape, shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROUND = 12
"""Corners by which a circle is drawn."""


def sketch(crane: Crane, state: State | None = None, *, width: float = 4.5) -> Figure:
    """Draw the crane from the side, its jib towards the right when it is not slewed.

    Args:
        crane: The crane.
        state: Where it stands; by default where it starts.
        width: Of the figure [inch].
    """
    q = (crane.start if state is None else state).q
    data = crane.model.createData()
    pin.framesForwardKinematics(crane.model, data, q)
    drawn = sorted(_outlines(crane, data), key=lambda one: one[0])
    figure, (ax,) = panels(width=width, height=width)
    ax.add_collection(
        PolyCollection(
            [outline for _, outline, _ in drawn], facecolors=[colour for *_, colour in drawn]
        )
    )
    # The payload, which stands first, hangs last.
    ends = np.roll(point_positions(crane, q), -1, axis=0)
    ax.plot(-ends[:, 1], ends[:, 2], color="#404040", linewidth=1.2, zorder=0.9)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="[m]", ylabel="[m]")
    return figure


def _outlines(
    crane: Crane, data: pin.Data
) -> Iterator[tuple[float, np.ndarray, tuple[float, ...]]]:
    """How near the viewer each shape is, its outline in the plane of the jib [m], shape (n, 2), and
    its colour.
    """
    for link, of_link in shapes(crane.urdf).items():
        if not of_link or not crane.model.existFrame(link, pin.BODY):
            continue
        place = data.oMf[crane.model.getFrameId(link, pin.BODY)]
        for shape in of_link:
            corners = (
                _corners(shape) @ Rotation.from_euler("xyz", shape.rpy).as_matrix().T + shape.centre
            )
            world = corners @ place.rotation.T + place.translation
            flat = np.stack([-world[:, 1], world[:, 2]], axis=1)
            try:
                outline = flat[ConvexHull(flat).vertices]
            except QhullError:  # seen from its edge
                continue
            yield float(world[:, 0].max()), outline, shape.colour


def _corners(shape: Shape) -> np.ndarray:
    """Points whose hull is the shape [m], in its own frame, shape (n, 3)."""
    if shape.kind == "box":
        return np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).reshape(3, -1).T * shape.size
    turn = np.linspace(0.0, 2 * np.pi, _ROUND, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * shape.size[0]
    if shape.kind == "cylinder":
        return np.array(
            [(*point, z) for point in ring for z in (-shape.size[1] / 2, shape.size[1] / 2)]
        )
    rise = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2 + 1)
    return np.array(
        [(*(point * np.cos(a)), shape.size[0] * np.sin(a)) for a in rise for point in ring]
    )
