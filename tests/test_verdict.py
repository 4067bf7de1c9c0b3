"""A check holds, fails, or was not judged; nothing that was not computed looks like a pass."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn.assumptions import Assumption, Origin, check_entered
from cranedyn.plotting.html import mark_html
from cranedyn.verdict import Check, Verdict, overall


@pytest.mark.parametrize(
    ("condition", "verdict"),
    [
        (True, Verdict.HOLDS),
        (np.bool_(False), Verdict.FAILS),
        (None, Verdict.NOT_JUDGED),
        (Verdict.FAILS, Verdict.FAILS),
        (math.nan < 1.0, Verdict.FAILS),
    ],
)
def test_a_condition_becomes_a_verdict(condition: bool | None, verdict: Verdict) -> None:
    check = Check("A sentence.", condition)
    assert check.verdict is verdict
    assert check.holds is {"holds": True, "fails": False}.get(verdict.value)
    assert Check("A sentence.", check.verdict) == check


@pytest.mark.parametrize("condition", [math.nan, 1, 0.0, "holds", [], np.array([True])])
def test_what_is_no_condition_is_no_verdict(condition: object) -> None:
    with pytest.raises(TypeError, match="holds"):
        Check("A sentence.", condition)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("conditions", "verdict"),
    [
        ([], Verdict.NOT_JUDGED),
        ([True, True], Verdict.HOLDS),
        ([True, None], Verdict.NOT_JUDGED),
        ([None, None], Verdict.NOT_JUDGED),
        ([None, False, True], Verdict.FAILS),
    ],
)
def test_checks_hold_together_only_if_there_are_some_and_all_hold(
    conditions: list[bool | None], verdict: Verdict
) -> None:
    assert overall(Check("", condition) for condition in conditions) is verdict


def test_each_verdict_has_a_word_and_a_sign_of_its_own() -> None:
    assert [verdict.word for verdict in Verdict] == ["holds", "FAILS", "not judged"]
    marks = [mark_html(verdict) for verdict in Verdict]
    assert len(set(marks)) == 3
    assert "✔" in marks[0]
    assert not any("✔" in mark for mark in marks[1:])


def test_a_default_is_never_taken_for_an_entered_value() -> None:
    entered = Assumption("largest swing of the rope", "2°", Origin.ENTERED, "[lift] swing")
    default = Assumption("gust to bear", "8 m/s", Origin.DEFAULT, "--wind")
    assert str(entered) == "largest swing of the rope: 2° (entered, [lift] swing)"
    assert check_entered([entered]).verdict is Verdict.HOLDS
    check = check_entered([entered, default])
    assert check.verdict is Verdict.NOT_JUDGED
    assert "Nobody entered 1 value that the result rests on: --wind." in check.sentence


def test_what_is_shipped_is_named_to_be_checked() -> None:
    crane = Assumption("crane", "the tower crane of this package", Origin.SHIPPED)
    chart = Assumption("load chart", "22 m jib", Origin.SHIPPED)
    check = check_entered([crane, chart])
    assert check.verdict is Verdict.HOLDS
    assert check.sentence.endswith("check that it is yours: crane and load chart.")
