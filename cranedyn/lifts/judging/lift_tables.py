"""Tables of a lift: each number with its clause or the command that makes it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cranedyn.lifts.judging import factors, wind_standards
from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.chart import CUT_OUT, WARNING
from cranedyn.lifts.judging.lift_checks import chart_share
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.loads import hanging_mass
from cranedyn.lifts.judging.numbered_positions import loads_at_rest
from cranedyn.lifts.judging.plan_checks import (
    KMH,
    governing_pressure,
    sling_force,
    wind_text,
)
from cranedyn.lifts.judging.plan_tables import (
    positions_table,
    sequence_table,
    wind_bounds_table,
)
from cranedyn.lifts.judging.table import Row, Table
from cranedyn.lifts.judging.wind_limit import (
    DIRECTIONS,
    FAILED_SHARE,
    GUST_FACTOR,
    LONGEST_GUST,
    SHORTEST_GUST,
    STEP,
    WindLimit,
)
from cranedyn.lifts.planning.ground_lift import stands_at
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.perturbed import CONFIDENCE, Perturbed
from cranedyn.lifts.planning.plan_assumptions import in_words, winch_of

CREEP_SHARE = 0.1
"""Creep speed of a hoist over its largest speed. No standard names it; this is an assumption."""

_SECOND_HAND = "second hand"
"""Source of what a standard demands: other texts that quote it, not the standard itself."""

_SHOWN_SPEEDS = 4.0
"""Speeds of which the table of winds shows every multiple [m/s]."""

_NOT_JUDGED = "not judged"
"""What stands in place of a number that was not computed."""

_LOADS_TITLE = "Loads of the run"
"""Title of the table of the largest loads."""

_CLEARANCES_TITLE = "Clearances"
"""Title of the table of the least distances."""

_GUSTS_TITLE = "Wind"
"""Title of the table of the worst of all lifts at each speed of a gust."""

_PERTURBED_TITLE = "Perturbed lifts"
"""Title of the table of the lifts that differ from the plan."""

_OF_COMMAND = (_LOADS_TITLE, _CLEARANCES_TITLE, _GUSTS_TITLE, _PERTURBED_TITLE)
"""Titles of the tables of simulated numbers, whose notes name the command that makes them again."""

_WITH_TAIL = ("jib", "upper")
"""Parts of the cranes of this project that carry a counter-jib or a counterweight behind them."""

SUMMARY_TITLE = "In numbers"
"""Title of the table of the numbers that decide."""

_LOADS_PAGE = "docs/concepts/lifting.md"
"""Page that derives the formulas of the loads."""


def with_command(made: Sequence[Table], command: str) -> list[Table]:
    """Return tables of a lift whose notes name the command that makes their numbers again, where
    there is one.
    """
    if not command:
        return [*made]
    named = []
    for table in made:
        again = f" Again: {command}." if table.title in _OF_COMMAND else ""
        named.append(table._replace(note=f"{table.note}{again}"))
    return named


def tables(analysis: LiftAnalysis) -> list[Table]:
    """Return all tables of a lift."""
    result = [_summary(analysis), _lift(analysis)]
    result += [positions_table(analysis), wind_bounds_table(analysis), sequence_table(analysis)]
    result += [_loads(analysis), _clearances(analysis)]
    result += [_assumptions(analysis), _factors(analysis)]
    if analysis.wind is not None:
        slews = "radius_m" in analysis.loads.values
        result.append(_wind(analysis, analysis.wind))
        # Limits of other makers beside that of this crane's invite to take the wrong one.
        in_use = slews and analysis.site.details.crane.wind_limit is None
        result.append(_limits_in_use(analysis.wind, in_use=in_use))
    if analysis.perturbed is not None:
        result.append(_robustness(analysis, analysis.perturbed))
    return result


def _summary(analysis: LiftAnalysis) -> Table:
    """Return the numbers that decide about the lift, each beside its limit."""
    required = analysis.requirements
    nearest = analysis.certificate.nearest
    utilisation = _NOT_JUDGED
    if analysis.utilisation is not None:
        utilisation = f"{100.0 * float(analysis.utilisation.max()):.1f} %"
    gust = _NOT_JUDGED
    if analysis.wind is not None:
        gust = wind_text(analysis.wind.limit())
    probability = _NOT_JUDGED
    if analysis.perturbed is not None:
        probability = f"at most {100.0 * analysis.perturbed.interval()[1]:.2f} %"
    rows: list[Row] = [
        *_radius_rows(analysis),
        ["utilisation of the chart", utilisation, f"{100.0 * chart_share(analysis):g} %"],
        [
            "gust that the lift bears",
            gust,
            "-" if required.wind is None else f"{wind_text(required.wind)} needed",
        ],
        *_gust_rows(analysis),
        ["least distance", f"{nearest.distance:.2f} m", f"{analysis.site.distance:g} m needed"],
        ["there are nearest", f"{nearest.body} and {nearest.obstacle}", "-"],
        ["perturbed lifts too near", probability, _or_dash(required.risk, 100.0, "%")],
        [
            "their least distance",
            perturbed_distance(analysis),
            f"{analysis.site.distance:g} m needed",
        ],
        *_details_rows(analysis),
        [_duration_name(analysis), f"{analysis.duration:.0f} s", "-"],
    ]
    note = "Each is from a table below."
    return Table(SUMMARY_TITLE, [("", ""), ("this lift", ""), ("limit", "")], rows, note)


def _gust_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return the row of what is used of the chart in the gust that the lift must bear, where a load
    that is blown outward may use more than in calm air; none where no gusts were simulated, or not
    as strong ones.
    """
    wind = analysis.wind
    required = analysis.requirements.wind
    if wind is None or required is None or required > wind.speeds[-1]:
        return []
    used = float(wind.worst["utilisation"][np.searchsorted(wind.speeds, required)])
    shown = "beyond the chart" if used > FAILED_SHARE else f"{100.0 * used:.1f} %"
    limit = f"{100.0 * wind.allowed['utilisation']:g} %"
    return [["utilisation in the gust needed", shown, limit]]


