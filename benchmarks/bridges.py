"""The exporters to other programs: how long each takes to write, how exactly the other side has it,
how fast it goes there.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from benchmarks.conduct import print_tables
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError
from cranedyn.export import c_code, fmi, gazebo, mcap, mjcf_file, ros2
from cranedyn.export.usual_controllers import CONTROLLERS
from cranedyn.interfaces import State
from cranedyn.interop import bags
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references import hold
from experiments import gazebo as recordings
from experiments import harness
from experiments.scenarios import programs

SETUP = harness.Setup(9.8, engine="compiled")
"""How the run is simulated that the other side repeats."""

STEPS_OF_PERIOD = 10
"""Number of physics steps in a control period of that run."""


class Comparison(NamedTuple):
    """What the other side was seen to do.

    Attributes:
        compared: What was compared.
        apart: The largest difference [rad, m, per second].
        speed: Steps or rows a second there, None if it was not measured here.
    """

    compared: str
    apart: float
    speed: float | None


def _gazebo(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Compare recordings from Gazebo; the tests say how to record them again."""
    pairs = recordings.pairs(SETUP).values()
    worst = max(pair.largest() for pair in pairs)
    return Comparison("swing angles, A1 at four lengths and soft, A2, A3", worst, None)


def _mjcf(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Run the model with MuJoCo's own motors and step."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(written))
    data = mujoco.MjData(model)
    start = run.state(0)
    data.qpos[:] = start.q
    data.qvel[:] = start.v
    brake = hold_controller(crane)
    setpoint = hold(crane, start)(0.0)
    rows = []
    began = time.process_time()
    for t in run.t:
        state = State(data.qpos.copy(), data.qvel.copy())
        rows.append(np.concatenate(state))
        data.ctrl[:] = brake(t, state, setpoint)
        mujoco.mj_step(model, data, STEPS_OF_PERIOD)
    speed = STEPS_OF_PERIOD * len(run) / (time.process_time() - began)
    return _swing_comparison(rows, run, speed)


def _fmu(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Run the unit in FMPy under the same hold controller."""
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    description = fmpy.read_model_description(written)
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    folder = fmpy.extract(written, written.with_suffix(""))
    unit = FMU3Slave(
        guid=description.guid, unzipDirectory=folder, modelIdentifier=fmi.NAME, instanceName="crane"
    )
    names = state_names(crane)
    start = run.state(0)
    states = [reference[name] for name in names]
    commands = [reference[f"{name}_command"] for name in input_names(crane, "effort")]
    unit.instantiate()
    unit.enterInitializationMode()
    unit.setFloat64([reference[f"{name}_start"] for name in names], np.concatenate(start).tolist())
    unit.exitInitializationMode()
    brake = hold_controller(crane)
    setpoint = hold(crane, start)(0.0)
    rows = []
    began = time.process_time()
    for k, t in enumerate(run.t):
        row = np.array(unit.getFloat64(states))
        rows.append(row)
        q, v = np.split(row, 2)
        unit.setFloat64(commands, brake(t, State(q, v), setpoint).tolist())
        unit.doStep(k * SETUP.control_period, SETUP.control_period)
    speed = STEPS_OF_PERIOD * len(run) / (time.process_time() - began)
    unit.terminate()
    unit.freeInstance()
    return _swing_comparison(rows, run, speed)


def _swing_comparison(rows: list[np.ndarray], run: Trajectory, speed: float) -> Comparison:
    """Compare coordinates and rates of the other side, a row for each control instant."""
    apart = np.abs(np.array(rows) - np.hstack([run.q, run.v])).max()
    return Comparison("coordinates and rates, 20 s of swing, hold", float(apart), speed)


def _c(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Compile the folder and run its test: 2,000 steps of the crane, 200 calls of the LQR."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise CraneError("gcc is not installed")
    command = [compiler, "-O2", "-std=c99", *sorted(written.glob("*.c")), "-o", written / "test"]
    subprocess.run([str(word) for word in command], check=True)
    printed = subprocess.run([written / "test"], capture_output=True, check=True, text=True).stdout
    differences = [float(text) for text in re.findall(r"Python (\S+),", printed)]
    # Round-off decides the digits of the difference: only its power of ten is told.
    decade = 10.0 ** np.ceil(np.log10(max(differences)))
    compared = "states, 2,000 steps, and efforts of an LQR, relative, at most"
    return Comparison(compared, float(decade), None)


def _mcap(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Read all coordinates and rates back."""
    columns = [name for joint in crane.layout.joints for name in joint.columns]
    began = time.process_time()
    values = bags.read_joint_states(written, columns)
    speed = len(run) / (time.process_time() - began)
    apart = max(float(np.abs(values[name] - run[name]).max()) for name in columns)
    return Comparison("coordinates and rates, read back", apart, speed)


def _ros2(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Compare the mass matrix of the package's URDF."""
    same = load_crane(written / "urdf" / "crane.urdf", gravity=crane.gravity)
    their_mass = pin.crba(same.model, same.data, run.q[0])
    our_mass = pin.crba(crane.model, crane.data, run.q[0])
    difference = float(np.abs(their_mass - our_mass).max())
    return Comparison("mass matrix of its URDF [kg, kg m, kg m²]", difference, None)


def _law(crane: Crane) -> object:
    """Return the LQR that is exported with the C code."""
    return CONTROLLERS["lqr"][1](crane, SETUP.control_period)


Export = Callable[[Path, Crane, Trajectory], object]
Compare = Callable[[Path, Crane, Trajectory], Comparison]

EXPORTERS: tuple[tuple[str, str, Export, Compare], ...] = (
    ("gazebo", "a1", lambda path, *_: gazebo.export(path, programs.program("a1", SETUP)), _gazebo),
    ("ros2", "package", lambda path, crane, run: ros2.export(path, crane), _ros2),
    ("mjcf", "crane.xml", lambda path, crane, run: mjcf_file.export(path, crane), _mjcf),
    ("fmu", "crane.fmu", lambda path, crane, run: fmi.export(crane, path), _fmu),
    ("c", "c", lambda path, crane, run: c_code.export(crane, path, _law(crane)), _c),
    ("mcap", "run.mcap", mcap.export, _mcap),
)
"""By the word of the command line: where it writes, how, and what the other side does."""


def exporter_table() -> harness.ResultTable:
    """Measure every exporter once."""
    crane = SETUP.crane
    brake = hold_controller(crane)
    start = crane.state(phi=0.1, theta=0.05)
    run = SETUP.simulate(crane, brake, None, start=start, duration=20.0, label="swing")
    rows: list[tuple[str | float | None, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, target, write, look in EXPORTERS:
            path = Path(folder, target)
            try:
                began = time.process_time()
                write(path, crane, run)
                spent = time.process_time() - began
                result = look(path, crane, run)
            except (CraneError, ImportError) as error:
                rows.append((name, None, None, f"not here: {error}", None, None))
                continue
            files = path.rglob("*") if path.is_dir() else [path]
            size = sum(file.stat().st_size for file in files)
            speed = None if result.speed is None else result.speed / 1e3
            rows.append((name, 1e3 * spent, size / 1e3, result.compared, result.apart, speed))
    columns = [
        ("exporter", ""),
        ("written [ms]", ".0f"),
        ("size [kB]", ".0f"),
        ("compared", ""),
        ("apart", ".0e"),
        ("thousand/s", ".0f"),
    ]
    note = (
        "Processor time. Apart: the largest difference [rad, m, per second] unless said "
        "otherwise. Thousand steps or rows a second."
    )
    return harness.ResultTable("Exporters on this machine", columns, rows, note)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; 0, or 2 for bad arguments or files."""
    return print_tables("bridges", __doc__, lambda options: [exporter_table()], argv)


if __name__ == "__main__":
    sys.exit(main())
