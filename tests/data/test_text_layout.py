"""Text tables of any program: what is recognised, and what is refused since it is ambiguous."""

from __future__ import annotations

import pytest

from cranedyn.data.text_layout import BLANKS, TextLayout, text_encoding, text_layout


def layout(text: str, encoding: str = "utf-8") -> TextLayout:
    return text_layout(text.encode(encoding), complete=True)


@pytest.mark.parametrize(
    ("text", "delimiter", "decimal"),
    [
        ("t,a\n0.5,1\n1.5,2\n", ",", "."),
        ("t;a\n0.5;1\n1.5;2\n", ";", "."),
        ("t;a\n0,5;1\n1,5;2\n", ";", ","),
        ("t\ta\n0,5\t1\n1,5\t2\n", "\t", ","),
        ("t|a\n0.5|1\n1.5|2\n", "|", "."),
        ('t,a\n"0,5","1,5"\n"1,5","2,5"\n', ",", ","),
        ("# t a\n0.5   1\n  1.5 2\n", BLANKS, "."),
        ("t;a\n1;2\n3;4\n", ";", "."),  # without any decimal mark
    ],
)
def test_delimiter_and_decimal_mark_are_those_that_make_numbers(
    text: str, delimiter: str, decimal: str
) -> None:
    found = layout(text)
    assert (found.delimiter, found.decimal) == (delimiter, decimal)
    assert found.names == ("t", "a")


@pytest.mark.parametrize(
    ("text", "names", "first_line"),
    [
        ("t,a\n0,1\n1,2\n", ("t", "a"), 1),
        (" t , swing angle \n0,1\n1,2\n", ("t", "swing angle"), 1),
        ("Recorder 3\n\nrate,100\nt,a\n0,1\n1,2\n", ("t", "a"), 4),
        ("# made by hand\n# t,a\n0,1\n1,2\n", ("t", "a"), 2),
        ("t,a,\n0,1\n1,2\n", ("t", "a"), 1),
        ("t,a\n0,1,\n1,2,\n", ("t", "a", ""), 1),
        ("0,1\n1,2\n", ("", ""), 0),
        ("# no header\n0,1\n1,2\n", ("", ""), 1),
        ("day,time,a\n01.05.24,0:00:01,1\n01.05.24,0:00:02,1\n", ("day", "time", "a"), 1),
    ],
)
def test_the_header_is_the_line_above_the_first_row(
    text: str, names: tuple[str, ...], first_line: int
) -> None:
    found = layout(text)
    assert found.names == names
    assert found.first_line == first_line


def test_a_row_of_units_is_told_from_a_header() -> None:
    assert layout("t,a,F\ns,[deg],(kN)\n0,1,2\n1,2,3\n").units == ("s", "[deg]", "(kN)")
    # Tonnes, volts and amperes are units, too, so a recorder above them makes the names no units.
    named = layout("first,second,third\nt,v,a\n0,1,2\n1,2,3\n")
    assert named.names == ("t", "v", "a")
    found = layout("recorder,3\nt,angle\n0,1\n1,2\n")
    assert found.units == ("", "")
    assert found.names == ("t", "angle")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings_are_told_by_their_marks_and_zeros(encoding: str) -> None:
    found = layout("t,Winkel [°]\n0,1\n1,2\n" * 1, encoding)
    assert found.names == ("t", "Winkel [°]")


def test_what_is_no_utf_8_is_taken_for_windows_and_said() -> None:
    found = layout("t,Winkel [°]\n0,1\n1,2\n", "cp1252")
    assert found.names == ("t", "Winkel [°]")
    assert found.remarks == ("the text is taken for Windows-1252, since it is not UTF-8",)


def test_a_character_that_the_sample_cuts_is_no_other_encoding() -> None:
    assert text_encoding("t,°".encode()[:-1]) == "utf-8"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("t;a\n1,500;1,100\n2,500;1,200\n", "'1,500' may be a decimal mark or one of thousands"),
        ("t,a\n0,5,0,1\n1,5,0,2\n", "line 1 has 2 cells and the rows below it have 4"),
        ("t;a\n0,5;1.5\n1,5;2.5\n", "one decimal mark"),
        ("t;a\n1.234,5;1\n2.345,5;2\n", "one decimal mark"),
        ("t;u;words\n1;2;a,1,2\n3;4;b,2,3\n", "',' and ';' separate its cells equally well"),
        ("a,b\n1,0.1,0.2\n2,0.1,0.2\n", "line 1 has 2 cells and the rows below it have 3"),
        ("hello\nworld\n", "has no rows of two numbers"),
        ("t,a\n", "has no rows of two numbers"),
        ("\0\0\1\2,\3", "it is not text"),
        ('t,a\n"0,1\n1,2\n', "line 2 has 1 cells and the rows below"),
    ],
)
def test_an_ambiguous_table_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        layout(text)


def test_a_cut_last_line_of_a_sample_does_not_count() -> None:
    text = "t,a\n0,1\n1,2\n2"
    assert text_layout(text.encode(), complete=False).names == ("t", "a")
