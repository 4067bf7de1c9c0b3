"""The linear crane for MATLAB, as SciPy reads the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from cranedyn.export.matlab import linear_system, to_matlab
from tests.helpers import crane

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
