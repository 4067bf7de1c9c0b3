"""Load charts: the rated load of a crane by radius and number of falls, and the utilisation of a
run.

Between two points of a chart the rated load falls so that its moment is a straight line over the
radius, as makers' charts do. That is never more than the straight line of the loads themselves
where these fall, and never more than the load at the point before.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.checks import finite, number, short_repr, whole, within
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import Misshapen, OutOfRange, UnknownName
from cranedyn.lifts.judging.loads import Loads, loads
from cranedyn.lifts.planning.site_file import CHART_EXAMPLES, example_path, read_fields
from cranedyn.lifts.planning.site_table import SiteTable
from cranedyn.model.crane import STANDARD_GRAVITY, Crane

CHARTS = Path(__file__).parent / "charts"
"""Folder of the example charts."""

GRAVITY = (1e-3, 1e3)
"""Least and largest gravity that a utilisation is computed for [m/s²]: about that of a small moon
and that of a star."""

WARNING = 0.9
"""Utilisation at which a load moment limiter warns."""

CUT_OUT = 1.0
"""Utilisation at which a load moment limiter stops what makes it worse."""

_MAX_POINTS = 1000
"""Largest number of points of a reeving, and of reevings of a chart."""

_MAX_RADIUS = 1e4
"""Largest radius of a chart [m]."""

ANY_RADIUS = _MAX_RADIUS
"""Radius of the only point of a chart that gives one load for all radii [m]."""

_MIN_LOAD = 1e-3
"""Least rated load of a chart [kg]."""

_MAX_LOAD = 1e9
"""Largest rated load of a chart [kg]."""


@dataclass(frozen=True)
class Reeving:
    """How the rope of a hoist runs: falls, sheaves and drum.

    Attributes:
        falls: Number of falls that carry the hook.
        efficiency: Efficiency of a sheave.
        drum_radius: Radius of the drum at the rope's axis [m].

    Raises:
        OutOfRange: If the falls are no whole number, or a number is out of its range.
    """

    falls: int
    efficiency: float = 0.98
    drum_radius: float = 0.2

    def __post_init__(self) -> None:
        """Check the numbers."""
        whole("number of falls", self.falls, 1)
        number("efficiency of a sheave", self.efficiency, "", "0.5 to 1")
        number("radius of the drum", self.drum_radius, "m", "> 0")

    def line_pull(self, tension: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the pull of the line on the drum [N] from the tension of all falls together [N]
        and the rate of the cable length [m/s], shape (rows,) each.

        Sheaves resist hoisting, a rate below 0, and hold back in lowering; at rest all falls pull
        alike. Raises `OutOfRange` if a number is not finite.
        """
        tension = finite("tension", tension, ("rows",))
        rate = finite("rate", rate, ("rows",))
        hoisting = theory.reeving_efficiency(self.falls, self.efficiency)
        # In lowering the load drives the sheaves, each of which passes on 1/η of its pull.
        lowering = theory.reeving_efficiency(self.falls, 1.0 / self.efficiency)
        share = np.where(rate < 0.0, hoisting, np.where(rate > 0.0, lowering, 1.0))
        return tension / (self.falls * share)

    def columns(self, crane: Crane, run: Trajectory) -> dict[str, np.ndarray]:
        """Return pull, torque on the drum and speed of the line, hoisting positive, of each row of
        a run; raises as `cranedyn.lifts.judging.loads.loads`, and `MissingRole` without a hoist.
        """
        rate = run.v[:, crane.layout.role("hoist", "The pull of the line")]
        line = self.line_pull(loads(crane, run)["rope_N"], rate)
        return {"line_N": line, "drum_Nm": self.drum_radius * line, "line_m_s": -self.falls * rate}

    def capacity(self, line_pull: float, gravity: float) -> float:
        """Return the load that a largest pull of the line hoists [kg], to which a chart is limited
        at small radii.

        Args:
            line_pull: Largest pull of the line [N].
            gravity: Gravity [m/s²].

        Raises:
            OutOfRange: If a number is not finite or not positive, or gravity is outside of
                `GRAVITY`.
        """
        number("pull of the line", line_pull, "N", "> 0")
        within("gravity", gravity, *GRAVITY, "m/s²")
        efficiency = theory.reeving_efficiency(self.falls, self.efficiency)
        return line_pull * self.falls * efficiency / gravity


