"""A thousand pulses at once: how the swing that is left depends on cable and pulse. Needs:
llvmlite.
"""

import numpy as np

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import panels
from cranedyn.references import hold, pulse

crane = cd.load_crane()
lengths = np.linspace(5.0, 20.0, 32)
widths = np.linspace(1.0, 9.0, 32)
references = []
starts = []
for length in lengths:
    start = crane.state(l=length)
    for width in widths:
        starts.append(start)
        references.append(pulse(crane, hold(crane, start), "x", 0.3, at=0.5, width=width))

batch = cd.simulate_batch(
    crane,
    hold_controller(crane),
    references,
    start=starts,
    duration=20.0,
    residual_from=12.0,
)
swings = np.degrees(batch.residual_swing).reshape(len(lengths), len(widths))
print(f"{swings.size} runs leave {swings.min():.2f} to {swings.max():.2f}°")

figure, (ax,) = panels(height=4.5, width=6.5)
drawn = ax.pcolormesh(widths, lengths, swings, rasterized=True)
ax.set(xlabel="width of the pulse [s]", ylabel="cable length [m]")
figure.colorbar(drawn, label="swing left [°]")
figure.savefig("batch_map.png")
