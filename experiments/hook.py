"""A load is attached, carried, set down and released in one run, and the energy adds up.

First a load is attached to a hook that swings, beside a plastic impact by hand. Then the tower
crane makes a round trip: its empty hook comes down to a box on a lorry and takes it, sets it down
on another lorry, and goes back without it.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from cranedyn.controllers import follow
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import ON_GROUND, Ground, Platform, box_corners, box_load
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.recording import Run
from cranedyn.references import spline
from cranedyn.simulation.stages import (
    LoadChange,
    LoadStage,
    StagedRun,
    change_load,
    simulate_stages,
)
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import POINT

STAGES = ("comes with its hook", "carries the box", "goes back")
"""Stages of the round trip."""

SHARES = (0.1, 0.5, 0.9)
"""Masses of a hook as shares of hook and load together."""

SWING_RATE = 0.6
"""Rate of the swing at which the load is attached [rad/s]."""

SWING_LENGTH = 10.0
"""Cable of that hook [m]."""

SIDES = (1.5, 3.0, 1.2)
"""Sides of the box across the jib, along it, and its height [m]."""

BOX = 1000.0
"""Mass of box and hook [kg]."""

HOOK = 100.0
"""Mass of the hook alone [kg]."""

ROPE_STIFFNESS = 2e7
"""Stiffness EA of the rope [N]."""

ROPE_DAMPING = 2e4
"""Damping of the rope [N s/m, of one metre], as in `experiments.liftoff`."""

PICK_UP = 12.0
"""Radius at which the box lies [m]."""

SET_DOWN = 18.0
"""Radius at which it is set down [m]."""

LORRY = 1.0
"""Height of the lorries [m]."""

SLACK = 0.02
"""Slack cable when the box is released [m]."""

RAISED = 5.0
"""Way by which the hook is raised above the lorries [m]."""

LOWERING = 14.0
"""Time for raising or lowering the hook [s]."""

TRAVEL = 36.0
"""Time for the way of the trolley [s]."""

REST = 6.0
"""Time at rest at the end of a stage [s]."""


@dataclass(frozen=True)
class Impact:
    """A load that is attached to a swinging hook.

    Attributes:
        share: Mass of the hook over that of hook and load.
        speed: Speed of the hook after over before.
        lost: Energy lost over the kinetic energy before.
    """

    share: float
    speed: float
    lost: float


def impacts(setup: Setup) -> list[Impact]:
    """Attach loads of several masses to a hook that swings."""
    found = []
    for share in SHARES:
        empty = setup.variant(**POINT, payload_mass=share * BOX)
        loaded = setup.variant(**POINT, payload_mass=BOX)
        state = empty.state(l=SWING_LENGTH, phi_dot=SWING_RATE)
        change = change_load(empty, loaded, state, prescribed=True)
        after = change.state.v[empty.layout.index("phi")] / SWING_RATE
        before = 0.5 * share * BOX * (SWING_LENGTH * SWING_RATE) ** 2
        found.append(Impact(share, float(after), change.lost / before))
    return found


@dataclass(frozen=True)
class RoundTrip:
    """The crane comes, carries the box, and goes back.

    Attributes:
        empty: The crane with its hook alone.
        loaded: The crane with hook and box.
        run: The run.
        pull: Tension of the rope at each row [N].
        heights: Height of the middle of what hangs, at each row [m].
        radii: Its radius, likewise [m].
    """

    empty: Crane
    loaded: Crane
    run: StagedRun
    pull: np.ndarray
    heights: np.ndarray
    radii: np.ndarray

    def row(self, stage: int) -> int:
        """Return the last row of a stage, just before the load changes or the run ends."""
        return int(np.searchsorted(self.run.trajectory.t, self.run.stages[stage].t[-1])) - 1


def round_trip(setup: Setup) -> RoundTrip:
    """Simulate the round trip: down to the box, to the other lorry with it, and back without it."""
    rope = {"rope_stiffness": ROPE_STIFFNESS, "rope_damping": ROPE_DAMPING, "hoist_max": 30.0}
    empty = setup.variant(**box_load(HOOK, 0.3, 0.3, 0.3), **rope)
    loaded = setup.variant(**box_load(BOX, *SIDES), **rope)
    lorries = [Platform((0.0, -radius), (2.0, 4.0), LORRY) for radius in (PICK_UP, SET_DOWN)]
    ground = Ground(box_corners(*SIDES), tuple(lorries), friction=0.5)

    # Cable at which the box just stands: its middle is half of its height above the lorry.
    hang = loaded.state(x=PICK_UP, l=20.0)
    below = 20.0 + float(point_paths(loaded, hang.q[None])[0, 0, 2]) - LORRY - 0.5 * SIDES[2]
    start = empty.state(x=PICK_UP, l=below - RAISED)
    down = [0.0, PICK_UP, below]
    over_lorry = [0.0, SET_DOWN, below - RAISED]
    arrives = LOWERING + REST
    leaves = arrives + 2.0 * LOWERING + TRAVEL + REST
    coming = spline(empty, start, [down], [LOWERING])
    carrying = spline(
        loaded,
        loaded.state(x=PICK_UP, l=below),
        [[0.0, PICK_UP, below - RAISED], over_lorry, [0.0, SET_DOWN, below + SLACK]],
        [LOWERING, TRAVEL, LOWERING],
        at=arrives,
    )
    going = spline(
        empty,
        empty.state(x=SET_DOWN, l=below + SLACK),
        [over_lorry, [0.0, PICK_UP, below - RAISED]],
        [LOWERING, TRAVEL],
        at=leaves,
    )
    period = setup.control_period
    stages = [
        LoadStage(empty, follow(empty, coming, period), arrives, coming),
        LoadStage(loaded, follow(loaded, carrying, period), leaves - arrives, carrying, ground),
        LoadStage(empty, follow(empty, going, period), LOWERING + TRAVEL + REST, going),
    ]
    run = simulate_stages(
        stages,
        start=start,
        drive="motion",
        dt=setup.dt,
        control_period=period,
        engine=setup.engine_of_runs,
        validity="mark",
        monitors=setup.monitors("round trip", sum(stage.duration for stage in stages)),
    )
    whole = run.trajectory
    pull = np.zeros(len(whole))
    middle = np.zeros((len(whole), 3))
    for crane, stage in zip((empty, loaded, empty), run.stages, strict=True):
        first = int(np.searchsorted(whole.t, stage.t[0]))
        rows = slice(first, first + len(stage))
        pull[rows] = rope_tension(crane.layout, JointForces.of(crane), stage.q.T, stage.v.T, 0.0)
        middle[rows] = point_paths(crane, stage.q)[:, 0]
    return RoundTrip(empty, loaded, run, pull, middle[:, 2], np.hypot(middle[:, 0], middle[:, 1]))


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Attach loads to a swinging hook, and make the round trip."""
    hit = impacts(setup)
    trip = round_trip(setup)
    return Outcome(
        tables=[_trip_table(trip), _impact_table(hit)],
        claims=[
            _impact_claim(hit),
            _energy_claim(trip),
            _gentle_claim(trip.run.changes[0]),
            _stands_claim(trip),
            _empty_claim(trip),
        ],
        parameters={"box_kg": BOX, "hook_kg": HOOK, "rope_stiffness_N": ROPE_STIFFNESS},
        trajectories={"round_trip": trip.run.trajectory},
        figures={"round_trip": _figure(trip)},
        recording=_recording(trip),
    )


