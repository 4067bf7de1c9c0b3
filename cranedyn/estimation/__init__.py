"""Control without full knowledge of the state, and with the limits of the drives."""

from cranedyn.estimation.load_estimate import with_load_estimate
from cranedyn.estimation.longer_cable import with_longer_cable
from cranedyn.estimation.mpc import mpc
from cranedyn.estimation.observer import with_observer
from cranedyn.estimation.sensor_model import with_sensor_model

__all__ = ["mpc", "with_load_estimate", "with_longer_cable", "with_observer", "with_sensor_model"]
