"""Files recorded elsewhere: names and units are said, and never guessed."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cranedyn.data.external import Source, parse_sources, read_external
from cranedyn.errors import DataError, UnknownName
from experiments import a1
from tests.experiments.conftest import write_csv

T = np.arange(0.0, 60.0, 0.02)
PHI = 0.1 * np.exp(-3e-4 * T) * np.cos(2.0 * math.pi / 6.378 * T)


@pytest.fixture
def degrees(tmp_path: Path) -> Path:
    """A file of somebody who writes milliseconds, degrees and millimetres."""
    return write_csv(
        tmp_path / "site.csv",
        **{"time": 1e3 * T, "swing angle": np.degrees(PHI), "rope": np.full_like(T, 10_000.0)},
    )


SAID = ["t_s=time[ms]", "phi_rad=swing angle[deg]", "l_m=rope[mm]"]


@pytest.mark.slow
def test_columns_arrive_under_our_names_and_in_our_units(degrees: Path) -> None:
    data = read_external(degrees, ("t_s", "phi_rad", "l_m"), parse_sources(SAID))
    np.testing.assert_allclose(data["t_s"], T, rtol=1e-15, atol=1e-12)
    np.testing.assert_allclose(data["phi_rad"], PHI, rtol=1e-14)
    np.testing.assert_allclose(data["l_m"], 10.0, rtol=1e-15)


def test_a1_finds_the_period_of_a_file_in_degrees(degrees: Path, tmp_path: Path) -> None:
    assert (
        a1.main(["--from", str(degrees), "--columns", *SAID, "--out", str(tmp_path / "out")]) == 0
    )
    (table,) = json.loads((tmp_path / "out" / "result.json").read_text())["tables"]
    row = dict(zip(table["columns"], table["rows"][0], strict=True))
    assert row["T [s]"] == pytest.approx(6.378, rel=1e-6)  # no noise
    assert row["l [m]"] == pytest.approx(10.0, rel=1e-12)


def test_degrees_that_nobody_said_are_refused_with_what_to_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_csv(
        tmp_path / "site.csv", t_s=T, phi_rad=np.degrees(PHI), l_m=np.full_like(T, 10.0)
    )
    assert a1.main(["--from", str(file), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert (
        f"{file}: phi_rad is 5.73 rad in some row; a swing is 1.5708 rad (90 degrees) at most."
        in error
    )
    assert "--columns phi_rad=phi_rad[deg]" in error
    options = ["--columns", "phi_rad=phi_rad[deg]", "--out", str(tmp_path / "out")]
    assert a1.main(["--from", str(file), *options]) == 0


def test_a_column_given_twice_or_not_needed_is_a_sentence(degrees: Path) -> None:
    with pytest.raises(DataError, match="phi_rad is given twice"):
        parse_sources(["phi_rad=a", "phi_rad=b"])
    with pytest.raises(
        UnknownName, match="There is no needed column 'theta_rad'; there are t_s, phi_rad"
    ):
        read_external(degrees, ("t_s", "phi_rad"), {"theta_rad": Source("b")})


def test_time_of_another_name_must_increase(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "a.csv", clock=np.array([0.0, 2.0, 1.0]), phi_rad=np.zeros(3))
    with pytest.raises(DataError, match="clock must increase"):
        read_external(file, ("t_s", "phi_rad"), {"t_s": Source("clock")})
