"""The first run: another load, a pulse of the trolley, what is printed, a table and a figure."""

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.references import hold, pulse

crane = cd.load_crane(payload_mass=2000)
start = crane.state(x=12.0, l=10.0)
reference = pulse(crane, hold(crane, start), "x", 0.5, at=1.0, width=3.2)
run = cd.simulate(crane, hold_controller(crane), reference, start=start, duration=20.0)

print(crane)
print(run)
run.write("first_run.csv")
cd.plot(run).savefig("first_run.png", dpi=110)