@dataclass(frozen=True, eq=False)
class RatedLoads:
    """Rated loads of a crane by radius, for one number of falls.

    Attributes:
        count: Number of falls of the rope that carry the hook.
        radii: Radii of the points of the chart, increasing [m], shape (k,).
        rated: Load that may hang there, the hook and all slings counted [kg], shape (k,).
        least: Smallest radius at which the load of the first point may hang [m].

    Raises:
        OutOfRange: If radii do not increase, loads rise with radius, or a number is outside of what
            a chart can have.
    """

    count: int
    radii: np.ndarray
    rated: np.ndarray
    least: float = 0.0

    def __post_init__(self) -> None:
        """Check that it is a chart."""
        whole("number of falls", self.count, 1)
        radii = finite("radii", self.radii, ("k",), unit="m", meaning="a list of numbers [m]")
        rated = finite("loads", self.rated, ("k",), unit="kg", meaning="a list of numbers [kg]")
        if len(rated) != len(radii):
            numbers = f"{len(rated)} for {len(radii)} radii"
            raise Misshapen("number of loads", numbers, "one load for each radius")
        object.__setattr__(self, "radii", radii)
        object.__setattr__(self, "rated", rated)
        if not 1 <= len(radii) <= _MAX_POINTS:
            raise OutOfRange("radii", f"{len(radii)} points", f"1 to {_MAX_POINTS}")
        least = number("smallest radius", self.least, "m", f"0 to {radii[0]:g}")
        object.__setattr__(self, "least", least)
        for i in np.flatnonzero(np.diff(radii) <= 0.0).tolist():
            order = f"{radii[i + 1]:g} m after {radii[i]:g} m"
            raise OutOfRange("radius of a point", order, "more than the one before")
        for radius, load in zip(radii, rated, strict=True):
            within("radius of a point", float(radius), 0.0, _MAX_RADIUS, "m")
            within(f"load at {radius:g} m", float(load), _MIN_LOAD, _MAX_LOAD, "kg")
        for i in np.flatnonzero(np.diff(rated) > 0.0).tolist():
            raise OutOfRange(
                f"load at {radii[i + 1]:g} m",
                f"{rated[i + 1]:g} kg after {rated[i]:g} kg at {radii[i]:g} m",
                "no more than at a smaller radius",
            )

    @property
    def constant(self) -> float:
        """The rated load of a crane that does not slew, the same wherever it is [kg].

        Raises:
            OutOfRange: If the chart gives loads by radius.
        """
        if self.radii[-1] != ANY_RADIUS:
            raise OutOfRange(
                f"chart on {self.count} falls",
                "loads by radius",
                "one load, rated, since this crane does not slew and has no radius",
            )
        return float(self.rated[0])

    def at(self, radius: np.ndarray | float) -> np.ndarray:
        """Return the rated load at radii [kg], of their shape.

        Raises:
            OutOfRange: If a radius is outside of the chart.
        """
        radius = np.asarray(radius, dtype=float)
        outside = ~((radius >= self.least) & (radius <= self.radii[-1]))
        if outside.any():
            name = f"radius on {self.count} falls"
            worst = f"{radius[outside].flat[0]:.6g}"
            allowed = f"{self.least:g} to {self.radii[-1]:g}, where the chart is"
            raise OutOfRange(name, worst, allowed, "m")
        # Between two points the moment is a straight line, and the load falls from one to the next.
        # So it is never more than at the point before, but for rounding.
        moment = np.interp(radius, self.radii, self.radii * self.rated)
        point_before = np.maximum(np.searchsorted(self.radii, radius, "right") - 1, 0)
        up_to_first = radius <= self.radii[0]
        divisor = np.where(up_to_first, 1.0, radius)  # the radius may be zero there
        between = np.minimum(moment / divisor, self.rated[point_before])
        return np.where(up_to_first, self.rated[0], between)


@dataclass(frozen=True, eq=False)
class Chart:
    """A crane's rated loads.

    Attributes:
        name: The crane and its jib.
        source: Where its numbers are from.
        reevings: Rated loads for each number of falls, the fewest first.
    """

    name: str
    source: str
    reevings: tuple[RatedLoads, ...]

    def on(self, falls: int | None = None) -> RatedLoads:
        """Return the rated loads on a number of falls; None for the fewest.

        Raises:
            UnknownName: If the chart has no such number of falls.
        """
        for reeving in self.reevings:
            if falls is None or reeving.count == falls:
                return reeving
        counts = [str(reeving.count) for reeving in self.reevings]
        raise UnknownName("number of falls", short_repr(falls), counts)


class CutOut(NamedTuple):
    """An interval in which a load moment limiter would act.

    Attributes:
        t: When it begins [s].
        ends: When it ends, or the run [s].
        kind: "warning" or "cut-out".
        most: Largest utilisation in it.
    """

    t: float
    ends: float
    kind: str
    most: float


