"""Joints that follow others: the sections of a telescope, the fingers of a grapple.

The URDF says so by ``<mimic joint="…" multiplier="r" offset="c"/>``: the coordinate of the follower
is r times that of its leader plus c. All coordinates of a crane, those of followers among them, are

    q = G q + c,   v = G v,   a = G a,

where the column of a follower in G is zero, and its row holds r at its leader: G projects on the
motions that are possible, G G = G. What moves a leader moves its followers too, so that its
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
        leader: Name of the joint that it follows, which itself follows no joint.
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
        """Return how a joint follows its leader, such as "= -2 leg + 0.1"."""
        place = self.followers.index(follower)
        ratio, offset = self.ratios[place], self.offsets[place]
        times = "" if ratio == 1.0 else f"{ratio:.4g} "
        shift = f" {'+' if offset > 0.0 else '-'} {abs(offset):.4g}" if offset else ""
        return f"= {times}{leader}{shift}"

    def complete(self, q: np.ndarray) -> np.ndarray:
        """Return coordinates in which the followers are where their leaders put them; shape (n,),
        or (..., n) for rows of them.
        """
        completed = q.copy()
        rows = zip(self.followers, self.leaders, self.ratios, self.offsets, strict=True)
        for follower, leader, ratio, offset in rows:
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
    to the joint that moves by itself.

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
    resolved = dict[str, Mimic]()
    for name, mimic in direct.items():
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
        len(names),
        tuple(names.index(name) for name in followers),
        tuple(names.index(mimics[name].leader) for name in followers),
        tuple(mimics[name].ratio for name in followers),
        tuple(mimics[name].offset for name in followers),
    )


def limit_leaders(
    coupling: Coupling, lower: np.ndarray, upper: np.ndarray, names: Sequence[str]
) -> list[str]:
    """Narrow the range of each leader so that its followers stay in theirs, in place; return a note
    on each range that was narrowed.

    Raises:
        ModelError: If a leader has no range left.
    """
    notes = []
    rows = zip(coupling.followers, coupling.leaders, coupling.ratios, coupling.offsets, strict=True)
    for follower, leader, ratio, offset in rows:
        if ratio == 0.0:
            continue
        ends = sorted((end - offset) / ratio for end in (lower[follower], upper[follower]))
        low, high = max(lower[leader], ends[0]), min(upper[leader], ends[1])
        if low > high:
            raise ModelError(
                f"{names[follower]} follows {names[leader]}, and is beyond its range wherever that "
                "one is; correct the ranges, or multiplier and offset of <mimic>."
            )
        if (low, high) != (lower[leader], upper[leader]):
            lower[leader], upper[leader] = low, high
            notes.append(
                f"{names[leader]} moves from {low:.6g} to {high:.6g}, where {names[follower]}, "
                "which follows it, stays in its range."
            )
    return notes
