"""Records: what is taken, and what is refused in a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, DataError
from cranedyn.export import mcap
from cranedyn.identification import Prior, Record, load_record
from cranedyn.simulation.simulate import simulate

PRIOR = Prior()


def columns(duration: float = 40.0, interval: float = 0.05) -> dict[str, np.ndarray]:
    """A swing beside a drive that moves."""
    t = np.arange(0.0, duration, interval)
    return {"t_s": t, "phi_rad": 0.1 * np.sin(0.8 * t), "x_m": 10.0 + np.tanh(t - 5.0)}


def changed(**others: np.ndarray | None) -> dict[str, np.ndarray]:
    found = {**columns(), **others}
    return {name: values for name, values in found.items() if values is not None}


def _clock(row: int, by: float) -> np.ndarray:
    t = columns()["t_s"].copy()
    t[row:] += by
    return t


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (columns(duration=8.0), r"lasts 7\.95 s; allowed is 15\.6 s or more, 2 periods"),
        (columns(interval=2.0), "has 20 rows to go by; allowed are 40 or more"),
        (changed(phi_rad=5.7 * np.sin(columns()["t_s"])), "90 degrees.*phi_rad=phi_rad.deg"),
        (changed(x_m=1e3 * columns()["x_m"]), r"x_m is 9000 m .*allowed is -3 to 27.*x_m=x_m.mm"),
        (changed(phi_rad=None), "has no swing column; one of phi_rad, phi_dot_rad_s, the"),
        (changed(phi_rad=np.zeros(800)), "phi_rad never moves; .* not connected"),
        (changed(t_s=None), "has no column t_s"),
        (changed(t_s=_clock(300, 3.0)), "goes from 14.95 to 18 s at row 301, a gap or a clock"),
        (changed(t_s=_clock(300, -3.0)), "does not increase at row 301 of 800, a clock that jumps"),
        (changed(x_m=np.full(800, np.nan)), "x_m of record is nan; allowed is finite"),
    ],
)
def test_what_is_no_record_is_refused_in_one_sentence(
    data: dict[str, np.ndarray], sentence: str
) -> None:
    with pytest.raises(CraneError, match=sentence) as caught:
        Record.of(PRIOR.crane, data)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("since", "rows"), [(1000.0, 0), (39.93, 1)])
def test_a_record_with_no_row_in_the_time_that_is_looked_at_is_not_one_of_a_clock_that_jumps(
    since: float, rows: int
) -> None:
    words = f"has {rows} rows to go by; allowed are 40 or more. .* outside of that time"
    with pytest.raises(DataError, match=words):
        Record.of(PRIOR.crane, columns(), since=since)


def test_a_swing_that_never_moves_beside_one_that_does_is_left_out_and_said() -> None:
    record = Record.of(PRIOR.crane, changed(theta_rad=np.zeros(800)))
    assert [joint.symbol for joint in record.swings] == ["phi"]
    assert record.notes == (
        "record: theta_rad never moves and is left out.",
        "record: nothing is recorded of gamma, taken to stand at 0 rad.",
        "record: nothing is recorded of l, taken to stand at 15 m.",
    )


def test_missing_rows_are_allowed_within_a_tenth_of_a_period() -> None:
    period = Record.of(PRIOR.crane, columns()).judged_period
    for gap in (0.09 * period, 0.11 * period):
        data = {key: np.delete(values, slice(300, 300 + round(gap / 0.05) - 1))
                for key, values in columns().items()}  # fmt: skip
        assert np.diff(data["t_s"]).max() == pytest.approx(gap, abs=0.025)
        if gap < 0.1 * period:
            assert len(Record.of(PRIOR.crane, data).t) == len(data["t_s"])
        else:
            with pytest.raises(DataError, match=rf"a gap .* allowed is {0.1 * period:.3g} s"):
                Record.of(PRIOR.crane, data)


def test_times_count_from_the_first_row_that_is_looked_at() -> None:
    record = Record.of(PRIOR.crane, columns(), since=10.0)
    assert record.t[0] == 0.0
    assert record.duration == pytest.approx(29.95)
    assert record.columns["phi_rad"][0] == pytest.approx(0.1 * np.sin(8.0))
    part = Record.of(PRIOR.crane, columns(), since=10.0, until=30.0)
    assert part.duration == pytest.approx(20.0)
    np.testing.assert_array_equal(part.columns["x_m"], record.columns["x_m"][:401])


def test_the_rate_of_a_swing_beyond_90_degrees_is_refused() -> None:
    """A rate R of a swing at ω is one of R / ω rad."""
    t = columns()["t_s"]
    for size in (0.95, 1.05):
        rate = size * np.pi / 2.0 * 0.8 * np.sin(0.8 * t)
        data = changed(phi_rad=None, phi_dot_rad_s=rate)
        if size < 1.0:
            assert Record.of(PRIOR.crane, data).columns.keys() == {"phi_dot_rad_s", "x_m"}
            continue
        with pytest.raises(DataError, match=r"phi_dot_rad_s is that of a swing of 1\.6.*deg/s"):
            Record.of(PRIOR.crane, data)


@pytest.mark.slow
def test_csv_parquet_and_mcap_of_a_run_give_the_same_record(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    crane = PRIOR.crane
    start = PRIOR.crane.state(phi=0.1, theta=0.05)
    run = simulate(crane, hold_controller(crane), start=start, duration=16.0, dt=1e-3,
                   control_period=0.01, engine="compiled")  # fmt: skip
    files = [run.write(tmp_path / name) for name in ("run.csv", "run.parquet")]
    files.append(mcap.export(tmp_path / "run.mcap", crane, run))
    one, other, ros = (load_record(file, crane) for file in files)
    assert one.columns.keys() == other.columns.keys()
    assert ros.columns.keys() == {name for name in one.columns if "setpoint" not in name}
    for name, values in ros.columns.items():
        assert np.array_equal(one.columns[name], values), name
        assert np.array_equal(one.columns[name], other.columns[name]), name
    np.testing.assert_allclose(ros.t, one.t, atol=1e-9)  # whole nanoseconds
