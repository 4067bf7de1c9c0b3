"""Where a crane hangs at rest: solved from gravity and springs, not assumed to be at zero."""

from __future__ import annotations

import math
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import lqr
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.dynamics.validity import events
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST


def _link(name: str, mass: float, centre: str, inertia: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )


def _joint(name: str, kind: str, links: str, place: str, axis: str, low: float, high: float) -> str:
    parent, child = links.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" effort="1e7" velocity="5"/></joint>'
    )


def _driven(**places: float) -> str:
    joints = "".join(
        f'<joint name="{name}"><command_interface name="effort"/><state_interface name="position">'
        f'<param name="initial_value">{place}</param></state_interface></joint>'
        for name, place in places.items()
    )
    return f'<ros2_control name="drives" type="system">{joints}</ros2_control>'


LUFFING = (
    '<robot name="luffing"><link name="mast"/>'
    + _joint("slew", "revolute", "mast upper", "0 0 30", "0 0 1", -3.0, 3.0)
    + _link("upper", 5000.0, "0 0 0", 1e5)
    + _joint("luff", "revolute", "upper boom", "0 0 0", "-1 0 0", 0.1, 1.3)
    + _link("boom", 4000.0, "0 -15 0", 3e5)
    + _joint("swing_out", "revolute", "boom ring", "0 -30 0", "-1 0 0", -3.1, 3.1)
    + _link("ring", 20.0, "0 0 0", 2.0)
    + _joint("swing_side", "revolute", "ring fork", "0 0 0", "0 1 0", -3.1, 3.1)
    + _link("fork", 20.0, "0 0 0", 2.0)
    + _joint("rope", "prismatic", "fork load", "0 0 0", "0 0 -1", 2.0, 25.0)
    + _link("load", 2000.0, "0 0 0", 500.0)
    + _driven(slew=0.0, luff=0.6, rope=12.0)
    + "</robot>"
)
"""A boom of 30 m that luffs, with the swing joints at its head."""

ECCENTRIC = (
    '<robot name="gantry"><link name="beam"/>'
    + _joint("trolley", "prismatic", "beam cart", "0 0 20", "1 0 0", 0.0, 30.0)
    + _link("cart", 500.0, "0 0 0", 50.0)
    + _joint("swing", "revolute", "cart fork", "0 0 0", "0 -1 0", -1.5, 1.5)
    + _link("fork", 10.0, "0 0 0", 1.0)
    + _joint("rope", "prismatic", "fork load", "0 0 0", "0 0 -1", 2.0, 18.0)
    + _link("load", 1000.0, "0.02 0 0", 100.0)
    + _driven(trolley=5.0, rope=10.0)
    + "</robot>"
)
"""A gantry whose load has its centre of mass 2 cm beside the rope."""


@cache
def loaded(text: str) -> Crane:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crane.urdf"
        path.write_text(text, encoding="utf-8")
        return load_crane(path)


both = pytest.mark.parametrize("text", [LUFFING, ECCENTRIC], ids=["luffing", "eccentric"])


def test_a_load_hangs_plumb_below_the_head_of_a_boom_and_its_centre_of_mass_below_its_pivot() -> (
    None
):
    crane = loaded(LUFFING)
    for luff in (0.2, 0.6, 1.1):
        # rounding of some angles
        assert_allclose(crane.state(luff=luff).q[2:4], [-luff, 0.0], atol=1e-14)
        assert_allclose(crane.swing_angles(crane.state(luff=luff).q), 0.0, atol=1e-14)
    gantry = loaded(ECCENTRIC)
    for rope in (5.0, 10.0, 15.0):
        q = gantry.state(rope=rope).q
        assert q[1] == pytest.approx(-math.atan2(0.02, rope), rel=1e-12)
        assert payload_position(gantry, q)[0] == pytest.approx(5.0, abs=1e-12)
        # to first order about 10 m of rope: its second derivative is 2 · 0.02 / rope³
        assert abs(gantry.swing_angles(q)[0]) <= 0.02 * (rope - 10.0) ** 2 / 5.0**3 + 1e-8


def test_a_load_that_hangs_plumb_at_zero_is_left_there_exactly() -> None:
    crane = load_crane()
    assert crane.state(gamma=0.7, x=13.0, l=9.0).q.tolist() == [0.7, 13.0, 0.0, 0.0, 9.0]
    assert not crane.rest.angle.any() and not crane.rest.slope.any()


def test_what_would_fall_does_not_hang_and_starts_where_its_description_says() -> None:
    upright = loaded(
        ECCENTRIC.replace('axis xyz="0 0 -1"', 'axis xyz="0 0 1"').replace("0.02 0 0", "0 0 0")
    )
    assert not upright.rest.hangs
    assert upright.start.q.tolist() == [5.0, 0.0, 10.0]
    stuck = loaded(ECCENTRIC.replace('lower="-1.5"', 'lower="0.1"'))
    assert not stuck.rest.hangs
    with pytest.raises(ModelError, match="does not hang at rest within the ranges of its joints"):
        stuck.hanging(np.array([5.0, 0.5, 10.0]))


