"""Tests of residuals beside those of statsmodels, too large a dependency for two formulas."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.identification import estimate
from cranedyn.identification.estimate import is_white, long_run

pytestmark = pytest.mark.slow

pytest.importorskip("statsmodels", reason="extra dev (statsmodels) is not installed")


def _autoregressive(share: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return noise of which each value has a share of the one before."""
    noise = rng.normal(size=count)
    for k in range(1, count):
        noise[k] += share * noise[k - 1]
    return noise


def test_a_residual_is_white_where_ljung_and_boxs_test_of_statsmodels_says_so() -> None:
    from statsmodels.stats.diagnostic import acorr_ljungbox

    rng = np.random.default_rng(3)
    verdicts = []
    for share in np.linspace(0.0, 0.6, 61):
        residual = 2.0 + _autoregressive(float(share), 300, rng)
        lags = [estimate._WHITENESS_LAGS]
        theirs = float(acorr_ljungbox(residual, lags=lags)["lb_pvalue"].iloc[0])
        assert is_white(residual) == (theirs > estimate.WHITENESS_LEVEL)
        verdicts.append(is_white(residual))
    assert 0.2 < np.mean(verdicts) < 0.8


def test_the_long_run_covariance_of_scores_is_that_of_newey_and_west_in_statsmodels() -> None:
    from statsmodels.stats.sandwich_covariance import S_hac_simple

    rng = np.random.default_rng(4)
    scores = np.stack([_autoregressive(share, 200, rng) for share in (0.0, 0.5, 0.9)], axis=1)
    np.testing.assert_allclose(long_run(scores), S_hac_simple(scores, nlags=20), rtol=1e-12)
