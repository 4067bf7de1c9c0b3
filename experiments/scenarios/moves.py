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

CLOSE = 0.010
"""How near the payload must stay to its goal to count as settled [m]."""

AFTER = 20.0
"""How long a move is watched after the arrival [s]."""

DRAG = 5.0
"""Drag coefficient times area of the load that gusts blow at [m²]."""

LIMITS = LARGE_CRANE
"""What the drives may do."""

IDEAL = "ideal"
"""Drives that take what each strategy answers."""

TOUR_LIMITS = Limits(rates=(0.08, 0.8, 0.8), accelerations=LIMITS.accelerations)
"""The same in a tour: rates of the article's demonstration are not published, these are ours."""

DWELL = 6.0
"""How long a tour stands still after each leg [s]."""


@dataclass(frozen=True)
class RestToRest:
    """From one rest to another.

    Attributes:
        name: What it is called.
        start: Slew [rad], trolley radius [m], cable length [m] at the start.
        goal: The same at the end.
        duration: Time for it [s].
        swing: Radial and tangential swing in which the load is let go at the start [rad].
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    duration: float
    swing: tuple[float, float] = (0.0, 0.0)

    def ends(self, crane: Crane) -> tuple[State, State]:
        """Start and goal as states at rest with the load plumb."""
        first, last = (
            crane.state(gamma=end[0], x=end[1], l=end[2]) for end in (self.start, self.goal)
        )
        return first, last


MOVES = (
    RestToRest("trolley", (0.0, 10.0, 15.0), (0.0, 20.0, 15.0), 20.0),
    RestToRest("slew", (0.0, 15.0, 15.0), (0.6, 15.0, 15.0), 20.0),
    RestToRest("combined", (0.0, 10.0, 15.0), (0.6, 20.0, 10.0), 20.0),
)
"""Single axes and all three together."""

COMBINED = MOVES[-1]
"""All three together."""

SWINGING = replace(COMBINED, name="combined, with a swing at the start", swing=(0.1, 0.05))
"""The combined move of a load that swings already."""


@dataclass(frozen=True)
class Score:
    """What a move was like.

    Attributes:
        arrives: When the drives should be there [s].
        peak: Largest swing on the way [rad], radial and tangential together.
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
        work: What the drives put in, not counting what they took back [J].
        beyond: Time in which drives that follow a motion or a rate were asked for more than they
            have, or the model did not hold [s].
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


def of_sampling(gravity: float, length: float, control_period: float, peak: float) -> float:
    """Swing that a plan which leaves none may leave [rad], because efforts are held for a control
    period and so come half of it late.

    Args:
        gravity: [m/s²].
        length: Of the cable [m].
        control_period: Time between control instants [s].
        peak: Largest swing on the way [rad].
    """
    return math.sqrt(gravity / length) * control_period / 2.0 * peak


def residual(trajectory: Trajectory) -> float:
    """Return the amplitude of the swing over a stretch without drive motion [rad]: half the longest
    way across, radial and tangential together.

    Raises:
        OutOfRange: If the stretch has less than two rows.
    """
    if len(trajectory) < 2:
        raise OutOfRange(
            "number of control instants in a dwell",
            len(trajectory),
            "2 or more: a shorter control period, a longer dwell",
        )
    return float(math.hypot(*(np.ptp(trajectory.coordinates("phi", "theta"), axis=0) / 2.0)))


def score(crane: Crane, goal: State, run: Trajectory, arrives: float) -> Score:
    """Score a run that should arrive at a goal at a time [s] and goes on for 20 s."""
    swing = run.coordinates("phi", "theta")
    amplitude = swing_amplitude(swing, run.rates("phi", "theta"), run["l_m"], crane.gravity)
    goal_position = payload_position(crane, goal.q)
    after = run.since(arrives - 1e-9)
    distance = np.linalg.norm(point_paths(crane, after.q)[:, 0] - goal_position, axis=1)
    beyond = run.effort + crane.payload_mass * crane.gravity * crane.layout.along("l")
    limits = LIMITS.for_crane(crane)
    acceleration = np.abs(np.diff(run.v[:, run.drives], axis=0)) / np.diff(run.t)[:, None]
    return Score(
        arrives=arrives,
        peak=float(np.linalg.norm(swing, axis=1).max()),
        arrival=float(amplitude[-len(after)]),
        later=float(amplitude[-1]),
        settled=settling_time(after.t - arrives, distance, CLOSE),
        length=float(run["l_m"][-1]),
        tracking=1000.0 * np.abs(run.q[:, run.drives] - run.setpoint).max(axis=0),
        effort=np.abs(beyond).max(axis=0),
        rms=np.sqrt(np.mean(beyond**2, axis=0)),
        rate=float((np.abs(run.v[:, run.drives]) / limits.rates).max()),
        acceleration=float((acceleration / limits.accelerations).max()),
        work=float(np.maximum(np.diff(run.work, axis=0), 0.0).sum()),
        beyond=float(np.diff(run.t)[run.valid[:-1] == 0.0].sum()),
    )


class MovePlan(NamedTuple):
    """How a move is to be made.

    Attributes:
        controller: Makes a controller, a new one for each run.
        reference: Where the drives should be.
        drive: How they take commands.
        arrives: When they should be there [s].
        motion: What a tracking controller goes by, None where there is none.
        uses_swing_sensor: Whether the controller needs the swing measured.
        softer: Makes a controller that is gentle enough for converters; None where the other is.
        rates: Makes a controller for converters that answers rates by itself; None where they are
            made of what the other answers.
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
"""Plans a move."""


def on_converters(setup: Setup, plan: MovePlan) -> MovePlan:
    """Return a plan for drives with typical frequency converters: commands of its controller become
    rates, see `cranedyn.controllers.velocity_command`.
    """
    if plan.rates:
        return plan._replace(controller=plan.rates, drive="velocity")

    def controller() -> Controller:
        return as_velocity_command(
            setup.crane,
            (plan.softer or plan.controller)(),
            drive="motion" if plan.drive == "motion" else "effort",
            control_period=setup.control_period,
        )

    first = controller()
    if isinstance(first, VelocityCommand):  # what is inside may remember
        return plan._replace(controller=controller, drive="velocity")
    if isinstance(first, HoistIntegral):
        return plan._replace(controller=lambda: replace(first, integral=0.0), drive="velocity")
    return plan._replace(controller=lambda: first, drive="velocity")


def followed(setup: Setup, reference: Reference, arrives: float) -> MovePlan:
    """Return the plan of a reference that drives follow exactly and that nothing corrects."""
    controller = partial(follow, setup.crane, reference, setup.control_period)
    return MovePlan(controller, reference, "motion", arrives, uses_swing_sensor=False)
