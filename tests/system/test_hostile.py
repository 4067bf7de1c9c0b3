"""What strangers bring and machines do: every input ends in a result or in one sentence, and no
file is lost or half there.
"""

from __future__ import annotations

import errno
import io
import itertools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from PIL import Image

from cranedyn.analysis.prediction import free_swing
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import read, read_columns
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.model.urdf import parse_urdf, skeleton
from cranedyn.recording import snapshot as pictures
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import grid, sweep
from experiments import energy, harness, mass_ratio, report
from experiments import snapshot as snapshots
from tests.helpers import RESULT, crane, files, python, turned
from tests.studies import squares


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe()


# --- descriptions ---------------------------------------------------------------------------------

_LAUGH = "".join(f"<!ENTITY l{i + 1} '{10 * f'&l{i};'}'>" for i in range(12))


def _chain(n: int, last: str) -> str:
    """Links on fixed joints, one below the other, the last of them above a given link."""
    links = "".join(f'<link name="k{i}"/>' for i in range(n))
    ends = ["hook_link", *(f"k{i}" for i in range(n)), *([last] if last else [])]
    joints = (
        f'<joint name="j{i}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for i, (a, b) in enumerate(itertools.pairwise(ends))
    )
    return f"{links}{''.join(joints)}</robot>"


HOSTILE: list[Callable[[str], str | bytes]] = [
    # a billion laughs, and a long entity many times
    lambda u: f'<!DOCTYPE r [<!ENTITY l0 "ha">{_LAUGH}]><robot name="&l12;"/>',
    lambda u: f"<!DOCTYPE r [<!ENTITY a '{'a' * 100_000}'>]><robot>{'&a;' * 20_000}</robot>",
    # what a file and what the net hold
    lambda u: '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="x">&a;</robot>',
    lambda u: u.replace("?>", '?><!DOCTYPE r SYSTEM "http://127.0.0.1:9/r.dtd">'),
    # deep nesting, joints in a circle, a chain that would overflow the stack
    lambda u: "<a>" * 100_000 + "</a>" * 100_000,
    lambda u: u.replace("</robot>", _chain(2, "k0")),
    lambda u: u.replace("</robot>", _chain(0, "base_link")),
    lambda u: u.replace("</robot>", _chain(20_000, "")),
    # much of one thing
    lambda u: u.replace('value="500.0"', f"value='{'1' * 4_000_000}x'"),
    lambda u: u.replace("<mass value", "<mass " + "".join(f"a{i}='' " for i in range(10_000)), 1),
    lambda u: u + " " * 6_000_000,
    # other files
    lambda u: b"\x1f\x8b\x08\x00" + bytes(range(256)),
    lambda u: u.encode("utf-16"),
    lambda u: "",
]

_LOADER = """
import json, resource, sys
from pathlib import Path
from cranedyn.model.load import load_crane
from cranedyn.errors import CraneError

taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + 400_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (30, 30))
for path in sys.argv[1:]:
    try:
        load_crane(path)
    except CraneError as error:
        print(json.dumps(str(error)))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited by means of Linux")
def test_hostile_descriptions_are_refused_within_30_seconds_and_400_megabytes(
    urdf: str, tmp_path: Path
) -> None:
    paths = []
    for i, make in enumerate(HOSTILE):
        content = make(urdf)
        # An expanded crane takes its time.
        for ending in ("urdf",) if "joint" in str(content) else ("urdf", "xacro"):
            paths.append(tmp_path / f"{i}.{ending}")
            paths[-1].write_bytes(content.encode() if isinstance(content, str) else content)
    run = python(_LOADER, *paths)
    assert run.returncode == 0, run.stderr
    sentences = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(sentences) == len(paths)
    for sentence in sentences:
        assert sentence.endswith(".")
        assert sentence.isprintable()
        assert len(sentence) < 2100


_WATCHED = """
import sys
from cranedyn.controllers import hold_controller
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.simulation.simulate import simulate

