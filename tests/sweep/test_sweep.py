"""Sweeps: every case once and in order, bad cases alone are bad, and refusals leave nothing."""

from __future__ import annotations

import io
import shutil
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.progress import Progress as Bars

from cranedyn.errors import CraneError, DataError
from cranedyn.sweep import Design, Progress, Study, cross, grid, results, sweep
from cranedyn.sweep.study import DIED, LATE, Task, study_name
from experiments.harness import progress as reports
from tests import studies
from tests.helpers import files

pytestmark = pytest.mark.usefixtures("limited")


def _evaluate(study: Study, design: Design) -> dict[str, list]:
    """Results of a study of `tests.studies`, as a worker computes them, by column."""
    task = Task(f"tests.studies:{study.__name__}")
    return task.evaluate(design.columns).to_pydict()


# --- a chunk --------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 9), min_size=1, max_size=20))
@pytest.mark.slow
def test_bad_cases_say_why_and_cost_no_other_case_its_results(xs: list[int]) -> None:
    columns = _evaluate(studies.troubled, grid(x=xs))
    errors = {
        1: "ArithmeticError: one is too much",
        2: "The result y is nan.",
        3: "The result y is -inf.",
    }
    assert columns["error"] == [errors.get(x) for x in xs]
    # Where every case is bad, there are no columns of results.
    nothing = [None] * len(xs)
    masked = [None if x in (1, 2, 3, 4) else float(x * x) for x in xs]  # 4 is masked, not bad
    assert columns.get("y", nothing) == masked
    words = columns.get("word", nothing)
    assert [word is None for word in words] == [x in (1, 2, 3) for x in xs]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nothing", "AttributeError: 'NoneType' object has no attribute 'items'"),
        ("short", "The study returned y of shape (2,) and type float64; allowed are numbers"),
        ("complex", "The study returned y of shape (1,) and type complex128; allowed are numbers"),
        ("parameter", "The study returned a column x, which another column is called."),
        ("reserved", "The study returned a column error, which another column is called."),
    ],
)
def test_wrong_results_of_a_study_are_the_error_of_the_case(kind: str, message: str) -> None:
    columns = _evaluate(studies.careless, grid(x=range(2), kind=kind))
    assert list(columns) == ["error"]
    assert all(error.startswith(message) for error in columns["error"])


def test_a_study_cannot_end_the_worker_by_leaving() -> None:
    assert _evaluate(studies.leaving, grid(x=[1.0])) == {"error": ["SystemExit: enough"]}


def test_a_result_that_is_a_number_and_a_word_is_refused() -> None:
    with pytest.raises(DataError, match=r"The study returns results of different kinds: .*y"):
        _evaluate(studies.two_minded, grid(x=range(4)))


def test_a_study_needs_a_name_by_which_workers_import_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert study_name(studies.squares) == "tests.studies:squares"
    monkeypatch.setattr(studies.squares, "__module__", "__main__")
    monkeypatch.setattr("__main__.__spec__", None)
    for study in (lambda cases: cases, SimpleNamespace(), studies.squares, None):
        with pytest.raises(CraneError, match=r"A study must be a function at the top of a module"):
            study_name(study)  # type: ignore[arg-type]
    monkeypatch.setattr("__main__.__spec__", SimpleNamespace(name="experiments.sweep"))
    assert study_name(studies.squares) == "experiments.sweep:squares"  # by python -m


# --- a sweep --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_keeps_every_case_in_order_with_its_parameters(tmp_path: Path) -> None:
    design = cross(grid(strategy=["flat", "spline"]), grid(x=range(5)))
    folder = tmp_path / "a" / "b"
    reported: list[Progress] = []
    end = sweep(studies.squares, design, folder, chunk=3, workers=2, progress=reported.append)
    assert reported[0] == Progress(done=0, cases=10, errors=0, before=0)
    assert reported[-1] == Progress(done=10, cases=10, errors=0, before=0)
    assert len(reported) == 5
    assert end == reported[-1]
    assert reported == sorted(reported)
    table = results(folder)
    assert table.column_names == ["case", "strategy", "x", "y", "error"]
    assert table["case"].to_pylist() == list(range(10))
    for name, values in design.columns.items():
        assert table[name].to_pylist() == values.tolist()
    assert table["y"].to_pylist() == (design.columns["x"] ** 2).tolist()
    assert table["error"].null_count == 10
    assert pa.dataset.dataset(folder).to_table().num_rows == 10  # readable without us
    assert files(folder) == ["_sweep.json", *(f"part-{i:06d}.parquet" for i in range(4))]


@pytest.mark.slow
def test_results_are_the_same_to_the_bit_for_any_workers_and_chunks(tmp_path: Path) -> None:
    design = grid(x=[0.1 * k for k in range(20)])
    tables = []
    for workers, chunk in ((1, 20), (2, 3)):
        folder = tmp_path / str(workers)
        sweep(studies.squares, design, folder, chunk=chunk, workers=workers)
        tables.append(results(folder).combine_chunks())
    assert tables[0].equals(tables[1])