def _duration_name(analysis: LiftAnalysis) -> str:
    """Return of what the duration in the summary is: of the lift, or without the ends that are not
    simulated.
    """
    stands = stands_at(analysis.site.start) or stands_at(analysis.site.goal)
    if stands and analysis.grounded is None:
        return "time, without lift-off and set-down"
    return "time of the lift"


def _details_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return how much is used of a leg of the slings and of the ground, where that is entered."""
    rows: list[Row] = []
    leg = sling_force(analysis)
    if leg is not None:
        used = f"{100.0 * leg.utilisation:.0f} %"
        rows.append(["used of a sling's working load", used, "100 %"])
    largest = governing_pressure(analysis)
    permitted = analysis.site.details.ground.permitted_pressure
    if largest is not None and permitted is not None:
        shown = f"{permitted / 1e3:g} kPa"
        name = f"pressure on the ground, {largest.case}"
        rows.append([name, f"{largest.pressure / 1e3:.0f} kPa", shown])
    return rows


def perturbed_distance(analysis: LiftAnalysis) -> str:
    """Return the least distance of the perturbed lifts to read, of those that did not break off.

    Where it is no less than required it is a lower bound: a distance that suffices is not measured
    further.
    """
    perturbed = analysis.perturbed
    if perturbed is None:
        return _NOT_JUDGED
    distances = perturbed.least[np.isfinite(perturbed.least)]
    if not len(distances):
        return "-"
    least = float(distances.min())
    return f"{at_least(least, perturbed.required)} m"


def at_least(distance: float, required: float) -> str:
    """Return a distance of a simulated lift to read [m]. One that suffices is not measured further,
    and is a lower bound.
    """
    return f"{'at least ' if distance >= required else ''}{distance:.2f}"


def _radius_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return the row of the largest radius; none for a crane that does not slew."""
    radius = analysis.loads.values.get("radius_m")
    return (
        []
        if radius is None
        else [["largest radius, as it swings", f"{float(radius.max()):.1f} m", "-"]]
    )


def _or_dash(value: float | None, scale: float, unit: str) -> str:
    """Return a number in a unit, and a dash where nobody entered it."""
    return "-" if value is None else f"{scale * value:g} {unit}"


