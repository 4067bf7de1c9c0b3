"""A sweep that can be interrupted and goes on; run it as ``python -m sweep_study``."""

import numpy as np

from cranedyn.command import command
from cranedyn.sweep import grid, results, sweep
from cranedyn.theory import amplitude_factor, point_period


def period(cases: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Periods of free swings [s] by cable length and amplitude; a study takes and gives columns."""
    return {"T_s": point_period(cases["l_m"], 9.80665) * amplitude_factor(cases["A_rad"])}


def main() -> int:
    """Sweep 200 cases, then look at all of them."""
    lengths = np.linspace(5.0, 24.0, 20).tolist()
    amplitudes = np.linspace(0.05, 1.0, 10).tolist()
    end = sweep(period, grid(l_m=lengths, A_rad=amplitudes), "periods", workers=1)
    table = results("periods")
    print(f"{end.done} cases, {end.done - end.before} of them computed just now")
    print(
        f"periods from {min(table['T_s'].to_pylist()):.3f} to {max(table['T_s'].to_pylist()):.3f} s"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(command(main))
