"""Sweeps: every case once and in order, bad cases alone are bad, and folders that would be mixed up
or not fit are refused.
"""

from __future__ import annotations

import io
import json
import math
import resource
import shutil
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.progress import Progress as Bars

import cranedyn
from cranedyn.errors import CraneError, DataError
from cranedyn.sweep import Design, Progress, cross, grid, limits, results, sweep
from cranedyn.sweep.chunk import DIED, evaluate, name_of
from cranedyn.sweep.manifest import Manifest, claimed
from cranedyn.sweep.sources import sources
from experiments.harness import progress as reports
from tests import studies
from tests.helpers import files

pytestmark = pytest.mark.usefixtures("limited")


def _evaluated(study: object, design: Design) -> dict[str, list]:
    return evaluate(f"tests.studies:{study.__name__}", design.columns).to_pydict()  # type: ignore[attr-defined]


# --- a chunk --------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 9), min_size=1, max_size=20))
def test_bad_cases_say_why_and_cost_no_other_case_its_results(xs: list[int]) -> None:
    found = _evaluated(studies.troubled, grid(x=xs))
    why = {
        1: "ArithmeticError: one is too much",
        2: "The result y is nan.",
        3: "The result y is -inf.",
    }
    assert found["error"] == [why.get(x) for x in xs]
    # 4 is masked, not bad.
    assert found.get("y", [None] * len(xs)) == [
        None if x in (1, 2, 3, 4) else float(x * x) for x in xs
    ]
    for i, x in enumerate(xs):
        assert ((found.get("word", [None] * len(xs))[i]) is None) == (x in (1, 2, 3))


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("nothing", "The study returned NoneType; allowed is a mapping of columns."),
        ("short", "The study returned y of shape (2,) for 1 cases; allowed is (1,)."),
        ("flat", "The study returned y of shape () for 1 cases; allowed is (1,)."),
        ("complex", "The study returned y of type complex128; allowed are numbers and words."),
        ("object", "The study returned y of type object; allowed are numbers and words."),
        ("large", "The study returned y of type uint64; allowed are numbers and words."),
        (
            "parameter",
            "The study returned a column 'x'; allowed is any name that no parameter has, but not "
            "case, error.",
        ),
        (
            "reserved",
            "The study returned a column 'error'; allowed is any name that no parameter has, but "
            "not case, error.",
        ),
    ],
)
def test_what_a_study_may_not_return_is_the_error_of_the_case(kind: str, says: str) -> None:
    assert _evaluated(studies.careless, grid(x=range(2), kind=kind)) == {"error": [says, says]}


def test_a_study_cannot_end_the_worker_by_leaving() -> None:
    assert _evaluated(studies.leaving, grid(x=[1.0])) == {"error": ["SystemExit: enough"]}


def test_results_of_two_kinds_are_said_in_a_sentence() -> None:
    with pytest.raises(DataError, match=r"The study returns results of different kinds: .*y"):
        _evaluated(studies.two_minded, grid(x=range(4)))


