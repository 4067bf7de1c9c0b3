"""Learn to move a load without swing: PPO of Stable-Baselines3 on compiled cranes, then its place
beside the strategies of `compare`.

``python examples/bridges/learn_to_stop_the_swing.py --steps 3000000 --out FOLDER`` takes minutes on
two cores. It needs ``pip install torch 'cranedyn[learning]'``; torch by itself first, so that you
choose the build: the one for the processor will do.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.interop.gymnasium import TowerCraneVectorEnv
from cranedyn.interop.sb3 import vec_env
from cranedyn.interop.task import Rules
from cranedyn.interop.tower_task import TowerSwingTask
from cranedyn.references import hold
from experiments.harness import Setup
from experiments.scenarios.moves import (
    MOVES,
    SWINGING,
    MovePlan,
    Score,
)
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import (
    STRATEGIES,
)

SCALE = np.array([1.0, 0.1, 0.1, 10.0, 1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 0.05, 0.05], dtype=np.float32)
"""Brings what is observed to numbers of about one."""

REWARD_OFFSET = 0.3
"""Number that is added to each reward, so that a step far from the goal gives about 0."""

REWARD_FACTOR = 3.0
"""Factor by which the sum is multiplied."""

MIN_REWARD = -10.0
"""Least reward, for a run that ends by too much swing."""

BESIDE = ("spline alone", "spline + PD", "flat + LQR", "operator")
"""Strategies of `compare` that are shown beside what was learned."""


def network_inputs(observation: np.ndarray) -> np.ndarray:
    """Return observations as inputs of the network, shape (n, 19): distances and swings also as
    cube roots, which tell small values apart.
    """
    return np.hstack(
        [observation * SCALE, np.cbrt(observation[:, :3]), np.cbrt(observation[:, 6:10])]
    )


def shaped(reward: np.ndarray) -> np.ndarray:
    """Return rewards from which PPO learns sooner."""
    return np.maximum(REWARD_FACTOR * (reward + REWARD_OFFSET), MIN_REWARD)


class LearningCurve(BaseCallback):
    """Keeps the learning curve: steps, seconds and the mean return of the episodes that have ended
    since.
    """

    def __init__(self, envs: VecEnv) -> None:
        super().__init__()
        self.many = envs
        self.rows = list[tuple[int, float, float]]()
        self.began = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.many.finished:
            self.rows.append(
                (
                    self.num_timesteps,
                    time.perf_counter() - self.began,
                    float(np.mean(self.many.finished)),
                )
            )
            self.many.finished.clear()
            print("{:>9} steps {:6.0f} s  return {:8.2f}".format(*self.rows[-1]), flush=True)


class Learned(NamedTuple):
    """What came of it."""

    curve: np.ndarray
    scores: dict[str, Score]


def learned_controller(model: PPO, task: TowerSwingTask, goal: np.ndarray) -> Controller:
    """Return the learned policy as a controller that commands accelerations every 0.1 s."""
    memory: dict[str, Any] = {"from": -np.inf, "command": np.zeros(3)}

    def controller(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        if t - memory["from"] > task.fleet.control_period - 1e-6:
            z = np.concatenate(state)[:, None]
            action, _ = model.predict(
                network_inputs(task.observation(z, goal[:, None])), deterministic=True
            )
            memory.update({"from": t, "command": task.commands(action.T.astype(float), z)[:, 0]})
        return memory["command"]

    return controller


def main(arguments: Sequence[str] | None = None) -> Learned:
    """Learn, draw the curve, and make the moves of `compare`."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=3_000_000, help="steps of the environment to learn from"
    )
    parser.add_argument("--cranes", type=int, default=256, help="cranes at once")
    parser.add_argument(
        "--beside",
        nargs="*",
        default=BESIDE,
        metavar="STRATEGY",
        help="strategies of compare to show beside it",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("out/learned"), help="folder for model, curve and figure"
    )
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small gain nothing from more

    cranes = TowerCraneVectorEnv(options.cranes, autoreset_mode="SameStep", max_episode_steps=300)
    env = vec_env(cranes, features=network_inputs, shaping=shaped)
    env.seed(options.seed)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=options.cranes * 8,
        n_epochs=8,
        learning_rate=lambda left: 1e-3 * left + 1e-5,
        gamma=0.985,
        ent_coef=0.0,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        seed=options.seed,
        device="cpu",
    )
    curve = LearningCurve(env)
    model.learn(options.steps, callback=curve)
    model.save(options.out / "model")
    rows = np.array(curve.rows).reshape(-1, 3)
    np.savetxt(
        options.out / "curve.csv",
        rows,
        delimiter=",",
        header="steps,seconds,mean_return",
        comments="",
    )
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(1e-6 * rows[:, 0], rows[:, 2])
    axes.set(
        xlabel="steps of the environment [million]",
        ylabel="mean return of an episode",
        title="PPO on the tower crane",
    )
    figure.savefig(options.out / "curve.png", dpi=110)
    plt.close(figure)
    return Learned(rows, compare_learned(model, options.beside))


def compare_learned(model: PPO, beside: Sequence[str]) -> dict[str, Score]:
    """Score the learned controller beside strategies of `compare`, for the combined move."""
    setup = Setup(engine="compiled")
    move = MOVES[-1]
    task = TowerSwingTask(setup.crane, 1, Rules(), 0.1, setup.dt, 1)
    plans = {name: STRATEGIES[name](setup, move) for name in beside}
    plans["learned"] = MovePlan(
        lambda: learned_controller(model, task, np.array(move.goal)),
        hold(setup.crane, move.ends(setup.crane)[1]),
        "motion",
        move.duration,
    )
    scores = {name: make(setup, move, plan)[1] for name, plan in plans.items()}
    scores["learned, swinging start"] = make(setup, SWINGING, plans["learned"])[1]
    print(
        "strategy                  peak [mrad]  at arrival [mrad]  20 s later [mrad]  settled [s]"
    )
    for name, score in scores.items():
        print(
            f"{name:24} {1e3 * score.peak:12.1f} {1e3 * score.arrival:18.3g} "
            f"{1e3 * score.later:18.3g} {score.settled:12.2f}"
        )
    return scores


if __name__ == "__main__":
    main()
