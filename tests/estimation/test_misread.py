"""Controllers whose hoist reads less than the cable has, and controllers that repeat a cycle: what
they say of themselves in the common form is what they do when they are asked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller, lqr
from cranedyn.controllers.affine import affine_form
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.repeated import Repeated
from cranedyn.estimation import mpc
from cranedyn.estimation.misread import Misread
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.references import Motion, flat
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, crane

C = crane()
SHARE = 0.1
OFFSET = -0.4
LONGER = C.state(x=10.0, l=15.0 * (1.0 + SHARE) + OFFSET)


def motion() -> Motion:
    return flat(C, C.state(x=10.0, l=15.0), C.state(gamma=0.1, x=11.0, l=14.0), 8.0)


def integrating() -> HoistIntegral:
    return HoistIntegral(C, lqr(C, motion()), 4e3, float(C.effort_limit[2]))


def asked(controller: Controller) -> Controller:
    """The same as a function, which no engine can take apart."""
    return lambda t, state, setpoint: controller(t, state, setpoint)


CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "hold": lambda: hold_controller(C),
    "lqr": lambda: lqr(C, motion()),
    "integral": integrating,
}


@pytest.mark.parametrize("inner", CONTROLLERS)
def test_what_misreads_the_cable_commands_what_the_reading_asks_for(inner: str) -> None:
    seen: list[State] = []

    def looking(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        seen.append(state)
        return CONTROLLERS[inner]()(t, state, setpoint)

    state = C.state(l=15.0 * (1.0 + SHARE) + OFFSET, l_dot=2.0 * (1.0 + SHARE), x_dot=0.3)
    Misread(C, looking, SHARE, OFFSET)(0.0, state, motion()(0.0))
    read = C.state(l=15.0, l_dot=2.0, x_dot=0.3)
    assert_allclose(np.concatenate(seen[0]), np.concatenate(read), atol=1e-14)  # rounding


compiled = pytest.mark.skipif(FAST != "compiled", reason="needs the extra compiled")


def run(controller: Controller, start: State, duration: float) -> np.ndarray:
    """Coordinates, rates and commands of a load heavier than planned, whose integral grows up to
    its limit.
    """
    made = simulate(
        crane(payload_mass=1500.0),
        controller,
        motion(),
        start=start,
        duration=duration,
        engine=FAST,
        validity="mark",
    )
    return np.hstack([made.q, made.v, made.command])


@pytest.mark.slow
@compiled
@pytest.mark.parametrize("inner", CONTROLLERS)
def test_a_misread_cable_runs_in_code_as_it_does_step_by_step(
    inner: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 12 s are two blocks of code, so the second goes on with what the first one integrated
    slowly = run(asked(Misread(C, CONTROLLERS[inner](), SHARE, OFFSET)), LONGER, 12.0)
    monkeypatch.setattr(Misread, "__call__", None)
    quickly = run(Misread(C, CONTROLLERS[inner](), SHARE, OFFSET), LONGER, 12.0)
    # commands of 1e4 N, and round-off in another order
    assert_allclose(quickly, slowly, atol=1e-7)


@pytest.mark.slow
@compiled
def test_a_cycle_runs_in_code_as_it_does_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    # three cycles of 8 s, whose ends are not those of the blocks of 10 s
    start = C.state(x=10.0, l=15.0)
    states = slice(2 * C.layout.n)
    slowly = run(asked(Repeated(integrating(), 8.0)), start, 24.0)
    monkeypatch.setattr(Repeated, "__call__", None)
    quickly = run(Repeated(integrating(), 8.0), start, 24.0)
    assert_allclose(quickly[:, states], slowly[:, states], atol=1e-9)


def test_what_is_not_affine_is_not_when_it_misreads_either() -> None:
    times = 5e-3 * np.arange(3)
    controller = Misread(C, mpc(C, motion()), SHARE, OFFSET)
    assert affine_form(controller, times, motion().at(times).position, 10) is None
