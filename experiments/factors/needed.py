"""What a move needs of the factors that a standard allows for, under several strategies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Controller, Reference, State
from cranedyn.lifts.judging import factors
from cranedyn.lifts.judging.loads import hanging_mass, loads
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.model.crane import Crane
from cranedyn.references.shaped import shaped, zv
from experiments.harness import Setup
from experiments.scenarios.crane_variants import POINT, ROPE, at_start, rope_stiffness
from experiments.scenarios.moves import LIMITS, MOVES, RestToRest, instant
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import FASTEST, FLAT, STRATEGIES

CONTROLLED = ("operator", "operator + ZV", FASTEST, FLAT)
"""Strategies that are compared: velocity drives that follow a joystick, the same shaped, and the
load carried along its own path, as fast as the drives can and in the time of the move."""

AFTER = 10.0
"""How long a move is watched after its arrival [s]."""

FULL_SPEED = 1.0
"""Full hoisting speed [m/s]."""

CREEP_SPEED = 0.1
"""Creep speed of the hoist [m/s]."""

ACCELERATION = 0.4
"""Acceleration to the full speed by a joystick [rad/s² or m/s²]."""

WATCH_TIME = 6.0
"""Time for which a lift-off is watched [s]."""


class Need(NamedTuple):
    """What a strategy needs.

    Attributes:
        move: Name of the move.
        strategy: How it is made.
        arrives: Time at which the drives arrive [s]; None where that is not the question.
        allowed: Factor of the standard.
        needed: Factor that was found.
        run: The run.
    """

    move: str
    strategy: str
    arrives: float | None
    allowed: float
    needed: float
    run: Trajectory

    @property
    def unused(self) -> float:
        """Share of what the standard allows for that is not needed; negative for too much."""
        return (self.allowed - self.needed) / self.allowed


@dataclass(frozen=True)
class PickUp:
    """How a load is taken up.

    Attributes:
        name: Name of the way.
        speed: Speed of the drum when the rope gets taut [m/s]; 0 where it is taut before.
        shaped: Whether the drive, which starts with a taut rope, is shaped for the bounce.
    """

    name: str
    speed: float
    shaped: bool = False


HOISTINGS = (
    PickUp("at full speed, 1 m/s (HD1)", FULL_SPEED),
    PickUp("creeping, 0.1 m/s (HD2, HD3)", CREEP_SPEED),
    PickUp("from a taut rope, 0.4 m/s² (HD5)", 0.0),
    PickUp("the same, shaped for the bounce", 0.0, shaped=True),
)
"""How a load is taken up, from rough to gentle."""


def across(setup: Setup) -> list[Need]:
    """Return the need of ψ_h of trolley and slew.

    It is the pull of the rope along the way of the drive, over the mass that hangs times the
    acceleration of which the drive is capable.
    """
    needs = []
    for move in MOVES:
        if move.name in ("trolley", "slew"):
            needs += [_need_of_move(setup, move, strategy) for strategy in CONTROLLED]
    return needs


def _need_of_move(setup: Setup, move: RestToRest, strategy: str) -> Need:
    """Return the need of ψ_h of a move of the trolley or the slew alone."""
    crane = setup.crane
    plan = STRATEGIES[strategy](setup, move)
    run, _ = make(setup, move, plan, label=f"{move.name}, {strategy}", after=AFTER)
    columns = loads(crane, run)
    if move.name == "trolley":
        lead = columns["off_lead_rad"]
        acceleration = LIMITS.accelerations[crane.layout.drive("x")]
    else:
        lead = columns["side_lead_rad"]
        radius = move.start[1]
        acceleration = LIMITS.accelerations[crane.layout.drive("gamma")] * radius
    pull = float(np.abs(columns["pull_N"] * np.tan(lead)).max())
    return Need(
        move=move.name,
        strategy=strategy,
        arrives=plan.arrives,
        allowed=factors.psi_h_regulated(1.0),
        needed=pull / (hanging_mass(crane) * acceleration),
        run=run,
    )


def upwards(setup: Setup) -> list[Need]:
    """Return the need of φ2 of a load on a rope that stretches.

    It stands beside the factor of the class of this rope: 1 + v ω/g at full speed.
    """
    crane = ROPE.crane(gravity=setup.gravity, **POINT)
    length = at_start(crane, "l")
    omega = theory.rope_bounce(rope_stiffness(crane), length, crane.payload_mass)
    allowed = theory.pickup_factor(FULL_SPEED, omega, crane.gravity)
    return [_need_of_pick_up(setup, crane, hoisting, omega, allowed) for hoisting in HOISTINGS]


def _need_of_pick_up(
    setup: Setup, crane: Crane, hoisting: PickUp, omega: float, allowed: float
) -> Need:
    """Return the need of φ2 of a load that is taken up.

    Args:
        setup: Clocks and engine.
        crane: The crane.
        hoisting: How the load is taken up.
        omega: Frequency of the load on its rope [rad/s].
        allowed: Factor of the standard.
    """
    start = State(crane.start.q, crane.start.v.copy())
    controller: Controller
    reference: Reference | None = None
    if hoisting.speed:
        # The drum turns, and the load still stands.
        start.v[crane.layout.index("l")] = -hoisting.speed
        start.v[crane.layout.index("rope_stretch")] = hoisting.speed
        controller = zero_command(crane)
        duration = instant(2.0 * math.pi / omega, setup.control_period)
    else:
        reference = _lifted(crane, hoisting.shaped, omega)
        controller = follow(crane, reference, setup.control_period)
        duration = WATCH_TIME
    run = setup.simulate(
        crane,
        controller,
        reference,
        start=start,
        duration=duration,
        label=hoisting.name,
        drive="motion",
        validity="mark",
    )
    needed = float(loads(crane, run)["slack_margin"].max())
    return Need("hoist", hoisting.name, None, allowed, needed, run)


def _lifted(crane: Crane, is_shaped: bool, omega: float) -> Reference:
    """Return a move up at full speed and back to rest, at the limit of the acceleration.

    Args:
        crane: The crane.
        is_shaped: Whether the move is shaped for the bounce.
        omega: Frequency of the bounce [rad/s].
    """
    up = joystick(
        crane,
        crane.start,
        [JoystickPulse("l", -FULL_SPEED, 0.0, 3.0)],
        accelerations=[ACCELERATION] * crane.layout.m,
    )
    return shaped(up, zv(), 2.0 * math.pi / omega) if is_shaped else up
