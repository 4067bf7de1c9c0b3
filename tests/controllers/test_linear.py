"""Linear dynamic controllers: as matrices say, in every engine and in batches, and at the limits of
the drives.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller, linear_controller
from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.controllers.linear import LinearController, observer_gain
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import CraneError, RunError
from cranedyn.estimation.misread import Misread
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, ROOT, alike_in_both_engines, crane
from tests.linear_laws import CRANE, INTEGRATOR, PERIOD, REST, filtered

compiled = pytest.mark.skipif(FAST != "compiled", reason="extra compiled is not installed")

CLOCKS: dict[str, Any] = {"dt": 2e-3, "control_period": PERIOD}
OFF = CRANE.state(x=12.3, l=14.8, gamma=0.02, phi=0.05, theta=-0.04)


class Plain:
    """The same controller as its documentation has it: matrices, and nothing else."""

    def __init__(self, law: LinearController) -> None:
        self._law = law
        self.states = [law.states.initial]
        self.commands: list[np.ndarray] = []

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command, and move on."""
        law = self._law
        about = law.tracking.setpoint[0].copy()
        if law.setpoint == "run":
            about[law.crane.layout.drives] = setpoint.position
        deviation = np.concatenate(state) - about
        x = self.states[-1]
        u = law.tracking.feed_forward[0] - law.tracking.gain[0] @ deviation + law.states.c @ x
        applied = np.minimum(np.maximum(u, -law.states.limit), law.states.limit)
        self.states.append(
            law.states.a @ x + law.states.b @ deviation + law.states.anti_windup @ (applied - u)
        )
        self.commands.append(u)
        return u


@compiled
@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
@pytest.mark.parametrize("setpoint", ["rest", "run"])
def test_in_both_engines_the_crane_moves_as_under_the_matrices_in_a_plain_loop(
    drive: Drive, setpoint: Any
) -> None:
    law = filtered(drive, setpoint=setpoint)
    motion = flat(CRANE, REST, CRANE.state(x=13.0, l=14.0, gamma=0.05), 6.0, period=PERIOD)
    how = {"reference": motion, "start": OFF, "duration": 6.0, "drive": drive} | CLOCKS
    run = alike_in_both_engines(CRANE, law, **how)
    plain = simulate(CRANE, Plain(law), engine="pinocchio", **how)
    assert_allclose(run.q, plain.q, atol=1e-10)  # round-off
    # The states matter: without them the trolley stands elsewhere.
    stateless = replace(law, states=replace(law.states, c=0.0 * law.states.c))
    assert np.abs(simulate(CRANE, stateless, engine=FAST, **how).q - run.q).max() > 1e-3


@compiled
def test_a_block_goes_on_with_the_states_of_the_block_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    how: Any = {"start": OFF, "duration": 3.0, "engine": "compiled"} | CLOCKS
    whole = simulate(CRANE, filtered(), **how)
    monkeypatch.setattr("cranedyn.compiled.blocks._MAX_BLOCK_LENGTH", 7)
    law = filtered()
    assert simulate(CRANE, law, **how).q.tobytes() == whole.q.tobytes()
    # and each run begins at the initial states
    assert simulate(CRANE, law, **how).q.tobytes() == whole.q.tobytes()


@compiled
def test_where_a_block_diverges_the_loop_goes_on_with_the_states_up_to_there() -> None:
    law = filtered("motion")
    wild = replace(law, states=replace(law.states, a=1.05 * np.eye(5)))
    how: Any = {"start": OFF, "duration": 20.0, "drive": "motion", "validity": "mark"} | CLOCKS
    runs = []
    for engine in ("compiled", "pinocchio"):
        with pytest.raises(RunError, match="t = ") as caught:
            simulate(CRANE, wild, engine=engine, **how)
        runs.append(caught.value.trajectory)
    assert len(runs[0]) == len(runs[1]) > 100
    assert_allclose(runs[0].q, runs[1].q, rtol=1e-6)  # round-off grows as the states do


@compiled
def test_each_crane_of_a_batch_moves_as_alone_whatever_the_number_of_states() -> None:
    from cranedyn.compiled.batch import simulate_batch

    laws: list[Any] = [
        filtered(),
        linear_controller(CRANE, about=REST, **INTEGRATOR),
        hold_controller(CRANE),
        filtered(initial=np.array([0.1, -0.2, 0.3, 0.01, 0.0])),
        Misread(CRANE, filtered(), 0.01, 0.2),
    ]
    controllers = [laws[i % 5] for i in range(11)]
    starts = [CRANE.state(x=12.0 + 0.05 * i, l=15.0, phi=0.05) for i in range(11)]
    reference = hold(CRANE, REST)
    batch = simulate_batch(CRANE, controllers, reference, start=starts, duration=3.0, **CLOCKS)
    for i in range(11):
        alone = simulate(
            CRANE, controllers[i], reference, start=starts[i], duration=3.0, engine="pinocchio",
            **CLOCKS,
        )  # fmt: skip
        assert_allclose(batch.end.q[i], alone.q[-1], rtol=0.0, atol=1e-9)  # round-off


