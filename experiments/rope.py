"""A rope with mass, and sheaves with friction: frequencies, pull and hoisting, beside theory.

The rope of the tower crane weighs 78 kg where it hangs 15 m on four falls, beside a load of 1 t.
Bodies on the rope carry this mass. They are compared with the Bessel functions of a heavy rope, and
the pull of the hoist with the weight of all that hangs.

The bodies keep the mass of one cable length while the hoist runs. What that does to the swing of a
load is compared with an independent solution of a running rope. Finally a hoist with friction in
its sheaves, on a rope without mass, raises and lowers a load.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.analysis.swing import zero_crossings
from cranedyn.controllers import follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.equations_of_motion import holding_effort, natural_frequencies
from cranedyn.lifts.judging.chart import Reeving
from cranedyn.lifts.judging.drum import Drum, Winch
from cranedyn.model.crane import Crane
from cranedyn.model.heavy_rope import bodies_for, rope_bends
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.references import spline
from cranedyn.references.simple import Spline
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import POINT
from experiments.scenarios.running_rope import CableMotion, RunningRope

LOAD = 1000.0
"""Mass of the load [kg]."""

FALLS = 4
"""Falls that carry it."""

ROPE_MASS = 1.3
"""Mass of a metre of steel rope of 18 mm [kg/m]."""

LENGTH = 15.0
"""Cable length of the frequencies [m]."""

BODIES = (1, 2, 3, 4, 6, 8, 12)
"""Numbers of bodies of which the frequencies are compared."""

MODES = 3
"""Frequencies that are compared: the swing and two vibrations of the rope."""

USUAL_BODIES = 3
"""Bodies of the runs on a rope with mass: the default of the crane."""

LENGTHS = (5.0, 10.0, 15.0, 20.0, 25.0)
"""Cable lengths at which the hoist holds the load [m]."""

SMALL_SWING = 1e-3
"""Swing at the start of the runs that are compared with linear theory [rad]."""

HOIST_ENDS = (25.0, 10.0)
"""Cable length from which, and to which, the swinging load is hoisted [m]."""

HOIST_TIME = 40.0
"""Time for it [s]."""

AFTERWARDS = 10.0
"""Time for which the load swings on at the last length [s]."""

SHEAVE_FRICTION = 0.01
"""Coefficient of friction of a rope on its sheaves, half a turn each: rolling bearings pass on some
97 to 98 % of a pull."""

RAISE_ENDS = (15.0, 10.0)
"""Cable lengths between which the hoist with friction goes [m]."""

RAISE_TIME = 12.0
"""Time for each way [s]."""

REST_TIME = 4.0
"""Time at rest before and after each [s]."""

DRUM = Drum(radius=0.25, width=0.8, rope_diameter=0.018, layers=4, inertia=60.0)
"""Drum of that hoist."""

LINE = 120.0
"""Rope on that drum with the hook at the pivot [m]."""


# --- frequencies ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frequencies:
    """Frequencies of small swings with some bodies on the rope.

    Attributes:
        bodies: Number of bodies.
        found: Frequencies of the crane [rad/s], those of the swing and vibrations along the jib.
        exact: Those of a heavy rope by Bessel functions, as many [rad/s].
    """

    bodies: int
    found: np.ndarray
    exact: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Relative errors of the frequencies."""
        return self.found / self.exact - 1.0


def heavy_crane(setup: Setup, bodies: int = USUAL_BODIES, **values: float) -> Crane:
    """Return the tower crane with a point load on a rope with mass, without damping."""
    rope = {"falls": FALLS, "rope_mass": ROPE_MASS, "rope_bodies": bodies}
    return setup.variant(**POINT, payload_mass=LOAD, **rope, **values)


