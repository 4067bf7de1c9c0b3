"""Moves from rest to rest, the ways to make them, and what each leaves behind; shared by the control experiments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cranedyn.analysis import settling_time, swing_amplitude
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import paper_controller
from cranedyn.crane import DRIVES, Crane, State
from cranedyn.dynamics import payload_position
from cranedyn.references.flat import flat
from cranedyn.references.motion import plumb
from cranedyn.references.spline import spline
from cranedyn.references.wanted import Reference
from cranedyn.simulate import Controller, Drive
from cranedyn.trajectory import Trajectory
from experiments import common

CLOSE = 0.010
"""How near the payload must stay to its goal to count as settled [m]."""

AFTER = 20.0
"""How long a move is watched after the arrival [s]."""


@dataclass(frozen=True)
class Move:
    """From one rest to another.

    Attributes:
        name: What it is called.
        start: Slew [rad], trolley radius [m], cable length [m] at the start.
        goal: The same at the end.
        duration: Time for it [s].
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    duration: float

    def ends(self, crane: Crane) -> tuple[State, State]:
        """Start and goal as states at rest."""
        first, last = (crane.state(gamma=end[0], x=end[1], l=end[2]) for end in (self.start, self.goal))
        return first, last


MOVES = (
    Move("trolley", (0.0, 10.0, 15.0), (0.0, 20.0, 15.0), 20.0),
    Move("slew", (0.0, 15.0, 15.0), (0.6, 15.0, 15.0), 20.0),
    Move("combined", (0.0, 10.0, 15.0), (0.6, 20.0, 10.0), 20.0),
)
"""Single axes and all three together."""


def _spline(crane: Crane, move: Move) -> Reference:
    return spline(move.ends(crane)[0], [move.goal], [move.duration])


def _alone(world: common.World, move: Move) -> tuple[Controller, Reference, Drive]:
    reference = _spline(world.crane, move)
    return follow(reference, world.control_period), reference, "motion"


def _held(world: common.World, move: Move) -> tuple[Controller, Reference, Drive]:
    return hold_controller(world.crane), _spline(world.crane, move), "effort"


def _paper(world: common.World, move: Move) -> tuple[Controller, Reference, Drive]:
    reference = _spline(world.crane, move)
    return paper_controller(world.crane, plumb(reference, move.duration, world.control_period)), reference, "effort"


def _lqr(world: common.World, move: Move) -> tuple[Controller, Reference, Drive]:
    reference = _spline(world.crane, move)
    return lqr(world.crane, plumb(reference, move.duration, world.control_period), dt=world.dt), reference, "effort"


def _flat(world: common.World, move: Move) -> tuple[Controller, Reference, Drive]:
    motion = flat(world.crane, *move.ends(world.crane), move.duration, period=world.control_period)
    return lqr(world.crane, motion, dt=world.dt), motion, "effort"


WAYS: dict[str, Callable[[common.World, Move], tuple[Controller, Reference, Drive]]] = {
    "spline alone": _alone,
    "spline + PD": _held,
    "paper's LQR + PID": _paper,
    "full-model LQR": _lqr,
    "flat + LQR": _flat,
}
"""Ways to make a move: controller, reference and kind of drive for each. The spline alone has drives that follow it exactly."""


def make(world: common.World, move: Move, way: str) -> Trajectory:
    """Make a move in one way and watch what is left."""
    controller, reference, drive = WAYS[way](world, move)
    start = move.ends(world.crane)[0]
    return world.simulate(
        world.crane, controller, reference, start=start, duration=move.duration + AFTER, label=f"{move.name}, {way}", drive=drive
    )


@dataclass(frozen=True)
class Score:
    """What a move was like.

    Attributes:
        peak: Largest swing on the way [rad], radial and tangential together.
        arrival: Amplitude of the swing at the arrival [rad].
        later: Amplitude of the swing 20 s after it [rad].
        hook: That amplitude as a way of the payload [mm].
        settled: Time after the arrival from which the payload stays within 10 mm of its goal [s]; inf if it does not.
        tracking: Largest distance of the drives from their reference: slew [mrad], trolley [mm], hoist [mm].
        effort: Largest effort of the drives beyond holding the load at rest [N m, N, N].
    """

    peak: float
    arrival: float
    later: float
    hook: float
    settled: float
    tracking: np.ndarray
    effort: np.ndarray


def score(crane: Crane, move: Move, run: Trajectory) -> Score:
    """Score a run of a move."""
    amplitude = swing_amplitude(run.q[:, 2:4], run.v[:, 2:4], run.q[:, 4], crane.gravity)
    goal = payload_position(crane, move.ends(crane)[1].q)
    after = run.since(move.duration - 1e-9)
    distance = np.linalg.norm([payload_position(crane, q) - goal for q in after.q], axis=1)
    at = round(move.duration / float(run.t[1] - run.t[0]))
    holding = np.array([0.0, 0.0, -crane.payload_mass * crane.gravity])
    return Score(
        peak=float(np.linalg.norm(run.q[:, 2:4], axis=1).max()),
        arrival=float(amplitude[at]),
        later=float(amplitude[-1]),
        hook=1000.0 * float(amplitude[-1] * run.q[-1, 4]),
        settled=settling_time(after.t - move.duration, distance, CLOSE),
        tracking=1000.0 * np.abs(run.q[:, DRIVES] - run.wanted).max(axis=0),
        effort=np.abs(run.effort - holding).max(axis=0),
    )
