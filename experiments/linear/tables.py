"""Tables of the comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

from experiments.harness import Column, ResultTable, tabulate
from experiments.linear.runs import DEEP, HIGH, LinearCase
from experiments.linear.sites import ANGLES, HOLD, RAMPS, SHARES, SiteCrane

RPM = 30.0 / math.pi
"""Turns a minute of one radian a second."""


def errors_table(site: SiteCrane, cases: Sequence[LinearCase]) -> ResultTable:
    """Return how far the paper's equations are from the plant in each move of a crane."""
    return tabulate(
        f"{site.name}: error of Eqs. (8), (10) over the largest swing",
        cases,
        [
            ("move", "", lambda c: c.job.name),
            ("takes [s]", ".1f", lambda c: c.job.arrival),
            ("swing [°]", ".2f", lambda c: math.degrees(c.paper.swing)),
            ("φ rms [%]", ".1f", lambda c: 100.0 * c.paper.phi),
            ("θ rms [%]", ".1f", lambda c: 100.0 * c.paper.theta),
            ("both rms [%]", ".1f", lambda c: 100.0 * c.paper.rms),
            ("peak [%]", ".1f", lambda c: 100.0 * c.paper.peak),
            ("all rates: rms [%]", ".1f", lambda c: 100.0 * c.rates.rms),
            ("with inertia: rms [%]", ".1f", lambda c: c.rigid and 100.0 * c.rigid.rms),
        ],
        f"Jib {site.jib:g} m, cable {site.height:g} m, trolley {site.trolley:.2f} m/s, slew "
        f"{site.slew * RPM:.2f} rpm, hoist {site.hoist[0]:.2f} and {site.hoist[1]:.2f} m/s.",
    )


def dropped_table(site: SiteCrane, cases: Sequence[LinearCase]) -> ResultTable:
    """Return how large the dropped terms are in each move of a crane."""

    def share(case: LinearCase, name: str) -> float:
        return 100.0 * case.dropped[name]

    terms = [(f"{name} [%]", ".1f", partial(share, name=name)) for name in cases[0].dropped]
    return tabulate(
        f"{site.name}: largest of each dropped term over the larger of ẍ and x γ̈",
        cases,
        [("move", "", lambda c: c.job.name), ("kept [m/s²]", ".3f", lambda c: c.kept), *terms],
    )


def rates_table(
    errors: Mapping[str, Sequence[float]], rates: Mapping[str, float], good: float
) -> ResultTable:
    """Return how the error falls with the slew rate."""
    return _scan_table(
        "Error of a slew at shares of the crane's slew rate",
        errors,
        [f"{share:g} [%]" for share in SHARES],
        (f"{100.0 * good:g} % at [rpm]", ".3f", lambda name: rates[name] * RPM),
        f"The rate is reached in {RAMPS[0]:g} s, and left {HOLD:g} s after the start; root mean "
        "square over the largest swing.",
    )


def angles_table(
    errors: Mapping[str, Sequence[float]], angles: Mapping[str, float], good: float
) -> ResultTable:
    """Return how the error falls with the angle."""
    return _scan_table(
        "Error of short slews",
        errors,
        [f"{angle:g}° [%]" for angle in ANGLES],
        (f"{100.0 * good:g} % at [°]", ".1f", lambda name: angles[name]),
        "The jib accelerates over half of the angle and brakes over the other, unless it reaches "
        "its rate before.",
    )


def _scan_table(
    title: str, errors: Mapping[str, Sequence[float]], headers: list[str], limit: Column, note: str
) -> ResultTable:

    def error(name: str, i: int) -> float:
        return 100.0 * errors[name][i]

    columns = [(header, ".1f", partial(error, i=i)) for i, header in enumerate(headers)]
    return tabulate(title, errors, [("crane", "", str), *columns, limit], note)


def powers_table(powers: Mapping[str, Sequence[float]]) -> ResultTable:
    """Return how a free swing changes on a cable that is hoisted slowly."""
    return tabulate(
        "Power of the cable length with which a free swing changes",
        powers,
        [
            ("crane", "", str),
            ("plant", "+.3f", lambda name: powers[name][0]),
            ("Eq. (8)", "+.3f", lambda name: powers[name][1]),
        ],
        f"Cable from {DEEP:g} to {HIGH:g} of its longest. By the action: -3/4, and +1/4 for l "
        "φ̈ + g φ = 0, which lacks 2 l̇ φ̇.",
    )
