"""Gazebo Classic: a folder with the crane, the world, a plugin that runs an affine controller from
tables, and what builds and runs it.
"""

from __future__ import annotations

import argparse
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from cranedyn.bridges.joints import ExportedJoint, check_heavy, described, grounded, joints
from cranedyn.bridges.programs import Program
from cranedyn.bridges.target import new_folder
from cranedyn.checks import whole
from cranedyn.errors import DataError, OutOfRange, UnknownName
from cranedyn.model.description import parse_values

TARGET = "DIR"

_TEMPLATES = Path(__file__).with_name("templates") / "gazebo"

SOLVERS = {"world": {"type": "world"}, "quick": {"type": "quick", "iters": "50"}}
"""Of ODE: the exact one of the article's world, and Gazebo's default."""


def export(
    folder: str | Path,
    program: Program,
    *,
    solver: str = "world",
    erp: float = 0.8,
    every: int = 1,
    overwritten: bool = False,
) -> Path:
    """Write a run for Gazebo Classic 11; ``run.sh`` in the folder makes it there and leaves
    ``log.csv``, with the columns of a trajectory.

    Args:
        folder: Where; it must not be there yet.
        program: What to run.
        solver: Of ODE, one of `SOLVERS`.
        erp: ODE's error reduction in a step, 0 to 1; 0.8 is the article's, 0.2 Gazebo's default.
        every: Control instants from one row of the log to the next.
        overwritten: Whether the plugin sets the rates of the passive joints to zero at every step,
            as the article's did.

    Raises:
        DataError: If something stands there, it cannot be written, or the controller is not affine
            in the state.
        ModelError: If the crane has a link without mass or inertia, which Gazebo drops with all
            that it carries, a joint with an armature, or what no URDF carries.
        OutOfRange: If the drives follow prescribed motion, or a number is not allowed.
        UnknownName: If there is no such solver.
    """
    folder = Path(folder)
    if solver not in SOLVERS:
        raise UnknownName("solver", solver, SOLVERS)
    if not 0.0 <= erp <= 1.0:
        raise OutOfRange("erp", erp, "0 to 1")
    every = whole("control instants between rows", every, 1)
    robot = described(program.crane)
    check_heavy(program.crane, robot, "Gazebo")
    law = program.tables("Gazebo")
    moving = joints(program.crane, robot)
    tables = {
        "feed_forward": law.feed_forward,
        "gain": law.gain.reshape(len(law.gain), -1),
        "setpoint": law.setpoint,
        "target": law.target,
        "integral": np.stack(
            [law.integral_gain, np.minimum(law.limit, np.finfo(float).max), law.integral]
        ),
    }
    model = grounded(robot, "Gazebo")
    for tag in model.findall("ros2_control"):
        model.remove(tag)
    model.append(_plugin(program, moving, every, overwritten))
    place = world(program.crane.gravity, program.dt, solver, erp)
    ET.SubElement(ET.SubElement(place[0], "include"), "uri").text = "model://crane"
    with new_folder(folder) as draft:
        shutil.copytree(_TEMPLATES, draft, dirs_exist_ok=True)
        (draft / "run.sh").chmod(0o755)
        (draft / "models" / "crane").mkdir(parents=True)
        _xml(draft / "models" / "crane" / "model.urdf", model)
        _xml(draft / "models" / "crane" / "model.config", _config())
        _xml(draft / "world.sdf", place)
        for name, rows in tables.items():
            _table(draft / f"{name}.csv", rows)
    return folder


