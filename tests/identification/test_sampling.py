"""Records as loggers write them: held values, clocks that jitter, swings of the other sign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cranedyn.identification import Model, Prior, Record, identify
from cranedyn.identification.record import load_record
from cranedyn.identification.sampling import is_irregular, samples, smooth
from cranedyn.model.crane import STANDARD_GRAVITY as GRAVITY
from experiments.identify import main
from experiments.measured import pendulum

GANTRY = """<robot name="gantry">
  <link name="rail"/><link name="cart"><inertial><mass value="2"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><mass value="1e-4"/>
    <inertia ixx="1e-7" iyy="1e-7" izz="1e-7" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="load"><inertial><mass value="1.1"/>
    <inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="trolley_joint" type="prismatic"><parent link="rail"/><child link="cart"/>
    <axis xyz="1 0 0"/><limit lower="-0.1" upper="1.5" effort="100" velocity="1"/></joint>
  <joint name="pendulum_joint" type="revolute"><parent link="cart"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="0" velocity="0"/></joint>
  <joint name="winch_joint" type="prismatic"><parent link="arm"/><child link="load"/>
    <axis xyz="0 0 -1"/><limit lower="0.05" upper="1" effort="100" velocity="1"/></joint>
</robot>"""

OFFSET, DELAY, WINDOW, DAMPING, BIAS, CABLE = -0.038, 0.17, 0.35, 0.008, 0.002, 0.381
MASS = 1.1


def logged(seed: int, sign: int = 1, **sensor: float) -> dict[str, np.ndarray]:
    """Return a record of the independent pendulum with the names of this gantry."""
    length = CABLE + OFFSET
    columns = pendulum.logged(
        seed, sign, length=length, cable=CABLE, damping=DAMPING / (MASS * length**2), bias=BIAS,
        **sensor,
    )  # fmt: skip
    names = {"x_m": "trolley_m", "l_m": "winch_m", "phi_rad": "pendulum_rad"}
    return {names.get(name, name): values for name, values in columns.items()}


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory) -> Prior:
    path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(GANTRY)
    return Prior(path, loading={"driven": ["trolley_joint", "winch_joint"]})


def test_a_held_column_brings_fresh_values_at_its_own_interval() -> None:
    columns = logged(1)
    t = columns["t_s"]
    sampled = samples(t, columns["trolley_m"])
    assert sampled.is_held and is_irregular(t)
    assert sampled.interval == pytest.approx(0.030, abs=0.003)
    assert 4e-5 < sampled.resolution < 2e-4
    spline, deviation = smooth(t, columns["trolley_m"], sampled)
    assert 1e-4 < deviation < 3e-3
    inside = np.linspace(0.5, 4.0, 200)
    assert np.abs(spline(inside) - pendulum.trolley(inside)).max() < 0.02
    assert np.abs(spline.derivative()(inside)).max() < 0.75  # 0.64 m/s in truth


def test_a_column_that_is_sampled_in_each_row_stays_as_it_is(prior: Prior) -> None:
    t = np.arange(0.0, 12.0, 0.01)
    columns = {"t_s": t, "trolley_m": pendulum.trolley(t), "pendulum_rad": 0.1 * np.sin(5.0 * t)}
    record = Record.of(prior.crane, columns)
    np.testing.assert_array_equal(record.columns["trolley_m"], columns["trolley_m"])
    assert record.columns.keys() == {"trolley_m", "pendulum_rad"}
    assert not record.resolution
    assert not samples(t, np.zeros(len(t))).is_held


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_a_crane_is_identified_from_what_a_logger_wrote(prior: Prior, sign: int) -> None:
    records = [Record.of(prior.crane, logged(seed, sign), name=f"r{seed}") for seed in (2, 3)]
    estimate = identify(Model.of(prior, records))
    assert estimate.least_explained[0] > 0.98
    assert not estimate.at_bound
    turned = [note for record in estimate.model.records for note in record.notes if "sign" in note]
    assert len(turned) == (0 if sign > 0 else 2)
    truth = {
        "winch_offset": OFFSET,
        "damp_pendulum": DAMPING,
        "delay": DELAY + 0.5 * (0.033 - 0.030),  # a held value is late by half its interval
        "pendulum_bias": BIAS,
    }
    for name, value in truth.items():
        slack = {"delay": 0.01, "winch_offset": 3e-4}.get(name, 0.0)
        assert abs(estimate.value(name) - value) < 1.5 * estimate.margin(name) + slack, name


@pytest.mark.slow
def test_a_sensor_that_averages_is_told_from_one_that_is_late(prior: Prior) -> None:
    """An average over a window is late by half of it, and smaller; a delay explains neither the
    size nor the period.
    """
    record = Record.of(prior.crane, logged(3, delay=0.0, window=WINDOW))
    names = ["winch_offset", "damp_pendulum", "pendulum_bias"]
    averaged, late = (
        identify(Model.of(prior, [record], [*names, sensor])) for sensor in ("window", "delay")
    )
    for name, value in {"window": WINDOW, "winch_offset": OFFSET}.items():
        assert abs(averaged.value(name) - value) < 1.5 * averaged.margin(name), name
    assert abs(late.value("winch_offset") - OFFSET) > late.margin("winch_offset")
    assert 1.0 - late.least_explained[0] > 3.0 * (1.0 - averaged.least_explained[0])


def test_delay_stays_below_a_quarter_of_the_swing(prior: Prior) -> None:
    record = Record.of(prior.crane, logged(4))
    assert record.swing_period == pytest.approx(2 * np.pi * np.sqrt(CABLE / GRAVITY), rel=1e-3)
    early, late = Model.of(prior, [record]).delay_bounds
    assert (early, late) == pytest.approx((-0.25 * record.swing_period, 0.25 * record.swing_period))


@pytest.mark.slow
def test_a_record_that_the_twin_does_not_explain_fails(
    tmp_path: Path, prior: Prior, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = logged(5)
    rng = np.random.default_rng(0)
    columns["pendulum_rad"] = np.round(rng.normal(0.0, 0.05, len(columns["t_s"])), 3)
    path = tmp_path / "record.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    assert set(load_record(path, prior.crane).columns) >= {"trolley_m", "pendulum_rad"}
    urdf = str(prior.urdf)
    options = ["--urdf", urdf, "--driven", "trolley_joint", "winch_joint"]
    assert main([str(path), *options, "--out", str(tmp_path / "out")]) == 1
    assert "FAILS      The records: the twin explains 90 %" in capsys.readouterr().out
