"""What a record cannot tell is said before it is believed, and which move would."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.identification import Model, Prior, Record, identify, preflight
from cranedyn.identification.preflight import propose_records
from experiments.identify.trial import TRUTH, trial_record
from tests.identification.test_estimate import TRUTH as TRUE
from tests.identification.test_estimate import recorded

pytestmark = pytest.mark.slow

PRIOR = Prior()


def test_setpoints_alone_do_not_tell_delay_and_lag_apart_and_positions_would() -> None:
    """At the true numbers: the swing is late by both alike. What the advice promises of recording
    the positions, too, is kept by a record with positions.
    """
    alone = Model.of(PRIOR, [trial_record(PRIOR, positions=False)])
    own = [one for one in alone.parameters if one.record is None]
    values = np.array([TRUTH[one.name] for one in own])
    values = np.concatenate([values, np.zeros(len(alone.parameters) - len(own))])
    judged = preflight(_at(alone, values))
    pairs = {frozenset((pair.first, pair.second)): pair.correlation for pair in judged.inseparable}
    assert pairs[frozenset(("delay", "x_lag"))] < -0.95
    best = judged.advice[0]
    assert "recorded, too" in best.move
    assert best.margins["delay"] < 0.5 * judged.margins["delay"]
    both = Model.of(PRIOR, [trial_record(PRIOR, positions=True)])
    kept = preflight(_at(both, values))
    assert not {"delay", "x_lag"} & {name for pair in kept.inseparable for name in pair[:2]}
    assert kept.margins["delay"] <= best.margins["delay"]


def _at(model: Model, values: np.ndarray) -> Model:
    """The same model, believed to be at values."""
    object.__setattr__(model, "first", values)
    return model


def test_margins_foretold_are_those_that_come_out() -> None:
    columns = dict(recorded())
    rng = np.random.default_rng(5)
    for name in ("phi_rad", "theta_rad"):
        columns[name] = columns[name] + 2e-3 * rng.standard_normal(len(columns["t_s"]))
    known = Prior(None, {name: TRUE[name] for name in ("payload_mass", "damp_swing")})
    names = ["l_offset", "delay", "phi_bias", "theta_bias"]
    model = Model.of(known, [Record.of(known.crane, columns)], names)
    foretold = preflight(model)
    estimate = identify(model)
    for name in names:
        assert abs(foretold.margins[name] / estimate.margin(name) - 1.0) < 0.15, name
    # A bias is the mean of what is left: its interval is 1.96 σ / sqrt(n), the noise being known
    # within 1 / sqrt(2 n), and little of it goes to other parameters.
    plain = 1.96 * 2e-3 / np.sqrt(len(model.rows(0)))
    for name in ("phi_bias", "theta_bias"):
        assert plain * 0.9 < estimate.margin(name) < plain * 1.15
    assert foretold.inseparable == ()
    assert foretold.undetermined == ()
    assert foretold.advice == ()


def test_the_weight_of_a_load_that_only_swings_is_said_to_be_next_to_unknown() -> None:
    """It shows by the inertia of the links alone, as a longer cable would; hoisting tells little
    more, since no effort is recorded.
    """
    columns = {name: recorded()[name] for name in ("t_s", "x_m", "phi_rad", "l_m")}
    columns["l_m"] = np.full_like(columns["l_m"], columns["l_m"][0])
    columns["phi_rad"] = columns["phi_rad"] + 1e-3 * np.random.default_rng(1).standard_normal(
        len(columns["t_s"])
    )
    model = Model.of(PRIOR, [Record.of(PRIOR.crane, columns)], ["l_offset", "payload_mass"])
    judged = preflight(model)
    assert judged.undetermined == ("payload_mass",)
    assert [{pair.first, pair.second} for pair in judged.inseparable] == [
        {"l_offset", "payload_mass"}
    ]
    assert judged.advice[0].margins["payload_mass"] < judged.margins["payload_mass"]
    assert any(" m, half the cable" in advice.move for advice in judged.advice)


def test_moves_that_are_proposed_stay_within_the_ranges_of_the_drives() -> None:
    model = Model.of(PRIOR, [Record.of(PRIOR.crane, recorded())])
    proposed = list(propose_records(model, model.first))
    assert len(proposed) >= 6
    crane = PRIOR.crane
    for words, record in proposed:
        for joint, at in zip(crane.layout.driven, crane.layout.drives, strict=True):
            place = record.columns[joint.columns[0]]
            assert crane.lower[at] <= place.min() <= place.max() <= crane.upper[at], words
