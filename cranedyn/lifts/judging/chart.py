"""Load charts: the rated load of a crane by radius, number of falls and length of the boom, and the
utilisation of a run.

Between two points of a chart the rated load falls so that its moment is a straight line over the
radius, as makers' charts do. That is never more than the straight line of the loads themselves
where these fall, and never more than the load at the point before. For a maker who does not allow
interpolation the load of the larger radius counts, with `interpolation = false` in the file.

Between two lengths of the boom a chart interpolates only if its file says so; without a word the
smaller load of both counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from cranedyn import theory
from cranedyn.checks import finite, number, short_repr, whole, within
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import Misshapen, OutOfRange, UnknownName
from cranedyn.lifts.judging.boom_table import BoomColumn, read_boom_table
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

BOOM_TOLERANCE = 0.05
"""Largest difference of a boom's length from one of the chart that counts as the same [m]: makers
round lengths to decimetres."""

BetweenBooms = Literal["smaller", "linear", "none"]
"""What counts for a boom between two lengths of a chart: the smaller load of both neighbours, the
load on the straight line between theirs, or none."""

_MIN_LOAD = 1e-3
"""Least rated load of a chart [kg]."""

_MAX_LOAD = 1e9
"""Largest rated load of a chart [kg]."""


class NotCovered(OutOfRange):
    """A boom, a radius or a state of a crane about which its chart says nothing."""


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

    @classmethod
    def over_sheaves(
        cls, falls: int, friction: float, wrap: float = math.pi, drum_radius: float = 0.2
    ) -> Reeving:
        """Return the reeving whose sheaves pass on the share η = e^{-μα} of a pull each, see
        `cranedyn.theory.capstan`.

        Args:
            falls: Number of falls that carry the hook.
            friction: Coefficient of friction μ. Of a rope that slips on a drum or post it is that
                of rope and drum. A sheave turns, and loses pull in its bearing and by the bending
                of the rope: then it is the coefficient that has the same effect, -ln(η)/α, about
                0.01 for half a turn on roller bearings.
            wrap: Angle α of the rope on a sheave [rad].
            drum_radius: Radius of the drum at the rope's axis [m].

        Raises:
            OutOfRange: If a number is out of its range, or a sheave passes on less than half.
        """
        number("coefficient of friction", friction, "", ">= 0")
        within("angle of the rope on a sheave", wrap, 0.0, 4.0 * math.pi, "rad")
        return cls(falls, 1.0 / theory.capstan(friction, wrap), drum_radius)

    def friction(self, weight: float) -> float:
        """Return the dry friction that sheaves put on the hoist under a weight [N]: the argument
        `friction_hoist` of a crane.

        The drive of the hoist pulls with n F, the pull F of the line on n falls. That is more than
        the weight in hoisting and less in lowering. The friction is the mean of both differences,
        which are nearly equal; it does not follow the tension of a load that swings.

        Args:
            weight: Weight on the falls [N].

        Raises:
            OutOfRange: If the weight is not finite, or is negative.
        """
        number("weight", weight, "N", ">= 0")
        hoisting = 1.0 / theory.reeving_efficiency(self.falls, self.efficiency)
        lowering = 1.0 / theory.reeving_efficiency(self.falls, 1.0 / self.efficiency)
        return 0.5 * weight * (hoisting - lowering)

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


AT_POINT = 2e-3
"""Distance from a radius of a chart up to which its load is that of the chart [m]: what a plan may
miss a place by."""


@dataclass(frozen=True, eq=False)
class RatedLoads:
    """Rated loads of a crane by radius, for one number of falls and one length of the boom.

    Attributes:
        count: Number of falls of the rope that carry the hook.
        radii: Radii of the points of the chart, increasing [m], shape (k,).
        rated: Load that may hang there, the hook and all slings counted [kg], shape (k,).
        least: Smallest radius at which the load of the first point may hang [m].
        boom: Length of the boom from its hinge to its head [m]; None for a jib or boom of which
            there is one length.
        stepwise: Whether between two points the load of the larger radius counts, for a maker who
            does not allow interpolation.

    Raises:
        OutOfRange: If radii do not increase, loads rise with radius, or a number is outside of what
            a chart can have.
    """

    count: int
    radii: np.ndarray
    rated: np.ndarray
    least: float = 0.0
    boom: float | None = None
    stepwise: bool = False

    def __post_init__(self) -> None:
        """Check that it is a chart."""
        whole("number of falls", self.count, 1)
        if self.boom is not None:
            length = number("boom of the chart", self.boom, "m", "> 0")
            object.__setattr__(self, "boom", length)
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

    def __str__(self) -> str:
        """Return for what it is, such as "6 falls and a boom of 24 m"."""
        boom = "" if self.boom is None else f" and a boom of {self.boom:g} m"
        return f"{self.count} falls{boom}"

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
        self._refuse_outside(radius)
        if self.stepwise:
            last = len(self.radii) - 1
            next_point = np.searchsorted(self.radii, radius - AT_POINT, "left")
            return self.rated[np.minimum(next_point, last)]
        # Between two points the moment is a straight line, and the load falls from one to the next.
        # So it is never more than at the point before, but for rounding.
        moment = np.interp(radius, self.radii, self.radii * self.rated)
        point_before = np.maximum(np.searchsorted(self.radii, radius, "right") - 1, 0)
        up_to_first = radius <= self.radii[0]
        divisor = np.where(up_to_first, 1.0, radius)  # the radius may be zero there
        between = np.minimum(moment / divisor, self.rated[point_before])
        return np.where(up_to_first, self.rated[0], between)

    def at_swinging(self, radius: np.ndarray, pivot_radius: np.ndarray) -> np.ndarray:
        """Return the rated load at radii of a hook that may swing [kg], of their shape.

        A swing takes a hook beyond the last radius of the chart while its rope is still held within
        the chart: there the rated moment of the last radius counts. Where it takes the hook nearer
        than the smallest radius, the load of that one counts.

        Args:
            radius: Radii of the hook [m], shape (...).
            pivot_radius: Radii of the pivot of its rope [m], shape (...).

        Raises:
            OutOfRange: If the pivot is outside of the chart.
        """
        self._refuse_outside(np.asarray(pivot_radius, dtype=float))
        within = np.clip(radius, self.least, self.radii[-1])
        return self.at(within) * within / np.maximum(radius, within)

    def refuse_planned(self, radius: np.ndarray) -> None:
        """Refuse planned radii of a load that hangs plumb [m], shape (n,), that are outside of the
        chart by more than what a plan may miss a place by.

        Raises:
            OutOfRange: With the radius.
        """
        low = self.least - AT_POINT
        high = self.radii[-1] + AT_POINT
        if float(np.min(radius)) < low or float(np.max(radius)) > high:
            self._refuse_outside(np.asarray(radius, dtype=float))

    def _refuse_outside(self, radius: np.ndarray) -> None:
        """Refuse radii outside of the chart [m], shape (...).

        Raises:
            OutOfRange: With the first of them.
        """
        outside = ~((radius >= self.least) & (radius <= self.radii[-1]))
        if outside.any():
            name = f"radius on {self}"
            worst = f"{radius[outside].flat[0]:.6g}"
            allowed = f"{self.least:g} to {self.radii[-1]:g}, where the chart is"
            raise OutOfRange(name, worst, allowed, "m")

    def points_about(self, radius: float) -> tuple[float, float] | None:
        """Return the radii of the two points between which the load of a radius is interpolated
        [m]; None at a point of the chart, between points of the same load, outside of all, and
        without interpolation.
        """
        if self.stepwise or not self.radii[0] < radius < self.radii[-1]:
            return None
        after = int(np.searchsorted(self.radii, radius))
        near = np.abs(self.radii - radius).min() <= AT_POINT
        if near or self.rated[after - 1] == self.rated[after]:
            return None
        return float(self.radii[after - 1]), float(self.radii[after])


class LengthsAbout(NamedTuple):
    """Rated loads of lengths of the boom about one; None where the chart has none.

    Attributes:
        shorter: Of the next shorter length.
        same: Of the same length.
        longer: Of the next longer length.
    """

    shorter: RatedLoads | None
    same: RatedLoads | None
    longer: RatedLoads | None


@dataclass(frozen=True, eq=False)
class Chart:
    """A crane's rated loads.

    Attributes:
        name: The crane and its jib.
        source: Where its numbers are from.
        reevings: Rated loads for each number of falls, the fewest first, and of one number for each
            length of the boom, the shortest first.
        between_booms: What counts for a boom between two lengths of the chart.
        counterweight: Counterweight for which the chart is made [kg]; None if it does not say.
        outriggers: Distance of neighbouring outriggers for which it is made [m]; None if it does
            not say, or the crane has none.
        interpolation: Whether loads between two radii may be interpolated; else the load of the
            next larger radius counts.
        example: Whether its numbers are an example and of no real crane.
    """

    name: str
    source: str
    reevings: tuple[RatedLoads, ...]
    between_booms: BetweenBooms = "smaller"
    counterweight: float | None = None
    outriggers: float | None = None
    interpolation: bool = True
    example: bool = False

    @property
    def counts(self) -> list[int]:
        """The numbers of falls, the fewest first."""
        return sorted({reeving.count for reeving in self.reevings})

    def of_falls(self, falls: int | None = None) -> list[RatedLoads]:
        """Return the rated loads on a number of falls, those of the shortest boom first; None for
        the fewest.

        Raises:
            UnknownName: If the chart has no such number of falls.
        """
        count = self.counts[0] if falls is None else falls
        found = [reeving for reeving in self.reevings if reeving.count == count]
        if not found:
            names = [str(known) for known in self.counts]
            raise UnknownName("number of falls", short_repr(falls), names)
        return found

    def booms(self, falls: int | None = None) -> list[float]:
        """Return the lengths of the boom [m] on a number of falls, the shortest first; an empty
        list if the chart does not tell lengths apart. Raises as `of_falls`.
        """
        return [one.boom for one in self.of_falls(falls) if one.boom is not None]

    def about_boom(self, falls: int | None, boom: float) -> LengthsAbout:
        """Return the rated loads of the lengths of the chart about a length of the boom [m]: of the
        same one within `BOOM_TOLERANCE`, and of the next shorter and longer ones. Raises as
        `of_falls`.
        """
        shorter = same = longer = None
        for reeving in self.of_falls(falls):
            if reeving.boom is None:
                continue
            if reeving.boom < boom - BOOM_TOLERANCE:
                shorter = reeving
            elif reeving.boom <= boom + BOOM_TOLERANCE:
                same = reeving
            elif longer is None:
                longer = reeving
        return LengthsAbout(shorter, same, longer)

    def on(self, falls: int | None = None, boom: float | None = None) -> RatedLoads:
        """Return the rated loads on a number of falls with a length of the boom.

        Between two lengths of the chart they are for the radii that both have; `between_booms` says
        which load counts.

        Args:
            falls: Number of falls; None for the fewest.
            boom: Length of the boom [m]; it counts only for a chart that tells lengths apart.

        Raises:
            UnknownName: If the chart has no such number of falls.
            NotCovered: If the chart tells lengths apart, and does not cover this one.
        """
        found = self.of_falls(falls)
        lengths = self.booms(falls)
        if not lengths:
            return found[0]
        called = f"length of the boom on {found[0].count} falls"
        listed = ", ".join(f"{length:g}" for length in lengths)
        if boom is None:
            raise NotCovered(called, "not known", f"one of the chart: {listed} m")
        near = self.about_boom(falls, boom)
        if near.same is not None:
            return near.same
        if near.shorter is not None and near.longer is not None and self.between_booms != "none":
            return _between(near.shorter, near.longer, boom, self.between_booms)
        allowed = f"{lengths[0]:g} to {lengths[-1]:g}, where the chart is"
        if self.between_booms == "none":
            allowed = f"{listed}: the chart has no loads for lengths between these"
        raise NotCovered(called, f"{boom:.6g}", allowed, "m")


def _between(
    shorter: RatedLoads, longer: RatedLoads, boom: float, between: BetweenBooms
) -> RatedLoads:
    """Return the rated loads of a boom between two lengths of a chart, at the radii of both.

    Between two of these points the moments of both lengths are straight lines, and the smaller one
    of both is concave. So the straight line of the moment that counts is nowhere above it.

    Raises:
        NotCovered: If both have no radius in common.
    """
    least = max(shorter.least, longer.least)
    last = min(float(shorter.radii[-1]), float(longer.radii[-1]))
    if least > last:
        raise NotCovered(
            "length of the boom",
            f"{boom:.6g} m, between {shorter.boom:g} and {longer.boom:g} m",
            "a length of the chart: both neighbours have loads at no radius in common",
        )
    points = np.union1d(shorter.radii, longer.radii)
    points = points[(points >= least) & (points <= last)]
    radii = np.union1d(points, [least, last] if least > 0.0 else [last])
    of_shorter = shorter.at(radii)
    of_longer = longer.at(radii)
    rated = np.minimum(of_shorter, of_longer)
    if between == "linear":
        assert shorter.boom is not None and longer.boom is not None
        share = (boom - shorter.boom) / (longer.boom - shorter.boom)
        rated = (1.0 - share) * of_shorter + share * of_longer
    # Both fall with the radius, but for round-off.
    rated = np.minimum.accumulate(rated)
    return RatedLoads(shorter.count, radii, rated, least, boom, shorter.stepwise)


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
    that hangs, dynamics included, over the rated weight at the radius of the hook.

    Args:
        loads: Loads of the run. Of a crane that does not slew, such as an overhead crane, the chart
            must give one load.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        gravity: Gravity for which the chart is made [m/s²].

    Raises:
        UnknownName: If the chart has no such number of falls.
        NotCovered: If the chart tells lengths of the boom apart, and does not cover that of the
            run, the boom changes its length during the run, or no length of the chart has the
            radius.
        OutOfRange: If the rope's upper end leaves the radii of the chart, the pull is not finite,
            gravity is outside of `GRAVITY`, or the crane does not slew and the chart has loads by
            radius.
        UnknownColumn: If the loads are those of a crane without a hoist.
    """
    within("gravity", gravity, *GRAVITY, "m/s²")
    pull = finite("pull of what hangs", loads["pull_N"], ("rows",), unit="N")
    reeving = reeving_of_run(loads, chart, falls)
    radius = loads.values.get("radius_m")
    if radius is None:  # it does not slew
        return pull / (gravity * reeving.constant)
    pivot_radius = loads.values.get("pivot_radius_m", radius)
    if reeving.boom is not None:
        _refuse_radii_of_no_boom(chart, reeving.count, pivot_radius)
    return pull / (gravity * reeving.at_swinging(radius, pivot_radius))


