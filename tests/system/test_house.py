"""Imports go down, and the house does not grow: see `tests.house`."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests import house
from tests.house import Import


@pytest.fixture(scope="module")
def edges() -> set[Import]:
    return house.imports()


def test_no_modules_of_cranedyn_import_each_other_in_a_circle(edges: set[Import]) -> None:
    assert house.circles(edges, "cranedyn") == []


def test_no_number_of_the_house_exceeds_its_bound() -> None:
    numbers = house.measure()
    assert numbers.keys() == house.GOALS.keys() == house.BOUNDS.keys()
    assert {name: n for name, n in numbers.items() if n > house.BOUNDS[name]} == {}


@pytest.mark.parametrize(
    "statement",
    [
        "import cranedyn.recording.show",
        "from cranedyn.recording import show",
        "def f():\n    from cranedyn.recording.show import view",
        "if TYPE_CHECKING:\n    from cranedyn.recording.show import view",
        "home = 'cranedyn.recording.show'",
        "home = 'cranedyn.recording.show:view'",
    ],
)
def test_an_import_counts_wherever_it_stands(statement: str) -> None:
    names = {house._module(name) for name in house._imported(ast.parse(statement))}
    assert "cranedyn.recording.show" in names


def test_a_circle_is_found_also_through_a_third_module() -> None:
    edges = {
        Import("cranedyn.a", "cranedyn.b"),
        Import("cranedyn.b", "cranedyn.c"),
        Import("cranedyn.c", "cranedyn.a"),
        Import("cranedyn.d", "cranedyn.a"),
    }
    assert house.circles(edges, "cranedyn") == [["cranedyn.a", "cranedyn.b", "cranedyn.c"]]


def test_an_import_of_a_higher_layer_is_found() -> None:
    down = Import("cranedyn.recording.show", "cranedyn.model.load")
    up = Import("cranedyn.model.load", "cranedyn.recording.show")
    assert house.upward({down, up}) == [up]


def test_lines_without_content_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text('def f(given: int) -> None:\n    """The answer."""\n    found = given\n')
    assert house.bindings([path]) == ["found", "given"]
    assert house.first_words([path]) == ["the"]
