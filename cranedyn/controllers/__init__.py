"""Controllers: from time, state and setpoint to one command for each drive.

A controller is any callable ``controller(t, state, setpoint)``. It commands efforts, accelerations
or rates, as the drives of the run take them. A controller that is affine in the state returns its
gains as tables by a method ``affine`` (`affine`), and then runs in compiled loops and batches
without Python. One that must know the control period of a run has ``begin_run``
(`cranedyn.clocks.Clocked`); one that integrates has ``resume`` (`affine.Stateful`), and one with
further states, which are linear, has ``resume_states`` (`affine.Dynamic`).

Public names:
    `hold_controller`: hold each drive at its setpoint, the weight of the load fed forward.
    `lqr`, `paper_controller`: gains along a motion; both return a `Tracking`.
    `linear_controller`: a design of your own as matrices A, B, C, D; returns a `LinearController`.
    `follow`: follow a reference with drives that take accelerations.
    `repeated.Repeated`: the controller of one cycle, for cycle after cycle.
    `damping.with_damping`: drives that yield to the swing.
    `velocity_command.as_velocity_command`: any controller for drives with frequency converters.

Begin with `hold`, then `tracking`. Observers, sensor models and MPC are in `cranedyn.estimation`.
"""

from cranedyn.controllers.follow import follow
from cranedyn.controllers.hold import Hold, hold_controller
from cranedyn.controllers.linear import LinearController, linear_controller
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.tracking import Tracking

__all__ = [
    "Hold",
    "LinearController",
    "Tracking",
    "follow",
    "hold_controller",
    "linear_controller",
    "lqr",
    "paper_controller",
]
