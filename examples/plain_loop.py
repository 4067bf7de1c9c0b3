"""The plain loop of cranedyn in Pinocchio alone, in 20 lines: what `cd.simulate` does for drives
that take efforts.
"""

import numpy as np
import pinocchio as pin

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.references import hold, pulse

crane = cd.load_crane()
start = crane.state(l=15.0, phi=0.05)
reference = pulse(crane, hold(crane, start), "x", 0.5, at=1.0, width=3.0)
controller = hold_controller(crane)


def plain_loop(duration: float, dt: float = 5e-4, control_period: float = 5e-3) -> np.ndarray:
    """Return the coordinates at the control instants, shape (rows, n)."""
    model = crane.model
    data = crane.model.createData()
    drives = crane.layout.drives
    q, v = start
    tau = np.zeros(model.nv)
    rows = []
    for k in range(round(duration / control_period) + 1):
        t = k * control_period
        command = controller(t, cd.State(q, v), reference(t))
        tau[drives] = np.clip(command, -crane.effort_limit, crane.effort_limit)
        rows.append(q)
        # Semi-implicit Euler: the new velocity moves the coordinates.
        for _ in range(round(control_period / dt)):
            v = v + dt * pin.aba(model, data, q, v, tau - crane.damping * v)
            q = q + dt * v
    return np.array(rows)


if __name__ == "__main__":
    run = cd.simulate(crane, controller, reference, start=start, duration=20.0)
    difference = np.abs(plain_loop(20.0) - run.q).max()
    print(f"{len(run)} rows; largest difference from cd.simulate: {difference:.1e}")
