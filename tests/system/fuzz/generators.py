"""All generators by name, with everything imported that they try."""

from __future__ import annotations

from tests.system.fuzz import api, files, lines, signals
from tests.system.fuzz.core import Generator

_ALL: list[Generator] = [*lines.GENERATORS, *files.GENERATORS, *api.GENERATORS, *signals.GENERATORS]
GENERATORS = {generator.name: generator for generator in _ALL}
"""By name."""
