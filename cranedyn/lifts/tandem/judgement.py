"""Judge a tandem lift by what its run shows: shares of the load, load charts, ropes, distances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number, within
from cranedyn.errors import OutOfRange
from cranedyn.lifts.tandem.clearance import tandem_distances
from cranedyn.lifts.tandem.rules import SOURCE, required_capacity
from cranedyn.lifts.tandem.simulation import TandemRun
from cranedyn.lifts.tandem.statics import static_shares
from cranedyn.verdict import Check

_TAUT = 1e-6
"""Least tension of a taut rope over its static share."""


@dataclass(frozen=True)
class TandemRequirements:
    """What is required of a tandem lift; what nobody entered is not judged.

    Attributes:
        inclination: Largest angle of a rope from plumb [rad].
        falls: Number of falls of both hooks; None for the fewest of the charts.
        distance: Required distance between what must not meet [m]; None for that of the site, if
            somebody entered it there.
    """

    inclination: float | None = None
    falls: int | None = None
    distance: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If the inclination is not from 0 to π/2, or the distance is negative.
        """
        if self.inclination is not None:
            within("inclination of a rope", self.inclination, 0.0, math.pi / 2.0, "rad")
        if self.distance is not None:
            number("required distance", self.distance, "m", ">= 0")


def judge_tandem(
    run: TandemRun, requirements: TandemRequirements = TandemRequirements()
) -> list[Check]:
    """Return the checks of a simulated tandem lift.

    Args:
        run: The run.
        requirements: What is required.
    """
    checks = []
    for crane in range(2):
        rated = _least_rated(run, crane, requirements)
        checks += [_share_check(run, crane, rated), _chart_check(run, crane, rated)]
    checks += [_taut_check(run), _inclination_check(run, requirements)]
    checks += _distance_checks(run, requirements)
    others = [
        station.name for station in run.lift.site.stations if station.name not in run.lift.names
    ]
    if others:
        named = ", ".join(others)
        checks.append(Check(f"Distances from the other cranes, {named}, are not computed.", None))
    checks.append(_wind_check(run))
    checks += [_hoist_check(run, crane) for crane in range(2)]
    checks.append(Check("Efforts of the drives other than the hoists are not computed.", None))
    return checks


def _wind_check(run: TandemRun) -> Check:
    """Return whether the lift was simulated in the wind; what it does is in all other checks."""
    if run.wind is None:
        return Check("The lift is simulated in calm air; nobody entered a wind.", None)
    strongest = float(np.abs(run["wind_m_s"]).max())
    towards = math.degrees(run.wind.direction)
    return Check(
        f"All of this is in a wind of up to {strongest:.1f} m/s that blows at {towards:g}° "
        f"from X towards Y, with a drag coefficient of {run.wind.drag:g}.",
        True,
    )


def _hoist_check(run: TandemRun, crane: int) -> Check:
    """Return whether the hoist of a crane holds the pull of its rope."""
    station = run.lift.stations[crane]
    peak = float(run.tensions[:, crane].max())
    limit = float(station.crane.effort_limit[station.crane.winch])
    sentence = f"{station.name}: its hoist holds {peak / 1e3:.1f} kN at most"
    if not math.isfinite(limit):
        return Check(f"{sentence}; its description has no limit.", None)
    return Check(f"{sentence}, of {limit / 1e3:.1f} kN that it can.", peak <= limit)


def _share_check(run: TandemRun, crane: int, rated: float | str) -> Check:
    """Return whether a crane has the additional capacity that the rule asks for.

    Args:
        run: The run.
        crane: Index of the crane.
        rated: What `_least_rated` returns for it.
    """
    lift = run.lift
    name = lift.names[crane]
    share = float(static_shares(lift.load)[crane]) * lift.load.mass
    needed = required_capacity(share)
    start = (
        f"{name}: its share of {share / 1e3:.3f} t asks for a rated load of {needed / 1e3:.3f} t"
    )
    if isinstance(rated, str):
        return Check(f"{start} ({SOURCE}); {rated}", None)
    return Check(f"{start}, and it has {rated / 1e3:.3f} t ({SOURCE}).", rated >= needed)


def _chart_check(run: TandemRun, crane: int, rated: float | str) -> Check:
    """Return whether the pull of a rope keeps within the load chart of its crane, from the same
    arguments.
    """
    lift = run.lift
    name = lift.names[crane]
    peak = float(run.tensions[:, crane].max()) / lift.gravity
    start = f"{name}: its rope pulls with {peak / 1e3:.3f} t at most"
    if isinstance(rated, str):
        return Check(f"{start}; {rated}", None)
    return Check(f"{start}, rated are {rated / 1e3:.3f} t where it is farthest out.", peak <= rated)


def _least_rated(run: TandemRun, crane: int, requirements: TandemRequirements) -> float | str:
    """Return the least rated load of a crane on the way [kg], or a sentence why there is none."""
    station = run.lift.stations[crane]
    if station.chart is None:
        return f"no load chart of {station.name} was entered."
    pivot = run.pivots(crane)[:, :2]
    radius = np.linalg.norm(pivot - np.asarray(station.foot, dtype=float)[:2], axis=1)
    try:
        return float(station.chart.on(requirements.falls).at(radius).min())
    except OutOfRange as error:
        return str(error)


def _taut_check(run: TandemRun) -> Check:
    """Return whether both ropes stay taut."""
    shares = static_shares(run.lift.load) * run.lift.load.mass * run.lift.gravity
    least = float((run.tensions / shares).min())
    return Check(
        f"Both ropes stay taut; the least tension is {least:.3f} of the static share.",
        least > _TAUT,
    )


def _inclination_check(run: TandemRun, requirements: TandemRequirements) -> Check:
    """Return whether the ropes stay near plumb."""
    largest = math.degrees(run.largest_inclination)
    sentence = f"The ropes lean by {largest:.2f}° at most"
    if requirements.inclination is None:
        return Check(f"{sentence}; nobody entered how far they may.", None)
    allowed = math.degrees(requirements.inclination)
    return Check(f"{sentence}, allowed are {allowed:g}°.", largest <= allowed)


def _distance_checks(run: TandemRun, requirements: TandemRequirements) -> Sequence[Check]:
    """Return whether nothing comes nearer than required, at the recorded rows and between them."""
    site = run.lift.site
    required = requirements.distance
    if required is None and "distance" in site.entered:
        required = site.distance
    checks = []
    for found in tandem_distances(run):
        sentence = (
            f"Between {found.between} there are {found.distance:.2f} m at least, at {found.t:.1f} s"
            f", and {found.proven:.2f} m are proven between all instants"
        )
        if required is None:
            checks.append(Check(f"{sentence}; nobody entered what is required.", None))
            continue
        least = found.required(required)
        missing = math.ceil(100.0 * (least - found.proven)) / 100.0
        remark = f": {missing:g} m are missing" if missing > 0.0 else ""
        sentence = f"{sentence}, required are {least:g} m{remark}."
        checks.append(Check(sentence, found.proven >= least))
    return checks
