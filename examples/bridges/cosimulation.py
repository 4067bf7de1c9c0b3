"""The crane as an FMU in another simulator's hands: FMPy steps it under a brake written here,
beside `simulate` under the same brake.

``python examples/bridges/cosimulation.py --out FOLDER``; it needs ``pip install 'cranedyn[fmi]'
fmpy`` and a C compiler.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

from cranedyn.controllers import hold_controller
from cranedyn.export.fmi import NAME, export
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate

PERIOD = 5e-3
DURATION = 20.0
STATES = ("gamma", "x", "phi", "theta", "l", "gamma_dot", "x_dot", "phi_dot", "theta_dot", "l_dot")
COMMANDS = ("T_gamma_command", "F_x_command", "F_l_command")


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """Export, step and compare; returns the largest difference from `simulate` and how many times
    real time the stepping was.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/cosimulation"),
        help="folder for the unit, which must not be there",
    )
    out: Path = parser.parse_args(arguments).out.resolve()  # FMPy loads libraries by whole paths
    out.mkdir(parents=True, exist_ok=True)

    crane = load_crane()
    start = crane.state(x=12.0, l=11.0, phi=0.2)
    brake = hold_controller(crane)
    path = export(crane, out / "crane.fmu")
    description = fmpy.read_model_description(path)
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    unit = FMU3Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(path, out / "unpacked"),
        modelIdentifier=NAME,
        instanceName="crane",
    )
    unit.instantiate()
    unit.enterInitializationMode()
    unit.setFloat64([reference[f"{name}_start"] for name in ("x", "l", "phi")], [12.0, 11.0, 0.2])
    unit.exitInitializationMode()

    states = [reference[name] for name in STATES]
    commands = [reference[name] for name in COMMANDS]
    goal = hold(crane, start)(0.0)
    rows = []
    began = time.perf_counter()
    for k in range(round(DURATION / PERIOD) + 1):
        z = np.array(unit.getFloat64(states))
        rows.append(z)
        unit.setFloat64(
            commands, brake(k * PERIOD, State(*np.split(z, 2)), Setpoint(*goal)).tolist()
        )
        unit.doStep(k * PERIOD, PERIOD)
    speed = DURATION / (time.perf_counter() - began)
    unit.terminate()
    unit.freeInstance()

    run = simulate(
        crane, brake, start=start, duration=DURATION, control_period=PERIOD, engine="compiled"
    )
    off = float(np.abs(np.array(rows) - np.hstack([run.q, run.v])).max())
    print(
        f"largest difference from simulate in {DURATION:g} s: {off:.1e}; FMPy with the brake in "
        f"Python: {speed:.0f} times real time"
    )
    return off, speed


if __name__ == "__main__":
    main()
