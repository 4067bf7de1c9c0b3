"""A sweep keeps what was computed, by the code it began with: damage and edits are noticed."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import cranedyn
from cranedyn.errors import CraneError, DataError
from cranedyn.sweep import Progress, grid, results, sweep
from cranedyn.sweep.folder import (
    CHUNK_FILE,
    MANIFEST,
    DamagedChunk,
    SweepFolder,
    is_whole,
    read_manifest,
)
from cranedyn.sweep.study import Task, source_digests
from experiments import sweep as experiment
from tests import studies
from tests.helpers import files

pytestmark = pytest.mark.usefixtures("limited")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep of six squares in three chunks."""
    folder = tmp_path_factory.mktemp("sweep")
    sweep(studies.squares, grid(x=range(6)), folder, chunk=2, workers=1)
    return folder


@pytest.fixture
def copied(swept: Path, tmp_path: Path) -> Path:
    """A copy, to be spoilt."""
    return Path(shutil.copytree(swept, tmp_path / "sweep"))


def _resume(folder: Path) -> Progress:
    """The progress with which a sweep goes on; it ends with every case."""
    reported: list[Progress] = []
    sweep(studies.squares, grid(x=range(6)), folder, workers=1, progress=reported.append)
    assert results(folder)["y"].to_pylist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    return reported[0]


@pytest.mark.slow
def test_an_interrupted_sweep_does_not_count_damaged_files_as_done(copied: Path) -> None:
    for index in (0, 1):
        file = copied / CHUNK_FILE.format(index)
        file.write_bytes(_flipped(file.read_bytes(), 800))

    def interrupt_after_a_chunk(progress: Progress) -> None:
        if progress.done > progress.before:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="4 of 6 cases are done"):
        sweep(
            studies.squares, grid(x=range(6)), copied, workers=1, progress=interrupt_after_a_chunk
        )


