"""Plans of a move by a controller of one's own, beside the strategies of `STRATEGIES`."""

from __future__ import annotations

from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller
from cranedyn.interop.controller_file import ControllerFile
from experiments.harness import Setup
from experiments.scenarios.moves import IDEAL, MovePlan, RestToRest
from experiments.scenarios.strategies import flat_motion

RATES_ON_IDEAL_DRIVES = (
    "It commands rates, which drives with frequency converters take: --drive velocity."
)
"""Why a controller that commands rates has no result on ideal drives."""


def own_plan(setup: Setup, move: RestToRest, own: ControllerFile, drive: str) -> MovePlan:
    """Let a controller of one's own track the flat motion, which "flat + LQR" tracks too, so that
    what differs is the controller.

    Args:
        setup: Crane and clocks.
        move: The move.
        own: The controller.
        drive: Kind of the drives, `IDEAL` or "velocity".

    Raises:
        CraneError: If the controller cannot be made, or commands rates and the drives are ideal.
    """
    motion = flat_motion(setup, move)
    first = own.make(setup.crane, motion, setup.dt)
    if first.drive == "velocity" and drive == IDEAL:
        raise CraneError(RATES_ON_IDEAL_DRIVES)

    def controller() -> Controller:
        """Return a controller that remembers nothing of a run before."""
        return own.make(setup.crane, motion, setup.dt).controller

    return MovePlan(controller, motion, first.drive, motion.arrival, motion)
