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
from cranedyn.identification.search import Search

INERTIAS = ("payload_mass", "payload_inertia", "dummy_mass", "dummy_inertia")
"""Arguments of a description that are masses and inertias of what swings."""

POINT = 1e-3
"""Share of the assumed inertias that a point load on a light cable has."""


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
    return [
        AssumedInertia(name, prior.value(name), prior.arguments[name].unit)
        for name in INERTIAS
        if name in prior.arguments and name not in prior.values and name not in estimated
    ]


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
    changes: list[tuple[str, dict[str, float]]] = []
    for one in assumed:
        for factor in (0.5, 2.0):
            value = factor * one.value
            text = f"{one.name} {one.value:g} → {value:g} {one.unit}"
            changes.append((text, {one.name: value}))
    point = {one.name: POINT * one.value for one in assumed if one.name.endswith("inertia")}
    if point:
        changes.append(("a point load: no payload_inertia, no dummy_inertia", point))
    effects: list[InertiaEffect] = []
    for done, (text, values) in enumerate(changes):
        if all(value == estimate.model.prior.value(name) for name, value in values.items()):
            continue  # a default of zero
        effects.append(_effect(estimate, text, values))
        if progress is not None:
            progress(done + 1)
    return effects


def _effect(estimate: Estimate, change: str, values: dict[str, float]) -> InertiaEffect:
    """Return how far the estimates move with other values of arguments."""
    model = estimate.model
    prior = replace(model.prior, values={**model.prior.values, **values})
    try:
        search = Search(replace(model, prior=prior), None, 0)
        found = search.solve(estimate.values, list(estimate.noise), 1.0)
    except CraneError:
        return InertiaEffect(change, {}, np.inf, "")
    moved: dict[str, float] = {}
    worst, largest = "", 0.0
    for p, before, after in zip(model.own, estimate.values.tolist(), found.tolist(), strict=False):
        moved[p.name] = after - before
        share = abs(moved[p.name]) / max(estimate.margin(p.name), 1e-300)
        if share >= largest:
            worst, largest = p.name, share
    return InertiaEffect(change, moved, largest, worst)
