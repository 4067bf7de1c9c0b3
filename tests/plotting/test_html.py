"""Pages from templates: every name is data."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import jinja2
import pytest

from cranedyn.plotting.figures import panels
from cranedyn.plotting.html import PageFigure, PageTable, render, worst_first
from cranedyn.verdict import Check, Verdict
from tests.helpers import HOSTILE_NAMES

TEMPLATE = """
{% extends "document.html" %}
{% from "parts.html" import check_list, figure, table_sections %}
{% block body %}
{{ check_list(checks) }}{{ table_sections(tables) }}{{ figure(drawing) }}
{% endblock %}
"""


class Page(HTMLParser):
    """The texts, values of attributes, and elements of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.values: list[str | None] = []
        self.elements: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep an element and its values."""
        self.elements.append(tag)
        self.values += [value for _, value in attrs]

    def handle_data(self, data: str) -> None:
        """Keep a text."""
        self.texts.append(data)


def page_of(name: str, folder: Path) -> str:
    template = folder / "page.html"
    template.write_text(TEMPLATE, "utf-8")
    table = PageTable(name, [(name, True), (name, False)], [[name, "1"]], name)
    return render(
        template,
        title=name,
        checks=[Check(name, True)],
        tables=[table, table],
        drawing=PageFigure.of(panels()[0], name),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_name_is_text_wherever_it_stands_and_makes_no_element(name: str, tmp_path: Path) -> None:
    page = Page(page_of(name, tmp_path))
    plain = Page(page_of("a", tmp_path))
    assert page.elements == plain.elements
    # title, heading and check; in each table caption, headers, a cell and the note; and the figure
    assert sum(text.strip() == name for text in page.texts) == 3 + 2 * 5 + 1
    assert page.values.count(name) == 1  # of the image


def test_a_value_that_is_not_given_is_no_empty_place(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("{{ titel }}")
    with pytest.raises(jinja2.UndefinedError, match="titel"):
        render(tmp_path / "page.html", title="a")


def test_the_checks_that_fail_stand_first_and_then_those_that_were_not_judged() -> None:
    checks = [Check("a", True), Check("b", None), Check("c", False), Check("d", True)]
    assert [check.sentence for check in worst_first(checks)] == ["c", "b", "a", "d"]
    assert worst_first(checks)[0].verdict is Verdict.FAILS


def test_a_table_needs_its_longest_words_in_columns_of_text_and_its_longest_cells_in_others() -> (
    None
):
    columns = [("name", True), ("value", False)]
    table = PageTable("t", columns, [["a longest word", "1.0 to 2.0"]])
    assert table.letters == len("longest") + len("1.0 to 2.0") + 2 * 2
