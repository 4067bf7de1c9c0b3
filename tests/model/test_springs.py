"""A load that yaws on two falls: both engines and batches, the real falls, and the hook."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from cranedyn import theory
from cranedyn.compiled.plant.cranes import load_cranes
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import zero_command
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import ModelError
from cranedyn.interfaces import Drive
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.validate.reading import crossing
from tests.helpers import crane, long_after

FALLS = {"fall_spacing": 2.0, "payload_izz": 500.0, "hoist_init": 6.0}
TWISTED = {"phi": 0.2, "theta": -0.1, "load_yaw": 0.9, "l_dot": -0.3}


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_both_engines_yaw_alike_and_keep_the_ledger(drive: Drive) -> None:
    c = crane(**FALLS, damp_yaw=20.0, hook_mass=200.0)
    controller = hold_controller(c) if drive == "effort" else zero_command(c)
    options: Any = {"drive": drive, "start": c.state(**TWISTED), "duration": 2.0}
    plain, compiled = (
        simulate(c, controller, engine=engine, integrator=rk4, **options)
        for engine in ("pinocchio", "compiled")
    )
    assert plain["load_yaw_rad"].min() < -0.5
    for name in ("q", "v", "effort", "energy"):
        ours = getattr(plain, name)
        theirs = getattr(compiled, name)
        assert_allclose(theirs, ours, rtol=0, atol=1e-12 * max(1.0, np.abs(ours).max()))
    # work and dissipation are summed by the trapezoidal rule
    assert np.abs(plain.unexplained).max() < 1e-5 * c.springs.energy(plain.q[0])


@pytest.mark.slow
def test_a_lane_of_a_batch_yaws_as_its_crane_does_alone() -> None:
    batches = pytest.importorskip("cranedyn.compiled.batch", reason="extra compiled")
    varied = {"fall_spacing": np.array([1.0, 2.0, 3.0]), "payload_mass": np.array([5e2, 1e3, 2e3])}
    cranes = load_cranes(**varied, phi=0.2, theta=0.0, load_yaw=0.9)
    batch = batches.simulate_batch(cranes, [hold_controller(c) for c in cranes], duration=1.0)
    for c, end in zip(cranes, batch.end.q, strict=True):
        start = c.state(phi=0.2, load_yaw=0.9)
        alone = simulate(c, hold_controller(c), start=start, duration=1.0)
        assert_allclose(end, alone.q[-1], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", long_after(1, [0.5, 0.01, 1.0]))
def test_the_period_is_that_of_two_falls_but_for_what_is_left_out(amplitude: float) -> None:
    """The energy of real falls gives the period by an integral over sin(ψ/2) = s sin u."""
    mass = 1000.0
    inertia = 500.0
    a = 1.0
    length = 6.0
    s = math.sin(amplitude / 2.0)
    c = crane(**FALLS)

    def height(yaw: float) -> float:
        return math.sqrt(length**2 - 2.0 * a**2 * (1.0 - math.cos(yaw)))

    def time(u: float) -> float:
        yaw = 2.0 * math.asin(s * math.sin(u))
        moved = inertia + mass * (a**2 * math.sin(yaw) / height(yaw)) ** 2
        left = 2.0 * mass * c.gravity * (height(yaw) - height(amplitude))
        return math.sqrt(moved / left) * 2.0 * s * math.cos(u) / math.cos(yaw / 2.0)

    start = c.state(load_yaw=amplitude)
    run = simulate(c, zero_command(c), start=start, duration=4.0, drive="motion", integrator=rk4)
    yaw = run["load_yaw_rad"]
    period = 2.0 * (crossing(run.t, yaw, 2) - crossing(run.t, yaw, 1))
    small = 2.0 * math.pi / theory.bifilar(mass, inertia, a, length, c.gravity)[1]
    assert period == pytest.approx(small * theory.amplitude_factor(amplitude), rel=1e-9)
    lift = a**2 * (1.0 - math.cos(amplitude)) / (2.0 * length**2)
    rising = mass * a**4 * math.sin(amplitude) ** 2 / (inertia * length**2)
    left_out = 4.0 * quad(time, 0.0, math.pi / 2.0 - 1e-6)[0] / period - 1.0
    assert abs(left_out) < 0.5 * (lift + rising) + 1e-5  # the integral's end


def test_two_falls_carry_the_load_that_replaces_that_of_the_crane() -> None:
    light = crane(**FALLS)
    heavy = crane(**FALLS, payload_mass=2500.0)
    changed = replace(light, model=heavy.model).springs.bifilar
    assert changed.stiffness == heavy.springs.bifilar.stiffness != light.springs.bifilar.stiffness


def test_a_hook_on_two_falls_is_where_it_hangs_on_one() -> None:
    assert [point.name for point in crane(**FALLS).points] == ["payload", "trolley"]
    hook = crane(**FALLS, hook_mass=200.0)
    assert hook.layout.joints[hook.points[2].body].name == "load_yaw_joint"
    assert hook.springs.bifilar.stiffness == pytest.approx(1200.0 * hook.gravity)  # a = 1 m
    assert "load_yaw" not in [hook.layout.symbols[i] for i in hook.swings]


@pytest.mark.parametrize(
    ("rope", "dynamics", "block", "refusal"),
    [
        (math.inf, '<dynamics damping="50"/>', "", "gives damping of 50 to rope_stretch_joint"),
        (math.inf, '<dynamics friction="9"/>', "", "gives friction of 9 to rope_stretch_joint"),
        (3e6, '<dynamics friction="9"/>', "", "gives friction of 9 to rope_stretch_joint"),
        (
            3e6,
            '<dynamics damping="50"/>',
            '<gazebo reference="rope_stretch_joint"><springStiffness>5</springStiffness></gazebo>',
            "gives a spring .springStiffness. of 5 to rope_stretch_joint",
        ),
    ],
    ids=["damping", "friction", "friction_of_an_elastic_rope", "spring_of_an_elastic_rope"],
)
def test_nothing_but_the_rope_acts_on_its_stretch(
    tmp_path: Path, rope: float, dynamics: str, block: str, refusal: str
) -> None:
    text = describe(values={"rope_stiffness": rope}, visuals=False)
    head, joint, rest = text.partition('<joint name="rope_stretch_joint"')
    rest = re.sub("<dynamics[^>]*/>", dynamics, rest, count=1)
    path = tmp_path / "rope.urdf"
    path.write_text(head + joint + rest.replace("</robot>", f"{block}</robot>"), encoding="utf-8")
    with pytest.raises(ModelError, match=refusal):
        load_crane(path)
