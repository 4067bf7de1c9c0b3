"""The comparison: its moves, ways, cases and scores, and the command as a user runs it."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from cranedyn import theory
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import read
from cranedyn.interfaces import Setpoint, State
from cranedyn.references import zv
from cranedyn.references.limits import use
from cranedyn.references.motion import hanging_reference
from cranedyn.simulation.simulate import simulate
from experiments import compare, harness
from experiments.compare import claims as compare_claims
from experiments.compare import runs as compare_runs
from experiments.compare.figures import robustness_figure, swing_figure
from experiments.compare.runs import StrategyResult
from experiments.harness.document import read_document
from experiments.harness.outcome import ResultTable
from experiments.report import page
from experiments.scenarios.moves import LIMITS, MOVES, SWINGING, RestToRest, Score
from experiments.scenarios.perturbations import NOMINAL, PERTURBATIONS, Perturbation, make
from experiments.scenarios.shaping import joystick_move
from experiments.scenarios.strategies import FASTEST, FLAT, MPC, PAPER, PD, STRATEGIES, TIME
from tests.document_numbers import missing
from tests.experiments.conftest import Ran
from tests.helpers import FAST, ROOT, crane

pytestmark = pytest.mark.slow

TROLLEY = MOVES[0]
COMBINED = MOVES[-1]
COMPARED = ["spline alone", PD, FLAT]


@pytest.fixture(scope="module")
def setup() -> harness.Setup:
    return harness.Setup(engine=FAST)


def test_the_spline_alone_leaves_what_the_closed_form_says() -> None:
    setup = harness.Setup()
    _, found = make(setup, TROLLEY, STRATEGIES["spline alone"](setup, TROLLEY))
    length = 15.0 + 500.0 / (1000.0 * 15.0)  # payload and dummy links swing as a longer pendulum
    # a hundredth: joint damping over 20 s (1e-4), large swing on the way (θ²/16 = 1e-4 of the
    # period, 3e-3 of a phase of 16 rad)
    assert found.arrival == pytest.approx(
        theory.quintic_residual(10.0, 20.0, length, setup.crane.gravity) * 15.0 / length, rel=0.01
    )


@pytest.mark.parametrize("move", [*MOVES, SWINGING], ids=lambda move: move.name)
def test_every_way_on_paper_keeps_the_limits_of_the_drives(
    setup: harness.Setup, move: RestToRest
) -> None:
    for strategy in ("spline alone", FLAT, "operator", "operator + ZVD"):
        plan = STRATEGIES[strategy](setup, move)
        motion = plan.motion or hanging_reference(setup.crane, plan.reference, plan.arrives + 1.0)
        shares = use(setup.crane, motion, LIMITS)
        # a trapezoid's acceleration jumps between samples of the spline that shapes it
        assert max(shares.values()) < 1.0 + 1e-6, (strategy, shares)


def test_the_operator_is_at_full_rate_at_once_and_stops_at_the_goal(setup: harness.Setup) -> None:
    reference, end = joystick_move(setup, COMBINED)
    assert reference(end).position == pytest.approx(COMBINED.goal, abs=1e-9)
    assert np.abs(reference(end + 1.0).velocity).max() == pytest.approx(0.0, abs=1e-12)
    speeds = np.array([np.abs(reference(t).velocity) for t in np.arange(0.0, end, 0.01)]).max(
        axis=0
    )
    assert speeds[1:] == pytest.approx(LIMITS.rates[1:])
    # a slew of 0.6 rad allows its full rate of 0.0838 rad/s: 0.0838²/0.02 = 0.35 rad are for
    # gaining and losing it
    assert speeds[0] == pytest.approx(LIMITS.rates[0])


def test_a_shaped_operator_leaves_what_the_shaper_leaves_of_the_bare_one(
    setup: harness.Setup,
) -> None:
    bare, shaped = (
        make(setup, TROLLEY, STRATEGIES[strategy](setup, TROLLEY))[1]
        for strategy in ("operator", "operator + ZV")
    )
    ratio = 1.0 / math.sqrt((15.0 + 500.0 / 15000.0) / 15.0) * (1.0 - bare.peak**2 / 16.0)
    # the shaper is made for a small swing of a point: what it leaves is its sensitivity at this
    # ratio, and the swing's second order
    assert shaped.arrival < bare.arrival * (float(zv().residual(ratio)) + 0.02)


def test_drives_that_yield_settle_what_the_operator_leaves(setup: harness.Setup) -> None:
    bare, yielding = (
        make(setup, COMBINED, STRATEGIES[strategy](setup, COMBINED))[1]
        for strategy in ("operator", "operator + yielding drives")
    )
    assert yielding.later < 0.05 * bare.later


@pytest.mark.parametrize("strategy", [FLAT, PAPER])
@pytest.mark.parametrize("mass", [500.0, 1500.0])
def test_a_load_of_another_mass_ends_where_it_shall(
    setup: harness.Setup, strategy: str, mass: float
) -> None:
    run, found = make(
        setup,
        COMBINED,
        STRATEGIES[strategy](setup, COMBINED),
        Perturbation("another load", load=mass / 1000.0),
    )
    # It sags or rises before the integrator has found the weight.
    assert np.abs(run["l_m"][run.t < 1.0] - 15.0).max() > 0.05
    # k_p/k_i is 2.5 s for the LQR and 4 s for the PID: after 40 s a thousandth of 0.5 m and less
    assert run["l_m"][-1] == pytest.approx(10.0, abs=1e-3)
    assert found.later < 1e-3


def test_a_longer_cable_is_longer_and_the_goal_with_it(setup: harness.Setup) -> None:
    run, found = make(
        setup, COMBINED, STRATEGIES[FLAT](setup, COMBINED), Perturbation("longer", cable=0.1)
    )
    assert run["l_m"][0] == pytest.approx(16.5)
    assert run["l_m"][-1] == pytest.approx(11.0, abs=0.01)
    assert found.settled < 10.0


def test_an_integrator_does_not_remember_another_run(setup: harness.Setup) -> None:
    plan = STRATEGIES[PAPER](setup, COMBINED)
    one, two = (make(setup, COMBINED, plan)[0] for _ in range(2))
    assert np.array_equal(one.q, two.q)


def test_a_predictive_controller_is_made_once_and_a_copy_remembers_nothing_of_another_run(
    setup: harness.Setup,
) -> None:
    plan = STRATEGIES[MPC](setup, COMBINED)
    one = plan.controller()
    one(0.0, COMBINED.ends(setup.crane)[0], plan.reference(0.0))
    two = plan.controller()
    assert one.last is not None and two.last is None  # type: ignore[attr-defined]
    assert one.sweep is two.sweep  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def done(ran: Callable[..., Ran]) -> Ran:
    # code that one worker makes serves all moves
    return ran("compare", "--only", *COMPARED, "--engine", FAST, "--jobs", "1")


@pytest.mark.long
def test_the_command_compares_the_ways_asked_for(done: Ran) -> None:
    assert (done.code, done.failed()) == (0, [])
    rows = {row["strategy"]: row for row in done.table("Move combined: (0.0, 10.0, 15.0) to")}
    assert list(rows) == COMPARED
    left = {strategy: row["at arrival [mrad]"] for strategy, row in rows.items()}
    assert left[FLAT] < 0.05 < 1.0 < left[PD]
    tour = {row["control"]: row for row in done.table("The article's seven legs as one tour")}
    assert list(tour) == ["none", "shaped", "paper", "lqr", "flat"]
    none, shaped, flat = (tour[name]["worst dwell [mrad]"] for name in ("none", "shaped", "flat"))
    told = [f"up to {none:.0f} mrad", f"up to {shaped:.0f} mrad", f"at most {flat:.3f} mrad"]
    assert missing(told, "README.md") == []


@pytest.mark.long
def test_feedback_outlives_every_case_and_a_swing_at_the_start(done: Ran) -> None:
    later = {row["strategy"]: row for row in done.table("Swing 20 s after the arrival")}
    alone = later["spline alone"][NOMINAL.name]
    assert all(later[FLAT][case.name] < 0.05 * alone for case in PERTURBATIONS)
    swinging = {row["strategy"]: row for row in done.table(f"Move {SWINGING.name}")}
    column = "20 s later [mrad]"
    assert swinging[FLAT][column] < 1e-2 * swinging["spline alone"][column]


@pytest.mark.long
def test_documents_show_the_ways_asked_for_as_printed(done: Ran) -> None:
    tables = [ResultTable.of(kept) for kept in done.result["tables"]]
    document = read_document(ROOT / "docs/results/control.md", "compare")
    assert document.stale(tables, subset=True) == []


@pytest.mark.long
def test_the_first_table_is_that_of_the_move_that_is_drawn(done: Ran) -> None:
    assert done.result["tables"][0]["title"].startswith("Move combined:")


@pytest.mark.long
def test_it_keeps_runs_figures_and_a_recording_of_several_drawn_into_each_other(done: Ran) -> None:
    expected = {"compare.rrd", "robustness.png", "swing.png", "compare_flat_lqr.parquet"}
    assert expected <= {path.name for path in done.folder.iterdir()}
    assert len(read(done.folder / "compare_flat_lqr.parquet")) == 8001
    recording = (done.folder / "compare.rrd").read_bytes()
    assert all(strategy.encode() in recording for strategy in (PD, FLAT))
    assert '<section id="compare">' in page([done.folder])


@pytest.mark.parametrize("count", [1, 3])
def test_the_figure_of_few_strategies_shows_its_label_whole_and_says_which_move_it_is(
    count: int,
) -> None:
    still = simulate(crane(), hold_controller(crane()), duration=0.1)
    figure = swing_figure(COMBINED, {f"strategy {i}": still for i in range(count)})
    figure.draw_without_rendering()
    label = figure._supylabel.get_window_extent()  # type: ignore[attr-defined]
    assert figure.bbox.y0 <= label.y0
    assert label.y1 <= figure.bbox.y1
    assert "combined move" in figure.axes[0].get_title(loc="left")


@pytest.mark.parametrize(("drive", "least"), [("ideal", 1e-3), ("velocity", 0.1)])
def test_a_swing_that_the_table_calls_smaller_than_its_resolution_is_drawn_at_that_resolution(
    drive: str, least: float
) -> None:
    score = _scored().score
    assert score is not None
    tiny = StrategyResult(replace(score, later=1e-9))
    large = StrategyResult(replace(score, later=2e-3))
    results = {FLAT: {NOMINAL.name: tiny}, PD: {NOMINAL.name: large}}
    (ax,) = robustness_figure(COMBINED, results, drive).axes
    (points,) = ax.lines
    assert points.get_xdata() == pytest.approx([least, 2.0])
    assert f"{least:g} mrad" in ax.get_xlabel()
    assert "combined move" in ax.get_title(loc="left")


@pytest.mark.parametrize("timed", [True, False])
def test_garbage_is_not_collected_while_a_controller_is_timed(timed: bool) -> None:
    with pytest.raises(KeyboardInterrupt), compare_runs.collector_waits(timed):
        assert gc.isenabled() is not timed
        raise KeyboardInterrupt
    assert gc.isenabled()


def test_strategies_that_are_usually_not_recorded_are_where_there_are_no_others() -> None:
    assert compare.recorded_strategies([FLAT, "operator", PD]) == [PD, FLAT]
    assert compare.recorded_strategies(["operator", "spline alone"]) == ["operator", "spline alone"]


def _scored(settled: float = 0.0, arrives: float = 10.0) -> StrategyResult:
    numbers = np.zeros(3)
    return StrategyResult(
        Score(arrives, 0.03, 1e-6, 1e-6, settled, 10.0, numbers, numbers, numbers, 1.0, 1.0, 0.0)
    )


def _judged(claims: Sequence[harness.Claim], words: str) -> list[bool | None]:
    return [claim.holds for claim in claims if words in claim.sentence]


@pytest.mark.parametrize(("least", "holds"), [(12.0, True), (15.5, False)])
def test_the_move_of_least_time_is_held_against_the_fastest_flat_path_under_the_same_limits(
    least: float, holds: bool
) -> None:
    found = {
        TIME: {NOMINAL.name: _scored(arrives=least)},
        FLAT: {NOMINAL.name: _scored(arrives=20.0)},
    }
    # Nothing of its kind to hold it against.
    assert _judged(compare_claims.ideal_claims(harness.Setup(), found), "least time") == []
    found[FASTEST] = {NOMINAL.name: _scored(arrives=15.0)}
    assert _judged(compare_claims.ideal_claims(harness.Setup(), found), "least time") == [holds]


@pytest.mark.parametrize(("longest", "holds"), [(0.049, True), (0.073, False)])
def test_the_predictive_controller_is_judged_by_its_longest_call_in_any_run(
    longest: float, holds: bool
) -> None:
    quick = np.full(20, 1e-3)
    slow = np.full(20, 1e-3)
    slow[13] = longest
    moves = {
        case: {MPC: {case: _scored()._replace(calls=calls)}}
        for case, calls in (("one", quick), ("another", slow))
    }
    (claim,) = compare_claims.time_claims(harness.Setup(), moves)
    assert claim.holds is holds
    assert f"{1e3 * longest:.2g} ms of processor time at most" in claim.sentence


def test_time_that_other_work_takes_from_the_processor_is_not_the_controllers() -> None:
    calls: list[float] = []
    controller = compare_runs._timed(lambda: lambda t, state, setpoint: time.sleep(0.05), calls)  # type: ignore[return-value, arg-type]
    controller(0.0, None, None)  # type: ignore[arg-type]
    assert calls[0] < 0.01


def test_the_fastest_flat_path_uses_a_limit_fully_and_keeps_all(setup: harness.Setup) -> None:
    motion = STRATEGIES[FASTEST](setup, COMBINED).motion
    assert motion is not None
    # the duration is found to a thousandth of a second of some fifteen, and rounded up to rows 5 ms
    # apart; accelerations go with its square
    assert 0.998 < max(use(setup.crane, motion, LIMITS).values()) <= 1.0


def test_what_the_first_call_of_a_controller_compiles_is_not_counted_as_its_time() -> None:
    is_compiled = False

    def controller(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        nonlocal is_compiled
        compiled_at = time.thread_time() + 0.05
        while not is_compiled and time.thread_time() < compiled_at:
            pass
        is_compiled = True
        return np.zeros(3)

    calls: list[float] = []
    timed = compare_runs._timed(lambda: controller, calls)
    drives = np.zeros(3)
    for t in (0.0, 0.05):
        timed(t, crane().start, Setpoint(drives, drives, drives))
    assert len(calls) == 2
    assert max(calls) < 0.025
