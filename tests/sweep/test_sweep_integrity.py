"""What a sweep keeps is what was computed, by the code it began with: damage, mix-ups and edits are
told, never taken for results.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import shutil
import stat
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import cranedyn
from cranedyn.errors import CraneError, DataError
from cranedyn.sweep import Progress, grid, results, sweep
from cranedyn.sweep.chunk import evaluate
from cranedyn.sweep.manifest import MANIFEST, PART, Manifest, claimed, read_manifest
from cranedyn.sweep.part import Damaged, is_whole, opened
from cranedyn.sweep.sources import sources
from experiments import sweep as experiment
from tests import studies
from tests.helpers import files

pytestmark = pytest.mark.usefixtures("limited")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep of six squares in three parts."""
    folder = tmp_path_factory.mktemp("sweep")
    sweep(studies.squares, grid(x=range(6)), folder, chunk=2, workers=1)
    return folder


@pytest.fixture
def copied(swept: Path, tmp_path: Path) -> Path:
    """The same, to be spoilt."""
    return Path(shutil.copytree(swept, tmp_path / "sweep"))


def _go_on(folder: Path) -> Progress:
    said: list[Progress] = []
    sweep(studies.squares, grid(x=range(6)), folder, workers=1, progress=said.append)
    assert results(folder)["y"].to_pylist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    return said[0]


def _flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


# --- parts ----------------------------------------------------------------------------------------


