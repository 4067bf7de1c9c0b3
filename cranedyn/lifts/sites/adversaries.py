"""Adversaries who try to make the cranes of a site collide, over a network that loses messages.

They look for a contact that the supervisor of the site does not prevent, by pushes at random, by
pushes towards the nearest load, and by a random search for the pushes that bring cranes nearest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import pdtri

from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.site_simulation import MessageChannel, SiteExtremes, simulate_copies

CHANNEL = MessageChannel(0.2, 0.3)
"""Network of the adversaries: latency [s], and share of the messages that it loses."""

PUSH_PERIOD = 10.0
"""Time for which an adversary pushes each drive at one rate [s]."""

PUSHES = 12
"""Number of pushes of an adversary before they repeat."""

LOOK_PERIOD = 0.5
"""Time after which a greedy adversary looks again where the other loads are [s]."""

GREEDY_RATIO = 0.8
"""Share of the pushes of greedy adversaries that go towards the nearest load."""

MUTATION_RATIO = 0.2
"""Share of the pushes that the search of optimised adversaries draws anew."""

ATTACK_KINDS = ("random", "greedy", "optimised")
"""Kinds of adversaries, see `attacks_on`."""

MAX_COPIES = 300
"""Largest number of copies of a site that run in lockstep with adversaries of one kind."""


@dataclass
class Adversary:
    """Operators of a crane on N copies of a site who try to collide.

    Each pushes every drive at a rate for `PUSH_PERIOD`, then at another one.

    Attributes:
        site: The site.
        index: Index of the crane.
        pushes: Rates over the largest ones, shape (N, `PUSHES`, m). NaN stands for a greedy push:
            it slews towards the nearest load of another crane, and takes the own load to its
            radius.
    """

    site: CraneSite
    index: int
    pushes: np.ndarray

    def __post_init__(self) -> None:
        """Begin without having looked where the other loads are."""
        self._looks_at = np.zeros(len(self.pushes))
        self._greedy_signs = 0.0 * self.pushes[:, 0]

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates [rad/s or m/s], shape (N, m).

        Args:
            t: Time [s].
            states: State of each crane, on all copies.
        """
        push = self.pushes[:, int(t / PUSH_PERIOD) % PUSHES]
        is_greedy = np.isnan(push)
        looking = np.flatnonzero(is_greedy.any(axis=1) & (t >= self._looks_at))
        if len(looking):
            seen = [State(q[looking], v[looking]) for q, v in states]
            self._greedy_signs[looking] = self._towards_nearest(seen)
            self._looks_at[looking] = t + LOOK_PERIOD
        shares = np.where(is_greedy, self._greedy_signs, push)
        return shares * self.site.stations[self.index].converters.rates

    def _towards_nearest(self, states: Sequence[State]) -> np.ndarray:
        """Return the sign of the rate of each drive that moves the pivot, in plan, towards the
        nearest pivot of another crane, shape (N, m).
        """
        ropes = []
        for station, state in zip(self.site.stations, states, strict=True):
            ropes.append(station.rope(state.q))
        mine = ropes.pop(self.index)
        if not ropes:
            # There is no other crane to push towards.
            return np.zeros(mine.motion.shape[:2])
        offsets = np.array([other.pivot[:, :2] - mine.pivot[:, :2] for other in ropes])
        nearest = np.argmin((offsets * offsets).sum(axis=2), axis=0)
        offset = offsets[nearest, np.arange(len(mine.pivot))]
        return np.sign((mine.motion[:, :, :2] * offset[:, None]).sum(axis=2))


