"""The list of all that the promise of a site rests on, and the page that prints it."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.assumptions import Assumption, Origin, check_entered
from cranedyn.disturbances.wind import steady
from cranedyn.lifts.sites.crane_site import CraneSite, SiteWind
from cranedyn.lifts.sites.crane_site_file import read_crane_site
from cranedyn.lifts.sites.promise import TRIED_REACTION, site_assumptions, unjudged_ropes
from cranedyn.lifts.sites.site_page import site_html, site_run_checks
from cranedyn.lifts.sites.site_simulation import simulate_site
from cranedyn.lifts.sites.working_wind import CALM, WorkingWind
from tests.lifts.sites.cases import site_of

pytestmark = pytest.mark.slow

ALL_ENTERED = """
distance = 1.5
swing = 6.0
wind = {gust = 9.0, area = 4.0}

[[crane]]
name = "a"
values = {payload_mass = 1000.0}
drives = {rates = [4.0, 1.0, 0.8], accelerations = [1.0, 0.4, 0.5]}
brakes = {decelerations = [0.5, 0.3, 0.4], tolerances = [0.2, 0.1, 0.04]}
reaction = 1.0

[[crane]]
name = "b"
position = [200.0, 0.0, 0.0]
values = {payload_mass = 500.0}
drives = {rates = [4.0, 1.0, 0.8], accelerations = [1.0, 0.4, 0.5]}
brakes = {decelerations = [0.5, 0.3, 0.4], tolerances = [0.2, 0.1, 0.04]}
reaction = 1.0
"""


def site_from(tmp_path: Path, text: str) -> CraneSite:
    file = tmp_path / "site.toml"
    file.write_text(text, "utf-8")
    return read_crane_site(file)


def defaults(site: CraneSite) -> set[str]:
    """Return the names of what nobody entered."""
    return {x.name for x in site_assumptions(site) if x.origin is Origin.DEFAULT}


def test_a_site_for_which_all_is_entered_rests_on_no_default(tmp_path: Path) -> None:
    assumptions = site_assumptions(site_from(tmp_path, ALL_ENTERED))
    assert check_entered(assumptions).holds
    entered = {x.name: x.value for x in assumptions if x.origin is Origin.ENTERED}
    assert entered == {
        "required distance": "1.5 m",
        "largest swing of a rope": "6°",
        "wind": "9 m/s in gusts, drag area 4 m²",
        "lightest load in the wind of a": "1000 kg",
        "lightest load in the wind of b": "500 kg",
        "weakest brakes": "slew 0.5 °/s², trolley 0.3 m/s², hoist 0.4 m/s²",
        "reaction time of brakes": "1 s",
        "fastest drives": "slew 4 °/s, trolley 1 m/s, hoist 0.8 m/s",
        "error of measured positions": "slew 0.2 °, trolley 0.1 m, hoist 0.04 m",
        "shapes of the crane": "those of its description, with the load",
    }
    # 202.5 N on the weight of 1000 and 500 kg: 1.18° and 2.37° of lean, of which 95 % count.
    computed = {x.name: x.value for x in assumptions if x.origin is Origin.COMPUTED}
    assert computed == {
        "swing by a gust of a": "2.4°; 3.5° are left to the drives",
        "swing by a gust of b": "4.7°; 1° are left to the drives",
        # Their drives may react after 1 s, which is longer than it was tried.
        "ropes in their largest swing": "not judged, since the drives may react too late to damp a "
        "swing",
    }
    assumed = {x.name for x in assumptions if x.origin is Origin.ASSUMED}
    assert assumed == {"gusts", "swing of ropes", "cycle of guards", "messages", "clocks"}


@pytest.mark.parametrize(
    ("field", "name"),
    [
        ("distance = 1.5\n", "required distance"),
        ("swing = 6.0\n", "largest swing of a rope"),
        ("wind = {gust = 9.0, area = 4.0}\n", "wind"),
        ("values = {payload_mass = 1000.0}\n", "lightest load in the wind of a"),
        ("values = {payload_mass = 1000.0}\n", "shapes of the crane of a"),
        ("reaction = 1.0\n\n", "reaction time of brakes of a"),
        (", tolerances = [0.2, 0.1, 0.04]}\nreaction = 1.0\n\n",
         "error of measured positions of a"),
        ("drives = {rates = [4.0, 1.0, 0.8], accelerations = [1.0, 0.4, 0.5]}\nbrakes",
         "fastest drives of a"),
        ("brakes = {decelerations = [0.5, 0.3, 0.4], tolerances = [0.2, 0.1, 0.04]}\n"
         "reaction = 1.0\n\n",
         "weakest brakes of a"),
    ],
)  # fmt: skip
def test_what_is_left_out_of_a_site_file_is_a_default_in_the_list(
    tmp_path: Path, field: str, name: str
) -> None:
    kept = {"drives": "brakes", ", toler": "}\nreaction = 1.0\n\n", "brakes": "reaction = 1.0\n\n"}
    rest = next((text for start, text in kept.items() if field.startswith(start)), "")
    assert field in ALL_ENTERED
    site = site_from(tmp_path, ALL_ENTERED.replace(field, rest, 1))
    assert name in defaults(site)


def test_a_site_made_by_code_rests_on_defaults_until_somebody_says_that_they_are_entered() -> None:
    site = replace(site_of(), entered=frozenset())
    assert {"required distance", "largest swing of a rope", "wind"} <= defaults(site)
    assert Assumption("wind", "no wind", Origin.DEFAULT) in site_assumptions(site)


def test_nothing_is_promised_of_the_rope_of_a_crane_whose_drives_react_late() -> None:
    """Gears add 2.38 s to the 0.52 s of the converters: nobody knows that ropes stay in cones."""
    site = site_of()
    north, south = site.stations
    late = replace(north, brakes=replace(north.brakes, reaction=0.52 + 2.38))
    at_limit = replace(south, brakes=replace(south.brakes, reaction=TRIED_REACTION))
    run = simulate_site(
        replace(site, stations=(late, at_limit)), [lambda t, states: np.zeros(3)] * 2, duration=1.0
    )
    (words,) = run.broken_assumptions
    assert words.startswith("the drives of north may react only after 2.9 s; that a guard keeps")
    (check,) = [check for check in site_run_checks(run) if words in check.sentence]
    assert check.holds is None
    values = {x.name: x.value for x in site_assumptions(run.site)}
    assert values["ropes in their largest swing of north"].startswith("not judged")
    assert values["ropes in their largest swing of south"] == (
        "tried for drives that react within 0.52 s"
    )
    assert not unjudged_ropes(site)


def test_tolerances_of_a_site_file_are_those_of_its_brakes(tmp_path: Path) -> None:
    station = site_from(tmp_path, ALL_ENTERED).stations[0]
    assert np.allclose(station.brakes.tolerances, [np.radians(0.2), 0.1, 0.04])


@pytest.mark.parametrize("wind", [None, SiteWind(steady(9.5))])
def test_the_page_prints_all_assumptions_and_judges_no_run_that_breaks_one(
    wind: SiteWind | None,
) -> None:
    site = replace(site_of(), working_wind=WorkingWind(9.0, 4.0))
    run = simulate_site(site, [lambda t, states: np.zeros(3)] * 2, duration=1.0, wind=wind)
    text = html.unescape(site_html(run))
    for assumption in site_assumptions(site):
        for word in (assumption.name, assumption.value):
            assert f">{word}<" in text
    broken = "Outside of what the site assumes: wind of up to 9.5 m/s, from 0.0 s on"
    assert (broken in text) == (wind is not None)
    assert "rests on: lightest load in the wind, reaction time of brakes, fastest drives" in text


def test_the_page_says_that_no_wind_is_assumed_where_none_is_entered() -> None:
    site = site_of()
    assert site.working_wind == CALM
    run = simulate_site(site, [lambda t, states: np.zeros(3)] * 2, duration=1.0)
    text = html.unescape(site_html(run))
    assert ">no wind<" in text
    assert ">default<" in text
    assert "rests on: wind, reaction" in text
