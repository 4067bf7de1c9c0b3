"""Lifts one after the other, as the command does it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

from cranedyn.lifts.planning.file_templates import template_text
from experiments import lift


def written(tmp_path: Path) -> str:
    """Write a list of one lift."""
    file = tmp_path / "chain.toml"
    first = template_text("chain").split("[[lift]]")[:2]
    file.write_text("[[lift]]".join(first), encoding="utf-8")
    return str(file)


@pytest.mark.slow
def test_a_chain_is_planned_run_and_recorded(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["--site", "open_yard", "--chain", written(tmp_path), "--set", "hoist_max:=30"]
    assert lift.main([*words, "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    moves, changes = result["tables"]
    assert [row[0] for row in moves["rows"]] == ["to formwork", "formwork", "home"]
    assert len(changes["rows"]) == 2
    assert all(claim["holds"] for claim in result["claims"])
    assert (out / "lift.rrd").exists() and (out / "chain.parquet").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--from", "6", "-14"], "--from is for single lifts"),
        (["--least-time"], "--least-time is for single lifts"),
        (["--lifts", "20"], "--lifts is for single lifts"),
        (["--site", "open_yard", "city_block"], "A chain is lifted on one site; 2 are given"),
    ],
)
def test_options_of_single_lifts_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    chain = ["--chain", written(tmp_path), "--out", str(tmp_path / "out")]
    assert lift.main([*chain, *words]) == 2
    assert sentence in capsys.readouterr().err
