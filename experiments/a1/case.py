"""One free swing of A1: the run, the fit to it, its prediction, and its error budget."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.analysis.prediction import FreeSwing, free_swing
from cranedyn.analysis.swing import SwingFit, fit_swing
from cranedyn.checks import number
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Gains, Hold
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Controller
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.references import hold, pulse
from experiments.harness import PlannedRun, Setup


class Published(NamedTuple):
    """A row of the article's table; None for what is not published.

    Attributes:
        period: Period [s].
        point: Error of the period against a point pendulum [%].
        rigid: Error of the period against a rigid pendulum [%].
        zeta: Damping ratio ζ.
        amplitude: Amplitude [rad].
    """

    period: float | None = None
    point: float | None = None
    rigid: float | None = None
    zeta: float | None = None
    amplitude: float | None = None


PUBLISHED = {
    5.0: Published(4.550, 1.41, 0.60, 0.00083, 0.0953),
    10.0: Published(6.378, 0.52, 0.32, 0.00036, 0.0980),
    15.0: Published(7.796, 0.32, 0.24, 0.00021, 0.0986),
    20.0: Published(8.995, 0.25, 0.20, 0.00014, 0.0988),
}
"""The article's table by cable length [m]."""

ROUNDING = {"error": 0.005, "damping ratio": 0.000005, "amplitude": 0.00005}
"""Half a unit in the last published digit of error [percentage points], ζ, and amplitude [rad]."""


class SoftTrolley(NamedTuple):
    """The article's run with a soft trolley.

    Attributes:
        length: Cable length [m].
        stiffness: k_p of the trolley [N/m].
        damping: k_d of the trolley [N s/m].
        published: What the article says of it.
    """

    length: float
    stiffness: float
    damping: float
    published: Published


SOFT = SoftTrolley(15.0, 3.0e4, 1.2e4, Published(point=1.18))
"""The article's run with a soft trolley.

Its k_d is chosen to meet the published error; with the 5e4 N s/m of the stiff trolley the error
would be +0.55 %.
"""

SWING = 0.10
"""Amplitude of the swing that the pulse is to give [rad]."""

PULSE_AT = 2.0
"""Start of the pulse [s]."""

DURATION = 70.0
"""Duration of a run [s]."""

FIT_FROM = 12.0
"""Start of the part of a run to which a swing is fitted [s]."""


@dataclass(frozen=True)
class SwingCase:
    """One run of A1.

    Attributes:
        length: Cable length [m].
        stiffness: Trolley k_p [N/m].
        published: The article's row for it; empty if there is none.
        fit: Period, damping and amplitude measured in the run.
        predicted: The same, predicted.
        budget: Relative gain in period over the point pendulum in standard gravity, by cause.
        trajectory: The run.
    """

    length: float
    stiffness: float
    published: Published
    fit: SwingFit
    predicted: FreeSwing
    budget: dict[str, float]
    trajectory: Trajectory

    @property
    def error(self) -> float:
        """Measured period over that of the point pendulum in standard gravity, less one."""
        return self.fit.period / float(theory.point_period(self.length, STANDARD_GRAVITY)) - 1.0

    @property
    def prediction_error(self) -> float:
        """Measured period over the predicted one, less one."""
        return self.fit.period / self.predicted.period - 1.0

    @property
    def unexplained(self) -> float:
        """The relative error that the budget does not explain."""
        return self.error - sum(self.budget.values())

    @property
    def finite_swing(self) -> float:
        """Relative change of the period because a finite swing A changes the compliance of the
        pivot, of the order A² of it.
        """
        return self.predicted.amplitude**2 * self.budget["pivot spring"]

    @property
    def second_order(self) -> float:
        """Bound of what a budget of first order neglects: products of its parts, and the above."""
        return sum(self.budget.values()) ** 2 + self.finite_swing


