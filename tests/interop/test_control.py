"""The crane in python-control, against closed forms and against `simulate`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.controllers.affine import affine_form
from cranedyn.controllers.lqr import effort_weight_of, state_weight_of
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import held_states, sampled
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import BRIDGE, HOOK, ROPE
from tests.helpers import FAST, G, constant, crane

ct = pytest.importorskip("control", reason="extra control (python-control) is not installed")
from cranedyn.interop.python_control import from_control, to_control  # noqa: E402

PERIOD = 2e-2
CLOCKS = {"dt": 2e-3, "control_period": PERIOD}


def deviation(run: Trajectory, rest: State) -> np.ndarray:
    """Coordinates and rates of a run beside those of a rest, shape (2 joints, n)."""
    return np.hstack([run.q - rest.q, run.v - rest.v]).T


def test_with_the_drives_in_prescribed_motion_the_poles_are_those_of_a_compound_pendulum() -> None:
    c = crane(damp_swing=2e3)
    plant = to_control(c, c.state(l=10.0), drive="motion", outputs=["phi", "theta"])
    total = [1000.0 * 10.0**2 + inertia for inertia in (500.0, 450.0)]
    expected = [np.roots([one, 2e3, 1000.0 * G * 10.0]) for one in total]
    poles = plant.poles()
    # round-off.
    assert_allclose(
        np.sort_complex(poles[np.abs(poles) > 0.1]),
        np.sort_complex(np.concatenate(expected)),
        atol=1e-9,
    )
    assert (plant.output_labels, plant.input_labels) == (
        ["phi", "theta"],
        ["gamma_ddot", "x_ddot", "l_ddot"],
    )
    # At a constant acceleration the load hangs back by a/g.
    slowly = to_control(c, c.state(l=10.0), drive="motion")["phi", "x_ddot"](1e-5j)
    assert abs(slowly) == pytest.approx(1.0 / G, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["effort", "motion"])
@pytest.mark.parametrize(
    ("make", "efforts"),
    [
        (lambda: crane(damp_swing=2e3, damp_trolley=200.0), (20.0, 0.5, 0.3)),
        *((relative.crane, None) for relative in (HOOK, ROPE, BRIDGE)),
    ],
    ids=["tower crane", *(relative.name for relative in (HOOK, ROPE, BRIDGE))],
)
def test_the_sampled_system_answers_a_small_step_as_the_nonlinear_crane_does(
    make: Callable[[], Crane], efforts: Sequence[float] | None, drive: Drive
) -> None:
    c = make()
    rest = c.state(x=17.0, l=11.0) if efforts else c.start
    sizes = efforts or [{"rad": 20.0, "m": 0.5}[joint.unit] for joint in c.layout.driven]
    small = np.array(sizes) if drive == "effort" else np.full(c.layout.m, 1e-4)
    plant = to_control(c, rest, drive=drive, **CLOCKS)
    assert plant.state_labels == state_names(c)
    steps = 50
    found = ct.forced_response(plant, U=np.repeat(small[:, None], steps + 1, axis=1)).outputs
    holding = holding_effort(c, rest.q) if drive == "effort" else np.zeros(c.layout.m)
    command = constant(*(holding + small))
    duration = steps * PERIOD
    run = simulate(c, command, start=rest, duration=duration, drive=drive, engine=FAST, **CLOCKS)
    off = np.abs(found - deviation(run, rest)).max(axis=1)
    # Second order: deviations of about 1e-3.
    assert (off <= 2e-3 * np.abs(found).max(axis=1) + 1e-7).all(), off


@pytest.mark.slow
def test_a_gain_of_dlqr_runs_compiled_and_the_nonlinear_crane_moves_as_the_closed_linear_loop() -> (
    None
):
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    c = crane()
    rest = c.state(x=12.0, l=15.0)
    plant = to_control(c, rest, **CLOCKS)
    gain, _, _ = ct.dlqr(plant, state_weight_of(c), effort_weight_of(c))
    controller = from_control(c, gain, rest)
    # What runs without Python.
    assert affine_form(controller, np.arange(3.0), np.zeros((3, 3)), 10) is not None
    closed = ct.ss(plant.A - plant.B @ gain, plant.B, plant.C, 0, dt=PERIOD)

    def off(size: float) -> float:
        start = State(rest.q + size * np.array([0.1, 2.0, 1.0, -1.0, 1.0]), rest.v)
        run, same = (
            simulate(c, controller, start=start, duration=10.0, engine=name, **CLOCKS)
            for name in ("compiled", "pinocchio")
        )
        assert_allclose(run.q, same.q, atol=1e-11)  # round-off
        linear = ct.initial_response(
            closed, T=run.t, X0=np.concatenate([start.q - rest.q, start.v])
        ).outputs
        return float(np.abs(linear - deviation(run, rest)).max())

    # The first order is the same: what is left is of the second, by which a tenth of the deviation
    # leaves a hundredth.
    assert off(1e-3) < 2e-5
    assert off(1e-4) == pytest.approx(off(1e-3) / 100.0, rel=0.05)


def test_what_python_control_calls_a_state_feedback_is_the_same_controller() -> None:
    c = crane()
    rest = c.state(l=12.0)
    plant = to_control(c, rest, **CLOCKS)
    gain, _, _ = ct.dlqr(plant, state_weight_of(c), effort_weight_of(c))
    names = state_names(c)
    commands = input_names(c, "effort")
    turned = names[::-1]
    systems = [
        ct.create_statefbk_iosystem(plant, gain)[0],
        ct.ss([], [], [], -gain, dt=PERIOD),
        ct.ss([], [], [], -gain, inputs=names, outputs=commands, dt=PERIOD),
        ct.ss([], [], [], -gain[:, ::-1], inputs=turned, outputs=commands, dt=PERIOD),
    ]
    for system in systems:
        assert (from_control(c, system, rest).gain[0] == gain).all()


def test_outputs_with_the_names_of_commands_go_to_these_drives_in_whatever_order() -> None:
    c = crane()
    names = state_names(c)
    gain = np.random.default_rng(0).normal(size=(3, 10))
    turned = input_names(c, "effort")[::-1]
    system = ct.ss([], [], [], -gain[::-1], inputs=names, outputs=turned, dt=PERIOD)
    assert (from_control(c, system, c.start).gain[0] == gain).all()
    # One output commands one drive; the others are held.
    alone = ct.ss([], [], [], [[-7e3]], inputs=["x"], outputs=["F_x"], dt=PERIOD)
    law = from_control(c, alone, c.start)
    hold_gain = hold_controller(c).affine(np.zeros(1), np.zeros((1, 3))).gain[0]
    assert (law.gain[0][1] == 7e3 * np.eye(10)[1]).all()
    assert (law.gain[0][[0, 2]] == hold_gain[[0, 2]]).all()


def test_a_system_without_names_has_the_states_of_the_plant_in_their_order() -> None:
    c = crane()
    gain = np.random.default_rng(0).normal(size=(3, 13))
    plain = ct.ss([], [], [], -gain, dt=PERIOD)
    laws = [from_control(c, one, c.start, drive="velocity") for one in (gain, plain)]
    for name in ("a", "b", "c"):
        assert (getattr(laws[1].states, name) == getattr(laws[0].states, name)).all()


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_about_a_motion_the_gain_keeps_the_load_on_it(drive: Drive) -> None:
    c = crane()
    start = c.state(x=12.0, l=12.0)
    goal = c.state(gamma=0.2, x=15.0, l=10.0)
    motion = flat(c, start, goal, 12.0, period=PERIOD)
    plant = to_control(c, start, drive=drive, **CLOCKS)
    weight = effort_weight_of(c) if drive == "effort" else np.diag([10.0, 1.0, 1.0])
    gain, _, _ = ct.dlqr(plant, state_weight_of(c), weight)
    controller = from_control(c, gain, motion, drive=drive, dt=2e-3)
    off = c.state(x=12.0, l=12.0, phi=0.05, theta=0.05)
    run = simulate(
        c,
        controller,
        motion,
        start=off,
        duration=40.0,
        drive=drive,
        engine=FAST,
        validity="mark",  # at the start the slew would need half again what its drive has
        **CLOCKS,
    )
    assert_allclose(run.q[-1], goal.q, atol=2e-3)  # 50 mrad of swing at the start, damped for 40 s
    undisturbed = simulate(
        c, controller, motion, start=start, duration=12.0, drive=drive, engine=FAST, **CLOCKS
    )
    assert np.abs(undisturbed.q - motion.q).max() < 5e-3


@pytest.mark.parametrize(
    ("feedback", "sentence"),
    [
        (np.zeros((3, 9)), r"gain.*\(3, 9\).* 3 rows and 10 columns.*F_x.*theta_dot"),
        (np.full((3, 10), np.nan), "gain of the feedback is nan; allowed is finite"),
        (np.zeros((3, 13)), r"gain.*\(3, 13\).* 3 rows and 10 columns"),
        (  # a notch filter of one signal
            ct.ss(ct.tf([1.0, 0.0, 1.0], [1.0, 0.4, 1.0])).sample(PERIOD),
            "has 1 outputs .*; it needs one for each drive: T_gamma, F_x, F_l. A filter of one",
        ),
        ("K", "feedback is 'K'"),
        (
            ct.ss(np.eye(2) * 0.5, np.zeros((2, 10)), np.zeros((3, 2)), np.zeros((3, 10)), dt=0),
            "2 states in continuous time",
        ),
        (ct.ss([], [], [], np.zeros((3, 11)), dt=PERIOD), "no input gamma"),
    ],
)
def test_a_feedback_that_is_none_is_refused_in_a_sentence(feedback: object, sentence: str) -> None:
    c = crane()
    with pytest.raises(CraneError, match=sentence):
        from_control(c, feedback, c.start)


def test_a_feedback_is_about_a_rest() -> None:
    with pytest.raises(OutOfRange, match="rates of the rest"):
        from_control(crane(), np.zeros((3, 10)), crane().state(x_dot=1.0))


def test_as_rates_are_commanded_drives_are_lags_and_the_load_is_the_same_pendulum() -> None:
    c = crane(damp_swing=2e3)
    lags = {"gamma": 0.25, "x": 0.15, "l": 0.125}
    plant = to_control(c, c.state(l=10.0), drive="velocity", converters=converters(c, lags=lags))
    assert plant.input_labels == ["gamma_dot_command", "x_dot_command", "l_dot_command"]
    total = [1000.0 * 10.0**2 + inertia for inertia in (500.0, 450.0)]
    swings = [np.roots([one, 2e3, 1000.0 * G * 10.0]) for one in total]
    expected = np.concatenate([np.zeros(3), [-1.0 / lag for lag in lags.values()], *swings])
    # round-off
    assert_allclose(np.sort_complex(plant.poles()), np.sort_complex(expected), atol=1e-9)


@pytest.mark.slow
def test_the_sampled_system_of_rates_has_the_delay_and_answers_as_converters_do() -> None:
    c = crane()
    rest = c.state(x=12.0, l=10.0)
    plant = to_control(c, rest, drive="velocity", **CLOCKS)
    assert plant.nstates == 13 and plant.state_labels[-1] == "l_dot_command_1"
    steps = 300
    t = PERIOD * np.arange(steps + 1)
    # slower than the ramps, by which the reference is the command
    command = 1e-3 * (1.0 - np.cos(2.0 * np.pi * t / 3.0))[:, None] * [0.05, 1.0, 0.5]
    linear = ct.forced_response(plant, U=command.T).outputs
    run = simulate(
        c,
        lambda t, state, setpoint: command[round(t / PERIOD)],
        start=rest,
        duration=steps * PERIOD,
        drive=Converters(**vars(converters(c)) | {"resolutions": np.zeros(3)}),
        engine=FAST,
        **CLOCKS,
    )
    off = np.abs(linear - deviation(run, rest)).max(axis=1)
    largest = np.abs(deviation(run, rest)).max(axis=1)
    # the ramp rounds each of the stairs, 2 mm/s² of them, by less than a control period
    assert (off[:10] <= 0.02 * largest + 1e-7).all(), off / largest


def as_gain(gain: np.ndarray) -> object:
    return gain


def as_system(gain: np.ndarray) -> object:
    plant = to_control(crane(), crane().state(x=12.0, l=10.0), drive="velocity", **CLOCKS)
    names = plant.state_labels[::-1]
    commands = plant.input_labels
    return ct.ss([], [], [], -gain[:, ::-1], inputs=names, outputs=commands, dt=PERIOD)


@pytest.mark.slow
@pytest.mark.parametrize("feedback", [as_gain, as_system])
def test_a_gain_of_the_commands_on_their_way_moves_the_crane_as_the_closed_linear_loop(
    feedback: Callable[[np.ndarray], object],
) -> None:
    c = crane()
    rest = c.state(x=12.0, l=10.0)
    plant = to_control(c, rest, drive="velocity", **CLOCKS)
    gain, _, _ = ct.dlqr(plant, np.eye(13), 0.1 * np.eye(3))
    assert np.abs(gain[:, 10:]).max() > 0.05, "it feeds back what is on its way"
    law = from_control(c, feedback(gain), rest, drive="velocity")
    # Small enough that ramps, rates and the second order are without effect.
    start = State(rest.q + 1e-4 * np.array([0.0, 1.0, 1.0, -1.0, 1.0]), rest.v)
    typical = converters(c)
    big = np.full(3, 1e9)
    drives = Converters(big, big, big, typical.lags, np.zeros(3), typical.delay)
    run = simulate(c, law, start=start, duration=10.0, drive=drives, engine=FAST, **CLOCKS)
    closed = ct.ss(plant.A - plant.B @ gain, plant.B, plant.C, 0, dt=PERIOD)
    first = np.concatenate([start.q - rest.q, start.v, np.zeros(3)])
    linear = ct.initial_response(closed, T=run.t, X0=first).outputs[:10]
    off = np.abs(linear - deviation(run, rest)).max(axis=1)
    # of the second order: the square of the largest deviation, 1.4e-4
    assert off.max() < 2e-8


def test_a_gain_of_the_commands_on_their_way_is_refused_a_run_with_another_delay() -> None:
    c = crane()
    law = from_control(c, np.zeros((3, 13)), c.start, drive="velocity")
    with pytest.raises(OutOfRange, match=r"control periods of 0\.005 s is 4; allowed is 1,"):
        simulate(c, law, duration=1.0, drive="velocity", control_period=5e-3)


@pytest.mark.slow
def test_a_controller_with_an_observer_moves_the_crane_as_the_closed_linear_loop() -> None:
    c = crane()
    rest = c.state(x=12.0, l=15.0)
    seen = ["gamma", "x", "phi", "theta", "l"]
    plant = to_control(c, rest, outputs=seen, **CLOCKS)
    gain, _, _ = ct.dlqr(plant, state_weight_of(c), effort_weight_of(c))
    filter_gain, _, poles = ct.dlqe(
        plant.A, np.eye(10), plant.C, 1e-2 * np.eye(10), 1e-4 * np.eye(5)
    )
    # The gain of `dlqe` is that of the prediction of the next state, with A in it.
    of_error = np.linalg.eigvals(plant.A - filter_gain @ plant.C)
    np.testing.assert_allclose(np.sort(abs(of_error)), np.sort(abs(poles)), rtol=0, atol=1e-9)
    design = ct.ss(
        plant.A - plant.B @ gain - filter_gain @ plant.C,
        filter_gain,
        -gain,
        np.zeros((3, 5)),
        inputs=seen,
        outputs=plant.input_labels,
        dt=PERIOD,
    )
    controller = from_control(c, design, rest)
    # What runs without Python.
    assert affine_form(controller, np.arange(3.0), np.zeros((3, 3)), 10) is not None
    loop = np.block([[plant.A, -plant.B @ gain], [filter_gain @ plant.C, design.A]])

    def off(size: float) -> float:
        start = State(rest.q + size * np.array([0.1, 2.0, 1.0, -1.0, 1.0]), rest.v)
        run, again = (
            simulate(c, controller, start=start, duration=8.0, engine=FAST, **CLOCKS)
            for _ in range(2)
        )
        assert (run.q == again.q).all()  # each run begins without memory
        z = [np.concatenate([start.q - rest.q, np.zeros(15)])]
        for _ in range(len(run) - 1):
            z.append(loop @ z[-1])
        return float(np.abs(np.array(z).T[:10] - deviation(run, rest)).max())

    # what is left is of second order, as of the static gain
    assert off(1e-3) < 1e-4
    assert off(1e-4) == pytest.approx(off(1e-3) / 100.0, rel=0.1)
    with pytest.raises(OutOfRange, match="control period of the run"):
        simulate(c, controller, start=rest, duration=1.0, dt=2e-3, control_period=4e-3)


def test_a_feedback_with_integral_action_adds_up_what_is_left() -> None:
    c = crane()
    rest = c.state(x=12.0, l=15.0)
    gain = np.random.default_rng(0).normal(size=(3, 11))
    plant = to_control(c, rest, **CLOCKS)
    place = np.eye(1, 10, 1)
    design, _ = ct.create_statefbk_iosystem(plant, gain, integral_action=place)
    controller = from_control(c, design, rest)
    off = c.state(x=12.5, l=15.0)
    z = np.concatenate(off) - np.concatenate(rest)
    for k in range(4):
        expected = holding_effort(c, rest.q) - gain[:, :10] @ z - gain[:, 10] * (0.5 * k)
        found = controller(k * PERIOD, off, hold(c)(0.0))
        assert_allclose(found, expected, rtol=1e-12, atol=1e-9)  # round-off


@pytest.mark.parametrize("period", [None, PERIOD])
def test_a_taut_inextensible_rope_has_states_and_feedback_of_a_rigid_one(
    period: float | None,
) -> None:
    rigid = crane()
    taut = crane(rope_stiffness=math.inf, drum_inertia=1e-6)
    systems = [to_control(c, control_period=period, dt=2e-3) for c in (rigid, taut)]
    assert systems[1].state_labels == systems[0].state_labels
    assert_allclose(systems[1].A, systems[0].A, rtol=1e-8, atol=1e-12)
    assert_allclose(systems[1].B, systems[0].B, rtol=1e-8, atol=1e-15)
    if period is None:
        return
    gains = [ct.dlqr(s, state_weight_of(rigid), effort_weight_of(rigid))[0] for s in systems]
    fed = [from_control(c, k, c.start) for c, k in zip((rigid, taut), gains, strict=True)]
    assert isinstance(fed[0], Tracking) and isinstance(fed[1], Tracking)
    held = held_states(taut, taut.start)
    assert not fed[1].gain[0][:, held].any()
    assert_allclose(np.delete(fed[1].gain[0], held, axis=1), fed[0].gain[0], rtol=1e-6, atol=1e-2)
    loop = sampled(taut, taut.start, dt=2e-3, control_period=period).closed(fed[1].gain[0])
    assert np.abs(np.linalg.eigvals(loop)).max() < 1.0
