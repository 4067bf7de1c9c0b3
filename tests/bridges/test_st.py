"""Controllers in Structured Text, translated by MATIEC, command what they command in Python."""

from __future__ import annotations

import os
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.bridges import st
from cranedyn.bridges.controller_block import controller_block, vectors
from cranedyn.bridges.usual_controllers import CONTROLLERS
from cranedyn.compiled.block import FunctionBlock, identifiers
from cranedyn.compiled.structured_text import plcopen_xml, structured_text
from cranedyn.errors import DataError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from tests.bridges.c_tools import output, tool
from tests.helpers import crane

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


class SoftPlc:
    """A block in Structured Text, translated by MATIEC; it runs as a process."""

    def __init__(self, block: FunctionBlock, folder: Path) -> None:
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
        self._process = subprocess.Popen(
            [folder / "plc"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
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


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_in_structured_text_commands_what_it_commands_in_python(
    name: str, tmp_path: Path
) -> None:
    drive, make = CONTROLLERS[name]
    duration = 2.0 if name == "observer" else 30.0
    block = controller_block(CRANE, make(CRANE, 5e-3), drive=drive, duration=duration)
    plc = SoftPlc(block, tmp_path)
    inputs, expected = vectors(CRANE, make(CRANE, 5e-3), block, rows=2000)
    found = np.array([plc(row)[0] for row in inputs])
    plc.end()
    off = np.abs(found - expected).max(axis=0)
    # Round-off of sums in another order, of the largest command.
    assert (off <= 1e-12 * np.maximum(np.abs(expected).max(axis=0), 1.0)).all()
    assert np.ptp(expected) > 0.0
