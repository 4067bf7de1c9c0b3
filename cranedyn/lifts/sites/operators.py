"""Operators who lift loads on a site with several cranes, and what their cranes reach.

They stand for the people in the cabins of a simulated site: each lifts loads between random places
that the crane reaches, and follows a load that swings.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from cranedyn.errors import CraneError, quoted
from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.distance_proof import least_distances
from cranedyn.lifts.sites.guard import gentle
from cranedyn.lifts.sites.lift_list import HOOKING_TIME
from cranedyn.lifts.sites.placed_capsules import place_capsules
from cranedyn.lifts.sites.plan import leaves_room

DAMPING_RATIO = 0.05
"""Damping ratio of the swing that an operator adds by following the load."""

CARRYING_CLEARANCE = 1.0
"""Cable length beyond the shortest while a load is carried [m]: it passes over lower jibs."""

PLACING_RATIO = 0.8
"""Cable length over the longest where a load is put."""

ARRIVAL_TOLERANCE = {"rad": 4e-3, "m": 0.1}
"""Distance from its goal at which a drive has arrived, by the unit of the drive."""

RERAISE_FACTOR = 10.0
"""Distance in arrival tolerances beside its goal from which on a load is raised before it goes
back: it was moved away by the supervisor while it was lowered."""

EDGE_RATIO = 0.05
"""Share of the range of each drive, at both of its ends, in which no lift begins or ends."""

OPERATOR_RAMP_RATIO = 0.75
"""Acceleration by which an operator changes rates, over the deceleration that the guard plans with.

