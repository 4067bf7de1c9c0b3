"""What a plan and its certificate rest on, and where each value is from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cranedyn.assumptions import Assumption, Origin
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import ModelError
from cranedyn.lifts.planning.site import DISTANCE, SWING, Site
from cranedyn.model.crane import Crane
from cranedyn.model.description import Argument
from cranedyn.model.description import arguments as description_arguments
from cranedyn.model.machines import read_machine
from cranedyn.references.limits import Limits

MAX_LISTED = 8
"""Most obstacles that are listed by name."""

MASS_ARGUMENTS = {
    "trolley_mass": "mass of the trolley",
    "upper_mass": "mass of what slews, on the slew axis",
    "slewing_inertia": "its moment of inertia",
    "dummy_mass": "mass of each link at the trolley",
}
"""Arguments of the tower crane of this project that are masses of its structure, in words."""

EARTH_GRAVITY = (9.76, 9.84)
"""Least and largest gravity on the ground of the Earth [m/s²]."""


def plan_assumptions(site: Site, crane: Crane, limits: Limits) -> list[Assumption]:
    """Return what a certificate of a lift rests on.

    Args:
        site: The site.
        crane: The crane.
        limits: Limits that the lift is planned with: those of the site if it enters any, or less.
    """
    return with_estimates(
        site,
        [
            *_of_crane(site, crane),
            *_of_structure(site, crane),
            *_of_load(site, crane),
            *_of_motion(site, crane, limits),
            *_of_surroundings(site),
        ],
    )


def with_estimates(site: Site, assumptions: Iterable[Assumption]) -> list[Assumption]:
    """Return assumptions, with the origin "estimated" in place of "entered" where the site says
    that what it enters is an estimate.
    """
    marked = []
    for assumption in assumptions:
        if assumption.origin is Origin.ENTERED and _is_estimated(site, assumption.field):
            marked.append(replace(assumption, origin=Origin.ESTIMATED))
        else:
            marked.append(assumption)
    return marked


def other_estimates(site: Site, assumptions: Iterable[Assumption]) -> list[Assumption]:
    """Return, as one assumption, the fields that a site calls estimates and that no assumption
    shows as entered. Such are the corner forces of the crane's papers, which a report only compares
    with what it computes, and rates where the plan takes less than was entered.
    """
    shown = {
        field
        for assumption in assumptions
        if assumption.origin in (Origin.ENTERED, Origin.ESTIMATED)
        for field in _fields_of(assumption.field)
    }
    rest = sorted(site.estimated - shown)
    if not rest:
        return []
    return [Assumption("other estimates", "; ".join(rest), Origin.ESTIMATED)]


def _is_estimated(site: Site, field: str) -> bool:
    """Return whether one of the fields that an assumption names was estimated; the mass of a load
    is also if its source says so.
    """
    if field == "[load] mass" and site.details.load.source == "estimated":
        return True
    return any(name in site.estimated for name in _fields_of(field))


def _fields_of(text: str) -> list[str]:
    """Return the fields that an assumption names, such as "[jib] mass, centre"."""
    table, _, names = text.partition("] ")
    return [f"{table}] {name}" for name in names.split(", ")]


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
        yield from _values_of_crane(site, crane, arguments or {}, f"the {kind} crane")
    else:
        yield Assumption("crane", crane.model.name, Origin.ENTERED, "[crane] values")
    if site.telescope:
        length = "" if site.boom is None else f"{site.boom:.6g} m, "
        value = f"{length}held during the lift; telescoping under load is not planned"
        yield Assumption("length of the boom", value, Origin.ENTERED, "[crane] boom")
    yield Assumption("gravity", f"{crane.gravity:g} m/s²", Origin.ASSUMED)


def _values_of_crane(
    site: Site, crane: Crane, arguments: Mapping[str, object], kind: str
) -> Iterator[Assumption]:
    """Yield what was entered of a crane of this package, and that the rest is as it is shipped.

    Args:
        site: The site.
        crane: The crane.
        arguments: Values of the crane that differ from its defaults, by name.
        kind: Which crane of this package it is, in words.
    """
    known = arguments_of(site)
    efforts = []
    for joint in crane.layout.driven:
        name = f"{joint.role or joint.symbol}_effort"
        if f"[crane.values] {name}" not in site.entered:
            efforts.append(name)
    elsewhere = {"payload_mass", "counterweight", "counter_jib", "falls", *efforts}
    if site.is_tower:
        elsewhere |= MASS_ARGUMENTS.keys()
    entered: list[str] = []
    estimated: list[str] = []
    for name in sorted(arguments.keys() - elsewhere):
        is_estimate = f"[crane.values] {name}" in site.estimated
        (estimated if is_estimate else entered).append(name)
    of_drives = [name for name in efforts if name in arguments]
    rest = "crane"
    value = f"{kind} of this package"
    if entered or estimated or of_drives:
        rest = "what is not entered of the crane"
        value = f"as that of {kind} of this package"
    yield Assumption(rest, value, Origin.SHIPPED, "[crane.values]")
    for names in (entered, estimated):
        if names:
            field = f"[crane.values] {', '.join(names)}"
            texts = [_argument_text(name, arguments[name], known) for name in names]
            origin = Origin.ENTERED if names is entered else Origin.ESTIMATED
            yield Assumption("values of the crane", ", ".join(texts), origin, field)
    if of_drives:
        texts = [_argument_text(name, arguments[name], known) for name in of_drives]
        yield Assumption(
            "largest efforts of the drives", ", ".join(texts), Origin.ENTERED, "[drives] efforts"
        )


def arguments_of(site: Site) -> dict[str, Argument]:
    """Return the arguments of the crane of this package that stands on a site, by name."""
    described = site.description
    path = None if described is None else described.urdf
    if described is not None and described.machine is not None:
        path = read_machine(described.machine).urdf
    return description_arguments() if path is None else description_arguments(path)


def _argument_text(name: str, value: object, known: Mapping[str, Argument]) -> str:
    """Return the value of an argument of a crane in words, with its unit: "boom mass 2,200 kg"."""
    words = name.replace("_", " ")
    if not isinstance(value, int | float):
        return f"{words} {value}"
    unit = known[name].unit.replace("^2", "²") if name in known else ""
    if unit in ("N", "N m") and abs(value) >= 1e4:
        value = value / 1e3
        unit = f"k{unit}"
    return f"{words} {value:,.6g} {unit}".rstrip()


def _of_structure(site: Site, crane: Crane) -> Iterator[Assumption]:
    """Yield the masses of the crane, and the base that it stands on or the rails that it travels
    on, as far as they are known.
    """
    yield from _masses_of_model(site, crane)
    for arm in site.arms:
        name = "jib" if arm.centre >= 0.0 else "counter-jib"
        value = f"{arm.mass:,.0f} kg, centre {abs(arm.centre):g} m from the slew axis"
        field = f"[{name.replace('-', '_')}] mass, centre"
        yield Assumption(f"mass of the {name}", value, Origin.ENTERED, field)
    length = site.crane.get("counter_jib")
    if length:
        yield Assumption(
            "length of the counter-jib", f"{length:g} m", Origin.ENTERED, "[counter_jib] length"
        )
    if site.counterweight is not None:
        value = f"{site.counterweight:,.0f} kg"
        yield Assumption("counterweight", value, Origin.ENTERED, "[crane] counterweight")
    base = site.base
    if base is not None:
        value = f"{base.spacing:g} m between its corners, {base.mass:,.0f} kg with what it adds"
        yield Assumption("base", value, Origin.ENTERED, "[base] spacing, mass")
        if base.permitted is not None:
            value = f"{base.permitted / 1e3:,.0f} kN"
            yield Assumption(
                "force that the ground bears under a corner",
                value,
                Origin.ENTERED,
                "[base] permitted",
            )
    runway = site.runway
    if runway is not None:
        first, second = runway.rails
        value = f"at {first:g} and {second:g} m, wheels {runway.wheel_base:g} m apart"
        yield Assumption("rails", value, Origin.ENTERED, "[runway] rails, wheel_base")


def _masses_of_model(site: Site, crane: Crane) -> Iterator[Assumption]:
    """Yield the masses that the model of a crane has: of the tower crane of this project each that
    the site enters and those that it leaves as they are shipped, and of another one their sum.
    """
    if not isinstance(crane.record.get("arguments"), dict) or not site.is_tower:
        # Pinocchio counts bodies from 1, and has in 0 what does not move, such as a carrier; the
        # last one is the load.
        moving = sum(inertia.mass for inertia in crane.model.inertias[1:]) - crane.payload_mass
        value = f"{moving:,.0f} kg in all that moves, without the load"
        origin = Origin.ENTERED
        if site.description is not None and site.description.file is None:
            shipped = shipped_masses(site)
            origin = Origin.SHIPPED if shipped else Origin.COMPUTED
            if shipped:
                value = f"{value}; as shipped: {', '.join(shipped)}"
        yield Assumption("masses of the crane's description", value, origin, "[crane]")
        return
    known = description_arguments()
    shipped = []
    for argument, name in MASS_ARGUMENTS.items():
        unit = known[argument].unit.replace("^2", "²")
        if argument in site.crane:
            value = f"{site.crane[argument]:,.0f} {unit}"
            yield Assumption(name, value, Origin.ENTERED, f"[crane.values] {argument}")
        else:
            shipped.append(
                f"{name.removeprefix('mass of ')} {float(known[argument].default):,.0f} {unit}"
            )
    if shipped:
        yield Assumption(
            "masses of the crane as shipped", ", ".join(shipped), Origin.SHIPPED, "[crane.values]"
        )


def shipped_masses(site: Site) -> list[str]:
    """Return the masses of a crane of this package that the site does not enter, in words; none of
    a published machine, or of a crane from a file.
    """
    described = site.description
    if described is None or described.file is not None or described.machine is not None:
        return []
    known = arguments_of(site)
    # The load and the rope have their own entries, and the links between the swing joints of a
    # model are no parts of a crane.
    others = ("payload_mass", "rope_mass", "dummy_mass")
    texts = []
    for name, argument in known.items():
        is_mass = name == "counterweight" or name.endswith("_mass")
        if is_mass and name not in site.crane and name not in others:
            texts.append(_argument_text(name, float(argument.default), known))
    return texts


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
    centre = site.details.load.centre
    place = "the middle of its box, in plan"
    if centre is not None:
        place = f"({', '.join(f'{x:g}' for x in centre)}) m from the middle of its box"
    yield Assumption(
        "centre of gravity of the load",
        place,
        Origin.COMPUTED if centre is None else Origin.ENTERED,
        "[load] centre",
    )
    attitude = f"held {load_attitude(site)}, such as by tag lines; it does not turn about the rope"
    yield Assumption("attitude of the load", attitude, Origin.ASSUMED)


def load_attitude(site: Site) -> str:
    """Return how the load is held in plan, in words: a site enters its sides across the jib and
    along it, and the load turns with the jib.
    """
    if not site.is_tower:
        return "as it is at the start, turning with the crane"
    if site.load is None:
        return "as the crane's URDF draws it, turning with the jib"
    across, along, _ = np.ptp(site.load, axis=0).tolist()
    if math.isclose(across, along, rel_tol=1e-3):
        return f"with a side of {along:.1f} m along the jib"
    where = "along" if along > across else "across"
    return f"with its longer side, {max(across, along):.1f} m, {where} the jib"


def rates_text(crane: Crane, rates: Sequence[float]) -> str:
    """Return rates of the drives to read, those of rotations in degrees per second."""
    texts = []
    for joint, rate in zip(crane.layout.driven, rates, strict=True):
        turns = joint.kind == "revolute"
        texts.append(f"{math.degrees(rate):.2g} °/s" if turns else f"{rate:.2f}")
    return f"{in_words(texts)} m/s"  # the hoist, which is the last one, winds up metres


def _accelerations_text(crane: Crane, accelerations: Sequence[float]) -> str:
    """Return accelerations of the drives to read, those of rotations in degrees."""
    texts = []
    for joint, acceleration in zip(crane.layout.driven, accelerations, strict=True):
        turns = joint.kind == "revolute"
        texts.append(f"{math.degrees(acceleration):.3g} °/s²" if turns else f"{acceleration:.3g}")
    return f"{in_words(texts)} m/s²"  # as in `rates_text`


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
        f"largest accelerations of {in_words(drives)}",
        _accelerations_text(crane, limits.accelerations),
        origin,
        "[drives] accelerations",
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


def _of_surroundings(site: Site) -> Iterator[Assumption]:
    """Yield the ground and what stands on the site."""
    yield Assumption(
        "ground", f"level, at a height of {site.ground:g} m", Origin.ENTERED, "[ground] height"
    )
    names = [solid.name for solid in site.solids]
    listed = ", ".join(names[:MAX_LISTED])
    if len(names) > MAX_LISTED:
        listed = f"{listed} and {len(names) - MAX_LISTED} more"
    value = f"{len(names)}: {listed}" if names else "none; nothing else is on the site"
    yield Assumption("obstacles and zones", value, Origin.ENTERED, "[[box]] and the like")
    yield Assumption(
        "wind on the structure of the crane",
        "none, in service and out of service",
        Origin.ASSUMED,
    )


def _origin(site: Site, field: str, value: float, default: float) -> Origin:
    """Return the origin of a value of a site that has a default. One that equals it counts as
    entered only if the site says so.
    """
    return Origin.ENTERED if field in site.entered or value != default else Origin.DEFAULT
