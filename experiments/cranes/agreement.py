"""The same move of each crane by Pinocchio, by compiled code, by MuJoCo, and its energy ledger.

MuJoCo reads the exported URDF, and is told what a parser of URDF does not read: springs, inertia of
motors, a rope that stretches.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import over_all_joints
from cranedyn.dynamics.integrators import rk4
from cranedyn.model.crane import Crane
from cranedyn.recording import Run
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import CRANE_VARIANTS, CraneVariant, moved, variant_crane

SWING = 0.1
"""Swing of the load at the start [rad]."""

DURATION = 6.0
"""Duration of the move [s]."""

ROUNDING = 1e-12
"""Largest difference between engines [rad, m, per second].

A push of 1e-15 g moves a free drive by 2e-13 m in 6 s. Stiff springs and bodies of almost no mass,
by which sums are divided, cost a digit more.
"""

MIN_MUJOCO_MASS = 1e-12
"""Mass [kg] and inertia [kg m²] of bodies that have none: MuJoCo refuses those."""

SITES = ((0.0, 0.0), (40.0, 0.0), (80.0, 0.0), (0.0, -60.0), (40.0, -60.0), (75.0, -40.0))
"""Places of the cranes in the recording [m]."""

LEDGER_TOLERANCE = 2.4e-9
"""Largest unexplained energy of RK4 over the range of the energy.

It is (ω dt)⁴ of the fastest mode, 14 rad/s, in steps of 0.5 ms.
"""


class EngineAgreement(NamedTuple):
    """Result of one crane.

    Attributes:
        variant: The crane.
        run: The move by Pinocchio.
        engines: Largest difference between compiled code and Pinocchio [rad, m, per second].
        mujoco: Largest difference between MuJoCo and Pinocchio; None if MuJoCo is not installed.
        left_open: Largest energy that the ledger of the same move by RK4 leaves unexplained [J].
        energy: Range of the energy in that move [J].
    """

    variant: CraneVariant
    run: Trajectory
    engines: float
    mujoco: float | None
    left_open: float
    energy: float


def study(setup: Setup) -> Outcome:
    """Move every crane four times."""
    results = [_compared(variant) for variant in CRANE_VARIANTS]
    return Outcome(
        [_table(results)],
        _claims(results),
        trajectories={r.variant.name.replace(" ", "_"): r.run for r in results},
        recording=[
            Run(r.variant.name, variant_crane(r.variant), r.run, (*site, 0.0))
            for site, r in zip(SITES, results, strict=True)
        ],
    )


def _compared(variant: CraneVariant) -> EngineAgreement:
    """Move a crane by each engine."""
    crane = variant_crane(variant)
    run = _moved(crane)
    code = _moved(crane, engine="compiled")
    exact = _moved(crane, integrator=rk4, engine="compiled")
    difference = max(float(np.abs(code.q - run.q).max()), float(np.abs(code.v - run.v).max()))
    return EngineAgreement(
        variant=variant,
        run=run,
        engines=difference,
        mujoco=mujoco_deviation(crane, run) if find_spec("mujoco") else None,
        left_open=float(np.abs(exact.unexplained).max()),
        energy=float(np.ptp(exact.energy)),
    )


def _moved(crane: Crane, **options: Any) -> Trajectory:
    """Move trolley and hoist, with whatever turns or carries the jib; the load swings both ways."""
    start = moved(crane, **{crane.layout.symbols[i]: SWING for i in crane.swings})
    reference = hold(crane, start)
    distances = {"gamma": 0.2, "bridge": 1.0, "x": 1.0, "l": -0.5}
    for joint in crane.layout.driven:
        distance = distances[joint.symbol]
        rate = abs(distance) / 3.0
        reference = ramp(crane, reference, joint.symbol, distance, rate=rate, at=0.5)
    return simulate(
        crane,
        hold_controller(crane),
        reference,
        start=start,
        duration=DURATION,
        validity="mark",
        **options,
    )


def _mujoco_model(crane: Crane, dt: float) -> Any:
    """Return the MjModel of a crane that steps as `simulate` does: semi-implicit Euler, no joint
    ranges, springs and damping before the step.
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(crane.urdf)
    spec.compiler.boundmass = MIN_MUJOCO_MASS
    spec.compiler.boundinertia = MIN_MUJOCO_MASS
    # MuJoCo warns of a singular inertia: it looks at coordinates of zero, where the cable has no
    # length and a point load no inertia against swing.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = spec.compile()
    disabled = mujoco.mjtDisableBit
    option = model.opt
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.timestep = dt
    option.gravity[:] = 0.0, 0.0, -crane.gravity
    # No joint ranges, and damping by the velocity before the step, as `simulate` has it.
    option.disableflags |= disabled.mjDSBL_CONSTRAINT | disabled.mjDSBL_EULERDAMP
    model.dof_armature[:] = crane.model.armature
    model.jnt_stiffness[:] = crane.springs.stiffness
    model.qpos_spring[:] = crane.springs.rest
    return model


