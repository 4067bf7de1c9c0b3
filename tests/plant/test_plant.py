"""Cranes that count time and mass in units of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.scalars import array
from cranedyn.model.crane import Crane
from cranedyn.plant.plant import Topology, numbers, plant
from tests.helpers import crane

DT = 1e-3


def _answers(c: Crane, drive: str, q: np.ndarray, v: np.ndarray) -> list[list[np.ndarray]]:
    """Accelerations and efforts in SI, from a plant in SI and from one that counts in steps."""
    values = numbers(c).tolist()
    if drive == "velocity":
        values += np.concatenate(converters(c).response).tolist()
    whole = plant(Topology.of(c), values, drive, drive == "effort")
    command = {
        "effort": np.array([3e4, -2e3, -9e3]),
        "motion": np.array([0.01, -0.3, 0.2]),
        "velocity": v[c.layout.drives] + [0.002, -0.01, 5.0],  # more than the hoist can do
    }[drive]
    force = np.tile([300.0, -200.0, 100.0], len(c.points))
    scaled, units = whole.in_steps(DT)
    found: list[list[Any]] = [
        list(whole.answer(q, v, array(command.tolist()), array(force.tolist()))[:2]),
        list(
            scaled.answer(
                q,
                v * units.time,
                array((command * units.command).tolist()),
                array((force * units.force).tolist()),
            )[:2]
        ),
    ]
    found[1][0] = found[1][0] / units.time**2
    found[1][1] = found[1][1] / (units.command if drive == "effort" else units.force)
    return [[part.astype(float) for part in one] for one in found]


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
@pytest.mark.parametrize(
    "values",
    [{}, {"hook_mass": 300.0, "sling_length": 4.0}, {"rope_stiffness": 4e7, "rope_damping": 1e4}],
)
def test_a_plant_that_counts_in_steps_and_loads_moves_the_same(
    drive: str, values: dict[str, float]
) -> None:
    c = crane(**values)
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = c.start.q + rng.normal(size=c.layout.n) * 0.1
        if drive == "effort":
            q[c.layout.drives[1]] = c.upper[c.layout.drives[1]] + 0.02  # against its buffer
        in_si, in_steps = _answers(c, drive, q, rng.normal(size=c.layout.n) * 0.3)
        for one, other in zip(in_si, in_steps, strict=True):
            assert_allclose(other, one, rtol=1e-9, atol=1e-9 * np.abs(one).max())


def test_work_and_force_have_one_unit() -> None:
    _, units = plant(Topology.of(crane()), numbers(crane()).tolist(), "effort", False).in_steps(DT)
    assert units.time == DT
    assert units.force == pytest.approx(DT**2 / crane().payload_mass)
    assert units.work == pytest.approx(1.0 / units.force)
