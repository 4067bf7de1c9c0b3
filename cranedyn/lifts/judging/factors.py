"""Dynamic factors of the standards, as functions.

The standards themselves were not read: what is said of EN 1991-3, EN 13001, FEM 1.001 and the
Australian ones is second hand, from texts that quote them. `cranedyn run factors` shows by
simulation which of the factors follow from mechanics, and are exact.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Literal, NamedTuple

from cranedyn.checks import check_choice, number, within

HoistingClass = Literal["HC1", "HC2", "HC3", "HC4"]
"""How hard a crane picks its loads up, from soft to hard."""

DriveClass = Literal["HD1", "HD2", "HD3", "HD4", "HD5"]
"""How its hoist drive picks up: HD1 without creep speed, HD2 with a creep speed that the driver
chooses, HD3 with one that is enforced, HD4 stepless by the driver, HD5 stepless by itself. EN
13001-2 (second hand)."""


class Hoisting(NamedTuple):
    """Numbers of a hoisting class, by which φ2 = φ2,min + β2 v_h.

    Attributes:
        slope: β2 [s/m].
        least: φ2,min.
    """

    slope: float
    least: float


_HOISTING: dict[HoistingClass, Hoisting] = {
    "HC1": Hoisting(0.17, 1.05),
    "HC2": Hoisting(0.34, 1.10),
    "HC3": Hoisting(0.51, 1.15),
    "HC4": Hoisting(0.68, 1.20),
}
HOISTING = MappingProxyType(_HOISTING)
"""Numbers of each hoisting class: EN 1991-3, Table 2.5 (second hand)."""

SLOW_RELEASE = 0.5
"""β3 of a load that is let go slowly, as by grabs: EN 1991-3, Table 2.4 (second hand)."""

RAPID_RELEASE = 1.0
"""β3 of a load that is let go at once, as by magnets: EN 1991-3, Table 2.4 (second hand)."""

BUFFER_SHARE = 0.7
"""Share of its speed at which a crane meets its buffers: FEM 1.001 (second hand)."""

MAX_BUFFER_DECELERATION = 5.0
"""Largest deceleration of a crane by its buffers [m/s²]; 2.5 where it meets them often: FEM 1.001
(second hand)."""


def phi_1(a: float = 0.1) -> tuple[float, float]:
    """Return the least and the largest φ1, which multiplies the crane's own weight when a load
    leaves the ground: 1 ± a.

    EN 1991-3, Table 2.4: 0 ≤ a ≤ 0.1 (second hand).
    """
    a = within("a", a, 0.0, 0.1)
    return 1.0 - a, 1.0 + a


def phi_2_least(hoisting: HoistingClass, drive: DriveClass = "HD1") -> float:
    """Return φ2,min: EN 1991-3, Table 2.5; 1.05 for HD3 and HD5 by AS 5221.1:2021 (both second
    hand).
    """
    check_choice("hoisting", hoisting, HoistingClass)
    check_choice("drive", drive, DriveClass)
    return 1.05 if drive in ("HD3", "HD5") else HOISTING[hoisting].least


def phi_2(hoisting: HoistingClass, speed: float, drive: DriveClass = "HD1") -> float:
    """Return φ2 = φ2,min + β2 v_h, which multiplies the weight of a load that is picked up from the
    ground at a speed [m/s].

    EN 1991-3, Table 2.4 (second hand). A load picked up at v by an elastic hoist of frequency ω
    pulls 1 + v ω/g times its weight (`cranedyn.theory.pickup_factor`), so β2 = ω/g.
    """
    minimum = phi_2_least(hoisting, drive)
    return minimum + HOISTING[hoisting].slope * number("hoisting speed", speed, "m/s", ">= 0")


def pick_up_speed(drive: DriveClass, largest: float, creep: float) -> float:
    """Return v_h, at which a drive picks a load up [m/s]: HD1 the largest, HD2 and HD3 creep, HD4
    half of the largest, HD5 none.

    AS 5221.1:2021 (second hand).

    Args:
        drive: Its class.
        largest: Largest steady hoisting speed [m/s].
        creep: Creep speed, at most the largest [m/s].
    """
    check_choice("drive", drive, DriveClass)
    largest = number("largest hoisting speed", largest, "m/s", ">= 0")
    creep = within("creep speed", creep, 0.0, largest, "m/s")
    if drive == "HD1":
        return largest
    if drive == "HD4":
        return largest / 2.0
    if drive == "HD5":
        return 0.0
    return creep


def phi_3(share: float, beta: float = RAPID_RELEASE) -> float:
    """Return φ3 = 1 - (Δm/m)(1 + β3), which multiplies the weight of a load that loses a part of
    its mass; negative where the load jumps up.

    EN 1991-3, Table 2.4 (second hand). With β3 = 1 it is exactly the least tension of an undamped
    elastic hoist over the weight before.

    Args:
        share: Δm/m, of the load that was lifted.
        beta: β3, see `SLOW_RELEASE`, `RAPID_RELEASE`.
    """
    return 1.0 - within("share", share, 0.0, 1.0) * (1.0 + within("beta", beta, 0.0, 1.0))


def phi_6(phi_2: float) -> float:
    """Return the factor of the dynamic test load: ½ (1 + φ2). EN 1991-3, 2.10 (second hand)."""
    return 0.5 * (1.0 + number("phi_2", phi_2, "", ">= 0"))


def psi_h(mass_ratio: float) -> float:
    """Return ψ_h: horizontal pull of a load that hangs from a carriage braked by a constant force,
    over its mass times the mean deceleration of load and carriage together, which is the force over
    both masses: √(2 + μ + 1/μ) for μ > 1, else 2.

    FEM 1.001, A.2.2.3 (second hand). It is the worst case over all durations of braking to
    standstill, exactly: at cos ωT = -1/μ.

    Args:
        mass_ratio: μ, load over carriage, with all that moves with the latter.
    """
    mu = number("mass_ratio", mass_ratio, "", "> 0")
    return math.sqrt(2.0 + mu + 1.0 / mu) if mu > 1.0 else 2.0


def psi_h_regulated(periods: float) -> float:
    """Return ψ_h of a drive that keeps its acceleration whatever the load does: 2 sin βπ for β ≤ ½,
    else 2.

    FEM 1.001, A.2.2.3 (second hand). It is exact for the small swing that a constant acceleration
    leaves.

    Args:
        periods: β, duration of the acceleration over the period of the pendulum.
    """
    beta = number("periods", periods, "", ">= 0")
    return 2.0 * math.sin(math.pi * beta) if beta < 0.5 else 2.0


def stopping(speed: float, deceleration: float) -> tuple[float, float]:
    """Return the distance and the time in which a drive stops, v²/(2a) and v/a: [rad] and [s] of a
    slew, [m] and [s] of another drive.

    Args:
        speed: [rad/s] or [m/s].
        deceleration: [rad/s²] or [m/s²].
    """
    v = number("speed", speed, "/s")
    a = number("deceleration", deceleration, "/s²", "> 0")
    return v * v / (2.0 * a), abs(v) / a


def buffer_stroke(speed: float, deceleration: float = MAX_BUFFER_DECELERATION) -> float:
    """Return the stroke that a buffer needs [m] to stop a crane of a speed [m/s] from 0.7 of it at
    a constant deceleration [m/s²]: (0.7 v)²/(2a). FEM 1.001 (second hand).
    """
    checked_deceleration = within(
        "deceleration", deceleration, 1e-3, MAX_BUFFER_DECELERATION, "m/s²"
    )
    impact_speed = BUFFER_SHARE * number("speed", speed, "m/s")
    return impact_speed * impact_speed / (2.0 * checked_deceleration)
