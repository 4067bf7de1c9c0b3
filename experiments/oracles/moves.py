"""A jib that turns steadily, and moves of the trolley.

Of the jib: where the load hangs, how it pulls, and its swing as seen from the jib. Of the trolley:
the swing that pulses of acceleration and quintic splines leave.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.oracles.bench import FINITE, MASS, SELDOM, SMALL, Bench, Build, G, Oracle

# --- a jib that turns steadily --------------------------------------------------------------------


class SteadySlewing(NamedTuple):
    """A load under a jib that turns steadily.

    Attributes:
        radius: Position of the trolley [m].
        length: Cable length [m].
        rpm: Slew rate [1/min], as makers state it.
    """

    radius: float
    length: float
    rpm: float

    @property
    def rate(self) -> float:
        """Slew rate [rad/s]."""
        return self.rpm * math.pi / 30.0


STEADY = (SteadySlewing(50.0, 45.0, 0.8), SteadySlewing(25.0, 19.0, 0.5))
"""A 71 EC-B 5 and an L1-24, with the trolley at the tip of the jib."""

SETTLING_TIME = 140.0
"""Time for which the load settles [s]."""

STAYING_TIME = 60.0
"""Time for which a load that hangs at rest under a turning jib must stay there [s]."""

LENGTH = 20.0
"""Cable length in all but steady slewing [m]."""

SLEW_RATE = 0.1
"""Slew rate at which the swing is seen from the jib [rad/s]."""

SAMPLE_TIME = 0.5
"""Time between the samples of this swing [s]."""


def turning_jib(bench: Bench) -> list[Oracle]:
    """Return the oracles of angles and tensions of steady slewing, and of the two frequencies."""
    crane = bench.build()
    oracles = []
    for case in STEADY:
        oracles += _steady(bench, case)
    return [*oracles, _stay(bench, crane, STEADY[0]), *_modes(bench, crane)]


def turning(build: Build, radius: float, length: float, rpm: float) -> tuple[Crane, State]:
    """Return a crane whose load hangs plumb under a jib that turns, and settles.

    Its swing joints are damped. Dampers act on the swing relative to the jib, so that they exert
    nothing once the load rests there, wherever that is.

    Args:
        build: Makes the crane.
        radius: Position of the trolley [m].
        length: Cable length [m].
        rpm: Slew rate [1/min].
    """
    # 2 ζ m l² ω with a damping ratio ζ of 0.6.
    damping = 1.2 * MASS * length**2 * math.sqrt(G / length)
    crane = build(damp_swing=damping)
    return crane, crane.state(x=radius, l=length, gamma_dot=rpm * math.pi / 30.0)


def _steady(bench: Bench, case: SteadySlewing) -> list[Oracle]:
    """Return the oracles of the angle at which the load settles, and of the tension there."""
    radius, length, rpm = case
    crane, plumb = turning(bench.build, radius, length, rpm)
    settled = cache(lambda dt: bench.run(crane, plumb, SETTLING_TIME, dt, substeps=SELDOM))
    location = f"x = {radius:g} m, l = {length:g} m, {rpm:g} rpm"
    # φ is positive where the load lags inwards of the trolley; centrifugal force pulls it outwards.
    angle = -math.degrees(theory.slewing_swing(radius, length, case.rate, G))
    tension = theory.slewing_tension(radius, length, case.rate, G, MASS)

    def read_angle(dt: float) -> float:
        return -math.degrees(settled(dt)["phi_rad"][-1])

    def read_tension(dt: float) -> float:
        return -float(settled(dt)["F_l_N"][-1])

    return [
        Oracle(f"load settles outward, {location}", "°", angle, read_angle),
        Oracle(f"tension then, {location}", "N", tension, read_tension),
    ]


def _stay(bench: Bench, crane: Crane, case: SteadySlewing) -> Oracle:
    """Return the oracle of a load that starts where it rests relative to the jib, undamped."""
    phi = theory.slewing_swing(case.radius, case.length, case.rate, G)
    start = crane.state(x=case.radius, l=case.length, gamma_dot=case.rate, phi=phi)

    def strays(dt: float) -> float:
        run = bench.run(crane, start, STAYING_TIME, dt, substeps=SELDOM)
        swing = run.coordinates("phi", "theta")
        return float(np.abs(swing - swing[0]).max())

    return Oracle("strays from there in a minute without damping", "rad", 0.0, strays)


def _modes(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the two frequencies of a small swing as seen from a turning jib.

    The trolley stands at the slew axis, where no centrifugal force bends the cable. In the frame
    at rest a small swing is the sum of two circular ones at ω and -ω. Seen from a jib that turns at
    Ω, z = φ + iθ has them at ω - Ω and -(ω + Ω).
    """
    start = crane.state(x=0.0, l=LENGTH, gamma_dot=SLEW_RATE, phi=1e-6, theta_dot=2e-7)

    @cache
    def rates(dt: float) -> tuple[float, float]:
        """Return the magnitudes of both rates [rad/s], the slow one first, by Prony's method.

        Samples of a sum of two exponentials obey z_k = a z_(k-1) + b z_(k-2). The roots of
        r² - a r - b are exp(i rate T), with the time T between samples.
        """
        run = bench.run(crane, start, STAYING_TIME, dt)
        stride = round(SAMPLE_TIME / (run.t[1] - run.t[0]))
        z = (run["phi_rad"] + 1j * run["theta_rad"])[::stride]
        before = np.stack([z[1:-1], z[:-2]], axis=1)
        a, b = np.linalg.lstsq(before, z[2:], rcond=None)[0]
        roots = np.roots([1.0, -a, -b])
        backward, forward = np.sort(np.log(roots).imag / SAMPLE_TIME).tolist()
        return forward, -backward

    omega = math.sqrt(G / LENGTH)
    slow = omega - SLEW_RATE
    fast = omega + SLEW_RATE
    observed = f"seen from a jib at {SLEW_RATE:g} rad/s"
    return [
        Oracle(f"{observed}: slow swing, ω - Ω", "rad/s", slow, lambda dt: rates(dt)[0]),
        Oracle(f"{observed}: fast swing, ω + Ω", "rad/s", fast, lambda dt: rates(dt)[1]),
    ]


