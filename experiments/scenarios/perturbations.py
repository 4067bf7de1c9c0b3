"""What may be different from what was planned: the load, the cable, the sensors, the air; and moves
under it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from cranedyn.clocks import Clocked
from cranedyn.controllers.affine import Affine, Stateful, affine_form
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.errors import CraneError
from cranedyn.estimation.load_estimate import LoadEstimateController, with_load_estimate
from cranedyn.estimation.observer import with_observer
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import Controller, Disturbance, Setpoint, State
from cranedyn.model.crane import Crane
from experiments.harness import PlannedRun, Setup
from experiments.scenarios.moves import AFTER, DRAG, MovePlan, RestToRest, Score, instant, score


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
    gust = cosine_gust(steady(0.0), 12.0, at=arrives - 10.0, lasts=10.0)
    return wind(crane, gust, direction=0.0, payload_area=DRAG)


@dataclass(frozen=True, eq=False)
class Misread:
    """A controller whose hoist reads less than the cable has: l = (1 + share) reading + offset.

    Attributes:
        crane: The crane.
        controller: What acts on the reading.
        share: By which share the cable is longer than it is read.
        offset: By how much it is longer besides, wherever the hoist stands [m].
    """

    crane: Crane
    controller: Controller
    share: float
    offset: float

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin a run, see `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command, shape (m,)."""
        hoist = self.crane.layout.index("l")
        q = state.q.copy()
        v = state.v.copy()
        q[hoist] = (q[hoist] - self.offset) / (1.0 + self.share)
        v[hoist] /= 1.0 + self.share
        return self.controller(t, State(q, v), setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form, see `cranedyn.controllers.affine`: what z - setpoint is to the
        reading, (z - added) / scale - setpoint, is that of the cable from scale setpoint + added,
        over scale.
        """
        layout = self.crane.layout
        form = affine_form(self.controller, times, positions, 2 * layout.n)
        if form is None:
            return None
        scale = np.ones(2 * layout.n)
        added = np.zeros(2 * layout.n)
        scale[layout.index("l") :: layout.n] += self.share  # position and rate
        added[layout.index("l")] = self.offset
        of_drives = scale[layout.drives]
        return replace(
            form,
            gain=form.gain / scale,
            setpoint=scale * form.setpoint + added,
            target=of_drives * form.target + added[layout.drives],
            integral_gain=form.integral_gain / of_drives,
            integral=of_drives * form.integral,
        )

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Resume a run, see `cranedyn.controllers.affine.Stateful`."""
        if isinstance(self.controller, Stateful):
            scale = 1.0 + self.share * self.crane.layout.along("l")
            self.controller.resume(t, integral / scale)


_observer = lru_cache(maxsize=1)(with_observer)
"""Observer without a controller, whose gains the cases of a move share."""

UNOBSERVED = "The observer uses efforts, not rates of converters."
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
    values = dict(perturbation.values)
    if perturbation.load != 1.0:
        values["payload_mass"] = perturbation.load * setup.crane.payload_mass
    crane = setup.variant(**values) if values else setup.crane
    misread = perturbation.cable, perturbation.offset
    first, last = (_stretched(crane, end, *misread) for end in move.ends(setup.crane))
    first.q[crane.swings] = move.swing
    controller = plan.controller()
    if perturbation.observer:
        if plan.motion is None:
            raise CraneError("An observer is linearised about a planned motion, and there is none.")
        if plan.drive == "velocity":
            raise CraneError(UNOBSERVED)
        controller = (
            replace(_observer(None, setup.crane, plan.motion, dt=setup.dt), controller=controller)
            if perturbation.observer == "state"
            else with_load_estimate(
                controller, setup.crane, plan.motion, sensors=perturbation.observer
            )
        )
        if setup.engine == "compiled" and isinstance(controller, LoadEstimateController):
            from cranedyn.compiled.load_filter_code import compile_load_estimate

            controller = compile_load_estimate(controller)
    if perturbation.noise or perturbation.delay:
        noise = perturbation.noise * noise_of(crane)
        controller = with_sensor_model(
            crane, controller, delay=perturbation.delay, noise=noise, rng=np.random.default_rng(1)
        )
    if any(misread):
        controller = Misread(crane, controller, *misread)
    disturbance = perturbation.disturbance
    planned = PlannedRun(
        crane,
        controller,
        plan.reference,
        first,
        instant(plan.arrives + after, setup.control_period),
        label,
        drive=plan.drive,
        disturbance=disturbance(crane, plan.arrives) if disturbance else None,
    )
    run = setup.make(planned)
    return run, score(crane, last, run, plan.arrives)


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