seen = []
watched = ("open", "socket.connect", "socket.getaddrinfo")
sys.addaudithook(lambda event, given: seen.append((event, given)) if event in watched else None)
crane = load_crane(sys.argv[1])
print([str(given[0]) for event, given in seen if not str(given[0]).endswith(".pyc")])
run = simulate(crane, hold_controller(crane), duration=0.05)
record(sys.argv[2], [Run("r", crane, run)], title="t")
print([given for event, given in seen if event != "open"])
"""


@pytest.mark.slow
def test_nothing_that_a_description_names_is_opened_or_fetched(urdf: str, tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
    names = "http://127.0.0.1:9/a.stl package://else/b.stl /etc/passwd file:///etc/shadow ../b.dae"
    meshes = "".join(map(mesh.format, names.split()))
    path = tmp_path / "crane.urdf"
    path.write_text(turned('<link name="hook_link">', f'<link name="hook_link">{meshes}', urdf))
    run = python(_WATCHED, path, tmp_path / "a.rrd")
    opened, fetched = run.stdout.splitlines()
    assert opened == str([str(path)])
    assert fetched == "[]"
    handed_on = skeleton(parse_urdf(path.read_text(), path))  # to parsers that no audit hook sees
    assert "mesh" not in handed_on
    assert "b.dae" not in handed_on
    assert load_crane(path).payload_mass == 1000.0


@pytest.mark.slow
def test_a_plain_urdf_is_never_expanded(urdf: str, tmp_path: Path) -> None:
    path = tmp_path / "crane.urdf"
    (tmp_path / "secret.yaml").write_text("a: 1")
    note = f"""name="hook_link" note="${{xacro.load_yaml('{tmp_path / "secret.yaml"}')}}">"""
    include = '<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro" filename="secret.yaml"/>'
    for text in (
        turned('name="hook_link">', note, urdf),
        turned("</robot>", f"{include}</robot>", urdf),
        urdf.replace("1000.0", "$(arg mass)"),
    ):
        path.write_text(text)
        with pytest.raises(ModelError, match="holds xacro directives; if you trust the file name"):
            load_crane(path)


@pytest.mark.parametrize(
    "body",
    [
        '<xacro:include filename="a.xacro"/>',
        '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
        "<link name=\"${__import__('os').getcwd()}\"/>",
        '<link name="${().__class__}"/>',
        '<link name="${[0] * 10**15}"/>',
        '<xacro:include filename="/etc/passwd"/>',
        "<xacro:if value='${1/0}'/>",
    ],
)
def test_a_xacro_that_cannot_be_expanded_is_one_sentence(body: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xacro"
    path.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{body}</robot>')
    with pytest.raises(ModelError, match=r"a\.xacro cannot be expanded: .*\.$") as caught:
        load_crane(path)
    assert str(caught.value).isprintable()


def test_a_rod_whose_inertia_is_singular_is_a_load(urdf: str, tmp_path: Path) -> None:
    # turned, so that rounding makes its zero eigenvalue a little negative or positive
    turn = (
        '<inertial>\n      <origin xyz="0 0 -0.0" rpy="0.3 0.4 0.5"/>\n      <mass value="1000.0"/>'
    )
    text = turned(turn.replace(' rpy="0.3 0.4 0.5"', ""), turn, urdf)
    (tmp_path / "crane.urdf").write_text(turned('izz="400.0"', 'izz="0.0"', text))
    assert load_crane(tmp_path / "crane.urdf").payload_mass == 1000.0


# --- tables ---------------------------------------------------------------------------------------

ALL = [column for columns in crane().layout.columns().values() for column in columns]


def _table(rows: int = 3, **replaced: pa.Array) -> pa.Table:
    columns = {
        name: pa.array(np.arange(rows, dtype=float) / 8 if name == "t_s" else np.ones(rows))
        for name in ALL
    }
    return pa.table(columns | replaced)


NO_NUMBER = "something that is not a number"
ODD_COLUMNS: list[tuple[pa.Array, str]] = [
    (pa.array(["1", "2", "3"]), NO_NUMBER),
    (pa.array([1, 2, 3], pa.timestamp("ms")), NO_NUMBER),
    (pa.array([True, False, True]), NO_NUMBER),
    (pa.array([[1.0], [2.0], [3.0]]), NO_NUMBER),
    (pa.array([{"a": 1.0}] * 3), NO_NUMBER),
    (pa.nulls(3), NO_NUMBER),
    (pa.array([1.0, None, 3.0]), "a value that is not finite, in data row 2"),
    (pa.array([1.0, 2.0, np.inf]), "a value that is not finite, in data row 3"),
]


@pytest.mark.parametrize(("column", "sentence"), ODD_COLUMNS)
def test_a_column_that_is_no_column_of_numbers_is_refused(
    column: pa.Array, sentence: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(_table(phi_rad=column), path)
    for reader in (read, lambda p: read_columns(p, ("t_s", "phi_rad"))):
        with pytest.raises(DataError, match=f"column phi_rad holds {sentence}"):
            reader(path)


def test_whole_and_decimal_numbers_are_numbers(tmp_path: Path) -> None:
    kinds = (pa.int8(), pa.uint64(), pa.float16(), pa.float32(), pa.decimal128(9, 2))
    for kind in kinds:
        values = pa.array([1.0, 2.0, 3.0]).cast(kind)
        pyarrow.parquet.write_table(_table(phi_rad=values), tmp_path / "a.parquet")
        assert read(tmp_path / "a.parquet")["phi_rad"].tolist() == [1.0, 2.0, 3.0]


WRITERS = {".csv": pyarrow.csv.write_csv, ".parquet": pyarrow.parquet.write_table}


@pytest.mark.parametrize("ending", WRITERS)
def test_a_column_that_is_there_twice_is_refused(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    WRITERS[ending](pa.Table.from_arrays([pa.array([0.0, 1.0])] * 2, names=["t_s", "t_s"]), path)
    with pytest.raises(DataError, match="has 2 columns t_s; needed is one"):
        read_columns(path, ("t_s",))


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("t", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [-1e308, 1e308, 0.0], []], ids=str)
def test_a_trajectory_whose_time_does_not_increase_is_refused(
    t: list[float], ending: str, tmp_path: Path
) -> None:
    WRITERS[ending](_table(len(t), t_s=pa.array(t, pa.float64())), tmp_path / f"a{ending}")
    words = "t_s must increase from row to row; in data row 3" if t else "has too few rows, 0"
    with pytest.raises(DataError, match=words):
        read(tmp_path / f"a{ending}")


@pytest.mark.parametrize("text", ["{", "[]", '{"a": [1]}', '{"a": null}', "[" * 100_000, "\udcff"])
def test_parameters_that_are_none_are_refused(text: str, tmp_path: Path) -> None:
    table = _table().replace_schema_metadata({"cranedyn": text.encode(errors="surrogateescape")})
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(DataError, match="parameters are not a JSON object of numbers and words"):
        read(tmp_path / "a.parquet")


@pytest.mark.slow
@pytest.mark.parametrize("ending", WRITERS)
def test_a_file_that_would_not_fit_is_refused_before_it_is_read(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Parquet file of equal numbers is small: what counts is how many there are."""
    path = tmp_path / f"a{ending}"
    rows = 200_000
    WRITERS[ending](_table(rows), path)
    assert ending == ".csv" or path.stat().st_size < 0.1 * rows * 8 * len(ALL)
    monkeypatch.setattr("cranedyn.data.tables.LARGEST", 1e6)
    monkeypatch.setattr(
        pyarrow.parquet.ParquetFile, "read", lambda *_, **__: pytest.fail("must not be read")
    )
    with pytest.raises(DataError, match=r"a\.\w+ holds \d+ MB to read; allowed are 1\."):
        read(path)


