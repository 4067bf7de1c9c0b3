"""Cylinders against Pinocchio's frames, virtual work and hand statics; pumps against their flow."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.controllers.pump_limited import PumpLimited
from cranedyn.dynamics.cylinders import (
    Cylinder,
    Pump,
    cylinder_columns,
    cylinder_values,
    read_cylinders,
)
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import ModelError, OutOfRange, UnknownName
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT

MOBILE = XACRO.with_name("mobile_crane.urdf.xacro")

FOOT = np.array([0.0, 0.1, 0.1])
"""Foot of the luffing cylinder in the frame of the superstructure [m]: 1.5 m ahead of the hinge at
y = 1.6 m and 1.2 m below it at z = 1.3 m."""

HEAD = np.array([0.0, -4.2, -0.5])
"""Its head in the frame of the boom [m]."""


@cache
def crane() -> Crane:
    return load_crane(MOBILE)


@cache
def luffing() -> Cylinder:
    return read_cylinders(crane())[0]


def distance_by_pinocchio(crane: Crane, q: np.ndarray) -> float:
    """Distance of foot and head in the world, by the frames of the links that carry them."""
    data = crane.model.createData()
    pin.framesForwardKinematics(crane.model, data, q)
    points = []
    for link, point in (("upper_link", FOOT), ("boom_link", HEAD)):
        frame = crane.model.getFrameId(link, pin.FrameType.BODY)
        points.append(data.oMf[frame].act(point))
    return float(np.linalg.norm(points[1] - points[0]))


@pytest.mark.parametrize("luff", [0.18, 0.5, 1.0, 1.42])
def test_the_length_of_a_cylinder_is_the_distance_of_its_points_in_pinocchios_frames(
    luff: float,
) -> None:
    q = crane().state(luff=luff, slew=0.7).q
    assert float(luffing().length(luff)) == pytest.approx(distance_by_pinocchio(crane(), q))
    # The lever arm is the slope of that distance.
    step = 1e-6
    ends = [distance_by_pinocchio(crane(), crane().state(luff=luff + s).q) for s in (-step, step)]
    slope = (ends[1] - ends[0]) / (2.0 * step)
    assert float(luffing().lever_arm(luff)) == pytest.approx(slope, rel=1e-8)


def test_the_lever_arm_is_the_distance_of_the_hinge_from_the_line_of_the_cylinder() -> None:
    """In the plane of the boom, the hinge at the origin: foot, and head turned up by the angle."""
    luff = 0.8
    foot = np.array([1.5, -1.2])
    ahead = np.array([np.cos(luff), np.sin(luff)])
    below = np.array([np.sin(luff), -np.cos(luff)])
    head = 4.2 * ahead + 0.5 * below
    along = (head - foot) / np.linalg.norm(head - foot)
    arm = abs(foot[0] * along[1] - foot[1] * along[0])
    assert float(luffing().lever_arm(luff)) == pytest.approx(arm)
    assert float(luffing().length(luff)) == pytest.approx(np.linalg.norm(head - foot))


def test_a_cylinder_works_as_its_joint_does() -> None:
    """Virtual work: force times the rate of the length is torque times the rate of the joint."""
    q = np.linspace(0.17, 1.43, 50)
    torque = 1e6 * np.cos(q)
    rate = 0.02 * np.sin(3.0 * q)
    step = 1e-6
    length_rate = rate * (luffing().length(q + step) - luffing().length(q - step)) / (2.0 * step)
    work = luffing().force(q, torque) * length_rate
    np.testing.assert_allclose(work, torque * rate, rtol=1e-7, atol=1e-3)


def test_a_cylinder_out_of_the_plane_is_longer_and_has_less_arm(tmp_path: Path) -> None:
    text = crane().urdf.replace('foot="0 0.1', 'foot="0.9 0.1')
    assert text != crane().urdf
    path = tmp_path / "aside.urdf"
    path.write_text(text)
    aside = read_cylinders(load_crane(path))[0]
    flat = luffing()
    assert float(aside.length(0.8)) == pytest.approx(np.hypot(float(flat.length(0.8)), 0.9))
    ratio = float(flat.length(0.8)) / float(aside.length(0.8))
    assert float(aside.lever_arm(0.8)) == pytest.approx(ratio * float(flat.lever_arm(0.8)))


def test_the_columns_of_a_run_at_rest_are_those_of_statics() -> None:
    run = simulate(crane(), hold_controller(crane()), duration=0.05, engine="pinocchio")
    columns = cylinder_columns(crane(), run)
    holding = holding_effort(crane(), crane().resting(crane().start.q))
    force = holding[1] / float(luffing().lever_arm(1.0))
    assert columns["luff_cylinder_force_N"][0] == pytest.approx(force, rel=1e-6)
    assert force > 0.0  # it pushes the boom up
    assert columns["luff_cylinder_pressure_Pa"][0] == pytest.approx(force / 0.08, rel=1e-6)
    assert columns["luff_cylinder_length_m"][0] == pytest.approx(float(luffing().length(1.0)))
    assert columns["telescope_cylinder_force_N"][0] == pytest.approx(holding[2], rel=1e-6)
    assert columns["telescope_cylinder_length_m"][0] == pytest.approx(5.0)


def test_a_crane_whose_telescope_is_held_keeps_its_other_cylinder() -> None:
    held = load_crane(MOBILE, locked={"telescope_joint": 6.0})
    (kept,) = read_cylinders(held)
    assert kept.symbol == "luff"
    assert float(kept.length(0.9)) == pytest.approx(float(luffing().length(0.9)))
    assert read_cylinders(load_crane()) == []


def test_a_joint_turns_as_fast_as_its_piston_lets_it() -> None:
    q = np.array([0.3, 1.2])
    rates = luffing().joint_rate(q, 0.05)
    np.testing.assert_allclose(rates * luffing().lever_arm(q), 0.05)
    with pytest.raises(OutOfRange, match="speed of the piston"):
        luffing().joint_rate(0.3, -1.0)


MOTORS = {"slew": 2e-3, "l": 1e-2}
"""Oil of slew and winch [m³/rad, m³/m]."""


def test_drives_that_share_a_pump_slow_down_alike_to_its_flow() -> None:
    pump = Pump(crane(), 3e-3, MOTORS)
    q = crane().state(luff=0.6).q
    rates = np.array([0.1, 0.02, -0.05, 0.3])
    arm = float(luffing().lever_arm(0.6))
    oil = 2e-3 * 0.1 + 0.08 * arm * 0.02 + 0.02 * 0.05 + 1e-2 * 0.3
    assert oil > 3e-3
    limited = pump.limited(q, rates)
    np.testing.assert_allclose(limited, rates * 3e-3 / oil, rtol=1e-12)
    few = np.array([0.1, 0.0, 0.0, 0.2])
    assert pump.limited(q, few).tolist() == few.tolist()
    # A slew on a pump of its own is not slowed down.
    without_slew = Pump(crane(), 3e-3, {"l": 1e-2}).limited(q, rates)
    assert without_slew[0] == 0.1
    assert without_slew[3] < 0.3
    assert Pump(crane(), 0.0, MOTORS).limited(q, rates).tolist() == [0.0, 0.0, 0.0, 0.0]


def test_a_pump_divides_its_flow_among_many_cranes_as_among_each_alone() -> None:
    pump = Pump(crane(), 3e-3, MOTORS)
    rng = np.random.default_rng(0)
    q = np.array([crane().state(luff=luff).q for luff in rng.uniform(0.3, 1.3, 7)])
    rates = rng.uniform(-0.3, 0.3, (7, 4))
    rates[3] = 0.0
    together = pump.limited(q, rates)
    for i in range(7):
        np.testing.assert_allclose(together[i], pump.limited(q[i], rates[i]), rtol=1e-14)


def test_a_regulated_pump_gives_less_oil_to_a_heavier_load() -> None:
    """Its flow times the pressure of the luffing cylinder, by statics, is its power."""
    q = crane().hanging(crane().state(luff=0.4).q)
    cylinder = luffing()
    force = float(cylinder.force(0.4, holding_effort(crane(), q)[1]))
    pressure = force / cylinder.area
    raised = np.array([0.0, 0.03, 0.0, 0.0])
    pump = Pump(crane(), 3e-3, MOTORS, power=1e4)
    assert float(pump.pressure(q, raised)) == pytest.approx(pressure, rel=1e-12)
    rate = pump.limited(q, raised)[1]
    oil = float(cylinder.volume(0.4)) * rate
    assert oil * pressure == pytest.approx(1e4, rel=1e-12)
    assert oil < 3e-3
    # The power that goes into the load is that of the joint.
    assert holding_effort(crane(), q)[1] * rate == pytest.approx(1e4, rel=1e-12)


def test_a_boom_that_is_lowered_needs_no_power() -> None:
    q = crane().hanging(crane().state(luff=0.4).q)
    lowered = np.array([0.0, -0.03, 0.0, 0.0])
    assert float(Pump(crane(), 3e-3, MOTORS, power=1.0).pressure(q, lowered)) == 0.0
    without = Pump(crane(), 3e-3, MOTORS).limited(q, lowered)
    regulated = Pump(crane(), 3e-3, MOTORS, power=1.0).limited(q, lowered)
    np.testing.assert_array_equal(regulated, without)


def test_the_heaviest_loaded_drive_sets_the_pressure_for_all() -> None:
    q = crane().hanging(crane().state(luff=0.4).q)
    held = holding_effort(crane(), q)
    # The hoist holds its load upwards against a coordinate that counts downwards.
    both = np.array([0.0, 0.02, 0.0, -0.1])
    pump = Pump(crane(), 3e-3, MOTORS, power=2e4)
    volumes = pump.volumes(q)
    pressures = [abs(held[drive]) / volumes[drive] for drive in (1, 3)]
    assert float(pump.pressure(q, both)) == pytest.approx(max(pressures), rel=1e-12)
    limited = pump.limited(q, both)
    taken = float(volumes @ np.abs(limited))
    assert taken == pytest.approx(2e4 / max(pressures), rel=1e-12)
    many = pump.limited(np.array([q, q]), np.array([both, 0.1 * both]))
    np.testing.assert_allclose(many[0], limited, rtol=1e-14)


@pytest.mark.parametrize("power", [0.0, -1.0, float("nan")])
def test_a_pump_without_power_is_refused(power: float) -> None:
    with pytest.raises(OutOfRange, match="power of the pump"):
        Pump(crane(), 3e-3, MOTORS, power=power)


@pytest.mark.slow
def test_cylinders_of_a_batch_are_those_of_each_run() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    from cranedyn.compiled.batch import simulate_batch

    starts = [crane().state(luff=0.8, telescope=2.0), crane().state(luff=0.9, telescope=4.0)]
    held = hold_controller(crane())
    batch = simulate_batch(crane(), held, start=starts, duration=0.5, record=10)
    columns = cylinder_values(crane(), batch.q, batch.v, batch.effort)
    for i, start in enumerate(starts):
        run = simulate(crane(), held, start=start, duration=0.5, engine="compiled")
        alone = cylinder_columns(crane(), run)
        for name, values in columns.items():
            # The last row of a run keeps the effort of the row before.
            np.testing.assert_allclose(values[i][:-1], alone[name][::10][:-1], rtol=1e-9, atol=1e-6)


def test_a_run_commands_no_more_than_its_pump_gives() -> None:
    pump = Pump(crane(), 2e-3, MOTORS)
    asked = np.array([0.15, 0.03, 0.08, 0.3])
    commands = []

    def command(t: float, state: object, setpoint: object) -> np.ndarray:
        return asked

    limited = PumpLimited(pump, command)

    def noted(t: float, state: object, setpoint: object) -> np.ndarray:
        rates = limited(t, state, setpoint)  # type: ignore[arg-type]
        commands.append(float(pump.volumes(state.q) @ np.abs(rates)))  # type: ignore[attr-defined]
        return rates

    simulate(crane(), noted, duration=0.2, drive="velocity", engine="pinocchio")
    assert max(commands) == pytest.approx(2e-3)


def changed(folder: Path, old: str, new: str) -> Crane:
    text = crane().urdf
    assert text.count(old) == 1
    path = folder / "changed.urdf"
    path.write_text(text.replace(old, new))
    return load_crane(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('area="0.08"', 'area="0"', "The area of .* of luff_joint is 0; allowed is a number above"),
        ('area="0.08"', 'area="inf"', "The area of .* is inf"),
        ('head="0 -4.2 -0.5"', "", "The head of the .* of luff_joint is"),
        ('head="0 -4.2 -0.5"', 'head="0 -4.2"', "allowed are three numbers"),
        ('head="0 -4.2 -0.5"', 'head="0 nan 1"', "allowed are three numbers"),
        ('head="0 -4.2 -0.5"', 'head="2 0 0"', "Foot and head .* 0 m from its axis"),
        ('head="0 -4.2 -0.5"', 'head="0 -4.2 -5"', "no lever arm at 0.197.* where foot, hinge and"),
        ('area="0.02"', 'area="0.02" foot="0 0 0"', "lies along a prismatic joint; leave out"),
        (
            '<gazebo reference="telescope_joint">',
            '<gazebo reference="luff_joint">',
            "luff_joint has two",
        ),
        (
            '<gazebo reference="telescope_joint">',
            '<gazebo reference="mast_joint">',
            "mast_joint, which is no joint that moves",
        ),
    ],
)
def test_what_is_no_cylinder_is_refused_in_a_sentence(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=words):
        read_cylinders(changed(tmp_path, old, new))


def test_what_is_no_pump_is_refused_in_a_sentence() -> None:
    with pytest.raises(UnknownName, match="There is no drive 'winch'"):
        Pump(crane(), 1e-3, {"winch": 1e-2})
    with pytest.raises(ModelError, match="luff has a cylinder, and is given a motor, too"):
        Pump(crane(), 1e-3, {"luff": 1e-2})
    with pytest.raises(ModelError, match="No drive takes oil of the pump"):
        Pump(load_crane(ROOT / "examples" / "portal_crane.urdf"), 1e-3, {})
    with pytest.raises(OutOfRange, match="flow of the pump"):
        Pump(crane(), -1e-3, MOTORS)