def planned_swing(
    crane: Crane, controller: Controller, length: float, swing: float = SWING
) -> PlannedRun:
    """Return the run in which the trolley moves aside and back after half a period.

    Args:
        crane: The crane.
        controller: Controller of its drives.
        length: Cable length [m].
        swing: Target amplitude [rad], up to π/2.
    """
    start = crane.state(l=length)
    number("swing", number("swing", swing, "rad", "> 0"), "rad", f"0 to {math.pi / 2:.4f}")
    half_period = math.pi * math.sqrt(length / STANDARD_GRAVITY)
    still = hold(crane, start)
    reference = pulse(crane, still, "x", swing * length / 2.0, at=PULSE_AT, width=half_period)
    return PlannedRun(crane, controller, reference, start, DURATION, f"l = {length:g} m")


def run(
    setup: Setup,
    length: float,
    *,
    swing: float = SWING,
    stiffness: Gains = None,
    damping: Gains = None,
    published: Published | None = None,
) -> SwingCase:
    """Swing the load by moving the trolley aside and back after half a period, and fit the free
    swing.

    Args:
        setup: The world.
        length: Cable length [m].
        swing: Target amplitude [rad], up to π/2.
        stiffness: k_p of the drives, see `cranedyn.controllers.hold_controller`.
        damping: k_d of the drives.
        published: The article's row for this run.
    """
    crane = setup.crane
    controller = hold_controller(
        crane, stiffness=stiffness, damping=damping, gravity=STANDARD_GRAVITY
    )
    planned = planned_swing(crane, controller, length, swing)
    if stiffness is not None:
        planned = replace(planned, label=f"{planned.label}, other gains")
    trajectory = setup.make(planned)
    assert planned.reference is not None
    late = trajectory.since(FIT_FROM)
    fit = fit_swing(late.t, late["phi_rad"])
    predicted = free_swing(
        crane,
        controller,
        planned.reference,
        planned.start,
        since=FIT_FROM,
        until=DURATION,
        dt=setup.dt,
        control_period=setup.control_period,
    )
    amplitude = float(np.sqrt(np.mean(fit.amplitude_at(late.t) ** 2)))
    return SwingCase(
        length=length,
        stiffness=float(controller.stiffness @ crane.layout.along("x")),
        published=published or Published(),
        fit=fit,
        predicted=predicted,
        budget=budget(crane, length, amplitude, controller),
        trajectory=trajectory,
    )


def budget(crane: Crane, length: float, amplitude: float, controller: Hold) -> dict[str, float]:
    """Return what each cause adds to the period, relative to the point pendulum in standard
    gravity.

    Args:
        crane: The crane.
        length: Cable length [m].
        amplitude: Amplitude of the swing [rad].
        controller: Controller of the drives, whose springs and dampers give way.
    """
    g = crane.gravity
    m = crane.payload_mass
    k_p = controller.stiffness
    k_d = controller.damping
    trolley = crane.layout.drive("x")
    hoist = crane.layout.drive("l")
    inertia = crane.payload_inertia[0, 0]
    point = float(theory.point_period(length, g))
    payload = theory.rigid_period(length, g, m, inertia)
    links = theory.rigid_period(length, g, m, inertia + crane.dummy_inertia[0])
    spring = theory.pivot_compliance(length, g, m, k_p[trolley])[0]
    damped = theory.pivot_compliance(length, g, m, k_p[trolley], k_d[trolley], crane.trolley_mass)
    return {
        "payload inertia": payload / point - 1.0,
        "dummy inertia": links / payload - 1.0,
        "pivot spring": spring,
        "pivot damper": damped[0] - spring,
        "amplitude": float(theory.amplitude_factor(amplitude)) - 1.0,
        "gravity": math.sqrt(STANDARD_GRAVITY / g) - 1.0,
        "hoist compliance": theory.hoist_compliance(
            amplitude, length, g, m, k_p[hoist], k_d[hoist]
        )[0],
    }
