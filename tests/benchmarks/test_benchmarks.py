"""Who is compared runs the same physics, or is not shown."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import accuracy, engines
from benchmarks.agreement import ALLOWED, Truth, sort
from benchmarks.conduct import conduct
from benchmarks.contestants import CONTESTANTS, native, ours
from benchmarks.timing import race, stretch
from benchmarks.workload import Case, Contestant, Result, Run, plain
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.errors import CraneError, ModelError
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.document_numbers import missing
from tests.helpers import crane, extrapolated
from tests.lagrangian import Lagrangian

CASE = Case()
RNG = np.random.default_rng(1)


@cache
def usual_truth() -> Truth:
    """The plain loop of the usual case, run once."""
    return Truth(CASE)


@cache
def undamped() -> tuple[Case, Truth]:
    """The case of a crane whose load swings without damping, and its plain loop, run once."""
    case = Case(crane(damp_swing=0.0))
    return case, Truth(case)


def max_deviation(contestant: Contestant, case: Case, truth: Truth) -> float:
    reason = contestant.missing()
    if reason is not None:
        pytest.skip(reason)
    return truth.max_deviation(contestant.prepare(case), many=contestant.many)


OTHER_DAMPING = ("Drake, discrete plant", "PyBullet, substeps of a control period")
"""Those that take the damping at the end of a step, or hold it over all steps of a control
period."""

ROUNDING = 4e-13
"""4000 steps of 1e-16 each."""


@pytest.mark.parametrize("contestant", CONTESTANTS, ids=lambda one: one.name)
@pytest.mark.slow
def test_each_contestant_makes_the_trajectory_of_the_plain_loop_but_for_its_damping(
    contestant: Contestant,
) -> None:
    if contestant.name not in OTHER_DAMPING:
        assert max_deviation(contestant, CASE, usual_truth()) < ROUNDING
        return
    assert max_deviation(contestant, *undamped()) < ROUNDING
    assert max_deviation(contestant, CASE, usual_truth()) > 100.0 * ROUNDING


@pytest.mark.slow
def test_a_contestant_gives_the_same_run_twice() -> None:
    for contestant in CONTESTANTS:
        if contestant.missing() is None:
            run = contestant.prepare(CASE)
            starts = CASE.starts(5 if contestant.many else 1)
            assert np.array_equal(run(starts, 0.1).ends, run(starts, 0.1).ends), contestant.name


def shifted(by: float, *, many: bool) -> Contestant:
    """The plain loop with a swing that is off."""

    def prepare(case: Case) -> Run:
        def run(starts: np.ndarray, duration: float) -> Result:
            wrong = starts.copy()
            wrong[:, 3] += by
            found = [plain(case, start, duration) for start in wrong]
            ends = np.concatenate([one.ends for one in found])
            peaks = np.concatenate([one.peaks for one in found])
            return Result(ends, peaks, None if many else found[0].log)

        return run

    return Contestant("shifted", lambda: None, prepare, many)


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.slow
def test_who_is_off_by_more_than_allowed_is_not_shown_and_it_is_said_by_how_much(
    many: bool,
) -> None:
    (ready,), refused = sort(CASE, [shifted(0.1 * ALLOWED, many=many)])
    assert ready.max_deviation <= ALLOWED
    assert refused == []
    ready_none, ((name, reason),) = sort(CASE, [shifted(3e-6, many=many)])
    assert ready_none == []
    assert name == "shifted"
    found = re.fullmatch(r"it is (\S+) off the plain loop after 2 s, more than 1e-09", reason)
    assert found
    # of two seconds of a pendulum of 8 s: the offset itself at the start, a fraction of it in the
    # end
    assert 1e-7 < float(found[1]) <= 3.1e-6


@pytest.mark.slow
def test_a_result_that_is_no_number_or_has_no_log_agrees_with_nothing() -> None:
    def broken(ends: float, log: bool) -> Run:
        def run(starts: np.ndarray, duration: float) -> Result:
            right = plain(CASE, starts[0], duration)
            return replace(right, ends=right.ends + ends, log=right.log if log else None)

        return run

    assert usual_truth().max_deviation(broken(0.0, True), many=False) == 0.0
    assert usual_truth().max_deviation(broken(np.nan, True), many=False) == np.inf
    assert usual_truth().max_deviation(broken(0.0, False), many=False) == np.inf


@pytest.mark.slow
def test_who_cannot_run_or_fails_is_named_with_the_reason() -> None:
    def fails(case: Case) -> Run:
        raise RuntimeError("no such joint\nand more")

    absent = Contestant("absent", lambda: "absent is not installed", fails)
    ready, refused = sort(CASE, [absent, Contestant("failing", lambda: None, fails)])
    assert ready == []
    assert refused == [
        ("absent", "absent is not installed"),
        ("failing", "it fails: RuntimeError: no such joint"),
    ]
    _, _, table = engines.engine_tables(
        [["plain loop", 1, 1.0, 1.0, 1.0, None], ["many", 64, 1.0, 1.0, 1.0, 0.0]], refused, 1
    )
    assert table.title == "Not shown"
    assert list(table.rows) == refused


@pytest.mark.slow
def test_without_the_plain_loop_nothing_is_compared() -> None:
    words = "Nothing can be compared without the plain loop: it does not take part"
    with pytest.raises(CraneError, match=words):
        engines.engines_benchmark(1, True, [shifted(0.0, many=False)])


@pytest.mark.slow
def test_a_double_pendulum_is_compared_by_those_that_run_any_crane() -> None:
    hook = Case(load_crane(hook_mass=engines.HOOK_MASS))
    able = [one for one in CONTESTANTS if one.any_crane and not one.missing()]
    assert {"plain loop", "compiled closed loop"} <= {one.name for one in able}
    ready, refused = sort(hook, able)
    assert refused == []
    assert len(ready) == len(able)


# --- C --------------------------------------------------------------------------------------------

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("lanes", [1, 8])
def test_c_moves_as_the_equations_on_paper_say(lanes: int) -> None:
    damping = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}
    c = crane(**damping)
    case = Case(c, dt=1e-3, period=1e-3)
    library = native.load_library(case, lanes, 1)
    rng = np.random.default_rng(0)
    starts = rng.uniform(
        [-3, 4, -1.2, -1.2, 5, -0.5, -2, -0.5, -0.5, -2],
        [3, 20, 1.2, 1.2, 25, 0.5, 2, 0.5, 0.5, 2],
        (8, 10),
    )
    ends = np.empty((8, 10))
    peaks = np.empty(8)
    library.run(8 // lanes, 1, starts.ctypes.data, ends.ctypes.data, peaks.ctypes.data, None)
    paper = Lagrangian(c.gravity)
    for start, end in zip(starts, ends, strict=True):
        q = start[:5]
        v = start[5:]
        effort = (case.controller.feed_forward - case.controller.damping * v[[0, 1, 4]]).clip(
            -c.effort_limit, c.effort_limit
        )
        tau = np.array([*effort[:2], 0.0, 0.0, effort[2]]) - c.damping * v
        a = (end[5:] - v) / case.dt
        # a is a difference of rates of size 2 over 1 ms, so rounded by 4e-13, and |M_ij| <= √(M_ii
        # M_jj)
        mass = np.sqrt(np.diag(paper.mass_matrix(q)))
        assert_allclose(paper.forces(q, v, a) / mass, tau / mass, atol=1e-12 * mass.sum())
        assert_allclose(end[:5], q + case.dt * end[5:], rtol=1e-15, atol=1e-15)


@pytest.mark.slow
@needs_compiler
def test_c_keeps_the_drives_within_their_limits() -> None:
    case = Case(crane(trolley_effort=500.0, slew_effort=1000.0))
    one = native.CONTESTANTS[0].prepare(case)
    start = case.starts(2)[1]
    result = one(start[None], 0.5)
    assert result.log is not None
    log = result.log()
    assert (np.abs(log[:, 10:]).max(axis=0)[:2] == [1000.0, 500.0]).all()
    expected = plain(case, start, 0.5).log
    assert expected is not None
    assert_allclose(log[:, :10], expected()[:, :10], atol=1e-13)  # rounding of 1000 steps


@pytest.mark.slow
@needs_compiler
def test_c_with_a_whole_log_has_the_columns_of_a_run() -> None:
    case = Case(crane(damp_slew=3e4, damp_swing=5e3))
    start = case.starts(2)[1]
    run = simulate(case.crane, case.controller, start=State(start[:5], start[5:]), duration=1.0)
    result = native.CONTESTANTS[1].prepare(case)(start[None], 1.0)
    assert result.log is not None
    log = result.log().base
    ours = (run.q, run.v, run.effort, run.setpoint, run.command, run.force, run.outside, run.energy)
    expected = np.column_stack([*ours, run.work, run.dissipated, run.valid])
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    assert_allclose(log / scale, expected / scale, atol=1e-12)  # rounding of 2000 steps


@needs_compiler
def test_c_refuses_a_crane_that_its_equations_do_not_describe() -> None:
    c = crane()
    model = c.model.copy()
    model.inertias[5].lever = np.array([0.1, 0.0, 0.0])
    with pytest.raises(ModelError, match="The payload has a centre beside its joint"):
        native.c_constants(Case(replace(c, model=model)))


@needs_compiler
@pytest.mark.slow
def test_what_the_compiler_says_is_the_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = tmp_path / "broken.c"
    source.write_text("#error no crane here\n", encoding="utf-8")
    monkeypatch.setattr(native, "SOURCE", source)
    ready, ((_, reason),) = sort(CASE, native.CONTESTANTS[:1])
    assert ready == []
    assert "cannot compile broken.c" in reason


def test_without_a_compiler_c_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert native.CONTESTANTS[0].missing() == "there is no C compiler, neither cc nor $CC"


# --- Timing, tables, figures ----------------------------------------------------------------------


def test_every_round_measures_each_once_in_an_order_of_its_own() -> None:
    calls: list[int] = []
    taken = race([lambda i=i: calls.append(i) for i in range(4)], 6, RNG)  # type: ignore[misc]
    assert taken.shape == (4, 6)
    assert (taken >= 0.0).all()
    orders = [tuple(calls[4 * k : 4 * k + 4]) for k in range(6)]
    assert {tuple(sorted(order)) for order in orders} == {(0, 1, 2, 3)}
    assert len(set(orders)) > 1


def test_a_run_is_cut_to_its_time_but_not_below_ten_times_its_fixed_cost_nor_beyond_the_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[float] = []

    def run(starts: np.ndarray, duration: float) -> Result:
        asked.append(duration)
        return Result(starts, np.zeros(len(starts)))

    def costs(fixed: float, each: float) -> None:
        monkeypatch.setattr(
            "benchmarks.timing.seconds",
            lambda task: (task(), fixed + each * asked[-1] / CASE.period)[1],
        )

    costs(0.0, 1e-3)
    assert stretch(CASE, run, 1, 0.5) == pytest.approx(500 * CASE.period)
    assert stretch(CASE, run, 1, 1e-9) == CASE.period
    costs(0.2, 1e-3)
    assert stretch(CASE, run, 1, 0.5) == pytest.approx(2000 * CASE.period)
    costs(0.0, 1e-9)
    assert stretch(CASE, run, 1, 0.5) == 70.0


@pytest.mark.long
def test_engines_leaves_tables_in_a_document_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = [one for one in CONTESTANTS if one is ours.PLAIN or one.name.startswith("C by hand")]
    page = tmp_path / "page.md"
    page.write_text("<!-- engines: One crane -->\n<!-- end -->\n", encoding="utf-8")
    arguments = ["--quick", "--rounds", "1", "--out", str(tmp_path), "--document", str(page)]
    measure = partial(engines.engines_benchmark, contestants=few)
    assert conduct("engines", "", measure, arguments) == 0
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^\| plain loop \| 1 \| [\d.]+ \| [\d.]+ \| 1 \| - \|$", text, re.MULTILINE)
    assert "Many cranes" not in text
    shown = capsys.readouterr().out
    assert "One crane for 70 s" in shown
    assert ("Many cranes at once" in shown) == (native.compiler() is not None)
    assert matplotlib.image.imread(tmp_path / "engines.png").std() > 0.01


@pytest.mark.parametrize(
    ("argument", "words"), [("0", "it must be 1 or more"), ("many", "many is no number of rounds")]
)
def test_a_number_of_rounds_that_is_none_is_refused(
    argument: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        engines.main(["--rounds", argument])
    assert ended.value.code == 2
    assert words in capsys.readouterr().err


# --- Accuracy -------------------------------------------------------------------------------------


def test_the_reference_is_where_runs_go_as_their_step_vanishes() -> None:
    c = CASE.crane
    _, exact = accuracy.reference(Case(c, period=0.01), 1.0)
    limit = extrapolated(
        lambda dt: accuracy.swung(Case(c, dt, 0.01), semi_implicit_euler, 1.0).q, 1e-3
    )
    # what is left is of order dt³ = 1e-9 s³, times jerks below 0.1 m/s³ of drives that hold
    assert np.abs(limit - exact).max() < 1e-10


@pytest.mark.slow
def test_half_the_step_halves_errors_of_semi_implicit_euler_and_rk4_errs_a_sixteenth() -> None:
    table = accuracy.integrators(1, RNG, steps=(1e-2, 5e-3, 2e-3, 1e-3), duration=6.0)
    euler, rk4 = (
        [row[2:] for row in table.rows if row[0] == rule.name] for rule in accuracy.INTEGRATORS
    )
    assert euler[0][0] < euler[-1][0] and rk4[0][0] < rk4[-1][0]  # a tenth of the step costs more
    off = [a / b for a, b in zip(*euler[2:], strict=True)][1:]
    assert_allclose(off, 2.0, rtol=0.25)  # order 1, and of the period's error the terms beyond
    _, place, period, _ = (a / b for a, b in zip(*rk4[:2], strict=True))
    # Order 4; the ledger's error is that of its own trapezoidal rule.
    assert_allclose([place, period], 16.0, rtol=0.25)
    assert accuracy.accuracy_figure(table).axes[0].get_xscale() == "log"


@pytest.mark.slow
def test_the_start_is_measured_of_those_that_run_and_is_longer_than_that_of_python() -> None:
    absent = Contestant("absent", lambda: "absent is not installed", ours.PLAIN.prepare)
    unknown = Contestant("nobody of this name", lambda: None, ours.PLAIN.prepare)
    (python, bare), (plain_loop, whole) = accuracy.start_up(
        1, RNG, [absent, unknown, ours.PLAIN]
    ).rows
    assert (python, plain_loop) == ("Python, nothing else", "plain loop")
    assert whole > bare > 0.0


def test_the_readme_says_how_many_times_faster_as_the_table_of_the_engines_does() -> None:
    table = Path(__file__).parents[2] / "docs/results/engines_one_crane.csv"
    rows = {row[0]: row for row in csv.reader(table.open(encoding="utf-8"))}
    ratio = float(rows["compiled closed loop"][4])
    faster = f"{ratio:.0f} times faster than the plain loop in Python"
    assert missing([faster], "README.md") == []