def test_no_flipped_bit_of_a_part_goes_unnoticed(copied: Path) -> None:
    manifest, path = read_manifest(copied), copied / PART.format(1)
    content = path.read_bytes()
    assert is_whole(io.BytesIO(content))
    for bit in range(8 * len(content)):
        assert not is_whole(io.BytesIO(_flipped(content, bit)))
    for byte in range(0, len(content), 10):
        path.write_bytes(_flipped(content, 8 * byte + byte // 10 % 8))
        with pytest.raises(Damaged), opened(copied, manifest, 1):
            pass


def test_no_flipped_bit_of_a_manifest_changes_results(copied: Path) -> None:
    whole, path = results(copied), copied / MANIFEST
    content = path.read_bytes()
    refused = 0
    for byte in range(0, len(content), 1 + len(content) // 500):
        path.write_bytes(_flipped(content, 8 * byte + byte % 8))
        try:
            assert results(copied).equals(whole)
        except DataError as error:
            assert str(error).startswith((f"Cannot read {path}", f"{path} is damaged"))
            refused += 1
    assert refused > 400  # only blanks may become others


def test_a_damaged_part_is_named_and_computed_again(copied: Path) -> None:
    (copied / PART.format(1)).write_bytes(_flipped((copied / PART.format(1)).read_bytes(), 4000))
    (copied / PART.format(2)).write_bytes(b"")
    with pytest.raises(DataError) as caught:
        results(copied)
    assert str(caught.value) == (
        f"The sweep in {copied} is not finished: 2 of 6 cases are there; sweep on, or ask for a "
        "partial table. "
        "Damaged, and computed again as it goes on: part-000001.parquet, part-000002.parquet."
    )
    assert results(copied, partial=True)["case"].to_pylist() == [0, 1]
    assert _go_on(copied) == Progress(2, 6, 0, 2)


def test_a_part_that_stands_for_another_counts_as_not_done(copied: Path) -> None:
    shutil.copy(copied / PART.format(0), copied / PART.format(1))
    with pytest.raises(
        DataError, match=r"4 of 6 cases are there; .* as it goes on: part-000001\.parquet\."
    ):
        results(copied)
    assert _go_on(copied) == Progress(4, 6, 0, 4)


def test_a_part_of_another_sweep_is_neither_taken_nor_overwritten(
    copied: Path, tmp_path: Path
) -> None:
    sweep(studies.squares, grid(x=range(6, 12)), tmp_path / "other", chunk=2, workers=1)
    stranger = (tmp_path / "other" / PART.format(1)).read_bytes()
    (copied / PART.format(1)).write_bytes(stranger)
    for act in (lambda: results(copied), lambda: _go_on(copied)):
        with pytest.raises(
            DataError,
            match=r"part-000001\.parquet is whole, but of another sweep; move it away, and its "
            r"cases are computed\.",
        ):
            act()
    assert (copied / PART.format(1)).read_bytes() == stranger


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "folder"])
@pytest.mark.parametrize("name", [PART.format(1), ".lock", MANIFEST])
def test_what_is_no_file_is_told_at_once(
    name: str, make: Callable[[Path], None], copied: Path
) -> None:
    (copied / name).unlink()
    make(copied / name)
    began = time.monotonic()
    with pytest.raises(
        DataError, match=name.replace(".", r"\.") if name != ".lock" else "Cannot sweep in "
    ):
        _go_on(copied)
    if name != ".lock":
        with pytest.raises(DataError, match=name.replace(".", r"\.")):
            results(copied)
    assert time.monotonic() - began < 1.0


def test_a_part_that_cannot_be_read_is_not_taken_for_a_bad_one(
    copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    content = (copied / PART.format(0)).read_bytes()
    monkeypatch.setattr("cranedyn.sweep.part._without_waiting", refused)
    with pytest.raises(DataError, match=r"Cannot read .*part-000000\.parquet: Permission denied\."):
        _go_on(copied)
    assert (copied / PART.format(0)).read_bytes() == content


def test_files_are_on_the_disk_before_their_names_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    fsync, replace = os.fsync, os.replace

    def synced(file: int) -> None:
        said.append("file" if stat.S_ISREG(os.fstat(file).st_mode) else "folder")
        fsync(file)

    def replaced(draft: Path, final: Path) -> None:
        said.append(final.name)
        replace(draft, final)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    sweep(studies.squares, grid(x=[1.0]), tmp_path, workers=1)
    for name in (MANIFEST, PART.format(0)):
        place = said.index(name)
        assert said[place - 1] == "file" and "folder" in said[place + 1 : place + 3]


# --- the manifest ---------------------------------------------------------------------------------


def test_a_manifest_names_the_code(swept: Path) -> None:
    found = json.loads((swept / MANIFEST).read_text())
    assert found["version"] == cranedyn.__version__
    assert found["sources"] == sources("tests.studies:squares")
    assert {
        "tests/studies.py",
        "cranedyn/sweep/run.py",
        "cranedyn/urdf/tower_crane.urdf.xacro",
    } <= found["sources"].keys()


@pytest.mark.parametrize("cases", [10**30, 10**400, 2**53, -1, True, 1e3, "6", None])
@pytest.mark.parametrize("sealed", [False, True])
def test_a_manifest_of_any_number_of_cases_ends_in_a_sentence_at_once(
    cases: object, sealed: bool, copied: Path
) -> None:
    forged = dataclasses.replace(read_manifest(copied), cases=cases)  # type: ignore[arg-type]
    found = json.loads((copied / MANIFEST).read_text()) | {"cases": cases}
    (copied / MANIFEST).write_text(
        json.dumps(found | {"checksum": forged.checksum} if sealed else found)
    )
    began = time.monotonic()
    for act in (
        lambda: results(copied),
        lambda: results(copied, partial=True),
        lambda: _go_on(copied),
    ):
        with pytest.raises(DataError):
            act()
    assert time.monotonic() - began < 1.0


def test_a_sweep_by_another_version_is_not_gone_on_with(copied: Path) -> None:
    manifest = read_manifest(copied)
    older = dataclasses.replace(manifest, version="0.0.9")
    (copied / MANIFEST).write_text(
        json.dumps({**dataclasses.asdict(older), "checksum": older.checksum})
    )
    with pytest.raises(
        DataError,
        match=r"what is there was computed by cranedyn 0\.0\.9, "
        rf"this is {cranedyn.__version__}; go on with that, or sweep into",
    ):
        _go_on(copied)


_STUDY = """
def study(cases):
    return {"y": FACTOR * cases["x"]}
"""


def test_a_study_edited_between_two_runs_is_not_mixed_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "2.0"))
    monkeypatch.syspath_prepend(tmp_path)
    import edited  # type: ignore[import-not-found]

    design, folder = grid(x=range(4)), tmp_path / "sweep"
    sweep(edited.study, design, folder, chunk=1, workers=1)
    (folder / PART.format(2)).unlink()
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "3.0"))
    with pytest.raises(DataError) as caught:
        sweep(edited.study, design, folder, workers=1)
    assert str(caught.value) == (
        f"Cannot sweep on in {folder}: what is there was computed by other code: edited.py changed "
        "since; "
        "put that back as it was, or sweep into another folder."
    )
    (tmp_path / "edited.py").write_text(_STUDY.replace("FACTOR", "2.0"))
    assert sweep(edited.study, design, folder, workers=1) == Progress(4, 4, 0, 3)
    assert results(folder)["y"].to_pylist() == [0.0, 2.0, 4.0, 6.0]


