"""Joints that follow others move with them, their inertia and weight included, in both engines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller, lqr
from cranedyn.dynamics.equations_of_motion import acceleration, energy, holding_effort
from cranedyn.dynamics.linearisation import linear
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold
from cranedyn.simulation.simulate import simulate
from tests.helpers import alike_in_both_engines
from tests.model.test_locked import JOINT, LINK

MIMIC = '<mimic joint="{0}" multiplier="{1}" offset="{2}"/>'

BOOM = (
    '<robot name="boom"><link name="truck"/>'
    + "".join(LINK.format(*link) for link in (("column", 900), ("base", 300), ("s1", 200)))
    + "".join(LINK.format(*link) for link in (("s2", 120), ("s3", 60), ("load", 100)))
    + LINK.format("counter", 80)
    + JOINT.format("slew", "revolute", "truck", "column", "0 0 1", "")
    + JOINT.format("luff", "revolute", "column", "base", "0 -1 0", "")
    + JOINT.format("out1", "prismatic", "base", "s1", "1 0 0", "")
    + JOINT.format("out2", "prismatic", "s1", "s2", "1 0 0", MIMIC.format("out1", 0.8, 0.1))
    + JOINT.format("out3", "prismatic", "s2", "s3", "1 0 0", MIMIC.format("out2", 0.5, 0.0))
    + JOINT.format("swing", "revolute", "s3", "load", "0 1 0", "")
    + JOINT.format("wag", "revolute", "s3", "counter", "1 0 0", MIMIC.format("swing", -0.3, 0.0))
    + "</robot>"
)
"""A boom whose sections follow each other, and a counterweight that follows the swing."""

DRIVEN = ["slew", "luff", "out1"]


@pytest.fixture
def crane(tmp_path: Path) -> Crane:
    path = tmp_path / "boom.urdf"
    path.write_text(BOOM, encoding="utf-8")
    return load_crane(path, driven=DRIVEN, payload="swing")


@pytest.fixture
def oracle(tmp_path: Path, crane: Crane) -> tuple[pin.Model, np.ndarray]:
    """Pinocchio's own model of mimic joints, which must follow a joint that follows none, and the
    indices here of its coordinates.
    """
    chained = MIMIC.format("out2", 0.5, 0.0)
    direct = MIMIC.format("out1", 0.4, 0.05)
    assert BOOM.count(chained) == 1
    model = pin.buildModelFromXML(BOOM.replace(chained, direct), mimic=True)
    model.gravity.linear = crane.model.gravity.linear
    free = [
        name
        for name in list(model.names)[1:]
        if not crane.layout.joints[_index(crane, name)].follows
    ]
    order = sorted(free, key=lambda name: model.joints[model.getJointId(name)].idx_v)
    return model, np.array([_index(crane, name) for name in order])


def _index(crane: Crane, name: str) -> int:
    return [joint.name for joint in crane.layout.joints].index(name)


def _random_state(crane: Crane, seed: int) -> State:
    rng = np.random.default_rng(seed)
    assert crane.coupling is not None
    q, v = rng.uniform(-0.5, 0.5, (2, crane.layout.n))
    return State(crane.coupling.complete(q), crane.coupling.spread(v))


def test_followers_are_neither_drives_nor_passive(crane: Crane) -> None:
    layout = crane.layout
    assert [joint.follows for joint in layout.joints if joint.follows] == ["out1", "out1", "swing"]
    assert [layout.symbols[i] for i in layout.passive] == ["swing"]
    assert [joint.symbol for joint in layout.driven] == DRIVEN
    start = crane.state(out1=0.5)
    at = layout.at("out2", "out3")
    assert start.q[at].tolist() == pytest.approx([0.5, 0.25])
    lines = repr(crane).splitlines()
    assert [line.partition(" = ")[2] for line in lines if " = " in line] == [
        "0.8 out1 + 0.1",
        "0.4 out1 + 0.05",
        "-0.3 swing",
    ]


@pytest.mark.parametrize("seed", range(3))
def test_accelerations_are_those_of_pinocchios_own_mimic_joints(
    crane: Crane, oracle: tuple[pin.Model, np.ndarray], seed: int
) -> None:
    model, at = oracle
    data = model.createData()
    state = _random_state(crane, seed)
    effort = np.array([1e3, 2e3, -500.0])
    q = state.q[at]
    v = state.v[at]
    upper = np.triu(pin.crba(model, data, q))
    mass = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(crane.mass_matrix(state.q)[np.ix_(at, at)], mass, rtol=1e-12)
    bias = pin.rnea(model, data, q, v, np.zeros(len(at)))
    tau = np.array(
        [dict(zip(DRIVEN, effort, strict=True)).get(crane.layout.symbols[i], 0.0) for i in at]
    )
    expected = np.linalg.solve(mass, tau - bias)
    np.testing.assert_allclose(acceleration(crane, state, effort)[at], expected, rtol=1e-9)
    weight = pin.computeGeneralizedGravity(model, data, q)
    drives = [at.tolist().index(i) for i in crane.layout.drives]
    np.testing.assert_allclose(holding_effort(crane, state.q), weight[drives], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_both_engines_move_followers_with_their_leaders(crane: Crane, drive: str) -> None:
    start = crane.state(out1=0.3, swing=0.4, swing_dot=-0.3, luff=0.2)
    controller = hold_controller(crane)

    def command(t: float, state: object, setpoint: object) -> np.ndarray:
        return np.array([0.2, -0.1, 0.3]) * np.cos(t)

    run = alike_in_both_engines(
        crane,
        controller if drive == "effort" else command,
        start=start,
        duration=0.5,
        drive=drive,
        validity="mark",
    )
    assert crane.coupling is not None
    q = run.q
    np.testing.assert_allclose(crane.coupling.complete(q), q, atol=1e-12)


def test_the_energy_of_a_coupled_crane_is_kept(crane: Crane) -> None:
    start = crane.state(out1=0.3, swing=0.4, luff=0.2)
    run = simulate(
        crane,
        lambda t, state, setpoint: np.zeros(3),
        start=start,
        duration=0.5,
        dt=1e-4,
        validity="mark",
        engine="compiled",
    )
    assert energy(crane, start) == pytest.approx(run.energy[0])
    assert np.abs(run.unexplained).max() < 1e-3 * np.ptp(crane.payload_mass * crane.gravity * run.q)


@pytest.mark.slow
def test_a_batch_moves_followers(crane: Crane) -> None:
    starts = [crane.state(swing=angle) for angle in (0.1, 0.3)]
    controller = hold_controller(crane)
    clock = {"dt": 1e-3, "control_period": 1e-2}
    batch = simulate_batch(crane, controller, start=starts, duration=1.0, record=1, **clock)
    for i, start in enumerate(starts):
        run = simulate(crane, controller, start=start, duration=1.0, validity="mark", **clock)
        assert np.abs(batch.q[i] - run.q).max() < 1e-9


def test_the_linear_crane_has_the_derivatives_of_its_accelerations(crane: Crane) -> None:
    rest = crane.state(out1=0.3, luff=0.2)
    n = crane.layout.n
    step = 1e-6
    effort = holding_effort(crane, rest.q)
    by_z = linear(crane, rest, effort).a
    assert crane.coupling is not None
    for i in crane.layout.independent:
        moved = []
        for sign in (1.0, -1.0):
            q = rest.q.copy()
            q[i] += sign * step
            state = State(crane.coupling.complete(q), rest.v)
            moved.append(acceleration(crane, state, effort))
        slope = (moved[0] - moved[1]) / (2.0 * step)
        at = crane.layout.independent
        np.testing.assert_allclose(by_z[n + at, i], slope[at], rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_a_controller_designed_on_the_linear_crane_brings_it_to_rest(crane: Crane) -> None:
    goal = crane.state(out1=0.5)
    controller = lqr(crane, hanging_reference(crane, hold(crane, goal), 30.0))
    swing = float(goal.q[crane.layout.index("swing")]) + 0.1
    start = crane.state(out1=0.5, swing=swing, slew=0.05)
    run = simulate(
        crane, controller, hold(crane, goal), start=start, duration=30.0, engine="compiled"
    )
    assert np.abs(run.q[-1] - goal.q).max() < 1e-3


def test_a_leader_keeps_its_followers_in_their_ranges(crane: Crane) -> None:
    # out2 = 0.8 out1 + 0.1 may be at 1.5 at most, and out1 at 1.75 then; out1 ends at 1.5.
    assert crane.upper[crane.layout.index("out1")] == 1.5
    # out2 >= -1.5 asks for out1 >= -2.
    assert crane.lower[crane.layout.index("out1")] == -1.5


@pytest.mark.parametrize("mimic", [("out1", 0.8, 9.0), ("out1", 1.0, 3.0)])
def test_a_leader_without_a_range_left_is_refused(
    tmp_path: Path, mimic: tuple[str, float, float]
) -> None:
    """All ranges are ±1.5: the follower out1 + 3 is in its range at out1 = -1.5 alone."""
    path = tmp_path / "boom.urdf"
    text = BOOM.replace(MIMIC.format("out1", 0.8, 0.1), MIMIC.format(*mimic))
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match="out2 follows out1, and is beyond its range wherever"):
        load_crane(path, driven=DRIVEN, payload="swing")


def test_a_range_that_a_follower_cuts_is_said(tmp_path: Path) -> None:
    path = tmp_path / "boom.urdf"
    path.write_text(BOOM.replace('multiplier="0.8"', 'multiplier="2"'), encoding="utf-8")
    crane = load_crane(path, driven=DRIVEN, payload="swing")
    assert crane.upper[crane.layout.index("out1")] == pytest.approx(0.7)
    assert any("out1 moves from -0.8 to 0.7, where out2" in note for note in crane.assumptions)


def test_a_follower_that_never_moves_has_no_friction(tmp_path: Path) -> None:
    path = tmp_path / "boom.urdf"
    still = MIMIC.format("swing", 0.0, 0.0)
    text = BOOM.replace(MIMIC.format("swing", -0.3, 0.0), still)
    text = text.replace(still, f'{still}<dynamics friction="3"/>')
    path.write_text(text, encoding="utf-8")
    assert load_crane(path, driven=DRIVEN, payload="swing").friction is None


def test_the_record_of_a_coupled_crane_is_the_crane(crane: Crane) -> None:
    again = load_crane(from_record={"crane": dict(crane.record)})
    assert again.coupling == crane.coupling and again.layout == crane.layout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('joint="out1"', 'joint="out9"', "out2 in .* mimics out9, which is no joint that moves"),
        ('joint="out1"', 'joint="out3"', "mimics itself, through others"),
        ('joint="out1"', 'joint="out2"', "mimics itself, through others"),
        (
            'multiplier="0.8"',
            'multiplier="x"',
            "multiplier of mimic .* is 'x'; allowed is a decimal",
        ),
    ],
)
def test_a_joint_that_mimics_nothing_is_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = tmp_path / "boom.urdf"
    path.write_text(BOOM.replace(old, new, 1), encoding="utf-8")
    with pytest.raises((ModelError, OutOfRange), match=words):
        load_crane(path, driven=DRIVEN, payload="swing")


def test_a_follower_takes_no_start_and_no_drive(tmp_path: Path, crane: Crane) -> None:
    with pytest.raises(
        OutOfRange, match=r"out2 at the start is 0\.3; allowed is left out: it foll"
    ):
        crane.state(out2=0.3)
    path = tmp_path / "boom.urdf"
    with pytest.raises(ModelError, match="out2, which mimics out1 and has no drive of its own"):
        load_crane(path, driven=[*DRIVEN, "out2"], payload="swing")


def test_what_is_made_for_independent_joints_says_so(tmp_path: Path, crane: Crane) -> None:
    from cranedyn.compiled.horizon.receding import receding
    from cranedyn.export import mjcf_file
    from cranedyn.references.limits import Limits

    limits = Limits(rates=(0.1, 0.1, 0.1), accelerations=(0.1, 0.1, 0.1))
    words = r"out2 follows out1\. Hold both by locked=\['out1'\], or --locked"
    with pytest.raises(ModelError, match=rf"Predictive control is made for .*{words}"):
        receding(crane, limits)
    with pytest.raises(ModelError, match=rf"The export to MuJoCo is made for .*{words}"):
        mjcf_file.export(tmp_path / "boom.xml", crane)
