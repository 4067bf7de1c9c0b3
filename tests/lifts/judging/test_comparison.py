"""Lifts compared: all combinations, each with a row, in order, and none dropped."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.errors import CraneError
from cranedyn.lifts.judging.chart import CHARTS, read_chart
from cranedyn.lifts.judging.comparison import (
    Case,
    ComparedCase,
    ComparedLift,
    Place,
    cases_of,
    in_order,
    lifts_from,
    places_from,
    refused,
)
from cranedyn.lifts.judging.comparison_page import (
    comparison_csv,
    comparison_html,
    comparison_table,
    places_map,
    without_empty_columns,
    worst_by_place,
)
from cranedyn.lifts.judging.lift_figures import LiftFigure
from cranedyn.lifts.judging.plan_record import PlanOptions
from cranedyn.lifts.planning.site_file import read_site
from experiments import lift_report
from experiments.lift_comparison import judge_cases

PLACE = Place(0.0, 0.0)
HERE = Case("yard.toml", PLACE)

ROWS = [
    refused(Case("yard.toml", Place(5.0, 5.0)), "The jib is too near to the hall."),
    ComparedCase(HERE, "NO GO", 0.5, 0.2, 20.0, 8.0, "It comes too near."),
    ComparedCase(Case("b.toml", PLACE), "GO", 0.6, 1.0, 30.0, 9.0),
    ComparedCase(Case("c.toml", PLACE), "GO", 0.4, 1.0, 40.0, 7.0),
    ComparedCase(Case("d.toml", PLACE), "GO", None, 2.0, 10.0, None),
]


def test_rows_are_sorted_by_verdict_and_then_by_what_is_asked_for() -> None:
    def order(key: str) -> list[str]:
        return [row.case.crane for row in in_order(ROWS, key)]

    assert order("share") == ["c", "b", "d", "yard", "yard"]
    assert order("clearance")[0] == "d" and order("time")[0] == "d" and order("wind")[0] == "b"
    assert [row.number for row in in_order(ROWS)] == [1, 2, 3, 4, 5]
    assert in_order(ROWS)[-1].word == "REFUSED"


def test_a_grid_has_its_corners_and_every_point() -> None:
    places = places_from("0:20:3,-5:5:2")
    assert {(place.x, place.y) for place in places} == {
        (x, y) for x in (0.0, 10.0, 20.0) for y in (-5.0, 5.0)
    }
    assert places_from("3,4") == [Place(3.0, 4.0)]


def test_places_are_read_from_csv_and_toml(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("x,y,heading\n1,2,90\n\n3,4,-90\n")
    (tmp_path / "p.toml").write_text(
        "[[position]]\nx = 1\ny = 2\nheading = 90\n[[position]]\nx = 3\ny = 4\nheading = -90\n"
    )
    read = places_from(str(tmp_path / "p.csv"))
    assert read == [Place(1.0, 2.0, 90.0), Place(3.0, 4.0, -90.0)]
    assert places_from(str(tmp_path / "p.toml")) == read


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("0:20", "allowed is a file that ends in .csv or .toml, or a grid"),
        ("0:20,1", "first:last:count"),
        ("0:20:0,1", "a whole number from 1"),
        ("0:20:101,0:20:101", "10201 places"),
        ("a,1", "x of the grid is a"),
        ("1e9,1", "x of a position is 1e+09 m"),
        ("missing.csv", "Cannot read missing.csv"),
    ],
)
def test_what_is_no_place_is_refused_in_a_sentence(text: str, sentence: str) -> None:
    with pytest.raises(CraneError) as error:
        places_from(text)
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("a,b\n1,2\n", "line 1 is 'a,b'"),
        ("x,y\n1\n", "line 2: it has 1 cells"),
        ("x,y\n1,nan\n", "line 2: y is nan m"),
        ("x,y,heading\n1,2,900\n", "line 2: heading of a position is 900"),
        ("x,y\n", "0 positions"),
        ("", "line 1 is"),
    ],
)
def test_a_file_of_places_is_refused_with_its_line(
    content: str, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / "p.csv").write_text(content)
    with pytest.raises(CraneError) as error:
        places_from(str(tmp_path / "p.csv"))
    assert sentence in str(error.value)


def test_lifts_of_a_list_change_ends_and_load_of_a_site(tmp_path: Path) -> None:
    file = tmp_path / "lifts.toml"
    file.write_text(
        '[[lift]]\nname = "a"\nfrom = [1, 2, 3]\nto = [4, 5]\nload = 500\n'
        '[[lift]]\nname = "b"\nfrom = [1, 2, 3]\nto = [4, 5, 6]\n'
    )
    lifts = lifts_from(file)
    assert lifts[0] == ComparedLift("a", (1.0, 2.0, 3.0), (4.0, 5.0), 500.0)
    yard = read_site("open_yard")
    heavy = lifts[0].of(yard)
    assert heavy.crane["payload_mass"] == 500.0 and set(heavy.rigging.values()) == {0.0}
    assert heavy.goal is not None and heavy.goal.tolist() == [4.0, 5.0]
    assert lifts[1].of(yard).crane["payload_mass"] == yard.crane["payload_mass"]
    for text, sentence in (
        ("", "there is none"),
        ('[[lift]]\nname = "a"\nfrom = [1, 2, 3]\n', "to: it is missing"),
        (file.read_text().replace('"b"', '"a"'), "two lifts are called a"),
        (file.read_text() + "after = 3\n", "There is no field 'after'"),
    ):
        file.write_text(text)
        with pytest.raises(CraneError) as error:
            lifts_from(file)
        assert sentence in str(error.value)


def test_a_place_moves_the_crane_and_leaves_the_site() -> None:
    yard = read_site("open_yard")
    moved = Place(3.0, -4.0, 90.0).of(yard)
    assert moved.foot.tolist() == [3.0, -4.0, yard.foot[2]]
    # The jib points along the site's Y at a heading of 90°, and along the crane's -Y.
    assert moved.crane_to_site @ [0.0, -1.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert moved.solids is yard.solids and moved.start is yard.start
    luffing = read_site("open_yard")
    assert Place(1.0, 1.0).of(luffing).heading == yard.heading


def test_all_combinations_are_cases_and_come_back_from_json() -> None:
    lifts = [
        ComparedLift("a", (1.0, 2.0, 3.0), (4.0, 5.0)),
        ComparedLift("b", (0.0,) * 3, (1.0,) * 3),
    ]
    cases = cases_of(["a.toml", "b.toml"], [PLACE, Place(1.0, 2.0, 3.0)], lifts)
    assert len(cases) == len(set(cases)) == 8
    assert [Case.of(json.loads(json.dumps(case.stored()))) for case in cases] == cases
    assert cases_of(["open_yard"]) == [Case("open_yard")]
    with pytest.raises(CraneError, match="Two site files are called yard"):
        cases_of(["a/yard.toml", "b/yard.toml"])
    with pytest.raises(CraneError, match="10100 cases"):
        cases_of(["open_yard"], [PLACE] * 101, lifts[:1] * 100)


def test_every_row_is_in_table_csv_and_page_with_its_reason() -> None:
    rows = in_order(ROWS)
    table = comparison_table(rows, "Coarse: 20 perturbed lifts.")
    read = list(csv.DictReader(io.StringIO(comparison_csv(table))))
    assert len(read) == len(ROWS) and read[-1]["reason"] == "The jib is too near to the hall."
    assert read[0]["share of capacity [%]"] == "40.0" and read[-1]["time [s]"] == ""
    assert "lift" in read[0] and "lift" not in dict(without_empty_columns(table).columns)
    figure = places_map(read_site("open_yard"), rows)
    page = comparison_html(table, [LiftFigure(figure, "Places.")], rows, "cranedyn run x")
    for said in ("5 cases: 3 GO, 1 NO GO, 1 REFUSED.", "The jib is too near", "Coarse: 20"):
        assert said in page
    named = {text.get_text() for text in figure.axes[0].texts}
    # The place (0, 0) is as good as the worst lift from it.
    assert named == {"4", "5"}


def test_a_place_is_as_good_as_the_worst_lift_from_it() -> None:
    light = ComparedCase(HERE, "GO", 0.3, 1.0, 20.0, 9.0)
    heavy = ComparedCase(HERE, "GO", 0.8, 1.0, 10.0, 9.0)
    assert worst_by_place([light, heavy], "share") == [heavy]
    assert worst_by_place([heavy, light], "time") == [light]
    assert worst_by_place([heavy, ROWS[1]], "share") == [ROWS[1]]


def task(place: Place) -> str:
    """A case of the example site, judged without perturbed lifts and gusts."""
    case = Case("open_yard", place)
    options = asdict(PlanOptions("open_yard", lifts=0, gusts=0))
    stored: dict[str, Any] = {"case": case.stored(), "options": options}
    return json.dumps({**stored, "chart": None, "crane": None})


@pytest.mark.slow
def test_a_case_has_the_share_of_its_radius() -> None:
    place = Place(0.0, 2.0)
    row = judge_cases({"task": np.array([task(place)])})
    yard = read_site("open_yard")
    ends = [yard.start, yard.goal]
    radii = [float(np.hypot(end[0] - place.x, end[1] - place.y)) for end in ends if end is not None]
    rated = read_chart(CHARTS / "laboratory.toml").on(2).at(np.array([max(radii)]))[0]
    # By hand: the mass over the rated load at the larger radius, and what the motion adds to it.
    still = yard.crane["payload_mass"] / rated
    assert still <= row["share"][0] < 1.1 * still
    assert row["word"][0] == "NOT COMPLETE" and np.ma.is_masked(row["wind"])
    assert "wind limit was not computed" in row["reason"][0]


@pytest.mark.slow
def test_the_command_keeps_what_it_refuses_as_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["--positions", "30,0", "--workers", "1", "--out", str(out)]
    assert lift_report.main(words) == 1
    assert "Of 1 cases 0 are a GO." in capsys.readouterr().out
    read = list(csv.DictReader((out / "comparison.csv").open()))
    assert [row["verdict"] for row in read] == ["REFUSED"]
    assert all("m from it" in row["reason"] for row in read)
    page = (out / "comparison.html").read_text()
    assert "Coarse: 400 perturbed lifts" in page and "Coarse: 2 gusts are drawn" in page
    assert not (out / "lift.json").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--cranes open_yard --site tower", "--site has no effect beside --cranes"),
        ("--sort wind", "--sort has no effect without --cranes, --positions or --list"),
        ("--positions 1,2 --view", "A comparison has no recording"),
        ("--list missing.toml", "Cannot read missing.toml"),
        ("--cranes missing.toml", "Cannot read missing.toml"),
    ],
)
def test_options_that_contradict_a_comparison_are_refused(
    words: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":0")
    assert lift_report.main(words.split()) == 2
    assert sentence in capsys.readouterr().err and list(tmp_path.iterdir()) == []
