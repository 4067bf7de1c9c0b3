"""Settings that all tests share, and a word at the end on how much was tried."""

from __future__ import annotations

import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# As experiments do, before anything imports NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile(
    "cranedyn",
    deadline=None,
    derandomize=True,
    max_examples=25,
    database=None,
    suppress_health_check=[HealthCheck.differing_executors],
)
settings.load_profile("cranedyn")

# Whoever starts the tests in the background has Ctrl-C ignored, in them and in all that they start;
# some of them test Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

_TRIED: Counter[str] = Counter()


@pytest.fixture
def limited() -> Iterator[None]:
    """A minute and no more, for tests that wait for other processes."""

    def over(*_: object) -> None:
        raise TimeoutError("the test has taken a minute")

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, 60.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as quick what is neither slow nor long, before `-m` selects."""
    for item in items:
        if not (item.get_closest_marker("slow") or item.get_closest_marker("long")):
            item.add_marker(pytest.mark.quick)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep how many inputs the fuzzing of this process tried; a worker hands it to the process that
    sums up.
    """
    tried = getattr(sys.modules.get("tests.system.test_fuzz"), "TRIED", {})
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["tried"] = dict(tried)
    else:
        _TRIED.update(tried)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what a worker has tried."""
    _TRIED.update(getattr(node, "workeroutput", {}).get("tried", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many inputs the fuzzing tried, and how they ended."""
    if _TRIED:
        terminalreporter.write_line(
            f"fuzzed {_TRIED.total()}: "
            f"{', '.join(f'{name} {count}' for name, count in sorted(_TRIED.items()))}"
        )
