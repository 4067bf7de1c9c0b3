"""Binding of compiled code to arrays: checks keep every call within its own memory."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.clocks import clocks
from cranedyn.compiled import binding, verify
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.binding import BoundKernel
from cranedyn.compiled.horizon.receding import receding
from cranedyn.compiled.kernel import Kernel, KernelOptions
from cranedyn.compiled.loop_tables import RowTable, single_table
from cranedyn.compiled.memory_layout import BufferLayout, size
from cranedyn.compiled.rows import compile_columns
from cranedyn.compiled.verify import compile_kernel
from cranedyn.controllers import hold_controller
from cranedyn.controllers.affine import Affine
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import QUANTITIES, Trajectory
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.dynamics.scalars import square_root
from cranedyn.errors import CraneError, Misshapen, ModelError, OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, crane

NINE = State(np.tile(crane().start.q, (9, 1)), np.zeros((9, 5)))


def _batch(controller: Any, reference: Any = None) -> object:
    return simulate_batch(crane(), controller, reference, start=NINE, duration=0.5)


def _alone(controller: Any, reference: Any = None) -> Trajectory:
    return simulate(crane(), controller, reference, duration=0.5, engine="compiled")


STRATEGIES = pytest.mark.parametrize("strategy", [_batch, _alone], ids=["batch", "alone"])
ROWS = 101


class _Answering(Hold):
    """A hold whose common form is made by somebody else."""

    def __init__(self, answer: Callable[[Affine], Any]) -> None:
        super().__init__(crane(), *_parts(hold_controller(crane())))
        object.__setattr__(self, "_answer", answer)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Any:
        return self._answer(super().affine(times, positions))  # type: ignore[attr-defined]


def _parts(brake: Hold) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return brake.stiffness, brake.damping, brake.feed_forward


# --- what controllers and references answer -------------------------------------------------------


WRONG_FORMS: list[tuple[str, Any, str, str]] = [
    ("integral", np.zeros(0), "an array of shape (0,)", "one of shape (3,)"),
    ("integral", 5, "an array of shape ()", "one of shape (3,)"),
    (
        "integral",
        np.zeros(3, complex),
        "no array of numbers but one of complex numbers",
        "an array of shape (3,)",
    ),
    ("integral_gain", np.ones((3, 1)), "an array of shape (3, 1)", "one of shape (3,)"),
    ("limit", np.ones(4), "an array of shape (4,)", "one of shape (3,)"),
    ("feed_forward", np.zeros((0, 3)), "an array of 0 rows", f"one of 1 to {ROWS}"),
    ("feed_forward", np.zeros(3), "an array of shape (3,)", "one of shape (rows, 3)"),
    ("gain", None, "no array of numbers but NoneType", "an array of shape (1, 3, 10)"),
    ("gain", np.zeros((2, 3, 10)), "an array of shape (2, 3, 10)", "one of shape (1, 3, 10)"),
    ("setpoint", np.zeros((ROWS, 9)), f"an array of shape ({ROWS}, 9)", "one of shape (rows, 10)"),
    ("setpoint", np.zeros((ROWS + 1, 10)), f"an array of {ROWS + 1} rows", f"one of 1 to {ROWS}"),
]


@STRATEGIES
@pytest.mark.parametrize(("part", "value", "given", "allowed"), WRONG_FORMS)
def test_a_common_form_that_is_not_as_it_should_be_is_refused_by_name(
    strategy: Callable[..., object], part: str, value: Any, given: str, allowed: str
) -> None:
    controller = _Answering(lambda form: replace(form, **{part: value}))
    with pytest.raises(Misshapen) as caught:
        strategy(controller)
    name = f"{part} in the common form of _Answering"
    assert str(caught.value) == f"{name} is {given}; allowed is {allowed}."


@STRATEGIES
def test_a_common_form_that_is_none_at_all_is_refused(strategy: Callable[..., object]) -> None:
    words = "the common form of _Answering is int; allowed is an Affine, or None where it is not"
    with pytest.raises(Misshapen, match=words):
        strategy(_Answering(lambda form: 3))


def _asked_at_each_instant(controller: Any) -> Trajectory:
    return _alone(lambda t, state, setpoint: controller(t, state, setpoint))


@pytest.mark.parametrize("part", ["feed_forward", "gain", "setpoint", "integral_gain", "integral"])
def test_a_form_with_a_number_missing_is_refused_in_a_batch_and_asked_at_each_instant_in_a_run(
    part: str,
) -> None:
    controller = _Answering(
        lambda form: replace(form, **{part: np.full_like(getattr(form, part), math.nan)})
    )
    words = f"{part} in the common form of _Answering is nan; allowed is finite"
    with pytest.raises(OutOfRange, match=words):
        _batch(controller)
    plain = _asked_at_each_instant(controller)
    assert _alone(controller).q.tobytes() == plain.q.tobytes()


@STRATEGIES
def test_a_limit_that_is_no_number_is_refused_since_nothing_else_would_meet_it(
    strategy: Callable[..., object],
) -> None:
    words = "limit in the common form of _Answering is an array that holds nan; allowed is numbers"
    with pytest.raises(Misshapen, match=words):
        strategy(_Answering(lambda form: replace(form, limit=np.full(3, math.nan))))


class _Table:
    """A reference whose table is made by somebody else."""

    def __init__(self, answer: Callable[[np.ndarray], Any]) -> None:
        self.at = answer
        self._still = hold(crane())

    def __call__(self, t: float) -> Setpoint:
        return self._still(t)


def _setpoint(shape: tuple[int, ...]) -> Callable[[np.ndarray], Setpoint]:
    return lambda times: Setpoint(*(np.zeros(shape) for _ in range(3)))


WRONG_TABLES: list[tuple[Callable[[np.ndarray], Any], str]] = [
    (_setpoint((ROWS, 2)), rf"position of the setpoint is .* \({ROWS}, 2\); .* \({ROWS}, 3\)"),
    (_setpoint((ROWS + 1, 3)), rf"is an array of shape \({ROWS + 1}, 3\)"),
    (_setpoint((0, 3)), r"is an array of shape \(0, 3\)"),
    (_setpoint((3,)), r"is an array of shape \(3,\)"),
    (
        lambda times: Setpoint(*[np.zeros((len(times), 3))] * 2, None),
        "acceleration of the setpoint is no array of numbers but NoneType",
    ),
    (lambda times: None, "answer of the reference is None; allowed is a cranedyn.Setpoint"),
]


@STRATEGIES
@pytest.mark.parametrize(("answer", "sentence"), WRONG_TABLES)
def test_a_table_of_a_reference_that_is_not_as_it_should_be_is_refused(
    strategy: Callable[..., object], answer: Callable[[np.ndarray], Any], sentence: str
) -> None:
    with pytest.raises(Misshapen, match=sentence):
        strategy(hold_controller(crane()), _Table(answer))


def test_a_form_that_goes_wrong_later_leaves_what_was_recorded_up_to_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cranedyn.compiled.blocks._MAX_BLOCK_LENGTH", 2000)
    asked: list[float] = []

    def answer(form: Affine) -> Affine:
        asked.append(0.0)
        return form if len(asked) == 1 else replace(form, integral=np.zeros(0))

    words = r"At t = .* s: integral in the common form of _Answering is an array of shape \(0,\)"
    how: Any = {"duration": 5.0, "control_period": 1e-3, "dt": 1e-3, "engine": "compiled"}
    with pytest.raises(RunError, match=words) as caught:
        simulate(crane(), _Answering(answer), **how)
    assert caught.value.trajectory is not None
    assert len(caught.value.trajectory) == 2000  # a block
    assert isinstance(caught.value.__cause__, Misshapen)


# --- the binding itself ---------------------------------------------------------------------------


def test_only_the_binding_takes_addresses_and_calls_compiled_code() -> None:
    texts = {
        path.relative_to(ROOT).as_posix(): path.read_text()
        for path in (ROOT / "cranedyn").rglob("*.py")
    }
    address = re.compile(r"\.ctypes\b|__array_interface__|data_as\(|\.function\(")
    # An entry of the benchmark in C takes addresses for the library of its author.
    assert {name for name, text in texts.items() if address.search(text)} == {
        "cranedyn/benchmark/entries/c_library.py",
        "cranedyn/compiled/binding.py",
    }


_LANES = 8
_CRANES = 11
_PERIODS = 20
_SIZES = BufferLayout.of(crane().layout)
_GAINS, _SETPOINTS, _FORCE, _OFFSET = map(
    size, (_SIZES.gain_table, _SIZES.setpoint_table, _SIZES.force, _SIZES.offset)
)
_OPTIONS = KernelOptions(
    _LANES,
    "effort",
    semi_implicit_euler,
    False,
    integral=False,
    offset=True,
    forces=True,
    shared=(False, True, True, True),
    log=True,
    summary=True,
    delayed=True,
)


def _loop(**changed: Any) -> BoundKernel:
    """A loop over two groups with two gain tables of three rows each."""
    code, _ = compile_kernel([crane(), crane(payload_mass=700.0)], _OPTIONS)
    groups = -(-_CRANES // _LANES)
    starts = np.zeros((groups, 4, _LANES), dtype=np.int64)
    starts[:, 0] = 3
    memory = {
        "state": np.zeros((groups, size(_SIZES.state), _LANES)),
        "numbers": np.ones((groups, code.source.varied, _LANES)),
        "delay": np.full((groups, 1, _LANES), 2, dtype=np.int64),
        "readings": np.zeros((groups, 3 * 10, _LANES)),
        "starts": starts,
        "summary": np.zeros((groups, size(_SIZES.summary), _LANES)),
        "log": np.zeros((groups, (_PERIODS + 1) * size(_SIZES.row), _LANES)),
    }
    tables = {
        "gain_table": RowTable(np.zeros((6, _GAINS)), 3, starts[0, 0]),
        "setpoint_table": RowTable(np.zeros((4, _SETPOINTS)), 4, starts[0, 1]),
        "force": RowTable(np.zeros((1, _FORCE)), 1, starts[0, 2]),
        "offset": RowTable(np.zeros((2, _OFFSET)), 2, starts[0, 3]),
    }
    tables |= {name: changed.pop(name) for name in tables if name in changed}
    counts = {"last": _PERIODS + 1, "end": _PERIODS, "reading_count": 3}
    given: dict[str, Any] = {**counts, **memory, **changed}
    present = [table for table in tables.values() if table is not None]
    return BoundKernel(code, clocks(0.2, 1e-3, 1e-2), present, **given)


def _with(name: str, change: Callable[[np.ndarray], Any]) -> dict[str, Any]:
    return {name: change(_loop()._arrays[name].array)}


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


_CHANGES: dict[str, Callable[[np.ndarray], Any]] = {
    "a group less": lambda array: array[:-1],
    "a row less": lambda array: array[:, :-1].copy(),
    "a lane less": lambda array: array[..., :-1].copy(),
    "flat": lambda array: array.ravel(),
    "single precision": lambda array: array.astype(np.float32),
    "the other byte order": lambda array: array.astype(array.dtype.newbyteorder()),
    "turned": np.asfortranarray,
    "a list": lambda array: array.tolist(),
    "out of place": lambda array: (
        np.frombuffer(b"x" + array.tobytes() + b"x" * 7, np.uint8)[1:-7]
        .view(array.dtype)
        .reshape(array.shape)
    ),
}


@pytest.mark.parametrize("change", _CHANGES)
@pytest.mark.parametrize(
    "name", ["state", "numbers", "starts", "delay", "readings", "summary", "log"]
)
@pytest.mark.slow
def test_only_arrays_of_the_right_shape_and_type_are_bound(name: str, change: str) -> None:
    changed = _with(name, _CHANGES[change])
    if change == "a group less" and name == "state":  # which says how many there are
        changed = {"state": np.zeros((3, size(_SIZES.state), _LANES))}
    with pytest.raises(Misshapen, match="allowed is"):
        _loop(**changed)


@pytest.mark.parametrize("name", ["state", "readings", "summary", "log"])
def test_arrays_to_which_code_writes_are_bound_only_if_writeable(name: str) -> None:
    with pytest.raises(Misshapen, match=f"{name} is .*; allowed is .* that can be written to"):
        _loop(**_with(name, _read_only))


@pytest.mark.parametrize(
    "changed",
    [
        {"starts": np.full((2, 4, _LANES), 4, dtype=np.int64)},
        {"starts": np.full((2, 4, _LANES), -1, dtype=np.int64)},
        {"gain_table": RowTable(np.zeros((2, _GAINS)), 3, np.zeros(1, int))},
        {"setpoint_table": RowTable(np.zeros((4, _SETPOINTS)), 5, np.zeros(1, int))},
        {"setpoint_table": RowTable(np.zeros((0, _SETPOINTS)), 0, np.zeros(1, int))},
        {"force": RowTable(np.zeros((1, 5)), 1, np.zeros(1, int))},
        {"force": RowTable(np.full((1, 6), math.nan), 1, np.zeros(1, int))},
        {"offset": RowTable(np.full((1, 10), math.inf), 1, np.zeros(1, int))},
        {"offset": RowTable(np.zeros((1, 10)), 2, np.zeros(1, int))},
        {"delay": np.full((2, 1, _LANES), 3, dtype=np.int64)},
        {"delay": np.full((2, 1, _LANES), -1, dtype=np.int64)},
        *({"reading_count": count} for count in (0, 4)),
        *({"last": last} for last in (_PERIODS + 2, 0)),
        {"log_interval": 0},
        {"end": -1},
        {"residual_from": 1.5},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_only_counts_within_the_arrays_are_bound(changed: dict[str, Any]) -> None:
    with pytest.raises(OutOfRange, match="allowed is"):
        _loop(**changed)


def test_a_loop_without_a_table_that_its_code_reads_is_refused() -> None:
    with pytest.raises(Misshapen, match="tables of a loop is 3 tables"):
        _loop(offset=None)


def test_the_control_of_the_first_instant_alone_writes_a_single_row() -> None:
    rows = np.full((2, (_PERIODS + 1) * size(_SIZES.row), _LANES), np.nan)
    _, control = _loop(log=rows).bind_calls()
    control()
    written = np.isfinite(rows.reshape(2, _PERIODS + 1, -1, _LANES)).all(axis=(2, 3))
    assert written[0].tolist() == [True] + [False] * _PERIODS and not written[1].any()


def test_a_log_with_a_ledger_has_room_for_a_row_at_each_instant() -> None:
    options = KernelOptions(1, "effort", semi_implicit_euler, log=True, ledger=True)
    code, _ = compile_kernel([crane()], options)
    widths = map(size, (code.sizes.gain_table, code.sizes.setpoint_table, code.sizes.force))
    tables = [single_table(np.zeros((1, width))) for width in widths]
    counts = size(code.sizes.state), 11 * size(code.sizes.row)
    memory = {name: np.zeros((1, n, 1)) for name, n in zip(("state", "log"), counts, strict=True)}
    with pytest.raises(Misshapen, match="log is an array"):
        BoundKernel(
            code, clocks(0.2, 1e-3, 1e-2), tables, last=21, end=20, log_interval=2, **memory
        )


def test_code_whose_accelerations_are_no_numbers_is_refused() -> None:
    code, varied = compile_kernel([crane()], KernelOptions(1, "effort", semi_implicit_euler))

    def no_numbers(code: Kernel, *_: np.ndarray) -> np.ndarray:
        return np.full((code.sizes.n, 1), np.nan)

    with pytest.raises(ModelError, match="moves otherwise than Pinocchio's"):
        verify.verify_cranes([crane()], code, varied, set(), accelerations_of=no_numbers)


def test_a_group_out_of_range_is_refused() -> None:
    _loop().run_groups(range(2))
    for group in (-1, 2):
        with pytest.raises(OutOfRange, match=f"group is {group}; allowed is 0 to 1"):
            _loop().run_groups([group])


# --- memory that is not ours ----------------------------------------------------------------------


def _digest(*arguments: str, **environment: str) -> list[str]:
    command = [sys.executable, *"-m tests.guard_pages --cases 60 --seed 3".split(), *arguments]
    how: Any = {"capture_output": True, "text": True, "timeout": 300, "cwd": ROOT}
    run = subprocess.run(command, env=os.environ | environment, check=False, **how)
    assert run.returncode == 0, f"{run.returncode} {run.stderr}"
    return run.stdout.splitlines()


@pytest.mark.long
def test_no_public_call_reads_or_writes_beside_an_array_or_what_nobody_has_written() -> None:
    """Between guard pages, and under the checks of the C library with freed memory filled; both
    times the same comes out, to the bit.
    """
    checks = next(Path("/usr/lib").glob("*/libc_malloc_debug.so.0"), None)
    preload = {"LD_PRELOAD": str(checks)} if checks else {}
    between = _digest()
    assert between == _digest("--plain", MALLOC_PERTURB_="90", MALLOC_CHECK_="3", **preload)
    assert re.fullmatch(
        r"60 calls: (CraneError \d+, )?Misshapen \d+, (OutOfRange \d+, )?ran \d\d", between[0]
    )


@pytest.mark.slow
def test_the_guard_bites() -> None:
    script = """
