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
yielding = hold_controller(crane, stiffness=(5.0e5, 5.0e3, 3.0e4))  # a soft trolley


def after_the_load(t: float, state: cd.State, setpoint: cd.Setpoint) -> np.ndarray:
    """Efforts of slew, trolley and hoist [N m, N, N]; the swing is positive when the load lags."""
    efforts = yielding(t, state, setpoint)
    efforts[trolley] -= 2.4e5 * state.q[phi]  # 4.8 m/s of the trolley for a rad
    return efforts


runs = {
    name: cd.simulate(crane, controller, start=start, duration=30.0)
    for name, controller in {"brake alone": brake, "after the load": after_the_load}.items()
}
for name, run in runs.items():
    print(f"{name:15} swings {np.degrees(abs(run.since(24.0)['phi_rad'])).max():.3f}° in the end")
plot_runs(runs).savefig("own_controller.png")
