"""Films of runs, read back picture by picture."""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError
from cranedyn.model.load import load_crane
from cranedyn.recording import Run
from cranedyn.recording.film import _Stage, film
from cranedyn.recording.sketch import Extent
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.next_commands import check_next_commands
from tests.portal import portal_crane

reason = "the extra film is not installed: pip install 'cranedyn[film]'"


def rows_of_red(picture: np.ndarray) -> np.ndarray:
    """Return the rows of the pixels of the load, which is red."""
    is_red = (picture[..., 0] > 200) & (picture[..., 1] < 80) & (picture[..., 2] < 80)
    return np.argwhere(is_red)[:, 0]


@pytest.mark.slow
def test_a_film_has_its_size_its_rate_and_thirty_pictures_a_second_in_which_the_load_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    av = pytest.importorskip("av", reason=reason)
    crane = load_crane()
    up = ramp(crane, hold(crane), "l", -3.0, rate=2.0, at=0.0)
    run = simulate(crane, hold_controller(crane), up, duration=1.5)
    file = run.write(tmp_path / "out.parquet")
    target = tmp_path / "out.mp4"
    assert main(["view", str(file), "--film", str(target)]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"Written to {target}.\n")
    check_next_commands(text, monkeypatch)
    with av.open(str(target)) as container:
        (stream,) = container.streams.video
        assert (stream.width, stream.height, stream.average_rate) == (1280, 720, 30)
        pictures = [p.to_ndarray(format="rgb24").astype(int) for p in container.decode(stream)]
    assert len(pictures) == 46  # of 1.5 s, the first and the last included
    first = rows_of_red(pictures[0][:, :660]).mean()
    last = rows_of_red(pictures[-1][:, :660]).mean()
    # Some 17 pixels are a metre, and their rows count downwards.
    assert 20 < first - last < 60
    # The close-up follows the load, which is large in it and hardly moves.
    near = [rows_of_red(pictures[i][:, 660:]) for i in (0, -1)]
    assert len(near[0]) > 3 * len(rows_of_red(pictures[0][:, :660]))
    assert abs(near[0].mean() - near[1].mean()) < 5


def test_the_swings_of_a_crane_whose_joints_have_names_of_their_own_differ_in_a_film(
    tmp_path: Path,
) -> None:
    crane = portal_crane(tmp_path)
    run = simulate(crane, hold_controller(crane), duration=0.02)
    for names in (["one"], ["one", "two"]):
        stage = _Stage([Run(name, crane, run) for name in names], 0.0, 0.02)
        curves = [line for line in stage._swing.lines if not line.get_label().startswith("_")]
        looks = {(line.get_color(), line.get_linestyle()) for line in curves}
        assert len(looks) == len(curves) == 2 * len(names)


def test_a_film_without_its_extra_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(CraneError, match=r"install it with: pip install 'cranedyn\[film\]'$"):
        film(tmp_path / "a.mp4", [])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run.parquet --film a.gif", "the ending must be .mp4"),
        ("a.rrd --film a.mp4", "a film needs a run, .parquet or .csv, which a.rrd is not"),
        ("run.parquet --film a.mp4 --serve", "--serve has no effect beside --film"),
    ],
)
def test_a_film_that_cannot_be_made_is_refused_in_a_line(
    words: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("av", reason=reason)
    try:
        code = main(["view", *words.split()])
    except SystemExit as end:
        code = int(str(end.code))
    assert code == 2
    assert sentence in capsys.readouterr().err


def test_a_film_of_no_run_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("av", reason=reason)
    run = simulate(crane := load_crane(), hold_controller(crane), duration=0.1)
    for runs in ([], [Run("none", crane, run.since(9.0))]):
        with pytest.raises(CraneError, match="rows of each run"):
            film(tmp_path / "a.mp4", runs)
    assert not list(tmp_path.iterdir())


def test_a_close_up_leaves_out_only_what_lies_outside_of_it() -> None:
    """The pictures of a load that swings far are those in which all of the crane is drawn."""
    crane = load_crane()
    start = crane.state(phi=0.3)
    run = Run("one", crane, simulate(crane, hold_controller(crane), start=start, duration=0.1))
    stage = _Stage([run], 0.0, 0.1)
    with patch.object(Extent, "reaches", lambda *_: True):
        whole = stage.picture(1)
        drawn_of_all = len(stage._near_crane.get_paths())
    assert np.array_equal(stage.picture(1), whole)
    # The hook block and the load, of all bodies of the crane.
    assert 0 < len(stage._near_crane.get_paths()) < 0.2 * drawn_of_all


@pytest.mark.parametrize("side", [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])
def test_a_rectangle_reaches_a_square_that_it_touches_and_none_beside_it(
    side: tuple[float, float],
) -> None:
    rectangle = Extent(-1.0, -1.0, 1.0, 1.0)
    assert rectangle.reaches(3.0 * np.array(side), 2.0)
    assert not rectangle.reaches(3.1 * np.array(side), 2.0)
