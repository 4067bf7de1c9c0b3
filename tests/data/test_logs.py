"""Tables as programs log them, in any format: the same numbers, or a sentence."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.io import savemat

from cranedyn.data import bounded, reading_process
from cranedyn.data.external import ExternalTable, Source, load_external, parse_sources
from cranedyn.data.logs import _sheet_column, find_format, open_log
from cranedyn.data.workbooks import Sheet
from cranedyn.errors import CraneError, DataError
from tests.experiments.test_measured import workbook

T = 0.02 * np.arange(50)
PHI = 0.1 * np.cos(0.8 * T)
NAMES = {"t_s": Source("time"), "phi_rad": Source("angle"), "l_m": Source("rope")}


def read(path: Path, *arguments: str, **options: object) -> ExternalTable:
    sources = parse_sources(arguments) if arguments else NAMES
    return load_external(open_log(path), list(sources), sources, **options)  # type: ignore[arg-type]


def text(path: Path, content: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(content.encode(encoding))
    return path


def rows(delimiter: str = ",", decimal: str = ".") -> list[str]:
    numbers = zip(T.tolist(), PHI.tolist(), strict=True)
    lines = [delimiter.join((repr(t), repr(phi), "15.0")) for t, phi in numbers]
    return [line.replace(".", decimal) for line in lines] if decimal != "." else lines


def check(table: ExternalTable) -> None:
    np.testing.assert_array_equal(table.columns["t_s"], T)
    np.testing.assert_array_equal(table.columns["phi_rad"], PHI)
    np.testing.assert_array_equal(table.columns["l_m"], np.full(50, 15.0))


# --- text -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "encoding", "remark"),
    [
        (["time, angle, rope", *rows()], "utf-8", None),
        (["Logger 3", "", "time;angle;rope", "s;rad;m", *rows(";", ",")], "utf-8", "semicolons"),
        (["time\tangle\trope", *rows("\t", ",")], "utf-16", "UTF-16"),
        (["# time angle rope", *rows("   ")], "utf-8", "blanks separate"),
    ],
)
def test_tables_of_many_programs_have_the_same_numbers_to_the_bit(
    lines: list[str], encoding: str, remark: str | None, tmp_path: Path
) -> None:
    table = read(text(tmp_path / "a.csv", "\r\n".join([*lines, ""]), encoding))
    check(table)
    assert (remark is None) == (not table.remarks)
    assert remark is None or any(remark in one for one in table.remarks)


def test_columns_are_addressed_by_number_where_there_is_no_header(tmp_path: Path) -> None:
    check(read(text(tmp_path / "a.csv", "\n".join(rows())), "t_s=#1", "phi_rad=#2", "l_m=#3"))


@pytest.mark.parametrize(
    ("header", "arguments"),
    [
        ("time [s],angle [deg],rope", ["t_s=time [s]", "phi_rad=angle [deg]", "l_m=rope"]),
        ("time [s],angle [deg],rope", ["t_s=time [s]", "phi_rad=angle [deg][deg]", "l_m=rope"]),
        ("time [s],angle [deg],rope", ['t_s="time [s]"', "phi_rad='angle [deg]'[deg]", "l_m=rope"]),
        ("time,a=b,rope", ["t_s=time", "phi_rad='a=b'[deg]", "l_m=rope"]),
        ("time,angle[1],rope", ["t_s=time", 'phi_rad="angle[1]"[deg]', "l_m=rope"]),
        ("time,angle,rope", ["t_s= time", "phi_rad= angle [deg]", "l_m=rope"]),
    ],
)
def test_names_with_blanks_and_brackets_are_addressed_whole_or_between_quotation_marks(
    header: str, arguments: list[str], tmp_path: Path
) -> None:
    path = text(tmp_path / "a.csv", "\n".join([header, *rows()]))
    found = read(path, *arguments).columns["phi_rad"]
    np.testing.assert_allclose(found, np.radians(PHI), rtol=1e-15)


def test_a_unit_that_the_file_says_and_the_user_does_not_is_refused(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "\n".join(["time,angle (deg),rope", *rows()]))
    with pytest.raises(DataError, match=r"is in deg; say so, too: .*\[deg\]'\.$"):
        read(path, "t_s=time", "phi_rad=angle (deg)", "l_m=rope")
    with_units = text(tmp_path / "b.csv", "\n".join(["time,angle,rope", "s,deg,m", *rows()]))
    with pytest.raises(DataError, match="says that angle is in deg"):
        read(with_units)
    table = read(with_units, "t_s=time", "phi_rad=angle[mrad]", "l_m=rope")
    assert "phi_rad is taken in mrad although the file says deg" in table.remarks


def test_units_are_known_in_any_case_and_one_of_another_quantity_is_refused(tmp_path: Path) -> None:
    loud = text(tmp_path / "a.csv", "\n".join(["time,angle,rope", "S,DEG,M", *rows()]))
    with pytest.raises(DataError, match="says that angle is in DEG; say so, too"):
        read(loud)
    read(loud, "t_s=time", "phi_rad=angle[deg]", "l_m=rope")
    other = text(tmp_path / "b.csv", "\n".join(["time,angle (m),rope", *rows()]))
    with pytest.raises(DataError, match=r"is in m; allowed for phi_rad are rad, deg, mrad\. Say"):
        read(other, "t_s=time", "phi_rad=angle (m)", "l_m=rope")


def test_a_long_cell_of_digits_takes_no_time(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "time,angle\n0,0.1\n1," + "1" * 100_000 + "x\n2,0.1\n")
    with pytest.raises(DataError, match="angle"):
        read(path, "t_s=time", "phi_rad=angle")


def test_dates_count_from_the_first_row(tmp_path: Path) -> None:
    lines = [
        f"2024-05-01T10:15:{t:09.6f}Z,{p!r},15.0" for t, p in zip(T, PHI.tolist(), strict=True)
    ]
    table = read(text(tmp_path / "a.csv", "\n".join(["time,angle,rope", *lines])))
    np.testing.assert_allclose(table.columns["t_s"], T, atol=1e-12)
    assert any("from 2024-05-01T10:15:00.000000Z" in remark for remark in table.remarks)


def test_times_are_no_angles(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "time,angle\n0:00:01,0:00:01\n0:00:02,0:00:02\n")
    with pytest.raises(DataError, match="column angle holds times; needed are numbers"):
        read(path, "t_s=time", "phi_rad=angle")


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        (["time,angle", "0,0.1", "1,0.1", "2"], "has 1 cells in data row 3 and 2 in the rows"),
        (["time,angle", "0,0.1", "1,0.1", "2,x"], "column angle holds x in data row 3, which is"),
        (["time,angle", "0,0.1", "1,nan"], "holds a value that is not finite, in data row 2"),
        (["time,angle", "0,0.1", "1,", *["2,0.1"] * 9], "is empty in data row 2; fill the cell in"),
        (["time,angle,angle", "0,0.1,1", "1,0.1,1"], "has 2 columns angle.* number, as in #2"),
    ],
)
def test_a_bad_cell_is_named_by_column_and_row(
    lines: list[str], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=sentence):
        read(text(tmp_path / "a.csv", "\n".join(lines)), "t_s=time", "phi_rad=angle")


# --- several topics in one table ------------------------------------------------------------------


def topics(path: Path) -> Path:
    """A table of PlotJuggler: a swing every 20 ms, and between a cable every 100 ms."""
    lines = [(t, f"{t!r},{phi!r},") for t, phi in zip(T.tolist(), PHI.tolist(), strict=True)]
    lines += [(0.01 + 0.1 * k, f"{0.01 + 0.1 * k!r},,{15.0 + k!r}") for k in range(10)]
    return text(path, "\n".join(["time,angle,rope", *[line for _, line in sorted(lines)]]))


def test_a_topic_holds_its_value_until_its_next_one(tmp_path: Path) -> None:
    """Each fresh value keeps its own time; the few empty cells of the swing lie on lines."""
    table = read(topics(tmp_path / "a.csv"), filling="hold")
    t = table.columns["t_s"]
    rope = table.columns["l_m"]
    fresh = 0.01 + 0.1 * np.arange(10)
    both = np.sort(np.concatenate([T, fresh]))
    np.testing.assert_array_equal(t, both[(both >= 0.01) & (both <= fresh[-1])])
    np.testing.assert_array_equal(table.columns["phi_rad"], np.interp(t, T, PHI))
    np.testing.assert_allclose(rope, 15.0 + np.floor((t - 0.01) / 0.1 + 1e-9), rtol=1e-15)
    assert any("l_m has values in 10 of 60 rows" in remark for remark in table.remarks)
    (about_swing,) = (remark for remark in table.remarks if remark.startswith("phi_rad"))
    assert about_swing.endswith("the others lie on straight lines between them")


def test_or_lies_on_straight_lines(tmp_path: Path) -> None:
    table = read(topics(tmp_path / "a.csv"), filling="interpolate")
    t = table.columns["t_s"]
    np.testing.assert_array_equal(table.columns["phi_rad"], np.interp(t, T, PHI))
    np.testing.assert_allclose(table.columns["l_m"], 15.0 + (t - 0.01) / 0.1, rtol=1e-12)


def test_a_swing_that_is_missing_for_long_is_refused(tmp_path: Path) -> None:
    lines = [f"{0.01 * k:.2f},{'' if k % 2 or 20 < k < 60 else '0.1'},15" for k in range(100)]
    path = text(tmp_path / "a.csv", "\n".join(["time,angle,rope", *lines]))
    with pytest.raises(DataError, match=r"angle has no value for 0\.4 s from time = 0\.2 s on"):
        read(path)


# --- since and until ------------------------------------------------------------------------------


def test_nothing_outside_of_since_and_until_is_judged(tmp_path: Path) -> None:
    """A swing beyond 90 degrees, a value that is none, and a clock that is set, all too early."""
    early = ["7,0.1,15", "0.01,1.7,15", "0.015,nan,15"]
    path = text(tmp_path / "a.csv", "\n".join(["time,angle,rope", *early, *rows()]))
    with pytest.raises(DataError, match="not finite"):
        read(path)
    table = read(path, since=0.02, until=0.5)
    np.testing.assert_array_equal(table.columns["t_s"], T[1:26])


# --- MATLAB, HDF5, workbooks, Parquet -------------------------------------------------------------


@pytest.mark.slow
def test_vectors_matrices_and_fields_of_matlab_are_columns(tmp_path: Path) -> None:
    log = {"time": T, "y": np.stack([PHI, np.full(50, 15.0)], axis=1), "name": "crane"}
    savemat(tmp_path / "a.mat", {"log": log, "rate": 50.0, "picture": np.zeros((300, 300))})
    log_file = open_log(tmp_path / "a.mat")
    assert log_file.names == ("log.time", "log.y(:,1)", "log.y(:,2)")
    assert log_file.remarks == ("picture has 300 columns and is left out",)
    check(read(tmp_path / "a.mat", "t_s=log.time", "phi_rad='log.y(:,1)'", "l_m='log.y(:,2)'"))


def test_vectors_of_different_lengths_are_no_table(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"time": T, "angle": PHI[:-1], "rope": PHI})
    with pytest.raises(DataError, match=r"differ in length: time has 50, angle has 49, rope has"):
        read(tmp_path / "a.mat")


@pytest.mark.slow
def test_a_file_of_matlab_7_3_is_hdf5_with_rows_first(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5 is not installed")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in (("time", T), ("angle", PHI), ("rope", np.full(50, 15.0))):
            file.create_dataset(name, data=values[None]).attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("both", data=np.stack([T, PHI]))
        file.create_group("#refs#").create_dataset("a", data=T)
    with open(tmp_path / "a.mat", "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    assert find_format(tmp_path / "a.mat") == "hdf5"
    check(read(tmp_path / "a.mat"))
    assert open_log(tmp_path / "a.mat").names[1:3] == ("both(:,1)", "both(:,2)")


@pytest.mark.slow
def test_data_of_hdf5_in_other_files_are_not_opened(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5 is not installed")
    (tmp_path / "secret.bin").write_bytes(bytes(400))
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_dataset("time", data=T)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["link"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "time")
        file["soft"] = h5py.SoftLink("/time")
        file.create_dataset("time", data=T)
    assert open_log(tmp_path / "a.h5").names == ("time",)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        where = [(str(tmp_path / "secret.bin"), 0, 400)]
        file.create_dataset("time", shape=(50,), dtype="f8", external=where)
    with pytest.raises(DataError, match="time lies in another file, which is not opened"):
        open_log(tmp_path / "b.h5")


@pytest.mark.slow
def test_a_workbook_may_have_lines_above_its_header_and_several_sheets(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine", reason="extra excel is not installed")
    numbers = zip(T.tolist(), PHI.tolist(), strict=True)
    body: list[list[object]] = [[t, phi, 15.0] for t, phi in numbers]
    first = [["Recorder 3"], ["time", "angle", "rope"], ["s", "rad", "m"], *body]
    check(read(workbook(tmp_path / "a.xlsx", [first])))
    blank = [["time", "angle", "rope"], [" ", "", " "], *body]
    check(read(workbook(tmp_path / "blank.xlsx", [blank])))
    path = workbook(tmp_path / "b.xlsx", [first, [["time", "angle", "rope"], *body]])
    assert open_log(path).names[3:] == ("S2!time", "S2!angle", "S2!rope")
    check(read(path, "t_s=S2!time", "phi_rad=S2!angle", "l_m=S2!rope"))
    with pytest.raises(DataError, match="on the sheets S1 and S2; needed is one sheet"):
        read(path, "t_s=S1!time", "phi_rad=S2!angle")
    body[7][1] = "lost"
    with pytest.raises(DataError, match="column 2: lost in row 9 is no number"):
        read(workbook(tmp_path / "c.xlsx", [[["time", "angle", "rope"], *body]]))


def test_a_date_above_the_table_is_no_cell_of_it() -> None:
    numbers = np.array([[np.nan, 1.7e9], [0.0, 0.1], [1.0, 0.2]])
    dated = Sheet("S", numbers, {}, last_date=(-1, 0), last_number=(2, 2))
    column = _sheet_column(Path("a.xlsx"), dated, 1, 1, may_be_time=False)
    assert column.values.tolist() == [0.1, 0.2]
    mixed = Sheet("S", numbers, {}, last_date=(-1, 1), last_number=(2, 2))
    with pytest.raises(DataError, match="column 2 holds dates and numbers; needed is one of both"):
        _sheet_column(Path("a.xlsx"), mixed, 1, 1, may_be_time=True)


def test_a_workbook_whose_only_cell_is_far_away_is_a_sentence(tmp_path: Path) -> None:
    """The cell XFD1048576 of a workbook of 1.6 kB asks for 549 GB."""
    pytest.importorskip("python_calamine", reason="extra excel is not installed")
    path = workbook(tmp_path / "a.xlsx", [[["time", "angle"], [0.0, 1.0]]])
    far = b"<row r='1048576'><c r='XFD1048576'><v>1</v></c></row></sheetData>"
    rewritten = tmp_path / "far.xlsx"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(rewritten, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b"</sheetData>", far))
    with pytest.raises(DataError, match=r"Cannot read .*far\.xlsx: .*(memory|gave up|cells)"):
        open_log(rewritten)


def test_a_parquet_file_may_have_dates_and_empty_cells(tmp_path: Path) -> None:
    stamps = pa.array((1e9 * T).astype("int64"), pa.int64()).cast(pa.timestamp("ns"))
    rope = pa.array([None if k % 5 else 15.0 for k in range(50)])
    table = pa.table({"time": stamps, "angle": PHI, "rope": rope})
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    found = read(tmp_path / "a.parquet").columns
    np.testing.assert_allclose(found["t_s"], T[:46], atol=1e-9)  # to the last value of the rope
    assert set(found["l_m"].tolist()) == {15.0}


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.csv", b"SQLite format 3\0" + bytes(100), "it is a database"),
        ("a.csv", b"\x1f\x8b" + bytes(100), "it is packed; unpack it first"),
        ("a.npz", b"PK\x03\x04" + bytes(100), "it is packed; unpack it first"),
        ("a.mat", b"MATLAB 5.0" + bytes(100), "Cannot read .*a.mat: "),
        ("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(20), "Cannot read .*a.h5: "),
        ("a.xlsx", b"PK\x03\x04" + bytes(100), "Cannot read .*a.xlsx: "),
    ],
)
def test_other_files_are_refused_by_name(
    name: str, content: bytes, sentence: str, tmp_path: Path
) -> None:
    extras = {".h5": ("h5py", "hdf5"), ".xlsx": ("python_calamine", "excel")}
    if Path(name).suffix in extras:
        module, extra = extras[Path(name).suffix]
        pytest.importorskip(module, reason=f"extra {extra} is not installed")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CraneError, match=sentence):
        open_log(tmp_path / name)


# --- the bounded process --------------------------------------------------------------------------


def mat() -> bytes:
    sink = io.BytesIO()
    savemat(sink, {"t": T, "y": PHI})
    return sink.getvalue()


_CRASHING = """
    4d41544c414220352e30204d41542d66696c6520506c6174666f726d3a20706f7369782c204372656174656420
    6f6e3a20467269204e6f762032372031393a35323a333220323032360000000000000000000000000000000000
    000000000000000000000000000000000000000000000000000000000000000000000001494d0e000000300000
    000600000008000000040000000000000005000000080000000100000003000000010001007400000010000300
    616263000e00000030000000060000000800000004000000000000000500000008000000010000000300000001
    000100790000000000030061626300