@pytest.mark.slow
def test_chunks_without_results_have_the_columns_of_the_others(tmp_path: Path) -> None:
    assert sweep(studies.hopeless, grid(x=range(7)), tmp_path, chunk=2, workers=1).errors == 4
    schema = pq.read_schema(tmp_path / "part-000003.parquet")  # of cases that are all good
    assert [field.name for field in schema] == ["case", "x", "y", "error"]
    for path in tmp_path.glob("part-*"):
        assert pq.read_schema(path).equals(schema)
    table = results(tmp_path)
    assert table["y"].to_pylist() == [None] * 4 + [16.0, 25.0, 36.0]
    assert table["error"].to_pylist() == ["ValueError: too small"] * 4 + [None] * 3


@pytest.mark.slow
def test_a_case_that_kills_its_worker_is_bad_alone(tmp_path: Path) -> None:
    sweep(studies.deadly, grid(x=range(8)), tmp_path, chunk=4, workers=2)
    table = results(tmp_path)
    assert table["error"].to_pylist() == [DIED if x == 3 else None for x in range(8)]
    assert table["y"].to_pylist() == [None if x == 3 else x * x for x in range(8)]


@pytest.mark.slow
def test_a_case_that_takes_too_long_is_bad_alone(tmp_path: Path) -> None:
    """Its worker, in native code that keeps Python's lock, is killed; the chunk of 4 has 4 times as
    long as a case, its halves half.
    """
    limit = 1.0  # in which a case that computes a square also ends on a busy machine
    start = time.monotonic()
    end = sweep(studies.stuck, grid(x=range(8)), tmp_path, chunk=4, workers=2, limit=limit)
    assert end == Progress(done=8, cases=8, errors=1, before=0)
    assert time.monotonic() - start > limit * (4 + 2 + 1)
    table = results(tmp_path)
    assert table["error"].to_pylist() == [LATE.format(limit) if x == 3 else None for x in range(8)]
    assert table["y"].to_pylist() == [None if x == 3 else x * x for x in range(8)]


def test_workers_that_cannot_be_started_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_to_start(*_: object, **_keywords: object) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr("cranedyn.sweep.workers.SpawnProcess", fail_to_start)
    with pytest.raises(CraneError, match=r"Cannot start a worker process: Too many open files\."):
        sweep(studies.squares, grid(x=range(2)), tmp_path / "sweep", workers=1)
    assert files(tmp_path) == []


@pytest.mark.slow
def test_a_sweep_without_a_chunk_goes_on_in_those_it_began_with(tmp_path: Path) -> None:
    design = grid(x=range(10))
    sweep(studies.squares, design, tmp_path, chunk=4, workers=1)
    (tmp_path / "part-000001.parquet").unlink()
    assert sweep(studies.squares, design, tmp_path, workers=1) == Progress(10, 10, 0, 6)
    assert len(list(tmp_path.glob("part-*"))) == 3
    # Nothing to do needs no workers.
    assert sweep(studies.squares, design, tmp_path, scheduler="tcp://127.0.0.1:1").done == 10


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("study", "design", "chunk", "difference"),
    [
        ("hopeless", grid(x=range(2)), 1, "study was tests.studies:squares, now tests.studies:"),
        ("squares", grid(x=1.0, a=range(2)), 1, "parameters was ('x',), now ('x', 'a')"),
        ("squares", grid(x=range(3)), 1, "cases was 2, now 3"),
        ("squares", grid(x=[0.0, 1.5]), 1, "parameters have other values"),
        ("squares", grid(x=range(2)), 2, "chunk was 1, now 2"),
    ],
)
@pytest.mark.slow
def test_another_sweep_is_not_swept_over(
    study: str, design: Design, chunk: int, difference: str, tmp_path: Path
) -> None:
    sweep(studies.squares, grid(x=range(2)), tmp_path, chunk=1, workers=1)
    with pytest.raises(DataError) as caught:
        sweep(getattr(studies, study), design, tmp_path, chunk=chunk)
    assert str(caught.value).startswith(
        f"Cannot sweep in {tmp_path}: it holds another sweep ({difference}"
    )


@pytest.mark.slow
def test_a_sweep_of_which_nothing_is_done_is_in_nobodys_way(tmp_path: Path) -> None:
    sweep(studies.squares, grid(x=[1.0]), tmp_path, workers=1)
    (tmp_path / "part-000000.parquet").unlink()
    with pytest.raises(DataError, match=r"has no finished case yet\."):
        results(tmp_path, partial=True)
    assert sweep(studies.squares, grid(x=range(10)), tmp_path, workers=1).done == 10


