"""The benchmark on one of its random sites."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import lift_benchmark


@pytest.mark.long
def test_a_random_site_is_planned_certified_and_set_beside_other_means(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--sites", "1", "--least-time", "--out", str(tmp_path / "out")]
    assert lift_benchmark.main(words) == 0, capsys.readouterr().out
    tables = {
        table["title"]: table["rows"]
        for table in json.loads((tmp_path / "out" / "result.json").read_text())["tables"]
    }
    assert tables["Sites without a certified lift"] == []
    means = ["planned", "stop at corners", "spline + PD", "operator", "in least time"]
    assert [row[0] for row in tables["Beside other means"]] == means
    swings = [row[-1] for row in tables["Beside other means"]]
    assert min(swings[1:4]) > 0.5 > max(swings[0], swings[4])
    _, planned, *_ = next(row for row in tables["Random sites"] if row[0] == "motion / bound")
    _, least, *_ = next(row for row in tables["Random sites"] if row[0] == "least time / bound")
    assert 1.0 < least < planned


@pytest.mark.slow
def test_the_sites_are_the_same_for_the_same_seed() -> None:
    from tests.lifts.planning.sites import crane

    one, again, other = (next(lift_benchmark.sites(crane(), 1, seed)) for seed in (1, 1, 2))
    assert one.start is not None
    assert again.start is not None
    assert other.start is not None
    assert one.start.tolist() == again.start.tolist() != other.start.tolist()
