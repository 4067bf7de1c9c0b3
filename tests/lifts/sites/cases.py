"""Sites and numbers that tests of sites share."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cranedyn.dynamics.converters import converters
from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import brakes
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.crane_site_file import read_crane_site
from cranedyn.model.load import load_crane

BAD = (math.nan, math.inf, -math.inf, 1e308, -1e308)
"""What is no quantity of a crane."""

ODD = (-0.0, 5e-324, -5e-324, 1e-300)
"""Numbers that are none of the usual, but can be measured."""


@cache
def site_of(name: str = "two_towers") -> CraneSite:
    return read_crane_site(name)


def at_rest(station: Station) -> State:
    """Return a copy of the start of a crane on one copy of a site."""
    return State(*(values[None].copy() for values in station.crane.start))


@cache
def travelling_station() -> Station:
    """Return a crane whose bracket and carriage slide in one direction."""
    text = Path("examples/wall_crane.urdf").read_text("utf-8")
    turning = 'name="bracket" type="revolute"'
    upright = '<axis xyz="0 0 1"/>'
    assert turning in text
    assert upright in text
    text = text.replace(turning, turning.replace("revolute", "prismatic"))
    text = text.replace(upright, '<axis xyz="0 -1 0"/>')
    with TemporaryDirectory() as folder:
        file = Path(folder) / "travelling.urdf"
        file.write_text(text, "utf-8")
        crane = load_crane(file, driven=["bracket", "carriage", "winch"])
    return Station("travelling", crane, np.zeros(3), 0.0, converters(crane), brakes(crane))
