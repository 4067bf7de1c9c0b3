"""The exporters to other programs: how long each takes to write, how exactly the other side has it,
how fast it goes there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.bridges import bags, fmi, gazebo, mcap, mjcf, ros2
from cranedyn.bridges.joints import input_names, state_names
from cranedyn.command import Parser, command
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from experiments import gazebo as recordings
from experiments import harness
from experiments.harness.document import read_document
from experiments.scenarios import programs

SETUP = harness.Setup(9.8, engine="compiled")


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
    data.qpos[:], data.qvel[:] = run.state(0)
    brake, setpoint, rows = hold_controller(crane), hold(crane, run.state(0))(0.0), []
    began = time.process_time()
    for t in run.t:
        state = State(data.qpos.copy(), data.qvel.copy())
        rows.append(np.concatenate(state))
        data.ctrl[:] = brake(t, state, setpoint)
        mujoco.mj_step(model, data, 10)
    speed = 10 * len(run) / (time.process_time() - began)
    return Comparison(
        "coordinates and rates, 20 s of swing, hold",
        float(np.abs(np.array(rows) - np.hstack([run.q, run.v])).max()),
        speed,
    )


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
    names, start = state_names(crane), run.state(0)
    states, commands = (
        [reference[name] for name in group]
        for group in (names, [f"{i}_command" for i in input_names(crane, "effort")])
    )
    unit.instantiate()
    unit.enterInitializationMode()
    unit.setFloat64([reference[f"{name}_start"] for name in names], np.concatenate(start).tolist())
    unit.exitInitializationMode()
    brake, setpoint, rows = hold_controller(crane), hold(crane, start)(0.0), []
    began = time.process_time()
    for k, t in enumerate(run.t):
        rows.append(np.array(unit.getFloat64(states)))
        unit.setFloat64(commands, brake(t, State(*np.split(rows[-1], 2)), setpoint).tolist())
        unit.doStep(k * SETUP.control_period, SETUP.control_period)
    speed = 10 * len(run) / (time.process_time() - began)
    unit.terminate()
    unit.freeInstance()
    return Comparison(
        "coordinates and rates, 20 s of swing, hold",
        float(np.abs(np.array(rows) - np.hstack([run.q, run.v])).max()),
        speed,
    )


def _mcap(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Read all coordinates and rates back."""
    columns = [
        f"{s}_{kind}"
        for s, u in (("gamma", "rad"), ("x", "m"), ("phi", "rad"), ("l", "m"))
        for kind in (u, f"dot_{u}_s")
    ]
    began = time.process_time()
    values = bags.read_joint_states(written, columns)
    speed = len(run) / (time.process_time() - began)
    return Comparison(
        "coordinates and rates, read back",
        max(float(np.abs(values[c] - run[c]).max()) for c in columns),
        speed,
    )


def _ros2(written: Path, crane: Crane, run: Trajectory) -> Comparison:
    """Compare the mass matrix of the package's URDF."""
    same = load_crane(written / "urdf" / "crane.urdf", gravity=crane.gravity)
    difference = np.abs(
        pin.crba(same.model, same.data, run.q[0]) - pin.crba(crane.model, crane.data, run.q[0])
    ).max()
    return Comparison("mass matrix of its URDF [kg, kg m, kg m²]", float(difference), None)


Exporter = tuple[
    str,
    str,
    Callable[[Path, Crane, Trajectory], object],
    Callable[[Path, Crane, Trajectory], Comparison],
]

EXPORTERS: tuple[Exporter, ...] = (
    (
        "gazebo",
        "a1",
        lambda path, crane, run: gazebo.export(path, programs.program("a1", SETUP)),
        _gazebo,
    ),
    ("ros2", "package", lambda path, crane, run: ros2.export(path, crane), _ros2),
    ("mjcf", "crane.xml", lambda path, crane, run: mjcf.export(path, crane), _mjcf),
    ("fmu", "crane.fmu", lambda path, crane, run: fmi.export(crane, path), _fmu),
    ("mcap", "run.mcap", mcap.export, _mcap),
)
"""By the word of the command line: where it writes, how, and what the other side does."""


def exporter_table() -> harness.ResultTable:
    """Measure every exporter once."""
    crane = SETUP.crane
    run = SETUP.simulate(
        crane,
        hold_controller(crane),
        None,
        start=crane.state(phi=0.1, theta=0.05),
        duration=20.0,
        label="swing",
    )
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
            size = sum(
                file.stat().st_size for file in (path.rglob("*") if path.is_dir() else [path])
            )
            rows.append(
                (
                    name,
                    1e3 * spent,
                    size / 1e3,
                    result.compared,
                    result.apart,
                    result.speed and result.speed / 1e3,
                )
            )
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
    parser = Parser(prog="python -m benchmarks.bridges", description=__doc__)
    parser.add_argument(
        "--document",
        metavar="FILE.md",
        help="put the table between its marks <!-- bridges: --> there",
    )
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    document = read_document(options.document, "bridges") if options.document else None
    result = exporter_table()
    print(result.markdown())
    if document is not None:
        document.write([result])
    return 0


if __name__ == "__main__":
    sys.exit(main())
