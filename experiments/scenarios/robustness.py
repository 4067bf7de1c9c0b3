"""What a chunk of the sweep is: one strategy for the combined move, planned once, by many cranes
that are not quite those planned for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from cranedyn.compiled.batch import simulate_batch
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.shaped import Shaper, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.spline import spline
from cranedyn.theory import point_period
from experiments.harness.setup import Setup
from experiments.scenarios import strategies as strategies
from experiments.scenarios.moves import MOVES, Move

COMBINED = MOVES[-1]

AFTER = 10.0
"""How long after the arrival the residual swing is looked at [s]."""

CLOCKS = ("gravity_m_s2", "dt_s", "control_period_s")
"""Columns of a design that say in which world it takes place, the same in every case."""


def _shaped_spline(shaper: Shaper) -> Callable[[Setup, Move], strategies.Plan]:
    """The spline in less time, shaped for the mean cable length, so that it ends when the move
    should.
    """

    def plan(setup: Setup, move: Move) -> strategies.Plan:
        period = strategies.mean_period(setup, move)
        base = spline(
            setup.crane,
            move.ends(setup.crane)[0],
            [move.goal],
            [move.duration - period * float(shaper.fractions[-1])],
        )
        reference = shaped(base, shaper, period)
        return strategies.followed(setup, reference, move.duration)

    return plan


def _shaped_for_moving_cable(setup: Setup, move: Move) -> strategies.Plan:
    """The same by the shaper that knows how the cable moves."""
    shorter = move.duration - float(point_period(move.goal[2], setup.crane.gravity)) / 2.0
    base = spline(setup.crane, move.ends(setup.crane)[0], [move.goal], [shorter])
    reference = shaped_hoisting(setup.crane, base, zv(), shorter, step=setup.control_period)
    return strategies.followed(setup, reference, move.duration)


STRATEGIES: dict[str, Callable[[Setup, Move], strategies.Plan]] = {
    strategies.PD: strategies.STRATEGIES[strategies.PD],
    "spline alone": strategies.STRATEGIES["spline alone"],
    "spline, ZV": _shaped_spline(zv()),
    "spline, ZVD": _shaped_spline(zvd()),
    "spline, ZV for a moving cable": _shaped_for_moving_cable,
    strategies.PAPER: strategies.STRATEGIES[strategies.PAPER],
    strategies.LQR: strategies.STRATEGIES[strategies.LQR],
    strategies.FLAT: strategies.STRATEGIES[strategies.FLAT],
}
"""Plans by name. Those without a controller in their name have drives that follow exactly, as stiff
velocity-controlled drives do."""


def robustness(cases: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Make moves and see what is left of them; a study for `cranedyn.sweep`.

    Args:
        cases: Columns ``strategy``; ``duration_s`` planned for the move; ``load``, mass of the
            payload over that planned for; ``cable_error_m``, by how much the cable is longer than
            measured; and those of `CLOCKS`.

    Returns:
        Columns: largest swing and amplitude of the swing 10 s after the arrival [rad]; distance of
        the payload from its goal then [m]; largest efforts over those of the drives; time at which
        the model ceased to hold [s], masked where it held.
    """
    gravity, dt, control_period = (float(cases[name][0]) for name in CLOCKS)
    setup = Setup(gravity, dt=dt, control_period=control_period)
    found: dict[str, np.ndarray] = {}
    plans = np.stack([cases["strategy"].astype(object), cases["duration_s"].astype(object)], axis=1)
    for strategy, duration in dict.fromkeys(map(tuple, plans.tolist())):
        rows = np.flatnonzero((cases["strategy"] == strategy) & (cases["duration_s"] == duration))
        made = _made(setup, strategy, duration, cases["load"][rows], cases["cable_error_m"][rows])
        for name, values in made.items():
            found.setdefault(name, np.ma.masked_all(len(plans)))[rows] = values
    return found


def _made(
    setup: Setup, strategy: str, duration: float, loads: np.ndarray, errors: np.ndarray
) -> dict[str, np.ndarray]:
    move = replace(COMBINED, duration=duration)
    plan = STRATEGIES[strategy](setup, move)
    cranes = [_crane(setup.gravity, float(load) * setup.crane.payload_mass) for load in loads]
    start, goal = (_longer(setup.crane, end, errors) for end in move.ends(setup.crane))
    offset = np.zeros((len(errors), 2 * setup.crane.layout.n))
    offset[:, setup.crane.layout.index("l")] = -errors
    ends = strategies.instant(setup, plan.arrives + AFTER)
    batch = simulate_batch(
        cranes,
        plan.controller(),
        plan.reference,
        start=start,
        duration=ends,
        dt=setup.dt,
        control_period=setup.control_period,
        drive=plan.drive,
        sensor_offset=offset,
        residual_from=ends,
        threads=1,
    )
    places = zip(cranes, batch.end.q, goal.q, strict=True)
    away = [
        np.linalg.norm(payload_position(crane, q) - payload_position(crane, aim))
        for crane, q, aim in places
    ]
    shares = batch.largest_effort / setup.crane.effort_limit
    return {
        "peak_swing_rad": batch.peak_swing,
        "residual_swing_rad": batch.residual_swing,
        "off_goal_m": np.array(away),
        **{
            f"{drive}_effort_share": shares[:, i]
            for i, drive in enumerate(("slew", "trolley", "hoist"))
        },
        "valid_until_s": np.ma.masked_invalid(batch.valid_until),
    }


def _longer(crane: Crane, state: State, by: np.ndarray) -> State:
    """Many states with cables longer by so much [m]."""
    q = np.tile(state.q, (len(by), 1))
    q[:, crane.layout.index("l")] += by
    return State(q, np.zeros_like(q))


@lru_cache(maxsize=4096)
def _crane(gravity: float, payload_mass: float) -> Crane:
    """The crane with another load, the same object for the same load."""
    return Setup(gravity).variant(payload_mass=payload_mass)
