"""Where the loads of many cranes hang at rest, for the starts and goals of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice, product
from typing import NamedTuple

import numpy as np

from cranedyn.dynamics.bodies import point_paths
from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane, once_per_crane
from cranedyn.model.springs import rest_stiffness

_SAMPLES = 8
"""Number of drive positions at which the linear rest is compared with the rest."""

_MAX_CORNERS = 64
"""Largest number of corners of the ranges of the drives: those of six drives."""

_ROUND_OFF = 1e-9
"""Largest deviation of the linear rest from the rest that counts as round-off [rad or m]."""


def hanging_coordinates(
    cranes: Sequence[Crane], kinds: np.ndarray, drives: np.ndarray
) -> np.ndarray:
    """Return coordinates of hanging cranes, shape (n, k).

    Args:
        cranes: The cranes to choose from.
        kinds: Which of them each column is, shape (k,).
        drives: Positions of the drives [rad or m], shape (m, k).

    Raises:
        ModelError: If a crane does not hang at rest there.
    """
    q = np.empty((cranes[0].layout.n, len(kinds)))
    for kind in np.unique(kinds).tolist():
        of_kind = kinds == kind
        q[:, of_kind] = _hanging(cranes[kind], drives[:, of_kind])
    return q


def rest_places(cranes: Sequence[Crane], kinds: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """Return the places in the world at which loads hang at rest [m], shape (3, k); the arguments
    are those of `hanging_coordinates`.

    Raises:
        ModelError: If a crane does not hang at rest there.
    """
    q = hanging_coordinates(cranes, kinds, drives)
    places = np.empty((3, len(kinds)))
    for kind in np.unique(kinds).tolist():
        of_kind = kinds == kind
        crane = cranes[kind]
        places[:, of_kind] = point_paths(crane, q[:, of_kind].T, [crane.payload])[:, 0].T
    return places


def range_corners(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return drive positions at the corners of ranges [rad or m], shape (m, k): all corners of up
    to six drives.

    Args:
        lower: Lower ends of the ranges of the drives [rad or m], shape (m,).
        upper: Upper ends.
    """
    ends = zip(lower.tolist(), upper.tolist(), strict=True)
    return np.array(list(islice(product(*ends), _MAX_CORNERS))).T


def check_hangs(cranes: Sequence[Crane], lower: np.ndarray, upper: np.ndarray) -> None:
    """Check that cranes hang at rest at the corners of ranges of their drives, where passive joints
    are farthest from their middle.

    Args:
        cranes: The cranes.
        lower: Lower ends of the ranges of the drives [rad or m], shape (m,).
        upper: Upper ends.

    Raises:
        ModelError: If a crane does not.
    """
    corners = range_corners(lower, upper)
    for kind in range(len(cranes)):
        hanging_coordinates(cranes, np.full(corners.shape[1], kind), corners)


def _hanging(crane: Crane, drives: np.ndarray) -> np.ndarray:
    """Return the coordinates of one crane that hangs at many drive positions, shape (n, k)."""
    linear = _linear_rest(crane)
    q = linear.at(crane, drives)
    to_solve = np.ones(q.shape[1], dtype=bool)
    if linear.is_exact:
        # Of a joint beyond its range, `hanging` says which and where.
        passive = crane.layout.passive
        is_low = q[passive] < crane.lower[passive][:, None]
        is_high = q[passive] > crane.upper[passive][:, None]
        to_solve = (is_low | is_high).any(axis=0)
    for column in np.flatnonzero(to_solve):
        q[:, column] = crane.hanging(q[:, column])
    return q


class _LinearRest(NamedTuple):
    """How the passive joints of a crane hang, to first order in the drives about its start.

    Attributes:
        slope: Derivatives of all coordinates by those of the drives, shape (n, m).
        is_exact: Whether the first order is all: it is for a load on a rope in a stiff crane.
    """

    slope: np.ndarray
    is_exact: bool

    def at(self, crane: Crane, drives: np.ndarray) -> np.ndarray:
        """Return coordinates at drive positions, shape (n, k)."""
        rest = crane.rest.q
        own = crane.layout.drives
        q = rest[:, None] + self.slope @ (drives - rest[own][:, None])
        q[own] = drives
        return q


@once_per_crane
def _linear_rest(crane: Crane) -> _LinearRest:
    """Return how the passive joints of a crane hang, and whether that is exact."""
    layout = crane.layout
    rest = crane.rest.q
    # At rest the gradient of the energy by the passive joints p stays zero while the drives d move:
    # K_pp δq_p + K_pd δq_d = 0. A joint without stiffness, such as a swivel, stays where it is: it
    # is zero in the solution of least norm.
    stiffness = rest_stiffness(crane.model, crane.data, crane.springs, rest, crane.coupling)
    of_passive = stiffness[np.ix_(layout.passive, layout.passive)]
    by_drives = stiffness[np.ix_(layout.passive, layout.drives)]
    slope = np.zeros((layout.n, layout.m))
    slope[layout.passive] = -np.linalg.lstsq(of_passive, by_drives, rcond=None)[0]
    slope[np.abs(slope) < _ROUND_OFF] = 0.0
    linear = _LinearRest(slope, is_exact=True)

    # The positions are random so that no symmetry of the crane hides a deviation.
    ends = crane.lower[layout.drives, None], crane.upper[layout.drives, None]
    samples = np.random.default_rng(0).uniform(*ends, (layout.m, _SAMPLES))
    for q in linear.at(crane, samples).T:
        try:
            deviation = np.abs(crane.hanging(q) - q).max()
        except ModelError:
            # It does not hang everywhere; `check_hangs` says where it must.
            return linear._replace(is_exact=False)
        if deviation > _ROUND_OFF:
            return linear._replace(is_exact=False)
    return linear
