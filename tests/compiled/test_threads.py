"""What several threads may do at once (docs/concepts/engine.md): all of it with one crane, and the
numbers are those of one thread alone.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from cranedyn.controllers import hold_controller, lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances import wind
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import flat
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, G, crane


@pytest.fixture
def restless() -> Iterator[None]:
    """Threads that take turns as often as Python can."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def together(*tasks: Callable[[], Any]) -> list[Any]:
    """What tasks return that are begun at the same time, each in a thread of its own."""
    ready = Barrier(len(tasks))

    def started(task: Callable[[], Any]) -> Any:
        ready.wait()
        return task()

    with ThreadPoolExecutor(len(tasks)) as pool:
        return list(pool.map(started, tasks))


def _check_together(task: Callable[[float], list[np.ndarray]], *places: float) -> None:
    """Compare what a task gives at some places with what it gives there in threads."""
    alone = [task(x) for x in places]
    found = together(*(partial(task, x) for x in places))
    for one, same in zip(alone, found, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, same, strict=True))


def _in_wind(c: Crane, x: float, engine: Any) -> Trajectory:
    gale = wind.wind(c, wind.steady(10.0), direction=0.3, payload_area=8.0, trolley_area=2.0)
    start = c.state(x=x, phi=0.1, theta=0.05)
    return simulate(
        c, hold_controller(c), start=start, duration=1.0, dt=5e-3, disturbance=gale, engine=engine
    )


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted({"pinocchio", FAST}))
def test_one_crane_runs_in_two_threads_as_in_one(engine: Any, restless: None) -> None:
    c = crane()
    names = ("q", "v", "force", "energy", "outside", "effort")

    def run(x: float) -> list[np.ndarray]:
        trajectory = _in_wind(c, x, engine)
        return [getattr(trajectory, name) for name in names]

    _check_together(run, 5.0, 20.0)


def test_what_a_crane_is_asked_in_two_threads_it_answers_as_in_one(restless: None) -> None:
    c = crane()

    def asked(x: float) -> list[np.ndarray]:
        state = State(np.array([0.1, x, 0.2, 0.1, x / 2.0]), np.array([0.1, 0.5, 0.2, 0.1, 0.3]))
        return [
            part
            for _ in range(300)
            for part in (
                dynamics.point_velocities(c, state),
                dynamics.payload_position(c, state.q),
                *dynamics.linearise(c, state, np.zeros(3)),
                *dynamics.prescribed_acceleration(c, state, np.ones(3)),
            )
        ]

    _check_together(asked, 8.0, 20.0)


@pytest.mark.slow
def test_motions_are_planned_and_controllers_made_in_two_threads_as_in_one(restless: None) -> None:
    c = crane()

    def planned(x: float) -> list[np.ndarray]:
        controller = lqr(c, flat(c, c.start, c.state(x=x), 9.0), every=100)
        return [controller.feed_forward, controller.gain]

    _check_together(planned, 8.0, 14.0)


@pytest.mark.skipif(FAST != "compiled", reason="extra compiled (llvmlite) is not installed")
@pytest.mark.slow
def test_code_is_made_and_batches_run_in_two_threads_as_in_one(restless: None) -> None:
    from cranedyn.compiled.batch import simulate_batch

    # Of which no other test has made code.
    cranes = [crane(payload_mass=mass) for mass in (911.0, 912.0)]

    def swung(c: Crane) -> np.ndarray:
        starts = [c.state(phi=swing) for swing in (0.1, 0.2, 0.3)]
        return simulate_batch(
            c, hold_controller(c), start=starts, duration=1.0, record=1, threads=2
        ).q

    found = together(*(lambda c=c: swung(c) for c in cranes))  # type: ignore[misc]
    assert all(np.array_equal(one, swung(c)) for one, c in zip(found, cranes, strict=True))


def test_a_crane_that_comes_from_another_process_has_scratch_memory_of_its_own() -> None:
    c = pickle.loads(pickle.dumps(crane()))
    assert c.data is c.data is not crane().data
    assert dynamics.energy(c, c.start) == dynamics.energy(crane(), crane().start)


@pytest.mark.slow
def test_cranes_are_loaded_in_several_threads(restless: None) -> None:
    masses = [1100.0, 1200.0, 1300.0]
    found = together(
        *(
            lambda mass=mass: load_crane(gravity=G, payload_mass=mass).payload_mass
            for mass in masses
        )
    )  # type: ignore[misc]
    assert found == masses
