"""The free swing of a held crane, predicted without simulating it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number
from cranedyn.clocks import intervals, multiple
from cranedyn.controllers import Hold
from cranedyn.dynamics.linearisation import dominant_mode, feedback_gain, sampled
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import tabulated
from cranedyn.theory import amplitude_factor, hoist_compliance

_DECAYED = 300.0
"""Decay times after which a swing has vanished: its square underflows."""


@dataclass(frozen=True)
class FreeSwing:
    """Predicted free swing over a time interval.

    Attributes:
        period: Period [s].
        damping_ratio: Damping ratio.
        amplitude: Root mean square of the amplitude over the interval [rad].
    """

    period: float
    damping_ratio: float
    amplitude: float


def free_swing(
    crane: Crane,
    hold: Hold,
    reference: Reference,
    start: State,
    *,
    since: float,
    until: float,
    dt: float = 5e-4,
    control_period: float = 5e-3,
) -> FreeSwing:
    """Predict the radial free swing after a reference.

    Period and damping of small swings are an eigenvalue of the linear crane under the sampled hold,
    stepped as `simulate` steps it; the amplitude is the share of that mode after the reference has
    acted on the linear loop. Two effects of finite amplitude are then
    added: the pendulum's own, (2/π) K(sin²(A/2)), and the compliance of the hoist at twice the
    swing's frequency (`theory.hoist_compliance`).

    Args:
        crane: Crane.
        hold: Hold controller of the drives.
        reference: Reference that excites the swing, at rest again before `since`.
        start: Initial state, at rest.
        since: Start of the interval [s].
        until: End of the interval [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].

    Raises:
        MissingRole: If the crane is not a tower crane.
        OutOfRange: If the interval does not begin at 0 or later and end after that while there is a
            swing, or the control period is not a multiple of `dt`.
    """
    if not number("since", since, "s", ">= 0") < number("until", until, "s"):
        raise OutOfRange("since", since, f"less than until, {until:g} s", "s")
    start = crane.layout.as_state("start", start)
    multiple("control_period", control_period, "dt", dt)
    intervals("until", until, control_period)
    layout = crane.layout
    _, _, radial, _, cable = layout.tower("The prediction of a free swing")
    hoist = layout.drive("l")
    stiffness = float(hold.stiffness[hoist])
    damping = float(hold.damping[hoist])

    # Where the crane rests: the hoist gives way until its stiffness carries what the feed-forward
    # leaves of the weight.
    rest = State(start.q.copy(), np.zeros(layout.n))
    rest.q[cable] += (hold.feed_forward[hoist] + crane.payload_mass * crane.gravity) / stiffness
    plant = sampled(crane, rest, dt=dt, control_period=control_period)
    loop = plant.closed(feedback_gain(crane, hold.stiffness, hold.damping))
    mode = dominant_mode(loop, control_period, coordinate=radial)

    # The setpoints of the reference, away from those at rest, excite the linear loop.
    times = control_period * np.arange(round(since / control_period))
    positions = tabulated(reference, times, layout.m).position
    excitations = hold.stiffness * (positions - start.q[layout.drives])
    excited = np.flatnonzero(excitations.any(axis=1))
    last = int(excited[-1]) if len(excited) else 0
    z = np.zeros(2 * layout.n)
    for excitation in excitations[: last + 1]:
        z = loop @ z + plant.b @ excitation

    def compliance(amplitude: float) -> tuple[float, float]:
        """Return what the hoist adds to the period, as a share of it, and to the damping ratio."""
        return hoist_compliance(
            amplitude, rest.q[cable], crane.gravity, crane.payload_mass, stiffness, damping
        )

    times = np.linspace(since, until, 200) - (last + 1) * control_period
    if -mode.rate.real * until > _DECAYED:
        last_time = f"{-_DECAYED / mode.rate.real:.3g} or less: the swing has died away by then"
        raise OutOfRange("until", until, last_time, "s")
    first = 2.0 * float(abs(mode.weights @ z))
    # The amplitude A decays by dA/dt = -linear A - cubic A³: the damping that the hoist adds grows
    # with A². With E = exp(2 linear t) the solution is A0 / √(E + cubic A0² (E - 1) / linear).
    linear = max(-mode.rate.real, 1e-12)
    cubic = mode.rate.imag * compliance(1.0)[1]
    grown = np.exp(2.0 * linear * times)
    decayed = first / np.sqrt(grown + cubic * first**2 * (grown - 1.0) / linear)
    amplitude = math.sqrt(float(np.mean(decayed**2)))
    longer, added_damping = compliance(amplitude)
    return FreeSwing(
        period=mode.period * float(amplitude_factor(amplitude)) * (1.0 + longer),
        damping_ratio=mode.damping_ratio + added_damping,
        amplitude=amplitude,
    )
