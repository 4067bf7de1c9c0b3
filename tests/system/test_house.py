"""Imports go down, and the house does not grow: see `tests.house`."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests import house, mutations


@pytest.mark.slow
def test_no_number_of_the_house_exceeds_its_bound() -> None:
    numbers = house.measure()
    assert numbers.keys() == house.LIMITS.keys()
    assert {name: n for name, n in numbers.items() if n > house.LIMITS[name][0]} == {}


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
    names = [*house.named_modules(ast.parse(statement))]
    assert any(name.startswith("cranedyn.recording.show") for name in names)


def test_a_circle_is_found_also_through_a_third_module() -> None:
    edges = {
        ("cranedyn.a", "cranedyn.b"),
        ("cranedyn.b", "cranedyn.c"),
        ("cranedyn.c", "cranedyn.a"),
        ("cranedyn.d", "cranedyn.a"),
    }
    assert house.circles(edges, "cranedyn") == [["cranedyn.a", "cranedyn.b", "cranedyn.c"]]


def test_an_import_of_a_higher_layer_is_found() -> None:
    down = ("cranedyn.recording.show", "cranedyn.model.load")
    up = ("cranedyn.model.load", "cranedyn.recording.show")
    assert house.upward({down, up}) == [up]


def test_names_and_docstrings_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text('def f(given: int) -> None:\n    """The answer."""\n    found = given\n')
    assert house.bindings([path]) == ["found", "given"]
    assert house.first_words([path]) == ["the"]


def test_every_mutation_finds_its_code_and_its_test() -> None:
    for mutation in mutations.read_table(mutations.TABLE):
        mutations.mutated((house.ROOT / mutation.file).read_text("utf-8"), mutation)
        mutations.find_test(mutation.test, house.ROOT)