class Attack(NamedTuple):
    """Runs of adversaries on a site.

    Attributes:
        site: Name of the site.
        kind: Kind of the adversaries, one of `ATTACK_KINDS`, or the protection of a shift.
        crane_minutes: Time of all cranes together [min].
        contacts: Number of contacts.
        least: Least distance less the required one [m].
        swing: Largest swing over the largest that is allowed.
        outside: Largest distance by which a drive left its box [rad or m]; negative inside.
    """

    site: str
    kind: str
    crane_minutes: float
    contacts: int
    least: float
    swing: float
    outside: float

    @classmethod
    def of(cls, site: CraneSite, kind: str, duration: float, run: SiteExtremes) -> Attack:
        """Return the result of copies of a site.

        Args:
            site: The site.
            kind: Kind of the adversaries.
            duration: Time from the first to the last row of each copy [s].
            run: Extremes of the copies.
        """
        return cls(
            site=site.name,
            kind=kind,
            crane_minutes=len(site.stations) * len(run.least) * duration / 60.0,
            contacts=int(run.contacts.sum()),
            least=float(run.least.min()) - site.distance,
            swing=float(run.swing.max()) / site.swing,
            outside=float(run.outside.max()),
        )

    @property
    def most_contacts(self) -> float:
        """Upper bound of the number of contacts in 10⁶ crane-minutes, at 95 %.

        It is the rate of a Poisson process that gives no more contacts than were counted with a
        probability of 5 %.
        """
        return float(1e6 * pdtri(self.contacts, 0.05) / self.crane_minutes)

    @classmethod
    def all_of(cls, runs: Sequence[Attack]) -> Attack:
        """Return several runs as one, with the site and the kind of the first."""
        return cls(
            site=runs[0].site,
            kind=runs[0].kind,
            crane_minutes=sum(run.crane_minutes for run in runs),
            contacts=sum(run.contacts for run in runs),
            least=min(run.least for run in runs),
            swing=max(run.swing for run in runs),
            outside=max(run.outside for run in runs),
        )


def attacks_on(site: CraneSite, duration: float, seed: Sequence[int]) -> list[Attack]:
    """Return attacks on a site by each kind of adversaries, for a third of a duration each.

    Random adversaries push at one of three rates: the largest to either side, or none. Greedy ones
    push towards the nearest load most of the time. Optimised ones come from a random search: in
    each round the quarter of the copies in which cranes came nearest is kept, and copies of them
    are tried again of which some pushes are drawn anew.

    Args:
        site: The site.
        duration: Time of all copies together [s].
        seed: Seed of the pushes and of the network.
    """
    rng = np.random.default_rng(seed)
    run_time = PUSH_PERIOD * PUSHES
    run_count = max(1, round(duration / 3.0 / run_time))
    rounds = math.ceil(run_count / MAX_COPIES)
    copies = math.ceil(run_count / rounds)
    shapes = [(copies, PUSHES, station.crane.layout.m) for station in site.stations]

    def redrawn(ratio: float, pushes: Sequence[np.ndarray | float]) -> list[np.ndarray]:
        """Return the pushes of each crane, of which a share is replaced by random ones."""
        result = []
        for shape, mine in zip(shapes, pushes, strict=True):
            is_replaced = rng.random(shape) < ratio
            result.append(np.where(is_replaced, rng.integers(-1, 2, shape), mine))
        return result

    all_greedy = [math.nan] * len(shapes)
    best = redrawn(1.0, [0.0] * len(shapes))
    least_of_best = np.full(copies, math.inf)
    attacks: list[Attack] = []
    for _ in range(rounds):
        # All kinds run in lockstep, as three groups of copies in the order of `ATTACK_KINDS`.
        trial = redrawn(MUTATION_RATIO, best)
        random = redrawn(1.0, best)
        greedy = redrawn(1.0 - GREEDY_RATIO, all_greedy)
        adversaries = []
        for i, groups in enumerate(zip(random, greedy, trial, strict=True)):
            adversaries.append(Adversary(site, i, np.concatenate(groups)))
        run = simulate_copies(
            site,
            adversaries,
            copies=3 * copies,
            duration=run_time,
            channel=CHANNEL,
            seed=int(rng.integers(2**32)),
        )
        for k, kind in enumerate(ATTACK_KINDS):
            group = slice(k * copies, (k + 1) * copies)
            extremes = SiteExtremes(
                run.contacts[group], run.least[group], run.swing[group], run.outside[group]
            )
            # The rows are a cycle apart, and the last one stands a cycle before the end.
            attacks.append(Attack.of(site, kind, run_time - CYCLE, extremes))

        least = np.concatenate([least_of_best, run.least[-copies:]])
        nearest_quarter = np.argsort(least, kind="stable")[: math.ceil(copies / 4)]
        kept = np.resize(nearest_quarter, copies)
        best = [np.concatenate([old, tried])[kept] for old, tried in zip(best, trial, strict=True)]
        least_of_best = least[kept]
    return attacks
