"""Many cranes at once: each as if it were alone, and only what is asked for is kept."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.compiled import inputs
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.memory_layout import BufferLayout
from cranedyn.controllers import follow, hold_controller, lqr
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics import validity as validity
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import Controller, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.compiled.test_compiled import allowed_between, per_second, soft_hold
from tests.helpers import G, crane
from tests.system.test_properties import LAB, VARIANTS

PERIOD = 1e-2
LASTS = 0.5
CLOCK: dict[str, Any] = {"duration": LASTS, "dt": 1e-3, "control_period": PERIOD}
ROWS = 51


# --- each as if it were alone ---------------------------------------------------------------------


def _cranes(count: int) -> list[Crane]:
    sizes = [
        {},
        {"payload_mass": 700.0},
        {"payload_mass": 2500.0, "damp_swing": 900.0},
        {"trolley_mass": 900.0, "trolley_effort": 3e3},
    ]
    return [crane(**sizes[i % 4]) for i in range(count)]


def _starts(count: int) -> State:
    rng = np.random.default_rng(5)
    q = crane().start.q + rng.uniform(-1.0, 1.0, (20, 5)) * [0.5, 3.0, 0.2, 0.2, 3.0]
    return State(q[:count], rng.uniform(-0.1, 0.1, (20, 5))[:count])


def _start(starts: State, i: int) -> State:
    return State(starts.q[i], starts.v[i])


def _references(count: int) -> list[Reference]:
    c = crane()
    starts = _starts(count)
    held = [hold(c, State(*rows)) for rows in zip(*starts, strict=True)]
    return [
        ramp(c, still, "xl"[i % 2], 0.2, rate=0.3 + 0.05 * i, at=0.1)
        for i, still in enumerate(held)
    ]


@cache
def _tracking(i: int) -> Tracking:
    return lqr(crane(), hanging_reference(crane(), _references(i + 1)[i], LASTS, PERIOD), dt=1e-3)


def _controllers(count: int) -> list[Any]:
    """Fresh ones, since some remember: three holds, one of them shared, tables and integrators."""
    shared = hold_controller(crane(), gravity=G)
    kinds: list[Callable[[int], Any]] = [
        lambda i: shared,
        lambda i: hold_controller(crane(), stiffness=(4e5, 2e5 + 1e4 * i, 3e4)),
        lambda i: _tracking(i % 8),
        lambda i: HoistIntegral(crane(), _tracking(i % 8), 2e3, 1.3e4),
    ]
    return [kinds[i % 4](i) for i in range(count)]


def _offset(controller: Controller, offset: np.ndarray) -> Controller:
    return lambda t, state, setpoint: controller(
        t, State(state.q + offset[:5], state.v + offset[5:]), setpoint
    )


def _same(c: Crane, alone: Trajectory, batch: Batch, i: int, share: float = 1e-12) -> None:
    """Crane i of a batch did what it does alone."""
    allowed = allowed_between(c, alone, share)
    for name in ("q", "v", "command", "effort", "energy"):
        off = np.abs(getattr(alone, name) - getattr(batch, name)[i]).max(axis=0)
        assert (off <= allowed[name]).all(), (
            f"crane {i}, {name}: {off} where {allowed[name]} is allowed"
        )
    assert [batch.end.q[i].tolist(), batch.end.v[i].tolist()] == [
        batch.q[i, -1].tolist(),
        batch.v[i, -1].tolist(),
    ]
    assert batch.peak_swing[i] == pytest.approx(
        np.hypot(alone.q[:, 2], alone.q[:, 3]).max(), rel=1e-11
    )
    assert_allclose(batch.largest_effort[i], np.abs(alone.effort).max(axis=0), rtol=1e-11)
    invalid = np.flatnonzero(alone.valid == 0.0)
    assert batch.valid_until[i] == (
        pytest.approx(alone.t[invalid[0]]) if len(invalid) else math.inf
    )


def _pushed(rows: np.ndarray, interval: int = 1) -> Callable[[float, State], np.ndarray]:
    """A row of forces for some control instants each, beyond the end of the rows the last."""
    return lambda t, state: rows[min(round(t / PERIOD) // interval, len(rows) - 1)].reshape(2, 3)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 20])
@pytest.mark.slow
def test_each_crane_of_a_batch_does_what_it_does_alone(count: int) -> None:
    cranes = _cranes(count)
    starts = _starts(count)
    references = _references(count)
    rng = np.random.default_rng(6)
    force = rng.normal(size=(count, 10, 6)) * 200.0
    offsets = rng.normal(size=(count, 10)) * 0.01
    given: Any = {"start": starts, "force": force, "force_interval": 3, "sensor_offset": offsets}
    batch = simulate_batch(cranes, _controllers(count), references, record=1, **given, **CLOCK)
    assert len(batch) == count
    for i, controller in enumerate(_controllers(count)):
        pushed = _pushed(force[i], 3)
        how = {"start": _start(starts, i), "disturbance": pushed, "validity": "mark"}
        asked = _offset(controller, offsets[i])
        _same(cranes[i], simulate(cranes[i], asked, references[i], **how, **CLOCK), batch, i)


RULES = pytest.mark.parametrize(
    ("integrator", "dt"), [(semi_implicit_euler, 1e-3), (rk4, PERIOD)], ids=["Euler", "RK4"]
)


@RULES
@pytest.mark.parametrize("drive", ["effort", "motion"])
@pytest.mark.slow
def test_drives_and_stepping_rules_are_those_of_a_run_alone(
    drive: Any, integrator: Integrator, dt: float
) -> None:
    count = 9
    how = {**CLOCK, "dt": dt, "drive": drive, "integrator": integrator, "t_start": 1.0}
    cranes = _cranes(count)
    starts = _starts(count)
    references = _references(count)
    controllers: list[Any] = [hold_controller(crane())] * count
    if drive == "motion":
        controllers = [follow(crane(), reference, PERIOD) for reference in references]
    batch = simulate_batch(cranes, controllers, references, start=starts, record=1, **how)
    for i, (c, controller, reference) in enumerate(
        zip(cranes, controllers, references, strict=True)
    ):
        start = _start(starts, i)
        alone = simulate(c, controller, reference, start=start, validity="mark", **how)
        _same(c, alone, batch, i)


@RULES
@pytest.mark.slow
def test_buffers_act_on_the_cranes_that_reach_them(integrator: Integrator, dt: float) -> None:
    count = 9
    c = crane(trolley_max=11.0)
    how = {**CLOCK, "dt": dt, "integrator": integrator}
    starts = [c.state(x=9.0 + 0.24 * i, x_dot=0.5, phi=0.05, theta=0.02) for i in range(count)]
    pull = Hold(c, np.zeros(3), np.array([0.0, 0.0, 2e4]), np.array([1e3, 500.0, -1000.0 * G]))
    batch = simulate_batch(c, pull, start=starts, buffers=True, record=1, **how)
    runs = [simulate(c, pull, start=start, validity="buffers", **how) for start in starts]
    for i, alone in enumerate(runs):
        _same(c, alone, batch, i)
    assert 0 < sum(alone.outside[-1, 1] != 0.0 for alone in runs) < count


@pytest.mark.slow
def test_without_a_reference_each_holds_where_it_starts_and_what_is_given_once_is_for_all() -> None:
    c = crane()
    brake = hold_controller(crane(), gravity=G)
    starts = _starts(5)
    force = np.full((1, 6), 100.0)
    offset = np.full(10, 0.001)
    how = {"record": 1, **CLOCK}
    batch = simulate_batch(c, brake, start=starts, force=force, sensor_offset=offset, **how)
    states = [_start(starts, i) for i in range(5)]
    each = simulate_batch(
        [c] * 5,
        [brake] * 5,
        [hold(c, state) for state in states],
        start=states,
        force=np.tile(force, (5, 3, 1)),
        sensor_offset=np.tile(offset, (5, 1)),
        **how,
    )
    # Rounding: tables that are shared are read by other code.
    assert_allclose(batch.q, each.q, rtol=0, atol=1e-12)
    assert len(simulate_batch(c, brake, start=states[3], **how)) == 1


@pytest.mark.parametrize("buffers", [False, True])
@pytest.mark.slow
def test_cranes_from_the_workshop_to_the_harbour_on_any_planet_are_one_batch(buffers: bool) -> None:
    rng = np.random.default_rng(3)
    cranes = [
        load_crane(gravity=float(rng.uniform(2.0, 20.0)), **values)
        for values in (*VARIANTS[-5:], LAB, {})
    ]
    starts = [
        State((c.lower + c.upper) / 2.0 + [0.1, 0.0, 0.15, -0.1, 0.0], rng.normal(size=5) * 0.03)
        for c in cranes
    ]
    masses = np.array([[c.payload_mass] * 3 + [c.trolley_mass] * 3 for c in cranes])
    force = 0.3 * rng.normal(size=(7, 60, 6)) * masses[:, None]
    holds = [soft_hold(c, start.q) for c, start in zip(cranes, starts, strict=True)]
    how = {"start": starts, "force": force, "buffers": buffers, "record": 1}
    batch = simulate_batch(cranes, holds, **how, **CLOCK)
    validity = "buffers" if buffers else "mark"
    for i, (c, start, brake) in enumerate(zip(cranes, starts, holds, strict=True)):
        alone_how: Any = {"disturbance": _pushed(force[i]), "validity": validity, **CLOCK}
        alone = simulate(c, brake, start=start, **alone_how)
        _same(c, alone, batch, i, per_second(c, start.q))


class _Scheduled:
    """A hold that is stiffer where its reference is farther out."""

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        form = self.affine(np.array([t]), setpoint.position[None])
        return form.feed_forward[0] - form.gain[0] @ (np.concatenate(state) - form.setpoint[0])

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        gain = [
            feedback_gain(crane(), np.array([5e5, 1e4 * x, 3e4]), np.array([1e6, 5e4, 2e4]))
            for x in positions[:, 1]
        ]
        feed_forward = np.tile([0.0, 0.0, -1000.0 * G], (len(times), 1))
        return without_integral(
            feed_forward, np.array(gain), at_drives(crane(), positions, np.zeros_like(positions))
        )


@pytest.mark.slow
def test_a_controller_that_looks_at_its_reference_does_so_for_each_crane() -> None:
    controller = _Scheduled()
    references = _references(9)
    starts = _starts(9)
    batch = simulate_batch(crane(), controller, references, start=starts, record=1, **CLOCK)
    for i, reference in enumerate(references):
        start = _start(starts, i)
        alone = simulate(crane(), controller, reference, start=start, validity="mark", **CLOCK)
        _same(crane(), alone, batch, i)


@pytest.mark.slow
def test_controllers_that_remember_begin_with_it_and_are_left_as_they_are() -> None:
    pair = [HoistIntegral(crane(), _tracking(0), 2e3, 1.3e4, integral=i) for i in (-0.3, 0.0)]
    batch, again = (
        simulate_batch(
            crane(), pair, _references(1)[0], start=_start(_starts(1), 0), record=1, **CLOCK
        )
        for _ in range(2)
    )
    assert [one.integral for one in pair] == [-0.3, 0.0]
    # k_i times what is remembered; rounding.
    assert_allclose(batch.command[0, 0] - batch.command[1, 0], [0.0, 0.0, -600.0], atol=1e-9)
    assert again.q.tobytes() == batch.q.tobytes()


# --- no crane feels another -----------------------------------------------------------------------


def _many(order: Sequence[int], **how: Any) -> Batch:
    """Twenty cranes in some order."""
    starts = _starts(20)
    each = (_cranes(20), _controllers(20), _references(20))
    return simulate_batch(
        *([items[i] for i in order] for items in each),  # type: ignore[arg-type]
        start=State(starts.q[list(order)], starts.v[list(order)]),
        **{"record": 1, **CLOCK, **how},
    )


RECORDED = ("q", "v", "command", "effort", "energy")
SUMMARY = ("peak_swing", "residual_swing", "largest_effort", "valid_until")


def _bits(batch: Batch, order: Sequence[int]) -> list[bytes]:
    # adding zero makes no difference between the two zeros
    return [(getattr(batch, name)[list(order)] + 0.0).tobytes() for name in SUMMARY + RECORDED]


@pytest.mark.slow
def test_neither_the_order_of_the_cranes_nor_the_number_of_threads_changes_a_bit() -> None:
    usual = _bits(_many(range(20)), range(20))
    order = np.random.default_rng(8).permutation(20)
    assert _bits(_many(order.tolist()), np.argsort(order).tolist()) == usual
    for threads in (1, 3):
        assert _bits(_many(range(20), threads=threads), range(20)) == usual


@pytest.mark.slow
def test_a_crane_that_diverges_harms_no_other_and_says_so() -> None:
    starts = _starts(9)
    calm = hold_controller(crane(), gravity=G)
    wild = Hold(crane(), calm.stiffness, -np.array([1e300, 1e300, 1e300]), calm.feed_forward)
    c = replace(crane(), effort_limit=np.full(3, np.inf))
    usual = simulate_batch(c, [calm] * 8 + [calm], start=starts, record=1, **CLOCK)
    harmed = simulate_batch(c, [calm] * 4 + [wild] + [calm] * 4, start=starts, record=1, **CLOCK)
    others = [i for i in range(9) if i != 4]
    # Rounding: tables that are shared are read by other code.
    assert_allclose(harmed.q[others], usual.q[others], rtol=0, atol=1e-12)
    for values in (harmed.end.q[4], harmed.peak_swing[4], harmed.residual_swing[4]):
        assert not np.isfinite(values).all()
    assert harmed.valid_until[4] < 0.1
    assert np.isfinite(harmed.peak_swing[others]).all()


# --- what is kept ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_the_summary_is_that_of_the_recorded_rows(drive: Any) -> None:
    # strong enough for a ramp that is followed exactly from its first instant
    strong = dict.fromkeys(("slew_effort", "trolley_effort", "hoist_effort"), 1e9)
    count = 9
    c = crane(swing_limit=0.2, trolley_max=11.5, **strong)
    starts = _starts(count)
    since = 2.0
    late = 2.3
    references = [
        ramp(c, hold(c, State(*rows)), "x", 2.0, rate=1.0, at=2.1)
        for rows in zip(*starts, strict=True)
    ]
    controllers: list[Any] = [hold_controller(c, gravity=G)] * count
    if drive == "motion":
        controllers = [follow(crane(), reference, PERIOD) for reference in references]
    how = {**CLOCK, "t_start": since, "residual_from": late, "drive": drive, "record": 1}
    batch = simulate_batch(c, controllers, references, start=starts, **how)
    rows = batch.t >= late - 1e-9
    ended = 0
    for i in range(count):
        q = batch.q[i]
        v = batch.v[i]
        effort = batch.effort[i]
        # rounding.
        assert batch.peak_swing[i] == pytest.approx(np.hypot(q[:, 2], q[:, 3]).max(), rel=1e-14)
        amplitude = swing_amplitude(q[rows, 2:4], v[rows, 2:4], q[rows, 4], G)
        assert batch.residual_swing[i] == pytest.approx(amplitude.max(), rel=1e-14)
        assert batch.largest_effort[i].tolist() == np.abs(effort).max(axis=0).tolist()
        needed = effort if drive == "motion" else None
        bounds = validity.conditions(c, q, v, effort[:, 2], needed=needed)
        event = validity.first_event(c, bounds)
        assert batch.valid_until[i] == (
            math.inf if event is None else pytest.approx(batch.t[event.row], abs=1e-12)
        )
        ended += event is not None
        assert batch.end.q[i].tolist() == q[-1].tolist()
    assert 0 < ended < count
    assert_allclose(batch.t, since + PERIOD * np.arange(ROWS), atol=1e-12)


@pytest.mark.slow
def test_by_default_the_swing_left_at_the_end_is_residual() -> None:
    brake = hold_controller(crane(), gravity=G)
    starts = _starts(3)
    for since in (0.0, 1e6 + 0.1):
        found = simulate_batch(crane(), brake, start=starts, t_start=since, record=1, **CLOCK)
        expected = [
            swing_amplitude(q[-1:, 2:4], v[-1:, 2:4], q[-1, 4], G)[0]
            for q, v in zip(found.q, found.v, strict=True)
        ]
        assert found.residual_swing == pytest.approx(expected, rel=1e-14)  # rounding


@pytest.mark.parametrize("every", [2, 50, 51, 1000])
def test_every_nth_row_is_recorded(every: int) -> None:
    whole = _many(range(20))
    thinned = _many(range(20), record=every)
    for name in RECORDED:
        np.testing.assert_array_equal(getattr(thinned, name), getattr(whole, name)[:, ::every])
    assert thinned.t.tolist() == whole.t[::every].tolist()


def _peak(call: Callable[[], Any]) -> float:
    """Memory taken on the way [MB], code and tables kept from an earlier call not counted."""
    call()
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_what_is_not_recorded_takes_no_memory() -> None:
    c = crane()
    brake = hold_controller(crane(), gravity=G)
    starts = State(np.tile(c.start.q, (256, 1)), np.zeros((256, 5)))
    # the log of 256 cranes and 501 rows of 22 numbers takes 23 MB; with it off, some arrays of 256
    # times 30 numbers and one table remain
    how = {"start": starts, "duration": 0.5, "dt": 1e-3, "control_period": 1e-3}
    assert _peak(lambda: simulate_batch(c, brake, record=1, **how)) > 20.0
    assert _peak(lambda: simulate_batch(c, brake, **how)) < 2.0
    found = simulate_batch(c, brake, **how)
    assert [getattr(found, name).size for name in ("t", *RECORDED)] == [0] * 6
    assert_allclose(found.end.q, starts.q, atol=1e-12)


@pytest.mark.slow
def test_tables_are_kept_once_and_no_longer_than_they_change() -> None:
    spread = np.random.default_rng(0).uniform(-0.5, 0.5, (100, 5)) * [1, 1, 0.1, 0.1, 1]
    starts = State(crane().start.q + spread, np.zeros((100, 5)))
    how = {"start": starts, "duration": 1.0, "dt": 1e-3, "control_period": 1e-3}
    # 100 tables of 1001 rows of 13 numbers for where each is held would be 10 MB, and as many
    # controllers' of 42 numbers 34 MB
    assert _peak(lambda: simulate_batch(crane(), hold_controller(crane()), **how)) < 2.0
    reference = _references(1)[0]
    path = hanging_reference(crane(), reference, 1.0, 1e-3)
    shared = lqr(crane(), path, dt=1e-3, every=100)
    assert _peak(lambda: simulate_batch(crane(), shared, reference, **how)) < 3.0


# --- what is refused ------------------------------------------------------------------------------

NINE = State(np.tile(crane().start.q, (9, 1)), np.zeros((9, 5)))


class _Louder(Hold):
    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return 1.1 * super().__call__(t, state, setpoint)


def test_a_control_period_longer_than_that_of_the_controller_is_refused_as_in_a_single_run() -> (
    None
):
    law = as_velocity_command(crane(), follow(crane(), hold(crane())), drive="motion")
    words = r"control period of the run is 0\.1 s; allowed is .* 0\.005 s, or less"
    for run in (simulate, simulate_batch):
        with pytest.raises(OutOfRange, match=words):
            run(crane(), law, duration=1.0, drive="velocity", control_period=0.1)


def test_controllers_that_have_no_common_form_are_refused_by_name() -> None:
    ran = HoistIntegral(crane(), _tracking(0), 2e3, 1.3e4)
    simulate(crane(), ran, _references(1)[0], start=_start(_starts(1), 0), **CLOCK)
    louder = _Louder(crane(), np.ones(3), np.ones(3), np.zeros(3))
    words = "is not affine in the state, or has run before; a batch needs one that is"
    starts = State(NINE.q[:2], NINE.v[:2])
    for controller, name in (
        (lambda t, state, setpoint: np.zeros(3), "function"),
        (ran, "HoistIntegral"),
        (louder, "_Louder"),
    ):
        with pytest.raises(CraneError, match=f"{name} {words}"):
            simulate_batch(crane(), [hold_controller(crane()), controller], start=starts, **CLOCK)


@contextmanager
def _refused_at_once(sentence: str) -> Iterator[None]:
    """An `OutOfRange` before a megabyte is taken."""
    tracemalloc.start()
    try:
        with pytest.raises(OutOfRange, match=sentence):
            yield
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_what_would_not_fit_into_memory_is_refused_before_any_is_taken() -> None:
    starts = State(np.broadcast_to(crane().start.q, (100000, 5)), np.zeros((100000, 5)))
    brake = hold_controller(crane())
    long = {"duration": 1e6, "dt": 1e-4, "control_period": 1e-4}
    with _refused_at_once("record is 100001 rows of 100000 cranes; .* would take 3.68e.03 GB"):
        simulate_batch(crane(), brake, start=starts, record=1, **{**CLOCK, "duration": 1000.0})
    with _refused_at_once("duration is 10000000000 control periods; allowed is what takes 4 GB"):
        simulate_batch(crane(), brake, start=starts, **long)


def test_ten_million_cranes_run_and_are_refused_where_each_needs_more() -> None:
    count = 20000
    c = crane()
    starts = State(np.broadcast_to(c.start.q, (count, 5)), np.zeros((count, 5)))
    short = {**CLOCK, "duration": PERIOD}
    found = _peak(lambda: simulate_batch(c, hold_controller(c), start=starts, **short))
    reckoned = 8e-6 * count * inputs._NUMBERS_PER_CRANE
    assert 0.8 * reckoned < found < reckoned + 0.5  # MB; tables and threads besides
    # 4 GB, and 0.8 GB for where they start: less than 6 GB.
    assert (
        inputs.required_numbers(BufferLayout.of(c.layout), 10**7, 0, 1, 0) * 8 < inputs._MAX_BYTES
    )

    many = State(np.broadcast_to(c.start.q, (10**7, 5)), np.broadcast_to(0.0, (10**7, 5)))
    with _refused_at_once(r"number of cranes is 10000000; .*; these would take 5\.44 GB"):
        simulate_batch(c, hold_controller(c), start=many, sensor_delay=1, **CLOCK)
    with _refused_at_once("record is 1 rows of 10000000 cranes; allowed is what takes 4 GB"):
        simulate_batch(c, hold_controller(c), start=many, record=1000, **CLOCK)


class _Another(Hold):
    """The hold controller as one that the batch does not know."""


def _another(c: Crane) -> Hold:
    known = hold_controller(c)
    return _Another(c, known.stiffness, known.damping, known.feed_forward)


@pytest.mark.parametrize("places", [1, 3])
def test_a_hold_controller_keeps_its_places_as_any_other_controller(places: int) -> None:
    c = crane()
    start = State(np.tile(c.start.q, (10, 1)), np.zeros((10, c.layout.n)))
    start.q[:, 1] += np.arange(10) % places
    known, other = (
        simulate_batch(c, controller, start=start, **CLOCK)
        for controller in (hold_controller(c), _another(c))
    )
    np.testing.assert_array_equal(known.end.q, other.end.q)


def test_starts_of_their_own_take_a_fifth_more_memory_than_equal_ones_at_most() -> None:
    c = crane()
    count = 10_000
    q = np.tile(c.start.q, (count, 1))
    v = np.zeros((count, c.layout.n))
    own = q + np.linspace(0.0, 1.0, count)[:, None] * [0.0, 1.0, 0.0, 0.0, 0.0]
    run = partial(simulate_batch, c, hold_controller(c), **{**CLOCK, "duration": PERIOD})
    equal_peak, own_peak = (_peak(partial(run, start=State(start, v))) for start in (q, own))
    assert own_peak < 1.2 * equal_peak


@pytest.mark.slow
def test_places_and_references_that_are_too_many_are_refused_before_there_is_a_table_of_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    c = crane()
    count = 1000
    away = np.linspace(0.0, 1.0, count)[:, None] * [0.0, 1.0, 0.0, 0.0, 0.0]
    starts = State(c.start.q + away, np.zeros((count, 5)))
    own = [hold(c, State(*rows)) for rows in zip(*starts, strict=True)]
    another = _another(c)
    # what each takes is less than what is reckoned with
    found = _peak(lambda: simulate_batch(c, another, start=starts, **CLOCK))
    assert found < 8e-6 * count * (inputs._NUMBERS_PER_CRANE + inputs._NUMBERS_PER_PAIR) + 0.5
    monkeypatch.setattr("cranedyn.compiled.inputs._MAX_BYTES", 1.5e6)
    places = r"number of places at which drives start is 1000; allowed is what takes 0\.0015 GB"
    with pytest.raises(OutOfRange, match=places):
        simulate_batch(c, another, start=starts, **CLOCK)
    tables = "number of controllers and references is 1 and 1 or more; allowed is what takes"
    with pytest.raises(OutOfRange, match=tables):
        simulate_batch(c, hold_controller(c), own, start=starts, **CLOCK)


def test_tables_that_would_not_fit_are_refused_while_they_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cranedyn.compiled.inputs._MAX_BYTES", 2e5)
    asked: list[int] = []

    def reference(i: int) -> Reference:
        def setpoint(t: float) -> Setpoint:
            asked.append(i)
            return Setpoint(np.array([0.0, 10.0 + t, 15.0]), np.zeros(3), np.zeros(3))

        return setpoint

    words = r"number of controllers and references is 1 and \d+ or more; .* takes 0\.0002 GB"
    references = [reference(i) for i in range(100)]
    with pytest.raises(OutOfRange, match=words):
        simulate_batch(crane(), hold_controller(crane()), references, start=crane().start, **CLOCK)
    assert max(asked) < 30


# --- imperfect sensors ----------------------------------------------------------------------------


@pytest.mark.slow
def test_noisy_late_sensors_in_a_batch_are_those_of_each_crane_alone() -> None:
    cranes = _cranes(10)
    starts = _starts(10)
    delays = [0, 3, 1, 0, 7, 2, 49, 60, 1, 5]
    controllers = [hold_controller(cranes[0])] * 10
    sizes = noise_of(cranes[0])
    noise = np.array(
        [sizes * np.random.default_rng(i).standard_normal((ROWS, len(sizes))) for i in range(10)]
    )
    sensors: Any = {"sensor_offset": noise, "sensor_delay": delays, "record": 1}
    found = simulate_batch(cranes, controllers, start=starts, **sensors, **CLOCK)
    quiet = simulate_batch(cranes, controllers, start=starts, record=1, **CLOCK)
    for i, (one, late) in enumerate(zip(cranes, delays, strict=True)):
        seen = with_sensor_model(
            one, controllers[i], delay=late, noise=sizes, rng=np.random.default_rng(i)
        )
        start = State(starts.q[i], starts.v[i])
        alone = simulate(one, seen, hold(one, start), start=start, validity="mark", **CLOCK)
        for name in ("q", "v", "command"):
            mine = getattr(found, name)[i]
            theirs = getattr(alone, name)
            assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    assert (np.abs(found.q - quiet.q).max(axis=(1, 2)) > 1e-7).all()  # that it does something


@pytest.mark.slow
def test_one_delay_is_that_of_all_and_none_is_no_other_code() -> None:
    def end(**delay: Any) -> np.ndarray:
        c = crane()
        return simulate_batch(c, hold_controller(c), start=_starts(9), **delay, **CLOCK).end.q

    one = end(sensor_delay=4)
    none = end()
    assert (end(sensor_delay=[4] * 9) == one).all()
    assert (one != none).any()
    assert (end(sensor_delay=0) == none).all()
