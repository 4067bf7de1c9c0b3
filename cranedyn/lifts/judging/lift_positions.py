"""Where the load is picked up, is farthest out and is set down, with the rated load there; and the
category of the lift that follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.chart import reeving_of_run
from cranedyn.lifts.judging.loads import hanging_mass
from cranedyn.lifts.judging.numbered_positions import end_names, loads_at_rest
from cranedyn.lifts.planning.plan_assumptions import in_words

CATEGORIES = ("routine", "intermediate", "complex", "critical")
"""Categories of a lift, the lightest first."""

MAX_NAMED = 12
"""Most things that stand in the exclusion zone and are named one by one."""

SHARE_RULES = (
    (0.90, "critical"),
    (0.80, "complex"),
    (0.75, "intermediate"),
)
"""Share of the rated load above which a lift is of a category, the highest first. Public guides to
LOLER 1998, BS 7121 and ASME P30.1 name these shares, and differ in what they call by them; read
second hand."""


@dataclass(frozen=True)
class LiftPosition:
    """A place of the load in a lift.

    Attributes:
        name: What happens there, such as "pick-up".
        t: Time at which the load is there [s].
        place: The place of the load in the frame of the site [m], shape (3,).
        radius: Distance of the hook in plan from the slew axis [m]; None for a crane that does
            not slew.
        rated: Rated load there [kg]; None without a chart that reaches all places of the lift.
        gross: Mass of all that hangs [kg].
        wheel: Largest force of a wheel on its rail there [N]; None for a crane without wheels.
    """

    name: str
    t: float
    place: np.ndarray
    radius: float | None
    rated: float | None
    gross: float
    wheel: float | None = None

    @property
    def share(self) -> float | None:
        """Gross load over the rated load, at rest; None if that is not known."""
        return None if self.rated is None else self.gross / self.rated


def lift_positions(analysis: LiftAnalysis) -> list[LiftPosition]:
    """Return pick-up, largest radius and set-down of a lift in the order of time. A load that
    stands is picked up from its support and set down on one, and hangs above both before and after
    the planned motion: these are positions, too. For a crane that does not slew the place at which
    a wheel presses most takes the place of the largest radius; it is left out if the wheels are not
    known either.
    """
    rows = np.arange(len(analysis.loads.t))[analysis.hangs]
    first = int(rows[0])
    last = int(rows[-1])
    first_name, last_name = end_names(analysis)
    named = [(first_name, first)]
    radius = analysis.loads.values.get("radius_m")
    wheels = largest_wheel_force(analysis)
    if radius is not None:
        named.append(("largest radius", int(rows[radius[rows].argmax()])))
    elif wheels is not None:
        named.append(("largest wheel force", int(rows[wheels[rows].argmax()])))
    named.append((last_name, last))
    positions = [_position(analysis, name, row, wheels) for name, row in named]
    # The hoist alone moves between a support and the place above it: radius and rated load are
    # those of the load that hangs, since a slack rope has no utilisation to take them from.
    stands = loads_at_rest(analysis)
    if stands.pick_up is not None:
        place = stands.pick_up.centre
        positions.insert(0, replace(positions[0], name="pick-up", t=0.0, place=place))
    if stands.set_down is not None:
        place = stands.set_down.centre
        t = float(analysis.loads.t[-1])
        positions.append(replace(positions[-1], name="set-down", t=t, place=place))
    return positions


def largest_wheel_force(analysis: LiftAnalysis) -> np.ndarray | None:
    """Return the largest force of a wheel in each row [N], shape (rows,); None for a crane whose
    wheels are not known.
    """
    if "wheel_1_N" not in analysis.loads.values:
        return None
    return np.stack([analysis.loads[f"wheel_{i}_N"] for i in range(1, 5)]).max(axis=0)


def _position(
    analysis: LiftAnalysis, name: str, row: int, wheels: np.ndarray | None
) -> LiftPosition:
    """Return the place of the load in a row of the loads."""
    radii = analysis.loads.values.get("radius_m")
    radius = None if radii is None else float(radii[row])
    return LiftPosition(
        name,
        t=float(analysis.loads.t[row]),
        place=load_place(analysis, row),
        radius=radius,
        rated=_rated(analysis, row),
        gross=hanging_mass(analysis.crane),
        wheel=None if wheels is None else float(wheels[row]),
    )


def load_place(analysis: LiftAnalysis, row: int) -> np.ndarray:
    """Return where the load is in a row of the run in the frame of the site [m], shape (3,)."""
    return analysis.site.to_site(payload_position(analysis.run_crane, analysis.run.q[row]))


def _rated(analysis: LiftAnalysis, row: int) -> float | None:
    """Return the rated load that the utilisation of a row was computed with [kg]: the pull over g
    and over the utilisation. None if that is not known: without a chart, or where it does not
    reach.
    """
    if analysis.utilisation is None:
        return None
    pull = float(analysis.loads["pull_N"][row])
    return pull / (analysis.crane.gravity * float(analysis.utilisation[row]))


def interpolation(analysis: LiftAnalysis, radius: float) -> str:
    """Return between which radii of the chart the rated load of a radius [m] is interpolated, such
    as "between 20 and 21 m"; empty where it is that of a point of the chart, or is not known.
    """
    chart = analysis.chart
    if chart is None or analysis.utilisation is None:
        return ""
    reeving = reeving_of_run(analysis.loads, chart, analysis.inputs.falls)
    about = reeving.points_about(radius)
    return "" if about is None else f"between {about[0]:g} and {about[1]:g} m"


@dataclass(frozen=True)
class LiftCategory:
    """The category of a lift.

    Attributes:
        name: One of `CATEGORIES`; None if the share of the rated load is not known and nothing else
            makes it a higher one.
        rules: What made it so, in sentences.
        not_entered: What could make it a higher category and nobody entered, in words.
        not_judged: What could make it a higher category and is not judged, in words.
        answered_no: What could make it a higher category and is not so, as somebody entered.
    """

    name: str | None
    rules: tuple[str, ...]
    not_entered: tuple[str, ...]
    not_judged: tuple[str, ...] = ()
    answered_no: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The category in words: "at least" where something that could raise it is not known."""
        if self.name is None:
            return "not judged"
        is_highest = self.name == CATEGORIES[-1]
        is_open = bool(self.not_entered or self.not_judged)
        return f"at least {self.name}" if is_open and not is_highest else self.name


