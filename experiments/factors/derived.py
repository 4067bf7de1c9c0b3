"""The same factors by simulation: what of a standard is mechanics must come out of the crane."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from cranedyn.controllers import Hold
from cranedyn.controllers.hold import zero_command
from cranedyn.interfaces import State
from cranedyn.lifts.judging import factors, wind_standards
from cranedyn.lifts.judging.loads import hanging_mass, loads_of_rows
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from experiments.factors.formulas import Compared
from experiments.scenarios.crane_variants import POINT
from experiments.scenarios.moves import instant

if TYPE_CHECKING:
    from cranedyn.compiled.batch import Batch

AGREES = 1e-3
"""Largest relative difference between formula and simulation.

Its largest parts are the strain of the rope, 2e-4; the time h of 5 ms between instants, which miss
a maximum by (ω h)²/8, 4e-5; the swing of 12 mrad, which is not quite small, 1e-4; and the step of
0.5 ms, (ω dt)².
"""

RATIOS = (0.5, 1.5, 3.0, 10.0)
"""Masses of the load over that of the carriage for which ψ_h is derived."""

DURATIONS = (1.0 / 12.0, 1.0 / 6.0, 0.25, 1.0 / 3.0, 0.5)
"""Durations of accelerations, in periods of the pendulum, for which ψ_h is derived."""

STEPS_PER_PERIOD = 1200
"""Number of control periods in a period of the pendulum while a trolley is accelerated evenly."""

HOIST_LENGTH = 2.0e4
"""Cable length of a hoist [m], so long that stretch and hoisting do not change its stiffness."""

HOIST_GRAVITY = 20.0
"""Gravity in which hoists are run [m/s²].

The softest hoist then stretches within the range of its joint. Only ω/g counts.
"""

LOAD = 1000.0
"""Mass of the load [kg]."""

INCLINATION = 0.005
"""Acceleration of the carriage over gravity: the angle at which the rope would hang at rest [rad].

