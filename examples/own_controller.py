"""A controller of one's own: the brake, and a trolley that goes after the load until it hangs
still.
"""

import numpy as np

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import plot_runs

crane = cd.load_crane()
phi = crane.layout.index("phi")
trolley = crane.layout.drive("x")
start = crane.state(phi=0.1)
brake = hold_controller(crane)
# The trolley is held softly, so that it can follow the load.
yielding = hold_controller(crane, stiffness=(5.0e5, 5.0e3, 3.0e4))


def after_the_load(t: float, state: cd.State, setpoint: cd.Setpoint) -> np.ndarray:
    """Efforts of slew, trolley and hoist [N m, N, N]; the swing is positive when the load lags."""
    efforts = yielding(t, state, setpoint)
    # In balance with the damping of the hold that is 4.8 m/s of the trolley for a rad.
    efforts[trolley] -= 2.4e5 * state.q[phi]
    return efforts


runs = {}
for name, controller in {"brake alone": brake, "after the load": after_the_load}.items():
    run = cd.simulate(crane, controller, start=start, duration=30.0)
    runs[name] = run
    left = np.degrees(abs(run.since(24.0)["phi_rad"])).max()
    print(f"{name:15} swings {left:.3f}° in the end")
plot_runs(runs).savefig("own_controller.png")
