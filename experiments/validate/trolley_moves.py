"""Oracles of moves of the trolley.

The swing that pulses of acceleration and quintic splines leave.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.validate.bench import Bench, G
from experiments.validate.oracle import FINITE_SWING, SMALL_SCALE, Oracle

LENGTH = 20.0
"""Cable length [m]."""

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


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of the swing that moves of the trolley leave."""
    crane = bench.build()
    return [
        *_pulses(bench, crane),
        *(_spline(bench, crane, duration) for duration in DURATIONS),
        *(_quiet(bench, crane, ratio) for ratio in QUIET_RATIOS),
    ]


def _residual_swing(run: Trajectory) -> float:
    """Return the amplitude of the radial swing at the end of a run [rad], scaled up again.

    The closed forms hold for small angles, so that motions are scaled down by `SMALL_SCALE` in the
    runs.
    """
    phi = float(run["phi_rad"][-1])
    rate = float(run["phi_dot_rad_s"][-1])
    length = float(run["l_m"][-1])
    return math.hypot(phi, rate * math.sqrt(length / G)) / SMALL_SCALE


def _finite_error(swing: float) -> float:
    """Return the order of the error of a closed form for small angles [rad].

    It is the swing times the square of the angle in the run.

    Args:
        swing: Largest swing on the way, not scaled down [rad].
    """
    return swing * (SMALL_SCALE * swing) ** 2


def _pulses(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the swing after a pulse of acceleration, and after braking as well."""

    def accelerations(t: float, state: State, setpoint: Setpoint, dt: float) -> np.ndarray:
        # Half a step early, so that rounding of the time does not decide which step is the last.
        trolley = crane.layout.along("x")
        if t < PULSE - dt / 2.0:
            return SMALL_SCALE * ACCELERATION * trolley
        if t > PULSE + COAST - dt / 2.0:
            return -SMALL_SCALE * ACCELERATION * trolley
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
            FINITE_SWING,
        ),
        Oracle(
            f"the same, {COAST:g} s of coasting and braking",
            "rad",
            after_braking,
            partial(read, 2.0 * PULSE + COAST),
            allowed,
            FINITE_SWING,
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
    goal = (0.0, trolley + SMALL_SCALE * DISTANCE, length)
    reference = spline(crane, start, [goal], [duration])
    return _residual_swing(bench.moved(crane, start, reference, duration, dt))


def _spline(bench: Bench, crane: Crane, duration: float) -> Oracle:
    """Return the oracle of the swing that a spline leaves."""
    closed = math.degrees(theory.quintic_residual(DISTANCE, duration, LENGTH, G))
    name = f"swing left by a spline of {DISTANCE:g} m in {duration:g} s"

    def read(dt: float) -> float:
        return math.degrees(_swing_after_spline(bench, crane, LENGTH, duration, dt))

    return Oracle(name, "°", closed, read, math.degrees(_finite_error(0.2)), FINITE_SWING)


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
