"""A crane dynamics laboratory: a URDF, Pinocchio, a plain loop, and every number explained.

    import cranedyn as cd

    crane = cd.load_crane(payload_mass=2000)

A name of the API is imported at its first use, so that ``import cranedyn`` is fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from cranedyn.version import __version__

if TYPE_CHECKING:
    from cranedyn.compiled.batch import simulate_batch
    from cranedyn.compiled.plant.cranes import load_cranes
    from cranedyn.data.trajectory import Trajectory
    from cranedyn.display import plot
    from cranedyn.errors import CraneError
    from cranedyn.interfaces import Setpoint, State
    from cranedyn.model.crane import Crane
    from cranedyn.model.load import load_crane
    from cranedyn.recording.viewer import view
    from cranedyn.simulation.simulate import simulate
    from cranedyn.simulation.stepper import Stepper

__all__ = [
    "Crane",
    "CraneError",
    "Setpoint",
    "State",
    "Stepper",
    "Trajectory",
    "__version__",
    "load_crane",
    "load_cranes",
    "plot",
    "simulate",
    "simulate_batch",
    "view",
]

_HOMES = {
    "Crane": "cranedyn.model.crane",
    "CraneError": "cranedyn.errors",
    "Setpoint": "cranedyn.interfaces",
    "State": "cranedyn.interfaces",
    "Stepper": "cranedyn.simulation.stepper",
    "Trajectory": "cranedyn.data.trajectory",
    "load_crane": "cranedyn.model.load",
    "load_cranes": "cranedyn.compiled.plant.cranes",
    "plot": "cranedyn.display",
    "simulate": "cranedyn.simulation.simulate",
    "simulate_batch": "cranedyn.compiled.batch",
    "view": "cranedyn.recording.viewer",
}


def __getattr__(name: str) -> Any:
    """Import a name of the API at its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    """Return the names of the API first, then all others."""
    return [*__all__, *(name for name in globals() if name not in __all__)]
