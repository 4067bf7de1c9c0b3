"""Code under construction: its sine and cosine, and lanes that do not feel each other."""

from __future__ import annotations

import gc
import math
import mmap
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from llvmlite import ir

from cranedyn.compiled import webassembly
from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.machine import Machine, assembly, translate
from cranedyn.dynamics.scalars import array, common_factor

LANES = 8


@cache
def _machine(lanes: int, made: Callable[[Code, Value], list]) -> Machine:
    module = ir.Module()
    code = Code(module, "run", ["given", "found"], lanes)
    for i, value in enumerate(made(code, code.load(code.argument["given"]))):
        code.store(value, code.argument["found"], i * lanes)
    code.end()
    return translate(module)


def _run(made: Callable[[Code, Value], list], x: np.ndarray, answers: int) -> np.ndarray:
    """What code makes of numbers, a group of lanes at a time, shape (answers, n)."""
    lanes = LANES if len(x) % LANES == 0 else 1
    run = _machine(lanes, made).function("run", 2)
    found = np.empty((len(x) // lanes, answers, lanes))
    groups = np.ascontiguousarray(x.reshape(-1, lanes))
    for group, out in zip(groups, found, strict=True):
        run(group.ctypes.data, out.ctypes.data)
    return found.transpose(1, 0, 2).reshape(answers, -1)


def _sine_and_cosine(code: Code, x: Value) -> list:
    return [np.sin(np.array([x]))[0], np.cos(np.array([x]))[0]]


def _check(x: np.ndarray, found: np.ndarray) -> None:
    """Within two units in the last place; close to the zeros besides, 1e-22 of the angle for the
    rounding of its reduction.
    """
    for exact, values in zip((np.sin(x), np.cos(x)), found, strict=True):
        reduction = 1e-22 * np.abs(x)
        assert (np.abs(values - exact) <= 2.0 * np.spacing(np.abs(exact)) + reduction).all()


@given(st.lists(st.floats(-1e6, 1e6, exclude_min=True, exclude_max=True), min_size=1, max_size=9))
def test_sine_and_cosine_are_those_of_the_library_to_two_units_in_the_last_place(
    angles: list[float],
) -> None:
    x = np.array(angles)
    _check(x, _run(_sine_and_cosine, x, 2))


def test_sine_and_cosine_hold_at_small_angles_quarter_turns_and_everywhere_between() -> None:
    rng = np.random.default_rng(0)
    quarters = np.arange(-640, 640) * (math.pi / 2.0)
    far = np.round(rng.uniform(-6e5, 6e5, 1600)) * (math.pi / 2.0)
    near = np.concatenate(
        [np.nextafter(part, side) for part in (quarters, far) for side in (-np.inf, np.inf)]
    )
    tiny = 10.0 ** rng.uniform(-300, 0, 800) * rng.choice([-1.0, 1.0], 800)
    wide = (rng.uniform(-size, size, 80000) for size in (4.0, 1e6))
    for x in (quarters, far, near, tiny, *wide):
        _check(x, _run(_sine_and_cosine, x, 2))


@pytest.mark.parametrize("angle", [1.1e6, -1e9, math.inf, -math.inf, math.nan])
def test_an_angle_too_large_to_be_reduced_is_not_a_number_and_harms_no_other_lane(
    angle: float,
) -> None:
    x = np.linspace(-7.0, 7.0, LANES)
    others = np.arange(LANES) != 3
    usual = _run(_sine_and_cosine, x, 2)
    x[3] = angle
    found = _run(_sine_and_cosine, x, 2)
    assert np.isnan(found[:, 3]).all()
    assert found[:, others].tolist() == usual[:, others].tolist()


@given(st.lists(st.floats(-0.78, 0.78), min_size=LANES, max_size=LANES), st.floats(-1e5, 1e5))
def test_a_lane_answers_the_same_whatever_path_its_neighbours_take(
    angles: list[float], far: float
) -> None:
    x = np.array(angles)
    beside = np.concatenate([x[:-1], [far]])
    # To the bit.
    found, alone = (_run(_sine_and_cosine, one, 2)[:, :-1] for one in (beside, x))
    assert found.tolist() == alone.tolist()


def _folded(code: Code, x: Value) -> list:
    sums = [x + 0.0, 0.0 + x, x - 0.0, 0.0 - x]
    return [*sums, x * 1.0, -1.0 * x, x * 0.0, x / 4.0, 3.0 / x, 0.0 / x]


def test_what_is_known_is_folded_and_the_rest_computed() -> None:
    x = np.linspace(0.5, 4.0, LANES)
    zero = np.zeros(LANES)
    expected = np.array([x, x, x, -x, x, -x, zero, x / 4.0, 3.0 / x, zero])
    assert _run(_folded, x, 10).tolist() == expected.tolist()
    code = Code(ir.Module(), "run", ["given"], 1)
    value = code.load(code.argument["given"])
    assert value + 0.0 is value
    assert value * 1.0 is value
    assert value * 0.0 == 0.0


def _cut(code: Code, x: Value) -> list:
    return [code.clipped(x, -1.0, 1.0)]


def test_a_value_cut_to_a_range_is_that_of_numpy_and_what_is_no_number_stays() -> None:
    x = np.array([-np.inf, -2.0, -1.0, 0.5, 1.0, 3.0, np.inf, np.nan])
    np.testing.assert_array_equal(_run(_cut, x, 1)[0], x.clip(-1.0, 1.0))


def _powers(code: Code, x: Value) -> list:
    doubled, angle = code.variables([x, 0.0])
    with code.loop(0, 5) as i:
        with code.when(code.builder.icmp_signed(">", i, code.integer(1))):
            doubled.set(doubled.get() * 2.0)
        angle.set(angle.get() + np.sin(np.array([doubled.get()]))[0])
    return [doubled.get(), angle.get(), np.sin(np.array([doubled.get()]))[0]]


def test_loops_repeat_and_a_sine_known_in_a_loop_is_not_taken_for_that_behind_it() -> None:
    x = np.linspace(-1.0, 1.0, LANES)
    found = _run(_powers, x, 3)
    assert found[0].tolist() == (8.0 * x).tolist()
    # rounding.
    np.testing.assert_allclose(
        found[1], 2 * np.sin(x) + np.sin(2 * x) + np.sin(4 * x) + np.sin(8 * x), atol=1e-15
    )
    np.testing.assert_allclose(found[2], np.sin(8 * x), atol=1e-15)


def _resident() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE / 1e6


@pytest.mark.slow
def test_code_that_is_part_of_a_cycle_is_freed_in_the_right_order() -> None:
    for _ in range(5):
        made = _machine.__wrapped__(1, _cut)
        # The collector of cycles frees in an order of its own.
        made.engine.back = made.context.back = cycle = [made]
        cycle.append(cycle)
        del made, cycle
        gc.collect()


@pytest.mark.slow
def test_code_that_nobody_needs_any_more_leaves_no_memory_behind() -> None:
    def made(i: int) -> None:
        _machine.__wrapped__(1, lambda code, x: [np.sin(np.array([x + float(i)]))[0]])
        gc.collect(1)  # of young cycles, which are many here

    for i in range(50):
        made(i)
    before = _resident()
    for i in range(50, 170):
        made(i)
    # passes and constants that are not freed are 0.1 MB for each of these; pages that the allocator
    # keeps have been taken before
    assert _resident() - before < 3.0


def test_a_section_has_no_name_in_the_symbol_table_of_an_object_file() -> None:
    section = [3, 0, 1]  # kind, flags, index
    function = [0, 0, 5, 1, ord("f")]  # and the length of its name, and the name
    table = bytes([2, *section, *function])
    (found,) = webassembly._functions_of_symbol_table(table)
    assert (found.name, found.index) == ("f", 5)


def test_a_module_that_was_translated_for_another_platform_remains_one_of_this_processor() -> None:
    """A module of another platform's sizes and alignments must not become code of this one."""
    module = ir.Module()
    code = Code(module, "run", ["given"], 1)
    code.end()
    before = str(module)
    assert assembly(module, webassembly.TRIPLE, "")
    assert str(module) == before


def test_numbers_know_the_factor_that_they_share() -> None:
    def divided(code: Code, x: Value) -> list:
        y = x + 1.0
        z = x + 2.0
        factor, rest = common_factor(array([x * y, 0.0, -(x * z)]))
        assert rest[1] == 0.0
        return [factor, rest[0], rest[2]]

    x = np.array([0.5, 3.0])
    assert np.array_equal(_run(divided, x, 3), [x, x + 1.0, -(x + 2.0)])


def test_numbers_without_a_factor_in_common_are_as_they_were() -> None:
    code = Code(ir.Module(), "run", ["given"], 1)
    x = code.load(code.argument["given"])
    y = x + 1.0
    for numbers in (array([x * x, y]), array([x * y]), array([0.0, 0.0]), array([2.0, 4.0])):
        factor, rest = common_factor(numbers)
        assert factor == 1.0
        assert rest is numbers
