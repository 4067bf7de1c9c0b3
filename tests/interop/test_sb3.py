"""Cranes for Stable-Baselines3: the same episodes."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.errors import CraneError
from tests.helpers import crane

sb3 = pytest.importorskip(
    "stable_baselines3", reason="extra learning (stable-baselines3) is not installed"
)
from cranedyn.interop.gymnasium import TowerCraneVectorEnv  # noqa: E402
from cranedyn.interop.sb3 import vec_env  # noqa: E402

pytestmark = pytest.mark.slow


def cranes(mode: str) -> TowerCraneVectorEnv:
    return TowerCraneVectorEnv(4, crane=crane(), autoreset_mode=mode, max_episode_steps=5)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep", "Disabled"])
def test_episodes_are_those_of_the_cranes_with_features_and_shaped_rewards(mode: str) -> None:
    env = vec_env(cranes(mode), features=lambda o: 2.0 * o, shaping=lambda r: r + 1.0)
    same = cranes("SameStep")
    env.seed(3)
    first, _ = same.reset(seed=3)
    assert (env.reset() == 2.0 * first).all()
    rng = np.random.default_rng(0)
    returns = np.zeros(4)
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
            assert infos[i]["is_success"] == info["final_info"]["is_success"][i]
        if k == 4:
            assert_allclose(env.finished, returns, rtol=1e-12)


def test_a_seed_holds_for_one_reset_which_drops_the_returns_of_unfinished_episodes() -> None:
    env = vec_env(cranes("SameStep"))
    env.seed(3)
    seeded = env.reset()
    env.step(np.zeros((4, 3), np.float32))
    drawn = env.reset()
    assert not np.array_equal(drawn, seeded)
    rewards = np.zeros(4)
    for _ in range(5):
        rewards += env.step(np.zeros((4, 3), np.float32))[1]
    assert_allclose(env.finished, rewards, rtol=1e-6)  # single precision


def test_attributes_are_returned_for_the_cranes_that_are_asked_for() -> None:
    env = vec_env(cranes("SameStep"))
    assert env.get_attr("num_envs", [0, 2]) == [4, 4] and len(env.get_attr("num_envs")) == 4
    assert env.env_is_wrapped(gym.Wrapper, 1) == [False]


@pytest.mark.parametrize("name", ["cranedyn/TowerCrane-v0", "cranedyn/Crane-v0"])
def test_the_cranes_of_the_how_to_are_taken_beyond_the_end_of_an_episode(name: str) -> None:
    env = vec_env(gym.make_vec(name, num_envs=2, max_episode_steps=5))
    env.reset()
    ended = [env.step(np.zeros((2, 3), np.float32))[2].any() for _ in range(12)]
    assert ended == [k % 5 == 4 for k in range(12)]


def test_other_environments_are_refused_at_construction() -> None:
    with pytest.raises(CraneError, match="vec_env adapts a CraneVectorEnv, and this is Sync"):
        vec_env(gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync"))
