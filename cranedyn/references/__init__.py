"""Where the drives should be at a time. A reference is a plain callable from time [s] to
`Setpoint`.
"""

from cranedyn.interfaces import Reference, Setpoint
from cranedyn.references.flat import flat
from cranedyn.references.hold import hold
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.pulse import pulse
from cranedyn.references.ramp import ramp
from cranedyn.references.shaped import ei, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.spline import shortest, spline

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
