"""Lifts compared: which crane, from which place, and which lift of a list.

A *case* is a lift of a site with a crane at a place. `cases_of` makes all combinations of site
files, places and lifts; each of them is judged, and `compared` makes its row of the judgement. A
case that is refused, such as a lift without a way, is a row with its reason, and never left out.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.data.files import read_text
from cranedyn.errors import CraneError, DataError, quoted
from cranedyn.lifts.judging.judgement import Judgement
from cranedyn.lifts.planning.site import CRANE_HEADING, Site
from cranedyn.lifts.planning.site_file import read_fields
from cranedyn.lifts.planning.site_table import SiteTable
from cranedyn.verdict import Verdict

MAX_CASES = 10_000
"""Most cases of a comparison; each takes some seconds."""

MAX_COORDINATE = 1e5
"""Largest coordinate of a place [m], as far from the origin as a site may reach."""

REFUSED = "REFUSED"
"""What stands in place of a verdict where a lift was not judged, since it was refused."""

WORD_ORDER = ("GO", "NOT COMPLETE", "NO GO", REFUSED)
"""Words of judgements in the order of a table, the best first."""

SORT_KEYS = ("share", "clearance", "time", "wind")
"""By what a table is sorted among rows of one word."""

_LARGER_IS_BETTER = ("clearance", "wind")
"""Those of `SORT_KEYS` of which a larger number is better."""


@dataclass(frozen=True)
class Place:
    """Where a crane stands on a site.

    Attributes:
        x: Its foot [m].
        y: Its foot [m].
        heading: Heading [degrees] as the site file enters it: `heading` of a tower crane, `yaw` of
            another one; None for that of the file.
    """

    x: float
    y: float
    heading: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("x", "y"):
            value = number(f"{name} of a position", getattr(self, name), "m")
            if abs(value) > MAX_COORDINATE:
                allowed = f"{-MAX_COORDINATE:g} to {MAX_COORDINATE:g}"
                raise DataError(f"{name} of a position is {value:g} m; allowed is {allowed}.")
        if self.heading is not None:
            number("heading of a position", self.heading, "degrees", "-360 to 360")

    def of(self, site: Site) -> Site:
        """Return a site whose crane stands there, at the height at which it stood."""
        changes: dict[str, Any] = {"foot": np.array([self.x, self.y, site.foot[2]])}
        entered = {"[crane] position"}
        if self.heading is not None:
            is_tower = site.is_tower
            angle = math.radians(self.heading)
            changes["heading"] = angle if is_tower else CRANE_HEADING + angle
            entered.add("[crane] heading" if is_tower else "[crane] yaw")
        return replace(site, entered=site.entered | entered, **changes)


@dataclass(frozen=True)
class ComparedLift:
    """A lift of a list.

    Attributes:
        name: Its name.
        start: Where the load begins [m], three coordinates, or two where it stands on what is
            below.
        goal: Where it ends, likewise.
        load: Mass of all that hangs [kg]; None for that of the site.
    """

    name: str
    start: tuple[float, ...]
    goal: tuple[float, ...]
    load: float | None = None

    def of(self, site: Site) -> Site:
        """Return a site with this lift."""
        changed = replace(
            site,
            start=np.array(self.start),
            goal=np.array(self.goal),
            entered=site.entered | {"[lift] from", "[lift] to"},
        )
        if self.load is None:
            return changed
        crane = {**site.crane, "payload_mass": self.load}
        return replace(changed, crane=crane, rigging={"hook": 0.0, "slings": 0.0})


@dataclass(frozen=True)
class Case:
    """A lift of a site with a crane at a place.

    Attributes:
        site: The site file, or the name of an example.
        place: Where the crane stands; None for the place of the file.
        lift: The lift; None for that of the file.
    """

    site: str
    place: Place | None = None
    lift: ComparedLift | None = None

    @property
    def crane(self) -> str:
        """What a table calls the crane: the name of the site file."""
        return Path(self.site).stem

    def change(self, site: Site) -> Site:
        """Return the site of this case, from that of its file."""
        if self.place is not None:
            site = self.place.of(site)
        return site if self.lift is None else self.lift.of(site)

    def stored(self) -> dict[str, Any]:
        """Return the case as JSON holds it."""
        return asdict(self)

    @classmethod
    def of(cls, stored: dict[str, Any]) -> Case:
        """Return a case from what `stored` returned."""
        place = stored["place"]
        lift = stored["lift"]
        if lift is not None:
            lift = {**lift, "start": tuple(lift["start"]), "goal": tuple(lift["goal"])}
        return cls(
            stored["site"],
            None if place is None else Place(**place),
            None if lift is None else ComparedLift(**lift),
        )


class ComparedCase(NamedTuple):
    """A case with what came of it.

    Attributes:
        case: The case.
        word: GO, NOT COMPLETE, NO GO or `REFUSED`.
        share: Largest share of the capacity by the chart, 1 for all of it; None if not judged.
        clearance: Least distance from an obstacle [m]; None if refused.
        time: Time of the lift [s]; None if refused.
        wind: Gust that the lift bears [m/s]; None if not judged.
        reason: Why it is no GO: the first check that fails, or else that was not judged, or why it
            was refused; empty for a GO.
        number: Number of its row in the table, from 1, by which a map names it; 0 before
            `in_order`.
    """

    case: Case
    word: str
    share: float | None = None
    clearance: float | None = None
    time: float | None = None
    wind: float | None = None
    reason: str = ""
    number: int = 0


def compared(case: Case, judgement: Judgement) -> ComparedCase:
    """Return the row of a case that was judged."""
    analysis = judgement.analysis
    share = None
    if analysis.utilisation is not None:
        share = float(analysis.utilisation.max())
    wind = None if analysis.wind is None else float(analysis.wind.limit())
    failed = [check for check in judgement.checks if check.verdict is Verdict.FAILS]
    unknown = [check for check in judgement.checks if check.verdict is Verdict.NOT_JUDGED]
    reasons = [check.sentence for check in [*failed, *unknown]]
    return ComparedCase(
        case,
        judgement.word,
        share,
        float(analysis.certificate.nearest.distance),
        float(analysis.duration),
        wind,
        reasons[0] if reasons else "",
    )


def refused(case: Case, reason: str) -> ComparedCase:
    """Return the row of a case that was refused for a reason."""
    return ComparedCase(case, REFUSED, reason=reason)


def in_order(rows: Sequence[ComparedCase], key: str = "share") -> list[ComparedCase]:
    """Return rows in the order of a table, numbered: by their words, then by a quantity, the best
    first; rows without that quantity come last among those of their word.

    Args:
        rows: The rows.
        key: One of `SORT_KEYS`.
    """

    def rank(row: ComparedCase) -> tuple[int, bool, float]:
        value = getattr(row, key)
        if value is None:
            return WORD_ORDER.index(row.word), True, 0.0
        better = -value if key in _LARGER_IS_BETTER else value
        return WORD_ORDER.index(row.word), False, better

    ranked = sorted(rows, key=rank)
    return [row._replace(number=i) for i, row in enumerate(ranked, start=1)]


# --- which cases ----------------------------------------------------------------------------------


def cases_of(
    sites: Sequence[str],
    places: Sequence[Place] = (),
    lifts: Sequence[ComparedLift] = (),
) -> list[Case]:
    """Return every combination of site files, places and lifts.

    Args:
        sites: Site files, or names of examples.
        places: Places of the crane; empty for that of each file.
        lifts: Lifts; empty for that of each file.

    Raises:
        CraneError: If two site files have one name, or there are more than `MAX_CASES`.
    """
    names = [Path(site).stem for site in sites]
    for name in names:
        if names.count(name) > 1:
            raise CraneError(
                f"Two site files are called {quoted(name)}, by which a table tells cranes apart; "
                "rename one."
            )
    all_places: Sequence[Place | None] = places or [None]
    all_lifts: Sequence[ComparedLift | None] = lifts or [None]
    count = len(sites) * len(all_places) * len(all_lifts)
    if count > MAX_CASES:
        raise CraneError(
            f"{len(sites)} site files, {len(all_places)} places and {len(all_lifts)} lifts make "
            f"{count} cases; allowed are {MAX_CASES} at most."
        )
    cases = []
    for site in sites:
        for place in all_places:
            for lift in all_lifts:
                cases.append(Case(site, place, lift))
    return cases


def places_from(text: str) -> list[Place]:
    """Return the places that an option names: a grid as "0:20:5,-10:10:3", or a file.

    Raises:
        DataError: If it is neither, or a place in it is none.
    """
    if text.endswith(".csv"):
        return _places_from_csv(Path(text))
    if text.endswith(".toml"):
        return _places_from_toml(Path(text))
    axes = text.split(",")
    if len(axes) != 2:
        raise DataError(
            f"Positions are {quoted(text)}; allowed is a file that ends in .csv or .toml, or a "
            "grid such as 0:20:5,-10:10:3, which is first:last:count of x and of y [m]."
        )
    x = _axis("x", axes[0])
    y = _axis("y", axes[1])
    if len(x) * len(y) > MAX_CASES:
        raise DataError(
            f"The grid of positions has {len(x) * len(y)} places; allowed are {MAX_CASES} at most."
        )
    places = []
    for y_value in y:
        for x_value in x:
            places.append(Place(x_value, y_value))
    return places


def _axis(name: str, text: str) -> list[float]:
    """Return the numbers of an axis of a grid, given as first:last:count or one number alone."""
    parts = text.split(":")
    if len(parts) == 1:
        return [number(f"{name} of the grid", parts[0], "m")]
    if len(parts) != 3:
        raise DataError(
            f"{name} of the grid is {quoted(text)}; allowed is first:last:count, or one number."
        )
    first = number(f"first {name} of the grid", parts[0], "m")
    last = number(f"last {name} of the grid", parts[1], "m")
    if not (parts[2].isdecimal() and 1 <= int(parts[2][:9]) <= MAX_CASES):
        raise DataError(
            f"The count of {name} of the grid is {quoted(parts[2])}; allowed is a whole number "
            f"from 1 to {MAX_CASES}."
        )
    return np.linspace(first, last, int(parts[2])).tolist()


def _places_from_csv(path: Path) -> list[Place]:
    """Return the places of a CSV file with the columns x, y and, where it has one, heading."""
    places = []
    rows = csv.reader(io.StringIO(read_text(path)))
    header = [cell.strip() for cell in next(rows, [])]
    if header not in (["x", "y"], ["x", "y", "heading"]):
        raise DataError(
            f"{path}, line 1 is {quoted(','.join(header))}; allowed is x,y or x,y,heading."
        )
    try:
        for row in rows:
            if not row:
                continue
            if len(row) != len(header):
                raise DataError(f"it has {len(row)} cells; {len(header)} are needed.")
            numbers = []
            for name, cell in zip(header, row, strict=True):
                unit = "degrees" if name == "heading" else "m"
                numbers.append(number(name, cell.strip(), unit))
            places.append(Place(*numbers))
    except (CraneError, csv.Error) as error:
        raise DataError(f"{path}, line {rows.line_num}: {error}") from None
    return _not_empty(path, places)


def _places_from_toml(path: Path) -> list[Place]:
    """Return the places of a TOML file with [[position]], each with x, y and maybe heading."""
    top, lines = read_fields(path, ["position"], "list of positions")
    places = []
    for entry in top.tables("position", ("x", "y", "heading"), lines):
        x = entry.number("x")
        y = entry.number("y")
        heading = entry.optional_number("heading", "degrees", "-360 to 360")
        try:
            places.append(Place(x, y, heading))
        except CraneError as error:
            entry.fail("x", error)
    return _not_empty(path, places)


def _not_empty(path: Path, places: list[Place]) -> list[Place]:
    """Return places of a file, of which there must be some.

    Raises:
        DataError: If there are none, or too many.
    """
    if not 1 <= len(places) <= MAX_CASES:
        raise DataError(f"{path} has {len(places)} positions; allowed are 1 to {MAX_CASES}.")
    return places


def lifts_from(path: Path) -> list[ComparedLift]:
    """Return the lifts of a TOML file with [[lift]], each with name, from, to and maybe load.

    Raises:
        DataError: If there are none, two have one name, or a field is missing, unknown or out of
            its range.
    """
    top, lines = read_fields(path, ["lift"], "list of lifts")
    lifts: list[ComparedLift] = []
    for entry in top.tables("lift", ("name", "from", "to", "load"), lines):
        name = entry.text("name")
        if any(lift.name == name for lift in lifts):
            entry.fail("name", f"two lifts are called {quoted(name)}; each needs its own name.")
        load = entry.optional_number("load", "kg", "> 0")
        lifts.append(ComparedLift(name, _end(entry, "from"), _end(entry, "to"), load))
    if not lifts:
        top.fail("lift", "there is none; write each as [[lift]].")
    return lifts


def _end(entry: SiteTable, field: str) -> tuple[float, ...]:
    """Return an end of a lift [m]: two coordinates where the load stands, three where it hangs."""
    value = entry.values.get(field)
    count = 2 if isinstance(value, list) and len(value) == 2 else 3
    return tuple(entry.numbers(field, count))
