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
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.linearisation import free_modes, sampled
from cranedyn.estimation.mpc import mpc
from cranedyn.estimation.observer import with_observer
from cranedyn.interfaces import Controller, EngineName, State
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.references.limits import use
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.simulation.simulate import simulate
from experiments.cranes.agreement import ROUNDING
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import (
    CRANE_VARIANTS,
    CraneVariant,
    at_start,
    moved,
    rest_at,
    variant_crane,
)
from experiments.scenarios.moves import sampling_swing

SWING = 0.05
"""Angle of all swing joints at the start [rad]."""

DURATION = 10.0
"""Time for which controllers damp the swing [s]."""

TRAVEL = 2.0
"""Distance of the trolley in the moves of least time [m]."""

WIND_SPEED = 15.0
"""Speed of the wind [m/s]."""

DRAG_AREA = 4.0
"""Drag coefficient times area of the load [m²]."""

MAX_DAMPED_SHARE = 0.5
"""Largest swing that a controller which damps leaves, over that which the hold controller leaves in
the same time."""

SWING_TOLERANCE = 0.05
"""Largest relative difference of the swing that is left.

MPC and LQR differ in their periods, 50 ms and 5 ms; a run differs from the linear loop by its
finite swing of 0.05 rad.
"""

LEDGER_TOLERANCE = 1e-10
"""Largest share of the wind's work that the energy ledger leaves unexplained.

Energies of 1e6 J are known to 1e-10 J, the work is 100 J, and there are 800 rows.
"""

STEP = 1e-3
"""Physics step [s]."""

PERIOD = 5e-3
"""Time between control instants [s]."""

COPIES = 8
"""Number of cranes in a batch."""

CLOCKS: dict[str, Any] = {"dt": STEP, "control_period": PERIOD}
"""Both clocks, as functions that run a crane take them."""


class ControlResult(NamedTuple):
    """Result of one crane.

    Attributes:
        variant: The crane.
        pull: Bound of the deflection of the trolley under the hold controller [m]. The load pulls
            with m g φ against the stiffness k_p; applied at once, that deflects by twice m g φ/k_p.
        deflection: Largest deflection of the trolley in the run [m].
        left_by_hold: Swing that the hold controller leaves [rad].
        left_by_lqr: Swing that the LQR leaves [rad].
        left_by_observer: Swing that the LQR leaves with an observer that measures the drives [rad].
        left_by_mpc: Swing that the MPC leaves [rad].
        predicted: Swing that the LQR leaves in the linear closed loop, from the same start [rad].
        efforts: Largest effort of the MPC over its limit.
        arrival: Duration of the move of least time [s].
        residual: Residual swing of this move, all modes together [rad].
        sampling: Bound of that, since efforts are held for a control period, see
            `experiments.scenarios.moves.sampling_swing` [rad].
        limits: Largest rate, acceleration or effort of the move over its limit.
        blown: Distance by which the wind moves the load [m].
        open: Share of the wind's work that the energy ledger leaves unexplained.
        lanes: Largest difference between a batch and single runs [rad, m, per second].
        run: The move of least time.
    """

    variant: CraneVariant
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
    results = [_controlled(variant, setup.engine_of_runs) for variant in CRANE_VARIANTS]
    return Outcome([_table(results)], _claims(results))