def _recording(trip: RoundTrip) -> list[Run]:
    """Return the stages for the viewer, each from its own beginning: a crane of a recording has one
    load, so that each stage has a crane of its own.
    """
    cranes = (trip.empty, trip.loaded, trip.empty)
    runs = {}
    for name, crane, stage in zip(STAGES, cranes, trip.run.stages, strict=True):
        runs[name] = (crane, replace(stage, t=stage.t - stage.t[0]))
    return harness.side_by_side(runs, apart=40.0)


def _impact_claim(hit: Sequence[Impact]) -> Claim:
    """Return the claim that impacts are those by hand, v₁ = v₀ m/(m + M)."""
    errors = []
    for impact in hit:
        errors += [abs(impact.speed - impact.share), abs(impact.lost - (1.0 - impact.share))]
    worst = max(errors)
    return Claim(
        "A load attached to a swinging hook shares its momentum as in a plastic impact by hand, "
        f"v₁ = v₀ m/(m + M), within 1e-9 (worst {worst:.0e}).",
        worst < 1e-9,
    )


def _energy_claim(trip: RoundTrip) -> Claim:
    """Return the claim that the energy of the whole run adds up."""
    whole = trip.run.trajectory
    moved = max(abs(change.brought) for change in trip.run.changes)
    left = float(np.abs(whole.unexplained).max())
    return Claim(
        f"The energy of the run adds up across both changes, within 0.1 % of the "
        f"{moved / 1e3:.1f} kJ that a load brings ({100.0 * left / moved:.3f} %).",
        left < 1e-3 * moved,
    )


