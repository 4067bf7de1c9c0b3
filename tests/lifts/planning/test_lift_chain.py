"""Lifts one after the other: the moves, energy across changes, loads that stand, and refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

from cranedyn.data.columns import LOADS_COLUMN
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.lifts.planning.file_templates import template_text
from cranedyn.lifts.planning.ground_lift import load_corners
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.planning.lift_chain import (
    CertifiedChain,
    ChainedLift,
    ChainList,
    certify_chain,
    plan_chain,
    read_chain,
)
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.references.limits import Limits

pytestmark = pytest.mark.slow

LONG_ROPE = {"hoist_max": 30.0}
HOME = np.array([7.5, -13.5, 8.0])
PALLET = ChainedLift(
    "pallet", np.array([6.0, -14.0]), np.array([9.0, -13.0]), 600.0, (1.2, 1.2, 1.0)
)
CRATE = ChainedLift("crate", np.array([8.0, -17.0]), np.array([9.0, -13.0]), 500.0, (1.0, 1.0, 0.8))


@cache
def yard() -> Site:
    return read_site("open_yard")


def limits() -> Limits:
    """Gentler drives than those of the yard, with which plans go to the swing that is allowed: on
    an elastic rope a load may then swing by a few per cent more, which its check says.
    """
    entered = yard().limits
    assert entered is not None
    return Limits(entered.rates, 0.5 * np.asarray(entered.accelerations))


@cache
def stacked() -> CertifiedChain:
    """A pallet is moved, and a crate set down on it."""
    chain = plan_chain(yard(), ChainList((PALLET, CRATE), HOME), limits(), values=LONG_ROPE)
    return certify_chain(chain)


def test_all_moves_of_a_chain_hold_and_make_one_trajectory() -> None:
    certified = stacked()
    failing = [check.sentence for check in certified.all_checks if check.holds is not True]
    assert not failing
    moves = certified.chain.moves
    assert [move.name for move in moves] == ["to pallet", "pallet", "to crate", "crate", "home"]
    whole = certified.run.trajectory
    assert len(certified.run.stages) == 5
    assert whole.t[-1] == pytest.approx(certified.chain.duration)
    assert (np.diff(whole.t) > 0.0).all()
    # Empty and loaded moves are checked alike.
    of_kind = [
        {check.sentence.split(":")[0] for check in checks} - {"Lift-off", "Set-down"}
        for checks in certified.checks
    ]
    assert all(len(checks) == len(of_kind[0]) for checks in of_kind)


def test_loads_bring_the_energy_of_their_height_and_take_it_away() -> None:
    """By hand: what is attached is the load alone, m g h above the ground of the crane."""
    certified = stacked()
    gravity = certified.chain.moves[0].lift.crane.gravity
    # Centres: the pallet on the ground, there again; the crate on the ground, and on the pallet.
    expected = [
        (470.0, 470.0 * gravity * 0.5),
        (-470.0, -470.0 * gravity * 0.5),
        (370.0, 370.0 * gravity * 0.4),
        (-370.0, -370.0 * gravity * 1.4),
    ]
    for change, (mass, energy) in zip(certified.run.changes, expected, strict=True):
        assert change.mass == pytest.approx(mass)
        # Sunk by some millimetres, which are 10 J each.
        assert change.brought == pytest.approx(energy, abs=30.0)
        assert 0.0 <= change.lost < 0.1
    whole = certified.run.trajectory
    assert abs(whole.unexplained).max() < 1e-3 * max(abs(e) for _, e in expected)
    net = sum(change.brought - change.lost for change in certified.run.changes)
    assert whole[LOADS_COLUMN][-1] == pytest.approx(net)


def test_a_released_load_stands_still_and_the_next_one_is_set_down_on_it() -> None:
    certified = stacked()
    site = certified.chain.site
    ends = {}
    for move, piece in zip(certified.chain.moves, certified.run.stages, strict=True):
        if move.load:
            ends[move.load] = site.to_site(load_corners(move.lift, piece.q[-1]))
            lift = {"pallet": PALLET, "crate": CRATE}[move.load]
            middle = ends[move.load].mean(axis=0)
            np.testing.assert_allclose(middle[:2], lift.goal, atol=0.01)
    assert ends["pallet"][:, 2].min() == pytest.approx(0.0, abs=0.005)
    assert ends["crate"][:, 2].min() == pytest.approx(1.0, abs=0.01)
    names = [solid.name for solid in certified.chain.moves[-1].lift.lift.clearance.solids]
    assert {"pallet", "crate"} <= set(names)
    carrying = certified.chain.moves[3].lift.lift.clearance
    assert "pallet" in [solid.name for solid in carrying.solids]
    assert "crate" not in [solid.name for solid in carrying.solids]


def test_the_empty_hook_moves_with_its_own_size_and_mass() -> None:
    chain = stacked().chain
    for move in chain.moves:
        crane = move.lift.crane
        mass = {"": 130.0, "pallet": 600.0, "crate": 500.0}[move.load]
        assert crane.payload_mass == pytest.approx(mass)
        size = np.ptp(move.lift.lift.clearance.bodies.load, axis=0)
        expected = chain.sizes[move.load] if move.load else chain.hook.size
        np.testing.assert_allclose(sorted(size), sorted(expected), atol=1e-9)
    # Where the hook takes a load, the end of the rope stays where it is.
    before = chain.moves[0].lift
    after = chain.moves[1].lift
    assert after.lug - before.lug == pytest.approx(1.0 / 2.0 + chain.hook.size[2] / 2.0)
    end = stacked().run.stages[0].q[-1]
    hook = payload_position(before.crane, end)
    bottom = hook[2] - chain.hook.size[2] / 2.0
    assert load_corners(after, end)[:, 2].max() == pytest.approx(bottom, abs=1e-6)


def test_a_recording_shows_loads_where_they_stand_and_hang(tmp_path: Path) -> None:
    from cranedyn.lifts.planning.chain_recording import record_chain
    from tests.rrd import rows

    file = record_chain(tmp_path / "chain.rrd", stacked())
    t, places = rows(file, "scene/crate", "Transform3D:translation")
    seconds = 1e-9 * np.asarray(t, dtype=float)
    begin = stacked().chain.begins[3]
    end = stacked().chain.begins[4]
    waiting = places[seconds < begin - 0.1]
    np.testing.assert_allclose(
        waiting, np.broadcast_to([8.0, -17.0, 0.4], waiting.shape), atol=0.01
    )
    standing = places[seconds > end + 0.1]
    np.testing.assert_allclose(
        standing, np.broadcast_to([9.0, -13.0, 1.4], standing.shape), atol=0.02
    )
    assert np.ptp(standing, axis=0).max() < 1e-9
    assert places[:, 2].max() > 2.0


def test_a_list_is_read_and_refused_with_line_and_field(tmp_path: Path) -> None:
    file = tmp_path / "chain.toml"
    file.write_text(template_text("chain"), encoding="utf-8")
    listed = read_chain(file)
    assert [lift.name for lift in listed.lifts] == ["formwork", "rebar"]
    assert listed.hooking == 5.0 and listed.hook_size is None
    for text, sentence in (
        ("home = [1.0, 2.0, 3.0]\n", r"lift: there is none; write each as \[\[lift\]\]"),
        (
            '[[lift]]\nname = "a"\nfrom = [1.0, 2.0, 3.0]\n',
            r"line 3, \[lift\] from: .* give X and Y",
        ),
        ('[[lift]]\nname = "a"\nfrom = [1.0, 2.0]\n', r"\[lift\] to: .*missing"),
        (
            '[[lift]]\nname = "a"\nfrom = [1.0, 2.0]\nto = [1.0, 3.0]\n' * 2,
            r"line 6, \[lift\] name: two lifts are called a",
        ),
    ):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(DataError, match=sentence):
            read_chain(file)


def test_what_cannot_be_chained_is_refused_with_the_move() -> None:
    def planned(lift: ChainedLift, site: Site | None = None) -> None:
        listed = ChainList((lift,), HOME)
        plan_chain(yard() if site is None else site, listed, limits(), values=LONG_ROPE)

    with pytest.raises(DataError, match="how heavy the empty hook is"):
        planned(PALLET, replace(yard(), rigging={}))
    with pytest.raises(DataError, match=r"The load of pallet is 100 kg .* are 130 kg alone"):
        planned(replace(PALLET, mass=100.0))
    with pytest.raises(DataError, match=r"would not stand on the load of pallet"):
        planned(replace(PALLET, size=(0.5, 2.0, 1.0)))
    with pytest.raises(NoWay, match=r"pallet: At the goal of pallet the load would tip"):
        planned(replace(PALLET, goal=np.array([13.0, -3.3])))
    with pytest.raises(CraneError, match="goal"):
        planned(replace(PALLET, goal=np.array([90.0, 0.0])))
    with pytest.raises(OutOfRange, match="start of the lift pallet"):
        replace(PALLET, start=np.array([1.0, np.nan]))
    with pytest.raises(DataError, match="lorry"):
        planned(replace(PALLET, name="lorry"))
