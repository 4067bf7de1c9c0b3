"""A crane and controllers in C: the numbers of Python, without findings of compilers and linters."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.bridges import c_code
from cranedyn.bridges.controller_block import controller_block, vectors
from cranedyn.bridges.usual_controllers import CONTROLLERS
from cranedyn.compiled.block import identifiers
from cranedyn.compiled.crane_block import crane_block
from cranedyn.controllers import follow, hold_controller, lqr, paper_controller
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.estimation import with_observer, with_sensor_model
from cranedyn.interfaces import Setpoint
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits
from cranedyn.references.shaped import shaped, zvd
from cranedyn.simulation.simulate import simulate
from experiments.relatives.catalogue import BRIDGE, HOOK
from tests.bridges.c_tools import STRICT, CompiledBlock, output, tool
from tests.helpers import crane

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

CRANE = crane()
MOTION = flat(CRANE, CRANE.state(), CRANE.state(gamma=0.1, x=10.5, l=14.7), 4.0)
LIMITS = Limits([0.08, 1.5, 1.0], [0.03, 0.6, 0.6])


def drifting(t: float) -> Setpoint:
    """A reference that moves."""
    rates = np.array([0.01, 0.5 + 0.1 * t, -0.2])
    return Setpoint(np.array([0.0, 10.0, 15.0]), rates, 0.0 * rates)


def damping() -> Any:
    return with_damping(CRANE, drifting, recovery=0.3, limits=LIMITS)


MADE: dict[str, tuple[Any, Callable[[], Any]]] = {
    "hold": ("effort", lambda: hold_controller(CRANE)),
    "lqr along a motion": ("effort", lambda: lqr(CRANE, MOTION)),
    "integral along a motion": ("effort", lambda: paper_controller(CRANE, MOTION)),
    "follow": ("motion", lambda: follow(CRANE, MOTION)),
    "yielding": ("motion", damping),
    "yielding, rates": ("velocity", lambda: as_velocity_command(CRANE, damping(), drive="motion")),
    "lqr, rates": (
        "velocity",
        lambda: as_velocity_command(CRANE, lqr(CRANE, MOTION), drive="effort"),
    ),
    "observer": ("effort", lambda: with_observer(lqr(CRANE, MOTION), CRANE, MOTION)),
    "shaper": ("effort", lambda: shaped(hold(CRANE), zvd(0.02), [0.71, 0.2])),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_a_controller_in_c_commands_what_it_commands_in_python(name: str, tmp_path: Path) -> None:
    drive, make = MADE[name]
    block = controller_block(CRANE, make(), drive=drive, duration=20.0)
    compiled = CompiledBlock(block, tmp_path)
    inputs, expected = vectors(CRANE, make(), block, rows=2000)
    names = [variable.name for variable in block.of_kind("output")]
    found = []
    for row in inputs.tolist():
        for variable, value in zip(block.of_kind("input"), row, strict=True):
            setattr(compiled.memory, variable.name, value)
        assert compiled.call()
        found.append([getattr(compiled.memory, name) for name in names])
    # Round-off of sums in another order, of the largest command.
    off = np.abs(np.array(found) - expected).max(axis=0)
    assert (off <= 1e-12 * np.maximum(np.abs(expected).max(axis=0), 1.0)).all()
    assert np.ptp(expected) > 0.0