Rates that follow the load come on top.
"""

OPERATOR_RATE_RATIO = 0.9
"""Largest rate that an operator commands, over that of the drive; following comes on top."""

STANDSTILL_RATIO = 0.02
"""Rate below which a drive stands, over its largest."""

# All four are chosen: an operator who brakes late enough not to waste time, and early enough not to
# pass the goal.
STOPPING_RATIO = 0.8
"""Deceleration with which an operator means to stop at a goal, over the acceleration of the
ramp."""

STOPPING_LEAD = 0.5
"""Time by which an operator is late to see how far it still is [s]."""

CREEP_GAIN = 0.15
"""Rate over the distance with which a drive creeps to its goal [1/s]."""

CREEP_RANGE = 4.0
"""Distance from the goal within which a drive creeps, in arrival tolerances."""

RECOVERY_TIME = 2.0
"""Time in which a drive can reach the rates from which an operator goes on [s]."""

TOWER_CLEARANCE_RATIO = 1.5
"""Distance that a crane keeps from the towers of others while it lifts, over the required one."""


@dataclass
class LiftOperator:
    """A person who lifts loads from place to place, and follows a load that swings.

    A lift goes to two places: where the load is hooked, and where it is put. To each place lead
    three *legs*: raise the hook, move over the place, lower. A leg is a position of the drives; NaN
    stands for a drive that may stay where it is.

    Attributes:
        site: The site.
        index: Index of the crane.
        seed: Seed of the places.
        zone: Box of positions outside of which it lifts nothing, shape (2, m); None for no zone.
        drawn: Number of lifts drawn so far, those included that would lead out of the zone.
        finished: Number of each lift that is done, counted from 1 as they are drawn.
    """

    site: CraneSite
    index: int
    seed: int
    zone: np.ndarray | None = None
    drawn: int = 0
    finished: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin with nothing to do.

        Raises:
            CraneError: If no place of a lift can lie in the zone.
        """
        self.station = self.site.stations[self.index]
        layout = self.station.crane.layout
        brakes = gentle(self.station, self.site.swing, self.site.working_wind)
        self.tolerances = np.array([ARRIVAL_TOLERANCE[joint.unit] for joint in layout.driven])
        self._rng = np.random.default_rng(self.seed)
        self._ramp = OPERATOR_RAMP_RATIO * brakes.decelerations
        self._check_zone()
        # Rates without those that follow the load.
        self._base_rates = np.zeros(layout.m)
        self._waits_until = 0.0
        self._legs: list[np.ndarray] = []

    def _check_zone(self) -> None:
        """Check that places of lifts can lie in the zone: otherwise they would be drawn for ever.

        Raises:
            CraneError: If none can.
        """
        if self.zone is None:
            return
        winch = self.station.crane.winch
        low, high = reach(self.site, self.index)
        edge = EDGE_RATIO * (high - low)
        lowest = low + edge
        highest = high - edge
        lowest[winch] = PLACING_RATIO * high[winch]
        highest[winch] = lowest[winch]
        for drive, joint in enumerate(self.station.crane.layout.driven):
            zone_low, zone_high = self.zone[:, drive].tolist()
            if not (lowest[drive] <= zone_high and zone_low <= highest[drive]):
                raise CraneError(
                    f"No place of a lift of {quoted(self.station.name)} lies in its zone: there "
                    f"{joint.symbol} is from {zone_low:.4g} to {zone_high:.4g} {joint.unit}, and "
                    f"places are from {lowest[drive]:.4g} to {highest[drive]:.4g} {joint.unit}."
                )

    def places(self) -> np.ndarray:
        """Return where the next lift begins and ends, shape (2, m).

        Places are drawn until one is found that leaves lower cranes room and lies in the zone.
        Those outside of the zone count as drawn: so the n-th lift is the same one in all shifts.
        """
        winch = self.station.crane.winch
        low, high = reach(self.site, self.index)
        edge = EDGE_RATIO * (high - low)
        while True:
            places = self._rng.uniform(low + edge, high - edge, (2, len(low)))
            places[:, winch] = PLACING_RATIO * high[winch]
            if not all(leaves_room(self.site, self.index, place) for place in places):
                continue
            self.drawn += 1
            if self.zone is None:
                return places
            if ((places >= self.zone[0]) & (places <= self.zone[1])).all():
                return places

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands [rad/s or m/s], shape (m,).

        Args:
            t: Time [s].
            states: State of each crane.
        """
        state = states[self.index]
        drives = self.station.crane.layout.drives
        position = state.q[drives]
        velocity = state.v[drives]
        at_rest = np.zeros_like(position)

        if not self._legs:
            for place in self.places():
                self._legs += self._legs_to(place)
        if t < self._waits_until:
            return self._follow_load(at_rest, state, velocity)

        if self._was_moved_away(position):
            self._legs[:1] = self._legs_to(self._legs[0])
        gap = np.where(np.isnan(self._legs[0]), 0.0, self._legs[0] - position)
        if self._has_arrived(gap):
            self._finish_leg(t)
            return self._follow_load(at_rest, state, velocity)
        return self._follow_load(self._rates_over(gap), state, velocity)

    def _legs_to(self, place: np.ndarray) -> list[np.ndarray]:
        """Return the legs that bring a load to a place: up, over it, and down."""
        winch = self.station.crane.winch
        shortest, _ = reach(self.site, self.index)
        carrying_length = shortest[winch] + CARRYING_CLEARANCE
        up = np.full_like(place, np.nan)
        up[winch] = carrying_length
        over = place.copy()
        over[winch] = carrying_length
        return [up, over, place]

    def _was_moved_away(self, position: np.ndarray) -> bool:
        """Return whether the crane is beside the place while it lowers the load: the supervisor
        moved it to let another crane pass.
        """
        is_lowering = len(self._legs) % 3 == 1
        beside = np.abs(self._legs[0] - position) > RERAISE_FACTOR * self.tolerances
        beside[self.station.crane.winch] = False
        return bool(is_lowering and beside.any())

    def _has_arrived(self, gap: np.ndarray) -> bool:
        """Return whether all drives are at the end of the leg and are commanded to stand, but for
        what follows the load.
        """
        stands = np.abs(self._base_rates) < STANDSTILL_RATIO * self.station.converters.rates
        return bool(((np.abs(gap) < self.tolerances) & stands).all())

    def _finish_leg(self, t: float) -> None:
        """Go on to the next leg; at a place the load is hooked or unhooked first."""
        self._legs.pop(0)
        if len(self._legs) % 3 == 0:
            self._waits_until = t + HOOKING_TIME
        if not self._legs:
            self.finished.append(self.drawn)

    def _rates_over(self, gap: np.ndarray) -> np.ndarray:
        """Return rates from which the drives can stop over the gap to the end of the leg."""
        distance = np.abs(gap)
        # A drive at v that slows down by a stops over d with v² = 2 a d.
        remaining = np.maximum(distance - STOPPING_LEAD * np.abs(self._base_rates), 0.0)
        stopping = np.sqrt(2.0 * STOPPING_RATIO * self._ramp * remaining)
        # By these alone a drive would come to rest before it arrives: near the end it creeps.
        creeping = CREEP_GAIN * distance * (distance < CREEP_RANGE * self.tolerances)
        fastest = OPERATOR_RATE_RATIO * self.station.converters.rates
        return np.sign(gap) * np.minimum(stopping + creeping, fastest)

    def _follow_load(self, wanted: np.ndarray, state: State, velocity: np.ndarray) -> np.ndarray:
        """Return the wanted rates, changed by no more than the ramp in a cycle, and with those that
        move the pivot towards the load.
        """
        # A guard may hold the drives back. Then the operator goes on from rates that they can reach
        # soon.
        margin = RECOVERY_TIME * self._ramp
        reachable = np.clip(self._base_rates, velocity - margin, velocity + margin)
        step = self._ramp * CYCLE
        self._base_rates = np.clip(wanted, reachable - step, reachable + step)

        # A pivot that follows the load at 2 ζ ω times its distance in plan damps the swing with the
        # ratio ζ. The distance is l times the inclination of the rope, and ω l = √(g l).
        crane = self.station.crane
        cable = abs(float(state.q[crane.layout.drives[crane.winch]]))
        rope = self.station.rope(state.q[None])
        inclination = rope.direction[0, :2]
        pivot_velocity = 2.0 * DAMPING_RATIO * math.sqrt(crane.gravity * cable) * inclination
        # Of all rates that move the pivot so the pseudoinverse gives the smallest; the winch does
        # not move it.
        drive_rates = pivot_velocity @ np.linalg.pinv(rope.motion[0, :, :2], rcond=1e-3)
        return self._base_rates + drive_rates


@cache
def reach(site: CraneSite, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what the drives of a crane can reach without touching the tower of another crane.

    Args:
        site: The site.
        index: Index of the crane.

    Returns:
        Lower and upper ends of the intervals of the drives [rad or m], shape (m,) each. The slew
        goes from zero at most half around to either side. An end of it is the first whole degree at
        which the crane would be nearer to a tower than `TOWER_CLEARANCE_RATIO` times the required
        distance; `EDGE_RATIO` keeps lifts away from there.
    """
    station = site.stations[index]
    layout = station.crane.layout
    slew = layout.drive_of("slew")
    low = station.crane.lower[layout.drives].copy()
    high = station.crane.upper[layout.drives].copy()
    if slew is None:
        return low, high
    low[slew] = max(low[slew], -math.pi)
    high[slew] = min(high[slew], math.pi)

    for ends, sign in ((low, -1.0), (high, 1.0)):
        angles = np.arange(0.0, sign * ends[slew], math.radians(1.0)) * sign
        for angle in angles:
            if not _passes_towers(site, index, angle, (low, high)):
                ends[slew] = angle
                break
    return low, high