"""
"""A file of MATLAB with four wrong bytes."""


def test_a_file_that_crashes_its_reader_is_a_sentence(tmp_path: Path) -> None:
    """Bytes that make SciPy 1.17 read foreign memory; it may refuse them some day."""
    (tmp_path / "a.mat").write_bytes(bytes.fromhex(_CRASHING))
    with pytest.raises(DataError, match=r"Cannot read .*a\.mat: "):
        open_log(tmp_path / "a.mat")


@pytest.mark.slow
def test_memory_time_and_size_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"t": np.zeros(20_000_000), "y": np.zeros(9)}, do_compression=True)
    assert path.stat().st_size < 1_000_000
    monkeypatch.setattr(bounded, "LARGEST_FILE", 100_000_000)
    with pytest.raises(DataError, match="it holds more than 100 MB of numbers"):
        open_log(path)
    monkeypatch.setattr(bounded, "LARGEST_FILE", 1_000)
    with pytest.raises(DataError, match=r"it is larger than 0\.001 MB"):
        open_log(path)
    monkeypatch.undo()
    monkeypatch.setattr(reading_process, "MEMORY", 200_000_000)
    with pytest.raises(DataError, match=r"memory|gave up|ended without a result"):
        open_log(path)
    monkeypatch.undo()
    monkeypatch.setattr(reading_process, "WALL_TIME", 0.01)
    with pytest.raises(DataError, match=r"takes more than 0\.01 s"):
        open_log(path)


def test_a_module_of_the_folder_takes_no_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scipy.py").write_text("open('ran', 'w')")
    (tmp_path / "a.mat").write_bytes(mat())
    monkeypatch.chdir(tmp_path)
    assert open_log("a.mat").names == ("t", "y")
    assert not (tmp_path / "ran").exists()


def test_pipes_are_refused_whatever_their_ending(tmp_path: Path) -> None:
    for ending in (".mat", ".xlsx", ".h5", ".db3", ".csv"):
        os.mkfifo(tmp_path / f"a{ending}")
        with pytest.raises(DataError, match="it is no file but a device"):
            open_log(tmp_path / f"a{ending}")
