"""Peers beside each other run the same physics, and the chart shows each with its number."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.agreement import Truth
from benchmarks.contestants import CONTESTANTS, jax, ours
from benchmarks.workload import Case


def test_jax_by_hand_makes_the_trajectory_of_the_plain_loop() -> None:
    by_hand = jax.CONTESTANTS[0]
    case = Case()
    if (reason := by_hand.missing()) is not None:
        pytest.skip(reason)
    # 4000 steps of 1e-16 each
    assert Truth(case).max_deviation(by_hand.prepare(case), many=True) < 4e-13


def test_everybody_takes_part_but_slower_ways_of_our_own() -> None:
    names = {one.name for one in peers.peers()}
    assert {one.name for one in jax.CONTESTANTS} < names
    assert {one.name for one in CONTESTANTS} - names == {
        "Python controller, compiled steps",
        "compiled closed loop",
        "compiled batch, 1 thread",
        "C by hand",
        "C by hand, whole log",
        "C by hand, 1 thread",
    }


@pytest.mark.slow
def test_the_table_is_sorted_and_the_chart_has_a_bar_for_each() -> None:
    few = [
        one for one in ours.CONTESTANTS if one.name in ("plain loop", "compiled batch, all cores")
    ]
    (table,), figure = peers.peers_benchmark(1, True, few)
    assert [row[0] for row in table.rows] == ["compiled batch, all cores", "plain loop"]
    rates = np.array([row[2] for row in table.rows], float)
    assert table.rows[0][3] == 1.0
    assert table.rows[1][3] == pytest.approx(rates[1] / rates[0], rel=0.01)
    (ax,) = figure().axes
    assert [bar.get_width() for bar in ax.patches] == rates.tolist()
    assert [text.get_text() for text in ax.get_yticklabels()] == [
        "cranedyn, compiled batch",
        "plain loop (one crane)",
    ]
