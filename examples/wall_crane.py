"""A crane of your own, from its URDF: held, swept, recorded: ``python examples/wall_crane.py``."""

import sys
from pathlib import Path

import numpy as np

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers.lqr import lqr
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.references import hold
from cranedyn.references.motion import hanging_reference
from cranedyn.simulation.simulate import simulate

# Joints of the URDF by the parts that they play in a tower crane.
ROLES = {"slew": "bracket", "trolley": "carriage", "hoist": "winch"}
SWINGS = {"radial_swing": "sway", "tangential_swing": "surge"}


def main(folder: Path) -> None:
    """Run it; what comes of it goes into a folder."""
    urdf = Path(__file__).with_name("wall_crane.urdf")
    crane = load_crane(urdf, joints=ROLES | SWINGS, driven=list(ROLES.values()))
    reference = hanging_reference(crane, hold(crane, crane.state(x=4.0, l=2.5)), duration=0.01)
    controller = lqr(crane, reference)
    start = crane.state(x=4.0, l=2.5, phi=0.1, theta=-0.1)
    run = simulate(crane, controller, reference, start=start, duration=20.0)
    phi, theta = run.since(15.0).coordinates("phi", "theta").T
    left = np.hypot(phi, theta).max()
    print(f"A swing of {1e3 * np.hypot(0.1, 0.1):.0f} mrad: {1e3 * left:.2f} mrad in the last 5 s.")
    starts = []
    for phi in np.linspace(-0.2, 0.2, 20):
        for theta in np.linspace(-0.2, 0.2, 20):
            starts.append(crane.state(x=4.0, l=2.5, phi=phi, theta=theta))
    batch = simulate_batch(
        crane, controller, reference, start=starts, duration=20.0, residual_from=15.0
    )
    print(f"From {len(batch)} starts: {1e3 * batch.residual_swing.max():.2f} mrad at most.")
    path = record(folder / "wall_crane.rrd", [Run("wall crane", crane, run)], title="Wall crane")
    print(f"Written to {path}.")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
