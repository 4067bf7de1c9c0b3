"""A crane on a ship: swing and parametric resonance, heave compensation, and control of the swing.

The tower crane stands on a base that moves as prescribed. Four tables compare it with closed forms,
with a published table, and with itself under controllers that do and do not measure the base.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from scipy.special import mathieu_a, mathieu_b

from cranedyn.controllers import follow, hold_controller, lqr
from cranedyn.controllers.hold import zero_command
from cranedyn.controllers.moving_base import heave_compensated, swing_in_world
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.disturbances.waves import Jonswap, Raos, motion_in_waves
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.interfaces import Controller, Drive, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.references import hold
from cranedyn.references.motion import hanging_reference
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import POINT

PUBLISHED_A1 = 1.85818754
"""Characteristic value a₁ of Mathieu's equation for q = 5: Abramowitz and Stegun (1964), Handbook
of Mathematical Functions, table 20.1."""

PUBLISHED_Q = 5.0
"""Parameter q of that value."""

STEPS_OF_PERIOD = 400
"""Physics steps of a period of the base in the runs about Mathieu's equation."""

SMALL_SWING = 1e-4
"""Swing of these runs [rad], whose square is lost."""

SMALL_ROLL = 1e-4
"""Roll in the runs about the linear response [rad]."""

RADIUS = 12.0
"""Distance of the load from the slew axis [m]."""

LENGTH = 10.0
"""Length of the cable [m]."""

HEAVE = 0.5
"""Amplitude of the heave that is compensated [m]."""

HEAVE_PERIOD = 8.0
"""Its period [s]."""

ROLL = 0.01
"""Amplitude of the roll under which swing is controlled [rad]."""

CONTROL_PERIODS = (8.0, 11.0, 15.0)
"""Periods of that roll [s]."""

CONTROL_FROM = 20.0
"""Time from which on the swing under control counts [s]."""

CONTROL_DURATION = 50.0
"""Duration of these runs [s]."""

SEA = Jonswap(0.5, 10.0, 3.3)
"""Sea of the last row, in which a raft rolls and heaves."""

SEEDS = (1,)
"""Seeds of its waves."""

QUICK_RAMP = 1e3
"""Acceleration and jerk of a converter whose ramp is no limit [m/s² and m/s³]."""

HOIST_LAG = 0.1
"""Lag of the speed control of the hoist [s]."""

HOIST_DELAY = 0.05
"""Delay of the commands of the hoist [s]."""


# --- Mathieu's equation ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Boundary:
    """A boundary of the first tongue of Mathieu's equation, as the crane has it.

    Attributes:
        source: Where the expected value is from.
        q: Parameter q, twice the amplitude of the heave over the length of the cable.
        expected: Parameter a = 4 g/(l ω²) of the boundary.
        simulated: The same of the simulated crane.
    """

    source: str
    q: float
    expected: float
    simulated: float

    @property
    def error(self) -> float:
        """Relative error of the simulated parameter."""
        return self.simulated / self.expected - 1.0


def boundaries(setup: Setup) -> list[Boundary]:
    """Find boundaries of the first tongue with the simulated crane."""
    cases = [
        ("closed form b₁", 0.15, float(mathieu_b(1, 0.15))),
        ("closed form a₁", 0.15, float(mathieu_a(1, 0.15))),
        ("A&S table 20.1, a₁", PUBLISHED_Q, PUBLISHED_A1),
    ]
    return [Boundary(source, q, a, _simulated_boundary(setup, q, a)) for source, q, a in cases]


def _simulated_boundary(setup: Setup, q: float, near: float) -> float:
    """Return the parameter a at which a small swing has twice the period of the base.

    There the matrix that maps swing and rate over one period of the base has the trace -2. The
    secant through two points near the boundary finds the place.

    Args:
        setup: The world.
        q: Parameter q.
        near: Where to look for it.
    """
    further = near * (1.0 + 1e-4)
    trace_near = _trace(setup, q, near)
    slope = (_trace(setup, q, further) - trace_near) / (further - near)
    return near + (-2.0 - trace_near) / slope


