"""Imports go down, without circles: see `tests.house`."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import pytest

from tests import house, mutations


@pytest.mark.slow
def test_imports_go_down_without_circles_and_no_public_name_is_ambiguous() -> None:
    assert house.problems() == []


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


def test_a_public_name_of_two_modules_is_found(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.py").write_text("def move() -> None: ...\ndef _own() -> None: ...\n")
    assert house.ambiguous(sorted(tmp_path.iterdir())) == ["move"]


@pytest.mark.slow
def test_every_mutation_finds_its_code_and_its_test() -> None:
    for mutation in mutations.read_mutations():
        mutations.mutated((house.ROOT / mutation.file).read_text("utf-8"), mutation)
        mutations.check_test_exists(mutation, house.ROOT)


@pytest.mark.parametrize("text", ["", "a = 1\n", "b = a\nc = a\nb = a\n"])
def test_a_mutation_whose_code_is_not_there_exactly_once_is_refused(text: str) -> None:
    mutation = mutations.Mutation("module.py", "tests/test.py::test_b", "B is 0.", "b = a", "b = 0")
    with pytest.raises(SystemExit, match=r"module\.py must hold the code 'b = a' exactly once"):
        mutations.mutated(text, mutation)


def test_a_mutation_whose_test_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "test.py").write_text("\ndef test_b(): ...\n")
    there = mutations.Mutation("module.py", "test.py::test_b[1]", "B is 0.", "b = a", "b = 0")
    mutations.check_test_exists(there, tmp_path)
    renamed = dataclasses.replace(there, test="test.py::test_c")
    with pytest.raises(SystemExit, match=r"test\.py does not define the test test_c"):
        mutations.check_test_exists(renamed, tmp_path)
