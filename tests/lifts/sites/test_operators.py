"""Operators of cranes that share a site, the places that they reach, and static zones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cranedyn.lifts.sites.crane_site_file import read_crane_site
from cranedyn.lifts.sites.operators import LiftOperator, reach
from cranedyn.lifts.sites.plan import leaves_room
from cranedyn.lifts.sites.zones import static_zones

pytestmark = pytest.mark.long


def test_zones_are_proven_apart_and_no_lift_in_them_leads_out() -> None:
    crane_site = read_crane_site("two_towers")
    zones = static_zones(crane_site)
    assert crane_site.apart(0, zones[0], zones).all()
    operator = LiftOperator(crane_site, 0, 1, zones[0])
    places = np.array([operator.places() for _ in range(5)])
    assert (places >= zones[0][0]).all()
    assert (places <= zones[0][1]).all()
    assert operator.drawn > 5  # some lead out


def test_a_crane_without_a_slew_reaches_all_of_its_ranges(tmp_path: Path) -> None:
    file = tmp_path / "site.toml"
    file.write_text('[[crane]]\nname = "a"\nmachine = "gantry_laboratory"\n', "utf-8")
    crane_site = read_crane_site(file)
    crane = crane_site.stations[0].crane
    low, high = reach(crane_site, 0)
    assert (low == crane.lower[crane.layout.drives]).all()
    assert (high == crane.upper[crane.layout.drives]).all()


def test_no_load_is_put_where_it_would_leave_a_lower_crane_no_room() -> None:
    towers = read_crane_site("four_towers")
    over_tower = np.array([2.387, 45.109, 70.4])
    assert not leaves_room(towers, 3, over_tower)
    assert leaves_room(towers, 3, over_tower * [1.0, 1.0, 0.5])


def test_an_operator_whose_load_was_brought_away_raises_it_before_it_goes_back() -> None:
    towers = read_crane_site("two_towers")
    for off, rises in (0.0, False), (0.1, True):
        operator = LiftOperator(towers, 0, 1)
        start = towers.stations[0].crane.start
        operator._legs = [start.q[[0, 1, 4]] + [off, 0.0, 5.0]]
        assert bool(operator(0.0, [start] * 2)[2] < 0.0) is rises