def _scripted(cases: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    return {}


def test_a_study_needs_a_name_by_which_workers_import_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert name_of(studies.squares) == "tests.studies:squares"
    for study in (lambda cases: cases, SimpleNamespace(), _scripted):
        monkeypatch.setattr(_scripted, "__module__", "__main__")
        monkeypatch.setattr("__main__.__spec__", None)
        with pytest.raises(
            CraneError,
            match=r"A study must be a function at the top of a module that workers can import; .* "
            r"is not\.",
        ):
            name_of(study)  # type: ignore[arg-type]
    monkeypatch.setattr("__main__.__spec__", SimpleNamespace(name="experiments.sweep"))
    assert name_of(_scripted) == "experiments.sweep:_scripted"  # as of python -m experiments.sweep


# --- a sweep --------------------------------------------------------------------------------------


def test_a_sweep_keeps_every_case_in_order_with_its_parameters(tmp_path: Path) -> None:
    design = cross(grid(strategy=["flat", "spline"]), grid(x=np.arange(5.0)))
    said: list[Progress] = []
    end = sweep(
        studies.squares, design, tmp_path / "a" / "b", chunk=3, workers=2, progress=said.append
    )
    assert (said[0], said[-1]) == (Progress(0, 10, 0, 0), Progress(10, 10, 0, 0)) and end == said[
        -1
    ]
    assert [progress.done for progress in said[1:]] == sorted(
        progress.done for progress in said[1:]
    ) and len(said) == 5
    table = results(tmp_path / "a" / "b")
    assert table.column_names == ["case", "strategy", "x", "y", "error"]
    assert table["case"].to_pylist() == list(range(10))
    for name, values in design.columns.items():
        assert table[name].to_pylist() == values.tolist()
    assert table["y"].to_pylist() == (design.columns["x"] ** 2).tolist()
    assert table["error"].null_count == 10
    assert pa.dataset.dataset(tmp_path / "a" / "b").to_table().num_rows == 10  # readable without us
    assert files(tmp_path / "a" / "b") == [
        ".lock",
        "_sweep.json",
        *(f"part-{i:06d}.parquet" for i in range(4)),
    ]


def test_parts_without_results_have_the_columns_of_the_others(tmp_path: Path) -> None:
    assert sweep(studies.hopeless, grid(x=range(7)), tmp_path, chunk=2, workers=1).errors == 4
    whole = pq.read_schema(tmp_path / "part-000003.parquet")
    assert [field.name for field in whole] == ["case", "x", "y", "error"]
    for path in tmp_path.glob("part-*"):
        assert pq.read_schema(path).equals(whole)
    table = results(tmp_path)
    assert table["y"].to_pylist() == [None] * 4 + [16.0, 25.0, 36.0]
    assert table["error"].to_pylist() == ["ValueError: too small"] * 4 + [None] * 3


def test_a_case_that_kills_its_worker_is_bad_alone(tmp_path: Path) -> None:
    sweep(studies.deadly, grid(x=range(8)), tmp_path, chunk=4, workers=2)
    table = results(tmp_path)
    assert table["error"].to_pylist() == [DIED if x == 3 else None for x in range(8)]
    assert table["y"].to_pylist() == [None if x == 3 else x * x for x in range(8)]


def test_a_case_that_takes_too_long_is_bad_alone(tmp_path: Path) -> None:
    """Its worker, in native code that keeps Python's lock, is killed; the chunk of 4 has 4 times as
    long as a case, its halves half.
    """
    began = time.monotonic()
    assert sweep(
        studies.stuck, grid(x=range(8)), tmp_path, chunk=4, workers=2, limit=0.5
    ) == Progress(8, 8, 1, 0)  # a worker's first case imports NumPy
    assert time.monotonic() - began > 0.5 * (4 + 2 + 1)
    table = results(tmp_path)
    assert table["error"].to_pylist() == [
        "The case took longer than the 0.5 s that a case may." if x == 3 else None for x in range(8)
    ]
    assert table["y"].to_pylist() == [None if x == 3 else x * x for x in range(8)]


def test_workers_that_cannot_be_started_are_said_in_a_sentence(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    refused = []
    for more in range(30):
        with socket.socket() as probe:  # it has the lowest number that is free
            resource.setrlimit(resource.RLIMIT_NOFILE, (probe.fileno() + more, hard))
        try:
            sweep(studies.squares, grid(x=range(2)), tmp_path / str(more), workers=1)
        except CraneError as error:
            assert str(error).endswith("Too many open files.")
            refused.append(more)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        if more not in refused:
            break
    assert refused == list(range(more)) and more > 4
    assert [path.name for path in tmp_path.iterdir()] == [str(more)]


def test_a_sweep_without_a_chunk_goes_on_in_those_it_began_with(tmp_path: Path) -> None:
    design = grid(x=range(10))
    sweep(studies.squares, design, tmp_path, chunk=4, workers=1)
    (tmp_path / "part-000001.parquet").unlink()
    assert sweep(studies.squares, design, tmp_path, workers=1) == Progress(10, 10, 0, 6)
    assert len(list(tmp_path.glob("part-*"))) == 3


def test_damaged_parts_are_computed_again_and_whole_ones_are_not(tmp_path: Path) -> None:
    design = grid(x=range(6))
    sweep(studies.squares, design, tmp_path, chunk=1, workers=1)
    parts = sorted(tmp_path.glob("part-*"))
    before = [part.stat().st_mtime_ns for part in parts]
    parts[1].write_bytes(parts[1].read_bytes()[:-9])
    parts[2].write_bytes(b"")
    pq.write_table(pa.table({"error": pa.array([None, None], pa.string())}), parts[3])
    pq.write_table(pa.table({"case": [4]}), parts[4])
    with pytest.raises(
        DataError,
        match=r"is not finished: 2 of 6 cases are there; sweep on, or ask for a partial table\.",
    ):
        results(tmp_path)
    assert results(tmp_path, partial=True)["case"].to_pylist() == [0, 5]
    said: list[Progress] = []
    sweep(studies.squares, design, tmp_path, workers=1, progress=said.append)
    assert said[0] == Progress(2, 6, 0, 2) and len(said) == 5
    assert results(tmp_path)["y"].to_pylist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    again = [part.stat().st_mtime_ns for part in parts]
    assert [a == b for a, b in zip(before, again, strict=True)] == [
        True,
        False,
        False,
        False,
        False,
        True,
    ]
    # Nothing to do needs no workers.
    assert sweep(studies.squares, design, tmp_path, scheduler="tcp://127.0.0.1:1").done == 6


# --- refusals -------------------------------------------------------------------------------------


def _manifest(**changes: object) -> Manifest:
    study, design = "tests.studies:squares", grid(x=range(10))
    code = {"version": cranedyn.__version__, "sources": sources(study)}
    return Manifest(
        **{
            "study": study,
            **code,
            "design": design.fingerprint,
            "parameters": ("x",),
            "cases": 10,
            "chunk": 1,
            **changes,
        }  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(
    ("there", "says"),
    [
        (
            {"study": "tests.studies:troubled"},
            "its study is tests.studies:troubled, not tests.studies:squares.",
        ),
        ({"parameters": ("a", "b")}, "its parameters are a, b, not x."),
        ({"cases": 20}, "its number of cases is 20, not 10."),
        ({"design": "0"}, "its parameters have other values."),
        ({"chunk": 7}, "its number of cases in a part is 7, not 1."),
        (
            {"chunk": 7, "cases": 20},
            "its number of cases is 20, not 10, its number of cases in a part is 7, not 1.",
        ),
    ],
)
def test_another_sweep_is_not_swept_over(
    there: dict[str, object], says: str, tmp_path: Path
) -> None:
    with claimed(tmp_path, _manifest(**there), True):
        (tmp_path / "part-000000.parquet").touch()
    with pytest.raises(DataError) as caught:
        sweep(studies.squares, grid(x=range(10)), tmp_path, chunk=1)
    assert str(caught.value) == f"Cannot sweep in {tmp_path}: it holds another sweep; {says}"


def test_a_sweep_of_which_nothing_is_done_is_in_nobodys_way(tmp_path: Path) -> None:
    with claimed(tmp_path, _manifest(cases=20), True):
        pass
    assert sweep(studies.squares, grid(x=range(10)), tmp_path, workers=1).done == 10


def test_one_process_at_a_time_is_at_a_folder(tmp_path: Path) -> None:
    with (
        claimed(tmp_path, _manifest(), True),
        pytest.raises(DataError, match="another process is sweeping there"),
    ):
        sweep(studies.squares, grid(x=range(10)), tmp_path)


def test_a_folder_of_other_things_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a")
    with pytest.raises(
        DataError, match=r"it holds other things \(a\.csv\); give a folder of its own\."
    ):
        sweep(studies.squares, grid(x=range(10)), tmp_path)
    assert files(tmp_path) == ["a.csv"]
    with pytest.raises(DataError, match=r"Cannot make the folder .*: File exists\."):
        sweep(studies.squares, grid(x=range(10)), tmp_path / "a.csv")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "null",
        '{"study": 1}',
        json.dumps({**vars(_manifest()), "chunk": 0}),
        "[" * 99_999,
    ],
)
def test_a_manifest_that_is_none_is_said_in_a_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / "_sweep.json").write_text(text)
    (tmp_path / "part-000000.parquet").touch()
    for act in (
        lambda: results(tmp_path),
        lambda: sweep(studies.squares, grid(x=range(10)), tmp_path),
    ):
        with pytest.raises(
            DataError,
            match=r"_sweep\.json is damaged, .*: put the file back as it was, or sweep into "
            r"another folder\.",
        ):
            act()


