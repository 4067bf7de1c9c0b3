"""Arguments of the shipped tower crane, for editors and type checkers."""

from __future__ import annotations

from typing import TypedDict


class CraneValues(TypedDict, total=False):
    """Numbers of the tower crane of this project, each an argument of its xacro file.

    ``cranedyn describe --list`` lists them with default, range and meaning. The
    comment behind each is its unit.
    """

    payload_mass: float  # kg
    payload_inertia: float  # kg m^2
    payload_ixx: float  # kg m^2
    payload_iyy: float  # kg m^2
    payload_izz: float  # kg m^2

    hook_mass: float  # kg
    sling_length: float  # m
    damp_sling: float  # N m s/rad

    rope_stiffness: float  # N
    rope_damping: float  # N s/m
    drum_inertia: float  # kg
    tower_twist_stiffness: float  # N m/rad
    slew_drive_inertia: float  # kg m^2
    tower_bend_stiffness: float  # N m/rad
    jib_bend_stiffness: float  # N m/rad
    jib_inertia: float  # kg m^2

    mast_height: float  # m
    pivot_height: float  # m
    total_height: float  # m
    counter_jib: float  # m
    upper_mass: float  # kg
    slewing_inertia: float  # kg m^2
    trolley_mass: float  # kg
    trolley_inertia: float  # kg m^2
    dummy_mass: float  # kg
    dummy_inertia: float  # kg m^2

    damp_slew: float  # N m s/rad
    damp_trolley: float  # N s/m
    damp_swing: float  # N m s/rad
    damp_hoist: float  # N s/m

    slew_limit: float  # rad
    trolley_min: float  # m
    trolley_max: float  # m
    swing_limit: float  # rad
    hoist_min: float  # m
    hoist_max: float  # m
    slew_effort: float  # N m
    trolley_effort: float  # N
    swing_effort: float  # N m
    hoist_effort: float  # N
    slew_velocity: float  # rad/s
    trolley_velocity: float  # m/s
    swing_velocity: float  # rad/s
    hoist_velocity: float  # m/s

    slew_init: float  # rad
    trolley_init: float  # m
    hoist_init: float  # m
