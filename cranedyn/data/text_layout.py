"""The layout of a text table of any program: encoding, delimiter, decimal mark, header and units.

A layout is recognised from the beginning of a file. Where two layouts fit a file equally well it is
refused, since each of them would give other numbers.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from cranedyn.data.clock_times import is_clock_time
from cranedyn.errors import DataError, quoted

SAMPLE = 200_000
"""Bytes at the beginning of a file by which its layout is recognised."""

BLANKS = " "
"""Delimiter of columns that any number of blanks and tabs separate."""

_COMMENT = re.compile(r"\s*(#|%|//)+\s*")
"""What a line of comment begins with."""

_NUMBERS = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I),
    ",": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I),
}
"""How a number is written, by the decimal mark."""

_MAX_NUMBER_LENGTH = 400
"""Number of characters up to which a cell may be a number; patterns of numbers take a time that
grows with the square of it."""

_DATE = re.compile(r"\d{1,4}([-./])\d{1,2}\1\d{1,4}")
"""A date in a column of its own, which says nothing about the layout."""

_DIGITS = re.compile(r"[-+\d.,;:|\s/eE]*\d[-+\d.,;:|\s/eE]*")
"""A cell of digits and separators only: if it is no number, the delimiter or the decimal mark that
was assumed is wrong."""

_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")
"""A number whose mark may be that of thousands, such as 1,500."""

_KNOWN_UNITS = frozenset(
    "s sec ms us µs ns min h rad mrad deg ° grad m mm cm km ft in rad/s mrad/s deg/s °/s rpm m/s "
    "mm/s cm/s m/min km/h m/s² m/s^2 m/s2 rad/s² rad/s^2 deg/s² deg/s^2 n kn nm knm n·m nmm j kj w "
    "kw v mv a ma hz kg t g bar pa kpa mpa % - 1 °c degc k bool count counts".split()
)
"""Units that a row of units may hold, in lower case."""

_TIME_UNITS = frozenset("s sec ms us µs ns min".split())
"""Units of time among them."""

_ENCODING_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Marks with which a text may begin, and the encodings that they stand for. Those of UTF-32 come
first: one of them begins with one of UTF-16."""

_UTF16_ZERO_SHARE = 0.4
"""Share of zeros among every second byte from which on a text is UTF-16: digits and delimiters have
one each, letters of other scripts have none."""

