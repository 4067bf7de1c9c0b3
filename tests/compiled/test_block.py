"""Function blocks: what is a fault, and what a block at fault gives, in C and Structured Text."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cranedyn.compiled.block import FAULT, BlockCode, FunctionBlock, Variable
from cranedyn.compiled.structured_text import structured_text
from cranedyn.dynamics.scalars import square_root
from tests.export.c_tools import CompiledBlock
from tests.export.st_interpreter import InterpretedBlock

LAWS: dict[str, tuple[Callable[[Any], Any], Callable[[float], bool]]] = {
    # Input to result, and whether the result is a number of at most 1e30, by hand.
    "root": (lambda x: square_root(x), lambda x: x >= 0.0),
    "inverse": (lambda x: 1.0 / x, lambda x: abs(x) >= 1e-30),
    "cube": (lambda x: x * x * x, lambda x: abs(x) <= 1e10),
    "sine": (lambda x: x.sin() * x.cos(), lambda x: abs(x) < 1e6),
}

INPUTS = [0.0, -0.0, 5e-324, 1e-200, 1e-31, 1e-29, 0.5, 9e5, 1.1e6, 9e9, 1.1e10, 1e12]
INPUTS += [1.1e12, 1e300, math.inf, math.nan]


def block_of(law: Callable[[Any], Any]) -> FunctionBlock:
    """A block with a law, an output that is cut to 1 and its copy, and a count of its calls."""
    variables = (
        Variable("x", "input"),
        Variable("gain", "parameter", start=1.0, lower=0.5, upper=2.0),
        Variable("y", "output", start=0.25, lower=-1.0, upper=1.0),
        Variable("calls", "state"),
        Variable("kept", "state", start=0.25),
    )
    block = FunctionBlock("law", "A law.", 0.01, variables, at_fault="y is halved.")

    def step(code: BlockCode) -> dict[str, Any]:
        return {"y": code.get("gain") * law(code.get("x")), "calls": code.get("calls") + 1.0}

    def fault(code: BlockCode) -> dict[str, Any]:
        half = code.get("kept") * 0.5
        return {"y": half, "kept": half}

    block.emit("step", step, {"kept": "y"})
    block.emit(FAULT, fault)
    return block


def check(call: Callable[..., tuple[float, float, bool]], name: str, inputs: list[float]) -> None:
    _, is_number = LAWS[name]
    for x in inputs:
        y, calls, fault = call(x=0.5, gain=1.0, reset=True)
        assert not fault
        assert calls == 1.0
        first = y
        y, calls, fault = call(x=x, gain=1.0)
        assert fault == (not (abs(x) <= 1e12 and is_number(x))), x
        if not fault:
            assert -1.0 <= y <= 1.0
            assert calls == 2.0
            continue
        assert (y, calls) == (0.5 * first, 1.0)
        y, calls, fault = call(x=0.5, gain=1.0)  # until the reset
        assert (y, calls, fault) == (0.25 * first, 1.0, True)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("name", LAWS)
def test_a_result_that_is_no_number_is_a_fault_in_c(name: str, tmp_path: Path) -> None:
    compiled = CompiledBlock(block_of(LAWS[name][0]), tmp_path)
    memory = compiled.memory

    def call(x: float, gain: float, *, reset: bool = False) -> tuple[float, float, bool]:
        if reset:
            compiled.call("reset")
        memory.x = x
        memory.gain = gain
        sound = compiled.call()
        return memory.y, memory.calls, not sound

    check(call, name, [*INPUTS, *(-x for x in INPUTS)])


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("precision", ["double", "single"])
def test_sines_in_c_are_those_of_mathematics(precision: Any, tmp_path: Path) -> None:
    for name, law, same in (
        ("sine", lambda x: x.sin(), math.sin),
        ("cosine", lambda x: x.cos(), math.cos),
    ):
        compiled = CompiledBlock(block_of(law), tmp_path / name, precision)
        quarters = [0.25 * math.pi * k for k in range(-40, 41)]
        for angle in [*quarters, *(100.0 * angle + 0.3 for angle in quarters), -9.9e5, 9.9e5]:
            compiled.memory.x = angle
            assert compiled.call()
            # The last bits of the value; in single precision the quarters are taken off with the
            # last bits of the angle.
            given = compiled.memory.x
            tolerance = 4e-16 if precision == "double" else 2.0**-23 * (2.0 + abs(given))
            assert abs(compiled.memory.y - same(given)) <= tolerance, (name, given)


@pytest.mark.parametrize("name", ["inverse", "cube"])
def test_a_result_that_is_no_number_is_a_fault_in_structured_text(name: str) -> None:
    # A zero is left out, whose inverse stops some PLCs; a block asks for no such thing.
    call = interpreted(name)
    check(call, name, [x for x in (*INPUTS, *(-x for x in INPUTS)) if x or name == "cube"])


def interpreted(name: str) -> Callable[..., tuple[float, float, bool]]:
    block = InterpretedBlock(structured_text(block_of(LAWS[name][0])))

    def call(x: float, gain: float, *, reset: bool = False) -> tuple[float, float, bool]:
        block.call(x=x, gain=gain, reset=reset)
        return tuple(block.memory[key] for key in ("y", "calls", "fault"))  # type: ignore[return-value]

    return call


@pytest.mark.parametrize("gain", [0.49, 2.01, -1.0, 0.0, math.inf, -math.inf, math.nan, 1e308])
def test_a_parameter_out_of_its_range_is_a_fault(gain: float) -> None:
    call = interpreted("cube")
    assert not call(x=0.5, gain=2.0, reset=True)[2]
    assert call(x=0.5, gain=gain)[2]


def test_an_infinite_result_is_a_fault_although_its_output_has_limits() -> None:
    call = interpreted("cube")
    y, _, fault = call(x=3.0, gain=1.0, reset=True)
    assert (y, fault) == (1.0, False)  # 27, cut to the limit
    y, _, fault = call(x=-9e10, gain=1.0)
    assert (y, fault) == (0.5, True)  # -7e32


def one_sided(side: str) -> FunctionBlock:
    """A block whose output is twice its input, and limited at one side alone."""
    variables = (Variable("x", "input"), Variable("y", "output", **{side: 1.0}))
    block = FunctionBlock("twice", "Twice.", 0.01, variables)
    block.emit("step", lambda code: {"y": code.get("x") * 2.0})
    block.emit(FAULT, lambda code: {"y": 0.0})
    return block


SIDES = {"lower": [1.0, 8.0], "upper": [-8.0, 1.0]}
"""Outputs for inputs of -4 and 4, by the side that is limited."""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("side", SIDES)
def test_an_output_may_be_limited_at_one_side_alone_in_c(side: str, tmp_path: Path) -> None:
    compiled = CompiledBlock(one_sided(side), tmp_path)
    found = []
    for x in (-4.0, 4.0):
        compiled.memory.x = x
        assert compiled.call()
        found.append(compiled.memory.y)
    assert found == SIDES[side]


@pytest.mark.parametrize("side", SIDES)
def test_an_output_may_be_limited_at_one_side_alone_in_structured_text(side: str) -> None:
    block = InterpretedBlock(structured_text(one_sided(side)))
    found = []
    for x in (-4.0, 4.0):
        block.call(x=x)
        found.append(block.memory["y"])
    assert found == SIDES[side]
