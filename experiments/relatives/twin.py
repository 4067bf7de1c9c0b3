"""A crane in MuJoCo: its exported URDF, and what a URDF's parser does not read: springs, inertia of
motors, a rope that stretches.
"""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from typing import Any

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.pinocchio import full
from cranedyn.model.crane import Crane

_LEAST = 1e-12
"""Mass [kg] and inertia [kg m²] that MuJoCo wants of bodies that have none."""


def missing() -> bool:
    """Return whether MuJoCo is not installed."""
    return find_spec("mujoco") is None


def model(crane: Crane, dt: float) -> Any:
    """Return the MjModel of a crane that steps as `simulate` does: semi-implicit Euler, no joint
    ranges, springs and damping before the step.
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(crane.urdf)
    spec.compiler.boundmass = spec.compiler.boundinertia = _LEAST
    # It looks at a cable of no length, where a point load has no inertia against swing.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = spec.compile()
    off, option = mujoco.mjtDisableBit, model.opt
    option.integrator, option.timestep, option.gravity[:] = (
        mujoco.mjtIntegrator.mjINT_EULER,
        dt,
        [0.0, 0.0, -crane.gravity],
    )
    option.disableflags |= off.mjDSBL_CONSTRAINT | off.mjDSBL_EULERDAMP
    model.dof_armature[:] = crane.model.armature
    model.jnt_stiffness[:], model.qpos_spring[:] = crane.springs.stiffness, crane.springs.rest
    return model


def deviation(crane: Crane, run: Trajectory) -> float:
    """Return how far MuJoCo goes from a run whose efforts it repeats, at most in any coordinate or
    rate [rad, m, per second].
    """
    import mujoco

    dt = float(run.parameters["dt_s"])
    mj_model = model(crane, dt)
    data, rope = mujoco.MjData(mj_model), crane.springs.rope
    data.qpos[:], data.qvel[:] = run.state(0)
    steps, worst = round(float(run.parameters["control_period_s"]) / dt), 0.0
    for k in range(len(run)):
        worst = max(
            worst,
            float(np.abs(data.qpos - run.q[k]).max()),
            float(np.abs(data.qvel - run.v[k]).max()),
        )
        acting = full(crane, run.effort[k])
        if rope is None:
            data.qfrc_applied[:] = acting
            mujoco.mj_step(mj_model, data, steps)
            continue
        for _ in range(steps):
            strain = data.qpos[rope.stretch] / data.qpos[rope.length]
            data.qfrc_applied[:] = acting
            data.qfrc_applied[rope.stretch] -= rope.stiffness * strain
            data.qfrc_applied[rope.length] += rope.stiffness * strain**2 / 2.0
            mujoco.mj_step(mj_model, data)
    return worst
