"""What may be different from what was planned: the load, the cable, the sensors, the air."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cranedyn.controllers.observer import observed
from cranedyn.controllers.sensed import noise_of, sensed
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Disturbance, Setpoint, State
from cranedyn.model.crane import Crane
from experiments import harness
from experiments.scenarios.moves import AFTER, Move, Score, score
from experiments.scenarios.strategies import Plan, instant


@dataclass(frozen=True)
class Perturbation:
    """How the crane that moves differs from the one that was planned for.

    Attributes:
        name: What it is called.
        load: Mass of the payload over that planned for.
        values: Further numbers of the crane.
        cable: By which share the cable is longer than measured.
        noise: Of the sensors, as a multiple of `cranedyn.controllers.sensed.noise_of`.
        delay: By how many control periods the sensors are late.
        disturbance: What acts from outside, for a crane and the time at which it should arrive [s].
        observer: Whether the swing is estimated from the drives instead of measured.
    """

    name: str
    load: float = 1.0
    values: Mapping[str, float] = field(default_factory=dict)
    cable: float = 0.0
    noise: float = 0.0
    delay: int = 0
    disturbance: Callable[[Crane, float], Disturbance] | None = None
    observer: bool = False

    @property
    def sensors_only(self) -> bool:
        """Whether it is nothing but the measurement of the swing that differs."""
        return self.noise > 0.0 or self.delay > 0 or self.observer


def _gust(crane: Crane, arrives: float) -> Disturbance:
    """A gust of 12 m/s square to the jib at zero slew, in the last ten seconds before the arrival,
    on 5 m² of load.
    """
    return wind(
        crane,
        cosine_gust(steady(0.0), 12.0, at=arrives - 10.0, lasts=10.0),
        direction=0.0,
        payload_area=5.0,
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
    Perturbation("no swing sensor", observer=True),
)
"""Cases of the comparison. 5000 N m s/rad are about 2 % of critical damping."""


def make(
    setup: harness.Setup,
    move: Move,
    plan: Plan,
    perturbation: Perturbation = NOMINAL,
    *,
    label: str = "",
) -> tuple[Trajectory, Score]:
    """Make a planned move under a case and watch what is left.

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
    first, last = (_stretched(crane, end, perturbation.cable) for end in move.ends(setup.crane))
    first.q[crane.swings] = move.swing
    controller = plan.controller()
    if perturbation.observer:
        if plan.motion is None:
            raise CraneError(
                "Without a planned motion there is nothing to linearise an observer about."
            )
        if plan.drive == "velocity":
            raise CraneError(UNOBSERVED)
        controller = observed(controller, setup.crane, plan.motion, dt=setup.dt)
    if perturbation.noise or perturbation.delay:
        noise = perturbation.noise * noise_of(crane)
        controller = sensed(
            crane, controller, delay=perturbation.delay, noise=noise, rng=np.random.default_rng(1)
        )
    if perturbation.cable:
        controller = _misread(crane, controller, perturbation.cable)
    duration = instant(setup, plan.arrives + AFTER)
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


def _stretched(crane: Crane, state: State, share: float) -> State:
    """The state with a cable longer by a share."""
    return State(state.q * _cable(crane, 1.0 + share), state.v.copy())


def _cable(crane: Crane, factor: float) -> np.ndarray:
    """A factor for the cable among ones for all other coordinates."""
    return np.array([factor if symbol == "l" else 1.0 for symbol in crane.layout.symbols])


def _misread(crane: Crane, controller: Controller, share: float) -> Controller:
    """A controller that takes the cable for shorter by a share than it is."""
    scale = _cable(crane, 1.0 / (1.0 + share))

    def misled(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return controller(t, State(scale * state.q, scale * state.v), setpoint)

    return misled