It is small, since ψ_h is that of a small swing.
"""

LENGTH = 10.0
"""Cable length of a pendulum [m]."""

PICK_UP_SPEED = 0.5
"""Hoisting speed at which loads are taken up [m/s]."""

STEP = 5e-4
"""Physics step [s]."""

PERIOD = 5e-3
"""Time between control instants [s]."""


def simulate_factors(gravity: float) -> list[Compared]:
    """Derive all factors by simulation, in a gravity [m/s²]."""
    return [
        *_pick_ups(),
        *_releases(),
        *_braked(gravity),
        *_regulated(gravity),
        *_blown(gravity),
        *_stopped(gravity),
    ]


def _compared(name: str, means: str, formula: float, simulated: float) -> Compared:
    """Return a factor by its formula and by simulation, with the means that simulated it."""
    return Compared(name, means, formula, simulated, AGREES)


def _simulated(crane: Crane, controller: Hold, **options: Any) -> Batch:
    """Run `cranedyn.compiled.batch.simulate_batch`, which needs the extra `compiled`."""
    from cranedyn.compiled.batch import simulate_batch

    return simulate_batch(crane, controller, **{"dt": STEP, "control_period": PERIOD, **options})


def _hoist(slope: float, mass: float = LOAD) -> Crane:
    """Return a point load on a rope that is as stiff as a hoist with 1 t.

    Args:
        slope: Slope β2 of the class of the hoist [s/m].
        mass: Mass of the load [kg].
    """
    # A load that is taken up at the speed v pulls by 1 + v ω/g: the slope is ω/g, with ω² = k/m.
    stiffness = LOAD * (slope * HOIST_GRAVITY) ** 2
    return load_crane(
        gravity=HOIST_GRAVITY,
        rope_stiffness=stiffness * HOIST_LENGTH,
        hoist_max=2.0 * HOIST_LENGTH,
        hoist_init=HOIST_LENGTH,
        pivot_height=4.0 * HOIST_LENGTH,
        payload_mass=mass,
        **POINT,
    )


def _coast(crane: Crane, start: State, duration: float, force: np.ndarray | None = None) -> Batch:
    """Run a crane whose drives keep their speed.

    Args:
        crane: The crane.
        start: Where it starts.
        duration: Duration [s].
        force: External forces at each control instant [N], shape (rows, 3 points).
    """
    return _simulated(
        crane,
        zero_command(crane),
        start=[start],
        duration=instant(duration, PERIOD),
        drive="motion",
        force=force,
        record=1,
    )


def _pulls(crane: Crane, batch: Batch) -> np.ndarray:
    """Return the pull of the load over its weight."""
    pull = loads_of_rows(crane, batch.q[0], batch.v[0], batch.effort[0])["rope_N"]
    return pull / (hanging_mass(crane) * crane.gravity)


def _pick_ups() -> Iterator[Compared]:
    """Pick up a load: the rope carries it, it still stands, and the drum already turns."""
    for name, hoisting_class in factors.HOISTING.items():
        crane = _hoist(hoisting_class.slope)
        v = np.zeros(crane.layout.n)
        v[crane.layout.at("l", "rope_stretch")] = -PICK_UP_SPEED, PICK_UP_SPEED
        batch = _coast(
            crane,
            State(crane.start.q, v),
            0.6 * 2.0 * math.pi / (hoisting_class.slope * HOIST_GRAVITY),
        )
        slope = (float(_pulls(crane, batch).max()) - 1.0) / PICK_UP_SPEED
        yield _compared(f"β2 of {name} [s/m]", "pick-up", hoisting_class.slope, slope)


def _releases() -> Iterator[Compared]:
    """Let go a part of a load that hangs: at once, or evenly over a time."""
    slope = factors.HOISTING["HC4"].slope
    for share in (0.2, 0.4):
        least_pull = _least_pull(slope, share, 0.0)
        name = f"φ3, {share:g} let go at once"
        yield _compared(name, "release", factors.phi_3(share), least_pull)
    share = 0.4
    # A force that changes evenly over a time T excites a spring by |sin(πT/τ)/(πT/τ)| of what it
    # does at once: by half, the β3 of a slow release, if T is 0.6034 of the period τ. That is the
    # period of the part that is left, which bounces faster than the whole load.
    period = 2.0 * math.pi / (slope * HOIST_GRAVITY)
    duration = 0.6034 * period * math.sqrt(1.0 - share)
    least_pull = _least_pull(slope, share, duration)
    formula = factors.phi_3(share, factors.SLOW_RELEASE)
    yield _compared("φ3, 0.4 let go slowly", "release", formula, least_pull)


def _least_pull(slope: float, share: float, lasts: float) -> float:
    """Return the least pull over the weight before, when a share is let go within a time [s]."""
    loaded = _hoist(slope)
    relieved = _hoist(slope, (1.0 - share) * LOAD)
    stretch = loaded.layout.index("rope_stretch")
    q = relieved.start.q.copy()
    q[stretch] = loaded.start.q[stretch]
    duration = lasts + 2.0 * math.pi / (slope * HOIST_GRAVITY)
    t = PERIOD * np.arange(math.ceil(duration / PERIOD) + 1)
    # What is still to go hangs on as a force without mass, held over each period at its mean.
    still = np.clip(1.0 - (t + PERIOD / 2.0) / lasts, 0.0, 1.0) if lasts else np.zeros(len(t))
    force = np.zeros((len(t), 3 * len(relieved.points)))
    force[:, 2] = -share * LOAD * HOIST_GRAVITY * still
    batch = _coast(relieved, State(q, np.zeros(relieved.layout.n)), duration, force)
    after = batch.t >= lasts
    return float(_pulls(relieved, batch)[after].min()) * (1.0 - share)


def _braked(gravity: float) -> Iterator[Compared]:
    """Brake a carriage by a constant force: whenever it stands, the load swings on.

    A crane does not know how fast it goes as a whole. So one run under the force tells of brakings
    of all durations: from each of its rows on the trolley stands still.
    """
    for ratio in RATIOS:
        # The trolley of the crane stands for the carriage.
        carriage = LOAD / ratio
        crane = load_crane(
            gravity=gravity,
            trolley_mass=carriage,
            trolley_inertia=0.0,
            trolley_max=60.0,
            trolley_init=30.0,
            hoist_init=LENGTH,
            **POINT,
        )
        force = INCLINATION * gravity * (LOAD + carriage)
        ahead = np.array([0.0, force, -LOAD * gravity])
        controller = Hold(crane, np.array([5e5, 0.0, 3e5]), np.array([1e6, 0.0, 2e4]), ahead)
        period = 2.0 * math.pi / math.sqrt(gravity / LENGTH * (1.0 + ratio))
        run = _simulated(
            crane, controller, start=[crane.start], duration=instant(period, PERIOD), record=1
        )
        psi = float(_swings_on(crane, run).max()) / INCLINATION
        yield _compared(f"ψ_h at μ = {ratio:g}", "braking", factors.psi_h(ratio), psi)


def _regulated(gravity: float) -> Iterator[Compared]:
    """Accelerate a trolley evenly, whatever the load does, for some part of a period."""
    crane = load_crane(gravity=gravity, trolley_init=5.0, hoist_init=LENGTH, **POINT)
    zeros = np.zeros(crane.layout.m)
    period = 2.0 * math.pi * math.sqrt(LENGTH / gravity)
    # All durations are whole numbers of such steps.
    step = period / STEPS_PER_PERIOD
    pushed = Hold(crane, zeros, zeros, INCLINATION * gravity * crane.layout.along("x"))
    run = _simulated(
        crane,
        pushed,
        start=[crane.start],
        duration=STEPS_PER_PERIOD / 2 * step,
        dt=step / 10.0,
        control_period=step,
        drive="motion",
        record=1,
    )
    swings = _swings_on(crane, run)
    for beta in DURATIONS:
        psi = float(swings[round(STEPS_PER_PERIOD * beta)]) / INCLINATION
        formula = factors.psi_h_regulated(beta)
        yield _compared(f"ψ_h at β = {beta:.3g}", "pushes", formula, psi)


def _swings_on(crane: Crane, run: Batch) -> np.ndarray:
    """Return the largest swing from each row on if the drives stop there [rad], shape (rows,)."""
    q = run.q[0]
    v = run.v[0].copy()
    v[:, crane.layout.drives] = 0.0
    period = 2.0 * math.pi * math.sqrt(LENGTH / crane.gravity)
    start = State(q, v)
    duration = instant(1.1 * period, PERIOD)
    batch = _simulated(crane, zero_command(crane), start=start, duration=duration, drive="motion")
    return batch.peak_swing


def _blown(gravity: float) -> Iterator[Compared]:
    """Blow at a load that hangs plumb by a wind that comes at once and stays."""
    crane = load_crane(gravity=gravity, payload_mass=LOAD, hoist_init=LENGTH, **POINT)
    for speed, area in ((20.0, 4.0), (28.5, 10.0)):
        force = wind_standards.wind_force(wind_standards.wind_pressure(speed), area)
        rows = np.zeros((1, 3 * len(crane.points)))
        rows[0, 1] = force
        batch = _coast(crane, crane.start, 8.0, rows)
        formula = wind_standards.gust_lean(force, LOAD, gravity)
        name = f"lean in {speed:g} m/s on {area:g} m² [rad]"
        yield _compared(name, "gust", formula, float(batch.peak_swing[0]))


def _stopped(gravity: float) -> Iterator[Compared]:
    """Brake a slew of 0.8 rpm at a constant deceleration to a standstill."""
    crane = load_crane(gravity=gravity, trolley_init=20.0, hoist_init=LENGTH, **POINT)
    zeros = np.zeros(crane.layout.m)
    rate = 0.8 * math.pi / 30.0
    braking = 0.02
    angle, lasts = factors.stopping(rate, braking)
    control = lasts / 800.0
    v = np.zeros(crane.layout.n)
    v[crane.layout.index("gamma")] = rate
    batch = _simulated(
        crane,
        Hold(crane, zeros, zeros, -braking * crane.layout.along("gamma")),
        start=[State(crane.start.q, v)],
        duration=lasts,
        dt=control / 10.0,
        control_period=control,
        drive="motion",
    )
    turned = float(batch.end.q[0, crane.layout.index("gamma")])
    yield _compared("slew stops within [rad]", "braking", angle, turned)
