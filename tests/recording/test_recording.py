"""What stands in a recording, checked against the trajectory and the dynamics it was made from."""

from __future__ import annotations

import os
import re
import resource
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.pinocchio import payload_position, pivot_position
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.plotting.style import COLOURS
from cranedyn.recording import Run, open_viewer, record, serve
from cranedyn.recording.series import plots
from cranedyn.references import hold, pulse, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, files, python
from tests.rrd import chunks, numbers, rows

pytestmark = pytest.mark.filterwarnings("error:::rerun")

FLOAT32 = 3e-5
"""[m] Half a unit in the last place of a 32-bit float at 50 m is 2e-6 m; six frames add up a few,
and their angles act over 20 m."""

SHORT = 4.0


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load_crane()


@pytest.fixture(scope="module")
def moving(crane: Crane) -> Trajectory:
    """All three drives move and the load swings both ways."""
    reference = pulse(crane, hold(crane), "x", 1.0, at=0.5, width=2.0)
    reference = ramp(
        crane, ramp(crane, reference, "gamma", 0.3, rate=0.2, at=0.5), "l", -2.0, rate=1.0, at=1.0
    )
    return simulate(crane, hold_controller(crane), reference, duration=SHORT)


@pytest.fixture(scope="module")
def file(crane: Crane, moving: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "moving.rrd"
    return record(
        path,
        [Run("all drives", crane, moving, (5.0, -3.0, 1.0))],
        title="A title",
        text="Some *claim*.",
    )


def test_every_number_comes_back_to_the_bit(file: Path, crane: Crane, moving: Trajectory):
    times, columns = numbers(file)
    expected = {"energy_J": moving.energy - moving.energy[0], "unexplained_J": moving.unexplained}
    for name in (
        name
        for key in ("q", "v", "setpoint", "effort", "work", "dissipated")
        for name in moving.columns[key]
    ):
        expected[name.replace("_rad", "_deg")] = (
            np.degrees(moving[name]) if "_rad" in name else moving[name]
        )
    for name, limit in zip(("T_gamma_Nm", "F_x_N", "F_l_N"), crane.effort_limit, strict=True):
        expected |= {
            f"{name}_upper": np.full(len(moving), limit),
            f"{name}_lower": np.full(len(moving), -limit),
        }
    assert columns.keys() == expected.keys()
    for name, values in expected.items():
        assert columns[name].dtype == np.float64 and columns[name].tobytes() == values.tobytes(), (
            name
        )
    np.testing.assert_array_equal(times, np.arange(len(moving)) * 5_000_000)


def test_every_curve_has_a_column_and_every_quantity_a_colour_of_its_own(file: Path, crane: Crane):
    columns = numbers(file)[1]
    for plot in plots(crane.layout).values():
        for curve in plot.curves:
            assert curve.column in columns and curve.quantity in COLOURS
    quantities = (
        "gamma",
        "x",
        "phi",
        "theta",
        "l",
        "energy",
        "dissipated",
        "unexplained",
        "setpoint",
    )
    assert len({COLOURS[name] for name in quantities}) == len(quantities)


def chained(path: Path, row: int) -> dict[str, np.ndarray]:
    """Where every frame stands in the scene at a row of the pictures, 4 x 4, from the transforms in
    the file alone.
    """
    from scipy.spatial.transform import Rotation

    steps = {}
    for _, batch in chunks(path):
        if "Transform3D:child_frame" not in batch.schema.names:
            continue
        k = min(row, batch.num_rows - 1)
        step = np.eye(4)
        if "Transform3D:quaternion" in batch.schema.names:
            step[:3, :3] = Rotation.from_quat(
                batch["Transform3D:quaternion"][k].as_py()[0]
            ).as_matrix()
        step[:3, 3] = batch["Transform3D:translation"][k].as_py()[0]
        steps[batch["Transform3D:child_frame"][k].as_py()[0]] = (
            batch["Transform3D:parent_frame"][k].as_py()[0],
            step,
        )

    def setup(frame: str) -> np.ndarray:
        return np.eye(4) if frame == "tf#/" else setup(steps[frame][0]) @ steps[frame][1]

    return {frame: setup(frame) for frame in steps}


@pytest.mark.parametrize("row", [0, 77, 200])
def test_the_frames_in_the_file_put_payload_and_trolley_where_the_dynamics_say(
    file: Path, crane: Crane, moving: Trajectory, row: int
):
    frames, q, offset = chained(file, row), moving.q[4 * row], np.array([5.0, -3.0, 1.0])
    np.testing.assert_allclose(
        frames["all drives: hook_link"][:3, 3], payload_position(crane, q) + offset, atol=FLOAT32
    )
    np.testing.assert_allclose(
        frames["all drives: trolley_link"][:3, 3], pivot_position(crane, q) + offset, atol=FLOAT32
    )


def test_all_that_is_drawn_stands_in_a_frame_of_its_run(file: Path):
    frames, drawn = {}, set()
    for entity, batch in chunks(file):
        name = entity.partition("/scene/")[2]
        drawn |= {name} if name else set()
        if "CoordinateFrame:frame" in batch.schema.names:
            frames[name] = batch["CoordinateFrame:frame"].flatten()[0].as_py()
    assert frames.keys() == drawn and set(frames.values()) <= chained(file, 0).keys()
    assert {frames[name] for name in ("cable", "path", "setpoint/cable")} == {"all drives: world"}


def test_a_position_beyond_the_joint_range_is_drawn_where_it_is(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    q = moving.q.copy()
    q[:, 1] = crane.upper[1] + 3.0
    path = record(tmp_path / "far.rrd", [Run("far", crane, replace(moving, q=q))], title="Far")
    position = chained(path, 0)["far: trolley_link"][:3, 3]
    np.testing.assert_allclose(np.hypot(*position[:2]), crane.upper[1] + 3.0, atol=FLOAT32)


def test_the_cable_runs_from_pivot_to_payload_fifty_times_a_second(
    file: Path, crane: Crane, moving: Trajectory
):
    times, ends = rows(file, "/scene/cable", "LineStrips3D:strips")
    np.testing.assert_array_equal(times, np.arange(201) * 20_000_000)
    q = moving.q[::4]
    np.testing.assert_allclose(
        np.linalg.norm(ends[:, 3:] - ends[:, :3], axis=1), q[:, 4], atol=FLOAT32
    )
    np.testing.assert_allclose(ends[:, :3], [pivot_position(crane, row) for row in q], atol=FLOAT32)


def test_the_outline_hangs_at_rest_where_the_drives_are_wanted(file: Path, moving: Trajectory):
    times, position = rows(file, "/joints/setpoint", "Transform3D:translation")
    gamma, x, length = moving.setpoint[np.searchsorted(moving.t, 1e-9 * times - 1e-9)].T
    np.testing.assert_allclose(
        position,
        np.stack([x * np.sin(gamma), -x * np.cos(gamma), 28.0 - length], axis=1),
        atol=FLOAT32,
    )


def test_a_crane_without_visuals_still_shows_a_payload(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    import re

    text = re.sub(r"<visual>.*?</visual>", "", crane.urdf, flags=re.DOTALL).replace(
        "hook_link", "ball"
    )
    bare = replace(crane, urdf_source=lambda: text)
    path = record(tmp_path / "bare.rrd", [Run("bare", bare, moving)], title="Bare")
    boxes = {
        entity: batch["Boxes3D:half_sizes"].flatten()
        for entity, batch in chunks(path)
        if "Boxes3D:half_sizes" in batch.schema.names
    }
    assert boxes.keys() == {"/bare/scene/ball/box", "/bare/scene/setpoint/box"}


def test_what_is_setpoint_takes_no_rows_while_it_does_not_change(crane: Crane, tmp_path: Path):
    still = simulate(
        crane,
        hold_controller(crane),
        pulse(crane, hold(crane), "x", 0.5, at=0.197, width=0.4),
        duration=1.0,
    )
    path = record(tmp_path / "still.rrd", [Run("still", crane, still)], title="Still")
    times, _ = rows(path, "/joints/setpoint", "Transform3D:translation")
    np.testing.assert_array_equal(times, [0, 200_000_000, 600_000_000])


def test_the_path_holds_the_last_four_seconds_of_the_payload(
    file: Path, crane: Crane, moving: Trajectory
):
    times, points = rows(file, "/scene/path", "Points3D:positions")
    np.testing.assert_array_equal(times, np.arange(41) * 100_000_000)
    last = points[-1].reshape(-1, 3)
    np.testing.assert_allclose(last[0], payload_position(crane, moving.q[-1]), atol=FLOAT32)
    np.testing.assert_allclose(last[39], payload_position(crane, moving.q[20]), atol=FLOAT32)


def test_the_arrows_point_where_the_load_hangs_off_the_plumb_line(
    file: Path, crane: Crane, moving: Trajectory
):
    _, vectors = rows(file, "/scene/swing", "Arrows3D:vectors")
    for row in (50, 100, 150, 200):
        q, arrows = moving.q[4 * row], vectors[row].reshape(2, 3)
        turn = np.array(
            [[np.cos(q[0]), -np.sin(q[0]), 0.0], [np.sin(q[0]), np.cos(q[0]), 0.0], [0.0, 0.0, 1.0]]
        )
        off = turn.T @ (payload_position(crane, q) - pivot_position(crane, q))
        assert abs(off[0]) > 1e-3 and abs(off[1]) > 1e-3
        assert np.sign(arrows[1, 0]) == np.sign(off[0]) and np.sign(arrows[0, 1]) == np.sign(off[1])
        np.testing.assert_allclose(
            np.abs([arrows[0, 1], arrows[1, 0]]), 0.5 * np.degrees(np.abs(q[2:4])), rtol=1e-6
        )


def test_two_runs_share_the_clock_and_neither_a_frame_nor_an_entity(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    path = record(
        tmp_path / "two.rrd",
        [Run("one / two", crane, moving), Run("three", crane, moving.since(2.0))],
        title="Two",
    )
    moved = [
        batch["Transform3D:child_frame"]
        for _, batch in chunks(path)
        if "Transform3D:child_frame" in batch.schema.names
    ]
    frames = [set(column.flatten().to_pylist()) for column in moved]
    assert len(frames) == 2 * 9 and len(set.union(*frames)) == len(frames)
    roots = {entity.split("/")[1] for entity, b in chunks(path) if "sim_time" in b.schema.names}
    assert len(roots) == 2
    assert numbers(path, "three")[0][0] == 2_000_000_000


def test_the_layout_travels_in_the_file(file: Path, crane: Crane):
    from rerun.chunk import RrdReader

    reader = RrdReader(file)
    (layout,), (recording,) = reader.blueprints(), reader.recordings()
    assert layout.application_id == recording.application_id
    names, spans = set(), []
    for chunk in reader.stream(store=layout):
        batch = chunk.to_record_batch()
        if "TimeAxis:view_range" in batch.schema.names:
            spans.append(batch["TimeAxis:view_range"].flatten()[0].as_py())
        if "ViewBlueprint:display_name" in batch.schema.names:
            names |= set(batch["ViewBlueprint:display_name"].flatten().to_pylist())
    assert names == {
        "Crane",
        "Payload",
        "About",
        *(plot.title for plot in plots(crane.layout).values()),
    }
    assert len(spans) == len(plots(crane.layout)) and {
        (span["start"], span["end"]) for span in spans
    } == {(0, 4_000_000_000)}


def test_another_set_of_runs_is_another_application_for_the_viewer(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    from rerun.chunk import RrdReader

    runs = [
        [Run("a", crane, moving)],
        [Run("b", crane, moving)],
        [Run("a", crane, moving, (1.0, 0.0, 0.0))],
    ]
    paths = [
        record(tmp_path / f"{i}.rrd", some, title="Größe: 50 %") for i, some in enumerate(runs)
    ]
    ids = [RrdReader(path).recordings()[0].application_id for path in paths]
    assert len(set(ids)) == 3
    assert all(
        character.isascii() and (character.isalnum() or character == "-")
        for character in "".join(ids)
    )


def test_the_words_hold_title_text_parameters_and_the_scale_of_the_arrows(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    given: dict[str, dict[str, float | str]] = {
        "one": {"gain": 2.5, "kind": "a|b"},
        "two": {"gain": 3.5},
    }
    runs = [Run(name, crane, replace(moving, parameters=values)) for name, values in given.items()]
    path = record(tmp_path / "words.rrd", runs, title="A title", text="Some *claim*.")
    (words,) = (
        b["TextDocument:text"].flatten()[0].as_py()
        for entity, b in chunks(path)
        if entity == "/text"
    )
    for part in ("## A title", "Some *claim*.", "0.5 m for a degree"):
        assert part in words
    for line in ("| parameter | one | two |", "| gain | 2.5 | 3.5 |", "| kind | a\\|b |  |"):
        assert line in words


def test_seventy_seconds_take_less_than_four_megabytes_and_a_second(crane: Crane, tmp_path: Path):
    from time import perf_counter

    reference = pulse(crane, hold(crane), "x", 1.0, at=2.0, width=4.0)
    reference = ramp(
        crane,
        ramp(crane, reference, "gamma", 1.2, rate=0.15, at=10.0),
        "l",
        -3.0,
        rate=0.5,
        at=14.0,
    )
    long = simulate(crane, hold_controller(crane), reference, duration=70.0)
    took = []
    for _ in range(3):
        before = perf_counter()
        path = record(tmp_path / "long.rrd", [Run("long", crane, long)], title="Long")
        took.append(perf_counter() - before)
    assert len(long) == 14001 and path.stat().st_size < 4e6 and min(took) < 1.0


def test_a_single_row_is_a_recording(crane: Crane, moving: Trajectory, tmp_path: Path):
    path = record(tmp_path / "row.rrd", [Run("row", crane, moving.since(SHORT))], title="Row")
    assert numbers(path)[0].tolist() == [4_000_000_000]


@pytest.mark.parametrize("name", ["missing/a.rrd", "a.txt", "folder.rrd"])
def test_a_path_that_cannot_be_written_leaves_nothing(
    crane: Crane, moving: Trajectory, tmp_path: Path, name: str
):
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(DataError, match="Cannot write"):
        record(tmp_path / name, [Run("run", crane, moving)], title="Nowhere")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.rrd"]


def test_a_full_disk_leaves_the_recording_that_was_there(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    path = record(tmp_path / "a.rrd", [Run("run", crane, moving)], title="First")
    before, (_, hard) = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(DataError, match="Cannot write"):
            record(path, [Run("run", crane, moving)], title="Second")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_runs_that_cannot_be_told_apart_or_hold_nothing_are_refused(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    path, run = tmp_path / "a.rrd", Run("run", crane, moving)
    broken = replace(moving, dissipated=np.where(moving.t > 1.0, np.nan, moving.dissipated))
    for runs in (
        [],
        [run, run],
        [Run("", crane, moving)],
        [Run("run", crane, moving.since(SHORT + 1.0))],
        [Run("run", crane, broken)],
    ):
        with pytest.raises(OutOfRange):
            record(path, runs, title="Refused")
    assert not path.exists()


def test_rerun_switched_off_in_the_environment_is_said(
    crane: Crane, moving: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(CraneError, match="RERUN"):
        record(tmp_path / "a.rrd", [Run("run", crane, moving)], title="Off")


def test_nothing_outside_the_recording_folder_imports_rerun():

    for path in [*ROOT.glob("cranedyn/**/*.py"), *ROOT.glob("experiments/**/*.py")]:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        if path.parent.name != "recording":
            assert not any(line.startswith(("import rerun", "from rerun")) for line in lines), path


def test_serving_answers_on_this_machine_alone_and_ends(file: Path):
    with serve(file, port=(port := _pair())) as server:
        assert urllib.request.urlopen(server.address, timeout=10).status == 200
        if sys.platform == "linux":
            listening = [
                line.split()[1]
                for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
                if line.split()[3] == "0A"
            ]
            ours = [
                address
                for address in listening
                if int(address.split(":")[1], 16) in (port, port + 1)
            ]
            assert len(ours) == 2 and all(address.startswith("0100007F:") for address in ours)
        with pytest.raises(CraneError, match=f"Port {port} .* in use"):
            serve(file, port=port)
    assert server.process.poll() is not None
    with pytest.raises(OSError):
        urllib.request.urlopen(server.address, timeout=10)


def test_a_viewer_that_we_start_sends_nothing_and_leaves_the_users_own_setting_alone(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for name in [name for name in os.environ if name == "CI" or name.startswith("XDG_")]:
        monkeypatch.delenv(name)
    # Where Rerun keeps the setting, and what it is about to send.
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    with serve(file, port=_pair()) as server:
        with urllib.request.urlopen(server.address, timeout=10) as page:
            policy = page.headers["Content-Security-Policy"]
            assert b"re_viewer" in page.read()
    allowed = server.data.removeprefix("rerun+").removesuffix("/proxy")
    assert re.findall(r"\w+://[^ ;]*", policy) == [allowed] and "default-src 'self'" in policy
    assert list(tmp_path.iterdir()) == []
    assert "Every program on this machine can read what is served, and add to it." in server.words
    assert server.address in server.words


def _pair() -> int:
    """A port that is free, as is the next."""
    from cranedyn.recording.process import free, free_port

    return next(port for port in iter(free_port, None) if free(port + 1) and port < 65534)


def test_what_is_no_recording_is_neither_served_nor_opened(file: Path, tmp_path: Path):
    old = tmp_path / "old.rrd"
    old.write_bytes(b"RRF2" + bytes([0, 30, 0, 0]) + file.read_bytes()[8:])
    for path, words in (
        (tmp_path / "none.rrd", "Cannot read"),
        (Path(__file__), "not a Rerun recording"),
        (old, "written by Rerun 0.30"),
    ):
        for look in (serve, open_viewer):
            with pytest.raises(DataError, match=words):
                look(path)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_without_a_display_the_viewer_points_to_saving_and_serving(
    file: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(CraneError, match=r"display.*--save.*--serve"):
        open_viewer(file)


def test_a_missing_viewer_is_said_in_a_sentence(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setitem(os.environ, "DISPLAY", ":0")
    for look in (serve, open_viewer):
        with pytest.raises(CraneError, match="not installed"):
            look(file)


def test_a_recording_that_is_interrupted_says_nothing_of_its_own(tmp_path: Path) -> None:
    done = python(
        """
import importlib, sys
record = importlib.import_module("cranedyn.recording.record")
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