# --- moves of the trolley -------------------------------------------------------------------------

ACCELERATION = 0.3
"""Acceleration of a pulse [m/s²]."""

PULSE = 4.0
"""Duration of a pulse [s]."""

COAST = 6.0
"""Time for which the trolley runs on before it brakes [s]."""

DISTANCE = 10.0
"""Distance of a move by a spline [m]."""

DURATIONS = (10.0, 15.0)
"""Durations of such moves [s]."""

QUIET_RATIOS = (1.834566, 2.895032, 4.938452)
"""Durations in periods of the swing at which a spline leaves none, to six decimals.

They are zeros of `theory.quintic_residual`.
"""

QUIET_DURATION = 20.0
"""Duration of a spline that leaves no swing [s]; the cable is as long as the ratio asks for."""


def trolley_moves(bench: Bench) -> list[Oracle]:
    """Return the oracles of the swing that moves of the trolley leave."""
    crane = bench.build()
    return [
        *_pulses(bench, crane),
        *(_spline(bench, crane, duration) for duration in DURATIONS),
        *(_quiet(bench, crane, ratio) for ratio in QUIET_RATIOS),
    ]


def _residual_swing(run: Trajectory) -> float:
    """Return the amplitude of the radial swing at the end of a run [rad], scaled up again.

    The closed forms hold for small angles, so that motions are scaled down by `SMALL` in the runs.
    """
    phi = float(run["phi_rad"][-1])
    rate = float(run["phi_dot_rad_s"][-1])
    length = float(run["l_m"][-1])
    return math.hypot(phi, rate * math.sqrt(length / G)) / SMALL


