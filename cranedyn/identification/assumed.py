"""Masses and inertias that nobody stated, and how far an estimate moves with them.

A record of a swing does not tell the inertia of the load from the length of its pendulum. What an
interval says holds for the inertias that were assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.identification.estimate import Estimate
from cranedyn.identification.least_squares import Search

INERTIAS = ("payload_mass", "payload_inertia", "dummy_mass", "dummy_inertia")
"""Arguments of a description that are masses and inertias of what swings."""

POINT_LOAD_SHARE = 1e-3
"""Share of the assumed inertias that stands for a point load on a light cable."""


@dataclass(frozen=True)
class AssumedInertia:
    """A mass or an inertia that nobody stated.

    Attributes:
        name: Name of the argument.
        value: The default that acted.
        unit: Its unit.
    """

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class InertiaEffect:
    """How estimates move with masses and inertias that nobody stated.

    Attributes:
        change: What was changed, such as "payload_inertia 400 → 200 kg m^2".
        moved: Change of each estimated parameter of the crane, by name; empty where the records
            cannot be explained then.
        intervals: Largest of these changes, in half widths of the interval of its parameter.
        parameter: Name of that parameter.
    """

    change: str
    moved: dict[str, float]
    intervals: float
    parameter: str


def assumed_inertias(estimate: Estimate) -> list[AssumedInertia]:
    """Return the masses and inertias that were neither stated nor estimated."""
    prior = estimate.model.prior
    estimated = {p.name for p in estimate.model.own}
    assumed = []
    for name in INERTIAS:
        is_known = name in prior.values or name in estimated
        if name in prior.arguments and not is_known:
            unit = prior.arguments[name].unit
            assumed.append(AssumedInertia(name, prior.value(name), unit))
    return assumed


def inertia_effects(
    estimate: Estimate, progress: Callable[[int], object] | None = None
) -> list[InertiaEffect]:
    """Return how far the estimates move if each assumed mass or inertia is half as large or twice
    as large, and if the load is a point.

    Args:
        estimate: The estimate.
        progress: Called with the number of changes tried so far.
    """
    assumed = assumed_inertias(estimate)
    # What is changed, in words, and the values of the arguments.
    changes: list[tuple[str, dict[str, float]]] = []
    for inertia in assumed:
        for factor in (0.5, 2.0):
            value = factor * inertia.value
            text = f"{inertia.name} {inertia.value:g} → {value:g} {inertia.unit}"
            changes.append((text, {inertia.name: value}))
    point_load = {}
    for inertia in assumed:
        if inertia.name.endswith("inertia"):
            point_load[inertia.name] = POINT_LOAD_SHARE * inertia.value
    if point_load:
        changes.append(("a point load: no payload_inertia, no dummy_inertia", point_load))
    effects: list[InertiaEffect] = []
    for done, (text, values) in enumerate(changes, start=1):
        if all(value == estimate.model.prior.value(name) for name, value in values.items()):
            continue  # a default of zero
        effects.append(_effect(estimate, text, values))
        if progress is not None:
            progress(done)
    return effects


def _effect(estimate: Estimate, change: str, values: dict[str, float]) -> InertiaEffect:
    """Return how far the estimates move with other values of arguments, found by a search over the
    whole records from the present estimates.
    """
    model = estimate.model
    prior = replace(model.prior, values={**model.prior.values, **values})
    try:
        search = Search(replace(model, prior=prior), None, 0)
        found = search.solve(estimate.values, list(estimate.noise), 1.0)
    except CraneError:
        return InertiaEffect(change, {}, np.inf, "")
    moved: dict[str, float] = {}
    most_moved = ""
    largest = 0.0
    for i, p in enumerate(model.own):
        moved[p.name] = float(found[i]) - float(estimate.values[i])
        intervals = abs(moved[p.name]) / max(estimate.margin(p.name), 1e-300)
        if intervals >= largest:
            most_moved = p.name
            largest = intervals
    return InertiaEffect(change, moved, largest, most_moved)
