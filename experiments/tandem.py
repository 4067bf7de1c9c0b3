"""Two cranes at one load: shares beside statics, and what late or stopped drives do to them.

A beam hangs on the ropes of two tower cranes. First its shares, its frequencies, its drift in the
wind and its energy stand beside closed forms. Then it is lifted as planned, in a gust, with one
crane late, with a drive that stops half way, and with its centre of mass elsewhere than planned.

With a file of somebody's own, its lift is planned around obstacles, simulated in its wind, and
judged.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from cranedyn.analysis.swing import zero_crossings
from cranedyn.command import command
from cranedyn.disturbances.wind import cosine_gust, steady
from cranedyn.lifts.tandem.drives import DriveMotion, TandemDrives
from cranedyn.lifts.tandem.judgement import TandemRequirements, judge_tandem
from cranedyn.lifts.tandem.load import TandemLoad, TandemRope
from cranedyn.lifts.tandem.load_wind import LoadWind
from cranedyn.lifts.tandem.plan import TandemLift, TandemPlan, plan_tandem
from cranedyn.lifts.tandem.recording import record_tandem
from cranedyn.lifts.tandem.rules import required_capacity
from cranedyn.lifts.tandem.simulation import LoadPose, TandemRun, simulate_tandem
from cranedyn.lifts.tandem.statics import lean_in_wind, static_shares, sway_frequency, yaw_frequency
from cranedyn.lifts.tandem.tandem_file import TandemJob, read_tandem
from cranedyn.lifts.tandem.yard import tandem_yard
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.plotting.style import run_colour
from cranedyn.verdict import Verdict, overall
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table

BEAM = TandemLoad(4000.0, (15.0, 0.6, 0.8), lugs=((-7.0, 0.0, 0.4), (7.0, 0.0, 0.4)))
"""The load: a beam of 4 t with a lug near each end."""

ROPE = TandemRope(stiffness=2e7, damping=2e4)
"""Both ropes: four falls of a rope of 16 mm have about this stiffness."""

YAW = -math.pi / 2.0
"""Heading of the beam, along the line of the towers [rad]."""

START = (0.0, -32.0, 5.0)
"""Centre of mass of the beam at the start [m]."""

GOAL = (6.0, -32.0, 12.0)
"""Its place at the end [m]."""

INCLINATION = math.radians(3.0)
"""Angle of a rope from plumb that the lift may reach [rad]."""

DT = 1e-3
"""Physics step [s]; the stretch of a rope swings in 0.3 s."""

FREE_SWING = 30.0
"""Duration of the free swings [s]."""

RULE = required_capacity(1.0)
"""Share over the static share that a code of practice provides for, see
`cranedyn.lifts.tandem.rules`."""


class TandemCase(NamedTuple):
    """A lift of the beam.

    Attributes:
        name: What is done, in words.
        run: The run.
        factors: Largest tension of each rope over the static share that was planned with, shape
            (2,).
        tilt: Largest angle of the beam from level [rad].
        turn: Largest angle by which it turns from its heading [rad].
    """

    name: str
    run: TandemRun
    factors: np.ndarray
    tilt: float
    turn: float


class ComparedNumber(NamedTuple):
    """A number of a simulation beside its closed form.

    Attributes:
        name: What it is.
        simulated: The number of the simulation.
        closed: The number of the closed form.
        allowed: Largest relative difference: of the step and of the stretch of the ropes.
    """

    name: str
    simulated: float
    closed: float
    allowed: float

    @property
    def difference(self) -> float:
        """Relative difference."""
        return self.simulated / self.closed - 1.0


WIND = 8.0
"""Steady wind in which the drift is compared, and the gust of a lift [m/s]."""

GUST_DURATION = 9.0
"""Duration of that gust [s], about the period in which the beam swings across its lugs."""

WIND_DURATION = 5.0
"""Time for which the beam hangs in a steady wind [s]."""


def experiment(setup: Setup) -> tuple[Outcome, TandemRun]:
    """Compare with closed forms, then lift the beam in all ways; return the planned lift, too."""
    lift = TandemLift(tandem_yard(), ("north", "south"), BEAM, ROPE)
    plan = plan_tandem(lift, START, GOAL, yaw=YAW)
    variants = _variants(plan)
    show_done = setup.reporter.count("lifts", len(variants) + 1)
    compared = _compared(lift)
    show_done(1)
    cases = []
    for variant in variants:
        cases.append(_case(variant, plan))
        show_done(1 + len(cases))
    planned = cases[0]
    checks = judge_tandem(planned.run, TandemRequirements(inclination=INCLINATION))
    note = (
        f"A beam of {BEAM.mass / 1e3:g} t on lugs 14 m apart; a code of practice provides for "
        f"{RULE:g} where two cranes are not synchronised. Drives that stop do so half way."
    )
    outcome = Outcome(
        tables=[_case_table(cases, note), _compared_table(compared), _check_table(checks)],
        claims=[*_claims(compared, cases, plan, checks), *_balance_claims(planned.run)],
        parameters={"mass_kg": BEAM.mass, "dt_s": DT, "duration_s": plan.duration},
        trajectories={f"tandem_{i}": case.run for i, case in enumerate(cases)},
        figures={"shares": _figure(cases)},
        next_commands=["cranedyn view {folder}/tandem.rrd"],
    )
    return outcome, planned.run


def _compared(lift: TandemLift) -> list[ComparedNumber]:
    """Return shares and frequencies of a beam that hangs from drives that stand."""
    gravity = lift.gravity
    off_centre = replace(BEAM, lugs=((-7.0, 0.0, 0.4), (5.0, 0.0, 0.4)))
    hanging = replace(lift, load=off_centre)
    place = (0.0, -33.0, 5.0)
    still = _standing(hanging, place)
    run = simulate_tandem(hanging, still, start=_pose(place), duration=2.0, dt=DT)
    weight = BEAM.mass * gravity
    compared = []
    for name, pull, share in zip(
        lift.names, run.tensions[-1], static_shares(off_centre), strict=True
    ):
        compared.append(ComparedNumber(f"share of {name}", pull / weight, share, 1e-5))

    still = _standing(lift, START)
    winch = lift.stations[0].crane.winch
    unstretched = float(still.first.position[0, winch])
    length = unstretched * (1.0 + 0.5 * BEAM.mass * gravity / ROPE.stiffness)
    moved = LoadPose(np.add(START, (0.0, 0.02, 0.0)), Rotation.from_euler("z", YAW + 0.002))
    run = simulate_tandem(lift, still, start=moved, duration=FREE_SWING, dt=DT)
    sway = _frequency(run.t, run["load_y_m"] - START[1])
    yaw = _frequency(run.t, run["yaw_rad"] - YAW)
    # Zero crossings between rows of 20 ms, and a period of small swings: 1e-5.
    compared += [
        ComparedNumber("sway along the lugs [rad/s]", sway, sway_frequency(length, gravity), 1e-5),
        ComparedNumber("turning [rad/s]", yaw, yaw_frequency(BEAM, length, gravity), 1e-5),
    ]
    return [*compared, _drift(lift)]


def _drift(lift: TandemLift) -> ComparedNumber:
    """Return how far a beam hangs aside in a steady wind across its lugs, where statics say it
    hangs still.
    """
    gravity = lift.gravity
    height = float(BEAM.lugs[0][2])
    lean = lean_in_wind(BEAM, WIND, gravity)
    still = _standing(lift, START)
    winch = lift.stations[0].crane.winch
    unstretched = float(still.first.position[0, winch])
    pull = 0.5 * BEAM.mass * gravity
    length = unstretched * (1.0 + pull / math.cos(lean) / ROPE.stiffness)
    plumb = unstretched * (1.0 + pull / ROPE.stiffness)
    # The pivots are above the lugs of a beam that hangs plumb at the start.
    aside = (length + height) * math.sin(lean)
    down = (length + height) * math.cos(lean) - (plumb + height)
    # The wind blows along X of the site; a lean towards X turns the beam about Y.
    attitude = Rotation.from_euler("y", -lean) * Rotation.from_euler("z", YAW)
    start = LoadPose(np.add(START, (aside, 0.0, -down)), attitude)
    wind = LoadWind(steady(WIND), 0.0)
    run = simulate_tandem(lift, still, start=start, duration=WIND_DURATION, dt=DT, wind=wind)
    drift = float(np.mean(run["load_x_m"])) - START[0]
    return ComparedNumber(f"drift in a wind of {WIND:g} m/s [m]", drift, aside, 1e-6)


def _standing(lift: TandemLift, place: Sequence[float]) -> TandemDrives:
    """Return drives that stand where a lift from a place begins."""
    above = (place[0], place[1], place[2] + 1.0)
    plan = plan_tandem(lift, place, above, yaw=YAW)
    motions = []
    for motion in plan.drives:
        position = np.repeat(motion.position[:1], 2, axis=0)
        motions.append(DriveMotion(np.array([0.0, 1.0]), position, np.zeros_like(position)))
    return TandemDrives(*motions)


def _pose(place: Sequence[float] | np.ndarray) -> LoadPose:
    """Return the beam at a place, level and along the line of the towers."""
    return LoadPose(np.array(place, dtype=float), Rotation.from_euler("z", YAW))


def _frequency(t: np.ndarray, values: np.ndarray) -> float:
    """Return the angular frequency of a swing about zero by its zero crossings [rad/s]."""
    return math.pi / float(np.mean(np.diff(zero_crossings(t, values))))


class _Variant(NamedTuple):
    """How a lift differs from its plan.

    Attributes:
        name: What is done, in words.
        drives: How the drives really move.
        load: The real load; None for that of the plan.
        wind: Wind on it; None for calm air.
    """

    name: str
    drives: TandemDrives
    load: TandemLoad | None = None
    wind: LoadWind | None = None


def _variants(plan: TandemPlan) -> list[_Variant]:
    """Return all ways to carry a plan out, that as planned first."""
    half_way = plan.duration / 2.0
    slew, _, hoist = plan.lift.limits_of(1).accelerations
    drives = plan.drives
    gust = cosine_gust(steady(0.0), WIND, at=half_way - GUST_DURATION / 2.0, lasts=GUST_DURATION)
    heavier_end = replace(BEAM, lugs=((-7.5, 0.0, 0.4), (6.5, 0.0, 0.4)))
    return [
        _Variant("as planned", drives),
        _Variant(f"in a gust of {WIND:g} m/s", drives, wind=LoadWind(gust, 0.0)),
        _Variant("south 0.5 s late", drives.delayed(0.5)),
        _Variant("south 2 s late", drives.delayed(2.0)),
        _Variant(
            "hoist of south stops",
            drives._replace(second=drives.second.stopped(2, half_way, float(hoist))),
        ),
        _Variant(
            "slew of south stops",
            drives._replace(second=drives.second.stopped(0, half_way, float(slew))),
        ),
        _Variant("centre of mass 0.5 m aside", drives, heavier_end),
    ]


def _case(variant: _Variant, plan: TandemPlan) -> TandemCase:
    """Carry a plan out as a variant says."""
    load = variant.load
    lift = plan.lift if load is None else replace(plan.lift, load=load)
    place = plan.start
    if load is not None:
        # The lugs hang where they were planned, so that the centre of mass is elsewhere.
        moved = np.mean(np.array(BEAM.lugs) - np.array(load.lugs), axis=0)
        place = plan.start + Rotation.from_euler("z", YAW).apply(moved)
    run = simulate_tandem(lift, variant.drives, start=_pose(place), dt=DT, wind=variant.wind)
    return _case_of(variant.name, run, plan)


def _case_of(name: str, run: TandemRun, plan: TandemPlan) -> TandemCase:
    """Return a run beside the static shares of its plan and the heading of its load."""
    lift = plan.lift
    static = static_shares(lift.load) * lift.load.mass * lift.gravity
    return TandemCase(
        name=name,
        run=run,
        factors=run.tensions.max(axis=0) / static,
        tilt=float(np.hypot(run["roll_rad"], run["pitch_rad"]).max()),
        turn=float(np.abs(run["yaw_rad"] - plan.yaw).max()),
    )


def _case_table(cases: Sequence[TandemCase], note: str = "") -> ResultTable:
    first, second = cases[0].run.lift.names
    return make_table(
        "Largest pulls over the static shares",
        cases,
        ("lift", "", lambda c: c.name),
        (first, ".3f", lambda c: float(c.factors[0])),
        (second, ".3f", lambda c: float(c.factors[1])),
        ("ropes lean [°]", ".2f", lambda c: math.degrees(c.run.largest_inclination)),
        ("tilt [°]", ".2f", lambda c: math.degrees(c.tilt)),
        ("turn [°]", ".2f", lambda c: math.degrees(c.turn)),
        note=note,
    )


def _compared_table(compared: Sequence[ComparedNumber]) -> ResultTable:
    return make_table(
        "Beside closed forms",
        compared,
        ("quantity", "", lambda c: c.name),
        ("simulated", ".6f", lambda c: c.simulated),
        ("closed form", ".6f", lambda c: c.closed),
        ("relative difference", "+.1e>1e-8", lambda c: c.difference),
        note="Shares: of a beam whose centre of mass is nearer to south. Frequencies: of swings of "
        "2 cm and 0.1° on ropes that damp.",
    )


def _check_table(checks: Sequence[Claim]) -> ResultTable:
    return make_table(
        "The planned lift, judged",
        checks,
        ("verdict", "", lambda c: c.verdict.word),
        ("check", "", lambda c: c.sentence),
    )


def _claims(
    compared: Sequence[ComparedNumber],
    cases: Sequence[TandemCase],
    plan: TandemPlan,
    checks: Sequence[Claim],
) -> list[Claim]:
    """Return the claims on closed forms and on the lifts."""
    worst = max(compared, key=lambda c: abs(c.difference) / c.allowed)
    planned, in_gust, slightly_late, late, hoist_stops, *_ = cases
    after = planned.run.t >= plan.duration
    left = planned.run.centres[after]
    error = float(np.linalg.norm(left - plan.goal, axis=1).max())
    failing = [check for check in checks if check.verdict is Verdict.FAILS]
    return [
        Claim(
            f"Shares, frequencies and drift are those of closed forms in {len(compared)} cases; "
            f"worst: {worst.name}, {worst.difference:+.1e} of {worst.allowed:g} allowed.",
            all(abs(c.difference) <= c.allowed for c in compared),
        ),
        Claim(
            f"As planned the beam arrives and hangs still within {1e3 * error:.1f} mm of its goal "
            "(5 mm allowed: the roll of the beam that the plan neglects).",
            error <= 5e-3,
        ),
        Claim(
            f"No check of the planned lift fails; its ropes pull with {planned.factors.max():.3f} "
            "of the static shares at most.",
            not failing,
        ),
        Claim(
            f"A crane that is 0.5 s late stays below {RULE:g} of the static shares "
            f"({slightly_late.factors.max():.3f}), and so does one that is 2 s late "
            f"({late.factors.max():.3f}).",
            max(slightly_late.factors.max(), late.factors.max()) <= RULE,
        ),
        _gust_claim(in_gust),
        _tilt_claim(hoist_stops),
    ]


def _gust_claim(case: TandemCase) -> Claim:
    """Return the claim on the energy of a beam in a gust."""
    balance = _open_balance(case.run)
    gained = float(np.ptp(case.run["energy_J"]))
    lean = math.degrees(case.run.largest_inclination)
    return Claim(
        f"In a gust across the beam the ropes lean by {lean:.1f}°, and its energy adds up with the "
        f"{case.run['wind_J'][-1]:.0f} J of the wind, to {balance / gained:.1e} of what it gains "
        "(1e-3 allowed).",
        balance / gained <= 1e-3,
    )


def _tilt_claim(case: TandemCase) -> Claim:
    """Return the claim on the shares of a beam that is left askew by a hoist that stops."""
    run = case.run
    tilt = float(run["roll_rad"][-1]), float(run["pitch_rad"][-1])
    # Pitch is about Y of the beam: positive lowers the end of its second lug.
    shares = run.tensions[-1] / run.tensions[-1].sum()
    closed = static_shares(BEAM, -tilt[1])
    return Claim(
        f"A hoist that stops half way leaves the beam {math.degrees(abs(tilt[1])):.1f}° askew; its "
        f"share of north is then {shares[0]:.4f}, by statics of plumb ropes {closed[0]:.4f} (0.002 "
        "allowed, since the ropes lean).",
        abs(shares[0] - closed[0]) <= 2e-3,
    )


def _balance_claims(run: TandemRun) -> list[Claim]:
    """Return the claim on the energy of the planned lift."""
    gained = run["energy_J"] - run["energy_J"][0]
    share = _open_balance(run) / float(gained[-1])
    # The sums take each step at its begin: an error of the order of the step, as the rule has.
    return [
        Claim(
            "The energy of the beam is what the cranes put in less what the ropes dissipate, to "
            f"{share:.1e} of the {gained[-1] / 1e3:.1f} kJ that it gains (1e-3 allowed).",
            share <= 1e-3,
        )
    ]


def _open_balance(run: TandemRun) -> float:
    """Return the largest energy of a run that nothing accounts for [J]."""
    gained = run["energy_J"] - run["energy_J"][0]
    return float(np.abs(gained - run["input_J"] - run["wind_J"] + run["loss_J"]).max())


def own_experiment(job: TandemJob) -> tuple[Outcome, TandemRun]:
    """Plan, simulate and judge a lift of a file; return its run, too."""
    plan = job.plan()
    run = simulate_tandem(job.lift, plan, dt=DT, wind=job.wind)
    checks = judge_tandem(run, job.requirements)
    case = _case_of("as planned" if run.wind is None else "in the wind", run, plan)
    left = run.centres[run.t >= plan.duration]
    error = float(np.linalg.norm(left.mean(axis=0) - plan.goal))
    complete = overall(checks)
    outcome = Outcome(
        tables=[_check_table(checks), _way_table(plan), _case_table([case])],
        claims=[
            *checks,
            Claim(f"{job.name}: the lift is certified, all {len(checks)} checks hold.", complete),
        ],
        parameters={
            "mass_kg": job.lift.load.mass,
            "dt_s": DT,
            "duration_s": plan.duration,
            "mean_distance_from_goal_m": error,
        },
        trajectories={"tandem": run},
        figures={"shares": _figure([case])},
        next_commands=["cranedyn view {folder}/tandem.rrd"],
    )
    return outcome, run


def _way_table(plan: TandemPlan) -> ResultTable:
    places = [("start", plan.start)]
    places += [(f"via {i}", place) for i, place in enumerate(plan.via, start=1)]
    places.append(("goal", plan.goal))
    return make_table(
        "Way of the load",
        places,
        ("place", "", lambda p: p[0]),
        ("x [m]", ".2f", lambda p: float(p[1][0])),
        ("y [m]", ".2f", lambda p: float(p[1][1])),
        ("z [m]", ".2f", lambda p: float(p[1][2])),
        note=f"The load stands still at each place; the whole way takes {plan.duration:.1f} s.",
    )


def _figure(cases: Sequence[TandemCase]) -> Figure:
    """Draw the pulls of both ropes over the static shares, a colour a lift."""
    figure, axes = panels(2, height=2.4, sharex=True)
    for crane, axis in enumerate(axes):
        for i, case in enumerate(cases):
            lift = case.run.lift
            # The load that is planned with is that of the first case.
            load = cases[0].run.lift.load
            static = static_shares(load)[crane] * load.mass * lift.gravity
            pull = case.run.tensions[:, crane] / static
            axis.plot(case.run.t, pull, color=run_colour(i), label=case.name)
        axis.set_ylabel(f"{cases[0].run.lift.names[crane]}: pull over share")
    axes[-1].set_xlabel("time [s]")
    legend_above(axes[0], columns=3)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line, then write the recording of the planned lift."""
    runs: list[tuple[TandemRun, Path]] = []

    def recorded(options: argparse.Namespace, setup: Setup) -> Outcome:
        job = None if options.site is None else read_tandem(options.site)
        outcome, planned = experiment(setup) if job is None else own_experiment(job)
        runs.append((planned, options.folder))
        return outcome

    parser = harness.parser("tandem", __doc__, recording=False, engines=("pinocchio",))
    text = (
        "a lift of your own as TOML, see docs/howto/tandem_lift.md; without it that of the example"
    )
    parser.add_argument("--site", metavar="FILE", default=None, help=text)
    code = harness.run_experiment(parser, recorded, argv)
    return command(lambda: _write_recording(*runs[0], code)) if runs else code


def _write_recording(run: TandemRun, folder: Path, code: int) -> int:
    """Write the recording of a run, and return the exit code of the experiment."""
    print(f"In 3D: {record_tandem(folder / 'tandem.rrd', run)}.")
    return code


if __name__ == "__main__":
    sys.exit(main())
