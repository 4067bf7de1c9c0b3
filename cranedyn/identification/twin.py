"""Twin: the identified crane and the errors of its drives and sensors, in a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.data.files import parse_json, read_text, with_ending, write_text
from cranedyn.errors import CraneError, DataError
from cranedyn.identification.estimate import Estimate
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane

ENTRY_KEYS = ("value", "margin", "unit", "kind")
"""Keys of each parameter in a file."""


@dataclass(frozen=True, eq=False)
class Twin:
    """Identified crane.

    Attributes:
        crane: The crane.
        identified: Value, half width of the 95 % interval (None where the records do not determine
            it), unit and kind of each estimated parameter, by name.
        records: Names of the records.
    """

    crane: Crane
    identified: Mapping[str, Mapping[str, Any]]
    records: tuple[str, ...]

    @property
    def options(self) -> str:
        """Options ``--gravity`` and ``--set`` that describe the crane on a command line."""
        values = self.crane.record.get("arguments", {})
        settings = " ".join(f"{name}:={value!r}" for name, value in values.items())
        return f"--gravity {self.crane.gravity!r}" + (f" --set {settings}" if settings else "")

    def write(self, path: str | Path) -> Path:
        """Write a ``.json`` file that `load_crane(from_record=...)` and ``--set`` take.

        Raises:
            DataError: If the ending is not ``.json`` or the file cannot be written.
        """
        path = with_ending(path, ".json")
        write_text(path, self.text)
        return path

    @property
    def text(self) -> str:
        """Content of the file."""
        content = {
            "crane": dict(self.crane.record),
            "identified": {name: dict(entry) for name, entry in self.identified.items()},
            "records": list(self.records),
        }
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def twin_of(estimate: Estimate) -> Twin:
    """Return the identified crane.

    Raises:
        CraneError: If a crane cannot have these values.
    """
    model = estimate.model
    identified: dict[str, dict[str, Any]] = {}
    for p in model.own:
        margin = estimate.margin(p.name)
        identified[p.name] = {
            "value": estimate.value(p.name),
            "margin": margin if math.isfinite(margin) else None,  # JSON has no infinity
            "unit": p.unit,
            "kind": p.kind,
        }
    crane = model.prior.load(**estimate.arguments)
    return Twin(crane, identified, tuple(record.name for record in model.records))


def read_twin(path: str | Path) -> Twin:
    """Read a twin from a file of `Twin.write`.

    Raises:
        DataError: If the file cannot be read or is no twin.
        CraneError: If its crane is not valid.
    """
    try:
        content = parse_json(read_text(path))
        identified = {str(name): dict(entry) for name, entry in content["identified"].items()}
        records = tuple(str(name) for name in content["records"])
        is_valid = all(_is_valid_entry(entry) for entry in identified.values())
    except CraneError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        is_valid = False
    if not is_valid:
        raise DataError(f"{path} is no twin; allowed is a file that `Twin.write` wrote.")
    return Twin(load_crane(from_record=path), identified, records)


def _is_valid_entry(entry: Mapping[str, Any]) -> bool:
    """Return whether an identified parameter has all of its keys, and finite numbers; its margin
    may be None.
    """
    if set(entry) != set(ENTRY_KEYS):
        return False
    numbers = [entry["value"], entry["margin"] or 0.0]
    return bool(np.isfinite(numbers).all())
