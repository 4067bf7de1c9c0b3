"""Documents that show tables as printed."""

from __future__ import annotations

from pathlib import Path

import pytest

from cranedyn.errors import DataError
from experiments.document import read_document
from experiments.outcome import Table

TABLES = [Table("Move one: far", [("way", ""), ("s", ".1f")], [("a", 1.25)]), Table("Move two", [("way", "")], [("b",)], "A note.")]
TEXT = (
    "Before.\n\n<!-- trial: Move two -->\nold\n<!-- end -->\n\nBetween.\n\n<!-- other: -->\nkept\n<!-- end -->\n"
    "<!-- trial: -->\n<!-- end -->\nAfter.\n"
)


def test_each_block_gets_the_tables_it_asks_for_and_all_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(TEXT, encoding="utf-8")
    read_document(path, "trial").write(TABLES)
    once = path.read_text(encoding="utf-8")
    first, second = (f"{table.markdown()}\n" for table in TABLES)
    assert once == (
        f"Before.\n\n<!-- trial: Move two -->\n\n{second}\n<!-- end -->\n\nBetween.\n\n<!-- other: -->\nkept\n<!-- end -->\n"
        f"<!-- trial: -->\n\n{first}\n{second}\n<!-- end -->\nAfter.\n"
    )
    read_document(path, "trial").write(TABLES)
    assert path.read_text(encoding="utf-8") == once


@pytest.mark.parametrize("form", [".3f", "+.2e", ",d", ",.6g", "%", ".10g", ""])
def test_a_table_takes_formats_of_sign_thousands_digits_and_kind(form: str) -> None:
    assert Table("t", [("a", form)], [("1" if form == "" else 1,)]).shown() == [[format("1" if form == "" else 1, form)]]


@pytest.mark.parametrize("form", [".999999999f", "<10", "010d", "{", "_d", "f "])
def test_a_table_with_another_format_cannot_be_made(form: str) -> None:
    with pytest.raises(ValueError, match="has the format"):
        Table("t", [("a", form)], [(1,)])


@pytest.mark.parametrize("row", [(1.5,), (1, 2), ("text",)])
def test_a_table_whose_rows_cannot_be_shown_cannot_be_made(row: tuple[object, ...]) -> None:
    with pytest.raises((ValueError, TypeError)):
        Table("t", [("a", "d")], [row])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no marks", "has no lines <!-- trial: --> and <!-- end -->"),
        ("<!-- trial: Move three -->\n<!-- end -->\n", "asks for a table 'Move three', which is not among those of trial"),
    ],
)
def test_a_document_without_a_place_for_a_table_is_refused_and_left_alone(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "page.md"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=words):
        read_document(path, "trial").write(TABLES)
    assert path.read_text(encoding="utf-8") == text
