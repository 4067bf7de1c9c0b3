"""The compiled load filter and the plain one."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError
from cranedyn.estimation import with_load_estimate
from cranedyn.estimation.load_filter import Sensors
from cranedyn.model.load import load_crane
from tests.estimation.motions import PERIOD, REST, STILL, at_rest
from tests.helpers import ROOT, crane, quickly

pytest.importorskip("llvmlite")

from cranedyn.compiled.load_filter_code import compile_load_estimate


@pytest.mark.parametrize(
    "sensors",
    [
        # The encoders of the drives are read in both of the others, too.
        pytest.param("drives", marks=pytest.mark.long),
        "swing",
        "imu",
    ],
)
@pytest.mark.slow
def test_compiled_and_plain_filters_make_the_same_run(sensors: Sensors) -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.05, theta=-0.03)
    plain = with_load_estimate(hold_controller(crane()), crane(), motion, sensors=sensors)
    compiled = compile_load_estimate(plain)
    runs = [
        quickly(crane(payload_mass=1500.0), controller, motion, start=start, duration=5.0)
        for controller in (plain, compiled)
    ]
    assert plain.filter.load == pytest.approx(1.5, rel=1e-2)
    # round-off of numbers up to 15 m
    np.testing.assert_allclose(runs[1].q, runs[0].q, rtol=0.0, atol=1e-12)
    # round-off of the covariance, whose numbers span ten decades
    np.testing.assert_allclose(compiled.filter.mean, plain.filter.mean, rtol=0.0, atol=2e-11)
    np.testing.assert_allclose(compiled.filter.covariance, plain.filter.covariance, atol=1e-11)
    np.testing.assert_array_equal(compiled.filter.covariance, compiled.filter.covariance.T)


@pytest.mark.slow
def test_compiled_and_plain_filters_of_another_crane_take_the_same_step() -> None:
    bridge = load_crane(ROOT / "urdf" / "overhead_crane.urdf.xacro", payload_mass=1000.0)
    motion = at_rest(bridge, **dict(zip(bridge.layout.symbols, bridge.start.q, strict=True)))
    plain = with_load_estimate(hold_controller(bridge), bridge, motion, sensors="imu")
    plain.filter.mean = plain.filter.mean + 0.1 * np.random.default_rng(5).normal(size=13)
    plain.filter.covariance = 1e-2 * np.eye(13)
    filters = plain.filter, compile_load_estimate(plain).filter
    for each in filters:
        each._believe()
        each.step(np.array([3000.0, 500.0, -8000.0]), bridge.start)
    for one, other in zip(*((each.mean, each.covariance) for each in filters), strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-13)


def test_a_crane_with_springs_keeps_its_plain_filter() -> None:
    elastic = load_crane(jib_bend_stiffness=4e7)
    motion = at_rest(elastic, **dict(zip(elastic.layout.symbols, elastic.start.q, strict=True)))
    controller = with_load_estimate(hold_controller(elastic), elastic, motion)
    assert compile_load_estimate(controller) is controller


@pytest.mark.slow
def test_an_estimate_that_is_not_finite_is_an_error() -> None:
    motion = at_rest(crane())
    plain = with_load_estimate(hold_controller(crane()), crane(), motion)
    controller = compile_load_estimate(plain)
    state = crane().state(**REST)
    controller(0.0, state, STILL)
    state.v[0] = np.nan
    with pytest.raises(CraneError, match="not finite"):
        controller(PERIOD, state, STILL)
