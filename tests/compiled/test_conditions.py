"""Where the model holds, as code says it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.interfaces import Drive
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation import log
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane

_LINK = """<link name="{name}"><inertial><mass value="10"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
_JOINT = """<joint name="{name}" type="prismatic"><parent link="{above}"/><child link="{below}"/>
<axis xyz="{axis}"/><origin xyz="0 0 {up}"/>
<limit lower="-5" upper="5" effort="100" velocity="9"/></joint>"""


@pytest.mark.slow
def test_a_crane_whose_load_stays_at_one_height_runs_in_code(tmp_path: Path) -> None:
    parts = [
        '<robot name="table"><link name="base"/>',
        *(_LINK.format(name=name) for name in ("cart", "load")),
        _JOINT.format(name="bridge", above="base", below="cart", axis="1 0 0", up=3),
        _JOINT.format(name="trolley", above="cart", below="load", axis="0 1 0", up=0),
        "</robot>",
    ]
    (tmp_path / "table.urdf").write_text("".join(parts))
    table = load_crane(tmp_path / "table.urdf", driven=["bridge", "trolley"])
    brake = hold_controller(table)
    assert simulate(table, brake, duration=0.1, engine="compiled").valid.all()
    assert simulate_batch(table, brake, duration=0.1).valid_until[0] == np.inf


def _counted(names: list[str], judge: Callable[..., Any], *given: Any, **named: Any) -> Any:
    names.append(judge.__name__)
    return judge(*given, **named)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the functions by which Python judged rows."""
    names = list[str]()
    monkeypatch.setattr(log, "conditions", partial(_counted, names, log.conditions))
    return names


def test_where_code_says_that_the_model_holds_nobody_asks_again(asked: list[str]) -> None:
    start = crane().state(phi=0.1)
    brake = hold_controller(crane())
    run = simulate(crane(), brake, start=start, duration=20.0, engine="compiled")
    assert not asked
    assert (run.valid == 1.0).all()


@pytest.mark.slow
def test_rows_are_marked_where_code_says_that_the_model_does_not_hold() -> None:
    start = crane().state(phi=1.5, theta=1.5)
    brake = hold_controller(crane())
    plain, code = (
        simulate(crane(), brake, start=start, duration=15.0, validity="mark", engine=engine)
        for engine in ("pinocchio", "compiled")
    )
    assert 0 < plain.valid.sum() < len(plain.valid)
    assert np.array_equal(plain.valid, code.valid)


@pytest.mark.parametrize(
    ("drive", "effort", "away"),
    [
        ("motion", 1e5, 0.2),
        ("motion", 20.0, 0.2),
        ("velocity", 1e5, 0.2),
        ("velocity", 200.0, 0.2),
        ("velocity", 1e5, 4.0),
    ],
)
@pytest.mark.slow
def test_code_says_whether_drives_can_and_rows_are_marked_where_they_cannot(
    drive: Drive, effort: float, away: float, asked: list[str]
) -> None:
    c = crane(trolley_effort=effort)
    none = np.zeros(3)
    law = Hold(c, np.ones(3), np.ones(3) * (drive == "motion"), none)
    goal = hold(c, c.state(x=float(c.start.q[1]) + away))
    how: Any = {"duration": 4.0, "drive": drive, "validity": "mark"}
    plain = simulate(c, law, goal, **how)
    asked.clear()
    code = simulate(c, law, goal, **how, engine="compiled")
    assert np.array_equal(plain.valid, code.valid)
    can = effort == 1e5 and away == 0.2
    assert plain.valid.all() == can == (not asked)
