"""Pictures of recordings: what can be seen on them, counted in pixels."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.plotting.style import COLOURS
from cranedyn.recording import Run, record
from cranedyn.recording.snapshot import animate, snapshot
from cranedyn.references import hold, pulse
from cranedyn.simulation.simulate import simulate
from experiments.snapshot import main
from tests.next_commands import check_next_commands

drivers = (
    "VK_ICD_FILENAMES" in os.environ
    or "VK_DRIVER_FILES" in os.environ
    or any(Path("/usr/share/vulkan/icd.d").glob("*.json"))
)
drawn = pytest.mark.skipif(
    not drivers, reason="no Vulkan driver to draw with (Debian: mesa-vulkan-drivers)"
)

SIZE = (640, 480)


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load_crane()


@pytest.fixture(scope="module")
def moving(crane: Crane) -> Trajectory:
    """The trolley goes out by 4 m at once; at 3 s the load has followed."""
    out = pulse(crane, hold(crane), "x", 4.0, at=0.5, width=10.0)
    return simulate(crane, hold_controller(crane), out, duration=4.0)


@pytest.fixture(scope="module")
def file(crane: Crane, moving: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = Run("out", crane, moving, (0.0, 8.0, 2.0))
    return record(tmp_path_factory.mktemp("snapshot") / "out.rrd", [run], title="Out")


@pytest.fixture(scope="module")
def scenes(file: Path, tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """The scene at 0 and at 3 s, shape (height, width, 3)."""
    folder = tmp_path_factory.mktemp("scenes")
    paths = snapshot(file, [0.0, 3.0], folder, size=SIZE, dashboard=False)
    assert [path.name for path in paths] == ["out-0s.png", "out-3s.png"]
    return [pixels(path) for path in paths]


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def steel(picture: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(picture, -1, 0)
    return (red > 120) & (green > 0.4 * red) & (green < 0.75 * red) & (blue < 0.25 * red)


def load(picture: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(picture, -1, 0)
    return (red > 120) & (green < 0.3 * red) & (blue < 0.3 * red)


def like(picture: np.ndarray, colour: str) -> int:
    """Number of pixels of almost a colour."""
    off = np.abs(picture - list(bytes.fromhex(colour[1:]))).max(axis=-1)
    return int(np.count_nonzero(off <= 12))


@drawn
def test_the_scene_shows_crane_and_load_before_a_light_sky(scenes: list[np.ndarray]):
    for picture in scenes:
        assert picture.shape == (SIZE[1], SIZE[0], 3)
        assert np.count_nonzero(steel(picture)) > 2000
        assert 200 < np.count_nonzero(load(picture)) < 3000
        assert like(picture, "#E1E8F0") > 50_000


@drawn
def test_the_load_is_seen_to_go_out_with_the_trolley(scenes: list[np.ndarray]):
    before, after = (np.argwhere(load(picture)).mean(axis=0) for picture in scenes)
    # pixels to the left; 4 m are an eighth of the crane's width
    assert 40 < before[1] - after[1] < 120
    assert abs(before[0] - after[0]) < 15


@drawn
def test_the_cable_is_seen_all_the_way_from_trolley_to_load(scenes: list[np.ndarray]):
    picture = scenes[0]
    where = np.argwhere(load(scenes[0]))
    top = where[:, 0].min()
    middle = round(where[:, 1].mean())
    beside = picture[top - 120 : top - 30, middle - 10 : middle + 10]
    assert (beside.max(axis=-1).min(axis=1) < 110).all()


@pytest.mark.slow
@drawn
def test_the_dashboard_shows_scene_and_curves(file: Path, tmp_path: Path):
    (path,) = snapshot(file, [3.0], tmp_path, size=(1280, 720))
    picture = pixels(path)
    assert picture.shape == (720, 1280, 3)
    left = picture[:, :700]
    right = picture[:, 720:]
    for name in ("x", "phi", "energy", "theta"):
        assert like(right, COLOURS[name]) > 100, f"curves of the colour of {name}"
    assert np.count_nonzero(steel(left)) > 2000
    assert np.count_nonzero(load(left)) > 200


@pytest.mark.slow
@drawn
def test_a_second_crane_in_the_same_place_has_a_load_of_another_colour(
    crane: Crane, moving: Trajectory, tmp_path: Path
):
    still = simulate(crane, hold_controller(crane), duration=4.0)
    runs = [Run("out", crane, moving), Run("still", crane, still)]
    path = record(tmp_path / "two.rrd", runs, title="Two")
    picture = pixels(snapshot(path, [3.0], tmp_path, size=SIZE, dashboard=False)[0])
    red, _, blue = np.moveaxis(picture, -1, 0)
    second = (blue > 80) & (red < 0.3 * blue)
    assert np.count_nonzero(load(picture)) > 200
    assert np.count_nonzero(second) > 200
    assert np.argwhere(second)[:, 1].mean() - np.argwhere(load(picture))[:, 1].mean() > 40


@pytest.mark.slow
@drawn
def test_a_gif_lasts_as_long_as_its_span_and_moves(file: Path, tmp_path: Path):
    seen: list[int] = []
    target = tmp_path / "out.gif"
    size = (320, 240)
    path = animate(file, (0.0, 2.0), target, fps=5.0, size=size, progress=seen.append)
    image = Image.open(path)
    frames = []
    durations = []
    for k in range(image.n_frames):
        image.seek(k)
        frames.append(np.asarray(image.convert("RGB")).astype(int))
        durations.append(image.info["duration"])
    assert image.size == size
    assert sum(durations) == 2200
    assert seen == list(range(1, 12))
    assert np.count_nonzero(load(frames[0]) != load(frames[-1])) > 50


@pytest.mark.slow
@drawn
def test_a_time_outside_of_the_recording_leaves_neither_a_picture_nor_a_viewer(
    file: Path, tmp_path: Path
):
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with pytest.raises(OutOfRange, match="0 to 4"):
        snapshot(file, [1.0, 4.5], tmp_path)
    assert not list(tmp_path.iterdir())
    snapshot(file, [0.0], tmp_path, size=SIZE)
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before


@pytest.mark.slow
@drawn
def test_a_file_that_only_begins_like_a_recording_is_refused(file: Path, tmp_path: Path):
    broken = tmp_path / "broken.rrd"
    broken.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(DataError, match="sim_time"):
        snapshot(broken, [0.0], tmp_path)


def test_without_a_driver_the_package_to_install_is_named(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("VK_ICD_FILENAMES", str(tmp_path / "none.json"))
    with pytest.raises(CraneError, match="mesa-vulkan-drivers"):
        snapshot(file, [0.0], tmp_path)


@pytest.mark.slow
@drawn
def test_the_command_writes_what_it_names(
    file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    gif = tmp_path / "a.gif"
    pictures = ["-t", "0", "2.5", "-o", str(tmp_path / "new"), "--gif", "0", "0.3", str(gif)]
    assert main([str(file), *pictures, "--view", "3d", "--size", "320", "240"]) == 0
    text = capsys.readouterr().out
    named = [Path(name) for name in re.findall(r"^Written to (.+)\.$", text, re.MULTILINE)]
    assert [path.name for path in named] == ["out-0s.png", "out-2.5s.png", "a.gif"]
    assert all(path.is_file() for path in named)
    check_next_commands(text, monkeypatch)
