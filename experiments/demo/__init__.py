"""The seven legs of the article's demonstration, until Ctrl-C, and the swing that is left in every
dwell.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cranedyn import theory
from cranedyn.analysis.swing import swing_amplitude
from cranedyn.checks import number
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import OutOfRange
from cranedyn.lifts.planning.itinerary import Stage, Timetable
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.references.limits import Limits
from experiments import harness
from experiments.demo.endless import Dwell, Dwells
from experiments.demo.live import PACES, LiveDemo, UncontrolledTour, pieces
from experiments.harness import Claim, Outcome, ResultTable, Setup
from experiments.scenarios.moves import DWELL, SETTLED_DISTANCE, TOUR_LIMITS, sampling_swing
from experiments.scenarios.tours import CONTROLS

MAX_ROWS = 70
"""Largest number of dwells in a table: those of ten cycles."""

MAX_SHARE = 0.25
"""Largest share of the uncontrolled swing that control may leave in a dwell."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run until the cycles are done or the user interrupts; both keep all that was recorded."""
    setup = replace(setup, reporter=harness.ProgressReporter(None))
    limits = _limits(options, setup)
    dwell_time = number("dwell", options.dwell, "s", "> 0")
    tour, controller = CONTROLS[options.control](setup, limits, dwell_time)
    until = _end(options, setup, tour)
    uncontrolled = None
    if options.control != "none":
        uncontrolled = UncontrolledTour(setup, limits, dwell_time, tour)
    demo = LiveDemo(options, setup, tour, uncontrolled)
    run = demo.run(pieces(setup, tour, controller, until))

    dwells = demo.dwells
    earlier_files = [file.name for file in demo.record.parts]
    parameters: dict[str, object] = {
        "rates": list(limits.rates),
        "accelerations": list(limits.accelerations),
        "dwell_s": options.dwell,
        "control": options.control,
    }
    if earlier_files:
        parameters["earlier_parts"] = earlier_files
    tables = [_table(dwells.rows, options.control, float(run.t[0]), earlier_files)]
    trajectories = {"demo": run}
    before = None if uncontrolled is None else uncontrolled.run(float(run.t[-1]))
    if uncontrolled is None:
        claims = _uncontrolled_claims(setup, tour, dwells)
        recorded = {"demo": (setup.crane, run)}
    else:
        claims = []
        recorded = {f"control {options.control}": (setup.crane, run)}
    if uncontrolled is not None and before is not None:
        tables.append(_table(uncontrolled.dwells.rows, "none"))
        trajectories["demo_before"] = before
        if not earlier_files:
            recorded["without control"] = (setup.crane, before)
        if options.control == "flat":
            claims = _flat_claims(setup, dwells)
        else:
            claims = _control_claims(dwells.rows, uncontrolled.dwells.rows, options.control)
    return Outcome(
        tables=tables,
        claims=claims,
        parameters=parameters,
        trajectories=trajectories,
        figures={"swing": _figure(tour, run)},
        recording=harness.side_by_side(recorded, apart=0.0),
    )


def _limits(options: argparse.Namespace, setup: Setup) -> Limits:
    """Return the limits of the drives, with the rates of the command line."""
    rates = (options.rate_slew, options.rate_x, options.rate_hoist)
    checked = setup.crane.layout.for_drives("rate limit", rates, "/s", "> 0")
    return Limits(checked.tolist(), TOUR_LIMITS.accelerations)


def _end(options: argparse.Namespace, setup: Setup, tour: Timetable) -> float:
    """Return the end of the run [s], infinite unless a number of cycles is given.

    Raises:
        OutOfRange: If the cycles last less than a control period.
    """
    if options.cycles is None:
        return math.inf
    end = number("cycles", options.cycles, "", "> 0") * tour.duration
    if end < setup.control_period:
        fewest_cycles = f"{setup.control_period / tour.duration:.3g} or more, one control period"
        raise OutOfRange("cycles", options.cycles, fewest_cycles)
    return end


