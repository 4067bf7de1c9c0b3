"""What is made for any crane, on each of them: hold, LQR, MPC, observer, least time, wind,
batch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import steady, wind
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.linearisation import free_modes, sampled
from cranedyn.dynamics.pinocchio import point_positions
from cranedyn.estimation.mpc import mpc
from cranedyn.estimation.observer import with_observer
from cranedyn.interfaces import Controller, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.planning.optimal import optimal
from cranedyn.references import hold
from cranedyn.references.limits import use
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.simulation.simulate import simulate
from experiments.relatives.catalogue import Relative, moved, relative_crane, rest_at
from experiments.scenarios.moves import of_sampling

SWING, DURATION = 0.05, 10.0
"""Swing of all swing joints at the start [rad], and for how long controllers have their way [s]."""

WAY = 2.0
"""Of the trolley in the moves of least time [m]."""

GUST, AREA = 15.0, 4.0
"""Speed of the wind [m/s], and drag area of the load [m²]."""

_DT, _PERIOD, _COPIES = 1e-3, 5e-3, 8


class ControlResult(NamedTuple):
    """What became of one crane.

    Attributes:
        relative: Which.
        pull: How far the trolley may give way to the load under the hold controller: twice m g
            φ/k_p, as at once [m].
        deflection: How far it does at most [m].
        left_by_hold, left_by_lqr, left_by_observer, left_by_mpc: Swing left by each [rad].
        predicted: Left by the LQR in the linear closed loop, from the same start [rad].
        efforts: Largest share of an effort limit that the MPC uses.
        arrival: Of the move of least time [s].
        residual: Swing left from there on, all modes together [rad].
        sampling: What it may leave, since efforts are held for a control period, see
            `experiments.scenarios.moves.of_sampling` [rad].
        limits: Largest share of a limit of rate, acceleration or effort that the move uses.
        blown: How far the wind moves the load [m].
        open: Share of the wind's work that the ledger leaves open.
        lanes: Largest difference between a batch and runs one by one [rad, m, per second].
        run: The move of least time.
    """

    relative: Relative
    pull: float
    deflection: float
    left_by_hold: float
    left_by_lqr: float
    left_by_observer: float
    left_by_mpc: float
    predicted: float
    efforts: float
    arrival: float
    residual: float
    sampling: float
    limits: float
    blown: float
    open: float
    lanes: float
    run: Trajectory


def run_controllers(relative: Relative, engine: EngineName = "pinocchio") -> ControlResult:
    """Control one crane by each controller, with an engine."""
    crane = relative_crane(relative)
    start = moved(crane, **{crane.layout.symbols[i]: SWING for i in crane.swings})
    reference = hanging_reference(crane, hold(crane, crane.start), 2 * _PERIOD, _PERIOD)
    regulator = lqr(crane, reference, dt=_DT)

    def run(controller: Controller) -> Trajectory:
        clocks = {"duration": DURATION, "dt": _DT, "control_period": _PERIOD}
        return simulate(crane, controller, reference, start=start, engine=engine, **clocks)  # type: ignore[arg-type]

    brake = hold_controller(crane)
    with_hold, damped, observed = (
        run(brake),
        run(regulator),
        run(with_observer(regulator, crane, reference, dt=_DT)),
    )
    ahead = run(mpc(crane, reference, dt=_DT, period=10 * _PERIOD, horizon=20))
    motion, move = _least_time(relative, crane, engine)
    goal = State(motion.q[-1], motion.v[-1])
    drive = crane.layout.drive("x")
    hanging = list(crane.model.inertias)[crane.layout.index("phi") + 1 :]
    weight = sum(float(body.mass) for body in hanging) * crane.gravity
    blown, missing = _blown(crane, engine)
    return ControlResult(
        relative,
        2.0 * weight * SWING / float(brake.stiffness[drive]),
        float(np.abs(with_hold["x_m"] - with_hold["x_m"][0]).max()),
        swing_left(crane, crane.start, with_hold),
        swing_left(crane, crane.start, damped),
        swing_left(crane, crane.start, observed),
        swing_left(crane, crane.start, ahead),
        _predicted(crane, regulator, start),
        float((np.abs(ahead.effort) / crane.effort_limit).max()),
        motion.arrival,
        swing_left(crane, goal, move, motion.arrival),
        _sampling(crane, goal, motion),
        max(use(crane, motion, relative.limits).values()),
        blown,
        missing,
        _lanes(crane, regulator, reference, start),
        move,
    )


def swing_left(crane: Crane, goal: State, run: Trajectory, since: float | None = None) -> float:
    """Return the largest swing that the modes about a rest can still make together in any swing
    joint [rad], at a time or at the end.
    """
    modes = free_modes(crane, goal)
    row = len(run) - 1 if since is None else int(np.searchsorted(run.t, since - 1e-9))
    reach = np.abs(modes.shapes[np.isin(modes.passive, crane.swings)])
    return float((reach @ modes.amplitudes(run.q[row : row + 1], run.v[row : row + 1])[0]).max())


def _least_time(relative: Relative, crane: Crane, engine: EngineName) -> tuple[Motion, Trajectory]:
    x = float(crane.start.q[crane.layout.index("x")])
    goal = rest_at(crane, x=x + WAY)
    still = [joint.symbol for joint in crane.layout.driven if joint.symbol != "x"]
    motion = optimal(
        crane, crane.start, goal, relative.limits, ramp=1.0, still=still, period=_PERIOD
    )
    tracking = lqr(crane, motion, dt=_DT)
    duration = _PERIOD * round((motion.arrival + 1.0) / _PERIOD)
    return motion, simulate(
        crane, tracking, motion, duration=duration, dt=_DT, control_period=_PERIOD, engine=engine
    )


def _sampling(crane: Crane, goal: State, motion: Motion) -> float:
    """Return the bound of `of_sampling` for the fastest mode that swings."""
    modes = free_modes(crane, goal)
    swinging = np.abs(modes.shapes[np.isin(modes.passive, crane.swings)]).max(
        axis=0
    ) > 0.01 * np.abs(modes.shapes).max(axis=0)
    length = crane.gravity / float(modes.frequencies[swinging].max()) ** 2
    return of_sampling(
        crane.gravity, length, _PERIOD, float(np.abs(motion.q[:, crane.swings]).max())
    )


def _predicted(crane: Crane, regulator: Tracking, start: State) -> float:
    """Return the swing that the linear closed loop leaves at the end [rad]."""
    loop = sampled(crane, crane.start, dt=_DT, control_period=_PERIOD).closed(regulator.gain[-1])
    z = np.linalg.matrix_power(loop, round(DURATION / _PERIOD)) @ np.concatenate(
        [start.q - crane.start.q, start.v]
    )
    q, v = np.split(z, 2)
    modes = free_modes(crane, crane.start)
    reach = np.abs(modes.shapes[np.isin(modes.passive, crane.swings)])
    return float((reach @ modes.amplitudes(crane.start.q[None] + q, v[None])[0]).max())


def _blown(crane: Crane, engine: EngineName) -> tuple[float, float]:
    """Return the offset of the load in a steady wind [m], and the relative error of its work."""
    breeze = wind(crane, steady(GUST), direction=0.0, payload_area=AREA)
    run = simulate(
        crane,
        hold_controller(crane),
        disturbance=breeze,
        duration=4.0,
        dt=_PERIOD,
        control_period=_PERIOD,
        integrator=rk4,
        engine=engine,
    )
    offset = point_positions(crane, run.q[-1])[0] - point_positions(crane, run.q[0])[0]
    return float(np.linalg.norm(offset)), float(
        np.abs(run.unexplained).max() / np.abs(run["W_force_J"]).max()
    )


def _lanes(crane: Crane, regulator: Controller, motion: Motion, start: State) -> float:
    """Compare a batch of cranes that start with swings of their own to two of them run alone."""
    shares = np.linspace(0.2, 1.0, _COPIES)
    starts = [State(crane.start.q + share * (start.q - crane.start.q), start.v) for share in shares]
    times = {"duration": 2.0, "dt": _DT, "control_period": _PERIOD}
    batch = simulate_batch(crane, regulator, motion, start=starts, **times)  # type: ignore[arg-type]
    worst = 0.0
    for i in (0, _COPIES - 1):
        alone = simulate(crane, regulator, motion, start=starts[i], engine="compiled", **times)  # type: ignore[arg-type]
        worst = max(
            worst,
            *(
                float(np.abs(a - b[-1]).max())
                for a, b in zip((batch.end.q[i], batch.end.v[i]), (alone.q, alone.v), strict=True)
            ),
        )
    return worst
