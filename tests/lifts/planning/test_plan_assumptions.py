"""What a plan rests on names every value that decides it, with its origin."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.assumptions import Assumption, Origin
from cranedyn.errors import DataError
from cranedyn.lifts.judging.analysis import Requirements
from cranedyn.lifts.judging.judged_inputs import resolve_inputs
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_site
from tests.lifts.planning.test_details_file import WHOLE

STRUCTURE = """
[drives]
rates = [4.8, 1.5, 1.0]
accelerations = [1.15, 0.4, 0.5]
[crane.values]
upper_mass = 9000.0
[base]
spacing = 4.5
mass = 60000.0
permitted = 400.0
[jib]
mass = 2000.0
centre = 10.0
[counter_jib]
length = 9.4
mass = 3500.0
centre = 6.0
[lift]
from = [6.0, -14.0]
to = [13.0, 9.0]
[[box]]
name = "shed"
centre = [13.0, -7.0]
size = [4.0, 8.0, 2.5]
"""


def site(folder: Path, text: str = WHOLE + STRUCTURE, before: str = "") -> Site:
    file = folder / "site.toml"
    file.write_text(before + text, encoding="utf-8")
    return read_site(file)


def rests_on(found: Site) -> dict[str, Assumption]:
    """What a judgement of a site rests on, by name."""
    assert found.limits is not None
    inputs = resolve_inputs(found, crane_of(found), found.limits, Requirements())
    return {assumption.name: assumption for assumption in inputs.assumptions}


def test_masses_base_ground_obstacles_and_rope_are_among_what_a_result_rests_on(
    tmp_path: Path,
) -> None:
    found = rests_on(site(tmp_path))
    for name, value, origin in (
        ("mass of what slews, on the slew axis", "9,000 kg", Origin.ENTERED),
        ("masses of the crane as shipped", "the trolley 500 kg", Origin.SHIPPED),
        ("mass of the jib", "2,000 kg, centre 10 m from the slew axis", Origin.ENTERED),
        ("mass of the counter-jib", "3,500 kg, centre 6 m", Origin.ENTERED),
        ("length of the counter-jib", "9.4 m", Origin.ENTERED),
        ("base", "4.5 m between its corners, 60,000 kg", Origin.ENTERED),
        ("force that the ground bears under a corner", "400 kN", Origin.ENTERED),
        ("ground", "level, at a height of 0 m", Origin.ENTERED),
        ("obstacles and zones", "1: shed", Origin.ENTERED),
        ("centre of gravity of the load", "(0.1, -0.2, -0.1) m", Origin.ENTERED),
        ("largest accelerations of slew, trolley and hoist", "1.15 °/s², 0.4 and 0.5 m/s²", None),
        ("stiffness EA of the rope, at lift-off and set-down", "4e+07 N on 2 f", Origin.ASSUMED),
        ("wind on the structure of the crane", "none", Origin.ASSUMED),
    ):
        assert found[name].value.startswith(value), found[name]
        assert origin is None or found[name].origin is origin, found[name]


def test_a_load_that_hangs_rests_on_no_stiffness_of_the_rope(tmp_path: Path) -> None:
    hanging = STRUCTURE.replace("-14.0]", "-14.0, 3.0]").replace("9.0]\n[[", "9.0, 3.0]\n[[")
    assert not any("stiffness" in name for name in rests_on(site(tmp_path, WHOLE + hanging)))


def test_what_was_estimated_is_called_so(tmp_path: Path) -> None:
    before = 'estimated = ["[jib] centre", "[crane.values] upper_mass"]\n'
    weighed = rests_on(site(tmp_path, before=before))
    names = {name for name, found in weighed.items() if found.origin is Origin.ESTIMATED}
    assert names == {"mass of the jib", "mass of what slews, on the slew axis"}
    before = 'estimated = ["[jib] centre", "[crane] wind_limit", "[crane] counter_ballast"]\n'
    others = rests_on(site(tmp_path, before=before))["other estimates"]
    assert others.origin is Origin.ESTIMATED
    assert others.value == "[crane] counter_ballast; [crane] wind_limit"
    text = (WHOLE + STRUCTURE).replace('"weighed"', '"estimated"')
    found = rests_on(site(tmp_path, text))
    assert found["mass of the load with its rigging"].origin is Origin.ESTIMATED
    with pytest.raises(DataError, match=re.escape("'[jib] mas' is not entered in this file")):
        site(tmp_path, before='estimated = ["[jib] mas"]\n')


@pytest.mark.parametrize(
    ("size", "attitude"),
    [
        ("[1.5, 3.0, 1.2]", "held with its longer side, 3.0 m, along the jib"),
        ("[3.0, 1.5, 1.2]", "held with its longer side, 3.0 m, across the jib"),
        ("[3.0, 3.0, 1.2]", "held with a side of 3.0 m along the jib"),
    ],
)
def test_a_load_that_lies_across_the_jib_is_not_said_to_lie_along_it(
    tmp_path: Path, size: str, attitude: str
) -> None:
    text = (WHOLE + STRUCTURE).replace("size = [1.5, 3.0, 1.2]", f"size = {size}")
    text = text.replace("-1.2, 0.6]", "-0.7, 0.6]").replace("1.2, 0.6]", "0.7, 0.6]")
    assert rests_on(site(tmp_path, text))["attitude of the load"].value.startswith(attitude)
