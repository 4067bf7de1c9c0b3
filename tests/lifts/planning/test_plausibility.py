"""Input that cannot be meant is refused with the likely mistake, unusual input is said."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from cranedyn.errors import DataError, OutOfRange
from cranedyn.lifts.planning.plausibility import RATE, WIND, findings, judge_value
from cranedyn.lifts.planning.site_file import EXAMPLES, SITES, read_site

YARD = (SITES / "open_yard.toml").read_text(encoding="utf-8")


def yard(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """Write the open yard with the values of some fields, such as "[load] mass", replaced."""
    text = YARD
    for field, value in changes:
        table, key = re.fullmatch(r"(\[\w+\]) (\w+)", field).groups()  # type: ignore[union-attr]
        pattern = rf"(?ms)^({re.escape(table)}.*?^{key} = ).*?$"
        text, count = re.subn(pattern, rf"\g<1>{value}", text, count=1)
        assert count == 1, field
    path = tmp_path / "yard.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", EXAMPLES)
def test_no_value_of_an_example_is_unusual(name: str) -> None:
    assert read_site(name).unusual == ()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            (("[load] mass", "0.87"),),
            r"\[load\] mass: .*is 0.161111 kg/m³.*Is 0.87 in tonnes\? .*870",
        ),
        ((("[load] size", "[1500.0, 3000.0, 1200.0]"),), r"\[load\] size: .*1,500|millimetres"),
        (
            (("[drives] rates", "[4.8, 95.0, 1.0]"),),
            r"\[drives\] rates: The rate of the trolley is 95 m/s",
        ),
        (
            (("[drives] rates", "[4.8, 95.0, 1.0]"),),
            r"Is 95 in metres per minute\? Then write 1.58333",
        ),
        ((("[drives] rates", "[400.0, 1.5, 1.0]"),), r"The rate of the slew is 400 °/s"),
        ((("[drives] accelerations", "[1.15, 24.0, 0.4]"),), "24 in metres per minute"),
        (
            (("[lift] from", "[6000.0, -14000.0, 3000.0]"),),
            r"\[lift\] from: .*15,232 m.*14,000 in milli",
        ),
        (
            (("[lift] to", "[5.0e6, 4.0e5, 4.0]"),),
            r"\[lift\] to: .*same frame as \[crane\] position",
        ),
        (
            (("[lift] distance", "500.0"),),
            r"\[lift\] distance: .*Is 500 in millimetres\? Then write 0.5",
        ),
        ((("[base] permitted", "400000.0"),), r"\[base\] permitted: .*newtons\? Then write 400"),
        ((("[base] spacing", "4500.0"),), r"\[base\] spacing: .*millimetres"),
        ((("[wind] gust", "120.0"),), r"\[wind\] gust: The gust is 120 m/s"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_line_field_and_the_likely_mistake(
    changes: tuple[tuple[str, str], ...], words: str, tmp_path: Path
) -> None:
    path = yard(tmp_path, *changes)
    with pytest.raises(DataError, match=words) as refused:
        read_site(path)
    assert re.match(rf"{re.escape(str(path))}, line \d+, ", str(refused.value))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ((("[wind] gust", "36.0"),), "Is 36 in kilometres per hour? Then write 10."),
        ((("[lift] swing", "0.035"),), "Is 0.035 in radians? Then write 2.00535."),
        ((("[load] mass", "30.0"),), "[load] mass: The density of the load is 5.5"),
        ((("[base] permitted", "30000.0"),), "usual is 1 to 20,000 kN. Is 30,000 in newtons?"),
    ],
)
def test_what_is_unusual_is_said_and_stops_nobody(
    changes: tuple[tuple[str, str], ...], words: str, tmp_path: Path
) -> None:
    unusual = read_site(yard(tmp_path, *changes)).unusual
    assert any(words in sentence for sentence in unusual), unusual


def test_a_laboratory_crane_of_a_tenth_of_a_kilogram_is_usual() -> None:
    """Numbers of the gantry that cranedyn/machines/gantry_cosys.toml documents."""
    assert [*judge_value(RATE, 0.28, "drives", "rates")] == []
    bench = replace(
        read_site("open_yard"),
        solids=(),
        load=np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.05) for z in (0, 0.05)]),
        crane={"payload_mass": 0.085},
        rigging={},
        start=np.array([0.2, -0.3, 0.1]),
        goal=np.array([0.2, 0.3, 0.1]),
    )
    assert findings(bench, (0.0, 0.445)) == []


@pytest.mark.parametrize(
    ("centre", "size", "refused", "words"),
    [
        ("[13000.0, 4000.0]", "[4.0, 4.0, 2.0]", True, "it has no effect. Is it in millimetres,"),
        ("[13.0, 4.0]", "[0.004, 0.004, 0.029]", True, "is 0.029 m large, too small to be one"),
        ("[90.0, 4.0]", "[4.0, 4.0, 2.0]", False, "whose trolley reaches 22 m: it has no effect"),
    ],
)
def test_an_obstacle_in_another_unit_does_not_vanish(
    centre: str, size: str, refused: bool, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "yard.toml"
    kiosk = f'[[box]]\nname = "kiosk"\ncentre = {centre}\nsize = {size}\n'
    path.write_text(YARD + kiosk, encoding="utf-8")
    if refused:
        with pytest.raises(DataError, match="The obstacle kiosk") as error:
            read_site(path)
        assert words in str(error.value)
    else:
        assert any(words in sentence for sentence in read_site(path).unusual)


def test_a_load_of_a_mesh_hangs_at_its_centre_of_volume(tmp_path: Path) -> None:
    """A hammer: a head of 2 x 2 x 1 m at the end of a handle of 6 x 0.5 x 0.5 m."""
    head = trimesh.creation.box((2.0, 2.0, 1.0))
    handle = trimesh.creation.box((6.0, 0.5, 0.5))
    handle.apply_translation([4.0, 0.0, 0.0])
    trimesh.util.concatenate([head, handle]).export(tmp_path / "hammer.stl")
    text = YARD.replace("size = [1.5, 3.0, 1.2]", 'file = "hammer.stl"')
    (tmp_path / "hammer.toml").write_text(text, encoding="utf-8")
    made = read_site(tmp_path / "hammer.toml").load
    assert made is not None
    # Volumes of 4 and 1.5 m³ at 0 and 4 m: the centre is 12/11 m from that of the head.
    assert made[:, 0].min() == pytest.approx(-1.0 - 12.0 / 11.0, abs=1e-6)
    (tmp_path / "both.toml").write_text(
        text.replace('file = "ham', 'size = [1.0, 1.0, 1.0]\nfile = "ham'), encoding="utf-8"
    )
    with pytest.raises(DataError, match="size: file is given, too"):
        read_site(tmp_path / "both.toml")


@pytest.mark.parametrize(("shift", "is_far"), [(0.0, True), (4.5e6, False)])
def test_a_place_is_as_far_as_it_is_from_the_foot_of_the_crane(shift: float, is_far: bool) -> None:
    """In the frame of a national grid, 4,500 km from its origin, a lift is where its crane is."""
    place = np.array([4.5e6 + 6.0, -14.0, 3.0])
    moved = replace(
        read_site("open_yard"), start=place, goal=None, foot=np.array([shift, 0.0, 0.0])
    )
    found = [finding for finding in findings(moved, (2.0, 22.0)) if finding.field == "from"]
    assert [finding.refused for finding in found] == [True] * is_far


@given(value=st.floats(allow_nan=True, allow_infinity=True))
@example(value=math.nan)
@example(value=math.inf)
@example(value=-0.0)
def test_a_value_is_usual_unusual_or_refused_and_never_none_of_these(value: float) -> None:
    found = [*judge_value(WIND, value, "wind", "gust")]
    possible = 0.0 <= value <= 100.0
    assert [finding.refused for finding in found] == (
        [] if 2.0 <= value <= 20.0 else [not possible]
    )
    assert all(math.isfinite(value) or finding.refused for finding in found)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e308"])
@pytest.mark.parametrize(
    "field",
    [
        *("[load] mass", "[rigging] hook", "[ground] height", "[crane] heading"),
        *("[base] spacing", "[base] mass", "[base] permitted", "[jib] mass", "[jib] centre"),
        *("[counter_jib] length", "[counter_jib] mass", "[counter_jib] centre"),
        *("[lift] distance", "[lift] swing", "[lift] risk", "[wind] gust", "[wind] swing"),
        *(f"[uncertainty] {key}" for key in ("mass", "cable", "wind", "gust", "delay")),
    ],
)
def test_a_number_that_is_none_is_refused_in_every_field(
    field: str, value: str, tmp_path: Path
) -> None:
    if field == "[crane] heading" and value == "1e308":
        return  # an angle like any other
    with pytest.raises((DataError, OutOfRange)):
        read_site(yard(tmp_path, (field, value)))


@pytest.mark.parametrize("value", ["nan", "inf", "1e308"])
@pytest.mark.parametrize(
    "field",
    [
        *("[load] size", "[drives] rates", "[drives] accelerations"),
        *("[lift] from", "[lift] to", "[crane] position"),
    ],
)
def test_a_number_that_is_none_is_refused_in_every_list(
    field: str, value: str, tmp_path: Path
) -> None:
    with pytest.raises((DataError, OutOfRange)):
        read_site(yard(tmp_path, (field, f"[1.0, {value}, 1.0]")))


@pytest.mark.parametrize(
    ("papers", "sentence"),
    [
        ({"jib_length": 45.0}, "jib is 45 m, and trolley_max in the values of [crane], the way"),
        ({"height_under_hook": 38.0}, "hook is 38 m, and pivot_height in the values of [crane]"),
        ({"counter_ballast": 25e3}, "counter-ballast is 25,000 kg, and the mass of [counter_jib]"),
        ({"central_ballast": 95e3}, "central ballast is 95,000 kg, and the mass of [base], of"),
    ],
)
def test_papers_of_another_crane_than_the_one_that_moves_are_refused(
    papers: dict[str, float], sentence: str
) -> None:
    site = read_site("signed_lift")
    crane = {**site.crane, "trolley_max": 60.0, "pivot_height": 31.5}
    agreeing = {
        **{"jib_length": 62.0, "height_under_hook": 29.0},
        **{"counter_ballast": 3000.0, "central_ballast": 40e3},
    }

    def found(said: dict[str, float]) -> list[str]:
        documents = replace(site.details.crane, **said)
        entered = replace(site, crane=crane, details=replace(site.details, crane=documents))
        return [str(finding) for finding in findings(entered) if finding.refused]

    assert found(agreeing) == []
    (refusal,) = found({**agreeing, **papers})
    assert sentence in refusal
