"""The content of a recording, checked against the trajectory and the dynamics behind it."""

from __future__ import annotations

import re
import resource
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, box_corners, box_load, standing
from cranedyn.dynamics.equations_of_motion import payload_position, pivot_position
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.plotting.style import COLOURS
from cranedyn.recording import Run, record
from cranedyn.recording.series import _axis_range, plots
from cranedyn.recording.shapes import rope_line, touching_points
from cranedyn.recording.sketch import Projection
from cranedyn.references import hold, pulse, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, files, python
from tests.rrd import chunks, numbers, poses, rows

pytestmark = pytest.mark.filterwarnings("error:::rerun")

FLOAT32 = 3e-5
"""[m] Half a unit in the last place of a 32-bit float at 50 m is 2e-6 m; six frames add up a few,
and their angles act over 20 m."""

SHORT = 4.0
OFFSET = (5.0, -3.0, 1.0)


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load_crane()


def moved(crane: Crane, duration: float, slew: float, hoist: float) -> Trajectory:
    """All three drives move and the load swings both ways."""
    reference = pulse(crane, hold(crane), "x", 1.0, at=0.5, width=2.0)
    reference = ramp(crane, reference, "gamma", slew, rate=0.2, at=0.5)
    reference = ramp(crane, reference, "l", hoist, rate=1.0, at=1.0)
    return simulate(crane, hold_controller(crane), reference, duration=duration)


@pytest.fixture(scope="module")
def moving(crane: Crane) -> Trajectory:
    return moved(crane, SHORT, 0.3, -2.0)


