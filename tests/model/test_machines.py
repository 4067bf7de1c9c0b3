"""The library of machines: each real crane loads, swings as its numbers say, and has a source."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cranedyn as cd
from cranedyn.__main__ import main
from cranedyn.analysis.swing import fit_swing
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.integrators import rk4
from cranedyn.model.machines import machine_names, read_machine
from cranedyn.references.limits import Limits
from cranedyn.theory import amplitude_factor, rigid_period

AMPLITUDE = 2e-3


@pytest.mark.parametrize("name", machine_names())
def test_a_machine_swings_at_the_period_and_the_damping_of_its_numbers(name: str) -> None:
    machine = read_machine(name)
    crane = cd.load_crane(machine=name)
    values = machine.values
    inertia = values.get("payload_inertia", 400.0) + 2.0 * values.get("dummy_inertia", 50.0)
    length = values.get("hoist_init", 15.0)
    mass = values.get("payload_mass", 1000.0)
    period = rigid_period(length, crane.gravity, mass, inertia)
    run = cd.simulate(
        crane,
        lambda t, state, setpoint: np.zeros(crane.layout.m),
        start=crane.state(phi=AMPLITUDE),
        duration=max(10.0, np.ceil(3.0 * period)),
        dt=1e-3,
        drive="motion",
        integrator=rk4,
        engine="compiled",
    )
    fit = fit_swing(run.t, run["phi_rad"])
    decay = values.get("damp_swing", 1.0) / (2.0 * (mass * length**2 + inertia))
    # Amplitudes differ by less than all of theirs, A²/16; a rate by the round-off of the fit.
    assert fit.decay_rate == pytest.approx(decay, abs=1e-6)
    damped = period / np.sqrt(1.0 - fit.damping_ratio**2)
    assert fit.period / damped == pytest.approx(1.0, abs=amplitude_factor(AMPLITUDE) - 1.0 + 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", machine_names())
def test_a_machine_says_its_source_and_how_sure_each_number_is(name: str) -> None:
    machine = read_machine(name)
    assert re.search(r"github\.com/\S+/\S+ at [0-9a-f]{7}, |\w\.com/", machine.source)
    assert machine.margins.keys() <= {*machine.values, *machine.accelerations}
    for key, margin in machine.margins.items():
        value = {**machine.values, **machine.accelerations}[key]
        assert 0.0 <= margin <= 0.2 * abs(value), key
        for end in (value - margin, value + margin) if key in machine.values else ():
            assert cd.load_crane(machine=name, values={key: end}).layout.m == 3


def test_values_override_a_machine_and_the_rest_stays_as_it_is() -> None:
    crane, other = (
        cd.load_crane(machine="inteco_3dcrane", values=values)
        for values in ({}, {"payload_mass": 0.5, "hoist_init": 0.8})
    )
    assert (crane.payload_mass, other.payload_mass) == (1.0, 0.5)
    assert (crane.trolley_mass, other.trolley_mass) == (1.155, 1.155)
    assert other.start.q[other.layout.index("l")] == 0.8
    (note,) = crane.assumptions
    assert note.startswith("INTECO 3DCrane") and "all is assumed but payload_mass, " in note
    heavy = cd.load_crane(machine="tower_mct2205", payload_mass=23500.0)
    assert heavy.payload_mass == 23500.0
    again = cd.load_crane(from_record={"crane": heavy.record})
    assert again.model.inertias.tolist() == heavy.model.inertias.tolist()
    assert heavy.record["arguments"]["trolley_max"] == 80.0


def test_limits_of_a_machine_are_those_of_plans_and_converters() -> None:
    crane = cd.load_crane(machine="inteco_3dcrane")
    machine = read_machine("inteco_3dcrane")
    limits = Limits(crane.rate_limit.tolist(), [*machine.accelerations.values()]).for_crane(crane)
    assert_allclose([limits.rates, limits.accelerations], [[0.3] * 3, [0.6] * 3])
    drives = converters(crane, accelerations=machine.accelerations)
    assert_allclose([drives.rates, drives.accelerations], [[0.3] * 3, [0.6] * 3])
    tower = cd.load_crane(machine="tower_hkcrc")
    brake = read_machine("tower_hkcrc").accelerations
    slew = converters(tower, accelerations=brake)
    # A stop in gear 3 took 15.05 s; the rate is known within 18 %.
    stop = slew.rates[tower.layout.drive("gamma")] / brake["gamma"]
    assert stop == pytest.approx(15.05, rel=0.2)


def test_the_command_lists_and_describes_machines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe", "--machines"]) == 0
    lines = capsys.readouterr().out.partition("Next: ")[0].splitlines()
    assert [line.split()[0] for line in lines] == machine_names()
    for name, line in zip(machine_names(), lines, strict=True):
        assert read_machine(name).title in line and read_machine(name).source in line
    assert main(["describe", "--machine", "gantry_cosys", "payload_mass:=0.1"]) == 0
    assert "Crane with a payload of 0.1 kg" in capsys.readouterr().out
    assert main(["describe", "--machine", "gantry_cosys", "--swing"]) == 2
    assert "--swing is allowed only with --urdf" in capsys.readouterr().err
