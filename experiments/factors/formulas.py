"""Formulas of the standards beside numbers that their sources print or that follow by hand."""

from __future__ import annotations

import math
from typing import NamedTuple

from cranedyn.lifts.judging import factors, wind_standards

DIGITS = 1e-4
"""Relative error that printing leaves: numbers are printed with four digits and more."""

_RPM = math.pi / 30.0
"""One revolution a minute [rad/s]."""


class Compared(NamedTuple):
    """A factor by its formula, beside its value from elsewhere.

    Attributes:
        name: Name of the factor.
        origin: Source of the formula, or how the factor was simulated. The standards themselves
            were not at hand: they are quoted from other texts.
        formula: Value that the function of `cranedyn.lifts.judging` returns.
        other: Value that the source prints, that follows by hand from its formula, or that was
            simulated.
        within: Largest relative difference between the two.
    """

    name: str
    origin: str
    formula: float
    other: float
    within: float = DIGITS

    @property
    def difference(self) -> float:
        """Relative difference from the formula."""
        return self.other / self.formula - 1.0

    @property
    def holds(self) -> bool:
        """Whether both values agree."""
        return math.isclose(self.formula, self.other, rel_tol=self.within, abs_tol=1e-12)


_EN = "EN 1991-3, T 2.4, 2.5"
_AS1 = "AS 5221.1:2021"
_AS2 = "AS 5222:2021"
_FEM = "FEM 1.001, A.2.2.3"
_FEMS = "FEM 1.001"

FORMULAS = (
    Compared("φ1, least", _EN, factors.phi_1()[0], 0.9),
    Compared("φ1, most", _EN, factors.phi_1()[1], 1.1),
    Compared("φ2,min of HC1", _EN, factors.phi_2_least("HC1"), 1.05),
    Compared("φ2,min of HC4", _EN, factors.phi_2_least("HC4"), 1.20),
    Compared("φ2,min of HC4, HD3", _AS1, factors.phi_2_least("HC4", "HD3"), 1.05),
    Compared("φ2,min of HC3, HD5", _AS1, factors.phi_2_least("HC3", "HD5"), 1.05),
    Compared("φ2 of HC1 at 0.5 m/s", _EN, factors.phi_2("HC1", 0.5), 1.135),
    Compared("φ2 of HC2 at 0.5 m/s", _EN, factors.phi_2("HC2", 0.5), 1.27),
    Compared("φ2 of HC3 at 1 m/s", _EN, factors.phi_2("HC3", 1.0), 1.66),
    Compared("φ2 of HC4 at 1 m/s", _EN, factors.phi_2("HC4", 1.0), 1.88),
    Compared("v_h of HD1", _AS1, factors.pick_up_speed("HD1", 1.0, 0.1), 1.0),
    Compared("v_h of HD2", _AS1, factors.pick_up_speed("HD2", 1.0, 0.1), 0.1),
    Compared("v_h of HD3", _AS1, factors.pick_up_speed("HD3", 1.0, 0.1), 0.1),
    Compared("v_h of HD4", _AS1, factors.pick_up_speed("HD4", 1.0, 0.1), 0.5),
    Compared("v_h of HD5", _AS1, factors.pick_up_speed("HD5", 1.0, 0.1), 0.0),
    Compared("φ3, rapid, a third", _EN, factors.phi_3(1.0 / 3.0), 1.0 / 3.0),
    Compared("φ3, slow, a half", _EN, factors.phi_3(0.5, factors.SLOW_RELEASE), 0.25),
    Compared("φ6 at φ2 = 1.3", "EN 1991-3, 2.10", factors.phi_6(1.3), 1.15),
    Compared("ψ_h at μ = 3", _FEM, factors.psi_h(3.0), 2.309401),
    Compared("ψ_h at μ = 1.5", _FEM, factors.psi_h(1.5), 2.041241),
    Compared("ψ_h at μ = 0.5", _FEM, factors.psi_h(0.5), 2.0),
    Compared("ψ_h at β = 1/4", _FEM, factors.psi_h_regulated(0.25), 1.414214),
    Compared("ψ_h at β = 1/6", _FEM, factors.psi_h_regulated(1.0 / 6.0), 1.0),
    Compared("ψ_h at β = 3", _FEM, factors.psi_h_regulated(3.0), 2.0),
    Compared("buffer at 2 m/s [m]", _FEMS, factors.buffer_stroke(2.0), 0.196),
    Compared("the same, frequent [m]", _FEMS, factors.buffer_stroke(2.0, 2.5), 0.392),
    Compared(
        "slew of 0.8 rpm, stop [rad]", "mechanics", factors.stopping(0.8 * _RPM, 0.02)[0], 0.175460
    ),
    Compared("its time [s]", "mechanics", factors.stopping(0.8 * _RPM, 0.02)[1], 4.18879),
    Compared("wind of 28.5 m/s [Pa]", _AS2, wind_standards.wind_pressure(28.5), 507.656),
    Compared("wind of 250 Pa [m/s]", _AS2, wind_standards.speed_of_pressure(250.0), 20.0),
    Compared("height factor at 10 m", _AS2, wind_standards.height_factor(10.0), 1.4),
    Compared("height factor at 100 m", _AS2, wind_standards.height_factor(100.0), 1.780384),
    Compared(
        "storm of 50 years [m/s]", _AS2, wind_standards.out_of_service_speed(10.0, 40.0), 56.0
    ),
    Compared("its pressure [Pa]", _AS2, wind_standards.wind_pressure(56.0), 1960.0),
    # Printed with three digits.
    *(
        Compared(
            f"f_rec of {years} years",
            _AS2,
            round(wind_standards.recurrence_factor(years), 3),
            factor,
        )
        for years, factor in ((5, 0.815), (10, 0.873), (25, 0.946))
    ),
    Compared("force on 10 m² [N]", _AS2, wind_standards.wind_force(250.0, 10.0), 2500.0),
)
"""Values that the functions of `cranedyn.lifts.judging` have to return.

At μ = 1.5 a public table prints 2.082, which its own formula does not give.
"""
