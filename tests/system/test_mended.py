"""Faults that fuzzing found: whatever is given, a sentence comes back."""

from __future__ import annotations

import errno
import gc
import json
import re
import types
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pyarrow as pa
import pyarrow.csv
import pytest

import experiments.snapshot
from cranedyn import theory
from cranedyn.analysis.prediction import free_swing
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller
from cranedyn.data import files
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.validity import hoisting
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.interfaces import Setpoint
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.planning.itinerary import Leg, itinerary
from cranedyn.plotting.figures import panels, save
from cranedyn.recording import Live, Run, record
from cranedyn.references import hold, pulse, ramp
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import grid, sweep
from experiments import a3, harness, report
from tests.helpers import crane
from tests.helpers import files as names_in
from tests.studies import squares


class Mine(Exception):
    """What a caller's own function raises."""


def raising(*_: object) -> Any:
    """A function of the caller's own."""
    raise Mine("not today")


class Unsayable:
    """A hold that cannot say itself in the common form."""

    def __call__(self, t: float, state: object, setpoint: object) -> np.ndarray:
        """Nothing."""
        return np.zeros(3)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> None:
        """It fails."""
        raise Mine("not today")


@pytest.fixture(scope="module")
def run() -> Trajectory:
    """A short one."""
    return simulate(crane(), hold_controller(crane()), duration=0.05, engine="compiled")


# --- shapes ---------------------------------------------------------------------------------------


STILL = dict.fromkeys(
    ("length_rate", "x", "x_rate", "x_acceleration", "slew_rate", "slew_acceleration"), 0.0
)


@pytest.mark.parametrize(
    "ask",
    [
        lambda: theory.adiabatic_amplitude(np.zeros((1,) * 32), 10.0, 0.1),
        lambda: theory.adiabatic_amplitude(np.full((2, 2), 5.0), 10.0, 0.1),
        lambda: theory.small_swing(
            np.zeros(2), np.float64(2.0), length=10.0, gravity=9.81, **STILL
        ),
        lambda: theory.small_swing(np.zeros(3), np.zeros(2), length=10.0, gravity=9.81, **STILL),
    ],
)
def test_a_closed_form_refuses_an_array_of_another_shape(ask: Callable[[], object]) -> None:
    with pytest.raises(OutOfRange, match=r"is an array of shape .*; allowed is one of shape"):
        ask()


BROKEN = {
    "an array": lambda t: np.zeros(3),
    "rows of nan": lambda t: np.full((2, 3), np.nan),
    "a part is missing": lambda t: Setpoint(np.zeros(3), np.zeros(3), None),  # type: ignore[arg-type]
    "of two drives": lambda t: Setpoint(*np.zeros((3, 2))),
    "not finite": lambda t: Setpoint(*np.full((3, 3), np.nan)),
}


@pytest.mark.parametrize("base", BROKEN.values(), ids=BROKEN)
def test_a_pulse_or_a_ramp_on_a_reference_that_says_nonsense_refuses_when_asked(base: Any) -> None:
    for made in (
        pulse(crane(), base, "x", 0.1, at=1.0, width=1.0),
        ramp(crane(), base, "x", 1.0, rate=1.0, at=1.0),
    ):
        for ask in (lambda: made(0.0), lambda: made(1.5), lambda: made.at(np.array([0.0, 1.5]))):  # noqa: B023
            with pytest.raises(OutOfRange, match=r"setpoint|answer of the reference"):
                ask()


# --- what a caller's own function raises ----------------------------------------------------------


def _batch(**given: Any) -> object:
    return simulate_batch(
        **{
            "crane": crane(),
            "controller": hold_controller(crane()),
            "start": crane().start,
            "duration": 0.05,
            **given,
        }
    )