def _trace(setup: Setup, q: float, a: float) -> float:
    """Return the trace of the matrix that maps a small swing over a period of the base."""
    crane = setup.variant(**POINT)
    omega = math.sqrt(4.0 * setup.gravity / (LENGTH * a))
    period = 2.0 * math.pi / omega
    base = BaseMotion.sines(heave=(0.5 * q * LENGTH, period, 0.5 * math.pi))
    swing = crane.layout.index("phi")
    step = period / STEPS_OF_PERIOD
    fine = replace(setup, dt=step, control_period=step, integrator="rk4")
    trace = 0.0
    for part in ("q", "v"):
        start = crane.state(x=RADIUS, l=LENGTH)
        arrays = {"q": start.q.copy(), "v": start.v.copy()}
        arrays[part][swing] = SMALL_SWING
        run = fine.simulate(
            crane,
            zero_command(crane),
            None,
            start=State(**arrays),
            duration=period,
            label=f"heaving pivot, q = {q:g}",
            drive="motion",
            base=base,
            # The rope would have to push in so strong a heave; the equation lets it.
            validity="mark",
        )
        trace += float(getattr(run, part)[-1, swing]) / SMALL_SWING
    return trace


# --- linear response to roll ----------------------------------------------------------------------


@dataclass(frozen=True)
class RollResponse:
    """Swing of the load on a base that rolls.

    Attributes:
        period: Period of the roll [s].
        expected: Amplitude of the swing relative to the crane over that of the roll, by the closed
            form, with its sign.
        simulated: The same of the simulated crane.
    """

    period: float
    expected: float
    simulated: float


def roll_responses(setup: Setup) -> list[RollResponse]:
    """Simulate the swing on a base that rolls, for some periods."""
    return [_roll_response(setup, period) for period in (4.0, 9.0, 14.0)]


def _roll_response(setup: Setup, period: float) -> RollResponse:
    """Return the swing on a base that rolls with a period [s].

    Roll φ about X moves the pivot at the height h sideways by -h φ. In the world the load answers
    as a pendulum whose pivot is driven, (ω0² - ω²) β = -ω² h φ/l, and relative to the crane it
    swings by β - φ.
    """
    crane = setup.variant(**POINT)
    start = crane.state(x=RADIUS, l=LENGTH)
    height = float(point_positions(crane, start.q)[1, 2])
    omega = 2.0 * math.pi / period
    natural = setup.gravity / LENGTH
    expected = -(omega**2) * height / LENGTH / (natural - omega**2) - 1.0
    # The run begins in the steady motion, which is a sine.
    v = start.v.copy()
    v[crane.layout.index("phi")] = expected * SMALL_ROLL * omega
    run = replace(setup, integrator="rk4").simulate(
        crane,
        zero_command(crane),
        None,
        start=State(start.q, v),
        duration=2.0 * period,
        label=f"roll of {period:g} s",
        drive="motion",
        base=BaseMotion.sines(roll=(SMALL_ROLL, period)),
    )
    sine = np.sin(omega * run.t)
    simulated = float(run["phi_rad"] @ sine / (sine @ sine)) / SMALL_ROLL
    return RollResponse(period, expected, simulated)


# --- heave compensation ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Compensation:
    """Heave of the load that is left by a hoist.

    Attributes:
        hoist: The hoist in words.
        left: Amplitude of the vertical motion of the load in the world over that of the base.
        expected: The same by the closed form |1 - H(ω)|; None where there is none.
        run: The run.
    """

    hoist: str
    left: float
    expected: float | None
    run: Trajectory


def compensations(setup: Setup) -> list[Compensation]:
    """Compensate a heave by several hoists."""
    crane = setup.crane
    base = BaseMotion.sines(heave=(HEAVE, HEAVE_PERIOD))
    at_rest = crane.state(x=RADIUS, l=LENGTH)
    held = hold(crane, at_rest)
    quick = converters(
        crane,
        delay=HOIST_DELAY,
        lags={"l": HOIST_LAG},
        accelerations={"l": QUICK_RAMP},
        jerks={"l": QUICK_RAMP / setup.dt},
        resolutions={"l": 0.0},
    )
    omega = 2.0 * math.pi / HEAVE_PERIOD
    # A command is held for a control period, and thus half of one late on average.
    late = HOIST_DELAY + 0.5 * setup.control_period
    response = np.exp(-1j * omega * late) / (1.0 + 1j * omega * HOIST_LAG)
    ahead = late + HOIST_LAG
    foreseen = response * np.exp(1j * omega * ahead)

    paid_out = heave_compensated(crane, held, base)
    early = heave_compensated(crane, held, base, ahead=ahead)
    period = setup.control_period
    cases = [
        _Hoist("none", held, follow(crane, held, period), "motion", 1.0),
        _Hoist("follows exactly", paid_out, follow(crane, paid_out, period), "motion", 0.0),
        _Hoist("lag 0.1 s, delay 0.05 s", paid_out, commanded_rates, quick, abs(1.0 - response)),
        _Hoist("the same, base foreseen", early, commanded_rates, quick, abs(1.0 - foreseen)),
        _Hoist("typical converter", paid_out, commanded_rates, "velocity", None),
    ]
    results = []
    for case in cases:
        run = setup.simulate(
            crane,
            case.controller,
            case.reference,
            start=_start_of(crane, at_rest, case.reference),
            duration=5.0 * HEAVE_PERIOD,
            label=case.name,
            drive=case.drive,
            base=base,
        )
        left = _heave_of_load(crane, base, run) / HEAVE
        results.append(Compensation(case.name, left, case.expected, run))
    return results


