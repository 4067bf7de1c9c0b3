"""Side view of a crane as a figure, for pages and notebooks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import PolyCollection
from scipy.spatial import ConvexHull, QhullError

from cranedyn.dynamics.pinocchio import point_positions
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import panels
from cranedyn.recording.shapes import visible_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sketch(crane: Crane, state: State | None = None, *, width: float = 4.5) -> Figure:
    """Draw a crane from the side; the jib of a tower crane at slew angle 0 points to the right.

    Args:
        crane: The crane.
        state: The state to draw; None for the start of the crane.
        width: Width of the figure [inch].
    """
    q = (crane.start if state is None else state).q
    outlines = []
    for shape, points in visible_points(crane, q):
        plane = np.stack([-points[:, 1], points[:, 2]], axis=1)
        try:
            outline = plane[ConvexHull(plane).vertices]
        except QhullError:  # a plate seen edge-on
            continue
        outlines.append((points[:, 0].max(), outline, shape.colour))
    outlines.sort(key=lambda entry: entry[0])  # what is nearer is drawn later
    figure, (ax,) = panels(width=width, height=width)
    ax.add_collection(
        PolyCollection(
            [outline for _, outline, _ in outlines],
            facecolors=[colour for *_, colour in outlines],
        )
    )
    ends = np.roll(point_positions(crane, q), -1, axis=0)  # the payload comes first, and hangs last
    ax.plot(-ends[:, 1], ends[:, 2], color="#404040", linewidth=1.2, zorder=0.9)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="[m]", ylabel="[m]")
    return figure
