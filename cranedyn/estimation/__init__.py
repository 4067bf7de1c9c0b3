"""Control with imperfect knowledge: sensor models, observers, load estimation, MPC.

Each function returns a controller, most of them around another one. What it returns remembers
what it has seen: make a new one for each run.

Public names:
    `with_sensor_model`: a controller that sees the state late and with noise.
    `with_observer`: a Kalman filter estimates the swing from the motion of the drives alone.
    `with_load_estimate`: an extended Kalman filter also estimates load and cable, and the command
    is adapted to them.
    `mpc`: the LQR with limits of efforts, rates and swing; needs the extra ``mpc``.
    `misread.Misread`: a controller whose hoist takes the cable for shorter than it is.
    `with_longer_cable`: the same path of a load on a longer cable.

Begin with `sensor_model`, then `observer`. docs/results/control.md shows what each gains.
"""

from cranedyn.estimation.load_estimate import with_load_estimate, with_longer_cable
from cranedyn.estimation.mpc import mpc
from cranedyn.estimation.observer import with_observer
from cranedyn.estimation.sensor_model import with_sensor_model

__all__ = ["mpc", "with_load_estimate", "with_longer_cable", "with_observer", "with_sensor_model"]
