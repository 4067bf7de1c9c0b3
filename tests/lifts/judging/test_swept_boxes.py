"""Boxes around a load in a recording turn as the load does, whatever the first drive of the crane
is.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.lifts.judging.lift_figures import _swept_boxes
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.solids import rotation_z
from tests.lifts.planning.test_any_crane import clearance


def lift_along(asked: Clearance, first: list[float], last: list[float]) -> Any:
    """What boxes need of a lift: a straight way between two places."""
    share = np.linspace(0.0, 1.0, 60)[:, None]
    places = np.array(first) + share * (np.array(last) - np.array(first))
    return SimpleNamespace(clearance=asked, timed=SimpleNamespace(places=places))


def test_the_load_of_a_bridge_that_travels_far_does_not_turn() -> None:
    swept = _swept_boxes(lift_along(clearance("overhead"), [5.0, 4.0, 6.0], [40.0, 12.0, 6.0]))
    assert len(swept["yaw"]) > 10
    assert np.all(swept["yaw"] == 0.0)


@pytest.mark.parametrize("kind", ["portal", "luffing"])
def test_boxes_turn_as_pinocchio_turns_the_load(kind: str) -> None:
    asked = clearance(kind)
    lift = lift_along(asked, [-0.9, 0.7, 8.0], [1.1, 1.1, 14.0])
    swept = _swept_boxes(lift)
    assert np.ptp(swept["yaw"]) > 1.0
    centres = asked.point(lift.timed.places)
    data = asked.crane.model.createData()
    for yaw, centre, size in zip(swept["yaw"], swept["centres"], swept["sizes"], strict=True):
        # The load is a cube about the end of the rope, so that its centre tells the place.
        row = int(np.linalg.norm(centres - centre, axis=1).argmin())
        q = asked.q(lift.timed.places[row])
        pin.forwardKinematics(asked.crane.model, data, q)
        of_load = data.oMi[asked.crane.payload.body + 1].rotation
        turned = rotation_z(yaw) @ asked.bodies.hook_turn
        np.testing.assert_allclose(of_load, turned, rtol=0.0, atol=1e-7)
        envelope = (float(asked.cable(q)) + asked.bodies.below) * asked.swing_chord
        np.testing.assert_allclose(size, 1.0 + 2.0 * envelope, rtol=1e-9)
