"""Thousands of cranes from the few that tell all others: each as if it had been loaded."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.plant.cranes import load_cranes
from cranedyn.compiled.plant.plant import plant_numbers
from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, ModelError
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, crane, turned

RNG = np.random.default_rng(0)
COUNT = 40


def some(low: float, high: float) -> np.ndarray:
    return RNG.uniform(low, high, COUNT)


CASES: dict[str, dict[str, Any]] = {
    "loads and cables": {"payload_mass": some(500.0, 5000.0), "l": some(5.0, 25.0)},
    "a hook": {
        "hook_mass": some(100.0, 900.0),
        "sling_length": some(2.0, 8.0),
        "payload_mass": some(500.0, 5000.0),
    },
    "all that turns": {
        "slewing_inertia": some(5e5, 2e6),
        "trolley_mass": some(200.0, 900.0),
        "trolley_init": some(5.0, 20.0),
    },
    "damping and limits": {
        "damp_swing": some(0.0, 100.0),
        "hoist_effort": some(5e4, 2e5),
        "payload_izz": some(0.0, 800.0),
    },
    "lighter gravity": {
        "gravity": 1.62,
        "payload_inertia": some(0.0, 900.0),
        "dummy_mass": some(0.0, 50.0),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("values", CASES.values(), ids=list(CASES))
def test_every_crane_has_the_numbers_that_it_has_when_it_is_loaded(values: dict[str, Any]) -> None:
    cranes = load_cranes(**values)
    size = np.abs(cranes.numbers).max(axis=0)
    for i in (0, 7, COUNT - 1):
        own = plant_numbers(cranes[i])
        assert (np.abs(own - cranes.numbers[i]) <= 1e-13 * size).all()  # rounding of a polynomial
        assert_allclose(
            cranes.start.q[i, cranes.layout.drives[:2]],
            cranes[i].start.q[cranes.layout.drives[:2]],
            rtol=1e-13,
        )


@pytest.mark.slow
def test_a_batch_of_them_moves_as_each_does_alone() -> None:
    cranes = load_cranes(payload_mass=some(500.0, 5000.0), l=some(8.0, 20.0), phi=0.1)
    controller = hold_controller(crane())
    batch = simulate_batch(cranes, controller, start=cranes.start, duration=2.0)
    # Where they start if nothing is said.
    assert np.array_equal(batch.end.q, simulate_batch(cranes, controller, duration=2.0).end.q)
    for i in (0, COUNT - 1):
        start = cranes.start
        alone = simulate(
            cranes[i],
            controller,
            start=cranes[i].state(l=start.q[i, -1], phi=0.1),
            duration=2.0,
            validity="mark",
        )
        assert_allclose(batch.end.q[i], alone.q[-1], atol=1e-12)


def test_ten_thousand_take_less_than_two_seconds() -> None:
    load_crane()
    began = time.process_time()
    masses = np.linspace(500.0, 5000.0, 10_000)
    lengths = np.linspace(5.0, 25.0, 10_000)
    assert len(load_cranes(payload_mass=masses, l=lengths)) == 10_000
    assert time.process_time() - began < 2.0  # some 0.5 s


@pytest.mark.slow
def test_an_overhead_crane_has_them_too() -> None:
    cranes = load_cranes(
        ROOT / "urdf" / "overhead_crane.urdf.xacro",
        payload_mass=some(1000.0, 9000.0),
        bridge_mass=some(5e3, 2e4),
    )
    assert len(cranes[3:5]) == 2
    assert cranes[3].payload_mass != cranes[4].payload_mass


def test_starts_are_coordinates_and_rates_by_name() -> None:
    angles = np.array([0.1, -0.1])
    rates = np.array([0.3, 0.2])
    cranes = load_cranes(payload_mass=[800.0, 900.0], phi=angles, phi_dot=rates, l=11.0)
    at = cranes.layout.index
    assert cranes.start.q[:, at("phi")].tolist() == angles.tolist()
    assert cranes.start.v[:, at("phi")].tolist() == rates.tolist()
    assert cranes.start.q[:, at("l")].tolist() == [11.0, 11.0]
    assert not np.delete(cranes.start.v, at("phi"), axis=1).any()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"payload_mass": [800.0, 900.0], "l": [10.0, 11.0, 12.0]}, "payload_mass of shape .2,.*l"),
        ({"payload_mass": 800.0}, "arrays of values is none"),
        ({"payload_mass": [[800.0]]}, "of shape .1, 1."),
        ({"payload_mass": [800.0, np.nan]}, "payload_mass is nan"),
        ({"payload_mass": [800.0, 900.0], "l": [10.0, 99.0]}, "is 99"),
        ({"payload_mass": [800.0, 900.0], "x": [0.5, 10.0]}, "is 0.5"),
        ({"payload_mass": [800.0, 900.0], "rope_stiffness": 3e6}, "are elastic.*give phi, theta"),
        ({"payload_mass": [800.0, 900.0], "colour": 1.0}, "colour"),
    ],
)
def test_what_no_cranes_can_be_made_of_is_refused(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(CraneError, match=sentence):
        load_cranes(**values)


@pytest.mark.slow
def test_a_description_that_is_no_polynomial_of_its_arguments_is_refused(tmp_path: Path) -> None:
    text = (ROOT / "urdf" / "tower_crane.urdf.xacro").read_text()
    mass = '<mass value="$(arg payload_mass)"/>'
    assert text.count(mass) == 1
    shutil.copytree(ROOT / "urdf", tmp_path / "urdf")
    path = tmp_path / "urdf" / "tower_crane.urdf.xacro"
    text = text.replace(mass, "<mass value=\"${1e6 / float('$(arg payload_mass)')}\"/>")
    # Its looks, which xacro takes most of its time for, have no part in the masses.
    looks = '<xacro:arg name="visuals" default="true"/>'
    appearance = tmp_path / "urdf" / "appearance.xacro"
    appearance.write_text(turned(looks, looks.replace("true", "false"), appearance.read_text()))
    path.write_text(text)
    with pytest.raises(ModelError, match=r"payload_mass in another way.*one by one"):
        load_cranes(path, payload_mass=np.linspace(500.0, 2000.0, 9))
    # Nor is where an elastic crane hangs, which is said at the start; its numbers are.
    elastic = dict.fromkeys(("phi", "theta", "rope_stretch"), 0.0)
    masses = np.linspace(500.0, 2000.0, 9)
    cranes = load_cranes(payload_mass=masses, rope_stiffness=3e6, **elastic)
    assert [cranes[i].payload_mass for i in (0, 8)] == [500.0, 2000.0]
    with pytest.raises(ModelError, match="in another way"):
        load_cranes(path, payload_mass=masses, rope_stiffness=3e6, **elastic)