def _finite_error(swing: float) -> float:
    """Return the order of the error of a closed form for small angles [rad].

    It is the swing times the square of the angle in the run.

    Args:
        swing: Largest swing on the way, not scaled down [rad].
    """
    return swing * (SMALL * swing) ** 2


def _pulses(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the swing after a pulse of acceleration, and after braking as well."""

    def accelerations(t: float, state: State, setpoint: Setpoint, dt: float) -> np.ndarray:
        # Half a step early, so that rounding of the time does not decide which step is the last.
        trolley = crane.layout.along("x")
        if t < PULSE - dt / 2.0:
            return SMALL * ACCELERATION * trolley
        if t > PULSE + COAST - dt / 2.0:
            return -SMALL * ACCELERATION * trolley
        return 0.0 * trolley

    def read(duration: float, dt: float) -> float:
        controller = partial(accelerations, dt=dt)
        return _residual_swing(bench.run(crane, crane.state(l=LENGTH), duration, dt, controller))

    # Under a constant acceleration a the load swings about a/g, by as much: up to 2 a/g.
    allowed = _finite_error(2.0 * ACCELERATION / G)
    after_pulse = theory.pulse_residual(ACCELERATION, PULSE, LENGTH, G)
    after_braking = theory.coast_residual(ACCELERATION, PULSE, COAST, LENGTH, G)
    return [
        Oracle(
            f"swing left by {ACCELERATION:g} m/s² for {PULSE:g} s",
            "rad",
            after_pulse,
            partial(read, PULSE + COAST),
            allowed,
            FINITE,
        ),
        Oracle(
            f"the same, {COAST:g} s of coasting and braking",
            "rad",
            after_braking,
            partial(read, 2.0 * PULSE + COAST),
            allowed,
            FINITE,
        ),
    ]


def _swing_after_spline(
    bench: Bench, crane: Crane, length: float, duration: float, dt: float
) -> float:
    """Return the swing that a spline of `DISTANCE` leaves [rad].

    Args:
        bench: Where it runs.
        crane: The crane.
        length: Cable length [m].
        duration: Duration of the spline [s].
        dt: Step [s].
    """
    start = crane.state(l=length)
    trolley = float(start.q[crane.layout.index("x")])
    goal = (0.0, trolley + SMALL * DISTANCE, length)
    reference = spline(crane, start, [goal], [duration])
    return _residual_swing(bench.moved(crane, start, reference, duration, dt))


def _spline(bench: Bench, crane: Crane, duration: float) -> Oracle:
    """Return the oracle of the swing that a spline leaves."""
    closed = math.degrees(theory.quintic_residual(DISTANCE, duration, LENGTH, G))
    name = f"swing left by a spline of {DISTANCE:g} m in {duration:g} s"

    def read(dt: float) -> float:
        return math.degrees(_swing_after_spline(bench, crane, LENGTH, duration, dt))

    return Oracle(name, "°", closed, read, math.degrees(_finite_error(0.2)), FINITE)


def _quiet(bench: Bench, crane: Crane, ratio: float) -> Oracle:
    """Return the oracle of a spline that leaves no swing, since it lasts a number of periods."""

    def cable_length(periods: float) -> float:
        """Return the cable length of which the spline lasts so many periods, T = 2π √(l/g) [m]."""
        return G * (QUIET_DURATION / (2.0 * math.pi * periods)) ** 2

    length = cable_length(ratio)
    # What the ratio is off by, half of its last decimal, leaves at most.
    at_least = theory.quintic_residual(DISTANCE, QUIET_DURATION, cable_length(ratio - 5e-7), G)
    at_most = theory.quintic_residual(DISTANCE, QUIET_DURATION, cable_length(ratio + 5e-7), G)
    name = f"swing left by one in {ratio:.6f} periods, l = {length:.3f} m"
    read = partial(_swing_after_spline, bench, crane, length, QUIET_DURATION)
    return Oracle(name, "rad", 0.0, read, max(at_least, at_most), "six decimals")
