"""Entries that are files of Stable-Baselines3, as `model.save` writes them.

Such a file is unpickled, which can run any code in it. So the command line asks for consent, and
the file is opened in the limited process of the entry only. What the policy observes and does is
that of `cranedyn.benchmark.entries.observation`; it acts deterministically.
"""

from __future__ import annotations

import json
import zipfile
from typing import Any

import numpy as np

from cranedyn.benchmark.entries.observation import Observer, check_sizes
from cranedyn.benchmark.entry import Briefing, Entry, Opened
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError, format_error, quoted

try:
    import stable_baselines3
    import torch
    from gymnasium.spaces import Box
except ModuleNotFoundError as error:
    raise CraneError(
        "Policies of Stable-Baselines3 need it and PyTorch, which are not installed: pip install "
        "torch 'cranedyn[learning]'."
    ) from error

_ALGORITHMS = (("sac", "SAC"), ("td3", "TD3"))
"""Algorithms by the part of their policies' module that tells them; DDPG is a kind of TD3."""


def open_source(source: str) -> Opened:
    """Load a policy; the file is unpickled.

    Raises:
        DataError: If it cannot be loaded, or its observations or actions are no vectors.
    """
    torch.set_num_threads(1)
    algorithm = getattr(stable_baselines3, _algorithm(source))
    try:
        model = algorithm.load(source, device="cpu")
    except Exception as error:  # other people's pickles
        raise DataError(
            f"{source} is no file of Stable-Baselines3: {format_error(error)}"
        ) from error
    for what, space in (
        ("observations", model.observation_space),
        ("actions", model.action_space),
    ):
        if not isinstance(space, Box) or len(space.shape) != 1:
            raise DataError(f"The {what} of {source} are {space}; needed is a Box of vectors.")

    def make(briefing: Briefing) -> Entry:
        observer = Observer(briefing)
        inputs = model.observation_space.shape[0]
        check_sizes(source, observer, inputs, model.action_space.shape[0])

        def rates(reading: SensorReading) -> np.ndarray:
            action, _ = model.predict(observer.observe(reading), deterministic=True)
            return observer.rates(action)

        return rates

    return make


def _algorithm(source: str) -> str:
    """Return the name of the algorithm of a file: the file does not state it, but the module of its
    policy and, for PPO and A2C, which share theirs, its settings.

    Raises:
        DataError: If it is no file of Stable-Baselines3, or of another algorithm.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            settings: dict[str, Any] = json.loads(archive.read("data"))
        module = str(settings["policy_class"]["__module__"])
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{source} is no file of Stable-Baselines3: {format_error(error)}"
        ) from error
    for part, name in _ALGORITHMS:
        if f".{part}." in module:
            return name
    if module == "stable_baselines3.common.policies":
        return "PPO" if "clip_range" in settings else "A2C"
    raise DataError(
        f"The policy of {source} is of {quoted(module)}; allowed are those of PPO, A2C, SAC, TD3 "
        "and DDPG in Stable-Baselines3."
    )
