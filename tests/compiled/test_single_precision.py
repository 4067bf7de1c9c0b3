"""Batches and fleets in single precision: how near they come to doubles, and what they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from llvmlite import ir

from benchmarks import precision
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.fleet import Fleet
from cranedyn.compiled.instructions import SINGLE
from cranedyn.compiled.kernel import Precision
from cranedyn.compiled.machine import translate
from cranedyn.controllers import hold_controller
from cranedyn.dynamics.contact import Ground
from cranedyn.errors import OutOfRange
from cranedyn.interop.task import INTEGRATOR
from cranedyn.model.load import load_crane
from tests.helpers import crane

# A float has 24 bits.
ROUNDING = 2.0**-24


def test_a_minute_of_free_swing_differs_by_roundings_from_that_in_doubles() -> None:
    rng = np.random.default_rng(0)
    starts = []
    for phi, theta, x, length in rng.uniform(
        [-0.3, -0.3, 5.0, 5.0], [0.3, 0.3, 20.0, 20.0], (20, 4)
    ):
        starts.append(crane().state(phi=phi, theta=theta, x=x, l=length))
    kinds: tuple[Precision, ...] = ("double", "single")
    double, single = (
        simulate_batch(
            crane(),
            hold_controller(crane()),
            start=starts,
            duration=60.0,
            precision=kind,
            threads=1,
        )
        for kind in kinds
    )
    difference = np.abs(single.end.q - double.end.q)
    # The start is rounded, and so is each sum; 120,000 steps add 15 periods' worth of phase.
    assert 0.0 < difference.max() < 300 * ROUNDING
    np.testing.assert_allclose(single.peak_swing, double.peak_swing, rtol=1e-6)
    np.testing.assert_array_equal(single.valid_until, double.valid_until)


@pytest.mark.parametrize("rate", [1e-3, 0.3])
def test_a_drive_of_any_rate_is_where_its_rate_brings_it(rate: float) -> None:
    # At 20 m a float is rounded to 1.9 µm; a step of 0.5 ms at 1 mm/s adds 0.5 µm.
    fleet = Fleet(crane(), 3, control_period=0.1, drive="motion", threads=1, precision="single")
    start = crane().state(x=20.0)
    drives = crane().layout.drives
    start.v[drives[1]] = rate
    fleet.place(np.arange(3), start)
    for _ in range(20):
        z = fleet.step(np.zeros((3, 3)))
    travelled = z[drives[1]] - 20.0
    np.testing.assert_allclose(travelled, 2.0 * rate, atol=20.0 * 20 * ROUNDING)


def test_cranes_of_different_loads_in_wind_move_as_in_doubles() -> None:
    kinds = [crane(), crane(payload_mass=2500.0)]
    count = 20
    results = []
    choices: tuple[Precision, ...] = ("double", "single")
    for kind in choices:
        fleet = Fleet(
            kinds,
            count,
            dt=1e-2,
            control_period=0.1,
            drive="effort",
            forces=True,
            integrator=INTEGRATOR,
            threads=1,
            precision=kind,
        )
        fleet.place(np.arange(count), crane().state(phi=0.2), np.arange(count) % 2)
        fleet.push(np.arange(count), np.full((count, fleet._force.shape[1]), 100.0))
        command = np.zeros((3, count))
        command[0] = 5e4
        for _ in range(20):
            z = fleet.step(command)
        results.append(z.copy())
    np.testing.assert_allclose(results[1], results[0], rtol=3e-6, atol=3e-6)
    assert (results[1] != results[0]).any()


def _sine_and_cosine(code: Code, angle: Value) -> list[Value]:
    return [angle.sin(), angle.cos()]


def test_sines_of_single_precision_are_those_of_the_library_to_three_units_in_the_last_place() -> (
    None
):
    lanes = 16
    module = ir.Module()
    code = Code(module, "run", ["given", "found"], lanes, scalar=SINGLE)
    for i, value in enumerate(_sine_and_cosine(code, code.load(code.argument["given"]))):
        code.store(value, code.argument["found"], i * lanes)
    code.end()
    machine = translate(module)
    run = machine.function("run", 2)
    rng = np.random.default_rng(0)
    # To nearly the largest angle, and next to multiples of a quarter turn.
    sizes = rng.choice([0.7, 4.0, 9.9e3], 16_000)
    wide = rng.uniform(-1.0, 1.0, 16_000) * sizes
    quarters = np.arange(-6000, 6000) * (np.pi / 2.0)
    angles = np.concatenate([wide, quarters]).astype(np.float32).astype(float).reshape(-1, lanes)
    found = np.empty((len(angles), 2, lanes))
    for group, result in zip(angles, found, strict=True):
        run(group.ctypes.data, result.ctypes.data)
    for i, exact in enumerate((np.sin(angles), np.cos(angles))):
        unit = np.spacing(np.abs(exact).astype(np.float32))
        # Close to a zero what the three parts of π/2 leave out counts, see SINGLE_HALF_PI.
        assert (np.abs(found[:, i] - exact) <= 3.0 * unit + 2e-15 * np.abs(angles)).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ground": Ground([[0.0, 0.0, -0.5]])}, "'double' with a ground"),
        ({"buffers": True}, "'double' with buffers"),
        ({"precision": "half"}, "precision is half"),
    ],
)
def test_what_needs_more_digits_is_refused(options: dict[str, Any], words: str) -> None:
    arguments = {"precision": "single", **options}
    with pytest.raises(OutOfRange, match=words):
        simulate_batch(crane(), hold_controller(crane()), duration=0.01, **arguments)


def test_a_rope_that_may_go_slack_is_refused() -> None:
    roped = load_crane(rope_stiffness=1e7)
    with pytest.raises(OutOfRange, match="'double' with a rope that may go slack"):
        Fleet(roped, 1, precision="single")


def test_an_environment_in_single_precision_observes_what_doubles_do() -> None:
    pytest.importorskip("gymnasium", reason="extra gymnasium is not installed")
    from cranedyn.interop.gymnasium import CraneVectorEnv

    observations = []
    for kind in ("double", "single"):
        env = CraneVectorEnv(3, precision=kind, threads=1)  # type: ignore[arg-type]
        env.reset(seed=1)
        actions = np.full((3, env.single_action_space.shape[0]), 0.5, dtype=np.float32)
        for _ in range(10):
            observed, *_ = env.step(actions)
        observations.append(observed)
    # Scaled to about 1.
    np.testing.assert_allclose(observations[1], observations[0], atol=1e-5)
    assert (observations[1] != observations[0]).any()


def test_the_benchmark_of_precision_prints_how_far_both_are_apart(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert precision.main(["--cranes", "16", "--seconds", "0.5"]) == 0
    assert "16 cranes after 0.5 s" in capsys.readouterr().out
    row = precision.compare(precision.cases()[0], 16, 0.5)
    assert isinstance(row[1], float) and 0.0 < row[1] < 0.01
