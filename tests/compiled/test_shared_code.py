"""Code that many variants of a crane share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled import verify
from cranedyn.compiled.verify import code_shared_with
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import converters
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate


def driven(mass: float, lag: float) -> Trajectory:
    """A run of a crane with a load [kg] and lags of its drives over the typical ones."""
    crane = load_crane(machine="inteco_3dcrane", payload_mass=mass)
    typical = converters(crane)

    def rates(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return np.array([0.1, -0.1 * np.cos(3.0 * t), 0.02])

    return simulate(
        crane,
        rates,
        duration=1.0,
        dt=1e-3,
        control_period=0.02,
        drive=replace(typical, lags=lag * typical.lags),
        engine="compiled",
    )


@pytest.mark.slow
def test_variants_of_a_crane_share_code_and_move_as_with_code_of_their_own() -> None:
    variants = [(0.7, 0.9), (1.3, 1.2), (1.1, 0.8)]
    alone = [driven(*variant) for variant in variants]
    nominal = load_crane(machine="inteco_3dcrane", payload_mass=1.0)
    before = verify._cached_kernel.cache_info().misses
    with code_shared_with(nominal, converters(nominal)):
        shared = [driven(*variant) for variant in variants]
    assert verify._cached_kernel.cache_info().misses == before + 1
    for own, common in zip(alone, shared, strict=True):
        # A constant that is folded and one that is loaded may be added in another order.
        assert_allclose(common.q, own.q, rtol=0.0, atol=1e-12)
        assert_allclose(common.v, own.v, rtol=0.0, atol=1e-12)
    # The loads are different ones, and so are the motions.
    assert np.abs(shared[0].q - shared[1].q).max() > 1e-4
    # Outside of the context each crane has its own code again.
    driven(0.9, 1.1)
    assert verify._cached_kernel.cache_info().misses == before + 2