def refuse_planned_radii(
    radius: np.ndarray, loads: Loads, chart: Chart, falls: int | None = None
) -> None:
    """Refuse a plan that takes a load out of the radii of the chart.

    Args:
        radius: Radii of the load that hangs plumb at all places of the plan [m], shape (n,).
        loads: Loads of its run.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.

    Raises:
        NotCovered: If no length of the boom has such a radius, or as `utilisation`.
        OutOfRange: If the chart does not have it for this boom.
    """
    reeving = reeving_of_run(loads, chart, falls)
    try:
        reeving.refuse_planned(radius)
    except OutOfRange:
        if reeving.boom is not None:
            _refuse_radii_of_no_boom(chart, reeving.count, radius)
        raise


def reeving_of_run(loads: Loads, chart: Chart, falls: int | None) -> RatedLoads:
    """Return the rated loads of a run, on its falls and for the boom that it has.

    Raises:
        NotCovered: If the chart has none, or the boom telescopes during the run.
    """
    return chart.on(falls, _boom_of_run(loads, chart, falls))


def _boom_of_run(loads: Loads, chart: Chart, falls: int | None) -> float | None:
    """Return the length of the boom during a run [m]; None if the chart does not ask for it, or it
    is not known.

    Raises:
        NotCovered: If the boom telescopes during the run. What may hang then is in another table of
            the maker's, and mostly far less.
    """
    lengths = loads.values.get("boom_m")
    if lengths is None or not chart.booms(falls):
        return None
    shortest = float(lengths.min())
    longest = float(lengths.max())
    if longest - shortest > BOOM_TOLERANCE:
        raise NotCovered(
            "length of the boom",
            f"{shortest:.6g} to {longest:.6g}",
            "one length during a run, since the chart is not for telescoping under load",
            "m",
        )
    return (shortest + longest) / 2.0


