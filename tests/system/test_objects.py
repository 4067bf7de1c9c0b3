"""What the processes of a test run share, see `tests.objects`."""

from __future__ import annotations

import inspect
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from llvmlite import ir

from cranedyn.compiled import machine
from cranedyn.model import description
from cranedyn.model.description import XACRO
from tests import objects


def scaling(factor: float) -> ir.Module:
    """A module with a function that multiplies the number at an address."""
    module = ir.Module()
    number = ir.DoubleType()
    function = ir.Function(
        module, ir.FunctionType(ir.VoidType(), [number.as_pointer()]), name="scale"
    )
    builder = ir.IRBuilder(function.append_basic_block())
    product = builder.fmul(builder.load(function.args[0]), number(factor))
    builder.store(product, function.args[0])
    builder.ret_void()
    return module


def scaled(translated: machine.Machine, value: float) -> float:
    """What the function of such a module makes of a number."""
    numbers = np.array([value])
    translated.function("scale", 1)(numbers.ctypes.data)
    return float(numbers[0])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is shared instead of that of this run."""
    # The functions without the folder of this run, which are put back at the end.
    monkeypatch.setattr(machine, "translate", inspect.unwrap(machine.translate))
    monkeypatch.setattr(machine, "object_code", inspect.unwrap(machine.object_code))
    monkeypatch.setattr(description, "_expand", inspect.unwrap(description._expand))
    objects.share(tmp_path)
    return tmp_path


def test_a_module_that_was_translated_is_taken_from_its_file_and_computes_the_same(
    folder: Path,
) -> None:
    first = machine.translate(scaling(3.0))
    (file,) = folder.iterdir()
    written = file.stat()
    second = machine.translate(scaling(3.0))
    assert scaled(first, 5.0) == 15.0
    assert scaled(second, 5.0) == 15.0
    assert [*folder.iterdir()] == [file]
    # It was not written again, which would be another file of this name.
    assert file.stat().st_ino == written.st_ino


def test_a_module_with_another_number_is_another_file(folder: Path) -> None:
    assert scaled(machine.translate(scaling(3.0)), 5.0) == 15.0
    assert scaled(machine.translate(scaling(7.0)), 5.0) == 35.0
    assert len([*folder.iterdir()]) == 2


def test_code_for_another_platform_is_made_once_for_each(folder: Path) -> None:
    web = "wasm32-unknown-unknown"
    plain = machine.object_code(scaling(3.0), web)
    assert machine.object_code(scaling(3.0), web) == plain
    assert len([*folder.iterdir()]) == 1
    machine.object_code(scaling(3.0), web, "+simd128")
    machine.object_code(scaling(3.0), "aarch64-unknown-linux-gnu")
    assert len([*folder.iterdir()]) == 3


def test_what_was_made_once_is_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(objects.FOLDER, str(tmp_path))
    made: list[Path] = []

    def make(file: Path) -> None:
        made.append(file)
        file.write_text("content")

    file = objects.made_once("name", make)
    assert objects.made_once("name", make) == file
    assert file.read_text() == "content"
    assert len(made) == 1
    assert os.path.dirname(file) == str(tmp_path)


def test_a_description_that_was_expanded_is_taken_from_its_file_and_reads_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = (("visuals", "false"), ("payload_mass", "1234.0"))
    first = description._expand(str(XACRO), values)
    assert first == inspect.unwrap(description._expand)(str(XACRO), values)
    (file,) = folder.iterdir()
    monkeypatch.setattr("xacro.process_file", None)
    assert description._expand(str(XACRO), values) == first
    assert [*folder.iterdir()] == [file]


def test_other_values_and_other_sources_are_another_description(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = (("visuals", "false"),)
    usual = description._expand(str(XACRO), values)
    assert description._expand(str(XACRO), (*values, ("payload_mass", "1234.0"))) != usual
    own = tmp_path_factory.mktemp("own") / XACRO.name
    for source in XACRO.parent.glob("*.xacro"):
        shutil.copy(source, own.parent)
    text = own.read_text("utf-8")
    assert text.count('name="payload_mass" default="1000.0"') == 1
    changed = text.replace('"payload_mass" default="1000.0"', '"payload_mass" default="999.0"')
    own.write_text(changed, "utf-8")
    monkeypatch.setattr(description, "XACRO", own)
    assert '<mass value="999.0"/>' in description._expand(str(own), values)
    assert len([*folder.iterdir()]) == 3


def test_a_description_of_somebody_else_is_expanded_each_time(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("theirs") / "r.xacro"
    path.write_text("<robot name='r'/>", "utf-8")
    description._expand(str(path), ())
    assert [*folder.iterdir()] == []


def test_what_no_run_has_used_for_long_is_forgotten(folder: Path) -> None:
    values = (("visuals", "false"),)
    description._expand(str(XACRO), values)
    machine.translate(scaling(3.0))
    kept = {*folder.iterdir()}
    unused = folder / "unused"
    unused.touch()
    long_ago = time.time() - 86400.0 * (objects.UNUSED_DAYS + 1.0)
    for file in folder.iterdir():
        os.utime(file, (long_ago, long_ago))
    description._expand(str(XACRO), values)
    machine.translate(scaling(3.0))
    objects.forget_unused(folder)
    assert {*folder.iterdir()} == kept


def test_a_folder_to_which_others_may_write_is_not_private(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    assert objects.is_private(tmp_path)
    tmp_path.chmod(0o777)
    assert not objects.is_private(tmp_path)
