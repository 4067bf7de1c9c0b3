"""The figures of A3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.analysis.swing import Agreement
from cranedyn.plotting.figures import COLOURS, panels


def slewing_figure(
    t: np.ndarray, measured: np.ndarray, modelled: np.ndarray, excitation: np.ndarray
) -> Figure:
    """Draw the push x γ̈ above, measured and modelled swing below."""
    figure, (above, below) = panels(2, height=2.6, sharex=True)
    above.plot(t, excitation, color=COLOURS["gamma"])
    above.set_ylabel("x γ̈ [m/s²]")
    below.plot(t, np.degrees(measured), color=COLOURS["theta"], label="θ simulated")
    below.plot(
        t,
        np.degrees(modelled),
        "--",
        color=COLOURS["unexplained"],
        linewidth=1.0,
        label="θ by Eq. (10)",
    )
    below.set(ylabel="θ [°]", xlabel="time [s]")
    below.legend(loc="upper right", ncols=2)
    return figure


def stages_figure(results: Mapping[str, Sequence[tuple[str, Agreement]]]) -> Figure:
    """Draw the difference that is left as one cause after the other is removed."""
    figure, (ax,) = panels(1, height=3.0)
    for (drive, models), colour, shift in zip(
        results.items(), (COLOURS["theta"], COLOURS["gamma"]), (-0.18, 0.18), strict=True
    ):
        bars = ax.barh(
            np.arange(len(models)) + shift,
            [100 * result.relative for _, result in models],
            0.34,
            color=colour,
            label=f"{drive} slew drive",
        )
        ax.bar_label(bars, fmt="%.2f %%", padding=3)
    ax.set_yticks(range(len(models)), [name for name, _ in models])
    ax.invert_yaxis()
    ax.margins(x=0.12)
    ax.set_xlabel("RMS difference in θ [% of its amplitude]")
    ax.legend()
    return figure
