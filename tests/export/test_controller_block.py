"""Blocks of controllers, in every language, whatever their inputs are: no output is NaN or
infinite, and at a fault the outputs do what is safe for their kind.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cranedyn.compiled.block import LARGEST, FunctionBlock
from cranedyn.compiled.crane_block import crane_block
from cranedyn.compiled.structured_text import structured_text
from cranedyn.controllers import follow, lqr
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.converters import converters
from cranedyn.export.controller_block import controller_block, reference_calls
from cranedyn.export.usual_controllers import CONTROLLERS, usual_controller
from cranedyn.interfaces import Drive
from cranedyn.model.load import load_crane
from cranedyn.references.flat import flat
from tests.export.c_tools import CompiledBlock, output, tool
from tests.export.st_interpreter import InterpretedBlock
from tests.helpers import ROOT, crane
from tests.linear_laws import filtered

CRANE = crane()
PERIOD = 5e-3
MOTION = flat(CRANE, CRANE.state(), CRANE.state(gamma=0.1, x=10.5, l=14.7), 4.0)
TYPICAL = converters(CRANE)

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def usual(name: str, drive: Drive | None = None) -> Callable[[], FunctionBlock]:
    def make() -> FunctionBlock:
        controller, commands = usual_controller(name, CRANE, PERIOD, drive)
        return controller_block(CRANE, controller, drive=commands)

    return make


def rates() -> FunctionBlock:
    law = as_velocity_command(CRANE, lqr(CRANE, MOTION), drive="effort")
    return controller_block(CRANE, law, drive="velocity")


def following() -> FunctionBlock:
    return controller_block(CRANE, follow(CRANE, MOTION), drive="motion")


def with_states() -> FunctionBlock:
    return controller_block(CRANE, filtered(setpoint="run", period=PERIOD))


BLOCKS: dict[str, tuple[str, Callable[[], FunctionBlock]]] = {
    "hold": ("effort", usual("hold")),
    "lqr": ("effort", usual("lqr")),
    "integral": ("effort", usual("integral")),
    "observer": ("effort", usual("observer")),
    "predictive": ("effort", usual("predictive")),
    "shaper": ("position", usual("shaper")),
    "yielding": ("motion", usual("yielding")),
    "follow": ("motion", following),
    "lqr, rates": ("velocity", rates),
    "hold, rates": ("velocity", usual("hold", "velocity")),
    "yielding, rates": ("velocity", usual("yielding", "velocity")),
    "shaper, rates": ("velocity", usual("shaper", "velocity")),
    "states": ("effort", with_states),
}
"""Kind of the outputs, and the block, by name."""

HOSTILE = [
    *(0.0, 5e-324, 1e-310, 1e-160, 1e-45, 1e-30, 1e-9, 0.5, 1.0, 30.0, 1e3, 1e6, 2e6, 1e9),
    *(1e12, 1.0000001e12, 1e20, 1e38, 1e39, 1e154, 1e155, 1e300, 1e308, np.inf, np.nan),
]
"""Inputs that break arithmetic: underflow, overflow of squares and products, and no numbers."""


def hostile_rows(block: FunctionBlock, rows: int, seed: int = 0) -> np.ndarray:
    """Inputs in each call, shape (rows, inputs): one in ten hostile, the others about the start."""
    rng = np.random.default_rng(seed)
    starts = np.array([variable.start for variable in block.of_kind("input")])
    table = starts + rng.uniform(-0.5, 0.5, (rows, len(starts)))
    values = rng.choice([*HOSTILE, *(-x for x in HOSTILE)], table.shape)
    # Every third sequence of 30 calls is hostile in all inputs, others in a few.
    share = np.where(np.arange(rows) // 30 % 3 == 0, 0.5, 0.02)[:, None]
    return np.where(rng.uniform(size=table.shape) < share, values, table)


Runner = Callable[[np.ndarray, bool], tuple[np.ndarray, bool]]
"""A block: from inputs and whether to reset to outputs and whether it is at fault."""


def in_c(block: FunctionBlock, folder: Path, precision: Any = "double") -> Runner:
    compiled = CompiledBlock(block, folder, precision)
    inputs, outputs = ([v.name for v in block.of_kind(kind)] for kind in ("input", "output"))

    def call(row: np.ndarray, reset: bool) -> tuple[np.ndarray, bool]:
        if reset:
            compiled.call("reset")
        for name, value in zip(inputs, row.tolist(), strict=True):
            setattr(compiled.memory, name, value)
        sound = compiled.call()
        assert sound != compiled.memory.fault
        return np.array([getattr(compiled.memory, name) for name in outputs]), not sound

    return call


def in_structured_text(block: FunctionBlock) -> Runner:
    interpreted = InterpretedBlock(structured_text(block))
    inputs, outputs = ([v.name for v in block.of_kind(kind)] for kind in ("input", "output"))

    def call(row: np.ndarray, reset: bool) -> tuple[np.ndarray, bool]:
        interpreted.call(reset=reset, **dict(zip(inputs, row.tolist(), strict=True)))
        memory = interpreted.memory
        return np.array([memory[name] for name in outputs], dtype=float), memory["fault"]

    return call


def largest_change(kind: str) -> np.ndarray:
    """Largest change of the outputs from one call at fault to the next, by the drives' data."""
    if kind == "effort":
        return CRANE.effort_limit * PERIOD / 0.25
    if kind == "velocity":
        # Drives of `converters` reach their usual rates in 3, 2.5 and 1.5 s.
        return np.array([0.0838, 1.583, 1.0]) / [3.0, 2.5, 1.5] * PERIOD
    return np.zeros(3)


