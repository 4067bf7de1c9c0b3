"""What the promise of a site rests on, in one list: nothing meets as long as all of it holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cranedyn.assumptions import Assumption, Origin
from cranedyn.lifts.sites.brakes import CYCLE, REACTION
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.guard import working_swing

# In its reaction time a drive need not slow down at all. A guard that intervenes damps the swing,
# and damping that comes late by a large share of the period of a rope drives it further up: drives
# that keep their speed for 0.8 s or longer can take a rope out of its cone.
TRIED_REACTION = REACTION
"""Longest reaction time with which it was tried that guards keep ropes in their cones [s]."""

_ROUNDING = 1e-9
"""Rounding error of a reaction time [s]."""

_OfCrane = Callable[[CraneSite, Station], tuple[str, Origin]]
"""Returns what is assumed of a crane of a site, and where it comes from."""


def site_assumptions(site: CraneSite) -> list[Assumption]:
    """Return all that the promise of a site rests on.

    Cranes of which the same is assumed share an entry.
    """

    def origin(value: str) -> Origin:
        """Return whether somebody entered a value of the site, see `CraneSite.entered`."""
        return Origin.ENTERED if value in site.entered else Origin.DEFAULT

    assumptions = [
        Assumption("required distance", f"{site.distance:g} m", origin("distance")),
        Assumption("largest swing of a rope", f"{math.degrees(site.swing):.3g}°", origin("swing")),
        _wind(site),
    ]
    if site.working_wind.gust:
        gusts = "each rises and falls once, and the swing has decayed before the next"
        assumptions.append(Assumption("gusts", gusts, Origin.ASSUMED))
        assumptions += _of_cranes(site, "lightest load in the wind", _load)
        assumptions += _of_cranes(site, "swing by a gust", _swing_by_wind)
    assumptions += _of_cranes(site, "weakest brakes", _brakes)
    assumptions += _of_cranes(site, "reaction time of brakes", _reaction)
    assumptions += _of_cranes(site, "fastest drives", _drives)
    assumptions += _of_cranes(site, "ropes in their largest swing", _ropes)
    assumptions += _of_cranes(site, "error of measured positions", _tolerances)
    assumptions += _of_cranes(site, "shapes of the crane", _shapes)
    assumptions += [
        Assumption("swing of ropes", "measured without an error, with its rate", Origin.ASSUMED),
        Assumption("cycle of guards", f"{CYCLE:g} s, and none is missed", Origin.ASSUMED),
        Assumption("messages", "as late or lost as they may be, but not forged", Origin.ASSUMED),
        Assumption("clocks", "none in common; each runs forward", Origin.ASSUMED),
    ]
    return assumptions


def reacts_late(station: Station) -> bool:
    """Return whether drives of a crane may react too late for the promise that its rope stays in
    its largest swing: later than in all trials, see `TRIED_REACTION`.
    """
    return station.brakes.reaction > TRIED_REACTION + _ROUNDING


def unjudged_ropes(site: CraneSite) -> list[str]:
    """Return for each crane that reacts late, in words, that nothing is promised of its rope."""
    words = []
    for station in site.stations:
        if reacts_late(station):
            words.append(
                f"the drives of {station.name} may react only after {station.brakes.reaction:.3g} "
                "s; that a guard keeps a rope in its largest swing is tried for up to "
                f"{TRIED_REACTION:.3g} s"
            )
    return words


def _wind(site: CraneSite) -> Assumption:
    """Return up to which wind the site works; where nobody entered one, in none."""
    wind = site.working_wind
    if "wind" not in site.entered and not wind.gust:
        return Assumption("wind", "no wind", Origin.DEFAULT)
    return Assumption(
        "wind", f"{wind.gust:g} m/s in gusts, drag area {wind.area:g} m²", Origin.ENTERED
    )


def _of_cranes(site: CraneSite, name: str, assumed_of: _OfCrane) -> list[Assumption]:
    """Return what is assumed of each crane. Cranes with the same value and origin share an entry,
    which names them unless it holds for all.

    Args:
        site: The site.
        name: Name of the assumption.
        assumed_of: Returns its value, and where that comes from, for a crane.
    """
    names: dict[tuple[str, Origin], list[str]] = {}
    for station in site.stations:
        names.setdefault(assumed_of(site, station), []).append(station.name)
    assumptions = []
    for (value, origin), cranes in names.items():
        whose = "" if len(cranes) == len(site.stations) else f" of {', '.join(cranes)}"
        assumptions.append(Assumption(f"{name}{whose}", value, origin))
    return assumptions


def _origin(station: Station, value: str) -> Origin:
    """Return whether somebody entered a value of a crane, see `Station.entered`."""
    return Origin.ENTERED if value in station.entered else Origin.DEFAULT


def _per_drive(station: Station, values: np.ndarray, per: str) -> str:
    """Return a number for each drive with its unit, angles in degrees."""
    texts = []
    for joint, value in zip(station.crane.layout.driven, values, strict=True):
        turns = joint.unit == "rad"
        shown = math.degrees(value) if turns else value
        texts.append(f"{joint.role or joint.symbol} {shown:.3g} {'°' if turns else 'm'}{per}")
    return ", ".join(texts)


def _swing_by_wind(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return how far a gust swings the load, and how much of the largest swing is left."""
    by_gust = math.degrees(site.working_wind.swing(station.crane))
    left = math.degrees(working_swing(station, site.swing, site.working_wind))
    return f"{by_gust:.2g}°; {left:.2g}° are left to the drives", Origin.COMPUTED


def _brakes(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return the weakest deceleration of each drive."""
    return _per_drive(station, station.brakes.decelerations, "/s²"), _origin(station, "brakes")


def _reaction(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return the time from a measurement to full deceleration."""
    return f"{station.brakes.reaction:.3g} s", _origin(station, "reaction")


def _ropes(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return whether the guard is known to keep the rope in its largest swing."""
    if reacts_late(station):
        return "not judged, since the drives may react too late to damp a swing", Origin.COMPUTED
    return f"tried for drives that react within {TRIED_REACTION:.3g} s", Origin.ASSUMED


def _drives(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return the largest rate of each drive."""
    return _per_drive(station, station.converters.rates, "/s"), _origin(station, "drives")


def _tolerances(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return the largest error of the measured position of each drive."""
    return _per_drive(station, station.brakes.tolerances, ""), _origin(station, "tolerances")


def _shapes(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return which shapes of the crane keep apart."""
    return "those of its description, with the load", _origin(station, "crane")


def _load(site: CraneSite, station: Station) -> tuple[str, Origin]:
    """Return the mass of the load: a lighter one swings farther in the wind."""
    return f"{station.crane.payload_mass:g} kg", _origin(station, "load")
