"""Control without full knowledge of the state, and with the limits of the drives."""

from cranedyn.estimation.load_estimate import adapted
from cranedyn.estimation.longer_cable import longer
from cranedyn.estimation.mpc import mpc
from cranedyn.estimation.observer import observed
from cranedyn.estimation.sensor_model import sensed

__all__ = ["adapted", "longer", "mpc", "observed", "sensed"]
