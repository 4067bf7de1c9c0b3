"""B1: the paper's control and its neighbours on three moves, as the command runs them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from cranedyn import theory
from cranedyn.analysis.swing import settling_time, swing_amplitude
from experiments.b1 import SHOWN as STRATEGIES
from experiments.scenarios.moves import MOVES
from tests.experiments.conftest import Ran
from tests.helpers import FAST


@pytest.fixture(scope="module")
def result(ran: Callable[..., Ran]) -> Ran:
    return ran("b1", "--engine", FAST)


def test_every_way_is_scored_on_every_move_and_the_spline_alone_among_them(result: Ran) -> None:
    for table, move in zip(result.result["tables"], MOVES, strict=True):
        assert move.name in table["title"]
        assert [row[0] for row in table["rows"]] == list(STRATEGIES)


def test_the_spline_alone_on_the_trolley_leaves_the_swing_of_the_closed_form(result: Ran) -> None:
    # Quintic of 10 m in 20 s on 15 m of cable: what a linear pendulum of the reduced length keeps;
    # 16 mrad is small (A²/16 = 2e-5).
    length = 15.0 + 500.0 / (1000.0 * 15.0)
    closed = 1000.0 * theory.quintic_residual(10.0, 20.0, length, 9.80665)
    row = result.result["tables"][0]["rows"][0]
    # finite swing on the way (26 mrad) and damp_swing change it by some 1e-4
    assert row[3] == pytest.approx(closed, rel=2e-3)


def test_swing_amplitude_of_a_free_swing_is_its_amplitude_at_any_time() -> None:
    t = np.linspace(0.0, 10.0, 50)
    omega = math.sqrt(9.81 / 8.0)
    swing = 0.02 * np.stack([np.cos(omega * t), np.zeros_like(t)], axis=1)
    rates = -0.02 * omega * np.stack([np.sin(omega * t), np.zeros_like(t)], axis=1)
    np.testing.assert_allclose(swing_amplitude(swing, rates, 8.0, 9.81), 0.02, rtol=1e-12)


@pytest.mark.parametrize(
    ("distance", "settled"),
    [
        ([5, 2, 5, 1, 1], 3.0),
        ([1, 1, 1, 1, 1], 0.0),
        ([1, 1, 1, 1, 5], math.inf),
        ([5, 1, math.nan, 1, 1], 3.0),
    ],
)
def test_settling_is_when_the_distance_is_small_for_good(
    distance: list[float], settled: float
) -> None:
    assert settling_time(np.arange(5.0), np.array(distance, dtype=float), 2.0) == settled
