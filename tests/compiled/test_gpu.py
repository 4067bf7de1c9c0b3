"""The door to a GPU, without one: PTX assembles without spills, and one crane a thread does on the
processor what vectors do, also by the kernels of a GPU behind a stand-in for its driver.
"""

from __future__ import annotations

import ctypes
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from benchmarks import gpu
from cranedyn.compiled import batch, cuda
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.horizon.receding import receding
from cranedyn.compiled.threads import WARP
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.limits import Limits
from tests import linear_laws
from tests.compiled import gpu_stand_in
from tests.compiled.test_batch import _controllers, _cranes, _references, _starts
from tests.helpers import crane
from tests.linear_laws import filtered, integrating

HOOK = {"hook_mass": 300.0, "sling_length": 4.0}
"""The tower crane with a double pendulum."""

QUANTITIES = ("q", "v", "command", "effort", "energy")
CLOCK: dict[str, Any] = {"dt": 1e-3, "control_period": 1e-2, "record": 1}
RNG = np.random.default_rng(4)
FORCE = RNG.normal(size=(9, 30, 6)) * 200.0
OFFSET = RNG.normal(size=(9, 30, 10)) * 0.01


def _whirling() -> dict[str, Any]:
    """One controller for all; swings whose angles must be reduced, and some beyond validity."""
    starts = [crane().state(phi=swing, x=8.0, x_dot=0.3) for swing in (0.01, 0.8, 1.2, 1.5)]
    return {"crane": crane(), "controller": hold_controller(crane(), gravity=9.81), "start": starts}


def _all_different() -> dict[str, Any]:
    return {
        "crane": _cranes(9),
        "controller": _controllers(9),
        "reference": _references(9),
        "start": _starts(9),
        "force": FORCE,
        "sensor_offset": OFFSET,
        "sensor_delay": [0, 1, 2, 3, 4, 5, 40, 0, 9],
    }


def _at_buffers() -> dict[str, Any]:
    c = crane(trolley_max=11.0)
    starts = [c.state(x=9.0 + 0.24 * i, x_dot=0.5, phi=0.05) for i in range(9)]
    return {
        "crane": c,
        "controller": hold_controller(c, gravity=9.81),
        "start": starts,
        "buffers": True,
        "integrator": rk4,
        "dt": 1e-2,
    }


def _moved() -> dict[str, Any]:
    references = _references(9)
    return {
        "crane": _cranes(9),
        "controller": [follow(crane(), one, 1e-2) for one in references],
        "reference": references,
        "start": _starts(9),
        "drive": "motion",
    }


def _on_converters() -> dict[str, Any]:
    """Drives with lags of their own that hear commands two control periods late."""
    none = np.zeros(3)
    share = np.array([0.3, 0.4, 0.5])
    lags = [{"x": 0.1 + 0.1 * i} for i in range(4)]
    return {
        "crane": _cranes(4),
        "controller": Hold(crane(), share, none, none),
        "reference": hold(crane(), crane().state(gamma=0.1, x=20.0, l=12.0)),
        "start": _starts(4),
        "drive": "velocity",
        "converters": [converters(crane(), lags=one, delay=0.02) for one in lags],
    }


def _with_states() -> dict[str, Any]:
    """Controllers with five states, with one that takes a drive to its limit, and with none."""
    laws = [filtered(), integrating(4e7, d=[[-4e7]]), hold_controller(linear_laws.CRANE)]
    starts = [linear_laws.CRANE.state(x=11.8 + 0.05 * i, l=15.0, phi=0.02) for i in range(9)]
    return {
        "crane": linear_laws.CRANE,
        "controller": [laws[i % 3] for i in range(9)],
        "reference": hold(linear_laws.CRANE, linear_laws.REST),
        "start": starts,
    }


def _another_crane() -> dict[str, Any]:
    c = load_crane(**HOOK)
    starts = [c.state(phi=0.1 * i) for i in range(3)]
    return {"crane": c, "controller": hold_controller(c), "start": starts}


def _on_a_base() -> dict[str, Any]:
    """Cranes that move as their buffers and a base that rolls and heaves let them."""
    base = BaseMotion.sines(heave=(0.5, 3.0, 0.4), roll=(0.05, 4.0), yaw=(0.1, 5.0, 1.0))
    return _at_buffers() | {"base": base}


STUDIES = {
    "one controller": _whirling,
    "all different": _all_different,
    "buffers and RK4": _at_buffers,
    "motion": _moved,
    "converters": _on_converters,
    "controllers with states": _with_states,
    "two pendulums": _another_crane,
    "on a base": _on_a_base,
}


def _apart(one: Batch, other: Batch) -> float:
    """The largest difference, as a share of the largest value of the quantity."""
    assert np.array_equal(one.valid_until, other.valid_until)
    found = []
    for name in (*QUANTITIES, "peak_swing", "residual_swing", "largest_effort"):
        a = getattr(one, name)
        b = getattr(other, name)
        assert np.isfinite(a).all()
        found.append(np.abs(a - b).max() / (np.abs(a).max() or 1.0))
    return float(np.max(found))


