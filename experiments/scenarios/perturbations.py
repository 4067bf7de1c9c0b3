"""What may be different from what was planned: the load, the cable, the sensors, the air; and moves
under it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.errors import CraneError
from cranedyn.estimation.load_estimate import LoadEstimateController, with_load_estimate
from cranedyn.estimation.misread import Misread
from cranedyn.estimation.observer import with_observer
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import Controller, Disturbance, State
from cranedyn.model.crane import Crane
from experiments.harness import PlannedRun, Setup
from experiments.scenarios.moves import AFTER, DRAG, MovePlan, RestToRest, Score, instant, score


@dataclass(frozen=True)
class Perturbation:
    """How the crane that moves differs from the one that was planned for.

    Attributes:
        name: Name of the case.
        load: Mass of the payload over the planned one.
        values: Further numbers of the crane.
        cable: Share by which the cable is longer than measured.
        offset: Length by which it is longer besides, wherever the hoist stands [m].
        noise: Noise of the sensors, as a multiple of `cranedyn.estimation.sensor_model.noise_of`.
        delay: Delay of the sensors in control periods.
        disturbance: Function that returns external forces, from a crane and the time at which it
            should arrive [s]; None for no forces.
        observer: Empty where the state is measured. "state" where the swing is estimated from the
            drives, with load and cable as planned. Otherwise the sensors of an observer that also
            estimates load and cable, see `cranedyn.estimation.load_filter.Sensors`.
    """

    name: str
    load: float = 1.0
    values: Mapping[str, float] = field(default_factory=dict)
    cable: float = 0.0
    offset: float = 0.0
    noise: float = 0.0
    delay: int = 0
    disturbance: Callable[[Crane, float], Disturbance] | None = None
    observer: Literal["", "state", "drives", "swing", "imu"] = ""

    @property
    def sensors_only(self) -> bool:
        """Whether nothing but the measurement of the swing may differ."""
        return self.noise > 0.0 or self.delay > 0 or self.observer != ""


def _gust(crane: Crane, arrives: float) -> Disturbance:
    """Return a gust of 12 m/s across the jib in the last ten seconds, on 5 m² of load."""
    gust = cosine_gust(steady(0.0), 12.0, at=arrives - 10.0, lasts=10.0)
    return wind(crane, gust, direction=0.0, payload_area=DRAG)


_observer = lru_cache(maxsize=1)(with_observer)
"""Observer without a controller, whose gains the cases of a move share."""

UNOBSERVED = "The observer uses efforts, not rates of converters."
"""Why there is no such case on frequency converters."""

UNOBSERVED_ACCELERATIONS = "The observer uses efforts, not accelerations of the drives."
"""Why there is no such case for a controller that commands accelerations."""

NOMINAL = Perturbation("as planned")

PERTURBATIONS = (
    NOMINAL,
    Perturbation("load -50 %", load=0.5),
    Perturbation("load +50 %", load=1.5),
    Perturbation("cable -10 %", cable=-0.1),
    Perturbation("cable +10 %", cable=0.1),
    Perturbation("noise", noise=1.0),
    Perturbation("delay 5 ms", delay=1),
    Perturbation("damped swing", values={"damp_swing": 5000.0}),
    Perturbation("gust", disturbance=_gust),
    Perturbation("no swing sensor", observer="state"),
)
"""Cases of the comparison. 5000 N m s/rad are about 2 % of critical damping."""

UNTOLD = (
    Perturbation("state alone: load -50 %", load=0.5, observer="state"),
    Perturbation("state alone: as planned", observer="state"),
    Perturbation("state alone: load +50 %", load=1.5, observer="state"),
    Perturbation("load too: load -50 %", load=0.5, observer="drives"),
    Perturbation("load too: as planned", observer="drives"),
    Perturbation("load too: load +50 %", load=1.5, observer="drives"),
    Perturbation("load too: cable -10 %", cable=-0.1, observer="drives"),
    Perturbation("load too: cable +10 %", cable=0.1, observer="drives"),
)
"""Cases in which the drives alone are seen, by the observer of the state or by that of the load."""

AFTER_UNTOLD = 0.1
"""How long these are watched after the arrival [s]: what is judged is the swing at it."""


def make(
    setup: Setup,
    move: RestToRest,
    plan: MovePlan,
    perturbation: Perturbation = NOMINAL,
    *,
    label: str = "",
    after: float = AFTER,
) -> tuple[Trajectory, Score]:
    """Make a planned move with a perturbed crane, and score it.

    Args:
        setup: The world.
        move: The move.
        plan: How it is made.
        perturbation: How the crane differs from the planned one.
        label: Name of the run for the progress.
        after: Time for which it is watched after the arrival [s].

    Raises:
        CraneError: If the run breaks off, or the plan has no motion that an observer could go by.
    """
    values = dict(perturbation.values)
    if perturbation.load != 1.0:
        values["payload_mass"] = perturbation.load * setup.crane.payload_mass
    crane = setup.variant(**values) if values else setup.crane
    start, goal = move.ends(crane)
    start = _stretched(crane, start, perturbation.cable, perturbation.offset)
    goal = _stretched(crane, goal, perturbation.cable, perturbation.offset)
    start.q[crane.swings] = move.swing
    disturbance = None
    if perturbation.disturbance is not None:
        disturbance = perturbation.disturbance(crane, plan.arrives)
    planned = PlannedRun(
        crane,
        _perturbed_controller(setup, crane, plan, perturbation),
        plan.reference,
        start,
        instant(plan.arrives + after, setup.control_period),
        label,
        drive=plan.drive,
        disturbance=disturbance,
    )
    run = setup.make(planned)
    return run, score(crane, goal, run, plan.arrives)


def _perturbed_controller(
    setup: Setup, crane: Crane, plan: MovePlan, perturbation: Perturbation
) -> Controller:
    """Return the controller of a plan behind the sensors of a perturbed crane."""
    controller = plan.controller()
    if perturbation.observer:
        controller = _observed(setup, plan, controller, perturbation.observer)
    if perturbation.noise or perturbation.delay:
        controller = with_sensor_model(
            crane,
            controller,
            delay=perturbation.delay,
            noise=perturbation.noise * noise_of(crane),
            rng=np.random.default_rng(1),
        )
    if perturbation.cable or perturbation.offset:
        controller = Misread(crane, controller, perturbation.cable, perturbation.offset)
    return controller


def _observed(
    setup: Setup,
    plan: MovePlan,
    controller: Controller,
    observer: Literal["state", "drives", "swing", "imu"],
) -> Controller:
    """Return a controller that acts on the estimate of an observer, see `Perturbation`.

    Raises:
        CraneError: If there is no such observer for the plan.
    """
    if plan.motion is None:
        raise CraneError("An observer is linearised about a planned motion, and there is none.")
    if plan.drive == "velocity":
        raise CraneError(UNOBSERVED)
    if plan.drive == "motion":
        raise CraneError(UNOBSERVED_ACCELERATIONS)
    if observer == "state":
        of_state = _observer(None, setup.crane, plan.motion, dt=setup.dt)
        return replace(of_state, controller=controller)
    estimating = with_load_estimate(controller, setup.crane, plan.motion, sensors=observer)
    if setup.engine == "compiled" and isinstance(estimating, LoadEstimateController):
        from cranedyn.compiled.load_filter_code import compile_load_estimate

        return compile_load_estimate(estimating)
    return estimating


def planned_move(setup: Setup, move: RestToRest, plan: MovePlan) -> PlannedRun:
    """Return the run of a planned move without perturbation.

    Args:
        setup: The world.
        move: The move.
        plan: How it is made.
    """
    first, _ = move.ends(setup.crane)
    q = first.q.copy()
    q[setup.crane.swings] = move.swing
    duration = instant(plan.arrives + AFTER, setup.control_period)
    start = State(q, first.v.copy())
    return PlannedRun(
        setup.crane, plan.controller(), plan.reference, start, duration, move.name, plan.drive
    )


def _stretched(crane: Crane, state: State, share: float, offset: float) -> State:
    """Return the state with a cable longer by a share, and by an offset [m]."""
    hoist = crane.layout.at("l")
    q = state.q.copy()
    q[hoist] = (1.0 + share) * q[hoist] + offset
    return State(q, state.v.copy())