def frequencies(setup: Setup) -> list[Frequencies]:
    """Return the frequencies with several numbers of bodies."""
    rows = []
    for bodies in BODIES:
        crane = heavy_crane(setup, bodies, hoist_init=LENGTH)
        radial = [crane.layout.index("phi")]
        # The bends of a body are two joints, the first of them along the jib as the radial swing.
        radial += rope_bends(crane)[::2]
        modes = min(MODES, bodies + 1)
        found = natural_frequencies(crane, crane.start.q, np.array(radial))[:modes]
        exact = theory.heavy_rope(LENGTH, FALLS * ROPE_MASS, LOAD, crane.gravity, modes)
        rows.append(Frequencies(bodies, found, exact))
    return rows


# --- pull -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pull:
    """What the hoist holds at a cable length.

    Attributes:
        length: Cable length [m].
        held: Force of the hoist [N].
        weight: Weight of the load and of the rope that hangs [N].
    """

    length: float
    held: float
    weight: float


def pulls(setup: Setup) -> list[Pull]:
    """Return what the hoist of a crane holds at several cable lengths.

    Its bodies have the mass of the rope at `LENGTH`: what the rope weighs more or less at another
    length acts on the hoist as well.
    """
    crane = heavy_crane(setup, hoist_init=LENGTH)
    hoist = crane.layout.drive("l")
    rows = []
    for length in LENGTHS:
        q = crane.hanging(crane.state(l=length).q)
        weight = (LOAD + FALLS * ROPE_MASS * length) * crane.gravity
        rows.append(Pull(length, -float(holding_effort(crane, q)[hoist]), weight))
    return rows


# --- a rope that is wound up ----------------------------------------------------------------------


@dataclass(frozen=True)
class SwingWhileHoisted:
    """A load that swings while it is hoisted.

    Attributes:
        name: Its name in tables.
        t: Time of each row [s].
        angles: Angle of the line from pivot to load at each row [rad].
        late: By how much the last zero of the angle is later than that on the running rope [s].
        expected: The same by the frequencies at each length, see `expected_delay` [s].
    """

    name: str
    t: np.ndarray
    angles: np.ndarray
    late: float
    expected: float

    @property
    def amplitude(self) -> float:
        """Largest angle after hoisting [rad]."""
        return float(np.abs(self.angles[self.t >= HOIST_TIME]).max())


def expected_delay(crane: Crane, reference: Spline, carried: float, until: float) -> float:
    """Return by how much a load swings later than on a running rope [s], where bodies with the mass
    of one cable length l₀ stand for the rope.

    With the mass μ of a metre of all falls, a rope has the share ε = μ l/M of the mass of its load,
    and makes the swing quicker by ε/12 to first order, since √((1 + ε/2)/(1 + ε/3)) is that of a
    rod. At the length l the bodies so make it too quick by the share μ (l₀ - l)/(12 M). The phase
    that is gained, the integral of this share times the frequency, over the frequency at the end is
    a time.

    Args:
        crane: The crane.
        reference: How it hoists.
        carried: Length whose mass the bodies have l₀ [m]; 0 for a rope without mass.
        until: Time at which the delay counts [s].
    """
    t = np.linspace(0.0, until, 1001)
    lengths = reference.at(t).position[:, crane.layout.drive("l")]
    frequencies = np.sqrt(crane.gravity / lengths)
    too_quick = FALLS * ROPE_MASS * (carried - lengths) / (12.0 * LOAD)
    return -float(np.trapezoid(too_quick * frequencies, t) / frequencies[-1])


@dataclass(frozen=True)
class HoistRuns:
    """Runs in which a swinging load is hoisted.

    Attributes:
        running_rope: The load on a running rope.
        cases: The load on bodies with the mass of the length in the middle, and with that of the
            length at the start, and on a rope without mass.
        crane: The crane of the first of them.
        run: Its run.
    """

    running_rope: SwingWhileHoisted
    cases: list[SwingWhileHoisted]
    crane: Crane
    run: Trajectory


