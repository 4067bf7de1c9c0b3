"""A reference of one's own: the trolley goes to and fro, once slowly and once in the rhythm of the
load.
"""

import math

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.interfaces import Reference
from cranedyn.plotting.figures import plot_runs
from cranedyn.theory import point_period

crane = cd.load_crane()
length = float(crane.start.q[crane.layout.index("l")])
rhythm = float(point_period(length, crane.gravity))


def to_and_fro(period: float) -> Reference:
    """Move the trolley about 10 m, 0.1 m to each side in a period [s]."""
    rate = 2.0 * math.pi / period

    def reference(t: float) -> cd.Setpoint:
        x = [
            0.1 * math.sin(rate * t),
            0.1 * rate * math.cos(rate * t),
            -0.1 * rate**2 * math.sin(rate * t),
        ]
        return cd.Setpoint([0.0, 10.0 + x[0], length], [0.0, x[1], 0.0], [0.0, x[2], 0.0])

    return reference


runs = {
    f"in {period:.1f} s": cd.simulate(
        crane, hold_controller(crane), to_and_fro(period), duration=40.0
    )
    for period in (3.0 * rhythm, rhythm)
}
for name, run in runs.items():
    print(f"{name}: {math.degrees(abs(run['phi_rad']).max()):.2f}° at most")
plot_runs(runs).savefig("own_reference.png")
