"""Train a policy for a task of the benchmark: PPO or SAC of Stable-Baselines3 on compiled cranes.

``python examples/bridges/train_benchmark_policy.py ppo inteco/move --minutes 12 --out FILE.npz``
trains on the crane of the task, with random starts and goals, and writes the network as plain
numbers. It needs ``pip install torch 'cranedyn[learning]'``.
"""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from cranedyn.benchmark.policy import Policy, Scales, network_inputs
from cranedyn.benchmark.task import CraneTask, select_tasks
from cranedyn.interop.gymnasium import CraneVectorEnv
from cranedyn.interop.sb3 import vec_env
from cranedyn.interop.task import PENALTY


class Recipe(NamedTuple):
    """How to train for a task.

    Attributes:
        period: Time from one action to the next [s]. The delays of drives and sensors together are
            at most one of them, so that the policy meets in training the delay that it meets in the
            benchmark.
        swing_share: Swing that ends an episode, as a share of the bound of the task. Where quick
            drives swing the load to the bound at once, a policy learns little but to end its
            episodes; beyond the bound it learns to bring the swing back.
        exploration: Logarithm of the standard deviation of the first actions of PPO. The quicker
            the drives, the smaller they are to be.
    """

    period: float
    swing_share: float
    exploration: float


RECIPES = {
    "inteco/move": Recipe(0.04, 0.85, -1.0),
    "gantry/move": Recipe(0.04, 2.0, -2.5),
    "overhead/move": Recipe(0.1, 0.85, -1.0),
}
"""How to train, by the name of the task."""

REACH_FACTOR = 1.5
"""Farthest goals in training over the distances of the task."""

STANDING_REACH = 0.2
"""Farthest goals in training of a drive that stands in the task, over its range: so it learns to
come back to where it shall stand."""

REWARD_RESOLUTION = 0.2
"""Distance below which coming closer is hardly rewarded, over the tolerance of the task."""

DISCOUNT_ANGLE = 6.0
"""Phase of the swing in which rewards to come count less by the factor e [rad]: about a period."""


class Clock(BaseCallback):
    """Ends the training after some seconds of the processor, and prints the mean return."""

    def __init__(self, envs: VecEnv, seconds: float) -> None:
        super().__init__()
        self._envs = envs
        self._seconds = seconds
        self._began = time.process_time()
        self._printed = 0

    def _on_step(self) -> bool:
        spent = time.process_time() - self._began
        if spent > self._printed * 30.0 and self._envs.finished:
            mean = float(np.mean(self._envs.finished[-500:]))
            print(f"{self.num_timesteps:>9} steps {spent:6.0f} s  return {mean:8.2f}", flush=True)
            self._printed += 1
        return spent < self._seconds


def cranes(task: CraneTask, count: int) -> CraneVectorEnv:
    """Return cranes of a task with random starts and goals."""
    goal = task.goal_state()
    assert goal is not None
    crane = task.crane()
    drives = crane.layout.drives
    travel = np.abs(goal.q[drives] - task.start_state().q[drives])
    ranges = (crane.upper - crane.lower)[drives]
    reach = np.where(travel > 0.0, REACH_FACTOR * travel, STANDING_REACH * ranges)
    recipe = RECIPES[task.name]
    return CraneVectorEnv(
        count,
        crane=crane,
        control_period=recipe.period,
        dt=0.01,
        converters=task.converters(),
        reach=reach.tolist(),
        swing=0.4 * task.swing_bound,
        swing_limit=recipe.swing_share * task.swing_bound,
        tolerance=task.tolerance,
        max_episode_steps=round(0.8 * task.duration / recipe.period),
        autoreset_mode="SameStep",
        threads=1,
    )


def main(arguments: Sequence[str] | None = None) -> Policy:
    """Train, write the policy, and return it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("algorithm", choices=["ppo", "sac"])
    parser.add_argument("task", choices=[*RECIPES])
    parser.add_argument("--minutes", type=float, default=12.0, help="processor time to train for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("policy.npz"), metavar="FILE.npz")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)  # networks this small gain nothing from more

    (task,) = select_tasks([options.task])
    recipe = RECIPES[task.name]
    period = recipe.period
    drives = task.crane().layout.m
    scale = REWARD_RESOLUTION * task.tolerance

    def shaped(reward: np.ndarray) -> np.ndarray:
        """Return rewards whose last decade ends at a share of the tolerance instead of at 1 cm."""
        distance = 0.01 * (10.0 ** (-np.maximum(reward, -3.0) / period) - 1.0)
        better = 1.0 - 0.5 * np.log10(1.0 + distance / scale)
        return np.where(reward == PENALTY, -10.0, better)

    many = cranes(task, 128 if options.algorithm == "ppo" else 16)
    env = vec_env(many, features=lambda seen: network_inputs(seen, drives), shaping=shaped)
    env.seed(options.seed)
    frequency = np.sqrt(9.81 / task.start_state().q[task.crane().layout.drives[-1]])
    discount = float(np.exp(-period / (DISCOUNT_ANGLE / frequency)))
    model = _learner(options.algorithm, env, discount, recipe.exploration, options.seed)
    # A shell starts programs in the background without this.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        model.learn(10**9, callback=Clock(env, 60.0 * options.minutes))
    except KeyboardInterrupt:
        print("interrupted; what was learned so far is kept")
    policy = exported(model, options.algorithm, task, many)
    policy.write(options.out)
    print(f"{model.num_timesteps} steps; written to {options.out}.")
    return policy


def _learner(algorithm: str, env: Any, discount: float, exploration: float, seed: int) -> Any:
    """Return what learns, untrained."""
    if algorithm == "ppo":
        return PPO(
            "MlpPolicy",
            env,
            n_steps=128,
            batch_size=2048,
            n_epochs=8,
            learning_rate=5e-4,
            target_kl=0.03,
            gamma=discount,
            ent_coef=0.0,
            policy_kwargs={"net_arch": [64, 64], "log_std_init": exploration},
            seed=seed,
            device="cpu",
        )
    return SAC(
        "MlpPolicy",
        env,
        buffer_size=400_000,
        batch_size=256,
        learning_starts=5_000,
        train_freq=1,
        gradient_steps=4,
        learning_rate=7e-4,
        gamma=discount,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )


def exported(model: Any, algorithm: str, task: CraneTask, many: CraneVectorEnv) -> Policy:
    """Return the network of a trained model as plain arrays."""
    if algorithm == "ppo":
        body = model.policy.mlp_extractor.policy_net
        last = model.policy.action_net
    else:
        body = model.policy.actor.latent_pi
        last = model.policy.actor.mu
    layers = [layer for layer in (*body, last) if isinstance(layer, torch.nn.Linear)]
    own = many.task.view.scales
    return Policy(
        algorithm=algorithm.upper(),
        task=task.name,
        period=RECIPES[task.name].period,
        activation="tanh" if algorithm == "ppo" else "relu",
        output="clip" if algorithm == "ppo" else "tanh",
        scales=Scales(
            reach=np.array(own.reach),
            middle=np.array(own.middle),
            half_range=np.array(own.half_range),
            rate=np.array(own.rate),
            swing=np.array([own.swing]),
            swing_rate=np.array([own.swing_rate]),
        ),
        weights=[layer.weight.detach().numpy().T.copy() for layer in layers],
        biases=[layer.bias.detach().numpy().copy() for layer in layers],
    )


if __name__ == "__main__":
    main()