def _table(
    rows: Sequence[Dwell],
    control: str,
    t_start: float = 0.0,
    earlier_files: Sequence[str] = (),
) -> ResultTable:
    """Return a row for each of the last dwells.

    Args:
        rows: The dwells.
        control: Name of the control.
        t_start: Time at which the run in memory begins [s].
        earlier_files: Names of the files that hold what was before.
    """
    columns = [
        ("leg", ""),
        ("arrives [s]", ".1f"),
        ("residual swing [mrad]", ".4g"),
        ("at the hook [mm]", ".4g"),
    ]
    strategy = "without swing control" if control == "none" else f"control {control}"
    note = "Amplitudes of radial and tangential swing together."
    if len(rows) > MAX_ROWS:
        note += f" The last {MAX_ROWS} of {len(rows)} dwells."
    if earlier_files:
        shown = list(earlier_files)
        if len(earlier_files) >= 3:
            shown = [earlier_files[0], "…", earlier_files[-1]]
        note += f" What happened before t = {t_start:.0f} s is in {', '.join(shown)}."
    title = f"Swing that is left in the dwells, {strategy}"
    return ResultTable(title, columns, rows[-MAX_ROWS:], note)


def _uncontrolled_claims(setup: Setup, tour: Timetable, dwells: Dwells) -> list[Claim]:
    """Return the claims that the load swings on, after the first leg as the closed form predicts.

    There are none before a dwell is over.
    """
    if not dwells.rows:
        return []
    swing = min(row.swing for row in dwells.rows)
    deviation = min(row.deviation for row in dwells.rows)
    first = dwells.first
    length = first["l_m"]
    angles = first.coordinates("phi", "theta")
    rates = first.rates("phi", "theta")
    amplitude = float(swing_amplitude(angles, rates, length, setup.gravity)[0])
    predicted = started_and_stopped(setup, tour.stages[0], float(length[0]))
    # The closed form does not know of a drive that reaches its limit.
    is_limited = bool((dwells.effort >= setup.crane.effort_limit).any())
    agrees = abs(amplitude - predicted.swing) < predicted.tolerance
    return [
        Claim(
            f"Without swing control the load keeps swinging in every dwell: {swing:.1f} mrad and "
            f"{deviation:.0f} mm at the hook at least, where "
            f"{1000 * SETTLED_DISTANCE:g} mm count as settled.",
            deviation > 1000.0 * SETTLED_DISTANCE,
        ),
        Claim(
            f"After the first leg it swings {1000 * amplitude:.1f} mrad; a trolley that starts and "
            "stops at once leaves "
            f"{1000 * predicted.swing:.1f} mrad by closed form, to which a finite swing adds or "
            f"takes {1000 * predicted.tolerance:.1f} mrad at most.",
            None if is_limited else agrees,
        ),
    ]


class PredictedSwing(NamedTuple):
    """A residual swing in closed form.

    Attributes:
        swing: The swing [rad].
        tolerance: How far a finite swing may change it [rad].
    """

    swing: float
    tolerance: float


def started_and_stopped(setup: Setup, stage: Stage, length: float) -> PredictedSwing:
    """Return the residual swing of a leg in which the trolley runs at a constant rate.

    A trolley that starts at once at the rate v leaves the load swinging by A = v/√(g l), and so
    does one that stops. After a time T both together leave 2 A |sin ωT/2|. The drive lags by
    k_d/k_p, which takes √(1 + (ω k_d/k_p)²) off a swing of the frequency ω, and gives way a little,
    which makes the period longer. A finite swing changes A² of the swing, and A²/16 of its phase.

    Args:
        setup: Crane and gravity.
        stage: The leg.
        length: Cable length [m].
    """
    crane = setup.crane
    gravity = setup.gravity
    duration = stage.arrival - stage.begin
    rate = abs(float((stage.target - stage.origin) @ crane.layout.along("x"))) / duration

    # A load with inertia swings as a point load on a longer cable.
    inertia = crane.payload_inertia[0, 0] + crane.dummy_inertia[0]
    reduced_length = length + inertia / (crane.payload_mass * length)
    k_p = STIFFNESS["trolley"]
    compliance = theory.pivot_compliance(reduced_length, gravity, crane.payload_mass, k_p)[0]
    period = float(theory.point_period(reduced_length, gravity)) * (1.0 + compliance)
    omega = 2.0 * math.pi / period
    lag = math.hypot(1.0, omega * DAMPING["trolley"] / k_p)
    amplitude = 2.0 * rate / math.sqrt(gravity * reduced_length) / lag
    phase = omega * duration
    return PredictedSwing(
        swing=amplitude * abs(math.sin(phase / 2.0)),
        tolerance=amplitude**3 * (1.0 + phase / 16.0),
    )


