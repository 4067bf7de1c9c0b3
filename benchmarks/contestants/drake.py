"""Drake on the same URDF: a continuous plant under its semi-explicit Euler, and a discrete
plant.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, brake


def _missing() -> str | None:
    return (
        None
        if find_spec("pydrake")
        else "drake is not installed: pip install 'cranedyn[benchmarks]'"
    )


def _advanced(case: Case, *, discrete: bool) -> Run:
    """Return a run of one crane, advanced by one control period at a time."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    plant: Any = MultibodyPlant(case.dt if discrete else 0.0)
    Parser(plant).AddModelsFromString(case.crane.urdf, "urdf")
    for i in case.crane.layout.drives:
        plant.AddJointActuator(
            case.crane.layout.joints[i].name, plant.GetJointByName(case.crane.layout.joints[i].name)
        )
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -case.crane.gravity])
    plant.Finalize()
    simulator = Simulator(plant)
    if not discrete:
        ResetIntegratorFromFlags(simulator, "semi_explicit_euler", case.dt)
    context = simulator.get_mutable_context()
    port = plant.get_actuation_input_port().FixValue(context, np.zeros(3))

    def run(starts: np.ndarray, duration: float) -> Result:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(context, starts[0])
        simulator.Initialize()
        effort = brake(case, starts[0])
        log = np.empty((case.periods(duration) + 1, 13))
        state = plant.GetPositionsAndVelocities
        advance = simulator.AdvanceTo
        for k, row in enumerate(log):
            now = state(context)
            row[:10] = now
            numbers = now.tolist()
            row[10:] = effort(numbers[:5], numbers[5:])
            port.GetMutableData().get_mutable_value().SetFromVector(row[10:])
            if k < len(log) - 1:
                advance((k + 1) * case.period)
        return case.logged(log)

    return run


CONTESTANTS = (
    Contestant("Drake, continuous plant", _missing, lambda case: _advanced(case, discrete=False)),
    Contestant("Drake, discrete plant", _missing, lambda case: _advanced(case, discrete=True)),
)
