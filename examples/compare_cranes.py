"""Two cranes and their numbers: how gravity, load and the give of the trolley change a period."""

import cranedyn as cd
from cranedyn.analysis.prediction import free_swing
from cranedyn.controllers import hold_controller
from cranedyn.references import hold
from cranedyn.theory import point_period

cranes = {
    "one tonne": cd.load_crane(),
    "two tonnes": cd.load_crane(payload_mass=2000),
    "on the moon": cd.load_crane(gravity=1.62),
}
print(f"{'crane':12} {'T point [s]':>12} {'T predicted [s]':>16} {'more [%]':>9}")
for name, crane in cranes.items():
    start = crane.state(l=10.0)
    point = float(point_period(10.0, crane.gravity))
    swing = free_swing(
        crane,
        hold_controller(crane, gravity=crane.gravity),
        hold(crane, start),
        crane.state(l=10.0, phi=0.05),
        since=0.0,
        until=20.0,
        dt=5e-4,
        control_period=5e-3,
    )
    print(f"{name:12} {point:12.4f} {swing.period:16.4f} {100 * (swing.period / point - 1):9.3f}")
