"""Controllers in Structured Text, translated by MATIEC, command what they command in Python."""

from __future__ import annotations

import os
import re
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.compiled.block import FunctionBlock, identifiers
from cranedyn.compiled.structured_text import structured_text
from cranedyn.errors import DataError
from cranedyn.export import st
from cranedyn.export.controller_block import controller_block, reference_calls
from cranedyn.export.usual_controllers import CONTROLLERS, RATE_CONTROLLERS, usual_controller
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.simulation.simulate import simulate
from tests.export.c_tools import output, tool
from tests.export.st_interpreter import InterpretedBlock
from tests.helpers import ROOT, crane
from tests.linear_laws import PERIOD, filtered

CRANE = crane()
LIBRARY = Path(os.environ.get("MATIEC_LIB", "/usr/local/share/matiec/lib"))

PROGRAM = """
PROGRAM MAIN
VAR c : controller; END_VAR
c();
END_PROGRAM
CONFIGURATION conf
RESOURCE res ON PLC
TASK t(INTERVAL := T#5ms, PRIORITY := 0);
PROGRAM inst WITH t : MAIN;
END_RESOURCE
END_CONFIGURATION
"""


def build_plc(block: FunctionBlock, folder: Path) -> Path:
    """A program that runs a block in Structured Text, translated by MATIEC."""
    translator = tool("iec2c", "none; see .ci/cross")
    (folder / "all.st").write_text(structured_text(block) + PROGRAM)
    output(translator, "-f", "-p", "-I", LIBRARY, "all.st", folder=folder)
    inputs, outputs = (
        [f"block.{v.name.upper()}.value" for v in block.of_kind(kind)]
        for kind in ("input", "output")
    )
    reads = " && ".join(f'scanf("%lf", &{name}) == 1' for name in inputs)
    writes = " ".join(f'printf("%.17g ", {name});' for name in outputs)
    (folder / "driver.c").write_text(
        '#include <stdio.h>\n#include "iec_std_lib.h"\nTIME __CURRENT_TIME;\n'
        'BOOL __DEBUG;\n#include "POUS.h"\n#include "POUS.c"\n'
        "int main(void) {\n  static CONTROLLER block;\n  int reset;\n"
        "  CONTROLLER_init__(&block, 0);\n"
        f'  while (scanf("%d", &reset) == 1 && {reads}) {{\n'
        "    block.RESET.value = reset != 0;\n    CONTROLLER_body__(&block);\n"
        f'    {writes}\n    printf("%d\\n", block.FAULT.value);\n    fflush(stdout);\n  }}\n'
        "  return 0;\n}\n"
    )
    include = LIBRARY / "C"
    output(tool("gcc"), "-w", "-I", include, "driver.c", "-o", "plc", "-lm", folder=folder)
    return folder / "plc"


