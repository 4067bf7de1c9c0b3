"""Two cranes at one load: statics, frequencies, energy, another engine, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

from cranedyn.errors import CraneError, OutOfRange, UnknownColumn, UnknownName
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.tandem.clearance import tandem_distances
from cranedyn.lifts.tandem.drives import DriveMotion, TandemDrives
from cranedyn.lifts.tandem.judgement import TandemRequirements, judge_tandem
from cranedyn.lifts.tandem.load import TandemLoad, TandemRope
from cranedyn.lifts.tandem.plan import TandemLift, TandemPlan, plan_tandem
from cranedyn.lifts.tandem.rules import required_capacity
from cranedyn.lifts.tandem.simulation import LoadPose, TandemRun, simulate_tandem
from cranedyn.lifts.tandem.statics import static_shares, sway_frequency, yaw_frequency
from cranedyn.lifts.tandem.yard import tandem_yard
from cranedyn.references.limits import Limits
from cranedyn.verdict import Verdict

G = 9.80665
BEAM = TandemLoad(4000.0, (15.0, 0.6, 0.8), lugs=((-7.0, 0.0, 0.4), (7.0, 0.0, 0.4)))
STIFF = TandemRope(stiffness=2e8, damping=2e5)
SLOW = Limits([0.01, 0.1, 0.2], [0.005, 0.05, 0.1])
USUAL = TandemRope(stiffness=2e7, damping=2e4)


@cache
def yard() -> CraneSite:
    return tandem_yard()


def lift_of(load: TandemLoad = BEAM, rope: TandemRope = STIFF) -> TandemLift:
    return TandemLift(yard(), ("north", "south"), load, rope)


# The beam lies along the line of the towers: north is at y = 0, its X axis points to the south.
YAW = -math.pi / 2.0
START = (0.0, -32.0, 5.0)


@cache
def planned() -> TandemPlan:
    return plan_tandem(lift_of(rope=USUAL), START, (4.0, -32.0, 9.0), yaw=YAW)


@cache
def lifted() -> TandemRun:
    return simulate_tandem(planned().lift, planned(), dt=1e-3)


def held(lift: TandemLift, place: tuple[float, float, float] = START) -> TandemDrives:
    """Drives that stand where a plan that begins at a place begins."""
    goal = (place[0], place[1], place[2] + 1.0)
    plan = plan_tandem(lift, place, goal, yaw=YAW)
    still = []
    for motion in plan.drives:
        position = np.repeat(motion.position[:1], 2, axis=0)
        still.append(DriveMotion(np.array([0.0, 1.0]), position, np.zeros_like(position)))
    return TandemDrives(*still)


def frequency(t: np.ndarray, values: np.ndarray) -> float:
    """Angular frequency by the zero crossings of a swing about zero [rad/s]."""
    from cranedyn.analysis.swing import zero_crossings

    crossings = zero_crossings(t, values)
    return math.pi / float(np.mean(np.diff(crossings)))


@pytest.mark.parametrize(("second", "tilt"), [(7.0, 0.0), (3.0, 0.0), (7.0, 0.1), (5.0, -0.2)])
def test_shares_are_those_of_moments_about_the_centre_of_mass(second: float, tilt: float) -> None:
    load = replace(BEAM, lugs=((-7.0, 0.0, 0.4), (second, 0.0, 0.4)))
    shares = static_shares(load, tilt)
    turned = Rotation.from_euler("y", -tilt).apply(np.array(load.lugs))
    assert shares.sum() == pytest.approx(1.0)
    # Two forces upwards at the lugs have no moment about the centre of mass.
    assert shares @ turned[:, 0] == pytest.approx(0.0, abs=1e-12)


def test_a_load_that_hangs_still_pulls_by_the_shares_of_statics() -> None:
    load = replace(BEAM, lugs=((-7.0, 0.0, 0.4), (4.0, 0.0, 0.4)))
    lift = lift_of(load)
    place = (0.0, -33.5, 5.0)
    still = held(lift, place)
    start = LoadPose(np.array(place), Rotation.from_euler("z", YAW))
    run = simulate_tandem(lift, still, start=start, duration=2.0, dt=1e-3)
    expected = static_shares(load) * load.mass * G
    # The winches take off the stretch, so that it is at rest but for rounding.
    np.testing.assert_allclose(
        run.tensions, np.broadcast_to(expected, run.tensions.shape), rtol=1e-6
    )
    assert np.ptp(run["load_z_m"]) < 1e-6


@pytest.mark.slow
def test_swings_along_the_lugs_and_about_the_vertical_have_the_frequencies_of_a_bifilar() -> None:
    lift = lift_of()
    still = held(lift)
    begins = planned_lengths(still)
    start = LoadPose(np.add(START, (0.0, 0.02, 0.0)), Rotation.from_euler("z", YAW + 0.002))
    run = simulate_tandem(lift, still, start=start, duration=30.0, dt=1e-3)
    sway = frequency(run.t, run["load_y_m"] - START[1])
    yaw = frequency(run.t, run["yaw_rad"] - YAW)
    # The period of small swings, a step of semi-implicit Euler and 5 mm of stretch: 1e-3.
    assert sway == pytest.approx(sway_frequency(begins, G), rel=1e-3)
    assert yaw == pytest.approx(yaw_frequency(BEAM, begins, G), rel=1e-3)


def planned_lengths(still: TandemDrives) -> float:
    """Length of both ropes [m]."""
    first, second = (motion.position[0, -1] for motion in still)
    assert first == pytest.approx(second)
    return float(first)


def test_energy_is_what_the_cranes_put_in_less_what_damping_takes() -> None:
    lift = planned().lift
    errors = []
    for dt in (2e-3, 1e-3):
        run = simulate_tandem(lift, planned(), duration=12.0, dt=dt)
        balance = run["energy_J"] - run["energy_J"][0] - run["input_J"] + run["loss_J"]
        errors.append(np.abs(balance).max())
    # Of order 1: half the step, half the error; the load gains 20 kJ.
    assert errors[1] < 0.6 * errors[0] < 60.0


def test_the_plan_brings_the_load_there_without_swing_and_without_turning() -> None:
    run = lifted()
    after = run.t >= planned().duration
    place = np.stack([run[f"load_{axis}_m"] for axis in "xyz"], axis=1)
    # The stretch of the ropes changes with the acceleration, and the winches change with it.
    np.testing.assert_allclose(place[after], [[4.0, -32.0, 9.0]] * int(after.sum()), atol=2e-3)
    # It leans with its ropes across the line of its lugs, and with nothing left at the end.
    assert np.abs(run["roll_rad"]).max() == pytest.approx(planned().largest_lean, rel=0.1)
    assert np.abs(run["roll_rad"][after]).max() < 5e-4
    assert np.abs(run["pitch_rad"]).max() < 1e-4 and np.ptp(run["yaw_rad"]) < 1e-4
    shares = static_shares(BEAM)
    assert (run.largest_shares > shares).all() and (run.largest_shares < 1.1 * shares).all()


def test_along_its_lugs_a_load_stays_level_and_its_shares_differ() -> None:
    lift = lift_of(rope=USUAL)
    plan = plan_tandem(lift, (0.0, -33.0, 5.0), (0.0, -31.0, 7.0), yaw=YAW)
    run = simulate_tandem(lift, plan, dt=1e-3, duration=round(plan.duration + 5.0))
    after = run.t >= plan.duration
    assert np.abs(run["pitch_rad"]).max() < 1e-4 and np.abs(run["roll_rad"]).max() < 1e-4
    assert np.ptp(run["load_y_m"][after]) < 1e-3
    # The lugs are above the centre of mass, so that the one that is ahead carries more at first.
    early = run.tensions[(run.t > 0.0) & (run.t < plan.duration / 2.0)]
    assert (early[:, 0] - early[:, 1]).max() > 10.0


ASIDE = (0.0, -33.0, 5.0)
"""Where the load of `askew_lift` hangs."""


def askew_lift() -> TandemLift:
    """A beam whose lugs are neither level nor in line with its centre of mass, on soft ropes."""
    load = replace(BEAM, lugs=((-7.0, 0.1, 0.4), (5.0, -0.2, 0.3)))
    return lift_of(load, TandemRope(2e6))


def tendon_model(
    lift: TandemLift, still: TandemDrives, start: LoadPose, run: TandemRun, *, dt: float, rule: str
) -> Any:
    """The load of a run on two tendons, as a model of MuJoCo with a step [s] and an integrator."""
    import mujoco

    load = lift.load
    rope = lift.rope
    pivots = [[run[f"{name}_pivot_{axis}_m"][0] for axis in "xyz"] for name in lift.names]
    lengths = [motion.position[0, -1] for motion in still]
    sites = []
    tendons = []
    for i, (pivot, length) in enumerate(zip(pivots, lengths, strict=True)):
        sites.append(f'<site name="p{i}" pos="{pivot[0]} {pivot[1]} {pivot[2]}"/>')
        tendons.append(
            f'<spatial stiffness="{rope.stiffness / length}" springlength="0 {length}">'
            f'<site site="p{i}"/><site site="l{i}"/></spatial>'
        )
    lugs = "".join(
        f'<site name="l{i}" pos="{lug[0]} {lug[1]} {lug[2]}"/>' for i, lug in enumerate(load.lugs)
    )
    x, y, z, w = start.rotation.as_quat()
    inertia = " ".join(map(str, load.moments))
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt}" integrator="{rule}" gravity="0 0 -{G}"/><worldbody>'
        f'{"".join(sites)}<body name="load" pos="{" ".join(map(str, start.position))}" '
        f'quat="{w} {x} {y} {z}">'
        f'<freejoint/><inertial pos="0 0 0" mass="{load.mass}" diaginertia="{inertia}"/>{lugs}'
        f"</body></worldbody><tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def test_mujoco_moves_the_same_load_on_two_tendons_alike() -> None:
    mujoco = pytest.importorskip("mujoco", reason="extra mujoco is not installed")
    lift = askew_lift()
    still = held(lift, ASIDE)
    start = LoadPose(np.add(ASIDE, (0.3, 0.2, 0.1)), Rotation.from_euler("z", YAW + 0.1))
    dt = 2.5e-4
    run = simulate_tandem(lift, still, start=start, duration=3.0, dt=dt, period=0.05)
    model = tendon_model(lift, still, start, run, dt=dt, rule="RK4")
    data = mujoco.MjData(model)
    positions = [data.qpos[:3].copy()]
    for _ in range(60):
        mujoco.mj_step(model, data, 200)
        positions.append(data.qpos[:3].copy())
    # Semi-implicit Euler is half a step ahead of the rates of RK4: 1 m/s in 0.25 ms are 0.25 mm.
    assert np.ptp(run.centres[:, 2]) > 0.05
    np.testing.assert_allclose(run.centres, positions, atol=1e-3)


@pytest.mark.slow
def test_a_crane_that_is_late_loads_a_rope_more_and_one_that_stops_tilts_the_load() -> None:
    plan = planned()
    late = simulate_tandem(plan.lift, plan.drives.delayed(2.0), start=pose(plan), dt=1e-3)
    assert np.abs(late["yaw_rad"] - YAW).max() > 20.0 * np.abs(lifted()["yaw_rad"] - YAW).max()
    stop = plan.drives._replace(second=plan.drives.second.stopped(2, plan.duration / 2.0, 0.4))
    tilted = simulate_tandem(plan.lift, stop, start=pose(plan), dt=1e-3)
    # North lifts on: the beam hangs askew by the difference of the ropes over 14 m.
    lengths = tilted["north_l_m"][-1] - tilted["south_l_m"][-1]
    tilt = max(abs(tilted["pitch_rad"][-1]), abs(tilted["roll_rad"][-1]))
    assert tilt == pytest.approx(abs(lengths) / 14.0, rel=0.1)


def pose(plan: TandemPlan) -> LoadPose:
    return LoadPose(plan.start, Rotation.from_euler("z", plan.yaw))


def test_a_stop_is_a_ramp_of_its_deceleration_to_rest() -> None:
    t = np.linspace(0.0, 10.0, 11)
    motion = DriveMotion(t, np.stack([t, 2.0 * t], axis=1), np.ones((11, 2)) * [1.0, 2.0])
    stopped = motion.stopped(1, 4.0, 0.5)
    times = np.array([3.0, 4.0, 6.0, 8.0, 9.5])
    position, rate = stopped.at(times)
    np.testing.assert_allclose(position[:, 1], [6.0, 8.0, 11.0, 12.0, 12.0], atol=1e-12)
    np.testing.assert_allclose(rate[:, 1], [2.0, 2.0, 1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(position[:, 0], times, atol=1e-12)


def test_a_slack_rope_does_not_push() -> None:
    rope = TandemRope(1e6, 1e5)
    up = np.array([0.0, 0.0, 10.0])
    still = np.zeros(3)
    assert rope.force(up, still, np.zeros(3), still, 10.5, 0.0).tension == 0.0
    # Taut by 1 mm, and the lug rises by 1 m/s: the damper would push.
    falling = rope.force(up, still, np.zeros(3), np.array([0.0, 0.0, 1.0]), 9.999, 0.0)
    assert falling.tension == 0.0 and falling.loss >= 0.0


def test_the_judgement_compares_shares_charts_ropes_and_distances() -> None:
    checks = judge_tandem(lifted(), TandemRequirements(inclination=math.radians(3.0)))
    words = {check.sentence.split(":")[0]: check.verdict for check in checks}
    failing = [check.sentence for check in checks if check.verdict is Verdict.FAILS]
    assert not failing
    unknown = [check.sentence for check in checks if check.verdict is Verdict.NOT_JUDGED]
    assert unknown == [
        "The lift is simulated in calm air; nobody entered a wind.",
        "Efforts of the drives other than the hoists are not computed.",
    ]
    assert words["north"] is Verdict.HOLDS and words["south"] is Verdict.HOLDS
    heavier = replace(lifted().lift.load, mass=9000.0)
    overloaded = replace(lifted(), lift=replace(lifted().lift, load=heavier))
    assert any("asks for" in c.sentence and c.holds is False for c in judge_tandem(overloaded))


def test_what_nobody_entered_is_not_judged() -> None:
    lift = replace(lifted().lift, site=replace(yard(), entered=frozenset()))
    checks = judge_tandem(replace(lifted(), lift=lift))
    unjudged = [check.sentence for check in checks if check.verdict is Verdict.NOT_JUDGED]
    assert any("nobody entered how far they may" in sentence for sentence in unjudged)
    assert sum("nobody entered what is required" in sentence for sentence in unjudged) == 6


def test_distances_are_those_of_the_posture_by_hand() -> None:
    found = {entry.between: entry.distance for entry in tandem_distances(lifted())}
    assert found["the load and the ground"] == pytest.approx(5.0 - 0.4, abs=1e-3)
    # Both ropes hang 14 m apart, and each jib ends beyond its rope.
    assert 0.0 < found["north and the rope of south"] < 10.0
    assert 0.0 < found["north and south"] < 8.0


def test_a_code_of_practice_asks_for_a_fifth_more_of_two_cranes() -> None:
    assert [required_capacity(1.0, count) for count in (2, 3, 4, 7)] == [1.2, 1.33, 1.5, 1.5]
    with pytest.raises(OutOfRange, match="number of cranes is 1"):
        required_capacity(1.0, 1)


def test_a_lift_that_cannot_be_is_refused() -> None:
    lift = lift_of()
    with pytest.raises(UnknownName, match="no crane 'east'; there are north, south"):
        TandemLift(yard(), ("north", "east"), BEAM, STIFF)
    with pytest.raises(OutOfRange, match="two different ones"):
        TandemLift(yard(), ("north", "north"), BEAM, STIFF)
    with pytest.raises(CraneError, match=r"north does not reach its lug at \(50\.00"):
        plan_tandem(lift, (50.0, -32.0, 5.0), (50.0, -32.0, 6.0), yaw=YAW)
    with pytest.raises(CraneError, match=r"needs .* m of rope .* its hoist has"):
        plan_tandem(lift, (0.0, -32.0, -5.0), (0.0, -32.0, -4.0), yaw=YAW)
    with pytest.raises(OutOfRange, match=r"duration of a tandem lift is 3 s; allowed is 7\."):
        plan_tandem(lift, START, (4.0, -32.0, 9.0), yaw=YAW, duration=3.0)
    with pytest.raises(OutOfRange, match=r"longer: drives would exceed their limits"):
        slower = replace(lift, limits=(SLOW, SLOW))
        plan_tandem(slower, START, (4.0, -32.0, 9.0), yaw=YAW, duration=12.0)
    with pytest.raises(OutOfRange, match="distance from start to goal"):
        plan_tandem(lift, START, START, yaw=YAW)
    with pytest.raises(OutOfRange, match="start of the load"):
        simulate_tandem(lift, planned().drives)
    with pytest.raises(OutOfRange, match="mass of the load"):
        replace(BEAM, mass=math.nan)
    with pytest.raises(OutOfRange, match="2 or more, increasing"):
        DriveMotion(np.zeros(2), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(OutOfRange, match="drive that stops is 3; allowed is 0 to 2"):
        planned().drives.first.stopped(3, 1.0, 0.4)
    with pytest.raises(UnknownColumn):
        lifted()["nothing"]


def test_slower_drives_take_longer() -> None:
    lift = replace(lift_of(rope=USUAL), limits=(SLOW, SLOW))
    plan = plan_tandem(lift, START, (4.0, -32.0, 9.0), yaw=YAW)
    assert plan.duration > 1.5 * planned().duration


def test_a_recording_shows_both_cranes_the_ropes_and_the_load_where_they_are(
    tmp_path: Path,
) -> None:
    from cranedyn.lifts.tandem.recording import record_tandem
    from tests.rrd import rows

    file = record_tandem(tmp_path / "tandem.rrd", lifted())
    t, places = rows(file, "scene/load", "Transform3D:translation")
    last = int(np.searchsorted(lifted().t, 1e-9 * t[-1] - 1e-6))
    expected = [lifted()[f"load_{axis}_m"][last] for axis in "xyz"]
    np.testing.assert_allclose(places[-1], expected, atol=1e-5)
    _, ropes = rows(file, "south", "LineStrips3D:strips")
    pivot = [lifted()[f"south_pivot_{axis}_m"][last] for axis in "xyz"]
    np.testing.assert_allclose(ropes[-1, :3], pivot, atol=1e-4)
    _, tension = rows(file, "north", "Scalars:scalars")
    np.testing.assert_allclose(tension[:, 0], lifted()["north_tension_N"])


def test_a_recording_of_numbers_that_are_not_finite_is_refused(tmp_path: Path) -> None:
    from cranedyn.lifts.tandem.recording import record_tandem

    broken = {**lifted().values, "load_x_m": np.full(len(lifted()), np.nan)}
    with pytest.raises(OutOfRange, match="load"):
        record_tandem(tmp_path / "tandem.rrd", replace(lifted(), values=broken))
    assert not (tmp_path / "tandem.rrd").exists()
