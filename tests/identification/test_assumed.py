"""What identify assumes: inertias that nobody stated, and signs of swings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn.errors import OutOfRange, UnknownName
from cranedyn.identification import Estimate, Model, Prior, Record, identify
from cranedyn.identification.assumed import assumed_inertias, inertia_effects
from cranedyn.model.crane import STANDARD_GRAVITY as GRAVITY
from cranedyn.theory import point_period

CABLE = 15.0


def estimate_of(prior: Prior) -> Estimate:
    """The estimate from a point load on a cable, small swings without damping."""
    t = np.arange(0.0, 40.0, 0.05)
    omega = 2.0 * math.pi / float(point_period(CABLE, GRAVITY))
    noise = 1e-4 * np.random.default_rng(3).standard_normal(len(t))
    swing = 0.02 * np.cos(omega * t) + noise
    columns = {"t_s": t, "phi_rad": swing, "l_m": np.full(len(t), CABLE)}
    record = Record.of(prior.crane, columns)
    return identify(Model.of(prior, [record], ["l_offset"]))


@pytest.mark.slow
def test_an_estimate_says_how_far_it_moves_with_inertias_that_nobody_stated() -> None:
    """A rigid pendulum swings as a point at l + I / (m l), I of the load and of the links."""
    estimate = estimate_of(Prior())
    names = [one.name for one in assumed_inertias(estimate)]
    assert names == ["payload_mass", "payload_inertia", "dummy_mass", "dummy_inertia"]
    effects = {effect.change: effect for effect in inertia_effects(estimate)}
    point = next(effect for change, effect in effects.items() if change.startswith("a point load"))
    radial = 400.0 + 2 * 50.0  # of the load and of both links, which all turn
    assert estimate.value("l_offset") == pytest.approx(-radial / (1000.0 * CABLE), rel=0.05)
    assert point.moved["l_offset"] == pytest.approx(radial / (1000.0 * CABLE), rel=0.05)
    assert point.intervals > 10.0
    doubled = effects["payload_inertia 400 → 800 kg m^2"]
    assert doubled.moved["l_offset"] == pytest.approx(-400.0 / (1000.0 * CABLE), rel=0.05)
    assert doubled.parameter == "l_offset"


@pytest.mark.slow
def test_what_was_stated_is_not_assumed() -> None:
    values = {"payload_mass": 1000.0, "payload_inertia": 0.1, "dummy_mass": 0.1}
    estimate = estimate_of(Prior(values={**values, "dummy_inertia": 0.1}))
    assert assumed_inertias(estimate) == []
    assert inertia_effects(estimate) == []
    assert estimate.value("l_offset") == pytest.approx(0.0, abs=2.0 * estimate.margin("l_offset"))


def moved_swing(sign: float) -> tuple[Prior, Record]:
    """The swing of a trolley that moves forth, of either sign."""
    prior = Prior()
    t = np.arange(0.0, 30.0, 0.05)
    s = np.clip((t - 1.0) / 3.0, 0.0, 1.0)
    x = 8.0 + s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    columns = {"t_s": t, "x_m": x, "l_m": np.full(len(t), CABLE), "phi_rad": 0.01 * np.sin(t)}
    model = Model.of(prior, [Record.of(prior.crane, columns)], ["l_offset"])
    values = model.first.copy()
    for i, p in enumerate(model.parameters):
        values[i] = 0.0 if p.kind in ("start", "start rate") else values[i]
    swing = np.zeros(len(t))
    swing[model.rows(0)] = model.predicted(0, values[None])[0, 0]
    noise = 1e-4 * np.random.default_rng(5).standard_normal(len(t))
    columns["phi_rad"] = sign * swing + noise
    return prior, Record.of(prior.crane, columns)


@pytest.mark.slow
def test_a_swing_of_the_other_sign_is_a_decision_with_both_likelihoods() -> None:
    prior, record = moved_swing(-1.0)
    estimate = identify(Model.of(prior, [record], ["l_offset"]))
    (decision,) = estimate.signs
    assert (decision.column, decision.is_turned) == ("phi_rad", True)
    assert decision.turned > decision.as_recorded + 100.0
    assert decision.turned == pytest.approx(estimate.log_likelihood)
    # white normal errors of 1e-4: their expected log-likelihood
    rows = estimate.residuals[0].size
    expected = -rows * (math.log(1e-4 * math.sqrt(2.0 * math.pi)) + 0.5)
    assert estimate.log_likelihood == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_a_stated_sign_is_not_tried_otherwise() -> None:
    prior, record = moved_swing(-1.0)
    stated = identify(Model.of(prior, [record], ["l_offset"], signs={"phi": -1}))
    assert stated.signs == ()
    assert stated.least_explained[0] > 0.99
    as_recorded = identify(Model.of(prior, [record], ["l_offset"], signs={"phi": 1}))
    assert as_recorded.signs == ()
    assert as_recorded.least_explained[0] < 0.9
    prior, record = moved_swing(1.0)
    assert identify(Model.of(prior, [record], ["l_offset"])).signs == ()


def test_a_sign_is_one_of_a_swing() -> None:
    t = np.arange(0.0, 40.0, 0.05)
    prior = Prior()
    record = Record.of(prior.crane, {"t_s": t, "phi_rad": 0.1 * np.sin(0.8 * t)})
    with pytest.raises(UnknownName, match="There is no swing 'x'; there are phi, theta"):
        Model.of(prior, [record], ["damp_swing"], signs={"x": 1})
    with pytest.raises(OutOfRange, match="sign of phi is 2; allowed is 1 or -1"):
        Model.of(prior, [record], ["damp_swing"], signs={"phi": 2})
