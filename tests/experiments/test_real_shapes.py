"""Distances of cranes by the shapes of their descriptions, against what capsules say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.dynamics.converters import converters
from cranedyn.lifts.sites.brakes import brakes
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.crane_site_file import read_crane_site
from cranedyn.lifts.sites.site_simulation import SiteRun, simulate_site
from cranedyn.model.load import load_crane
from experiments.site.real_shapes import real_distances

pytestmark = pytest.mark.slow


def test_walls_of_two_wall_cranes_are_as_far_apart_as_their_description_says() -> None:
    # Each stands on a wall of 6 m along x; their feet are 30 m apart, and the jibs are parallel.
    crane = load_crane(Path("examples/wall_crane.urdf"), driven=["bracket", "carriage", "winch"])
    stations = [
        Station(
            name, crane, np.array([x, 0.0, 0.0]), -np.pi / 2.0, converters(crane), brakes(crane)
        )
        for name, x in (("a", 0.0), ("b", 30.0))
    ]
    site = CraneSite("walls", tuple(stations))
    run = simulate_site(site, [lambda t, states: np.zeros(3)] * 2, duration=0.2, supervised=False)
    assert real_distances(run).least == pytest.approx(24.0, abs=1e-6)


@cache
def crossing() -> SiteRun:
    """Return a run in which nothing protects two cranes whose jibs and ropes cross."""
    rates = np.array([0.05, 0.0, 0.0])
    operators = [lambda t, states, sign=sign: sign * rates for sign in (1.0, -1.0)]
    site = read_crane_site("two_towers")
    return simulate_site(site, operators, duration=90.0, supervised=False)


def test_shapes_that_overlap_do_so_after_a_contact_was_counted_and_lie_in_capsules() -> None:
    real = real_distances(crossing())
    assert real.least <= 0.0 and real.overlaps > 0
    assert real.uncounted == 0 and real.excess < 0.0


def test_contacts_that_are_not_counted_are_seen() -> None:
    real = real_distances(replace(crossing(), contacts=()))
    assert real.uncounted == real.overlaps > 0


def test_capsules_of_a_quarter_of_their_radius_are_seen() -> None:
    # A jib is at least 1 m high: by capsules a quarter as thick it is farther off than it is.
    run = crossing()
    site = read_crane_site("two_towers")
    for station in site.stations:
        station.__dict__["bodies"] = replace(station.bodies, radius=0.25 * station.bodies.radius)
    rates = np.array([0.05, 0.0, 0.0])
    operators = [lambda t, states, sign=sign: sign * rates for sign in (1.0, -1.0)]
    thin = simulate_site(site, operators, duration=40.0, supervised=False)
    assert (thin.distances > run.distances[: len(thin)]).all()
    assert real_distances(thin).excess > 0.0
