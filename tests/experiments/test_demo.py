"""The demo: legs, dwells, streaming, and that nothing is lost when it is stopped or killed."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory, join, read
from cranedyn.planning.itinerary import ARTICLE_TOUR, Leg, itinerary
from cranedyn.recording import Live
from experiments import demo, harness
from experiments.endless import Dwell, Dwells
from experiments.report import page
from experiments.scenarios.moves import residual
from tests.helpers import FAST, ROOT, crane
from tests.told import missing

RATES = (0.08, 0.8, 0.8)
"""Of the article: slew [rad/s], trolley and hoist [m/s]."""


def times(file: Path) -> np.ndarray:
    """Every time at which numbers stand in a recording [s], increasing."""
    found = [np.zeros(0)]
    for chunk in RrdReader(str(file)).stream():
        batch = chunk.to_record_batch()
        if "Run:row" in "".join(batch.schema.names):
            column = next(i for i, name in enumerate(batch.schema.names) if "sim_time" in name)
            found.append(batch.column(column).cast("int64").to_numpy() / 1e9)
    return np.unique(np.concatenate(found).round(9))


def test_the_tour_visits_the_published_targets_and_returns() -> None:
    tour = itinerary(crane(), crane().start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    arrivals = [tour(stage.arrival).position for stage in tour.stages]
    assert [a[1] for a in arrivals[:4]] == [20.0, 20.0, 20.0, 6.0]
    assert [a[2] for a in arrivals[:4]] == [15.0, 24.0, 10.0, 10.0]
    assert arrivals[4][0] == 0.6
    np.testing.assert_allclose(arrivals[-1], crane().start.q[[0, 1, 4]])


def test_no_drive_exceeds_its_rate_or_jumps_over_two_cycles() -> None:
    tour = itinerary(crane(), crane().start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    t = np.arange(0.0, 2 * tour.duration, 0.05)
    position = np.array([tour(s).position for s in t])
    # 1e-9: rounding of the differences
    assert (
        np.abs(np.diff(position, axis=0) / 0.05).max(axis=0) <= np.array(RATES) * (1 + 1e-9)
    ).all()


def test_every_dwell_stands_still_as_long_as_asked_for() -> None:
    tour = itinerary(crane(), crane().start, ARTICLE_TOUR, rates=RATES, dwell=2.5)
    for stage in tour.stages:
        assert stage.end - stage.arrival == pytest.approx(2.5)
        np.testing.assert_array_equal(
            tour(stage.arrival + 0.1).position, tour(stage.end - 0.1).position
        )
        assert not tour(stage.arrival + 0.1).velocity.any()


@pytest.mark.parametrize(
    ("legs", "rates", "dwell", "words"),
    [
        ((Leg("away", x=15.0),), RATES, 6.0, "end of the tour"),
        ((), RATES, 6.0, "tour is empty"),
        (ARTICLE_TOUR, (0.08, 0.0, 0.8), 6.0, "rate of x is 0.0 m/s"),
        (ARTICLE_TOUR, RATES, -1.0, "dwell is -1.0 s"),
        (
            (Leg("nowhere", x=float("nan")), Leg("back", x=10.0)),
            RATES,
            6.0,
            "x of leg nowhere is nan",
        ),
    ],
)
def test_an_impossible_tour_is_refused_with_a_sentence(
    legs: tuple[Leg, ...], rates: tuple[float, ...], dwell: float, words: str
) -> None:
    with pytest.raises(harness.CraneError, match=words):
        itinerary(crane(), crane().start, legs, rates=rates, dwell=dwell)


def test_pieces_joined_are_the_run_in_one_go_to_the_bit() -> None:
    setup = harness.Setup()
    tour = itinerary(setup.crane, setup.crane.start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    joined = join(list(demo.pieces(setup, tour, hold_controller(setup.crane), 3.0)))
    whole = setup.simulate(
        setup.crane,
        hold_controller(setup.crane),
        tour,
        start=setup.crane.start,
        duration=3.0,
        label="",
    )
    # velocities pass through the unit of the step at every seam: one rounding each, 1e-16 of values
    # up to 1, grown over 3 s
    np.testing.assert_allclose(joined.q, whole.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(joined.work, whole.work, rtol=0, atol=1e-6)
    np.testing.assert_allclose(joined.t, whole.t, rtol=0, atol=1e-12)


def test_residual_is_the_amplitude_of_a_known_swing() -> None:
    t = np.linspace(0.0, 20.0, 4001)
    q = np.zeros((4001, 5))
    q[:, 2], q[:, 3] = 0.03 * np.cos(t), 0.04 * np.sin(t)
    empty = np.zeros((4001, 3))
    run = Trajectory(
        t,
        q,
        0 * q,
        empty,
        empty,
        empty,
        0 * t,
        empty,
        0 * t,
        np.zeros((4001, 6)),
        np.zeros((4001, 2)),
        0 * t + 1,
        crane().layout.columns(),
    )
    assert residual(run) == pytest.approx(0.05, rel=1e-5)  # 4001 samples meet the tops within 1e-6


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    assert demo.main(["--cycles", "1", "--engine", FAST, "--out", str(folder / "demo")]) == 0
    return folder / "demo"


def test_the_load_keeps_swinging_in_every_dwell_and_the_table_says_how_much(done: Path) -> None:
    result = json.loads((done / "result.json").read_text())
    rows = result["tables"][0]["rows"]
    assert [row[0] for row in rows] == [leg.name for leg in ARTICLE_TOUR]
    left = [row[2] for row in rows]
    assert min(left) > 1.0
    assert missing([f"{min(left):.0f} to {max(left):.0f} mrad"], "README.md") == []
    run = read(done / "demo.parquet")
    last = run.between(run.t[-1] - 6.0, run.t[-1])
    assert 1000 * residual(last) == pytest.approx(rows[-1][2], rel=1e-6)


def test_the_report_shows_the_result(done: Path) -> None:
    assert '<section id="demo">' in page([done])


def test_what_the_first_leg_leaves_is_the_closed_forms_and_that_of_another_lag_is_not(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    claims = json.loads((done / "result.json").read_text())["claims"]
    assert [claim["holds"] for claim in claims] == [True, True]
    setup, run = harness.Setup(), read(done / "demo.parquet")
    tour = itinerary(setup.crane, setup.crane.start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    dwells = Dwells(tour, setup.control_period)
    dwells.add(run.between(0.0, tour.stages[0].end))
    assert [claim.holds for claim in demo._bare(setup, tour, dwells)] == [True, True]
    monkeypatch.setattr(demo, "DAMPING", {"trolley": 4.0 * demo.DAMPING["trolley"]})
    dwells.rows = [Dwell("leg", 0.0, 100.0, 9.0)]  # 9 mm at the hook count as settled
    assert [claim.holds for claim in demo._bare(setup, tour, dwells)] == [False, False]


def test_flat_paths_may_leave_what_sampling_makes_of_the_swing_and_no_more() -> None:
    setup = harness.Setup()
    dwells = Dwells(
        itinerary(setup.crane, setup.crane.start, ARTICLE_TOUR, rates=RATES, dwell=6.0),
        setup.control_period,
    )
    dwells.peak, dwells.shortest = 0.04, 10.0
    most = np.sqrt(setup.gravity / 10.0) * 2.5e-3 * 40.0  # mrad
    for left, holds in ((0.99 * most, True), (1.01 * most, False)):
        dwells.rows = [Dwell("leg", 0.0, left, 0.0)]
        assert demo._nothing(setup, dwells).holds == holds


def test_the_recording_of_a_finished_demo_holds_every_instant(done: Path) -> None:
    run = read(done / "demo.parquet")
    np.testing.assert_allclose(times(done / "demo.rrd"), run.t, rtol=0, atol=1e-9)


def start(folder: Path) -> subprocess.Popen[bytes]:
    """A demo in a process of its own, already writing."""
    command = [sys.executable, "-m", "experiments.demo", "--pace", "20", "--out", str(folder)]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT
    )
    for _ in range(600):
        # While its first bytes are being written it is no recording yet.
        with contextlib.suppress(RuntimeError, ValueError):
            if (folder / "demo.rrd").is_file() and len(times(folder / "demo.rrd")) > 100:
                return process
        time.sleep(0.05)
    process.kill()
    raise AssertionError("the demo did not begin to write within 30 s")


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_ctrl_c_leaves_everything_complete(tmp_path: Path) -> None:
    process = start(tmp_path / "demo")
    process.send_signal(signal.SIGINT)
    try:
        assert process.wait(30) == 0
    finally:
        process.kill()
    run = read(tmp_path / "demo" / "demo.parquet")
    assert run.t[-1] >= 0.5  # the first piece at least
    np.testing.assert_allclose(times(tmp_path / "demo" / "demo.rrd"), run.t, rtol=0, atol=1e-9)


@pytest.mark.skipif(os.name == "nt", reason="kill -9 is a signal of POSIX")
@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_killed_demo_leaves_a_file_that_opens(tmp_path: Path) -> None:
    process = start(tmp_path / "demo")
    process.send_signal(signal.SIGKILL)
    process.wait(30)
    t = times(tmp_path / "demo" / "demo.rrd")
    assert t[0] == 0.0
    assert t[-1] >= 0.5  # the first piece at least
    # no gap: rows every 5 ms, times to the nanosecond
    np.testing.assert_allclose(np.diff(t), 0.005, rtol=0, atol=2e-9)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--rate-x", "0"], "rate limit of x is 0.0 m/s"),
        (["--dwell", "-1"], "dwell is -1.0 s"),
        (["--cycles", "0"], "cycles is 0.0"),
        (["--pace", "-2", "--cycles", "1"], "pace is -2.0"),
        (["--set", "trolley_max:=15"], "x at the start is 20.0 m; allowed is 2 to 15"),
        (["--payload-mass", "0"], "payload_mass is 0.0 kg"),
        (["--view", "--cycles", "1"], "--serve"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_written(
    words: list[str],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert demo.main([*words, "--out", str(tmp_path / "demo")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "demo").exists()


def test_a_live_recording_shows_the_energy_of_the_whole_run_not_of_its_pieces(
    tmp_path: Path,
) -> None:
    setup = harness.Setup(engine=FAST)
    tour = itinerary(setup.crane, setup.crane.start, ARTICLE_TOUR, rates=RATES, dwell=6.0)
    pieces = list(demo.pieces(setup, tour, hold_controller(setup.crane), 2.0))
    with Live(setup.crane, "demo", title="Live", file=tmp_path / "live.rrd") as live:
        for piece in pieces:
            live.append(piece)
    rows = {}
    for chunk in RrdReader(str(tmp_path / "live.rrd")).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        if "Run:row" in names:
            t = (
                batch.column(next(i for i, n in enumerate(names) if "sim_time" in n))
                .cast("int64")
                .to_pylist()
            )
            rows |= dict(
                zip(
                    t,
                    [row[0] for row in batch.column(names.index("Run:row")).to_pylist()],
                    strict=True,
                )
            )
    whole = join(pieces)
    shown = [rows[t] for t in sorted(rows)]
    np.testing.assert_allclose([row["W_x_J"] for row in shown], whole["W_x_J"], rtol=0, atol=1e-9)
    # 1e-7: energies of 2e5 J are sums that round at 3e-11
    np.testing.assert_allclose(
        [row["unexplained_J"] for row in shown], whole.unexplained, rtol=0, atol=1e-7
    )
    np.testing.assert_allclose(
        [row["energy_J"] for row in shown], whole.energy - whole.energy[0], rtol=0, atol=1e-9
    )


def test_a_rate_that_ends_between_control_instants_loses_no_leg_and_units_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        demo.main(
            [
                "--cycles",
                "1",
                "--rate-x",
                "0.7",
                "--dwell",
                "1",
                "--engine",
                FAST,
                "--out",
                str(tmp_path / "demo"),
            ]
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert printed.count("the load still swings") == len(ARTICLE_TOUR)
    assert {"residual", "swing", "[mrad]"} <= set(printed.split())  # a head may fold
    assert len(
        json.loads((tmp_path / "demo" / "result.json").read_text())["tables"][0]["rows"]
    ) == len(ARTICLE_TOUR)