def check_hostile(
    block: FunctionBlock, kind: str, call: Runner, table: np.ndarray, slack: float
) -> int:
    """Check the call of every row, to a relative slack for round-off; return how many faults
    began.
    """
    used = block.of_kind("input")
    lowest = np.array([max(v.lower, -LARGEST) for v in used])
    limits = np.array([[v.lower, v.upper] for v in block.of_kind("output")]) * (1.0 + slack)
    at_start = np.array([variable.start for variable in block.of_kind("output")])
    last = at_start
    began = 0
    was_at_fault = False
    for k, row in enumerate(table):
        reset = k % 30 == 0
        if reset:
            was_at_fault = False
            last = at_start
        outputs, fault = call(row, reset)
        assert np.isfinite(outputs).all(), (row, outputs)
        assert (limits[:, 0] <= outputs).all() and (outputs <= limits[:, 1]).all()
        impossible = ~((row >= lowest) & (row <= LARGEST))
        assert fault or not (impossible.any() or was_at_fault)
        if fault and kind != "motion":
            change = np.abs(outputs - last)
            assert (change <= largest_change(kind) * (1.0 + slack) + slack * np.abs(last)).all()
        began += fault and not was_at_fault
        last = outputs
        was_at_fault = fault
    return began


@pytest.mark.slow
@needs_gcc
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", BLOCKS)
def test_no_output_in_c_is_nan_or_jumps_at_a_fault(
    name: str, precision: Any, tmp_path: Path
) -> None:
    if name == "predictive" and precision == "single":
        pytest.skip("predictive control is refused in single precision")
    kind, make = BLOCKS[name]
    block = make()
    call = in_c(block, tmp_path, precision)
    rows = 300 if name == "predictive" else 3000
    table = hostile_rows(block, rows)
    slack = 1e-12
    if precision == "single":
        table = table.astype(np.float32).astype(float)
        slack = 1e-6
    assert check_hostile(block, kind, call, table, slack) > rows / 100


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in BLOCKS if name != "predictive"])
def test_no_output_in_structured_text_is_nan_or_jumps_at_a_fault(
    name: str,
) -> None:
    kind, make = BLOCKS[name]
    block = make()
    table = hostile_rows(block, 1500)
    assert check_hostile(block, kind, in_structured_text(block), table, 1e-12) > 15


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(), min_size=14, max_size=14))
def test_yielding_drives_are_never_commanded_what_is_no_number(inputs: list[float]) -> None:
    outputs, fault = YIELDING(np.array(inputs), True)
    limits = TYPICAL.accelerations
    assert np.isfinite(outputs).all() and (np.abs(outputs) <= limits).all()
    if fault:
        assert (outputs == 0.0).all()  # no drive has moved since the reset


YIELDING = in_structured_text(usual("yielding")())