def hoistings(setup: Setup) -> HoistRuns:
    """Hoist a swinging load: on bodies with the mass of the length in the middle and of that at the
    start, on a rope without mass, and on a running rope.
    """
    first, last = HOIST_ENDS
    middle = 0.5 * (first + last)
    cranes = [
        (f"bodies with the mass of {middle:g} m", middle),
        (f"bodies with the mass of {first:g} m", first),
        ("a rope without mass", 0.0),
    ]
    runs = []
    for name, carried in cranes:
        if carried:
            crane = heavy_crane(setup, hoist_init=first, rope_mass_length=carried)
        else:
            crane = setup.variant(**POINT, payload_mass=LOAD, hoist_init=first)
        runs.append((crane, _run_hoist(setup, crane, f"hoist a load: {name}")))

    crane, run = runs[0]
    reference = _hoist_reference(crane)
    hoist = crane.layout.drive("l")

    def cable(t: float) -> CableMotion:
        setpoint = reference.at(np.array([t]))
        return CableMotion(
            length=float(setpoint.position[0, hoist]),
            rate=float(setpoint.velocity[0, hoist]),
            acceleration=float(setpoint.acceleration[0, hoist]),
        )

    rope = RunningRope(FALLS * ROPE_MASS, LOAD)
    angles = rope.angles(cable, SMALL_SWING, run.t, crane.gravity)
    until = zero_crossings(run.t, angles)[-1]
    cases = []
    for (name, carried), (its_crane, its_run) in zip(cranes, runs, strict=True):
        swing = _angles(its_crane, its_run)
        late = float(zero_crossings(its_run.t, swing)[-1] - until)
        expected = expected_delay(crane, reference, carried, until)
        cases.append(SwingWhileHoisted(name, its_run.t, swing, late, expected))
    return HoistRuns(SwingWhileHoisted("running rope", run.t, angles, 0.0, 0.0), cases, crane, run)


def _hoist_reference(crane: Crane) -> Spline:
    """Return the reference that hoists a load from the start of a crane."""
    goal = crane.start.q[crane.layout.drives].copy()
    goal[crane.layout.drive("l")] = HOIST_ENDS[1]
    return spline(crane, crane.start, [goal], [HOIST_TIME])


def _run_hoist(setup: Setup, crane: Crane, label: str) -> Trajectory:
    """Return the run of a crane that hoists a load which swings."""
    reference = _hoist_reference(crane)
    return setup.simulate(
        crane,
        follow(crane, reference, setup.control_period),
        reference,
        start=crane.state(phi=SMALL_SWING),
        duration=HOIST_TIME + AFTERWARDS,
        label=label,
        drive="motion",
    )


def _angles(crane: Crane, run: Trajectory) -> np.ndarray:
    """Return the angle of the line from pivot to load in each row of a run [rad], positive as the
    radial swing is: towards +Y, since the jib points along -Y and the load lags inward.
    """
    paths = point_paths(crane, run.q)
    load = paths[:, 0]
    pivot = paths[:, 1]
    line = load - pivot
    return np.arctan2(line[:, 1], -line[:, 2])


# --- sheaves --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sheaves:
    """A load that is raised and lowered on a reeving whose sheaves rub.

    Attributes:
        run: The run.
        up: Force of the hoist while it raises the load steadily, as a share of the weight.
        down: The same while it lowers it.
        up_capstan: The same of hoisting by the capstan equation: n F/W with the pull F of the line
            and the weight W.
        down_capstan: The same of lowering.
        winch: Columns of the winch, see `cranedyn.lifts.judging.drum.Winch.columns`.
    """

    run: Trajectory
    up: float
    down: float
    up_capstan: float
    down_capstan: float
    winch: dict[str, np.ndarray]


