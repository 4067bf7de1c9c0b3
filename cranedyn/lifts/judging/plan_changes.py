"""What differs between the results of two judgements of a lift.

Numbers are compared as they are printed: two are the same if they differ by one in their last
printed digit at most, since another processor may round the other way. Everything else has to be
the same: words, verdicts, counts, and what was entered.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from cranedyn.lifts.judging.plan_inputs import input_changes
from cranedyn.lifts.judging.plan_record import (
    PlanRecord,
    PlanResult,
    RecordedCheck,
    RecordedTable,
)

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")
"""A printed number; not the digits in a name such as "HC2"."""

_UNIT = re.compile(r"\s?(?:%|°|(?:kN m|kN|kg|mrad|rpm|mm|ms|m/s|m|s|t|N|Pa|rad)\b)")
"""A unit that follows a measured number. A whole number without a unit is a count, which has to be
the same."""

_ROUNDING = 1.0 + 1e-6
"""Difference of two numbers of which one is rounded the other way, over one in the last digit;
decimal fractions are no binary ones, so that one is a little more than one."""


def same_text(first: str, second: str) -> bool:
    """Return whether two texts say the same: the same words, and numbers that differ by one in the
    last printed digit at most. Whole numbers without a unit have to be equal.
    """
    if first == second:
        return True
    if _NUMBER.sub("#", first) != _NUMBER.sub("#", second):
        return False
    matches = zip(_NUMBER.finditer(first), _NUMBER.finditer(second), strict=True)
    for old, new in matches:
        has_unit = _UNIT.match(first, old.end()) is not None
        if not _same_number(old[0], new[0], has_unit=has_unit):
            return False
    return True


def _same_number(old: str, new: str, *, has_unit: bool) -> bool:
    """Return whether two printed numbers are the same but for rounding."""
    if old == new:
        return True
    is_count = old.lstrip("+-").isdigit() and new.lstrip("+-").isdigit() and not has_unit
    if is_count:
        return False
    difference = abs(float(old.replace(",", "")) - float(new.replace(",", "")))
    return difference <= _ROUNDING * max(_last_digit(old), _last_digit(new))


def _last_digit(number: str) -> float:
    """Return the value of one in the last digit of a printed number."""
    mantissa, _, exponent = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - decimals)


def result_changes(before: PlanResult, after: PlanResult) -> list[str]:
    """Return all that differs between two results, a sentence without a full stop each: the word,
    the checks with their numbers, and the tables.
    """
    changes = _word_changes(before, after)
    new_checks = {check.name: check for check in after.checks}
    old_names = {check.name for check in before.checks}
    for check in before.checks:
        changes += _check_changes(check, new_checks.get(check.name))
    for check in after.checks:
        if check.name not in old_names:
            changes.append(f"new check {check.name} ({check.verdict}): {check.sentence}")
    new_tables = {table.title: table for table in after.tables}
    old_titles = {table.title for table in before.tables}
    for table in before.tables:
        changes += _table_changes(table, new_tables.get(table.title))
    changes += [
        f"new table {table.title!r}" for table in after.tables if table.title not in old_titles
    ]
    return changes


def _word_changes(before: PlanResult, after: PlanResult) -> list[str]:
    """Return how the verdict has changed; nothing if it has not."""
    return [] if before.word == after.word else [f"verdict: {before.word} → {after.word}"]


def _check_changes(old: RecordedCheck, new: RecordedCheck | None) -> list[str]:
    """Return how a check has changed: its verdict, or what its sentence says."""
    if new is None:
        return [f"check {old.name} is not there any more: {old.sentence}"]
    if old.verdict != new.verdict:
        return [f"check {old.name}: {old.verdict} → {new.verdict}: {new.sentence}"]
    if not same_text(old.sentence, new.sentence):
        return [f"check {old.name}: {old.sentence} → {new.sentence}"]
    return []


def _table_changes(old: RecordedTable, new: RecordedTable | None) -> list[str]:
    """Return how a table has changed, cell by cell."""
    if new is None:
        return [f"table {old.title!r} is not there any more"]
    if old.columns != new.columns or len(old.rows) != len(new.rows):
        return [f"table {old.title!r} has other rows or columns"]
    changes = []
    for old_row, new_row in zip(old.rows, new.rows, strict=True):
        for header, was, now in zip(old.columns, old_row, new_row, strict=True):
            # In most tables the unit of a cell stands in the first column or in the header.
            unit = f"{header} {old_row[0]}"
            if not same_text(f"{was} {_unit_in(unit)}", f"{now} {_unit_in(unit)}"):
                column = f", {header}" if header else ""
                changes.append(f"{old.title}, {old_row[0]}{column}: {was} → {now}")
    return changes


def _unit_in(heading: str) -> str:
    """Return the unit that stands in brackets in a heading; empty if there is none."""
    match = re.search(r"\[([^\]]+)\]", heading)
    return "" if match is None else match[1]


def key_changes(before: PlanResult, after: PlanResult) -> list[str]:
    """Return what somebody who accepted a result has to know of another one: the verdict, checks
    whose verdict has changed or that are new or gone, and the numbers of the first table.
    """
    changes = _word_changes(before, after)
    new_checks = {check.name: check for check in after.checks}
    old_checks = {check.name: check for check in before.checks}
    for check in before.checks:
        now = new_checks.get(check.name)
        if now is None or now.verdict != check.verdict:
            changes += _check_changes(check, now)
    for check in after.checks:
        if check.name not in old_checks:
            changes.append(f"new check {check.name} ({check.verdict}): {check.sentence}")
    changes += _first_table_changes(before.tables, after.tables)
    return changes


def _first_table_changes(
    before: Sequence[RecordedTable], after: Sequence[RecordedTable]
) -> list[str]:
    """Return how the numbers have changed that decide, row by row."""
    if not before or not after:
        return []
    old_rows = {row[0]: row for row in before[0].rows if row}
    new_rows = {row[0]: row for row in after[0].rows if row}
    changes = []
    for name in [*old_rows, *(name for name in new_rows if name not in old_rows)]:
        was = ", ".join(cell for cell in old_rows.get(name, ())[1:])
        now = ", ".join(cell for cell in new_rows.get(name, ())[1:])
        if not same_text(was, now):
            changes.append(f"{name}: {was or 'not there'} → {now or 'not there'}")
    return changes


def revision_changes(before: PlanRecord, after: PlanRecord) -> list[str]:
    """Return what has changed from one revision of a plan to another: inputs by field, verdict,
    checks, and key numbers.
    """
    inputs = input_changes(before.inputs, after.inputs)
    return [*inputs, *key_changes(before.result, after.result)]
