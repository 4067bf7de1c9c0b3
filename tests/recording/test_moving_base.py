"""Recordings of cranes on a base that moves."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.recording.contents import Run
from cranedyn.recording.recorder import record
from tests.helpers import crane, quickly
from tests.rrd import numbers, poses, rows

BASE = BaseMotion.sines(heave=(1.0, 4.0, 0.3), roll=(0.08, 5.0, 0.2), yaw=(0.2, 6.0, 1.0))


@cache
def voyage() -> Run:
    one = crane()
    run = quickly(one, hold_controller(one), duration=2.0, base=BASE)
    return Run("ship", one, run, offset=(20.0, -5.0, 0.0), heading=0.7)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("base") / "base.rrd"
    return record(path, [voyage()], title="On a ship")


def load_in_world(row: int) -> np.ndarray:
    run = voyage().trajectory
    frames = BASE.frames(run.t[[row]])
    on_base = payload_position(crane(), run.q[row])
    return voyage().to_scene(frames.origin[0] + frames.rotation[0] @ on_base)


def test_the_crane_moves_with_its_base_and_its_path_stays_in_the_world(file: Path) -> None:
    row = 200
    time = round(1e9 * float(voyage().trajectory.t[row]))
    # The link of the hook is that of the load; Rerun keeps single precision.
    pose = poses(file, time)["ship: hook_link"]
    assert_allclose(pose[:3, 3], load_in_world(row), atol=2e-5)
    times, path = rows(file, "/scene/path", "Points3D:positions")
    newest = path.reshape(len(times), -1, 3)[-1, 0]
    world = poses(file, 0)["ship: world below the base"]
    assert_allclose(world[:3, :3] @ newest + world[:3, 3], load_in_world(-1), atol=2e-5)


def test_the_coordinates_of_the_base_are_recorded_with_angles_in_degrees(file: Path) -> None:
    times, columns = numbers(file)
    assert_allclose(columns["base_heave_m"], np.sin(2 * np.pi * times / 4e9 + 0.3), atol=1e-6)
    roll = np.degrees(0.08 * np.sin(2 * np.pi * times / 5e9 + 0.2))
    assert_allclose(columns["base_roll_deg"], roll, atol=1e-5)
    assert "W_base_J" in columns