import ctypes, numpy as np
from tests.guard_pages import guard
guard()
for beyond in (0, 1):
    for array in (np.zeros(17), np.zeros(17)):
        ctypes.memset(array.ctypes.data - beyond, 0, array.nbytes + 2 * beyond)
    print(beyond, flush=True)
"""
    how: Any = {"capture_output": True, "text": True, "cwd": ROOT}
    run = subprocess.run([sys.executable, "-c", script], check=False, **how)
    assert (run.stdout, run.returncode) == ("0\n", -signal.SIGSEGV)


# --- pieces, and Ctrl-C between them --------------------------------------------------------------


def _everything(integrator: Any, dt: float, drive: Any, buffers: bool) -> list[bytes]:
    """What a run alone in blocks, a run under Python and a batch record."""
    c = crane(trolley_max=10.05)
    start = c.state(phi=0.15, theta=-0.1, x_dot=0.3)
    brake = hold_controller(c)
    if drive == "motion":
        brake = Hold(c, np.ones(3), np.ones(3), np.zeros(3))
    how: dict[str, Any] = {"integrator": integrator, "drive": drive}
    how |= {"duration": 0.3, "dt": dt, "control_period": 2e-2}
    reference = ramp(c, hold(c, start), "x", 0.2, rate=0.3, at=0.1)
    alone: Any = {"validity": "buffers" if buffers else "mark", "engine": "compiled"}
    found: list[bytes] = []
    for controller in (brake, lambda t, state, setpoint: brake(t, state, setpoint)):
        run = simulate(c, controller, reference, start=start, **how, **alone)
        found += [getattr(run, name).tobytes() for name in QUANTITIES]
    starts = State(np.tile(start.q, (9, 1)) + 0.01 * np.arange(9)[:, None], np.zeros((9, 5)))
    many: Any = {"start": starts, "buffers": buffers, "record": 1, "force": np.full((3, 6), 9.0)}
    batch = simulate_batch(c, brake, reference, **many, **how)
    parts = (*batch.end, batch.q, batch.effort, batch.peak_swing, batch.valid_until)
    return found + [np.ascontiguousarray(part).tobytes() for part in parts]


@pytest.mark.parametrize("steps", [1, 50])
@pytest.mark.parametrize(
    ("integrator", "dt", "drive", "buffers"),
    [
        (semi_implicit_euler, 1e-3, "effort", False),
        (rk4, 2e-2, "effort", True),
        (semi_implicit_euler, 5e-4, "motion", False),
    ],
    ids=["Euler", "RK4 with buffers", "motion"],
)
@pytest.mark.slow
def test_a_run_in_pieces_is_the_same_to_the_bit(
    steps: int,
    integrator: Any,
    dt: float,
    drive: Any,
    buffers: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = _everything(integrator, dt, drive, buffers)
    monkeypatch.setattr(binding, "_MAX_STEPS_PER_CALL", steps)
    assert _everything(integrator, dt, drive, buffers) == whole


def test_integrals_are_the_same_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    feed_forward = np.zeros((1, 3)) - [0.0, 0.0, 9810.0]
    table = Tracking(1e-2, feed_forward, np.zeros((1, 3, 10)), np.zeros((1, 10)))
    clock: Any = {"duration": 0.3, "dt": 1e-3, "control_period": 2e-2, "engine": "compiled"}

    def integral() -> tuple[float, bytes]:
        controller = HoistIntegral(crane(), table, 2e3, 1.2e4)
        run = simulate(crane(), controller, hold(crane(), crane().state(l=15.2)), **clock)
        return controller.integral, run.q.tobytes()

    whole = integral()
    assert whole[0] != 0.0
    monkeypatch.setattr(binding, "_MAX_STEPS_PER_CALL", 7)
    assert integral() == whole


@contextmanager
def _ctrl_c(after: float) -> Iterator[list[float]]:
    """Ctrl-C after some seconds; when it came, by the processor's time, stands in what is given."""
    came: list[float] = []

    def press(*_: object) -> None:
        came.append(time.process_time())
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, press)
    signal.setitimer(signal.ITIMER_REAL, after)
    try:
        yield came
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


