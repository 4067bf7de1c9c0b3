"""Who is compared runs the same physics, or is not shown."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import accuracy, agreement, engines
from benchmarks.agreement import ALLOWED, Truth, sort
from benchmarks.contestants import CONTESTANTS, native, ours
from benchmarks.engines_figure import engines_figure
from benchmarks.timing import race, stretch
from benchmarks.workload import Case, Contestant, Result, Run, plain
from cranedyn.errors import CraneError, ModelError
from cranedyn.integrator import Integrator, semi_implicit_euler
from tests.helpers import crane
from tests.lagrangian import Lagrangian

CASE = Case()
TRUTH = Truth(CASE)
RNG = np.random.default_rng(1)


def apart(contestant: Contestant, case: Case = CASE, truth: Truth = TRUTH) -> float:
    reason = contestant.missing()
    if reason is not None:
        pytest.skip(reason)
    return truth.apart(contestant.prepare(case), many=contestant.many)


@pytest.mark.parametrize(
    "contestant", [one for one in CONTESTANTS if "discrete" not in one.name and "substeps" not in one.name], ids=lambda one: one.name
)
def test_each_contestant_makes_the_trajectory_of_the_plain_loop(contestant: Contestant) -> None:
    # rounding, held by the drives: 4000 steps of 1e-16 each in all efforts and rates would add to 4e-13
    assert apart(contestant) < 4e-13


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
            ends, peaks = np.concatenate([one.ends for one in found]), np.concatenate([one.peaks for one in found])
            return Result(ends, peaks, None if many else found[0].log)

        return run

    return Contestant("shifted", lambda: None, prepare, many)


@pytest.mark.parametrize("many", [False, True])
def test_who_is_off_by_more_than_allowed_is_not_shown_and_it_is_said_by_how_much(many: bool) -> None:
    (ready,), refused = sort(CASE, [shifted(0.1 * ALLOWED, many=many)])
    assert ready.apart <= ALLOWED
    assert refused == []
    ready_none, ((name, reason),) = sort(CASE, [shifted(3e-6, many=many)])
    assert ready_none == []
    assert name == "shifted"
    found = re.fullmatch(r"it is (\S+) off the plain loop after 2 s, more than 1e-09", reason)
    assert found
    # of two seconds of a pendulum of 8 s: the offset itself at the start, a fraction of it in the end
    assert 1e-7 < float(found[1]) <= 3.1e-6


def test_a_result_that_is_no_number_or_has_no_log_agrees_with_nothing() -> None:
    def broken(ends: float, log: bool) -> Run:
        def run(starts: np.ndarray, duration: float) -> Result:
            right = plain(CASE, starts[0], duration)
            return replace(right, ends=right.ends + ends, log=right.log if log else None)

        return run

    assert TRUTH.apart(broken(0.0, True), many=False) == 0.0
    assert TRUTH.apart(broken(np.nan, True), many=False) == np.inf
    assert TRUTH.apart(broken(0.0, False), many=False) == np.inf


def test_who_cannot_run_or_fails_is_named_with_the_reason() -> None:
    def fails(case: Case) -> Run:
        raise RuntimeError("no such joint\nand more")

    absent = Contestant("absent", lambda: "absent is not installed", fails)
    ready, refused = sort(CASE, [absent, Contestant("failing", lambda: None, fails)])
    assert ready == []
    assert refused == [("absent", "absent is not installed"), ("failing", "it fails: RuntimeError: no such joint")]
    _, _, table = engines.tables([["plain loop", 1, 1.0, 1.0, 1.0, None], ["many", 64, 1.0, 1.0, 1.0, 0.0]], refused, 1)
    assert table.title == "Not shown"
    assert list(table.rows) == refused


def test_without_the_plain_loop_nothing_is_compared() -> None:
    with pytest.raises(CraneError, match="Nothing can be compared without the plain loop: it does not take part"):
        engines.benchmark(1, True, [shifted(0.0, many=False)])


# --- C -----------------------------------------------------------------------------------------------------------------------------

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


@needs_compiler
@pytest.mark.parametrize("lanes", [1, 8])
def test_c_moves_as_the_equations_on_paper_say(lanes: int) -> None:
    damping = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}
    c = crane(**damping)
    case = Case(c, dt=1e-3, period=1e-3)
    library = native.compiled(case, lanes, 1)
    rng = np.random.default_rng(0)
    starts = rng.uniform([-3, 4, -1.2, -1.2, 5, -0.5, -2, -0.5, -0.5, -2], [3, 20, 1.2, 1.2, 25, 0.5, 2, 0.5, 0.5, 2], (8, 10))
    ends, peaks = np.empty((8, 10)), np.empty(8)
    library.run(8 // lanes, 1, starts.ctypes.data, ends.ctypes.data, peaks.ctypes.data, None)
    paper = Lagrangian(c.gravity)
    for start, end in zip(starts, ends, strict=True):
        q, v = start[:5], start[5:]
        effort = (case.controller.feed_forward - case.controller.damping * v[[0, 1, 4]]).clip(-c.effort_limit, c.effort_limit)
        tau = np.array([*effort[:2], 0.0, 0.0, effort[2]]) - c.damping * v
        a = (end[5:] - v) / case.dt
        # a is a difference of rates of size 2 over 1 ms, so rounded by 4e-13; it weighs up to √(M_ii M_jj) and the drives' inertia is 2e6
        mass = np.sqrt(np.diag(paper.mass_matrix(q)))
        assert_allclose(paper.forces(q, v, a) / mass, tau / mass, atol=1e-12 * mass.sum())
        assert_allclose(end[:5], q + case.dt * end[5:], rtol=1e-15, atol=1e-15)


@needs_compiler
def test_c_keeps_the_drives_within_their_limits() -> None:
    case = Case(crane(trolley_effort=500.0, slew_effort=1000.0))
    one = native.CONTESTANTS[0].prepare(case)
    start = case.starts(2)[1]
    log = one(start[None], 0.5).log
    assert log is not None
    assert (np.abs(log[:, 10:]).max(axis=0)[:2] == [1000.0, 500.0]).all()
    expected = plain(case, start, 0.5).log
    assert_allclose(log[:, :10], expected[:, :10], atol=1e-13)  # rounding of 1000 steps


@needs_compiler
def test_c_refuses_a_crane_that_its_equations_do_not_describe(monkeypatch: pytest.MonkeyPatch) -> None:
    c = crane()
    model = c.model.copy()
    model.inertias[5].lever = np.array([0.1, 0.0, 0.0])
    with pytest.raises(ModelError, match="The payload has a centre beside its joint"):
        native.numbers(Case(replace(c, model=model)))


@needs_compiler
def test_what_the_compiler_says_is_the_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source = tmp_path / "broken.c"
    source.write_text("#error no crane here\n", encoding="utf-8")
    monkeypatch.setattr(native, "SOURCE", source)
    ready, ((_, reason),) = sort(CASE, native.CONTESTANTS[:1])
    assert ready == []
    assert "cannot compile broken.c" in reason


def test_without_a_compiler_c_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert native.CONTESTANTS[0].missing() == "there is no C compiler, neither cc nor $CC"


# --- Timing, tables, figures ---------------------------------------------------------------------------------------------------------


def test_every_round_measures_each_once_in_an_order_of_its_own() -> None:
    calls: list[int] = []
    taken = race([lambda i=i: calls.append(i) for i in range(4)], 6, RNG)  # type: ignore[misc]
    assert taken.shape == (4, 6)
    assert (taken >= 0.0).all()
    orders = [tuple(calls[4 * k : 4 * k + 4]) for k in range(6)]
    assert {tuple(sorted(order)) for order in orders} == {(0, 1, 2, 3)}
    assert len(set(orders)) > 1


def test_a_run_is_cut_to_its_time_and_never_longer_than_the_whole() -> None:
    def instant(starts: np.ndarray, duration: float) -> Result:
        return Result(starts, np.zeros(len(starts)))

    assert stretch(CASE, instant, 1, 0.5) == 70.0
    assert stretch(CASE, plain_run(), 1, 1e-9) == CASE.period


def plain_run() -> Run:
    return ours.PLAIN.prepare(CASE)


def test_rows_and_figure_of_engines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    few = [one for one in CONTESTANTS if one is ours.PLAIN or "C by hand" in one.name or "rollout" in one.name]
    monkeypatch.setattr(engines, "CONTESTANTS", few)
    monkeypatch.setattr(agreement, "CRANES", 3)
    page = tmp_path / "page.md"
    page.write_text("<!-- engines: One crane -->\n<!-- end -->\n", encoding="utf-8")
    assert engines.main(["--quick", "--rounds", "1", "--out", str(tmp_path), "--document", str(page)]) == 0
    assert "| plain loop | 1 |" in page.read_text(encoding="utf-8")
    assert "Many cranes" in capsys.readouterr().out
    assert matplotlib.image.imread(tmp_path / "engines.png").std() > 0.01
