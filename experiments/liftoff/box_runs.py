"""Runs of a box that is lifted off the ground, slides on it, or is set down."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, box_corners, box_load, standing
from cranedyn.dynamics.equations_of_motion import body_points, payload_position
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.interfaces import State
from cranedyn.lifts.judging import factors
from cranedyn.lifts.judging.factors import HOISTING, DriveClass, HoistingClass
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from experiments.harness import Setup
from experiments.scenarios.moves import instant

MASS = 1000.0
"""Mass of the box [kg]."""

SIDES = (1.5, 3.0, 1.2)
"""Sides of the box along X, Y and Z [m]; at zero slew the jib points along -Y."""

MAX_HOISTING_SPEED = 0.8
"""Largest hoisting speed [m/s]."""

CREEP_SPEED = 0.1
"""Creep speed of the hoist [m/s]."""

CLASS_ROPE_LENGTH = 1000.0
"""Length of the rope of a hoist of a class [m], so long that its stiffness hardly changes while it
shortens."""

HARD_GROUND_SINK = 5e-4
"""Depth by which the box sinks into hard ground under its weight [m]."""

# A real rope, for all but the hoisting classes.

ROPE_STIFFNESS = 2e7
"""Stiffness E A of the rope [N]."""

ROPE_LENGTH = 25.0
"""Length of the rope [m]."""

ROPE_DAMPING = 2e4
"""Damping of the rope [N s/m]."""

SLING_DAMPING = 500.0
"""Damping of the box about its lug [N m s/rad]."""

SLACK = 0.02
"""Slack of the rope before lift-off [m]."""

SET_DOWN_HEIGHT = 0.05
"""Height of the box above ground before it is set down [m]."""

OFF_LEAD_TIME = 20.0
"""Duration of a lift off-lead [s]."""

THROWN_SLACK = 0.5
"""Slack of the rope above a box that slides [m]; it stays slack until the box rests."""


class LiftOff(NamedTuple):
    """Lift-off by a hoist of a class.

    Attributes:
        hoisting: Hoisting class.
        drive: Drive class.
        speed: Hoisting speed [m/s].
        simulated: Largest tension over the weight.
        allowed: Largest difference of it from 1 + β2 v.
    """

    hoisting: HoistingClass
    drive: DriveClass
    speed: float
    simulated: float
    allowed: float

    @property
    def closed(self) -> float:
        """Largest tension over the weight in closed form, 1 + β2 v."""
        return 1.0 + HOISTING[self.hoisting].slope * self.speed

    @property
    def standard(self) -> float:
        """Factor φ2 of the standard, which covers it."""
        return factors.phi_2(self.hoisting, self.speed, self.drive)


class OffLead(NamedTuple):
    """Lift-off with the trolley beside the box.

    Attributes:
        friction: Coefficient of friction.
        offset: Distance of the trolley from above the box [m].
        speed: Hoisting speed [m/s].
        lead: Angle of the rope from plumb as it gets taut [rad].
        slid: Distance that the box slides before it leaves the ground [m].
        swing: Largest swing after that, as on a rope of the length at lift-off [rad].
        run: The run.
    """

    friction: float
    offset: float
    speed: float
    lead: float
    slid: float
    swing: float
    run: Trajectory


class Slide(NamedTuple):
    """A box that slides to rest below a slack rope.

    Attributes:
        friction: Coefficient of friction.
        speed: Speed at first [m/s].
        slid: Distance until it rests [m].
        closed: Distance by the work of friction, v² / (2 μ g) [m].
        allowed: How far the two may differ [m].
    """

    friction: float
    speed: float
    slid: float
    closed: float
    allowed: float


class SetDown(NamedTuple):
    """Set-down of the box.

    Attributes:
        speed: Speed of lowering [m/s].
        pull: Largest tension over the weight.
        push: Largest force of the ground over the weight.
        slack_after: Time from touching the ground to a slack rope [s]; inf if it stays taut.
        rebounds: Time that the box is in the air again after it touched [s].
    """

    speed: float
    pull: float
    push: float
    slack_after: float
    rebounds: float


@cache
def _crane(gravity: float, rope: float, length: float, **values: float) -> Crane:
    """Return a crane with the box, whose rope reaches from its pivot to the box on the ground.

    Args:
        gravity: Gravity [m/s²].
        rope: Stiffness E A of the rope [N].
        length: Length of the rope at the start [m].
        **values: Further numbers of the crane.
    """
    pivot_height = length + SIDES[2]
    numbers = {
        **box_load(MASS, *SIDES),
        "pivot_height": pivot_height,
        "mast_height": pivot_height - 2.0,
        "total_height": pivot_height + 5.0,
        "hoist_max": 2.0 * length,
        "hoist_init": length,
        "rope_stiffness": rope,
        # Links between the swing joints that weigh nothing beside the box.
        "dummy_mass": 1.0,
        "dummy_inertia": 1.0,
        **values,
    }
    return load_crane(gravity=gravity, values=numbers)


def roped_crane(setup: Setup) -> Crane:
    """Return the crane with a real rope."""
    return _crane(
        setup.gravity,
        ROPE_STIFFNESS,
        ROPE_LENGTH,
        rope_damping=ROPE_DAMPING,
        damp_sling=SLING_DAMPING,
    )


def _run(
    setup: Setup, crane: Crane, ground: Ground, start: State, duration: float, label: str
) -> Trajectory:
    """Return a run in which the drives keep their speed.

    It goes on where the rope is slack.

    Args:
        setup: Clocks and engine.
        crane: The crane.
        ground: The ground.
        start: Where it starts.
        duration: Duration [s]; it ends at the next control instant.
        label: Name of the run.
    """
    return setup.simulate(
        crane,
        zero_command(crane),
        None,
        start=start,
        duration=instant(duration, setup.control_period),
        label=label,
        drive="motion",
        validity="mark",
        ground=ground,
    )


def _from_ground(crane: Crane, ground: Ground, offset: float, slack: float, speed: float) -> State:
    """Return the start of a lift-off, with the box on the ground and the hoist at its speed.

    Args:
        crane: The crane.
        ground: The ground.
        offset: Distance of the trolley from above the box [m].
        slack: Slack of the rope [m].
        speed: Hoisting speed [m/s].
    """
    layout = crane.layout
    rope = crane.start.q[crane.layout.index("l")]
    lead = math.atan2(offset, rope)
    # The rope leans; the sling turns the box back, so that it stands level.
    state = crane.state(phi=lead, sling_radial=-lead, l=math.hypot(rope, offset) + slack)
    v = np.zeros(layout.n)
    # The hoist winds up the slack, and the load does not move.
    v[layout.index("l")] = -speed
    v[layout.index("rope_stretch")] = speed
    return standing(crane, ground, State(state.q, v))


def _pull(crane: Crane, run: Trajectory) -> np.ndarray:
    """Return the tension over the weight at each row."""
    weight = crane.payload_mass * crane.gravity
    return JointForces.of(crane).tension(run.q.T, run.v.T) / weight


def _push(crane: Crane, ground: Ground, run: Trajectory) -> np.ndarray:
    """Return the force of level ground over the weight at each row."""
    contacts = ground.contacts(crane)
    forces = []
    for q, v in zip(run.q, run.v, strict=True):
        place = body_points(crane.model, crane.data, contacts.body, np.array(contacts.points), q, v)
        # The normal force does not depend on where a point stuck to the ground: the points
        # themselves stand for it.
        reaction = contacts.reaction(*place, place[0])[0]
        forces.append(float(np.sum(reaction[2])))
    return np.array(forces) / (crane.payload_mass * crane.gravity)


def pick_up(setup: Setup, hoisting: HoistingClass, drive: DriveClass) -> LiftOff:
    """Lift the box off by a hoist of a class.

    A load on a spring that is taken up at the speed v pulls by 1 + v ω/g of its weight: the slope
    β2 of a hoisting class is that of a rope on which the load has the frequency ω = β2 g.
    """
    speed = factors.pick_up_speed(drive, MAX_HOISTING_SPEED, CREEP_SPEED)
    omega = HOISTING[hoisting].slope * setup.gravity
    stiffness = MASS * omega**2 * CLASS_ROPE_LENGTH
    crane = _crane(setup.gravity, stiffness, CLASS_ROPE_LENGTH)
    ground = Ground(box_corners(*SIDES), sink=HARD_GROUND_SINK)
    start = _from_ground(crane, ground, 0.0, SLACK, speed)
    # The rope gets taut, takes up the weight, and the box bounces up once.
    stretch = setup.gravity / omega**2
    jump = HOISTING[hoisting].slope * speed
    duration = (SLACK + stretch) / speed + 1.5 * math.pi / omega
    run = _run(setup, crane, ground, start, duration, f"{hoisting}, {drive}")
    # The difference has three reasons: the ground is soft, a rope that strains and shortens gets
    # stiffer, and the peak is between two rows.
    strain = (stretch + 2.0 * speed / omega) / CLASS_ROPE_LENGTH
    softness = HARD_GROUND_SINK / stretch
    allowed = jump * (softness + 2.0 * strain + (omega * setup.control_period) ** 2)
    return LiftOff(hoisting, drive, speed, float(_pull(crane, run).max()), allowed)


def off_lead_lift(setup: Setup, friction: float, offset: float, speed: float) -> OffLead:
    """Lift the box off by a rope that leans.

    Args:
        setup: Gravity, clocks and engine.
        friction: Coefficient of friction.
        offset: Distance of the trolley from above the box [m].
        speed: Hoisting speed [m/s].
    """
    crane = roped_crane(setup)
    ground = Ground(box_corners(*SIDES), (), friction)
    start = _from_ground(crane, ground, offset, SLACK / 4.0, speed)
    run = _run(setup, crane, ground, start, OFF_LEAD_TIME, f"{offset:g} m off-lead")
    phi = run["phi_rad"]
    length = run["l_m"]
    left_ground = int(np.flatnonzero(_push(crane, ground, run))[-1])
    # On a rope that shortens slowly a swing grows as l^(-3/4): scaled back to lift-off.
    growth = (length[left_ground:] / length[left_ground]) ** 0.75
    swing = np.abs(phi[left_ground:]) * growth
    slid = payload_position(crane, run.q[left_ground]) - payload_position(crane, run.q[0])
    return OffLead(
        friction=friction,
        offset=offset,
        speed=speed,
        lead=float(phi[0]),
        slid=float(np.linalg.norm(slid[:2])),
        swing=float(swing.max()),
        run=run,
    )


def slide(setup: Setup, friction: float, speed: float) -> Slide:
    """Let the box slide along the jib below a slack rope, level on the ground, until it rests."""
    crane = roped_crane(setup)
    ground = Ground(box_corners(*SIDES), (), friction)
    layout = crane.layout
    start = standing(crane, ground, crane.state(phi=0.0, l=ROPE_LENGTH + THROWN_SLACK))
    closed = speed**2 / (2.0 * friction * setup.gravity)
    # The box keeps level: its lug swings about the pivot, and the sling turns back as fast.
    # A slack rope has a negative stretch: with it the length is the distance from the pivot.
    distance = float(start.q[layout.at("l", "rope_stretch")].sum())
    swing_rate = speed / distance
    v = np.zeros(layout.n)
    v[layout.index("phi")] = swing_rate
    v[layout.index("sling_radial")] = -swing_rate
    duration = 1.5 * speed / (friction * setup.gravity) + 0.5
    run = _run(setup, crane, ground, State(start.q, v), duration, f"slides at {speed:g} m/s")
    slid = payload_position(crane, run.q[-1]) - payload_position(crane, run.q[0])
    # At both ends of the way contacts are strained by μ times the sink, where friction builds up
    # and where they hold the box; and the box pitches, so that its centre moves by as much times
    # the square of height over length.
    strain = friction * ground.sink
    allowed = 2.0 * strain * (1.0 + (SIDES[2] / SIDES[1]) ** 2)
    return Slide(friction, speed, float(np.linalg.norm(slid[:2])), closed, allowed)


def set_down(setup: Setup, speed: float) -> SetDown:
    """Lower the box to the ground at a speed [m/s], and on until the rope is slack."""
    crane = roped_crane(setup)
    ground = Ground(box_corners(*SIDES))
    stretch = crane.start.q[crane.layout.index("rope_stretch")]
    start = crane.state(l=ROPE_LENGTH - SET_DOWN_HEIGHT - float(stretch), l_dot=speed)
    duration = (2.0 * SET_DOWN_HEIGHT) / speed + 1.0
    run = _run(setup, crane, ground, start, duration, f"down at {speed:g} m/s")
    pull = _pull(crane, run)
    push = _push(crane, ground, run)
    touched = int(np.flatnonzero(push)[0])
    slack_times = run.t[touched + np.flatnonzero(pull[touched:] <= 0.0)]
    slack_after = math.inf
    if len(slack_times):
        slack_after = float(slack_times[0] - run.t[touched])
    rows_in_air = np.count_nonzero(push[touched:] == 0.0)
    return SetDown(
        speed=speed,
        pull=float(pull.max()),
        push=float(push.max()),
        slack_after=slack_after,
        rebounds=float(rows_in_air * setup.control_period),
    )