@pytest.mark.slow
@both
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_an_lqr_about_rest_moves_no_load_that_hangs_at_rest(text: str, engine: EngineName) -> None:
    crane = loaded(text)
    controller = lqr(crane, hanging_reference(crane, hold(crane), 5.0))
    run = simulate(crane, controller, hold(crane), duration=5.0, engine=engine)
    # rounding of 30 m
    assert_allclose(
        payload_position(crane, run.q[-1]), payload_position(crane, crane.start.q), atol=1e-12
    )


@pytest.mark.slow
@both
def test_a_move_of_least_time_ends_at_rest_where_the_load_hangs(text: str) -> None:
    pytest.importorskip("casadi", reason="extra optimal (casadi) is not installed")
    from cranedyn.lifts.planning.optimal import optimal

    crane = loaded(text)
    swing = 0.05
    if text is LUFFING:
        goal = crane.state(luff=0.8, slew=0.3)
        limits = Limits((0.05, 0.02, 0.5), (0.01, 0.01, 0.3))
    else:
        goal = crane.state(trolley=9.0, rope=8.0)
        limits = Limits((1.0, 0.5), (0.3, 0.3))
    motion = optimal(crane, crane.start, goal, limits, swing=swing)
    # between the points of the plan a parabola, and rest to first order in the drives
    assert np.abs(crane.swing_angles(motion.q)).max() < 1.01 * swing + 2e-4
    duration = 5e-3 * math.ceil(motion.arrival / 5e-3) + 10.0
    run = simulate(crane, lqr(crane, motion), motion, duration=duration, engine=FAST)
    left = np.abs(run.since(motion.arrival).q - goal.q).max()
    # commands that are held for 5 ms come half of it late: ω T/2 of the swing on the way
    assert left < math.sqrt(crane.gravity / 8.0) * 2.5e-3 * swing


GOALS = {LUFFING: {"luff": 1.1, "slew": 0.3, "rope": 8.0}, ECCENTRIC: {"trolley": 9.0, "rope": 5.0}}
RATES = {
    LUFFING: Limits((0.05, 0.02, 0.5), (0.01, 0.01, 0.3)),
    ECCENTRIC: Limits((1.0, 0.5), (0.3, 0.3)),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        # tests/compiled/test_horizon_model.py has a boom that luffs in the default run.
        pytest.param(LUFFING, marks=pytest.mark.long, id="luffing"),
        pytest.param(ECCENTRIC, id="eccentric"),
    ],
)
def test_predictive_control_takes_a_load_to_where_it_hangs(text: str) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    from cranedyn.compiled.batch import simulate_batch
    from cranedyn.compiled.horizon.receding import receding

    crane = loaded(text)
    goal = crane.state(**GOALS[text])
    batch = simulate_batch(
        crane,
        receding(crane, RATES[text]),
        hold(crane, goal),
        start=[crane.start, goal],
        duration=60.0,
        record=1,
    )
    assert not batch.failures.any()
    # Where it hangs for the goal is solved by a step of Newton's method; then 60 s of decay.
    assert np.abs(batch.end.q - goal.q).max() < 1e-8
    # A bound of 0.1 rad from where it hangs, which is known to first order about the start.
    assert np.abs(crane.swing_angles(batch.q)).max() < 0.1


@pytest.mark.slow
def test_the_swing_of_a_run_counts_from_where_the_load_hangs() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    from cranedyn.compiled.batch import simulate_batch

    crane = loaded(LUFFING)
    controller = lqr(crane, hanging_reference(crane, hold(crane), 1.0))
    batch = simulate_batch(crane, controller, hold(crane), start=[crane.start] * 2, duration=1.0)
    assert (batch.peak_swing < 1e-12).all()  # rounding; the joint is at -0.6 rad
    with pytest.raises(
        OutOfRange, match=r"swing_out at the start is 1.0 rad; allowed is .* to 0.97"
    ):
        crane.state(luff=0.6, swing_out=-0.6 + 1.6, swing_side=0.0)
    q = crane.state(luff=0.6, swing_side=0.0).q.copy()
    q[crane.layout.index("swing_out")] = -0.6 + 1.6
    start = State(q, np.zeros(crane.layout.n))
    run = simulate(
        crane, controller, hold(crane), start=start, duration=0.1, validity="mark", engine=FAST
    )
    assert "swing_out swings by 1.6 rad" in events(crane, run)[0].words
    assert run.valid[0] == 0.0
