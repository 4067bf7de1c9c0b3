"""Which gains the article must have had: the unpublished gains of trolley and hoist, from the three
published columns of A1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from cranedyn.controllers.hold import DAMPING, STIFFNESS
from experiments import a1, harness

ROUNDING = np.array(list(a1.ROUNDING.values()))
"""Half a unit in the last published digit of error [percentage points], ζ, and amplitude [rad],
shape (3,)."""

TROLLEY = (4.0e4, 4.5e4, 5.0e4, 5.5e4, 6.0e4)
"""Values of the trolley's k_d tried [N s/m], with a stiff hoist."""

STIFF_HOIST = (1.0e6, 6.0e4)
HOIST = (
    STIFF_HOIST,
    (1.0e5, 2.0e4),
    (5.0e4, 2.0e4),
    (3.0e4, 2.0e4),
    (3.0e4, 1.0e4),
    (2.0e4, 2.0e4),
    (1.0e4, 2.0e4),
)
"""Pairs of the hoist's k_p [N/m] and k_d [N s/m] tried, with the trolley's k_d of
`cranedyn.controllers.hold`."""


def differences(setup: harness.Setup, trolley_damping: float, hoist: Sequence[float]) -> np.ndarray:
    """Ours less the published error [percentage points], ζ and amplitude [rad] at the four lengths,
    shape (4, 3).
    """
    stiffness, damping = {"l": hoist[0]}, {"x": trolley_damping, "l": hoist[1]}
    cases = [a1.run(setup, length, stiffness=stiffness, damping=damping) for length in a1.PUBLISHED]
    return np.array(
        [
            (
                100 * c.error - p.point,
                c.fit.damping_ratio - (p.zeta or 0.0),
                c.fit.amplitude - (p.amplitude or 0.0),
            )
            for c, p in zip(cases, a1.PUBLISHED.values(), strict=True)
        ]
    )


def identify(setup: harness.Setup) -> harness.Outcome:
    """Scan the trolley's k_d, then the hoist's gains, then fit all three together."""
    scan = np.array([differences(setup, k_d, STIFF_HOIST) for k_d in TROLLEY])
    pulls = [_best(np.array(TROLLEY), scan[:, :, column]) for column in range(3)]
    hoists = np.array([differences(setup, DAMPING["trolley"], pair) for pair in HOIST])

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        k_d, *hoist = np.exp(logarithms)
        return (differences(setup, k_d, hoist) / ROUNDING).ravel()

    start = np.log([DAMPING["trolley"], STIFFNESS["hoist"], DAMPING["hoist"]])
    fit = least_squares(residuals, start, diff_step=0.02, xtol=1e-3, ftol=1e-3, max_nfev=4)
    best = np.exp(fit.x)
    ours = differences(setup, DAMPING["trolley"], (STIFFNESS["hoist"], DAMPING["hoist"]))
    rest = [f"{value:+.6f}" for value in ours[:, 1]]
    stiff = [f"{value:+.6f}" for value in hoists[0][:, 1]]
    return harness.Outcome(
        tables=[
            _table(
                "Trolley k_d with a stiff hoist (k_p = 1e6 N/m, k_d = 6e4 N s/m): ours less the "
                "published columns",
                [(f"{k:.2e}",) for k in TROLLEY],
                ("k_d [N s/m]",),
                scan,
            ),
            harness.Table(
                "The k_d that each column alone asks for, stiff hoist",
                [("column", ""), ("k_d [N s/m]", ".3g")],
                list(zip(("error", "ζ", "amplitude"), pulls, strict=True)),
            ),
            _table(
                f"Hoist gains with trolley k_d = {DAMPING['trolley']:.0e} N s/m",
                [(f"{a:.0e}", f"{b:.0e}") for a, b in HOIST],
                ("hoist k_p", "hoist k_d"),
                hoists,
            ),
            harness.Table(
                "All three gains fitted together, each column weighted by its rounding",
                [("gain", ""), ("fitted", ".3g"), ("taken", ".3g")],
                [
                    ("trolley k_d [N s/m]", best[0], DAMPING["trolley"]),
                    ("hoist k_p [N/m]", best[1], STIFFNESS["hoist"]),
                    ("hoist k_d [N s/m]", best[2], DAMPING["hoist"]),
                ],
                f"ζ left unexplained (ours less published) at 5, 10, 15, 20 m: {', '.join(rest)} "
                "with the gains "
                f"taken; {', '.join(stiff)} with a stiff hoist.",
            ),
        ],
        claims=[
            harness.Claim(
                "The compliance of the hoist lowers the misfit of ζ at least tenfold "
                f"({misfit(hoists[0]):.1e} to {misfit(ours):.1e}).",
                setup.judged(misfit(hoists[0]) > 10.0 * misfit(ours)),
            )
        ],
        parameters=setup.parameters() | {"fitted": best.tolist()},
    )


def _best(k_d: np.ndarray, differences: np.ndarray) -> float:
    """Where the sum of squares over the lengths is least, differences taken as linear in k_d."""
    slope, level = np.polyfit(k_d, differences, 1)
    return float(-(slope @ level) / (slope @ slope))


def misfit(differences: np.ndarray) -> float:
    """Root mean square over the lengths of what is missing in ζ."""
    return float(np.sqrt(np.mean(differences[:, 1] ** 2)))


def _table(
    title: str, labels: Sequence[Sequence[str]], headers: Sequence[str], values: np.ndarray
) -> harness.Table:
    lengths = [f"{length:g} m" for length in a1.PUBLISHED]
    columns = [
        *((h, "") for h in headers),
        *((f"error {n}", "+.3f") for n in lengths),
        *((f"ζ {n}", "+.1f") for n in lengths),
        *((f"A {n}", "+.1f") for n in lengths),
    ]
    columns.append(("misfit", ".2f"))
    rows = [
        (
            *label,
            *(value * (1.0, 1e5, 1e4)).T.ravel().tolist(),
            float(np.sqrt(np.mean((value / ROUNDING) ** 2))),
        )
        for label, value in zip(labels, values, strict=True)
    ]
    return harness.Table(
        title,
        columns,
        rows,
        "Error in percentage points, ζ in 1e-5, A in 1e-4 rad; misfit is the root mean square over "
        "all "
        "twelve numbers in units of half their last digit.",
    )
