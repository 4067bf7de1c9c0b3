"""A figure for a paper: two runs in one style, as a drawing of a given width, and the numbers of
its caption.
"""

import numpy as np

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import legend_above, panels, save
from cranedyn.plotting.style import LINE_STYLES, run_colour
from cranedyn.references import hold, pulse

crane = cd.load_crane()
start = crane.state(l=10.0)
figure, (ax,) = panels(width=5.2, height=2.6)
for i, (name, width) in enumerate({"half a period": 3.2, "a whole period": 6.4}.items()):
    reference = pulse(crane, hold(crane, start), "x", 0.3, at=1.0, width=width)
    run = cd.simulate(crane, hold_controller(crane), reference, start=start, duration=25.0)
    phi = np.degrees(run["phi_rad"])
    ax.plot(run.t, phi, LINE_STYLES["phi"], color=run_colour(i), label=name)
    print(f"a pulse of {name} leaves {abs(phi[run.t > 15]).max():.2f}°")
ax.set(xlabel="time [s]", ylabel="radial swing [°]")
legend_above(ax)
save(figure, "pulses.svg")