def test_a_folder_of_other_things_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a")
    with pytest.raises(DataError, match=r"it holds other things \(a\.csv\); give a folder of its"):
        sweep(studies.squares, grid(x=range(10)), tmp_path)
    assert files(tmp_path) == ["a.csv"]
    with pytest.raises(DataError, match=r"Cannot make the folder .*: File exists\."):
        sweep(studies.squares, grid(x=range(10)), tmp_path / "a.csv")
    with pytest.raises(DataError, match=r"holds no sweep: there is no _sweep\.json in it\."):
        results(tmp_path)


@pytest.mark.slow
def test_results_that_would_not_fit_the_memory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep(studies.squares, grid(x=range(10)), tmp_path, workers=1)
    monkeypatch.setattr("cranedyn.sweep.design.os.sysconf", lambda name: 25)
    with pytest.raises(DataError, match=r"The table of 10 cases would take 3\.2e-07 GB of memory"):
        results(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"study": None}, "A study must be a function"),
        ({"design": {"x": [1.0]}}, "allowed is a Design, see grid and sample."),
        ({"folder": "a\0b"}, "Cannot make the folder"),
        ({"folder": "/proc/none/a"}, "Cannot make the folder /proc/none/a: No such file"),
        ({"chunk": 0}, "chunk is 0; allowed is a whole number"),
        ({"workers": 1.5}, "number of workers is 1.5; allowed is a whole number"),
        ({"workers": 10**9}, "number of workers is 1000000000"),
        ({"limit": -1.0}, r"limit is -1\.0 s; allowed is 0\.001 to 1e\+06\."),
        ({"scheduler": "tcp://127.0.0.1:1"}, "has no effect beside a scheduler"),
        ({"security": 5}, "Certificates have no effect without a scheduler"),
    ],
)
def test_a_sweep_that_is_refused_leaves_nothing(
    change: dict, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments: dict[str, Any] = {
        "study": studies.squares,
        "design": grid(x=range(2)),
        "folder": "a/b",
        "workers": 1,
    }
    with pytest.raises(CraneError, match=message):
        sweep(**(arguments | change))
    assert files(tmp_path) == []


@pytest.mark.slow
def test_a_study_that_workers_cannot_import_is_reported_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies.squares, "__module__", "tests.elsewhere")
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "a" / "b", tmp_path / "there"):
        with pytest.raises(CraneError, match=r"cannot import the study tests\.elsewhere:squares: "):
            sweep(studies.squares, grid(x=range(2)), folder, workers=1)
    assert files(tmp_path) == ["there"]


@pytest.mark.slow
def test_results_that_would_not_fit_the_disk_are_refused_before_and_after_the_first_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def set_free_space(size: float) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=size))

    design = grid(x=range(1000))
    set_free_space(8 * 1999)
    with pytest.raises(DataError, match=r"The results of 1000 cases would take 1\.6e-05 GB; 1\.6e"):
        sweep(studies.wide, design, tmp_path, workers=1)
    set_free_space(8 * 2001)
    with pytest.raises(DataError, match=r"The results of 900 cases would take .* GB; 1\.6e-05 GB"):
        sweep(studies.wide, design, tmp_path, chunk=100, workers=1)
    assert len(list(tmp_path.glob("part-*"))) == 1
    set_free_space(1e9)
    assert sweep(studies.wide, design, tmp_path, workers=1) == Progress(1000, 1000, 0, 100)


# --- progress -------------------------------------------------------------------------------------


def test_the_time_left_goes_by_the_pace_of_this_process() -> None:
    # 10 cases in 20 s, 50 to come.
    assert Progress(done=50, cases=100, errors=0, before=40).left(20.0) == 100.0
    assert Progress(done=40, cases=100, errors=0, before=40).left(20.0) is None


def test_progress_is_shown_in_words() -> None:
    times = iter([10.0, 10.0, 30.0])
    bars = Bars(console=Console(file=io.StringIO()))
    report = reports.ProgressReporter(bars).sweep("study", lambda: next(times))
    assert report is not None
    shown = []
    for done, errors in ((40, 0), (50, 2)):
        report(Progress(done, cases=4000, errors=errors, before=40))
        task = bars.tasks[0]
        shown.append((task.completed, task.total, task.fields["speed"]))
    assert shown == [
        (40, 4000, "40 of 4000 cases"),
        (50, 4000, "50 of 4000 cases, 0.5/s, 2 bad"),  # the bar tells the time left itself
    ]
    progress = Progress(50, cases=4000, errors=2, before=40)
    left = "2:11:40 left"  # 3950 / 0.5 s
    assert reports._rate(progress, 20.0) == f"50 of 4000 cases, 0.5/s, 2 bad, {left}"


def test_progress_is_told_to_a_terminal_and_elsewhere_in_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with reports.sweeping("study") as report:
        assert report is not None
        report(Progress(1, 2, 0, 0))
        assert capsys.readouterr().err == ""  # nothing of what is short
    monkeypatch.setattr("experiments.harness.progress.LINE_INTERVAL", 0.0)
    with reports.sweeping("study") as report:
        assert report is not None
        report(Progress(1, 2, 0, 0))
    assert capsys.readouterr().err.startswith("study: ")