# --- numbers that make no experiment --------------------------------------------------------------


def test_a_load_that_does_not_swing_through_has_no_period() -> None:
    light = load_crane(payload_mass=1e-12, damp_swing=0)
    start = light.state(phi=0.1)
    run = simulate(
        light, lambda t, state, setpoint: np.zeros(3), start=start, duration=1.0, drive="motion"
    )
    with pytest.raises(
        DataError, match="The load swings through 0 times in 40 s; a period needs two"
    ):
        mass_ratio.crossing_period(run)


def test_a_result_that_is_not_finite_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    columns = [("name", ""), ("a", ".1f"), ("b", ".1f")]
    rows = [("x", 1.0, None), ("y", np.float64(2.0), np.nan)]
    table = harness.ResultTable("Some table", columns, rows)
    for outcome, words in (
        (harness.Outcome([table], []), "b in row 2 of the table 'Some table'"),
        (harness.Outcome([], [], {"a": np.inf}), "parameters"),
    ):
        parser = harness.parser("trial", "A trial.")
        out = str(tmp_path / "out")
        with redirect_stderr(io.StringIO()) as err:
            code = harness.run_experiment(parser, lambda *_, o=outcome: o, ["--out", out])
        assert code == 2
        assert words in err.getvalue()
        assert err.getvalue().startswith("error: These arguments give a result that is not finite")
        assert files(tmp_path) == []


