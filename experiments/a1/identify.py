"""Identification of the article's gains: those of trolley and hoist, which are not published, from
the three published columns of A1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from cranedyn.controllers.hold import DAMPING, STIFFNESS
from experiments.a1 import case
from experiments.a1.case import PUBLISHED, run
from experiments.harness import Claim, Column, Outcome, ResultTable, Setup, make_table

ROUNDING = np.array(list(case.ROUNDING.values()))
"""Half a unit in the last published digit of error [percentage points], ζ, and amplitude [rad],
shape (3,)."""

TROLLEY = (4.0e4, 4.5e4, 5.0e4, 5.5e4, 6.0e4)
"""Values of the trolley's k_d tried [N s/m], with a stiff hoist."""

STIFF_HOIST = (1.0e6, 6.0e4)
"""k_p [N/m] and k_d [N s/m] of a stiff hoist."""

HOIST = (STIFF_HOIST, (1e5, 2e4), (5e4, 2e4), (3e4, 2e4), (3e4, 1e4), (2e4, 2e4), (1e4, 2e4))
"""Pairs of the hoist's k_p [N/m] and k_d [N s/m] tried, with the trolley's k_d of
`cranedyn.controllers.hold`."""


def differences(setup: Setup, trolley_damping: float, hoist: Sequence[float]) -> np.ndarray:
    """Return ours less the published error [percentage points], ζ and amplitude [rad] at the four
    lengths, shape (4, 3), by the trolley's k_d and the hoist's k_p and k_d.
    """
    stiffness = {"l": hoist[0]}
    damping = {"x": trolley_damping, "l": hoist[1]}
    cases = [run(setup, length, stiffness=stiffness, damping=damping) for length in PUBLISHED]
    ours = [(100 * c.error, c.fit.damping_ratio, c.fit.amplitude) for c in cases]
    return np.array(ours) - [(p.point, p.zeta, p.amplitude) for p in PUBLISHED.values()]


def identify_hoist(setup: Setup) -> Outcome:
    """Scan the trolley's k_d, then the hoist's gains, then fit all three together."""
    scan = np.array([differences(setup, k_d, STIFF_HOIST) for k_d in TROLLEY])
    optima = [_optimum(np.array(TROLLEY), scan[:, :, column]) for column in range(3)]
    hoists = np.array([differences(setup, DAMPING["trolley"], pair) for pair in HOIST])

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        k_d, *hoist = np.exp(logarithms)
        return (differences(setup, k_d, hoist) / ROUNDING).ravel()

    gains = (DAMPING["trolley"], STIFFNESS["hoist"], DAMPING["hoist"])
    fit = least_squares(residuals, np.log(gains), diff_step=0.02, xtol=1e-3, ftol=1e-3, max_nfev=4)
    fitted = np.exp(fit.x)
    ours = differences(setup, gains[0], gains[1:])
    zeta = _zetas(ours)
    zeta_of_stiff = _zetas(hoists[0])
    names = ("trolley k_d [N s/m]", "hoist k_p [N/m]", "hoist k_d [N s/m]")
    return Outcome(
        tables=[
            _table(
                "Trolley k_d with a stiff hoist (k_p = 1e6 N/m, k_d = 6e4 N s/m): ours less the "
                "published columns",
                zip(TROLLEY, scan, strict=True),
                ("k_d [N s/m]", "", lambda row: f"{row[0]:.2e}"),
            ),
            ResultTable(
                "The k_d that each column alone asks for, stiff hoist",
                [("column", ""), ("k_d [N s/m]", ".3g")],
                list(zip(("error", "ζ", "amplitude"), optima, strict=True)),
            ),
            _table(
                f"Hoist gains with trolley k_d = {DAMPING['trolley']:.0e} N s/m",
                zip(HOIST, hoists, strict=True),
                ("hoist k_p", "", lambda row: f"{row[0][0]:.0e}"),
                ("hoist k_d", "", lambda row: f"{row[0][1]:.0e}"),
            ),
            ResultTable(
                "All three gains fitted together, each column weighted by its rounding",
                [("gain", ""), ("fitted", ".3g"), ("taken", ".3g")],
                list(zip(names, fitted.tolist(), gains, strict=True)),
                f"ζ left unexplained (ours less published) at 5, 10, 15, 20 m: {zeta} with the "
                f"gains taken; {zeta_of_stiff} with a stiff hoist.",
            ),
        ],
        claims=[
            Claim(
                "The compliance of the hoist lowers the misfit of ζ at least tenfold "
                f"({misfit(hoists[0]):.1e} to {misfit(ours):.1e}).",
                setup.judged(misfit(hoists[0]) > 10.0 * misfit(ours)),
            )
        ],
        parameters={"fitted": fitted.tolist()},
    )


def _zetas(differences: np.ndarray) -> str:
    """Return the differences in ζ at the four lengths as text."""
    return ", ".join(f"{value:+.6f}" for value in differences[:, 1])


def _optimum(k_d: np.ndarray, differences: np.ndarray) -> float:
    """Return the k_d of the least sum of squares, with differences taken as linear in it."""
    slope, level = np.polyfit(k_d, differences, 1)
    return float(-(slope @ level) / (slope @ slope))


def misfit(differences: np.ndarray) -> float:
    """Return the root mean square over the lengths of the difference in ζ."""
    return float(np.sqrt(np.mean(differences[:, 1] ** 2)))


def _table(title: str, rows: Iterable[tuple[object, np.ndarray]], *labels: Column) -> ResultTable:
    """Return the table of the differences at all lengths.

    Args:
        title: Its title.
        rows: What each row is about, with its differences, shape (4, 3).
        *labels: Columns that show what a row is about.
    """

    def difference(row: tuple[object, np.ndarray], i: int, k: int, scale: float) -> float:
        return float(row[1][i, k] * scale)

    columns: list[Column] = []
    for k, (name, form, scale) in enumerate(
        (("error", "+.3f", 1.0), ("ζ", "+.1f", 1e5), ("A", "+.1f", 1e4))
    ):
        for i, length in enumerate(PUBLISHED):
            read = partial(difference, i=i, k=k, scale=scale)
            columns.append((f"{name} {length:g} m", form, read))
    return make_table(
        title,
        rows,
        *labels,
        *columns,
        ("misfit", ".2f", lambda row: float(np.sqrt(np.mean((row[1] / ROUNDING) ** 2)))),
        note="Error in percentage points, ζ in 1e-5, A in 1e-4 rad; misfit is the root mean "
        "square over all twelve numbers in units of half their last digit.",
    )
