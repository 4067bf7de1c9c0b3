"""How the drives get where they should be. A controller is a plain callable from time, state and
setpoint to three commands.
"""

from cranedyn.controllers.adapted import adapted
from cranedyn.controllers.follow import follow
from cranedyn.controllers.hold import Hold, hold_controller
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.mpc import mpc
from cranedyn.controllers.observer import observed
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.sensed import sensed
from cranedyn.controllers.tracking import Tracking

__all__ = [
    "Hold",
    "Tracking",
    "adapted",
    "follow",
    "hold_controller",
    "lqr",
    "mpc",
    "observed",
    "paper_controller",
    "sensed",
]
