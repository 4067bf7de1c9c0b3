"""Groups of lanes whose steps take turns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.kernel import LANES, KernelOptions, KernelSource
from cranedyn.compiled.plant.plant import Topology, plant_numbers
from cranedyn.compiled.team import TEAM, teams_of
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.interfaces import State
from cranedyn.references import hold
from tests.helpers import crane

GROUPS = 2 * TEAM + 1
"""Groups of a run: two whole teams, and a group that is left over."""

PERIOD = 1e-2

CLOCK: dict[str, Any] = {"duration": 0.3, "dt": 1e-3, "control_period": PERIOD}

RNG = np.random.default_rng(3)

RUNS: dict[str, dict[str, Any]] = {
    "alone in the air": {},
    "pushed, with sensors that are late": {
        "force": RNG.normal(size=(GROUPS * 8, 7, 6)) * 200.0,
        "force_interval": 3,
        "sensor_offset": RNG.normal(size=(GROUPS * 8, 10)) * 0.01,
        "sensor_delay": (np.arange(GROUPS * 8) % 3).tolist(),
    },
    "in long steps": {"integrator": rk4, "dt": 1e-2},
    "behind converters": {"drive": "velocity"},
    "on ships": {
        "base": [BaseMotion.sines(roll=(0.001 * i, 9.0)) for i in range(1, GROUPS * 8 + 1)]
    },
}
"""Arguments of a run of its cranes, one or one for each, by what they are."""


def _run(rows: slice, arguments: dict[str, Any]) -> Batch:
    """Run some of the cranes, which differ in where they start and in what acts on them."""
    count = GROUPS * 8
    rng = np.random.default_rng(4)
    q = crane().start.q + rng.uniform(-1.0, 1.0, (count, 5)) * [0.5, 3.0, 0.2, 0.2, 3.0]
    v = rng.uniform(-0.1, 0.1, (count, 5))
    own = {}
    for name, value in arguments.items():
        has_one_for_each = isinstance(value, list | np.ndarray)
        own[name] = value[rows] if has_one_for_each else value
    controller: Any = hold_controller(crane())
    if "drive" in own:
        still = hold(crane(), crane().start)
        asked = follow(crane(), still, PERIOD)
        controller = as_velocity_command(crane(), asked, drive="motion", control_period=PERIOD)
    return simulate_batch(
        crane(), controller, start=State(q[rows], v[rows]), record=1, **{**CLOCK, **own}
    )


def _bits(batch: Batch) -> list[np.ndarray]:
    """Return what a batch leaves."""
    ends = [batch.end.q, batch.end.v, batch.peak_swing, batch.residual_swing]
    return [*ends, batch.largest_effort, batch.valid_until, batch.q, batch.v, batch.effort]


@pytest.mark.parametrize("name", RUNS)
def test_a_group_in_a_team_goes_as_alone_to_the_bit(name: str) -> None:
    together = _bits(_run(slice(None), RUNS[name]))
    assert np.isfinite(together[0]).all()
    for group in range(GROUPS):
        rows = slice(8 * group, 8 * group + 8)
        for values, alone in zip(together, _bits(_run(rows, RUNS[name])), strict=True):
            assert np.array_equal(values[rows], alone)


def test_a_group_whose_crane_turns_far_harms_no_other_of_its_team() -> None:
    calm = crane().state(phi=0.1)
    wild = crane().state(phi=0.1, theta_dot=40.0)
    starts = [calm] * (LANES["double"] * TEAM)
    alone = simulate_batch(crane(), hold_controller(crane()), start=starts, duration=0.5)
    starts[3] = wild
    beside = simulate_batch(crane(), hold_controller(crane()), start=starts, duration=0.5)
    others = np.arange(len(starts)) != 3
    assert np.array_equal(alone.end.q[others], beside.end.q[others])


def test_teams_are_powers_of_two() -> None:
    assert list(teams_of(range(7), 4)) == [[0, 1, 2, 3], [4, 5], [6]]
    assert list(teams_of([5], 4)) == [[5]]
    assert list(teams_of([], 4)) == []
    assert list(teams_of([2, 3], 1)) == [[2], [3]]


def test_only_short_steps_of_equal_cranes_take_turns() -> None:
    numbers = tuple(plant_numbers(crane()).tolist())
    options = KernelOptions(lanes=8, drive="effort", integrator=semi_implicit_euler)
    source = KernelSource(Topology.of(crane()), numbers, options)
    assert source.works_in_teams
    different = KernelSource(Topology.of(crane()), (None, *numbers[1:]), options)
    assert not different.works_in_teams