@compiled
def test_a_batch_begins_at_the_initial_states_also_after_a_run() -> None:
    from cranedyn.compiled.batch import simulate_batch

    law = linear_controller(CRANE, about=REST, **INTEGRATOR)
    how: Any = {"start": OFF, "duration": 2.0} | CLOCKS
    fresh = simulate_batch(CRANE, law, **how).end.q
    simulate(CRANE, law, engine=FAST, **how)
    assert simulate_batch(CRANE, law, **how).end.q.tobytes() == fresh.tobytes()


@compiled
@pytest.mark.parametrize("how", ["single", "batch"])
def test_a_run_with_another_control_period_is_refused(how: str) -> None:
    from cranedyn.compiled.batch import simulate_batch

    run = simulate if how == "single" else simulate_batch
    with pytest.raises(
        CraneError, match=r"control period of the run is 0\.02 s; allowed is .* 0\.01"
    ):
        run(CRANE, filtered(), duration=1.0, dt=2e-3, control_period=2e-2)


class Wrapped:
    """A controller that hands on the affine form of another one, but not its states."""

    def __init__(self, law: LinearController) -> None:
        self._law = law

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command."""
        return self._law(t, state, setpoint)

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin a run."""
        self._law.begin_run(t, control_period)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form."""
        return self._law.affine(times, positions)


@compiled
def test_a_wrapper_that_cannot_go_on_from_states_runs_in_python_and_is_refused_a_batch() -> None:
    from cranedyn.compiled.batch import simulate_batch

    how: Any = {"start": OFF, "duration": 1.0} | CLOCKS
    runs = [simulate(CRANE, law, engine=FAST, **how) for law in (filtered(), Wrapped(filtered()))]
    assert_allclose(runs[1].q, runs[0].q, atol=1e-12)  # round-off
    with pytest.raises(CraneError, match="Wrapped is not affine in the state"):
        simulate_batch(CRANE, Wrapped(filtered()), **how)


def test_asked_again_for_the_same_time_it_answers_the_same() -> None:
    once, twice = filtered(), filtered()
    setpoint = hold(CRANE)(0.0)
    for k in range(5):
        t = k * PERIOD
        first = twice(t, OFF, setpoint)
        assert (twice(t, OFF, setpoint) == first).all()
        assert (once(t, OFF, setpoint) == first).all()


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_a_controller_with_one_output_commands_one_drive_and_leaves_the_others_held(
    drive: Drive,
) -> None:
    name = input_names(CRANE, drive)[1]
    law = linear_controller(
        CRANE, about=REST, drive=drive, **INTEGRATOR | {"outputs": [name], "d": [[-2.0]]}
    )
    setpoint = hold(CRANE, REST)(0.0)
    found = law(0.0, OFF, setpoint)
    assert found[1] == pytest.approx(-2.0 * (OFF.q[1] - REST.q[1]))
    offset = OFF.q[CRANE.layout.drives] - REST.q[CRANE.layout.drives]
    held = hold_controller(CRANE)
    expected = held(0.0, OFF, setpoint)
    if drive == "velocity":
        expected = -held.stiffness / held.damping * offset
    elif drive == "motion":
        expected = -25.0 * offset  # 5 rad/s
    assert_allclose(found[[0, 2]], expected[[0, 2]], rtol=1e-12)
    # The setpoint of the run moves the drives that are held, too.
    follows = linear_controller(
        CRANE, about=REST, drive=drive, setpoint="run", **INTEGRATOR | {"outputs": [name]}
    )
    there = Setpoint(OFF.q[CRANE.layout.drives], *np.zeros((2, 3)))
    standing = State(OFF.q, 0.0 * OFF.v)
    at_goal = follows(0.0, standing, there)
    rest_command = holding_effort(CRANE, REST.q) if drive == "effort" else np.zeros(3)
    assert_allclose(at_goal, rest_command, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(["effort", "motion", "velocity"]), st.booleans(), st.integers(0, 2**32 - 1))
def test_whatever_its_inputs_and_outputs_are_it_commands_what_its_matrices_say_by_name(
    drive: Drive, limited: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    names = state_names(CRANE)
    commands = input_names(CRANE, drive)
    on_their_way = [f"{name}_{i}" for i in (1, 2) for name in commands if drive == "velocity"]
    signals = [*names, *on_their_way]
    inputs = [str(name) for name in rng.permutation(signals)[: rng.integers(1, len(signals) + 1)]]
    outputs = [str(name) for name in rng.permutation(commands)[: rng.integers(1, 4)]]
    k = int(rng.integers(0, 5))
    a, b, c, d, back = (
        rng.normal(size=shape)
        for shape in (
            (k, k), (k, len(inputs)), (len(outputs), k), (len(outputs), len(inputs)),
            (k, len(outputs)),
        )
    )  # fmt: skip
    # So that efforts reach their limits, and rates theirs.
    scale = 1e6 if drive == "effort" else 1.0
    initial = rng.normal(size=k)
    delays = [int(name[-1]) for name in inputs if name in on_their_way]
    typical = converters(CRANE, delay=PERIOD * max(delays, default=1))
    law = linear_controller(
        CRANE, a, b, scale * c, scale * d, about=REST, inputs=inputs, outputs=outputs,
        period=PERIOD, initial=initial, anti_windup=back / scale if limited else None, drive=drive,
        converters=typical if drive == "velocity" else None,
    )  # fmt: skip
    law.begin_run(0.0, PERIOD)
    at_rest = holding_effort(CRANE, REST.q) if drive == "effort" else np.zeros(3)
    limits = {
        "effort": CRANE.effort_limit, "motion": np.full(3, np.inf), "velocity": typical.rates,
    }[drive]  # fmt: skip
    places = [commands.index(name) for name in outputs]
    setpoint = hold(CRANE, REST)(0.0)
    x = initial
    past = [np.zeros(3), np.zeros(3)]
    for call in range(5):
        z = 0.1 * rng.normal(size=10)
        value = dict(zip(names, z, strict=True))
        for i in (1, 2):
            value |= {f"{name}_{i}": past[-i][j] for j, name in enumerate(commands)}
        y = np.array([value[name] for name in inputs])
        u = scale * (c @ x + d @ y)
        found = law(call * PERIOD, State(REST.q + z[:5], REST.v + z[5:]), setpoint)
        tolerance = 1e-12 * max(1.0, np.abs(u).max(), np.abs(at_rest).max())  # round-off
        assert_allclose(found[places], at_rest[places] + u, rtol=1e-9, atol=tolerance)
        applied = np.clip(found, -limits, limits)
        x = a @ x + b @ y
        if limited:
            x = x + back / scale @ (applied - found)[places]
        past.append(applied if limited else found)


def saturating(anti_windup: Any) -> tuple[LinearController, Plain]:
    """Ten seconds of an integrating trolley with its brake on, 5 m from where it should be, and ten
    more with it there.
    """
    law = linear_controller(
        CRANE, about=REST, anti_windup=anti_windup, **INTEGRATOR | {"c": [[4e4]], "d": [[-3e4]]}
    )
    plain = Plain(law)
    setpoint = hold(CRANE, REST)(0.0)
    for k in range(2000):
        x = 7.0 if k < 1000 else 12.0
        state = CRANE.state(x=x, l=15.0)
        command = law(k * PERIOD, state, setpoint)
        assert_allclose(plain(k * PERIOD, state, setpoint), command, rtol=1e-12)
    return law, plain


def test_an_integrator_is_released_at_once_where_anti_windup_holds_it_at_the_limit() -> None:
    limit = float(CRANE.effort_limit[1])
    _, wound = saturating(None)
    # Without anti-windup: 5 m times 10 s, which stay, as the error is zero after that.
    assert wound.states[-1][0] == pytest.approx(50.0)
    assert wound.commands[-1][1] == pytest.approx(4e4 * 50.0)
    law, held = saturating("observer")
    # At the limit x = x + T e + w (limit - c x - d e), with the error e, is at rest where
    # c x + d e = limit + T e / w.
    gain = float(law.states.anti_windup[0, 1])
    overshoot = PERIOD * 5.0 / gain
    assert held.commands[999][1] == pytest.approx(limit + overshoot, rel=1e-9)
    # Released, the command is what the integrator has beyond the proportional part: below the
    # limit at once, since that has been subtracted.
    assert held.commands[1000][1] == pytest.approx(limit + overshoot - 3e4 * 5.0, rel=1e-6)


@compiled
def test_at_the_limit_of_a_drive_both_engines_hold_the_states_alike() -> None:
    weak = crane(trolley_effort=2e3)
    far = weak.state(x=9.0, l=15.0)
    runs = []
    for anti_windup in (None, "observer"):
        law = linear_controller(
            weak, about=REST, anti_windup=anti_windup, **INTEGRATOR | {"c": [[4e3]], "d": [[-3e4]]}
        )
        runs.append(
            alike_in_both_engines(weak, law, start=far, duration=12.0, validity="mark", **CLOCKS)
        )
    assert (np.abs(runs[1].effort[:, 1]) >= 2e3).mean() > 0.05, "the drive is at its limit"
    assert np.abs(runs[0].q - runs[1].q).max() > 0.1


def test_the_anti_windup_observer_is_that_of_the_riccati_equation() -> None:
    # One state, a = c = 1: P = P + 1 - P²/(P + 1) is solved by the golden ratio, and l = P/(P + 1).
    assert observer_gain(np.eye(1), np.eye(1))[0, 0] == pytest.approx((np.sqrt(5.0) - 1.0) / 2.0)
    law = filtered()
    radius = np.abs(np.linalg.eigvals(law.states.a - law.states.anti_windup @ law.states.c)).max()
    assert radius < 1.0


@compiled
def test_a_command_on_its_way_is_remembered_as_the_limit_leaves_it() -> None:
    typical = converters(CRANE, delay=2.0 * PERIOD)
    commands = [f"x_dot_command_{i}" for i in (2, 1)]

    def law(anti_windup: Any) -> LinearController:
        none = np.zeros((0, 0))
        d = np.array([[-4.0, -0.3, -0.4]])
        return linear_controller(
            CRANE, none, np.zeros((0, 3)), np.zeros((1, 0)), d, about=REST, drive="velocity",
            inputs=["x", *commands], outputs=["x_dot_command"], anti_windup=anti_windup,
            converters=typical,
        )  # fmt: skip

    setpoint = hold(CRANE, REST)(0.0)
    far = CRANE.state(x=10.0, l=15.0)
    limit = float(typical.rates[1])
    for anti_windup, remembered in ((None, 8.0), ("observer", limit)):
        controller = law(anti_windup)
        first, second = (controller(t, far, setpoint)[1] for t in (0.0, PERIOD))
        assert first == 8.0
        assert second == pytest.approx(8.0 - 0.4 * remembered)
        how: Any = {"start": far, "duration": 6.0, "drive": typical, "validity": "mark"}
        alike_in_both_engines(CRANE, controller, **how | CLOCKS)
        with pytest.raises(CraneError, match="allowed is 2, the commands on their way"):
            simulate(CRANE, controller, duration=1.0, drive=typical, control_period=5e-3)


def with_integrator(**changes: Any) -> LinearController:
    return linear_controller(CRANE, **{"about": REST} | INTEGRATOR | changes)


HIDDEN = {"a": np.eye(2), "b": np.zeros((2, 1)), "c": [[1.0, 0.0]]}
"""A second integrator that no command sees."""


AS_RATES: dict[str, Any] = {"outputs": ["x_dot_command"], "drive": "velocity"}
AS_ACCELERATIONS: dict[str, Any] = {"outputs": ["x_ddot"], "drive": "motion"}

REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"a": np.eye(2)}, "b of the controller is an array of shape (1, 1); allowed is one of sh"),
    ({"a": np.ones((1, 2))}, "a of the controller is an array of shape (1, 2)"),
    ({"c": [[np.nan]]}, "c of the controller is nan; allowed is finite"),
    ({"d": np.zeros((1, 2))}, "d of the controller is an array of shape (1, 2); allowed is one of"),
    ({"initial": [0.0, 0.0]}, "initial states is an array of shape (2,); allowed is one of"),
    ({"period": 0.0}, "period of the controller is 0.0 s; allowed is > 0"),
    ({"period": None}, "period of the controller is None"),
    ({"inputs": ["y"]}, "There is no input 'y'; there are gamma, x, phi"),
    ({"inputs": ["x_dot_command_1"]}, "There is no input 'x_dot_command_1'"),
    ({"inputs": ["x_dot_command_99"]} | AS_RATES, "is on its way is 99; allowed is 64 or less"),
    ({"outputs": ["x_ddot"]}, "There is no command 'x_ddot'; there are T_gamma, F_x, F_l"),
    ({"inputs": ["x", "x"], "b": [[1, 2]], "d": [[1, 2]]}, "The input x is given twice"),
    ({"anti_windup": np.zeros((3, 1))}, "anti_windup is an array of shape (3, 1); allowed is one"),
    ({"anti_windup": "clamp"}, "anti_windup is clamp; allowed is observer"),
    ({"c": [[1e300]]}, "or numbers too large for a Riccati equation"),
    (HIDDEN, 'so that there is no anti-windup "observer"; give it anti_windup=None'),
    ({"setpoint": "goal"}, "setpoint is goal; allowed is rest or run"),
    ({"about": CRANE.state(x_dot=1.0)}, "rates of the rest"),
    (
        {"about": flat(CRANE, REST, OFF._replace(v=REST.v), 9.0), "setpoint": "run"},
        'setpoint is run; allowed is "rest" about a motion',
    ),
    ({"converters": converters(CRANE)} | AS_ACCELERATIONS, "converters"),
]


@pytest.mark.parametrize(("changes", "sentence"), REFUSED)
def test_matrices_that_are_no_controller_of_the_crane_are_refused_in_a_sentence(
    changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(CraneError, match=re.escape(sentence)):
        with_integrator(**changes)


@pytest.mark.parametrize("field", ["a", "b", "c", "anti_windup", "limit", "initial"])
def test_a_form_whose_states_have_another_shape_is_refused_by_name(field: str) -> None:
    law = with_integrator()
    law = replace(law, states=replace(law.states, **{field: np.zeros((2, 7))}))
    words = f"{field} of the states of LinearController is an array of shape"
    with pytest.raises(CraneError, match=words):
        affine_form(law, np.zeros(1), np.zeros((1, 3)), 10)


@compiled
def test_about_the_setpoint_of_the_run_the_load_of_a_luffing_crane_hangs_plumb() -> None:
    luffing = load_crane(urdf=ROOT / "urdf" / "luffing_crane.urdf.xacro")
    law = linear_controller(
        luffing, [[0.9]], [[0.1]], [[0.2]], [[0.1]], about=luffing.start, inputs=["swing_radial"],
        outputs=["luff_ddot"], drive="motion", setpoint="run", period=PERIOD,
    )  # fmt: skip
    q = luffing.start.q.copy()
    q[luffing.layout.index("luff")] += 0.1
    at_rest = luffing.state(**dict(zip(luffing.layout.symbols, luffing.resting(q), strict=True)))
    setpoint = hold(luffing, at_rest)
    # The swing, which is measured from the jib, is none at rest, wherever the jib stands.
    assert_allclose(law(0.0, at_rest, setpoint(0.0)), 0.0, atol=1e-12)
    start = at_rest._replace(q=at_rest.q + 0.02 * (np.arange(5) == 2))
    alike_in_both_engines(
        luffing, law, reference=setpoint, start=start, duration=2.0, drive="motion", **CLOCKS
    )


def test_about_a_motion_the_commands_of_the_motion_are_fed_forward() -> None:
    goal = CRANE.state(gamma=0.2, x=15.0, l=10.0)
    motion = flat(CRANE, REST, goal, 12.0, period=PERIOD)
    law = filtered(about=motion)
    run = simulate(CRANE, law, motion, start=REST, duration=12.0, engine=FAST, **CLOCKS)
    assert np.abs(run.q - motion.q).max() < 0.02
    still = simulate(CRANE, filtered(), motion, start=REST, duration=12.0, engine=FAST, **CLOCKS)
    assert np.abs(still.q[-1] - REST.q).max() < 1e-6


def test_rates_of_held_drives_are_those_of_the_hold_controller_for_velocities() -> None:
    law = linear_controller(
        CRANE, about=REST, drive="velocity", **INTEGRATOR | {"outputs": ["x_dot_command"]}
    )
    held = as_velocity_command(CRANE, hold_controller(CRANE), drive="effort")
    setpoint = hold(CRANE, REST)(0.0)
    found = law(0.0, OFF, setpoint)[[0, 2]]
    assert_allclose(found, held(0.0, OFF, setpoint)[[0, 2]], rtol=1e-12)


def test_the_limits_are_those_of_the_drives() -> None:
    effort = with_integrator().states.limit
    assert (effort == CRANE.effort_limit).all()
    drives = converters(CRANE)
    faster = Converters(**vars(drives) | {"rates": 2.0 * drives.rates})
    rates = with_integrator(**AS_RATES, converters=faster)
    assert (rates.states.limit == 2.0 * drives.rates).all()
    free = with_integrator(**AS_ACCELERATIONS)
    assert np.isinf(free.states.limit).all()
