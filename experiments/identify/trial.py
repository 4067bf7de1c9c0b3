"""A trial of identification: a record of a crane that differs from what is believed of it, and
controllers tried on the crane that was found.
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
from cranedyn.identification.drive_motion import SampledMotion, lagged
from cranedyn.interfaces import State
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.model.crane import Crane
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
"""True values of the parameters that are believed otherwise [SI units]."""

DURATION = 120.0
"""Duration of the record [s]."""

INTERVAL = 0.05
"""Time from one row of the record to the next [s]."""

NOISE = 2e-3
"""Standard deviation of the noise of a swing sensor [rad]."""

ENCODER_NOISE = {"rad": 1e-4, "m": 1e-3}
"""Standard deviation of the noise of a drive's position, by its unit."""

PULSES = (
    JoystickPulse("x", 0.6, 2.0, 5.0),
    JoystickPulse("gamma", 0.08, 12.0, 6.0),
    JoystickPulse("l", 0.4, 30.0, 5.0),
    JoystickPulse("x", -0.6, 45.0, 5.0),
    JoystickPulse("gamma", -0.08, 62.0, 6.0),
    JoystickPulse("l", -0.4, 80.0, 5.0),
    JoystickPulse("x", 0.4, 92.0, 3.0),
)
"""What an operator does during the record."""

TRIED = (strategies.PD, strategies.FLAT)
"""Strategies that are tried on a twin."""

DRAWS = 64
"""Number of cranes that are drawn from the distribution of the estimate."""

SETTLING_TIME = 10.0
"""Time after the arrival at which the residual swing is read [s]."""

STEP = 5e-3
"""Step of the run that is recorded [s]."""


@dataclass(frozen=True)
class Trial:
    """Residual swing of a strategy on cranes as the estimate describes them.

    Attributes:
        strategy: Name of the strategy.
        designed: Crane for which it is designed: "believed" or "twin".
        swing: Residual swing of each crane that is drawn from the estimate [rad], shape (cranes,).
    """

    strategy: str
    designed: str
    swing: np.ndarray


