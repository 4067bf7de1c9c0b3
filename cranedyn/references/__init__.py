"""References: from time [s] to the setpoint of the drives.

A reference is any callable ``reference(t)`` that returns a `Setpoint`: positions, rates and
accelerations of the drives. A method ``at(times)`` answers for many times at once, which makes
compiled loops and batches faster (`tabulated`).

Public names:
    `hold`, `pulse`, `ramp`, `spline`: setpoints over time, without a model of the load.
    `shaped`: any reference behind an input shaper, such as `zv`.
    `flat`: a motion that takes the load along a path and leaves no swing.
    `Motion`: coordinates, rates and accelerations of all joints, for controllers that know the
    model; `hanging_reference` makes one of a reference.
    `limits.Limits`: largest rates and accelerations of the drives.

Begin with `hold` and `ramp`. Itineraries and the joystick are in `cranedyn.lifts.planning`.
"""

from cranedyn.interfaces import Reference, Setpoint
from cranedyn.references.flat import flat
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.shaped import ei, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.simple import hold, pulse, ramp, shortest, spline

__all__ = [
    "Motion",
    "Reference",
    "Setpoint",
    "ei",
    "flat",
    "hanging_reference",
    "hold",
    "pulse",
    "ramp",
    "shaped",
    "shaped_hoisting",
    "shortest",
    "spline",
    "zv",
    "zvd",
]
