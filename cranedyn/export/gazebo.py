"""Gazebo Classic: a folder with the crane, the world, a plugin that runs an affine controller from
tables, and scripts that build and run it.
"""

from __future__ import annotations

import argparse
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.checks import whole
from cranedyn.clocks import Clocks, clocks
from cranedyn.command import command_line
from cranedyn.controllers import hold_controller
from cranedyn.controllers.affine import Affine
from cranedyn.errors import DataError, OutOfRange, UnknownName
from cranedyn.export.crane_data import (
    GAZEBO_LEAST_MASS,
    ExportedJoint,
    add,
    anchor_to_world,
    check_inertias,
    finite_form,
    give_light_bodies,
    joints,
    mesh_notes,
    readme,
    remove_control,
    urdf_element,
    write_length_spring,
    xml_bytes,
)
from cranedyn.export.point_masses import give_bodies_to_points
from cranedyn.export.target import new_folder
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.references import hold
from cranedyn.references.tabulated import tabulated

_TEMPLATES = Path(__file__).with_name("templates") / "gazebo"
"""Folder of the texts that do not depend on the crane: the plugin, its build and the scripts."""

TARGET = "DIR"
"""What the command line calls the target of the export."""

EXAMPLE = "gazebo_swing --gravity 9.8"
"""Example of a target, for the help of the command line."""

ARTICLE_ERP = 0.8
"""Share of the error of a constraint that ODE removes in a step, as in the article's world.

Gazebo's default is 0.2.
"""

ANGLE = 0.1
"""Angle from which a load swings, unless another is asked for [rad]."""

DURATION = 60.0
"""Duration of a swing, unless another is asked for [s]."""

SOLVERS = {"world": {"type": "world"}, "quick": {"type": "quick", "iters": "50"}}
"""Tags of the solvers of ODE by name: the exact one, of the article's world, and the iterative one,
Gazebo's default."""


@dataclass(frozen=True)
class Program:
    """Run for Gazebo, with the arguments of `cranedyn.simulation.simulate.simulate`.

    Attributes:
        crane: The crane.
        controller: Controller that is affine in the state.
        reference: Reference of the drives; None holds them at the start.
        start: Initial state.
        duration: Duration [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].
        drive: Drive mode.
    """

    crane: Crane
    controller: Controller
    reference: Reference | None
    start: State
    duration: float
    dt: float = 5e-4
    control_period: float = 5e-3
    drive: Drive = "effort"

    @property
    def clock(self) -> Clocks:
        """Clock of the run."""
        return clocks(self.duration, self.dt, self.control_period)

    def tables(self) -> Affine:
        """Return the controller as tables.

        Raises:
            DataError: If the controller is not affine, or has states of its own.
            OutOfRange: If the drives follow prescribed motion, or the affine form holds a number
                that is not finite.
        """
        if self.drive != "effort":
            allowed = "effort: another engine's joints take forces"
            raise OutOfRange("drive of a run in Gazebo", self.drive, allowed)
        clock = self.clock
        layout = self.crane.layout
        times = clock.period * np.arange(clock.periods + 1)
        reference = hold(self.crane, self.start) if self.reference is None else self.reference
        positions = tabulated(reference, times, layout.m).position
        form = finite_form(self.controller, times, positions, 2 * layout.n, clock.period, "Gazebo")
        if form.states is not None:
            raise DataError(
                f"The controller {type(self.controller).__name__} has {len(form.states)} states of "
                "its own, and the plugin for Gazebo runs gains and integrals of the drives alone; "
                "export it as C instead."
            )
        return form


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    text = "angle of the first swing joint at the start [rad] (default %(default)s)"
    parser.add_argument("--angle", type=float, default=ANGLE, metavar="RAD", help=text)
    text = "cable length at the start [m] (default: that of the crane)"
    parser.add_argument("--length", type=float, metavar="L", help=text)
    text = "duration [s] (default %(default)s)"
    parser.add_argument("--duration", type=float, default=DURATION, metavar="S", help=text)
    add_world(parser)