_STANDING: dict[str, Any] = {
    "crane": crane(),
    "controller": hold_controller(crane()),
    "control_period": 3.0,
    "duration": 3.0,
    "dt": 1e-8,
}
_ALONE = {**_STANDING, "engine": "compiled"}
_MANY = {**_STANDING, "start": NINE}
_LONGEST_STEPS = {"duration": 1e7, "control_period": 1e3, "dt": 1e3, "integrator": rk4,
                  # Drives that leave their rest run to their buffers, where steps are divided.
                  "controller": hold_controller(crane(), gravity=9.8)}  # fmt: skip
_LONG: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
    "a period of 3e8 steps": (simulate, _ALONE),
    "the same under Python": (
        simulate,
        {**_ALONE, "controller": lambda *_: np.array([0.0, 0.0, -9810.0])},
    ),
    "the same by Pinocchio": (simulate, _STANDING),
    "a batch": (simulate_batch, {**_MANY, "duration": 3e4, "dt": 1e-5}),
    "a batch of such periods": (simulate_batch, _MANY),
    "a batch of the longest steps": (
        simulate_batch,
        {**_MANY, **_LONGEST_STEPS, "buffers": True, "threads": 1},
    ),
}
LONG = pytest.mark.parametrize(("run", "how"), list(_LONG.values()), ids=list(_LONG))


