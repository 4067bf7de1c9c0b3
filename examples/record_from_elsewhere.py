"""A record of another program: milliseconds, degrees, other names; its period beside theory."""

import math

import numpy as np

from cranedyn.analysis.swing import fit_swing
from cranedyn.data.external import Source, read_external
from cranedyn.theory import point_period

# What somebody's sensor has written: a swing of 5° with a period of 6.35 s that decays slowly.
t = np.arange(0.0, 60.0, 0.02)
swing = 5.0 * np.exp(-1e-3 * t) * np.cos(2.0 * math.pi / 6.35 * t)
rows = np.stack([1e3 * t, swing, np.full_like(t, 10.0)], axis=1)
np.savetxt("site.csv", rows, delimiter=",", header="time,angle,rope", comments="")

names = {"t_s": Source("time", "ms"), "phi_rad": Source("angle", "deg"), "l_m": Source("rope")}
data = read_external("site.csv", ["t_s", "phi_rad", "l_m"], names)
found = fit_swing(data["t_s"], data["phi_rad"])
theory = float(point_period(data["l_m"].mean(), 9.80665))
print(f"period {found.period:.4f} s, a point on a string has {theory:.4f} s")
print(f"amplitude {math.degrees(found.amplitude):.3f}°, damping ratio {found.damping_ratio:.5f}")