def add_world(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the world and of the log in it."""
    add = parser.add_argument
    add("--solver", default="world", choices=SOLVERS, help="ODE's solver")
    text = "ODE's error reduction in a step"
    add("--erp", type=float, default=ARTICLE_ERP, metavar="SHARE", help=text)
    text = "control instants from one row of the log to the next"
    add("--every", type=int, default=1, metavar="N", help=text)
    text = "set the rates of the passive joints to zero at every step"
    add("--overwritten", action="store_true", help=text)


def run(options: argparse.Namespace) -> Path:
    """Write the free swing of a crane whose drives are held, and return its folder.

    Raises:
        DataError: If the crane has no swing joint, or no hoist and a length is given.
    """
    crane = crane_from_options(options)
    if not len(crane.swings):
        raise DataError("This crane has no swing joint, so there is nothing that swings.")
    start = {crane.layout.symbols[crane.swings[0]]: options.angle}
    if options.length is not None:
        if not crane.layout.has("hoist"):
            raise DataError("This crane has no hoist; leave --length out.")
        hoist = crane.layout.role("hoist", "--length")
        start[crane.layout.symbols[hoist]] = options.length
    swinging = Program(
        crane,
        hold_controller(crane, gravity=crane.gravity),
        None,
        crane.state(**start),
        options.duration,
    )
    return export_with_options(options, swinging)


def export_with_options(options: argparse.Namespace, program: Program) -> Path:
    """Write a run with the folder and the arguments of `add_world`, and return the folder."""
    return export(
        options.target,
        program,
        solver=options.solver,
        erp=options.erp,
        every=options.every,
        overwritten=options.overwritten,
    )


def export(
    folder: str | Path,
    program: Program,
    *,
    solver: str = "world",
    erp: float = ARTICLE_ERP,
    every: int = 1,
    overwritten: bool = False,
) -> Path:
    """Write a run for Gazebo Classic 11; ``run.sh`` in the folder runs it there and writes
    ``log.csv``, with the columns of a trajectory.

    Plugins and transmissions of the crane's own file are replaced, a load on two falls has the yaw
    stiffness of the length at the start, and a hook block that is a point becomes a solid ball of
    steel; then a README.md in the folder says so.

    Args:
        folder: New folder.
        program: Run to export.
        solver: Solver of ODE, one of `SOLVERS`.
        erp: ODE's error reduction in a step, 0 to 1, see `ARTICLE_ERP`.
        every: Control instants from one row of the log to the next.
        overwritten: Whether the plugin sets the rates of the passive joints to zero at every step,
            as the article's did.

    Raises:
        DataError: If the folder exists or cannot be written, or the controller is not affine in
            the state.
        ModelError: If the crane has a link without mass or inertia, which Gazebo drops with all
            that it carries, a joint with an armature or one that follows another, or an element
            that no URDF has.
        OutOfRange: If the drives follow prescribed motion, or a number is not allowed.
        UnknownName: If there is no such solver.
    """
    folder = Path(folder)
    if solver not in SOLVERS:
        raise UnknownName("solver", solver, SOLVERS)
    if not 0.0 <= erp <= 1.0:
        raise OutOfRange("erp", erp, "0 to 1")
    every = whole("control instants between rows", every, 1)
    # Gazebo Classic does not know <mimic>: followers would move freely.
    program.crane.require_independent_joints("The export to Gazebo Classic")
    robot = urdf_element(program.crane)
    notes = mesh_notes(program.crane, robot) + remove_control(robot)
    model = anchor_to_world(program.crane, robot, "Gazebo")
    notes += write_length_spring(program.crane, robot)
    notes += give_bodies_to_points(program.crane, robot)
    give_light_bodies(program.crane, robot)
    check_inertias(program.crane, robot, "Gazebo", least_mass=GAZEBO_LEAST_MASS)
    affine = program.tables()
    moving = joints(program.crane, robot)
    tables = {
        "feed_forward": affine.feed_forward,
        "gain": affine.gain.reshape(len(affine.gain), -1),
        "setpoint": affine.setpoint,
        "target": affine.target,
        # The largest number stands for no limit.
        "integral": np.stack(
            [affine.integral_gain, np.minimum(affine.limit, np.finfo(float).max), affine.integral]
        ),
    }
    model.append(_plugin(program, moving, every, overwritten))
    sdf = world(program.crane.gravity, program.dt, solver, erp)
    (scene,) = sdf.iterfind("world")
    add(add(scene, "include"), "uri", "model://crane")
    config = ET.Element("model")
    add(config, "name", "crane")
    add(config, "version", "1.0")
    add(config, "sdf", "model.urdf", version="1.6")
    with new_folder(folder) as draft:
        shutil.copytree(_TEMPLATES, draft, dirs_exist_ok=True)
        (draft / "run.sh").chmod(0o755)
        (draft / "models" / "crane").mkdir(parents=True)
        (draft / "models" / "crane" / "model.urdf").write_bytes(xml_bytes(model))
        (draft / "models" / "crane" / "model.config").write_bytes(xml_bytes(config))
        if notes or program.crane.assumptions:
            text = readme("crane", program.crane, notes)
            (draft / "README.md").write_text(text, encoding="utf-8")
        (draft / "world.sdf").write_bytes(xml_bytes(sdf))
        for name, rows in tables.items():
            lines = [",".join(repr(number) for number in row) + "\n" for row in rows.tolist()]
            (draft / f"{name}.csv").write_text("".join(lines))
    return folder


def _plugin(
    program: Program, moving: Sequence[ExportedJoint], interval: int, overwritten: bool
) -> ET.Element:
    """Return the element of the plugin that drives the crane, with its parameters.

    Args:
        program: The run.
        moving: Joints in the order of the coordinates.
        interval: Control instants from one row of the log to the next.
        overwritten: Whether the rates of the passive joints are set to zero at every step.
    """
    clock = program.clock
    tag = ET.Element("gazebo")
    plugin = add(tag, "plugin", name="drives", filename="libcrane_drives.so")
    # The plugin reads these by their names, see the templates.
    settings = {
        "steps_per_control": clock.steps,
        "rows": clock.periods + 1,
        "rows_between_logs": interval,
        "control_period": repr(clock.period),
        "overwrite_passive_velocities": str(overwritten).lower(),
    }
    for name, value in settings.items():
        add(plugin, name, value)
    for joint, q, v in zip(moving, *program.start, strict=True):
        entry = add(plugin, "joint")
        column, rate = joint.columns
        entries = {
            "name": joint.name,
            "column": column,
            "rate_column": rate,
            "start": repr(float(q)),
            "start_rate": repr(float(v)),
        }
        if joint.driven:
            entries |= {"effort_column": joint.effort_column, "effort_limit": repr(joint.effort)}
        for name, text in entries.items():
            add(entry, name, text)
    return tag


def world(gravity: float, dt: float, solver: str, erp: float) -> ET.Element:
    """Return an empty world of Gazebo Classic, as SDF.

    Args:
        gravity: Gravity [m/s²].
        dt: Physics step [s].
        solver: Solver of ODE, one of `SOLVERS`.
        erp: Share of the error of a constraint that ODE removes in a step.
    """
    sdf = ET.Element("sdf", version="1.6")
    scene = add(sdf, "world", name="crane")
    add(scene, "gravity", f"0 0 {-gravity!r}")
    physics = add(scene, "physics", type="ode")
    add(physics, "max_step_size", repr(dt))
    add(physics, "real_time_update_rate", "0")  # as fast as it goes
    ode = add(physics, "ode")
    solver_element = add(ode, "solver")
    for name, value in SOLVERS[solver].items():
        add(solver_element, name, value)
    constraints = add(ode, "constraints")
    add(constraints, "cfm", "0")
    add(constraints, "erp", repr(erp))
    return sdf


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    run_script = options.target.absolute() / "run.sh"
    log = options.target / "log.csv"
    return [
        command_line(run_script),
        f"{command_line('cranedyn', 'run', 'a1', '--from', log)}  # once run.sh has written it",
    ]