def test_a_sweep_that_is_refused_leaves_nothing(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="extra dask is not installed")
    for folder in (tmp_path / "a" / "b", tmp_path):
        with pytest.raises(CraneError, match="No Dask scheduler answers"):
            sweep(studies.squares, grid(x=[1.0, 2.0]), folder, scheduler="tcp://127.0.0.1:1")
        assert files(tmp_path) == []


def test_results_of_nothing_are_said_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DataError, match=r"holds no sweep: there is no _sweep\.json in it\."):
        results(tmp_path)
    with claimed(tmp_path, _manifest(), True):
        pass
    with pytest.raises(DataError, match=r"has no finished case yet\."):
        results(tmp_path, partial=True)
    sweep(studies.squares, grid(x=range(10)), tmp_path, workers=1)
    monkeypatch.setattr(limits, "memory", lambda: 319)
    with pytest.raises(
        DataError,
        match=r"The table of 10 cases would take 3\.2e-07 GB of memory; allowed are 3\.19e-07 GB",
    ):
        results(tmp_path)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"chunk": 0}, "chunk is 0; allowed is a whole number from 1."),
        ({"workers": 1.5}, "number of workers is 1.5; allowed is a whole number from 1."),
        (
            {"workers": 2, "scheduler": "tcp://127.0.0.1:1"},
            "The number of workers has no effect beside a scheduler",
        ),
    ],
)
def test_arguments_are_checked_before_anything_is_made(
    options: dict, says: str, tmp_path: Path
) -> None:
    with pytest.raises(CraneError, match=says):
        sweep(studies.squares, grid(x=range(10)), tmp_path / "a", **options)
    assert files(tmp_path) == []


