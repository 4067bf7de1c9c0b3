"""Speed of batches by rope."""

from __future__ import annotations

import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from benchmarks.ropes import measure_ropes
from cranedyn.dynamics.integrators import semi_implicit_euler

pytestmark = pytest.mark.slow


def test_only_ropes_of_loads_that_bounce_go_slack_while_they_are_timed() -> None:
    (table,) = measure_ropes(8, 1.0, 1, [semi_implicit_euler])
    named = {str(name): numbers for name, _, *numbers in table.rows}
    slack, changes, speed, ratio = zip(*named.values(), strict=True)
    assert [share > 0.0 for share in slack] == [False, False, True, True]
    assert [count > 0.0 for count in changes] == [False, False, True, True]
    assert min(speed) > 0.0
    assert ratio[0] == 1.0