def _control_claims(
    controlled: Sequence[Dwell], uncontrolled: Sequence[Dwell], control: str
) -> list[Claim]:
    """Return the claim that control leaves a quarter of the swing, or less, in each dwell.

    There is none before a dwell of both is over.
    """
    # The tour without control may have ended before.
    pairs = list(zip(controlled, uncontrolled, strict=False))
    if not pairs:
        return []
    worst = max(dwell.swing / before.swing for dwell, before in pairs)
    claim = Claim(
        f"With {control} every dwell has at most a quarter of its swing without control (worst: "
        f"1/{1 / worst:.0f}).",
        worst < MAX_SHARE,
    )
    return [claim]


def _flat_claims(setup: Setup, dwells: Dwells) -> list[Claim]:
    """Return the claim that flat paths leave no more swing than the sampling of the efforts
    explains. There is none before a dwell is over.
    """
    if not dwells.rows:
        return []
    residual = max(row.swing for row in dwells.rows)
    peak = dwells.peak
    allowed = 1000.0 * sampling_swing(setup.gravity, dwells.shortest, setup.control_period, peak)
    claim = Claim(
        f"Flat paths leave a swing of at most {residual:.4f} mrad (allowed {allowed:.4f}: the "
        f"drives get a new effort every {1000 * setup.control_period:g} ms only, while the load "
        f"swings by up to {1000 * peak:.1f} mrad).",
        residual < allowed,
    )
    return [claim]


def _figure(tour: Timetable, run: Trajectory) -> Figure:
    """Draw drives and swing over time, with the dwells shaded."""
    figure, (drives, swing) = panels(2, height=2.4, sharex=True)
    drives.plot(run.t, run["x_m"], color=COLOURS["x"], label="x [m]")
    drives.plot(run.t, run["l_m"], color=COLOURS["l"], label="l [m]")
    drives.plot(run.t, np.degrees(run["gamma_rad"]), color=COLOURS["gamma"], label="γ [°]")
    swing.plot(run.t, np.degrees(run["phi_rad"]), color=COLOURS["phi"], label="φ radial")
    swing.plot(run.t, np.degrees(run["theta_rad"]), color=COLOURS["theta"], label="θ tangential")
    first = float(run.t[0])
    last = float(run.t[-1])
    cycles = np.arange(first // tour.duration, math.ceil(last / tour.duration))
    for cycle in tour.duration * cycles:
        for stage in tour.stages:
            start = max(cycle + stage.arrival, first)
            end = min(cycle + stage.end, last)
            if start < last and first < end:
                swing.axvspan(start, end, color=COLOURS["setpoint"], alpha=0.25, linewidth=0)
    swing.set(xlabel="time [s], dwells shaded", ylabel="swing [°]")
    legend_above(drives, columns=3)
    legend_above(swing, columns=2)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("demo", __doc__)
    harness.add_setup(parser)
    parser.set_defaults(live=True)
    parser.add_argument(
        "--control",
        choices=CONTROLS,
        default="none",
        help="none: PD without swing control; shaped: the same with shaped commands; paper, lqr: "
        "splines with the paper's control or the "
        "full-model LQR; flat: paths of the payload. All but none are recorded over the same tour "
        "without control",
    )
    slew, trolley, hoist = TOUR_LIMITS.rates
    pace = (
        f"times real time, {PACES}; 1 with --view or --serve if not given, else as fast as it goes"
    )
    for name, default, metavar, text in (
        ("--cycles", None, "N", "stop after so many cycles"),
        ("--rate-x", trolley, "V", "rate of the trolley [m/s]"),
        ("--rate-slew", slew, "W", "rate of the slew [rad/s]"),
        ("--rate-hoist", hoist, "V", "rate of the hoist [m/s]"),
        ("--dwell", DWELL, "T", "time at rest after each leg [s]"),
        ("--pace", None, "FACTOR", pace),
    ):
        parser.add_argument(name, type=float, default=default, metavar=metavar, help=text)
    return harness.run_experiment(parser, experiment, argv)
