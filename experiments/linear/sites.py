"""Cranes of the size of those on building sites, and the moves that they make at full speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.planning.joystick import JoystickPulse, joystick
from cranedyn.references import shortest, spline
from experiments.harness import Setup

POINT = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}
"""A point load on a massless rope without friction."""

RAMPS = (5.0, 4.0)
"""Time in which slew and trolley reach their speed [s]; ours."""

HOISTING = 0.4
"""Acceleration of the hoist [m/s²]; ours."""

QUARTER = math.pi / 2.0
"""How far every slew goes [rad]."""


@dataclass(frozen=True)
class SiteCrane:
    """A crane with its speeds.

    Attributes:
        name: What it is called.
        jib: Largest trolley radius [m].
        height: Of the hook at most, taken as the longest cable [m].
        trolley: Speed of the trolley [m/s].
        slew: Slew rate [rad/s].
        hoist: Speed of the hoist with a heavy load and with a light one [m/s].
    """

    name: str
    jib: float
    height: float
    trolley: float
    slew: float
    hoist: tuple[float, float]

    def crane(self, setup: Setup, **values: float) -> Crane:
        """Return the crane, by default with a point load; its mast is high enough for the
        drawing.
        """
        mast = {
            "mast_height": self.height + 2.0,
            "pivot_height": self.height + 4.0,
            "total_height": self.height + 10.0,
        }
        strategies = {"trolley_max": self.jib, "hoist_max": self.height, "hoist_min": 1.0}
        return setup.variant(**{**POINT, **mast, **strategies, **values})

    @property
    def accelerations(self) -> tuple[float, float, float]:
        """Of slew [rad/s²], trolley and hoist [m/s²]."""
        return self.slew / RAMPS[0], self.trolley / RAMPS[1], HOISTING


_HOIST = (17.0 / 60.0, 134.0 / 60.0)


def _site(name: str, jib: float, height: float, trolley: float, slew: float) -> SiteCrane:
    return SiteCrane(name, jib, height, trolley / 60.0, slew * math.pi / 30.0, _HOIST)


SITES = (
    SiteCrane("article's crane", 22.0, 26.4, 0.8, 0.08, (17.0 / 60.0, 0.8)),
    _site("71 EC-B 5", 50.0, 45.0, 63.0, 0.8),
    _site("380 EC-B 16", 75.0, 83.0, 95.0, 0.8),
    _site("L1-24", 25.0, 19.0, 22.0, 0.5),
)
"""The article's crane with the speeds of the demo, and three of a maker's list: jib [m], hook
height [m], trolley [m/min], slew [1/min].

Their hoists run at 17 to 134 m/min, the slower the heavier the load.
"""


@dataclass(frozen=True, eq=False)
class Job:
    """A move that begins with the load hanging at rest.

    Attributes:
        name: What it is called.
        start: Where it begins.
        reference: The way of the drives.
        arrival: When they stand still again [s].
    """

    name: str
    start: State
    reference: Reference
    arrival: float


def jobs(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return the moves: single drives, in splines and at constant speed between ramps, then pairs,
    then all.
    """
    middle, tip, high, deep = (
        0.5 * site.jib,
        0.9 * site.jib,
        2.0 / 3.0 * site.height,
        0.9 * site.height,
    )
    outward, slew = (
        JoystickPulse("x", site.trolley, 0.0, 0.4 * site.jib / site.trolley),
        JoystickPulse("gamma", site.slew, 0.0, QUARTER / site.slew),
    )
    slow, fast = (
        JoystickPulse("l", -speed, 0.0, share_of_height * site.height / speed)
        for speed, share_of_height in zip(site.hoist, (0.3, 0.6), strict=True)
    )
    inside, outside, below = (
        crane.state(x=x, l=cable) for x, cable in ((middle, high), (tip, high), (middle, deep))
    )
    return [
        _splined("trolley, spline", site, crane, inside, (0.0, tip, high)),
        _joystick_job("trolley", site, crane, inside, outward),
        _splined("slew, spline", site, crane, outside, (QUARTER, tip, high)),
        _joystick_job("slew", site, crane, outside, slew),
        _joystick_job("slew, trolley", site, crane, inside, slew, outward),
        _joystick_job("trolley, slow hoist", site, crane, below, outward, slow),
        _joystick_job("trolley, fast hoist", site, crane, below, outward, fast),
        _joystick_job("slew, trolley, fast hoist", site, crane, below, slew, outward, fast),
    ]


SHARES, HOLD = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32), 30.0
"""Shares of its slew rate that a crane turns at, and how long the joystick is held [s]."""

ANGLES = (1.0, 2.0, 5.0, 10.0, 20.0)
"""Short slews [°]."""


def slow_slews(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return slews at shares of the crane's rate, reached in the usual time."""
    slew, *accelerations = site.accelerations
    return [
        _moved(
            f"slew at {share:g} of the rate",
            crane,
            _outside(site, crane),
            (share * slew, *accelerations),
            JoystickPulse("gamma", share * site.slew, 0.0, HOLD),
        )
        for share in SHARES
    ]


def short_slews(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return slews by small angles at the usual acceleration, most of which never reach the
    rate.
    """
    holds = [
        max(math.sqrt(a / site.accelerations[0]), a / site.slew) for a in map(math.radians, ANGLES)
    ]
    return [
        _joystick_job(
            f"slew of {angle:g}°",
            site,
            crane,
            _outside(site, crane),
            JoystickPulse("gamma", site.slew, 0.0, hold),
        )
        for angle, hold in zip(ANGLES, holds, strict=True)
    ]


def _outside(site: SiteCrane, crane: Crane) -> State:
    return crane.state(x=0.9 * site.jib, l=2.0 / 3.0 * site.height)


def _splined(name: str, site: SiteCrane, crane: Crane, start: State, goal: Sequence[float]) -> Job:
    (duration,) = shortest(
        crane,
        start,
        [goal],
        rates=(site.slew, site.trolley, site.hoist[1]),
        accelerations=site.accelerations,
    )
    return Job(name, start, spline(crane, start, [goal], [duration]), duration)


def _joystick_job(
    name: str, site: SiteCrane, crane: Crane, start: State, *pulses: JoystickPulse
) -> Job:
    return _moved(name, crane, start, site.accelerations, *pulses)


def _moved(
    name: str, crane: Crane, start: State, accelerations: Sequence[float], *pulses: JoystickPulse
) -> Job:
    limits = dict(zip(("gamma", "x", "l"), accelerations, strict=True))
    arrival = max(pulse.at + pulse.hold + abs(pulse.rate) / limits[pulse.drive] for pulse in pulses)
    return Job(name, start, joystick(crane, start, pulses, accelerations=accelerations), arrival)