_DELIMITER_WORDS = {
    ";": "semicolons",
    "\t": "tabs",
    "|": "bars",
    BLANKS: "blanks",
    ",": "commas",
}
"""Delimiters in words, for remarks."""


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text table.

    Attributes:
        encoding: Encoding, by its name in Python.
        delimiter: What separates cells; `BLANKS` for any number of blanks.
        decimal: Decimal mark, "." or ",".
        names: Names of the columns; empty where one has none.
        units: Units of the columns in a row of their own; empty where there is none.
        clocks: Indices of the columns that hold times such as 10:15:30.5 or 2024-05-01T10:15:30Z.
        first_line: Index of the line of the first row, from 0.
        remarks: What was recognised besides a plain table, a sentence each.
    """

    encoding: str
    delimiter: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    clocks: frozenset[int]
    first_line: int
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """Rows of numbers of a sample under one delimiter and decimal mark.

    Attributes:
        delimiter: The delimiter.
        decimal: The decimal mark.
        cells: Cells of each line of the sample, by the index of the line; blank lines are left out.
        count: Number of lines that are rows of numbers.
        width: Number of cells of a row.
        first: Index of the line of the first row.
    """

    delimiter: str
    decimal: str
    cells: Mapping[int, list[str]]
    count: int
    width: int
    first: int


def text_encoding(sample: bytes) -> str:
    """Return the encoding of a text, by its name in Python, from its first bytes.

    Raises:
        ValueError: If it is not text.
    """
    for mark, encoding in _ENCODING_MARKS:
        if not sample.startswith(mark):
            continue
        if encoding == "utf-32":
            raise ValueError("it is text in UTF-32; save it as UTF-8")
        return encoding
    zeros_at_even = sample[::2].count(0)
    zeros_at_odd = sample[1::2].count(0)
    most_of_half = _UTF16_ZERO_SHARE * len(sample) / 2
    if zeros_at_odd > most_of_half and not zeros_at_even:
        return "utf-16-le"  # the low byte, which is not zero, comes first
    if zeros_at_even > most_of_half and not zeros_at_odd:
        return "utf-16-be"
    if zeros_at_even or zeros_at_odd:
        raise ValueError("it is not text")
    try:
        # The sample may end within a character.
        codecs.getincrementaldecoder("utf-8")().decode(sample)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def text_layout(sample: bytes, *, complete: bool) -> TextLayout:
    """Return the layout of a text table.

    Args:
        sample: Bytes at the beginning of the file.
        complete: Whether they are the whole file.

    Raises:
        ValueError: If it is no table, or its layout is ambiguous; the text says why.
    """
    encoding = text_encoding(sample)
    text = codecs.getincrementaldecoder(encoding)("replace").decode(sample)
    lines = re.split(r"\r\n|\n|\r", text)
    if not complete and len(lines) > 1:
        lines.pop()  # the last line may be cut
    rows = _only_fitting_rows(lines)
    header = _header(lines, rows)
    body = []
    for number, cells in rows.cells.items():
        if number >= rows.first and len(cells) == rows.width:
            body.append(cells)
    _check_decimal(rows, body)
    remarks: list[str] = []
    if encoding == "cp1252":
        remarks.append("the text is taken for Windows-1252, since it is not UTF-8")
    elif encoding.startswith("utf-16"):
        remarks.append("the text is taken for UTF-16")
    if rows.delimiter != "," or rows.decimal != ".":
        delimiter = _DELIMITER_WORDS[rows.delimiter]
        point = "comma" if rows.decimal == "," else "point"
        remarks.append(f"{delimiter} separate its cells, with a decimal {point}")
    return TextLayout(
        encoding=encoding,
        delimiter=rows.delimiter,
        decimal=rows.decimal,
        names=header.names,
        units=header.units,
        clocks=clock_columns(body, rows.width),
        first_line=rows.first,
        remarks=(*remarks, *header.remarks),
    )


def clock_columns(body: Sequence[Sequence[str]], width: int) -> frozenset[int]:
    """Return the indices of the columns whose first cell that is not empty is a time."""
    clocks: set[int] = set()
    for column in range(width):
        filled = (cells[column] for cells in body if cells[column])
        if is_clock_time(next(filled, "")):
            clocks.add(column)
    return frozenset(clocks)


def _split(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line without blanks around them."""
    if delimiter == BLANKS:
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:
        raise ValueError("it has a line that is no row of a table") from error
    return [cell.strip() for cell in cells]


def _is_table_row(cells: Sequence[str], decimal: str) -> bool:
    """Return whether a line is a row of the table.

    A row has two cells with a number or a time, or one such cell beside empty ones. No cell of it
    would be several numbers with another delimiter, or one with another decimal mark.
    """
    value_count = 0
    empty_count = 0
    word_count = 0
    for cell in cells:
        if not cell:
            empty_count += 1
        elif len(cell) > _MAX_NUMBER_LENGTH:
            word_count += 1
        elif _NUMBERS[decimal].fullmatch(cell) or is_clock_time(cell):
            value_count += 1
        elif _DIGITS.fullmatch(cell) and not _DATE.fullmatch(cell):
            return False
        else:
            word_count += 1
    return value_count >= 2 or (value_count == 1 and empty_count >= 1 and word_count == 0)


def _find_rows(cells: Mapping[int, list[str]], delimiter: str, decimal: str) -> _Rows | None:
    """Return the rows of a sample under a delimiter and a decimal mark; None if there is none.

    Args:
        cells: The cells of each line that is not blank, by its index.
        delimiter: What separates them.
        decimal: The decimal mark.
    """
    row_widths: dict[int, int] = {}
    for number, row in cells.items():
        if _is_table_row(row, decimal):
            row_widths[number] = len(row)
    if not row_widths:
        return None
    width, count = Counter(row_widths.values()).most_common(1)[0]

    # The first row is followed by another one, unless it is the last line: a title may look like a
    # row, too.
    numbers = list(cells)
    for place, number in enumerate(numbers):
        is_row = row_widths.get(number) == width
        is_last = place == len(numbers) - 1
        if is_row and (is_last or row_widths.get(numbers[place + 1]) == width):
            return _Rows(delimiter, decimal, cells, count, width, number)
    return None