def test_a_worker_with_other_sources_computes_nothing() -> None:
    with pytest.raises(
        CraneError,
        match=r"A worker has other source files of the study tests\.studies:squares, or of "
        r"cranedyn",
    ):
        evaluate("tests.studies:squares", grid(x=[1.0]).columns, "0" * 64)


# --- refusals -------------------------------------------------------------------------------------


def test_a_refused_sweep_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "a" / "b", tmp_path / "there"):
        with pytest.raises(CraneError, match=r"No Dask scheduler answers|needs Dask"):
            monkeypatch.setattr("cranedyn.sweep.cluster.CONNECTING", 0.1)
            sweep(studies.squares, grid(x=range(4)), folder, scheduler="tcp://127.0.0.1:1")
        with (
            monkeypatch.context() as patch,
            pytest.raises(CraneError, match="cannot import the study"),
        ):
            patch.setattr(studies.squares, "__module__", "tests.elsewhere")
            sweep(studies.squares, grid(x=range(4)), folder, workers=1)
    assert files(tmp_path) == ["there"]


def test_a_lock_that_a_refused_sweep_has_removed_locks_nothing(tmp_path: Path) -> None:
    one = Manifest("a:b", cranedyn.__version__, {}, "0", ("x",), 10, 1)
    with claimed(tmp_path, one, True):
        (tmp_path / ".lock").unlink()
        with claimed(tmp_path, one, True):  # by its name there is another now
            pass


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"study": None}, "A study must be a function"),
        ({"study": 5}, "A study must be a function"),
        (
            {"design": {"x": [1.0]}},
            "allowed is a Design, of which grid, sampled and cross make some.",
        ),
        ({"design": None}, "design is None; allowed is a Design"),
        ({"folder": 5}, "The folder of a sweep is 5; allowed is a path."),
        ({"folder": ""}, "The folder of a sweep is ''; allowed is a path."),
        ({"folder": "a\0b"}, "The folder of a sweep is .*; allowed is a path."),
        ({"folder": b"a"}, "The folder of a sweep is b'a'; allowed is a path."),
        (
            {"folder": "/proc/none/a"},
            "Cannot make the folder /proc/none/a: No such file or directory.",
        ),
        ({"folder": "a" * 300}, "Cannot .* a+.*: File name too long."),
        ({"chunk": "a"}, "chunk is a; allowed is a number."),
        ({"chunk": 10**400}, "chunk is "),
        ({"chunk": float("nan")}, "chunk is nan; allowed is a finite number."),
        (
            {"workers": 10**9},
            "number of workers is 1000000000; allowed is a whole number from 1 to 1024.",
        ),
        ({"workers": None, "limit": -1.0}, r"limit is -1\.0 s; allowed is 0\.001 to 1e\+06\."),
        ({"limit": "soon"}, "limit is soon s; allowed is a number."),
        ({"limit": float("nan")}, "limit is nan s; allowed is a finite number."),
    ],
)
def test_odd_arguments_are_said_in_a_sentence(
    change: dict, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = {
        "study": studies.squares,
        "design": grid(x=range(2)),
        "folder": tmp_path / "a",
        "workers": 1,
        **change,
    }
    with pytest.raises(CraneError, match=says):
        sweep(given.pop("study"), given.pop("design"), given.pop("folder"), **given)
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    "words",
    [
        "--durations 99999999999999",
        "--durations 1000000000",
        "--points 0",
        "--points 1.5",
        f"--points {'9' * 5000}",
        f"--scheduler tcp://{'a' * 300}:1",
        "--scheduler 5",
        "--workers 5000",
        "--limit nan",
        "--limit 0",
        "--tls-cert cert.pem",
        "--tls-ca-file none.pem --tls-cert none.pem --tls-key none.pem --scheduler "
        "tls://127.0.0.1:1",
    ],
    ids=lambda words: words[:30],
)
def test_a_refused_command_ends_in_a_sentence_and_leaves_no_folder(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--out", str(tmp_path / "out"), "--points", "2", "--durations", "2", *words.split()]
    try:
        code: object = experiment.main(given)
    except SystemExit as left:
        code = left.code
    assert code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]
    assert files(tmp_path) == []


@pytest.mark.parametrize("folder", [5, "", "a\0b", None, "/proc/none"])
def test_odd_folders_have_no_results(folder: object) -> None:
    with pytest.raises(DataError):
        results(folder)  # type: ignore[arg-type]