@pytest.fixture(scope="module")
def file(crane: Crane, moving: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "moving.rrd"
    return record(path, [Run("all drives", crane, moving, OFFSET)], title="A title")


# --- numbers and plots ----------------------------------------------------------------------------


def test_numbers_are_those_of_fifty_rows_a_second_and_of_all_jumps_of_an_effort(
    file: Path, crane: Crane, moving: Trajectory
) -> None:
    times, columns = numbers(file)
    kept = times // 5_000_000
    expected = {"energy_J": moving.energy - moving.energy[0], "unexplained_J": moving.unexplained}
    for key in ("q", "v", "setpoint", "effort", "work", "dissipated"):
        for name in moving.columns[key]:
            values = np.degrees(moving[name]) if "_rad" in name else moving[name]
            expected[name.replace("_rad", "_deg")] = values
    for name, limit in zip(("T_gamma_Nm", "F_x_N", "F_l_N"), crane.effort_limit, strict=True):
        expected[f"{name}_upper"] = np.full(len(moving), limit)
        expected[f"{name}_lower"] = np.full(len(moving), -limit)
    assert columns.keys() == expected.keys()
    for name, values in expected.items():
        assert columns[name].tobytes() == values[kept].astype(np.float32).tobytes(), name
    jumps = np.abs(np.diff(moving.effort, axis=0)) > 0.01 * crane.effort_limit
    ends = np.flatnonzero(jumps.any(axis=1))
    assert {*range(0, len(moving), 4), *ends, *(ends + 1)} == {*kept} and 0 < len(ends) < 100


@pytest.mark.slow
def test_the_coordinates_stand_in_the_recording_as_text_ten_times_a_second(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    runs = [Run("a|b", crane, moving), Run("late", crane, moving.since(2.0))]
    path = record(tmp_path / "readout.rrd", runs, title="Two")
    (batch,) = (batch for entity, batch in chunks(path) if entity == "/readout")
    assert_array_equal(batch["sim_time"].cast("int64"), np.arange(41) * 100_000_000)
    text = batch["TextDocument:text"].flatten()[30].as_py().splitlines()
    gamma, x, phi, theta, length = moving.q[np.searchsorted(moving.t, 3.0 - 1e-9)]
    shown = np.array([np.degrees(gamma), x, *np.degrees([phi, theta]), length])
    cells = " | ".join(f"{value:.2f}" for value in shown)
    assert text[0] == "|  | γ [°] | x [m] | φ [°] | θ [°] | l [m] |"
    assert text[2:] == [f"| a\\|b | {cells} |", f"| late | {cells} |"] and abs(theta) > 1e-3


@pytest.mark.parametrize(
    "values", [(-5.7, 5.7), (10.0, 11.0), (10.1, 10.1), (-43.0, 44.0), (7.2, 7.91)]
)
def test_two_numbers_stand_at_every_axis_whatever_its_range(values: tuple[float, float]) -> None:
    low, high = _axis_range([np.array(values)], 0.02)
    tick = 10.0 ** np.ceil(np.log10((high - low) / 11))
    assert low < min(values) and max(values) < high
    assert np.floor(high / tick) - np.ceil(low / tick) >= 1


@pytest.mark.slow
def test_both_swings_of_two_runs_have_four_colours(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    runs = [Run("one", crane, moving), Run("two", crane, moving)]
    reader = RrdReader(record(tmp_path / "two.rrd", runs, title="Two"))
    colours = {}
    for chunk in reader.stream(store=reader.blueprints()[0]):
        batch = chunk.to_record_batch()
        if "SeriesLines:names" in batch.schema.names:
            names, rgba = (batch[f"SeriesLines:{key}"].flatten() for key in ("names", "colors"))
            colours[names[0].as_py()] = rgba[0].as_py()
    swings = [f"{swing} · {run}" for swing in "φθ" for run in ("one", "two")]
    assert len({colours[name] for name in swings}) == 4


def test_every_curve_has_a_column_and_every_quantity_its_colour(file: Path, crane: Crane) -> None:
    columns = numbers(file)[1]
    curves = [curve for plot in plots(crane.layout).values() for curve in plot.curves]
    assert all(curve.column in columns and curve.quantity in COLOURS for curve in curves)
    quantities = {curve.quantity for curve in curves} - {"limit"}
    assert len(quantities) == len({COLOURS[name] for name in quantities}) == 9


def test_the_layout_travels_in_the_file(file: Path, crane: Crane) -> None:
    reader = RrdReader(file)
    (layout,) = reader.blueprints()
    (recording,) = reader.recordings()
    assert layout.application_id == recording.application_id
    names = set()
    spans = []
    for chunk in reader.stream(store=layout):
        batch = chunk.to_record_batch()
        if "TimeAxis:view_range" in batch.schema.names:
            spans.append(batch["TimeAxis:view_range"].flatten()[0].as_py())
        if "ViewBlueprint:display_name" in batch.schema.names:
            names |= set(batch["ViewBlueprint:display_name"].flatten().to_pylist())
    titles = [plot.title for plot in plots(crane.layout).values()]
    assert names == {"Crane", "Payload", "Now", "About", *titles}
    assert len(spans) == len(titles)
    assert {(span["start"], span["end"]) for span in spans} == {
        (0, 5_600_000_000)
    }  # and beside it the legend


@pytest.mark.slow
def test_another_set_of_runs_is_another_application_for_the_viewer(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    ids = set()
    for run in (
        Run("a", crane, moving),
        Run("b", crane, moving),
        Run("a", crane, moving, (1.0, 0.0, 0.0)),
    ):
        path = record(tmp_path / "a.rrd", [run], title="Größe: 50 %")
        ids.add(RrdReader(path).recordings()[0].application_id)
    assert len(ids) == 3 and all(re.fullmatch(r"[A-Za-z0-9-]+", name) for name in ids)


@pytest.mark.slow
def test_the_text_has_title_description_parameters_and_the_scale_of_the_arrows(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    parameters: dict[str, dict[str, float | str]] = {
        "one": {"gain": 2.5, "kind": "a|b"},
        "two": {"gain": 3.5},
    }
    runs = [
        Run(name, crane, replace(moving, parameters=values)) for name, values in parameters.items()
    ]
    path = record(tmp_path / "text.rrd", runs, title="A title", text="Some *claim*.")
    (batch,) = (batch for entity, batch in chunks(path) if entity == "/text")
    text = batch["TextDocument:text"].flatten()[0].as_py()
    for phrase in ("## A title", "Some *claim*.", "0.5 m for a degree"):
        assert phrase in text
    for row in ("| parameter | one | two |", "| gain | 2.5 | 3.5 |", "| kind | a\\|b |  |"):
        assert row in text


# --- the scene ------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", [0, 38, 100])
def test_the_frames_put_payload_and_trolley_where_the_dynamics_do(
    file: Path, crane: Crane, moving: Trajectory, row: int
) -> None:
    frames = poses(file, row * 40_000_000)
    q = moving.q[8 * row]
    for link, position in (("hook", payload_position), ("trolley", pivot_position)):
        translation = frames[f"all drives: {link}_link"][:3, 3]
        assert_allclose(translation, position(crane, q) + OFFSET, atol=FLOAT32)


def test_everything_in_the_scene_stands_in_a_frame_of_its_run(file: Path) -> None:
    frames = {}
    names = set()
    for entity, batch in chunks(file):
        if name := entity.partition("/scene/")[2]:
            names.add(name)
        if "CoordinateFrame:frame" in batch.schema.names:
            frames[name] = batch["CoordinateFrame:frame"].flatten()[0].as_py()
    assert frames.keys() == names and set(frames.values()) <= poses(file, 0).keys()
    assert {frames[name] for name in ("cable", "path", "setpoint/cable")} == {"all drives: world"}


def test_a_position_beyond_the_joint_range_is_drawn_where_it_is(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    q = moving.q.copy()
    q[:, 1] = crane.upper[1] + 3.0
    path = record(tmp_path / "far.rrd", [Run("far", crane, replace(moving, q=q))], title="Far")
    position = poses(path, 0)["far: trolley_link"][:3, 3]
    assert_allclose(np.hypot(*position[:2]), crane.upper[1] + 3.0, atol=FLOAT32)


def test_the_cable_runs_from_pivot_to_payload_25_times_a_second(
    file: Path, crane: Crane, moving: Trajectory
) -> None:
    times, ends = rows(file, "/scene/cable", "LineStrips3D:strips")
    assert_array_equal(times, np.arange(101) * 40_000_000)
    q = moving.q[::8]
    assert_allclose(np.linalg.norm(ends[:, 3:] - ends[:, :3], axis=1), q[:, 4], atol=FLOAT32)
    assert_allclose(ends[:, :3], [pivot_position(crane, row) for row in q], atol=FLOAT32)


def test_the_outline_hangs_at_rest_at_the_setpoint_of_the_drives(
    file: Path, moving: Trajectory
) -> None:
    times, position = rows(file, "/joints/setpoint", "Transform3D:translation")
    gamma, x, length = moving.setpoint[np.searchsorted(moving.t, 1e-9 * times - 1e-9)].T
    expected = np.stack([x * np.sin(gamma), -x * np.cos(gamma), 28.0 - length], axis=1)
    assert_allclose(position, expected, atol=FLOAT32)


def test_a_constant_setpoint_takes_no_rows(crane: Crane, tmp_path: Path) -> None:
    reference = pulse(crane, hold(crane), "x", 0.5, at=0.197, width=0.4)
    still = simulate(crane, hold_controller(crane), reference, duration=1.0)
    path = record(tmp_path / "still.rrd", [Run("still", crane, still)], title="Still")
    times, _ = rows(path, "/joints/setpoint", "Transform3D:translation")
    assert_array_equal(times, [0, 200_000_000, 600_000_000])


def test_the_path_holds_the_last_four_seconds_of_the_payload(
    file: Path, crane: Crane, moving: Trajectory
) -> None:
    times, points = rows(file, "/scene/path", "Points3D:positions")
    assert_array_equal(times, np.arange(41) * 100_000_000)
    last = points[-1].reshape(-1, 3)
    assert_allclose(last[0], payload_position(crane, moving.q[-1]), atol=FLOAT32)
    assert_allclose(last[39], payload_position(crane, moving.q[20]), atol=FLOAT32)


def test_the_arrows_point_where_the_load_hangs_off_the_plumb_line(
    file: Path, crane: Crane, moving: Trajectory
) -> None:
    _, vectors = rows(file, "/scene/swing", "Arrows3D:vectors")
    for row in (25, 50, 75, 100):
        q = moving.q[8 * row]
        arrows = vectors[row].reshape(2, 3)
        deviation = payload_position(crane, q) - pivot_position(crane, q)
        deviation = Rotation.from_euler("z", -q[0]).apply(deviation)[:2]
        shown = np.array([arrows[1, 0], arrows[0, 1]])
        assert (np.abs(deviation) > 1e-3).all()
        assert_array_equal(np.sign(shown), np.sign(deviation))
        assert_allclose(np.abs(shown), 0.5 * np.degrees(np.abs(q[[3, 2]])), rtol=1e-6)


def test_a_crane_without_visuals_still_shows_a_payload(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    urdf = re.sub(r"<visual>.*?</visual>", "", crane.urdf, flags=re.DOTALL)
    bare = replace(crane, urdf_source=lambda: urdf)
    path = record(tmp_path / "bare.rrd", [Run("bare", bare, moving)], title="Bare")
    boxes = {entity for entity, batch in chunks(path) if "Boxes3D:half_sizes" in batch.schema.names}
    assert boxes == {"/bare/scene/hook_link/box", "/bare/scene/setpoint/box"}


@pytest.mark.slow
def test_two_runs_share_the_clock_but_neither_a_frame_nor_an_entity(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    runs = [Run("one / two", crane, moving), Run("three", crane, moving.since(2.0))]
    path = record(tmp_path / "two.rrd", runs, title="Two")
    batches = list(chunks(path))
    frames = [
        set(batch["Transform3D:child_frame"].flatten().to_pylist())
        for _, batch in batches
        if "Transform3D:child_frame" in batch.schema.names
    ]
    assert len(frames) == 2 * 9 and len(set.union(*frames)) == len(frames)
    roots = {entity.split("/")[1] for entity, b in batches if "sim_time" in b.schema.names}
    assert len(roots) == 3 and {"three", "readout"} < roots
    assert numbers(path, "three")[0][0] == 2_000_000_000


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_seventy_seconds_take_less_than_two_megabytes_and_a_second(
    crane: Crane, tmp_path: Path
) -> None:
    long = moved(crane, 70.0, 1.2, -3.0)
    durations = []
    for _ in range(3):
        before = process_time()
        path = record(tmp_path / "long.rrd", [Run("long", crane, long)], title="Long")
        durations.append(process_time() - before)
    assert len(long) == 14001 and path.stat().st_size < 2e6 and min(durations) < 1.0


def test_a_single_row_is_a_recording(crane: Crane, moving: Trajectory, tmp_path: Path) -> None:
    path = record(tmp_path / "row.rrd", [Run("row", crane, moving.since(SHORT))], title="Row")
    assert numbers(path)[0].tolist() == [4_000_000_000]


@pytest.mark.parametrize("name", ["missing/a.rrd", "a.txt", "folder.rrd"])
def test_a_path_that_cannot_be_written_leaves_nothing(
    crane: Crane, moving: Trajectory, tmp_path: Path, name: str
) -> None:
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(DataError, match="Cannot write"):
        record(tmp_path / name, [Run("run", crane, moving)], title="Nowhere")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.rrd"]


@pytest.mark.slow
def test_a_full_disk_leaves_the_recording_that_was_there(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    path = record(tmp_path / "a.rrd", [Run("run", crane, moving)], title="First")
    before = path.read_bytes()
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(DataError, match="Cannot write"):
            record(path, [Run("run", crane, moving)], title="Second")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_runs_without_distinct_names_rows_or_finite_values_are_refused(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    path = tmp_path / "a.rrd"
    run = Run("run", crane, moving)
    broken = replace(moving, dissipated=np.where(moving.t > 1.0, np.nan, moving.dissipated))
    empty = moving.since(SHORT + 1.0)
    for runs in (
        [],
        [run, run],
        [replace(run, name="")],
        [replace(run, trajectory=empty)],
        [replace(run, trajectory=broken)],
    ):
        with pytest.raises(OutOfRange):
            record(path, runs, title="Refused")
    assert not path.exists()


def test_rerun_switched_off_in_the_environment_is_an_error(
    crane: Crane, moving: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(CraneError, match="RERUN"):
        record(tmp_path / "a.rrd", [Run("run", crane, moving)], title="Off")


def test_nothing_outside_the_recording_folder_imports_rerun() -> None:
    for path in [*ROOT.glob("cranedyn/**/*.py"), *ROOT.glob("experiments/**/*.py")]:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        if path.parent.name != "recording":
            assert not any(line.startswith(("import rerun", "from rerun")) for line in lines), path


@pytest.mark.slow
def test_a_recording_that_is_interrupted_prints_nothing_of_its_own(tmp_path: Path) -> None:
    done = python(
        """
import importlib, sys
record = importlib.import_module("cranedyn.recording.recorder")
def interrupted(*_):
    raise KeyboardInterrupt
record.log_series = interrupted
from cranedyn.controllers import hold_controller
from cranedyn.model.load import load_crane
from cranedyn.recording import Run
from cranedyn.simulation.simulate import simulate
crane = load_crane()
try:
    run = simulate(crane, hold_controller(crane), duration=0.02)
    record.record(sys.argv[1], [Run("a", crane, run)], title="t")
except KeyboardInterrupt:
    print("interrupted")
""",
        tmp_path / "a.rrd",
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
    assert files(tmp_path) == []


def test_two_falls_are_drawn_from_the_pivot_to_the_load_and_turn_with_it() -> None:
    c = load_crane(fall_spacing=2.0)
    line = rope_line(c, c.state(phi=0.3, load_yaw=0.5, l=8.0).q[None])[0]
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    fall = np.sqrt(8.0**2 + 2.0 * (1.0 - np.cos(0.5)))  # the lift is not drawn
    np.testing.assert_allclose(lengths, [1.0, fall, 2.0, fall, 1.0, 0.0], atol=1e-12)


@pytest.mark.slow
def test_a_slack_rope_sags_between_the_same_ends_as_long_as_it_is() -> None:
    slack = load_crane(rope_stiffness=np.inf)
    q = np.array([slack.state(phi=0.3, rope_stretch=by).q for by in (0.0, -0.2, -1.0)])
    cable = rope_line(slack, q)
    straight = rope_line(load_crane(), q[:, :5])
    np.testing.assert_allclose(cable[0, [0, -1]], straight[0], atol=1e-12)
    lengths = np.linalg.norm(np.diff(cable, axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(lengths, 15.0, rtol=5e-3)  # of the parabola's series, and 8 chords
    pictures = [Projection(slack).rope(row) for row in q]
    assert [len(picture) for picture in pictures] == [9, 9, 9]
    # a straight rope has even steps
    bent = [np.ptp(np.diff(picture[:, 0])) for picture in pictures]
    assert bent[0] < 1e-9 < 0.1 < bent[1] < bent[2]


@pytest.mark.slow
def test_a_load_that_stands_has_marks_at_its_lowest_corners_until_it_is_lifted(
    tmp_path: Path,
) -> None:
    tower = load_crane(**box_load(1000.0, 1.0, 2.0, 1.0), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(1.0, 2.0, 1.0))
    run = simulate(
        tower,
        lambda t, state, setpoint: np.array([0.0, 0.0, -2.0]),
        start=standing(tower, ground, tower.state(l=26.98)),
        duration=0.5,
        drive="motion",
        ground=ground,
    )
    marks = touching_points(tower, run, 0)
    assert marks.shape == (4, 3)
    np.testing.assert_allclose(marks[:, 2], -ground.sink, atol=1e-9)
    assert np.unique(marks[:, :2], axis=0).shape == (4, 2)
    assert touching_points(tower, run, len(run) - 1).shape == (0, 3)
    file = record(tmp_path / "stands.rrd", [Run("stands", tower, run)], title="Stands")
    (sent,) = (
        batch["Points3D:positions"]
        for entity, batch in chunks(file)
        if entity.endswith("/scene/contact") and "sim_time" in batch.schema.names
    )
    assert [len(points) for points in sent.to_pylist()][:: len(sent) - 1] == [4, 0]