@pytest.mark.slow
def test_an_energy_that_grows_leaves_the_band_of_its_ripple() -> None:
    # 2π√(5 m/g), longer by 0.3²/16 for the amplitude
    held = crane()
    period = 4.5 * 1.006
    start = held.state(l=5.0, phi=0.3)
    law = hold_controller(held, gravity=held.gravity)
    run = simulate(held, law, start=start, duration=20.0)
    mean, least, most = energy.band(run, period)
    assert least <= mean <= most
    # 4 J in 20 s beside a ripple of 0.8 J.
    mean, least, most = energy.band(replace(run, energy=run.energy + 0.2 * run.t), period)
    assert not least <= mean <= most


class Mine(Exception):
    """What a caller's own function raises."""


def raising(*_: object) -> Any:
    """A function of the caller's own."""
    raise Mine("not today")


@pytest.mark.parametrize("whose", ["batch", "free swing"])
def test_what_a_callers_own_reference_raises_is_a_sentence_with_its_place_and_its_cause(
    whose: str,
) -> None:
    c = crane()
    law = hold_controller(crane())
    words = rf"The reference raised Mine in \w+, line \d+ of {Path(__file__).name}: not today\."
    with pytest.raises(CraneError, match=words) as caught:
        if whose == "batch":
            simulate_batch(c, law, raising, start=c.start, duration=0.05)
        else:
            free_swing(c, law, raising, c.state(phi=0.1), since=1.0, until=3.0)
    assert isinstance(caught.value.__cause__, Mine)


@pytest.mark.slow
def test_where_a_file_system_knows_no_locks_a_sweep_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("cranedyn.data.files.fcntl.flock", unknown)
    assert sweep(squares, grid(x=[1.0]), tmp_path / "swept", workers=1).done == 1


# --- pictures and the report ----------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Pictures without a viewer, no two alike; returns the times asked for."""
    asked: list[float] = []

    @contextmanager
    def fake(
        recording: Path, times: Sequence[float], size: tuple[int, int], whole: bool
    ) -> Iterator[Iterator[Image.Image]]:
        asked.extend(times)
        yield (
            Image.fromarray(np.roll(np.eye(*size, dtype=np.uint8), i, axis=1) * 255).convert("RGB")
            for i, _ in enumerate(times)
        )

    monkeypatch.setattr(pictures, "_pictures", fake)
    return asked


@pytest.mark.parametrize(
    ("fps", "span"), [(30.0, 2.0), (24.0, 1.5), (50.0, 1.0), (7.0, 3.0), (10.0, 0.1)]
)
def test_a_gif_takes_the_time_that_it_shows(
    fps: float, span: float, drawn: list[float], tmp_path: Path
) -> None:
    path = pictures.animate(
        tmp_path / "a.rrd", (1.0, 1.0 + span), tmp_path / "a.gif", fps=fps, size=(200, 200)
    )
    delays = []
    with Image.open(path) as image:
        for k in range(image.n_frames):
            image.seek(k)
            delays.append(image.info["duration"])
    shown = np.cumsum([0, *delays]) / 1000.0
    # A GIF counts in 10 ms.
    np.testing.assert_allclose(shown[:-1], np.array(drawn) - 1.0, atol=0.005 + 1e-9)
    assert shown[-1] == pytest.approx(span + 1.0 / fps, abs=0.011)
    assert min(delays) >= 20  # browsers play shorter ones at 100 ms


