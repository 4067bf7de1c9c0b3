"""Moves from rest to rest, plans for them, and what is left of a swing after them; shared by the
control experiments.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cranedyn.analysis.swing import settling_time, swing_amplitude
from cranedyn.controllers import follow
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.velocity_command import VelocityCommand, as_velocity_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references.limits import LARGE_CRANE, Limits
from cranedyn.references.motion import Motion
from experiments.harness.setup import Setup

SETTLED_DISTANCE = 0.010
"""Largest distance of the payload from its goal at which it counts as settled [m]."""

AFTER = 20.0
"""Time for which a move is watched after the arrival [s]."""

DRAG = 5.0
"""Drag coefficient times area of the load that gusts blow at [m²]."""

LIMITS = LARGE_CRANE
"""Limits of the drives."""

IDEAL = "ideal"
"""Name of drives that take what each strategy answers, efforts or accelerations."""

TOUR_LIMITS = Limits(rates=(0.08, 0.8, 0.8), accelerations=LIMITS.accelerations)
"""Limits of the drives in a tour. The rates of the article's demonstration are not published; these
are ours."""

DWELL = 6.0
"""Time for which a tour stands still after each leg [s]."""


@dataclass(frozen=True)
class RestToRest:
    """A move from one rest to another.

    Attributes:
        name: Name of the move.
        start: Slew [rad], trolley radius [m] and cable length [m] at the start.
        goal: The same at the end.
        duration: Planned duration [s].
        swing: Radial and tangential swing from which the load is let go at the start [rad].
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    duration: float
    swing: tuple[float, float] = (0.0, 0.0)

    def ends(self, crane: Crane) -> tuple[State, State]:
        """Return start and goal as states at rest with the load plumb."""
        return self._at_rest(crane, self.start), self._at_rest(crane, self.goal)

    @staticmethod
    def _at_rest(crane: Crane, end: tuple[float, float, float]) -> State:
        slew, radius, length = end
        return crane.state(gamma=slew, x=radius, l=length)


MOVES = (
    RestToRest("trolley", (0.0, 10.0, 15.0), (0.0, 20.0, 15.0), 20.0),
    RestToRest("slew", (0.0, 15.0, 15.0), (0.6, 15.0, 15.0), 20.0),
    RestToRest("combined", (0.0, 10.0, 15.0), (0.6, 20.0, 10.0), 20.0),
)
"""Moves of single axes, and of all three together."""

COMBINED = MOVES[-1]
"""The move of all three axes together."""

SWINGING = replace(COMBINED, name="combined, with a swing at the start", swing=(0.1, 0.05))
"""The combined move of a load that swings already."""


@dataclass(frozen=True)
class Score:
    """Swing, errors and efforts of a move.

    Attributes:
        arrives: Time at which the drives should arrive [s].
        peak: Largest swing on the way, radial and tangential together [rad].
        arrival: Amplitude of the swing at the arrival [rad].
        later: Amplitude of the swing 20 s after it [rad].
        settled: Time after the arrival from which the payload stays within 10 mm of its goal [s];
            inf if it does not.
        length: Cable length at the end [m].
        tracking: Largest distance of the drives from their reference: slew [mrad], trolley [mm],
            hoist [mm].
        effort: Largest effort of the drives beyond holding the load at rest [N m, N, N].
        rms: Root mean square of the same.
        rate: Largest rate of a drive as a share of its limit.
        acceleration: Largest acceleration of a drive as a share of its limit, between control
            instants.
        work: Work that the drives put in, without what they took back [J].
        beyond: Time in which drives that follow a motion or a rate were asked for more effort than
            they have, or the model did not hold [s].
    """

    arrives: float
    peak: float
    arrival: float
    later: float
    settled: float
    length: float
    tracking: np.ndarray
    effort: np.ndarray
    rms: np.ndarray
    rate: float
    acceleration: float
    work: float
    beyond: float = 0.0

    @property
    def cycle(self) -> float:
        """Time from the start until the payload stays within 10 mm of its goal [s]."""
        return self.arrives + self.settled


def instant(t: float, control_period: float) -> float:
    """Return the first control instant at or after a time [s]."""
    return control_period * float(np.ceil(t / control_period - 1e-9))


def sampling_swing(gravity: float, length: float, control_period: float, peak: float) -> float:
    """Return the swing that a plan which leaves none may leave all the same [rad].

    Efforts are held for a control period T, and so come T/2 late on average. A swing of the
    amplitude A that is late by T/2 differs by A ω T/2.

    Args:
        gravity: Gravity [m/s²].
        length: Cable length [m].
        control_period: Time between control instants, T [s].
        peak: Largest swing on the way, A [rad].
    """
    return math.sqrt(gravity / length) * control_period / 2.0 * peak


