"""Random models in MJCF beside MuJoCo: ``python -m tests.model.mjcf_comparison --count 500``.

Masses, ranges, friction, gravity, frequencies at rest and 5 s of motion are compared; a model that
MuJoCo refuses must be refused here, too. Prints how many were compared, and raises at the first
difference.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import scipy

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import natural_frequencies
from cranedyn.errors import ModelError, RunError
from cranedyn.interfaces import State
from cranedyn.model import mjcf, mjcf_compiler
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from tests.model.mjcf_models import random_model

STEP = 1e-3
"""Physics step of the compared motions [s]."""


class Counts(NamedTuple):
    """Number of models compared, of those whose motion was compared, and of those that both sides
    refuse.
    """

    compared: int
    moved: int
    refused: int


def loaded(folder: Path, text: str, **options: Any) -> Crane:
    """Return the crane of the text of an MJCF file, saved in a folder."""
    path = folder / "crane.xml"
    path.write_text(text, encoding="utf-8")
    return load_crane(path, **options)


def reference(folder: Path) -> tuple[Any, Any]:
    """What MuJoCo makes of the file that was loaded last, without limits and contacts."""
    model = mujoco.MjModel.from_xml_path(str(folder / "crane.xml"))
    for bit in ("LIMIT", "CONTACT", "FRICTIONLOSS", "ACTUATION", "EULERDAMP"):
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}"))
    model.opt.timestep = STEP
    return model, mujoco.MjData(model)


def order(crane: Crane, model: Any) -> list[int]:
    """Index among MuJoCo's joints of each joint of a crane."""
    return [model.joint(joint.name).id for joint in crane.layout.joints]


def mass_matrix(model: Any, data: Any) -> np.ndarray:
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def compare(crane: Crane, folder: Path, seed: int) -> None:
    """Compare a crane with the model that MuJoCo compiles of its file."""
    model, data = reference(folder)
    at = order(crane, model)
    limited = model.jnt_limited[at].astype(bool)
    assert np.array_equal(crane.lower[limited], model.jnt_range[at][limited, 0])
    assert np.array_equal(crane.upper[limited], model.jnt_range[at][limited, 1])
    assert crane.gravity == -model.opt.gravity[2]
    friction = np.zeros(crane.layout.n)
    if crane.friction is not None:
        friction[list(crane.friction.joints)] = crane.friction.effort
    assert np.array_equal(friction, model.dof_frictionloss[at])
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, crane.layout.n)
        data.qpos[at] = q
        mujoco.mj_forward(model, data)
        theirs = mass_matrix(model, data)[np.ix_(at, at)]
        ours = pin.crba(crane.model, crane.data, q)
        ours = np.triu(ours) + np.triu(ours, 1).T
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def compare_rest(crane: Crane, folder: Path) -> None:
    """Compare the frequencies about rest with drives locked, by differences of MuJoCo's forces."""
    model, data = reference(folder)
    at = np.array(order(crane, model))
    passive = crane.layout.passive
    if not (len(passive) and crane.rest.hangs):
        return
    joints = at[passive]
    step = 1e-5
    stiffness = np.zeros((len(passive), len(passive)))
    for column, joint in enumerate(joints):
        forces = []
        for sign in (1.0, -1.0):
            data.qpos[at] = crane.rest.q
            data.qpos[joint] += sign * step
            data.qvel[:] = 0.0
            mujoco.mj_forward(model, data)
            forces.append((data.qfrc_bias - data.qfrc_passive)[joints])
        stiffness[:, column] = (forces[0] - forces[1]) / (2.0 * step)
    data.qpos[at] = crane.rest.q
    mujoco.mj_forward(model, data)
    mass = mass_matrix(model, data)[np.ix_(joints, joints)]
    squares = scipy.linalg.eigvalsh(0.5 * (stiffness + stiffness.T), mass)
    theirs = np.sqrt(np.maximum(squares, 0.0))
    ours = natural_frequencies(crane, crane.rest.q, passive)
    # Differences of forces lose half of the digits.
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-4 * theirs.max())


def moved(crane: Crane, start: State) -> Trajectory:
    """Five seconds of a crane whose drives are held from a start on."""
    return simulate(
        crane,
        hold_controller(crane),
        start=start,
        duration=5.0,
        dt=STEP,
        control_period=5.0 * STEP,
        engine="compiled",
        validity="mark",
    )


def compare_motion(crane: Crane, folder: Path) -> bool:
    """Compare 5 s of motion with MuJoCo's under the same controller; both step by semi-implicit
    Euler, so that round-off is what differs. Dry friction is left out, since MuJoCo has a law of
    its own for it. Return whether the motion could be compared: not where it is chaotic, so that a
    start moved by 1e-12 ends elsewhere, or diverges.
    """
    crane = replace(crane, friction=None)
    model, data = reference(folder)
    at = np.array(order(crane, model))
    drives = crane.layout.drives
    q = crane.rest.q + 0.05
    nearby = crane.rest.q + 0.05 + 1e-12
    try:
        run, other = (moved(crane, State(one, np.zeros(crane.layout.n))) for one in (q, nearby))
    except RunError:
        return False
    if np.abs(run.q - other.q).max() > 1e-9:
        return False
    controller = hold_controller(crane)
    limit = crane.effort_limit
    setpoint = hold(crane, State(q, np.zeros(crane.layout.n)))(0.0)
    data.qpos[at] = run.q[0]
    mujoco.mj_forward(model, data)
    for t in run.t[:-1].tolist():
        command = controller(t, State(data.qpos[at], data.qvel[at]), setpoint)
        data.qfrc_applied[at[drives]] = np.clip(command, -limit, limit)
        for _ in range(5):
            mujoco.mj_step(model, data)
    # A start moved by 1e-12 may move the end by 1e-9; each of 5,000 steps rounds by less.
    assert np.abs(data.qpos[at] - run.q[-1]).max() < 1e-7 * max(np.abs(run.q).max(), 1.0)
    return True


def compiled_here(path: Path) -> dict[str, Any]:
    """Return the description of a model without the process of its own, which takes most of the
    time.
    """
    try:
        return mjcf_compiler.describe_model(mujoco, path)
    except (mjcf_compiler.Refused, ValueError) as error:
        raise ModelError(f"{path}: {error}") from error


def compare_random_models(count: int, folder: Path, first: int = 0) -> Counts:
    """Compare random models with MuJoCo's until a number of them was compared."""
    compared = moved = refused = 0
    with patch.object(mjcf, "_compiled", compiled_here):
        for seed in range(first, first + 10 * count):
            text = random_model(seed)
            try:
                mujoco.MjModel.from_xml_string(text)
            except ValueError:
                with pytest.raises(ModelError):
                    loaded(folder, text)
                refused += 1
                continue
            try:
                crane = loaded(folder, text)
            except ModelError as error:  # a random spring may hold a joint beyond its range
                assert "does not hang at rest" in str(error)
                continue
            compare(crane, folder, seed)
            compare_rest(crane, folder)
            moved += compare_motion(crane, folder)
            compared += 1
            if compared == count:
                break
    return Counts(compared, moved, refused)


def main(argv: Sequence[str] | None = None) -> int:
    """Compare as many models as the command line says."""
    parser = argparse.ArgumentParser(prog="python -m tests.model.mjcf_comparison")
    parser.add_argument("--count", type=int, default=500, help="models to compare")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        counts = compare_random_models(options.count, Path(folder), options.first)
    print(
        f"{counts.compared} models agree with MuJoCo, {counts.moved} of them in motion, too; "
        f"{counts.refused} are refused by both."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
