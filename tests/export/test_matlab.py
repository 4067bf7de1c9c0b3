"""The linear crane for MATLAB, as SciPy reads the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from cranedyn.controllers import hold_controller, lqr
from cranedyn.errors import CraneError
from cranedyn.export.matlab import controller_to_matlab, linear_system, to_matlab
from cranedyn.export.usual_controllers import CONTROLLERS
from cranedyn.interfaces import Setpoint, State
from cranedyn.references.flat import flat
from tests.helpers import crane
from tests.linear_laws import CRANE, PERIOD, REST, filtered

NAMES = ("states", "outputs", "input_units", "state_units", "output_units")


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_the_file_has_the_matrices_with_names_and_units(drive: str, tmp_path: Path) -> None:
    c = crane()
    state = c.state(x=12.0, l=11.0)
    settings = {"drive": drive, "control_period": 1e-2, "outputs": ["phi", "x"]}
    content = loadmat(to_matlab(tmp_path / "crane.mat", c, state, **settings))  # type: ignore[arg-type]
    system = linear_system(c, state, **settings)  # type: ignore[arg-type]
    assert len(system.a) == (16 if drive == "velocity" else 10)  # two commands on their way
    for name, matrix in (("A", system.a), ("B", system.b), ("C", system.c)):
        assert (content[name] == matrix).all()
    assert content["D"].shape == (2, 3)
    assert content["Ts"].item() == 1e-2
    assert content["z0"].ravel().tolist() == np.concatenate(state).tolist()
    lists = {name: [cell.item() for cell in content[name].ravel()] for name in NAMES}
    assert lists["states"] == system.states
    assert lists["outputs"] == ["phi", "x"]
    assert lists["output_units"] == ["rad", "m"]
    assert len(lists["state_units"]) == len(system.a)
    units = {"effort": ["N m", "N", "N"], "motion": ["rad/s^2", "m/s^2", "m/s^2"]}
    assert lists["input_units"] == units.get(drive, ["rad/s", "m/s", "m/s"])
    assert lists["state_units"][9] == "m/s"


@pytest.mark.parametrize("setpoint", ["rest", "run"])
def test_the_matrices_of_a_controller_command_what_it_commands_in_python(
    setpoint: Any, tmp_path: Path
) -> None:
    law = filtered(setpoint=setpoint, initial=np.arange(5.0))
    content = loadmat(
        controller_to_matlab(tmp_path / "law.mat", CRANE, law, control_period=PERIOD, duration=1.0)
    )
    drives = CRANE.layout.drives
    x = content["x0"][:, 0]
    z0 = content["z0"][:, 0]
    limits = content["u_limits"][:, 0]
    rng = np.random.default_rng(0)
    for k in range(40):
        z = np.concatenate(REST) + rng.normal(size=10)
        setpoints = REST.q[drives] + rng.normal(size=3)
        found = law(k * PERIOD, State(z[:5], z[5:]), Setpoint(setpoints, *np.zeros((2, 3))))
        inputs = np.concatenate([z - z0, setpoints - z0[drives]])
        u = content["u0"][:, 0] + content["C"] @ x + content["D"] @ inputs
        np.testing.assert_allclose(u, found, rtol=1e-9, atol=1e-6)  # round-off
        cut = np.clip(u, -limits, limits) - u
        x = content["A"] @ x + content["B"] @ inputs + content["anti_windup"] @ cut
    names = [cell.item() for cell in content["inputs"].ravel()]
    assert names[-4:] == ["l_dot", "gamma_set", "x_set", "l_set"]
    assert content["D"][:, 10:].any() == (setpoint == "run")
    assert [cell.item() for cell in content["output_units"].ravel()] == ["N m", "N", "N"]


def test_a_gain_is_a_system_without_states(tmp_path: Path) -> None:
    law = hold_controller(CRANE)
    content = loadmat(controller_to_matlab(tmp_path / "hold.mat", CRANE, law, duration=1.0))
    assert content["A"].shape == (0, 0) and content["D"].shape == (3, 13)
    assert content["D"][1, 1] == -law.stiffness[1] and content["D"][1, 11] == law.stiffness[1]


def moving() -> Any:
    return lqr(CRANE, flat(CRANE, CRANE.state(), CRANE.state(x=10.5), 4.0))


REFUSED: list[tuple[Callable[[], Any], str]] = [
    (moving, "Tracking changes over time"),
    (lambda: CONTROLLERS["integral"][1](CRANE, 5e-3), "HoistIntegral has integrals that stop"),
    (lambda: CONTROLLERS["observer"][1](CRANE, 5e-3), "ObserverController is not affine"),
    (filtered, "allowed is that of the controller, 0.01"),
]


@pytest.mark.parametrize(("make", "sentence"), REFUSED)
def test_a_controller_that_is_no_constant_matrix_is_refused_and_leaves_no_file(
    make: Callable[[], Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(CraneError, match=sentence):
        controller_to_matlab(tmp_path / "law.mat", CRANE, make(), duration=5.0)
    assert not list(tmp_path.iterdir())
