"""The command: whole on its examples, on files of strangers, and on synthetic cranes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cranedyn.data.trajectory import read
from cranedyn.identification import Prior, Twin, read_twin
from experiments import compare, identify
from experiments.gazebo import RECORDINGS
from experiments.harness import Outcome, ResultTable, Setup
from experiments.harness.document import read_document
from experiments.identify.coverage import NAMES
from experiments.identify.figures import spectra
from experiments.scenarios.perturbations import PERTURBATIONS
from tests.helpers import ROOT
from tests.identification.test_estimate import TRUTH, recorded


@pytest.mark.long
def test_the_examples_hold_their_claims(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Gravity, inertia, damping and gains of Gazebo's world from files alone, and the trial."""
    out = tmp_path / "out"
    assert identify.main(["--out", str(out)]) == 0, capsys.readouterr().out
    result = json.loads((out / "result.json").read_text())
    assert len(result["claims"]) == 17
    assert {"twin.json", "twin_1.parquet", "twin_1.png", "correlation.svg", "gazebo.png"} <= {
        *result["files"]
    }
    assert (out / "identify.rrd").stat().st_size > 1e5
    made = [ResultTable.of(kept) for kept in result["tables"]]
    stale = read_document(ROOT / "docs" / "results" / "identification.md", "identify").stale(made)
    # What is left of Gazebo's noiseless files, and so its intervals, is round-off.
    assert [sentence for sentence in stale if "Gazebo Classic" not in sentence] == []


def _write_site(file: Path, noise: dict[str, float]) -> None:
    data = dict(recorded())
    rng = np.random.default_rng(0)
    for name, spread in noise.items():
        data[name] = data[name] + spread * rng.standard_normal(len(data["t_s"]))
    names = ["t_s", "x_m", "gamma_rad", "l_m", "theta_rad", "F_l_N"]
    table = np.stack([data[name] for name in names] + [np.degrees(data["phi_rad"])], axis=1)
    header = ",".join([*names, "Angle"])
    np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.17g")


@pytest.mark.slow
def test_a_record_that_the_model_does_not_explain_ends_in_a_sentence_and_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without noise the straight lines between rows of the late sensor are what is left."""
    file = tmp_path / "site.csv"
    _write_site(file, {})
    words = ["--columns", "phi_rad=Angle[deg]", "--estimate", "l_offset", "delay"]
    assert identify.main([str(file), *words, "--out", str(tmp_path / "out")]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "is white noise (not site.csv: phi_rad, site.csv: theta_rad" in shown
    assert "intervals may not hold the truth" in shown


@pytest.mark.slow
def test_a_file_of_a_stranger_in_degrees_gives_a_twin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "site.csv"
    out = tmp_path / "out"
    _write_site(file, {"phi_rad": 1e-5, "theta_rad": 1e-5, "F_l_N": 1.0})
    words = [str(file), "--columns", "phi_rad=Angle[deg]", "--all", "--out", str(out)]
    assert identify.main(words) == 0
    twin = read_twin(out / "twin.json")
    assert twin.records == ("site.csv",)
    for name, value in TRUTH.items():
        assert twin.identified[name]["value"] == pytest.approx(value, rel=1e-3)
    run = read(out / "twin_1.parquet")
    assert run.record["crane"] == json.loads((out / "twin.json").read_text())["crane"]
    shown = capsys.readouterr().out
    assert "What the twin leaves" in shown
    assert "Controllers tried on the twin" in shown


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["{l5}", "--estimate", "colour"], "There is no parameter 'colour'"),
        (["{l5}", "--columns", "phi_rad=Angle[ell]"], "There is no unit of phi_rad 'ell'"),
        (["{l5}", "{l5}"], "Two records have one name: a1_l5.parquet, a1_l5.parquet"),
        (["{l5}", "--since", "69"], "has 21 rows to go by"),
        (["{l5}", "--joints", "l=NAME"], "--joints has no effect without an .mcap or .bag FILE"),
        (["{l5}", "--drives", "effort"], "A record has no effort of some drive"),
        (["--estimate", "delay"], "--estimate has no effect without a FILE"),
        (["--sign", "phi=-1"], "--sign has no effect without a FILE"),
        (["{l5}", "--sign", "phi=minus"], "sign of phi is minus; allowed is 1 or -1"),
        (["{l5}", "--sign", "x=1"], "There is no swing 'x'; there are phi, theta"),
        (["--set", "payload_mass:=900"], "--set has no effect without a FILE"),
        (["--workers", "2"], "--workers has no effect without --coverage"),
        (["--coverage", "0"], "coverage is 0; allowed is a whole number >= 1"),
        (["{l5}", "--coverage", "3"], "A FILE has no effect beside --coverage"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_leaves_no_file(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    l5 = str(RECORDINGS / "a1_l5.parquet")
    given = [word.replace("{l5}", l5) for word in words]
    assert identify.main([*given, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert sentence in error
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_was_assumed_and_how_a_file_was_read_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(0.0, 40.0, 0.05)
    lines = [f"{a:.2f};{0.05 * np.cos(0.808 * a):.6f};15,0" for a in t.tolist()]
    file = tmp_path / "site.csv"
    file.write_text("\n".join(["t_s;phi_rad;l_m", *lines]).replace(".", ","))
    words = ["--estimate", "l_offset", "--all", "--out", str(tmp_path / "out")]
    assert identify.main([str(file), *words]) in (0, 1)
    shown = " ".join(capsys.readouterr().out.split())
    assert "semicolons separate its cells, with a decimal comma" in shown
    assert "Nobody stated payload_mass = 1000 kg, payload_inertia = 400 kg m^2" in shown
    assert "What was assumed of masses and inertias" in shown
    tables = json.loads((tmp_path / "out" / "result.json").read_text())["tables"]
    assert any("a point load" in str(table["rows"]) for table in tables)


def test_a_twin_with_its_damping_goes_through_compare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    twin = tmp_path / "twin.json"
    with_damping = Twin(Prior(values={"damp_swing": 4000.0}).crane, {}, ("site.csv",))
    with_damping.write(twin)
    seen: list[Setup] = []

    def remember(options: object, setup: Setup) -> Outcome:
        seen.append(setup)
        return Outcome([ResultTable("Nothing", [("a", "")], [("b",)])])

    monkeypatch.setattr(compare, "experiment", remember)
    assert compare.main(["--set", str(twin), "--out", str(tmp_path / "out")]) == 0
    assert float(seen[0].values["damp_swing"]) == 4000.0
    damped = next(case for case in PERTURBATIONS if case.name == "damped swing")
    assert damped.values["damp_swing"] == 5000.0


@pytest.mark.long
def test_coverage_counts_intervals_that_hold_the_truth(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert identify.main(["--coverage", "1", "--workers", "1", "--out", str(out)]) == 0
    (table,) = json.loads((out / "result.json").read_text())["tables"]
    assert [row[0] for row in table["rows"]] == list(NAMES)
    assert all(row[1] in (0, 1) for row in table["rows"])


def test_a_spectrum_has_the_power_of_what_it_is_of() -> None:
    """By Parseval: the integral of the density is the variance, less what the window leaks."""
    t = np.arange(0.0, 100.0, 0.05)
    wave = 0.1 * np.sin(0.8 * t)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    frequency, seen, left = spectra(0.05, t, wave + noise, noise)
    step = frequency[1] - frequency[0]
    assert seen.sum() * step == pytest.approx(0.005, rel=0.05)
    assert left.sum() * step == pytest.approx(1e-6, rel=0.1)
    assert frequency[np.argmax(seen)] == pytest.approx(0.8 / (2.0 * np.pi), abs=step)