def _lift(analysis: LiftAnalysis) -> Table:
    """Return what is lifted, by which crane, from where to where and how fast."""
    lift = analysis.certificate.lift
    site = analysis.site
    size = np.ptp(lift.clearance.bodies.load, axis=0)
    ends = [*site.to_site(lift.clearance.point(lift.ends))]
    for i, at_rest in enumerate(loads_at_rest(analysis)):
        if at_rest is not None:
            ends[i] = at_rest.centre
    radius = analysis.loads.values.get("radius_m")
    radius_rows: list[Row] = []
    if radius is not None:
        radius_rows.append(["radius [m]", f"{radius.min():.1f} to {radius.max():.1f}", "the plan"])
    length = analysis.run.q[:, LoadJoints.of(analysis.run_crane).hoist]
    rows: list[Row] = [
        ["site", site.name, "the site's file"],
        ["from, to [m]", " to ".join(_point(end) for end in ends), "the site's file"],
        ["begins and ends", _begins_and_ends(analysis), "the site's file"],
        ["gross load", _gross(analysis), "the site's file"],
        ["its size [m]", " x ".join(f"{side:.1f}" for side in size), "the site's file"],
        ["crane", analysis.crane.model.name, "its URDF"],
        *_chart_rows(analysis),
        *radius_rows,
        ["cable [m]", f"{length.min():.1f} to {length.max():.1f}", "the plan"],
        *_rate_rows(lift),
        ["required distance", f"{site.distance:g} m", "the site's file"],
    ]
    return Table("The lift", [("", ""), ("value", ""), ("from", "")], rows)


def _rate_rows(lift: Lift) -> list[Row]:
    """Return the largest rates of the drives, of those that turn in rpm."""
    rows: list[Row] = []
    for joint, rate in zip(lift.crane.layout.driven, lift.limits.rates, strict=True):
        turns = joint.kind == "revolute"
        value = f"{rate * 30.0 / math.pi:.2f} rpm" if turns else f"{rate:.2f} m/s"
        rows.append([f"{joint.role or joint.symbol}, at most", value, "the drives"])
    return rows


def _begins_and_ends(analysis: LiftAnalysis) -> str:
    """Return whether the load stands or hangs at the start and at the end."""
    site = analysis.site
    # Only tower cranes, and plans whose certificate holds, are simulated from the ground or to it.
    is_simulated = analysis.grounded is not None
    start = "hanging"
    if stands_at(site.start):
        start = "lifted off" if is_simulated else "standing (lift-off not simulated)"
    end = "hanging"
    if stands_at(site.goal):
        end = "set down" if is_simulated else "standing (set-down not simulated)"
    return f"{start}, {end}"


def _chart_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return the rows about the chart."""
    chart = analysis.chart
    if chart is None:
        return [["chart", "none of this crane was entered", None]]
    return [
        ["chart", chart.name, "the chart's file"],
        ["its source", chart.source, "the chart's file"],
        ["falls", f"{analysis.inputs.falls}", "the table below"],
        *_boom_rows(analysis),
    ]


def _boom_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return the rows about a boom that telescopes: its length, and by which lengths of the chart
    its loads are; none for another crane.
    """
    boom = analysis.site.boom
    chart = analysis.chart
    if boom is None or chart is None:
        return []
    rows: list[Row] = [["length of the boom [m]", f"{boom:.4g}, held", "the site's file"]]
    lengths = chart.booms(analysis.inputs.falls)
    listed = ", ".join(f"{length:.4g}" for length in lengths) or "none"
    rows.append(["lengths of the chart [m]", listed, "the chart's file"])
    if lengths and analysis.utilisation is not None:
        is_one = chart.about_boom(analysis.inputs.falls, boom).same is not None
        rule = {"smaller": "the smaller load of both", "linear": "a straight line between both"}
        counts = "that of the chart" if is_one else rule[chart.between_booms]
        rows.append(["load between two lengths", counts, "the chart's file"])
    return rows


