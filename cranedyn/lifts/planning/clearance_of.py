"""Which clearance a crane needs: that of a tower crane in closed form, or that of any chain of
joints.
"""

from __future__ import annotations

from cranedyn.errors import MissingRole, ModelError
from cranedyn.lifts.planning.chain_clearance import ChainClearance
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.crane_bodies import refuse_other_kinematics
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.crane import Crane


def clearance_of(crane: Crane, site: Site) -> Clearance:
    """Return the distances between a crane and its site.

    A crane with the joints of a tower crane where this project's crane has them is measured in
    closed form, and its jib apart from what hangs. Every other one is measured by its chain of
    joints, see `cranedyn.lifts.planning.hoist_chain`.

    Raises:
        ModelError: If its joints are no chain of two drives, two swings and a hoist.
    """
    return TowerClearance(crane, site) if has_tower_joints(crane) else ChainClearance(crane, site)


def tower_clearance(clearance: Clearance, user: str) -> TowerClearance:
    """Return the clearance of a tower crane as such.

    Args:
        clearance: Crane and site.
        user: What is made for a tower crane only, to begin a sentence with.

    Raises:
        ModelError: If it is that of another crane.
    """
    if isinstance(clearance, TowerClearance):
        return clearance
    raise ModelError(
        f"{user} needs a tower crane of this project's kind: slew, trolley, two swings and hoist. "
        f"{clearance.crane.model.name} is another one."
    )


def has_tower_joints(crane: Crane) -> bool:
    """Return whether a crane has the joints of a tower crane, where this project's has them."""
    try:
        refuse_other_kinematics(crane)
    except (MissingRole, ModelError):
        return False
    return True
