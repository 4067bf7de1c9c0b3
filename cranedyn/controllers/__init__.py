"""How the drives get where they should be. A controller is a plain callable from time, state and what is wanted to three commands."""

from cranedyn.controllers.follow import follow
from cranedyn.controllers.hold import Hold, hold_controller

__all__ = ["Hold", "follow", "hold_controller"]
