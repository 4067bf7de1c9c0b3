"""What a lift plan says beside the motion: the job, its people, the rigging, the ground and the
documents of the crane.

Site files enter these values, see docs/howto/plan_lift.md. Each of them is optional. A value that
nobody entered is None, or an empty tuple, and is printed as an empty field to be filled in by hand:
no default stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

WeightSource = Literal["weighed", "drawing", "estimated"]
"""How the mass of a load is known."""

WEIGHT_SOURCES: tuple[WeightSource, ...] = get_args(WeightSource)
"""All ways in which the mass of a load may be known."""

WEIGHT_TOLERANCES: dict[WeightSource, float] = {
    "weighed": 0.03,
    "drawing": 0.10,
    "estimated": 0.25,
}
"""By how much a load may be heavier than entered, as a share of its mass, where no tolerance of its
own was entered."""

SlingType = Literal["chain", "wire rope", "webbing", "round"]
"""What a sling is made of."""


@dataclass(frozen=True)
class Job:
    """Which lift on which site a plan is for.

    Attributes:
        site: Name or address of the site.
        client: Who ordered the lift.
        number: Number of the lift.
        title: What is lifted, in words.
        date: Day of the lift, as entered.
        revision: Revision of the plan, as entered.
    """

    site: str | None = None
    client: str | None = None
    number: str | None = None
    title: str | None = None
    date: str | None = None
    revision: str | None = None


@dataclass(frozen=True)
class People:
    """Who answers for the lift and who takes part in it; names are entered by the user.

    Attributes:
        prepared: Who prepared the plan.
        approved: Who approved it.
        appointed: The appointed person.
        supervisor: The supervisor of the lift.
        operator: The operator of the crane.
        slinger: Who attaches the load.
        signaller: Who directs the operator.
        second_signaller: Who directs the operator where the first one does not see the load.
        receiver: Who receives the load where it is set down.
        guard: Who keeps people out of the exclusion zone.
        communication: How they speak to each other, such as "radio, channel 4".
    """

    prepared: str | None = None
    approved: str | None = None
    appointed: str | None = None
    supervisor: str | None = None
    operator: str | None = None
    slinger: str | None = None
    signaller: str | None = None
    second_signaller: str | None = None
    receiver: str | None = None
    guard: str | None = None
    communication: str | None = None


@dataclass(frozen=True)
class CraneDocuments:
    """Which crane lifts, as its papers name it.

    Attributes:
        maker: Its maker.
        type: Its type.
        serial: Its serial number.
        configuration: Its configuration, in words.
        jib_length: Length of its jib or boom [m].
        counter_ballast: Mass of its counter-ballast [kg].
        height_under_hook: Largest height of the hook above the foot [m].
        chart_page: Page of the load chart in the maker's manual.
        chart_date: Date of that chart.
        wind_limit: Wind at which the maker stops the crane [m/s].
        wind_measured: Where and how the wind is measured, such as "anemometer at the jib head".
        central_ballast: Mass of the ballast on its base [kg].
        corner_in_service: Largest force of a corner on the ground in service, with the wind in
            which the crane works [N].
        corner_out_of_service: The same out of service, in a storm [N].
        out_of_service: How it is left, and up to which wind, in words.
        examined: When it was thoroughly examined, with the number of the report, in words.
    """

    maker: str | None = None
    type: str | None = None
    serial: str | None = None
    configuration: str | None = None
    jib_length: float | None = None
    counter_ballast: float | None = None
    height_under_hook: float | None = None
    chart_page: str | None = None
    chart_date: str | None = None
    wind_limit: float | None = None
    wind_measured: str | None = None
    central_ballast: float | None = None
    corner_in_service: float | None = None
    corner_out_of_service: float | None = None
    out_of_service: str | None = None
    examined: str | None = None

    @property
    def corner_forces(self) -> dict[str, float | None]:
        """The largest forces of a corner [N], "in service" and "out of service"."""
        return {
            "in service": self.corner_in_service,
            "out of service": self.corner_out_of_service,
        }


@dataclass(frozen=True)
class LoadDetails:
    """What is known of a load beside its mass and its size.

    Attributes:
        source: How its mass is known.
        centre: Centre of gravity from the centre of the load's box, in the axes of the load [m].
        lifting_points: Points to which the rigging is attached, from the centre of the box [m].
        area: Largest area that it turns to the wind [m²].
        drag: Drag coefficient that belongs to the area.
    """

    source: WeightSource | None = None
    centre: tuple[float, float, float] | None = None
    lifting_points: tuple[tuple[float, float, float], ...] = ()
    area: float | None = None
    drag: float | None = None


@dataclass(frozen=True)
class Slings:
    """The slings between hook, or spreader, and load.

    Attributes:
        type: What they are made of.
        number: Number of legs.
        angle: Angle of each leg from the vertical [rad].
        length: Length of each leg [m].
        limit: Working load limit of one leg, in a straight pull [kg].
        certificate: Number of their certificate.
        set_limit: Working load limit of all legs together, up to 45° from the vertical, as the tag
            of a set has it [kg]. Either this or `limit` is entered, or neither.
    """

    type: SlingType | None = None
    number: int | None = None
    angle: float | None = None
    length: float | None = None
    limit: float | None = None
    certificate: str | None = None
    set_limit: float | None = None


@dataclass(frozen=True)
class Spreader:
    """A beam or frame between hook and load.

    Attributes:
        name: What it is called.
        height: Height from its lifting eye to the eyes below [m].
        limit: Its working load limit [kg].
    """

    name: str | None = None
    height: float | None = None
    limit: float | None = None


@dataclass(frozen=True)
class GroundDetails:
    """What carries the crane.

    Attributes:
        permitted_pressure: Bearing pressure that the ground permits [Pa].
        pressure_source: Where that is from, such as the number of a soil report.
        mat_length: Length of the mat under each corner or outrigger [m].
        mat_width: Width of that mat [m].
        north: Bearing of the Y axis of the site, clockwise from north [rad].
    """

    permitted_pressure: float | None = None
    pressure_source: str | None = None
    mat_length: float | None = None
    mat_width: float | None = None
    north: float | None = None

    @property
    def mat_area(self) -> float | None:
        """Area of a mat [m²]; None if it is not known."""
        if self.mat_length is None or self.mat_width is None:
            return None
        return self.mat_length * self.mat_width


@dataclass(frozen=True)
class SiteLimits:
    """Limits that a site sets for itself.

    Attributes:
        chart_share: Largest share of the rated load that may be used, from 0 to 1.
        wind: Gust at which the lift stops [m/s].
        over_people: Whether the load is moved over people or over a public way.
        over_services: Whether it is moved over services, such as power lines or pipes in use.
        blind: Whether the operator cannot see the load all the way.
    """

    chart_share: float | None = None
    wind: float | None = None
    over_people: bool | None = None
    over_services: bool | None = None
    blind: bool | None = None


@dataclass(frozen=True)
class LiftInShift:
    """What the plan of a shift says of a lift, as `cranedyn run site --reports` writes it.

    Attributes:
        site: Name of the site with several cranes.
        lift: Name of the lift in its list.
        crane: Name of the crane.
        begins: When the crane leaves for the load, from the begin of the shift.
        leaves: When it leaves with the load.
        delivered: When the load is at its goal.
        unhooked: When it is unhooked.
        waits: How long the crane stands because of others, and because of which.
        after: The lifts whose loads must be unhooked before.
        others: What each other crane does while this one carries the load, in sentences.
    """

    site: str | None = None
    lift: str | None = None
    crane: str | None = None
    begins: str | None = None
    leaves: str | None = None
    delivered: str | None = None
    unhooked: str | None = None
    waits: str | None = None
    after: str | None = None
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlanDetails:
    """All that a lift plan says beside the motion.

    Attributes:
        job: Which lift on which site it is for.
        people: Who takes part.
        crane: Papers of the crane.
        load: What else is known of the load.
        slings: The slings.
        spreader: The spreader; None if there is none.
        hook_block_height: Height of the hook block from the rope's end to the saddle of the hook
            [m].
        hook_block_limit: Rated load of the hook block [kg].
        ground: What carries the crane.
        limits: Limits of the site.
        tag_lines: How the load is kept from turning, such as "two, of 10 m".
        rigging_examined: When slings and other accessories were thoroughly examined, with the
            numbers of the reports, in words.
        exclusion: How the area below the load is kept clear, in words.
        in_zone: What is done about people and services in what stands in that area, in words, by
            the name of what stands there, or by the beginning of such names and a star.
        trial_lift: How the load is tried before it is lifted, in words.
        contingency: What is done if something goes wrong, in sentences.
        shift: What the plan of a shift says of the lift; None if it is of none.
    """

    job: Job = field(default_factory=Job)
    people: People = field(default_factory=People)
    crane: CraneDocuments = field(default_factory=CraneDocuments)
    load: LoadDetails = field(default_factory=LoadDetails)
    slings: Slings = field(default_factory=Slings)
    spreader: Spreader | None = None
    hook_block_height: float | None = None
    hook_block_limit: float | None = None
    ground: GroundDetails = field(default_factory=GroundDetails)
    limits: SiteLimits = field(default_factory=SiteLimits)
    tag_lines: str | None = None
    rigging_examined: str | None = None
    exclusion: str | None = None
    in_zone: Mapping[str, str] = field(default_factory=dict)
    trial_lift: str | None = None
    contingency: tuple[str, ...] = ()
    shift: LiftInShift | None = None

    def done_about(self, name: str) -> str | None:
        """Return what is done about something that stands in the exclusion zone, in words; None if
        nobody entered it.
        """
        for key, done in self.in_zone.items():
            if is_named(name, key):
                return done
        return None


def is_named(name: str, key: str) -> bool:
    """Return whether a key of `PlanDetails.in_zone` is the name of something, or its beginning and
    a star, such as "house*" for all parts of a building model. A beginning alone is none: "shed"
    says nothing of "shed 2".
    """
    if key.endswith("*"):
        return name.startswith(key.removesuffix("*"))
    return name == key