@dataclass(frozen=True)
class _Hoist:
    """A hoist that compensates a heave, or does not.

    Attributes:
        name: What it is, in words.
        reference: Setpoints of the drives.
        controller: What commands the drives.
        drive: How they take the commands.
        expected: Share of the heave that is left by the closed form; None where there is none.
    """

    name: str
    reference: Reference
    controller: Controller
    drive: Drive | Converters
    expected: float | None


def commanded_rates(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
    """Command the rates of the setpoint, shape (m,)."""
    return setpoint.velocity


def _start_of(crane: Crane, at_rest: State, reference: Reference) -> State:
    """Return the state at which the drives are on a reference, and all else hangs at rest."""
    setpoint = reference(0.0)
    q = at_rest.q.copy()
    v = at_rest.v.copy()
    q[crane.layout.drives] = setpoint.position
    v[crane.layout.drives] = setpoint.velocity
    return State(q, v)


def _heave_of_load(crane: Crane, base: BaseMotion, run: Trajectory) -> float:
    """Return the amplitude of the vertical motion of the load in the world at the period of the
    base, over the last three periods [m].
    """
    late = run.since(2.0 * HEAVE_PERIOD)
    height = points_in_world(crane, base, late)[:, 0, 2]
    angle = 2.0 * math.pi / HEAVE_PERIOD * late.t
    columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    sine, cosine, _ = np.linalg.lstsq(columns, height)[0]
    return math.hypot(sine, cosine)


def points_in_world(crane: Crane, base: BaseMotion, run: Trajectory) -> np.ndarray:
    """Return the points of a crane in the world [m], shape (rows, points, 3)."""
    return base.frames(run.t).points_in_world(point_paths(crane, run.q))


# --- control of the swing -------------------------------------------------------------------------


@dataclass(frozen=True)
class SwingControl:
    """Largest swing in the world under three controllers, after the start [rad].

    Attributes:
        motion: Motion of the base in words.
        held: Drives that hold their place.
        unmeasured: Feedback of the swing as the crane's own encoders see it.
        measured: The same feedback with the attitude of the base measured.
    """

    motion: str
    held: float
    unmeasured: float
    measured: float


def raft(gravity: float) -> Raos:
    """Return the response of a raft that follows the surface of a beam sea.

    It heaves as the water does. Waves ζ = a cos(ω t - k y) along Y, with k = ω²/g, have the slope
    a k sin(ω t) at the raft, which is its roll: a quarter of a period late.
    """
    frequency = np.linspace(0.1, 6.0, 600)
    response = np.zeros((len(frequency), len(COORDINATES)), dtype=complex)
    response[:, COORDINATES.index("heave")] = 1.0
    response[:, COORDINATES.index("roll")] = -1j * frequency**2 / gravity
    return Raos(frequency, response, heading=90.0)


def swing_controls(setup: Setup) -> list[SwingControl]:
    """Control the swing on bases that roll, and in a sea."""
    motions = {}
    for period in CONTROL_PERIODS:
        motions[f"roll of {period:g} s"] = BaseMotion.sines(roll=(ROLL, period))
    for seed in SEEDS:
        waves = motion_in_waves(SEA, raft(setup.gravity), seed=seed)
        motions[f"raft in a beam sea, seed {seed}"] = waves
    return [_swing_control(setup, name, motion) for name, motion in motions.items()]


def _swing_control(setup: Setup, name: str, base: BaseMotion) -> SwingControl:
    """Control the swing on one base."""
    crane = setup.crane
    start = crane.state(x=RADIUS, l=LENGTH)
    reference = hold(crane, start)
    feedback = lqr(crane, hanging_reference(crane, reference, 5.0), dt=setup.dt)
    controllers: dict[str, Controller] = {
        "held": hold_controller(crane),
        "unmeasured": feedback,
        "measured": swing_in_world(crane, feedback, base),
    }
    largest = {}
    for kind, controller in controllers.items():
        run = setup.simulate(
            crane,
            controller,
            reference,
            start=start,
            duration=CONTROL_DURATION,
            label=f"{name}, {kind}",
            base=base,
        )
        late = run.since(CONTROL_FROM)
        points = points_in_world(crane, base, late)
        sideways = np.linalg.norm((points[:, 0] - points[:, 1])[:, :2], axis=1)
        below = points[:, 1, 2] - points[:, 0, 2]
        largest[kind] = float(np.arctan2(sideways, below).max())
    return SwingControl(name, **largest)


# --- the experiment -------------------------------------------------------------------------------


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run the crane on its bases."""
    edges = boundaries(setup)
    rolls = roll_responses(setup)
    hoists = compensations(setup)
    swings = swing_controls(setup)
    exact = hoists[1].run
    return Outcome(
        tables=[
            _compensation_table(hoists),
            _control_table(swings),
            _boundary_table(edges),
            _roll_table(rolls),
        ],
        claims=[
            *_boundary_claims(edges),
            _roll_claim(rolls),
            _exact_claim(setup, hoists[1]),
            _lag_claim(hoists),
            _control_claim(swings),
        ],
        parameters={
            "radius_m": RADIUS,
            "length_m": LENGTH,
            "heave_m": HEAVE,
            "heave_period_s": HEAVE_PERIOD,
            "roll_rad": ROLL,
            "sea_hs_m": SEA.hs,
            "sea_tp_s": SEA.tp,
            "sea_gamma": SEA.gamma,
            "seeds": list(SEEDS),
        },
        trajectories={"compensated": exact},
        figures={"heave": _heave_figure(setup, hoists)},
        recording=harness.side_by_side(
            {
                "no compensation": (setup.crane, hoists[0].run),
                "heave compensated": (setup.crane, exact),
            },
            apart=40.0,
        ),
    )


def _boundary_claims(edges: Sequence[Boundary]) -> list[Claim]:
    """Return the claims that the boundaries are those of Mathieu's equation.

    RK4 with 400 steps a period has a relative error of the order of (2π/400)⁴ = 6e-8; the published
    value has nine digits.
    """
    allowed = (2.0 * math.pi / STEPS_OF_PERIOD) ** 4
    closed = max(abs(edge.error) for edge in edges[:2])
    published = abs(edges[2].error)
    return [
        Claim(
            "A pendulum on a heaving pivot becomes unstable where Mathieu's equation does, within "
            f"{allowed:.0e} (worst {closed:.0e}).",
            closed < allowed,
        ),
        Claim(
            f"The published a₁(5) = {PUBLISHED_A1} of table 20.1 is reproduced within "
            f"{10.0 * allowed:.0e} ({published:.0e}).",
            # Five times as strong a drive makes the terms of the error that many times larger.
            published < 10.0 * allowed,
        ),
    ]


def _roll_claim(rolls: Sequence[RollResponse]) -> Claim:
    """Return the claim that the swing on a rolling base is the linear response."""
    worst = max(abs(roll.simulated / roll.expected - 1.0) for roll in rolls)
    allowed = 10.0 * SMALL_ROLL
    return Claim(
        f"On a rolling base the load swings as the linear response says, within {allowed:.0e}: the "
        f"terms of second order in a roll of {SMALL_ROLL:g} rad (worst {worst:.0e}).",
        worst < allowed,
    )


def _exact_claim(setup: Setup, exact: Compensation) -> Claim:
    """Return the claim that a hoist that follows exactly keeps the load at its height.

    Semi-implicit Euler steps the length ahead of its rate by half a step: (ω dt/2) of the heave.
    Accelerations that are constant in a control period h leave (ω h)²/12 of it.
    """
    omega = 2.0 * math.pi / HEAVE_PERIOD
    allowed = 0.5 * omega * setup.dt + (omega * setup.control_period) ** 2 / 12.0
    return Claim(
        "A hoist that follows exactly keeps the load at its height in the world, within "
        f"{allowed:.1e} of the heave, which the steps leave ({exact.left:.1e}).",
        exact.left < 1.01 * allowed,
    )


def _lag_claim(hoists: Sequence[Compensation]) -> Claim:
    """Return the claim that late hoists leave what the closed form says."""
    differences = []
    for hoist in hoists[2:4]:
        assert hoist.expected is not None
        differences.append(abs(hoist.left - hoist.expected))
    worst = max(differences)
    return Claim(
        "A hoist with lag and delay leaves the share |1 - H(ω)| of the heave, within 0.001 "
        f"(worst {worst:.1e}).",
        worst < 1e-3,
    )


def _control_claim(swings: Sequence[SwingControl]) -> Claim:
    """Return the claim that measuring the base helps the control of the swing.

    The largest swing in one realisation of a sea is random, so that nothing is claimed of it.
    """
    regular = swings[: len(CONTROL_PERIODS)]
    ratios = [swing.measured / swing.unmeasured for swing in regular]
    return Claim(
        "On a base that rolls regularly, feedback of the swing leaves less of it in the world when "
        f"it measures the attitude of the base: {100.0 * min(ratios):.0f} to "
        f"{100.0 * max(ratios):.0f} % of what it leaves without.",
        max(ratios) < 1.0,
    )


def _compensation_table(hoists: Sequence[Compensation]) -> ResultTable:
    return make_table(
        f"Load on a base that heaves by ±{HEAVE:g} m in {HEAVE_PERIOD:g} s",
        hoists,
        ("hoist", "", lambda hoist: hoist.hoist),
        ("load heaves ± [mm]", ".2f", lambda hoist: 1e3 * HEAVE * hoist.left),
        ("share [%]", ".3f", lambda hoist: 100.0 * hoist.left),
        (
            "closed form [%]",
            ".3f",
            lambda hoist: None if hoist.expected is None else 100.0 * hoist.expected,
        ),
    )


def _control_table(swings: Sequence[SwingControl]) -> ResultTable:
    return make_table(
        f"Largest swing in the world from {CONTROL_FROM:g} s to {CONTROL_DURATION:g} s [mrad]",
        swings,
        ("base", "", lambda swing: swing.motion),
        ("drives hold", ".1f", lambda swing: 1e3 * swing.held),
        ("LQR", ".1f", lambda swing: 1e3 * swing.unmeasured),
        ("LQR, base measured", ".1f", lambda swing: 1e3 * swing.measured),
        note=f"Roll of {ROLL:g} rad; sea of Hs {SEA.hs:g} m, Tp {SEA.tp:g} s, one realisation.",
    )


def _boundary_table(edges: Sequence[Boundary]) -> ResultTable:
    return make_table(
        "Heaving pivot: boundary of parametric resonance, a = 4 g/(l ω²)",
        edges,
        ("source", "", lambda edge: edge.source),
        ("q", "g", lambda edge: edge.q),
        ("expected", ".6f", lambda edge: edge.expected),
        ("simulated", ".6f", lambda edge: edge.simulated),
    )


def _roll_table(rolls: Sequence[RollResponse]) -> ResultTable:
    return make_table(
        "Swing of the load over the roll of the base",
        rolls,
        ("period [s]", "g", lambda roll: roll.period),
        ("closed form", "+.5f", lambda roll: roll.expected),
        ("simulated", "+.5f", lambda roll: roll.simulated),
    )


def _heave_figure(setup: Setup, hoists: Sequence[Compensation]) -> Figure:
    base = BaseMotion.sines(heave=(HEAVE, HEAVE_PERIOD))
    figure, (ax,) = panels(1, height=3.4, width=7.0)
    for hoist in hoists:
        height = points_in_world(setup.crane, base, hoist.run)[:, 0, 2]
        ax.plot(hoist.run.t, height - height[0], label=hoist.hoist)
    ax.set(xlabel="time [s]", ylabel="height of the load [m]")
    legend_above(ax, columns=3)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("ship", __doc__)
    harness.add_setup(parser, "payload_inertia", "dummy_mass", "dummy_inertia", "damp_swing")
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
