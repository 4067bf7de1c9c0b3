"""Times of clocks and calendars in seconds."""

from __future__ import annotations

import math

import pytest

from cranedyn.data.clock_times import clock_seconds, is_clock_time


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["0:00:01", "00:01:00.5", "1:00:00,25"], [1.0, 60.5, 3600.25]),
        (["00:01.5", "01:02.5"], [1.5, 62.5]),
        (["23:59:59.5", "0:00:00.5", "0:00:01.5"], [86399.5, 86400.5, 86401.5]),
        (["2024-05-01T10:15:30", "2024-05-01 10:15:31.5"], [0.0, 1.5]),
        (["2024-02-28T23:59:59Z", "2024-03-01T00:00:00Z"], [0.0, 86401.0]),  # a leap year
        (["2024-05-01T12:00:00+02:00", "2024-05-01T10:00:01Z"], [0.0, 1.0]),
        (["01.05.2024 10:15:30", "02.05.2024 10:15:30"], [0.0, 86400.0]),
        (["", "0:00:01", ""], [math.nan, 1.0, math.nan]),
    ],
)
def test_times_are_seconds(texts: list[str], seconds: list[float]) -> None:
    assert clock_seconds(texts).tolist() == pytest.approx(seconds, nan_ok=True, abs=1e-12)


def test_microseconds_of_a_date_are_kept() -> None:
    texts = [f"2024-05-01T10:15:30.{k:06d}" for k in range(5)]
    # one part in 2^53 of the fraction
    assert clock_seconds(texts).tolist() == pytest.approx([1e-6 * k for k in range(5)], abs=1e-15)


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        (["10:15", "10:16"], "may be hours and minutes or minutes and seconds"),
        (["01/02/2024 10:15:30"], "may have its day or its month first"),
        (["2024-05-01T10:15:30", "10:15:31"], "some of its times have a date"),
        (["2024-05-01T10:15:30Z", "2024-05-01T10:15:31"], "some of its times have a time zone"),
        (["2024-02-30T10:15:30"], "has a date that is none"),
        (["0:61:00"], "is no time of a day"),
        (["0:00:01", "x"], "'x' in data row 2 is no time"),
    ],
)
def test_a_time_that_may_be_two_is_refused(texts: list[str], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        clock_seconds(texts)


def test_numbers_are_no_times() -> None:
    assert not any(map(is_clock_time, ("1.5", "1e3", "2024-05-01", "x", "")))
