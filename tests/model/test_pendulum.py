"""A crane says when its load does not swing as a point at the end of its rope."""

from __future__ import annotations

import math

import pytest

from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.load import load_crane
from cranedyn.model.machines import machine_names
from cranedyn.model.pendulum import LARGEST_DIFFERENCE, pendulum

SMALL = {"payload_mass": 0.2, "hoist_min": 0.1, "hoist_init": 0.3}
"""The load of a table-top crane, with all else as it is for a tonne."""


def test_the_slowest_swing_is_that_of_the_closed_form() -> None:
    """T = 2π √((m l² + I)/(m g l)), with the inertias of load and links about the pivot."""
    found = pendulum(load_crane(**SMALL))
    assert found is not None
    inertia = 0.2 * 0.3**2 + 400.0 + 50.0 + 50.0
    expected = 2.0 * math.pi * math.sqrt(inertia / (0.2 * STANDARD_GRAVITY * 0.3))
    assert found.period == pytest.approx(expected, rel=1e-9)  # round-off
    assert found.length == pytest.approx(0.3, rel=1e-12)
    assert found.point_period == pytest.approx(
        2.0 * math.pi * math.sqrt(0.3 / STANDARD_GRAVITY), rel=1e-12
    )


def test_a_small_load_with_the_inertias_of_a_large_one_is_told_by_its_crane() -> None:
    crane = load_crane(**SMALL)
    (sentence,) = crane.assumptions
    assert "swings with a period of 183 s; a point load 0.3 m below the pivot" in sentence
    assert "would swing with 1.1 s" in sentence
    assert "500 kg m²" in sentence
    assert "payload_inertia and dummy_inertia are at their defaults" in sentence
    assert sentence in repr(crane)
    # The record of a run says it, too.
    assert load_crane(from_record={"crane": crane.record}).assumptions == crane.assumptions


def test_a_small_load_with_inertias_of_its_own_is_an_ordinary_pendulum() -> None:
    crane = load_crane(**SMALL, payload_inertia=1e-4, dummy_inertia=1e-6)
    assert crane.assumptions == ()
    given = load_crane(**SMALL, payload_inertia=1.0, dummy_inertia=1e-6)
    assert "defaults" not in given.assumptions[0]


def test_shipped_cranes_and_machines_swing_as_points_within_a_few_per_cent() -> None:
    cranes = [load_crane(), load_crane(hook_mass=150.0), load_crane(rope_stiffness=2e6)]
    cranes += [load_crane(machine=name) for name in machine_names()]
    for crane in cranes:
        found = pendulum(crane)
        assert found is not None
        assert abs(found.period / found.point_period - 1.0) < 0.1 * LARGEST_DIFFERENCE
        assert not any("point load" in sentence for sentence in crane.assumptions)
