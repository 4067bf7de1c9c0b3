"""The command that plans and simulates the lifts of a site's file."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from cranedyn.lifts.judging.plan_folder import document_checks
from cranedyn.lifts.judging.plan_record import read_plan_record
from cranedyn.lifts.sites.crane_site_file import SITES
from cranedyn.lifts.sites.timetable import CSV_COLUMNS
from experiments import site

pytestmark = pytest.mark.slow


def run_site(folder: Path, *words: str) -> int:
    """Run the command with results in a folder, and return its exit code."""
    return site.main([*words, "--out", str(folder)])


@pytest.fixture(scope="module")
def shift_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the results of the example shift."""
    folder = tmp_path_factory.mktemp("shift")
    assert run_site(folder, "--site", "two_towers_shift", "--reports") == 0
    return folder


def test_each_lift_has_a_report_that_the_page_links_and_whose_record_verifies(
    shift_folder: Path,
) -> None:
    page = (shift_folder / "shift.html").read_text("utf-8")
    for name in ("01_formwork", "02_rebar", "03_facade", "04_bucket"):
        report = shift_folder / "lifts" / name / "lift.html"
        assert f'href="lifts/{name}/lift.html"' in page
        text = report.read_text("utf-8")
        assert "In the shift" in text
        record = read_plan_record(report.with_suffix(".json"))
        checks = document_checks(record, report.parent)
        assert checks and all(check.holds for check in checks)
        # The plan of the shift stands in the file that the record is of.
        site = record.inputs.file("site")
        assert site is not None and site.text is not None and "[shift]" in site.text


def test_the_command_writes_timetable_chart_page_recording_and_trajectories(
    shift_folder: Path,
) -> None:
    written = {file.name for file in shift_folder.iterdir()}
    assert written >= {
        "result.json",
        "timetable.csv",
        "timetable.png",
        "shift.html",
        "site.rrd",
        "crane_1.parquet",
        "crane_2.parquet",
    }
    page = (shift_folder / "shift.html").read_text("utf-8")
    assert all(name in page for name in ("formwork", "rebar", "bucket", "facade", "Timetable"))


def test_the_timetable_keeps_the_order_that_the_file_asks_for(shift_folder: Path) -> None:
    text = (shift_folder / "timetable.csv").read_text("utf-8")
    rows = {row["lift"]: row for row in csv.DictReader(io.StringIO(text))}
    assert tuple(next(csv.reader(io.StringIO(text)))) == CSV_COLUMNS
    assert [rows[name]["crane"] for name in ("formwork", "rebar")] == ["north", "south"]
    assert float(rows["formwork"]["load_kg"]) == 800.0
    assert float(rows["facade"]["at_load_s"]) >= 120.0
    before = max(float(rows[name]["unhooked_s"]) for name in ("formwork", "rebar"))
    assert float(rows["bucket"]["at_load_s"]) >= before
    for row in rows.values():
        times = [float(row[name]) for name in CSV_COLUMNS[9:14]]
        assert times == sorted(times)


def test_all_lifts_of_the_example_arrive_proven_apart_under_the_supervisor(
    shift_folder: Path,
) -> None:
    claims = json.loads((shift_folder / "result.json").read_text("utf-8"))["claims"]
    verdicts = {claim["sentence"]: claim["holds"] for claim in claims}
    for words in ("4 of 4 lifts", "proven to keep", "hooks are within", "0 contacts", "Least dist"):
        assert [holds for claim, holds in verdicts.items() if words in claim] == [True]
    # No chart is entered: nobody says that the cranes can carry their loads.
    assert [holds for claim, holds in verdicts.items() if "no chart" in claim] == [None]


def test_a_lift_that_is_left_out_fails_the_shift_with_its_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    towers = (SITES / "two_towers.toml").read_text("utf-8")
    lift = '[[lift]]\nname = "far"\nfrom = [0.0, 20.0, 3.0]\nto = [0.0, 400.0, 3.0]\n'
    file = tmp_path / "far.toml"
    file.write_text(f"{towers}\n{lift}", "utf-8")
    assert run_site(tmp_path / "out", "--site", str(file)) == 1
    said = capsys.readouterr().out
    assert "FAILS" in said.upper() and "Lift far: north (its load would hang 350" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--site two_towers_shift --hours 1", "--hours has no effect without a site without"),
        ("--site two_towers --film a.mp4", "--film has no effect without a site with [[lift]]"),
        ("--site two_towers two_towers_shift", "two_towers_shift lists lifts"),
    ],
)
def test_arguments_without_an_effect_on_a_shift_are_refused(
    words: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_site(tmp_path / "out", *words.split()) == 2
    assert said in capsys.readouterr().err