def _flipped(content: bytes, bit: int) -> bytes:
    """The content with one bit changed."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.slow
def test_no_flipped_bit_of_a_part_goes_unnoticed(copied: Path) -> None:
    folder = SweepFolder(copied, read_manifest(copied))
    path = copied / CHUNK_FILE.format(1)
    content = path.read_bytes()
    assert is_whole(content)
    assert not any(is_whole(_flipped(content, bit)) for bit in range(8 * len(content)))
    assert not any(is_whole(content[:length]) for length in range(len(content)))
    path.write_bytes(_flipped(content, 4000))
    with pytest.raises(DamagedChunk):
        folder.open(1)


@pytest.mark.slow
def test_no_flipped_bit_of_a_manifest_changes_results(copied: Path) -> None:
    table = results(copied)
    path = copied / MANIFEST
    content = path.read_bytes()
    refused = 0
    for byte in range(0, len(content), 1 + len(content) // 500):
        path.write_bytes(_flipped(content, 8 * byte + byte % 8))
        try:
            assert results(copied).equals(table)
        except DataError as error:
            assert str(error).startswith((f"Cannot read {path}", f"{path} is damaged"))
            refused += 1
    assert refused > 400  # only blanks may become others


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[]", "null", '{"study": 1}', "[" * 99_999, '{"cases": -1}', '{"cases": 1e400}'],
)
def test_a_manifest_that_is_none_is_refused(text: str, copied: Path) -> None:
    (copied / MANIFEST).write_text(text)
    for act in (lambda: results(copied), lambda: _resume(copied)):
        with pytest.raises(DataError, match=r"_sweep\.json is damaged, .*: put the file back"):
            act()


@pytest.mark.slow
def test_a_damaged_part_is_named_and_computed_again(copied: Path) -> None:
    parts = sorted(copied.glob("part-*"))
    parts[1].write_bytes(_flipped(parts[1].read_bytes(), 4000))
    parts[2].write_bytes(b"")
    before = parts[0].stat().st_mtime_ns
    with pytest.raises(DataError) as caught:
        results(copied)
    assert str(caught.value) == (
        f"The sweep in {copied} is not finished: 2 of 6 cases are there; sweep on, or ask for a "
        "partial table. "
        "Damaged, and computed again as it goes on: part-000001.parquet, part-000002.parquet."
    )
    assert results(copied, partial=True)["case"].to_pylist() == [0, 1]
    assert _resume(copied) == Progress(2, 6, 0, 2)
    assert parts[0].stat().st_mtime_ns == before


@pytest.mark.slow
def test_a_part_that_stands_for_another_counts_as_not_done(copied: Path) -> None:
    shutil.copy(copied / CHUNK_FILE.format(0), copied / CHUNK_FILE.format(1))
    with pytest.raises(DataError, match=r"4 of 6 cases are there; .* goes on: part-000001\."):
        results(copied)
    assert _resume(copied) == Progress(4, 6, 0, 4)


@pytest.mark.slow
def test_a_part_of_another_sweep_is_neither_taken_nor_overwritten(
    copied: Path, tmp_path: Path
) -> None:
    sweep(studies.squares, grid(x=range(6, 12)), tmp_path / "other", chunk=2, workers=1)
    content = (tmp_path / "other" / CHUNK_FILE.format(1)).read_bytes()
    (copied / CHUNK_FILE.format(1)).write_bytes(content)
    for act in (lambda: results(copied), lambda: _resume(copied)):
        with pytest.raises(DataError, match=r"part-000001\.parquet is whole, but of another sweep"):
            act()
    assert (copied / CHUNK_FILE.format(1)).read_bytes() == content


def test_ctrl_c_in_a_destructor_of_arrow_is_not_lost(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = SweepFolder(copied, read_manifest(copied))
    table = folder.read(0)
    monkeypatch.setattr(
        pq.ParquetWriter, "__del__", lambda writer: signal.raise_signal(signal.SIGINT)
    )
    with pytest.raises(KeyboardInterrupt):
        folder.write(0, table)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "folder"])
@pytest.mark.parametrize("name", [CHUNK_FILE.format(1), MANIFEST])
def test_a_pipe_or_a_folder_in_the_place_of_a_file_is_refused_at_once(
    name: str, make: Callable[[Path], None], copied: Path
) -> None:
    (copied / name).unlink()
    make(copied / name)
    for act in (lambda: results(copied), lambda: _resume(copied)):
        with pytest.raises(DataError, match=name.replace(".", r"\.")):
            act()


# --- the code -------------------------------------------------------------------------------------


def test_a_manifest_names_the_code(swept: Path) -> None:
    fields = json.loads((swept / MANIFEST).read_text())
    assert fields["version"] == cranedyn.__version__
    assert fields["sources"] == source_digests("tests.studies:squares")
    expected = {
        "tests/studies.py",
        "cranedyn/sweep/running.py",
        "cranedyn/urdf/tower_crane.urdf.xacro",
    }
    assert expected <= fields["sources"].keys()


def test_a_sweep_by_another_version_is_not_gone_on_with(copied: Path) -> None:
    older = dataclasses.replace(read_manifest(copied), version="0.0.9")
    fields = {**dataclasses.asdict(older), "checksum": older.checksum}
    (copied / MANIFEST).write_text(json.dumps(fields))
    with pytest.raises(DataError, match=rf"version was 0\.0\.9, now {cranedyn.__version__}"):
        _resume(copied)


_STUDY = """
def study(cases):
    return {"y": FACTOR * cases["x"]}
"""


@pytest.mark.slow
def test_a_study_edited_between_two_runs_is_not_mixed_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "2.0"))
    monkeypatch.syspath_prepend(tmp_path)
    import edited  # type: ignore[import-not-found]

    design = grid(x=range(4))
    folder = tmp_path / "sweep"
    sweep(edited.study, design, folder, chunk=1, workers=1)
    (folder / CHUNK_FILE.format(2)).unlink()
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "3.0"))
    with pytest.raises(DataError, match=r"another sweep \(the code changed: edited\.py\); undo"):
        sweep(edited.study, design, folder, workers=1)
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "2.0"))
    assert sweep(edited.study, design, folder, workers=1) == Progress(4, 4, 0, 3)
    assert results(folder)["y"].to_pylist() == [0.0, 2.0, 4.0, 6.0]


def test_a_worker_with_other_sources_computes_nothing() -> None:
    with pytest.raises(CraneError, match=r"A worker has other source files of the study tests\."):
        Task("tests.studies:squares", "0" * 64).evaluate(grid(x=[1.0]).columns)


@pytest.mark.parametrize(
    "options",
    [
        "--durations 1000000000",
        "--points 1.5",
        "--tls-cert cert.pem",
        "--tls-ca-file none.pem --tls-cert none.pem --tls-key none.pem --scheduler tls://a:1",
    ],
)
@pytest.mark.slow
def test_a_refused_command_ends_in_a_message_and_leaves_no_folder(
    options: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["--out", str(tmp_path / "out"), "--points", "2", "--durations", "2", *options.split()]
    try:
        code: object = experiment.main(argv)
    except SystemExit as exit_of_parser:
        code = exit_of_parser.code
    assert code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]
    assert files(tmp_path) == []
