"""PyBullet on the same URDF, stepped from Python."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, brake


def _missing() -> str | None:
    """Return why PyBullet cannot run here, None if it can."""
    if find_spec("pybullet"):
        return None
    return (
        "pybullet is not installed: pip install 'cranedyn[benchmarks]' (its wheel is for "
        "Python 3.11)"
    )


def _weighed(urdf: str) -> str:
    """Return the URDF with explicit zero masses for massless links; Bullet would assume 1 kg and
    warn.
    """
    robot = ET.fromstring(urdf)
    for link in robot.iterfind("link"):
        if link.find("inertial") is None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value="0")
            zeros = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
            ET.SubElement(inertial, "inertia", zeros)
    return ET.tostring(robot, encoding="unicode")


def _stepped(case: Case, at_once: int) -> Run:
    """Return a run of one crane with several physics steps in each call of `stepSimulation`.

    Bullet forgets torques after each call. With several steps in a call it holds the damping of the
    joints over all of them, too.
    """
    import pybullet as bullet

    setup = bullet.connect(bullet.DIRECT)
    here = {"physicsClientId": setup}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crane.urdf"
        path.write_text(_weighed(case.crane.urdf), encoding="utf-8")
        from_file = bullet.URDF_USE_INERTIA_FROM_FILE
        robot = bullet.loadURDF(str(path), useFixedBase=True, flags=from_file, **here)
    bullet.setGravity(0.0, 0.0, -case.crane.gravity, **here)
    substeps = at_once if at_once > 1 else 0
    bullet.setPhysicsEngineParameter(fixedTimeStep=at_once * case.dt, numSubSteps=substeps, **here)
    joint_index = {
        bullet.getJointInfo(robot, i, **here)[1].decode(): i
        for i in range(bullet.getNumJoints(robot, setup))
    }
    joints = [joint_index[joint.name] for joint in case.crane.layout.joints]
    drives = [joints[i] for i in case.crane.layout.drives]
    none = {"linearDamping": 0.0, "angularDamping": 0.0, "maxJointVelocity": 1e9}
    for i in range(-1, len(joint_index)):
        bullet.changeDynamics(robot, i, **none, **here)
    for joint, damping in zip(joints, case.crane.damping, strict=True):
        bullet.changeDynamics(robot, joint, jointDamping=damping, **here)
    # A velocity motor without force: otherwise Bullet brakes each joint.
    still = [0.0] * len(joints)
    bullet.setJointMotorControlArray(robot, joints, bullet.VELOCITY_CONTROL, forces=still, **here)
    states = bullet.getJointStates
    control = bullet.setJointMotorControlArray
    torque = bullet.TORQUE_CONTROL
    step = bullet.stepSimulation
    calls = range(case.steps // at_once)

    def run(starts: np.ndarray, duration: float) -> Result:
        for joint, q, v in zip(joints, starts[0, :5], starts[0, 5:], strict=True):
            bullet.resetJointState(robot, joint, q, v, physicsClientId=setup)
        effort = brake(case, starts[0])
        log = np.empty((case.periods(duration) + 1, 13))
        for k, row in enumerate(log):
            q, v, _, _ = zip(*states(robot, joints, setup), strict=True)
            tau = effort(q, v)
            row[:5] = q
            row[5:10] = v
            row[10:] = tau
            if k < len(log) - 1:
                for _ in calls:
                    control(robot, drives, torque, forces=tau, physicsClientId=setup)
                    step(setup)
        return case.logged(log)

    return run


CONTESTANTS = (
    Contestant(
        "PyBullet, substeps of a control period", _missing, lambda case: _stepped(case, case.steps)
    ),
    Contestant("PyBullet, each step", _missing, lambda case: _stepped(case, 1)),
)
