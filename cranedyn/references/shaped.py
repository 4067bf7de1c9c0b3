"""Input shaping: the same command in two or three parts, timed so that the swings they cause
cancel.

Singer & Seering 1990 (ZV, ZVD); Singhose, Seering & Singer 1994 (EI).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import finite, number, within
from cranedyn.clocks import intervals
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import Tabulating, tabulated


@dataclass(frozen=True, eq=False)
class Shaper:
    """A train of impulses whose amplitudes add up to one.

    Attributes:
        fractions: Time of each impulse, in swing periods.
        amplitudes: Share of the command that each carries.
    """

    fractions: np.ndarray
    amplitudes: np.ndarray

    def __post_init__(self) -> None:
        """Check that there is an amplitude for each impulse."""
        fractions = finite("fractions of a shaper", self.fractions, ("n",), unit="periods")
        amplitudes = finite("amplitudes of a shaper", self.amplitudes, fractions.shape)
        object.__setattr__(self, "fractions", fractions)
        object.__setattr__(self, "amplitudes", amplitudes)

    def residual(self, ratio: float | np.ndarray) -> np.ndarray:
        """Return the swing that is left, as a share of that without shaping, when the true
        frequency is `ratio` times the one shaped for; undamped.
        """
        angles = 2.0 * math.pi * np.multiply.outer(np.asarray(ratio, dtype=float), self.fractions)
        return np.abs(np.exp(1.0j * angles) @ self.amplitudes)


def zv(damping_ratio: float = 0.0) -> Shaper:
    """Zero vibration: two impulses, half a period apart."""
    k = _decay(damping_ratio)
    return Shaper(np.array([0.0, 0.5]), np.array([1.0, k]) / (1.0 + k))


def zvd(damping_ratio: float = 0.0) -> Shaper:
    """Zero vibration and derivative: three impulses, insensitive to small errors of the
    frequency.
    """
    k = _decay(damping_ratio)
    return Shaper(np.array([0.0, 0.5, 1.0]), np.array([1.0, 2.0 * k, k * k]) / (1.0 + k) ** 2)


def ei(tolerance: float = 0.05) -> Shaper:
    """Extra insensitive: leaves a share of the swing at the frequency shaped for, to stay below it
    over a wider range; undamped.
    """
    v = number("tolerance", tolerance, "", "0 to 1")
    # At the frequency shaped for the middle impulse opposes the outer two: their difference is v.
    outer = (1.0 + v) / 4.0
    middle = (1.0 - v) / 2.0
    return Shaper(np.array([0.0, 0.5, 1.0]), np.array([outer, middle, outer]))


def _decay(damping_ratio: float) -> float:
    """Return what is left of a swing after half a period, exp(-π ζ / √(1 - ζ²))."""
    ratio = number("damping ratio", damping_ratio, "", "0 to 0.99")
    return math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio**2))


@dataclass(frozen=True, eq=False)
class Shaped(Tabulating):
    """A reference in parts: the same command several times, each time later and smaller.

    Attributes:
        base: The reference without shaping.
        delays: Delay of each part [s].
        amplitudes: Share of the command that each carries.
    """

    base: Reference
    delays: np.ndarray
    amplitudes: np.ndarray

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        delayed = tabulated(self.base, np.subtract.outer(times, self.delays).ravel())
        shape = len(times), len(self.delays), -1
        return Setpoint(*(self.amplitudes @ derivative.reshape(shape) for derivative in delayed))


def shaped(base: Reference, shaper: Shaper, period: float | Sequence[float]) -> Reference:
    """Shape all drives of a reference for one swing period [s], or for several at once.

    For several the shaper is convolved with itself: each part for one period comes in as many parts
    for the next, so that k impulses become k² for a double pendulum, and the command ends later by
    the last delay of each (Singer & Seering 1990).

    Raises:
        OutOfRange: If a period is not positive, or there is none.
    """
    periods = np.atleast_1d(period).tolist()
    if not periods:
        raise OutOfRange("swing periods", "none", "one or more", "s")
    delays = np.zeros(1)
    amplitudes = np.ones(1)
    for swing_period in periods:
        later = number("swing period", swing_period, "s", "> 0") * shaper.fractions
        delays = np.add.outer(delays, later).ravel()
        amplitudes = np.multiply.outer(amplitudes, shaper.amplitudes).ravel()
    return Shaped(base, delays, amplitudes)


_REST_SAMPLES = 30
"""Samples at rest behind a curve: a cubic spline rings about a kink, less by 2 + √3 from sample to
sample, so 30 of them leave 1e-17."""


@dataclass(frozen=True, eq=False)
class ShapedHoisting(Tabulating):
    """A reference with a motion of its own for all drives but the hoist, which stand still before
    time 0 and after the end.

    Attributes:
        base: The reference of the hoist.
        others: Indices of the others among the drives.
        end: Time at which the others arrive [s].
        curves: Position of the others over time, its first and its second derivative.
    """

    base: Reference
    others: np.ndarray
    end: float
    curves: tuple[scipy.interpolate.BSpline, ...]

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        inside = np.clip(times, 0.0, self.end)
        moving = ((times >= 0.0) & (times < self.end))[:, None]
        position, velocity, acceleration = self.curves
        of_base = tabulated(self.base, times)
        # Copies, since the arrays may be the base's own.
        setpoint = Setpoint(
            of_base.position.copy(), of_base.velocity.copy(), of_base.acceleration.copy()
        )
        setpoint.position[:, self.others] = position(inside)
        setpoint.velocity[:, self.others] = np.where(moving, velocity(inside), 0.0)
        setpoint.acceleration[:, self.others] = np.where(moving, acceleration(inside), 0.0)
        return setpoint


def shaped_hoisting(
    crane: Crane, base: Reference, shaper: Shaper, duration: float, *, step: float = 5e-3
) -> Reference:
    """Shape all drives of a reference but the hoist while its own hoisting changes the period; the
    hoist is left as it is.

    Each part of a move comes when the swing that the move caused has gone on by the shaper's
    fraction of a turn, ∫ω dt = 2π fraction with ω² = g/l(t), and is as large as that swing has
    become: a way gone at cable length l₁ leaves an amplitude in proportion to l₁^(-1/4) l^(-3/4),
    so the part at l₂ is (l₂/l₁)^(1/4) times that at l₁. The parts add up to the whole way. Slow
    hoisting and a small swing are assumed. Where the cable shortens, parts are passed on faster
    than they were asked for, by up to (l₁/l₂)^(1/2).

    Args:
        crane: The crane.
        base: The reference.
        shaper: The shaper.
        duration: Time over which the base moves [s].
        step: Spacing of the samples [s].

    Raises:
        MissingRole: If the crane has no driven hoist.
        OutOfRange: If duration or a cable is not positive, or the step longer than a quarter of the
            duration or too short for it.
    """
    role = crane.layout.role("hoist", "Shaped hoisting")
    hoist = crane.layout.drive(crane.layout.symbols[role])
    other_drives = np.delete(np.arange(crane.layout.m), hoist)
    intervals("duration", duration, step)
    within("step of the shaped reference", step, 0.0, duration / 4.0, "s")
    count = round(duration / step)
    of_base = tabulated(base, step * np.arange(count + 1), crane.layout.m)
    longest = float(of_base.position[:, hoist].max())
    number("longest cable that the reference wants", longest, "m", "> 0")
    slowest_period = 2.0 * math.pi * math.sqrt(longest / crane.gravity)

    # The last part comes up to this much after the command.
    longest_delay = slowest_period * float(shaper.fractions[-1])
    intervals("duration and swing period", duration + longest_delay, step)
    t = step * np.arange(count + math.ceil(longest_delay / step) + 2 + _REST_SAMPLES)
    setpoint = tabulated(base, t)
    length = setpoint.position[:, hoist]
    number("shortest cable that the reference wants", length.min(), "m", "> 0")
    moved = _moved_in_parts(shaper, crane.gravity, t, length, setpoint.velocity[:, other_drives])
    position = setpoint.position[0, other_drives] + moved
    curve = scipy.interpolate.make_interp_spline(t, position, k=3)
    return ShapedHoisting(
        base, other_drives, float(t[-1]), (curve, curve.derivative(), curve.derivative(2))
    )


def _moved_in_parts(
    shaper: Shaper, gravity: float, t: np.ndarray, length: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Return how far drives have moved that get a command in parts while the cable changes its
    length [rad or m], shape (rows, drives), see `shaped_hoisting`.

    Args:
        shaper: The shaper.
        gravity: Gravity [m/s²].
        t: Times [s], shape (rows,).
        length: Cable length at these times [m], shape (rows,).
        velocity: Rates that are commanded [rad/s or m/s], shape (rows, drives).
    """
    # The phase of the swing, ∫ω dt.
    phase = scipy.integrate.cumulative_trapezoid(np.sqrt(gravity / length), t, initial=0.0)

    # Of what is commanded at each time, the share of each part: its amplitude times l^(1/4) at the
    # length at which the part comes, scaled so that the parts add up to one.
    fractions = shaper.fractions[:, None]
    length_of_part = np.interp(phase + 2.0 * math.pi * fractions, phase, length)
    weights = shaper.amplitudes[:, None] * length_of_part**0.25
    shares = weights / weights.sum(axis=0)

    # How far each part has moved the drives up to the time at which it was commanded, shape (parts,
    # times, drives).
    velocities = shares[:, :, None] * velocity
    displacements = scipy.integrate.cumulative_trapezoid(velocities, t, axis=1, initial=0.0)
    moved = np.zeros_like(velocity)
    for fraction, displacement in zip(shaper.fractions, displacements, strict=True):
        # A part comes when the swing has gone on by its fraction of a turn. So what has come up to
        # a time was commanded up to that by which the phase was as much less.
        commanded = np.interp(phase - 2.0 * math.pi * fraction, phase, t)
        moved += np.stack([np.interp(commanded, t, column) for column in displacement.T], axis=1)
    return moved