def _refuse_radii_of_no_boom(chart: Chart, falls: int, radius: np.ndarray) -> None:
    """Refuse radii at which the chart has a load for no length of the boom.

    At a radius that other lengths have, what is missing is a field that the maker leaves empty: no
    load is permitted there, see `RatedLoads.at`.

    Raises:
        NotCovered: With the radius that is farthest outside.
    """
    found = chart.of_falls(falls)
    low = min(reeving.least for reeving in found)
    high = max(float(reeving.radii[-1]) for reeving in found)
    smallest = float(np.min(radius))
    largest = float(np.max(radius))
    if smallest >= low and largest <= high:
        return
    worst = smallest if low - smallest > largest - high else largest
    raise NotCovered(
        f"radius on {falls} falls",
        f"{worst:.6g}",
        f"{low:g} to {high:g}, where the chart is for any boom",
        "m",
    )


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

    For a boom of several lengths there is a table `[[falls]]` for each length with `boom` [m], or
    one with `table`, a CSV file in the folder of the chart, see
    `cranedyn.lifts.judging.boom_table`, and its `unit`, "kg" or "t". The file may also have
    `between_booms`, see `BetweenBooms`, `counterweight` [kg], `outriggers` [m], `interpolation` and
    `example`, see `Chart`.

    Raises:
        DataError: If it cannot be read, is no TOML, or something in it is missing, unknown or not
            possible in a chart; with line, table and field.
        UnknownName: If there is no file and no example of that name.
    """
    path = example_path(path, CHARTS, CHART_EXAMPLES, "chart")
    top, lines = read_fields(path, [*_TOP_FIELDS, "falls"], "chart")
    for name in ("name", "source", "falls"):
        if name not in top.values:
            top.fail(name, "it is missing.")
    entries = top.tables("falls", _FALLS_FIELDS, lines)
    if not 1 <= len(entries) <= _MAX_POINTS:
        allowed = f"allowed are 1 to {_MAX_POINTS} tables [[falls]]."
        top.fail("falls", f"there are {len(entries)}; {allowed}")
    reevings: list[RatedLoads] = []
    for entry in entries:
        for reeving in _falls(entry):
            _refuse_second(entry, reeving, reevings)
            reevings.append(reeving)
    reevings.sort(key=lambda reeving: (reeving.count, reeving.boom or 0.0))
    between = top.choice("between_booms", get_args(BetweenBooms), "smaller", "rule")
    interpolates = "interpolation" not in top.values or top.flag("interpolation")
    if not interpolates:
        if between == "linear":
            top.fail("between_booms", '"linear" interpolates, which interpolation = false forbids.')
        reevings = [replace(reeving, stepwise=True) for reeving in reevings]
    return Chart(
        top.text("name"),
        top.text("source"),
        tuple(reevings),
        between,  # type: ignore[arg-type]
        top.optional_number("counterweight", "kg", ">= 0"),
        top.optional_number("outriggers", "m", "> 0"),
        interpolation=interpolates,
        example=top.flag("example"),
    )


_TOP_FIELDS = ("source", "between_booms", "counterweight", "outriggers", "interpolation", "example")
"""Fields of a chart beside its name and its tables [[falls]]."""

_FALLS_FIELDS = ("count", "boom", "radii", "loads", "least", "rated", "table", "unit")
"""Fields of a table [[falls]]."""


def _refuse_second(entry: SiteTable, reeving: RatedLoads, others: Sequence[RatedLoads]) -> None:
    """Refuse rated loads for falls and a boom of which there are some already.

    Raises:
        DataError: With the line of the table [[falls]].
    """
    for other in others:
        if reeving.count != other.count:
            continue
        falls = f"{reeving.count} falls"
        if reeving.boom is None and other.boom is None:
            entry.fail("count", f"another [[falls]] has {falls}, too; leave one out.")
        if reeving.boom is None or other.boom is None:
            entry.fail("count", f"one [[falls]] of {falls} has a boom and another one none.")
        if abs(reeving.boom - other.boom) <= 2.0 * BOOM_TOLERANCE:
            entry.fail(
                "boom" if "boom" in entry.values else "table",
                f"{reeving.boom:g} m and {other.boom:g} m are two lengths on {falls} that are less "
                f"than {2.0 * BOOM_TOLERANCE:g} m apart; leave one out.",
            )


def _falls(entry: SiteTable) -> list[RatedLoads]:
    """Return the rated loads of a table [[falls]]: one, or one for each boom of a CSV file.

    Raises:
        DataError: If a field is missing or not possible in a chart, with its line and field.
    """
    values = dict(entry.values)
    if "table" in values:
        reason = "table is given, too, which has the loads; leave one out."
        _refuse_fields(entry, ("boom", "radii", "loads", "least", "rated"), reason)
        return _of_table(entry)
    _refuse_fields(entry, ("unit",), "it is for loads of a table; those of this file are in kg.")
    if "rated" in values:
        reason = "rated is given, too, one load for all radii; leave one out."
        _refuse_fields(entry, ("radii", "loads", "least"), reason)
        values["radii"] = [ANY_RADIUS]
        values["loads"] = [entry.number("rated", unit="kg", allowed="> 0")]
    for name in ("count", "radii", "loads"):
        if name not in values:
            entry.fail(name, "it is missing.")
    boom = entry.optional_number("boom", "m", "> 0")
    try:
        least = values.get("least", 0.0)
        return [RatedLoads(values["count"], values["radii"], values["loads"], least, boom)]
    except OutOfRange as error:
        entry.fail(_field_of(error), error)


def _refuse_fields(entry: SiteTable, names: Sequence[str], reason: str) -> None:
    """Refuse fields of a table for a reason, as far as it has them.

    Raises:
        DataError: With the line of the first one that it has.
    """
    for name in names:
        if name in entry.values:
            entry.fail(name, reason)


def _of_table(entry: SiteTable) -> list[RatedLoads]:
    """Return the rated loads of the CSV file that a table [[falls]] names, for each boom.

    Raises:
        DataError: If the file is no such table, with its line, or a field is not possible.
    """
    count = entry.whole("count")
    units = {"kg": 1.0, "t": 1e3}
    unit = entry.choice("unit", tuple(units), "kg")
    columns = read_boom_table(entry.file("table"))
    return [_of_column(entry, count, column, units[unit]) for column in columns]


def _of_column(entry: SiteTable, count: int, column: BoomColumn, unit: float) -> RatedLoads:
    """Return the rated loads of a column of a CSV file, whose loads are in a unit [kg]."""
    loads = [unit * load for load in column.loads]
    try:
        # Nothing is known of radii below the first one with a load.
        return RatedLoads(count, column.radii, loads, column.radii[0], column.boom)  # type: ignore[arg-type]
    except OutOfRange as error:
        entry.fail("table", f"in the column of the boom of {column.boom:g} m: {error}")


def _field_of(error: OutOfRange) -> str:
    """Return the field of a table [[falls]] that an error of `RatedLoads` is about."""
    fields = {
        "number of falls": "count",
        "number of loads": "loads",
        "load": "loads",
        "smallest radius": "least",
        "boom": "boom",
    }
    for beginning, field in fields.items():
        if error.name.startswith(beginning):
            return field
    return "radii"
