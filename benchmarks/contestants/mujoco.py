"""MuJoCo on the same URDF: stepped from Python for one crane, rolled out on all processors for
many.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, brake


def twin(urdf: str, *, gravity: float, dt: float) -> Any:
    """Return a crane as an MjModel that steps as `simulate` does.

    Semi-implicit Euler, damping at the velocity before the step, no joint ranges.

    Args:
        urdf: Plain URDF.
        gravity: Along -Z [m/s²].
        dt: Physics step [s].
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(urdf)
    # MuJoCo takes no link without mass, such as those between the joints of a sling.
    spec.compiler.boundmass = 1e-9
    spec.compiler.boundinertia = 1e-9
    model = spec.compile()
    option = model.opt
    disable = mujoco.mjtDisableBit
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.timestep = dt
    option.gravity[:] = [0.0, 0.0, -gravity]
    # MuJoCo's Euler method would take the damping implicitly.
    option.disableflags |= disable.mjDSBL_CONSTRAINT | disable.mjDSBL_EULERDAMP
    return model


def _missing() -> str | None:
    """Return why MuJoCo cannot run here, None if it can."""
    if find_spec("mujoco"):
        return None
    return "mujoco is not installed: pip install 'cranedyn[mujoco]'"


def _stepped(case: Case, at_once: int) -> Run:
    """Return a run of one crane with several physics steps in each call of `mj_step`."""
    import mujoco

    model = twin(case.crane.urdf, gravity=case.crane.gravity, dt=case.dt)
    data = mujoco.MjData(model)
    step = mujoco.mj_step
    calls = range(case.steps // at_once)
    n = case.n

    def run(starts: np.ndarray, duration: float) -> Result:
        mujoco.mj_resetData(model, data)
        q = data.qpos
        v = data.qvel
        tau = data.qfrc_applied
        q[:], v[:] = np.split(starts[0], 2)
        slew, trolley, hoist = case.crane.layout.drives.tolist()
        effort = brake(case, starts[0])
        log = np.empty((case.periods(duration) + 1, 2 * n + 3))
        for k, row in enumerate(log):
            row[:n] = q
            row[n : 2 * n] = v
            row[2 * n :] = tau[slew], tau[trolley], tau[hoist] = effort(q.tolist(), v.tolist())
            if k < len(log) - 1:
                for _ in calls:
                    step(model, data, at_once)
        return case.logged(log)

    return run


def _rolled_out(case: Case) -> Run:
    """Return a run of many cranes, rolled out by one control period at a time.

    A controller inside the model would be asked at every physics step, which is another controller.
    """
    import mujoco
    from mujoco.rollout import Rollout

    model = twin(case.crane.urdf, gravity=case.crane.gravity, dt=case.dt)
    threads = os.cpu_count() or 1
    n = case.n
    datas = [mujoco.MjData(model) for _ in range(threads)]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    force = mujoco.mjtState.mjSTATE_QFRC_APPLIED
    rollout = Rollout(nthread=threads)
    hold = case.controller
    limit = case.crane.effort_limit

    def run(starts: np.ndarray, duration: float) -> Result:
        drives = case.crane.layout.drives
        count = len(starts)
        setpoint = starts[:, drives]
        # A state of MuJoCo begins with the time.
        state = np.zeros((count, mujoco.mj_stateSize(model, full)))
        state[:, 1 : 1 + 2 * n] = starts
        states = np.empty((count, case.steps, state.shape[1]))
        sensors = np.empty((count, case.steps, 0))
        tau = np.zeros((count, 1, n))
        peaks = case.swing(starts)
        for _ in range(case.periods(duration)):
            rows = state[:, 1 : 1 + 2 * n]
            offset = setpoint - rows[:, drives]
            rates = rows[:, n + drives]
            effort = hold.feed_forward + hold.stiffness * offset - hold.damping * rates
            tau[:, 0, drives] = np.clip(effort, -limit, limit)
            rollout.rollout(
                model,
                datas,
                state,
                tau,
                control_spec=int(force),
                nstep=case.steps,
                state=states,
                sensordata=sensors,
            )
            state = states[:, -1].copy()
            peaks = np.maximum(peaks, case.swing(state[:, 1 : 1 + 2 * n]))
        return Result(state[:, 1 : 1 + 2 * n].copy(), peaks)

    return run


CONTESTANTS = (
    Contestant(
        "MuJoCo, mj_step of a control period",
        _missing,
        lambda case: _stepped(case, case.steps),
        any_crane=True,
    ),
    Contestant(
        "MuJoCo, mj_step of each step", _missing, lambda case: _stepped(case, 1), any_crane=True
    ),
    Contestant(
        f"MuJoCo, rollout of control periods, {os.cpu_count()} threads",
        _missing,
        _rolled_out,
        many=True,
        any_crane=True,
    ),
)
