"""One control period at a time: the same as the loop, as often as one likes."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.dynamics.contact import Ground, box_corners, box_load, standing
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, RunError
from cranedyn.interfaces import State
from cranedyn.references import hold
from cranedyn.simulation.engine import load_engine
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stepper import Stepper
from tests.helpers import crane

ENGINE = pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
VARIANTS: list[dict[str, Any]] = [
    {},
    {"drive": "motion"},
    {"buffers": True},
    {"integrator": rk4, "dt": 5e-3},
    {"drive": "velocity"},
]


@ENGINE
@pytest.mark.parametrize(
    "variant", VARIANTS, ids=["effort", "motion", "buffers", "RK4", "velocity"]
)
def test_a_loop_of_ones_own_goes_through_the_states_of_simulate_to_the_bit(
    engine: Any, variant: dict[str, Any]
) -> None:
    start = crane().state(phi=0.1, theta=-0.05, x=12.0)
    setpoint = hold(crane(), start)(0.0)
    controller = hold_controller(crane())
    commands = {
        "effort": lambda t, state: controller(t, state, setpoint),
        "motion": lambda t, state: np.array([0.01, 0.1, -0.05]),
        "velocity": lambda t, state: np.array([0.02, 0.5, -0.3]),
    }
    command = commands[variant.get("drive", "effort")]
    stepper = Stepper(crane(), start=start, engine=engine, **variant)
    for _ in range(2):  # after a reset, too
        states = [stepper.reset(start)]
        states += [stepper.step(command(stepper.t, stepper.state)) for _ in range(40)]
        found = {**{name: value for name, value in variant.items() if name != "buffers"}}
        found |= {"validity": "buffers"} if "buffers" in variant else {}
        # a plain function as the controller: no block runs ahead
        run = simulate(
            crane(),
            lambda t, state, _: command(t, state),
            start=start,
            duration=0.2,
            engine=engine,
            **found,
        )
        assert np.array_equal(run.q, [state.q for state in states])
        assert np.array_equal(run.v, [state.v for state in states])
        assert stepper.t == pytest.approx(0.2, rel=1e-12)


@ENGINE
def test_a_force_acts_for_the_period_with_which_it_comes(engine: Any) -> None:
    force = np.array([[1000.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    weight = np.array([0.0, 0.0, -crane().payload_mass * crane().gravity])
    stepper = Stepper(crane(), forces=True, engine=engine, control_period=0.5)
    pushed = stepper.step(weight, force)
    left = stepper.step(weight)
    theta_rate = crane().layout.index("theta")
    assert pushed.v[theta_rate] != 0.0
    run = simulate(
        crane(),
        lambda t, state, _: weight,
        duration=1.0,
        control_period=0.5,
        disturbance=lambda t, state: force if t < 0.5 else 0.0 * force,
        engine=engine,
    )
    assert np.array_equal(run.q[1:], [pushed.q, left.q])


@pytest.mark.slow
@ENGINE
def test_a_force_ends_where_none_is_given(engine: Any) -> None:
    force = np.array([[1000.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    weight = np.array([0.0, 0.0, -crane().payload_mass * crane().gravity])
    stepper = Stepper(crane(), forces=True, engine=engine)
    expected = [stepper.step(weight, force), stepper.step(weight, 0.0 * force)]
    moving = load_engine(engine).begin(stepper._spec)
    found = [moving.step(weight, force), moving.step(weight, None)]
    assert np.array_equal(found[1].v, expected[1].v)
    acting = moving.actuation.force
    assert acting is None or not acting.any()


@ENGINE
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_copy_goes_on_by_itself_from_where_the_original_was(
    engine: Any, variant: dict[str, Any]
) -> None:
    drive = variant.get("drive", "effort")
    command = {"effort": [9e3, 500.0, -9e3], "motion": [0.01, 0.1, -0.05]}.get(drive, [0, 1, 0])
    force = np.tile([100.0, 50.0, 0.0], (2, 1))

    def new() -> Stepper:
        return Stepper(crane(), engine=engine, forces=True, **variant)

    def moved(stepper: Stepper, steps: int, sign: float) -> list[np.ndarray]:
        states = [stepper.step(sign * np.array(command), force=force) for _ in range(steps)]
        return [np.concatenate(state) for state in states]

    def in_turns(back: Stepper, forth: Stepper) -> list[list[np.ndarray]]:
        """Move both three times, the one against the other."""
        states = []
        for _ in range(3):
            states.append(moved(back, 2, -1.0))
            states.append(moved(forth, 2, 1.0))
        return states

    stepper = new()
    moved(stepper, 5, 1.0)
    copied = deepcopy(stepper)
    found = in_turns(copied, stepper)

    alone = new()
    other = new()
    moved(alone, 5, 1.0)
    moved(other, 5, 1.0)
    assert np.array_equal(found, in_turns(other, alone))
    assert copied.t == stepper.t == alone.t


def test_it_starts_where_the_urdf_says_and_its_states_cannot_be_written_to() -> None:
    stepper = Stepper(crane())
    assert np.array_equal(stepper.state.q, crane().start.q)
    assert stepper.t == 0.0
    with pytest.raises(ValueError, match="read-only"):
        stepper.step([0.0, 0.0, -9806.65]).q[0] = 1.0


def test_a_command_that_is_not_finite_names_the_joint_and_the_time() -> None:
    stepper = Stepper(crane())
    stepper.step([0.0, 0.0, -9806.65])
    with pytest.raises(RunError, match=r"at t = 0.0050 s; trolley_joint needs a finite number"):
        stepper.step([0.0, np.nan, 0.0])


def test_a_step_that_cannot_be_made_leaves_state_and_time() -> None:
    stepper = Stepper(crane(), control_period=0.1, drive="motion")
    stepper.reset(State(crane().start.q, np.full(5, 0.2)))
    before = stepper.state
    with pytest.raises(CraneError):
        stepper.step([-5e3, -4e3, 6e3])  # moves beyond all bounds within the period
    assert stepper.state is before
    assert stepper.t == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("engine", [None, "compiled", "oracle"])
@pytest.mark.usefixtures("oracle")
def test_a_load_stands_on_the_ground_of_a_stepper_as_in_simulate_and_in_a_copy(engine: Any) -> None:
    sides = (1.5, 3.0, 1.2)
    tower = crane(**box_load(1000.0, *sides), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(*sides))
    start = standing(tower, ground, tower.state(l=26.83))
    common = {"start": start, "drive": "motion", "ground": ground, "engine": engine}
    command = np.array([0.0, 0.3, -4.0])
    stepper = Stepper(tower, **common)
    stepper.step(command)
    stepper.reset(start)
    states = [stepper.reset(start)] + [stepper.step(command) for _ in range(20)]
    copied = deepcopy(stepper)
    ends = [[one.step(command) for _ in range(20)][-1] for one in (copied, stepper)]
    run = simulate(tower, lambda t, state, _: command, duration=0.2, **common)
    assert np.array_equal(run.q[:21], [state.q for state in states])
    assert all(np.array_equal(run.q[-1], end.q) for end in ends)
    assert run.phase is not None
    assert run.phase[0] == 2.0 != run.phase[-1]
