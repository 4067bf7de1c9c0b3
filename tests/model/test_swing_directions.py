"""Which way a positive swing angle moves the load, and what is said of a swing that was added."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.gantry import GANTRY
from tests.helpers import ROOT
from tests.model.test_hanging import ECCENTRIC, LUFFING


def gantry(folder: Path, text: str = GANTRY, **swing: float) -> Crane:
    """Load the gantry crane from a new file, with a swing."""
    path = folder / "gantry.urdf"
    path.write_text(text)
    return load_crane(path, swing=swing or True)


def test_each_swing_says_which_way_it_moves_the_load_of_a_gantry(tmp_path: Path) -> None:
    crane = gantry(tmp_path)
    assert crane.swing_directions == (
        "phi > 0 moves the load towards +Y, where portal increases.",
        "theta > 0 moves the load towards -X, where cross decreases.",
    )
    for sentence in crane.swing_directions:
        assert f"\n{sentence}\n" in repr(crane)


def test_drives_that_count_the_other_way_are_named_so(tmp_path: Path) -> None:
    text = GANTRY.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>')
    phi, _ = gantry(tmp_path, text).swing_directions
    assert phi == "phi > 0 moves the load towards +Y, where portal decreases."


def test_a_swing_of_the_tower_crane_is_a_lag_and_turns_with_the_slew() -> None:
    phi, theta = load_crane().swing_directions
    assert phi.endswith("at the start, where x decreases.")
    assert theta.endswith("at the start, where gamma decreases.")


@pytest.mark.parametrize("text", [LUFFING, ECCENTRIC, None], ids=["luffing", "eccentric", "bridge"])
def test_the_directions_are_those_of_the_load_by_differences(
    text: str | None, tmp_path: Path
) -> None:
    path = ROOT / "urdf" / "overhead_crane.urdf.xacro"
    if text is not None:
        path = tmp_path / "crane.urdf"
        path.write_text(text)
    crane = load_crane(path)
    assert len(crane.swing_directions) == len(crane.swings)
    for i, sentence in zip(crane.swings.tolist(), crane.swing_directions, strict=True):
        step = np.zeros(crane.layout.n)
        step[i] = 1e-6
        moved = payload_position(crane, crane.start.q + step)
        moved = moved - payload_position(crane, crane.start.q - step)
        words = re.match(r"(\w+) > 0 moves the load towards ([+-])([XYZ])", sentence)
        assert words is not None
        assert words[1] == crane.layout.joints[i].symbol
        axis = "XYZ".index(words[3])
        assert axis == np.argmax(np.abs(moved))
        assert words[2] == ("+" if moved[axis] > 0.0 else "-")


@pytest.mark.parametrize(("drive", "swing"), [("portal", "phi"), ("cross", "theta")])
def test_a_swing_leads_the_drive_that_increases_where_it_is_said_to(
    drive: str, swing: str, tmp_path: Path
) -> None:
    crane = gantry(tmp_path)
    (sentence,) = [text for text in crane.swing_directions if text.startswith(swing)]
    leads = sentence.endswith(f"where {drive} increases.")
    assert leads is (drive == "portal")
    acceleration = 0.1 * crane.layout.along(drive)
    run = simulate(crane, lambda *_: acceleration, duration=1.0, drive="motion")
    # The pivot accelerates and leaves the load behind.
    assert bool(run.q[-1, crane.layout.index(swing)] < 0.0) is leads


def test_a_crane_that_does_not_swing_has_no_directions(tmp_path: Path) -> None:
    (tmp_path / "gantry.urdf").write_text(GANTRY)
    assert load_crane(tmp_path / "gantry.urdf").swing_directions == ()


def test_another_mass_of_the_load_is_told_with_its_inertia(tmp_path: Path) -> None:
    crane = gantry(tmp_path, mass=1500.0)
    sentence = (
        "The load has 1500 kg in place of the 300 kg of the file, and its rotational inertias are "
        "those of the file times 5."
    )
    assert sentence in crane.assumptions
    assert crane.model.inertias[-1].inertia[0, 0] == pytest.approx(5.0 * 20.0, rel=1e-12)
    assert not any("in place of" in text for text in gantry(tmp_path, mass=300.0).assumptions)


def test_a_start_that_is_moved_into_the_range_is_told(tmp_path: Path) -> None:
    moved = gantry(tmp_path, length=1.9)  # the hook of the file would be above the pivot
    (sentence,) = [text for text in moved.assumptions if "starts at" in text]
    start = moved.start.q[moved.layout.index("l")]
    assert sentence.startswith(f"lift_joint starts at {start:.3g}, since its start in the file")
    assert "which is -0.1 here" in sentence
    assert not any("starts at" in text for text in gantry(tmp_path).assumptions)
