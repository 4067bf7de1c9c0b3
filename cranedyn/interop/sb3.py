"""Many cranes as a vectorised environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from cranedyn.errors import CraneError, quoted
from cranedyn.interop.gymnasium import CraneVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise CraneError(
        "This bridge needs Stable-Baselines3, which is not installed: pip install torch "
        "'cranedyn[learning]'."
    ) from error

Change = Callable[[np.ndarray], np.ndarray]
"""Function that maps observations or rewards of all cranes to others."""


class _CraneVecEnv(VecEnv):
    """Cranes as Stable-Baselines3 asks for them, see `vec_env`.

    Attributes:
        env: The cranes.
        returns: Sum of the rewards of each present episode so far, shape (num_envs,).
        finished: Sums of the rewards of the episodes that have ended, in their order.
    """

    def __init__(self, env: CraneVectorEnv, features: Change, shaping: Change) -> None:
        self.env = env
        self._features = features
        self._shaping = shaping
        self.returns = np.zeros(env.num_envs)
        self.finished = list[float]()
        observation = np.zeros((1, len(env.task.observed)))
        width = features(observation).shape[1]
        inputs = gym.spaces.Box(-np.inf, np.inf, (width,), np.float32)
        super().__init__(env.num_envs, inputs, env.single_action_space)

    def _inputs(self, observation: np.ndarray) -> np.ndarray:
        """Return the inputs of the network for observations, shape (n, width)."""
        return self._features(observation).astype(np.float32)

    def reset(self) -> np.ndarray:
        """Begin episodes of all cranes, and return the inputs of the network."""
        # One seed is for all cranes. It holds for one reset, by the rules of Stable-Baselines3.
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        # Episodes that were not finished do not count.
        self.returns = np.zeros(self.num_envs)
        return self._inputs(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step, and return inputs, shaped rewards, which episodes ended, and infos."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in reward]
        self.returns += reward
        ended = terminated | truncated
        final = observation
        solved = info["is_success"]
        if ended.any():
            # Stable-Baselines3 wants the next episode to begin in the step that ends one.
            if self.env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
                final = info["final_obs"]
                solved = info["final_info"]["is_success"]
            else:
                fresh, _ = self.env.reset(options={"reset_mask": ended})
                observation = np.where(ended[:, None], fresh, final)
        for i in np.flatnonzero(ended):
            last = self._inputs(final[i : i + 1])[0]
            infos[i] = {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(solved[i]),
            }
            self.finished.append(float(self.returns[i]))
            self.returns[i] = 0.0
        shaped = self._shaping(reward).astype(np.float32)
        return self._inputs(observation), shaped, ended, infos

    def close(self) -> None:
        """Close the cranes."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the cranes, once for each index; all cranes share it."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the cranes; all of them share it."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **named: Any) -> Any:
        """Call a method of all cranes, and return its result once for each index."""
        result = getattr(self.env, method_name)(*args, **named)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each index: cranes have no wrappers."""
        return [False for _ in self._get_indices(indices)]


def vec_env(
    env: CraneVectorEnv, *, features: Change = np.asarray, shaping: Change = np.asarray
) -> Any:
    """Return cranes as the algorithms of Stable-Baselines3 take them, such as PPO.

    The attribute ``finished`` of the result lists the returns of all episodes so far, without
    shaping.

    Args:
        env: The cranes, such as ``gym.make_vec`` makes them, of any ``autoreset_mode``.
        features: Function from observations, shape (n, observed), to the inputs of the network,
            shape (n, k).
        shaping: Function from rewards to those from which the network learns, shape (n,) each.

    Raises:
        CraneError: If these are other environments than `CraneVectorEnv`.
    """
    if not isinstance(env, CraneVectorEnv):
        raise CraneError(
            f"vec_env adapts a CraneVectorEnv, and this is {quoted(type(env).__name__)}; make "
            "the cranes with gymnasium.make_vec without a vectorization_mode and without wrappers."
        )
    return _CraneVecEnv(env, features, shaping)
