"""Short tasks and entries for the tests of the benchmark."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.benchmark.entry import Briefing, Entry, Opened, briefing_of
from cranedyn.benchmark.entry_kinds import open_entry
from cranedyn.benchmark.entry_process import EntryLimits
from cranedyn.benchmark.entry_source import EntrySource
from cranedyn.benchmark.evaluate import InstanceResult
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.benchmark.task import CraneTask, Instance, instances, read_tasks
from tests.helpers import ROOT

TOY = Path(__file__).with_name("toy.toml")

PAGE = (ROOT / "docs/benchmark.md").read_text(encoding="utf-8")


def toy(kind: str) -> CraneTask:
    """The short task of a kind."""
    return next(task for task in read_tasks(TOY) if task.kind == kind)


def toy_instance(kind: str, **values: float) -> Instance:
    """The nominal instance of the short task of a kind, with values that differ."""
    nominal = instances(toy(kind))[0]
    return Instance(
        task=nominal.task,
        index=1,
        seeds=nominal.seeds,
        values={**nominal.values, **values},
        swing_signs=(1.0, 1.0),
        noise_seed=0,
    )


def towards_goal(briefing: Briefing) -> Entry:
    """Drives that go to their goal, or do as the operator says."""
    if briefing.goal is None:
        return lambda reading: reading.operator
    goal = briefing.goal.q[briefing.crane.layout.drives]
    return lambda reading: 2.0 * (goal - reading.position)


def still(briefing: Briefing) -> Entry:
    """Drives that stand still."""
    return lambda reading: np.zeros_like(reading.position)


def from_page(language: str, word: str) -> str:
    """The code of the page in a language that has a word."""
    blocks = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    (found,) = [block for block in blocks if word in block]
    return str(found)


def page_controller() -> Any:
    """The controller in Python of the page."""
    names: dict[str, Any] = {}
    exec(from_page("python", "def controller"), names)
    return names["controller"]


class InThisProcess:
    """An entry in this process, in the place of an `EntryProcess`; it keeps what it was given."""

    def __init__(self, opened: Opened) -> None:
        self._opened = opened
        self.files: dict[str, str] = {}
        self.changed: set[str] = set()
        self.briefing: Briefing | None = None
        self.readings: list[SensorReading] = []

    def begin(self, task: CraneTask) -> None:
        """Tell the entry what it is told."""
        self.briefing = briefing_of(task)
        self._entry = self._opened(self.briefing)

    def command(self, reading: SensorReading) -> tuple[np.ndarray, float]:
        """Return the command, and one microsecond."""
        self.readings.append(reading)
        return np.asarray(self._entry(reading), dtype=float), 1e-6

    def end_instance(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def opened_here(source: EntrySource, limits: EntryLimits) -> InThisProcess:
    """An entry from its file in this process, for tests that are not about processes."""
    return InThisProcess(open_entry(source.source))


def result_of(task: str, index: int, **values: Any) -> InstanceResult:
    """A result of an instance that passed unless the values say otherwise."""
    metrics = {"settled_s": 2.0, "swing_rad": 0.1, "work_J": 5.0, "rms_error_m": 0.01}
    metrics |= {name: values.pop(name) for name in list(values) if name in metrics}
    arguments: dict[str, Any] = {"status": "passed", "metrics": metrics, "command_us": (10.0, 20.0)}
    return InstanceResult(task, index, **{**arguments, **values})