def test_a_study_that_workers_cannot_import_is_said_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies.squares, "__module__", "tests.elsewhere")
    with pytest.raises(
        CraneError,
        match=r"cannot import the study tests\.elsewhere:squares: ModuleNotFoundError: No module "
        r"named",
    ):
        sweep(studies.squares, grid(x=range(2)), tmp_path, workers=1)


def _disk(monkeypatch: pytest.MonkeyPatch, free: float) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=free))


def test_results_that_would_not_fit_the_disk_are_refused_before_and_after_the_first_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    design = grid(x=range(1000))
    _disk(monkeypatch, 8 * 1999)
    with pytest.raises(
        DataError,
        match=r"The results of 1000 cases would take 1\.6e-05 GB; 1\.6e-05 GB are free in ",
    ):
        sweep(studies.wide, design, tmp_path, workers=1)
    _disk(monkeypatch, 8 * 2001)
    with pytest.raises(
        DataError, match=r"The results of 900 cases would take .* GB; 1\.6e-05 GB are free in "
    ):
        sweep(studies.wide, design, tmp_path, chunk=100, workers=1)
    assert len(list(tmp_path.glob("part-*"))) == 1
    _disk(monkeypatch, 1e9)
    assert sweep(studies.wide, design, tmp_path, workers=1) == Progress(1000, 1000, 0, 100)
    assert results(tmp_path).num_rows == 1000


# --- progress -------------------------------------------------------------------------------------


def test_the_time_left_goes_by_the_pace_of_this_process() -> None:
    # 10 cases in 20 s, 50 to come.
    assert Progress(done=50, cases=100, errors=0, before=40).left(20.0) == 100.0
    assert Progress(done=40, cases=100, errors=0, before=40).left(20.0) is None
    assert Progress(done=100, cases=100, errors=0, before=40).left(20.0) == 0.0


def test_progress_is_shown_in_words() -> None:
    clock = iter([10.0, 10.0, 30.0])
    bars = Bars(console=Console(file=io.StringIO()))
    show = reports.ProgressReporter(bars).sweep("study", lambda: next(clock))
    assert show is not None
    said = []
    for progress in (Progress(40, 4000, 0, 40), Progress(50, 4000, 2, 40)):
        show(progress)
        said.append((bars.tasks[0].completed, bars.tasks[0].total, bars.tasks[0].fields["speed"]))
    assert said == [
        (40, 4000, "40 of 4000 cases"),
        (50, 4000, "50 of 4000 cases, 0.5/s, 2 bad, 2:11:40 left"),
    ]
    assert math.isclose(3950 / 0.5, 2 * 3600 + 11 * 60 + 40)


def test_progress_is_told_to_a_terminal_and_elsewhere_in_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with reports.sweeping("study") as lines:
        assert lines is not None
        lines(Progress(1, 2, 0, 0))
        assert capsys.readouterr().err == ""  # nothing of what is short
    monkeypatch.setattr("experiments.harness.progress.LINE_INTERVAL", 0.0)
    with reports.sweeping("study") as lines:
        assert lines is not None
        lines(Progress(1, 2, 0, 0))
    assert capsys.readouterr().err.startswith("study: ")
    monkeypatch.setattr(
        "experiments.harness.progress.Console",
        lambda stderr: Console(file=io.StringIO(), force_terminal=True),
    )
    with reports.sweeping("study") as somebody:
        assert somebody is not None
        somebody(Progress(1, 2, 0, 0))