def _only_fitting_rows(lines: Sequence[str]) -> _Rows:
    """Return the rows under the only delimiter and decimal mark that fit the lines.

    Raises:
        ValueError: If none fits, or several.
    """
    # Commas between cells with decimal commas, as in "0,1","0,2", and blanks come last: many a line
    # of another table could be read so, too.
    pairs = [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), ("|", ",")]
    fitting = _rows_under_each(lines, pairs)
    if not fitting:
        fitting = _rows_under_each(lines, [(",", ",")])
    if not fitting:
        fitting = _rows_under_each(lines, [(BLANKS, "."), (BLANKS, ",")])
    if not fitting:
        raise ValueError(
            "it has no rows of two numbers or more with one delimiter (comma, semicolon, tab, bar "
            "or blanks) and one decimal mark"
        )
    most = max(rows.count for rows in fitting)
    best = [rows for rows in fitting if rows.count == most]
    delimiters = {rows.delimiter for rows in best}
    if len(delimiters) > 1:
        names = " and ".join(sorted(map(repr, delimiters)))
        raise ValueError(f"{names} separate its cells equally well; write it with one of them")
    # Where no number has a decimal mark both marks fit, and the point comes first.
    return best[0]


def _rows_under_each(lines: Sequence[str], pairs: Sequence[tuple[str, str]]) -> list[_Rows]:
    """Return the rows under each pair of a delimiter and a decimal mark that fits."""
    cells: dict[str, dict[int, list[str]]] = {}
    fitting = []
    for delimiter, decimal in pairs:
        if delimiter not in cells:
            cells[delimiter] = _split_lines(lines, delimiter)
        rows = _find_rows(cells[delimiter], delimiter, decimal)
        if rows is not None:
            fitting.append(rows)
    return fitting


def _split_lines(lines: Sequence[str], delimiter: str) -> dict[int, list[str]]:
    """Return the cells of each line that is not blank, by its index."""
    cells = {}
    for number, line in enumerate(lines):
        if line.strip():
            cells[number] = _split(line, delimiter)
    return cells


def _check_decimal(rows: _Rows, body: Sequence[Sequence[str]]) -> None:
    """Check that a comma in numbers cannot be that of thousands.

    Raises:
        ValueError: If each number with a comma could have thousands.
    """
    if rows.decimal != ",":
        return
    with_comma: list[str] = []
    for cells in body:
        with_comma += [cell for cell in cells if "," in cell]
    if with_comma and all(_THOUSANDS.fullmatch(cell) for cell in with_comma):
        raise ValueError(
            f"the comma in {quoted(with_comma[0])} may be a decimal mark or one of thousands; "
            "write decimal points"
        )


