"""Every experiment: what it claims, what it leaves behind, what it refuses. Each is run once,
whole, through its command line.
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console
from rich.progress import Progress

from cranedyn import theory
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import QUANTITIES, read
from cranedyn.errors import RunError
from cranedyn.interfaces import Setpoint
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments import a1, a2, a3, energy, harness, mass_ratio, report
from experiments.harness import setup as world_room
from experiments.harness.outcome import show
from tests.document_numbers import STATEMENTS, missing
from tests.experiments.conftest import ARTICLE, PLAIN, Ran, Standard, parse_strict, write_csv
from tests.helpers import files
from tests.next_commands import check_next_commands

EXPERIMENTS = {"a1": a1, "a2": a2, "a3": a3, "energy": energy, "mass_ratio": mass_ratio}

each = pytest.mark.parametrize("name", EXPERIMENTS)

# --- what every experiment does -------------------------------------------------------------------


@each
@pytest.mark.slow
def test_every_claim_holds_and_the_exit_code_says_so(name: str, standard: Standard) -> None:
    found = standard(name)
    assert (found.code, found.failed()) == (0, [])
    assert found.text.count("\nholds      ") == len(found.result["claims"]) >= 3


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(PLAIN))
def test_an_experiment_prints_the_same_whatever_computes_its_steps(
    name: str, standard: Standard, ran: Callable[..., Ran]
) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    compiled = standard(name)
    plain = ran(name, "--gravity", "9.8")
    assert compiled.code == plain.code == 0
    assert _printed(compiled) == _printed(plain)
    assert compiled.result["parameters"]["engine"] == "compiled"
    assert plain.result["parameters"]["engine"] == "pinocchio"


FILES = {
    "a1": ("a1_l5 a1_l10 a1_l15 a1_l20 a1_soft", "waveform period budget"),
    "a2": ("a2 a2_stiff", "hoisting fits"),
    "a3": ("a3 a3_stiff", "slewing stages"),
    "energy": (
        "energy_damp_0 energy_damp_1 energy_damp_200000 "
        "energy_dt_1000us energy_dt_500us energy_dt_250us",
        "ledger remainder",
    ),
    "mass_ratio": ("links_50 links_1e-6 tour_1000", "links"),
}


@each
@pytest.mark.slow
def test_trajectories_figures_recording_and_result_are_written_and_nothing_else(
    name: str, standard: Standard
) -> None:
    folder = standard(name).folder
    trajectories, figures = map(str.split, FILES[name])
    expected = {f"{t}.parquet" for t in trajectories} | {
        f"{f}{ending}" for f in figures for ending in (".png", ".svg")
    }
    assert set(files(folder)) == expected | {"result.json", f"{name}.rrd"}
    assert (folder / f"{name}.rrd").stat().st_size > 10_000
    for path in folder.glob("*.parquet"):
        run = read(path)
        assert all(np.isfinite(getattr(run, array)).all() for array in QUANTITIES)
        assert run.parameters["integrator"] == "semi-implicit Euler"
    for path in folder.glob("*.png"):
        picture = matplotlib.image.imread(path)
        assert min(picture.shape[:2]) > 300
        # Ink: a blank frame has a tenth of it.
        assert (picture[..., :3].min(axis=2) < 0.9).mean() > 0.01
        coarse = (picture[::3, ::3, :3] * 7).astype(int) @ [64, 8, 1]
        assert len(np.unique(coarse)) > 10  # colours


def _printed(ran: Ran) -> str:
    """Return all tables and claims as printed where there is no terminal."""
    tables = [harness.ResultTable.of(stored) for stored in ran.result["tables"]]
    with redirect_stdout(io.StringIO()) as out:
        show(harness.Outcome(tables, [harness.Claim(**claim) for claim in ran.result["claims"]]))
    return out.getvalue()


@each
@pytest.mark.slow
def test_its_tables_fit_80_columns_and_the_report_shows_it(name: str, standard: Standard) -> None:
    framed = [line for line in _printed(standard(name)).splitlines() if line[:1] in tuple("┏┃┡│└")]
    assert framed and max(map(cell_len, framed)) <= 80  # γ̈ is two characters in one column
    assert "…" not in _printed(standard(name))
    page = report.page([standard(name).folder])
    assert f'<section id="{name}">' in page
    captions = re.findall("<figcaption>(.*?)</figcaption>", page)
    assert len(captions) == len(FILES[name][1].split())
    assert all(len(caption.split()) > 4 for caption in captions)


@each
@pytest.mark.slow
def test_the_result_names_what_it_was_made_with(name: str, standard: Standard) -> None:
    result = standard(name).result
    assert result["experiment"] == name
    assert result["parameters"]["gravity_m_s2"] == (9.8 if name in ARTICLE else 9.80665)
    assert (result["parameters"]["dt_s"], result["parameters"]["control_period_s"]) == (5e-4, 5e-3)
    assert {"python", "cranedyn", "pin", "numpy", "rerun-sdk"} <= set(result["versions"])
    assert result["versions"]["pin"].startswith("4.")


@each
@pytest.mark.slow
def test_documents_tell_the_numbers_of_the_command(name: str, standard: Standard) -> None:
    documents = "README.md", "docs/results/article.md"
    for document, numbers in zip(documents, STATEMENTS[name](standard(name)), strict=True):
        assert missing(numbers, document) == []


# --- mass ratio -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_light_links_converge_to_none_in_proportion(standard: Standard) -> None:
    rows = standard("mass_ratio").table("Free swing with ever lighter links")
    assert [row["link [kg]"] for row in rows] == [50.0, 10.0, 1.0, 0.1, 1e-2, 1e-4, 1e-6, 0.0]
    bare = 1000 * 15**2 + 400
    for row in rows:
        # compound pendulum: T² goes with the inertia, one link each for φ and for what it carries
        expected = np.sqrt((bare + 2 * row["link [kg]"]) / bare) - 1
        # Rounding, crossings between samples.
        assert row["relative to no links"] == pytest.approx(expected, rel=1e-4, abs=1e-10)
        rigid = theory.rigid_period(15, 9.80665, 1000, 400 + 2 * row["link [kg]"])
        assert row["T [s]"] == pytest.approx(rigid * 1.000625586, rel=1e-6)


@pytest.mark.slow
def test_a_point_load_swings_alike_whatever_it_weighs(standard: Standard) -> None:
    rows = standard("mass_ratio").table("All drives in prescribed motion")
    assert [row["load [kg]"] for row in rows] == [10.0, 1e3, 1e5]
    for column in ("point: max φ [rad]", "max θ [rad]"):
        assert np.ptp([row[column] for row in rows]) < 1e-12  # rounding
        assert rows[0][column] > 0.03  # it does swing


# --- tables, claims and exit codes ----------------------------------------------------------------


def _conducted(outcome: harness.Outcome, argv: Sequence[str]) -> tuple[int, str]:
    with redirect_stdout(io.StringIO()) as out:
        parser = harness.parser("trial", "A trial.")
        code = harness.run_experiment(parser, lambda *_: outcome, list(argv))
    return code, out.getvalue()


@pytest.mark.parametrize(
    ("claims", "line", "code"),
    [
        ([True, True], "2 of 2 claims hold, 0 not judged.", 0),
        ([True, None, False], "1 of 3 claims hold, 1 not judged.", 1),
        ([None], "0 of 1 claims hold, 1 not judged.", 0),
        ([np.bool_(True), None], "1 of 2 claims hold, 1 not judged.", 0),
        ([np.bool_(False)], "0 of 1 claims hold, 0 not judged.", 1),
        ([], "", 0),
    ],
)
def test_the_exit_code_is_1_when_a_claim_fails_and_one_that_is_not_judged_is_counted_as_that(
    claims: list[bool | np.bool_ | None], line: str, code: int, tmp_path: Path
) -> None:
    judged = [harness.Claim("One is one.", holds) for holds in claims]  # type: ignore[arg-type]
    found, text = _conducted(harness.Outcome([], judged), ["--out", str(tmp_path)])
    assert found == code
    last = f"Written to {tmp_path}; no run to record."
    above_commands = text.splitlines()[:-2]
    assert above_commands[-2:] == [*([line] if line else []), last]
    assert ("FAILS      One is one." in text) == (code == 1)
    kept = parse_strict((tmp_path / "result.json").read_text())["claims"]
    assert [claim["holds"] for claim in kept] == [c if c is None else bool(c) for c in claims]


PAGE = harness.Outcome([], [], texts={"data.txt": "", "page.html": "<p>Hello</p>"})
"""An outcome with a page."""

TWIN = harness.Outcome([], [], next_commands=["cranedyn drive --set {folder}/twin.json"])
"""An outcome that names a command itself."""


@pytest.mark.parametrize(
    ("outcome", "commands"),
    [
        (PAGE, ["python -m webbrowser file://{folder}/page.html", "cranedyn run trial --help"]),
        (TWIN, ["cranedyn drive --set {folder}/twin.json", "cranedyn run trial --help"]),
        (harness.Outcome([], []), ["cranedyn run trial --help", "cranedyn list"]),
    ],
)
def test_an_experiment_ends_with_two_commands_that_go_on_with_its_files(
    outcome: harness.Outcome, commands: Sequence[str], tmp_path: Path
) -> None:
    _, text = _conducted(outcome, ["--out", str(tmp_path)])
    first, second = (command.format(folder=tmp_path) for command in commands)
    assert text.endswith(f"\nNext: {first}\n      {second}\n")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a1", "mass_ratio"])
def test_the_commands_at_the_end_of_an_experiment_work(
    name: str, standard: Standard, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_next_commands(standard(name).text, monkeypatch)


def test_tables_are_printed_with_title_and_note_and_kept_with_all_digits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    row = ("first", 1 / 3, np.float64(2.55), None)
    columns = [("name", ""), ("a", ".2f"), ("a", ".1f"), ("b", ".1f")]
    table = harness.ResultTable("Some title", columns, [row], "Some note.")
    assert table.shown() == [["first", "0.33", "2.5", "-"]]
    code, text = _conducted(harness.Outcome([table], [], {"n": np.int64(3)}), [])
    assert code == 0
    assert "Written to out/trial; no run to record." in text
    assert all(word in text for word in ("Some title", "Some note.", "first", "0.33", "2.5"))
    result = parse_strict((tmp_path / "out" / "trial" / "result.json").read_text())
    (kept,) = result["tables"]
    assert harness.ResultTable.of(kept).rows == [["first", 1 / 3, 2.55, None]]
    assert (kept["title"], kept["note"]) == ("Some title", "Some note.")
    assert result["parameters"] == {"n": 3}


def test_only_the_articles_world_judges_its_numbers() -> None:
    assert harness.Setup(9.8).judged(True) is True
    assert harness.Setup(9.8).judged(np.bool_(False)) is False  # type: ignore[arg-type]
    assert harness.Setup(9.8, engine="compiled").judged(True) is True  # the same to round-off
    for setup in (
        harness.Setup(),
        harness.Setup(9.8, {"payload_mass": 900}),
        harness.Setup(9.8, dt=1e-3),
        harness.Setup(9.8, control_period=1e-2),
    ):
        assert setup.judged(True) is None


def test_a_world_runs_on_its_own_clocks_and_numbers() -> None:
    setup = harness.Setup(3.7, {"payload_mass": "700"}, 1e-3, 2e-2)
    held = setup.crane
    clocks = {"dt": 1e-3, "control_period": 2e-2}
    assert (held.gravity, held.payload_mass) == (3.7, 700.0)
    assert not setup.variant(payload_inertia=0).payload_inertia.any()
    hold = hold_controller(held)
    found = setup.simulate(held, hold, None, start=held.start, duration=0.2, label="x")
    same = simulate(held, hold, duration=0.2, **clocks)
    assert found.q.tolist() == same.q.tolist()
    means = {"validity": "stop", "engine": "pinocchio", "integrator": "euler"}
    numbers = {"gravity_m_s2": 3.7, "payload_mass": "700"}
    assert setup.parameters() == {f"{k}_s": v for k, v in clocks.items()} | means | numbers


@pytest.mark.parametrize(
    ("duration", "times", "shown"),
    [
        (2.0, [k * 5e-3 for k in range(401)], [0.0, 0.5, 1.0, 1.5, 2.0]),
        (30.0, [9.995, 19.995, 29.995, 30.0], [9.995, 19.995, 29.995, 30.0]),
    ],
)
def test_progress_is_told_at_most_twice_a_second_and_only_to_a_terminal(
    duration: float, times: Sequence[float], shown: Sequence[float]
) -> None:
    assert harness.ProgressReporter().run("x", duration) is None
    progress = Progress(console=Console(file=io.StringIO()))
    moments = []
    update = harness.ProgressReporter(progress).run("x", duration)
    progress.update = lambda task, completed, **_: moments.append(completed)  # type: ignore[method-assign]
    assert update is not None
    for t in times:
        update(t)
    assert moments == shown


# --- what is refused, and runs that break off -----------------------------------------------------


@cache
def _loaded(gravity: float, values: tuple[tuple[str, object], ...]) -> Crane:
    return load_crane(gravity=gravity, values=dict(values))


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that a user might bring."""
    folder = tmp_path_factory.mktemp("records")
    t = np.arange(0.0, 40.0, 0.01)
    still = np.zeros_like(t)
    swing = 0.1 * np.cos(t)
    good = {
        "t_s": t,
        "phi_rad": swing,
        "l_m": still + 10,
        "gamma_dot_rad_s": 0.01 * np.sin(t),
        "x_m": still + 20,
        "theta_rad": swing,
        "theta_dot_rad_s": -0.1 * np.sin(t),
    }
    rates = dict.fromkeys(("gamma_dot_rad_s", "x_m", "theta_rad", "theta_dot_rad_s"), still)
    for name, columns in {
        "good": good,
        "long": {**good, "l_m": still + 1e300},
        "epoch": {**good, "t_s": t + 1.7e9},
        "sparse": {**good, "t_s": 60 * t},
        "spun": {**good, "gamma_dot_rad_s": 1e5 * np.sin(t)},
        "whirled": {**good, "theta_dot_rad_s": 1e3 * np.sin(t)},
        "far": {**good, "x_m": still + 2e5},
        "columns": {"time": t, "angle": swing},
        "up": {**good, "l_m": still - 10},
        "short": {name: column[:300] for name, column in good.items()},
        "still": {**good, "phi_rad": still, **rates},
        "uneven": {**good, "t_s": t + 0.004 * np.sin(9 * t)},
    }.items():
        write_csv(folder / f"{name}.csv", **columns)
    (folder / "file").write_text("")
    return folder


