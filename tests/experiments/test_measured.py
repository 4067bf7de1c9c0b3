"""Readers of public records, on small files of the same form that the tests write."""

from __future__ import annotations

import io
import subprocess
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.io import savemat

from cranedyn.errors import DataError
from cranedyn.identification import Record
from cranedyn.model.crane import STANDARD_GRAVITY as GRAVITY
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.recording.scene import drawn_size
from cranedyn.recording.shapes import visible_points
from experiments import measured
from experiments.measured import main
from experiments.measured.drive import STEP as DRIVE_STEP
from experiments.measured.drive import drive_table, fit_drive, simulate_trolley
from experiments.measured.effects import CANDIDATES, Fit, fit, residue
from experiments.measured.pendulum import STEP, logged, reported, simulate_swing, trolley
from experiments.measured.sources import SOURCES, committed_file, read_mat, read_workbook
from tests import rrd

HEADINGS = (
    "timestamp", "trolley_position", "cable_length", "sway_angle", "pwm_trolley_motor",
)  # fmt: skip
NAMES = ("t_s", "x_m", "l_m", "phi_rad", "x_command")


def workbook(path: Path, sheets: list[list[list[object]]]) -> Path:
    """Write a workbook of sheets of rows of cells."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kinds = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    main_kind = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    package = "http://schemas.openxmlformats.org/package/2006"

    def cell(value: object) -> str:
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
        return f"<c><v>{value!r}</v></c>"

    numbers = range(1, len(sheets) + 1)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{package}/content-types"><Default Extension="rels" ContentType='
            '"application/vnd.openxmlformats-package.relationships+xml"/></Types>',
        )
        file.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{package}/relationships"><Relationship Id="r" Type="{kinds}/'
            'officeDocument" Target="xl/workbook.xml"/></Relationships>',
        )
        entries = "".join(f'<sheet name="S{i}" sheetId="{i}" r:id="r{i}"/>' for i in numbers)
        file.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{main_kind}" xmlns:r="{kinds}"><sheets>{entries}</sheets>'
            "</workbook>",
        )
        links = "".join(
            f'<Relationship Id="r{i}" Type="{kinds}/worksheet" Target="worksheets/s{i}.xml"/>'
            for i in numbers
        )
        file.writestr(
            "xl/_rels/workbook.xml.rels",
            f'<Relationships xmlns="{package}/relationships">{links}</Relationships>',
        )
        for i, rows in zip(numbers, sheets, strict=True):
            body = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
            text = f'<worksheet xmlns="{main_kind}"><sheetData>{body}</sheetData></worksheet>'
            file.writestr(f"xl/worksheets/s{i}.xml", text)
    return path


def table(*, length: int = 5) -> list[list[object]]:
    return [[0.01 * i, 0.1 * i, 0.4, 0.01 * i, 650.0] for i in range(length)]


def test_a_workbook_has_a_record_a_sheet_and_headings_in_the_first(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine", reason="extra measured is not installed")
    path = workbook(tmp_path / "a.xlsx", [[list(HEADINGS), *table()], table(length=7)])
    first, second = read_workbook(path)
    assert (len(first["t_s"]), len(second["t_s"])) == (5, 7)
    np.testing.assert_allclose(second["x_m"], 0.1 * np.arange(7))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([["time", *HEADINGS[1:]], *table()], r"a.xlsx, sheet S1, row 1 has no column 'timestamp'"),
        ([list(HEADINGS), *table(), [0.02, 0, 0.4, 0, 0]], "sheet S1, row 7: the time runs back"),
        ([list(HEADINGS), *table(), [1.0, 0, 0.4, 400.0, 0]], "row 7: phi_rad is 400; allowed"),
        ([list(HEADINGS), *table(), [1.0, "x", 0.4, 0.0, 0]], "row 7: 'x' is no number"),
        ([list(HEADINGS)], "sheet S1 has 0 rows of numbers"),
        ([list(HEADINGS), *table(), [1e999, 0, 0.4, 0.0, 0]], "row 7: the time is inf|is no numb"),
    ],
)
def test_a_workbook_that_is_no_record_is_refused_with_sheet_and_row(
    tmp_path: Path, rows: list[list[object]], message: str
) -> None:
    pytest.importorskip("python_calamine", reason="extra measured is not installed")
    with pytest.raises(DataError, match=message):
        list(read_workbook(workbook(tmp_path / "a.xlsx", [rows])))


def test_a_file_that_is_no_workbook_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine", reason="extra measured is not installed")
    path = tmp_path / "a.xlsx"
    path.write_bytes(b"no workbook")
    with pytest.raises(DataError, match=r"Cannot read .*a\.xlsx"):
        list(read_workbook(path))


def mat(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    savemat(file, arrays)
    return file.getvalue()


@pytest.mark.slow
def test_a_mat_file_has_times_and_angles() -> None:
    t = np.arange(10.0)
    newer = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)
    columns = read_mat(mat(t=t, y=0.1 * t), "a")
    np.testing.assert_array_equal(columns["phi_rad"], 0.1 * t)
    for content, message in (
        (mat(t=t), "a.mat has no vector y, but t; needed are t and y"),
        (newer, "Cannot read a.mat: NotImplementedError: Please use HDF reader"),
        (b"no such file", "Cannot read a.mat"),
        (mat(t=t[::-1], y=t), "a.mat, row 2: the time runs back"),
        (mat(t=t, y=50.0 * t), "a.mat, row 2: phi_rad is 50; allowed is up to 3.142"),
        (mat(t=t, y=np.where(t == 4.0, np.nan, 0.0)), "a.mat, row 5: phi_rad is nan"),
        (mat(t=t, y=t[:5]), "10 times and 5 angles"),
    ):
        with pytest.raises(DataError, match=message):
            read_mat(content, "a")


def test_without_data_it_says_how_to_get_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    message = capsys.readouterr().err
    assert message.count("git clone https://github.com/") == 2
    assert "--data DIR" in message
    assert main(["--data", "nowhere"]) == 2


@pytest.mark.slow
def test_drag_centring_and_tilt_are_found_in_a_record_that_has_them() -> None:
    t = np.arange(0.0, 12.0, 0.03)
    one = np.ones(1)
    half = 0.5 * STEP * np.arange(2401)
    move = CubicSpline(half, trolley(half, 1.2, 1.75))
    effects = [value * one for value in (0.05, 0.06, 0.0, 0.02)]
    phi = simulate_swing(move(half, 2)[:, None], 0.35 * one, np.zeros((2, 1)), *effects).ravel()
    columns = {"t_s": t, "x_m": move(t), "x_dot_m_s": move(t, 1), "l_m": np.full(len(t), 0.38)}
    columns["phi_rad"] = reported(t, phi, 0.0, 0.35) + 0.004 * move(t)
    crane = load_crane(XACRO.with_name("overhead_crane.urdf.xacro"), values=SOURCES[0].values)
    records = [Record.of(crane, columns, name=name) for name in ("1", "2")]
    found, without = (fit(records, names) for names in (CANDIDATES[-1], CANDIDATES[1]))
    expected = {"damping": 0.05, "window": 0.35, "drag": 0.06, "centring": 0.02, "tilt": 0.004}
    for name, value in expected.items():
        assert found.values[name] == pytest.approx(value, rel=0.02), name
    np.testing.assert_allclose(found.offsets, -0.03, atol=1e-4)
    assert (without.offsets < -0.031).all()  # shorter than it is


def committed(folder: Path, content: bytes) -> tuple[Path, str]:
    """A repository with a file in a commit, and its name."""
    clone = folder / "clone"
    clone.mkdir()
    git = ["git", "-C", str(clone)]
    subprocess.run([*git, "init", "-q"], check=True)
    (clone / "a.mat").write_bytes(content)
    subprocess.run([*git, "add", "."], check=True)
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run([*git, *identity, "commit", "-qm", "x"], check=True)
    found = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    return clone, found.stdout.strip()


def test_a_file_of_a_commit_is_found_by_the_beginning_of_its_name(tmp_path: Path) -> None:
    clone, commit = committed(tmp_path, b"content")
    assert committed_file(clone, commit[:7], "a.mat") == b"content"
    with pytest.raises(DataError, match=f"has no b.mat in commit {commit[:7]}"):
        committed_file(clone, commit[:7], "b.mat")
    with pytest.raises(DataError, match=r"has no folder \.git/objects"):
        committed_file(tmp_path, commit, "a.mat")


@pytest.mark.parametrize(
    "setting",
    [
        '[diff "x"]\n\ttextconv = touch {ran}; cat\n',
        "[core]\n\tpager = touch {ran}\n\tfsmonitor = touch {ran}\n\tsshCommand = touch {ran}\n",
        "[core]\n\trepositoryformatversion = 1\n[extensions]\n\tpartialClone = origin\n"
        '[remote "origin"]\n\turl = {other}\n\tpromisor = true\n'
        '\tuploadpack = touch {ran}; git-upload-pack\n[protocol "file"]\n\tallow = always\n',
    ],
)
def test_programs_that_a_clone_names_do_not_run(setting: str, tmp_path: Path) -> None:
    """One that turns a file into text, one that shows it, and one that fetches a missing object."""
    clone, commit = committed(tmp_path, b"content")
    ran = tmp_path / "ran"
    other = tmp_path / "other.git"
    subprocess.run(["git", "init", "-q", "--bare", str(other)], check=True)
    with (clone / ".git" / "config").open("a") as config:
        config.write(setting.format(ran=ran, other=other))
    (clone / ".git" / "info" / "attributes").write_text("*.mat diff=x\n")
    if "partialClone" in setting:
        for path in (clone / ".git" / "objects").glob("??/*"):
            if b"blob" in zlib.decompress(path.read_bytes())[:5]:
                path.unlink()
        with pytest.raises(DataError, match=r"has no a\.mat"):
            committed_file(clone, commit, "a.mat")
    else:
        assert committed_file(clone, commit, "a.mat") == b"content"
    assert not ran.exists()


@pytest.mark.long
def test_records_of_the_same_form_are_identified_and_predicted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("python_calamine", reason="extra measured is not installed")
    monkeypatch.setattr(measured, "CANDIDATES", CANDIDATES[:2])
    sheets = []
    for seed in (2, 3):
        columns = logged(seed, delay=0.0, window=0.35)
        columns["x_command"] = np.where(columns["t_s"] < 4.0, 700.0, 0.0)
        rows = np.column_stack([columns[name] for name in NAMES]).tolist()
        sheets.append([list(HEADINGS), *rows] if seed == 2 else rows)
    folder = tmp_path / "gantry_crane_model_optimizer" / "data"
    workbook(folder / "trolley_step_response_750_with_random.xlsx", sheets)
    clone = tmp_path / "aaucrane"
    clone.mkdir()
    subprocess.run(["git", "init", "-q", str(clone)], check=True)
    assert main(["--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "has no matlab/model/ang/measang.mat in commit e48d9cb" in capsys.readouterr().err
    clone.rename(tmp_path / "elsewhere")
    code = main(["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    printed, message = capsys.readouterr()
    assert not message
    assert "holds      gantry: each record alone explains 90 % of its swing" in printed
    assert code in (0, 1)
    assert "trolley" in printed
    assert "Then the offset of 92 % of the records at least agrees with the" in printed
    assert "of 2 intervals hold the mean" in " ".join(printed.split())
    # The sensor's lateness, average and bias are taken off the recorded swing. An average takes
    # another share of the forced swing at the start than of a free one.
    recorded, twin = (
        rrd.numbers(tmp_path / "out" / "measured.rrd", rf"trolley\ 750\,\ 1\:\ {run}")
        for run in ("recorded", "twin")
    )
    error = recorded[1]["phi_deg"] - twin[1]["phi_deg"]
    assert np.std(error) < 0.2 * np.std(twin[1]["phi_deg"])


@pytest.mark.slow
def test_pendulums_of_two_lengths_tell_offset_and_gravity_within_their_intervals() -> None:
    crane = load_crane(XACRO.with_name("overhead_crane.urdf.xacro"), values=SOURCES[0].values)
    records = []
    for seed in range(4):
        more = 0.1 * (seed % 2)
        columns = logged(seed, travel=0.9, lasts=1.5 + 0.2 * seed, length=0.343 + more,
                         cable=0.381 + more, delay=0.0, window=0.35)  # fmt: skip
        records.append(Record.of(crane, columns, name=str(seed)))
    found = fit(records, CANDIDATES[1])
    mean, agree = found.agreement
    assert agree.all()
    assert mean == pytest.approx(-0.038, abs=2e-4)
    value, margin = found.gravity
    assert abs(value - GRAVITY) <= margin < 0.005 * GRAVITY


def together(offsets: np.ndarray, cables: np.ndarray, deviation: float) -> Fit:
    covariance = deviation**2 * np.eye(len(offsets))
    return Fit((), {}, cables, offsets, covariance, np.full((len(offsets), 2), np.nan), 0.0, 0.0)


def test_gravity_of_all_records_is_that_of_one_offset() -> None:
    # Pendulums 30 mm shorter than their cables, in another gravity than that of the fit.
    cables = np.array([0.4, 0.4, 0.6, 0.6])
    gravity = 9.78
    offsets = (cables - 0.03) * GRAVITY / gravity - cables
    value, margin = together(offsets, cables, 1e-4).gravity
    assert value == pytest.approx(gravity, rel=1e-9)
    # Two and two lengths of 0.1 mm each, 0.2 m apart.
    assert margin == pytest.approx(1.96 * 1e-4 / 0.2 * gravity, rel=1e-2)
    noise = 1e-3 * np.array([1.0, -1.0, -1.0, 1.0])
    # Squares of 4 · 10² over two degrees of freedom.
    assert together(offsets + noise, cables, 1e-4).gravity[1] == pytest.approx(
        10.0 * np.sqrt(2.0) * margin, rel=1e-2
    )


def test_records_agree_with_their_mean_within_the_interval_of_the_difference() -> None:
    offsets = 1e-3 * np.array([0.0, 0.0, 0.0, 4.0])
    # A difference from the mean of four has the deviation √(3/4) of one: 3 mm are 1.97 of 1.52 mm.
    for deviation, agreeing in ((1.70e-3, 3), (1.80e-3, 4)):
        mean, agree = together(offsets, np.full(4, 0.4), deviation).agreement
        assert mean == pytest.approx(1e-3)
        assert agree.sum() == agreeing


def test_a_second_oscillation_is_found_while_the_trolley_stands() -> None:
    t = np.arange(0.0, 12.0, 0.033)
    columns = {"x_m": trolley(t)}
    record = Record("1", load_crane(), t, columns)
    error = 0.002 * np.sin(1.3 * np.sqrt(GRAVITY / 0.35) * t) + np.where(t < 3.0, 0.1, 0.001)
    ratio, amplitude = residue(record, t, error, 0.35)
    assert ratio == pytest.approx(1.3, abs=0.02)
    assert amplitude == pytest.approx(0.002, rel=0.05)
    assert np.isnan(residue(record, t[t < 8.0], error, 0.35)).all()


@pytest.mark.slow
def test_stribecks_friction_is_told_from_dry_friction() -> None:
    t = np.arange(0.0, 4.0, DRIVE_STEP)
    command = np.random.default_rng(1).uniform(0.5, 0.8, (len(t), 4)) + 0.02 * np.arange(4)
    command[t > 3.0] = 0.0
    for surplus in (0.0, 0.05):
        values = np.array([3.4, 1.3, 0.6, surplus])
        way = simulate_trolley(command, values)
        assert (way[-1] > 0.05).all()
        logs = [
            {"t_s": t, "x_m": 0.7 + x, "x_command": share}
            for x, share in zip(way.T, command.T, strict=True)
        ]
        np.testing.assert_allclose(fit_drive(logs, 4), values, atol=0.01)
        *_, (dry, both) = zip(*drive_table(logs).rows, strict=True)
        assert (both < 0.1 * dry) == (surplus > 0.0)


def test_a_crane_of_a_laboratory_is_drawn_in_its_size() -> None:
    crane = load_crane(XACRO.with_name("overhead_crane.urdf.xacro"), values=SOURCES[0].values)
    low = np.array([np.inf] * 3)
    high = np.array([-np.inf] * 3)
    for _, points in visible_points(crane, crane.start.q, None):
        low = np.minimum(low, points.min(axis=0))
        high = np.maximum(high, points.max(axis=0))
    # Of the span, the runway and the height; a girder and a trolley stand out on all sides.
    assert (high - low < 1.2 * np.array([2.0, 3.0, 2.0])).all()
    assert drawn_size(crane) == pytest.approx(0.2)
    assert drawn_size(load_crane()) == 1.0
