"""The tables of A1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cranedyn import theory
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from experiments import harness

if TYPE_CHECKING:
    from experiments.a1 import Case


def article_table(crane: Crane, cases: Sequence[Case]) -> harness.Table:
    """The article's table beside ours."""
    rows: list[tuple[float | None, ...]] = []
    for case in cases:
        p = case.published
        point, rigid = pendulums(crane, case.length)
        period, published, diff, of_rigid, zeta, amplitude = (
            (p.period, p.point, 100 * case.error - p.point, p.rigid, p.zeta, p.amplitude)
            if p
            else (None,) * 6
        )
        rows.append(
            (
                case.length,
                case.fit.period,
                period,
                point,
                100 * case.error,
                published,
                diff,
                100 * (case.fit.period / rigid - 1),
                of_rigid,
                case.fit.damping_ratio,
                zeta,
                case.fit.amplitude,
                amplitude,
            )
        )
    columns = [
        ("l [m]", "g"),
        ("T [s]", ".4f"),
        ("art.", ".3f"),
        ("T point", ".3f"),
        ("error [%]", "+.3f"),
        ("art.", "+.2f"),
        ("diff", "+.3f"),
        ("rigid [%]", "+.3f"),
        ("art.", "+.2f"),
        ("ζ", ".6f"),
        ("art.", ".5f"),
        ("A [rad]", ".5f"),
        ("art.", ".4f"),
    ]
    note = (
        "Errors against the point and the rigid pendulum (payload inertia alone) in standard "
        "gravity, as "
        "published. The article's world had 9.8 m/s²: --gravity 9.8."
    )
    return harness.Table("Free swing beside the article (art.)", columns, rows, note)


def pendulums(crane: Crane, length: float) -> tuple[float, float]:
    """Periods of point and rigid pendulum in standard gravity [s]."""
    return float(theory.point_period(length, STANDARD_GRAVITY)), theory.rigid_period(
        length, STANDARD_GRAVITY, crane.payload_mass, crane.payload_inertia[0, 0]
    )


def budget_table(cases: Sequence[Case]) -> harness.Table:
    """What each cause adds to the period, beside what was simulated."""
    causes = list(cases[0].budget)
    rows = []
    for case in cases:
        parts = [100 * case.budget[cause] for cause in causes]
        published = case.published.point if case.published else None
        rows.append(
            (
                case.length,
                case.stiffness,
                *parts,
                sum(parts),
                100 * case.error,
                100 * case.error - sum(parts),
                published,
            )
        )
    columns = [
        ("l [m]", "g"),
        ("k_p", ".0e"),
        *((cause, "+.3f") for cause in causes),
        ("sum", "+.3f"),
        ("simulated", "+.3f"),
        ("residual", "+.3f"),
        ("article", "+.2f"),
    ]
    return harness.Table("Error budget [% of the point pendulum's period]", columns, rows)


def damping_table(crane: Crane, cases: Sequence[Case]) -> harness.Table:
    """What each cause adds to the damping ratio."""
    g, m, rows = crane.gravity, crane.payload_mass, []
    for case in cases:
        length = case.length + (crane.payload_inertia[0, 0] + crane.dummy_inertia[0]) / (
            m * case.length
        )
        pivot = theory.pivot_compliance(
            length, g, m, STIFFNESS["trolley"], DAMPING["trolley"], crane.trolley_mass
        )[1]
        hoist = theory.hoist_compliance(
            case.predicted.amplitude, length, g, m, STIFFNESS["hoist"], DAMPING["hoist"]
        )[1]
        joint = float(crane.damping[2]) / (2.0 * m * length**2 * math.sqrt(g / length))
        zeta = case.fit.damping_ratio
        published = case.published.zeta if case.published else None
        rows.append(
            (
                case.length,
                pivot,
                hoist,
                joint,
                pivot + hoist + joint,
                zeta,
                published,
                zeta - published if published else None,
            )
        )
    columns = [
        ("l [m]", "g"),
        ("trolley k_d", ".6f"),
        ("hoist compliance", ".6f"),
        ("damp_swing", ".6f"),
        ("sum", ".6f"),
        ("simulated", ".6f"),
        ("article", ".5f"),
        ("simulated less article", "+.6f"),
    ]
    return harness.Table(
        "Where the damping ratio ζ comes from",
        columns,
        rows,
        "By closed forms for the reduced length l + I/(m l). The compliance of the hoist is the "
        "part that no trolley k_d explains.",
    )


def prediction_table(cases: Sequence[Case]) -> harness.Table:
    """Period and damping ratio predicted and simulated."""
    columns = [
        ("l [m]", "g"),
        ("k_p [N/m]", ".0e"),
        ("T predicted [s]", ".5f"),
        ("T simulated [s]", ".5f"),
        ("diff [%]", "+.4f"),
        ("ζ predicted", ".6f"),
        ("ζ simulated", ".6f"),
    ]
    rows = [
        (
            c.length,
            c.stiffness,
            c.predicted.period,
            c.fit.period,
            100 * (c.fit.period / c.predicted.period - 1),
            c.predicted.damping_ratio,
            c.fit.damping_ratio,
        )
        for c in cases
    ]
    return harness.Table(
        "Predicted: eigenvalue of the sampled linear loop, times the factors of finite amplitude",
        columns,
        rows,
    )
