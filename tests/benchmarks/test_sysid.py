"""Identification beside MuJoCo's toolbox: both predict held-out records of a pendulum."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("mujoco", reason="extra mujoco is not installed")
pytest.importorskip("tabulate", reason="mujoco[sysid] is not installed")

from benchmarks import sysid
from cranedyn.identification import Record
from experiments.measured.pendulum import logged

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_table_compares_held_out_errors(capsys: pytest.CaptureFixture[str]) -> None:
    assert sysid.main(["--records", "2"]) == 0
    printed = capsys.readouterr().out
    assert all(way in printed for way in ("mujoco.sysid", "cranedyn", "window instead of delay"))
    assert "iter:" not in printed
    assert sysid.main(["--data", "nowhere"]) == 2
    assert "git clone" in capsys.readouterr().err


def test_both_identify_a_sensor_that_is_late() -> None:
    """Without an average in the sensor both have all parameters that the record has; what is left
    is rounding of the positions, of which MuJoCo gets what we smooth.
    """
    prior, _ = sysid.records_of(None, 0)
    logs = []
    for seed in (1, 2):
        columns = logged(seed, travel=0.9, lasts=1.5 + 0.4 * seed, delay=0.1)
        logs.append(sysid.Logged(columns, Record.of(prior.crane, columns)))
    predictions = [
        sysid.theirs(prior, logs[:1], smooth=True)(logs[1]),
        sysid.ours(prior, logs[:1], "delay")(logs[1]),
    ]
    errors = [logs[1].error(predicted) for predicted in predictions]
    assert max(errors) < 0.1
    swing = logs[1].clean.columns["phi_rad"][logs[1].judged]
    assert np.std(predictions[0] - predictions[1]) < 0.1 * np.std(swing)
