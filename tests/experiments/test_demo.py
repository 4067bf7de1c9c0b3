"""The demo: legs, dwells, streaming, a run without end in bounded memory, and that nothing is lost
when it is stopped or killed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import QUANTITIES, Trajectory, join, read
from cranedyn.lifts.planning.itinerary import ARTICLE_TOUR, itinerary
from cranedyn.recording import Live
from experiments import demo, harness
from experiments.demo import endless, live
from experiments.scenarios.moves import residual
from tests.document_numbers import missing
from tests.experiments.conftest import Ran
from tests.helpers import FAST, ROOT, crane, files
from tests.rrd import chunks

RATES = (0.08, 0.8, 0.8)
"""Of the article: slew [rad/s], trolley and hoist [m/s]."""

WORLD = harness.Setup(engine=FAST)
TOUR = itinerary(WORLD.crane, WORLD.crane.start, ARTICLE_TOUR, rates=RATES, dwell=3.0)


def times(file: Path) -> np.ndarray:
    """Every time at which numbers stand in a recording [s], increasing."""
    return np.array(sorted(rows(file))) / 1e9


def rows(file: Path) -> dict[int, dict[str, float]]:
    """The numbers in a recording by their times [ns]."""
    found = {}
    for _, batch in chunks(file):
        if "Run:row" in batch.schema.names:
            t = batch["sim_time"].cast("int64")
            numbers = batch["Run:row"].flatten()
            found |= dict(zip(t.to_pylist(), numbers.to_pylist(), strict=True))
    return found


# --- the tour -------------------------------------------------------------------------------------


def test_the_tour_visits_the_published_targets_and_returns() -> None:
    arrivals = [TOUR(stage.arrival).position for stage in TOUR.stages]
    assert [a[1] for a in arrivals[:4]] == [20.0, 20.0, 20.0, 6.0]
    assert [a[2] for a in arrivals[:4]] == [15.0, 24.0, 10.0, 10.0]
    assert arrivals[4][0] == 0.6
    assert_allclose(arrivals[-1], crane().start.q[[0, 1, 4]])


def test_no_drive_exceeds_its_rate_and_every_dwell_stands_still_as_long_as_asked_for() -> None:
    position = np.array([TOUR(t).position for t in np.arange(0.0, 2 * TOUR.duration, 0.05)])
    fastest = np.abs(np.diff(position, axis=0) / 0.05).max(axis=0)
    assert (fastest <= np.array(RATES) * (1 + 1e-9)).all()  # rounding of the differences
    for stage in TOUR.stages:
        assert stage.end - stage.arrival == pytest.approx(3.0)
        resting = TOUR(stage.arrival + 0.1)
        leaving = TOUR(stage.end - 0.1)
        assert_array_equal(resting.position, leaving.position)
        assert not resting.velocity.any()


# --- pieces ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pieces() -> list[Trajectory]:
    return list(live.pieces(WORLD, TOUR, hold_controller(WORLD.crane), TOUR.duration + 20.0))


def test_pieces_joined_are_the_run_in_one_go(pieces: list[Trajectory]) -> None:
    joined = join([piece for piece in pieces if piece.t[-1] < 3.0 + 1e-9])
    c = WORLD.crane
    whole = WORLD.simulate(
        c, hold_controller(c), TOUR, start=c.start, duration=float(joined.t[-1]), label=""
    )
    # velocities pass through the unit of the step at every seam: one rounding each, 1e-16 of values
    # up to 1, grown over 3 s
    assert_allclose(joined.q, whole.q, rtol=0, atol=1e-12)
    assert_allclose(joined.work, whole.work, rtol=0, atol=1e-6)
    assert_allclose(joined.t, whole.t, rtol=0, atol=1e-12)


def test_residual_is_the_amplitude_of_a_known_swing(pieces: list[Trajectory]) -> None:
    run = join(pieces).before(20.0)
    swing = np.zeros_like(run.q)
    swing[:, 2] = 0.03 * np.cos(run.t)
    swing[:, 3] = 0.04 * np.sin(run.t)
    # rows 5 ms apart meet the tops within 1e-5
    assert residual(replace(run, q=swing)) == pytest.approx(0.05, rel=1e-5)


@pytest.mark.slow
def test_memory_holds_two_parts_at_most_and_the_files_hold_the_rest(
    pieces: list[Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(endless, "PART", 7.0)
    record = endless.EndlessRecord(tmp_path / "demo.parquet")
    for piece in pieces:
        record.append(piece)
        last = record.last()
        assert last.t[-1] == piece.t[-1]
        assert last.t[-1] - last.t[0] < 14.0
    names = [part.name for part in record.parts[:3]]
    assert names == [f"demo_from_{begin}s.parquet" for begin in (0, 7, 14)]
    parts = [*map(read, record.parts), record.last()]
    whole = join(pieces)
    for name in set(QUANTITIES) - {"work", "dissipated", "outside"}:
        together = np.concatenate([getattr(part, name) for part in parts])
        assert_array_equal(together, getattr(whole, name))
    for part in parts:
        assert not part.work[0].any()
        assert not part.outside[0].any()
        assert part.dissipated[0] == 0.0
        unexplained = whole.unexplained[(whole.t >= part.t[0]) & (whole.t <= part.t[-1])]
        # 1e-7: sums up to 2e6 J that begin at another row round at 5e-10 each
        assert_allclose(part.unexplained, unexplained - unexplained[0], rtol=0, atol=1e-7)


def test_what_is_left_in_the_dwells_is_the_same_from_pieces_as_from_the_whole_run(
    pieces: list[Trajectory],
) -> None:
    dwells = endless.Dwells(TOUR, WORLD.control_period)
    whole = join(pieces)
    told = [dwell for piece in pieces if (dwell := dwells.add(piece)) is not None]
    assert told == dwells.rows
    assert [row.leg for row in dwells.rows[:7]] == [leg.name for leg in ARTICLE_TOUR]
    stages = ((c, s) for c in (0.0, TOUR.duration) for s in TOUR.stages)
    for row, (cycle, stage) in zip(dwells.rows, stages, strict=False):
        rest = whole.between(cycle + stage.arrival, cycle + stage.end)
        assert row.arrival == cycle + stage.arrival
        assert row.swing == pytest.approx(1000.0 * residual(rest), rel=1e-12)
        assert row.deviation == pytest.approx(row.swing * rest.q[-1, 4], rel=1e-12)


@pytest.mark.slow
def test_a_live_recording_shows_the_energy_of_the_whole_run_not_of_its_pieces(
    pieces: list[Trajectory], tmp_path: Path
) -> None:
    few = [piece for piece in pieces if piece.t[-1] < 2.0 + 1e-9]
    with Live(WORLD.crane, "demo", title="Live", file=tmp_path / "live.rrd") as live:
        for piece in few:
            live.append(piece)
    whole = join(few)
    shown = sorted(rows(tmp_path / "live.rrd").items())
    kept = np.searchsorted(whole.t, [1e-9 * t - 1e-9 for t, _ in shown])
    for name, expected, rounding in (
        ("W_x_J", whole["W_x_J"], 1e-9),
        (
            "unexplained_J",
            whole.unexplained,
            1e-7,
        ),  # energies of 2e5 J are sums that round at 3e-11
        ("energy_J", whole.energy - whole.energy[0], 1e-9),
    ):
        # Recorded in single precision.
        assert_allclose([row[name] for _, row in shown], expected[kept], rtol=6e-8, atol=rounding)


# --- the command ----------------------------------------------------------------------------------


def assert_covered(shown: np.ndarray, t: np.ndarray) -> None:
    """Check that recorded times are those of rows from the first to the last, without gaps."""
    assert_allclose(t[np.searchsorted(t, shown - 2e-9)], shown, rtol=0, atol=2e-9)
    assert_allclose(shown[[0, -1]], t[[0, -1]], rtol=0, atol=2e-9)
    assert np.diff(shown).max() < 0.02 + 4e-9


@pytest.fixture(scope="module")
def done(ran: Callable[..., Ran]) -> Ran:
    return ran("demo", "--cycles", "1", "--engine", FAST)


def test_the_load_keeps_swinging_in_every_dwell_and_the_table_says_how_much(done: Ran) -> None:
    table = done.result["tables"][0]["rows"]
    assert [row[0] for row in table] == [leg.name for leg in ARTICLE_TOUR]
    left = [row[2] for row in table]
    assert min(left) > 1.0
    assert missing([f"{min(left):.0f} to {max(left):.0f} mrad"], "README.md") == []
    run = read(done.folder / "demo.parquet")
    last = run.between(run.t[-1] - 6.0, run.t[-1])
    assert 1000 * residual(last) == pytest.approx(table[-1][2], rel=1e-6)
    assert_covered(times(done.folder / "demo.rrd"), run.t)


def test_what_the_first_leg_leaves_is_the_closed_forms_and_that_of_another_lag_is_not(
    done: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (done.code, done.failed()) == (0, [])
    run = read(done.folder / "demo.parquet")
    tour = itinerary(WORLD.crane, WORLD.crane.start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    dwells = endless.Dwells(tour, WORLD.control_period)
    dwells.add(run.between(0.0, tour.stages[0].end))
    assert [claim.holds for claim in demo._uncontrolled_claims(WORLD, tour, dwells)] == [True, True]
    monkeypatch.setattr(demo, "DAMPING", {"trolley": 4.0 * demo.DAMPING["trolley"]})
    dwells.rows = [endless.Dwell("leg", 0.0, 100.0, 9.0)]  # 9 mm at the hook count as settled
    assert [claim.holds for claim in demo._uncontrolled_claims(WORLD, tour, dwells)] == [
        False,
        False,
    ]


def test_flat_paths_may_leave_what_sampling_makes_of_the_swing_and_no_more() -> None:
    dwells = endless.Dwells(TOUR, WORLD.control_period)
    dwells.peak = 0.04
    dwells.shortest = 10.0
    most = np.sqrt(WORLD.gravity / 10.0) * 2.5e-3 * 40.0  # mrad
    for left, holds in ((0.99 * most, True), (1.01 * most, False)):
        dwells.rows = [endless.Dwell("leg", 0.0, left, 0.0)]
        assert [claim.holds for claim in demo._flat_claims(WORLD, dwells)] == [holds]


@pytest.mark.long
def test_the_controlled_demo_has_no_swing_worth_the_name_and_is_recorded_over_that_without(
    ran: Callable[..., Ran],
) -> None:
    flat = ran("demo", "--control", "flat", "--cycles", "0.4", "--engine", FAST)
    assert (flat.code, flat.failed()) == (0, [])
    after, before = flat.result["tables"]
    assert max(row[2] for row in after["rows"]) < 0.1
    assert min(row[2] for row in before["rows"]) > 50.0
    assert {"demo.parquet", "demo_before.parquet", "demo.rrd", "swing.png"} <= {*files(flat.folder)}
    recording = (flat.folder / "demo.rrd").read_bytes()
    assert b"control flat" in recording
    assert b"without control" in recording


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
@pytest.mark.parametrize("control", [pytest.param("none", marks=pytest.mark.long), "flat"])
def test_a_long_demo_leaves_its_parts_and_its_last_minutes(
    control: str, monkeypatch: pytest.MonkeyPatch, ran: Callable[..., Ran]
) -> None:
    monkeypatch.setattr(endless, "PART", 12.0)
    monkeypatch.setattr(live, "MAX_FILE_DURATION", 14.0)
    words = "--cycles 0.3 --dwell 1 --control".split()
    long = ran("demo", *words, control, "--engine", FAST)
    parts = [read(long.folder / name) for name in long.result["parameters"]["earlier_parts"]]
    last = read(long.folder / "demo.parquet")
    t = np.concatenate([part.t for part in (*parts, last)])
    assert_allclose(t, 0.005 * np.arange(len(t)), rtol=0, atol=1e-9)
    assert len(parts) >= 1
    assert last.t[-1] - last.t[0] < 24.0
    note = f"What happened before t = {last.t[0]:.0f} s is in demo_from_0s.parquet"
    assert note in long.result["tables"][0]["note"]
    earlier = [times(path) for path in long.folder.glob("demo_from_*.rrd")]
    assert_covered(np.unique(np.concatenate(earlier)), t)
    assert_covered(times(long.folder / "demo.rrd"), last.t)
    if control != "none":
        bare = read(long.folder / "demo_before.parquet")
        assert bare.t[0] == 0.0
        assert bare.t[-1] == pytest.approx(24.0)
        assert len(long.result["tables"][1]["rows"]) >= 1


def test_a_short_demo_has_no_parts(ran: Callable[..., Ran]) -> None:
    short = ran("demo", "--cycles", "0.01", "--engine", FAST)
    names = "demo.parquet demo.rrd result.json swing.png swing.svg"
    assert files(short.folder) == names.split()


@pytest.mark.long
def test_a_rate_that_ends_between_control_instants_loses_no_leg_and_units_are_printed(
    ran: Callable[..., Ran],
) -> None:
    made = ran("demo", *"--cycles 1 --rate-x 0.7 --dwell 1 --engine".split(), FAST)
    assert made.text.count("the load still swings") == len(ARTICLE_TOUR)
    assert {"residual", "swing", "[mrad]"} <= set(made.text.split())  # a head may fold
    assert len(made.result["tables"][0]["rows"]) == len(ARTICLE_TOUR)


def _start(folder: Path, *words: str) -> subprocess.Popen[str]:
    """A demo in a process of its own, already writing."""
    command = [sys.executable, "-m", "experiments.demo", *words, "--out", str(folder)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, cwd=ROOT, **pipes)
    for _ in range(2400):
        # While its first bytes are being written it is no recording yet.
        with contextlib.suppress(RuntimeError, ValueError):
            if (folder / "demo.rrd").is_file() and len(rows(folder / "demo.rrd")) > 100:
                return process
        time.sleep(0.05)
    process.kill()
    raise AssertionError("the demo did not begin to write within two minutes")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_ctrl_c_ends_a_demo_with_its_comparison_soon_and_leaves_everything_complete(
    tmp_path: Path,
) -> None:
    """What would have run without control is simulated alongside, so that nothing is left to
    simulate when Ctrl-C comes.
    """
    folder = tmp_path / "demo"
    process = _start(folder, *"--control shaped --pace 20 --engine".split(), FAST)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (0, "")
    run = read(folder / "demo.parquet")
    bare = read(folder / "demo_before.parquet")
    assert run.t[-1] >= 0.5  # the first piece at least
    assert bare.t[-1] == pytest.approx(run.t[-1], abs=0.51)  # a piece at most
    assert_covered(times(folder / "demo.rrd"), run.t)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="kill -9 is a signal of POSIX")
@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_killed_demo_leaves_a_file_that_opens(tmp_path: Path) -> None:
    process = _start(tmp_path / "demo", "--pace", "20")
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=120)
    t = times(tmp_path / "demo" / "demo.rrd")
    assert t[0] == 0.0
    assert t[-1] >= 0.5  # the first piece at least
    assert_covered(t, np.arange(0.0, t[-1] + 0.0025, 0.005))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--rate-x 0", "rate limit of x is 0.0 m/s"),
        ("--dwell -1", "dwell is -1.0 s"),
        ("--cycles 0", "cycles is 0.0"),
        ("--cycles 1e-9", "cycles is 1e-09; allowed is 3.82e-05 or more, one control period"),
        ("--pace -2 --cycles 1", "pace is -2.0"),
        ("--set trolley_max:=15", "x at the start is 20.0 m; allowed is 2 to 15"),
        ("--set payload_mass:=0", "payload_mass is 0 kg"),
        ("--view --cycles 1", "--serve"),
        ("--control shaped --dwell 2 --cycles 1", "so it must be that at least"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_written(
    words: str,
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert demo.main([*words.split(), "--out", str(tmp_path / "demo")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "demo").exists()
