"""A crane with drive words: what it does by command, by its own rules, and by injected faults."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers.lqr import effort_weight_of, lqr
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.disturbances.wind import AIR_DENSITY, steady, wind
from cranedyn.dynamics.converters import STEPS, converters
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import State
from cranedyn.interop.commissioning import words as w
from cranedyn.interop.commissioning.served_crane import (
    DRAG_AREA,
    MIN_LOAD_HEIGHT,
    PERIOD,
    ServedCrane,
)
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold
from cranedyn.simulation.simulate import simulate
from tests.helpers import long_after

pytestmark = pytest.mark.slow
CRANE = load_crane()
RATES = converters(CRANE).rates
DRIVES = CRANE.layout.drives
STATUS = {name: 1 << i for i, name in enumerate(w.STATUS_BITS)}


def go(plant: ServedCrane, seconds: float, *, beating: bool = True, **commands: int) -> None:
    """Write commands, with __ for the dot, and run cycles with a heartbeat."""
    plant.image.commands.update({k.replace("__", "."): v for k, v in commands.items()})
    for _ in range(round(seconds / PERIOD)):
        plant.image.commands["heartbeat"] = (plant.cycles * beating) & 0xFFFF
        plant.cycle()


def has(plant: ServedCrane, drive: str, *names: str) -> list[bool]:
    return [bool(plant.image.readings[f"{drive}.status"] & STATUS[name]) for name in names]


def driving(**start: float) -> ServedCrane:
    """Return a crane whose trolley and hoist have run at half speed for 2 s."""
    plant = ServedCrane(CRANE, start=CRANE.state(**start), duration=60.0)
    go(plant, 2.0, x__control=1, x__speed=STEPS // 2, l__control=1, l__speed=-STEPS // 2)
    assert_allclose(plant.state.v[DRIVES], [0.0, RATES[1] / 2, -RATES[2] / 2], rtol=1e-3, atol=1e-9)
    return plant


def test_a_disabled_drive_stands_with_its_brake_closed_whatever_its_speed_command() -> None:
    plant = ServedCrane(CRANE, duration=10.0)
    go(plant, 1.0, x__speed=STEPS)
    assert plant.state.v[DRIVES[1]] == 0.0
    assert has(plant, "x", "ready", "brake closed", "running") == [True, True, False]
    go(plant, 4.0, x__control=1)
    assert has(plant, "x", "running", "brake closed", "at speed") == [True, False, True]
    go(plant, 4.0, x__control=0)
    assert has(plant, "x", "running", "brake closed") == [False, True]
    assert abs(plant.state.v[DRIVES[1]]) < 0.01 * RATES[1]


def test_the_ramp_word_is_the_time_to_full_speed() -> None:
    plant = ServedCrane(CRANE, start=CRANE.state(x=5.0), duration=10.0)
    go(plant, 4.0, x__control=1, x__speed=STEPS, x__ramp=8000)
    # behind the ramp by the delay, the rounding's share and the lag, 0.13 s of 8 s at least
    share = plant.state.v[DRIVES[1]] / RATES[1]
    assert 0.5 - 0.25 / 8.0 < share < 0.5 - 0.1 / 8.0
    go(plant, 5.0)
    assert plant.image.readings["x.actual_speed"] == pytest.approx(STEPS, abs=2)


def test_encoders_count_the_way_and_sensors_read_what_the_crane_does() -> None:
    plant = driving()
    readings = plant.image.readings
    q = plant.state.q
    assert abs(readings["x.encoder"] * 1e-4 - q[1]) <= 0.5e-4 + 1e-12
    assert abs(readings["phi.angle"] * 1e-4 - q[2]) <= 0.5e-4 + 1e-12
    # the load cell feels weight, swing and hoisting: m (g cos φ cos θ + l φ'²) at a steady speed
    felt = CRANE.gravity * math.cos(q[2]) * math.cos(q[3]) + q[4] * plant.state.v[2] ** 2
    assert readings["load"] == pytest.approx(1000.0 * felt / CRANE.gravity, abs=3.0)


@pytest.mark.parametrize("way", [-1, 1])
def test_at_full_speed_every_drive_stops_before_the_end_of_its_range(way: int) -> None:
    start = CRANE.state(x=13.0, l=17.0) if way > 0 else CRANE.state(x=9.0, l=9.0)
    plant = ServedCrane(CRANE, start=start, duration=60.0)
    words = (("control", 1), ("speed", way * STEPS))
    commands = {f"{drive}__{word}": value for drive in "xl" for word, value in words}
    fastest = np.zeros(5)
    for _ in range(15):
        go(plant, 1.0, **commands)
        fastest = np.maximum(fastest, np.abs(plant.state.v))
    assert (fastest[DRIVES[1:]] > 0.95 * RATES[1:]).all()
    q = plant.state.q
    assert ((q > CRANE.lower) & (q < CRANE.upper))[DRIVES].all()
    end = "upper end" if way > 0 else "lower end"
    assert has(plant, "x", end, "fault") == has(plant, "l", end, "fault") == [True, False]
    assert np.abs(plant.state.v[DRIVES]).max() < 0.02
    go(plant, 3.0, x__speed=-way * STEPS)  # the way back is free
    assert way * plant.state.v[DRIVES[1]] < -0.5 * RATES[1]


def test_lowering_ends_above_the_ground() -> None:
    crane = load_crane(hoist_max=60.0, pivot_height=30.0)
    plant = ServedCrane(crane, start=crane.state(l=25.0), duration=20.0)
    go(plant, 12.0, l__control=1, l__speed=STEPS)
    assert (
        MIN_LOAD_HEIGHT < float(payload_position(crane, plant.state.q)[2]) < MIN_LOAD_HEIGHT + 0.2
    )
    assert has(plant, "l", "upper end") == [True]


def test_without_a_heartbeat_an_enabled_crane_stops_after_half_a_second_and_says_why() -> None:
    plant = driving()
    go(plant, 4.0, beating=False)
    # the last beat was heard in the first of these cycles, when the word became 0
    assert plant.events == [(pytest.approx(2.5 + PERIOD, abs=1e-9), w.FAULTS[w.WATCHDOG_FAULT])]
    assert np.abs(plant.state.v[DRIVES]).max() < 1e-3
    assert has(plant, "x", "fault", "brake closed", "ready") == [True, True, False]
    standing = ServedCrane(CRANE, duration=5.0)
    go(standing, 2.0, beating=False)
    assert not standing.fault


@pytest.mark.parametrize(
    ("command", "fault", "text"),
    [
        (
            {"inject": w.ROPE_SENSOR_LOST_BIT},
            w.ROPE_SENSOR_FAULT,
            "rope sensor: its reading is not valid",
        ),
        ({"inject": w.MESSAGES_LOST_BIT}, w.WATCHDOG_FAULT, "watchdog: no new heartbeat for 0.5 s"),
        ({"x__inject": w.ENCODER_JUMP_BIT}, w.ENCODER_FAULT, "x encoder: its counts do not fit"),
    ],
    ids=["rope sensor lost", "messages lost", "encoder jump"],
)
def test_under_an_injected_fault_the_crane_stops_and_says_why(
    command: dict[str, int], fault: int, text: str
) -> None:
    plant = driving()
    before = plant.state.q[DRIVES].copy()
    go(plant, 4.0, **command)
    assert (plant.fault, plant.image.readings["fault"]) == (fault, fault)
    ((_, said),) = plant.events
    assert said.startswith(text)
    assert np.abs(plant.state.v[DRIVES]).max() < 1e-3
    # 0.5 s of the watchdog, then delay, lag and rounding, and half of the ramp's time
    way = np.abs(plant.state.q[DRIVES] - before)
    assert (way[1:] < RATES[1:] / 2 * (0.5 + 0.35 + 1.5)).all()
    if fault == w.ROPE_SENSOR_FAULT:
        assert plant.image.readings["load"] == plant.image.readings["phi.angle"] == w.LOST_READING


def test_a_slipping_brake_lets_the_load_down_until_the_converter_holds_it() -> None:
    plant = ServedCrane(CRANE, duration=20.0)
    go(plant, 3.0, l__inject=w.BRAKE_SLIP_BIT, x__inject=w.BRAKE_SLIP_BIT)
    ((t, text),) = plant.events
    assert text == "l brake: the drive moves with its brake closed"
    sunk = plant.state.q - CRANE.start.q
    assert 0.0 < sunk[4] < 0.05 and sunk[1] == 0.0  # nothing pulls the trolley
    assert abs(plant.state.v[4]) < 1e-6 and t < 0.5


def test_a_fault_stays_until_a_reset_rises_while_no_drive_is_enabled() -> None:
    plant = driving()
    go(plant, 3.0, inject=w.ROPE_SENSOR_LOST_BIT)
    go(plant, 1.0, inject=0, x__control=w.ENABLE_BIT | w.RESET_BIT)
    assert plant.fault == w.ROPE_SENSOR_FAULT  # a drive is enabled
    go(plant, 0.1, x__control=w.RESET_BIT, l__control=0)
    assert plant.fault == w.ROPE_SENSOR_FAULT  # the bit has not risen
    go(plant, 0.1, x__control=0)
    go(plant, 0.1, x__control=w.RESET_BIT)
    assert plant.fault == 0 and plant.events[-1][1] == "fault reset"
    go(plant, 3.0, x__control=w.ENABLE_BIT)
    assert plant.state.v[DRIVES[1]] == pytest.approx(RATES[1] / 2, rel=1e-3)


def test_a_wind_turned_on_swings_the_load_to_twice_its_rest_angle() -> None:
    crane = load_crane(damp_swing=0.0)
    plant = ServedCrane(crane, start=crane.state(x=12.0, l=10.0), duration=20.0)
    largest = 0
    for _ in range(8):
        go(plant, 1.0, wind=800)
        largest = max(largest, *(abs(plant.image.readings[f"{s}.angle"]) for s in ("phi", "theta")))
    rest = math.atan(0.5 * AIR_DENSITY * DRAG_AREA * 8.0**2 / (1000.0 * crane.gravity))
    # less by the drag of the moving load, and by what a look a second misses
    assert 1.7 * rest < largest * w.ANGLE_RESOLUTION < 2.0 * rest


def test_a_run_is_that_of_simulate_under_the_same_rates_and_carries_its_events() -> None:
    plant = driving()
    go(plant, 2.0, inject=w.MESSAGES_LOST_BIT)
    run = plant.trajectory()
    assert run.record["notes"] == {"events": [[2.5, w.FAULTS[w.WATCHDOG_FAULT]]]}
    rates = np.diff(run.setpoint, axis=0) / PERIOD
    first = (run.setpoint[0] - CRANE.start.q[DRIVES]) / PERIOD
    table = np.vstack([first, rates])
    same = simulate(
        CRANE,
        lambda t, state, setpoint: table[round(t / PERIOD)],
        duration=(len(run) - 1) * PERIOD,
        drive="velocity",
        engine="compiled",
        disturbance=wind(CRANE, steady(0.0), direction=0.0, payload_area=DRAG_AREA),
    )
    assert_allclose(run.q, same.q, rtol=0.0, atol=1e-9)  # rates from differences of positions


@pytest.mark.parametrize("period", [pytest.param(PERIOD, marks=pytest.mark.long), 4 * PERIOD])
def test_a_regulator_of_speeds_removes_a_swing_that_it_reads_from_the_words(period: float) -> None:
    """Rates of the rope angles, which have no word, are differences of two cycles."""
    rest = hanging_reference(CRANE, hold(CRANE), duration=period, period=period)
    weight = effort_weight_of(CRANE) * np.diag([30.0, 30.0, 1.0])
    law = as_velocity_command(
        CRANE, lqr(CRANE, rest, effort_weight=weight), drive="effort", control_period=period
    )
    plant = ServedCrane(CRANE, start=CRANE.state(phi=0.1, theta=0.05), duration=60.0)
    scale_of = {word.name: word.scale for word in plant.image.words}

    def read(suffix: str, symbols: Sequence[str]) -> list[float]:
        names = [f"{symbol}.{suffix}" for symbol in symbols]
        return [scale_of[name] * plant.image.readings[name] for name in names]

    drives = ("gamma", "x", "l")
    angles = np.array(read("angle", ("phi", "theta")))
    for _ in range(round(12.0 / period)):
        last_angles = angles
        angles = np.array(read("angle", ("phi", "theta")))
        position, speed = read("encoder", drives), read("actual_speed", drives)
        q = np.concatenate([position[:2], angles, position[2:]])
        v = np.concatenate([speed[:2], (angles - last_angles) / period, speed[2:]])
        commands = {}
        for drive, rate in zip(drives, law(plant.t, State(q, v), rest(0.0)), strict=True):
            commands[f"{drive}.control"] = 1
            counts = round(rate / scale_of[f"{drive}.speed"])
            commands[f"{drive}.speed"] = max(-STEPS, min(STEPS, counts))
        go(plant, period, **commands)
    assert plant.fault == 0
    amplitude = swing_amplitude(
        plant.state.q[None, 2:4], plant.state.v[None, 2:4], plant.state.q[4:], CRANE.gravity
    )
    assert amplitude < 0.015


def test_other_cranes_have_words_too_and_a_moving_start_is_refused() -> None:
    bridge = load_crane("urdf/overhead_crane.urdf.xacro")
    plant = ServedCrane(bridge, duration=5.0)
    go(plant, 1.0, bridge__control=1, bridge__speed=STEPS)
    assert plant.image.readings["bridge.actual_speed"] > 0
    with pytest.raises(OutOfRange, match="rates of the start"):
        ServedCrane(CRANE, start=CRANE.state(x_dot=0.1))


def test_where_the_model_ceases_to_hold_the_run_ends_with_what_it_recorded() -> None:
    plant = ServedCrane(CRANE, duration=20.0)
    with pytest.raises(RunError, match="swing_tangential_joint swings by"):
        go(plant, 10.0, wind=10000)
    assert 1 < len(plant.trajectory()) < 10.0 / PERIOD


@pytest.mark.parametrize("seed", long_after(1, range(3)))
def test_whatever_words_are_written_drives_keep_their_rates_and_ranges(seed: int) -> None:
    plant = ServedCrane(CRANE, duration=60.0)
    rng = np.random.default_rng(seed)
    words = [word for word in plant.image.words if word.command and word.name != "wind"]
    extreme = {"UINT16": [0, 1, 2, 3, 65535], "INT16": [-32768, -16384, 0, 16384, 32767]}
    for _ in range(200):
        for word in words:
            if rng.uniform() < 0.3:
                plant.image.commands[word.name] = int(rng.choice(extreme[word.kind]))
        if rng.uniform() < 0.5:  # else the watchdog or an injected fault ends all motion early
            injected = [word.name for word in words if word.name.endswith("inject")]
            plant.image.commands.update(dict.fromkeys(injected, 0))
        for _ in range(20):
            plant.image.commands["heartbeat"] = plant.cycles & 0xFFFF
            plant.cycle()
            q, v = plant.state
            assert np.isfinite([*q, *v]).all()
            # The lag overshoots what it follows by nothing; slip of a brake is a twentieth.
            assert (np.abs(v[DRIVES]) <= RATES * 1.001).all()
            assert ((q > CRANE.lower) & (q < CRANE.upper))[DRIVES].all()
    assert np.isfinite(plant.trajectory().v).all()


IMPOSSIBLE = [math.nan, math.inf, -math.inf, 1e308, -1e308, 0.5, 65536, -32769, 10**40]
IMPOSSIBLE += [None, "1", True, [1]]


@pytest.mark.parametrize("value", IMPOSSIBLE, ids=repr)
def test_a_command_that_is_no_number_of_its_type_leaves_the_last_one(value: object) -> None:
    plant = driving()
    same = driving()
    go(plant, 0.5, x__speed=value, l__ramp=value, wind=value, inject=value)  # type: ignore[arg-type]
    go(same, 0.5)
    assert np.array_equal(np.concatenate(plant.state), np.concatenate(same.state))
    named = sorted(["x.speed", "l.ramp", "wind", "inject"])
    told = [text.split(" is ")[0] for _, text in plant.events]
    assert told == named
    assert not same.events and not plant.fault


@pytest.mark.parametrize("rope_stiffness", [0.0, 1e7, math.inf])
def test_the_load_cell_weighs_the_load_on_any_rope(rope_stiffness: float) -> None:
    plant = ServedCrane(load_crane(rope_stiffness=rope_stiffness), duration=5.0)
    go(plant, 0.1)
    assert plant.image.readings["load"] == pytest.approx(1000, abs=2)
