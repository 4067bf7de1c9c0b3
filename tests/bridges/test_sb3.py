"""Cranes for Stable-Baselines3: the same episodes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.helpers import crane

sb3 = pytest.importorskip(
    "stable_baselines3", reason="extra learning (stable-baselines3) is not installed"
)
from cranedyn.bridges.gymnasium import TowerCraneVectorEnv  # noqa: E402
from cranedyn.bridges.sb3 import vec_env  # noqa: E402

pytestmark = pytest.mark.slow


def cranes(**rules: str) -> TowerCraneVectorEnv:
    return TowerCraneVectorEnv(
        4, crane=crane(), autoreset_mode="SameStep", max_episode_steps=5, **rules
    )


def test_episodes_are_those_of_the_cranes_with_features_and_shaped_rewards() -> None:
    env, same = (vec_env(cranes(), features=lambda o: 2.0 * o, shaping=lambda r: r + 1.0), cranes())
    env.seed(3)
    first, _ = same.reset(seed=3)
    assert (env.reset() == 2.0 * first).all()
    rng, returns = np.random.default_rng(0), np.zeros(4)
    for k in range(10):
        actions = rng.uniform(-1.0, 1.0, (4, 3))
        observation, reward, _, truncated, info = same.step(actions)
        returns += reward
        inputs, shaped, ended, infos = env.step(actions)
        assert (inputs == 2.0 * observation).all() and (ended == truncated).all()
        assert_allclose(shaped, reward + 1.0, rtol=1e-6)  # single precision
        for i in np.flatnonzero(ended):
            assert (infos[i]["terminal_observation"] == 2.0 * info["final_obs"][i]).all()
            assert infos[i]["TimeLimit.truncated"]
        if k == 4:
            assert_allclose(env.finished, returns, rtol=1e-12)
