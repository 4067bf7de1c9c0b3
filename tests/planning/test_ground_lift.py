"""Lifts from the ground to the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cranedyn.errors import OutOfRange

pytest.importorskip("coal", reason="extra planning (coal) is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.planning.ground_lift import GroundLift, certify_ground_lift, from_ground
from cranedyn.planning.lift import Lift, plan_lift
from cranedyn.planning.site_file import SITES, read_site

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def planned() -> Lift:
    yard = read_site(SITES / "open_yard.toml")
    assert yard.limits is not None
    site = replace(yard, solids=(), start=np.array([6.0, -14.0, 2.4]))
    return plan_lift(site, yard.limits, goal=np.array([8.0, -13.0, 2.4]))


@pytest.fixture(scope="module")
def lift(planned: Lift) -> GroundLift:
    return from_ground(planned, creep=0.2, sink_rate=0.2)


def test_a_load_is_lifted_off_moved_and_set_down(lift: GroundLift) -> None:
    run, checks = certify_ground_lift(lift)
    assert [check.sentence for check in checks if not check.holds] == []
    changes = np.flatnonzero(np.diff(run.phase)) + 1
    assert run.phase[[0, *changes]].tolist() == [2.0, 0.0, 2.0]
    assert (run.valid == 1.0).all()


def test_checks_notice_a_load_that_loses_its_way(lift: GroundLift) -> None:
    beside = replace(lift.lift, ends=lift.lift.ends + np.array([0.0, 0.02, 0.0]))
    _, checks = certify_ground_lift(replace(lift, lift=beside))
    assert [check.holds for check in checks] == [True, True, True, False]


def test_speeds_are_positive_and_the_ground_is_at_the_foot(planned: Lift) -> None:
    with pytest.raises(OutOfRange, match="creep speed"):
        from_ground(planned, creep=0.0)
    with pytest.raises(OutOfRange, match="sink rate"):
        from_ground(planned, sink_rate=-0.1)
    raised = replace(planned.clearance, site=replace(planned.clearance.site, ground=1.0))
    with pytest.raises(OutOfRange, match="foot of the crane"):
        from_ground(replace(planned, clearance=raised))