def _controlled(variant: CraneVariant, engine: EngineName | None) -> ControlResult:
    """Control a crane by each controller, from a swing in all swing joints."""
    crane = variant_crane(variant)
    start = moved(crane, **{crane.layout.symbols[i]: SWING for i in crane.swings})
    reference = hanging_reference(crane, hold(crane, crane.start), 2 * PERIOD, PERIOD)
    regulator = lqr(crane, reference, dt=STEP)

    def run(controller: Controller) -> Trajectory:
        return simulate(
            crane, controller, reference, start=start, duration=DURATION, engine=engine, **CLOCKS
        )

    residual = partial(_swing_left, crane, crane.start)
    brake = hold_controller(crane)
    with_hold = run(brake)
    damped = run(regulator)
    observed = run(with_observer(regulator, crane, reference, dt=STEP))
    ahead = run(mpc(crane, reference, dt=STEP, period=10 * PERIOD, horizon=20))
    motion, move = _least_time(variant, crane, engine)
    goal = State(motion.q[-1], motion.v[-1])
    drive = crane.layout.drive("x")
    # All that hangs: the bodies behind the radial swing joint, in chain order. Bodies count from 1.
    hanging = list(crane.model.inertias)[crane.layout.index("phi") + 1 :]
    weight = sum(float(body.mass) for body in hanging) * crane.gravity
    blown, unexplained = _blown(crane, engine)
    return ControlResult(
        variant=variant,
        pull=2.0 * weight * SWING / float(brake.stiffness[drive]),
        deflection=float(np.abs(with_hold["x_m"] - with_hold["x_m"][0]).max()),
        left_by_hold=residual(with_hold),
        left_by_lqr=residual(damped),
        left_by_observer=residual(observed),
        left_by_mpc=residual(ahead),
        predicted=_predicted(crane, regulator, start),
        efforts=float((np.abs(ahead.effort) / crane.effort_limit).max()),
        arrival=motion.arrival,
        residual=_swing_left(crane, goal, move, motion.arrival),
        sampling=_sampling(crane, goal, motion),
        limits=max(use(crane, motion, variant.limits).values()),
        blown=blown,
        open=unexplained,
        lanes=_lanes(crane, regulator, reference, start),
        run=move,
    )


def _swing_left(crane: Crane, goal: State, run: Trajectory, since: float | None = None) -> float:
    """Return the largest swing that all modes can still make together in any swing joint [rad].

    Args:
        crane: The crane.
        goal: State of rest about which the modes swing.
        run: The run.
        since: Time at which the modes are read [s]; the end of the run if None.
    """
    row = len(run) - 1 if since is None else int(np.searchsorted(run.t, since - 1e-9))
    return _swing(crane, goal, *run.state(row))


def _swing(crane: Crane, goal: State, q: np.ndarray, v: np.ndarray) -> float:
    """Return the same for a state: the amplitudes of all modes, each by its share in a joint.

    Args:
        crane: The crane.
        goal: State of rest about which the modes swing.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
    """
    modes = free_modes(crane, goal)
    shares = np.abs(modes.shapes[np.isin(modes.passive, crane.swings)])
    return float((shares @ modes.amplitudes(q[None], v[None])[0]).max())


def _least_time(
    variant: CraneVariant, crane: Crane, engine: EngineName | None
) -> tuple[Motion, Trajectory]:
    """Return a motion of least time of the trolley, and a run in which an LQR tracks it."""
    goal = rest_at(crane, x=at_start(crane, "x") + TRAVEL)
    still = [joint.symbol for joint in crane.layout.driven if joint.symbol != "x"]
    motion = optimal(crane, crane.start, goal, variant.limits, ramp=1.0, still=still, period=PERIOD)
    tracking = lqr(crane, motion, dt=STEP)
    duration = PERIOD * round((motion.arrival + 1.0) / PERIOD)
    return motion, simulate(crane, tracking, motion, duration=duration, engine=engine, **CLOCKS)


def _sampling(crane: Crane, goal: State, motion: Motion) -> float:
    """Return the bound of `sampling_swing` for the fastest mode that swings [rad].

    Args:
        crane: The crane.
        goal: State of rest about which the modes swing.
        motion: The planned motion, whose largest swing counts.
    """
    modes = free_modes(crane, goal)
    shapes = np.abs(modes.shapes)
    # A mode swings if a swing joint has more than a hundredth of it.
    in_swing_joints = shapes[np.isin(modes.passive, crane.swings)].max(axis=0)
    swinging = in_swing_joints > 0.01 * shapes.max(axis=0)
    # The pendulum of the same frequency.
    length = crane.gravity / float(modes.frequencies[swinging].max()) ** 2
    peak = float(np.abs(motion.q[:, crane.swings]).max())
    return sampling_swing(crane.gravity, length, PERIOD, peak)


