"""Times as clocks and calendars write them: 10:15:30.5, 2024-05-01T10:15:30.5+02:00 and 01.05.2024
10:15:30.5.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2})([.,]\d+)?")
"""Hours, minutes, seconds and their fraction; hours may be missing where there is a fraction."""

_DATE_TIME = re.compile(
    r"(?:(?P<year>\d{4})(?P<mark>[-/])(?P<month>\d\d?)(?P=mark)(?P<day>\d\d?)"
    r"|(?P<day_first>\d\d?)\.(?P<month_second>\d\d?)\.(?P<year_last>\d{4}))[T ]+"
    r"(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d)(?P<fraction>[.,]\d+)?"
    r"\s*(?P<zone>Z|[+-]\d\d(?::?\d\d)?)?"
)
"""Date and time, with a fraction of a second and a time zone: the year first, as in ISO 8601, or
day, month and year with points between."""

_SLASHED = re.compile(r"\d\d?/\d\d?/\d{4}[T ]+\d\d?:\d\d.*")
"""A date whose month may be the first or the second number."""

_DAY = 86_400.0
"""Length of a day [s]."""

_MIDNIGHT_STEP = -0.5 * _DAY
"""Step of a clock below which it has passed midnight [s]: it falls back by more than half a day."""


def is_clock_time(text: str) -> bool:
    """Return whether a text is a time of a clock or a date with a time."""
    return bool(_DATE_TIME.fullmatch(text) or _CLOCK.fullmatch(text) or _SLASHED.fullmatch(text))


def clock_seconds(texts: Sequence[str]) -> np.ndarray:
    """Return times in seconds: dates with times count from the first of them, hours, minutes and
    seconds from 0:00:00. A clock that passes midnight goes on.

    Args:
        texts: The times, all of one kind; empty where there is none.

    Returns:
        The times [s], NaN where there is none, shape (times,).

    Raises:
        ValueError: If one is no time, or is ambiguous, or some have a time zone and others have
            none; the text says which.
    """
    seconds = np.full(len(texts), np.nan)
    fractions = np.zeros(len(texts))
    zones: set[bool] = set()
    kinds: set[str] = set()
    for row, text in enumerate(texts):
        if not text:
            continue
        date_time = _DATE_TIME.fullmatch(text)
        if date_time is not None:
            kinds.add("date")
            zones.add(date_time["zone"] is not None)
            seconds[row] = _date_seconds(date_time)
            fractions[row] = _fraction(date_time["fraction"])
            continue
        clock = _CLOCK.fullmatch(text)
        if clock is not None:
            kinds.add("clock")
            seconds[row] = _day_seconds(clock, text)
            fractions[row] = _fraction(clock[4])
            continue
        if _SLASHED.fullmatch(text):
            raise ValueError(
                f"{text!r} may have its day or its month first; write 2024-05-01T10:15:30 (ISO "
                "8601)"
            )
        raise ValueError(
            f"{text!r} in data row {row + 1} is no time; allowed are seconds, h:m:s, and "
            "2024-05-01T10:15:30 (ISO 8601)"
        )
    if len(kinds) > 1:
        raise ValueError("some of its times have a date and others have none")
    if len(zones) > 1:
        raise ValueError("some of its times have a time zone and others have none")
    present = np.flatnonzero(np.isfinite(seconds))
    if not len(present):
        return seconds
    if kinds == {"date"}:
        # Whole seconds since the year 1 are some 6e10: beside them a double holds some microseconds
        # only. So they count from the first one, and fractions are added after that.
        return (seconds - seconds[present[0]]) + (fractions - fractions[present[0]])
    steps = np.diff(seconds[present])
    midnights = np.cumsum(steps < _MIDNIGHT_STEP)
    seconds[present[1:]] += _DAY * midnights
    return seconds + fractions


def _fraction(digits: str | None) -> float:
    """Return a fraction of a second from its mark and digits, 0 where there is none."""
    return float(digits.replace(",", ".")) if digits else 0.0


def _date_seconds(match: re.Match[str]) -> float:
    """Return the whole seconds of a date with a time from the year 1 on."""
    year = int(match["year"] or match["year_last"])
    month = int(match["month"] or match["month_second"])
    day = int(match["day"] or match["day_first"])
    hour = int(match["hour"])
    minute = int(match["minute"])
    second = int(match["second"])
    try:
        days = date(year, month, day).toordinal()
    except ValueError:
        raise ValueError(f"{match[0]!r} has a date that is none") from None
    zone = match["zone"] or "Z"
    offset = 0.0
    if zone != "Z":  # +HH, +HHMM or +HH:MM: a time in the east is that much ahead of UTC
        minutes = int(zone[1:3]) * 60 + int(zone[3:].removeprefix(":") or 0)
        offset = 60.0 * minutes * (-1.0 if zone[0] == "-" else 1.0)
    _check_ranges(match[0], hour, minute, second)
    return days * _DAY + 3600.0 * hour + 60.0 * minute + second - offset


def _day_seconds(match: re.Match[str], text: str) -> float:
    """Return the whole seconds of a time of a clock from 0:00:00 on."""
    if match[1] is None and match[4] is None:
        raise ValueError(
            f"{text!r} may be hours and minutes or minutes and seconds; write it with three parts, "
            "as 0:10:15"
        )
    hour = int(match[1] or 0)
    minute = int(match[2])
    second = int(match[3])
    # Hours are not bounded: a time since the start of a recording may have a hundred.
    _check_ranges(text, 0, minute, second)
    return 3600.0 * hour + 60.0 * minute + second


def _check_ranges(text: str, hour: int, minute: int, second: int) -> None:
    """Check that a time is one of a day; 24:00:00 is its end, and 60 s are a leap second."""
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError(f"{text!r} is no time of a day")
