"""The drum of a hoist, and the friction of its sheaves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.errors import OutOfRange
from cranedyn.lifts.judging.chart import Reeving
from cranedyn.lifts.judging.drum import Drum, Winch
from cranedyn.model.load import load_crane
from cranedyn.references import spline
from cranedyn.simulation.simulate import simulate

DRUM = Drum(radius=0.24, width=0.5, rope_diameter=0.02, layers=3, inertia=40.0)


def test_a_layer_has_as_many_turns_as_fit() -> None:
    assert [DRUM.turns(layer) for layer in range(3)] == [25, 24, 25]
    assert Drum(0.24, 0.499, 0.02).turns(0) == 24
    # Half a diameter is left beside the turns, in which every second layer has room.
    assert Drum(0.24, 0.51, 0.02).turns(1) == 25


def test_layers_lie_in_the_grooves_of_those_below() -> None:
    """Axes of touching ropes are the corners of equal triangles with sides of a diameter."""
    assert DRUM.layer_radius(0) == 0.25
    step = DRUM.layer_radius(1) - DRUM.layer_radius(0)
    assert math.hypot(step, 0.01) == pytest.approx(0.02, rel=1e-12)


def test_a_full_drum_has_wound_all_of_its_layers() -> None:
    radii = [0.25 + layer * 0.02 * math.sqrt(3) / 2 for layer in range(3)]
    wound = 2 * math.pi * (25 * radii[0] + 24 * radii[1] + 25 * radii[2])
    assert DRUM.capacity == pytest.approx(wound, rel=1e-12)
    assert DRUM.angle(np.array(DRUM.capacity)) == pytest.approx(2 * math.pi * 74)


def test_angle_and_radius_change_with_the_layer() -> None:
    layer = 2 * math.pi * 25 * 0.25
    wound = np.array([0.0, 0.5 * layer, layer + 1.0])
    np.testing.assert_allclose(
        DRUM.angle(wound), [0.0, math.pi * 25, 2 * math.pi * 25 + 1.0 / DRUM.layer_radius(1)]
    )
    np.testing.assert_allclose(DRUM.radius_at(wound), [0.25, 0.25, DRUM.layer_radius(1)])


@pytest.mark.parametrize("wound", [-0.1, 1e3, float("nan")])
def test_a_length_that_the_drum_cannot_have_is_refused(wound: float) -> None:
    with pytest.raises(OutOfRange, match="rope wound on the drum"):
        DRUM.angle(np.array(wound))


def test_a_drum_too_narrow_for_a_turn_is_refused() -> None:
    with pytest.raises(OutOfRange, match="width of the drum"):
        Drum(0.2, 0.01, 0.02)


def test_each_metre_of_cable_takes_a_metre_of_each_fall() -> None:
    winch = Winch(DRUM, Reeving(4), 100.0)
    np.testing.assert_allclose(winch.wound(np.array([0.0, 10.0, 25.0])), [100.0, 60.0, 0.0])
    with pytest.raises(OutOfRange, match="0 to 25, at which the drum is empty"):
        winch.wound(np.array([26.0]))
    with pytest.raises(OutOfRange, match="the capacity of the drum"):
        Winch(DRUM, Reeving(4), 1000.0)


def test_the_drum_is_as_inert_as_a_mass_at_the_hook() -> None:
    """Both have the kinetic energy J ω²/2 = m v²/2 where the drum turns by ω = n v/r."""
    winch = Winch(DRUM, Reeving(4), 30.0)
    speed = 0.7
    turning = 4 * speed / DRUM.layer_radius(0)
    energy = 0.5 * DRUM.inertia * turning**2
    assert 0.5 * winch.mass_at_hook(5.0) * speed**2 == pytest.approx(energy, rel=1e-12)


def test_sheaves_pass_on_what_their_friction_leaves() -> None:
    reeving = Reeving.over_sheaves(2, friction=0.02, wrap=math.pi)
    assert reeving.efficiency == pytest.approx(math.exp(-0.02 * math.pi), rel=1e-12)
    # One sheave between two falls: W = F + F e^(-μα) in hoisting.
    pull = reeving.line_pull(np.array([1000.0]), np.array([-0.1]))[0]
    assert pull == pytest.approx(1000.0 / (1.0 + math.exp(-0.02 * math.pi)), rel=1e-12)


@pytest.mark.parametrize("friction", [-0.1, 0.5, float("nan")])
def test_a_friction_that_no_sheave_has_is_refused(friction: float) -> None:
    with pytest.raises(OutOfRange):
        Reeving.over_sheaves(4, friction)


def test_the_hoist_pulls_harder_up_than_down() -> None:
    """With the friction of a reeving, in both engines: by hand where the load moves steadily."""
    reeving = Reeving.over_sheaves(4, 0.02)
    weight = 1000.0 * 9.80665
    friction = reeving.friction(weight)
    ratio = theory.capstan(0.02, math.pi)
    up = 4 / sum(ratio**-k for k in range(4)) - 1.0
    down = 1.0 - 4 / sum(ratio**k for k in range(4))
    assert friction == pytest.approx(0.5 * weight * (up + down), rel=1e-12)
    crane = load_crane(friction_hoist=friction)
    start = crane.state(l=15.0)
    raised = start.q[crane.layout.drives].copy()
    raised[crane.layout.drive("l")] = 12.0
    reference = spline(crane, start, [raised], [4.0])
    run = simulate(
        crane, follow(crane, reference, 0.005), reference, start=start, duration=2.1, drive="motion"
    )
    middle = int(np.searchsorted(run.t, 2.0))
    assert -run["F_l_N"][middle] == pytest.approx(weight + friction, rel=1e-3)


def test_a_winch_turns_with_its_line() -> None:
    winch = Winch(DRUM, Reeving(4), 100.0)
    crane = load_crane()
    start = crane.state(l=15.0)
    raised = start.q[crane.layout.drives].copy()
    raised[crane.layout.drive("l")] = 5.0
    reference = spline(crane, start, [raised], [6.0])
    run = simulate(
        crane, follow(crane, reference, 0.005), reference, start=start, duration=6.0, drive="motion"
    )
    columns = winch.columns(crane, run)
    turned = columns["drum_rad"][-1] - columns["drum_rad"][0]
    steps = np.diff(run.t) * 0.5 * (columns["drum_rad_s"][1:] + columns["drum_rad_s"][:-1])
    # The rate jumps where a layer begins, which the sum over rows of 5 ms misses by half a row.
    assert steps.sum() == pytest.approx(turned, rel=1e-3)
    at_rest = columns["line_N"][0] * columns["layer_m"][0]
    assert columns["drum_Nm"][0] == pytest.approx(at_rest, rel=0.1)
