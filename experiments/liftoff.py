"""Lift-off and set-down: what they do to the rope and to the swing.

A box stands on the ground with a slack rope, the hoist already turns, and the rope takes the box
up; or the box hangs and is set down. Drives follow their motion exactly.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, box_corners, box_load, standing
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import body_points, payload_position
from cranedyn.interfaces import State
from cranedyn.lifting import factors
from cranedyn.lifting.factors import HOISTING, DriveClass, HoistingClass
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.plotting.style import run_colour
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.oracles.bench import locked
from experiments.scenarios.moves import instant

MASS, SIDES = 1000.0, (1.5, 3.0, 1.2)
"""Mass [kg] and sides of the box [m]."""

LARGEST, CREEP = 0.8, 0.1
"""Largest hoisting speed and creep speed [m/s]."""

DRIVES: tuple[DriveClass, ...] = ("HD1", "HD2", "HD4")
"""Drive classes that differ in the speed of lift-off."""

CLASSES: tuple[HoistingClass, ...] = ("HC1", "HC2", "HC3", "HC4")
"""Hoisting classes."""

HOIST_LENGTH, HARD = 1000.0, 5e-4
"""Length of the rope of a hoist of a class [m], so long that its stiffness hardly changes on the
way; and static sink of hard ground [m]."""

ROPE, LENGTH, ROPE_DAMPING, SLING_DAMPING = 2e7, 25.0, 2e4, 500.0
"""EA [N], length [m] and damping [N s/m] of a rope, and damping of the box about its lug
[N m s/rad], for all but the hoisting classes."""

SLACK, ABOVE = 0.02, 0.05
"""Slack of the rope before lift-off, and height of the box before set-down [m]."""

OFFSETS, FRICTIONS, SPEEDS = (0.1, 0.5, 1.0, 2.0), (0.2, 0.6), (0.05, 0.2)
"""Trolley from above the box [m], coefficients of friction and hoisting speeds [m/s] of lifts
off-lead."""

SINK_RATES = (0.05, 0.1, 0.2, 0.4)
"""Speeds of setting down [m/s]."""

THROWN_SPEEDS = (0.5, 1.5)
"""Speeds of a box on the ground below a slack rope, which friction alone brings to rest [m/s]."""

THROWN_SLACK = 0.5
"""Slack of its rope [m], so that it stays slack until the box rests."""

ADIABATIC = 0.02
"""Relative error of the law that a swing grows as l^(-3/4) on a shortening rope, here: of the order
of the speed over l ω."""


class LiftOff(NamedTuple):
    """Lift-off by a hoist of a class at a speed [m/s]: largest tension over the weight, and how far
    it may be from 1 + β2 v.
    """

    hoisting: HoistingClass
    drive: DriveClass
    speed: float
    simulated: float
    allowed: float

    @property
    def closed(self) -> float:
        """1 + β2 v."""
        return 1.0 + HOISTING[self.hoisting].slope * self.speed

    @property
    def standard(self) -> float:
        """φ2 of the standard."""
        return factors.phi_2(self.hoisting, self.speed, self.drive)


class OffLead(NamedTuple):
    """Lift-off with the trolley beside the box [m]: angle of the rope as it gets taut [rad], way
    that the box slides [m], largest swing as on a rope of the length at lift-off [rad].
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
    """Set-down at a speed [m/s]: largest tension and force of the ground over the weight, times
    from touching to a slack rope and in the air again [s].
    """

    speed: float
    pull: float
    push: float
    slack_after: float
    rebounds: float


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Lift the box off and set it down in all ways."""
    picked = [_pick_up(setup, hoisting, drive) for hoisting in CLASSES for drive in DRIVES]
    leaning = [_off_lead(setup, *case) for case in itertools.product(FRICTIONS, OFFSETS, SPEEDS)]
    slides = [_slide(setup, *case) for case in itertools.product(FRICTIONS, THROWN_SPEEDS)]
    down = [_set_down(setup, speed) for speed in SINK_RATES]
    worst = max(leaning, key=lambda lift: lift.swing / lift.lead)
    return Outcome(
        tables=[
            _pick_up_table(picked),
            _off_lead_table(leaning),
            _slide_table(slides),
            _set_down_table(down),
        ],
        claims=[*_pick_up_claims(picked), _slide_claim(slides), *_other_claims(worst, down)],
        trajectories={"off_lead": worst.run},
        figures={"lift_off": _figure(picked)},
        recording=harness.side_by_side({"off-lead": (_roped(setup), worst.run)}, apart=0.0),
    )


@cache
def _crane(gravity: float, rope: float, length: float, **values: float) -> Crane:
    """Return a crane with the box and a rope of an EA [N] that just reaches it on the ground when
    it is as long as at the start [m].
    """
    top = length + SIDES[2]
    heights = {"pivot_height": top, "mast_height": top - 2.0, "total_height": top + 5.0}
    hoist = {"hoist_max": 2.0 * length, "hoist_init": length, "rope_stiffness": rope}
    links = {"dummy_mass": 1.0, "dummy_inertia": 1.0}
    numbers = {**box_load(MASS, *SIDES), **heights, **hoist, **links, **values}
    return load_crane(gravity=gravity, values=numbers)


def _roped(setup: Setup) -> Crane:
    """Return the crane with a real rope."""
    damping = {"rope_damping": ROPE_DAMPING, "damp_sling": SLING_DAMPING}
    return _crane(setup.gravity, ROPE, LENGTH, **damping)


def _run(
    setup: Setup, crane: Crane, ground: Ground, start: State, duration: float, label: str
) -> Trajectory:
    """Return a run in which the drives keep their speed."""
    clocks = instant(duration, setup.control_period)
    options = {"drive": "motion", "validity": "mark", "ground": ground}
    return setup.simulate(
        crane, locked(crane), None, start=start, duration=clocks, label=label, **options
    )


def _from_ground(crane: Crane, ground: Ground, offset: float, slack: float, speed: float) -> State:
    """Return the start of a lift-off: trolley beside the box by an offset [m], rope slack [m], and
    the hoist at its speed [m/s].
    """
    layout = crane.layout
    rope = crane.start.q[crane.layout.index("l")]
    lead = math.atan2(offset, rope)
    state = crane.state(phi=lead, sling_radial=-lead, l=math.hypot(rope, offset) + slack)
    v = np.zeros(layout.n)
    v[layout.at("l", "rope_stretch")] = -speed, speed
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
        forces.append(float(np.sum(contacts.reaction(*place, place[0])[0][2])))
    return np.array(forces) / (crane.payload_mass * crane.gravity)


def _pick_up(setup: Setup, hoisting: HoistingClass, drive: DriveClass) -> LiftOff:
    speed = factors.pick_up_speed(drive, LARGEST, CREEP)
    omega = HOISTING[hoisting].slope * setup.gravity
    crane = _crane(setup.gravity, MASS * omega**2 * HOIST_LENGTH, HOIST_LENGTH)
    ground = Ground(box_corners(*SIDES), sink=HARD)
    start = _from_ground(crane, ground, 0.0, SLACK, speed)
    # the rope gets taut, takes up the weight, and the box bounces up once
    stretch = setup.gravity / omega**2
    jump = HOISTING[hoisting].slope * speed
    duration = (SLACK + stretch) / speed + 1.5 * math.pi / omega
    run = _run(setup, crane, ground, start, duration, f"{hoisting}, {drive}")
    # the ground is soft; a rope that strains and shortens gets stiffer; the peak is between rows
    strain = (stretch + 2.0 * speed / omega) / HOIST_LENGTH
    allowed = jump * (HARD / stretch + 2.0 * strain + (omega * setup.control_period) ** 2)
    return LiftOff(hoisting, drive, speed, float(_pull(crane, run).max()), allowed)


def _off_lead(setup: Setup, friction: float, offset: float, speed: float) -> OffLead:
    crane = _roped(setup)
    ground = Ground(box_corners(*SIDES), (), friction)
    start = _from_ground(crane, ground, offset, SLACK / 4.0, speed)
    run = _run(setup, crane, ground, start, 20.0, f"{offset:g} m off-lead")
    lead = run["phi_rad"]
    length = run["l_m"]
    off = int(np.flatnonzero(_push(crane, ground, run))[-1])
    swing = np.abs(lead[off:]) * (length[off:] / length[off]) ** 0.75
    slid = payload_position(crane, run.q[off]) - payload_position(crane, run.q[0])
    distance = float(np.linalg.norm(slid[:2]))
    return OffLead(friction, offset, speed, float(lead[0]), distance, float(swing.max()), run)


def _slide(setup: Setup, friction: float, speed: float) -> Slide:
    """Let the box slide along the jib below a slack rope, level on the ground, until it rests."""
    crane = _roped(setup)
    ground = Ground(box_corners(*SIDES), (), friction)
    layout = crane.layout
    start = standing(crane, ground, crane.state(phi=0.0, l=LENGTH + THROWN_SLACK))
    closed = speed**2 / (2.0 * friction * setup.gravity)
    # The box keeps level: its lug swings about the pivot, and the sling turns back as fast.
    swing = speed / float(start.q[layout.at("l", "rope_stretch")].sum())
    v = np.zeros(layout.n)
    v[layout.at("phi", "sling_radial")] = swing, -swing
    duration = 1.5 * speed / (friction * setup.gravity) + 0.5
    run = _run(setup, crane, ground, State(start.q, v), duration, f"slides at {speed:g} m/s")
    way = payload_position(crane, run.q[-1]) - payload_position(crane, run.q[0])
    # At both ends of the way contacts are strained by μ times the sink, where friction builds up
    # and where they hold the box; and the box pitches, so that its centre moves by as much times
    # the square of height over length.
    strain = friction * ground.sink
    allowed = 2.0 * strain * (1.0 + (SIDES[2] / SIDES[1]) ** 2)
    return Slide(friction, speed, float(np.linalg.norm(way[:2])), closed, allowed)


def _set_down(setup: Setup, speed: float) -> SetDown:
    crane = _roped(setup)
    ground = Ground(box_corners(*SIDES))
    stretch = crane.start.q[crane.layout.index("rope_stretch")]
    start = crane.state(l=LENGTH - ABOVE - float(stretch), l_dot=speed)
    run = _run(setup, crane, ground, start, (2.0 * ABOVE) / speed + 1.0, f"down at {speed:g} m/s")
    pull = _pull(crane, run)
    push = _push(crane, ground, run)
    touched = int(np.flatnonzero(push)[0])
    slack = run.t[touched + np.flatnonzero(pull[touched:] <= 0.0)]
    rebounds = float(np.count_nonzero(push[touched:] == 0.0) * setup.control_period)
    waited = float(slack[0] - run.t[touched]) if len(slack) else math.inf
    return SetDown(speed, float(pull.max()), float(push.max()), waited, rebounds)


def _pick_up_table(picked: Sequence[LiftOff]) -> ResultTable:
    return make_table(
        "Lift-off by hoisting and drive class",
        picked,
        ("class", "", lambda p: p.hoisting),
        ("drive", "", lambda p: p.drive),
        ("v_h [m/s]", ".2f", lambda p: p.speed),
        ("T/W", ".4f", lambda p: p.simulated),
        ("1 + β2 v_h", ".4f", lambda p: p.closed),
        ("allowed", ".0e", lambda p: p.allowed),
        ("φ2", ".3f", lambda p: p.standard),
        note="The hoist turns at v_h, the rope gets taut, the box leaves hard ground. Allowed: by "
        "the sink of the ground and the strain of the rope. φ2 = φ2,min + β2 v_h, EN 1991-3 and "
        "13001-2 read second hand. HD5 lifts off without speed.",
    )


def _figure(picked: Sequence[LiftOff]) -> Figure:
    """Draw φ2 and simulated tensions over the speed of lift-off, a colour a class."""
    figure, (ax,) = panels(width=7.0, height=3.6)
    speeds = np.array([0.0, max(p.speed for p in picked)])
    for i, hoisting in enumerate(CLASSES):
        slope, intercept = HOISTING[hoisting]
        drawn = [p for p in picked if p.hoisting == hoisting]
        colour = run_colour(i)
        ax.plot(speeds, intercept + slope * speeds, color=colour, label=f"φ2, {hoisting}")
        ax.plot(speeds, 1.0 + slope * speeds, color=colour, linestyle=":")
        ax.plot([p.speed for p in drawn], [p.simulated for p in drawn], "o", color=colour)
    ax.plot([], [], ":", color=COLOURS["setpoint"], label="1 + β2 v")
    ax.plot([], [], "o", color=COLOURS["setpoint"], label="simulated")
    ax.set(xlabel="hoisting speed at lift-off [m/s]", ylabel="tension over weight")
    ax.legend()
    return figure


def _off_lead_table(leaning: Sequence[OffLead]) -> ResultTable:
    return make_table(
        "Lift-off by a rope that leans",
        leaning,
        ("friction", ".1f", lambda o: o.friction),
        ("offset [m]", ".1f", lambda o: o.offset),
        ("v_h [m/s]", ".2f", lambda o: o.speed),
        ("off-lead [°]", ".2f", lambda o: math.degrees(o.lead)),
        ("slid [m]", ".2f>0.01", lambda o: o.slid),
        ("swing [°]", ".2f", lambda o: math.degrees(o.swing)),
        ("swing/off-lead", ".2f", lambda o: o.swing / o.lead),
        note="Off-lead: as the rope gets taut. Swing: largest in 20 s, as on a rope of the length "
        "at lift-off.",
    )


def _slide_table(slides: Sequence[Slide]) -> ResultTable:
    return make_table(
        "A box that slides to rest",
        slides,
        ("friction", ".1f", lambda s: s.friction),
        ("v [m/s]", ".1f", lambda s: s.speed),
        ("slid [m]", ".4f", lambda s: s.slid),
        ("v²/(2 μ g)", ".4f", lambda s: s.closed),
        ("allowed", ".0e", lambda s: s.allowed),
        note="On the ground below a slack rope. Allowed: by the strain of contacts that stick and "
        "the pitch of the box.",
    )


def _set_down_table(down: Sequence[SetDown]) -> ResultTable:
    return make_table(
        "Set-down",
        down,
        ("v [m/s]", ".2f", lambda d: d.speed),
        ("T/W at most", ".3f", lambda d: d.pull),
        ("ground/W at most", ".2f", lambda d: d.push),
        ("slack after [s]", ".2f", lambda d: d.slack_after),
        ("in the air again [s]", ".2f", lambda d: d.rebounds),
    )


def _pick_up_claims(picked: Sequence[LiftOff]) -> list[Claim]:
    off = max(picked, key=lambda p: abs(p.simulated - p.closed) / p.allowed)
    near = min(picked, key=lambda p: p.standard - p.simulated)
    return [
        Claim(
            f"A box that leaves the ground loads the rope by 1 + β2 v_h in {len(picked)} cases; "
            f"worst: {off.hoisting} {off.drive}, {off.simulated:.4f} beside {off.closed:.4f}, "
            f"{off.allowed:.0e} allowed.",
            all(abs(p.simulated - p.closed) <= p.allowed for p in picked),
        ),
        Claim(
            f"φ2 covers each of them; nearest: {near.hoisting} {near.drive}, {near.simulated:.3f} "
            f"of {near.standard:.3f}.",
            near.simulated <= near.standard,
        ),
    ]


def _slide_claim(slides: Sequence[Slide]) -> Claim:
    off = max(slides, key=lambda s: abs(s.slid - s.closed) / s.allowed)
    return Claim(
        f"A box that slides rests after v²/(2 μ g) in {len(slides)} cases; worst: {off.slid:.4f} m "
        f"beside {off.closed:.4f} m, {off.allowed:.0e} m allowed.",
        all(abs(s.slid - s.closed) <= s.allowed for s in slides),
    )


def _other_claims(worst: OffLead, down: Sequence[SetDown]) -> list[Claim]:
    hard = max(down, key=lambda d: d.pull)
    return [
        Claim(
            "After lift-off the load swings no farther than the rope leaned; worst: "
            f"{worst.swing / worst.lead:.3f} of it, {1.0 + ADIABATIC:g} allowed.",
            worst.swing <= (1.0 + ADIABATIC) * worst.lead,
        ),
        Claim(
            f"A set-down loads the rope by no more than the weight: {hard.pull:.4f} at most; it "
            "goes slack in each case and the box stays down.",
            hard.pull <= 1.001
            and all(math.isfinite(d.slack_after) and d.rebounds == 0.0 for d in down),
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("liftoff", __doc__, engines=("compiled", "pinocchio"))
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