def _predicted(crane: Crane, regulator: Tracking, start: State) -> float:
    """Return the swing that the linear closed loop leaves at the end [rad]."""
    loop = sampled(crane, crane.start, dt=STEP, control_period=PERIOD).closed(regulator.gain[-1])
    deviation = np.concatenate([start.q - crane.start.q, start.v])
    z = np.linalg.matrix_power(loop, round(DURATION / PERIOD)) @ deviation
    q, v = np.split(z, 2)
    return _swing(crane, crane.start, crane.start.q + q, v)


def _blown(crane: Crane, engine: EngineName | None) -> tuple[float, float]:
    """Return the offset of the load in a steady wind [m], and the relative error of its work."""
    breeze = wind(crane, steady(WIND_SPEED), direction=0.0, payload_area=DRAG_AREA)
    run = simulate(
        crane,
        hold_controller(crane),
        disturbance=breeze,
        duration=4.0,
        dt=PERIOD,
        control_period=PERIOD,
        integrator=rk4,
        engine=engine,
    )
    offset = point_positions(crane, run.q[-1])[0] - point_positions(crane, run.q[0])[0]
    unexplained = float(np.abs(run.unexplained).max() / np.abs(run["W_force_J"]).max())
    return float(np.linalg.norm(offset)), unexplained


def _lanes(crane: Crane, regulator: Controller, motion: Motion, start: State) -> float:
    """Compare a batch of cranes that start with swings of their own to two of them run alone."""
    shares = np.linspace(0.2, 1.0, COPIES)
    starts = [State(crane.start.q + share * (start.q - crane.start.q), start.v) for share in shares]
    duration = 2.0
    batch = simulate_batch(crane, regulator, motion, start=starts, duration=duration, **CLOCKS)
    worst = 0.0
    for i in (0, COPIES - 1):
        alone = simulate(
            crane,
            regulator,
            motion,
            start=starts[i],
            engine="compiled",
            duration=duration,
            **CLOCKS,
        )
        end = alone.state(-1)
        position_difference = float(np.abs(batch.end.q[i] - end.q).max())
        rate_difference = float(np.abs(batch.end.v[i] - end.v).max())
        worst = max(worst, position_difference, rate_difference)
    return worst


def _table(results: Sequence[ControlResult]) -> ResultTable:
    return make_table(
        "Control",
        results,
        ("crane", "", lambda c: c.variant.name),
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
        f"by {TRAVEL:g} m. Wind: way of the load in {WIND_SPEED:g} m/s on {DRAG_AREA:g} m² for "
        "4 s. Batch: largest difference of eight cranes at once from single runs [rad, m, per "
        "second].",
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
            f"{100 * damped:.0f} % at most of what the hold leaves (allowed "
            f"{100 * MAX_DAMPED_SHARE:g} %).",
            damped < MAX_DAMPED_SHARE,
        ),
        Claim(
            f"LQR: {100 * predicted:.1f} % off the linear loop at most (allowed "
            f"{100 * SWING_TOLERANCE:g} %).",
            predicted < SWING_TOLERANCE,
        ),
        Claim(
            f"MPC is the LQR where no limit binds: {100 * alike:.1f} % apart (allowed "
            f"{100 * SWING_TOLERANCE:g} %), efforts up to "
            f"{100 * max(c.efforts for c in controls):.0f} % of their limits.",
            alike < SWING_TOLERANCE and all(c.efforts <= 1.0 for c in controls),
        ),
        Claim(
            "Moves of least time keep all limits and end at rest in all modes: "
            f"{1e3 * max(c.residual for c in controls):.3f} mrad, at most "
            f"{100 * late:.0f} % of what drives may leave that get a new effort every 5 ms only.",
            late < 1.0 and all(c.limits < 1.0 + 1e-6 for c in controls),
        ),
        Claim(
            f"Wind: its work is in the ledger to {max(c.open for c in controls):.0e} (allowed "
            f"{LEDGER_TOLERANCE:.0e}), and it moves every load.",
            all(c.open < LEDGER_TOLERANCE and c.blown > 0.01 for c in controls),
        ),
        Claim(
            f"Cranes of a batch move as alone: {max(c.lanes for c in controls):.0e} (allowed "
            f"{ROUNDING:.0e}).",
            all(c.lanes < ROUNDING for c in controls),
        ),
    ]
