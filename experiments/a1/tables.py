"""The tables of A1."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cranedyn import theory
from cranedyn.analysis.swing import SwingFit
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from experiments.a1.case import FIT_FROM, SwingCase
from experiments.harness import ResultTable, make_table


def article_table(crane: Crane, cases: Sequence[SwingCase]) -> ResultTable:
    """Return the article's table beside ours."""
    return make_table(
        "Free swing beside the article (art.)",
        cases,
        ("l [m]", "g", lambda c: c.length),
        ("T [s]", ".4f", lambda c: c.fit.period),
        ("error [%]", "+.3f", lambda c: 100 * c.error),
        ("art.", "+.2f", lambda c: c.published.point),
        ("ζ", ".6f", lambda c: c.fit.damping_ratio),
        ("art.", ".5f", lambda c: c.published.zeta),
        ("A [rad]", ".5f", lambda c: c.fit.amplitude),
        ("art.", ".4f", lambda c: c.published.amplitude),
        ("T art.", ".3f", lambda c: c.published.period),
        ("T point", ".3f", lambda c: _point(c.length)),
        ("error less art.", "+.3f", lambda c: _less(100 * c.error, c.published.point)),
        (
            "error, rigid pendulum [%]",
            "+.3f",
            lambda c: 100 * (c.fit.period / _rigid(crane, c.length) - 1),
        ),
        ("art., rigid pendulum", "+.2f", lambda c: c.published.rigid),
        note="error: how much longer the period T is than 2π√(l/g) with g = 9.80665 m/s²; ζ: "
        "damping ratio; A: amplitude; art.: published in the article, which simulated with 9.8 "
        "m/s² (here: --gravity 9.8).",
    )


def _point(length: float) -> float:
    return float(theory.point_period(length, STANDARD_GRAVITY))


def _rigid(crane: Crane, length: float) -> float:
    inertia = crane.payload_inertia[0, 0]
    return theory.rigid_period(length, STANDARD_GRAVITY, crane.payload_mass, inertia)


def _less(value: float, published: float | None) -> float | None:
    return None if published is None else value - published


def budget_table(cases: Sequence[SwingCase]) -> ResultTable:
    """Return what each cause adds to the period, beside the simulated error."""
    causes = [
        (cause, "+.3f", lambda c, cause=cause: 100 * c.budget[cause]) for cause in cases[0].budget
    ]

    def total(case: SwingCase) -> float:
        return sum(100 * share for share in case.budget.values())

    return make_table(
        "Error budget [% of the point pendulum's period]",
        cases,
        ("l [m]", "g", lambda c: c.length),
        ("k_p", ".0e", lambda c: c.stiffness),
        *causes,
        ("sum", "+.3f", total),
        ("simulated", "+.3f", lambda c: 100 * c.error),
        ("residual", "+.3f", lambda c: 100 * c.error - total(c)),
        ("article", "+.2f", lambda c: c.published.point),
    )


def damping_table(crane: Crane, cases: Sequence[SwingCase]) -> ResultTable:
    """Return what each cause adds to the damping ratio."""
    g = crane.gravity
    m = crane.payload_mass

    def parts(case: SwingCase) -> tuple[float, float, float]:
        inertia = crane.payload_inertia[0, 0] + crane.dummy_inertia[0]
        length = case.length + inertia / (m * case.length)
        trolley = STIFFNESS["trolley"], DAMPING["trolley"], crane.trolley_mass
        hoist = STIFFNESS["hoist"], DAMPING["hoist"]
        joint = float(crane.damping[2]) / (2.0 * m * length**2 * math.sqrt(g / length))
        return (
            theory.pivot_compliance(length, g, m, *trolley)[1],
            theory.hoist_compliance(case.predicted.amplitude, length, g, m, *hoist)[1],
            joint,
        )

    return make_table(
        "Where the damping ratio ζ comes from",
        cases,
        ("l [m]", "g", lambda c: c.length),
        ("trolley k_d", ".6f", lambda c: parts(c)[0]),
        ("hoist compliance", ".6f", lambda c: parts(c)[1]),
        ("damp_swing", ".6f", lambda c: parts(c)[2]),
        ("sum", ".6f", lambda c: sum(parts(c))),
        ("simulated", ".6f", lambda c: c.fit.damping_ratio),
        ("article", ".5f", lambda c: c.published.zeta),
        ("simulated less article", "+.6f", lambda c: _less(c.fit.damping_ratio, c.published.zeta)),
        note="By closed forms for the reduced length l + I/(m l). The compliance of the hoist is "
        "the part that no trolley k_d explains.",
    )


def prediction_table(cases: Sequence[SwingCase]) -> ResultTable:
    """Return period and damping ratio predicted and simulated."""
    return make_table(
        "Predicted: eigenvalue of the sampled linear loop, times the factors of finite amplitude",
        cases,
        ("l [m]", "g", lambda c: c.length),
        ("k_p [N/m]", ".0e", lambda c: c.stiffness),
        ("T predicted [s]", ".5f", lambda c: c.predicted.period),
        ("T simulated [s]", ".5f", lambda c: c.fit.period),
        ("diff [%]", "+.4f", lambda c: 100 * c.prediction_error),
        ("ζ predicted", ".6f", lambda c: c.predicted.damping_ratio),
        ("ζ simulated", ".6f", lambda c: c.fit.damping_ratio),
    )


def files_table(crane: Crane, fits: Sequence[tuple[str, float, SwingFit]]) -> ResultTable:
    """Return the fits of recorded files, each with its name and cable length [m]."""
    return make_table(
        "Free swing in files recorded elsewhere",
        fits,
        ("file", "", lambda f: f[0]),
        ("l [m]", ".3f", lambda f: f[1]),
        ("T [s]", ".4f", lambda f: f[2].period),
        ("point [%]", "+.3f", lambda f: 100 * (f[2].period / _point(f[1]) - 1)),
        ("rigid [%]", "+.3f", lambda f: 100 * (f[2].period / _rigid(crane, f[1]) - 1)),
        ("ζ", ".6f", lambda f: f[2].damping_ratio),
        ("A [rad]", ".5f", lambda f: f[2].amplitude),
        ("fit rms [rad]", ".1e", lambda f: f[2].rms),
        note=f"Fitted from t = {FIT_FROM:g} s; rigid pendulum of {crane.payload_mass:g} kg and "
        f"{crane.payload_inertia[0, 0]:g} kg m².",
    )
