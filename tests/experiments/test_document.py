"""Documents that show tables as printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cranedyn.errors import DataError
from experiments.harness.document import main, read_document, unlike_files
from experiments.harness.outcome import ResultTable
from tests.document_numbers import missing

TABLES = [
    ResultTable("Move one: far", [("strategy", ""), ("s", ".1f")], [("a", 1.25)]),
    ResultTable("Move two [m]", [("strategy", "")], [("b",)], "A note."),
]
TEXT = (
    "Before.\n\n<!-- trial: Move two -->\nold\n<!-- end -->\n\nBetween.\n\n<!-- other: -->\nkept\n"
    "<!-- end -->\n"
    "<!-- trial: -->\n<!-- end -->\nAfter.\n"
)


def test_each_block_gets_the_tables_it_asks_for_and_all_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(TEXT, encoding="utf-8")
    read_document(path, "trial").write(TABLES)
    once = path.read_text(encoding="utf-8")
    first, second = (f"{table.markdown()}\n" for table in TABLES)
    assert once == (
        f"Before.\n\n<!-- trial: Move two -->\n\n{second}\n<!-- end -->\n\nBetween.\n\n<!-- other: "
        "-->\nkept\n<!-- end -->\n"
        f"<!-- trial: -->\n\n{first}\n{second}\n<!-- end -->\nAfter.\n"
    )
    read_document(path, "trial").write(TABLES)
    assert path.read_text(encoding="utf-8") == once


def test_a_block_of_a_csv_file_has_a_link_only_and_the_table_lies_beside_the_page(
    tmp_path: Path,
) -> None:
    path = tmp_path / "page.md"
    text = "<!-- trial far.csv: Move one -->\n{}<!-- end -->\n"
    text += "<!-- trial b.csv: Move two -->\n{}<!-- end -->\n"
    path.write_text(text.format("", ""), encoding="utf-8")
    read_document(path, "trial").write(TABLES)
    assert path.read_text(encoding="utf-8") == text.format(
        "\n* [Move one: far](far.csv)\n\n", "\n* [Move two](b.csv)\n\n"
    )
    file = tmp_path / "far.csv"
    assert file.read_text(encoding="utf-8") == "strategy,s\na,1.2\n"
    assert read_document(path, "trial").stale(TABLES) == []
    assert unlike_files(path) == []
    file.write_text("strategy,s\na,1.9\n", encoding="utf-8")
    stale = f"{path}, Move one: far: s of 'a' is 1.9, now 1.2."
    assert read_document(path, "trial").stale(TABLES) == [stale]
    file.unlink()
    (missing,) = read_document(path, "trial").stale(TABLES)
    assert "it is not there" in missing
    (missing,) = unlike_files(path)
    assert "the block of far.csv" in missing


WIDE = ResultTable(
    "Swing [mrad]: (0, 1) to (2, 3)",
    [("strategy", ""), ("cases", ",d"), ("left", ".2f>0.1"), ("a|b", ".1f")],
    [("flat | LQR", 106496, 0.02, None), ("PD", 5, 3.25, -1.0)],
)
WIDE_SHOWN = (
    "<!-- trial table swing.csv: Swing -->\n\n**Swing [mrad]** ([CSV](swing.csv))\n\n"
    "| strategy | cases | left | a\\|b |\n| --- | ---: | ---: | ---: |\n"
    "| flat \\| LQR | 106496 | < 0.1 | - |\n| PD | 5 | 3.20 | -1.0 |\n\n<!-- end -->\n"
)


def test_a_table_with_a_csv_file_stands_on_the_page_with_a_link_to_it(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text("<!-- trial table swing.csv: Swing -->\n<!-- end -->\n", encoding="utf-8")
    read_document(path, "trial").write([WIDE])
    assert path.read_text(encoding="utf-8") == WIDE_SHOWN
    assert read_document(path, "trial").stale([WIDE]) == []
    assert unlike_files(path) == []


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("| 5 |", "| 6 |"),
        ("| PD | 5 | 3.20 | -1.0 |\n", ""),
        ("left", "right"),
        ("(swing.csv))", "(other.csv))"),
        ("**Swing", "Swing"),
    ],
)
def test_a_table_on_a_page_that_is_not_that_of_its_csv_file_is_named(
    before: str, after: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "page.md"
    path.write_text(WIDE_SHOWN, encoding="utf-8")
    read_document(path, "trial").write([WIDE])
    assert before in WIDE_SHOWN
    path.write_text(WIDE_SHOWN.replace(before, after), encoding="utf-8")
    assert unlike_files(path) == [f"{path}: the block of swing.csv is not what the file holds."]
    assert main([str(path), "--results", str(tmp_path)]) == 1
    assert "the block of swing.csv" in capsys.readouterr().out


SHOWN = (
    "<!-- trial: -->\n\n**Move**\n\n| strategy | s | mrad | left |\n| --- | ---: | ---: | ---: |\n"
    "| a | 12.86 | 1.02e-05 | < 0.1 |\n| b | - | 5.52 | 0.7 |\n\n<!-- end -->\n"
)
A = ("a", 12.86, 1.02e-5, 0.055)
B = ("b", None, 5.52, 0.69)


@pytest.mark.parametrize(
    ("rows", "stale"),
    [
        ([A, B], []),
        # off by half of a digit, and on the edge of the next; the last column has a resolution
        ([("a", 12.8649, 1.029e-5, 0.14), ("b", None, 5.5101, 0.79)], []),
        ([("a", 12.86, 1.02e-5, 0.0), ("b", None, 5.52, 0.61)], []),
        ([("a", 12.8711, 1.02e-5, 0.0), B], ["s of 'a' is 12.86, now 12.87"]),
        (
            [("a", 12.86, 1.04e-5, 0.0), ("b", None, 3.59, 0.7)],
            ["mrad of 'a' is 1.02e-05, now 1.04e-05", "mrad of 'b' is 5.52, now 3.59"],
        ),
        (
            [("a", 12.86, 1.02e-5, 0.16), ("b", None, 5.52, 0.05)],
            ["left of 'a' is < 0.1, now 0.2", "left of 'b' is 0.7, now < 0.1"],
        ),
        (
            [("a", None, 1.02e-5, 0.0), ("b", 1.0, 5.52, 0.7)],
            ["s of 'a' is 12.86, now -", "s of 'b' is -, now 1.00"],
        ),
        ([A], ["its row 'b' was not made"]),
        ([A, B, ("c", 1.0, 1.0, 1.0)], ["a row 'c' is not there"]),
    ],
)
def test_a_cell_that_is_not_what_is_made_now_is_named(
    rows: list[tuple[object, ...]], stale: list[str], tmp_path: Path
) -> None:
    # A header ends with a blank where another is the same.
    columns = [("strategy", ""), ("s ", ".2f"), ("mrad", ".3g"), ("left", ".3g>0.1")]
    table = ResultTable("Move", columns, rows)  # type: ignore[arg-type]
    page = tmp_path / "page.md"
    page.write_text(SHOWN, encoding="utf-8")
    document = read_document(page, "trial")
    for part in (False, True):
        assert document.stale([table], subset=part) == [
            f"{tmp_path / 'page.md'}, Move: {sentence}."
            for sentence in stale
            if not (part and "was not made" in sentence)
        ]


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (0.0548, ".3g>0.1", "< 0.1"),
        (-0.0548, "+.3g>0.1", "< 0.1"),
        (0.154, ".3g>0.1", "0.2"),
        (16.14, ".3g>0.1", "16.1"),
        (1244.0, ".3g>0.1", "1.24e+03"),
        (4.4e-16, "+.1e>1e-11", "< 1e-11"),
        (-3.14e-4, "+.1e>1e-11", "-3.1e-04"),
        (None, ".3g>0.1", "-"),
    ],
)
def test_no_digit_below_the_resolution_of_a_column_is_shown(
    value: float | None, form: str, shown: str
) -> None:
    assert ResultTable("t", [("a", form)], [(value,)]).shown() == [[shown]]


def test_a_number_that_a_document_tells_may_be_off_by_one_of_its_last_digit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.document_numbers.ROOT", tmp_path)
    (tmp_path / "page.md").write_text("Within 0.0021 %\nor 6.4e-6 rad, 36 forms.", encoding="utf-8")
    right = ["Within 0.0021 %", "within 0.0022 %".capitalize(), "% or 6.5e-6 rad, 36 forms"]
    wrong = ["Within 0.0023 %", "6.6e-6 rad", "37 forms", "6 forms", "4e-6 rad", "36 form of"]
    assert missing(right + wrong, "page.md") == wrong


def test_documents_are_held_against_results_and_filled_from_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    results = tmp_path / "out" / "trial"
    page.write_text(SHOWN + "<!-- other: -->\nkept\n<!-- end -->\n", encoding="utf-8")
    results.mkdir(parents=True)
    kept = ResultTable("Move", [("way", ""), ("s", ".1f")], [("a", 1.25)]).stored()
    (results / "result.json").write_text(json.dumps({"tables": [kept]}), encoding="utf-8")
    words = [str(page), "--results", str(tmp_path / "out")]
    assert main(words) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{page}: there is no result of other in {tmp_path / 'out'}; its tables are not looked at.",
        f"{page}, Move: it is not there, or has other columns.",
        "1 cells or rows are stale.",
    ]
    assert main([*words, "--write"]) == 0
    assert main(words) == 0
    assert "| a | 1.2 |" in page.read_text(encoding="utf-8")
    (results / "result.json").write_text('{"tables": [{"title": "Move"}]}', encoding="utf-8")
    assert main(words) == 2
    assert "is not the result of an experiment" in capsys.readouterr().err


@pytest.mark.parametrize("form", [".3f", "+.2e", ",d", ",.6g", "%", ".10g"])
def test_a_table_takes_formats_of_sign_thousands_digits_and_kind(form: str) -> None:
    assert ResultTable("t", [("a", form)], [(1,)]).shown() == [[format(1, form)]]


@pytest.mark.parametrize("form", [".999999999f", "<10", "010d", "{", "_d", "f ", ".3g>2"])
def test_a_table_with_another_format_cannot_be_made(form: str) -> None:
    with pytest.raises(ValueError, match="has the format"):
        ResultTable("t", [("a", form)], [(1,)])


@pytest.mark.parametrize("row", [(1.5,), (1, 2), ("text",)])
def test_a_table_whose_rows_cannot_be_shown_cannot_be_made(row: tuple[object, ...]) -> None:
    with pytest.raises((ValueError, TypeError)):
        ResultTable("t", [("a", "d")], [row])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no marks", "has no lines <!-- trial: --> and <!-- end -->"),
        (
            "<!-- trial: Move three -->\n<!-- end -->\n",
            "asks for a table 'Move three', which is not among those of trial",
        ),
        (
            "<!-- trial: -->\nold\n\nOther text.\n<!-- other: -->\nkept\n<!-- end -->\n",
            "has no line <!-- end --> before the next",
        ),
        ("<!-- trial csv: -->\n<!-- end -->\n", "has a line <!-- end --> without a block before"),
        (
            "<!-- trial moves.csv: Move -->\n<!-- end -->\n",
            "block for moves.csv is the beginning of those of 2 tables",
        ),
    ],
)
def test_a_document_without_a_place_for_a_table_is_refused_and_left_alone(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "page.md"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=words):
        read_document(path, "trial").write(TABLES)
    assert path.read_text(encoding="utf-8") == text
