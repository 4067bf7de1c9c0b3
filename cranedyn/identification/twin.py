"""A twin: the crane that was identified, with how its drives and sensors are off, in a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.data.files import parse_json, read_text, write_text
from cranedyn.errors import CraneError, DataError
from cranedyn.identification.estimate import Estimate
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane

KINDS = ("value", "margin", "unit", "kind")
"""What a file says of each parameter."""


@dataclass(frozen=True, eq=False)
class Twin:
    """A crane as its records show it.

    Attributes:
        crane: The crane.
        identified: Of each parameter that was found value, half width of its 95 % interval (None
            where the records say nothing), unit and kind, by name.
        records: Names of the records.
    """

    crane: Crane
    identified: Mapping[str, Mapping[str, Any]]
    records: tuple[str, ...]

    @property
    def off(self) -> dict[str, float]:
        """How drives and sensors are off, by name: whatever is no argument of the crane."""
        return {
            name: float(one["value"])
            for name, one in self.identified.items()
            if one["kind"] != "argument"
        }

    @property
    def words(self) -> str:
        """What makes the crane on any command line that has ``--gravity`` and ``--set``."""
        values = self.crane.record.get("arguments", {})
        given = " ".join(f"{name}:={value!r}" for name, value in values.items())
        return f"--gravity {self.crane.gravity!r}" + (f" --set {given}" if given else "")

    def write(self, path: str | Path) -> Path:
        """Write a ``.json`` file that `load_crane(from_record=...)` and ``--set`` take.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".json":
            raise DataError(f"Cannot write {path}: the ending must be .json.")
        write_text(path, self.text)
        return path

    @property
    def text(self) -> str:
        """What the file says."""
        content = {
            "crane": dict(self.crane.record),
            "identified": {name: dict(one) for name, one in self.identified.items()},
            "records": list(self.records),
        }
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def twin_of(estimate: Estimate) -> Twin:
    """The crane that was identified.

    Raises:
        CraneError: If no crane can have these numbers.
    """
    model = estimate.model
    identified = {
        one.name: {
            "value": estimate.value(one.name),
            "margin": margin if math.isfinite(margin := estimate.margin(one.name)) else None,
            "unit": one.unit,
            "kind": one.kind,
        }
        for one in model.own
    }
    crane = model.prior.load(**estimate.found_arguments)
    return Twin(crane, identified, tuple(record.name for record in model.records))


def read_twin(path: str | Path) -> Twin:
    """A twin from the file that `Twin.write` wrote.

    Raises:
        DataError: If the file cannot be read, or is none.
        CraneError: If its crane is none.
    """
    try:
        content = parse_json(read_text(path))
        identified = {str(name): dict(one) for name, one in content["identified"].items()}
        records = tuple(str(name) for name in content["records"])
        fine = all(
            set(one) == set(KINDS) and np.isfinite([one["value"], one["margin"] or 0.0]).all()
            for one in identified.values()
        )
    except CraneError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        fine = False
    if not fine:
        raise DataError(f"{path} is no twin; allowed is a file that `Twin.write` wrote.")
    return Twin(load_crane(from_record=path), identified, records)
