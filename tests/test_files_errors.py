"""Files are whole or not there; what goes wrong is one sentence that carries its numbers."""

from __future__ import annotations

import errno
import math
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import CraneError, DataError, OutOfRange, RunError, UnknownName, number, within
from cranedyn.figures import panels, save
from cranedyn.files import written
from tests.helpers import files

# --- files -------------------------------------------------------------------------------------------------------------------------


def test_a_file_appears_only_when_it_is_whole(tmp_path: Path) -> None:
    final = tmp_path / "a.csv"
    with written(final) as draft:
        draft.write_text("half")
        assert not final.exists()
        assert draft.parent == tmp_path  # beside, so that the renaming is one step
        assert draft.suffix == ".csv"  # writers choose the format by it
        draft.write_text("whole")
    assert final.read_text() == "whole"
    assert files(tmp_path) == ["a.csv"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, CraneError])
def test_nothing_is_left_behind_when_writing_breaks_off(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "a.csv").write_text("old")
    with pytest.raises(error), written(tmp_path / "a.csv") as draft:
        draft.write_text("half")
        raise error("stop")
    assert files(tmp_path) == ["a.csv"]
    assert (tmp_path / "a.csv").read_text() == "old"


def test_a_full_disk_is_a_sentence_and_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"Cannot write .*a.csv: No space left on device\."), written(tmp_path / "a.csv") as draft:
        draft.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert files(tmp_path) == []


def test_a_missing_folder_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"Cannot write .*: the folder .*missing does not exist"), written(tmp_path / "missing" / "a.csv"):
        pytest.fail("must not get here")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(DataError, match="it is a folder"), written(tmp_path / "a.csv"):
        pytest.fail("must not get here")


def test_a_figure_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    figure, axes = panels(2, 2)
    assert len(axes) == 4
    axes[0].plot([0, 1], [0, 1])
    assert save(figure, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(DataError, match="does not exist"):
        save(figure, tmp_path / "missing" / "a.png")
    assert files(tmp_path) == ["a.png"]


# --- numbers -----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "allowed", "result"),
    [
        (1, "any", 1.0),
        ("-2.5e3", "any", -2500.0),
        (0, ">= 0", 0.0),
        (1e-300, "> 0", 1e-300),
        (3, "3 to 4", 3.0),
        (np.float64(4), "3 to 4", 4.0),
    ],
)
def test_a_number_in_its_range_is_handed_back_as_a_float(value: object, allowed: str, result: float) -> None:
    found = number("n", value, "m", allowed)
    assert (type(found), found) == (float, result)


@pytest.mark.parametrize(
    ("value", "allowed", "sentence"),
    [
        (math.nan, "any", "n is nan m; allowed is a finite number."),
        (-math.inf, "any", "n is -inf m; allowed is a finite number."),
        (math.nan, "> 0", "n is nan m; allowed is > 0."),
        (0.0, "> 0", "n is 0.0 m; allowed is > 0."),
        (-1e-9, ">= 0", "n is -1e-09 m; allowed is >= 0."),
        (math.inf, ">= 0", "n is inf m; allowed is >= 0."),
        (2.999, "3 to 4", "n is 2.999 m; allowed is 3 to 4."),
        (-4, "-3 to -1", "n is -4 m; allowed is -3 to -1."),
        ("many", "> 0", "n is many m; allowed is a number > 0."),
        (None, "any", "n is None m; allowed is a number."),
    ],
)
def test_a_number_out_of_its_range_is_refused_with_value_unit_and_range(value: object, allowed: str, sentence: str) -> None:
    with pytest.raises(OutOfRange) as caught:
        number("n", value, "m", allowed)
    assert str(caught.value) == sentence
    assert (caught.value.name, caught.value.unit) == ("n", "m")
    assert caught.value.value is value


def test_a_number_between_two_is_handed_back_and_any_other_refused_to_the_last_digit() -> None:
    low, high = 0.1, 2 / 3
    assert [within("n", x, low, high) for x in (low, "0.2", high)] == [low, 0.2, high]
    for x, allowed in (
        (0.0, "0.1 to 0.666667"),
        (math.nextafter(high, 1.0), "0.1 to 0.6666666666666666"),
        (math.nan, "a finite number"),
    ):
        with pytest.raises(OutOfRange) as caught:
            within("n", x, low, high, "m")
        assert str(caught.value) == f"n is {x} m; allowed is {allowed}."


# --- errors ------------------------------------------------------------------------------------------------------------------------


def test_every_error_is_a_crane_error_that_carries_its_values() -> None:
    unknown = UnknownName("drive", "y", ["x", "l"])
    assert str(unknown) == "There is no drive 'y'; there are x, l."
    assert (unknown.given, unknown.known) == ("y", ("x", "l"))
    broken = RunError("It broke.", t=1.5, joint="yaw_joint", value=7.0)
    assert (str(broken), broken.t, broken.joint, broken.value, broken.trajectory) == ("It broke.", 1.5, "yaw_joint", 7.0, None)
    for error in (unknown, broken, OutOfRange("a", 1, "> 2"), DataError("x")):
        assert isinstance(error, CraneError)
