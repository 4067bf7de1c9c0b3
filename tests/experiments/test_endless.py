"""A demo without end: memory holds its last minutes, files hold what came before, and it ends soon
after Ctrl-C.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import QUANTITIES, Trajectory, join, read
from cranedyn.planning.itinerary import ARTICLE_TOUR, itinerary
from experiments import demo, endless, harness
from experiments.endless import Dwells, EndlessRecord
from experiments.scenarios.moves import residual
from tests.experiments.test_demo import RATES, times
from tests.helpers import FAST, ROOT, files

WORLD = harness.Setup(engine=FAST)
TOUR = itinerary(WORLD.crane, WORLD.crane.start, ARTICLE_TOUR, rates=RATES, dwell=3.0)


@pytest.fixture(scope="module")
def pieces() -> list[Trajectory]:
    return list(demo.pieces(WORLD, TOUR, hold_controller(WORLD.crane), TOUR.duration + 20.0))


def test_memory_holds_two_parts_at_most_and_the_files_hold_the_rest(
    pieces: list[Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(endless, "PART", 7.0)
    record = EndlessRecord(tmp_path / "demo.parquet")
    for piece in pieces:
        record.append(piece)
        last = record.last()
        assert last.t[-1] == piece.t[-1]
        assert last.t[-1] - last.t[0] < 14.0
    assert [part.name for part in record.parts[:3]] == [
        "demo_from_0s.parquet",
        "demo_from_7s.parquet",
        "demo_from_14s.parquet",
    ]
    parts = [*map(read, record.parts), record.last()]
    whole = join(pieces)
    for name in set(QUANTITIES) - {"work", "dissipated", "outside"}:
        np.testing.assert_array_equal(
            np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name)
        )
    for part in parts:
        assert not part.work[0].any() and not part.outside[0].any() and part.dissipated[0] == 0.0
        rows = (whole.t >= part.t[0]) & (whole.t <= part.t[-1])
        # 1e-7: sums up to 2e6 J that begin at another row round at 5e-10 each
        np.testing.assert_allclose(
            part.unexplained,
            whole.unexplained[rows] - whole.unexplained[rows][0],
            rtol=0,
            atol=1e-7,
        )


def test_what_is_left_in_the_dwells_is_the_same_from_pieces_as_from_the_whole_run(
    pieces: list[Trajectory],
) -> None:
    dwells, whole = Dwells(TOUR, WORLD.control_period), join(pieces)
    told = [found for piece in pieces if (found := dwells.add(piece)) is not None]
    assert told == dwells.rows
    assert [row.leg for row in dwells.rows[:7]] == [leg.name for leg in ARTICLE_TOUR]
    for row, (cycle, stage) in zip(
        dwells.rows, ((c, s) for c in (0.0, TOUR.duration) for s in TOUR.stages), strict=False
    ):
        rest = whole.between(cycle + stage.arrival, cycle + stage.end)
        assert row.arrival == cycle + stage.arrival
        assert row.swing == pytest.approx(1000.0 * residual(rest), rel=1e-12)
        assert row.deviation == pytest.approx(row.swing * rest.q[-1, 4], rel=1e-12)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
@pytest.mark.parametrize("control", ["none", "flat"])
def test_a_long_demo_leaves_its_parts_and_its_last_minutes(
    control: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name, value in (
        (endless, "PART", 12.0),
        (demo, "PART", 12.0),
        (demo, "RECORDED", 14.0),
    ):
        monkeypatch.setattr(module, name, value)
    words = [
        "--cycles",
        "0.3",
        "--dwell",
        "1",
        "--control",
        control,
        "--engine",
        FAST,
        "--out",
        str(tmp_path / "demo"),
    ]
    assert demo.main(words) == 0
    folder = tmp_path / "demo"
    result = json.loads((folder / "result.json").read_text())
    parts = [read(folder / name) for name in result["parameters"]["earlier_parts"]]
    last = read(folder / "demo.parquet")
    t = np.concatenate([part.t for part in (*parts, last)])
    np.testing.assert_allclose(t, 0.005 * np.arange(len(t)), rtol=0, atol=1e-9)
    assert len(parts) >= 1 and last.t[-1] - last.t[0] < 24.0
    assert (
        f"What happened before t = {last.t[0]:.0f} s is in demo_from_0s.parquet"
        in result["tables"][0]["note"]
    )
    recorded = np.unique(np.concatenate([times(path) for path in folder.glob("demo_from_*.rrd")]))
    np.testing.assert_allclose(recorded, t, rtol=0, atol=1e-9)
    np.testing.assert_allclose(times(folder / "demo.rrd"), last.t, rtol=0, atol=1e-9)
    if control != "none":
        bare = read(folder / "demo_before.parquet")
        assert bare.t[0] == 0.0 and bare.t[-1] == pytest.approx(24.0)
        assert len(result["tables"][1]["rows"]) >= 1
    assert not [name for name in files(folder) if name.startswith(".")]


def test_a_short_demo_has_no_parts(tmp_path: Path) -> None:
    assert demo.main(["--cycles", "0.01", "--engine", FAST, "--out", str(tmp_path)]) == 0
    assert files(tmp_path) == [
        "demo.csv",
        "demo.parquet",
        "demo.rrd",
        "result.json",
        "swing.png",
        "swing.svg",
    ]


def test_cycles_that_are_shorter_than_a_control_period_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo.main(["--cycles", "1e-9", "--out", str(tmp_path / "demo")]) == 2
    assert (
        capsys.readouterr().err
        == "error: cycles is 1e-09; allowed is 3.82e-05 or more, one control period.\n"
    )
    assert not (tmp_path / "demo").exists()


def test_ctrl_c_ends_a_demo_with_its_comparison_soon(tmp_path: Path) -> None:
    """What would have run without control is simulated alongside, so that nothing is left to
    simulate when Ctrl-C comes.
    """
    words = [
        "-m",
        "experiments.demo",
        "--control",
        "shaped",
        "--engine",
        FAST,
        "--out",
        str(tmp_path),
    ]
    process = subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    while process.poll() is None and not (tmp_path / "demo.rrd").exists():
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert (process.returncode, error) == (0, "")
    run, bare = read(tmp_path / "demo.parquet"), read(tmp_path / "demo_before.parquet")
    assert bare.t[-1] == pytest.approx(run.t[-1], abs=0.51)  # a piece at most
