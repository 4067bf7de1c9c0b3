"""Tables of the comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from experiments.harness.outcome import Table
from experiments.linear.runs import DEEP, HIGH, Case
from experiments.linear.sites import ANGLES, HOLD, RAMPS, SHARES, Site

RPM = 30.0 / math.pi
"""Turns a minute of one radian a second."""


def errors_table(site: Site, some: Sequence[Case]) -> Table:
    """How far the paper's equations are from the plant in each move of a crane."""
    rows: list[tuple[str | float | None, ...]] = []
    for c in some:
        shares = (
            c.paper.phi,
            c.paper.theta,
            c.paper.rms,
            c.paper.peak,
            c.rates.rms,
            c.rigid.rms if c.rigid else None,
        )
        rows.append(
            (
                c.job.name,
                c.job.arrival,
                math.degrees(c.paper.swing),
                *(share and 100.0 * share for share in shares),
            )
        )
    columns = [
        ("move", ""),
        ("takes [s]", ".1f"),
        ("swing [°]", ".2f"),
        ("φ rms [%]", ".1f"),
        ("θ rms [%]", ".1f"),
        ("both rms [%]", ".1f"),
        ("peak [%]", ".1f"),
        ("all rates: rms [%]", ".1f"),
        ("with inertia: rms [%]", ".1f"),
    ]
    note = (
        f"Jib {site.jib:g} m, cable {site.height:g} m, trolley {site.trolley:.2f} m/s, slew "
        f"{site.slew * RPM:.2f} rpm, hoist {site.hoist[0]:.2f} and {site.hoist[1]:.2f} m/s."
    )
    return Table(
        f"{site.name}: error of Eqs. (8), (10) over the largest swing", columns, rows, note
    )


def dropped_table(site: Site, some: Sequence[Case]) -> Table:
    """How large the dropped terms are in each move of a crane."""
    columns = [
        ("move", ""),
        ("kept [m/s²]", ".3f"),
        *((f"{name} [%]", ".1f") for name in some[0].dropped),
    ]
    rows: list[tuple[str | float, ...]] = [
        (c.job.name, c.kept, *(100.0 * share for share in c.dropped.values())) for c in some
    ]
    return Table(
        f"{site.name}: largest of each dropped term over the larger of ẍ and x γ̈", columns, rows
    )


def rates_table(
    errors: Mapping[str, Sequence[float]], rates: Mapping[str, float], good: float
) -> Table:
    """How the error falls with the slew rate."""
    columns = [
        ("crane", ""),
        *((f"{share:g} [%]", ".1f") for share in SHARES),
        (f"{100.0 * good:g} % at [rpm]", ".3f"),
    ]
    rows: list[tuple[str | float, ...]] = [
        (name, *(100.0 * e for e in some), rates[name] * RPM) for name, some in errors.items()
    ]
    note = (
        f"The rate is reached in {RAMPS[0]:g} s, and left {HOLD:g} s after the start; root mean "
        "square over the largest swing."
    )
    return Table("Error of a slew at shares of the crane's slew rate", columns, rows, note)


def angles_table(
    errors: Mapping[str, Sequence[float]], angles: Mapping[str, float], good: float
) -> Table:
    """How the error falls with the way."""
    columns = [
        ("crane", ""),
        *((f"{angle:g}° [%]", ".1f") for angle in ANGLES),
        (f"{100.0 * good:g} % at [°]", ".1f"),
    ]
    rows: list[tuple[str | float, ...]] = [
        (name, *(100.0 * e for e in some), angles[name]) for name, some in errors.items()
    ]
    return Table(
        "Error of short slews",
        columns,
        rows,
        "The jib accelerates over half of the angle and brakes over the other, unless it reaches "
        "its rate before.",
    )


def powers_table(found: Mapping[str, Sequence[float]]) -> Table:
    """How a free swing changes on a cable that is hoisted slowly."""
    rows: list[tuple[str | float, ...]] = [(name, *some) for name, some in found.items()]
    columns = [("crane", ""), ("plant", "+.3f"), ("Eq. (8)", "+.3f")]
    note = (
        f"Cable from {DEEP:g} to {HIGH:g} of its longest. By the action: -3/4, and +1/4 for l "
        "φ̈ + g φ = 0, which lacks 2 l̇ φ̇."
    )
    return Table("Power of the cable length with which a free swing changes", columns, rows, note)