@pytest.mark.parametrize(
    ("ask", "whose"),
    [
        (lambda: _batch(reference=raising), "reference"),
        (lambda: _batch(controller=Unsayable()), "controller"),
        (
            lambda: free_swing(
                crane(),
                hold_controller(crane()),
                raising,
                crane().state(phi=0.1),
                since=1.0,
                until=3.0,
            ),
            "reference",
        ),
    ],
)
def test_what_a_callers_own_function_raises_is_a_sentence_with_its_place_and_its_cause(
    ask: Callable[[], object], whose: str
) -> None:
    with pytest.raises(
        CraneError,
        match=rf"The {whose} raised Mine in \w+, line \d+ of test_mended\.py: not today\.",
    ) as caught:
        ask()
    assert isinstance(caught.value.__cause__, Mine)


def test_a_free_swing_may_be_looked_at_from_its_start_and_a_reference_at_no_time() -> None:
    still = hold(crane())
    found = [
        free_swing(
            crane(),
            hold_controller(crane()),
            reference,
            crane().state(phi=0.1),
            since=0.0,
            until=3.0,
        )
        for reference in (still, lambda t: still(t))
    ]
    assert found[0] == found[1]
    assert [part.shape for part in tabulated(lambda t: still(t), np.empty(0), 3)] == [(0, 3)] * 3


# --- values that cannot be written out, texts that UTF-8 cannot write -----------------------------


def test_a_recording_may_have_a_title_a_text_and_names_that_are_no_utf_8(
    run: Trajectory, tmp_path: Path
) -> None:
    odd = "a\udcff\nb"
    record(tmp_path / "a.rrd", [Run(odd, crane(), run)], title=odd, text=odd)
    with Live(crane(), odd, title=odd, text=odd, file=tmp_path / "b.rrd") as live:
        live.append(run)
    assert names_in(tmp_path) == ["a.rrd", "b.rrd"]
    assert Run(odd, crane(), run).name == "a\\udcff\nb"


# --- files ----------------------------------------------------------------------------------------


def test_a_figure_that_is_interrupted_while_it_is_written_leaves_no_file_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    figure, _ = panels()
    PIL.Image.init()
    monkeypatch.setitem(PIL.Image.SAVE, "PNG", stop)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(KeyboardInterrupt):
            save(figure, tmp_path / "a.png")
        gc.collect()
    assert [str(one.message) for one in said if one.category is ResourceWarning] == []
    assert not list(tmp_path.iterdir())


def test_where_a_file_system_knows_no_locks_a_sweep_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(files.fcntl, "flock", unknown)
    assert sweep(squares, grid(x=[1.0]), tmp_path / "swept", workers=1).done == 1


def test_pictures_are_not_taken_before_the_moving_one_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        experiments.snapshot, "snapshot", lambda *_, **__: pytest.fail("a picture was taken")
    )
    for span, says in (
        ("0 1 a.png", "the ending must be .gif"),
        ("0 x a.gif", "END is x"),
        ("1 1 a.gif", "span is 1 to 1"),
    ):
        assert (
            experiments.snapshot.main(
                ["a.rrd", "-t", "0", "-o", str(tmp_path / "out"), "--gif", *span.split()]
            )
            == 2
        )
        assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _experiment(code: int, seen: list[str]) -> types.SimpleNamespace:
    """An experiment that notes its folder and ends with a code."""

    def main(argv: list[str]) -> int:
        seen.append(harness.parser("mass_ratio", "A trial.").parse_args(argv).out)
        return code

    return types.SimpleNamespace(main=main)


@pytest.mark.parametrize("code", [2, 130])
def test_a_report_may_go_into_a_folder_that_looks_like_an_option_and_ends_as_its_experiment(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report.importlib, "import_module", lambda name: _experiment(code, seen))
    assert report.main(["--out=-", "--only", "mass_ratio"]) == code
    assert seen == ["-/mass_ratio"] and not list(tmp_path.iterdir())


def test_a_report_judges_all_folders_before_the_first_experiment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        report.importlib, "import_module", lambda name: pytest.fail(f"{name} was run")
    )
    (tmp_path / "a2").write_text("in the way", encoding="utf-8")
    assert report.main(["--out", str(tmp_path), "--only", "a1", "a2"]) == 2
    assert names_in(tmp_path) == ["a2"]


