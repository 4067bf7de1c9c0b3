"""Editors complete the numbers of the tower crane."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from cranedyn.errors import OutOfRange
from cranedyn.model import description
from cranedyn.model.crane import Crane
from cranedyn.model.description import CraneValues, arguments
from cranedyn.model.load import load_crane
from tests.helpers import ROOT

OVERHEAD = ROOT / "urdf" / "overhead_crane.urdf.xacro"


def test_the_keywords_of_load_crane_are_the_documented_arguments_in_their_units() -> None:
    source = Path(description.__file__).read_text(encoding="utf-8")
    units = dict(re.findall(r"    (\w+): float(?:  # (.+))?", source))
    assert units == {name: argument.unit for name, argument in arguments().items()}
    assert [*CraneValues.__annotations__] == [*units]
    taken = inspect.signature(load_crane).parameters
    assert taken["numbers"].annotation == "Unpack[CraneValues]"
    assert not CraneValues.__annotations__.keys() & taken.keys()


def test_values_of_another_xacro_file_are_given_by_name_in_a_mapping() -> None:
    crane = load_crane(OVERHEAD, values={"bridge_mass": 9000, "payload_mass": "700"})
    assert crane.payload_mass == 700.0
    assert load_crane(values={"payload_mass": 700}).payload_mass == 700.0
    with pytest.raises(OutOfRange, match="payload_mass is given twice"):
        load_crane(payload_mass=1.0, values={"payload_mass": 2.0})


def test_rest_is_solved_once_when_a_crane_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = Crane.hanging
    calls = []
    monkeypatch.setattr(Crane, "hanging", lambda self, q: calls.append(q) or solve(self, q))
    load_crane()
    load_crane(rope_stiffness=1e6)
    assert len(calls) == 2
