"""What is read is a regular file whose size is known: pipes and devices are refused at once, and
memory holds what was asked for.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from cranedyn.data.files import open_file, parse_json, read_bytes, read_text
from cranedyn.data.trajectory import read, read_columns
from cranedyn.errors import DataError
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import open_viewer
from cranedyn.recording import snapshot as pictures
from experiments import report
from experiments.harness.document import read_document
from tests.helpers import python

READERS: dict[str, Callable[[Path], object]] = {
    "text": read_text,
    "bytes": read_bytes,
    "a table": lambda path: read_columns(path, ("t_s",)),
    "a trajectory": read,
    "a document": lambda path: read_document(path, "a1"),
    "a URDF": load_crane,
    "xacro": describe,
    "a recording": open_viewer,
    "pictures": lambda path: pictures.snapshot(path, [0.0], path.parent),
}


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_pipes_and_devices_are_refused_at_once(
    reader: Callable[[Path], object], tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "a.pipe")
    os.mkfifo(tmp_path / "a.parquet")
    (tmp_path / "link.csv").symlink_to("/dev/urandom")
    names = ("a.pipe", "a.parquet", "link.csv")
    devices = ["/dev/urandom", "/dev/zero", "/dev/null", *(tmp_path / name for name in names)]
    began = time.process_time()
    for path in devices:
        with pytest.raises(DataError, match=r"Cannot read .*: it is no file but a device\."):
            reader(Path(path))
    with pytest.raises(DataError, match=r"Cannot read .*: it is a folder\."):
        reader(tmp_path)
    assert time.process_time() - began < 1.0


def test_a_result_that_is_a_pipe_and_a_figure_that_is_large_make_no_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "result.json")
    with pytest.raises(DataError, match=r"result\.json: it is no file but a device\."):
        report.page([tmp_path])
    (tmp_path / "a.png").write_bytes(bytes(2000))
    monkeypatch.setattr(report, "_MAX_FIGURE_SIZE", 1000)
    with pytest.raises(DataError, match=r"a\.png: it is larger than 0\.001 MB\."):
        report.figure_address(tmp_path, "a.png")


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    assert read_bytes(path, 100) == b"x" * 100
    with pytest.raises(DataError, match="it is larger than"):
        read_bytes(path, 99)
    with pytest.raises(DataError, match="No such file"):
        read_bytes(tmp_path / "b")
    with pytest.raises(DataError, match="Cannot read"):
        open_file("a\0b")


def _csv(path: Path, rows: int, junk: int) -> None:
    """Rows of a number and words that nobody asks for."""
    line = f"{{}},{'x' * junk}\n"
    path.write_text("t_s,words\n" + "".join(line.format(k) for k in range(rows)))


_PEAK = """
import sys
import pyarrow as pa
from cranedyn.data.tables import read_table
found = read_table(sys.argv[1], ["t_s"])[0]["t_s"]
assert (found == range(len(found))).all()
print(len(found), pa.default_memory_pool().max_memory())
"""


@pytest.mark.slow
def test_columns_that_nobody_asks_for_cost_no_memory(tmp_path: Path) -> None:
    _csv(tmp_path / "a.csv", 100_000, 500)
    size = (tmp_path / "a.csv").stat().st_size
    assert size > 50e6
    run = python(_PEAK, tmp_path / "a.csv")
    assert run.returncode == 0, run.stderr
    rows, peak = map(int, run.stdout.split())
    # All columns would take 400 MB. That of one column is 0.8 MB, and how many blocks of half a
    # megabyte are under way at a time is Arrow's to decide and differs from run to run.
    assert rows == 100_000
    assert peak < size / 2


def test_numbers_of_a_small_file_that_would_fill_the_memory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"
    # 2 bytes each, 8 in memory.
    path.write_text("t_s\n" + "".join(f"{k % 10}\n" for k in range(300_000)))
    monkeypatch.setattr("cranedyn.data.tables.LARGEST", 1_000_000)
    with pytest.raises(DataError, match=r"a\.csv holds \d MB to read; allowed are 1\."):
        read_columns(path, ("t_s",))


def test_a_parquet_file_whose_own_description_is_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.parquet"
    parameters = {"cranedyn": '{"a": "' + "x" * 100_000 + '"}'}
    table = pa.table({"t_s": np.arange(3.0)}).replace_schema_metadata(parameters)
    pyarrow.parquet.write_table(table, path)
    assert read_columns(path, ("t_s",))["t_s"].tolist() == [0.0, 1.0, 2.0]
    monkeypatch.setattr("cranedyn.data.tables._MAX_FOOTER", 100_000)
    with pytest.raises(DataError, match=r"a\.parquet says in 0 MB what is in it; allowed are 0\."):
        read_columns(path, ("t_s",))


@pytest.mark.parametrize(
    "text",
    ["t_s,a\r\n0,b\r\n1,c", "t_s,a\r0,b\r1,c\r", "\ufefft_s,a\n0,b\n1,c", '"t_s",a\n0,"b"\n1,c'],
)
def test_tables_of_all_dialects_are_read(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode())
    assert read_columns(tmp_path / "a.csv", ("t_s",))["t_s"].tolist() == [0.0, 1.0]


def test_arrow_is_handed_no_object_of_pythons_to_read_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its threads would come back to it while Python ends, which aborts the process at times."""
    table = pa.table({"t_s": np.arange(3.0)})
    sources = []
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    pyarrow.csv.write_csv(table, tmp_path / "a.csv")

    def noting(reader: Any) -> Any:
        return lambda source, *args, **named: (
            sources.append(type(source)) or reader(source, *args, **named)
        )

    for module, name in (("parquet", "ParquetFile"), ("csv", "open_csv")):
        reader = getattr(getattr(pyarrow, module), name)
        monkeypatch.setattr(f"pyarrow.{module}.{name}", noting(reader))
    for name in ("a.parquet", "a.csv"):
        assert len(read_columns(tmp_path / name, ("t_s",))["t_s"]) == 3
    assert sources == [pa.OSFile] * 3


@pytest.mark.parametrize(
    "text", ["1e400", "[-1e400]", "Infinity", '{"a": NaN}', "9" * 400, "9" * 5000, "{"]
)
def test_a_json_text_with_a_number_that_is_not_finite_is_none(text: str) -> None:
    with pytest.raises(ValueError):
        parse_json(text)
    assert parse_json('{"a": [1, 2.5, -0.0, 1e-400]}') == {"a": [1, 2.5, 0.0, 0.0]}


def test_a_line_that_is_longer_than_a_block_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cranedyn.data.tables._BLOCK_SIZE", 100)
    _csv(tmp_path / "a.csv", 200, 50)
    assert read_columns(tmp_path / "a.csv", ("t_s",))["t_s"].tolist() == list(range(200))
    _csv(tmp_path / "a.csv", 200, 500)
    with pytest.raises(DataError, match=r"a\.csv: it has a line of more than 0\.0001 MB\."):
        read_columns(tmp_path / "a.csv", ("t_s",))
