"""Validation: every oracle holds as the command runs it, the document shows what it prints, and a
plant that is wrong is noticed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cranedyn.dynamics import drives as loop
from cranedyn.errors import DataError
from cranedyn.interfaces import EngineName
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments import validate
from experiments.harness import Claim
from experiments.scenarios.crane_variants import POINT
from experiments.validate import (
    bench,
    conserved,
    locked_drives,
    reading,
    running_cable,
    slack_rope,
    trolley_moves,
    turning_jib,
)
from experiments.validate.bench import LARGE, Bench, G, point_crane
from experiments.validate.oracle import Oracle, check_oracle
from tests.document_numbers import missing
from tests.experiments.conftest import Ran
from tests.helpers import EXPLICIT_EULER, FAST, files, turned
from tests.lagrangian import Lagrangian

HALVINGS = 3
"""One less than by default, so that the tests take half of the time; what is allowed follows from
the runs themselves."""


@pytest.fixture(scope="module")
def result(ran: Callable[..., Ran]) -> Ran:
    return ran("validate", "--engine", FAST)


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.long
def test_every_oracle_is_a_claim(result: Ran) -> None:
    tables = result.result["tables"]
    claims = result.result["claims"]
    assert len(claims) == sum(len(table["rows"]) for table in tables) + 3  # order, two ledgers
    assert [table["title"] for table in tables] == [*validate.PARTS, "Ropes that go slack"]


@pytest.mark.long
def test_the_error_goes_with_the_first_or_second_power_of_the_step(result: Ran) -> None:
    tables = result.result["tables"][: len(validate.PARTS)]
    orders = {row[0]: row[-1] for table in tables for row in table["rows"]}
    first = [order for order in orders.values() if order is not None and order < 1.5]
    assert len(first) >= 10
    assert max(abs(order - 1.0) for order in first) < 0.02  # the claim's own bound
    # a swing in its plane is a sequence that time can run either way, so its period has no first
    # power
    for name in orders:
        if name.startswith("period of"):
            assert orders[name] == pytest.approx(2.0, abs=0.02)


@pytest.mark.long
def test_the_documents_count_closed_forms_and_claims_as_the_command_does(result: Ran) -> None:
    forms = result.result["parameters"]["closed_forms"]
    claims = len(result.result["claims"])
    assert claims == forms + 3  # the order of the step, two ledgers
    assert missing([f"| {forms} closed forms hold |"], "README.md") == []
    assert missing([f"of the {claims} claims fail"], "docs/results/validation.md") == []


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--halvings 2", "halvings is 2; allowed is 3 to 6"),
        ("--halvings 7", "halvings is 7; allowed is 3 to 6"),
        ("--spoil payload_mas:=5", "There is no argument 'payload_mas'"),
        ("--spoil payload_mass", "'payload_mass' is not of the form name:=value"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    words: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert validate.main([*words.split(), "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {sentence}")
    assert files(tmp_path) == []


# --- every claim, by the functions of the command -------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("title", validate.PARTS)
def test_a_run_has_its_closed_form_for_a_vanishing_step(
    title: str, subtests: pytest.Subtests
) -> None:
    for oracle in validate.PARTS[title](Bench(point_crane, FAST)):
        with subtests.test(oracle.name):
            found = check_oracle(oracle, HALVINGS)
            assert found.holds, found


@pytest.mark.slow
def test_a_rope_that_goes_slack_has_its_closed_forms(subtests: pytest.Subtests) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    for oracle in slack_rope.oracles(Bench(point_crane, FAST)):
        with subtests.test(oracle.name):
            found = slack_rope.check_slack_oracle(oracle)
            assert found.holds, found


@pytest.mark.slow
@pytest.mark.parametrize(
    "claim", [slack_rope.ledger_of_rk4, slack_rope.ledger_of_semi_implicit_euler]
)
def test_the_ledger_of_a_bouncing_load_closes(claim: Callable[[Bench], Claim]) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    assert claim(Bench(point_crane, FAST)).holds


# --- judging --------------------------------------------------------------------------------------


def test_powers_of_the_step_are_taken_off_and_their_order_is_found() -> None:
    cubic = Oracle("x", "", 2.0, lambda dt: 2.0 + 3.0 * dt - 5.0 * dt**2 + 7.0 * dt**3)
    found = check_oracle(cubic, HALVINGS)
    assert found.steps == [0.02, 0.01, 0.005, 0.0025]
    assert found.limit == pytest.approx(2.0, abs=1e-14)  # rounding
    assert found.order == pytest.approx(1.0, abs=1e-3)  # the second power, (dt 5/3)² of it
    assert found.holds
    even = check_oracle(Oracle("x", "", 2.0, lambda dt: 2.0 + 3.0 * dt**2 - 5.0 * dt**4), HALVINGS)
    # What is left of the fourth power, below that of the second step.
    assert even.limit == pytest.approx(2.0, abs=5.0 * 0.01**4)
    assert even.order == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("off", [1e-9, -1e-6, math.nan])
def test_a_limit_that_is_off_does_not_hold(off: float) -> None:
    oracle = Oracle("x", "", 2.0, lambda dt: 2.0 + off + 3.0 * dt)
    assert not check_oracle(oracle, HALVINGS).holds
    if math.isfinite(off):
        assert check_oracle(
            oracle._replace(tolerance=2.0 * abs(off), reason="much"), HALVINGS
        ).holds


def test_runs_that_have_no_limit_hold_nothing() -> None:
    noise = np.random.default_rng(3)
    noisy = Oracle("x", "", 2.0, lambda dt: 2.0 + 1e-3 * noise.normal())
    assert not check_oracle(noisy, HALVINGS).holds
    jump = check_oracle(Oracle("x", "", 2.0, lambda dt: 2.001 if dt == 0.02 else 2.0), HALVINGS)
    assert abs(jump.remainder) <= jump.allowed
    assert not jump.holds  # near enough, but only because nothing is known


# --- a plant that is wrong ------------------------------------------------------------------------


def _failing(
    part: Callable[[Bench], list[Oracle]], crane: Crane, words: str, engine: EngineName = FAST
) -> int:
    """How many rows do not hold on a crane, of those that begin with some words."""
    rows = [
        oracle
        for oracle in part(Bench(lambda **values: crane, engine))
        if oracle.name.startswith(words)
    ]
    assert rows
    return sum(not check_oracle(oracle, HALVINGS).holds for oracle in rows)


@pytest.mark.slow
def test_the_axis_of_the_tangential_swing_is_noticed(tmp_path: Path) -> None:
    for path in XACRO.parent.glob("*.xacro"):
        (tmp_path / path.name).write_text(path.read_text())
    own = tmp_path / XACRO.name
    own.write_text(turned('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', own.read_text()))
    flipped = load_crane(own, gravity=G, check_axes=False, **POINT, **LARGE)
    assert _failing(turning_jib.oracles, flipped, "seen from a jib") == 2
    assert _failing(conserved.oracles, flipped, "total angular momentum") == 1


@pytest.mark.slow
def test_twice_the_gravity_is_noticed() -> None:
    beam = {"fall_spacing": 2.0, "payload_inertia": 1.0}
    heavy, yawing = (
        load_crane(gravity=2.0 * G, **{**POINT, **LARGE, **more}) for more in ({}, beam)
    )
    assert _failing(running_cable.oracles, heavy, "φ after") == 2
    assert _failing(locked_drives.oracles, yawing, "period of") == 7
    assert _failing(trolley_moves.oracles, heavy, "swing left") == 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "words", "values"),
    [
        (locked_drives.oracles, "period of 30", {"payload_inertia": 1.0}),
        (locked_drives.oracles, "precession of an oval of 8 m by 4 m", {"damp_swing": 10.0}),
        (locked_drives.oracles, "tension at the lowest point", {"payload_mass": 1001.0}),
        (conserved.oracles, "period under a free trolley", {"trolley_mass": 501.0}),
    ],
)
def test_a_number_of_the_crane_that_is_off_a_little_is_noticed(
    part: Callable[[Bench], list[Oracle]], words: str, values: dict[str, float]
) -> None:
    assert _failing(part, point_crane(**values), words) == 1


def test_another_integrator_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "simulate", partial(simulate, integrator=EXPLICIT_EULER))
    assert _failing(conserved.oracles, point_crane(), "ripple of the energy", "pinocchio") == 1


@pytest.mark.slow
def test_coriolis_and_centrifugal_forces_that_are_lost_are_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = loop.solve_accelerations
    monkeypatch.setattr(
        loop,
        "solve_accelerations",
        lambda model, data, q, v, a, *more: usual(model, data, q, 0.0 * v, a, *more),
    )
    assert _failing(running_cable.oracles, point_crane(), "φ after", "pinocchio") == 2
    assert _failing(turning_jib.oracles, point_crane(), "seen from a jib", "pinocchio") == 2


@pytest.mark.slow
def test_spoilt_cranes_make_claims_fail_and_the_exit_code_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        validate, "PARTS", {"Locked drives": lambda bench: locked_drives.oracles(bench)[:2]}
    )
    words = f"--spoil payload_inertia:=5 --halvings 3 --engine {FAST} --out".split()
    assert validate.main([*words, str(tmp_path / "out")]) == 1
    # Both periods, no order where an error does not vanish, and a load caught beside its pivot.
    assert capsys.readouterr().out.count("\nFAILS ") == 4


def test_a_run_in_which_there_is_nothing_to_read_is_refused() -> None:
    t = np.linspace(0.0, 2.0, 21)
    with pytest.raises(
        DataError, match="A swing passes the vertical 0 times in 2 s, where its oracle needs 2"
    ):
        reading.crossing(t, np.exp(-t), 2)
    with pytest.raises(
        DataError,
        match=r"nothing to read between 1 and 1\.1 s, where its oracle needs a turning point",
    ):
        reading.zero_between(reading.curve(t, np.exp(-t), 10).derivative(), 1.0, 1.1)


def test_times_between_rows_are_read_to_rounding() -> None:
    t = np.linspace(0.0, 10.0, 101)
    # (0.07)⁸ of the polynomial.
    assert reading.crossing(t, np.cos(0.7 * t), 2) == pytest.approx(1.5 * math.pi / 0.7, rel=1e-12)


def test_the_payload_by_hand_is_where_the_lagrangian_has_it() -> None:
    q = np.array([[0.4, 12.0, 0.3, -0.2, 15.0], [-1.0, 5.0, -0.7, 0.6, 8.0]])
    expected = [Lagrangian(G).payload(row) - [0.0, 0.0, 28.0] for row in q]
    np.testing.assert_allclose(reading.payload_from_pivot(q), expected, atol=1e-13)  # rounding
