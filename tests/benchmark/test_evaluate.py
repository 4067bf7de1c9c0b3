"""What an entry measures, and what is measured of its runs."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.benchmark import baselines
from cranedyn.benchmark.entry import Briefing, Declined, Entry, briefing_of
from cranedyn.benchmark.entry_kinds import open_entry
from cranedyn.benchmark.evaluate import (
    InstanceResult,
    Variant,
    operator_travel,
    run_instance,
    violation,
)
from cranedyn.benchmark.sensors import SensorChain, SensorReading
from cranedyn.benchmark.task import Instance, instances, select_tasks
from cranedyn.errors import RunError
from tests.benchmark.toys import InThisProcess, still, towards_goal, toy, toy_instance


def run(instance: Instance, entry: object = still) -> tuple[InstanceResult, InThisProcess]:
    """The result of an instance, and the entry in this process."""
    process = InThisProcess(entry)  # type: ignore[arg-type]
    return run_instance(instance, process), process  # type: ignore[arg-type]


def with_sensors(instance: Instance, **values: float) -> Instance:
    """An instance whose task has other sensors."""
    task = instance.task
    return replace(instance, task=replace(task, sensors=task.sensors._replace(**values)))


# --- sensors --------------------------------------------------------------------------------------


def readings(instance: Instance, count: int = 6) -> list[SensorReading]:
    """Readings of a trolley that runs at 0.1 m/s, with a swing of 0.1 rad/s."""
    crane = instance.task.crane()
    sensors = SensorChain(instance, crane)
    found = []
    for i in range(count):
        t = i * instance.task.period
        state = crane.state(bridge=0.2, x=0.7 + 0.1 * t, phi=0.1 * t, l=0.5, x_dot=0.1, phi_dot=0.1)
        found.append(sensors.read(t, state))
    return found


def test_a_reading_without_noise_is_the_state_a_period_ago() -> None:
    for i, reading in enumerate(readings(toy_instance("move"))):
        then = max(i - 1, 0) * 0.02
        assert reading.t == i * 0.02
        assert reading.position == pytest.approx([0.2, 0.7 + 0.1 * then, 0.5], abs=1e-12)
        assert reading.rate == pytest.approx([0.0, 0.1, 0.0], abs=1e-12)
        assert reading.swing == pytest.approx([0.1 * then, 0.0], abs=1e-12)
        assert reading.swing_rate == pytest.approx([0.1, 0.0], abs=1e-12)
        assert not reading.operator.any()


def test_a_longer_rope_a_bias_and_a_delay_are_in_the_readings() -> None:
    differing = toy_instance("move", rope_offset=0.03, swing_bias=-0.01, more_delay=1.6)
    last = readings(differing)[-1]
    assert last.position[2] == pytest.approx(0.47)
    # A delay of one period and 1.6 more, which is rounded to two.
    assert last.swing == pytest.approx([0.1 * 0.04 - 0.01, -0.01], abs=1e-12)


def test_readings_stay_during_an_outage() -> None:
    found = readings(toy_instance("move", outage=0.05, outage_at=0.05))
    positions = [reading.position[1] for reading in found]
    # Measured at 0, 0.02 and 0.04 s; no more from 0.06 to 0.08 s; again at 0.1 s.
    assert positions == pytest.approx([0.7, 0.7, 0.702, 0.702, 0.702, 0.704], abs=1e-12)


def test_noise_and_resolution_are_those_of_the_task() -> None:
    coarse = with_sensors(toy_instance("move"), position_step=0.01, swing_step=0.004)
    reading = readings(coarse)[-1]
    assert reading.position == pytest.approx([0.2, 0.71, 0.5], abs=1e-12)
    assert reading.swing == pytest.approx([0.008, 0.0], abs=1e-12)

    noisy = with_sensors(toy_instance("move", noise_factor=3.0), noise=2.0)
    crane = noisy.task.crane()
    sensors = SensorChain(noisy, crane)
    state = crane.state(bridge=0.2, x=0.7, l=0.5)
    swings = np.array([sensors.read(0.02 * i, state).swing for i in range(2000)])
    # 1 mrad times 6; the standard deviation of 4,000 numbers is right to 1.1 %, five times which
    # is allowed.
    assert swings.std() == pytest.approx(6e-3, rel=0.055)


# --- measured ------------------------------------------------------------------------------------


def test_a_load_on_a_ship_swings_though_its_drives_stand_and_the_ship_is_not_measured() -> None:
    (task,) = select_tasks(["ship/move"])
    short = replace(task, duration=6.0, sensors=task.sensors._replace(noise=0.0))
    nominal = instances(task)[0]
    at_sea, process = run(replace(nominal, task=short))
    on_land, _ = run(replace(nominal, task=replace(short, sea=None)))
    assert process.briefing is not None
    assert process.briefing.sea == task.sea
    # A roll of some mrad, and the acceleration of the boom's head, which is 28 m above the deck.
    assert 2e-3 < at_sea.metrics["swing_rad"] < 0.1
    assert on_land.metrics["swing_rad"] < 1e-3 * at_sea.metrics["swing_rad"]
    # The encoders of the drives see nothing of it.
    start = process.readings[0].position
    for reading in process.readings:
        assert reading.position == pytest.approx(start, abs=2e-4)


def test_the_swing_period_of_a_load_on_a_sling_is_that_of_rope_and_sling() -> None:
    (task,) = select_tasks(["hook/move"])
    told = briefing_of(task)
    assert len(told.crane.swings) == 4
    assert told.swing_period == pytest.approx(
        2.0 * math.pi * math.sqrt((13.0 + 5.0) / told.crane.gravity)
    )


def test_an_entry_gets_sensors_only_and_is_told_the_nominal_crane() -> None:
    heavy = toy_instance("move", payload_factor=1.5, rope_offset=0.05)
    result, process = run(heavy, towards_goal)
    assert process.briefing is not None
    assert process.briefing.crane.payload_mass == pytest.approx(1.0)
    # The drum pays out what it is told to; the load hangs lower, and so does its goal.
    assert process.readings[0].position == pytest.approx([0.2, 0.7, 0.5], abs=1e-9)
    assert result.status == "passed"


def test_a_free_swing_is_measured_as_it_is() -> None:
    """Two swing angles of 0.03 rad together are 0.03 √2; the load is never near its goal."""
    result, _ = run(toy_instance("move", start_swing=0.03))
    assert result.status == "failed"
    assert "did not stay within 0.02 m" in result.reason
    assert result.metrics["swing_rad"] == pytest.approx(0.03 * math.sqrt(2.0), rel=1e-3)
    assert result.metrics["work_J"] == pytest.approx(0.0, abs=1e-4)
    assert "settled_s" not in result.metrics


def test_the_work_of_hoisting_is_that_of_the_weight() -> None:
    """A load of 1 kg by 0.1 m: m g h; the rest is kinetic energy that brakes take back, of which
    the drive puts in m v²/2 at most.
    """
    result, _ = run(toy_instance("move"), towards_goal)
    assert result.status == "passed"
    weight = 1.0 * 9.80665 * 0.1
    # The load hangs on a rope of little mass: the crane's links below the trolley weigh 2 g.
    assert weight * 0.97 < result.metrics["work_J"] < weight * 1.01 + 0.5 * 0.3**2
    # Settled when 0.02 m are left of 0.1 m: the proportional loop at 2/s takes ln 5 / 2 = 0.8 s and
    # the lag, delay and ramp of the drive, which are 0.2 s together.
    assert math.log(5.0) / 2.0 < result.metrics["settled_s"] < math.log(5.0) / 2.0 + 0.25


def test_the_error_on_a_path_is_the_distance_of_the_load_from_it() -> None:
    """Drives that stand still are as far from the path as it is long, 0.1 m."""
    result, _ = run(toy_instance("path"))
    assert result.status == "failed"
    assert result.metrics["error_m"] == pytest.approx(0.1, abs=1e-6)
    assert result.reason == "The load was 0.1 m from its place; allowed is 0.08 m."


def test_the_settling_in_wind_counts_from_the_end_of_the_gusts() -> None:
    task = toy("wind")
    assert task.counts_from == 1.5
    calm, _ = run(toy_instance("wind", gust_factor=0.0))
    assert calm.status == "passed"
    assert calm.metrics["settled_s"] == 0.0
    assert calm.metrics["error_m"] < 1e-6
    blown, _ = run(toy_instance("wind"))
    # ½ ρ A v² = 0.2 N at the peak of the gust on a weight of 9.8 N; a gust that lasts 0.7 swing
    # periods leads to up to twice the static angle.
    static = math.atan(0.5 * 1.25 * 0.02 * 4.0**2 / 9.80665)
    assert 0.5 * static < blown.metrics["swing_rad"] < 2.0 * static
    across, _ = run(toy_instance("wind", gust_direction=math.pi / 2.0))
    assert across.metrics["swing_rad"] == pytest.approx(blown.metrics["swing_rad"], rel=0.05)


def test_a_drive_may_not_stray_from_where_the_operator_sends_it() -> None:
    """Half of 0.3 m/s for a second is 0.15 m."""
    assert operator_travel(toy("operator")) == pytest.approx([0.15, -0.075, 0.0])
    stays, _ = run(toy_instance("operator"))
    assert stays.metrics["stray"] == pytest.approx(0.15, abs=1e-6)
    assert stays.reason.startswith("A drive ended 0.15 ")
    obeys, process = run(toy_instance("operator"), towards_goal)
    assert obeys.metrics["stray"] < 1e-3
    asked = {round(reading.t, 2): reading.operator.tolist() for reading in process.readings}
    assert asked[0.48] == [0.0, 0.0, 0.0]
    assert asked[0.5] == pytest.approx([0.15, -0.075, 0.0])
    assert asked[1.5] == [0.0, 0.0, 0.0]


def test_each_bound_fails_an_instance() -> None:
    task = toy("path")
    passing = {"settled_s": 0.1, "swing_rad": 0.2, "error_m": 0.08}
    assert violation(task, passing) == ""
    assert "swung by 0.201" in violation(task, {**passing, "swing_rad": 0.201})
    assert "0.081 m" in violation(task, {**passing, "error_m": 0.081})
    del passing["settled_s"]
    assert "last 0.5 s" in violation(task, passing)


def test_a_load_must_stay_at_its_goal_for_a_while() -> None:
    """An entry that leaves the goal at the end has not settled, nor has one that comes too late."""

    def late(briefing: Briefing) -> Entry:
        inner = towards_goal(briefing)
        return lambda reading: inner(reading) if reading.t > 2.0 else np.zeros(3)

    result, _ = run(toy_instance("move"), late)
    assert result.status == "failed"
    assert "settled_s" not in result.metrics


def test_a_run_that_breaks_off_fails_and_says_where() -> None:
    def away(briefing: Briefing) -> Entry:
        return lambda reading: np.array([1.0, 0.0, 0.0])

    result, _ = run(toy_instance("move"), away)
    assert result.status == "failed"
    assert "bridge_joint" in result.reason
    assert "--validity" not in result.reason
    assert result.metrics == {}


def test_a_run_that_the_user_interrupts_is_no_failure_of_the_entry() -> None:
    def interrupts(briefing: Briefing) -> Entry:
        def rates(reading: SensorReading) -> np.ndarray:
            raise KeyboardInterrupt

        return rates

    with pytest.raises(RunError, match="Interrupted"):
        run(toy_instance("move"), interrupts)


def test_an_entry_may_decline() -> None:
    def only_moves(briefing: Briefing) -> Entry:
        raise Declined("It is for moves only.")

    result, _ = run(toy_instance("wind"), only_moves)
    assert (result.status, result.reason) == ("declined", "It is for moves only.")


def test_the_engines_and_half_of_the_step_agree_on_what_is_measured() -> None:
    """Semi-implicit Euler is of first order: half of a step of 2 ms changes a smooth motion by
    about a thousandth.
    """
    instance = toy_instance("move", start_swing=0.02)
    found = []
    for variant in (Variant(), Variant(engine="pinocchio"), Variant(substeps=2)):
        process = InThisProcess(towards_goal)
        found.append(run_instance(instance, process, variant).metrics)  # type: ignore[arg-type]
    usual, pinocchio, halved = found
    for name, value in usual.items():
        assert pinocchio[name] == pytest.approx(value, rel=1e-7)
        assert halved[name] == pytest.approx(value, rel=0.01)


def test_a_state_of_a_reading_is_the_measured_one() -> None:
    """On a luffing crane the load hangs at other angles as the jib luffs: swing is from there."""
    (task,) = select_tasks(["luffing/move"])
    briefing = briefing_of(task)
    crane = briefing.crane
    state = crane.state(gamma=0.3, luff=1.1, l=18.0, theta=0.05, luff_dot=0.02)
    exact = with_sensors(instances(task)[0], noise=0.0, position_step=0.0, swing_step=0.0)
    again = briefing.state(SensorChain(exact, crane).read(0.0, state))
    assert again.q == pytest.approx(state.q, abs=1e-12)
    # A passive joint that only follows the jib does not swing.
    assert again.v == pytest.approx(state.v, abs=1e-12)


def test_a_file_of_matrices_is_an_entry_that_tracks_the_planned_motion(tmp_path: Path) -> None:
    file = tmp_path / "gain.json"
    gain = {"D": [[-2.0]], "inputs": ["l"], "outputs": ["l_dot_command"]}
    file.write_text(json.dumps(gain), encoding="utf-8")
    result, process = run(toy_instance("move"), open_entry(str(file)))
    assert result.status == "passed", result.reason
    # The plan lasts two periods of the load on the longer rope, 0.5 m, rounded up to 20 ms.
    period = 2.0 * math.pi * math.sqrt(0.5 / 9.80665)
    assert process.briefing is not None
    planned = process.briefing.moderate_duration
    assert planned == pytest.approx(2.0 * period, abs=0.02)
    # Half-way a smooth motion is in the middle between start and goal, but for what it lags behind.
    lengths = {round(reading.t, 2): reading.position[2] for reading in process.readings}
    assert lengths[round(planned / 2.0, 2)] == pytest.approx(0.45, abs=0.01)
    operator, _ = run(toy_instance("operator"), open_entry(str(file)))
    assert operator.status == "declined"


def test_a_design_is_kept_for_the_instances_of_a_task_and_no_other() -> None:
    told = briefing_of(toy("move"))
    first = baselines._design(told, baselines._smooth)
    assert baselines._design(told, baselines._smooth) is first
    other = briefing_of(toy("wind"))
    _, motion = baselines._design(other, baselines._smooth)
    assert motion is other.motion
    # Each instance has a controller of its own.
    assert baselines.full_lqr(told) is not baselines.full_lqr(told)


@pytest.mark.parametrize("name", ["paper_lqr_pid", "flat_lqr", "yielding_drives"])
def test_a_baseline_for_tower_cranes_of_five_joints_declines_one_with_a_sling(name: str) -> None:
    (task,) = select_tasks(["hook/move"])
    with pytest.raises(Declined, match="tower crane of five joints"):
        getattr(baselines, name)(briefing_of(task))


@pytest.mark.slow
def test_the_tolerance_on_a_ship_is_not_kept_by_drives_that_stand_still_in_most_seas() -> None:
    """As the file of the tasks says: in 3 of the 5 public instances."""
    (task,) = select_tasks(["ship/move"])
    assert task.goal is not None
    at_goal = replace(task, start={**task.start, **task.goal})
    process = InThisProcess(still)
    failed = 0
    for instance in instances(at_goal, "public"):
        plumb = replace(instance, values={**instance.values, "start_swing": 0.0})
        result = run_instance(plumb, process)  # type: ignore[arg-type]
        assert result.metrics, result.reason
        failed += result.status == "failed"
    assert failed == 3