@pytest.mark.parametrize("length", [-1e-300, -0.5, -np.inf])
def test_a_rope_of_negative_length_is_a_fault_of_yielding_drives(length: float) -> None:
    row = np.array([v.start for v in usual("yielding")().of_kind("input")])
    assert not YIELDING(row, True)[1]
    row[4] = length
    outputs, fault = YIELDING(row, False)
    assert fault and (outputs == 0.0).all()


NAMES = [v.name for v in usual("yielding")().of_kind("input")]


def test_accelerations_at_a_fault_brake_each_drive_to_rest_within_its_limit() -> None:
    row = np.array([v.start for v in usual("yielding")().of_kind("input")])
    rates = np.array([0.06, -1.2, 0.8])
    row[NAMES.index("gamma_dot") : NAMES.index("l_dot") + 1] = rates
    YIELDING(row, True)
    row[0] = np.nan
    steps = np.ceil(np.abs(rates) / (TYPICAL.accelerations * PERIOD)).astype(int)
    for k in range(steps.max() + 20):
        outputs, fault = YIELDING(row, False)
        assert fault and (np.abs(outputs) <= TYPICAL.accelerations).all()
        full = k < steps - 1
        assert np.allclose(outputs[full], -(np.sign(rates) * TYPICAL.accelerations)[full])
        rates = rates + PERIOD * outputs
    assert np.abs(rates).max() < 1e-12 and np.abs(outputs).max() < 1e-9


def test_a_drive_is_not_braked_for_longer_than_from_its_largest_rate() -> None:
    row = np.array([v.start for v in usual("yielding")().of_kind("input")])
    row[NAMES.index("x_dot")] = 1e11  # a reading that is a number, and impossible
    YIELDING(row, True)
    row[0] = np.nan
    limit = float(CRANE.rate_limit[1])
    braking = sum(float(YIELDING(row, False)[0][1]) * PERIOD for _ in range(5000))
    assert braking == pytest.approx(-limit, rel=1e-9)


