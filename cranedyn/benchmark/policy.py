"""Trained policies of the benchmark: small networks as files of arrays, which hold no code.

A policy was trained in `cranedyn.interop.gymnasium` on the crane of a task, with starts and goals
drawn over the ranges of its drives, by ``examples/bridges/train_benchmark_policy.py``. Its file is
a NumPy archive of plain numbers, read without unpickling anything.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.data.files import atomic_write
from cranedyn.errors import DataError, OutOfRange

FOLDER = Path(__file__).resolve().parent / "policies"
"""Folder of the policies of this package."""

ACTIVATIONS = ("tanh", "relu")
"""What follows each layer but the last."""

OUTPUTS = ("clip", "tanh")
"""What brings the results of the last layer to -1 to 1."""


@dataclass(frozen=True, eq=False)
class Scales:
    """How measured quantities of a crane with m drives are scaled to about -1 to 1.

    Attributes:
        reach: Distance of a drive to its goal that counts as 1 [rad or m], shape (m,).
        middle: Position of a drive that counts as 0 [rad or m], shape (m,).
        half_range: Distance from there that counts as 1 [rad or m], shape (m,).
        rate: Rate of a drive that counts as 1 [rad/s or m/s], shape (m,).
        swing: Swing that counts as 1 [rad], shape (1,).
        swing_rate: Rate of a swing that counts as 1 [rad/s], shape (1,).
    """

    reach: np.ndarray
    middle: np.ndarray
    half_range: np.ndarray
    rate: np.ndarray
    swing: np.ndarray
    swing_rate: np.ndarray


@dataclass(frozen=True, eq=False)
class Policy:
    """A network from what is measured to shares of the largest rates of the drives.

    Attributes:
        algorithm: What trained it, such as "PPO".
        task: Task on whose crane it was trained, such as "inteco/move".
        period: Time from one action to the next [s].
        activation: One of `ACTIVATIONS`.
        output: One of `OUTPUTS`.
        scales: Scales of its inputs.
        weights: Matrices of the layers, shape (inputs, outputs) each.
        biases: Their biases, shape (outputs,) each.
    """

    algorithm: str
    task: str
    period: float
    activation: str
    output: str
    scales: Scales
    weights: Sequence[np.ndarray]
    biases: Sequence[np.ndarray]

    def action(
        self,
        to_go: np.ndarray,
        position: np.ndarray,
        rate: np.ndarray,
        swing: np.ndarray,
        swing_rate: np.ndarray,
    ) -> np.ndarray:
        """Return shares of the largest rates from -1 to 1, shape (m,).

        Args:
            to_go: Distances of the drives to their goals [rad or m], shape (m,).
            position: Their positions [rad or m], shape (m,).
            rate: Their rates [rad/s or m/s], shape (m,).
            swing: Swing angles from rest [rad], shape (s,).
            swing_rate: Their rates [rad/s], shape (s,).
        """
        scales = self.scales
        observation = np.concatenate(
            [
                to_go / scales.reach,
                (position - scales.middle) / scales.half_range,
                rate / scales.rate,
                swing / scales.swing,
                swing_rate / scales.swing_rate,
            ]
        )
        return self.of_observation(observation[None], len(to_go))[0]

    def of_observation(self, observation: np.ndarray, drives: int) -> np.ndarray:
        """Return actions for observations of `cranedyn.interop.load_view.LoadView`, shape (n, m).

        Args:
            observation: Observations, shape (n, observed).
            drives: Number of drives, m.
        """
        values = network_inputs(observation, drives)
        last = len(self.weights) - 1
        for i, (matrix, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ matrix + bias
            if i < last:
                values = np.tanh(values) if self.activation == "tanh" else np.maximum(values, 0.0)
        return np.tanh(values) if self.output == "tanh" else np.clip(values, -1.0, 1.0)

    def write(self, file: Path) -> None:
        """Write the policy, whole or not at all."""
        about = {
            "algorithm": self.algorithm,
            "task": self.task,
            "period": self.period,
            "activation": self.activation,
            "output": self.output,
        }
        arrays = dict(vars(self.scales))
        for i, (matrix, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays[f"weight_{i}"] = matrix.astype(np.float32)
            arrays[f"bias_{i}"] = bias.astype(np.float32)
        # Text as bytes: an array of characters is plain numbers, too.
        text = np.frombuffer(json.dumps(about, sort_keys=True).encode(), dtype=np.uint8)
        with atomic_write(file) as draft, draft.open("wb") as stream:
            np.savez(stream, about=text, **arrays)


def network_inputs(observation: np.ndarray, drives: int) -> np.ndarray:
    """Return observations as inputs of a network, shape (n, observed + m + swings): distances and
    swings also as cube roots, which tell small values apart.

    Args:
        observation: Observations of `cranedyn.interop.load_view.LoadView`, shape (n, observed).
        drives: Number of drives, m.
    """
    swings = (observation.shape[1] - 3 * drives) // 2
    small = [
        np.cbrt(observation[:, :drives]),
        np.cbrt(observation[:, 3 * drives : 3 * drives + swings]),
    ]
    return np.hstack([observation, *small])


def read_policy(file: Path) -> Policy:
    """Read a policy from its file; nothing in it is run.

    Raises:
        DataError: If it cannot be read, or is no policy.
    """
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        about = json.loads(arrays.pop("about").tobytes().decode())
        return _checked(about, arrays)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        EOFError,
        zipfile.BadZipFile,
        OutOfRange,
    ) as error:
        raise DataError(f"{file} is no policy of the benchmark: {error}.") from error


def _checked(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Policy:
    """Return a policy from what its file holds.

    Raises:
        OutOfRange: If a word is none that is known, or arrays do not fit together.
    """
    for name, allowed in (("activation", ACTIVATIONS), ("output", OUTPUTS)):
        if about[name] not in allowed:
            raise OutOfRange(name, about[name], " or ".join(allowed))
    drives = len(arrays["reach"])
    scales = {}
    for name in Scales.__annotations__:
        size = 1 if name.startswith("swing") else drives
        scales[name] = finite(name, arrays[name], (size,))
    weights: list[np.ndarray] = []
    biases: list[np.ndarray] = []
    while f"weight_{len(weights)}" in arrays:
        matrix = arrays[f"weight_{len(weights)}"]
        bias = arrays[f"bias_{len(weights)}"]
        if weights and matrix.shape[0] != weights[-1].shape[1]:
            raise OutOfRange("layers", matrix.shape, "matrices that follow one another")
        weights.append(finite("a matrix", matrix, matrix.shape))
        biases.append(finite("a bias", bias, (matrix.shape[1],)))
    if not weights or weights[-1].shape[1] != drives:
        raise OutOfRange("layers", len(weights), f"layers whose last has {drives} outputs")
    return Policy(
        algorithm=str(about["algorithm"]),
        task=str(about["task"]),
        period=number("period of a policy", about["period"], "s", "> 0"),
        activation=about["activation"],
        output=about["output"],
        scales=Scales(**scales),
        weights=weights,
        biases=biases,
    )