def _prepared(run: Callable[..., object], how: dict[str, Any]) -> None:
    """Have code made, so that an interruption comes while it runs."""
    short = how["control_period"] * 1e-3
    with suppress(CraneError):
        run(**{**how, "duration": short, "control_period": short, "dt": short})


@LONG
@pytest.mark.slow
def test_ctrl_c_is_answered_within_two_seconds_whatever_runs(
    run: Callable[..., object], how: dict[str, Any]
) -> None:
    _prepared(run, how)
    with _ctrl_c(0.3) as came, pytest.raises((KeyboardInterrupt, RunError)) as caught:
        run(**how)
    assert time.process_time() - came[0] < 2.0  # the machine may be busy with others
    assert (
        isinstance(caught.value, KeyboardInterrupt)
        or str(caught.value) == "Interrupted at t = 0.000 s."
    )


@pytest.mark.parametrize("run", [pytest.param(simulate, marks=pytest.mark.long), simulate_batch])
@pytest.mark.slow
def test_ctrl_c_is_answered_within_two_seconds_under_the_longest_horizon(
    run: Callable[..., object],
) -> None:
    def go(duration: float) -> None:
        made = receding(crane(), limits, stages=200, period=5e-3, stage=0.1)
        starts = [crane().state(phi=0.2, x=3.0 + i) for i in range(9)]
        more = {"start": starts[0], "engine": "compiled", "validity": "mark"}
        run(crane(), made, duration=duration, **more if run is simulate else {"start": starts})

    limits = Limits(rates=(0.1, 1.0, 1.0), accelerations=(0.05, 0.5, 0.5))
    go(5e-3)  # code is made
    with _ctrl_c(0.3) as came, pytest.raises((KeyboardInterrupt, RunError)):
        go(600.0)
    assert time.process_time() - came[0] < 2.0  # the machine may be busy with others


