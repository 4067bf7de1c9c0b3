"""Wind and other external forces on the points of a crane: for a tower crane the payload and the
trolley.

A wind speed is a callable from time [s] to [m/s]; `wind` converts it to forces for
`cranedyn.simulation.simulate.simulate`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.clocks import intervals
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.equations_of_motion import point_positions, point_velocities
from cranedyn.dynamics.scalars import square_root
from cranedyn.errors import UnknownName
from cranedyn.interfaces import Disturbance, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import interpolate, locate

AIR_DENSITY = 1.25
"""Density of air in the wind pressure of standards [kg/m³]: q = 0.625 v² (AS 5222:2021, a modified
ISO 4302; second hand). The standard atmosphere at sea level has 1.225 (ISO 2533).
"""

Speed = Callable[[float], float]
"""Wind speed [m/s] over time [s]."""


def drag_force(area: Any, relative_velocity: np.ndarray) -> np.ndarray:
    """Return the drag of air on bodies [N]: ½ ρ A |w| w, with ρ = `AIR_DENSITY`.

    The numbers may be of any kind, see `cranedyn.dynamics.scalars`.

    Args:
        area: Drag coefficient times area of each body [m²], a number or shape (...).
        relative_velocity: Velocity of the air less that of the body [m/s], shape (..., k).

    Returns:
        The forces in the axes of the velocity, shape (..., k).
    """
    # The first axis of the transpose runs over the components. `np.linalg.norm` knows floats only.
    squares = sum(component * component for component in relative_velocity.T)
    speed = np.asarray(square_root(squares)).T
    pressure = 0.5 * AIR_DENSITY * np.asarray(area)[..., None]
    return pressure * speed[..., None] * relative_velocity


def constant_force(crane: Crane, *, at: float = 0.0, **forces: Sequence[float]) -> Disturbance:
    """Return constant forces on points of a crane in the world [N] from a time on [s].

    A horizontal force F on a payload of weight m g moves its rest to atan(F/(m g)); applied at once
    it swings the payload to nearly twice that.

    Args:
        crane: Crane.
        at: Start of the forces [s].
        forces: Force by the name of the point, for example ``payload=(100.0, 0.0, 0.0)``; see
            `cranedyn.model.layout.Layout.points`.

    Raises:
        UnknownName: If there is no such point.
        OutOfRange: If a number is not finite, or a force has not three components.
    """
    values = np.zeros((len(crane.points), 3))
    for name, force in forces.items():
        if name not in crane.layout.points:
            raise UnknownName("point", name, crane.layout.points)
        values[crane.layout.points.index(name)] = finite(
            f"force on the {name}", force, (3,), unit="N"
        )
    first = number("start of the force", at, "s")
    no_forces = np.zeros_like(values)
    return lambda t, state: values if t >= first else no_forces


def steady(speed: float) -> Speed:
    """Return a constant wind [m/s]."""
    value = number("wind speed", speed, "m/s")
    return lambda t: value


def step_gust(base: Speed, rise: float, *, at: float) -> Speed:
    """Add a step of the wind.

    Args:
        base: Wind speed to which it is added.
        rise: Height of the step [m/s].
        at: Time of the step [s].
    """
    step = number("rise of the wind", rise, "m/s")
    first = number("start of the gust", at, "s")
    return lambda t: base(t) + (step if t >= first else 0.0)


def cosine_gust(base: Speed, rise: float, *, at: float, lasts: float) -> Speed:
    """Add a discrete gust of the shape (1 - cos)/2.

    Args:
        base: Wind speed to which it is added.
        rise: Largest rise of the gust, half-way through it [m/s].
        at: Time at which it begins [s].
        lasts: Its duration [s].
    """
    largest = number("rise of the wind", rise, "m/s")
    first = number("start of the gust", at, "s")
    span = number("duration of the gust", lasts, "s", "> 0")

    def gusty(t: float) -> float:
        gust = 0.0
        if first <= t <= first + span:
            gust = largest * (1.0 - math.cos(2.0 * math.pi * (t - first) / span)) / 2.0
        return base(t) + gust

    return gusty


def gust_shape(t: np.ndarray, at: float | np.ndarray, lasts: float | np.ndarray) -> np.ndarray:
    """Return the share of its largest rise that a discrete gust has reached, see `cosine_gust`.

    Args:
        t: Times [s].
        at: Time at which each gust begins [s]; the arrays are broadcast against each other.
        lasts: Duration of each gust [s].
    """
    shape = (1.0 - np.cos(2.0 * math.pi * (t - at) / lasts)) / 2.0
    return np.where((at <= t) & (t <= at + lasts), shape, 0.0)


def turbulence(
    base: Speed,
    intensity: float,
    rng: np.random.Generator,
    *,
    duration: float,
    time_scale: float = 5.0,
    step: float = 0.05,
) -> Speed:
    """Add a first-order Gauss-Markov process, the longitudinal Dryden spectrum: σ² autocorrelated
    as exp(-|τ|/time scale).

    It is exact at the steps. Between them a straight line would have less than σ, so it is scaled
    to σ.

    Args:
        base: Mean wind.
        intensity: Standard deviation σ over the mean wind at the start.
        rng: Random generator; the same seed gives the same wind.
        duration: Duration [s], after which the last value stays.
        time_scale: Integral time scale [s].
        step: Time between values [s].

    Raises:
        OutOfRange: If a number is not positive.
    """
    relative = number("turbulence intensity", intensity, "", ">= 0")
    sigma = relative * abs(number("wind speed", base(0.0), "m/s"))
    # Checks the numbers; the last step may end after the duration.
    intervals("duration of the turbulence", duration, step)
    count = math.ceil(duration / step) + 1
    # Correlation of a value with the next: exp(-step/time scale).
    correlation = math.exp(-step / number("time scale of the turbulence", time_scale, "s", "> 0"))
    noise = rng.standard_normal(count) * sigma
    # Each value has the variance c² σ² + (1 - c²) σ² = σ², with c the correlation.
    values = [noise[0]]
    for kick in noise[1:]:
        values.append(correlation * values[-1] + math.sqrt(1.0 - correlation**2) * kick)
    gusts = np.array(values)

    def gust(t: float) -> float:
        row, share = locate(t, step, count)
        # The line a + s (b - a) between two values with E[ab] = c σ² has the variance
        # ((1 - s)² + s² + 2 s (1 - s) c) σ² = (1 - lost) σ².
        lost = 2.0 * share * (1.0 - share) * (1.0 - correlation)
        return float(interpolate(gusts, row, share)) / math.sqrt(1.0 - lost)

    return lambda t: base(t) + gust(t)


@dataclass(frozen=True, eq=False)
class Wind:
    """Drag of a horizontal wind on points of a crane, see `wind`.

    Attributes:
        crane: Crane.
        speed: Wind speed over time.
        along: Unit vector in which it blows, in the world, shape (3,).
        areas: Drag coefficient times area of each point [m²], shape (points,).
        base: Motion of the base on which the crane stands; None for a crane that stands in the
            world. A run on a moving base sets it.
    """

    crane: Crane
    speed: Speed
    along: np.ndarray
    areas: np.ndarray
    base: BaseMotion | None = None

    def __call__(self, t: float, state: State) -> np.ndarray:
        """Return the forces in the world [N], shape (points, 3)."""
        point_velocity = point_velocities(self.crane, state)
        if self.base is not None:
            position = point_positions(self.crane, state.q)
            point_velocity = self.base.world_velocities(t, position, point_velocity)
        return drag_force(self.areas, self.speed(t) * self.along - point_velocity)


def wind(crane: Crane, speed: Speed, *, direction: float, **areas: float) -> Wind:
    """Return the drag of a horizontal wind on points of a crane: ½ ρ A |w - v| (w - v), relative to
    their own velocity v.

    Args:
        crane: Crane.
        speed: Wind speed over time.
        direction: Direction in which it blows, angle from the world's +X towards +Y [rad]; -π/2 is
            along the jib at zero slew.
        areas: Drag coefficient times area [m²] by the name of the point with the ending "_area",
            for example ``payload_area=4.0``.

    Raises:
        UnknownName: If there is no such point.
        OutOfRange: If a number is not finite or an area is negative.
    """
    angle = number("direction of the wind", direction, "rad")
    along = np.array([math.cos(angle), math.sin(angle), 0.0])
    points = crane.layout.points
    names = [f"{point}_area" for point in points]
    drag_areas = np.zeros(len(crane.points))
    for name, area in areas.items():
        if name not in names:
            raise UnknownName("drag area", name, names)
        point = name.removesuffix("_area")
        drag_areas[names.index(name)] = number(f"drag area of the {point}", area, "m²", ">= 0")
    return Wind(crane, speed, along, drag_areas)