def sheaves(setup: Setup) -> Sheaves:
    """Raise and lower a load on a reeving with friction."""
    reeving = Reeving.over_sheaves(FALLS, SHEAVE_FRICTION, drum_radius=DRUM.layer_radius(0))
    weight = LOAD * setup.gravity
    crane = setup.variant(
        **POINT, payload_mass=LOAD, falls=FALLS, friction_hoist=reeving.friction(weight)
    )
    start = crane.state(l=RAISE_ENDS[0])
    drives = start.q[crane.layout.drives]
    raised = drives.copy()
    raised[crane.layout.drive("l")] = RAISE_ENDS[1]
    reference = spline(
        crane, start, [raised, raised, drives], [RAISE_TIME, REST_TIME, RAISE_TIME], at=REST_TIME
    )
    run = setup.simulate(
        crane,
        follow(crane, reference, setup.control_period),
        reference,
        start=start,
        duration=3.0 * REST_TIME + 2.0 * RAISE_TIME,
        label="raise and lower",
        drive="motion",
    )
    # In the middle of each way the load does not accelerate.
    middle_up = int(np.searchsorted(run.t, REST_TIME + 0.5 * RAISE_TIME))
    middle_down = int(np.searchsorted(run.t, 2.0 * REST_TIME + 1.5 * RAISE_TIME))
    share = -run["F_l_N"] / weight
    winch = Winch(DRUM, reeving, LINE)
    ratio = theory.capstan(SHEAVE_FRICTION, np.pi)
    # In hoisting each fall pulls less than the one before it, W = F (1 + 1/r + 1/r² + ...) with
    # r = e^{μα}; in lowering each pulls more, W = F (1 + r + r² + ...). No sheave is between drum
    # and first fall.
    falls = np.arange(FALLS)
    return Sheaves(
        run=run,
        up=float(share[middle_up]),
        down=float(share[middle_down]),
        up_capstan=float(FALLS / (ratio**-falls).sum()),
        down_capstan=float(FALLS / (ratio**falls).sum()),
        winch=winch.columns(crane, run),
    )


