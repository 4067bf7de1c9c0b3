"""The record of a run: named columns, kept to the bit, read back or refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cranedyn.data.trajectory import QUANTITIES, Trajectory, read, read_columns
from cranedyn.errors import DataError
from tests.helpers import crane, files

COLUMNS = crane().layout.columns()
WIDTHS = {name: len(columns) for name, columns in COLUMNS.items()}


def _made(numbers: np.ndarray) -> Trajectory:
    """A trajectory that holds these numbers, shape (n, 29 or more), whatever they mean."""
    edges = np.cumsum([0, *WIDTHS.values()])
    parts = {name: numbers[:, a:b] for name, a, b in zip(WIDTHS, edges, edges[1:], strict=False)}
    return Trajectory(
        **{name: part[:, 0] if WIDTHS[name] == 1 else part for name, part in parts.items()},
        columns=COLUMNS,
        parameters={"dt_s": 0.1, "drive": "effort"},
    )


WIDTH = sum(WIDTHS.values())
_EXTREMES = 5e-324, 1.7976931348623157e308, -0.0, np.nextafter(1.0, 2.0)
NASTY = np.array([0.1 + 0.2, 1 / 3, *_EXTREMES, -9806.65, 1e22, 123456789.123456789])


@pytest.fixture
def made() -> Trajectory:
    numbers = np.random.default_rng(0).normal(size=(7, WIDTH)) * 10.0 ** np.arange(-14, WIDTH - 14)
    numbers[:, 0] = np.arange(7) / 3.0
    return _made(numbers)


def _bits(trajectory: Trajectory) -> list[bytes]:
    return [np.ascontiguousarray(getattr(trajectory, name)).tobytes() for name in QUANTITIES]


WORDS = st.text(st.characters(codec="utf-8"))
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    numbers=arrays(
        float,
        st.tuples(st.integers(1, 5), st.just(WIDTH)),
        elements=FINITE | st.sampled_from(NASTY.tolist()),
    ),
    parameters=st.dictionaries(WORDS, FINITE | WORDS),
)
def test_what_is_written_is_read_back_to_the_bit(
    numbers: np.ndarray, parameters: dict[str, float | str], tmp_path: Path
) -> None:
    numbers[:, 0] = [-1e308, 5e-324, 1.0, 1.1, 1e308][-len(numbers) :]  # times must increase
    before = replace(_made(numbers), parameters=parameters)
    first = read(before.write(tmp_path / "a.csv"))
    second = read(replace(first, parameters=parameters).write(tmp_path / "b.parquet"))
    third = read(second.write(tmp_path / "c.csv"))
    assert _bits(third) == _bits(second) == _bits(first) == _bits(before)
    assert second.parameters == parameters
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "c.csv").read_bytes()


def test_both_formats_hold_the_same_columns_in_the_same_order(
    made: Trajectory, tmp_path: Path
) -> None:
    csv = pyarrow.csv.read_csv(made.write(tmp_path / "a.csv"))
    parquet = pyarrow.parquet.read_table(made.write(tmp_path / "a.parquet"))
    assert (
        csv.column_names
        == parquet.column_names
        == [column for columns in COLUMNS.values() for column in columns]
    )
    assert (
        csv.column_names[:11]
        == "t_s gamma_rad x_m phi_rad theta_rad l_m gamma_dot_rad_s x_dot_m_s phi_dot_rad_s "
        "theta_dot_rad_s l_dot_m_s".split()
    )
    assert csv.column_names[17:20] == ["T_gamma_Nm", "F_x_N", "F_l_N"]


def test_parquet_keeps_the_parameters(made: Trajectory, tmp_path: Path) -> None:
    assert read(made.write(tmp_path / "a.parquet")).parameters == {"dt_s": 0.1, "drive": "effort"}
    assert read(made.write(tmp_path / "a.csv")).parameters == {}


def test_rows_are_iterated_whatever_the_joints_are_called(made: Trajectory) -> None:
    columns = {
        quantity: tuple(name.replace("gamma", "ring-gear 1") for name in names)
        for quantity, names in COLUMNS.items()
    }
    renamed = replace(made, columns=columns)
    row = next(iter(renamed))
    assert row.x_m == renamed["x_m"][0]
    assert row[renamed.keys().index("ring-gear 1_rad")] == renamed["ring-gear 1_rad"][0]


def test_every_column_is_found_by_its_name(made: Trajectory) -> None:
    for name, columns in COLUMNS.items():
        for i, column in enumerate(columns):
            whole = getattr(made, name)
            assert made[column].tolist() == (whole if len(columns) == 1 else whole[:, i]).tolist()
    with pytest.raises(KeyError, match="phi"):
        made["phi"]


def test_rows_are_counted_and_cut() -> None:
    ordered = _made(np.sort(np.random.default_rng(0).normal(size=(7, WIDTH)), axis=0))
    late = ordered.since(ordered.t[3])
    assert (len(ordered), len(late)) == (7, 4)
    assert [getattr(late, name).tolist() for name in QUANTITIES] == [
        getattr(ordered, name)[3:].tolist() for name in QUANTITIES
    ]
    assert late.parameters == ordered.parameters
    assert ordered.state(-1).q.tolist() == ordered.q[6].tolist()
    assert ordered.state(2).v.tolist() == ordered.v[2].tolist()


def test_the_ledger_of_a_part_starts_at_its_first_row() -> None:
    n = 5
    whole = _made(np.zeros((n, WIDTH)))
    ledger = Trajectory(
        **{name: getattr(whole, name) for name in QUANTITIES}
        | {
            "t": np.arange(n) * 1.0,
            "energy": np.array([10.0, 11.0, 13.0, 16.0, 20.0]),
            "work": np.outer([0.0, 2.0, 5.0, 9.0, 14.0], [1.0, 2.0, -2.0]),
            "dissipated": np.array([0.0, 1.0, 2.0, 3.0, 4.5]),
        },
        columns=COLUMNS,
    )
    assert ledger.unexplained.tolist() == [0.0, 0.0, 0.0, 0.0, 0.5]
    assert ledger.since(2.0).unexplained.tolist() == [0.0, 0.0, 0.5]


def test_another_ending_is_refused_and_nothing_is_written(made: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"the ending must be \.csv or \.parquet"):
        made.write(tmp_path / "a.xlsx")
    with pytest.raises(DataError, match=r"the folder .*missing does not exist"):
        made.write(tmp_path / "missing" / "a.csv")
    assert files(tmp_path) == []


# --- files from elsewhere -------------------------------------------------------------------------


def _csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "theirs.csv"
    path.write_text(text)
    return path


def test_columns_are_read_in_any_order_among_others_and_from_whole_numbers(tmp_path: Path) -> None:
    found = read_columns(_csv(tmp_path, "note,phi_rad,t_s\na,1,0\nb,2,1\n"), ("t_s", "phi_rad"))
    assert list(found) == ["t_s", "phi_rad"]
    assert [values.tolist() for values in found.values()] == [[0.0, 1.0], [1.0, 2.0]]
    assert all(values.dtype == float for values in found.values())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "t_s,phi\n0,1\n1,2\n",
            r"theirs.csv has no column phi_rad; needed are t_s, phi_rad, it has 't_s, phi'",
        ),
        ("t_s,phi_rad\n0,up\n1,2\n", r"Cannot read .*theirs.csv: .*invalid value 'up'"),
        (
            "t_s,phi_rad\n0,1\n1,nan\n",
            r"column phi_rad holds a value that is not finite, in data row 2",
        ),
        (
            "t_s,phi_rad\n0,1\n1,\n",
            r"column phi_rad holds a value that is not finite, in data row 2",
        ),
        (
            "t_s,phi_rad\n0,inf\n1,1\n",
            r"column phi_rad holds a value that is not finite, in data row 1",
        ),
        (
            "t_s,phi_rad\n0,1\n0,2\n",
            r"t_s must increase from row to row; in data row 2 it is 0 s after 0 s",
        ),
        ("t_s,phi_rad\n1,1\n", "has too few rows, 1; it needs two rows or more"),
        ("t_s,phi_rad\n", "has too few rows, 0; it needs two rows or more"),
        ("t_s,phi_rad\n0,1,2\n", r"Cannot read .*theirs.csv: .*[Ee]xpected 2 columns"),
        ("", r"Cannot read .*theirs.csv: .*[Ee]mpty"),
    ],
)
def test_a_file_without_what_is_needed_is_refused_in_a_sentence(
    tmp_path: Path, text: str, sentence: str
) -> None:
    with pytest.raises(DataError, match=sentence) as caught:
        read_columns(_csv(tmp_path, text), ("t_s", "phi_rad"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["missing.csv", "missing.parquet", "folder.csv"])
def test_a_file_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(DataError, match="Cannot read "):
        read_columns(tmp_path / name, ("t_s",))


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_binary_file_is_refused(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(DataError):
        read_columns(path, ("t_s",))


@pytest.mark.parametrize("column", [column for columns in COLUMNS.values() for column in columns])
def test_a_trajectory_with_a_column_missing_is_refused(
    tmp_path: Path, made: Trajectory, column: str
) -> None:
    pyarrow.csv.write_csv(made.table().drop_columns([column]), tmp_path / "a.csv")
    with pytest.raises(DataError, match=f"has no column {column};"):
        read(tmp_path / "a.csv")


def test_a_column_named_with_a_brace_is_no_format(tmp_path: Path, made: Trajectory) -> None:
    table = made.table()
    names = [name.replace("T_gamma_Nm", "T_gam}a_Nm") for name in table.column_names]
    pyarrow.csv.write_csv(table.rename_columns(names), tmp_path / "a.csv")
    with pytest.raises(DataError, match="has no column"):
        read(tmp_path / "a.csv")


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        DataError,
        match=r"theirs\.csv has no column energy_J, dissipated_J, W_force_J, W_buffers_J, valid",
    ):
        read(_csv(tmp_path, "t_s,a\n0,1\n1,2\n"))
    lonely = {
        name: [0.0, 1.0]
        for name in ("t_s", "energy_J", "dissipated_J", "W_force_J", "W_buffers_J", "valid")
    }
    pyarrow.csv.write_csv(pa.table(lonely), tmp_path / "lonely.csv")
    with pytest.raises(DataError, match="columns of no joint"):
        read(tmp_path / "lonely.csv")