@pytest.fixture
def one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """The threads of a GPU run on this processor."""
    monkeypatch.setattr(cuda, "check_available", lambda: None)
    monkeypatch.setattr(cuda, "run", lambda loop, *_: batch.run_in_threads(loop, 1))


@pytest.mark.usefixtures("one_after_another")
@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.slow
def test_one_crane_a_thread_does_what_eight_in_a_vector_do(study: str) -> None:
    given = {**CLOCK, **STUDIES[study](), "duration": 0.5}
    # Round-off alone: sums are fused in another order.
    assert _apart(simulate_batch(**given), simulate_batch(**given, device="cuda")) < 1e-13


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., SimpleNamespace]]:
    """Make a driver that runs kernels on this processor take the place of NVIDIA's."""

    def put(change: Callable[[str], str] = str) -> SimpleNamespace:
        made = gpu_stand_in.driver(change)
        monkeypatch.setattr(cuda, "_driver", lambda: made)
        monkeypatch.setattr(cuda, "assembly", lambda module, *_: str(module))
        return made

    for kept in (cuda._primary, cuda._module):
        kept.cache_clear()
    yield put
    for kept in (cuda._primary, cuda._module):
        kept.cache_clear()


@pytest.fixture
def machine(stand_in: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The stand-in's functions."""
    return stand_in()


@pytest.mark.parametrize(
    "study", ["one controller", "all different", "buffers and RK4", "converters", "on a base"]
)
@pytest.mark.slow
def test_the_kernels_of_a_gpu_do_what_vectors_do(machine: SimpleNamespace, study: str) -> None:
    given = {**CLOCK, **STUDIES[study](), "duration": 0.05}
    assert _apart(simulate_batch(**given), simulate_batch(**given, device="cuda")) < 1e-13
    assert machine.calls.count("cuMemAlloc") == machine.calls.count("cuMemFree") > 0


@pytest.mark.slow
def test_a_run_on_the_gpu_goes_on_from_piece_to_piece_to_the_bit(
    machine: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    # On a base, whose motion a piece must read from where it begins.
    base = BaseMotion.sines(heave=(0.5, 0.3), roll=(0.05, 0.4))
    given = {**CLOCK, **_whirling(), "duration": 0.05, "device": "cuda", "base": base}
    whole = simulate_batch(**given)
    before = machine.calls.count("cuLaunchKernel")
    monkeypatch.setattr(cuda, "_MAX_STEPS_PER_LAUNCH", 25 * WARP)
    pieces = simulate_batch(**given)
    assert machine.calls.count("cuLaunchKernel") - before == 6
    assert _apart(whole, pieces) == 0.0
    monkeypatch.setattr(cuda, "_MAX_STEPS_PER_LAUNCH", 4 * WARP)  # less than a control period
    assert _apart(whole, simulate_batch(**given)) == 0.0


@pytest.mark.slow
def test_code_that_does_otherwise_on_the_gpu_is_refused(
    stand_in: Callable[..., SimpleNamespace],
) -> None:
    machine = stand_in(lambda text: text.replace(" fsub ", " fadd "))
    with pytest.raises(ModelError, match="moves otherwise than Pinocchio's"):
        simulate_batch(**CLOCK, **_whirling(), duration=0.01, device="cuda")
    assert machine.calls.count("cuMemAlloc") == machine.calls.count("cuMemFree")


def test_a_gpu_that_refuses_is_told_of_and_leaves_nothing_behind(machine: SimpleNamespace) -> None:
    machine.cuMemcpyHtoD = lambda *_: (SimpleNamespace(name="CUDA_ERROR_UNKNOWN"),)
    with pytest.raises(CraneError, match=r"The GPU refused cuMemcpyHtoD: CUDA_ERROR_UNKNOWN\."):
        simulate_batch(**CLOCK, **_whirling(), duration=0.01, device="cuda")
    assert machine.calls.count("cuMemAlloc") == machine.calls.count("cuMemFree") == 1


@pytest.mark.usefixtures("one_after_another")
@pytest.mark.slow
def test_a_predictive_controller_is_refused_on_a_gpu() -> None:
    limits = Limits(rates=(0.08, 1.5, 1.0), accelerations=(0.02, 0.4, 0.4))
    with pytest.raises(OutOfRange, match="cpu where the controller is a predictive one"):
        simulate_batch(
            crane(), receding(crane(), limits), start=_starts(2), duration=0.1, device="cuda"
        )


# --- NVIDIA's own ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", gpu.KINDS)
@pytest.mark.parametrize("name", gpu.CRANES)
@pytest.mark.slow
def test_ptx_assembles_without_spills(name: str, kind: str) -> None:
    if (assembler := gpu.assembler()) is None:
        pytest.skip("extra ptxas (nvidia-cuda-nvcc-cu12) is not installed")
    text = gpu.ptx_text(gpu.CRANES[name], kind)
    # Nothing in memory of a thread, nothing called, no address but of the GPU's own memory.
    assert not re.search(r"\.local|\bcall\b|\tld\.b64|\tst\.b64", text)
    # RK4 of a crane with seven joints keeps up to 20 numbers more than there are registers for.
    allowed = 160 if "RK4" in kind and "hook" in name else 0
    for chip in gpu.CHIPS:
        found = gpu.assemble(assembler, text, chip)
        assert found.spilled <= allowed and 30 < found.registers <= 255, (chip, found)


def test_what_the_assembler_refuses_is_no_success() -> None:
    if (assembler := gpu.assembler()) is None:
        pytest.skip("extra ptxas (nvidia-cuda-nvcc-cu12) is not installed")
    text = gpu.ptx_text({}, "cranes that are alike")
    with pytest.raises(CraneError, match="ptxas does not assemble it: "):
        gpu.assemble(assembler, text.replace("fma.rn.f64", "fma.f64", 1), "sm_90")


@pytest.mark.slow
@pytest.mark.usefixtures("one_after_another")
def test_the_benchmark_of_a_gpu_runs_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "COUNTS", (3, 40))
    rows = list(gpu.measure_speed(simulated=3.0, rounds=1))
    assert [row[0] for row in rows] == [3, 40]
    for _, there, here, ratio in rows:
        assert 0.0 < there == pytest.approx(ratio * here)


@pytest.mark.slow
def test_nvidias_functions_take_what_they_are_given() -> None:
    driver = pytest.importorskip(
        "cuda.bindings.driver", reason="extra cuda (cuda-bindings) is not installed"
    )
    rows = np.zeros(3)
    rows.flags.writeable = False
    arguments = (1, 2, 3), (ctypes.c_int64,) * 3
    given: dict[str, tuple[Any, ...]] = {
        "cuInit": (0,),
        "cuDeviceGet": (0,),
        "cuDevicePrimaryCtxRetain": (driver.CUdevice(0),),
        "cuCtxPushCurrent": (driver.CUcontext(0),),
        "cuCtxPopCurrent": (),
        "cuModuleLoadData": (b"not PTX\0",),
        "cuModuleGetFunction": (driver.CUmodule(0), b"run"),
        "cuMemAlloc": (24,),
        "cuMemcpyHtoD": (driver.CUdeviceptr(0), rows, 24),
        "cuMemcpyDtoH": (np.zeros(3), driver.CUdeviceptr(0), 24),
        "cuMemFree": (driver.CUdeviceptr(0),),
        "cuCtxSynchronize": (),
    }
    called = set(re.findall(r'_?driver\.(cu\w+)|_call\(\s*"(cu\w+)"', inspect.getsource(cuda)))
    launch = "cuLaunchKernel"
    assert {one or other for one, other in called} == {*given, launch}
    assert int(driver.CUdeviceptr(5)) == 5
    try:
        cuda.check_available()
    except CraneError:
        given[launch] = (driver.CUfunction(0), 1, 1, 1, 32, 1, 1, 0, 0, arguments, 0)
    for name, values in given.items():
        try:
            getattr(driver, name)(*values)
        except (
            Exception
        ) as error:  # without a driver it says so, after it has read all that is given
            assert "driver" in str(error) or "libcuda" in str(error), (name, error)
    with pytest.raises(TypeError):
        driver.cuMemcpyHtoD(driver.CUdeviceptr(0), "not an array", 24)


def test_without_a_gpu_a_sentence_says_what_is_lacking(monkeypatch: pytest.MonkeyPatch) -> None:
    cuda._driver.cache_clear()
    given = {**CLOCK, **_whirling(), "duration": 0.01, "device": "cuda"}
    fake = SimpleNamespace(
        cuInit=lambda flags: (SimpleNamespace(name="CUDA_ERROR_NO_DEVICE"),),
        CUresult=SimpleNamespace(CUDA_SUCCESS=0),
    )
    monkeypatch.setitem(sys.modules, "cuda.bindings", SimpleNamespace(driver=fake))
    with pytest.raises(CraneError, match=r"no GPU that CUDA can use here: CUDA_ERROR_NO_DEVICE\."):
        simulate_batch(**given)

    def missing(flags: int) -> None:
        raise RuntimeError("Failed to dlopen libcuda.so.1")

    fake.cuInit = missing
    with pytest.raises(CraneError, match="needs NVIDIA's driver, which is not on this machine"):
        simulate_batch(**given)
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    with pytest.raises(CraneError, match=r"needs cuda-bindings.*pip install 'cranedyn\[cuda\]'"):
        simulate_batch(**given)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"device": "gpu"}, "device is gpu; allowed is cpu or cuda"),
        ({"device": "cuda", "threads": 2}, "threads is 2; allowed is None on a GPU"),
    ],
)
def test_words_and_threads_that_mean_nothing_are_refused(how: Any, words: str) -> None:
    with pytest.raises(OutOfRange, match=words):
        simulate_batch(**CLOCK, **_whirling(), duration=0.01, **how)


def test_a_gpu_does_what_the_processor_does() -> None:
    try:
        cuda.check_available()
    except CraneError as error:
        pytest.skip(str(error))
    for study in STUDIES.values():
        given = {**CLOCK, **study(), "duration": 0.5}
        assert _apart(simulate_batch(**given), simulate_batch(**given, device="cuda")) < 1e-13
