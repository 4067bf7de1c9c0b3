"""Learn to bring the load of an overhead crane to its place, without a library for learning.

``python examples/bridges/learn_overhead_crane.py --out FOLDER`` takes about a minute of one
processor. It needs ``pip install 'cranedyn[gymnasium]'``. ``--urdf FILE`` or ``--machine NAME``
learns on another crane.

The policy is a matrix, of which augmented random search improves the return: Mania, Guy & Recht,
Simple random search of static linear policies is competitive for reinforcement learning, NeurIPS
2018. In each iteration it tries random changes of the matrix in pairs, M + D and M - D, on cranes
of their own, and moves the matrix along the changes of the best pairs, each in proportion to the
difference of the two returns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from cranedyn.interop.gymnasium import ID
from cranedyn.interop.task import OVERHEAD
from cranedyn.model.load import load_crane

STEPS = 400
"""Steps of an episode, of 0.1 s each."""

DIRECTIONS = 16
"""Pairs of changes that an iteration tries."""

BEST_DIRECTIONS = 8
"""Pairs that move the matrix, those of the largest returns."""

EPISODES = 16
"""Episodes over which the return of a matrix is averaged."""

CHANGE = 0.2
"""Standard deviation of a change of an element in the first iteration. Observations are of the size
of 1, and so are actions."""

LAST_CHANGE_SHARE = 0.1
"""Standard deviation in the last iterations, as a share of that in the first."""

STEP_SIZE = 0.2
"""Step size in the first iteration; it falls to zero in the last one."""

LOST_REWARD = -0.4
"""Reward that each step counts after an episode has ended badly, as if the load were 100 m from its
place: otherwise a short episode would be better than a slow one."""

TEST_EPISODES = 1000
"""Number of episodes in which a policy is tested."""

Policy = Callable[[np.ndarray], np.ndarray]
"""Function from observations, a row for each crane, to actions."""


class Score(NamedTuple):
    """Results of many episodes.

    Attributes:
        mean_return: Mean sum of rewards.
        solved: Share of episodes whose load is within 5 cm of its place at the end.
        distance: Median distance from there [m].
    """

    mean_return: float
    solved: float
    distance: float


class Learned(NamedTuple):
    """Results of the example.

    Attributes:
        matrix: The policy, shape (actions, features).
        scores: Score by the name of the policy.
    """

    matrix: np.ndarray
    scores: dict[str, Score]


def features(observation: np.ndarray) -> np.ndarray:
    """Return observations and their cube roots, which tell small distances and swings apart."""
    return np.hstack([observation, np.cbrt(observation)])


def run_episodes(cranes: Any, policy: Policy) -> tuple[np.ndarray, dict[str, Any]]:
    """Run an episode of each crane; return the sums of rewards, shape (n,), and the last infos."""
    observation, infos = cranes.reset()
    returns = np.zeros(cranes.num_envs)
    ended = np.zeros(cranes.num_envs, dtype=bool)
    for _ in range(STEPS):
        observation, reward, terminated, _, infos = cranes.step(policy(observation))
        returns += np.where(ended, LOST_REWARD, reward)
        ended |= terminated
    return returns, infos | {"ended": ended}


def score_policy(cranes: Any, policy: Policy) -> Score:
    """Return the score of a policy in episodes that are the same for every policy."""
    cranes.reset(seed=2026)
    returns, infos = run_episodes(cranes, policy)
    solved = infos["is_success"] & ~infos["ended"]
    return Score(returns.mean(), solved.mean(), float(np.median(infos["distance"])))


def linear_policy(matrices: np.ndarray) -> Policy:
    """Return the policy of one matrix, shape (actions, features), or of one for each crane."""

    def policy(observation: np.ndarray) -> np.ndarray:
        action = matrices @ features(observation)[:, :, None]
        return np.clip(action[:, :, 0], -1.0, 1.0)

    return policy


def learn(crane: Any, iterations: int, seed: int) -> np.ndarray:
    """Return the matrix of a policy by augmented random search."""
    cranes = gym.make_vec(ID, num_envs=2 * DIRECTIONS * EPISODES, crane=crane)
    observation, _ = cranes.reset(seed=seed)
    rng = np.random.default_rng(seed)
    matrix = np.zeros((crane.layout.m, features(observation).shape[1]))
    began = time.process_time()
    for iteration in range(iterations):
        left = 1.0 - iteration / iterations
        change = CHANGE * max(left, LAST_CHANGE_SHARE)
        directions = rng.standard_normal((DIRECTIONS, *matrix.shape))
        tried = np.concatenate([matrix + change * directions, matrix - change * directions])
        returns, _ = run_episodes(cranes, linear_policy(np.repeat(tried, EPISODES, axis=0)))
        plus, minus = returns.reshape(2, DIRECTIONS, EPISODES).mean(axis=2)
        best = np.argsort(np.maximum(plus, minus))[-BEST_DIRECTIONS:]
        spread = np.concatenate([plus[best], minus[best]]).std()
        slope = np.tensordot(plus[best] - minus[best], directions[best], 1) / BEST_DIRECTIONS
        matrix = matrix + STEP_SIZE * left / spread * slope
        if (iteration + 1) % 50 == 0:
            seconds = time.process_time() - began
            print(f"{iteration + 1:4} iterations {seconds:4.0f} s  return {returns.mean():7.1f}")
    return matrix


def main(arguments: Sequence[str] | None = None) -> Learned:
    """Learn, and test the policy beside drives that stand still and a random policy."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--urdf", type=Path, help="the crane (default: the overhead crane)")
    parser.add_argument("--machine", help="a real crane instead, by its name")
    parser.add_argument(
        "--out", type=Path, default=Path("out/overhead"), help="folder for the policy"
    )
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.machine:
        crane = load_crane(machine=options.machine)
    else:
        crane = load_crane(options.urdf or OVERHEAD)

    matrix = learn(crane, options.iterations, options.seed)
    np.savetxt(options.out / "policy.csv", matrix, delimiter=",")
    tested = gym.make_vec(ID, num_envs=TEST_EPISODES, crane=crane)
    rng = np.random.default_rng(options.seed)
    policies: dict[str, Policy] = {
        "standing still": lambda observation: np.zeros((TEST_EPISODES, crane.layout.m)),
        "random": lambda observation: rng.uniform(-1.0, 1.0, (TEST_EPISODES, crane.layout.m)),
        "learned": linear_policy(matrix),
    }
    scores = {}
    print("policy           return   within 5 cm at the end   median distance [m]")
    for name, policy in policies.items():
        score = score_policy(tested, policy)
        scores[name] = score
        print(
            f"{name:14} {score.mean_return:8.1f} {100.0 * score.solved:22.1f} % "
            f"{score.distance:20.3f}"
        )
    return Learned(matrix, scores)


if __name__ == "__main__":
    main()
