"""What may be different from what was planned: the load, the cable, the sensors, the air."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cranedyn.controllers.observer import observed
from cranedyn.controllers.sensed import NOISE, sensed
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Disturbance, State, Wanted
from cranedyn.model.crane import Crane
from experiments.harness import conduct as common
from experiments.scenarios.moves import AFTER, Move, Score, score
from experiments.scenarios.strategies import Plan, instant


@dataclass(frozen=True)
class Case:
    """How the crane that moves differs from the one that was planned for.

    Attributes:
        name: What it is called.
        load: Mass of the payload over that planned for.
        values: Further numbers of the crane.
        cable: By which share the cable is longer than measured.
        noise: Standard deviations of what the sensors add to coordinates and rates, shape (10,); None for none.
        delay: By how many control periods the sensors are late.
        blow: What pushes from outside, for a crane and the time at which it should arrive [s].
        observer: Whether the swing is estimated from the drives instead of measured.
    """

    name: str
    load: float = 1.0
    values: Mapping[str, float] = field(default_factory=dict)
    cable: float = 0.0
    noise: np.ndarray | None = None
    delay: int = 0
    blow: Callable[[Crane, float], Disturbance] | None = None
    observer: bool = False

    @property
    def sensors_only(self) -> bool:
        """Whether it is nothing but the measurement of the swing that differs."""
        return self.noise is not None or self.delay > 0 or self.observer


def _gust(crane: Crane, arrives: float) -> Disturbance:
    """A gust of 12 m/s square to the jib at zero slew, in the last ten seconds before the arrival, on 5 m² of load."""
    return wind(crane, cosine_gust(steady(0.0), 12.0, at=arrives - 10.0, lasts=10.0), direction=0.0, payload_area=5.0)


NOMINAL = Case("as planned")

CASES = (
    NOMINAL,
    Case("load -50 %", load=0.5),
    Case("load +50 %", load=1.5),
    Case("cable -10 %", cable=-0.1),
    Case("cable +10 %", cable=0.1),
    Case("noise", noise=NOISE),
    Case("delay 5 ms", delay=1),
    Case("damped swing", values={"damp_swing": 5000.0}),
    Case("gust", blow=_gust),
    Case("no swing sensor", observer=True),
)
"""Cases of the comparison. 5000 N m s/rad are about 2 % of critical damping."""


def make(world: common.World, move: Move, plan: Plan, case: Case = NOMINAL, *, label: str = "") -> tuple[Trajectory, Score]:
    """Make a planned move under a case and watch what is left.

    Raises:
        CraneError: If the run breaks off, or the plan has no motion that an observer could go by.
    """
    values = {**case.values, **({} if case.load == 1.0 else {"payload_mass": case.load * world.crane.payload_mass})}
    crane = world.variant(**values) if values else world.crane
    first, last = (_stretched(end, case.cable) for end in move.ends(world.crane))
    first.q[2:4] = move.swing
    controller = plan.controller()
    if case.observer:
        if plan.motion is None:
            raise CraneError("Without a planned motion there is nothing to linearise an observer about.")
        controller = observed(controller, world.crane, plan.motion, dt=world.dt)
    if case.noise is not None or case.delay:
        noise = np.zeros(10) if case.noise is None else case.noise
        controller = sensed(controller, delay=case.delay, noise=noise, rng=np.random.default_rng(1))
    if case.cable:
        controller = _misread(controller, case.cable)
    duration = instant(world, plan.arrives + AFTER)
    run = world.simulate(
        crane,
        controller,
        plan.reference,
        start=first,
        duration=duration,
        label=label,
        drive=plan.drive,
        disturbance=case.blow(crane, plan.arrives) if case.blow else None,
    )
    return run, score(crane, last, run, plan.arrives)


def _stretched(state: State, share: float) -> State:
    """The state with a cable longer by a share."""
    return State(state.q * np.array([1.0, 1.0, 1.0, 1.0, 1.0 + share]), state.v.copy())


def _misread(controller: Controller, share: float) -> Controller:
    """A controller that takes the cable for shorter by a share than it is."""
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1.0 / (1.0 + share)])

    def misled(t: float, state: State, wanted: Wanted) -> np.ndarray:
        return controller(t, State(scale * state.q, scale * state.v), wanted)

    return misled
