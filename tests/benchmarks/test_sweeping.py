"""The benchmark of sweeps measures what it says."""

from __future__ import annotations

import itertools
import time
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import sweep_studies, sweeping
from cranedyn.errors import CraneError
from cranedyn.sweep.study import study_name

ONE = sweeping.Way("1 process", 1, None)


@pytest.mark.slow
def test_a_pace_is_that_of_the_parts_and_not_of_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    # By clocks that show the first part 3 s after the start, and one every 50 ms from then on.
    clock, processor = (itertools.chain([0.0], itertools.count(3.0, each)) for each in (0.05, 0.01))
    times = SimpleNamespace(perf_counter=clock.__next__, process_time=processor.__next__)
    monkeypatch.setattr(sweeping, "time", times)
    found = sweeping.pace(sweep_studies.waiting, ONE, 8, 1)
    assert found.first == 3.0
    assert found.each == pytest.approx(0.05)
    assert found.busy == pytest.approx(0.01)


@pytest.mark.slow
def test_bad_cases_end_a_measurement() -> None:
    from tests.studies import hopeless

    assert study_name(hopeless) == "tests.studies:hopeless"
    with pytest.raises(CraneError, match="of 4 cases went wrong"):
        sweeping.pace(hopeless, ONE, 1, 4)


def test_the_swings_are_those_of_the_crane() -> None:
    found = sweep_studies.swinging({"x": np.linspace(0.0, 1.0, 9)})["peak_rad"]
    assert found == pytest.approx(0.3 * np.linspace(0.0, 1.0, 9), rel=1e-3, abs=1e-12)


def test_the_plan_is_arithmetic_on_what_was_measured() -> None:
    measured = sweeping.Overhead(once=36.0, part=0.36, case=3.6e-6)
    table = sweeping.billion_case_table(measured, spent=86400.0 / 1e9, size=20.0, workers=8)
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["disk, a parameter and a result of a case"] == "20 GB"
    assert rows["computing on one processor"] == "1.0 days"
    # 100 starts, 10,000 parts and a billion cases: an hour each
    assert rows["the one program that hands out and writes"] == "3.0 h"
    assert rows["processors that it keeps busy"] == "8"
    assert rows["with 64 processors"] == "3.0 h"


def test_the_plan_says_nothing_of_processors_where_the_cost_of_a_case_is_lost_in_noise() -> None:
    table = sweeping.billion_case_table(sweeping.Overhead(1.0, 1e-3, -1e-9), 4e-4, 25.0, 2)
    assert "lost in the noise" in table.note
    assert not [row for row in table.rows if "processors" in str(row[0])]


@pytest.mark.long
def test_dasks_workers_compute_what_processes_do() -> None:
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    before = time.perf_counter()
    with sweeping.way("Dask", 1) as by:
        assert by.name == "Dask, 1 worker"
        assert by.scheduler.startswith("tcp://127.0.0.1:")
        found = sweeping.pace(sweep_studies.nothing, by, 6, 10)
    assert 0.0 < found.each < time.perf_counter() - before
