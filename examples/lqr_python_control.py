"""LQR by python-control on the crane's own linear model, run on the full multibody. Needs:
control.
"""

import control
import numpy as np

import cranedyn as cd
from cranedyn.controllers import Tracking
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import sampled

crane = cd.load_crane()
goal = crane.state(x=12.0)
# With z the deviations of coordinates and rates, z after one control period is a z + b u.
model = sampled(crane, goal)

q = np.diag([100.0, 10.0, 100.0, 100.0, 10.0, 20.0, 2.0, 100.0, 100.0, 2.0]) ** 2
r = np.diag([1 / 2.0e4, 1 / 1.0e3, 1 / 1.0e3]) ** 2
gain, _, poles = control.dlqr(model.a, model.b, q, r)
print(f"slowest pole of the closed loop: {abs(poles).max():.6f} a control period")

effort = np.atleast_2d(holding_effort(crane, goal.q))
lqr = Tracking(model.period, effort, np.asarray(gain)[None], np.concatenate(goal)[None])
run = cd.simulate(crane, lqr, start=crane.state(x=11.5, phi=0.05), duration=20.0)
print(
    f"off the goal by {1e3 * abs(run['x_m'][-1] - 12.0):.3f} mm, swing "
    f"{1e3 * abs(run['phi_rad'][-1]):.4f} mrad"
)
cd.plot(run, "x_m", "phi_rad", "F_x_N").savefig("lqr.png")