# --- tables, claims and pictures ------------------------------------------------------------------


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Compare frequencies and pull, hoist a swinging load, and raise one over sheaves."""
    compared = frequencies(setup)
    held = pulls(setup)
    hoisted = hoistings(setup)
    rubbing = sheaves(setup)
    crane = heavy_crane(setup, hoist_init=LENGTH)
    return Outcome(
        tables=[
            _frequency_table(compared),
            _bodies_table(crane),
            _pull_table(held),
            _hoisting_table(hoisted),
            _winch_table(rubbing),
        ],
        claims=[
            _swing_claim(compared),
            _order_claim(compared),
            _pull_claim(held),
            *_hoisting_claims(hoisted),
            _sheave_claim(rubbing),
        ],
        parameters={"load_kg": LOAD, "falls": FALLS, "rope_kg_per_m": ROPE_MASS},
        trajectories={"hoisting": hoisted.run, "sheaves": rubbing.run},
        figures={"rope": _figure(compared, hoisted, rubbing)},
        recording=harness.side_by_side({"hoisting": (hoisted.crane, hoisted.run)}),
    )


def _row_of(compared: Sequence[Frequencies], bodies: int) -> Frequencies:
    """Return the frequencies with a number of bodies."""
    return next(row for row in compared if row.bodies == bodies)


def _swing_claim(compared: Sequence[Frequencies]) -> Claim:
    """Return the claim that the swing has the frequency of a heavy rope."""
    error = abs(float(_row_of(compared, USUAL_BODIES).errors[0]))
    return Claim(
        f"With {USUAL_BODIES} bodies the load swings with the frequency of a heavy rope by Bessel "
        f"functions, within 0.1 % ({100.0 * error:.3f} %).",
        error < 1e-3,
    )


def _order_claim(compared: Sequence[Frequencies]) -> Claim:
    """Return the claim that errors fall with the square of the number of bodies."""
    coarse = _row_of(compared, 4).errors
    fine = _row_of(compared, 8).errors
    ratios = coarse / fine
    return Claim(
        "With twice as many bodies the errors of the swing and of two vibrations are four times "
        f"smaller, within 5 % ({', '.join(f'{ratio:.2f}' for ratio in ratios)} times from 4 to 8).",
        bool((np.abs(ratios / 4.0 - 1.0) < 0.05).all()),
    )


def _pull_claim(held: Sequence[Pull]) -> Claim:
    """Return the claim that the hoist holds the weight at any length."""
    worst = max(abs(pull.held / pull.weight - 1.0) for pull in held)
    return Claim(
        "The hoist holds the weight of the load and of the rope that hangs, at every cable length, "
        f"within 1e-9 (worst {worst:.0e}).",
        worst < 1e-9,
    )


def _hoisting_claims(hoisted: HoistRuns) -> list[Claim]:
    """Return the claims that a load which is hoisted swings as on a running rope, but for what the
    constant mass of the bodies makes of its frequency.
    """
    worst = max(abs(case.late - case.expected) for case in hoisted.cases)
    amplitudes = [case.amplitude / hoisted.running_rope.amplitude - 1.0 for case in hoisted.cases]
    apart = max(np.abs(amplitudes).tolist())
    return [
        Claim(
            f"Hoisted from {HOIST_ENDS[0]:g} to {HOIST_ENDS[1]:g} m, loads swing earlier or later "
            "than on a running rope by what μ (l₀ - l)/(12 M) of the frequency gives, within "
            f"0.02 s, 0.3 % of a period ({worst:.3f} s).",
            worst < 0.02,
        ),
        Claim(
            "Their swing afterwards is as large as on the running rope, within 3 % "
            f"({100.0 * apart:.1f} %).",
            apart < 0.03,
        ),
    ]


def _sheave_claim(rubbing: Sheaves) -> Claim:
    """Return the claim that the hoist pulls as a rope over sheaves with friction has it, but for
    one friction that stands for those of hoisting and lowering.
    """
    half_difference = 0.5 * abs((rubbing.up_capstan - 1.0) - (1.0 - rubbing.down_capstan))
    worst = max(
        abs(rubbing.up - rubbing.up_capstan),
        abs(rubbing.down - rubbing.down_capstan),
    )
    return Claim(
        f"The hoist pulls {rubbing.up:.4f} of the weight in hoisting and {rubbing.down:.4f} in "
        f"lowering, where T₂ = T₁ e^(μα) gives {rubbing.up_capstan:.4f} and "
        f"{rubbing.down_capstan:.4f}: one friction, the mean of both, misses each by "
        f"{half_difference:.4f}, and the run by 1e-4 more at most ({worst:.4f}).",
        worst < half_difference + 1e-4,
    )


def _frequency_table(compared: Sequence[Frequencies]) -> ResultTable:
    def error(mode: int) -> Callable[[Frequencies], float | None]:
        # A rope with one body has a swing and one vibration.
        return lambda row: 100.0 * row.errors[mode] if mode < len(row.errors) else None

    return make_table(
        "Frequencies of a load on a heavy rope, beside Bessel functions",
        compared,
        ("bodies", "", lambda row: row.bodies),
        ("swing [rad/s]", ".6f", lambda row: row.found[0]),
        ("by Bessel", ".6f", lambda row: row.exact[0]),
        ("error [%]", ".4f", error(0)),
        ("of the first vibration [%]", ".2f", error(1)),
        ("of the second [%]", ".2f", error(2)),
    )


def _bodies_table(crane: Crane) -> ResultTable:
    usual = f"{FALLS} falls of {ROPE_MASS:g} kg/m, {LENGTH:g} m, {LOAD / 1e3:g} t"
    ropes = [
        (usual, LENGTH, FALLS * ROPE_MASS, LOAD),
        ("the same with an empty hook of 200 kg", LENGTH, FALLS * ROPE_MASS, 200.0),
        ("2 falls of 2.4 kg/m, 60 m, 2 t", 60.0, 4.8, 2000.0),
    ]
    rows = []
    for name, length, mass, load in ropes:
        counts = [
            bodies_for(error, length, mass, load, crane.gravity, mode)
            for error, mode in ((1e-2, 1), (1e-3, 1), (1e-4, 1), (5e-2, 2))
        ]
        rows.append((name, *counts))
    return make_table(
        "Bodies that a rope needs",
        rows,
        ("rope", "", lambda row: row[0]),
        ("swing to 1 %", "", lambda row: row[1]),
        ("to 0.1 %", "", lambda row: row[2]),
        ("to 0.01 %", "", lambda row: row[3]),
        ("vibration to 5 %", "", lambda row: row[4]),
    )


def _pull_table(held: Sequence[Pull]) -> ResultTable:
    return make_table(
        "What the hoist holds",
        held,
        ("cable [m]", "g", lambda pull: pull.length),
        ("held [N]", ".1f", lambda pull: pull.held),
        ("load and rope weigh [N]", ".1f", lambda pull: pull.weight),
    )


def _hoisting_table(hoisted: HoistRuns) -> ResultTable:
    return make_table(
        f"A load that swings while it is hoisted from {HOIST_ENDS[0]:g} to {HOIST_ENDS[1]:g} m",
        [hoisted.running_rope, *hoisted.cases],
        ("", "", lambda case: case.name),
        ("swing afterwards [mrad]", ".3f", lambda case: 1e3 * case.amplitude),
        ("late at the end [s]", ".3f", lambda case: case.late),
        ("by the frequencies [s]", ".3f", lambda case: case.expected),
    )


def _winch_table(rubbing: Sheaves) -> ResultTable:
    run = rubbing.run
    rows = {
        "at rest below": 0.5 * REST_TIME,
        "hoisting": REST_TIME + 0.5 * RAISE_TIME,
        "at rest above": 1.5 * REST_TIME + RAISE_TIME,
        "lowering": 2.0 * REST_TIME + 1.5 * RAISE_TIME,
    }
    places = [(name, int(np.searchsorted(run.t, t))) for name, t in rows.items()]
    winch = rubbing.winch
    return make_table(
        "The winch of a hoist over sheaves with friction",
        places,
        ("", "", lambda row: row[0]),
        ("line [N]", ".0f", lambda row: winch["line_N"][row[1]]),
        ("rope on the drum [m]", ".1f", lambda row: winch["wound_m"][row[1]]),
        ("layer at [m]", ".4f", lambda row: winch["layer_m"][row[1]]),
        ("drum [rad/s]", ".3f", lambda row: round(winch["drum_rad_s"][row[1]], 6) + 0.0),
        ("torque [N m]", ".0f", lambda row: winch["drum_Nm"][row[1]]),
    )


def _figure(compared: Sequence[Frequencies], hoisted: HoistRuns, rubbing: Sheaves) -> Figure:
    figure, (errors, angles, force) = panels(3, height=2.0, width=7.0)
    for mode, name in enumerate(("swing", "first vibration", "second vibration")):
        rows = [row for row in compared if mode < len(row.errors)]
        counts = [row.bodies for row in rows]
        errors.loglog(counts, [abs(row.errors[mode]) for row in rows], "o-", label=name)
    errors.set(xlabel="bodies on the rope", ylabel="error of a frequency")
    legend_above(errors, columns=3)
    drawn = [(hoisted.running_rope, "-"), (hoisted.cases[0], "--"), (hoisted.cases[2], ":")]
    for case, style in drawn:
        angles.plot(case.t, 1e3 * case.angles, style, label=case.name)
    angles.set(xlabel="time [s]", ylabel="angle [mrad]")
    legend_above(angles, columns=3)
    force.plot(rubbing.run.t, -rubbing.run["F_l_N"] / 1e3)
    force.set(xlabel="time [s]", ylabel="hoist [kN]")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("rope", __doc__)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
