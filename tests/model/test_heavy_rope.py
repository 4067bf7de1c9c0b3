"""A rope with mass: bodies on it, its weight, and what the rest of the product makes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cranedyn as cd
from cranedyn import theory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.equations_of_motion import holding_effort, natural_frequencies
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, describe
from cranedyn.model.heavy_rope import bodies_for, chain_frequencies, rope_bends, rope_bodies
from cranedyn.model.load import load_crane
from cranedyn.recording.shapes import rope_line
from tests.helpers import FAST

POINT: dict[str, Any] = {
    "payload_inertia": 0.0,
    "dummy_mass": 0.0,
    "dummy_inertia": 0.0,
    "damp_swing": 0.0,
}

OTHERS = ["luffing_crane", "mobile_crane", "overhead_crane"]


def _heavy(**values: Any) -> Crane:
    return load_crane(**{**POINT, "falls": 4, "rope_mass": 1.3, **values})


@pytest.mark.parametrize("direction", [0, 1])
def test_frequencies_are_those_of_bodies_on_a_line(direction: int) -> None:
    """Of the whole model, beside a chain of springs by hand; along the jib and across it."""
    crane = _heavy(rope_bodies=4)
    swings = [crane.layout.index(("phi", "theta")[direction]), *rope_bends(crane)[direction::2]]
    found = natural_frequencies(crane, crane.start.q, np.array(swings))
    expected = chain_frequencies(4, 15.0, 5.2, 1000.0, crane.gravity)
    # Across the jib the trolley and the upper structure stand still, too: drives are locked.
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("name", OTHERS)
def test_other_cranes_have_the_rope_too(name: str) -> None:
    # The mobile crane counts the mass of each of its falls.
    falls = 6.0 if name == "mobile_crane" else 1.0
    crane = load_crane(
        XACRO.with_name(f"{name}.urdf.xacro"),
        values={
            "rope_mass": 12.0 / falls,
            "rope_bodies": 3,
            "payload_inertia": 1e-6,
            "payload_mass": 1500.0,
            "dummy_mass": 1e-6,
            "dummy_inertia": 1e-6,
        },
    )
    length = float(crane.start.q[crane.layout.index("l")])
    bends = rope_bends(crane)[1::2]
    found = natural_frequencies(
        crane, crane.start.q, np.array([crane.layout.index("theta"), *bends])
    )
    expected = chain_frequencies(3, length, 12.0, 1500.0, crane.gravity)
    # The links between the swing joints weigh a milligram.
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_more_bodies_come_as_the_square_to_the_heavy_rope() -> None:
    exact = theory.heavy_rope(15.0, 5.2, 1000.0, 9.80665, 3)
    errors = [chain_frequencies(n, 15.0, 5.2, 1000.0, 9.80665)[:3] / exact - 1.0 for n in (20, 40)]
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.02)


def test_a_heavy_rope_without_load_has_the_zeros_of_a_bessel_function() -> None:
    """Zeros of J₀ by Abramowitz and Stegun (1964), table 9.5."""
    zeros = 2.0 * theory.heavy_rope(15.0, 5.0, 1e-9, 9.80665, 4) / np.sqrt(9.80665 / 15.0)
    published = [2.4048255577, 5.5200781103, 8.6537279129, 11.7915344391]
    # The load of a microgram shifts them by about a share of it.
    np.testing.assert_allclose(zeros, published, rtol=1e-9)


def test_a_light_rope_swings_as_a_pendulum() -> None:
    """ω² = (g/l)(1 + ε/6) to first order in the mass of the rope over that of the load."""
    share = 1e-5
    found = theory.heavy_rope(10.0, share * 1000.0 / 10.0, 1000.0, 9.80665)[0]
    expected = np.sqrt(9.80665 / 10.0 * (1.0 + share / 6.0))
    assert found == pytest.approx(expected, rel=share**2)


@pytest.mark.parametrize(
    "bad", [(0.0, 1.0, 1.0, 9.8), (1.0, -1.0, 1.0, 9.8), (1.0, 1.0, np.nan, 1)]
)
def test_a_heavy_rope_of_no_meaning_is_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(OutOfRange):
        theory.heavy_rope(*bad)


def test_bodies_for_an_error_leave_it() -> None:
    for error in (1e-2, 1e-3, 1e-4):
        count = bodies_for(error, 15.0, 5.2, 200.0, 9.80665)
        exact = theory.heavy_rope(15.0, 5.2, 200.0, 9.80665)[0]
        assert abs(chain_frequencies(count, 15.0, 5.2, 200.0, 9.80665)[0] / exact - 1.0) <= error
        if count > 1:
            fewer = chain_frequencies(count - 1, 15.0, 5.2, 200.0, 9.80665)[0]
            assert abs(fewer / exact - 1.0) > error
    with pytest.raises(OutOfRange, match="mode 40 needs more than 100 bodies"):
        bodies_for(1e-6, 15.0, 5.2, 200.0, 9.80665, 40)


@pytest.mark.parametrize("length", [5.0, 15.0, 25.0])
def test_the_hoist_holds_the_rope_that_hangs(length: float) -> None:
    crane = _heavy(rope_mass_length=12.0)
    q = crane.hanging(crane.state(l=length).q)
    held = holding_effort(crane, q)[crane.layout.drive("l")]
    assert held == pytest.approx(-(1000.0 + 5.2 * length) * crane.gravity, rel=1e-12)


def test_bodies_lie_evenly_on_the_rope() -> None:
    crane = _heavy(rope_bodies=3)
    q = crane.hanging(crane.state(l=12.0).q)
    line = rope_line(crane, q[None])[0]
    below = line[0, 2] - line[:, 2]
    np.testing.assert_allclose(below, [0.0, 2.0, 6.0, 10.0, 12.0], atol=1e-12)
    masses = [crane.model.inertias[body + 1].mass for body in rope_bodies(crane)]
    np.testing.assert_allclose(masses, 4 * 1.3 * 15.0 / 3)


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_both_engines_move_it_alike(drive: Any) -> None:
    crane = _heavy()
    start = crane.state(phi=0.1, theta=-0.05)
    count = crane.layout.m

    def command(t: float, *_: object) -> np.ndarray:
        wave = np.array([0.02, 0.3, 0.1]) * np.sin(t)
        if drive == "motion":
            return wave
        return holding_effort(crane, start.q) + 1e3 * wave[:count]

    runs = [
        cd.simulate(crane, command, start=start, duration=1.0, drive=drive, engine=engine)
        for engine in ("pinocchio", FAST)
    ]
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-11)


def test_its_energy_adds_up() -> None:
    """What the hoist pays out is energy like any other: with RK4 nothing is left unexplained."""
    from cranedyn.dynamics.integrators import rk4

    crane = _heavy()
    hoist = crane.layout.drive("l")

    def command(t: float, *_: object) -> np.ndarray:
        accelerations = np.zeros(crane.layout.m)
        accelerations[hoist] = -0.5 * np.cos(t)
        return accelerations

    run = cd.simulate(
        crane,
        command,
        start=crane.state(phi=0.1),
        duration=3.0,
        drive="motion",
        integrator=rk4,
        engine=FAST,
    )
    work = np.abs(run["W_l_J"]).max()
    assert work > 1e3
    # The hoist moves the load up and down by kilojoules; RK4 leaves its error of fourth order.
    assert np.abs(run.unexplained).max() < 1e-6 * work


def test_it_stretches_if_it_has_a_stiffness() -> None:
    pytest.importorskip("llvmlite", reason="the extra compiled is not installed")
    crane = _heavy(rope_stiffness=2e7)
    stretch = crane.start.q[crane.layout.index("rope_stretch")]
    # All of the stretch is in the last piece, which carries the load alone.
    assert stretch == pytest.approx(1000.0 * crane.gravity * 15.0 / (4 * 2e7), rel=1e-6)
    run = cd.simulate(
        crane,
        lambda t, *_: np.zeros(crane.layout.m),
        start=crane.state(phi=0.05),
        duration=1.0,
        drive="motion",
    )
    assert np.isfinite(run.q).all()


def test_a_rope_with_mass_that_only_goes_slack_is_refused() -> None:
    with pytest.raises(ModelError, match="as those of a rope with mass do"):
        _heavy(rope_stiffness=np.inf)


def test_a_crane_without_mass_of_the_rope_has_no_bodies() -> None:
    crane = load_crane()
    assert rope_bodies(crane) == ()
    assert rope_bends(crane) == ()
    assert crane.springs.rope_mass is None


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("<ropeMassLength>15.0</ropeMassLength>", "", "need each other"),
        (
            "<ropeMassLength>",
            "<springStiffness>100</springStiffness><ropeMassLength>",
            "a spring and a rope with mass",
        ),
        ("<ropeMass>5.2</ropeMass>", "<ropeMass>-1</ropeMass>", "ropeMass of hoist_joint"),
        (
            '<gazebo reference="hoist_joint"><ropeMass>',
            '<gazebo reference="trolley_joint"><ropeMass>',
            "it must be the hoist",
        ),
    ],
)
def test_a_file_that_describes_it_wrongly_is_refused(
    tmp_path: Path, before: str, after: str, message: str
) -> None:
    text = describe(XACRO, {"rope_mass": 1.3, "falls": 4})
    text = "".join(line.strip() for line in text.splitlines())
    assert before in text
    path = tmp_path / "crane.urdf"
    path.write_text(text.replace(before, after), encoding="utf-8")
    with pytest.raises(CraneError, match=message):
        load_crane(path)


def test_a_heavier_load_on_it_is_the_same_crane_again() -> None:
    """A record carries the rope."""
    crane = _heavy(payload_mass=2000.0)
    again = load_crane(from_record={"crane": crane.record})
    assert again.springs.rope_mass == crane.springs.rope_mass
    np.testing.assert_array_equal(again.start.q, crane.start.q)


def test_the_pivot_is_where_the_rope_begins() -> None:
    crane = _heavy()
    assert crane.layout.points[1] == "trolley"
    np.testing.assert_allclose(point_paths(crane, crane.start.q[None])[0, 1], [0.0, -10.0, 28.0])