def simulate_motion(
    crane: Crane, start: State, motion: SampledMotion, duration: float, **options: Any
) -> Trajectory:
    """Simulate a crane whose drives follow a motion exactly, with its period as the step.

    Args:
        crane: The crane.
        start: Where it starts.
        motion: Motion of the drives.
        duration: Duration [s].
        **options: Further options of `cranedyn.simulation.simulate.simulate`.
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
    times = STEP * np.arange(round(DURATION / STEP) + 2)
    setpoints = np.array([aims(t).position for t in times.tolist()])
    positions = []
    velocities = []
    for i, joint in enumerate(crane.layout.driven):
        position, velocity = lagged(setpoints[:, i], STEP, TRUTH[f"{joint.symbol}_lag"])
        positions.append(position)
        velocities.append(velocity)
    motion = SampledMotion(STEP, np.stack(positions, axis=1), np.stack(velocities, axis=1))
    return simulate_motion(crane, start, motion, DURATION, reference=aims)


def trial_record(prior: Prior, *, positions: bool) -> Record:
    """Return the record of the trial as sensors show it.

    Args:
        prior: What is believed of the crane.
        positions: Whether positions of the drives are recorded beside their setpoints.
    """
    run = trial_run()
    rng = np.random.default_rng(18)
    rows = np.arange(0, len(run), round(INTERVAL / STEP))
    t = run.t[rows]
    columns = {"t_s": t}
    for joint in prior.crane.layout.driven:
        offset = TRUTH.get(f"{joint.symbol}_offset", 0.0)
        position = joint.columns[0]
        setpoint = joint.setpoint_column
        columns[setpoint] = run[setpoint][rows] - offset
        # The noise is drawn in any case, so that swings have the same noise with and without
        # positions.
        noise = ENCODER_NOISE[joint.unit] * rng.standard_normal(len(t))
        if positions:
            columns[position] = run[position][rows] - offset + noise
    for symbol in ("phi", "theta"):
        late = np.interp(t - TRUTH["delay"], run.t, run[f"{symbol}_rad"])
        noise = NOISE * rng.standard_normal(len(t))
        columns[f"{symbol}_rad"] = late + TRUTH[f"{symbol}_bias"] + noise
    return Record.of(prior.crane, columns, name="trial")


def try_strategies(estimate: Estimate) -> list[Trial]:
    """Try strategies on cranes that are drawn from the estimate, in the combined move.

    Each strategy is designed for the crane that was believed, with sensors as they are, and for the
    twin, with sensors corrected by their estimated errors.
    """
    prior = estimate.model.prior
    mean = {name: value for name, (value, _) in estimate.intervals.items()}
    draws = _draws(estimate)
    family = estimate.model.family
    cranes = []
    for i in range(DRAWS):
        values = [float(draws[name][i]) for name in family.names]
        cranes.append(family.at(np.array(values)))

    arguments = dict(estimate.arguments)
    gravity = arguments.pop("gravity", prior.crane.gravity)
    beliefs = {
        "believed": (Setup(prior.crane.gravity, prior.values), dict[str, float]()),
        "twin": (Setup(gravity, {**prior.values, **arguments}), mean),
    }
    trials = []
    for strategy in TRIED:
        for belief, (setup, corrected) in beliefs.items():
            swing = _residual_swing(setup, strategy, cranes, draws, corrected)
            trials.append(Trial(strategy, belief, swing))
    return trials


def _draws(estimate: Estimate) -> dict[str, np.ndarray]:
    """Draw parameters from the normal distribution of an estimate, each clipped to its range.

    Returns:
        Values by the name of the parameter, shape (draws,) each.
    """
    parameters = estimate.model.own
    count = len(parameters)
    rng = np.random.default_rng(0)
    covariance = estimate.covariance[:count, :count].copy()
    # A parameter of which the records say nothing stays as it was believed.
    covariance[np.isinf(covariance)] = 0.0
    spread = rng.multivariate_normal(estimate.values[:count], covariance, DRAWS, method="eigh")
    low = np.array([parameter.low for parameter in parameters])
    high = np.array([parameter.high for parameter in parameters])
    clipped = np.clip(spread, low, high)
    return {parameter.name: clipped[:, i] for i, parameter in enumerate(parameters)}


def _residual_swing(
    setup: Setup,
    strategy: str,
    cranes: list[Crane],
    draws: Mapping[str, np.ndarray],
    corrected: Mapping[str, float],
) -> np.ndarray:
    """Return the residual swing of a strategy on each crane [rad], shape (cranes,).

    Args:
        setup: Crane and clocks for which the strategy is designed.
        strategy: Name of the strategy.
        cranes: Cranes on which it is tried.
        draws: Parameters of these cranes, by name.
        corrected: Errors of sensors for which measurements are corrected, by name.
    """
    move = COMBINED
    layout = setup.crane.layout
    plan = strategies.STRATEGIES[strategy](setup, move)
    start = move.ends(setup.crane)[0]
    q = np.tile(start.q, (len(cranes), 1))
    sensor_offset = np.zeros((len(cranes), 2 * layout.n))
    for name, values in draws.items():
        symbol, _, kind = name.rpartition("_")
        error = values - corrected.get(name, 0.0)
        if kind == "offset":
            # The drive stands that far beside where its sensor shows it.
            q[:, layout.index(symbol)] += error
            sensor_offset[:, layout.index(symbol)] -= error
        elif kind == "bias":
            sensor_offset[:, layout.index(symbol)] += error
    ends = instant(plan.arrives + SETTLING_TIME, setup.control_period)
    return simulate_batch(
        cranes,
        plan.controller(),
        plan.reference,
        start=State(q, np.zeros_like(q)),
        duration=ends,
        dt=setup.dt,
        control_period=setup.control_period,
        drive=plan.drive,
        sensor_offset=sensor_offset,
        residual_from=ends,
    ).residual_swing
