"""Joints that follow others: the sections of a telescope, the fingers of a grapple.

A URDF states this by ``<mimic joint="…" multiplier="r" offset="c"/>``: the coordinate of the
follower is r times that of its leader plus c. All coordinates of a crane, those of followers among
them, are

    q = G q + c,   v = G v,   a = G a,

where the vector c holds the offsets of the followers, and 0 elsewhere. The column of a follower in
G is zero, and its row holds r at its leader: G projects on the motions that are possible,
G G = G. What moves a leader moves its followers too, so that its
generalized force and inertia are those of the reduced coordinates, Gᵀ τ and Gᵀ M G.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), §3.2, on explicit constraints.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.errors import ModelError


class Mimic(NamedTuple):
    """How a joint follows another one.

    Attributes:
        leader: Name of the joint that it follows; after `read_mimics` one that follows no other.
        ratio: Its rate over that of the leader.
        offset: Its coordinate where that of the leader is zero [rad or m].
    """

    leader: str
    ratio: float
    offset: float


@dataclass(frozen=True)
class Coupling:
    """Followers among the n joints of a crane.

    Attributes:
        n: Number of coordinates.
        followers: Indices of the followers among the coordinates.
        leaders: Indices of their leaders.
        ratios: Their rates over those of their leaders.
        offsets: Their coordinates where those of their leaders are zero [rad or m].
    """

    n: int
    followers: tuple[int, ...]
    leaders: tuple[int, ...]
    ratios: tuple[float, ...]
    offsets: tuple[float, ...]

    @cached_property
    def matrix(self) -> np.ndarray:
        """The matrix G, shape (n, n)."""
        matrix = np.eye(self.n)
        for follower, leader, ratio in zip(self.followers, self.leaders, self.ratios, strict=True):
            matrix[follower, follower] = 0.0
            matrix[follower, leader] = ratio
        return matrix

    def formula(self, follower: int, leader: str) -> str:
        """Return how a joint follows its leader, such as "= -2 leg + 0.1".

        Args:
            follower: Index of the follower among the coordinates.
            leader: Name of its leader.
        """
        place = self.followers.index(follower)
        ratio = self.ratios[place]
        offset = self.offsets[place]
        text = f"= {leader}" if ratio == 1.0 else f"= {ratio:.4g} {leader}"
        if offset:
            text += f" {'+' if offset > 0.0 else '-'} {abs(offset):.4g}"
        return text

    def complete(self, q: np.ndarray) -> np.ndarray:
        """Return coordinates in which the followers are where their leaders put them; shape (n,),
        or (..., n) for rows of them.
        """
        completed = q.copy()
        for place, follower in enumerate(self.followers):
            leader = self.leaders[place]
            ratio = self.ratios[place]
            offset = self.offsets[place]
            completed[..., follower] = ratio * q[..., leader] + offset
        return completed

    def spread(self, v: np.ndarray) -> np.ndarray:
        """Return rates or accelerations G v, shape (n,), in which the followers move with their
        leaders; of floats or of symbols.
        """
        spread = v.copy()
        for follower, leader, ratio in zip(self.followers, self.leaders, self.ratios, strict=True):
            spread[follower] = v[leader] * ratio
        return spread

    def gather(self, forces: np.ndarray) -> np.ndarray:
        """Return generalized forces Gᵀ τ, shape (n,), in which the leaders carry what acts on their
        followers, and the followers nothing; of floats or of symbols.
        """
        gathered = forces.copy()
        for follower, leader, ratio in zip(self.followers, self.leaders, self.ratios, strict=True):
            gathered[leader] = gathered[leader] + forces[follower] * ratio
            gathered[follower] = 0.0
        return gathered

    def reduce(self, mass: np.ndarray) -> np.ndarray:
        """Return Gᵀ M G of a symmetric matrix, shape (n, n), with 1 on the diagonal of followers,
        so that it can be solved; of floats or of symbols.
        """
        reduced = mass.copy()
        # M G adds the column of a follower to that of its leader, and clears it; Gᵀ (M G) does so
        # with the rows.
        for follower, leader, ratio in zip(self.followers, self.leaders, self.ratios, strict=True):
            reduced[:, leader] = reduced[:, leader] + reduced[:, follower] * ratio
            reduced[leader, :] = reduced[leader, :] + reduced[follower, :] * ratio
            reduced[:, follower] = 0.0
            reduced[follower, :] = 0.0
        for follower in self.followers:
            reduced[follower, follower] = 1.0
        return reduced


def read_mimics(robot: ET.Element, moving: Sequence[str]) -> dict[str, Mimic]:
    """Return how joints of a checked URDF follow others, by name. A chain of followers is resolved
    to the joint at its head, which follows no other.

    Args:
        robot: The URDF.
        moving: Names of the joints that move.
    """
    direct: dict[str, Mimic] = {}
    for joint in robot.iterfind("joint"):
        element = joint.find("mimic")
        name = joint.get("name", "")
        if element is not None and name in moving:
            direct[name] = Mimic(
                element.get("joint", ""),
                float(element.get("multiplier", "1")),
                float(element.get("offset", "0")),
            )
    resolved: dict[str, Mimic] = {}
    for name, mimic in direct.items():
        # With q = r q' + c and q' = r' q" + c':  q = (r r') q" + (r c' + c).
        while mimic.leader in direct:
            above = direct[mimic.leader]
            ratio = mimic.ratio * above.ratio
            offset = mimic.ratio * above.offset + mimic.offset
            mimic = Mimic(above.leader, ratio, offset)
        resolved[name] = mimic
    return resolved


def coupling_of(mimics: dict[str, Mimic], names: Sequence[str]) -> Coupling | None:
    """Return the coupling of joints by their names in the order of the coordinates; None if no
    joint follows another.
    """
    if not mimics:
        return None
    followers = [name for name in names if name in mimics]
    return Coupling(
        n=len(names),
        followers=tuple(names.index(name) for name in followers),
        leaders=tuple(names.index(mimics[name].leader) for name in followers),
        ratios=tuple(mimics[name].ratio for name in followers),
        offsets=tuple(mimics[name].offset for name in followers),
    )


def limit_leaders(
    coupling: Coupling, lower: np.ndarray, upper: np.ndarray, names: Sequence[str]
) -> list[str]:
    """Narrow the range of each leader so that its followers stay in theirs, in place; return a note
    on each range that was narrowed.

    Raises:
        ModelError: If a leader has no range left in which it can move.
    """
    notes = []
    for place, follower in enumerate(coupling.followers):
        leader = coupling.leaders[place]
        ratio = coupling.ratios[place]
        offset = coupling.offsets[place]
        if ratio == 0.0:
            continue
        # The follower is at an end of its range where its leader is at (end - offset)/ratio. A
        # negative ratio swaps the ends.
        at_lower = (lower[follower] - offset) / ratio
        at_upper = (upper[follower] - offset) / ratio
        low = max(lower[leader], min(at_lower, at_upper))
        high = min(upper[leader], max(at_lower, at_upper))
        if low >= high:
            raise ModelError(
                f"{names[follower]} follows {names[leader]}, and is beyond its range wherever that "
                "one is, or in it at a single place; correct the ranges, or multiplier and offset "
                "of <mimic>."
            )
        if low != lower[leader] or high != upper[leader]:
            lower[leader] = low
            upper[leader] = high
            notes.append(
                f"{names[leader]} moves from {low:.6g} to {high:.6g}, where {names[follower]}, "
                "which follows it, stays in its range."
            )
    return notes