# --- columns --------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 8, 21])
def test_compiled_columns_have_the_bits_of_numpy_and_are_all_there_are(count: int) -> None:
    def text(value: Callable[[float], Any], numbers: np.ndarray) -> list[Any]:
        a = numbers[:3]
        b = numbers[3]
        return [square_root((a * a).sum()) / value(0.1) + b * 3.0 * 0.7, a[2] - b]

    code = compile_columns(text, [3, 1], 2)
    *a, b = np.random.default_rng(0).random((4, count))
    first = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) / 0.1 + b * 3.0 * 0.7
    answers = code(np.array(a).T.copy().T, b[None])  # rows are not contiguous
    np.testing.assert_array_equal(answers, [first, a[2] - b])
    with pytest.raises(Misshapen, match="columns"):
        code(np.array(a), np.zeros((1, count + 1)))
    with pytest.raises(Misshapen, match="columns"):
        code(np.array(a, dtype=np.float32), b[None])


# --- many threads ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_code_that_many_threads_ask_for_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    c = load_crane(payload_mass=1023.0)
    made = []
    options = replace(_OPTIONS, lanes=1, shared=(True, True, True, True))

    def slowly(*given: Any) -> Any:
        made.append(given)
        time.sleep(0.05)
        return honest(*given)

    honest = verify.kernel
    monkeypatch.setattr(verify, "_cached_kernel", lru_cache(slowly))
    with ThreadPoolExecutor(4) as pool:
        codes = list(pool.map(lambda _: compile_kernel([c], options)[0], range(4)))
    assert len(made) == 1
    assert all(code is codes[0] for code in codes)
