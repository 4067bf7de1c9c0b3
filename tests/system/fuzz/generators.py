"""All generators by name, with everything imported that they try."""

from __future__ import annotations

from tests.system.fuzz import api, files, lines, signals
from tests.system.fuzz.core import Generator

GENERATORS: dict[str, Generator] = {
    generator.name: generator for generator in [*lines.GENERATORS, *files.GENERATORS, *api.GENERATORS, *signals.GENERATORS]
}
"""By name."""
