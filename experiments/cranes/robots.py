"""Robots of example-robot-data loaded as cranes: the same integrators and the same compiled engine
move them.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.interfaces import EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table


class RobotFile(NamedTuple):
    """A robot of example-robot-data.

    Attributes:
        file: Name of its file.
        payload: Joint that carries the last body.
        driven: Number of joints that are driven, the first ones; the others hang.
    """

    file: str
    payload: str
    driven: int


ROBOTS = (
    RobotFile("ur5_joint_limited_robot.urdf", "wrist_3_joint", 4),
    RobotFile("so100.urdf", "gripper", 4),
    RobotFile("finger_edu.urdf", "finger_middle_to_lower_joint", 2),
    RobotFile("bolt.urdf", "FR_KFE", 3),
)
"""The robots."""

ROUNDING = 1e-12
"""Largest difference between engines in half a second [rad, per second].

Light links amplify rounding of 1e-16 by the condition of their mass matrix, some 1e3.
"""

ORDER_TOLERANCE = 0.1
"""Largest difference of a measured order from 1 of semi-implicit Euler and 4 of RK4.

It is what the next power of a step of 1 ms changes.
"""

STEP = 1e-3
"""The coarser of two steps [s]."""


class Robot(NamedTuple):
    """Result of one robot.

    Attributes:
        name: Name of the robot.
        joints: Number of its joints.
        driven: Number of those that are driven.
        engines: Largest difference between compiled code and Pinocchio [rad, per second], by the
            name of the stepping rule.
        left_open: Largest energy that the ledger leaves open at a step and at half of it [J], by
            the name of the stepping rule.
    """

    name: str
    joints: int
    driven: int
    engines: dict[str, float]
    left_open: dict[str, tuple[float, float]]

    def order(self, rule: Integrator) -> float:
        """Return the power of the step with which the open energy falls."""
        coarse, fine = self.left_open[rule.name]
        return float(np.log2(coarse / fine))


def study(setup: Setup) -> Outcome:
    """Run all robots."""
    results = [_robot(robot) for robot in ROBOTS]
    return Outcome([_table(results)], [_claim(results)])


def _robot(robot: RobotFile) -> Robot:
    """Move a robot by both engines and both stepping rules."""
    files = metadata.files("example-robot-data") or []
    path = Path(str(next(file for file in files if file.name == robot.file).locate()))
    # The first joint of a Pinocchio model is the universe.
    joints = list(pin.buildModelFromUrdf(str(path)).names)[1:]
    crane = load_crane(path, payload=robot.payload, driven=joints[: robot.driven])
    engines = dict[str, float]()
    left_open = dict[str, tuple[float, float]]()
    for rule in (semi_implicit_euler, rk4):
        plain = _moved(crane, rule, "pinocchio", STEP)
        compiled = _moved(crane, rule, "compiled", STEP)
        half_step = _moved(crane, rule, "compiled", STEP / 2.0)
        engines[rule.name] = max(
            float(np.abs(plain.q - compiled.q).max()), float(np.abs(plain.v - compiled.v).max())
        )
        left_open[rule.name] = (_left_open(compiled), _left_open(half_step))
    name = robot.file.removesuffix(".urdf")
    return Robot(name, crane.layout.n, robot.driven, engines, left_open)


def _left_open(run: Trajectory) -> float:
    """Return the largest energy that the ledger leaves open [J]."""
    return float(np.abs(run.unexplained).max())


def _moved(crane: Crane, rule: Integrator, engine: EngineName, dt: float) -> Trajectory:
    """Hold a robot for half a second, pushed away from where it stands."""
    rng = np.random.default_rng(5)
    start = State(crane.start.q, rng.normal(size=crane.layout.n))
    return simulate(
        crane,
        hold_controller(crane),
        hold(crane, crane.start),
        start=start,
        duration=0.5,
        dt=dt,
        control_period=5e-3,
        validity="mark",
        integrator=rule,
        engine=engine,
    )


def _table(results: Sequence[Robot]) -> ResultTable:
    return make_table(
        "Robots of example-robot-data, loaded as cranes",
        results,
        ("robot", "", lambda r: r.name),
        ("joints", "d", lambda r: r.joints),
        ("driven", "d", lambda r: r.driven),
        ("Pinocchio - code", ".0e>1e-12", lambda r: max(r.engines.values())),
        ("unexplained, Euler [J]", ".1e", lambda r: r.left_open[semi_implicit_euler.name][0]),
        ("order", ".3f", lambda r: r.order(semi_implicit_euler)),
        ("unexplained, RK4 [J]", ".1e", lambda r: r.left_open[rk4.name][0]),
        ("order ", ".3f", lambda r: r.order(rk4)),
        note=f"Half a second under hold in steps of {1e3 * STEP:g} ms; what the ledger leaves "
        "open, and the power of the step with which that falls.",
    )


def _claim(results: Sequence[Robot]) -> Claim:
    engines = max(max(r.engines.values()) for r in results)
    texts = []
    worst = 0.0
    for rule, power in ((semi_implicit_euler, 1.0), (rk4, 4.0)):
        orders = [r.order(rule) for r in results]
        texts.append(f"{rule.name} {min(orders):.3f} to {max(orders):.3f}")
        worst = max(worst, *(abs(order - power) for order in orders))
    orders_text = ", ".join(texts)
    return Claim(
        f"{len(results)} robots move as well: both engines agree to {engines:.0e} (allowed "
        f"{ROUNDING:.0e}), and what the ledger leaves open falls with the order of the "
        f"rule: {orders_text} (within {ORDER_TOLERANCE:g} of 1 and 4).",
        engines < ROUNDING and worst < ORDER_TOLERANCE,
    )