def _assumptions(analysis: LiftAnalysis) -> Table:
    """Return what the judgement rests on, with where each value is from."""
    rows: list[Row] = []
    for assumption in analysis.inputs.assumptions:
        field = assumption.field or None
        rows.append([assumption.name, assumption.value, assumption.origin.value, field])
    columns = [("", ""), ("value", ""), ("from", ""), ("field or option", "")]
    note = "The result holds as long as these do. A default is a value that nobody entered."
    return Table("What the result rests on", columns, rows, note)


def _gross(analysis: LiftAnalysis) -> str:
    """Return the mass that hangs as the sum that it is. A site enters masses of the rigging as 0
    where that of the load contains them.
    """
    gross = hanging_mass(analysis.crane) / 1e3
    rigging = analysis.site.rigging
    if not rigging:
        return f"{gross:.2f} t; no hook block and no slings were entered"
    if not any(rigging.values()):
        return f"{gross:.2f} t with hook block and slings"
    terms = {"load": gross - sum(rigging.values()) / 1e3}
    terms |= {name: mass / 1e3 for name, mass in rigging.items()}
    weighed = " + ".join(f"{name} {mass:.2f} t" for name, mass in terms.items())
    return f"{gross:.2f} t = {weighed}"


def _point(point: np.ndarray) -> str:
    return f"({', '.join(f'{coordinate:.1f}' for coordinate in point)})"


def _loads(analysis: LiftAnalysis) -> Table:
    """Return the extremes of the loads and their times."""
    carried = analysis.loads
    t = carried.t
    rows: list[Row] = []

    def add(name: str, values: np.ndarray, scale: float, unit: str, limit: str = "-") -> None:
        k = int(np.abs(values).argmax())
        rows.append([f"{name} [{unit}]", scale * float(values[k]), float(t[k]), limit])

    if analysis.utilisation is not None:
        thresholds = f"{100.0 * WARNING:g}, {100.0 * CUT_OUT:g}"
        add("utilisation", analysis.utilisation, 100.0, "%", thresholds)
    of_chart = "-" if analysis.chart is None else "the chart"
    slews = "load_moment_Nm" in carried.values
    if slews:
        add("load moment", carried["load_moment_Nm"], 1e-3, "kN m", of_chart)
    add("rope", carried["rope_N"], 1e-3, "kN")
    assert analysis.requirements.swing is not None  # see `cranedyn.lifts.judging.judged_inputs`
    allowed = f"{math.degrees(analysis.requirements.swing):g}"
    add("off-lead", np.degrees(carried["off_lead_rad"]), 1.0, "°", allowed)
    add("side-lead", np.degrees(carried["side_lead_rad"]), 1.0, "°", allowed)
    add("side force", carried["side_force_percent"], 1.0, "% of the weight")
    if slews:
        add("slewing ring, tilting", carried["ring_tilting_Nm"], 1e-3, "kN m")
        add("slewing ring, torsion", carried["ring_torsion_Nm"], 1e-3, "kN m")
    if analysis.site.runway is None:
        add("foot, overturning", carried["overturning_Nm"], 1e-3, "kN m")
        add("foot, torsion", carried["torsion_Nm"], 1e-3, "kN m")
    base = analysis.site.base
    note = f"Formulas: {_LOADS_PAGE}."
    if base is not None:
        corners = np.stack([carried[f"corner_{i}_N"] for i in range(1, 5)], axis=1)
        permitted = "-" if base.permitted is None else f"{base.permitted / 1e3:g}"
        add("corner, most", corners.max(axis=1), 1e-3, "kN", permitted)
        k = int(corners.min(axis=1).argmin())
        rows.append(["corner, least [kN]", 1e-3 * float(corners.min()), float(t[k]), "> 0"])
        note = (
            f"Formulas: {_LOADS_PAGE}. Corners: base {base.spacing:g} m wide, "
            f"{base.mass / 1e3:g} t with mast and ballast, as entered."
        )
    runway = analysis.site.runway
    if runway is not None:
        wheels = np.stack([carried[f"wheel_{i}_N"] for i in range(1, 5)], axis=1)
        permitted = "-" if runway.permitted is None else f"{runway.permitted / 1e3:g}"
        add("wheel, most", wheels.max(axis=1), 1e-3, "kN", permitted)
        k = int(wheels.min(axis=1).argmin())
        rows.append(["wheel, least [kN]", 1e-3 * float(wheels.min()), float(t[k]), "> 0"])
    columns = [("largest", ""), ("value", ".2f"), ("at [s]", ".1f"), ("limit", "")]
    return Table(_LOADS_TITLE, columns, rows, note)