@dataclass(frozen=True)
class TableHeader:
    """Names and units above the rows of a table.

    Attributes:
        names: Names of the columns; empty where one has none.
        units: Units of the columns in a row of their own; empty where there is none.
        remarks: Where they were found, a sentence each.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    remarks: tuple[str, ...]


class HeaderLine(NamedTuple):
    """Line above the first row of a table.

    Attributes:
        number: Its number, from 1.
        cells: Its cells.
        is_comment: Whether it begins as a comment.
    """

    number: int
    cells: list[str]
    is_comment: bool = False


def _header(lines: Sequence[str], rows: _Rows) -> TableHeader:
    """Return the names and units above the first row."""
    above: list[HeaderLine] = []
    for number in rows.cells:
        if number >= rows.first:
            break
        line = lines[number]
        comment = _COMMENT.match(line)
        cells = rows.cells[number]
        if comment is not None:
            cells = _split(line[comment.end() :], rows.delimiter)
        above.append(HeaderLine(number + 1, cells, is_comment=comment is not None))
    ends_empty = True
    for number, cells in rows.cells.items():
        if number >= rows.first and len(cells) == rows.width and cells[-1]:
            ends_empty = False
    return table_header(above, rows.width, rows.first + 1, ends_empty=ends_empty)


def table_header(
    above: Sequence[HeaderLine], width: int, first: int, *, ends_empty: bool
) -> TableHeader:
    """Return the names and units above the first row of a table.

    Args:
        above: The lines above the first row.
        width: Number of cells of a row.
        first: Number of the line of the first row.
        ends_empty: Whether the last cell of all rows is empty, which needs no name.

    Raises:
        ValueError: If the line above the rows is neither a comment nor a header of them.
    """
    blank = ("",) * width
    if not above:
        remark = f"it has no header; its columns are #1 to #{width}"
        return TableHeader(blank, blank, (remark,))
    last = above[-1]
    names = _as_header(last.cells, width, ends_empty)
    if names is None:
        if last.is_comment:
            remark = f"it has no header of {width} names; its columns are #1 to #{width}"
            return TableHeader(blank, blank, (remark,))
        raise ValueError(
            f"line {last.number} has {len(last.cells)} cells and the rows below it have {width}; "
            "allowed is a header with a name for each column, or none. A decimal comma beside "
            "commas between the cells makes such a file, too"
        )
    units = blank
    header_number = last.number
    if len(above) > 1 and is_row_of_units(names):
        line_above = above[-2]
        names_above = _as_header(line_above.cells, width, ends_empty)
        if names_above is not None and _are_names(names_above):
            units = names
            names = names_above
            header_number = line_above.number
    remarks = []
    if header_number > 1:
        remarks.append(f"its header is line {header_number}")
    if any(units):
        remarks.append(f"line {last.number} holds units")
    if first != last.number + 1:
        remarks.append(f"its first row is line {first}")
    return TableHeader(names, units, tuple(remarks))


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether each cell is a text other than a number."""
    return all(cells) and not any(_is_number(cell) for cell in cells)


def _as_header(cells: list[str], width: int, ends_empty: bool) -> tuple[str, ...] | None:
    """Return cells as a header with one name for each of `width` columns; None if they are none.

    A delimiter at the end of the header only makes a cell too many, one at the end of the rows only
    makes a cell too few. A header over rows that begin with a number of their own, which has no
    name, has a cell too few as well; it is refused, and told apart by the last cells of the rows,
    which are not empty there.
    """
    if len(cells) == width + 1 and not cells[-1]:
        cells = cells[:-1]
    elif len(cells) == width - 1 and len(cells) > 1 and ends_empty:
        cells = [*cells, ""]
    if len(cells) != width or not any(cells):
        return None
    return tuple(cells)


def is_row_of_units(cells: Sequence[str]) -> bool:
    """Return whether the cells of a row are units: each is empty, or a known unit in brackets or
    bare.

    Bare units must have one of time among them, since "t, v, a" are known units, too, but more
    likely names.
    """
    if not any(cells):
        return False
    are_bracketed = True
    has_time = False
    for cell in cells:
        if not cell:
            continue
        in_brackets = unit_in_brackets(cell)
        unit = (in_brackets or cell).lower()
        if unit not in _KNOWN_UNITS:
            return False
        # The brackets must enclose the whole cell: "x [m]" is a name with its unit.
        if not in_brackets or in_brackets != cell[1:-1].strip():
            are_bracketed = False
        if unit in _TIME_UNITS:
            has_time = True
    return are_bracketed or has_time


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number with any decimal mark."""
    if len(cell) > _MAX_NUMBER_LENGTH:
        return False
    return any(number.fullmatch(cell) for number in _NUMBERS.values())


def unit_in_brackets(name: str) -> str:
    """Return the unit at the end of a name such as "angle [deg]" or "Time (s)", empty if there is
    none.
    """
    match = re.search(r"(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*$", name)
    if match is None:
        return ""
    return (match[1] or match[2] or "").strip()


def is_unit(text: str) -> bool:
    """Return whether a text is a unit with a dimension, in any case of its letters."""
    return text.lower() in _KNOWN_UNITS - {"-", "1", "%"}


def not_a_table(path: object, error: ValueError) -> DataError:
    """Return the error that a file has no layout that can be read."""
    return DataError(f"Cannot read {path} as a table: {error}.")
