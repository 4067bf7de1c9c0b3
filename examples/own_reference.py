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
        position = 0.1 * math.sin(rate * t)
        speed = 0.1 * rate * math.cos(rate * t)
        acceleration = -0.1 * rate**2 * math.sin(rate * t)
        # Slew, trolley and cable: positions, rates and accelerations.
        return cd.Setpoint(
            [0.0, 10.0 + position, length], [0.0, speed, 0.0], [0.0, acceleration, 0.0]
        )

    return reference


runs = {}
for period in (3.0 * rhythm, rhythm):
    run = cd.simulate(crane, hold_controller(crane), to_and_fro(period), duration=40.0)
    runs[f"in {period:.1f} s"] = run
for name, run in runs.items():
    print(f"{name}: {math.degrees(abs(run['phi_rad']).max()):.2f}° at most")
plot_runs(runs).savefig("own_reference.png")
