"""Figures in files."""

from __future__ import annotations

import re

import pytest

from cranedyn.plotting.figures import panels, save, svg


def _drawn():
    figure, (left, right) = panels(1, 2)
    left.plot([0.0, 1.0], [0.0, 1e5], label="load")
    right.set(xlabel="time [s]", ylabel="a name that takes room")
    return figure


@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_a_file_is_the_same_alone_or_with_others_of_its_figure(tmp_path, ending):
    alone = save(_drawn(), tmp_path / f"alone{ending}")
    names = [tmp_path / f"both{other}" for other in (".svg", ".png")]
    assert save(_drawn(), *names) == names[0]
    assert (tmp_path / f"both{ending}").read_bytes() == alone.read_bytes()


def test_panels_are_placed_once_for_all_files_and_anew_for_the_next(tmp_path, monkeypatch):
    figure, placed = _drawn(), []
    engine = figure.get_layout_engine()
    place = engine.execute
    monkeypatch.setattr(engine, "execute", lambda fig: placed.append(fig) or place(fig))
    save(figure, tmp_path / "a.png", tmp_path / "a.svg")
    assert len(placed) == 1
    save(figure, tmp_path / "b.png")
    assert len(placed) == 2
    assert figure.get_layout_engine() is engine


def test_a_drawing_keeps_its_words_and_inverts_paper_ink_and_grid_by_night():
    drawing = svg(_drawn()).decode()
    assert all(f">{words}</text>" in drawing for words in ("time [s]", "a name that takes room"))
    night = drawing[drawing.index("prefers-color-scheme: dark") : drawing.index("</style>")]
    assert {"#000000", "#ffffff", "#dddddd"} == {
        ink for ink in re.findall(r": (#\w{6})", drawing.replace(night, "")) if ink in night
    }