def _clearances(analysis: LiftAnalysis) -> Table:
    """Tabulate the least distance of all that hangs from each obstacle, the nearest first, and then
    that of each part of the crane above the rope.
    """
    certificate = analysis.certificate
    zones = {solid.name for solid in analysis.site.solids if solid.zone}
    rows: list[Row] = []
    for name, distance in sorted(certificate.distances.items(), key=lambda item: item[1].min()):
        k = int(distance.argmin())
        required = "kept out of" if name in zones else f"{analysis.site.distance:g}"
        rows.append([name, float(distance[k]), float(certificate.t[k]), required])
    rows += _structure_rows(analysis)
    columns = [("obstacle", ""), ("least [m]", ".2f"), ("at [s]", ".1f"), ("required [m]", "")]
    clearance = certificate.lift.clearance
    envelope = clearance.envelope(float(np.max(clearance.cable(certificate.run.q))))
    swing = math.degrees(analysis.site.swing)
    note = (
        "Of all that hangs, and of each part of the crane that moves above the rope where it is "
        "named; proven between the instants (docs/concepts/planning.md), for this motion of the "
        f"drives alone. The plan keeps an envelope of {envelope:.2f} m about what hangs clear "
        f"besides, for a swing of {swing:.3g}°. Rope, hook block and load are what hangs: slings, "
        "spreader and tag lines are neither in this proof nor in the drawings of the motion."
    )
    if analysis.grounded is not None:
        begins = analysis.grounded.lift.phases["motion"]
        note += f" Times are from the begin of the motion, {begins:.0f} s into the sequence."
    return Table(_CLEARANCES_TITLE, columns, rows, note)


def _structure_rows(analysis: LiftAnalysis) -> list[Row]:
    """Return the least distance of each part of the crane that moves above the rope from what
    stands, the nearest first.
    """
    certificate = analysis.certificate
    clearance = certificate.lift.clearance
    q = certificate.run.q
    rows: list[Row] = []
    for part, (k, nearest) in clearance.nearest_of_structure(q).items():
        named = f"{part}, with its tail" if part in _WITH_TAIL else part
        name = f"{named}: from {nearest.obstacle}"
        required = f"{analysis.site.distance:g}"
        rows.append([name, nearest.distance, float(certificate.run.t[k]), required])
    return sorted(rows, key=lambda row: float(row[1] or 0.0))