def mujoco_deviation(crane: Crane, run: Trajectory) -> float:
    """Return how far MuJoCo goes from a run whose efforts it repeats, at most in any coordinate or
    rate [rad, m, per second].
    """
    import mujoco

    dt = float(run.parameters["dt_s"])
    mj_model = _mujoco_model(crane, dt)
    data = mujoco.MjData(mj_model)
    rope = crane.springs.rope
    start = run.state(0)
    data.qpos[:] = start.q
    data.qvel[:] = start.v
    steps = round(float(run.parameters["control_period_s"]) / dt)
    worst = 0.0
    for k in range(len(run)):
        worst = max(
            worst,
            float(np.abs(data.qpos - run.q[k]).max()),
            float(np.abs(data.qvel - run.v[k]).max()),
        )
        acting = over_all_joints(crane, run.effort[k])
        if rope is None:
            data.qfrc_applied[:] = acting
            mujoco.mj_step(mj_model, data, steps)
            continue
        for _ in range(steps):
            # The energy of a rope of length l stretched by s is EA s²/(2 l): it pulls the stretch
            # by EA s/l, and lengthens the cable by EA (s/l)²/2.
            strain = data.qpos[rope.stretch] / data.qpos[rope.length]
            data.qfrc_applied[:] = acting
            data.qfrc_applied[rope.stretch] -= rope.stiffness * strain
            data.qfrc_applied[rope.length] += rope.stiffness * strain**2 / 2.0
            mujoco.mj_step(mj_model, data)
    return worst


def _table(results: Sequence[EngineAgreement]) -> ResultTable:
    return make_table(
        f"Three engines, {DURATION:g} s with all drives moving and the load swinging",
        results,
        ("crane", "", lambda a: a.variant.name),
        ("joints", "d", lambda a: variant_crane(a.variant).layout.n),
        ("Pinocchio - code", ".0e>1e-12", lambda a: a.engines),
        ("Pinocchio - MuJoCo", ".0e>1e-12", lambda a: a.mujoco),
        ("energy [J]", ".0f", lambda a: a.energy),
        ("unexplained [J]", ".0e", lambda a: a.left_open),
        note="Largest difference of any coordinate or rate [rad, m, per second]. "
        "Ledger by RK4: change of the energy, and what of it is unexplained.",
    )


def _claims(agreements: Sequence[EngineAgreement]) -> list[Claim]:
    engines = max(a.engines for a in agreements)
    deviations = [a.mujoco for a in agreements if a.mujoco is not None]
    share = max(a.left_open / a.energy for a in agreements)
    mujoco_text = f"{max(deviations):.0e}" if deviations else "MuJoCo is not installed"
    return [
        Claim(
            f"Pinocchio and compiled code agree on each crane to {engines:.0e} (allowed "
            f"{ROUNDING:.0e}).",
            engines < ROUNDING,
        ),
        Claim(
            "MuJoCo, on the exported URDF under the same efforts, makes the same move: "
            f"{mujoco_text} (allowed {ROUNDING:.0e}).",
            max(deviations) < ROUNDING if deviations else None,
        ),
        Claim(
            f"The ledger of each closes to {share:.0e} of what the energy changes by (allowed "
            f"{LEDGER_TOLERANCE:.0e}).",
            share < LEDGER_TOLERANCE,
        ),
    ]
