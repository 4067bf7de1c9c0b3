"""A gust on the load: how far it goes, and what the energy ledger says of it."""

import math

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.disturbances.wind import cosine_gust, wind

crane = cd.load_crane()
# 5 m/s, and 15 m/s at the height of the gust; it blows across the jib.
speed = cosine_gust(lambda t: 5.0, 10.0, at=5.0, lasts=6.0)
blow = wind(crane, speed, direction=0.0, payload_area=8.0)

run = cd.simulate(crane, hold_controller(crane), duration=20.0, disturbance=blow)
print(f"the load goes {math.degrees(abs(run['theta_rad']).max()):.2f}° across the jib")
print(f"work of the wind {run['W_force_J'][-1]:.1f} J, unexplained {run.unexplained[-1]:+.3f} J")
cd.plot(run, "theta_rad", "payload_force_x_N", "W_force_J").savefig("wind.png")