def _gentle_claim(change: LoadChange) -> Claim:
    """Return the claim that a hook at rest takes the load without an impact."""
    return Claim(
        f"A hook that hangs still takes the box without an impact: {change.lost:.1e} J are lost, "
        "less than 1 J.",
        0.0 <= change.lost < 1.0,
    )


def _stands_claim(trip: RoundTrip) -> Claim:
    """Return the claim that the box stands where it should when it is released."""
    row = trip.row(1)
    beside = abs(trip.radii[row] - SET_DOWN)
    stands = trip.run.stages[1]["phase"][-1] == ON_GROUND
    return Claim(
        f"The box stands on the second lorry when it is released, {100.0 * beside:.1f} cm beside "
        "its place, 5 at most.",
        bool(stands) and beside < 0.05,
    )


def _empty_claim(trip: RoundTrip) -> Claim:
    """Return the claim that the rope holds the hook alone after the release."""
    weight = HOOK * trip.empty.gravity
    pull = float(trip.pull[trip.run.trajectory.t >= trip.run.trajectory.t[-1] - 0.5 * REST].mean())
    return Claim(
        f"At the end the rope holds the hook alone: {pull:.1f} N beside its weight of "
        f"{weight:.1f} N, within 0.5 %.",
        abs(pull / weight - 1.0) < 5e-3,
    )


def _trip_table(trip: RoundTrip) -> ResultTable:
    rows = []
    ends = [-1, *(trip.row(i) for i in range(3))]
    for name, (first, last) in zip(STAGES, itertools.pairwise(ends), strict=True):
        inner = slice(first + 1, last + 1)
        rows.append((name, trip.run.trajectory.t[last], trip.pull[inner].max() / 1e3, last))
    return make_table(
        "Round trip",
        rows,
        ("stage", "", lambda row: row[0]),
        ("until [s]", ".1f", lambda row: row[1]),
        ("largest pull [kN]", ".2f", lambda row: row[2]),
        ("radius then [m]", ".2f", lambda row: trip.radii[row[3]]),
        ("height then [m]", ".2f", lambda row: trip.heights[row[3]]),
    )


def _impact_table(hit: Sequence[Impact]) -> ResultTable:
    return make_table(
        "A load attached to a swinging hook",
        hit,
        ("m/(m + M)", "g", lambda impact: impact.share),
        ("speed after / before", ".9f", lambda impact: impact.speed),
        ("energy lost / before", ".9f", lambda impact: impact.lost),
        ("by hand", "g", lambda impact: 1.0 - impact.share),
    )


def _figure(trip: RoundTrip) -> Figure:
    figure, (height, pull) = panels(2, height=2.2, width=7.0)
    whole = trip.run.trajectory
    height.plot(whole.t, trip.heights, label="middle of hook or box")
    height.set(ylabel="height [m]")
    pull.plot(whole.t, trip.pull / 1e3)
    pull.set(xlabel="time [s]", ylabel="pull [kN]")
    for ax in (height, pull):
        ax.axvspan(*trip.run.stages[1].t[[0, -1]], alpha=0.12, label="with the box")
    legend_above(height, columns=2)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("hook", __doc__, engines=("compiled",))
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