def residual(trajectory: Trajectory) -> float:
    """Return the amplitude of the swing over a stretch in which the drives stand still [rad].

    It is half of the range of the swing, radial and tangential together.

    Raises:
        OutOfRange: If the stretch has less than two rows.
    """
    if len(trajectory) < 2:
        raise OutOfRange(
            "number of control instants in a dwell",
            len(trajectory),
            "2 or more: a shorter control period, a longer dwell",
        )
    radial, tangential = np.ptp(trajectory.coordinates("phi", "theta"), axis=0) / 2.0
    return float(math.hypot(radial, tangential))


def score(crane: Crane, goal: State, run: Trajectory, arrives: float) -> Score:
    """Score a run of a move that goes on for 20 s after the arrival.

    Args:
        crane: The crane.
        goal: Where it should arrive.
        run: The run.
        arrives: Time at which it should arrive [s].
    """
    swing = run.coordinates("phi", "theta")
    amplitude = swing_amplitude(swing, run.rates("phi", "theta"), run["l_m"], crane.gravity)
    after = run.since(arrives - 1e-9)
    goal_position = payload_position(crane, goal.q)
    distance = np.linalg.norm(point_paths(crane, after.q)[:, 0] - goal_position, axis=1)

    # The hoist holds the load by the effort -m g.
    effort = run.effort + crane.payload_mass * crane.gravity * crane.layout.along("l")
    limits = LIMITS.for_crane(crane)
    rates = run.v[:, run.drives]
    acceleration = np.abs(np.diff(rates, axis=0)) / np.diff(run.t)[:, None]
    return Score(
        arrives=arrives,
        peak=float(np.linalg.norm(swing, axis=1).max()),
        arrival=float(amplitude[-len(after)]),
        later=float(amplitude[-1]),
        settled=settling_time(after.t - arrives, distance, SETTLED_DISTANCE),
        length=float(run["l_m"][-1]),
        tracking=1000.0 * np.abs(run.q[:, run.drives] - run.setpoint).max(axis=0),
        effort=np.abs(effort).max(axis=0),
        rms=np.sqrt(np.mean(effort**2, axis=0)),
        rate=float((np.abs(rates) / limits.rates).max()),
        acceleration=float((acceleration / limits.accelerations).max()),
        work=float(np.maximum(np.diff(run.work, axis=0), 0.0).sum()),
        beyond=float(np.diff(run.t)[run.valid[:-1] == 0.0].sum()),
    )


class MovePlan(NamedTuple):
    """How a move is to be made.

    Attributes:
        controller: Function that makes a controller, a new one for each run.
        reference: Motion that the drives should make.
        drive: Kind of the drives, by what they take.
        arrives: Time at which the drives should arrive [s].
        motion: Motion about which a controller tracks or an observer is linearised; None if there
            is none.
        uses_swing_sensor: Whether the controller needs the swing measured.
        softer: Function that makes a controller gentle enough for converters; None if that is
            `controller`.
        rates: Function that makes a controller which answers rates for converters by itself; None
            if rates are made of the answers of the others.
    """

    controller: Callable[[], Controller]
    reference: Reference
    drive: Drive
    arrives: float
    motion: Motion | None = None
    uses_swing_sensor: bool = True
    softer: Callable[[], Controller] | None = None
    rates: Callable[[], Controller] | None = None


Planner = Callable[[Setup, RestToRest], MovePlan]
"""Function that plans a move in a setup."""


def on_converters(setup: Setup, plan: MovePlan) -> MovePlan:
    """Return a plan for drives with typical frequency converters.

    The commands of its controller become rates, see `cranedyn.controllers.velocity_command`.
    """
    if plan.drive == "velocity":
        return plan
    if plan.rates:
        return plan._replace(controller=plan.rates, drive="velocity")

    def make_controller() -> Controller:
        make_inner = plan.softer or plan.controller
        return as_velocity_command(
            setup.crane,
            make_inner(),
            drive="motion" if plan.drive == "motion" else "effort",
            control_period=setup.control_period,
        )

    first = make_controller()
    # What is inside such a command may remember a run: each needs a new one.
    if isinstance(first, VelocityCommand):
        return plan._replace(controller=make_controller, drive="velocity")
    # Of this one only the integral remembers.
    if isinstance(first, HoistIntegral):
        return plan._replace(controller=lambda: replace(first, integral=0.0), drive="velocity")
    return plan._replace(controller=lambda: first, drive="velocity")


def followed(setup: Setup, reference: Reference, arrives: float) -> MovePlan:
    """Return the plan of a reference that drives follow exactly, without feedback of the swing."""
    controller = partial(follow, setup.crane, reference, setup.control_period)
    return MovePlan(controller, reference, "motion", arrives, uses_swing_sensor=False)
