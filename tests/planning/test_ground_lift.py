"""Lifts from the ground to the ground."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from cranedyn.controllers.lqr import lqr
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.errors import CraneError, OutOfRange

pytest.importorskip("coal", reason="extra planning (coal) is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.planning.ground_lift import GroundLift, certify_ground_lift, from_ground
from cranedyn.planning.lift import Lift, plan_lift
from cranedyn.planning.site_file import SITES, read_site
from cranedyn.planning.solids import box
from cranedyn.references.flat import smoothstep

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def planned() -> Lift:
    yard = read_site(SITES / "open_yard.toml")
    assert yard.limits is not None
    obstacles = box("pad", (9.0, -13.0), (4.0, 4.0, 1.5), -1.0), box("roof", (0, 9), (9, 9, 1), 9.0)
    ends = {"start": np.array([4.0, -15.0]), "goal": np.array([9.0, -13.0])}
    return plan_lift(replace(yard, solids=obstacles, ground=-1.0, **ends), yard.limits)


@pytest.fixture(scope="module")
def lift(planned: Lift) -> GroundLift:
    return from_ground(planned, creep=0.2, sink_rate=0.2)


def test_a_load_is_lifted_off_the_ground_moved_and_set_down_on_an_obstacle(
    lift: GroundLift,
) -> None:
    run, checks = certify_ground_lift(lift)
    assert [check.sentence for check in checks if not check.holds] == []
    changes = np.flatnonzero(np.diff(run.phase)) + 1
    assert run.phase[[0, *changes]].tolist() == [2.0, 0.0, 2.0]
    assert (run.valid == 1.0).all()
    heights = [payload_position(lift.crane, run.q[row])[2] for row in (0, -1)]
    half, sink = 0.6, lift.ground.sink
    assert heights == pytest.approx([half - 1.0 - sink, half + 0.5 - sink], abs=1e-4)
    assert len(lift.ground.platforms) == 1  # the roof is far away
    pulls = [float(x) for x in re.findall(r"[\d.]+(?= (?:of the weight|by closed))", checks[0][0])]
    assert 1.0 < pulls[0] < pulls[1] < 1.0 + 2.0 * (pulls[0] - 1.0)


@pytest.mark.long
def test_a_load_that_is_lifted_off_lead_and_set_down_beside_its_goal_has_no_certificate(
    lift: GroundLift,
) -> None:
    motion = lift.motion
    q = motion.q.copy()
    q[:, motion.drives[1]] += 0.7 * smoothstep(np.arange(len(q)) * motion.period / 4.0)
    aside = replace(motion, q=q)
    leaning = replace(lift, motion=aside, controller=lqr(lift.lift.crane, aside))
    _, checks = certify_ground_lift(leaning)
    assert not checks[0].holds and "without a bound" in checks[0].sentence
    assert not checks[3].holds and "mm from its goal" in checks[3].sentence


def test_bad_input_is_a_sentence(planned: Lift) -> None:
    with pytest.raises(OutOfRange, match="creep speed"):
        from_ground(planned, creep=0.0)
    with pytest.raises(OutOfRange, match="sink rate"):
        from_ground(planned, sink_rate=-0.1)
    other = replace(planned.crane, record={})
    with pytest.raises(CraneError, match="tower crane of this project"):
        from_ground(replace(planned, clearance=replace(planned.clearance, crane=other)))
