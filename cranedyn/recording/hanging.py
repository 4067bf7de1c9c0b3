"""Rope and load of a crane as they are drawn: a slack rope sags, a load that stands has marks."""

from __future__ import annotations

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import ON_GROUND
from cranedyn.dynamics.pinocchio import body_points
from cranedyn.model.crane import Crane, Point

CONTACT = "#F22B05"
"""Colour of marks where a load touches."""

_SAG_POINTS, _LEVEL = 9, 5e-3
"""Points of a rope that sags, and height above the lowest point of a load up to which others are
marked where it touches [m]."""


def rope_line(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return pivot, hook if there is one, and payload in the world [m], shape (rows, points, 3), at
    coordinates of shape (rows, n); of a rope that may go slack also points between that sag, of two
    falls their ends.
    """
    order = [*range(1, len(crane.points)), 0]
    points = point_paths(crane, np.asarray(q))[:, order]
    if (falls := crane.springs.bifilar) is not None:
        above, a = crane.model.parents[falls.yaw + 1] - 1, 0.5 * falls.spacing
        ends = ((falls.yaw, -a), (above, -a), (above, a), (falls.yaw, a), (falls.yaw, 0.0))
        corners = [Point("", body, np.array([0.0, aside, 0.0])) for body, aside in ends]
        path = point_paths(crane, np.asarray(q), corners)
        path[:, 1:3] += points[:, :1] - path[:, 4:]  # from the lower ends up to the pivot
        return np.concatenate([path[:, 4:], path, points[:, 1:]], axis=1)
    if (rope := crane.springs.rope) is None:
        return points
    top, end = points[:, :1], points[:, 1:2]
    slack = np.maximum(-np.asarray(q)[:, rope.stretch], 0.0)
    # A parabola of depth f over a chord d is longer than that by 8 f²/(3 d).
    depth = np.sqrt(0.375 * slack * np.linalg.norm(end - top, axis=2)[:, 0])
    u = np.linspace(0.0, 1.0, _SAG_POINTS)[:, None]
    sag = (4.0 * u * (1.0 - u) * depth)[..., None].transpose(1, 0, 2)
    aside = np.cross(top - end, [1.0, -1.0, 0.0])  # diagonal, so that no side view hides it
    aside /= np.maximum(np.linalg.norm(aside, axis=2, keepdims=True), 1e-9)
    return np.concatenate([top + u * (end - top) + sag * aside, points[:, 2:]], axis=1)


def touching_points(crane: Crane, run: Trajectory, row: int) -> np.ndarray:
    """Return the lowest of the points of the load that may touch [m], in the world, shape (k, 3);
    none where the load does not touch.
    """
    ground = run.record.get("ground", {})
    levers = ground.get("points") if isinstance(ground, dict) else None
    if run.phase is None or run.phase[row] < ON_GROUND or not isinstance(levers, list):
        return np.zeros((0, 3))
    points, still = crane.payload.lever + np.array(levers), np.zeros(crane.layout.n)
    places = body_points(crane.model, crane.data, crane.payload.body, points, run.q[row], still)[0]
    return places[:, places[2] < places[2].min() + _LEVEL].T