class SoftPlc:
    """A program of `build_plc` that runs as a process."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __call__(self, inputs: np.ndarray, *, reset: bool = False) -> tuple[np.ndarray, bool]:
        """Outputs, and whether the block is at fault."""
        assert self._process.stdin is not None and self._process.stdout is not None
        print(int(reset), *map(repr, inputs.tolist()), file=self._process.stdin, flush=True)
        *outputs, fault = self._process.stdout.readline().split()
        return np.array(outputs, dtype=float), fault == "1"

    def end(self) -> None:
        """End the process."""
        self._process.communicate()


class PythonPlc:
    """A block in Structured Text, which Python runs."""

    def __init__(self, block: FunctionBlock) -> None:
        self._inputs = [variable.name for variable in block.of_kind("input")]
        self._outputs = [variable.name for variable in block.of_kind("output")]
        self._interpreted = InterpretedBlock(structured_text(block))

    def __call__(self, inputs: np.ndarray, *, reset: bool = False) -> tuple[np.ndarray, bool]:
        """Outputs, and whether the block is at fault."""
        given = dict(zip(self._inputs, inputs.tolist(), strict=True))
        self._interpreted.call(reset=reset, **given)
        memory = self._interpreted.memory
        outputs = [memory[name] for name in self._outputs]
        return np.array(outputs, dtype=float), memory["fault"]

    def end(self) -> None:
        """Nothing runs."""


@cache
def block_of(name: str) -> FunctionBlock:
    """The block of a usual controller."""
    controller, drive = usual(name)
    return controller_block(CRANE, controller, drive=drive)


def usual(name: str) -> tuple[Any, Drive]:
    """A usual controller, with rates as commands if its name ends so, and what it commands."""
    plain, _, rates = name.partition(", ")
    return usual_controller(plain, CRANE, 5e-3, "velocity" if rates else None)


MakePlc = Callable[[str, str], PythonPlc | SoftPlc]
"""From what a block runs on, and the name of its controller, to the block at its start."""

PLCS = ["Python", "MATIEC"]
"""What a block in Structured Text runs on."""


@pytest.fixture(scope="module")
def make_plc(tmp_path_factory: pytest.TempPathFactory) -> MakePlc:
    """Makes a block that runs; each program is built once."""

    @cache
    def program(name: str) -> Path:
        return build_plc(block_of(name), tmp_path_factory.mktemp("plc"))

    def make(plc_name: str, name: str) -> PythonPlc | SoftPlc:
        return PythonPlc(block_of(name)) if plc_name == "Python" else SoftPlc(program(name))

    return make


NAMES = [name for name in CONTROLLERS if name != "predictive"]
NAMES += [f"{name}, rates" for name in RATE_CONTROLLERS if name != "predictive"]
"""Controllers without loops, which the straight code of Structured Text has not."""


@pytest.mark.slow
@pytest.mark.parametrize("plc_name", PLCS)
@pytest.mark.parametrize("name", NAMES)
def test_a_controller_in_structured_text_commands_what_it_commands_in_python(
    name: str, plc_name: str, make_plc: MakePlc
) -> None:
    controller, _ = usual(name)
    plc = make_plc(plc_name, name)
    # The shaper's line of 777 calls runs around twice.
    inputs, expected = reference_calls(CRANE, controller, block_of(name), rows=2000)
    found = np.array([plc(row)[0] for row in inputs])
    plc.end()
    off = np.abs(found - expected).max(axis=0)
    # Round-off of sums in another order, of the largest command.
    assert (off <= 1e-12 * np.maximum(np.abs(expected).max(axis=0), 1.0)).all()
    assert np.ptp(expected) > 0.0


@pytest.mark.parametrize("plc_name", ["Python", pytest.param("MATIEC", marks=pytest.mark.long)])
@pytest.mark.parametrize("setpoint", ["rest", "run"])
def test_a_linear_controller_with_states_commands_in_structured_text_what_it_commands_in_python(
    setpoint: Any, plc_name: str, tmp_path: Path
) -> None:
    block = controller_block(CRANE, filtered(setpoint=setpoint), control_period=PERIOD)
    inputs, expected = reference_calls(CRANE, filtered(setpoint=setpoint), block, rows=300)
    # Setpoints are inputs only where the controller acts about them.
    names = [variable.name for variable in block.of_kind("input")]
    assert [name for name in names if name.endswith("_set")] == [
        f"{name}_set" for name in ("gamma", "x", "l") if setpoint == "run"
    ]
    plc = PythonPlc(block) if plc_name == "Python" else SoftPlc(build_plc(block, tmp_path))
    # Twice: a reset brings the initial states back.
    for _ in range(2):
        found = np.array([plc(row, reset=k == 0)[0] for k, row in enumerate(inputs)])
        # Round-off of sums in another order, of the largest command.
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    plc.end()


@pytest.mark.slow
def test_a_plc_with_the_block_moves_the_crane_as_python_does(make_plc: MakePlc) -> None:
    _, make = CONTROLLERS["integral"]
    block = block_of("integral")
    plc = make_plc("MATIEC", "integral")
    runs = []
    variables = [variable.name for variable in block.variables if variable.kind == "input"]
    used = [variables.index(variable.name) for variable in block.of_kind("input")]

    def by_plc(t: float, state: State, setpoint: Any) -> np.ndarray:
        values = np.concatenate([*state, setpoint.position, setpoint.velocity])
        return plc(values[used])[0]

    goal = CRANE.state(gamma=0.05, x=10.5, l=14.8)
    reference = bang_ramp(CRANE, goal)
    for controller in (make(CRANE, 5e-3), by_plc):
        runs.append(simulate(CRANE, controller, reference, duration=6.0, validity="mark"))
    plc.end()
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-9
    assert abs(runs[0].q[-1, 1] - 10.5) < 0.1  # and it moved


def bang_ramp(c: Any, goal: State) -> Callable[[float], Setpoint]:
    """The drives on straight lines to a goal within 3 s."""
    begin = c.start.q[c.layout.drives]
    end = goal.q[c.layout.drives]

    def reference(t: float) -> Setpoint:
        share = min(t / 3.0, 1.0)
        rate = (end - begin) / 3.0 * (t < 3.0)
        return Setpoint(begin + share * (end - begin), rate, 0.0 * rate)

    return reference


@pytest.mark.slow
@pytest.mark.parametrize("plc_name", PLCS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.0000001e12, -1.0000001e12])
def test_an_input_out_of_range_is_a_fault_until_the_reset(
    bad: float, plc_name: str, make_plc: MakePlc
) -> None:
    block = block_of("integral")
    plc = make_plc(plc_name, "integral")
    inputs = np.array([variable.start for variable in block.of_kind("input")])
    first, fault = plc(inputs + 0.01)
    assert not fault
    wrong = inputs.copy()
    wrong[1] = bad
    for k in range(1, 60):
        outputs, fault = plc(wrong if k == 1 else inputs)
        assert fault and np.abs(outputs - first).max() <= k * 1e6 * 5e-3 / 0.25
    assert (outputs == [variable.start for variable in block.of_kind("output")]).all()
    outputs, fault = plc(inputs + 0.01, reset=True)
    assert not fault and (outputs == first).all()
    plc.end()


def test_the_xml_has_the_variables_and_the_body_of_the_text(tmp_path: Path) -> None:
    path = st.export(CRANE, tmp_path / "hold.st", CONTROLLERS["hold"][1](CRANE, 5e-3))
    root = ET.parse(tmp_path / "hold.xml").getroot()
    text = path.read_text()
    space = {"p": "http://www.plcopen.org/xml/tc6_0201", "h": "http://www.w3.org/1999/xhtml"}
    names = [entry.get("name") for entry in root.findall(".//p:variable", space)]
    assert {"reset", "x_set", "fault", "F_x_command"} <= set(names)
    assert all(f"  {name} : " in text for name in names)
    body = root.findtext(".//h:p", "", space)
    assert body and body in text


def test_what_cannot_be_exported_is_refused_in_a_sentence_and_leaves_no_file(
    tmp_path: Path,
) -> None:
    def strange(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return np.zeros(3)

    with pytest.raises(DataError, match="The controller function is neither affine in the state"):
        st.export(CRANE, tmp_path / "a.st", strange)
    predictive, _ = usual_controller("predictive", CRANE, 5e-3)
    with pytest.raises(DataError, match="loops, which is not written in Structured Text"):
        st.export(CRANE, tmp_path / "a.st", predictive)
    with pytest.raises(DataError, match=r"the ending must be \.st"):
        st.export(CRANE, tmp_path / "a.txt", CONTROLLERS["hold"][1](CRANE, 5e-3))
    (tmp_path / "b.xml").write_text("mine")
    with pytest.raises(DataError, match="it is there already"):
        st.export(CRANE, tmp_path / "b.st", CONTROLLERS["hold"][1](CRANE, 5e-3))
    assert [path.name for path in tmp_path.iterdir()] == ["b.xml"]


@pytest.mark.slow
def test_the_page_says_how_many_operations_a_call_of_each_block_has() -> None:
    page = (ROOT / "docs/howto/controller_code.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) kB \|$", page, re.M)
    assert {name for name, *_ in rows} == {*CONTROLLERS} - {"kalman", "predictive"}
    for name, operations, kilobytes in rows:
        controller, drive = usual_controller(name, CRANE, 5e-3)
        text = structured_text(controller_block(CRANE, controller, drive=drive, name="block"))
        # As the command of the page counts them.
        assert len(re.findall(r" (?:[*+/-]|[<>]=?) ", text)) == int(operations), name
        # Another gravity has other digits.
        assert abs(len(text.encode()) / 1e3 - int(kilobytes)) < 1.0, name


def test_names_that_are_no_identifiers_are_mapped_one_to_one() -> None:
    long_names = [f"{'a' * 39}_b", f"{'a' * 39}_c"]
    names = ["x", "X", "base yaw", "base_yaw", "IF", "v3", "ü", "x_now", *long_names]
    chosen = identifiers(names)
    assert chosen["x"] == "x" and len({new.lower() for new in chosen.values()}) == len(names)
    assert all(new.isidentifier() and "__" not in new for new in chosen.values())
    assert not any(new.startswith("_") or new.endswith("_") for new in chosen.values())
    assert chosen["IF"] == "the_IF" and chosen["v3"] == "the_v3"


def test_no_variable_has_the_name_of_a_local_constant_in_other_letters() -> None:
    chosen = identifiers(["V1", "X_NOW", "the_now_now", "End_If"])
    assert [*chosen.values()] == ["the_V1", "the_X", "the_the", "the_End_If"]
