"""How the drives get where they should be. A controller is a plain callable from time, state and
setpoint to three commands.
"""

from cranedyn.controllers.follow import follow
from cranedyn.controllers.hold import Hold, hold_controller
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.tracking import Tracking

__all__ = ["Hold", "Tracking", "follow", "hold_controller", "lqr", "paper_controller"]
