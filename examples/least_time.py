"""The fastest move of the trolley that ends without swing, beside a spline of the same time. Needs:
casadi.
"""

import math

import numpy as np

import cranedyn as cd
from cranedyn.controllers import lqr
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.plotting.figures import plot_runs
from cranedyn.references import hanging_reference, spline
from cranedyn.references.limits import Limits

crane = cd.load_crane()
start = crane.state(x=10.0)
goal = crane.state(x=15.0)
limits = Limits(rates=(0.1, 1.0, 1.0), accelerations=(0.05, 0.3, 0.3))

fastest = optimal(crane, start, goal, limits)
duration = 5e-3 * math.ceil(fastest.arrival / 5e-3)
aim = goal.q[crane.layout.drives].tolist()
smooth = hanging_reference(crane, spline(crane, start, [aim], [duration]), duration)

runs = {}
for name, motion in {"least time": fastest, "spline": smooth}.items():
    runs[name] = cd.simulate(
        crane, lqr(crane, motion, every=50), motion, start=start, duration=20.0
    )
    swing = np.abs(runs[name].since(duration)["phi_rad"]).max()
    print(f"{name:10} in {duration:.2f} s leaves {1e3 * swing:.2f} mrad")
plot_runs(runs).savefig("least_time.png")
