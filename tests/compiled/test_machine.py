"""Machine code, translated once and kept for later processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from llvmlite import ir

from cranedyn.compiled import machine
from cranedyn.data import kept_files

WEB = "wasm32-unknown-unknown"


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
    """An empty folder in which files are kept instead of that of this run."""
    folder = tmp_path / "kept"
    monkeypatch.setenv(kept_files.VARIABLE, str(folder))
    return folder


def files(folder: Path) -> list[Path]:
    """The files that are kept in a folder."""
    return [path for path in folder.iterdir() if path.name != "tidied"]


def test_a_module_that_was_translated_is_not_translated_again_and_computes_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = machine.translate(scaling(3.0))
    assert len(files(folder)) == 1
    monkeypatch.setattr(machine, "_native_object", None)
    second = machine.translate(scaling(3.0))
    assert scaled(first, 5.0) == 15.0
    assert scaled(second, 5.0) == 15.0


def test_another_number_and_another_way_to_optimise_are_other_files(folder: Path) -> None:
    assert scaled(machine.translate(scaling(3.0)), 5.0) == 15.0
    assert scaled(machine.translate(scaling(7.0)), 5.0) == 35.0
    assert scaled(machine.translate(scaling(7.0), inlining=True), 5.0) == 35.0
    assert len(files(folder)) == 3


def test_another_processor_has_code_of_its_own(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.translate(scaling(3.0))
    here = machine._translator()
    for i, part in enumerate(here):
        other = (*here[:i], f"{part},-avx", *here[i + 1 :])
        monkeypatch.setattr(machine, "_translator", lambda other=other: other)
        machine.translate(scaling(3.0))
    assert len(files(folder)) == 1 + len(here)


def test_code_that_was_damaged_is_translated_again(folder: Path) -> None:
    machine.translate(scaling(3.0))
    (file,) = files(folder)
    whole = file.read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 1
    for content in (b"", whole[:20], whole[:-1], bytes(damaged)):
        file.write_bytes(content)
        assert scaled(machine.translate(scaling(3.0)), 5.0) == 15.0
        assert file.read_bytes() == whole


def test_without_a_folder_code_is_translated_each_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(kept_files.VARIABLE, kept_files.OFF)
    for _ in range(2):
        assert scaled(machine.translate(scaling(3.0)), 5.0) == 15.0
    assert not folder.exists()


def test_code_for_another_platform_is_made_once_for_each(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = machine.object_code(scaling(3.0), WEB)
    machine.object_code(scaling(3.0), WEB, "+simd128")
    machine.object_code(scaling(3.0), "aarch64-unknown-linux-gnu")
    assert len(files(folder)) == 3
    monkeypatch.setattr(machine, "_cross", None)
    assert machine.object_code(scaling(3.0), WEB) == plain