def _factors(analysis: LiftAnalysis) -> Table:
    """Tabulate the dynamic factors that standards allow for, beside what this lift needs."""
    crane = analysis.crane
    loads = analysis.loads
    drive = analysis.drive
    limits = analysis.certificate.lift.limits
    mass = hanging_mass(crane)

    hoist_rate = limits.rates[winch_of(crane)]
    speed = factors.pick_up_speed(drive, hoist_rate, CREEP_SHARE * hoist_rate)
    phi_2 = factors.phi_2(analysis.hoisting, speed, drive)
    pull = float(loads["rope_N"].max()) / (mass * crane.gravity)
    phi_low, phi_high = factors.phi_1()

    # The rope leads off plumb, and pulls the trolley along the jib and the jib about the mast.
    outward = float(np.abs(loads["pull_N"] * np.tan(loads["off_lead_rad"])).max())
    sideways = float(np.abs(loads["pull_N"] * np.tan(loads["side_lead_rad"])).max())
    # How long a drive accelerates differs from lift to lift. From half a period of the pendulum on
    # the factor is 2, its largest.
    psi = f"{factors.psi_h_regulated(0.5):.2f}"
    rows: list[Row] = [
        ["φ1, own weight at lift-off", f"{phi_low:g} to {phi_high:g}", None, "EN 1991-3, T 2.4"],
        [f"v_h of {drive} [m/s]", f"{speed:.2f}", None, "AS 5221.1:2021"],
        [f"φ2 of {analysis.hoisting}, {drive}", f"{phi_2:.3f}", pull, "EN 1991-3, T 2.4, 2.5"],
        ["φ6, dynamic test load", f"{factors.phi_6(phi_2):.3f}", None, "EN 1991-3, 2.10"],
    ]
    drives = crane.layout.drives.tolist()
    joints = LoadJoints.of(crane)
    named = []
    if joints.trolley in drives:
        named.append("trolley")
        acceleration = limits.accelerations[drives.index(joints.trolley)]
        needed = outward / (mass * acceleration)
        rows.append(["ψ_h of the trolley", psi, needed, "FEM 1.001, A.2.2.3"])
    if joints.slew in drives:
        named.append("slew")
        radius = float(loads["radius_m"].max())
        acceleration = limits.accelerations[drives.index(joints.slew)]
        needed = sideways / (mass * acceleration * radius)
        rows.append(["ψ_h of the slew", psi, needed, "FEM 1.001, A.2.2.3"])
    columns = [("factor", ""), ("allowed", ""), ("needed here", ".3f"), ("clause", "")]
    if not stands_at(analysis.site.start):
        picked_up = "Picking up is not in it: the load hangs at the start."
    elif analysis.grounded is None:
        picked_up = "Picking up is not in it: lift-off was not simulated."
    else:
        picked_up = "Picking up is in it."
    sideways_note = ""
    if named:
        sideways_note = (
            "; its horizontal pull over mass times the limit of acceleration of the "
            f"{in_words(named)}"
        )
    note = (
        f"Clauses were read {_SECOND_HAND}. Needed: largest pull of the rope over the weight"
        f"{sideways_note}. {picked_up} Again: cranedyn run factors."
    )
    return Table("Dynamic factors", columns, rows, note)


def _wind(analysis: LiftAnalysis, limit: WindLimit) -> Table:
    """Tabulate the worst of all lifts in gusts up to each speed."""
    worst = limit.worst
    rows: list[Row] = []
    for i, speed in enumerate(limit.speeds.tolist()):
        if not _is_shown(speed, limit):
            continue
        failed = worst["utilisation"][i] > FAILED_SHARE
        values: Row = [
            100.0 * float(worst["utilisation"][i]),
            math.degrees(worst["swing"][i]),
            at_least(float(worst["clearance"][i]), limit.allowed["clearance"]),
        ]
        broken = [name for name in limit.allowed if not limit.kept(name)[i]]
        beyond = "fails" if failed else ", ".join(broken) or "none"
        numbers: Row = [None, None, None] if failed else values
        pressure = wind_standards.wind_pressure(speed)
        rows.append([speed, KMH * speed, pressure, *numbers, beyond])
    columns = [
        ("gusts up to [m/s]", ".1f"),
        ("[km/h]", ".0f"),
        ("pressure [Pa]", ".0f"),
        ("utilisation %", ".1f"),
        ("rope from plumb [°]", ".1f"),
        ("clearance [m]", ""),
        ("beyond its limit", ""),
    ]
    note = (
        f"{limit_text(limit)} The worst of {limit.lifts} lifts in all, wind on the load alone. "
        "A gust rises from a mean wind of "
        f"{1.0 / GUST_FACTOR:.2g} of its speed. Pressure: 0.625 v², AS 5222:2021, {_SECOND_HAND}. "
        'A distance that suffices is not measured further: "at least" says that more may be left.'
    )
    note += _lift_off_note(analysis, limit)
    return Table(_GUSTS_TITLE, columns, rows, note)


def _lift_off_note(analysis: LiftAnalysis, limit: WindLimit) -> str:
    """Return where the utilisation of the first page is from, in a sentence with a space before it;
    empty where it is no more than that in the weakest gust. Lift-off pulls more than the weight, in
    calm air, so that its utilisation is not among those of gusts.
    """
    if analysis.utilisation is None or analysis.grounded is None:
        return ""
    highest = float(analysis.utilisation.max())
    least_gust = float(limit.worst["utilisation"][0])
    if highest <= least_gust:
        return ""
    t = float(analysis.loads.t[analysis.utilisation.argmax()])
    return (
        f" The utilisation of {100.0 * highest:.1f} % on the first page is at t = {t:.1f} s of the "
        "lift with lift-off and set-down, which is in calm air and not in this table."
    )


