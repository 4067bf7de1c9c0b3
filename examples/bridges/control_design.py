"""Design a swing controller with python-control, then run it on the nonlinear crane: Bode, root
locus, LQR, margins.

Run it with ``python examples/bridges/control_design.py --out FOLDER``; it needs ``pip install
'cranedyn[control]'``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import control as ct
import matplotlib.pyplot as plt
import numpy as np

from cranedyn.controllers.lqr import effort_weight_of, state_weight_of
from cranedyn.interop.python_control import from_control, to_control
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate

PERIOD = 5e-3
"""Control period of the run [s]."""


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Design, check and run; returns what is printed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/control_design"), help="folder for the figure"
    )
    out: Path = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)

    crane = load_crane()
    rest = crane.state(x=12.0, l=15.0)
    trolley = to_control(crane, rest, drive="motion")["phi", "x_ddot"]
    plant = to_control(crane, rest, control_period=PERIOD)  # as `simulate` steps it: efforts, held

    gain, _, poles = ct.dlqr(plant, state_weight_of(crane), effort_weight_of(crane))
    margins = {name: margins_at(plant, gain, i) for i, name in enumerate(plant.input_labels)}
    figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
    ct.bode_plot(trolley, omega=np.logspace(-1, 1, 400), ax=axes[:, :1])
    axes[0, 0].set_title("swing by the trolley's acceleration")
    rate = to_control(crane, rest, drive="motion")["phi_dot", "x_ddot"]
    ct.root_locus_plot(ct.tf(rate), gains=np.linspace(0, 40, 400), ax=axes[0, 1])
    axes[0, 1].set(
        title="trolley accelerated by -k phi_dot", xlabel="real [1/s]", ylabel="imaginary [rad/s]"
    )

    controller = from_control(crane, gain, rest)
    swinging = crane.state(x=12.0, l=15.0, phi=0.1, theta=-0.1)
    run = simulate(
        crane, controller, start=swinging, duration=40.0, control_period=PERIOD, engine="compiled"
    )
    swing = np.hypot(run["phi_rad"], run["theta_rad"])
    axes[1, 1].plot(run.t, 1e3 * swing)
    axes[1, 1].set(xlabel="t [s]", ylabel="swing [mrad]", title="the nonlinear crane under the LQR")
    figure.savefig(out / "control_design.png", dpi=110)
    plt.close(figure)

    result = {
        "slowest pole [1/s]": float(np.log(np.abs(poles)).max() / PERIOD),
        "swing left [mrad]": 1e3 * float(swing[-1]),
    }
    for name, (phase_margin, modulus_margin) in margins.items():
        result |= {
            f"{name}: phase margin [deg]": phase_margin,
            f"{name}: modulus margin": modulus_margin,
        }
    for label, value in result.items():
        print(f"{label:32} {value:10.4g}")
    return result


def margins_at(plant: ct.StateSpace, gain: np.ndarray, drive: int) -> tuple[float, float]:
    """Phase margin [deg] and modulus margin, min |1 + L|, of the loop opened at one drive, the
    others closed.
    """
    other_gain = gain.copy()
    other_gain[drive] = 0.0
    loop = ct.ss(plant.A - plant.B @ other_gain, plant.B[:, [drive]], gain[[drive]], 0, dt=plant.dt)
    # On a grid of our own: left alone, python-control 0.10.2 finds crossings that are not there for
    # loops with poles so near to 1.
    response = ct.frequency_response(loop, np.geomspace(1e-3, 0.999 * np.pi / PERIOD, 2_000))
    _, phase_margin, *_ = ct.stability_margins(response)
    return float(phase_margin), float(np.abs(1.0 + response.frdata).min())


if __name__ == "__main__":
    main()
