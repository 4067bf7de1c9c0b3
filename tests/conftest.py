"""Settings that all tests share."""

from __future__ import annotations

import gc
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests import objects

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


def pytest_configure(config: pytest.Config) -> None:
    """Let all processes of the run share compiled code, see `tests.objects`."""
    if objects.FOLDER not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="cranedyn-objects-")
        os.environ[objects.FOLDER] = folder.name  # workers of pytest-xdist inherit it
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.pop(objects.FOLDER))
    is_worker = hasattr(config, "workerinput")
    starts_workers = bool(config.getoption("tx", None))
    if is_worker or not starts_workers:
        objects.share(Path(os.environ[objects.FOLDER]))


@pytest.fixture
def limited() -> Iterator[None]:
    """Five minutes and no more, for tests that wait for other processes."""

    def over(*_: object) -> None:
        raise TimeoutError("the test has taken five minutes")

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, 300.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def oracle() -> Iterator[str]:
    """Let `simulate` find the engine of `tests.oracles.contact_engine` by the name "oracle"."""
    from tests.oracles import contact_engine  # imports the compiled engine

    with contact_engine.registered() as name:
        yield name


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as quick what is neither slow nor long, before `-m` selects."""
    for item in items:
        if not (item.get_closest_marker("slow") or item.get_closest_marker("long")):
            item.add_marker(pytest.mark.quick)


def pytest_collection_finish() -> None:
    """Look for garbage seldom, and not among what stays: a tenth of the time of the tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
