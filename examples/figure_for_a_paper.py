"""A figure for a paper: the swing of two runs in one panel, as wide as a column, with letters of
8 points, and the numbers of its caption.
"""

import numpy as np

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import plot_runs, save
from cranedyn.references import hold, pulse

crane = cd.load_crane()
start = crane.state(l=10.0)
runs = {}
for name, width in {"half a period": 3.2, "a whole period": 6.4}.items():
    reference = pulse(crane, hold(crane, start), "x", 0.3, at=1.0, width=width)
    run = cd.simulate(crane, hold_controller(crane), reference, start=start, duration=25.0)
    left = np.degrees(abs(run.since(15.0)["phi_rad"]).max())
    print(f"a pulse of {name} leaves {left:.2f}°")
    runs[name] = run

figure = plot_runs(runs, "phi_rad", width=3.5, height=2.2, font_size=8.0)  # [inch], [points]
figure.axes[0].set_ylabel("radial swing [°]")
save(figure, "pulses.pdf", "pulses.svg")
