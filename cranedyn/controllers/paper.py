"""The control of Muddassir et al. (ISARC 2024), as far as it is described.

One LQR for trolley and radial swing, one for slew and tangential swing, both time-varying through
cable length and radius, and a PID with gravity feed-forward for the hoist.

The planes are the paper's Eqs. (7)-(10). Its weights and gains are not public: those here are ours.
"""

from __future__ import annotations

import numpy as np
import scipy

from cranedyn.checks import finite, number, whole
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import riccati, stationary
from cranedyn.controllers.tracking import Tracking
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

TROLLEY_WEIGHTS = (np.diag([10.0, 2.0, 100.0, 100.0]) ** 2, np.diag([1.0 / 1.0e3]) ** 2)
"""Q for x, ẋ, φ, φ̇ and R for F_x; Bryson's rule, ours."""

SLEW_WEIGHTS = (np.diag([100.0, 20.0, 100.0, 100.0]) ** 2, np.diag([1.0 / 2.0e4]) ** 2)
"""Q for γ, γ̇, θ, θ̇ and R for T_γ; Bryson's rule, ours."""

HOIST = (4.0e4, 1.0e4, 1.2e4)
"""Gains k_p [N/m], k_i [N/(m s)] and k_d [N s/m] of the hoist, ours."""


def trolley_plane(
    mass: float, trolley: float, length: float, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a and b of Eqs. (7), (8): M ẍ = F_x - m g φ and l φ̈ = ẍ - g φ, for [x, ẋ, φ, φ̇].

    Args:
        mass: Mass of the load, m [kg].
        trolley: Mass of the trolley, M [kg].
        length: Cable length, l [m].
        gravity: Gravity, g [m/s²].
    """
    drive = np.array([0.0, 0.0, -mass * gravity / trolley, 0.0])
    a = np.array([[0, 1, 0, 0], drive, [0, 0, 0, 1], (drive - [0, 0, gravity, 0]) / length])
    return a, np.array([[0.0], [1.0 / trolley], [0.0], [1.0 / (trolley * length)]])


def slew_plane(
    mass: float, inertia: float, radius: float, length: float, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a and b of Eqs. (9), (10): J γ̈ = T_γ - m g x θ and l θ̈ = x γ̈ - g θ, for [γ, γ̇, θ,
    θ̇].

    Args:
        mass: Mass of the load, m [kg].
        inertia: Moment of inertia of structure and trolley about the slew axis, J [kg m²].
        radius: Position of the trolley, x [m].
        length: Cable length, l [m].
        gravity: Gravity, g [m/s²].
    """
    drive = np.array([0.0, 0.0, -mass * gravity * radius / inertia, 0.0])
    a = np.array(
        [[0, 1, 0, 0], drive, [0, 0, 0, 1], (radius * drive - [0, 0, gravity, 0]) / length]
    )
    return a, np.array([[0.0], [1.0 / inertia], [0.0], [radius / (inertia * length)]])


def paper_controller(
    crane: Crane,
    motion: Motion,
    *,
    gravity: float | None = None,
    hoist: tuple[float, float, float] = HOIST,
    every: int = 10,
) -> HoistIntegral:
    """Return the paper's controller about a motion with the load hanging plumb; make one for each
    run, since it integrates.

    Args:
        crane: The crane.
        motion: What to track; its period is the control period.
        gravity: Gravity assumed by the controller [m/s²]; it may differ from that of the crane,
            which None takes.
        hoist: k_p [N/m], k_i [N/(m s)] and k_d [N s/m] of the hoist.
        every: Control instants between linearisations.

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If a gain of the hoist is negative or there are not three, gravity is not
            positive, or `every` is not at least 1.
    """
    slew, trolley, radial, tangential, hoist_joint = crane.layout.tower("The paper's control")
    motion.check_fits("motion", crane.layout)
    every = min(whole("rows between linearisations", every, 1), len(motion.q))
    gravity = crane.gravity if gravity is None else number("gravity", gravity, "m/s²", "> 0")
    if finite("gains of the hoist", hoist, (3,)).min() < 0.0:
        raise OutOfRange("gains of the hoist", hoist, ">= 0")
    load_mass = crane.payload_mass
    trolley_mass = crane.trolley_mass
    rows = len(motion.q)
    radius = motion.q[:, trolley]
    length = motion.q[:, hoist_joint]
    inertia = crane.slewing_inertia + trolley_mass * radius**2
    trolley_planes = []
    slew_planes = []
    for k in range(0, rows, every):
        trolley_planes.append(trolley_plane(load_mass, trolley_mass, length[k], gravity))
        slew_planes.append(slew_plane(load_mass, inertia[k], radius[k], length[k], gravity))

    # The state of a plane is the drive, its rate, the swing and its rate. In the state of the crane
    # a rate is n columns behind its coordinate.
    n = crane.layout.n
    gain = np.zeros((rows, crane.layout.m, 2 * n))
    drive = {role: crane.layout.drive_of(role) for role in ("slew", "trolley", "hoist")}
    columns = [trolley, n + trolley, radial, n + radial]
    gain[:, drive["trolley"], columns] = _plane_gains(
        trolley_planes, TROLLEY_WEIGHTS, motion.period, rows, every
    )
    columns = [slew, n + slew, tangential, n + tangential]
    gain[:, drive["slew"], columns] = _plane_gains(
        slew_planes, SLEW_WEIGHTS, motion.period, rows, every
    )
    k_p, k_i, k_d = hoist
    gain[:, drive["hoist"], hoist_joint] = k_p
    gain[:, drive["hoist"], n + hoist_joint] = k_d

    # Of a load that hangs plumb: the inertia about the slew axis, the masses along the jib, and the
    # weight of the load on the hoist, whose coordinate grows downwards.
    feed_forward = np.stack(
        [
            (inertia + load_mass * radius**2) * motion.a[:, slew],
            (trolley_mass + load_mass) * motion.a[:, trolley],
            load_mass * (motion.a[:, hoist_joint] - gravity),
        ],
        axis=1,
    )
    tracking = Tracking(motion.period, feed_forward, gain, np.hstack([motion.q, motion.v]))
    limit = float(crane.effort_limit[drive["hoist"]])
    return HoistIntegral(crane, tracking, integral_gain=k_i, limit=limit)


def _plane_gains(
    planes: list[tuple[np.ndarray, np.ndarray]],
    weights: tuple[np.ndarray, np.ndarray],
    period: float,
    rows: int,
    every: int,
) -> np.ndarray:
    """Return the gains of the finite-horizon sweep for one plane, with the effort held for each
    control period, shape (rows, 4).

    Args:
        planes: a and b at each linearisation.
        weights: Q and R.
        period: Control period [s].
        rows: Rows of the motion.
        every: Rows from one linearisation to the next.
    """
    # exp(h [[A, B], [0, 0]]) = [[A_d, B_d], [0, 1]]: state and input after a period h in which the
    # input is held.
    block = np.zeros((len(planes), 5, 5))
    for k, (a, b) in enumerate(planes):
        block[k, :4, :4] = a
        block[k, :4, 4:] = b
    discrete = scipy.linalg.expm(period * block)
    a = discrete[:, :4, :4]
    b = discrete[:, :4, 4:]
    plane_of_row = np.arange(rows) // every
    state_weight, effort_weight = weights
    final_weight = stationary(a[-1], b[-1], state_weight, effort_weight)
    sweep = riccati(a[plane_of_row], b[plane_of_row], state_weight, effort_weight, final_weight)
    return sweep.gain[:, 0]