def _plugin(
    program: Program, moving: Sequence[ExportedJoint], every: int, overwritten: bool
) -> ET.Element:
    """What the plugin is told."""
    clock, tag = program.clock, ET.Element("gazebo")
    plugin = ET.SubElement(tag, "plugin", name="drives", filename="libcrane_drives.so")
    told = {
        "steps_per_control": clock.steps,
        "rows": clock.periods + 1,
        "rows_between_logs": every,
        "control_period": repr(clock.period),
    }
    for name, value in {**told, "overwrite_passive_velocities": str(overwritten).lower()}.items():
        ET.SubElement(plugin, name).text = str(value)
    for joint, q, v in zip(moving, *program.start, strict=True):
        entry = ET.SubElement(plugin, "joint")
        column, rate = joint.columns
        described = {
            "name": joint.name,
            "column": column,
            "rate_column": rate,
            "start": repr(float(q)),
            "start_rate": repr(float(v)),
        }
        if joint.driven:
            described |= {"effort_column": joint.effort_column, "effort_limit": repr(joint.effort)}
        for name, value in described.items():
            ET.SubElement(entry, name).text = value
    return tag


def world(gravity: float, dt: float, solver: str, erp: float) -> ET.Element:
    """An empty world of Gazebo Classic: gravity [m/s²], physics step [s], one of `SOLVERS`, ODE's
    error reduction.
    """
    sdf = ET.Element("sdf", version="1.6")
    place = ET.SubElement(sdf, "world", name="crane")
    ET.SubElement(place, "gravity").text = f"0 0 {-gravity!r}"
    physics = ET.SubElement(place, "physics", type="ode")
    ET.SubElement(physics, "max_step_size").text = repr(dt)
    ET.SubElement(physics, "real_time_update_rate").text = "0"  # as fast as it goes
    ode = ET.SubElement(physics, "ode")
    chosen = ET.SubElement(ode, "solver")
    for name, value in SOLVERS[solver].items():
        ET.SubElement(chosen, name).text = value
    constraints = ET.SubElement(ode, "constraints")
    ET.SubElement(constraints, "cfm").text = "0"
    ET.SubElement(constraints, "erp").text = repr(erp)
    return sdf


def _config() -> ET.Element:
    model = ET.Element("model")
    for name, text in {"name": "crane", "version": "1.0"}.items():
        ET.SubElement(model, name).text = text
    ET.SubElement(model, "sdf", version="1.6").text = "model.urdf"
    return model


def _xml(path: Path, root: ET.Element) -> None:
    ET.indent(root)
    path.write_bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _table(path: Path, rows: np.ndarray) -> None:
    path.write_text("".join(",".join(map(repr, row)) + "\n" for row in rows.tolist()))


def add_arguments(made: argparse.ArgumentParser) -> None:
    """What its command line takes beside the folder and the crane."""
    made.add_argument(
        "--experiment", default="a1", metavar="RUN", help="what to run: a1, a2, a3, swing or move"
    )
    made.add_argument(
        "--length", type=float, metavar="L", help="cable length of a1 and swing [m] (default 15)"
    )
    made.add_argument(
        "--strategy",
        metavar="NAME",
        help="strategy of a move, such as 'flat + LQR' (default), see experiments.compare",
    )
    made.add_argument("--solver", default="world", choices=SOLVERS, help="ODE's solver")
    made.add_argument(
        "--erp", type=float, default=0.8, metavar="SHARE", help="ODE's error reduction in a step"
    )
    made.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="N",
        help="control instants from one row of the log to the next",
    )
    made.add_argument(
        "--overwritten",
        action="store_true",
        help="set the rates of the passive joints to zero at every step",
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line asks for. Its runs are those of the experiments, which stand
    above: only a command reaches up.
    """
    if options.urdf is not None:
        raise DataError(
            "--urdf has no effect here: the runs are those of this project's crane; from Python, "
            "export takes any program."
        )
    harness, programs = (
        import_module("experiments.harness"),
        import_module("experiments.scenarios.programs"),
    )
    setup = harness.Setup(options.gravity, parse_values(options.values))
    program = programs.program(
        options.experiment, setup, length=options.length, strategy=options.strategy
    )
    return export(
        options.target,
        program,
        solver=options.solver,
        erp=options.erp,
        every=options.every,
        overwritten=options.overwritten,
    )
