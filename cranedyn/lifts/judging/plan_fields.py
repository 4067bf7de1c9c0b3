"""The fields of a lift plan: what people look for on it, with its value, or empty to be filled in
by hand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.assumptions import Assumption, Origin
from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.lift_positions import MAX_NAMED, largest_wheel_force
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.plan_checks import (
    bearing_pressure,
    corner_range,
    forces_on_ground,
    hook_height,
    rope_left,
    sling_force,
    wind_text,
)
from cranedyn.lifts.judging.table import place_text, tonnes
from cranedyn.lifts.planning.plan_details import CraneDocuments, LiftInShift, PlanDetails, Slings
from cranedyn.lifts.planning.rigging import leg_limit

COUNTING_FIELDS = (
    *("[uncertainty] mass", "[uncertainty] wind", "[uncertainty] gust"),
    *("[load] source", "[load] area", "[lift] swing", "[lift] distance"),
    *("[wind]", "[drives] rates"),
    *("--wind", "--swing", "--falls", "--chart"),
)
"""Beginnings of the fields and options that enter what may turn out otherwise on the day of the
lift: what the people on the site can watch. A delay of the sensors, an error of the measured cable
or a probability nobody sees."""


@dataclass(frozen=True)
class PlanField:
    """A field of a lift plan.

    Attributes:
        label: What it is.
        value: Its value as text; None if nobody entered it, then it is an empty line.
    """

    label: str
    value: str | None


@dataclass(frozen=True)
class FieldGroup:
    """Fields of a lift plan about one subject.

    Attributes:
        title: The subject.
        fields: The fields.
    """

    title: str
    fields: Sequence[PlanField]


def identification(analysis: LiftAnalysis) -> FieldGroup:
    """Return which lift the plan is for."""
    job = analysis.site.details.job
    papers = analysis.site.details.crane
    fields = [
        PlanField("Site", job.site),
        PlanField("Client", job.client),
        PlanField("What is lifted", job.title),
        PlanField("Lift number", job.number),
        PlanField("Date of the lift", job.date),
        PlanField("Revision of the job", job.revision),
        PlanField(
            "Crane", " ".join(dict.fromkeys(filter(None, (papers.maker, papers.type)))) or None
        ),
    ]
    return FieldGroup("Identification", fields)


def signatures(analysis: LiftAnalysis) -> list[PlanField]:
    """Return who signs, with their names as far as they are entered."""
    people = analysis.site.details.people
    return [
        PlanField("Prepared by", people.prepared),
        PlanField("Approved by", people.approved),
        PlanField("Appointed person", people.appointed),
        PlanField("Lift supervisor", people.supervisor),
        PlanField("Crane operator", people.operator),
        PlanField("Slinger", people.slinger),
        PlanField("Signaller", people.signaller),
        *_second_signaller(analysis),
        PlanField("Receives the load", people.receiver),
        PlanField("Guards the zone", people.guard),
    ]


def _second_signaller(analysis: LiftAnalysis) -> list[PlanField]:
    """Return who directs the operator where the first signaller does not see the load; nothing if
    nobody is entered and the operator sees it all the way.
    """
    details = analysis.site.details
    if details.people.second_signaller is None and details.limits.blind is False:
        return []
    return [PlanField("Second signaller", details.people.second_signaller)]


def counting_assumptions(analysis: LiftAnalysis) -> list[Assumption]:
    """Return the assumptions that people on the site can watch, and every value that nobody
    entered, these first.
    """
    assumptions = analysis.inputs.assumptions
    defaults = [a for a in assumptions if a.origin is Origin.DEFAULT]
    others = [a for a in assumptions if a.origin is not Origin.DEFAULT]
    return defaults + [a for a in others if a.field.startswith(COUNTING_FIELDS)]


def other_assumptions(analysis: LiftAnalysis) -> list[Assumption]:
    """Return the assumptions that are not among `counting_assumptions`: crane, structure, base,
    load, rope, obstacles; those that are estimates first.
    """
    counting = {assumption.name for assumption in counting_assumptions(analysis)}
    others = [a for a in analysis.inputs.assumptions if a.name not in counting]
    return sorted(others, key=lambda assumption: assumption.origin is not Origin.ESTIMATED)


def field_groups(analysis: LiftAnalysis, in_zone: Sequence[str] = ()) -> list[FieldGroup]:
    """Return the fields of the pages behind the first, by subject.

    Args:
        analysis: The lift.
        in_zone: Names of what stands in its exclusion zone.
    """
    groups = [
        _load(analysis),
        _rigging(analysis),
        _crane(analysis),
        _ground(analysis),
        _people(analysis, in_zone),
    ]
    shift = analysis.site.details.shift
    return groups if shift is None else [_shift(shift), *groups]


def _shift(shift: LiftInShift) -> FieldGroup:
    """Return what the plan of the shift says of the lift."""
    fields = [
        PlanField("Site with several cranes", shift.site),
        PlanField("Lift", shift.lift),
        PlanField("Crane", shift.crane),
        PlanField("Leaves for the load", shift.begins),
        PlanField("Leaves with the load", shift.leaves),
        PlanField("Delivered", shift.delivered),
        PlanField("Unhooked", shift.unhooked),
        PlanField("Waits", shift.waits),
        PlanField("Not before", shift.after or "no lift"),
        PlanField("Meanwhile", " ".join(shift.others) or "no other crane"),
    ]
    return FieldGroup("In the shift (h:mm:ss from its begin)", fields)


def _load(analysis: LiftAnalysis) -> FieldGroup:
    """Return weight, size, centre of gravity and lifting points of the load."""
    site = analysis.site
    load = site.details.load
    size = np.ptp(analysis.certificate.lift.clearance.bodies.load, axis=0)
    rigging = sum(site.rigging.values())
    mass = site.crane.get("payload_mass")
    points = "; ".join(place_text(point, 2) for point in load.lifting_points)
    fields = [
        PlanField("Mass of the load", None if mass is None else tonnes(mass - rigging)),
        PlanField("How it is known", load.source),
        PlanField("Tolerance", f"±{100.0 * analysis.inputs.spread.load:.3g} %"),
        PlanField("Size across, along, high", " × ".join(f"{side:.2f}" for side in size) + " m"),
        PlanField(
            "Centre of gravity, from the middle of the box",
            None if load.centre is None else f"{place_text(load.centre, 2)} m",
        ),
        PlanField("Lifting points, from there", f"{points} m" if points else None),
        PlanField("Area to the wind", None if load.area is None else f"{load.area:g} m²"),
        PlanField("Drag coefficient", None if load.drag is None else f"{load.drag:g}"),
    ]
    return FieldGroup("Load", fields)


def _rigging(analysis: LiftAnalysis) -> FieldGroup:
    """Return slings, spreader, hook block and headroom."""
    details = analysis.site.details
    slings = details.slings
    spreader = details.spreader
    masses = analysis.site.rigging
    leg = sling_force(analysis)
    fields = [
        PlanField("Slings", slings.type),
        PlanField("Number of legs", None if slings.number is None else f"{slings.number}"),
        PlanField("Length of a leg", None if slings.length is None else f"{slings.length:g} m"),
        PlanField("Angle from the vertical", _degrees(slings.angle if leg is None else leg.angle)),
        *_sling_limits(slings),
        PlanField("Certificate", slings.certificate),
        PlanField("Used of the WLL", None if leg is None else f"{100.0 * leg.utilisation:.0f} %"),
        PlanField("Mass of the slings", _mass(masses, "slings")),
        PlanField("Mass of the hook block", _mass(masses, "hook")),
        PlanField(
            "Rated load of the hook block",
            None if details.hook_block_limit is None else tonnes(details.hook_block_limit),
        ),
        PlanField(
            "Height of the hook block",
            None if details.hook_block_height is None else f"{details.hook_block_height:g} m",
        ),
        _headroom(analysis),
        PlanField("Tag lines", details.tag_lines),
        PlanField("Accessories thoroughly examined", details.rigging_examined),
    ]
    if spreader is None:
        fields.append(PlanField("Spreader", "none entered"))
    else:
        limit = "WLL not entered" if spreader.limit is None else f"WLL {tonnes(spreader.limit)}"
        fields.append(PlanField("Spreader", f"{spreader.name or 'unnamed'}, {limit}"))
    return FieldGroup("Rigging", fields)


def _headroom(analysis: LiftAnalysis) -> PlanField:
    """Return how far the hook stays below its largest height; of a boom crane, whose hook has
    another largest height at each radius, how far its block stays below the head of the boom.
    """
    if LoadJoints.of(analysis.crane).has_boom:
        left = rope_left(analysis)
        return PlanField(
            "Block below the boom head, at least", None if left is None else f"{left:.2f} m"
        )
    height = hook_height(analysis)
    largest = analysis.site.details.crane.height_under_hook
    if height is None or largest is None:
        return PlanField("Headroom", None)
    return PlanField("Headroom", f"{largest - height:.2f} m")


def _sling_limits(slings: Slings) -> list[PlanField]:
    """Return the working load limit of one leg, and that of the set where it was entered: which of
    the two is said with each.
    """
    of_leg = leg_limit(slings)
    if slings.set_limit is None:
        return [PlanField("WLL of one leg", None if of_leg is None else tonnes(of_leg))]
    shown = None if of_leg is None else f"{tonnes(of_leg)}, from that of the set"
    return [
        # Tags of sets have a limit of their own beyond that, see `cranedyn.lifts.planning.rigging`.
        PlanField("WLL of the set, on its tag", f"{tonnes(slings.set_limit)} up to 45°"),
        PlanField("WLL of one leg", shown),
    ]


def _crane(analysis: LiftAnalysis) -> FieldGroup:
    """Return the papers of the crane."""
    crane = analysis.site.details.crane
    chart = analysis.chart
    slews = "radius_m" in analysis.loads.values
    has_boom = LoadJoints.of(analysis.crane).has_boom
    limit = crane.wind_limit
    fields = [
        PlanField("Maker", crane.maker),
        PlanField("Type", crane.type),
        PlanField("Serial number", crane.serial),
        PlanField("Configuration", crane.configuration),
    ]
    # A crane that does not slew has neither a jib nor a counter-ballast.
    if slews or crane.jib_length is not None:
        length = None if crane.jib_length is None else f"{crane.jib_length:g} m"
        name = "Boom length" if has_boom else "Length of the jib"
        fields.append(PlanField(name, length))
    # What the chart asks for is the same mass, by another name.
    ballast = crane.counter_ballast
    if ballast is None:
        ballast = analysis.site.counterweight
    if slews or ballast is not None:
        shown = None if ballast is None else tonnes(ballast)
        fields.append(PlanField("Counter-ballast", shown))
    ballast = crane.central_ballast
    if analysis.site.is_tower or ballast is not None:
        fields.append(PlanField("Central ballast", None if ballast is None else tonnes(ballast)))
    height = crane.height_under_hook
    fields += [
        PlanField("Falls", None if analysis.inputs.falls is None else f"{analysis.inputs.falls}"),
    ]
    # The largest height of the hook of a boom crane differs from radius to radius.
    if not has_boom or height is not None:
        shown = None if height is None else f"{height:g} m"
        name = "Height under hook, not judged" if has_boom else "Height under hook"
        fields.append(PlanField(name, shown))
    fields += [
        PlanField("Load chart", None if chart is None else chart.name),
        PlanField("Page of the chart", crane.chart_page),
        PlanField("Date of the chart", crane.chart_date),
        PlanField("Wind limit of the maker", None if limit is None else wind_text(limit)),
        PlanField("Wind measured by", crane.wind_measured),
        PlanField("How it is left out of service", crane.out_of_service),
        PlanField("Thoroughly examined", crane.examined),
    ]
    return FieldGroup("Crane", fields)


def _ground(analysis: LiftAnalysis) -> FieldGroup:
    """Return forces on the ground or the rails, mats and pressures."""
    ground = analysis.site.details.ground
    runway = analysis.site.runway
    wheels = largest_wheel_force(analysis)
    if wheels is not None:
        permitted = None if runway is None or runway.permitted is None else runway.permitted
        fields = [
            PlanField("Largest force of a wheel, load as entered", f"{wheels.max() / 1e3:.0f} kN"),
            PlanField("The rail may bear", None if permitted is None else kilonewtons(permitted)),
        ]
        return FieldGroup("Runway", fields)
    forces = corner_range(analysis)
    pressure = bearing_pressure(analysis)
    base = analysis.site.base
    force = None if base is None or base.permitted is None else base.permitted
    mat = None
    if ground.mat_length is not None and ground.mat_width is not None:
        mat = f"{ground.mat_length:g} m × {ground.mat_width:g} m"
    bears = ground.permitted_pressure
    papers = analysis.site.details.crane
    in_service = papers.corner_in_service
    fields = [
        *_corner_fields(analysis),
        PlanField(
            "Largest force of a corner, heavier load, no wind on the crane",
            None if forces is None else kilonewtons(forces[1]),
        ),
        PlanField(
            "By the papers, in service with wind",
            None if in_service is None else kilonewtons(in_service),
        ),
        PlanField(
            "By the papers, out of service",
            _out_of_service_text(papers),
        ),
        PlanField("Permitted force", None if force is None else kilonewtons(force)),
        PlanField("Mat below each corner", mat),
        PlanField(
            "Bearing pressure, no wind on the crane",
            None if pressure is None else f"{pressure / 1e3:.0f} kPa",
        ),
        PlanField("Permitted pressure", None if bears is None else f"{bears / 1e3:g} kPa"),
        PlanField("From", ground.pressure_source),
    ]
    return FieldGroup("Ground", fields)


def _out_of_service_text(papers: CraneDocuments) -> str | None:
    """Return the force of a corner out of service, or that it is not judged with how the crane is
    left; None if neither is entered.
    """
    if papers.corner_out_of_service is not None:
        return kilonewtons(papers.corner_out_of_service)
    left = papers.out_of_service
    return None if left is None else f"not judged: {left}"


def _corner_fields(analysis: LiftAnalysis) -> list[PlanField]:
    """Return the forces of each corner of the base while the lift lasts, with its place from the
    middle of the base; of a crane whose corners are not known an empty field.
    """
    base = analysis.site.base
    forces = forces_on_ground(analysis)
    if base is None or forces is None:
        return [PlanField("Force of each corner", None)]
    axes = "the crane" if base.turns_with_crane else "the site"
    fields = []
    corners = (("+", "+"), ("−", "+"), ("−", "−"), ("+", "−"))  # as `forces_on_ground` has them
    for (x, y), force in zip(corners, forces, strict=True):
        label = f"Corner at {x}x, {y}y of {axes}, load as entered"
        fields.append(PlanField(label, f"{force.min() / 1e3:.0f} to {force.max() / 1e3:.0f} kN"))
    return fields


def _people(analysis: LiftAnalysis, in_zone: Sequence[str]) -> FieldGroup:
    """Return how people are kept clear, speak, and act if something goes wrong."""
    details = analysis.site.details
    limits = details.limits
    fields = [
        PlanField("Exclusion zone", details.exclusion),
        *_in_zone_fields(details, in_zone),
        PlanField("Guards the exclusion zone", details.people.guard),
        PlanField("Receives the load", details.people.receiver),
        *_second_signaller(analysis),
        PlanField("Communication", details.people.communication),
        PlanField("Trial lift", details.trial_lift),
        PlanField("Over people or a public way", yes_or_no(limits.over_people)),
        PlanField("Over services", yes_or_no(limits.over_services)),
        PlanField("Blind for the operator", yes_or_no(limits.blind)),
        PlanField("If something goes wrong", " ".join(details.contingency) or None),
    ]
    return FieldGroup("People and contingency", fields)


def _in_zone_fields(details: PlanDetails, in_zone: Sequence[str]) -> list[PlanField]:
    """Return what is done about people and services in each thing that stands in the exclusion
    zone. Things with one sentence, such as the parts of a building, have one field. Those without
    one have an empty field each, as many as whoever signs can answer by hand; the rest is counted.
    """
    done: dict[str, str] = {}
    missing = []
    for name in in_zone:
        sentence = details.done_about(name)
        if sentence is None:
            missing.append(PlanField(f"In that zone: {name}", None))
        else:
            done[sentence] = f"{done[sentence]}, {name}" if sentence in done else name
    fields = [PlanField(f"In that zone: {names}", sentence) for sentence, names in done.items()]
    more = len(missing) - MAX_NAMED
    if more > 0:
        missing = [*missing[:MAX_NAMED], PlanField(f"In that zone: {more} more", None)]
    return fields + missing


def kilonewtons(force: float) -> str:
    """Return a force [N] in kilonewtons."""
    return f"{force / 1e3:.0f} kN"


def _degrees(angle: float | None) -> str | None:
    """Return an angle [rad] in degrees."""
    return None if angle is None else f"{math.degrees(angle):.0f}°"


def _mass(masses: Mapping[str, float], part: str) -> str | None:
    """Return the mass of a part of the rigging to read; None if it is not entered."""
    mass = masses.get(part)
    return None if mass is None else f"{mass:g} kg"


def yes_or_no(value: bool | None) -> str | None:
    """Return an answer in a word."""
    if value is None:
        return None
    return "yes" if value else "no"