def lift_category(analysis: LiftAnalysis, in_zone: Sequence[str] = ()) -> LiftCategory:
    """Return the category of a lift: the highest that one of these rules gives.

    Args:
        analysis: The lift.
        in_zone: Names of what stands in its exclusion zone, where people or services may be. That
            is not judged unless the site says what is done about each.

    * The share of the rated load that the gross load takes at rest, see `SHARE_RULES`.
    * Over people or a public way it is critical, over services complex.
    * If the operator does not see the load all the way, it is complex.

    Two cranes at one load make a lift critical, too; such a lift is not judged by this program.
    """
    found: list[tuple[str, str]] = []
    not_entered = []
    shares = [position.share for position in lift_positions(analysis)]
    known = [share for share in shares if share is not None]
    if known and len(known) == len(shares):
        found.append(_category_of_share(max(known)))
    else:
        not_entered.append("the share of the rated load")
    limits = analysis.site.details.limits
    answered_no = []
    for entered, category, rule, missing, otherwise in (
        (
            limits.over_people,
            "critical",
            "The load is moved over people or a public way.",
            "whether it is moved over people",
            "not over people or a public way",
        ),
        (
            limits.over_services,
            "complex",
            "The load is moved over services.",
            "whether it is moved over services",
            "not over services",
        ),
        (
            limits.blind,
            "complex",
            "The operator does not see the load all the way.",
            "whether the operator sees it all the way",
            "in the operator's sight all the way",
        ),
    ):
        if entered is None:
            not_entered.append(missing)
        elif entered:
            found.append((category, rule))
        else:
            answered_no.append(otherwise)
    highest = max((category for category, _ in found), key=CATEGORIES.index, default=None)
    return LiftCategory(
        highest,
        rules=tuple(rule for category, rule in found if category == highest),
        not_entered=tuple(not_entered),
        not_judged=tuple(_open_in_zone(analysis, in_zone)),
        answered_no=tuple(answered_no),
    )


def _open_in_zone(analysis: LiftAnalysis, in_zone: Sequence[str]) -> list[str]:
    """Return what stands in the exclusion zone and has nothing said about it, in words; empty if
    there is nothing.
    """
    details = analysis.site.details
    names = [name for name in in_zone if details.done_about(name) is None]
    if not names:
        return []
    more = len(names) - MAX_NAMED
    if more > 0:
        names = [*names[:MAX_NAMED], f"{more} more"]
    return [f"what stands in the exclusion zone ({in_words(names)})"]


def _category_of_share(share: float) -> tuple[str, str]:
    """Return the category of a share of the rated load, with its rule in a sentence."""
    used = f"The gross load is {100.0 * share:.0f} % of the rated load at most"
    for threshold, category in SHARE_RULES:
        if share > threshold:
            return category, f"{used}, more than {100.0 * threshold:.0f} %."
    lowest = SHARE_RULES[-1][0]
    return CATEGORIES[0], f"{used}, no more than {100.0 * lowest:.0f} %."