def _is_shown(speed: float, limit: WindLimit) -> bool:
    """Return whether the table of winds has a row for a speed [m/s]: multiples of `_SHOWN_SPEEDS`,
    to keep it short, and those about the limit, where it decides.
    """
    return speed % _SHOWN_SPEEDS == 0.0 or abs(speed - limit.limit()) <= 2.0


def limit_text(limit: WindLimit) -> str:
    """Return what the limit of a load in wind rests on, in sentences."""
    if limit.limit() == 0.0:
        return f"The weakest gust that is tried, {STEP:g} m/s, breaks a limit."
    return (
        f"At {limit.limit():g} m/s none of {limit.at_limit} gusts breaks a limit: a grid from "
        f"{DIRECTIONS} sides, {SHORTEST_GUST:g} to {LONGEST_GUST:g} s long, beginning at any time "
        "of the lift, others about the worst of the grid, which do not depend on chance, and "
        f"{limit.drawn} drawn at random, by which, with {100.0 * CONFIDENCE:g} % confidence, at "
        f"most {100.0 * limit.largest_share:.2g} % of such gusts do."
    )


def _limits_in_use(limit: WindLimit, *, in_use: bool) -> Table:
    """Tabulate the gust of each limit of this lift beside those that standards have in general.

    Args:
        limit: The limits of this lift.
        in_use: Whether to name limits that are in use for other cranes.
    """
    named: list[tuple[str, float, str]] = []
    for name in limit.allowed:
        named.append((f"{name} of this lift", limit.limit(name), "this page"))
    # These are in use for tower and mobile cranes; a bridge may be in a hall.
    operating = wind_standards.OPERATING if in_use else {}
    for name, speed in operating.items():
        named.append((f"in use for other cranes: {name}", speed, _SECOND_HAND))
    for name, speed in wind_standards.IN_SERVICE.items():
        named.append((f"in service, {name} winds", speed, f"AS 5222:2021, {_SECOND_HAND}"))
    rows: list[Row] = [[name, speed, KMH * speed, source] for name, speed, source in named]
    columns = [("limit", ""), ("gust up to [m/s]", ".1f"), ("[km/h]", ".0f"), ("from", "")]
    note = "For comparison: what counts for this lift is the table of its wind limits."
    return Table("Wind limits in comparison", columns, rows, note)


def _robustness(analysis: LiftAnalysis, perturbed: Perturbed) -> Table:
    """Tabulate how many perturbed lifts failed, and the least distance and largest swing of those
    that did not break off.
    """
    low, high = perturbed.interval()
    confidence = f"{100.0 * CONFIDENCE:g} %"
    spread = analysis.inputs.spread
    # A lift that broke off has no distance, and may have no swing either.
    distances = perturbed.least[np.isfinite(perturbed.least)]
    swings = perturbed.swing[np.isfinite(perturbed.swing)]
    rows: list[Row] = [
        ["lifts", f"{len(perturbed.least)}"],
        ["below required clearance", f"{perturbed.failures - perturbed.broken_off}"],
        ["out of a drive's range, or rope slack", f"{perturbed.broken_off}"],
        [
            f"probability of either, {confidence} [%]",
            f"{100.0 * low:.3f} to {100.0 * high:.3f}",
        ],
        [
            "least distance [m]",
            at_least(float(distances.min()), perturbed.required) if len(distances) else "-",
        ],
        ["swing after, at most [mrad]", f"{1e3 * swings.max():.1f}" if len(swings) else "-"],
    ]
    note = (
        f"Load ±{100.0 * spread.load:.3g} %, cable ±{spread.cable:g} m, mean wind to "
        f"{spread.wind:g} m/s with gusts of {spread.gust:g} m/s more, sensors to "
        f"{1e3 * max(spread.late):g} ms late, the load hanging at both ends; "
        f"interval by Clopper and Pearson (docs/concepts/planning.md)."
    )
    return Table(_PERTURBED_TITLE, [("", ""), ("value", "")], rows, note)
