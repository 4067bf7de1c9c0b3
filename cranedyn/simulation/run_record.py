"""Record of a run: the crane and what moved it, as JSON.

Together with the columns of the trajectory, which have its start, its times and its commands, the
run can be made again.
"""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import scipy

from cranedyn.model.crane import Crane
from cranedyn.simulation.run_spec import RunSpec
from cranedyn.version import __version__

_MAX_LENGTH = 64
"""Length of the longest array or list that is written whole."""

_MAX_DEPTH = 6
"""Levels of nesting that are recorded; what is deeper is recorded by the name of its class."""

VERSIONS = {
    "python": platform.python_version(),
    "cranedyn": __version__,
    "pin": pin.__version__,
    "numpy": np.__version__,
    "scipy": scipy.__version__,
}
"""Versions of the programs. They are read from the modules: to look through the metadata of what is
installed takes as long as to load a crane."""


def controller_notes(controller: object, depth: int = 0) -> dict[str, Any]:
    """Return what a controller adds to the record of a run, as values of JSON.

    That is what its method `notes` returns. A dataclass without one, such as a controller around
    another one, adds the notes of its fields, by the same rule; of two notes of one name the one of
    the later field counts.

    Args:
        controller: The controller.
        depth: Levels of nesting above it; from `_MAX_DEPTH` on, nothing is looked into.
    """
    notes = getattr(controller, "notes", None)
    if notes:
        return dict(notes())
    if not is_dataclass(controller) or isinstance(controller, type | Crane):
        return {}
    if depth >= _MAX_DEPTH:
        return {}
    notes_of_fields: dict[str, Any] = {}
    for field in fields(controller):
        inner = getattr(controller, field.name, None)
        notes_of_fields |= controller_notes(inner, depth + 1)
    return notes_of_fields


def run_parameters(spec: RunSpec, engine: str) -> dict[str, float | str]:
    """Return the numbers and words that describe a run, by name.

    Args:
        spec: The run.
        engine: Name of the engine.
    """
    return {
        "dt_s": spec.clocks.dt,
        "control_period_s": spec.clocks.period,
        "gravity_m_s2": spec.crane.gravity,
        "drive": spec.drive,
        "engine": engine,
        "integrator": spec.integrator.name,
        "validity": spec.validity,
    }


def run_record(spec: RunSpec, controller: object, reference: object) -> dict[str, Any]:
    """Return what a run is made of, as values of JSON: the crane, and what commands and pushes it.

    Make it before the run: a controller may change its own fields while it runs.

    Args:
        spec: The run.
        controller: What commands the crane.
        reference: What gives the setpoints; None for none.
    """
    record: dict[str, Any] = {"crane": dict(spec.crane.record)}
    actors = {
        "controller": controller,
        "reference": reference,
        "disturbance": spec.disturbance,
        "ground": spec.ground,
        "base": spec.base,
        "converters": spec.converters,
    }
    for name, actor in actors.items():
        if actor is not None:
            record[name] = json_value(actor)
    record["versions"] = dict(VERSIONS)
    return record


def with_notes(record: Mapping[str, Any], controller: object) -> dict[str, Any]:
    """Return a record of a run with what the controller has noted until now."""
    notes = controller_notes(controller)
    return {**record, "notes": notes} if notes else dict(record)


def json_value(value: object, depth: int = 0) -> Any:
    """Return an object as a value of JSON.

    * A dataclass or a named tuple becomes its class and its public fields.
    * A short array becomes its numbers, and a long one its shape and checksum.
    * A number that is not finite becomes the word for it, such as "nan".
    * Anything else, such as a function or a long list, becomes its qualified name.

    Args:
        value: The object.
        depth: Levels of nesting above it.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.ndarray):
        return _array_value(value)
    if isinstance(value, int | float | np.number | np.bool_):
        return _number_value(value)
    if isinstance(value, Crane):
        return "the crane"
    if depth >= _MAX_DEPTH:
        return _qualified_name(value)
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in fields(value) if not field.name.startswith("_")]
        named = {name: getattr(value, name, None) for name in names}
        return {"kind": _qualified_name(value), **json_value(named, depth)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {"kind": _qualified_name(value), **json_value(value._asdict(), depth)}
    if isinstance(value, dict | Mapping):  # a dict first: an abstract class is slow to compare
        return {str(name): json_value(item, depth + 1) for name, item in value.items()}
    if isinstance(value, list | tuple) and len(value) <= _MAX_LENGTH:
        return [json_value(item, depth + 1) for item in value]
    return _qualified_name(value)


def _number_value(value: float | np.number | np.bool_) -> Any:
    """Return a number as a value of JSON, which has none that are not finite."""
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int):
        return value
    return float(value) if math.isfinite(value) else str(value)


def _array_value(value: np.ndarray) -> Any:
    """Return an array as a value of JSON: its numbers, or the shape and checksum of a long one."""
    if value.dtype.kind not in "fiub":
        return _qualified_name(value)
    if value.size <= _MAX_LENGTH:
        plain = value.tolist()
        return plain if np.isfinite(value).all() else json_value(plain)
    content = np.ascontiguousarray(value, dtype=float).tobytes()
    return {"shape": list(value.shape), "sha256": hashlib.sha256(content).hexdigest()}


def _qualified_name(value: object) -> str:
    """Return the qualified name of a class or a function, of an object that of its class."""
    named = value if hasattr(value, "__qualname__") else type(value)
    module = getattr(named, "__module__", "")
    return f"{module}.{named.__qualname__}"
