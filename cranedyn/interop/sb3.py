"""Many cranes as a vectorised environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from cranedyn.errors import CraneError, quoted
from cranedyn.interop.gymnasium import TowerCraneVectorEnv
from cranedyn.interop.task import OBSERVED

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise CraneError(
        "This bridge needs Stable-Baselines3, which is not installed: pip install torch "
        "'cranedyn[learning]'."
    ) from error

Change = Callable[[np.ndarray], np.ndarray]


class _CraneVecEnv(VecEnv):
    """See `vec_env`."""

    def __init__(self, env: TowerCraneVectorEnv, features: Change, shaping: Change) -> None:
        self.env = env
        self._features = features
        self._shaping = shaping
        self.returns = np.zeros(env.num_envs)
        self.finished = list[float]()
        width = features(np.zeros((1, len(OBSERVED)))).shape[1]
        inputs = gym.spaces.Box(-np.inf, np.inf, (width,), np.float32)
        super().__init__(env.num_envs, inputs, env.single_action_space)

    def _inputs(self, observation: np.ndarray) -> np.ndarray:
        return self._features(observation).astype(np.float32)

    def reset(self) -> np.ndarray:
        return self._inputs(self.env.reset(seed=self._seeds[0])[0])

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in reward]
        self.returns += reward
        ended = terminated | truncated
        final = observation
        if ended.any():
            # Stable-Baselines3 wants the next episode to begin in the step that ends one.
            if self.env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
                final = info["final_obs"]
            else:
                fresh, _ = self.env.reset(options={"reset_mask": ended})
                observation = np.where(ended[:, None], fresh, final)
        for i in np.flatnonzero(ended):
            last = self._inputs(final[i : i + 1])[0]
            infos[i] = {"terminal_observation": last, "TimeLimit.truncated": bool(truncated[i])}
            self.finished.append(float(self.returns[i]))
            self.returns[i] = 0.0
        shaped = self._shaping(reward).astype(np.float32)
        return self._inputs(observation), shaped, ended, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **named: Any) -> Any:
        return [getattr(self.env, method_name)(*args, **named)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def vec_env(
    env: TowerCraneVectorEnv, *, features: Change = np.asarray, shaping: Change = np.asarray
) -> Any:
    """Return cranes as PPO and its like take them; `finished` lists the returns of their episodes.

    Args:
        env: The cranes, such as ``gym.make_vec`` makes them, of any ``autoreset_mode``.
        features: From observations, shape (n, 12), to inputs of the network, shape (n, k).
        shaping: From rewards to those that are learned from, shape (n,) each.

    Raises:
        CraneError: If these are other environments than `TowerCraneVectorEnv`.
    """
    if not isinstance(env, TowerCraneVectorEnv):
        raise CraneError(
            f"vec_env adapts a TowerCraneVectorEnv, and this is {quoted(type(env).__name__)}; make "
            "the cranes with gymnasium.make_vec without a vectorization_mode and without wrappers."
        )
    return _CraneVecEnv(env, features, shaping)
