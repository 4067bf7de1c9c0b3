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

ROBOTS = {
    "ur5_joint_limited_robot.urdf": ("wrist_3_joint", 4),
    "so100.urdf": ("gripper", 4),
    "finger_edu.urdf": ("finger_middle_to_lower_joint", 2),
    "bolt.urdf": ("FR_KFE", 3),
}
"""Files, the joint that carries the last body, and how many of the joints, the first, are driven;
the others hang."""

ROUNDING = 1e-12
"""Between engines in half a second [rad, per second]: light links amplify rounding of 1e-16 by
their mass matrix's condition, some 1e3."""

ORDER = 0.1
"""How far a measured order may be from 1 of semi-implicit Euler and 4 of RK4: what the next power
of a step of 1 ms changes."""

STEP = 1e-3
"""The coarser of two steps [s]."""


class Robot(NamedTuple):
    """What one robot shows.

    Attributes:
        name: Which.
        joints: How many.
        driven: How many of them are driven.
        engines: Largest difference of compiled code and Pinocchio, by stepping rule [rad, per
            second].
        open: Energy that the ledger leaves open at a step and at half of it, by stepping rule, at
            most [J].
    """

    name: str
    joints: int
    driven: int
    engines: dict[str, float]
    open: dict[str, tuple[float, float]]

    def order(self, rule: Integrator) -> float:
        """Return the power of the step with which the open energy falls."""
        coarse, fine = self.open[rule.name]
        return float(np.log2(coarse / fine))


def study(setup: Setup) -> Outcome:
    """Run all robots."""
    results = [_robot(name, payload, driven) for name, (payload, driven) in ROBOTS.items()]
    return Outcome([_table(results)], [_claim(results)])


def _robot(name: str, payload: str, driven: int) -> Robot:
    files = metadata.files("example-robot-data") or []
    path = Path(str(next(file for file in files if file.name == name).locate()))
    joints = list(pin.buildModelFromUrdf(str(path)).names)[1:]
    crane = load_crane(path, payload=payload, driven=joints[:driven])
    engines = dict[str, float]()
    open_energy = dict[str, tuple[float, float]]()
    for rule in (semi_implicit_euler, rk4):
        runs = [_moved(crane, rule, engine, STEP) for engine in ("pinocchio", "compiled")]
        engines[rule.name] = max(
            float(np.abs(a - b).max())
            for a, b in zip(*((run.q, run.v) for run in runs), strict=True)
        )
        open_energy[rule.name] = _open(runs[1]), _open(_moved(crane, rule, "compiled", STEP / 2.0))
    return Robot(name.removesuffix(".urdf"), crane.layout.n, driven, engines, open_energy)


def _open(run: Trajectory) -> float:
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
        ("unexplained, Euler [J]", ".1e", lambda r: r.open[semi_implicit_euler.name][0]),
        ("order", ".3f", lambda r: r.order(semi_implicit_euler)),
        ("unexplained, RK4 [J]", ".1e", lambda r: r.open[rk4.name][0]),
        ("order ", ".3f", lambda r: r.order(rk4)),
        note=f"Half a second under hold in steps of {1e3 * STEP:g} ms; what the ledger leaves "
        "open, and the power of the step with which that falls.",
    )


def _claim(results: Sequence[Robot]) -> Claim:
    engines = max(max(r.engines.values()) for r in results)
    orders = {rule.name: [r.order(rule) for r in results] for rule in (semi_implicit_euler, rk4)}
    orders_text = ", ".join(
        f"{name} {min(values):.3f} to {max(values):.3f}" for name, values in orders.items()
    )
    off = max(
        abs(order - power)
        for values, power in zip(orders.values(), (1.0, 4.0), strict=True)
        for order in values
    )
    return Claim(
        f"{len(results)} robots move as well: both engines agree to {engines:.0e} (allowed "
        f"{ROUNDING:.0e}), and what the ledger leaves open falls with the order of the "
        f"rule: {orders_text} (within {ORDER:g} of 1 and 4).",
        engines < ROUNDING and off < ORDER,
    )
