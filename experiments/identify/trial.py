"""A record to try identification on, made by a crane that is not as one believes; and controllers
tried on the crane that was found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification import Estimate, Prior, Record
from cranedyn.identification.motion import SampledMotion, lagged
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning.joystick import JoystickPulse, joystick
from cranedyn.simulation.simulate import simulate
from experiments.harness import Setup
from experiments.scenarios import strategies
from experiments.scenarios.moves import COMBINED, LIMITS, instant

TRUTH = {
    "l_offset": 0.37,
    "damp_swing": 2000.0,
    "delay": 0.08,
    "phi_bias": 4e-3,
    "theta_bias": -3e-3,
    "gamma_lag": 0.25,
    "x_lag": 0.25,
    "l_lag": 0.25,
}
"""What is true of the crane of the trial and not believed of it."""

DURATION, INTERVAL, NOISE, ENCODER = 120.0, 0.05, 2e-3, {"rad": 1e-4, "m": 1e-3}
"""Of its record: how long it lasts and from row to row [s], noise of the swing [rad] and of the
drives [their unit]."""

PULSES = (
    JoystickPulse("x", 0.6, 2.0, 5.0),
    JoystickPulse("gamma", 0.08, 12.0, 6.0),
    JoystickPulse("l", 0.4, 30.0, 5.0),
    JoystickPulse("x", -0.6, 45.0, 5.0),
    JoystickPulse("gamma", -0.08, 62.0, 6.0),
    JoystickPulse("l", -0.4, 80.0, 5.0),
    JoystickPulse("x", 0.4, 92.0, 3.0),
)
"""What an operator does meanwhile."""

TRIED = (strategies.PD, strategies.FLAT)
"""Strategies that are tried on a twin."""

DRAWS, AFTER = 64, 10.0
"""How many cranes as sure as the estimate is, and how long after the arrival the swing is looked at
[s]."""

_STEP = 5e-3


@dataclass(frozen=True)
class Trial:
    """What a strategy leaves on the twin.

    Attributes:
        strategy: Its name.
        designed: For which crane: "believed" or "twin".
        swing: Largest swing left after the arrival by each crane that the estimate allows [rad],
            shape (cranes,).
    """

    strategy: str
    designed: str
    swing: np.ndarray


def simulate_motion(
    crane: Crane, start: State, motion: SampledMotion, duration: float, **options: Any
) -> Trajectory:
    """Simulate drives that follow a motion exactly, at its own step, for a time [s]; further
    options are those of `cranedyn.simulation.simulate.simulate`.
    """
    step = motion.period
    return simulate(
        crane,
        follow(crane, motion, step),
        start=start,
        duration=duration,
        dt=step,
        control_period=step,
        drive="motion",
        integrator=rk4,
        engine="compiled",
        **options,
    )


@cache
def trial_run() -> Trajectory:
    """Run the crane of the trial on drives that lag behind their setpoints."""
    crane = Prior().load(damp_swing=TRUTH["damp_swing"])
    start = crane.state(x=8.0, l=12.0 + TRUTH["l_offset"])
    aims = joystick(crane, start, PULSES, accelerations=LIMITS.accelerations)
    times = _STEP * np.arange(round(DURATION / _STEP) + 2)
    aim = np.array([aims(t).position for t in times.tolist()])
    lags = [TRUTH[f"{joint.symbol}_lag"] for joint in crane.layout.driven]
    moved = [lagged(aim[:, i], _STEP, lag) for i, lag in enumerate(lags)]
    position, velocity = (np.stack(column, axis=1) for column in zip(*moved, strict=True))
    motion = SampledMotion(_STEP, position, velocity)
    return simulate_motion(crane, start, motion, DURATION, reference=aims)


def trial_record(prior: Prior, *, positions: bool) -> Record:
    """Return the record of the trial: swing, setpoints of the drives, and perhaps their positions,
    as sensors show them.
    """
    run = trial_run()
    rng = np.random.default_rng(18)
    rows = np.arange(0, len(run), round(INTERVAL / _STEP))
    t = run.t[rows]
    columns = {"t_s": t}
    for joint in prior.crane.layout.driven:
        off = TRUTH.get(f"{joint.symbol}_offset", 0.0)
        position = joint.columns[0]
        aim = joint.setpoint_column
        columns[aim] = run[aim][rows] - off
        measured = run[position][rows] - off + ENCODER[joint.unit] * rng.standard_normal(len(t))
        columns |= {position: measured} if positions else {}
    for symbol in ("phi", "theta"):
        late = np.interp(t - TRUTH["delay"], run.t, run[f"{symbol}_rad"])
        noise = NOISE * rng.standard_normal(len(t))
        columns[f"{symbol}_rad"] = late + TRUTH[f"{symbol}_bias"] + noise
    return Record.of(prior.crane, columns, name="trial")


def try_strategies(estimate: Estimate) -> list[Trial]:
    """Try strategies on cranes that the estimate allows, designed for the crane that was believed
    in and for the twin; the combined move of the comparison.
    """
    prior = estimate.model.prior
    mean = {name: value for name, (value, _) in estimate.intervals.items()}
    draws = _draws(estimate)
    family = estimate.model.family
    cranes = [
        family.at(np.array([float(draws[name][i]) for name in family.names])) for i in range(DRAWS)
    ]
    arguments = dict(estimate.arguments)
    gravity = arguments.pop("gravity", prior.crane.gravity)
    beliefs = {
        "believed": (Setup(prior.crane.gravity, prior.values), dict[str, float]()),
        "twin": (Setup(gravity, {**prior.values, **arguments}), mean),
    }
    return [
        Trial(strategy, belief, _left(setup, strategy, cranes, draws, corrected))
        for strategy in TRIED
        for belief, (setup, corrected) in beliefs.items()
    ]


def _draws(estimate: Estimate) -> dict[str, np.ndarray]:
    """Draw parameters from the estimate's distribution, by name, shape (draws,) each."""
    parameters = estimate.model.own
    count = len(parameters)
    rng = np.random.default_rng(0)
    covariance = estimate.covariance[:count, :count].copy()
    covariance[np.isinf(covariance)] = 0.0  # of what nothing is said stays what one believed
    spread = rng.multivariate_normal(estimate.values[:count], covariance, DRAWS, method="eigh")
    low, high = (
        np.array([getattr(parameter, end) for parameter in parameters]) for end in ("low", "high")
    )
    return dict(
        zip([parameter.name for parameter in parameters], np.clip(spread, low, high).T, strict=True)
    )


def _left(
    setup: Setup,
    strategy: str,
    cranes: list[Crane],
    draws: Mapping[str, np.ndarray],
    corrected: Mapping[str, float],
) -> np.ndarray:
    """Return the swing that a plan leaves with uncorrected sensor offsets."""
    move = COMBINED
    layout = setup.crane.layout
    plan = strategies.STRATEGIES[strategy](setup, move)
    start = move.ends(setup.crane)[0]
    q = np.tile(start.q, (len(cranes), 1))
    wrong = np.zeros((len(cranes), 2 * layout.n))
    for name, values in draws.items():
        symbol, _, kind = name.rpartition("_")
        off = values - corrected.get(name, 0.0)
        if kind == "offset":
            q[:, layout.index(symbol)] += off
            wrong[:, layout.index(symbol)] -= off
        elif kind == "bias":
            wrong[:, layout.index(symbol)] += off
    ends = instant(plan.arrives + AFTER, setup.control_period)
    return simulate_batch(
        cranes,
        plan.controller(),
        plan.reference,
        start=State(q, np.zeros_like(q)),
        duration=ends,
        dt=setup.dt,
        control_period=setup.control_period,
        drive=plan.drive,
        sensor_offset=wrong,
        residual_from=ends,
    ).residual_swing
