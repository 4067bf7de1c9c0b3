"""Workbooks of spreadsheet programs (.xlsx, .xls, .xlsb, .ods): their sheets as cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.data.bounded import read_bounded

HEADER_ROWS = 200
"""Number of rows at the top of a sheet among which the first row of numbers is looked for."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """Cells of a sheet.

    Attributes:
        name: Name of the sheet.
        numbers: Numbers, NaN where a cell holds none, shape (rows, columns). Dates count in seconds
            from 1970, times of day and durations in seconds.
        words: Words by row and column, both from 0.
        last_date: Last row of each column that holds a date, -1 for none.
        last_number: Last row of each column that holds a number which is no date, -1 for none.
    """

    name: str
    numbers: np.ndarray
    words: Mapping[tuple[int, int], str]
    last_date: tuple[int, ...]
    last_number: tuple[int, ...]

    def holds_dates(self, column: int, first: int) -> bool:
        """Return whether a column holds a date from a row on."""
        return self.last_date[column] >= first

    def holds_numbers(self, column: int, first: int) -> bool:
        """Return whether a column holds a number that is no date from a row on."""
        return self.last_number[column] >= first

    def cell(self, row: int, column: int) -> float | str:
        """Return the number or the words of a cell, an empty text where it is empty."""
        word = self.words.get((row, column))
        if word:
            return word
        number = float(self.numbers[row, column])
        return "" if np.isnan(number) else number

    def row(self, row: int) -> list[float | str]:
        """Return the cells of a row."""
        return [self.cell(row, column) for column in range(self.numbers.shape[1])]

    def first_row(self) -> int | None:
        """Return the index of the first of two rows of numbers, or None if there are none: rows of
        two numbers or more, or of one beside empty cells.
        """
        height = min(len(self.numbers), HEADER_ROWS)
        rows = [self._is_row(i) for i in range(height)]
        for i, is_row in enumerate(rows):
            is_last_of_sheet = i + 1 == len(self.numbers)
            is_followed = i + 1 < height and rows[i + 1]
            if is_row and (is_last_of_sheet or is_followed):
                return i
        return None

    def _is_row(self, row: int) -> bool:
        """Return whether a row has two numbers or more, or one beside empty cells."""
        width = self.numbers.shape[1]
        number_count = int(np.isfinite(self.numbers[row]).sum())
        word_count = sum((row, column) in self.words for column in range(width))
        return number_count >= 2 or (number_count == 1 and word_count == 0 and width > 1)


def read_sheets(path: str | Path) -> list[Sheet]:
    """Read the sheets of a workbook.

    Raises:
        DataError: As `cranedyn.data.bounded.read_bounded`.
        CraneError: If python-calamine is not installed.
    """
    result = read_bounded(path, "workbook")
    numbers = result.content.view("<f8")
    sheets: list[Sheet] = []
    begin = 0
    for described in result.header["sheets"]:
        height = int(described["height"])
        width = int(described["width"])
        matrix = numbers[begin : begin + height * width].reshape(height, width)
        begin += height * width
        words = {(int(i), int(j)): str(text) for i, j, text in described["texts"]}
        last_date = tuple(int(row) for row in described["last_date"])
        last_number = tuple(int(row) for row in described["last_number"])
        sheets.append(
            Sheet(
                name=str(described["name"]),
                numbers=matrix,
                words=words,
                last_date=last_date,
                last_number=last_number,
            )
        )
    return sheets