def utilisation(
    loads: Loads, chart: Chart, falls: int | None = None, *, gravity: float = STANDARD_GRAVITY
) -> np.ndarray:
    """Return the utilisation of the rated load moment in each row, shape (rows,): the pull of all
    that hangs, dynamics included, over the rated weight at that radius.

    Args:
        loads: Loads of the run. Of a crane that does not slew, such as an overhead crane, the chart
            must give one load.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        gravity: Gravity for which the chart is made [m/s²].

    Raises:
        UnknownName: If the chart has no such number of falls.
        OutOfRange: If the trolley leaves the radii of the chart, the pull is not finite, gravity is
            outside of `GRAVITY`, or the crane does not slew and the chart has loads by radius.
        UnknownColumn: If the loads are those of a crane without a hoist.
    """
    within("gravity", gravity, *GRAVITY, "m/s²")
    pull = finite("pull of what hangs", loads["pull_N"], ("rows",), unit="N")
    reeving = chart.on(falls)
    radius = loads.values.get("radius_m")
    if radius is None:  # it does not slew
        return pull / (gravity * reeving.constant)
    return pull / (gravity * reeving.at(radius))


def cut_outs(t: np.ndarray, used: np.ndarray) -> list[CutOut]:
    """Return where a load moment limiter would act, in the order of time: a warning from 90 %, a
    cut-out from 100 % on.

    Args:
        t: Times [s], shape (rows,).
        used: Utilisation, shape (rows,).

    Raises:
        OutOfRange: If an array has another shape, or a number is not finite.
    """
    t = finite("t", t, ("rows",), unit="s")
    used = finite("utilisation", used, t.shape)
    intervals = []
    for kind, limit in (("warning", WARNING), ("cut-out", CUT_OUT)):
        # Rows at which the utilisation passes the limit, in turn upwards and downwards.
        edges = np.flatnonzero(np.diff(used >= limit, prepend=False, append=False))
        for first, end in edges.reshape(-1, 2).tolist():
            ends = float(t[min(end, len(t) - 1)])
            intervals.append(CutOut(float(t[first]), ends, kind, float(used[first:end].max())))
    return sorted(intervals)


def assess_run(
    crane: Crane, run: Trajectory, chart: Chart, falls: int | None = None
) -> tuple[np.ndarray, list[CutOut]]:
    """Return the utilisation of a run and where a limiter would act, see `utilisation` and
    `cut_outs`.
    """
    used = utilisation(loads(crane, run), chart, falls, gravity=crane.gravity)
    return used, cut_outs(run.t, used)


def read_chart(path: str | Path) -> Chart:
    """Read a chart from a TOML file, or the example chart of that name.

    The file has `name`, `source`, and a table `[[falls]]` for each reeving with `count`,
    `radii` [m], `loads` [kg] and, as an option, `least` [m]. Instead of radii and loads it may have
    one load for all radii, `rated` [kg], as an overhead crane has.

    Raises:
        DataError: If it cannot be read, is no TOML, or something in it is missing, unknown or not
            possible in a chart; with line, table and field.
        UnknownName: If there is no file and no example of that name.
    """
    path = example_path(path, CHARTS, CHART_EXAMPLES, "chart")
    top, lines = read_fields(path, ["source", "falls"], "chart")
    for name in ("name", "source", "falls"):
        if name not in top.values:
            top.fail(name, "it is missing.")
    entries = top.tables("falls", ("count", "radii", "loads", "least", "rated"), lines)
    if not 1 <= len(entries) <= _MAX_POINTS:
        allowed = f"allowed are 1 to {_MAX_POINTS} tables [[falls]]."
        top.fail("falls", f"there are {len(entries)}; {allowed}")
    reevings: list[RatedLoads] = []
    for entry in entries:
        reeving = _falls(entry)
        if any(reeving.count == other.count for other in reevings):
            entry.fail("count", f"another [[falls]] has {reeving.count} falls, too; leave one out.")
        reevings.append(reeving)
    reevings.sort(key=lambda reeving: reeving.count)
    return Chart(top.text("name"), top.text("source"), tuple(reevings))


def _falls(entry: SiteTable) -> RatedLoads:
    """Return the rated loads of a table [[falls]].

    Raises:
        DataError: If a field is missing or not possible in a chart, with its line and field.
    """
    values = dict(entry.values)
    if "rated" in values:
        for name in ("radii", "loads", "least"):
            if name in values:
                entry.fail(name, "rated is given, too, one load for all radii; leave one out.")
        values["radii"] = [ANY_RADIUS]
        values["loads"] = [entry.number("rated", unit="kg", allowed="> 0")]
    for name in ("count", "radii", "loads"):
        if name not in values:
            entry.fail(name, "it is missing.")
    try:
        return RatedLoads(
            values["count"], values["radii"], values["loads"], values.get("least", 0.0)
        )
    except OutOfRange as error:
        entry.fail(_field_of(error), error)


def _field_of(error: OutOfRange) -> str:
    """Return the field of a table [[falls]] that an error of `RatedLoads` is about."""
    fields = {
        "number of falls": "count",
        "number of loads": "loads",
        "load": "loads",
        "smallest radius": "least",
    }
    for beginning, field in fields.items():
        if error.name.startswith(beginning):
            return field
    return "radii"
