"""Sines and cosines that are turned from step to step instead of computed anew."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from llvmlite import ir

from cranedyn.compiled.angles import LONGER, SHORTER, Turn
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.machine import translate
from cranedyn.controllers import hold_controller
from cranedyn.dynamics.integrators import rk4
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane, locked

LANES = 8


Way = Callable[[Code, Turn], tuple[Value, Value]]

WAYS: dict[str, Way] = {
    "in a step": lambda code, turn: code.sine_and_cosine(turn.angle),
    "after a step": lambda code, turn: turn.rotate(SHORTER),
    "after a step, mended": lambda code, turn: turn.refine(turn.rotate(SHORTER)),
}


def _turned(before: np.ndarray, by: np.ndarray, way: str) -> np.ndarray:
    """Sine and cosine of `before + by`, shape (2, LANES), by code that knows those of `before`."""
    module = ir.Module()
    code = Code(module, "run", ["given", "found"], LANES)
    angle, step = (code.load(code.argument["given"], i * LANES) for i in range(2))
    code.sine_and_cosine(angle)
    turn = code.turn(code.advanced(angle, step))
    assert turn is not None
    for i, value in enumerate(WAYS[way](code, turn)):
        code.store(value, code.argument["found"], i * LANES)
    code.end()
    given = np.ascontiguousarray([before, by])
    found = np.empty((2, LANES))
    machine = translate(module)
    machine.function("run", 2)(given.ctypes.data, found.ctypes.data)
    return found


@pytest.mark.parametrize(
    ("way", "largest"),
    [
        *product(WAYS, [1e-9, 1e-3, SHORTER.limit]),
        *product(["in a step", "after a step, mended"], [LONGER.limit, 3.0]),
    ],
)
def test_a_turn_costs_two_roundings_at_most(way: str, largest: float) -> None:
    rng = np.random.default_rng(1)
    before = rng.uniform(-3.0, 3.0, LANES)
    by = rng.uniform(-largest, largest, LANES)
    after = before + by
    off = _turned(before, by, way) - [np.sin(after), np.cos(after)]
    # the sum itself is rounded, which moves the angle by half a unit of 4
    assert np.abs(off).max() <= 2.0 * np.finfo(float).eps + 0.5 * np.spacing(4.0)


@pytest.mark.parametrize("way", ["in a step", "after a step, mended"])
def test_a_lane_that_turns_far_is_computed_anew_and_no_other_lane_feels_it(way: str) -> None:
    before = np.linspace(-1.0, 1.0, LANES)
    by = np.full(LANES, 1e-3)
    by[5] = 1e-2
    calm = _turned(before, by, way)
    by[3] = 2.0
    found = _turned(before, by, way)
    assert np.abs(found[:, 3] - [np.sin(before[3] + 2.0), np.cos(before[3] + 2.0)]).max() < 3e-16
    assert np.array_equal(np.delete(found, 3, axis=1), np.delete(calm, 3, axis=1))
    quick = _turned(before, by, "after a step")
    if way != "in a step":  # little turns are as they were
        assert np.array_equal(np.delete(found, [3, 5], axis=1), np.delete(quick, [3, 5], axis=1))


def test_roundings_of_turned_angles_do_not_add_up_over_a_long_control_period() -> None:
    def swing(period: float) -> np.ndarray:
        return simulate(
            crane(),
            locked,
            start=crane().state(phi=0.3, theta=0.2, l=15.0),
            duration=100.0,
            control_period=period,
            drive="motion",
            engine="compiled",
        ).q[-1]

    # 200 000 steps; turned all the way without being computed anew they are 1.4e-13 off
    assert np.abs(swing(100.0) - swing(0.05)).max() < 1e-14


@pytest.mark.slow
def test_rates_told_in_other_units_do_not_drift() -> None:
    start = crane().state(phi=0.2, theta=0.1, l=15.0)
    runs = [
        simulate(crane(), hold_controller(crane()), start=start, duration=300.0, engine=engine)
        for engine in ("pinocchio", "compiled")
    ]
    # By way of a reciprocal of the step they are 1.3e-13 off.
    assert np.abs(runs[0].q - runs[1].q).max() < 5e-14


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.05, 0.5])
def test_long_steps_that_turn_far_are_those_of_pinocchio(period: float) -> None:
    start = crane().state(phi=0.1, phi_dot=4.0, theta_dot=-0.5)
    how: Any = {"duration": 2.0, "dt": 0.05, "control_period": period, "integrator": rk4}
    how |= {"drive": "motion", "validity": "mark"}
    runs = [
        simulate(crane(), locked, start=start, **how, engine=engine)
        for engine in ("pinocchio", "compiled")
    ]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-11


def test_a_crane_in_a_batch_goes_as_alone_however_fast_its_neighbours_swing() -> None:
    calm = crane().state(phi=0.1)
    wild = crane().state(phi=0.1, theta_dot=40.0)
    alone, beside = (
        simulate_batch(crane(), hold_controller(crane()), start=starts, duration=0.5)
        for starts in ([calm], [calm, wild])
    )
    assert np.array_equal(alone.end.q[0], beside.end.q[0])