def test_a_document_that_asks_for_a_table_that_is_not_made_costs_no_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- a1: Missing -->\n<!-- end -->\n", encoding="utf-8")
    made = harness.parser("a1", "A trial.")
    outcome = harness.Outcome([harness.ResultTable("Here", [("a", "")], [("b",)])], [])
    code = harness.run_experiment(
        made,
        lambda options, setup: outcome,
        ["--out", str(tmp_path / "out"), "--document", str(page)],
    )
    assert code == 2 and "asks for a table 'Missing'" in capsys.readouterr().err
    assert names_in(tmp_path) == ["page.md"]


# --- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [1e-310, 5e-324])
def test_a_leg_that_would_never_end_is_refused(rate: float) -> None:
    legs = [Leg("out", x=12.0), Leg("back", x=float(crane().start.q[crane().layout.index("x")]))]
    with pytest.raises(
        OutOfRange,
        match="time that leg out takes at these rates is inf s; allowed is a finite number",
    ):
        itinerary(crane(), crane().start, legs, rates=(0.1, rate, 1.0), dwell=1.0)


def _signals(folder: Path, **replaced: np.ndarray) -> Path:
    """A file of signals as a slewing crane would give them."""
    t = np.arange(400) * 0.04
    columns = {
        "t_s": t,
        "gamma_dot_rad_s": 0.01 * np.sin(t),
        "x_m": 20.0 + 0.0 * t,
        "theta_rad": 0.1 * np.cos(t),
    }
    columns |= {"theta_dot_rad_s": -0.1 * np.sin(t), "l_m": 15.0 + 0.0 * t, **replaced}
    pyarrow.csv.write_csv(pa.table(columns), folder / "a.csv")
    return folder / "a.csv"


@pytest.mark.parametrize(
    ("column", "factor", "says"),
    [
        ("gamma_dot_rad_s", 1e7, "gamma_dot_rad_s is -?99999.* in some row; allowed is -10 to 10"),
        ("theta_dot_rad_s", 1e4, "theta_dot_rad_s is -999.* in some row; allowed is -10 to 10"),
        (
            "x_m",
            1e4,
            r"a\.csv: The jib accelerates the trolley sideways by up to 2e\+03 m/s²; allowed is up "
            r"to 1000 m/s²",
        ),
    ],
)
def test_a_jib_or_a_load_faster_than_any_crane_is_refused_before_it_is_integrated(
    column: str,
    factor: float,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    good = pyarrow.csv.read_csv(_signals(tmp_path))[column].to_numpy()
    monkeypatch.setattr(a3, "_integrate", lambda *_: pytest.fail("a model was integrated"))
    assert (
        a3.main(
            [
                "--from",
                str(_signals(tmp_path, **{column: factor * good})),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 2
    )
    assert re.search(says, capsys.readouterr().err)


def test_a_record_of_a_crane_is_analysed_as_before(tmp_path: Path) -> None:
    assert a3.main(["--from", str(_signals(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))


# --- cranes ---------------------------------------------------------------------------------------


def test_dynamics_need_a_damping_or_a_friction_for_parsers_to_be_quiet(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    robot = ET.fromstring(describe())
    dynamics = next(
        joint for joint in robot.iterfind("joint") if joint.get("name") == "yaw_joint"
    ).find("dynamics")
    assert dynamics is not None
    dynamics.attrib = {"armature": "1.0"}
    (tmp_path / "a.urdf").write_text(ET.tostring(robot, encoding="unicode"), encoding="utf-8")
    with pytest.raises(
        ModelError, match=r"The dynamics of joint yaw_joint in .* needs a damping\."
    ):
        load_crane(tmp_path / "a.urdf")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("q", [np.zeros(3), np.full(5, np.nan)])
def test_a_crane_is_not_asked_how_it_hangs_at_coordinates_that_are_none(q: Any) -> None:
    with pytest.raises(OutOfRange, match="coordinates is "):
        crane().hanging(q)


def test_the_force_of_a_hoist_is_taken_from_rows_of_efforts_alone() -> None:
    assert hoisting(crane(), np.array([[1.0, 2.0, 3.0]])).tolist() == [3.0]
    for effort in (np.zeros(3), np.zeros((2, 2))):
        with pytest.raises(OutOfRange, match="effort is an array of shape"):
            hoisting(crane(), effort)