def _passes_towers(
    site: CraneSite, index: int, angle: float, ends: tuple[np.ndarray, np.ndarray]
) -> bool:
    """Return whether a crane keeps `TOWER_CLEARANCE_RATIO` times the required distance from the
    towers of all others.

    Args:
        site: The site.
        index: Index of the crane.
        angle: Its slew angle [rad].
        ends: Lower and upper ends of its drives, shape (m,) each; its other drives are tried at
            both.
    """
    bodies = site.bodies
    slew = site.stations[index].crane.layout.drive_of("slew")
    moves_with_crane = ~bodies.hangs[index] & (bodies.joint[index] > 0)
    my_capsules = np.nonzero(moves_with_crane)[0]
    cranes = range(len(site.stations))
    is_other = np.array([i != index and not site.share_runway(index, i) for i in cranes])
    towers = np.argwhere((bodies.joint == 0) & is_other[:, None])
    if not len(towers) or not len(my_capsules):
        return True
    pairs = np.array(list(itertools.product(my_capsules, range(len(towers)))))

    for other_drives in ends:
        position = other_drives.copy()
        position[slew] = angle
        places = np.repeat(site.positions(index, position)[None], len(pairs), axis=0)
        crane = np.full(len(pairs), index)
        tower = towers[pairs[:, 1]]
        moving = place_capsules(bodies, crane, pairs[:, 0], places, places, site.swing)
        still = place_capsules(bodies, tower[:, 0], tower[:, 1], 0 * places, 0 * places, 0.0)
        # `not >=` is true for NaN as well.
        if not least_distances(moving, still).min() >= TOWER_CLEARANCE_RATIO * site.distance:
            return False
    return True
