"""A site for examples: two towers whose jibs face each other."""

from __future__ import annotations

from pathlib import Path

from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.crane_site_file import read_crane_site

_YARD = Path(__file__).with_name("examples") / "tandem_yard.toml"


def tandem_yard() -> CraneSite:
    """Return the site: towers "north" and "south", 64 m apart along Y, with jibs of 27 m."""
    return read_crane_site(_YARD)
