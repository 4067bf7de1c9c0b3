"""Two runs in one recording, to look at in the viewer: ``cranedyn view two_runs.rrd``."""

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.recording import Run, record
from cranedyn.references import hold, pulse, ramp

crane = cd.load_crane()
still = hold(crane, crane.start)
references = {
    "pulse of the trolley": pulse(crane, still, "x", 0.5, at=1.0, width=3.0),
    "slew by 30°": ramp(crane, still, "gamma", 0.52, rate=0.1, at=1.0),
}
runs = []
for name, reference in references.items():
    trajectory = cd.simulate(crane, hold_controller(crane), reference, duration=20.0)
    runs.append(Run(name, crane, trajectory))
path = record("two_runs.rrd", runs, title="Two runs", text="Red and blue on one clock.")
print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
