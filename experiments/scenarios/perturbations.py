"""What may be different from what was planned: the load, the cable, the sensors, the air."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.errors import CraneError
from cranedyn.estimation.load_estimate import with_load_estimate
from cranedyn.estimation.observer import with_observer
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import Disturbance, State
from cranedyn.model.crane import Crane
from experiments.harness import Setup
from experiments.scenarios.misread import Misread
from experiments.scenarios.moves import AFTER, DRAG, RestToRest, Score, score
from experiments.scenarios.strategies import MovePlan, instant


@dataclass(frozen=True)
class Perturbation:
    """How the crane that moves differs from the one that was planned for.

    Attributes:
        name: What it is called.
        load: Mass of the payload over that planned for.
        values: Further numbers of the crane.
        cable: By which share the cable is longer than measured.
        offset: By how much it is longer besides, wherever the hoist stands [m].
        noise: Of the sensors, as a multiple of `cranedyn.estimation.sensor_model.noise_of`.
        delay: By how many control periods the sensors are late.
        disturbance: What acts from outside, for a crane and the time at which it should arrive [s].
        observer: Empty where the state is measured. "state" where the swing is estimated from the
            drives, load and cable as planned; else what an observer that estimates load and cable,
            too, has for sensors, see `cranedyn.estimation.load_filter.Sensors`.
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
        """Whether it is nothing but the measurement of the swing that differs."""
        return self.noise > 0.0 or self.delay > 0 or self.observer != ""


def _gust(crane: Crane, arrives: float) -> Disturbance:
    """Return a gust of 12 m/s across the jib in the last ten seconds, on 5 m² of load."""
    return wind(
        crane,
        cosine_gust(steady(0.0), 12.0, at=arrives - 10.0, lasts=10.0),
        direction=0.0,
        payload_area=DRAG,
    )


UNOBSERVED = "The observer goes by efforts, not by the rates of converters."
"""Why there is no such case on frequency converters."""

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
    """Make a planned move under a case and watch what is left for some time after it [s].

    Raises:
        CraneError: If the run breaks off, or the plan has no motion that an observer could go by.
    """
    values = {
        **perturbation.values,
        **(
            {}
            if perturbation.load == 1.0
            else {"payload_mass": perturbation.load * setup.crane.payload_mass}
        ),
    }
    crane = setup.variant(**values) if values else setup.crane
    misread = perturbation.cable, perturbation.offset
    first, last = (_stretched(crane, end, *misread) for end in move.ends(setup.crane))
    first.q[crane.swings] = move.swing
    controller = plan.controller()
    if perturbation.observer:
        if plan.motion is None:
            raise CraneError(
                "Without a planned motion there is nothing to linearise an observer about."
            )
        if plan.drive == "velocity":
            raise CraneError(UNOBSERVED)
        controller = (
            with_observer(controller, setup.crane, plan.motion, dt=setup.dt)
            if perturbation.observer == "state"
            else with_load_estimate(
                controller, setup.crane, plan.motion, sensors=perturbation.observer
            )
        )
    if perturbation.noise or perturbation.delay:
        noise = perturbation.noise * noise_of(crane)
        controller = with_sensor_model(
            crane, controller, delay=perturbation.delay, noise=noise, rng=np.random.default_rng(1)
        )
    if any(misread):
        controller = Misread(crane, controller, *misread)
    duration = instant(setup, plan.arrives + after)
    run = setup.simulate(
        crane,
        controller,
        plan.reference,
        start=first,
        duration=duration,
        label=label,
        drive=plan.drive,
        disturbance=perturbation.disturbance(crane, plan.arrives)
        if perturbation.disturbance
        else None,
    )
    return run, score(crane, last, run, plan.arrives)


def _stretched(crane: Crane, state: State, share: float, offset: float) -> State:
    """Return the state with a cable longer by a share, and by an offset [m]."""
    hoist = crane.layout.at("l")
    q = state.q.copy()
    q[hoist] = (1.0 + share) * q[hoist] + offset
    return State(q, state.v.copy())
