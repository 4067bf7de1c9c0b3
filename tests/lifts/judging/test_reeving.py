"""Reeving: efficiency, pull of the line and torque of the drum."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.lifts.judging.chart import Reeving
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane


@pytest.mark.parametrize("falls", [1, 2, 4, 7])
@pytest.mark.parametrize("eta", [1.0, 0.98, 0.9])
def test_each_sheave_passes_on_its_share_of_the_pull(falls: int, eta: float) -> None:
    pulls = [eta**k for k in range(falls)]
    assert theory.reeving_efficiency(falls, eta) == pytest.approx(sum(pulls) / falls, rel=1e-14)


@pytest.mark.parametrize("speed", [-0.5, 0.0, 0.5])
def test_the_drum_does_the_work_on_the_load_and_what_the_sheaves_take(speed: float) -> None:
    one = crane()
    reeving = Reeving(4, 0.95, 0.3)
    start = one.state(l_dot=speed)
    reference = ramp(one, hold(one, start), "l", 5.0 * (speed or 1.0), rate=abs(speed) or 0.1, at=0)
    if not speed:
        reference = hold(one, start)
    run = simulate(
        one, follow(one, reference, 5e-3), reference, start=start, duration=0.5, drive="motion"
    )
    columns = reeving.columns(one, run)
    weight = one.payload_mass * one.gravity
    efficiency = theory.reeving_efficiency(4, 0.95)
    expected = {-0.5: weight / (4 * efficiency), 0.0: weight / 4}
    expected[0.5] = weight / sum(0.95**-k for k in range(4))
    assert_allclose(columns["line_N"], expected[speed], rtol=1e-9)
    assert_allclose(columns["drum_Nm"], 0.3 * columns["line_N"])
    assert_allclose(columns["line_m_s"], -4 * speed, atol=1e-12)
    lifting = weight * -speed
    assert (columns["line_N"] * columns["line_m_s"] >= lifting - 1e-6).all()
    assert reeving.capacity(expected[-0.5], one.gravity) == pytest.approx(one.payload_mass)


def test_the_pull_depends_on_the_direction_of_the_hoist() -> None:
    pull = Reeving(2, 0.9).line_pull(np.full(3, 190.0), np.array([-1.0, 0.0, 1.0]))
    assert_allclose(pull, [190.0 / 1.9, 95.0, 190.0 / (1.0 + 1.0 / 0.9)])
