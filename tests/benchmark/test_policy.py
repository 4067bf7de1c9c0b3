"""Trained policies: what a network computes, and what a file of one may hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.benchmark import baselines
from cranedyn.benchmark.entry import Declined, briefing_of
from cranedyn.benchmark.policy import FOLDER, Policy, Scales, network_inputs, read_policy
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.benchmark.task import select_tasks
from cranedyn.errors import DataError

POLICY = Policy(
    algorithm="PPO",
    task="inteco/move",
    period=0.04,
    activation="relu",
    output="clip",
    scales=Scales(
        reach=np.array([0.5]),
        middle=np.array([1.0]),
        half_range=np.array([2.0]),
        rate=np.array([0.3]),
        swing=np.array([0.2]),
        swing_rate=np.array([0.8]),
    ),
    # One drive and one swing: five observations, and two cube roots.
    weights=[np.eye(7)[:, :3], np.array([[1.0], [1.0], [-2.0]])],
    biases=[np.array([0.0, 0.0, 0.1]), np.array([0.05])],
)


def test_a_network_computes_layer_after_layer() -> None:
    """The hidden layer takes distance, position and rate: 0.4, 0.25, -0.5 + 0.1, of which the last
    is cut off.
    """
    measured = [np.array([value]) for value in (0.2, 1.5, -0.15, 0.02, 0.0)]
    assert POLICY.action(*measured) == pytest.approx([0.4 + 0.25 + 0.05])
    squashed = replace(POLICY, output="tanh", activation="tanh")
    expected = np.tanh(0.4) + np.tanh(0.25) - 2.0 * np.tanh(-0.4) + 0.05
    assert squashed.action(*measured) == pytest.approx([np.tanh(expected)])
    far = [np.array([value]) for value in (5.0, 1.5, 0.0, 0.0, 0.0)]
    assert POLICY.action(*far) == pytest.approx([1.0])


def test_small_distances_and_swings_are_told_apart_by_their_cube_roots() -> None:
    observation = np.array([[0.008, 0.5, 0.1, -0.027, 0.3]])
    assert network_inputs(observation, 1)[0, 5:] == pytest.approx([0.2, -0.3])


def test_a_policy_is_read_as_it_was_written(tmp_path: Path) -> None:
    file = tmp_path / "policy.npz"
    POLICY.write(file)
    found = read_policy(file)
    assert (found.algorithm, found.task, found.period) == ("PPO", "inteco/move", 0.04)
    measured = [np.array([value]) for value in (0.2, 1.5, -0.15, 0.02, 0.0)]
    # The file has single precision.
    assert found.action(*measured) == pytest.approx(POLICY.action(*measured), abs=1e-6)


class Dangerous:
    """What would write a file if it were unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.file,))


def test_nothing_in_a_file_is_run(tmp_path: Path) -> None:
    file = tmp_path / "policy.npz"
    trace = tmp_path / "ran"
    np.savez(file, about=np.array([Dangerous(trace)], dtype=object))
    with pytest.raises(DataError, match="is no policy"):
        read_policy(file)
    assert not trace.exists()


@pytest.mark.parametrize(
    "change",
    [
        {"activation": "gelu"},
        {"period": -1.0},
        {"weights": [np.eye(7)[:, :3], np.ones((4, 1))]},
        {"weights": [np.eye(7)[:, :3]], "biases": [np.zeros(3)]},
        {"biases": [np.zeros(3), np.array([np.nan])]},
        {"scales": replace(POLICY.scales, rate=np.ones(2))},
    ],
)
def test_a_policy_that_does_not_fit_together_is_refused(change: dict, tmp_path: Path) -> None:
    file = tmp_path / "policy.npz"
    replace(POLICY, **change).write(file)
    with pytest.raises(DataError, match="is no policy"):
        read_policy(file)
    (tmp_path / "text.npz").write_text("no archive", encoding="utf-8")
    with pytest.raises(DataError, match="is no policy"):
        read_policy(tmp_path / "text.npz")


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.npz")), ids=lambda file: file.stem)
def test_a_policy_of_this_package_is_a_baseline_that_takes_part_on_its_crane(file: Path) -> None:
    policy = read_policy(file)
    make = getattr(baselines, file.stem)
    assert file.stem in baselines.NAMES
    (task,) = select_tasks([policy.task])
    entry = make(briefing_of(task))
    start = task.start_state().q[task.crane().layout.drives]
    zero = np.zeros(len(start))
    reading = SensorReading(0.0, start, zero, np.zeros(2), np.zeros(2), zero)
    rates = entry(reading)
    assert rates.any()
    assert (np.abs(rates) <= (1.0 + 1e-6) * task.largest_rates).all()
    # The same until the next action, whatever is measured.
    assert (entry(reading._replace(t=0.02, swing=np.array([0.1, 0.0]))) == rates).all()
    assert (entry(reading._replace(t=0.04, swing=np.array([0.1, 0.0]))) != rates).any()
    (other,) = select_tasks(["tower/move"])
    with pytest.raises(Declined):
        make(briefing_of(other))
