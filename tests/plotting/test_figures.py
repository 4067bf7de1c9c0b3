"""Figures in files."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from cranedyn.errors import DataError
from cranedyn.plotting.figures import legend_above, panels, save, svg
from tests.helpers import HOSTILE_NAMES, long_after


def _drawn():
    figure, (left, right) = panels(1, 2)
    left.plot([0.0, 1.0], [0.0, 1e5], label="load")
    right.set(xlabel="time [s]", ylabel="a name that takes room")
    return figure


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_a_file_is_the_same_alone_or_with_others_of_its_figure(tmp_path, ending):
    alone = save(_drawn(), tmp_path / f"alone{ending}")
    names = [tmp_path / f"both{other}" for other in (".svg", ".png", ".pdf")]
    assert save(_drawn(), *names) == names[0]
    assert (tmp_path / f"both{ending}").read_bytes() == alone.read_bytes()


@pytest.mark.slow
def test_panels_are_placed_once_for_all_files_and_anew_for_the_next(tmp_path, monkeypatch):
    figure = _drawn()
    placed = []
    engine = figure.get_layout_engine()
    place = engine.execute
    monkeypatch.setattr(engine, "execute", lambda fig: placed.append(fig) or place(fig))
    save(figure, tmp_path / "a.png", tmp_path / "a.svg")
    assert len(placed) == 1
    save(figure, tmp_path / "b.png")
    assert len(placed) == 2
    assert figure.get_layout_engine() is engine


@pytest.mark.slow
def test_a_drawing_keeps_its_words_and_inverts_paper_ink_and_grid_by_night():
    drawing = svg(_drawn()).decode()
    assert all(f">{words}</text>" in drawing for words in ("time [s]", "a name that takes room"))
    night = drawing[drawing.index("prefers-color-scheme: dark") : drawing.index("</style>")]
    assert {"#000000", "#ffffff", "#dddddd"} == {
        ink for ink in re.findall(r": (#\w{6})", drawing.replace(night, "")) if ink in night
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", long_after(4, HOSTILE_NAMES))
def test_a_name_is_drawn_as_it_is_wherever_it_stands(name):
    figure, (left, right) = panels(1, 2)
    left.plot([0.0, 1.0], [0.0, 1.0], label=name)
    left.legend()
    left.text(0.5, 0.5, name)
    left.set(title=name, xlabel=name, ylabel=name, xticks=[0.5], xticklabels=[name])
    right.loglog([1.0, 100.0], [1.0, 100.0])
    texts = ElementTree.fromstring(svg(figure)).iter("{http://www.w3.org/2000/svg}text")
    shown = ["".join(text.itertext()) for text in texts]
    assert shown.count(name) == 6
    assert "100" in {
        "".join(text.split()) for text in shown
    }  # powers of ten are formulas all the same


def test_a_figure_that_matplotlib_saves_itself_shows_names_as_they_are(tmp_path):
    figure, (ax,) = panels()
    ax.set_title(r"$\frac$")
    figure.savefig(tmp_path / "figure.svg")
    assert r"<!-- $\frac$ -->" in (tmp_path / "figure.svg").read_text()


def test_a_long_legend_makes_no_panel_narrow_and_meets_none_beside_it():
    figure, axes = panels(1, 2)
    for ax in axes:
        for number in range(4):
            ax.plot([0.0, 1.0], [0.0, number], label=f"a curve with a long name, {number}")
    left, right = (legend_above(ax).get_window_extent for ax in axes)
    figure.draw_without_rendering()
    for ax in axes:
        assert ax.get_window_extent().width > 0.4 * figure.bbox.width
    assert left().x1 < right().x0
    assert right().x1 < figure.bbox.x1


def test_a_short_legend_is_one_row():
    _, (ax,) = panels()
    for name in ("recorded", "twin", "left"):
        ax.plot([0.0, 1.0], [0.0, 1.0], label=name)
    tops = {text.get_window_extent().y0 for text in legend_above(ax).get_texts()}
    assert len(tops) == 1


def test_a_legend_with_a_name_that_is_no_formula_is_measured_as_it_is_written():
    _, (ax,) = panels()
    ax.plot([0.0, 1.0], [0.0, 1.0], label=r"$\frac$")
    assert legend_above(ax).get_window_extent().width > 0.0


def test_a_pdf_has_truetype_fonts_and_no_date(tmp_path):
    content = save(_drawn(), tmp_path / "figure.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert b"/TrueType" in content or b"/CIDFontType2" in content
    assert b"/Type3" not in content
    assert b"CreationDate" not in content


def test_an_ending_that_no_figure_has_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(DataError, match=r"ending must be \.png or \.svg or \.pdf"):
        save(_drawn(), tmp_path / "figure.docx")