def test_wherever_the_jib_stands_an_exported_lqr_expects_the_load_to_hang_plumb() -> None:
    luffing = load_crane(urdf=ROOT / "urdf" / "luffing_crane.urdf.xacro")
    make = CONTROLLERS["lqr"][1]
    block = controller_block(luffing, make(luffing, PERIOD))
    call = in_structured_text(block)
    inputs, expected = reference_calls(luffing, make(luffing, PERIOD), block, rows=20)
    found = np.array([call(row, False)[0] for row in inputs])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    # Where the jib stands 0.1 rad higher, at its setpoint and with the load at rest, no effort
    # beyond those of the start is needed: the swing is measured from the jib.
    row = {variable.name: variable.start for variable in block.of_kind("input")}
    at_start, _ = call(np.array([*row.values()]), True)
    q = luffing.start.q.copy()
    q[luffing.layout.index("luff")] += 0.1
    row |= dict(zip(luffing.layout.symbols, luffing.resting(q).tolist(), strict=True))
    row["luff_set"] += 0.1
    elsewhere, _ = call(np.array([*row.values()]), True)
    np.testing.assert_allclose(elsewhere, at_start, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_an_observer_believes_in_the_effort_that_acts_not_in_the_one_it_asks_for() -> None:
    weak = crane(trolley_effort=2e4)
    make = CONTROLLERS["observer"][1]
    block = controller_block(weak, make(weak, PERIOD))
    call = in_structured_text(block)
    inputs, expected = reference_calls(weak, make(weak, PERIOD), block, rows=100)
    found = np.array([call(row, k == 0)[0] for k, row in enumerate(inputs)])
    cut = np.abs(expected[:, 1]) == 2e4
    assert 10 < cut.sum() < 95
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.slow
def test_rates_keep_to_what_converters_of_a_large_crane_reach() -> None:
    call = in_structured_text(rates())
    row = np.array([v.start for v in rates().of_kind("input")])
    row[:3] += [30.0, -300.0, 300.0]
    found, _ = call(row, True)
    # A tenth beyond 0.8 rpm, 95 m/min and 60 m/min.
    usual_rates = np.array([0.8 * 2.0 * np.pi / 60.0, 95.0 / 60.0, 1.0])
    np.testing.assert_allclose(np.abs(found), 1.1 * usual_rates, rtol=1e-3)


def test_a_follower_at_fault_brakes_at_the_ramps_of_a_large_crane() -> None:
    block = following()
    call = in_structured_text(block)
    names = [v.name for v in block.of_kind("input")]
    row = np.array([v.start for v in block.of_kind("input")])
    row[names.index("x_dot")] = 1.0
    call(row, True)
    row[names.index("gamma_dot")] = np.nan
    found, fault = call(row, False)
    # 95 m/min in 2.5 s
    assert fault and found == pytest.approx([0.0, -1.583 / 2.5, 0.0])


def test_efforts_at_a_fault_end_at_the_weight_of_the_load_after_a_quarter_of_a_second() -> None:
    call = in_structured_text(usual("hold")())
    row = np.array([v.start for v in usual("hold")().of_kind("input")])
    row[2] -= 100.0  # the hoist is far above its setpoint, so that its effort is at the limit
    before, _ = call(row, True)
    assert before[2] == 100e3
    row[0] = np.inf
    outputs = before
    for k in range(1, 50):  # of 5 ms
        outputs, fault = call(row, False)
        assert fault and outputs[2] == pytest.approx(100e3 - k / 50 * 100e3)
    for _ in range(6):  # a tenth of the limit further, to the weight
        outputs, _ = call(row, False)
    assert outputs.tolist() == [0.0, 0.0, -9810.0]  # 1,000 kg


def test_a_shaper_at_fault_holds_its_position_until_a_reset() -> None:
    call = in_structured_text(usual("shaper")())
    setpoint = np.array([0.3, 18.0, 7.0])
    assert call(setpoint, True)[0] == pytest.approx(setpoint)
    for bad in ([0.3, np.nan, 7.0], [0.0, 10.0, 15.0], [1e13, 10.0, 15.0]):
        outputs, fault = call(np.array(bad), False)
        assert fault and outputs == pytest.approx(setpoint)
    outputs, fault = call(np.array([0.0, 10.0, 15.0]), True)
    assert not fault and outputs == pytest.approx([0.0, 10.0, 15.0])


@pytest.mark.slow
@needs_gcc
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_a_crane_in_c_stands_still_at_a_fault_and_is_never_nan(
    drive: Any, precision: Any, tmp_path: Path
) -> None:
    block = crane_block(CRANE, drive=drive)
    compiled = CompiledBlock(block, tmp_path, precision)
    rng = np.random.default_rng(0)
    states = [v.name for v in block.of_kind("state")]
    computed = [v.name for v in block.of_kind("state", "output")]
    inputs = block.of_kind("input", "parameter")
    faults = 0
    for k in range(1500):
        if k % 30 == 0:
            compiled.call("reset")
        for v in inputs:
            if rng.uniform() < 0.03:
                setattr(compiled.memory, v.name, rng.choice(HOSTILE) * rng.choice([-1.0, 1.0]))
        state = [getattr(compiled.memory, name) for name in states]
        sound = compiled.call("outputs" if k % 2 else "step")
        assert np.isfinite([getattr(compiled.memory, name) for name in computed]).all()
        for v in inputs:
            value = getattr(compiled.memory, v.name)
            possible = v.lower * (1.0 - 1e-6) <= value <= v.upper and abs(value) <= 1e12
            assert possible or not sound
        if not sound:
            faults += 1
            assert compiled.memory.valid == 0.0
            assert [getattr(compiled.memory, name) for name in states] == state
    assert faults > 100


@pytest.mark.slow
@needs_gcc
def test_a_crane_in_c_is_not_valid_where_a_converter_cuts_a_command(tmp_path: Path) -> None:
    compiled = CompiledBlock(crane_block(CRANE, drive="velocity"), tmp_path)
    for command, valid in ((1.7, 1.0), (1.8, 0.0), (-1.7, 1.0), (-1.8, 0.0)):
        compiled.memory.x_dot_command = command  # the limit is 1.1 times 1.583 m/s
        assert compiled.call("outputs") and compiled.memory.valid == valid


@needs_gcc
@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_c_is_not_compiled_by_what_removes_its_checks(flag: str, tmp_path: Path) -> None:
    from cranedyn.compiled.c_text import c_header, c_source

    block = usual("hold")()
    (tmp_path / "controller.h").write_text(c_header(block))
    (tmp_path / "controller.c").write_text(c_source(block))
    with pytest.raises(AssertionError, match="remove the checks that find NaN"):
        output(tool("gcc"), flag, "-c", "controller.c", folder=tmp_path)
