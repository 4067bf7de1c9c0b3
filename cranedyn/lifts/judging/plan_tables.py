"""Tables of the first page of a lift plan and of its sequence."""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.lift_positions import LiftPosition, interpolation, lift_positions
from cranedyn.lifts.judging.plan_checks import KMH, LOAD, MAKER, SITE, wind_bounds
from cranedyn.lifts.judging.sequence import StepByHand, all_steps
from cranedyn.lifts.judging.table import BLANK, Row, Table, place_text
from cranedyn.lifts.judging.wind_limit import STRONGEST

POSITIONS_TITLE = "Pick-up, largest radius, set-down"
"""Title of the table of a crane that slews."""

PLACES_TITLE = "Pick-up and set-down"
"""Title of the same table of a crane that does not slew."""

WIND_TITLE = "Wind limits"
"""Title of the table of the winds in which the lift stops."""

SEQUENCE_TITLE = "Sequence"
"""Title of the table of the steps of a lift."""


def positions_table(analysis: LiftAnalysis) -> Table:
    """Return rated capacity, gross load and share where the load is picked up, farthest out and set
    down; for a crane that does not slew, at the places that take their place.
    """
    positions = lift_positions(analysis)
    slews = positions[0].radius is not None
    has_wheels = positions[0].wheel is not None
    columns = [("", ""), ("load at (x, y, z) [m]", "")]
    if slews:
        columns.append(("radius [m]", ".2f"))
    columns += [("rated capacity [t]", ".2f"), ("gross load [t]", ".2f"), ("share [%]", ".1f")]
    if has_wheels:
        columns.append(("wheel, most [kN]", ".0f"))
    rows = []
    for position in positions:
        row: Row = [position.name, place_text(position.place)]
        if slews:
            row.append(position.radius)
        row += _capacity(position)
        if has_wheels:
            assert position.wheel is not None  # all positions have one, or none
            row.append(position.wheel / 1e3)
        rows.append(row)
    falls = "" if analysis.inputs.falls is None else f" on {analysis.inputs.falls} falls"
    chart = "no chart was entered" if analysis.chart is None else f"{analysis.chart.name}{falls}"
    note = (
        f"Places: in plan the centre of gravity, which hangs below the hook; in height the middle "
        f"of the load. Rated capacity from: {chart}. The share is that of the load at rest; with "
        "the dynamics of the lift it is the utilisation of the chart."
    )
    if slews:
        note += " The largest radius is that of the load as it swings."
    note += _interpolation_note(analysis, positions)
    return Table(POSITIONS_TITLE if slews else PLACES_TITLE, columns, rows, note)


def _interpolation_note(analysis: LiftAnalysis, positions: Sequence[LiftPosition]) -> str:
    """Return how the rated loads of positions follow from points of the chart, in sentences."""
    note = ""
    interpolated: dict[str, list[str]] = {}
    for position in positions:
        between = "" if position.radius is None else interpolation(analysis, position.radius)
        if between:
            interpolated.setdefault(between, []).append(position.name)
    for between, names in interpolated.items():
        note += f" Interpolated {between}: {', '.join(names)}."
    if interpolated:
        note += " Many makers do not allow interpolation: interpolation = false in the chart."
    if analysis.chart is not None and not analysis.chart.interpolation:
        note += (
            " The maker does not allow interpolation: at each place the load of the next larger "
            "radius of the chart counts."
        )
    return note


def _capacity(position: LiftPosition) -> Row:
    """Return rated capacity [t], gross load [t] and share [%] at a place, as a part of a row."""
    rated = None if position.rated is None else position.rated / 1e3
    share = None if position.share is None else 100.0 * position.share
    return [rated, position.gross / 1e3, share]


def wind_bounds_table(analysis: LiftAnalysis) -> Table:
    """Return the winds in which the lift stops, first the least in a row of its own, and how the
    wind is measured. A limit that is not known is an empty line, to be filled in by hand, or not
    judged.
    """
    bounds = wind_bounds(analysis)
    rows: list[Row] = []
    if bounds:
        least = bounds[0].gust
        rows.append(["the least that is known: stop here", least, KMH * least])
    for bound in bounds:
        rows.append([_whose(analysis, bound.source), bound.gust, KMH * bound.gust])
    known = [bound.source for bound in bounds]
    for source in (MAKER, SITE):
        if source not in known:
            rows.append([f"{source} {BLANK}", None, None])
    if LOAD not in known:
        rows.append([f"{LOAD}: not judged", None, None])
    columns = [("limit of", ""), ("gust [m/s]", ".1f"), ("[km/h]", ".0f")]
    measured = analysis.site.details.crane.wind_measured or BLANK
    note = f"The wind is measured by: {measured}."
    wind = analysis.wind
    if wind is None or wind.limit() == 0.0:
        note += " The limit of this load is from simulated gusts at the load."
    else:
        note += (
            f" The limit of this load is from simulated gusts: none of {wind.at_limit} of its "
            "speed breaks a limit, the worst among them looked for; the most that is tried is "
            f"{STRONGEST:g} m/s."
        )
    return Table(WIND_TITLE, columns, rows, note)


def _whose(analysis: LiftAnalysis, source: str) -> str:
    """Return whose limit a wind limit is; for that of the load with what a stronger gust exceeds
    first.
    """
    wind = analysis.wind
    if source != LOAD or wind is None or wind.binding is None:
        return source
    if wind.binding == "clearance" and wind.nearest is not None:
        return f"{source} (clearance between {wind.nearest.body} and {wind.nearest.obstacle})"
    return f"{source} ({wind.binding})"


def sequence_table(analysis: LiftAnalysis) -> Table:
    """Return the steps of the lift with their times, what crane and people do, how fast, and who
    speaks.
    """
    people = analysis.site.details.people
    speaks = people.signaller or BLANK
    rows: list[Row] = []
    for step in all_steps(analysis):
        if isinstance(step, StepByHand):
            rows.append([str(step.position), "-", step.what, "-", "-", speaks])
            continue
        times = f"{step.begins:.0f} to {step.ends:.0f}"
        place = place_text(step.place)
        action = ". ".join(step.movements)
        speeds = ", ".join(step.speeds) or "-"
        rows.append([step.positions, times, action, speeds, place, speaks])
    columns = [
        ("positions", ""),
        ("time [s]", ""),
        ("what happens", ""),
        ("at most", ""),
        ("load then at [m]", ""),
        ("who speaks", ""),
    ]
    spoken = people.communication or BLANK
    note = (
        "Positions as numbered on the drawings; times from the beginning of the simulated lift. "
        "Steps without a time last as long as people need, and its clock stands meanwhile, as the "
        f"crane does. They speak by: {spoken}. The proof of the distances holds for this motion "
        "alone: drives that move at other times, in another order or at other speeds take the load "
        "along another way, which is not proven."
    )
    return Table(SEQUENCE_TITLE, columns, rows, note)
