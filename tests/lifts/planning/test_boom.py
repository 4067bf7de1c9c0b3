"""Booms: their joints and length, and sites that hold a telescope at one."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import DataError, ModelError, OutOfRange
from cranedyn.lifts.planning.boom import boom_length, boom_of, telescope_at
from cranedyn.lifts.planning.hoist_chain import HoistChain
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.plan_assumptions import plan_assumptions
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from tests.helpers import ROOT


@cache
def kind(name: str) -> Crane:
    return load_crane(XACRO.with_name(f"{name}_crane.urdf.xacro"))


def test_a_boom_is_what_one_drive_luffs() -> None:
    boom = boom_of(kind("mobile"))
    assert boom is not None and boom.telescope is not None
    names = [joint.name for joint in kind("mobile").layout.joints]
    found = (names[boom.luff], names[boom.telescope], names[boom.head])
    assert found == ("luff_joint", "telescope_joint", "swing_radial_joint")
    luffing = boom_of(kind("luffing"))
    assert luffing is not None and luffing.telescope is None
    assert boom_of(kind("tower")) is None and boom_of(kind("overhead")) is None
    # Two drives luff a knuckle boom, which has no one length.
    assert boom_of(load_crane(ROOT / "examples" / "cranes" / "knuckle_boom.urdf")) is None


def test_its_length_is_that_from_hinge_to_head_wherever_it_points() -> None:
    crane = kind("mobile")
    q = crane.state(slew=2.0, luff=0.4, telescope=3.0).q
    assert boom_length(crane, q) == pytest.approx(11.0 + 3.0 * 3.0)
    assert boom_length(kind("luffing"), kind("luffing").start.q) == pytest.approx(45.0)
    assert boom_length(kind("tower"), kind("tower").start.q) is None


@pytest.mark.parametrize(("length", "extension"), [(11.0, 0.0), (28.0, 17.0 / 3.0), (35.6, 8.2)])
def test_a_telescope_is_held_where_the_boom_has_its_length(length: float, extension: float) -> None:
    joint, coordinate = telescope_at(kind("mobile"), length)
    assert (joint, coordinate) == ("telescope_joint", pytest.approx(extension))
    held = load_crane(XACRO.with_name("mobile_crane.urdf.xacro"), locked={joint: coordinate})
    assert boom_length(held, held.start.q) == pytest.approx(length)


def test_a_telescope_beside_the_line_of_the_boom_is_held_where_that_length_is(
    tmp_path: Path,
) -> None:
    """The head is 3 m above that line, and 20 m along it with an extension of 3 m each."""
    aside = kind("mobile").urdf.replace('<origin xyz="0 -11.0 0"', '<origin xyz="0 -11.0 3"')
    assert aside != kind("mobile").urdf
    path = tmp_path / "aside.urdf"
    path.write_text(aside)
    crane = load_crane(path)
    joint, coordinate = telescope_at(crane, float(np.hypot(20.0, 3.0)))
    assert (joint, coordinate) == ("telescope_joint", pytest.approx(3.0))


def test_a_length_that_a_boom_cannot_have_is_refused() -> None:
    with pytest.raises(OutOfRange, match=r"boom is 36 m; allowed is 11 to 35\.6"):
        telescope_at(kind("mobile"), 36.0)
    with pytest.raises(ModelError, match="luffing_crane has no boom that telescopes"):
        telescope_at(kind("luffing"), 45.0)


@cache
def page_site() -> str:
    """Return the site of the page about the mobile crane."""
    page = ROOT / "docs/howto/mobile_crane.md"
    _, site = re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), re.S | re.M)
    return site


def read_changed(folder: Path, old: str = "", new: str = "") -> Site:
    text = page_site()
    assert old in text
    file = folder / "street.toml"
    file.write_text(text.replace(old, new, 1))
    return read_site(file)


def test_a_site_holds_the_boom_and_enters_counterweight_and_falls(tmp_path: Path) -> None:
    site = read_changed(tmp_path)
    assert (site.telescope, site.boom) == ("telescope_joint", 28.0)
    assert site.counterweight == 12e3
    assert (site.crane["counterweight"], site.crane["falls"]) == (12e3, 6)
    assert [drive.name for drive in site.drives] == ["slew", "luff", "hoist"]
    crane = crane_of(site)
    assert boom_length(crane, crane.start.q) == pytest.approx(28.0)
    assert HoistChain(crane).carriers == (0, 1)
    assert site.limits is not None
    (boom,) = [a for a in plan_assumptions(site, crane, site.limits) if "boom" in a.name]
    assert boom.value == "28 m, held during the lift; telescoping under load is not planned"


def test_a_boom_may_be_held_by_its_joint_and_may_have_another_base_section(tmp_path: Path) -> None:
    held = read_changed(tmp_path, "boom = 28.0 ", "locked = { telescope_joint = 4.0 } #")
    assert held.boom == pytest.approx(23.0)
    longer = read_changed(tmp_path, "boom = 28.0 ", "values = { boom_min = 12.0 }\nboom = 28.0 #")
    assert longer.description is not None
    assert longer.description.locked == {"telescope_joint": pytest.approx(16.0 / 3.0)}
    crane = crane_of(longer)
    assert boom_length(crane, crane.start.q) == pytest.approx(28.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("boom = 28.0 ", "#", "line 4, .crane. kind: the boom of this crane telescopes .telesco"),
        ("boom = 28.0 ", "boom = 60.0 #", "line 5, .crane. boom: .* 11 to 35.6"),
        (
            "boom = 28.0 ",
            "boom = 28.0\nlocked = { telescope_joint = 4.0 } #",
            "locked holds telescope_joint, too",
        ),
        ('kind = "mobile"', 'kind = "luffing"', "luffing_crane has no boom that telescopes"),
        ('kind = "mobile"', 'kind = "tower"', "a tower crane has none"),
        ('kind = "mobile"', "", "it is for a crane that file, kind or machine names"),
        ("counterweight = 12000.0", "counterweight = -1.0", "line 6, .crane. counterweight"),
        (
            "counterweight = 12000.0 ",
            "values = { counterweight = 9e3 }\ncounterweight = 12e3 #",
            "counterweight: the same value is entered twice: here, and as counterweight = 9000 in",
        ),
        ("permitted = 400.0 ", 'along = "street" #', "There is no way to lie 'street'"),
    ],
)
def test_a_site_of_a_mobile_crane_is_refused_with_its_line(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=words):
        read_changed(tmp_path, old, new)


def test_outriggers_lie_along_the_axes_of_their_crane_and_a_base_along_those_of_its_site(
    tmp_path: Path,
) -> None:
    turned = read_changed(tmp_path, "yaw = 0.0", "yaw = 30.0")
    assert turned.base is not None and turned.base.turns_with_crane
    assert np.abs(turned.base_corners[:, :2]) == pytest.approx(3.2)
    fixed = read_changed(tmp_path, "permitted = 400.0 ", 'along = "site" #')
    assert fixed.base is not None and not fixed.base.turns_with_crane


@pytest.mark.parametrize("mass", [0.0, 9000.0])
def test_a_counterweight_is_that_of_the_crane(mass: float, tmp_path: Path) -> None:
    site = read_changed(tmp_path, "counterweight = 12000.0", f"counterweight = {mass}")
    total = sum(inertia.mass for inertia in crane_of(site).model.inertias)
    # Carrier, superstructure, boom, both links between the swing joints, load with rigging.
    assert total == pytest.approx(mass + 22000.0 + 7000.0 + 8200.0 + 60.0 + 3600.0)
