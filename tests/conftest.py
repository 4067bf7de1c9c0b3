"""Settings that all tests share."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import tempfile
from collections import Counter
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
    """Let all processes of the run keep what is made once in one folder, see `tests.objects`."""
    from cranedyn.data import kept_files

    if objects.FOLDER not in os.environ:
        # Workers of pytest-xdist inherit it.
        os.environ[objects.FOLDER] = str(_shared_folder(config))
        config.add_cleanup(lambda: os.environ.pop(objects.FOLDER))
    os.environ[kept_files.VARIABLE] = os.environ[objects.FOLDER]


def _shared_folder(config: pytest.Config) -> Path:
    """Return the folder that the processes of a run share: in the cache of pytest, where later runs
    find it again. Without such a cache, or if others may write there and so bring code into this
    process, it is a new one, which is removed at the end.
    """
    from cranedyn.data import kept_files

    cache = getattr(config, "cache", None)
    if cache is not None:
        with contextlib.suppress(OSError):  # a checkout may be there to be read only
            folder = Path(cache.mkdir("cranedyn-objects"))
            if kept_files.is_guarded(folder) and os.access(folder, os.W_OK):
                objects.forget_unused(folder)
                return folder
    temporary = tempfile.TemporaryDirectory(prefix="cranedyn-objects-")
    config.add_cleanup(temporary.cleanup)
    return Path(temporary.name)


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


FIRST = (
    "system/test_fuzz.py",
    "experiments/test_whole.py",
    "matrix/test_foreign_cranes.py",
    "lifts/judging/test_mobile_lift.py",
    "lifts/judging/test_other_cranes.py",
    "lifts/judging/test_judgement.py",
    "experiments/test_site_shift.py",
    "experiments/test_compare_own_controller.py",
    "experiments/test_lift_chain.py",
    "lifts/planning/test_lift_chain.py",
    "benchmarks/test_settling_ropes.py",
    "compiled/test_horizon.py",
)
"""Files of few tests that take half a minute of the processor or more. A worker takes whole files:
one of these, begun last, would run alone while the other workers have nothing left to do.
"""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as quick what is neither slow nor long, before `-m` selects."""
    for item in items:
        if not (item.get_closest_marker("slow") or item.get_closest_marker("long")):
            item.add_marker(pytest.mark.quick)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Let workers begin with the files of `FIRST`, then with those of many tests. Look for garbage
    seldom, and not among what stays: a tenth of the time of the tests.
    """
    if hasattr(session.config, "workerinput"):
        counts = Counter(item.path for item in session.items)
        session.items.sort(
            key=lambda item: (
                not item.path.as_posix().endswith(FIRST),
                -counts[item.path],
                item.path,
            )
        )
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
