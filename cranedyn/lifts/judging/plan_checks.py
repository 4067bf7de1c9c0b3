"""Checks of what a site enters for its lift plan: slings, spreader, lifting points, headroom,
bearing pressure and limits of the wind.

Each is made from what was entered. Where nothing of it was entered there is no check, and the
report lists it under what is not checked (`not_checked`). Where a part of it was entered and the
rest is missing, it is not judged. The derivations are in docs/concepts/lifting.md, "What a lift
plan adds".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.loads import hanging_mass
from cranedyn.lifts.judging.table import tonnes
from cranedyn.lifts.planning.crane_bodies import corners_of
from cranedyn.lifts.planning.plan_assumptions import in_words
from cranedyn.lifts.planning.plan_details import CraneDocuments
from cranedyn.lifts.planning.rigging import (
    attachment_height,
    counted_legs,
    largest_share,
    leg_limit,
    leg_share,
    rigging_height,
    set_limit_at,
    sling_angle,
    tilt,
)
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.verdict import Check

MAX_SLING_ANGLE = math.radians(60.0)
"""Largest angle of a leg from the vertical at which slings may be used [rad]: of guides for
slingers, as for EN 818-4 and EN 1492; read second hand."""

JIB_TOLERANCE = 0.01
"""Length by which a jib or counter-jib that is entered may reach beyond the shapes of a crane's
description [m]: what rounding to centimetres makes, far below the distance that a lift keeps."""

KMH = 3.6
"""One metre per second in kilometres per hour."""

PlanCheck = Callable[[LiftAnalysis], Check | None]
"""A check of what a site enters; None where nothing of it was entered."""


def plan_checks(analysis: LiftAnalysis) -> list[Check]:
    """Return the checks of what the site enters for its lift plan, in the order of the report."""
    checks = []
    for function in PLAN_CHECKS:
        check = function(analysis)
        if check is not None:
            # By the name of the function a stored plan finds its check again.
            checks.append(Check(check.sentence, check.verdict, function.__name__))
    return checks


def not_checked(analysis: LiftAnalysis, checks: Sequence[Check]) -> list[str]:
    """Return what is not checked because nobody entered anything of it, in sentences.

    Args:
        analysis: The lift.
        checks: All checks that were made, those of `plan_checks` among them.
    """
    made = {check.name for check in checks}
    joints = LoadJoints.of(analysis.crane)
    on_rails = joints.travel is not None
    has_boom = joints.has_boom
    sentences = []
    for function, sentence in PLAN_CHECKS.items():
        # A crane on rails has wheel loads in the place of a pressure on the ground.
        of_ground = function in (ground_bears, papers_bear)
        left_out = (of_ground and on_rails) or (function is headroom and has_boom)
        applies = bool(sentence) and not left_out
        if applies and function.__name__ not in made:
            sentences.append(sentence)
    return sentences


# --- rigging --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SlingForce:
    """What the most loaded leg of the slings carries.

    Attributes:
        force: Its force, dynamics of the simulated lift and tolerance of the mass included [N].
        limit: The force that its working load limit allows [N].
        angle: Its angle from the vertical [rad].
        share: The share of the weight below that it is counted with.
        lifted: The force of all that hangs in the slings, the same included [N].
        set_limit: The force that the tag of the set allows at this angle [N]; None if the limit of
            one leg was entered.
    """

    force: float
    limit: float
    angle: float
    share: float
    lifted: float
    set_limit: float | None = None

    @property
    def utilisation(self) -> float:
        """Its force over what its working load limit allows, or what hangs over what the tag of the
        set allows, whichever is more.
        """
        of_leg = self.force / self.limit
        return of_leg if self.set_limit is None else max(of_leg, self.lifted / self.set_limit)


def lifted_force(analysis: LiftAnalysis, *, above: tuple[str, ...]) -> float:
    """Return the largest force by which the parts of what hangs pull on what holds them [N], with a
    load heavier by its tolerance.

    Load, slings, spreader and hook block move together, so that each part takes the share of the
    rope's largest tension that its mass is of all. That tension is of the simulated lift, so that
    the dynamics of lifting off and moving are in it.

    Args:
        analysis: The lift.
        above: Parts of the rigging that hold the others and are not counted, of "hook", "slings"
            and "spreader".
    """
    mass = hanging_mass(analysis.crane)
    below = mass - sum(analysis.site.rigging.get(part, 0.0) for part in above)
    tension = float(analysis.loads["rope_N"].max())
    return (1.0 + analysis.inputs.spread.load) * tension * below / mass


def sling_force(analysis: LiftAnalysis) -> SlingForce | None:
    """Return what the most loaded leg carries; None if something that it needs is not entered, or
    the centre of gravity is outside of the lifting points.
    """
    details = analysis.site.details
    slings = details.slings
    angle = sling_angle(details)
    limit = leg_limit(slings)
    if slings.number is None or limit is None or angle is None:
        return None
    share = leg_share(details.load, slings.number)
    if share is None:
        return None
    lifted = lifted_force(analysis, above=("hook", "spreader"))
    gravity = analysis.crane.gravity
    of_set = set_limit_at(slings, angle)
    return SlingForce(
        force=lifted * share / math.cos(angle),
        limit=limit * gravity,
        angle=angle,
        share=share,
        lifted=lifted,
        set_limit=None if of_set is None else of_set * gravity,
    )


def slings_bear(analysis: LiftAnalysis) -> Check | None:
    """Check that the most loaded leg of the slings carries no more than its working load limit, at
    an angle at which slings may be used.
    """
    slings = analysis.site.details.slings
    has_limit = slings.limit is not None or slings.set_limit is not None
    if slings.number is None and not has_limit:
        return None
    missing = []
    if slings.number is None:
        missing.append("number")
    if not has_limit:
        missing.append("limit of one leg or set_limit of the set")
    if sling_angle(analysis.site.details) is None:
        missing.append("angle, or length beside [load] lifting_points")
    if missing:
        return Check(
            f"The slings are not judged: [rigging.slings] lacks {in_words(missing)}.", None
        )
    leg = sling_force(analysis)
    if leg is None:
        return Check("The slings are not judged: the load does not hang in them as entered.", None)
    assert slings.number is not None  # as nothing is missing
    gravity = analysis.crane.gravity
    counted = counted_legs(slings.number)
    entered = "entered as that of one leg"
    of_set = ""
    if leg.set_limit is not None:
        assert slings.set_limit is not None
        entered = f"which follows from {tonnes(slings.set_limit)} on the tag of the set"
        of_set = (
            f" All that hangs in the set pulls with {tonnes(leg.lifted / gravity)}; its tag allows "
            f"{tonnes(leg.set_limit / gravity)} at that angle."
        )
    return Check(
        f"A leg of the slings pulls with {tonnes(leg.force / gravity)} at most, "
        f"{100.0 * leg.force / leg.limit:.0f} % of its working load limit of "
        f"{tonnes(leg.limit / gravity)}, {entered}, with {100.0 * leg.share:.0f} % of the "
        f"weight at {math.degrees(leg.angle):.0f}° from the vertical ({counted} of "
        f"{slings.number} counted on); {math.degrees(MAX_SLING_ANGLE):.0f}° allowed.{of_set}",
        leg.utilisation <= 1.0 and leg.angle <= MAX_SLING_ANGLE,
    )


def hook_block_bears(analysis: LiftAnalysis) -> Check | None:
    """Check that what hangs on the hook is no more than the rated load of the hook block."""
    limit = analysis.site.details.hook_block_limit
    if limit is None:
        return None
    gravity = analysis.crane.gravity
    force = lifted_force(analysis, above=("hook",))
    return Check(
        f"The hook block carries {tonnes(force / gravity)} at most, "
        f"{100.0 * force / gravity / limit:.0f} % of its rated load of {tonnes(limit)}.",
        force <= gravity * limit,
    )


def spreader_bears(analysis: LiftAnalysis) -> Check | None:
    """Check that the spreader carries no more than its working load limit."""
    spreader = analysis.site.details.spreader
    if spreader is None:
        return None
    if spreader.limit is None:
        return Check("The spreader is not judged: [rigging.spreader] lacks limit.", None)
    gravity = analysis.crane.gravity
    force = lifted_force(analysis, above=("hook", "spreader"))
    return Check(
        f"The spreader carries {tonnes(force / gravity)} at most, "
        f"{100.0 * force / gravity / spreader.limit:.0f} % of its working load limit of "
        f"{tonnes(spreader.limit)}.",
        force <= gravity * spreader.limit,
    )


def centre_between_lifting_points(analysis: LiftAnalysis) -> Check | None:
    """Check that the centre of gravity is within the polygon of the lifting points in plan, and not
    above them.
    """
    load = analysis.site.details.load
    if not load.lifting_points or load.centre is None:
        return None
    share = largest_share(load.lifting_points, load.centre)
    if share is None:
        return Check(
            "The centre of gravity is outside of the lifting points in plan: the load turns over, "
            "or hangs out of level until it is below the hook.",
            False,
        )
    above = load.centre[2] - min(z for _, _, z in load.lifting_points)
    if above > 0.0:
        return Check(
            f"The centre of gravity is {above:.2f} m above a lifting point: whether the load turns "
            "over is not computed.",
            None,
        )
    leans = tilt(analysis.site.details)
    level = ""
    if leans is not None:
        level = f"; with all legs of one length it hangs {math.degrees(leans):.1f}° out of level"
    return Check(
        "The centre of gravity is between the lifting points, of which one may carry "
        f"{100.0 * share:.0f} % of the weight{level}.",
        True,
    )


# --- heights --------------------------------------------------------------------------------------


def hook_height(analysis: LiftAnalysis) -> float | None:
    """Return the largest height of the saddle of the hook above the foot of the crane in the
    planned motion [m]; None if the height of the rigging does not follow from what is entered.
    """
    rigging = rigging_height(analysis.site.details)
    if rigging is None:
        return None
    clearance = analysis.certificate.lift.clearance
    places = clearance.point(analysis.certificate.run.q[:, clearance.drive_joints])
    attached = attachment_height(analysis.site.details, clearance.bodies.load)
    return float(places[:, 2].max()) + attached + rigging


def headroom(analysis: LiftAnalysis) -> Check | None:
    """Check that the hook stays below the largest height that it can have by the papers of the
    crane, less the error of the cable length. The hook of a boom crane has no largest height that
    is the same at all radii.
    """
    largest = analysis.site.details.crane.height_under_hook
    if largest is None or LoadJoints.of(analysis.crane).has_boom:
        return None  # of a boom crane `rope_above_hook_block` is the check
    needed = hook_height(analysis)
    if needed is None:
        return Check(
            "The headroom is not judged: the height of slings and spreader does not follow from "
            "what [rigging.slings] and [rigging.spreader] enter.",
            None,
        )
    error = analysis.inputs.spread.cable
    return Check(
        f"The hook rises to {needed:.2f} m above the foot, {largest - needed:.2f} m below its "
        f"largest height of {largest:g} m; the cable may be wrong by {error:g} m.",
        largest - needed >= error,
    )


def rope_above_hook_block(analysis: LiftAnalysis) -> Check | None:
    """Check that the hook block with all that hangs below it is shorter than the cable."""
    details = analysis.site.details
    if details.hook_block_height is None:
        return None
    rigging = rigging_height(details)
    if rigging is None:
        return Check(
            "Whether the hook block fits below the upper end of the rope is not judged: the height "
            "of slings and spreader does not follow from what is entered.",
            None,
        )
    left = rope_left(analysis)
    assert left is not None  # as both heights are known
    error = analysis.inputs.spread.cable
    return Check(
        f"Above the hook block {left:.2f} m of rope are left at least; the cable may be wrong by "
        f"{error:g} m.",
        left >= error,
    )


def rope_left(analysis: LiftAnalysis) -> float | None:
    """Return the least length of rope above the hook block in the planned motion [m]; None if the
    height of block or rigging is not known.
    """
    details = analysis.site.details
    rigging = rigging_height(details)
    if rigging is None or details.hook_block_height is None:
        return None
    clearance = analysis.certificate.lift.clearance
    shortest = float(np.min(clearance.cable(analysis.certificate.run.q)))
    hangs = attachment_height(details, clearance.bodies.load) + rigging + details.hook_block_height
    return shortest - hangs


def jib_as_long_as_entered(analysis: LiftAnalysis) -> Check | None:
    """Check that the jib of the model, with which it is proven that the jib turns freely, is no
    shorter than that of the crane's papers: the model's ends just beyond the largest radius of its
    trolley.
    """
    length = analysis.site.details.crane.jib_length
    clearance = analysis.certificate.lift.clearance
    if length is None or not isinstance(clearance, TowerClearance):
        return None
    # The jib points along -Y at zero slew.
    tip = max(-float(corners_of(shape)[:, 1].min()) for shape in clearance.bodies.upper)
    if tip >= length - JIB_TOLERANCE:
        return Check(f"The jib of the model, {tip:.2f} m, is no shorter than entered.", True)
    return Check(
        f"The jib of the model ends {tip:.2f} m from the slew axis, and jib_length is {length:g} "
        "m: what its outer part meets is not judged. Enter trolley_max of the crane.",
        None,
    )


# --- ground ---------------------------------------------------------------------------------------


class SupportForces(NamedTuple):
    """Forces of the corners of a base on the ground [N], with a load heavier by its tolerance.

    Attributes:
        smallest: The smallest.
        largest: The largest.
    """

    smallest: float
    largest: float


def corner_range(analysis: LiftAnalysis) -> SupportForces | None:
    """Return the smallest and the largest force of a corner of the base; None if they are not
    known.
    """
    base = analysis.site.base
    forces = forces_on_ground(analysis)
    if base is None or forces is None:
        return None
    # A load heavier by its tolerance presses by that share of its own part in a corner, which is
    # W/4 on all of them and W r/(√2 b) more on the one that the jib points to, see `corner_forces`.
    added = analysis.inputs.spread.load * analysis.loads["pull_N"]
    tilting = analysis.loads["radius_m"] / (math.sqrt(2.0) * base.spacing)
    return SupportForces(
        float((forces.min(axis=0) + np.minimum(added * (0.25 - tilting), 0.0)).min()),
        float((forces.max(axis=0) + added * (0.25 + tilting)).max()),
    )


def forces_on_ground(analysis: LiftAnalysis) -> np.ndarray | None:
    """Return the forces of the corners of the base on the ground, with the load as it is entered
    and without wind [N], shape (4, rows), in the order of
    `cranedyn.lifts.judging.loads.corner_forces`; None if they are not known.
    """
    if analysis.site.base is None or "corner_1_N" not in analysis.loads.values:
        return None
    return np.stack([analysis.loads[f"corner_{i}_N"] for i in range(1, 5)])


def bearing_pressure(analysis: LiftAnalysis) -> float | None:
    """Return the largest pressure below a mat [Pa]: the largest force of a corner over the area of
    its mat; None if one of them is not known.
    """
    area = analysis.site.details.ground.mat_area
    forces = corner_range(analysis)
    if forces is None or area is None:
        return None
    return forces.largest / area


def ground_bears(analysis: LiftAnalysis) -> Check | None:
    """Check that the pressure below each mat is no more than the ground permits."""
    ground = analysis.site.details.ground
    if ground.permitted_pressure is None:
        return None
    permitted = f"{ground.permitted_pressure / 1e3:g} kPa permitted"
    if ground.mat_length is None or ground.mat_width is None:
        return Check(f"The bearing pressure is not judged, {permitted}: [ground] lacks mat.", None)
    pressure = bearing_pressure(analysis)
    if pressure is None:
        return Check(
            f"The bearing pressure is not judged, {permitted}: the forces of the corners are not "
            "known.",
            None,
        )
    return Check(
        f"Below a mat of {ground.mat_length:g} m by {ground.mat_width:g} m the ground bears "
        f"{pressure / 1e3:.0f} kPa at most, without wind on the crane, the weight of the mat not "
        f"counted; {permitted}.",
        pressure <= ground.permitted_pressure,
    )


def papers_bear(analysis: LiftAnalysis) -> Check | None:
    """Check that the ground bears the largest force of a corner by the papers of the crane, in
    service with wind on its structure and out of service: the permitted force, and the permitted
    pressure below a mat, as far as they are entered.
    """
    papers = analysis.site.details.crane
    known = {name: force for name, force in papers.corner_forces.items() if force is not None}
    if not known:
        return None
    largest = max(known.values())
    forces = " and ".join(f"{force / 1e3:.0f} kN {name}" for name, force in known.items())
    sentence = f"By the crane's papers a corner presses with {forces}, wind on the crane included"
    in_service = papers.corner_in_service
    computed = forces_on_ground(analysis)
    calm = 0.0 if computed is None else float(computed.max())
    if in_service is not None and in_service < calm:
        return Check(
            f"{sentence}: less in service than the {calm / 1e3:.0f} kN of this lift without wind. "
            "The papers are of another crane or setup, or the base that is entered is.",
            False,
        )
    lacks, needed = _not_in_papers(papers)
    base = analysis.site.base
    permitted_force = None if base is None else base.permitted
    ground = analysis.site.details.ground
    limits = []
    holds = True
    if permitted_force is not None:
        limits.append(f"{permitted_force / 1e3:.0f} kN permitted")
        holds = largest <= permitted_force
    if ground.permitted_pressure is not None:
        if ground.mat_area is None:
            return Check(f"{sentence}; not judged, since [ground] lacks mat.{lacks}", None)
        pressure = largest / ground.mat_area
        limits.append(
            f"{pressure / 1e3:.0f} kPa below a mat, {ground.permitted_pressure / 1e3:g} kPa "
            "permitted"
        )
        holds = holds and pressure <= ground.permitted_pressure
    if not limits:
        return Check(
            f"{sentence}; not judged, since neither [base] permitted nor [ground] "
            f"permitted_pressure is entered.{lacks}",
            None,
        )
    # What is entered can fail; that it holds says nothing of what is not.
    judged = None if holds and needed else holds
    return Check(f"{sentence}; {'; '.join(limits)}.{lacks}", judged)


def _not_in_papers(papers: CraneDocuments) -> tuple[str, bool]:
    """Return which force of a corner is not entered, as sentences with a space before them, and
    whether it must be: not that out of service where it is entered in words how the crane is left,
    such as with its boom laid down.
    """
    sentences = []
    needed = False
    if papers.corner_in_service is None:
        sentences.append("In service it is not judged: [crane] lacks corner_in_service.")
        needed = True
    if papers.corner_out_of_service is None:
        left = papers.out_of_service
        if left is None:
            sentences.append(
                "Out of service it is not judged: [crane] lacks corner_out_of_service."
            )
            needed = True
        else:
            sentences.append(f"Out of service it is not judged; the crane is left so: {left}.")
    return "".join(f" {sentence}" for sentence in sentences), needed


def ground_caveat(analysis: LiftAnalysis) -> str:
    """Return what the computed forces on the ground leave out, in a sentence; empty for a crane
    without corners.
    """
    if forces_on_ground(analysis) is None:
        return ""
    papers = analysis.site.details.crane
    sentence = "Computed forces and pressures on the ground are without wind on the crane"
    known = [name for name, force in papers.corner_forces.items() if force is not None]
    missing = [name for name, force in papers.corner_forces.items() if force is None]
    if known:
        sentence += f"; with wind, {' and '.join(known)}, those of its papers count"
    if not missing:
        return f"{sentence}."
    if missing == ["out of service"] and papers.out_of_service is not None:
        return f"{sentence}. Out of service is not judged: {papers.out_of_service}."
    return (
        f"{sentence}. With wind, {' and '.join(missing)}, the ground is not judged: take the "
        "forces of the corners from the crane's papers."
    )


class GroundPressure(NamedTuple):
    """The largest pressure below a mat that is known.

    Attributes:
        pressure: The pressure [Pa].
        case: Which it is, in words.
    """

    pressure: float
    case: str


def governing_pressure(analysis: LiftAnalysis) -> GroundPressure | None:
    """Return the largest pressure below a mat: of the computed force, which is without wind on the
    crane, and of those of the crane's papers; None if none is known.
    """
    area = analysis.site.details.ground.mat_area
    papers = analysis.site.details.crane
    known = []
    calm = bearing_pressure(analysis)
    if calm is not None:
        known.append(GroundPressure(calm, "calm air"))
    if area is not None:
        for name, force in papers.corner_forces.items():
            if force is not None:
                known.append(GroundPressure(force / area, f"{name}, papers"))
    return max(known, default=None)


# --- wind -----------------------------------------------------------------------------------------


MAKER = "the maker of the crane"
"""Who sets the limit of `CraneDocuments.wind_limit`."""

SITE = "the site"
"""Who sets the limit of `SiteLimits.wind`."""

LOAD = "this load, by its area"
"""What sets the limit that `cranedyn.lifts.judging.wind_limit` finds."""


class WindBound(NamedTuple):
    """A wind in which a lift stops.

    Attributes:
        source: Whose limit it is: `MAKER`, `SITE` or `LOAD`.
        gust: The gust [m/s].
    """

    source: str
    gust: float


def wind_bounds(analysis: LiftAnalysis) -> list[WindBound]:
    """Return the winds in which the lift stops, as far as they are known, the least first: of the
    maker, of the site, and of this load by its area.
    """
    details = analysis.site.details
    bounds = []
    if details.crane.wind_limit is not None:
        bounds.append(WindBound(MAKER, details.crane.wind_limit))
    if details.limits.wind is not None:
        bounds.append(WindBound(SITE, details.limits.wind))
    if analysis.wind is not None:
        bounds.append(WindBound(LOAD, analysis.wind.limit()))
    return sorted(bounds, key=lambda bound: bound.gust)


def gust_below_all_limits(analysis: LiftAnalysis) -> Check | None:
    """Check that the gust in which the lift must be possible is below the limits of maker and
    site.
    """
    details = analysis.site.details
    if details.crane.wind_limit is None and details.limits.wind is None:
        return None
    least = wind_bounds(analysis)[0]
    required = analysis.requirements.wind
    assert required is not None  # see `cranedyn.lifts.judging.judged_inputs`
    return Check(
        f"The least limit of the wind is that of {least.source}, {wind_text(least.gust)}; "
        f"{wind_text(required)} required.",
        required <= least.gust,
    )


def wind_text(speed: float) -> str:
    """Return the speed of a wind in both units that people use."""
    return f"{speed:g} m/s ({KMH * speed:.0f} km/h)"


PLAN_CHECKS: dict[PlanCheck, str] = {
    slings_bear: "The slings: [rigging.slings] enters neither their number nor their limit.",
    hook_block_bears: "The hook block: [rigging] lacks hook_limit, its rated load.",
    spreader_bears: "",  # a lift without a spreader lacks nothing
    centre_between_lifting_points: (
        "How the load hangs: [load] lacks lifting_points or centre, its centre of gravity."
    ),
    jib_as_long_as_entered: "",  # the model's jib is then the only one
    headroom: "The headroom: [crane] lacks height_under_hook.",
    rope_above_hook_block: (
        "Whether the hook block fits below the upper end of the rope: [rigging] lacks hook_height."
    ),
    ground_bears: "The pressure on the ground: [ground] lacks permitted_pressure.",
    papers_bear: (
        "The ground with wind on the crane, in service and out of service: [crane] lacks "
        "corner_in_service and corner_out_of_service, the largest forces of a corner by its papers."
    ),
    gust_below_all_limits: (
        "The wind in which maker or site stop the crane: neither [crane] wind_limit nor [limits] "
        "wind is entered."
    ),
}
"""The checks of what a site enters, in the order of the report, each with the sentence that takes
its place where nothing of it was entered; an empty one where nothing is missing then."""
