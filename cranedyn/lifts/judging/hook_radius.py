"""The radius of the hook at planned places: its distance in plan from the slew axis, as a load
chart counts it. The column `radius_m` of `cranedyn.lifts.judging.loads` is the same of a
simulated run.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.lifts.planning.clearance import Clearance


def hook_radius(clearance: Clearance, place: np.ndarray) -> float | None:
    """Return the radius of the hook, with its load plumb, at a place [m]; None for a crane that
    does not turn.

    Args:
        clearance: Crane and site.
        place: Positions of the drives, shape (3,).
    """
    radii = hook_radii(clearance, place[None])
    return None if radii is None else float(radii[0])


def hook_radii(clearance: Clearance, places: np.ndarray) -> np.ndarray | None:
    """Return the radii of the hook, with its load plumb, at places [m], shape (rows,); None for a
    crane that does not turn.

    Args:
        clearance: Crane and site.
        places: Positions of the drives, shape (rows, 3).
    """
    if clearance.turning is None:
        return None
    crane = clearance.crane
    # A drive before the slew, such as that of a portal that travels, moves the slew axis.
    stays = clearance.turning == 0
    data = crane.model.createData()
    slew = int(clearance.drive_joints[clearance.turning]) + 1
    axes = []
    for q in clearance.q(places[:1] if stays else places):
        pin.forwardKinematics(crane.model, data, q)
        axes.append(data.oMi[slew].translation.copy())
    across = clearance.point(places) - np.array(axes)
    return np.hypot(across[:, 0], across[:, 1])
