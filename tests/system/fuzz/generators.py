"""All generators by name, with everything imported that they try."""

from __future__ import annotations

from tests.system.fuzz import api, files, interfaces, lines, loops, sites, trees
from tests.system.fuzz.core import Generator

_ALL: list[Generator] = [
    generator
    for module in (lines, files, trees, sites, interfaces, loops, api)
    for generator in module.GENERATORS
]
GENERATORS = {generator.name: generator for generator in _ALL}
"""By name."""
