"""What is made for any crane, on each of them: hold, LQR, MPC, observer, least time, wind,
batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

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
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.relatives.agreement import ROUNDING
from experiments.relatives.catalogue import (
    RELATIVES,
    Relative,
    at_start,
    moved,
    relative_crane,
    rest_at,
)
from experiments.scenarios.moves import of_sampling

SWING, DURATION = 0.05, 10.0
"""Swing of all swing joints at the start [rad], and for how long controllers have their way [s]."""

WAY = 2.0
"""Of the trolley in the moves of least time [m]."""

GUST, AREA = 15.0, 4.0
"""Speed of the wind [m/s], and drag area of the load [m²]."""

HALF = 0.5
"""A controller that damps leaves at most this share of what the hold controller leaves in the same
time."""

ALIKE = 0.05
"""Of the swing left: how far MPC and LQR may differ, whose periods are 50 ms and 5 ms, and the run
from the linear loop, at 0.05 rad."""

LEDGER = 1e-10
"""Share of the wind's work: energies of 1e6 J are known to 1e-10 J, the work is 100 J, and there
are 800 rows."""

_DT, _PERIOD, _COPIES = 1e-3, 5e-3, 8
_CLOCKS: dict[str, Any] = {"dt": _DT, "control_period": _PERIOD}


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


def study(setup: Setup) -> Outcome:
    """Control each crane by each controller."""
    results = [_controlled(relative, setup.engine) for relative in RELATIVES]
    return Outcome([_table(results)], _claims(results))


def _controlled(relative: Relative, engine: EngineName) -> ControlResult:
    crane = relative_crane(relative)
    start = moved(crane, **{crane.layout.symbols[i]: SWING for i in crane.swings})
    reference = hanging_reference(crane, hold(crane, crane.start), 2 * _PERIOD, _PERIOD)
    regulator = lqr(crane, reference, dt=_DT)

    def run(controller: Controller) -> Trajectory:
        return simulate(
            crane, controller, reference, start=start, duration=DURATION, engine=engine, **_CLOCKS
        )

    residual = partial(_swing_left, crane, crane.start)
    brake = hold_controller(crane)
    with_hold = run(brake)
    damped = run(regulator)
    observed = run(with_observer(regulator, crane, reference, dt=_DT))
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
        residual(with_hold),
        residual(damped),
        residual(observed),
        residual(ahead),
        _predicted(crane, regulator, start),
        float((np.abs(ahead.effort) / crane.effort_limit).max()),
        motion.arrival,
        _swing_left(crane, goal, move, motion.arrival),
        _sampling(crane, goal, motion),
        max(use(crane, motion, relative.limits).values()),
        blown,
        missing,
        _lanes(crane, regulator, reference, start),
        move,
    )


def _swing_left(crane: Crane, goal: State, run: Trajectory, since: float | None = None) -> float:
    """Return the largest swing that the modes about a rest can still make together in any swing
    joint [rad], at a time or at the end.
    """
    row = len(run) - 1 if since is None else int(np.searchsorted(run.t, since - 1e-9))
    return _swing(crane, goal, *run.state(row))


def _swing(crane: Crane, goal: State, q: np.ndarray, v: np.ndarray) -> float:
    modes = free_modes(crane, goal)
    reach = np.abs(modes.shapes[np.isin(modes.passive, crane.swings)])
    return float((reach @ modes.amplitudes(q[None], v[None])[0]).max())


def _least_time(relative: Relative, crane: Crane, engine: EngineName) -> tuple[Motion, Trajectory]:
    goal = rest_at(crane, x=at_start(crane, "x") + WAY)
    still = [joint.symbol for joint in crane.layout.driven if joint.symbol != "x"]
    motion = optimal(
        crane, crane.start, goal, relative.limits, ramp=1.0, still=still, period=_PERIOD
    )
    tracking = lqr(crane, motion, dt=_DT)
    duration = _PERIOD * round((motion.arrival + 1.0) / _PERIOD)
    return motion, simulate(crane, tracking, motion, duration=duration, engine=engine, **_CLOCKS)


def _sampling(crane: Crane, goal: State, motion: Motion) -> float:
    """Return the bound of `of_sampling` for the fastest mode that swings."""
    modes = free_modes(crane, goal)
    shapes = np.abs(modes.shapes)
    swinging = shapes[np.isin(modes.passive, crane.swings)].max(axis=0) > 0.01 * shapes.max(axis=0)
    length = crane.gravity / float(modes.frequencies[swinging].max()) ** 2
    peak = float(np.abs(motion.q[:, crane.swings]).max())
    return of_sampling(crane.gravity, length, _PERIOD, peak)


def _predicted(crane: Crane, regulator: Tracking, start: State) -> float:
    """Return the swing that the linear closed loop leaves at the end [rad]."""
    loop = sampled(crane, crane.start, dt=_DT, control_period=_PERIOD).closed(regulator.gain[-1])
    z = np.linalg.matrix_power(loop, round(DURATION / _PERIOD)) @ np.concatenate(
        [start.q - crane.start.q, start.v]
    )
    q, v = np.split(z, 2)
    return _swing(crane, crane.start, crane.start.q + q, v)


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
    times = {"duration": 2.0, **_CLOCKS}
    batch = simulate_batch(crane, regulator, motion, start=starts, **times)
    worst = 0.0
    for i in (0, _COPIES - 1):
        alone = simulate(crane, regulator, motion, start=starts[i], engine="compiled", **times)
        ends = zip((batch.end.q[i], batch.end.v[i]), alone.state(-1), strict=True)
        worst = max(worst, *(float(np.abs(a - b).max()) for a, b in ends))
    return worst


def _table(results: Sequence[ControlResult]) -> ResultTable:
    return make_table(
        "Control",
        results,
        ("crane", "", lambda c: c.relative.name),
        ("yields [mm]", ".2f", lambda c: 1e3 * c.deflection),
        ("hold [mrad]", ".2f", lambda c: 1e3 * c.left_by_hold),
        ("LQR", ".2f", lambda c: 1e3 * c.left_by_lqr),
        ("observer", ".2f", lambda c: 1e3 * c.left_by_observer),
        ("MPC", ".2f", lambda c: 1e3 * c.left_by_mpc),
        ("least time [s]", ".2f", lambda c: c.arrival),
        ("residual [mrad]", ".3f", lambda c: 1e3 * c.residual),
        ("limits [%]", ".1f", lambda c: 100.0 * c.limits),
        ("wind [m]", ".2f", lambda c: c.blown),
        ("batch", ".0e>1e-12", lambda c: c.lanes),
        note=f"From {1e3 * SWING:g} mrad in each swing joint: yield of the trolley under the hold "
        "controller, and swing after 10 s under each controller. Least time: a move of the trolley "
        f"by {WAY:g} m. Wind: way of the load in {GUST:g} m/s on {AREA:g} m² for 4 s. Batch: "
        "largest difference of eight cranes at once from single runs [rad, m, per second].",
    )


def _claims(controls: Sequence[ControlResult]) -> list[Claim]:
    damped = max(
        max(c.left_by_lqr, c.left_by_observer, c.left_by_mpc) / c.left_by_hold for c in controls
    )
    predicted = max(abs(c.left_by_lqr / c.predicted - 1.0) for c in controls)
    alike = max(abs(c.left_by_mpc / c.left_by_lqr - 1.0) for c in controls)
    gives = max(c.deflection / c.pull for c in controls)
    late = max(c.residual / c.sampling for c in controls)
    return [
        Claim(
            f"Hold: the trolley gives way by {100 * gives:.0f} % at most of what a pull at once, 2 "
            "m g φ, allows.",
            all(c.deflection < c.pull for c in controls),
        ),
        Claim(
            "LQR, LQR with an observer that sees the drives alone, and MPC leave "
            f"{100 * damped:.0f} % at most of what the hold leaves (allowed {100 * HALF:g} %).",
            damped < HALF,
        ),
        Claim(
            f"LQR: {100 * predicted:.1f} % off the linear loop at most (allowed {100 * ALIKE:g} "
            "%).",
            predicted < ALIKE,
        ),
        Claim(
            f"MPC is the LQR where no limit binds: {100 * alike:.1f} % apart (allowed "
            f"{100 * ALIKE:g} %), efforts up to "
            f"{100 * max(c.efforts for c in controls):.0f} % of their limits.",
            alike < ALIKE and all(c.efforts <= 1.0 for c in controls),
        ),
        Claim(
            "Moves of least time keep all limits and end at rest in all modes: "
            f"{1e3 * max(c.residual for c in controls):.3f} mrad, "
            f"{100 * late:.0f} % at most of what efforts held for 5 ms may leave.",
            late < 1.0 and all(c.limits < 1.0 + 1e-6 for c in controls),
        ),
        Claim(
            f"Wind: its work is in the ledger to {max(c.open for c in controls):.0e} (allowed "
            f"{LEDGER:.0e}), and it moves every load.",
            all(c.open < LEDGER and c.blown > 0.01 for c in controls),
        ),
        Claim(
            f"Cranes of a batch move as alone: {max(c.lanes for c in controls):.0e} (allowed "
            f"{ROUNDING:.0e}).",
            all(c.lanes < ROUNDING for c in controls),
        ),
    ]
