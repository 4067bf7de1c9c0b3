"""Whether a load chart can be that of a crane, see `cranedyn.lifts.planning.plausibility`."""

from __future__ import annotations

from collections.abc import Iterator

from cranedyn.lifts.judging.chart import ANY_RADIUS, Chart
from cranedyn.lifts.planning.plausibility import (
    MILLIMETRES,
    TONNES,
    Finding,
    Quantity,
    judge_value,
)

RADIUS = Quantity("A radius of the chart", "m", (1e-3, 1e3), (0.05, 150.0), MILLIMETRES)
"""Radii of charts: possible ones, usual ones, and units that are mistaken for metres."""

RATED = Quantity("A rated load of the chart", "kg", (1e-3, 2.5e7), (0.5, 5e6), TONNES)
"""Rated loads of charts: possible ones, usual ones, and the unit that is mistaken for kilograms."""

JIB_SHARE = (0.6, 1.3)
"""Last radius of a chart over the reach of its crane: a chart ends about where the jib ends."""


def chart_findings(chart: Chart, reach: float | None) -> Iterator[Finding]:
    """Yield what cannot be meant of a chart, and what is unusual.

    Args:
        chart: The chart.
        reach: Largest radius of the crane's trolley [m]; None for a crane that does not slew, whose
            chart has one load and no radii.
    """
    for reeving in chart.reevings:
        for rated in reeving.rated.tolist():
            yield from judge_value(RATED, rated, "chart", "loads")
        if reach is None or reeving.radii[-1] == ANY_RADIUS:
            continue
        for radius in reeving.radii.tolist():
            yield from judge_value(RADIUS, radius, "chart", "radii")
        if reeving.boom is not None:
            continue  # the loads of each length of the boom end elsewhere
        last = float(reeving.radii[-1])
        low, high = JIB_SHARE
        if not low * reach <= last <= high * reach:
            yield Finding(
                "chart",
                "radii",
                False,
                f"The chart on {reeving.count} falls ends at {last:g} m and the crane's trolley "
                f"reaches {reach:g} m. Is it the chart of another jib?",
            )
