"""What a plan and its certificate rest on, and where each value is from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cranedyn.assumptions import Assumption, Origin
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import ModelError
from cranedyn.lifts.planning.site import DISTANCE, SWING, Site
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits

EARTH_GRAVITY = (9.76, 9.84)
"""Least and largest gravity on the ground of the Earth [m/s²]."""


def plan_assumptions(site: Site, crane: Crane, limits: Limits) -> list[Assumption]:
    """Return what a certificate of a lift rests on.

    Args:
        site: The site.
        crane: The crane.
        limits: Limits that the lift is planned with: those of the site if it enters any, or less.
    """
    return [*_of_crane(site, crane), *_of_load(site, crane), *_of_motion(site, crane, limits)]


def held_mass(crane: Crane) -> float:
    """Return the mass that the hoist of a crane holds at its start [kg]."""
    return abs(float(holding_effort(crane, crane.start.q)[winch_of(crane)])) / crane.gravity


def winch_of(crane: Crane) -> int:
    """Return the index of the hoist among the drives.

    Raises:
        ModelError: If no drive sets the length of the rope, or several do.
    """
    if crane.winch is None:
        raise ModelError(
            "A planned lift needs one drive that sets the length of the rope: a driven prismatic "
            "joint below the swing joints."
        )
    return crane.winch


def _of_crane(site: Site, crane: Crane) -> Iterator[Assumption]:
    """Yield which crane it is, and its gravity."""
    described = site.description
    # A crane from a file of its own has no arguments in its record.
    arguments = crane.record.get("arguments")
    kind = "tower" if isinstance(arguments, dict) else ""
    if described is not None and described.file is None:
        kind = described.kind or f"machine {described.machine}"
        arguments = site.crane
    if kind:
        value = f"the {kind} crane of this package"
        origin = Origin.SHIPPED
        if arguments:
            changed = ", ".join(f"{name} {x:g}" for name, x in sorted(arguments.items()))
            value = f"{value} with {changed}"
    else:
        value = crane.model.name
        origin = Origin.ENTERED
    yield Assumption("crane", value, origin, "[crane] values")
    if site.telescope:
        length = "" if site.boom is None else f"{site.boom:.6g} m, "
        value = f"{length}held during the lift; telescoping under load is not planned"
        yield Assumption("length of the boom", value, Origin.ENTERED, "[crane] boom")
    yield Assumption("gravity", f"{crane.gravity:g} m/s²", Origin.ASSUMED)


def _of_load(site: Site, crane: Crane) -> Iterator[Assumption]:
    """Yield the masses of load and rigging, and size and attitude of the load."""
    entered = "payload_mass" in site.crane or "payload_mass" in crane.record.get("arguments", {})
    yield Assumption(
        "mass of the load with its rigging",
        f"{held_mass(crane):,.0f} kg",
        Origin.ENTERED if entered else Origin.DEFAULT,
        "[load] mass",
    )
    # Without the hook block and the slings a load seems lighter than what hangs. So a site enters
    # both, as 0 where the mass of the load contains them.
    for part, name in (("hook", "mass of the hook block"), ("slings", "mass of the slings")):
        is_entered = part in site.rigging
        yield Assumption(
            name,
            f"{site.rigging.get(part, 0.0):g} kg",
            Origin.ENTERED if is_entered else Origin.DEFAULT,
            f"[rigging] {part}",
        )
    if site.load is None:
        size = "the shapes of the crane's URDF"
        origin = Origin.DEFAULT
    else:
        sides = " x ".join(f"{side:.1f}" for side in np.ptp(site.load, axis=0))
        size = f"{sides} m"
        origin = Origin.ENTERED
    yield Assumption("size of the load", size, origin, "[load] size")
    along = "along the jib" if site.is_tower else "as it is at the start"
    attitude = f"held {along}, such as by tag lines; it does not turn about the rope"
    yield Assumption("attitude of the load", attitude, Origin.ASSUMED)


def rates_text(crane: Crane, rates: Sequence[float]) -> str:
    """Return rates of the drives to read, those of rotations in degrees per second."""
    texts = []
    for joint, rate in zip(crane.layout.driven, rates, strict=True):
        turns = joint.kind == "revolute"
        texts.append(f"{math.degrees(rate):.2g} °/s" if turns else f"{rate:.2f}")
    return f"{in_words(texts)} m/s"  # the hoist, which is the last one, winds up metres


def in_words(names: Sequence[str]) -> str:
    """Return names as a list in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _of_motion(site: Site, crane: Crane, limits: Limits) -> Iterator[Assumption]:
    """Yield the rates of the drives, the swing and the distance to keep."""
    drives = [joint.role or joint.symbol for joint in crane.layout.driven]
    if site.limits is None:
        origin = Origin.DEFAULT
    elif np.allclose(limits.rates, site.limits.rates, rtol=1e-9):
        origin = Origin.ENTERED
    else:
        origin = Origin.COMPUTED  # a plan uses less where the crane's own rates leave no reserve
    yield Assumption(
        f"largest rates of {in_words(drives)}",
        rates_text(crane, limits.rates),
        origin,
        "[drives] rates",
    )
    yield Assumption(
        "largest swing that the distance is kept with",
        f"{math.degrees(site.swing):.3g}°",
        _origin(site, "[lift] swing", site.swing, SWING),
        "[lift] swing",
    )
    yield Assumption(
        "distance to keep",
        f"{site.distance:g} m",
        _origin(site, "[lift] distance", site.distance, DISTANCE),
        "[lift] distance",
    )


def _origin(site: Site, field: str, value: float, default: float) -> Origin:
    """Return the origin of a value of a site that has a default. One that equals it counts as
    entered only if the site says so.
    """
    return Origin.ENTERED if field in site.entered or value != default else Origin.DEFAULT