@pytest.mark.parametrize("span", [(0.0, 1e9), (0.0, 1e300), (-1e308, 1e308)])
def test_a_gif_of_more_pictures_than_memory_holds_is_refused(
    span: tuple[float, float], drawn: list[float], tmp_path: Path
) -> None:
    with pytest.raises(
        OutOfRange, match=r"number of pictures is \S+; allowed is 1627 or fewer of 640 x 480 pixels"
    ):
        pictures.animate(tmp_path / "a.rrd", span, tmp_path / "a.gif")
    assert not drawn
    assert files(tmp_path) == []


def test_pictures_are_not_even_drawn_where_the_moving_one_is_refused(
    drawn: list[float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for span, sentence in (
        ("0 1e9 a.gif", "number of pictures"),
        ("0 1 a.png", "the ending must be .gif"),
        ("0 x a.gif", "END is x"),
        ("1 1 a.gif", "span is 1 to 1"),
        ("0 1 a.gif --fps 0", "pictures per second is 0"),
        ("0 1 a.gif --size 1 1", "pixels; allowed is"),
    ):
        words = ["-t", "0", "-o", str(tmp_path / "out"), "--gif", *span.split()]
        code = snapshots.main([str(tmp_path / "a.rrd"), *words])
        err = capsys.readouterr().err
        assert (code, err.count("\n"), drawn, files(tmp_path)) == (2, 1, [], [])
        assert sentence in err


def test_a_folder_for_pictures_is_made_only_when_there_are_some(tmp_path: Path) -> None:
    (tmp_path / "bad.rrd").write_text("nothing")
    with pytest.raises(DataError):
        pictures.snapshot(tmp_path / "bad.rrd", [0.0], tmp_path / "new")
    with pytest.raises(OutOfRange, match="each time once"):
        pictures.snapshot(tmp_path / "bad.rrd", [1.0, 1.0000001], tmp_path / "new")
    assert files(tmp_path) == ["bad.rrd"]


_TABLE = RESULT["tables"][0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        *("{}", "null", "[" * 100_000, "\x00"),
        json.dumps(RESULT | {"claims": [{"sentence": 1, "holds": 2}]}),
        json.dumps(RESULT | {"figures": ["../../../etc/passwd"]}),
        json.dumps(RESULT | {"files": {"../a1/result.json": "0"}}),
        json.dumps(RESULT | {"files": {"result.json": "0"}}),
        json.dumps(RESULT | {"tables": [_TABLE | {"formats": ["999999999d"]}]}),
        json.dumps(RESULT | {"tables": [_TABLE | {"rows": [["up"]]}]}),
    ],
    ids=lambda text: text[:12],
)
def test_a_result_of_another_shape_is_one_sentence_and_no_report(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "a1"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(RESULT))
    assert report.main(["--out", str(tmp_path), "--only", "a1"]) == 0
    (tmp_path / "report.html").unlink()
    capsys.readouterr()
    (folder / "result.json").write_text(text)
    assert report.main(["--out", str(tmp_path), "--only", "a1"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: Cannot read ")
    assert err.count("\n") == 1
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("code", [2, 130])
def test_a_report_may_go_into_a_folder_that_looks_like_an_option_and_ends_as_its_experiment(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = f"import sys; sys.exit({code} if sys.argv[-1] == '--out=-/mass_ratio' else 99)"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report, "COMMAND", (sys.executable, "-c", script))
    assert report.main(["--out=-", "--only", "mass_ratio"]) == code
    assert files(tmp_path) == []


def test_a_report_judges_all_folders_before_the_first_experiment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "COMMAND", ("/nothing is run",))
    (tmp_path / "a2").write_text("in the way", encoding="utf-8")
    assert report.main(["--out", str(tmp_path), "--only", "a1", "a2"]) == 2
    assert files(tmp_path) == ["a2"]