@pytest.fixture
def elsewhere(records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to be in, with those files; cranes are expanded once for all tests that are here."""

    def load_once(*, gravity: float, values: dict[str, object]) -> Crane:
        return _loaded(gravity, tuple(values.items()))

    monkeypatch.setattr(world_room, "load_crane", load_once)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(records, tmp_path, dirs_exist_ok=True)
    return tmp_path


BAD = r"""
a1 --length 3.3 => l at the start is 3.3 m; allowed is 3.4 to 26.4
a1 --length 15 15 => length is \[15.0, 15.0\] m; allowed is each length once
a1 --swing 0 => swing is 0.0 rad; allowed is > 0
a1 --swing 1.6 => swing is 1.6 rad; allowed is 0 to 1.5708
a1 --from columns.csv => columns.csv has no column t_s, phi_rad, l_m
a1 --from up.csv => up.csv: l_m is -10 in some row; allowed is 0.001 to 1e\+06
a1 --from short.csv => short.csv: The record holds no row
a1 --from still.csv => still.csv: The record from 12 to 39.99 s holds 0 half swings
a2 --from short.csv => short.csv: From 12 s on the swing has 0 peaks while the cable
a3 --radius 1 => x at the start is 1.0 m; allowed is 2 to 22
a3 --from short.csv => The record ends at 2.99 s; the comparison starts at 4 s
a3 --from still.csv => still.csv: The .* signal does not move
a3 --from uneven.csv => The slew acceleration needs 11 rows or more, evenly spaced
mass_ratio --dt 3e-4 => control_period is 0.005 s; allowed is a multiple of dt = 0.0003
a1 --gravity -9.8 => gravity is -9.8 m/s²; allowed is > 0
a1 --control-period 1e300 => dt is 0.0005 s; allowed is 1e\+290 or more for a run of
a1 --set payload_mass=5 => 'payload_mass=5' is not of the form name:=value
a1 --out file/out => Cannot make the folder file/out: Not a directory
a1 --out file => Cannot write to file: it is not a folder
a1 --save x.mp4 => Cannot write x.mp4: the ending must be .rrd
a1 --save missing/x.rrd => as missing/x.rrd: its folder does not exist
mass_ratio --set payload_mass:=1e20 => smallest eigenvalue of the scaled mass matrix
energy --swing 1e-200 => swing is 1e-200 rad; allowed is 0.001 to 1.5708
energy --set damp_swing:=5 => damp_swing is set by the experiment energy itself; leave it
mass_ratio --set dummy_mass:=5 => dummy_mass is set by the experiment mass_ratio itself
a3 --set trolley_init:=5 => trolley_init is set by the experiment a3 itself
a1 --set payload_mass:=1 payload_mass:=2 => payload_mass is given twice
a1 --columns phi_rad=a => --columns has no effect without --from
a1 --joints l=rope => --joints has no effect without --from and an .mcap or .bag file; leave it out
energy --port 9999 => --port has no effect without --serve; leave it out
energy --dt 1e-7 --control-period 1e-7 => duration is 6 s; allowed is .* at most
a1 --from good.csv --engine compiled => --engine has no effect beside --from; leave it out
a1 --from good.csv --length 5 => --length has no effect beside --from
a1 --from good.csv --identify => --identify has no effect beside --from
a1 --identify --swing 0.2 => --swing has no effect beside --identify
a2 --from good.csv --set payload_mass:=2 => --set has no effect beside --from
a3 --from good.csv --dt 1e-3 => --dt has no effect beside --from
a1 --from long.csv => long\.csv: l_m is 1e\+300 in some row; allowed is 0\.001 to 1e\+06
a1 --from epoch.csv => epoch\.csv: t_s is 1\.7e\+09 in some row; allowed is -1e\+06 to 1e\+06
a1 --from sparse.csv => sparse\.csv: t_s leaves a gap of 0\.6 s; allowed are 0\.5 s
a3 --from spun.csv => gamma_dot_rad_s is -?[19].* in some row; allowed is -10 to 10
a3 --from whirled.csv => theta_dot_rad_s is -?[19].* in some row; allowed is -10 to 10
a3 --from far.csv => the trolley sideways by up to 2e\+03 m/s²; allowed is up to 1000 m/s²
energy --out LONG => Cannot .*File name too long
energy --save /proc/cranedyn.rrd => Cannot write /proc/cranedyn.rrd
"""
"""Commands, and what is in the sentence with which they are refused; LONG is a name too long."""


@pytest.mark.parametrize("row", BAD.strip().splitlines())
def test_bad_input_is_one_sentence_exit_code_2_and_nothing_written(
    row: str, elsewhere: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    line, sentence = row.split(" => ")
    name, *words = line.replace("LONG", "a" * 300).split()
    before = files(elsewhere)
    assert EXPERIMENTS[name].main(words) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert re.fullmatch(rf"error: .*{sentence}.*\.\n", err)
    assert files(elsewhere) == before


def test_the_good_file_is_analysed(elsewhere: Path) -> None:
    assert a1.main("--from good.csv --set payload_mass:=900 --out out".split()) == 0


@pytest.mark.slow
def test_an_experiment_runs_as_a_command_without_a_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "experiments.mass_ratio", "--set", "payload_mass:=-1"]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    error = "error: payload_mass is -1 kg; allowed is > 0.\n"
    assert (run.returncode, run.stdout, run.stderr) == (2, "", error)
    assert files(tmp_path) == []


def _breaking(at: float) -> Callable[..., Any]:
    def controller(*arguments: Any, **more: Any) -> Any:
        brake = hold_controller(*arguments, **more)

        def command(t: float, state: Any, setpoint: Setpoint) -> np.ndarray:
            if t >= at:
                raise KeyboardInterrupt
            return brake(t, state, setpoint)

        return command

    return controller


def test_ctrl_c_keeps_what_was_recorded_and_is_exit_code_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(a3, "hold_controller", _breaking(1.0))
    assert a3.main(["--out", str(tmp_path / "out")]) == 130
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: Interrupted at t = 1.000 s.\nWhat was recorded up to then is in ")
    assert files(tmp_path) == ["out", "out/broken_off.parquet"]
    kept = read(tmp_path / "out" / "broken_off.parquet")
    assert (len(kept), kept.t[-1]) == (200, 0.995)


def test_a_run_that_diverges_keeps_what_was_recorded_and_is_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wild = (
        "--validity mark --dt 0.25 --control-period 0.25 "
        "--set trolley_effort:=1e12 hoist_effort:=1e12 slew_effort:=1e14"
    )
    assert energy.main(["--out", str(tmp_path / "out"), *wild.split()]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert re.match(
        r"error: The run diverged at t = [\d.]+ s: \w+_joint moves at \S+ per second; a smaller dt "
        r"or softer gains may help\.\n",
        err,
    )
    kept = read(tmp_path / "out" / "broken_off.parquet")
    assert len(kept) >= 1
    assert np.isfinite(kept.q).all()


def test_a_run_error_without_a_record_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def experiment(options: Any, setup: harness.Setup) -> harness.Outcome:
        raise RunError("It broke.", t=0.0)

    parser = harness.parser("trial", "A trial.")
    argv = ["--out", str(tmp_path / "out")]
    assert harness.run_experiment(parser, experiment, argv) == 1
    assert capsys.readouterr() == ("", "error: It broke.\n")
    assert files(tmp_path) == []
