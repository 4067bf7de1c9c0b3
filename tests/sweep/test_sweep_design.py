"""Designs: every combination once, boxes filled evenly, the same seed the same points."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from cranedyn.errors import CraneError
from cranedyn.sweep import cross, grid, sample

_names = st.sampled_from(["mass", "length", "strategy", "wind", "größe"])
_numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4)
_words = st.lists(st.text("abc δ", min_size=1, max_size=5), min_size=1, max_size=3)
_grids = st.dictionaries(_names, _numbers | _words, min_size=1, max_size=3)


@given(_grids)
@pytest.mark.slow
def test_a_grid_is_the_product_of_its_values_the_last_changing_fastest(
    values: dict[str, list],
) -> None:
    design = grid(**values)
    assert list(design.columns) == list(values)
    assert list(zip(*design.columns.values(), strict=True)) == list(
        itertools.product(*values.values())
    )


@given(_grids, _grids)
def test_a_product_of_grids_is_the_grid_of_both(a: dict[str, list], b: dict[str, list]) -> None:
    if a.keys() & b.keys():
        with pytest.raises(CraneError, match="Both designs have the parameter"):
            cross(grid(**a), grid(**b))
    else:
        assert cross(grid(**a), grid(**b)).fingerprint == grid(**a, **b).fingerprint


def test_one_value_is_shared_by_all_cases_and_whole_numbers_are_numbers() -> None:
    design = grid(strategy="flat", mass=range(3), seed=np.arange(2), on=True)
    assert len(design) == 6
    assert set(design.columns["strategy"]) == {"flat"}
    assert {name: values.dtype.kind for name, values in design.columns.items()} == {
        "strategy": "U",
        "mass": "f",
        "seed": "f",
        "on": "f",
    }


_boxes = st.dictionaries(
    _names, st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)), min_size=1, max_size=4
)


@given(
    _boxes, st.integers(1, 70), st.integers(0, 1000), st.sampled_from(["sobol", "latin hypercube"])
)
@pytest.mark.slow
def test_samples_stay_in_their_box_and_come_again_from_their_seed(
    box: dict[str, tuple], count: int, seed: int, method: str
) -> None:
    ranges = {name: (low, low + width) for name, (low, width) in box.items()}
    design = sample(count, seed=seed, method=method, **ranges)
    assert len(design) == count
    for name, (low, high) in ranges.items():
        assert ((low <= design.columns[name]) & (design.columns[name] <= high)).all()
    assert design.fingerprint == sample(count, seed=seed, method=method, **ranges).fingerprint
    assert design.fingerprint != sample(count, seed=seed + 1, method=method, **ranges).fingerprint


@pytest.mark.parametrize(
    ("count", "method"), [(37, "latin hypercube"), (64, "latin hypercube"), (64, "sobol")]
)
def test_every_slice_of_every_range_has_one_point(count: int, method: str) -> None:
    design = sample(count, seed=3, method=method, a=(0.0, 1.0), b=(-2.0, 6.0), c=(10.0, 11.0))
    for values, low, width in zip(
        design.columns.values(), (0.0, -2.0, 10.0), (1.0, 8.0, 1.0), strict=True
    ):
        assert_array_equal(np.sort(np.floor((values - low) / width * count)), np.arange(count))


def test_sobol_points_are_one_in_each_box_of_a_power_of_two() -> None:
    """A (0, m, 2)-net in base 2 (Sobol 1967): so it is for every division of 64 boxes into rows and
    columns.
    """
    design = sample(64, seed=5, a=(0.0, 1.0), b=(0.0, 1.0))
    for rows in (1, 2, 4, 8, 16, 32, 64):
        boxes = np.floor(design.columns["a"] * rows) * 64 + np.floor(
            design.columns["b"] * (64 // rows)
        )
        assert len(set(boxes)) == 64


def test_sobol_points_of_a_seed_go_on_from_fewer() -> None:
    many = sample(100, seed=5, a=(0.0, 1.0), b=(2.0, 3.0))
    few = sample(7, seed=5, a=(0.0, 1.0), b=(2.0, 3.0))
    for name, values in few.columns.items():
        assert_array_equal(values, many.columns[name][:7])


def test_a_design_cannot_be_changed_from_outside() -> None:
    mass = np.array([1.0, 2.0])
    design = grid(mass=mass)
    mass[:] = 3.0
    assert_array_equal(design.columns["mass"], [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        design.columns["mass"][0] = 4.0


def test_a_fingerprint_tells_names_values_and_order_apart() -> None:
    designs = [
        grid(a=[1.0, 2.0]),
        grid(a=[2.0, 1.0]),
        grid(b=[1.0, 2.0]),
        grid(a=["1.0", "2.0"]),
        grid(a=[1.0, math.nextafter(2.0, 3.0)]),
        grid(a=[1.0, 2.0], b=1.0),
        grid(b=1.0, a=[1.0, 2.0]),
        grid(a=[1.0]),
    ]
    assert len({design.fingerprint for design in designs}) == len(designs)
