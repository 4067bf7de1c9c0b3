"""A phone's gyroscope on the load, and a tape, tell cable, damping and gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cranedyn.__main__ import main
from cranedyn.data.external import parse_sources
from cranedyn.errors import DataError
from cranedyn.identification import Model, Prior, identify, load_record

TRUTH = {"l_offset": 0.35, "damp_swing": 200.0, "gravity": 9.79}
PHYPHOX = ",".join(f'"{name}"' for name in ("Time (s)", *(f"Gyroscope {c} (rad/s)" for c in "xyz")))


def phone(path: Path, length: float, header: str, duration: float) -> None:
    """Write what a phone records that lies askew on a load of 1000 kg: rates with noise, a bias
    that warms up and wanders, and a clock that starts early, jitters and is 10 ppm fast.
    """
    rng = np.random.default_rng(int(length))
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7])
    t = np.arange(0.0, duration, 0.01)
    t = np.sort(t + 2e-4 * rng.standard_normal(t.shape))
    mass = 1000.0
    cable = length + TRUTH["l_offset"]
    inertia = mass * cable**2 + 500.0  # of the load and of the two links at the pivot

    def pendulum(_: float, state: np.ndarray) -> list[float]:
        moment = mass * TRUTH["gravity"] * cable * np.sin(state[0])
        return [state[1], -(moment + TRUTH["damp_swing"] * state[1]) / inertia]

    swing = solve_ivp(pendulum, (0.0, duration + 1.0), [0.07, 0.0], t_eval=t + 0.5, rtol=1e-10)
    wander = 1e-6 * np.cumsum(rng.standard_normal(t.shape))
    drift = rng.normal(0.0, 5e-3, 3) + (2e-3 * (1.0 - np.exp(-t / 40.0)) + wander)[:, None]
    rates = np.outer(swing.y[1], turn.apply([0.8, 0.6, 0.0])) + drift
    rates += 1.5e-3 * rng.standard_normal(rates.shape)
    rows = np.column_stack([1.00001 * t - 0.1, rates])
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9E")


def record(folder: Path, length: float, header: str = PHYPHOX, duration: float = 60.0) -> Path:
    """Write the record of such a phone."""
    file = folder / f"swing_{length}_{len(header)}.csv"
    source = folder / "phone.csv"
    phone(source, length, header, duration)
    assert main(["record-template", str(file), "--gyroscope", str(source), str(length)]) == 0
    return file


@pytest.mark.slow
def test_cable_damping_and_gravity_of_a_gyroscope_lie_within_their_intervals(
    tmp_path: Path,
) -> None:
    prior = Prior()
    records = [load_record(record(tmp_path, length), prior.crane) for length in (6.0, 12.0, 20.0)]
    estimate = identify(Model.of(prior, records, list(TRUTH)))
    for name, (value, margin) in estimate.intervals.items():
        assert abs(value - TRUTH[name]) <= margin <= 0.02 * TRUTH[name], name
    assert estimate.least_explained[0] > 0.99
    assert estimate.not_white == ()


def test_apps_differ_in_their_columns_only(tmp_path: Path) -> None:
    files = [record(tmp_path, 8.0, header, 8.0) for header in (PHYPHOX, "seconds_elapsed,x,y,z")]
    assert files[0].read_text() == files[1].read_text()
    columns = np.genfromtxt(files[0], delimiter=",", names=True)
    assert columns.dtype.names == ("t_s", "phi_dot_rad_s", "l_m")
    # The swing of 0.07 rad at ω = √(g/l), whatever the phone's axes, within noise and drift.
    peak = np.ptp(columns["phi_dot_rad_s"]) / 2.0
    assert peak == pytest.approx(0.07 * np.sqrt(9.79 / 8.35), rel=0.1)


@pytest.mark.slow
def test_a_rate_counts_where_no_angle_is_and_degrees_are_noticed(tmp_path: Path) -> None:
    crane = Prior().crane
    file = record(tmp_path, 8.0, duration=20.0)
    rates = load_record(file, crane)
    assert [rates.swing_column(joint) for joint in rates.swings] == ["phi_dot_rad_s"]
    table = np.loadtxt(file, delimiter=",", skiprows=1) * [1.0, 180.0 / np.pi, 1.0]
    np.savetxt(file, table, delimiter=",", header="t_s,phi_dot_rad_s,l_m", comments="")
    with pytest.raises(DataError, match=r"that of a swing of \d.*=phi_dot_rad_s\[deg/s\]"):
        load_record(file, crane)
    again = load_record(file, crane, sources=parse_sources(["phi_dot_rad_s=phi_dot_rad_s[deg/s]"]))
    assert_allclose(again.columns["phi_dot_rad_s"], rates.columns["phi_dot_rad_s"])
    both = table[:, [0, 1, 1, 2]] / [1.0, 60.0, 60.0, 1.0]
    header = "t_s,phi_rad,phi_dot_rad_s,l_m"
    np.savetxt(file, both, delimiter=",", header=header, comments="")
    assert "phi_dot_rad_s" not in load_record(file, crane).columns


def test_the_command_says_what_to_measure_and_refuses_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(record(tmp_path, 8.0, duration=2.0))
    new = str(tmp_path / "new.csv")
    for words, code, text in (
        ([], 0, "phi_dot_rad_s [rad/s] of a gyroscope"),
        ([file], 2, "it is there already"),
        ([new, "--gyroscope", "none.csv", "8"], 2, "Cannot read none.csv"),
        ([new, "--gyroscope", file, "8"], 2, "no columns of a gyroscope; allowed are Time (s), "),
        ([new, "--gyroscope", file, "-8"], 2, "length of the cable is -8 m; allowed is > 0"),
        ([new], 0, "Written to "),
    ):
        assert main(["record-template", *words]) == code
        assert text in "".join(capsys.readouterr())
    with pytest.raises(DataError, match="has 3 rows to go by; allowed are 40 or more"):
        load_record(new, Prior().crane)
